"""The maps that the pixel classifier looks at: brightness and two colour ratios, relative to the face at hand.

Logarithms of ratios do not change with exposure; taking off the middle value of the picture (coarse stage) or of the
lips and of the skin (fine stage) removes white balance, skin tone and lip tone, so that one classifier serves all.
Every map is uint8 with 128 for "like the reference", on a canvas padded by its edge pixels.
"""

from __future__ import annotations

from functools import lru_cache

import numba as nb
import numpy as np

MAX_OFFSET = 16  # px, the farthest a forest looks from a pixel
PAD = MAX_OFFSET  # px of edge around the maps of a canvas
REACH = PAD + 8  # px around them that the widest blur sees
COARSE_BLURS, FINE_BLURS = (3, 7, 15), ((3, 7), (1, 11))  # box widths; fine: against the lips, against the skin
ODDS_BLURS = (1, 11)
OCTAVE = 256  # steps per doubling
GAINS = np.array([48, 140, 140]) / OCTAVE  # map steps per step of brightness, red/green, blue/green
SPREAD_GAIN = 40.0  # map steps for the distance between the 10th and 90th percentile
MIN_SPREAD = 0.08 * OCTAVE
COARSE_COUNT = 6 * len(COARSE_BLURS) + 2
FINE_COUNT = 3 * sum(len(boxes) for boxes in FINE_BLURS) + 2 * 3 + 4
BINS, BIN_BITS, BIN_OFFSET = 1024, 2, 2048  # histogram for medians: bins are 2**BIN_BITS steps wide

_MIDDLE, _LOW_MIDDLE_HIGH = np.array([0.5]), np.array([0.1, 0.5, 0.9])
_COARSE_BOXES, _FINE_BOXES, _ODDS_BOXES = np.array([COARSE_BLURS] * 2), np.array(FINE_BLURS), np.array([ODDS_BLURS])
_FINE_GAINS = np.stack([GAINS, GAINS], axis=1)
_LEVEL_CENTRES, _LEVEL_GAINS = np.full((3, 1), 128.0), np.ones((3, 1))  # levels stay what they are
_LOG_LIGHT = np.round(OCTAVE * np.log2(np.arange(256) + 4)).astype(np.int16)
_LOG_COLOUR = np.round(OCTAVE * np.log2(np.arange(256) + 8)).astype(np.int16)


@nb.njit(cache=True, nogil=True)
def _log_ratios(rgb, log_light, log_colour, out):
    for i in range(rgb.shape[0]):
        for j in range(rgb.shape[1]):
            red, green, blue = rgb[i, j, 0], rgb[i, j, 1], rgb[i, j, 2]
            grey = (np.uint32(77) * red + np.uint32(150) * green + np.uint32(29) * blue) >> np.uint32(8)
            out[0, i, j] = log_light[grey]
            out[1, i, j] = log_colour[red] - log_colour[green]
            out[2, i, j] = log_colour[blue] - log_colour[green]


@nb.njit(cache=True, nogil=True)
def _quantiles(ratios, kinds, step, shares):
    """Quantiles (2, 3, shares) of the ratios of every `step`-th pixel of kind 0 and of kind 1; kinds (H, W) int8.

    Where there are fewer than 16 pixels of a kind, all pixels of a kind of at least 0 stand in for it.
    """
    counts = np.zeros((3, 3, BINS), np.int32)
    for i in range(0, kinds.shape[0], step):
        for j in range(0, kinds.shape[1], step):
            kind = kinds[i, j]
            if kind >= 0:
                for c in range(3):
                    counts[kind, c, min(max((ratios[c, i, j] + BIN_OFFSET) >> BIN_BITS, 0), BINS - 1)] += 1
    found = np.empty((2, 3, shares.size))
    for kind in range(2):
        for c in range(3):
            line, total = counts[kind, c], 0
            for b in range(BINS):
                total += line[b]
            if total < 16:
                total = 0
                for b in range(BINS):
                    line[b] = counts[0, c, b] + counts[1, c, b] + counts[2, c, b]
                    total += line[b]
            run, b = line[0], 0
            for k in range(shares.size):
                while run < shares[k] * total:
                    b += 1
                    run += line[b]
                found[kind, c, k] = (b + 0.5) * (1 << BIN_BITS) - BIN_OFFSET
    return found


@nb.njit(cache=True, nogil=True)
def _kinds(lip, opening, where, out):
    """0 likely lip and not opening, 1 not likely lip, 2 other pixels that may count, -1 the rest."""
    for i in range(where.shape[0]):
        for j in range(where.shape[1]):
            kind = 0 if lip[i, j] > 0 and opening[i, j] < 0 else 1 if lip[i, j] < -1 else 2
            out[i, j] = kind if where[i, j] else -1


