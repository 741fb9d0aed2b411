"""The whole analysis of a study in one call, and as JSON."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pandas as pd

from study.atomic import whole_file
from study.binomial import clopper_pearson, p_at_least, p_two_sided, share_to_ratio
from study.bradley_terry import Strengths, strengths
from study.clusters import ClusteredShare, clustered_share
from study.consistency import consistency, heterogeneity_p, participants
from study.effects import Effect, Interaction, interaction, position_effect, side_effect
from study.errors import InputError
from study.headline import Headline, headline
from study.mixed import gee, mixed_logit, statsmodels_installed
from study.replication import check_statements, replicate_thesis
from study.responses import Answers, thesis_answers
from study.tables import grouped, level_pairs
from study.verdicts import verdicts

DRAWS = 19_999


@dataclasses.dataclass(frozen=True)
class Analysis:
    """What a study says. a is a level above the least ("sticky"), b the least ("none"), unless a table says otherwise.

    Parameters
    ----------
    answers : those that were analysed, test trials only, exclusions done
    headline : a against b, other participants and other pairs allowed for; None with too few of either
    tests : the same question by every test, one row each: test, sample (what could have been otherwise), share, ratio,
        low, high (of the share), p (two-sided but for the first)
    pairs : every pair of levels (`study.tables.level_pairs`)
    groups : a against b by action, audio and speed: grouping, and the columns of `study.tables.grouped`
    strengths : Bradley-Terry; None where levels were not compared
    participants, heterogeneity_p, consistency : of `study.consistency`
    side, position : of `study.effects`; None where not known
    interactions : by audio and by speed, where the study has both values
    exclusions : one row per participant with catch trials: participant, catch_n, wrong_n, excluded
    replication, statements, verdicts : the thesis's numbers, words and conclusions; None for other answers
    notes : sentences on what could not be done, and why
    level, seed, draws : settings
    """

    answers: Answers
    headline: Headline | None
    tests: pd.DataFrame
    pairs: pd.DataFrame
    groups: pd.DataFrame
    strengths: Strengths | None
    participants: pd.DataFrame
    heterogeneity_p: float
    consistency: pd.DataFrame
    side: ClusteredShare | None
    position: Effect | None
    interactions: dict[str, Interaction]
    exclusions: pd.DataFrame
    replication: pd.DataFrame | None
    statements: pd.DataFrame | None
    verdicts: pd.DataFrame | None
    notes: tuple[str, ...]
    level: float
    seed: int
    draws: int

    def to_dict(self) -> dict:
        """All results as plain numbers, words, lists and dicts; None for NaN."""
        found = {
            "source": self.answers.source,
            "answers_n": len(self.answers),
            "participants_n": len(self.answers.participants),
            "levels": list(self.answers.levels),
        }
        for field in dataclasses.fields(self):
            if field.name != "answers":
                found[field.name] = _plain(getattr(self, field.name))
        return found

    def save(self, path: str | Path) -> Path:
        """Write `to_dict` as JSON; same answers and settings, same bytes."""
        with whole_file(path) as part:
            part.write_text(json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        return Path(path)


def analyse(
    answers: Answers | None = None,
    *,
    max_wrong_n: int | None = None,
    level: float = 0.95,
    seed: int = 0,
    draws: int = DRAWS,
) -> Analysis:
    """Everything that can be said about the answers.

    Parameters
    ----------
    answers : `load_answers(...)`; None: the thesis's, with its replication and the verdicts on its conclusions
    max_wrong_n : leave out participants with more wrong catch trials than this; None: nobody. Choose it before looking
    level : of all intervals
    seed, draws : of the headline test's random numbers; all others follow from the seed

    Raises
    ------
    InputError : no answers to test trials, fewer than two levels, or settings out of range
    """
    if not 0 < level < 1:
        raise InputError(f"expected a confidence level between 0 and 1, such as 0.95, got {level}")
    if draws < 99:
        raise InputError(f"expected at least 99 draws, got {draws}")
    bundled = answers is None
    answers = thesis_answers() if bundled else answers
    answers, exclusions = _exclude(answers, max_wrong_n)
    answers = answers.tests
    if not len(answers):
        raise InputError("expected answers to test trials, got none; are all practice, catch trials or left out?")
    a, b = answers.sticky()
    notes: list[str] = []
    overall = _headline(answers.choices(a, b), notes, level=level, draws=draws, seed=seed)
    by_set = _by_video_set(answers, a, b, level, draws, seed)
    pairs = level_pairs(answers, level=level, seed=seed, draws=draws // 2)
    try:
        fitted = strengths(answers, level=level, seed=seed)
    except InputError as error:
        fitted = None
        notes.append(f"No strengths per level: {error}.")
    people, orderly = participants(answers, a, b), consistency(answers)
    differ_p = heterogeneity_p(answers, a, b, seed=seed)
    interactions = _interactions(answers, level, draws // 4, seed, notes)
    if not answers.sides_known:
        notes.append("The side on which a video was shown is not known: no preference for a side can be computed.")
    if not answers.positions_known:
        notes.append("The order of the trials is not known: no effect of the position can be computed.")
    if bundled:
        checked = {
            "replication": replicate_thesis(answers),
            "statements": check_statements(answers),
            "verdicts": verdicts(
                overall=overall,
                by_video_set=by_set,
                pairs=pairs,
                people=people,
                heterogeneity_p=differ_p,
                consistency=orderly,
                **interactions,
            ),
        }
    else:
        checked = dict.fromkeys(("replication", "statements", "verdicts"))
    return Analysis(
        answers,
        overall,
        _tests(answers, a, b, overall, by_set, level, seed, notes),
        pairs,
        _groups(answers, a, b, level, seed),
        fitted,
        people,
        differ_p,
        orderly,
        side_effect(answers, level=level),
        position_effect(answers, a, b, level=level),
        interactions,
        exclusions,
        *checked.values(),
        tuple(notes),
        level,
        seed,
        draws,
    )


def _exclude(answers: Answers, max_wrong_n: int | None) -> tuple[Answers, pd.DataFrame]:
    if max_wrong_n is not None and max_wrong_n < 0:
        raise InputError(f"expected 0 or more wrong catch trials, got {max_wrong_n}")
    catch = answers.table[answers.table["kind"] == "catch"]
    columns = ["participant", "catch_n", "wrong_n", "excluded"]
    if catch.empty or "expected" not in catch:
        if max_wrong_n is not None:
            raise InputError("expected catch trials with a column expected to leave participants out by, got none")
        return answers, pd.DataFrame(columns=columns)
    wrong = (catch["chosen"] != catch["expected"]).groupby(catch["participant"]).agg(["size", "sum"])
    rows = []
    for name in answers.participants:
        if name in wrong.index:
            n, wrong_n = map(int, wrong.loc[name])
            rows.append((name, n, wrong_n, max_wrong_n is not None and wrong_n > max_wrong_n))
    table = pd.DataFrame(rows, columns=columns)
    out = set(table.loc[table["excluded"], "participant"])
    return dataclasses.replace(answers, table=answers.table[~answers.table["participant"].isin(out)]), table


def _headline(choices, notes: list[str], **settings) -> Headline | None:
    try:
        found = headline(choices, **settings)
    except InputError as error:
        notes.append(f"No headline test: {error}.")
        return None
    if found.caution:
        notes.append(f"Headline test: {found.caution}.")
    return found


def _by_video_set(answers: Answers, a, b, level: float, draws: int, seed: int) -> Headline | None:
    """The headline test with action and audio in place of the pair, since the pairs of an action share their videos."""
    choices = answers.choices(a, b)
    names, item = np.unique(
        choices.table["action"] + choices.table["audio"].map({0: "", 1: " with audio"}), return_inverse=True
    )
    try:
        return headline(
            dataclasses.replace(choices, item=item, items=tuple(names)), level=level, draws=draws, seed=seed
        )
    except InputError:  # one action, or two
        return None


def _tests(answers, a, b, overall, by_set, level, seed, notes) -> pd.DataFrame:
    choices, found = answers.choices(a, b), answers.preference(a, b)
    if not len(choices.y):
        raise InputError(f"expected answers that put {b[0]} against another level, got none")
    clustered = clustered_share(choices, level=level, seed=seed)
    low, high = clopper_pearson(found.for_a, found.n, level)
    rows = [
        ("binomial, one-sided (thesis eq. 5.2)", "answers", found.share, low, high, p_at_least(found.for_a, found.n)),
        ("binomial, two-sided", "answers", found.share, low, high, p_two_sided(found.for_a, found.n)),
        ("Student's t", "participants", clustered.share, clustered.low, clustered.high, clustered.p_t),
        ("sign flips, exact", "participants", clustered.share, np.nan, np.nan, clustered.p_sign_flip),
        ("bootstrap", "participants", clustered.share, clustered.boot_low, clustered.boot_high, np.nan),
    ]
    for name, sample, model in (
        ("GEE", "participants", gee),
        ("mixed logit", "participants and pairs", mixed_logit),
    ):
        if model is gee and not statsmodels_installed():
            notes.append("No GEE: it needs statsmodels (pip install lipmetrics[statistics]).")
            continue
        try:
            one = model(choices, level=level)
        except InputError as error:
            notes.append(f"No {name}: {error}.")
            continue
        rows.append((name, sample, *(1 / (1 + np.exp(-x)) for x in (one.logit, one.low, one.high)), one.p))
    for one, sample in ((by_set, "participants and sets of videos"), (overall, "participants and pairs")):
        if one is not None:
            rows.append(("headline", sample, one.mean, one.low, one.high, one.p))
    table = pd.DataFrame(rows, columns=["test", "sample", "share", "low", "high", "p"])
    table.insert(3, "ratio", share_to_ratio(table["share"]))
    return table


def _groups(answers: Answers, a, b, level: float, seed: int) -> pd.DataFrame:
    """a against b in all, and by action, audio, speed, and action and audio, as far as they vary."""
    groupings = [(), ("action",), ("audio",), ("speed",), ("action", "audio")]
    frames = []
    for by in groupings:
        if all(len(answers.table[column].unique()) > 1 for column in by):
            one = grouped(answers, a, b, by, level=level, seed=seed)
            one = one.astype(dict.fromkeys(by, object))  # so that 0 and 1 stay whole numbers beside empty cells
            one.insert(0, "grouping", " and ".join(by) or "all")
            frames.append(one)
    table = pd.concat(frames, ignore_index=True)
    first = ["grouping", *(c for c in ("action", "audio", "speed") if c in table)]
    return table[[*first, *(c for c in table if c not in first)]]


def _interactions(answers: Answers, level, draws, seed, notes) -> dict[str, Interaction]:
    found = {}
    for factor in ("audio", "speed"):
        values = sorted(one for one in answers.table[factor].unique() if one != "")
        if len(values) != 2:
            continue
        if set(values) == {"fast", "slow"}:
            values = ["slow", "fast"]
        matches = answers.matches if factor == "speed" else None
        try:
            found[factor] = interaction(answers, factor, *values, matches=matches, level=level, draws=draws, seed=seed)
        except InputError as error:
            notes.append(f"No interaction with {factor}: {error}.")
    return found


def _plain(value):
    if isinstance(value, pd.DataFrame):
        return [{str(k): _plain(v) for k, v in row.items()} for row in value.to_dict("records")]
    if dataclasses.is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        if np.isnan(value):
            return None
        return str(value) if np.isinf(value) else value
    return value
