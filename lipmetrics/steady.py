"""Evidence that lasts: noise is not movement, so where the picture stays the same the log-odds change little."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def steady(canvas, odds, region, before, odds_before, region_before, back, keep, change):
    """Draw log-odds towards those of the frame before, in place: odds += weight (odds_before - odds).

    The weight falls from `keep`, up to a change of `change` grey levels (green, mean of 3 x 3 px), to 0 at twice it.

    canvas, before : (rows, cols, 3) uint8, now and in the frame before; odds, odds_before : (K, rows, cols) float32
    region, region_before : half open (row0, row1, col0, col1) in which the log-odds were made, and are drawn
    back : (2, 3), from (row, column, 1) on this canvas to (row, column) of the same place on the one before
    """
    height, width = canvas.shape[:2]
    row0, row1, col0, col1 = region
    seen0, seen1, left, right = region_before
    top, bottom, first, last = max(row0 - 1, 0), min(row1 + 1, height), max(col0 - 1, 0), min(col1 + 1, width)
    changes = np.zeros((row1 - row0 + 2, col1 - col0 + 2), np.float32)  # a px more on each side
    rows, cols = np.empty(changes.shape, np.float32), np.empty(changes.shape, np.float32)
    for i in range(top, bottom):
        for j in range(first, last):
            row = np.float32(back[0, 0] * i + back[0, 1] * j + back[0, 2])
            col = np.float32(back[1, 0] * i + back[1, 1] * j + back[1, 2])
            rows[i - row0 + 1, j - col0 + 1], cols[i - row0 + 1, j - col0 + 1] = row, col
            row, col = (
                min(max(row, np.float32(0)), np.float32(height - 1)),
                min(max(col, np.float32(0)), np.float32(width - 1)),
            )
            r, c = min(int(row), height - 2), min(int(col), width - 2)
            down, across = row - np.float32(r), col - np.float32(c)
            upper = before[r, c, 1] + across * (np.float32(before[r, c + 1, 1]) - np.float32(before[r, c, 1]))
            lower = before[r + 1, c, 1] + across * (
                np.float32(before[r + 1, c + 1, 1]) - np.float32(before[r + 1, c, 1])
            )
            changes[i - row0 + 1, j - col0 + 1] = abs(np.float32(canvas[i, j, 1]) - upper - down * (lower - upper))
    for i in range(row0, row1):
        for j in range(col0, col1):
            row, col = rows[i - row0 + 1, j - col0 + 1], cols[i - row0 + 1, j - col0 + 1]
            if not (seen0 <= row <= seen1 - 1 and left <= col <= right - 1):
                continue
            total = np.float32(0)
            for a in range(3):
                for b in range(3):
                    total += changes[i - row0 + a, j - col0 + b]
            n = (min(i + 2, height) - max(i - 1, 0)) * (min(j + 2, width) - max(j - 1, 0))
            weight = np.float32(keep * min(max(2.0 - total / (n * change), 0.0), 1.0))
            if weight == 0:
                continue
            r, c = max(min(int(row), seen1 - 2), seen0), max(min(int(col), right - 2), left)
            down, across = row - np.float32(r), col - np.float32(c)
            for k in range(odds.shape[0]):
                old = odds_before[k]
                upper = old[r, c] + across * (old[r, c + 1] - old[r, c])
                lower = old[r + 1, c] + across * (old[r + 1, c + 1] - old[r + 1, c])
                odds[k, i, j] += weight * (upper + down * (lower - upper) - odds[k, i, j])
