"""The stable time step against dense eigenvalues of the mesh, and against runs just below and above it."""

import numpy as np
import pytest
from meshes import ELEMENT_TYPES, Ramp, distorted

from simulator import assembly, elements, timestep
from simulator.mesh import block, to_tetrahedra
from simulator.model import Fixed, Force, Model, NeoHookean
from simulator.solver import solve


@pytest.mark.parametrize("element_type", [pytest.param("H8", marks=pytest.mark.slow), "T4", "T4ANP"])
def test_stable_step_is_that_of_the_dense_eigenvalue_problem(element_type):
    model = distorted(element_type, np.random.default_rng(0), materials=(NeoHookean(800, 7000), NeoHookean(900, 7000)))
    mass = assembly.masses(model)
    h = 1e-7
    arguments = (model.nodes, model.elements, element_type, model.materials, model.material_of, model.hourglass)
    columns = []
    for i in range(model.nodes.size):
        u = np.zeros(model.nodes.size)
        u[i] = h
        u = u.reshape(-1, 3)
        columns.append(
            (elements.internal_forces(*arguments, u) - elements.internal_forces(*arguments, -u)).ravel() / (2 * h)
        )
    roots = np.repeat(1 / np.sqrt(mass), 3)
    largest = np.linalg.eigvals(roots[:, None] * np.array(columns) * roots).real.max()
    exact = 2 / np.sqrt(largest)
    found = timestep.stable_step(model, mass)
    assert 0.985 * exact < found < 1.003 * exact
    assert timestep.element_steps(model).min() < 1.003 * exact


def test_element_steps_are_exact_for_a_single_element():
    model = Model(*block((1, 1, 1), (0.01, 0.02, 0.015)))
    assert timestep.element_steps(model)[0] == pytest.approx(
        timestep.stable_step(model, assembly.masses(model)), rel=0.01
    )


def test_hourglass_stiffness_lowers_the_step():
    nodes, cells = block((2, 2, 2), (0.02, 0.02, 0.02))
    soft, stiff = (Model(nodes, cells, hourglass=kappa) for kappa in (0.05, 5.0))
    assert timestep.stable_step(stiff, assembly.masses(stiff)) < 0.5 * timestep.stable_step(soft, assembly.masses(soft))


@pytest.mark.parametrize("element_type", ELEMENT_TYPES)
@pytest.mark.parametrize(("part", "stable"), [(0.97, True), (1.05, False)])
def test_runs_are_stable_below_the_step_and_not_above(element_type, part, stable):
    nodes, cells = block((3, 3, 3), (0.03, 0.03, 0.03))
    cells = cells if element_type == "H8" else to_tetrahedra(nodes, cells)
    held, top = np.flatnonzero(nodes[:, 2] == 0), np.flatnonzero(nodes[:, 2] > 0.0299)
    loads = (Fixed(held), Force(top, 0, 1e-6, Ramp(0.01)))  # small, so that the body stays as stiff as at rest
    model = Model(nodes, cells, element_type, loads=loads, damping=20.0, duration_s=1.0)
    free = ~np.logical_or(*assembly.constrained(model))
    critical = timestep.stable_step(model, assembly.masses(model), free)
    at = Model(nodes, cells, element_type, loads=loads, damping=20.0, dt_s=part * critical, duration_s=800 * critical)
    motion = solve(at, precision="float64", threads=1)
    assert (motion.stopped is None) == stable
    if not stable:
        assert "too large" in motion.stopped.cause


def test_mass_is_added_only_where_the_step_asks_for_it():
    nodes, cells = block((4, 1, 1), (0.04, 0.01, 0.01))
    nodes[:, 0] = np.where(nodes[:, 0] > 0.035, 0.032, nodes[:, 0])  # one thin element
    model = Model(nodes, cells)
    own = timestep.element_steps(model)
    wanted = 0.9 * np.median(own)
    factors = timestep.mass_factors(model, wanted)
    assert (factors[:3] == 1).all()
    assert factors[3] > 1
    assert timestep.stable_step(model, assembly.masses(model, factors)) >= 0.99 * wanted
