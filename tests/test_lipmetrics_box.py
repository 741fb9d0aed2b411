import cv2
import numpy as np
import pytest
from drawn_mouth import AskedFrame

from lipmetrics.box import ASPECT, CANVAS, COARSE, MOUTH, Box, lay_canvas, nine_of_sixteen

MIDDLE = (np.array(CANVAS) - 1) / 2


def ramp(height, width):
    """(height, width, 3) float32 whose red is its row and whose green is its column: no rounding hides a shift."""
    rows, cols = np.indices((height, width), np.float32)
    return np.stack([rows, cols, 0 * rows], axis=2)


def places(box, size):
    """(*size, 2) (row, column) in the picture of every pixel of a canvas of `size`."""
    points = np.indices(size).reshape(2, -1).T
    fine = (points + 0.5) * np.array(CANVAS) / np.array(size) - 0.5
    return box.to_picture(fine).reshape(*size, 2)


def test_to_canvas_undoes_to_picture():
    rng = np.random.default_rng(0)
    for _ in range(20):
        box = Box(*rng.uniform(-50, 500, 2), rng.uniform(5, 900), rng.uniform(-0.7, 0.7))
        points = rng.uniform(-20, 150, (30, 2))
        assert box.to_canvas(box.to_picture(points)) == pytest.approx(points, abs=1e-9)


def test_from_canvas_to_canvas_is_through_the_picture():
    rng = np.random.default_rng(1)
    for _ in range(20):
        one, other = (Box(*rng.uniform(-50, 500, 2), rng.uniform(20, 200), rng.uniform(-0.7, 0.7)) for _ in range(2))
        points = rng.uniform(-20, 150, (30, 2))
        through = other.to_canvas(one.to_picture(points))
        assert np.column_stack([points, np.ones(30)]) @ one.onto(other).T == pytest.approx(through)
        assert one.place(*points[0]) == pytest.approx(one.to_picture(points[:1])[0])


def test_the_mouth_fills_its_share_of_the_canvas():
    ends = Box(40.0, 90.0, 100.0).to_picture(MIDDLE + np.array([(0, -MOUTH / 2), (0, MOUTH / 2)]))
    assert ends == pytest.approx(np.array([(40, 40), (40, 140)]))
    left, right = Box(40.0, 90.0, 100.0, 0.3).to_picture(MIDDLE + np.array([(0, -MOUTH / 2), (0, MOUTH / 2)]))
    assert right - (40, 90) == pytest.approx((50 * np.sin(0.3), 50 * np.cos(0.3)))  # right end lower
    assert left + right == pytest.approx((80, 180))


@pytest.mark.parametrize("size", [CANVAS, COARSE])
@pytest.mark.parametrize(
    "box",
    [
        Box(450.0, 460.0, 64.0),
        Box(450.3, 460.6, 50.0),
        Box(450.4, 460.7, 100.0, 0.35),
        Box(452.0, 463.0, 70.0, -0.7),
        Box(440.0, 450.0, 12.0, 0.1),
        Box(450.0, 460.0, 230.0),
        Box(450.5, 465.2, 300.0, -0.3),
        Box(450.0, 460.0, 440.0),
    ],
    ids=str,
)
def test_the_canvas_shows_the_place_it_lies_on(box, size):
    canvas = lay_canvas(AskedFrame(ramp(900, 920)), box, size)
    off = canvas[..., :2] - places(box, size)
    step = ASPECT * box.scale * CANVAS[1] / size[1]  # picture px per column
    assert np.abs(off).max() < 0.03 + 0.03 * step
    assert np.abs(off.mean(axis=(0, 1))).max() < 0.02


@pytest.mark.parametrize("size", [CANVAS, COARSE])
@pytest.mark.parametrize("width_px", [230.0, 440.0])
def test_a_canvas_smaller_than_its_place_shows_averages_of_it(width_px, size):
    chequered = np.repeat((np.indices((900, 920)).sum(axis=0) % 2 * 255).astype(np.uint8)[..., None], 3, axis=2)
    canvas = lay_canvas(AskedFrame(chequered), Box(450.0, 460.0, width_px, 0.2), size)
    assert canvas.mean() == pytest.approx(127.5, abs=2)
    assert np.ptp(canvas) <= 130  # picked pixels would be 0 and 255


@pytest.mark.parametrize("size", [CANVAS, COARSE])
@pytest.mark.parametrize(
    "box", [Box(5.0, 120.0, 64.0), Box(236.0, 245.0, 80.0, 0.3), Box(110.0, 2.0, 20.0, -0.2)], ids=str
)
def test_beyond_the_picture_its_edge_is_repeated(box, size):
    canvas = lay_canvas(AskedFrame(ramp(240, 250)), box, size)
    expected = np.clip(places(box, size), 0, (239, 249))
    assert np.abs(canvas[..., :2] - expected).max() < max(1.5, 1.1 * ASPECT * box.scale * CANVAS[1] / size[1])


def test_only_what_lies_under_the_canvas_is_asked_for():
    frame = AskedFrame(ramp(240, 250))
    box = Box(100.0, 130.0, 40.0, 0.2)
    lay_canvas(frame, box)
    (region,) = frame.asked
    hull = places(box, CANVAS).reshape(-1, 2)
    assert all(isinstance(bound, int) for bound in region)
    low, high = np.array(region[::2]), np.array(region[1::2])
    assert (low <= hull.min(axis=0)).all()
    assert (high > hull.max(axis=0)).all()
    assert (low >= hull.min(axis=0) - 5 - 2 * ASPECT * box.scale).all()
    assert (high <= hull.max(axis=0) + 6 + 2 * ASPECT * box.scale).all()


def test_nothing_is_asked_for_where_the_canvas_misses_the_picture():
    frame = AskedFrame(ramp(60, 80))
    for box in (Box(300.0, 40.0, 40.0), Box(30.0, -200.0, 40.0), Box(-80.0, 40.0, 30.0, 0.3)):
        assert lay_canvas(frame, box) is None
    assert frame.asked == []


@pytest.mark.parametrize("side", [2, 3, 8])
def test_a_tiny_picture_fills_the_canvas(side):
    picture = np.full((side, side, 3), 77, np.uint8)
    canvas = lay_canvas(AskedFrame(picture), Box(side / 2, side / 2, 64.0))
    assert (canvas.shape, canvas.dtype) == ((*CANVAS, 3), np.uint8)
    assert (canvas == 77).all()
    assert (lay_canvas(AskedFrame(picture), Box(side / 2, side / 2, 900.0, 0.2)) == 77).all()


def test_nine_pixels_are_the_means_of_sixteen():
    picture = np.random.default_rng(0).integers(0, 256, (*CANVAS, 3)).astype(np.uint8)
    small, high, wide = nine_of_sixteen(picture), CANVAS[0] // 16, CANVAS[1] // 16
    fine = picture.repeat(9, axis=0).repeat(9, axis=1).astype(float)
    assert np.array_equal(small, np.round(fine.reshape(9 * high, 16, 9 * wide, 16, 3).mean(axis=(1, 3))))
    assert np.array_equal(small, cv2.resize(picture, COARSE[::-1], interpolation=cv2.INTER_AREA))
