"""The state that a damped run settles in, against an independent fully integrated static solution, refined."""

import sys
from pathlib import Path

import numpy as np
import pytest
from implicit import _stress_and_stiffness, equilibrium
from meshes import Ramp

from simulator.elements import lumped_mass
from simulator.materials import NeoHookean
from simulator.mesh import block
from simulator.model import Fixed, Force, Model
from simulator.solver import solve

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import statics

SIZE = (0.04, 0.02, 0.02)


def pushed(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Block of 2n x n x n cells that slides on three planes under a smooth body force: nodes, elements, forces, fixed.

    Without clamped edges the solution is smooth, so that theory's order 2 can be seen on coarse meshes.
    """
    nodes, elements = block((2 * n, n, n), SIZE)
    x, y, z = (nodes / SIZE).T
    pattern = np.stack(
        [np.sin(np.pi * x / 2) * (1 - y), 0.3 * np.cos(np.pi * x) * y, -x * np.sin(np.pi * z / 2)], axis=1
    )
    volume = lumped_mass(nodes, elements, np.ones(len(elements)))
    return nodes, elements, 2e4 * volume[:, None] * pattern, nodes < 1e-9


def test_reference_stress_and_stiffness_are_right():
    rng = np.random.default_rng(0)
    F = np.eye(3) + rng.uniform(-0.2, 0.2, (4, 3, 3))
    P, A = _stress_and_stiffness(F, 800, 7000)
    assert np.allclose(P, NeoHookean(800, 7000).stress(F), rtol=1e-12, atol=1e-9)
    dF = rng.normal(size=(3, 3))
    h = 1e-6
    change = (_stress_and_stiffness(F + h * dF, 800, 7000)[0] - _stress_and_stiffness(F - h * dF, 800, 7000)[0]) / (
        2 * h
    )
    assert np.abs(np.einsum("eijkl,kl->eij", A, dF) - change).max() < 1e-7 * np.abs(change).max()


def compliance(forces: np.ndarray, u: np.ndarray) -> float:
    """Work of the forces at their displacement, J."""
    return float(np.sum(forces * u))


def settled(n: int) -> float:
    """Compliance, J, at the end of a damped run."""
    nodes, elements, forces, fixed = pushed(n)
    loads = [Fixed(np.flatnonzero(fixed[:, axis]), (axis,)) for axis in range(3)]
    loads += [Force(np.arange(len(nodes)), axis, forces[:, axis], Ramp(0.3)) for axis in range(3)]
    model = Model(nodes, elements, loads=tuple(loads), damping=60.0, duration_s=1.2)
    motion = solve(model, [1.0, 1.2], precision="float64")
    assert motion.stopped is None
    before, after = (compliance(forces, u) for u in motion.displacements)
    assert before == pytest.approx(after, rel=1e-6)  # at rest
    return after


def converged() -> float:
    """Compliance, J, of the reference solution, extrapolated from two meshes by the order 2 of trilinear elements."""
    found = []
    for n in (6, 12):
        nodes, elements, forces, fixed = pushed(n)
        found.append(compliance(forces, equilibrium(nodes, elements, 800, 7000, forces, fixed)))
    return found[1] + (found[1] - found[0]) / 3


@pytest.mark.slow
def test_static_limit_converges_to_the_fully_integrated_solution():
    counts = np.array([4, 8, 16])
    limit = converged()
    errors = np.array([abs(settled(n) / limit - 1) for n in counts])
    assert errors[-1] < 0.01
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] == pytest.approx(2, abs=0.25)


@pytest.mark.slow
def test_static_limit_is_that_of_quadratic_elements_of_scikit_fem():
    pytest.importorskip("skfem", reason="scikit-fem absent: pip install 'lipmetrics[benchmarks]'")
    material = statics.MATERIALS["tissue, Poisson's ratio 0.445"]
    truth = statics.equilibrium(4, material)
    coarse, fine = (statics.distance(statics.settled(n, material), truth) for n in (4, 8))
    assert fine < 0.004
    assert np.log2(coarse / fine) == pytest.approx(2, abs=0.25)
