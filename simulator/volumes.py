"""Volumes that pick nodes of a mesh: boxes, ellipsoids, closed surfaces, and unions of them (thesis section 3.3.5).

A volume has three methods over points (N, 3), m: `inside` (N,) bool; `depth` (N,), 0 outside and at the border and
up to 1 at the heart, for loads that fade towards the border; `distance_m` (N,), how far outside a point lies, 0
within. And `mirrored`, the same volume on the other side of x = 0.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from simulator.errors import InputError
from simulator.obj_file import read_obj

_MIRROR = np.array([-1.0, 1.0, 1.0])


class Volume(Protocol):
    """A part of space."""

    def inside(self, points: np.ndarray) -> np.ndarray:
        """(N,) bool of points (N, 3), m."""

    def depth(self, points: np.ndarray) -> np.ndarray:
        """(N,) 0 outside, rising inwards to 1."""

    def distance_m(self, points: np.ndarray) -> np.ndarray:
        """(N,) m, 0 inside."""

    def mirrored(self) -> Volume:
        """The volume with x turned into -x."""


@dataclass(frozen=True)
class Box:
    """Box between two opposite corners, m, its edges along the axes.

    Raises
    ------
    InputError : numbers that are not finite, or a length that is not above 0
    """

    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]

    def __post_init__(self):
        low, high = _three(self, "low_m"), _three(self, "high_m")
        if not all(a < b for a, b in zip(low, high, strict=True)):
            raise InputError(f"expected a Box with low_m below high_m along every axis, got {low} and {high}")

    def inside(self, points: np.ndarray) -> np.ndarray:
        return ((points >= self.low_m) & (points <= self.high_m)).all(axis=1)

    def depth(self, points: np.ndarray) -> np.ndarray:
        low, high = np.array(self.low_m), np.array(self.high_m)
        return np.clip(1 - np.abs((points - (low + high) / 2) / ((high - low) / 2)).max(axis=1), 0, None)

    def distance_m(self, points: np.ndarray) -> np.ndarray:
        beyond = np.maximum(np.maximum(np.subtract(self.low_m, points), points - self.high_m), 0)
        return np.linalg.norm(beyond, axis=1)

    def mirrored(self) -> Box:
        (x0, y0, z0), (x1, y1, z1) = self.low_m, self.high_m
        return Box((-x1, y0, z0), (-x0, y1, z1))


@dataclass(frozen=True)
class Ellipsoid:
    """Ellipsoid.

    Parameters
    ----------
    centre_m, radii_m : m
    turn_deg : turns about x, then y, then z, degrees

    Raises
    ------
    InputError : numbers that are not finite, or a radius that is not above 0
    """

    centre_m: tuple[float, float, float]
    radii_m: tuple[float, float, float]
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self):
        for name in ("centre_m", "radii_m", "turn_deg"):
            _three(self, name)
        if not min(self.radii_m) > 0:
            raise InputError(f"expected an Ellipsoid with radii_m above 0, got {self.radii_m}")

    def _scaled(self, points: np.ndarray) -> np.ndarray:
        """(N,) 0 at the centre, 1 at the border."""
        x, y, z = (points - self.centre_m).T
        if any(self.turn_deg):
            # Written out: a matrix product may round mirrored points differently.
            x, y, z = (x * a + y * b + z * c for a, b, c in _rotation(self.turn_deg).T)
        a, b, c = self.radii_m
        return np.sqrt((x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2)

    def inside(self, points: np.ndarray) -> np.ndarray:
        return self._scaled(points) <= 1

    def depth(self, points: np.ndarray) -> np.ndarray:
        return np.clip(1 - self._scaled(points), 0, None)

    def distance_m(self, points: np.ndarray) -> np.ndarray:
        """Measured towards the centre, so a little above the shortest way."""
        scaled = self._scaled(points)
        return np.linalg.norm(points - self.centre_m, axis=1) * np.clip(1 - 1 / np.maximum(scaled, 1), 0, None)

    def mirrored(self) -> Ellipsoid:
        (x, y, z), (a, b, c) = self.centre_m, self.turn_deg
        return replace(self, centre_m=(-x, y, z), turn_deg=(a, -b, -c))


@dataclass(frozen=True, eq=False)
class ClosedSurface:
    """What closed surfaces of triangles enclose; several shells count as their union.

    Inside is where the winding number, the solid angle of all triangles over 4 pi, is above 1/2 (A. van Oosterom,
    J. Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125): it needs no ray that might hit an edge.

    Parameters
    ----------
    vertices : (V, 3) m
    triangles : (F, 3) vertex numbers

    Raises
    ------
    InputError : a surface with a hole, with faces that meet three at an edge or face opposite ways, or without volume
    """

    vertices: np.ndarray
    triangles: np.ndarray

    def __post_init__(self):
        vertices, triangles = np.array(self.vertices, dtype=float), np.array(self.triangles, dtype=np.int64)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
            raise InputError(f"expected finite vertices of shape (V, 3), got shape {vertices.shape}")
        if triangles.ndim != 2 or triangles.shape[1] != 3 or not len(triangles):
            raise InputError(f"expected triangles of shape (F, 3), got shape {triangles.shape}")
        if triangles.min() < 0 or triangles.max() >= len(vertices):
            raise InputError(f"expected vertex numbers 0 to {len(vertices) - 1}, got others in a triangle")
        shell = _shells(triangles)
        corners = vertices[triangles] - vertices.mean(axis=0)
        volume = np.bincount(shell, np.linalg.det(corners) / 6)
        if not (np.abs(volume) > 1e-12 * np.ptp(vertices, axis=0).max() ** 3).all():
            raise InputError("expected a closed surface that encloses a volume, got a flat one")
        inverted = volume[shell] < 0
        triangles[inverted] = triangles[inverted][:, ::-1]
        for name, array in (("vertices", vertices), ("triangles", triangles)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def inside(self, points: np.ndarray) -> np.ndarray:
        points = np.asarray(points, dtype=float)
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        near = ((points >= low) & (points <= high)).all(axis=1)
        found = np.zeros(len(points), bool)
        found[near] = np.concatenate([[], *map(self._winding, _chunks(points[near], len(self.triangles)))]) > 0.5
        return found

    def _winding(self, points: np.ndarray) -> np.ndarray:
        a, b, c = np.moveaxis(self.vertices[self.triangles][None] - points[:, None, None], 2, 0)
        la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
        volume = np.einsum("nfi,nfi->nf", a, np.cross(b, c))
        ab, bc, ca = (np.einsum("nfi,nfi->nf", v, w) for v, w in ((a, b), (b, c), (c, a)))
        return np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb).sum(axis=1) / (2 * math.pi)

    def depth(self, points: np.ndarray) -> np.ndarray:
        """Distance to the surface over the largest of the points' distances."""
        inside = self.inside(points)
        depth = np.zeros(len(points))
        if inside.any():
            depth[inside] = self._to_surface(points[inside])
            depth /= depth.max() or 1.0
        return depth

    def distance_m(self, points: np.ndarray) -> np.ndarray:
        return np.where(self.inside(points), 0.0, self._to_surface(points))

    def _to_surface(self, points: np.ndarray) -> np.ndarray:
        return np.concatenate(
            [_point_triangle(part, self.vertices[self.triangles]) for part in _chunks(points, len(self.triangles))]
        )

    def mirrored(self) -> ClosedSurface:
        return ClosedSurface(self.vertices * _MIRROR, self.triangles[:, ::-1])


