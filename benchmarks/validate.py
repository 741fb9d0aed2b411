"""The detector against the simulator: a quick score while working on a method, and the tables that are printed.

    python benchmarks/validate.py --part tune --quick
    python benchmarks/validate.py --part tune --only "skin tone" beard "noise: 12 %"
    python benchmarks/validate.py --write -o out          # lipmetrics validate of both methods, kept in out

The quick score keeps its clips in LIPMETRICS_BENCHMARK_CACHE or a temporary folder, so that a second run only measures.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

import cv2
import pandas as pd
from results import markdown, write_section

from lipmetrics import cli
from lipmetrics.accuracy import load_truth
from lipmetrics.html_page import number
from lipmetrics.pipeline import measure
from lipmetrics.validation import by_condition, figures, score_frames
from lipmetrics.validation_page import SHORT
from lipmetrics.validation_verdict import HEIGHTS_PERCENT, VERDICTS, WIDTHS_PX, by_class, rule
from simulator.suite import kept_clips, suite

DOCS = Path(__file__).parents[1] / "docs"
PAGE, MARKS = DOCS / "validation.md", ("<!-- validate -->", "<!-- end -->")
METHODS = ("default", "thesis")
SHOWN = {
    "iou_median": "IoU",
    "iou_10th": "10th",
    "height_percent_median": "height %",
    "height_percent_bias": "bias",
    "width_percent_median": "width %",
    "count_right_percent": "count right",
    "several_right_percent": "several right",
    "missed_percent": "missed",
    "false_percent": "false",
    "onset_frames_median": "onset",
    "jitter_still_percent": "jitter",
    "found_percent": "found",
    "confidence_median": "confidence",
}


def clip_frames(clips, folder: Path, method: str = "default", settings=None) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Rows of `score_frames` of some clips with a column `clip`, and the table of the clips; missing ones are made."""
    rows, facts = [], []
    for clip, path in kept_clips(clips, folder):
        measured = measure(path, method=method, settings=settings, keep_outlines=True)
        rows.append(score_frames(measured, load_truth(path.with_suffix(""))).assign(clip=clip.name))
        of_clip = {name: getattr(clip, name) for name in ("axis", "setting", "condition")}
        facts.append({"clip": clip.name, "take": clip.take.name} | of_clip)
    order = {clip.name: number for number, clip in enumerate(clips)}
    return pd.concat(rows, ignore_index=True), pd.DataFrame(facts).sort_values("clip", key=lambda c: c.map(order))


def quick_score(part: str, quick: bool, only: list[str], method: str) -> None:
    """Print one line of figures per condition."""
    started = time.perf_counter()
    clips = suite(part, quick=quick, only=only)
    with tempfile.TemporaryDirectory() as passing:
        folder = Path(os.environ.get("LIPMETRICS_BENCHMARK_CACHE", passing)) / "suite"
        frames, facts = clip_frames(clips, folder, method)
    table = by_condition(frames, facts).set_index("condition")
    table.loc["all"] = figures(frames)
    with pd.option_context("display.width", 250, "display.max_columns", 99, "display.max_rows", 999):
        print(table[list(SHOWN)].rename(columns=SHOWN).round(2).to_string())
    print(f"{len(facts)} clips, {len(frames)} frames, {time.perf_counter() - started:.0f} s")


# -- the tables that are printed --------------------------------------------------------------------------------------


def goals(summaries: dict[str, dict]) -> str:
    """The goals as a Markdown table, the methods side by side."""
    said = {True: "met", False: "not met", None: "-"}
    rows = {}
    for method, summary in summaries.items():
        for row in summary["targets"]:
            of_goal = rows.setdefault(row["what"], {"goal": row["goal"]})
            of_goal |= {f"{method}, all": row["all"], f"{method}, mix": row["mix"], f"{method}": said[row["met"]]}
    return markdown(pd.DataFrame.from_dict(rows, orient="index").fillna("-"))


def trust(conditions: pd.DataFrame) -> str:
    """The settings of each axis by verdict, as a Markdown table."""
    rows = {}
    for axis, of_axis in conditions.groupby("axis", sort=False):
        named = {v: ", ".join(of_axis.loc[of_axis["verdict"] == v, "setting"]) or "-" for v in VERDICTS}
        rows[axis] = named
    return markdown(pd.DataFrame.from_dict(rows, orient="index").rename_axis("condition"))


