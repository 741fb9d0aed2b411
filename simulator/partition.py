"""In which order the solver visits elements and nodes: neighbours close in memory, and parts that threads can share.

Whatever numbers a mesh comes with, hexahedra that follow one another across opposite faces are visited as rows, and the
nodes along the four edges of a row are stored in the same order, so that 8 elements at a time are read without looking
up numbers. Where rows are short, elements are visited in reverse Cuthill-McKee order and nodes stored as first touched.
A fixed number of parts, not of threads, sums the forces, so that the result does not depend on who does the work.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

from simulator.elements import row_numbers
from simulator.simd import RUN_ORDER


@dataclass(frozen=True, eq=False)
class Partition:
    """Order of visit and the division into parts.

    Parameters
    ----------
    elements : (E or more,) element numbers of the mesh in order of visit, -1 for places left empty
    nodes : (N,) node numbers of the mesh in order of storage
    element_starts : (P + 1,) part p visits elements[element_starts[p] : element_starts[p + 1]]
    node_starts : (P + 1,) even, as two records fill one register: part p advances the nodes stored between
    touched : (P, P, 2) first and one past the last stored node of part p's range that part q touches, (0, 0) if none
    """

    elements: np.ndarray
    nodes: np.ndarray
    element_starts: np.ndarray
    node_starts: np.ndarray
    touched: np.ndarray


SHORTEST_ROW = 16  # on average, for a mesh to be visited in rows
GRANULE = 8  # elements of one batch, which all follow the same law
MOST_EMPTY = 1 / 16  # of the elements, up to which each row is filled up to whole batches


def partition(elements: np.ndarray, law: np.ndarray, n_nodes: int, parts: int | None = None) -> Partition:
    """Divide a mesh of elements (E, n), of constitutive laws (E,) int, into parts of whole batches.

    `parts` None takes 1 below 400 elements, 2 below 6,000, else 4.
    """
    if parts is None:
        parts = 1 if len(elements) < 400 else 2 if len(elements) < 6000 else 4
    chains = _chains(elements) if elements.shape[1] == 8 else []
    if chains and len(elements) >= SHORTEST_ROW * len(chains):
        links = _touching(np.repeat(np.arange(len(chains)), [len(c) for c in chains]), elements[np.concatenate(chains)])
        chains = [chains[i] for i in _cuthill_mckee(links)]
        nodes = _along_edges(elements, chains)
        if np.ptp(law) == 0 and sum(-len(chain) % GRANULE for chain in chains) <= MOST_EMPTY * len(elements):
            chains = [np.append(chain, np.full(-len(chain) % GRANULE, -1)) for chain in chains]
        order = _laws_apart(np.concatenate(chains), law, GRANULE)
        order = _interleaved(order, elements)
    else:
        order = _laws_apart(_cuthill_mckee(_touching(np.arange(len(elements)), elements)), law, GRANULE)
        touches = elements[order[order >= 0]].ravel()
        nodes = touches[np.sort(np.unique(touches, return_index=True)[1])]
    stored_at = np.empty(n_nodes, np.int64)
    stored_at[nodes] = np.arange(n_nodes)

    batches = -(-len(order) // GRANULE)
    element_starts = np.minimum(GRANULE * (np.arange(parts + 1) * batches // parts), len(order))
    stored = np.where(order[:, None] >= 0, stored_at[elements[order]], -1)
    node_starts = np.zeros(parts + 1, np.int64)
    for p in range(1, parts):
        node_starts[p] = (stored[: element_starts[p]].max() + 2) // 2 * 2
    node_starts[-1] = n_nodes
    touched = np.zeros((parts, parts, 2), np.int64)
    for q in range(parts):
        mine = np.unique(stored[element_starts[q] : element_starts[q + 1]])  # starts with -1 where places are empty
        for p in range(parts):
            inside = mine[(mine >= node_starts[p]) & (mine < node_starts[p + 1])]
            if len(inside):
                touched[p, q] = inside[0], inside[-1] + 1
    return Partition(order, nodes, element_starts, node_starts, touched)


def in_batches(parts: Partition, law: np.ndarray, batch: int, count: int) -> Partition:
    """The same order in whole batches of `batch` elements of one law, the batches shared out to `count` parts.

    The nodes and what is said of them stay as they are.
    """
    order = _laws_apart(parts.elements[parts.elements >= 0], law, batch)
    batches = -(-len(order) // batch)
    starts = np.minimum(batch * (np.arange(count + 1) * batches // count), len(order))
    return replace(parts, elements=order, element_starts=starts)


def _touching(group: np.ndarray, elements: np.ndarray) -> sparse.csr_array:
    """Graph of groups of elements (E, n), numbered by group (E,), linked where they share a node."""
    n = elements.shape[1]
    incidence = sparse.csr_array(
        (np.ones(elements.size, np.int32), (np.repeat(group, n), elements.ravel())),
        shape=(group.max() + 1, elements.max() + 1),
    )
    return incidence @ incidence.T


def _cuthill_mckee(links: sparse.csr_array) -> np.ndarray:
    return reverse_cuthill_mckee(sparse.csr_matrix(links), symmetric_mode=True).astype(np.int64)


def _chains(elements: np.ndarray) -> list[np.ndarray]:
    """Rows of hexahedra (E, 8): each next one has at corners 0, 3, 4, 7 what the one before has at 1, 2, 5, 6."""
    faces = row_numbers(np.concatenate([elements[:, [0, 3, 4, 7]], elements[:, [1, 2, 5, 6]]]))
    starts, ends = faces[: len(elements)], faces[len(elements) :]
    beginning_at = np.full(len(faces), -1)
    beginning_at[starts] = np.arange(len(elements))
    following = beginning_at[ends].tolist()
    has_previous = np.isin(starts, ends)
    taken = [False] * len(elements)
    chains = []
    for first in np.argsort(has_previous, kind="stable").tolist():  # rings, which have no first element, come last
        chain = []
        e = first
        while e >= 0 and not taken[e]:
            taken[e] = True
            chain.append(e)
            e = following[e]
        if chain:
            chains.append(np.array(chain))
    return chains


def _along_edges(elements: np.ndarray, chains: list[np.ndarray]) -> np.ndarray:
    """(N,) nodes in the order in which rows touch them, each row along its four edges one after the other."""
    touched = []
    for chain in chains:
        for a, b in ((0, 1), (3, 2), (4, 5), (7, 6)):
            touched.append(elements[chain, a])
            touched.append(elements[chain[-1:], b])
    touched = np.concatenate(touched)
    return touched[np.sort(np.unique(touched, return_index=True)[1])]


def _interleaved(order: np.ndarray, elements: np.ndarray) -> np.ndarray:
    """The order with each batch whose elements follow one another turned to RUN_ORDER; empty places may come last."""
    whole = order[: len(order) // GRANULE * GRANULE].reshape(-1, GRANULE)
    next_to = (elements[whole[:, 1:]][:, :, [0, 3, 4, 7]] == elements[whole[:, :-1]][:, :, [1, 2, 5, 6]]).all(axis=2)
    follows = (next_to | (whole[:, 1:] < 0)).all(axis=1) & (whole[:, 0] >= 0)
    whole = np.where(follows[:, None], whole[:, RUN_ORDER], whole)
    return np.concatenate([whole.ravel(), order[whole.size :]])


def _laws_apart(order: np.ndarray, law: np.ndarray, batch: int) -> np.ndarray:
    """The order, grouped by law, each group but the last filled up with -1 to whole batches."""
    if np.ptp(law) == 0:
        return order
    groups = [order[law[order] == number] for number in np.unique(law)]
    filled = [np.append(group, np.full(-len(group) % batch, -1)) for group in groups[:-1]]
    return np.concatenate([*filled, groups[-1]])
