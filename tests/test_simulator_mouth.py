import dataclasses

import numpy as np
import pytest

from simulator.elements import CORNERS, hexahedron_gradients
from simulator.errors import InputError
from simulator.faces import FACES, face, random_face
from simulator.mouth import (
    FLATTEST,
    LIPS,
    RESOLUTIONS,
    SALIVA,
    SKIN,
    MouthShape,
    corner_quality,
    lip_heights,
    mouth_mesh,
)


@pytest.fixture(scope="module", params=RESOLUTIONS)
def mouth(request):
    return mouth_mesh(resolution=request.param)


@pytest.mark.parametrize(("resolution", "thesis"), [("low", 852), ("medium", 3414), ("high", 13680)])
def test_element_counts_of_the_thesis(resolution, thesis):
    assert abs(len(mouth_mesh(resolution=resolution).elements) / thesis - 1) < 0.05


def test_mirror_image_to_the_last_bit(mouth):
    X = mouth.nodes
    image = X * [-1.0, 1.0, 1.0]

    def order(points):
        return np.lexsort(points.T + 0.0)

    partner = np.empty(len(X), int)
    partner[order(X)] = order(image)
    assert np.array_equal(X[partner], image)
    own = {(frozenset(e), g) for e, g in zip(mouth.elements.tolist(), mouth.group.tolist(), strict=True)}
    mirrored = {(frozenset(e), g) for e, g in zip(partner[mouth.elements].tolist(), mouth.group.tolist(), strict=True)}
    assert own == mirrored
    assert np.array_equal(mouth.border_m[partner], mouth.border_m)


def test_no_element_across_the_middle(mouth):
    x = mouth.nodes[mouth.elements][:, :, 0]
    assert ((x >= 0).all(axis=1) | (x <= 0).all(axis=1)).all()


def test_saliva_is_one_chain_from_corner_to_corner(mouth):
    X = mouth.nodes
    assert np.array_equal(mouth.saliva, np.flatnonzero(mouth.group == SALIVA))
    for place, element in enumerate(mouth.saliva):
        ends = {*mouth.upper[place : place + 2].ravel(), *mouth.lower[place : place + 2].ravel()}
        assert set(mouth.elements[element]) == ends
    x = X[mouth.upper[:, 0], 0]
    assert (np.diff(x) > 0).all()
    assert np.isclose(x[0], -0.025, atol=1e-12) and np.isclose(x[-1], 0.025, atol=1e-12)
    assert np.isclose(mouth.width_m, 0.050, atol=1e-6)
    for edge in (mouth.upper, mouth.lower):
        assert np.allclose(X[edge[:, 0]] - X[edge[:, 1]], [0, 0, 0.006], atol=1e-15)
    assert np.allclose((X[mouth.upper] - X[mouth.lower])[..., 1], mouth.film_m, atol=1e-12)


def test_the_lips_touch_through_the_saliva_only(mouth):
    tissue = mouth.elements[mouth.group != SALIVA]
    upper = np.isin(tissue, mouth.upper[1:-1]).any(axis=1)
    lower = np.isin(tissue, mouth.lower[1:-1]).any(axis=1)
    assert not (upper & lower).any()
    assert np.array_equal(np.unique(tissue), np.arange(len(mouth.nodes)))  # no node is of the saliva alone


def test_surfaces_look_outwards(mouth):
    for quads, sign in ((mouth.outer, 1), (mouth.inner, -1)):
        P = mouth.nodes[quads]
        normal = np.cross(P[:, 2] - P[:, 0], P[:, 3] - P[:, 1])
        assert (sign * normal[:, 2] > 0).all()
    for quads, corners in ((mouth.outer, slice(4, 8)), (mouth.inner, slice(0, 4))):
        assert np.array_equal(np.sort(quads, axis=1), np.sort(mouth.elements[:, corners], axis=1))


