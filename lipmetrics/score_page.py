"""The page of a score: how far each model is from real takes, where not, and what a good number is."""

from __future__ import annotations

import math
from html import escape
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from lipmetrics import floors
from lipmetrics.compare import Region, align, carry, propose_phases
from lipmetrics.curve_figures import (
    COLOURS,
    REAL,
    FloorRow,
    Group,
    aligned_png,
    floors_png,
    path_png,
    profiles_png,
    regions_png,
)
from lipmetrics.errors import InputError
from lipmetrics.html_page import bullets, folded, number, picture, span, table, write_page
from lipmetrics.measuring import GROUPS, Measure, formula_of, label_of, title_of, unit_of
from lipmetrics.metrics import HIGHER
from lipmetrics.score_files import headlines, kinds_of, overall_row, titled
from lipmetrics.scoring import Labelled, Score

MOST_REAL_DRAWN = 40
_FAMILY_ABOUT = {
    "as they are": "Curves at equal times, so lateness counts.",
    "after alignment": "Curves along the path that fits them best: lateness counts in the next table only.",
    "in time": "How late the model is, and how much the path had to warp. Of lag, value is its size; bias + is late.",
    "movement": "Differences of sizes, times and speeds of a take by itself; bias is model minus real.",
    "sticky lips": "Differences of what only openings tell: how many, when they merge, how fast the corners unzip.",
}


def write_score_page(score: Score, path: str | Path) -> None:
    """Write the page; it holds its pictures itself.

    Raises InputError if it cannot be written.
    """
    body = f"""
<h1>{escape(", ".join(score.models))} against real mouths</h1>
<p>{_counts(score)}</p>
<h2>In short</h2>
{bullets(in_short(score))}
{bullets(score.notes)}
<h2>Scores in the floor</h2>
{_floor_figure(score)}
<p class="note">{_floor_legend(score)}</p>
{_reading(score)}
<h2>All numbers</h2>
{_all_tables(score)}
{_comparisons(score)}
<h2>Utterance by utterance</h2>
{_utterances(score)}
{_closer_looks(score)}
{_failed(score)}
<h2>Settings and versions</h2>
{table(_settings(score))}
"""
    write_page(path, "lipmetrics score", body)


def in_short(score: Score) -> list[str]:
    """The result in sentences, also for the terminal."""
    found = []
    for model in score.models:
        parts = []
        for measure in headlines(score):
            row = overall_row(score, model, measure.name)
            if not math.isfinite(row["value"]):
                continue
            text = f"{title_of(measure)} {_with_unit(row['value'], unit_of(measure, score.unit))}"
            percentile = row.get(f"percentile_{score.primary}", math.nan)
            if math.isfinite(percentile):
                text += f" (percentile {percentile:.0f})"
            parts.append(text)
        found.append(f"{model}: {'; '.join(parts)}.")
        found += _late(score, model)
    for _, row in score.comparisons.iterrows():
        if row["metric"] in [measure.name for measure in headlines(score)[:2]]:
            found.append(_verdict(row))
    return found


def _floor_figure(score: Score) -> str:
    rows = floor_rows(score)
    axis = "distance over the median of the floor (1 is a typical real take)"
    what = "Scores of the models among the distances of real takes"
    return picture(floors_png(rows, list(score.models), axis), what) if rows else ""


def floor_rows(score: Score) -> list[FloorRow]:
    """Each metric's floor and the models' scores over the floor's median; metrics without such are left out."""
    rows = []
    kind = score.primary
    for measure in score.measures:
        if kind is None or measure.better == HIGHER:
            continue
        ratios = []
        for utterance in dict.fromkeys(score.floors["utterance"]):
            floor = score.floor_values.get((utterance, measure.name, kind), np.empty(0))
            if len(floor) and np.median(floor) > 0:
                ratios.append(floor / np.median(floor))
        scores = {}
        for model in score.models:
            row = overall_row(score, model, measure.name)
            scores[model] = tuple(row[f"ratio_{kind}{end}"] for end in ("", "_low", "_high"))
        if ratios and any(math.isfinite(one[0]) for one in scores.values()):
            rows.append(FloorRow(label_of(measure.name), np.concatenate(ratios), scores))
    return rows


