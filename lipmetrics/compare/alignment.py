"""Two takes set against one another in time: the path between them, and how late and how warped one is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lipmetrics.compare import kernels
from lipmetrics.compare.curves import CHANNELS, Curve, even, nearest_name
from lipmetrics.compare.warping import (
    BAND,
    COST,
    best_path,
    check_settings,
    check_size,
    distance_of,
    per_step_of,
)

CLOCKS = ("shared", "start")
STRETCH_WINDOW_S = 0.2


@dataclass(frozen=True)
class Alignment:
    """What `align` found. Times are those of the takes; after clock='start', counted from each take's first sample.

    a, b : the curves that were aligned, on even grids of one rate
    path : (L, 2) int64, samples of a and b, start to end
    distance : cost of the path, in the unit of the values (`dtw_path`); grows with the length
    per_step : mean of the local costs along the path ('squared': root of the mean), comparable between lengths
    lag_s : how much later b is than a: median of t_b - t_a along the path, each step weighted by how far both curves
        move in it, so that time spent at rest, where any shift fits, says nothing
    lag_low_s, lag_high_s : 5 and 95 % quantiles of the same
    warp : share of the path's steps in which one of the two stands still, 0 to 1
    hold_s : longest time for which one of the two stands still
    stretch : largest ratio of the times that both go through while they move on by STRETCH_WINDOW_S on average, >= 1
    at_band : share of the path's cells at the edge of the band; where it is not near 0, the band kept the path
        from a larger shift, and lag_s is a lower bound
    """

    a: Curve
    b: Curve
    path: np.ndarray
    distance: float
    per_step: float
    lag_s: float
    lag_low_s: float
    lag_high_s: float
    warp: float
    hold_s: float
    stretch: float
    at_band: float
    cost: str
    band: float | None
    rate_hz: float
    clock: str

    @property
    def times_s(self) -> np.ndarray:
        """(L, 2) times of the path's pairs in a and in b, seconds."""
        return np.stack([self.a.time_s[self.path[:, 0]], self.b.time_s[self.path[:, 1]]], axis=1)

    @property
    def b_on_a(self) -> np.ndarray:
        """(T_a, C) values of b at the times of a: for each sample of a the mean of those matched with it."""
        return matched_mean(self.path[:, 0], self.b.data[self.path[:, 1]], len(self.a.time_s))

    @property
    def a_on_b(self) -> np.ndarray:
        """(T_b, C) values of a at the times of b."""
        return matched_mean(self.path[:, 1], self.a.data[self.path[:, 0]], len(self.b.time_s))

    def to_b(self, time_s, side: str = "mean"):
        """Times of b that the path matches with times of a; those outside a get the nearest end's.

        side : of the moments of b matched with one moment of a, the 'first', the 'last' or their 'mean'
        """
        return carry_times(self.path, self.a.time_s, self.b.time_s, time_s, side)


def align(
    a,
    b,
    *,
    channels: Sequence[str] = CHANNELS,
    rate_hz: float | None = None,
    cost: str = COST,
    band: float | None = BAND,
    clock: str = "shared",
    mixed_units: bool = False,
) -> Alignment:
    """Align two takes by dynamic time warping.

    Both are first resampled evenly at `rate_hz`, or at the higher of their own rates.

    Parameters
    ----------
    a, b : Takes, Averages, pairs (time_s, values) or arrays (T,) or (T, C) with `rate_hz`
    channels : those of the takes that count, all alike
    cost, band : see `dtw_path`; None for no band
    clock : 'shared', the times of both are of one clock (a model and the speech it was made for), so that a late start
        counts as lateness; 'start', each counts from its first sample
    mixed_units : compare different units of length all the same

    Raises
    ------
    InputError : unusable curves or settings, different units or numbers of channels
    """
    (first, second), rate_hz = even([a, b], channels, rate_hz, mixed_units)
    squared, share = check_settings(cost, band)
    if nearest_name(clock, CLOCKS, "clock") == "start":
        first, second = from_start(first), from_start(second)
    check_size(len(first.time_s), len(second.time_s), share)
    path, total = best_path(first.data, second.data, squared, share)
    lag, weight = step_lags(first, second, path)
    return Alignment(
        *(first, second, path, float(distance_of(total, squared)), float(per_step_of(total, len(path), squared))),
        *(weighted_quantile(lag, weight, share_below) for share_below in (0.5, 0.05, 0.95)),
        *(warp_share(path), longest_hold(path) / rate_hz, largest_stretch(path, rate_hz)),
        *(band_share(path, len(first.time_s), len(second.time_s), share), cost, band, rate_hz, clock),
    )


