"""Frames to a video file: lossless for measuring, H.264 for people; equal frames make equal bytes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from simulator.atomic import whole_file
from simulator.errors import InputError
from simulator.wording import choices, nearest

# name: encoder, pixel format, endings of its files
CODECS = {
    "ffv1": ("ffv1", "bgr0", (".mkv", ".avi")),
    "h264": ("libx264", "yuv420p", (".mp4", ".mkv", ".mov")),
    "h264_lossless": ("libx264rgb", "rgb24", (".mp4", ".mkv", ".mov")),
}
CONTAINERS = {".mkv": "matroska", ".mp4": "mp4", ".mov": "mov", ".avi": "avi"}


def write_video(
    path: str | Path,
    frames: Iterable[np.ndarray],
    frame_rate: float | Fraction = 30,
    codec: str = "ffv1",
    crf: int = 16,
    threads: int = 2,
) -> int:
    """Write frames (H, W, 3) uint8 RGB to a video file, whole or not at all; return their number.

    Parameters
    ----------
    path : ends in .mkv, .mp4, .mov or .avi
    frame_rate : frames per second; a Fraction is kept exactly, a float to the nearest with a denominator up to 1001
    codec : "ffv1" (lossless, for measuring), "h264" (for people: plays anywhere, colours at half size) or
        "h264_lossless" (RGB in H.264, which few players show)
    crf : constant rate factor of "h264", 0 (best) to 51

    Raises
    ------
    InputError : unknown codec, a file ending it cannot go into, no frame, frames of different or odd size
    """
    path, rate = Path(path), _rate(frame_rate)
    if codec not in CODECS:
        raise InputError(f"expected a codec of {choices(CODECS)}, got {nearest(codec, CODECS)}")
    encoder, pixels, endings = CODECS[codec]
    if path.suffix.lower() not in endings:
        raise InputError(f"expected a file that ends in {choices(endings)} for {codec}, got '{path.name}'")
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        raise InputError("expected one or more frames to write, got none")
    size = _checked(first, None, even=codec == "h264")
    count = 0
    with whole_file(path) as part:
        quick_start = {"movflags": "+faststart"} if path.suffix.lower() in (".mp4", ".mov") else {}
        with av.open(str(part), "w", format=CONTAINERS[path.suffix.lower()], options=quick_start) as container:
            container.flags |= av.container.Flags.bitexact.value  # no time of day, no random numbers
            stream = container.add_stream(encoder, rate=rate, options=_options(codec, crf))
            stream.height, stream.width, stream.pix_fmt = *size, pixels
            stream.time_base = 1 / rate
            stream.codec_context.thread_count = threads
            stream.codec_context.flags |= av.codec.context.Flags.bitexact
            if codec == "h264":
                _mark_bt709(stream.codec_context)
            frame = first
            while frame is not None:
                _checked(frame, size)
                container.mux(stream.encode(_picture(frame, pixels, count, 1 / rate)))
                count += 1
                frame = next(frames, None)
            container.mux(stream.encode(None))
    return count


def compressed(frames: Iterable[np.ndarray], frame_rate: float | Fraction = 30, crf: int = 28) -> Iterator[np.ndarray]:
    """The frames as they look after H.264 compression, in order: encoded and decoded in memory.

    Odd sizes lose their last row or column to the encoder and get it back as a copy of the one before.
    """
    rate = _rate(frame_rate)
    encoder = decoder = size = None
    for number, frame in enumerate(frames):
        if encoder is None:
            size = _checked(frame, None)
            encoder = av.CodecContext.create("libx264", "w")
            encoder.height, encoder.width = size[0] // 2 * 2, size[1] // 2 * 2
            encoder.pix_fmt, encoder.framerate, encoder.time_base = "yuv420p", rate, 1 / rate
            encoder.options = _options("h264", crf) | {"tune": "zerolatency"}
            encoder.thread_count = 1
            _mark_bt709(encoder)
            decoder = av.CodecContext.create("h264", "r")
            decoder.thread_count = 1
        _checked(frame, size)
        even = np.ascontiguousarray(frame[: encoder.height, : encoder.width])
        for packet in encoder.encode(_picture(even, "yuv420p", number, 1 / rate)):
            yield from _decoded(decoder, packet, size)
    if encoder is not None:
        for packet in encoder.encode(None):
            yield from _decoded(decoder, packet, size)
        yield from _decoded(decoder, None, size)


def _decoded(decoder, packet, size) -> Iterator[np.ndarray]:
    for frame in decoder.decode(packet):
        rgb = frame.to_ndarray(format="rgb24", src_colorspace="ITU709", dst_color_range="JPEG")
        yield np.pad(rgb, ((0, size[0] - rgb.shape[0]), (0, size[1] - rgb.shape[1]), (0, 0)), mode="edge")


def _picture(frame: np.ndarray, pixels: str, number: int, time_base: Fraction) -> av.VideoFrame:
    picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
    if pixels == "yuv420p":
        picture = picture.reformat(format=pixels, dst_colorspace="ITU709", dst_color_range="MPEG")
    elif pixels != "rgb24":
        picture = picture.reformat(format=pixels)
    picture.pts, picture.time_base = number, time_base
    return picture


def _options(codec: str, crf: int) -> dict[str, str]:
    if codec == "ffv1":
        return {"level": "3", "slices": "4", "slicecrc": "1"}
    if codec == "h264_lossless":
        return {"qp": "0", "preset": "fast"}
    if not (isinstance(crf, int) and not isinstance(crf, bool) and 0 <= crf <= 51):
        raise InputError(f"expected crf as a whole number from 0 (best) to 51, got {crf!r}")
    return {"crf": str(crf), "preset": "medium"}


def _mark_bt709(context) -> None:
    # ITU-R BT.709, limited range: what players take an unmarked video of this kind for
    context.color_primaries = context.color_trc = context.colorspace = 1
    context.color_range = 1


def _rate(frame_rate) -> Fraction:
    try:
        rate = frame_rate if isinstance(frame_rate, Fraction) else Fraction(frame_rate).limit_denominator(1001)
    except (TypeError, ValueError, OverflowError):
        rate = Fraction(0)
    if not 0 < rate <= 100_000:
        raise InputError(f"expected frame_rate above 0 and up to 100000 frames per second, got {frame_rate!r}")
    return rate


def _checked(frame, size: tuple[int, int] | None, even: bool = False) -> tuple[int, int]:
    if not (isinstance(frame, np.ndarray) and frame.dtype == np.uint8 and frame.ndim == 3 and frame.shape[2] == 3):
        got = f"{frame.dtype} {frame.shape}" if isinstance(frame, np.ndarray) else type(frame).__name__
        raise InputError(f"expected frames as (height, width, 3) uint8 RGB, got {got}")
    if size is not None and frame.shape[:2] != size:
        raise InputError(f"expected frames of one size, got {frame.shape[:2]} after {size}")
    if even and (frame.shape[0] % 2 or frame.shape[1] % 2):
        raise InputError(f"expected an even height and width for h264, got {frame.shape[:2]}; or use ffv1")
    return frame.shape[:2]
