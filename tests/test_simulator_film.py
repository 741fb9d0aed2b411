"""The saliva's law: forces against a slow energy, breaking, decay, sticking again, contact."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from glued_blocks import FILM_M, GLUE, HEIGHT_M, glued_blocks
from scipy.spatial.transform import Rotation

from simulator import assembly, film
from simulator.curves import KeyFrames
from simulator.motion import BROKEN, INTACT, STICKING
from simulator.partition import partition
from simulator.solver import solve

DT = 1e-5


@pytest.fixture
def rng():
    return np.random.default_rng(0)


OPENING = KeyFrames((0.0, 0.05), (0.0, 1.0), ("linear",))


@pytest.fixture
def lips():
    """The film of two blocks as the kernels have it, and a function from displacements (N, 3) to forces (N, 3)."""
    model = glued_blocks(OPENING, strength=1e9, columns=3)
    parts = partition(model.elements, assembly.laws(model), len(model.nodes), 1)
    nodes = assembly.node_arrays(model, parts, "float64", DT, assembly.masses(model))
    arrays, _ = assembly.film_arrays(model, parts)
    count = len(model.nodes)

    def forces(u, state=INTACT, steps=1, moved=None, dt=DT):
        arrays.memory[:, film.STATE] = state
        nodes.u[:count, :3] = u
        nodes.du[:count, :3] = 0 if moved is None else moved
        for _ in range(steps):
            nodes.forces[:] = 0
            forces.work = film.pull_film(arrays, nodes, 0, 0.0, dt)
        return nodes.forces[0, :count, :3].copy()

    forces.rest = nodes.rest[:count, :3]
    forces.nodes = nodes
    forces.held = np.union1d(arrays.lower, arrays.upper)
    return arrays, forces


def energy(arrays, x) -> float:
    """Sum of V psi over the struts, slowly; psi = G/2 (J^(-2/3) (2 + Q) - 3) + K/2 (J - 1)^2."""
    total = 0.0
    for f in range(len(arrays.area)):
        low, up = x[arrays.lower[f]], x[arrays.upper[f]]
        strut, middle = (up - low) / arrays.length[f][:, None], (low + up) / 2
        a, b = middle[[1, 2]].sum(0) - middle[[0, 3]].sum(0), middle[[2, 3]].sum(0) - middle[[0, 1]].sum(0)
        n = np.cross(a, b) / np.linalg.norm(np.cross(a, b))
        a = a / np.linalg.norm(a)
        b = np.cross(n, a)
        slip = arrays.memory[f, film.REST : film.AXES].reshape(4, 3)
        c = arrays.slant[f]
        J, s, t = strut @ n / c, (strut @ a - slip[:, 0]) / c, (strut @ b - slip[:, 1]) / c
        G, K = arrays.shear[f], arrays.bulk[f]
        psi = G / 2 * (J ** (-2 / 3) * (2 + J**2 + s**2 + t**2) - 3) + K / 2 * (J - 1) ** 2
        total += (arrays.area[f] * arrays.length[f] * c * psi).sum()
    return total


def random_motion(forces, rng, size_m=5e-5):
    u = np.zeros_like(forces.rest)
    u[forces.held] = rng.normal(0, size_m, (len(forces.held), 3))
    return u


def test_forces_are_the_derivative_of_the_energy(lips, rng):
    arrays, forces = lips
    u, direction = random_motion(forces, rng), random_motion(forces, rng, 1.0)
    f, h = forces(u), 1e-9
    slope = (energy(arrays, forces.rest + u + h * direction) - energy(arrays, forces.rest + u - h * direction)) / (
        2 * h
    )
    assert (f * direction).sum() == pytest.approx(slope, rel=1e-6)
    assert np.abs(f).max() > 1e-3


def test_no_force_at_rest_or_when_turned(lips):
    _, forces = lips
    assert np.abs(forces(np.zeros_like(forces.rest))).max() < 1e-14
    turned = Rotation.from_euler("xyz", [40, -25, 70], degrees=True).apply(forces.rest) + np.array([0.1, 0.2, 0.3])
    assert np.abs(forces(turned - forces.rest)).max() < 1e-9  # of 0.2 N at 5 % strain


def test_forces_neither_push_nor_turn_the_whole(lips, rng):
    _, forces = lips
    u = random_motion(forces, rng)
    f = forces(u)
    assert np.abs(f.sum(axis=0)).max() < 1e-12 * np.abs(f).max()
    assert np.abs(np.cross(forces.rest + u, f).sum(axis=0)).max() < 1e-9 * np.abs(f).max()


def test_contact_pushes_but_neither_pulls_nor_rubs(lips):
    arrays, forces = lips
    arrays.strength[:] = 0
    u = np.zeros_like(forces.rest)
    above = forces.rest[:, 1] > HEIGHT_M + FILM_M / 2
    u[above] = [1e-5, -2e-5, 0]
    f = forces(u, BROKEN)
    J = 1 - 2e-5 / FILM_M
    pressure = GLUE.stress(np.diag([1.0, J, 1.0]))[1, 1]  # uniaxial strain
    area = 0.003 * 0.003
    assert f[above][:, 1].sum() == pytest.approx(pressure * area, rel=1e-9)
    assert np.abs(f[above].sum(axis=0)[[0, 2]]).max() < 1e-12
    u[above] = [1e-5, 2e-5, 0]
    assert not forces(u, BROKEN).any()


def test_it_breaks_when_the_squared_stretch_reaches_the_critical_value(lips):
    arrays, forces = lips
    arrays.strength[:] = 0.01
    u = np.zeros_like(forces.rest)
    above = forces.rest[:, 1] > HEIGHT_M + FILM_M / 2
    for factor, state in ((0.999, INTACT), (1.001, BROKEN)):
        u[above, 1] = FILM_M * (np.sqrt(1 + 0.01 * factor) - 1)
        arrays.memory[:, film.STATE] = INTACT
        forces(u)
        assert (arrays.memory[:, film.STATE] == state).all()


@pytest.mark.parametrize("dt", [1e-5, 4e-5])
def test_the_force_decays_with_its_time_constant_whatever_the_step(lips, dt):
    arrays, forces = lips
    arrays.strength[:] = 0.01
    arrays.times[0] = 0.002
    u = np.zeros_like(forces.rest)
    above = forces.rest[:, 1] > HEIGHT_M + FILM_M / 2
    u[above, 1] = FILM_M * 0.004
    before = np.abs(forces(u)).max()
    u[above, 1] = FILM_M * 0.01
    after = np.abs(forces(u)).max()
    assert after == pytest.approx(before, rel=1e-9)  # the force at the break is that of before
    steps = round(0.002 / dt)
    later = forces(u, BROKEN, steps, dt=dt)
    assert np.abs(later).max() == pytest.approx(before / np.e, rel=1e-6)


def test_it_sticks_again_where_the_lips_lie_and_its_force_comes_back_over_the_ramp(lips):
    arrays, forces = lips
    arrays.strength[:] = 0.01
    u = np.zeros_like(forces.rest)
    above = forces.rest[:, 1] > HEIGHT_M + FILM_M / 2
    u[above] = [5e-5, 0.0, 0.0]  # slid along by an eighth of the film
    assert np.abs(forces(u, BROKEN)).max() < 1e-12
    assert (arrays.memory[:, film.STATE] == STICKING).all()
    opened = u.copy()
    opened[above, 1] = FILM_M * 0.002
    share, steps = [], round(arrays.times[1] / DT)
    for _ in range(2):  # a quarter of the ramp at rest but for its last step
        forces(u, STICKING, steps // 4 - 1)
        share.append(np.abs(forces(opened, STICKING)).max())
    full = np.abs(forces(opened, INTACT)).max()
    assert np.array(share) / full == pytest.approx([0.25, 0.5], rel=0.01)


def test_what_sticks_again_is_at_rest_where_the_lips_lie_when_it_has_set(lips):
    arrays, forces = lips
    arrays.strength[:] = 0.05
    u = np.zeros_like(forces.rest)
    above = forces.rest[:, 1] > HEIGHT_M + FILM_M / 2
    steps = round(arrays.times[1] / DT)
    state = BROKEN
    for i in range(steps // 10):  # they still move while it sets: along the film, and towards each other
        u[above] = [1e-7 * i, FILM_M * (0.009 - 1e-5 * i), 0.0]
        forces(u, state)
        state = STICKING
    forces(u, STICKING, steps)  # then lie, still apart
    lying = np.abs(forces(u, INTACT)).max()
    u[above, 1] += FILM_M * 0.001
    pulled = np.abs(forces(u, INTACT)).max()
    assert lying < 0.01 * pulled
    assert arrays.memory[:, film.Q_NOW] == pytest.approx(1.001**2, rel=1e-5)


def test_what_sets_gives_way_to_lips_that_come_closer(lips):
    arrays, forces = lips
    arrays.strength[:] = 0.05
    u = np.zeros_like(forces.rest)
    above = forces.rest[:, 1] > HEIGHT_M + FILM_M / 2
    u[above, 1] = FILM_M * 0.009
    forces(u, BROKEN)
    u[above, 1] = 0.0
    assert np.abs(forces(u, STICKING, 400)).max() < 1e-12


def test_what_has_just_broken_does_not_stick_before_its_force_has_faded(lips):
    arrays, forces = lips
    arrays.strength[:] = 0.001
    u = np.zeros_like(forces.rest)
    above = forces.rest[:, 1] > HEIGHT_M + FILM_M / 2
    u[above, 1] = FILM_M * 0.002
    forces(u)
    assert (arrays.memory[:, film.STATE] == BROKEN).all()
    wait = -np.log(film.FADED) * arrays.times[0]
    for steps, state in ((round(0.99 * wait / DT), BROKEN), (round(0.02 * wait / DT), STICKING)):
        for _ in range(10):
            nodes_moved = forces(u, arrays.memory[:, film.STATE].copy(), steps // 10)
        assert (arrays.memory[:, film.STATE] == state).all()
    assert np.isfinite(nodes_moved).all()


def test_viscosity_slows_the_ends_of_a_strut_by_its_stiffness_and_their_speed(lips):
    arrays, forces = lips
    u, moved = np.zeros_like(forces.rest), np.zeros_like(forces.rest)
    moved[forces.rest[:, 1] > HEIGHT_M + FILM_M / 2, 0] = 1e-8  # along the film: nothing is pushed together
    before = forces(u, moved=moved)
    stiff = arrays.memory[:, film.STIFF : film.STIFF + 4].reshape(-1)
    starts = arrays.pair_first.astype(int)
    k = np.array([stiff[arrays.pair_struts[i:j].astype(int)].sum() for i, j in pairwise(starts)])
    inertia = film.INERTIA * k + arrays.pair_tissue
    arrays.pair_memory[:, 0] = inertia  # as in the step before: the ends do not meet anew
    film.ease_film(arrays, forces.nodes, 0, 1.0, DT)
    low, up = arrays.pair_lower.astype(int), arrays.pair_upper.astype(int)
    compliance = forces.nodes.compliance[low, 0] + forces.nodes.compliance[up, 0]
    drag = film.VISCOUS_S * k * 1e-8 / DT
    drag /= 1 + (inertia + 0.5 * film.VISCOUS_S / DT * k) * compliance  # half a step later, with the inertia
    change = forces.nodes.forces[0, : len(u), 0] - before[:, 0]
    assert change[up] == pytest.approx(drag, rel=1e-6)
    assert change[low] == pytest.approx(-drag, rel=1e-6)


def test_work_of_an_unbroken_film_is_its_energy(lips, rng):
    arrays, forces = lips
    u = random_motion(forces, rng, 2e-5)
    total, steps = 0.0, 400
    for i in range(1, steps + 2):  # the work of an increment is known one step later
        f_moved = u / steps if i > 1 else 0 * u
        forces(u * min(i - 1, steps) / steps, moved=f_moved)
        total += forces.work
    assert total == pytest.approx(energy(arrays, forces.rest + u), rel=1e-4)


def solved(model, **settings):
    times = np.linspace(0, model.duration_s, 26)
    return solve(model, times, threads=1, **settings)


def test_level_zero_lets_go_at_once_and_glue_holds_longer():
    onset = []
    for strength in (0.0, 0.002, 0.004):
        motion = solved(glued_blocks(OPENING, strength=strength))
        open_at = (motion.saliva.state == BROKEN).any(axis=1)
        onset.append(motion.time_s[np.argmax(open_at)])
    assert onset[0] <= 0.004 < onset[1] < onset[2] < 0.1


@pytest.mark.parametrize("precision", ["mixed", "float64"])
def test_energy_is_accounted_for_while_glue_breaks(precision):
    motion = solved(glued_blocks(OPENING), precision=precision)
    assert (motion.saliva.state[-1] == BROKEN).all()
    work = np.abs(motion.energies["external_j"]).max()
    assert motion.energies["saliva_j"][-1] > 0.005 * work
    assert np.abs(motion.energies["residual_j"]).max() < 2e-4 * work


def test_results_do_not_depend_on_the_time_step():
    model = glued_blocks(OPENING)
    motions = [solved(dataclasses.replace(model, dt_s=dt)) for dt in (4e-5, 1e-5)]
    places = [motion.positions[:, model.nodes[:, 1] > HEIGHT_M] for motion in motions]
    assert np.abs(places[0] - places[1]).max() < 0.02 * 0.002
    assert (motions[0].saliva.state != motions[1].saliva.state).sum() <= 2


def test_pressed_lips_do_not_pass_through_each_other():
    slam = KeyFrames((0.0, 0.02, 0.03, 0.1), (0.0, 1.0, -0.6, -0.6), ("linear",) * 3)
    model = glued_blocks(slam, strength=0.0)
    motion = solved(model)
    upper = model.elements[model.saliva.elements][:, [2, 3, 6, 7]]
    lower = model.elements[model.saliva.elements][:, [1, 0, 5, 4]]
    gap = (motion.positions[:, upper] - motion.positions[:, lower])[..., 1]
    assert motion.stopped is None
    assert gap.max() > 2 * FILM_M
    assert gap.min() > 0.8 * FILM_M


@pytest.mark.parametrize("dt", [2e-4, 1.2e-5])
def test_lips_that_meet_gain_no_energy_at_steps_far_above_what_the_film_alone_would_bear(dt):
    slam = KeyFrames((0.0, 0.02, 0.03, 0.1), (0.0, 1.0, -0.6, -0.6), ("linear",) * 3)
    model = dataclasses.replace(glued_blocks(slam, strength=0.0), dt_s=dt)
    area, mass = 0.001 * 0.003 / 4, 1000 * 0.001 * 0.003 * 0.002 / 8  # of the share of one element in one node
    wave = GLUE.bulk_pa + 4 / 3 * GLUE.shear_pa
    film_alone = 2 / np.sqrt(wave * area / FILM_M * 2 / mass)
    assert (dt > 2 * film_alone) == (dt == 2e-4)
    motion = solve(model, np.linspace(0, 0.1, 201), threads=1)
    assert motion.stopped is None
    work = np.abs(motion.energies["external_j"]).max()
    taken = motion.energies["saliva_j"]
    assert taken.min() > -1e-3 * work
    assert np.abs(motion.energies["residual_j"]).max() < 1e-2 * work
    upper = model.elements[model.saliva.elements][:, [2, 3, 6, 7]]
    lower = model.elements[model.saliva.elements][:, [1, 0, 5, 4]]
    assert (motion.positions[:, upper] - motion.positions[:, lower])[..., 1].min() > 0.8 * FILM_M


def test_added_inertia_neither_moves_the_whole_nor_acts_between_open_lips(lips):
    arrays, forces = lips
    rng = np.random.default_rng(1)
    above = forces.rest[:, 1] > HEIGHT_M + FILM_M / 2
    for state, gap, acts in ((INTACT, 0.0, True), (BROKEN, 3 * FILM_M, False), (BROKEN, -1e-6, True)):
        u = np.zeros_like(forces.rest)
        u[above, 1] = gap
        arrays.strength[:] = 0
        if state == INTACT:
            arrays.strength[:] = 1e9
        arrays.pair_memory[:] = 0
        forces(u, state, moved=rng.normal(0, 1e-7, u.shape))
        before = forces.nodes.forces[0].copy()
        film.ease_film(arrays, forces.nodes, 0, 0.999, DT)
        change = (forces.nodes.forces[0] - before)[:, :3]
        assert change.any() == acts
        assert np.abs(change.sum(axis=0)).max() <= 1e-12 * np.abs(change).max()


def test_two_threads_that_share_a_film_give_the_same_bytes():
    model = glued_blocks(OPENING, columns=100, duration_s=0.02, strength=5e-4)
    parts = partition(model.elements, assembly.laws(model), len(model.nodes))
    arrays, _ = assembly.film_arrays(model, parts)
    assert arrays.divided
    one, two = (solve(model, np.linspace(0, 0.02, 11), threads=count) for count in (1, 2))
    assert (one.saliva.state[-1] == BROKEN).any()
    assert one.positions.tobytes() == two.positions.tobytes()
    assert all(one.energies[name].tobytes() == two.energies[name].tobytes() for name in one.energies)


def test_opened_and_closed_again_it_sticks_again():
    again = KeyFrames((0.0, 0.02, 0.04, 0.06, 0.2, 0.25), (0.0, 1.0, 0.0, -0.05, -0.05, 1.0), ("linear",) * 5)
    motion = solved(glued_blocks(again, duration_s=0.25, damping=100.0))
    states = motion.saliva.state[:, 0].tolist()
    order = [state for i, state in enumerate(states) if i == 0 or state != states[i - 1]]
    assert order[0] == INTACT and order[-1] == BROKEN
    assert BROKEN in order[:-1] and INTACT in order[1:-1]


def test_a_lick_lets_go_and_drying_glues_harder():
    from simulator.moisture import Lick

    slow = KeyFrames((0.0, 0.1), (0.0, 0.3), ("linear",))
    whole = np.arange(2)
    held = solved(glued_blocks(slow, strength=0.05))
    licked = solved(glued_blocks(slow, strength=0.05, licks=(Lick(0.05, whole, 2.0),)))
    assert (held.saliva.state == INTACT).all()
    assert np.array_equal(licked.saliva.state[:, 0] == BROKEN, licked.time_s > 0.05 + 1e-9)
    drying = solved(glued_blocks(slow, strength=0.05, moisture=1.0, drying_per_s=10.5))
    assert drying.saliva.moisture[:, 0] == pytest.approx(np.maximum(0, 1 - 10.5 * drying.time_s), abs=1e-9)
    assert drying.saliva.critical[:, 0] == pytest.approx(1 + 0.05 * drying.saliva.moisture[:, 0], abs=1e-12)
    broke = int(np.argmax(drying.saliva.state[:, 0] == BROKEN))
    assert 0 < broke < 25
    assert (
        drying.saliva.stretch[broke - 1, 0] ** 2 < drying.saliva.critical[broke - 1, 0] + 0.05 * 10.5 * 1e-4
    )  # a step


def test_rest_is_passed_over_and_changes_nothing():
    class Restless:
        """The same curve without saying when it is quiet."""

        def __init__(self, curve):
            self.value, self.rate = curve.value, curve.rate

    curve = KeyFrames((0.1, 0.15, 1.5, 1.55), (0.0, 0.2, 0.2, 1.0), ("linear",) * 3)
    settings = {"duration_s": 2.0, "strength": 0.02, "drying_per_s": 0.3, "moisture": 1.0, "damping": 300.0}
    motions = [
        solve(glued_blocks(one, **settings), np.linspace(0, 2, 101), threads=1) for one in (curve, Restless(curve))
    ]
    assert motions[0].steps < 0.6 * motions[1].steps
    assert motions[0].settings["passed_over_s"] > 0.6
    assert np.abs(motions[0].positions - motions[1].positions).max() < 1e-3 * 0.002
    assert np.array_equal(motions[0].saliva.state, motions[1].saliva.state)
    assert motions[0].saliva.moisture == pytest.approx(motions[1].saliva.moisture, abs=1e-4)


def test_drying_wakes_what_rests():
    curve = KeyFrames((0.02, 0.06, 0.5), (0.0, 0.3, 0.3), ("linear",) * 2)
    model = glued_blocks(curve, strength=0.003, drying_per_s=1.0, duration_s=1.5, damping=300.0)
    motion = solve(model, np.linspace(0, 1.5, 76), threads=1)
    assert motion.settings["passed_over_s"] > 0.1
    state, Z, Q = motion.saliva.state[:, 0], motion.saliva.critical[:, 0], motion.saliva.stretch[:, 0] ** 2
    broke = int(np.argmax(state == BROKEN))
    assert broke > 10
    assert Z[broke - 1] > Q[broke - 1] > 1 + 0.9 * (Z[broke] - 1)


def test_a_film_that_breaks_while_one_side_is_squeezed_keeps_no_force_there(lips):
    arrays, forces = lips
    u = np.zeros_like(forces.rest)
    above = forces.rest[:, 1] > HEIGHT_M + FILM_M / 2
    u[above, 1] = FILM_M * (0.004 + 8.0 * (forces.rest[above, 2] - 0.0015))  # open in front, squeezed behind
    forces(u)  # intact: the last forces are those of this state
    arrays.strength[:] = 0.001
    forces(u)
    assert (arrays.memory[:, film.STATE] == BROKEN).all()
    frozen = np.linalg.norm(arrays.memory[:, film.FROZEN : film.FROZEN + 12].reshape(-1, 4, 3), axis=2)
    squeezed = forces.rest[arrays.upper, 2] < 0.0015
    assert (frozen[squeezed] == 0).all()
    assert (frozen[~squeezed] > 1e-6).all()
