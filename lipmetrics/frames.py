"""Pictures with their times, from a video file, a folder of pictures or a pattern such as ``take/*.png``.

Policies, so that a time or a picture is never silently wrong; whatever they do to a clip is told in `warnings`:

- Times are presentation time stamps of the file in seconds, on the file's own clock (which need not start at 0).
  AVI stores none, so there it is the time its frames are decoded by. A frame without a stamp gets its decoding
  stamp, else it follows the frame before it by one step of the nominal frame rate.
- Times strictly increase. A frame whose stamp is not later than the one before it is left out, as a player would do;
  where the clock jumps back by more than a second (joined recordings) it goes on from the frame before the jump.
- Packets that cannot be decoded are gone past, and pictures the decoder marks as damaged are left out.
- `Frame.index` counts the pictures that come out of the file, left out or not, from 0.
- Rotation and mirroring asked for by the file are applied here, once. Sizes, regions and pixels are as displayed.
"""

from __future__ import annotations

import csv
import glob
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path

import av
import numpy as np
from av.stream import Disposition
from av.video.frame import PictureType
from av.video.reformatter import VideoReformatter

from lipmetrics.endings import PICTURE_ENDINGS
from lipmetrics.errors import InputError
from lipmetrics.pixels import (
    Turn,
    averaged,
    averaged_rgb,
    can_cut,
    displayed_size,
    to_rgb,
    turn_by_angle,
    turn_of,
)

MAX_SIDE_PX = 20_000
MAX_FPS = 100_000.0
_FALLBACK_STEP_S = 1 / 25
_CLOCK_RESTART_S = 1.0
_MAX_READ_ERRORS = 100
decoder_threads_n = 0  # 0: one for every core; a process that works beside others sets it to 1

# Only here do the packets alone tell the index of a picture: every packet is one shown picture with its own stamp.
_JUMPABLE_CONTAINERS = ("mov,mp4,m4a,3gp,3g2,mj2", "matroska,webm")
_NOT_JUMPABLE_CODECS = ("vp8", "libvpx")  # has packets that are never shown

_PICTURE_DECODERS = (
    (re.compile(rb"\x89PNG"), "png"),
    (re.compile(rb"\xff\xd8"), "mjpeg"),
    (re.compile(rb"II\*\0|MM\0\*"), "tiff"),
    (re.compile(rb"BM"), "bmp"),
    (re.compile(rb"RIFF....WEBP", re.DOTALL), "webp"),
    (re.compile(rb"P6"), "ppm"),
    (re.compile(rb"P5"), "pgm"),
)


@dataclass(frozen=True)
class VideoInfo:
    """Facts about a source. Sizes in px as displayed; what the source does not tell is NaN or an empty string.

    kind : ``video`` or ``images``
    rotation_deg : turn to the left that the file asks for and the reader applied: 0, 90, 180 or 270
    mirrored : whether the picture is mirrored left to right after that turn
    pixel_aspect : width of a pixel over its height, as displayed
    nominal_fps : the rate the file names; times do not follow from it
    """

    path: str
    kind: str
    width: int
    height: int
    rotation_deg: int
    mirrored: bool
    pixel_aspect: float
    time_base: str
    codec: str
    pixel_format: str
    nominal_fps: float
    has_audio: bool
    duration_s: float


