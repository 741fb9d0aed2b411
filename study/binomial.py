"""Exact binomial p-values and intervals of one count, and Holm's correction over several.

They take every answer for an independent coin. The answers of one participant are not; see `study.clusters` and
`study.headline` for what holds then.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from study.errors import InputError


def p_at_least(r, n, p: float = 0.5):
    """One-sided P(>= r), thesis eq. 5.2. Arrays or numbers; 1 without answers."""
    r, n = _counts(r, n)
    return _plain(stats.binom.sf(r - 1, n, p))


def p_more_than(r, n, p: float = 0.5):
    """P(> r): what the thesis prints for eq. 5.2. For replication only; as a p-value it is too small."""
    r, n = _counts(r, n)
    return _plain(stats.binom.sf(r, n, p))


def p_two_sided(r, n, p: float = 0.5):
    """Exact two-sided p: the probability of all counts that are no more likely than r (as scipy.stats.binomtest)."""
    r, n = _counts(r, n)
    return _plain(np.vectorize(lambda a, b: stats.binomtest(a, b, p).pvalue if b else 1.0, otypes=[float])(r, n))


def clopper_pearson(r, n, level: float = 0.95) -> tuple:
    """Exact interval of the share r / n: coverage at least `level` for every true share. (0, 1) without answers.

    Clopper and Pearson, Biometrika 26, 1934.
    """
    r, n = _counts(r, n)
    tail = (1 - _level(level)) / 2
    with np.errstate(invalid="ignore"):
        low = np.where(r == 0, 0.0, stats.beta.ppf(tail, r, n - r + 1))
        high = np.where(r == n, 1.0, stats.beta.ppf(1 - tail, r + 1, n - r))
    return _plain(low), _plain(high)


def wilson(r, n, level: float = 0.95) -> tuple:
    """Wilson's score interval of the share r / n: coverage about `level` on average. (0, 1) without answers.

    Wilson, Journal of the American Statistical Association 22, 1927; no continuity correction.
    """
    r, n = _counts(r, n)
    z = stats.norm.isf((1 - _level(level)) / 2)
    with np.errstate(invalid="ignore", divide="ignore"):
        middle = (r + z**2 / 2) / (n + z**2)
        half = z / (n + z**2) * np.sqrt(np.where(n > 0, r * (n - r) / np.maximum(n, 1), 0) + z**2 / 4)
    low, high = np.where(r == 0, 0.0, middle - half), np.where(r == n, 1.0, middle + half)
    return _plain(low), _plain(high)


def share_to_ratio(share):
    """Preference ratio of a share: share / (1 - share), infinite at 1."""
    share = np.asarray(share, dtype=float)
    with np.errstate(divide="ignore"):
        return _plain(share / (1 - share))


def holm(p: Sequence[float]) -> np.ndarray:
    """Holm's adjusted p-values (K,) of K tests, NaN left out. Holm, Scandinavian Journal of Statistics 6, 1979."""
    p = np.asarray(p, dtype=float)
    adjusted = np.full(len(p), np.nan)
    known = np.flatnonzero(~np.isnan(p))
    order = known[np.argsort(p[known], kind="stable")]
    scaled = p[order] * np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(1, np.maximum.accumulate(scaled)) if len(order) else scaled
    return adjusted


def _counts(r, n) -> tuple[np.ndarray, np.ndarray]:
    r, n = np.broadcast_arrays(r, n)
    if not (np.issubdtype(r.dtype, np.integer) and np.issubdtype(n.dtype, np.integer)):
        raise InputError(f"expected whole numbers of answers, got {r.tolist()} of {n.tolist()}; leave ties out")
    if (r < 0).any() or (r > n).any():
        raise InputError(f"expected 0 to n answers for one side, got {r.tolist()} of {n.tolist()}")
    return r, n


def _level(level: float) -> float:
    if not 0 < level < 1:
        raise InputError(f"expected a confidence level between 0 and 1, such as 0.95, got {level}")
    return level


def _plain(value):
    value = np.asarray(value)
    return float(value) if value.ndim == 0 else value
