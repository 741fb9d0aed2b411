"""A quick score of a method on the simulated suite while working on it; `lipmetrics validate` is the whole.

    python benchmarks/validate.py --part tune --quick
    python benchmarks/validate.py --part tune --only "skin tone" beard "noise: 12 %"

Clips are kept in LIPMETRICS_BENCHMARK_CACHE or a temporary folder, so that a second run only measures.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

import pandas as pd

from lipmetrics.accuracy import load_truth
from lipmetrics.pipeline import measure
from lipmetrics.validation import by_condition, figures, score_frames
from simulator.suite import by_take, solve_take, suite, write_clip

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
    folder.mkdir(parents=True, exist_ok=True)
    rows, facts = [], []
    for take, of_take in by_take(clips).items():
        solved = None
        for clip in of_take:
            path = folder / f"{clip.fingerprint}.mp4"
            if not path.exists():
                solved = solved or solve_take(take)
                if solved.motion is None:
                    print(f"{clip.name}: dropped, {solved.dropped}")
                    continue
                write_clip(clip, solved, folder, clip.fingerprint)
            measured = measure(path, method=method, settings=settings, keep_outlines=True)
            rows.append(score_frames(measured, load_truth(folder / clip.fingerprint)).assign(clip=clip.name))
            facts.append(
                {
                    "clip": clip.name,
                    "axis": clip.axis,
                    "setting": clip.setting,
                    "condition": clip.condition,
                    "take": clip.take.name,
                }
            )
    order = {clip.name: number for number, clip in enumerate(clips)}
    return pd.concat(rows, ignore_index=True), pd.DataFrame(facts).sort_values("clip", key=lambda c: c.map(order))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", default="tune")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="*", default=())
    parser.add_argument("--method", default="default")
    arguments = parser.parse_args()
    started = time.perf_counter()
    clips = suite(arguments.part, quick=arguments.quick, only=arguments.only)
    with tempfile.TemporaryDirectory() as passing:
        folder = Path(os.environ.get("LIPMETRICS_BENCHMARK_CACHE", passing)) / "suite"
        frames, facts = clip_frames(clips, folder, arguments.method)
    table = by_condition(frames, facts).set_index("condition")
    table.loc["all"] = figures(frames)
    with pd.option_context("display.width", 250, "display.max_columns", 99, "display.max_rows", 999):
        print(table[list(SHOWN)].rename(columns=SHOWN).round(2).to_string())
    print(f"{len(facts)} clips, {len(frames)} frames, {time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
