"""Compiled inner loops of the comparison: time warping, Hausdorff distance, barycentre averaging.

Curves are (T, C) float64, samples by channels, free of NaN; the modules above see to that. All run without Python's
lock, so that threads share the work.

The table of least costs is filled along anti-diagonals, whose cells do not depend on one another, so that the processor
computes several at a time; loops run from 0 over slices, which is what numba needs to vectorise them. The step taken
into each cell is kept in 2 bits, four anti-diagonals to a row of bytes: 25 MB for 10,000 by 10,000 samples.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

LANES = 8  # cells are computed in batches of this many; what is computed past the end of a diagonal is never read
PAD = 16  # spare places behind every buffer for that
SPARSE = 16  # of so many points of a curve, one goes first in `directed`


@njit(cache=True, nogil=True, error_model="numpy")
def band_width(n, m, band):
    """Radius of the band in samples (rule in `warping`); -1 for no band."""
    if band < 0:
        return -1
    return np.int64(math.floor(band * (max(n, m) - 1) + 1e-9))


@njit(cache=True, nogil=True, error_model="numpy")
def diagonal(d, n, m, width):
    """First and last i of the cells (i, d - i) that are allowed; last = first - 1 if there are none."""
    first, last = max(0, d - m + 1), min(n - 1, d)
    if width >= 0:
        first = max(first, (d - width - max(0, m - n) + 1) // 2)
        last = min(last, (d + width + max(0, n - m)) // 2)
    return first, last


@njit(cache=True, nogil=True, error_model="numpy")
def steps_size(n, m, width):
    """Bytes that the steps of an n by m table take."""
    size = 0
    for d in range(0, n + m - 1, 4):
        first, last = diagonal(d, n, m, width)
        size += last - first + 4 + LANES
    return size


@njit(cache=True, nogil=True, error_model="numpy")
def lay_out(curve, backwards, rows, start, stride):
    """Write a curve (T, C) into the flat `rows`, channel c from `start` + c `stride` on, with zeros behind it."""
    n, channels = curve.shape
    rows[start : start + rows_of(channels) * stride] = 0.0
    for c in range(channels):
        for k in range(n):
            rows[start + c * stride + k] = curve[n - 1 - k if backwards else k, c]


@njit(cache=True, nogil=True, error_model="numpy")
def rows_of(channels):
    """Rows that a curve is laid out in: at least 4, unless there is one channel."""
    return max(channels, 4) if channels > 1 else 1


@njit(cache=True, nogil=True, error_model="numpy")
def _one_channel(x, y, at, there, count, squared, add, work):
    """Local costs of one channel, set or added."""
    for k in range(count):
        gap = x[at + k] - y[there + k]
        local = gap * gap if squared else abs(gap)
        work[k] = work[k] + local if add else local


@njit(cache=True, nogil=True, error_model="numpy")
def _four_channels(x, y, at, there, stride_x, stride_y, count, squared, work):
    """Local costs of the first four channels."""
    at1, there1 = at + stride_x, there + stride_y
    at2, there2 = at1 + stride_x, there1 + stride_y
    at3, there3 = at2 + stride_x, there2 + stride_y
    if squared:
        for k in range(count):
            gap0, gap1 = x[at + k] - y[there + k], x[at1 + k] - y[there1 + k]
            gap2, gap3 = x[at2 + k] - y[there2 + k], x[at3 + k] - y[there3 + k]
            work[k] = (gap0 * gap0 + gap1 * gap1) + (gap2 * gap2 + gap3 * gap3)
    else:
        for k in range(count):
            gap0, gap1 = abs(x[at + k] - y[there + k]), abs(x[at1 + k] - y[there1 + k])
            gap2, gap3 = abs(x[at2 + k] - y[there2 + k]), abs(x[at3 + k] - y[there3 + k])
            work[k] = (gap0 + gap1) + (gap2 + gap3)


@njit(cache=True, nogil=True, error_model="numpy")
def _cells(work, older, old, new, count, steps, at, one, two):
    """One anti-diagonal: least cost of each cell, and the step into it. Ties: diagonal, then i - 1, then j - 1."""
    for k in range(count):
        best = work[older + k]
        step = np.uint8(0)
        up, left = work[old + k], work[old + np.uint64(1) + k]
        if up < best:
            best = up
            step = one
        if left < best:
            best = left
            step = two
        work[new + np.uint64(1) + k] = best + work[k]
        steps[at + k] |= step


@njit(cache=True, nogil=True, error_model="numpy")
def fill(x, y, from_x, from_y, stride_x, stride_y, n, m, channels, width, squared, work, steps, starts):
    """Fill the table of least costs and return the cost of the best path.

    x, y, from_x, from_y, stride_x, stride_y : as `lay_out` made them, y backwards; strides >= n + PAD and m + PAD
    work : at least 4 (n + PAD)
    steps, starts : the step into each cell, read by `trace`

    Places are unsigned numbers, which spares numba the question whether one counts from the end of the array, and whole
    arrays are passed, as counting the references to slices would take longer than a short diagonal.
    """
    lane = n + PAD
    older, old, new = lane, 2 * lane, 3 * lane
    work[: 4 * lane] = np.inf
    work[older] = 0.0  # before the first cell
    used = 0
    for d in range(n + m - 1):
        first, last = diagonal(d, n, m, width)
        if d & 3 == 0:
            size = last - first + 4 + LANES
            starts[d >> 2] = used - first
            for k in range(np.uint64(used), np.uint64(used + size)):
                steps[k] = 0
            used += size
        count = np.uint64((last - first + LANES) // LANES * LANES)
        at, there = np.uint64(from_x + first), np.uint64(from_y + m - 1 - d + first)  # j = d - i, backwards
        if channels > 1:
            _four_channels(x, y, at, there, np.uint64(stride_x), np.uint64(stride_y), count, squared, work)
            for c in range(4, channels):
                below, right = np.uint64(c * stride_x), np.uint64(c * stride_y)
                _one_channel(x, y, at + below, there + right, count, squared, True, work)
        else:
            _one_channel(x, y, at, there, count, squared, False, work)
        _cells(
            *(work, np.uint64(older + first), np.uint64(old + first), np.uint64(new + first), count),
            *(steps, np.uint64(starts[d >> 2] + first), np.uint8(1 << (2 * (d & 3))), np.uint8(2 << (2 * (d & 3)))),
        )
        work[new + first] = np.inf
        work[new + last + 2] = np.inf
        older, old, new = old, new, older
    return work[old + n]


@njit(cache=True, nogil=True, error_model="numpy")
def trace(steps, starts, n, m, path):
    """Write the path at the end of `path` (>= n + m - 1, 2), first cell first; return the number of its cells."""
    i, j, at = n - 1, m - 1, path.shape[0] - 1
    while True:
        path[at, 0] = i
        path[at, 1] = j
        if i == 0 and j == 0:
            return path.shape[0] - at
        d = i + j
        step = (steps[starts[d >> 2] + i] >> (2 * (d & 3))) & 3
        if j == 0 or (step == 1 and i > 0):
            i -= 1
        elif i == 0 or step == 2:
            j -= 1
        else:
            i -= 1
            j -= 1
        at -= 1


@njit(cache=True, nogil=True, error_model="numpy")
def warp(x, y, band, squared, path):
    """Align x (n, C) with y (m, C): write the path at the end of `path` (>= n + m - 1, 2); return cost and length."""
    n, m, channels = x.shape[0], y.shape[0], x.shape[1]
    stride_x, stride_y, rows = n + PAD, m + PAD, rows_of(channels)
    across, down, work = np.empty(rows * stride_x), np.empty(rows * stride_y), np.empty(4 * stride_x)
    lay_out(x, False, across, 0, stride_x)
    lay_out(y, True, down, 0, stride_y)
    width = band_width(n, m, band)
    steps, starts = np.empty(steps_size(n, m, width), np.uint8), np.empty((n + m) // 4 + 1, np.int64)
    total = fill(across, down, 0, 0, stride_x, stride_y, n, m, channels, width, squared, work, steps, starts)
    return total, trace(steps, starts, n, m, path)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _square(a, k, b, at, gap):
    """Squared distance of point k of a from point `at` of b, whose times are `gap` apart. Few channels need no loop.

    Put into its callers, as the call takes longer than the work.
    """
    k, at, channels = np.uint64(k), np.uint64(at), b.shape[1]
    square = gap * gap + (a[k, 0] - b[at, 0]) ** 2
    if channels > 1:
        square += (a[k, 1] - b[at, 1]) ** 2
    if channels > 2:
        square += (a[k, 2] - b[at, 2]) ** 2
    if channels > 3:
        square += (a[k, 3] - b[at, 3]) ** 2
    for c in range(4, channels):
        square += (a[k, c] - b[at, c]) ** 2
    return square


@njit(cache=True, nogil=True, error_model="numpy")
def directed(time_a, a, time_b, b, least):
    """Largest of the squared distances from each point of a to its nearest of b; points (time, values), times sorted.

    Each point of a first looks at the point of b that the one before it ended with, then searches outwards from its own
    time. It stops where time alone is farther than the nearest found, or where it can no longer raise the largest,
    which starts at `least`. A few points from all over go first: the largest is then near its end early, and most of
    the others stop at their first look.
    """
    n = b.shape[0]
    largest = least
    for sparse in (True, False):
        middle, near = 0, 0
        for k in range(0, a.shape[0], SPARSE if sparse else 1):
            time = time_a[k]
            nearest = _square(a, k, b, near, time_b[near] - time)
            if nearest <= largest:
                continue
            while middle < n - 1 and time_b[middle] < time:
                middle += 1
            right, left = middle, middle - 1
            while nearest > largest:
                gap_right = time_b[right] - time if right < n else np.inf
                gap_left = time - time_b[left] if left >= 0 else np.inf
                gap = min(gap_right, gap_left)
                if gap * gap >= nearest:
                    break
                if gap_right <= gap_left:
                    at = right
                    right += 1
                else:
                    at = left
                    left -= 1
                square = _square(a, k, b, at, gap)
                if square < nearest:
                    nearest = square
                    near = at
            largest = max(largest, nearest)
    return largest


@njit(cache=True, nogil=True, error_model="numpy")
def moves(values):
    """How far a curve (T, C) moves from sample to sample, summed over channels (T,); 0 at the first."""
    moved = np.zeros(values.shape[0])
    for k in range(1, values.shape[0]):
        for c in range(values.shape[1]):
            moved[k] += abs(values[k, c] - values[k - 1, c])
    return moved


@njit(cache=True, nogil=True, error_model="numpy")
def lag_half_samples(moved_x, moved_y, path, weights):
    """Median of j - i along a path, each step weighted by how far both curves move in it; in half samples.

    A step from (i, j) to (i', j') counts at the mean of both ends. Where neither curve moves at all, steps count alike.
    moved_x, moved_y : as `moves` gives them
    weights (>= 2 (n + m)) : work space, zeros, which it leaves behind
    """
    middle = 2 * (moved_x.size - 1)
    total, low, high = 0.0, weights.size, -1
    for even in range(2):
        for k in range(1, path.shape[0]):
            i, j, i0, j0 = path[k, 0], path[k, 1], path[k - 1, 0], path[k - 1, 1]
            weight = float(even)
            if i > i0:
                weight += moved_x[i]
            if j > j0:
                weight += moved_y[j]
            at = j + j0 - i - i0 + middle
            weights[at] += weight
            total += weight
            low, high = min(low, at), max(high, at)
        if total > 0:
            break
    if high < 0:  # a single cell
        return 0.0
    half = 0.5 * total * (1 - 1e-12)
    first, last = low, high
    below, above = weights[first], weights[last]
    while below < half:
        first += 1
        below += weights[first]
    while above < half:
        last -= 1
        above += weights[last]
    weights[low : high + 1] = 0.0
    return 0.5 * (first + last) - middle


@njit(cache=True, nogil=True, error_model="numpy")
def measure(xs, x_at, picks, ys, y_at, length, paths, step, there, back, lag):
    """Both Hausdorff distances of the aligned curves, and the lag, of the pairs that `lanes.warp` has aligned.

    picks (P,) : numbers of the xs
    step : time from sample to sample, in value units. Aligned curves share their times, so that what each counts from
        does not matter
    there, back, lag (P, M) : results; lag in half samples, both counted from their first
    """
    channels, longest = xs.shape[1], paths.shape[2]
    times, weights = np.empty(longest), np.zeros(2 * longest + 2)
    aligned_x, aligned_y = np.empty((longest, channels)), np.empty((longest, channels))
    moved_y = moves(ys)  # that from curve to curve is never read
    for a in range(picks.size):
        x = xs[x_at[picks[a]] : x_at[picks[a] + 1]]
        moved_x = moves(x)
        for b in range(y_at.size - 1):
            y = ys[y_at[b] : y_at[b + 1]]
            count = length[a, b]
            path = paths[a, b, longest - count :]
            for k in range(count):
                i, j = path[k, 0], path[k, 1]
                times[k] = 0.5 * step * (i + j)
                for c in range(channels):
                    aligned_x[k, c] = x[i, c]
                    aligned_y[k, c] = y[j, c]
            time, p, q = times[:count], aligned_x[:count], aligned_y[:count]
            there[a, b] = math.sqrt(directed(time, p, time, q, 0.0))
            back[a, b] = math.sqrt(directed(time, q, time, p, 0.0))
            lag[a, b] = lag_half_samples(moved_x, moved_y[y_at[b] : y_at[b + 1]], path, weights)
