"""The maps that the pixel classifier looks at: brightness and two colour ratios, relative to the face at hand.

Logarithms of ratios do not change with exposure; taking off the middle value of the picture (coarse stage) or of the
lips and of the skin (fine stage) removes white balance, skin tone and lip tone, so that one classifier serves all.
Every map is uint8 with 128 for "like the reference", on a canvas padded by its edge pixels.
"""

from __future__ import annotations

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
def _count(value, counts):
    counts[min(max((value + BIN_OFFSET) >> BIN_BITS, 0), BINS - 1)] += 1


@nb.njit(cache=True, nogil=True)
def _quantile(counts, share):
    """Of a histogram of _count; NaN under 16 pixels."""
    total = counts.sum()
    if total < 16:
        return np.nan
    run, b = counts[0], 0
    while run < share * total:
        b += 1
        run += counts[b]
    return (b + 0.5) * (1 << BIN_BITS) - BIN_OFFSET


@nb.njit(cache=True, nogil=True)
def _inside(begin, size, count):
    """Half-open part of `count` pixels from `begin` on that lies on a canvas of `size`."""
    return min(max(-begin, 0), count), max(min(size - begin, count), 0)


@nb.njit(cache=True, nogil=True)
def _go_on(line, first, end):
    """Repeat the first and the last pixel of a part to the ends of its line."""
    line[:first] = line[first]
    line[end:] = line[end - 1]


@nb.njit(cache=True, nogil=True)
def _quantise(plane, row, col, centre, gain, out):
    """128 + gain (plane - centre) in 0..255, of the part of the plane that begins at row, col; its edge goes on."""
    height, width = plane.shape
    times, plus = np.int32(round(gain * 1024)), np.int32(round((128.5 - gain * centre) * 1024))
    first, end = _inside(col, width, out.shape[1])
    for i in range(out.shape[0]):
        values, line = plane[min(max(i + row, 0), height - 1)], out[i]
        inner, part = values[first + col : end + col], line[first:end]
        for j in range(part.size):
            value = (times * np.int32(inner[j]) + plus) >> np.int32(10)
            part[j] = np.uint16(min(max(value, np.int32(0)), np.int32(255)))
        _go_on(line, first, end)


@nb.njit(cache=True, nogil=True)
def _quantise_log_odds(odds, row, col, out):
    height, width = odds.shape
    first, end = _inside(col, width, out.shape[1])
    for i in range(out.shape[0]):
        values, line = odds[min(max(i + row, 0), height - 1)], out[i]
        inner, part = values[first + col : end + col], line[first:end]
        for j in range(part.size):
            part[j] = np.uint16(min(max(128.0 + 24.0 * inner[j], 0.0), 255.0))
        _go_on(line, first, end)


@nb.njit(cache=True, nogil=True)
def _box_sums(values, step, box, threes, out):
    """out[j] = the sum of values[j + k step] over k < box; all flat uint16. What has no such values is left alone."""
    end = values.size - (box - 1) * step
    second, third = values[step:], values[2 * step :]
    if box == 3:
        threes = out
    for j in range(third.size):
        threes[j] = values[j] + second[j] + third[j]
    if box >= 6:
        later = threes[3 * step :]
        for j in range(end):
            out[j] = threes[j] + later[j]
    for k in range(6, box - 2, 3):
        later = threes[k * step :]
        for j in range(end):
            out[j] += later[j]
    for k in range(box - box % 3, box):
        later = values[k * step :]
        for j in range(end):
            out[j] += later[j]


