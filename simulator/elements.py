"""Element geometry in the reference configuration, and the slow, plain force and energy of a whole mesh.

H8 is the 8-node hexahedron with uniform gradient and stiffness hourglass control, T4 the linear tetrahedron, T4ANP
the tetrahedron whose pressure is averaged at the nodes. The numpy functions here are what the compiled kernels are
tested against; they can be read beside docs/solver.md.

Sources: M. I. Leach, thesis (Sheffield, 2020), section 3.4 (with the signs of eqs 3.26, 3.28, 3.29 and 3.31 corrected);
D. P. Flanagan, T. Belytschko, IJNME 17 (1981) 679; G. R. Joldes, A. Wittek, K. Miller, CNME 25 (2009) 827;
Z. A. Taylor et al., IEEE TMI 27 (2008) 650, and NiftySim 2.5 for the conventions.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

NODES_OF = {"H8": 8, "T4": 4, "T4ANP": 4}

# Natural coordinates (xi, eta, zeta) of the 8 nodes, (8, 3); shape functions N_a = prod(1 + s_a xi) / 8.
CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], dtype=float
)


# Base vectors of the hourglass modes eta zeta, xi zeta, xi eta, xi eta zeta at the nodes, (8, 4).
HOURGLASS = np.stack(
    [
        CORNERS[:, 1] * CORNERS[:, 2],
        CORNERS[:, 0] * CORNERS[:, 2],
        CORNERS[:, 0] * CORNERS[:, 1],
        CORNERS.prod(axis=1),
    ],
    axis=1,
)


def volumes(nodes: np.ndarray, elements: np.ndarray) -> np.ndarray:
    """(E,) m3: exact volume, of hexahedra that of the trilinear map; below 0 where inverted."""
    if elements.shape[1] == 4:
        return np.linalg.det(_edges(nodes, elements)) / 6
    return sum(np.linalg.det(jacobian) for _, jacobian in _gauss_points(nodes, elements))


def shape_gradients(nodes: np.ndarray, elements: np.ndarray) -> np.ndarray:
    """(E, n, 3) 1/m: B[a, j] = 1/V integral of dN_a / dX_j, the mean over the element (Flanagan and Belytschko 1981).

    With the mean, unlike the value at the centre, the forces of an affine motion balance at inner nodes of any mesh.
    """
    if elements.shape[1] == 4:
        return _TETRAHEDRON @ np.swapaxes(np.linalg.inv(_edges(nodes, elements)), 1, 2)
    integral, V = np.zeros((len(elements), 8, 3)), np.zeros(len(elements))
    for dN, jacobian in _gauss_points(nodes, elements):
        cofactors = np.cross(jacobian[:, [1, 2, 0]], jacobian[:, [2, 0, 1]])  # det times dxi_i / dX_j
        integral += dN @ cofactors
        V += np.einsum("ej,ej->e", jacobian[:, 0], cofactors[:, 0])
    return integral / V[:, None, None]


_TETRAHEDRON = np.array([[-1, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)


def _edges(nodes: np.ndarray, elements: np.ndarray) -> np.ndarray:
    """(E, 3, 3): vectors from node 0 of each tetrahedron to its nodes 1, 2, 3, dX_j / dxi_i."""
    return nodes[elements[:, 1:]] - nodes[elements[:, :1]]


def _gauss_points(nodes: np.ndarray, elements: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """dN_a/dxi_i (8, 3) and dX_j/dxi_i (E, 3, 3) at 2 x 2 x 2 points of hexahedra; each has weight 1.

    They integrate volume and mean gradients exactly: both are quadratic in each natural coordinate.
    """
    X = nodes[elements] - nodes[elements[:, :1]]  # far from the origin too, a flat element has no volume at all
    for point in CORNERS / np.sqrt(3):
        dN = hexahedron_gradients(point)
        yield dN, dN.T @ X


def hexahedron_gradients(point: np.ndarray) -> np.ndarray:
    """(8, 3): dN_a / dxi_i at natural coordinates `point` (3,)."""
    terms = 1 + CORNERS * point
    return CORNERS / 8 * np.stack([terms[:, 1] * terms[:, 2], terms[:, 0] * terms[:, 2], terms[:, 0] * terms[:, 1]], 1)


def gradient_amplitudes(B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """D and W (E, 3, 3), 1/m, of hexahedra: B_aj = s_ak D_kj + Gamma_ai W_ij with s = CORNERS, Gamma = HOURGLASS.

    B (E, 8, 3) as of `shape_gradients`. Of the hourglass shapes only the first three take part; W is 0 in
    parallelepipeds, where D = (1/8) dxi_k / dX_j.
    """
    return CORNERS.T @ B / 8, HOURGLASS[:, :3].T @ B / 8


def hourglass_vectors(B: np.ndarray, L: np.ndarray) -> np.ndarray:
    """(E, 8, 4): gamma_ai = Gamma_ai - B_aj L_ij, the modes freed of every affine displacement.

    B (E, 8, 3) as of `shape_gradients`, L (E, 4, 3) as of `hourglass_extents`.
    """
    return HOURGLASS - B @ np.swapaxes(L, 1, 2)


def hourglass_extents(nodes: np.ndarray, elements: np.ndarray) -> np.ndarray:
    """(E, 4, 3) m: L_ij = sum_b Gamma_bi X_bj, how much of each hourglass shape the element has at rest."""
    return HOURGLASS.T @ nodes[elements]


def hourglass_stiffness(B: np.ndarray, V: np.ndarray, wave_modulus_pa: np.ndarray, kappa: float) -> np.ndarray:
    """(E,) N/m: k = kappa V (lambda + 2 mu) sum B^2 / 8 with lambda + 2 mu (E,) in Pa; `kappa` is dimensionless.

    B (E, 8, 3) as of `shape_gradients`, V (E,) as of `volumes`.
    """
    return kappa * V * wave_modulus_pa * np.einsum("eaj,eaj->e", B, B) / 8


def lumped_mass(nodes: np.ndarray, elements: np.ndarray, density: np.ndarray) -> np.ndarray:
    """(N,) kg: each element of density (E,) kg/m3 gives the same share of its mass to each of its nodes."""
    return shared_out(elements, density * volumes(nodes, elements), len(nodes))


def shared_out(elements: np.ndarray, values: np.ndarray, n_nodes: int) -> np.ndarray:
    """(N,): each element gives the same share of its value (E,) to each of its nodes."""
    n = elements.shape[1]
    return np.bincount(elements.ravel(), np.repeat(values / n, n), minlength=n_nodes)


def row_numbers(rows: np.ndarray) -> np.ndarray:
    """(R,) a number for each row (R, n) of whole numbers from 0 on, the same for rows that are equal."""
    number = rows[:, 0]
    for column in rows.T[1:]:
        number = np.unique(number * (column.max(initial=0) + 1) + column, return_inverse=True)[1]
    return number


def deformation_gradients(nodes: np.ndarray, elements: np.ndarray, u: np.ndarray) -> np.ndarray:
    """(E, 3, 3): F = I + sum_a u_a B_a, for displacements u (N, 3), m."""
    return np.eye(3) + np.einsum("eai,eaj->eij", u[elements], shape_gradients(nodes, elements))


def averaged_gradients(nodes: np.ndarray, elements: np.ndarray, bulk_pa: np.ndarray, u: np.ndarray) -> np.ndarray:
    """(E, 3, 3): F~ = (J~ / J)^(1/3) F of nodally averaged pressure, with J~ = p~ / K + 1 and bulk_pa K (E,).

    The element pressure K (J - 1) is averaged, weighted by volume, over the elements at each node, and p~ is the mean
    over the four nodes (Joldes et al. 2009, eqs 6 to 12).
    """
    F = deformation_gradients(nodes, elements, u)
    J = np.linalg.det(F)
    V = volumes(nodes, elements)
    at_nodes = elements.ravel()
    pressure = np.bincount(at_nodes, np.repeat(bulk_pa * (J - 1) * V, 4)) / np.bincount(at_nodes, np.repeat(V, 4))
    J_averaged = pressure[elements].mean(axis=1) / bulk_pa + 1
    return (J_averaged / J)[:, None, None] ** (1 / 3) * F


def internal_forces(
    nodes: np.ndarray,
    elements: np.ndarray,
    element_type: str,
    materials: tuple,
    material_of: np.ndarray,
    hourglass: float,
    u: np.ndarray,
) -> np.ndarray:
    """(N, 3) N: f_a = V P B_a, and for H8 with sum_i gamma_ai k (gamma_bi u_b) added (thesis eq. 3.48)."""
    F, wave_modulus = _element_state(nodes, elements, element_type, materials, material_of, u)
    P = np.empty_like(F)
    for number, material in enumerate(materials):
        P[material_of == number] = material.stress(F[material_of == number])
    V, B = volumes(nodes, elements), shape_gradients(nodes, elements)
    f = np.einsum("e,eij,eaj->eai", V, P, B)
    if element_type == "H8":
        gamma = hourglass_vectors(B, hourglass_extents(nodes, elements))
        k = hourglass_stiffness(B, V, wave_modulus, hourglass)
        f += np.einsum("e,eai,ebi,ebj->eaj", k, gamma, gamma, u[elements])
    total = np.zeros_like(nodes)
    np.add.at(total, elements, f)
    return total


def strain_energies(
    nodes: np.ndarray,
    elements: np.ndarray,
    element_type: str,
    materials: tuple,
    material_of: np.ndarray,
    hourglass: float,
    u: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Two arrays (E,) J: V psi(F), and k/2 sum_i |gamma_bi u_b|^2 of the hourglass modes (0 for tetrahedra)."""
    F, wave_modulus = _element_state(nodes, elements, element_type, materials, material_of, u)
    psi = np.empty(len(elements))
    for number, material in enumerate(materials):
        psi[material_of == number] = material.energy(F[material_of == number])
    V = volumes(nodes, elements)
    elastic = V * psi
    if element_type != "H8":
        return elastic, np.zeros(len(elements))
    B = shape_gradients(nodes, elements)
    gamma = hourglass_vectors(B, hourglass_extents(nodes, elements))
    modes = np.einsum("ebi,ebj->eij", gamma, u[elements])
    k = hourglass_stiffness(B, V, wave_modulus, hourglass)
    return elastic, k / 2 * np.einsum("eij,eij->e", modes, modes)


def _element_state(nodes, elements, element_type, materials, material_of, u):
    if element_type == "T4ANP":
        F = averaged_gradients(nodes, elements, np.array([m.bulk_pa for m in materials])[material_of], u)
    else:
        F = deformation_gradients(nodes, elements, u)
    return F, np.array([m.wave_modulus_pa for m in materials])[material_of]
