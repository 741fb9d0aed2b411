"""Does a participant's choosing hang together: circular triads, and whether participants differ at all."""

from __future__ import annotations

import functools
import itertools

import numpy as np
import pandas as pd

from study.binomial import clopper_pearson, holm, p_two_sided
from study.responses import Answers

ENUMERATED_N = 15  # pairs of a group up to which all answers are gone through; above, as many as are drawn
DRAWN_N = 20_000


def consistency(answers: Answers) -> pd.DataFrame:
    """Circular triads (a over b, b over c, c over a) of every participant, against coin flips.

    Only levels within one action and one audio are compared. Kendall and Babington Smith, Biometrika 31, 1940. Triads
    with a tie or without all three answers do not count; of pairs answered more than once the first answer counts.

    Returns
    -------
    One row per participant and a last one, "all": participant, triads (that could be circular), circular, expected (by
    coin flips: a quarter of them), zeta (1: none circular, 0: as many as by coin flips in the mean; negative: more),
    p (that coin flips give as few, exact up to six levels, else by 20,000 draws).
    """
    answers = answers.tests
    levels = {level: i for i, level in enumerate(answers.levels)}
    beats = {name: {} for name in answers.participants}  # participant: group: pair of levels: the lower one won
    columns = ["participant", "action", "audio", "level_left", "level_right", "left", "chosen"]
    for participant, action, audio, left, right, code, chosen in answers.table[columns].itertuples(index=False):
        left, right = levels[left], levels[right]
        if chosen and left != right:
            pair = (min(left, right), max(left, right))
            beats[participant].setdefault((action, audio), {}).setdefault(pair, (chosen == code) == (left < right))
    rows, everyone = [], np.ones(1)
    for participant, groups in beats.items():
        triads = circular = 0
        chance = np.ones(1)
        for group in groups.values():
            pairs = tuple(sorted(group))
            triples = _triples(pairs)
            if triples:
                triads += len(triples)
                circular += int(_circular(np.array([[group[pair] for pair in pairs]]), triples)[0])
                chance = np.convolve(chance, _by_chance(pairs))
        everyone = np.convolve(everyone, chance)
        rows.append((participant, triads, circular, _at_most(chance, circular) if triads else np.nan))
    found = pd.DataFrame(rows, columns=["participant", "triads", "circular", "p"])
    total = int(found["circular"].sum())
    found.loc[len(found)] = ["all", int(found["triads"].sum()), total, _at_most(everyone, total)]
    found["expected"] = found["triads"] / 4
    found["zeta"] = 1 - found["circular"] / found["expected"].where(found["triads"] > 0)
    return found[["participant", "triads", "circular", "expected", "zeta", "p"]]


def participants(answers: Answers, a, b) -> pd.DataFrame:
    """Each participant's choices of a level of `a` against one of `b`.

    Returns
    -------
    One row per participant: participant, for_a, for_b, ties, share, low, high (Clopper-Pearson), p (exact two-sided
    binomial: within one participant, answers to different pairs, taken as independent), p_holm
    """
    answers = answers.tests
    rows = []
    for participant in answers.participants:
        found = answers.where(participant=participant).preference(a, b)
        rows.append((participant, found.for_a, found.for_b, found.ties, found.share))
    table = pd.DataFrame(rows, columns=["participant", "for_a", "for_b", "ties", "share"])
    n = table["for_a"] + table["for_b"]
    table["low"], table["high"] = clopper_pearson(table["for_a"].to_numpy(), n.to_numpy())
    table["p"] = p_two_sided(table["for_a"].to_numpy(), n.to_numpy())
    table["p_holm"] = holm(table["p"])
    return table


def heterogeneity_p(answers: Answers, a, b, *, draws: int = 4999, seed: int = 0) -> float:
    """p of "all participants have the same preference": do participants' shares differ more than answers dealt anew?

    The answers to each pair are dealt anew among those who answered it, so that pairs may differ as they like; the
    statistic is the sum over participants of (answers for a - expected from the pairs)^2 / n.
    """
    choices = answers.tests.choices(a, b)
    persons_n = len(choices.persons)
    if persons_n < 2:
        return np.nan
    order = np.argsort(choices.item, kind="stable")
    y, person, item = choices.y[order], choices.person[order], choices.item[order]
    item_n = np.bincount(item)
    rest = y - (np.bincount(item, y) / item_n)[item]
    person_n = np.bincount(person, minlength=persons_n)
    member = np.zeros((len(y), persons_n))
    member[np.arange(len(y)), person] = 1

    def statistic(rest):
        return ((rest @ member) ** 2 / person_n).sum(-1)

    seen = statistic(rest)
    rng = np.random.default_rng(seed)
    count, done = 0, 0
    while done < draws:
        n = min(1000, draws - done)
        # sorted by item, then by a random key: a shuffle within every item
        dealt = np.argsort(item + rng.random((n, len(y))) * 0.999, axis=1)
        count += int((statistic(rest[dealt]) >= seen - 1e-9).sum())
        done += n
    return (1 + count) / (1 + draws)


@functools.lru_cache(maxsize=64)
def _triples(pairs: tuple) -> tuple:
    """(T) places of the pairs (i, j), (j, k), (i, k) of every triple i < j < k that is complete."""
    place = {pair: at for at, pair in enumerate(pairs)}
    ends = sorted({end for pair in pairs for end in pair})
    found = []
    for i, j, k in itertools.combinations(ends, 3):
        if (i, j) in place and (j, k) in place and (i, k) in place:
            found.append((place[i, j], place[j, k], place[i, k]))
    return tuple(found)


def _circular(wins: np.ndarray, triples: tuple) -> np.ndarray:
    """(B,) circular triads of tournaments wins (B, P), True where the first of the pair won."""
    ij, jk, ik = np.array(triples).T
    return ((wins[:, ij] == wins[:, jk]) & (wins[:, ij] != wins[:, ik])).sum(1)


@functools.lru_cache(maxsize=64)
def _by_chance(pairs: tuple) -> np.ndarray:
    """Probability of 0, 1, 2, ... circular triads of these pairs, by coin flips."""
    if len(pairs) <= ENUMERATED_N:
        wins = (np.arange(2 ** len(pairs))[:, None] >> np.arange(len(pairs))) & 1
    else:
        wins = np.random.default_rng(0).integers(0, 2, (DRAWN_N, len(pairs)))
    counts = np.bincount(_circular(wins, _triples(pairs)))
    return counts / counts.sum()


def _at_most(chance: np.ndarray, seen: int) -> float:
    return float(min(1.0, chance[: seen + 1].sum()))
