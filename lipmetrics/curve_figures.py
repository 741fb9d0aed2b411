"""Figures of takes set against one another: curves, the path between two, regions carried over, floors and scores.

Every function returns the bytes of a PNG; the same input gives the same bytes.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lipmetrics.compare import Alignment, Average, Region
from lipmetrics.compare.kernels import band_width
from lipmetrics.take import Take

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

REAL = "#8a8f98"
COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
FIRST, SECOND = "#0072b2", "#d55e00"
REGION_COLOURS = {"onset": "#f3e2b8", "opening": "#cfe3f5", "hold": "#d9efd9", "closing": "#eadcf0"}
_UNITS = {"mw": "mouth widths", "model": "units of the mesh", "": ""}
_STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.linewidth": 0.8,
}


@dataclass(frozen=True)
class Group:
    """Takes that are drawn alike."""

    label: str
    takes: Sequence[Take]
    colour: str
    width: float = 1.4


def profiles_png(groups: Sequence[Group], channels: Sequence[str]) -> bytes:
    """Curves of all takes over their own times, a panel per channel, and the number of openings where it is known."""

    def draw(figure: Figure) -> None:
        counted = [[take for take in group.takes if "n_openings" in take.channels] for group in groups]
        rows = len(channels) + any(counted)
        panels = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
        for group in groups:
            for k, take in enumerate(group.takes):
                name = group.label if k == 0 else None
                style = {"color": group.colour, "linewidth": group.width, "label": name}
                style["alpha"] = 1.0 if len(group.takes) < 4 else 0.5
                for panel, channel in zip(panels, channels, strict=False):
                    panel.plot(take.time_s, take.channels[channel], **style)
                if "n_openings" in take.channels and any(counted):
                    panels[-1].step(take.time_s, take.channels["n_openings"], where="mid", **style)
        unit = groups[0].takes[0].unit if groups and groups[0].takes else ""
        for panel, channel in zip(panels, channels, strict=False):
            _name(panel, channel, unit)
        if any(counted):
            panels[-1].set_ylabel("openings")
            panels[-1].yaxis.get_major_locator().set_params(integer=True)
        panels[-1].set_xlabel("time (s)")
        _legend(figure, panels[0])

    return _png(draw, (9, 1.9 * (len(channels) + 1) + 0.5))


def path_png(match: Alignment) -> bytes:
    """The path between two takes with the band that held it, and what it is late by over time."""

    def draw(figure: Figure) -> None:
        square, late = figure.subplots(1, 2, width_ratios=(1, 1.25))
        times = match.times_s
        first, second = match.a.time_s, match.b.time_s
        ends = np.array([[first[0], second[0]], [first[-1], second[-1]]])
        radius = -1 if match.band is None else band_width(len(first), len(second), match.band)
        if radius >= 0:
            i, longer = np.arange(len(first)), len(second) - len(first)
            low, high = i - radius + min(0, longer), i + radius + max(0, longer)
            band = (second[0] + j / match.rate_hz for j in (low, high))
            square.fill_between(first, *band, color="#eef1f5", label="band")
        square.plot(*ends.T, color="#999999", linewidth=0.8, linestyle=(0, (4, 3)), label="same tempo")
        square.plot(*times.T, color="#333333", linewidth=1.6, label="path")
        square.set(xlabel=f"{match.a.name}: time (s)", ylabel=f"{match.b.name}: time (s)")
        square.set_xlim(first[0], max(first[-1], first[0] + 1e-9))
        square.set_ylim(second[0], max(second[-1], second[0] + 1e-9))
        square.legend(frameon=False, loc="upper left", fontsize=8)
        middle = times.mean(axis=1)
        late.axhline(0, color="#999999", linewidth=0.8)
        late.plot(middle, 1000 * (times[:, 1] - times[:, 0]), color="#333333", linewidth=1.4)
        late.axhline(1000 * match.lag_s, color=SECOND, linewidth=1.2, linestyle=(0, (2, 2)))
        late.set(xlabel="time (s)", ylabel=f"{match.b.name} is later by (ms)")
        late.set_title(f"lag {1000 * match.lag_s:+.0f} ms, warp {100 * match.warp:.0f} %", fontsize=9)

    return _png(draw, (9, 3.9))


def aligned_png(match: Alignment) -> bytes:
    """Both takes as they are (left), and the second one brought to the first one's times (right)."""

    def draw(figure: Figure) -> None:
        channels = match.a.channels
        panels = figure.subplots(len(channels), 2, sharex="col", sharey="row", squeeze=False)
        moved = match.b_on_a
        for c, channel in enumerate(channels):
            for panel in panels[c]:
                panel.plot(match.a.time_s, match.a.data[:, c], color=FIRST, linewidth=2.2, label=match.a.name)
            panels[c, 0].plot(match.b.time_s, match.b.data[:, c], color=SECOND, linewidth=1.4, label=match.b.name)
            panels[c, 1].plot(match.a.time_s, moved[:, c], color=SECOND, linewidth=1.4)
            difference = moved[:, c] - match.a.data[:, c]
            panels[c, 1].fill_between(
                match.a.time_s,
                match.a.data[:, c],
                match.a.data[:, c] + difference,
                color=SECOND,
                alpha=0.18,
                linewidth=0,
            )
            _name(panels[c, 0], channel, match.a.unit or match.b.unit)
            _grid(panels[c, 1])
        panels[0, 0].set_title("as they are", fontsize=9)
        panels[0, 1].set_title("after alignment", fontsize=9)
        for panel in panels[-1]:
            panel.set_xlabel("time (s)")
        _legend(figure, panels[0, 0])

    return _png(draw, (9, 1.9 * len(match.a.channels) + 0.8))


