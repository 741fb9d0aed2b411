from dataclasses import astuple, replace

import cv2
import numpy as np
import pytest
from drawn_mouth import opened

from lipmetrics.artificial import (
    Camera,
    Face,
    Shape,
    draw,
    lip_curves,
    random_camera,
    random_face,
    random_shape,
)

SIZE, MOUTH_PX = (120, 150), 80.0
SHAPES = {
    "slit": opened(0.06),
    "wide open": opened(0.6, roundness=0.5, upper=0.08),
    "one-sided": opened(0.2, span=(-0.9, 0.1)),
    "smile": opened(0.2, smile=0.15, width=1.2),
    "tilted": opened(0.2, skew=0.05),
    "seen from the left": opened(0.2, yaw=-0.2),
    "seen from the right": opened(0.2, yaw=0.2),
    "in two": opened(0.3, glued=((0.1, 0.3),)),
}


def drawn(shape, **how):
    how = {"px_per_mouth": MOUTH_PX, "rng": np.random.default_rng(1), **how}
    return draw(Face(shape=shape), SIZE, **how)


def area_px(shape, upper, lower):
    """Between two of the four lip curves, by the trapezoidal rule."""
    x = np.linspace(-shape.width / 2, shape.width / 2, 20001)
    curves = lip_curves(shape, x)
    return np.trapezoid(curves[lower] - curves[upper], x) * MOUTH_PX**2


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
@pytest.mark.parametrize("how", [{"supersample": 1}, {"roll_rad": 0.4}, {"centre": (55.3, 80.6)}], ids=str)
def test_shares_add_up_to_the_area_between_the_curves(shape, how):
    drawing = drawn(shape, **how)
    assert drawing.opening.sum() == pytest.approx(area_px(shape, 1, 2), rel=0.03)
    assert drawing.lip.sum() == pytest.approx(area_px(shape, 0, 3), rel=0.03)


def test_lower_lip_is_what_lies_below_the_opening():
    shape = opened(0.3)
    drawing = drawn(shape)
    assert drawing.lower.sum() == pytest.approx(area_px(shape, 2, 3), rel=0.05)
    rows = np.arange(SIZE[0])
    heights = [np.average(rows, weights=share.sum(axis=1)) for share in (drawing.opening, drawing.lower)]
    assert heights[0] < heights[1]


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_curves_keep_their_order_and_meet_from_the_corners_on(shape):
    x = np.linspace(-shape.width, shape.width, 2001)
    curves = np.array(lip_curves(shape, x))
    assert np.isfinite(curves).all()
    assert (np.diff(curves, axis=0) >= -1e-12).all()
    outside = np.abs(x) >= shape.width / 2
    assert np.ptp(curves[:, outside], axis=0) == pytest.approx(0, abs=1e-9)


def test_corners_are_where_the_shape_says():
    drawing = drawn(opened(0.2, width=1.1, smile=0.1, skew=0.05, tubercle=0.0), centre=(60.0, 70.0))
    left, right = drawing.corners
    assert left == pytest.approx((60 + 80 * (-0.1 - 0.05), 70 - 80 * 0.55))
    assert right == pytest.approx((60 + 80 * (-0.1 + 0.05), 70 + 80 * 0.55))
    lips = np.argwhere(drawing.lip > 0.5)
    ends = lips[lips[:, 1].argmin()], lips[lips[:, 1].argmax()]
    assert np.array(ends) == pytest.approx(drawing.corners, abs=2.5)


@pytest.mark.parametrize("roll_rad", [-0.3, 0.25])
def test_roll_turns_the_mouth_about_its_centre_right_end_down(roll_rad):
    shape, centre = opened(0.3, smile=0.1), np.array([58.0, 71.0])
    flat, turned = (drawn(shape, centre=tuple(centre), roll_rad=r) for r in (0.0, roll_rad))
    cos, sin = np.cos(roll_rad), np.sin(roll_rad)
    turn = np.array([[cos, -sin], [sin, cos]])  # of (row, column) to the right
    assert turned.corners - centre == pytest.approx((flat.corners - centre) @ turn, abs=1e-4)
    assert np.sign(turned.corners[1, 0] - turned.corners[0, 0]) == np.sign(roll_rad)
    middles = [np.array(np.indices(SIZE) * d.opening).sum(axis=(1, 2)) / d.opening.sum() for d in (flat, turned)]
    assert middles[1] - centre == pytest.approx((middles[0] - centre) @ turn, abs=0.1)