# -- words ------------------------------------------------------------------------------------------------------------


def _counts(score: Score) -> str:
    speakers = {one.labels.speaker for one in score.references} - {None}
    utterances = {one.utterance for one in score.references}
    clips = ", ".join(f"{escape(name)} has {_plural(len(takes), 'take')}" for name, takes in score.models.items())
    said = "one utterance" if len(utterances) == 1 else f"{len(utterances)} utterances"
    who = f" of {_plural(len(speakers), 'speaker')}" if speakers else ", speakers unknown"
    unit = _UNITS.get(score.unit, score.unit)
    real = _plural(len(score.references), "real take")
    return f"{clips}. The reference is {real} of {said}{who}. Lengths are in {unit}."


def _late(score: Score, model: str) -> list[str]:
    names = {measure.name for measure in score.measures}
    if "lag_v1" not in names:
        return []
    row = overall_row(score, model, "lag_v1")
    if not math.isfinite(row["bias"]):
        return []
    word = "late" if row["bias"] >= 0 else "early"
    warp = overall_row(score, model, "warp_v1")
    text = f"{model} is {abs(1000 * row['bias']):.0f} ms {word} on average"
    if math.isfinite(warp["value"]):
        text += f", and aligning it lets one of the two stand still in {100 * warp['value']:.0f} % of the steps"
        floor = warp.get(f"median_{score.primary}", math.nan)
        text += f" (real takes among themselves {100 * floor:.0f} %)" if math.isfinite(floor) else ""
    return [text + "."]


def _verdict(row) -> str:
    nearer = row["first"] if row["difference"] < 0 else row["second"]
    if row["better"] == HIGHER:
        nearer = row["second"] if nearer == row["first"] else row["first"]
    items = _plural(row["items_n"], row["item"])
    sure = "the difference is more than chance" if row["p"] < 0.05 else "the difference could be chance"
    text = f"In {label_of(row['metric'])} {nearer} is nearer by {number(abs(row['difference']))} on {items}"
    text += f" ({number(row['low'])} to {number(row['high'])})" if math.isfinite(row["low"]) else ""
    if row["smallest_p"] > 0.05:
        few = f"{row['clusters_n']} {row['cluster']}" + "s" * (row["clusters_n"] != 1)
        return f"{text}; {few} cannot tell it from chance (a test's p is {number(row['smallest_p'], 2)} at least)."
    return f"{text}; sign-flip test p = {number(row['p'], 2)}: {sure}."


def _floor_legend(score: Score) -> str:
    if score.primary is None:
        return "No floor can be had from these takes."
    return (
        f"Grey: {floors.MEANING[score.primary]}; a dot is a real take, the box half of them, the line 90 %. "
        f"Coloured: the model, its bar the {100 * score.settings.level:.0f} % interval. Metrics in which higher is "
        "nearer, and those whose floor has the median 0, are in the tables only."
    )


def _reading(score: Score) -> str:
    return """<h3>How to read this</h3>
<p>A number by itself says little: two real people are apart too. So each real take is scored like the model, against
the takes of the others: that is the floor. <i>Percentile</i> is the share of the floor that is nearer than the model:
50 is a typical real take, 95 and more is outside what real takes do. <i>Ratio</i> is the score over the floor's median.
A percentile near 0 does not mean better than real: an average movement, without anybody's habits, lies nearer to all
than they lie to one another. Read the distances after alignment together with lag and warp: alignment forgives
lateness, these two do not.</p>"""


def _all_tables(score: Score) -> str:
    parts = []
    families = list(dict.fromkeys(measure.family for measure in score.measures))
    for family in sorted(families, key=lambda one: list(GROUPS).index(one) if one in GROUPS else len(GROUPS)):
        measures = [measure for measure in score.measures if measure.family == family]
        parts.append(f"<h3>{escape(family.capitalize() or 'Metrics')}</h3>")
        if family in _FAMILY_ABOUT:
            parts.append(f'<p class="note">{escape(_FAMILY_ABOUT[family])}</p>')
        parts.append(_table_of(score, measures))
    names = [(measure.name, formula_of(measure.name)) for measure in score.measures]
    parts.append(folded("Definitions", table(names, ("metric", "formula"))))
    return "".join(parts)


