import itertools

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from study.clusters import bootstrap_weights, clustered_share, expanded_percentiles, sign_flip_p
from study.errors import InputError
from study.responses import Choices


def choices(matrix) -> Choices:
    """Answers of participants (rows) to pairs (columns)."""
    matrix = np.asarray(matrix, dtype=float)
    person, item = np.indices(matrix.shape).reshape(2, -1)
    names = tuple(map(str, range(matrix.shape[0]))), tuple(map(str, range(matrix.shape[1])))
    return Choices(matrix.ravel(), person, item, *names, pd.DataFrame())


def test_sign_flips_equal_going_through_all_patterns():
    rng = np.random.default_rng(1)
    for _ in range(20):
        excess = rng.integers(-6, 7, 9) / 2
        sums = [abs(np.dot(signs, np.abs(excess))) for signs in itertools.product((-1, 1), repeat=9)]
        assert sign_flip_p(excess) == pytest.approx(np.mean(np.array(sums) >= abs(excess.sum()) - 1e-9))


def test_sign_flips_of_a_unanimous_group():
    assert sign_flip_p(np.ones(6)) == pytest.approx(2 / 2**6)
    assert sign_flip_p(np.zeros(4)) == 1


def test_equal_sizes_give_students_test_on_the_participants_means():
    matrix = np.random.default_rng(2).integers(0, 2, (11, 8))
    found = clustered_share(choices(matrix))
    test = stats.ttest_1samp(matrix.mean(1), 0.5)
    interval = test.confidence_interval(0.95)
    assert found.share == pytest.approx(matrix.mean())
    assert found.p_t == pytest.approx(test.pvalue)
    assert (found.low, found.high) == pytest.approx((interval.low, interval.high))


def test_people_who_agree_with_themselves_widen_the_interval():
    """The same answers, dealt so that each participant answers all alike, are worth fewer."""
    together = np.repeat([1, 1, 1, 1, 1, 1, 0, 0, 0, 0], 5).reshape(10, 5)
    spread = np.array([[1, 1, 1, 0, 0]] * 8 + [[1, 1, 1, 1, 0], [1, 1, 0, 0, 0]])
    wide, narrow = clustered_share(choices(together)), clustered_share(choices(spread))
    assert wide.share == narrow.share == 0.6
    assert wide.p_sign_flip > 0.5 and wide.high - wide.low > 3 * (narrow.high - narrow.low)
    assert wide.boot_high - wide.boot_low > 2 * (narrow.boot_high - narrow.boot_low)


def test_without_spread_there_is_no_interval():
    found = clustered_share(choices(np.ones((4, 3))))
    assert found.share == 1 and np.isnan([found.low, found.high, found.p_t]).all()
    assert found.p_sign_flip == pytest.approx(2 / 16)


def test_expanded_percentiles_are_as_long_as_students_interval():
    """For a mean, whose bootstrap distribution is normal with sd s sqrt((n-1)/n) / sqrt(n)."""
    n, s = 12, 2.0
    drawn = stats.norm.ppf((np.arange(200_000) + 0.5) / 200_000) * s * np.sqrt((n - 1) / n) / np.sqrt(n)
    low, high = expanded_percentiles(drawn, n, 0.95)
    assert high == pytest.approx(stats.t.ppf(0.975, n - 1) * s / np.sqrt(n), rel=1e-3)
    assert low == pytest.approx(-high)


def test_the_same_seed_gives_the_same_interval():
    matrix = np.random.default_rng(3).integers(0, 2, (9, 5))
    assert clustered_share(choices(matrix), seed=4) == clustered_share(choices(matrix), seed=4)
    assert not np.array_equal(bootstrap_weights(9, 4), bootstrap_weights(9, 5))


def test_no_answers_are_refused():
    with pytest.raises(InputError, match="at least one answer"):
        clustered_share(choices(np.empty((0, 0))))
