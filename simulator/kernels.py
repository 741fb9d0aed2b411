"""The compiled inner loops: element forces, nodal update, loads, and the steps that chain them.

Arrays and numbers only. Elements come in batches of as many as a register has lanes; the constants of one batch lie
together, quantity by quantity, so that a step reads them as one stream. Equations are named in docs/solver.md.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numba.extending import overload

from simulator.film import ease_film, forces_of, pull_film
from simulator.simd import (
    gather,
    inverse_cbrt,
    lanes,
    load,
    load_along,
    load_as,
    load_product_along,
    lowest,
    meet,
    poison_unless_positive,
    scatter_add,
    scatter_add_line,
    splat,
    spread,
    store,
    total,
    zero,
    zero_along,
)

NEO_HOOKEAN, ST_VENANT_KIRCHHOFF, VISCO_NEO_HOOKEAN = 0, 1, 2  # which law a batch follows

# Constants of a batch, in this order: gradient amplitudes D (9), of H8 also W (9), two stiffnesses times volume, then
#   H8: hourglass stiffness k, hourglass extents L (4 x 3);  T4ANP: 1 / bulk modulus, bulk modulus times volume.
CONSTANTS = {"H8": 9 + 9 + 2 + 1 + 12, "T4": 9 + 2, "T4ANP": 9 + 2 + 2}
HISTORY = 9  # per viscous term: 1 isochoric or 0 volumetric, two factors of the update, six stresses

# Rows of the log, one column per step.
LOG_KINETIC, LOG_DAMPING, LOG_SALIVA, LOG_EXTERNAL, LOG_LOWEST_J = range(5)
LOG_ROWS = 5

# Why `advance` came back.
DONE, INVERTED, ENERGY_GREW = range(3)

# Damping and external work so far, most external work, sums m du^2 and m du du_old, what to multiply the work of the
# next step by (1, or old over new step where it has just changed, as increments were scaled to the new), and the
# saliva's work so far.
LEDGER = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0])  # at the start
# What a part reports of a step: places in its 16 doubles, two cache lines.
STATS = 16
SQUARE, PRODUCT, LOWEST_J, WORK, GLUE = range(5)


class H8Elements(NamedTuple):
    """Batches of elements of one type, in order of visit; the last batch of a part is filled up with empty elements.

    numbers : (B * n * L,) int32, 4 times the stored node of corner a, lane l of batch b at (b n + a) L + l
    constants : (B * Q * L,) float32 or float64, in the same layout
    law : (B,) int64, law of a batch
    run : (B,) int64, 1 where the elements of a batch of 8 lie in a row: corner by corner their nodes are stored one
        after the other, in simd.RUN_ORDER, and corners 1, 2, 5, 6 one place after corners 0, 3, 4, 7
    swept : (B,) int64, 1 where all elements of a batch are a face moved along a line, as those of a sheet of even
        thickness: the third row of W and all but the third of L are 0
    history : (B * terms * HISTORY * L,) viscous stresses, m3 Pa
    terms : number of viscous terms of each element
    starts : (P + 1,) first batch of each part
    """

    numbers: np.ndarray
    constants: np.ndarray
    law: np.ndarray
    run: np.ndarray
    swept: np.ndarray
    history: np.ndarray
    terms: int
    starts: np.ndarray


class T4Elements(NamedTuple):
    """As H8Elements."""

    numbers: np.ndarray
    constants: np.ndarray
    law: np.ndarray
    run: np.ndarray
    swept: np.ndarray
    history: np.ndarray
    terms: int
    starts: np.ndarray


class T4ANPElements(NamedTuple):
    """As H8Elements."""

    numbers: np.ndarray
    constants: np.ndarray
    law: np.ndarray
    run: np.ndarray
    swept: np.ndarray
    history: np.ndarray
    terms: int
    starts: np.ndarray


class Nodes(NamedTuple):
    """Nodal records of 4 numbers, the 4th unused unless said; the last records belong to empty elements.

    The 4th of `forces` may hold anything finite, as it is multiplied by the 4th of `compliance`, 0.

    seen : (M, 4) displacement as the elements see it, m, in their precision; 4th for T4ANP: nodal pressure
    forces : (P, M, 4) sum of one part's forces, N, in the precision of the elements; 4th for T4ANP: summed pressure
    rest : (M, 4) position at rest, m
    u, du : (M, 4) displacement and its last increment, m, in the precision of the nodal sums
    compliance : (M, 4) dt2/m / (1 + alpha dt/2), s2/kg; 0 where fixed, 1 where prescribed
    mass : (M,) kg
    inverse_volume : (M,) 1/m3, one over the volume of the elements at a node, for T4ANP
    starts : (P + 1,), touched : (P, P, 2) as in partition.Partition
    """

    seen: np.ndarray
    forces: np.ndarray
    rest: np.ndarray
    u: np.ndarray
    du: np.ndarray
    compliance: np.ndarray
    mass: np.ndarray
    inverse_volume: np.ndarray
    starts: np.ndarray
    touched: np.ndarray


class Loads(NamedTuple):
    """What acts on stored degrees of freedom (4 node + axis), sorted by the part that owns the node.

    force_dof, force_n, force_curve : (F,) nodal forces; force_starts (P + 1,)
    moved_dof : (D,) prescribed; moved_starts (P + 1,); moved_terms (D + 1,) its terms in moved_m, moved_curve
    reaction : (D,) force that the constraint exerted in the last step, N
    face_nodes : (S, 4) stored nodes, -1 for the 4th of a triangle; face_pa, face_curve (S,); face_starts (P + 1,)
    face_force : (S, 3) force per node in the last step, N
    """

    force_dof: np.ndarray
    force_n: np.ndarray
    force_curve: np.ndarray
    force_starts: np.ndarray
    moved_dof: np.ndarray
    moved_m: np.ndarray
    moved_curve: np.ndarray
    moved_terms: np.ndarray
    moved_starts: np.ndarray
    reaction: np.ndarray
    face_nodes: np.ndarray
    face_pa: np.ndarray
    face_curve: np.ndarray
    face_starts: np.ndarray
    face_force: np.ndarray


# What only compiled code calls needs no door for Python, nor one for C; they took a quarter of the time to compile.
# Called from Python, such a function ends the process.
_outer = njit(cache=True, nogil=True, no_cfunc_wrapper=True)
_inner = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True)
_inlined = njit(forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)

# ---- constitutive laws on vectors -----------------------------------------------------------------------------------


@_inlined
def _cofactors(F00, F01, F02, F10, F11, F12, F20, F21, F22):
    """Cofactor matrix J F^-T."""
    return (
        F11 * F22 - F12 * F21,
        F12 * F20 - F10 * F22,
        F10 * F21 - F11 * F20,
        F02 * F21 - F01 * F22,
        F00 * F22 - F02 * F20,
        F01 * F20 - F00 * F21,
        F01 * F12 - F02 * F11,
        F02 * F10 - F00 * F12,
        F00 * F11 - F01 * F10,
    )


@_inlined
def _neo_hookean(F00, F01, F02, F10, F11, F12, F20, F21, F22, GV, KV):
    """V P = a F + b J F^-T with a = GV J^(-2/3) and b = KV (J - 1) - a tr C / (3 J); also J."""
    c00, c01, c02, c10, c11, c12, c20, c21, c22 = _cofactors(F00, F01, F02, F10, F11, F12, F20, F21, F22)
    J = F00 * c00 + F01 * c01 + F02 * c02
    tr_C = (
        (F00 * F00 + F01 * F01 + F02 * F02) + (F10 * F10 + F11 * F11 + F12 * F12) + (F20 * F20 + F21 * F21 + F22 * F22)
    )
    y = inverse_cbrt(J)
    a = GV * (y * y)
    b = KV * (J - 1.0) - a * tr_C * (y * y * y) * (1.0 / 3.0)
    return (
        a * F00 + b * c00,
        a * F01 + b * c01,
        a * F02 + b * c02,
        a * F10 + b * c10,
        a * F11 + b * c11,
        a * F12 + b * c12,
        a * F20 + b * c20,
        a * F21 + b * c21,
        a * F22 + b * c22,
        J,
    )


@_inlined
def _st_venant_kirchhoff(F00, F01, F02, F10, F11, F12, F20, F21, F22, mV, lV):
    """V P = F (lV tr(E) I + 2 mV E), with E = (F^T F - I) / 2; also J."""
    c00, c01, c02, _, _, _, _, _, _ = _cofactors(F00, F01, F02, F10, F11, F12, F20, F21, F22)
    J = F00 * c00 + F01 * c01 + F02 * c02
    E00 = 0.5 * (F00 * F00 + F10 * F10 + F20 * F20) - 0.5
    E11 = 0.5 * (F01 * F01 + F11 * F11 + F21 * F21) - 0.5
    E22 = 0.5 * (F02 * F02 + F12 * F12 + F22 * F22) - 0.5
    S01 = mV * (F00 * F01 + F10 * F11 + F20 * F21)
    S02 = mV * (F00 * F02 + F10 * F12 + F20 * F22)
    S12 = mV * (F01 * F02 + F11 * F12 + F21 * F22)
    volumetric = lV * (E00 + E11 + E22)
    S00 = volumetric + 2.0 * mV * E00
    S11 = volumetric + 2.0 * mV * E11
    S22 = volumetric + 2.0 * mV * E22
    return (
        F00 * S00 + F01 * S01 + F02 * S02,
        F00 * S01 + F01 * S11 + F02 * S12,
        F00 * S02 + F01 * S12 + F02 * S22,
        F10 * S00 + F11 * S01 + F12 * S02,
        F10 * S01 + F11 * S11 + F12 * S12,
        F10 * S02 + F11 * S12 + F12 * S22,
        F20 * S00 + F21 * S01 + F22 * S02,
        F20 * S01 + F21 * S11 + F22 * S12,
        F20 * S02 + F21 * S12 + F22 * S22,
        J,
    )


@_inner
def _visco_neo_hookean(F00, F01, F02, F10, F11, F12, F20, F21, F22, GV, KV, history, start, terms):
    """V P = F (S_iso + S_vol - sum of h), each h <- p h + q S_part first; also J. The law keeps state: `history`."""
    L = lanes(history)
    c00, c01, c02, c10, c11, c12, c20, c21, c22 = _cofactors(F00, F01, F02, F10, F11, F12, F20, F21, F22)
    J = F00 * c00 + F01 * c01 + F02 * c02
    y = inverse_cbrt(J)
    inverse_J2 = (y * y * y) * (y * y * y)
    # Inverse of C, from the cofactors of F: C^-1 = cof^T cof / J^2.
    i00 = inverse_J2 * (c00 * c00 + c10 * c10 + c20 * c20)
    i11 = inverse_J2 * (c01 * c01 + c11 * c11 + c21 * c21)
    i22 = inverse_J2 * (c02 * c02 + c12 * c12 + c22 * c22)
    i01 = inverse_J2 * (c00 * c01 + c10 * c11 + c20 * c21)
    i02 = inverse_J2 * (c00 * c02 + c10 * c12 + c20 * c22)
    i12 = inverse_J2 * (c01 * c02 + c11 * c12 + c21 * c22)
    tr_C = (
        (F00 * F00 + F01 * F01 + F02 * F02) + (F10 * F10 + F11 * F11 + F12 * F12) + (F20 * F20 + F21 * F21 + F22 * F22)
    )
    a = GV * (y * y)
    third = a * tr_C * (1.0 / 3.0)
    v = KV * J * (J - 1.0)
    S00, S11, S22 = a - third * i00 + v * i00, a - third * i11 + v * i11, a - third * i22 + v * i22
    S01, S02, S12 = (v - third) * i01, (v - third) * i02, (v - third) * i12
    for term in range(terms):
        at = start + term * HISTORY * L
        iso, p, q = load(history, at), load(history, at + L), load(history, at + 2 * L)
        one, part = iso * a, v - iso * (v + third)  # isochoric: a I - third C^-1, volumetric: v C^-1
        h00 = p * load(history, at + 3 * L) + q * (one + part * i00)
        h11 = p * load(history, at + 4 * L) + q * (one + part * i11)
        h22 = p * load(history, at + 5 * L) + q * (one + part * i22)
        h01 = p * load(history, at + 6 * L) + q * (part * i01)
        h02 = p * load(history, at + 7 * L) + q * (part * i02)
        h12 = p * load(history, at + 8 * L) + q * (part * i12)
        store(history, at + 3 * L, h00)
        store(history, at + 4 * L, h11)
        store(history, at + 5 * L, h22)
        store(history, at + 6 * L, h01)
        store(history, at + 7 * L, h02)
        store(history, at + 8 * L, h12)
        S00, S11, S22, S01, S02, S12 = S00 - h00, S11 - h11, S22 - h22, S01 - h01, S02 - h02, S12 - h12
    return (
        F00 * S00 + F01 * S01 + F02 * S02,
        F00 * S01 + F01 * S11 + F02 * S12,
        F00 * S02 + F01 * S12 + F02 * S22,
        F10 * S00 + F11 * S01 + F12 * S02,
        F10 * S01 + F11 * S11 + F12 * S12,
        F10 * S02 + F11 * S12 + F12 * S22,
        F20 * S00 + F21 * S01 + F22 * S02,
        F20 * S01 + F21 * S11 + F22 * S12,
        F20 * S02 + F21 * S12 + F22 * S22,
        J,
    )


@_inlined
def _stress(law, F00, F01, F02, F10, F11, F12, F20, F21, F22, p, q, history, start, terms):
    """V P (9 vectors) and J of the law of one batch. A law with state gets its batch's `history` from `start` on."""
    if law == NEO_HOOKEAN:
        return _neo_hookean(F00, F01, F02, F10, F11, F12, F20, F21, F22, p, q)
    if law == ST_VENANT_KIRCHHOFF:
        return _st_venant_kirchhoff(F00, F01, F02, F10, F11, F12, F20, F21, F22, p, q)
    return _visco_neo_hookean(F00, F01, F02, F10, F11, F12, F20, F21, F22, p, q, history, start, terms)


