"""The maps that the pixel classifier looks at: brightness and two colour ratios, relative to the face at hand.

Logarithms of ratios do not change with exposure; taking off the middle value of the picture (coarse stage) or of the
lips and of the skin (fine stage) removes white balance, skin tone and lip tone, so that one classifier serves all.
Every map is uint8 with 128 for "like the reference", on a canvas padded by its edge pixels.
"""

from __future__ import annotations

import cv2
import numba as nb
import numpy as np

PAD = 32  # px around a canvas, at least the largest offset in a forest
COARSE_BLURS, FINE_BLURS = (3, 7, 15), ((3, 7), (1, 11))  # box widths; fine: against the lips, against the skin
OCTAVE = 256  # steps per doubling
GAINS = np.array([48, 140, 140]) / OCTAVE  # map steps per step of brightness, red/green, blue/green
SPREAD_GAIN = 40.0  # map steps for the distance between the 10th and 90th percentile
MIN_SPREAD = 0.08 * OCTAVE
BINS, BIN_STEPS, BIN_OFFSET = 1024, 4, 2048  # histogram for medians

_LOG_LIGHT = np.round(OCTAVE * np.log2(np.arange(256) + 4)).astype(np.int16)
_LOG_COLOUR = np.round(OCTAVE * np.log2(np.arange(256) + 8)).astype(np.int16)


@nb.njit(cache=True, nogil=True)
def _log_ratios(rgb, pad, log_light, log_colour, out):
    height, width = rgb.shape[:2]
    for i in range(height + 2 * pad):
        r = min(max(i - pad, 0), height - 1)
        for j in range(width):
            red, green, blue = rgb[r, j, 0], rgb[r, j, 1], rgb[r, j, 2]
            grey = (np.int32(77) * red + np.int32(150) * green + np.int32(29) * blue) >> 8
            out[0, i, j + pad] = log_light[grey]
            out[1, i, j + pad] = log_colour[red] - log_colour[green]
            out[2, i, j + pad] = log_colour[blue] - log_colour[green]
        for c in range(3):
            for j in range(pad):
                out[c, i, j] = out[c, i, pad]
                out[c, i, width + pad + j] = out[c, i, width + pad - 1]


