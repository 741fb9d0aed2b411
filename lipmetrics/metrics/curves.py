"""How far the curves of two takes are apart, as they are and after alignment, and how late and how warped one is.

A pair of takes is aligned once, on width, height and area together (`lipmetrics.compare`), and each channel is scored
along that path. Aligned numbers forgive lateness and uneven tempo, so they are told together with lag and warp. Takes
share one clock here: a model starts with the recording that it is compared with. Lengths are in the unit of the takes,
`mw` in the rows; areas in its square.

Every function takes a reference and a model, or in their place what `validate` made of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from lipmetrics.compare import Alignment, align, aligned_l2
from lipmetrics.compare.distances import SECONDS_PER_UNIT, common_moments, of_points
from lipmetrics.compare.warping import BAND, COST
from lipmetrics.errors import InputError
from lipmetrics.metrics import movement
from lipmetrics.metrics.registry import HIGHER, LOWER, NONE, Metric
from lipmetrics.take import Take

CHANNELS = ("width", "height", "area")


@dataclass(frozen=True, eq=False)
class Pair:
    """A reference and a model, aligned.

    alignment : a is the reference, b the model
    time_s : (N,) moments that both cover
    real, made : (N, 3) width, height and area of reference and model at these moments
    """

    reference: Take
    model: Take
    alignment: Alignment
    time_s: np.ndarray
    real: np.ndarray
    made: np.ndarray


def validate(
    reference: Take | Pair,
    model: Take | None = None,
    *,
    cost: str = COST,
    band: float | None = BAND,
    mixed_units: bool = False,
) -> Pair:
    """Align two takes.

    Parameters
    ----------
    cost, band : of the alignment, see docs/comparison.md
    mixed_units : score different units of length all the same

    Raises
    ------
    InputError : no takes, different units, unknown stretches that are too long, or no moment in common
    """
    if isinstance(reference, Pair):
        return reference
    for take in (reference, model):
        movement.validate(take)
    alignment = align(reference, model, channels=CHANNELS, cost=cost, band=band, mixed_units=mixed_units)
    a, b = alignment.a, alignment.b
    inside = common_moments(a, b)
    made = np.stack([np.interp(a.time_s[inside], b.time_s, column) for column in b.data.T], axis=1)
    return Pair(reference, model, alignment, a.time_s[inside], a.data[inside], made)


def l2(reference: Take | Pair, model: Take | None = None, channel: str = "height") -> float:
    """Root mean square difference at equal times, mw (area: mw^2): sqrt( mean over common t of (x(t) - y(t))^2 )."""
    pair, c = validate(reference, model), _column(channel)
    return float(np.sqrt(((pair.real[:, c] - pair.made[:, c]) ** 2).mean()))


def l2_aligned(reference: Take | Pair, model: Take | None = None, channel: str = "height") -> float:
    """Root mean square difference along the path, mw (area: mw^2): sqrt( mean over path (i, j) of (x_i - y_j)^2 )."""
    _column(channel)
    return aligned_l2(validate(reference, model).alignment).channels[channel]


def dtw(reference: Take | Pair, model: Take | None = None, channel: str = "height") -> float:
    """Mean absolute difference along the path, mw (area: mw^2): mean over path (i, j) of |x_i - y_j|.

    The three channels add up to the mean local cost of the path that is as cheap as can be.
    """
    match, c = validate(reference, model).alignment, _column(channel)
    return float(np.abs(match.a.data[match.path[:, 0], c] - match.b.data[match.path[:, 1], c]).mean())


def hausdorff(reference: Take | Pair, model: Take | None = None, channel: str = "height") -> float:
    """Hausdorff distance of the aligned curves as points (time, value), mw: the worst moment.

    Both curves take the mean of the times of each pair of the path; one second counts as much as one mouth width (as
    one square mouth width for the area).

    Source: Leach & Maddock's evaluation of mouth animation, here in both directions.
    """
    match, c = validate(reference, model).alignment, slice(_column(channel), _column(channel) + 1)
    time = match.times_s.mean(axis=1) / SECONDS_PER_UNIT
    real, made = match.a.data[match.path[:, 0], c], match.b.data[match.path[:, 1], c]
    return max(of_points(time, real, time, made))


def correlation(reference: Take | Pair, model: Take | None = None, channel: str = "height") -> float:
    """Pearson's correlation at equal times, 1. NaN where one of the two does not change."""
    pair, c = validate(reference, model), _column(channel)
    real, made = (values[:, c] - values[:, c].mean() for values in (pair.real, pair.made))
    size = math.sqrt((real**2).sum() * (made**2).sum())
    # a channel that stays the same may differ from its mean by rounding
    if min(np.ptp(pair.real[:, c]), np.ptp(pair.made[:, c])) == 0 or size == 0:
        return math.nan
    return float(np.clip((real * made).sum() / size, -1, 1))


def mod_v1(reference: Take | Pair, model: Take | None = None) -> float:
    """Mouth opening difference, mw: mean absolute difference of the measured heights of the opening at equal times.

        MOD = mean over common t of |h(t) - g(t)|

    What the name says, of the opening itself. `vertices.mod_artalk_v1` and `mod_msmd_v1` are what others call so.

    Source: this package.
    """
    pair = validate(reference, model)
    return float(np.abs(pair.real[:, 1] - pair.made[:, 1]).mean())