# ---- element forces -------------------------------------------------------------------------------------------------


@_inlined
def _modes(u0, u1, u2, u3, u4, u5, u6, u7):
    """Sums over the corners of u_a times xi, eta, zeta, eta zeta, xi zeta, xi eta, xi eta zeta, by butterflies."""
    a0, a1, a2, a3 = u0 + u1, u3 + u2, u4 + u5, u7 + u6
    b0, b1, b2, b3 = u1 - u0, u2 - u3, u5 - u4, u6 - u7
    c0, c1, d0, d1 = a0 + a1, a2 + a3, a1 - a0, a3 - a2
    e0, e1, g0, g1 = b0 + b1, b2 + b3, b1 - b0, b3 - b2
    return e0 + e1, d0 + d1, c1 - c0, d1 - d0, e1 - e0, g0 + g1, g1 - g0


@_inlined
def _corners(xi, eta, zeta, eta_zeta, xi_zeta, xi_eta, xi_eta_zeta):
    """The transposed map: value at each of the 8 corners of the sum of the modes with these amplitudes."""
    d0, d1 = eta - eta_zeta, eta + eta_zeta
    e0, e1 = xi - xi_zeta, xi + xi_zeta
    g0, g1 = xi_eta - xi_eta_zeta, xi_eta + xi_eta_zeta
    a0, a1, a2, a3 = -zeta - d0, d0 - zeta, zeta - d1, zeta + d1
    b0, b1, b2, b3 = e0 - g0, e0 + g0, e1 - g1, e1 + g1
    return a0 - b0, a0 + b0, a1 + b1, a1 - b1, a2 - b2, a2 + b2, a3 + b3, a3 - b3


