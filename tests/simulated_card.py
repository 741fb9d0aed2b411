"""Runs on numba's simulated card beside the processor: `NUMBA_ENABLE_CUDASIM=1 python simulated_card.py`.

Prints, case by case as JSON, by how much the motion, the energies and the saliva's record differ.
"""

import json
from dataclasses import replace

import numpy as np
from glued_blocks import glued_blocks
from meshes import Ramp, distorted

from simulator.curves import KeyFrames
from simulator.materials import NeoHookean, StVenantKirchhoff, ViscoNeoHookean
from simulator.mesh import block
from simulator.model import Displacement, Fixed, Force, Gravity, Model, Pressure
from simulator.solver import solve

DT = 2e-4


def solid(*kinds, steps=10, **settings) -> Model:
    """12 elements held below, under loads of these kinds."""
    nodes, elements = block((2, 2, 3), (0.02, 0.02, 0.03))
    top = np.flatnonzero(nodes[:, 2] > 0.0299)
    left = elements[elements[:, 0] % 3 == 0][:, [0, 3, 7, 4]]
    loads = {
        "press": Pressure(left, 600.0, Ramp(0.002)),
        "pull": Force(top, 0, 0.01, Ramp(0.002)),
        "fall": Gravity(9.81, (1.0, 0.2, -0.1), Ramp(0.002)),
        "move": Displacement(top, 2, -0.003, Ramp(0.002)),
        "slide": Displacement(top[:3], 0, 0.002, Ramp(0.002)),
    }
    held = Fixed(np.flatnonzero(nodes[:, 2] == 0))
    settings = {"damping": 20.0, "dt_s": DT, "duration_s": steps * DT, **settings}
    return Model(nodes, elements, loads=(held, *(loads[kind] for kind in kinds)), **settings)


def tetrahedra() -> Model:
    mesh = distorted("T4", np.random.default_rng(0), cells=(1, 1, 1))
    loads = (Fixed(np.flatnonzero(mesh.nodes[:, 2] < 0.003)), Gravity(9.81, (1, 0.2, -0.1), Ramp(0.002)))
    return Model(mesh.nodes, mesh.elements, "T4", loads=loads, dt_s=DT, duration_s=6 * DT)


def lips() -> Model:
    """A film of two elements that is torn and closes again."""
    opening = KeyFrames((0.0, 0.002, 0.004), (0.0, 1.0, 0.0), ("linear",) * 2)
    model = glued_blocks(opening, peak_m=1e-4, strength=1e-5, duration_s=0.004, decay_s=1e-5, ramp_s=4e-4)
    return replace(model, dt_s=1.5e-4)


LAWS = NeoHookean(800, 7000), StVenantKirchhoff(2000, 0.4)
VISCOUS = ViscoNeoHookean(800.0, 7000.0, isochoric=((0.4, 0.01),), volumetric=((0.2, 0.02),))
CASES = {
    "forces, pressures and gravity": (solid("press", "pull", "fall"), "float64"),
    "prescribed displacements": (solid("move", "slide"), "float64"),
    "two laws, mixed": (solid("press", "fall", materials=LAWS, material_of=np.arange(12) % 2), "mixed"),
    "viscous": (solid("fall", materials=(VISCOUS,)), "float64"),
    "tetrahedra": (tetrahedra(), "float64"),
    "saliva": (lips(), "float64"),
    "a step far too large": (solid("move", dt_s=4e-3, steps=200), "float64"),
    "a step halved": (solid("move", dt_s="auto", steps=30), "float64"),
}


def differences(model: Model, precision: str) -> dict:
    times = np.linspace(0.0, model.duration_s, 4 if model.saliva is None else 28)
    one = solve(model, times, precision=precision, device="cuda")
    other = solve(model, times, precision=precision, threads=1)
    size, work = np.abs(other.displacements).max(), np.abs(other.energies["external_j"]).max()
    found = {
        "moved_m": float(size),
        "motion_m": float(np.abs(one.positions - other.positions).max()),
        "energies": max(float(np.abs(one.energies[name] - a).max()) for name, a in other.energies.items()),
        "work": float(work),
        "stopped": [str(one.stopped), str(other.stopped)],
        "steps": [one.steps, other.steps],
        "restarts": other.settings["restarts"],
        "device": one.settings["device"],
    }
    if other.saliva is not None:
        found["states"] = np.unique(other.saliva.state).tolist()
        found["stretch"] = float(np.abs(one.saliva.stretch - other.saliva.stretch).max())
        found["same_states"] = bool((one.saliva.state == other.saliva.state).all())
    return found


if __name__ == "__main__":
    print(json.dumps({name: differences(*case) for name, case in CASES.items()}))
