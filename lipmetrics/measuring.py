"""The metrics that a score is made of: of pairs of curves, of movement and of sticky lips, and how they are called.

Metrics of meshes and landmarks (`vertices`, `landmarks`) need more than a take holds, so they are not part of a score.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from lipmetrics.compare import BAND, COST
from lipmetrics.errors import InputError
from lipmetrics.metrics import LOWER, METRICS, NONE, curves, movement, sticky
from lipmetrics.take import CHANNELS, Take

ZERO = "zero"
AT_BAND = "at_band"  # not a metric: the share of the path at the edge of the band, where lag is a lower bound

# said by another metric already: the size of the lag; heights and speeds as differences; ratios are not distances
LEFT_OUT = ("lateness_v1", "peak_ratio_v1", "speed_ratio_v1")
GROUPS = {
    "as they are": ("l2", "mod", "correlation"),
    "after alignment": ("l2_aligned", "dtw", "hausdorff"),
    "in time": ("lag", "warp", "hold", "stretch", "onset_difference"),
    "movement": (),
    "sticky lips": (),
}
# what a row of a table in a paper has room for
HEADLINES = (
    *("l2_width_v1", "l2_height_v1", "dtw_width_v1", "dtw_height_v1", "hausdorff_width_v1", "hausdorff_height_v1"),
    *("lag_v1", "warp_v1", "most_openings_v1"),
)


@dataclass(frozen=True)
class Measure:
    """A metric as a score uses it.

    better : `lower` is nearer, `higher` is nearer, or `zero`: the distance is the absolute value
    of_pair : compares two takes; else it describes one, and the distance is the absolute difference
    family : a key of `GROUPS`
    """

    name: str
    unit: str
    better: str
    of_pair: bool
    family: str = ""


@dataclass(frozen=True)
class Measuring:
    """What is measured, and how: `pair(real, model)` and `take(take)` give name -> value of the `measures`."""

    measures: tuple[Measure, ...]
    pair: Callable[[Take, Take], Mapping[str, float]]
    take: Callable[[Take], Mapping[str, float]]


def all_measures(
    *,
    channels: Sequence[str] = CHANNELS,
    cost: str = COST,
    band: float | None = BAND,
    rate_hz: float | None = None,
    mixed_units: bool = False,
) -> Measuring:
    """All metrics that takes allow; those of a curve are of these channels, their alignment is of all three.

    Parameters
    ----------
    rate_hz : samples per second that curves are compared at; None: the higher rate of a pair

    Raises
    ------
    InputError : a channel other than width, height and area
    """
    channels = tuple(channels)
    for channel in channels:
        if channel not in CHANNELS:
            raise InputError(f"expected the channels {', '.join(CHANNELS)}, got '{channel}'")
    rows = [row for row in METRICS.values() if row.needs in ("take pair", "take", "openings")]
    rows = [row for row in rows if row.name not in LEFT_OUT and _wanted(row.name, channels)]
    measures = sorted((_measure(row) for row in rows), key=lambda one: list(GROUPS).index(one.family))
    prepared: dict[int, tuple[Take, Take]] = {}

    def even(take: Take) -> Take:
        if rate_hz is None:
            return take
        if id(take) not in prepared:  # the take is kept with it, so that its id stays its own
            time_s, values = take.array(CHANNELS, rate_hz)
            columns = dict(zip(CHANNELS, values.T, strict=True))
            prepared[id(take)] = (take, Take(take.name, time_s, columns, take.unit, None, take.source, take.meta))
        return prepared[id(take)][1]

    def pair(real: Take, model: Take) -> Mapping[str, float]:
        both = curves.validate(even(real), even(model), cost=cost, band=band, mixed_units=mixed_units)
        return curves.evaluate(both) | {AT_BAND: both.alignment.at_band}

    def single(take: Take) -> Mapping[str, float]:
        found = movement.evaluate(take)
        if take.openings is not None:
            found |= sticky.evaluate(take)
        return found

    return Measuring(tuple(measures), pair, single)


def label_of(name: str) -> str:
    """A metric's name in words: 'l2_aligned_height_v1' -> 'L2 aligned height'."""
    words = name.rsplit("_v", 1)[0].split("_")
    words = [{"l2": "L2", "dtw": "DTW", "mod": "MOD", "hausdorff": "Hausdorff"}.get(word, word) for word in words]
    return " ".join(words)


def title_of(measure: Measure) -> str:
    """What a score's value in a metric is: of a metric of single takes it is a difference."""
    return label_of(measure.name) + ("" if measure.of_pair else " difference")


def unit_of(measure: Measure, unit: str) -> str:
    """The unit of a metric of takes in `unit`, as people write it: nothing, 's', 'mw', 'mw²', 'mw/s', 'per s'."""
    text = measure.unit.replace("mw", unit)
    return {"1": "", "1/s": "per s"}.get(text, text.replace("^2", "²"))


def formula_of(name: str) -> str:
    """A metric's formula, as its row says it."""
    return METRICS[name].formula if name in METRICS else ""


def _measure(row) -> Measure:
    of_pair = row.needs == "take pair"
    better = LOWER
    if of_pair:
        better = ZERO if row.better == NONE else row.better
    return Measure(row.name, row.unit, better, of_pair, _group(row))


def _group(row) -> str:
    if row.family in ("movement", "sticky"):
        return "movement" if row.family == "movement" else "sticky lips"
    stem = row.name.rsplit("_v", 1)[0]
    of = [name for name, stems in GROUPS.items() if any(stem == s or _is_of_channel(stem, s) for s in stems)]
    return of[0] if of else "in time"


def _is_of_channel(stem: str, start: str) -> bool:
    return any(stem == f"{start}_{channel}" for channel in CHANNELS)


def _wanted(name: str, channels: tuple[str, ...]) -> bool:
    """Whether a metric of curves is of one of the channels, or of none in particular."""
    row, stem = METRICS[name], name.rsplit("_v", 1)[0]
    if row.family != "curves":
        return True
    of = [channel for channel in CHANNELS if stem.endswith(f"_{channel}")]
    return not of or of[0] in channels