# Vectors kept for a batch of hexahedra: 3 components x 8 corners, slopes or stresses (9), hourglass modes (12).
KEPT = 24 + 9 + 12
SLOPES, MODES = 24, 33  # where the latter two begin
GROUP = 4  # batches that go from phase to phase together


@_inner
def _h8_forces(elements, part, seen, forces, scratch):
    """Add the forces of one part's hexahedra to `forces` (M, 4); return the lowest J.

    The work is cut in phases that fit the 16 registers of most processors, with `scratch` in the first cache between
    them; a phase is done for a group of batches, so that the processor has several to work on while one waits for a
    result. The three components go through the same code one after the other.
    """
    constants, numbers = elements.constants, elements.numbers
    L = lanes(constants)
    low = splat(zero(constants), 1e30)
    end = elements.starts[part + 1]
    for first in range(elements.starts[part], end, GROUP):
        last = min(first + GROUP, end)
        for batch in range(first, last):
            n, at, run = batch * 8 * L, (batch - first) * KEPT * L, elements.run[batch]
            for corner in range(8):
                x, y, z, _ = gather(seen, numbers, n + corner * L, run)
                store(scratch, at + corner * L, x)
                store(scratch, at + (8 + corner) * L, y)
                store(scratch, at + (16 + corner) * L, z)
        for batch in range(first, last):
            q, at, swept = batch * 33 * L, (batch - first) * KEPT * L, elements.swept[batch]
            for i in range(3):
                slopes, modes = at + (SLOPES + 3 * i) * L, at + (MODES + 4 * i) * L
                _gradient_of_component(constants, q, scratch, at + 8 * i * L, slopes, modes, swept, L)
        for batch in range(first, last):
            q, h = batch * 33 * L, ((batch - first) * KEPT + SLOPES) * L
            P00, P01, P02, P10, P11, P12, P20, P21, P22, J = _stress(
                elements.law[batch],
                1.0 + load(scratch, h),
                load(scratch, h + L),
                load(scratch, h + 2 * L),
                load(scratch, h + 3 * L),
                1.0 + load(scratch, h + 4 * L),
                load(scratch, h + 5 * L),
                load(scratch, h + 6 * L),
                load(scratch, h + 7 * L),
                1.0 + load(scratch, h + 8 * L),
                load(constants, q + 18 * L),
                load(constants, q + 19 * L),
                elements.history,
                batch * elements.terms * HISTORY * L,
                elements.terms,
            )
            low = poison_unless_positive(low, J)
            store(scratch, h, P00)
            store(scratch, h + L, P01)
            store(scratch, h + 2 * L, P02)
            store(scratch, h + 3 * L, P10)
            store(scratch, h + 4 * L, P11)
            store(scratch, h + 5 * L, P12)
            store(scratch, h + 6 * L, P20)
            store(scratch, h + 7 * L, P21)
            store(scratch, h + 8 * L, P22)
        for batch in range(first, last):
            q, at, swept = batch * 33 * L, (batch - first) * KEPT * L, elements.swept[batch]
            for i in range(3):
                slopes, modes = at + (SLOPES + 3 * i) * L, at + (MODES + 4 * i) * L
                _forces_of_component(constants, q, scratch, at + 8 * i * L, slopes, modes, swept, L)
        for batch in range(first, last):
            n, at, run = batch * 8 * L, (batch - first) * KEPT * L, elements.run[batch]
            for a, b in ((0, 1), (3, 2), (4, 5), (7, 6)):
                scatter_add_line(
                    forces,
                    numbers,
                    n + a * L,
                    n + b * L,
                    run,
                    load(scratch, at + a * L),
                    load(scratch, at + (8 + a) * L),
                    load(scratch, at + (16 + a) * L),
                    load(scratch, at + b * L),
                    load(scratch, at + (8 + b) * L),
                    load(scratch, at + (16 + b) * L),
                )
    return lowest(low)


