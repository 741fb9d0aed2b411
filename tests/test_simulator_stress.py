"""Random bodies, materials, steps and loads: every run is right, or stopped with a reason; none is silently wrong.

Right means: within 10 % of a run with a step 4 times smaller and in float64, in the norm of the whole motion.
Undamped bodies that go on ringing are out of phase by then, as central differences at half to all of the limit must
be (the error falls 16-fold with the next 4 times smaller step); of these it is asked that their energy balances and
that they swing as far.
"""

import dataclasses

import numpy as np
import pytest
from meshes import ELEMENT_TYPES, Ramp

from simulator import assembly, timestep
from simulator.materials import NeoHookean
from simulator.mesh import block, to_tetrahedra
from simulator.model import Displacement, Fixed, Force, Gravity, Model
from simulator.solver import solve


def random_model(rng) -> Model:
    cells = tuple(rng.integers(1, 4, 3))
    nodes, hexahedra = block(cells, tuple(0.01 * n for n in cells))
    nodes = nodes + rng.uniform(-0.15, 0.15, nodes.shape) * 0.01
    kind = ELEMENT_TYPES[rng.integers(3)]
    elements = hexahedra if kind == "H8" else to_tetrahedra(nodes, hexahedra)
    shear = 10 ** rng.uniform(2, 4)
    poisson = rng.uniform(0.2, 0.499)
    law = NeoHookean(shear, 2 * shear * (1 + poisson) / (3 * (1 - 2 * poisson)), rng.uniform(500, 2000))
    held = np.flatnonzero(nodes[:, 2] < 0.004)
    top = np.flatnonzero(nodes[:, 2] > nodes[:, 2].max() - 0.004)
    violence = 10 ** rng.uniform(-2, 0.7)
    rise = rng.uniform(0.005, 0.05)
    load = [
        Gravity(violence * shear / 50, rng.normal(size=3), Ramp(rise)),
        Force(top, int(rng.integers(3)), violence * shear * 2e-5, Ramp(rise)),
        Displacement(top, int(rng.integers(3)), rng.choice([-1, 1]) * violence * 0.006, Ramp(rise)),
    ][rng.integers(3)]
    model = Model(nodes, elements, kind, (law,), loads=(Fixed(held), load), damping=rng.choice([0.0, 20.0, 200.0]))
    free = ~np.logical_or(*assembly.constrained(model))
    if not free.any():
        return random_model(rng)
    critical = timestep.stable_step(model, assembly.masses(model), free)
    dt = critical * rng.uniform(0.5, 1.5)
    return dataclasses.replace(model, dt_s=dt, duration_s=dt * int(rng.integers(100, 400)))


@pytest.mark.parametrize("seed", [*range(8), *(pytest.param(s, marks=pytest.mark.slow) for s in range(8, 120))])
def test_right_or_stopped(seed):
    model = random_model(np.random.default_rng(seed))
    times = np.array([0.5, 1.0]) * model.duration_s
    motion = solve(model, times, threads=1)
    assert np.isfinite(motion.positions).all()
    if motion.stopped is not None:
        assert motion.stopped.cause and motion.stopped.advice
        return
    finer = solve(dataclasses.replace(model, dt_s=model.dt_s / 4), motion.time_s, precision="float64", threads=1)
    if finer.stopped is not None:
        assert len(finer.time_s) == len(motion.time_s), f"the finer run {finer.stopped}"
    scale = max(np.linalg.norm(finer.displacements), 1e-9)
    if np.linalg.norm(motion.displacements - finer.displacements) < 0.1 * scale:
        return
    assert model.damping == 0
    assert 0.5 < np.linalg.norm(motion.displacements) / scale < 2
    if model.element_type != "T4ANP":
        work = np.abs(motion.energies["external_j"]).max()
        assert np.abs(motion.energies["residual_j"]).max() < 0.05 * work