class Frame:
    """One picture: index in the source, presentation time in seconds, height and width in px as displayed."""

    __slots__ = ("_picture", "_reformatter", "_turn", "_whole", "height", "index", "time_s", "width")

    def __init__(
        self, index: int, time_s: float, picture: av.VideoFrame, turn: Turn, reformatter: VideoReformatter
    ) -> None:
        self.index = index
        self.time_s = time_s
        self.height, self.width = displayed_size(picture, turn)
        self._picture = picture
        self._turn = turn
        self._reformatter = reformatter
        self._whole: np.ndarray | None = None

    @property
    def picture(self) -> av.VideoFrame:
        """The picture as it was decoded: in its own pixel format, not turned."""
        return self._picture

    def rgb(self, region: tuple[int, int, int, int] | None = None) -> np.ndarray:
        """The picture, or only the region (row0, row1, col0, col1) of it, as a new (h, w, 3) uint8 RGB array.

        The region is half open, in px as displayed, and inside the picture. Only the region is converted.
        """
        if region is None or can_cut(self._picture):
            return to_rgb(self._picture, self._turn, region, self._reformatter)
        if self._whole is None:
            self._whole = to_rgb(self._picture, self._turn, None, self._reformatter)
        row0, row1, col0, col1 = region
        return self._whole[row0:row1, col0:col1].copy()

    def averaged(self, region: tuple[int, int, int, int], block: tuple[int, int]) -> np.ndarray:
        """Means of `rgb(region)` over blocks of so many rows and columns; what is left at its end is left out."""
        if can_cut(self._picture):
            return averaged_rgb(self._picture, self._turn, region, block, self._reformatter)
        return averaged(self.rgb(region), block)


class FrameSource:
    """What `open_frames` returns. Each iteration reads the source anew from its start."""

    def __init__(
        self,
        info: VideoInfo,
        read: Callable[[_Notes], Iterator[tuple[int, float, object]]],
        load: Callable[[object], tuple[av.VideoFrame, Turn]],
        notes: _Notes,
        span: tuple[float, float],
        every: int,
        tick_s: float,
    ) -> None:
        self.info = info
        self.variable_frame_rate = False
        self._read = read
        self._load = load
        self._notes_at_open = notes
        self._notes = notes
        self._span = span
        self._every = every
        self._tick_s = tick_s
        self._running: Iterator[Frame] | None = None

    @property
    def warnings(self) -> list[str]:
        """What was found wrong with the source so far; complete after an iteration."""
        return self._notes.lines()

    def __enter__(self) -> FrameSource:
        return self

    def __exit__(self, *_: object) -> None:
        if self._running is not None:
            self._running.close()

    def __iter__(self) -> Iterator[Frame]:
        self._running = self._frames()
        return self._running

    def _frames(self) -> Iterator[Frame]:
        start_s, stop_s = self._span
        self._notes = notes = self._notes_at_open.copy()
        self.variable_frame_rate = False
        reformatter = VideoReformatter()
        shortest, longest, seen_s, last_s, given = math.inf, 0.0, math.nan, math.nan, 0
        for index, time_s, item in self._read(notes):
            if math.isnan(seen_s):
                seen_s = time_s
            if time_s >= stop_s:
                break
            if time_s >= start_s:
                if not math.isnan(last_s):
                    shortest, longest = min(shortest, time_s - last_s), max(longest, time_s - last_s)
                    self.variable_frame_rate = longest - shortest > max(1.5 * self._tick_s, 0.05 * shortest)
                last_s = time_s
                if index % self._every == 0:
                    frame = Frame(index, time_s, *self._load(item), reformatter)
                    if (frame.height, frame.width) == (self.info.height, self.info.width):
                        given += 1
                        yield frame
                    elif self.info.kind == "images":
                        raise InputError(
                            f"expected pictures of one size, but {item} is {frame.width} x {frame.height} px where the "
                            f"first one is {self.info.width} x {self.info.height} px; leave it out or resize it"
                        )
                    else:
                        notes.add(f"frame of another size ({frame.width} x {frame.height} px), left out", time_s)
        if math.isnan(seen_s):
            raise InputError(f"expected a picture in {self.info.path}, but all are damaged; check the recording")
        if not given:
            raise InputError(
                f"expected a time range and step that meet a frame of {self.info.path}, but got start {start_s:g} s, "
                f"stop {stop_s:g} s, every {self._every}, where the first frame read is at {seen_s:g} s; widen them"
            )


