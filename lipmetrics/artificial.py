"""Drawn mouths at known positions: training pictures, test pictures and what `lipmetrics demo` rehearses with.

A mouth is drawn in mouth units: x to the right, y downwards, the resting mouth is 1 wide, its centre is (0, 0).
Everything that varies between people, light and cameras is a field of :class:`Face`; :func:`random_face` draws
one from a seeded generator over a range meant to cover real recordings (no value is fitted to any recording).
:func:`draw` returns the picture and, from the same curves, the exact share of every pixel that is lip or opening.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from lipmetrics.paint import Paint, gloss_share, light_factor, lip_factor, random_paint, skin_factor
from lipmetrics.relief import Light, Relief, face_height, head_height, shading


@dataclass(frozen=True)
class Shape:
    """The four lip curves, in mouth units (mouth width 1 at rest)."""

    width: float = 1.0  # corner to corner
    gap: tuple[float, float] = (0.0, 0.0)  # height of the opening above and below the seam line at its middle
    span: tuple[float, float] = (-0.9, 0.9)  # where the opening begins and ends, share of the half width
    side: float = 0.12  # how far the outer outline passes the end of the opening, share of the half width
    roundness: float = 0.8  # exponent of the opening's outline: 0.5 an ellipse, 1 a parabola, 1.5 pointed
    upper: float = 0.12  # lip heights
    lower: float = 0.16
    bow: float = 0.3  # depth of the cupid's bow, share of the upper lip
    smile: float = 0.05  # height of the corners above the middle
    skew: float = 0.0  # one corner higher
    tubercle: float = 0.02  # the seam dips in the middle
    wobble: tuple[float, ...] = (0.0, 0.0, 0.0)
    glued: tuple[tuple[float, float], ...] = ()  # parts of the lip line (share of half width) held together
    yaw: float = 0.0  # one half looks shorter


@dataclass(frozen=True)
class Face:
    """Everything that is drawn. Colours are RGB in 0..1 before light and camera."""

    shape: Shape = field(default_factory=Shape)
    skin: tuple[float, float, float] = (0.80, 0.62, 0.53)
    lip: tuple[float, float, float] = (0.66, 0.38, 0.37)
    lower_gain: float = 1.08
    lip_edge: float = 0.03  # softness of the outer lip border
    teeth: tuple[float, float, float] = (0.86, 0.83, 0.76)
    tongue: tuple[float, float, float] = (0.70, 0.36, 0.36)
    cavity: tuple[float, float, float] = (0.10, 0.04, 0.04)
    upper_teeth: float = 0.0  # how far each reaches into the opening, mouth units
    lower_teeth: float = 0.0
    tongue_height: float = 0.0
    gums: float = 0.0
    tooth_width: float = 0.11
    seam: tuple[float, float] = (0.5, 0.015)  # darkness and width of the closed lip line
    corner_dark: float = 0.3
    relief: Relief = field(default_factory=Relief)
    light: Light = field(default_factory=Light)
    paint: Paint = field(default_factory=Paint)
    turn: tuple[float, float] = (0.0, 0.0)  # of the head to its left and upwards, radians
    side_shadow: tuple[float, float, float] = (0.0, 0.0, 0.2)  # of something unseen: strength, place, softness
    upper_tint: float = 1.0  # upper lip colour against the lower's
    rim: tuple[float, float, float] = (1.0, 1.0, 0.02)  # wet inner edge: brightness, redness, width
    creases: float = 0.04
    lip_mottle: float = 0.04  # colour that comes and goes over the lips
    nose_y: float = -0.62
    nostril: float = 0.6
    nose_red: float = 0.05
    eyes: float = 1.0  # above the nose
    jaw_shadow: float = 0.2
    blots: tuple[tuple[float, float, float, float, float], ...] = ()  # x, y, radii, tone: shadows, marks, wrinkles
    nose_width: float = 0.62
    chin_y: float = 1.05
    jaw_width: float = 1.5
    background: tuple[float, float, float] = (0.3, 0.3, 0.35)
    neck: float = 0.75
    mottle: float = 0.03
    stubble: float = 0.0
    stubble_grain: float = 1.0  # 0: a shaved beard's even shadow
    moustache: tuple[float, float] = (0.0, 0.05)  # strength, how far it hangs over the upper lip
    beard: tuple[float, float] = (0.0, 0.7)  # strength, distance from the mouth's middle where it begins
    tongue_out: tuple[float, float] = (0.0, 0.0)  # how far below the lower lip it ends (0: inside), sideways
    hair: tuple[float, float, float] = (0.15, 0.11, 0.09)
    occluder: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # x, y, radius, tone (radius 0: none)


@dataclass(frozen=True)
class Camera:
    """From the drawn face to a picture."""

    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)
    exposure: float = 1.0
    contrast: float = 1.0
    saturation: float = 1.0
    blur_px: float = 0.5
    noise: float = 0.01
    sharpen: float = 0.0  # strength of the halo that cameras put around edges
    coarse: float = 1.0  # below 1: recorded this much smaller, then enlarged
    jpeg: int = 92  # quality, 100 for none


@dataclass(frozen=True)
class Drawing:
    """A drawn picture and its truth.

    picture : (H, W, 3) uint8 RGB
    lip, opening, lower : (H, W) float32, the share of each pixel that is lip (both lips and the opening together), that
        is opening, and that is lower lip
    corners : (2, 2) (row, column) of the mouth's corners
    """

    picture: np.ndarray
    lip: np.ndarray
    opening: np.ndarray
    lower: np.ndarray
    corners: np.ndarray


def _lens(u: np.ndarray, left: float, right: float, roundness: float) -> np.ndarray:
    """1 in the middle between left and right, 0 at both and outside."""
    v = (u - (left + right) / 2) / max((right - left) / 2, 1e-6)
    return np.clip(1 - v**2, 0, None) ** roundness


def lip_curves(shape: Shape, x: np.ndarray) -> tuple[np.ndarray, ...]:
    """Outer upper, inner upper, inner lower, outer lower lip at x (any shape), mouth units; NaN-free.

    Outside the corners all four meet."""
    half = shape.width / 2
    v = np.clip(x / half, -1, 1)
    u = v + shape.yaw * (v**2 - 1)  # the middle moves sideways, the corners stay
    seam = (
        -shape.smile * u**2
        + shape.skew * u
        + shape.tubercle * np.exp(-((u / 0.22) ** 2))
        + shape.wobble[0] * np.sin(3 * u)
        + shape.wobble[1] * np.sin(5 * u + 1)
        + shape.wobble[2] * np.cos(8 * u)
    )
    left, right = shape.span
    lens = _lens(u, left, right, shape.roundness)
    around = np.maximum(lens, _lens(u, max(left - shape.side, -1), min(right + shape.side, 1), shape.roundness))
    for begin, end in shape.glued:
        edge = 0.03
        lens = lens * np.clip(np.maximum((begin - u) / edge, (u - end) / edge), 0, 1)
        around = np.maximum(lens, 0.9 * around)
    inner_upper = seam - shape.gap[0] * lens
    inner_lower = seam + shape.gap[1] * lens
    ends = 1 - np.abs(u) ** 2.2
    bow = 1 + shape.bow * (np.exp(-(((np.abs(u) - 0.22) / 0.16) ** 2)) - 1.1 * np.exp(-((u / 0.13) ** 2)))
    outer_upper = seam - shape.gap[0] * around - shape.upper * ends**0.9 * bow
    outer_lower = seam + shape.gap[1] * around + shape.lower * np.clip(1 - u**2, 0, None) ** 0.8
    return outer_upper, inner_upper, inner_lower, outer_lower


def _noise(rng: np.random.Generator, size: tuple[int, int], cell: float) -> np.ndarray:
    """Smooth noise (H, W) about 0, spread about 1, features `cell` px wide."""
    h, w = max(2, int(np.ceil(size[0] / cell)) + 2), max(2, int(np.ceil(size[1] / cell)) + 2)
    small = rng.standard_normal((h, w)).astype(np.float32)
    return cv2.resize(small, (size[1], size[0]), interpolation=cv2.INTER_CUBIC)


def _step(distance: np.ndarray, soft: float) -> np.ndarray:
    """0 to 1 where `distance` rises through 0, over about `soft`."""
    return np.clip(distance / soft + 0.5, 0, 1)


def _blend(picture: np.ndarray, colour: np.ndarray, share: np.ndarray) -> np.ndarray:
    return picture + share[..., None] * (colour - picture)


def draw(
    face: Face,
    size: tuple[int, int],
    px_per_mouth: float,
    centre: tuple[float, float] | None = None,
    roll_rad: float = 0.0,
    camera: Camera | None = None,
    rng: np.random.Generator | None = None,
    supersample: int = 2,
) -> Drawing:
    """Draw a lower face: `size` (H, W) px, mouth `px_per_mouth` px wide at rest, its centre at `centre` (row, column).

    The scene is drawn `supersample` times larger and averaged down (1 is four times faster, its fine lines harder).
    `rng` drives skin texture, hair and noise only; without it they are seeded with 0.
    """
    rng = rng if rng is not None else np.random.default_rng(0)
    camera = camera or Camera()
    row0, col0 = centre if centre is not None else ((size[0] - 1) / 2, (size[1] - 1) / 2)
    k = supersample
    full = (size[0] * k, size[1] * k)
    scale = px_per_mouth * k
    rows = ((np.arange(full[0], dtype=np.float32) + 0.5) / k - 0.5 - row0)[:, None] / px_per_mouth
    cols = ((np.arange(full[1], dtype=np.float32) + 0.5) / k - 0.5 - col0)[None, :] / px_per_mouth
    cos, sin = np.float32(np.cos(roll_rad)), np.float32(np.sin(roll_rad))
    on_screen = cols * cos + rows * sin, rows * cos - cols * sin
    x, y, head = _surface(face, *on_screen)
    # the curves are smooth: tabulated once, looked up per pixel
    table_x = np.linspace(-0.6 * face.shape.width, 0.6 * face.shape.width, 721)
    curves = lip_curves(face.shape, table_x)
    ou, iu, il, ol = (np.interp(x.ravel(), table_x, c).reshape(x.shape).astype(np.float32) for c in curves)
    half = face.shape.width / 2
    inside = np.abs(x) < half
    fine = 1.0 / scale
    ends_y = [float(np.interp(side, table_x, curves[1])) for side in (-half, half)]

    lip = np.where(inside, _step(np.minimum(y - ou, ol - y), fine), 0)
    soft_lip = np.where(inside, _step(np.minimum(y - ou, ol - y), max(fine, face.lip_edge)), 0)
    opening = np.where(inside & (il - iu > 0.25 * fine), _step(np.minimum(y - iu, il - y), fine), 0)
    z = face_height(face.relief, head, x, y, (ou, iu, il, ol), half, face.nose_y, float(np.mean(ends_y)))
    lines, pores = _lines(rng, full, scale), np.stack([_noise(rng, full, max(1.2, 0.02 * scale)) for _ in range(2)])
    rough = face.relief.rough * pores * (1 - soft_lip)
    rough[0] += face.relief.lines * lines[None, :] * soft_lip
    lit, shine = shading(face.light, _turned_to_camera(face, x, y, z), scale, soft_lip.astype(np.float32), rough)
    bright = max(float(np.percentile(lit[..., 1], 75)), 0.05)  # a camera sets its exposure by the face
    picture = _skin(face, x, y, ou, ol, full, scale, rng)
    picture = _blend(picture, _lip_colour(face, x, y, ou, iu, il, ol, lines, full, scale, rng), soft_lip)
    lit, shine = lit / bright, shine / bright
    picture = np.sqrt(picture**2 * lit + shine)
    if opening.any():
        picture = _blend(picture, _mouth_colour(face, x, y, iu, il, full, scale, rng) / np.sqrt(bright), opening)
    strength, seam_width = face.seam
    shut = np.where(inside, np.exp(-(((y - (iu + il) / 2) / max(seam_width, fine)) ** 2)), 0) * (1 - opening)
    picture *= (1 - strength * shut * np.exp(-(((il - iu) / 0.03) ** 2)))[..., None]
    for side, end in zip((-half, half), ends_y, strict=True):
        picture *= (1 - face.corner_dark * np.exp(-(((x - side) / 0.05) ** 2 + ((y - end) / 0.035) ** 2)))[..., None]
    picture = _hair(face, picture, x, y, ou, ol, opening, np.sqrt(lit), full, scale, rng)
    if face.tongue_out[0] > 0 and opening.any():
        picture = _tongue_out(face, picture, x, y, iu, ol, np.sqrt(lit), full, scale, rng)
    picture = _behind(face, picture, x, y, full, scale, rng)
    if face.occluder[2] > 0:
        ox, oy, radius, tone = face.occluder
        away = np.hypot(x - ox, (y - oy) * 0.7) + 0.03 * _noise(rng, full, 0.2 * scale)
        colour = np.asarray(face.skin, np.float32) * tone * (1 - 0.4 * np.clip(away / radius, 0, 1)[..., None])
        hidden = _step(radius - away, 0.02)
        picture = _blend(picture, colour, hidden)
    strength, place, soft = face.side_shadow
    picture *= ((1 - strength * _step(x - place, soft)) * light_factor(face.paint, x, y))[..., None]

    shrink = (size[1], size[0])
    picture = cv2.resize(picture.astype(np.float32), shrink, interpolation=cv2.INTER_AREA)
    lip = cv2.resize(lip.astype(np.float32), shrink, interpolation=cv2.INTER_AREA)
    lower = lip * cv2.resize(_step(y - (iu + il) / 2, fine), shrink, interpolation=cv2.INTER_AREA)
    opening = cv2.resize(opening.astype(np.float32), shrink, interpolation=cv2.INTER_AREA)
    corners = []
    for side, end in zip((-half, half), ends_y, strict=True):
        across, down = _on_screen(face, side, end)
        corners.append(
            (row0 + (across * sin + down * cos) * px_per_mouth, col0 + (across * cos - down * sin) * px_per_mouth)
        )
    return Drawing(photograph(picture, camera, rng), lip, opening, np.clip(lower - opening, 0, 1), np.array(corners))


_DEEPEST = 2.0  # mouth units


def _head(face, x, y):
    return head_height(face.relief, x, y, face.nose_y, face.nose_width, face.chin_y)


def _surface(face, across, down):
    """Where on the face each point of the screen lies (x, y), and its height there, for a turned head.

    By fixed-point iteration: the face is a height over its plane and the turn small, so each round
    comes closer."""
    left, up = face.turn
    if left == up == 0:
        return across, down, _head(face, across, down)
    size = across.shape[::-1]
    grid = tuple(max(2, side // 4) for side in size)  # the shifts are smooth
    across_few, down_few = (cv2.resize(each, grid, interpolation=cv2.INTER_AREA) for each in (across, down))
    x, y = across_few / np.float32(np.cos(left)), down_few / np.float32(np.cos(up))
    start = float(_head(face, 0.0, 0.0))
    for _ in range(5):
        z = _head(face, x, y) - start
        z = np.clip(z, -_DEEPEST, _DEEPEST)  # far off the face the rounds would lead away
        x = np.float32((across_few - z * np.sin(left)) / np.cos(left))
        y = np.float32((down_few + (z * np.cos(left) - x * np.sin(left)) * np.sin(up)) / np.cos(up))
    x = across + cv2.resize(x - across_few, size, interpolation=cv2.INTER_LINEAR)
    y = down + cv2.resize(y - down_few, size, interpolation=cv2.INTER_LINEAR)
    return x, y, _head(face, x, y)


def _on_screen(face, x: float, y: float) -> tuple[float, float]:
    """The inverse of `_surface` at one point."""
    left, up = face.turn
    z = float(_head(face, x, y)) - float(_head(face, 0.0, 0.0))
    across, deep = x * np.cos(left) + z * np.sin(left), z * np.cos(left) - x * np.sin(left)
    return float(across), float(y * np.cos(up) - deep * np.sin(up))


def _turned_to_camera(face, x, y, z):
    left, up = face.turn
    return (z * np.cos(left) - x * np.sin(left)) * np.cos(up) + y * np.sin(up)


def _lines(rng, full, scale):
    """The creases that run up and down the lips, (W,), about 0 with spread 1."""
    lines = rng.standard_normal(full[1]).astype(np.float32)
    width = max(1, int(0.02 * scale))
    return np.convolve(lines, np.ones(width, np.float32) / np.sqrt(width), "same")


def _skin(face, x, y, ou, ol, full, scale, rng):
    skin = np.asarray(face.skin, np.float32)
    texture = 1 + face.mottle * (0.6 * _noise(rng, full, 0.25 * scale) + 0.4 * _noise(rng, full, 0.04 * scale))
    picture = skin * texture[..., None]
    tint = 0.03 * _noise(rng, full, 0.4 * scale)
    shade = np.zeros_like(x)
    for bx, by, rx, ry, tone in face.blots:
        shade += tone * _step(1 - np.hypot((x - bx) / rx, (y - by) / ry), 0.5)
    holes = np.exp(
        -((((np.abs(x) - 0.23 * face.nose_width) / 0.09) ** 2 + ((y - face.nose_y + 0.02) / 0.055) ** 2) ** 2)
    )
    shade += face.nostril * holes
    tip = face.nose_red * np.exp(-((x / 0.3) ** 2) - ((y - face.nose_y + 0.16) / 0.15) ** 2)
    picture *= np.stack([1 + 0 * tint, 1 - tint - tip, 1 - tint - tip], -1) * np.clip(1 - shade, 0.05, 1.25)[..., None]
    picture *= skin_factor(face.paint, x, y, ou, ol, face.nose_y, face.nose_width)
    return _eyes(face, picture, x, y, np.asarray(face.hair, np.float32))


def _hair(face, picture, x, y, ou, ol, opening, lit, full, scale, rng):
    """Stubble, moustache and beard, which hide the skin and the edge of the lips but not the opening."""
    (moustache, hang), (beard, begins) = face.moustache, face.beard
    if not (face.stubble or moustache or beard):
        return picture
    hair = np.asarray(face.hair, np.float32)
    patchy = 0.25 * _noise(rng, full, 0.3 * scale)
    on_lip = _step(np.minimum(y - ou, ol - y), 0.04) * (np.abs(x) < face.shape.width / 2)
    around = _step(y - face.nose_y - 0.15 + 0.2 * patchy, 0.3) * np.clip(1.5 - np.abs(x), 0, 1) * (1 - on_lip)
    bare_chin = np.exp(-(((y - ol - 0.09) / 0.07) ** 2) - (x / 0.3) ** 2)
    speckle = np.clip(0.5 + 0.7 * face.stubble_grain * _noise(rng, full, max(1.5, 0.018 * scale)), 0, 1)
    picture = _blend(picture, hair * lit, face.stubble * around * speckle * (1 - 0.5 * bare_chin))
    strands = rng.standard_normal(full).astype(np.float32)
    strands = cv2.blur(strands, (max(1, int(0.012 * scale)), max(3, int(0.09 * scale))))
    strands = 1 + 0.35 * strands / max(float(strands.std()), 1e-6)
    above = _step(ou + hang + 0.04 * strands - 0.04 - y, 0.05) * _step(y - face.nose_y - 0.12 + 0.2 * patchy, 0.15)
    above *= _step(0.75 - np.abs(x) + 0.3 * y, 0.2)
    below = _step(np.hypot(x / 0.95, (y - 0.1) / 0.75) - begins + 0.3 * patchy, 0.25) * _step(y + 0.6 + patchy, 0.8)
    below = np.maximum(below, _step(y - ol - 0.12, 0.1) * _step(0.5 - np.abs(x), 0.3)) * (1 - on_lip)
    growth = np.maximum(moustache * above, beard * below * _step(y - ou, 0.3))
    growth = np.clip(growth * (0.6 + 0.4 * speckle), 0, 1) * (1 - opening)
    return picture + growth[..., None] * (hair * strands[..., None] * lit - picture)


def _tongue_out(face, picture, x, y, iu, ol, lit, full, scale, rng):
    """A tongue over the lower lip; the opening's truth stays that of the lips."""
    out, aside = face.tongue_out
    middle = aside * np.clip(y - iu, 0, None)
    end = float(ol.max()) + out
    wide = 0.3 * np.sqrt(np.clip((end - y) / 0.25, 0, 1))
    is_tongue = _step(wide - np.abs(x - middle), 0.02) * _step(y - iu - 0.35 * (end - iu), 0.03)
    groove = 1 - 0.2 * np.exp(-(((x - middle) / 0.03) ** 2)) + 0.06 * _noise(rng, full, 0.06 * scale)
    round_off = 1 - 0.35 * np.clip(np.abs(x - middle) / np.maximum(wide, 0.02), 0, 1) ** 3
    colour = np.asarray(face.tongue, np.float32) * (groove * round_off)[..., None]
    return _blend(picture, colour * (0.5 + 0.5 * lit), is_tongue)


