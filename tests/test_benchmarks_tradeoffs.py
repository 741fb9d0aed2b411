"""Run time against error: what is compared, errors whose size is known, relative times, and places of labels."""

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pandas as pd
import pytest
from mouth_clip import ellipse

from lipmetrics.detect import make_detector
from lipmetrics.look import CLOSED, NO_MOUTH, OPEN, Look
from lipmetrics.validation import CLEAR_MW

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import timing
import tradeoff_figure
import tradeoffs
import tradeoffs_comparison as comparison
import tradeoffs_detector as detector
import tradeoffs_simulator as simulator

# --- times


def test_works_are_timed_in_turn():
    done = []
    taken = timing.in_turn_s({name: partial(done.append, name) for name in "ab"}, 2)
    assert done == ["a", "b", "a", "b"]
    assert [each.shape for each in taken.values()] == [(2, 2), (2, 2)]


def test_times_are_multiples_of_the_defaults():
    assert timing.relative({"a": 2.0, "b": 3.0, "c": 1.0}, "a") == {"a": 1.0, "b": 1.5, "c": 0.5}


# --- detector


def rows_of(heights, clip="a"):
    return pd.DataFrame({"clip": clip, "frame": range(len(heights)), "height_px": heights})


def test_every_second_frame_leaves_straight_lines_between():
    frames = pd.concat([rows_of([0, 5, 2, 5, np.nan, 5, 6, 5.0]), rows_of([1.0] * 8, "b")], ignore_index=True)
    heights = detector.thin_out(frames, 2)["height_px"]
    np.testing.assert_allclose(heights[:8], [0, 1, 2, 3, 4, 5, 6, 6])
    np.testing.assert_allclose(heights[8:], 1)
    assert detector.thin_out(frames, 1) is frames


class Counting:
    """Sees nothing but the number of each frame it is shown, and says it as its confidence."""

    seen = 0

    def look(self, frame):
        Counting.seen += 1
        return Look(CLOSED, confidence=frame.index)


@pytest.fixture
def five_frames(tmp_path, monkeypatch):
    for index in range(5):
        cv2.imwrite(str(tmp_path / f"{index}.png"), np.full((8, 8, 3), 50 * index, np.uint8))
    monkeypatch.setattr(detector, "open_frames", partial(detector.open_frames, fps=25))
    monkeypatch.setattr(detector.Setting, "detector", lambda self, info: Counting())
    monkeypatch.setattr(Counting, "seen", 0)
    return tmp_path


def test_a_method_is_shown_every_third_frame_only_and_the_others_take_no_time(five_frames):
    looks, taken = zip(*detector.timed_looks(detector.Setting(every=3), five_frames), strict=True)
    assert [look.confidence for look in looks] == [0, 0, 0, 3, 3]
    assert Counting.seen == 2
    assert [one > 0 for one in taken] == [True, False, False, True, False]


@pytest.mark.parametrize("name", detector.SETTINGS)
def test_settings_of_the_detector_exist_and_only_one_is_the_default(name):
    def whole(setting):
        own = make_detector(setting.method, None, None).settings
        return setting.method, replace(own, **setting.changes), setting.every, setting.scale

    assert [whole(one) for one in detector.SETTINGS.values()].count(whole(detector.SETTINGS[name])) == 1
    assert detector.SETTINGS[detector.DEFAULT] == detector.Setting()


def test_outlines_of_a_smaller_picture_are_put_back_on_the_pixels_they_cover():
    square = np.array([[-0.5, -0.5], [-0.5, 3.5], [1.5, 3.5], [1.5, -0.5]])  # of pixels 0 to 1, 0 to 3
    look = detector.scaled_back(Look(OPEN, [square], square[:2]), np.array([0.5, 0.25]))
    np.testing.assert_allclose(look.outlines[0], [[-0.5, -0.5], [-0.5, 15.5], [3.5, 15.5], [3.5, -0.5]])
    np.testing.assert_allclose(look.corners, [[-0.5, -0.5], [-0.5, 15.5]])