def test_another_centre_moves_everything_and_without_one_it_is_the_middle():
    here, there = drawn(opened(0.3), centre=(50.0, 70.0)), drawn(opened(0.3), centre=(57.0, 66.0))
    for name in ("lip", "opening", "lower"):
        assert np.roll(getattr(here, name), (7, -4), axis=(0, 1)) == pytest.approx(getattr(there, name), abs=1e-3)
    assert drawn(opened(0.3)).corners.mean(axis=0)[1] == pytest.approx((SIZE[1] - 1) / 2)


def test_a_closed_mouth_has_no_opening():
    assert not drawn(Shape()).opening.any()
    face = random_face(np.random.default_rng(3), closed=False)
    assert draw(face, SIZE, MOUTH_PX, supersample=1).opening.any()
    shut = replace(face, shape=replace(face.shape, gap=(0.0, 0.0)))
    assert not draw(shut, SIZE, MOUTH_PX, supersample=1).opening.any()


@pytest.mark.parametrize(("glued", "openings"), [((), 1), (((-0.1, 0.1),), 2), (((-0.4, -0.2), (0.2, 0.4)), 3)])
def test_glued_parts_divide_the_opening(glued, openings):
    mask = drawn(opened(0.25, glued=glued)).opening > 0.5
    assert cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)[0] - 1 == openings


def test_the_same_seed_gives_the_same_bytes():
    def picture(seed):
        rng = np.random.default_rng(seed)
        return draw(random_face(rng), SIZE, MOUTH_PX, camera=random_camera(rng), rng=rng, supersample=1).picture

    assert picture(5).tobytes() == picture(5).tobytes()
    assert picture(5).tobytes() != picture(6).tobytes()


def test_the_generator_changes_skin_and_noise_but_not_the_truth():
    one, other = (drawn(opened(0.3), rng=np.random.default_rng(seed)) for seed in (1, 2))
    assert not np.array_equal(one.picture, other.picture)
    for name in ("lip", "opening", "lower", "corners"):
        assert np.array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.filterwarnings("error")  # a NaN that is turned into a pixel only warns
@pytest.mark.parametrize("faces_n", [40, pytest.param(200, marks=pytest.mark.slow)])
def test_random_faces_draw_without_trouble(faces_n):
    for seed in range(faces_n):
        rng = np.random.default_rng(seed)
        face, camera = random_face(rng), random_camera(rng)
        for colour in (face.skin, face.lip, face.teeth, face.tongue, face.cavity, face.hair):
            assert min(colour) >= 0, seed
            assert max(colour) <= (1.1 if colour is face.teeth else 1), seed  # teeth gleam
        curves = np.array(lip_curves(face.shape, np.linspace(-1, 1, 401)))
        assert (np.diff(curves, axis=0) >= -1e-12).all(), seed
        drawing = draw(face, (56, 64), 34.0, roll_rad=rng.normal(0, 0.2), camera=camera, rng=rng, supersample=1)
        assert (drawing.picture.shape, drawing.picture.dtype) == ((56, 64, 3), np.uint8)
        shares = np.array([drawing.lip, drawing.opening, drawing.lower])
        assert np.isfinite(shares).all(), seed
        assert shares.min() >= 0, seed
        assert shares.max() <= 1 + 1e-5, seed
        assert (drawing.opening <= drawing.lip + 1e-5).all(), seed
        assert bool(drawing.opening.any()) == (sum(face.shape.gap) > 0), seed
        assert np.isfinite(drawing.corners).all(), seed
        assert drawing.picture.std() > 1, seed


def test_random_shapes_close_when_told_and_one_in_four_otherwise():
    rng = np.random.default_rng(0)
    assert all(sum(random_shape(rng, closed=True).gap) == 0 for _ in range(50))
    assert all(sum(random_shape(rng, closed=False).gap) >= 0.03 for _ in range(50))
    shut = [sum(random_shape(rng).gap) == 0 for _ in range(400)]
    assert np.mean(shut) == pytest.approx(0.25, abs=0.07)


