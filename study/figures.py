"""Figures of a study: bar charts of how often each level was chosen, as thesis figures 5.2 to 5.20 have them but with
intervals, and rows of estimates with their intervals.

Whiskers of the bars are exact (Clopper and Pearson) and take every answer for an independent one, as the thesis does;
they are too short where a participant's answers hang together. Rows of estimates have intervals that allow for that.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.atomic import whole_file
from study.binomial import clopper_pearson, p_two_sided
from study.printed import counted, level_names, number, p_text
from study.responses import Answers

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 130
MOST_PAIRS_N = 15  # more pairs of levels than this are no longer readable as bar charts
_LEAST, _EFFECT, _INK, _QUIET = "#8a8f98", "#0b6fb8", "#222222", "#6b7280"
_RAMP = ("#8fc1e8", "#08457e")  # levels above the least, from weak to strong
_COLUMNS_N = 3
_STYLE = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same letters everywhere
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#9ca3af",
    "axes.linewidth": 0.8,
    "xtick.color": _INK,
    "ytick.color": _INK,
    "xtick.major.size": 0,
    "svg.hashsalt": "lipmetrics",
}


@dataclasses.dataclass(frozen=True)
class Bar:
    """One bar: how often something was chosen of the times it was shown."""

    label: str
    chosen_n: int
    shown_n: int
    colour: str


@dataclasses.dataclass(frozen=True)
class Panel:
    """Bars side by side under a title; `note` stands beneath the title."""

    title: str
    bars: tuple[Bar, ...]
    note: str = ""


@dataclasses.dataclass(frozen=True)
class Chart:
    """What a bar chart shows.

    Parameters
    ----------
    name : of its file, without ending
    title : above it
    kind : "grouped" (all levels above the least against the least), "pairs" (every pair of levels) or "levels" (each
        level against all others)
    parts : title and conditions (of `Answers.where`) of each part
    """

    name: str
    title: str
    kind: str
    parts: tuple[tuple[str, dict], ...]


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A row of `draw_estimates`: a value with its interval; `group` starts a new block when it changes."""

    label: str
    value: float
    low: float
    high: float
    text: str = ""
    group: str = ""
    strong: bool = False


def _thesis_charts() -> tuple[Chart, ...]:
    def chart(number: int, title: str, kind: str, *parts: tuple[str, dict]) -> Chart:
        return Chart(f"figure_5_{number:02d}", f"Figure 5.{number}: {title}", kind, parts)

    def one(action: str, audio: int = 0) -> tuple[str, dict]:
        return "", {"action": action, "audio": audio}

    def both(action: str) -> tuple[tuple[str, dict], ...]:
        return tuple((name, {"action": action, "audio": audio}) for audio, name in ((0, "no audio"), (1, "audio")))

    none, pairs, shift = "no stickiness or sticky", "every pair of levels", "how often each level was chosen"
    return (
        chart(2, f"all trials, {none}", "grouped", ("", {})),
        chart(3, f"all actions and participants, {pairs}", "pairs", ("", {})),
        chart(4, f"slow mouth opening, {none}", "grouped", one("open_slow")),
        chart(5, f"slow mouth opening, {pairs}", "pairs", one("open_slow")),
        chart(6, f"'m' without audio, {none}", "grouped", one("m")),
        chart(7, f"'m' without audio, {pairs}", "pairs", one("m")),
        chart(8, f"fast mouth opening, {none}", "grouped", one("open_fast")),
        chart(9, f"fast mouth opening, {pairs}", "pairs", one("open_fast")),
        chart(10, f"'p' without audio, {none}", "grouped", one("p")),
        chart(11, f"'p' without audio, {pairs}", "pairs", one("p")),
        chart(12, f"'puppy' without audio, {none}", "grouped", one("puppy")),
        chart(13, f"'puppy' without audio, {pairs}", "pairs", one("puppy")),
        chart(14, f"'m', {none}", "grouped", *both("m")),
        chart(15, f"'m', {shift}", "levels", *both("m")),
        chart(16, f"'p', {none}", "grouped", *both("p")),
        chart(17, f"'p' with audio, {pairs}", "pairs", one("p", 1)),
        chart(18, f"'mummy', {none}", "grouped", *both("mummy")),
        chart(19, f"'puppy', {none}", "grouped", *both("puppy")),
        chart(20, f"'puppy', {shift}", "levels", *both("puppy")),
    )


THESIS_CHARTS = _thesis_charts()


def charts_of(answers: Answers) -> tuple[Chart, ...]:
    """Charts that suit any answers: all trials together, and each action (and audio) by itself."""
    grouped = f"{level_names(answers.sticky()[0])} or {level_names(answers.sticky()[1])}"
    found = [Chart("all", f"All trials: {grouped}", "grouped", (("", {}),))]
    levels_n = len(answers.levels)
    pairs = 1 < levels_n * (levels_n - 1) // 2 <= MOST_PAIRS_N
    if pairs:
        found.append(Chart("all_pairs", "All trials: every pair of levels", "pairs", (("", {}),)))
    table = answers.tests.table
    cells = table[["action", "audio"]].drop_duplicates()
    if len(cells) > 1:
        parts = []
        for action in answers.actions:
            for audio in sorted(cells.loc[cells["action"] == action, "audio"]):
                parts.append((cell_name(action, audio, table), {"action": action, "audio": audio}))
        found.append(Chart("by_action", f"Each action: {grouped}", "grouped", tuple(parts)))
        if levels_n > 2:
            found.append(
                Chart("by_action_levels", "Each action: how often each level was chosen", "levels", tuple(parts))
            )
    return tuple(found)


