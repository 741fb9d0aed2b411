"""The skin's own colour, relief and shine as a picture over its rest coordinates, made once for a clip.

The nose has no mesh: its base is relief, colour and shadow here, above the sheet of the mouth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from simulator.look import Look
from simulator.mouth import Mouth, border_distance, line_y
from simulator.shade import BLUE, GREEN, LIP, OIL, RED, SEAM, SLOPE_X, SLOPE_Y

AROUND_M = (0.020, 0.030, 0.025)  # what the texture covers beside, below and above the sheet
GRAIN_M = 0.0002  # size of the finest pattern, so that it does not depend on the picture's size
FINEST_M, COARSEST_M = 0.0001, 0.0012
# The nose is above this height and the lips within this distance of their border, m: beyond it they give nothing.
NOSE_M, NEAR_M = 0.008, 0.012
BAND = 24  # rows that are painted at a time


@dataclass(frozen=True, eq=False)
class Texture:
    """values (h, w, 8) float32, see simulator.shade; left_m, top_m of its corner and size texel_m of a texel, m"""

    values: np.ndarray
    left_m: float
    top_m: float
    texel_m: float

    def places(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Column and row in the texture of rest coordinates x, y, m."""
        return (x - self.left_m) / self.texel_m - 0.5, (self.top_m - y) / self.texel_m - 0.5


def skin_texture(mouth: Mouth, look: Look, px_m: float) -> Texture:
    """Texture for a picture whose pixels are px_m wide, m; the same pattern at every size."""
    fine = px_m < 0.75 * GRAIN_M
    step = FINEST_M if fine else GRAIN_M
    low, high = mouth.nodes.min(axis=0), mouth.nodes.max(axis=0)
    half, top = max(-low[0], high[0]) + AROUND_M[0], high[1] + AROUND_M[2]
    shape = (round((top - low[1] + AROUND_M[1]) / step), round(2 * half / step))
    y = (top - (np.arange(shape[0]) + 0.5) * step).astype(np.float32)[:, None]
    x = (-half + (np.arange(shape[1]) + 0.5) * step).astype(np.float32)[None, :]
    values = np.empty((*shape, 8), np.float32)
    _paint(values, x, y, mouth, look, step)
    texel = min(max(px_m, step), COARSEST_M)
    if texel > step * 1.2:
        size = (round(shape[1] * step / texel), round(shape[0] * step / texel))
        texel = shape[1] * step / size[0]
        values = np.concatenate(
            [cv2.resize(values[..., a : a + 4], size, interpolation=cv2.INTER_AREA) for a in (0, 4)], axis=-1
        )
    else:
        texel = step
    return Texture(np.ascontiguousarray(values), -half, top, texel)


def _paint(values: np.ndarray, x: np.ndarray, y: np.ndarray, mouth: Mouth, look: Look, step: float) -> None:
    skin, shape = look.skin, values.shape[:2]
    rng = np.random.default_rng([look.seed, 1])

    border, line = _border(mouth, x, y)
    near = np.flatnonzero(border.max(axis=1) > -NEAR_M)
    lips = slice(near.min(), near.max() + 1) if len(near) else slice(0, 0)

    def noise(across_m: float, along_m: float | None = None, rows: slice = slice(0, shape[0])) -> np.ndarray:
        return _noise(rng, shape, rows, step, across_m, across_m if along_m is None else along_m)

    fields = {"blotch": noise(0.006), "mottle": noise(0.0018), "pores": noise(0.0003)}
    fields["dapple"] = noise(0.001, rows=lips)
    # the border of the red wanders a little
    fields["border"] = border + 0.00012 * noise(0.004)
    fields["streaks"] = noise(0.0003, 0.002, lips)
    if skin.freckles:
        fields["spots"] = noise(0.0008)
    fields["dots"] = noise(0.0003, rows=slice(0, shape[0] if skin.stubble else 0))
    fields["lines"] = skin.lip_lines * (noise(0.00035, 0.004, lips) + 0.6 * noise(0.0008, 0.006, lips))
    relief = np.empty(shape, np.float32)
    # a band of rows at a time, small enough for a cache
    bands = [slice(top, min(top + BAND, shape[0])) for top in range(0, shape[0], BAND)]
    for rows in bands:
        of_band = {name: field[rows] for name, field in fields.items()}
        _paint_band(values[rows], relief[rows], x, y[rows], line, mouth.width_m / 2, look, **of_band)
    for rows in bands:
        around = slice(max(rows.start - 1, 0), rows.stop + 1)
        down, right = (gradient / step for gradient in np.gradient(relief[around]))
        for a, slope in ((SLOPE_X, right), (SLOPE_Y, -down)):
            slope = slope[rows.start - around.start :][: rows.stop - rows.start]
            values[rows, :, a] = slope / np.sqrt(1 + (slope / 0.9) ** 2)  # skin hangs over nowhere


