"""Side, position, and whether the preference changes with a factor such as audio or speed.

Participants are the sample throughout: every effect is computed for each of them, and tested by Student's t and by the
exact sign-flip test over participants. Where the same pair of levels was shown under both values of the factor, the
differences also go through `study.headline`, which allows for the choice of the pairs.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
import pandas as pd
from scipy import stats

from study.binomial import holm
from study.clusters import ClusteredShare, clustered_share, t_interval
from study.errors import InputError
from study.headline import Headline, headline
from study.responses import Answers, Choices, choices_from


@dataclasses.dataclass(frozen=True)
class Effect:
    """A mean over participants.

    Parameters
    ----------
    mean, low, high : mean of the participants' values and its interval (Student's t)
    p : two-sided, against no effect
    participants_n : whose values those are
    level : of the interval
    """

    mean: float
    low: float
    high: float
    p: float
    participants_n: int
    level: float = 0.95


@dataclasses.dataclass(frozen=True)
class Interaction:
    """How preference differs between two values of a factor, second minus first.

    Parameters
    ----------
    factor, first, second : column and its two values
    levels : one row per level: level, share_first, share_second (of its trials in which it was chosen), difference,
        low, high, p, p_holm (mean over participants, Student's t)
    p_levels : that no level's share changes (Hotelling's T^2 over participants)
    sticky : change of the share of levels above the least in trials against the least
    higher : change of the share of the higher level, all trials
    higher_sticky : the same, in trials among levels above the least
    matched_sticky, matched_higher, matched_higher_sticky : the same three in trials whose pair was shown under both
        values, tested over participants and pairs; None where nothing matches or too little does
    left_out : participants who answered fewer of the actions than most, or under one value only
    """

    factor: str
    first: object
    second: object
    levels: pd.DataFrame
    p_levels: float
    sticky: Effect
    higher: Effect
    higher_sticky: Effect
    matched_sticky: Headline | None
    matched_higher: Headline | None
    matched_higher_sticky: Headline | None
    left_out: tuple[str, ...]


def side_effect(answers: Answers, *, level: float = 0.95) -> ClusteredShare | None:
    """Share of choices of the left video, ties counted half; None if the sides are not known."""
    answers = answers.tests
    if not answers.sides_known:
        return None
    return clustered_share(answers.left_chosen(), level=level)


def position_effect(answers: Answers, a, b, *, level: float = 0.95) -> Effect | None:
    """Change of the share of `a` from the first to the last trial of a session; None if the order is not known.

    Each participant's straight line of share by position (0 first, 1 last test trial), mean over participants.
    """
    answers = answers.tests
    if not answers.positions_known:
        return None
    trial = answers.table["trial"]
    by_person = trial.groupby(answers.table["participant"])
    first, last = by_person.transform("min"), by_person.transform("max")
    choices = answers.choices(a, b)
    at = ((trial - first) / (last - first).where(last > first))[choices.table.index].to_numpy(dtype=float)
    slopes = []
    for person in range(len(choices.persons)):
        mine = choices.person == person
        x = at[mine]
        if len(x) > 1 and np.ptp(x) > 0:
            x = x - x.mean()
            slopes.append(x @ choices.y[mine] / (x @ x))
    return _mean(np.array(slopes), level)


def interaction(
    answers: Answers,
    factor: str,
    first,
    second,
    *,
    matches: Mapping[str, str] | None = None,
    level: float = 0.95,
    draws: int = 4999,
    seed: int = 0,
) -> Interaction:
    """How preference changes from `first` to `second` of a column of the answers.

    Parameters
    ----------
    matches : which action under `second` belongs to which under `first` ({"open_fast": "open_slow"}), for a factor that
        goes with the action; None: the same action
    draws : of the headline test

    Raises
    ------
    InputError : an unknown column or value, or fewer than three participants with answers under both values
    """
    answers = answers.tests
    both = answers.where(**{factor: [first, second]})
    table = both.table
    second_rows = table[factor].astype(str).isin([str(second)])
    home = table["action"].replace(dict(matches)) if matches else table["action"]
    shared = set(home[second_rows]) & set(home[~second_rows])
    if factor != "speed" or matches:  # only actions that were shown under both values
        table, second_rows, home = (one[home.isin(shared)] for one in (table, second_rows, home))
    if table.empty:
        raise InputError(f"expected actions shown with {factor} {first} and with {factor} {second}, got none")
    shown = table.drop_duplicates(["participant", factor, "action"]).groupby("participant").size()
    whole = shown == shown.max()
    if whole.mean() < 0.5:  # a design in which everybody sees a part: who saw both values will do
        whole = table.groupby("participant")[factor].agg(lambda values: len(values.unique()) == 2)
    left_out = tuple(name for name in answers.participants if not whole.get(name, False))
    keep = ~table["participant"].isin(left_out)
    table, second_rows, home = table[keep], second_rows[keep], home[keep]
    if table["participant"].nunique() < 3:
        raise InputError(f"expected at least 3 participants who saw all actions with {factor} {first} and {second}")
    part = dataclasses.replace(answers, table=table)
    sticky, least = answers.sticky()
    sides = {
        "sticky": part.choices(sticky, least),
        "higher": part.higher_chosen(),
        "higher_sticky": part.where(level=sticky).higher_chosen() if len(sticky) > 1 else None,
    }
    effects, matched = {}, {}
    for name, choices in sides.items():
        if choices is None or not len(choices.y):
            effects[name], matched[name] = _mean(np.empty(0), level), None
            continue
        late = second_rows[choices.table.index].to_numpy()
        effects[name] = _mean(_differences(choices, late), level)
        matched[name] = _matched(choices, late, home, level, draws, seed)
    levels, p_levels = _by_level(part, second_rows, level)
    return Interaction(
        factor,
        first,
        second,
        levels,
        p_levels,
        effects["sticky"],
        effects["higher"],
        effects["higher_sticky"],
        matched["sticky"],
        matched["higher"],
        matched["higher_sticky"],
        left_out,
    )


def _differences(choices: Choices, late: np.ndarray) -> np.ndarray:
    """(I,) mean of y where late minus mean where not, of participants with both."""
    n = len(choices.persons)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = [
            np.bincount(choices.person[rows], choices.y[rows], n) / np.bincount(choices.person[rows], minlength=n)
            for rows in (late, ~late)
        ]
    found = means[0] - means[1]
    return found[np.isfinite(found)]


def _matched(choices: Choices, late: np.ndarray, home: pd.Series, level, draws, seed) -> Headline | None:
    """The headline test of the differences, second minus first, of every participant and every pair of levels."""
    table = choices.table
    low = np.minimum(*(table[side].map(str).to_numpy(dtype=object) for side in ("level_left", "level_right")))
    high = np.maximum(*(table[side].map(str).to_numpy(dtype=object) for side in ("level_left", "level_right")))
    keys = pd.DataFrame({"person": choices.person, "home": home[table.index].to_numpy(), "low": low, "high": high})
    other = [c for c in ("action", "audio") if table.groupby(late)[c].nunique().max() > 1]
    if "audio" in other and set(table["audio"][late]) == set(table["audio"][~late]):
        keys["audio"] = table["audio"].to_numpy()
    keys["late"], keys["y"] = late, choices.y
    by = [c for c in keys if c not in ("late", "y")]
    wide = keys.pivot_table(index=by, columns="late", values="y", aggfunc="mean")
    if wide.shape[1] < 2:
        return None
    wide = wide.dropna()
    y = (wide[True] - wide[False]).to_numpy()
    names = wide.reset_index()
    items, item_names = pd.factorize(pd.MultiIndex.from_frame(names[[c for c in by if c != "person"]]))
    persons, person_names = pd.factorize(names["person"])
    pairs = Choices(y, persons, items, tuple(map(str, person_names)), tuple(map(str, item_names)), names)
    try:
        return headline(pairs, null=0.0, level=level, draws=draws, seed=seed)
    except InputError:  # too few
        return None


def _by_level(part: Answers, second_rows: pd.Series, level: float) -> tuple[pd.DataFrame, float]:
    """Each level's share of its trials by value of the factor, and Hotelling's T^2 of the differences."""
    table, levels, people = part.table, part.levels_shown, part.participants
    differences, rows = [], []
    for one in levels:
        mine = table[(table["level_left"] == one) ^ (table["level_right"] == one)]
        code = np.where(mine["level_left"] == one, mine["left"], mine["right"])
        y = np.where(mine["chosen"] == "", 0.5, (mine["chosen"] == code).astype(float))
        late = second_rows[mine.index].to_numpy()
        choices = choices_from(mine, y)
        found = _differences(choices, late)
        mean = _mean(found, level)
        rows.append((one, y[~late].mean(), y[late].mean(), mean.mean, mean.low, mean.high, mean.p))
        differences.append(found)
    frame = pd.DataFrame(rows, columns=["level", "share_first", "share_second", "difference", "low", "high", "p"])
    frame["p_holm"] = holm(frame["p"])
    if any(len(one) != len(people) for one in differences):
        return frame, np.nan
    return frame, hotelling_p(np.array(differences).T)


def hotelling_p(x: np.ndarray) -> float:
    """p of "the means of all columns of x (I, K) are 0", by Hotelling's T^2; columns that add up are taken once.

    Hotelling, Annals of Mathematical Statistics 2, 1931. NaN with too few rows.
    """
    values, vectors = np.linalg.eigh(np.cov(x, rowvar=False).reshape(x.shape[1], -1))
    keep = values > 1e-9 * max(values.max(), 1e-300)
    rows_n, columns_n = len(x), int(keep.sum())
    if rows_n <= x.shape[1] or not columns_n:
        return np.nan
    mean = x.mean(0) @ vectors[:, keep]
    t2 = rows_n * (mean**2 / values[keep]).sum()
    return float(stats.f.sf(t2 * (rows_n - columns_n) / (columns_n * (rows_n - 1)), columns_n, rows_n - columns_n))


def _mean(values: np.ndarray, level: float) -> Effect:
    n = len(values)
    if n < 2:
        return Effect(float(values.mean()) if n else np.nan, np.nan, np.nan, np.nan, n, level)
    low, high, p = t_interval(values.mean(), values.std(ddof=1) / np.sqrt(n), n - 1, level)
    return Effect(float(values.mean()), float(low), float(high), float(p), n, level)
