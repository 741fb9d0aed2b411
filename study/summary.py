"""An analysis in plain sentences and tables of text, for the terminal, the report and the documentation.

`a` are the levels above the least, `b` is the least, as in `study.analysis`.
"""

from __future__ import annotations

import dataclasses
import html
import itertools

import numpy as np
import pandas as pd

from study.analysis import Analysis
from study.effects import Effect, Interaction
from study.headline import Headline
from study.printed import between, counted, level_name, level_names, number, p_text, percent, points

SAMPLES = {
    "answers": "every answer an independent coin; holds for these participants and pairs only, if at all",
    "participants": "other participants could have come; the pairs stay as they are",
    "participants and pairs": "other participants could have come and other pairs could have been shown",
    "participants and sets of videos": "other participants and other sets of videos (an action with or without audio)",
}


SHORT = 14  # letters of a cell that is kept on one line


@dataclasses.dataclass(frozen=True)
class Table:
    """Rows of text.

    Parameters
    ----------
    head : names of the columns
    rows : cells, as many as the head has
    method : how the numbers come about, for beneath the table
    """

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    method: str = ""

    def text(self, indent: str = "  ") -> str:
        """Aligned columns, two spaces apart; the last column as long as it is."""
        lines = [self.head, *self.rows] if any(self.head) else list(self.rows)
        widths = [max(map(len, column)) for column in itertools.islice(zip(*lines, strict=True), len(self.head) - 1)]
        found = []
        for line in lines:
            cells = [cell.ljust(width) for cell, width in zip(line, widths, strict=False)]
            found.append((indent + "  ".join([*cells, line[-1]])).rstrip())
        return "\n".join(found)

    def html(self) -> str:
        """A table and its method beneath."""

        def line(cells, tag: str) -> str:
            if cells[0] and len(cells) > 1 and not any(cells[1:]):  # a heading between rows
                return f'<tr><th colspan="{len(cells)}">{html.escape(cells[0])}</th></tr>'
            short = [' class="short"' if len(cell) <= SHORT else "" for cell in cells]
            marked = zip(cells, short, strict=True)
            return "<tr>" + "".join(f"<{tag}{kind}>{html.escape(cell)}</{tag}>" for cell, kind in marked) + "</tr>"

        head = f"<thead>{line(self.head, 'th')}</thead>" if any(self.head) else ""
        body = "\n".join(line(row, "td") for row in self.rows)
        note = f'\n<p class="note">{html.escape(self.method)}</p>' if self.method else ""
        return f'<div class="wide"><table>{head}<tbody>\n{body}\n</tbody></table></div>{note}'

    def markdown(self) -> str:
        """A table of Markdown, without the method."""
        lines = [self.head, ("---",) * len(self.head), *self.rows]
        return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines) + "\n"


def sides(found: Analysis) -> tuple[str, str]:
    """Names of a and b: `levels 4, 7, 10` and `level 0`."""
    a, b = found.answers.sticky()
    return level_names(a), level_names(b)


# -- sentences --------------------------------------------------------------------------------------------------------


def what_was_asked(found: Analysis) -> list[str]:
    """Who answered what, a sentence each."""
    table = found.answers.table
    per_person = table.groupby("participant").size()
    least, most = int(per_person.min()), int(per_person.max())
    each = f"{least} each" if least == most else f"{least} to {most} each"
    ties = int((table["chosen"] == "").sum())
    said = [
        f"{counted(len(table), 'answer')} of {counted(len(per_person), 'participant')} ({each}) to "
        f"{counted(table['pair'].nunique(), 'pair')} of videos"
        + (f", {counted(ties, 'tie')} among them" if ties else "")
        + "; practice and catch trials are not counted.",
        f"{len(found.answers.levels)} levels: {', '.join(_plain(level) for level in found.answers.levels)}.",
    ]
    actions = [action for action in found.answers.actions if action]
    if len(actions) > 1:
        audio = len(set(table["audio"])) > 1
        said.append(
            f"{len(actions)} actions: {', '.join(action.replace('_', ' ') for action in actions)}"
            + (", some with audio." if audio else ".")
        )
    out = int(found.exclusions["excluded"].sum()) if len(found.exclusions) else 0
    if out:
        said.append(f"Left out because of wrong catch trials: {counted(out, 'participant')}.")
    return said


