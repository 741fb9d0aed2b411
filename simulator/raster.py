"""Kernels that turn triangles and lip edges into pixels: smooth normals, depth buffer, exact cover of the opening.

Places are (row, column) in px, the origin at the centre of pixel (0, 0). Arrays and floats only.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def vertex_normals(points: np.ndarray, triangles: np.ndarray, weight: np.ndarray, normals: np.ndarray) -> None:
    """Unit normals (V, 3) of points (V, 3): mean over the triangles (T, 3) at each, by area and weight (T,)."""
    normals[:] = 0.0
    for t in range(len(triangles)):
        i, j, k = triangles[t]
        ax, ay, az = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
        bx, by, bz = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1], points[k, 2] - points[i, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        w = weight[t]
        for corner in (i, j, k):
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


@njit(cache=True, nogil=True)
def draw_triangles(
    places: np.ndarray, depth: np.ndarray, triangles: np.ndarray, nearest: np.ndarray, owner: np.ndarray, bary
) -> None:
    """Which triangle is nearest at the centre of each pixel, and where in it.

    places (V, 2) row and column, px; depth (V,) larger is nearer; triangles (T, 3) counter-clockwise as seen.
    Fills nearest (H, W), owner (H, W) triangle or -1, and bary (H, W, 2) weights of its second and third corner.
    """
    height, width = owner.shape
    nearest[:] = -np.inf
    owner[:] = -1
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
        # weights of the second and the third corner, and how they change along a row
        du, dv = -y2 * over, y1 * over
        for row in range(first, last + 1):
            y = row - y0
            u0 = (x2 * y + y2 * x0) * over
            v0 = -(x1 * y + y1 * x0) * over
            reached = False
            for column in range(begin, end + 1):
                u, v = u0 + du * column, v0 + dv * column
                if u >= -1e-9 and v >= -1e-9 and u + v <= 1.0 + 1e-9:
                    reached = True
                    z = z0 + u * z1 + v * z2
                    if z > nearest[row, column]:
                        nearest[row, column] = z
                        owner[row, column] = t
                        bary[row, column, 0] = u
                        bary[row, column, 1] = v
                elif reached:
                    break


@njit(cache=True, nogil=True)
def _add_edge(row0, column0, row1, column1, weight, cover) -> None:
    """Add an edge's signed share to cover (H, W + 2), whose running sum along a row is then the covered area."""
    height, width = cover.shape[0], cover.shape[1] - 2
    y0, x0, y1, x1 = row0 + 0.5, column0 + 0.5, row1 + 0.5, column1 + 0.5
    if y0 == y1:
        return
    if y0 > y1:
        y0, x0, y1, x1, weight = y1, x1, y0, x0, -weight
    slope = (x1 - x0) / (y1 - y0)
    for row in range(max(int(math.floor(y0)), 0), min(int(math.ceil(y1)), height)):
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


@njit(cache=True, nogil=True)
def _at(line: np.ndarray, at: int, x: float) -> float:
    """Height of a polyline (n, 2) of (row, column) at column x on its piece `at`."""
    x0, x1 = line[at, 1], line[at + 1, 1]
    t = (x - x0) / (x1 - x0) if x1 > x0 else 0.0
    return line[at, 0] + t * (line[at + 1, 0] - line[at, 0])


