import math

import numpy as np
import pandas as pd
import pytest
from mouth_clip import profile_of

from lipmetrics.look import CLOSED, NO_MOUTH, OPEN, Look
from lipmetrics.validation import (
    BEFORE,
    by_condition,
    figures,
    intervals,
    jitter,
    merges,
    onsets,
    score_frames,
    with_errors,
)

FPS, MOUTH_PX = 25, 100.0
CORNERS = np.array([[50.0, 10.0], [50.0, 110.0]])


def box(height: float, width: float = 40.0, row: float = 40.0, col: float = 30.0) -> np.ndarray:
    return np.array([(row, col), (row, col + width), (row + height, col + width), (row + height, col)], float)


def clip(*frames: list[np.ndarray] | None, corners: np.ndarray = CORNERS, confidence: float = 0.9):
    """A profile of frames with these outlines; None is a frame in which no mouth was found."""
    looks = [
        Look(NO_MOUTH) if boxes is None else Look(OPEN if boxes else CLOSED, boxes, corners, confidence)
        for boxes in frames
    ]
    profile = profile_of(looks, [i / FPS for i in range(len(frames))], MOUTH_PX)
    profile.meta["corners_px"] = CORNERS.tolist()
    return profile


def rows(kinds: str, seen: str, *, height=None, true=None, name: str = "a", **columns) -> pd.DataFrame:
    """A clip's frames from letters: o(pen), h(ardly), c(losed); measured o, c or n(o mouth)."""
    count = len(kinds)
    kind = [{"o": "open", "h": "hardly", "c": "closed"}[k] for k in kinds]
    status = [{"o": OPEN, "c": CLOSED, "n": NO_MOUTH}[k] for k in seen]
    true = np.array([10.0 if k == "o" else 1.0 if k == "h" else 0.0 for k in kinds] if true is None else true)
    height = np.array([10.0 if k == "o" else 0.0 for k in seen] if height is None else height, float)
    is_open, is_seen = np.array([k == "o" for k in kinds]), np.array([k == "o" for k in seen])
    table = {
        "clip": name,
        "frame": np.arange(count),
        "time_s": np.arange(count) / FPS,
        "kind": kind,
        "status": status,
        "n": np.where(np.array(list(seen)) == "n", np.nan, is_seen),
        "n_visible": (np.array(list(kinds)) != "c").astype(int),
        "n_clear": is_open.astype(int),
        "true_height_px": true,
        "height_px": height,
        "iou": np.where(is_open, np.where(is_seen, 0.9, 0.0), np.nan),
        "merge": False,
        "true_merge": False,
        "found": np.array(list(seen)) != "n",
        "confidence": 0.8,
        "mouth_px": MOUTH_PX,
    }
    for size in ("width", "area"):
        table |= {f"true_{size}_px": 40.0 * true, f"{size}_px": 40.0 * height}
    return pd.DataFrame(table | columns)


# -- frames -----------------------------------------------------------------------------------------------------------


def test_kinds_of_frames_and_what_is_counted_in_them():
    true = clip([box(10)], [box(1.5)], [], [box(10), box(1.5, 9, col=90)], [box(10), box(5, 9, col=90)])
    table = score_frames(true, true)
    assert table["kind"].tolist() == ["open", "hardly", "closed", "open", "open"]
    assert table["n_visible"].tolist() == [1, 1, 0, 2, 2] and table["n_clear"].tolist() == [1, 0, 0, 1, 2]
    assert table["iou"].tolist()[:1] == [1.0] and np.isnan(table["iou"][1:3]).all()
    assert with_errors(table)["count_right"].all()
    one = score_frames(clip([box(10)], [], [], [box(10)], [box(10)]), true)
    assert with_errors(one)["count_right"].tolist() == [True, True, True, True, False]
    assert with_errors(one)["count_equal"].tolist() == [True, True, True, True, False]


