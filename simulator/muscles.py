"""Bones and muscles of a mouth as loads: jaw, skull, and the muscles that move the lips (thesis 3.3.5 and 4.1.1).

A muscle is a set of nodes picked by ellipsoids that are placed by the mouth's own landmarks, a direction, and a force
that fades smoothly from the heart of each ellipsoid to its border and is shared out by the tissue's volume, so that it
does not depend on the mesh. An activation curve multiplies it. Bones are nodes that are held (skull) or turned about
the joint of the jaw.

What the usual forces do to an average adult after 1 s, medium mesh, damping 15 1/s, lips free of saliva and of contact;
motions to the left of the face, up and forward in mm, J the lowest volume ratio at a point of an element:

| muscle           | usual     | corner of the mouth | middle of upper lip | middle of lower lip | width  | J    |
|------------------|-----------|---------------------|---------------------|---------------------|--------|------|
| jaw              | 0.010 m   | -0.7, -3.2, -2.7    | 0, -0.2, -0.2       | 0, -6.8, -4.4       | -3 %   | 0.83 |
| jaw              | 0.025 m   | -1.2, -7.5, -7.6    | 0, -0.7, -0.6       | 0, -16.4, -12.4     | -5 %   | 0.80 |
| jaw              | 0.040 m   | -1.5, -11.1, -13.1  | 0, -1.2, -1.2       | 0, -24.8, -21.7     | -6 %   | 0.78 |
| jaw              | 0.050 m   | -1.6, -13.0, -16.9  | 0, -1.5, -1.6       | 0, -29.7, -28.5     | -7 %   | 0.75 |
| zygomaticus      | 0.18 N    | 6.2, 5.4, -3.1      | 0, 0.8, -1.6        | 0, -0.3, -1.6       | +25 %  | 0.79 |
| risorius         | 0.13 N    | 6.2, -0.3, -0.2     | 0, 0.0, -0.9        | 0, -0.5, -1.2       | +25 %  | 0.85 |
| depressor_anguli | 0.15 N    | 1.3, -6.2, -1.4     | 0, -0.9, -0.3       | 0, -0.3, -1.1       | +5 %   | 0.77 |
| orbicularis      | 0.12 N    | -5.8, 0.6, -5.0     | 0, -0.8, 0.7        | 0, 0.8, 0.6         | -23 %  | 0.40 |
| pout             | 0.15 N    | -5.6, 0.5, -1.7     | 0, -0.5, 1.5        | 0, 0.6, 2.2         | -22 %  | 0.42 |
| levator_labii    | 0.055 N   | -0.4, 0.5, 0.2      | 0, 4.7, 1.2         | 0, 0.0, 0.1         | -2 %   | 0.93 |
| depressor_labii  | 0.075 N   | 0.2, -0.3, 0.9      | 0, 0.0, 0.0         | 0, -3.4, 4.0        | +1 %   | 0.75 |
| mentalis         | 0.05 N    | -0.1, 0.0, 0.1      | 0, 0.0, 0.0         | 0, 2.0, 1.0         | 0 %    | 0.91 |
| press            | 0.045 N   | 0.0, -0.1, -0.3     | 0, -2.6, -0.8       | 0, 1.7, -1.0        | 0 %    | 0.90 |
| burst            | 0.035 N   | 0.0, 0.0, 0.8       | 0, 2.1, 1.9         | 0, -1.8, 3.4        | 0 %    | 0.89 |

The low mesh gives the same to 0.3 mm seen from the front and 1.1 mm in depth.

Directions: x > 0 is the left side of the face, y up, z towards the viewer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from simulator.elements import lumped_mass
from simulator.errors import InputError
from simulator.model import Displacement, Fixed, Force, Load, Shape
from simulator.mouth import SALIVA, Mouth
from simulator.volumes import Ellipsoid, Volume, nodes_inside
from simulator.wording import choices, nearest

JAW_JOINT = (0.055, -0.085)  # y, z of the joint's axis from the middle of the lips, m
LARGEST_DROP_M = 0.050  # path of the chin (thesis 4.1.1)
USUAL_DROP_M = 0.025
USUAL_HALF_M, USUAL_THICKNESS_M = 0.025, 0.006  # of the mouth that the usual forces of MUSCLES are for
SIDES = ("both", "left", "right")
LOWEST, HIGHEST = -0.1, 1.0  # activation of the jaw; below 0 the chin is lifted and presses the lips together


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Places and lengths of a mouth at rest from which the muscles are placed, m.

    Parameters
    ----------
    centre_x, y, z : the middle between the lips, on the outer surface
    half : half the width of the mouth
    corner_y, corner_z : the corners, which are at centre_x - half and + half
    upper, lower : heights of the red of the lips
    chin_y, chin_z : the point of the chin
    thickness : of the sheet
    line : (S + 1, 2) x and y of the line between the lips, from corner to corner
    """

    centre_x: float
    y: float
    z: float
    half: float
    corner_y: float
    corner_z: float
    upper: float
    lower: float
    chin_y: float
    chin_z: float
    thickness: float
    line: np.ndarray


