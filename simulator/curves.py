"""How a load changes over time: the load shapes of NiftySim and key-framed activation curves.

A curve has two methods, `value(t_s)` and `rate(t_s)` (its time derivative, 1/s), both vectorised over time, and is
a plain frozen value: two curves of the same numbers are equal. Rates are derivatives from the right where a curve has
a corner. Any object with these two methods serves as the shape of a load.

Sources: NiftySim 2.5 for the named shapes; M. I. Leach, thesis (Sheffield, 2020), section 3.3.5, figure 3.12 and
listing 3.1 for the key frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulator.atomic import whole_file
from simulator.errors import InputError
from simulator.wording import choices, nearest

LOAD_SHAPES = ("POLY345", "RAMP", "STEP", "HILLY", "RAMPHOLD")
SEGMENTS = ("linear", "geometric", "quarter_sin", "smooth")

_HILLY_OMEGA = 4 * 3.14159  # NiftySim's own digits of pi: its results depend on them


@dataclass(frozen=True)
class LoadShape:
    """One of NiftySim's load shapes, a function of the relative time r = t / duration.

    | name     | value                  |
    |----------|------------------------|
    | POLY345  | 10 r^3 - 15 r^4 + 6 r^5 |
    | RAMP     | r                      |
    | STEP     | 1                      |
    | HILLY    | r exp(cos(4 pi r) - 1) |
    | RAMPHOLD | min(10 r, 1)           |

    Up to and at t = 0 every shape is 0, so that a STEP acts from the first step after the start: NiftySim, too, applies
    no force in its first step. After the duration the formulas run on, as they do in NiftySim, whose last step ends one
    step after the total time.

    Parameters
    ----------
    name : one of `LOAD_SHAPES`
    duration_s : time at which r = 1, s

    Raises
    ------
    InputError : unknown name, or a duration that is not above 0
    """

    name: str
    duration_s: float

    def __post_init__(self):
        if self.name not in LOAD_SHAPES:
            raise InputError(f"expected a load shape of {choices(LOAD_SHAPES)}, got {nearest(self.name, LOAD_SHAPES)}")
        if not (self.duration_s > 0 and math.isfinite(self.duration_s)):
            raise InputError(f"expected the duration of a load shape to be above 0 s, got {self.duration_s}")

    def value(self, t_s):
        """Value at the times `t_s`, s, shape (...); same shape, a float for a scalar."""
        r = np.asarray(t_s, dtype=float) / self.duration_s
        match self.name:
            case "POLY345":
                value = r**3 * (10 - 15 * r + 6 * r**2)
            case "RAMP":
                value = r
            case "STEP":
                value = np.ones_like(r)
            case "HILLY":
                value = r * np.exp(np.cos(_HILLY_OMEGA * r) - 1)
            case "RAMPHOLD":
                value = np.minimum(10 * r, 1)
        return np.where(np.isnan(r), r, np.where(r <= 0, 0.0, value))[()]

    def rate(self, t_s):
        """Time derivative at the times `t_s`, s, shape (...), in 1/s; from the right at corners."""
        r = np.asarray(t_s, dtype=float) / self.duration_s
        match self.name:
            case "POLY345":
                slope = 30 * r**2 * (1 - r) ** 2
            case "RAMP":
                slope = np.ones_like(r)
            case "STEP":
                slope = np.zeros_like(r)
            case "HILLY":
                slope = np.exp(np.cos(_HILLY_OMEGA * r) - 1) * (1 - r * _HILLY_OMEGA * np.sin(_HILLY_OMEGA * r))
            case "RAMPHOLD":
                slope = np.where(r < 0.1, 10.0, 0.0)
        return np.where(np.isnan(r), r, np.where(r < 0, 0.0, slope / self.duration_s))[()]


@dataclass(frozen=True)
class KeyFrames:
    """A curve through key frames, held at its first value before the first and at its last value after the last.

    With s = (t - t0) / (t1 - t0) a segment between (t0, v0) and (t1, v1) is

    | segment     | value                       |
    |-------------|-----------------------------|
    | linear      | v0 + (v1 - v0) s            |
    | geometric   | v0 (v1 / v0)^s              |
    | quarter_sin | v0 + (v1 - v0) sin(pi/2 s)  |
    | smooth      | v0 + (v1 - v0) (10 s^3 - 15 s^4 + 6 s^5) |

    The smooth segment, which starts and ends at rest, is the movement of least jerk (Flash and Hogan 1985), as jaws
    make it; the others are the thesis's.

    Parameters
    ----------
    times_s : times of the N >= 1 key frames, s, increasing
    values : values at these times, N
    segments : how each key frame is left for the next, N - 1 of `SEGMENTS`

    Raises
    ------
    InputError : counts that do not fit, times out of order, NaN, unknown segment, geometric segment touching 0
    """

    times_s: tuple[float, ...]
    values: tuple[float, ...]
    segments: tuple[str, ...]

    def __post_init__(self):
        for name in ("times_s", "values"):
            object.__setattr__(self, name, tuple(float(number) for number in getattr(self, name)))
        object.__setattr__(self, "segments", tuple(self.segments))
        keys = len(self.times_s)
        if keys == 0 or len(self.values) != keys or len(self.segments) != keys - 1:
            raise InputError(
                "expected key frames with one value per time and one segment between each two, got "
                f"{keys} times, {len(self.values)} values and {len(self.segments)} segments"
            )
        for i in range(keys):
            if not (math.isfinite(self.times_s[i]) and math.isfinite(self.values[i])):
                raise InputError(
                    f"expected finite times and values, got key frame {i + 1} at {self.times_s[i]} s "
                    f"with value {self.values[i]}"
                )
        for i in range(keys - 1):
            _check_segment(self.segments[i], self.times_s[i : i + 2], self.values[i : i + 2])

    def value(self, t_s):
        """Value at the times `t_s`, s, shape (...); same shape, a float for a scalar."""
        t = np.asarray(t_s, dtype=float)
        value = np.where(np.isnan(t), t, np.where(t < self.times_s[0], self.values[0], self.values[-1]))
        for i, segment in enumerate(self.segments):
            t0, t1 = self.times_s[i : i + 2]
            v0, v1 = self.values[i : i + 2]
            inside = (t >= t0) & (t < t1)
            s = (t[inside] - t0) / (t1 - t0)
            match segment:
                case "linear":
                    value[inside] = v0 + (v1 - v0) * s
                case "geometric":
                    value[inside] = v0 * np.exp(s * _log_ratio(v0, v1))
                case "quarter_sin":
                    value[inside] = v0 + (v1 - v0) * np.sin(np.pi / 2 * s)
                case "smooth":
                    value[inside] = v0 + (v1 - v0) * s**3 * (10 - 15 * s + 6 * s**2)
        return value[()]

    def rate(self, t_s):
        """Time derivative at the times `t_s`, s, shape (...), in 1/s; from the right at key frames."""
        t = np.asarray(t_s, dtype=float)
        rate = np.where(np.isnan(t), t, 0.0)
        for i, segment in enumerate(self.segments):
            t0, t1 = self.times_s[i : i + 2]
            v0, v1 = self.values[i : i + 2]
            inside = (t >= t0) & (t < t1)
            s = (t[inside] - t0) / (t1 - t0)
            match segment:
                case "linear":
                    rate[inside] = (v1 - v0) / (t1 - t0)
                case "geometric":
                    rate[inside] = v0 * np.exp(s * _log_ratio(v0, v1)) * _log_ratio(v0, v1) / (t1 - t0)
                case "quarter_sin":
                    rate[inside] = (v1 - v0) / (t1 - t0) * np.pi / 2 * np.cos(np.pi / 2 * s)
                case "smooth":
                    rate[inside] = (v1 - v0) / (t1 - t0) * 30 * s**2 * (1 - s) ** 2
        return rate[()]

    def quiet_until(self, t_s: float) -> float:
        """Time up to which the value stays what it is at `t_s`, s; `t_s` itself while it changes, inf after the end."""
        until = t_s
        for i, time in enumerate(self.times_s):
            if time <= until:
                continue
            if i > 0 and self.values[i] != self.values[i - 1]:
                return until
            until = time
        return math.inf


def quiet_until(curve: object, t_s: float) -> float:
    """`curve.quiet_until(t_s)`, or `t_s` where the curve has no such method and may change at any time."""
    method = getattr(curve, "quiet_until", None)
    return t_s if method is None else method(t_s)


def read_key_frames(path: str | Path) -> KeyFrames:
    """Read an activation file: a line `time value` per key frame, a line with the kind of segment between each two.

        0.0 0.0
        linear
        0.1 0.2
        geometric
        0.5 0.6
        quarter_sin
        1.0 1.0

    This is listing 3.1 of the thesis, which may also be given with its line numbers as printed. Empty lines and what
    follows a `#` are skipped. Times in s.

    Raises
    ------
    InputError : no such file, or a line that does not fit; the message names file and line
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text"
        raise InputError(f"expected an activation file, got {path}: {reason}") from None
    lines = [(number, line.split("#")[0].split()) for number, line in enumerate(text.splitlines(), start=1)]
    lines = [(number, words) for number, words in lines if words]
    if not lines:
        raise InputError(f"expected key frames in the activation file {path}, got none; write lines such as '0.0 0.0'")
    if len(lines[0][1]) == 3 and all(words[0] == str(i) for i, (_, words) in enumerate(lines, start=1)):
        lines = [(number, words[1:]) for number, words in lines]
    times, values, segments = [], [], []
    for i, (number, words) in enumerate(lines):
        if i % 2 == 0:
            time, value = _key_frame(words, f"{path}, line {number}")
            times.append(time)
            values.append(value)
        elif len(words) == 1 and words[0] in SEGMENTS:
            segments.append(words[0])
        else:
            raise InputError(
                f"{path}, line {number}: expected a segment of {choices(SEGMENTS)} between two key frames, "
                f"got {nearest(' '.join(words), SEGMENTS)}"
            )
        if len(times) >= 2 and i % 2 == 0:
            try:
                _check_segment(segments[-1], times[-2:], values[-2:])
            except InputError as error:
                raise InputError(f"{path}, line {number}: {error}") from None
    if len(segments) == len(times):
        raise InputError(f"{path}, line {lines[-1][0]}: expected a key frame after '{segments[-1]}', got the end")
    return KeyFrames(times, values, segments)


