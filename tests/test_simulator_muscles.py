import dataclasses

import numpy as np
import pytest

from simulator.curves import KeyFrames
from simulator.elements import deformation_gradients, lumped_mass
from simulator.errors import InputError
from simulator.faces import face
from simulator.model import Displacement, Fixed, Force, Model
from simulator.mouth import SALIVA, mouth_mesh
from simulator.muscles import (
    MUSCLES,
    Activation,
    Jaw,
    SineOf,
    VersineOf,
    jaw,
    jaw_nodes,
    landmarks,
    muscle_force,
    muscle_loads,
    skull,
    usual_force,
)
from simulator.obj_mesh import read_mouth_obj, write_surface_obj
from simulator.solver import solve
from simulator.symmetry import half
from simulator.volumes import Box, Ellipsoid

RAMP = KeyFrames((0.0, 0.1, 1.0), (0.0, 1.0, 1.0), ("quarter_sin", "linear"))


@pytest.fixture(scope="module")
def mouth():
    return mouth_mesh(resolution="low")


def partner_of(mouth):
    place = {tuple(X): node for node, X in enumerate((mouth.nodes + 0.0).tolist())}
    return np.array([place[(-x + 0.0, y, z)] for x, y, z in mouth.nodes.tolist()])


def model(mouth, activations, **settings):
    """The mouth without its saliva."""
    loads = (skull(mouth), *muscle_loads(mouth, activations))
    settings = {"damping": 15.0, "duration_s": 0.2} | settings
    return Model(mouth.nodes, mouth.elements[mouth.group != SALIVA], loads=loads, **settings)


@pytest.mark.parametrize("name", MUSCLES)
def test_forces_of_both_sides_are_mirror_images_to_the_last_bit(mouth, name):
    force = muscle_force(mouth, Activation(name, None, RAMP))
    assert np.abs(force).max() > 0
    assert np.array_equal(force[partner_of(mouth)], force * [-1, 1, 1])


@pytest.mark.parametrize("name", MUSCLES)
def test_sides_add_up_and_the_peak_is_the_force_of_a_side(mouth, name):
    left, right, both = (
        muscle_force(mouth, Activation(name, 0.3, RAMP, side=side)) for side in ("left", "right", "both")
    )
    assert np.allclose(left + right, both, atol=1e-15)
    assert np.isclose(np.linalg.norm(left, axis=1).sum(), 0.3, rtol=1e-12)
    x = mouth.nodes[:, 0]
    assert (np.linalg.norm(left, axis=1) * x).sum() > 0 > (np.linalg.norm(right, axis=1) * x).sum()


def test_directions(mouth):
    """Where each muscle pulls the left half of the face, (x, y, z)."""
    signs = {
        "zygomaticus": (1, 1, -1),
        "risorius": (1, 0, -1),
        "depressor_anguli": (1, -1, -1),
        "orbicularis": (-1, None, 0),
        "pout": (-1, None, 1),
        "levator_labii": (1, 1, -1),
        "depressor_labii": (1, -1, 0),
        "mentalis": (0, 1, 1),
        "press": (0, None, 0),
        "burst": (0, None, 1),
    }
    assert set(signs) == set(MUSCLES)
    for name, expected in signs.items():
        total = muscle_force(mouth, Activation(name, 1.0, RAMP, side="left")).sum(axis=0)
        for value, sign in zip(total, expected, strict=True):
            assert sign is None or (np.sign(value) == sign if sign else abs(value) < 1e-12), name


