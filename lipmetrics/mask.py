"""The thesis's method: lips by colour in two colour spaces, openings as the holes that the lips enclose.

Section 5.3.2 of the thesis, one function per step: enhance the colours (`lipmetrics.enhance`), score every pixel as lip
once by red against green and once by hue, correlate the two scores so that teeth, tongue and reflections which fool one
are caught by the other, threshold, and take the enclosed contours. It needs lips that form a closed ring and a
picture of little else than the mouth; it is kept as the baseline that the default method is measured against.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from lipmetrics import enhance
from lipmetrics.errors import InputError
from lipmetrics.look import CLOSED, NO_MOUTH, OPEN, Look
from lipmetrics.outline import trace_outlines

CORRELATIONS = {"or": np.maximum, "and": np.minimum, "mean": lambda a, b: (a + b) / 2}


@dataclass(frozen=True)
class ThesisSettings:
    """Settings of `method="thesis"`. Fractions are of the picture's pixels unless said otherwise.

    clip_fraction : brightest part of a histogram that does not count for its stretch
    gain_frames : the clip's gains are the median over this many first frames, then stay
    median_px : side of the median filter, odd; 1 for none
    red_green : (R-G)/(R+G) at which a pixel is as much lip as skin, 0 to 1
    hue_deg, hue_half_width_deg : hue of lips, and the distance from it at which a pixel is as much lip as skin
    min_saturation : HSV saturation, 0 to 1, below which a hue says nothing
    min_value : HSV value, 0 to 1, below which a pixel is no lip: the dark of a mouth has the hue of noise
    correlation : how the two scores become one: "or" (the larger), "and" (the smaller), "mean"
    threshold : correlated score, 0 to 1, above which a pixel is lip
    min_lips : lips smaller than this fraction of the picture are no mouth
    min_opening_mw2 : openings of a smaller area are noise, in squared mouth widths
    """

    clip_fraction: float = 0.02
    gain_frames: int = 9
    median_px: int = 5
    red_green: float = 0.1
    hue_deg: float = 350.0
    hue_half_width_deg: float = 15.0
    min_saturation: float = 0.1
    min_value: float = 0.3
    correlation: str = "or"
    threshold: float = 0.5
    min_lips: float = 0.002
    min_opening_mw2: float = 0.0005

    def __post_init__(self) -> None:
        faults = []
        if not 0 <= self.clip_fraction < 1:
            faults.append(f"clip_fraction from 0 to below 1, got {self.clip_fraction}")
        if self.gain_frames < 1:
            faults.append(f"gain_frames of at least 1, got {self.gain_frames}")
        if self.median_px < 1 or self.median_px % 2 == 0:
            faults.append(f"an odd median_px of at least 1, got {self.median_px}")
        if not 0 < self.red_green < 1:
            faults.append(f"red_green between 0 and 1, got {self.red_green}")
        if not 0 < self.hue_half_width_deg <= 180:
            faults.append(f"hue_half_width_deg above 0 and up to 180, got {self.hue_half_width_deg}")
        if self.correlation not in CORRELATIONS:
            faults.append(f"correlation to be one of {', '.join(CORRELATIONS)}, got '{self.correlation}'")
        if faults:
            raise InputError("thesis settings: expected " + "; ".join(faults))


def red_green_score(rgb: np.ndarray, red_green: float) -> np.ndarray:
    """How much each pixel is lip by red against green, (H, W) float32 in 0..1; 0.5 where (R-G)/(R+G) is `red_green`."""
    red, green = rgb[..., 0].astype(np.float32), rgb[..., 1].astype(np.float32)
    contrast = (red - green) / np.maximum(red + green, 1)
    return np.clip(0.5 * contrast / red_green, 0, 1)


def hue_score(rgb: np.ndarray, hue_deg: float, half_width_deg: float, min_saturation: float) -> np.ndarray:
    """How much each pixel is lip by hue, (H, W) float32 in 0..1; 1 at `hue_deg`, 0.5 at `half_width_deg` from it.

    Pixels of less than `min_saturation` (0..1) score 0: grey has no hue.
    """
    hsv = cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV_FULL)
    turns = hsv[..., 0].astype(np.float32) / 256 - hue_deg / 360
    distance_deg = 360 * np.abs(turns - np.rint(turns))
    score = np.clip(1 - 0.5 * distance_deg / half_width_deg, 0, 1)
    return np.where(hsv[..., 1] >= 255 * min_saturation, score, np.float32(0))


def largest_region(mask: np.ndarray) -> np.ndarray:
    """The largest 8-connected region of a (H, W) bool mask, (H, W) bool; nothing where the mask is empty."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    if count == 1:
        return np.zeros_like(mask)
    return labels == 1 + stats[1:, cv2.CC_STAT_AREA].argmax()