@njit(cache=True, nogil=True)
def add_opening(edges, middle, breaks, opacity, cos, sin, centre_row, centre_column, weight, cover) -> None:
    """Add the exactly covered area of every pixel by what is seen between the lips, before the running sum.

    The region lies between the lower of the upper lip's outer and inner edge and the higher of the lower lip's.

    edges : (4, n, 2) row, column of upper outer, upper inner, lower outer and lower inner edge in the picture turned
        upright, px; columns do not fall
    middle : (n,) columns at which the elements end
    breaks : columns of all of these, rising
    opacity : (n - 1,) of the film in each element, 0 where it is broken
    cos, sin, centre_row, centre_column : turn from upright to the picture, about its centre
    weight : of this opening; the sum over the places of a blurred one is 1
    cover : (2, H, W + 2) is added to: what is seen through, and what the saliva hides
    """
    n = edges.shape[1]
    begin = max(edges[0, 0, 1], edges[1, 0, 1], edges[2, 0, 1], edges[3, 0, 1])
    end = min(edges[0, n - 1, 1], edges[1, n - 1, 1], edges[2, n - 1, 1], edges[3, n - 1, 1])
    at = np.zeros(4, np.int64)
    element = 0
    cuts = np.empty(4)
    for b in range(len(breaks) - 1):
        x0, x1 = max(breaks[b], begin), min(breaks[b + 1], end)
        if not x1 > x0:
            continue
        centre = (x0 + x1) / 2
        for e in range(4):
            while at[e] < n - 2 and edges[e, at[e] + 1, 1] <= centre:
                at[e] += 1
        while element < n - 2 and middle[element + 1] <= centre:
            element += 1
        uo0, uo1 = _at(edges[0], at[0], x0), _at(edges[0], at[0], x1)
        ui0, ui1 = _at(edges[1], at[1], x0), _at(edges[1], at[1], x1)
        lo0, lo1 = _at(edges[2], at[2], x0), _at(edges[2], at[2], x1)
        li0, li1 = _at(edges[3], at[3], x0), _at(edges[3], at[3], x1)
        if min(lo0, li0) <= max(uo0, ui0) and min(lo1, li1) <= max(uo1, ui1):
            continue
        # between the places where outer and inner edges cross, the region is a trapezium, a triangle or nothing
        cuts[0], count = 0.0, 1
        for p0, p1 in ((ui0 - uo0, ui1 - uo1), (li0 - lo0, li1 - lo1)):
            if p0 * p1 < 0:
                cuts[count] = p0 / (p0 - p1)
                count += 1
        cuts[count] = 1.0
        if count == 3 and cuts[1] > cuts[2]:
            cuts[1], cuts[2] = cuts[2], cuts[1]
        for c in range(count):
            a, z = cuts[c], cuts[c + 1]
            top_a = max(uo0 + a * (uo1 - uo0), ui0 + a * (ui1 - ui0))
            top_z = max(uo0 + z * (uo1 - uo0), ui0 + z * (ui1 - ui0))
            low_a = min(lo0 + a * (lo1 - lo0), li0 + a * (li1 - li0))
            low_z = min(lo0 + z * (lo1 - lo0), li0 + z * (li1 - li0))
            gap_a, gap_z = low_a - top_a, low_z - top_z
            if gap_a <= 0 and gap_z <= 0:
                continue
            if gap_a < 0 or gap_z < 0:
                s = gap_a / (gap_a - gap_z)
                if gap_a < 0:
                    a += s * (z - a)
                    top_a += s * (top_z - top_a)
                    low_a = top_a
                else:
                    z = a + s * (z - a)
                    top_z = top_a + s * (top_z - top_a)
                    low_z = top_z
            xa, xz = x0 + a * (x1 - x0) - centre_column, x0 + z * (x1 - x0) - centre_column
            ya, yz, va, vz = top_a - centre_row, top_z - centre_row, low_a - centre_row, low_z - centre_row
            for turn in range(4):
                if turn == 0:
                    y0, c0, y1, c1 = ya, xa, va, xa
                elif turn == 1:
                    y0, c0, y1, c1 = va, xa, vz, xz
                elif turn == 2:
                    y0, c0, y1, c1 = vz, xz, yz, xz
                else:
                    y0, c0, y1, c1 = yz, xz, ya, xa
                r0, q0 = centre_row + cos * y0 + sin * c0, centre_column + cos * c0 - sin * y0
                r1, q1 = centre_row + cos * y1 + sin * c1, centre_column + cos * c1 - sin * y1
                for layer in range(2):
                    share = opacity[element] if layer else 1 - opacity[element]
                    if share > 0:
                        _add_edge(r0, q0, r1, q1, weight * share, cover[layer])


@njit(cache=True, nogil=True)
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
