"""The von Mises stress of `simulator.stress`, against formulas."""

import dataclasses

import numpy as np
import pytest
from moved_mouth import moved_mouth

from simulator.errors import InputError
from simulator.materials import NeoHookean, StVenantKirchhoff, ViscoNeoHookean
from simulator.mesh import block, to_tetrahedra
from simulator.mouth import mouth_mesh
from simulator.stress import von_mises


@dataclasses.dataclass
class Body:
    nodes: np.ndarray
    elements: np.ndarray


@pytest.fixture(params=["H8", "T4"])
def body(request):
    nodes, elements = block((2, 3, 2), (0.02, 0.03, 0.01))
    return Body(nodes, elements if request.param == "H8" else to_tetrahedra(nodes, elements))


@pytest.mark.parametrize(("along", "across"), [(1.3, 0.9), (0.7, 1.1), (1.0, 1.0)])
def test_uniaxial_stretch(body, along, across):
    # Cauchy stresses of diag(a, b, b) differ by G J^(-5/3) (a^2 - b^2), and that is the von Mises stress.
    J = along * across**2
    positions = body.nodes[None] * [along, across, across]
    stress = von_mises(body, positions, NeoHookean(800.0, 7000.0))
    expected = 800 * J ** (-5 / 3) * abs(along**2 - across**2)
    assert stress.shape == (1, len(body.elements))
    np.testing.assert_allclose(stress, expected, rtol=1e-9, atol=1e-9)


def test_simple_shear(body):
    # F = I + g e1 e2: s = G (B - tr B / 3), and 3/2 s : s = 3 G^2 (g^2 + g^4 / 3).
    g = 0.4
    positions = body.nodes[None] + g * body.nodes[None, :, [1]] * [1, 0, 0]
    expected = 800 * np.sqrt(3 * (g**2 + g**4 / 3))
    np.testing.assert_allclose(von_mises(body, positions), expected, rtol=1e-9)


def test_pressure_and_turns_have_none(body):
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    assert von_mises(body, body.nodes[None] * 0.8).max() < 1e-9
    assert von_mises(body, (body.nodes @ turn.T)[None] + 0.3).max() < 1e-9
    stretched = body.nodes * [1.2, 1, 1]
    both = von_mises(body, np.stack([stretched, stretched @ turn.T]), StVenantKirchhoff(1000.0, 0.3))
    np.testing.assert_allclose(both[1], both[0], rtol=1e-9)


def test_an_element_turned_inside_out_has_no_number(body):
    mirrored = body.nodes[None] * [-1, 1, 1]
    assert np.isnan(von_mises(body, mirrored)).all()


def test_a_mouth_at_rest_has_none_and_open_has_some():
    mouth, motion = moved_mouth(times=3)
    stress = von_mises(mouth, motion.positions)
    assert stress.shape == (3, len(mouth.elements)) and stress[0].max() < 1e-9 and stress[2].max() > 100


def test_bad_input():
    mouth = mouth_mesh(resolution="low")
    with pytest.raises(InputError, match=r"shape \(T, 1888, 3\), got \(1888, 3\)"):
        von_mises(mouth, mouth.nodes)
    with pytest.raises(InputError, match=r"got ViscoNeoHookean; take its `instantaneous` law"):
        von_mises(mouth, mouth.nodes[None], ViscoNeoHookean(800.0, 7000.0))
