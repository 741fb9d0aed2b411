"""What is compared: curves over time, taken from takes, averages or plain arrays, and set on one even time grid."""

from __future__ import annotations

import difflib
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lipmetrics.errors import InputError

CHANNELS = ("width", "height", "area")
MOST_SAMPLES = 200_000  # of one curve after resampling
_ALIKE = 0.01  # time steps that differ by less than this share count as alike (times rounded to milliseconds)


@dataclass(frozen=True)
class Curve:
    """A curve without gaps.

    time_s : (T,) float64, strictly increasing, seconds
    data : (T, C) float64, finite, C-contiguous
    channels : names of the C columns
    unit : of lengths ('mw', 'px', 'm', 'model'), '' where unknown
    """

    name: str
    time_s: np.ndarray
    data: np.ndarray
    channels: tuple[str, ...]
    unit: str = ""

    @property
    def rate_hz(self) -> float:
        """Samples per second: of the mean time step if all are alike, else of the median; NaN for a single sample."""
        steps = np.diff(self.time_s)
        if not len(steps):
            return float("nan")
        mean = (self.time_s[-1] - self.time_s[0]) / len(steps)
        alike = np.abs(steps - mean).max() <= _ALIKE * mean
        return float(1.0 / (mean if alike else np.median(steps)))


def as_curve(source, channels: Sequence[str] = CHANNELS, rate_hz: float | None = None, name: str = "curve") -> Curve:
    """A curve from any of the forms that comparisons accept.

    Parameters
    ----------
    source : a Take (or anything with `array(channels)`, `unit` and `name`), an Average, a Curve, a pair
        (time_s (T,), values (T,) or (T, C)), or an array (T,) or (T, C) sampled at `rate_hz` from 0 s
    channels : names to take from a Take, Average or Curve; arrays come as they are, with all their columns

    Raises
    ------
    InputError : no samples, values that are not finite, times that do not increase, unknown channels
    """
    channels = (channels,) if isinstance(channels, str) else tuple(channels)
    if isinstance(source, Curve):
        return _choose(source, channels)
    if hasattr(source, "as_curve"):
        return _choose(source.as_curve(), channels)
    if hasattr(source, "array") and hasattr(source, "channels"):
        time_s, values = source.array(channels)
        name = str(getattr(source, "name", name))
        return checked(Curve(name, time_s, values, channels, str(getattr(source, "unit", ""))))
    if isinstance(source, tuple) and len(source) == 2:
        time_s, values = source
    else:
        values = np.asarray(source)
        if rate_hz is None:
            raise InputError(f"{name}: expected a take, or (time_s, values), or an array with rate_hz; got no times")
        time_s = np.arange(len(values) if values.ndim else 0) / check_rate(rate_hz)
    values = as_values(values, name)
    names = channels if len(channels) == values.shape[1] else tuple(str(c) for c in range(values.shape[1]))
    return _timed(Curve(name, time_s, values, names))


