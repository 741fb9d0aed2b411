"""Figures of the truth: profiles of several scenes over time, and the saliva's states along the lips."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simulator.atomic import whole_file
from simulator.errors import InputError
from simulator.truth import STATES, Truth

# Formats whose files hold no date, so that the same truth gives the same bytes.
_NO_DATE = {".png": {"Software": None}, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
_STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.linewidth": 0.8,
    "xtick.color": "#333333",
    "ytick.color": "#333333",
    "svg.hashsalt": "simulator",
    "pdf.fonttype": 42,
}
_PANELS = (
    ("area_mw2", "area (mouth widths²)"),
    ("width_mw", "width (mouth widths)"),
    ("height_mw", "height (mouth widths)"),
)
# from wet to dry, told apart in grey too; the dashes tell apart lines that lie on one another
_COLOURS = ("#35a7c4", "#3465a4", "#7b3294", "#c51b5b", "#e08214", "#7f7f00", "#333333", "#8c510a")
_DASHES = ("-", (0, (6, 1.5)), (0, (3, 1.5)), (0, (1, 1)))
_STATE_COLOURS = ("#b7d7e8", "#2b2b33", "#e08214")


def plot_truth(truths: dict[str, Truth], path: str | Path, title: str = "") -> None:
    """Area, width and height of the largest opening over time, one line per truth, as in thesis figures 5.43 to 5.48.

    Parameters
    ----------
    truths : label -> truth, in the order of the legend; sizes are in mouth widths
    path : .png, .pdf or .svg; it appears whole or not at all

    Raises
    ------
    InputError : no truth, another kind of file, or a place that cannot be written to
    """
    if not truths:
        raise InputError("expected one truth or more to draw, got none")

    def draw(figure):
        axes = figure.subplots(1, len(_PANELS), sharex=True)
        for panel, (column, label) in zip(axes, _PANELS, strict=True):
            for k, (name, truth) in enumerate(truths.items()):
                panel.plot(
                    truth.frames["time_s"].to_numpy(),
                    truth.frames[column].to_numpy(),
                    color=_COLOURS[k % len(_COLOURS)],
                    linestyle=_DASHES[k % len(_DASHES)],
                    linewidth=1.4,
                    label=str(name),
                )
            panel.set(xlabel="time (s)", title=label)
            panel.set_ylim(bottom=0)
            panel.margins(x=0)
            panel.grid(color="#000000", alpha=0.08, linewidth=0.6)
        figure.legend(
            *axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=min(len(truths), 6), frameon=False
        )

    _write(draw, path, (9.6, 3.2), title)


def plot_saliva(truth: Truth, path: str | Path, title: str = "") -> None:
    """States of the saliva over time and place along the lips.

    Parameters
    ----------
    truth : of two frames or more
    path : .png, .pdf or .svg; it appears whole or not at all

    Raises
    ------
    InputError : fewer frames, another kind of file, or a place that cannot be written to
    """
    time_s = truth.frames["time_s"].to_numpy()
    if len(time_s) < 2:
        raise InputError(f"expected two frames or more to draw, got {len(time_s)}")
    number = {name: k for k, name in enumerate(STATES)}
    state = truth.saliva["state"].map(number).to_numpy().reshape(len(time_s), -1).T
    x_mm = 1000 * truth.saliva["x_m"].to_numpy()[: len(state)]

    def draw(figure):
        from matplotlib.colors import ListedColormap
        from matplotlib.patches import Patch

        panel = figure.subplots()
        colours = ListedColormap(_STATE_COLOURS)
        panel.pcolormesh(_edges(time_s), _edges(x_mm), state, cmap=colours, vmin=-0.5, vmax=2.5, rasterized=True)
        panel.set(xlabel="time (s)", ylabel="along the lips at rest (mm)")
        seen = [k for k in range(len(STATES)) if (state == k).any()]
        handles = [Patch(color=_STATE_COLOURS[k], label=STATES[k]) for k in seen]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)

    _write(draw, path, (6.4, 3.6), title)


def _edges(middles: np.ndarray) -> np.ndarray:
    """Edges (n + 1,) half-way between middles (n,), the outer two as far out as the next ones are in."""
    if len(middles) < 2:
        return np.array([middles[0] - 0.5, middles[0] + 0.5])
    between = (middles[1:] + middles[:-1]) / 2
    return np.concatenate([[2 * middles[0] - between[0]], between, [2 * middles[-1] - between[-1]]])


def _write(draw, path: str | Path, size: tuple[float, float], title: str) -> None:
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in _NO_DATE:
        raise InputError(f"expected a figure named .png, .pdf or .svg, got {path.name!r}; choose one of these")
    # matplotlib takes long to import, so only who asks for a figure waits for it
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE), whole_file(path) as part:
        figure = Figure(figsize=size, dpi=150, layout="constrained")
        draw(figure)
        if title:
            figure.suptitle(title, fontsize=10)
        figure.savefig(part, format=kind[1:], metadata=_NO_DATE[kind])
