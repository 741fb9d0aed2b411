"""Size and place of polygons, and masks of them.

`lipmetrics` measures its outlines by the same definitions in code of its own, so that a slip in one of the two shows.
"""

from __future__ import annotations

import numba
import numpy as np

SIZES = ("row_min", "row_max", "col_min", "col_max", "width", "height", "area", "centroid_row", "centroid_col")


def measure(points: np.ndarray, start: np.ndarray) -> np.ndarray:
    """The numbers of `SIZES` of polygons, (K, 9) float64.

    Width is the extent along the columns. Height is the length inside the polygon of the fullest column, not the extent
    along the rows: a mouth that smiles or is tilted is not higher for it. The centroid is that of the area.

    Parameters
    ----------
    points : (P, 2) (row, column) of all corners, one polygon after the other; each simple, its last corner not repeated
    start : (K + 1,) polygon k has corners start[k] up to start[k + 1]
    """
    return _measure(np.ascontiguousarray(points, np.float64), np.asarray(start, np.int64))


def mask(polygons: list[np.ndarray], shape: tuple[int, int]) -> np.ndarray:
    """(rows, columns) bool: pixels whose centre lies in one of the polygons, (n, 2) (row, column) each."""
    inside = np.zeros(shape, bool)
    for polygon in polygons:
        p, q = polygon, np.roll(polygon, -1, axis=0)
        first, stop = np.clip(np.ceil([p[:, 0].min(), p[:, 0].max()]).astype(int), 0, shape[0])
        row = np.arange(first, stop)
        # edges that reach from one side of the row to the other, each with the first pixel to the right of it
        at, edge = np.nonzero((p[:, 0] <= row[:, None]) != (q[:, 0] <= row[:, None]))
        part = (row[at] - p[edge, 0]) / (q[edge, 0] - p[edge, 0])
        column = np.ceil(p[edge, 1] + part * (q[edge, 1] - p[edge, 1])).astype(int)
        crossed = np.zeros((len(row), shape[1] + 1), np.int64)
        np.add.at(crossed, (at, np.clip(column, 0, shape[1])), 1)
        inside[first:stop] |= np.cumsum(crossed, axis=1)[:, :-1] % 2 == 1
    return inside


@numba.njit(cache=True, nogil=True)
def _measure(points, start):
    sizes = np.empty((len(start) - 1, 9))
    for k in range(len(start) - 1):
        polygon = points[start[k] : start[k + 1]]
        n = len(polygon)
        top, bottom, left, right = np.inf, -np.inf, np.inf, -np.inf
        for i in range(n):
            top, bottom = min(top, polygon[i, 0]), max(bottom, polygon[i, 0])
            left, right = min(left, polygon[i, 1]), max(right, polygon[i, 1])
        # Shoelace formula about the middle of the box, which keeps the products small.
        row0, col0 = (top + bottom) / 2, (left + right) / 2
        twice, row, col = 0.0, 0.0, 0.0
        for i in range(n):
            y0, x0, y1, x1 = (
                polygon[i - 1, 0] - row0,
                polygon[i - 1, 1] - col0,
                polygon[i, 0] - row0,
                polygon[i, 1] - col0,
            )
            cross = x0 * y1 - x1 * y0
            twice += cross
            row += (y0 + y1) * cross
            col += (x0 + x1) * cross
        sizes[k, 0], sizes[k, 1], sizes[k, 2], sizes[k, 3] = top, bottom, left, right
        sizes[k, 4], sizes[k, 5], sizes[k, 6] = right - left, _fullest_column(polygon), abs(twice) / 2
        sizes[k, 7], sizes[k, 8] = row0 + row / (3 * twice), col0 + col / (3 * twice)
    return sizes


@numba.njit(cache=True, nogil=True)
def _fullest_column(polygon):
    """Largest total length inside the polygon of one column: it is at a corner, on one of the corner's two sides.

    Edges that a column crosses alternate in direction, so the length is the sum of their rows signed by direction.
    """
    longest = 0.0
    for k in range(len(polygon)):
        column = polygon[k, 1]
        before, behind = 0.0, 0.0
        for i in range(len(polygon)):
            y0, x0, y1, x1 = polygon[i - 1, 0], polygon[i - 1, 1], polygon[i, 0], polygon[i, 1]
            if x0 == x1 or column < min(x0, x1) or column > max(x0, x1):
                continue
            row = y0 + (y1 - y0) * ((column - x0) / (x1 - x0))
            signed = row if x1 > x0 else -row
            if column > min(x0, x1):
                before += signed
            if column < max(x0, x1):
                behind += signed
        longest = max(longest, abs(before), abs(behind))
    return longest
