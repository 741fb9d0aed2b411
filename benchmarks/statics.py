"""The static limit of the solver against scikit-fem: a block that settles under a load, refined.

The block slides on three planes and is squeezed and sheared by a smooth body force, so that nothing spoils the order of
convergence. scikit-fem (BSD; Gustafsson and McBain, JOSS 5, 2020) solves the same equilibrium with triquadratic
hexahedra and Newton's method; its elements, quadrature and assembly have nothing in common with the solver's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulator.curves import LoadShape
from simulator.elements import lumped_mass
from simulator.materials import NeoHookean
from simulator.mesh import block
from simulator.model import Fixed, Force, Model
from simulator.solver import solve

SIZE_M = (0.04, 0.02, 0.02)
MATERIALS = {"tissue, Poisson's ratio 0.445": NeoHookean(800, 7000), "Poisson's ratio 0.490": NeoHookean(800, 40000)}


@dataclass(frozen=True, eq=False)
class Settled:
    """Nodes at rest and their displacements (N, 3), m, and the work of the load at its displacement, J."""

    nodes: np.ndarray
    u: np.ndarray
    compliance_j: float


def body_force(X: np.ndarray) -> np.ndarray:
    """(..., 3) N/m3 at the positions X (..., 3), m."""
    x, y, z = np.moveaxis(X / SIZE_M, -1, 0)
    pattern = [np.sin(np.pi * x / 2) * (1 - y), 0.3 * np.cos(np.pi * x) * y, -x * np.sin(np.pi * z / 2)]
    return 4e4 * np.stack(pattern, axis=-1)


def settled(n: int, material: NeoHookean) -> Settled:
    """Where a damped run with 2n x n x n uniform-gradient hexahedra comes to rest."""
    nodes, elements = block((2 * n, n, n), SIZE_M)
    forces = lumped_mass(nodes, elements, np.ones(len(elements)))[:, None] * body_force(nodes)
    loads = [Fixed(np.flatnonzero(nodes[:, axis] < 1e-9), (axis,)) for axis in range(3)]
    rise = LoadShape("RAMPHOLD", 3.0)  # to 1 within 0.3 s
    loads += [Force(np.arange(len(nodes)), axis, forces[:, axis], rise) for axis in range(3)]
    model = Model(nodes, elements, materials=(material,), loads=tuple(loads), damping=60.0, duration_s=1.6)
    motion = solve(model, [1.4, 1.6], precision="float64")
    before, after = (float(np.sum(forces * u)) for u in motion.displacements)
    if motion.stopped or abs(before / after - 1) > 1e-6:
        raise RuntimeError(f"expected a block at rest after 1.6 s, got {motion.stopped or 'one that still moves'}")
    return Settled(nodes, motion.displacements[-1], after)


def equilibrium(n: int, material: NeoHookean) -> Settled:
    """The equilibrium with 2n x n x n triquadratic hexahedra of scikit-fem, at their corners."""
    from skfem import Basis, BilinearForm, ElementHex2, ElementVector, LinearForm, MeshHex, condense, solver_iter_pcg
    from skfem import solve as solve_linear
    from skfem.helpers import ddot, det, dot, inv, mul, transpose

    grids = (np.linspace(0, length, cells + 1) for length, cells in zip(SIZE_M, (2 * n, n, n), strict=True))
    mesh = MeshHex.init_tensor(*grids)
    basis = Basis(mesh, ElementVector(ElementHex2()), intorder=5)
    planes = (basis.get_dofs(lambda x, axis=axis: x[axis] < 1e-9).all(f"u^{axis + 1}") for axis in range(3))
    held = np.concatenate(list(planes))
    free = np.setdiff1d(np.arange(basis.N), held)

    @LinearForm
    def load_form(v, w):
        return dot(np.moveaxis(body_force(np.moveaxis(w.x, 0, -1)), -1, 0), v)

    load = load_form.assemble(basis)
    u = basis.zeros()
    for part in (0.5, 1.0, *[1.0] * 12):  # of the load
        F = basis.interpolate(u).grad + np.eye(3)[:, :, None, None]
        imbalance, stiffness = _linearised(material, F, ddot, det, inv, mul, transpose)
        residual = part * load - LinearForm(imbalance).assemble(basis)
        if part == 1.0 and np.abs(residual[free]).max() < 1e-9 * np.abs(load).max():
            return Settled(mesh.p.T, u[basis.nodal_dofs].T, float(load @ u))
        tangent = BilinearForm(stiffness).assemble(basis)
        solver = solver_iter_pcg(rtol=1e-6)
        u = u + solve_linear(*condense(tangent, residual, D=held), solver=solver)
    raise RuntimeError("Newton's method did not converge")


def _linearised(material: NeoHookean, F, ddot, det, inv, mul, transpose):
    """The forms P : grad v and dP[grad du] : grad v at the deformation gradients F (3, 3, elements, points)."""
    G, K = material.shear_pa, material.bulk_pa
    J, T = det(F), transpose(inv(F))
    a, tr_C = G * J ** (-2 / 3), ddot(F, F)
    P = a * (F - tr_C / 3 * T) + K * J * (J - 1) * T
    present = [None, None]  # trial function and its dP, asked for with one test function after the other

    def stiffness(du, v, w):
        if present[0] is not du:
            H = du.grad
            trace, turned = ddot(T, H), mul(T, mul(transpose(H), T))
            dP = a * (H - 2 / 3 * (trace * F + ddot(F, H) * T) + tr_C * (2 / 9 * trace * T + turned / 3))
            present[:] = du, dP + K * (2 * J**2 - J) * trace * T - K * J * (J - 1) * turned
        return ddot(present[1], v.grad)

    return lambda v, w: ddot(P, v.grad), stiffness


def common(one: Settled, other: Settled) -> tuple[np.ndarray, np.ndarray]:
    """Displacements (C, 3), m, of both at the nodes that they share."""
    at = {tuple(key): u for key, u in zip(np.rint(other.nodes * 1e7).astype(int).tolist(), other.u, strict=True)}
    keys = [tuple(key) for key in np.rint(one.nodes * 1e7).astype(int).tolist()]
    shared = [number for number, key in enumerate(keys) if key in at]
    return one.u[shared], np.array([at[keys[number]] for number in shared])


def distance(one: Settled, truth: Settled) -> float:
    """Relative L2 distance of the displacements at shared nodes."""
    u, exact = common(one, truth)
    return float(np.linalg.norm(u - exact) / np.linalg.norm(exact))
