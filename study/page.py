"""The report of a study: one HTML page that holds its figures itself, the honest result first."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from html import escape
from pathlib import Path

import numpy as np

from study import summary
from study.analysis import Analysis
from study.atomic import whole_file
from study.printed import counted, p_text, percent
from study.summary import Table

METHODS = (
    (
        "headline test",
        "Answers are crossed: a participant who likes one kind of video, and a pair in which one video simply looks "
        "better, move many answers together. The test estimates how much participants differ, how much pairs differ "
        "and how much is left, and asks how far the share would move with other participants and other pairs. Its "
        "distribution is drawn by simulating studies of the same layout without a preference. In simulations with "
        "such effects it errs in about 5 % of studies at a nominal 5 %; the binomial test errs several times as "
        "often.",
    ),
    (
        "Student's t over participants",
        "Each participant's answers are added up and the participants are the sample (cluster-robust standard error, "
        "participants - 1 degrees of freedom). It holds for the very pairs that were shown.",
    ),
    (
        "sign flips, bootstrap",
        "The same question without a normal distribution: could each participant's surplus as well have had the "
        "other sign (all patterns counted), and how the share moves when participants are drawn anew with "
        "replacement (percentiles widened for few participants, Hesterberg 2015).",
    ),
    (
        "GEE, mixed logit",
        "Two models that many reviewers ask for: the mean over people with answers of one participant correlated "
        "(bias-reduced covariance, Mancl and DeRouen 2001), and log odds with normal effects of participants and "
        "pairs (Laplace).",
    ),
    (
        "exact",
        "Binomial counts as if every answer were an independent coin: Clopper and Pearson's interval, p-values "
        "summed from the binomial distribution. Right within one participant; too narrow for answers of several.",
    ),
    (
        "Holm",
        "Several tests at once find something by chance more often than one; Holm's p-values keep the chance of any "
        "false finding among them at the nominal level.",
    ),
    (
        "Bradley-Terry strength",
        "One number per level such that the odds of i over j are exp(strength i - strength j); ties by Davidson's "
        "extension; intervals from a bootstrap over participants.",
    ),
    (
        "preference ratio",
        "Answers for the one over answers for the other: 1 is no preference, 1.5 is 60 %. Ties are left out of "
        "ratios and of exact tests and count half elsewhere.",
    ),
)
CHART_WORDS = (
    "Whiskers are exact intervals that take answers for independent; they are too short where a participant's "
    "answers hang together, but they do not mislead about the counts."
)


def write_page(path: Path, found: Analysis, figures: Mapping[str, Path]) -> Path:
    """Write the page; `figures` are PNG files by name, taken in.

    Raises
    ------
    InputError : the place cannot be written to
    """
    with whole_file(path) as part:
        part.write_text(page(found, {name: file.read_bytes() for name, file in figures.items()}), encoding="utf-8")
    return path


def page(found: Analysis, figures: Mapping[str, bytes]) -> str:
    """The page's HTML; `figures` are PNG by name."""
    rest = dict(figures)

    def figure(name: str, words: str) -> str:
        return _figure(rest.pop(name), words) if name in rest else ""

    sections = [_opening(found)]
    sections.append(("By every test", _table(summary.tests(found))))
    sections.append(("By level", _levels(found, figure)))
    if len(found.groups) > 1:
        forest = figure("groups", "Shares by action, audio and speed with their intervals")
        charts = figure("by_action", "Each action") + figure("by_action_levels", "Each action, every level")
        sections.append(("By action, audio and speed", forest + _table(summary.groups(found)) + charts))
    for factor, one in found.interactions.items():
        both = _table(summary.interaction_effects(one)) + _table(summary.interaction_levels(one))
        sections.append((f"Does {factor} change the preference?", both))
    sections.append(("By participant", _people(found, figure)))
    sections.append(("Side and position", _sentences(summary.side_and_position(found))))
    sections.append(("Checks of attention and exclusions", _exclusions(found)))
    if found.replication is not None:
        sections += _thesis(found, rest)
        rest = {}
    if rest:
        sections.append(("Bar charts", "".join(_figure(png, name) for name, png in rest.items()) + _note(CHART_WORDS)))
    sections.append(("What cannot be said", _sentences(_limits(found))))
    sections.append(("How the numbers were computed", _methods(found)))
    body = "\n".join(f"<section>\n<h2>{escape(title)}</h2>\n{text}\n</section>" for title, text in sections if text)
    title = "Analysis of a paired-comparison study"
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{_STYLE}</style></head>\n<body>\n<h1>{title}</h1>\n"
        f'<p class="note">{escape(found.answers.source)}</p>\n{body}\n</body></html>\n'
    )