@pytest.mark.parametrize("scale, size", [(1.0, (90, 120)), (0.5, (44, 60)), (0.25, (22, 30))])
def test_smaller_copies_have_even_sizes_and_the_same_frames(tmp_path, scale, size):
    path = tmp_path / "clip.mp4"
    detector.write_video(path, [np.full((90, 120, 3), level, np.uint8) for level in (40, 120, 200)], 25, "h264")
    copy = detector.shrunk_copy(path, scale, tmp_path)
    assert (copy == path) == (scale == 1.0)
    assert tuple(detector.size_of(copy)) == size
    with detector.open_frames(copy) as frames:
        np.testing.assert_allclose([frame.rgb().mean() for frame in frames], (40, 120, 200), atol=4)


def truth_of(monkeypatch, heights, mouth_px=100.0):
    """A truth of ellipses that are `heights` high and 40 px wide."""
    outlines = [[ellipse(height / 2, (50.0, 60.0))] if height else [] for height in heights]
    truth = SimpleNamespace(
        frames=pd.DataFrame({"height_px": heights}), meta={"mouth_width_px": mouth_px}, outlines=outlines
    )
    monkeypatch.setattr(detector, "load_truth", lambda path: truth)
    return outlines


def test_errors_on_a_simulated_clip_are_those_of_its_truth(monkeypatch):
    outlines = truth_of(monkeypatch, [0.0, 10.0, 20.0, 20.0, 0.9 * 100 * CLEAR_MW])
    looks = [Look(CLOSED), Look(OPEN, outlines[1]), Look(NO_MOUTH), Look(OPEN, outlines[1]), Look(CLOSED)]
    found = detector.simulated_errors(Path("clip.mp4"), looks)
    np.testing.assert_allclose(found["height_percent"], [0, 0, 20, 10, 1.8], atol=0.3)
    np.testing.assert_allclose(found["lost_percent"], [np.nan, 0, 100, 50, np.nan], atol=3)
    assert found["found"].tolist() == [True, True, False, True, True]


def test_between_every_second_frame_heights_are_interpolated_and_outlines_held(monkeypatch):
    outlines = truth_of(monkeypatch, [10.0, 15.0, 20.0])
    looks = [Look(OPEN, outlines[0]), Look(OPEN, outlines[0]), Look(OPEN, outlines[2])]
    found = detector.simulated_errors(Path("clip.mp4"), looks, every=2)
    np.testing.assert_allclose(found["height_percent"], 0, atol=0.3)
    np.testing.assert_allclose(found["lost_percent"], [0, 100 / 3, 0], atol=3)


def test_another_number_of_frames_than_the_truth_has_is_refused(monkeypatch):
    truth_of(monkeypatch, [10.0, 15.0])
    with pytest.raises(ValueError, match="expected 2 frames"):
        detector.simulated_errors(Path("clip.mp4"), [Look(CLOSED)])


# --- simulator


def test_differences_of_profiles_are_in_percent_of_the_mouth_width():
    frames = [pd.DataFrame({"width_mw": [0.0, w], "height_mw": [0.0, 0.1], "area_mw2": [0.0, a]}) for w, a in
              ((0.5, 0.03), (0.52, 0.028))]  # fmt: skip
    found = simulator.differences(*(SimpleNamespace(frames=each) for each in frames))
    np.testing.assert_allclose(found["width_mw"], [0, 2])
    np.testing.assert_allclose(found["area_mw2"], [0, 0.2], atol=1e-12)
    assert simulator.worst_mean(found) == pytest.approx(1)
    assert simulator.summed_up(np.append(np.zeros(99), 5.0)) == "0.05 / 0.00 / 5.00"


def test_cases_that_are_compared_can_be_solved_and_only_one_is_the_default():
    seen = []
    for mesh, changes in simulator.CASES.values():
        scene = simulator.with_solver(simulator.findings.scene("slow_open", 7.0, mesh), **changes)
        seen.append((mesh, scene.solve))
    assert all(seen.count(each) == 1 for each in seen)
    mesh, changes = simulator.CASES[simulator.DEFAULT]
    assert not changes
    assert mesh == simulator.findings.load_scene("slow_open").face.resolution


# --- comparison


