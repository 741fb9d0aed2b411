"""Triangles and edges on pixels against plain arithmetic."""

import numpy as np
import pytest

from simulator import raster


def test_depth_buffer_against_a_loop_over_pixels():
    rng = np.random.default_rng(0)
    height, width = 23, 31
    places = rng.uniform(-5, 36, (60, 2))
    # Laid out as render passes them on: code is compiled for each layout anew.
    depth = rng.uniform(0, 1, (60, 3))[:, 2]
    triangles = np.asfortranarray(np.arange(60, dtype=np.uint32).reshape(-1, 3))
    nearest, owner = np.empty((2, height, width), np.float32)
    bary = np.zeros((2, height, width), np.float32)
    raster.draw_triangles(places, depth, triangles, nearest, owner, bary)
    drawn = 0
    for row in range(height):
        for column in range(width):
            best, which = -np.inf, -1
            for t, corners in enumerate(triangles):
                p = places[corners]
                system = np.vstack([p.T, np.ones(3)])
                weights = np.linalg.solve(system, [row, column, 1])
                # counter-clockwise as seen, with rows downwards
                turn = np.linalg.det(system) > 0
                if turn and (weights > 0).all() and weights @ depth[corners] > best:
                    best, which, at = weights @ depth[corners], t, weights[1:]
            assert owner[row, column] == which
            if which >= 0:
                drawn += 1
                assert bary[:, row, column] == pytest.approx(at, abs=1e-5)
                assert nearest[row, column] == pytest.approx(best, abs=1e-5)
    assert drawn > 200


def test_normals_of_a_bowl_are_those_of_its_formula():
    v, u = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1.2, 1, 51), indexing="ij")
    points = np.stack([u, v, 0.4 * u**2 - 0.3 * v**2 + 0.2 * u * v], axis=-1).reshape(-1, 3)
    corner = (np.arange(40)[:, None] * 51 + np.arange(50)).ravel()
    quads = np.stack([corner, corner + 1, corner + 52, corner + 51], axis=1).astype(np.uint32)
    normals = np.empty_like(points)
    raster.vertex_normals(points, quads, np.ones(len(quads)), normals)
    expected = np.stack([-0.8 * u - 0.2 * v, 0.6 * v - 0.2 * u, np.ones_like(u)], axis=-1)
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    error = np.abs(normals.reshape(41, 51, 3) - expected)
    assert error[1:-1, 1:-1].max() < 1e-3 and error.max() < 0.05


def cover_of(polygons, size, weight=-1.0):
    """Cover of polygons, each a list of (row, column) clockwise as seen."""
    cover = np.zeros((size[0], size[1] + 2))
    start = np.cumsum([0, *map(len, polygons)])
    raster.add_polygons(np.concatenate(polygons).astype(float), start, weight, cover)
    area = np.empty(size, np.float32)
    raster.sum_cover(cover, (0, size[0]), area)
    assert not cover.any()
    return area


def test_cover_of_a_rectangle_is_its_share_of_each_pixel():
    area = cover_of([[(2.25, 3.5), (2.25, 7.75), (5.0, 7.75), (5.0, 3.5)]], (9, 12))
    rows = np.clip(np.minimum(np.arange(9) + 0.5, 5.0) - np.maximum(np.arange(9) - 0.5, 2.25), 0, 1)
    columns = np.clip(np.minimum(np.arange(12) + 0.5, 7.75) - np.maximum(np.arange(12) - 0.5, 3.5), 0, 1)
    assert area == pytest.approx(np.outer(rows, columns), abs=1e-6)


def test_cover_of_slanted_edges_by_many_samples():
    for turn in (0.0, 0.7, 2.0):
        corners = np.array([(4.0, 2.2), (9.5, 20.7), (10.0, 20.7), (11.0, 2.2)]) - [11.5, 12.5]
        spin = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        corners = corners @ spin + [11.5, 12.5]
        area = cover_of([corners], (24, 26), weight=-0.75)
        fine = 40
        r, c = ((np.arange(n * fine) + 0.5) / fine - 0.5 for n in (24, 26))
        r, c = np.meshgrid(r, c, indexing="ij")
        within = np.ones(r.shape, bool)
        for (r0, c0), (r1, c1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            within &= (r1 - r0) * (c - c0) < (c1 - c0) * (r - r0)
        expected = within.reshape(24, fine, 26, fine).mean(axis=(1, 3))
        assert np.abs(area - 0.75 * expected).max() < 0.02
        if turn == 0.0:
            assert area.sum() == pytest.approx(0.75 * (7.0 + 0.5) / 2 * 18.5, rel=1e-5)


def test_covers_add_up_and_are_cut_at_the_rim():
    size = (9, 12)
    whole = [(-10.0, -30.0), (-10.0, 60.0), (50.0, 60.0), (50.0, -30.0)]
    assert cover_of([whole], size) == pytest.approx(1.0)
    # two triangles that share a slanted edge leave no seam
    corners = [(1.3, 1.2), (2.0, 9.9), (7.7, 10.4), (6.1, 0.3)]
    parts = cover_of([corners[:3], [corners[0], *corners[2:]]], size)
    assert parts == pytest.approx(cover_of([corners], size), abs=1e-6)
