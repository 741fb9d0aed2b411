"""A long take: when its pictures are shown, which of them are key pictures, and any stretch of them decoded.

Where the file says so itself (mp4, mov, mkv, webm), its packets are read once without decoding and a stretch is decoded
from the key picture before it. Of other files all is decoded, once to know the times and once to cut. Pictures are
counted and timed as `lipmetrics.frames` does it, with its policies.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from pathlib import Path

import av
import numpy as np
from av.video.frame import PictureType

from lipmetrics.endings import VIDEO_ENDINGS
from lipmetrics.errors import InputError
from lipmetrics.frames import VideoInfo, open_frames, open_video

# Only here is every packet one shown picture with its own stamp.
INDEXED_CONTAINERS = ("mov,mp4,m4a,3gp,3g2,mj2", "matroska,webm")
HIDDEN_PACKETS = ("vp8", "vp9", "av1", "libvpx", "libvpx-vp9", "libdav1d", "libaom-av1")  # may have some never shown
NEAR_S = 0.0005  # cut lists give milliseconds


@dataclass(frozen=True)
class LongTake:
    """What is known of a take before it is cut.

    path, info : of the video
    container : FFmpeg's name of its form
    time_base : s per tick
    pts : (N,) int64 ticks at which pictures are shown, increasing
    time_s : (N,) the same in seconds from the first picture
    key : (N,) whether that is a key picture; all False where the file is not indexed
    order : (N,) int64 place of each picture in the file, in order of decoding; empty where the file is not indexed
    end_s : when the last picture ends
    """

    path: Path
    info: VideoInfo
    container: str
    time_base: Fraction
    pts: np.ndarray
    time_s: np.ndarray
    key: np.ndarray
    order: np.ndarray
    end_s: float

    @property
    def indexed(self) -> bool:
        return len(self.order) > 0

    def part(self, start_s: float, stop_s: float) -> tuple[int, int]:
        """First picture shown at `start_s` or later, and first one shown at `stop_s` or later, within half a ms."""
        low, high = np.searchsorted(self.time_s, (start_s - NEAR_S, stop_s - NEAR_S))
        return int(low), int(high)


def read_take(path: str | Path) -> LongTake:
    """Find out when each picture of a take is shown, in one pass.

    Raises
    ------
    InputError : no such file, not a video, or one without a picture that can be decoded
    """
    path = Path(path)
    if not path.is_file():
        near = [one.name for one in sorted(path.parent.glob("*")) if one.suffix.lower() in VIDEO_ENDINGS][:3]
        hint = f"; there are {', '.join(near)}" if near else ""
        what = "a folder" if path.is_dir() else "no file"
        raise InputError(f"expected the video of a take, got {what} at {path}{hint}")
    frames = open_frames(path)
    info = frames.info
    if info.kind != "video":
        raise InputError(f"expected the video of a take, got a picture, {path}")
    with opened(path) as (container, stream):
        kind, time_base = container.format.name, stream.time_base
        found = _packets(container, stream)
    if found is None:
        times = array("d", (frame.time_s for frame in frames))
        pts = np.round(np.asarray(times) / float(time_base)).astype(np.int64)
        key, order = np.zeros(len(pts), bool), np.empty(0, np.int64)
        seconds = np.asarray(times) - times[0]
    else:
        pts, key, order = found
        seconds = (pts - pts[0]) * float(time_base)
    step_s = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 1 / (info.nominal_fps or 25)
    return LongTake(path, info, kind, time_base, pts, seconds, key, order, float(seconds[-1]) + step_s)


def pictures(take: LongTake, parts: Sequence[tuple[int, int]]) -> Iterator[tuple[int, int, av.VideoFrame]]:
    """Decode some parts (first, end) of a take, in order and apart: (which part, which picture of the take, picture).

    A picture that cannot be decoded is missing from what comes.
    """
    if take.indexed:
        for number, (first, end) in enumerate(parts):
            for index, picture in _stretch(take, first, end):
                yield number, index, picture
        return
    number = 0
    for place, frame in enumerate(open_frames(take.path)):  # the very pictures that were counted
        while number < len(parts) and place >= parts[number][1]:
            number += 1
        if number == len(parts):
            return
        if place >= parts[number][0]:
            yield number, place, frame.picture


@contextmanager
def opened(path: Path) -> Iterator[tuple[av.container.InputContainer, av.VideoStream]]:
    """The file and its moving picture, the one that `lipmetrics.frames` takes."""
    with open_video(path) as (container, stream):
        stream.thread_type = "AUTO"
        yield container, stream


def _packets(container, stream) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Stamps in order, key pictures, places in the file; None where packets do not tell."""
    if container.format.name not in INDEXED_CONTAINERS or stream.codec_context.name in HIDDEN_PACKETS:
        return None
    stamps, keys = array("q"), bytearray()
    try:
        for packet in container.demux(stream):
            if not packet.size or packet.is_discard:
                continue
            if packet.pts is None or packet.dts is None or packet.is_corrupt:
                return None
            stamps.append(packet.pts)
            keys.append(packet.is_keyframe)
    except av.error.FFmpegError:
        return None
    pts = np.asarray(stamps, np.int64)
    order = np.argsort(pts, kind="stable")
    pts = pts[order]
    if not len(pts) or (np.diff(pts) <= 0).any() or not keys[0] or order[0] != 0:
        return None
    return pts, np.frombuffer(bytes(keys), bool)[order], order.astype(np.int64)


def _stretch(take: LongTake, first: int, end: int) -> Iterator[tuple[int, av.VideoFrame]]:
    """Pictures first..end-1, decoded from the key picture before them, or from the start where that does not do."""
    start = int(np.flatnonzero(take.key[: first + 1])[-1])
    with opened(take.path) as (container, stream):
        head = _seek(container, stream, int(take.pts[start]))
        if head is not None:
            yield from _wanted(chain([head], container.decode(stream)), take, first, end)
            return
    with opened(take.path) as (container, stream):
        yield from _wanted(_decoded(container, stream), take, first, end)


def _seek(container, stream, pts: int) -> av.VideoFrame | None:
    """The picture at `pts`, if the decoder can begin there; the container then goes on behind it."""
    try:
        container.seek(pts, stream=stream)
        for picture in container.decode(stream):
            if picture.pts is None or picture.pts > pts:
                return None
            if picture.pts == pts:
                return picture if picture.pict_type == PictureType.I and not picture.is_corrupt else None
    except av.error.FFmpegError:
        return None
    return None


def _decoded(container, stream) -> Iterator[av.VideoFrame]:
    """Pictures, past what cannot be decoded."""
    for packet in container.demux(stream):
        try:
            decoded = packet.decode()
        except av.error.FFmpegError:
            continue
        yield from decoded


def _wanted(
    decoded: Iterable[av.VideoFrame], take: LongTake, first: int, end: int
) -> Iterator[tuple[int, av.VideoFrame]]:
    index = first
    try:
        for picture in decoded:
            if picture.pts is None or picture.pts < take.pts[first] or picture.is_corrupt:
                continue
            index = int(np.searchsorted(take.pts, picture.pts))
            if index >= end:
                return
            if take.pts[index] == picture.pts:
                yield index, picture
    except av.error.FFmpegError:
        return
