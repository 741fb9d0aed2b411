from dataclasses import replace

import numpy as np
import pytest

from lipmetrics.artificial import Shape, lip_curves
from lipmetrics.relief import Light, Relief, face_height, head_height, shading

PX = 80.0
ROWS, COLS = (np.indices((101, 121)) - np.array([50, 60])[:, None, None]) / PX  # y and x, mouth units
SMOOTH, NO_LIPS = np.zeros((2, 101, 121)), np.zeros((101, 121))
LAMP = Light(direction=(0, 0, 1), sky=0.0, scatter=0.0, hardness=0.0, skin_shine=(0, 1), lip_shine=(0, 1))


def lit(light, z):
    return shading(light, z.astype(np.float32), PX, NO_LIPS, SMOOTH)[0][..., 1]


@pytest.mark.parametrize("slope", [0.0, 0.5, -1.0])
def test_a_plane_is_lit_by_the_cosine_of_the_angle_to_the_lamp(slope):
    toward = np.array([0.6, 0.0, 0.8])
    normal = np.array([-slope, 0, 1]) / np.hypot(slope, 1)
    seen = lit(replace(LAMP, direction=tuple(toward)), slope * COLS)
    assert seen[5:-5, 5:-5] == pytest.approx(max(0.0, float(normal @ toward)), abs=1e-4)


def test_scattered_light_reaches_into_the_shade_red_farthest():
    away = -1.0 * COLS  # turned from a lamp on the left
    light = replace(LAMP, direction=(-1.0, 0, 0.6), scatter=0.6)
    red, green, blue = shading(light, away.astype(np.float32), PX, NO_LIPS, SMOOTH)[0][50, 60]
    assert lit(replace(light, scatter=0.0), away)[50, 60] == 0
    assert red > green > blue >= 0


@pytest.mark.parametrize("side", [-1, 1])
def test_a_ridge_casts_its_shadow_away_from_the_lamp(side):
    ridge = 0.3 * np.exp(-((COLS / 0.05) ** 2))
    seen = lit(replace(LAMP, direction=(side * 0.8, 0, 0.6), hardness=1.0), ridge)
    column = 60 - side * 20  # 0.25 mouth widths behind the ridge, which reaches 0.4
    assert seen[50, column] < 0.1
    assert seen[50, 60 + side * 20] == pytest.approx(0.6, abs=0.02)
    assert lit(replace(LAMP, direction=(side * 0.8, 0, 0.6)), ridge)[50, column] == pytest.approx(0.6, abs=0.02)


def test_hollows_see_less_sky():
    pit = -0.2 * np.exp(-(COLS**2 + ROWS**2) / 0.1**2)
    sky = replace(LAMP, sky=1.0)
    assert lit(sky, pit)[50, 60] < 0.8 * lit(sky, pit)[50, 5]
    assert lit(replace(sky, hollow=0.0), pit)[50, 60] == pytest.approx(lit(sky, pit)[50, 5], rel=0.02)


def test_lips_have_highlights_of_their_own():
    light = replace(LAMP, lip_shine=(0.5, 20.0), skin_shine=(0.1, 5.0))
    flat = np.zeros_like(NO_LIPS, np.float32)
    for lips, strength in ((NO_LIPS, 0.1), (NO_LIPS + 1, 0.5)):
        assert shading(light, flat, PX, lips, SMOOTH)[1] == pytest.approx(strength)


def height_along(row_y, shape, relief, x=0.0):
    y = np.asarray(row_y, float)
    curves = [np.full(y.shape, c[0]) for c in lip_curves(shape, np.array([x]))]
    head = head_height(relief, np.full(y.shape, x), y, -0.6, 0.7, 1.1)
    return face_height(relief, head, np.full(y.shape, x), y, curves, shape.width / 2, -0.6, 0.0) - head


def test_lips_stand_out_and_meet_in_a_groove():
    shape = Shape(upper=0.12, lower=0.16, tubercle=0.0)
    relief = Relief(philtrum=0.0, sulcus=(0.0, 0.1), chin=(0.0, 0.4))
    y = np.linspace(-0.4, 0.5, 901)
    z = height_along(y, shape, relief)
    upper, lower = z[(y < 0) & (y > -0.12)].max(), z[(y > 0) & (y < 0.16)].max()
    assert upper == pytest.approx(relief.upper_lip, rel=0.02)
    assert lower == pytest.approx(relief.lower_lip, rel=0.02)
    assert z[(y > -0.02) & (y < 0.02)].min() < 0.5 * min(upper, lower)
    assert abs(z[0]) < 0.2 * upper


def test_the_nose_stands_out_above_its_base_only():
    y = np.array([-1.0, -0.3])
    flat, nosed = (head_height(Relief(nose=nose, wings=0.0), 0.0 * y, y, -0.6, 0.7, 1.1) for nose in (0.0, 0.4))
    assert nosed - flat == pytest.approx([0.4 * (1 - 0.45 * 0.25 / 0.9), 0.0], abs=1e-6)
