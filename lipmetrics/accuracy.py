"""How far a measured profile is from the truth of the same clip, and the truth's files of a simulated clip.

Frames are matched by their times. Lengths are compared in % of the true width of the mouth at rest, areas in % of its
square.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import cv2
import numpy as np

from lipmetrics.errors import InputError
from lipmetrics.look import CLOSED, OPEN
from lipmetrics.profile import Profile, load_profile

SIZES = {"width": "width_px", "height": "height_px", "area": "area_px"}
_FINER = 4  # sub-pixels along each axis when outlines are laid over one another


def load_truth(path: str | Path) -> Profile:
    """A simulated clip's truth with its outlines, from `<path>.frames.csv`, `.openings.csv`, `.json`, `.polygons.json`.

    Raises
    ------
    InputError : a file is missing or is not of a truth, or its outlines are not those of its tables
    """
    truth = load_profile(path)
    polygons = Path(f"{path}.polygons.json")
    try:
        frames = json.loads(polygons.read_text(encoding="utf-8"))["frames"]
        outlines = [[np.array(each["outline"], float) for each in frame["openings"]] for frame in frames]
        fits = all(outline.ndim == 2 and outline.shape[1] == 2 for frame in outlines for outline in frame)
    except (OSError, ValueError, KeyError, TypeError, RecursionError, OverflowError) as error:
        raise InputError(f"expected {polygons} to be outlines that the simulator wrote, but: {error}") from None
    counts = truth.frames["n_openings"].to_numpy(float, na_value=0)
    if not fits or len(outlines) != len(counts) or (counts != [len(frame) for frame in outlines]).any():
        raise InputError(f"expected {polygons} to hold the outlines of the tables beside it, got others; simulate anew")
    truth.outlines = outlines
    return truth


def pair_frames(measured_s: np.ndarray, truth_s: np.ndarray) -> np.ndarray:
    """(P, 2) positions of frames of the same moment in two ascending lists of times, s: measured, true.

    Each is the other's nearest, at most half a true frame away; frames without a partner are left out.
    """
    if len(measured_s) == 0 or len(truth_s) == 0:
        return np.empty((0, 2), int)
    apart = np.abs(measured_s[:, None] - truth_s[None])
    nearest, back = apart.argmin(axis=1), apart.argmin(axis=0)
    here = np.arange(len(measured_s))
    close = apart[here, nearest] <= 0.5 * _step_s(truth_s) + 1e-9
    kept = close & (back[nearest] == here)
    return np.column_stack([here[kept], nearest[kept]])


def compare(measured: Profile, truth: Profile) -> dict:
    """What a measured profile has right and how far off it is.

    Sizes are those of the largest opening, in frames that both see open; shares are of the frames in both profiles.
    What cannot be told is NaN.

    Parameters
    ----------
    measured, truth : of one clip; where both hold outlines, these are laid over one another
    """
    pairs = pair_frames(measured.frames["time_s"].to_numpy(float), truth.frames["time_s"].to_numpy(float))
    a, b = measured.frames.iloc[pairs[:, 0]], truth.frames.iloc[pairs[:, 1]]
    seen, really = (table["status"].to_numpy() == OPEN for table in (a, b))
    time_s, both = b["time_s"].to_numpy(float), seen & really
    mouth_px = float(truth.meta["mouth_width_px"])
    number, true_number = (table["n_openings"].to_numpy(float, na_value=np.nan) for table in (a, b))
    several = true_number > 1
    missed = really & (a["status"].to_numpy() == CLOSED)
    report = {
        "frames": len(pairs),
        "frames_without_partner": len(measured.frames) + len(truth.frames) - 2 * len(pairs),
        "frames_open": int(really.sum()),
        "frames_measured_open": int(seen.sum()),
        "frames_without_mouth": int((~a["status"].isin([OPEN, CLOSED])).sum()),
        "frames_with_several_openings": int(several.sum()),
        "open_or_closed_right_percent": _share(a["status"].to_numpy() == b["status"].to_numpy()),
        "number_of_openings_right_percent": _share(number == true_number),
        "several_openings_right_percent": _share((number == true_number)[several]),
        "highest_missed_px": _largest(b["height_px"].to_numpy(float)[missed]),
        "highest_invented_px": _largest(a["height_px"].to_numpy(float)[seen & ~really]),
    }
    for name, column in SIZES.items():
        unit = mouth_px ** (2 if name == "area" else 1)
        off = 100 * (a[column].to_numpy(float) - b[column].to_numpy(float))[both] / unit
        report[name] = _summary(off, time_s[both])
    report["overlap_percent"] = _overlaps(measured, truth, pairs[both])
    step_s = _step_s(truth.frames["time_s"].to_numpy(float))
    for name, moment in (("opens", _first_open_s), ("closes", _last_open_s), ("merges", _merge_s)):
        report[name] = _moment(moment(measured), moment(truth), step_s)
    report["mouth_width_px"] = float(measured.meta["mouth_width_px"])
    report["true_mouth_width_px"] = mouth_px
    report["mouth_width_off_percent"] = 100 * (report["mouth_width_px"] / mouth_px - 1)
    return report


def describe(report: dict) -> list[str]:
    """The comparison in words, one line each."""
    opens, merges = report["opens"], report["merges"]
    lines = [
        f"{report['frames']} frames, {report['frames_open']} of them open, "
        f"{report['frames_with_several_openings']} with several openings",
        f"opening height is off by {report['height']['mean_percent']:.1f} % of the mouth width on average, "
        f"its width by {report['width']['mean_percent']:.1f} %",
        f"open or closed is right in {report['open_or_closed_right_percent']:.0f} % of the frames, "
        f"the number of openings in {report['number_of_openings_right_percent']:.0f} %",
        f"the mouth opens at {opens['true_s']:.3f} s, {_late(opens)}",
    ]
    if math.isfinite(merges["true_s"]):
        lines.append(f"openings merge at {merges['true_s']:.3f} s, {_late(merges)}")
    lines.append(f"mouth width {report['mouth_width_px']:.1f} px, truly {report['true_mouth_width_px']:.1f} px")
    return lines


def _late(moment: dict) -> str:
    if not math.isfinite(moment["off_ms"]):
        return "which is not seen"
    frames = round(moment["off_frames"])
    if frames == 0:
        return "seen in that frame"
    word = "frame" if abs(frames) == 1 else "frames"
    return f"seen {abs(frames)} {word} {'later' if frames > 0 else 'earlier'}"


def _summary(off: np.ndarray, time_s: np.ndarray) -> dict:
    if len(off) == 0:
        return dict.fromkeys(("mean_percent", "bias_percent", "largest_percent", "largest_at_s"), math.nan)
    worst = int(np.abs(off).argmax())
    return {
        "mean_percent": float(np.abs(off).mean()),
        "bias_percent": float(off.mean()),
        "largest_percent": float(abs(off[worst])),
        "largest_at_s": float(time_s[worst]),
    }


def _overlaps(measured: Profile, truth: Profile, pairs: np.ndarray) -> dict:
    known = len(measured.outlines) == len(measured.frames) and len(truth.outlines) == len(truth.frames)
    shares = [100 * overlap(measured.outlines[i], truth.outlines[j]) for i, j in pairs] if known else []
    if not shares:
        return {"median": math.nan, "least": math.nan}
    return {"median": float(np.median(shares)), "least": float(min(shares))}


def overlap(outlines: list[np.ndarray], others: list[np.ndarray]) -> float:
    """Intersection over union of two sets of polygons, (n, 2) (row, column) px each, to a quarter of a pixel; NaN
    where there are none."""
    points = np.concatenate([np.empty((0, 2)), *outlines, *others])
    if len(points) == 0:
        return math.nan
    low = np.floor(points.min(axis=0)) - 1
    shape = tuple(((np.ceil(points.max(axis=0)) + 2 - low) * _FINER).astype(int))
    one, other = (_filled(each, low, shape) for each in (outlines, others))
    either = np.count_nonzero(one | other)
    return np.count_nonzero(one & other) / either if either else math.nan


def _filled(outlines: list[np.ndarray], low: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    mask = np.zeros(shape, np.uint8)
    for outline in outlines:
        corners = ((outline - low + 0.5) * _FINER - 0.5)[:, ::-1]
        cv2.fillPoly(mask, [np.round(corners * 16).astype(np.int32)], 1, cv2.LINE_8, 4)
    return mask.astype(bool)


def _moment(measured_s: float | list[float], true_s: float | list[float], step_s: float) -> dict:
    """Of several true moments the first, and what was measured nearest to it."""
    if isinstance(true_s, list):
        true_s = true_s[0] if true_s else math.nan
        measured_s = min(measured_s, key=lambda s: abs(s - true_s), default=math.nan)
    off_ms, off_frames = 1000 * (measured_s - true_s), (measured_s - true_s) / step_s
    rounded = {"off_ms": round(off_ms, 2) + 0.0, "off_frames": round(off_frames, 2) + 0.0}  # the tables' times are
    return {"true_s": true_s, "measured_s": measured_s, **rounded}


def _first_open_s(profile: Profile) -> float:
    return _edge_s(profile, 0)


def _last_open_s(profile: Profile) -> float:
    return _edge_s(profile, -1)


def _edge_s(profile: Profile, which: int) -> float:
    times = profile.frames.loc[profile.frames["status"] == OPEN, "time_s"]
    return float(times.iloc[which]) if len(times) else math.nan


def _merge_s(profile: Profile) -> list[float]:
    openings = profile.openings
    return [float(s) for s in openings.loc[openings["event"] == "merge", "time_s"].drop_duplicates()]


def _step_s(time_s: np.ndarray) -> float:
    return float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0


def _share(right: np.ndarray) -> float:
    return float(100 * np.mean(right)) if len(right) else math.nan


def _largest(values: np.ndarray) -> float:
    return float(values.max(initial=0.0))
