"""The benchmarks' own arithmetic: the split by person, masks, heights and scores worked out by hand."""

import sys
from pathlib import Path

import av
import numpy as np
import pandas as pd
import pytest

from lipmetrics.look import CLOSED, NO_MOUTH, OPEN, Look
from simulator.mesh import block, to_tetrahedra

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import mouth
import reference
import results
import scores
import solver
import speed

needs_data = pytest.mark.skipif(
    reference.reference_folder() is None,
    reason="reference data absent; set LIPMETRICS_REFERENCE or put them in ../shared/reference",
)


# --- split


def test_faces_of_one_photograph_are_not_divided():
    assert reference.person("h_2005566839_1") == reference.person("h_2005566839_3") == "h_2005566839"
    assert reference.person("grid_s2") == "grid_s2"
    assert reference.person("lp_d1") != reference.person("lp_d10")


def test_split_is_the_same_in_every_run():
    names = ("lp_d0", "lp_d6", "aoc", "grid_s2", "trump", "vr_1", "german", "noem")
    assert "".join(reference.part_of(name)[0] for name in names) == "trrttrtr"


@needs_data
def test_no_person_is_on_both_sides():
    tune, report = (
        {reference.person(name) for folder in ("videos", "hand", "stills_mask", "stills_pts")
         for name in reference.choose(folder, part)["identity"]}
        for part in ("tune", "report")
    )  # fmt: skip
    assert tune
    assert report
    assert not tune & report
    part = {Path(path).stem: half for half in ("tune", "report") for path in reference.choose("videos", half)["path"]}
    assert part["grid_pwij3p"] == part["grid_id2"]
    assert part["mt_trump"] == part["fom_04"]
    for half in ("tune", "report"):
        for item in reference.items("hand", half):
            assert part[reference.split_hand_name(item.file.name)[0]] == half


@needs_data
def test_halves_are_balanced():
    for folder, count in {"videos": 34, "hand": 20, "stills_mask": 150, "stills_pts": 62}.items():
        assert len(reference.choose(folder, "all")) == count
        assert 0.4 <= len(reference.choose(folder, "report")) / count <= 0.6


# --- masks and heights


def test_fill_takes_pixels_whose_centre_is_inside():
    box = np.array([[0.5, 1.5], [0.5, 5.5], [3.5, 5.5], [3.5, 1.5]])
    expected = np.zeros((5, 8), bool)
    expected[1:4, 2:6] = True
    np.testing.assert_array_equal(reference.fill([box], (5, 8)), expected)
    np.testing.assert_array_equal(reference.fill([box[::-1]], (5, 8)), expected)


def test_fill_joins_outlines_and_cuts_them_at_the_picture():
    left = np.array([[-3.0, -4.0], [-3.0, 1.4], [1.4, 1.4], [1.4, -4.0]])
    right = left + np.array([0, 2])
    assert reference.fill([left, right], (4, 3)).sum() == 2 * 3
    assert not reference.fill([], (4, 3)).any()


def test_fill_agrees_with_counting_crossings_pixel_by_pixel():
    rng = np.random.default_rng(3)
    angle = np.sort(rng.uniform(0, 2 * np.pi, 15))
    star = np.stack([9 + np.sin(angle) * rng.uniform(3, 8, 15), 13 + np.cos(angle) * rng.uniform(4, 12, 15)], axis=1)
    expected = [[_inside(star, row, col) for col in range(27)] for row in range(19)]
    np.testing.assert_array_equal(reference.fill([star], (19, 27)), expected)


