"""The connected regions of a canvas: the likeliest one, its mask, and sums over it."""

from __future__ import annotations

import cv2
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
    count, labels, stats, _ = cv2.connectedComponentsWithStats((odds > 0).view(np.uint8), connectivity=4)
    if count < 2:
        return None
    mask = np.zeros(size, np.bool_)
    row, col = place
    best = _mark_likeliest(labels, odds, weight, count, mask[row : row + odds.shape[0], col : col + odds.shape[1]])
    left, top, width, height, area = stats[best].tolist()
    return mask, (left + col, top + row, width, height, area)


@numba.njit(cache=True, nogil=True)
def _mark_likeliest(labels, odds, weight, count, mask):
    score = np.zeros(count)
    for i in range(labels.shape[0]):
        for j in range(labels.shape[1]):
            if labels[i, j] > 0:
                score[labels[i, j]] += weight[i, j] * min(odds[i, j], np.float32(3))
    best = score.argmax()
    for i in range(labels.shape[0]):
        for j in range(labels.shape[1]):
            mask[i, j] = labels[i, j] == best
    return best


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