def _opening(found: Analysis) -> tuple[str, str]:
    a, b = summary.sides(found)
    first, *others = summary.in_short(found)
    asked = (
        "<p>In every trial a participant saw two videos side by side and chose one. The question above all: "
        f"{escape(a)} or {escape(b)}?</p>"
    )
    return "In short", f'<p class="lead">{escape(first)}</p>\n{_sentences(others)}\n{asked}\n' + _sentences(
        summary.what_was_asked(found)
    )


def _levels(found: Analysis, figure) -> str:
    text = "".join(figure(name, "Every pair of levels") for name in ("all_pairs", "pairs", "figure_5_03"))
    text += _table(summary.pairs(found))
    if found.strengths is not None:
        text += "<h3>Strength of each level</h3>" + figure("strengths", "Strengths with their intervals")
        text += _table(summary.strengths(found))
    return text


def _people(found: Analysis, figure) -> str:
    shares = found.participants["share"]
    said = (
        f"<p>Shares run from {percent(shares.min())} to {percent(shares.max())}. "
        + (
            f"If all participants had the same preference, they would differ this much with p = "
            f"{p_text(found.heterogeneity_p)} (answers to each pair dealt anew among those who gave them)."
            if np.isfinite(found.heterogeneity_p)
            else ""
        )
        + "</p>"
    )
    return figure("participants", "Share of every participant") + said + _table(summary.participants(found))


def _exclusions(found: Analysis) -> str:
    if not len(found.exclusions):
        return "<p>The answers have no catch trials, and nobody was left out.</p>"
    out = int(found.exclusions["excluded"].sum())
    wrong = int(found.exclusions["wrong_n"].sum())
    said = (
        f"<p>{wrong} of {int(found.exclusions['catch_n'].sum())} catch trials were answered otherwise than expected; "
        f"left out: {counted(out, 'participant')}.</p>"
    )
    return said + _table(summary.exclusions(found))


def _thesis(found: Analysis, rest: dict[str, bytes]) -> list[tuple[str, str]]:
    charts = "".join(_figure(png, name) for name, png in rest.items())
    return [
        ("Where the thesis's conclusions survive", _table(summary.verdicts(found.verdicts))),
        ("The thesis's printed numbers", _table(summary.replication(found.replication))),
        ("The thesis's words about its figures", _table(summary.statements(found.statements))),
        ("Figures 5.2 to 5.20 from the answers", charts + _note(CHART_WORDS)),
    ]


def _limits(found: Analysis) -> list[str]:
    return [
        *(note for note in found.notes if not note.startswith(("The side", "The order"))),
        "A p-value above 0.05 does not show that there is no difference; look at the interval for how large one may "
        "be.",
        "Other participants means others like these; other pairs means others like those that were shown.",
    ]


def _methods(found: Analysis) -> str:
    items = "\n".join(f"<dt>{escape(name)}</dt><dd>{escape(words)}</dd>" for name, words in METHODS)
    settings = (
        f"Intervals of {percent(found.level)}; random numbers from seed {found.seed}, {found.draws} draws in the "
        "headline test: the same answers and settings give the same page."
    )
    return f"<dl>\n{items}\n</dl>\n{_note(settings)}"


def _table(table: Table) -> str:
    return table.html() + "\n"


def _figure(png: bytes, words: str) -> str:
    words = words.replace("_", " ")
    return f'<img alt="{escape(words)}" src="data:image/png;base64,{base64.b64encode(png).decode("ascii")}">\n'


def _sentences(said: list[str]) -> str:
    return "<ul>\n" + "\n".join(f"<li>{escape(one)}</li>" for one in said) + "\n</ul>" if said else ""


def _note(words: str) -> str:
    return f'<p class="note">{escape(words)}</p>\n'


_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; max-width: 66rem; margin: 2rem auto;
  padding: 0 1rem; }
h1 { font-size: 1.7rem; margin-bottom: 0; } h2 { font-size: 1.25rem; margin-top: 2.5rem; } h3 { font-size: 1.05rem; }
img { max-width: 100%; height: auto; display: block; margin: 0.8rem 0; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; margin: 0.5rem 0; font-size: 0.88rem; font-variant-numeric: tabular-nums; }
td, th { padding: 0.2rem 0.9rem 0.2rem 0; text-align: left; border-bottom: 1px solid #ddd; vertical-align: top; }
th { font-weight: 600; } .short { white-space: nowrap; }
dt { font-weight: 600; margin-top: 0.6rem; } dd { margin: 0; }
.lead { font-size: 1.2rem; } .note { color: #666; font-size: 0.88rem; }
@media print { section { break-inside: avoid-page; } }
"""
