"""A mouth from a surface of quads in an OBJ file, and back (thesis sections 3.3.2 and 3.3.3).

The file holds the outer surface of the lower face with closed lips, its quads under the names skin, lips and saliva
(as material, group or object), x across the face, y up, z towards the viewer. The saliva is a chain of thin quads from
one corner of the mouth to the other. Extruded along z it becomes one layer of hexahedra.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from simulator.atomic import whole_file
from simulator.errors import InputError
from simulator.mouth import COMMISSURE, FLATTEST, GROUPS, LIPS, SALIVA, Mouth, corner_quality
from simulator.obj_file import Face, ObjFile, read_obj
from simulator.wording import choices, nearest

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
WIDTHS_M = (0.02, 0.12)  # of a mouth: outside, the units are wrong


def read_mouth_obj(path: str | Path, thickness_m: float = 0.006, units: str = "m") -> Mouth:
    """Mouth from an OBJ file of quads.

    Parameters
    ----------
    path : the file; vertices that no face uses are left out
    thickness_m : depth of the layer, along z, m
    units : of the file, one of `UNITS`

    Returns
    -------
    Mouth with nodes and elements in the order of the file, the inner nodes first. Its `border_m` is the distance in
    space to the line between skin and lips, its `film_m` the median height of the saliva's quads seen from the front,
    its `shape` None.

    Raises
    ------
    InputError : a file that is not such a surface; the message names the line
    """
    if units not in UNITS:
        raise InputError(f"expected units of {choices(UNITS)}, got {nearest(units, UNITS)}")
    if not (isinstance(thickness_m, int | float) and 0.0005 <= thickness_m <= 0.03):
        raise InputError(f"expected thickness_m between 0.0005 and 0.03 m, got {thickness_m!r}")
    read = read_obj(path)
    quads, group = _quads(read), np.array([_group(face, read.path) for face in read.faces])
    for number, name in enumerate(GROUPS):
        if number != COMMISSURE and not (group == number).any():
            raise InputError(f"{read.path}: expected quads of the groups {choices(GROUPS)}, got none of {name}")
    used = np.unique(quads)
    _check_coinciding(read, used)
    number = np.full(len(read.vertices), -1)
    number[used] = np.arange(len(used))
    outer, faces = read.vertices[used] * UNITS[units], number[quads]
    _check_shapes(read, outer, faces, thickness_m)
    faces = _turned(outer, faces)
    _check_edges(read, faces)
    faces, chain = _chain(read, outer, faces, group)
    lower, upper = (_along(faces[chain], first, last) for first, last in ((0, 1), (3, 2)))
    width = np.linalg.norm(outer[upper[-1]] - outer[upper[0]])
    if not WIDTHS_M[0] <= width <= WIDTHS_M[1]:
        raise InputError(
            f"{read.path}: expected a mouth {WIDTHS_M[0]} to {WIDTHS_M[1]} m wide, got {width:.3g} m; "
            f"say in which units the file is, {choices(UNITS)}"
        )
    count = len(outer)
    border = _border_distance(outer, faces, group)
    height = np.linalg.norm((outer[upper] - outer[lower])[:, :2], axis=1)
    return Mouth(
        nodes=np.concatenate([outer - [0, 0, thickness_m], outer]),
        elements=np.concatenate([faces, faces + count], axis=1),
        group=group,
        saliva=chain,
        upper=np.stack([count + upper, upper], axis=1),
        lower=np.stack([count + lower, lower], axis=1),
        outer=faces + count,
        inner=faces[:, ::-1],
        border_m=np.concatenate([border, border]),
        film_m=float(np.median(height)),
    )


def write_surface_obj(mouth: Mouth, path: str | Path) -> None:
    """Write the outer surface of a mouth, m, in groups, for a modelling program or `read_mouth_obj`.

    Raises
    ------
    InputError : the place cannot be written to
    """
    lines = ["# outer surface of a mouth; x across, y up, z towards the viewer; metres"]
    used = np.unique(mouth.outer)
    number = np.zeros(len(mouth.nodes), np.int64)
    number[used] = np.arange(1, len(used) + 1)
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in mouth.nodes[used].tolist()]
    before = None
    for quad, group in zip(number[mouth.outer].tolist(), mouth.group.tolist(), strict=True):
        if group != before:
            lines += [f"g {GROUPS[group]}", f"usemtl {GROUPS[group]}"]
            before = group
        lines.append("f " + " ".join(map(str, quad)))
    with whole_file(path) as part:
        part.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _quads(read: ObjFile) -> np.ndarray:
    """(Q, 4) vertex numbers."""
    for face in read.faces:
        if len(face.corners) != 4:
            raise InputError(
                f"{read.path}, line {face.line}: expected quads only, got a face of {len(face.corners)} vertices; "
                "a layer of hexahedra needs four"
            )
    return np.array([face.corners for face in read.faces])


def _group(face: Face, path: Path) -> int:
    """Number of the group of a face; exporters add endings such as '.001' to names."""
    for name in face.names:
        plain = re.sub(r"\.\d+$", "", name).lower()
        if plain in GROUPS:
            return GROUPS.index(plain)
    got = nearest(face.names[0], GROUPS) if face.names else "none"
    raise InputError(
        f"{path}, line {face.line}: expected a face under the material, group or object {choices(GROUPS)}, got {got}"
    )


def _check_coinciding(read: ObjFile, used: np.ndarray) -> None:
    places, back, counts = np.unique(read.vertices[used], axis=0, return_inverse=True, return_counts=True)
    if len(places) < len(used):
        first = int(np.flatnonzero(counts > 1)[0])
        one, other = np.sort(read.vertex_lines[used[back.ravel() == first]])[:2]
        raise InputError(
            f"{read.path}, line {other}: expected vertices at different places, got the place of line {one} again; "
            "merge them"
        )


def _check_shapes(read: ObjFile, outer: np.ndarray, faces: np.ndarray, thickness_m: float) -> None:
    """Refuse quads that would make bad hexahedra."""
    nodes = np.concatenate([outer - [0, 0, thickness_m], outer])
    quality = corner_quality(nodes, np.concatenate([faces, faces + len(outer)], axis=1))
    bad = np.flatnonzero(quality < FLATTEST)
    if not len(bad):
        return
    line, value = read.faces[bad[0]].line, quality[bad[0]]
    if len(bad) == len(faces) and quality.max() < 0:
        cause = "clockwise quads; flip the normals of the surface, or turn the face towards +z"
    elif value < -FLATTEST:
        cause = "one that is inverted there, not convex, or folded behind the face; reorder its vertices or reshape it"
    else:
        cause = "one that is almost flat there, or seen from the side; reshape it"
    raise InputError(
        f"{read.path}, line {line}: expected convex quads counter-clockwise seen from +z, with corners of quality "
        f"{FLATTEST} or more, got {value:.2g}: {cause}"
    )


def _turned(outer: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The quads, each with its first edge as nearly along x as it can be, so that the solver sees rows."""
    edges = outer[np.roll(faces, -1, axis=1)] - outer[faces]
    first = np.argmax(edges[:, :, 0] / np.linalg.norm(edges, axis=2), axis=1)
    return np.take_along_axis(faces, (first[:, None] + np.arange(4)) % 4, axis=1)