def test_the_warping_of_a_pair_is_the_one_that_is_said():
    for number in range(5):
        one = comparison.warped(number, rate_hz=500)
        inside = (one.later_s >= 0) & (one.later_s <= one.b.time_s[-1])
        ours = np.interp(one.moments_s, one.a.time_s, one.a.channels["height"])[inside]
        theirs = np.interp(one.later_s, one.b.time_s, one.b.channels["height"])[inside]
        apart = np.abs(ours - theirs)
        assert np.ptp(ours) > 0.04
        assert apart.mean() < 0.03  # noise, and a mouth width that is off by a few percent
        away = np.abs(ours - np.interp(one.later_s + 0.1, one.b.time_s, one.b.channels["height"])[inside])
        assert apart.mean() < away.mean()


def test_pairs_come_from_their_numbers():
    assert np.array_equal(comparison.warped(3).b.channels["area"], comparison.warped(3).b.channels["area"])
    assert comparison.warped(3).lag_s != comparison.warped(4).lag_s


def test_errors_of_takes_that_are_only_late_are_known():
    time_s = np.arange(0, 2.4, 1 / 60)
    pulse = np.exp(-(((time_s - 1.2) / 0.2) ** 2))
    channels = dict.fromkeys(comparison.CHANNELS, pulse)
    one = comparison.Take("a", time_s, channels)
    late = comparison.Take("b", time_s + 0.1, channels)
    moments = np.arange(0, 2.4, 0.002)
    moving = np.abs(np.gradient(np.exp(-(((moments - 1.2) / 0.2) ** 2))))
    exact = comparison.Warped(one, late, moments, moments + 0.1, moving)
    assert exact.lag_s == pytest.approx(0.1)
    assert comparison.errors_ms([exact], 0.1)["time"] == pytest.approx(0, abs=0.5)
    off = comparison.Warped(one, late, moments, moments + 0.13, moving)
    found = comparison.errors_ms([exact, off], 0.1)
    assert found["time"] == pytest.approx(15, abs=0.5)
    assert found["lag"] == pytest.approx(15, abs=0.5)
    assert found["kept_in"] == 0


def test_defaults_of_comparison_are_among_what_is_compared():
    assert (comparison.BAND, comparison.OWN_HZ) in comparison.CASES
    assert (comparison.RECOGNITION_BAND, comparison.OWN_HZ) in comparison.CASES


# --- figure

INSIDE = np.array([[0.0, 0.0], [400.0, 300.0]])


def test_a_label_stands_beside_its_point_and_covers_no_other():
    at, half = np.array([200.0, 150.0]), np.array([30.0, 5.0])
    middle = tradeoff_figure.place(at, half, at[None], [], INSIDE)
    assert middle[0] - half[0] > at[0]
    first = np.array([middle - half, middle + half])
    other = tradeoff_figure.place(at, half, np.array([at, middle]), [first], INSIDE)
    assert (np.abs(other - middle) >= 2 * half).any()


def test_a_label_stays_inside_the_panel():
    at, half = np.array([395.0, 150.0]), np.array([30.0, 5.0])
    assert tradeoff_figure.place(at, half, at[None], [], INSIDE)[0] + half[0] < 400


@pytest.mark.parametrize("log", [False, True])
def test_figure_is_drawn_the_same_twice(tmp_path, log):
    points = [
        tradeoff_figure.Point("default", 1.0, 2.0, True, "a"),
        tradeoff_figure.Point("fast", 0.3, 0.0, family="a"),
        tradeoff_figure.Point("slow", 4.0, 1.5, family="b"),
    ]
    panel = tradeoff_figure.Panel("panel", "error", points, log=log, least=1e-3, joined=True)
    files = [tmp_path / "one.png", tmp_path / "other.png"]
    for file in files:
        tradeoff_figure.draw([panel, panel], file, "title", "time")
    assert files[0].read_bytes() == files[1].read_bytes()
    picture = cv2.imread(str(files[0]))
    assert picture.shape == (560, 1240, 3)
    red = (picture == (0x28, 0x27, 0xD6)).all(axis=2)
    assert red[:, :620].any()
    assert red[:, 620:].any()


def test_no_repeats_are_refused(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["tradeoffs.py", "--repeats", "0"])
    with pytest.raises(SystemExit, match="2"):
        tradeoffs.main()
    assert "1 repeat or more" in capsys.readouterr().err
