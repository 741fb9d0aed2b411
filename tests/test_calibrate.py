import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import calibrate

from lipmetrics.confidence import package_calibration, probability
from simulator.suite import suite


def rows(**columns) -> pd.DataFrame:
    usual = {"height_px": 10.0, "true_height_px": 10.0, "mouth_px": 100.0, "n": 1, "n_clear": 1, "n_visible": 1}
    return pd.DataFrame(usual | {"found": True} | columns, index=range(max(map(np.size, columns.values()), default=1)))


def test_what_a_good_frame_is():
    heights = [10.0, 12.0, 12.1, 8.0, 7.9, np.nan]
    assert calibrate.is_good(rows(height_px=heights)).tolist() == [True, True, False, True, False, False]
    assert calibrate.is_good(rows(height_px=[11.0, 11.1], mouth_px=40.0)).tolist() == [True, False]
    assert calibrate.is_good(rows(n=[0, 1, 2, 3], n_visible=2)).tolist() == [False, True, True, False]
    assert not calibrate.is_good(rows(found=[False])).any()


def test_area_under_the_curve_against_all_pairs():
    rng = np.random.default_rng(2)
    values, good = rng.integers(0, 6, 60).astype(float), rng.uniform(size=60) < 0.4
    pairs = [(a > b) + 0.5 * (a == b) for a in values[good] for b in values[~good]]
    assert calibrate.area_under_curve(values, good) == pytest.approx(np.mean(pairs))
    assert np.isnan(calibrate.area_under_curve(values, np.ones(60, bool)))


def test_groups_are_of_one_size_and_in_order():
    values = np.random.default_rng(1).uniform(size=103)
    of = calibrate.groups(values, 10)
    assert np.ptp(np.bincount(of)) <= 1
    assert all(values[of == k].max() <= values[of == k + 1].min() for k in range(9))


def test_calibration_error_of_what_is_right_and_of_what_is_not():
    rng = np.random.default_rng(0)
    values = rng.uniform(size=40_000)
    good = rng.uniform(size=values.size) < values
    assert calibrate.calibration_error(values, good) < 0.02
    assert calibrate.calibration_error(values**2, good) == pytest.approx(1 / 2 - 1 / 3, abs=0.01)


def test_intervals_hold_the_share_and_grow_with_fewer_clips():
    rng = np.random.default_rng(0)
    values, good = rng.uniform(size=4000), rng.uniform(size=4000) < 0.7
    many = calibrate.reliability(values, good.astype(float), np.arange(4000) // 10)
    few = calibrate.reliability(values, good.astype(float), np.arange(4000) // 1000)
    assert (many["frames"] == 400).all() and ((many["low"] <= many["good"]) & (many["good"] <= many["high"])).all()
    assert (many["high"] - many["low"]).mean() == pytest.approx(2 * 1.96 * np.sqrt(0.7 * 0.3 / 400), rel=0.2)
    one = calibrate.reliability(values, (np.arange(4000) < 1000).astype(float), np.arange(4000) // 1000)
    assert (one["high"] - one["low"]).mean() > 2 * (few["high"] - few["low"]).mean()


def test_the_fit_finds_the_weights_that_made_the_frames_and_none_below_zero():
    rng = np.random.default_rng(3)
    seen = rng.normal(size=(60_000, 4)) * (1, 2, 1, 0.5)
    true = np.array([1.0, 0.5, -0.4, 2.0])
    good = rng.uniform(size=len(seen)) < 1 / (1 + np.exp(-(seen @ true + 0.4)))
    one = calibrate.fit_logistic(seen, good, ridge=0.0)
    assert one.weights == pytest.approx((1, 0.5, 0, 2), abs=0.1) and one.bias == pytest.approx(0.4, abs=0.05)
    assert one.most == pytest.approx(tuple(seen.max(axis=0)), rel=1e-5)
    against = calibrate.fit_logistic(-seen, good)
    assert against.weights[0] == 0 and against.weights[3] == 0


def test_openings_of_a_mask():
    mask = np.zeros((60, 100), bool)
    assert calibrate.openings_of(mask, 100.0) == (0, 0, 0.0)
    mask[10:20, 5:25] = mask[40:41, 60:62] = mask[30:33, 40:50] = True
    assert calibrate.openings_of(mask, 100.0) == (2, 3, 10.0)


def test_the_clips_are_a_fifth_and_of_every_setting():
    clips = calibrate.thinned("tune")
    assert len(clips) < len(suite("tune")) / 4
    assert {clip.condition for clip in suite("tune", quick=True)} <= {clip.condition for clip in clips}
    assert len({clip.take.action for clip in clips if clip.axis == "noise"}) > 1
    worst = {clip.name for clip in calibrate.with_plain_of_worst("report")}
    assert {clip.name for clip in calibrate.thinned("report")} <= worst


def test_falls_at_the_worst_settings_are_told_of_the_same_movements():
    table = pd.DataFrame(
        {
            "clip": ["plain.a", "plain.b", "noise_1.5.a", "beard_full.a"],
            "condition": ["plain", "plain", "noise: 12 %", "beard: full"],
            "good": [1.0, 0.0, 0.5, 1.0],
            "now": [0.9, 0.1, 0.6, 0.95],
            "before": 0.5,
        }
    )
    found = calibrate.by_worst(table)
    assert found.loc["noise: 12 %", "confidence, plain"] == 0.9 and found.loc["noise: 12 %", "falls"] == "yes"
    assert found.loc["beard: full", "falls"] == "no, as little goes wrong"


@pytest.mark.slow
def test_confidence_is_calibrated_on_simulated_clips(tmp_path):
    clips = suite("report", only=["plain", "noise: 12 %", "blur: 5 px", "mouth width: 40 px"])[::4]
    frames = calibrate.clip_rows(clips, tmp_path)
    now = probability(calibrate.evidence_of(frames), package_calibration())
    assert abs(now.mean() - frames["good"].mean()) < 0.12
    assert calibrate.area_under_curve(now, frames["good"].to_numpy(bool)) > 0.65
    blurred = frames["condition"] == "blur: 5 px"
    assert now[blurred].mean() < now[frames["condition"] == "plain"].mean()