def test_the_camera_does_what_its_fields_say():
    def mean_rgb(**camera):
        settings = replace(Camera(noise=0.0, blur_px=0.0, jpeg=100), **camera)
        return draw(Face(), (60, 80), 40.0, camera=settings, supersample=1).picture.mean(axis=(0, 1))

    plain = mean_rgb()
    assert mean_rgb(exposure=0.5) == pytest.approx(plain / 2, rel=0.02)
    assert mean_rgb(gains=(0.8, 1.0, 1.0)) == pytest.approx(plain * (0.8, 1, 1), rel=0.02)
    assert np.ptp(mean_rgb(saturation=0.0)) == pytest.approx(0, abs=0.5)
    assert mean_rgb(coarse=0.5, blur_px=1.0, jpeg=70) == pytest.approx(plain, rel=0.03)


def test_faces_can_be_compared_and_kept():
    assert random_face(np.random.default_rng(4)) == random_face(np.random.default_rng(4))
    assert len(astuple(random_face(np.random.default_rng(4)))) == len(astuple(Face()))


@pytest.mark.parametrize("turn", [(0.3, 0.0), (-0.3, 0.0), (0.0, 0.25), (0.25, -0.2)])
def test_a_turned_head_shows_its_mouth_where_its_corners_say(turn):
    face = Face(shape=opened(0.25), turn=turn)
    front = draw(replace(face, turn=(0.0, 0.0)), SIZE, MOUTH_PX, roll_rad=0.2)
    turned = draw(face, SIZE, MOUTH_PX, roll_rad=0.2)
    lips = np.argwhere(turned.lip > 0.5)
    ends = lips[lips[:, 1].argmin()], lips[lips[:, 1].argmax()]
    assert np.array(ends) == pytest.approx(turned.corners, abs=3)
    widths = [np.hypot(*(d.corners[1] - d.corners[0])) for d in (front, turned)]
    assert widths[1] / widths[0] == pytest.approx(np.cos(turn[0]), rel=0.02)
    assert turned.opening.sum() / front.opening.sum() == pytest.approx(np.cos(turn[0]) * np.cos(turn[1]), rel=0.15)


def test_a_head_turned_aside_shows_more_of_one_half():
    left, right = (
        draw(Face(shape=opened(0.25), turn=(turn, 0.0)), SIZE, MOUTH_PX, centre=(60.0, 75.0)).lip.sum(axis=0)
        for turn in (0.35, -0.35)
    )
    middle = (SIZE[1] - 1) / 2
    halves = [abs(np.flatnonzero(side > 0.5) - middle).max() for side in (left[75:], left[:75], right[75:], right[:75])]
    assert left[75:].sum() != pytest.approx(left[:75].sum(), rel=0.1)
    assert left[75:].sum() == pytest.approx(right[74::-1].sum(), rel=0.1), halves


def test_hair_hides_the_skin_and_leaves_the_truth():
    bare, bearded = (
        draw(Face(shape=opened(0.2), moustache=hair, beard=hair), SIZE, MOUTH_PX) for hair in ((0.0, 0.6), (1.0, 0.05))
    )
    assert np.array_equal(bare.opening, bearded.opening)
    above = np.s_[33:43, 65:85]  # between nose and lip
    assert bearded.picture[above].mean() < 0.6 * bare.picture[above].mean()


def test_a_tongue_put_out_hides_the_lower_lip_and_leaves_the_truth():
    inside, out = (
        draw(Face(shape=opened(0.3), tongue_out=tongue), SIZE, MOUTH_PX) for tongue in ((0.0, 0.0), (0.3, 0.0))
    )
    assert np.array_equal(inside.opening, out.opening)
    lower = (inside.lower > 0.9) & (np.abs(np.arange(SIZE[1]) - 74.5) < 8)
    changed = np.abs(inside.picture.astype(int) - out.picture).max(axis=2)
    assert (changed[lower] > 5).mean() > 0.8
    assert np.median(changed[:35, 60:90]) < 8


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("turn", [(0.5, 0.4), (-0.5, -0.4), (0.5, 0.0)])
def test_a_turned_head_is_drawn_far_around_it_too(turn):
    drawing = draw(Face(shape=opened(0.3), turn=turn), (90, 100), 8.0, centre=(5.0, 95.0), supersample=1)
    assert np.isfinite(drawing.lip).all()
    assert drawing.lip.sum() > 5
