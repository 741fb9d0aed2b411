"""The headline test: a preference that would be found again with other participants and with other pairs of videos.

Answers are crossed: every participant sees many pairs, every pair is seen by many participants. A participant who likes
a, or a pair in which a looks better, moves all their answers together, so neither answers nor participants alone are a
sample. With y = 1 where a was chosen,

    y = mu + person + pair + rest,     T^2 = (mean(y) - 1/2)^2 / V,
    V = s_person^2 sum(n_i^2)/N^2 + s_pair^2 sum(m_j^2)/N^2 + s_rest^2 / N,

where n_i are the answers of participant i, m_j those to pair j, and the three variances come from the sums of squares
(analysis of variance estimators, Searle, Casella and McCulloch, Variance Components, 1992, section 5.3), negative ones set
to 0. How T is distributed depends on the variances, and no table has it: it is found by drawing normal y of the same
layout with the estimated variances (parametric bootstrap of a studentised statistic). benchmarks/study.py measures the
errors of the first kind, and compares with the tests that were not taken.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from study.errors import InputError
from study.responses import Choices

DRAWS = 9999
#: below these the measured error of the first kind leaves 4 to 6 % (benchmarks/RESULTS.md)
FEW_PARTICIPANTS, FEW_ITEMS = 10, 10


@dataclasses.dataclass(frozen=True)
class Headline:
    """A mean with what other participants and other pairs would change about it.

    Parameters
    ----------
    mean : of y: the share of answers for a, ties counted half, or a mean difference
    p : two-sided, against `null`
    low, high : interval of `level`; it holds `null` exactly when p > 1 - level
    error : standard error, sqrt(V)
    person_sd, item_sd, rest_sd : square roots of the variances, in units of y
    n, participants_n, items_n : numbers of answers, participants and pairs
    caution : '' or why the numbers are not to be trusted
    level, null, draws, seed : settings
    """

    mean: float
    p: float
    low: float
    high: float
    error: float
    person_sd: float
    item_sd: float
    rest_sd: float
    n: int
    participants_n: int
    items_n: int
    caution: str
    level: float = 0.95
    null: float = 0.5
    draws: int = DRAWS
    seed: int = 0


def headline(
    choices: Choices, *, null: float = 0.5, level: float = 0.95, draws: int = DRAWS, seed: int = 0
) -> Headline:
    """The test on some choices; `null` is the mean of y without a preference.

    Raises
    ------
    InputError : answers of fewer than 3 participants or to fewer than 3 pairs, or no more answers than unknowns
    """
    y, person, item = choices.y, choices.person, choices.item
    persons_n, items_n = len(choices.persons), len(choices.items)
    if min(persons_n, items_n) < 3 or len(y) < persons_n + items_n:
        raise InputError(
            f"expected answers of at least 3 participants to at least 3 pairs, and more than both together, got {len(y)} "
            f"of {persons_n} to {items_n}"
        )
    layout = _Layout(person, item, persons_n, items_n)
    mean, parts = float(y.mean()), layout.variances(y[None] - null)[:, 0]
    variance = float(layout.weights @ parts)
    rng = np.random.default_rng(seed)
    chunk = max(1, 4_000_000 // len(y))
    drawn = np.concatenate([_null_t2(layout, parts, min(chunk, draws - at), rng) for at in range(0, draws, chunk)])
    t2 = _ratio((mean - null) ** 2, variance)
    p = float((1 + np.sum(drawn >= t2 * (1 - 1e-12))) / (draws + 1))
    # the k-th largest, so that p > 1 - level exactly where the interval holds the null
    k = max(1, int(np.floor((1 - level) * (draws + 1) + 1e-9)))
    half = float(np.sqrt(np.partition(drawn, draws - k)[draws - k] * variance))
    low, high = mean - half, mean + half
    if null == 0.5:
        low, high = max(0.0, low), min(1.0, high)
    few = [f"{n} {what}" for n, least, what in _few(persons_n, items_n) if n < least]
    caution = f"only {' and '.join(few)}: p is too small" if few else ""
    sd = np.sqrt(parts)
    return Headline(
        mean,
        p,
        low,
        high,
        float(np.sqrt(variance)),
        *map(float, sd),
        len(y),
        persons_n,
        items_n,
        caution,
        level,
        null,
        draws,
        seed,
    )


def _few(persons_n: int, items_n: int) -> tuple:
    return (persons_n, FEW_PARTICIPANTS, "participants"), (items_n, FEW_ITEMS, "pairs")


class _Layout:
    """Who answered what: the sums over participants and over pairs, and what they mean for the variances."""

    def __init__(self, person: np.ndarray, item: np.ndarray, persons_n: int, items_n: int):
        n = len(person)
        self.shape = (n, persons_n, items_n)
        self.person, self.item = person, item
        self.by_person = np.zeros((n, persons_n))
        self.by_person[np.arange(n), person] = 1
        self.by_item = np.zeros((n, items_n))
        self.by_item[np.arange(n), item] = 1
        self.person_n, self.item_n = self.by_person.sum(0), self.by_item.sum(0)
        met = self.by_person.T @ self.by_item  # (I, J) answers of each participant to each pair
        k1, k2 = (self.person_n**2).sum() / n, (self.item_n**2).sum() / n
        k3 = (met**2 / self.person_n[:, None]).sum()
        k4 = (met**2 / self.item_n).sum()
        # expected sums of squares between participants, between pairs and in all, by variance (person, item, rest)
        self.expected = np.array(
            [
                [n - k1, k3 - k2, persons_n - 1],
                [k4 - k1, n - k2, items_n - 1],
                [n - k1, n - k2, n - 1],
            ]
        )
        if np.linalg.cond(self.expected / n) > 1e8:
            raise InputError(
                "expected several pairs of each participant and several participants of each pair; these answers cannot "
                "tell participants from pairs"
            )
        self.solve = np.linalg.inv(self.expected)
        self.weights = np.array([k1 / n, k2 / n, 1 / n])  # variance of the mean from the three variances

    def variances(self, y: np.ndarray) -> np.ndarray:
        """(3, B) variances of person, pair and rest, not below 0, from y (B, N)."""
        n = y.shape[1]
        middle = y.sum(1) ** 2 / n
        squares = (y**2).sum(1)
        persons = ((y @ self.by_person) ** 2 / self.person_n).sum(1)
        items = ((y @ self.by_item) ** 2 / self.item_n).sum(1)
        found = self.solve @ np.stack([persons - middle, items - middle, squares - middle])
        return np.maximum(found, 0)


def _null_t2(layout: _Layout, parts: np.ndarray, draws: int, rng: np.random.Generator) -> np.ndarray:
    """(draws,) T^2 of normal answers without a preference."""
    n, persons_n, items_n = layout.shape
    person_sd, item_sd, rest_sd = np.sqrt(parts)
    y = rng.normal(0, 1, (draws, n)) * rest_sd
    y += (rng.normal(0, 1, (draws, persons_n)) * person_sd)[:, layout.person]
    y += (rng.normal(0, 1, (draws, items_n)) * item_sd)[:, layout.item]
    return _ratio(y.mean(1) ** 2, layout.weights @ layout.variances(y))


def _ratio(square, variance):
    """T^2; infinite where all answers agree, 0 where they do so on the null."""
    square, variance = np.asarray(square, dtype=float), np.asarray(variance, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(square <= 1e-24, 0.0, square / variance)
