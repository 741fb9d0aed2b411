import numpy as np
import pandas as pd
import pytest
from scipy import optimize

from study.bradley_terry import fit, strengths
from study.errors import InputError
from study.responses import answers_from, thesis_answers


def table(rows) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=["participant", "left", "right", "chosen"])


def minus_log_likelihood(x, wins, ties):
    strength, nu = np.concatenate([[0], x[:-1]]), np.exp(x[-1])
    found = 0
    for i in range(len(wins)):
        for j in range(i + 1, len(wins)):
            a, b = np.exp(strength[i]), np.exp(strength[j])
            tie = nu * np.sqrt(a * b)
            for seen, weight in ((wins[i, j], a), (wins[j, i], b), (ties[i, j], tie)):
                found -= seen * np.log(weight / (a + b + tie)) if seen else 0
    return found


def test_strengths_and_ties_are_the_maximum_of_the_likelihood():
    rng = np.random.default_rng(1)
    wins = rng.integers(5, 40, (4, 4)) * (1 - np.eye(4, dtype=int))
    ties = np.triu(rng.integers(1, 15, (4, 4)), 1)
    ties = ties + ties.T
    found, nu = fit(wins[None], ties[None])
    best = optimize.minimize(minus_log_likelihood, np.zeros(4), args=(wins, ties), method="BFGS").x
    assert found[0] == pytest.approx(np.r_[0, best[:-1]], abs=2e-4)
    assert nu[0] == pytest.approx(np.exp(best[-1]), rel=1e-3)


def test_two_levels_are_the_log_of_their_ratio():
    rows = [(f"p{i}", "m_0", "m_1", "m_1" if i % 4 else "m_0") for i in range(20)]
    found = strengths(answers_from(table(rows)))
    assert found.table["strength"].tolist() == pytest.approx([0, np.log(3)], abs=1e-3)
    assert found.table["share"][1] == pytest.approx(0.75, abs=1e-3)
    assert found.tie == 0 and found.freedom == 0


def test_expected_counts_equal_the_seen_ones():
    """Scores of a maximum likelihood fit: each level wins as often as the model expects."""
    thesis = thesis_answers()
    found = strengths(thesis)
    strength = dict(zip(found.table["level"], found.table["strength"], strict=True))
    for level in thesis.levels:
        seen = expected = 0
        for other in thesis.levels:
            if other != level:
                pair = thesis.preference(level, other)
                seen += pair.for_a
                expected += pair.n / (1 + np.exp(strength[other] - strength[level]))
        assert expected == pytest.approx(seen, abs=0.01)


def test_the_thesis_prefers_7_then_4_then_10():
    found = strengths(thesis_answers())
    assert found.table.set_index("level")["rank"].to_dict() == {0: 4, 4: 2, 7: 1, 10: 3}
    assert found.participants_n == 20 and found.freedom == 3
    seven = found.differences.set_index(["level_a", "level_b"]).loc[(7, 10)]
    assert seven["low"] < seven["difference"] < seven["high"] < 0


def test_known_strengths_come_back_with_intervals_that_hold_them():
    rng = np.random.default_rng(2)
    true = {0: 0.0, 1: 0.8, 2: -0.5}
    rows = []
    for person in range(30):
        for _ in range(10):
            for i, j in ((0, 1), (1, 2), (0, 2)):
                first = rng.random() < 1 / (1 + np.exp(true[j] - true[i]))
                rows.append((f"p{person}", f"m_{i}", f"m_{j}", f"m_{i if first else j}"))
    found = strengths(answers_from(table(rows))).table
    assert found["strength"].to_numpy() == pytest.approx([0, 0.8, -0.5], abs=0.3)
    assert (found["low"] <= [0, 0.8, -0.5]).all() and (found["high"] >= [0, 0.8, -0.5]).all()


def test_a_level_that_always_wins_stays_finite():
    rows = [(f"p{i}", "m_0", "m_1", "m_1") for i in range(8)]
    found = strengths(answers_from(table(rows))).table
    assert np.isfinite(found[["strength", "low", "high"]]).all(axis=None) and found["strength"][1] > 5


def test_levels_that_never_met_are_refused():
    rows = [("p1", "m_0", "m_1", "m_0"), ("p2", "m_2", "m_3", "m_2")]
    with pytest.raises(InputError, match="no trial that joins 2, 3 to 0"):
        strengths(answers_from(table(rows)))
