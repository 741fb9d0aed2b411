"""Parts of a movement (onset, opening, hold, closing): found, carried over to another take, and compared.

Thesis 5.3.2, "Gradient Analysis": regions labelled on an average are found again in a take by the warping path, and
what the lips do inside a region is compared between speakers or levels of stickiness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from lipmetrics.compare.alignment import Alignment
from lipmetrics.compare.curves import CHANNELS, Curve, as_curve
from lipmetrics.errors import InputError

PHASES = ("onset", "opening", "hold", "closing")
REST, PARTED, OPEN = 0.05, 0.2, 0.9  # shares of the range from rest to peak


@dataclass(frozen=True)
class Region:
    """A labelled stretch of time, seconds."""

    label: str
    start_s: float
    end_s: float


def propose_phases(take, *, channel: str = "height", rate_hz: float | None = None) -> tuple[Region, ...]:
    """Onset, opening, hold and closing about the highest peak of one channel.

    With levels as shares of the range from the lowest value to the peak: the onset goes from the last moment at or
    under REST before the peak to the first above PARTED, the opening from there to the first at or above OPEN, the hold
    to the last at or above OPEN without falling to REST between, the closing to the next moment at or under REST (or
    the end).

    Raises
    ------
    InputError : the channel is constant, or the curve cannot be used
    """
    curve = as_curve(take, (channel,), rate_hz)
    values = curve.data[:, 0]
    peak = int(np.argmax(values))
    span = values[peak] - values.min()
    if not span > 0:
        raise InputError(f"{curve.name}: expected {channel} to change, got {values[peak]:g} throughout")
    level = (values - values.min()) / span
    before, after = np.flatnonzero(level[:peak] <= REST), np.flatnonzero(level[peak:] <= REST)
    start = int(before[-1]) if len(before) else 0
    end = peak + int(after[0]) if len(after) else len(values) - 1
    rise = np.flatnonzero(level[start : peak + 1] > PARTED)[0] + start
    top = np.flatnonzero(level[start : end + 1] >= OPEN) + start
    bounds = curve.time_s[[start, rise, top[0], top[-1], end]]
    return tuple(Region(label, float(bounds[at]), float(bounds[at + 1])) for at, label in enumerate(PHASES))


def carry(regions: Sequence[Region], match: Alignment) -> tuple[Region, ...]:
    """Regions of the alignment's a, carried over to its b by the path.

    A boundary that two regions share goes to the middle of the moments matched with it, so that they go on sharing it.
    Other starts go to the last and other ends to the first moment matched, so that a region holds its movement and no
    rest around it.

    Raises
    ------
    InputError : a region that ends before it starts, or lies outside a
    """
    regions = check_regions(regions, match.a)
    starts, ends = {region.start_s for region in regions}, {region.end_s for region in regions}
    carried = []
    for region in regions:
        start = float(match.to_b(region.start_s, "mean" if region.start_s in ends else "last"))
        end = float(match.to_b(region.end_s, "mean" if region.end_s in starts else "first"))
        carried.append(Region(region.label, min(start, end), max(start, end)))
    return tuple(carried)


def gradients(
    take, regions: Sequence[Region], *, channels: Sequence[str] = CHANNELS, rate_hz: float | None = None
) -> pd.DataFrame:
    """How fast each channel changes within each region.

    Columns: region, channel, start_s, duration_s, change (last less first value), mean_slope (least squares line, unit
    per s), peak_slope (the central difference of largest size, signed, unit per s). A region shorter than two samples
    has no slopes (NaN).

    Raises
    ------
    InputError : see `carry`; the curve cannot be used
    """
    curve = as_curve(take, channels, rate_hz)
    regions = check_regions(regions, curve)
    rows = []
    for region in regions:
        inside = (curve.time_s >= region.start_s - 1e-9) & (curve.time_s <= region.end_s + 1e-9)
        for channel, column in zip(curve.channels, curve.data.T, strict=True):
            ends = np.interp([region.start_s, region.end_s], curve.time_s, column)
            mean, peak = _slopes(curve.time_s[inside], column[inside])
            lasts = region.end_s - region.start_s
            rows.append((region.label, channel, region.start_s, lasts, ends[1] - ends[0], mean, peak))
    names = ["region", "channel", "start_s", "duration_s", "change", "mean_slope", "peak_slope"]
    return pd.DataFrame(rows, columns=names)


def compare_gradients(regions: Sequence[Region], match: Alignment) -> pd.DataFrame:
    """`gradients` of an alignment's a in `regions` and of its b in the same regions carried over.

    Columns: region, channel, then start_s, duration_s, change, mean_slope and peak_slope of each with _a and _b, and
    mean_slope_ratio, peak_slope_ratio (b / a; NaN where a has 0).
    """
    a = gradients(match.a, regions, channels=match.a.channels)
    b = gradients(match.b, carry(regions, match), channels=match.b.channels)
    table = (
        a.drop(columns=["region", "channel"])
        .add_suffix("_a")
        .join(b.drop(columns=["region", "channel"]).add_suffix("_b"))
    )
    table.insert(0, "region", a["region"])
    table.insert(1, "channel", a["channel"])
    for slope in ("mean_slope", "peak_slope"):
        table[f"{slope}_ratio"] = table[f"{slope}_b"] / table[f"{slope}_a"].where(table[f"{slope}_a"] != 0)
    return table


def check_regions(regions: Sequence[Region], curve: Curve) -> tuple[Region, ...]:
    """The regions, if each lies in order within the curve's time; InputError otherwise."""
    for region in regions:
        if not region.start_s <= region.end_s:
            raise InputError(
                f"region {region.label!r}: expected start <= end, got {region.start_s} to {region.end_s} s"
            )
        if region.end_s < curve.time_s[0] - 1e-9 or region.start_s > curve.time_s[-1] + 1e-9:
            raise InputError(
                f"region {region.label!r} ({region.start_s:g} to {region.end_s:g} s) lies outside {curve.name}"
                f" ({curve.time_s[0]:g} to {curve.time_s[-1]:g} s)"
            )
    return tuple(regions)


def _slopes(time_s: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    if len(values) < 2:
        return float("nan"), float("nan")
    centred = time_s - time_s.mean()
    slopes = np.gradient(values, time_s)
    return float((centred @ values) / (centred @ centred)), float(slopes[np.argmax(np.abs(slopes))])
