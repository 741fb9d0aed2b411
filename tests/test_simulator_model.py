"""Models that cannot be simulated are refused in one sentence with the place."""

import numpy as np
import pytest
from meshes import Constant, Ramp

from simulator.errors import InputError
from simulator.mesh import block
from simulator.model import Displacement, Fixed, Force, Gravity, Model, Pressure
from simulator.stability import check_supports

NODES, ELEMENTS = block((2, 1, 1), (0.02, 0.01, 0.01))


def with_node(value):
    nodes = NODES.copy()
    nodes[3] = value
    return nodes


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"nodes": NODES[:, :2]}, r"shape \(N, 3\), got \(12, 2\)"),
        ({"nodes": with_node(np.nan)}, "at node 3"),
        ({"nodes": np.vstack([NODES, [9, 9, 9]])}, "1 loose nodes, the first is node 12"),
        ({"elements": ELEMENTS + 6}, "node numbers 0 to 11, got .* in element 0"),
        ({"elements": ELEMENTS[:, [0, 0, 2, 3, 4, 5, 6, 7]]}, "8 different nodes per element, got .* in element 0"),
        ({"elements": ELEMENTS[:, [4, 5, 6, 7, 0, 1, 2, 3]]}, "positive volume, got -1e-06 m3 in element 0 and 2"),
        ({"elements": ELEMENTS[:, :4]}, "H8 elements of shape"),
        ({"element_type": "H20"}, "H8, T4, T4ANP, got 'H20'"),
        ({"material_of": np.array([0, 1])}, "materials 0 to 0, got 1 for element 1"),
        ({"materials": ()}, "at least one material"),
        ({"dt_s": 0.0}, "dt_s above 0 s or 'auto', got 0.0"),
        ({"dt_s": -1e-4}, "dt_s above 0 s"),
        ({"duration_s": float("nan")}, "duration_s above 0 s"),
        ({"damping": -1}, "damping of 0 1/s or more"),
        ({"hourglass": -0.1}, "hourglass stiffness of 0 or more"),
        ({"output_every": 0}, "output_every of 1 step or more"),
        ({"loads": (Fixed([12]),)}, "node numbers 0 to 11 in Fixed, got 12"),
    ],
)
def test_models(change, says):
    with pytest.raises(InputError, match=says):
        Model(**{"nodes": NODES, "elements": ELEMENTS, **change})


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Fixed([]), "the nodes of Fixed as one or more node numbers, got an empty set"),
        (lambda: Fixed([0.5]), "node numbers, got shape"),
        (lambda: Fixed([0], (3,)), "axes 0, 1 or 2 in Fixed"),
        (lambda: Force([0, 1], 0, [1.0], Constant()), "one number or 2, one per node"),
        (lambda: Force([0, 5], 0, [1.0, np.nan], Constant()), "finite magnitudes_n in Force, got nan at node 5"),
        (lambda: Displacement([0], 1, np.inf, Constant()), "finite magnitudes_m"),
        (lambda: Displacement([0], 1, 1.0, "RAMP"), "to have value"),
        (lambda: Gravity(9.81, (0, 0, 0), Constant()), "not all 0"),
        (lambda: Pressure(np.zeros((0, 4), int), 1.0, Constant()), "Pressure faces"),
        (lambda: Pressure([[0, 1, 2, 3]], np.nan, Constant()), "finite Pressure magnitude"),
    ],
)
def test_loads(make, says):
    with pytest.raises(InputError, match=says):
        make()


def test_a_model_cannot_be_changed_through_its_arrays():
    model = Model(NODES, ELEMENTS)
    with pytest.raises(ValueError, match="read-only"):
        model.nodes[0] = 1


@pytest.mark.parametrize(
    ("loads", "says"),
    [
        ((), "free to move along x, y, z"),
        ((Fixed(np.arange(12), (0, 1)),), "free to move along z"),
        ((Fixed([0, 3, 6, 9]),), None),
        ((Fixed([0, 3]),), "is free to turn"),  # a hinge
        ((Fixed([0]), Displacement(np.arange(12), 2, 0.001, Ramp(1))), "is free to turn"),
        ((Fixed(np.arange(12)[NODES[:, 0] == 0], (0,)), Fixed([0], (1, 2)), Fixed([3], (2,))), None),
    ],
)
def test_bodies_that_can_move_without_deforming(loads, says):
    model = Model(NODES, ELEMENTS, loads=loads)
    if says is None:
        check_supports(model)
        return
    with pytest.raises(InputError, match=says):
        check_supports(model)
    check_supports(Model(NODES, ELEMENTS, loads=loads, free_bodies=True))


def test_each_of_two_bodies_must_be_held():
    nodes = np.concatenate([NODES, NODES + 1])
    model = Model(nodes, np.concatenate([ELEMENTS, ELEMENTS + 12]), loads=(Fixed([0, 3, 6, 9]),))
    with pytest.raises(InputError, match="one of 12 nodes, the first is node 12"):
        check_supports(model)
