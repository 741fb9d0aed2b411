"""The figure of a profile: width, height, area and number of openings over time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lipmetrics import draw
from lipmetrics.atomic import whole_file
from lipmetrics.errors import InputError
from lipmetrics.look import CLOSED, NO_MOUTH
from lipmetrics.profile import Profile

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Formats whose files hold no date, so that the same profile gives the same bytes.
_NO_DATE = {".png": {"Software": None}, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
_COLOURS = {"width": "#0072b2", "height": "#d55e00", "area": "#009e73", "openings": "#333333"}
_SPANS = {CLOSED: ("closed", {"color": "#e3e7ec"}), NO_MOUTH: ("no mouth found", {"color": "#f6d5d0"})}
_TOTAL_LINE = {"linewidth": 0.8, "linestyle": (0, (4, 2))}
_STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.linewidth": 0.8,
    "xtick.color": "#333333",
    "ytick.color": "#333333",
    "svg.hashsalt": "lipmetrics",
    "pdf.fonttype": 42,
}


def plot_profile(profile: Profile, path: str | Path) -> None:
    """Draw the largest opening's width, height and area, and the number of openings, over the frames' true times.

    Lengths are in mouth widths; the title says how many px that is. Spans where the mouth is closed or was not found
    are shaded. Where several openings were seen at once, the area of all of them together is drawn as a thin line.

    Parameters
    ----------
    path : .png, .pdf or .svg; it appears whole or not at all, and the same profile gives the same bytes

    Raises
    ------
    InputError : another kind of file, or a place that cannot be written to
    """
    path = Path(path)
    if path.suffix.lower() not in _NO_DATE:
        raise InputError(f"expected a figure named .png, .pdf or .svg, got {path.name!r}; choose one of these")
    # matplotlib takes longer to import than a clip to measure, so only who asks for a figure waits for it
    import matplotlib as mpl

    with mpl.rc_context(_STYLE), whole_file(path) as part:
        kind = path.suffix.lower()
        draw_figure(profile).savefig(part, format=kind[1:], metadata=_NO_DATE[kind])


def draw_figure(profile: Profile) -> Figure:
    """The figure that `plot_profile` writes: panels of width, height, area and number of openings."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 6.6), dpi=150, layout="constrained")
    _draw_panels(figure.subplots(4, 1, sharex=True, height_ratios=(3, 3, 3, 1.4)), profile)
    figure.align_ylabels()
    figure.suptitle(_title(profile), fontsize=10)
    _add_legend(figure, profile)
    return figure


def _draw_panels(axes: np.ndarray, profile: Profile) -> None:
    rows = profile.frames
    time_s = rows["time_s"].to_numpy(float)
    edges_s = frame_edges(time_s)
    spans = status_spans(rows["status"].to_numpy(), edges_s)
    mouth_width = draw.mouth_width_px(profile)
    # without a mouth width the lengths in px are all there is
    unit, of_width = ("mouth widths", mouth_width) if np.isfinite(mouth_width) else ("px", 1.0)
    width, height, area, openings = axes

    for panel in axes:
        for status, start_s, stop_s in spans:
            panel.axvspan(start_s, stop_s, linewidth=0, zorder=0, **_SPANS[status][1])
        if len(time_s):
            panel.set_xlim(edges_s[0], edges_s[-1])
    _draw_line(width, time_s, rows["width_px"].to_numpy(float) / of_width, _COLOURS["width"], f"width\n({unit})")
    _draw_line(height, time_s, rows["height_px"].to_numpy(float) / of_width, _COLOURS["height"], f"height\n({unit})")
    if (rows["n_openings"] > 1).any():
        total = rows["total_area_px"].to_numpy(float) / of_width**2
        area.plot(time_s, total, color=_COLOURS["area"], **_TOTAL_LINE)
    _draw_line(area, time_s, rows["area_px"].to_numpy(float) / of_width**2, _COLOURS["area"], f"area\n({unit}²)")
    count = rows["n_openings"].astype(float).to_numpy()
    top = np.nanmax(count, initial=1.0)
    openings.stairs(count, edges_s, baseline=None, color=_COLOURS["openings"], linewidth=1.2)
    openings.set(ylim=(-0.3, top + 0.3), yticks=np.arange(0, top + 1, max(1, top // 3)), ylabel="openings")
    openings.set_xlabel("time (s)")


def _draw_line(panel: Axes, time_s: np.ndarray, values: np.ndarray, colour: str, label: str) -> None:
    panel.plot(time_s, values, color=colour, linewidth=1.2)
    alone = _alone(values)
    panel.plot(time_s[alone], values[alone], ".", color=colour, markersize=4)
    drawn = np.concatenate([line.get_ydata() for line in panel.lines])
    top = np.nanmax(drawn, initial=0.0) or 1.0
    panel.set(ylim=(-0.03 * top, 1.08 * top), ylabel=label)
    panel.grid(axis="y", color="#000000", alpha=0.08, linewidth=0.6)


def _add_legend(figure: Figure, profile: Profile) -> None:
    """Name the shadings and the second area line, those that occur."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    seen = set(profile.frames["status"])
    entries = [Patch(label=label, **look) for status, (label, look) in _SPANS.items() if status in seen]
    if (profile.frames["n_openings"] > 1).any():
        entries.append(Line2D([], [], color=_COLOURS["area"], label="area of all openings", **_TOTAL_LINE))
    if entries:
        figure.legend(handles=entries, loc="outside lower center", ncols=len(entries), frameon=False)


def frame_edges(time_s: np.ndarray) -> np.ndarray:
    """Edges (n + 1,) in s of the time each of n frames stands for: half-way between neighbours' times (n,)."""
    if len(time_s) == 0:
        return np.zeros(1)
    middles = (time_s[1:] + time_s[:-1]) / 2
    # a single frame stands for a second, so that there is something to see
    half_first, half_last = (middles[0] - time_s[0], time_s[-1] - middles[-1]) if len(middles) else (0.5, 0.5)
    return np.concatenate([[time_s[0] - half_first], middles, [time_s[-1] + half_last]])


def status_spans(status: np.ndarray, edges_s: np.ndarray) -> list[tuple[str, float, float]]:
    """Runs of frames that are closed or have no mouth, as (status, start in s, stop in s)."""
    changes = np.flatnonzero(status[1:] != status[:-1]) + 1
    starts = np.append(0, changes)[: len(status)]
    stops = np.append(changes, len(status))[: len(starts)]
    runs = zip(starts, stops, strict=True)
    return [(status[i], float(edges_s[i]), float(edges_s[j])) for i, j in runs if status[i] in _SPANS]


def _alone(values: np.ndarray) -> np.ndarray:
    """(n,) bool: known values between unknown ones, which a line leaves out."""
    known = np.isfinite(values)
    return known & ~np.append(False, known[:-1]) & ~np.append(known[1:], False)


def _title(profile: Profile) -> str:
    width = draw.mouth_width_px(profile)
    known = f"mouth width {width:.1f} px" if np.isfinite(width) else "mouth width unknown"
    return f"{profile.meta.get('file', '')}   ({len(profile.frames)} frames, {known})"
