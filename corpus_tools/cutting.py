"""Clips out of a long take: copied packet by packet where nothing is lost by it, else encoded anew; sound with them.

A clip is copied where its first picture is a key picture and its pictures stand in the file together, so that none of
them needs one outside. Every clip is then decoded once to see that it has its pictures at their times.

Encoded clips are H.264 in the pixel format of the take, lossless unless a quality is asked for: so a clip measures as
the take does. Times between pictures are the take's own, to the tick.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import groupby
from pathlib import Path

import av
import numpy as np
from av.video.frame import PictureType
from av.video.reformatter import ColorRange

from corpus_tools.cuts import Piece
from corpus_tools.long_take import LongTake, opened, pictures
from lipmetrics.atomic import whole_file
from lipmetrics.errors import InputError
from lipmetrics.frames import open_frames

COPIED, ENCODED = "copied", "re-encoded"
PRESET = "fast"
COPIED_CODECS = ("h264", "hevc", "mjpeg", "prores", "dnxhd", "ffv1", "mpeg4")
COPIED_SOUNDS = ("aac", "mp3", "mp3float", "ac3", "alac", "flac", "opus", "vorbis")
AAC_RATES = (8_000, 11_025, 12_000, 16_000, 22_050, 24_000, 32_000, 44_100, 48_000)
_FORMATS = {".mp4": "mp4", ".mov": "mov", ".mkv": "matroska"}
MPEG = int(ColorRange.MPEG)
_KEY_EVERY_S = 0.5  # key pictures of encoded clips: to and fro in a player


@dataclass(frozen=True)
class Made:
    """A clip as it was cut.

    name, path : of the clip
    how : `copied` or `re-encoded`; why : the reason for the latter
    first_frame, last_frame : of the take, counted from 0
    start_s, stop_s : as asked for; first_s, last_s : when these pictures are shown in the take, from its first picture
    sound : `copied`, `re-encoded` or `none`
    error : why there is no clip; empty where there is one
    views : pictures (h, w, 3) uint8 RGB of the clip as written: first, middle, last
    """

    name: str
    path: Path
    how: str
    why: str
    first_frame: int
    last_frame: int
    start_s: float
    stop_s: float
    first_s: float
    last_s: float
    sound: str = "none"
    error: str = ""
    views: tuple[np.ndarray, ...] = ()

    @property
    def frames_n(self) -> int:
        return self.last_frame - self.first_frame + 1


def ending_of(take: LongTake) -> str:
    """Of the clips: a form that holds whatever the take holds."""
    if take.container == "matroska,webm":
        return ".mkv"
    return ".mov" if take.path.suffix.lower() == ".mov" else ".mp4"


def why_not_copied(take: LongTake, first: int, end: int) -> str:
    """Why pictures first..end-1 cannot be copied; empty where they can."""
    if not take.indexed:
        return "the take's form keeps no time of every packet"
    if take.info.codec not in COPIED_CODECS:
        return f"{take.info.codec} is not copied"
    if not take.key[first]:
        return "does not begin on a key picture"
    places = take.order[first:end]
    if places.min() != places[0] or places.max() - places[0] != end - first - 1:
        return "needs a picture outside of it"
    return ""


def plan(take: LongTake, pieces: Sequence[Piece], folder: Path) -> list[Made]:
    """What each piece becomes; nothing is written.

    Raises
    ------
    InputError : a piece beyond the end of the take, or without a picture
    """
    planned = []
    for one in pieces:
        if one.stop_s > take.end_s + 0.5 / max(take.info.nominal_fps, 1) + 0.001:
            raise InputError(
                f"expected cuts inside of the take, which ends at {take.end_s:.3f} s, got {one.name} from "
                f"{one.start_s:g} to {one.stop_s:g} s; are the times from the mark (--mark)?"
            )
        first, end = take.part(one.start_s, one.stop_s)
        if first == end:
            raise InputError(f"expected a picture in {one.name}, got none from {one.start_s:g} to {one.stop_s:g} s")
        why = why_not_copied(take, first, end)
        times = (one.start_s, one.stop_s, float(take.time_s[first]), float(take.time_s[end - 1]))
        path = folder / (one.name + ending_of(take))
        if why and (becomes := _pixels(take.info.pixel_format, True)[1]) not in (take.info.pixel_format, "rgb24"):
            why += f"; {take.info.pixel_format} becomes {becomes}"
        planned.append(Made(one.name, path, ENCODED if why else COPIED, why, first, end - 1, *times))
    return planned


def cut(take: LongTake, planned: Sequence[Made], *, crf: int | None = None, view_px: int = 160) -> Iterator[Made]:
    """Write the clips; each comes as soon as it is whole, those to be copied first.

    What cannot be cut has its `error`; the others go on.

    Parameters
    ----------
    crf : constant rate factor of clips that are encoded, 1 (best) to 51; None is lossless
    """
    to_encode = []
    for one in planned:
        if one.how == ENCODED:
            to_encode.append(one)
            continue
        done = _attempt(take, one, None, crf, view_px)
        if done.error:
            why = f"could not be copied: {done.error}"
            to_encode.append(replace(one, how=ENCODED, why=why))
        else:
            yield done
    to_encode.sort(key=lambda one: one.first_frame)
    parts = [(one.first_frame, one.last_frame + 1) for one in to_encode]
    reached = 0
    for number, group in groupby(pictures(take, parts), key=lambda item: item[0]):
        for lost in to_encode[reached:number]:
            yield replace(lost, error="none of its pictures can be decoded")
        yield _attempt(take, to_encode[number], ((index, picture) for _, index, picture in group), crf, view_px)
        reached = number + 1
    for lost in to_encode[reached:]:
        yield replace(lost, error="none of its pictures can be decoded")


def _attempt(take: LongTake, one: Made, decoded, crf: int | None, view_px: int) -> Made:
    try:
        with whole_file(one.path) as part:
            try:
                sound = _write(take, one, decoded, crf, part)
                views = _checked(take, one, part, view_px)
            except (av.error.FFmpegError, ValueError) as error:
                if isinstance(error, InputError):
                    raise
                raise InputError(" ".join(str(error).split())) from None
    except InputError as error:
        return replace(one, error=str(error))
    return replace(one, sound=sound, views=views)


def _write(take: LongTake, one: Made, decoded, crf: int | None, part: Path) -> str:
    """Write one clip; says what became of its sound."""
    ticks = take.time_base.denominator
    ending = one.path.suffix
    # the index first; the wait before a track's first sample, which mp4 keeps apart, as finely as the times
    options = {} if ending == ".mkv" else {"movflags": "+faststart"}
    if ending != ".mkv":
        options["movie_timescale"] = str(ticks * math.ceil(90_000 / ticks))
    with (
        opened(take.path) as (source, stream),
        av.open(f"file:{part}", "w", format=_FORMATS[ending], options=options) as target,
    ):
        if one.how == COPIED:
            moving = _copied(take, one, source, stream, target)
        else:
            moving = _encoded(take, one, decoded, crf, target)
        head = next(moving, None)  # the stream is made
        if head is None:
            raise InputError("none of its pictures can be decoded")
        kind, sound = "none", iter(())
        with av.open(
            f"file:{take.path}", options={"protocol_whitelist": "file"}, metadata_errors="replace"
        ) as listened:
            if listened.streams.audio and listened.streams.audio[0].codec_context is not None:
                kind, sound = _sound(take, one, listened, target)
            moving = _first_then(head, moving)
            for _, packet in heapq.merge(moving, sound, key=lambda item: item[0]):
                target.mux(packet)
    return kind


def _first_then(head, rest):
    yield head
    yield from rest


def _copied(take: LongTake, one: Made, source, stream, target) -> Iterator[tuple[float, av.Packet]]:
    copy = target.add_stream_from_template(stream)
    zero, last = int(take.pts[one.first_frame]), int(take.pts[one.last_frame])
    source.seek(zero, stream=stream)
    left_n = one.frames_n
    for packet in source.demux(stream):
        if packet.pts is None or not packet.size or not zero <= packet.pts <= last:
            continue
        packet.pts -= zero
        packet.dts -= zero
        packet.stream = copy
        yield float(packet.dts * take.time_base), packet
        left_n -= 1
        if not left_n:
            return
    raise InputError(f"{left_n} of its {one.frames_n} pictures were not found again")


def _encoded(take: LongTake, one: Made, decoded, crf: int | None, target) -> Iterator[tuple[float, av.Packet]]:
    zero, video, written_n = int(take.pts[one.first_frame]), None, 0
    for index, picture in decoded:
        if video is None:
            video, pixels = _encoder(take, picture, crf, target)
        if picture.format.name != pixels:
            picture = picture.reformat(format=pixels)
        picture.pts, picture.time_base = int(take.pts[index]) - zero, take.time_base
        picture.pict_type = PictureType.NONE  # the encoder chooses, not the take
        written_n += 1
        for packet in video.encode(picture):
            yield float(packet.pts * packet.time_base), packet
    if written_n != one.frames_n:
        raise InputError(f"{one.frames_n - written_n} of its {one.frames_n} pictures are damaged in the take")
    for packet in video.encode():
        yield float(packet.pts * packet.time_base), packet


def _encoder(take: LongTake, picture: av.VideoFrame, crf: int | None, target):
    """The stream, of the take's size, turn, colours and times, and its pixel format."""
    name, pixels = _pixels(picture.format.name, crf is None)
    rate = Fraction(take.info.nominal_fps if take.info.nominal_fps > 0 else 25).limit_denominator(1001)
    video = target.add_stream(name, rate=max(rate, Fraction(1, 1000)))
    video.width, video.height, video.pix_fmt = picture.width, picture.height, pixels
    # no pictures out of order: then every packet has its own time, and no player needs an edit list to be in time
    video.options = {"preset": PRESET, "bf": "0", **({"qp": "0"} if crf is None else {"crf": str(crf)})}
    if picture.color_range == MPEG:
        video.options |= {"x264-params": "videoformat=component"}  # else it would not be written, as it is the usual
    video.gop_size = max(1, round(_KEY_EVERY_S * float(rate)))
    context = video.codec_context
    context.time_base = video.time_base = take.time_base
    aspect = Fraction(take.info.pixel_aspect).limit_denominator(1000)
    context.sample_aspect_ratio = 1 / aspect if take.info.rotation_deg % 180 else aspect
    for colour in ("color_range", "colorspace", "color_primaries", "color_trc"):
        setattr(context, colour, getattr(picture, colour))
    if take.info.rotation_deg or take.info.mirrored:
        video.set_display_rotation(take.info.rotation_deg, hflip=take.info.mirrored)
    return video, pixels


