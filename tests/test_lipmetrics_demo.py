import json

import numpy as np
import pytest
from drawn_mouth import overlap

from lipmetrics import demo
from lipmetrics.artificial import Shape, lip_curves
from lipmetrics.frames import open_frames
from lipmetrics.look import CLOSED, OPEN
from lipmetrics.openings import measure_outline

SHAPES = demo.sticky_opening()
STUCK = [shape for shape in SHAPES if shape.glued]


def test_the_mouth_rests_opens_in_two_parts_that_merge_and_closes():
    counts = [len(demo.true_outlines(shape)) for shape in SHAPES]
    assert len(SHAPES) == 3 * demo.FPS
    assert [count for k, count in enumerate(counts) if k == 0 or count != counts[k - 1]] == [0, 2, 1, 0]
    assert counts.count(2) >= 10
    assert counts[0] == counts[-1] == 0


def test_true_outlines_are_the_curves_themselves():
    shape = Shape(gap=(0.1, 0.2), span=(-0.8, 0.9), smile=0.1)
    (opening,) = map(measure_outline, demo.true_outlines(shape))
    x = np.linspace(-0.5, 0.5, 100001)
    _, upper, lower, _ = lip_curves(shape, x)
    px = demo.MOUTH_WIDTH_PX
    assert opening.height_px == pytest.approx(0.3 * px, abs=0.01)
    assert opening.area_px == pytest.approx(np.trapezoid(lower - upper, x) * px**2, rel=1e-3)
    assert opening.width_px == pytest.approx(0.85 * px, abs=0.5)
    assert opening.col_min == pytest.approx(demo.CENTRE[1] - 0.4 * px, abs=0.5)
    assert opening.row_min == pytest.approx(demo.CENTRE[0] + upper.min() * px, abs=px * 0.1)
    assert demo.true_outlines(Shape()) == []


@pytest.mark.parametrize(
    "shape", [STUCK[-1], max(SHAPES, key=lambda shape: shape.gap), Shape()], ids=["stuck", "wide", "shut"]
)
def test_the_picture_shows_what_the_truth_says(shape):
    assert overlap(demo.true_outlines(shape), demo.drawn(shape).opening) > 0.97


def test_the_face_stays_the_same_while_the_mouth_moves():
    one, other = demo.drawn(STUCK[0]).picture, demo.drawn(STUCK[-1]).picture
    assert one.shape == (*demo.SIZE, 3)
    above = slice(0, int(demo.CENTRE[0] - 0.4 * demo.MOUTH_WIDTH_PX))
    assert np.abs(one[above].astype(int) - other[above]).max() <= 12
    assert not np.array_equal(one, other)


def test_a_profile_agrees_with_itself():
    truth = demo.true_profile(SHAPES)
    report = demo.compare(truth, truth)
    assert report["frames"] == len(SHAPES)
    assert report["frames_open"] == sum(sum(shape.gap) * demo.MOUTH_WIDTH_PX > 0.1 for shape in SHAPES)
    assert report["height_error_percent"] == 0
    assert report["open_or_closed_right_percent"] == report["number_of_openings_right_percent"] == 100


def test_differences_are_counted_in_percent():
    truth, other = demo.true_profile(SHAPES), demo.true_profile(SHAPES)
    frames = other.frames
    seen_open = np.flatnonzero(frames["status"] == OPEN)
    frames["height_px"] += 0.03 * demo.MOUTH_WIDTH_PX
    frames.loc[seen_open[:3], "status"] = CLOSED
    frames.loc[seen_open[-6:], "n_openings"] += 1
    report = demo.compare(other, truth)
    assert report["height_error_percent"] == pytest.approx(3)
    assert report["open_or_closed_right_percent"] == pytest.approx(100 * (1 - 3 / len(SHAPES)))
    assert report["number_of_openings_right_percent"] == pytest.approx(100 * (1 - 6 / len(SHAPES)))


def test_the_clip_has_every_frame_at_its_time(tmp_path):
    demo.write_clip(tmp_path / "clip.mp4", SHAPES[::15])
    with open_frames(tmp_path / "clip.mp4") as frames:
        times = [frame.time_s for frame in frames]
        assert (frames.info.height, frames.info.width) == demo.SIZE
    assert times == pytest.approx(np.arange(5) / demo.FPS)


@pytest.mark.slow
def test_the_default_method_measures_the_clip_well(tmp_path):
    report = demo.demo(tmp_path)
    assert report["height_error_percent"] < 3
    assert report["open_or_closed_right_percent"] >= 95
    assert report["number_of_openings_right_percent"] >= 90
    assert report["mouth_width_px"] == pytest.approx(report["true_mouth_width_px"], rel=0.05)
    saved = json.loads((tmp_path / "demo.report.json").read_text())
    assert saved["height_error_percent"] == report["height_error_percent"]
    assert any("height" in line and "%" in line for line in report["text"])
