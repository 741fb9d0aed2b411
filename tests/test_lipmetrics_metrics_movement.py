import math

import numpy as np
import pytest

from lipmetrics.errors import InputError
from lipmetrics.metrics import METRICS, movement
from lipmetrics.take import Take


def take_of(time_s, height, width=None, area=None):
    height = np.asarray(height, float)
    width = height if width is None else width
    return Take("made", time_s, {"width": width, "height": height, "area": height if area is None else area})


def triangle(time_s):
    """Closed to 0.4 s, height 1 at 0.8 s, closed again from 1.0 s on."""
    return np.interp(time_s, [0.4, 0.8, 1.0], [0, 1, 0])


EVERY_10_MS = np.arange(121) / 100
TRIANGLE = take_of(EVERY_10_MS, triangle(EVERY_10_MS))


def test_a_triangle_by_hand():
    scores = movement.evaluate(TRIANGLE)
    assert scores["peak_height_v1"] == pytest.approx(1)
    assert scores["onset_time_v1"] == pytest.approx(0.44)  # a tenth of the height, on a slope of 2.5
    assert scores["closing_time_v1"] == pytest.approx(0.98)
    assert scores["open_duration_v1"] == pytest.approx(0.54)
    assert scores["time_to_peak_v1"] == pytest.approx(0.36)
    assert scores["opening_speed_v1"] == pytest.approx(2.5)
    assert scores["closing_speed_v1"] == pytest.approx(5)
    # the smoothed slope changes sign between 0.82 and 0.83 s, where the height is 0.9; likewise on the way down
    assert scores["opening_stiffness_v1"] == pytest.approx(2.5, rel=0.2)
    assert scores["closing_stiffness_v1"] == pytest.approx(5, rel=0.2)
    assert scores["open_share_v1"] == pytest.approx(59 / 120)  # frames 0.41 to 0.99 s, of 1.2 s


def test_peaks_of_each_channel():
    take = take_of([0, 1, 2], [0, 3, 1], width=[0, 2, 5], area=[0, 7, 6])
    assert (movement.peak_height_v1(take), movement.peak_width_v1(take), movement.peak_area_v1(take)) == (3, 5, 7)


@pytest.mark.parametrize("rate_hz", [25, 60, 250])
def test_speed_hardly_depends_on_the_frame_rate(rate_hz):
    """Half a cosine from 0 to 0.4 in 0.3 s: its greatest slope is pi / 2 * 0.4 / 0.3."""
    time_s = np.arange(int(0.8 * rate_hz) + 1) / rate_hz
    height = 0.2 * (1 - np.cos(np.pi * np.clip((time_s - 0.2) / 0.3, 0, 1)))
    assert movement.opening_speed_v1(take_of(time_s, height)) == pytest.approx(np.pi / 2 * 0.4 / 0.3, rel=0.04)


def test_starting_time_and_direction_do_not_matter():
    later = take_of(EVERY_10_MS + 77, triangle(EVERY_10_MS))
    assert movement.evaluate(later) == pytest.approx(movement.evaluate(TRIANGLE), abs=1e-9)
    backward = take_of(EVERY_10_MS, triangle(EVERY_10_MS)[::-1])
    assert movement.opening_speed_v1(backward) == pytest.approx(movement.closing_speed_v1(TRIANGLE))
    assert movement.opening_stiffness_v1(backward) == pytest.approx(movement.closing_stiffness_v1(TRIANGLE))


def test_slopes_are_straight_lines_of_least_squares_at_real_times():
    rng = np.random.default_rng(3)
    time_s = np.cumsum(rng.uniform(0.004, 0.014, 60))
    values = rng.normal(size=60)
    values[[20, 41]] = np.nan
    found = movement.slopes(time_s, values, 0.08)
    for k in range(60):
        if k in (0, 59) or np.isnan(values[k - 1 : k + 2]).any():
            assert np.isnan(found[k])
            continue
        start, stop = (0, 20) if k < 20 else (21, 41) if k < 41 else (42, 60)  # known frames around it
        before = sum(time_s[k] - time_s[start:k] <= 0.04)
        after = sum(time_s[k + 1 : stop] - time_s[k] <= 0.04)
        n = max(1, min(before, after))
        expected = np.polyfit(time_s[k - n : k + n + 1], values[k - n : k + n + 1], 1)[0]
        assert found[k] == pytest.approx(expected, rel=1e-9), k