def _pixels(name: str, lossless: bool) -> tuple[str, str]:
    """Encoder and pixel format for pictures of such a format: the same where there is one, else the nearest."""
    known = {one.name for one in av.Codec("libx264", "w").video_formats}
    if name in known:
        return "libx264", name
    given = av.VideoFormat(name)
    deep = "10le" if given.components[0].bits > 8 else ""
    if given.is_rgb:
        return ("libx264", f"yuv444p{deep}") if deep or not lossless else ("libx264rgb", "rgb24")
    sampling = next((part for part in ("444", "422") if part in name), "420")
    return "libx264", f"yuv{sampling}p{deep}"


def _sound(take: LongTake, one: Made, source, target) -> tuple[str, Iterator[tuple[float, av.Packet]]]:
    """What becomes of the sound, and its packets with their times."""
    stream = source.streams.audio[0]
    zero_s = _clock(take, one.first_frame)
    stop_s = zero_s + one.last_s - one.first_s + _step_s(take, one)
    name = stream.codec_context.name
    span_s = (zero_s, stop_s)
    if name in COPIED_SOUNDS and one.path.suffix in (".mp4", ".mov", ".mkv") and _fits(name, one.path.suffix):
        copy = target.add_stream_from_template(stream)
        return COPIED, _copied_sound(source, stream, copy, span_s)
    keeps = name.startswith("pcm_") and one.path.suffix != ".mp4" and name in av.codecs_available
    rate = stream.rate if keeps or stream.rate in AAC_RATES else 48_000
    layout = stream.layout.name if keeps else ("mono" if stream.channels == 1 else "stereo")
    encoder = target.add_stream(name if keeps else "aac", rate=rate, layout=layout)
    return ENCODED, _encoded_sound(source, stream, encoder, span_s)


