"""Structured meshes: blocks of hexahedra or tetrahedra, and the one-layer sheet with a slit for timing."""

from __future__ import annotations

import numpy as np

from simulator.errors import InputError

# Corners of the unit cube in the node order of H8 elements.
_CUBE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
# Tetrahedra of one hexahedron, by its local node numbers, each of positive volume. Six share the diagonal 0-6 and match
# across all faces of a block; five of one cell match only the mirrored five of its neighbours.
_SIX = np.array([[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]])
_FIVE = np.array([[0, 1, 2, 5], [0, 2, 3, 7], [0, 5, 7, 4], [2, 7, 5, 6], [0, 2, 7, 5]])
_FIVE_MIRRORED = np.array([[1, 0, 4, 3], [1, 2, 3, 6], [1, 6, 4, 5], [3, 4, 6, 7], [1, 3, 4, 6]])


def block(cells: tuple[int, int, int], size_m: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Box of hexahedra with one corner at the origin; node numbers run fastest along x, then y, then z.

    Parameters
    ----------
    cells : number of elements along x, y, z
    size_m : lengths along x, y, z, m

    Returns
    -------
    nodes : (N, 3) m
    elements : (E, 8)

    Raises
    ------
    InputError : a count below 1 or a length that is not above 0
    """
    if min(cells) < 1 or not min(size_m) > 0:
        raise InputError(f"expected cells of 1 or more and sizes above 0 m, got {cells} and {size_m}")
    counts = np.array(cells) + 1
    axes = [np.linspace(0, length, count) for length, count in zip(size_m, counts, strict=True)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    nodes = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    k, j, i = np.meshgrid(*(np.arange(n) for n in cells[::-1]), indexing="ij")
    cell = np.stack([i.ravel(), j.ravel(), k.ravel()], axis=1)
    corners = cell[:, None] + _CUBE
    return nodes, corners @ np.array([1, counts[0], counts[0] * counts[1]])


def to_tetrahedra(nodes: np.ndarray, hexahedra: np.ndarray, per_cell: int = 6) -> np.ndarray:
    """(E * per_cell, 4): each hexahedron of a block cut into 6 or 5 tetrahedra.

    Five need neighbours cut as mirror images of one another; cells are told apart by the parity of their first node's
    place in the grid, found from the sorted coordinates.
    """
    if per_cell == 6:
        return hexahedra[:, _SIX].reshape(-1, 4)
    if per_cell != 5:
        raise InputError(f"expected 5 or 6 tetrahedra per cell, got {per_cell}")
    places = [np.unique(nodes[:, axis], return_inverse=True)[1] for axis in range(3)]
    odd = sum(place[hexahedra[:, 0]] for place in places) % 2 == 1
    cut = np.where(odd[:, None, None], _FIVE_MIRRORED, _FIVE)
    return np.take_along_axis(hexahedra[:, None, :], cut, axis=2).reshape(-1, 4)


SHEET_CELLS = {852: (71, 12), 3414: (142, 24), 13680: (285, 48)}


def lip_sheet(elements: int = 3414, size_m: tuple[float, float, float] = (0.12, 0.07, 0.004)) -> tuple:
    """One layer of hexahedra like the lower face, curved forwards, with a closed slit for the mouth.

    Parameters
    ----------
    elements : 852, 3,414 (here 3,408) or 13,680, the sizes of the thesis, or near them
    size_m : width, height and thickness, m

    Returns
    -------
    nodes : (N, 3) m; x to the left of the face, y up, z forwards; the slit runs along y = 0 over the middle 45 % of the
        width, its nodes doubled
    elements : (E, 8), rows along x
    sets : name -> node numbers: "rim" (outer edge), "upper" and "lower" (the two sides of the slit)
    """
    if elements not in SHEET_CELLS:
        raise InputError(f"expected a sheet of {', '.join(map(str, SHEET_CELLS))} elements, got {elements}")
    columns, rows = SHEET_CELLS[elements]
    flat, cells = block((columns, rows, 1), (1.0, 1.0, 1.0))
    s, t, depth = 2 * flat[:, 0] - 1, 2 * flat[:, 1] - 1, flat[:, 2]
    width, height, thickness = size_m
    # Rows crowd towards the lips, and the sheet bulges forwards like the face over the teeth.
    nodes = np.stack(
        [
            width / 2 * s,
            height / 2 * (0.7 * t + 0.3 * t**3),
            thickness * depth + 0.035 * (1 - s**2) + 0.004 * np.exp(-((t / 0.3) ** 2)) * np.exp(-((s / 0.5) ** 2)),
        ],
        axis=1,
    )
    slit = np.flatnonzero((np.abs(t) < 0.1 / rows) & (np.abs(s) < 0.45))
    twin = np.full(len(nodes), -1)
    twin[slit] = len(nodes) + np.arange(len(slit))
    above = np.flatnonzero(np.arange(len(cells)) // columns >= rows // 2)
    copied = twin[cells[above]]
    cells[above] = np.where(copied >= 0, copied, cells[above])
    rim = np.flatnonzero((np.abs(s) > 1 - 1e-9) | (np.abs(t) > 1 - 1e-9))
    return np.concatenate([nodes, nodes[slit]]), cells, {"rim": rim, "lower": slit, "upper": twin[slit]}


def shuffled(
    nodes: np.ndarray, elements: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same mesh with node and element numbers in random order; also the new number of each old node (N,)."""
    order = rng.permutation(len(nodes))
    number = np.empty_like(order)
    number[order] = np.arange(len(nodes))
    return nodes[order], number[elements][rng.permutation(len(elements))], number
