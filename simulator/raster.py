"""Kernels that turn triangles and lip edges into pixels: smooth normals, depth buffer, exact cover of the opening.

Places are (row, column) in px, the origin at the centre of pixel (0, 0). Arrays and floats only.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from simulator.simd import choose, lanes, load, minimum, splat, store


@njit(cache=True, nogil=True, error_model="numpy")
def vertex_normals(points: np.ndarray, quads: np.ndarray, weight: np.ndarray, normals: np.ndarray) -> None:
    """Unit normals (V, 3) of points (V, 3): mean over the quads (Q, 4) at each, by area and weight (Q,).

    A quad's own normal is across its diagonals, so that none of them is favoured.
    """
    normals[:] = 0.0
    for q in range(len(quads)):
        i, j, k, n = quads[q]
        ax, ay, az = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1], points[k, 2] - points[i, 2]
        bx, by, bz = points[n, 0] - points[j, 0], points[n, 1] - points[j, 1], points[n, 2] - points[j, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        w = weight[q]
        for corner in (i, j, k, n):
            normals[corner, 0] += w * nx
            normals[corner, 1] += w * ny
            normals[corner, 2] += w * nz
    for v in range(len(normals)):
        length = math.sqrt(normals[v, 0] ** 2 + normals[v, 1] ** 2 + normals[v, 2] ** 2)
        if length > 1e-30:
            normals[v, 0] /= length
            normals[v, 1] /= length
            normals[v, 2] /= length
        else:
            normals[v, 2] = 1.0


_SLACK = np.float32(1e-5)  # far above rounding: triangles that share an edge leave no gap along it


@njit(cache=True, nogil=True, error_model="numpy")
def draw_triangles(
    places: np.ndarray, depth: np.ndarray, triangles: np.ndarray, nearest: np.ndarray, owner: np.ndarray, bary
) -> None:
    """Which triangle is nearest at the centre of each pixel, and where in it.

    places (V, 2) row and column, px; depth (V,) larger is nearer; triangles (T, 3) counter-clockwise as seen, fewer
    than 2^24. Fills nearest (H, W), owner (H, W) triangle or -1, and bary (2, H, W) weights of its second and third
    corner, all float32; pictures are 8 or more px wide.
    """
    height, width = owner.shape
    nearest[:] = -np.inf
    owner[:] = -1
    # a vector of neighbours along the row at once: few triangles are wider
    numbers = np.arange(lanes(nearest)).astype(np.float32)
    steps = load(numbers, 0)
    for t in range(len(triangles)):
        i, j, k = triangles[t]
        y0, x0 = places[i, 0], places[i, 1]
        y1, x1 = places[j, 0] - y0, places[j, 1] - x0
        y2, x2 = places[k, 0] - y0, places[k, 1] - x0
        area = x2 * y1 - x1 * y2  # rows run downwards
        if not area > 1e-12:
            continue
        top, bottom = min(0.0, y1, y2) + y0, max(0.0, y1, y2) + y0
        left, right = min(0.0, x1, x2) + x0, max(0.0, x1, x2) + x0
        if bottom < 0 or right < 0 or top > height - 1 or left > width - 1:
            continue
        first, last = max(math.ceil(top), 0), min(math.floor(bottom), height - 1)
        begin, end = max(math.ceil(left), 0), min(math.floor(right), width - 1)
        z0, z1, z2 = depth[i], depth[j] - depth[i], depth[k] - depth[i]
        over = 1.0 / area
        me = splat(steps, t)
        for column in range(begin, end + 1, len(numbers)):
            place = min(column, width - len(numbers))
            # weights of the second and the third corner in the first row, and how they change downwards
            x, y = place - x0, first - y0
            first_u = (x2 * y - y2 * x) * over - y2 * over * steps
            first_v = (y1 * x - x1 * y) * over + y1 * over * steps
            down_u, down_v = np.float32(x2 * over), np.float32(x1 * over)
            for row in range(first, last + 1):
                down = np.float32(row - first)
                u, v = first_u + down * down_u, first_v - down * down_v
                z = z0 + z1 * u + z2 * v
                at = row * width + place
                # all is read before any is written: the processor waits where a place is alike but for its page
                before, other = load(nearest, at), load(owner, at)
                other_u, other_v = load(bary, at), load(bary, at + height * width)
                # above 0 where inside and nearer
                seen = minimum(minimum(minimum(u, v), 1.0 - u - v) + _SLACK, z - before)
                store(nearest, at, choose(seen, z, before))
                store(owner, at, choose(seen, me, other))
                store(bary, at, choose(seen, u, other_u))
                store(bary, at + height * width, choose(seen, v, other_v))


@njit(cache=True, nogil=True, error_model="numpy")
def _add_edge(start, end, weight, cover) -> None:
    """Add an edge's signed share to cover (H, W + 2), whose running sum along a row is then the covered area."""
    height, width = cover.shape[0], cover.shape[1] - 2
    y0, x0, y1, x1 = start[0] + 0.5, start[1] + 0.5, end[0] + 0.5, end[1] + 0.5
    if y0 == y1:
        return
    if y0 > y1:
        y0, x0, y1, x1, weight = y1, x1, y0, x0, -weight
    slope = (x1 - x0) / (y1 - y0)
    for row in range(max(math.floor(y0), 0), min(math.ceil(y1), height)):
        a, b = max(y0, float(row)), min(y1, row + 1.0)
        if b <= a:
            continue
        xa = min(max(x0 + slope * (a - y0), 0.0), float(width))
        xb = min(max(x0 + slope * (b - y0), 0.0), float(width))
        share = weight * (b - a)
        low, high = min(xa, xb), max(xa, xb)
        first, last = int(low), int(high)
        if first == last:
            right = (low + high) / 2 - first  # part of the pixel that lies left of the edge
            cover[row, first] += share * (1 - right)
            cover[row, first + 1] += share * right
        else:
            per_px = share / (high - low)
            before = 0.0  # area so far, right of the edge, of the pixels up to this one
            for column in range(first, last + 1):
                enter, leave = max(low, float(column)), min(high, column + 1.0)
                passed = (leave - enter) * per_px
                inside = (enter - low) * per_px + passed * (1 - ((enter + leave) / 2 - column))
                cover[row, column] += inside - before
                before = inside
            cover[row, last + 1] += share - before


@njit(cache=True, nogil=True, error_model="numpy")
def add_polygons(points: np.ndarray, start: np.ndarray, weight: float, cover: np.ndarray) -> None:
    """Add the exactly covered area of every pixel by some polygons to cover (H, W + 2), before the running sum.

    points : (P, 2) row and column of all corners, px; polygon k has start[k] up to start[k + 1]
    weight : of the area; positive where the corners run counter-clockwise as seen
    """
    for k in range(len(start) - 1):
        for i in range(start[k], start[k + 1]):
            j = i + 1 if i + 1 < start[k + 1] else start[k]
            _add_edge(points[i], points[j], weight, cover)


@njit(cache=True, nogil=True, error_model="numpy")
def sum_cover(cover: np.ndarray, rows: tuple[int, int], area: np.ndarray) -> None:
    """area (H, W) of the rows [from, to) from what the edges added to cover (H, W + 2), which is cleared there."""
    for row in range(rows[0], rows[1]):
        total = 0.0
        for column in range(area.shape[1]):
            total += cover[row, column]
            cover[row, column] = 0.0
            area[row, column] = min(max(total, 0.0), 1.0)
        cover[row, area.shape[1]] = 0.0
        cover[row, area.shape[1] + 1] = 0.0