@nb.njit(cache=True, nogil=True)
def _blur(padded, box, work, out):
    """Mean over box x box pixels, rounded; padded, uint16, reaches REACH - PAD farther than out on each side.

    Sums run over the picture as one long row: what they take from the next row lands in columns that are not read.
    """
    first = REACH - PAD - box // 2
    seen = padded[first : padded.shape[0] - first]
    if box == 1:
        sums = seen
    else:
        _box_sums(seen.ravel(), seen.shape[1], box, work[0], work[1])
        _box_sums(work[1, : seen.size], 1, box, work[0], work[2])
        sums = work[2, : seen.size].reshape(seen.shape)
    # times / 2**23 is 1 / area to within what rounding forgives, for every box up to 15
    half, times = np.uint32(box * box // 2), np.uint32((1 << 23) // (box * box) + (box > 1))
    for i in range(out.shape[0]):
        part, line = sums[i, first : first + out.shape[1]], out[i]
        for j in range(line.size):
            line[j] = np.uint8(np.uint32(np.uint32(part[j] + half) * times) >> np.uint32(23))


@nb.njit(cache=True, nogil=True)
def _lip_position(odds, row, col, out):
    """Where a pixel lies in its column of lip: out[0] share of the lip above it, out[1] how much lip there is."""
    height, width = odds.shape
    above, total = np.zeros((out.shape[1], width)), np.zeros(width)
    for r in range(max(height, row + out.shape[1])):
        if r < height:
            values = odds[r]
            for j in range(width):
                total[j] += min(max(0.25 * values[j] + 0.5, 0.0), 1.0)
        if 0 <= r - row < out.shape[1]:
            above[r - row] = total
    total += 1e-3
    first, end = _inside(col, width, out.shape[2])
    whole, amount = total[first + col : end + col], out[1, 0, first:end]
    for j in range(whole.size):
        amount[j] = np.uint8(min(4.0 * whole[j], 255.0))
    _go_on(out[1, 0], first, end)
    for i in range(out.shape[1]):
        out[1, i] = out[1, 0]
        part, share = above[i, first + col : end + col], out[0, i, first:end]
        for j in range(part.size):
            share[j] = np.uint8(np.int32(255.0 * part[j] / whole[j]))
        _go_on(out[0, i], first, end)


@nb.njit(cache=True, nogil=True)
def _positions(height, width, row, col, out):
    """out[0] the row and out[1] the column, 0 to 255 over the canvas."""
    for j in range(out.shape[2]):
        out[1, 0, j] = min(max((j + col) * 255 // (width - 1), 0), 255)
    for i in range(out.shape[1]):
        out[0, i] = min(max((i + row) * 255 // (height - 1), 0), 255)
        out[1, i] = out[1, 0]


@nb.njit(cache=True, nogil=True)
def _room(shape):
    """A plane that reaches REACH - PAD farther than a map on each side, and room for its sums; both uint16."""
    rows, cols = shape[1] + 2 * (REACH - PAD), shape[2] + 2 * (REACH - PAD)
    return np.empty((rows, cols), np.uint16), np.zeros((3, rows * cols), np.uint16)


@nb.njit(cache=True, nogil=True)
def _coarse_maps(ratios, row, col, gains, boxes, maps):
    _, height, width = ratios.shape
    padded, work = _room(maps.shape)
    n = 0
    for c in range(3):
        counts = np.zeros(BINS, np.int32)
        for i in range(0, height, 3):
            for j in range(0, width, 3):
                _count(ratios[c, i, j], counts)
        spread = max(_quantile(counts, 0.9) - _quantile(counts, 0.1), MIN_SPREAD)
        for gain in (gains[c], SPREAD_GAIN / spread):
            _quantise(ratios[c], row - REACH, col - REACH, _quantile(counts, 0.5), gain, padded)
            for box in boxes:
                _blur(padded, box, work, maps[n])
                n += 1
    _positions(height, width, row - PAD, col - PAD, maps[n:])


@nb.njit(cache=True, nogil=True)
def _fine_maps(ratios, middles, odds, row, col, gains, boxes, maps):
    _, height, width = ratios.shape
    padded, work = _room(maps.shape)
    n = 0
    for c in range(3):
        for k in range(2):
            _quantise(ratios[c], row - REACH, col - REACH, middles[k, c], gains[c], padded)
            for box in boxes[k]:
                _blur(padded, box, work, maps[n])
                n += 1
    for c in range(3):
        _quantise_log_odds(odds[c], row - REACH, col - REACH, padded)
        for box in ODDS_BLURS:
            _blur(padded, box, work, maps[n])
            n += 1
    _lip_position(odds[0], row - PAD, col - PAD, maps[n : n + 2])
    _positions(height, width, row - PAD, col - PAD, maps[n + 2 :])


@nb.njit(cache=True, nogil=True)
def _references(ratios, lip, opening, where):
    counts = np.zeros((2, 3, BINS), np.int32)
    for i in range(0, where.shape[0], 2):
        for j in range(0, where.shape[1], 2):
            if where[i, j]:
                if lip[i, j] > 0 and opening[i, j] < 0:
                    kind = 0
                elif lip[i, j] < -1:
                    kind = 1
                else:
                    continue
                for c in range(3):
                    _count(ratios[c, i, j], counts[kind, c])
    out = np.empty((2, 3))
    for c in range(3):
        for kind in range(2):
            out[kind, c] = _quantile(counts[kind, c], 0.5)
            if np.isnan(out[kind, c]):
                every = counts[kind, c]
                every[:] = 0
                for i in range(0, where.shape[0], 2):
                    for j in range(0, where.shape[1], 2):
                        if where[i, j]:
                            _count(ratios[c, i, j], every)
                out[kind, c] = _quantile(every, 0.5)
    return out


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
    return _references(ratios, lip, opening, where)


def _empty_maps(count: int, ratios: np.ndarray, region: tuple[int, int, int, int] | None):
    row0, row1, col0, col1 = region or (0, ratios.shape[1], 0, ratios.shape[2])
    return row0, col0, np.empty((count, row1 - row0 + 2 * PAD, col1 - col0 + 2 * PAD), np.uint8)


def coarse_maps(ratios: np.ndarray, region: tuple[int, int, int, int] | None = None) -> np.ndarray:
    """Maps of the coarse stage from :func:`log_ratios`, (20, rows + 2 PAD, cols + 2 PAD) uint8.

    region : half-open part of the canvas (row0, row1, col0, col1) that is wanted, all by default; the answer for
        a pixel does not depend on it
    """
    row, col, maps = _empty_maps(COARSE_COUNT, ratios, region)
    _coarse_maps(ratios, row, col, GAINS, COARSE_BLURS, maps)
    return maps


def fine_maps(
    ratios: np.ndarray, middles: np.ndarray, odds: np.ndarray, region: tuple[int, int, int, int] | None = None
) -> np.ndarray:
    """Maps of the fine stage, (22, rows + 2 PAD, cols + 2 PAD) uint8.

    middles : (2, 3) from :func:`references`; odds : (3, H, W) log-odds of the coarse stage on this canvas; region
        as in :func:`coarse_maps`
    """
    row, col, maps = _empty_maps(FINE_COUNT, ratios, region)
    _fine_maps(ratios, middles, odds, row, col, GAINS, FINE_BLURS, maps)
    return maps