def in_short(found: Analysis) -> list[str]:
    """The main result first, then what goes with it, a sentence each."""
    a, b = sides(found)
    overall = found.groups.iloc[0]
    total = int(overall["for_a"] + overall["for_b"])
    several = len(found.answers.sticky()[0]) > 1
    name = a[0].upper() + a[1:] if a.startswith("level") else a
    chosen = f"{name} {'were' if several else 'was'} chosen over {b}"
    counts = f"{int(overall['for_a'])} of {total} answers, {percent(overall['share'])}, a preference ratio of "
    said = [f"{chosen} in {counts}{number(overall['ratio'])}."]
    if found.headline is not None:
        one = found.headline
        sure = "more than chance" if one.p <= 1 - one.level else "no more than chance may bring"
        said[0] = (
            f"{said[0][:-1]}: {sure}, p = {p_text(one.p)}, {percent(one.level)} interval of the share "
            f"{between(one.low, one.high)}."
        )
        said.append(
            "This p and interval are those of the headline test: they allow for other participants and for other "
            "pairs of videos than these."
        )
        if one.caution:
            said.append(f"Caution: {one.caution}.")
    by_person = _test(found, "Student's t")
    if by_person is not None and np.isfinite(by_person["p"]):
        said.append(
            f"For these pairs alone, with other participants: {between(by_person['low'], by_person['high'])}, "
            f"p = {p_text(by_person['p'])} (Student's t over participants)."
        )
    if total > len(found.participants) > 1:
        coin = _test(found, "binomial, two-sided")
        said.append(
            f"The binomial test would say p = {p_text(coin['p'])}. It takes every answer for an independent coin; "
            "answers of one participant, and answers about one pair, hang together, so it is surer than the answers "
            "allow."
        )
    if found.strengths is not None and len(found.answers.levels) > 2:
        table = found.strengths.table
        best = table.loc[table["rank"].idxmin()]
        said.append(
            f"The strongest level is {_plain(best['level'])}, also in {percent(best['first'])} of bootstrap samples "
            "of the participants (Bradley-Terry)."
        )
    said += [_interaction_sentence(one, a) for one in found.interactions.values()]
    if np.isfinite(found.heterogeneity_p) and total > len(found.participants):
        shares = found.participants["share"]
        differ = "differ" if found.heterogeneity_p <= 0.05 else "do not differ more than chance lets them"
        said.append(
            f"Participants {differ}: from {percent(shares.min())} to {percent(shares.max())} for {a} "
            f"(p = {p_text(found.heterogeneity_p)}, answers to each pair dealt anew)."
        )
    return said


def _interaction_sentence(one: Interaction, a: str) -> str:
    does = "changes" if one.p_levels <= 0.05 else "is not shown to change"
    return (
        f"Which levels are chosen {does} with {one.factor}: p = {p_text(one.p_levels)} over participants "
        f"(Hotelling's T²); the share for {a} changes by {_effect(one.sticky)} percentage points from "
        f"{_value(one, one.first)} to {_value(one, one.second)} (p = {p_text(one.sticky.p)}, Student's t)."
    )


def side_and_position(found: Analysis) -> list[str]:
    """Sentences on the side and on the position in the session, or why there are none."""
    said = []
    if found.side is not None:
        one = found.side
        by = f" ({between(one.low, one.high)}, p = {p_text(one.p_t)}; Student's t over participants)"
        left = f"The left video was chosen in {percent(one.share, 1)} of the answers"
        said.append(f"{left}{by if one.participants_n > 1 else ''}.")
    if found.position is not None and found.position.participants_n:
        said.append(
            f"From the first to the last trial of a session the share for {sides(found)[0]} changes by "
            f"{_effect(found.position)} percentage points (p = {p_text(found.position.p)}; mean of the participants' "
            "straight lines, Student's t)."
        )
    return said + [note for note in found.notes if note.startswith(("The side", "The order"))]


# -- tables -----------------------------------------------------------------------------------------------------------


def tests(found: Analysis) -> Table:
    """The same question by every test."""
    rows = [
        (
            f"{row.test}, sets" if row.sample.endswith("sets of videos") else row.test,
            percent(row.share),
            number(row.ratio),
            between(row.low, row.high),
            p_text(row.p),
            SAMPLES.get(row.sample, row.sample),
        )
        for row in found.tests.itertuples()
    ]
    method = (
        f"Share and ratio for {sides(found)[0]}. Intervals are {percent(found.level)}; p is two-sided but for the "
        "first row. GEE and the mixed logit are turned from log odds to shares; the mixed logit is about the middle "
        "participant and pair, not the mean."
    )
    return Table(("test", "share", "ratio", "interval", "p", "what could have been otherwise"), tuple(rows), method)


