"""The largest stable time step of a mesh, and masses scaled to raise it.

Central differences are stable up to dt = 2 / omega_max, with omega_max^2 the largest eigenvalue of M^-1 K. K is that of
the undeformed mesh, hourglass stiffness and nodal averaging included; damping by mass does not lower the limit.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from scipy import sparse
from scipy.linalg import eigh_tridiagonal

from simulator import elements as geometry
from simulator.model import Model

LANCZOS_STEPS = 24, 80  # at least, lest it settles on a smaller eigenvalue, and at most
LANCZOS_TOLERANCE = 0.01  # of the eigenvalue; the step is half as sensitive


def stable_step(model: Model, mass: np.ndarray, free: np.ndarray | None = None) -> float:
    """Largest stable time step of the undeformed mesh, s, from the assembled mesh.

    The largest eigenvalue of M^-1/2 K M^-1/2 over the free degrees of freedom comes from Lanczos iteration, with K
    applied as B^T C B, never formed. To the Ritz value, which is approached from below, its residual is added, so that
    the step errs to the small side.

    Parameters
    ----------
    mass : (N,) kg
    free : (N, 3) bool, False where a node is held or prescribed; None takes all
    """
    roots = np.repeat(1 / np.sqrt(mass), 3)
    if free is not None:
        roots = roots * free.ravel()
    if not roots.any():
        return math.inf
    stiffness = _stiffness(model)
    now = np.random.default_rng(0).standard_normal(len(roots)) * (roots > 0)
    now /= math.sqrt(_product(now, now))
    before, beta = np.zeros_like(now), 0.0
    diagonal, beside = [], []
    for step in range(min(LANCZOS_STEPS[1], np.count_nonzero(roots))):
        image = roots * stiffness(roots * now) - beta * before
        diagonal.append(_product(now, image))
        image -= diagonal[-1] * now
        beta = math.sqrt(_product(image, image))
        values, vectors = eigh_tridiagonal(np.array(diagonal), np.array(beside))
        largest = values[-1]
        residual = beta * abs(vectors[-1, -1])
        if (step + 1 >= LANCZOS_STEPS[0] and residual <= LANCZOS_TOLERANCE * largest) or beta <= 1e-12 * largest:
            break
        before, now = now, image / beta
        beside.append(beta)
    return 2 / math.sqrt(largest + residual)


def _product(one: np.ndarray, other: np.ndarray) -> float:
    """Scalar product, summed by one thread: those of a matrix library wait for one another where a core is busy."""
    return float(np.sum(one * other))


def _stiffness(model: Model):
    """Function v (3N,) -> K v of the undeformed mesh."""
    nodes, elements = model.nodes, model.elements
    shear, bulk, wave = _moduli(model)
    V, B = model.volumes, model.shape_gradients
    if model.saliva is not None:  # which limits no step: film.ease_film
        V = V.copy()
        V[model.saliva.elements] = 0.0
    averaged = _averaging(model) if model.element_type == "T4ANP" else None
    if model.element_type == "H8":
        gamma = geometry.hourglass_vectors(B, geometry.hourglass_extents(nodes, elements))
        gamma.setflags(write=False)  # as B is: compiled once for both
        k = geometry.hourglass_stiffness(B, model.volumes, wave, model.hourglass)[:, None, None]
        if model.saliva is not None:
            k[model.saliva.elements] = 0.0

    def apply(v):
        u = v.reshape(-1, 3)
        H = _gathered(elements, B, u)  # [e, j, i] = du_i / dX_j
        trace = np.einsum("eii->e", H)
        stress = H + H.transpose(0, 2, 1)
        stress *= shear[:, None, None]
        volumetric = bulk * (trace if averaged is None else averaged @ trace) - 2 / 3 * shear * trace
        np.einsum("eii->ei", stress)[:] += volumetric[:, None]
        stress *= V[:, None, None]
        f = _spread(elements, B, stress, len(nodes))
        if model.element_type == "H8":
            f += _spread(elements, gamma, k * _gathered(elements, gamma, u), len(nodes))
        return f.ravel()

    return apply


@njit(cache=True)
def _gathered(elements, weights, u):
    """(E, k, 3): [e, j, i] = sum_a weights[e, a, j] u[a, i] over the nodes a of element e; u (N, 3)."""
    n, k = weights.shape[1:]
    sums = np.empty((len(elements), k, 3))
    for e in range(len(elements)):
        for j in range(k):
            x, y, z = 0.0, 0.0, 0.0
            for a in range(n):
                node, weight = elements[e, a], weights[e, a, j]
                x += weight * u[node, 0]
                y += weight * u[node, 1]
                z += weight * u[node, 2]
            sums[e, j, 0], sums[e, j, 1], sums[e, j, 2] = x, y, z
    return sums


@njit(cache=True)
def _spread(elements, weights, values, n_nodes):
    """(N, 3): `_gathered` transposed, of values (E, k, 3)."""
    n, k = weights.shape[1:]
    sums = np.zeros((n_nodes, 3))
    for e in range(len(elements)):
        for a in range(n):
            node = elements[e, a]
            x, y, z = sums[node, 0], sums[node, 1], sums[node, 2]
            for j in range(k):
                weight = weights[e, a, j]
                x += weight * values[e, j, 0]
                y += weight * values[e, j, 1]
                z += weight * values[e, j, 2]
            sums[node, 0], sums[node, 1], sums[node, 2] = x, y, z
    return sums


def _averaging(model: Model) -> sparse.csr_array:
    """(E, E): volume change of the elements -> the mean over each one's nodes of the averages at these nodes.

    With materials of different bulk modulus it is the pressure that is averaged: K^-1 A K.
    """
    n_elements = len(model.elements)
    V = model.volumes
    bulk = _moduli(model)[1]
    incidence = sparse.csr_array(
        (np.ones(model.elements.size), model.elements.ravel(), np.arange(n_elements + 1) * 4),
        shape=(n_elements, len(model.nodes)),
    )
    at_node = incidence.T @ V
    return sparse.csr_array(
        sparse.diags_array(0.25 / bulk)
        @ incidence
        @ sparse.diags_array(1 / at_node)
        @ incidence.T
        @ sparse.diags_array(V * bulk)
    )


def element_steps(model: Model, chosen: np.ndarray | slice = slice(None)) -> np.ndarray:
    """(E,) s: stable step of each element by itself. The smallest is a lower bound of `stable_step`.

    Per element the nonzero eigenvalues of M_e^-1 K_e are those of (n/m) V C^1/2 B B^T C^1/2 (6 x 6) and of the
    hourglass stiffness (n/m) k gamma^T gamma (4 x 4), with m the element's mass.

    chosen : index of the elements asked for, E in number
    """
    elements, B, V = model.elements[chosen], model.shape_gradients[chosen], model.volumes[chosen]
    n = elements.shape[1]
    shear, bulk, wave = (values[chosen] for values in _moduli(model))
    density = np.array([material.density for material in model.materials])[model.material_of[chosen]]
    strain = np.zeros((len(elements), 6, n, 3))  # xx yy zz xy yz zx, shear strains divided by sqrt 2
    for i in range(3):
        j = (i + 1) % 3
        strain[:, i, :, i] = B[:, :, i]
        strain[:, 3 + i, :, i] = B[:, :, j] / np.sqrt(2)
        strain[:, 3 + i, :, j] = B[:, :, i] / np.sqrt(2)
    strain = strain.reshape(len(elements), 6, 3 * n)
    # C^1/2 = sqrt(2 G) (I - d) + sqrt(3 K) d, with d the projection on the volumetric strain.
    d = np.zeros((6, 6))
    d[:3, :3] = 1 / 3
    root = np.sqrt(2 * shear)[:, None, None] * (np.eye(6) - d) + np.sqrt(3 * bulk)[:, None, None] * d
    scaled = root @ strain
    stiffest = V * np.linalg.eigvalsh(scaled @ scaled.transpose(0, 2, 1))[:, -1]
    if model.element_type == "H8":
        gamma = geometry.hourglass_vectors(B, geometry.hourglass_extents(model.nodes, elements))
        k = geometry.hourglass_stiffness(B, V, wave, model.hourglass)
        stiffest = np.maximum(stiffest, k * np.linalg.eigvalsh(gamma.transpose(0, 2, 1) @ gamma)[:, -1])
    nodal_mass = density * V / n
    return 2 / np.sqrt(stiffest / nodal_mass)


def node_stiffness(model: Model, mass: np.ndarray) -> np.ndarray:
    """(N,) N/m: mass (N,), kg, times the square of the highest frequency of the tissue's elements at a node.

    Only nodes of the saliva have it, 0 the others.
    """
    at_saliva = np.zeros(len(model.nodes), bool)
    at_saliva[model.elements[model.saliva.elements]] = True
    tissue = at_saliva[model.elements].any(axis=1)
    tissue[model.saliva.elements] = False
    shortest = np.full(len(model.nodes), math.inf)
    np.minimum.at(shortest, model.elements[tissue], element_steps(model, tissue)[:, None])
    return np.where(at_saliva, mass * (2 / shortest) ** 2, 0.0)


def mass_factors(model: Model, dt_s: float) -> np.ndarray:
    """(E,) factors, 1 or more, by which the mass of each element must grow for `dt_s` (s) to be stable in it."""
    return np.maximum(1.0, (dt_s / element_steps(model)) ** 2)


def _moduli(model: Model) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shear, bulk and wave modulus of each element, (E,) Pa."""
    return tuple(
        np.array([getattr(material, name) for material in model.materials])[model.material_of]
        for name in ("shear_pa", "bulk_pa", "wave_modulus_pa")
    )
