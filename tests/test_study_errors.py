"""The benchmark of the study's tests, and what its committed table must show."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from study.power import Scenario, simulate

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import study_errors


def test_the_tests_not_taken_by_hand():
    y = simulate(Scenario(6, 8, 0.4, 0.6, 0.6), 1, np.random.default_rng(1))
    found = study_errors.all_p_values(y, np.random.default_rng(2), 99)
    one = y[0]
    mean, people, pairs = one.mean(), one.mean(1), one.mean(0)
    a, b = 8 * people.var(ddof=1), 6 * pairs.var(ddof=1)
    rest = ((one - people[:, None] - pairs + mean) ** 2).sum() / 35
    t = abs(mean - 0.5) / np.sqrt((a + b - rest) / 48)
    freedom = (a + b - rest) ** 2 / (a**2 / 5 + b**2 / 7 + rest**2 / 35)
    assert found["normal"][0] == pytest.approx(2 * stats.norm.sf(t))
    assert found["satterthwaite"][0] == pytest.approx(2 * stats.t.sf(t, freedom))
    assert found["larger"][0] == max(found["participants"][0], found["pairs"][0])


def test_a_small_table_has_a_row_for_every_test():
    table = study_errors.type_one(5, 6, 40, draws=99)
    assert table.shape == (len(study_errors.NAMES), 6)
    assert ((table >= 0) & (table <= 100)).all(axis=None)


def test_the_committed_table_meets_the_target():
    """4 to 6 % for the headline test in all twelve cells; the pooled binomial outside in the ten where people or pairs
    differ."""
    text = (
        Path(study_errors.__file__)
        .with_name("RESULTS.md")
        .read_text()
        .partition("<!-- study -->")[2]
        .partition("<!-- end -->")[0]
    )
    rows = {
        name: [
            [float(cell) for cell in row.split("|")[2:8]]
            for row in re.findall(rf"^\| {re.escape(study_errors.NAMES[name])} \|.*$", text, re.MULTILINE)[:2]
        ]
        for name in ("headline", "binomial")
    }
    assert len(rows["headline"]) == len(rows["binomial"]) == 2
    assert all(4 <= rate <= 6 for row in rows["headline"] for rate in row)
    assert all(rate > 9 for row in rows["binomial"] for rate in row[1:])
