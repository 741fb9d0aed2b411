import json
import math

import numpy as np
import pytest
from mouth_clip import MOUTH_WIDTH_PX, ellipse, profile_of
from moved_mouth import moved_mouth

from lipmetrics.accuracy import compare, describe, load_truth, overlap, pair_frames
from lipmetrics.errors import InputError
from lipmetrics.look import CLOSED, NO_MOUTH, OPEN, Look
from lipmetrics.outline import fill_outlines
from simulator.camera import Camera
from simulator.truth import truth as simulated_truth

FPS = 25


def box(row: float, col: float, height: float, width: float) -> np.ndarray:
    return np.array([(row, col), (row, col + width), (row + height, col + width), (row + height, col)], float)


def clip(*frames: list[np.ndarray] | None, start_s: float = 0.0, mouth_width_px: float = MOUTH_WIDTH_PX):
    """A profile of frames with these outlines; None is a frame in which no mouth was found."""
    looks = [Look(NO_MOUTH) if boxes is None else Look(OPEN if boxes else CLOSED, boxes) for boxes in frames]
    return profile_of(looks, [start_s + i / FPS for i in range(len(frames))], mouth_width_px)


# -- frames of the same moment ----------------------------------------------------------------------------------------


def test_frames_are_matched_by_their_times():
    assert pair_frames(np.array([0.0, 0.04, 0.08]), np.array([0.0, 0.04, 0.08])).tolist() == [[0, 0], [1, 1], [2, 2]]
    dropped = pair_frames(np.array([0.041, 0.119]), np.array([0.0, 0.04, 0.08, 0.12]))
    assert dropped.tolist() == [[0, 1], [1, 3]]
    twice_as_many = pair_frames(np.arange(5) * 0.02, np.arange(3) * 0.04)
    assert twice_as_many.tolist() == [[0, 0], [2, 1], [4, 2]]
    assert len(pair_frames(np.array([1.0, 1.04]), np.array([0.0, 0.04]))) == 0
    assert len(pair_frames(np.array([]), np.array([0.0]))) == 0


def test_a_frame_that_was_dropped_moves_nothing():
    true = clip([], [box(9, 9, 4, 20)], [box(9, 9, 8, 30)], [box(9, 9, 2, 10)])
    seen = clip([], [box(9, 9, 4, 20)], [box(9, 9, 8, 30)], [box(9, 9, 2, 10)])
    for table in ("frames", "openings"):
        kept = getattr(seen, table)
        setattr(seen, table, kept[kept["frame"] != 1].reset_index(drop=True))
    del seen.outlines[1]
    report = compare(seen, true)
    assert report["frames"] == 3 and report["frames_without_partner"] == 1
    assert report["height"]["largest_percent"] == 0 and report["overlap_percent"]["least"] == 100


# -- numbers ----------------------------------------------------------------------------------------------------------


def test_a_profile_agrees_with_itself():
    true = clip([], [box(9, 9, 4, 20), box(9, 40, 4, 9)], [box(9, 9, 8, 40)], [])
    report = compare(true, true)
    assert (report["frames"], report["frames_open"], report["frames_with_several_openings"]) == (4, 2, 1)
    for name in ("width", "height", "area"):
        assert report[name]["mean_percent"] == report[name]["largest_percent"] == 0
    for name in ("open_or_closed", "number_of_openings", "several_openings"):
        assert report[f"{name}_right_percent"] == 100
    assert report["overlap_percent"] == {"median": 100, "least": 100}
    assert report["highest_missed_px"] == report["highest_invented_px"] == 0
    assert report["opens"]["off_ms"] == report["closes"]["off_frames"] == 0
    assert math.isnan(report["merges"]["true_s"]) and report["mouth_width_off_percent"] == 0


def test_errors_are_in_percent_of_the_true_mouth_width():
    true = clip([box(9, 9, 6, 30)], [box(9, 9, 6, 30)], [box(9, 9, 6, 30)], mouth_width_px=60)
    seen = clip([box(9, 9, 9, 30)], [box(9, 9, 4.5, 33)], [], mouth_width_px=66)
    report = compare(seen, true)
    assert report["height"]["mean_percent"] == pytest.approx((5 + 2.5) / 2)
    assert report["height"]["bias_percent"] == pytest.approx((5 - 2.5) / 2)
    assert report["height"]["largest_percent"] == pytest.approx(5) and report["height"]["largest_at_s"] == 0
    assert report["width"]["mean_percent"] == pytest.approx(2.5)
    assert report["width"]["largest_at_s"] == pytest.approx(1 / FPS)
    areas = 100 * np.array([30 * 9 - 180, 33 * 4.5 - 180]) / 60**2
    assert report["area"]["mean_percent"] == pytest.approx(np.abs(areas).mean())
    assert report["mouth_width_off_percent"] == pytest.approx(10)
    assert report["overlap_percent"]["median"] == pytest.approx(100 * (6 / 9 + 135 / (180 + 13.5)) / 2, abs=2)
    assert report["highest_missed_px"] == 6