@_inlined
def _gradient_of_component(constants, q, scratch, u, slopes, modes, swept, L):
    """du/dX = s_ak D_kj + Gamma_ai W_ij and k gamma^T u of one component from its corner values, all in scratch."""
    xi, eta, zeta, eta_zeta, xi_zeta, xi_eta, xi_eta_zeta = _modes(
        load(scratch, u),
        load(scratch, u + L),
        load(scratch, u + 2 * L),
        load(scratch, u + 3 * L),
        load(scratch, u + 4 * L),
        load(scratch, u + 5 * L),
        load(scratch, u + 6 * L),
        load(scratch, u + 7 * L),
    )
    k, w, g = load(constants, q + 20 * L), q + 9 * L, q + 21 * L
    H0 = _weighted(constants, q, L, xi, eta, zeta)
    H1 = _weighted(constants, q + L, L, xi, eta, zeta)
    H2 = _weighted(constants, q + 2 * L, L, xi, eta, zeta)
    H0 = H0 + (eta_zeta * load(constants, w) + xi_zeta * load(constants, w + 3 * L))
    H1 = H1 + (eta_zeta * load(constants, w + L) + xi_zeta * load(constants, w + 4 * L))
    H2 = H2 + (eta_zeta * load(constants, w + 2 * L) + xi_zeta * load(constants, w + 5 * L))
    if not swept:
        H0 = H0 + xi_eta * load(constants, w + 6 * L)
        H1 = H1 + xi_eta * load(constants, w + 7 * L)
        H2 = H2 + xi_eta * load(constants, w + 8 * L)
        eta_zeta = _freed(constants, g, L, eta_zeta, H0, H1, H2)
        xi_zeta = _freed(constants, g + 3 * L, L, xi_zeta, H0, H1, H2)
        xi_eta_zeta = _freed(constants, g + 9 * L, L, xi_eta_zeta, H0, H1, H2)
    store(scratch, slopes, H0)
    store(scratch, slopes + L, H1)
    store(scratch, slopes + 2 * L, H2)
    store(scratch, modes, k * eta_zeta)
    store(scratch, modes + L, k * xi_zeta)
    store(scratch, modes + 2 * L, k * _freed(constants, g + 6 * L, L, xi_eta, H0, H1, H2))
    store(scratch, modes + 3 * L, k * xi_eta_zeta)


@_inlined
def _weighted(constants, column, L, a, b, c):
    """Sum of three values times one column of three rows of constants."""
    return a * load(constants, column) + b * load(constants, column + 3 * L) + c * load(constants, column + 6 * L)


@_inlined
def _freed(constants, g, L, mode, H0, H1, H2):
    """Amplitude of one hourglass mode less that of the affine motion."""
    return (mode - load(constants, g) * H0) - (load(constants, g + L) * H1 + load(constants, g + 2 * L) * H2)


@_inlined
def _forces_of_component(constants, q, scratch, f, slopes, modes, swept, L):
    """Corner forces of one component from V P and the hourglass modes': `_gradient_of_component` transposed."""
    eta_zeta, xi_zeta = load(scratch, modes), load(scratch, modes + L)
    xi_eta, xi_eta_zeta = load(scratch, modes + 2 * L), load(scratch, modes + 3 * L)
    w, g = q + 9 * L, q + 21 * L
    t0 = load(scratch, slopes) - load(constants, g + 6 * L) * xi_eta
    t1 = load(scratch, slopes + L) - load(constants, g + 7 * L) * xi_eta
    t2 = load(scratch, slopes + 2 * L) - load(constants, g + 8 * L) * xi_eta
    if not swept:
        t0 = t0 - _weighted_modes(constants, g, L, eta_zeta, xi_zeta, xi_eta_zeta)
        t1 = t1 - _weighted_modes(constants, g + L, L, eta_zeta, xi_zeta, xi_eta_zeta)
        t2 = t2 - _weighted_modes(constants, g + 2 * L, L, eta_zeta, xi_zeta, xi_eta_zeta)
        xi_eta = xi_eta + _weighted_row(constants, w + 6 * L, L, t0, t1, t2)
    eta_zeta = eta_zeta + _weighted_row(constants, w, L, t0, t1, t2)
    xi_zeta = xi_zeta + _weighted_row(constants, w + 3 * L, L, t0, t1, t2)
    xi = _weighted_row(constants, q, L, t0, t1, t2)
    eta = _weighted_row(constants, q + 3 * L, L, t0, t1, t2)
    zeta = _weighted_row(constants, q + 6 * L, L, t0, t1, t2)
    f0, f1, f2, f3, f4, f5, f6, f7 = _corners(xi, eta, zeta, eta_zeta, xi_zeta, xi_eta, xi_eta_zeta)
    store(scratch, f, f0)
    store(scratch, f + L, f1)
    store(scratch, f + 2 * L, f2)
    store(scratch, f + 3 * L, f3)
    store(scratch, f + 4 * L, f4)
    store(scratch, f + 5 * L, f5)
    store(scratch, f + 6 * L, f6)
    store(scratch, f + 7 * L, f7)


@_inlined
def _weighted_row(constants, row, L, t0, t1, t2):
    """Sum of three values times one row of constants."""
    return t0 * load(constants, row) + t1 * load(constants, row + L) + t2 * load(constants, row + 2 * L)


@_inlined
def _weighted_modes(constants, g, L, eta_zeta, xi_zeta, xi_eta_zeta):
    """What the hourglass modes but the third take from V P along one axis."""
    two = load(constants, g) * eta_zeta + load(constants, g + 3 * L) * xi_zeta
    return two + load(constants, g + 9 * L) * xi_eta_zeta


