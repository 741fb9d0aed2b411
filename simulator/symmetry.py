"""Half of a mirror-symmetric model, and the whole motion from that of the half.

The half is held against motion across the plane of symmetry, which is all that the other half did to it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from simulator.elements import row_numbers
from simulator.errors import InputError
from simulator.model import Displacement, Fixed, Force, Gravity, Model, Pressure
from simulator.moisture import Lick
from simulator.motion import Motion, SalivaRecord
from simulator.saliva import Saliva

_TOLERANCE = 1e-6  # of the size of the body


@dataclass(frozen=True, eq=False)
class Half:
    """One half of a model.

    Parameters
    ----------
    model : the half on the positive side of the plane
    kept : (n,) number in the whole model of each node of the half
    axis : the plane is at right angles to it
    partner : (N,) for each node of the whole its mirror image
    whole : (N, 3) nodes of the whole at rest, m
    saliva : element numbers of the whole's saliva (S,), and (S,) where the half has each one or its image; or None
    """

    model: Model
    kept: np.ndarray
    axis: int
    partner: np.ndarray
    whole: np.ndarray
    saliva: tuple[np.ndarray, np.ndarray] | None = None

    def mirrored(self, motion: Motion) -> Motion:
        """The motion of the whole model; energies are those of both halves."""
        of_half = np.empty(len(self.whole), np.int64)
        of_half[self.partner[self.kept]] = np.arange(len(self.kept))
        of_half[self.kept] = np.arange(len(self.kept))
        sign = np.full(len(self.whole), -1.0)
        sign[self.kept] = 1.0

        def both(states):
            whole = np.empty((len(motion.time_s), *self.whole.shape))
            for state, values in zip(states, whole, strict=True):  # one after the other, as each fits the cache
                np.take(state, of_half, axis=0, out=values, mode="clip")
                values[:, self.axis] *= sign
            return whole

        positions = both(state - motion.nodes for state in motion.positions)
        positions += self.whole
        return dataclasses.replace(
            motion,
            positions=positions,
            velocities=None if motion.velocities is None else both(motion.velocities),
            nodes=self.whole,
            energies={name: 2 * values for name, values in motion.energies.items()},
            saliva=self._whole_record(motion.saliva),
        )

    def _whole_record(self, record: SalivaRecord | None) -> SalivaRecord | None:
        if record is None:
            return None
        elements, at = self.saliva
        return SalivaRecord(
            elements, *(getattr(record, name)[:, at] for name in ("state", "stretch", "moisture", "critical"))
        )


def half(model: Model, axis: int = 0, at_m: float = 0.0) -> Half:
    """Cut a mirror-symmetric model in two at the plane where coordinate `axis` is `at_m`, m.

    Raises
    ------
    InputError : a mesh, a material or a load that is not symmetric, or an element that the plane would cut
    """
    X = model.nodes
    tolerance = _TOLERANCE * np.ptp(X, axis=0).max()
    image = X.copy()
    image[:, axis] = 2 * at_m - image[:, axis]
    partner = _partners(model, image, tolerance, axis, at_m)
    side = X[model.elements][:, :, axis] - at_m
    right, left = (side > -tolerance).all(axis=1), (side < tolerance).all(axis=1)
    if not (right | left).all():
        raise InputError(
            f"expected no element across the plane of symmetry, got element {int(np.argmin(right | left))}; "
            "use an even number of elements across it"
        )
    _check_elements(model, partner, right, left)
    kept = np.unique(model.elements[right])
    number = np.full(len(X), -1)
    number[kept] = np.arange(len(kept))
    on_plane = np.abs(X[kept, axis] - at_m) <= tolerance
    loads = [_half_load(load, number, partner, axis, np.abs(X[:, axis] - at_m) <= tolerance) for load in model.loads]
    plane = Fixed(np.flatnonzero(on_plane), (axis,))
    saliva, places = _half_saliva(model, partner, right)
    part = dataclasses.replace(
        model,
        saliva=saliva,
        nodes=X[kept],
        elements=number[model.elements[right]],
        material_of=model.material_of[right],
        loads=(plane, *(load for load in loads if load is not None)),
    )
    return Half(part, kept, axis, partner, X, places)


def _partners(model: Model, image: np.ndarray, tolerance: float, axis: int, at_m: float) -> np.ndarray:
    """(N,) node at each node's mirror image; where nodes share a place, by their elements."""
    tree = cKDTree(model.nodes)
    distance, partner = tree.query(image)
    if (distance > tolerance).any():
        node = int(np.argmax(distance))
        raise InputError(
            f"expected a mirror-symmetric mesh, got node {node} without a mirror image; solve the whole model"
        )
    # Nodes doubled along a slit are told apart by the centre of their elements.
    n = model.elements.shape[1]
    centre = np.zeros_like(model.nodes)
    for axis_values, of_elements in zip(centre.T, model.nodes[model.elements].mean(axis=1).T, strict=True):
        axis_values[:] = np.bincount(model.elements.ravel(), np.repeat(of_elements, n))
    centre /= np.bincount(model.elements.ravel())[:, None]
    mirrored = centre.copy()
    mirrored[:, axis] = 2 * at_m - mirrored[:, axis]
    for node in np.flatnonzero(np.abs(centre[partner] - mirrored).max(axis=1) > tolerance):
        near = np.array(tree.query_ball_point(image[node], tolerance))
        partner[node] = near[np.argmin(np.abs(centre[near] - mirrored[node]).max(axis=1))]
    return partner


