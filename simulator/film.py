"""Compiled law of the saliva between the lips: glue that breaks, decays and sticks again, and contact (docs/solver.md).

A saliva element is a thin film whose faces follow the lips; it resists being opened, squeezed and sheared, not being
stretched along the lips. Its four edges across the film are struts, each with a quarter of its area, so that the film
can open from one side and nowhere lets the lips pass through each other.

Arrays and numbers only, in float64: a film of 0.4 mm breaks at strains of a thousandth.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from simulator.motion import BROKEN, INTACT, STICKING

TOUCHING = 1.01  # mean normal stretch up to which lips lie on each other, and a broken element sticks again
FADED = 0.01  # share of the force it broke with up to which it may
SETTLING = 5.0  # the rest of an element that sticks again follows the lips with 1 / 5 of the ramp as time constant
VISCOUS_S = 1e-4  # retardation time: the force of the film's viscosity is that of its stiffness at this age
FLATTEST = 0.05  # normal stretch below which the law goes on along its tangent in the powers of J
INERTIA = 0.5  # from 1/4 on the film limits no time step
NEAR_INERTIA = 0.1  # of the tissue's own stiffness; from 0.1 on, lips that touch and part stir up no fast waves
NEAR = 2.0  # normal stretch from which on lips do not meet within a step
GONE = 1e-12  # share of its force below which a broken element has none

# What an element remembers: its state, time in that state (s), share left of the frozen forces, Q, Z, moisture, then
# per strut the last force (3, N), the force at the break (3, N), and where it is at rest: along the film (2) and how
# far open; the last forces on the axes A and B (6), 1 where all last forces are 0, the normal, and per strut its
# stiffness (N/m), whether it has it now, and J.
STATE, SINCE, LEFT, Q_NOW, Z_NOW, MOISTURE_NOW, LAST = 0, 1, 2, 3, 4, 5, 6
FROZEN, REST, AXES = LAST + 12, LAST + 24, LAST + 36
IDLE, NORMAL, STIFF, HOLDS, STRETCH = LAST + 42, LAST + 43, LAST + 46, LAST + 50, LAST + 54
MEMORY = LAST + 58

# As in kernels.py; the two that are called from Python keep their door for it.
_whole = njit(no_cfunc_wrapper=True)
_inner = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True)
_inlined = njit(forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)


class Film(NamedTuple):
    """Saliva elements, sorted by the part that visits them.

    lower, upper : (F, 4) stored nodes at the ends of the struts, in a ring around the film whose normal
        points up
    length : (F, 4) m at rest
    slant : (F, 4) cosine between strut and normal at rest
    area : (F,) of one strut, m2
    shear, bulk : (F,) Pa
    strength, moisture, drying : (F,) K, M / Mc at the beginning of the stretch of steps, 1/s
    times : (2,) decay and ramp, s
    memory : (F, MEMORY)
    starts : (P + 1,)
    pair_lower, pair_upper : (D,) stored nodes that struts join, sorted by the part that owns the lower one
    pair_struts : numbers 4 f + k of the struts of all pairs, those of pair d from pair_first[d] (D + 1,) on
    pair_upper_part : (D,) the part that owns the upper one
    pair_tissue : (D,) inertia against moving relative to each other of ends that are near, over dt^2, N/m
    pair_memory : (D, 4) stiffness times `INERTIA` in the last step, N/m, and the force that eased it, N
    pair_starts : (P + 1,)
    divided : 1 where the ends of a pair belong to different parts
    """

    lower: np.ndarray
    upper: np.ndarray
    length: np.ndarray
    slant: np.ndarray
    area: np.ndarray
    shear: np.ndarray
    bulk: np.ndarray
    strength: np.ndarray
    moisture: np.ndarray
    drying: np.ndarray
    times: np.ndarray
    memory: np.ndarray
    starts: np.ndarray
    pair_lower: np.ndarray
    pair_upper: np.ndarray
    pair_struts: np.ndarray
    pair_first: np.ndarray
    pair_upper_part: np.ndarray
    pair_tissue: np.ndarray
    pair_memory: np.ndarray
    pair_starts: np.ndarray
    divided: int


@_inlined
def forces_of(nodes, part):
    """(M, 4) where one part adds up its forces."""
    return nodes.forces[part]


@_inlined
def traction(J, Q, G, K):
    """Coefficients a, b of the traction a s + b n of a stretch s = J n + shear, Q = s . s, Pa.

    From psi = G/2 (J^(-2/3) (2 + Q) - 3) + K/2 (J - 1)^2, neo-Hookean with tr C = 2 + Q.
    """
    bounded = max(J, FLATTEST)
    root = _inverse_cbrt(bounded)
    a = G * root * root
    return a, K * (J - 1.0) - a * (2.0 + Q) / (3.0 * bounded)


@_inlined
def _inverse_cbrt(x):
    """x^(-1/3), near 1 to a rounding error or two from its series and one step of Householder's method."""
    d = x - 1.0
    if abs(d) > 0.05:
        return x ** (-1.0 / 3.0)
    y = 1.0 + d * (-1.0 / 3.0 + d * (2.0 / 9.0))
    e = 1.0 - x * (y * y * y)
    return y + y * e * (1.0 / 3.0 + e * (2.0 / 9.0 + e * (14.0 / 81.0)))


