"""What a clip is, found out quickly: times and sizes from its packets, light and framing from three pictures at most.

Pictures are taken at key frames, which are read without those before them. Only a short clip with a single key frame
is decoded up to its middle.

A head turned to the side is told from a frontal face that is not seen and a profile that is (cascades of
OpenCV), which happens from about 40 degrees on. Smaller angles are not seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import av
import cv2
import numpy as np

from corpus_tools.clips import Clip
from lipmetrics.errors import InputError
from lipmetrics.find import FACE_SIDE, faces
from lipmetrics.frames import _is_cut_off as is_cut_off
from lipmetrics.frames import open_frames, open_video
from lipmetrics.look import NO_MOUTH
from lipmetrics.still import look_at

WANTED = (0.05, 0.5, 0.95)  # shares of a clip at which pictures are looked at
SHORT_S = 10.0
AROUND = (0.6, 0.75)  # rows and columns on each side of the mouth's middle in which light is measured, mouth widths
DARKEST, BRIGHTEST = 5, 250  # grey levels that count as clipped


@dataclass(frozen=True)
class Facts:
    """Of a clip; NaN where unknown.

    Parameters
    ----------
    width_px, height_px : of the picture as displayed
    frames_n : pictures in the clip
    length_s : from the first picture to the end of the last, s
    fps : pictures per second, by the median step
    longest_step : from one picture to the next, in median steps: 2 where one is left out
    has_sound : whether there is sound
    damage : what is damaged or cut off; empty if nothing is seen to be
    looked_n, mouths_n, sides_n : pictures looked at, those with a mouth, and those with a face seen from the side only
    brightness : mean grey level around the mouth, or of the picture without a mouth, 0 to 255
    clipped : share of the pixels there that are as dark or as bright as can be, in the worst picture
    mouth_width_px : between the corners, median
    tilt_deg : angle of the line through the corners, the largest, clockwise above 0
    off_middle : of the mouth from the middle of the face seen, in widths of the face, the largest; above 0 to the right
    margin_mw : least distance of the lips from the edge of the picture, mouth widths; lips are taken to be 0.2 high
        on each side of the middle
    """

    width_px: int
    height_px: int
    frames_n: int
    length_s: float
    fps: float
    longest_step: float
    has_sound: bool
    damage: str
    looked_n: int
    mouths_n: int
    sides_n: int
    brightness: float
    clipped: float
    mouth_width_px: float
    tilt_deg: float
    off_middle: float
    margin_mw: float


COLUMNS = tuple(field.name for field in fields(Facts))


def clip_facts(clip: Clip) -> Facts:
    """Look at a clip.

    Raises
    ------
    InputError : it cannot be read, or has no picture in the part asked for
    """
    with open_frames(clip.path, fps=clip.fps, start_s=clip.start_s, stop_s=clip.stop_s) as frames:
        info = frames.info
        if info.kind == "images":
            times_s, keys_s, damage = _all_times(frames), None, ""
        else:
            times_s, keys_s, damage = _packet_times(clip)
            if times_s is None:  # not all have stamps: the reader knows what to do then, and has to decode
                times_s = _all_times(frames)
    inside = (times_s >= (clip.start_s or -math.inf)) & (times_s < (clip.stop_s or math.inf))
    times_s = times_s[inside]
    if not len(times_s):
        raise InputError(f"expected a picture between the start and the stop of {clip.name}, got none")
    steps_s = np.diff(times_s)
    step_s = float(np.median(steps_s)) if len(steps_s) else math.nan
    seen = [_seen(_picture_at(clip, time_s)) for time_s in _looked_at(times_s, keys_s)]
    return Facts(
        width_px=info.width,
        height_px=info.height,
        frames_n=len(times_s),
        length_s=float(times_s[-1] - times_s[0]) + (0.0 if math.isnan(step_s) else step_s),
        fps=1 / step_s if step_s > 0 else math.nan,
        longest_step=float(steps_s.max() / step_s) if step_s > 0 else math.nan,
        has_sound=info.has_audio,
        damage=damage,
        looked_n=len(seen),
        mouths_n=sum(one.has_mouth for one in seen),
        sides_n=sum(one.from_side for one in seen),
        brightness=float(np.mean([one.brightness for one in seen])),
        clipped=max(one.clipped for one in seen),
        mouth_width_px=_middle([one.mouth_width_px for one in seen]),
        tilt_deg=_farthest([one.tilt_deg for one in seen]),
        off_middle=_farthest([one.off_middle for one in seen]),
        margin_mw=min((one.margin_mw for one in seen if one.has_mouth), default=math.nan),
    )


def _packet_times(clip: Clip) -> tuple[np.ndarray | None, np.ndarray | None, str]:
    """Times of all pictures and of key frames in order, s, without decoding; None where some have no stamp."""
    times, keys, damage, packets_n, end_s = [], [], "", 0, 0.0
    with open_video(clip.path) as (container, stream):
        is_avi = container.format.name == "avi"
        try:
            for packet in container.demux(stream):
                if not packet.size:
                    continue
                packets_n += 1
                stamp = packet.dts if is_avi else packet.pts
                if packet.is_corrupt:
                    damage = "a part is damaged"
                if packet.is_discard:
                    continue
                times.append(stamp)
                if stamp is not None:
                    end_s = max(end_s, float((stamp + (packet.duration or 0)) * stream.time_base))
                    if packet.is_keyframe:
                        keys.append(stamp)
        except av.error.FFmpegError as error:
            damage = f"a part cannot be read ({error.strerror})"
        if is_cut_off(container, stream, packets_n, end_s):
            damage = f"cut off after {end_s:.2f} s"
        unit = stream.time_base
    if not times or None in times:
        return None, None, damage
    return (*(np.array([float(stamp * unit) for stamp in sorted(set(some))]) for some in (times, keys)), damage)


def _all_times(frames) -> np.ndarray:
    return np.array([frame.time_s for frame in frames])


def _looked_at(times_s: np.ndarray, keys_s: np.ndarray | None) -> list[float]:
    """Times of the pictures to look at, which are all times of pictures."""
    first_s, last_s = times_s[0], times_s[-1]
    wanted_s = [first_s + share * (last_s - first_s) for share in WANTED]
    middle_s = float(times_s[len(times_s) // 2])
    if keys_s is None:  # pictures of a folder can all be read alone
        return sorted({float(times_s[np.argmin(np.abs(times_s - t))]) for t in wanted_s})
    keys_s = keys_s[(keys_s >= first_s) & (keys_s <= last_s)]
    chosen = {float(keys_s[np.argmin(np.abs(keys_s - t))]) for t in wanted_s} if len(keys_s) else {float(first_s)}
    if len(chosen) == 1 and last_s - first_s <= SHORT_S:
        chosen.add(middle_s)
    return sorted(chosen)


def _picture_at(clip: Clip, time_s: float) -> np.ndarray:
    """(H, W, 3) uint8 RGB of the picture at this time, or the next that is not damaged."""
    start_s = max(time_s - 1e-6, 0.0) if time_s > 0 else None
    with open_frames(clip.path, fps=clip.fps, start_s=start_s) as frames:
        return next(iter(frames)).rgb()


@dataclass(frozen=True)
class _Seen:
    has_mouth: bool
    from_side: bool
    brightness: float
    clipped: float
    mouth_width_px: float = math.nan
    tilt_deg: float = math.nan
    off_middle: float = math.nan
    margin_mw: float = math.nan


def _seen(picture: np.ndarray) -> _Seen:
    """Light and framing in one (H, W, 3) uint8 RGB picture."""
    height, width = picture.shape[:2]
    look, found = look_at(picture), faces(_Whole(picture))
    from_side = not found and _has_profile(picture)
    if look.status == NO_MOUTH or not np.isfinite(look.corners).all():
        return _Seen(False, from_side, *_light(picture))
    (row0, col0), (row1, col1) = look.corners.tolist()
    across = look.lip_width_px
    row, col = (row0 + row1) / 2, (col0 + col1) / 2
    top, left = max(0, int(row - AROUND[0] * across)), max(0, int(col - AROUND[1] * across))
    around = picture[top : int(row + AROUND[0] * across) + 1, left : int(col + AROUND[1] * across) + 1]
    margin_px = min(col0, width - 1 - col1, row - 0.2 * across, height - 1 - row - 0.2 * across)
    return _Seen(
        True,
        from_side,
        *_light(around if around.size else picture),
        mouth_width_px=across,
        tilt_deg=math.degrees(math.atan2(row1 - row0, col1 - col0)),
        off_middle=_off_middle(found, row, col),
        margin_mw=margin_px / across,
    )


def _light(picture: np.ndarray) -> tuple[float, float]:
    """Mean grey level, and the share of pixels that are clipped: black, or white in all channels that they have."""
    grey = picture.astype(np.float32) @ np.array([0.299, 0.587, 0.114], np.float32)
    clipped = (grey <= DARKEST) | (picture.max(axis=2) >= BRIGHTEST) & (grey >= 0.8 * BRIGHTEST)
    return float(grey.mean()), float(clipped.mean())


class _Whole:
    """A picture with the face of a frame, as the search for faces wants it."""

    def __init__(self, picture: np.ndarray):
        self._picture = picture
        self.height, self.width = picture.shape[:2]

    def rgb(self) -> np.ndarray:
        return self._picture


def _has_profile(picture: np.ndarray) -> bool:
    """Whether a face is seen from its left or its right."""
    shrink = max(1.0, max(picture.shape[:2]) / FACE_SIDE)
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    grey = cv2.equalizeHist(cv2.resize(grey, None, fx=1 / shrink, fy=1 / shrink, interpolation=cv2.INTER_AREA))
    cascade = cv2.CascadeClassifier(cv2.data.haarcascades + "haarcascade_profileface.xml")
    ways = (grey, np.ascontiguousarray(grey[:, ::-1]))  # the cascade knows one side only
    return any(len(cascade.detectMultiScale(way, scaleFactor=1.1, minNeighbors=5, minSize=(60, 60))) for way in ways)


def _off_middle(found: list, row: float, col: float) -> float:
    """How far the mouth is from the middle of the face that it is in, face widths; NaN where no face is seen."""
    for left, top, width, height in found:
        if left < col < left + width and top + 0.5 * height < row < top + 1.1 * height:
            return (col - left) / width - 0.5
    return math.nan


def _middle(values: list[float]) -> float:
    known = [value for value in values if not math.isnan(value)]
    return float(np.median(known)) if known else math.nan


def _farthest(values: list[float]) -> float:
    return max((value for value in values if not math.isnan(value)), key=abs, default=math.nan)