class _Notes:
    """Warnings of one pass over a source; one that comes again is counted."""

    def __init__(self, seen: dict[str, tuple[int, float]] | None = None) -> None:
        self._seen = {} if seen is None else dict(seen)

    def copy(self) -> _Notes:
        return _Notes(self._seen)

    def add(self, text: str, time_s: float = math.nan) -> None:
        count, first_s = self._seen.get(text, (0, time_s))
        self._seen[text] = (count + 1, first_s)

    def lines(self) -> list[str]:
        return [
            text + (f" ({count} x, first near {first_s:.3f} s)" if not math.isnan(first_s) else "")
            for text, (count, first_s) in self._seen.items()
        ]


def open_frames(
    source: str | os.PathLike,
    *,
    fps: float | None = None,
    timestamps: str | os.PathLike | Sequence[float] | None = None,
    start_s: float | None = None,
    stop_s: float | None = None,
    every: int = 1,
) -> FrameSource:
    """Open a video file, a folder of pictures (natural order) or a pattern for reading, frame by frame.

    fps, timestamps : one of the two for a sequence of pictures, none for a video. `timestamps` is a file with one time
        in seconds per line, or a table with a column ``time_s``, or the times themselves; strictly increasing.
    start_s, stop_s : give frames with start_s <= time < stop_s, in seconds on the clock of the source
    every : give frames whose index is a multiple of it

    Raises InputError here for a source that cannot be read and for arguments that do not fit, and while iterating for
    a bad picture of a sequence and where no frame is left.
    """
    span = _checked_span(start_s, stop_s)
    if isinstance(every, bool) or not isinstance(every, int | np.integer) or every < 1:
        raise InputError(f"expected every to be a whole number of at least 1, but got {every!r}")
    path = Path(source)
    if path.is_file() and path.suffix.lower() not in PICTURE_ENDINGS:
        if fps is not None or timestamps is not None:
            raise InputError(
                f"expected fps or timestamps only with pictures, but {path} is a video, which has its own times; leave "
                "them out"
            )
        return _open_video(path, span, int(every))
    return _open_pictures(_pictures_of(path), path, fps, timestamps, span, int(every))


def _checked_span(start_s: float | None, stop_s: float | None) -> tuple[float, float]:
    start = 0.0 if start_s is None else float(start_s)
    stop = math.inf if stop_s is None else float(stop_s)
    if not 0 <= start < math.inf or math.isnan(stop) or stop <= start:
        raise InputError(f"expected 0 <= start < stop in seconds, but got start {start:g} and stop {stop:g}")
    # A recording may begin shortly before 0; only a start that is asked for cuts it.
    return (-math.inf if start_s is None else start), stop


def _check_size(path: Path, width: int, height: int) -> None:
    if max(width, height) > MAX_SIDE_PX:
        raise InputError(
            f"expected pictures of at most {MAX_SIDE_PX} px a side, but {path} is {width} x {height} px; shrink it"
        )


# --- video files ------------------------------------------------------------------------------------------------------


def _open_video(path: Path, span: tuple[float, float], every: int) -> FrameSource:
    notes = _Notes()
    with open_video(path) as (container, stream):
        first = next(_decoded(container, stream, _packets(container, stream, _Notes()), _Notes()), None)
        if first is None:
            raise InputError(f"expected at least one picture in {path}, but none can be decoded; check the recording")
        turn = turn_of(first)
        height, width = displayed_size(first, turn)
        _check_size(path, width, height)
        rate = stream.guessed_rate or stream.average_rate
        step_s = float(1 / rate) if rate else _FALLBACK_STEP_S
        aspect = float(stream.sample_aspect_ratio or 1)
        info = VideoInfo(
            path=str(path),
            kind="video",
            width=width,
            height=height,
            **_turn_facts(turn),
            pixel_aspect=1 / aspect if turn.transpose else aspect,
            time_base=str(stream.time_base),
            codec=stream.codec_context.name,
            pixel_format=first.format.name,
            nominal_fps=float(rate) if rate else math.nan,
            has_audio=bool(container.streams.audio),
            duration_s=_duration_s(container, stream),
        )
        tick_s = float(stream.time_base)
    if info.pixel_aspect != 1:
        notes.add(
            f"pixels are {info.pixel_aspect:.4g} times as wide as high, so widths and heights in px differ in scale"
        )
    read = partial(_read_video, path=path, start_s=span[0], step_s=step_s, first_pts=first.pts)
    return FrameSource(info, read, lambda picture: (picture, turn), notes, span, every, tick_s)


