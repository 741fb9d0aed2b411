"""A take: one recording of one movement as curves over time, whatever it was measured from.

Comparison, metrics and scores see takes only. Closed is 0, unknown is NaN; the two are never mixed. Lengths are in
mouth widths unless another unit is asked for, so that takes of different sizes can be compared; areas in its square.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches

import numpy as np
import pandas as pd

from lipmetrics.errors import InputError

UNITS = ("mw", "px", "m", "model")
SOURCES = ("profile", "truth", "video", "mesh", "mediapipe", "openface", "pyfeat", "dlib")
CHANNELS = ("width", "height", "area")
OPENING_COLUMNS = (
    *("time_s", "frame", "opening", "left", "right", "top", "bottom", "width", "height", "area", "x", "y"),
    *("event", "parents"),
)
_NOT_NEGATIVE = {*CHANNELS, "n_openings", "total_area"}
_COUNTS = {"n_openings"}  # held, not interpolated


@dataclass(frozen=True, eq=False)
class Take:
    """One recording of one movement.

    name : what tables and figures call it
    time_s : (T,) float64, strictly increasing, presentation times in s
    channels : name -> (T,) float64; `width`, `height` and `area` of the largest opening, and where known `n_openings`
        and `total_area`; 0 closed, NaN unknown
    unit : of lengths: `mw` (mouth widths), `px`, `m` or `model` (the mesh's own); areas are in its square
    openings : columns `OPENING_COLUMNS`, one row per opening per frame, in that unit; None where they are not known.
        x to the right, y down as one looks at the face; the origin is the middle of the mouth (`meta["origin"]` says
        how it was found); `x`, `y` are the centre of the area; `event` and `parents` as in docs/data_formats.md
    source : `profile`, `truth`, `video`, `mesh`, `mediapipe`, `openface`, `pyfeat` or `dlib`
    meta : where it comes from, the mouth width in the unit of the source and how it was found

    Raises
    ------
    InputError : an array of another shape, times that do not increase, or an unknown unit or source
    """

    name: str
    time_s: np.ndarray
    channels: dict[str, np.ndarray]
    unit: str = "mw"
    openings: pd.DataFrame | None = None
    source: str = "profile"
    meta: dict = field(default_factory=dict)

    def __post_init__(self) -> None:
        time_s = np.ascontiguousarray(self.time_s, float)
        channels = {name: np.ascontiguousarray(values, float) for name, values in self.channels.items()}
        if self.unit not in UNITS:
            raise InputError(f"{self.name}: expected the unit {' or '.join(UNITS)}, got '{self.unit}'")
        if self.source not in SOURCES:
            raise InputError(f"{self.name}: expected the source {' or '.join(SOURCES)}, got '{self.source}'")
        if time_s.ndim != 1 or len(time_s) == 0:
            raise InputError(f"{self.name}: expected the times of one frame or more, got shape {time_s.shape}")
        if not np.isfinite(time_s).all():
            frame = int(np.argmin(np.isfinite(time_s)))
            raise InputError(f"{self.name}: expected a time in s for every frame, got {time_s[frame]} for no. {frame}")
        back = np.flatnonzero(np.diff(time_s) <= 0)
        if len(back):
            k = int(back[0])
            raise InputError(
                f"{self.name}: expected times that increase, got {time_s[k]:g} s and then {time_s[k + 1]:g} s at frame "
                f"no. {k + 1}; leave out frames that are there twice"
            )
        missing = [name for name in CHANNELS if name not in channels]
        if missing:
            raise InputError(f"{self.name}: expected the channels {', '.join(CHANNELS)}, missing {', '.join(missing)}")
        for name, values in channels.items():
            if values.shape != time_s.shape:
                raise InputError(
                    f"{self.name}: expected {len(time_s)} values of '{name}', one per time, got shape {values.shape}"
                )
            if name in _NOT_NEGATIVE and (np.isinf(values).any() or (values < 0).any()):
                odd = values[np.isinf(values) | (values < 0)][0]
                raise InputError(f"{self.name}: expected values of '{name}' from 0 upwards or NaN, got {odd}")
        object.__setattr__(self, "time_s", time_s)
        object.__setattr__(self, "channels", channels)

    @property
    def duration_s(self) -> float:
        """From the first to the last frame, s."""
        return float(self.time_s[-1] - self.time_s[0])

    @property
    def rate_hz(self) -> float:
        """Frames per second; of the median step where steps differ; NaN for one frame."""
        if len(self.time_s) < 2:
            return math.nan
        steps = np.diff(self.time_s)
        step = float(np.median(steps))
        if np.abs(steps - step).max() < 0.01 * step:  # even but for rounded times
            return (len(self.time_s) - 1) / self.duration_s
        return 1 / step

    def array(
        self,
        channels: Sequence[str] = CHANNELS,
        rate_hz: float | None = None,
        max_gap_s: float = 0.1,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Channels without unknown values, for what compares curves.

        Unknown frames between known ones are bridged linearly where the known ones are at most `max_gap_s` apart
        (numbers of openings keep the last known one). At the two ends they are left out, `max_gap_s` at most.

        Parameters
        ----------
        channels : C names
        rate_hz : samples per second, evenly from the first time on, linearly between the frames; None keeps the frames

        Returns
        -------
        time_s : (T,) float64
        values : (T, C) float64, contiguous, no NaN

        Raises
        ------
        InputError : an unknown channel, or values that are unknown for longer, with their time
        """
        channels = (channels,) if isinstance(channels, str) else tuple(channels)
        if not channels:
            raise InputError("expected one channel or more, got none")
        for name in channels:
            if name not in self.channels:
                raise InputError(f"{self.name}: {unknown('channel', name, self.channels)}")
        if not (math.isfinite(max_gap_s) and max_gap_s >= 0):
            raise InputError(f"expected a longest gap of 0 s or more, got {max_gap_s}")
        values = np.column_stack([self.channels[name] for name in channels])
        known = np.isfinite(values)
        if not known.any(axis=0).all():
            name = channels[int(np.argmin(known.any(axis=0)))]
            raise InputError(f"{self.name}: expected '{name}' in some frame, it is unknown in all; leave this take out")
        first = int(known.argmax(axis=0).max())
        last = int(len(values) - 1 - known[::-1].argmax(axis=0).max())
        if first > last:
            raise InputError(f"{self.name}: expected a frame in which all of {', '.join(channels)} are known")
        self._check_gaps(channels, known, first, last, max_gap_s)
        time_s, values, known = self.time_s[first : last + 1], values[first : last + 1], known[first : last + 1]
        if rate_hz is None:
            target = time_s
        else:
            if not (math.isfinite(rate_hz) and rate_hz > 0):
                raise InputError(f"expected a rate above 0 per second, got {rate_hz}")
            count = math.floor((time_s[-1] - time_s[0]) * rate_hz * (1 + 1e-9) + 1e-6) + 1
            target = np.minimum(time_s[0] + np.arange(count) / rate_hz, time_s[-1])
        out = np.empty((len(target), len(channels)))
        for c, name in enumerate(channels):
            at, there = time_s[known[:, c]], values[known[:, c], c]
            if name in _COUNTS:
                out[:, c] = there[np.maximum(np.searchsorted(at, target + 1e-9, side="right") - 1, 0)]
            else:
                out[:, c] = np.interp(target, at, there)
        return target.copy(), out

    def _check_gaps(self, channels: tuple[str, ...], known: np.ndarray, first: int, last: int, max_gap_s: float):
        """Refuse unknown stretches that are too long to be bridged or, at the ends, left out."""
        limit = max_gap_s * (1 + 1e-9) + 1e-9
        for c, name in enumerate(channels):
            at = self.time_s[known[:, c]]
            bridged = np.diff(np.flatnonzero(known[:, c])) > 1
            ends = [(self.time_s[0], self.time_s[first]), (self.time_s[last], self.time_s[-1])]
            gaps = [*zip(at[:-1][bridged], at[1:][bridged], strict=True), *ends]
            for start_s, stop_s in gaps:
                if stop_s - start_s > limit:
                    raise InputError(
                        f"{self.name}: expected a known {name}, but it is unknown from {start_s:.3f} to {stop_s:.3f} "
                        f"s, longer than the {max_gap_s:g} s that are bridged; cut the take there or allow longer gaps"
                    )


def same_unit(takes: Sequence[Take], *, allow_mixed: bool = False) -> str:
    """The one unit of some takes; that of the first where mixed ones are allowed.

    Raises
    ------
    InputError : no takes, or takes in different units
    """
    if not takes:
        raise InputError("expected one take or more, got none")
    first_of = {take.unit: take.name for take in reversed(takes)}
    if len(first_of) > 1 and not allow_mixed:
        found = ", ".join(f"'{first_of[unit]}' in {unit}" for unit in UNITS if unit in first_of)
        raise InputError(
            f"expected takes in one unit, got {found}; read all of them in mouth widths, or allow mixed units"
        )
    return takes[0].unit


def unknown(what: str, given: str, known) -> str:
    """What to say of a name that is none of the known ones, with the nearest of these."""
    near = get_close_matches(str(given), list(known), n=1)
    hint = f"; did you mean '{near[0]}'?" if near else ""
    return f"expected a {what} out of {', '.join(known)}, got '{given}'{hint}"
