"""Where the mouth is believed to be, and the small upright canvas laid over that place."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numba
import numpy as np

from lipmetrics.pixels import averaged_region

CANVAS = (112, 64)  # rows, columns of the fine canvas
COARSE = (63, 36)  # the same cut of the picture, for the coarse stage
ASPECT = 2  # a canvas px is so many times as wide as high: lips run along the rows, so fewer columns tell as much
MOUTH = 32  # columns of the fine canvas that a mouth fills from corner to corner


@dataclass(frozen=True)
class Box:
    """A mouth in the picture: centre of the lips (row, column), width from corner to corner in px, and tilt.

    roll_rad : positive when the mouth's right end (in the picture) is lower
    """

    row: float
    col: float
    width_px: float
    roll_rad: float = 0.0

    @property
    def scale(self) -> float:
        """Picture px per row of the canvas; a column is ASPECT times as wide."""
        return self.width_px / (MOUTH * ASPECT)

    def to_picture(self, points: np.ndarray) -> np.ndarray:
        """Canvas points (n, 2) (row, column) in the picture."""
        points = np.asarray(points, float)
        rows, cols = points[:, 0] - (CANVAS[0] - 1) / 2, ASPECT * (points[:, 1] - (CANVAS[1] - 1) / 2)
        cos, sin = self.scale * math.cos(self.roll_rad), self.scale * math.sin(self.roll_rad)
        out = np.empty(points.shape)
        out[:, 0] = self.row + rows * cos + cols * sin
        out[:, 1] = self.col + cols * cos - rows * sin
        return out

    def to_canvas(self, points: np.ndarray) -> np.ndarray:
        """Picture points (n, 2) (row, column) on the canvas."""
        rows, cols = ((np.asarray(points, float) - (self.row, self.col)) / self.scale).T
        cos, sin = np.cos(self.roll_rad), np.sin(self.roll_rad)
        upright = np.column_stack([rows * cos - cols * sin, (cols * cos + rows * sin) / ASPECT])
        return upright + (np.array(CANVAS) - 1) / 2

    def place(self, row: float, col: float) -> tuple[float, float]:
        """One canvas point in the picture, as :meth:`to_picture`; its preparations take longer than a point does."""
        down, across = row - (CANVAS[0] - 1) / 2, ASPECT * (col - (CANVAS[1] - 1) / 2)
        cos, sin = self.scale * math.cos(self.roll_rad), self.scale * math.sin(self.roll_rad)
        return self.row + down * cos + across * sin, self.col + across * cos - down * sin

    def onto(self, other: Box) -> np.ndarray:
        """Matrix (2, 3) that takes (row, column, 1) on this canvas to (row, column) of the same place on another's."""
        shrink, turn = self.scale / other.scale, self.roll_rad - other.roll_rad
        cos, sin = shrink * math.cos(turn), shrink * math.sin(turn)
        middle_row, middle_col = (CANVAS[0] - 1) / 2, (CANVAS[1] - 1) / 2
        down, across = (self.row - other.row) / other.scale, (self.col - other.col) / other.scale
        other_cos, other_sin = math.cos(other.roll_rad), math.sin(other.roll_rad)
        rows = down * other_cos - across * other_sin + middle_row - cos * middle_row - ASPECT * sin * middle_col
        cols = (across * other_cos + down * other_sin + sin * middle_row) / ASPECT + middle_col - cos * middle_col
        return np.array([(cos, ASPECT * sin, rows), (-sin / ASPECT, cos, cols)])


def lay_canvas(frame, box: Box, size: tuple[int, int] = CANVAS) -> np.ndarray | None:
    """Cut the canvas of `box` out of a frame: (rows, columns, 3) uint8 RGB of `size`, None if it misses the picture.

    Only the part of the frame under the canvas is converted to RGB. Beyond the picture its edge is repeated.
    """
    cos, sin = math.cos(box.roll_rad), math.sin(box.roll_rad)
    high, wide = box.scale * (CANVAS[0] - 1) / 2, box.scale * (CANVAS[1] * ASPECT - 1) / 2
    down, across = high * abs(cos) + wide * abs(sin), wide * abs(cos) + high * abs(sin)
    step = box.scale * CANVAS[0] / size[0]  # picture px per row of the result
    wide_step = ASPECT * step  # and per column
    margin = 2 + wide_step
    # from even rows and columns on, where samples of colour begin
    row0, col0 = max(math.floor(box.row - down - margin) & -2, 0), max(math.floor(box.col - across - margin) & -2, 0)
    row1 = min(math.ceil(box.row + down + margin) + 1, frame.height)
    col1 = min(math.ceil(box.col + across + margin) + 1, frame.width)
    if row1 - row0 < 2 or col1 - col0 < 2:
        return None
    # averaging first: picking every n-th pixel would alias
    high, wide = min(max(1, int(step)), row1 - row0), min(max(1, int(wide_step)), col1 - col0)
    patch = averaged_region(frame, (row0, row1, col0, col1), (high, wide))
    # canvas (x, y) to picture (x, y) to patch
    x, y = (size[1] - 1) / 2, (size[0] - 1) / 2
    left = (box.col - col0 - wide_step * cos * x + step * sin * y + 0.5) / wide - 0.5
    top = (box.row - row0 - wide_step * sin * x - step * cos * y + 0.5) / high - 0.5
    return cv2.warpAffine(
        patch,
        np.array(
            [[wide_step * cos / wide, -step * sin / wide, left], [wide_step * sin / high, step * cos / high, top]]
        ),
        (size[1], size[0]),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )


def nine_of_sixteen(picture: np.ndarray) -> np.ndarray:
    """A picture (16 m, 16 n, 3) uint8 averaged over its area down to (9 m, 9 n, 3), as CANVAS is to COARSE."""
    rows, cols = 9 * picture.shape[0] // 16, 9 * picture.shape[1] // 16
    out = np.empty((rows, cols, 3), np.uint8)
    _nine_of_sixteen(picture.reshape(len(picture), -1), out.reshape(rows, -1))
    return out


@numba.njit(cache=True, nogil=True)
def _nine_of_sixteen(picture, out):
    """A pixel of the result covers 16 ninths of a pixel, which lie in 2 or 3 pixels; rows of both are flat."""
    down, width = np.empty(picture.shape[1] + 3, np.uint16), picture.shape[1]
    for i in range(out.shape[0]):
        down[:] = 0
        for r in range(16 * i // 9, (16 * i + 15) // 9 + 1):
            share = np.uint16(min(9 * r + 9, 16 * i + 16) - max(9 * r, 16 * i))
            line = picture[r]
            for j in range(width):
                down[j] += share * line[j]
        line = out[i]
        for j in range(line.size // 3):
            c = 16 * j // 9
            first = 9 * c + 9 - 16 * j
            second = min(9, 16 - first)
            third = 16 - first - second  # 0 where the pixel ends with the second
            for k in range(3):
                at = 3 * c + k
                total = first * down[at] + second * down[at + 3] + third * down[min(at + 6, width)]
                line[3 * j + k] = (total + 127 + (total >> 8 & 1)) >> 8  # a half goes to the even number, as in OpenCV
