"""How sure a number is: bootstrap intervals over clusters, and the paired comparison of two sets of scores.

Clips of one speaker resemble one another, so whole speakers are drawn, not clips (cluster bootstrap; Davison and
Hinkley, Bootstrap Methods and their Application, 1997, section 3.8). A draw is a vector of counts: how often each
cluster is in it. A statistic is a function of such vectors, which lets one draw touch several kinds of cluster at once
(the speakers of the references and those of a model). Everything is seeded: same numbers, same interval.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lipmetrics.errors import InputError

DRAWS, LEVEL = 2000, 0.95
METHODS = ("percentile", "bca")
FEWEST_CLUSTERS = 10  # below this, bootstrap intervals are known to be too narrow
MOST_EXACT = 14  # clusters up to which all 2^n sign flips are tried


@dataclass(frozen=True)
class Interval:
    """A value with its bootstrap interval; `low` and `high` are NaN where a single cluster leaves nothing to draw."""

    value: float
    low: float
    high: float
    level: float = LEVEL
    method: str = "percentile"
    draws: int = DRAWS
    clusters: tuple[int, ...] = ()


@dataclass(frozen=True)
class SignFlip:
    """Two-sided test that differences are symmetric about 0.

    p : share of the sign flips whose mean is at least as far from 0 as the one seen
    exact : all flips were tried; else `flips` random ones, and p = (k + 1) / (flips + 1)
    smallest_p : the least p that so few clusters can give
    """

    p: float
    exact: bool
    flips: int
    clusters: int
    smallest_p: float


@dataclass(frozen=True)
class Paired:
    """Two models on the same items: mean of first minus second, its interval, the test, and who is lower how often.

    Attributes
    ----------
    mean_first, mean_second : means over the items
    difference : mean of first - second, with its interval
    test : the sign-flip test of that mean
    first_lower, second_lower, items_n : number of items where the first, the second is lower, and of all
    """

    mean_first: float
    mean_second: float
    difference: Interval
    test: SignFlip
    first_lower: int
    second_lower: int
    items_n: int


def cluster_counts(clusters_n: int, draws: int = DRAWS, seed: int = 0) -> np.ndarray:
    """How often each cluster is in each of `draws` samples with replacement: (draws, clusters_n) float64."""
    if clusters_n < 1 or draws < 1:
        raise InputError(f"expected at least one cluster and one draw, got {clusters_n} and {draws}")
    rng = np.random.default_rng(seed)
    return rng.multinomial(clusters_n, np.full(clusters_n, 1 / clusters_n), size=draws).astype(float)


def bootstrap(
    statistic: Callable[..., np.ndarray],
    clusters: tuple[int, ...],
    *,
    draws: int = DRAWS,
    level: float = LEVEL,
    method: str = "percentile",
    seed: int = 0,
) -> Interval:
    """Bootstrap interval of a statistic of one or several kinds of cluster, drawn independently of one another.

    percentile: the quantiles (1 - level) / 2 and (1 + level) / 2 of the draws.
    bca: the quantiles Phi(z0 + (z0 + z) / (1 - a (z0 + z))), z0 from the share of draws below the value and a from the
    jackknife (Efron, Better bootstrap confidence intervals, J. Am. Stat. Assoc. 82, 1987, eq. 2.3; several samples as
    in Davison and Hinkley 1997, section 5.3.2).

    Parameters
    ----------
    statistic : one array (B, n_k) of counts for each kind -> (B,) values; NaN where a draw has no answer
    clusters : number of clusters n_k of each kind
    method : "percentile" or "bca"

    Returns
    -------
    Interval; without limits where every kind has one cluster only, or fewer than half of the draws have an answer

    Raises
    ------
    InputError : an unknown method, a level outside (0, 1)
    """
    if method not in METHODS:
        raise InputError(f"expected an interval of kind {' or '.join(METHODS)}, got {method!r}")
    if not 0 < level < 1:
        raise InputError(f"expected a level between 0 and 1 such as 0.95, got {level}")
    value = float(statistic(*(np.ones((1, n)) for n in clusters))[0])
    nothing = Interval(value, math.nan, math.nan, level, method, draws, clusters)
    if max(clusters) < 2 or not math.isfinite(value):
        return nothing
    counts = [cluster_counts(n, draws, seed + k) for k, n in enumerate(clusters)]
    drawn = statistic(*counts)
    drawn = drawn[np.isfinite(drawn)]
    if 2 * len(drawn) < draws:
        return nothing
    tails = np.array([(1 - level) / 2, (1 + level) / 2])
    if method == "bca":
        tails = _bca_tails(tails, drawn, value, _acceleration(statistic, clusters))
    low, high = np.quantile(drawn, tails)
    return Interval(value, float(low), float(high), level, method, draws, clusters)


def _bca_tails(tails: np.ndarray, drawn: np.ndarray, value: float, acceleration: float) -> np.ndarray:
    from scipy.special import ndtr, ndtri

    below = (np.mean(drawn < value) + np.mean(drawn <= value)) / 2
    # all draws on one side would put both limits at infinity
    z0 = ndtri(np.clip(below, 0.5 / len(drawn), 1 - 0.5 / len(drawn)))
    z = z0 + ndtri(tails)
    return ndtr(z0 + z / (1 - acceleration * z))


def _acceleration(statistic: Callable[..., np.ndarray], clusters: tuple[int, ...]) -> float:
    cubes = squares = 0.0
    for k, n in enumerate(clusters):
        if n < 2:
            continue
        counts = [np.ones((n, m)) for m in clusters]
        counts[k] = 1 - np.eye(n)
        left_out = statistic(*counts)
        left_out = left_out[np.isfinite(left_out)]
        if len(left_out) == 0:
            continue
        influence = (n - 1) * (left_out.mean() - left_out)
        cubes += (influence**3).sum() / n**3
        squares += (influence**2).sum() / n**2
    return cubes / (6 * squares**1.5) if squares > 0 else 0.0


def mean_by_counts(values: np.ndarray, clusters: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """The mean of values (n,), each in a cluster 0 .. k-1, as a statistic of counts (B, k); NaN values are left out."""
    known = np.isfinite(values)
    size = int(clusters.max()) + 1
    sums = np.bincount(clusters[known], values[known], size)
    sizes = np.bincount(clusters[known], minlength=size).astype(float)

    def mean(counts: np.ndarray) -> np.ndarray:
        weight = counts @ sizes
        return np.divide(counts @ sums, weight, out=np.full(len(counts), np.nan), where=weight > 0)

    return mean


def sign_flip_test(differences: np.ndarray, clusters: np.ndarray | None = None, *, draws: int = 9999, seed: int = 0):
    """Two-sided sign-flip (paired permutation) test of the mean of `differences`, flipping whole clusters.

    With up to `MOST_EXACT` clusters all 2^n flips are tried, else `draws` random ones and
    p = (k + 1) / (draws + 1) (Phipson and Smyth, Stat. Appl. Genet. Mol. Biol. 9, 2010, article 39).

    Parameters
    ----------
    differences : (n,) float, first minus second; NaN are left out
    clusters : (n,) int; None: each difference by itself

    Returns
    -------
    SignFlip; p is NaN with no difference at all
    """
    differences = np.asarray(differences, float)
    known = np.isfinite(differences)
    clusters = np.arange(len(differences)) if clusters is None else np.asarray(clusters)
    if not known.any():
        return SignFlip(math.nan, True, 0, 0, math.nan)
    labels, inverse = np.unique(clusters[known], return_inverse=True)
    sums = np.bincount(inverse, differences[known])
    n = len(labels)
    seen = abs(sums.sum())
    near = seen * (1 - 1e-12)  # the same sum in another order may round to less
    if n <= MOST_EXACT:
        # the first sign is held: a flip and its opposite are equally far from 0
        signs = 1 - 2 * ((np.arange(2 ** (n - 1))[:, None] >> np.arange(n)) & 1)
        p = float(np.mean(np.abs(signs @ sums) >= near))
        return SignFlip(p, True, 2**n, n, 2.0 ** (1 - n))
    signs = np.random.default_rng(seed).integers(0, 2, (draws, n)) * 2.0 - 1
    extreme = int((np.abs(signs @ sums) >= near).sum())
    return SignFlip((extreme + 1) / (draws + 1), False, draws, n, 1 / (draws + 1))


def compare_paired(
    first: np.ndarray,
    second: np.ndarray,
    clusters: np.ndarray | None = None,
    *,
    draws: int = DRAWS,
    level: float = LEVEL,
    method: str = "bca",
    seed: int = 0,
) -> Paired:
    """Compare the scores of two models on the same n items, clustered by speaker or by utterance.

    Parameters
    ----------
    first, second : (n,) float scores, item by item; items where either is NaN are left out
    clusters : (n,) labels; None: each item by itself

    Raises
    ------
    InputError : different lengths, or no item that both models have
    """
    first, second = np.asarray(first, float), np.asarray(second, float)
    if first.shape != second.shape or first.ndim != 1:
        raise InputError(f"expected two rows of scores of one length, got shapes {first.shape} and {second.shape}")
    known = np.isfinite(first) & np.isfinite(second)
    if not known.any():
        raise InputError("expected items that both models have a score of, found none; give both the same utterances")
    first, second = first[known], second[known]
    labels = np.arange(len(known)) if clusters is None else np.asarray(clusters)
    _, index = np.unique(labels[known], return_inverse=True)
    difference = first - second
    interval = bootstrap(
        mean_by_counts(difference, index), (int(index.max()) + 1,), draws=draws, level=level, method=method, seed=seed
    )
    test = sign_flip_test(difference, index, seed=seed)
    wins = int((first < second).sum()), int((first > second).sum())
    return Paired(float(first.mean()), float(second.mean()), interval, test, *wins, len(first))


def holm(p: np.ndarray) -> np.ndarray:
    """p-values (n,) adjusted for their number (Holm, Scand. J. Stat. 6, 1979); NaN are left out and stay NaN."""
    p = np.asarray(p, float)
    adjusted = np.full(len(p), np.nan)
    known = np.flatnonzero(np.isfinite(p))
    order = known[np.argsort(p[known], kind="stable")]
    steps = p[order] * np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1) if len(order) else steps
    return adjusted
