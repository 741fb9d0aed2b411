"""The state that a damped run settles in, against an independent fully integrated static solution, refined."""

import numpy as np
import pytest
from implicit import _stress_and_stiffness, equilibrium
from meshes import Ramp

from simulator.materials import NeoHookean
from simulator.mesh import block
from simulator.model import Fixed, Force, Model
from simulator.solver import solve

SIZE = (0.04, 0.02, 0.02)


def pulled(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Block of 2n x n x n cells held at x = 0, dragged down along its far face: nodes, elements, forces, fixed."""
    nodes, elements = block((2 * n, n, n), SIZE)
    far = nodes[:, 0] > SIZE[0] - 1e-9
    share = np.where(far, 1.0, 0.0)
    for axis in (1, 2):
        share[(nodes[:, axis] < 1e-9) | (nodes[:, axis] > SIZE[axis] - 1e-9)] *= 0.5
    forces = np.zeros_like(nodes)
    forces[:, 2] = -0.01 * share / share.sum()
    return nodes, elements, forces, np.repeat((nodes[:, 0] < 1e-9)[:, None], 3, axis=1)


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


def settled(n: int) -> float:
    """Mean sag of the far face, m, at the end of a damped run."""
    nodes, elements, forces, fixed = pulled(n)
    far = np.flatnonzero(forces[:, 2])
    loads = (Fixed(np.flatnonzero(fixed[:, 0])), Force(far, 2, forces[far, 2], Ramp(0.5)))
    motion = solve(Model(nodes, elements, loads=loads, damping=25.0, duration_s=2.5), [2.0, 2.5], precision="float64")
    assert motion.stopped is None
    sag = (motion.displacements[:, :, 2] * forces[:, 2]).sum(axis=1) / forces[:, 2].sum()
    assert sag[0] == pytest.approx(sag[1], rel=2e-5)  # at rest
    return sag[1]


@pytest.mark.slow
def test_static_limit_converges_to_the_fully_integrated_solution():
    counts = np.array([2, 4, 8])
    exact = []
    for n in (2, 4, 8):
        nodes, elements, forces, fixed = pulled(n)
        u = equilibrium(nodes, elements, 800, 7000, forces, fixed)
        exact.append((u[:, 2] * forces[:, 2]).sum() / forces[:, 2].sum())
    # Richardson: the compliance error falls with a power of h found from the three meshes.
    ratio = (exact[1] - exact[0]) / (exact[2] - exact[1])
    limit = exact[2] + (exact[2] - exact[1]) / (ratio - 1)
    errors = np.array([abs(settled(n) - limit) for n in counts]) / abs(limit)
    slope = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert errors[-1] < 0.01
    assert 1.5 < slope < 2.6  # theory: 2 for smooth solutions, less for the edges of the clamp
