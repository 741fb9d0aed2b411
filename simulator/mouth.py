"""The lower face as one layer of hexahedra: skin and lips of tissue, a film of saliva between the lips.

The mesh is a grid of columns (from one cheek to the other) and rows (from the chin up to the nose). One row is the
line of the mouth: between the corners its elements are the saliva, beyond them skin that grows thicker outwards.

Coordinates at rest, m: x to the right of the picture (the left of the face), y up, z towards the viewer; the middle of
the closed lips is near the origin. The first half of the nodes are the inner surface, the second half the outer one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from simulator.elements import CORNERS
from simulator.errors import InputError
from simulator.wording import choices, nearest

SKIN, LIPS, SALIVA, COMMISSURE = 0, 1, 2, 3  # groups of elements
GROUPS = ("skin", "lips", "saliva", "corners")
CORNER_M = 0.001  # where the row of the line is thinner than this beyond the saliva, it is the fibrous corner

# Columns from corner to corner, columns of each cheek, rows above and below the line of the mouth: 870, 3,422 and
# 13,680 elements, where the thesis has 852, 3,414 and 13,680 (table 4.1).
RESOLUTIONS = {"low": (30, 14, 7), "medium": (60, 29, 14), "high": (122, 59, 28)}


@dataclass(frozen=True)
class MouthShape:
    """Lengths of a lower face at rest, in m.

    Parameters
    ----------
    width_m : mouth, from corner to corner
    upper_lip_m, lower_lip_m : heights of the red of the lips at the middle
    protrusion_m : how far the lips stand out
    bow_m : depth of the dip in the middle of the upper lip's border
    corner_rise_m : how much higher the corners are than the middle of the line between the lips
    thickness_m : depth of skin and lips, along z
    film_m : thickness of the saliva between the closed lips
    half_width_m : from the middle to the edge of the sheet
    above_m, below_m : from the line of the mouth to the upper and lower edge of the sheet
    face_radius_m : radius of the face seen from above
    chin_m : how far the chin stands out
    groove_m : depth of the furrow between lower lip and chin
    """

    width_m: float = 0.050
    upper_lip_m: float = 0.0075
    lower_lip_m: float = 0.0095
    protrusion_m: float = 0.0055
    bow_m: float = 0.0012
    corner_rise_m: float = -0.0008
    thickness_m: float = 0.006
    film_m: float = 0.0004
    half_width_m: float = 0.065
    above_m: float = 0.040
    below_m: float = 0.055
    face_radius_m: float = 0.075
    chin_m: float = 0.005
    groove_m: float = 0.0025


@dataclass(frozen=True, eq=False)
class Mouth:
    """A mesh of the lower face; what the solver, the camera and the exports need to know about it.

    Parameters
    ----------
    nodes : (N, 3) m
    elements : (E, 8) hexahedra; corners 0-3 lie on the inner, 4-7 on the outer surface
    group : (E,) SKIN, LIPS, SALIVA, or COMMISSURE, the thin firm tissue that holds the lips together at their ends
    saliva : (S,) saliva elements along the lips, from negative to positive x
    upper, lower : (S + 1, 2) nodes of the lips' edges, column by column along the saliva: [:, 0] outer, [:, 1] inner
    outer, inner : (Q, 4) the outer and the inner surface as quads, row q of both belongs to element q;
        counter-clockwise seen from outside the body
    border_m : (N,) distance to the border between skin and red lip, m, positive in the lips
    film_m : thickness of the saliva at rest, m
    shape : what the mesh was made from, or None where it was read from a file
    """

    nodes: np.ndarray
    elements: np.ndarray
    group: np.ndarray
    saliva: np.ndarray
    upper: np.ndarray
    lower: np.ndarray
    outer: np.ndarray
    inner: np.ndarray
    border_m: np.ndarray
    film_m: float
    shape: MouthShape | None = None

    @property
    def width_m(self) -> float:
        """Distance between the corners of the mouth at rest, m."""
        middle = (self.nodes[self.upper[:, 0]] + self.nodes[self.lower[:, 0]]) / 2
        return float(np.linalg.norm(middle[-1] - middle[0]))


def mouth_mesh(shape: MouthShape | None = None, resolution: str = "medium") -> Mouth:
    """Mesh of a lower face with closed lips.

    Parameters
    ----------
    shape : lengths; None takes those of an average adult
    resolution : one of `RESOLUTIONS`

    Raises
    ------
    InputError : unknown resolution, or lengths that do not make a face, each alone or together
    """
    shape = shape or MouthShape()
    _check(shape)
    if resolution not in RESOLUTIONS:
        raise InputError(f"expected a resolution of {choices(RESOLUTIONS)}, got {nearest(resolution, RESOLUTIONS)}")
    across, beside, rows = RESOLUTIONS[resolution]
    x, y = _grid(shape, across, beside, rows)
    outer = np.stack([x, y, surface_z(shape, x, y)], axis=-1).reshape(-1, 3)
    inner = outer - [0, 0, shape.thickness_m]
    per_row, count = x.shape[1], len(outer)
    row, column = np.meshgrid(np.arange(x.shape[0] - 1), np.arange(per_row - 1), indexing="ij")
    corner = (row * per_row + column).ravel()
    faces = np.stack([corner, corner + 1, corner + per_row + 1, corner + per_row], axis=1)
    in_line = (row == rows).ravel() & (column >= beside).ravel() & (column < beside + across).ravel()
    border = border_distance(shape, x, y).ravel()
    group = np.where(border[faces].mean(axis=1) > 0, LIPS, SKIN)
    height = (outer[faces[:, 2:], 1] - outer[faces[:, :2][:, ::-1], 1]).mean(axis=1)
    group[(row == rows).ravel() & (height < CORNER_M)] = COMMISSURE
    group[in_line] = SALIVA
    edge = rows * per_row + beside + np.arange(across + 1)
    nodes, elements = np.concatenate([inner, outer]), np.concatenate([faces, faces + count], axis=1)
    _check_elements(nodes, elements)
    return Mouth(
        nodes=nodes,
        elements=elements,
        group=group,
        saliva=np.flatnonzero(in_line),
        upper=np.stack([count + edge + per_row, edge + per_row], axis=1),
        lower=np.stack([count + edge, edge], axis=1),
        outer=faces + count,
        inner=faces[:, ::-1],
        border_m=np.concatenate([border, border]),
        film_m=shape.film_m,
        shape=shape,
    )


def _grid(shape: MouthShape, across: int, beside: int, rows: int):
    """x, y (rows, columns) of the nodes."""
    half = shape.width_m / 2
    # Beyond the corners columns widen steadily; the first one is as wide as those of the mouth.
    first, length = shape.width_m / across, shape.half_width_m - half
    outward = half + length * _stretched(np.arange(1, beside + 1) / beside, first * beside / length)
    along = np.linspace(-half, half, across + 1)
    x = np.concatenate([-outward[::-1], (along - along[::-1]) / 2, outward])
    beyond = np.clip((np.abs(x) - half) / length, 0, 1)
    gap = shape.film_m + (0.005 - shape.film_m) * beyond**1.5
    v = np.arange(rows + 1) / rows
    above = np.outer(_stretched(v, 0.40), shape.above_m - gap / 2)
    below = np.outer(_stretched(v[::-1], 0.33), shape.below_m - gap / 2)
    line = line_y(shape, x)
    edge = np.exp(-((beyond / 0.7) ** 2))  # the line of the mouth fades towards the cheeks
    upper = line * edge * (1 - v[:, None] ** 2) + gap / 2 + above
    lower = line * edge * (1 - v[::-1, None] ** 2) - gap / 2 - below
    y = np.concatenate([lower, upper])
    return np.broadcast_to(x, y.shape), y


def _stretched(v: np.ndarray, slope: float) -> np.ndarray:
    """Monotonic map of 0..1 to 0..1 that begins with a slope below 1."""
    slope = min(max(slope, 0.05), 1.0)
    return slope * v + (1 - slope) * v**2


def line_y(shape: MouthShape, x: np.ndarray) -> np.ndarray:
    """Height of the line between the closed lips, m: a shallow bow with a dip under the upper lip's middle."""
    s = np.minimum(np.abs(x) / (shape.width_m / 2), 1.0)
    return (
        shape.corner_rise_m * s**2 + 0.0008 * np.exp(-(((s - 0.35) / 0.18) ** 2)) - 0.0004 * np.exp(-((s / 0.15) ** 2))
    )


