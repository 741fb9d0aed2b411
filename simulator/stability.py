"""What makes a run impossible before it starts, and what made it fail once it has."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from simulator import assembly, kernels, timestep
from simulator import elements as geometry
from simulator.errors import InputError
from simulator.model import Model
from simulator.motion import Stop


def check_supports(model: Model) -> None:
    """Refuse a body that can move or turn without deforming, unless the model allows `free_bodies`.

    Raises
    ------
    InputError : names a node of the first such body and what it is free to do
    """
    if model.free_bodies:
        return
    n = model.elements.shape[1]
    first = np.repeat(model.elements[:, 0], n - 1)
    links = sparse.coo_array(
        (np.ones(len(first)), (first, model.elements[:, 1:].ravel())), shape=(len(model.nodes),) * 2
    )
    count, body_of = connected_components(links, directed=False)
    held = np.logical_or(*assembly.constrained(model))
    for body in range(count):
        nodes = np.flatnonzero(body_of == body)
        if _rank(model.nodes[nodes], held[nodes]) < 6:
            raise InputError(
                f"expected every body to be held against moving and turning, got one of {len(nodes)} nodes, "
                f"the first is node {nodes[0]}, that {_freedom(held[nodes])}; fix more "
                "of its nodes, or set free_bodies if it is meant to fly"
            )


def _rank(X: np.ndarray, held: np.ndarray) -> int:
    """How many of the six rigid motions of a body X (n, 3) the held degrees of freedom (n, 3) resist."""
    gram = np.zeros((6, 6))
    x = X - X.mean(axis=0)
    x = x / max(np.abs(x).max(), 1e-300)
    for axis in range(3):
        rows = np.zeros((len(x), 6))
        rows[:, axis] = 1
        # Component `axis` of r x X for a rotation about each axis.
        rows[:, 3 + (axis + 1) % 3] = x[:, (axis + 2) % 3]
        rows[:, 3 + (axis + 2) % 3] = -x[:, (axis + 1) % 3]
        rows = rows[held[:, axis]]
        gram += rows.T @ rows
    values = np.linalg.eigvalsh(gram)
    return int((values > 1e-9 * max(values[-1], 1e-300)).sum())


def _freedom(held: np.ndarray) -> str:
    free = [name for axis, name in enumerate("xyz") if not held[:, axis].any()]
    return f"is free to move along {', '.join(free)}" if free else "is free to turn"


def diagnose(
    model: Model, mass: np.ndarray, u: np.ndarray, du: np.ndarray, time_s: float, dt: float, reason: int
) -> Stop:
    """Explain why a run cannot go on from displacement u (N, 3), reached by the increment du (N, 3), m.

    reason : as `kernels.advance` gives it
    """
    with np.errstate(all="ignore"):
        J = np.stack(
            [np.linalg.det(geometry.deformation_gradients(model.nodes, model.elements, w)) for w in (u - du, u)]
        )
    if model.saliva is not None:
        J[:, model.saliva.elements] = 1.0  # broken, they are pulled and turned at will
    fixed, moved = assembly.constrained(model)
    stable = timestep.stable_step(model, mass, ~(fixed | moved))
    too_large = dt > stable
    smaller = (
        f"the stable limit of the mesh at rest is {stable:.3g} s: use dt_s = {0.8 * min(stable, dt):.2g} or 'auto'"
    )
    load = "apply the load more slowly or in smaller measure, refine the mesh there, or use a smaller dt_s"
    if too_large:
        element = _fastest(model, mass, du) if reason == kernels.ENERGY_GREW else _worst(J)
        return Stop(time_s, element, f"the time step {dt:.3g} s is too large, the motion grew without bound", smaller)
    if not np.isfinite(u).all():
        return Stop(time_s, _worst(J), "a displacement is not a finite number", load)
    if reason == kernels.INVERTED:
        return Stop(time_s, _worst(J), "an element was turned inside out", load)
    return Stop(
        time_s,
        _fastest(model, mass, du),
        "the energy grew beyond what the loads supplied",
        f"squeezed elements need a smaller step: halve dt_s = {dt:.3g}, or use 'auto'; or {load}",
    )


def _worst(J: np.ndarray) -> int:
    """Element of the first state of J (2, E) that is not finite or inverted somewhere, the worst one there."""
    for state in J:
        bad = np.where(np.isfinite(state), state, -np.inf)
        if (bad <= 0).any():
            return int(np.argmin(bad))
    return int(np.argmin(J[0]))


def _fastest(model: Model, mass: np.ndarray, du: np.ndarray) -> int:
    """An element at the node that carries most kinetic energy."""
    energy = np.nan_to_num(mass * np.sum(du.astype(float) ** 2, axis=1), nan=np.inf)
    return int(np.argmax((model.elements == np.argmax(energy)).any(axis=1)))
