"""In which order the solver visits elements and nodes: neighbours close in memory, and parts that threads can share.

Whatever numbers a mesh comes with, its elements are visited in a reverse Cuthill-McKee order and its nodes stored in the
order in which these elements first touch them. A fixed number of parts, not of threads, sums the forces, so that the
result does not depend on how many threads do the work.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee


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


GRANULE = 8  # elements of one batch, which all follow the same law


def partition(elements: np.ndarray, law: np.ndarray, n_nodes: int, parts: int | None = None) -> Partition:
    """Divide a mesh of elements (E, n), of constitutive laws (E,) int, into parts of whole batches.

    `parts` None takes 1 below 400 elements, 2 below 6,000, else 4.
    """
    if parts is None:
        parts = 1 if len(elements) < 400 else 2 if len(elements) < 6000 else 4
    order = _laws_apart(_neighbours_together(elements, n_nodes), law)
    touches = elements[order[order >= 0]].ravel()
    first_touch = np.unique(touches, return_index=True)[1]
    nodes = touches[np.sort(first_touch)]
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


def _neighbours_together(elements: np.ndarray, n_nodes: int) -> np.ndarray:
    """(E,) reverse Cuthill-McKee order of the graph whose edges are shared nodes."""
    n_elements, n = elements.shape
    incidence = sparse.csr_array(
        (np.ones(elements.size, np.int8), elements.ravel(), np.arange(n_elements + 1) * n), shape=(n_elements, n_nodes)
    )
    return reverse_cuthill_mckee(sparse.csr_matrix(incidence @ incidence.T), symmetric_mode=True).astype(np.int64)


def _laws_apart(order: np.ndarray, law: np.ndarray) -> np.ndarray:
    """The order, grouped by law, each group but the last filled up with -1 to whole batches."""
    groups = [order[law[order] == number] for number in np.unique(law)]
    filled = [np.append(group, np.full(-len(group) % GRANULE, -1)) for group in groups[:-1]]
    return np.concatenate([*filled, groups[-1]])
