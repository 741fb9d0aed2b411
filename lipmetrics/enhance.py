"""Colour enhancement before segmentation: white balance, saturation stretch, median filter.

The order and the idea are those of section 5.3.2 (algorithm 2) of the thesis this method comes from: the brightest
skin is shifted to white, so that the colour of the skin drops out and the lips are what is left with colour; stretching
the saturation then gives every speaker the same contrast. Estimating a gain and applying it are separate functions,
because a clip has one gain: a white balance that jumps from frame to frame makes the profile jitter.

Pictures are (H, W, 3) uint8 RGB; every function leaves its input as it is.
"""

from __future__ import annotations

import cv2
import numpy as np


def clipped_maximum(channel: np.ndarray, clip_fraction: float) -> int:
    """Largest value of an (H, W) uint8 channel once its brightest `clip_fraction` of pixels is cut off.

    Clipping keeps sharp reflections and hot pixels from deciding the gain of the whole picture.
    """
    above_or_at = np.bincount(channel.ravel(), minlength=256)[::-1].cumsum()[::-1]
    return int(np.flatnonzero(above_or_at > clip_fraction * channel.size)[-1])


def white_gains(rgb: np.ndarray, clip_fraction: float) -> np.ndarray:
    """Gains s = 255 / i_max of the red, green and blue channel, (3,) float64 (thesis eq. 5.3).

    i_max is the `clipped_maximum` of the channel, at least 1.
    """
    return np.array([255.0 / max(1, clipped_maximum(rgb[..., k], clip_fraction)) for k in range(3)])


def white_balance(rgb: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """The picture with each channel multiplied by its gain, cut off at 255."""
    return cv2.LUT(rgb, _tables(gains))


def saturation_gain(rgb: np.ndarray, clip_fraction: float) -> float:
    """Gain 255 / S_max that stretches the HSV saturation to full scale; S_max is its `clipped_maximum`, at least 1."""
    return 255.0 / max(1, clipped_maximum(cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV)[..., 1], clip_fraction))


def stretch_saturation(rgb: np.ndarray, gain: float) -> np.ndarray:
    """The picture with its HSV saturation multiplied by `gain`, cut off at 255; hue and value stay."""
    hsv = cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV)
    return cv2.cvtColor(cv2.LUT(hsv, _tables([1.0, gain, 1.0])), cv2.COLOR_HSV2RGB)


def median_filter(rgb: np.ndarray, size_px: int) -> np.ndarray:
    """The picture with each channel median filtered over an odd window of `size_px`; 1 leaves it as it is.

    A median removes a bright point where a Gaussian would smear it, and keeps edges, which is where the lips end.
    """
    return cv2.medianBlur(rgb, size_px) if size_px > 1 else rgb.copy()


def _tables(gains) -> np.ndarray:
    """Look-up table (1, 256, 3) uint8 that multiplies channel k by gains[k]."""
    levels = np.arange(256.0)[:, None] * np.asarray(gains, float)
    return np.minimum(np.rint(levels), 255).astype(np.uint8)[None]
