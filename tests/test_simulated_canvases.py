"""Simulated pictures for training: what is known of their pixels, and that they are the same every time."""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import simulated_canvases as canvases

from lipmetrics.box import CANVAS, MOUTH
from simulator.camera import Camera
from simulator.truth import truth

LIP, OPENING, LOWER = range(3)


@pytest.fixture(scope="module")
def album(tmp_path_factory):
    """Two motions, and the pictures of three looks."""
    folder = tmp_path_factory.mktemp("album")
    canvases.solve_motions(folder, count=2)
    canvases.draw_pictures(folder, stages=3, motions=2)
    return folder


def test_shares_are_shares_and_openings_and_lower_lips_are_mouth(album):
    files = sorted(album.glob("*.shares.png"))
    assert len(files) == 3 * canvases.PER_STAGE
    openings = 0
    for file in files:
        shares = cv2.imread(str(file))[..., ::-1] / 255
        picture = cv2.imread(str(album / file.name.replace(".shares", "")))
        assert picture.shape == shares.shape
        assert (shares[..., OPENING] + shares[..., LOWER] <= shares[..., LIP] + 2 / 255).all()
        assert shares[..., LOWER].sum() > 0.2 * shares[..., LIP].sum()
        openings += shares[..., OPENING].max() > 0.5
    assert openings > 3


def test_the_opening_of_a_canvas_has_the_area_that_the_truth_says(album):
    motion = canvases.solved(album, 0)
    number = int(motion.height_mw.argmax())
    assert motion.height_mw[number] > 0.05
    mouth = motion.mouth
    camera = Camera(width_px=200, height_px=160, view_m=2 * mouth.width_m)
    patches = canvases.lip_patches(mouth, motion.positions[number].astype(float))
    upper, lower = (canvases.lip_share(camera, patches[side], (160, 200)) for side in ("upper", "lower"))
    width = np.flatnonzero((upper + lower > 0.5).any(axis=0))
    assert np.ptp(width) == pytest.approx(100, abs=14)  # 100 px from corner to corner at rest
    rows = np.arange(160)[:, None]
    assert (rows * upper).sum() / upper.sum() < (rows * lower).sum() / lower.sum()
    both = np.minimum(upper, lower).sum() / upper.sum()
    assert both < 0.1  # they meet along one line only
    # the red is as high as the mesh says where the mouth is shut
    still = canvases.lip_patches(mouth, mouth.nodes)
    share = np.maximum(*(canvases.lip_share(camera, still[side], (160, 200)) for side in ("upper", "lower")))
    shape = motion.scene.face.shape()
    high_px = (shape.upper_lip_m + shape.lower_lip_m) * camera.px_per_m
    assert share[:, 100].sum() == pytest.approx(high_px, rel=0.2)


def test_heights_and_numbers_of_openings_are_those_of_the_truth(album):
    motion = canvases.solved(album, 1)
    solved = canvases.simulate(motion.scene, parts=motion.scene.model(), threads=1)
    frames = truth(solved, motion.mouth, Camera(), solved.time_s).frames
    np.testing.assert_array_equal(motion.openings, frames["n_openings"])
    np.testing.assert_allclose(motion.height_mw, frames["height_mw"].fillna(0), atol=1e-12)


def test_a_cut_canvas_has_its_mouth_where_and_as_large_as_asked(album):
    for seed in range(6):
        rng = np.random.default_rng(seed)
        canvas, shares = canvases.cut_canvas(album, CANVAS, 1.0, np.zeros(2), 0.0, 0.5, rng)
        assert canvas.shape == (*CANVAS, 3) and canvas.dtype == np.uint8
        assert shares.shape == (3, *CANVAS) and shares.dtype == np.float32
        rows, cols = (np.flatnonzero((shares[LIP] > 0.5).any(axis=axis)) for axis in (1, 0))
        assert abs((rows[0] + rows[-1]) / 2 - (CANVAS[0] - 1) / 2) < 2
        assert abs((cols[0] + cols[-1]) / 2 - (CANVAS[1] - 1) / 2) < 3
        assert np.ptp(cols) == pytest.approx(MOUTH, abs=6)
    moved = canvases.cut_canvas(album, CANVAS, 1.0, np.array([0.1, -0.2]), 0.0, 0.5, np.random.default_rng(5))[1]
    row, col = (np.average(np.arange(n), weights=moved[LIP].sum(axis=1 - k)) for k, n in enumerate(CANVAS))
    now_row, now_col = (np.average(np.arange(n), weights=shares[LIP].sum(axis=1 - k)) for k, n in enumerate(CANVAS))
    assert row - now_row == pytest.approx(0.1 * 2 * MOUTH, abs=1)
    assert col - now_col == pytest.approx(-0.2 * MOUTH, abs=1)


def test_shut_mouths_come_as_often_as_asked(album):
    for closed in (0.0, 1.0):
        cut = [
            canvases.cut_canvas(album, CANVAS, 1.0, np.zeros(2), 0.0, closed, np.random.default_rng(n))[1]
            for n in range(4)
        ]
        assert all((shares[OPENING].max() > 0) == (closed == 0) for shares in cut)


def test_the_same_seed_gives_the_same_pictures(album, tmp_path):
    again = tmp_path / "again"
    canvases.solve_motions(again, count=2)
    canvases.draw_pictures(again, stages=1, motions=2)
    names = sorted(path.name for path in again.glob("000000*.png"))
    assert len(names) == 2 * canvases.PER_STAGE
    for name in names:
        assert (again / name).read_bytes() == (album / name).read_bytes()


def test_a_quad_is_cut_where_the_red_ends():
    square = np.array([(0.0, 0, 0), (4, 0, 0), (4, 1, 0), (0, 1, 0)])
    kept = canvases._cut(square, np.array([-1.0, 3, 3, -1]))
    assert kept[:, 0].min() == pytest.approx(1)
    assert len(kept) == 4
