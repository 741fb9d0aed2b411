"""Light and shade painted onto a flat drawing of a face, for `lipmetrics.artificial`.

Where `lipmetrics.relief` follows a surface and a lamp, this follows what an eye remembers of faces: a shadow under
the lower lip, a gloss on it, a dark philtrum, folds. Neither is like all photographs; a classifier that has learnt from
both leans on what they share. Lengths are in mouth units, x to the right, y downwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Paint:
    """Strengths of the painted shades, and where they lie; all strengths 0 paint nothing."""

    light: tuple[float, float] = (0.0, 0.0)  # brightness change per mouth width along x and y
    below_lip: tuple[float, float, float] = (
        0.0,
        0.06,
        0.45,
    )  # shadow under the lower lip: strength, height, half length
    chin_light: tuple[float, float] = (0.0, 0.35)  # the chin catches light: strength, distance below the lip
    philtrum: tuple[float, float] = (0.0, 0.2)  # soft shadow above the upper lip: strength, half width
    folds: tuple[float, float] = (0.0, 0.06)  # from nose to mouth: strength, width
    nose: tuple[float, float] = (0.0, 0.0)  # shine of its tip, darkness of its creases
    nose_shadow: tuple[float, float, float] = (0.0, 0.25, 0.0)  # on the upper lip: strength, length, sideways
    shadow_red: float = 0.0  # skin is redder in the shade: light scatters inside it
    upper_dark: float = 0.0
    bulge: tuple[float, float] = (0.0, 0.3)  # the lower lip is lighter in its middle: strength, half length
    seam_shade: float = 0.0  # the upper lip darkens towards the seam
    gloss: tuple[float, float, float, float] = (0.0, 0.1, 0.05, 0.4)  # highlights: strength, length, height, place
    streaks: float = 0.6  # how far the lip's creases break the highlights up


def random_paint(rng: np.random.Generator) -> Paint:
    """Shades over a range meant to cover real recordings."""
    gloss = (rng.uniform(0.05, 0.6), rng.uniform(0.03, 0.25), rng.uniform(0.01, 0.07), rng.uniform(0.1, 0.65))
    return Paint(
        light=(rng.normal(0, 0.15), rng.normal(-0.05, 0.12)),
        below_lip=(rng.uniform(0, 0.65), rng.uniform(0.04, 0.16), rng.uniform(0.25, 0.7)),
        chin_light=(rng.uniform(0, 0.4), rng.uniform(0.15, 0.5)),
        philtrum=(rng.uniform(0, 0.35), rng.uniform(0.08, 0.45)),
        folds=(rng.uniform(-0.1, 0.35), rng.uniform(0.03, 0.15)),
        nose=(rng.uniform(-0.1, 0.4), rng.uniform(0, 0.9)),
        nose_shadow=(rng.uniform(0.05, 0.45), rng.uniform(0.1, 0.5), rng.normal(0, 0.4))
        if rng.random() < 0.4
        else (0.0, 0.25, 0.0),
        shadow_red=rng.uniform(-0.05, 0.4),
        upper_dark=rng.uniform(-0.1, 0.3),
        bulge=(rng.uniform(0, 0.5), rng.uniform(0.12, 0.5)),
        seam_shade=rng.uniform(-0.1, 0.35),
        gloss=gloss if rng.random() < 0.7 else (0.0, 0.1, 0.05, 0.4),
        streaks=rng.uniform(0.2, 1.3),
    )


def _ramp(distance, soft: float):
    """0 to 1 where `distance` rises through 0, over about `soft`."""
    return np.clip(distance / soft + 0.5, 0, 1)


def skin_factor(paint: Paint, x, y, ou, ol, nose_y: float, nose_width: float) -> np.ndarray:
    """What the shades make of the skin's colour: factors (H, W, 3). ou, ol : outer lip curves at x."""
    aside = np.abs(x)
    strength, width = paint.folds
    fold_x = 0.40 + 0.34 * np.clip(y + 0.6, 0, 1.2) ** 0.7 + 0.03 * np.sin(5 * y)
    shade = strength * np.exp(-(((aside - fold_x) / width) ** 2)) * _ramp(y + 0.6, 0.3) * _ramp(0.4 - y, 0.4)
    shade = shade + 0.4 * strength * np.exp(-((x / 0.05) ** 2)) * _ramp(y - nose_y, 0.1) * (y < 0)
    gap, below = np.clip(y - ol, 0, None), y > ol
    strength, height, length = paint.below_lip
    under = np.exp(-(((gap - 0.6 * height) / height) ** 2)) * np.clip(1 - (x / length) ** 2, 0, 1)
    shade += strength * under * below
    strength, distance = paint.chin_light
    shade -= strength * np.exp(-(((gap - distance) / 0.14) ** 2) - (x / 0.3) ** 2) * below
    strength, breadth = paint.philtrum
    shade += strength * np.exp(-((x / breadth) ** 2)) * _ramp(y - nose_y - 0.05, 0.15) * (y < ou)
    strength, length, sideways = paint.nose_shadow
    drop = y - nose_y
    cast = np.exp(-(((x - sideways * drop) / (0.4 * nose_width)) ** 4)) * _ramp(drop, 0.05) * _ramp(length - drop, 0.25)
    shade += strength * cast
    shine, dark = paint.nose
    tip = np.exp(-((x / 0.16) ** 2) - ((drop + 0.16) / 0.12) ** 2)
    wing = np.hypot((aside - 0.3 * nose_width) / (0.2 * nose_width), (drop + 0.1) / 0.15)
    crease = np.exp(-(((wing - 1) / 0.18) ** 2)) * (aside > 0.3 * nose_width) * (drop < 0.1)
    sides = np.exp(-(((aside - 0.32 * nose_width) / 0.1) ** 2)) * _ramp(-drop, 0.1)
    shade -= shine * tip - 0.6 * dark * crease - 0.3 * dark * sides
    lit = np.clip(1 - shade, 0.05, 1.4)[..., None]
    return lit ** np.array([1, 1 + paint.shadow_red, 1 + 1.3 * paint.shadow_red], np.float32)