@nb.njit(inline="always")
def _box_sums(values, step, box, threes, out):
    """out[j] = the sum of values[j + k step] over k < box; all flat uint16. What has no such values is left alone."""
    end = values.size - (box - 1) * step
    second, third = values[step:], values[2 * step :]
    for j in range(third.size):
        threes[j] = values[j] + second[j] + third[j]
    later = threes[3 * step :] if box >= 6 else threes
    for j in range(end):
        out[j] = threes[j] + later[j] if box >= 6 else threes[j]
    for k in range(6, box):
        if k % 3 == 0 and k + 3 <= box:
            later = threes[k * step :]
        elif k >= box - box % 3:
            later = values[k * step :]
        else:
            continue
        for j in range(end):
            out[j] += later[j]


@nb.njit(inline="always")
def _blur(padded, box, work, out):
    """Mean over box x box pixels, rounded; padded, uint16, reaches REACH - PAD farther than out on each side.

    Sums run over the picture as one long row: what they take from the next row lands in columns that are not read.
    """
    first = REACH - PAD - box // 2
    seen = padded[first : padded.shape[0] - first]
    width, values = seen.shape[1], seen.ravel()
    if box > 1:
        for step in (width, 1):
            down, work_out = work[0], work[1 if step > 1 else 2]
            _box_sums(values, step, box, down, work_out)
            values = work_out[: values.size]
    # times / 2**23 is 1 / area to within what rounding forgives, for every box up to 15
    half, times = np.uint32(box * box // 2), np.uint32((1 << 23) // (box * box) + (box > 1))
    for i in range(out.shape[0]):
        part, line = values[i * width + first : (i + 1) * width], out[i]
        for j in range(line.size):
            line[j] = np.uint8(np.uint32(np.uint32(part[j] + half) * times) >> np.uint32(23))


@nb.njit(cache=True, nogil=True)
def _blurred_maps(planes, row, col, centres, gains, boxes, padded, work, maps):
    """Of each plane (3, H, W) int16, quantised in the ways k, centres and gains (3, k), the blurs (k, boxes), in order.

    Quantised is 128 + gain (plane - centre) in 0..255; the maps begin PAD px above and left of row, col, and the
    edge of the planes goes on. padded and work : room for _blur
    """
    _, height, width = planes.shape
    row, col = row - REACH, col - REACH
    first, end = min(max(-col, 0), padded.shape[1]), max(min(width - col, padded.shape[1]), 0)
    n = 0
    for c in range(3):
        for k in range(centres.shape[1]):
            gain = gains[c, k]
            times, plus = np.int32(round(gain * 1024)), np.int32(round((128.5 - gain * centres[c, k]) * 1024))
            for i in range(padded.shape[0]):
                line = padded[i]
                inner, part = planes[c, min(max(i + row, 0), height - 1), first + col : end + col], line[first:end]
                for j in range(part.size):
                    value = (times * np.int32(inner[j]) + plus) >> np.int32(10)
                    part[j] = np.uint16(min(max(value, np.int32(0)), np.int32(255)))
                for j in range(first):
                    line[j] = line[first]
                for j in range(end, line.size):
                    line[j] = line[end - 1]
            for b in range(boxes.shape[1]):
                _blur(padded, boxes[k, b], work, maps[n])
                n += 1


@nb.njit(cache=True, nogil=True)
def _log_odds_levels(odds, out):
    """128 + 24 log-odds, cut to whole numbers in 0..255; odds and out flat."""
    for j in range(odds.size):
        out[j] = np.int16(min(max(np.float64(128) + np.float64(24) * odds[j], 0.0), 255.0))


@nb.njit(cache=True, nogil=True)
def _lip_position(odds, row, col, out):
    """Where a pixel lies in its column of lip: out[0] share of the lip above it, out[1] how much lip there is."""
    height, width = odds.shape
    above, total = np.zeros((out.shape[1] + 1, width)), np.zeros(width)
    for r in range(max(height, row + out.shape[1])):
        reached = above[min(max(r - row, -1), out.shape[1])]  # the last one is of no use
        for j in range(width):
            if r < height:
                total[j] += min(max(0.25 * odds[r, j] + 0.5, 0.0), 1.0)
            reached[j] = total[j]
    for i in range(out.shape[1]):
        for j in range(out.shape[2]):
            c = min(max(j + col, 0), width - 1)
            whole = total[c] + 1e-3
            out[0, i, j] = np.uint8(np.int32(255.0 * above[i, c] / whole))
            out[1, i, j] = np.uint8(np.int32(min(4.0 * whole, 255.0)))


def log_ratios(rgb: np.ndarray) -> np.ndarray:
    """(3, H, W) int16: log brightness, log red/green, log blue/green, OCTAVE steps per doubling."""
    out = np.empty((3, *rgb.shape[:2]), np.int16)
    _log_ratios(rgb, _LOG_LIGHT, _LOG_COLOUR, out)
    return out


def references(ratios: np.ndarray, lip: np.ndarray, opening: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Middle log ratios (2, 3) of the lips and of the skin.

    lip, opening : (H, W) log-odds of the coarse stage; where : (H, W) bool, the pixels that may count. Lips are likely
    lip and not opening, skin is not likely lip; where there are too few of either, all pixels stand in.
    """
    kinds = np.empty(where.shape, np.int8)
    _kinds(lip, opening, where, kinds)
    return _quantiles(ratios, kinds, 2, _MIDDLE)[..., 0]


@lru_cache(maxsize=4)
def _all_of_one_kind(height: int, width: int) -> np.ndarray:
    return np.zeros((height, width), np.int8)


@lru_cache(maxsize=4)
def _ramps(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Row and column, 0 to 255 over the canvas and PAD farther."""
    return tuple(np.clip(np.arange(-PAD, n + PAD) * 255 // (n - 1), 0, 255).astype(np.uint8) for n in (height, width))


def _positions(canvas: tuple[int, int], row: int, col: int, out: np.ndarray) -> None:
    rows, cols = _ramps(*canvas)
    out[0] = rows[row : row + out.shape[1], None]
    out[1] = cols[col : col + out.shape[2]]


def _room(count: int, ratios: np.ndarray, region: tuple[int, int, int, int] | None):
    """Row and column where a region begins, its maps, a plane that reaches REACH beyond it, and room for its sums."""
    row0, row1, col0, col1 = region or (0, ratios.shape[1], 0, ratios.shape[2])
    rows, cols = row1 - row0 + 2 * REACH, col1 - col0 + 2 * REACH
    maps = np.empty((count, row1 - row0 + 2 * PAD, col1 - col0 + 2 * PAD), np.uint8)
    return row0, col0, maps, np.empty((rows, cols), np.uint16), np.zeros((3, rows * cols), np.uint16)


def coarse_maps(ratios: np.ndarray, region: tuple[int, int, int, int] | None = None) -> np.ndarray:
    """Maps of the coarse stage from :func:`log_ratios`, (20, rows + 2 PAD, cols + 2 PAD) uint8.

    region : half-open part of the canvas (row0, row1, col0, col1) that is wanted, all by default; the answer for
        a pixel does not depend on it
    """
    row, col, maps, padded, work = _room(COARSE_COUNT, ratios, region)
    low, middle, high = _quantiles(ratios, _all_of_one_kind(*ratios.shape[1:]), 3, _LOW_MIDDLE_HIGH)[0].T
    gains = np.stack([GAINS, SPREAD_GAIN / np.maximum(high - low, MIN_SPREAD)], axis=1)
    centres = np.stack([middle, middle], axis=1)
    _blurred_maps(ratios, row, col, centres, gains, _COARSE_BOXES, padded, work, maps)
    _positions(ratios.shape[1:], row, col, maps[-2:])
    return maps


def fine_maps(
    ratios: np.ndarray, middles: np.ndarray, odds: np.ndarray, region: tuple[int, int, int, int] | None = None
) -> np.ndarray:
    """Maps of the fine stage, (22, rows + 2 PAD, cols + 2 PAD) uint8.

    middles : (2, 3) from :func:`references`; odds : (3, H, W) log-odds of the coarse stage on this canvas; region
        as in :func:`coarse_maps`
    """
    row, col, maps, padded, work = _room(FINE_COUNT, ratios, region)
    _blurred_maps(ratios, row, col, np.ascontiguousarray(middles.T), _FINE_GAINS, _FINE_BOXES, padded, work, maps)
    levels = np.empty(odds.shape, np.int16)
    _log_odds_levels(odds.ravel(), levels.ravel())
    n = len(_FINE_GAINS) * _FINE_BOXES.size
    _blurred_maps(levels, row, col, _LEVEL_CENTRES, _LEVEL_GAINS, _ODDS_BOXES, padded, work, maps[n:])
    _lip_position(odds[0], row - PAD, col - PAD, maps[-4:-2])
    _positions(ratios.shape[1:], row, col, maps[-2:])
    return maps
