import math

import numpy as np
import pytest
from scipy.spatial.distance import directed_hausdorff

from lipmetrics.errors import InputError
from lipmetrics.metrics import METRICS, curves
from lipmetrics.take import Take


def opening(time_s, start_s=0.3, size=1.0, name="made", unit="mw"):
    """Opens and closes within 0.6 s from `start_s` on."""
    height = 0.3 * size * np.sin(np.pi * np.clip((time_s - start_s) / 0.6, 0, 1)) ** 2
    return Take(name, time_s, {"width": 0.5 + height, "height": height, "area": height * 0.6}, unit)


TIME_S = np.arange(61) / 50
REAL = opening(TIME_S)


def test_a_take_against_itself():
    scores = curves.evaluate(REAL, REAL)
    assert list(scores) == [row.name for row in METRICS.values() if row.family == "curves"]
    ones = ("correlation", "stretch", "peak_ratio", "speed_ratio")
    for name, value in scores.items():
        assert value == pytest.approx(1 if name.startswith(ones) else 0, abs=1e-12), name


def test_a_late_model_is_late_and_not_warped_away():
    late = opening(TIME_S, start_s=0.4)
    scores = curves.evaluate(REAL, late)
    assert scores["lag_v1"] == pytest.approx(0.1, abs=0.011) and scores["lateness_v1"] == scores["lag_v1"]
    assert scores["onset_difference_v1"] == pytest.approx(0.1, abs=0.005)
    assert scores["l2_aligned_height_v1"] < 0.1 * scores["l2_height_v1"]
    back = curves.evaluate(late, REAL)
    assert back["lag_v1"] == pytest.approx(-scores["lag_v1"]) and back["lateness_v1"] == scores["lateness_v1"]
    assert scores["warp_v1"] > 0 and scores["hold_v1"] > 0


def test_differences_at_equal_times_by_hand():
    time_s = np.array([0.0, 0.1, 0.2])
    real = Take("real", time_s, {"width": [1, 1, 1], "height": [0, 1, 0], "area": [0, 1, 0]})
    made = Take("made", time_s, {"width": [1, 1, 4], "height": [0, 3, 1], "area": [0, -1 + 1, 0]})
    assert curves.l2(real, made, "height") == pytest.approx(math.sqrt((0 + 4 + 1) / 3))
    assert curves.l2(real, made, "width") == pytest.approx(math.sqrt(9 / 3))
    assert curves.mod_v1(real, made) == pytest.approx(1)
    assert curves.peak_ratio_v1(real, made) == pytest.approx(3)
    # heights about their means: (-1, 2, -1) / 3 and (-4, 5, -1) / 3
    assert curves.correlation(real, made, "height") == pytest.approx(15 / math.sqrt(6 * 42))
    assert math.isnan(curves.correlation(real, made, "width"))


def test_along_the_path_by_hand():
    """A model that is higher by 0.2 all the time has the diagonal as its path, as width and area match there."""
    made = Take("made", TIME_S, REAL.channels | {"height": REAL.channels["height"] + 0.2})
    pair = curves.validate(REAL, made)
    assert (np.diff(pair.alignment.path, axis=0) == 1).all()
    assert curves.dtw(pair, channel="height") == pytest.approx(0.2)
    assert curves.l2_aligned(pair, channel="height") == pytest.approx(0.2)
    assert curves.hausdorff(pair, channel="width") == pytest.approx(0)
    assert 0.1 < curves.hausdorff(pair, channel="height") <= 0.2


def test_the_channels_of_dtw_add_up_to_the_cost_of_the_path():
    pair = curves.validate(REAL, opening(TIME_S, 0.35, 0.8))
    total = sum(curves.dtw(pair, channel=channel) for channel in curves.CHANNELS)
    assert total == pytest.approx(pair.alignment.per_step)


def test_hausdorff_is_that_of_scipy():
    pair = curves.validate(REAL, opening(TIME_S, 0.35, 0.8))
    match = pair.alignment
    time_s = match.times_s.mean(axis=1)
    points = [
        np.stack([time_s, side.data[at, 1]], axis=1) for side, at in zip((match.a, match.b), match.path.T, strict=True)
    ]
    expected = max(directed_hausdorff(*points)[0], directed_hausdorff(*points[::-1])[0])
    assert curves.hausdorff(pair, channel="height") == pytest.approx(expected)


def test_other_rates_and_lengths():
    """The same movement filmed 24 times per second and cut later: nearly no difference."""
    other = opening(np.arange(36) / 24)
    scores = curves.evaluate(REAL, other)
    assert scores["l2_height_v1"] < 0.01 and scores["correlation_height_v1"] > 0.999
    assert abs(scores["lag_v1"]) < 0.02 and scores["speed_ratio_v1"] == pytest.approx(1, rel=0.1)


def test_equal_times_are_times_of_the_clock():
    """A model whose recording begins 0.1 s later on the same clock."""
    later = opening(TIME_S[5:])
    assert curves.l2(REAL, later) == pytest.approx(0, abs=1e-12) and curves.mod_v1(later, REAL) < 1e-12


def test_what_does_not_change_has_no_correlation():
    """The mean of equal numbers differs from them by rounding."""
    still = Take("still", TIME_S, REAL.channels | {"width": np.full(61, 0.1)})
    assert np.full(61, 0.1).mean() != 0.1
    assert math.isnan(curves.correlation(REAL, still, "width"))


def test_a_smaller_model():
    scores = curves.evaluate(REAL, opening(TIME_S, size=0.5))
    assert scores["peak_ratio_v1"] == pytest.approx(0.5) and scores["speed_ratio_v1"] == pytest.approx(0.5)
    assert scores["correlation_height_v1"] == pytest.approx(1)


def test_shut_mouths():
    shut = Take("shut", TIME_S, dict.fromkeys(("width", "height", "area"), np.zeros(61)))
    scores = curves.evaluate(shut, REAL)
    for name in ("peak_ratio_v1", "speed_ratio_v1", "onset_difference_v1", "correlation_height_v1"):
        assert math.isnan(scores[name]), name
    assert scores["mod_v1"] == pytest.approx(REAL.channels["height"].mean())
    assert curves.evaluate(REAL, shut)["peak_ratio_v1"] == 0


def test_a_pair_is_aligned_once():
    pair = curves.validate(REAL, opening(TIME_S, 0.35), band=0.1)
    assert curves.validate(pair) is pair
    assert curves.evaluate(pair) == curves.evaluate(REAL, opening(TIME_S, 0.35), band=0.1)


def test_bad_input_is_named():
    with pytest.raises(InputError, match="expected a take, got NoneType"):
        curves.evaluate(REAL)
    with pytest.raises(InputError, match="px"):
        curves.evaluate(REAL, opening(TIME_S, unit="px"))
    assert curves.evaluate(REAL, opening(TIME_S, unit="px"), mixed_units=True)["mod_v1"] == 0
    with pytest.raises(InputError, match="width, height, area, got 'ratio'"):
        curves.l2(REAL, REAL, "ratio")
    with pytest.raises(InputError, match="moment in common"):
        curves.evaluate(REAL, opening(TIME_S + 10))