def test_states_are_counted_over_all_frames():
    true = clip([], [], [box(9, 9, 4, 9)], [box(9, 9, 4, 9), box(9, 30, 2, 9)], [box(9, 9, 4, 9)])
    seen = clip([], [box(9, 9, 3, 9)], [], [box(9, 9, 4, 9)], None)
    report = compare(seen, true)
    assert report["open_or_closed_right_percent"] == pytest.approx(40)
    assert report["number_of_openings_right_percent"] == pytest.approx(20)
    assert report["several_openings_right_percent"] == 0
    assert report["frames_without_mouth"] == 1
    assert (report["frames_open"], report["frames_measured_open"]) == (3, 2)
    assert report["highest_invented_px"] == 3 and report["highest_missed_px"] == 4


def test_moments_are_compared_in_time():
    one, two = [box(9, 9, 4, 9)], [box(9, 9, 4, 9), box(9, 30, 2, 9)]
    true, seen = clip([], one, two, one, one, []), clip([], [], one, two, one, one)
    for profile, frame in ((true, 3), (seen, 4)):
        profile.openings.loc[profile.openings["frame"] == frame, "event"] = "merge"
    report = compare(seen, true)
    assert report["opens"] == {"true_s": 0.04, "measured_s": 0.08, "off_ms": 40, "off_frames": 1}
    assert report["closes"]["off_frames"] == 1
    assert report["merges"]["true_s"] == pytest.approx(0.12) and report["merges"]["off_ms"] == pytest.approx(40)
    text = "\n".join(describe(report))
    assert "opens at 0.040 s, seen 1 frame later" in text and "merge at 0.120 s, seen 1 frame later" in text


def test_a_mouth_that_is_never_seen_open_has_no_errors_and_says_so():
    report = compare(clip([], []), clip([], [box(9, 9, 4, 9)]))
    assert math.isnan(report["height"]["mean_percent"]) and math.isnan(report["opens"]["off_ms"])
    assert math.isnan(report["overlap_percent"]["median"])
    assert "which is not seen" in "\n".join(describe(report))


def test_overlap_is_that_of_the_pixels():
    one, other = ellipse(12.0), ellipse(9.0, centre=(62.0, 54.0))
    masks = [fill_outlines([outline * 8], (800, 800)) for outline in (one, other)]
    expected = (masks[0] & masks[1]).sum() / (masks[0] | masks[1]).sum()
    assert overlap([one], [other]) == pytest.approx(expected, abs=0.01)
    assert overlap([one, ellipse(12.0, centre=(60.0, 150.0))], [one]) == pytest.approx(0.5, abs=0.01)
    assert overlap([one], []) == 0 and math.isnan(overlap([], []))


# -- files of the truth -----------------------------------------------------------------------------------------------


@pytest.fixture
def saved(tmp_path):
    mouth, motion = moved_mouth(patch=(0.002, 0.006))
    true = simulated_truth(motion, mouth, Camera(width_px=200, height_px=160))
    true.save(tmp_path, "clip")
    return true, tmp_path


def test_the_truth_is_read_as_it_was_written(saved):
    true, folder = saved
    loaded = load_truth(folder / "clip")
    assert loaded.frames["n_openings"].tolist() == [len(frame) for frame in true.polygons]
    assert max(map(len, true.polygons)) == 2
    for frame, expected in zip(loaded.outlines, true.polygons, strict=True):
        for outline, polygon in zip(frame, expected, strict=True):
            np.testing.assert_allclose(outline, polygon, atol=1e-5)
    np.testing.assert_allclose(loaded.frames["height_px"], true.frames["height_px"], rtol=1e-6)
    assert loaded.meta["mouth_width_px"] == pytest.approx(true.meta["mouth_width_px"])
    report = compare(loaded, loaded)
    assert report["overlap_percent"]["least"] == 100 and report["open_or_closed_right_percent"] == 100


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda frames: frames.pop(), r"expected .*clip\.polygons\.json to hold the outlines of the tables beside it"),
        (lambda frames: frames[-1]["openings"].clear(), "to hold the outlines of the tables beside it"),
        (lambda frames: frames[-1].pop("openings"), "to be outlines that the simulator wrote"),
        (lambda frames: frames[-1]["openings"][0].update(outline=[1, 2]), "to hold the outlines of the tables"),
    ],
)
def test_outlines_that_are_not_those_of_the_tables(saved, change, sentence):
    path = saved[1] / "clip.polygons.json"
    content = json.loads(path.read_text())
    change(content["frames"])
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=sentence):
        load_truth(saved[1] / "clip")


def test_outlines_that_are_not_there(saved):
    (saved[1] / "clip.polygons.json").unlink()
    with pytest.raises(InputError, match=r"expected .*clip\.polygons\.json to be outlines that the simulator wrote"):
        load_truth(saved[1] / "clip")
