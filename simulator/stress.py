"""How hard the tissue is strained: von Mises stress of a motion, for pictures (thesis figure 3.18) and tables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from simulator.elements import shape_gradients
from simulator.errors import InputError
from simulator.materials import NeoHookean

if TYPE_CHECKING:
    from simulator.materials import Material

TISSUE = NeoHookean(800.0, 7000.0)  # skin and lips (thesis section 3.3.4, with G and K named right)


class Mesh(Protocol):
    """Whatever has nodes (N, 3), m, at rest, and elements (E, 8) or (E, 4): a `Mouth`, a `Model`."""

    nodes: np.ndarray
    elements: np.ndarray


def von_mises(mesh: Mesh, positions: np.ndarray, material: Material = TISSUE) -> np.ndarray:
    """Von Mises stress in every element, as if all of them were of `material`.

    sqrt(3/2 s : s), s the deviator of the Cauchy stress P F^T / det F, with the mean F of each element.

    Parameters
    ----------
    mesh : nodes at rest and elements
    positions : (T, N, 3) m, of the nodes
    material : law with a `stress`

    Returns
    -------
    stress : (T, E) Pa; NaN where an element is turned inside out

    Raises
    ------
    InputError : positions that do not fit, or a law whose stress depends on the past
    """
    positions = np.asarray(positions)
    if positions.ndim != 3 or positions.shape[1:] != mesh.nodes.shape:
        raise InputError(f"expected positions of shape (T, {len(mesh.nodes)}, 3), got {positions.shape}")
    if not hasattr(material, "stress"):
        raise InputError(
            f"expected a material whose stress follows from the shape alone, got {type(material).__name__}; "
            "take its `instantaneous` law"
        )
    B = shape_gradients(mesh.nodes, mesh.elements)
    result = np.empty((len(positions), len(mesh.elements)))
    for t, state in enumerate(positions):  # one state at a time keeps memory small
        u = np.asarray(state, float) - mesh.nodes
        F = np.eye(3) + np.einsum("eai,eaj->eij", u[mesh.elements], B)
        J = np.linalg.det(F)
        whole = J > 0
        F[~whole], J[~whole] = np.eye(3), 1.0
        cauchy = material.stress(F) @ np.swapaxes(F, 1, 2) / J[:, None, None]
        deviator = cauchy - np.einsum("eii->e", cauchy)[:, None, None] / 3 * np.eye(3)
        result[t] = np.where(whole, np.sqrt(1.5 * np.einsum("eij,eij->e", deviator, deviator)), np.nan)
    return result