def cell_name(action: str, audio: int, table) -> str:
    """Name of an action with or without audio, as figures and tables give it; audio is left out if it never varies."""
    name = action.replace("_", " ") or "all"
    return name if table["audio"].nunique() < 2 else f"{name}, {'audio' if audio else 'no audio'}"


def draw_chart(chart: Chart, answers: Answers) -> Figure:
    """The bar chart of some answers; parts without answers are left out."""
    panels = [
        panel for title, where in chart.parts for panel in _panels(chart.kind, title, answers.tests.where(**where))
    ]
    return draw_panels([panel for panel in panels if panel.bars[0].shown_n], chart.title)


def _panels(kind: str, title: str, answers: Answers) -> list[Panel]:
    levels = answers.levels
    colour = dict(zip(levels, level_colours(len(levels)), strict=True))
    if kind == "levels":
        return [Panel(title, tuple(_level_bar(answers, level, colour[level]) for level in levels))]
    if kind == "grouped":
        more, least = answers.sticky()
        return [_two_bars(title, answers, least, more, (_LEAST, _EFFECT))]
    letters = (f"({letter}) " for letter in "abcdefghijklmno")
    return [
        _two_bars(title or next(letters), answers, [a], [b], (colour[a], colour[b]))
        for a, b in itertools.combinations(levels, 2)
    ]


def _two_bars(title: str, answers: Answers, a: list, b: list, colours: tuple[str, str]) -> Panel:
    seen = answers.preference(b, a)
    bars = (Bar(level_names(a), seen.for_b, seen.n, colours[0]), Bar(level_names(b), seen.for_a, seen.n, colours[1]))
    note = f"ratio {number(seen.ratio)}, p = {p_text(p_two_sided(seen.for_a, seen.n))}" if seen.n else "no answers"
    ties = f", {counted(seen.ties, 'tie')}" if seen.ties else ""
    return Panel(title, bars, note + ties)


def _level_bar(answers: Answers, level, colour: str) -> Bar:
    seen = answers.preference([level], [other for other in answers.levels if other != level])
    return Bar(level_names([level]), seen.for_a, seen.n, colour)


