"""Dynamic time warping of two arrays: the path of least cost, start to end.

Rules (Sakoe and Chiba 1978, symmetric, without slope weights): the path goes from (0, 0) to (n - 1, m - 1) in steps of
(1, 1), (1, 0) or (0, 1); its cost is the sum of the local costs of its cells, the first included.

Band (Sakoe and Chiba): cell (i, j) of n x m samples is allowed if

    -r - max(0, n - m) <= j - i <= r + max(0, m - n),   r = floor(band (max(n, m) - 1)),

which is |i - j| <= r for equal lengths, and is widened on one side by the difference of the lengths otherwise: both
staying in step and ending together are allowed. The rule is the same with x and y exchanged and with both reversed, and
its cells always hold a path. tslearn has the same; dtaidistance too, with window = r + 1.
"""

from __future__ import annotations

import numpy as np

from lipmetrics.compare import kernels, lanes
from lipmetrics.compare.curves import as_values, nearest_name
from lipmetrics.errors import InputError

COSTS = ("absolute", "squared")
COST = "absolute"
BAND = 0.1  # default of all that aligns takes, share of the longer duration; a lag cannot exceed it
MOST_CELLS = 8_000_000_000  # 2 GB of steps
MOST_BYTES = 32_000_000  # of costs, for several pairs at a time; longer curves are aligned pair after pair


def dtw_path(x, y, *, cost: str = COST, band: float | None = None) -> tuple[np.ndarray, float]:
    """Path of least cost between two curves, and that cost.

    Parameters
    ----------
    x, y : (n,) or (n, C) and (m,) or (m, C), finite
    cost : 'absolute', local cost sum over channels of |a - b|, distance its sum along the path; or 'squared', local
        cost sum over channels of (a - b)^2, distance the root of its sum along the path
    band : radius as a share of the longer curve, 0 to 1 (module docstring); None for none

    Returns
    -------
    path (L, 2) int64 : pairs (i, j), both increasing or equal from row to row. Of equal costs the step (1, 1) wins,
        then (1, 0), then (0, 1), looking back from the end
    distance : float, in the unit of the values for both costs

    Raises
    ------
    InputError : empty, NaN, infinite or not numbers; different numbers of channels; unknown cost; band outside 0 to 1
    """
    x, y = as_values(x, "x"), as_values(y, "y")
    if x.shape[1] != y.shape[1]:
        raise InputError(f"expected the same number of channels in x and y, got {x.shape[1]} and {y.shape[1]}")
    squared, share = check_settings(cost, band)
    check_size(len(x), len(y), share)
    path, total = best_path(x, y, squared, share)
    return path, float(distance_of(total, squared))


def best_path(x: np.ndarray, y: np.ndarray, squared: bool, band: float) -> tuple[np.ndarray, float]:
    """Path (L, 2) int64 and summed cost of two curves that were checked."""
    path = np.empty((len(x) + len(y), 2), np.int32)
    total, length = kernels.warp(x, y, band, squared, path)
    return path[-length:].astype(np.int64), float(total)


def best_paths(many, many_at, picks, ones, one_at, many_first: bool, squared: bool, band: float):
    """Curves number `picks` (P,) of the many against all M of the ones, packed as `lanes.warp` takes them.

    many_first : whether the many are the x of `dtw_path`, and the ones its y, or the other way round
    Returns summed costs (P, M), lengths (P, M), and paths (P, M, longest, 2) int32 of samples of the many and of the
    one, each at the end of its row; InputError if a cost is not finite. Fastest if curves picked one after another are
    alike in length.
    """
    sizes, one_sizes = np.diff(many_at)[picks], np.diff(one_at)
    shape = (len(picks), len(one_sizes))
    totals, lengths = np.empty(shape), np.empty(shape, np.int64)
    paths = np.empty((*shape, int(sizes.max() + one_sizes.max()), 2), np.int32)
    if many.shape[1] <= lanes.MOST_CHANNELS and lanes.table_bytes(sizes, one_sizes, band) <= MOST_BYTES:
        lanes.warp(many, many_at, picks, ones, one_at, many_first, band, squared, totals, lengths, paths)
    else:
        for a, b in np.ndindex(shape):
            x, y = many[many_at[picks[a]] : many_at[picks[a] + 1]], ones[one_at[b] : one_at[b + 1]]
            first, second = (x, y) if many_first else (y, x)
            totals[a, b], lengths[a, b] = kernels.warp(first, second, band, squared, paths[a, b])
            if not many_first:
                paths[a, b] = paths[a, b, :, ::-1].copy()
    distance_of(totals, squared)
    return totals, lengths, paths


def check_settings(cost: str, band: float | None) -> tuple[bool, float]:
    """Whether the cost is squared, and the band as the kernels take it (-1 for none)."""
    squared = nearest_name(cost, COSTS, "cost") == "squared"
    if band is None:
        return squared, -1.0
    if not isinstance(band, (int, float, np.number)) or isinstance(band, bool) or not 0 <= band <= 1:
        raise InputError(f"expected a band from 0 to 1 (share of the longer duration) or None, got {band!r}")
    return squared, float(band)


def check_size(n: int, m: int, band: float) -> None:
    """InputError if the table would be too large to keep."""
    cells = n * m if band < 0 else min(n, m) * min(max(n, m), abs(n - m) + 2 * band * max(n, m))
    if cells > MOST_CELLS:
        raise InputError(f"{n} x {m} samples are too many to align; use a lower rate_hz or a narrower band")


def distance_of(total, squared: bool):
    """Distance from the summed local costs; InputError if the sum was too large for a number."""
    if not np.all(np.isfinite(total)):
        raise InputError("the values are too large to compare: their summed cost is not finite")
    return np.sqrt(total) if squared else total


def per_step_of(total, length, squared: bool):
    """Mean local cost of a path (absolute), or the root of the mean (squared): comparable between lengths."""
    return np.sqrt(total / length) if squared else total / length
