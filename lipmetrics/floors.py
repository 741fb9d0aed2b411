"""The floor: how far real takes are from one another, and where a score stands in it.

A take's score is its distance to a set of takes of the same utterance. Distances to the takes of one speaker are
averaged first, then the speakers, so that a speaker with many repeats counts once. The floor is the same number for
each real take: against the other speakers ("speakers": leave one speaker out), against the other repeats of its own
speaker ("repeats"), or, where nobody knows who speaks, against all other takes ("takes").

All functions take counts of the speakers, so that a bootstrap can draw speakers; counts of 1 give the plain numbers.
"""

from __future__ import annotations

import numpy as np

SPEAKERS, REPEATS, TAKES = "speakers", "repeats", "takes"
MEANING = {
    SPEAKERS: "real takes against other speakers (leave one speaker out)",
    REPEATS: "real takes against other repeats of the same speaker",
    TAKES: "real takes against all other takes, speakers unknown (leave one take out)",
}


def group_means(distances: np.ndarray, groups: np.ndarray, groups_n: int) -> np.ndarray:
    """Mean distance of each row to the takes of each group: (m, n) and groups (n,) of 0 .. groups_n-1 -> (m, groups_n).

    NaN distances are left out; NaN where nothing is left.
    """
    member = np.eye(groups_n)[np.asarray(groups, int)]
    known = np.isfinite(distances)
    return _divide(np.where(known, distances, 0.0) @ member, known.astype(float) @ member)


def against_groups(means: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Mean over groups, weighted by how often each was drawn: means (m, g), counts (B, g) -> (B, m); NaN left out."""
    known = np.isfinite(means)
    return _divide(counts @ np.where(known, means, 0.0).T, counts @ known.T.astype(float))


def leave_group_out(distances: np.ndarray, groups: np.ndarray, groups_n: int) -> np.ndarray:
    """`group_means` of real takes (n, n) among themselves, a take's own group left out (NaN): (n, groups_n)."""
    means = group_means(distances, groups, groups_n)
    means[np.arange(len(means)), groups] = np.nan
    return means


def within_group(distances: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """Mean distance of each take to the others of its own group, (n, n) -> (n,); NaN where it is the only one."""
    other = (groups[:, None] == groups[None, :]) & ~np.eye(len(groups), dtype=bool)
    known = other & np.isfinite(distances)
    return _divide(np.where(known, distances, 0.0).sum(axis=1), known.sum(axis=1).astype(float))


def percentile(scores: np.ndarray, floor: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """Where scores stand in the floor, in %: the share of the floor that is lower, ties counted half.

        100 (sum of weights of floor < score + half of those of floor = score) / (sum of all weights)

    50 is a typical real take, 100 is farther off than every real take. Values within 1e-12 (relative) are ties.

    Parameters
    ----------
    scores : (B, m); floor : (B, n); weights : (B, n) or None, all 1; a NaN of the floor has no weight

    Returns
    -------
    (B, m) float64; NaN where the score is NaN or the floor is empty
    """
    weights = np.isfinite(floor) * (1.0 if weights is None else weights)
    tiny = 1e-12 * np.maximum(np.abs(scores), 1e-300)[:, :, None]
    off = scores[:, :, None] - floor[:, None, :]
    lower = np.where(off > tiny, 1.0, np.where(off < -tiny, 0.0, 0.5))
    share = (np.where(weights[:, None, :] > 0, lower, 0.0) * weights[:, None, :]).sum(axis=2)
    shares = 100 * _divide(share, np.broadcast_to(weights.sum(axis=1, keepdims=True), share.shape))
    return np.where(np.isfinite(scores), shares, np.nan)


def weighted_median(values: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """Median of each row (B, n) with weights (B, n): the mean of lower and upper median; NaN values have no weight."""
    weights = np.isfinite(values) * (1.0 if weights is None else weights)
    order = np.argsort(values, axis=1, kind="stable")  # NaN last
    values, weights = np.take_along_axis(values, order, 1), np.take_along_axis(weights, order, 1)
    reached = np.cumsum(weights, axis=1)
    half = reached[:, -1:] / 2 if values.shape[1] else np.zeros((len(values), 1))
    if values.shape[1] == 0:
        return np.full(len(values), np.nan)
    lower = np.argmax(reached >= half * (1 - 1e-12), axis=1)
    upper = np.argmax(reached > half * (1 + 1e-12), axis=1)
    rows = np.arange(len(values))
    middle = (values[rows, lower] + values[rows, upper]) / 2
    return np.where(half[:, 0] > 0, middle, np.nan)


def _divide(sums: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return np.divide(sums, weights, out=np.full(np.shape(sums), np.nan), where=weights > 0)
