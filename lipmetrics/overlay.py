"""The overlay video: the source as it plays, with outlines, mouth corners and numbers drawn, to check a profile by."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from pathlib import Path

import av
import cv2
import numpy as np

from lipmetrics import draw
from lipmetrics.atomic import whole_file
from lipmetrics.frames import Frame, VideoInfo, open_frames
from lipmetrics.profile import Profile

# Below this many rows numbers and outlines are too coarse to read, so the picture is enlarged by a whole factor ...
SMALL_PX = 480
# ... and beyond this many px in all (4K), or on a side, few players decode H.264, so it is shrunk.
LARGE_AREA_PX = 3840 * 2160
LARGE_SIDE_PX = 8192
# Pictures have no time base; their times are kept to this.
MICROSECOND = Fraction(1, 1_000_000)
# A clip whose clock starts later than this plays from its first frame on.
LONGEST_WAIT_S = 1.0
# Sound that an mp4 in a browser plays as it is; every other kind is encoded anew as AAC.
COPIED_CODECS = ("aac", "mp3", "mp3float")
AAC_RATES = (8_000, 11_025, 12_000, 16_000, 22_050, 24_000, 32_000, 44_100, 48_000)

# Caption and the longest text of each number on the strip, in the order drawn.
_CELLS = {
    "frame": "000000",
    "time": "0000.000 s",
    "mouth": "not measured",
    "openings": "00",
    "width": "0000.0 px  0.00 mw",
    "height": "0000.0 px  0.00 mw",
}


@dataclass(frozen=True)
class Layout:
    """Where things stand in the overlay picture, in drawn px: the source enlarged by `scale`, a strip of text below."""

    scale: float
    picture_height: int
    picture_width: int
    picture_col: int
    height: int
    width: int
    text_px: int
    cells: dict[str, tuple[int, int]]  # caption -> (row, column) of its top left corner


def write_overlay(
    source: str | Path,
    profile: Profile,
    path: str | Path,
    *,
    fps: float | None = None,
    timestamps: str | Path | None = None,
    start_s: float | None = None,
    stop_s: float | None = None,
    every: int = 1,
) -> list[str]:
    """Write `source` with what `profile` measured drawn into it as an H.264 mp4 that plays in a browser.

    Frames keep their presentation times, variable frame rate included: exactly in the source's own time base, to the
    microsecond for pictures. Time zero of the overlay is `start_s`, else zero of the source's clock, else (where that
    is more than a second before the first frame, or after it) the first frame. The sound is copied where it is AAC
    or MP3 and encoded as AAC otherwise. Small pictures are enlarged by a whole factor.

    Parameters
    ----------
    source, fps, timestamps, start_s, stop_s, every
        As in `lipmetrics.frames.open_frames`; usually as the profile was measured. A frame that the profile does
        not hold is drawn as "not measured".
    profile
        With its outlines, as `lipmetrics.measure` returns it.
    path
        The mp4 to write; it appears whole or not at all.

    Returns
    -------
    Sentences on what could not be kept: sound that cannot be decoded.

    Raises
    ------
    InputError : `source` cannot be read or has no frame in the time asked for; `profile` has no outlines; `path`
        cannot be written
    """
    chosen = {"fps": fps, "timestamps": timestamps, "start_s": start_s, "stop_s": stop_s, "every": every}
    found = draw.found_by_frame(profile)
    remarks: list[str] = []
    with (
        whole_file(path) as part,
        open_frames(source, **chosen) as frames,
        _open_sound(source) if frames.info.has_audio else nullcontext() as sound,
        av.open(str(part), "w", format="mp4", options=_container_options(frames.info)) as target,
    ):
        pictures = iter(frames)
        first = next(pictures)
        zero_s = _time_zero(first.time_s) if start_s is None else start_s
        layout = plan_layout(first.height, first.width)
        video = _add_video(target, layout, frames.info, every)
        streams = [_video_packets(chain([first], pictures), found, layout, video, zero_s)]
        if sound is not None:
            span_s = (-math.inf if start_s is None else start_s, math.inf if stop_s is None else stop_s)
            streams.append(_audio_packets(sound.streams.audio[0], target, zero_s, span_s, remarks))
        for _, packet in heapq.merge(*streams, key=lambda item: item[0]):
            target.mux(packet)
    return remarks


def plan_layout(height: int, width: int) -> Layout:
    """Layout of the overlay for a source of `height` x `width` px; the drawn size is even, as H.264 asks."""
    most = min(math.sqrt(LARGE_AREA_PX / (height * width)), LARGE_SIDE_PX / max(height, width))
    scale = min(max(1, round(SMALL_PX / min(height, width))), math.floor(most)) if most >= 1 else most
    picture_height, picture_width = max(1, round(height * scale)), max(1, round(width * scale))

    text_px = max(11, round(min(picture_height, picture_width) / 46))
    gap, line = round(1.6 * text_px), round(4.2 * text_px)
    widths = {name: max(draw.text_size(t, text_px) for t in (name, longest)) for name, longest in _CELLS.items()}
    drawn_width = max(picture_width, max(widths.values()) + 2 * gap)
    cells, row, col = {}, picture_height, gap
    for name, cell_width in widths.items():
        if col > gap and col + cell_width + gap > drawn_width:
            row, col = row + line, gap
        cells[name] = (row, col)
        col += cell_width + gap
    drawn_height = row + line
    return Layout(
        scale=scale,
        picture_height=picture_height,
        picture_width=picture_width,
        picture_col=(drawn_width - picture_width) // 2,
        height=drawn_height + drawn_height % 2,
        width=drawn_width + drawn_width % 2,
        text_px=text_px,
        cells=cells,
    )


def draw_overlay(
    picture: np.ndarray, layout: Layout, found: draw.Found | None, index: int, time_s: float
) -> np.ndarray:
    """One overlay picture, (layout.height, layout.width, 3) uint8 RGB.

    `picture` is the source's (height, width, 3) uint8 RGB; `found` what the profile holds about this frame,
    or None.
    """
    drawn = np.full((layout.height, layout.width, 3), draw.STRIP_COLOUR, np.uint8)
    place = drawn[: layout.picture_height, layout.picture_col : layout.picture_col + layout.picture_width]
    size = (layout.picture_width, layout.picture_height)
    place[:] = cv2.resize(picture, size, interpolation=cv2.INTER_CUBIC if layout.scale > 1 else cv2.INTER_AREA)
    texts = {"frame": str(index), "time": f"{time_s:.3f} s", "mouth": "not measured"}
    if found is not None:
        view = draw.View(scale=layout.scale)
        for outline, identity in zip(found.outlines, found.identities, strict=True):
            draw.draw_outline(place, outline, draw.colour_of(identity), view)
        draw.draw_corners(place, found.corners, view)
        row = found.row
        texts |= {
            "mouth": row.status.replace("_", " "),
            "openings": draw.format_number(row.n_openings, 0),
            "width": _both_units(row.width_px, row.width_mw),
            "height": _both_units(row.height_px, row.height_mw),
        }
    for name, (row, col) in layout.cells.items():
        text_px = layout.text_px
        draw.draw_text(drawn, name, row + round(1.6 * text_px), col, round(0.8 * text_px), draw.QUIET_COLOUR)
        draw.draw_text(drawn, texts.get(name, "-"), row + round(3.3 * text_px), col, text_px)
    return drawn


def _both_units(px: float, mouth_widths: float) -> str:
    return f"{draw.format_number(px, 1, ' px')}  {draw.format_number(mouth_widths, 2, ' mw')}"


def _time_zero(first_s: float) -> float:
    """Time in the source at which the overlay starts: 0, but the first frame's time `first_s` where a player would
    show nothing for long (a broadcast's clock) or the container could not hold it (before 0)."""
    return 0.0 if 0 <= first_s <= LONGEST_WAIT_S else first_s


def _time_base(info: VideoInfo) -> Fraction:
    return Fraction(info.time_base) if info.time_base else MICROSECOND


def _container_options(info: VideoInfo) -> dict[str, str]:
    """Index first, so that a browser plays before it has all; the wait before the first frame, which mp4 keeps apart
    from the frames' times, as finely as these."""
    ticks = _time_base(info).denominator
    return {"movflags": "+faststart", "movie_timescale": str(ticks * math.ceil(90_000 / ticks))}


def _add_video(target, layout: Layout, info: VideoInfo, every: int):
    rate = info.nominal_fps / every if info.nominal_fps > 0 else 25.0
    video = target.add_stream("libx264", rate=max(Fraction(1, 1000), Fraction(rate).limit_denominator(1001)))
    video.width, video.height, video.pix_fmt = layout.width, layout.height, "yuv420p"
    # Without B-frames every packet is stored with its own time, so no player has to read an edit list to be in time.
    video.options = {"crf": "18", "preset": "veryfast", "bf": "0"}
    context = video.codec_context
    context.time_base = video.time_base = _time_base(info)
    context.sample_aspect_ratio = Fraction(info.pixel_aspect).limit_denominator(1000)
    # Say which colours these are (BT.709, limited range), or players guess by the picture's size.
    context.color_range, context.colorspace, context.color_primaries, context.color_trc = 1, 1, 1, 1
    return video


def _video_packets(
    frames: Iterable[Frame], found: dict[int, draw.Found], layout: Layout, video, zero_s: float
) -> Iterator[tuple[float, av.Packet]]:
    """Time in s and packet of every frame, drawn and encoded."""
    time_base = video.codec_context.time_base
    zero, last = round(zero_s / time_base), -1
    for frame in frames:
        drawn = draw_overlay(frame.rgb(), layout, found.get(frame.index), frame.index, frame.time_s)
        encoded = av.VideoFrame.from_ndarray(drawn, format="rgb24").reformat(format="yuv420p", dst_colorspace="ITU709")
        # times given in less than microseconds may round to the same one, which the encoder refuses
        last = max(round(frame.time_s / time_base) - zero, last + 1)
        encoded.pts, encoded.time_base = last, time_base
        for packet in video.encode(encoded):
            yield float(packet.pts * time_base), packet
    for packet in video.encode():
        yield float(packet.pts * time_base), packet


def _open_sound(source: str | Path):
    return av.open(f"file:{source}", options={"protocol_whitelist": "file"}, metadata_errors="replace")


def _audio_packets(
    stream, target, zero_s: float, span_s: tuple[float, float], remarks: list[str]
) -> Iterator[tuple[float, av.Packet]]:
    """Time in s and packet of the sound within `span_s`; a remark tells where it cannot be read on."""
    if stream.codec_context is None:
        remarks.append("the overlay has no sound: no decoder knows its kind")
        return
    send = _copied if stream.codec_context.name in COPIED_CODECS else _encoded
    reached_s = 0.0
    try:
        for packet in send(stream, target, round(zero_s / stream.time_base), span_s):
            reached_s = float(packet.pts * packet.time_base)
            yield reached_s, packet
    except (av.FFmpegError, ValueError) as error:
        remarks.append(f"the overlay's sound ends at {reached_s:.2f} s, it cannot be decoded beyond ({error})")


def _copied(stream, target, zero: int, span_s: tuple[float, float]) -> Iterator[av.Packet]:
    copy = target.add_stream_from_template(stream)
    last = -math.inf
    for packet in stream.container.demux(stream):
        # the last packet has no time; one that goes back in time comes from damage, and mp4 refuses it
        if packet.pts is None or packet.pts <= last or not span_s[0] <= packet.pts * packet.time_base < span_s[1]:
            continue
        last = packet.pts
        packet.pts = packet.dts = last - zero
        packet.stream = copy
        yield packet


def _encoded(stream, target, zero: int, span_s: tuple[float, float]) -> Iterator[av.Packet]:
    rate = stream.rate if stream.rate in AAC_RATES else 48_000
    aac = target.add_stream("aac", rate=rate, layout="mono" if stream.channels == 1 else "stereo")
    for packet in stream.container.demux(stream):
        try:
            frames = packet.decode()
        except av.error.InvalidDataError:  # a damaged piece of sound is a short silence
            continue
        for frame in frames:
            if frame.pts is not None and span_s[0] <= frame.time < span_s[1]:
                frame.pts -= zero
                yield from aac.encode(frame)
    yield from aac.encode()
