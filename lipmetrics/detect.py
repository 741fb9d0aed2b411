"""The methods by name, and looking into a part of the picture only."""

from __future__ import annotations

import difflib
import importlib
from dataclasses import replace

import numpy as np

from lipmetrics.errors import InputError
from lipmetrics.look import Look
from lipmetrics.pixels import averaged_region

# name -> module with make_detector(settings or None, info) -> object with .look(frame) -> Look and .settings
METHODS = {"default": "lipmetrics.lips", "thesis": "lipmetrics.mask"}


def make_detector(method: str, settings, info, roi: tuple[int, int, int, int] | None = None):
    """A detector for the frames of one clip, which must be given in order.

    Parameters
    ----------
    method : a name in `METHODS`
    settings : the method's frozen settings dataclass, or None for its defaults
    info : `lipmetrics.frames.VideoInfo` of the clip
    roi : (row0, row1, col0, col1), half open, px of the displayed picture; the method is shown nothing else

    Returns
    -------
    an object with ``.look(frame) -> lipmetrics.look.Look`` and ``.settings`` (the frozen dataclass in use)

    Raises
    ------
    InputError : unknown method, or a region that is not inside the picture
    """
    if method not in METHODS:
        near = difflib.get_close_matches(str(method), METHODS, n=1)
        hint = f"; did you mean '{near[0]}'?" if near else ""
        raise InputError(f"expected a method out of {', '.join(METHODS)}, got '{method}'{hint}")
    make = importlib.import_module(METHODS[method]).make_detector
    if roi is None:
        return make(settings, info)
    row0, row1, col0, col1 = roi
    if not (0 <= row0 < row1 <= info.height and 0 <= col0 < col1 <= info.width):
        raise InputError(
            f"expected a region inside the picture of {info.width} x {info.height} px, "
            f"got X,Y,W,H = {col0},{row0},{col1 - col0},{row1 - row0}; give one that fits"
        )
    return _InsideRegion(make(settings, replace(info, height=row1 - row0, width=col1 - col0)), roi)


class _Window:
    """The part of a frame inside a region, with the face of a frame."""

    def __init__(self, frame, roi):
        self._frame, self._roi = frame, roi
        self.index, self.time_s = frame.index, frame.time_s
        self.height, self.width = roi[1] - roi[0], roi[3] - roi[2]

    def rgb(self, region=None) -> np.ndarray:
        return self._frame.rgb(self._in_picture(region or (0, self.height, 0, self.width)))

    def averaged(self, region, block: tuple[int, int]) -> np.ndarray:
        return averaged_region(self._frame, self._in_picture(region), block)

    def _in_picture(self, region) -> tuple[int, int, int, int]:
        top, left = self._roi[0], self._roi[2]
        row0, row1, col0, col1 = region
        return top + row0, top + row1, left + col0, left + col1


class _InsideRegion:
    """A detector that sees a region only and answers in coordinates of the whole picture."""

    def __init__(self, detector, roi):
        self._detector, self._roi = detector, roi
        self.settings = getattr(detector, "settings", None)

    def look(self, frame) -> Look:
        look = self._detector.look(_Window(frame, self._roi))
        shift = np.array([self._roi[0], self._roi[2]], float)
        return Look(look.status, [outline + shift for outline in look.outlines], look.corners + shift, look.confidence)