def _turn_facts(turn: Turn) -> dict[str, int | bool]:
    # A turn by 90 degrees is a transposition and one flip, so it mirrors where the count of the three is odd.
    mirrored = (turn.transpose + turn.flip_rows + turn.flip_cols) % 2 == 1
    flip_cols = turn.flip_cols != mirrored
    rotation_deg = (270 if flip_cols else 90) if turn.transpose else (180 if flip_cols else 0)
    return {"rotation_deg": rotation_deg, "mirrored": mirrored}


def _duration_s(container: av.container.InputContainer, stream: av.VideoStream) -> float:
    if stream.duration is not None:
        return float(stream.duration * stream.time_base)
    return container.duration / av.time_base if container.duration is not None else math.nan


@contextmanager
def open_video(path: Path) -> Iterator[tuple[av.container.InputContainer, av.VideoStream]]:
    """The opened file and its moving picture, closed afterwards; InputError if there is none."""
    if path.stat().st_size == 0:
        raise InputError(f"expected a video, but {path} is empty (0 bytes); copy or record it again")
    try:
        # The prefix and the whitelist keep odd file names and playlists from opening anything but this file.
        container = av.open(f"file:{path}", options={"protocol_whitelist": "file"}, metadata_errors="replace")
    except (av.error.FFmpegError, OSError) as error:
        raise InputError(
            f"cannot read {path} as a video ({error.strerror}): expected mp4, mov, avi, mpg, mkv or webm, but it is "
            "something else or was cut off before its index was written"
        ) from error
    with container:
        streams = [s for s in container.streams.video if not s.disposition & Disposition.attached_pic]
        if container.format.name == "tty":  # FFmpeg draws plain text as a picture
            raise InputError(f"expected a video, but {path} is a text file; give the recording itself")
        if not streams:
            what = "sound only" if container.streams.audio else "no moving picture"
            raise InputError(f"expected a video, but {path} holds {what}; give the recording with its picture")
        streams = [s for s in streams if s.codec_context is not None]
        if not streams:
            raise InputError(f"expected a video, but {path} holds a kind of picture that is unknown; convert it to mp4")
        stream = max(streams, key=lambda s: (bool(s.disposition & Disposition.default), s.width * s.height))
        _check_size(path, stream.width, stream.height)
        stream.codec_context.thread_count = decoder_threads_n
        yield container, stream


def _read_video(
    notes: _Notes, path: Path, start_s: float, step_s: float, first_pts: int | None
) -> Iterator[tuple[int, float, av.VideoFrame]]:
    if start_s > 0:
        with open_video(path) as (container, stream):
            stream.thread_type = "AUTO"
            jumped = _jump(container, stream, start_s, first_pts, notes)
            if jumped is not None:
                index, pictures = jumped
                yield from _timed(_stamped(container, stream, pictures, notes), step_s, index, notes)
                return
    with open_video(path) as (container, stream):
        stream.thread_type = "AUTO"
        pictures = _decoded(container, stream, _packets(container, stream, notes), notes)
        yield from _timed(_stamped(container, stream, pictures, notes), step_s, 0, notes)


