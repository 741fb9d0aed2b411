"""Triangles and edges on pixels against plain arithmetic."""

import numpy as np
import pytest

from simulator import raster


def test_depth_buffer_against_a_loop_over_pixels():
    rng = np.random.default_rng(0)
    height, width = 23, 31
    places = rng.uniform(-5, 36, (60, 2))
    depth = rng.uniform(0, 1, 60)
    triangles = np.arange(60, dtype=np.uint32).reshape(-1, 3)
    nearest, owner = np.empty((height, width), np.float32), np.empty((height, width), np.int32)
    bary = np.zeros((height, width, 2), np.float32)
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
                assert bary[row, column] == pytest.approx(at, abs=1e-5)
                assert nearest[row, column] == pytest.approx(best, abs=1e-5)
    assert drawn > 200


def test_normals_of_a_sphere_point_outwards():
    rng = np.random.default_rng(1)
    from scipy.spatial import ConvexHull

    points = rng.standard_normal((400, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    triangles = ConvexHull(points).simplices
    inwards = (
        np.einsum(
            "ti,ti->t",
            np.cross(*(points[triangles[:, k]] - points[triangles[:, 0]] for k in (1, 2))),
            points[triangles[:, 0]],
        )
        < 0
    )
    triangles[inwards] = triangles[inwards][:, ::-1]
    normals = np.empty_like(points)
    raster.vertex_normals(points, triangles.astype(np.uint32), np.ones(len(triangles)), normals)
    assert (normals * points).sum(axis=1).min() > 0.95


def opening(corners, size, opacity=0.0, turn=0.0):
    """Cover of a four-cornered opening (upper left, upper right, lower left, lower right), each (row, column)."""
    corners = np.array(corners, float)
    edges = np.array([corners[:2], corners[:2], corners[2:], corners[2:]])
    cover = np.zeros((2, size[0], size[1] + 2))
    ends = edges[0, :, 1].copy()
    middle = (size[0] - 1) / 2, (size[1] - 1) / 2
    raster.add_opening(
        edges,
        ends,
        np.sort(edges[..., 1].ravel()),
        np.array([opacity]),
        np.cos(turn),
        np.sin(turn),
        *middle,
        1.0,
        cover,
    )
    area = np.empty((2, *size), np.float32)
    for layer in range(2):
        raster.sum_cover(cover[layer], (0, size[0]), area[layer])
    assert not cover.any()
    return area


def test_cover_of_a_rectangle_is_its_share_of_each_pixel():
    hole, film = opening([(2.25, 3.5), (2.25, 7.75), (5.0, 3.5), (5.0, 7.75)], (9, 12))
    rows = np.clip(np.minimum(np.arange(9) + 0.5, 5.0) - np.maximum(np.arange(9) - 0.5, 2.25), 0, 1)
    columns = np.clip(np.minimum(np.arange(12) + 0.5, 7.75) - np.maximum(np.arange(12) - 0.5, 3.5), 0, 1)
    assert hole == pytest.approx(np.outer(rows, columns), abs=1e-6) and not film.any()


def test_cover_of_slanted_edges_by_many_samples():
    corners = [(4.0, 2.2), (9.5, 20.7), (11.0, 2.2), (10.0, 20.7)]
    for turn in (0.0, 0.7, 2.0):
        hole, film = opening(corners, (24, 26), opacity=0.25, turn=turn)
        fine = 40
        r, c = np.meshgrid(
            (np.arange(24 * fine) + 0.5) / fine - 0.5, (np.arange(26 * fine) + 0.5) / fine - 0.5, indexing="ij"
        )
        y, x = r - 11.5, c - 12.5
        r, c = 11.5 + np.cos(turn) * y - np.sin(turn) * x, 12.5 + np.cos(turn) * x + np.sin(turn) * y
        s = (c - 2.2) / 18.5
        within = (s > 0) & (s < 1) & (r > 4.0 + 5.5 * s) & (r < 11.0 - 1.0 * s)
        expected = within.reshape(24, fine, 26, fine).mean(axis=(1, 3))
        assert np.abs(hole - 0.75 * expected).max() < 0.02
        assert np.abs(film - 0.25 * expected).max() < 0.02
        assert hole.sum() == pytest.approx(0.75 * (7.0 + 0.5) / 2 * 18.5, rel=1e-5)


def test_crossed_edges_leave_only_the_open_part():
    # from 8 px open to 8 px passed through: half of the width is a triangle
    hole, _ = opening([(4.0, 1.5), (12.0, 17.5), (12.0, 1.5), (4.0, 17.5)], (20, 20))
    assert hole.sum() == pytest.approx(8 * 8 / 2, rel=1e-5)


def test_cover_beyond_the_picture_is_cut():
    hole, _ = opening([(-10.0, -30.0), (-10.0, 60.0), (50.0, -30.0), (50.0, 60.0)], (9, 12))
    assert hole == pytest.approx(1.0)
