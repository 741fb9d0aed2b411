"""Half a model solved, and mirrored, is the whole model solved."""

import numpy as np
import pytest
from meshes import Ramp

from simulator.errors import InputError
from simulator.mesh import block
from simulator.model import Fixed, Force, Gravity, Model, Pressure
from simulator.solver import solve
from simulator.symmetry import half


def pressed_plate(cells=(6, 3, 2), **settings) -> Model:
    nodes, elements = block(cells, (0.06, 0.03, 0.02))
    nodes = nodes - [0.03, 0, 0]
    nodes[:, 1] += 0.1 * nodes[:, 0] ** 2 / 0.03  # curved, but even in x
    far, top = np.flatnonzero(nodes[:, 2] == 0), np.flatnonzero(nodes[:, 2] > 0.0199)
    faces = elements[:, [4, 5, 6, 7]]
    faces = faces[(nodes[faces][:, :, 2] > 0.0199).all(axis=1)]
    loads = (
        Fixed(far),
        Force(top, 1, 2e-4, Ramp(0.05)),
        Force(top, 0, 1e-2 * nodes[top, 0], Ramp(0.05)),
        Gravity(9.81, (0, -1, 1), Ramp(0.05)),
        Pressure(faces, 30.0, Ramp(0.05)),
    )
    settings = {"loads": loads, "damping": 20.0, "dt_s": 2e-4, "duration_s": 0.1, **settings}
    return Model(nodes, elements, **settings)


def test_half_the_mesh_gives_the_whole_motion():
    model = pressed_plate()
    whole = solve(model, [0.05, 0.1], precision="float64")
    part = half(model)
    assert len(part.model.elements) == len(model.elements) / 2
    mirrored = part.mirrored(solve(part.model, [0.05, 0.1], precision="float64"))
    assert np.abs(whole.displacements).max() > 1e-3
    assert np.abs(mirrored.positions - whole.positions).max() < 1e-10 * np.abs(whole.displacements).max()
    for name, values in whole.energies.items():
        if name != "residual_j":
            assert mirrored.energies[name] == pytest.approx(values, rel=1e-6, abs=1e-12)


def test_what_is_not_symmetric_is_refused():
    model = pressed_plate()
    with pytest.raises(InputError, match="no element across the plane"):
        half(pressed_plate((5, 3, 2)))
    nodes = model.nodes.copy()
    nodes[5, 2] += 1e-3
    with pytest.raises(InputError, match="without a mirror image"):
        half(Model(nodes, model.elements))
    with pytest.raises(InputError, match="mirror-symmetric Force"):
        half(Model(model.nodes, model.elements, loads=(Force([0], 1, 1.0, Ramp(1)),)))
    with pytest.raises(InputError, match="mirror-symmetric Force"):
        half(Model(model.nodes, model.elements, loads=(Force(np.arange(len(model.nodes)), 0, 1.0, Ramp(1)),)))
    with pytest.raises(InputError, match="Gravity along the plane"):
        half(Model(model.nodes, model.elements, loads=(Gravity(1.0, (1, 0, 0), Ramp(1)),)))
    material_of = np.zeros(len(model.elements), int)
    material_of[0] = 1
    with pytest.raises(InputError, match="of another material"):
        half(
            Model(model.nodes, model.elements, materials=(*model.materials, *model.materials), material_of=material_of)
        )
