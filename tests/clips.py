"""Small clips and pictures that tests make for themselves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np


def smooth_picture(height: int, width: int, seed: int = 0) -> np.ndarray:
    """(height, width, 3) uint8 RGB of soft coloured patches, no two corners alike."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(30, 226, (5, 7, 3), dtype=np.uint8)
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)


def moving_pictures(count: int, height: int = 64, width: int = 96, seed: int = 0) -> list[np.ndarray]:
    """`count` pictures of (height, width, 3) uint8 RGB; every one differs from every other."""
    still = smooth_picture(height, 2 * width, seed)
    return [np.ascontiguousarray(np.roll(still, 2 * i, axis=1)[:, :width]) for i in range(count)]


def write_video(
    path: Path,
    pictures: Sequence[np.ndarray],
    *,
    codec: str = "libx264",
    pixel_format: str = "yuv420p",
    source_format: str = "rgb24",
    fps: int = 25,
    ticks: Sequence[int] | None = None,
    time_base: Fraction | None = None,
    rotation_deg: int = 0,
    hflip: bool = False,
    key_every: int = 10,
    options: dict[str, str] | None = None,
    container_options: dict[str, str] | None = None,
    sound: bool = False,
    tags: dict[str, int] | None = None,
) -> Path:
    """Encode pictures. `ticks` are presentation stamps in `time_base`; without them frame i is shown at i / fps.

    rotation_deg is the turn to the left a player shall apply, `tags` sets color_range and colorspace of the stream.
    """
    time_base = time_base or Fraction(1, fps)
    with av.open(str(path), "w", options=container_options or {}) as container:
        stream = container.add_stream(codec, rate=fps, options=options or {})
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = pixel_format
        stream.gop_size = key_every
        stream.codec_context.time_base = time_base
        for name, value in (tags or {}).items():
            setattr(stream.codec_context, name, value)
        if rotation_deg or hflip:
            stream.set_display_rotation(rotation_deg, hflip=hflip)
        audio = container.add_stream("aac", rate=16000, layout="mono") if sound else None
        for i, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format=source_format)
            frame.pts = i if ticks is None else ticks[i]
            frame.time_base = time_base
            for name, value in (tags or {}).items():
                setattr(frame, name, value)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
        if audio is not None:
            _write_tone(container, audio, len(pictures) / fps)
    return path


def copy_packets(source: Path, path: Path, change: Callable[[list[tuple[av.Packet, bytes]]], list]) -> Path:
    """Copy the video of `source` without decoding it; `change` takes and gives (packet, its bytes) in file order."""
    with av.open(str(source)) as container, av.open(str(path), "w") as target:
        stream = target.add_stream_from_template(container.streams.video[0])
        packets = [(packet, bytes(packet)) for packet in container.demux(video=0) if packet.size]
        for packet, data in change(packets):
            copy = av.Packet(data)
            copy.pts, copy.dts, copy.duration = packet.pts, packet.dts, packet.duration
            copy.time_base, copy.is_keyframe, copy.stream = packet.time_base, packet.is_keyframe, stream
            target.mux(copy)
    return path


def write_sound(path: Path, duration_s: float = 0.5) -> Path:
    """A file with sound and no picture."""
    with av.open(str(path), "w") as container:
        _write_tone(container, container.add_stream("aac", rate=16000, layout="mono"), duration_s)
    return path


def _write_tone(container: av.container.OutputContainer, stream: av.AudioStream, duration_s: float) -> None:
    samples = np.sin(np.arange(int(duration_s * 16000)) * 0.1).astype(np.float32)[None]
    for start in range(0, samples.shape[1], 1024):
        block = samples[:, start : start + 1024]
        frame = av.AudioFrame.from_ndarray(np.ascontiguousarray(block), format="fltp", layout="mono")
        frame.sample_rate, frame.pts, frame.time_base = 16000, start, Fraction(1, 16000)
        container.mux(stream.encode(frame))
    container.mux(stream.encode())


def write_pictures(folder: Path, pictures: Sequence[np.ndarray], name: str = "frame_{}.png") -> Path:
    """Write RGB pictures as name.format(0), name.format(1), ... and return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for i, picture in enumerate(pictures):
        assert cv2.imwrite(str(folder / name.format(i)), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    return folder
