"""Closed lips that nothing moves stay at rest: touching and parting by rounding errors feeds no wave."""

import dataclasses

import numpy as np
import pytest

from simulator import assembly, film, symmetry, timestep
from simulator.faces import FACES, random_face
from simulator.partition import partition
from simulator.scene import load_scene
from simulator.solver import solve

DRIVEN = (24, 25, 37)  # random faces whose closed lips blew up at 0.9 of the stable step


def closed(shape, resolution="low"):
    """Half of a mouth that does nothing, its lips closed and not sticky."""
    scene = load_scene("slow_open", 0.0)
    face = dataclasses.replace(scene.face, resolution=resolution, **dataclasses.asdict(shape))
    return symmetry.half(dataclasses.replace(scene, muscle=(), face=face).model()[1]).model


def drawn(number):
    return random_face(np.random.default_rng([78, number]))


def kinetic_j(model):
    motion = solve(model, np.linspace(0, 0.6, 7), velocities=True, threads=1)
    assert motion.stopped is None and motion.settings["restarts"] == 0
    return np.abs(motion.energies["kinetic_j"]).max()


@pytest.mark.parametrize("number", DRIVEN)
def test_lips_that_touch_gain_no_energy(number):
    assert kinetic_j(closed(drawn(number))) < 1e-14


@pytest.mark.slow
@pytest.mark.parametrize("shape", [*FACES.values(), *map(drawn, range(40))])
def test_lips_of_many_faces_gain_no_energy(shape):
    assert kinetic_j(closed(shape)) < 1e-14


def test_inertia_of_near_ends_is_a_share_of_the_tissue_and_follows_no_mass_scaling():
    model = closed(FACES["wide"])
    stiffness = timestep.node_stiffness(model, assembly.masses(model))
    steps = timestep.element_steps(model)
    node = model.elements[model.saliva.elements[0], 0]
    tissue = np.setdiff1d(np.flatnonzero((model.elements == node).any(axis=1)), model.saliva.elements)
    assert stiffness[node] == assembly.masses(model)[node] * (2 / steps[tissue].min()) ** 2
    heavy = dataclasses.replace(
        model, materials=tuple(dataclasses.replace(one, density=4 * one.density) for one in model.materials)
    )
    np.testing.assert_allclose(timestep.node_stiffness(heavy, assembly.masses(heavy)), stiffness, rtol=1e-12)
    arrays, _ = assembly.film_arrays(model, partition(model.elements, assembly.laws(model), len(model.nodes)))
    assert (arrays.pair_tissue > 0).all()
    assert arrays.pair_tissue.max() < film.NEAR_INERTIA * stiffness.max() / 2 * (1 + 1e-12)
