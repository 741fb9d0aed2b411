"""The time stepping: theory, energy, equal bits, runs that must stop."""

import re
import signal
from dataclasses import replace

import numpy as np
import pytest
from meshes import Constant, Ramp, distorted

from simulator import solver
from simulator.errors import InputError
from simulator.mesh import block, lip_sheet
from simulator.model import (
    Displacement,
    Fixed,
    Force,
    Gravity,
    Model,
    NeoHookean,
    Pressure,
    StVenantKirchhoff,
    ViscoNeoHookean,
)
from simulator.solver import solve


def bar(cells=(24, 2, 2), **settings) -> tuple[Model, float]:
    """Slender bar, held at x = 0, pulled at its end by a small step force; and its wave speed at Poisson's ratio 0."""
    length, side = 0.12, 0.01
    nodes, elements = block(cells, (length, side, side))
    law = StVenantKirchhoff(3000.0, 0.0, 1050.0)
    end = np.flatnonzero(nodes[:, 0] > length - 1e-9)
    loads = (
        Fixed(np.flatnonzero(nodes[:, 0] == 0), (0,)),
        Fixed(np.flatnonzero(nodes[:, 1] == 0), (1,)),
        Fixed(np.flatnonzero(nodes[:, 2] == 0), (2,)),
        Force(end, 0, 1e-7, Constant()),
    )
    model = Model(nodes, elements, materials=(law,), loads=loads, **settings)
    return model, np.sqrt(law.young_pa / law.density)


def hanging(**settings) -> Model:
    """Small distorted block of tissue, held at the bottom, under growing gravity to the side."""
    rng = np.random.default_rng(0)
    model = distorted("H8", rng, materials=(NeoHookean(800, 7000), NeoHookean(2000, 9000)))
    held = np.flatnonzero(model.nodes[:, 2] < 0.003)
    loads = (Fixed(held), Gravity(9.81, (1, 0.2, -0.1), Ramp(0.1)))
    settings = {"damping": 20.0, "dt_s": 2e-4, "duration_s": 0.2, **settings}
    return Model(
        model.nodes, model.elements, materials=model.materials, material_of=model.material_of, loads=loads, **settings
    )


def test_frequency_of_a_bar_in_longitudinal_vibration():
    # Held at one end, free at the other: f = c / (4 L).
    model, speed = bar(duration_s=1.2, dt_s=2e-4)
    motion = solve(model, np.arange(0, 1.2, 2e-3), precision="float64")
    end = np.argmax(model.nodes @ [1, 1, 1])
    swing = motion.displacements[:, end, 0]
    swing = swing - swing.mean()
    up = np.flatnonzero((swing[:-1] < 0) & (swing[1:] >= 0))
    crossing = motion.time_s[up] - swing[up] * np.diff(motion.time_s)[up] / (swing[up + 1] - swing[up])
    assert len(crossing) >= 3
    frequency = (len(crossing) - 1) / (crossing[-1] - crossing[0])
    assert frequency == pytest.approx(speed / (4 * 0.12), rel=0.01)


def test_error_falls_with_the_square_of_the_step():
    steps = np.array([8e-4, 4e-4, 2e-4])
    ends = [solve(hanging(dt_s=dt), [0.2], precision="float64").positions[-1] for dt in (*steps, 2.5e-5)]
    errors = [np.linalg.norm(end - ends[-1]) for end in ends[:-1]]
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(2, abs=0.1)


def test_a_free_body_keeps_falling_as_galileo_said():
    nodes, elements = block((2, 2, 2), (0.02, 0.02, 0.02))
    loads = (Gravity(9.81, (0, 0, -1), Constant()),)
    model = Model(nodes, elements, loads=loads, dt_s=1e-4, duration_s=0.1, free_bodies=True)
    motion = solve(model, [0.1], precision="float64")
    steps = 1000
    fall = 0.5 * 9.81 * steps * (steps + 1) * 1e-8  # exactly what the scheme gives when the force acts from step 0 on
    assert np.abs(motion.displacements[-1] - [0, 0, -fall]).max() < 1e-12


@pytest.mark.parametrize("precision", ["float32", "mixed", "float64"])
def test_energy_balances(precision):
    motion = solve(hanging(), precision=precision)
    assert motion.stopped is None
    work = np.abs(motion.energies["external_j"]).max()
    limit = {"float32": 1e-3, "mixed": 1e-4, "float64": 1e-4}[precision]
    assert np.abs(motion.energies["residual_j"]).max() < limit * work
    assert motion.energies["damping_j"][-1] > 0.01 * work  # the ledger has something to balance


