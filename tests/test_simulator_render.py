"""The renderer against geometry worked out otherwise, and against what light and cameras must do."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from moved_mouth import moved_mouth

from simulator.aperture import COAT_M
from simulator.camera import Camera
from simulator.errors import InputError
from simulator.inside import jaw_matrix, turned_jaw
from simulator.look import CLEAN, TONES, Inside, Light, Look, Sensor, Skin, to_linear, to_srgb
from simulator.motion import BROKEN, INTACT
from simulator.render import Stage, draw_mouth, render
from simulator.truth import truth

SMALL = Camera(width_px=128, height_px=96, view_m=0.09)
EMPTY = Inside(upper_teeth=False, lower_teeth=False, tongue=False, cavity_colour=(0, 0, 0))
PLAIN = Look(sensor=CLEAN)


@pytest.fixture(scope="module")
def scene():
    return moved_mouth("low", times=11, drop_m=0.03)


def polygon_of(mouth, positions, camera, columns):
    """Heights of the opening's upper and lower border at picture columns, px, from the projected edges."""
    ends = positions[[mouth.upper, mouth.lower]]  # (2, columns, outer and inner, 3)
    film = np.linalg.norm(mouth.nodes[mouth.upper] - mouth.nodes[mouth.lower], axis=-1)[..., None] + COAT_M
    apart = ends[0] - ends[1]
    nearer = apart * np.maximum(1 - film / np.linalg.norm(apart, axis=-1, keepdims=True), 0)
    middle = ends.mean(axis=0)
    place = camera.project(np.stack([middle + nearer / 2, middle - nearer / 2]))
    lines = [[np.interp(columns, lip[:, e, 1], lip[:, e, 0]) for e in (0, 1)] for lip in place]
    for lip, edges, lowest in zip(place, lines, (-np.inf, np.inf), strict=True):  # a lip's sides hide too
        for (r0, c0), (r1, c1) in lip:
            part = (columns - c0) / (c1 - c0 or 1e-9)
            edges.append(np.where((part > 0) & (part < 1), r0 + part * (r1 - r0), lowest))
    return np.max(lines[0], axis=0), np.min(lines[1], axis=0)


def cover_of(mouth, positions, camera, fine=32):
    """(H, W) cover of the opening, each column cut into `fine` strips."""
    columns = (np.arange(camera.width_px * fine) + 0.5) / fine - 0.5
    top, low = polygon_of(mouth, positions, camera, columns)
    rows = np.arange(camera.height_px)[:, None]
    strips = np.clip(np.minimum(low, rows + 0.5) - np.maximum(top, rows - 0.5), 0, 1)
    return strips.reshape(camera.height_px, camera.width_px, fine).mean(axis=2)


@pytest.mark.parametrize("yaw_deg", [0, 15])
@pytest.mark.parametrize("frame", [1, 4, pytest.param(10, marks=pytest.mark.slow)])
def test_cover_is_the_area_between_the_projected_edges(scene, frame, yaw_deg):
    mouth, motion = scene
    camera = replace(SMALL, yaw_deg=yaw_deg)
    cover = Stage(mouth, camera, PLAIN).cover(motion.positions[frame])
    expected = cover_of(mouth, motion.positions[frame], camera)
    assert expected.sum() > 3
    assert np.abs(cover - expected).max() < 0.02  # the strips' own error
    assert cover.sum() == pytest.approx(expected.sum(), rel=1e-3)