def _jump(
    container: av.container.InputContainer,
    stream: av.VideoStream,
    start_s: float,
    first_pts: int | None,
    notes: _Notes,
) -> tuple[int, Iterator[av.VideoFrame]] | None:
    """Go to the last key picture before the start without decoding what lies before it.

    Returns its index in the file and the pictures from there on. Returns None wherever that could differ from
    decoding everything: then the file has to be opened again and read from its first picture.
    """
    if container.format.name not in _JUMPABLE_CONTAINERS or stream.codec_context.name in _NOT_JUMPABLE_CODECS:
        return None
    start = start_s / stream.time_base
    shown, key = [], None
    for packet in _packets(container, stream, _Notes()):  # what it finds is found again when decoding
        if not packet.size:
            break
        if packet.pts is None:
            return None
        if not packet.is_discard:
            shown.append(packet.pts)
            if packet.is_keyframe and packet.pts <= start:
                key = packet.pts
        # Stamps are never earlier than the decoding stamp, so from here on all are later than the start.
        if packet.dts is not None and packet.dts > start:
            break
    if key is None or min(shown) != first_pts:
        return None
    try:
        container.seek(key, stream=stream)
    except av.error.FFmpegError:
        return None
    packets = _packets(container, stream, notes)
    first = next(packets, None)
    if first is None or first.pts is None or first.pts > start:
        return None
    pictures = _decoded(container, stream, chain([first], packets), notes)
    head = next(pictures, None)
    # Otherwise pictures come that need what was jumped over, or the packet was only called a key picture.
    if head is None or head.pts != first.pts or head.pict_type != PictureType.I:
        return None
    return sum(pts < first.pts for pts in shown), chain([head], pictures)


def _packets(container: av.container.InputContainer, stream: av.VideoStream, notes: _Notes) -> Iterator[av.Packet]:
    """All packets, then the empty one that drains the decoder; goes on after stretches that cannot be read."""
    for _ in range(_MAX_READ_ERRORS):
        try:
            yield from container.demux(stream)
            return
        except av.error.FFmpegError as error:
            notes.add(f"part of the file cannot be read ({error.strerror}), gone past")


def _decoded(
    container: av.container.InputContainer, stream: av.VideoStream, packets: Iterable[av.Packet], notes: _Notes
) -> Iterator[av.VideoFrame]:
    count, end_s = 0, 0.0
    for packet in packets:
        time_s = math.nan if packet.pts is None else float(packet.pts * stream.time_base)
        if packet.size:
            count += 1
            end_s = max(end_s, time_s + float((packet.duration or 0) * stream.time_base))
        if packet.is_corrupt:
            notes.add("packet lies in a damaged or cut-off part of the file", time_s)
        try:
            pictures = packet.decode()
        except av.error.FFmpegError:
            notes.add("packet cannot be decoded, gone past", time_s)
            continue
        yield from pictures
    if _is_cut_off(container, stream, count, end_s):
        notes.add(f"the file is cut off: its header promises more than the {end_s:.3f} s that can be read")


def _is_cut_off(container: av.container.InputContainer, stream: av.VideoStream, packets: int, end_s: float) -> bool:
    """Whether the file ends before what its header promises; mpg has no such header."""
    if container.format.name == "avi":
        return stream.frames > packets
    if container.format.name == "matroska,webm":
        clock = re.fullmatch(r"(\d+):(\d+):([\d.]+)", stream.metadata.get("DURATION", ""))
        rate = stream.guessed_rate or stream.average_rate
        step_s = float(1 / rate) if rate else _FALLBACK_STEP_S
        return clock is not None and end_s + 1.5 * step_s < sum(
            float(part) * unit for part, unit in zip(clock.groups(), (3600, 60, 1), strict=True)
        )
    entries = stream.index_entries
    return len(entries) > 0 and entries[-1].pos + entries[-1].size > container.size