def pairs(found: Analysis) -> Table:
    """Every pair of levels."""
    has_headline = "p_headline" in found.pairs and found.pairs["p_headline"].notna().any()
    head = ["", "chosen", "ratio", "share", "exact", "participants", "p", "p, Holm"]
    rows = []
    for row in found.pairs.to_dict("records"):
        cells = [f"{_plain(row['level_a'])} over {_plain(row['level_b'])}", *_count_cells(row)]
        if has_headline:
            cells += [between(row["headline_low"], row["headline_high"])]
            cells += [p_text(row["p_headline"]), p_text(row["p_headline_holm"])]
        rows.append(tuple(cells))
    if has_headline:
        head += ["headline", "p", "p, Holm"]
    method = (
        "Share of the first level. exact: Clopper-Pearson, answers as independent coins; participants: Student's t "
        "over participants with its p; headline: participants and pairs of videos. Holm: corrected for the number "
        "of rows."
    )
    return Table(tuple(head), tuple(rows), method)


def groups(found: Analysis) -> Table:
    """a against b by action, audio and speed."""
    rows, before = [], "all"
    for row in found.groups.to_dict("records"):
        if row["grouping"] != before:
            before = row["grouping"]
            rows.append((f"by {before}", *[""] * 7))
        rows.append((group_name(row), *_count_cells(row)))
    method = (
        f"Share for {sides(found)[0]} against {sides(found)[1]}. exact: Clopper-Pearson, answers as independent coins; "
        "participants: Student's t over participants with its p, Holm within each block of rows."
    )
    if found.interactions:
        factors = " and ".join(found.interactions)
        method += (
            f" Rows by {factors} may be about different actions; what {factors} change is tested on like against like."
        )
    return Table(("", "chosen", "ratio", "share", "exact", "participants", "p", "p, Holm"), tuple(rows), method)


def group_name(row: dict) -> str:
    """`all`, `puppy, audio`, `slow`: what a row of `Analysis.groups` is about."""
    by = str(row["grouping"]).split(" and ")
    names = []
    for column in by if by != ["all"] else []:
        if column == "audio":
            names.append("audio" if int(row["audio"]) else "no audio")
        else:
            names.append(str(row[column]).replace("_", " "))
    return ", ".join(names) or "all"


def strengths(found: Analysis) -> Table:
    """Bradley-Terry strengths."""
    rows = [
        (
            _plain(row.level),
            number(row.strength),
            between(row.low, row.high, number) if row.Index else "-",
            percent(row.share),
            between(row.share_low, row.share_high) if row.Index else "-",
            str(row.rank),
            percent(row.first),
        )
        for row in found.strengths.table.itertuples()
    ]
    fit = found.strengths
    method = (
        "Strength: log odds against the least level, one number per level for all pairs (Bradley and Terry"
        + (", ties after Davidson" if fit.tie else "")
        + f"). Intervals: {percent(found.level)}, bootstrap over participants. chosen: how likely over the "
        "least level. first: in how many bootstrap samples the level is the strongest. "
        + (
            f"Whether one strength per level is enough: deviance {fit.misfit:.1f} on {fit.freedom} degrees of freedom, "
            f"p = {p_text(fit.p_misfit)}"
            + (" - it is not, the pairs disagree with one scale." if fit.p_misfit <= 0.05 else ".")
            if fit.freedom > 0
            else ""
        )
    )
    return Table(("level", "strength", "interval", "chosen", "interval", "rank", "first"), tuple(rows), method.strip())


def participants(found: Analysis) -> Table:
    """Every participant's preference and order."""
    order = found.consistency.set_index("participant")
    rows = []
    for row in found.participants.to_dict("records"):
        mine = order.loc[row["participant"]] if row["participant"] in order.index else None
        rows.append(
            (
                str(row["participant"]),
                f"{row['for_a']} of {row['for_a'] + row['for_b']}",
                percent(row["share"]),
                between(row["low"], row["high"]),
                p_text(row["p"]),
                p_text(row["p_holm"]),
                *(_triads(mine) if mine is not None else ("-", "-")),
            )
        )
    if "all" in order.index:
        rows.append(("all", "", "", "", "", "", *_triads(order.loc["all"])))
    method = (
        f"Share for {sides(found)[0]}; interval and p are exact binomial within the participant. circular: how often "
        "a was chosen over b, b over c and c over a, of the triads that could be, and how many a coin would give (a "
        "quarter); p: that a coin gives as few (Kendall and Babington Smith)."
    )
    return Table(("participant", "chosen", "share", "exact", "p", "p, Holm", "circular", "p"), tuple(rows), method)


def _triads(row) -> tuple[str, str]:
    if not row["triads"]:
        return "-", "-"
    return f"{int(row['circular'])} of {int(row['triads'])} (coin: {row['expected']:.3g})", p_text(row["p"])


