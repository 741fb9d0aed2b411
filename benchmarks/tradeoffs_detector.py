"""The detector's run time against its error: size of the picture, filters, every n-th frame, the method.

- Simulated clips of the suite's part `tune`, whose openings are known: mean error of the largest opening's height over
  all frames, and the part of the openings' area that is not covered (1 - IoU, mean over the frames that are open).
- Reference clips and stills of the half `tune`, where they are there: correlation with the landmark tools' height.

Every n-th frame: heights between are on straight lines, outlines are the last ones. Smaller pictures: the clip is
written anew at that size, outlines are scaled back; shrinking is not in the time.
"""

from __future__ import annotations

import dataclasses
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import accuracy
import cv2
import findings
import numpy as np
import pandas as pd
import reference
from results import markdown
from timing import relative
from tradeoff_figure import Panel, Point, draw

from lipmetrics.accuracy import load_truth, overlap
from lipmetrics.detect import make_detector
from lipmetrics.frames import open_frames
from lipmetrics.look import NO_MOUTH, OPEN, Look
from lipmetrics.openings import measure_outline
from lipmetrics.validation import CLEAR_MW, CLEAR_PX
from simulator.suite import kept_clips, suite
from simulator.video import write_video

FIGURE = findings.FIGURES / "tradeoff_detector.png"


@dataclass(frozen=True)
class Setting:
    """method, changes : and what differs from its own settings; every : n of every n-th frame; scale : of the picture;
    drawn : in the figure, too, not only in the table"""

    method: str = "default"
    changes: dict[str, object] = field(default_factory=dict)
    every: int = 1
    scale: float = 1.0
    drawn: bool = True

    def detector(self, info):
        """A new one for a clip."""
        own = make_detector(self.method, None, info).settings
        return make_detector(self.method, dataclasses.replace(own, **self.changes), info)


def _table_only(**changes: object) -> Setting:
    return Setting(changes=changes, drawn=False)


DEFAULT = "default"
SETTINGS: dict[str, Setting] = {
    DEFAULT: Setting(),
    "every 2nd frame": Setting(every=2),
    "every 3rd frame": Setting(every=3),
    "every 5th frame": Setting(every=5),
    "picture at 1/2": Setting(scale=0.5),
    "picture at 1/4": Setting(scale=0.25),
    "keeps 0 of the frame before": Setting(changes={"steady": 0.0}),
    "keeps 0.8 of the frame before": Setting(changes={"steady": 0.8}),
    "canvas follows half of 0.03 mw": _table_only(move_mw=0.03),
    "canvas follows half of 0.12 mw": _table_only(move_mw=0.12),
    "open above evidence 5": _table_only(sure_above=5.0),
    "open above evidence 20": _table_only(sure_above=20.0),
    "leans by 0 towards open": _table_only(lean=0.0),
    "leans by 0.8 towards open": _table_only(lean=0.8),
    "thesis": Setting("thesis"),
    "thesis, every 2nd frame": Setting("thesis", every=2),
    "thesis, every 3rd frame": Setting("thesis", every=3, drawn=False),
    "thesis, picture at 1/2": Setting("thesis", scale=0.5),
    "thesis, median of 1 px": Setting("thesis", {"median_px": 1}),
    "thesis, median of 3 px": Setting("thesis", {"median_px": 3}, drawn=False),
    "thesis, median of 9 px": Setting("thesis", {"median_px": 9}),
    "thesis, correlated by 'and'": Setting("thesis", {"correlation": "and"}, drawn=False),
    "thesis, correlated by 'mean'": Setting("thesis", {"correlation": "mean"}, drawn=False),
}
MIXED = 8  # clips of the suite in which everything varies, besides the plain ones
REAL_CLIPS = ("lp_d0", "lp_d18", "lia_driving2", "grid_pwij3p", "sty_vscode", "vox_00473")
REAL_S = 2.0  # of each are timed
CRF = 10  # of clips written at another size


# -- looking ----------------------------------------------------------------------------------------------------------


def timed_looks(setting: Setting, path: Path, stop_s: float | None = None) -> Iterator[tuple[Look, float]]:
    """Of every frame of a clip what the method says, and the time of finding and measuring, decoding left out, s.

    It is shown every n-th frame only; its last word stands for the frames between, which take no time.
    """
    with open_frames(path, stop_s=stop_s) as frames:
        detector = setting.detector(frames.info)
        for frame in frames:
            taken = 0.0
            if frame.index % setting.every == 0:
                began = time.thread_time()
                look = detector.look(frame)
                for outline in look.outlines:
                    measure_outline(outline)
                taken = time.thread_time() - began
            yield look, taken


def scaled_back(look: Look, ratio: np.ndarray) -> Look:
    """What was seen in a picture whose rows and columns are `ratio` (2,) times as many, in that of the clip."""

    def back(points: np.ndarray) -> np.ndarray:
        return (points + 0.5) / ratio - 0.5

    return dataclasses.replace(look, outlines=[back(one) for one in look.outlines], corners=back(look.corners))