def test_stiffness_is_of_the_stroke_of_the_peak_velocity():
    """A fast small opening from 0.2 to 0.5 at 3 per s, then a slow large one from 0.5 to 1 at 1 per s."""
    height = np.interp(EVERY_10_MS, [0.1, 0.2, 0.3, 0.4, 0.9], [0.2, 0.5, 0.5, 0.4, 1])
    take = take_of(EVERY_10_MS, height)
    assert movement.opening_speed_v1(take) == pytest.approx(3)
    assert movement.opening_stiffness_v1(take) == pytest.approx(3 / 0.3, rel=0.02)


def test_a_tremor_is_no_stroke():
    height = np.minimum(EVERY_10_MS, 0.5)
    height[100:103] -= [0.001, 0.002, 0.001]
    take = take_of(EVERY_10_MS, height)
    assert 0 < movement.closing_speed_v1(take) < 0.1
    assert math.isnan(movement.closing_stiffness_v1(take))


def test_nothing_is_computed_across_unknown_frames():
    height = triangle(EVERY_10_MS)
    height[50:75] = np.nan
    take = take_of(EVERY_10_MS, height)
    assert movement.opening_speed_v1(take) == pytest.approx(2.5)
    jump = take_of(np.arange(6) / 10, [0, 0, np.nan, 1, 1, 1])
    assert movement.opening_speed_v1(jump) == 0
    assert math.isnan(movement.opening_speed_v1(take_of([0, 0.1, 0.2], [0, np.nan, 1])))
    assert movement.open_share_v1(jump) == pytest.approx(0.25 / 0.4)


def test_a_mouth_that_never_opens():
    shut = movement.evaluate(take_of(np.arange(5) / 25, np.zeros(5)))
    assert shut["peak_height_v1"] == shut["open_share_v1"] == shut["opening_speed_v1"] == 0
    for name in ("onset_time_v1", "closing_time_v1", "open_duration_v1", "time_to_peak_v1", "opening_stiffness_v1"):
        assert math.isnan(shut[name]), name
    one = movement.evaluate(take_of([3.0], [0.5]))
    assert one["open_share_v1"] == 1 and math.isnan(one["opening_speed_v1"])


def test_a_mouth_that_is_open_at_the_ends_has_no_onset():
    take = take_of([0, 1, 2], [0.5, 0, 0.4])
    assert math.isnan(movement.onset_time_v1(take)) and math.isnan(movement.closing_time_v1(take))


def test_silence_by_hand():
    """Heights 1, 2, 3, 10 in two silences, mean 4, deviations 3, 2, 1, 6, median 2.5; frames between do not count."""
    take = take_of(np.arange(8) / 10, [1, 2, 50, 60, 3, 10, np.nan, 9])
    silence = [(0.0, 0.1), (0.4, 0.6)]
    assert movement.silence_mad_v1(take, silence) == pytest.approx(2.5)
    assert movement.silence_height_v1(take, silence) == pytest.approx(4)
    assert movement.silence_travel_v1(take, silence) == pytest.approx((1 + 7) / 0.2)
    assert set(movement.evaluate(take, silence=silence)) == {
        row.name for row in METRICS.values() if row.family == "movement"
    }
    assert "silence_mad_v1" not in movement.evaluate(take)
    nothing = [(5.0, 6.0)]
    for function in (movement.silence_mad_v1, movement.silence_height_v1, movement.silence_travel_v1):
        assert math.isnan(function(take, nothing))
    with pytest.raises(InputError, match="start before end"):
        movement.silence_mad_v1(take, [(0.3, 0.1)])
    with pytest.raises(InputError, match="pairs in s"):
        movement.silence_mad_v1(take, (0.1, 0.3))


def test_bad_input_is_named():
    with pytest.raises(InputError, match="expected a take, got ndarray"):
        movement.peak_height_v1(np.zeros(3))
    with pytest.raises(InputError, match="made: expected a known height"):
        movement.evaluate(take_of([0, 1], [np.nan, np.nan]))
    with pytest.raises(InputError, match="'lips', it has width"):
        movement.validate(TRIANGLE, "lips")
    with pytest.raises(InputError, match="window above 0 s, got 0"):
        movement.Settings(window_s=0)
    with pytest.raises(InputError, match="between 0 and 1 for the onset"):
        movement.Settings(onset_share=1)
