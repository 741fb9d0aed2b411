"""Kernels that colour pixels: skin and lips, the inside of the mouth, both put together, and the camera's sensor.

All light is linear, 1 is white. Arrays and floats only. Places are (row, column) in px.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

# Channels of the skin's texture.
RED, GREEN, BLUE, SLOPE_X, SLOPE_Y, LIP, SEAM, OIL = range(8)
# Attributes of a vertex: unit normal, place in the texture, how closed the lips are there, light, wetness.
NX, NY, NZ, TEX_X, TEX_Y, CLOSED, SHADE, WET = range(8)


@njit(cache=True, nogil=True, error_model="numpy")
def shade_tissue(
    owner, bary, triangles, plain, attributes, velocity, texture, axes, light, finish, backdrop, moves, tissue, moved
):
    """Colour every pixel that a triangle owns.

    owner (H, W), bary (H, W, 2) from `draw_triangles`; triangles (T, 3); attributes (V, 8), see NX and on
    plain : (T,) whether a triangle is skin alone: neither lip nor near their line
    velocity : (V, 2) px moved while the shutter is open
    texture : (h, w, 8), see RED and on
    axes : (2, 3) the face's x and y axis in the camera's axes
    light : (6, 3) direction, half vector, colour, ambient colour, wrap of red, green and blue, seam's colour
    finish : sheen, wetness, gloss, seam; moves : whether to fill moved
    backdrop : (H, 3) light of what is behind
    tissue : (H, W, 3) is filled, as is moved (H, W, 2), px
    """
    height, width = owner.shape
    # numbers of one size: a mixture with 64 bits costs a third of the time
    zero, one = np.float32(0.0), np.float32(1.0)
    high, wide = np.float32(texture.shape[0] - 1.001), np.float32(texture.shape[1] - 1.001)
    lx, ly, lz = light[0]
    hx, hy, hz = light[1]
    ax, ay, az = axes[0]
    bx, by, bz = axes[1]
    seam_r, seam_g, seam_b = light[5]
    sheen, wetness, gloss, seam = finish
    sheen *= np.float32(0.16)
    silk, wet = wetness * (one - gloss) * np.float32(0.30), wetness * gloss * np.float32(0.9)
    wetness *= np.float32(0.16)
    soft, hard = np.float32(0.6), np.float32(0.4)
    # numbers of a row, so that the light, which is the same sum for every pixel, is reckoned on many pixels at once
    rows = np.empty((13, width), np.float32)
    at, skin = np.empty(8, np.float32), np.empty(8, np.float32)
    nx, ny, nz, norm = rows[0], rows[1], rows[2], rows[3]
    red, green, blue, oil = rows[4], rows[5], rows[6], rows[7]
    facing, shine, sky, rim, body = rows[8], rows[9], rows[10], rows[11], rows[12]
    lips, lip, dark = np.empty(width, np.int64), np.empty(width, np.float32), np.empty(width, np.float32)
    for row in range(height):
        count = 0
        for column in range(width):
            body[column] = one
            if owner[row, column] < 0:
                nx[column], ny[column], nz[column] = zero, zero, one
                red[column], green[column], blue[column], oil[column] = zero, zero, zero, zero
                moved[row, column, 0] = zero
                moved[row, column, 1] = zero
                continue
            t = np.uint32(owner[row, column])
            i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]  # unsigned: no look at negative indices
            u, v = bary[row, column, 0], bary[row, column, 1]
            w = one - u - v
            # eight alike, read and written side by side: one instruction does them all
            v0 = w * attributes[i, 0] + u * attributes[j, 0] + v * attributes[k, 0]
            v1 = w * attributes[i, 1] + u * attributes[j, 1] + v * attributes[k, 1]
            v2 = w * attributes[i, 2] + u * attributes[j, 2] + v * attributes[k, 2]
            v3 = w * attributes[i, 3] + u * attributes[j, 3] + v * attributes[k, 3]
            v4 = w * attributes[i, 4] + u * attributes[j, 4] + v * attributes[k, 4]
            v5 = w * attributes[i, 5] + u * attributes[j, 5] + v * attributes[k, 5]
            v6 = w * attributes[i, 6] + u * attributes[j, 6] + v * attributes[k, 6]
            v7 = w * attributes[i, 7] + u * attributes[j, 7] + v * attributes[k, 7]
            at[0], at[1], at[2], at[3], at[4], at[5], at[6], at[7] = v0, v1, v2, v3, v4, v5, v6, v7
            if moves:
                moved[row, column, 0] = w * velocity[i, 0] + u * velocity[j, 0] + v * velocity[k, 0]
                moved[row, column, 1] = w * velocity[i, 1] + u * velocity[j, 1] + v * velocity[k, 1]
            tx, ty = min(max(at[TEX_X], zero), wide), min(max(at[TEX_Y], zero), high)
            c, r = np.uint32(tx), np.uint32(ty)
            fx, fy = tx - np.float32(c), ty - np.float32(r)
            w11 = fx * fy
            w01, w10 = fx - w11, fy - w11
            w00 = one - fx - w10
            r1, c1 = r + np.uint32(1), c + np.uint32(1)
            v0 = w00 * texture[r, c, 0] + w01 * texture[r, c1, 0] + w10 * texture[r1, c, 0] + w11 * texture[r1, c1, 0]
            v1 = w00 * texture[r, c, 1] + w01 * texture[r, c1, 1] + w10 * texture[r1, c, 1] + w11 * texture[r1, c1, 1]
            v2 = w00 * texture[r, c, 2] + w01 * texture[r, c1, 2] + w10 * texture[r1, c, 2] + w11 * texture[r1, c1, 2]
            v3 = w00 * texture[r, c, 3] + w01 * texture[r, c1, 3] + w10 * texture[r1, c, 3] + w11 * texture[r1, c1, 3]
            v4 = w00 * texture[r, c, 4] + w01 * texture[r, c1, 4] + w10 * texture[r1, c, 4] + w11 * texture[r1, c1, 4]
            v5 = w00 * texture[r, c, 5] + w01 * texture[r, c1, 5] + w10 * texture[r1, c, 5] + w11 * texture[r1, c1, 5]
            v6 = w00 * texture[r, c, 6] + w01 * texture[r, c1, 6] + w10 * texture[r1, c, 6] + w11 * texture[r1, c1, 6]
            v7 = w00 * texture[r, c, 7] + w01 * texture[r, c1, 7] + w10 * texture[r1, c, 7] + w11 * texture[r1, c1, 7]
            skin[0], skin[1], skin[2], skin[3], skin[4], skin[5], skin[6], skin[7] = v0, v1, v2, v3, v4, v5, v6, v7
            red[column], green[column], blue[column], oil[column] = skin[RED], skin[GREEN], skin[BLUE], skin[OIL]
            sx, sy = skin[SLOPE_X], skin[SLOPE_Y]
            nx[column] = at[NX] - sx * ax - sy * bx
            ny[column] = at[NY] - sx * ay - sy * by
            nz[column] = at[NZ] - sx * az - sy * bz
            if not plain[t]:
                lips[count] = column
                lip[count] = max(at[WET], skin[LIP])
                dark[count] = seam * skin[SEAM] * at[CLOSED]
                body[column] = at[SHADE]
                count += 1
        for c in range(width):
            norm[c] = one / np.sqrt(nx[c] * nx[c] + ny[c] * ny[c] + nz[c] * nz[c] + np.float32(1e-12))
        for c in range(width):
            facing[c] = (nx[c] * lx + ny[c] * ly + nz[c] * lz) * norm[c]
            sky[c] = np.float32(0.72) + np.float32(0.28) * ny[c] * norm[c]
        for c in range(width):
            # below 0.55 the powers are as good as 0, and soon denormal, which is slow
            s = max((nx[c] * hx + ny[c] * hy + nz[c] * hz) * norm[c], np.float32(0.55))
            s2 = s * s
            s4 = s2 * s2
            s8 = s4 * s4
            shine[c] = sheen * (np.float32(0.25) * s8 + s8 * s8) * oil[c]
        for c in range(width):
            away = one - min(max(nz[c] * norm[c], zero), one)
            rim[c] = np.float32(0.10) * away * away * away
        for n in range(count):
            c = lips[n]
            s = max((nx[c] * hx + ny[c] * hy + nz[c] * hz) * norm[c], np.float32(0.55))
            s16 = s * s
            s16 *= s16
            s16 *= s16
            s16 *= s16
            s64 = s16 * s16
            s64 *= s64
            light_up = one - dark[n]
            shine[c] += lip[n] * (silk * s16 + wet * s64 * s64 + wetness * s64 - shine[c])
            shine[c] *= body[c] * (one - np.float32(0.7) * dark[n])
            rim[c] *= light_up
            sky[c] *= body[c]
            red[c] = red[c] * light_up + dark[n] * seam_r
            green[c] = green[c] * light_up + dark[n] * seam_g
            blue[c] = blue[c] * light_up + dark[n] * seam_b
        for a in range(3):
            colour, sun, around, wrap = rows[4 + a], light[2, a], light[3, a], light[4, a]
            over = one / (one + wrap)
            for c in range(width):
                lit = max((facing[c] + wrap) * over, zero)
                lit = sun * lit * (soft + hard * lit) * body[c] + around * sky[c]
                colour[c] = colour[c] * lit + sun * shine[c] + around * rim[c]
        for c in range(width):
            if owner[row, c] < 0:
                red[c], green[c], blue[c] = backdrop[row, 0], backdrop[row, 1], backdrop[row, 2]
            tissue[row, c, 0], tissue[row, c, 1], tissue[row, c, 2] = red[c], green[c], blue[c]


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
    """The mean of tissue (H, W, 3) along each pixel's movement (H, W, 2), px, in out (H, W, 3)."""
    height, width = tissue.shape[:2]
    zero, half = np.float32(0.0), np.float32(0.5)
    lowest, rightmost = np.float32(height - 1.01), np.float32(width - 1.01)
    for row in range(height):
        for column in range(width):
            dy, dx = moved[row, column, 0], moved[row, column, 1]
            length = max(abs(dy), abs(dx))
            if length <= np.float32(0.3):
                for a in range(3):
                    out[row, column, a] = tissue[row, column, a]
                continue
            count = min(int(length) + 2, samples)
            each = np.float32(1.0) / np.float32(count)
            red, green, blue = zero, zero, zero
            for s in range(count):
                share = (np.float32(s) + half) * each - half
                y = min(max(np.float32(row) - dy * share, zero), lowest)
                x = min(max(np.float32(column) - dx * share, zero), rightmost)
                r, c = np.uint32(y), np.uint32(x)
                fy, fx = y - np.float32(r), x - np.float32(c)
                w11 = fx * fy
                w01, w10 = fx - w11, fy - w11
                w00 = np.float32(1.0) - fx - w10
                r1, c1 = r + np.uint32(1), c + np.uint32(1)
                red += w00 * tissue[r, c, 0] + w01 * tissue[r, c1, 0] + w10 * tissue[r1, c, 0] + w11 * tissue[r1, c1, 0]
                green += w00 * tissue[r, c, 1] + w01 * tissue[r, c1, 1]
                green += w10 * tissue[r1, c, 1] + w11 * tissue[r1, c1, 1]
                blue += w00 * tissue[r, c, 2] + w01 * tissue[r, c1, 2]
                blue += w10 * tissue[r1, c, 2] + w11 * tissue[r1, c1, 2]
            out[row, column, 0], out[row, column, 1], out[row, column, 2] = red * each, green * each, blue * each


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
def develop(linear, gains, noise, read_noise, vignette, seed, curve, picture):
    """8-bit picture (H, W, 3) of linear light (H, W, 3): exposure and cast, vignette, noise, sRGB curve.

    The noise of a pixel depends on seed and its place alone: Irwin-Hall numbers of three 7-bit parts, spread
    sqrt(noise^2 v + read_noise^2) at light v. curve : (n,) uint8 over light from 0 to 1.
    """
    height, width = linear.shape[:2]
    zero, one = np.float32(0.0), np.float32(1.0)
    scale = np.float32(len(curve) - 1)
    noisy = noise > 0 or read_noise > 0
    # parts from 0 to 127: mean of three 190.5, variance of three 3 (128^2 - 1) / 12
    spread = 1 / math.sqrt(3 * (128**2 - 1) / 12)
    shot, dark = np.float32((noise * spread) ** 2), np.float32((read_noise * spread) ** 2)
    start = _hash(np.uint64(seed))
    bits = np.uint64(0)
    gain = one
    for row in range(height):
        y = (row - (height - 1) / 2) * 2 / max(height, width)
        for column in range(width):
            if vignette > 0:
                x = (column - (width - 1) / 2) * 2 / max(height, width)
                gain = np.float32(1 - vignette * min((x * x + y * y) / 2, 1.0))
            if noisy:
                bits = _hash(start + np.uint64(row * width + column))
            for a in range(3):
                v = max(linear[row, column, a] * gain * gains[a], zero)
                if noisy:
                    total = np.int32(bits & np.uint64(127)) + np.int32((bits >> np.uint64(7)) & np.uint64(127))
                    total += np.int32((bits >> np.uint64(14)) & np.uint64(127))
                    bits = bits >> np.uint64(21)
                    v = max(v + (np.float32(total) - np.float32(190.5)) * np.sqrt(shot * v + dark), zero)
                picture[row, column, a] = curve[np.uint32(min(v, one) * scale + np.float32(0.5))]
