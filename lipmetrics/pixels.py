"""One decoded picture to an RGB array: any pixel format, only the region that is asked for, turned as displayed.

A region is cut out of the planes of the decoded picture before its colours are converted, so the cost follows the
region, not the picture. The conversion itself is FFmpeg's (swscale), with the matrix and range the picture is tagged
with. Deep RGB and grey (more than 8 bits) are scaled by 255/65535 and rounded. Transparent pixels are laid over mid
grey, which is neither dark like a mouth cavity nor red like a lip.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import av
import cv2
import numpy as np
from av.sidedata.sidedata import Type as SideDataType
from av.video.reformatter import VideoReformatter

from lipmetrics import planes
from lipmetrics.errors import InputError

BACKGROUND = 128  # grey level under transparent pixels

# Per plane: bytes per sample, and the shifts that take picture rows and columns to rows and columns of the plane.
_ONE, _TWO = (1, 0, 0), (2, 0, 0)
_LAYOUTS = {
    "yuv420p": (_ONE, (1, 1, 1), (1, 1, 1)),
    "yuvj420p": (_ONE, (1, 1, 1), (1, 1, 1)),
    "nv12": (_ONE, (2, 1, 1)),
    "yuv422p": (_ONE, (1, 0, 1), (1, 0, 1)),
    "yuvj422p": (_ONE, (1, 0, 1), (1, 0, 1)),
    "yuv444p": (_ONE, _ONE, _ONE),
    "yuvj444p": (_ONE, _ONE, _ONE),
    "yuv420p10le": (_TWO, (2, 1, 1), (2, 1, 1)),
    "gray": (_ONE,),
    "gray16le": (_TWO,),
    "gray16be": (_TWO,),
    "rgb24": ((3, 0, 0),),
    "bgr24": ((3, 0, 0),),
    "bgr0": ((4, 0, 0),),
    "rgba": ((4, 0, 0),),
    "bgra": ((4, 0, 0),),
}
# Matrix tags swscale knows (RGB, 709, unspecified, FCC, 470BG, 170M, 240M, 2020); others are read as unspecified.
_MATRICES = frozenset({0, 1, 2, 4, 5, 6, 7, 9})
_UNSPECIFIED = 2
_MARGIN_PX = 4


class Turn(NamedTuple):
    """How a stored picture becomes the displayed one: transpose first, then flip."""

    transpose: bool = False
    flip_rows: bool = False
    flip_cols: bool = False


# By 0, 90, 180 and 270 degrees to the left.
_TURNS = (Turn(), Turn(True, True, False), Turn(False, True, True), Turn(True, False, True))


def turn_by_angle(picture: av.VideoFrame) -> Turn:
    """The turn a decoded picture asks for; cheap, but a mirror image is not told from a turn."""
    return _TURNS[round(picture.rotation / 90) % 4]


def turn_of(picture: av.VideoFrame) -> Turn:
    """The turn or mirror image that the display matrix (mp4, mov, mkv) asks for, in steps of 90 degrees.

    For one picture of a clip, not for each: PyAV's side data keep the picture alive until the garbage collector runs.
    """
    try:
        matrix = picture.side_data.get(SideDataType.DISPLAYMATRIX)
    except ValueError:  # a type of side data that PyAV does not know
        return turn_by_angle(picture)
    if matrix is None:
        return Turn()
    # x' = a x + c y, y' = b x + d y
    a, b, _, c, d = np.frombuffer(bytes(matrix), np.int32)[:5].tolist()
    if abs(a) >= abs(b):
        return Turn(False, d < 0, a < 0)
    return Turn(True, b < 0, c < 0)


def displayed_size(picture: av.VideoFrame, turn: Turn) -> tuple[int, int]:
    """(height, width) in px after the turn."""
    return (picture.width, picture.height) if turn.transpose else (picture.height, picture.width)


def can_cut(picture: av.VideoFrame) -> bool:
    """Whether a region can be converted by itself to the very values it has when the whole picture is converted."""
    layout = _LAYOUTS.get(picture.format.name)
    if layout is None or len(layout) == 1:
        return layout is not None
    # In odd and very small sizes swscale fits the chroma planes to the size, so a part would differ from the whole.
    return picture.height % 2 == picture.width % 2 == 0 and min(picture.height, picture.width) >= 16


def to_rgb(
    picture: av.VideoFrame, turn: Turn, region: tuple[int, int, int, int] | None, reformatter: VideoReformatter
) -> np.ndarray:
    """The picture as displayed, or a region (row0, row1, col0, col1; half open) of it, as new (h, w, 3) uint8 RGB.

    A region only where `can_cut`. Raises InputError if the pixel format cannot be converted.
    """
    if region is None:
        pixels = _converted(picture, reformatter)
    else:
        row0, row1, col0, col1 = _stored_region(region, turn, *displayed_size(picture, turn))
        part, top, left = _cut_out(picture, row0, row1, col0, col1)
        pixels = _converted(part, reformatter)[row0 - top : row1 - top, col0 - left : col1 - left]
    return np.ascontiguousarray(_turned(pixels, turn))


def averaged_rgb(
    picture: av.VideoFrame,
    turn: Turn,
    region: tuple[int, int, int, int],
    block: tuple[int, int],
    reformatter: VideoReformatter,
) -> np.ndarray:
    """Means of `to_rgb` over blocks of so many rows and columns; what is left at the region's end is left out.

    Of common pixel formats the planes are averaged and only then converted: much less work, and but for rounding
    the same. A region only where `can_cut`.
    """
    if max(block) > planes.MAX_BLOCK or picture.format.name not in planes.FORMATS:
        return averaged(to_rgb(picture, turn, region, reformatter), block)
    matrix = picture.colorspace if picture.colorspace in _MATRICES else _UNSPECIFIED
    if matrix not in planes.MATRICES:
        return averaged(to_rgb(picture, turn, region, reformatter), block)
    row0, row1, col0, col1 = region
    size = ((row1 - row0) // block[0], (col1 - col0) // block[1])
    part = (row0, row0 + size[0] * block[0], col0, col0 + size[1] * block[1])
    top, _, left, _ = _stored_region(part, turn, *displayed_size(picture, turn))
    pixels = planes.averaged_rgb(
        [_samples(plane) for plane in picture.planes],
        planes.FORMATS[picture.format.name],
        (top, left),
        size[::-1] if turn.transpose else size,
        block[::-1] if turn.transpose else block,
        planes.coefficients(matrix, picture.format.name.startswith("yuvj") or picture.color_range == planes.FULL_RANGE),
    )
    return np.ascontiguousarray(_turned(pixels, turn))


def averaged(pixels: np.ndarray, block: tuple[int, int]) -> np.ndarray:
    """Means of an array (h, w, channels) over blocks of so many rows and columns; the rest at its end is left out."""
    if block == (1, 1):
        return pixels
    high, wide = pixels.shape[0] // block[0], pixels.shape[1] // block[1]
    whole = pixels[: high * block[0], : wide * block[1]]
    return cv2.resize(whole, (wide, high), interpolation=cv2.INTER_AREA)


def averaged_region(frame, region: tuple[int, int, int, int], block: tuple[int, int]) -> np.ndarray:
    """Means of `frame.rgb(region)` over blocks, by the frame itself where it knows a shorter way."""
    if hasattr(frame, "averaged"):
        return frame.averaged(region, block)
    return averaged(frame.rgb(region), block)


def _stored_region(region: tuple[int, int, int, int], turn: Turn, height: int, width: int) -> tuple[int, int, int, int]:
    row0, row1, col0, col1 = region
    if turn.flip_rows:
        row0, row1 = height - row1, height - row0
    if turn.flip_cols:
        col0, col1 = width - col1, width - col0
    return (col0, col1, row0, row1) if turn.transpose else (row0, row1, col0, col1)


def _turned(pixels: np.ndarray, turn: Turn) -> np.ndarray:
    if turn.transpose:
        pixels = pixels.transpose(1, 0, 2)
    return pixels[:: -1 if turn.flip_rows else 1, :: -1 if turn.flip_cols else 1]


def _cut_out(picture: av.VideoFrame, row0: int, row1: int, col0: int, col1: int) -> tuple[av.VideoFrame, int, int]:
    """The part as a picture of its own, with a margin for interpolated chroma, and its first row and column."""
    layout = _LAYOUTS[picture.format.name]
    margin = _MARGIN_PX if len(layout) > 1 else 0
    top, bottom = max(row0 - margin & -2, 0), min(row1 + margin + 1 & -2, picture.height)
    left, right = max(col0 - margin & -2, 0), min(col1 + margin + 1 & -2, picture.width)
    part = av.VideoFrame(right - left, bottom - top, picture.format.name)
    part.colorspace, part.color_range = picture.colorspace, picture.color_range
    for (size, row_shift, col_shift), source, target in zip(layout, picture.planes, part.planes, strict=True):
        samples = _samples(source)[top >> row_shift : bottom >> row_shift]
        samples = samples[:, (left >> col_shift) * size : (right >> col_shift) * size]
        _samples(target)[: samples.shape[0], : samples.shape[1]] = samples
    return part, top, left


def _samples(plane: av.video.plane.VideoPlane) -> np.ndarray:
    return np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)


def _converted(picture: av.VideoFrame, reformatter: VideoReformatter) -> np.ndarray:
    """The whole picture as (h, w, 3) uint8 RGB, as stored."""
    if picture.colorspace not in _MATRICES:
        picture.colorspace = _UNSPECIFIED
    target, deep, alpha = _target(picture.format.name)
    try:
        # Threads cost more than they save on the small regions this is called with.
        converted = reformatter.reformat(picture, format=target, threads=1)
    except (OSError, ValueError) as error:
        raise InputError(
            f"cannot convert pixel format {picture.format.name} ({error}); expected one that FFmpeg turns into RGB, "
            "re-encode the video as yuv420p"
        ) from error
    pixels = converted.to_ndarray()
    if converted is picture:  # nothing to do, so the array is the decoder's own memory
        pixels = pixels.copy()
    if deep:
        pixels = ((pixels.astype(np.uint32) + 128) // 257).astype(np.uint8)
    return _over_background(pixels) if alpha else pixels


@lru_cache
def _target(name: str) -> tuple[str, bool, bool]:
    """The format to convert to, whether it is deep, and whether it has alpha."""
    pixel_format = av.VideoFormat(name)
    parts = pixel_format.components
    alpha = name == "pal8" or any(part.is_alpha for part in parts)
    # swscale alone would cut deep RGB and grey down to the high byte; deep YUV it scales well.
    deep = parts[0].bits > 8 and (pixel_format.is_rgb or len(parts) <= 2)
    return {(0, 0): "rgb24", (0, 1): "rgba", (1, 0): "rgb48le", (1, 1): "rgba64le"}[deep, alpha], deep, alpha


def _over_background(pixels: np.ndarray) -> np.ndarray:
    colours, alpha = pixels[..., :3], pixels[..., 3:]
    if alpha.min() == 255:
        return colours
    mixed = colours.astype(np.uint32) * alpha + BACKGROUND * (255 - alpha.astype(np.uint32))
    return ((mixed + 127) // 255).astype(np.uint8)