def _table_of(score: Score, measures: list[Measure]) -> str:
    kinds = kinds_of(score)
    signed = any(
        math.isfinite(overall_row(score, model, one.name)["bias"]) for model in score.models for one in measures
    )
    head = ["metric", "unit", "model", "value", "interval", *(["bias"] if signed else [])]
    for kind in kinds:
        head += [f"floor: {kind}", "ratio", "percentile", *(["interval"] if kind == score.primary else [])]
    rows = []
    for measure in measures:
        for m, model in enumerate(score.models):
            row = overall_row(score, model, measure.name)
            arrow = " ↑" if measure.better == HIGHER else ""
            unit = unit_of(measure, score.unit)
            cells = [label_of(measure.name) + arrow, unit, model] if m == 0 else ["", "", model]
            cells += [number(row["value"]), span(row["low"], row["high"])]
            if signed:
                cells.append(f"{row['bias']:+.3g}" if math.isfinite(row["bias"]) else "-")
            for kind in kinds:
                name = f"percentile_{kind}"
                cells += [number(row[f"median_{kind}"]), number(row[f"ratio_{kind}"]), _percent(row[name])]
                if kind == score.primary:
                    cells.append(_percent_span(row[f"{name}_low"], row[f"{name}_high"]))
            rows.append(cells)
    return table(rows, head) + _incomplete(score, measures)


def _incomplete(score: Score, measures: list[Measure]) -> str:
    """Which metrics some pairs do not have: a mouth that never merges has no merge time, and nothing is put in."""
    found = []
    for measure in measures:
        for model in score.models:
            row = overall_row(score, model, measure.name)
            if row["known_n"] < row["pairs_n"]:
                found.append(f"{label_of(measure.name)}, {model}: {row['known_n']} of {row['pairs_n']} pairs")
    if not found:
        return ""
    return f'<p class="note">Known for a part of the pairs only: {escape("; ".join(found))}.</p>'


def _comparisons(score: Score) -> str:
    if not len(score.comparisons):
        return ""
    first = score.comparisons.iloc[0]
    rows = []
    for _, row in score.comparisons.iterrows():
        wins = f"{row['first_nearer']} : {row['second_nearer']}"
        p = [number(row["p"], 2), number(row["p_holm"], 2)]
        means = [number(row["mean_first"]), number(row["mean_second"])]
        pair = f"{row['first']} - {row['second']}"
        rows.append(
            [label_of(row["metric"]), pair, *means, number(row["difference"]), span(row["low"], row["high"]), *p, wins]
        )
    head = ["metric", "models", "first", "second", "difference", "interval", "p", "p (Holm)", "nearer"]
    return f"""<h2>Models against each other</h2>
<p class="note">Same {first["item"]}s, clustered by {first["cluster"]} ({first["clusters_n"]}). Interval: BCa bootstrap.
p: two-sided sign-flip test{", all flips" if first["p_exact"] else ""}, not below {number(first["smallest_p"], 2)} here.
Holm's p allows for the number of metrics.</p>{table(rows, head)}"""


def _utterances(score: Score) -> str:
    measures = headlines(score)
    rows = []
    for (model, utterance), part in score.utterances.groupby(["model", "utterance"], sort=False):
        of = part.set_index("metric")
        cells = [model, utterance, str(of["clips_n"].iloc[0])]
        for measure in measures:
            row = of.loc[measure.name]
            percentile = row.get(f"percentile_{score.primary}", math.nan)
            cells.append(number(row["value"]) + (f" ({percentile:.0f})" if math.isfinite(percentile) else ""))
        rows.append(cells)
    head = ["model", "utterance", "takes", *(titled(score, one) for one in measures)]
    about = "Value, and in brackets its percentile in the floor. All metrics of all clips are in the CSV."
    return f'{table(rows, head)}<p class="note">{about}</p>'


