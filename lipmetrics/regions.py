"""The connected regions of a canvas: the likeliest one, its mask, and sums over it."""

from __future__ import annotations

import numba
import numpy as np


def likeliest_region(
    odds: np.ndarray, weight: np.ndarray, part: tuple[int, int, int, int]
) -> tuple[np.ndarray, tuple[int, int, int, int, int]] | None:
    """The 4-connected region of log-odds above 0 with the most weighted log-odds, of which 3 count at most.

    odds, weight : (rows, cols) float32; part : half open (row0, row1, col0, col1), nothing else is looked at

    Returns
    -------
    mask (rows, cols) bool, and (left, top, width, height, area) of the region; None without any
    """
    mask = np.zeros(odds.shape, np.bool_)
    extent = _mark_likeliest(odds, weight, *part, mask)
    return (mask, extent) if extent[-1] else None


@numba.njit(inline="always")
def _root(parent, k):
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@numba.njit(cache=True, nogil=True)
def _mark_likeliest(odds, weight, row0, row1, col0, col1, mask):
    """Regions by joining what touches, first above and to the left; the mask, zeros, becomes True in the likeliest."""
    labels = np.zeros(odds.shape, np.int32)
    parent, score, n = np.zeros(odds.size // 2 + 2, np.int32), np.zeros(odds.size // 2 + 2), 1
    for i in range(row0, row1):
        for j in range(col0, col1):
            if not odds[i, j] > 0:
                continue
            above = labels[i - 1, j] if i > row0 else np.int32(0)
            before = labels[i, j - 1] if j > col0 else np.int32(0)
            label = above if above else before
            if not label:
                label = np.int32(n)
                parent[label] = label
                n += 1
            elif above and before and above != before:
                first, second = _root(parent, above), _root(parent, before)
                parent[max(first, second)] = min(first, second)
            labels[i, j] = label
            score[label] += weight[i, j] * min(odds[i, j], np.float32(3))
    best = 0
    for k in range(n - 1, 0, -1):  # a root has a lower number than what hangs on it
        if parent[k] != k:
            score[_root(parent, k)] += score[k]
            score[k] = 0.0
    for k in range(1, n):
        if best == 0 or score[k] > score[best]:
            best = k
    top, bottom, left, right, area = row1, 0, col1, 0, 0
    for i in range(row0, row1):
        for j in range(col0, col1):
            if labels[i, j] and _root(parent, labels[i, j]) == best:
                mask[i, j] = True
                area += 1
                top, bottom, left, right = min(top, i), i + 1, min(left, j), max(right, j + 1)
    return left, top, right - left, bottom - top, area


@numba.njit(cache=True, nogil=True)
def sums_over(odds, mask, top, bottom):
    """Pixels in the mask, the sum of the log-odds there, and pixels of the whole canvas that are above 0.

    Nothing of the mask lies outside rows top to bottom, half open.
    """
    inside, above, total = 0, 0, 0.0
    for i in range(mask.shape[0]):
        line = odds[i]
        for j in range(line.size):
            above += line[j] > 0
        if top <= i < bottom:
            chosen = mask[i]
            for j in range(line.size):
                if chosen[j]:
                    inside += 1
                    total += line[j]
    return inside, total, above


@numba.njit(cache=True, nogil=True)
def middle_row(mask, begin, end):
    """Mean row of those with a pixel of the mask in columns begin to end, half open."""
    total, rows = 0, 0
    for i in range(mask.shape[0]):
        for j in range(begin, end):
            if mask[i, j]:
                total += i
                rows += 1
                break
    return total / rows
