"""What happens in a long take over time: how much the mouth moves, and how loud it is; and when something does.

Movement is the mean difference of the twentieth of the blocks that change most, between small pictures at most 30 times
a second: of the mouth's part of the face in the first pictures, or of the whole picture where no face is seen.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import av
import numpy as np

from lipmetrics.errors import InputError
from lipmetrics.find import faces
from lipmetrics.frames import Frame, open_frames

MOST_PER_S = 30.0
BLOCKS_ROWS = 36
MOUTH_IN_FACE = (0.62, 1.08, 0.18, 0.82)  # top, bottom, left, right: shares of a face's box
FACE_LOOKS, FACE_EVERY = 5, 10
WINDOW_S = 0.02  # of loudness
SMOOTH_S = 0.1
LEAST_MOVEMENT = 0.7  # grey levels above rest
LEAST_LOUDNESS_DB, QUIET_DB = 12.0, -55.0  # above the median, and below full scale
GAP_S, SHORTEST_S = 0.5, 0.08


@dataclass(frozen=True)
class Activity:
    """What happens in a take; times in s from its first picture.

    movement : (N,) grey levels at time_s
    loudness_db : (M,) below full scale at sound_time_s; empty without sound
    region : (row0, row1, col0, col1) px that was looked at; is_mouth : whether that is where a mouth is
    """

    time_s: np.ndarray
    movement: np.ndarray
    sound_time_s: np.ndarray
    loudness_db: np.ndarray
    region: tuple[int, int, int, int]
    is_mouth: bool


@dataclass(frozen=True)
class Event:
    """Something from start_s to stop_s: movement (grey levels) and loudness (dB above the median) at their highest."""

    start_s: float
    stop_s: float
    movement: float
    louder_db: float


def read_activity(path: str | Path, progress=None) -> Activity:
    """Watch and listen to a take once, in memory that grows by a few numbers per picture alone.

    progress : called with the time reached, s

    Raises
    ------
    InputError : the take cannot be read
    """
    with open_frames(path) as frames:
        region, is_mouth = _region(islice(frames, FACE_LOOKS * FACE_EVERY))
    side = max(1, (region[1] - region[0]) // BLOCKS_ROWS)
    times, movement = array("d"), array("d")
    before, first_s = None, None
    with open_frames(path) as frames:
        for frame in frames:
            first_s = frame.time_s if first_s is None else first_s
            time_s = frame.time_s - first_s
            if times and time_s - times[-1] < 1 / MOST_PER_S - 0.002:
                continue
            now = frame.averaged(region, (side, side)).astype(np.float32).mean(axis=2)
            times.append(time_s)
            movement.append(0.0 if before is None else _change(now - before))
            before = now
            if progress is not None:
                progress(time_s)
        has_audio = frames.info.has_audio
    if len(times) < 3:
        raise InputError(f"expected a take of some seconds, got {len(times)} pictures in {path}")
    movement[0] = movement[1]
    sound = _loudness(Path(path), first_s) if has_audio else (np.empty(0), np.empty(0))
    return Activity(np.asarray(times), np.asarray(movement), *sound, region, is_mouth)


def find_events(activity: Activity) -> list[Event]:
    """Where the mouth moves, or it is loud, in order of time; what is less than half a second apart is one.

    Rest is what happens most of the time: the median. Something begins where movement first leaves rest by three
    deviations, and counts where it later leaves it by eight, and by a seventh of the take's strong movements.
    """
    step_s = float(np.median(np.diff(activity.time_s)))
    moved = _smooth(_without_flashes(activity.movement), SMOOTH_S / step_s)
    rest, deviation = _rest(moved)
    strong = float(np.quantile(moved, 0.98)) - rest
    high = rest + max(8 * deviation, 0.15 * strong, LEAST_MOVEMENT)
    low = rest + max(3 * deviation, 0.04 * strong, LEAST_MOVEMENT / 3)
    spans = [(a, b, True) for a, b in _spans(activity.time_s, moved, low, high)]
    heard, quiet_db = activity.loudness_db, 0.0
    if len(heard):
        quiet_db = float(np.median(heard))
        high_db = max(quiet_db + LEAST_LOUDNESS_DB, QUIET_DB)
        heard = _smooth(heard, SMOOTH_S / WINDOW_S)
        found = _spans(activity.sound_time_s, heard, high_db - LEAST_LOUDNESS_DB / 2, high_db)
        spans += [(a, b, False) for a, b in found]
    joined: list[list[float]] = []
    for start_s, stop_s, _ in sorted(spans):
        if joined and start_s - joined[-1][1] < GAP_S:
            joined[-1][1] = max(joined[-1][1], stop_s)
        else:
            joined.append([start_s, stop_s])
    events = []
    for start_s, stop_s in joined:
        if stop_s - start_s < SHORTEST_S:
            continue
        moves = [(a, b) for a, b, is_movement in spans if is_movement and a < stop_s and b > start_s]
        most = max((_highest(activity.time_s, moved, a, b) - rest for a, b in moves), default=0.0)
        louder = _highest(activity.sound_time_s, heard, start_s, stop_s) - quiet_db if len(heard) else 0.0
        events.append(Event(start_s, stop_s, most, louder))
    return events


def _region(frames: Iterator[Frame]) -> tuple[tuple[int, int, int, int], bool]:
    """Around the mouth of the largest face of the first pictures, or the whole picture."""
    found, size = [], (0, 0)
    for k, frame in enumerate(frames):
        size = (frame.height, frame.width)
        if k % FACE_EVERY == 0:
            found += faces(frame)[:1]
    if not found:
        return (0, size[0], 0, size[1]), False
    left, top, width, height = np.median(np.array(found), axis=0)
    share = MOUTH_IN_FACE
    rows = np.clip(np.round(top + height * np.array(share[:2])), 0, size[0]).astype(int)
    cols = np.clip(np.round(left + width * np.array(share[2:])), 0, size[1]).astype(int)
    if rows[1] - rows[0] < 8 or cols[1] - cols[0] < 8:
        return (0, size[0], 0, size[1]), False
    return (int(rows[0]), int(rows[1]), int(cols[0]), int(cols[1])), True


def _change(difference: np.ndarray) -> float:
    values = np.abs(difference - np.median(difference)).ravel()  # lamps that flicker change all blocks alike
    top_n = max(1, len(values) // 20)
    return float(np.partition(values, -top_n)[-top_n:].mean())


def _loudness(path: Path, first_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Times of windows of 20 ms, from the first picture, and their root mean square in dB below full scale."""
    sums, counts = array("d"), array("q")
    with av.open(f"file:{path}", options={"protocol_whitelist": "file"}, metadata_errors="replace") as container:
        stream = container.streams.audio[0]
        if stream.codec_context is None:
            return np.empty(0), np.empty(0)
        resampler = av.AudioResampler(format="flt", layout="mono", rate=16_000)
        window_n = round(16_000 * WINDOW_S)
        try:
            for packet in container.demux(stream):
                try:
                    given = packet.decode()
                except av.error.FFmpegError:
                    continue
                for one in given:
                    if one.pts is None:
                        continue
                    for frame in resampler.resample(one):
                        at = round((float(frame.pts * frame.time_base) - first_s) * 16_000)
                        _add_power(sums, counts, at, frame.to_ndarray().ravel(), window_n)
        except av.error.FFmpegError:
            pass
    counted = np.maximum(np.asarray(counts, float), 1)
    loudness_db = 10 * np.log10(np.asarray(sums, float) / counted + 1e-9)
    return (np.arange(len(sums)) + 0.5) * WINDOW_S, loudness_db