def test_a_small_mouth_is_open_from_one_pixel_on():
    true = clip([box(0.9)], [box(1.1)])
    true.meta["mouth_width_px"] = 40.0  # of which 2 % are less than a pixel
    assert score_frames(true, true)["kind"].tolist() == ["hardly", "open"]


def test_what_is_missed_has_no_overlap_and_no_error():
    true = clip([box(10)], [box(10)], [box(10)], [])
    table = with_errors(score_frames(clip([box(8)], [], None, [box(3)]), true))
    assert table["iou"].tolist()[:3] == [pytest.approx(0.8, abs=0.01), 0.0, 0.0]  # to a quarter of a pixel
    assert table["missed"].tolist() == [False, True, True, False]
    assert table["false"].tolist() == [False, False, False, True]
    assert table["bad"].tolist() == [False, True, True, True]
    assert table["height_off_px"].tolist()[0] == -2 and table["height_off_percent"].tolist()[0] == -2
    assert table["area_off_percent"].tolist()[0] == pytest.approx(-100 * 80 / 100**2)
    assert table["height_off_px"].isna().tolist() == [False, True, True, True]


def test_a_mouth_is_found_where_it_is():
    true = clip(*[[box(10)]] * 4)
    assert score_frames(clip(*[[box(10)]] * 4), true)["found"].all()
    aside, below = CORNERS + np.array([0, 31]), CORNERS + np.array([31, 0])
    wider, narrower = (60 + (CORNERS - 60) * np.array([1, factor]) for factor in (1.6, 0.6))
    for wrong in (aside, below, wider, narrower):
        assert not score_frames(clip(*[[box(10)]] * 4, corners=wrong), true)["found"].any()
    true.meta["drift_px"] = [[0, 0], [0, 31], [31, 0], [0, -31]]
    assert score_frames(clip(*[[box(10)]] * 4), true)["found"].tolist() == [True, False, False, False]
    assert score_frames(clip(*[[box(10)]] * 4, corners=aside), true)["found"].tolist()[1]


def test_only_merges_of_clear_openings_count():
    true = clip([box(10, 9), box(5, 9, col=90)], [box(10, 70)], [box(10, 9), box(1, 9, col=90)], [box(10, 70)])
    true.openings.loc[true.openings["frame"].isin([1, 3]), "event"] = "merge"
    seen = clip(*[[box(10)]] * 4)
    seen.openings.loc[seen.openings["frame"] == 2, "event"] = "merge"
    table = score_frames(seen, true)
    assert table["true_merge"].tolist() == [False, True, False, False]
    assert table["merge"].tolist() == [False, False, True, False]


# -- what follows from them -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "kinds, seen, late",
    [
        ("cccchhoooo", "ccccccoooo", [(0, 2)]),  # at the first clear frame
        ("cccchhoooo", "ccccoooooo", [(0, 0)]),  # at the first sliver
        ("cccchhoooo", "ccccccccoo", [(2, 4)]),
        ("cccchhoooo", "ccoooooooo", [(-2, -2)]),
        ("cccchhoooo", "cccccccccc", [(math.nan, math.nan)]),
        ("cccchhcccc", "ccccoocccc", []),  # never clear
        ("oooccccooo", "cccccccooo", [(0, 0)]),  # open from the beginning is no onset
        ("ccoooccooo", "cccoocccoo", [(1, 1), (1, 1)]),
        ("ccoooccooo", "ccooooooco", [(0, 0), (-2, -2)]),  # open ever since: as early as the spell before allows
        (20 * "c" + "oo", 22 * "o", [(-BEFORE, -BEFORE)]),
    ],
)
def test_onsets(kinds, seen, late):
    assert np.array_equal(np.array(onsets(rows(kinds, seen))).ravel(), np.array(late).ravel(), equal_nan=True)


def test_merges_are_looked_for_near_the_true_ones():
    true = np.isin(np.arange(40), [5, 30])
    table = rows(40 * "o", 40 * "o", true_merge=true, merge=np.isin(np.arange(40), [7, 1]))
    assert np.array_equal(merges(table), [2, math.nan], equal_nan=True)