@_whole
def pull_film(film, nodes, part, elapsed, dt):
    """Add the forces of one part's saliva to its nodes' internal forces; return its work over the last increment, J.

    They are the derivative of the film's energy with respect to the nodes, that of the film's own axes included, so
    that they neither turn the lips nor, while nothing breaks, make energy.

    elapsed : time since `film.moisture` was right, s
    """
    du, own, memory = nodes.du, forces_of(nodes, part), film.memory
    fade = math.exp(-dt / film.times[0])
    ramp = film.times[1]
    settled = 1.0 - math.exp(-SETTLING * dt / ramp)
    work = 0.0
    k_0, k_1, k_2, k_3 = np.intp(0), np.intp(1), np.intp(2), np.intp(3)  # not literals: those compile four times over
    for f in range(np.uintp(film.starts[part]), np.uintp(film.starts[part + 1])):
        middle_0, e_0 = _strut(film, nodes, f, k_0)
        middle_1, e_1 = _strut(film, nodes, f, k_1)
        middle_2, e_2 = _strut(film, nodes, f, k_2)
        middle_3, e_3 = _strut(film, nodes, f, k_3)
        # Unit vectors: a along the film, n across it, b = n x a.
        forth, back = _minus(middle_2, middle_0), _minus(middle_1, middle_3)
        A, B = _plus(forth, back), _minus(forth, back)
        n, length_A = _cross(A, B), math.sqrt(_dot(A, A))
        a, n = _times(1.0 / length_A, A), _times(1.0 / math.sqrt(_dot(n, n)), n)
        b = _cross(n, a)

        c_0, c_1 = 1.0 / film.slant[f, 0], 1.0 / film.slant[f, 1]
        c_2, c_3 = 1.0 / film.slant[f, 2], 1.0 / film.slant[f, 3]
        J_0, J_1, J_2, J_3 = c_0 * _dot(n, e_0), c_1 * _dot(n, e_1), c_2 * _dot(n, e_2), c_3 * _dot(n, e_3)
        moisture = max(0.0, film.moisture[f] - film.drying[f] * elapsed)
        Z = 1.0 if moisture > 1.0 else 1.0 + film.strength[f] * moisture

        # What sticks again is at rest where the lips lie by the time it has set.
        state, since, left = memory[f, STATE], memory[f, SINCE] + dt, memory[f, LEFT]
        if state != INTACT:
            left = left * fade if left > GONE else 0.0
            follows = settled
            if state == BROKEN and left <= FADED and Z > 1.0 and 0.25 * ((J_0 + J_1) + (J_2 + J_3)) <= TOUCHING:
                state, since, follows = STICKING, 0.0, 1.0
            if state == STICKING:
                _settle(memory, f, k_0, a, b, e_0, J_0, follows)
                _settle(memory, f, k_1, a, b, e_1, J_1, follows)
                _settle(memory, f, k_2, a, b, e_2, J_2, follows)
                _settle(memory, f, k_3, a, b, e_3, J_3, follows)

        # Stretch of the glue across the film and shear along a and b, of each strut and on average.
        a_0, b_0, glue_0 = _stretch(memory, f, k_0, c_0, a, b, e_0, J_0)
        a_1, b_1, glue_1 = _stretch(memory, f, k_1, c_1, a, b, e_1, J_1)
        a_2, b_2, glue_2 = _stretch(memory, f, k_2, c_2, a, b, e_2, J_2)
        a_3, b_3, glue_3 = _stretch(memory, f, k_3, c_3, a, b, e_3, J_3)
        mean_a, mean_b = 0.25 * ((a_0 + a_1) + (a_2 + a_3)), 0.25 * ((b_0 + b_1) + (b_2 + b_3))
        mean_glue = 0.25 * ((glue_0 + glue_1) + (glue_2 + glue_3))
        Q = mean_glue * mean_glue + mean_a * mean_a + mean_b * mean_b
        if state != BROKEN and Q >= Z:
            state, since, left = BROKEN, 0.0, 1.0
            _freeze(memory, f, n)
        elif state == STICKING and since >= ramp:
            state, left = INTACT, 0.0
        memory[f, STATE], memory[f, SINCE], memory[f, LEFT] = state, since, left
        memory[f, Q_NOW], memory[f, Z_NOW], memory[f, MOISTURE_NOW] = Q, Z, moisture

        memory[f, NORMAL], memory[f, NORMAL + 1], memory[f, NORMAL + 2] = n
        memory[f, STRETCH], memory[f, STRETCH + 1], memory[f, STRETCH + 2], memory[f, STRETCH + 3] = J_0, J_1, J_2, J_3

        share = 1.0  # of the glue's force
        if state == STICKING:
            share = since / ramp
        elif state == BROKEN:
            share = 0.0
            if left == 0.0 and memory[f, IDLE] == 1.0 and min(min(J_0, J_1), min(J_2, J_3)) >= 1.0:
                continue  # open: there was no force and there is none
        G, K, area = film.shear[f], film.bulk[f], film.area[f]
        across_0, along_0, aside_0, stiff_0 = _tractions(J_0, glue_0, a_0, b_0, share, G, K, area)
        memory[f, STIFF + 0] = stiff_0 * c_0 / film.length[f, 0]
        memory[f, HOLDS + 0] = 1.0 if share > 0.0 or J_0 < 1.0 else 0.0
        across_1, along_1, aside_1, stiff_1 = _tractions(J_1, glue_1, a_1, b_1, share, G, K, area)
        memory[f, STIFF + 1] = stiff_1 * c_1 / film.length[f, 1]
        memory[f, HOLDS + 1] = 1.0 if share > 0.0 or J_1 < 1.0 else 0.0
        across_2, along_2, aside_2, stiff_2 = _tractions(J_2, glue_2, a_2, b_2, share, G, K, area)
        memory[f, STIFF + 2] = stiff_2 * c_2 / film.length[f, 2]
        memory[f, HOLDS + 2] = 1.0 if share > 0.0 or J_2 < 1.0 else 0.0
        across_3, along_3, aside_3, stiff_3 = _tractions(J_3, glue_3, a_3, b_3, share, G, K, area)
        memory[f, STIFF + 3] = stiff_3 * c_3 / film.length[f, 3]
        memory[f, HOLDS + 3] = 1.0 if share > 0.0 or J_3 < 1.0 else 0.0
        # Moments that go with the turning of the axes.
        tilt_a_0, tilt_b_0, spin_0 = _moments(film.length[f, 0], n, a, b, e_0, across_0, along_0, aside_0)
        tilt_a_1, tilt_b_1, spin_1 = _moments(film.length[f, 1], n, a, b, e_1, across_1, along_1, aside_1)
        tilt_a_2, tilt_b_2, spin_2 = _moments(film.length[f, 2], n, a, b, e_2, across_2, along_2, aside_2)
        tilt_a_3, tilt_b_3, spin_3 = _moments(film.length[f, 3], n, a, b, e_3, across_3, along_3, aside_3)
        tilt_a, tilt_b = (tilt_a_0 + tilt_a_1) + (tilt_a_2 + tilt_a_3), (tilt_b_0 + tilt_b_1) + (tilt_b_2 + tilt_b_3)
        spin = (spin_0 + spin_1) + (spin_2 + spin_3)
        turn = tilt_b / _dot(B, b)
        f_A = _times(1.0 / length_A, _plus(_times(tilt_a - _dot(B, a) * turn, n), _times(spin, b)))
        f_B = _times(turn, n)
        # On both ends of struts 0 and 2, then of 1 and 3, whose signs differ.
        both, other = _plus(f_A, f_B), _minus(f_A, f_B)
        was_A = memory[f, AXES], memory[f, AXES + 1], memory[f, AXES + 2]
        was_B = memory[f, AXES + 3], memory[f, AXES + 4], memory[f, AXES + 5]
        mean, other_mean = _plus(both, _plus(was_A, was_B)), _plus(other, _minus(was_A, was_B))
        force_0 = _pull(memory, f, k_0, n, a, b, across_0, along_0, aside_0, left)
        force_1 = _pull(memory, f, k_1, n, a, b, across_1, along_1, aside_1, left)
        force_2 = _pull(memory, f, k_2, n, a, b, across_2, along_2, aside_2, left)
        force_3 = _pull(memory, f, k_3, n, a, b, across_3, along_3, aside_3, left)
        work += _add_forces(film, memory, own, du, f, k_0, force_0, _times(-1.0, both), _times(-1.0, mean))
        work += _add_forces(film, memory, own, du, f, k_1, force_1, other, other_mean)
        work += _add_forces(film, memory, own, du, f, k_2, force_2, both, mean)
        work += _add_forces(film, memory, own, du, f, k_3, force_3, _times(-1.0, other), _times(-1.0, other_mean))
        memory[f, AXES], memory[f, AXES + 1], memory[f, AXES + 2] = f_A
        memory[f, AXES + 3], memory[f, AXES + 4], memory[f, AXES + 5] = f_B
        memory[f, IDLE] = 1.0 if share == 0.0 and left == 0.0 and min(min(J_0, J_1), min(J_2, J_3)) >= 1.0 else 0.0
    return work


