"""Alignment of takes: lag, warp and stretch of known shifts and tempos; rates, units and clocks."""

import numpy as np
import pytest
from compared_curves import movement, take

import lipmetrics
from lipmetrics.compare.alignment import align, largest_stretch, longest_hold, matched_mean, weighted_quantile
from lipmetrics.compare.curves import as_curve, even
from lipmetrics.compare.warping import dtw_path
from lipmetrics.errors import InputError


@pytest.mark.parametrize("late_s", [-0.2, -0.06, 0.0, 0.02, 0.2])
@pytest.mark.parametrize("cost", ["absolute", "squared"])
def test_lag_of_a_shift_is_the_shift(late_s, cost):
    match = align(take(), take(late_s=late_s), cost=cost)
    assert match.lag_s == pytest.approx(late_s, abs=1e-9)
    assert match.lag_low_s == pytest.approx(late_s, abs=1e-9)
    assert match.lag_high_s == pytest.approx(late_s, abs=1e-9)
    assert match.distance == pytest.approx(0, abs=1e-9)
    assert match.hold_s == pytest.approx(abs(late_s), abs=1e-9)  # the ends are tied together


def test_lag_does_not_fade_in_a_long_rest():
    match = align(take(end_s=12), take(end_s=12, late_s=0.3))
    assert match.lag_s == pytest.approx(0.3, abs=1e-9)
    assert np.median(np.diff(match.times_s, axis=1)) == pytest.approx(0.0, abs=1e-9)  # which the plain median does


def test_lag_beyond_the_band_is_reported_as_bound():
    match = align(take(), take(late_s=0.4), band=0.1)
    assert match.lag_s == pytest.approx(0.22, abs=1e-9)
    assert match.at_band > 0.2
    assert align(take(), take(late_s=0.4), band=0.3).at_band == 0
    assert align(take(), take(late_s=0.4), band=None).lag_s == pytest.approx(0.4, abs=1e-9)


def test_exchanged_takes_exchange_the_sign():
    random = np.random.default_rng(3)
    a = take(movement(np.arange(90) / 50) + 0.02 * random.random((90, 3)))
    b = take(movement(np.arange(110) / 50 - 0.1) + 0.02 * random.random((110, 3)))
    forth, back = align(a, b), align(b, a)
    assert forth.lag_s == pytest.approx(-back.lag_s, abs=1e-9)
    assert forth.lag_low_s == pytest.approx(-back.lag_high_s, abs=1e-9)
    assert forth.distance == pytest.approx(back.distance)
    assert forth.warp == back.warp


@pytest.mark.parametrize("tempo", [2, 3])
def test_warp_and_stretch_of_a_tempo(tempo):
    """At tempo k the path has k cells per sample of the shorter, of which one is diagonal."""
    slow = np.repeat(movement(np.arange(100) / 50) + np.arange(100)[:, None] / 100, tempo, axis=0)
    match = align(take(movement(np.arange(100) / 50) + np.arange(100)[:, None] / 100), take(slow))
    assert match.warp == pytest.approx((tempo - 1) / tempo, abs=0.01)
    assert match.stretch == pytest.approx(tempo, rel=0.25)
    assert match.hold_s == pytest.approx((tempo - 1) / 50)
    assert match.lag_high_s > 1.0


def test_identical_takes_have_neither_lag_nor_warp():
    match = align(take(), take())
    assert (match.lag_s, match.warp, match.hold_s, match.stretch, match.distance) == (0, 0, 0, 1, 0)


def test_holds_and_stretches_of_a_path_by_hand():
    path = np.array([[0, 0], [1, 1], [1, 2], [1, 3], [2, 4], [3, 5], [4, 5]])
    assert longest_hold(path) == 2
    # spans of 4 half samples (a window of 2 samples): from (0, 0) to (1, 3), the first cell 4 on; to (2, 4); ...
    assert largest_stretch(path, 10.0, 0.2) == 3.0
    assert largest_stretch(np.array([[0, 0]]), 10.0) == 1.0


def test_different_rates_and_irregular_times():
    random = np.random.default_rng(1)
    fast = take(rate_hz=100.0)
    jittered = np.arange(56) / 25 + random.uniform(-0.004, 0.004, 56)
    for other in (take(rate_hz=25.0), take(rate_hz=29.97), take(time_s=np.abs(jittered))):
        match = align(fast, other)
        assert match.rate_hz == pytest.approx(100)
        assert abs(match.lag_s) <= 0.01
        assert match.per_step < 0.004
    late = align(take(rate_hz=100.0), take(rate_hz=25.0, late_s=0.12))
    assert late.lag_s == pytest.approx(0.12, abs=0.011)


def test_clocks():
    a, b = take(), take(time_s=5 + np.arange(111) / 50, values=movement(np.arange(111) / 50))
    assert align(a, b).lag_s == pytest.approx(5)
    assert align(a, b, clock="start").lag_s == 0
    assert align(a, b, clock="start").b.time_s[0] == 0