def shown(table: pd.DataFrame, index: str, columns: dict[str, str]) -> str:
    """Some figures as a Markdown table."""
    texts = {title: [number(float(value)) for value in table[name]] for name, title in columns.items()}
    return markdown(pd.DataFrame(texts, index=pd.Index(table[index], name=index)))


def run(folder: Path) -> None:
    """Both methods on the part `report`."""
    for method in METHODS:
        if cli.main(["validate", "-o", str(folder), "--method", method]) not in (cli.DONE, cli.SOME_FAILED):
            raise SystemExit(f"lipmetrics validate --method {method} failed")


def write(folder: Path) -> None:
    """Write the section of RESULTS.md, the tables and figures of docs/ from the reports in a folder."""
    places = {"default": folder} | {method: folder / method for method in METHODS[1:]}
    places = {method: place for method, place in places.items() if (place / "summary.json").exists()}
    summaries = {m: json.loads((place / "summary.json").read_text(encoding="utf-8")) for m, place in places.items()}
    tables = {m: pd.read_csv(place / "conditions.csv") for m, place in places.items()}
    conditions, frames = tables["default"], pd.read_csv(folder / "frames.csv")
    columns = dict(SHORT)
    for method in [one for one in tables if one != "default"]:
        conditions[method] = conditions["condition"].map(tables[method].set_index("condition")["iou_median"])
        columns[method] = f"{method}'s IoU"
    usual = summaries["default"]
    by_height = by_class(frames, 100 * frames["true_height_px"] / frames["mouth_px"], HEIGHTS_PERCENT, "height, %")
    in_classes = {"frames": "frames"} | {n: t for n, t in SHORT.items() if not n.startswith(("onset", "jitter", "fal"))}
    confidence = pd.DataFrame(usual["confidence"])
    of_confidence = {"frames": "frames", "bad_percent": "bad frames %", "iou_median": "IoU"}
    table = shown(conditions, "condition", columns)
    numbers = {m: [str((rows["verdict"] == one).sum()) for one in VERDICTS] for m, rows in tables.items()}
    trusted = ", ".join(f"{method} {' / '.join(of_method)}" for method, of_method in numbers.items())
    text = [
        "## The detector against the simulator",
        "",
        f"`python benchmarks/validate.py --write`: {usual['clips']} clips, {usual['frames']} frames of part `report`.",
        "",
        goals(summaries),
        f"Conditions {' / '.join(VERDICTS)}: {trusted}.",
        "",
        "Of the default method, sizes in % of the mouth's width, medians:",
        "",
        table,
        "By the width of the mouth in the picture, px:",
        "",
        shown(by_class(frames, frames["mouth_px"], WIDTHS_PX, "width, px"), "width, px", in_classes),
        "By the true height of the largest opening, % of the mouth's width:",
        "",
        shown(by_height, "height, %", in_classes),
        "By confidence:",
        "",
        shown(confidence, "confidence", of_confidence | {"height_percent_median": "height error %"}),
    ]
    write_section("validate", "\n".join(text))
    page = PAGE.read_text(encoding="utf-8")
    before, rest = page.split(MARKS[0], 1)
    after = rest.split(MARKS[1], 1)[1]
    inside = [goals(summaries), *(f"- {line}" for line in rule()), "", trust(conditions)]
    PAGE.write_text(f"{before}{MARKS[0]}\n\n" + "\n".join(inside) + f"\n{MARKS[1]}{after}", encoding="utf-8")
    drawn = cv2.imread(str(folder / "worst.png"))
    cv2.imwrite(str(DOCS / "figures" / "validate_worst.jpg"), drawn, [cv2.IMWRITE_JPEG_QUALITY, 85])
    (DOCS / "figures" / "validate_height_error.png").write_bytes((folder / "height_error.png").read_bytes())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", default="tune")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="*", default=())
    parser.add_argument("--method", default="default")
    parser.add_argument("--write", action="store_true", help="the whole of part report, into RESULTS.md and docs/")
    parser.add_argument("--again", action="store_true", help="from the reports that are in -o, without a run")
    parser.add_argument("-o", "--out", default="lipmetrics-validate", help="folder of clips and reports for --write")
    arguments = parser.parse_args()
    if arguments.write:
        if not arguments.again:
            run(Path(arguments.out))
        write(Path(arguments.out))
    else:
        quick_score(arguments.part, arguments.quick, arguments.only, arguments.method)


if __name__ == "__main__":
    main()