def size_of(path: Path) -> np.ndarray:
    """(rows, columns) of a clip's pictures."""
    with open_frames(path) as frames:
        return np.array([frames.info.height, frames.info.width], float)


def shrunk_copy(path: Path, scale: float, folder: Path) -> Path:
    """The clip itself, or one with smaller pictures in the folder, made if it is not there."""
    if scale == 1.0:
        return path
    copy = folder / f"{path.stem}_{scale:g}.mp4"
    if not copy.exists():
        with open_frames(path) as frames:
            width, height = (max(2, 2 * round(scale * side / 2)) for side in (frames.info.width, frames.info.height))
            small = (cv2.resize(frame.rgb(), (width, height), interpolation=cv2.INTER_AREA) for frame in frames)
            write_video(copy, small, frames.info.nominal_fps, "h264", crf=CRF, threads=1)
    return copy


def looks_of(setting: Setting, folder: Path) -> Callable[[Path], Iterator[Look]]:
    """A function from a clip to one Look per frame of it; smaller copies are kept in the folder."""

    def looks(path: Path) -> Iterator[Look]:
        copy = shrunk_copy(path, setting.scale, folder)
        ratio = size_of(copy) / size_of(path)
        for look, _ in timed_looks(setting, copy):
            yield look if setting.scale == 1.0 else scaled_back(look, ratio)

    return looks


def relative_times(
    settings: dict[str, Setting], clips: Sequence[Path], folder: Path, repeats: int, stop_s: float | None = None
) -> dict[str, float]:
    """Processor time per frame of the clips after the first frame, as multiples of the default's, best of `repeats`."""
    best = {name: [np.inf] * len(clips) for name in settings}
    for _ in range(repeats):
        for number, path in enumerate(clips):
            for name, setting in settings.items():
                copy = shrunk_copy(path, setting.scale, folder)
                taken = [seconds for _, seconds in timed_looks(setting, copy, stop_s)][1:]
                best[name][number] = min(best[name][number], sum(taken))
    return relative({name: sum(each) for name, each in best.items()}, DEFAULT)


def thin_out(frames: pd.DataFrame, every: int) -> pd.DataFrame:
    """The profile where only every n-th frame was measured: heights between are on straight lines."""
    if every == 1:
        return frames

    def fill_in(rows: pd.DataFrame) -> pd.Series:
        known = rows["height_px"].where(rows["frame"] % every == 0).notna()
        if not known.any():
            return rows["height_px"] * np.nan
        heights = np.interp(rows["frame"], rows.loc[known, "frame"], rows.loc[known, "height_px"])
        return pd.Series(heights, rows.index)

    parts = [fill_in(rows) for _, rows in frames.groupby("clip", sort=False)]
    return frames.assign(height_px=pd.concat(parts))


# -- simulated clips --------------------------------------------------------------------------------------------------


def simulated_clips(folder: Path, plain: int, mixed: int) -> list[Path]:
    """Videos of the suite's part `tune`, with their truths beside them; what is there already is not made anew."""
    chosen = [*suite("tune", only=["plain"])[:plain], *suite("tune", only=["mix"])[:mixed]]
    return [path for _, path in kept_clips(chosen, folder)]


def simulated_errors(path: Path, looks: Sequence[Look], every: int = 1) -> pd.DataFrame:
    """One row per frame: error of the largest opening's height, % of the mouth width, and the part of the area, %, that
    measured and true openings do not share, NaN where the mouth is not clearly open. Without a mouth, nothing is open.
    """
    truth = load_truth(path.with_suffix(""))
    mouth_px = float(truth.meta["mouth_width_px"])
    true = truth.frames["height_px"].to_numpy(float, na_value=0.0)
    if len(looks) != len(true):
        raise ValueError(f"expected {len(true)} frames as the truth has, got {len(looks)}")
    rows = pd.DataFrame({"clip": path.stem, "frame": range(len(looks)), "height_px": [_height_px(x) for x in looks]})
    height = thin_out(rows, every)["height_px"].fillna(0.0).to_numpy()
    lost = [
        100 * (1 - overlap(look.outlines if look.status == OPEN else [], outlines))
        if at >= max(CLEAR_MW * mouth_px, CLEAR_PX)
        else np.nan
        for look, outlines, at in zip(looks, truth.outlines, true, strict=True)
    ]
    found = [look.status != NO_MOUTH for look in looks]
    return pd.DataFrame(
        {"height_percent": 100 * np.abs(height - true) / mouth_px, "lost_percent": lost, "found": found}
    )


def _height_px(look: Look) -> float:
    """Of the largest opening; NaN without a mouth."""
    if look.status == NO_MOUTH:
        return np.nan
    openings = [measure_outline(outline) for outline in look.outlines] if look.status == OPEN else []
    return max(openings, key=lambda one: one.area_px).height_px if openings else 0.0


