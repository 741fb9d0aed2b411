"""A lip ring on plain skin, which the thesis's method can read, and a method for tests that looks at nothing."""

from __future__ import annotations

import cv2
import numpy as np

from lipmetrics.look import CLOSED, NO_MOUTH, OPEN, Look

HEIGHT, WIDTH = 80, 120
SKIN, LIP, DARK = (210, 170, 150), (170, 80, 90), (30, 15, 15)


def ring(*half_heights: int, height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """(height, width, 3) uint8 RGB of lips 80 px wide around dark ellipses 24 px wide, side by side, of these half
    heights; 0 draws none. The ring is off the middle, so that swapped axes show."""
    rgb = np.full((height, width, 3), SKIN, np.uint8)
    cv2.ellipse(rgb, (50, 45), (40, 25), 0, 0, 360, LIP, cv2.FILLED)
    for place, half_height in enumerate(half_heights):
        if half_height:
            col = 50 + round(32 * (place - (len(half_heights) - 1) / 2))
            cv2.ellipse(rgb, (col, 45), (12, half_height), 0, 0, 360, DARK, cv2.FILLED)
    return rgb


class _Script:
    """Sees in frame i what the settings say: a height in px, 0 for closed, None for no mouth."""

    def __init__(self, settings):
        self.settings = None
        self._heights = settings or (10.0, 0.0, None)

    def look(self, frame) -> Look:
        height = self._heights[frame.index % len(self._heights)]
        corners = np.array([[20.0, 10.0], [20.0, 50.0]])
        if height is None:
            return Look(NO_MOUTH)
        if height == 0:
            return Look(CLOSED, [], corners, 0.9)
        box = np.array([[20.0, 20.0], [20.0, 40.0], [20.0 + height, 40.0], [20.0 + height, 20.0]])
        return Look(OPEN, [box], corners, 0.8)


def make_detector(settings, info) -> _Script:
    return _Script(settings)
