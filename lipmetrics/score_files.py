"""The files of a score: JSON with everything, CSV with a row per clip and metric, a row of LaTeX for a paper."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd

from lipmetrics import floors
from lipmetrics.atomic import whole_file
from lipmetrics.measuring import HEADLINES, Measure, title_of, unit_of
from lipmetrics.profile import without_nan
from lipmetrics.scoring import Labelled, Score

FORMAT = "lipmetrics score 1"
_LATEX = {c: f"\\{c}" for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}


def write_score(score: Score, folder: str | Path, stem: str = "score") -> list[Path]:
    """Write `<stem>.json`, `<stem>.csv` and `<stem>.tex` into `folder`; the same score gives the same bytes.

    Raises InputError if `folder` cannot be written to.
    """
    texts = {
        "json": json.dumps(without_nan(as_record(score)), indent=1, ensure_ascii=False, allow_nan=False) + "\n",
        "csv": score.clips.to_csv(index=False, float_format="%.9g", lineterminator="\n"),
        "tex": latex(score),
    }
    paths = [Path(folder) / f"{stem}.{ending}" for ending in texts]
    for path, text in zip(paths, texts.values(), strict=True):
        with whole_file(path) as part:
            part.write_text(text, encoding="utf-8", newline="\n")
    return paths


def as_record(score: Score) -> dict:
    """A score as plain values for JSON, with nine significant digits; NaN is left for the writer."""
    values = {}
    for (utterance, metric, kind), floor in score.floor_values.items():
        values.setdefault(utterance, {}).setdefault(metric, {})[kind] = [_short(value) for value in np.sort(floor)]
    return {
        "format": FORMAT,
        "unit": score.unit,
        "settings": asdict(score.settings),
        "interval": {"kind": "percentile bootstrap of speakers or clips", "level": score.settings.level},
        "floors": {kind: floors.MEANING[kind] for kind in kinds_of(score)},
        "primary_floor": score.primary,
        "notes": score.notes,
        "failed": score.failed,
        "models": {name: [_who(one) for one in takes] for name, takes in score.models.items()},
        "references": [_who(one) for one in score.references],
        "overall": _records(score.overall),
        "utterances": _records(score.utterances),
        "clips": _records(score.clips),
        "comparisons": _records(score.comparisons),
        "floor_summary": _records(score.floors),
        "floor_values": values,
    }


def summary(score: Score) -> dict:
    """What `--json` prints: everything but clips, utterances and the floors themselves."""
    record = as_record(score)
    for name in ("clips", "utterances", "floor_values", "floor_summary"):
        del record[name]
    return record


def kinds_of(score: Score) -> list[str]:
    """The kinds of floor that a score has, the one its percentiles refer to first."""
    kinds = [kind for kind in floors.MEANING if f"percentile_{kind}" in score.overall]
    return sorted(kinds, key=lambda kind: kind != score.primary)


def headlines(score: Score) -> list[Measure]:
    """The metrics of a row in a paper."""
    wanted = [one for name in HEADLINES for one in score.measures if one.name == name]
    return wanted or list(score.measures[:6])


def titled(score: Score, measure: Measure) -> str:
    """A metric's name and unit, for the head of a column."""
    unit = unit_of(measure, score.unit)
    return title_of(measure) + (f" ({unit})" if unit else "")


def latex(score: Score) -> str:
    """A row of LaTeX per model: value, and its percentile in the floor in brackets; what is what in comments."""
    measures = headlines(score)
    names = [titled(score, one) for one in measures]
    floor = floors.MEANING.get(score.primary or "", "none could be had")
    lines = [
        f"% lipmetrics score: {', '.join(one.name for one in measures)}",
        f"% value (percentile of the floor, 50 is a typical real take); floor: {floor}",
        f"% Model & {' & '.join(map(_escaped, names))} \\\\",
    ]
    for model in score.models:
        cells = [_escaped(model)]
        for measure in measures:
            row = overall_row(score, model, measure.name)
            percentile = row.get(f"percentile_{score.primary}", math.nan)
            cell = f"{row['value']:.3g}" if math.isfinite(row["value"]) else "--"
            cells.append(cell + (f" ({percentile:.0f})" if math.isfinite(percentile) else ""))
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join(lines) + "\n"


def overall_row(score: Score, model: str, metric: str) -> dict:
    """The row of `overall` of a model and a metric."""
    table = score.overall
    return table[(table["model"] == model) & (table["metric"] == metric)].iloc[0].to_dict()


def _who(one: Labelled) -> dict:
    labels = {name: value for name, value in asdict(one.labels).items() if value is not None}
    return {"take": one.take.name, **labels, "source": one.take.source, "frames": len(one.take.time_s)}


def _records(table: pd.DataFrame) -> list[dict]:
    return [{name: _short(value) for name, value in row.items()} for row in table.to_dict("records")]


def _short(value):
    """Nine significant digits: those after differ from machine to machine."""
    if isinstance(value, float | np.floating):
        return float(f"{value:.9g}")
    return value.item() if isinstance(value, np.generic) else value


def _escaped(text: str) -> str:
    return "".join(_LATEX.get(c, c) for c in text)
