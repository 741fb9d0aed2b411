"""Kernels that colour pixels: skin and lips, the inside of the mouth, both put together, and the camera's sensor.

All light is linear, 1 is white. Arrays and floats only. Places are (row, column) in px.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from simulator.simd import gather, load, maximum, minimum, scatter, square_root, store

# Channels of the skin's texture.
RED, GREEN, BLUE, OIL, SLOPE_X, SLOPE_Y, LIP, SEAM = range(8)
# Attributes of a vertex: unit normal, how closed the lips are there, place in the texture, px moved over the shutter.
NX, NY, NZ, CLOSED, TEX_X, TEX_Y, MOVED_ROW, MOVED_COLUMN = range(8)
LANES = 8  # numbers of a texel, of a vertex, and pixels that are lit at once


@njit(cache=True, nogil=True, error_model="numpy")
def shade_tissue(owner, bary, triangles, plain, attributes, wet, texture, axes, light, finish, backdrop, tissue, moved):
    """Colour every pixel that a triangle owns.

    owner (H, W), bary (2, H, W) from `draw_triangles`; triangles (T, 3); attributes (V, 8), see NX and on
    plain : (T,) whether a triangle is skin alone: neither lip nor near their line
    wet : (V,) 1 on the inner edges of the lips, which are wet and lie in shadow, else 0
    texture : (h, w, 8), see RED and on
    axes : (2, 3) the face's x and y axis in the camera's axes
    light : (6, 3) direction, half vector, colour, ambient colour, wrap of red, green and blue, seam's colour
    finish : sheen, wetness, gloss, seam
    backdrop : (H, 3) light of what is behind
    tissue : (H, W, 4) is filled with red, green and blue, as is moved (H, W, 2), px
    """
    height, width = owner.shape
    # numbers of one size: a mixture with 64 bits costs a third of the time
    zero, one = np.float32(0.0), np.float32(1.0)
    high, wide = np.float32(texture.shape[0] - 1.001), np.float32(texture.shape[1] - 1.001)
    below = LANES * texture.shape[1]  # from a texel to the one below it
    nothing = zero * load(attributes, 0)
    full = nothing + one
    # a row of pixels in short passes, so that the processor has many pixels in hand at once
    points, skins = np.zeros((2 * width, 4), np.float32), np.zeros((2 * width, 4), np.float32)
    texels, weights = np.zeros(width, np.int64), np.zeros((width, 2), np.float32)
    wets, lips = np.zeros(width, np.float32), np.zeros(width, np.bool_)
    first_half = np.arange(0, LANES * width, LANES).astype(np.int32)
    second_half, pixels = first_half + np.int32(4), first_half // np.int32(2)
    for row in range(height):
        behind = False
        for column in range(width):
            wets[column], lips[column] = zero, False
            if owner[row, column] < zero:
                store(points, LANES * column, nothing)
                behind = True
                continue
            t = np.uint32(owner[row, column])
            i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]  # unsigned: no look at negative indices
            u, v = bary[0, row, column], bary[1, row, column]
            w = one - u - v
            at_i, at_j, at_k = LANES * np.int64(i), LANES * np.int64(j), LANES * np.int64(k)
            point = w * load(attributes, at_i) + u * load(attributes, at_j) + v * load(attributes, at_k)
            store(points, LANES * column, point)
            if not plain[t]:
                wets[column], lips[column] = w * wet[i] + u * wet[j] + v * wet[k], True
        for column in range(width):
            place = points[2 * column + 1]
            tx, ty = min(max(place[TEX_X - 4], zero), wide), min(max(place[TEX_Y - 4], zero), high)
            c, r = np.int32(tx), np.int32(ty)
            texels[column] = below * np.int64(r) + LANES * np.int64(c)
            weights[column, 0], weights[column, 1] = tx - np.float32(c), ty - np.float32(r)
            moved[row, column, 0], moved[row, column, 1] = place[MOVED_ROW - 4], place[MOVED_COLUMN - 4]
        for column in range(width):
            at, fx, fy = texels[column], weights[column, 0], weights[column, 1]
            upper, lower = load(texture, at), load(texture, at + below)
            upper = upper + fx * (load(texture, at + LANES) - upper)
            lower = lower + fx * (load(texture, at + below + LANES) - lower)
            store(skins, LANES * column, upper + fy * (lower - upper))
        for column in range(0, width, LANES):
            c = min(column, width - LANES)  # the last ones overlap
            nx, ny, nz, closed = gather(points, first_half, c, 0)
            red, green, blue, oil = gather(skins, first_half, c, 0)
            slope_x, slope_y, lip, seam = gather(skins, second_half, c, 0)
            nx = nx - slope_x * axes[0, 0] - slope_y * axes[1, 0]
            ny = ny - slope_x * axes[0, 1] - slope_y * axes[1, 1]
            nz = nz - slope_x * axes[0, 2] - slope_y * axes[1, 2]
            norm = one / square_root(nx * nx + ny * ny + nz * nz + np.float32(1e-12))
            nx, ny, nz = nx * norm, ny * norm, nz * norm
            facing = nx * light[0, 0] + ny * light[0, 1] + nz * light[0, 2]
            sky = np.float32(0.72) + np.float32(0.28) * ny
            # below 0.55 the powers are as good as 0, and soon denormal, which is slow
            s = maximum(nx * light[1, 0] + ny * light[1, 1] + nz * light[1, 2], np.float32(0.55) * full)
            s4 = (s * s) * (s * s)
            s8 = s4 * s4
            shine = np.float32(0.16) * finish[0] * (np.float32(0.25) * s8 + s8 * s8) * oil
            away = one - minimum(maximum(nz, nothing), full)
            rim = np.float32(0.10) * away * away * away
            body, lip_here = full, False
            for n in range(c, c + LANES):
                lip_here |= lips[n]
            if lip_here:
                wetness, gloss = finish[1], finish[2]
                inner = load(wets, c)
                lip, dark = maximum(inner, lip), finish[3] * seam * closed
                body, light_up = one - np.float32(0.55) * inner, one - dark
                s16 = s8 * s8
                s64 = (s16 * s16) * (s16 * s16)
                silk = wetness * (one - gloss) * np.float32(0.30) * s16
                silk = silk + wetness * gloss * np.float32(0.9) * (s64 * s64) + wetness * np.float32(0.16) * s64
                shine = (shine + lip * (silk - shine)) * body * (one - np.float32(0.7) * dark)
                rim, sky = rim * light_up, sky * body
                red = red * light_up + dark * light[5, 0]
                green = green * light_up + dark * light[5, 1]
                blue = blue * light_up + dark * light[5, 2]
            red = _lit(red, facing, shine, sky, rim, body, light, 0)
            green = _lit(green, facing, shine, sky, rim, body, light, 1)
            blue = _lit(blue, facing, shine, sky, rim, body, light, 2)
            scatter(tissue[row], pixels, c, red, green, blue, nothing)
        if behind:
            for column in range(width):
                if owner[row, column] < zero:
                    for a in range(3):
                        tissue[row, column, a] = backdrop[row, a]


@njit(forceinline=True)
def _lit(colour, facing, shine, sky, rim, body, light, a):
    """Light of one colour, 0 to 2, that a surface throws back: soft light that reaches round it, sky, highlights."""
    sun, around, wrap = light[2, a], light[3, a], light[4, a]
    direct = maximum((facing + wrap) * (np.float32(1.0) / (np.float32(1.0) + wrap)), np.float32(0.0) * facing)
    direct = sun * direct * (np.float32(0.6) + np.float32(0.4) * direct) * body + around * sky
    return colour * direct + sun * shine + around * rim


@njit(cache=True, nogil=True, error_model="numpy")
def fill_between(owner, hole, film, box, tissue, moved, far):
    """Give every pixel seen between the lips the colour and movement of a tissue pixel near by, in tissue and moved.

    box : first and last + 1 row, first and last + 1 column; far (H, W) int32 is used up
    """
    top, bottom, left, right = box
    for row in range(top, bottom):
        for column in range(left, right):
            between = owner[row, column] < 0 and hole[row, column] + film[row, column] > 0
            far[row, column] = 1 << 20 if between else 0
    for way in range(2):
        for at_row in range(bottom - top):
            row = top + at_row if way == 0 else bottom - 1 - at_row
            for at_column in range(right - left):
                column = left + at_column if way == 0 else right - 1 - at_column
                best, from_row, from_column = far[row, column], row, column
                if best == 0:
                    continue
                step = -1 if way == 0 else 1
                if top <= row + step < bottom and far[row + step, column] + 1 < best:
                    best, from_row, from_column = far[row + step, column] + 1, row + step, column
                if left <= column + step < right and far[row, column + step] + 1 < best:
                    best, from_row, from_column = far[row, column + step] + 1, row, column + step
                if best < far[row, column]:
                    far[row, column] = best
                    for a in range(3):
                        tissue[row, column, a] = tissue[from_row, from_column, a]
                    moved[row, column, 0] = moved[from_row, from_column, 0]
                    moved[row, column, 1] = moved[from_row, from_column, 1]


@njit(cache=True, nogil=True, error_model="numpy")
def _hash(a: np.uint64) -> np.uint64:
    """A number from 0 to 2^64 - 1 that looks random (the finaliser of splitmix64, Steele et al. 2014)."""
    a = a + np.uint64(0x9E3779B97F4A7C15)
    a = (a ^ (a >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    a = (a ^ (a >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return a ^ (a >> np.uint64(31))


@njit(cache=True, nogil=True, error_model="numpy")
def shade_inside(hole, box, camera, jaw, shown, rows, upper, lower, colours, light, tongue, shadow, px_m, seed, inside):
    """Colour what is seen between the lips.

    hole : (H, W) cover; only pixels of `box` with some of it are coloured, in inside (H, W, 3)
    camera : (3, 6): turn from camera to face (3, 3), its middle (3,), (px/m, distance, -), (middle row, column, -)
    jaw : (3, 4) from the face to the jaw at rest
    shown : upper teeth, lower teeth, tongue
    rows : (2, 3) of upper and lower row: depth, radius of the arch, height of the edge, m
    upper, lower : (n, 5) over x from -0.04 to 0.04 m: edge, length (m), gap, tilt, brightness
    colours : (4, 3) teeth, gum, tongue, cavity
    light : (4, 3) direction in the face's axes, half vector, colour, ambient colour
    tongue : (2, 3) centre and half axes, m, in the jaw's axes
    shadow : strength; depth, m, over which the light fades; wetness
    px_m : size of a pixel, m
    """
    top, bottom, left, right = box
    scale, distance = camera[0, 4], camera[1, 4]
    middle_row, middle_column = camera[0, 5], camera[1, 5]
    below = np.zeros(right - left)  # px below the upper lip
    ends = np.zeros(right - left)
    colour, tooth = np.empty(3), np.empty(5)
    for row in range(top, bottom):
        for column in range(left, right):
            ends[column - left] += hole[row, column]
    for row in range(top, bottom):
        for column in range(left, right):
            seen = hole[row, column]
            if seen <= 0:
                below[column - left] = 0.0
                continue
            below[column - left] += seen
            sx, sy = (column - middle_column) / scale, (middle_row - row) / scale
            ox, oy, oz = camera[0, 3], camera[1, 3], camera[2, 3]  # the turned place of the picture's middle
            gx, gy, gz = 0.0, 0.0, 0.0
            ox += camera[0, 0] * sx + camera[0, 1] * sy
            oy += camera[1, 0] * sx + camera[1, 1] * sy
            oz += camera[2, 0] * sx + camera[2, 1] * sy
            gx = (camera[0, 0] * sx + camera[0, 1] * sy) / distance - camera[0, 2]
            gy = (camera[1, 0] * sx + camera[1, 1] * sy) / distance - camera[1, 2]
            gz = (camera[2, 0] * sx + camera[2, 1] * sy) / distance - camera[2, 2]
            jx = jaw[0, 0] * ox + jaw[0, 1] * oy + jaw[0, 2] * oz + jaw[0, 3]
            jy = jaw[1, 0] * ox + jaw[1, 1] * oy + jaw[1, 2] * oz + jaw[1, 3]
            jz = jaw[2, 0] * ox + jaw[2, 1] * oy + jaw[2, 2] * oz + jaw[2, 3]
            kx = jaw[0, 0] * gx + jaw[0, 1] * gy + jaw[0, 2] * gz
            ky = jaw[1, 0] * gx + jaw[1, 1] * gy + jaw[1, 2] * gz
            kz = jaw[2, 0] * gx + jaw[2, 1] * gy + jaw[2, 2] * gz
            # the cavity: an oval that grows darker towards its depth, lit a little at its walls
            t_back = (-0.045 - oz) / gz
            bx, by = ox + t_back * gx, oy + t_back * gy
            rise = min((bx / 0.030) ** 2 + ((by + 0.012) / 0.028) ** 2, 1.6)
            glow = 0.16 + 0.5 * rise
            for a in range(3):
                colour[a] = colours[3, a] * glow
            under = below[column - left] * px_m
            gap = ends[column - left] * px_m
            # light that comes past the upper lip, and less of it in a narrow gap
            lid = 1 - shadow[0] * math.exp(-under / (0.0035 + 0.15 * gap)) - 0.3 * shadow[0] * math.exp(-gap / 0.006)
            lid = max(lid, 0.05)
            fx, fy, fz, hx, hy, hz = ox, oy, oz, gx, gy, gz
            if shown[2] > 0:
                qx, qy, qz = jx - tongue[0, 0], jy - tongue[0, 1], jz - tongue[0, 2]
                aa = (kx / tongue[1, 0]) ** 2 + (ky / tongue[1, 1]) ** 2 + (kz / tongue[1, 2]) ** 2
                b = kx * qx / tongue[1, 0] ** 2 + ky * qy / tongue[1, 1] ** 2 + kz * qz / tongue[1, 2] ** 2
                c = (qx / tongue[1, 0]) ** 2 + (qy / tongue[1, 1]) ** 2 + (qz / tongue[1, 2]) ** 2 - 1
                root = b * b - aa * c
                # its outline is softened over about two pixels: root falls to 0 there
                edge = min(max(root / (aa * 4 * px_m / tongue[1, 1]), 0.0), 1.0)
                if edge > 0:
                    t = (-b - math.sqrt(max(root, 0.0))) / aa
                    x, y, z = qx + t * kx, qy + t * ky, qz + t * kz
                    nx, ny, nz = x / tongue[1, 0] ** 2, y / tongue[1, 1] ** 2, z / tongue[1, 2] ** 2
                    groove = math.exp(-((x / 0.0022) ** 2))
                    nx -= 0.25 * (x / 0.0022) * groove / tongue[1, 1]
                    cell = np.uint64(int((x + 0.1) / 0.0006) * 100003 + int((z + 0.2) / 0.0009)) ^ np.uint64(seed)
                    grain = (_hash(cell) & np.uint64(255)) / 255.0 - 0.5
                    length = 1 / math.sqrt(nx * nx + ny * ny + nz * nz)
                    nx, ny, nz = nx * length, ny * length, nz * length
                    lit = max(nx * light[0, 0] + ny * light[0, 1] + nz * light[0, 2] + 0.3, 0.0) / 1.3
                    shine = max(nx * light[1, 0] + ny * light[1, 1] + nz * light[1, 2] + 0.06 * grain, 0.0) ** 40
                    deep = math.exp(min(z + tongue[0, 2] + 0.012, 0.0) / shadow[1]) * lid
                    tone = (1 + 0.10 * grain) * (1 - 0.18 * groove)
                    for a in range(3):
                        value = colours[2, a] * (light[2, a] * lit + light[3, a]) * tone
                        value = (value + 0.14 * shadow[2] * light[2, a] * shine) * deep
                        colour[a] += edge * (value - colour[a])
            for side in range(2):  # the lower row, then the upper one before it
                which = 1 - side
                if shown[which] <= 0:
                    continue
                table = upper
                if which == 1:
                    table = lower
                    ox, oy, oz, gx, gy, gz = jx, jy, jz, kx, ky, kz
                else:
                    ox, oy, oz, gx, gy, gz = fx, fy, fz, hx, hy, hz
                # where the ray meets the front of the row
                t, x = 0.0, ox
                for _ in range(3):
                    x = ox + t * gx
                    t = (rows[which, 0] - x * x / (2 * rows[which, 1]) - oz) / gz
                x = ox + t * gx
                at = min(max((x + 0.04) / 0.08 * (len(table) - 1), 0.0), len(table) - 1.001)
                n = int(at)
                for a in range(5):
                    tooth[a] = table[n, a] + (at - n) * (table[n + 1, a] - table[n, a])
                on = (rows[which, 2] + tooth[0] - oy - t * gy) * (1.0 if which == 1 else -1.0)  # beyond its edge, m
                cover = min(max(on / px_m + 0.5, 0.0), 1.0)
                if abs(x) > 0.038:
                    cover = 0.0
                if cover <= 0:
                    continue
                length = tooth[1]
                gum = min(max((on - length) / (px_m + 0.0004) + 0.5, 0.0), 1.0)
                part = min(max(on / length, 0.0), 1.0)
                nx = tooth[3] * (1 - gum) + x / rows[which, 1]
                ny = (0.45 * (1 - part) ** 2 - 0.15 * part) * (-1.0 if which == 0 else 1.0)
                if gum > 0:
                    ny = 0.3 * (1.0 if which == 1 else -1.0)
                norm = 1 / math.sqrt(nx * nx + ny * ny + 1)
                nx, ny, nz = nx * norm, ny * norm, norm
                lit = max(nx * light[0, 0] + ny * light[0, 1] + nz * light[0, 2] + 0.45, 0.0) / 1.45
                shine = max(nx * light[1, 0] + ny * light[1, 1] + nz * light[1, 2], 0.0) ** 60
                deep = math.exp(-(x * x) / (2 * rows[which, 1]) / shadow[1]) * lid
                if which == 1:
                    deep *= 0.85
                dark = tooth[2] * (1 - 0.6 * part)
                tone = tooth[4] * (0.90 + 0.10 * min(part * 4, 1.0)) * (1 - dark)
                for a in range(3):
                    warm = 1.0 - 0.10 * part * a  # yellower towards the gum
                    body = 1.12 * colours[0, a] * tone * warm * (1 - gum) + colours[1, a] * gum
                    value = (body * (light[2, a] * lit + light[3, a]) + 0.22 * light[2, a] * shine) * deep
                    colour[a] += cover * (value - colour[a])
            for a in range(3):
                inside[row, column, a] = colour[a]


@njit(cache=True, nogil=True, error_model="numpy")
def smear(tissue, moved, samples, out):
    """The mean of tissue (H, W, 4) along each pixel's movement (H, W, 2), px, in out (H, W, 4)."""
    height, width = tissue.shape[:2]
    zero, half = np.float32(0.0), np.float32(0.5)
    lowest, rightmost = np.float32(height - 1.01), np.float32(width - 1.01)
    sums = np.empty((4, 4), np.float32)
    for row in range(height):
        for column in range(width):
            dy, dx = moved[row, column, 0], moved[row, column, 1]
            length = max(abs(dy), abs(dx))
            if length <= np.float32(0.3):
                for a in range(4):
                    out[row, column, a] = tissue[row, column, a]
                continue
            count = min(int(length) + 2, samples)
            each = np.float32(1.0) / np.float32(count)
            # of a pixel and its right neighbour, and of both times how near the place is to the latter
            pair, nearer = zero * load(tissue, 0), zero * load(tissue, 0)
            for s in range(count):
                share = (np.float32(s) + half) * each - half
                y = min(max(np.float32(row) - dy * share, zero), lowest)
                x = min(max(np.float32(column) - dx * share, zero), rightmost)
                r, c = np.int32(y), np.int32(x)
                at = 4 * (np.int64(r) * width + np.int64(c))
                above = load(tissue, at)
                both = above + (y - np.float32(r)) * (load(tissue, at + 4 * width) - above)
                pair = pair + both
                nearer = nearer + (x - np.float32(c)) * both
            store(sums, 0, pair - nearer)
            store(sums, 8, nearer)
            for a in range(4):
                out[row, column, a] = each * (sums[0, a] + sums[3, a])


