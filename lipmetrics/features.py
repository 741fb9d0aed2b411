"""The maps that the pixel classifier looks at: brightness and two colour ratios, relative to the face at hand.

Logarithms of ratios do not change with exposure; taking off the middle value of the picture (coarse stage) or of the
lips and of the skin (fine stage) removes white balance, skin tone and lip tone, so that one classifier serves all.
Every map is uint8 with 128 for "like the reference", on a canvas padded by its edge pixels.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numba as nb
import numpy as np

MAX_OFFSET = 16  # px, the farthest a forest looks from a pixel
PAD = 24  # px of edge around a canvas: the farthest look, and half the widest blur there
COARSE_BLURS, FINE_BLURS = (3, 7, 15), ((3, 7), (1, 11))  # box widths; fine: against the lips, against the skin
OCTAVE = 256  # steps per doubling
GAINS = np.array([48, 140, 140]) / OCTAVE  # map steps per step of brightness, red/green, blue/green
SPREAD_GAIN = 40.0  # map steps for the distance between the 10th and 90th percentile
MIN_SPREAD = 0.08 * OCTAVE
COARSE_COUNT = 6 * len(COARSE_BLURS) + 2
FINE_COUNT = 3 * sum(len(boxes) for boxes in FINE_BLURS) + 2 * 3 + 4
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
    """Three quantiles of every `step`-th pixel where weight is True; NaN under 16 pixels."""
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
def _quantise(plane, row, col, centre, gain, out):
    """128 + gain (plane - centre) in 0..255, of the part of the plane that begins at row, col."""
    times, plus = np.int32(round(gain * 1024)), np.int32(round((128.5 - gain * centre) * 1024))
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            value = (times * np.int32(plane[i + row, j + col]) + plus) >> 10
            out[i, j] = np.uint8(min(max(value, 0), 255))


@nb.njit(cache=True, nogil=True)
def _quantise_log_odds(odds, row, col, out):
    height, width = odds.shape
    for i in range(out.shape[0]):
        r = min(max(i + row, 0), height - 1)
        for j in range(out.shape[1]):
            c = min(max(j + col, 0), width - 1)
            out[i, j] = np.uint8(min(max(128.0 + 24.0 * odds[r, c], 0.0), 255.0))


@nb.njit(cache=True, nogil=True)
def _lip_position(odds, row, col, out):
    """Where a pixel lies in its column of lip: out[0] share of the lip above it, out[1] how much lip there is."""
    height, width = odds.shape
    for j in range(out.shape[2]):
        c = min(max(j + col, 0), width - 1)
        total = 1e-3
        above = 0.0
        for r in range(height):
            lip = min(max(0.25 * odds[r, c] + 0.5, 0.0), 1.0)
            total += lip
            if r < row:
                above += lip
        mass = np.uint8(min(4.0 * total, 255.0))
        for i in range(out.shape[1]):
            r = i + row
            if 0 <= r < height:
                above += min(max(0.25 * odds[r, c] + 0.5, 0.0), 1.0)
            out[0, i, j] = np.uint8(min(255.0 * above / total, 255.0))
            out[1, i, j] = mass


def log_ratios(rgb: np.ndarray) -> np.ndarray:
    """(3, H + 2 PAD, W + 2 PAD) int16: log brightness, log red/green, log blue/green, OCTAVE steps per doubling."""
    height, width = rgb.shape[:2]
    out = np.empty((3, height + 2 * PAD, width + 2 * PAD), np.int16)
    _log_ratios(rgb, PAD, _LOG_LIGHT, _LOG_COLOUR, out)
    return out


def _positions(out: np.ndarray, size: tuple[int, int], region: tuple[int, int, int, int]) -> None:
    """Fill two maps with row and column, 0 to 255 over the canvas of `size`."""
    row0, row1, col0, col1 = region
    rows = np.clip((np.arange(row0 - PAD, row1 + PAD) * 255) // (size[0] - 1), 0, 255).astype(np.uint8)
    cols = np.clip((np.arange(col0 - PAD, col1 + PAD) * 255) // (size[1] - 1), 0, 255).astype(np.uint8)
    out[0], out[1] = rows[:, None], cols[None, :]


def _blurred(plane: np.ndarray, box: int, out: np.ndarray) -> None:
    if box == 1:
        out[:] = plane
    else:
        cv2.blur(plane, (box, box), dst=out, borderType=cv2.BORDER_REPLICATE)


def whole(ratios: np.ndarray) -> tuple[int, int, int, int]:
    """The region (row0, row1, col0, col1), half open, that is the whole canvas of these log ratios."""
    return 0, ratios.shape[1] - 2 * PAD, 0, ratios.shape[2] - 2 * PAD


def _empty_maps(count: int, region: tuple[int, int, int, int]) -> np.ndarray:
    row0, row1, col0, col1 = region
    return np.empty((count, row1 - row0 + 2 * PAD, col1 - col0 + 2 * PAD), np.uint8)


def coarse_maps(ratios: np.ndarray, region: tuple[int, int, int, int] | None = None) -> np.ndarray:
    """Maps of the coarse stage from :func:`log_ratios`, (20, rows + 2 PAD, cols + 2 PAD) uint8.

    region : half-open part of the canvas (row0, row1, col0, col1) that is wanted, all by default; the answer for
        a pixel does not depend on it
    """
    _, height, _, width = whole(ratios)
    region = region or whole(ratios)
    every = _every(height, width)
    maps = _empty_maps(COARSE_COUNT, region)
    plane = np.empty(maps.shape[1:], np.uint8)
    n = 0
    for c in range(3):
        low, middle, high = _quantiles(ratios[c], every, PAD, 3, 0.1, 0.5, 0.9)
        for gain in (GAINS[c], SPREAD_GAIN / max(high - low, MIN_SPREAD)):
            _quantise(ratios[c], region[0], region[2], middle, gain, plane)
            for box in COARSE_BLURS:
                _blurred(plane, box, maps[n])
                n += 1
    _positions(maps[n:], (height, width), region)
    return maps


@lru_cache(maxsize=4)
def _every(height: int, width: int) -> np.ndarray:
    return np.ones((height, width), np.bool_)


def references(ratios: np.ndarray, lip: np.ndarray, opening: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Middle log ratios (2, 3) of the lips and of the skin.

    lip, opening : (H, W) log-odds of the coarse stage; where : (H, W) bool, the pixels that may count. Lips are likely
    lip and not opening, skin is not likely lip; where there are too few of either, all pixels stand in.
    """
    return _references(ratios, lip, opening, where, PAD)


