"""Every take against every reference at once: distance, Hausdorff and lag, on as many threads as there are cores."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from lipmetrics.compare import kernels
from lipmetrics.compare.alignment import CLOCKS
from lipmetrics.compare.curves import CHANNELS, Curve, even, nearest_name, thread_count
from lipmetrics.compare.distances import SECONDS_PER_UNIT, check_seconds
from lipmetrics.compare.lanes import LANES
from lipmetrics.compare.warping import BAND, COST, best_paths, check_settings, check_size, distance_of, per_step_of
from lipmetrics.errors import InputError

BLOCK_BYTES = 2_000_000  # of paths kept at a time by each thread: within its cache, and long enough a piece of work


@dataclass(frozen=True)
class Pairs:
    """N takes against M references; arrays (N, M) as `align` and `hausdorff` define them for one pair.

    distance, per_step, lag_s, warp : of the path; lag_s > 0 where the take is later than the reference
    hausdorff : of the aligned curves, the larger of there (take to reference) and back
    steps : cells of the path
    """

    takes: tuple[str, ...]
    references: tuple[str, ...]
    distance: np.ndarray
    per_step: np.ndarray
    hausdorff: np.ndarray
    there: np.ndarray
    back: np.ndarray
    lag_s: np.ndarray
    warp: np.ndarray
    steps: np.ndarray
    cost: str
    band: float | None
    seconds_per_unit: float
    rate_hz: float
    clock: str


def pairs(
    takes: Sequence,
    references: Sequence,
    *,
    channels: Sequence[str] = CHANNELS,
    rate_hz: float | None = None,
    cost: str = COST,
    band: float | None = BAND,
    clock: str = "shared",
    seconds_per_unit: float = SECONDS_PER_UNIT,
    mixed_units: bool = False,
    threads: int | None = None,
) -> Pairs:
    """Compare all takes with all references. All are resampled at one rate: `rate_hz`, or the highest of their own.

    Parameters as in `align` and `hausdorff`; threads : None for one per core. The result does not depend on it.

    Raises
    ------
    InputError : see `align`
    """
    squared, share = check_settings(cost, band)
    scale = 1.0 / check_seconds(seconds_per_unit)
    nearest_name(clock, CLOCKS, "clock")
    threads = thread_count(threads)
    if not len(takes) or not len(references):
        raise InputError(f"expected at least one take and one reference, got {len(takes)} and {len(references)}")
    curves, rate_hz = even([*takes, *references], channels, rate_hz, mixed_units)
    first, second = curves[: len(takes)], curves[len(takes) :]
    check_size(max(len(c.time_s) for c in first), max(len(c.time_s) for c in second), share)
    turned = len(first) < len(second)  # the more there are of those aligned at a time, the faster
    many, ones = (second, first) if turned else (first, second)
    (values, at), (one_values, one_at) = pack(many), pack(ones)
    shape = (len(many), len(ones))
    total, there, back, lag = (np.empty(shape) for _ in range(4))
    steps = np.empty(shape, np.int64)
    by_length = np.argsort(np.diff(at), kind="stable")

    def block(start: int, stop: int) -> None:
        picks = by_length[start:stop]
        total[picks], steps[picks], paths = best_paths(
            *(values, at, picks, one_values, one_at, not turned, squared, share)
        )
        measured = np.empty((3, len(picks), len(ones)))
        kernels.measure(values, at, picks, one_values, one_at, steps[picks], paths, scale / rate_hz, *measured)
        there[picks], back[picks], lag[picks] = measured

    longest = int(np.diff(at).max() + np.diff(one_at).max())
    size = BLOCK_BYTES // (8 * longest * len(ones) * LANES) * LANES
    in_threads(block, len(many), max(LANES, size), threads)
    sizes = np.diff(at)[:, None] + np.diff(one_at)[None, :]
    if turned:
        total, steps, there, back, lag, sizes = total.T, steps.T, back.T, there.T, -lag.T, sizes.T
    shift = np.zeros(total.shape)  # of a reference's first sample against a take's, seconds
    if clock == "shared":
        shift = np.array([c.time_s[0] for c in second])[None, :] - np.array([c.time_s[0] for c in first])[:, None]
    return Pairs(
        *(tuple(c.name for c in first), tuple(c.name for c in second)),
        *(distance_of(total, squared), per_step_of(total, steps, squared), np.maximum(there, back), there, back),
        *(-(lag / (2 * rate_hz) + shift), (2 * steps - sizes) / np.maximum(steps - 1, 1), steps),
        *(cost, band, seconds_per_unit, rate_hz, clock),
    )


def pack(curves: Sequence[Curve]) -> tuple[np.ndarray, np.ndarray]:
    """Values of all curves one after another (sum T, C), and the rows at which each starts, with the end (N + 1,)."""
    at = np.concatenate([[0], np.cumsum([len(curve.time_s) for curve in curves])]).astype(np.int64)
    return np.ascontiguousarray(np.concatenate([curve.data for curve in curves])), at


def in_threads(block, count: int, size: int, threads: int) -> None:
    """Call block(start, stop) over 0 to count, in pieces of at most `size`."""
    starts = range(0, count, size)
    stops = [min(start + size, count) for start in starts]
    if threads == 1 or len(starts) == 1:
        for start, stop in zip(starts, stops, strict=True):
            block(start, stop)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(block, starts, stops))
