"""How hard the tissue is pulled: the von Mises stress of every element, for display."""

from __future__ import annotations

import numpy as np

from simulator.elements import shape_gradients
from simulator.materials import NeoHookean
from simulator.mouth import Mouth

TISSUE = NeoHookean(800.0, 7000.0)


def von_mises(
    mouth: Mouth, positions: np.ndarray, material: NeoHookean = TISSUE, gradients: np.ndarray | None = None
) -> np.ndarray:
    """(E,) Pa: sqrt(3/2 s:s), s the deviator of the Cauchy stress sigma = P F^T / J, of tissue in every element.

    Parameters
    ----------
    positions : (N, 3) m
    material : law of the tissue; saliva elements are reckoned with it too and mean nothing
    gradients : `shape_gradients(mouth.nodes, mouth.elements)`, if at hand
    """
    B = shape_gradients(mouth.nodes, mouth.elements) if gradients is None else gradients
    F = np.swapaxes(np.asarray(positions)[mouth.elements], 1, 2) @ B
    J = np.maximum(np.linalg.det(F), 1e-9)[:, None, None]
    sigma = material.stress(F) @ np.swapaxes(F, 1, 2) / J
    s = sigma - np.trace(sigma, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    return np.sqrt(1.5 * np.einsum("eij,eij->e", s, s))
