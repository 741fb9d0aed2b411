"""Counts, ratios, exact p-values and intervals for any grouping of the answers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from study.binomial import clopper_pearson, holm, p_at_least, p_two_sided, wilson
from study.clusters import clustered_share
from study.errors import InputError
from study.headline import headline
from study.responses import Answers

COUNTS = [
    "for_a",
    "for_b",
    "ties",
    "ratio",
    "share",
    "p_one_sided",
    "p_two_sided",
    "exact_low",
    "exact_high",
    "wilson_low",
    "wilson_high",
    "participants_n",
    "p",
    "low",
    "high",
    "boot_low",
    "boot_high",
    "method",
]


def count_row(answers: Answers, a, b, *, level: float = 0.95, seed: int = 0) -> dict:
    """One comparison of levels `a` against `b`, the columns `COUNTS`.

    share : for_a / (for_a + for_b), ties left out
    p_one_sided, p_two_sided, exact_low, exact_high, wilson_low, wilson_high : answers as independent coins
    p, low, high : the same with participants as the sample (Student's t, ties counted half); where nobody has more than
        one answer, or all have the same share, the exact binomial ones. `method` says which: participants or exact
    boot_low, boot_high : bootstrap over participants; NaN where the method is exact
    """
    choices = answers.choices(a, b)
    found = answers.preference(a, b)
    row = {"for_a": found.for_a, "for_b": found.for_b, "ties": found.ties, "ratio": found.ratio, "share": found.share}
    row["p_one_sided"], row["p_two_sided"] = p_at_least(found.for_a, found.n), p_two_sided(found.for_a, found.n)
    row["exact_low"], row["exact_high"] = clopper_pearson(found.for_a, found.n, level)
    row["wilson_low"], row["wilson_high"] = wilson(found.for_a, found.n, level)
    row["participants_n"] = len(choices.persons)
    row |= {"p": row["p_two_sided"], "low": row["exact_low"], "high": row["exact_high"], "method": "exact"}
    row["boot_low"] = row["boot_high"] = np.nan
    if len(choices.persons) > 1 and len(choices.y) > len(choices.persons):
        clustered = clustered_share(choices, level=level, seed=seed)
        if clustered.high > clustered.low:
            row |= {"p": clustered.p_t, "low": clustered.low, "high": clustered.high, "method": "participants"}
            row |= {"boot_low": clustered.boot_low, "boot_high": clustered.boot_high}
    return row


def grouped(
    answers: Answers, a, b, by: str | Sequence[str] = (), *, level: float = 0.95, seed: int = 0
) -> pd.DataFrame:
    """`count_row` for every value of the columns `by` (any columns of the answers), and Holm's p over the rows.

    Returns
    -------
    One row per group, in the order of the values: the columns `by`, `COUNTS` and p_holm (of `p`)

    Raises
    ------
    InputError : no such column
    """
    answers = answers.tests
    by = [by] if isinstance(by, str) else list(by)
    for column in by:
        answers.where(**{column: answers.table[column].unique() if column in answers.table else ""})  # for its message
    rows = []
    keys = answers.table[by].drop_duplicates().itertuples(index=False) if by else [()]
    for values in sorted(keys, key=lambda one: [_place(answers, c, v) for c, v in zip(by, one, strict=True)]):
        part = answers.where(**dict(zip(by, values, strict=True)))
        if len(part.choices(a, b).y):
            rows.append(dict(zip(by, values, strict=True)) | count_row(part, a, b, level=level, seed=seed))
    table = pd.DataFrame(rows, columns=[*by, *COUNTS])
    table["p_holm"] = holm(table["p"])
    return table


def level_pairs(
    answers: Answers, *, level: float = 0.95, seed: int = 0, draws: int | None = None, by: str | Sequence[str] = ()
) -> pd.DataFrame:
    """Every pair of levels, a the higher, and Holm's p over the pairs (within each group of `by`).

    With `draws` and without `by`, also p_headline, headline_low, headline_high of `study.headline`, and
    p_headline_holm: NaN where there are too few participants or pairs of videos.

    Returns
    -------
    One row per pair (and group): level_a, level_b, the columns `COUNTS`, p_holm
    """
    answers = answers.tests
    levels = answers.levels
    frames = []
    for i, low in enumerate(levels):
        for high in levels[i + 1 :]:
            one = grouped(answers, high, low, by, level=level, seed=seed).drop(columns="p_holm")
            one.insert(0, "level_a", high)
            one.insert(1, "level_b", low)
            if draws and not by:
                one = one.assign(**_headline(answers, high, low, level, draws, seed))
            frames.append(one)
    frames = [one for one in frames if len(one)]
    if not frames:
        raise InputError("expected answers that put two levels against one another, got none")
    table = pd.concat(frames, ignore_index=True)
    by = [by] if isinstance(by, str) else list(by)
    for column in ("p", "p_headline") if draws and not by else ("p",):
        groups = table.groupby(by)[column] if by else None
        table[f"{column}_holm"] = groups.transform(lambda p: holm(p.to_numpy())) if by else holm(table[column])
    return table


def _headline(answers: Answers, a, b, level: float, draws: int, seed: int) -> dict:
    try:
        found = headline(answers.choices(a, b), level=level, draws=draws, seed=seed)
    except InputError:  # too few
        return dict.fromkeys(("p_headline", "headline_low", "headline_high"), np.nan)
    return {"p_headline": found.p, "headline_low": found.low, "headline_high": found.high}


def _place(answers: Answers, column: str, value):
    if column == "action":
        return answers.actions.index(value)
    if column == "participant":
        return answers.participants.index(value)
    return value
