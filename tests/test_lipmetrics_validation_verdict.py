import math

import numpy as np
import pandas as pd
import pytest
from test_lipmetrics_validation import MOUTH_PX, box, clip, rows

from lipmetrics.validation import by_condition, score_frames
from lipmetrics.validation_verdict import (
    CARE_NAME,
    REFUSED_NAME,
    TRUSTED_NAME,
    by_class,
    calibration,
    disagreement_mw2,
    rule,
    targets,
    verdict,
    worst_frames,
)

GOOD = {
    "iou_median": 0.95,
    "height_percent_median": 0.5,
    "missed_percent": 0.0,
    "false_percent": 0.0,
    "count_right_percent": 100.0,
    "found_percent": 100.0,
}


@pytest.mark.parametrize(
    "name, care, refused",
    [
        ("iou_median", 0.84, 0.69),
        ("height_percent_median", 1.6, 4.1),
        ("missed_percent", 5.1, 21),
        ("false_percent", 2.1, 11),
        ("count_right_percent", 94, 79),
        ("found_percent", 97, 89),
    ],
)
def test_the_rule_of_trust(name, care, refused):
    assert verdict(GOOD) == TRUSTED_NAME
    assert verdict(GOOD | {name: care}) == CARE_NAME
    assert verdict(GOOD | {name: refused}) == REFUSED_NAME
    assert verdict(GOOD | {name: math.nan}) == TRUSTED_NAME


def test_the_rule_is_said_with_its_numbers():
    first, second, _ = rule()
    assert "median IoU at least 0.85," in first and "mouths found at least 98 %" in first
    assert "median height error at most 4 %" in second


def clips_of(*facts) -> pd.DataFrame:
    columns = ["clip", "axis", "setting", "condition", "take"]
    return pd.DataFrame([(name, a, s, f"{a}: {s}", take) for name, a, s, take in facts], columns=columns)


def test_goals_that_are_met_and_that_are_not():
    iou = {"light": 0.97, "dark": 0.93}
    frames = pd.concat(
        [
            *(rows("ccoooo", "ccoooo", name=name, iou=value) for name, value in iou.items()),
            rows("ccoooo", "ococoo", name="mixed", iou=0.7, mouth_px=79.0),
        ]
    )
    clips = clips_of(
        ("light", "skin tone", "light", "walk"),
        ("dark", "skin tone", "dark", "walk"),
        ("mixed", "mix", "mix", "run"),
    )
    found = {row["what"]: row for row in targets(frames, clips, by_condition(frames, clips), failed=1)}
    by_word = {
        word: next(row for what, row in found.items() if word in what) for word in ("median", "10th", "width er")
    }
    assert by_word["median"]["all"] == "0.950"
    assert by_word["10th"]["met"] and by_word["10th"]["mix"] == "-"  # its mouth is too small to count
    assert by_word["width er"]["all"] == "0.00 px, 0.00 %" and by_word["width er"]["met"]
    false = found["false openings on closed mouths"]
    assert not false["met"] and false["all"] == "16.67 %" and false["mix"] == "50.00 %"
    tone = found["skin tone: median IoU, best less worst"]
    assert tone["all"] == "0.040 (dark 0.930, light 0.970)" and not tone["met"]
    assert (
        found["clips that the method breaks on"]["all"] == "1" and not found["clips that the method breaks on"]["met"]
    )


def test_tones_are_not_compared_by_different_movements():
    frames = pd.concat([rows("oo", "oo", name="light"), rows("oo", "oo", name="dark")])
    clips = clips_of(("light", "skin tone", "light", "walk"), ("dark", "skin tone", "dark", "run"))
    assert not any("skin tone" in row["what"] for row in targets(frames, clips, by_condition(frames, clips)))


def test_nonsense_is_silent_where_confidence_does_not_fall():
    plain = rows("oooo", "oooo", name="p", confidence=0.8)
    frames = pd.concat(
        [
            plain,
            rows("oooo", "occo", name="dim", confidence=0.5),
            rows("oooo", "occo", name="loud", confidence=0.8),
            rows("oooo", "oooo", name="fine", confidence=0.9),
        ]
    )
    facts = [(name, "noise", name, "walk") for name in ("dim", "loud", "fine")]
    clips = clips_of(("p", "plain", "plain", "walk"), *facts)
    row = targets(frames, clips, by_condition(frames, clips))[-1]
    assert row["all"] == "1 of 2; not in noise: loud" and row["met"] is False
    fine = clips[clips["clip"].isin(["p", "fine"])]
    row = targets(frames, fine, by_condition(frames, fine))[-1]
    assert row["all"] == "0 of 0" and row["met"] is None


def test_classes_of_frames():
    frames = rows("oooo", "oooc", mouth_px=[40.0, 59.9, 60.0, 90.0])
    table = by_class(frames, frames["mouth_px"], (0, 60, 80, math.inf), "width")
    assert table["width"].tolist() == ["0 to 60", "60 to 80", "80 or more"]
    assert table["frames"].tolist() == [2, 1, 1] and table["missed_percent"].tolist() == [0, 0, 100]


def test_what_confidence_is_worth():
    frames = rows("oooo", "occo", confidence=[1.0, 0.2, 0.2, 0.2])
    table = calibration(frames)
    assert table["frames"].tolist() == [3, 1] and table["bad_percent"].tolist() == [pytest.approx(200 / 3), 0]
    assert table["confidence"].tolist() == ["0 to 0.3", "0.95 to 1"]


def test_disagreement_is_the_area_of_one_but_not_both():
    true = clip([box(10)], [box(10)], [], [box(1.5)])
    seen = clip([box(8, row=42)], [], [box(5)], [box(30)])
    apart = disagreement_mw2(score_frames(seen, true)) * MOUTH_PX**2
    assert apart == pytest.approx([2 * 40, 10 * 40, 5 * 40, 0], rel=0.04)  # to a quarter of a pixel


def test_the_worst_frames_are_of_different_clips_conditions_and_movements():
    frames = pd.concat(
        [
            rows("oo", "oo", name=f"{k}", iou=[0.9, 0.1 + k / 100], total_area_px=10.0, true_total_area_px=10.0)
            for k in range(9)
        ]
    )
    settings = ["x", "x", "x", "a", "b", "c", "d", "e", "f"]
    takes = ["1", "2", "3", "1", "1", "1", "4", "5", "6"]
    facts = [(f"{k}", "noise", settings[k], takes[k]) for k in range(9)]
    worst = worst_frames(frames, clips_of(*facts), count=5)
    assert worst["clip"].tolist() == ["0", "1", "3", "4", "6"]
    assert worst["frame"].tolist() == [1] * 5 and np.all(np.diff(worst["apart"]) <= 0)
