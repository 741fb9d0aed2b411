from dataclasses import replace

import numpy as np
import pytest

from lipmetrics.paint import Paint, gloss_share, light_factor, lip_factor, random_paint, skin_factor

Y, X = (np.indices((101, 121)) - np.array([50, 60])[:, None, None]) / 50.0  # mouth units
OU, SEAM, OL = np.full_like(X, -0.12), np.zeros_like(X), np.full_like(X, 0.16)
CURVES, UPPER = (OU, SEAM, SEAM, OL), (Y < 0).astype(float)


def skin(paint):
    return skin_factor(paint, X, Y, OU, OL, -0.6, 0.7)


def at(factors, x, y):
    return factors[round(50 + 50 * y), round(60 + 50 * x)]


def test_no_paint_changes_nothing():
    assert skin(Paint()) == pytest.approx(1)
    assert lip_factor(Paint(), X, Y, CURVES, UPPER) == pytest.approx(1)
    assert gloss_share(Paint(), X, Y, CURVES, UPPER, np.full_like(X, 0.6)) == pytest.approx(0)
    assert light_factor(Paint(), X, Y) == pytest.approx(1)


@pytest.mark.parametrize(
    ("paint", "darkest", "untouched"),
    [
        (Paint(below_lip=(0.5, 0.06, 0.45)), (0.0, 0.2), (0.0, -0.3)),
        (Paint(philtrum=(0.3, 0.2)), (0.0, -0.3), (0.8, -0.3)),
        (Paint(folds=(0.3, 0.06)), (0.64, -0.1), (0.0, 0.4)),
        (Paint(nose_shadow=(0.4, 0.25, 0.0)), (0.0, -0.5), (0.0, 0.4)),
        (Paint(nose=(0.0, 0.5)), (0.34, -0.7), (0.0, 0.4)),
    ],
    ids=["below the lip", "philtrum", "fold", "nose's shadow", "nose's creases"],
)
def test_a_shade_lies_where_it_is_named(paint, darkest, untouched):
    factors = skin(paint)[..., 1]
    assert at(factors, *darkest) < 0.92
    assert at(factors, *untouched) == pytest.approx(1, abs=0.01)


def test_shade_is_redder_when_told():
    shaded = Paint(below_lip=(0.5, 0.06, 0.45), shadow_red=0.4)
    red, green, blue = at(skin(shaded), 0.0, 0.2)
    assert red > green > blue
    assert np.ptp(at(skin(replace(shaded, shadow_red=0.0)), 0.0, 0.2)) == pytest.approx(0, abs=1e-6)


def test_the_upper_lip_darkens_and_the_lower_one_bulges():
    factors = lip_factor(Paint(upper_dark=0.2, seam_shade=0.3, bulge=(0.4, 0.3)), X, Y, CURVES, UPPER)
    assert at(factors, 0, -0.02) < at(factors, 0, -0.1) < 0.81
    assert at(factors, 0, 0.06) > 1.3 > at(factors, 0.45, 0.06)


def test_gloss_stays_on_the_lips_and_light_falls_off_along_its_slope():
    broken = np.full_like(X, 1.0)
    share = gloss_share(Paint(gloss=(0.5, 0.1, 0.03, 0.4)), X, Y, CURVES, UPPER, broken)
    assert at(share, 0.05, 0.06) == pytest.approx(0.5, abs=0.02)
    assert at(share, 0.8, 0.06) < 0.01
    assert at(light_factor(Paint(light=(0.2, -0.1)), X, Y), 0.5, -0.3) == pytest.approx(1.13)


def test_random_paint_repeats_with_its_seed_and_varies():
    assert random_paint(np.random.default_rng(1)) == random_paint(np.random.default_rng(1))
    assert random_paint(np.random.default_rng(1)) != random_paint(np.random.default_rng(2))
