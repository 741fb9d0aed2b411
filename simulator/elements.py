"""Element geometry in the reference configuration, and the slow, plain force and energy of a whole mesh.

H8 is the 8-node hexahedron with one integration point and stiffness hourglass control, T4 the linear tetrahedron, T4ANP
the tetrahedron whose pressure is averaged at the nodes. The numpy functions here are what the compiled kernels are
tested against; they can be read beside docs/solver.md.

Sources: M. I. Leach, thesis (Sheffield, 2020), section 3.4 (with the signs of eqs 3.26, 3.28, 3.29 and 3.31 corrected);
D. P. Flanagan, T. Belytschko, IJNME 17 (1981) 679; G. R. Joldes, A. Wittek, K. Miller, CNME 25 (2009) 827;
Z. A. Taylor et al., IEEE TMI 27 (2008) 650, and NiftySim 2.5 for the conventions.
"""

from __future__ import annotations

import numpy as np

NODES_OF = {"H8": 8, "T4": 4, "T4ANP": 4}

# Natural coordinates (xi, eta, zeta) of the 8 nodes, (8, 3); shape functions N_a = prod(1 + s_a xi) / 8.
CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], dtype=float
)


def signed_volumes(nodes: np.ndarray, elements: np.ndarray) -> np.ndarray:
    """(E,) m3: exact volume of tetrahedra, and of hexahedra the volume 8 det J0 of the centre, < 0 where inverted."""
    return np.linalg.det(_centre_jacobians(nodes, elements)) * (8 if elements.shape[1] == 8 else 1 / 6)


def _centre_jacobians(nodes: np.ndarray, elements: np.ndarray) -> np.ndarray:
    """(E, 3, 3): dX_j / dxi_i at the centre."""
    X = nodes[elements]
    if elements.shape[1] == 4:
        return X[:, 1:] - X[:, :1]
    return np.einsum("ai,eaj->eij", CORNERS, X) / 8
