"""The surface of a mouth for display and for animators: what is seen of it, with closed lips that look closed.

The surface is the outer and the inner surface without the saliva, the lips' walls that face each other, and the rim of
the sheet; it is closed, each edge has two quads. The lips' edges are where `aperture.shown_positions` has them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulator.aperture import shown_positions
from simulator.errors import InputError
from simulator.motion import Motion
from simulator.mouth import LIPS, SALIVA, SKIN, Mouth
from simulator.playback import values_at


@dataclass(frozen=True, eq=False)
class Surface:
    """Quads of a mouth that stay the same over time.

    Parameters
    ----------
    quads : (Q, 4) vertices, counter-clockwise seen from outside; skin first, then lips; the first use of each vertex
        is in the order of their numbers, so that programs which number vertices anew number them the same
    groups : (Q,) SKIN or LIPS
    element_of : (Q,) element that each quad is a side of
    nodes : (V,) node of the mouth that each vertex is
    """

    quads: np.ndarray
    groups: np.ndarray
    element_of: np.ndarray
    nodes: np.ndarray

    def vertex_of(self, nodes: np.ndarray) -> np.ndarray:
        """Vertices of `nodes`, same shape; -1 where a node is inside the body."""
        number = np.full(max(int(self.nodes.max()), int(np.max(nodes))) + 1, -1)
        number[self.nodes] = np.arange(len(self.nodes))
        return number[nodes]


def display_surface(mouth: Mouth) -> Surface:
    """The quads that are seen of a mouth."""
    body = np.flatnonzero(mouth.group != SALIVA)
    outside = mouth.outer[body]
    # Each side of an outer quad that no neighbour shares carries a wall down to the inner surface.
    start, end = outside.ravel(), np.roll(outside, -1, axis=1).ravel()
    count = len(mouth.nodes)
    shared = np.isin(start * count + end, end * count + start)
    below = np.arange(count)
    below[mouth.elements[:, 4:]] = mouth.elements[:, :4]
    start, end, owner = start[~shared], end[~shared], np.repeat(body, 4)[~shared]
    walls = np.stack([end, start, below[start], below[end]], axis=1)
    on_edge = np.isin(walls, np.concatenate([mouth.upper, mouth.lower])).all(axis=1)
    quads = np.concatenate([outside, mouth.inner[body], walls])
    of_body = np.where(mouth.group[body] == LIPS, LIPS, SKIN)  # the corners look like skin
    groups = np.concatenate([of_body, of_body, np.where(on_edge, LIPS, SKIN)])
    element_of = np.concatenate([body, body, owner])
    order = np.argsort(groups, kind="stable")
    quads, groups, element_of = quads[order], groups[order], element_of[order]
    nodes, first, inverse = np.unique(quads, return_index=True, return_inverse=True)
    by_use = np.argsort(first)
    number = np.empty(len(nodes), np.int64)
    number[by_use] = np.arange(len(nodes))
    return Surface(number[inverse.reshape(quads.shape)], groups, element_of, nodes[by_use])


def display_positions(mouth: Mouth, positions: np.ndarray) -> np.ndarray:
    """(T, V, 3) m, where the vertices of `display_surface` are when the nodes are at `positions` (T, N, 3), m.

    Raises
    ------
    InputError : a shape that does not fit
    """
    return shown_positions(mouth, positions)[:, display_surface(mouth).nodes]


def display_frames(mouth: Mouth, motion: Motion, times_s: np.ndarray) -> np.ndarray:
    """(F, V, 3) m, where the vertices of `display_surface` are at times (F,), s; linear between the saved ones.

    Raises
    ------
    InputError : times that `playback.at_times` refuses, or a position that is no number, as after a run that blew up
    """
    frames = display_positions(mouth, values_at(motion.time_s, motion.positions, times_s))
    bad = ~np.isfinite(frames).all(axis=(1, 2))
    if bad.any():
        raise InputError(
            f"expected positions that are numbers, got some that are not at {times_s[np.argmax(bad)]:g} s; "
            "leave out the times from there on"
        )
    return np.asarray(frames, float)


def vertex_normals(vertices: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """(..., V, 3) unit normals of vertices (..., V, 3): the mean of the quads (Q, 4) at each, weighted by area."""
    corner = [vertices[..., quads[:, k], :] for k in range(4)]
    twice_area = np.cross(corner[2] - corner[0], corner[3] - corner[1])
    normals = np.zeros_like(vertices, dtype=float)
    for k in range(4):
        np.add.at(normals, (..., quads[:, k], slice(None)), twice_area)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.where(length > 0, normals / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0])