@lru_cache(maxsize=2)
def landmarks(mouth: Mouth) -> Landmarks:
    """The landmarks of a mouth, parametric or read from a file."""
    X = mouth.nodes
    line = (X[mouth.upper[:, 0]] + X[mouth.lower[:, 0]]) / 2
    centre_x = float(line[0, 0] + line[-1, 0]) / 2
    y, z = (float(np.interp(centre_x, line[:, 0], line[:, axis])) for axis in (1, 2))
    outer = X[np.unique(mouth.outer)]
    chin_y = y + 0.55 * (float(outer[:, 1].min()) - y)
    half = float(line[-1, 0] - line[0, 0]) / 2
    chin = outer[np.hypot(outer[:, 0] - centre_x, outer[:, 1] - chin_y) < half]
    chin_z = float(LinearNDInterpolator(chin[:, :2], chin[:, 2])(centre_x, chin_y))
    if not math.isfinite(chin_z):
        raise InputError(
            f"expected a chin below the mouth, at x = {centre_x:.3g} and y = {chin_y:.3g} m, got a surface with a hole "
            "there, or one that ends above"
        )
    return Landmarks(
        centre_x,
        y,
        z,
        half,
        *(line[[0, -1], 1:].mean(axis=0)).tolist(),
        *(float(mouth.border_m[edge[:, 0]].max()) for edge in (mouth.upper, mouth.lower)),
        chin_y,
        chin_z,
        float(np.median(np.linalg.norm(X[mouth.upper[:, 0]] - X[mouth.upper[:, 1]], axis=1))),
        line[:, :2],
    )


@dataclass(frozen=True)
class Part:
    """Nodes of a muscle of the left half of the face, and where they are pulled.

    Parameters
    ----------
    volume : the force fades from its heart to its border
    pull : direction (x, y, z); or None for the middle of the mouth
    share : part of the muscle's force
    lip : 1 for nodes above the line between the lips only, -1 for those below, 0 for all
    """

    volume: Volume
    pull: tuple[float, float, float] | None
    share: float = 1.0
    lip: int = 0


@dataclass(frozen=True)
class Muscle:
    """A muscle by name.

    Parameters
    ----------
    peak_n : usual force at full activation, N, of each side, of an average adult
    effect : what that does
    parts : its parts on a given face; those near the middle of the face fade out beyond it
    forward : force along z over that along the face
    """

    peak_n: float
    effect: str
    parts: Callable[[Landmarks], tuple[Part, ...]]
    forward: float = 0.0


def _at(face: Landmarks, x: float, y: float, radii: tuple[float, float, float], z: float | None = None) -> Ellipsoid:
    """Ellipsoid at x from the middle of the face, at height y, in the middle of the sheet whose surface is at z."""
    z = face.z if z is None else z
    return Ellipsoid((face.centre_x + x, y, z - face.thickness / 2), radii)


def _corner(face: Landmarks, out: float, up: float, pull: tuple[float, float, float]) -> tuple[Part, ...]:
    """A pull at the corner; `out` and `up` move its middle, in half widths of the mouth."""
    radius = 0.42 * face.half
    place = _at(face, (1 + out) * face.half, face.corner_y + up * face.half, (radius, radius, face.half), face.corner_z)
    return (Part(place, pull),)