def lip_heights(shape: MouthShape, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heights of the red of the upper and the lower lip over the line, m; 0 from the corners outwards."""
    s = np.minimum(np.abs(x) / (shape.width_m / 2), 1.0)
    upper = shape.upper_lip_m * (1 - s**2.2) ** 0.9 - shape.bow_m * np.exp(-((s / 0.13) ** 2))
    upper = upper + 0.15 * shape.upper_lip_m * np.exp(-(((s - 0.28) / 0.14) ** 2))
    lower = shape.lower_lip_m * (1 - s**2.6) ** 0.8
    return upper, lower


def border_distance(shape: MouthShape, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Distance to the border of the red of the lips along y, m, positive inside; negative beyond the corners."""
    upper, lower = lip_heights(shape, x)
    above = y - line_y(shape, x)
    half = shape.width_m / 2
    return np.where(above > 0, upper - above, lower + above) - np.maximum(np.abs(x) - half, 0.0)


def surface_z(shape: MouthShape, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Depth of the face's outer surface, m: cheeks, lips, furrow, chin."""
    half = shape.width_m / 2
    s = np.abs(x) / half
    upper, lower = lip_heights(shape, x)
    above = y - line_y(shape, x)
    fade = np.clip(1 - s**2, 0, None) ** 0.75
    height = np.where(above > 0, np.maximum(upper, 0.002), np.maximum(lower, 0.002))
    d = np.abs(above) / height
    z = -(x**2) / (2 * shape.face_radius_m)
    z = z + shape.protrusion_m * fade * _lip_profile(d)
    z = z - 0.0012 * np.exp(-(((np.abs(x) - half) / 0.004) ** 2) - (above / 0.006) ** 2)  # dimple at the corners
    z = z + 0.06 * (above + np.hypot(above, 0.006) - 0.006)  # the skin of the upper lip rises to the nose
    z = z - 0.0012 * np.exp(-((x / 0.0035) ** 2)) * _step(above, upper + 0.001, upper + 0.006)  # philtrum
    groove, chin = -0.55 * shape.below_m * 0.55, -0.55 * shape.below_m
    z = z - shape.groove_m * np.exp(-(((y - groove) / 0.006) ** 2) - (x / (0.8 * half)) ** 2)
    z = z + shape.chin_m * np.exp(-(((y - chin) / 0.011) ** 2) - (x / (0.75 * half)) ** 2)
    return z - 40.0 * np.clip(-y - 0.72 * shape.below_m, 0, None) ** 2  # under the chin


def _lip_profile(d: np.ndarray) -> np.ndarray:
    """How far a lip stands out at d heights of it from the line: 0.3 there, 1 in its middle, 0 beyond."""
    inner = 0.3 + 0.7 * np.sin(np.pi / 2 * np.clip(d / 0.45, 0, 1))
    outer = 0.5 + 0.5 * np.cos(np.pi * np.clip((d - 0.45) / 1.05, 0, 1))
    return np.where(d < 0.45, inner, outer)


def _step(value: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    t = np.clip((value - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


FLATTEST = 0.1  # corner quality of an element, below which a geometry is refused


def corner_quality(nodes: np.ndarray, elements: np.ndarray) -> np.ndarray:
    """(E,) the lowest corner Jacobian over the lengths of its three edges: 1 in a box, 0 where flat, below 0 inverted.

    A layer extruded along z passes through itself nowhere, on either surface, if all are above 0.
    """
    lowest = np.full(len(elements), np.inf)
    X = nodes.T[:, elements]
    for corner in range(8):
        # The corners at the other ends of the edges along xi, eta and zeta.
        (a, b, c), signs = _NEIGHBOURS[corner], -CORNERS[corner]
        u, v, w = ((X[:, :, end] - X[:, :, corner]) * sign for end, sign in zip((a, b, c), signs, strict=True))
        volume = (
            u[0] * (v[1] * w[2] - v[2] * w[1]) + u[1] * (v[2] * w[0] - v[0] * w[2]) + u[2] * (v[0] * w[1] - v[1] * w[0])
        )
        lengths = np.sqrt((u * u).sum(axis=0) * (v * v).sum(axis=0) * (w * w).sum(axis=0))
        lowest = np.minimum(lowest, volume / np.maximum(lengths, 1e-300))
    return lowest


_NEIGHBOURS = ((1, 3, 4), (0, 2, 5), (3, 1, 6), (2, 0, 7), (5, 7, 0), (4, 6, 1), (7, 5, 2), (6, 4, 3))


def _check_elements(nodes: np.ndarray, elements: np.ndarray) -> None:
    quality = corner_quality(nodes, elements)
    worst = int(np.argmin(quality))
    if quality[worst] < FLATTEST:
        x, y, _ = nodes[elements[worst]].mean(axis=0) * 1e3
        raise InputError(
            f"impossible geometry: expected elements with corner Jacobians of {FLATTEST} or more, got "
            f"{quality[worst]:.2g} at x = {x:.1f}, y = {y:.1f} mm; let the lips and the chin stand out less, or make "
            "the lips higher"
        )


def _check(shape: MouthShape) -> None:
    for one in fields(shape):
        value = getattr(shape, one.name)
        if not (isinstance(value, int | float) and math.isfinite(value)):
            raise InputError(f"expected {one.name} as a number of m, got {value!r}")
    limits = (
        ("width_m", 0.02, 0.12),
        ("upper_lip_m", 0.001, 0.03),
        ("lower_lip_m", 0.001, 0.03),
        ("film_m", 2e-5, 0.002),
        ("thickness_m", 0.001, 0.02),
        ("half_width_m", shape.width_m / 2 * 1.3, 0.2),
        ("above_m", shape.upper_lip_m * 1.5, 0.15),
        ("below_m", shape.lower_lip_m * 1.5, 0.15),
        ("bow_m", 0.0, 0.8 * shape.upper_lip_m),
        ("corner_rise_m", -0.01, 0.01),
        ("protrusion_m", 0.0, 0.02),
        ("face_radius_m", 0.04, 1.0),
        ("chin_m", -0.02, 0.02),
        ("groove_m", -0.02, 0.02),
    )
    for name, low, high in limits:
        if not low <= getattr(shape, name) <= high:
            raise InputError(f"expected {name} between {low:.4g} and {high:.4g} m, got {getattr(shape, name)}")