def _closer_looks(score: Score) -> str:
    """The clip of each model that is farthest off, with its nearest real take."""
    parts = []
    for m, model in enumerate(score.models):
        worst = farthest_clip(score, model)
        if worst is None:
            continue
        clip, real, same = worst
        parts.append(f"<h2>A closer look: {escape(clip.take.name)} of {escape(model)}</h2>")
        where = f", the farthest off of {escape(model)}," if len(score.models[model]) > 1 else ""
        parts.append(
            f"<p>The clip{where} with the real takes of the same utterance. It is aligned with "
            f"{escape(real.take.name)}, the real take nearest to it in {label_of(headlines(score)[0].name)}.</p>"
        )
        shown = [one.take for one in same[:MOST_REAL_DRAWN]]
        groups = [
            Group("real takes", shown, REAL, 0.9),
            Group(clip.take.name, [clip.take], COLOURS[m % len(COLOURS)], 2),
        ]
        parts.append(picture(profiles_png(groups, score.settings.channels), "Curves of the clip and of the real takes"))
        parts.append(_pair_figures(score, real, clip))
    return "".join(parts)


def farthest_clip(score: Score, model: str) -> tuple[Labelled, Labelled, list[Labelled]] | None:
    """The clip of a model with the largest score in the first headline, the real take nearest to it, all of those."""
    measure = headlines(score)[0]
    best: tuple[float, tuple] | None = None
    for one in score.models[model]:
        values = score.clip_distances(model, one, measure)
        same = [real for real in score.references if real.utterance == one.utterance]
        if not np.isfinite(values).any():
            continue
        mean = float(np.nanmean(values))
        if best is None or mean > best[0]:
            best = (mean, (one, same[int(np.nanargmin(values))], same))
    return best[1] if best else None


def _pair_figures(score: Score, real: Labelled, clip: Labelled) -> str:
    settings = score.settings
    match = align(
        real.take,
        clip.take,
        rate_hz=settings.rate_hz,
        cost=settings.cost,
        band=settings.band,
        mixed_units=settings.allow_mixed_units,
    )
    parts = [
        picture(path_png(match), "The path between both"),
        picture(aligned_png(match), "Both, as they are and aligned"),
    ]
    try:
        regions: tuple[Region, ...] = propose_phases(real.take)
        parts.append(picture(regions_png(match, regions, carry(regions, match), "height"), "Phases of both"))
        parts.append('<p class="note">Phases proposed on the real take, carried over by the path.</p>')
    except InputError as error:
        parts.append(f'<p class="note">No phases are drawn: {escape(str(error))}.</p>')
    return "".join(parts)


def _failed(score: Score) -> str:
    if not score.failed:
        return ""
    return f"<h2>Passed over</h2>{table(score.failed.items(), ('take', 'why'))}"


def _settings(score: Score) -> list[tuple[str, str]]:
    settings = score.settings
    rows = [
        ("channels", ", ".join(settings.channels)),
        ("local cost of the alignment", settings.cost),
        ("band", "none" if settings.band is None else f"{settings.band:g} of the longer one's duration"),
        (
            "curves compared at",
            "the higher rate of both" if settings.rate_hz is None else f"{settings.rate_hz:g} per second",
        ),
        ("compared with", "takes of the same speaker" if settings.same_speaker else "all real takes of the utterance"),
        ("intervals", f"percentile bootstrap, {settings.draws} draws, level {settings.level:g}, seed {settings.seed}"),
    ]
    for package in ("lipmetrics", "numpy", "scipy"):
        try:
            rows.append((package, version(package)))
        except PackageNotFoundError:
            continue
    return rows


_UNITS = {"mw": "mouth widths (mw)", "px": "px", "m": "m", "model": "units of the mesh"}


def _with_unit(value: float, unit: str) -> str:
    if unit == "s":
        return f"{1000 * value:.0f} ms"
    return number(value) + (f" {unit}" if unit else "")


def _percent(value: float) -> str:
    return f"{value:.0f}" if math.isfinite(value) else "-"


def _percent_span(low: float, high: float) -> str:
    return f"{low:.0f} to {high:.0f}" if math.isfinite(low) else "-"


def _plural(count: int, word: str) -> str:
    return f"{count} {word}" + ("" if count == 1 else "s")