def as_values(values, name: str = "curve") -> np.ndarray:
    """Any array (T,) or (T, C) as (T, C) float64 C-contiguous, finite, T and C at least 1; InputError otherwise."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected numbers of shape (samples,) or (samples, channels)") from None
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2:
        raise InputError(f"{name}: expected shape (samples,) or (samples, channels), got {array.shape}")
    if 0 in array.shape:
        raise InputError(f"{name}: expected at least one sample and one channel, got shape {array.shape}")
    bad = ~np.isfinite(array)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise InputError(
            f"{name}: expected finite values, got {array[row, column]} at sample {row}, channel {column}"
            f" ({int(bad.sum())} in all); bridge or cut unknown stretches first"
        )
    return np.ascontiguousarray(array)


def checked(curve: Curve) -> Curve:
    """The curve with its arrays in the promised form; InputError if they cannot be."""
    return _timed(replace(curve, data=as_values(curve.data, curve.name)))


def _timed(curve: Curve) -> Curve:
    """`checked` of a curve whose values are in the promised form already."""
    try:
        time_s = np.asarray(curve.time_s, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{curve.name}: expected times in seconds, got something else") from None
    if time_s.shape != curve.data.shape[:1]:
        raise InputError(
            f"{curve.name}: expected one time per sample, got {time_s.shape} for {curve.data.shape[0]} samples"
        )
    if not np.isfinite(time_s).all() or (np.diff(time_s) <= 0).any():
        raise InputError(f"{curve.name}: expected finite times that increase from sample to sample (in seconds)")
    return replace(curve, time_s=np.ascontiguousarray(time_s))


def check_rate(rate_hz: float) -> float:
    """The rate, if it is positive and finite; InputError otherwise."""
    if not (isinstance(rate_hz, (int, float, np.number)) and 0 < rate_hz < np.inf):
        raise InputError(f"expected a rate above 0 samples per second, got {rate_hz!r}")
    return float(rate_hz)


def resample(curve: Curve, rate_hz: float) -> Curve:
    """The curve at t0, t0 + 1 / rate_hz, ... up to its end, by straight lines between samples."""
    if _on_grid(curve, rate_hz):
        return curve
    count = _count(curve, rate_hz)
    time_s = curve.time_s[0] + np.arange(count) / rate_hz
    columns = [np.interp(time_s, curve.time_s, column) for column in curve.data.T]
    return replace(curve, time_s=time_s, data=np.ascontiguousarray(np.stack(columns, axis=1)))


def even(
    sources: Sequence, channels: Sequence[str] = CHANNELS, rate_hz: float | None = None, mixed_units: bool = False
) -> tuple[list[Curve], float]:
    """Curves of all sources on even grids of one rate, which is returned too.

    The rate is `rate_hz` if given, else the highest of the sources' own (of their median time steps), so that none
    loses detail; curves keep their own first time. Arrays without times need `rate_hz` and are not changed by it.

    Raises
    ------
    InputError : see `as_curve`; different numbers of channels; different units, unless `mixed_units`
    """
    curves = [as_curve(source, channels, rate_hz, f"curve {at}") for at, source in enumerate(sources)]
    if not curves:
        raise InputError("expected at least one take, got none")
    for curve in curves[1:]:
        if curve.data.shape[1] != curves[0].data.shape[1]:
            raise InputError(
                f"expected the same channels in both, got {curves[0].data.shape[1]} in {curves[0].name}"
                f" and {curve.data.shape[1]} in {curve.name}"
            )
    units = {curve.unit for curve in curves if curve.unit}
    if len(units) > 1 and not mixed_units:
        raise InputError(
            f"expected takes of one unit, got {', '.join(sorted(units))}; bring them to one unit (mouth widths, say)"
            " or pass mixed_units=True"
        )
    if rate_hz is None:
        rates = [curve.rate_hz for curve in curves if len(curve.time_s) > 1]
        rate_hz = max(rates) if rates else 1.0
    rate_hz = check_rate(rate_hz)
    return [_at_rate(source, curve, rate_hz) for source, curve in zip(sources, curves, strict=True)], rate_hz


def _at_rate(source, curve: Curve, rate_hz: float) -> Curve:
    """The curve at a rate; a take resamples itself, as it knows which of its channels are counts."""
    if _on_grid(curve, rate_hz):
        return curve
    if not hasattr(source, "array"):
        return resample(curve, rate_hz)
    _count(curve, rate_hz)
    time_s, data = source.array(curve.channels, rate_hz=rate_hz)
    return replace(curve, time_s=time_s, data=data)


def _count(curve: Curve, rate_hz: float) -> int:
    """Samples of the curve at a rate; InputError if they are too many."""
    count = int(np.floor((curve.time_s[-1] - curve.time_s[0]) * rate_hz + 1e-6)) + 1
    if count > MOST_SAMPLES:
        raise InputError(f"{curve.name}: {count} samples at {rate_hz:g} per second are too many; pass a lower rate_hz")
    return count


def _on_grid(curve: Curve, rate_hz: float) -> bool:
    return len(curve.time_s) == 1 or float(np.abs(np.diff(curve.time_s) * rate_hz - 1).max()) <= 1e-9


def nearest_name(name: object, known: Sequence[str], what: str) -> str:
    """`name` if it is known; InputError that names the nearest known one otherwise."""
    if name in known:
        return str(name)
    near = difflib.get_close_matches(str(name), known, 1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise InputError(f"expected {what} to be one of {', '.join(map(str, known))}, got {name!r}{hint}")


def thread_count(threads: int | None) -> int:
    """`threads`, or as many as this process may use cores."""
    if threads is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not isinstance(threads, (int, np.integer)) or threads < 1:
        raise InputError(f"expected at least 1 thread, got {threads!r}")
    return int(threads)


def _choose(curve: Curve, channels: tuple[str, ...]) -> Curve:
    """The named columns of a curve; all of them where it has none of these names (it came from a plain array)."""
    if channels == curve.channels or not set(channels) & set(curve.channels):
        return checked(curve)
    at = [curve.channels.index(nearest_name(channel, curve.channels, "channel")) for channel in channels]
    return checked(replace(curve, data=curve.data[:, at], channels=channels))