def test_lips_are_pressed_together_and_blown_apart(mouth):
    upper = mouth.upper[len(mouth.upper) // 2, 0]
    lower = mouth.lower[len(mouth.lower) // 2, 0]
    press, burst, ring = (
        muscle_force(mouth, Activation(name, None, RAMP)) for name in ("press", "burst", "orbicularis")
    )
    assert press[upper, 1] < 0 < press[lower, 1]
    assert burst[lower, 1] < 0 < burst[upper, 1]
    assert ring[upper, 1] < 0


@pytest.mark.slow
def test_force_does_not_depend_on_the_mesh():
    """Sum, place and spread of the force of one side."""
    found = []
    for resolution in ("low", "medium"):
        mouth = mouth_mesh(resolution=resolution)
        force = muscle_force(mouth, Activation("zygomaticus", 1.0, RAMP, side="left"))
        size = np.linalg.norm(force, axis=1)
        middle = size @ mouth.nodes
        spread = np.sqrt(size @ (mouth.nodes - middle) ** 2)
        found.append([*force.sum(axis=0), *(middle * 1e3), *(spread * 1e3)])
    assert np.allclose(found[0], found[1], atol=0.4)  # N and mm


def test_force_fades_towards_the_border(mouth):
    volume = Ellipsoid((0.03, 0.0, -0.008), (0.02, 0.02, 0.02))
    force = muscle_force(mouth, Activation("risorius", None, RAMP, side="left", volume=volume))
    size = np.linalg.norm(force, axis=1)
    assert (size[~volume.inside(mouth.nodes)] == 0).all()
    tissue = mouth.elements[mouth.group != SALIVA]
    share = lumped_mass(mouth.nodes, tissue, np.ones(len(tissue)))
    faded = share * np.sin(np.pi / 2 * volume.depth(mouth.nodes)) ** 2
    own = mouth.nodes[:, 0] > 0.25 * 0.025  # elsewhere it fades to the other side of the face
    assert np.allclose(size[own] / size[own].sum(), faded[own] / faded[own].sum(), rtol=1e-9, atol=1e-15)


def test_forward_part_of_the_sphincter(mouth):
    plain = muscle_force(mouth, Activation("orbicularis", 1.0, RAMP))
    forward = muscle_force(mouth, Activation("orbicularis", 1.0, RAMP, forward=0.75))
    along = np.hypot(forward[:, 0], forward[:, 1])
    assert np.allclose(forward[:, 2], 0.75 * along)
    assert (plain[:, 2] == 0).all()


def test_usual_force_is_scaled_to_the_face(mouth):
    def size(shape):
        force = muscle_force(mouth_mesh(shape, "low"), Activation("risorius", None, RAMP, side="left"))
        return np.linalg.norm(force, axis=1).sum()

    assert np.isclose(size(None), MUSCLES["risorius"].peak_n)
    child = face("child")
    expected = MUSCLES["risorius"].peak_n * child.width_m / 0.05 * child.thickness_m / 0.006
    assert np.isclose(size(child), expected)
    assert np.isclose(usual_force(mouth_mesh(child, "low"), "risorius"), expected)


def test_curves_of_the_turn():
    curve = KeyFrames((0.0, 1.0, 2.0), (0.0, 1.0, -0.1), ("quarter_sin", "linear"))
    t = np.linspace(0.05, 1.95, 20)
    for shape, expected in (
        (SineOf(curve, 0.4), np.sin(0.4 * curve.value(t))),
        (VersineOf(curve, 0.4), 1 - np.cos(0.4 * curve.value(t))),
    ):
        assert np.allclose(shape.value(t), expected, atol=1e-15)
        slope = (shape.value(t + 1e-6) - shape.value(t - 1e-6)) / 2e-6
        assert np.allclose(shape.rate(t), slope, atol=1e-8)
    assert SineOf(curve, 0.4) == SineOf(dataclasses.replace(curve), 0.4)


@pytest.mark.parametrize("time_s", [0.03, 0.1, 0.7])
def test_chin_turns_exactly_about_the_joint(mouth, time_s):
    activations = [Activation("jaw", 0.04, RAMP)]
    moved = np.zeros_like(mouth.nodes)
    for load in muscle_loads(mouth, activations):
        if isinstance(load, Displacement):
            moved[load.nodes, load.axis] += load.magnitudes_m * load.shape.value(time_s)
    nodes, part = jaw_nodes(mouth)
    chin = nodes[part == 1]
    assert len(chin) > 50
    lower_jaw = jaw(mouth, activations)
    assert np.allclose((mouth.nodes + moved)[chin], lower_jaw.turned(mouth.nodes[chin], time_s), atol=1e-12)
    partly = nodes[part < 1]
    whole = lower_jaw.turned(mouth.nodes[partly], time_s) - mouth.nodes[partly]
    assert np.allclose(moved[partly], part[part < 1][:, None] * whole, atol=1e-12)


def test_peak_is_the_path_of_the_chin(mouth):
    place = landmarks(mouth)
    lower_jaw = jaw(mouth, [Activation("jaw", 0.03, RAMP)])
    chin = np.array([0.0, place.chin_y, place.chin_z])
    path = np.array([lower_jaw.turned(chin, t) for t in np.linspace(0, 0.1, 200)])
    assert np.isclose(np.linalg.norm(np.diff(path, axis=0), axis=1).sum(), 0.03, rtol=1e-5)
    assert path[-1, 1] < path[0, 1] - 0.015 and path[-1, 2] < path[0, 2]
    angle, joint = lower_jaw.transform(0.5)
    assert angle > 0
    assert np.allclose(joint, [0, place.y + 0.055, place.z - 0.085])
    assert jaw(mouth, []).transform(0.5)[0] == 0.0
    assert isinstance(jaw(mouth, [], (0.04, -0.07)), Jaw)


def test_bones_hold_the_edge(mouth):
    X = mouth.nodes
    held = skull(mouth).nodes
    edge = np.abs(X[:, 0]) > 0.065 - 1e-9
    edge |= (X[:, 1] < X[:, 1].min() + 1e-9) | (X[:, 1] > X[:, 1].max() - 1e-9)
    nodes, part = jaw_nodes(mouth)
    assert np.array_equal(np.sort(np.concatenate([held, nodes[edge[nodes]]])), np.flatnonzero(edge))
    assert (X[held, 1] >= landmarks(mouth).y).all()
    sides = np.abs(X[nodes, 0]) > 0.065 - 1e-9
    order = np.argsort(X[nodes[sides], 1])
    assert (np.diff(part[sides][order]) <= 1e-12).all()
    assert part[sides].min() < 0.05 and part[sides].max() == 1.0
    free = np.unique([*mouth.upper.ravel(), *mouth.lower.ravel()])
    assert not np.isin(free, np.concatenate([held, nodes])).any()


def test_jaw_at_rest_is_held(mouth):
    loads = muscle_loads(mouth, [Activation("zygomaticus", None, RAMP)])
    held = [load for load in loads if isinstance(load, Fixed) and load.axes == (0, 1, 2)]
    assert len(held) == 1 and np.array_equal(held[0].nodes, jaw_nodes(mouth)[0])
    assert not any(isinstance(load, Displacement) for load in loads)
    assert not any(isinstance(load, Force) for load in muscle_loads(mouth, [Activation("press", 0.0, RAMP)]))


def test_mouth_opens_from_the_middle_and_no_element_inverts(mouth):
    opened = model(mouth, [Activation("jaw", 0.04, RAMP)], duration_s=0.4)
    motion = solve(opened, [0.0, 0.05, 0.4])
    assert motion.stopped is None
    gap = (motion.positions[:, mouth.upper[:, 0]] - motion.positions[:, mouth.lower[:, 0]])[:, :, 1] - mouth.film_m
    middle = gap.shape[1] // 2
    assert gap[2, middle] > 0.015
    for state in gap[1:]:
        assert (np.diff(state[: middle + 1]) > -2e-4).all()
        assert np.argmax(state) == middle
    F = deformation_gradients(opened.nodes, opened.elements, motion.displacements[2])
    assert np.linalg.det(F).min() > 0.6


def test_half_of_a_symmetric_mouth_is_enough(mouth):
    activations = [Activation("jaw", 0.01, RAMP), *(Activation(name, 0.02, RAMP) for name in MUSCLES)]
    whole = model(mouth, activations, duration_s=0.02, dt_s=1e-4)
    part = half(whole)
    expected, motion = solve(whole, [0.02]), part.mirrored(solve(part.model, [0.02]))
    assert np.abs(expected.displacements).max() > 1e-4
    assert np.allclose(motion.positions, expected.positions, atol=1e-8)
    with pytest.raises(InputError, match="mirror-symmetric Force"):
        half(model(mouth, [Activation("zygomaticus", None, RAMP, side="left")]))


def test_smile_moves_the_corners_out_and_up(mouth):
    motion = solve(model(mouth, [Activation("zygomaticus", None, RAMP)], duration_s=0.4), [0.4])
    corner = motion.displacements[0, [mouth.upper[0, 0], mouth.upper[-1, 0]]] * 1e3
    assert np.allclose(corner[0], corner[1] * [-1, 1, 1], atol=1e-3)
    assert 6 < np.hypot(*corner[1, :2]) < 10 and corner[1].min() > -4


def test_mouth_of_a_file_works_as_well(mouth, tmp_path):
    write_surface_obj(mouth, tmp_path / "mouth.obj")
    imported = read_mouth_obj(tmp_path / "mouth.obj")
    activations = [Activation("jaw", 0.04, RAMP), Activation("zygomaticus", None, RAMP)]
    here, there = (solve(model(one, activations, duration_s=0.02), [0.02]) for one in (mouth, imported))
    assert there.stopped is None
    assert np.abs(here.displacements).max() > 0.01
    # The heights of the lips, from which chin and muscles are placed, are those of whole elements in a file.
    apart = np.linalg.norm(here.positions - there.positions, axis=2)
    assert np.median(apart) < 2e-4 and apart.max() < 6e-3


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Activation("zygomatics", None, RAMP), "expected a muscle of jaw, .*did you mean 'zygomaticus'"),
        (
            lambda: Activation("press", None, RAMP, side="lft"),
            "side of press as both, left or right, got 'lft'; did you",
        ),
        (lambda: Activation("jaw", 0.051, RAMP), "moves by up to 0.05 m, got 0.051 m"),
        (lambda: Activation("jaw", -0.01, RAMP), "peak of jaw as 0 or more"),
        (lambda: Activation("press", float("nan"), RAMP), "peak of press as a finite number"),
        (lambda: Activation("jaw", None, RAMP, side="left"), "turns as a whole"),
        (lambda: Activation("press", None, KeyFrames((0, 1), (0, 1.2), ("linear",))), "from 0 to 1, got 0 to 1.2"),
        (lambda: Activation("jaw", None, KeyFrames((0, 1), (0, -0.2), ("linear",))), "from -0.1 to 1, got -0.2 to 0"),
    ],
)
def test_bad_activations(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_bad_loads(mouth):
    with pytest.raises(InputError, match="one activation of the jaw, got 2"):
        muscle_loads(mouth, [Activation("jaw", None, RAMP), Activation("jaw", None, RAMP)])
    with pytest.raises(InputError, match="joint of the jaw above and behind the chin"):
        muscle_loads(mouth, [], jaw_joint=(0.05, 0.05))
    far = Box((0.2, 0.2, 0.2), (0.3, 0.3, 0.3))
    with pytest.raises(InputError, match="inside the volume of press, got none: the nearest is node"):
        muscle_loads(mouth, [Activation("press", None, RAMP, volume=far)])
    other = Box((-0.06, -0.1, -0.1), (-0.02, 0.1, 0.1))
    with pytest.raises(InputError, match="beyond the middle of the face only; move the volume to x > 0"):
        muscle_loads(mouth, [Activation("press", None, RAMP, volume=other)])
    assert muscle_loads(mouth, [Activation("jaw", None, KeyFrames((0, 1), (0, -0.1), ("linear",)))])
