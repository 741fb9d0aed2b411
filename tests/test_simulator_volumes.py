import numpy as np
import pytest
from scipy.spatial import Delaunay

from simulator.errors import InputError
from simulator.volumes import Box, ClosedSurface, Ellipsoid, Union, nodes_inside, read_closed_surface

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
CUBE_FACES = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ]
)


def points(count=4000, low=-1.5, high=1.5):
    return np.random.default_rng(3).uniform(low, high, (count, 3))


def torus(around=24, across=12, R=1.0, r=0.35):
    u, v = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.arange(across) * 2 * np.pi / across, indexing="ij")
    vertices = np.stack([(R + r * np.cos(v)) * np.cos(u), (R + r * np.cos(v)) * np.sin(u), r * np.sin(v)], axis=-1)
    i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    a, b = i * across + j, (i + 1) % around * across + j
    c, d = (i + 1) % around * across + (j + 1) % across, i * across + (j + 1) % across
    triangles = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return vertices.reshape(-1, 3), triangles


def test_box_and_ellipsoid_by_their_formulas():
    P = points()
    box = Box((-0.5, -1, 0), (0.5, 1, 0.25))
    assert np.array_equal(box.inside(P), (abs(P[:, 0]) <= 0.5) & (abs(P[:, 1]) <= 1) & (abs(P[:, 2] - 0.125) <= 0.125))
    assert np.allclose(box.distance_m(np.array([[1.5, 2.0, 0.1], [0, 0, 0.1]])), [np.sqrt(2), 0])
    egg = Ellipsoid((0.1, 0.2, 0.3), (0.5, 0.8, 1.0))
    assert np.array_equal(egg.inside(P), (((P - [0.1, 0.2, 0.3]) / [0.5, 0.8, 1.0]) ** 2).sum(axis=1) <= 1)
    assert np.allclose(egg.distance_m(np.array([[2.1, 0.2, 0.3], [0.1, 0.2, 0.3]])), [1.5, 0])
    assert np.allclose(egg.depth(np.array([[0.1, 0.2, 0.3], [0.35, 0.2, 0.3], [0.7, 0.2, 0.3]])), [1, 0.5, 0])


def test_turned_ellipsoid():
    egg = Ellipsoid((0, 0, 0), (1.0, 0.1, 0.1), (0, 0, 90))
    assert egg.inside(np.array([[0, 0.9, 0], [0.9, 0, 0]])).tolist() == [True, False]
    # First about x, which leaves the long axis where it is, then about z.
    egg = Ellipsoid((0, 0, 0), (1.0, 0.1, 0.1), (90, 0, 45))
    assert egg.inside(np.array([[0.6, 0.6, 0], [0.6, -0.6, 0]])).tolist() == [True, False]


@pytest.mark.parametrize(
    "volume",
    [
        Box((-0.5, -1, 0), (0.2, 1, 0.25)),
        Ellipsoid((0.4, 0.2, 0.3), (0.9, 0.5, 0.7), (10, 20, 30)),
        ClosedSurface(CUBE, CUBE_FACES),
        Union((Box((0, 0, 0), (1, 1, 1)), Ellipsoid((1, 0, 0), (0.5, 0.5, 0.5)))),
    ],
    ids=lambda volume: type(volume).__name__,
)
def test_mirrored(volume):
    P = points()
    other, image = volume.mirrored(), P * [-1, 1, 1]
    assert volume.inside(P).any()
    assert np.array_equal(other.inside(image), volume.inside(P))
    assert np.allclose(other.depth(image), volume.depth(P), atol=1e-12)
    assert np.array_equal(volume.depth(P) > 0, volume.inside(P))


