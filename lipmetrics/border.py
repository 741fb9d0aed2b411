"""Where an opening's borders really run, near where the decoder put them: read off the picture across each border.

The canvas is straightened along a border, so that its rows run from the lip into the opening, and a small forest
(`lipmetrics.forest`) says for each column how far the border lies from the middle row. The lower border is seen upside
down, so that one forest serves both.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from lipmetrics.features import PAD
from lipmetrics.forest import Forest, log_odds

REACH = 4.0  # rows, the farthest that a border is moved
SEEN = (0, 2, 4, 6, 8, 10)  # of the fine maps: brightness and colours against the lips, and against the skin
# of the way that the forest says: simulated mouths hardly gain by more, and people draw real outlines farther out
SHARE = 0.5
COUNT = len(SEEN) + 5  # two kinds of log-odds, height, which border, distance from the end
UPPER, LOWER = 1, -1  # rows from the lip into the opening
ROWS = 2 * PAD[0] + 1


def moved(
    forest: Forest, maps: np.ndarray, odds: np.ndarray, origin: tuple[int, int], left: int, upper, lower
) -> tuple[np.ndarray, np.ndarray]:
    """Borders (n,) of an opening in the columns from `left` on, where the forest sees them; all in px of the canvas.

    maps, odds, origin : as in :func:`straightened`
    """
    found = []
    for border, side in ((upper, UPPER), (lower, LOWER)):
        seen = straightened(maps, odds, origin, left, upper, lower, side)
        answer = log_odds(forest, seen, PAD, (0, 1), (0, len(border)))[0, 0]
        off = np.tanh(0.5 * answer.astype(np.float64)) * SHARE * REACH
        # neighbours know the same border
        padded = np.concatenate([off[:1], off, off[-1:]])
        found.append(border + side * (padded[:-2] + 2 * padded[1:-1] + padded[2:]) / 4)
    above, below = found
    middle = (above + below) / 2
    return np.minimum(above, middle), np.maximum(below, middle)


def straightened(
    maps: np.ndarray, odds: np.ndarray, origin: tuple[int, int], left: int, upper, lower, side: int
) -> np.ndarray:
    """Maps (COUNT, ROWS, n + 2 PAD[1]) uint8 of a canvas, straightened along one border of an opening.

    Parameters
    ----------
    maps : (C, rows + 2 PAD[0], cols + 2 PAD[1]) uint8 of `lipmetrics.features.fine_maps`
    odds : (3, H, W) float32, log-odds of the whole canvas
    origin : row and column of the canvas where the region of the maps begins
    left : first column of the opening
    upper, lower : (n,) rows of its borders
    side : UPPER or LOWER
    """
    out = np.empty((COUNT, ROWS, len(upper) + 2 * PAD[1]), np.uint8)
    upper, lower = np.asarray(upper, np.float64), np.asarray(lower, np.float64)
    _straighten(maps, odds, np.array(SEEN), origin[0], origin[1], left, upper, lower, side, out)
    return out


@nb.njit(cache=True, nogil=True)
def _straighten(maps, odds, seen, row0, col0, left, upper, lower, side, out):
    rows, cols = maps.shape[1:]
    height, width = odds.shape[1:]
    count, kinds = len(upper), seen.size
    for j in range(out.shape[2]):
        c = j - PAD[1]
        k = min(max(c, 0), count - 1)
        border = upper[k] if side > 0 else lower[k]
        col = min(max(left + c - col0 + PAD[1], 0), cols - 1)
        odds_col = min(max(left + c, 0), width - 1)
        high = np.uint8(min(max(8 * (lower[k] - upper[k]), 0.0), 255.0))
        end = np.uint8(min(max(8 * min(c + 1, count - c) + 64, 0), 255))
        for r in range(out.shape[1]):
            row = border + side * (r - PAD[0])
            at = min(max(row - row0 + PAD[0], 0.0), rows - 1.001)
            i = int(at)
            part = at - i
            for m in range(kinds):
                line = maps[seen[m]]
                out[m, r, j] = np.uint8((1 - part) * line[i, col] + part * line[i + 1, col] + 0.5)
            at = min(max(row, 0.0), height - 1.001)
            i = int(at)
            part = at - i
            for m in range(2):
                value = (1 - part) * odds[m, i, odds_col] + part * odds[m, i + 1, odds_col]
                out[kinds + m, r, j] = np.uint8(min(max(128 + 24 * value, 0.0), 255.0))
            out[kinds + 2, r, j] = high
            out[kinds + 3, r, j] = 255 if side > 0 else 0
            out[kinds + 4, r, j] = end