def regions_png(match: Alignment, regions: Sequence[Region], carried: Sequence[Region], channel: str) -> bytes:
    """Regions of the first take, and where the path carries them in the second one."""

    def draw(figure: Figure) -> None:
        panels = figure.subplots(2, 1, sharey=True)
        c = match.a.channels.index(channel)
        sides = ((match.a, regions, FIRST), (match.b, carried, SECOND))
        for panel, (curve, parts, colour) in zip(panels, sides, strict=True):
            top = max(match.a.data[:, c].max(), match.b.data[:, c].max()) or 1.0
            for k, region in enumerate(parts):
                shade = REGION_COLOURS.get(region.label, tuple(REGION_COLOURS.values())[k % 4])
                panel.axvspan(region.start_s, region.end_s, color=shade, linewidth=0)
                if region.end_s == region.start_s:
                    continue  # a take that ends open has no closing
                panel.text(
                    (region.start_s + region.end_s) / 2,
                    1.1 * top if k % 2 == 0 else 1.25 * top,
                    region.label,
                    ha="center",
                    va="center",
                    fontsize=8,
                    color="#333333",
                    clip_on=True,
                )
            panel.plot(curve.time_s, curve.data[:, c], color=colour, linewidth=1.8)
            panel.set_ylim(-0.03 * top, 1.38 * top)
            panel.set_xlim(curve.time_s[0], max(curve.time_s[-1], curve.time_s[0] + 1e-9))
            panel.set_title(curve.name, fontsize=9, loc="left")
            _name(panel, channel, curve.unit)
        panels[-1].set_xlabel("time (s)")

    return _png(draw, (9, 4.2))


@dataclass(frozen=True)
class FloorRow:
    """A metric of a floor figure: the floor and the models' scores as ratios to the floor's median.

    floor : (n,) real takes over their median; scores : model -> (value, low, high), over the same
    """

    label: str
    floor: np.ndarray
    scores: dict[str, tuple[float, float, float]]
    note: str = ""