def test_closed_surface_against_convex_hull_and_formula():
    P = points()
    rng = np.random.default_rng(0)
    ball = rng.standard_normal((60, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    hull = Delaunay(ball).convex_hull
    outward = np.linalg.det(ball[hull]) < 0
    hull[outward] = hull[outward][:, ::-1]
    assert np.array_equal(ClosedSurface(ball, hull).inside(P), Delaunay(ball).find_simplex(P) >= 0)
    vertices, triangles = torus(48, 24)
    radius = np.hypot(np.hypot(P[:, 0], P[:, 1]) - 1, P[:, 2])
    clear = (radius < 0.33) | (radius > 0.36)
    assert np.array_equal(ClosedSurface(vertices, triangles).inside(P)[clear], (radius < 0.33)[clear])


def test_points_level_with_edges_and_vertices():
    """Where a ray along an axis would run along faces and edges."""
    surface = ClosedSurface(CUBE, CUBE_FACES)
    P = np.array([[0.5, 0.5, 0.5], [-0.5, 0, 0], [1.5, 1, 1], [0.5, 0.5, -1], [0.25, 0.25, 0.25], [2, 0.7, 0.4]])
    assert surface.inside(P).tolist() == [True, False, False, False, True, False]
    assert np.allclose(surface.distance_m(P), [0, 0.5, 0.5, 1, 0, 1])


def test_inside_out_surface_and_two_shells():
    inverted = ClosedSurface(CUBE, CUBE_FACES[:, ::-1])
    assert inverted.inside(np.array([[0.5, 0.5, 0.5]])).all()
    both = ClosedSurface(
        np.concatenate([CUBE, np.add(CUBE, [0.5, 0, 0])]), np.concatenate([CUBE_FACES, CUBE_FACES[:, ::-1] + 8])
    )
    assert both.inside(np.array([[0.2, 0.5, 0.5], [0.7, 0.5, 0.5], [1.3, 0.5, 0.5], [1.6, 0.5, 0.5]])).tolist() == [
        True,
        True,
        True,
        False,
    ]


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        (CUBE_FACES[:-1], "a hole: 3 edges belong to one triangle only.*fill the hole"),
        (np.concatenate([CUBE_FACES, CUBE_FACES[:1]]), "expected two triangles at every edge, got 3"),
        (np.concatenate([CUBE_FACES[:-1], CUBE_FACES[-1:, ::-1]]), "opposite sense.*normals consistent"),
        (CUBE_FACES + 1, "vertex numbers 0 to 7"),
        (np.array([[0, 1, 2], [0, 2, 1]]), "encloses a volume, got a flat one"),
    ],
)
def test_surfaces_that_enclose_nothing(faces, message):
    with pytest.raises(InputError, match=message):
        ClosedSurface(CUBE, faces)


def test_closed_surface_of_a_file(tmp_path):
    path = tmp_path / "cube.obj"
    quads = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = [f"v {x} {y} {z}" for x, y, z in CUBE] + ["f " + " ".join(f"{n}/1/1" for n in quad) for quad in quads]
    path.write_text("\n".join(lines))
    surface = read_closed_surface(path, scale=0.01)
    assert surface.inside(np.array([[0.005, 0.005, 0.005], [0.5, 0.5, 0.5]])).tolist() == [True, False]
    path.write_text("\n".join(lines[:-1]))
    with pytest.raises(InputError, match=r"cube\.obj: expected a closed surface, got one with a hole"):
        read_closed_surface(path)
    with pytest.raises(InputError, match="scale above 0"):
        read_closed_surface(path, scale=0)


def test_nodes_inside():
    nodes = np.array([[0, 0, 0], [0.01, 0, 0], [0.02, 0, 0]])
    assert nodes_inside(nodes, Box((0.005, -1, -1), (1, 1, 1))).tolist() == [1, 2]
    with pytest.raises(
        InputError, match=r"inside the chin, got none: the nearest is node 2 at \(20.0, 0.0, 0.0\) mm, 5 mm outside"
    ):
        nodes_inside(nodes, Ellipsoid((0.03, 0, 0), (0.005, 0.005, 0.005)), "the chin")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Box((0, 0, 0), (1, 0, 1)), "low_m below high_m"),
        (lambda: Box((0, 0), (1, 1, 1)), "low_m of Box as three finite numbers"),
        (lambda: Ellipsoid((0, 0, 0), (1, -1, 1)), "radii_m above 0"),
        (lambda: Ellipsoid((0, 0, float("nan")), (1, 1, 1)), "centre_m of Ellipsoid"),
        (lambda: Union(()), "one or more volumes"),
    ],
)
def test_bad_volumes(make, message):
    with pytest.raises(InputError, match=message):
        make()