def _add_power(sums: array, counts: array, at: int, samples: np.ndarray, window_n: int) -> None:
    if at < 0:
        samples, at = samples[-at:], 0
    if not len(samples):
        return
    place = (at + np.arange(len(samples))) // window_n
    first = int(place[0])
    for k, (power, n) in enumerate(
        zip(np.bincount(place - first, samples.astype(float) ** 2), np.bincount(place - first), strict=True), first
    ):
        if k > 10_000_000:  # a stamp from nowhere
            return
        while len(sums) <= k:
            sums.append(0.0)
            counts.append(0)
        sums[k] += power
        counts[k] += int(n)


def _without_flashes(values: np.ndarray) -> np.ndarray:
    """Medians of five: a single picture that differs, such as a key picture of another quality, is no movement."""
    padded = np.pad(values, 2, mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)


def _smooth(values: np.ndarray, width: float) -> np.ndarray:
    n = max(1, round(width))
    padded = np.pad(values, (n // 2, n - 1 - n // 2), mode="edge")
    return np.convolve(padded, np.full(n, 1 / n), mode="valid")


def _rest(values: np.ndarray) -> tuple[float, float]:
    """The median, and the deviation of what lies below it: movement lies above."""
    middle = float(np.median(values))
    below = values[values <= middle]
    return middle, 1.4826 * float(np.median(middle - below))


def _spans(time_s: np.ndarray, values: np.ndarray, low: float, high: float) -> list[tuple[float, float]]:
    """Stretches above `low` that reach `high`."""
    above = np.concatenate([[False], values > low, [False]])
    edges = np.flatnonzero(above[1:] != above[:-1]).reshape(-1, 2)
    return [(float(time_s[a]), float(time_s[b - 1])) for a, b in edges if values[a:b].max() >= high]


def _highest(time_s: np.ndarray, values: np.ndarray, start_s: float, stop_s: float) -> float:
    inside = values[(time_s >= start_s - 1e-9) & (time_s <= stop_s + 1e-9)]
    return float(inside.max()) if len(inside) else float(np.interp((start_s + stop_s) / 2, time_s, values))
