"""How well a method finds mouth openings in the reference data. Prints the tables of RESULTS.md.

    python benchmarks/accuracy.py --methods default thesis --part report
    python benchmarks/accuracy.py --methods default --part tune --set stills --worst 12 out

The figures are defined in scores.py.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import reference
import worst
from reference import Item
from results import markdown, write_section
from scores import Scored, by_confidence, by_height, clip_scores, score, summary, table, video_summary

from lipmetrics.detect import make_detector
from lipmetrics.frames import open_frames
from lipmetrics.look import NO_MOUTH, OPEN, Look
from lipmetrics.still import look_at

LookOf = Callable[[np.ndarray], Look]  # (height, width, 3) uint8 RGB -> Look
SETS = ("stills", "points", "hand", "closeups", "crops", "videos")
JITTERED_CLOSE_UPS, SEED = 2, 20


# --- showing the data to a method


def evaluate(items: Iterable[Item], look_of: LookOf) -> list[Scored]:
    """Show every picture to the method by itself and score it."""
    return [score(item, look_of(item.picture())) for item in items]


def evaluate_stills(look_of: LookOf, part: str = "tune", kind: str = "stills_mask") -> list[Scored]:
    """Full pictures: ``stills_mask``, ``stills_pts`` or ``hand``."""
    return evaluate(reference.items(kind, part), look_of)


def evaluate_closeups(look_of: LookOf, part: str = "tune") -> list[Scored]:
    """Mouth-only pictures of all stills: one centred, JITTERED_CLOSE_UPS moved and scaled."""
    stills = reference.items("stills_mask", part) + reference.items("stills_pts", part)
    windows = []
    for still in stills:
        rng = np.random.default_rng([SEED, *still.name.encode()])  # the same crops whatever the part
        windows += [reference.close_up(still)]
        windows += [reference.close_up(still, rng) for _ in range(JITTERED_CLOSE_UPS)]
    return evaluate(windows, look_of)


def evaluate_crops(look_of: LookOf, part: str = "tune") -> list[Scored]:
    """Nose-to-chin pictures of the stills with masks."""
    return evaluate(map(reference.nose_to_chin, reference.items("stills_mask", part)), look_of)


def evaluate_videos(
    looks_of: Callable[[Path], Iterable[Look]], part: str = "tune", clips: Iterable[str] | None = None
) -> pd.DataFrame:
    """Profiles of the reference videos beside the landmark tools'.

    looks_of : video file -> one Look per frame from the first on
    clips : names of the videos to take, without suffix; all of the part if None
    Returns one row per frame: clip, person, frame, status, height_px and lip_width_px (NaN where no mouth was found),
    confidence, and the columns of the landmark tools' profile.
    """
    tables = []
    for path, identity in reference.choose("videos", part)[["path", "identity"]].to_numpy():
        stem = Path(path).stem
        if clips is not None and stem not in clips:
            continue
        looks = list(looks_of(reference.video_file(stem)))
        found = pd.DataFrame(
            {
                "frame": range(len(looks)),
                "status": [look.status for look in looks],
                "height_px": [_profile_height(look) for look in looks],
                "lip_width_px": [look.lip_width_px for look in looks],
                "confidence": [look.confidence for look in looks],
            }
        )
        rows = reference.profile(stem).merge(found, on="frame", how="left")
        tables.append(rows.assign(clip=stem, person=reference.person(identity)))
    return pd.concat(tables, ignore_index=True)


def _profile_height(look: Look) -> float:
    if look.status == NO_MOUTH:
        return np.nan
    return reference.height_px(look.outlines) if look.status == OPEN else 0.0


# --- methods of the package


def still_looks(method: str, settings: object = None) -> LookOf:
    """A method of lipmetrics on single pictures, each seen for the first time."""
    return partial(look_at, method=method, settings=settings)


def clip_looks(method: str, settings: object = None) -> Callable[[Path], Iterable[Look]]:
    """A method of lipmetrics on clips, from the first frame to the last."""

    def looks_of(path: Path) -> Iterable[Look]:
        with open_frames(path) as frames:
            detector = make_detector(method, settings, frames.info)
            yield from map(detector.look, frames)

    return looks_of


# --- report


def run_set(name: str, method: str, part: str) -> list[Scored]:
    """Score a method on one of the sets of pictures."""
    look_of = still_looks(method)
    if name == "closeups":
        return evaluate_closeups(look_of, part)
    if name == "crops":
        return evaluate_crops(look_of, part)
    return evaluate_stills(look_of, part, {"stills": "stills_mask", "points": "stills_pts", "hand": "hand"}[name])


def of_part(rows: pd.DataFrame, part: str) -> pd.DataFrame:
    """The rows of ``tune`` or ``report``, or all of them."""
    return rows if part == "all" else rows[rows["person"].map(reference.part_of) == part]


def figures(rows: dict[str, pd.DataFrame]) -> dict[str, str]:
    """The figures of the main table, by the names in TARGETS, from one table per set."""
    found = {}
    if "stills" in rows:
        one = summary(rows["stills"])
        found["stills: median IoU, open"] = f"{one['iou_median']:.3f}"
        found["stills: 10th percentile IoU, open"] = f"{one['iou_p10']:.2f}"
        found["stills: mean height error, % of mouth width"] = f"{one['height_error_pct']:.2f}"
        found["stills: median height error, px"] = f"{one['height_error_median_px']:.1f}"
        found["stills: closed called open"] = f"{one['false_open']} of {one['closed']}"
        found["stills: open called closed"] = f"{one['missed']} of {one['open']}"
    for name, sets in {"points and hand": ["points", "hand"], "points": ["points"], "hand": ["hand"]}.items():
        if all(one in rows for one in sets):
            one = summary(pd.concat([rows[each] for each in sets]))
            found[f"{name}: median IoU, open"] = f"{one['iou_median']:.3f}"
            found[f"{name}: mean height error, % of mouth width"] = f"{one['height_error_pct']:.2f}"
            found[f"{name}: closed called open"] = f"{one['false_open']} of {one['closed']}"
            found[f"{name}: open called closed"] = f"{one['missed']} of {one['open']}"
    if "videos" in rows:
        one = video_summary(clip_scores(rows["videos"]))
        found["videos: frames with a mouth found, %"] = f"{one['found_pct']:.1f}"
        found["videos: correlation of height, median over clips"] = f"{one['correlation_median']:.3f}"
        found["videos: correlation of height, 10th percentile"] = f"{one['correlation_p10']:.2f}"
        found["videos: open or closed as the tools, % of frames"] = f"{one['agreement_pct']:.1f}"
        found["videos: the same, median over clips"] = f"{one['agreement_median_pct']:.1f}"
        for state in ("closed", "still"):
            ours, tools = one[f"jitter_{state}_pct"], one[f"jitter_{state}_tools_pct"]
            found[f"videos: jitter where {state}, % of mouth width"] = f"{ours:.2f} (MediaPipe {tools:.2f})"
    for name, words in {"closeups": "close-ups", "crops": "nose to chin"}.items():
        if name in rows:
            one = summary(rows[name])
            found[f"{words}: mouth found, %"] = f"{one['located_pct']:.1f}"
            found[f"{words}: median IoU, open"] = f"{one['iou_median']:.3f}"
            found[f"{words}: closed called open"] = f"{one['false_open']} of {one['closed']}"
            found[f"{words}: open called closed"] = f"{one['missed']} of {one['open']}"
    return found


# What is asked of the default method, and what MediaPipe reaches (the reference data's own account of it; on the hand
# frames scored here from its stored points).
TARGETS = {
    "stills: median IoU, open": (">= 0.70", "0.73 (dlib 0.69)"),
    "stills: mean height error, % of mouth width": ("<= 4", "2.5"),
    "stills: closed called open": ("<= 3 of 35", "0 of 35 (dlib 5)"),
    "stills: open called closed": ("<= 6 of 115", "-"),
    "points and hand: median IoU, open": (">= 0.68", "-"),
    "videos: correlation of height, median over clips": (">= 0.90", "is the reference"),
    "videos: open or closed as the tools, % of frames": (">= 92", "is the reference"),
    "videos: jitter where closed, % of mouth width": ("<= MediaPipe", "in brackets"),
    "videos: jitter where still, % of mouth width": ("<= MediaPipe", "in brackets"),
    "close-ups: mouth found, %": (">= 98", "7 (8 of 120)"),
    "nose to chin: mouth found, %": ("-", "73 (87 of 120)"),
}


def main_table(rows: dict[str, dict[str, pd.DataFrame]], parts: Iterable[str]) -> pd.DataFrame:
    """The main table: rows the figures, columns the target, MediaPipe and each method in each part."""
    columns = {}
    for method, sets in rows.items():
        for part in parts:
            columns[f"{method}, {part}"] = figures({name: of_part(each, part) for name, each in sets.items()})
    table = pd.DataFrame(columns)
    known = {name: TARGETS.get(name, ("-", "-")) for name in table.index}
    if any(name.startswith("hand: median") for name in known):
        stored = summary(_stored_mediapipe())
        known["hand: median IoU, open"] = ("-", f"{stored['iou_median']:.3f}")
        known["hand: mean height error, % of mouth width"] = ("-", f"{stored['height_error_pct']:.2f}")
        known["hand: closed called open"] = ("-", f"{stored['false_open']} of {stored['closed']}")
    table.insert(0, "target", [known[name][0] for name in table.index])
    table["MediaPipe, all"] = [known[name][1] for name in table.index]
    table.index.name = "figure"
    return table


def _stored_mediapipe() -> pd.DataFrame:
    return table(score(item, reference.stored_mediapipe(item)) for item in reference.items("hand", "all"))


def report(rows: dict[str, dict[str, pd.DataFrame]], part: str) -> str:
    """All tables as Markdown. rows: method -> set -> rows of pictures or frames."""
    parts = ("report", "tune", "all") if part == "all" else (part,)
    people = "`report` and `tune` are two halves without a person in common; settings were chosen on `tune`."
    text = f"## Accuracy\n\n{people}\n\n{markdown(main_table(rows, parts))}"
    for method, sets in rows.items():
        for name, each in sets.items():
            text += f"\n### {method}: {name}, {part}\n"
            if name == "videos":
                text += f"\n{markdown(clip_scores(each).drop(columns=['same', 'bends_closed', 'bends_still']))}"
                continue
            text += f"\n{markdown(by_height(each).rename_axis('true height, px'))}"
            if len(thirds := by_confidence(each)):
                text += f"\n{markdown(thirds.rename_axis('confidence'))}"
    return text


# --- command line


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--methods", nargs="+", default=["default", "thesis"])
    parser.add_argument("--part", choices=reference.PARTS, default="tune")
    parser.add_argument("--set", nargs="+", choices=SETS, default=list(SETS), dest="sets")
    parser.add_argument("--worst", nargs=2, metavar=("N", "FOLDER"), help="write a sheet of the worst N of each set")
    parser.add_argument("--write", action="store_true", help="put the tables into RESULTS.md")
    options = parser.parse_args()
    if reference.reference_folder() is None:
        parser.error("expected the reference data in LIPMETRICS_REFERENCE or ../shared/reference, found none")
    if options.write and (options.part != "all" or set(options.sets) != set(SETS)):
        parser.error("--write needs --part all and every set, so that RESULTS.md is never half of a run")

    rows = {}
    for method in options.methods:
        rows[method] = {}
        for name in options.sets:
            began = time.perf_counter()
            sheet = Path(options.worst[1]) / f"{method}_{name}_{options.part}.png" if options.worst else None
            rows[method][name] = _run(name, method, options.part, sheet, int(options.worst[0]) if sheet else 0)
            print(f"{method} on {name}: {time.perf_counter() - began:.0f} s", file=sys.stderr)
    text = report(rows, options.part)
    print(text)
    if options.write:
        write_section("accuracy", text)


def _run(name: str, method: str, part: str, sheet: Path | None, count: int) -> pd.DataFrame:
    if name == "videos":
        frames = evaluate_videos(clip_looks(method), part)
        if sheet:
            worst.draw_worst_clips(frames, count, sheet)
        return frames
    scored = run_set(name, method, part)
    if sheet:
        worst.write_worst(scored, count, sheet)
    return table(scored)


if __name__ == "__main__":
    main()