def _fits(name: str, ending: str) -> bool:
    return name != "vorbis" or ending == ".mkv"


def _clock(take: LongTake, frame: int) -> float:
    """The time of a picture on the file's own clock, s."""
    return float(int(take.pts[frame]) * take.time_base)


def _step_s(take: LongTake, one: Made) -> float:
    """How long the last picture is shown."""
    following = one.last_frame + 1
    after_s = float(take.time_s[following]) if following < len(take.time_s) else take.end_s
    return after_s - one.last_s


def _sound_packets(source, stream, start_s: float) -> Iterator[av.Packet]:
    """Packets from at most a second before a time on; from the start of the file where it cannot go there."""
    if start_s > 1:
        source.seek(int((start_s - 1) * av.time_base))
        head = next((packet for packet in source.demux(stream) if packet.pts is not None), None)
        if head is None or head.pts * stream.time_base > start_s - 0.1:
            source.seek(0)
        else:
            yield head
    yield from source.demux(stream)


def _copied_sound(source, stream, copy, span_s: tuple[float, float]) -> Iterator[tuple[float, av.Packet]]:
    """Packets that begin inside; the first one does so a few hundredths of a second late at most."""
    zero, last = round(Fraction(span_s[0]) / stream.time_base), -math.inf
    for packet in _sound_packets(source, stream, span_s[0]):
        if packet.pts is None or packet.pts <= last or packet.pts < zero:
            continue
        if packet.pts * stream.time_base >= span_s[1]:
            return
        last = packet.pts
        packet.pts = packet.dts = last - zero
        packet.stream = copy
        yield float(packet.pts * packet.time_base), packet