def _stamped(
    container: av.container.InputContainer, stream: av.VideoStream, pictures: Iterable[av.VideoFrame], notes: _Notes
) -> Iterator[tuple[float | None, bool, av.VideoFrame]]:
    """Each picture with its stamp in seconds (None where the file has none) and whether it is damaged."""
    # What FFmpeg calls presentation stamps in AVI is guessed from the order of decoding, and wrong with B-frames.
    is_avi = container.format.name == "avi"
    ticks_up, ticks_down = stream.time_base.numerator, stream.time_base.denominator
    for picture in pictures:
        stamp = picture.dts if is_avi or picture.pts is None else picture.pts
        if picture.pts is None:
            notes.add("frame without a presentation time stamp, timed by its decoding stamp or the frame before it")
        if picture.interlaced_frame:
            notes.add("frame is interlaced, used as it is")
        yield None if stamp is None else stamp * ticks_up / ticks_down, picture.is_corrupt, picture


def _timed(
    stamped: Iterable[tuple[float | None, bool, object]], step_s: float, first_index: int, notes: _Notes
) -> Iterator[tuple[int, float, object]]:
    """(index, time, picture) with strictly increasing times, by the policies in the module's head."""
    last_s, shift_s = math.nan, 0.0
    for index, (stamp_s, damaged, picture) in enumerate(stamped, first_index):
        following_s = 0.0 if math.isnan(last_s) else last_s + step_s
        time_s = following_s if stamp_s is None else stamp_s + shift_s
        if damaged:
            notes.add("frame is damaged, left out", time_s)
            continue
        if time_s < last_s - _CLOCK_RESTART_S:
            notes.add("time stamps start again, continued one frame step after the frame before", last_s)
            shift_s += following_s - time_s
            time_s = following_s
        elif time_s <= last_s:
            notes.add("frame is not later than the one before it, left out", last_s)
            continue
        last_s = time_s
        yield index, time_s, picture


# --- sequences of pictures --------------------------------------------------------------------------------------------


def _pictures_of(source: Path) -> list[Path]:
    if source.is_file():
        return [source]
    if source.is_dir():
        found = [path for path in source.iterdir() if path.is_file()]
    elif source.exists():
        raise InputError(f"expected a file or a folder, but {source} is neither; copy the recording into a file")
    elif glob.has_magic(str(source)):
        found = [Path(name) for name in glob.glob(str(source), recursive=True) if os.path.isfile(name)]
    else:
        raise InputError(
            f"expected a video file, a folder of pictures or a pattern like '*.png', but {source} does not exist; "
            "check the path"
        )
    pictures = [path for path in found if path.suffix.lower() in PICTURE_ENDINGS and not path.name.startswith(".")]
    if not pictures:
        raise InputError(
            f"expected pictures ({', '.join(sorted(PICTURE_ENDINGS))}) in {source}, but there is none among its "
            f"{len(found)} files; give the folder that holds them, or a video file by its name"
        )
    return sorted(pictures, key=lambda path: (str(path.parent), _natural(path.name)))


def _natural(name: str) -> list[tuple[int, str]]:
    """Sort key that puts frame_2 before frame_10."""
    return [(int(part), "") if part.isdecimal() else (-1, part.lower()) for part in re.split(r"([0-9]+)", name)] + [
        (-1, name)
    ]


def _open_pictures(
    pictures: list[Path],
    source: Path,
    fps: float | None,
    timestamps: str | os.PathLike | Sequence[float] | None,
    span: tuple[float, float],
    every: int,
) -> FrameSource:
    times_s = _picture_times(len(pictures), source, fps, timestamps)
    first, turn = _load_picture(pictures[0])
    height, width = displayed_size(first, turn)
    notes = _Notes()
    if len({path.suffix.lower() for path in pictures}) > 1:
        notes.add("pictures of several file types are read as one sequence; give a pattern to choose one")
    if timestamps is None and _has_gaps(pictures):
        notes.add("the numbers in the file names have gaps, but times are counted by position; give time stamps")
    info = VideoInfo(
        path=str(source),
        kind="images",
        width=width,
        height=height,
        **_turn_facts(turn),
        pixel_aspect=1.0,
        time_base="",
        codec=_decoder_of(pictures[0].read_bytes()[:16]),
        pixel_format=first.format.name,
        nominal_fps=math.nan if fps is None else float(fps),
        has_audio=False,
        duration_s=math.nan if fps is None else len(pictures) / float(fps),
    )
    return FrameSource(
        info,
        lambda _: zip(range(len(pictures)), times_s, pictures, strict=True),
        _load_picture,
        notes,
        span,
        every,
        0.0,
    )