def test_energy_balances_when_nodes_are_moved_and_when_faces_are_pressed():
    nodes, elements = block((3, 3, 3), (0.03, 0.03, 0.03))
    top = np.flatnonzero(nodes[:, 2] > 0.0299)
    bottom = Fixed(np.flatnonzero(nodes[:, 2] == 0))
    sides = elements[elements[:, 0] % 4 == 0][:, [0, 3, 7, 4]]
    for load in (Displacement(top, 2, -0.006, Ramp(0.1)), Pressure(sides, 60.0, Ramp(0.1))):
        model = Model(nodes, elements, loads=(bottom, load), damping=10.0, dt_s=2e-4, duration_s=0.15)
        motion = solve(model, precision="float64")
        work = np.abs(motion.energies["external_j"]).max()
        assert work > 1e-6
        assert np.abs(motion.energies["residual_j"]).max() < 1e-3 * work


def test_pressure_on_all_sides_shrinks_a_block_as_its_bulk_modulus_says():
    nodes, elements = block((3, 3, 3), (0.03, 0.03, 0.03))
    outer = []
    for face in ((3, 2, 1, 0), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)):
        quads = elements[:, face]
        flat = [np.ptp(nodes[quads][:, :, axis], axis=1) for axis in range(3)]
        at = [nodes[quads][:, :, axis].mean(axis=1) for axis in range(3)]
        on = np.any([(f < 1e-12) & ((a < 1e-9) | (a > 0.03 - 1e-9)) for f, a in zip(flat, at, strict=True)], axis=0)
        outer.append(quads[on])
    planes = tuple(Fixed(np.flatnonzero(nodes[:, axis] == 0), (axis,)) for axis in range(3))
    load = Pressure(np.concatenate(outer), 70.0, Ramp(0.2))
    motion = solve(Model(nodes, elements, loads=(*planes, load), damping=200.0, dt_s=4e-4, duration_s=0.5), [0.5])
    ratio = np.prod(motion.positions[-1].max(axis=0) / 0.03)
    assert ratio == pytest.approx(1 - 70 / 7000, abs=2e-6)  # sigma = K (J - 1)


def test_displacements_of_one_node_add_up_and_win_over_fixed():
    nodes, elements = block((1, 1, 1), (0.01, 0.01, 0.01))
    top = np.array([4, 5, 6, 7])
    loads = (Fixed(np.arange(8)), Displacement(top, 2, 1e-3, Ramp(0.05)), Displacement(top, 2, [2e-3] * 4, Ramp(0.05)))
    motion = solve(Model(nodes, elements, loads=loads, dt_s=1e-4, duration_s=0.06), [0.06])
    assert np.abs(motion.displacements[-1, top] - [0, 0, 3e-3]).max() < 1e-12
    assert np.abs(motion.displacements[-1, :4]).max() == 0


def test_viscous_stress_relaxes_to_its_long_time_part():
    # Held stretched in confined compression: the reaction decays from the instantaneous stress to (1 - alpha) of it.
    nodes, elements = block((1, 1, 1), (0.01, 0.01, 0.01))
    held = Fixed(np.arange(8))
    pull = Displacement(np.arange(4, 8), 2, 5e-4, Ramp(0.002))
    law = ViscoNeoHookean(800, 7000, 1050, ((0.4, 0.02),), ((0.4, 0.02),))
    model = Model(nodes, elements, materials=(law,), loads=(held, pull), dt_s=1e-4, duration_s=0.3)
    run = solver._Run(model, [0.004, 0.3], "float64", 0.9, 1.0, None, False)
    choice, reactions = solver.ThreadChoice(1, 1), []
    with solver.ThreadPoolExecutor(1) as pool:
        while not run.finished:
            run.advance(choice, pool)
            reactions.append((run.time, np.abs(run.loads.reaction).sum()))
    assert reactions[-1][1] / NeoHookean(800, 7000).stress(np.diag([1, 1, 1.05]))[2, 2] == pytest.approx(
        0.6e-4, rel=1e-3
    )


def test_threads_do_not_change_a_bit():
    nodes, elements, sets = lip_sheet(852)
    loads = (Fixed(sets["rim"]), Force(sets["lower"], 1, -2e-4, Ramp(0.02)))
    model = Model(nodes, elements, loads=loads, damping=20.0, dt_s=2e-4, duration_s=0.04)
    one, two, measured = (solve(model, [0.02, 0.04], threads=threads) for threads in (1, 2, None))
    assert np.abs(one.displacements[-1]).max() > 1e-4
    assert np.array_equal(one.positions, two.positions)
    assert np.array_equal(one.positions, measured.positions)
    assert one.energies["residual_j"].tolist() == two.energies["residual_j"].tolist()


