"""Between pixel masks and polygons, exact to the pixel edge.

A mask pixel (r, c) covers r-0.5 .. r+0.5 by c-0.5 .. c+0.5. An outline runs along those edges, so a region n pixels
wide measures width n and its polygon's area is its number of pixels; a contour through pixel centres would lose one.
"""

from __future__ import annotations

import cv2
import numba
import numpy as np


def trace_outlines(mask: np.ndarray, min_area_px: int = 1) -> list[np.ndarray]:
    """Outlines of the regions of a mask, largest region first.

    Parameters
    ----------
    mask : (H, W) bool; a region is a 4-connected set of True pixels, holes in it are filled
    min_area_px : regions of fewer pixels are left out

    Returns
    -------
    one polygon per region, each (n, 2) float64 (row, column) in px, clockwise in the picture, corners only
    """
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    regions = [k for k in range(1, count) if stats[k, cv2.CC_STAT_AREA] >= min_area_px]
    regions.sort(key=lambda k: -stats[k, cv2.CC_STAT_AREA])
    outlines = []
    for k in regions:
        left, top, width, height = stats[k, :4]
        region = labels[top : top + height, left : left + width] == k
        outlines.append(np.add(_walk_edges(region), (top - 0.5, left - 0.5)))
    return outlines


def fill_outlines(outlines: list[np.ndarray], shape: tuple[int, int]) -> np.ndarray:
    """Mask (H, W) bool of the pixels whose centre lies inside one of the polygons, (n, 2) (row, column) each."""
    mask = np.zeros(shape, bool)
    for outline in outlines:
        inside = np.zeros(shape, np.bool_)
        _fill_even_odd(np.ascontiguousarray(outline, np.float64), inside)
        mask |= inside
    return mask


@numba.njit(cache=True)
def _walk_edges(region):
    """Corners (n, 2) of the outer border of the region that holds the first True pixel; pixel (r, c) spans r..r+1."""
    height, width = region.shape
    start = 0
    while not region[0, start]:
        start += 1
    # Walk with the region on the right hand: east along the top edge of its first pixel to begin with.
    row, col, d_row, d_col = 0, start, 0, 1
    rows, cols = [0.0], [float(start)]
    while True:
        row += d_row
        col += d_col
        # the two pixels in front of this corner, to the right and to the left of the walking direction
        right_row, right_col = row + (d_row + d_col - 1) // 2, col + (d_col - d_row - 1) // 2
        left_row, left_col = row + (d_row - d_col - 1) // 2, col + (d_col + d_row - 1) // 2
        right = 0 <= right_row < height and 0 <= right_col < width and region[right_row, right_col]
        left = 0 <= left_row < height and 0 <= left_col < width and region[left_row, left_col]
        if right and not left:
            continue
        if row == 0 and col == start:
            break
        rows.append(float(row))
        cols.append(float(col))
        if right:
            d_row, d_col = -d_col, d_row  # turn left, away from the pixel in front
        else:
            d_row, d_col = d_col, -d_row  # turn right; first choice where two pixels touch by a corner only
    corners = np.empty((len(rows), 2))
    for k in range(len(rows)):
        corners[k, 0] = rows[k]
        corners[k, 1] = cols[k]
    return corners


@numba.njit(cache=True)
def _fill_even_odd(outline, inside):
    """Flip every pixel to the right of each polygon edge, row by row: an odd number of flips is inside."""
    height, width = inside.shape
    for k in range(len(outline)):
        row_a, col_a = outline[k - 1]
        row_b, col_b = outline[k]
        if row_a == row_b:
            continue
        if row_a > row_b:
            row_a, col_a, row_b, col_b = row_b, col_b, row_a, col_a
        for row in range(max(0, int(np.ceil(row_a))), min(height, int(np.ceil(row_b)))):
            crossing = col_a + (row - row_a) * (col_b - col_a) / (row_b - row_a)
            for col in range(max(0, int(np.ceil(crossing))), width):
                inside[row, col] = not inside[row, col]
