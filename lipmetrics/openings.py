"""From outlines to numbers: extents, height, area and centroid of an opening, and its identity over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np


class Opening(NamedTuple):
    """One opening in one frame, in px; row_min is the upper edge, col_min the left edge.

    `width_px` is the horizontal extent. `height_px` is the inside length of the fullest column, not the vertical
    extent: a mouth that smiles or is tilted is not higher for it.
    """

    row_min: float
    row_max: float
    col_min: float
    col_max: float
    width_px: float
    height_px: float
    area_px: float
    centroid_row: float
    centroid_col: float


def measure_outline(outline: np.ndarray) -> Opening:
    """Measure one opening.

    Parameters
    ----------
    outline : (n, 2) float (row, column) in px, a simple polygon of at least 3 corners, last one not repeated
    """
    return Opening(*_measure(np.ascontiguousarray(outline, np.float64)))


@numba.njit(cache=True)
def _measure(outline):
    """The fields of Opening."""
    row_min, row_max, col_min, col_max = np.inf, -np.inf, np.inf, -np.inf
    for row, col in outline:
        row_min, row_max = min(row_min, row), max(row_max, row)
        col_min, col_max = min(col_min, col), max(col_max, col)
    area, centroid_row, centroid_col = _area_and_centroid(outline)
    height = fullest_column(outline)
    return row_min, row_max, col_min, col_max, col_max - col_min, height, area, centroid_row, centroid_col


@numba.njit(cache=True)
def _area_and_centroid(outline):
    """Shoelace formula about the first corner, which keeps the products small."""
    origin_row, origin_col = outline[0]
    twice_area = sum_row = sum_col = 0.0
    for k in range(1, len(outline) - 1):
        row_a, col_a = outline[k, 0] - origin_row, outline[k, 1] - origin_col
        row_b, col_b = outline[k + 1, 0] - origin_row, outline[k + 1, 1] - origin_col
        cross = col_a * row_b - col_b * row_a
        twice_area += cross
        sum_row += (row_a + row_b) * cross
        sum_col += (col_a + col_b) * cross
    if twice_area == 0.0:  # a line or a point
        return 0.0, outline[:, 0].mean(), outline[:, 1].mean()
    return abs(twice_area) / 2, origin_row + sum_row / (3 * twice_area), origin_col + sum_col / (3 * twice_area)


@numba.njit(cache=True)
def fullest_column(outline):
    """Largest total length of a simple polygon inside one vertical line, px; outline (n, 2) float64 (row, column).

    Along the columns between two neighbouring corners the inside length is linear, so it is largest at a corner, on one
    of its two sides. Edges crossed by a vertical line alternate in direction, so the inside length is the sum of
    their rows, signed by direction.
    """
    corners = np.sort(outline[:, 1])  # one column several times changes no maximum; np.unique takes long to compile
    right_of = np.zeros(len(corners))  # inside length just right of each corner column
    left_of = np.zeros(len(corners))
    for k in range(len(outline)):
        row_a, col_a = outline[k - 1]
        row_b, col_b = outline[k]
        if col_a == col_b:
            continue
        sign = 1.0
        if col_a > col_b:
            row_a, col_a, row_b, col_b = row_b, col_b, row_a, col_a
            sign = -1.0
        slope = (row_b - row_a) / (col_b - col_a)
        for i in range(np.searchsorted(corners, col_a), np.searchsorted(corners, col_b)):
            right_of[i] += sign * (row_a + slope * (corners[i] - col_a))
            left_of[i + 1] += sign * (row_a + slope * (corners[i + 1] - col_a))
    return max(np.abs(right_of).max(), np.abs(left_of).max())


class Identity(NamedTuple):
    """Who an opening is: its number, what happened to it in this frame, and who it came from.

    event : ``""`` (goes on), ``"new"``, ``"split"`` or ``"merge"``
    parents : identities of the frame before that flow into it, for a merge or a split; its own first in a merge
    """

    number: int
    event: str = ""
    parents: tuple[int, ...] = ()


@dataclass
class Identities:
    """Gives the openings of successive frames numbers that stay with them; one of these per clip.

    Two openings of successive frames are the same where their bounding boxes overlap, each grown by `reach` times the
    width of the widest opening in the two frames (at least 1 px), because a thin slit may move by more than
    its own height. When openings merge the number of the largest goes on, when one splits the largest part keeps it.
    """

    reach: float = 0.05

    def __post_init__(self) -> None:
        self._known: dict[int, Opening] = {}
        self._next = 1

    def update(self, openings: list[Opening]) -> list[Identity]:
        """Identities of the openings of the next frame, in their order. Leave frames out that say nothing about
        the mouth (`no_mouth`); give an empty list where it is closed."""
        numbers = list(self._known)
        affinity = _affinity(list(self._known.values()), openings, self.reach)
        child_of, parent_of = _pair_off(affinity)
        identities: list[Identity] = []
        for child in range(len(openings)):
            if child in parent_of:
                own = parent_of[child]
                lost = [p for p in range(len(numbers)) if p not in child_of and affinity[p].argmax() == child]
                absorbed = [numbers[p] for p in lost if affinity[p, child] > 0]
                number = numbers[own]
                identities.append(Identity(number, "merge", (number, *absorbed)) if absorbed else Identity(number))
                continue
            source = affinity[:, child].argmax() if numbers else 0
            split = bool(numbers) and affinity[source, child] > 0
            identities.append(
                Identity(self._next, "split", (numbers[source],)) if split else Identity(self._next, "new")
            )
            self._next += 1
        self._known = {identity.number: opening for identity, opening in zip(identities, openings, strict=True)}
        return identities


def _pair_off(affinity: np.ndarray) -> tuple[dict[int, int], dict[int, int]]:
    """Pair parents with children one to one, strongest affinity first: child of each parent, parent of each child."""
    child_of: dict[int, int] = {}
    parent_of: dict[int, int] = {}
    for flat in np.argsort(-affinity, axis=None, kind="stable"):
        parent, child = (int(i) for i in np.unravel_index(flat, affinity.shape))
        if affinity[parent, child] <= 0:
            break
        if parent not in child_of and child not in parent_of:
            child_of[parent], parent_of[child] = child, parent
    return child_of, parent_of


def _affinity(parents: list[Opening], children: list[Opening], reach: float) -> np.ndarray:
    """(parents, children) float64: area of the smaller of the two openings, times how much of the smaller box overlaps.

    The area decides which of several parents or children goes on; the overlap keeps neighbours apart.
    """
    affinity = np.zeros((len(parents), len(children)))
    grow = max(1.0, reach * max((opening.width_px for opening in (*parents, *children)), default=0.0))
    # one or two of each: numbers one by one are faster than arrays
    for i, a in enumerate(parents):
        for j, b in enumerate(children):
            rows = min(a.row_max, b.row_max) - max(a.row_min, b.row_min) + 2 * grow
            cols = min(a.col_max, b.col_max) - max(a.col_min, b.col_min) + 2 * grow
            if rows > 0 and cols > 0:
                shared = rows * cols / min(_grown(a, grow), _grown(b, grow))
                affinity[i, j] = min(a.area_px, b.area_px) * shared
    return affinity


def _grown(opening: Opening, grow: float) -> float:
    """Area of the bounding box that is larger by `grow` on each side, px²."""
    return (opening.row_max - opening.row_min + 2 * grow) * (opening.col_max - opening.col_min + 2 * grow)