def break_off_after(stretches: int, monkeypatch) -> None:
    """Send Ctrl-C to the run in the middle of its work."""
    left, next_stretch = [stretches], solver.ThreadChoice.next

    def next_or_signal(self, steps):
        left[0] -= 1
        if left[0] == 0:
            signal.raise_signal(signal.SIGINT)
        return next_stretch(self, steps)

    monkeypatch.setattr(solver.ThreadChoice, "next", next_or_signal)


@pytest.mark.parametrize("dt", [1e-4, "auto"])
def test_an_interrupted_run_ends_in_the_same_bits(tmp_path, monkeypatch, dt):
    model = hanging(dt_s=dt, duration_s=0.3)
    whole = solve(model, np.linspace(0, 0.3, 7), velocities=True)
    file = tmp_path / "run.npz"
    break_off_after(6, monkeypatch)
    with pytest.raises(KeyboardInterrupt) as interrupted:
        solve(model, np.linspace(0, 0.3, 7), velocities=True, checkpoint_path=file)
    part = interrupted.value.motion
    assert 2 <= len(part.time_s) < 7 and "interrupted" in part.stopped.cause
    assert np.array_equal(part.positions, whole.positions[: len(part.time_s)])
    assert file.exists()
    resumed = solve(model, np.linspace(0, 0.3, 7), velocities=True, checkpoint_path=file)
    assert np.array_equal(whole.positions, resumed.positions)
    assert np.array_equal(whole.velocities, resumed.velocities)
    assert np.array_equal(whole.time_s, resumed.time_s)
    for name, values in whole.energies.items():
        assert np.array_equal(values, resumed.energies[name]), name
    with pytest.raises(InputError, match="that of another model"):
        solve(hanging(), checkpoint_path=file)
    damaged = bytearray(file.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    for content in (b"", b"no checkpoint", bytes(damaged), bytes(damaged[:1000])):
        file.write_bytes(content)
        with pytest.raises(InputError, match="damaged or something else"):
            solve(model, np.linspace(0, 0.3, 7), velocities=True, checkpoint_path=file)
    anew = solve(model, np.linspace(0, 0.3, 7), velocities=True, checkpoint_path=file, resume=False)
    assert np.array_equal(whole.positions, anew.positions)


@pytest.mark.parametrize("dt", [1e-4, "auto"])
def test_velocities_are_the_rates_of_change_of_positions(dt):
    model = hanging(dt_s=dt, duration_s=0.1)
    at, h = np.array([0.03, 0.05, 0.1]), 2e-4
    motion = solve(model, [0, *at], precision="float64", velocities=True)
    fine = solve(hanging(dt_s=1e-4, duration_s=0.11), np.sort([*(at - h), *(at + h)]), precision="float64")
    slope = (fine.positions[1::2] - fine.positions[::2]) / (2 * h)
    assert np.abs(motion.velocities[0]).max() == 0
    assert np.linalg.norm(motion.velocities[1:] - slope) < 2e-3 * np.linalg.norm(slope)
    plain = solve(model, [0, *at], precision="float64")
    assert plain.velocities is None and np.array_equal(plain.positions, motion.positions)


def test_auto_step_saves_the_times_asked_for_and_agrees_with_a_small_fixed_step():
    times = [0.0, 0.03, 0.1, 0.2]
    auto = solve(hanging(dt_s="auto"), times)
    fixed = solve(hanging(dt_s=2e-5), times, precision="float64")
    assert auto.time_s == pytest.approx(times, abs=1e-12)
    assert auto.steps < 0.1 * fixed.steps
    assert np.linalg.norm(auto.displacements - fixed.displacements) < 0.01 * np.linalg.norm(fixed.displacements)


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"dt_s": 4e-3}, "too large"),
        ({"gravity": 3e5}, "inside out|energy grew|not a finite"),
    ],
)
def test_a_run_that_blows_up_stops_and_keeps_what_it_had(change, cause):
    base = hanging(**{"dt_s": 3e-4, **{k: v for k, v in change.items() if k == "dt_s"}}, duration_s=0.5)
    loads = (base.loads[0], Gravity(change.get("gravity", 9.81), (1, 0, -1), Ramp(0.3)))
    model = Model(
        base.nodes, base.elements, materials=base.materials, material_of=base.material_of, loads=loads,
        dt_s=base.dt_s, duration_s=0.5, damping=5.0,
    )  # fmt: skip
    motion = solve(model, np.linspace(0, 0.5, 51))
    assert motion.stopped is not None
    assert re.search(cause, motion.stopped.cause)
    assert 0 <= motion.stopped.element < len(model.elements)
    assert motion.stopped.advice
    assert 0 < motion.stopped.time_s < 0.5
    assert 1 <= len(motion.time_s) < 51
    assert np.isfinite(motion.positions).all()
    assert motion.time_s[-1] <= motion.stopped.time_s
    assert len(motion.energies["residual_j"]) == len(motion.time_s)