@_inlined
def _tetrahedron_gradient(seen, numbers, n, constants, q):
    """F (9 vectors) of one batch of tetrahedra, its D (9 vectors), and the mean of the nodal pressures."""
    L = lanes(constants)
    x0, y0, z0, w0 = gather(seen, numbers, n, 0)
    x1, y1, z1, w1 = gather(seen, numbers, n + L, 0)
    x2, y2, z2, w2 = gather(seen, numbers, n + 2 * L, 0)
    x3, y3, z3, w3 = gather(seen, numbers, n + 3 * L, 0)
    xa, xb, xc, ya, yb, yc, za, zb, zc = x1 - x0, x2 - x0, x3 - x0, y1 - y0, y2 - y0, y3 - y0, z1 - z0, z2 - z0, z3 - z0
    D00, D01, D02 = load(constants, q), load(constants, q + L), load(constants, q + 2 * L)
    D10, D11, D12 = load(constants, q + 3 * L), load(constants, q + 4 * L), load(constants, q + 5 * L)
    D20, D21, D22 = load(constants, q + 6 * L), load(constants, q + 7 * L), load(constants, q + 8 * L)
    return (
        1.0 + (xa * D00 + xb * D10 + xc * D20),
        xa * D01 + xb * D11 + xc * D21,
        xa * D02 + xb * D12 + xc * D22,
        ya * D00 + yb * D10 + yc * D20,
        1.0 + (ya * D01 + yb * D11 + yc * D21),
        ya * D02 + yb * D12 + yc * D22,
        za * D00 + zb * D10 + zc * D20,
        za * D01 + zb * D11 + zc * D21,
        1.0 + (za * D02 + zb * D12 + zc * D22),
        D00,
        D01,
        D02,
        D10,
        D11,
        D12,
        D20,
        D21,
        D22,
        0.25 * ((w0 + w1) + (w2 + w3)),
    )


@_inner
def _tetrahedron_pressures(elements, part, seen, forces):
    """Add K V (J - 1) of one part's tetrahedra to the 4th column of their nodes' forces; return the lowest J."""
    constants, numbers = elements.constants, elements.numbers
    L = lanes(constants)
    low = splat(zero(constants), 1e30)
    nothing = zero(constants)
    for batch in range(elements.starts[part], elements.starts[part + 1]):
        n, q = batch * 4 * L, batch * 13 * L
        F00, F01, F02, F10, F11, F12, F20, F21, F22, _, _, _, _, _, _, _, _, _, _ = _tetrahedron_gradient(
            seen, numbers, n, constants, q
        )
        c00, c01, c02, _, _, _, _, _, _ = _cofactors(F00, F01, F02, F10, F11, F12, F20, F21, F22)
        J = F00 * c00 + F01 * c01 + F02 * c02
        low = poison_unless_positive(low, J)
        w = load(constants, q + 12 * L) * (J - 1.0)
        for a in range(4):
            scatter_add(forces, numbers, n + a * L, nothing, nothing, nothing, w)
    return lowest(low)


@_inner
def _t4_forces(elements, part, seen, forces, averaged):
    """Add the forces of one part's tetrahedra to `forces` (M, 4); return the lowest J.

    `averaged` scales F to the volume ratio of the nodal pressures in the 4th column of `seen`.
    """
    constants, numbers = elements.constants, elements.numbers
    L = lanes(constants)
    low = splat(zero(constants), 1e30)
    stride = 13 if averaged else 11
    for batch in range(elements.starts[part], elements.starts[part + 1]):
        n, q = batch * 4 * L, batch * stride * L
        F00, F01, F02, F10, F11, F12, F20, F21, F22, D00, D01, D02, D10, D11, D12, D20, D21, D22, pressure = (
            _tetrahedron_gradient(seen, numbers, n, constants, q)
        )
        if averaged:
            c00, c01, c02, _, _, _, _, _, _ = _cofactors(F00, F01, F02, F10, F11, F12, F20, F21, F22)
            J = F00 * c00 + F01 * c01 + F02 * c02
            averaged_J = pressure * load(constants, q + 11 * L) + 1.0
            y = inverse_cbrt(averaged_J)
            s = averaged_J * (y * y) * inverse_cbrt(J)
            F00, F01, F02, F10, F11, F12 = s * F00, s * F01, s * F02, s * F10, s * F11, s * F12
            F20, F21, F22 = s * F20, s * F21, s * F22
        P00, P01, P02, P10, P11, P12, P20, P21, P22, J = _stress(
            elements.law[batch],
            F00,
            F01,
            F02,
            F10,
            F11,
            F12,
            F20,
            F21,
            F22,
            load(constants, q + 9 * L),
            load(constants, q + 10 * L),
            elements.history,
            batch * elements.terms * HISTORY * L,
            elements.terms,
        )
        low = poison_unless_positive(low, J)
        x1, y1, z1 = (
            P00 * D00 + P01 * D01 + P02 * D02,
            P10 * D00 + P11 * D01 + P12 * D02,
            P20 * D00 + P21 * D01 + P22 * D02,
        )
        x2, y2, z2 = (
            P00 * D10 + P01 * D11 + P02 * D12,
            P10 * D10 + P11 * D11 + P12 * D12,
            P20 * D10 + P21 * D11 + P22 * D12,
        )
        x3, y3, z3 = (
            P00 * D20 + P01 * D21 + P02 * D22,
            P10 * D20 + P11 * D21 + P12 * D22,
            P20 * D20 + P21 * D21 + P22 * D22,
        )
        w = zero(constants)
        scatter_add(forces, numbers, n, -(x1 + x2 + x3), -(y1 + y2 + y3), -(z1 + z2 + z3), w)
        scatter_add(forces, numbers, n + L, x1, y1, z1, w)
        scatter_add(forces, numbers, n + 2 * L, x2, y2, z2, w)
        scatter_add(forces, numbers, n + 3 * L, x3, y3, z3, w)
    return lowest(low)


@_inner
def _average_pressures(nodes, part):
    """Nodal pressure: the parts' sums of K V (J - 1) over the volume at the node, to the 4th column of `seen`."""
    for node in range(nodes.starts[part], nodes.starts[part + 1]):
        pressure = 0.0
        for other in range(nodes.forces.shape[0]):
            pressure += nodes.forces[other, node, 3]
            nodes.forces[other, node, 3] = 0.0
        nodes.seen[node, 3] = pressure * nodes.inverse_volume[node]


# ---- loads ----------------------------------------------------------------------------------------------------------


