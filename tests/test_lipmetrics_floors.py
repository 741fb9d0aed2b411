import math

import numpy as np
import pytest
from scipy import stats

from lipmetrics import floors


@pytest.fixture
def rng():
    return np.random.default_rng(2)


def ones(n):
    return np.ones((1, n))


def test_percentile_is_that_of_scipy_with_ties_halved(rng):
    floor = rng.integers(0, 6, 40).astype(float)
    scores = np.arange(-1, 8).astype(float)
    expected = [stats.percentileofscore(floor, s, kind="mean") for s in scores]
    np.testing.assert_allclose(floors.percentile(scores[None], floor[None])[0], expected)


def test_rounding_does_not_break_a_tie():
    assert floors.percentile(np.array([[0.1 + 0.2]]), np.array([[0.3, 0.3]])) == 50


def test_weights_are_copies(rng):
    floor, counts = rng.normal(size=9), rng.integers(0, 4, 9)
    copies = np.repeat(floor, counts)
    score = np.array([[0.1, -0.4]])
    np.testing.assert_allclose(
        floors.percentile(score, floor[None], counts[None].astype(float)), floors.percentile(score, copies[None])
    )
    assert floors.weighted_median(floor[None], counts[None].astype(float)) == pytest.approx(np.median(copies))


@pytest.mark.parametrize("n", [1, 2, 5, 8])
def test_median_without_weights(n, rng):
    values = rng.normal(size=(3, n))
    np.testing.assert_allclose(floors.weighted_median(values), np.median(values, axis=1))


def test_unknown_values_have_no_weight():
    floor = np.array([[1.0, math.nan, 3.0]])
    assert floors.percentile(np.array([[2.0]]), floor) == 50
    assert floors.weighted_median(floor) == 2
    assert math.isnan(floors.percentile(np.array([[math.nan]]), floor)[0, 0])
    assert math.isnan(floors.percentile(np.array([[1.0]]), np.full((1, 2), math.nan))[0, 0])
    assert math.isnan(floors.weighted_median(np.empty((1, 0)))[0])


def slow_leave_out(distances, groups, i):
    """Mean over the other groups of the mean over their takes, one take at a time."""
    means = []
    for g in set(groups) - {groups[i]}:
        values = [distances[i, j] for j in range(len(groups)) if groups[j] == g and math.isfinite(distances[i, j])]
        if values:
            means.append(sum(values) / len(values))
    return sum(means) / len(means)


def test_leaving_a_group_out_is_that_of_loops(rng):
    groups = np.array([0, 0, 1, 2, 2, 2, 3])
    distances = rng.random((7, 7))
    distances[0, 2] = math.nan
    found = floors.against_groups(floors.leave_group_out(distances, groups, 4), ones(4))[0]
    np.testing.assert_allclose(found, [slow_leave_out(distances, groups, i) for i in range(7)])


def test_a_group_drawn_twice_counts_twice():
    means = np.array([[1.0, 4.0, math.nan]])
    np.testing.assert_allclose(floors.against_groups(means, np.array([[2.0, 1, 5], [0, 0, 1]])), [[2], [math.nan]])


def test_within_a_group():
    distances = np.array([[0.0, 2, 9], [4, 0, 9], [9, 9, 0]])
    np.testing.assert_allclose(floors.within_group(distances, np.array([0, 0, 1])), [2, 4, math.nan])