def simulated_table(folder: Path, repeats: int, plain: int = 6, mixed: int = MIXED) -> pd.DataFrame:
    """A row for each setting, on simulated clips."""
    clips = simulated_clips(folder, plain, mixed)
    times = relative_times(SETTINGS, clips, folder, repeats)
    rows = {}
    for name, setting in SETTINGS.items():
        looks = looks_of(setting, folder)
        errors = pd.concat([simulated_errors(path, list(looks(path)), setting.every) for path in clips])
        rows[name] = {
            "time, default = 1": times[name],
            "height error, mean, %": errors["height_percent"].mean(),
            "height error, 95th percentile, %": errors["height_percent"].quantile(0.95),
            "1 - IoU, mean, %": errors["lost_percent"].mean(),
            "1 - IoU, median, %": errors["lost_percent"].median(),
            "mouth found, %": 100 * errors["found"].mean(),
        }
    return pd.DataFrame(rows).T.rename_axis(f"{len(clips)} simulated clips, {len(errors)} frames")


# -- reference data ---------------------------------------------------------------------------------------------------


def real_table(folder: Path, repeats: int, clips: Sequence[str] = REAL_CLIPS, stills: bool = True) -> pd.DataFrame:
    """A row for each setting, on the half `tune` of the reference data."""
    times = relative_times(SETTINGS, [reference.video_file(one) for one in clips], folder, repeats, REAL_S)
    rows = {}
    for name, setting in SETTINGS.items():
        frames = accuracy.evaluate_videos(looks_of(setting, folder), "tune", clips)
        video = accuracy.video_summary(accuracy.clip_scores(thin_out(frames, setting.every)))
        row = rows[name] = {
            "time, default = 1": times[name],
            "videos: correlation": video["correlation_median"],
            "videos: agreement, %": video["agreement_pct"],
            "videos: jitter where still, %": video["jitter_still_pct"],
        }
        if stills and setting.every == 1 and setting.scale == 1.0:
            own = dataclasses.replace(make_detector(setting.method, None, None).settings, **setting.changes)
            one = accuracy.still_looks(setting.method, own)
            one = accuracy.summary(accuracy.table(accuracy.evaluate_stills(one, "tune")))
            row |= {"stills: IoU": one["iou_median"], "stills: height error, %": one["height_error_pct"]}
            row |= {"stills: wrong open or closed": one["false_open"] + one["missed"]}
    return pd.DataFrame(rows).T.rename_axis(f"{len(clips)} reference clips, landmark tools' height")


# -- tables and figure ------------------------------------------------------------------------------------------------


def tables(repeats: int, plain: int = 6, mixed: int = MIXED, real: bool = True) -> str:
    """Both tables, where there are reference data, and the figure."""
    with tempfile.TemporaryDirectory() as passing:
        folder = Path(os.environ.get("LIPMETRICS_BENCHMARK_CACHE", passing)) / "tradeoffs"
        folder.mkdir(parents=True, exist_ok=True)
        simulated = simulated_table(folder, repeats, plain, mixed)
        text = (
            "Finding and measuring, decoding left out, processor time; what the errors are of stands at the head of\n"
        )
        text += "`tradeoffs_detector.py`. Figure: docs/figures/tradeoff_detector.png.\n\n" + markdown(simulated)
        of_real = None
        if real and reference.reference_folder() is not None:
            of_real = real_table(folder, repeats)
            text += "\n" + markdown(of_real, 3)
        else:
            text += "\nNo reference data were there.\n"
    figure(simulated, of_real)
    return text


def figure(simulated: pd.DataFrame, real: pd.DataFrame | None) -> None:
    """Draw the tables' rows that are `drawn`."""

    def panel(table: pd.DataFrame, title: str, label: str, errors: pd.Series) -> Panel:
        points = [
            Point(
                short(name),
                table.loc[name, "time, default = 1"],
                errors[name],
                name == DEFAULT,
                f"method {setting.method}",
            )
            for name, setting in SETTINGS.items()
            if setting.drawn and np.isfinite(errors[name])
        ]
        return Panel(title, label, points)

    title = "simulated clips, part tune"
    panels = [
        panel(simulated, title, "error of the height, mean, % of the mouth width", simulated["height error, mean, %"]),
        panel(simulated, title, "1 - IoU of the openings, mean, %", simulated["1 - IoU, mean, %"]),
    ]
    if real is not None:
        label = "1 - correlation with the landmark tools' height"
        panels.append(panel(real, "reference clips, half tune", label, 1 - real["videos: correlation"]))
    draw(panels, FIGURE, "Detector: run time against error", "processor time per frame, default = 1")


def short(name: str) -> str:
    """A setting's name without the method, which its colour tells."""
    return name.removeprefix("thesis, ").removesuffix(" of the frame before")
