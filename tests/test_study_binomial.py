import numpy as np
import pytest
from scipy import stats

from study.binomial import clopper_pearson, holm, p_at_least, p_more_than, p_two_sided, share_to_ratio, wilson
from study.errors import InputError

N = [1, 2, 7, 20, 31]


def coverage(low, high, n, shares):
    """(S,) probability that the interval of the count holds the share, summed over all counts."""
    chance = stats.binom.pmf(np.arange(n + 1)[:, None], n, shares)
    return (chance * ((low[:, None] <= shares) & (shares <= high[:, None]))).sum(0)


@pytest.mark.parametrize("n", N)
def test_p_values_and_exact_intervals_equal_scipy(n):
    r = np.arange(n + 1)
    low, high = clopper_pearson(r, n)
    wilson_low, wilson_high = wilson(r, n, 0.9)
    for k in r:
        test = stats.binomtest(int(k), n)
        assert p_two_sided(int(k), n) == pytest.approx(test.pvalue, abs=1e-14)
        assert p_at_least(int(k), n) == pytest.approx(stats.binomtest(int(k), n, alternative="greater").pvalue)
        assert (low[k], high[k]) == pytest.approx(tuple(test.proportion_ci(0.95, "exact")), abs=1e-12)
        assert (wilson_low[k], wilson_high[k]) == pytest.approx(tuple(test.proportion_ci(0.9, "wilson")), abs=1e-12)


def test_the_thesis_takes_one_count_too_few():
    assert p_at_least(346, 576) == pytest.approx(7.656e-7, rel=1e-3)
    assert p_more_than(346, 575) == pytest.approx(3.951e-7, rel=1e-3)
    assert p_at_least(5, 9) == pytest.approx(p_more_than(4, 9)) == pytest.approx(0.5)


@pytest.mark.parametrize("n", [5, 20, 60])
def test_coverage_of_exact_intervals_is_at_least_nominal_for_every_share(n):
    r = np.arange(n + 1)
    low, high = clopper_pearson(r, n)
    ends = np.concatenate([np.linspace(0, 1, 1001), low + 1e-9, high - 1e-9]).clip(0, 1)
    covered = coverage(low, high, n, ends)
    assert covered.min() >= 0.95 - 1e-9


@pytest.mark.parametrize("n", [20, 60])
def test_coverage_of_wilson_is_nominal_on_average_only(n):
    r = np.arange(n + 1)
    low, high = wilson(r, n)
    shares = np.linspace(0.0005, 0.9995, 1000)
    covered = coverage(low, high, n, shares)
    assert np.mean(covered) == pytest.approx(0.95, abs=0.01)
    assert np.min(covered) < 0.95


def test_nothing_asked_nothing_known():
    assert p_at_least(0, 0) == p_two_sided(0, 0) == 1
    assert clopper_pearson(0, 0) == wilson(0, 0) == (0, 1)


def test_ratio_of_a_share():
    assert share_to_ratio(0.6) == pytest.approx(1.5)
    assert share_to_ratio(1.0) == np.inf


def test_holm_by_hand():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    found = holm([0.5, np.nan, 0.4])
    assert found[[0, 2]] == pytest.approx([0.8, 0.8]) and np.isnan(found[1])
    assert len(holm([])) == 0


def test_holm_keeps_the_family_error():
    """All nulls true: at least one of six rejected in at most 5 % of families; without Holm in 26 %."""
    p = np.random.default_rng(0).random((4000, 6))
    assert np.mean([(holm(row) <= 0.05).any() for row in p]) < 0.06
    assert np.mean((p <= 0.05).any(1)) > 0.2


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: p_at_least(3, 2), "0 to n answers"),
        (lambda: p_two_sided(-1, 2), "0 to n answers"),
        (lambda: p_at_least(1.5, 2), "whole numbers"),
        (lambda: wilson(1, 2, 95), "between 0 and 1"),
    ],
)
def test_bad_counts_are_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()
