"""Compiled inner loops that align many curves with one, LANES of them at a time.

The many are interleaved, sample by sample, so that the processor computes the same cell of LANES tables at once. Cells
of a row depend on the one before, but that lies a whole LANES back, and neither the start of a row nor the edge of a
band costs anything, which is what a narrow band consists of. Costs are added in the same order as in `kernels`, and
give the same numbers to the last bit.

In what follows q counts samples of the many, p those of the one.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lipmetrics.compare.kernels import band_width

LANES = 8
MOST_CHANNELS = 4


@njit(cache=True, nogil=True, error_model="numpy")
def _interleave(values, at, picks, longest, many):
    """Curves number `picks` into the flat `many`: channel c, sample q, lane l at (c longest + q) LANES + l, else 0."""
    for k in range(MOST_CHANNELS * longest * LANES):
        many[k] = 0.0
    for lane in range(picks.size):
        start = at[picks[lane]]
        for q in range(at[picks[lane] + 1] - start):
            for c in range(values.shape[1]):
                many[(c * longest + q) * LANES + lane] = values[start + q, c]


@njit(cache=True, nogil=True, error_model="numpy")
def _limits(sizes, m, band, low, high):
    """Least and largest q - p that the band allows in each lane (rule in `warping`).

    Returns the least and the largest of all lanes, and whether any lane has a band at all.
    """
    lowest, highest, banded = np.int64(0), np.int64(0), False
    for lane in range(sizes.size):
        n = sizes[lane]
        low[lane], high[lane] = 1 - m, n - 1
        width = band_width(n, m, band)
        if width >= 0:
            low[lane] = max(low[lane], -width - max(0, m - n))
            high[lane] = min(high[lane], width + max(0, n - m))
        lowest, highest = min(lowest, low[lane]), max(highest, high[lane])
        banded = banded or low[lane] > 1 - m or high[lane] < n - 1
    return lowest, highest, banded


@njit(cache=True, nogil=True, error_model="numpy")
def _row(many, q, stride, one, squared, kept_off, edge, table, below, new, count):
    """One row of the tables of all lanes: least costs of `count` places from `new` + LANES on. Places are unsigned."""
    one0, one1, one2, one3 = one
    q1, q2, q3 = q + stride, q + np.uint64(2) * stride, q + np.uint64(3) * stride
    lanes = np.uint64(LANES)
    if squared:
        for k in range(count):
            gap0, gap1, gap2, gap3 = many[q + k] - one0, many[q1 + k] - one1, many[q2 + k] - one2, many[q3 + k] - one3
            local = (gap0 * gap0 + gap1 * gap1) + (gap2 * gap2 + gap3 * gap3)
            best = min(table[below + k], table[below + lanes + k])
            table[new + lanes + k] = min(best, table[new + k]) + (local + kept_off[edge + k])
    else:
        for k in range(count):
            gap0, gap1, gap2, gap3 = many[q + k] - one0, many[q1 + k] - one1, many[q2 + k] - one2, many[q3 + k] - one3
            local = (abs(gap0) + abs(gap1)) + (abs(gap2) + abs(gap3))
            best = min(table[below + k], table[below + lanes + k])
            table[new + lanes + k] = min(best, table[new + k]) + (local + kept_off[edge + k])


@njit(cache=True, nogil=True, error_model="numpy")
def _fill(many, longest, lanes_n, one, low, high, limits, squared, kept_off, table, rows):
    """Fill the tables of least costs of all lanes.

    low, high, limits : as `_limits` gives them
    kept_off : work space, (longest + m) LANES
    table : at least `_table_size`
    rows (m + 1,) : result, the place in the table where q = 0 of row p - 1 would be
    """
    m, channels = one.shape
    lowest, highest, banded = limits
    for k in range(((highest - lowest if banded else longest) + 1) * LANES):
        kept_off[k] = 0.0
    if banded:  # a lane's band within the widest: costs are infinite outside
        for lane in range(lanes_n):
            for k in range(highest - lowest + 1):
                if k + lowest < low[lane] or k + lowest > high[lane]:
                    kept_off[k * LANES + lane] = np.inf
    used = (min(longest - 1, highest) + 2) * LANES
    for k in range(used):
        table[k] = np.inf if k >= LANES else 0.0  # 0 before the first cell
    rows[0] = LANES
    for p in range(m):
        first, last = max(0, p + lowest), min(longest - 1, p + highest)
        count = (last - first + 1) * LANES
        rows[p + 1] = used + (1 - first) * LANES
        before = rows[p] + (first - 1) * LANES
        edge = (first - p - lowest) * LANES if banded else 0
        for k in range(LANES):
            table[used + k] = np.inf
        samples = (
            one[p, 0],
            one[p, 1] if channels > 1 else 0.0,
            one[p, 2] if channels > 2 else 0.0,
            one[p, 3] if channels > 3 else 0.0,
        )
        _row(
            *(many, np.uint64(first * LANES), np.uint64(longest * LANES), samples, squared),
            *(kept_off, np.uint64(edge)),
            *(table, np.uint64(before), np.uint64(used), np.uint64(count)),
        )
        for k in range(LANES):
            table[used + LANES + count + k] = np.inf
        used += count + 2 * LANES


def table_bytes(sizes, one_sizes, band: float) -> float:
    """About what the tables of LANES curves take, bytes. sizes, one_sizes : samples of the many and the ones."""
    n, m, least = int(sizes.max()), int(one_sizes.max()), int(min(sizes.min(), one_sizes.min()))
    width = n if band < 0 else min(n, 2 * band * max(n, m) + max(n, m) - least)
    return 8.0 * LANES * m * width


@njit(cache=True, nogil=True, error_model="numpy")
def _table_size(longest, m, lowest, highest):
    """Numbers that the tables of LANES curves of `longest` samples take: their rows, one below, two places beside."""
    return (m + 1) * (min(longest, highest - lowest + 1) + 2) * LANES


@njit(cache=True, nogil=True, error_model="numpy")
def _trace(table, rows, lane, n, m, many_first, path):
    """Write the path (q, p) of a lane at the end of `path` (>= n + m - 1, 2); return the number of its cells.

    Of equal costs the diagonal wins, then a step in the many only if `many_first`, else one in the one only. Steps need
    no look at the edges of the table, as costs beyond are infinite.
    """
    q, p, at = n - 1, m - 1, path.shape[0] - 1
    while True:
        path[at, 0] = q
        path[at, 1] = p
        if q == 0 and p == 0:
            return path.shape[0] - at
        below, left = rows[p] + q * LANES + lane, rows[p + 1] + (q - 1) * LANES + lane
        diagonal, beneath, beside = table[below - LANES], table[below], table[left]
        former, latter = (beside, beneath) if many_first else (beneath, beside)
        second = latter < min(diagonal, former)
        other = not second and former < diagonal
        q -= not (other if not many_first else second)
        p -= not (second if not many_first else other)
        at -= 1


@njit(cache=True, nogil=True, error_model="numpy")
def warp(values, at, picks, ones, one_at, many_first, band, squared, total, length, paths):
    """Align each of the curves number `picks` (P,) of the many with each of the M ones.

    values (sum T, C), at (N + 1,) : curves one after another, C <= MOST_CHANNELS, and the row at which each starts;
        ones, one_at (M + 1,) too
    many_first : which of two steps of equal cost is taken, see `_trace`
    total, length (P, M) : results, summed cost and number of cells; the length is 0 where the cost is not finite
    paths (P, M, longest, 2) int32 : results, sample of the many and of the one; longest >= n + m - 1; each path is at
        the end of its row
    """
    longest, tallest = np.int64(0), np.int64(0)  # as literals they would have what they are given to compiled twice
    for a in picks:
        longest = max(longest, at[a + 1] - at[a])
    for b in range(one_at.size - 1):
        tallest = max(tallest, one_at[b + 1] - one_at[b])
    many = np.empty(MOST_CHANNELS * longest * LANES)
    kept_off = np.empty((longest + tallest) * LANES)
    table, rows = np.empty(0), np.empty(tallest + 1, np.int64)
    held, low, high = np.empty(LANES, np.int64), np.empty(LANES, np.int64), np.empty(LANES, np.int64)
    for start in range(0, picks.size, LANES):
        group = picks[start : start + LANES]
        sizes, longest = held[: group.size], np.int64(0)
        for lane in range(group.size):
            sizes[lane] = at[group[lane] + 1] - at[group[lane]]
            longest = max(longest, sizes[lane])
        _interleave(values, at, group, longest, many)
        for b in range(one_at.size - 1):
            one = ones[one_at[b] : one_at[b + 1]]
            m = one.shape[0]
            limits = _limits(sizes, m, band, low, high)
            size = _table_size(longest, m, limits[0], limits[1])
            if size > table.size:
                table = np.empty(size)
            _fill(many, longest, sizes.size, one, low, high, limits, squared, kept_off, table, rows)
            for lane in range(sizes.size):
                total[start + lane, b] = table[rows[m] + (sizes[lane] - 1) * LANES + lane]
                length[start + lane, b] = 0
                if np.isfinite(total[start + lane, b]):
                    length[start + lane, b] = _trace(
                        table, rows, lane, sizes[lane], m, many_first, paths[start + lane, b]
                    )
