"""The lower face as a surface, and the light on it, for `lipmetrics.artificial`.

The surface is a height towards the camera over the face's plane, in mouth units (mouth width 1), x to the right and y
downwards. Lips, nose, cheeks and chin are sums of smooth bumps about the lip curves. Light is one lamp and a sky:
Lambert's law wrapped around the edge of the shade, more so in red, which skin scatters farthest; shadows cast along
the lamp's direction; hollows see less sky; and Blinn-Phong highlights.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

_SHADOW_STEPS = (0.025, 0.05, 0.08, 0.12, 0.17, 0.23, 0.3, 0.4, 0.52, 0.68, 0.9)  # mouth units towards the lamp
_SCATTER = np.array([1.0, 0.5, 0.35])  # how far each channel reaches into the shade, against red
_SEAM = 0.12  # depth of the groove where the lips meet, share of their heights
_BORDER_UPPER, _BORDER_LOWER = 0.6, 0.4  # height of the lips' outer borders, share of their own


@dataclass(frozen=True)
class Relief:
    """Heights of the parts of a lower face, mouth units."""

    curve: float = 0.28  # the face falls away sideways
    muzzle: float = 0.10  # the jaws push the mouth forward
    upper_lip: float = 0.09
    lower_lip: float = 0.11
    sulcus: tuple[float, float] = (0.05, 0.13)  # hollow under the lower lip: depth, distance from it
    chin: tuple[float, float] = (0.10, 0.45)  # height, distance from the lower lip
    philtrum: float = 0.02
    nose: float = 0.35
    nose_round: float = 0.2  # over how much its underside rises
    wings: float = 0.16
    cheek: tuple[float, float] = (0.05, 0.25)  # step at the fold from nose to mouth: height, softness
    fold: tuple[float, float] = (0.40, 0.34)  # where it runs: from the middle at the nose, widening downwards
    dimple: float = 0.03  # at the corners
    lines: float = 0.3  # roughness of the lips' creases, slope
    rough: float = 0.05  # of the skin, slope


@dataclass(frozen=True)
class Light:
    """A lamp and a sky.

    direction : (x, y, z) towards the lamp; y is negative above, z towards the camera
    sky : share of the light that comes from all around
    lamp_colour, sky_colour : RGB factors
    scatter : how far red light reaches into the shade
    hardness : of cast shadows, 0 for none
    hollow : how much darker hollows are
    skin_shine, lip_shine : strength and exponent of the highlights
    """

    direction: tuple[float, float, float] = (0.1, -0.45, 0.9)
    sky: float = 0.5
    lamp_colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    sky_colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    scatter: float = 0.3
    hardness: float = 0.6
    hollow: float = 1.0
    skin_shine: tuple[float, float] = (0.05, 10.0)
    lip_shine: tuple[float, float] = (0.15, 25.0)


def _bump(value, centre: float, spread: float):
    return np.exp(-(((value - centre) / spread) ** 2))


def _smooth(value):
    """0 below 0, 1 above 1, without a kink between."""
    t = np.clip(value, 0, 1)
    return t * t * (3 - 2 * t)


def _hill(value, top: float, left: float, right: float):
    """1 at `top`, `left` at 0 and `right` at 1, a parabola on each side."""
    down = np.where(
        value < top, (1 - left) * ((value - top) / top) ** 2, (1 - right) * ((value - top) / (1 - top)) ** 2
    )
    return 1 - down


def head_height(relief: Relief, x, y, nose_y: float, nose_width: float, chin_y: float):
    """The face without lips and folds: what turns a picture of it when the head turns. Any shape, mouth units."""
    z = -relief.curve * np.abs(x) ** 2.2 - 0.1 * np.clip(y - 0.1, 0, None) ** 2
    z = z + relief.muzzle * np.exp(-((x / 0.6) ** 2) - ((y - 0.05) / 0.5) ** 2)
    up = nose_y - y
    ridge = _smooth(up / relief.nose_round + 0.6) * (1 - 0.45 * np.clip((up - 0.15) / 0.9, 0, 1))
    z = z + relief.nose * ridge * np.exp(-((x / (0.34 * nose_width)) ** 2))
    wing = np.exp(-(((np.abs(x) - 0.36 * nose_width) / (0.17 * nose_width)) ** 2)) * _bump(up, 0.1, 0.12)
    return z + relief.wings * wing - 0.9 * np.clip(y - chin_y + 0.15, 0, None) ** 1.5


def face_height(relief: Relief, head, x, y, curves, half: float, nose_y: float, end_y: float):
    """`head` with lips, folds and chin. curves : the four lip curves at x, as `artificial.lip_curves` gives them."""
    ou, iu, il, ol = curves
    across = np.clip(1 - (x / half) ** 2, 0, None) ** 0.6
    up, lo = relief.upper_lip, relief.lower_lip
    seam = -_SEAM * (up + lo)
    t = np.clip((y - ou) / np.maximum(iu - ou, 1e-3), 0, 1)
    s = np.clip((y - il) / np.maximum(ol - il, 1e-3), 0, 1)
    upper = seam + (up - seam) * _hill(t, 0.35, _BORDER_UPPER, 0.0)
    lower = seam + (lo - seam) * _hill(s, 0.55, 0.0, _BORDER_LOWER)
    above, below = np.clip(ou - y, 0, None), np.clip(y - ol, 0, None)
    upper, lower = upper * np.exp(-above / 0.2), lower * np.exp(-below / 0.14)
    lips = np.where(y < iu, upper, np.where(y > il, lower, seam))
    z = head + across * lips
    depth, distance = relief.sulcus
    z = z - depth * _bump(below, distance, 0.09) * np.exp(-((x / 0.42) ** 2)) * (y > ol)
    height, distance = relief.chin
    z = z + height * _bump(y - ol, distance, 0.24) * np.exp(-((x / 0.38) ** 2))
    groove = np.exp(-((x / 0.075) ** 2)) - 0.7 * np.exp(-(((np.abs(x) - 0.17) / 0.09) ** 2))
    z = z - relief.philtrum * groove * _smooth((y - nose_y) / 0.15) * np.exp(-np.clip(y - ou, 0, None) / 0.03)
    height, soft = relief.cheek
    start, widening = relief.fold
    fold_x = start + widening * np.clip(y - nose_y + 0.1, 0, 1.4) ** 0.7
    reach = _smooth((y - nose_y + 0.35) / 0.3) * _smooth((end_y + 0.4 - y) / 0.6)
    z = z + height * _smooth((np.abs(x) - fold_x) / soft + 0.5) * reach
    return z - relief.dimple * np.exp(-((np.abs(x) - half - 0.02) ** 2 + (y - end_y) ** 2) / 0.08**2)


def shading(
    light: Light, z: np.ndarray, px_per_mouth: float, lip: np.ndarray, rough: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """How much light a surface sends to the camera: factors (H, W, 3) for its colour, and highlights (H, W, 3).

    z : (H, W) float32, towards the camera, mouth units
    lip : (H, W), 0 to 1, where the lips' highlights apply instead of the skin's
    rough : (2, H, W) slopes along x and y added for creases and pores
    """
    z = z.astype(np.float32)
    dx = cv2.Sobel(z, cv2.CV_32F, 1, 0, ksize=3, scale=px_per_mouth / 8)
    dy = cv2.Sobel(z, cv2.CV_32F, 0, 1, ksize=3, scale=px_per_mouth / 8)
    normal = np.stack([-dx - rough[0], -dy - rough[1], np.ones_like(z)])
    normal /= np.sqrt((normal**2).sum(axis=0))
    lamp = np.asarray(light.direction, np.float32) / np.linalg.norm(light.direction)
    facing = np.tensordot(lamp, normal, 1)
    lit = _cast(light, z, px_per_mouth, lamp)
    hollow = np.zeros_like(z)
    for spread, share in ((0.05, 1.5), (0.15, 1.2), (0.4, 0.7)):
        hollow += share * np.clip(cv2.GaussianBlur(z, (0, 0), max(spread * px_per_mouth, 0.5)) - z, 0, None)
    sky = np.exp(-2.5 * light.hollow * hollow) * (0.85 - 0.15 * normal[1])
    wrap = light.scatter * _SCATTER
    diffuse = np.clip((facing[..., None] + wrap) / (1 + wrap), 0, None) * lit[..., None] ** (
        1 - 0.5 * _SCATTER * light.scatter
    )
    colour = (
        light.sky * np.array(light.sky_colour) * sky[..., None]
        + (1 - light.sky) * np.array(light.lamp_colour) * diffuse
    )
    half = lamp + np.array([0, 0, 1], np.float32)
    mirror = np.clip(np.tensordot(half / np.linalg.norm(half), normal, 1), 0, 1)
    (skin, skin_n), (lips, lips_n) = light.skin_shine, light.lip_shine
    shine = (1 - lip) * skin * mirror**skin_n + lip * lips * mirror**lips_n
    return colour.astype(np.float32), (shine * lit)[..., None] * np.array(light.lamp_colour, np.float32)


def _cast(light: Light, z: np.ndarray, px_per_mouth: float, lamp: np.ndarray) -> np.ndarray:
    """1 where the lamp is seen, towards 0 where the surface itself stands before it."""
    aside = float(np.hypot(lamp[0], lamp[1]))
    if light.hardness <= 0 or aside < 0.05:
        return np.ones_like(z)
    step, climb = lamp[:2] / aside, float(lamp[2]) / aside
    shade = np.zeros_like(z)
    for far in _SHADOW_STEPS:
        move = np.array([[1, 0, far * px_per_mouth * step[0]], [0, 1, far * px_per_mouth * step[1]]], np.float32)
        there = cv2.warpAffine(
            z, move, z.shape[::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE
        )
        over = there - z - far * climb
        shade = np.maximum(shade, _smooth(over / (0.02 + 0.12 * far) + 0.3))
    return 1 - light.hardness * shade
