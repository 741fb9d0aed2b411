"""How one mouth moves: size and time of its opening, speed of opening and closing, and rest in silence.

All of it is of the largest opening's curves in a take, at real times. Unknown frames (NaN) are left out and nothing is
computed across them. Lengths are in the unit of the take; the rows say `mw`, mouth widths, its default.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lipmetrics.errors import InputError
from lipmetrics.metrics.registry import NONE, Metric
from lipmetrics.take import Take

_STILL = 0.01  # of the peak velocity counts as none: rounding must not lengthen a stroke


@dataclass(frozen=True)
class Settings:
    """What the measures of movement depend on.

    window_s : a speed is the slope of the straight line of least squares through the frames at most half of this away,
        and at least through both neighbours. The default is three frames at 25 per second: slow enough to be steady at
        250 per second, fast enough not to flatten a closing lip, which lasts 100 ms
    onset_share : a mouth counts as opened above this share of its greatest height
    """

    window_s: float = 0.08
    onset_share: float = 0.1

    def __post_init__(self) -> None:
        if not (math.isfinite(self.window_s) and self.window_s > 0):
            raise InputError(f"expected a window above 0 s, got {self.window_s}")
        if not 0 < self.onset_share < 1:
            raise InputError(f"expected a share of the height between 0 and 1 for the onset, got {self.onset_share}")


def validate(take: Take, channel: str = "height") -> tuple[np.ndarray, np.ndarray]:
    """Times and values of the known frames of a channel.

    Returns
    -------
    time_s, values : (K,) float64

    Raises
    ------
    InputError : no take, no such channel, or no known frame
    """
    if not isinstance(take, Take):
        raise InputError(f"expected a take, got {type(take).__name__}; read one with lipmetrics.read_take(path)")
    if channel not in take.channels:
        raise InputError(f"{take.name}: expected the channel '{channel}', it has {', '.join(take.channels)}")
    known = np.isfinite(take.channels[channel])
    if not known.any():
        raise InputError(f"{take.name}: expected a known {channel} in some frame, it is unknown in all")
    return take.time_s[known], take.channels[channel][known]


def peak_height_v1(take: Take) -> float:
    """Greatest height of the largest opening, mw: max_t h(t)."""
    return float(validate(take)[1].max())


def peak_width_v1(take: Take) -> float:
    """Greatest width of the largest opening, mw: max_t w(t)."""
    return float(validate(take, "width")[1].max())


def peak_area_v1(take: Take) -> float:
    """Greatest area of the largest opening, mw^2: max_t a(t)."""
    return float(validate(take, "area")[1].max())


def onset_time_v1(take: Take, settings: Settings = Settings()) -> float:
    """When the mouth opens, s after the first frame: h first reaches a tenth of its greatest value, between frames.

    NaN where the mouth never opens or is as open in its first known frame. The share is a setting.
    """
    time_s, height = validate(take)
    return _rise(time_s, height, settings.onset_share * height.max()) - float(take.time_s[0])


def closing_time_v1(take: Take, settings: Settings = Settings()) -> float:
    """When the mouth has closed for the last time, s after the first frame: h falls below a tenth of its maximum.

    NaN where the mouth never opens or is still that open in its last known frame.
    """
    time_s, height = validate(take)
    return -_rise(-time_s[::-1], height[::-1], settings.onset_share * height.max()) - float(take.time_s[0])


def open_duration_v1(take: Take, settings: Settings = Settings()) -> float:
    """From onset to closing, s: `closing_time_v1` - `onset_time_v1`; pauses between belong to it."""
    return closing_time_v1(take, settings) - onset_time_v1(take, settings)


def time_to_peak_v1(take: Take, settings: Settings = Settings()) -> float:
    """From onset to the greatest height, s (its first frame where several are equal)."""
    time_s, height = validate(take)
    return float(time_s[height.argmax()]) - float(take.time_s[0]) - onset_time_v1(take, settings)


def open_share_v1(take: Take) -> float:
    """Share of the known time in which the mouth is open, 1; a frame lasts to half way to each of its neighbours."""
    height, lasts = take.channels["height"], frame_durations(take.time_s)
    validate(take)
    known = np.isfinite(height)
    return float(lasts[known & (height > 0)].sum() / lasts[known].sum())


def opening_speed_v1(take: Take, settings: Settings = Settings()) -> float:
    """Peak velocity of opening, mw/s: the greatest slope of h; NaN where fewer than 3 frames in a row are known.

    Source: peak velocity as in studies of lip kinematics, such as Max 1999; slope as in `Settings.window_s`.
    """
    return _peak(take, settings, 1)[0]


def closing_speed_v1(take: Take, settings: Settings = Settings()) -> float:
    """Peak velocity of closing, mw/s, as a positive number: the greatest slope of -h."""
    return _peak(take, settings, -1)[0]


def opening_stiffness_v1(take: Take, settings: Settings = Settings()) -> float:
    """Peak velocity of opening over the way of that stroke, 1/s: max h' / (h at its end - h at its start).

    The stroke lasts as long as the slope around the peak is above a hundredth of it. NaN where its way is under a tenth
    of the greatest height (`Settings.onset_share`), which is no opening.

    Source: Munhall, Ostry & Parush 1985: "ratio of maximum instantaneous velocity to movement amplitude, a kinematic
    index of mass-normalized stiffness".
    """
    return _stiffness(take, settings, 1)


def closing_stiffness_v1(take: Take, settings: Settings = Settings()) -> float:
    """Peak velocity of closing over the way of that stroke, 1/s, as `opening_stiffness_v1`."""
    return _stiffness(take, settings, -1)


def silence_mad_v1(take: Take, silence: Sequence[tuple[float, float]]) -> float:
    """How much the height of the opening varies in silence, mw: median over silent frames of |h - mean h|.

    THEval's "silent lip stability" about the mean, of the measured opening in mouth widths instead of landmarks in
    distances of the eyes; `landmarks.silent_lip_stability_theval_v1` is the original.

    Parameters
    ----------
    silence : (start, end) in s of the take's times, both included

    Returns
    -------
    float, NaN where fewer than 2 frames in silence are known

    Source: after Quignon et al. 2026 (THEval).
    """
    height = _silent_heights(take, silence)
    return float(np.median(np.abs(height - height.mean()))) if len(height) > 1 else math.nan


def silence_height_v1(take: Take, silence: Sequence[tuple[float, float]]) -> float:
    """Mean height of the opening in silence, mw; NaN where no silent frame is known."""
    height = _silent_heights(take, silence)
    return float(height.mean()) if len(height) else math.nan


def silence_travel_v1(take: Take, silence: Sequence[tuple[float, float]]) -> float:
    """Way that the height goes up and down in silence per second, mw/s: sum |h_i+1 - h_i| / sum (t_i+1 - t_i).

    Over neighbouring known frames that are both silent. Jitter of a measurement adds to it, most at high frame rates.
    """
    pieces = [piece for piece in _silent_pieces(take, silence) if len(piece[0]) > 1]
    lasts = sum(time_s[-1] - time_s[0] for time_s, _ in pieces)
    return float(sum(np.abs(np.diff(height)).sum() for _, height in pieces) / lasts) if lasts else math.nan


def evaluate(
    take: Take, *, silence: Sequence[tuple[float, float]] | None = None, settings: Settings = Settings()
) -> dict[str, float]:
    """All metrics of this module by name; those of silence are left out without `silence`.

    Raises
    ------
    InputError : as `validate`
    """
    scores = {}
    for row in ROWS:
        if row.needs == "take":
            scores[row.name] = row.function(take, settings) if row.name in _WITH_SETTINGS else row.function(take)
        elif silence is not None:
            scores[row.name] = row.function(take, silence)
    return scores


def frame_durations(time_s: np.ndarray) -> np.ndarray:
    """(T,) s that each frame lasts: from half way to half way to its neighbours; 1 for a single frame."""
    if len(time_s) == 1:
        return np.ones(1)
    edges = np.concatenate([time_s[:1], (time_s[1:] + time_s[:-1]) / 2, time_s[-1:]])
    return np.diff(edges)


def slopes(time_s: np.ndarray, values: np.ndarray, window_s: float) -> np.ndarray:
    """Slope per s at each frame of the straight line of least squares through the frames around it.

    Parameters
    ----------
    time_s, values : (T,) float, values NaN where unknown
    window_s : frames at most half of this away count, and both neighbours always

    Returns
    -------
    (T,) float64, NaN where the frame or a neighbour is unknown; unknown frames further away end the window
    """
    out = np.full(len(time_s), np.nan)
    for start, stop in _runs(np.isfinite(values)):
        t, v = time_s[start:stop], values[start:stop]
        here = np.arange(1, len(t) - 1)
        half = window_s / 2 * (1 + 1e-6)
        first = np.minimum(np.searchsorted(t, t[here] - half), here - 1)
        last = np.maximum(np.searchsorted(t, t[here] + half, side="right") - 1, here + 1)
        # symmetric in number, so that near the ends a bend is not taken for a slope
        reach = np.minimum(here - first, last - here)
        for n in np.unique(reach):
            at = here[reach == n]
            around = at[:, None] + np.arange(-n, n + 1)
            dt = t[around] - t[around].mean(axis=1, keepdims=True)
            dv = v[around] - v[around].mean(axis=1, keepdims=True)
            out[start + at] = (dt * dv).sum(axis=1) / (dt**2).sum(axis=1)
    return out


def _peak(take: Take, settings: Settings, sign: int) -> tuple[float, float]:
    """Greatest slope of sign * height, not below 0, and the way of the stroke it belongs to."""
    validate(take)
    height = sign * take.channels["height"]
    slope = slopes(take.time_s, height, settings.window_s)
    if not np.isfinite(slope).any():
        return math.nan, math.nan
    k = int(np.nanargmax(slope))
    if slope[k] <= 0:
        return 0.0, 0.0
    moving = slope > _STILL * slope[k]  # False at both ends of a run, whose slopes are NaN
    first = last = k
    while moving[first - 1]:
        first -= 1
    while moving[last + 1]:
        last += 1
    return float(slope[k]), float(height[last + 1] - height[first - 1])


def _stiffness(take: Take, settings: Settings, sign: int) -> float:
    speed, way = _peak(take, settings, sign)
    return speed / way if way > 0 and way >= settings.onset_share * peak_height_v1(take) else math.nan


def _rise(time_s: np.ndarray, values: np.ndarray, level: float) -> float:
    """When values first reach `level`, linearly between frames; NaN where they start there or `level` is 0."""
    k = int(np.argmax(values >= level))
    if level <= 0 or k == 0:
        return math.nan
    share = (level - values[k - 1]) / (values[k] - values[k - 1])
    return float(time_s[k - 1] + share * (time_s[k] - time_s[k - 1]))


def _silent_heights(take: Take, silence: Sequence[tuple[float, float]]) -> np.ndarray:
    return np.concatenate([np.empty(0), *(height for _, height in _silent_pieces(take, silence))])


def _silent_pieces(take: Take, silence: Sequence[tuple[float, float]]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Times and heights of each stretch of neighbouring frames that are known and silent."""
    validate(take)
    spans = np.asarray(silence, float)
    if spans.ndim != 2 or spans.shape[1] != 2 or not (spans[:, 0] < spans[:, 1]).all():
        raise InputError(f"expected silence as (start, end) pairs in s, start before end, got {silence!r}")
    time_s, height = take.time_s, take.channels["height"]
    silent = ((time_s[:, None] >= spans[:, 0]) & (time_s[:, None] <= spans[:, 1])).any(axis=1)
    return [(time_s[a:b], height[a:b]) for a, b in _runs(silent & np.isfinite(height))]