def test_auto_step_recovers_where_squeezing_makes_the_first_step_too_large():
    nodes, elements = block((3, 3, 4), (0.03, 0.03, 0.04))
    top = np.flatnonzero(nodes[:, 2] > 0.0399)
    loads = (Fixed(np.flatnonzero(nodes[:, 2] == 0)), Displacement(top, 2, -0.026, Ramp(0.3)))
    model = Model(nodes, elements, loads=loads, damping=50.0, duration_s=0.3)
    motion = solve(model)
    assert motion.stopped is None
    work = np.abs(motion.energies["external_j"]).max()
    assert np.abs(motion.energies["residual_j"]).max() < 0.02 * work


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"precision": "float16"}, "precision of float32, mixed, float64, got 'float16'"),
        ({"threads": 0}, "threads of 1 or more, got 0"),
        ({"safety": 1.5}, "safety above 0 and at most 1"),
        ({"mass_scaling": -1}, "mass_scaling above 0"),
        ({"times": [0.2, 0.1]}, "increasing times"),
    ],
)
def test_impossible_settings_are_refused(settings, says):
    with pytest.raises(InputError, match=says):
        solve(hanging(), **settings)


def test_nan_in_a_load_curve_is_refused():
    class Broken(Ramp):
        def value(self, t_s):
            return np.where(np.asarray(t_s) > 0.05, np.nan, 0.0)

    base = hanging()
    model = Model(base.nodes, base.elements, loads=(base.loads[0], Gravity(1.0, (1, 0, 0), Broken(1))), dt_s=2e-4)
    with pytest.raises(InputError, match=r"finite load factors, got nan at 0\.0502 s"):
        solve(model)


def test_uniform_mass_scaling_slows_waves_and_allows_larger_steps():
    plain, heavy = (solve(hanging(dt_s="auto"), [0.2], mass_scaling=factor) for factor in (1.0, 16.0))
    assert heavy.settings["stable_dt_s"] == pytest.approx(4 * plain.settings["stable_dt_s"], rel=0.01)
    assert heavy.settings["added_mass"] == pytest.approx(15)


@pytest.mark.parametrize(("every", "steps"), [(4, [0, 4, 8, 10]), (5, [0, 5, 10]), (99, [0, 10])])
def test_states_are_saved_every_so_many_steps_and_at_the_end(every, steps):
    motion = solve(hanging(dt_s=1e-4, duration_s=1e-3, output_every=every), threads=1)
    assert motion.time_s == pytest.approx(np.array(steps) * 1e-4)


def test_a_run_that_stopped_leaves_no_checkpoint_and_damaged_ones_are_one_sentence(tmp_path):
    model, file = hanging(), tmp_path / "run.npz"
    usual = solve(replace(model, dt_s="auto"), [0.01], threads=1).settings["stable_dt_s"]
    stopped = solve(replace(model, dt_s=1.5 * usual), checkpoint_path=file, checkpoint_every_s=0.0, threads=1)
    assert stopped.stopped.time_s < model.duration_s
    again = solve(replace(model, dt_s=1.5 * usual), checkpoint_path=file, checkpoint_every_s=0.0, threads=1)
    assert again.stopped == stopped.stopped
    file.unlink(missing_ok=True)
    times = np.linspace(0, 0.02, 3)
    solve(model, times, checkpoint_path=file, checkpoint_every_s=0.0, threads=1)
    with np.load(file) as found:
        arrays = {name: found[name] for name in found.files}
    bad = {"array_u": np.zeros((2, 4)), "step": np.array("x"), "next_output": np.array(99), "dt": np.array([1.0, 2.0])}
    for name, value in [*bad.items(), ("energies", None), ("ledger", np.zeros(2)), ("time_s", np.array([]))]:
        changed = arrays | {name: value}
        np.savez(file, **{key: one for key, one in changed.items() if one is not None})
        with pytest.raises(InputError, match="expected a checkpoint"):
            solve(model, times, checkpoint_path=file, threads=1)
