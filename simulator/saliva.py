"""The film of saliva between the lips: what the solver has to know about it (thesis sections 3.5 and 3.6)."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from simulator.errors import InputError
from simulator.moisture import Lick

DECAY_S = 0.02  # the force of a broken element falls by e in this time; 0.001 s in eq. 3.62, 0.01 s in algorithm 1
POOLING = 36.0  # how many times as strong the saliva is at the corners as in the middle (docs/validation.md)
RAMP_S = 0.01  # an element that sticks again gets its force back over this time (thesis 3.5.3)


def pooled(place: np.ndarray, pooling: float) -> np.ndarray:
    """Factor on the strength at places from -1 to 1 along the lips: 1 in the middle, `pooling` at the corners.

    Saliva gathers in the corners of the mouth. The tip of an opening is pulled the harder the longer the opening is, so
    that with one strength everywhere the lips would come apart along their whole length as soon as they part anywhere.
    """
    return 1 + (pooling - 1) * np.abs(place) ** 3


@dataclass(frozen=True, eq=False)
class Saliva:
    """Elements of a model that break, decay, stick again, and keep the lips apart.

    Q is the square of the stretch along the height of the element. It breaks where Q reaches Z = 1 + K M / Mc
    (`moisture.critical`); the force that it then has decays as exp(-t / decay_s). Where its height comes back to that
    at rest, its force is ramped in again over ramp_s, about where the lips then lie. Squeezed, it is stiff in whatever
    state it is.

    Parameters
    ----------
    elements : (S,) element numbers
    up : (S, 3) unit vectors at rest, across the film from the lower to the upper lip
    strength : (S,) or one number: K, Z - 1 at critical moisture; 0 never glues
    moisture : (S,) or one number: M / Mc at the start
    drying_per_s : (S,) or one number: evaporation rate over Mc, 1/s
    licks : wettings, in the order of their times
    decay_s, ramp_s : s

    Raises
    ------
    InputError : shapes that do not fit, or a negative number
    """

    elements: np.ndarray
    up: np.ndarray
    strength: np.ndarray | float
    moisture: np.ndarray | float = 1.0
    drying_per_s: np.ndarray | float = 0.0
    licks: tuple[Lick, ...] = ()
    decay_s: float = DECAY_S
    ramp_s: float = RAMP_S

    def __post_init__(self):
        elements = np.array(self.elements, dtype=np.int64).ravel()
        count = len(elements)
        up = np.array(self.up, dtype=float)
        if not count or len(np.unique(elements)) != count:
            raise InputError(f"expected one or more different saliva elements, got {count}, some twice or none")
        if up.shape != (count, 3) or not np.allclose(np.linalg.norm(up, axis=1), 1, atol=1e-6):
            raise InputError(f"expected up as {count} unit vectors of shape ({count}, 3), got shape {up.shape}")
        values = {"elements": elements, "up": up}
        for name in ("strength", "moisture", "drying_per_s"):
            array = np.array(getattr(self, name), dtype=float)
            if array.shape not in ((), (count,)):
                raise InputError(f"expected {name} as one number or {count}, one per element, got shape {array.shape}")
            array = np.array(np.broadcast_to(array, (count,)))
            if not (np.isfinite(array).all() and (array >= 0).all()):
                raise InputError(f"expected {name} of 0 or more in every saliva element, got {np.nanmin(array):g}")
            values[name] = array
        for name in ("decay_s", "ramp_s"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"expected {name} above 0 s, got {getattr(self, name)}")
        licks = tuple(self.licks)
        for before, after in itertools.pairwise(licks):
            if after.time_s < before.time_s:
                raise InputError(
                    f"expected licks in the order of their times, got {after.time_s} after {before.time_s} s"
                )
        for lick in licks:
            if len(lick.saliva) and not (lick.saliva.min() >= 0 and lick.saliva.max() < count):
                raise InputError(f"expected a lick on saliva elements 0 to {count - 1}, got {lick.saliva.max()}")
        values["licks"] = licks
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            object.__setattr__(self, name, value)
