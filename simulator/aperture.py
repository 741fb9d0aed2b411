"""The hole between the lips as it is seen: exact polygons from the nodes of the lips' edges, no image processing.

A lip is some 6 mm deep. Its outer edge, its inner edge and the side of the lip between them all hide what lies behind.
Arrays of edges have axes time, column, edge (0 outer, 1 inner), coordinate; element s of the saliva lies between
columns s and s + 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from simulator.errors import InputError
from simulator.motion import INTACT
from simulator.mouth import Mouth

# Saliva that stays on the lips when the film between them parts, half of it on each (0.07 to 0.1 mm: thesis 3.6.1).
# It hides the last of the gap, so that an opening grows steadily and not by whole elements.
COAT_M = 1e-4
SEEN_M = 1e-5  # what is nowhere higher is not an opening: a hundredth of a pixel where the mouth is 50 px wide
_TOUCHING = 1e-6  # of the above: where it is less high the lips touch and part an opening in two, rounding or not
_SAME = 1e-9  # relative, for a distance that equals the one at rest


class LipEdges(NamedTuple):
    """The edges of the lips that are seen, without the film of saliva between them.

    upper, lower : (T, C, 2, 3) m; where the lips are closed both are the same point
    gap_m : (T, C) distance between them, the smaller of that outside and that inside, m
    loose : (T, C - 1) elements that are not intact and stand open
    """

    upper: np.ndarray
    lower: np.ndarray
    gap_m: np.ndarray
    loose: np.ndarray


class Pieces(NamedTuple):
    """Visible openings of all frames, frame by frame and along the lips.

    points : (P, 2) corners of all polygons, one after the other, in the axes of the edges
    start : (K + 1,) piece k has corners start[k] up to start[k + 1]
    frame : (K,)
    first, last : (K,) saliva elements between which it lies, both included
    """

    points: np.ndarray
    start: np.ndarray
    frame: np.ndarray
    first: np.ndarray
    last: np.ndarray


def lip_edges(
    upper: np.ndarray,
    lower: np.ndarray,
    rest_upper: np.ndarray,
    rest_lower: np.ndarray,
    state: np.ndarray | None = None,
) -> LipEdges:
    """Take the film out of the gap, and close the lips where the saliva is intact.

    The film belongs to the lips, half of it to each, and a coat of saliva stays on them: in every column the two ends
    of the outer and of the inner edge are moved towards each other, along the line that joins them, by half their
    distance at rest and half of COAT_M. Where they meet, or have passed one another, both are put in
    the middle. So are both edges of a column that an intact element touches.

    Parameters
    ----------
    upper, lower : (T, C, 2, 3) nodes of the lips' edges, m
    rest_upper, rest_lower : (C, 2, 3) the same at rest, m
    state : (T, C - 1) of the saliva's elements; 0 is intact. None takes none as intact: this is where the edges are
        drawn, with stretched saliva between them
    """
    rest = rest_upper - rest_lower
    rest_m = np.linalg.norm(rest, axis=-1)
    across = upper - lower
    distance = np.linalg.norm(across, axis=-1)
    passed = np.einsum("tcei,cei->tce", across, rest) <= 0
    intact = np.zeros((len(upper), upper.shape[1] - 1), bool) if state is None else state == INTACT
    tied = np.zeros(distance.shape[:2], bool)
    tied[:, :-1] |= intact
    tied[:, 1:] |= intact
    rest_m = rest_m + COAT_M
    closed = (distance <= rest_m * (1 + _SAME)) | passed | tied[..., None]
    gap = np.where(closed, 0.0, distance - rest_m)
    middle = (upper + lower) / 2
    half = across * (gap / np.where(distance > 0, distance, 1.0) / 2)[..., None]
    gap_m = gap.min(axis=2)  # closed inside or outside is closed
    loose = ~intact & (np.maximum(gap_m[:, :-1], gap_m[:, 1:]) > SEEN_M)
    return LipEdges(middle + half, middle - half, gap_m, loose)


def mouth_edges(mouth: Mouth, positions: np.ndarray, state: np.ndarray | None = None) -> LipEdges:
    """`lip_edges` of a mouth whose nodes are at positions (T, N, 3), m.

    Raises
    ------
    InputError : a shape that does not fit
    """
    positions = np.asarray(positions)
    if positions.ndim != 3 or positions.shape[1:] != mouth.nodes.shape:
        raise InputError(f"expected positions of shape (T, {len(mouth.nodes)}, 3), got {positions.shape}")
    upper, lower = mouth.upper, mouth.lower
    return lip_edges(positions[:, upper], positions[:, lower], mouth.nodes[upper], mouth.nodes[lower], state)


def shown_positions(mouth: Mouth, positions: np.ndarray) -> np.ndarray:
    """(T, N, 3) m, the positions with the lips' edges where they are drawn: nearer to each other by film and coat.

    Pictures, the viewer and files for animators all have the edges here, so that what gapes in them is as high as the
    truth says.

    Raises
    ------
    InputError : a shape that does not fit
    """
    edges = mouth_edges(mouth, positions)
    shown = np.array(positions, float)
    shown[:, mouth.upper], shown[:, mouth.lower] = edges.upper, edges.lower
    return shown


def runs(loose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Runs of neighbours that are True in (T, S) bool: frame, first and last element (R,) of each, in order."""
    padded = np.zeros((loose.shape[0], loose.shape[1] + 2), np.int8)
    padded[:, 1:-1] = loose
    step = np.diff(padded, axis=1)
    frame, first = map(np.ascontiguousarray, np.nonzero(step == 1))  # else what reads them is compiled twice
    _, behind = np.nonzero(step == -1)
    return frame, first, behind - 1


