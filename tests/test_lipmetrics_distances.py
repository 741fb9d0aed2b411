"""Hausdorff and L2 distances against scipy, a slow version and known curves."""

import numpy as np
import pytest
from compared_curves import movement, take
from scipy.spatial.distance import cdist, directed_hausdorff

import lipmetrics
from lipmetrics.compare import align, aligned_hausdorff, aligned_l2, hausdorff, l2
from lipmetrics.compare.distances import of_points
from lipmetrics.errors import InputError


def slow(p, q):
    """Directed, by all pairs."""
    return max(min(np.sqrt(((one - other) ** 2).sum()) for other in q) for one in p)


@pytest.mark.parametrize("scale", [0.01, 1.0, 30.0, 1000.0])
@pytest.mark.parametrize(("n", "m", "channels"), [(1, 1, 1), (1, 30, 2), (40, 1, 1), (50, 70, 1), (80, 60, 4)])
def test_equals_scipy_and_slow_version(n, m, channels, scale):
    random = np.random.default_rng(n + m)
    time_a, time_b = np.sort(random.uniform(0, 2, n)), np.sort(random.uniform(0.3, 2.5, m))
    a, b = scale * random.normal(size=(n, channels)), scale * random.normal(size=(m, channels))
    p, q = np.column_stack([time_a, a]), np.column_stack([time_b, b])
    found = of_points(time_a, a, time_b, b)
    assert found == pytest.approx((directed_hausdorff(p, q)[0], directed_hausdorff(q, p)[0]), rel=1e-12)
    assert found == pytest.approx((slow(p, q), slow(q, p)), rel=1e-12)


def test_many_smooth_curves_equal_all_pairs():
    random = np.random.default_rng(2)
    time = np.arange(150) / 50
    for _ in range(40):
        a, b = (np.cumsum(random.normal(size=(150, 2)), axis=0) * random.choice([0.01, 0.1, 1]) for _ in range(2))
        gaps = cdist(np.column_stack([time, a]), np.column_stack([time, b]))
        assert of_points(time, a, time, b) == pytest.approx((gaps.min(1).max(), gaps.min(0).max()), rel=1e-12)


@pytest.mark.parametrize("seconds_per_unit", [0.1, 1.0, 5.0])
def test_aligned_is_that_of_the_matched_points(seconds_per_unit):
    a, b = take(), take(1.3 * movement(np.arange(120) / 50 - 0.1))
    match = align(a, b)
    time = match.times_s.mean(axis=1) / seconds_per_unit
    p = np.column_stack([time, match.a.data[match.path[:, 0]]])
    q = np.column_stack([time, match.b.data[match.path[:, 1]]])
    found = hausdorff(a, b, seconds_per_unit=seconds_per_unit)
    assert (found.a_to_b, found.b_to_a) == pytest.approx((slow(p, q), slow(q, p)), rel=1e-12)
    assert found.value == max(found.a_to_b, found.b_to_a)
    assert (found.seconds_per_unit, found.aligned, found.unit) == (seconds_per_unit, True, "mw")
    assert aligned_hausdorff(match, seconds_per_unit) == found
    back = hausdorff(b, a, seconds_per_unit=seconds_per_unit)
    assert back.value == pytest.approx(found.value)


def test_the_time_unit_decides_what_a_shift_costs():
    """Two ramps of slope s, one late by d: the nearest point lies s d / sqrt(1 + s^2) away, in units of value."""
    time = np.arange(1001) / 500
    a, b = (time, 3 * time), (time, 3 * (time - 0.1))
    for seconds in (0.2, 1.0, 4.0):
        slope = 3 * seconds
        inner = 3 * 0.1 / np.sqrt(1 + slope**2)
        found = hausdorff(a, b, aligned=False, seconds_per_unit=seconds)
        # at the ends there is nothing nearer than the end of the other
        ends = min(np.hypot((time - 0.0) / seconds, 3 * (time - 0.1) - 0.0))
        assert found.value >= inner - 1e-6
        assert found.a_to_b == pytest.approx(
            max(inner, np.hypot((time - 2) / seconds, 3 * (time - 0.1) - 6).min()), rel=1e-3
        )
        assert ends == pytest.approx(inner, rel=1e-2)


def test_lateness_is_in_the_unaligned_distance_only():
    a, late = take(), take(late_s=0.2)
    assert hausdorff(a, late).value == pytest.approx(0, abs=1e-9)
    assert hausdorff(a, late, aligned=False).value > 0.1
    assert l2(a, late, aligned=True).value == pytest.approx(0, abs=1e-9)
    assert l2(a, late).value > 0.1


def test_l2_by_hand():
    a, b = (np.arange(4), [[0.0, 0.0]] * 4), (np.arange(4), [[3.0, 1.0]] * 4)
    found = l2(a, b)
    assert found.value == pytest.approx(np.sqrt((9 + 1) / 2))
    assert found.channels == pytest.approx({"0": 3.0, "1": 1.0})
    assert (found.samples, found.aligned, found.unit) == (4, False, "")
    assert aligned_l2(align(a, b)) == l2(a, b, aligned=True)
    assert l2(a, b, aligned=True).value == pytest.approx(found.value)


def test_l2_takes_the_time_both_cover():
    time = np.arange(10.0)
    assert l2((time, time), (time[4:], time[4:] + 1)).samples == 6
    assert l2((time, time), (time + 3.5, time + 3.5)).value == pytest.approx(0)
    with pytest.raises(InputError, match="no moment in common; pass clock='start'"):
        l2((time, time), (time + 20, time))
    assert l2((time, time), (time + 20, time), clock="start").value == 0


def test_single_samples_and_constants():
    one, other = ([0.0], [1.0]), ([0.3], [1.4])
    assert hausdorff(one, other, aligned=False).value == pytest.approx(0.5)
    assert hausdorff(one, other).value == pytest.approx(0.4)  # aligned: at one time
    still = hausdorff(take(np.full((20, 3), 0.1)), take(np.full((30, 3), 0.2)))
    assert still.value == pytest.approx(np.sqrt(3) * 0.1)


@pytest.mark.parametrize("seconds", [0, -1, np.nan, np.inf, "1"])
def test_refused_time_unit(seconds):
    for aligned in (True, False):
        with pytest.raises(InputError, match="seconds_per_unit above 0"):
            hausdorff(take(), take(), seconds_per_unit=seconds, aligned=aligned)


@pytest.mark.parametrize(
    ("time", "values", "message"),
    [
        ([0.0, 1.0], [1.0, np.nan], "finite values"),
        ([0.0, np.nan], [1.0, 1.0], "finite time per point"),
        ([1.0, 0.0], [1.0, 1.0], "finite time per point"),
        ([0.0], [1.0, 1.0], "finite time per point"),
        ([], [], "at least one sample"),
        ([0.0], [[1.0, 2.0]], "same number of channels"),
    ],
)
def test_refused_points(time, values, message):
    with pytest.raises(InputError, match=message):
        of_points(np.array(time), values, np.array([0.0]), [0.0])


def test_mixed_units_and_top_level_names():
    with pytest.raises(InputError, match="one unit"):
        lipmetrics.hausdorff(take(), take(unit="m"))
    with pytest.raises(InputError, match="one unit"):
        lipmetrics.l2(take(), take(unit="m"))
