"""`lipmetrics corpus average`: averages of a store as one page, and as tables."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from html import escape
from itertools import pairwise
from pathlib import Path

import pandas as pd
from tqdm import tqdm

from corpus_tools.average import (
    MEASURES,
    Group,
    average_groups,
    curves_table,
    default_fields,
    order,
    read_takes_of,
    speaker_field,
    speakers_table,
    summary_table,
)
from corpus_tools.average_figures import levels_png, speakers_png
from corpus_tools.naming import Template
from lipmetrics.atomic import whole_file
from lipmetrics.errors import InputError
from lipmetrics.html_page import bullets, folded, number, picture, table, write_page

MOST_ACTIONS_N = 60  # with figures; all are in the tables
COLUMNS_N = 5  # speakers in a figure
SHOWN = ("onset_s", "rise_s", "peak_height", "peak_width", "peak_area", "fastest_opening")


def write_report(
    source: str | Path,
    folder: str | Path,
    *,
    by: Sequence[str] | None = None,
    template: Template | None = None,
    parquet: bool = False,
    progress: bool = False,
) -> dict:
    """Average a store, or a folder of profiles, and write report.html, averages.csv, summary.csv and speakers.csv.

    Parameters
    ----------
    by : fields; clips that agree in them are averaged, and the last one of several is drawn as levels. None: the
        action or utterance, and the stickiness where it is known
    template : of the names of profiles in a folder
    parquet : write the three tables as Parquet too

    Returns
    -------
    The summary of the command; `failed` lists what could not be averaged.

    Raises
    ------
    InputError : nothing that can be averaged, unknown fields, no pyarrow for Parquet, or a folder that cannot be
        written to
    """
    if parquet:
        _check_parquet()
    folder = Path(folder)
    failed: list[dict[str, str]] = []
    takes = read_takes_of(source, template, lambda name, why: failed.append({"source": name, "error": why}))
    fields = list(dict.fromkeys(default_fields(takes) if by is None else by))
    values = {tuple(take.meta.get("fields", {}).get(field) for field in fields) for take in takes}
    with tqdm(total=len(values), unit="group", disable=not progress) as bar:
        groups = average_groups(takes, fields, progress=bar.update)
    summary = summary_table(groups)
    tables = {"averages": curves_table(groups), "summary": summary, "speakers": speakers_table(groups)}
    files = [folder / "report.html"]
    write_page(files[0], "Average profiles", _body(Path(source), takes, groups, fields, summary, failed))
    for name, content in tables.items():
        files += _write_table(folder / name, content, parquet)
    whose = speaker_field(takes)
    people_n = len({who for group in groups for who in group.takes})
    people = f"{people_n} speakers" if whose else "speakers unknown"
    return {
        "text": [f"{len(takes)} clips, {people}, {len(groups)} groups by {' and '.join(fields) or 'nothing'}"]
        + [str(path) for path in files],
        "done_n": len(takes),
        "clips_n": len(takes),
        "speakers_n": people_n if whose else None,
        "groups": [{**group.fields, "speakers_n": len(group.takes), "clips_n": group.clips_n} for group in groups],
        "files": [str(path) for path in files],
        "failed": failed,
    }


def _write_table(base: Path, content: pd.DataFrame, parquet: bool) -> list[Path]:
    paths = [base.with_suffix(".csv")]
    text = io.StringIO()
    content.to_csv(text, index=False, float_format="%.7g", lineterminator="\n")
    with whole_file(paths[0]) as part:
        part.write_text(text.getvalue(), encoding="utf-8", newline="")
    if parquet:
        paths.append(base.with_suffix(".parquet"))
        with whole_file(paths[1]) as part:
            content.to_parquet(part, engine="pyarrow", index=False)
    return paths


def _check_parquet() -> None:
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        raise InputError(
            "expected pyarrow to write Parquet, it is not installed; pip install 'lipmetrics[parquet]' or leave "
            "--parquet out"
        ) from None


# -- the page ----------------------------------------------------------------------------------------------------------


def _body(
    source: Path,
    takes: Sequence,
    groups: Sequence[Group],
    fields: Sequence[str],
    summary: pd.DataFrame,
    failed: Sequence[dict[str, str]],
) -> str:
    whose = speaker_field(takes)
    people = sorted({who for group in groups for who in group.takes}, key=order)
    by = " and ".join(fields) or "nothing: all clips are one group"
    facts = [
        f"{len(takes)} clips of {source.name}, {f'{len(people)} speakers' if whose else 'speakers unknown'}, "
        f"{len(groups)} groups by {by}.",
        "Lengths are in mouth widths, areas in their square; time is from the start of each clip.",
        "A speaker's average is that of the speaker's clips; a group's average is that of its speakers' averages, so "
        "everyone counts once. Curves are aligned before they are averaged, by their shape, whatever their size.",
        "Between: standard deviation over the speakers. Within: standard deviation over the repeats of one speaker, "
        "pooled over speakers. Bands in figures of levels are the one between speakers"
        + (", and within where there is one speaker." if whose else "; without speakers, the one within."),
        "Alignment takes differences of tempo out of both spreads; time_between_s in averages.csv is what it took out.",
    ]
    parts = ["<h1>Average profiles</h1>", bullets(facts)]
    if failed:
        rows = [(one["source"], one["error"]) for one in failed]
        parts.append(folded(f"{len(failed)} clips could not be averaged", table(rows, ("clip", "reason"))))
    actions = _by_action(groups, fields)
    parts += ["<h2>Numbers</h2>", _numbers(groups, summary, fields)]
    if len(fields) > 1:
        parts.append(_orders(actions, summary, fields))
    for action, own in list(actions.items())[:MOST_ACTIONS_N]:
        parts.append(f"<h2>{escape(action)}</h2>")
        parts += _figures(action, own, fields)
    if len(actions) > MOST_ACTIONS_N:
        parts.append(f'<p class="note">{len(actions) - MOST_ACTIONS_N} more are in the tables, without figures.</p>')
    return "".join(parts)


def _by_action(groups: Sequence[Group], fields: Sequence[str]) -> dict[str, dict[str, Group]]:
    """Groups by what all but the last field say, then by the last one; by themselves where there is one field."""
    found: dict[str, dict[str, Group]] = {}
    for group in groups:
        texts = ["-" if value is None else str(value) for value in group.fields.values()]
        if len(fields) > 1:
            found.setdefault(" ".join(texts[:-1]), {})[f"{fields[-1]} {texts[-1]}"] = group
        else:
            found[" ".join(texts) or "all clips"] = {"": group}
    return found


def _figures(action: str, own: dict[str, Group], fields: Sequence[str]) -> list[str]:
    curves = {}
    for label, group in own.items():
        spread = group.average.spread if len(group.takes) > 1 else group.within
        curves[label] = (group.average, spread)
    count = ", ".join(
        f"{label + ': ' if label else ''}{len(group.takes)} speakers, {group.clips_n} clips"
        for label, group in own.items()
    )
    what = f"{action}: area, width and height" + (f" by {fields[-1]}" if len(fields) > 1 else "")
    parts = [picture(levels_png(curves, what), what), f'<p class="note">{escape(count)}</p>']
    people = sorted({who for group in own.values() for who in group.takes}, key=order)
    if people == [""]:
        return parts
    figures = []
    for at in range(0, len(people), COLUMNS_N):
        shown = {
            who: {label: (group.speakers[who], group.takes[who]) for label, group in own.items() if who in group.takes}
            for who in people[at : at + COLUMNS_N]
        }
        what = f"{action}: speakers side by side"
        figures.append(picture(speakers_png(shown, list(own), what), what))
    first, *others = figures
    parts.append(first)
    if others:
        parts.append(folded(f"{len(people) - COLUMNS_N} more speakers", "".join(others)))
    return parts


def _numbers(groups: Sequence[Group], summary: pd.DataFrame, fields: Sequence[str]) -> str:
    rows = []
    for group, (_, row) in zip(groups, summary.iterrows(), strict=True):
        said = ["-" if value is None else str(value) for value in group.fields.values()]
        cells = [*said, str(len(group.takes)), str(group.clips_n)]
        for name in SHOWN:
            spreads = [number(row[f"{name}_{kind}"], 2) for kind in ("between", "within")]
            cells.append(f"{number(row[name])} ({spreads[0]}; {spreads[1]})")
        rows.append(cells)
    note = "; ".join(f"{name}: {says}" for name, says in MEASURES.items())
    return (
        table(rows, (*fields, "speakers", "clips", *SHOWN))
        + f'<p class="note">Mean over speakers (standard deviation between; within speakers). {escape(note)}.</p>'
    )


def _orders(actions: dict[str, dict[str, Group]], summary: pd.DataFrame, fields: Sequence[str]) -> str:
    """How each measure goes with the level, action by action."""
    rows, at = [], 0
    for action, own in actions.items():
        part = summary.iloc[at : at + len(own)]
        at += len(own)
        if len(own) < 2:
            continue
        cells = [action]
        for name in SHOWN:
            values = part[name].tolist()
            cells.append(f"{' · '.join(number(value, 2) for value in values)} {_arrow(values)}")
        rows.append(cells)
    if not rows:
        return ""
    note = f"In order of {fields[-1]}, from low to high. ↗ rises at every step, ↘ falls at every step."
    return f"<h3>By {escape(fields[-1])}</h3>" + table(rows, (fields[0], *SHOWN)) + f'<p class="note">{note}</p>'


def _arrow(values: Sequence[float]) -> str:
    if any(math.isnan(value) for value in values):
        return ""
    steps = [after - before for before, after in pairwise(values)]
    return "↗" if all(step > 0 for step in steps) else "↘" if all(step < 0 for step in steps) else ""
