"""Distances between two takes as curves: Hausdorff, and L2 with and without alignment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lipmetrics.compare import kernels
from lipmetrics.compare.alignment import Alignment, align, from_start
from lipmetrics.compare.curves import CHANNELS, Curve, as_values, check_rate, even, nearest_name
from lipmetrics.compare.warping import BAND, COST
from lipmetrics.errors import InputError

SECONDS_PER_UNIT = 1.0  # one second of time weighs as much as one unit of value (one mouth width)


@dataclass(frozen=True)
class Hausdorff:
    """Hausdorff distance of two curves as points (time / seconds_per_unit, values), in the unit of the values.

    value : the larger of both directions
    a_to_b : the largest distance from a point of a to its nearest of b; b_to_a likewise
    seconds_per_unit : how many seconds count as one unit of value
    aligned : whether the curves were aligned first
    """

    value: float
    a_to_b: float
    b_to_a: float
    seconds_per_unit: float
    aligned: bool
    unit: str


@dataclass(frozen=True)
class L2:
    """Root mean square difference of two takes, in the unit of the values.

    value : over all samples compared and all channels
    channels : of each channel by itself
    samples : number of moments compared
    """

    value: float
    channels: dict[str, float]
    samples: int
    aligned: bool
    unit: str


def hausdorff(
    a,
    b,
    *,
    channels: Sequence[str] = CHANNELS,
    seconds_per_unit: float = SECONDS_PER_UNIT,
    aligned: bool = True,
    rate_hz: float | None = None,
    cost: str = COST,
    band: float | None = BAND,
    clock: str = "shared",
    mixed_units: bool = False,
) -> Hausdorff:
    """Hausdorff distance of two takes, after alignment (thesis 5.3.2) or as they are.

    Aligned, each pair (i, j) of the path puts both curves' values at the mean of both times, so that the result is the
    same with a and b exchanged; lateness is then not in it (see `Alignment.lag_s`). Not aligned, each curve keeps its
    own times.

    Raises
    ------
    InputError : see `align`; seconds_per_unit not above 0
    """
    scale = 1.0 / check_seconds(seconds_per_unit)
    if aligned:
        match = align(
            *(a, b), channels=channels, rate_hz=rate_hz, cost=cost, band=band, clock=clock, mixed_units=mixed_units
        )
        return aligned_hausdorff(match, seconds_per_unit)
    (first, second), _ = even([a, b], channels, rate_hz, mixed_units)
    if nearest_name(clock, ("shared", "start"), "clock") == "start":
        first, second = from_start(first), from_start(second)
    there, back = of_points(first.time_s * scale, first.data, second.time_s * scale, second.data)
    return Hausdorff(max(there, back), there, back, seconds_per_unit, False, first.unit or second.unit)


def aligned_hausdorff(match: Alignment, seconds_per_unit: float = SECONDS_PER_UNIT) -> Hausdorff:
    """Hausdorff distance of curves that are aligned already."""
    time = match.times_s.mean(axis=1) / check_seconds(seconds_per_unit)
    there, back = of_points(time, match.a.data[match.path[:, 0]], time, match.b.data[match.path[:, 1]])
    return Hausdorff(max(there, back), there, back, seconds_per_unit, True, match.a.unit or match.b.unit)


def of_points(time_a: np.ndarray, a: np.ndarray, time_b: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Directed Hausdorff distances a to b and b to a of points (time, values); times increase, all in one unit."""
    a, b = as_values(a, "a"), as_values(b, "b")
    if a.shape[1] != b.shape[1]:
        raise InputError(f"expected the same number of channels in a and b, got {a.shape[1]} and {b.shape[1]}")
    for time, values, name in ((time_a, a, "a"), (time_b, b, "b")):
        if len(time) != len(values) or not np.isfinite(time).all() or (np.diff(time) < 0).any():
            raise InputError(f"{name}: expected one finite time per point, none before the one in front of it")
    time_a, time_b = np.ascontiguousarray(time_a, np.float64), np.ascontiguousarray(time_b, np.float64)
    there, back = kernels.directed(time_a, a, time_b, b, 0.0), kernels.directed(time_b, b, time_a, a, 0.0)
    return float(np.sqrt(there)), float(np.sqrt(back))


def l2(
    a,
    b,
    *,
    channels: Sequence[str] = CHANNELS,
    aligned: bool = False,
    rate_hz: float | None = None,
    cost: str = COST,
    band: float | None = BAND,
    clock: str = "shared",
    mixed_units: bool = False,
) -> L2:
    """Root mean square difference of two takes.

    Not aligned, over the time both cover, b by straight lines at the times of a; aligned, over the pairs of the path.

    Raises
    ------
    InputError : see `align`; the takes have no moment in common
    """
    if aligned:
        match = align(
            *(a, b), channels=channels, rate_hz=rate_hz, cost=cost, band=band, clock=clock, mixed_units=mixed_units
        )
        return aligned_l2(match)
    (first, second), _ = even([a, b], channels, rate_hz, mixed_units)
    if nearest_name(clock, ("shared", "start"), "clock") == "start":
        first, second = from_start(first), from_start(second)
    inside = common_moments(first, second)
    others = [np.interp(first.time_s[inside], second.time_s, column) for column in second.data.T]
    return _l2(first.data[inside] - np.stack(others, axis=1), first, second, False)


def aligned_l2(match: Alignment) -> L2:
    """Root mean square difference over the pairs of a path."""
    return _l2(match.a.data[match.path[:, 0]] - match.b.data[match.path[:, 1]], match.a, match.b, True)


def common_moments(a: Curve, b: Curve) -> np.ndarray:
    """(T_a,) bool, the samples of a within the time of b; InputError if there are none."""
    inside = (a.time_s >= b.time_s[0] - 1e-9) & (a.time_s <= b.time_s[-1] + 1e-9)
    if not inside.any():
        raise InputError(
            f"{a.name} ({a.time_s[0]:g} to {a.time_s[-1]:g} s) and {b.name} ({b.time_s[0]:g} to {b.time_s[-1]:g} s)"
            " have no moment in common; pass clock='start' to count each from its own start"
        )
    return inside


def check_seconds(seconds_per_unit: float) -> float:
    """`seconds_per_unit` if above 0; InputError otherwise."""
    try:
        return check_rate(seconds_per_unit)
    except InputError:
        raise InputError(f"expected seconds_per_unit above 0, got {seconds_per_unit!r}") from None


def _l2(difference: np.ndarray, a: Curve, b: Curve, aligned: bool) -> L2:
    of_channels = np.sqrt((difference**2).mean(axis=0))
    named = {channel: float(value) for channel, value in zip(a.channels, of_channels, strict=True)}
    return L2(float(np.sqrt((difference**2).mean())), named, len(difference), aligned, a.unit or b.unit)