@nb.njit(cache=True, nogil=True)
def _references(ratios, lip, opening, where, pad):
    is_lip, is_skin = np.zeros(where.shape, np.bool_), np.zeros(where.shape, np.bool_)
    for i in range(0, where.shape[0], 2):
        for j in range(0, where.shape[1], 2):
            if where[i, j]:
                is_lip[i, j] = lip[i, j] > 0 and opening[i, j] < 0
                is_skin[i, j] = lip[i, j] < -1
    out = np.empty((2, 3))
    for c in range(3):
        out[0, c] = _quantiles(ratios[c], is_lip, pad, 2, 0.5, 0.5, 0.5)[1]
        out[1, c] = _quantiles(ratios[c], is_skin, pad, 2, 0.5, 0.5, 0.5)[1]
        for k in range(2):
            if np.isnan(out[k, c]):
                out[k, c] = _quantiles(ratios[c], where, pad, 2, 0.5, 0.5, 0.5)[1]
    return out


def fine_maps(
    ratios: np.ndarray, middles: np.ndarray, odds: np.ndarray, region: tuple[int, int, int, int] | None = None
) -> np.ndarray:
    """Maps of the fine stage, (22, rows + 2 PAD, cols + 2 PAD) uint8.

    middles : (2, 3) from :func:`references`; odds : (3, H, W) log-odds of the coarse stage on this canvas; region
        as in :func:`coarse_maps`
    """
    region = region or whole(ratios)
    row, col = region[0], region[2]
    maps = _empty_maps(FINE_COUNT, region)
    plane = np.empty(maps.shape[1:], np.uint8)
    n = 0
    for c in range(3):
        for k, boxes in enumerate(FINE_BLURS):
            _quantise(ratios[c], row, col, middles[k, c], GAINS[c], plane)
            for box in boxes:
                _blurred(plane, box, maps[n])
                n += 1
    for each in odds:
        _quantise_log_odds(each, row - PAD, col - PAD, maps[n])
        _blurred(maps[n], 11, maps[n + 1])
        n += 2
    _lip_position(odds[0], row - PAD, col - PAD, maps[n : n + 2])
    _positions(maps[n + 2 :], odds.shape[1:], region)
    return maps