@pytest.mark.parametrize("frame", [3, 6, 10])
def test_drawn_opening_agrees_with_the_polygon(scene, frame):
    mouth, motion = scene
    camera = Camera()
    # skin of one colour in even light; the line where lips meet would be dark too
    skin = Skin(lip_lines=0, texture=0, seam=0, colour=(220, 180, 170), lip_colour=(220, 180, 170))
    look = Look(skin=skin, light=Light(strength=0, ambient=1), inside=EMPTY, sensor=CLEAN)
    picture = draw_mouth(mouth, motion.positions[frame], camera, look).astype(int)
    columns = np.arange(camera.width_px)
    top, low = polygon_of(mouth, motion.positions[frame], camera, columns)
    assert (low - top).max() > 5
    rows = np.arange(camera.height_px)[:, None]
    inside = (rows > top) & (rows < low)
    light = to_linear(picture[..., 0])
    dark = light < 0.5 * np.median(light)
    dark[:200] = False  # nostrils
    assert (inside & dark).sum() / (inside | dark).sum() > 0.975  # the thinnest is 4 px high


def test_height_of_the_opening_to_a_hundredth_of_a_pixel(scene):
    mouth, motion = scene
    camera = Camera()
    stage = Stage(mouth, camera, PLAIN)
    for frame in (2, 5, 9):
        top, low = polygon_of(mouth, motion.positions[frame], camera, (np.arange(64) + 0.5) / 64 + 255 - 0.5)
        height = stage.cover(motion.positions[frame])[:, 255].sum()
        assert height == pytest.approx((low - top).mean(), abs=0.01)


def test_cover_turns_with_the_head(scene):
    mouth, motion = scene
    camera = Camera(width_px=96, height_px=96, view_m=0.08, centre_y_m=0.0)
    upright = Stage(mouth, camera, PLAIN).cover(motion.positions[8])
    for roll, turns in ((180, 2), (90, -1), (-90, 1)):
        turned = Stage(mouth, replace(camera, roll_deg=roll), PLAIN).cover(motion.positions[8])
        assert np.abs(turned - np.rot90(upright, turns)).max() < 1e-4
    slanted = Stage(mouth, replace(camera, roll_deg=33), PLAIN).cover(motion.positions[8])
    assert slanted.sum() == pytest.approx(upright.sum(), rel=1e-4)


def test_closed_lips_look_closed(scene):
    mouth, motion = scene
    assert not Stage(mouth, SMALL, PLAIN).cover(motion.nodes).any()
    # in one colour and even light nothing shows where they meet
    skin = Skin(
        lip_lines=0, texture=0, seam=0, wetness=0, nose=False, colour=(220, 180, 170), lip_colour=(220, 180, 170)
    )
    look = Look(skin=skin, light=Light(strength=0, ambient=1), inside=EMPTY, sensor=CLEAN)
    picture = draw_mouth(mouth, motion.nodes, Camera(), look).astype(int)
    assert picture[..., 0].min() > 100


def test_drawn_hole_is_what_the_truth_calls_open():
    mouth, motion = moved_mouth("low", times=11, drop_m=0.02, patch=(-0.004, 0.006))
    camera = Camera(yaw_deg=10, roll_deg=20)
    found = truth(motion, mouth, camera)
    stage = Stage(mouth, camera, PLAIN)
    for frame in (3, 4, 5, 10):
        area = stage.cover(motion.positions[frame], motion.saliva.state[frame]).sum()
        assert area == pytest.approx(found.frames.total_area_px[frame], rel=1e-4) and area > 0