def draw_panels(panels: Sequence[Panel], title: str) -> Figure:
    """Panels of bars in rows of three, on one scale; a dotted line stands where chance would have each bar."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    most_bars = max(len(panel.bars) for panel in panels)
    columns = _columns(len(panels), most_bars)
    rows = -(-len(panels) // columns)
    # margins in inches instead of a layout engine, which takes several times as long as the drawing
    one, left, right, gap = max(1.95, 0.62 * most_bars + 0.6), 0.62, 0.12, 0.14
    one = max(one, (4.4 - left - right + gap) / columns - gap)
    width = left + right + columns * one + (columns - 1) * gap
    note = "whiskers: exact 95 % intervals; dotted: chance"
    if any("p " in panel.note for panel in panels):
        note += "; p: exact, two-sided; both as if answers were independent"
    note = _wrapped(note, width)
    lines = max(len(_title_lines(panel)) for panel in panels)
    tall, top, bottom, between = (
        1.75 if rows > 1 else 2.2,
        0.42 + 0.16 * lines,
        0.5 + 0.13 * note.count("\n"),
        0.36 + 0.16 * lines,
    )
    height = top + bottom + rows * tall + (rows - 1) * between
    with rc_context(_STYLE):
        figure = Figure(figsize=(width, height), dpi=DPI)
        grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
        figure.subplots_adjust(
            left / width, bottom / height, 1 - right / width, 1 - top / height, gap / one, between / tall
        )
        for axes, panel in itertools.zip_longest(grid.ravel(), panels):
            if panel is None:
                axes.set_visible(False)
            else:
                _draw_bars(axes, panel)
        for axes in grid[:, 0]:
            axes.set_ylabel("answers")
        most = max(clopper_pearson(bar.chosen_n, bar.shown_n)[1] * bar.shown_n for p in panels for bar in p.bars)
        grid[0, 0].set_ylim(0, 1.24 * most)
        figure.text(0.5, 1 - 0.07 / height, title, ha="center", va="top", fontsize=10.5, color=_INK)
        figure.text(0.5, 0.06 / height, note, ha="center", va="bottom", fontsize=7.5, color=_QUIET)
        return figure


def _columns(panels_n: int, bars_n: int) -> int:
    if panels_n <= _COLUMNS_N:
        return panels_n
    if bars_n > 2 or panels_n % _COLUMNS_N == 0:
        return 2 if panels_n == 4 or bars_n > 4 else _COLUMNS_N
    return next((n for n in (4, 5) if panels_n % n == 0), 4)


def _title_lines(panel: Panel) -> list[str]:
    return [part for part in (panel.title.strip(), panel.note) if part]


def _draw_bars(axes: Axes, panel: Panel) -> None:
    for at, bar in enumerate(panel.bars):
        low, high = (share * bar.shown_n for share in clopper_pearson(bar.chosen_n, bar.shown_n))
        axes.bar(at, bar.chosen_n, width=0.66, color=bar.colour)
        error = [[bar.chosen_n - low], [high - bar.chosen_n]]
        axes.errorbar(at, bar.chosen_n, error, fmt="none", ecolor=_INK, elinewidth=1.1, capsize=4)
        axes.hlines(bar.shown_n / 2, at - 0.42, at + 0.42, colors=_INK, linestyles=":", linewidth=1, zorder=2.5)
        share = f"{100 * bar.chosen_n / bar.shown_n:.0f} %" if bar.shown_n else ""
        axes.annotate(
            f"{bar.chosen_n}\n{share}",
            (at, high),
            (0, 2),
            textcoords="offset points",
            ha="center",
            va="bottom",
            fontsize=8,
            color=_INK,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
        )
    axes.set_xticks(range(len(panel.bars)), [bar.label for bar in panel.bars])
    axes.set_xlim(-0.6, len(panel.bars) - 0.4)
    axes.set_title("\n".join(_title_lines(panel)), color=_INK)


def draw_estimates(
    rows: Sequence[Estimate], title: str, axis: str, *, null: float | None = 0.5, note: str = "", percent: bool = True
) -> Figure:
    """Values with their intervals, one row each, blocks by `group`; a dotted line at `null`.

    `percent` prints shares as per cent.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    scale = 100 if percent else 1
    at, places, heads = 0.0, [], []
    for before, row in zip((None, *rows), rows, strict=False):
        if row.group and (before is None or row.group != before.group):
            at += 0.35 if before is not None else 0.0
            heads.append((at, row.group))
            at += 1
        places.append(at)
        at += 1
    with rc_context(_STYLE):
        figure = Figure(figsize=(7.4, 0.235 * at + 1.25), dpi=DPI, layout="constrained")
        axes = figure.subplots()
        if null is not None:
            axes.axvline(null * scale, color=_INK, linestyle=":", linewidth=1)
        for place, row in zip(places, rows, strict=True):
            colour = _EFFECT if row.strong or all(not one.strong for one in rows) else _LEAST
            if np.isfinite([row.low, row.high]).all():
                axes.plot([row.low * scale, row.high * scale], [place] * 2, color=colour, linewidth=1.6)
            axes.plot(row.value * scale, place, "o", color=colour, markersize=5)
        seen = np.array([[row.low, row.value, row.high] for row in rows], dtype=float) * scale
        low, high = (float(limit) for limit in (np.nanmin(seen), np.nanmax(seen)))
        if null is not None:
            low, high = min(low, null * scale), max(high, null * scale)
        margin = 0.04 * (high - low or 1)
        axes.set_xlim(low - margin, high + margin)
        axes.set_ylim(at - 0.4, -0.6)
        axes.set_yticks(
            [*places, *(place for place, _ in heads)], [*(row.label for row in rows), *(name for _, name in heads)]
        )
        for label in axes.get_yticklabels()[len(rows) :]:
            label.set(fontweight="bold")
        right = axes.secondary_yaxis("right")
        right.set_yticks(places, [row.text for row in rows], fontsize=8, color=_QUIET)
        right.spines["right"].set_visible(False)
        right.tick_params(length=0)
        axes.tick_params(axis="y", length=0)
        axes.grid(axis="x", color="#000000", alpha=0.08, linewidth=0.6)
        axes.set_axisbelow(True)
        axes.set_xlabel(axis)
        figure.suptitle(title, fontsize=10.5, color=_INK)
        if note:
            figure.supxlabel(_wrapped(note, 7.4), fontsize=7.5, color=_QUIET)
        return figure


def level_colours(levels_n: int) -> list[str]:
    """A grey for the least level, blues from light to dark for the others."""
    from matplotlib.colors import LinearSegmentedColormap, to_hex

    ramp = LinearSegmentedColormap.from_list("levels", _RAMP)
    return [_LEAST, *(to_hex(ramp(float(x))) for x in np.linspace(0, 1, max(1, levels_n - 1)))][:levels_n]


def write_figure(figure: Figure, path: str | Path) -> Path:
    """Write a figure as PNG; the same figure gives the same bytes, and the file appears whole or not at all."""
    from matplotlib import rc_context

    with rc_context(_STYLE), whole_file(path) as part:
        figure.savefig(part, format="png", metadata={"Software": None})
    return Path(path)


def _wrapped(text: str, width_in: float) -> str:
    import textwrap

    return "\n".join(textwrap.wrap(text, max(20, int(width_in * 17))))