def floors_png(rows: Sequence[FloorRow], models: Sequence[str], axis: str) -> bytes:
    """Each metric's floor as dots and box, the models' scores with their intervals marked in it; logarithmic."""

    def draw(figure: Figure) -> None:
        panel = figure.subplots()
        rng = np.random.default_rng(0)
        values = [v for row in rows for v in (*row.floor, *(s[0] for s in row.scores.values())) if v > 0]
        least = min(values, default=1.0)
        edge = max(least, 1e-2) / 1.3  # what is lower stands at the edge
        for k, row in enumerate(rows):
            y = len(rows) - 1 - k
            floor = np.clip(row.floor[np.isfinite(row.floor)], edge, None)
            panel.axhspan(y - 0.42, y + 0.42, color="#f6f7f9" if k % 2 else "#ffffff", linewidth=0, zorder=0)
            if len(floor):
                q05, q25, q50, q75, q95 = np.quantile(floor, [0.05, 0.25, 0.5, 0.75, 0.95])
                panel.plot([q05, q95], [y, y], color=REAL, linewidth=1.0, zorder=1)
                panel.barh(y, q75 - q25, 0.34, q25, color="#dfe3e8", edgecolor=REAL, linewidth=0.8, zorder=1)
                panel.plot([q50, q50], [y - 0.17, y + 0.17], color="#333333", linewidth=1.4, zorder=2)
                spread = rng.uniform(-0.13, 0.13, len(floor))
                panel.plot(floor, y + spread, ".", color=REAL, markersize=3.5, alpha=0.7, zorder=2)
            for m, model in enumerate(models):
                value, low, high = row.scores.get(model, (math.nan,) * 3)
                if not math.isfinite(value):
                    continue
                at = y + 0.3 * ((m + 0.5) / len(models) - 0.5) * (len(models) > 1)
                colour = COLOURS[m % len(COLOURS)]
                if math.isfinite(low) and math.isfinite(high):
                    panel.plot([max(low, edge), max(high, edge)], [at, at], color=colour, linewidth=1.8, zorder=3)
                below = value < edge
                style = {"markersize": 7, "color": colour, "zorder": 4, "markeredgecolor": "white"}
                panel.plot(max(value, edge), at, "<" if below else "D", **style)
        panel.set_xscale("log")
        panel.set_yticks(range(len(rows)), [row.label for row in reversed(rows)])
        panel.set_ylim(-0.6, len(rows) - 0.4)
        panel.axvline(1, color="#333333", linewidth=0.6, linestyle=(0, (2, 3)), zorder=1)
        panel.set_xlabel(axis)
        panel.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
        panel.tick_params(axis="y", length=0)
        for m, model in enumerate(models):
            panel.plot([], [], "D", color=COLOURS[m % len(COLOURS)], label=model)
        panel.plot([], [], ".", color=REAL, label="real takes among themselves")
        _legend(figure, panel)

    return _png(draw, (9, 0.36 * len(rows) + 1.4))


def average_png(made: Average, takes: Sequence[Take] = ()) -> bytes:
    """An average with its spread (one standard deviation), over the takes that it was made of."""

    def draw(figure: Figure) -> None:
        panels = figure.subplots(len(made.channels), 1, sharex=True, squeeze=False)[:, 0]
        for c, (panel, channel) in enumerate(zip(panels, made.channels, strict=True)):
            for k, take in enumerate(takes):
                name = f"{len(takes)} takes" if k == 0 else None
                style = {"color": REAL, "linewidth": 0.8, "alpha": 0.6, "label": name}
                panel.plot(take.time_s - take.time_s[0], take.channels[channel], **style)
            mean, spread = made.mean[:, c], made.spread[:, c]
            if np.isfinite(spread).all():
                low = np.maximum(mean - spread, 0)
                label = "± 1 standard deviation"
                panel.fill_between(made.time_s, low, mean + spread, color=FIRST, alpha=0.2, linewidth=0, label=label)
            panel.plot(made.time_s, mean, color=FIRST, linewidth=2, label="average")
            _name(panel, channel, made.unit)
        panels[-1].set_xlabel("time from the start of each take (s)")
        _legend(figure, panels[0])

    return _png(draw, (9, 2.0 * len(made.channels) + 0.6))


def _png(draw, size: tuple[float, float]) -> bytes:
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=size, dpi=110, layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure)
        target = io.BytesIO()
        figure.savefig(target, format="png", metadata={"Software": None})
    return target.getvalue()


def _name(panel: Axes, channel: str, unit: str) -> None:
    unit = _UNITS.get(unit, unit) + ("²" if channel == "area" else "")
    panel.set_ylabel(f"{channel}\n({unit})" if unit.strip("²") else channel)
    _grid(panel)


def _grid(panel: Axes) -> None:
    panel.grid(axis="y", color="#000000", alpha=0.08, linewidth=0.6)


def _legend(figure: Figure, panel: Axes) -> None:
    handles, labels = panel.get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside upper center", ncols=min(len(labels), 5), frameon=False)