@dataclass(frozen=True)
class Union:
    """All that lies in one of several volumes."""

    parts: tuple[Volume, ...]

    def __post_init__(self):
        object.__setattr__(self, "parts", tuple(self.parts))
        if not self.parts:
            raise InputError("expected a Union of one or more volumes, got none")

    def inside(self, points: np.ndarray) -> np.ndarray:
        return np.any([part.inside(points) for part in self.parts], axis=0)

    def depth(self, points: np.ndarray) -> np.ndarray:
        return np.max([part.depth(points) for part in self.parts], axis=0)

    def distance_m(self, points: np.ndarray) -> np.ndarray:
        return np.min([part.distance_m(points) for part in self.parts], axis=0)

    def mirrored(self) -> Union:
        return Union(tuple(part.mirrored() for part in self.parts))


def read_closed_surface(path: str | Path, scale: float = 1.0) -> ClosedSurface:
    """The volume in an OBJ file; polygons are cut into triangles, coordinates multiplied by `scale` to give m.

    Raises
    ------
    InputError : a file that cannot be read, or a surface that is not closed
    """
    if not (math.isfinite(scale) and scale > 0):
        raise InputError(f"expected a scale above 0, got {scale}")
    read = read_obj(path)
    triangles = [(face.corners[0], b, c) for face in read.faces for b, c in itertools.pairwise(face.corners[1:])]
    # Exporters double vertices along seams.
    vertices, number = np.unique(read.vertices, axis=0, return_inverse=True)
    try:
        return ClosedSurface(vertices * scale, number.ravel()[np.array(triangles)])
    except InputError as error:
        raise InputError(f"{read.path}: {error}") from None