def _upper(face: Landmarks, pull, share=1.0, x: float = 0.0, lift: float = 0.5, wide: float = 0.9, high: float = 1.2):
    place = _at(face, x * face.half, face.y + lift * face.upper, (wide * face.half, high * face.upper, face.half))
    return Part(place, pull, share, lip=1)


def _lower(face: Landmarks, pull, share=1.0, x: float = 0.0, drop: float = 0.5, wide: float = 0.9, high: float = 1.2):
    place = _at(face, x * face.half, face.y - drop * face.lower, (wide * face.half, high * face.lower, face.half))
    return Part(place, pull, share, lip=-1)


def _ring(face: Landmarks) -> tuple[Part, ...]:
    radius = 0.65 * face.half
    corner = _at(face, 0.95 * face.half, face.corner_y, (radius, 0.8 * radius, face.half), face.corner_z)
    high = 0.8 * (face.upper + face.lower)
    lips = _at(face, 0.0, face.y + (face.upper - face.lower) / 2, (face.half, high, face.half))
    return Part(corner, None, 0.8), Part(lips, None, 0.2)


MUSCLES = {
    "zygomaticus": Muscle(
        0.18, "corners out, up and back: a smile", lambda face: _corner(face, 0.08, 0.06, (0.72, 0.66, -0.2))
    ),
    "risorius": Muscle(0.13, "corners out and back", lambda face: _corner(face, 0.10, 0.0, (0.97, 0.0, -0.24))),
    "depressor_anguli": Muscle(0.15, "corners down", lambda face: _corner(face, 0.0, -0.10, (0.15, -0.97, -0.1))),
    "orbicularis": Muscle(0.12, "the ring of the lips tightens", _ring),
    "pout": Muscle(0.15, "the ring tightens and comes forward", _ring, forward=0.25),
    "levator_labii": Muscle(
        0.055,
        "upper lip up",
        lambda face: (_upper(face, (0.10, 0.99, -0.1), x=0.35, lift=0.8, wide=0.5, high=1.6),),
    ),
    "depressor_labii": Muscle(
        0.075,
        "lower lip down",
        lambda face: (_lower(face, (0.10, -0.99, 0.0), x=0.35, drop=0.6, wide=0.5, high=1.4),),
    ),
    "mentalis": Muscle(
        0.05,
        "lower lip up and forward",
        lambda face: (_lower(face, (0.0, 0.94, 0.34), drop=1.0, wide=0.6, high=1.2),),
    ),
    "press": Muscle(
        0.045,
        "lips pressed together",
        lambda face: (_upper(face, (0.0, -1.0, 0.0), 0.4), _lower(face, (0.0, 1.0, 0.0), 0.6)),
    ),
    "burst": Muscle(
        0.035,
        "air drives the lips apart and forward",
        lambda face: (_upper(face, (0.0, 0.85, 0.53), 0.4), _lower(face, (0.0, -0.85, 0.53), 0.6)),
    ),
}
JAW = "jaw"


