"""One strength per level from all pairs at once: Bradley and Terry's model, with Davidson's ties.

With strength lambda_i (a log odds),

    P(i over j) = e^lambda_i / D,   P(tie) = nu e^((lambda_i + lambda_j) / 2) / D,
    D = e^lambda_i + e^lambda_j + nu e^((lambda_i + lambda_j) / 2)

(Bradley and Terry, Biometrika 39, 1952; Davidson, Journal of the American Statistical Association 65, 1970). Without
ties nu is 0. Intervals come from a bootstrap over participants.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
from scipy import stats

from study.clusters import bootstrap_weights, expanded_percentiles
from study.errors import InputError
from study.responses import Answers

#: weight of the pull towards equal strengths, in answers: keeps the strength of a level that always won finite
PULL = 1e-3
STEPS_N = 100


@dataclasses.dataclass(frozen=True)
class Strengths:
    """Fitted strengths.

    Parameters
    ----------
    table : one row per level: level, strength (log odds against the least level), low, high, share (probability to be
        chosen over the least level), share_low, share_high, rank (1 = strongest), first (share of bootstrap samples in
        which it is the strongest)
    differences : one row per pair of levels: level_a, level_b, difference (strength of b - a), low, high
    tie : nu, 0 if there were no ties
    misfit, freedom, p_misfit : deviance against free probabilities of every pair, its degrees of freedom, and p of the
        chi-square as if answers were independent; a small p says that one strength per level is not enough
    participants_n, level : number of participants, and confidence level of the intervals
    """

    table: pd.DataFrame
    differences: pd.DataFrame
    tie: float
    misfit: float
    freedom: int
    p_misfit: float
    participants_n: int
    level: float = 0.95


def strengths(answers: Answers, *, level: float = 0.95, seed: int = 0) -> Strengths:
    """Strength of every level in the test trials of `answers`.

    Raises
    ------
    InputError : fewer than two levels, no answers, or levels that were never compared, not even through others
    """
    answers = answers.tests
    levels = answers.levels_shown
    wins, ties = _counts(answers, levels)
    total_wins, total_ties = wins.sum(0), ties.sum(0)
    _check_connected(total_wins + total_ties, levels)
    estimate, nu = fit(total_wins[None], total_ties[None])
    estimate, nu = estimate[0], float(nu[0])
    persons_n, levels_n = len(wins), len(levels)
    boot = bootstrap_weights(persons_n, seed)
    drawn, _ = fit(
        (boot @ wins.reshape(persons_n, -1)).reshape(-1, levels_n, levels_n),
        (boot @ ties.reshape(persons_n, -1)).reshape(-1, levels_n, levels_n),
    )
    low, high = expanded_percentiles(drawn, persons_n, level)
    table = pd.DataFrame(
        {
            "level": levels,
            "strength": estimate,
            "low": low,
            "high": high,
            "share": _expit(estimate),
            "share_low": _expit(low),
            "share_high": _expit(high),
            "rank": stats.rankdata(-estimate, method="min").astype(int),
            "first": np.bincount(drawn.argmax(1), minlength=levels_n) / len(drawn),
        }
    )
    rows = []
    for i in range(levels_n):
        for j in range(i + 1, levels_n):
            a, b = expanded_percentiles(drawn[:, j] - drawn[:, i], persons_n, level)
            rows.append((levels[i], levels[j], estimate[j] - estimate[i], float(a), float(b)))
    differences = pd.DataFrame(rows, columns=["level_a", "level_b", "difference", "low", "high"])
    misfit, freedom = _misfit(total_wins, total_ties, estimate, nu)
    p_misfit = float(stats.chi2.sf(misfit, freedom)) if freedom > 0 else np.nan
    return Strengths(table, differences, nu, misfit, freedom, p_misfit, persons_n, level)


def fit(wins: np.ndarray, ties: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Strengths (B, L), the first 0, and nu (B,), of many tables at once, by Newton's method.

    Parameters
    ----------
    wins : (B, L, L) how often the row was chosen over the column
    ties : (B, L, L) ties, symmetric: each tie counted in both triangles
    """
    sets_n, levels_n, _ = wins.shape
    first, second = np.triu_indices(levels_n, 1)
    a, b, t = wins[:, first, second], wins[:, second, first], ties[:, first, second]
    n = a + b + t
    with_ties = bool(t.sum())
    design = np.zeros(
        (3, len(first), levels_n)
    )  # derivative of the log weight of (i wins, j wins, tie) by the strengths
    at = np.arange(len(first))
    design[0, at, first] = 1
    design[1, at, second] = 1
    design[2, at, first] = design[2, at, second] = 0.5
    design = design[:, :, 1:]
    if with_ties:
        design = np.concatenate([design, np.zeros((3, len(first), 1))], axis=2)
        design[2, :, -1] = 1
    unknowns_n = design.shape[2]
    x = np.zeros((sets_n, unknowns_n))
    seen = np.stack([a, b, t])
    pull = PULL * np.eye(unknowns_n)
    todo = np.arange(sets_n)
    for _ in range(STEPS_N):
        weight = np.einsum("kpu,bu->kbp", design, x[todo])
        if not with_ties:
            weight[2] = -np.inf
        weight = np.exp(weight - weight.max(0))
        chance = weight / weight.sum(0)
        expected = np.einsum("kbp,kpu->bpu", chance, design)
        slope = np.einsum("kbp,kpu->bu", seen[:, todo] - n[todo] * chance, design) - PULL * x[todo]
        bend = np.einsum("bp,kbp,kpu,kpv->buv", n[todo], chance, design, design, optimize=True)
        bend += pull - np.einsum("bp,bpu,bpv->buv", n[todo], expected, expected, optimize=True)
        step = np.linalg.solve(bend, slope[..., None])[..., 0]
        step /= np.maximum(1, np.abs(step).max(1, keepdims=True))
        x[todo] += step
        todo = todo[np.abs(step).max(1) > 1e-9]
        if not len(todo):
            break
    found = np.concatenate([np.zeros((sets_n, 1)), x[:, : levels_n - 1]], axis=1)
    return found, np.exp(x[:, -1]) if with_ties else np.zeros(sets_n)