def enclosed(ring: np.ndarray) -> np.ndarray:
    """Pixels that an 8-connected (H, W) bool mask encloses, (H, W) bool.

    These are the inner contours that `cv2.findContours` gives (Suzuki's border following), filled: whatever outside the
    mask cannot be reached from the picture's border. Skin inside the ring, a tooth taken for lip, belongs to it.
    """
    outer, _ = cv2.findContours(ring.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    filled = np.zeros(ring.shape, np.uint8)
    cv2.drawContours(filled, outer, -1, 1, cv2.FILLED)
    return filled.astype(bool) & ~ring


def lip_corners(lips: np.ndarray) -> np.ndarray:
    """Left and right end of the lips, a (H, W) bool mask: (2, 2) float64 (row, column) at the pixels' outer edge."""
    columns = np.flatnonzero(lips.any(axis=0))
    ends = [(np.flatnonzero(lips[:, column]).mean(), column) for column in (columns[0], columns[-1])]
    return np.add(ends, ((0, -0.5), (0, 0.5)))


class ThesisDetector:
    """The method on the frames of one clip, in order; it remembers the clip's gains and nothing else.

    settings : see `ThesisSettings`
    region : (row0, row1, col0, col1), half open, where to look; the whole picture if None
    """

    def __init__(self, settings: ThesisSettings, region: tuple[int, int, int, int] | None = None):
        self.settings = settings
        self.region = region
        self._white: list[np.ndarray] = []
        self._saturation: list[float] = []

    def look(self, frame) -> Look:
        """What one frame (`lipmetrics.frames.Frame`) shows."""
        look = self._look_at(frame.rgb(self.region))
        if self.region is None:
            return look
        shift = np.array([self.region[0], self.region[2]], float)
        return Look(look.status, [o + shift for o in look.outlines], look.corners + shift, look.confidence)

    def enhanced(self, rgb: np.ndarray) -> np.ndarray:
        """The picture with the clip's white balance and saturation stretch and the median filter applied."""
        s = self.settings
        if len(self._white) < s.gain_frames:
            self._white.append(enhance.white_gains(rgb, s.clip_fraction))
        white = enhance.white_balance(rgb, np.median(self._white, axis=0))
        if len(self._saturation) < s.gain_frames:
            self._saturation.append(enhance.saturation_gain(white, s.clip_fraction))
        return enhance.median_filter(enhance.stretch_saturation(white, float(np.median(self._saturation))), s.median_px)

    def _look_at(self, rgb: np.ndarray) -> Look:
        s = self.settings
        if rgb.max() - rgb.min() < 16:  # black, white or grey all over: nothing to see, and no gain to learn
            return Look(NO_MOUTH)
        colours = self.enhanced(rgb)
        by_red = red_green_score(colours, s.red_green)
        by_hue = hue_score(colours, s.hue_deg, s.hue_half_width_deg, s.min_saturation)
        score = CORRELATIONS[s.correlation](by_red, by_hue)
        lips = largest_region((score > s.threshold) & (colours.max(axis=2) >= 255 * s.min_value))
        if np.count_nonzero(lips) < s.min_lips * lips.size:
            return Look(NO_MOUTH)
        corners = lip_corners(lips)
        min_area_px = max(1, round(s.min_opening_mw2 * (corners[1, 1] - corners[0, 1]) ** 2))
        outlines = trace_outlines(enclosed(lips), min_area_px)
        both = np.minimum(by_red, by_hue)[lips] > s.threshold
        return Look(OPEN if outlines else CLOSED, outlines, corners, float(both.mean()))


def make_detector(settings: ThesisSettings | None, info) -> ThesisDetector:
    """Factory for the table of methods. `info` (`lipmetrics.frames.VideoInfo`) is not needed."""
    return ThesisDetector(settings or ThesisSettings())
