"""Teeth, tongue and cavity in numbers for the kernel that draws them: arches, tooth by tooth, and the moving jaw."""

from __future__ import annotations

import math

import numpy as np

from simulator.errors import InputError
from simulator.look import Inside, to_linear

# Widths of the crowns from the middle outwards, and their lengths from edge to gum, m (averages of adults).
UPPER = (
    (0.0085, 0.0065, 0.0076, 0.0070, 0.0068, 0.0100, 0.0095),
    (0.0105, 0.0090, 0.0100, 0.0085, 0.0080, 0.007, 0.007),
)
LOWER = (
    (0.0053, 0.0058, 0.0068, 0.0070, 0.0071, 0.0110, 0.0105),
    (0.0090, 0.0092, 0.0105, 0.0088, 0.008, 0.007, 0.007),
)
# How much higher than the middle ones the edges of the others stand, m, upper and lower.
RISE = ((0.0, 0.0008, 0.0001, 0.0006, 0.0009, 0.0012, 0.0016), (0.0, 0.0001, 0.0002, -0.0003, -0.0006, -0.0008, -0.001))
ARCH_M = (0.0165, 0.0150)  # radius of upper and lower arch at the middle
OVERJET_M = 0.002
HALF_M = 0.04  # the tables reach from -HALF_M to HALF_M, as the kernel knows
SAMPLES = 1601


def teeth_table(lower: bool, seed: int) -> np.ndarray:
    """(n, 5) over x: the edge's height over the middle teeth's and length to the gum, m; dark of gaps, tilt, tone."""
    rng = np.random.default_rng([seed, 2 + lower])
    widths, lengths = (np.array(v) for v in (LOWER if lower else UPPER))
    rise, radius = np.array(RISE[lower]), ARCH_M[lower]
    x = np.linspace(-HALF_M, HALF_M, SAMPLES)
    ratio = x / radius
    along = radius / 2 * (ratio * np.sqrt(1 + ratio**2) + np.arcsinh(ratio))  # length along the arch
    ends = np.concatenate([[0], np.cumsum(widths)])
    tooth = np.clip(np.searchsorted(ends, np.abs(along), side="right") - 1, 0, len(widths) - 1)
    u = 2 * (np.abs(along) - ends[tooth]) / widths[tooth] - 1  # -1 at the side of the middle, 1 at the other
    u = np.clip(u, -1, 1)
    which = tooth + len(widths) * (x < 0)
    own = rng.standard_normal((4, 2 * len(widths)))
    up = 1 if not lower else -1  # towards the gum
    corner = 0.0011 * np.clip((np.abs(u) - 0.55) / 0.45, 0, 1) ** 2.5
    cusp = np.where(tooth == 2, 0.0005 * np.abs(u), 0.0)
    edge = rise[tooth] + up * (corner + cusp) + 0.00015 * own[0][which] + 0.00012 * own[1][which] * u
    length = lengths[tooth] * (1 + 0.03 * own[2][which]) * (1 - 0.20 * np.abs(u) ** 3)
    gap_m = (1 - np.abs(u)) * widths[tooth] / 2
    gap = 0.75 * np.exp(-((gap_m / 0.00022) ** 2)) + 0.25 * np.exp(-gap_m / 0.0008)
    tilt = 0.55 * np.sign(x) * np.sign(u) * np.abs(u) ** 3
    tone = 1 + 0.03 * own[3][which] - 0.06 * (tooth == 2)
    return np.stack([edge, length, gap, tilt, tone], axis=1)


def rows_of(inside: Inside) -> np.ndarray:
    """(2, 3) of the upper and the lower teeth: depth, radius of the arch, height of the edge, m."""
    return np.array(
        [
            [inside.teeth_z_m, ARCH_M[0], inside.upper_edge_m],
            [inside.teeth_z_m - OVERJET_M, ARCH_M[1], inside.lower_edge_m],
        ]
    )


def tongue_of(inside: Inside) -> np.ndarray:
    """(2, 3) middle and half axes of the tongue, an ellipsoid behind the lower teeth, m."""
    top = inside.lower_edge_m - 0.0005 + inside.tongue_height_m
    half = (0.0215, 0.011, 0.028)
    return np.array([[0.0, top - half[1], inside.teeth_z_m - OVERJET_M - 0.003 - half[2]], half])


def colours_of(inside: Inside) -> np.ndarray:
    """(4, 3) linear light of teeth, gum, tongue and cavity."""
    return np.array(
        [to_linear(c) for c in (inside.teeth_colour, inside.gum_colour, inside.tongue_colour, inside.cavity_colour)]
    )


def turned_jaw(angle_deg: float, joint: tuple[float, float] = (0.025, -0.095)) -> np.ndarray:
    """(4, 4) turn of the jaw about its joint, opening the mouth.

    angle_deg : positive opens
    joint : y and z of the axis, m; the default is that of an average adult in the mouth's coordinates
    """
    angle = math.radians(angle_deg)
    cos, sin = math.cos(angle), math.sin(angle)
    y, z = joint
    # about the x axis, so that what lies before the joint sinks
    return np.array(
        [[1, 0, 0, 0], [0, cos, -sin, y - cos * y + sin * z], [0, sin, cos, z - sin * y - cos * z], [0, 0, 0, 1.0]]
    )


def jaw_matrix(jaw) -> np.ndarray:
    """(4, 4) from None (at rest), a (4, 4) matrix, or (angle in deg, (y, z) of the joint in m).

    Raises
    ------
    InputError : neither of them, or a matrix that is no movement of a rigid body
    """
    if jaw is None:
        return np.eye(4)
    if isinstance(jaw, tuple) and len(jaw) == 2:
        return turned_jaw(float(jaw[0]), (float(jaw[1][0]), float(jaw[1][1])))
    matrix = np.asarray(jaw, float)
    if matrix.shape != (4, 4):
        raise InputError(f"expected jaw as a (4, 4) matrix or (angle_deg, (y_m, z_m)), got shape {matrix.shape}")
    turn = matrix[:3, :3]
    rigid = np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-9)
    if not (np.isfinite(matrix).all() and rigid and np.linalg.det(turn) > 0):
        raise InputError("expected jaw as a turn and a shift, got a matrix that stretches or mirrors")
    return matrix
