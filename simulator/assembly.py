"""From a model to the arrays of the kernels: element constants, nodal records, loads by degree of freedom."""

from __future__ import annotations

import math

import numpy as np

from simulator import elements as geometry
from simulator import film, kernels, timestep
from simulator.errors import InputError
from simulator.materials import NeoHookean, StVenantKirchhoff, ViscoNeoHookean
from simulator.model import Displacement, Fixed, Force, Gravity, Model, Pressure
from simulator.partition import Partition
from simulator.simd import LANES, RUN_ORDER

_ELEMENTS = {"H8": kernels.H8Elements, "T4": kernels.T4Elements, "T4ANP": kernels.T4ANPElements}
_LAW = {
    NeoHookean: kernels.NEO_HOOKEAN,
    StVenantKirchhoff: kernels.ST_VENANT_KIRCHHOFF,
    ViscoNeoHookean: kernels.VISCO_NEO_HOOKEAN,
}
# (dtype of elements, dtype of nodal sums)
PRECISIONS = {
    "float32": (np.float32, np.float32),
    "mixed": (np.float32, np.float64),
    "float64": (np.float64, np.float64),
}


def laws(model: Model) -> np.ndarray:
    """(E,) constitutive law of each element, as the kernels number them."""
    return np.array([_LAW[type(material)] for material in model.materials])[model.material_of]


def masses(model: Model, factors: np.ndarray | float = 1.0) -> np.ndarray:
    """(N,) lumped nodal mass, kg, the mass of each element multiplied by `factors` (E,) or one number."""
    density = np.array([material.density for material in model.materials])[model.material_of]
    return geometry.shared_out(model.elements, density * factors * model.volumes, len(model.nodes))


