"""The maps that the pixel classifier looks at: brightness and two colour ratios, relative to the face at hand.

Logarithms of ratios do not change with exposure; taking off the middle value of the picture (coarse stage) or of the
lips and of the skin (fine stage) removes white balance, skin tone and lip tone, so that one classifier serves all.
Every map is uint8 with 128 for "like the reference", on a canvas padded by its edge pixels.
"""

from __future__ import annotations

from functools import lru_cache

import numba as nb
import numpy as np

# Rows and columns; a px is twice as wide as high (lipmetrics.box.ASPECT).
MAX_OFFSET = (16, 8)  # px, the farthest a forest looks from a pixel
PAD = MAX_OFFSET  # px of edge around the maps of a canvas
REACH = (PAD[0] + 8, PAD[1] + 4)  # px around the canvas that the widest blur sees
BLUR_WIDTHS = {1: 1, 3: 1, 7: 3, 11: 5, 15: 7}  # by the height of a box: as good as square
COARSE_BLURS, FINE_BLURS = (3, 7, 15), ((3, 7), (1, 11))  # box heights; fine: against the lips, against the skin
ODDS_BLURS = (1, 11)
OCTAVE = 256  # steps per doubling
GAINS = np.array([48, 140, 140]) / OCTAVE  # map steps per step of brightness, red/green, blue/green
SPREAD_GAIN = 40.0  # map steps for the distance between the 10th and 90th percentile
MIN_SPREAD = 0.08 * OCTAVE
COARSE_COUNT = 6 * len(COARSE_BLURS) + 2
FINE_COUNT = 3 * sum(len(boxes) for boxes in FINE_BLURS) + 2 * 3 + 4
BINS, BIN_BITS, BIN_OFFSET = 1024, 2, 2048  # histogram for medians: bins are 2**BIN_BITS steps wide

_COARSE_BOXES, _FINE_BOXES, _ODDS_BOXES = (
    np.array([[(height, BLUR_WIDTHS[height]) for height in heights] for heights in kinds])
    for kinds in ([COARSE_BLURS] * 2, FINE_BLURS, [ODDS_BLURS])
)
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
    for k in range(6 if box >= 6 else 3, box):
        if k % 3 == 0 and k + 3 <= box:
            later = threes[k * step :]
        elif k >= box - box % 3:
            later = values[k * step :]
        else:
            continue
        for j in range(end):
            out[j] += later[j]