@nb.njit(cache=True, nogil=True)
def _quantiles(plane, weight, pad, step, low, middle, high):
    """Three quantiles of every `step`-th pixel where weight is True; (nan, nan, nan) under 16 pixels."""
    counts = np.zeros(BINS, np.int32)
    total = 0
    for i in range(0, weight.shape[0], step):
        for j in range(0, weight.shape[1], step):
            if weight[i, j]:
                counts[min(max((plane[i + pad, j + pad] + BIN_OFFSET) // BIN_STEPS, 0), BINS - 1)] += 1
                total += 1
    found = np.full(3, np.nan)
    if total < 16:
        return found
    run = 0
    k = 0
    goals = (low, middle, high)
    for b in range(BINS):
        run += counts[b]
        while k < 3 and run >= goals[k] * total:
            found[k] = (b + 0.5) * BIN_STEPS - BIN_OFFSET
            k += 1
    return found


@nb.njit(cache=True, nogil=True)
def _quantise(plane, centre, gain, out):
    for i in range(plane.shape[0]):
        for j in range(plane.shape[1]):
            out[i, j] = np.uint8(min(max(128.0 + gain * (plane[i, j] - centre), 0.0), 255.0))


@nb.njit(cache=True, nogil=True)
def _quantise_log_odds(odds, pad, out):
    height, width = odds.shape
    for i in range(height + 2 * pad):
        r = min(max(i - pad, 0), height - 1)
        for j in range(width + 2 * pad):
            c = min(max(j - pad, 0), width - 1)
            out[i, j] = np.uint8(min(max(128.0 + 24.0 * odds[r, c], 0.0), 255.0))


@nb.njit(cache=True, nogil=True)
def _lip_position(odds, pad, out):
    """Where a pixel lies in its column of lip: out[0] share of the lip above it, out[1] how much lip there is."""
    height, width = odds.shape
    for j in range(width + 2 * pad):
        c = min(max(j - pad, 0), width - 1)
        total = 1e-3
        for r in range(height):
            total += min(max(0.25 * odds[r, c] + 0.5, 0.0), 1.0)
        run = 0.0
        mass = np.uint8(min(4.0 * total, 255.0))
        for i in range(height + 2 * pad):
            r = i - pad
            if 0 <= r < height:
                run += min(max(0.25 * odds[r, c] + 0.5, 0.0), 1.0)
            out[0, i, j] = np.uint8(min(255.0 * run / total, 255.0))
            out[1, i, j] = mass


def log_ratios(rgb: np.ndarray) -> np.ndarray:
    """(3, H + 2 PAD, W + 2 PAD) int16: log brightness, log red/green, log blue/green, OCTAVE steps per doubling."""
    height, width = rgb.shape[:2]
    out = np.empty((3, height + 2 * PAD, width + 2 * PAD), np.int16)
    _log_ratios(rgb, PAD, _LOG_LIGHT, _LOG_COLOUR, out)
    return out


def _positions(out: np.ndarray, height: int, width: int) -> None:
    """Fill the last two maps with row and column, 0 to 255 over the canvas."""
    rows = np.clip((np.arange(-PAD, height + PAD) * 255) // (height - 1), 0, 255).astype(np.uint8)
    cols = np.clip((np.arange(-PAD, width + PAD) * 255) // (width - 1), 0, 255).astype(np.uint8)
    out[-2], out[-1] = rows[:, None], cols[None, :]


def _blurred(plane: np.ndarray, box: int, out: np.ndarray) -> None:
    if box == 1:
        out[:] = plane
    else:
        cv2.blur(plane, (box, box), dst=out, borderType=cv2.BORDER_REPLICATE)


def coarse_maps(ratios: np.ndarray) -> np.ndarray:
    """(20, H + 2 PAD, W + 2 PAD) uint8 maps of the coarse stage from :func:`log_ratios`."""
    height, width = ratios.shape[1] - 2 * PAD, ratios.shape[2] - 2 * PAD
    every = np.ones((height, width), np.bool_)
    maps = np.empty((6 * len(COARSE_BLURS) + 2, *ratios.shape[1:]), np.uint8)
    plane = np.empty(ratios.shape[1:], np.uint8)
    n = 0
    for c in range(3):
        low, middle, high = _quantiles(ratios[c], every, PAD, 3, 0.1, 0.5, 0.9)
        for gain in (GAINS[c], SPREAD_GAIN / max(high - low, MIN_SPREAD)):
            _quantise(ratios[c], middle, gain, plane)
            for box in COARSE_BLURS:
                _blurred(plane, box, maps[n])
                n += 1
    _positions(maps, height, width)
    return maps


def references(ratios: np.ndarray, lip: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """Middle log ratios (2, 3) of the lips and of the skin.

    lip, skin : (H, W) bool, which pixels to take; NaN where there are under 16 of them
    """
    out = np.empty((2, 3))
    for k, where in enumerate((lip, skin)):
        for c in range(3):
            out[k, c] = _quantiles(ratios[c], where, PAD, 1, 0.5, 0.5, 0.5)[1]
    return out


def fine_maps(ratios: np.ndarray, middles: np.ndarray, odds: np.ndarray) -> np.ndarray:
    """(22, H + 2 PAD, W + 2 PAD) uint8 maps of the fine stage.

    middles : (2, 3) from :func:`references`; odds : (3, H, W) log-odds of the coarse stage on this canvas
    """
    height, width = odds.shape[1:]
    maps = np.empty((12 + 2 * len(odds) + 4, *ratios.shape[1:]), np.uint8)
    plane = np.empty(ratios.shape[1:], np.uint8)
    n = 0
    for c in range(3):
        for k, boxes in enumerate(FINE_BLURS):
            _quantise(ratios[c], middles[k, c], GAINS[c], plane)
            for box in boxes:
                _blurred(plane, box, maps[n])
                n += 1
    for each in odds:
        _quantise_log_odds(each, PAD, maps[n])
        _blurred(maps[n], 11, maps[n + 1])
        n += 2
    _lip_position(odds[0], PAD, maps[n : n + 2])
    _positions(maps, height, width)
    return maps
