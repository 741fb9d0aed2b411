"""Compiled law of the saliva between the lips: glue that breaks, decays and sticks again, and contact (docs/solver.md).

A saliva element is a thin film whose faces follow the lips; it resists being opened, squeezed and sheared, not being
stretched along the lips. Its four edges across the film are struts, each with a quarter of its area, so that the film
can open from one side and nowhere lets the lips pass through each other.

Arrays and numbers only, in float64: a film of 0.4 mm breaks at strains of a thousandth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from simulator.motion import BROKEN, INTACT, STICKING

TOUCHING = 1.0001  # mean normal stretch up to which a broken element counts as back at rest (thesis 3.5.4)
FLATTEST = 0.05  # normal stretch below which the law goes on along its tangent in the powers of J
GONE = 1e-12  # share of its force below which a broken element has none

# What an element remembers: its state, time in that state (s), share left of the frozen forces, Q, Z, moisture, then
# per strut the last force (3, N), the force at the break (3, N), and where it is at rest along the film (2).
STATE, SINCE, LEFT, Q_NOW, Z_NOW, MOISTURE_NOW, LAST = 0, 1, 2, 3, 4, 5, 6
FROZEN, OFFSET, AXES = LAST + 12, LAST + 24, LAST + 32
MEMORY = LAST + 38


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


@njit(inline="always")
def traction(J, Q, G, K):
    """Coefficients a, b of the traction a s + b n of a stretch s = J n + shear, Q = s . s, Pa.

    From psi = G/2 (J^(-2/3) (2 + Q) - 3) + K/2 (J - 1)^2, neo-Hookean with tr C = 2 + Q.
    """
    bounded = max(J, FLATTEST)
    root = bounded ** (-1.0 / 3.0)
    a = G * root * root
    return a, K * (J - 1.0) - a * (2.0 + Q) / (3.0 * bounded)


@njit
def pull_film(film, nodes, part, elapsed, dt):
    """Add the forces of one part's saliva to its nodes' internal forces; return its work over the last increment, J.

    They are the derivative of the film's energy with respect to the nodes, that of the film's own axes included, so
    that they neither turn the lips nor, while nothing breaks, make energy.

    elapsed : time since `film.moisture` was right, s
    """
    u, du, rest, own = nodes.u, nodes.du, nodes.rest, nodes.forces[part]
    fade = np.exp(-dt / film.times[0])
    ramp = film.times[1]
    work = 0.0
    middle, e = np.empty((4, 3)), np.empty((4, 3))  # twice the middles of the struts, and the struts over their lengths
    A, B, a, b, n = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    force, f_A, f_B = np.empty((4, 3)), np.empty(3), np.empty(3)
    for f in range(film.starts[part], film.starts[part + 1]):
        memory = film.memory[f]
        for k in range(4):
            low, up = film.lower[f, k], film.upper[f, k]
            for i in range(3):
                p, q = rest[low, i] + u[low, i], rest[up, i] + u[up, i]
                middle[k, i] = q + p
                e[k, i] = (q - p) / film.length[f, k]
        # Unit vectors: a along the film, n across it, b = n x a.
        for i in range(3):
            A[i] = middle[1, i] + middle[2, i] - middle[0, i] - middle[3, i]
            B[i] = middle[2, i] + middle[3, i] - middle[0, i] - middle[1, i]
        _cross(A, B, n)
        length_A = _unit(A, a)
        _unit(n, n)
        _cross(n, a, b)
        beta_a, beta_b = _dot(B, a), _dot(B, b)

        mean_J, mean_a, mean_b = 0.0, 0.0, 0.0
        for k in range(4):
            inverse = 0.25 / film.slant[f, k]
            mean_J += inverse * _dot(n, e[k])
            mean_a += inverse * (_dot(a, e[k]) - memory[OFFSET + 2 * k])
            mean_b += inverse * (_dot(b, e[k]) - memory[OFFSET + 2 * k + 1])
        Q = mean_J * mean_J + mean_a * mean_a + mean_b * mean_b
        moisture = max(0.0, film.moisture[f] - film.drying[f] * elapsed)
        Z = 1.0 if moisture > 1.0 else 1.0 + film.strength[f] * moisture

        state = int(memory[STATE])
        memory[SINCE] += dt
        if state == BROKEN:
            memory[LEFT] = memory[LEFT] * fade if memory[LEFT] > GONE else 0.0
            if Z > 1.0 and mean_J <= TOUCHING:
                state = STICKING
                memory[SINCE] = 0.0
                for k in range(4):
                    memory[OFFSET + 2 * k], memory[OFFSET + 2 * k + 1] = _dot(a, e[k]), _dot(b, e[k])
                Q = mean_J * mean_J
        elif Q >= Z:
            state = BROKEN
            memory[SINCE], memory[LEFT] = 0.0, 1.0
            for k in range(4):  # where the film is squeezed contact goes on, and glue has no force to leave
                pulled = _dot(n, memory[LAST + 3 * k : LAST + 3 * k + 3]) > 0.0
                for i in range(3 * k, 3 * k + 3):
                    memory[FROZEN + i] = memory[LAST + i] if pulled else 0.0
        elif state == STICKING and memory[SINCE] >= ramp:
            state = INTACT
        memory[STATE], memory[Q_NOW], memory[Z_NOW], memory[MOISTURE_NOW] = state, Q, Z, moisture

        share, left = 1.0, 0.0  # of the glue's force, of the frozen one
        if state == STICKING:
            share = memory[SINCE] / ramp
        elif state == BROKEN:
            share, left = 0.0, memory[LEFT]
        G, K, area = film.shear[f], film.bulk[f], film.area[f]
        tilt_a, tilt_b, spin = 0.0, 0.0, 0.0  # moments that go with the turning of the axes
        for k in range(4):
            inverse = 1.0 / film.slant[f, k]
            e_n, e_a, e_b = _dot(n, e[k]), _dot(a, e[k]), _dot(b, e[k])
            J = inverse * e_n
            across, along_a, along_b = 0.0, 0.0, 0.0
            if J < 1.0 and share < 1.0:  # contact: what the film would do without shear
                s, r = traction(J, J * J, G, K)
                across = (1.0 - share) * (s * J + r)
            if share > 0.0:
                g_a, g_b = inverse * (e_a - memory[OFFSET + 2 * k]), inverse * (e_b - memory[OFFSET + 2 * k + 1])
                s, r = traction(J, J * J + g_a * g_a + g_b * g_b, G, K)
                across += share * (s * J + r)
                along_a, along_b = share * s * g_a, share * s * g_b
            across, along_a, along_b = area * across, area * along_a, area * along_b
            arm = film.length[f, k]
            tilt_a += arm * (along_a * e_n - across * e_a)
            tilt_b += arm * (along_b * e_n - across * e_b)
            spin += arm * (along_a * e_b - along_b * e_a)
            for i in range(3):
                frozen = left * memory[FROZEN + 3 * k + i]
                force[k, i] = across * n[i] + along_a * a[i] + along_b * b[i] + frozen
        for i in range(3):
            f_A[i] = ((tilt_a - beta_a / beta_b * tilt_b) * n[i] + spin * b[i]) / length_A
            f_B[i] = tilt_b / beta_b * n[i]
        for k in range(4):
            low, up = film.lower[f, k], film.upper[f, k]
            sign_A, sign_B = -1.0 if k == 0 or k == 3 else 1.0, -1.0 if k < 2 else 1.0
            for i in range(3):
                at = LAST + 3 * k + i
                both = sign_A * f_A[i] + sign_B * f_B[i]
                before = sign_A * memory[AXES + i] + sign_B * memory[AXES + 3 + i]
                work += 0.5 * (memory[at] + force[k, i]) * (du[up, i] - du[low, i])
                work += 0.5 * (before + both) * (du[up, i] + du[low, i])
                memory[at] = force[k, i]
                own[up, i] += both + force[k, i]
                own[low, i] += both - force[k, i]
        memory[AXES : AXES + 3] = f_A
        memory[AXES + 3 : AXES + 6] = f_B
    return work


@njit(inline="always")
def _dot(p, q):
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@njit(inline="always")
def _cross(p, q, out):
    out[0], out[1], out[2] = p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]


@njit(inline="always")
def _unit(p, out):
    """Write p over its length, which is returned."""
    size = np.sqrt(_dot(p, p))
    out[0], out[1], out[2] = p[0] / size, p[1] / size, p[2] / size
    return size
