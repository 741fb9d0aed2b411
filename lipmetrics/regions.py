"""The connected regions of a canvas: the likeliest one, its mask, and sums over it."""

from __future__ import annotations

import numba
import numpy as np


def likeliest_region(
    odds: np.ndarray, weight: np.ndarray, place: tuple[int, int], size: tuple[int, int]
) -> tuple[np.ndarray, tuple[int, int, int, int, int]] | None:
    """The 4-connected region of log-odds above 0 with the most weighted log-odds, of which 3 count at most.

    odds, weight : (rows, cols) float32, a part of a canvas of `size` that begins at row and column `place`

    Returns
    -------
    mask (*size) bool, and (left, top, width, height, area) of the region in px of the canvas; None without any
    """
    mask = np.zeros(size, np.bool_)
    row, col = place
    extent = _mark_likeliest(odds, weight, mask[row : row + odds.shape[0], col : col + odds.shape[1]])
    left, top, width, height, area = extent
    return (mask, (left + col, top + row, width, height, area)) if area else None


@numba.njit(cache=True, nogil=True)
def _root(parent, k):
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@numba.njit(cache=True, nogil=True)
def _mark_likeliest(odds, weight, mask):
    """Regions by joining what touches, first above and to the left; the mask, zeros, becomes True in the likeliest."""
    rows, cols = odds.shape
    labels, parent, score = np.zeros((rows, cols), np.int32), np.zeros(rows * cols // 2 + 2, np.int32), [0.0]
    for i in range(rows):
        for j in range(cols):
            if not odds[i, j] > 0:
                continue
            above = labels[i - 1, j] if i > 0 else np.int32(0)
            before = labels[i, j - 1] if j > 0 else np.int32(0)
            label = above if above else before
            if not label:
                label = np.int32(len(score))
                parent[label] = label
                score.append(0.0)
            elif above and before and above != before:
                first, second = _root(parent, above), _root(parent, before)
                parent[max(first, second)] = min(first, second)
            labels[i, j] = label
            score[label] += weight[i, j] * min(odds[i, j], np.float32(3))
    best, n = 0, len(score)
    for k in range(n - 1, 0, -1):  # a root has a lower number than what hangs on it
        if parent[k] != k:
            score[_root(parent, k)] += score[k]
            score[k] = 0.0
    for k in range(1, n):
        if best == 0 or score[k] > score[best]:
            best = k
    top, bottom, left, right, area = rows, 0, cols, 0, 0
    for i in range(rows):
        for j in range(cols):
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
        if mask[i, begin:end].any():
            total += i
            rows += 1
    return total / rows