@_whole
def ease_film(film, nodes, part, keep, dt):
    """Give the two ends of stiff struts inertia against moving relative to each other; return what it takes, J.

    With M + B dt^2 k in place of the mass M, k the stiffness of the struts and B `INERTIA`, their frequency stays below
    1 / (sqrt(B) dt) whatever the step. Ends that would meet within the step share their momentum with the inertia that
    this adds, so that they neither overlap by much nor bounce; where they part it is dropped. The film's viscosity,
    `VISCOUS_S` k against the speed of the ends, makes what rings in it die out. All of them take energy, and never give
    any; all is written as equal and opposite forces on the ends, which hold the sum of all parts' forces.

    keep, dt : as in kernels.advance
    """
    du, memory, own, four = nodes.du, film.memory, forces_of(nodes, part), np.uintp(4)
    viscosity = VISCOUS_S / (INERTIA * dt)
    work = 0.0
    for d in range(np.uintp(film.pair_starts[part]), np.uintp(film.pair_starts[part + 1])):
        low, up = film.pair_lower[d], film.pair_upper[d]
        of_up = forces_of(nodes, film.pair_upper_part[d])
        added, near = 0.0, False  # of what holds or touches
        for i in range(film.pair_first[d], film.pair_first[d + np.uintp(1)]):
            f, k = film.pair_struts[i] // four, film.pair_struts[i] % four
            added += INERTIA * memory[f, np.uintp(STIFF) + k] * memory[f, np.uintp(HOLDS) + k]
            near |= memory[f, np.uintp(STRETCH) + k] < NEAR
        if added == 0.0 and near:
            moved = (
                keep * (du[up, 0] - du[low, 0]) - _pull_apart(nodes, own, of_up, low, up, np.uintp(0)),
                keep * (du[up, 1] - du[low, 1]) - _pull_apart(nodes, own, of_up, low, up, np.uintp(1)),
                keep * (du[up, 2] - du[low, 2]) - _pull_apart(nodes, own, of_up, low, up, np.uintp(2)),
            )
            for i in range(film.pair_first[d], film.pair_first[d + np.uintp(1)]):
                f, k = film.pair_struts[i] // four, film.pair_struts[i] % four
                n = memory[f, NORMAL], memory[f, NORMAL + 1], memory[f, NORMAL + 2]
                J = memory[f, np.uintp(STRETCH) + k] + _dot(n, moved) / (film.slant[f, k] * film.length[f, k])
                if J < 1.0:
                    added += INERTIA * memory[f, np.uintp(STIFF) + k]
        held = added
        if near:
            added += film.pair_tissue[d]
        before = film.pair_memory[d, 0]
        if added == 0.0 and before == 0.0:
            continue
        film.pair_memory[d, 0] = added
        for i in range(np.uintp(3)):
            compliance = _compliance(nodes, low, i) + _compliance(nodes, up, i)
            moved_i = du[up, i] - du[low, i]
            shared = moved_i
            if added > before:
                shared *= (1.0 + before * compliance) / (1.0 + added * compliance)
            # The increments' difference without and with inertia and viscosity, and the force that makes up for it.
            pull = _pull_apart(nodes, own, of_up, low, up, i)
            inertia = added * compliance
            slowed = viscosity * held * compliance
            eased = shared + ((keep - 1.0 - slowed) * shared - pull) / (1.0 + inertia + 0.5 * slowed)
            force = (keep * moved_i - pull - eased) / compliance if compliance > 0.0 else 0.0
            at = np.uintp(1) + i
            work += 0.5 * (film.pair_memory[d, at] + force) * moved_i
            film.pair_memory[d, at] = force
            own[low, i] -= force
            of_up[up, i] += force
    return work


