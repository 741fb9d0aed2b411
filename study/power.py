"""How often a test would find a preference: the design simulated, with effects of the person and of the pair.

The logit of choosing a is `preference` + normal(0, person_sd) of the participant + normal(0, item_sd) of the pair. With
preference 0 the rate is the error of the first kind.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
from scipy import stats

from study.design import Design
from study.errors import InputError
from study.headline import headline, null_t2_complete, t2_complete, two_way_p
from study.responses import Choices

TESTS = ("headline", "participants", "pairs", "binomial")
DRAWS = 1999


@dataclasses.dataclass(frozen=True)
class Scenario:
    """What is simulated.

    Parameters
    ----------
    participants_n, items_n : participants, and pairs of videos that put a against b; everybody answers each once
    preference : logit of choosing a for the middle participant and pair; 0.405 is a ratio of 1.5
    person_sd, item_sd : standard deviations of the effects, logits
    """

    participants_n: int = 20
    items_n: int = 30
    preference: float = 0.4
    person_sd: float = 0.5
    item_sd: float = 0.5

    def __post_init__(self):
        for name in ("participants_n", "items_n"):
            if getattr(self, name) < 3:
                raise InputError(f"expected {name} to be at least 3, got {getattr(self, name)}")
        for name in ("person_sd", "item_sd"):
            if not getattr(self, name) >= 0:
                raise InputError(f"expected {name} to be 0 or more logits, got {getattr(self, name)}")
        if not np.isfinite(self.preference):
            raise InputError(f"expected preference in logits, got {self.preference}")


def simulate(scenario: Scenario, studies_n: int, rng: np.random.Generator) -> np.ndarray:
    """(S, I, J) answers, 1 for a and 0 for b."""
    shape = (studies_n, scenario.participants_n, scenario.items_n)
    logit = scenario.preference + rng.normal(0, 1, shape[:2])[:, :, None] * scenario.person_sd
    logit = logit + rng.normal(0, 1, (studies_n, shape[2]))[:, None] * scenario.item_sd
    return (rng.random(shape) < 1 / (1 + np.exp(-logit))).astype(float)


def p_values(y: np.ndarray, rng: np.random.Generator, draws: int = DRAWS) -> dict[str, np.ndarray]:
    """Two-sided p (S,) of each of `TESTS` for studies y (S, I, J) in which everybody answered everything.

    headline : `study.headline`; participants, pairs : Student's t on their means; binomial : all answers as coins
    """
    _, persons_n, items_n = y.shape
    n = persons_n * items_n
    r = np.rint(y.sum((1, 2))).astype(int)
    found = {"headline": headline_p(y, rng, draws)}
    for name, axis in (("participants", 2), ("pairs", 1)):
        means = y.mean(axis)
        error = means.std(1, ddof=1) / np.sqrt(means.shape[1])
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.where(np.abs(means.mean(1) - 0.5) < 1e-12, 0, np.abs(means.mean(1) - 0.5) / error)
        found[name] = 2 * stats.t.sf(t, means.shape[1] - 1)
    by_count = 2 * np.minimum(stats.binom.cdf(np.arange(n + 1), n, 0.5), stats.binom.sf(np.arange(n + 1) - 1, n, 0.5))
    found["binomial"] = np.minimum(1, by_count)[r]
    return found


def headline_p(y: np.ndarray, rng: np.random.Generator, draws: int = DRAWS) -> np.ndarray:
    """p (S,) of the headline test for complete studies y (S, I, J); one set of random numbers serves all studies."""
    t2, variances = t2_complete(y - 0.5)
    null_t2 = null_t2_complete(y.shape[1], y.shape[2], draws, rng)
    return np.array([two_way_p(t2[s], null_t2(variances[:, s])) for s in range(len(y))])


def rejection(
    scenario: Scenario, *, alpha: float = 0.05, studies_n: int = 2000, seed: int = 0, draws: int = DRAWS
) -> pd.DataFrame:
    """How often each of `TESTS` has p <= alpha.

    Returns
    -------
    One row per test: test, rate, error (standard error of the rate from `studies_n` simulated studies)
    """
    rng = np.random.default_rng(seed)
    counts, done = dict.fromkeys(TESTS, 0), 0
    chunk = max(1, 2_000_000 // (scenario.participants_n * scenario.items_n))
    while done < studies_n:
        y = simulate(scenario, min(chunk, studies_n - done), rng)
        for name, p in p_values(y, rng, draws).items():
            counts[name] += int((p <= alpha + 1e-12).sum())
        done += len(y)
    rate = np.array([counts[name] / studies_n for name in TESTS])
    return pd.DataFrame({"test": TESTS, "rate": rate, "error": np.sqrt(rate * (1 - rate) / studies_n)})


def sample_size(
    scenario: Scenario,
    *,
    power: float = 0.8,
    alpha: float = 0.05,
    studies_n: int = 1000,
    seed: int = 0,
    most: int = 400,
) -> tuple[int | None, pd.DataFrame]:
    """The fewest participants with whom the headline test finds the preference as often as `power`.

    Returns
    -------
    participants, or None if `most` are not enough (pairs that differ set a limit no number of participants passes),
    and a table of what was tried: participants_n, power, error

    Raises
    ------
    InputError : no preference to find, or a power that is not between 0 and 1
    """
    if scenario.preference == 0:
        raise InputError("expected a preference to find, got 0 logits; give the least that would matter, such as 0.4")
    if not 0 < power < 1:
        raise InputError(f"expected a power between 0 and 1, such as 0.8, got {power}")
    tried: dict[int, tuple[float, float]] = {}

    def enough(n: int) -> bool:
        one = dataclasses.replace(scenario, participants_n=n)
        row = rejection(one, alpha=alpha, studies_n=studies_n, seed=seed).iloc[0]
        tried[n] = float(row["rate"]), float(row["error"])
        return tried[n][0] >= power

    low, high = 4, 8
    while not enough(high):
        low, high = high, min(2 * high, most)
        if low == most:
            break
    found = None
    if tried[high][0] >= power:
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if enough(middle) else (middle, high)
        found = high
    table = pd.DataFrame([(n, *tried[n]) for n in sorted(tried)], columns=["participants_n", "power", "error"])
    return found, table


def design_power(
    design: Design,
    *,
    preference: float = 0.4,
    person_sd: float = 0.5,
    item_sd: float = 0.5,
    alpha: float = 0.05,
    studies_n: int = 300,
    draws: int = 999,
    seed: int = 0,
) -> tuple[float, float]:
    """Power of the headline test for the very trials of a design, and its standard error.

    Counted are the pairs with the least level; y is 1 where the other video is chosen.
    """
    level = {one.code: one.level for one in design.stimuli}
    least = min((one.level for one in design.stimuli), key=lambda text: (_number(text), text))
    items = [i for i, (a, b) in enumerate(design.pairs, start=1) if least in (level[a], level[b])]
    place = {question: at for at, question in enumerate(items)}
    cells = [
        (person, place[trial.question])
        for person, session in enumerate(design.sessions)
        for trial in session
        if trial.kind == "test" and trial.question in place
    ]
    if not cells:
        raise InputError(f"expected trials with level {least} in the design, got none")
    person, item = np.array(cells).T
    used, item = np.unique(item, return_inverse=True)
    rng = np.random.default_rng(seed)
    names = tuple(map(str, range(len(design.sessions)))), tuple(map(str, used))
    found = 0
    for number in range(studies_n):
        logit = preference + rng.normal(0, person_sd, len(names[0]))[person] + rng.normal(0, item_sd, len(used))[item]
        y = (rng.random(len(person)) < 1 / (1 + np.exp(-logit))).astype(float)
        choices = Choices(y, person, item, *names, pd.DataFrame())
        found += headline(choices, draws=draws, seed=seed + number).p <= alpha
    rate = found / studies_n
    return rate, float(np.sqrt(rate * (1 - rate) / studies_n))


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.inf
