"""Places in a picture where the mouth could be, likeliest first."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import cv2

from lipmetrics.box import Box

FACE_SIDE = 320  # px of the longer side in which faces are searched
CASCADES = (
    "haarcascade_frontalface_alt2.xml",
    "haarcascade_frontalface_default.xml",
)  # the second if the first is blind
IN_FACE, IN_FACE_SPREAD = (0.81, 0.5, 0.4), (0.08, 0.12, 0.35)  # down, across, width: of a face box
IN_PICTURE, IN_PICTURE_SPREAD = (0.55, 0.5, 0.45), (0.3, 0.3, 0.7)  # the same of a picture in which no face is seen
FACE_STARTS = tuple(product((-0.05, 0.04), (-0.07, 0.07)))  # added to down and to width
WIDTHS = ((0.72, 0.52, 0.38), (0.27, 0.19))  # of a mouth, shares of the picture's width, where no face is seen
STRIDE = 0.4  # of the grid of such mouths, mouth widths


@dataclass(frozen=True)
class Place:
    """Boxes to try, in a face or in the whole picture.

    rectangle : (left, top, width, height) px of the face, or of the picture; mouth : where in it the middle of a mouth
    lies, (down, across), and how wide it is, all as shares; spread : of the three, the last as a logarithm; least : the
    likelihood of the unlikeliest place
    """

    boxes: list[Box]
    rectangle: tuple[float, float, float, float]
    mouth: tuple[float, float, float]
    spread: tuple[float, float, float]
    least: float
    is_face: bool

    def likelihood(self, box: Box) -> float:
        """How likely a mouth sits there, judged by place and size alone, 0 to 1."""
        left, top, width, height = self.rectangle
        down = ((box.row - top) / height - self.mouth[0]) / self.spread[0]
        across = ((box.col - left) / width - self.mouth[1]) / self.spread[1]
        wide = math.log(box.width_px / width / self.mouth[2]) / self.spread[2]
        return self.least + (1 - self.least) * math.exp(-0.5 * (down**2 + across**2 + wide**2))


@lru_cache(maxsize=2)
def _cascade(name: str) -> cv2.CascadeClassifier:
    return cv2.CascadeClassifier(cv2.data.haarcascades + name)


def faces(frame) -> list[tuple[float, float, float, float]]:
    """Frontal faces (left, top, width, height) in px of the picture, largest first."""
    shrink = max(1.0, max(frame.height, frame.width) / FACE_SIDE)
    picture = frame.rgb()
    if shrink > 1:
        picture = cv2.resize(picture, None, fx=1 / shrink, fy=1 / shrink, interpolation=cv2.INTER_AREA)
    if min(picture.shape[:2]) < 40:
        return []
    grey = cv2.equalizeHist(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))
    for name in CASCADES:
        found = _cascade(name).detectMultiScale(grey, scaleFactor=1.1, minNeighbors=3, minSize=(40, 40))
        if len(found):
            return [tuple(float(side) * shrink for side in face) for face in sorted(found, key=lambda face: -face[2])]
    return []


def places(frame) -> Iterator[Place]:
    """Where to look for the mouth: in the faces seen, then at any size anywhere."""
    down, across, wide = IN_FACE
    for face in faces(frame)[:3]:
        left, top, width, height = face
        boxes = [
            Box(top + (down + lower) * height, left + across * width, (wide + wider) * width)
            for lower, wider in FACE_STARTS
        ]
        yield Place(boxes, face, IN_FACE, IN_FACE_SPREAD, least=0.0, is_face=True)
    picture = (0.0, 0.0, float(frame.width), float(frame.height))
    for shares in WIDTHS:
        boxes = [box for share in shares for box in _grid(frame, share * min(frame.width, 1.6 * frame.height))]
        if boxes:
            yield Place(boxes, picture, IN_PICTURE, IN_PICTURE_SPREAD, least=0.5, is_face=False)


def _grid(frame, width_px: float) -> list[Box]:
    """Boxes of one size over the picture, from its middle outwards."""
    if width_px < 16:
        return []
    rows = _line(frame.height, 0.45 * width_px, STRIDE * width_px)
    cols = _line(frame.width, 0.6 * width_px, STRIDE * width_px)
    boxes = [Box(row, col, width_px) for row, col in product(rows, cols)]
    middle = ((frame.height - 1) / 2, (frame.width - 1) / 2)
    return sorted(boxes, key=lambda box: abs(box.row - middle[0]) + abs(box.col - middle[1]))


def _line(length: int, margin: float, stride: float) -> list[float]:
    """Evenly spaced places between the margins, the middle alone where there is no room."""
    room = length - 1 - 2 * margin
    if room <= stride:
        return [(length - 1) / 2]
    steps = int(room // stride) + 1
    return [margin + room * k / steps for k in range(steps + 1)]