@dataclass(frozen=True)
class Activation:
    """A muscle at work.

    Parameters
    ----------
    muscle : a name of `MUSCLES`, or "jaw"
    peak : force of each side at activation 1, N; of the jaw the path of the chin, m. None takes the muscle's usual one,
        scaled to the size of the mouth and its thickness so that faces move alike, and 0.025 m for the jaw
    curve : activation over time, 0 to 1; of the jaw -0.1 to 1
    side : "both", or "left" or "right" of the face (left is x > 0)
    volume : in place of the muscle's own: on the left side, mirrored for the right one
    forward : force along z over that along the face, in place of the muscle's own

    Raises
    ------
    InputError : unknown muscle or side, a number out of range
    """

    muscle: str
    peak: float | None
    curve: Shape
    side: str = "both"
    volume: Volume | None = None
    forward: float | None = None

    def __post_init__(self):
        known = (JAW, *MUSCLES)
        if self.muscle not in known:
            raise InputError(f"expected a muscle of {choices(known)}, got {nearest(self.muscle, known)}")
        if self.side not in SIDES:
            raise InputError(f"expected the side of {self.muscle} as {choices(SIDES)}, got {nearest(self.side, SIDES)}")
        if self.peak is None and self.muscle == JAW:
            object.__setattr__(self, "peak", USUAL_DROP_M)
        for name in ("peak", "forward"):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, int | float) and math.isfinite(value)):
                raise InputError(f"expected the {name} of {self.muscle} as a finite number, got {value!r}")
        if self.peak is not None and self.peak < 0:
            raise InputError(f"expected the peak of {self.muscle} as 0 or more, got {self.peak}")
        lowest = 0.0
        if self.muscle == JAW:
            lowest = LOWEST
            if self.peak > LARGEST_DROP_M:
                raise InputError(
                    f"expected a jaw whose chin moves by up to {LARGEST_DROP_M} m, got {self.peak} m; "
                    "lengths are in metres"
                )
            if self.side != "both" or self.forward is not None:
                raise InputError("expected a jaw without side and forward: it turns as a whole")
        values = getattr(self.curve, "values", (0.0,))
        if not (lowest <= min(values) and max(values) <= HIGHEST):
            raise InputError(
                f"expected an activation of {self.muscle} from {lowest:g} to {HIGHEST:g}, got {min(values):g} to "
                f"{max(values):g}; the peak sets the strength"
            )


@dataclass(frozen=True)
class SineOf:
    """sin(angle curve(t)), with angle_rad the angle at 1."""

    curve: Shape
    angle_rad: float

    def value(self, t_s):
        """At times t_s, s, of any shape."""
        return np.sin(self.angle_rad * self.curve.value(t_s))

    def rate(self, t_s):
        """1/s, at times t_s, s."""
        return np.cos(self.angle_rad * self.curve.value(t_s)) * self.angle_rad * self.curve.rate(t_s)


@dataclass(frozen=True)
class VersineOf:
    """1 - cos(angle curve(t)), with angle_rad the angle at 1."""

    curve: Shape
    angle_rad: float

    def value(self, t_s):
        """At times t_s, s, of any shape."""
        return 2 * np.sin(self.angle_rad / 2 * self.curve.value(t_s)) ** 2

    def rate(self, t_s):
        """1/s, at times t_s, s."""
        return np.sin(self.angle_rad * self.curve.value(t_s)) * self.angle_rad * self.curve.rate(t_s)


@dataclass(frozen=True)
class Jaw:
    """The turning of the lower jaw about the axis through its joint, which runs along x.

    Parameters
    ----------
    joint_m : (x, y, z)
    peak_rad : angle at activation 1; positive opens the mouth
    curve : activation, or None for a jaw at rest
    """

    joint_m: tuple[float, float, float]
    peak_rad: float
    curve: Shape | None = None

    def transform(self, t_s: float) -> tuple[float, np.ndarray]:
        """The angle at time t_s, rad, and the joint (3,), m: y' = y cos - z sin, z' = y sin + z cos about it."""
        angle = 0.0 if self.curve is None else self.peak_rad * float(self.curve.value(t_s))
        return angle, np.array(self.joint_m)

    def turned(self, points: np.ndarray, t_s: float) -> np.ndarray:
        """Points (..., 3), m, fixed to the jaw at rest, at time t_s."""
        angle, joint = self.transform(t_s)
        x, y, z = np.moveaxis(points - joint, -1, 0)
        sin, cos = math.sin(angle), math.cos(angle)
        return np.stack([x, y * cos - z * sin, y * sin + z * cos], axis=-1) + joint


def jaw(mouth: Mouth, activations: Sequence[Activation], jaw_joint: tuple[float, float] = JAW_JOINT) -> Jaw:
    """The jaw that some activations move; its teeth follow it.

    Parameters
    ----------
    jaw_joint : y, z of the joint from the middle of the lips, m

    Raises
    ------
    InputError : two activations of the jaw, or a joint in front of the chin or below it
    """
    face = landmarks(mouth)
    working = [one for one in activations if one.muscle == JAW]
    if len(working) > 1:
        raise InputError(f"expected one activation of the jaw, got {len(working)}; join their key frames")
    y, z = face.y + jaw_joint[0], face.z + jaw_joint[1]
    if not (y > face.chin_y and z < face.chin_z - 0.01):
        raise InputError(f"expected the joint of the jaw above and behind the chin, got {tuple(jaw_joint)} m")
    radius = math.hypot(face.chin_y - y, face.chin_z - z)
    joint = (face.centre_x, y, z)
    return Jaw(joint, working[0].peak / radius, working[0].curve) if working else Jaw(joint, 0.0)


