"""What is to be solved: mesh, materials, loads, time. Frozen, checked when made, free of any solver state.

All lengths are in m, times in s, forces in N. Axes are 0, 1, 2 for x, y, z. Node and element numbers start at 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, Protocol

import numpy as np

from simulator.elements import NODES_OF, shape_gradients, volumes
from simulator.errors import InputError
from simulator.materials import Material, NeoHookean, StVenantKirchhoff, ViscoNeoHookean
from simulator.saliva import Saliva

__all__ = [
    "Displacement",
    "Fixed",
    "Force",
    "Gravity",
    "Load",
    "Material",
    "Model",
    "NeoHookean",
    "Pressure",
    "Shape",
    "StVenantKirchhoff",
    "ViscoNeoHookean",
]


class Shape(Protocol):
    """How a load changes over time; simulator/curves.py has the usual ones."""

    def value(self, t_s: np.ndarray) -> np.ndarray:
        """Dimensionless factor at times `t_s`, s; same shape as `t_s`."""

    def rate(self, t_s: np.ndarray) -> np.ndarray:
        """Time derivative of `value`, 1/s; same shape as `t_s`."""


@dataclass(frozen=True, eq=False)
class Fixed:
    """Nodes (n,) int whose displacement along each of `axes` stays 0."""

    nodes: np.ndarray
    axes: tuple[int, ...] = (0, 1, 2)

    def __post_init__(self):
        _set(self, nodes=_node_set(self, self.nodes), axes=_axes(self, self.axes))


@dataclass(frozen=True, eq=False)
class Displacement:
    """Nodes (n,) int displaced along `axis` by magnitudes_m (n,) or one number, m, times shape(t).

    Several displacements of one node along one axis add up; a displacement overrides `Fixed`.
    """

    nodes: np.ndarray
    axis: int
    magnitudes_m: np.ndarray | float
    shape: Shape

    def __post_init__(self):
        nodes = _node_set(self, self.nodes)
        _axes(self, (self.axis,))
        _set(self, nodes=nodes, magnitudes_m=_magnitudes(self, self.magnitudes_m, nodes, "magnitudes_m"))
        _check_shape(self)


@dataclass(frozen=True, eq=False)
class Force:
    """Nodes (n,) int pushed along `axis` by magnitudes_n (n,) or one number, N per node, times shape(t)."""

    nodes: np.ndarray
    axis: int
    magnitudes_n: np.ndarray | float
    shape: Shape

    def __post_init__(self):
        nodes = _node_set(self, self.nodes)
        _axes(self, (self.axis,))
        _set(self, nodes=nodes, magnitudes_n=_magnitudes(self, self.magnitudes_n, nodes, "magnitudes_n"))
        _check_shape(self)


@dataclass(frozen=True, eq=False)
class Gravity:
    """Body force: nodal mass times `acceleration` (m/s2) along `direction` (3,), made a unit vector, times shape(t).

    `nodes` (n,) int restricts it to some nodes; None means all.
    """

    acceleration: float
    direction: np.ndarray
    shape: Shape
    nodes: np.ndarray | None = None

    def __post_init__(self):
        direction = np.array(self.direction, dtype=float)
        length = np.linalg.norm(direction) if direction.shape == (3,) else math.nan
        if not (0 < length < math.inf and math.isfinite(self.acceleration)):
            raise InputError(
                f"expected Gravity with a finite acceleration and a direction of 3 numbers that are not all 0, "
                f"got {self.acceleration} and {self.direction}"
            )
        if abs(length - 1) > 1e-15:  # a unit vector stays as it is, to the last bit, when it is written and read again
            direction /= length
        _set(self, direction=_read_only(direction))
        if self.nodes is not None:
            _set(self, nodes=_node_set(self, self.nodes))
        _check_shape(self)


@dataclass(frozen=True, eq=False)
class Pressure:
    """Follower pressure, Pa, on faces (F, 3 or 4) int of node numbers, times shape(t).

    The force on each node of a face is -p a / n, with a the area vector of the deformed face (right-hand rule over its
    node order) and n its number of nodes: a positive pressure pushes against the face's normal.
    """

    faces: np.ndarray
    magnitude_pa: float
    shape: Shape

    def __post_init__(self):
        faces = np.array(self.faces)
        if faces.ndim != 2 or faces.shape[1] not in (3, 4) or not len(faces) or faces.dtype.kind not in "iu":
            raise InputError(f"expected Pressure faces of shape (F, 3) or (F, 4) node numbers, got shape {faces.shape}")
        if not math.isfinite(self.magnitude_pa):
            raise InputError(f"expected a finite Pressure magnitude_pa, got {self.magnitude_pa}")
        _set(self, faces=_read_only(faces.astype(np.int64)))
        _check_shape(self)


Load = Fixed | Displacement | Force | Gravity | Pressure


@dataclass(frozen=True, eq=False)
class Model:
    """A deformable body, what acts on it, and for how long.

    Parameters
    ----------
    nodes : (N, 3) positions at rest, m
    elements : (E, 8) or (E, 4) node numbers; H8: 0-3 one face counter-clockwise seen from inside the element, 4-7 the
        opposite face in the same order; T4: 3 is on the side from which 0, 1, 2 run counter-clockwise
    element_type : "H8", "T4" or "T4ANP" (tetrahedra with nodally averaged pressure)
    materials : one or more materials
    material_of : (E,) index into `materials`; None gives every element the first
    loads : Fixed, Displacement, Force, Gravity, Pressure
    damping : mass-proportional damping alpha, 1/s
    hourglass : dimensionless stiffness of the hourglass modes of H8 (NiftySim's HGKappa)
    dt_s : time step, s, or "auto"
    duration_s : s
    output_every : steps between saved states when `solve` is given no times; None saves 100 states
    outputs : names of the quantities a file format asks to be written
    free_bodies : allow parts that can move without deforming
    saliva : elements that follow the law of `simulator.saliva` with the moduli of their material

    Raises
    ------
    InputError : all faults of the arrays in one sentence each
    """

    nodes: np.ndarray
    elements: np.ndarray
    element_type: Literal["H8", "T4", "T4ANP"] = "H8"
    materials: tuple[Material, ...] = (NeoHookean(800.0, 7000.0, 1050.0),)
    material_of: np.ndarray | None = None
    loads: tuple[Load, ...] = ()
    damping: float = 0.0
    hourglass: float = 0.08
    dt_s: float | Literal["auto"] = "auto"
    duration_s: float = 1.0
    output_every: int | None = None
    outputs: tuple[str, ...] = field(default=("U",))
    free_bodies: bool = False
    saliva: Saliva | None = None

    def __post_init__(self):
        nodes, elements = np.array(self.nodes, dtype=float), np.array(self.elements)
        _check_mesh(nodes, elements, self.element_type)
        elements = elements.astype(np.int64)
        _set(self, nodes=_read_only(nodes), elements=_read_only(elements))
        _check_volumes(self.volumes)
        material_of = np.zeros(len(elements), np.int64) if self.material_of is None else np.array(self.material_of)
        _check_materials(material_of, self.materials, len(elements))
        for load in self.loads:
            _check_load_nodes(load, len(nodes))
        _check_saliva(self, elements)
        _check_numbers(self)
        _set(
            self,
            material_of=_read_only(material_of.astype(np.int64)),
            materials=tuple(self.materials),
            loads=tuple(self.loads),
            outputs=tuple(self.outputs),
        )

    @cached_property
    def volumes(self) -> np.ndarray:
        """(E,) m3, as of `elements.volumes`."""
        return _read_only(volumes(self.nodes, self.elements))

    @cached_property
    def shape_gradients(self) -> np.ndarray:
        """(E, n, 3) 1/m, as of `elements.shape_gradients`."""
        return _read_only(shape_gradients(self.nodes, self.elements))


def _check_mesh(nodes: np.ndarray, elements: np.ndarray, element_type: str) -> None:
    if element_type not in NODES_OF:
        raise InputError(f"expected element_type {', '.join(NODES_OF)}, got {element_type!r}")
    if nodes.ndim != 2 or nodes.shape[1] != 3 or not len(nodes):
        raise InputError(f"expected nodes of shape (N, 3), got {nodes.shape}")
    if not np.isfinite(nodes).all():
        raise InputError(
            f"expected finite node positions, got {nodes[_first(~np.isfinite(nodes).all(1))]} at node "
            f"{_first(~np.isfinite(nodes).all(1))}"
        )
    n = NODES_OF[element_type]
    if elements.ndim != 2 or elements.shape[1] != n or not len(elements) or elements.dtype.kind not in "iu":
        raise InputError(f"expected {element_type} elements of shape (E, {n}) node numbers, got {elements.shape}")
    outside = ((elements < 0) | (elements >= len(nodes))).any(1)
    if outside.any():
        e = _first(outside)
        raise InputError(f"expected node numbers 0 to {len(nodes) - 1}, got {elements[e].tolist()} in element {e}")
    ordered = np.sort(elements, axis=1)
    repeated = (ordered[:, 1:] == ordered[:, :-1]).any(1)
    if repeated.any():
        e = _first(repeated)
        raise InputError(f"expected {n} different nodes per element, got {elements[e].tolist()} in element {e}")
    unused = np.ones(len(nodes), bool)
    unused[elements] = False
    if unused.any():
        raise InputError(
            f"expected every node to belong to an element, got {unused.sum()} loose nodes, the first is node "
            f"{_first(unused)}; remove them"
        )


def _check_volumes(V: np.ndarray) -> None:
    if not (V > 0).all():
        e = _first(~(V > 0))
        raise InputError(
            f"expected elements of positive volume, got {V[e]:.3g} m3 in element {e} and "
            f"{(~(V > 0)).sum()} such elements in all; check their node order and for coinciding nodes"
        )


def _check_materials(material_of: np.ndarray, materials: tuple, n_elements: int) -> None:
    if not materials:
        raise InputError("expected at least one material, got none")
    if material_of.shape != (n_elements,) or material_of.dtype.kind not in "iu":
        raise InputError(f"expected material_of of shape ({n_elements},) of integers, got {material_of.shape}")
    outside = (material_of < 0) | (material_of >= len(materials))
    if outside.any():
        e = _first(outside)
        raise InputError(f"expected materials 0 to {len(materials) - 1}, got {material_of[e]} for element {e}")


def _check_saliva(model: Model, elements: np.ndarray) -> None:
    if model.saliva is None:
        return
    if model.element_type != "H8":
        raise InputError(f"expected saliva in a mesh of H8 elements, got {model.element_type}")
    if not (model.saliva.elements.min() >= 0 and model.saliva.elements.max() < len(elements)):
        raise InputError(f"expected saliva elements 0 to {len(elements) - 1}, got {model.saliva.elements.max()}")


def _check_load_nodes(load: Load, n_nodes: int) -> None:
    numbers = load.faces if isinstance(load, Pressure) else load.nodes
    if numbers is not None and (numbers.min() < 0 or numbers.max() >= n_nodes):
        wrong = numbers[(numbers < 0) | (numbers >= n_nodes)].ravel()[0]
        raise InputError(f"expected node numbers 0 to {n_nodes - 1} in {type(load).__name__}, got {wrong}")


def _check_numbers(model: Model) -> None:
    if model.dt_s != "auto" and not (not isinstance(model.dt_s, str) and 0 < model.dt_s < math.inf):
        raise InputError(f"expected a time step dt_s above 0 s or 'auto', got {model.dt_s!r}")
    if not 0 < model.duration_s < math.inf:
        raise InputError(f"expected duration_s above 0 s, got {model.duration_s!r}")
    if not 0 <= model.damping < math.inf:
        raise InputError(f"expected damping of 0 1/s or more, got {model.damping!r}")
    if not 0 <= model.hourglass < math.inf:
        raise InputError(f"expected hourglass stiffness of 0 or more, got {model.hourglass!r}")
    if model.output_every is not None and model.output_every < 1:
        raise InputError(f"expected output_every of 1 step or more, got {model.output_every!r}")


def _node_set(load: object, nodes: np.ndarray) -> np.ndarray:
    nodes = np.atleast_1d(np.array(nodes))
    if nodes.ndim != 1 or not len(nodes) or nodes.dtype.kind not in "iu":
        got = "an empty set" if not nodes.size else f"shape {nodes.shape} of {nodes.dtype}"
        raise InputError(f"expected the nodes of {type(load).__name__} as one or more node numbers, got {got}")
    return _read_only(nodes.astype(np.int64))


def _axes(load: object, axes: tuple[int, ...]) -> tuple[int, ...]:
    axes = tuple(axes)
    if not axes or any(axis not in (0, 1, 2) for axis in axes):
        raise InputError(f"expected axes 0, 1 or 2 in {type(load).__name__}, got {axes}")
    return axes


def _magnitudes(load: object, magnitudes: np.ndarray | float, nodes: np.ndarray, name: str) -> np.ndarray:
    values = np.array(magnitudes, dtype=float)
    if values.ndim == 0:
        values = np.full(len(nodes), float(values))
    if values.shape != nodes.shape:
        raise InputError(
            f"expected {name} of {type(load).__name__} as one number or {len(nodes)}, one per node, got {values.shape}"
        )
    if not np.isfinite(values).all():
        i = _first(~np.isfinite(values))
        raise InputError(f"expected finite {name} in {type(load).__name__}, got {values[i]} at node {nodes[i]}")
    return _read_only(values)


def _check_shape(load: object) -> None:
    if not callable(getattr(load.shape, "value", None)):
        raise InputError(
            f"expected the shape of {type(load).__name__} to have value(t_s), got {type(load.shape).__name__}; "
            "use a curve of simulator.curves"
        )


def _first(mask: np.ndarray) -> int:
    return int(np.argmax(mask))


def _read_only(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array


def _set(frozen: object, **values: object) -> None:
    for name, value in values.items():
        object.__setattr__(frozen, name, value)