@nb.njit(inline="always")
def _blur(padded, height, width, work, out):
    """Mean over height x width pixels, rounded; padded, uint16, reaches REACH - PAD farther than out on each side.

    Sums run over the picture as one long row: what they take from the next row lands in columns that are not read.
    """
    first, first_col = REACH[0] - PAD[0] - height // 2, REACH[1] - PAD[1] - width // 2
    seen = padded[first : padded.shape[0] - first]
    stride, values = seen.shape[1], seen.ravel()
    if height > 1:
        _box_sums(values, stride, height, work[0], work[1])
        values = work[1, : values.size]
    if width > 1:
        _box_sums(values, 1, width, work[0], work[2])
        values = work[2, : values.size]
    # times / 2**23 is 1 / area to within what rounding forgives, for every box up to 15
    area = height * width
    half, times = np.uint32(area // 2), np.uint32((1 << 23) // area + (area > 1))
    for i in range(out.shape[0]):
        part, line = values[i * stride + first_col : (i + 1) * stride], out[i]
        for j in range(line.size):
            line[j] = np.uint8(np.uint32(np.uint32(part[j] + half) * times) >> np.uint32(23))


@nb.njit(cache=True, nogil=True)
def _blurred_maps(planes, row, col, centres, gains, boxes, padded, work, maps):
    """Of each plane (3, H, W) int16, quantised in the ways k, centres and gains (3, k), the blurs (k, boxes), in order.

    Quantised is 128 + gain (plane - centre) in 0..255; the maps begin PAD px above and left of row, col, and the
    edge of the planes goes on. padded and work : room for _blur
    """
    _, height, width = planes.shape
    row, col = row - REACH[0], col - REACH[1]
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
                _blur(padded, boxes[k, b, 0], boxes[k, b, 1], work, maps[n])
                n += 1


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


@nb.njit(cache=True, nogil=True)
def _place(height, width, row, col, out):
    """Row and column, 0 to 255 over the canvas, from row and col on; beyond the canvas its edge goes on."""
    for i in range(out.shape[1]):
        out[0, i] = min(max((i + row) * 255 // (height - 1), 0), 255)
    for j in range(out.shape[2]):
        out[1, :, j] = min(max((j + col) * 255 // (width - 1), 0), 255)


@nb.njit(cache=True, nogil=True)
def _coarse(ratios, kinds, region, gains, boxes):
    _, height, width = ratios.shape
    maps, padded, work = _room(region, 3 * boxes.size // 2 + 2)
    quantiles = _quantiles(ratios, kinds, 2, np.array([0.1, 0.5, 0.9]))[0]
    both_gains, centres = np.empty((3, 2)), np.empty((3, 2))
    for c in range(3):
        low, middle, high = quantiles[c]
        both_gains[c, 0], both_gains[c, 1] = gains[c], SPREAD_GAIN / max(high - low, MIN_SPREAD)
        centres[c] = middle
    _blurred_maps(ratios, region[0], region[2], centres, both_gains, boxes, padded, work, maps)
    _place(height, width, region[0] - PAD[0], region[2] - PAD[1], maps[-2:])
    return maps


@nb.njit(cache=True, nogil=True)
def _fine(ratios, middles, odds, region, gains, boxes, odds_boxes):
    _, height, width = ratios.shape
    count = 3 * boxes.size // 2
    maps, padded, work = _room(region, count + 3 * odds_boxes.size // 2 + 4)
    both_gains, centres = np.empty((3, 2)), np.empty((3, 2))
    for c in range(3):
        both_gains[c] = gains[c]
        centres[c, 0], centres[c, 1] = middles[0, c], middles[1, c]
    _blurred_maps(ratios, region[0], region[2], centres, both_gains, boxes, padded, work, maps)
    levels = np.empty(odds.shape, np.int16)
    for c in range(3):
        for i in range(height):
            for j in range(width):
                levels[c, i, j] = np.int16(
                    min(max(np.float32(128) + np.float32(24) * odds[c, i, j], np.float32(0)), np.float32(255))
                )
    as_they_are, centres = np.ones((3, 1)), np.full((3, 1), 128.0)
    _blurred_maps(levels, region[0], region[2], centres, as_they_are, odds_boxes, padded, work, maps[count:])
    _lip_position(odds[0], region[0] - PAD[0], region[2] - PAD[1], maps[-4:-2])
    _place(height, width, region[0] - PAD[0], region[2] - PAD[1], maps[-2:])
    return maps


@nb.njit(cache=True, nogil=True)
def _room(region, count):
    """The maps of a region, a plane that reaches REACH beyond it, and room for its sums."""
    row0, row1, col0, col1 = region
    rows, cols = row1 - row0 + 2 * REACH[0], col1 - col0 + 2 * REACH[1]
    maps = np.empty((count, row1 - row0 + 2 * PAD[0], col1 - col0 + 2 * PAD[1]), np.uint8)
    return maps, np.empty((rows, cols), np.uint16), np.zeros((3, rows * cols), np.uint16)


@nb.njit(cache=True, nogil=True)
def _references(ratios, lip, opening, where):
    kinds = np.empty(where.shape, np.int8)
    for i in range(where.shape[0]):
        for j in range(where.shape[1]):
            kind = 0 if lip[i, j] > 0 and opening[i, j] < 0 else 1 if lip[i, j] < -1 else 2
            kinds[i, j] = kind if where[i, j] else -1
    return _quantiles(ratios, kinds, 2, np.array([0.5]))


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
    return _references(ratios, lip, opening, where)[..., 0]


@lru_cache(maxsize=4)
def _all_of_one_kind(height: int, width: int) -> np.ndarray:
    return np.zeros((height, width), np.int8)


def coarse_maps(ratios: np.ndarray, region: tuple[int, int, int, int] | None = None) -> np.ndarray:
    """Maps of the coarse stage from :func:`log_ratios`, (20, rows + 2 PAD[0], cols + 2 PAD[1]) uint8.

    region : half-open part of the canvas (row0, row1, col0, col1) that is wanted, all by default; the answer for
        a pixel does not depend on it
    """
    height, width = ratios.shape[1:]
    return _coarse(ratios, _all_of_one_kind(height, width), region or (0, height, 0, width), GAINS, _COARSE_BOXES)


def fine_maps(
    ratios: np.ndarray, middles: np.ndarray, odds: np.ndarray, region: tuple[int, int, int, int] | None = None
) -> np.ndarray:
    """Maps of the fine stage, (22, rows + 2 PAD[0], cols + 2 PAD[1]) uint8.

    middles : (2, 3) from :func:`references`; odds : (3, H, W) float32, log-odds of the coarse stage on this canvas;
        region as in :func:`coarse_maps`
    """
    height, width = ratios.shape[1:]
    return _fine(ratios, middles, odds, region or (0, height, 0, width), GAINS, _FINE_BOXES, _ODDS_BOXES)
