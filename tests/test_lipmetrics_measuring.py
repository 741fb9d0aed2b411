import pytest
from moving_takes import moving_take

from lipmetrics.compare import align
from lipmetrics.errors import InputError
from lipmetrics.measuring import AT_BAND, GROUPS, HEADLINES, LEFT_OUT, ZERO, all_measures, formula_of, title_of, unit_of
from lipmetrics.metrics import METRICS, curves


def test_every_metric_that_takes_allow_is_used_once():
    names = [measure.name for measure in all_measures().measures]
    possible = {row.name for row in METRICS.values() if row.needs in ("take pair", "take", "openings")}
    assert sorted(names) == sorted(possible - set(LEFT_OUT))
    assert set(HEADLINES) <= set(names)
    assert set(LEFT_OUT) <= set(METRICS)


def test_every_metric_has_a_group_and_a_formula():
    for measure in all_measures().measures:
        assert measure.family in GROUPS
        assert formula_of(measure.name)


def test_channels_choose_metrics_of_curves_only():
    names = {measure.name for measure in all_measures(channels=("height",)).measures}
    assert {"l2_height_v1", "lag_v1", "mod_v1", "peak_width_v1"} <= names
    assert not {"l2_width_v1", "dtw_area_v1"} & names
    with pytest.raises(InputError, match="width, height, area, got 'depth'"):
        all_measures(channels=("depth",))


def test_values_are_those_of_the_families():
    a, b = moving_take(high=0.3), moving_take(high=0.4, late_s=0.08)
    measuring = all_measures()
    assert measuring.pair(a, b) == curves.evaluate(a, b) | {AT_BAND: align(a, b).at_band}
    assert measuring.take(a)["peak_height_v1"] == pytest.approx(0.3)
    assert "merges_v1" not in measuring.take(a)  # no openings are known
    assert {m.name for m in measuring.measures if m.better == ZERO} == {"lag_v1", "onset_difference_v1"}


def test_a_rate_resamples_curves():
    a, b = moving_take(), moving_take(rate_hz=100, late_s=0.03)
    slow, fast = (all_measures(rate_hz=rate).pair(a, b)["hold_v1"] for rate in (10, 100))
    assert slow == pytest.approx(round(slow * 10) / 10)  # whole samples
    assert 0 < fast < 0.1


def test_names_and_units_in_words():
    by_name = {measure.name: measure for measure in all_measures().measures}
    assert title_of(by_name["l2_aligned_height_v1"]) == "L2 aligned height"
    assert title_of(by_name["peak_height_v1"]) == "peak height difference"
    assert [
        unit_of(by_name[n], "px") for n in ("l2_area_v1", "warp_v1", "opening_stiffness_v1", "opening_speed_v1")
    ] == [*("px²", "", "per s", "px/s")]