@_inner
def _push_faces(loads, nodes, part, curves, step):
    """Add follower pressures to one part's forces; return their work over the last increment (trapezoidal rule)."""
    work = 0.0
    own, u, du, position = forces_of(nodes, part), nodes.u, nodes.du, nodes.rest
    for s in range(loads.face_starts[part], loads.face_starts[part + 1]):
        a, b, c, d = loads.face_nodes[s, 0], loads.face_nodes[s, 1], loads.face_nodes[s, 2], loads.face_nodes[s, 3]
        n = 4 if d >= 0 else 3
        e, last = (b, d) if d >= 0 else (a, b)
        # Area vector: (c - a) x (d - b) / 2 of a quadrilateral, (c - a) x (b - a) / -2 of a triangle.
        px = (position[c, 0] + u[c, 0]) - (position[a, 0] + u[a, 0])
        py = (position[c, 1] + u[c, 1]) - (position[a, 1] + u[a, 1])
        pz = (position[c, 2] + u[c, 2]) - (position[a, 2] + u[a, 2])
        qx = (position[last, 0] + u[last, 0]) - (position[e, 0] + u[e, 0])
        qy = (position[last, 1] + u[last, 1]) - (position[e, 1] + u[e, 1])
        qz = (position[last, 2] + u[last, 2]) - (position[e, 2] + u[e, 2])
        sign = 0.5 if n == 4 else -0.5
        p = -loads.face_pa[s] * curves[loads.face_curve[s], step] * sign / n
        fx, fy, fz = p * (py * qz - pz * qy), p * (pz * qx - px * qz), p * (px * qy - py * qx)
        for i in range(n):
            node = loads.face_nodes[s, i]
            work += 0.5 * (loads.face_force[s, 0] + fx) * du[node, 0]
            work += 0.5 * (loads.face_force[s, 1] + fy) * du[node, 1]
            work += 0.5 * (loads.face_force[s, 2] + fz) * du[node, 2]
            _press_node(own, s, node, fx, fy, fz)
        loads.face_force[s, 0], loads.face_force[s, 1], loads.face_force[s, 2] = fx, fy, fz
    return work


@_inlined
def _press_node(own, s, node, fx, fy, fz):
    """Take the force of face s on one of its nodes from the internal forces."""
    own[node, 0] -= fx
    own[node, 1] -= fy
    own[node, 2] -= fz


@_inner
def _push_nodes(loads, nodes, part, curves, step):
    """Take nodal forces from one part's internal forces; return their work over the last increment."""
    own, du = forces_of(nodes, part), nodes.du
    before, now = np.uintp(step - 1), np.uintp(step)
    four = np.uintp(4)
    work = 0.0
    for i in range(np.uintp(loads.force_starts[part]), np.uintp(loads.force_starts[part + 1])):
        node, axis, curve = loads.force_dof[i] // four, loads.force_dof[i] % four, loads.force_curve[i]
        force = loads.force_n[i] * curves[curve, now]
        own[node, axis] -= force
        work += (loads.force_n[i] * curves[curve, before] + force) * du[node, axis]
    return 0.5 * work