def test_saliva_hides_the_inside_where_it_holds(scene):
    mouth, motion = scene
    at = motion.nodes + 0.15 * (motion.positions[10] - motion.nodes)  # 4 mm open in the middle
    holds = np.full(len(mouth.saliva), BROKEN)
    holds[: len(holds) // 2] = INTACT
    stage = Stage(mouth, SMALL, Look(skin=Skin(film=1.0), inside=EMPTY, sensor=CLEAN))
    cover, whole = stage.cover(at, holds), stage.cover(at)
    middle = SMALL.width_px // 2
    step = round(mouth.width_m / len(mouth.saliva) * SMALL.px_per_m) + 1  # of one column of the mesh
    assert not cover[:, : middle - 1].any()
    assert cover[:, middle + step :] == pytest.approx(whole[:, middle + step :])
    clear = Stage(mouth, SMALL, Look(skin=Skin(film=0.0), inside=EMPTY, sensor=CLEAN))
    row = int(whole[:, middle].argmax())
    assert whole[row, middle - 8] > 0.99 and whole[row, middle + 8] > 0.99
    drawn, seen = (one.draw(at, state=holds)[row].max(axis=1) for one in (stage, clear))
    assert drawn[middle + 8] == seen[middle + 8] == seen[middle - 8] == 0
    assert drawn[middle - 8] > 30


def test_smeared_opening_is_the_mean_over_the_shutter(scene):
    mouth, motion = scene
    look = Look(skin=Skin(texture=0, lip_lines=0), inside=EMPTY, sensor=replace(CLEAN, samples=16))
    stage = Stage(mouth, SMALL, look)
    begin, end = motion.positions[4], motion.positions[10]
    canvas_row = stage.draw((begin + end) / 2, during=(begin, end)).astype(int)
    sharp = stage.draw((begin + end) / 2).astype(int)
    covers = [stage.cover(begin + s * (end - begin)) for s in (np.arange(64) + 0.5) / 64]
    mean = np.mean(covers, axis=0)
    # where it is open half of the time, the light is about half of the lips'
    column = SMALL.width_px // 2
    rows = np.flatnonzero((mean[:, column] > 0.45) & (mean[:, column] < 0.55))
    lips = np.percentile(to_linear(sharp[:, column, 0])[covers[-1][:, column] == 0], 50)
    assert len(rows)
    assert np.allclose(to_linear(canvas_row[rows, column, 0]), 0.5 * lips, atol=0.25 * lips)
    assert (stage.draw(begin, during=(begin, begin)) == stage.draw(begin)).all()


def test_any_frame_alone_is_the_frame_of_the_clip(scene):
    mouth, motion = scene
    look = Look(seed=3)
    jaw = lambda time: (10 * time, (0.025, -0.095))  # noqa: E731
    clips = [list(render(motion, mouth, SMALL, look, frame_rate=6, jaw=jaw, threads=n)) for n in (1, 2)]
    assert len(clips[0]) == 7 and np.array_equal(*clips)
    assert clips[0][0].shape == (96, 128, 3) and clips[0][0].dtype == np.uint8
    again = list(render(motion, mouth, SMALL, look, times_s=motion.time_s[:1], frame_rate=6, jaw=jaw))
    assert (again[0] == clips[0][0]).all()
    other = next(render(motion, mouth, SMALL, replace(look, seed=4), frame_rate=6))
    assert (other != clips[0][0]).mean() > 0.3


def test_light_from_the_other_side_mirrors_the_picture(scene):
    mouth, motion = scene
    even = Skin(texture=0, lip_lines=0, nose=True)
    inside = replace(Inside(), tongue=False, upper_teeth=False, lower_teeth=False)
    pictures = []
    for side in (-1, 1):
        look = Look(skin=even, light=Light(direction=(side * 0.6, 0.4, 0.7)), inside=inside, sensor=CLEAN)
        pictures.append(draw_mouth(mouth, motion.positions[6], SMALL, look).astype(int))
    assert pictures[0][:, :30].mean() > pictures[0][:, -30:].mean() + 15
    difference = np.abs(pictures[0] - pictures[1][:, ::-1])
    assert np.percentile(difference, 99) <= 3  # the red border alone wanders


def test_tones_go_from_light_to_dark():
    bright = [to_srgb(Skin(tone=name).linear).mean() for name in TONES]
    assert (np.diff(bright) < -10).all() and bright[0] > 200 and bright[-1] < 70
    for name in TONES:
        skin, lips = Skin(tone=name).linear, Skin(tone=name).lip_linear
        # lips are redder than the skin around them, for every tone
        assert lips[0] / lips[1] > 1.2 * skin[0] / skin[1]
    assert to_srgb(Skin(colour=(10, 200, 30)).linear) == pytest.approx((10, 200, 30))


def test_noise_has_the_spread_asked_for(scene):
    mouth, motion = scene
    flat = Look(
        skin=Skin(texture=0, lip_lines=0, sheen=0, nose=False),
        light=Light(strength=0, ambient=1, ambient_colour=(255, 255, 255)),
        sensor=Sensor(blur_px=0, noise=0.05, read_noise=0.01, shutter=0),
    )
    stage = Stage(mouth, SMALL, flat)
    clean = to_linear(Stage(mouth, SMALL, replace(flat, sensor=CLEAN)).draw(motion.nodes))
    noisy = np.array([to_linear(stage.draw(motion.nodes, frame=k)) for k in range(12)])
    where = (clean[..., 1] > 0.2) & (clean.max(axis=2) < 0.8)
    spread = noisy.std(axis=0, ddof=1)[where]
    expected = np.sqrt(0.05**2 * clean[where] + 0.01**2)
    assert where.sum() > 2000
    assert np.sqrt((spread**2).mean()) == pytest.approx(np.sqrt((expected**2).mean()), rel=0.02)
    assert np.abs((noisy.mean(axis=0) - clean)[where].mean()) < 1e-3
    # neighbours and colours know nothing of each other
    rest = (noisy - noisy.mean(axis=0))[:, where]
    assert abs(np.corrcoef(rest[..., 0].ravel(), rest[..., 1].ravel())[0, 1]) < 0.02
    assert abs(np.corrcoef(rest[:, 1:, 0].ravel(), rest[:, :-1, 0].ravel())[0, 1]) < 0.02


def test_camera_effects_do_what_they_say(scene):
    mouth, motion = scene
    plain = to_linear(draw_mouth(mouth, motion.nodes, SMALL, PLAIN))

    def seen(**settings):
        return to_linear(draw_mouth(mouth, motion.nodes, SMALL, Look(sensor=replace(CLEAN, **settings))))

    middle = np.s_[40:50, 50:70]
    assert seen(exposure=0.5)[middle].mean() == pytest.approx(0.5 * plain[middle].mean(), rel=0.01)
    blue = seen(cast=(1, 1, 0.25))[middle].mean(axis=(0, 1)) / plain[middle].mean(axis=(0, 1))
    assert blue == pytest.approx([1, 1, 0.25], rel=0.02)
    corner = seen(vignette=0.8)[:4, :4].mean() / plain[:4, :4].mean()
    assert corner == pytest.approx(1 - 0.8 * (1 + 0.75**2) / 2, abs=0.05)
    sharpness = [np.abs(np.diff(seen(blur_px=b)[..., 0], axis=0)).mean() for b in (0, 1, 3)]
    assert sharpness[0] > 1.1 * sharpness[1] > 1.1 * sharpness[2]
    few = draw_mouth(mouth, motion.nodes, SMALL, Look(sensor=replace(CLEAN, jpeg=5))).astype(int)
    assert 2 < np.abs(few - to_srgb(plain)).mean() < 30


def test_lower_teeth_move_with_the_jaw(scene):
    mouth, motion = scene
    camera = Camera(width_px=256, height_px=256, view_m=0.06)
    teeth = Look(inside=replace(EMPTY, lower_teeth=True), sensor=CLEAN)
    bright = []
    for jaw in (None, (6.0, (0.025, -0.095))):
        picture = draw_mouth(mouth, motion.positions[10], camera, teeth, jaw=jaw)[..., 2]
        column = picture[:, 131]  # beside the gap between the middle teeth
        cover = Stage(mouth, camera, teeth).cover(motion.positions[10])[:, 131] > 0.99
        bright.append(np.flatnonzero(cover & (column > 90)).min())
    sunk = turned_jaw(6.0) @ [0, -0.0022, -0.010, 1]
    where = camera.project(np.array([[0, -0.0022, -0.010], sunk[:3]]))
    assert bright[1] - bright[0] == pytest.approx(where[1, 0] - where[0, 0], abs=1.5)
    # teeth of the upper row stay
    upper = Look(inside=replace(EMPTY, upper_teeth=True), sensor=CLEAN)
    a, b = (draw_mouth(mouth, motion.positions[10], camera, upper, jaw=j) for j in (None, (6.0, (0.025, -0.095))))
    assert (a == b).all()


def test_jaw_matrices():
    assert (jaw_matrix(None) == np.eye(4)).all()
    turn = turned_jaw(12.0, (0.02, -0.09))
    assert turn @ [0.01, 0.02, -0.09, 1] == pytest.approx([0.01, 0.02, -0.09, 1])  # the joint stays
    assert (turn @ [0, -0.04, 0, 1])[1] < -0.05  # the chin sinks
    with pytest.raises(InputError, match="stretches or mirrors"):
        jaw_matrix(np.diag([1.0, -1.0, 1.0, 1.0]))
    with pytest.raises(InputError, match=r"got shape \(3, 3\)"):
        jaw_matrix(np.eye(3))


def test_stress_shows_numbers_as_colours(scene):
    mouth, motion = scene
    right = np.where(mouth.nodes[:, 0] > 0, 1.0, 0.0)
    picture = draw_mouth(mouth, motion.nodes, SMALL, mode="stress", scalars=right, top=1.0).astype(int)
    low, high = picture[60, 20], picture[60, -20]
    assert high[0] > high[2] + 50 and low[2] > low[0]  # red is much, blue is little
    frames = list(render(motion, mouth, SMALL, mode="stress", frame_rate=2))
    assert len(frames) == 3 and (frames[0] != frames[2]).mean() > 0.2
    by_element = np.tile(np.linspace(0, 1, len(mouth.elements)), (len(motion.time_s), 1))
    assert next(render(motion, mouth, SMALL, mode="stress", scalars=by_element)).any()


def test_wireframe_draws_the_edges_of_the_mesh(scene):
    mouth, motion = scene
    camera = Camera(width_px=400, height_px=400)
    picture = draw_mouth(mouth, motion.positions[6], camera, mode="wireframe")
    place = np.rint(camera.project(motion.positions[6][np.unique(mouth.outer)])).astype(int)
    place = place[((place >= 0) & (place < 400)).all(axis=1)]
    assert (picture[place[:, 0], place[:, 1]].max(axis=1) > 60).mean() > 0.95
    assert (picture.max(axis=2) < 30).mean() > 0.3


@pytest.mark.parametrize("size", [(160, 120), (64, 64), (97, 65)])
@pytest.mark.parametrize("resolution", ["low", pytest.param("high", marks=pytest.mark.slow)])
def test_any_size_and_resolution(size, resolution):
    mouth, motion = moved_mouth(resolution, times=3)
    look = Look(Skin(tone=0.5, stubble=0.5, freckles=0.5), sensor=Sensor(h264=30))
    frames = list(render(motion, mouth, Camera(*size), look, frame_rate=Fraction(4)))
    assert len(frames) == 5 and all(f.shape == (*size[::-1], 3) for f in frames)
    assert frames[0].std() > 5


def test_bad_input(scene):
    mouth, motion = scene
    with pytest.raises(InputError, match="did you mean 'stress'"):
        render(motion, mouth, mode="stres")
    with pytest.raises(InputError, match="from 0 to 1 s, the times of the motion, got 0 to 2 s"):
        render(motion, mouth, times_s=[0, 2])
    with pytest.raises(InputError, match="this mouth's 1888 nodes"):
        draw_mouth(mouth, motion.nodes[:-1])
    with pytest.raises(InputError, match="NaN"):
        draw_mouth(mouth, np.full_like(motion.nodes, np.nan))
    with pytest.raises(InputError, match="got shape \\(2, 5\\)"):
        render(motion, mouth, mode="stress", scalars=np.zeros((2, 5)))
    with pytest.raises(InputError, match="above 0 frames per second"):
        render(motion, mouth, frame_rate=0)
    with pytest.raises(InputError, match="one state for each of 30"):
        draw_mouth(mouth, motion.nodes, SMALL, state=np.zeros(3))