def _behind(face, picture, x, y, full, scale, rng):
    """Jaw, neck and what is behind."""
    edge = face.jaw_width / 2 * np.sqrt(np.clip(1 - np.clip((y + 0.3) / (face.chin_y + 0.3), 0, 1) ** 2.4, 0, 1)) + 1e-3
    off = np.maximum(_step(np.abs(x) - edge, 0.05), _step(y - face.chin_y, 0.02))
    behind = np.asarray(face.background, np.float32) * (1 + 0.25 * _noise(rng, full, 0.35 * scale))[..., None]
    throat = picture * face.neck * (1 - face.jaw_shadow * np.exp(-(np.abs(off - 1) / 0.5)))[..., None]
    picture = picture * (1 - face.jaw_shadow * np.exp(-np.clip(edge - np.abs(x), 0, None) / 0.12))[..., None]
    is_neck = _step(0.55 * face.jaw_width / 2 + 0.2 - np.abs(x), 0.1) * (y > face.chin_y * 0.6)
    return _blend(picture, _blend(behind, throat, is_neck), off)


def _eyes(face, picture, x, y, hair):
    # far above the mouth: seen only where a search looks in the wrong place
    eye_y = face.nose_y - face.eyes
    if y.min() < eye_y + 0.5:
        u = (np.abs(x) - 0.62) / 0.3
        lid = 0.13 * np.clip(1 - u**2, 0, None)
        off = np.abs(y - eye_y) - lid
        white = np.array([0.85, 0.8, 0.78], np.float32) * (1 - 0.2 * np.clip(u**2, 0, 1))[..., None]
        iris = _step(0.1 - np.hypot(np.abs(x) - 0.62, y - eye_y), 0.02)
        eye = _blend(white, 0.6 * hair, iris)
        picture = _blend(picture, eye, _step(-off, 0.02) * (np.abs(u) < 1))
        lash = np.exp(-((off / 0.03) ** 2)) * (np.abs(u) < 1.1)
        brow = np.exp(-(((y - eye_y + 0.36 - 0.1 * u**2) / 0.06) ** 2)) * (np.abs(u) < 1.4)
        picture = _blend(picture, hair, np.clip(0.7 * lash + 0.8 * brow, 0, 1))
    return picture


