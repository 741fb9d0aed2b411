import dataclasses
import re

import numpy as np
import pytest

from simulator.curves import KeyFrames
from simulator.errors import InputError
from simulator.faces import face
from simulator.model import Fixed, Force, Model
from simulator.mouth import LIPS, SALIVA, SKIN, Mouth, mouth_mesh
from simulator.obj_file import read_obj
from simulator.obj_mesh import read_mouth_obj, write_surface_obj
from simulator.solver import solve

# A mouth of 4 x 5 quads, mm: skin, lips, two quads of saliva between skin, lips, skin.
X_MM, Y_MM = (-45, -25, 0, 25, 45), (-30, -12, -0.2, 0.2, 12, 30)


def vertex(column, row):
    """Number of a vertex in the file, from 1."""
    return row * len(X_MM) + column + 1


def surface_lines():
    lines = [f"v {x} {y} {10 - x * x / 200}" for y in Y_MM for x in X_MM]
    for name, cells in (
        ("skin", [(c, r) for r in range(5) for c in range(4) if not (c in (1, 2) and r in (1, 2, 3))]),
        ("lips", [(1, 1), (2, 1), (1, 3), (2, 3)]),
        ("saliva", [(2, 2), (1, 2)]),
    ):
        lines.append(f"usemtl {name}")
        for c, r in cells:
            lines.append("f " + " ".join(str(vertex(c + i, r + j)) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))))
    return lines


def read(tmp_path, lines, **settings):
    path = tmp_path / "mouth.obj"
    path.write_text("\n".join(lines))
    return read_mouth_obj(path, **{"units": "mm"} | settings)


def test_small_surface(tmp_path):
    mouth = read(tmp_path, surface_lines(), thickness_m=0.004)
    assert mouth.nodes.shape == (60, 3) and mouth.elements.shape == (20, 8)
    assert np.allclose(mouth.nodes[30:, 0].reshape(6, 5), np.array(X_MM) / 1e3)
    assert np.allclose(mouth.nodes[30:] - mouth.nodes[:30], [0, 0, 0.004])
    assert np.bincount(mouth.group).tolist() == [14, 4, 2]
    assert mouth.saliva.tolist() == [19, 18]  # along x, not as in the file
    assert mouth.upper.tolist() == [[30 + n, n] for n in (16, 17, 18)]
    assert mouth.lower.tolist() == [[30 + n, n] for n in (11, 12, 13)]
    assert np.isclose(mouth.film_m, 0.0004) and np.isclose(mouth.width_m, 0.05)
    assert mouth.shape is None
    by_node = mouth.border_m[30:].reshape(6, 5)
    assert np.allclose(by_node[[1, 4], 1:4], 0) and np.allclose(by_node[1:5, [1, 3]], 0)
    assert np.isclose(by_node[2, 2], 0.0118) and np.isclose(by_node[3, 2], 0.0118)
    assert np.isclose(by_node[0, 2], -0.018) and (by_node[[0, 5]] < 0).all()


@pytest.mark.parametrize("resolution", ["low", "medium"])
@pytest.mark.parametrize("name", ["average", "protruding"])
def test_written_and_read_again(tmp_path, name, resolution):
    mouth = mouth_mesh(face(name), resolution)
    write_surface_obj(mouth, tmp_path / "mouth.obj")
    again = read_mouth_obj(tmp_path / "mouth.obj", thickness_m=mouth.shape.thickness_m)
    for field in dataclasses.fields(Mouth):
        value, other = getattr(mouth, field.name), getattr(again, field.name)
        if isinstance(value, np.ndarray) and field.name != "border_m":
            assert np.array_equal(value, other), field.name
    assert np.isclose(again.film_m, mouth.film_m, rtol=1e-9)
    inside = mouth.elements[np.isin(mouth.group, (LIPS, SALIVA))]
    assert (again.border_m[inside].max(axis=1) >= 0).all() and (again.border_m[inside].min(axis=1) >= 0).all()
    skin = mouth.elements[mouth.group == SKIN]
    assert (again.border_m[skin] <= 0).all()
    assert np.median(np.abs(again.border_m - mouth.border_m)) < 0.005
    write_surface_obj(again, tmp_path / "again.obj")
    assert (tmp_path / "again.obj").read_bytes() == (tmp_path / "mouth.obj").read_bytes()