def nodes_inside(nodes: np.ndarray, volume: Volume, what: str = "the volume") -> np.ndarray:
    """(n,) numbers of the nodes (N, 3), m, inside a volume; `what` names it in messages.

    Raises
    ------
    InputError : no node lies inside
    """
    found = np.flatnonzero(volume.inside(nodes))
    if not len(found):
        distance = volume.distance_m(nodes)
        nearest = int(np.argmin(distance))
        place = ", ".join(f"{value * 1e3:.1f}" for value in nodes[nearest])
        raise InputError(
            f"expected nodes inside {what}, got none: the nearest is node {nearest} at ({place}) mm, "
            f"{distance[nearest] * 1e3:.2g} mm outside; move the volume or make it larger"
        )
    return found


def _three(volume: object, name: str) -> tuple[float, float, float]:
    try:
        values = tuple(float(value) for value in getattr(volume, name))
    except (TypeError, ValueError):
        values = ()
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise InputError(
            f"expected {name} of {type(volume).__name__} as three finite numbers, got {getattr(volume, name)!r}"
        )
    object.__setattr__(volume, name, values)
    return values


def _rotation(turn_deg: Sequence[float]) -> np.ndarray:
    """(3, 3) of turns about x, then y, then z."""
    R = np.eye(3)
    for axis, angle in enumerate(np.radians(turn_deg)):
        one = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        one[i, i] = one[j, j] = math.cos(angle)
        one[i, j], one[j, i] = -math.sin(angle), math.sin(angle)
        R = one @ R
    return R


def _shells(triangles: np.ndarray) -> np.ndarray:
    """(F,) which connected shell each triangle is of; refuses those that are not closed."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    of = np.tile(np.arange(len(triangles)), 3)
    low, high = edges.min(axis=1), edges.max(axis=1)
    forward = edges[:, 0] < edges[:, 1]
    _, edge, uses = np.unique(np.stack([low, high], axis=1), axis=0, return_inverse=True, return_counts=True)
    edge = edge.ravel()
    once, often = np.flatnonzero(uses[edge] == 1), np.flatnonzero(uses[edge] > 2)
    if len(once):
        raise InputError(
            f"expected a closed surface, got one with a hole: {len(once)} edges belong to one triangle only, the first "
            f"between vertices {low[once[0]]} and {high[once[0]]}; fill the hole"
        )
    if len(often):
        raise InputError(
            f"expected two triangles at every edge, got {uses[edge][often[0]]} between vertices {low[often[0]]} and "
            f"{high[often[0]]}; remove inner and doubled faces"
        )
    turns = np.bincount(edge, np.where(forward, 1, -1))
    if (turns != 0).any():
        first = int(np.argmax(turns[edge] != 0))
        raise InputError(
            f"expected faces that all look outwards, got two of opposite sense at the edge between vertices "
            f"{low[first]} and {high[first]}; make the normals consistent"
        )
    pairs = of[np.argsort(edge, kind="stable")].reshape(-1, 2)
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(triangles),) * 2)
    return connected_components(links, directed=False)[1]


def _chunks(points: np.ndarray, triangles: int) -> list[np.ndarray]:
    """The points in parts that keep (points x triangles x 3 x 3) arrays small."""
    size = max(1, 200_000 // triangles)
    return [points[i : i + size] for i in range(0, len(points), size)]


def _point_triangle(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(N,) distance of points (N, 3) to the nearest of triangles (F, 3, 3)."""
    a, b, c = (triangles[:, i] for i in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    normal = normal / np.where(length > 0, length, 1)[:, None]
    best = np.full((len(points), len(triangles)), np.inf)
    above = np.ones_like(best, dtype=bool)
    for p, q in ((a, b), (b, c), (c, a)):
        edge, offset = q - p, points[:, None] - p
        along = np.einsum("nfi,fi->nf", offset, edge) / np.maximum(np.einsum("fi,fi->f", edge, edge), 1e-300)
        rest = offset - np.clip(along, 0, 1)[..., None] * edge
        best = np.minimum(best, np.linalg.norm(rest, axis=2))
        above &= np.einsum("nfi,fi->nf", offset, np.cross(normal, edge)) >= 0
    over = above & (length > 0)
    height = np.abs(np.einsum("nfi,fi->nf", points[:, None] - a, normal))
    return np.where(over, height, best).min(axis=1)