def lag_v1(reference: Take | Pair, model: Take | None = None) -> float:
    """How much later the model is, s; negative earlier. Median time difference along the path where something moves."""
    return validate(reference, model).alignment.lag_s


def lateness_v1(reference: Take | Pair, model: Take | None = None) -> float:
    """Size of the lag, s: |lag_v1|."""
    return abs(lag_v1(reference, model))


def warp_v1(reference: Take | Pair, model: Take | None = None) -> float:
    """Share of the path's steps in which one of the two stands still, 1, from 0, the same tempo, to 1."""
    return validate(reference, model).alignment.warp


def hold_v1(reference: Take | Pair, model: Take | None = None) -> float:
    """Longest time for which the path lets one of the two stand still, s."""
    return validate(reference, model).alignment.hold_s


def stretch_v1(reference: Take | Pair, model: Take | None = None) -> float:
    """Largest ratio of the times that both go through within 0.2 s of the path, 1; 1 is the same tempo throughout."""
    return validate(reference, model).alignment.stretch


def onset_difference_v1(reference: Take | Pair, model: Take | None = None) -> float:
    """How much later the model's mouth opens, s: onset of the model - onset of the reference, on the shared clock.

    Onsets as in `movement.onset_time_v1`. NaN where one of them has none.
    """
    pair = validate(reference, model)
    real, made = (movement.onset_time_v1(take) + float(take.time_s[0]) for take in (pair.reference, pair.model))
    return made - real


def peak_ratio_v1(reference: Take | Pair, model: Take | None = None) -> float:
    """Greatest height of the model over that of the reference, 1: above 1 overacts, below 1 mumbles.

    NaN where the reference never opens.
    """
    pair = validate(reference, model)
    real, made = movement.peak_height_v1(pair.reference), movement.peak_height_v1(pair.model)
    return made / real if real > 0 else math.nan


def speed_ratio_v1(reference: Take | Pair, model: Take | None = None) -> float:
    """Peak opening velocity of the model over that of the reference, 1. NaN where the reference never opens."""
    pair = validate(reference, model)
    real, made = movement.opening_speed_v1(pair.reference), movement.opening_speed_v1(pair.model)
    return made / real if real > 0 else math.nan


def evaluate(reference: Take | Pair, model: Take | None = None, **settings) -> dict[str, float]:
    """All metrics of this module by name; settings as for `validate`.

    Raises
    ------
    InputError : as `validate`
    """
    pair = validate(reference, model, **settings)
    return {row.name: row.function(pair) for row in ROWS}


def _column(channel: str) -> int:
    if channel not in CHANNELS:
        raise InputError(f"expected the channel {', '.join(CHANNELS)}, got {channel!r}")
    return CHANNELS.index(channel)


def _rows_of_channels():
    for function, better, formula, source in (
        (l2, LOWER, "sqrt( mean over common t of (x(t) - y(t))^2 )", "root mean square"),
        (l2_aligned, LOWER, "sqrt( mean over path (i, j) of (x_i - y_j)^2 )", "root mean square after alignment"),
        (dtw, LOWER, "mean over path (i, j) of |x_i - y_j|", "dynamic time warping, docs/comparison.md"),
        (hausdorff, LOWER, "Hausdorff distance of (t, x) and (t, y) along the path", "docs/comparison.md"),
        (correlation, HIGHER, "Pearson's r of x(t) and y(t) over common t", "Pearson"),
    ):
        for channel in CHANNELS:
            unit = "1" if function is correlation else "mw^2" if channel == "area" else "mw"
            name = f"{function.__name__}_{channel}_v1"
            called = partial(function, channel=channel)
            yield Metric(name, "curves", unit, better, "take pair", called, formula, source)


ROWS = (
    *_rows_of_channels(),
    Metric(
        *("mod_v1", "curves", "mw", LOWER, "take pair", mod_v1),
        *("mean over common t of |h(t) - g(t)|", "this package"),
    ),
    Metric(
        *("lag_v1", "curves", "s", NONE, "take pair", lag_v1),
        *("weighted median of t_model - t_reference along the path", "docs/comparison.md"),
    ),
    Metric(*("lateness_v1", "curves", "s", LOWER, "take pair", lateness_v1, "|lag_v1|", "docs/comparison.md")),
    Metric(
        *("warp_v1", "curves", "1", LOWER, "take pair", warp_v1),
        *("steps of the path that are not diagonal / steps", "docs/comparison.md"),
    ),
    Metric(
        *("hold_v1", "curves", "s", LOWER, "take pair", hold_v1),
        *("longest stretch of the path in which one stands still", "docs/comparison.md"),
    ),
    Metric(
        *("stretch_v1", "curves", "1", LOWER, "take pair", stretch_v1),
        *("largest ratio of both times within 0.2 s of the path", "docs/comparison.md"),
    ),
    Metric(
        *("onset_difference_v1", "curves", "s", NONE, "take pair", onset_difference_v1),
        *("onset of the model - onset of the reference", "this package"),
    ),
    Metric(
        *("peak_ratio_v1", "curves", "1", NONE, "take pair", peak_ratio_v1),
        *("max h of the model / max h of the reference", "this package"),
    ),
    Metric(
        *("speed_ratio_v1", "curves", "1", NONE, "take pair", speed_ratio_v1),
        *("opening_speed_v1 of the model / of the reference", "this package"),
    ),
)
