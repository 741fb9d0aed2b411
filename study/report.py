"""`lipmetrics study analyse`: answers to tables, figures and a report."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from study import summary
from study.analysis import Analysis, analyse
from study.atomic import whole_file
from study.errors import InputError
from study.figures import THESIS_CHARTS, Estimate, charts_of, draw_chart, draw_estimates, write_figure
from study.page import write_page
from study.printed import between, number, percent
from study.responses import Answers, load_answers
from study.wording import nearest

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DONE, BAD_INPUT = 0, 2
_INTERVALS = "intervals over participants, exact ones where nobody answered twice"
MOST_ROWS_N = 60  # of a figure with one row for each participant, or pair of levels


def main(words: list[str], prog: str = "lipmetrics study analyse") -> int:
    """Run one command line; returns the exit code."""
    arguments = _parser(prog).parse_args(words)
    found = analyse(
        _answers(arguments),
        max_wrong_n=arguments.max_wrong,
        level=arguments.level,
        seed=arguments.seed,
    )
    files = save(found, arguments.out) if arguments.out else []
    if arguments.json:
        facts = {"command": "analyse", "files": [str(file) for file in files]} | found.to_dict()
        _say(json.dumps(facts, indent=1, ensure_ascii=False, allow_nan=False))
    else:
        _say(in_text(found))
        if files:
            _say(f"\n{len(files)} files -> {arguments.out}; begin with {Path(arguments.out) / 'report.html'}")
    return DONE


def _answers(arguments: argparse.Namespace):
    if arguments.answers is not None:
        answers = load_answers(arguments.answers, design=arguments.design, stimuli=arguments.stimuli)
        return answers if arguments.least is None else with_least(answers, arguments.least)
    if arguments.design or arguments.stimuli or arguments.least is not None:
        raise InputError("expected answers to go with --design, --stimuli or --least, got none; name the CSV file")
    return None


def with_least(answers: Answers, level: str) -> Answers:
    """The same answers with another level as the one that all others are compared with.

    Raises
    ------
    InputError : no such level
    """
    by_text = {summary.level_name(one).removeprefix("level "): one for one in answers.levels}
    if level not in by_text:
        raise InputError(f"expected a level of the answers, got {nearest(level, by_text)}")
    others = (one for one in answers.levels if one != by_text[level])
    return dataclasses.replace(answers, levels=(by_text[level], *others))


def save(found: Analysis, folder: str | Path) -> list[Path]:
    """Write analysis.json, tables/*.csv, figures/*.png and report.html to a folder; returns the paths.

    The same analysis gives the same bytes. Files of these names are replaced, others stay.

    Raises
    ------
    InputError : the folder cannot be written to
    """
    folder = Path(folder)
    files = [found.save(folder / "analysis.json")]
    for name, table in tables(found).items():
        files.append(folder / "tables" / f"{name}.csv")
        with whole_file(files[-1]) as part:
            table.to_csv(part, index=False, lineterminator="\n", float_format="%.10g")
    pictures = {
        name: write_figure(figure, folder / "figures" / f"{name}.png") for name, figure in draw_figures(found).items()
    }
    return [*files, *pictures.values(), write_page(folder / "report.html", found, pictures)]


def tables(found: Analysis) -> dict[str, pd.DataFrame]:
    """The tables of an analysis by name, numbers as they are."""
    answers = found.answers.table
    all_of_them = {
        "answers": answers[[column for column in answers if not str(column).startswith("_")]],
        "tests": found.tests,
        "pairs": found.pairs,
        "groups": found.groups,
        "strengths": found.strengths.table if found.strengths else None,
        "strength_differences": found.strengths.differences if found.strengths else None,
        "participants": found.participants,
        "consistency": found.consistency,
        **{f"levels_by_{factor}": one.levels for factor, one in found.interactions.items()},
        "catch_trials": found.exclusions if len(found.exclusions) else None,
        "replication": found.replication,
        "statements": found.statements,
        "verdicts": found.verdicts,
    }
    return {name: table for name, table in all_of_them.items() if table is not None}


def draw_figures(found: Analysis) -> dict[str, Figure]:
    """All figures by name: bar charts (those of the thesis for its answers), and rows of estimates with intervals."""
    charts = THESIS_CHARTS if found.replication is not None else charts_of(found.answers)
    figures = {chart.name: draw_chart(chart, found.answers) for chart in charts}
    a, b = summary.sides(found)
    axis = f"share of answers for {a} (%)"
    if len(found.groups) > 1:
        figures["groups"] = draw_estimates(
            _group_rows(found), f"{a} against {b}", axis, note=f"{_INTERVALS}; the first over pairs too"
        )
    if found.strengths is not None:
        rows = [
            Estimate(
                summary.level_name(row.level),
                row.strength,
                row.low,
                row.high,
                f"{number(row.strength)}" + (f" ({between(row.low, row.high, number)})" if row.Index else ""),
            )
            for row in found.strengths.table.itertuples()
        ]
        note = "log odds against the least level; intervals: bootstrap over participants"
        figures["strengths"] = draw_estimates(
            rows, "Strength of each level (Bradley-Terry)", "strength", null=0, note=note, percent=False
        )
    if "all_pairs" not in figures and found.replication is None and 1 < len(found.pairs) <= MOST_ROWS_N:
        figures["pairs"] = draw_estimates(
            _pair_rows(found), "Every pair of levels", "share of answers for the first (%)", note=_INTERVALS
        )
    if len(found.participants) <= MOST_ROWS_N:
        people = found.participants.sort_values("share", kind="stable", ascending=False)
        rows = [
            Estimate(str(row.participant), row.share, row.low, row.high, f"{row.for_a} of {row.for_a + row.for_b}")
            for row in people.itertuples()
            if row.for_a + row.for_b
        ]
        note = "exact intervals within each participant; dotted: no preference"
        figures["participants"] = draw_estimates(rows, f"Every participant: {a} against {b}", axis, note=note)
    return figures


def _pair_rows(found: Analysis) -> list[Estimate]:
    names = [
        f"{summary.level_name(a)} over {summary.level_name(b).removeprefix('level ')}"
        for a, b in zip(found.pairs["level_a"], found.pairs["level_b"], strict=True)
    ]
    rows = zip(names, found.pairs.itertuples(), strict=True)
    return [
        Estimate(name, row.share, row.low, row.high, f"{row.for_a} of {row.for_a + row.for_b}")
        for name, row in rows
        if np.isfinite(row.share)
    ]


def _group_rows(found: Analysis) -> list[Estimate]:
    rows = []
    if found.headline is not None:
        one = found.headline
        text = f"{percent(one.mean)} ({between(one.low, one.high)})"
        rows.append(Estimate("all, headline", one.mean, one.low, one.high, text, "all", True))
    names = {"action and audio": "by action and audio"}
    groupings = set(found.groups["grouping"])
    for row in found.groups.to_dict("records"):
        if row["grouping"] == "action" and "action and audio" in groupings:
            continue  # finer rows follow
        if not np.isfinite(row["share"]):
            continue
        group = "all" if row["grouping"] == "all" else names.get(row["grouping"], f"by {row['grouping']}")
        text = f"{percent(row['share'])} ({between(row['low'], row['high'])})"
        label = "all, participants" if row["grouping"] == "all" else summary.group_name(row)
        rows.append(Estimate(label, row["share"], row["low"], row["high"], text, group, row["grouping"] == "all"))
    return rows


def in_text(found: Analysis) -> str:
    """What the command prints."""
    parts = [found.answers.source, _bullets(summary.what_was_asked(found))]
    parts += ["", "In short", _bullets(summary.in_short(found))]
    parts += ["", "By every test", summary.tests(found).text()]
    parts += ["", "Pairs of levels", summary.pairs(found).text()]
    if found.strengths is not None:
        parts += ["", "Strength of each level (Bradley-Terry)", summary.strengths(found).text()]
    if len(found.groups) > 1:
        parts += ["", "By action, audio and speed", summary.groups(found).text()]
    said = summary.side_and_position(found)
    if said:
        parts += ["", "Side and position", _bullets(said)]
    if found.replication is not None:
        equal = int(found.replication["agrees"].sum())
        parts += [
            "",
            f"The thesis's printed numbers: {equal} of {len(found.replication)} equal those of its answers",
            summary.replication(found.replication).text(),
            "",
            "The thesis's conclusions",
            _conclusions(found.verdicts),
        ]
    notes = [note for note in found.notes if note not in said]
    if notes:
        parts += ["", "Notes", _bullets(notes)]
    return "\n".join(parts)


def _conclusions(verdicts: pd.DataFrame) -> str:
    words = {"yes": "survives", "no": "does not", "in part": "in part"}
    rows = [
        (words.get(row.survives, row.survives), f"p {summary.p_text(row.p)}", f"{row.conclusion}: {row.estimate}")
        for row in verdicts.itertuples()
    ]
    return summary.Table(("", "", ""), tuple(rows)).text()


def _bullets(said: list[str]) -> str:
    return "\n".join(f"  - {one}" for one in said)


def _say(text: str) -> None:
    try:
        print(text, flush=True)
    except BrokenPipeError:  # nobody reads on
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line instead of a page of usage."""

    def error(self, message: str):
        self.exit(BAD_INPUT, f"{self.prog}: {message}; see '{self.prog} --help'\n")


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = _Parser(
        prog=prog,
        description="Answers of a study to tables, figures and a report. "
        "Without a file: the answers of the thesis's study, with its printed numbers replicated.",
        epilog=f"example: {prog} answers.csv -o results",
    )
    parser.add_argument(
        "answers",
        nargs="?",
        metavar="ANSWERS.csv",
        help="a row per answer: participant, left, right, chosen (empty for a tie); further columns are kept",
    )
    parser.add_argument("-o", "--out", metavar="DIR", help="folder for report.html, analysis.json, tables/, figures/")
    parser.add_argument("--stimuli", metavar="CSV", help="what the videos show: stimulus, action, level, audio, speed")
    parser.add_argument("--design", metavar="FILE", help="design.json of the study, for the same")
    parser.add_argument(
        "--least",
        metavar="LEVEL",
        help="level that all others are compared with; default the lowest, or the first in the alphabet",
    )
    parser.add_argument(
        "--max-wrong", type=_number_of, metavar="N", help="leave out who answered more than N catch trials wrong"
    )
    parser.add_argument("--level", type=_share, default=0.95, metavar="P", help="of the intervals; default 0.95")
    parser.add_argument("--seed", type=_number_of, default=0, metavar="S", help="of all random numbers; default 0")
    parser.add_argument("--json", action="store_true", help="print one machine-readable summary on stdout")
    return parser


def _number_of(text: str) -> int:
    if not text.isascii() or not text.isdigit() or len(text) > 18:
        raise argparse.ArgumentTypeError(f"expected a whole number, 0 or more, got '{text}'")
    return int(text)


def _share(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f"expected a number between 0 and 1 such as 0.95, got '{text}'")
    return value