def skull(mouth: Mouth) -> Fixed:
    """The edge of the sheet above the level of the mouth, held."""
    edge = _rim(mouth)
    return Fixed(edge[mouth.nodes[edge, 1] >= landmarks(mouth).y])


def muscle_loads(
    mouth: Mouth, activations: Sequence[Activation], jaw_joint: tuple[float, float] = JAW_JOINT
) -> tuple[Load, ...]:
    """Loads of the jaw, which is held where no activation moves it, and of muscles.

    Parameters
    ----------
    activations : in any order; several of one muscle add up
    jaw_joint : y, z of the joint from the middle of the lips, m

    Raises
    ------
    InputError : a muscle without nodes, two activations of the jaw
    """
    loads = [_gums(mouth), *_jaw_loads(mouth, jaw(mouth, activations, jaw_joint))]
    volume, face = _tissue_volume(mouth), landmarks(mouth)
    for activation in activations:
        if activation.muscle == JAW or activation.peak == 0:
            continue
        force = _force(mouth.nodes, volume, face, activation)
        for axis in range(3):
            nodes = np.flatnonzero(force[:, axis])
            if len(nodes):
                loads.append(Force(nodes, axis, force[nodes, axis], activation.curve))
    return tuple(loads)


def muscle_force(mouth: Mouth, activation: Activation) -> np.ndarray:
    """(N, 3) N: the forces of a muscle at activation 1.

    On a mirror-symmetric mesh those of "both" sides are symmetric to the last bit.
    """
    return _force(mouth.nodes, _tissue_volume(mouth), landmarks(mouth), activation)


def usual_force(mouth: Mouth, name: str) -> float:
    """Force of each side of the muscle called `name` at activation 1, N, where none is given: that of a mouth of this
    size and thickness.
    """
    return _usual_force(MUSCLES[name], landmarks(mouth))


def _usual_force(muscle: Muscle, face: Landmarks) -> float:
    return muscle.peak_n * (face.half / USUAL_HALF_M) * (face.thickness / USUAL_THICKNESS_M)


def _force(X: np.ndarray, tissue: np.ndarray, face: Landmarks, activation: Activation) -> np.ndarray:
    image = X * [-1.0, 1.0, 1.0] + [2 * face.centre_x, 0.0, 0.0]
    total = np.zeros_like(X)
    if activation.side != "right":
        total = total + _left_force(X, tissue, face, activation)
    if activation.side != "left":
        total = total + _left_force(image, tissue, face, activation) * [-1.0, 1.0, 1.0]
    return total


def _left_force(X: np.ndarray, tissue: np.ndarray, face: Landmarks, activation: Activation) -> np.ndarray:
    muscle = MUSCLES[activation.muscle]
    parts = muscle.parts(face)
    if activation.volume is not None:
        parts = tuple(replace(part, volume=activation.volume) for part in parts)
    forward = muscle.forward if activation.forward is None else activation.forward
    peak = _usual_force(muscle, face) if activation.peak is None else activation.peak
    total = np.zeros_like(X)
    for part in parts:
        nodes_inside(X, part.volume, f"the volume of {activation.muscle}")
        weight = (1 - np.cos(math.pi * part.volume.depth(X))) / 2 * tissue
        if part.lip:
            weight = weight * (part.lip * (X[:, 1] - np.interp(X[:, 0], *face.line.T)) > 0)
        # Beyond the middle of the face it is the other side's muscle.
        across = np.clip((X[:, 0] - face.centre_x) / (0.25 * face.half), -1, 1)
        weight = weight * (1 + np.sin(math.pi / 2 * across)) / 2
        if part.pull is None:
            pull = np.stack([face.centre_x - X[:, 0], face.y - X[:, 1], np.zeros(len(X))], axis=1)
            pull /= [face.half, face.upper + face.lower, 1.0]
        else:
            pull = np.broadcast_to(np.divide(part.pull, math.hypot(*part.pull)), X.shape)
        force = weight[:, None] * pull
        force[:, 2] += forward * weight * (np.hypot(pull[:, 0], pull[:, 1]))
        size = math.fsum(np.sqrt((force[:, 0] ** 2 + force[:, 1] ** 2) + force[:, 2] ** 2))  # no order in the sum
        if not size > 0:
            raise InputError(
                f"expected nodes well inside the volume of {activation.muscle}, got them on its border or beyond the "
                "middle of the face only; move the volume to x > 0 or make it larger"
            )
        total += peak * part.share / size * force
    return total