def test_groups_and_the_border_of_the_lips():
    mouth = mouth_mesh(resolution="high")
    centre = mouth.nodes[mouth.outer].mean(axis=1)
    lips = centre[mouth.group == LIPS]
    height = (lips[:, 1].max(), -lips[:, 1].min())
    assert np.allclose(height, (0.0075, 0.0095), atol=0.0012)
    assert np.abs(lips[:, 0]).max() < 0.025
    skin = mouth.border_m[mouth.outer[mouth.group == SKIN]].mean(axis=1)
    assert (skin <= 0).all()
    upper, lower = lip_heights(MouthShape(), np.array([0.0, 0.025, 0.04]))
    assert np.allclose(upper, [0.0063, 0, 0], atol=2e-4) and np.allclose(lower, [0.0095, 0, 0], atol=1e-9)


def test_corner_quality_of_known_elements():
    box = (CORNERS + 1) * [1.0, 2.0, 0.5]
    leaning = box + np.outer(box[:, 0], [0, 0, 1.0])  # edges along x lean by 45 degrees
    folded = box.copy()
    folded[[6, 2], :2] = [0.5, 1.0]  # corner 2 pulled in beyond the diagonal
    nodes = np.concatenate([box, leaning, folded])
    quality = corner_quality(nodes, np.arange(24).reshape(3, 8))
    assert np.allclose(quality[:2], [1.0, np.sqrt(0.5)])
    assert quality[2] < 0


@pytest.mark.parametrize("resolution", RESOLUTIONS)
@pytest.mark.parametrize("name", FACES)
def test_every_face_meshes_well(name, resolution):
    mouth = mouth_mesh(face(name), resolution)
    X = mouth.nodes[mouth.elements]
    for corner in CORNERS:
        jacobian = np.einsum("ai,eaj->eij", hexahedron_gradients(corner), X)
        assert (np.linalg.det(jacobian) > 0).all()
    assert corner_quality(mouth.nodes, mouth.elements).min() > 0.2
    sides = np.linalg.norm(X[:, [1, 2, 3, 0]] - X[:, :4], axis=2)[mouth.group != SALIVA]
    assert (sides.max(axis=1) / sides.min(axis=1)).max() < 20


def test_faces_differ():
    shapes = list(FACES.values())
    assert len(shapes) >= 8
    for i, one in enumerate(shapes):
        for other in shapes[:i]:
            a, b = (np.array(dataclasses.astuple(shape)) for shape in (one, other))
            assert (np.abs(a - b) > 0.05 * np.abs(a)).sum() >= 3


def test_random_faces_are_seeded_and_mesh():
    rng = np.random.default_rng(5)
    faces = [random_face(rng) for _ in range(40)]
    assert len(set(faces)) == 40
    assert faces[0] == random_face(np.random.default_rng(5))
    for shape in faces:
        assert corner_quality(*_mesh(shape)).min() > 0.2


def _mesh(shape):
    mouth = mouth_mesh(shape, "low")
    return mouth.nodes, mouth.elements


def test_face_by_name_with_changes():
    assert face("wide", chin_m=0.001) == dataclasses.replace(FACES["wide"], chin_m=0.001)
    with pytest.raises(InputError, match="did you mean 'thin_lips'"):
        face("thin_lip")
    with pytest.raises(InputError, match="did you mean 'width_m'"):
        face("wide", with_m=0.05)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"width_m": 50}, "expected width_m between 0.02 and 0.12 m, got 50"),
        ({"film_m": 0.0}, "expected film_m between"),
        ({"chin_m": float("nan")}, "expected chin_m as a number of m"),
        ({"half_width_m": 0.03}, "expected half_width_m between 0.0325"),
        ({"protrusion_m": 0.02}, "impossible geometry.*stand out less"),
    ],
)
def test_impossible_geometry_is_refused(changes, message):
    with pytest.raises(InputError, match=message):
        mouth_mesh(MouthShape(**changes), "medium")


def test_unknown_resolution():
    with pytest.raises(InputError, match="did you mean 'medium'"):
        mouth_mesh(resolution="mediun")


def test_the_limit_of_quality_lies_below_all_faces():
    assert FLATTEST <= 0.1