def _paint_band(
    values, relief, x, y, line, half, look, *, blotch, mottle, pores, dapple, border, streaks, dots, lines, spots=None
):
    """Fill rows of all channels but the slopes, and of the relief, m, from those of the noises and the border."""
    skin, texture, side = look.skin, look.skin.texture, np.abs(x)
    # redder beside the nose, round the mouth and on the cheeks
    flush = _bell((side - 0.045) / 0.02) * _bell((y - 0.02) / 0.025)
    if skin.nose:
        flush = flush + 0.9 * _bell(side / 0.014) * _bell((y - 0.040) / 0.012)
    flush = 0.20 * flush + texture * (0.10 * blotch + 0.05 * mottle)
    tone = 1 + texture * (0.025 * blotch + 0.03 * mottle + 0.04 * pores)
    # a darker fold where cheek meets lip, and shadow below the lips
    fold = _smooth((y + 0.012) / 0.025) * _smooth((0.037 - y) / 0.008)
    if fold.any():
        low = np.clip((0.034 - y) / 0.034, 0, 1.3)
        off = np.abs((side - 0.0205 - 0.0165 * low**1.3) / (0.0024 + 0.003 * low))
        fold = fold * np.exp(-(off**1.7))
    below_lip = _bell((y + 0.0150) / 0.0045) * _bell(x / 0.020)
    bumps = texture * (1.1e-5 * pores + 2.5e-5 * mottle)
    lip = seam = np.float32(0.0)
    near = border.max() > -NEAR_M
    if near:
        lip = _smooth(border / skin.border_m + 0.5)
        above = y - line
        lip_tone = 1 + texture * (0.06 * blotch + 0.05 * dapple) + 0.05 * skin.lip_lines * streaks
        # the lower lip is a little lighter than the upper one
        lip_tone = lip_tone * (1 + 0.04 * np.tanh(-above / 0.002))
        within = side < half
        rim = _bell((border + 0.0008) / 0.0009) * within
        corner = _bell((side - half - 0.0005) / 0.0035) * _bell(above / 0.0022)
        bumps = bumps * (1 - lip) + 5.5e-5 * lines * lip + 1.2e-4 * _bell(border / 0.0011) * within
        off = np.maximum(np.abs(above) - 0.0002, 0) / 0.0005
        seam = np.exp(-(off * np.sqrt(off))) * _smooth((half + 0.0015 - side) / 0.004)
    shade = 1 - 0.075 * fold - 0.10 * below_lip * (1 - lip)
    if near:
        shade = shade - 0.30 * corner + 0.05 * rim  # paler along the red, darker at the corners
    if skin.nose and y[0, 0] > NOSE_M:
        nose, nose_shade = _nose(x, y, look.light.direction)
        bumps, shade = bumps + nose, shade * nose_shade
    oil = np.clip(1 + texture * (0.25 * blotch + 0.25 * pores), 0, 2)
    if skin.freckles:
        freckle = np.maximum(spots - 2.3 + 1.3 * skin.freckles, 0) * _bell((y - 0.035) / 0.03)
        freckle = np.clip(freckle, 0, 1) * (1 - lip)
    if skin.stubble:
        beard = _beard(x, y, half) * (1 - lip) * _smooth((-border - 0.0008) / 0.002)
        cover = beard * skin.stubble * (0.30 + 0.55 * np.clip((dots - 0.2) * 0.8, 0, 1))
        oil = oil * (1 - 0.6 * beard * skin.stubble)
    base, red = skin.linear.astype(np.float32), skin.lip_linear.astype(np.float32)
    for channel, (a, absorbs) in enumerate(((RED, 0.25), (GREEN, 1.0), (BLUE, 0.85))):
        colour = base[channel] * tone * np.exp(-absorbs * flush)
        if skin.freckles:
            colour = colour * np.exp(-freckle * (0.25, 0.5, 0.65)[channel])
        if skin.stubble:
            colour = colour + cover * ((0.055, 0.050, 0.050)[channel] - colour)
        if near:
            colour = colour + lip * (red[channel] * lip_tone - colour)
        values[..., a] = np.maximum(colour * shade, 0.002)
    relief[:] = bumps - 4e-4 * fold
    values[..., LIP], values[..., SEAM], values[..., OIL] = lip, seam, oil


def _noise(rng, shape, rows: slice, step: float, across_m: float, along_m: float) -> np.ndarray:
    """Smooth noise about 0 with spread 1, features across_m wide (along x) and along_m high, the same at every step.

    It is 0 outside of `rows`; the random numbers are used up all the same.
    """
    cells = [max(size * step / GRAIN_M, 1) for size in shape]
    # draw it no finer than it is
    k = [max(1.0, 0.5 * size / GRAIN_M) for size in (along_m, across_m)]
    small = [math.ceil(n / f) + 4 for n, f in zip(cells, k, strict=True)]
    field = rng.standard_normal(small, dtype=np.float32)
    values = np.zeros(shape, np.float32)
    if rows.start == rows.stop:
        return values
    field = cv2.GaussianBlur(field, (0, 0), 0.8, sigmaY=0.8)
    field /= field.std()
    # cubic interpolation at places that do not depend on the step
    down = (np.arange(shape[0], dtype=np.float32) + 0.5) * (step / GRAIN_M / k[0]) + 1
    columns = (np.arange(shape[1], dtype=np.float32) + 0.5) * (step / GRAIN_M / k[1]) + 1
    turn = np.array([[columns[1] - columns[0], 0, columns[0]], [0, down[1] - down[0], down[rows.start]]])
    size = (shape[1], rows.stop - rows.start)
    values[rows] = cv2.warpAffine(field, turn, size, flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP)
    return values