def _gums(mouth: Mouth) -> Fixed:
    """The inside of the skin over the upper teeth: it slides over them but stays in front of them."""
    face = landmarks(mouth)
    middle = face.y + 2.4 * face.upper
    place = Ellipsoid(
        (face.centre_x, middle, face.z - face.thickness), (0.8 * face.half, 1.4 * face.upper, 3 * face.half)
    )
    inner = np.unique(mouth.inner)
    return Fixed(inner[nodes_inside(mouth.nodes[inner], place, "the upper gums")], (2,))


def _jaw_loads(mouth: Mouth, jaw: Jaw) -> list[Load]:
    nodes, part = jaw_nodes(mouth)
    if jaw.curve is None or jaw.peak_rad == 0:
        return [Fixed(nodes)]
    _, ry, rz = (mouth.nodes[nodes] - jaw.joint_m).T
    sine, versine = SineOf(jaw.curve, jaw.peak_rad), VersineOf(jaw.curve, jaw.peak_rad)
    return [
        Fixed(nodes, (0,)),
        Displacement(nodes, 1, -rz * part, sine),
        Displacement(nodes, 1, -ry * part, versine),
        Displacement(nodes, 2, ry * part, sine),
        Displacement(nodes, 2, -rz * part, versine),
    ]


def jaw_nodes(mouth: Mouth) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n,) that follow the jaw, and how far (n,): 1 those of the chin, less up the edge of the cheeks."""
    face = landmarks(mouth)
    X, edge = mouth.nodes, _rim(mouth)
    part = np.zeros(len(X))
    down = np.clip((face.y - X[edge, 1]) / (face.y - face.chin_y), 0, 1)
    part[edge] = down * down * (3 - 2 * down)
    gap = face.y - face.lower - face.chin_y  # from the chin to the red of the lip
    chin = Ellipsoid(
        (face.centre_x, face.chin_y, face.chin_z - face.thickness / 2), (0.8 * face.half, 0.8 * gap, face.half)
    )
    part[nodes_inside(X, chin, "the chin")] = 1.0
    nodes = np.flatnonzero(part)
    return nodes, part[nodes]


def _rim(mouth: Mouth) -> np.ndarray:
    """Nodes of the edge of the sheet, on both surfaces."""
    edges = np.concatenate([mouth.outer[:, [i, (i + 1) % 4]] for i in range(4)])
    _, place, uses = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    outer = np.unique(edges[place[uses == 1]])
    opposite = np.empty(len(mouth.nodes), np.int64)
    opposite[mouth.elements[:, 4:]] = mouth.elements[:, :4]
    return np.concatenate([opposite[outer], outer])


def _tissue_volume(mouth: Mouth) -> np.ndarray:
    """(N,) m3 of tissue of each node, without the saliva; mirrored nodes have the same to the last bit."""
    tissue = mouth.elements[mouth.group != SALIVA]
    volume = lumped_mass(mouth.nodes, tissue, np.ones(len(tissue)))
    volume = np.append(volume, np.zeros(len(mouth.nodes) - len(volume)))
    place = {tuple(X): node for node, X in enumerate((mouth.nodes + 0.0).tolist())}
    partner = [place.get((-x + 0.0, y, z), -1) for x, y, z in mouth.nodes.tolist()]
    return volume if -1 in partner else (volume + volume[partner]) / 2