def from_start(curve: Curve) -> Curve:
    """The curve with its times counted from its first sample."""
    return Curve(curve.name, curve.time_s - curve.time_s[0], curve.data, curve.channels, curve.unit)


def step_lags(a: Curve, b: Curve, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each step of a path: t_b - t_a in its middle, seconds, and how far both curves move in it.

    Weights are all 1 where neither curve moves anywhere. A path of a single cell counts as one step.
    """
    lag = b.time_s[path[:, 1]] - a.time_s[path[:, 0]]
    if len(path) == 1:
        return lag, np.ones(1)
    moved = [np.abs(np.diff(curve.data[at], axis=0)).sum(axis=1) for curve, at in zip((a, b), path.T, strict=True)]
    weight = moved[0] + moved[1]
    return (lag[1:] + lag[:-1]) / 2, weight if weight.sum() > 0 else np.ones(len(weight))


def weighted_quantile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    """The value that `share` of the weight lies below; midway between two where it falls between them."""
    order = np.argsort(values, kind="stable")
    values, sums = values[order], np.cumsum(weights[order])
    low = np.searchsorted(sums, share * sums[-1] * (1 - 1e-12))
    high = np.searchsorted(sums, share * sums[-1] * (1 + 1e-12), side="right")
    return float((values[min(low, len(values) - 1)] + values[min(high, len(values) - 1)]) / 2)


def warp_share(path: np.ndarray) -> float:
    """Share of steps that are not diagonal; 0 for a single cell."""
    return float((np.diff(path, axis=0).sum(axis=1) == 1).mean()) if len(path) > 1 else 0.0


def longest_hold(path: np.ndarray) -> int:
    """Largest number of steps in a row in which one of the two stands still, samples."""
    longest = 0
    for column in path.T:
        _, counts = np.unique(column, return_counts=True)
        longest = max(longest, int(counts.max()) - 1)
    return longest


def largest_stretch(path: np.ndarray, rate_hz: float, window_s: float = STRETCH_WINDOW_S) -> float:
    """Largest ratio of the times both go through within a window; a standstill counts as one sample.

    The window spans `window_s` of the mean time of both, or the whole path where that is shorter.
    """
    middle = path.sum(axis=1)  # in half samples, strictly increasing
    span = min(max(round(2 * window_s * rate_hz), 1), int(middle[-1]))
    if span == 0:
        return 1.0
    ends = np.searchsorted(middle, middle + span)
    starts = np.flatnonzero(ends < len(path))
    gone = path[ends[starts]] - path[starts]
    return float((gone.max(axis=1) / np.maximum(gone.min(axis=1), 1)).max())


def band_share(path: np.ndarray, n: int, m: int, band: float) -> float:
    """Share of the cells of a path whose neighbour farther out is kept off by the band; 0 without a band."""
    radius = kernels.band_width(n, m, band)
    if radius < 0:
        return 0.0
    i, j = path.T
    lower = (i - j == radius + max(0, n - m)) & (i < n - 1) & (j > 0)
    upper = (j - i == radius + max(0, m - n)) & (j < m - 1) & (i > 0)
    return float((lower | upper).mean())


def matched_mean(at: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Mean of the rows of `values` (L, C) that share a place `at` (L,), (count, C); each place occurs."""
    sums = np.stack([np.bincount(at, column, count) for column in values.T], axis=1)
    return sums / np.bincount(at, minlength=count)[:, None]


def carry_times(path: np.ndarray, time_a: np.ndarray, time_b: np.ndarray, time_s, side: str = "mean"):
    """Times of b for times of a along a path; between samples by straight lines. `side` as in `Alignment.to_b`."""
    matched = time_b[path[:, 1]]
    starts = np.flatnonzero(np.diff(path[:, 0], prepend=-1))
    ends = np.append(starts[1:], len(path)) - 1
    nearest_name(side, ("first", "last", "mean"), "side")
    of_sample = {
        "first": matched[starts],
        "last": matched[ends],
        "mean": (matched[starts] + matched[ends]) / 2,  # times are even
    }[side]
    return np.interp(time_s, time_a, of_sample)
