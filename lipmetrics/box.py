"""Where the mouth is believed to be, and the small upright canvas laid over that place."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from lipmetrics.pixels import averaged

CANVAS = (112, 128)  # rows, columns of the fine canvas
COARSE = (63, 72)  # the same cut of the picture, for the coarse stage
MOUTH = 64  # columns of the fine canvas that a mouth fills from corner to corner


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
        """Picture px per canvas px."""
        return self.width_px / MOUTH

    def to_picture(self, points: np.ndarray) -> np.ndarray:
        """Canvas points (n, 2) (row, column) in the picture."""
        points = np.asarray(points, float)
        rows, cols = points[:, 0] - (CANVAS[0] - 1) / 2, points[:, 1] - (CANVAS[1] - 1) / 2
        cos, sin = self.scale * math.cos(self.roll_rad), self.scale * math.sin(self.roll_rad)
        out = np.empty(points.shape)
        out[:, 0] = self.row + rows * cos + cols * sin
        out[:, 1] = self.col + cols * cos - rows * sin
        return out

    def to_canvas(self, points: np.ndarray) -> np.ndarray:
        """Picture points (n, 2) (row, column) on the canvas."""
        rows, cols = ((np.asarray(points, float) - (self.row, self.col)) / self.scale).T
        cos, sin = np.cos(self.roll_rad), np.sin(self.roll_rad)
        return np.column_stack([rows * cos - cols * sin, cols * cos + rows * sin]) + (np.array(CANVAS) - 1) / 2


def lay_canvas(frame, box: Box, size: tuple[int, int] = CANVAS) -> np.ndarray | None:
    """Cut the canvas of `box` out of a frame: (rows, columns, 3) uint8 RGB of `size`, None if it misses the picture.

    Only the part of the frame under the canvas is converted to RGB. Beyond the picture its edge is repeated.
    """
    cos, sin = math.cos(box.roll_rad), math.sin(box.roll_rad)
    high, wide = box.scale * (CANVAS[0] - 1) / 2, box.scale * (CANVAS[1] - 1) / 2
    down, across = high * abs(cos) + wide * abs(sin), wide * abs(cos) + high * abs(sin)
    margin = 2 + box.scale
    # an even start keeps blocks of pixels together that share their chroma
    row0, row1 = (
        max(math.floor(box.row - down - margin), 0) & -2,
        min(math.ceil(box.row + down + margin) + 1, frame.height),
    )
    col0, col1 = (
        max(math.floor(box.col - across - margin), 0) & -2,
        min(math.ceil(box.col + across + margin) + 1, frame.width),
    )
    if row1 - row0 < 2 or col1 - col0 < 2:
        return None
    step = box.scale * CANVAS[1] / size[1]  # picture px per px of the result
    # averaging first: picking every n-th pixel would alias
    shrink = min(max(1, int(step)), row1 - row0, col1 - col0)
    patch = _averaged(frame, (row0, row1, col0, col1), shrink)
    # canvas (x, y) to picture (x, y) to patch
    x, y = (size[1] - 1) / 2, (size[0] - 1) / 2
    left = (box.col - col0 - step * (cos * x - sin * y) + 0.5) / shrink - 0.5
    top = (box.row - row0 - step * (sin * x + cos * y) + 0.5) / shrink - 0.5
    ratio = step / shrink
    return cv2.warpAffine(
        patch,
        np.array([[ratio * cos, -ratio * sin, left], [ratio * sin, ratio * cos, top]]),
        (size[1], size[0]),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )


def _averaged(frame, region: tuple[int, int, int, int], shrink: int) -> np.ndarray:
    """Means over shrink x shrink px of a region, by the frame itself if it knows a short way; RGB uint8."""
    if hasattr(frame, "averaged"):
        return frame.averaged(region, shrink)
    return averaged(frame.rgb(region), shrink)