@_inlined
def _pull_apart(nodes, of_low, of_up, low, up, axis):
    """By how much the forces on the ends of a strut shorten their difference in a step, m."""
    return _compliance(nodes, up, axis) * of_up[up, axis] - _compliance(nodes, low, axis) * of_low[low, axis]


@_inlined
def _compliance(nodes, node, axis):
    """As kernels.Nodes has it, but 0 where the displacement is prescribed."""
    c = np.float64(nodes.compliance[node, axis])
    return c if c != 1.0 else 0.0


@_inlined
def _strut(film, nodes, f, k):
    """Twice the middle of strut k of element f, m, and the strut over its length at rest."""
    u, rest, low, up = nodes.u, nodes.rest, film.lower[f, k], film.upper[f, k]
    p = rest[low, 0] + u[low, 0], rest[low, 1] + u[low, 1], rest[low, 2] + u[low, 2]
    q = rest[up, 0] + u[up, 0], rest[up, 1] + u[up, 1], rest[up, 2] + u[up, 2]
    return _plus(p, q), _times(1.0 / film.length[f, k], _minus(q, p))


@_inlined
def _settle(memory, f, k, a, b, e, J, share):
    """Let the rest of a strut follow where it lies by a share of the way; squeezed it gives way at once."""
    at = REST + 3 * k
    memory[f, at] += share * (_dot(a, e) - memory[f, at])
    memory[f, at + 1] += share * (_dot(b, e) - memory[f, at + 1])
    memory[f, at + 2] = max(0.0, min(J - 1.0, memory[f, at + 2] + share * (J - 1.0 - memory[f, at + 2])))