def element_arrays(model: Model, parts: Partition, dtype: type, dt: float, lanes: int | None = None):
    """H8Elements, T4Elements or T4ANPElements of a model, in batches of `lanes` elements; None: of one register.

    dt (s) enters the viscous terms only.
    """
    L = lanes or LANES[np.dtype(dtype)]
    order = parts.elements
    stored_at = np.empty(len(model.nodes), np.int32)
    stored_at[parts.nodes] = np.arange(len(model.nodes), dtype=np.int32)
    spare = len(model.nodes)  # record of the empty elements
    starts_of_records = 4 * np.where(order[:, None] >= 0, stored_at[model.elements[order]], spare).astype(np.int32)
    if len(RUN_ORDER) == L:
        _complete_runs(starts_of_records, order, L)
    constants = _element_constants(model)[order]
    constants[order < 0] = 0.0
    swept = np.zeros(-(-len(order) // L), np.int64)
    if model.element_type == "H8":
        swept[:] = np.logical_and.reduceat(_swept(constants), np.arange(0, len(order), L))
    law = laws(model)[order]
    history, terms = _history(model, dt)
    starts = -(-parts.element_starts // L)
    return _ELEMENTS[model.element_type](
        _batched(starts_of_records, L, 4 * spare),
        _batched(constants.astype(dtype), L, 0),
        law[::L].astype(np.int64),
        _runs(starts_of_records, L),
        swept,
        _batched(history[order].astype(dtype), L, 0),
        terms,
        starts,
    )


def _complete_runs(starts: np.ndarray, order: np.ndarray, L: int) -> None:
    """Let the empty elements at the end of a row go on along it, so that its last batch is a run as the others are.

    They have no stiffness and add nothing to the nodes that happen to be stored there.
    """
    whole = starts[: len(starts) // L * L].reshape(-1, L, starts.shape[1])
    going_on = whole[:, :1] + 4 * np.array(RUN_ORDER, np.int32)[None, :, None]
    empty = order[: whole.shape[0] * L].reshape(-1, L) < 0
    runs = ((whole == going_on).all(axis=2) | empty).all(axis=1)
    whole[:] = np.where((runs[:, None] & empty)[:, :, None], going_on, whole)


def _runs(starts: np.ndarray, L: int) -> np.ndarray:
    """(B,) 1 where a batch of record starts (E, n) is a run as kernels.H8Elements has it, else 0."""
    batches = -(-len(starts) // L)
    runs = np.zeros(batches, np.int64)
    if len(RUN_ORDER) != L or starts.shape[1] != 8:
        return runs
    whole = starts[: len(starts) // L * L].reshape(-1, L, 8)
    in_order = whole == whole[:, :1] + 4 * np.array(RUN_ORDER)[None, :, None]
    next_places = whole[:, 0, [1, 2, 5, 6]] == whole[:, 0, [0, 3, 4, 7]] + 4
    runs[: len(whole)] = in_order.all(axis=(1, 2)) & next_places.all(axis=1)
    return runs


def _swept(constants: np.ndarray) -> np.ndarray:
    """(E,) whether the constants that kernels.H8Elements.swept promises to be 0 are, but for rounding of the nodes."""
    size = np.abs(constants[:, :9]).max(axis=1)  # of the gradients, 1/m
    W_third, L_others = np.abs(constants[:, 15:18]).max(axis=1), np.abs(constants[:, _L_OTHERS]).max(axis=1)
    return (W_third <= _ROUNDING * size) & (L_others * size <= _ROUNDING)


_L_OTHERS = [*range(21, 27), *range(30, 33)]  # hourglass extents of the modes eta zeta, xi zeta and xi eta zeta
_ROUNDING = 1e-12


def _element_constants(model: Model) -> np.ndarray:
    """(E, Q) in the order of kernels.CONSTANTS."""
    n_elements, V, B = len(model.elements), model.volumes, model.shape_gradients
    shear, bulk, wave = (
        np.array([getattr(material, name) for material in model.materials])[model.material_of]
        for name in ("shear_pa", "bulk_pa", "wave_modulus_pa")
    )
    second = np.where(laws(model) == kernels.ST_VENANT_KIRCHHOFF, bulk - 2 / 3 * shear, bulk)
    if model.element_type == "H8":
        D, W = geometry.gradient_amplitudes(B)
        columns = [D.reshape(n_elements, 9), W.reshape(n_elements, 9)]
    else:
        columns = [B[:, 1:].reshape(n_elements, 9)]
    columns += [(V * shear)[:, None], (V * second)[:, None]]
    if model.element_type == "H8":
        k = geometry.hourglass_stiffness(B, V, wave, model.hourglass)
        columns += [k[:, None], geometry.hourglass_extents(model.nodes, model.elements).reshape(n_elements, 12)]
    if model.element_type == "T4ANP":
        columns += [(1 / bulk)[:, None], (V * bulk)[:, None]]
    constants = np.concatenate(columns, axis=1)
    if model.saliva is not None:
        constants[model.saliva.elements] = 0.0  # `film_arrays` has their stiffness
    return constants


# Edges across a hexahedron along each natural coordinate, as (from, to) nodes in a ring.
_STRUTS = np.array(
    [
        [(0, 1), (3, 2), (7, 6), (4, 5)],
        [(0, 3), (1, 2), (5, 6), (4, 7)],
        [(0, 4), (1, 5), (2, 6), (3, 7)],
    ]
)


def film_struts(model: Model) -> tuple[np.ndarray, ...]:
    """Geometry of the saliva at rest.

    Returns
    -------
    lower, upper : (S, 4) nodes at the ends of the four edges across each element, in a ring
    length : (S, 4) of these edges, m
    tangents : (S, 2, 3) unit vectors along the film: from edges 0, 3 to 1, 2, and at right angles to it
    normal : (S, 3) unit vector, up
    area : (S,) of one strut, m2
    """
    of_saliva = model.elements[model.saliva.elements]
    edges = of_saliva[:, _STRUTS]  # (S, 3, 4, 2)
    vectors = model.nodes[edges[..., 1]] - model.nodes[edges[..., 0]]
    along_up = np.einsum("sakj,sj->sa", vectors, model.saliva.up)
    cosine = along_up / np.linalg.norm(vectors.sum(axis=2), axis=2)
    axis = np.abs(cosine).argmax(axis=1)
    rows = np.arange(len(of_saliva))
    ends = edges[rows, axis]
    flipped = along_up[rows, axis] < 0
    ends[flipped] = ends[flipped][:, :, ::-1]
    lower, upper = ends[..., 0], ends[..., 1]
    length = np.linalg.norm(model.nodes[upper] - model.nodes[lower], axis=2)
    middle = (model.nodes[upper] + model.nodes[lower]) / 2
    a, b = _ring_axes(middle)
    downward = np.einsum("sj,sj->s", np.cross(a, b), model.saliva.up) < 0
    for values in (lower, upper, length, middle):
        values[downward] = values[downward][:, ::-1]
    a, b = _ring_axes(middle)
    normal = np.cross(a, b)
    area = np.linalg.norm(normal, axis=1)
    normal /= area[:, None]
    a /= np.linalg.norm(a, axis=1)[:, None]
    return lower, upper, length, np.stack([a, np.cross(normal, a)], axis=1), normal, area / 4


def _ring_axes(middle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a = (middle[:, 1] + middle[:, 2] - middle[:, 0] - middle[:, 3]) / 2
    return a, (middle[:, 2] + middle[:, 3] - middle[:, 0] - middle[:, 1]) / 2


def film_arrays(model: Model, parts: Partition) -> tuple[film.Film, np.ndarray]:
    """The saliva as the kernels have it, at rest, and (F,) where each row is in `model.saliva`; empty without one."""
    count = len(parts.element_starts) - 1
    if model.saliva is None:
        none, ends, starts = np.zeros(0), np.zeros((0, 4), np.uintp), np.zeros(count + 1, np.int64)
        empty = np.zeros((0, 4)), np.zeros((0, 4)), *[none] * 6, np.ones(2), np.zeros((0, film.MEMORY)), starts
        return film.Film(ends, ends, *empty, *_pairs(ends, ends, parts, none)), np.zeros(0, np.int64)
    saliva = model.saliva
    visited_at = np.empty(len(model.elements), np.int64)
    real = parts.elements >= 0
    visited_at[parts.elements[real]] = np.flatnonzero(real)
    order = np.argsort(visited_at[saliva.elements], kind="stable")
    stored_at = np.empty(len(model.nodes), np.int64)
    stored_at[parts.nodes] = np.arange(len(model.nodes))
    lower, upper, length, tangents, normal, area = (values[order] for values in film_struts(model))
    strut = (model.nodes[upper] - model.nodes[lower]) / length[..., None]
    memory = np.zeros((len(order), film.MEMORY))
    memory[:, [film.Q_NOW, film.Z_NOW]] = 1.0
    memory[:, film.MOISTURE_NOW] = saliva.moisture[order]
    lies = np.concatenate([np.einsum("skj,saj->ska", strut, tangents), np.zeros((len(order), 4, 1))], axis=2)
    memory[:, film.REST : film.AXES] = lies.reshape(len(order), 12)
    shear, bulk = (
        np.array([getattr(one, name) for one in model.materials])[model.material_of[saliva.elements[order]]]
        for name in ("shear_pa", "bulk_pa")
    )
    tissue = timestep.node_stiffness(model, masses(model))
    arrays = film.Film(
        stored_at[lower].astype(np.uintp),
        stored_at[upper].astype(np.uintp),
        length,
        np.einsum("skj,sj->sk", strut, normal),
        area,
        shear,
        bulk,
        saliva.strength[order],
        saliva.moisture[order].copy(),
        saliva.drying_per_s[order],
        np.array([saliva.decay_s, saliva.ramp_s]),
        memory,
        np.searchsorted(visited_at[saliva.elements[order]], parts.element_starts),
        *_pairs(stored_at[lower], stored_at[upper], parts, tissue[parts.nodes]),
    )
    return arrays, order


def _pairs(lower: np.ndarray, upper: np.ndarray, parts: Partition, stiffness: np.ndarray) -> tuple:
    """The last fields of film.Film: pairs of nodes that struts from `lower` to `upper` (S, 4) join; stiffness (N,)."""
    ends = np.stack([lower.ravel(), upper.ravel()], axis=1).astype(np.int64)
    pairs, number = np.unique(ends, axis=0, return_inverse=True)
    number = number.ravel()
    of_upper = np.searchsorted(parts.node_starts, pairs[:, 1], side="right") - 1
    starts = np.searchsorted(pairs[:, 0], parts.node_starts)
    of_lower = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    struts = np.argsort(number, kind="stable")
    return (
        pairs[:, 0].astype(np.uintp),
        pairs[:, 1].astype(np.uintp),
        struts.astype(np.uintp),
        np.searchsorted(number[struts], np.arange(len(pairs) + 1)).astype(np.uintp),
        of_upper,
        film.NEAR_INERTIA / (1 / stiffness[pairs]).sum(axis=1),
        np.zeros((len(pairs), 4)),
        starts,
        int((of_upper != of_lower).any()),
    )


def _history(model: Model, dt: float) -> tuple[np.ndarray, int]:
    """(E, terms * HISTORY) factors of the viscous terms and their stresses, 0; and the number of terms."""
    series = []
    for material in model.materials:
        kinds = ((1.0, "isochoric"), (0.0, "volumetric"))
        series.append([(iso, *term) for iso, name in kinds for term in getattr(material, name, ())])
    terms = max(map(len, series))
    table = np.zeros((len(series), terms, kernels.HISTORY))
    for number, rows in enumerate(series):
        for term, (iso, alpha, tau) in enumerate(rows):
            table[number, term, :3] = iso, tau / (dt + tau), dt * alpha / (dt + tau)
    return table.reshape(len(series), -1)[model.material_of], terms


def _batched(rows: np.ndarray, L: int, filler: float) -> np.ndarray:
    """(E, Q) -> flat (B, Q, L), the last batch filled up."""
    batches = -(-len(rows) // L)
    full = np.full((batches * L, rows.shape[1]), filler, rows.dtype)
    full[: len(rows)] = rows
    batched = _aligned_zeros((batches, rows.shape[1], L), rows.dtype)
    batched[:] = full.reshape(batches, L, -1).transpose(0, 2, 1)
    return batched.reshape(-1)


_LINE = 64  # bytes of a cache line; a register read across two lines takes twice as long


def _aligned_zeros(shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """Zeros that begin with a cache line, as numpy's do not."""
    count, size = math.prod(shape), np.dtype(dtype).itemsize
    raw = np.zeros(count + _LINE // size, dtype)
    first = -raw.ctypes.data % _LINE // size
    return raw[first : first + count].reshape(shape)


def node_arrays(model: Model, parts: Partition, precision: str, dt: float, mass: np.ndarray) -> kernels.Nodes:
    """Nodal records at rest, in storage order."""
    of_elements, of_sums = PRECISIONS[precision]
    n_nodes = len(model.nodes)
    # Spare records for the empty elements, which may go on along a row; two records of float32 fill one register.
    records = (n_nodes + len(RUN_ORDER) + 2) // 2 * 2
    parts_count = len(parts.node_starts) - 1

    def record(values, dtype):
        full = _aligned_zeros((records, 4), dtype)
        full[:n_nodes, :3] = values[parts.nodes]
        return full

    V = np.repeat(model.volumes, model.elements.shape[1])
    at_node = np.bincount(model.elements.ravel(), V, minlength=n_nodes)
    inverse_volume = np.zeros(records)
    inverse_volume[:n_nodes] = 1 / at_node[parts.nodes]
    return kernels.Nodes(
        seen=_aligned_zeros((records, 4), of_elements),
        forces=_aligned_zeros((parts_count, records, 4), of_elements),
        rest=record(model.nodes, np.float64),
        u=_aligned_zeros((records, 4), of_sums),
        du=_aligned_zeros((records, 4), of_sums),
        compliance=record(compliances(model, dt, mass), of_elements),
        mass=np.append(mass[parts.nodes], np.zeros(records - n_nodes)),
        inverse_volume=inverse_volume,
        starts=parts.node_starts,
        touched=parts.touched,
    )


def compliances(model: Model, dt: float, mass: np.ndarray) -> np.ndarray:
    """(N, 3) dt^2/m / (1 + alpha dt/2), s2/kg; 0 where held and 1 where prescribed, as kernels.Nodes has it."""
    fixed, moved = constrained(model)
    values = np.empty((len(mass), 3))
    values[:] = (dt**2 / (1 + model.damping * dt / 2) / mass)[:, None]
    values[fixed] = 0.0
    values[moved] = 1.0
    return values


def constrained(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Two masks (N, 3): degrees of freedom held at 0, and those displaced (which wins over held)."""
    fixed, moved = np.zeros((2, len(model.nodes), 3), bool)
    for load in model.loads:
        if isinstance(load, Fixed):
            for axis in load.axes:
                fixed[load.nodes, axis] = True
        if isinstance(load, Displacement):
            moved[load.nodes, load.axis] = True
    return fixed & ~moved, moved


def load_arrays(model: Model, parts: Partition, mass: np.ndarray) -> tuple[kernels.Loads, list, list]:
    """Loads by stored degree of freedom, the list of curves they refer to, and the gravities of all nodes.

    A gravity of all nodes is (curve number, acceleration vector (3,)).
    """
    stored_at = np.empty(len(model.nodes), np.int64)
    stored_at[parts.nodes] = np.arange(len(model.nodes))
    curves, gravities, forces, moves, faces = [], [], [], [], []
    fixed, _ = constrained(model)
    for load in model.loads:
        if isinstance(load, Fixed):
            continue
        number = len(curves)
        curves.append(load.shape)
        match load:
            case Displacement():
                moves += [(4 * stored_at[load.nodes] + load.axis, load.magnitudes_m, number)]
            case Force():
                free = ~fixed[load.nodes, load.axis]
                forces += [(4 * stored_at[load.nodes[free]] + load.axis, load.magnitudes_n[free], number)]
            case Gravity(nodes=None):
                gravities.append((number, load.acceleration * load.direction))
            case Gravity():
                for axis in np.flatnonzero(load.direction):
                    nodes = load.nodes[~fixed[load.nodes, axis]]
                    weight = load.acceleration * load.direction[axis] * mass[nodes]
                    forces += [(4 * stored_at[nodes] + axis, weight, number)]
            case Pressure():
                faces += [(stored_at[load.faces], load.magnitude_pa, number)]
    force_dof, force_n, force_curve = _joined(forces)
    order = np.argsort(force_dof, kind="stable")
    force_dof, force_n, force_curve = force_dof[order], force_n[order], force_curve[order]
    term_dof, moved_m, moved_curve = _joined(moves)
    order = np.argsort(term_dof, kind="stable")
    term_dof, moved_m, moved_curve = term_dof[order], moved_m[order], moved_curve[order]
    moved_dof, first = np.unique(term_dof, return_index=True)
    face_nodes, face_pa, face_curve, face_starts = _faces_by_part(faces, parts, model, stored_at)
    bounds = 4 * parts.node_starts
    loads = kernels.Loads(
        force_dof.astype(np.uintp),  # unsigned: compiled code need not ask whether to count from the end
        force_n,
        force_curve.astype(np.uintp),
        np.searchsorted(force_dof, bounds),
        moved_dof.astype(np.uintp),
        moved_m,
        moved_curve.astype(np.uintp),
        np.append(first, len(term_dof)).astype(np.uintp),
        np.searchsorted(moved_dof, bounds),
        np.zeros(len(moved_dof)),
        face_nodes,
        face_pa,
        face_curve,
        face_starts,
        np.zeros((len(face_nodes), 3)),
    )
    return loads, curves, gravities


def _joined(entries: list) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(dof, magnitude, curve number) of all entries, one row per degree of freedom."""
    dof = np.concatenate([np.zeros(0, np.int64), *(dof for dof, _, _ in entries)])
    magnitude = np.concatenate([np.zeros(0), *(values for _, values, _ in entries)])
    curve = np.concatenate([np.zeros(0, np.int64), *(np.full(len(dof), c) for dof, _, c in entries)])
    return dof, magnitude, curve


def _faces_by_part(faces: list, parts: Partition, model: Model, stored_at: np.ndarray):
    """Faces sorted by a part whose elements touch all their nodes, so that it may add forces there."""
    count = len(parts.element_starts) - 1
    nodes = np.full((sum(len(f) for f, _, _ in faces), 4), -1, np.int64)
    pressure, curve = np.zeros(len(nodes)), np.zeros(len(nodes), np.int64)
    row = 0
    for numbers, magnitude, c in faces:
        rows = slice(row, row + len(numbers))
        nodes[rows, : numbers.shape[1]], pressure[rows], curve[rows] = numbers, magnitude, c
        row += len(numbers)
    owner = np.full(len(nodes), -1)
    for part in range(count - 1, -1, -1):
        visited = parts.elements[parts.element_starts[part] : parts.element_starts[part + 1]]
        touched = np.zeros(len(model.nodes) + 1, bool)
        touched[stored_at[model.elements[visited[visited >= 0]]]] = True
        touched[-1] = True  # the missing 4th node of a triangle
        owner[touched[nodes].all(axis=1)] = part
    if (owner < 0).any():
        face = nodes[np.argmax(owner < 0)]
        raise InputError(
            f"expected a Pressure face to be a face of an element, got nodes {parts.nodes[face[face >= 0]].tolist()}"
        )
    order = np.argsort(owner, kind="stable")
    return nodes[order], pressure[order], curve[order], np.searchsorted(owner[order], np.arange(count + 1))


def energy_arrays(model: Model) -> tuple[np.ndarray, ...]:
    """Arguments of kernels.strain_energies and kernels.largest_area_stretch: elements, D, W, V, moduli, law, k, L."""
    constants = _element_constants(model)
    if model.element_type == "H8":
        W, rest = constants[:, 9:18].reshape(-1, 3, 3).copy(), constants[:, 18:]
        k, L = rest[:, 2].copy(), rest[:, 3:15].reshape(-1, 4, 3).copy()
    else:
        W, rest = np.zeros((0, 3, 3)), constants[:, 9:]
        k, L = np.zeros(0), np.zeros((0, 4, 3))
    return (
        np.ascontiguousarray(model.elements),
        constants[:, :9].reshape(-1, 3, 3).copy(),
        W,
        rest[:, 0].copy(),
        rest[:, 1].copy(),
        laws(model),
        k,
        L,
    )