def _lip_colour(face, x, y, ou, iu, il, ol, lines, full, scale, rng):
    lip = np.asarray(face.lip, np.float32)
    upper = _step((iu + il) / 2 - y, 0.01)
    tone = np.where(upper > 0.5, face.upper_tint, face.lower_gain) * lip_factor(
        face.paint, x, y, (ou, iu, il, ol), upper
    )
    tone = tone * (1 + face.creases * (lines[None, :] + 0.5 * _noise(rng, full, 0.05 * scale)))
    tint = face.lip_mottle * _noise(rng, full, 0.07 * scale)
    colour = lip * tone[..., None] * np.stack([1 + 0.3 * tint, 1 - tint, 1 - 0.7 * tint], -1)
    bright, red, rim_width = face.rim
    at_rim = np.exp(-(np.minimum(np.abs(y - iu), np.abs(y - il)) / rim_width))
    colour = colour * (1 + at_rim[..., None] * (np.array([bright, bright * red, bright * red], np.float32) - 1))
    broken = 0.6 + 0.4 * lines[None, :] + 0.4 * _noise(rng, full, 0.05 * scale)
    return colour + gloss_share(face.paint, x, y, (ou, iu, il, ol), upper, broken)[..., None] * (1 - colour)


def _mouth_colour(face, x, y, iu, il, full, scale, rng):
    depth = np.clip(np.minimum(y - iu, il - y) / 0.08, 0, 1)
    colour = (
        np.asarray(face.cavity, np.float32) * (1.4 - 0.6 * depth + 0.15 * _noise(rng, full, 0.1 * scale))[..., None]
    )
    if face.tongue_height > 0:
        top = il - face.tongue_height * np.clip(1 - (x / 0.42) ** 2, 0, 1) ** 0.6
        groove = 1 - 0.15 * np.exp(-((x / 0.03) ** 2)) + 0.06 * _noise(rng, full, 0.06 * scale)
        tongue = (
            np.asarray(face.tongue, np.float32) * (groove * (0.7 + 0.3 * np.clip((y - top) / 0.12, 0, 1)))[..., None]
        )
        colour = _blend(colour, tongue, _step(y - top, 0.02) * _step(0.42 - np.abs(x), 0.04))
    reach = 0.44 * face.shape.width
    for upper in (True, False):
        length = face.upper_teeth if upper else face.lower_teeth
        if length <= 0:
            continue
        arch = length * np.clip(1 - 0.6 * (x / reach) ** 2, 0, 1)
        edge = (iu + arch - y) if upper else (y - (il - arch))
        pitch = face.tooth_width * (1.0 if upper else 0.72) * (1 - 0.35 * np.clip(np.abs(x) / 0.4, 0, 1))
        phase = np.mod(x / pitch + (0.0 if upper else 0.5), 1.0)
        between = np.minimum(phase, 1 - phase) * pitch
        enamel = 1 - 0.25 * np.exp(-((between / 0.006) ** 2)) - 0.3 * np.clip(np.abs(x) / reach, 0, 1) ** 3
        edge = edge - 0.015 * np.exp(-((between / 0.012) ** 2))
        from_lip = (y - iu) if upper else (il - y)
        enamel = enamel * (0.75 + 0.25 * np.clip(from_lip / 0.05, 0, 1)) * (1 + 0.03 * _noise(rng, full, 0.08 * scale))
        tooth = np.asarray(face.teeth, np.float32) * (enamel * (1.0 if upper else 0.88))[..., None]
        if face.gums > 0 and upper:
            gum = _step(face.gums + 0.015 * np.cos(2 * np.pi * phase) - from_lip, 0.01)
            tooth = _blend(tooth, np.asarray(face.tongue, np.float32) * 1.05, gum)
        colour = _blend(colour, tooth, _step(edge, 0.012) * _step(reach - np.abs(x), 0.06))
    # light falls in past the upper lip, or from below past the lower one
    light = face.light
    toward = np.asarray(light.direction) / np.linalg.norm(light.direction)
    deep = 0.07 * abs(toward[1]) / max(toward[2], 0.2)
    from_lip = (y - iu) if toward[1] < 0 else (il - y)
    lamp = (1 - light.sky) * toward[2] * (1 - light.hardness * _step(deep - from_lip, 0.06))
    return colour * np.sqrt(
        0.85 * light.sky * np.asarray(light.sky_colour, np.float32)
        + lamp[..., None] * np.asarray(light.lamp_colour, np.float32)
    )