def visible(upper: np.ndarray, lower: np.ndarray, loose: np.ndarray, seen: float) -> Pieces:
    """Polygons of what is seen between the lips.

    In each run of loose elements the opening reaches up to the lowest of the upper lip's edges and side, down to the
    highest of the lower lip's, over the places that all four edges span. Where these pass one another it is
    closed, so one run may give several openings or none.

    Parameters
    ----------
    upper, lower : (T, C, 2, 2) edges in the picture: place along the mouth, and across it, downwards
    loose : (T, C - 1) as in `LipEdges`
    seen : an opening is higher than this somewhere, in the unit of the edges
    """
    upper, lower = np.ascontiguousarray(upper), np.ascontiguousarray(lower)
    frames, columns = upper.shape[:2]
    # all places where a line along a lip may begin or end
    cuts = np.sort(np.stack([upper[..., 0], lower[..., 0]], axis=-1).reshape(frames, 4 * columns), axis=1)
    frame, first, last = runs(loose)
    piece = np.empty((len(frame) * (4 * columns + 1), 2), np.int64)  # at most one between two cuts
    room = len(frame) * (4 * columns + 16)
    while True:
        points, chain = np.empty((room, 2)), np.empty((2, 16 * columns + room // 64, 2))
        used, pieces = _trace(upper, lower, cuts, frame, first, last, seen, chain, points, piece)
        if used >= 0:
            break
        room *= 2
    points, run = points[:used].copy(), piece[:pieces, 1]
    start = np.concatenate([[0], piece[:pieces, 0]])
    if pieces:
        place = (upper[..., 0] + lower[..., 0]).mean(axis=2)[frame[run]] / 2  # (K, C) of the columns
        element = np.arange(columns - 1)
        within = (element >= first[run, None]) & (element <= last[run, None])
        within &= np.maximum(place[:, :-1], place[:, 1:]) > np.minimum.reduceat(points[:, 0], start[:-1])[:, None]
        within &= np.minimum(place[:, :-1], place[:, 1:]) < np.maximum.reduceat(points[:, 0], start[:-1])[:, None]
        first, last = within.argmax(axis=1), columns - 2 - within[:, ::-1].argmax(axis=1)
    return Pieces(points, start, frame[run], first[:pieces], last[:pieces])


# Plain loops below: array expressions take numba several times as long to compile.
_kernel = numba.njit(cache=True, nogil=True, error_model="numpy", no_cpython_wrapper=True)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _trace(upper, lower, cuts, frame, first, last, seen, chain, points, piece):
    """Walk along every run from left to right and write down the pieces.

    chain (2, n, 2) takes the corners of the upper and the lower side of the piece in hand, points (m, 2) those of all
    polygons, piece (k, 2) where its corners end, and its run. Returns the numbers of points and pieces; a negative
    number of points where there was not room enough.
    """
    columns = upper.shape[1]
    lines = np.empty((2, 3 * columns, 4))  # of the upper and the lower lip: u, v at the left and the right end
    reach = np.empty((2, 3 * columns))  # rightmost end of the lines up to this one
    begin = np.empty((2, 3 * columns))  # leftmost end of the lines from this one on
    sizes = np.zeros(4, np.int64)  # corners in the upper and in the lower chain, points, pieces
    touching = _TOUCHING * seen
    for r in range(len(frame)):
        t, a, b = frame[r], first[r], last[r] + 1
        top, bottom = upper[t, a : b + 1], lower[t, a : b + 1]
        count_u, least_u, most_u = _gather(top, lines[0], reach[0], begin[0])
        count_l, least_l, most_l = _gather(bottom, lines[1], reach[1], begin[1])
        low, high = max(least_u, least_l), min(most_u, most_l)
        tiny = 1e-12 * max(high - low, abs(low), abs(high))  # far above rounding
        from_u, from_l, line_u, line_l, highest = 0, 0, -1, -1, 0.0
        left = low
        for c in range(cuts.shape[1] + 1):
            if left >= high:
                break
            right = high if c == cuts.shape[1] else min(cuts[t, c], high)
            if right <= left + tiny:
                continue
            while reach[0, from_u] <= left + tiny:
                from_u += 1
            while reach[1, from_l] <= left + tiny:
                from_l += 1
            x = left
            while x < right:
                i, end_u = _bound(lines[0], begin[0], from_u, count_u, x, right, 1.0, tiny)
                j, end_l = _bound(lines[1], begin[1], from_l, count_l, x, right, -1.0, tiny)
                end = min(end_u, end_l)
                f0, f1, g0, g1 = _at(lines[0, i], x), _at(lines[0, i], end), _at(lines[1, j], x), _at(lines[1, j], end)
                d0, d1 = g0 - f0, g1 - f1
                if sizes[0] > 0 and d0 <= touching:
                    _finish(chain, sizes, highest, seen, points, piece, r)
                if d0 > touching or d1 > touching:
                    x0, x1 = x, end
                    if d0 < 0 or d1 < 0:  # the sides meet in between
                        part = d0 / (d0 - d1)
                        meet, height = x + part * (end - x), f0 + part * (f1 - f0)
                        if d0 < 0:
                            x0, f0, g0 = meet, height, height
                        else:
                            x1, f1, g1 = meet, height, height
                    if sizes[0] == 0:
                        line_u, line_l, highest = -1, -1, 0.0
                    if max(sizes[0], sizes[1]) + 2 > chain.shape[1] or sizes[0] + sizes[1] + sizes[2] + 4 > len(points):
                        return np.int64(-1), np.int64(0)
                    sizes[0] = _extend(chain[0], sizes[0], i == line_u, x0, f0, x1, f1)
                    sizes[1] = _extend(chain[1], sizes[1], j == line_l, x0, g0, x1, g1)
                    line_u, line_l, highest = i, j, max(highest, g0 - f0, g1 - f1)
                    if d1 <= touching:
                        _finish(chain, sizes, highest, seen, points, piece, r)
                x = end
            left = right
        if sizes[0] > 0:
            _finish(chain, sizes, highest, seen, points, piece, r)
    return sizes[2], sizes[3]


@_kernel
def _gather(lip, lines, reach, begin):
    """Lines of a lip in the order of its columns: across its side, along its outer, along its inner edge.

    Returns their number, and from where to where both edges reach along the mouth.
    """
    count = 0
    least, most = lip[0, 0, 0], lip[0, 0, 0]
    other_least, other_most = lip[0, 1, 0], lip[0, 1, 0]
    for c in range(len(lip)):
        least, most = min(least, lip[c, 0, 0]), max(most, lip[c, 0, 0])
        other_least, other_most = min(other_least, lip[c, 1, 0]), max(other_most, lip[c, 1, 0])
        for kind in range(3 if c + 1 < len(lip) else 1):
            edge = 1 if kind == 2 else 0
            u0, v0 = lip[c, edge, 0], lip[c, edge, 1]
            if kind == 0:
                u1, v1 = lip[c, 1, 0], lip[c, 1, 1]
            else:
                u1, v1 = lip[c + 1, edge, 0], lip[c + 1, edge, 1]
            if u0 == u1:  # upright: its ends belong to other lines
                continue
            if u0 > u1:
                u0, v0, u1, v1 = u1, v1, u0, v0
            lines[count, 0], lines[count, 1], lines[count, 2], lines[count, 3] = u0, v0, u1, v1
            reach[count] = u1 if count == 0 else max(reach[count - 1], u1)
            count += 1
    for k in range(count - 1, -1, -1):
        begin[k] = lines[k, 0] if k == count - 1 else min(begin[k + 1], lines[k, 0])
    return count, max(least, other_least), min(most, other_most)


@_kernel
def _bound(lines, begin, start, count, x, right, sign, tiny):
    """The lowest (sign 1) or highest (-1) line just right of x, and where another takes over, at most `right`.

    No line begins or ends between x and `right`.
    """
    best, value, later = -1, 0.0, 0.0
    for k in range(start, count):
        if begin[k] > x + tiny:
            break
        if lines[k, 0] <= x + tiny and lines[k, 2] >= right - tiny:
            here, there = sign * _at(lines[k], x), sign * _at(lines[k], right)
            # lines that cross at x are equal there but for rounding: the one ahead at `right` is it
            if best < 0 or here > value + tiny or (here > value - tiny and there > later):
                best, value, later = k, here, there
    end = right
    for k in range(start, count):
        if begin[k] > x + tiny:
            break
        if lines[k, 0] <= x + tiny and lines[k, 2] >= right - tiny:
            here, there = sign * _at(lines[k], x), sign * _at(lines[k], right)
            if there > later + tiny:
                end = min(end, max(x + tiny, x + (right - x) * (value - here) / (value - here + there - later)))
    return best, end


@_kernel
def _at(line, x):
    return line[1] + (line[3] - line[1]) * ((x - line[0]) / (line[2] - line[0]))


@_kernel
def _extend(chain, size, same_line, x0, v0, x1, v1):
    """Lengthen a chain of corners by a stretch from (x0, v0) to (x1, v1); its new size."""
    if size > 0 and same_line:
        size -= 1
    elif size == 0 or chain[size - 1, 0] != x0 or chain[size - 1, 1] != v0:
        chain[size, 0], chain[size, 1] = x0, v0
        size += 1
    chain[size, 0], chain[size, 1] = x1, v1
    return size + 1


@_kernel
def _finish(chain, sizes, highest, seen, points, piece, run):
    """Empty the chains and, where the piece was high enough, add it: the upper chain, then the lower one backwards."""
    start, total, same = sizes[2], sizes[0] + sizes[1], 0.01 * _TOUCHING * seen
    used = start
    if highest > seen:
        for k in range(total):
            side, at = (0, k) if k < sizes[0] else (1, total - 1 - k)
            u, v = chain[side, at, 0], chain[side, at, 1]
            if used == start or abs(u - points[used - 1, 0]) > same or abs(v - points[used - 1, 1]) > same:
                points[used, 0], points[used, 1] = u, v
                used += 1
        u, v = points[start, 0], points[start, 1]
        if abs(u - points[used - 1, 0]) <= same and abs(v - points[used - 1, 1]) <= same:
            used -= 1
        k = sizes[3]
        piece[k, 0], piece[k, 1] = used, run
        sizes[2], sizes[3] = used, k + 1
    sizes[0], sizes[1] = 0, 0