@njit(cache=True, nogil=True, error_model="numpy")
def compose(linear, inside, hole, film, film_colour, box):
    """Mix what is seen between the lips and the saliva there into linear (H, W, 3) by their cover."""
    top, bottom, left, right = box
    for row in range(top, bottom):
        for column in range(left, right):
            h, f = hole[row, column], film[row, column]
            if h + f > 0:
                rest = max(np.float32(1.0) - h - f, np.float32(0.0))
                for a in range(3):
                    between = h * inside[row, column, a] + f * film_colour[a]
                    linear[row, column, a] = rest * linear[row, column, a] + between


@njit(cache=True, nogil=True, error_model="numpy")
def develop(linear, lens, gains, noise, read_noise, vignette, grain, seed, curve, picture):
    """8-bit picture (H, W, 3) of linear light (H, W, 4): lens, exposure and cast, vignette, noise, sRGB curve.

    lens : (2 n + 1,) weights of the pixels of a row or column around each; beyond the rim it is as there
    gains : (4,) factors of the colours
    noise, read_noise : at light v the noise has the spread sqrt(noise^2 v + read_noise^2)
    grain : (n,) normal random numbers, n > 4 W; a row's noise is the sum of two stretches of it, at places that depend
        on seed and row alone
    curve : (m,) uint8 over light from 0 to 1
    """
    height, width = linear.shape[:2]
    numbers, reach = 4 * width, len(lens) // 2
    factor, fall = np.empty(numbers, np.float32), np.empty(numbers, np.float32)
    for n in range(numbers):
        x = (n // 4 - (width - 1) / 2) * 2 / max(height, width)
        factor[n], fall[n] = gains[n % 4], gains[n % 4] * vignette / 2 * x * x
    shot, dark = np.float32(noise**2 / 2), np.float32(read_noise**2 / 2)  # halves: two stretches
    line, light = np.empty(numbers + 8 * reach, np.float32), np.empty(numbers, np.float32)
    scale = np.float32(len(curve) - 1)
    nothing = np.float32(0.0) * load(factor, 0)
    full = nothing + np.float32(1.0)
    for row in range(height):
        for number in range(0, numbers, LANES):
            n = min(number, numbers - LANES)  # the last ones overlap
            seen = nothing
            for k in range(len(lens)):
                seen = seen + lens[k] * load(linear, min(max(row + k - reach, 0), height - 1) * numbers + n)
            store(line, 4 * reach + n, seen)
        for n in range(4 * reach):
            line[n], line[4 * reach + numbers + n] = line[4 * reach + n % 4], line[4 * reach + numbers - 4 + n % 4]
        y = (row - (height - 1) / 2) * 2 / max(height, width)
        middle = np.float32(1 - vignette / 2 * y * y)
        bits, stretches = _hash(np.uint64(seed) + np.uint64(row)), np.uint64(len(grain) - numbers)
        one, other = np.int64((bits >> np.uint64(32)) % stretches), np.int64((bits & np.uint64(0xFFFFFFFF)) % stretches)
        for number in range(0, numbers, LANES):
            n = min(number, numbers - LANES)
            seen = nothing
            for k in range(len(lens)):
                seen = seen + lens[k] * load(line, n + 4 * k)
            seen = maximum(seen * (middle * load(factor, n) - load(fall, n)), nothing)
            seen = seen + (load(grain, one + n) + load(grain, other + n)) * square_root(shot * seen + dark)
            store(light, n, scale * minimum(maximum(seen, nothing), full) + np.float32(0.5))
        for column in range(width):
            for a in range(3):
                picture[row, column, a] = curve[np.int32(light[4 * column + a])]