@_inlined
def _stretch(memory, f, k, inverse, a, b, e, J):
    """Shears and normal stretch of a strut's glue from where it is at rest."""
    at = REST + 3 * k
    return inverse * (_dot(a, e) - memory[f, at]), inverse * (_dot(b, e) - memory[f, at + 1]), J - memory[f, at + 2]


@_inner
def _freeze(memory, f, n):
    """Keep the forces at the break; where the film is squeezed contact goes on, and glue has no force to leave."""
    for k in range(4):
        at = LAST + 3 * k
        pulled = n[0] * memory[f, at] + n[1] * memory[f, at + 1] + n[2] * memory[f, at + 2] > 0.0
        for i in range(3 * k, 3 * k + 3):
            memory[f, FROZEN + i] = memory[f, LAST + i] if pulled else 0.0


@_inlined
def _tractions(J, glue, g_a, g_b, share, G, K, area):
    """Forces of a strut along n, a and b, N: its share of the glue's, and contact for the rest; and its area times the
    slope of the traction over J, N."""
    across, along, aside = 0.0, 0.0, 0.0
    y = _inverse_cbrt(min(max(J, FLATTEST), 1.0))
    stiff = K + G * (2.0 / 9.0 * y**2 + 10.0 / 9.0 * y**8)
    if J < 1.0 and share < 1.0:  # what the film would do without shear
        s, r = traction(J, J * J, G, K)
        across = (1.0 - share) * (s * J + r)
    if share > 0.0:
        s, r = traction(glue, glue * glue + g_a * g_a + g_b * g_b, G, K)
        across += share * (s * glue + r)
        along, aside = share * s * g_a, share * s * g_b
    return area * across, area * along, area * aside, area * stiff


