"""Drawn faces for tests of the default method, the truth about them, and frames as a reader would give them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lipmetrics.artificial import Camera, Drawing, Face, Shape, draw
from lipmetrics.outline import fill_outlines

PLAIN = Face(jaw_width=2.3)


def opened(height_mw: float, **shape) -> Shape:
    """A mouth open by `height_mw` mouth widths, a third of it above the line of the lips."""
    return Shape(gap=(height_mw / 3, 2 * height_mw / 3), **shape)


def plain(shape: Shape, size=(200, 260), px_per_mouth=90.0, centre=None, roll_rad=0.0, seed=0, face=PLAIN) -> Drawing:
    """The plain face with this mouth, taken by a good camera."""
    face = replace(face, shape=shape, chin_y=face.chin_y + 0.8 * shape.gap[1])
    rng = np.random.default_rng(seed)
    return draw(face, size, px_per_mouth, centre, roll_rad, Camera(noise=0.005), rng, supersample=1)


def overlap(outlines: list[np.ndarray], opening: np.ndarray) -> float:
    """Intersection over union of outlines, (n, 2) (row, column) px each, and what is opening, (H, W) shares; 1 if both
    are empty."""
    seen, true = fill_outlines(outlines, opening.shape), opening > 0.5
    either = np.count_nonzero(seen | true)
    return np.count_nonzero(seen & true) / either if either else 1.0


class AskedFrame:
    """A picture with the face of `lipmetrics.frames.Frame`; `asked` lists the regions that were asked for."""

    def __init__(self, picture: np.ndarray, index: int = 0):
        self.picture, self.index, self.time_s, self.asked = picture, index, index / 25, []
        self.height, self.width = picture.shape[:2]

    def rgb(self, region=None) -> np.ndarray:
        self.asked.append(region)
        row0, row1, col0, col1 = region or (0, self.height, 0, self.width)
        assert 0 <= row0 < row1 <= self.height
        assert 0 <= col0 < col1 <= self.width
        return self.picture[row0:row1, col0:col1]
