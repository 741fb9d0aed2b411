import numpy as np
import pandas as pd
import pytest

from study.errors import InputError
from study.mixed import _minus_log_likelihood, gee, mixed_logit, statsmodels_installed
from study.power import Scenario, simulate
from study.responses import Choices, thesis_answers


def choices(matrix) -> Choices:
    person, item = np.indices(matrix.shape).reshape(2, -1)
    names = tuple(map(str, range(matrix.shape[0]))), tuple(map(str, range(matrix.shape[1])))
    return Choices(matrix.ravel(), person, item, *names, pd.DataFrame())


def test_laplace_comes_near_the_integral():
    """People only: the likelihood is a product of integrals over one normal effect, here by Gauss and Hermite."""
    rng = np.random.default_rng(1)
    y = simulate(Scenario(9, 25, 0.3, 0.8, 0), 1, rng)[0]
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    weights = weights / weights.sum()
    for beta, sd in ((0.3, 0.8), (0.0, 0.4)):
        p = 1 / (1 + np.exp(-(beta + sd * nodes)))
        exact = -sum(np.log((weights * p ** row.sum() * (1 - p) ** (25 - row.sum())).sum()) for row in y)
        people, pairs = np.indices(y.shape).reshape(2, -1)
        found = _minus_log_likelihood(y.ravel(), people, pairs, beta, sd, 0.0, np.zeros(9 + 25))
        assert found == pytest.approx(exact, abs=0.1)


def test_known_effects_come_back():
    found = mixed_logit(choices(simulate(Scenario(40, 40, 0.5, 0.8, 0.6), 1, np.random.default_rng(2))[0]))
    assert found.low < 0.5 < found.high
    assert found.person_sd == pytest.approx(0.8, abs=0.25) and found.item_sd == pytest.approx(0.6, abs=0.25)
    assert found.freedom == 39


def test_without_effects_it_is_the_plain_log_odds():
    y = np.indices((12, 12)).sum(0) % 3 > 0  # every row and column 8 of 12
    found = mixed_logit(choices(y.astype(float)))
    assert found.logit == pytest.approx(np.log(2), abs=1e-3) and found.ratio == pytest.approx(2, abs=2e-3)
    assert found.person_sd < 0.02 and found.item_sd < 0.02
    half = (found.high - found.low) / 2
    assert half == pytest.approx(2.201 * np.sqrt(1 / 96 + 1 / 48), rel=0.01)  # t, 11 degrees of freedom


def test_the_thesis_by_both():
    pytest.importorskip("statsmodels")
    thesis = thesis_answers()
    sticky = thesis.choices(*thesis.sticky())
    by_people, by_both = gee(sticky), mixed_logit(sticky)
    assert by_people.ratio == pytest.approx(1.5, abs=0.02)
    assert by_people.p < by_both.p < 0.05  # pairs differ too, so more is uncertain


def test_gee_of_equal_sizes_is_the_mean_of_people():
    pytest.importorskip("statsmodels")
    y = simulate(Scenario(12, 10, 0.4, 0.6, 0), 1, np.random.default_rng(4))[0]
    found = gee(choices(y))
    share = 1 / (1 + np.exp(-found.logit))
    assert share == pytest.approx(y.mean(), abs=1e-4)
    # Mancl and DeRouen's correction divides each residual by 1 - 1/I
    error = np.sqrt(((y.mean(1) - y.mean()) ** 2).sum()) / 11 / (share * (1 - share))
    assert (found.high - found.logit) / 2.200985 == pytest.approx(error, rel=1e-3)


def test_bad_answers_are_refused(monkeypatch):
    with pytest.raises(InputError, match="expected both answers"):
        mixed_logit(choices(np.ones((5, 5))))
    with pytest.raises(InputError, match="at least 3 participants"):
        mixed_logit(choices(np.eye(2)))
    monkeypatch.setattr("study.mixed.statsmodels_installed", lambda: False)
    with pytest.raises(InputError, match=r"pip install lipmetrics\[statistics\]"):
        gee(choices(np.eye(5)))
    assert isinstance(statsmodels_installed(), bool)