def interaction_levels(one: Interaction) -> Table:
    """How often each level is chosen under both values of a factor."""
    rows = [
        (
            _plain(row.level),
            percent(row.share_first),
            percent(row.share_second),
            f"{points(row.difference)} ({between(row.low, row.high, points)})",
            p_text(row.p),
            p_text(row.p_holm),
        )
        for row in one.levels.itertuples()
    ]
    left_out = f" Left out, without answers to all of these actions: {', '.join(one.left_out)}." if one.left_out else ""
    method = (
        "Share of its trials in which the level was chosen; difference in percentage points, mean over "
        f"participants, Student's t; Holm over the levels. All levels at once: p = {p_text(one.p_levels)} "
        f"(Hotelling's T²).{left_out}"
    )
    head = ("level", _value(one, one.first), _value(one, one.second), "difference", "p", "p, Holm")
    return Table(head, tuple(rows), method)


def interaction_effects(one: Interaction) -> Table:
    """How three summary shares change with a factor, over participants and over participants and pairs."""
    names = {
        "sticky": "a level above the least chosen over the least",
        "higher": "the higher of two levels chosen",
        "higher_sticky": "the same, the least level left out",
    }
    rows = []
    for name, words in names.items():
        effect, matched = getattr(one, name), getattr(one, f"matched_{name}")
        if not effect.participants_n:
            continue
        rows.append(
            (
                words,
                _effect(effect),
                p_text(effect.p),
                "-" if matched is None else _effect(matched),
                "-" if matched is None else p_text(matched.p),
            )
        )
    method = (
        f"Percentage points, {_value(one, one.second)} minus {_value(one, one.first)}, with intervals. participants: "
        "Student's t; participants and pairs: headline test on the pairs that were shown under both."
    )
    return Table(("change", "participants", "p", "participants and pairs", "p"), tuple(rows), method)


def exclusions(found: Analysis) -> Table:
    """Catch trials of every participant."""
    rows = [
        (str(row.participant), f"{row.wrong_n} of {row.catch_n}", "left out" if row.excluded else "kept")
        for row in found.exclusions.itertuples()
    ]
    return Table(("participant", "wrong catch trials", ""), tuple(rows))


def replication(found: pd.DataFrame) -> Table:
    """The thesis's printed numbers beside those of its answers."""
    rows = []
    for row in found.to_dict("records"):
        counts = "" if pd.isna(row["for_a"]) else f"{int(row['for_a'])}:{int(row['for_b'])}"
        value = row["reconstructed"]
        if value is None or pd.isna(value):
            again = ""
        else:
            again = p_text(value) if str(row["quantity"]).endswith("p") else number(float(value), 3)
        rows.append(
            (
                row["place"],
                row["quantity"],
                row["printed"],
                row["from_answers"],
                counts,
                "yes" if row["agrees"] else "no",
                again,
                row["reason"],
            )
        )
    head = ("where", "what", "printed", "from the answers", "counts", "equal", "by that reason", "why it differs")
    method = (
        "from the answers: all answers, p one-sided P(>= r) as eq. 5.2 defines it, to the digits that the thesis "
        "prints. by that reason: the number with the error that the last column names made on purpose; it comes out "
        "as printed. counts: for the first against the second."
    )
    return Table(head, tuple(rows), method)


def statements(found: pd.DataFrame) -> Table:
    """What the thesis says in words, beside the counts."""
    rows = [
        (row.place, row.printed, "yes" if row.holds else "no", row.counts, row.remark) for row in found.itertuples()
    ]
    method = "counts point that way: no more than that; the table of conclusions has the tests."
    return Table(("where", "in words", "counts point that way", "counts", "remark"), tuple(rows), method)


def verdicts(found: pd.DataFrame) -> Table:
    """Which conclusions survive."""
    rows = [
        (row.conclusion, row.survives, row.estimate, p_text(row.p), row.test, row.comment, row.place)
        for row in found.itertuples()
    ]
    head = ("the thesis concludes", "survives", "estimate", "p", "test", "remark", "where")
    return Table(head, tuple(rows))


# -- cells ------------------------------------------------------------------------------------------------------------


def _count_cells(row: dict) -> list[str]:
    ties = f", {counted(int(row['ties']), 'tie')}" if row["ties"] else ""
    return [
        f"{int(row['for_a'])} of {int(row['for_a'] + row['for_b'])}{ties}",
        number(row["ratio"]),
        percent(row["share"]),
        between(row["exact_low"], row["exact_high"]),
        between(row["low"], row["high"]) if row["method"] == "participants" else "-",
        p_text(row["p"]),
        p_text(row["p_holm"]),
    ]


def _test(found: Analysis, name: str):
    rows = found.tests[found.tests["test"] == name]
    return rows.iloc[0] if len(rows) else None


def _effect(one: Effect | Headline) -> str:
    return f"{points(one.mean)} ({between(one.low, one.high, points)})"


def _value(one: Interaction, value) -> str:
    if one.factor == "audio":
        return "audio" if int(value) else "no audio"
    return str(value)


def _plain(level) -> str:
    return level_name(level).removeprefix("level ")
