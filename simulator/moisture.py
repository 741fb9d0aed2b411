"""How wet the lips are, and how strongly that glues them (thesis section 3.6).

Moisture is given over the critical moisture Mc: above 1 the saliva is a lubricant, from 1 down it glues, less and less
until it is dry.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simulator.errors import InputError

FULL_LEVEL = 10.0  # the strongest stickiness of the study (thesis 5.1)
FULL_STRENGTH = 0.0016  # K of eq. 3.67, so that this is Z - 1 at the full level


@dataclass(frozen=True, eq=False)
class Lick:
    """Wetting of a part of the lips at one time.

    Parameters
    ----------
    time_s : s, above 0
    saliva : (n,) positions in `Saliva.elements`
    moisture : M / Mc from then on
    """

    time_s: float
    saliva: np.ndarray
    moisture: float

    def __post_init__(self):
        saliva = np.array(self.saliva, dtype=np.int64).ravel()
        if not (math.isfinite(self.time_s) and self.time_s > 0):
            raise InputError(f"expected a lick at a time above 0 s, got {self.time_s}")
        if not (math.isfinite(self.moisture) and self.moisture >= 0):
            raise InputError(f"expected a lick to a moisture of 0 or more, got {self.moisture}")
        saliva.setflags(write=False)
        object.__setattr__(self, "saliva", saliva)


def dried(moisture: np.ndarray, rate_per_s: np.ndarray, elapsed_s: np.ndarray | float) -> np.ndarray:
    """M(t) / Mc = max(0, M0 / Mc - rate t), thesis eq. 3.66; arrays of one shape, rate over Mc in 1/s."""
    return np.maximum(0.0, moisture - rate_per_s * elapsed_s)


def wetted(moisture: np.ndarray, rate_per_s: np.ndarray, licks: Sequence[Lick], time_s: float) -> np.ndarray:
    """M / Mc (S,) at a time, after all licks up to then; `moisture` is that at time 0. Arguments as in Saliva."""
    now, since = np.array(moisture), np.zeros(len(moisture))
    for lick in licks:
        if lick.time_s <= time_s:
            now[lick.saliva], since[lick.saliva] = lick.moisture, lick.time_s
    return dried(now, rate_per_s, time_s - since)


def next_change_s(
    moisture: np.ndarray, rate_per_s: np.ndarray, strength: np.ndarray, stretch_squared: np.ndarray, broken: np.ndarray
) -> float:
    """Time until drying alone next breaks an element that is held at Q, or lets a broken one stick, s; inf if never.

    Arguments are (S,), moisture that of now; `broken` marks elements that lie against one another.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        least = np.where(stretch_squared > 1, (stretch_squared - 1) / strength, -1.0)  # M / Mc at which Z = Q
        target = np.where(broken, 1.0, least)
        wait = np.where((moisture > target) & (target >= 0), (moisture - target) / rate_per_s, np.inf)
    return float(np.min(wait, initial=math.inf))


def critical(moisture: np.ndarray, strength: np.ndarray) -> np.ndarray:
    """Z = 1 where M > Mc, else 1 + K M / Mc, thesis eq. 3.67; `strength` is K."""
    return np.where(moisture > 1, 1.0, 1 + strength * moisture)


def strength_of_level(level: float) -> float:
    """K of a stickiness level from 0 to 10, linear.

    Raises
    ------
    InputError : a level out of range
    """
    if not 0 <= level <= FULL_LEVEL:
        raise InputError(f"expected a stickiness level from 0 to {FULL_LEVEL:g}, got {level}")
    return FULL_STRENGTH * level / FULL_LEVEL