def _encoded_sound(source, stream, encoder, span_s: tuple[float, float]) -> Iterator[tuple[float, av.Packet]]:
    """Samples from the first to the last picture, to the sample."""
    rate = encoder.rate
    form = encoder.codec_context.format or encoder.codec_context.codec.audio_formats[0]
    resampler = av.AudioResampler(format=form.name, layout=encoder.layout.name, rate=rate)
    total_n = round((span_s[1] - span_s[0]) * rate)
    for packet in _sound_packets(source, stream, span_s[0]):
        if packet.pts is not None and packet.pts * stream.time_base >= span_s[1]:
            break
        try:
            frames = packet.decode()
        except av.error.FFmpegError:  # a damaged piece of sound is a short silence
            continue
        for given in frames:
            if given.pts is None:
                continue
            for frame in resampler.resample(given):
                at = round((frame.pts * frame.time_base - Fraction(span_s[0])) * rate)
                kept = _trimmed(frame, max(0, -at), min(frame.samples, total_n - at))
                if kept is not None:
                    kept.pts, kept.time_base = max(at, 0), Fraction(1, rate)
                    for done in encoder.encode(kept):
                        yield float(done.pts * done.time_base), done
    for done in encoder.encode():
        yield float(done.pts * done.time_base), done


def _trimmed(frame: av.AudioFrame, low: int, high: int) -> av.AudioFrame | None:
    if high <= low:
        return None
    if low == 0 and high == frame.samples:
        return frame
    width = 1 if frame.format.is_planar else frame.layout.nb_channels
    samples = np.ascontiguousarray(frame.to_ndarray()[:, low * width : high * width])
    kept = av.AudioFrame.from_ndarray(samples, format=frame.format.name, layout=frame.layout.name)
    kept.sample_rate = frame.sample_rate
    return kept


def _checked(take: LongTake, one: Made, path: Path, view_px: int) -> tuple[np.ndarray, ...]:
    """Decode the clip that was written: its pictures are as many as they should be, at their times.

    Returns views of the first, the middle and the last one.

    Raises
    ------
    InputError : they are not
    """
    expected = take.time_s[one.first_frame : one.last_frame + 1] - one.first_s
    wanted = {0, one.frames_n // 2, one.frames_n - 1}
    views, times = [], []
    source = open_frames(path)
    for place, frame in enumerate(source):
        times.append(frame.time_s)
        if place == 0 and one.how == COPIED and frame.picture.pict_type != PictureType.I:
            raise InputError("its first picture cannot be decoded by itself")
        if place in wanted:
            views.append(view(frame, view_px))
    if len(times) != one.frames_n or np.abs(np.asarray(times) - expected).max() > 1.5 * float(take.time_base) + 1e-6:
        raise InputError(f"expected {one.frames_n} pictures at their times, got {len(times)}")
    return tuple(views[k] for k in (0, len(views) // 2, -1))


def view(frame, width_px: int) -> np.ndarray:
    """A small picture of a frame, about `width_px` wide, (h, w, 3) uint8 RGB."""
    block = max(1, round(frame.width / width_px))
    return frame.averaged((0, frame.height, 0, frame.width), (block, block))
