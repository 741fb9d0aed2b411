"""Where the mouth is believed to be, and the small upright canvas laid over that place."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

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
        rows, cols = (np.asarray(points, float) - (np.array(CANVAS) - 1) / 2).T * self.scale
        cos, sin = np.cos(self.roll_rad), np.sin(self.roll_rad)
        return np.column_stack([self.row + rows * cos + cols * sin, self.col + cols * cos - rows * sin])

    def to_canvas(self, points: np.ndarray) -> np.ndarray:
        """Picture points (n, 2) (row, column) on the canvas."""
        rows, cols = ((np.asarray(points, float) - (self.row, self.col)) / self.scale).T
        cos, sin = np.cos(self.roll_rad), np.sin(self.roll_rad)
        return np.column_stack([rows * cos - cols * sin, cols * cos + rows * sin]) + (np.array(CANVAS) - 1) / 2


def lay_canvas(frame, box: Box, size: tuple[int, int] = CANVAS) -> np.ndarray | None:
    """Cut the canvas of `box` out of a frame: (rows, columns, 3) uint8 RGB of `size`, None if it misses the picture.

    Only the part of the frame under the canvas is converted to RGB. Beyond the picture its edge is repeated.
    """
    high, wide = CANVAS[0] - 1, CANVAS[1] - 1
    hull = box.to_picture(np.array([(0, 0), (0, wide), (high, 0), (high, wide)]))
    margin = 2 + box.scale
    low = np.floor(hull.min(axis=0) - margin).astype(int)
    top = np.ceil(hull.max(axis=0) + margin).astype(int) + 1
    row0, col0 = np.maximum(low, 0)
    row1, col1 = np.minimum(top, (frame.height, frame.width))
    if row1 - row0 < 2 or col1 - col0 < 2:
        return None
    patch = frame.rgb((int(row0), int(row1), int(col0), int(col1)))
    step = box.scale * CANVAS[1] / size[1]  # picture px per px of the result
    shrink = max(1, int(step))  # averaging first: picking every n-th pixel would alias
    if shrink > 1:
        small = (max(1, patch.shape[1] // shrink), max(1, patch.shape[0] // shrink))
        patch = cv2.resize(patch[: small[1] * shrink, : small[0] * shrink], small, interpolation=cv2.INTER_AREA)
    cos, sin = np.cos(box.roll_rad), np.sin(box.roll_rad)
    turn = step * np.array([[cos, -sin], [sin, cos]])  # canvas (x, y) to picture (x, y)
    middle = np.array([(size[1] - 1) / 2, (size[0] - 1) / 2])
    offset = np.array([box.col - col0, box.row - row0]) - turn @ middle
    matrix = np.column_stack([turn / shrink, (offset + 0.5) / shrink - 0.5])
    return cv2.warpAffine(
        patch,
        matrix,
        (size[1], size[0]),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