def _check_elements(model: Model, partner: np.ndarray, right: np.ndarray, left: np.ndarray) -> None:
    of_nodes = np.sort(np.concatenate([model.elements[left], partner[model.elements[right]]]), axis=1)
    of_material = np.concatenate([model.material_of[left], model.material_of[right]])
    number = row_numbers(np.column_stack([of_nodes, of_material]))
    alike = np.isin(number[left.sum() :], number[: left.sum()])
    if not alike.all():
        raise InputError(
            f"expected a mirror-symmetric mesh, got element {np.flatnonzero(right)[np.argmin(alike)]} whose image is "
            "missing or of another material; solve the whole model"
        )


def _half_saliva(model: Model, partner: np.ndarray, right: np.ndarray):
    """The saliva of the half, its elements renumbered, and `Half.saliva`."""
    saliva = model.saliva
    if saliva is None:
        return None, None
    by_nodes = {tuple(sorted(model.elements[e])): s for s, e in enumerate(saliva.elements.tolist())}
    twin = np.array(
        [by_nodes.get(tuple(sorted(partner[model.elements[e]])), -1) for e in saliva.elements.tolist()], np.int64
    )
    values = np.stack([saliva.strength, saliva.moisture, saliva.drying_per_s], axis=1)
    if (twin < 0).any() or not np.allclose(values, values[twin], rtol=1e-9, atol=0):
        raise InputError("expected mirror-symmetric saliva, got other elements or values; solve the whole model")
    for lick in saliva.licks:
        if set(twin[lick.saliva].tolist()) != set(lick.saliva.tolist()):
            raise InputError(f"expected mirror-symmetric licks, got another at {lick.time_s} s; solve the whole model")
    kept = np.flatnonzero(right[saliva.elements])
    row = np.full(len(twin), -1)
    row[kept] = np.arange(len(kept))
    number = np.cumsum(right) - 1
    licks = tuple(Lick(lick.time_s, row[lick.saliva[row[lick.saliva] >= 0]], lick.moisture) for lick in saliva.licks)
    part = Saliva(
        number[saliva.elements[kept]],
        saliva.up[kept],
        saliva.strength[kept],
        saliva.moisture[kept],
        saliva.drying_per_s[kept],
        licks,
        saliva.decay_s,
        saliva.ramp_s,
    )
    return part, (saliva.elements, np.where(row >= 0, row, row[twin]))


def _half_load(load, number: np.ndarray, partner: np.ndarray, axis: int, on_plane: np.ndarray):
    """The load on the kept nodes, renumbered, or None; on the plane the half takes half of each nodal force."""
    name = type(load).__name__
    if isinstance(load, Pressure):
        faces = {tuple(sorted(face)) for face in load.faces.tolist()}
        if any(tuple(sorted(partner[list(face)].tolist())) not in faces for face in load.faces.tolist()):
            raise InputError(f"expected mirror-symmetric faces in {name}, got others; solve the whole model")
        kept = (number[load.faces] >= 0).all(axis=1)
        return dataclasses.replace(load, faces=number[load.faces[kept]]) if kept.any() else None
    if isinstance(load, Gravity) and load.nodes is None:
        if load.direction[axis] != 0:
            raise InputError("expected Gravity along the plane of symmetry, got one across it; solve the whole model")
        return load
    sign, values = 1.0, np.ones(len(load.nodes))
    if isinstance(load, Force | Displacement):
        values = load.magnitudes_n if isinstance(load, Force) else load.magnitudes_m
        sign = -1.0 if load.axis == axis else 1.0
    of_node = np.full(len(number), np.nan)
    of_node[load.nodes] = values
    alike = np.isclose(of_node[partner[load.nodes]], sign * of_node[load.nodes], rtol=1e-9, atol=0)
    if not alike.all():
        raise InputError(
            f"expected a mirror-symmetric {name}, got node {load.nodes[np.argmin(alike)]} without its equal; "
            "solve the whole model"
        )
    kept = number[load.nodes] >= 0
    if not kept.any():
        return None
    changed = {"nodes": number[load.nodes[kept]]}
    if isinstance(load, Force):
        changed["magnitudes_n"] = np.where(on_plane[load.nodes], 0.5, 1.0)[kept] * values[kept]
    if isinstance(load, Displacement):
        changed["magnitudes_m"] = values[kept]
    return dataclasses.replace(load, **changed)