def test_faces_in_any_order_and_turned_any_way(tmp_path):
    rng = np.random.default_rng(2)
    lines, material = [], None
    quads = []
    for line in surface_lines():
        if line.startswith("v"):
            lines.append(line)
        elif line.startswith("usemtl"):
            material = line
        else:
            corners = np.roll(line.split()[1:], rng.integers(4))
            quads.append([material, "f " + " ".join(corners)])
    rng.shuffle(quads)
    mouth = read(tmp_path, lines + [line for pair in quads for line in pair])
    straight = read(tmp_path, surface_lines())
    assert np.array_equal(mouth.upper, straight.upper) and np.array_equal(mouth.lower, straight.lower)
    assert np.array_equal(mouth.border_m, straight.border_m)
    assert {tuple(e) for e in mouth.elements.tolist()} == {tuple(e) for e in straight.elements.tolist()}
    assert np.array_equal(mouth.elements[mouth.saliva], straight.elements[straight.saliva])


@pytest.mark.parametrize(
    "change",
    [
        lambda lines: [line.replace("usemtl", "g") for line in lines],
        lambda lines: [line.replace("usemtl", "o") for line in lines],
        lambda lines: [re.sub("usemtl (.*)", r"usemtl \1.001", line).replace("skin", "Skin") for line in lines],
        lambda lines: ["o Face", "g Plane", *lines, "# end"],
        lambda lines: [re.sub(r"(\d+)(?= |$)", r"\1/1/1", line) if line[0] == "f" else line for line in lines],
        lambda lines: [f"{line} 1.0" if line[0] == "v" else line for line in lines],
        lambda lines: [
            re.sub(r"\d+", lambda m: str(int(m[0]) - 31), line) if line[0] == "f" else line for line in lines
        ],
        lambda lines: [line.replace("f ", "f \\\n  ") for line in lines],
        lambda lines: ["v 900 900 900", *(_shifted(line, 1) for line in lines)],
    ],
    ids=["g", "o", "endings", "other names too", "textures", "weights", "negative", "joined lines", "loose vertex"],
)
def test_other_ways_to_write_the_same(tmp_path, change):
    expected, mouth = read(tmp_path, surface_lines()), read(tmp_path, change(surface_lines()))
    for field in dataclasses.fields(Mouth):
        assert np.array_equal(getattr(mouth, field.name), getattr(expected, field.name)), field.name


def _shifted(line, by):
    return re.sub(r"\d+", lambda m: str(int(m[0]) + by), line) if line[0] == "f" else line


def test_mouth_on_the_slant(tmp_path):
    """Turned by 50 degrees, the sides of the quads lie nearer to the x axis than the lips."""
    cos, sin = np.cos(np.radians(50)), np.sin(np.radians(50))
    lines = surface_lines()
    for i, line in enumerate(lines[:30]):
        x, y, z = map(float, line.split()[1:])
        lines[i] = f"v {x * cos - y * sin} {x * sin + y * cos} {z}"
    straight, slanting = read(tmp_path, surface_lines()), read(tmp_path, lines)
    for name in ("saliva", "upper", "lower"):
        assert np.array_equal(getattr(slanting, name), getattr(straight, name))
    assert np.array_equal(slanting.elements[slanting.saliva], straight.elements[straight.saliva])
    assert np.isclose(slanting.film_m, straight.film_m)


def test_units(tmp_path):
    mouth = read(tmp_path, surface_lines(), units="mm")
    metres = [
        "v " + " ".join(repr(float(n) / 1e3) for n in line.split()[1:]) if line[0] == "v" else line
        for line in surface_lines()
    ]
    assert np.allclose(read(tmp_path, metres, units="m").nodes, mouth.nodes, atol=1e-15)
    with pytest.raises(InputError, match=r"mouth 0\.02 to 0\.12 m wide, got 50 m; say in which units"):
        read(tmp_path, surface_lines(), units="m")
    with pytest.raises(InputError, match=r"units of m, cm or mm, got 'inch'"):
        read(tmp_path, surface_lines(), units="inch")
    with pytest.raises(InputError, match="thickness_m between"):
        read(tmp_path, surface_lines(), thickness_m=6)


def replaced(old, new):
    def change(lines):
        assert old in lines
        return [new if line == old else line for line in lines]

    return change


