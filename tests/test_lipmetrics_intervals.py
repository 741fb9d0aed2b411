import itertools
import math

import numpy as np
import pytest
from scipy import stats

from lipmetrics.errors import InputError
from lipmetrics.intervals import bootstrap, cluster_counts, compare_paired, holm, mean_by_counts, sign_flip_test


@pytest.fixture
def rng():
    return np.random.default_rng(4)


def mean_of(values):
    return mean_by_counts(values, np.arange(len(values)))


def test_counts_are_samples_with_replacement():
    counts = cluster_counts(7, 4000, seed=1)
    assert (counts.sum(axis=1) == 7).all()
    np.testing.assert_allclose(counts.mean(axis=0), 1, atol=0.05)
    np.testing.assert_allclose((counts == 0).mean(), (6 / 7) ** 7, atol=0.01)


def test_the_percentile_interval_is_the_quantiles_of_the_draws(rng):
    values = rng.exponential(size=20)
    found = bootstrap(mean_of(values), (20,), draws=3000, seed=5)
    assert found.value == pytest.approx(values.mean())
    drawn = cluster_counts(20, 3000, 5) @ values / 20
    assert (found.low, found.high) == pytest.approx(tuple(np.quantile(drawn, [0.025, 0.975])))


def test_bca_is_that_of_scipy(rng):
    values = rng.exponential(size=25)
    found = bootstrap(mean_of(values), (25,), draws=20_000, method="bca")
    other = stats.bootstrap((values,), np.mean, n_resamples=20_000, method="BCa", rng=np.random.default_rng(0))
    width = found.high - found.low
    assert found.low == pytest.approx(other.confidence_interval.low, abs=0.03 * width)
    assert found.high == pytest.approx(other.confidence_interval.high, abs=0.03 * width)
    plain = bootstrap(mean_of(values), (25,), draws=20_000)
    assert found.high > plain.high + 0.02 * width  # a skewed sample: the correction is to be seen


def test_bca_of_two_samples_is_that_of_scipy(rng):
    a, b = rng.exponential(size=15), rng.exponential(2, size=30)
    mean_a, mean_b = mean_of(a), mean_of(b)
    found = bootstrap(lambda wa, wb: mean_a(wa) - mean_b(wb), (15, 30), draws=20_000, method="bca")

    def difference(x, y, axis=-1):
        return np.mean(x, axis=axis) - np.mean(y, axis=axis)

    other = stats.bootstrap((a, b), difference, n_resamples=20_000, method="BCa", rng=np.random.default_rng(0))
    width = found.high - found.low
    assert found.low == pytest.approx(other.confidence_interval.low, abs=0.04 * width)
    assert found.high == pytest.approx(other.confidence_interval.high, abs=0.04 * width)


def test_clusters_make_intervals_wider_than_their_clips(rng):
    speakers = np.repeat(np.arange(12), 10)
    values = rng.normal(size=12)[speakers] + 0.1 * rng.normal(size=120)
    clustered = bootstrap(mean_by_counts(values, speakers), (12,))
    loose = bootstrap(mean_of(values), (120,))
    assert clustered.high - clustered.low > 2 * (loose.high - loose.low)


def test_one_cluster_has_no_interval():
    found = bootstrap(mean_of(np.array([3.0])), (1,))
    assert found.value == 3 and math.isnan(found.low) and math.isnan(found.high)


def test_unknown_values_are_left_out():
    mean = mean_by_counts(np.array([1.0, math.nan, 5.0]), np.array([0, 0, 1]))
    np.testing.assert_allclose(mean(np.array([[1.0, 1.0], [2.0, 1.0], [0.0, 2.0]])), [3, 7 / 3, 5])
    assert math.isnan(mean(np.zeros((1, 2)))[0])


def by_hand(sums):
    """Two-sided p over all 2^n flips, one by one."""
    flips = [abs(np.dot(signs, sums)) for signs in itertools.product((-1, 1), repeat=len(sums))]
    return np.mean(np.array(flips) >= abs(sum(sums)) * (1 - 1e-12))


@pytest.mark.parametrize("n", [1, 2, 5, 9])
def test_sign_flips_are_counted_exactly(n, rng):
    differences = rng.normal(0.5, 1, n)
    found = sign_flip_test(differences)
    assert found.exact and found.flips == 2**n
    assert found.p == pytest.approx(by_hand(differences))
    assert found.smallest_p == pytest.approx(2 / 2**n)


def test_sign_flips_are_those_of_scipy(rng):
    a, b = rng.normal(size=10), rng.normal(0.6, 1, size=10)
    other = stats.permutation_test((a, b), lambda x, y: np.mean(x - y), permutation_type="samples", n_resamples=np.inf)
    assert sign_flip_test(a - b).p == pytest.approx(other.pvalue)


def test_clusters_are_flipped_as_one(rng):
    differences = rng.normal(0.4, 1, 12)
    clusters = np.array([0, 0, 0, 1, 1, 2, 2, 2, 2, 3, 4, 4])
    found = sign_flip_test(differences, clusters)
    assert found.p == pytest.approx(by_hand(np.bincount(clusters, differences)))
    assert found.clusters == 5


def test_many_flips_are_drawn_and_never_give_0(rng):
    differences = rng.normal(0.5, 1, 30)
    found = sign_flip_test(differences, draws=4999)
    assert not found.exact
    assert found.p == pytest.approx(stats.ttest_1samp(differences, 0).pvalue, abs=0.02)
    assert sign_flip_test(np.ones(40), draws=999).p == 1 / 1000


def test_p_is_even_where_nothing_differs(rng):
    p = [sign_flip_test(rng.normal(size=8)).p for _ in range(400)]
    for level in (0.1, 0.3, 0.5):
        assert np.mean(np.array(p) <= level) == pytest.approx(level, abs=0.07)


def test_paired_comparison():
    first, second = np.array([1.0, 2, 3, 4, math.nan]), np.array([2.0, 4, 3, 5, 6])
    found = compare_paired(first, second, np.array(["u", "u", "v", "w", "x"]))
    assert found.difference.value == pytest.approx(-1)
    assert (found.mean_first, found.mean_second, found.items_n) == (2.5, 3.5, 4)
    assert (found.first_lower, found.second_lower) == (3, 0)
    assert found.test.p == pytest.approx(by_hand([-3, 0, -1]))
    assert found.difference.clusters == (3,)


def test_holm_by_hand():
    np.testing.assert_allclose(holm(np.array([0.01, 0.04, math.nan, 0.03])), [0.03, 0.06, math.nan, 0.06])
    np.testing.assert_allclose(holm(np.array([0.9, 0.8])), [1, 1])


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: bootstrap(mean_of(np.ones(2)), (2,), method="bcca"), "percentile or bca"),
        (lambda: bootstrap(mean_of(np.ones(2)), (2,), level=95), "between 0 and 1"),
        (lambda: cluster_counts(0), "at least one cluster"),
        (lambda: compare_paired(np.ones(2), np.ones(3)), "one length"),
        (lambda: compare_paired(np.array([math.nan]), np.ones(1)), "both models"),
    ],
)
def test_bad_input(call, sentence):
    with pytest.raises(InputError, match=sentence):
        call()
