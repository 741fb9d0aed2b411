"""A small RGB picture straight from the luma and chroma planes of a decoded one: averaged first, then converted.

Converting colours after averaging costs by the small picture. The arithmetic is swscale's own for these formats (each
product cut to a whole number, chroma of the nearest sample), so without averaging the values are the very same; with
it they differ by the rounding.
"""

from __future__ import annotations

from functools import lru_cache

import numba
import numpy as np

FORMATS = {"yuv420p": (1, 1), "yuvj420p": (1, 1), "yuv422p": (0, 1), "yuvj422p": (0, 1)}  # shifts of chroma rows, cols
FULL_RANGE = 2  # tag
# By matrix tag: red from V, blue from U, green from U, green from V, 16 bits after the point, for video range.
_COEFFICIENTS = {
    1: (117489, 138438, -13975, -34925),
    2: (104597, 132201, -25675, -53279),
    4: (104448, 132798, -24759, -53109),
    5: (104597, 132201, -25675, -53279),
    6: (104597, 132201, -25675, -53279),
    7: (117579, 136230, -16907, -35559),
    9: (110013, 140363, -12277, -42626),
}
MATRICES = frozenset(_COEFFICIENTS)
MAX_BLOCK = 256  # sums of more rows would not fit 16 bits
_EIGHTHS = 3  # samples are kept in eighths, as bits


@lru_cache(maxsize=32)
def coefficients(matrix: int, full_range: bool) -> np.ndarray:
    """(6,) int32: luma of black in eighths, and 13 bits after the point of luma, V to red, U to blue, U and V to green.

    matrix : one of MATRICES
    """
    if full_range:
        black, luma = 0, 1 << 16
        chroma = [int(value * 224 / 255) for value in _COEFFICIENTS[matrix]]
    else:
        black, luma, chroma = 16, (255 << 16) // 219, _COEFFICIENTS[matrix]
    return np.array([black << _EIGHTHS, *((value + 4) >> 3 for value in (luma, *chroma))], np.int32)


def averaged_rgb(
    samples: list[np.ndarray],
    chroma_shifts: tuple[int, int],
    place: tuple[int, int],
    size: tuple[int, int],
    block: tuple[int, int],
    coefficients: np.ndarray,
) -> np.ndarray:
    """RGB (*size, 3) uint8 of means over blocks of so many rows and columns.

    samples : Y, U and V (rows, cols) uint8; place : row and column, in Y, where the first block begins
    """
    means = np.empty((3, *size), np.int16)
    out = np.empty((*size, 3), np.uint8)
    _block_means(samples[0], *place, 0, 0, *block, means[0])
    for plane, mean in zip(samples[1:], means[1:], strict=True):
        _block_means(plane, *place, *chroma_shifts, *block, mean)
    _to_rgb(means, coefficients, block == (1, 1), out)
    return out


@numba.njit(cache=True, nogil=True)
def _block_means(plane, row, col, row_shift, col_shift, down, across, out):
    """Means in eighths of blocks that begin at row, col, of a plane that has 1 sample for 2**shift rows or columns."""
    height, width = out.shape
    if down == across == 1:
        for i in range(height):
            source, line = plane[(row + i) >> row_shift], out[i]
            if col_shift:
                for j in range(width):
                    line[j] = source[(col + j) >> col_shift] << 3
            else:
                part = source[col : col + width]
                for j in range(width):
                    line[j] = part[j] << 3
        return
    if row_shift and down % 2 == row % 2 == 0:
        row, down, row_shift = row >> 1, down >> 1, 0
    if col_shift and across % 2 == col % 2 == 0:
        col, across, col_shift = col >> 1, across >> 1, 0
    first, last = col >> col_shift, (col + across * width - 1) >> col_shift
    sums = np.zeros(last + 2 - first, np.uint16)  # over the rows of a block; one more, which is 0
    full = (across - 1) // 2 if col_shift else across  # samples of a block that are in no other
    windows, picked = np.zeros(sums.size, np.int32), np.empty(width, np.int32)
    share = np.float32(8 / (down * across))
    for i in range(height):
        for j in range(sums.size):
            sums[j] = 0
            windows[j] = 0
        for r in range(row + i * down, row + (i + 1) * down):
            line = plane[r >> row_shift, first : last + 1]
            for j in range(line.size):
                sums[j] += line[j]
        for k in range(full):
            later = sums[k:]
            for j in range(later.size):
                windows[j] += later[j]
        if col_shift:
            begin = col & 1
            for j in range(width):
                end = begin + across
                # a sample stands for two columns, but at the ends of a block perhaps for one of them
                picked[j] = 2 * windows[(begin + 1) >> 1] + (begin & 1) * sums[begin >> 1] + (end & 1) * sums[end >> 1]
                begin = end
        else:
            for j in range(width):
                picked[j] = windows[j * across]
        line = out[i]
        for j in range(width):
            line[j] = np.int16(np.float32(picked[j]) * share + np.float32(0.5))


@numba.njit(cache=True, nogil=True)
def _to_rgb(means, coefficients, cut, out):
    """Colours of means in eighths. Products are cut to whole numbers, or their sum loses what cuts take on average."""
    black, luma, red_v, blue_u, green_u, green_v = coefficients
    middle, low, high, bits = np.int32(1024), np.int32(0), np.int32(255), np.int32(16)
    kept = np.int32(-1 << 16 if cut else -1)
    two_cuts, three_cuts = np.int32(0 if cut else -1 << 15), np.int32(0 if cut else -1 << 16)  # and rounding
    colours = np.empty((3, out.shape[1]), np.uint8)
    red, green, blue = colours[0], colours[1], colours[2]
    for i in range(out.shape[0]):
        ys, us, vs = means[0, i], means[1, i], means[2, i]
        for j in range(ys.size):
            y = (np.int32(ys[j] - black) * luma) & kept
            u, v = np.int32(us[j] - middle), np.int32(vs[j] - middle)
            r = (y + ((v * red_v) & kept) + two_cuts) >> bits
            g = (y + ((u * green_u) & kept) + ((v * green_v) & kept) + three_cuts) >> bits
            b = (y + ((u * blue_u) & kept) + two_cuts) >> bits
            red[j] = np.uint8(min(max(np.int32(r), low), high))
            green[j] = np.uint8(min(max(np.int32(g), low), high))
            blue[j] = np.uint8(min(max(np.int32(b), low), high))
        line = out[i]
        for j in range(ys.size):
            line[j, 0] = red[j]
            line[j, 1] = green[j]
            line[j, 2] = blue[j]