def _check_edges(read: ObjFile, faces: np.ndarray) -> None:
    """Refuse edges of three quads, and surfaces in pieces."""
    of, edge, uses = _edges(faces)
    if uses.max() > 2:
        first = int(np.argmax(uses[edge] > 2))
        raise InputError(
            f"{read.path}, line {read.faces[of[first]].line}: expected at most two quads at an edge, got "
            f"{uses[edge[first]]}; remove doubled faces"
        )
    nodes = faces.max() + 1
    links = coo_array((np.ones(faces.size), (np.repeat(faces[:, 0], 4), faces.ravel())), shape=(nodes, nodes))
    pieces, piece = connected_components(links, directed=False)
    if pieces > 1:
        other = int(np.argmax(piece[faces[:, 0]] != piece[faces[0, 0]]))
        raise InputError(
            f"{read.path}, line {read.faces[other].line}: expected one connected surface, got {pieces} pieces; "
            "remove teeth, tongue and loose parts, and merge doubled vertices"
        )


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the (4Q,) sides of the quads: the quad and the number of the edge; and the uses of each edge."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
    _, edge, uses = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    return np.repeat(np.arange(len(faces)), 4), edge.ravel(), uses


def _chain(read: ObjFile, outer: np.ndarray, faces: np.ndarray, group: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The quads, those of the saliva turned so that 0-1 is the edge of the lower lip; and the saliva along x."""
    saliva = np.flatnonzero(group == SALIVA)
    sides: dict[int, list[tuple[int, int]]] = {}  # edge -> (quad, its side)
    of, edge, _ = _edges(faces[saliva])
    for place, (quad, one) in enumerate(zip(of.tolist(), edge.tolist(), strict=True)):
        sides.setdefault(one, []).append((quad, place % 4))
    next_to: list[dict[int, int]] = [{} for _ in saliva]  # neighbour -> own side
    for pair in sides.values():
        if len(pair) == 2:
            (a, side_a), (b, side_b) = pair
            next_to[a][b], next_to[b][a] = side_a, side_b
    for quad, neighbours in enumerate(next_to):
        own = sorted(neighbours.values())
        if len(own) not in (1, 2) or (len(own) == 2 and own[1] - own[0] != 2):
            raise _no_chain(
                read, saliva[quad], f"{len(own)} saliva quads beside this one" + (" but not opposite" * (len(own) == 2))
            )
    x = outer[faces[saliva]][:, :, 0].mean(axis=1)
    ends = [quad for quad, neighbours in enumerate(next_to) if len(neighbours) == 1]
    if not ends:
        raise _no_chain(read, saliva[0], "a closed ring")
    order = [min(ends, key=lambda quad: x[quad])]
    while True:
        onward = [quad for quad in next_to[order[-1]] if len(order) < 2 or quad != order[-2]]
        if not onward:
            break
        order.append(onward[0])
    if len(order) < len(saliva):
        missing = min(set(range(len(saliva))) - set(order))
        raise _no_chain(read, saliva[missing], "this one apart from the others")
    turned = faces.copy()
    for place, quad in enumerate(order):
        # Side 1 leads to the next quad, side 3 to the one before.
        side = next_to[quad][order[place + 1]] if place + 1 < len(order) else next_to[quad][order[place - 1]] + 2
        turned[saliva[quad]] = np.roll(faces[saliva[quad]], 1 - side)
    chain = saliva[order]
    lower, upper = (_along(turned[chain], *ends) for ends in ((0, 1), (3, 2)))
    back = np.flatnonzero((np.diff(outer[lower, 0]) <= 0) | (np.diff(outer[upper, 0]) <= 0))
    if len(back):
        raise _no_chain(read, chain[back[0]], "one that turns back along x")
    return turned, chain


def _no_chain(read: ObjFile, quad: int, got: str) -> InputError:
    return InputError(
        f"{read.path}, line {read.faces[quad].line}: expected the saliva as one chain of two or more quads, side by "
        f"side from corner to corner, got {got}"
    )


def _along(quads: np.ndarray, first: int, last: int) -> np.ndarray:
    """(S + 1,) nodes along one edge of a chain."""
    return np.append(quads[:, first], quads[-1, last])


def _border_distance(outer: np.ndarray, faces: np.ndarray, group: np.ndarray) -> np.ndarray:
    """(n,) m: distance of outer nodes to the line between skin and lips (with the saliva), positive in the lips."""
    _, edge, uses = _edges(faces)
    red = np.repeat(np.isin(group, (LIPS, SALIVA)), 4)
    red_uses = np.bincount(edge, red, minlength=len(uses))
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    line = ends[red & (red_uses[edge] == 1) & (uses[edge] == 2)]
    if not len(line):
        return np.full(len(outer), math.inf)
    a, along = outer[line[:, 0]], outer[line[:, 1]] - outer[line[:, 0]]
    length_2 = np.einsum("ei,ei->e", along, along)
    distance = np.empty(len(outer))
    for start in range(0, len(outer), 4096):
        offset = outer[start : start + 4096, None] - a
        part = np.clip(np.einsum("nei,ei->ne", offset, along) / length_2, 0, 1)
        rest = offset - part[..., None] * along
        distance[start : start + 4096] = np.sqrt(np.einsum("nei,nei->ne", rest, rest).min(axis=1))
    outside = np.zeros(len(outer), bool)
    outside[faces[~np.isin(group, (LIPS, SALIVA))]] = True
    return np.where(outside, -distance, distance)
