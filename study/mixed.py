"""Two models that reviewers know: GEE (by statsmodels, extra `statistics`) and the mixed logit.

Both stand beside `study.headline`, which keeps its error rate with fewer participants and pairs.
"""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
from scipy import optimize, stats

from study.errors import InputError
from study.responses import Choices

STEPS_N = 50


@dataclasses.dataclass(frozen=True)
class LogOdds:
    """Log odds of a over b by a model.

    Parameters
    ----------
    model : gee or mixed logit
    logit, low, high : estimate and interval of `level`
    p : two-sided, against 0
    person_sd, item_sd : standard deviations of the effects, logits; NaN where the model has none
    freedom : degrees of freedom of Student's t
    """

    model: str
    logit: float
    low: float
    high: float
    p: float
    person_sd: float
    item_sd: float
    freedom: int
    level: float = 0.95

    @property
    def ratio(self) -> float:
        """Preference ratio, exp(logit)."""
        return float(np.exp(self.logit))


def statsmodels_installed() -> bool:
    try:
        import statsmodels.genmod.generalized_estimating_equations  # noqa: F401
    except ImportError:
        return False
    return True


def gee(choices: Choices, *, level: float = 0.95) -> LogOdds:
    """Mean over people, pairs taken as given: GEE with exchangeable answers within participants; ties left out.

    Bias-reduced covariance (Mancl and DeRouen, Biometrics 57, 2001), Student's t with participants - 1 degrees of
    freedom.

    Raises
    ------
    InputError : statsmodels missing, fewer than 3 participants or pairs, or all answers the same
    """
    if not statsmodels_installed():
        raise InputError("expected statsmodels for GEE; install it with: pip install lipmetrics[statistics]")
    from statsmodels.genmod.cov_struct import Exchangeable
    from statsmodels.genmod.families import Binomial
    from statsmodels.genmod.generalized_estimating_equations import GEE

    y, person, _ = _without_ties(choices)
    order = np.argsort(person, kind="stable")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = GEE(y[order], np.ones((len(y), 1)), person[order], family=Binomial(), cov_struct=Exchangeable())
        found = model.fit(cov_type="bias_reduced")
    return _student("gee", found.params[0], found.bse[0], np.nan, np.nan, person.max(), level)


def mixed_logit(choices: Choices, *, level: float = 0.95) -> LogOdds:
    """The middle participant and pair: logit = beta + normal effect of the participant + of the pair; ties left out.

    Maximum likelihood by Laplace's approximation (Breslow and Clayton, Journal of the American Statistical Association
    88, 1993); standard error from the curvature in all three parameters, Student's t with the lesser of
    participants - 1 and pairs - 1 degrees of freedom.

    Raises
    ------
    InputError : fewer than 3 participants or pairs, or all answers the same
    """
    y, person, item = _without_ties(choices)
    effects = np.zeros(person.max() + item.max() + 2)  # the last mode, from which the next search starts

    def loss(x):
        return _minus_log_likelihood(y, person, item, x[0], abs(x[1]), abs(x[2]), effects)

    begin = np.array([np.log(y.mean() / (1 - y.mean())), 0.3, 0.3])
    options = {"xatol": 1e-4, "fatol": 1e-7, "maxiter": 1000}
    best = optimize.minimize(loss, begin, method="Nelder-Mead", options=options).x
    best[1:] = np.abs(best[1:])
    keep = np.array([True, best[1] > 1e-3, best[2] > 1e-3])  # a variance at 0 has no curvature to speak of
    error = np.sqrt(np.linalg.inv(_curvature(loss, best)[np.ix_(keep, keep)])[0, 0])
    return _student("mixed logit", best[0], error, best[1], best[2], min(person.max(), item.max()), level)


def _minus_log_likelihood(y, person, item, beta, person_sd, item_sd, effects: np.ndarray) -> float:
    """Laplace's approximation.

    `effects` (I + J) holds a start for the effects over their standard deviations, and then their mode, found by
    Newton's method.
    """
    persons_n, items_n = person.max() + 1, item.max() + 1
    sd = np.repeat([person_sd, item_sd], [persons_n, items_n])
    cell = person * items_n + item

    def at(effects):
        scaled = effects * sd
        logit = beta + scaled[person] + scaled[persons_n + item]
        chance = 1 / (1 + np.exp(-logit))
        weight = np.bincount(cell, chance * (1 - chance), persons_n * items_n).reshape(persons_n, items_n)
        bend = np.block([[np.diag(weight.sum(1)), weight], [weight.T, np.diag(weight.sum(0))]])
        return logit, chance, bend * sd * sd[:, None] + np.eye(len(sd))

    for _ in range(STEPS_N):
        _, chance, bend = at(effects)
        rest = y - chance
        slope = np.concatenate([np.bincount(person, rest, persons_n), np.bincount(item, rest, items_n)]) * sd - effects
        step = np.linalg.solve(bend, slope)
        effects += step
        if np.abs(step).max() < 1e-9:
            break
    logit, _, bend = at(effects)
    fit = (y * logit - np.logaddexp(0, logit)).sum() - effects @ effects / 2
    return float(np.linalg.slogdet(bend)[1] / 2 - fit)


def _curvature(loss, x: np.ndarray, step: float = 1e-3) -> np.ndarray:
    n = len(x)
    found = np.empty((n, n))
    moves = np.eye(n) * step
    for i in range(n):
        for j in range(i + 1):
            corners = [loss(x + a * moves[i] + b * moves[j]) for a in (1, -1) for b in (1, -1)]
            found[i, j] = found[j, i] = (corners[0] - corners[1] - corners[2] + corners[3]) / (4 * step**2)
    return found


def _without_ties(choices: Choices) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    keep = choices.y != 0.5
    y = choices.y[keep]
    names, person = np.unique(choices.person[keep], return_inverse=True)
    pairs, item = np.unique(choices.item[keep], return_inverse=True)
    if len(names) < 3 or len(pairs) < 3 or y.min(initial=1) == y.max(initial=0):
        raise InputError(
            f"expected both answers, of at least 3 participants to at least 3 pairs, got {int(y.sum())} of {len(y)} "
            f"for one side, {len(names)} participants, {len(pairs)} pairs"
        )
    return y, person, item


def _student(model, logit, error, person_sd, item_sd, freedom, level) -> LogOdds:
    half = stats.t.isf((1 - level) / 2, freedom) * error
    p = 2 * stats.t.sf(abs(logit) / error, freedom)
    values = map(float, (logit, logit - half, logit + half, p, person_sd, item_sd))
    return LogOdds(model, *values, int(freedom), level)
