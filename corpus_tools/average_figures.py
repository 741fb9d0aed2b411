"""Figures of averages: levels of stickiness over one another, and speakers side by side.

In the manner of Leach's thesis: figures 5.43 to 5.48 (area, width and height of one action by level) and 5.35 and 5.36
(one action of several speakers, a column each). Every function returns the bytes of a PNG; the same input gives the
same bytes.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from lipmetrics.compare import Average
from lipmetrics.take import Take

PANELS = ("area", "width", "height")
UNITS = {"area": "mouth widths²", "width": "mouth widths", "height": "mouth widths"}
GREY = "#8a8f98"
_STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.linewidth": 0.8,
}


def levels_png(curves: Mapping[str, tuple[Average, np.ndarray]], title: str) -> bytes:
    """Area, width and height of some levels over time, with one standard deviation as a band.

    Parameters
    ----------
    curves : (average, its spread (T, 3)) by what the legend says, in order
    """

    def draw(figure) -> None:
        panels = figure.subplots(1, 3)
        colours = level_colours(len(curves))
        for k, (panel, channel) in enumerate(zip(panels, PANELS, strict=True)):
            for colour, (label, (made, spread)) in zip(colours, curves.items(), strict=True):
                c = made.channels.index(channel)
                mean, around = made.mean[:, c], spread[:, c]
                if np.isfinite(around).all():
                    low = np.maximum(mean - around, 0)
                    panel.fill_between(made.time_s, low, mean + around, color=colour, alpha=0.15, linewidth=0)
                panel.plot(made.time_s, mean, color=colour, linewidth=1.8, label=label)
            panel.set_title(f"({'abc'[k]}) {channel}", fontsize=9)
            panel.set(xlabel="time (s)", ylabel=UNITS[channel])
            panel.set_ylim(bottom=0)
            _grid(panel)
        _legend(figure, panels[0], title)

    return _png(draw, (12, 3.5))


def speakers_png(
    speakers: Mapping[str, Mapping[str, tuple[Average, Sequence[Take]]]], labels: Sequence[str], title: str
) -> bytes:
    """Area, width and height in rows, a column per speaker; averages over this speaker's clips, which are thin.

    Parameters
    ----------
    speakers : speaker -> level -> (average, the clips)
    labels : all levels in order, so that a level has one colour everywhere
    """

    def draw(figure) -> None:
        panels = figure.subplots(3, len(speakers), sharex=True, sharey="row", squeeze=False)
        colours = dict(zip(labels, level_colours(len(labels)), strict=True))
        for column, (who, by_level) in enumerate(speakers.items()):
            for row, channel in enumerate(PANELS):
                panel = panels[row, column]
                for label, (made, takes) in by_level.items():
                    for take in takes if len(takes) > 1 else ():
                        time_s = take.time_s - take.time_s[0]
                        panel.plot(time_s, take.channels[channel], color=colours[label], linewidth=0.6, alpha=0.35)
                    c = made.channels.index(channel)
                    panel.plot(made.time_s, made.mean[:, c], color=colours[label], linewidth=1.6, label=label)
                _grid(panel)
                if column == 0:
                    panel.set_ylabel(f"{channel}\n({UNITS[channel]})")
            panels[0, column].set_title(who, fontsize=9)
            panels[-1, column].set_xlabel("time (s)")
        for panel in panels[:, 0]:
            panel.set_ylim(bottom=0)  # now that all is in it
        found: dict[str, object] = {}
        for panel in panels[0]:
            found |= dict(zip(*reversed(panel.get_legend_handles_labels()), strict=True))
        shown = [label for label in labels if label in found]
        _legend(figure, None, title, [found[label] for label in shown], shown)

    return _png(draw, (max(5.0, 2.6 * len(speakers) + 0.8), 6.2))


def level_colours(count: int) -> list[str]:
    """From light for the lowest level to dark for the highest; one colour where there is one."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    if count == 1:
        return ["#0072b2"]
    return [to_hex(colormaps["plasma_r"](0.12 + 0.8 * k / (count - 1))) for k in range(count)]


def _legend(figure, panel, title: str, handles=None, labels=None) -> None:
    if handles is None:
        handles, labels = panel.get_legend_handles_labels()
    if any(labels):
        figure.legend(handles, labels, loc="upper right", ncols=min(len(labels), 6), frameon=False)
    figure.text(0.01, 1 - 0.22 / figure.get_figheight(), title, fontsize=10)


def _grid(panel) -> None:
    panel.grid(axis="y", color="#000000", alpha=0.08, linewidth=0.6)


def _png(draw: Callable, size: tuple[float, float]) -> bytes:
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=size, dpi=100)
        FigureCanvasAgg(figure)
        width, height = size  # margins in inches; working them out takes longer than to draw
        figure.subplots_adjust(0.75 / width, 0.5 / height, 1 - 0.15 / width, 1 - 0.65 / height, 0.22, 0.12)
        draw(figure)
        target = io.BytesIO()
        figure.savefig(target, format="png", metadata={"Software": None})
    return target.getvalue()