def write_key_frames(curve: KeyFrames, path: str | Path) -> None:
    """Write an activation file that `read_key_frames` reads back equal.

    Raises
    ------
    InputError : the place cannot be written to
    """
    keys = [f"{time!r} {value!r}" for time, value in zip(curve.times_s, curve.values, strict=True)]
    lines = [line for pair in zip(keys, (*curve.segments, ""), strict=True) for line in pair][:-1]
    with whole_file(path) as part:
        part.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _key_frame(words: list[str], place: str) -> tuple[float, float]:
    try:
        time, value = (float(word) for word in words)
    except ValueError:
        time = value = math.nan
    if not (math.isfinite(time) and math.isfinite(value)):
        raise InputError(f"{place}: expected a key frame 'time value' in finite numbers, got '{' '.join(words)}'")
    return time, value


def _check_segment(segment: str, times_s, values) -> None:
    (t0, t1), (v0, v1) = times_s, values
    if segment not in SEGMENTS:
        raise InputError(f"expected a segment of {choices(SEGMENTS)}, got {nearest(segment, SEGMENTS)}")
    if not t1 > t0:
        raise InputError(f"expected key frames in increasing time, got {t1} s after {t0} s")
    if segment == "geometric" and (0 in (v0, v1) or (v0 > 0) != (v1 > 0)):
        raise InputError(
            f"expected a geometric segment between two values of one sign and not 0, got {v0} and {v1} "
            f"from {t0} to {t1} s; use linear, or a small value in place of 0"
        )


def _log_ratio(v0: float, v1: float) -> float:
    return math.log(abs(v1)) - math.log(abs(v0))