def lip_factor(paint: Paint, x, y, curves, upper) -> np.ndarray:
    """What the shades make of the lips' colour: factors (H, W). curves : the four lip curves at x; upper : 1 above the
    seam, 0 below."""
    ou, iu, il, ol = curves
    up = np.clip((y - ou) / np.maximum(iu - ou, 1e-3), 0, 1)
    low = np.clip((y - il) / np.maximum(ol - il, 1e-3), 0, 1)
    strength, length = paint.bulge
    round_off = 1 - 0.18 * (1 - low) ** 4 - 0.2 * low**4 if strength else 1.0
    of_lower = round_off * (1 + strength * np.exp(-((x / length) ** 2) - ((low - 0.4) / 0.3) ** 2))
    return np.where(upper > 0.5, (1 - paint.upper_dark) * (1 - paint.seam_shade * up**3), of_lower)


def gloss_share(paint: Paint, x, y, curves, upper, broken) -> np.ndarray:
    """How much of the lips' colour the highlights cover: (H, W), 0 to 1. broken : (H, W) about 0.6, the creases."""
    strength, length, height, place = paint.gloss
    ou, iu, il, ol = curves
    up = np.clip((y - ou) / np.maximum(iu - ou, 1e-3), 0, 1)
    low = np.clip((y - il) / np.maximum(ol - il, 1e-3), 0, 1)
    patch = np.exp(-(((x - 0.05) / (2 * length)) ** 4) - ((low - place) / (8 * height)) ** 2) * (upper < 0.5)
    patch += 0.5 * np.exp(-(((np.abs(x) - 0.12) / length) ** 2) - ((up - 0.35) / (6 * height)) ** 2) * (upper > 0.5)
    return np.clip(strength * patch * np.clip(1 + paint.streaks * (broken - 1), 0, 1), 0, 1)


def light_factor(paint: Paint, x, y) -> np.ndarray:
    """Brightness (H, W) of light that falls off across the face."""
    return np.clip(1 + paint.light[0] * x + paint.light[1] * y, 0.15, 2)
