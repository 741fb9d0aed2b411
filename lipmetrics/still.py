"""One picture instead of a clip: what a method says about it, its openings, its mask."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lipmetrics.detect import make_detector
from lipmetrics.errors import InputError
from lipmetrics.frames import VideoInfo
from lipmetrics.look import OPEN, Look
from lipmetrics.openings import Opening, measure_outline
from lipmetrics.outline import fill_outlines


def look_at(picture: np.ndarray, *, method: str = "default", settings=None) -> Look:
    """What a method says about one (H, W, 3) uint8 RGB picture.

    Raises
    ------
    InputError : another shape or type, unknown method
    """
    if getattr(picture, "dtype", None) != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or not picture.size:
        shape, dtype = getattr(picture, "shape", type(picture).__name__), getattr(picture, "dtype", "no dtype")
        raise InputError(f"expected one (H, W, 3) uint8 RGB picture, got {shape} {dtype}; convert it first")
    height, width = picture.shape[:2]
    info = VideoInfo(
        path="",
        kind="images",
        width=width,
        height=height,
        rotation_deg=0,
        mirrored=False,
        pixel_aspect=1.0,
        time_base="",
        codec="",
        pixel_format="rgb24",
        nominal_fps=float("nan"),
        has_audio=False,
        duration_s=float("nan"),
    )
    return make_detector(method, settings, info).look(_Still(np.ascontiguousarray(picture)))


def opening_mask(picture: np.ndarray, *, method: str = "default", settings=None) -> np.ndarray:
    """Where the mouth is open in one (H, W, 3) uint8 RGB picture: (H, W) bool, all False when closed or not found.

    Raises InputError as `look_at` does.
    """
    look = look_at(picture, method=method, settings=settings)
    return fill_outlines(look.outlines if look.status == OPEN else [], picture.shape[:2])


def find_openings(picture: np.ndarray, *, method: str = "default", settings=None) -> list[Opening]:
    """The openings in one (H, W, 3) uint8 RGB picture, one `lipmetrics.openings.Opening` each, largest first.

    Raises InputError as `look_at` does.
    """
    look = look_at(picture, method=method, settings=settings)
    found = [measure_outline(outline) for outline in look.outlines] if look.status == OPEN else []
    return sorted(found, key=lambda opening: -opening.area_px)


@dataclass(frozen=True)
class _Still:
    """One picture with the face of `lipmetrics.frames.Frame`."""

    picture: np.ndarray
    index: int = 0
    time_s: float = 0.0

    @property
    def height(self) -> int:
        return self.picture.shape[0]

    @property
    def width(self) -> int:
        return self.picture.shape[1]

    def rgb(self, region=None) -> np.ndarray:
        if region is None:
            return self.picture
        row0, row1, col0, col1 = region
        return self.picture[row0:row1, col0:col1]