def _counts(answers: Answers, levels: list) -> tuple[np.ndarray, np.ndarray]:
    """wins (I, L, L) and ties (I, L, L) of every participant."""
    table = answers.table
    number = {name: i for i, name in enumerate(answers.participants)}
    place = {level: i for i, level in enumerate(levels)}
    if len(levels) < 2:
        raise InputError(f"expected answers about at least two levels, got {len(levels)}")
    person = table["participant"].map(number).to_numpy()
    left, right = (table[side].map(place).to_numpy() for side in ("level_left", "level_right"))
    tie, left_won = (table["chosen"] == "").to_numpy(), (table["chosen"] == table["left"]).to_numpy()
    wins, ties = np.zeros((2, len(number), len(levels), len(levels)))
    winner, loser = np.where(left_won, left, right), np.where(left_won, right, left)
    other = left != right  # two videos of one level say nothing about levels
    np.add.at(wins, (person[~tie & other], winner[~tie & other], loser[~tie & other]), 1)
    for i, j in ((left, right), (right, left)):
        np.add.at(ties, (person[tie & other], i[tie & other], j[tie & other]), 1)
    return wins, ties


def _check_connected(met: np.ndarray, levels: list) -> None:
    together = (met + met.T > 0) | np.eye(len(met), dtype=bool)
    reached = np.linalg.matrix_power(together.astype(float), len(met))[0] > 0
    if not reached.all():
        apart = [str(level) for level, ok in zip(levels, reached, strict=True) if not ok]
        raise InputError(
            f"expected every level to be compared with the others, got no trial that joins {', '.join(apart)} to "
            f"{levels[0]}"
        )


def _misfit(wins: np.ndarray, ties: np.ndarray, estimate: np.ndarray, nu: float) -> tuple[float, int]:
    first, second = np.triu_indices(len(wins), 1)
    seen = np.stack([wins[first, second], wins[second, first], ties[first, second]])
    a, b = np.exp(estimate[first]), np.exp(estimate[second])
    weight = np.stack([a, b, nu * np.sqrt(a * b)])
    n, expected = seen.sum(0), seen.sum(0) * weight / weight.sum(0)
    with np.errstate(divide="ignore", invalid="ignore"):
        deviance = 2 * np.where(seen > 0, seen * np.log(seen / expected), 0).sum()
    outcomes = 2 if nu > 0 else 1
    unknowns = len(wins) - 1 + (nu > 0)
    return float(deviance), int(outcomes * np.count_nonzero(n) - unknowns)


def _expit(x):
    return 1 / (1 + np.exp(-np.asarray(x, dtype=float)))
