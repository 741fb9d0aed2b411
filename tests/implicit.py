"""Independent slow statics: trilinear hexahedra with 2 x 2 x 2 Gauss points and the neo-Hookean law, Newton's method.

Shares nothing with the solver but the formula of the strain energy: stress and stiffness come from it by their own
algebra, integration is full, time does not exist.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

NATURAL = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1.0]]
)


def equilibrium(nodes, elements, shear_pa, bulk_pa, forces, fixed, tolerance=1e-10):
    """Displacement (N, 3), m, under dead nodal forces (N, 3), N, with `fixed` (N, 3) bool held at 0."""
    gradients, weights = _gauss_points(nodes, elements)
    u = np.zeros_like(nodes)
    free = np.flatnonzero(~fixed.ravel())
    dofs = (3 * elements[:, :, None] + np.arange(3)).reshape(len(elements), 24)
    rows, columns = np.repeat(dofs, 24, axis=1).ravel(), np.tile(dofs, (1, 24)).ravel()
    for _ in range(30):
        residual = forces.copy()
        K = np.zeros((len(elements), 24, 24))
        for B, w in zip(gradients, weights, strict=True):
            F = np.eye(3) + np.einsum("eai,eaj->eij", u[elements], B)
            P, A = _stress_and_stiffness(F, shear_pa, bulk_pa)
            np.add.at(residual, elements, -np.einsum("e,eij,eaj->eai", w, P, B))
            K += np.einsum("e,eaj,eijkl,ebl->eaibk", w, B, A, B, optimize=True).reshape(-1, 24, 24)
        norm = np.abs(residual.ravel()[free]).max()
        if norm < tolerance * np.abs(forces).max():
            return u
        stiffness = sparse.csr_array((K.ravel(), (rows, columns)), shape=(u.size, u.size))[free][:, free]
        step = np.zeros(u.size)
        step[free] = spsolve(stiffness.tocsc(), residual.ravel()[free])
        u += step.reshape(-1, 3)
    raise AssertionError("Newton's method did not converge")


def _gauss_points(nodes, elements):
    gradients, weights = [], []
    for point in NATURAL / np.sqrt(3):
        one = 1 + NATURAL * point
        dN = NATURAL / 8 * np.stack([one[:, 1] * one[:, 2], one[:, 0] * one[:, 2], one[:, 0] * one[:, 1]], axis=1)
        jacobian = np.einsum("ai,eaj->eij", dN, nodes[elements])
        gradients.append(np.einsum("eji,ai->eaj", np.linalg.inv(jacobian), dN))
        weights.append(np.linalg.det(jacobian))
    return gradients, weights


def _stress_and_stiffness(F, G, K):
    """P = dpsi/dF and A = dP/dF, with T = F^-T: dT_ij/dF_kl = -T_il T_kj and dJ/dF = J T."""
    J = np.linalg.det(F)
    T = np.swapaxes(np.linalg.inv(F), 1, 2)
    I1 = np.einsum("eij,eij->e", F, F)
    a = G * J ** (-2 / 3)
    P = a[:, None, None] * (F - I1[:, None, None] / 3 * T) + (K * J * (J - 1))[:, None, None] * T
    TT = np.einsum("eij,ekl->eijkl", T, T)
    swapped = np.einsum("eil,ekj->eijkl", T, T)
    FT = np.einsum("eij,ekl->eijkl", F, T) + np.einsum("eij,ekl->eijkl", T, F)
    identity = np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))

    def scaled(factor, tensor):
        return factor[:, None, None, None, None] * tensor

    A = scaled(a, identity - 2 / 3 * FT) + scaled(a * I1 * 2 / 9, TT) + scaled(a * I1 / 3, swapped)
    A += scaled(K * (2 * J**2 - J), TT) - scaled(K * J * (J - 1), swapped)
    return P, A
