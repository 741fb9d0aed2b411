"""What happens in a truth, as single numbers: when the mouth opens, how far, and where."""

from __future__ import annotations

import math

import numpy as np

from simulator.errors import InputError
from simulator.truth import Truth
from simulator.wording import choices

SIZES = ("width_mw", "height_mw", "area_mw2")


def spells_s(truth: Truth) -> list[tuple[float, float]]:
    """Times the mouth is open without a break: the first and the last open frame of each, s."""
    is_open = (truth.frames["status"] == "open").to_numpy()
    time_s = truth.frames["time_s"].to_numpy()
    step = np.diff(is_open.astype(int), prepend=0, append=0)
    starts, stops = np.flatnonzero(step == 1), np.flatnonzero(step == -1) - 1
    return [(float(time_s[a]), float(time_s[b])) for a, b in zip(starts, stops, strict=True)]


def onset_s(truth: Truth) -> float:
    """Time of the first open frame, s; NaN where the mouth never opens."""
    spells = spells_s(truth)
    return spells[0][0] if spells else math.nan


def merges_s(truth: Truth) -> list[float]:
    """Times of the frames in which openings have merged, s."""
    merged = truth.openings["event"] == "merge"
    return truth.openings.loc[merged, "time_s"].drop_duplicates().tolist()


def reached_s(truth: Truth, share: float = 0.9, size: str = "width_mw") -> float:
    """Time when a size of the largest opening first is `share` of that in the last frame, s, linear between frames.

    NaN where the last frame is closed.

    Raises
    ------
    InputError : an unknown size, or a share that is not between 0 and 1
    """
    if not 0 < share <= 1:
        raise InputError(f"expected a share above 0 and up to 1, got {share}")
    values, time_s = _values(truth, size), truth.frames["time_s"].to_numpy()
    if len(values) == 0 or values[-1] == 0:
        return math.nan
    wanted = share * values[-1]
    at = int(np.argmax(values >= wanted))
    if at == 0:
        return float(time_s[0])
    part = (wanted - values[at - 1]) / (values[at] - values[at - 1])
    return float(time_s[at - 1] + part * (time_s[at] - time_s[at - 1]))


def peak_over_settled(truth: Truth, size: str = "height_mw") -> float:
    """The largest value of a size over that in the last frame; NaN where the last frame is closed.

    Raises
    ------
    InputError : an unknown size
    """
    values = _values(truth, size)
    return float(values.max() / values[-1]) if len(values) and values[-1] > 0 else math.nan


def corners_mw(truth: Truth) -> np.ndarray:
    """(T, 2) left and right end of the largest opening along the mouth, in mouth widths from the middle; NaN if closed.

    The middle is half-way between the corners of the mouth at rest, which lie at -0.5 and 0.5; where the head is tilted
    the ends are taken along the line from corner to corner.
    """
    ends = np.full((len(truth.polygons), 2), np.nan)
    along = truth.corners[1] - truth.corners[0]
    middle = truth.corners.mean(axis=0)
    sizes = iter(truth.openings["area_px"].tolist())
    for frame, polygons in enumerate(truth.polygons):
        areas = [next(sizes) for _ in polygons]
        if areas:
            place = (polygons[areas.index(max(areas))] - middle) @ along / (along @ along)
            ends[frame] = place.min(), place.max()
    return ends


def centre_offset_mw(truth: Truth, time_s: float | None = None) -> float:
    """How far right of the mouth's middle the middle between the ends of the largest opening is, in mouth widths.

    Parameters
    ----------
    time_s : takes the frame nearest to it; None takes the last open frame. NaN where that is closed
    """
    middle = corners_mw(truth).mean(axis=1)
    if time_s is not None and len(middle):
        return float(middle[np.argmin(np.abs(truth.frames["time_s"].to_numpy() - time_s))])
    known = middle[np.isfinite(middle)]
    return float(known[-1]) if len(known) else math.nan


def _values(truth: Truth, size: str) -> np.ndarray:
    if size not in SIZES:
        raise InputError(f"expected a size of {choices(SIZES)}, got {size!r}")
    return truth.frames[size].to_numpy()