def test_aligned_curves_and_carried_times():
    a, b = take(), take(late_s=0.2)
    match = align(a, b)
    assert match.b_on_a.shape == match.a.data.shape
    assert np.abs(match.b_on_a - match.a.data).max() < 1e-9
    assert np.abs(match.a_on_b - match.b.data).max() < 1e-9
    assert match.to_b(0.8) == pytest.approx(1.0)
    assert match.to_b([0.61, 0.9]) == pytest.approx([0.81, 1.1])
    assert match.to_b(-3.0, "first") == 0.0
    with pytest.raises(InputError, match="did you mean 'first'"):
        match.to_b(0.5, "frist")


def test_path_is_that_of_the_arrays():
    a, b = take(), take(late_s=0.1)
    path, distance = dtw_path(a.array()[1], b.array()[1], band=0.1)
    match = align(a, b)
    assert np.array_equal(match.path, path)
    assert match.distance == pytest.approx(distance)
    assert match.per_step == pytest.approx(distance / len(path))
    squared = align(a, take(2 * movement(np.arange(111) / 50)), cost="squared")
    assert squared.per_step == pytest.approx(np.sqrt(squared.distance**2 / len(squared.path)))


def test_constant_and_single_sample_takes():
    still = take(np.full((20, 3), 0.1))
    match = align(still, take(np.full((30, 3), 0.2)))
    assert match.per_step == pytest.approx(0.3)
    assert np.isfinite([match.lag_s, match.warp, match.stretch]).all()
    single = align(take(np.full((1, 3), 0.1)), take(np.full((1, 3), 0.3), time_s=[0.5]))
    assert (single.lag_s, single.warp, single.stretch, single.hold_s) == (0.5, 0, 1, 0)
    assert single.distance == pytest.approx(0.6)


def test_arrays_and_top_level_name():
    values = movement(np.arange(111) / 50)
    match = lipmetrics.align(values, values, rate_hz=50)
    assert match.distance == 0
    assert match.a.channels == ("width", "height", "area")
    assert lipmetrics.align((np.arange(111) / 50, values[:, 0]), values[:, 0], rate_hz=50).a.channels == ("0",)


def test_unknown_frames_of_a_take():
    values = movement(np.arange(111) / 50)
    values[40:42] = np.nan
    assert align(take(values), take()).per_step < 1e-3
    values[40:60] = np.nan
    with pytest.raises(InputError, match="unknown from"):
        align(take(values), take())


@pytest.mark.parametrize(
    ("a", "b", "settings", "message"),
    [
        (take(), take(unit="px"), {}, "takes of one unit, got mw, px"),
        (np.zeros(5), take(), {}, "got no times"),
        (np.zeros((5, 2)), np.zeros((5, 3)), {"rate_hz": 50}, "the same channels in both, got 2"),
        (take(), take(), {"rate_hz": 0}, "a rate above 0"),
        (take(), take(), {"rate_hz": 1e9}, "too many; pass a lower rate_hz"),
        (take(), take(), {"clock": "strat"}, "did you mean 'start'"),
        (take(), take(), {"channels": ("widht",)}, "widht"),
        ((np.arange(3), [1.0, 2.0]), take(), {}, "one time per sample"),
        (([0, 2, 1], [1.0, 2.0, 3.0]), take(), {}, "times that increase"),
        ((["x"], [1.0]), take(), {}, "times in seconds"),
        ((np.arange(2), [1.0, np.nan]), (np.arange(2), [1.0, 1.0]), {}, "curve 0: expected finite values"),
    ],
)
def test_refused(a, b, settings, message):
    with pytest.raises(InputError, match=message):
        align(a, b, **settings)


def test_mixed_units_when_asked_for():
    assert align(take(), take(unit="px"), mixed_units=True).distance == 0


def test_no_takes():
    with pytest.raises(InputError, match="at least one take"):
        even([])


def test_counts_are_held_when_resampled():
    made = take(rate_hz=10.0)
    count = np.arange(len(made.time_s)) % 3.0
    made = type(made)("made", made.time_s, made.channels | {"n_openings": count}, "mw")
    (curve,), _ = even([made], ("n_openings",), 40.0)
    assert set(np.unique(curve.data)) == {0.0, 1.0, 2.0}


def test_weighted_quantile_against_repeated_values():
    values, weights = np.array([3.0, 1.0, 2.0, 5.0]), np.array([1, 3, 2, 4])
    repeated = np.sort(np.repeat(values, weights))
    assert weighted_quantile(values, weights, 0.5) == np.median(repeated) == 2.5
    assert weighted_quantile(values, weights, 0.05) == 1.0
    assert weighted_quantile(values, weights, 0.95) == 5.0


def test_matched_mean_by_hand():
    assert matched_mean(np.array([0, 0, 1]), np.array([[1.0], [3.0], [5.0]]), 2).tolist() == [[2.0], [5.0]]


def test_channels_of_a_curve_by_name():
    curve = as_curve(take())
    assert as_curve(curve, ("area", "width")).data[:, 1].tolist() == curve.data[:, 0].tolist()
    with pytest.raises(InputError, match="did you mean 'width'"):
        as_curve(curve, ("height", "widht"))