def test_jitter_is_what_does_not_move_in_truth():
    true, seen = [0, 0, 0, 10, 10, 10.1, 15], [0, 2, 0, 10, 11, 11.1, 20]
    closed, still = jitter(rows("cccoooo", "cocoooo", true=true, height=seen))
    assert closed.tolist() == [2, 2] and still == pytest.approx([1, 0], abs=1e-9)


def test_figures_of_some_clips():
    a = rows("ccccoooo", "cccoccoo", height=[0, 0, 0, 4, 0, 0, 12, 9])
    b = rows("cchhoooo", "ccchoooo".replace("h", "o"), name="b", height=[0, 0, 0, 3, 10, 10, 11, 10])
    found = figures(pd.concat([a, b], ignore_index=True))
    assert (found["clips"], found["frames"], found["frames_open"], found["frames_closed"]) == (2, 16, 8, 6)
    assert found["missed_percent"] == 25 and found["missed_highest_percent"] == 10
    assert found["false_percent"] == pytest.approx(100 / 6) and found["false_highest_percent"] == 4
    assert (found["hardly_frames"], found["hardly_seen_percent"]) == (2, 50)
    assert found["height_px_median"] == 0.5 and found["height_px_bias"] == pytest.approx((2 - 1 + 1) / 6)
    assert found["height_percent_median"] == 0.5 and found["width_px_median"] == 20
    assert (found["onsets"], found["onset_frames_median"], found["onset_seen_percent"]) == (2, 0.5, 100)
    assert found["iou_median"] == 0.9 and found["iou_10th"] == 0
    assert found["count_right_percent"] == pytest.approx(100 * 13 / 16)
    assert found["bad_percent"] == pytest.approx(100 * 3 / 16)


def test_what_cannot_be_told_is_nan():
    found = figures(rows("cccc", "cccc"))
    assert math.isnan(found["iou_median"]) and math.isnan(found["missed_percent"]) and found["false_percent"] == 0
    assert math.isnan(intervals(rows("cccc", "cccc"))["iou_median"][0])


def test_an_interval_holds_the_median_and_is_wider_with_fewer_clips():
    rng = np.random.default_rng(0)
    many = [rows("oooo", "oooo", name=f"{k}", iou=rng.normal(0.8, 0.05)) for k in range(40)]
    low, high = intervals(pd.concat(many))["iou_median"]
    assert low < 0.8 < high and high - low < 0.05
    few = intervals(pd.concat(many[:5]))["iou_median"]
    assert few[1] - few[0] > high - low
    assert intervals(pd.concat(many)) == intervals(pd.concat(many))


def test_conditions_are_set_beside_the_same_movements_filmed_plainly():
    one, other = rows("oo", "oo", name="p1"), rows("oo", "oo", name="p2", iou=0.5)
    noisy, alone = rows("oo", "oc", name="n1"), rows("oo", "oo", name="x")
    clips = pd.DataFrame(
        [
            ("p1", "plain", "plain", "plain", "walk"),
            ("p2", "plain", "plain", "plain", "run"),
            ("n1", "noise", "3 %", "noise: 3 %", "walk"),
            ("x", "face", "x", "face: x", "fly"),
        ],
        columns=["clip", "axis", "setting", "condition", "take"],
    )
    table = by_condition(pd.concat([noisy, one, other, alone]), clips).set_index("condition")
    assert list(table.index) == ["plain", "noise: 3 %", "face: x"]
    assert table["iou_median"].tolist() == [pytest.approx(0.7), 0.45, 0.9]
    assert table.loc["noise: 3 %", "plain_iou_median"] == 0.9 and math.isnan(table.loc["face: x", "plain_iou_median"])
    assert table.loc["plain", "plain_iou_median"] == pytest.approx(0.7)
    assert table.loc["noise: 3 %", "bad_percent"] == 50 and table.loc["noise: 3 %", "plain_bad_percent"] == 0
