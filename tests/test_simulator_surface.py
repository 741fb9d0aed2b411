from collections import Counter

import numpy as np
import pytest
from moved_mouth import moved_mouth

from simulator.aperture import COAT_M
from simulator.errors import InputError
from simulator.mouth import LIPS, SALIVA, SKIN, mouth_mesh
from simulator.surface import display_frames, display_positions, display_surface, vertex_normals


@pytest.fixture(scope="module")
def moved():
    return moved_mouth(times=5)


def volume(vertices, quads):
    """m3, by the divergence theorem over two triangles of each quad."""
    triangles = vertices[np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])]
    return np.linalg.det(triangles).sum() / 6


@pytest.mark.parametrize("resolution", ["low", "medium"])
def test_the_surface_is_closed_and_its_quads_agree_about_outside(resolution):
    mouth = mouth_mesh(resolution=resolution)
    surface = display_surface(mouth)
    sides = Counter((int(q[k]), int(q[(k + 1) % 4])) for q in surface.quads for k in range(4))
    assert set(sides.values()) == {1}
    assert all((b, a) in sides for a, b in sides)
    # Euler's formula: a sheet with a slit through it is a ring.
    assert len(surface.nodes) - len(sides) // 2 + len(surface.quads) == 0


def test_the_volume_is_that_of_the_tissue(moved):
    mouth, _ = moved
    surface = display_surface(mouth)
    a, b, c, d = np.moveaxis(mouth.nodes[mouth.outer][..., :2], 1, 0)
    area = np.abs(np.linalg.det(np.stack([c - a, d - b], axis=1))) / 2  # as seen from the front
    tissue = (area * mouth.shape.thickness_m)[mouth.group != SALIVA].sum()  # the sheet is thick along z alone
    assert volume(mouth.nodes[surface.nodes], surface.quads) == pytest.approx(tissue, rel=1e-3)


def test_groups_and_elements(moved):
    mouth, _ = moved
    surface = display_surface(mouth)
    assert np.all(np.diff(surface.groups) >= 0) and set(surface.groups) == {SKIN, LIPS}
    assert not np.isin(surface.element_of, mouth.saliva).any()
    of_element = mouth.elements[surface.element_of]
    assert all(np.isin(surface.nodes[q], e).all() for q, e in zip(surface.quads, of_element, strict=True))
    corners = surface.nodes[surface.quads]
    walls = np.isin(corners, mouth.upper).all(axis=1)
    assert walls.sum() == len(mouth.saliva) and (surface.groups[walls] == LIPS).all()
    lowest = display_positions(mouth, mouth.nodes[None])[0][surface.quads[walls]]
    across = np.cross(lowest[:, 2] - lowest[:, 0], lowest[:, 3] - lowest[:, 1])
    assert (across[:, 1] < 0).all()  # the upper lip's wall faces down


def test_vertices_are_numbered_by_first_use(moved):
    surface = display_surface(moved[0])
    _, first = np.unique(surface.quads, return_index=True)
    assert np.all(np.diff(first) > 0)
    assert np.array_equal(surface.vertex_of(surface.nodes), np.arange(len(surface.nodes)))


def test_closed_lips_meet_and_open_ones_keep_their_half_of_film_and_coat(moved):
    mouth, motion = moved
    surface = display_surface(mouth)
    shown = display_positions(mouth, motion.positions)
    upper, lower = surface.vertex_of(mouth.upper), surface.vertex_of(mouth.lower)
    assert np.array_equal(shown[0][upper], shown[0][lower])
    rest = np.linalg.norm(mouth.nodes[mouth.upper] - mouth.nodes[mouth.lower], axis=-1)
    for state, place in zip(motion.positions, shown, strict=True):
        was = np.linalg.norm(state[mouth.upper] - state[mouth.lower], axis=-1)
        now = np.linalg.norm(place[upper] - place[lower], axis=-1)
        np.testing.assert_allclose(now, np.maximum(was - rest - COAT_M, 0), atol=1e-12)
    others = np.setdiff1d(np.arange(len(mouth.nodes)), np.concatenate([mouth.upper, mouth.lower]))
    assert np.array_equal(shown[:, surface.vertex_of(others)], motion.positions[:, others])


def test_overlapping_lips_meet_in_the_middle(moved):
    mouth, _ = moved
    pressed = mouth.nodes.copy()
    pressed[mouth.upper, 1] -= 1.5 * mouth.film_m
    surface = display_surface(mouth)
    shown = display_positions(mouth, pressed[None])[0]
    assert np.array_equal(shown[surface.vertex_of(mouth.upper)], shown[surface.vertex_of(mouth.lower)])


def test_normals_of_a_sphere():
    # Points of a grid in longitude and latitude, without the poles.
    longitude, latitude = np.meshgrid(np.linspace(0, 1, 40), np.linspace(-0.5, 0.5, 40))
    points = np.stack(
        [np.cos(latitude) * np.sin(longitude), np.sin(latitude), np.cos(latitude) * np.cos(longitude)], axis=-1
    ).reshape(-1, 3)
    corner = (np.arange(39)[:, None] * 40 + np.arange(39)).ravel()
    quads = np.stack([corner, corner + 1, corner + 41, corner + 40], axis=1)
    normals = vertex_normals(np.stack([points, 2 * points]), quads)
    np.testing.assert_allclose(normals[0], points, atol=0.02)
    np.testing.assert_allclose(normals[1], normals[0], atol=1e-12)


def test_frames_are_linear_between_saved_states_until_the_edges_are_put_where_they_are_drawn(moved):
    mouth, motion = moved
    frames = display_frames(mouth, motion, [0.0, 0.3125, 1.0])
    part_way = 0.75 * motion.positions[1] + 0.25 * motion.positions[2]
    expected = display_positions(mouth, np.stack([motion.positions[0], part_way, motion.positions[4]]))
    np.testing.assert_allclose(frames, expected, atol=1e-15)


def test_bad_positions(moved):
    mouth, motion = moved
    with pytest.raises(InputError, match=r"shape \(T, 1888, 3\), got \(5, 1888, 2\)"):
        display_positions(mouth, motion.positions[..., :2])
    with pytest.raises(InputError, match="times from 0 to 1 s"):
        display_frames(mouth, motion, [0.5, 1.2])