@_inlined
def _moments(arm, n, a, b, e, across, along, aside):
    e_n, e_a, e_b = _dot(n, e), _dot(a, e), _dot(b, e)
    return arm * (along * e_n - across * e_a), arm * (aside * e_n - across * e_b), arm * (along * e_b - aside * e_a)


@_inlined
def _pull(memory, f, k, n, a, b, across, along, aside, left):
    """Force of a strut on its upper end, N, what is left of the frozen one included."""
    at = FROZEN + 3 * k
    return (
        across * n[0] + along * a[0] + aside * b[0] + left * memory[f, at],
        across * n[1] + along * a[1] + aside * b[1] + left * memory[f, at + 1],
        across * n[2] + along * a[2] + aside * b[2] + left * memory[f, at + 2],
    )


@_inlined
def _add_forces(film, memory, own, du, f, k, force, both, twice_mean):
    """Add a strut's force and what acts on both its ends, N; return the work of the means since the last step, J."""
    low, up = film.lower[f, k], film.upper[f, k]
    work = 0.0
    for i in range(np.uintp(3)):
        at = LAST + 3 * k + i
        work += (memory[f, at] + force[i]) * (du[up, i] - du[low, i]) + twice_mean[i] * (du[up, i] + du[low, i])
        memory[f, at] = force[i]
        _add_to_ends(own, f, k, low, up, i, both[i] - force[i], both[i] + force[i])
    return 0.5 * work


@_inlined
def _add_to_ends(own, f, k, low, up, axis, of_low, of_up):
    """Add one component of the forces on the ends of strut k of element f to those of their nodes."""
    own[up, axis] += of_up
    own[low, axis] += of_low


@_inlined
def _dot(p, q):
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@_inlined
def _cross(p, q):
    return p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]


@_inlined
def _plus(p, q):
    return p[0] + q[0], p[1] + q[1], p[2] + q[2]


@_inlined
def _minus(p, q):
    return p[0] - q[0], p[1] - q[1], p[2] - q[2]


@_inlined
def _times(factor, p):
    return factor * p[0], factor * p[1], factor * p[2]