def _inside(polygon, row, col):
    inside = False
    for (row0, col0), (row1, col1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if (row0 > row) != (row1 > row) and col < col0 + (row - row0) / (row1 - row0) * (col1 - col0):
            inside = not inside
    return inside


@pytest.mark.parametrize(
    ("outlines", "height"),
    [
        ([], 0.0),
        ([[[0, 0], [0, 4], [4, 0]]], 4.0),  # right triangle, fullest at its upright side
        ([[[2.25, 1.0], [0.5, 5.0], [2.25, 9.0], [4.75, 5.0]]], 4.25),  # diamond between pixels
        ([[[0, 0], [0, 6], [3, 6], [3, 3], [7, 3], [7, 6], [10, 6], [10, 0]]], 10.0),  # a C: its back is fullest
        ([[[0, 1], [0, 6], [3, 6], [3, 1]], [[5, 4], [5, 9], [6, 9], [6, 4]]], 4.0),  # one above the other
    ],
    ids=["none", "triangle", "sub-pixel", "concave", "two"],
)
def test_height_is_the_length_inside_the_fullest_column(outlines, height):
    assert reference.height_px([np.array(one, float) for one in outlines]) == pytest.approx(height)


def test_iou():
    one, other = np.zeros((4, 4), bool), np.zeros((4, 4), bool)
    assert reference.iou(one, other) == 1
    one[:2], other[1:3] = True, True
    assert reference.iou(one, other) == pytest.approx(4 / 12)


# --- pictures


class Still:
    """An item with a mouth of 20 px from column 5 to 25, open by 4 rows of 10 columns."""

    name = identity = "c_made_up"
    kind, mouth_width_px = "stills_mask", 20.0
    corners = np.array([[10.0, 5.0], [10.0, 25.0]])

    def __init__(self, is_open=True):
        self.is_open = is_open

    def mask(self):
        mask = np.zeros((20, 30), bool)
        mask[8:12, 10:20] = self.is_open
        return mask


def box(row0, row1, col0, col1):
    return np.array([[row0, col0], [row0, col1], [row1, col1], [row1, col0]], float)


def test_score_of_an_opening_twice_as_high():
    row = scores.score(Still(), Look(OPEN, [box(7.5, 15.5, 9.5, 19.5)], Still.corners + np.array([2, 0]))).row
    assert row["iou"] == pytest.approx(0.5)
    assert row["height_px"] == pytest.approx(8)
    assert row["height_error_pct"] == pytest.approx(20)
    assert row["off_centre_mw"] == pytest.approx(0.1)
    assert row["located"]


@pytest.mark.parametrize(
    "corners",
    [Still.corners + np.array([6.5, 0]), [[10, -1], [10, 31]], np.full((2, 2), np.nan)],
    ids=["too low", "too wide", "unknown"],
)
def test_mouth_in_the_wrong_place_or_size_is_not_located(corners):
    corners = np.array(corners, float)
    assert not scores.score(Still(), Look(CLOSED, [], corners)).row["located"]


def test_summary_counts_false_and_missed():
    right = Look(OPEN, [box(7.5, 11.5, 9.5, 19.5)])
    looks = [(Still(), right), (Still(), Look(CLOSED)), (Still(), Look(NO_MOUTH)), (Still(False), right)]
    found = scores.summary(scores.table([scores.score(*pair) for pair in looks]))
    assert (found["open"], found["closed"]) == (3, 1)
    assert (found["missed"], found["false_open"], found["no_mouth"]) == (2, 1, 1)
    assert found["iou_median"] == 0
    assert found["height_error_pct"] == pytest.approx((0 + 20 + 20) / 3)


# --- clips


def test_closed_and_still_parts():
    height = np.array([0.0] * 4 + [0.3] + [0.01] * 5 + [0.2, 0.21, 0.2, 0.22, 0.21, 0.3, 0.2])
    assert np.flatnonzero(scores.closed_frames(height)).tolist() == [5, 6, 7, 8, 9]
    assert np.flatnonzero(scores.still_frames(height)).tolist() == [10, 11, 12, 13, 14]


def test_bends_need_three_known_neighbours():
    height = np.array([0.1, 0.1, 0.2, 0.1, np.nan, 0.1, 0.1])
    inside = np.ones(7, bool)
    np.testing.assert_allclose(scores.bends(height, inside), [10, 20])
    inside[0] = False
    np.testing.assert_allclose(scores.bends(height, inside), [20])


def clip_of(height_px):
    theirs = np.array([0.0, 0.0, 2.0, 4.0, 6.0, 4.0, 2.0, 0.0])
    status = [NO_MOUTH if np.isnan(height) else OPEN if height else CLOSED for height in height_px]
    tools = {"open_h_px": theirs, "mouth_w_px": 40.0, "mp_ok": 1, "agree": 1}
    ours = {"status": status, "height_px": height_px, "lip_width_px": 20.0}
    return pd.DataFrame({"clip": "a", "frame": range(8)} | tools | ours)


def test_a_profile_of_half_the_size_agrees_fully():
    clip = scores.clip_scores(clip_of([0, 0, 1, 2, 3, 2, 1, 0])).iloc[0]
    assert clip["correlation"] == pytest.approx(1)
    assert clip["agreement_pct"] == 100


def test_a_frame_without_a_mouth_disagrees():
    clip = scores.clip_scores(clip_of([0, np.nan, 1, 2, np.nan, 2, 1, 0])).iloc[0]
    assert clip["agreement_pct"] == 75
    assert clip["found_pct"] == 75


def test_a_profile_that_never_moves_has_no_correlation():
    assert scores.clip_scores(clip_of([1.0] * 8)).iloc[0]["correlation"] == 0


def test_summary_weighs_agreement_by_frames():
    frames = pd.concat(
        [clip_of([0, 0, 1, 2, 3, 2, 1, 0]), clip_of([3.0] * 8).assign(clip="b", agree=[1] * 4 + [0] * 4)]
    )
    found = scores.video_summary(scores.clip_scores(frames))
    assert found["agreement_pct"] == pytest.approx(100 * (8 + 2) / 12)
    assert found["agreement_median_pct"] == pytest.approx(75)


# --- speed


def test_enlarged_clip_keeps_its_frames_and_fills_the_sides(tmp_path):
    small, large = tmp_path / "small.mp4", tmp_path / "large.mp4"
    with av.open(str(small), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv420p"
        for level in (40, 120, 200):
            frame = av.VideoFrame.from_ndarray(np.full((64, 64, 3), level, np.uint8), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    speed.enlarge(small, large, height=128, width=256)
    with av.open(str(large)) as container:
        frames = list(container.decode(video=0))
    pictures = [frame.to_ndarray(format="rgb24") for frame in frames]
    assert [frame.time for frame in frames] == pytest.approx([0, 0.04, 0.08])
    assert [picture.shape for picture in pictures] == [(128, 256, 3)] * 3
    np.testing.assert_allclose([picture[64, 128, 0] for picture in pictures], (40, 120, 200), atol=6)
    np.testing.assert_allclose([picture[64, 20, 0] for picture in pictures], 128, atol=6)


# --- tables


def test_sections_are_replaced_one_at_a_time(tmp_path):
    file = tmp_path / "RESULTS.md"
    results.write_section("accuracy", "first try", file)
    results.write_section("speed", "fast", file)
    results.write_section("accuracy", "second try", file)
    text = file.read_text()
    assert "first try" not in text
    assert text.index("second try") < text.index("fast")
    assert [path.name for path in tmp_path.iterdir()] == ["RESULTS.md"]


def test_markdown_table():
    table = pd.DataFrame({"a": [1.0, np.nan], "b": [0.126, "x"]}, index=pd.Index(["p", "q"], name="row"))
    assert results.markdown(table).splitlines() == [
        "| row | a | b |",
        "| --- | --- | --- |",
        "| p | 1 | 0.13 |",
        "| q | - | x |",
    ]


# --- simulated mouth


def test_stopwatch_adds_up_what_a_method_took():
    class Worker:
        def work(self, number):
            return number + 1

    watch, worker = mouth._Stopwatch(), Worker()
    watch.watch(worker, "work", "working")
    assert [worker.work(1), worker.work(2)] == [2, 3]
    assert watch.spent["working"] >= 0


# --- meshes


def test_the_stepper_advances_the_sheet():
    stepper = solver.Stepper(solver.sheet(852, dt_s=solver.ANIMATION_DT), "mixed", 5)
    stepper.run()
    assert stepper.nodes.u.any()


def test_quartered_tetrahedra_fill_the_block_with_hexahedra_that_share_their_nodes():
    nodes, cells = block((2, 3, 1), (0.2, 0.3, 0.1))
    tetrahedra = to_tetrahedra(nodes, cells)
    points, hexahedra = solver.quartered(nodes, tetrahedra)
    assert hexahedra.shape == (4 * len(tetrahedra), 8)
    assert len(np.unique(points.round(9), axis=0)) == len(points)  # no node twice
    signs = np.array([(x, y, z) for z in (-1, 1) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]) / 8
    jacobians = np.linalg.det(np.einsum("ni,enj->eij", signs, points[hexahedra]))
    assert jacobians.min() > 0
    faces = [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    sides = np.sort(hexahedra[:, faces].reshape(-1, 4), axis=1)
    _, shared = np.unique(sides, axis=0, return_counts=True)
    assert shared.max() == 2
    on_surface = 2 * (2 * 3 + 2 * 1 + 3 * 1) * 2 * 3  # squares of two triangles, three quadrilaterals each
    assert (shared == 1).sum() == on_surface