def photograph(picture: np.ndarray, camera: Camera, rng: np.random.Generator) -> np.ndarray:
    """(H, W, 3) float 0..1 to uint8 through white balance, exposure, contrast, colour, blur, noise and JPEG."""
    out = picture * np.asarray(camera.gains, np.float32) * camera.exposure
    grey = out.mean(-1, keepdims=True)
    out = grey + camera.saturation * (out - grey)
    out = np.clip(out, 0, None) ** camera.contrast
    height, width = out.shape[:2]
    if camera.coarse < 1:
        small = (max(2, round(width * camera.coarse)), max(2, round(height * camera.coarse)))
        out = cv2.resize(out, small, interpolation=cv2.INTER_AREA)
    if camera.blur_px > 0:
        out = cv2.GaussianBlur(out, (0, 0), camera.blur_px)
    if camera.sharpen > 0:
        out = out + camera.sharpen * (out - cv2.GaussianBlur(out, (0, 0), 1.5))
    out = out + camera.noise * rng.standard_normal(out.shape).astype(np.float32)
    out = np.clip(255 * out + 0.5, 0, 255).astype(np.uint8)
    if camera.jpeg < 100:
        _, code = cv2.imencode(".jpg", out[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, camera.jpeg])
        out = cv2.imdecode(code, cv2.IMREAD_COLOR)[..., ::-1]
    if camera.coarse < 1:
        out = cv2.resize(out, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(out)


def random_shape(rng: np.random.Generator, closed: bool | None = None) -> Shape:
    """A mouth shape: closed with the given truth value, or in a quarter of the cases."""
    closed = rng.random() < 0.25 if closed is None else closed
    upper, lower = rng.uniform(0.06, 0.18), rng.uniform(0.1, 0.26)
    if rng.random() < 0.1:
        upper, lower = rng.uniform(0.01, 0.05), rng.uniform(0.02, 0.07)
    smile = rng.normal(0.04, 0.07)
    gap = (0.0, 0.0)
    width = rng.uniform(0.9, 1.15)
    span = (-rng.uniform(0.55, 1.0), rng.uniform(0.55, 1.0))
    glued: tuple = ()
    if not closed:
        kind = rng.random()
        smiling = 0.2 < kind < 0.55
        if kind < 0.25:  # a slit
            total = rng.uniform(0.03, 0.1)
        elif kind < 0.75:  # talking, smiling with teeth
            total = rng.uniform(0.08, 0.32)
        else:  # wide open
            total = rng.uniform(0.25, 0.95)
            width *= 1 - 0.35 * total * rng.random()
            span = (-rng.uniform(0.6, 0.92), rng.uniform(0.6, 0.92))
            thin = 1 - 0.45 * total
            upper, lower = upper * thin, lower * thin
        if smiling:  # crescent, thin lips
            smile = abs(rng.normal(0.12, 0.06))
            width *= rng.uniform(1.0, 1.2)
            upper, lower = upper * rng.uniform(0.4, 1), lower * rng.uniform(0.5, 1)
            span = (-rng.uniform(0.75, 1.0), rng.uniform(0.75, 1.0))
        share = rng.uniform(0.1, 0.6)
        gap = (total * share, total * (1 - share))
        if kind < 0.6 and rng.random() < 0.1:
            if rng.random() < 0.5:
                middle, reach = rng.uniform(-0.4, 0.4), rng.uniform(0.05, 0.2)
                glued = ((middle - reach, middle + reach),)
            else:  # one-sided
                span = (-0.95, rng.uniform(-0.3, 0.3)) if rng.random() < 0.5 else (rng.uniform(-0.3, 0.3), 0.95)
    return Shape(
        width=width,
        gap=gap,
        span=span,
        side=rng.uniform(0.03, 0.2),
        roundness=rng.uniform(0.45, 1.1),
        upper=upper,
        lower=lower,
        bow=rng.uniform(0.0, 0.45),
        smile=smile,
        skew=rng.normal(0, 0.02),
        tubercle=rng.uniform(-0.01, 0.04),
        wobble=tuple(rng.normal(0, (0.006, 0.004, 0.002))),
        glued=glued,
        yaw=float(np.clip(rng.normal(0, 0.12), -0.35, 0.35)),
    )


FLAT_LIGHT = Light(direction=(0, 0, 1), sky=1.0, hardness=0.0, hollow=0.0, skin_shine=(0.0, 1.0), lip_shine=(0.0, 1.0))


def random_relief(shape: Shape, rng: np.random.Generator, flat: bool = False) -> Relief:
    """Heights of a face: full lips stand out more, a smile lifts the cheeks. A flat one keeps what turns with it."""
    relief = Relief(
        curve=rng.uniform(0.15, 0.42),
        muzzle=rng.uniform(0.0, 0.22),
        upper_lip=rng.uniform(0.2, 0.9) * shape.upper,
        lower_lip=rng.uniform(0.3, 0.9) * shape.lower,
        sulcus=(rng.uniform(0, 0.09), rng.uniform(0.08, 0.2)),
        chin=(rng.uniform(0, 0.17), rng.uniform(0.33, 0.6)),
        philtrum=rng.uniform(0, 0.025),
        nose=rng.uniform(0.2, 0.5),
        nose_round=rng.uniform(0.12, 0.32),
        wings=rng.uniform(0.05, 0.22),
        cheek=(rng.uniform(0, 0.07) + max(rng.uniform(0, 0.5) * shape.smile, 0), rng.uniform(0.12, 0.5)),
        fold=(rng.uniform(0.3, 0.5), rng.uniform(0.25, 0.42)),
        dimple=rng.uniform(0, 0.04),
        lines=rng.uniform(0, 0.16),
        rough=rng.uniform(0, 0.06),
    )
    return replace(relief, lines=0.0, rough=0.0) if flat else relief


def random_light(rng: np.random.Generator) -> Light:
    """Light in rooms, studios and the open: mostly from above, from one side, or a flash."""
    from_below = rng.random() < 0.1
    warm = rng.normal(0, (0.08, 0.1))
    return Light(
        direction=(
            rng.normal(0, 0.5),
            abs(rng.normal(0.3, 0.2)) if from_below else -abs(rng.normal(0.5, 0.35)),
            rng.uniform(0.3, 1.2),
        ),
        sky=rng.uniform(0.15, 0.85),
        lamp_colour=(1 + warm[0], 1.0, 1 - warm[0]),
        sky_colour=(1 + warm[1], 1.0, 1 - warm[1]),
        scatter=rng.uniform(0.1, 0.6),
        hardness=rng.uniform(0, 1),
        hollow=rng.uniform(0.4, 2.0),
        skin_shine=(rng.uniform(0, 0.2), rng.uniform(4, 30)),
        lip_shine=(rng.uniform(0, 0.5) if rng.random() < 0.8 else 0.0, rng.uniform(6, 60)),
    )


_SKINS = np.array([(0.95, 0.80, 0.73), (0.86, 0.66, 0.54), (0.72, 0.51, 0.38), (0.52, 0.34, 0.24), (0.30, 0.19, 0.14)])


def random_face(rng: np.random.Generator, closed: bool | None = None) -> Face:
    """A face over the human range of tones, lip colours, beards, teeth and light."""
    shape = random_shape(rng, closed)
    tone = rng.uniform(0, 4)
    skin = np.array([np.interp(tone, range(5), _SKINS[:, c]) for c in range(3)]) * rng.normal(0.95, 0.05, 3)
    ruddy = rng.uniform(0, 1)
    lip = skin * (
        rng.uniform(0.76, 1.0),
        rng.uniform(0.62, 0.84) - 0.16 * ruddy,
        rng.uniform(0.7, 0.95) - 0.14 * ruddy,
    )
    if rng.random() < 0.2:  # lipstick
        lip = np.array([rng.uniform(0.45, 0.9), rng.uniform(0.08, 0.4), rng.uniform(0.12, 0.5)])
    gap = sum(shape.gap)
    flat = rng.random() < 0.5  # painted shades or those of a surface
    teeth_shown = rng.random() < (0.92 if 0.1 < gap < 0.35 else 0.75)
    lower_shown = rng.random() < 0.3
    bearded = rng.random()
    cavity = rng.uniform(0.01, 0.16) * np.array([1, rng.uniform(0.4, 0.9), rng.uniform(0.4, 0.9)])
    teeth = np.array([0.92, rng.uniform(0.84, 0.91), rng.uniform(0.66, 0.9)]) * rng.uniform(0.55, 1.15)
    return Face(
        shape=shape,
        skin=tuple(np.clip(skin, 0.03, 1)),
        lip=tuple(np.clip(lip, 0.02, 1)),
        lower_gain=rng.uniform(0.9, 1.15 + 0.08 * tone),
        lip_edge=rng.uniform(0.005, 0.1),
        teeth=tuple(np.clip(teeth + rng.uniform(0, 0.3) * (skin * teeth.mean() - teeth), 0, 1.1)),
        tongue=tuple(np.array([0.75, rng.uniform(0.32, 0.5), rng.uniform(0.33, 0.5)]) * rng.uniform(0.5, 1.05)),
        cavity=tuple(cavity),
        upper_teeth=(rng.uniform(0.4, 1.7) * gap if gap < 0.25 else rng.uniform(0.03, 0.22)) if teeth_shown else 0.0,
        lower_teeth=(rng.uniform(0.1, 0.8) * gap if gap < 0.2 else rng.uniform(0.02, 0.14)) if lower_shown else 0.0,
        tongue_height=rng.uniform(0.15, 0.8 if rng.random() < 0.85 else 1.15) * gap
        if rng.random() < (0.1 if gap < 0.12 else 0.35)
        else 0.0,
        gums=rng.uniform(0.005, 0.05) if rng.random() < 0.12 else 0.0,
        tooth_width=rng.uniform(0.09, 0.14),
        seam=(rng.uniform(0.1, 0.85), rng.uniform(0.006, 0.03))
        if rng.random() < 0.8
        else (rng.uniform(0.1, 0.5), 0.05),
        corner_dark=rng.uniform(0, 0.45),
        relief=random_relief(shape, rng, flat),
        light=FLAT_LIGHT if flat else random_light(rng),
        paint=random_paint(rng) if flat else Paint(),
        turn=tuple(np.clip(rng.normal(0, (0.17, 0.12)), -0.5, 0.4)),
        side_shadow=(rng.uniform(0.2, 0.75), rng.uniform(-0.8, 0.8), rng.uniform(0.2, 1.0))
        if rng.random() < 0.06
        else (0, 0, 1),
        upper_tint=rng.uniform(0.6, 1.0) if tone > 2.5 else rng.uniform(0.85, 1.05),
        rim=(rng.uniform(0.75, 1.15), rng.uniform(0.75, 1.05), rng.uniform(0.01, 0.04)),
        creases=rng.uniform(0, 0.14),
        lip_mottle=rng.uniform(0, 0.2),
        nose_y=-rng.uniform(0.36, 0.75),
        nostril=rng.uniform(0.1, 0.9),
        nose_red=rng.uniform(-0.03, 0.2),
        eyes=rng.uniform(0.7, 1.2),
        jaw_shadow=rng.uniform(0, 0.6),
        blots=tuple(
            (
                rng.normal(0, 0.6),
                rng.normal(0, 0.6),
                rng.uniform(0.02, 0.4),
                rng.uniform(0.02, 0.25),
                rng.normal(0, 0.12),
            )
            for _ in range(rng.integers(0, 5))
        ),
        nose_width=rng.uniform(0.55, 0.95),
        chin_y=rng.uniform(0.7, 1.35) + 0.8 * shape.gap[1],
        jaw_width=rng.uniform(1.9, 3.6),
        background=tuple(rng.uniform(0.02, 0.95) * rng.uniform(0.6, 1.2, 3)),
        neck=rng.uniform(0.4, 1.0),
        mottle=rng.uniform(0.01, 0.06),
        stubble=rng.uniform(0.1, 0.5) if bearded < 0.4 else 0.0,
        stubble_grain=rng.uniform(0, 1.2),
        moustache=(rng.uniform(0.3, 1) if bearded < 0.2 else 0.0, rng.uniform(-0.04, 0.09)),
        beard=(rng.uniform(0.3, 1) if bearded < 0.15 or 0.2 < bearded < 0.24 else 0.0, rng.uniform(0.6, 0.95)),
        tongue_out=(rng.uniform(-0.05, 0.5) if gap > 0.1 and rng.random() < 0.04 else 0.0, rng.normal(0, 0.2)),
        hair=tuple(rng.uniform(0.02, 0.8) * np.array([1, rng.uniform(0.7, 1), rng.uniform(0.5, 1)])),
        occluder=(rng.normal(0, 0.8), rng.uniform(0.2, 1.2), rng.uniform(0.1, 0.35), rng.uniform(0.5, 1.3))
        if rng.random() < 0.02
        else (0.0, 0.0, 0.0, 0.0),
    )


def random_camera(rng: np.random.Generator) -> Camera:
    """A camera over phones, web cams, television and old photographs."""
    return Camera(
        gains=tuple(np.exp(rng.normal(0, (0.08, 0.04, 0.1)))),
        exposure=float(np.exp(rng.normal(0.05, 0.22))),
        contrast=rng.uniform(0.7, 1.4),
        saturation=0.0 if rng.random() < 0.1 else rng.uniform(0.5, 1.5),
        blur_px=rng.uniform(0.0, 0.9),
        noise=abs(rng.normal(0, 0.012)),
        sharpen=rng.uniform(0, 1.2) if rng.random() < 0.5 else 0.0,
        coarse=1.0 if rng.random() < 0.5 else rng.uniform(0.3, 1.0),
        jpeg=int(rng.integers(45, 100)),
    )
