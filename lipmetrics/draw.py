"""Outlines, corners and text drawn into RGB pictures; what the overlay and the contact sheet share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from lipmetrics.errors import InputError
from lipmetrics.profile import Profile

# One colour per opening identity, told apart from one another and from skin, lips and teeth.
COLOURS = ((0, 229, 255), (255, 220, 0), (255, 70, 210), (120, 255, 40), (255, 140, 0), (150, 120, 255))
CORNER_COLOUR = (255, 255, 255)
TEXT_COLOUR = (235, 235, 235)
QUIET_COLOUR = (150, 150, 150)
STRIP_COLOUR = (24, 24, 24)

_FONT = cv2.FONT_HERSHEY_DUPLEX
_SUBPIXEL_BITS = 4


@dataclass(frozen=True)
class View:
    """Where source pixels land in the drawn picture: `scale` times (row - row0, col - col0), pixel centres kept."""

    scale: float = 1.0
    row0: float = 0.0
    col0: float = 0.0

    def to_drawn(self, points: np.ndarray) -> np.ndarray:
        """(n, 2) (row, column) in source px -> (n, 2) (row, column) in drawn px."""
        return (np.asarray(points, float) - (self.row0, self.col0) + 0.5) * self.scale - 0.5


@dataclass(frozen=True)
class Found:
    """What a profile holds about one frame.

    row : the frame's row of ``profile.frames``, as a named tuple
    outlines, identities : one (n, 2) polygon of (row, column) and one identity per opening
    corners : (2, 2) (row, column), NaN where unknown
    """

    row: Any
    outlines: list[np.ndarray]
    identities: list[int]
    corners: np.ndarray


def found_by_frame(profile: Profile) -> dict[int, Found]:
    """What `profile` holds, by frame index.

    Raises
    ------
    InputError : the profile has no outlines, as one that was read back from its files
    """
    if len(profile.outlines) != len(profile.frames):
        raise InputError("expected a profile with outlines, got one without; measure the clip with keep_outlines=True")
    identities: dict[int, list[int]] = {}
    for frame, identity in zip(profile.openings["frame"], profile.openings["opening"], strict=True):
        identities.setdefault(int(frame), []).append(int(identity))
    rows = profile.frames.astype({"n_openings": float}).itertuples(index=False)
    return {
        int(row.frame): Found(row, outlines, identities.get(int(row.frame), []), corners)
        for row, outlines, corners in zip(rows, profile.outlines, profile.corners, strict=True)
    }


def mouth_width_px(profile: Profile) -> float:
    """Mouth width in px that the profile's lengths are divided by, NaN where it is not known."""
    return float(profile.meta.get("mouth_width_px", math.nan))


def colour_of(identity: int) -> tuple[int, int, int]:
    """RGB colour of an opening's identity (1, 2, ...); repeats after ``len(COLOURS)`` identities."""
    return COLOURS[(int(identity) - 1) % len(COLOURS)]


def line_width(height: int, width: int) -> int:
    """Line width in px that stays fine enough to judge an outline by at a drawn size of `height` x `width` px."""
    return max(1, round(min(height, width) / 720))


def draw_outline(picture: np.ndarray, outline: np.ndarray, colour: tuple[int, int, int], view: View) -> None:
    """Draw one closed polygon, (n, 2) (row, column) in source px, into `picture` in place."""
    thickness = line_width(*picture.shape[:2])
    points = [_fixed_point(view.to_drawn(outline))]
    cv2.polylines(picture, points, True, colour, thickness, cv2.LINE_AA, _SUBPIXEL_BITS)


def draw_corners(picture: np.ndarray, corners: np.ndarray, view: View) -> None:
    """Mark the mouth corners, (2, 2) (row, column) in source px, with short upright ticks; NaN corners are left out."""
    thickness = line_width(*picture.shape[:2])
    reach = 5.0 * thickness
    for row, col in view.to_drawn(corners):
        if math.isfinite(row) and math.isfinite(col):
            tick = np.array([[row - reach, col], [row + reach, col]])
            cv2.polylines(picture, [_fixed_point(tick)], False, CORNER_COLOUR, thickness, cv2.LINE_AA, _SUBPIXEL_BITS)


def text_size(text: str, height_px: int) -> int:
    """Width in px of `text` when its capitals are `height_px` high."""
    return cv2.getTextSize(text, _FONT, *_font(height_px))[0][0]


def draw_text(
    picture: np.ndarray, text: str, row: int, col: int, height_px: int, colour: tuple[int, int, int] = TEXT_COLOUR
) -> None:
    """Write `text` in place, its baseline on `row`, its left edge at `col`, its capitals `height_px` high."""
    scale, thickness = _font(height_px)
    cv2.putText(picture, text, (int(col), int(row)), _FONT, scale, colour, thickness, cv2.LINE_AA)


def format_number(value: float, decimals: int, unit: str = "") -> str:
    """A measured value for a caption; an unknown one is a dash, never a 0."""
    return f"{value:.{decimals}f}{unit}" if math.isfinite(value) else f"-{unit}"


def _fixed_point(points: np.ndarray) -> np.ndarray:
    """(n, 2) (row, column) -> (n, 1, 2) int32 (x, y) with the fraction bits that OpenCV's `shift` reads."""
    return np.round(points[:, None, ::-1] * (1 << _SUBPIXEL_BITS)).astype(np.int32)


def _font(height_px: int) -> tuple[float, int]:
    thickness = max(1, round(height_px / 11))
    return cv2.getFontScaleFromHeight(_FONT, height_px, thickness), thickness
