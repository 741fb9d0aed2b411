"""The headline test: a preference that would be found again with other participants and with other pairs of videos.

Answers are crossed: every participant sees many pairs, every pair is seen by many participants. A participant who likes
a, or a pair in which a looks better, moves all their answers together, so neither answers nor participants alone are a
sample. With y = 1 where a was chosen,

    y = mu + person + pair + rest,     T^2 = (mean(y) - 1/2)^2 / V,
    V = s_person^2 sum(n_i^2)/N^2 + s_pair^2 sum(m_j^2)/N^2 + s_rest^2 / N,

where n_i are the answers of participant i, m_j those to pair j, and the three variances come from the sums of squares
(analysis of variance estimators; Searle, Casella and McCulloch, Variance Components, 1992, chapter 5), negative ones
set to 0. How T is distributed depends on the variances, and no table has it: it is found by drawing normal y of the
same layout with the estimated variances (parametric bootstrap of a studentised statistic). benchmarks/study_errors.py
measures the errors of the first kind, and compares with the tests that were not taken.
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
            "expected answers of at least 3 participants to at least 3 pairs, and more than both together, got "
            f"{len(y)} of {persons_n} to {items_n}"
        )
    layout = _Layout(person, item, persons_n, items_n)
    mean, parts = float(y.mean()), layout.variances(y[None] - null)[:, 0]
    variance = float(layout.weights @ parts)
    drawn = layout.null_t2(parts, draws, np.random.default_rng(seed))
    t2 = _ratio((mean - null) ** 2, variance)
    p = two_way_p(t2, drawn)
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


def two_way_p(t2: float, drawn: np.ndarray) -> float:
    """p of T^2 among drawn ones (B,)."""
    return float((1 + np.sum(drawn >= t2 * (1 - 1e-12))) / (len(drawn) + 1))


# -- everybody answered everything once: the same test, many studies at a time ----------------------------------------


def t2_complete(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T^2 (S,) and variances (3, S) of studies y (S, I, J) whose null is 0."""
    _, persons_n, items_n = y.shape
    middle = y.mean((1, 2))
    persons = items_n * ((y.mean(2) - middle[:, None]) ** 2).sum(1)
    items = persons_n * ((y.mean(1) - middle[:, None]) ** 2).sum(1)
    rest = np.maximum(((y - middle[:, None, None]) ** 2).sum((1, 2)) - persons - items, 0)
    squares = persons / (persons_n - 1), items / (items_n - 1), rest / ((persons_n - 1) * (items_n - 1))
    parts = _parts_complete(*squares, persons_n, items_n)
    return _ratio(middle**2, _weights_complete(persons_n, items_n) @ parts), parts


def null_t2_complete(persons_n: int, items_n: int, draws: int, rng: np.random.Generator):
    """A function of variances (3,) that gives T^2 (draws,) without a preference, from one set of random numbers."""
    z2 = rng.chisquare(1, draws)
    freedom = persons_n - 1, items_n - 1, (persons_n - 1) * (items_n - 1)
    spread = [rng.chisquare(one, draws) / one for one in freedom]
    weights = _weights_complete(persons_n, items_n)

    def null_t2(parts: np.ndarray) -> np.ndarray:
        person, item, rest = parts
        squares = (rest + items_n * person) * spread[0], (rest + persons_n * item) * spread[1], rest * spread[2]
        return _ratio(weights @ parts * z2, weights @ _parts_complete(*squares, persons_n, items_n))

    return null_t2


def _parts_complete(persons, items, rest, persons_n: int, items_n: int) -> np.ndarray:
    """(3, ...) variances from the mean squares between participants, between pairs, and of the rest."""
    return np.stack([np.maximum(persons - rest, 0) / items_n, np.maximum(items - rest, 0) / persons_n, rest])


def _weights_complete(persons_n: int, items_n: int) -> np.ndarray:
    return np.array([1 / persons_n, 1 / items_n, 1 / (persons_n * items_n)])


# -- any layout -------------------------------------------------------------------------------------------------------


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
                "expected several pairs of each participant and several participants of each pair; these answers "
                "cannot tell participants from pairs"
            )
        self.solve = np.linalg.inv(self.expected)
        self.weights = np.array([k1 / n, k2 / n, 1 / n])  # variance of the mean from the three variances

    def variances(self, y: np.ndarray) -> np.ndarray:
        """(3, B) variances of person, pair and rest, not below 0, from y (B, N)."""
        return self._from_sums(y @ self.by_person, y @ self.by_item, (y**2).sum(1))

    def null_t2(self, parts: np.ndarray, draws: int, rng: np.random.Generator) -> np.ndarray:
        """(draws,) T^2 of normal answers with the variances `parts` (3,) and without a preference.

        Only the sums over participants and pairs are drawn. They fix the part of y in their own space of R dimensions;
        of the rest, N - R dimensions, only the sum of squares is needed. (Symmetric roots, so that neither the order of
        the answers nor the eigenvectors that a library picks change the draws.)
        """
        n, persons_n, items_n = self.shape
        both = np.hstack([self.by_person, self.by_item])
        squares, vectors = np.linalg.eigh(both.T @ both)
        kept = squares > 1e-9 * squares[-1]
        squares, vectors = squares[kept], vectors[:, kept]
        root, inverse = (vectors * np.sqrt(squares)) @ vectors.T, (vectors / squares) @ vectors.T
        sd = np.repeat(np.sqrt(parts[:2]), [persons_n, items_n])
        sums = (rng.normal(0, 1, (draws, persons_n + items_n)) @ root) * np.sqrt(parts[2])
        sums += (rng.normal(0, 1, (draws, persons_n + items_n)) * sd) @ (both.T @ both)
        square = ((sums @ inverse) * sums).sum(1)
        if n > len(squares):
            square += parts[2] * rng.chisquare(n - len(squares), draws)
        by_person, by_item = sums[:, :persons_n], sums[:, persons_n:]
        return _ratio((by_person.sum(1) / n) ** 2, self.weights @ self._from_sums(by_person, by_item, square))

    def _from_sums(self, by_person: np.ndarray, by_item: np.ndarray, square: np.ndarray) -> np.ndarray:
        middle = by_person.sum(1) ** 2 / self.shape[0]
        persons = (by_person**2 / self.person_n).sum(1)
        items = (by_item**2 / self.item_n).sum(1)
        return np.maximum(self.solve @ np.stack([persons - middle, items - middle, square - middle]), 0)


def _ratio(square, variance):
    """T^2; infinite where all answers agree, 0 where they do so on the null."""
    square, variance = np.asarray(square, dtype=float), np.asarray(variance, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(square <= 1e-24, 0.0, square / variance)
