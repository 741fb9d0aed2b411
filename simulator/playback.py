"""A motion at other times than those it was saved at, so that a picture's frame rate is free of the solver's steps."""

from __future__ import annotations

import dataclasses

import numpy as np

from simulator.errors import InputError
from simulator.motion import Motion, SalivaRecord

SAME_S = 1e-9  # times nearer than this are the same time: frame times are sums and quotients that round


def at_times(motion: Motion, times_s: np.ndarray) -> Motion:
    """The motion at given times.

    Positions, velocities, energies, and stretch, moisture and critical value of the saliva are interpolated linearly
    between the saved times; the state of a saliva element is the last one saved at or before. At a saved time
    all are as saved, to the last bit.

    Parameters
    ----------
    motion : with one or more saved times
    times_s : (F,) s, increasing, within the saved times; may be empty

    Raises
    ------
    InputError : times that are not a list of increasing numbers, or that lie outside the saved times
    """
    places = _places(motion.time_s, times_s)

    def between(values):
        return _between(np.asarray(values), *places)

    saliva = motion.saliva
    if saliva is not None:
        states = np.asarray(saliva.state)[places[0]]
        saliva = SalivaRecord(
            saliva.elements, states, *map(between, (saliva.stretch, saliva.moisture, saliva.critical))
        )
    return dataclasses.replace(
        motion,
        time_s=np.array(times_s, float),
        positions=between(motion.positions),
        energies={name: between(values) for name, values in motion.energies.items()},
        velocities=None if motion.velocities is None else between(motion.velocities),
        saliva=saliva,
    )


def values_at(saved_s: np.ndarray, values: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """(F, ...) values (T, ...) of the saved times (T,), s, at given times (F,), s, as `at_times` has those of a motion.

    Raises
    ------
    InputError : as `at_times`
    """
    return _between(np.asarray(values), *_places(saved_s, times_s))


def states_at(saved_s: np.ndarray, states: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """(F, ...) states (T, ...): of each time (F,), s, the last one saved at or before.

    Raises
    ------
    InputError : as `at_times`
    """
    return np.asarray(states)[_places(saved_s, times_s)[0]]


def frame_times(motion: Motion, times_s: np.ndarray | None = None) -> np.ndarray:
    """(F,) s, times of one frame or more; None takes the saved ones.

    Raises
    ------
    InputError : no times, or times that `at_times` refuses
    """
    times = _times(motion.time_s if times_s is None else times_s)
    if len(times) == 0:
        none = "a motion with saved states" if times_s is None else "the time of one frame or more"
        raise InputError(f"expected {none}, got none")
    _places(motion.time_s, times)
    return times


def _times(times_s: np.ndarray) -> np.ndarray:
    try:
        times = np.array(times_s, float)
    except (TypeError, ValueError):
        raise InputError(f"expected times as a list of numbers in s, got {type(times_s).__name__}") from None
    if times.ndim != 1 or not np.isfinite(times).all():
        raise InputError("expected times as a list of finite numbers in s, got another shape, NaN or infinity")
    return times


def _places(saved_s: np.ndarray, times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Saved states (F,) before and after each time, and how far (F,) it is from the one to the other, 0 to 1."""
    saved_s, times = np.asarray(saved_s, float), _times(times_s)
    if (np.diff(times) <= 0).any():
        at = int(np.argmax(np.diff(times) <= 0))
        raise InputError(f"expected times that increase, got {times[at + 1]:g} after {times[at]:g} s")
    if len(times) == 0:
        none = np.zeros(0, int)
        return none, none, np.zeros(0)
    if len(saved_s) == 0:
        raise InputError("expected a motion with saved states, got one with none; solve it with times")
    for time in (times[0], times[-1]):
        if not saved_s[0] - SAME_S <= time <= saved_s[-1] + SAME_S:
            raise InputError(
                f"expected times from {saved_s[0]:g} to {saved_s[-1]:g} s, those the motion was saved for, got {time:g}"
                "; ask for others or solve for longer"
            )
    before = np.clip(np.searchsorted(saved_s, times + SAME_S, side="right") - 1, 0, None)
    after = np.minimum(before + 1, len(saved_s) - 1)
    span = np.where(after > before, saved_s[after] - saved_s[before], 1.0)
    part = (times - saved_s[before]) / span
    part[np.abs(times - saved_s[before]) <= SAME_S] = 0.0
    return before, after, np.clip(part, 0.0, 1.0)


def _between(values: np.ndarray, before: np.ndarray, after: np.ndarray, part: np.ndarray) -> np.ndarray:
    start = values[before]
    way = np.flatnonzero(part)  # elsewhere the next state, which may be no number, has no say
    if len(way):
        start = np.array(start, float)
        start[way] += part[way].reshape(-1, *[1] * (values.ndim - 1)) * (values[after[way]] - start[way])
    return start