def _border(mouth: Mouth, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance to the border of the lips and the height of the line between them, m, over the texture."""
    if mouth.shape is not None:
        shape = mouth.shape
        line = line_y(shape, x)
        # the line's small waves end at the lips' edge: the lower border is a plain bow
        bow = shape.corner_rise_m * np.minimum(np.abs(x) / (shape.width_m / 2), 1.0) ** 2 + 0.0003
        border = border_distance(shape, x, np.where(y < line, y - bow + line, y))
        return border.astype(np.float32), line.astype(np.float32)
    from scipy.interpolate import LinearNDInterpolator

    nodes = np.unique(mouth.outer)
    at = mouth.nodes[nodes, :2]
    rough = LinearNDInterpolator(at, mouth.border_m[nodes], fill_value=-0.05)
    every = 4  # the mesh is far coarser than the texture
    border = rough(np.broadcast_to(x[:, ::every], (y[::every].shape[0], x[:, ::every].shape[1])), y[::every])
    border = cv2.resize(border.astype(np.float32), (x.shape[1], y.shape[0]), interpolation=cv2.INTER_LINEAR)
    middle = (mouth.nodes[mouth.upper[:, 0], :2] + mouth.nodes[mouth.lower[:, 0], :2]) / 2
    order = np.argsort(middle[:, 0])
    return border, np.interp(x, middle[order, 0], middle[order, 1]).astype(np.float32)


def _nose(x: np.ndarray, y: np.ndarray, light) -> tuple[np.ndarray, np.ndarray]:
    """Relief (m) and shade of the base of a nose: tip, wings, nostrils, and the shadow under it."""
    side = np.abs(x)
    # the lower rim of the nose: lowest at the middle, higher over the nostrils, down again at the wings
    rim = 0.0225 + 0.0030 * np.exp(-(((side - 0.0075) / 0.0035) ** 2))
    tip = 0.0105 * np.exp(-((side / 0.0095) ** 2)) * _smooth((y - 0.0225) / 0.011)
    wing = (
        0.0062 * np.exp(-(((side - 0.0125) / 0.0042) ** 2)) * _smooth((y - rim) / 0.006) * _smooth((0.0460 - y) / 0.014)
    )
    bridge = 0.006 * np.exp(-((side / 0.009) ** 2)) * _smooth((y - 0.034) / 0.02)
    # round the wings
    around = np.sqrt((side - 0.0115) ** 2 + (0.85 * (y - 0.0310)) ** 2)
    crease = (
        np.exp(-(((around - 0.0064) / 0.0015) ** 2)) * _smooth((side - 0.0120) / 0.004) * _smooth((y - 0.0245) / 0.004)
    )
    turn = (y - 0.0258) - 0.32 * (side - 0.0068)
    nostril = np.exp(-((((side - 0.0068) / 0.0036) ** 2 + (turn / 0.0016) ** 2) ** 2))
    under = np.exp(-((side / 0.0135) ** 2)) * np.exp(-(((y - 0.0215) / 0.0035) ** 2))
    # the longer the shadow, the higher the light stands
    steep = min(max(light[1] / (math.sqrt(sum(v * v for v in light)) + 1e-9), 0.0), 1.0)
    shade = (1 - 0.92 * nostril) * (1 - 0.25 * crease) * (1 - 0.40 * steep * under)
    return (tip + wing + bridge).astype(np.float32), shade.astype(np.float32)


def _beard(x: np.ndarray, y: np.ndarray, half: float) -> np.ndarray:
    """Where a beard grows, 0 to 1: upper lip, chin, jaw; not the middle below the nose nor high on the cheeks."""
    side = np.abs(x)
    moustache = _smooth((0.022 - y) / 0.006) * _smooth((half + 0.013 - side - 0.7 * np.maximum(y, 0)) / 0.016)
    line = 0.010 - 0.55 * np.maximum(side - half - 0.004, 0) + 1.2 * np.maximum(side - 0.048, 0)
    low = _smooth((line - 0.006 - y) / 0.014)
    bare = np.exp(-(((side - 0.016) / 0.006) ** 2) - ((y + 0.016) / 0.005) ** 2)
    return np.clip(np.where(y > 0, np.maximum(moustache, low), low + moustache * _smooth(1 - side / half)), 0, 1) * (
        1 - 0.6 * bare
    )


def _smooth(t: np.ndarray) -> np.ndarray:
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def _bell(t: np.ndarray) -> np.ndarray:
    return np.exp(-(t * t))
