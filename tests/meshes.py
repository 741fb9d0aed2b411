"""Small meshes for the tests of the simulator."""

import numpy as np

from simulator.mesh import block, to_tetrahedra
from simulator.model import Model, NeoHookean, StVenantKirchhoff

ELEMENT_TYPES = ("H8", "T4", "T4ANP")


class Ramp:
    """Load factor that grows to 1 over `rise_s` as a smooth half cosine and stays there."""

    def __init__(self, rise_s: float):
        self.rise_s = rise_s

    def value(self, t_s):
        return 0.5 - 0.5 * np.cos(np.pi * np.clip(np.asarray(t_s) / self.rise_s, 0, 1))

    def rate(self, t_s):
        t = np.asarray(t_s)
        return np.where(t < self.rise_s, 0.5 * np.pi / self.rise_s * np.sin(np.pi * t / self.rise_s), 0.0)


class Constant:
    """Load factor 1 at all times."""

    def value(self, t_s):
        return np.ones_like(np.asarray(t_s, dtype=float))

    def rate(self, t_s):
        return np.zeros_like(np.asarray(t_s, dtype=float))


def distorted(element_type: str, rng, cells=(3, 2, 4), jitter=0.1, **settings) -> Model:
    """Block of 1 cm cells with every node moved by a tenth of a cell, two materials strewn over it."""
    nodes, hexahedra = block(cells, tuple(0.01 * n for n in cells))
    nodes = nodes + rng.uniform(-jitter, jitter, nodes.shape) * 0.01
    elements = hexahedra if element_type == "H8" else to_tetrahedra(nodes, hexahedra)
    settings = {"materials": (NeoHookean(800, 7000), StVenantKirchhoff(2000, 0.4)), **settings}
    material_of = rng.integers(0, len(settings["materials"]), len(elements))
    return Model(nodes, elements, element_type, material_of=material_of, **settings)
