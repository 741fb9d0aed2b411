"""Preference when a participant's answers hang together: participants, not answers, are the sample.

These hold for the pairs of videos that were shown; `study.headline` also allows for the choice of the pairs.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from scipy import stats

from study.errors import InputError
from study.responses import Choices

BOOTSTRAPS = 4000


@dataclasses.dataclass(frozen=True)
class ClusteredShare:
    """Share of answers for a, with participants as clusters.

    Parameters
    ----------
    share : mean of y, ties counted half
    n, participants_n : answers and participants
    p_sign_flip : exact two-sided p of `sign_flip_p`
    p_t, low, high : two-sided p and interval of Student's t with the cluster-robust standard error, participants - 1
        degrees of freedom; NaN with one participant, or if all have the same share
    boot_low, boot_high : interval of the bootstrap over participants (`expanded_percentiles`)
    level : of the intervals
    """

    share: float
    n: int
    participants_n: int
    p_sign_flip: float
    p_t: float
    low: float
    high: float
    boot_low: float
    boot_high: float
    level: float = 0.95


def clustered_share(choices: Choices, *, level: float = 0.95, seed: int = 0) -> ClusteredShare:
    """Share of answers for a, its intervals and p against one half.

    Raises
    ------
    InputError : no answers
    """
    total, count = sums(choices.y, choices.person, len(choices.persons))
    if not count.sum():
        raise InputError("expected at least one answer, got none")
    n, persons_n = count.sum(), len(count)
    share = total.sum() / n
    low = high = p_t = np.nan
    squares = ((total - share * count) ** 2).sum()
    if persons_n > 1 and squares > 1e-12:
        error = np.sqrt(persons_n / (persons_n - 1) * squares) / n
        low, high, p_t = t_interval(share, error, persons_n - 1, level, null=0.5)
        low, high = max(0.0, float(low)), min(1.0, float(high))
    boot = bootstrap_weights(persons_n, seed)
    shares = (boot @ total) / (boot @ count)
    boot_low, boot_high = expanded_percentiles(shares, persons_n, level)
    return ClusteredShare(
        float(share),
        int(n),
        persons_n,
        sign_flip_p(total - count / 2),
        float(p_t),
        low,
        high,
        float(boot_low),
        float(boot_high),
        level,
    )


def sums(y: np.ndarray, cluster: np.ndarray, clusters_n: int) -> tuple[np.ndarray, np.ndarray]:
    """Sum of y (N,) and number of answers in each cluster, (I,) both."""
    return np.bincount(cluster, y, clusters_n), np.bincount(cluster, minlength=clusters_n)


@functools.lru_cache(maxsize=8)
def bootstrap_weights(persons_n: int, seed: int, n: int = BOOTSTRAPS) -> np.ndarray:
    """(B, I) how often each participant is drawn in each of n bootstrap samples; not to be written to."""
    drawn = np.random.default_rng(seed).multinomial(persons_n, np.full(persons_n, 1 / persons_n), size=n).astype(float)
    drawn.flags.writeable = False
    return drawn


def expanded_percentiles(drawn: np.ndarray, persons_n: int, level: float) -> tuple:
    """low and high of bootstrap values (B, ...), over the first axis; NaN with one participant.

    The percentiles are taken further out than `level` says, as far as makes the interval of a mean as long as
    Student's: plain percentiles are too narrow with few participants (Hesterberg, The American Statistician 69, 2015).
    """
    if persons_n < 2:
        nothing = np.full(drawn.shape[1:], np.nan)
        return nothing, nothing
    t = stats.t.isf((1 - level) / 2, persons_n - 1)
    tail = stats.norm.sf(np.sqrt(persons_n / (persons_n - 1)) * t)
    low, high = np.quantile(drawn, [tail, 1 - tail], axis=0)
    return low, high


def t_interval(estimate, error, freedom, level: float, null: float = 0.0) -> tuple:
    """low, high and two-sided p of Student's t; an estimate without spread has p 0, or 1 at the null."""
    half = stats.t.isf((1 - level) / 2, freedom) * error
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(estimate == null, 0.0, np.abs(estimate - null) / error)
    return estimate - half, estimate + half, 2 * stats.t.sf(t, freedom)


def sign_flip_p(excess: np.ndarray) -> float:
    """Exact two-sided p of the sum of participants' excesses (I,), if each could as well have had the other sign.

    `excess` is a multiple of one half (answers for a minus half of the answers). All 2^I sign patterns count, by
    adding up the distribution of the sum participant by participant. Needs no model: only that under the null
    participants are independent and a's and b's excess are equally likely.
    """
    steps = np.rint(2 * np.abs(np.asarray(excess, dtype=float))).astype(int)
    reach = int(steps.sum())
    chance = np.zeros(2 * reach + 1)
    chance[reach] = 1
    for step in steps[steps > 0]:
        moved = np.zeros_like(chance)
        moved[step:] = chance[:-step]
        moved[:-step] += chance[step:]
        chance = moved / 2
    seen = abs(int(np.rint(2 * np.sum(excess))))
    return float(min(1.0, chance[np.abs(np.arange(-reach, reach + 1)) >= seen].sum()))