def _runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """Start and stop (one beyond) of each stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


ROWS = (
    Metric(
        *("peak_height_v1", "movement", "mw", NONE, "take", peak_height_v1, "max_t h(t)", "this package"),
    ),
    Metric(*("peak_width_v1", "movement", "mw", NONE, "take", peak_width_v1, "max_t w(t)", "this package")),
    Metric(*("peak_area_v1", "movement", "mw^2", NONE, "take", peak_area_v1, "max_t a(t)", "this package")),
    Metric(
        *("onset_time_v1", "movement", "s", NONE, "take", onset_time_v1),
        *("first t with h(t) >= 0.1 max h, minus t_0", "this package"),
    ),
    Metric(
        *("closing_time_v1", "movement", "s", NONE, "take", closing_time_v1),
        *("last t with h(t) >= 0.1 max h, minus t_0", "this package"),
    ),
    Metric(
        *("open_duration_v1", "movement", "s", NONE, "take", open_duration_v1),
        *("closing_time_v1 - onset_time_v1", "this package"),
    ),
    Metric(
        *("time_to_peak_v1", "movement", "s", NONE, "take", time_to_peak_v1),
        *("first t with h(t) = max h, minus t_0 and onset_time_v1", "this package"),
    ),
    Metric(
        *("open_share_v1", "movement", "1", NONE, "take", open_share_v1),
        *("time with h > 0 / time with h known", "this package"),
    ),
    Metric(
        *("opening_speed_v1", "movement", "mw/s", NONE, "take", opening_speed_v1),
        *("max_t h'(t)", "peak velocity; Max 1999"),
    ),
    Metric(
        *("closing_speed_v1", "movement", "mw/s", NONE, "take", closing_speed_v1),
        *("max_t -h'(t)", "peak velocity; Max 1999"),
    ),
    Metric(
        *("opening_stiffness_v1", "movement", "1/s", NONE, "take", opening_stiffness_v1),
        *("opening_speed_v1 / (h at the end - h at the start of that stroke)", "Munhall, Ostry & Parush 1985"),
    ),
    Metric(
        *("closing_stiffness_v1", "movement", "1/s", NONE, "take", closing_stiffness_v1),
        *("closing_speed_v1 / (h at the start - h at the end of that stroke)", "Munhall, Ostry & Parush 1985"),
    ),
    Metric(
        *("silence_mad_v1", "movement", "mw", NONE, "take with silence", silence_mad_v1),
        *("median over silent t of |h - mean h|", "after Quignon et al. 2026, THEval"),
    ),
    Metric(
        *("silence_height_v1", "movement", "mw", NONE, "take with silence", silence_height_v1),
        *("mean over silent t of h", "this package"),
    ),
    Metric(
        *("silence_travel_v1", "movement", "mw/s", NONE, "take with silence", silence_travel_v1),
        *("sum |h_i+1 - h_i| / sum (t_i+1 - t_i), both frames silent", "this package"),
    ),
)
_WITH_SETTINGS = {row.name for row in ROWS if row.function.__defaults__}