FIRST_LIP = "f 7 8 13 12"
FAULTS = {
    "triangle": (replaced(FIRST_LIP, "f 7 8 13"), r"line 47: expected quads only, got a face of 3 vertices"),
    "no saliva": (lambda lines: [line.replace("saliva", "lips") for line in lines], "got none of saliva"),
    "unknown name": (lambda lines: [line.replace("lips", "lisp") for line in lines], "line 47.*did you mean 'lips'"),
    "no name": (lambda lines: [line for line in lines if line[0] != "u"], "line 31: .*got none"),
    "number too large": (replaced(FIRST_LIP, "f 7 8 13 99"), "line 47: expected vertex numbers up to 30, got 99"),
    "number 0": (replaced(FIRST_LIP, "f 0 8 13 12"), "line 47: expected vertex numbers from 1.*got '0'"),
    "number too negative": (replaced(FIRST_LIP, "f -31 8 13 12"), "line 47: .*back to -30, got '-31'"),
    "not a number": (replaced(FIRST_LIP, "f a 8 13 12"), "line 47: .*got 'a'"),
    "vertex twice": (replaced(FIRST_LIP, "f 7 8 8 12"), "line 47: expected a face of different vertices"),
    "two vertices": (replaced(FIRST_LIP, "f 7 8"), "line 47: expected a face of three or more"),
    "nan": (
        lambda lines: ["v 0 nan 0", *lines[1:]],
        "line 1: expected a vertex of three finite numbers, got '0 nan 0'",
    ),
    "short vertex": (lambda lines: ["v 0 1", *lines[1:]], "line 1: expected a vertex of three finite numbers"),
    "word": (lambda lines: ["v 0 1 x", *lines[1:]], "line 1: expected a vertex of three finite numbers"),
    "same place": (lambda lines: [*lines[:6], lines[0], *lines[7:]], "line 7: .*got the place of line 1 again; merge"),
    "inverted": (replaced(FIRST_LIP, "f 7 12 13 8"), "line 47: expected convex quads.*inverted there"),
    "crossed": (replaced(FIRST_LIP, "f 7 8 12 13"), "line 47: expected convex quads"),
    "all clockwise": (
        lambda lines: ["f " + " ".join(line.split()[:0:-1]) if line[0] == "f" else line for line in lines],
        "clockwise quads; flip the normals",
    ),
    "flat": (
        lambda lines: [lines[0], f"v -25 -30 {10 + 400}", *lines[2:]],
        "line 32: .*seen from the side",
    ),
    "doubled face": (lambda lines: [*lines, FIRST_LIP], "expected at most two quads at an edge, got 3"),
    "gap in the saliva": (
        lambda lines: [*lines[:-1], "usemtl lips", lines[-1]],
        "line 52: expected the saliva as one chain.*got 0 saliva quads beside",
    ),
    "saliva apart": (
        lambda lines: [*lines[:31], *lines[33:], *lines[31:33]],
        "line 50: expected the saliva as one chain.*got this one apart from the others",
    ),
    "saliva round a corner": (
        lambda lines: [*lines[:48], *lines[49:], lines[48]],
        "line 52: expected the saliva as one chain.*2 saliva quads beside this one but not opposite",
    ),
    "two pieces": (
        lambda lines: [
            *(f"v {x} {y} 0" for x, y in ((200, 0), (210, 0), (210, 10), (200, 10))),
            *(_shifted(line, 4) for line in lines),
            "usemtl skin",
            "f 1 2 3 4",
        ],
        "expected one connected surface, got 2 pieces",
    ),
    "empty": (lambda lines: [], "expected vertices and faces in .*got 0 and 0"),
    "no faces": (lambda lines: lines[:30], "got 30 and 0"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_named(tmp_path, fault):
    change, message = FAULTS[fault]
    with pytest.raises(InputError, match=message):
        read(tmp_path, change(surface_lines()))


def test_saliva_ring(tmp_path):
    """A ring has no ends."""
    lines = [line for line in surface_lines() if line[0] == "v"]
    ring = {(1, 1), (2, 1), (3, 1), (3, 2), (3, 3), (2, 3), (1, 3), (1, 2)}
    names = {True: "usemtl saliva", False: "usemtl skin"}
    for r in range(5):
        for c in range(4):
            name = "usemtl lips" if (c, r) == (2, 2) else names[(c, r) in ring]
            corners = (vertex(c + i, r + j) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
            lines += [name, "f " + " ".join(map(str, corners))]
    with pytest.raises(InputError, match="one chain of two or more quads"):
        read(tmp_path, lines)


def test_no_such_file(tmp_path):
    with pytest.raises(InputError, match=r"expected an OBJ file, got .*nothing\.obj: No such file"):
        read_obj(tmp_path / "nothing.obj")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file"):
        write_surface_obj(mouth_mesh(resolution="low"), tmp_path / "file" / "mouth.obj")


def test_imported_mouth_is_solved(tmp_path):
    mouth = read(tmp_path, surface_lines())
    edge = np.flatnonzero(np.abs(mouth.nodes[:, 1]) > 0.0299)
    pull = Force(mouth.upper[1], 1, 1e-3, KeyFrames((0.0,), (1.0,), ()))
    model = Model(
        mouth.nodes,
        mouth.elements,
        material_of=mouth.group * 0,
        loads=(Fixed(edge), pull),
        damping=15.0,
        duration_s=0.01,
    )
    motion = solve(model, [0.01])
    assert motion.stopped is None
    moved = motion.displacements[0]
    assert moved[mouth.upper[1, 0], 1] > 1e-5 and np.isfinite(moved).all()