@_inner
def _pull_nodes(nodes, part, before, now):
    """Take the weight from one part's internal forces; return the work of gravity over the last increment.

    before, now : (8,) acceleration of all nodes in the last and in this step, m/s2, each x, y, z, 0 twice
    """
    du, own = nodes.du, nodes.forces[part]
    L = lanes(du)
    g, momentum = load_as(du, now, 0), zero(du)
    for i in range(4 * nodes.starts[part], 4 * nodes.starts[part + 1], L):
        m = spread(du, du, nodes.mass, i // 4)
        momentum = momentum + m * load(du, i)
        store(own, i, load_as(du, own, i) - m * g)
    mean = 0.5 * (load_as(du, before, 0) + g)
    return total(momentum * mean)


@_inner
def _move_nodes(loads, nodes, part, curves, step, keep, damping, dt):
    """Turn the forces of prescribed degrees of freedom into what brings them to place; return the constraints' work.

    The forces are those of all parts together.
    """
    u, du, own = nodes.u, nodes.du, forces_of(nodes, part)
    first, last = np.uintp(loads.moved_starts[part]), np.uintp(loads.moved_starts[part + 1])
    following, one, four = np.uintp(step + 1), np.uintp(1), np.uintp(4)
    inertia, drag = 1.0 / (dt * dt), 0.5 * damping / dt
    work = 0.0
    for i in range(first, last):
        node, axis = loads.moved_dof[i] // four, loads.moved_dof[i] % four
        target = 0.0
        for term in range(loads.moved_terms[i], loads.moved_terms[i + one]):
            target += loads.moved_m[term] * curves[loads.moved_curve[term], following]
        old, new = du[node, axis], target - u[node, axis]
        force = own[node, axis] + nodes.mass[node] * (inertia * (new - old) + drag * (new + old))
        work += 0.5 * (loads.reaction[i] + force) * old
        loads.reaction[i] = force
        own[node, axis] = keep * old - new
    return work


# ---- nodal update ---------------------------------------------------------------------------------------------------


@_inner
def _join_forces(nodes, part):
    """Add what the other parts have put on one part's nodes to its own forces."""
    own = nodes.forces[part]
    for other in range(part + 1, nodes.forces.shape[0]):
        foreign = nodes.forces[other]
        # From an even record on, as parts begin with one: two at a time never reach into the next part.
        for i in range(nodes.touched[part, other, 0] // 2 * 8, 4 * nodes.touched[part, other, 1], lanes(own)):
            store(own, i, load(own, i) + load(foreign, i))
            store(foreign, i, zero(foreign))


@_inner
def _advance_nodes(nodes, part, keep, stats):
    """du <- keep du - compliance f, u <- u + du, f <- 0 (thesis eq. 3.55 as increments); its sums.

    keep = (1 - alpha dt/2) / (1 + alpha dt/2). Writes sum m du_new^2 and sum m du_new du_old to `stats`.
    """
    u, du, seen, compliance, mass = nodes.u, nodes.du, nodes.seen, nodes.compliance, nodes.mass
    own = nodes.forces[part]
    first, last = 4 * nodes.starts[part], 4 * nodes.starts[part + 1]
    nothing = zero_along(own, u)
    square, product = nothing, nothing
    for i in range(first, last, lanes(own)):
        old = load_along(own, du, i)
        new = keep * old - load_product_along(own, u, compliance, own, i)
        moved = load_along(own, u, i) + new
        store(du, i, new)
        store(u, i, moved)
        store(seen, i, moved)
        store(own, i, nothing)
        impulse = spread(own, u, mass, i // 4) * new
        square = square + impulse * new
        product = product + impulse * old
    stats[SQUARE], stats[PRODUCT] = total(square), total(product)


# ---- steps ----------------------------------------------------------------------------------------------------------


def element_forces(elements, nodes, part, scratch):
    """Add the internal forces of one part's elements to its nodes' forces; return the lowest J."""
    raise NotImplementedError("compiled code only")


@overload(element_forces)
def _element_forces(elements, nodes, part, scratch):
    if elements.instance_class is H8Elements:
        return lambda elements, nodes, part, scratch: _h8_forces(
            elements, part, nodes.seen, nodes.forces[part], scratch
        )
    if elements.instance_class is T4Elements:
        return lambda elements, nodes, part, scratch: _t4_forces(elements, part, nodes.seen, nodes.forces[part], False)
    return lambda elements, nodes, part, scratch: _t4_forces(elements, part, nodes.seen, nodes.forces[part], True)


def averages_pressure(elements) -> bool:
    """Whether the element forces need nodal pressures first."""
    return isinstance(elements, T4ANPElements)


@overload(averages_pressure)
def _averages_pressure(elements):
    averages = elements.instance_class is T4ANPElements
    return lambda elements: averages


def element_pressures(elements, nodes, part):
    """Add the weighted pressures of one part's elements to its nodes, where needed; return the lowest J."""
    raise NotImplementedError("compiled code only")


@overload(element_pressures)
def _element_pressures(elements, nodes, part):
    if elements.instance_class is T4ANPElements:
        return lambda elements, nodes, part: _tetrahedron_pressures(elements, part, nodes.seen, nodes.forces[part])
    return lambda elements, nodes, part: 1e30


@_outer
def internal_forces(elements, nodes):
    """Leave the sum of all parts' internal forces of the displacements `seen` in forces[0]; return the lowest J."""
    parts = nodes.forces.shape[0]
    scratch = np.empty(GROUP * KEPT * lanes(elements.constants), elements.constants.dtype)
    low = 1e30
    nodes.forces[:] = 0.0
    if averages_pressure(elements):
        for part in range(parts):
            low = min(low, element_pressures(elements, nodes, part))
        for part in range(parts):
            _average_pressures(nodes, part)
    for part in range(parts):
        low = min(low, element_forces(elements, nodes, part, scratch))
    for part in range(1, parts):
        nodes.forces[0] += nodes.forces[part]
    return low


@_inlined
def damping_loss(rescale, damping, dt, old_square, product, old_product):
    """What damping took in a step, J, from sums of m du^2 and m du du_old of this step and the last."""
    return rescale * damping / (4.0 * dt) * (2.0 * old_square + product + old_product)


@_inlined
def verdict(energy, most, low):
    """Why to stop, or DONE: more kinetic and damped energy than there can be, or the lowest J not above 0."""
    reason = DONE
    if not energy <= most:  # nor NaN
        reason = ENERGY_GREW
    if not low > 0.0:
        reason = INVERTED
    return reason


@_outer
def advance(
    elements, nodes, loads, film, curves, gravity, column, steps, thread, threads, arrived, scheme, ledger, log, stats
):
    """Do up to `steps` steps as one of `threads` threads that all call this at once; return reason and steps done.

    Parameters
    ----------
    film : film.Film, its moisture right at the first step
    curves : (curves, columns) load factors; column `column` is the present step
    gravity : (columns, 8) acceleration of all nodes, m/s2, each x, y, z, 0 twice
    arrived : (1,) int64, 0 at the start
    scheme : keep = (1 - alpha dt/2) / (1 + alpha dt/2), alpha (1/s), dt (s), energy tolerance, energy floor (J)
    ledger : running sums as LEDGER, updated
    log : (LOG_ROWS, steps) filled
    stats : (2, P, STATS) scratch
    """
    keep, damping, dt, tolerance, floor = scheme
    parts = nodes.forces.shape[0]
    first, last = thread * parts // threads, (thread + 1) * parts // threads
    lost, done_work, most, square, product = ledger[0], ledger[1], ledger[2], ledger[3], ledger[4]
    rescale, glued = ledger[5], ledger[6]
    scratch = np.empty(GROUP * KEPT * lanes(elements.constants), elements.constants.dtype)
    meeting = 0
    reason = DONE
    done = 0
    for step in range(steps):
        at = column + step
        pulled = False
        for axis in range(3):
            pulled |= gravity[at - 1, axis] != 0.0 or gravity[at, axis] != 0.0
        parity = step % 2
        for part in range(first, last):
            mine = stats[parity, part]
            mine[LOWEST_J] = 1e30
            mine[GLUE] = pull_film(film, nodes, part, step * dt, dt)
            mine[WORK] = _push_faces(loads, nodes, part, curves, at)
            if averages_pressure(elements):
                mine[LOWEST_J] = element_pressures(elements, nodes, part)
            else:
                mine[LOWEST_J] = element_forces(elements, nodes, part, scratch)
        meeting += 1
        meet(arrived, threads, meeting)
        if averages_pressure(elements):
            for part in range(first, last):
                _average_pressures(nodes, part)
            meeting += 1
            meet(arrived, threads, meeting)
            for part in range(first, last):
                mine = stats[parity, part]
                mine[LOWEST_J] = min(mine[LOWEST_J], element_forces(elements, nodes, part, scratch))
            meeting += 1
            meet(arrived, threads, meeting)
        for part in range(first, last):
            mine = stats[parity, part]
            mine[WORK] += _push_nodes(loads, nodes, part, curves, at)
            if pulled:
                mine[WORK] += _pull_nodes(nodes, part, gravity[at - 1], gravity[at])
            _join_forces(nodes, part)
        if film.divided:
            meeting += 1
            meet(arrived, threads, meeting)
        for part in range(first, last):
            stats[parity, part, GLUE] += ease_film(film, nodes, part, keep, dt)
        if film.divided:
            meeting += 1
            meet(arrived, threads, meeting)
        for part in range(first, last):
            mine = stats[parity, part]
            mine[WORK] += _move_nodes(loads, nodes, part, curves, at, keep, damping, dt)
            _advance_nodes(nodes, part, keep, mine)
        meeting += 1
        meet(arrived, threads, meeting)

        # Every thread adds up the same numbers in the same order, so all of them take the same decision.
        low, work, glue = 1e30, 0.0, 0.0
        old_square, old_product = square, product
        square, product = 0.0, 0.0
        for part in range(parts):
            mine = stats[parity, part]
            low = min(low, mine[LOWEST_J])
            work += mine[WORK]
            glue += mine[GLUE]
            square += mine[SQUARE]
            product += mine[PRODUCT]
        kinetic = product / (2.0 * dt * dt)
        lost += damping_loss(rescale, damping, dt, old_square, product, old_product)
        done_work += rescale * work
        glued += rescale * glue
        rescale = 1.0
        most = max(most, done_work)
        if thread == 0:
            log[LOG_KINETIC, step], log[LOG_DAMPING, step] = kinetic, lost
            log[LOG_EXTERNAL, step], log[LOG_LOWEST_J, step] = done_work, low
            log[LOG_SALIVA, step] = glued
        done += 1
        reason = verdict(kinetic + lost, tolerance * most + floor, low)
        if reason != DONE:
            break
    if thread == 0:
        ledger[0], ledger[1], ledger[2], ledger[3], ledger[4] = lost, done_work, most, square, product
        ledger[5], ledger[6] = rescale, glued
    return reason, done


# ---- once per saved state -------------------------------------------------------------------------------------------


@_inlined
def _gradient(elements, e, D, W, u, F, modes):
    """Fill F (3, 3) of one element, and for hexahedra rows 3 to 6 of modes (7, 3), its hourglass shapes' amplitudes."""
    for i in range(3):
        if elements.shape[1] == 8:
            modes[0, i], modes[1, i], modes[2, i], modes[3, i], modes[4, i], modes[5, i], modes[6, i] = _modes(
                u[elements[e, 0], i],
                u[elements[e, 1], i],
                u[elements[e, 2], i],
                u[elements[e, 3], i],
                u[elements[e, 4], i],
                u[elements[e, 5], i],
                u[elements[e, 6], i],
                u[elements[e, 7], i],
            )
        else:
            for k in range(3):
                modes[k, i] = u[elements[e, k + 1], i] - u[elements[e, 0], i]
    for i in range(3):
        for j in range(3):
            F[i, j] = 1.0 if i == j else 0.0
            for k in range(3):
                F[i, j] += modes[k, i] * D[e, k, j]
                if len(W) > 0:
                    F[i, j] += modes[3 + k, i] * W[e, k, j]
    return F[0, 0], F[0, 1], F[0, 2], F[1, 0], F[1, 1], F[1, 2], F[2, 0], F[2, 1], F[2, 2]


@_outer
def strain_energies(elements, D, W, GV, KV, law, k, L, u):
    """Elastic and hourglass energy of a mesh, J: sum of V psi(F) and of k/2 |gamma^T u|^2.

    elements (E, n), D (E, 3, 3), GV, KV (E,) stiffness times volume, law (E,), W (E, 3, 3), k (E,) and L (E, 4, 3) of
    hexahedra, u (N, 3) m; u[n] belongs to node n of `elements`.
    """
    elastic, hourglass = 0.0, 0.0
    F, modes = np.zeros((3, 3)), np.zeros((7, 3))
    for e in range(len(elements)):
        F00, F01, F02, F10, F11, F12, F20, F21, F22 = _gradient(elements, e, D, W, u, F, modes)
        c00, c01, c02, _, _, _, _, _, _ = _cofactors(F00, F01, F02, F10, F11, F12, F20, F21, F22)
        J = F00 * c00 + F01 * c01 + F02 * c02
        C00 = F00 * F00 + F10 * F10 + F20 * F20
        C11 = F01 * F01 + F11 * F11 + F21 * F21
        C22 = F02 * F02 + F12 * F12 + F22 * F22
        if law[e] == ST_VENANT_KIRCHHOFF:
            C01 = F00 * F01 + F10 * F11 + F20 * F21
            C02 = F00 * F02 + F10 * F12 + F20 * F22
            C12 = F01 * F02 + F11 * F12 + F21 * F22
            squares = 0.25 * ((C00 - 1.0) ** 2 + (C11 - 1.0) ** 2 + (C22 - 1.0) ** 2) + 0.5 * (C01**2 + C02**2 + C12**2)
            elastic += 0.125 * KV[e] * (C00 + C11 + C22 - 3.0) ** 2 + GV[e] * squares
        else:
            isochoric = abs(J) ** (-2.0 / 3.0) * (C00 + C11 + C22) - 3.0
            elastic += 0.5 * GV[e] * isochoric + 0.5 * KV[e] * (J - 1.0) ** 2
        if len(k) > 0:
            for mode in range(4):
                for i in range(3):
                    q = modes[3 + mode, i]
                    for axis in range(3):
                        q -= L[e, mode, axis] * (F[i, axis] - (1.0 if i == axis else 0.0))
                    hourglass += 0.5 * k[e] * q * q
    return elastic, hourglass


@_outer
def largest_area_stretch(elements, D, W, u):
    """Largest singular value of the cofactor matrix J F^-T over all elements, 1 at rest.

    It is the most that any element has grown in area; its square bounds how much stiffer the pressure part of an
    element has become along the direction in which it is squeezed. Arguments as in `strain_energies`.
    """
    most = 1.0
    F, modes = np.zeros((3, 3)), np.zeros((7, 3))
    for e in range(len(elements)):
        F00, F01, F02, F10, F11, F12, F20, F21, F22 = _gradient(elements, e, D, W, u, F, modes)
        c00, c01, c02, c10, c11, c12, c20, c21, c22 = _cofactors(F00, F01, F02, F10, F11, F12, F20, F21, F22)
        # Largest eigenvalue of the symmetric 3 x 3 matrix cof cof^T, by the trigonometric formula.
        a00 = c00 * c00 + c01 * c01 + c02 * c02
        a11 = c10 * c10 + c11 * c11 + c12 * c12
        a22 = c20 * c20 + c21 * c21 + c22 * c22
        a01 = c00 * c10 + c01 * c11 + c02 * c12
        a02 = c00 * c20 + c01 * c21 + c02 * c22
        a12 = c10 * c20 + c11 * c21 + c12 * c22
        mean = (a00 + a11 + a22) / 3.0
        b00, b11, b22 = a00 - mean, a11 - mean, a22 - mean
        spread = np.sqrt((b00 * b00 + b11 * b11 + b22 * b22 + 2.0 * (a01 * a01 + a02 * a02 + a12 * a12)) / 6.0)
        if spread > 0.0 and mean + 2.0 * spread > most:  # else it cannot be the largest
            det = b00 * (b11 * b22 - a12 * a12) - a01 * (a01 * b22 - a12 * a02) + a02 * (a01 * a12 - b11 * a02)
            half = min(max(det / (2.0 * spread**3), -1.0), 1.0)
            mean += 2.0 * spread * np.cos(np.arccos(half) / 3.0)
        most = max(most, mean)
    return np.sqrt(most)