def _picture_times(
    count: int, source: Path, fps: float | None, timestamps: str | os.PathLike | Sequence[float] | None
) -> list[float]:
    if fps is not None and timestamps is not None:
        raise InputError("expected fps or timestamps, but got both; give the one that is right")
    if timestamps is not None:
        return _times_from(timestamps, count)
    if fps is None:
        if count == 1:
            return [0.0]
        raise InputError(f"expected fps or timestamps for the {count} pictures of {source}, but got neither; give one")
    try:
        rate = float(fps)
    except (TypeError, ValueError):
        rate = math.nan
    if not 0 < rate <= MAX_FPS:
        raise InputError(f"expected fps above 0 and at most {MAX_FPS:g}, but got {fps!r}; give pictures per second")
    return [index / rate for index in range(count)]


def _times_from(timestamps: str | os.PathLike | Sequence[float], count: int) -> list[float]:
    if isinstance(timestamps, str | os.PathLike):
        name, values = str(timestamps), _times_in_file(Path(timestamps))
    else:
        name, values = "timestamps", list(timestamps)
    try:
        times_s = [float(value) for value in values]
    except (TypeError, ValueError) as error:
        raise InputError(f"expected times in seconds in {name}, but got something else ({error})") from error
    if len(times_s) != count:
        raise InputError(f"expected one time for each of the {count} pictures, but {name} has {len(times_s)}")
    for place, (before, after) in enumerate(zip([-math.inf, *times_s[:-1]], times_s, strict=True)):
        if not (before < after < math.inf):
            raise InputError(
                f"expected strictly increasing times in seconds, but in {name} time {place + 1} is {after:g} after "
                f"{before:g}; correct it"
            )
    return times_s


def _times_in_file(path: Path) -> list[str]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read time stamps from {path} ({error}); expected a text file of seconds") from error
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise InputError(f"expected times in seconds in {path}, but it is empty")
    delimiter = next((sign for sign in ("\t", ";", ",") if sign in lines[0]), ",")
    try:
        rows = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=delimiter)]
    except csv.Error as error:
        raise InputError(f"expected times in seconds in {path}, but: {error}") from None
    if "time_s" in rows[0]:
        column = rows[0].index("time_s")
        return [row[column] if column < len(row) else "" for row in rows[1:]]
    if any(len(row) != 1 for row in rows):
        raise InputError(f"expected one time per line or a column time_s in {path}, but its first line is {lines[0]!r}")
    return [row[0] for row in rows]


def _has_gaps(pictures: list[Path]) -> bool:
    """Whether the last numbers in the names do not go up in equal steps."""
    numbers = [re.findall(r"[0-9]+", path.stem)[-1:] for path in pictures]
    if not all(numbers):
        return False
    return len(set(np.diff([int(number[0]) for number in numbers]).tolist())) > 1


def _load_picture(path: Path) -> tuple[av.VideoFrame, Turn]:
    """Decode one picture file; raises InputError that names it."""
    try:
        data = path.read_bytes()
        decoder = av.CodecContext.create(_decoder_of(data[:16]), "r")
        decoder.thread_count = 1
        picture = next(iter(decoder.decode(av.Packet(data)) or decoder.decode(None)))
    except (av.error.FFmpegError, OSError, StopIteration, ValueError) as error:
        raise InputError(f"cannot read picture {path} ({error}); replace it or take it out of the sequence") from error
    _check_size(path, picture.width, picture.height)
    return picture, turn_by_angle(picture)


def _decoder_of(head: bytes) -> str:
    for magic, decoder in _PICTURE_DECODERS:
        if magic.match(head):
            return decoder
    raise ValueError("not a known picture format")
