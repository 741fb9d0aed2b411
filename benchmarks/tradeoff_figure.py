"""The drawing of run time against error: one panel for each kind of error, every point labelled, defaults in red."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

CHOSEN = "#d62728"
COLOURS = ("#333333", "#1f77b4", "#2ca02c", "#b8860b", "#9467bd")
TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
LABEL_PX = 2.0  # kept free around labels
# of a label's middle from its point, in half sizes of the label and then px outward; the first are preferred
PLACES = [
    (np.array(side, float), away)
    for away in (7, 16, 28, 42, 60)
    for side in ((1, 0.6), (1, -0.6), (-1, 0.6), (-1, -0.6), (0, 1), (0, -1), (1, 0), (-1, 0))
]


@dataclass(frozen=True)
class Point:
    """label : said beside it; time : relative, the default's is 1; error : as its panel has it; chosen : the default;
    family : points of one family have one colour, and a line through them where the panel joins them"""

    label: str
    time: float
    error: float
    chosen: bool = False
    family: str = ""


@dataclass(frozen=True)
class Panel:
    """title, error : what is above it and beside its axis; log : errors on a logarithmic axis, from `least` up, which
    stands for all that are smaller; joined : a line through each family, in the order given"""

    title: str
    error: str
    points: Sequence[Point]
    log: bool = False
    least: float = 0.0
    joined: bool = False


def draw(panels: Sequence[Panel], path: Path, title: str, time: str) -> None:
    """One figure with the panels side by side; `time` is said below each."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.2 * len(panels), 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    families = list(dict.fromkeys(point.family for panel in panels for point in panel.points))
    colours = dict(zip(families, itertools.cycle(COLOURS)))
    everything = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, panel in zip(everything, panels, strict=True):
        _points(axes, panel, colours)
        axes.set_xlabel(time)
    named = [family for family in families if family]
    if len(named) > 1:
        handles = [everything[0].plot([], [], "o", color=colours[name], label=name)[0] for name in named]
        handles.append(everything[0].plot([], [], "o", color=CHOSEN, markersize=9, label="default settings")[0])
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9)
    figure.draw_without_rendering()  # places of the axes, which the labels need
    for axes, panel in zip(everything, panels, strict=True):
        _labels(axes, panel, colours)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.set_layout_engine("none")
    figure.savefig(path, dpi=100, metadata={"Software": None})


def _shown(panel: Panel, error: float) -> float:
    return max(error, panel.least) if panel.log else error


def _points(axes, panel: Panel, colours: dict[str, str]) -> None:
    for family in colours:
        of_family = [point for point in panel.points if point.family == family]
        if panel.joined:
            places = [(point.time, _shown(panel, point.error)) for point in of_family]
            axes.plot(*zip(*places, strict=True) if places else ([], []), color=colours[family], lw=0.8, alpha=0.6)
        for point in of_family:
            colour, size = (CHOSEN, 9) if point.chosen else (colours[family], 5)
            order = 4 if point.chosen else 3
            axes.plot(point.time, _shown(panel, point.error), "o", color=colour, markersize=size, zorder=order)
    axes.set_xscale("log")
    times = [point.time for point in panel.points]
    low, high = min(times) / 1.6, max(times) * 1.9
    axes.set_xlim(low, high)
    ticks = [tick for tick in TICKS if low < tick < high]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    errors = [_shown(panel, point.error) for point in panel.points]
    if panel.log:
        axes.set_yscale("log")
        axes.set_ylim(min(errors) / 2, max(errors) * 2)
        decades = 10.0 ** np.arange(np.floor(np.log10(min(errors))), np.ceil(np.log10(max(errors))) + 1)
        kept = [tick for tick in decades if min(errors) / 2 <= tick <= max(errors) * 2]
        names = [f"up to {t:g}" if panel.least and abs(t / panel.least - 1) < 1e-6 else f"{t:g}" for t in kept]
        axes.set_yticks(kept, names)
        axes.minorticks_off()
    else:
        room = 0.12 * (max(errors) - min(errors) or 1.0)
        axes.set_ylim(max(0.0, min(errors) - room) if min(errors) >= 0 else min(errors) - room, max(errors) + room)
    axes.axvline(1, color="lightgrey", lw=0.8, zorder=0)
    axes.set_title(panel.title, fontsize=10)
    axes.set_ylabel(panel.error)
    axes.spines[["top", "right"]].set_visible(False)


def _labels(axes, panel: Panel, colours: dict[str, str]) -> None:
    """Beside each point its label, where neither a point nor another label is; the default's first."""
    at = np.array([axes.transData.transform((p.time, _shown(panel, p.error))) for p in panel.points])
    box = axes.get_window_extent()
    inside = np.array([[box.x0, box.y0], [box.x1, box.y1]])
    taken: list[np.ndarray] = []
    for number in sorted(range(len(panel.points)), key=lambda k: not panel.points[k].chosen):
        point = panel.points[number]
        colour = CHOSEN if point.chosen else colours[point.family]
        text = axes.text(0, 0, point.label, fontsize=8, color=colour, ha="center", va="center", transform=None)
        extent = text.get_window_extent()
        half = np.array([extent.width, extent.height]) / 2
        middle = place(at[number], half, at, taken, inside)
        taken.append(np.array([middle - half, middle + half]))
        text.set_transform(axes.transData)
        text.set_position(axes.transData.inverted().transform(middle))
        if np.abs(middle - at[number] - np.sign(middle - at[number]) * half).max() > 14:
            end = np.clip(at[number], middle - half, middle + half)
            (x0, y0), (x1, y1) = axes.transData.inverted().transform(np.array([at[number], end]))
            axes.plot([x0, x1], [y0, y1], color="grey", lw=0.5, zorder=1)


def place(
    at: np.ndarray, half: np.ndarray, points: np.ndarray, taken: Sequence[np.ndarray], inside: np.ndarray
) -> np.ndarray:
    """Where the middle of a label goes: of the places around its point the first that covers least.

    Parameters
    ----------
    at : (2,) its point, px
    half : (2,) half its width and height, px
    points : (N, 2) all points
    taken : (2, 2) lower left and upper right corner of each label that is there
    inside : (2, 2) the same of the panel
    """

    def covered(middle: np.ndarray) -> float:
        low, high = middle - half - LABEL_PX, middle + half + LABEL_PX
        points_in = np.sum(((points > low - 4) & (points < high + 4)).all(axis=1))
        labels_in = sum(bool((low < other[1]).all() and (high > other[0]).all()) for other in taken)
        return points_in + labels_in + 3 * bool((low < inside[0]).any() or (high > inside[1]).any())

    middles = [at + side * half + away * side / np.linalg.norm(side) for side, away in PLACES]
    return min(middles, key=covered)  # the first of equals
