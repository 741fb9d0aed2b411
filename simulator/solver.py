"""Explicit dynamics of a model: from its loads to the motion of its nodes.

`solve` is the whole method: divide the mesh, find the stable step, then advance from saved state to saved state. The
scheme is central differences advanced by increments of displacement (docs/solver.md).
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
from tqdm import tqdm

from simulator import assembly, checkpoint, film, kernels, moisture, timestep
from simulator.curves import quiet_until
from simulator.errors import InputError, Interrupted
from simulator.interruption import deferred_signals
from simulator.model import Model
from simulator.motion import BROKEN, ENERGIES, STICKING, Motion, SalivaRecord, Stop
from simulator.partition import Partition, in_batches, partition
from simulator.stability import check_supports, diagnose
from simulator.threads import ThreadChoice

SAFETY = 0.9  # of the stable step of the undeformed mesh, for dt "auto"
BLOCK = 512  # steps whose load factors are worked out together
SAVED_STATES = 100  # where neither the caller nor the model says
ENERGY_TOLERANCE = 1.1  # kinetic and damped energy over the external work, above which a run is unstable
ENERGY_FLOOR = 1e-10  # of the modulus times the volume of the body: below, energies are rounding error
RESIDUAL_TOLERANCE = 0.05  # of the largest external work, at a saved state
CALM_STATES = 2
CALM_FORCE = 1e-3  # share of its force that a broken saliva element may still have
CALM_M_S = 1e-5  # largest nodal speed of a body at rest, twice in a row; what is left to come is a millionth of a mouth
DEVICES = ("cpu", "cuda")
RESTARTS = 6  # times a run with dt "auto" may go back to the last saved state and halve its step


def solve(
    model: Model,
    times: Sequence[float] | None = None,
    *,
    precision: str | None = None,
    threads: int | None = None,
    device: str = "cpu",
    safety: float = SAFETY,
    mass_scaling: float = 1.0,
    lightest_dt_s: float | None = None,
    velocities: bool = False,
    checkpoint_path: str | Path | None = None,
    checkpoint_every_s: float = 60.0,
    resume: bool = True,
    progress: bool = False,
) -> Motion:
    """Simulate a model.

    Parameters
    ----------
    model : what to simulate
    times : times of the states to save, s, increasing; None takes those of the model (every `output_every` steps), or
        100 evenly spaced ones and the start. With a fixed step the nearest whole steps are saved
    precision : "float32", "float64", or "mixed": elements in float32, displacements and their increments in float64.
        None takes "mixed", for the table of run time against error in docs/validation.md
    threads : number of threads, at most one per core; None measures whether a second one pays. The result does not
        depend on it
    device : "cpu", or "cuda" for an NVIDIA card, which hexahedra and T4 tetrahedra are computed on. Its results differ
        by rounding errors, and are the same in every run on cards of one kind
    safety : dt "auto" takes this part of the stable step
    mass_scaling : factor on all densities, for quasi-static motion
    lightest_dt_s : add mass to the elements that alone would need a smaller step than this, s
    velocities : also save the velocity of all nodes with each state
    checkpoint_path : file that is written every `checkpoint_every_s` seconds of work, and when the run is interrupted
    resume : go on from a checkpoint that is there already, and end in the same bits as a run that was never
        interrupted; False starts anew
    progress : show a progress bar with the time left

    Returns
    -------
    Motion with the states reached; `stopped` says why a run ended early

    Raises
    ------
    InputError : a setting out of range, a body free to move without deforming, NaN in a load, a checkpoint that is
        damaged or another run's, no card or elements that it does not compute
    Interrupted : Ctrl-C; a KeyboardInterrupt with the motion so far
    """
    precision = precision or "mixed"
    _check_settings(precision, threads, device, safety, mass_scaling)
    check_supports(model)
    run = _Run(model, times, precision, safety, mass_scaling, lightest_dt_s, velocities, device)
    choice = ThreadChoice(1 if device == "cuda" else threads, parts=len(run.parts.node_starts) - 1)
    if checkpoint_path is not None and resume:
        run.resume(checkpoint_path)
    saved_at = clock.monotonic()
    bar = tqdm(total=model.duration_s, unit="s", disable=not progress, initial=run.time, bar_format=_BAR)
    with deferred_signals() as signals, ThreadPoolExecutor(choice.most) as pool, bar:
        while not run.finished and not signals:
            run.advance(choice, pool)
            bar.update(run.time - bar.n)
            if checkpoint_path is not None and not run.finished and clock.monotonic() - saved_at >= checkpoint_every_s:
                run.save(checkpoint_path)
                saved_at = clock.monotonic()
        if signals and checkpoint_path is not None and not run.finished:
            run.save(checkpoint_path)
    if signals:
        raise Interrupted(run.motion(), signals[0])
    return run.motion()


_BAR = "{desc}{percentage:3.0f}%|{bar}| {n:.3f}/{total:.3f} s [{elapsed}<{remaining}]"


@dataclass
class _State:
    """All that changes from step to step; what a checkpoint holds, and what a restart goes back to.

    arrays : nodal records and loads' memories, in storage order
    dt, base_s, step : the present time is base_s + step dt
    calm : saved states in a row at which nothing moved
    frames : saved positions; time_s, energies : rows of the result; energies lag one step behind their state
    glue : (S, 4) state, stretch, moisture and Z of the saliva at each saved state
    velocities : saved velocities where asked for; until the energies of the last state are known, its mean velocity
        over the step before
    """

    arrays: dict[str, np.ndarray]
    dt: float
    base_s: float = 0.0
    step: int = 0
    steps: int = 0
    next_output: int = 0
    calm: int = 0
    ledger: np.ndarray = field(default_factory=kernels.LEDGER.copy)
    time_s: list = field(default_factory=list)
    frames: list = field(default_factory=list)
    energies: list = field(default_factory=list)
    velocities: list = field(default_factory=list)
    glue: list = field(default_factory=list)

    def copy(self) -> _State:
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        values["arrays"] = {name: array.copy() for name, array in self.arrays.items()}
        return _State(**{name: value.copy() if hasattr(value, "copy") else value for name, value in values.items()})

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Everything as arrays, for a file."""
        values = {one.name: np.asarray(getattr(self, one.name)) for one in fields(self) if one.name != "arrays"}
        return values | {f"array_{name}": array for name, array in self.arrays.items()}

    @staticmethod
    def from_arrays(values: dict[str, np.ndarray]) -> _State:
        """The state that `to_arrays` gave."""
        arrays = {name.removeprefix("array_"): values[name] for name in values if name.startswith("array_")}
        numbers = {name: values[name].item() for name in ("dt", "base_s", "step", "steps", "next_output", "calm")}
        lists = {name: list(values[name]) for name in ("time_s", "frames", "energies", "velocities", "glue")}
        return _State(arrays, ledger=values["ledger"], **numbers, **lists)


class _Run:
    """A simulation under way: the model as arrays, its state, and the steps between two saved states."""

    def __init__(self, model, times, precision, safety, mass_scaling, lightest_dt_s, velocities, device="cpu"):
        self.model, self.precision, self.safety, self.velocities = model, precision, safety, velocities
        self.card = _card(device)
        factors = np.full(len(model.elements), float(mass_scaling))
        if lightest_dt_s is not None:
            factors *= timestep.mass_factors(model, lightest_dt_s / math.sqrt(mass_scaling))
        self.mass = assembly.masses(model, factors)
        self.parts: Partition = partition(model.elements, assembly.laws(model), len(model.nodes))
        self.stored_at = np.argsort(self.parts.nodes)  # record of each node
        self.visits, self.lanes = self.parts, None
        if self.card is not None:
            self.visits, self.lanes = self._visits_of_card()
        fixed, moved = assembly.constrained(model)
        self.auto = model.dt_s == "auto"
        free = ~(fixed | moved)
        self.stable_dt = timestep.stable_step(model, self.mass, free) if self.auto else math.nan
        self.limit = min(self.safety * self.stable_dt, model.duration_s) if self.auto else model.dt_s
        self.times = _output_times(model, times, self.limit)
        self.loads, self.curves, self.gravities = assembly.load_arrays(model, self.parts, self.mass)
        self.film, self.film_order = assembly.film_arrays(model, self.parts)
        self.events = [] if model.saliva is None else sorted({lick.time_s for lick in model.saliva.licks})
        self.energy_arrays = assembly.energy_arrays(model)
        modulus = np.array([material.wave_modulus_pa for material in model.materials])[model.material_of]
        self.floor = ENERGY_FLOOR * float(model.volumes @ modulus)
        self.added_mass = float(self.mass.sum() / assembly.masses(model).sum() - 1)
        self.skipped_s = 0.0
        self.stop: Stop | None = None
        self.restarts = 0
        self.residual_tolerance = RESIDUAL_TOLERANCE
        self._table_of = None
        dt = self.limit
        self._build(dt)
        self.state = _State(self._live_arrays(), dt)
        self.last_good = None
        self._step_for_interval(self._stored("u"))
        self._save_due()
        if self.auto:
            self.last_good = self.state.copy()

    # -- arrays that depend on the step --

    def _build(self, dt: float) -> None:
        of_elements = assembly.PRECISIONS[self.precision][0]
        self.elements = assembly.element_arrays(self.model, self.visits, of_elements, dt, self.lanes)
        self.nodes = assembly.node_arrays(self.model, self.parts, self.precision, dt, self.mass)
        self._set_scheme(dt)
        if self.card is not None:
            arrays = (self.elements, self.nodes, self.loads, self.film)
            self.on_card = self.card.Steps(*arrays, len(self.model.nodes), self.blocks, bool(self.gravities))

    def _set_scheme(self, dt: float) -> None:
        half = self.model.damping * dt / 2
        self.scheme = ((1 - half) / (1 + half), self.model.damping, dt, ENERGY_TOLERANCE, self.floor)

    def _live_arrays(self) -> dict[str, np.ndarray]:
        """The arrays that a step changes, by name; forces are 0 between steps."""
        return {
            "u": self.nodes.u,
            "du": self.nodes.du,
            "seen": self.nodes.seen,
            "history": self.elements.history,
            "reaction": self.loads.reaction,
            "face_force": self.loads.face_force,
            "film": self.film.memory,
            "film_pairs": self.film.pair_memory,
        }

    def load_state(self, state: _State) -> None:
        """Take over a state of this run, from a checkpoint or from before a restart."""
        self._build(state.dt)
        live = self._live_arrays()
        for name, array in state.arrays.items():
            live[name][:] = array
        self.nodes.forces[:] = 0
        self.state = state.copy()
        self.state.arrays = live
        self._table_of = None
        self._has_changed()

    def save(self, path: str | Path) -> None:
        """Write a checkpoint."""
        extra = {"limit": np.array(self.limit), "restarts": np.array(self.restarts)}
        good = {} if self.last_good is None else {f"good_{k}": v for k, v in self.last_good.to_arrays().items()}
        checkpoint.save(path, self._fingerprint(), self.state.to_arrays() | extra | good)

    def resume(self, path: str | Path) -> None:
        """Go on from the checkpoint at `path`, if there is one."""
        arrays = checkpoint.load(path, self._fingerprint())
        if arrays is None:
            return
        try:
            self.limit, self.restarts = arrays["limit"].item(), arrays["restarts"].item()
            good = {name.removeprefix("good_"): array for name, array in arrays.items() if name.startswith("good_")}
            self.last_good = self._fitting(_State.from_arrays(good)) if good else None
            self.load_state(self._fitting(_State.from_arrays(arrays)))
        except (LookupError, ValueError, TypeError, AttributeError, OverflowError) as error:
            raise InputError(
                f"expected a checkpoint in {path}, got one that is damaged ({error}); delete it and start the run anew"
            ) from None

    def _fitting(self, state: _State) -> _State:
        """A state out of a file, if it can be one of this run; else ValueError or TypeError."""
        for name, array in self._live_arrays().items():
            came = state.arrays[name]
            if came.shape != array.shape or came.dtype != array.dtype:
                raise ValueError(f"{name} of another size or kind")
        counts, rows = (state.step, state.steps, state.next_output, state.calm), len(state.time_s)
        if not all(isinstance(one, int) and one >= 0 for one in counts) or state.next_output > len(self.times):
            raise ValueError("a count out of range")
        if not (0 < state.dt <= 2 * self.model.duration_s and 0 <= state.base_s <= self.model.duration_s):
            raise ValueError("a time out of range")
        if state.ledger.shape != kernels.LEDGER.shape or state.ledger.dtype != kernels.LEDGER.dtype:
            raise ValueError("the ledger of another size")
        shapes = {"frames": self.model.nodes.shape, "energies": (len(ENERGIES),), "time_s": ()}
        for name, shape in shapes.items():
            if any(np.shape(row) != shape or np.asarray(row).dtype.kind != "f" for row in getattr(state, name)):
                raise ValueError(f"{name} of another size or kind")
        if not rows or len(state.frames) != rows or len(state.glue) != rows or not 0 <= rows - len(state.energies) <= 1:
            raise ValueError("states that do not fit one another")
        return state

    def _fingerprint(self) -> str:
        settings = (self.precision, self.safety, self.velocities, self.times.tolist(), self.mass.tolist())
        if self.card is not None:
            settings += ("cuda",)
        return checkpoint.fingerprint(self.model, settings)

    def _change_step(self, dt: float) -> None:
        """Go on from the present state with another step: velocities stay."""
        state = self.state
        ratio = dt / state.dt
        state.arrays["du"] *= ratio
        state.ledger[3:5] *= ratio**2
        state.ledger[5] /= ratio
        state.base_s, state.step, state.dt = self.time, 0, dt
        stored = np.take(assembly.compliances(self.model, dt, self.mass), self.parts.nodes, axis=0)
        self.nodes.compliance[: len(stored), :3] = stored
        self._set_scheme(dt)
        if self.elements.terms:  # the factors of the viscous terms follow the step, their stresses stay
            real = self.elements.constants.dtype.type
            fresh = assembly.element_arrays(self.model, self.visits, real, dt, self.lanes).history
            shape = (-1, self.elements.terms, kernels.HISTORY, self.lanes or assembly.LANES[fresh.dtype])
            self.elements.history.reshape(shape)[:, :, :3] = fresh.reshape(shape)[:, :, :3]
        self._table_of = None
        self._has_changed()

    # -- the card --

    def _visits_of_card(self) -> tuple[Partition, int]:
        """The order in which the card visits elements, and how many of them at a time."""
        model = self.model
        count, struts = len(model.elements), 0 if model.saliva is None else 4 * len(model.saliva.elements)
        lanes = self.card.lanes_for(count)
        self.blocks = self.card.blocks_for(count, len(model.nodes), struts)
        workers = self.card.workers(self.blocks)
        return in_batches(self.parts, assembly.laws(model), lanes, workers), lanes

    def _has_changed(self) -> None:
        """Tell the card, if there is one, that the arrays here are not those that its last steps left."""
        if self.card is not None:
            self.on_card.changed = True

    # -- time --

    @property
    def time(self) -> float:
        return self.state.base_s + self.state.step * self.state.dt

    @property
    def finished(self) -> bool:
        return self.stop is not None or (
            self.state.next_output >= len(self.times) and len(self.state.energies) == len(self.state.time_s)
        )

    def _output_step(self) -> int:
        """Step, counted from the base time, of the next state to save."""
        return round((self.times[self.state.next_output] - self.state.base_s) / self.state.dt)

    def _step_for_interval(self, u: np.ndarray) -> None:
        """With dt "auto": a step that ends on the next saved time and is stable at the displacements u (N, 3), m."""
        state = self.state
        if not self.auto or state.next_output >= len(self.times):
            return
        interval = self.times[state.next_output] - self.time
        if interval <= 0:
            return
        # Waves cross the most squeezed element faster than they do at rest.
        limit = self.limit * (1 / kernels.largest_area_stretch(*self.energy_arrays[:3], u))
        dt = interval / math.ceil(interval / limit - 1e-9)
        if not limit / 2 < state.dt <= limit or abs(interval / state.dt - round(interval / state.dt)) > 1e-6:
            self._change_step(dt)

    # -- steps --

    def advance(self, choice: ThreadChoice, pool: ThreadPoolExecutor) -> None:
        """Do a stretch of steps: to the next saved state, the end of a block of load factors, or a blow-up."""
        state = self.state
        resting = state.calm >= CALM_STATES
        if resting and len(state.energies) == len(state.time_s):
            state.calm = 0
            self._pass_over_rest()
            return
        curves, gravity = self._load_table(state.step // BLOCK)
        column = state.step % BLOCK + 1
        steps = BLOCK - state.step % BLOCK
        # After the last saved state one more step makes its energies known.
        steps = min(steps, self._output_step() - state.step) if state.next_output < len(self.times) else 1
        steps = self._wet(steps)
        if (self.velocities or resting) and len(state.energies) < len(state.time_s):
            steps = 1  # the next increment completes the velocity and the energies of the saved state
        count, steps = choice.next(steps)
        log = np.empty((kernels.LOG_ROWS, steps))
        reason, done = self._steps(pool, count, curves, gravity, column, steps, log)
        state.step += done
        state.steps += done
        choice.report(count, done)
        if reason == kernels.DONE and len(state.energies) < len(state.time_s):
            reason = self._close_energies(log[:, 0])
        if reason != kernels.DONE:
            self._give_up(reason)
            return
        self._save_due()

    def _steps(self, pool, count, curves, gravity, column, steps, log) -> tuple[int, int]:
        if self.card is not None:
            return self.on_card.advance(curves, gravity, column, steps, self.scheme, self.state.ledger, log)
        arrived, stats = np.zeros(1, np.int64), np.zeros((2, len(self.parts.node_starts) - 1, kernels.STATS))
        common = (arrived, self.scheme, self.state.ledger, log, stats)

        def run(thread):
            return kernels.advance(
                self.elements, self.nodes, self.loads, self.film, curves, gravity, column, steps, thread, count, *common
            )

        others = [pool.submit(run, thread) for thread in range(1, count)]
        result = run(0)
        for other in others:
            other.result()
        return result

    def _load_table(self, block: int) -> tuple[np.ndarray, np.ndarray]:
        """Load factors (curves, BLOCK + 2) and gravity (BLOCK + 2, 8) from a step before the block to one after."""
        if self._table_of != block:
            state = self.state
            t = state.base_s + state.dt * np.arange(block * BLOCK - 1, (block + 1) * BLOCK + 1)
            t[t < 0] = 0.0
            factors = np.array([np.broadcast_to(curve.value(t), t.shape) for curve in self.curves], dtype=float)
            factors = factors.reshape(len(self.curves), len(t))
            if not np.isfinite(factors).all():
                number, column = np.argwhere(~np.isfinite(factors))[0]
                raise InputError(
                    f"expected finite load factors, got {factors[number, column]} at {t[column]:.6g} s from "
                    f"{self.curves[number]}; correct the curve"
                )
            gravity = np.zeros((len(t), 8))
            for number, vector in self.gravities:
                gravity[:, :3] += factors[number, :, None] * vector
                gravity[:, 4:7] = gravity[:, :3]
            self._table, self._table_of = (factors, gravity), block
        return self._table

    # -- saliva --

    def _wet(self, steps: int) -> int:
        """Set the saliva's moisture for a stretch of steps from now on; return how many until the next lick."""
        saliva = self.model.saliva
        if saliva is None:
            return steps
        self.film.moisture[:] = moisture.wetted(
            saliva.moisture, saliva.drying_per_s, saliva.licks, self.time + self.state.dt / 2
        )[self.film_order]
        ahead = [time for time in self.events if time > self.time + self.state.dt / 2]
        return min(steps, max(1, round((ahead[0] - self.time) / self.state.dt))) if ahead else steps

    def _glue(self, time_s: float) -> np.ndarray:
        """(S, 4) state, stretch, moisture and Z of the saliva; its state is that of its last forces."""
        saliva, memory = self.model.saliva, self.film.memory
        rows = np.empty((len(memory), 4))
        if saliva is not None:
            rows[self.film_order, 0] = memory[:, film.STATE]
            rows[self.film_order, 1] = np.sqrt(memory[:, film.Q_NOW])
            rows[:, 2] = moisture.wetted(saliva.moisture, saliva.drying_per_s, saliva.licks, time_s)
            rows[:, 3] = moisture.critical(rows[:, 2], saliva.strength)
        return rows

    # -- rest --

    def _count_calm(self) -> None:
        """Note at a saved state whether all is still while no load changes."""
        state = self.state
        fastest = float(np.abs(state.arrays["du"][:, :3]).max()) / state.dt
        quiet = all(quiet_until(curve, self.time) > self.time for curve in self.curves)
        if self.velocities or not quiet or not fastest <= CALM_M_S:
            state.calm = 0
        else:
            state.calm = CALM_STATES if fastest == 0 else state.calm + 1

    def _pass_over_rest(self) -> None:
        """Go on to the next time at which a load, a lick or drying changes anything; states in between are the last."""
        state, now = self.state, self.time
        until = min([self.times[-1], *(quiet_until(curve, now) for curve in self.curves)])
        until = min([until, *(time for time in self.events if time > now), now + self._saliva_rests_for()])
        if self.auto:
            passed = self.times[state.next_output :] <= until
        else:
            steps = state.step + math.floor((until - now) / state.dt)
            passed = np.round((self.times[state.next_output :] - state.base_s) / state.dt) <= steps
        if not passed.any():
            return
        for time in self.times[state.next_output :][passed]:
            state.time_s.append(float(time))
            state.frames.append(state.frames[-1])
            state.glue.append(self._glue(float(time)))
            state.energies.append(state.energies[-1])
        state.next_output += int(passed.sum())
        self.film.memory[:, film.SINCE] += until - now
        self._has_changed()
        if self.auto:
            state.base_s, state.step = until, 0
            self._table_of = None
            self._step_for_interval(self._stored("u"))
            self.last_good = state.copy()
        else:
            state.step = steps
        self.skipped_s += self.time - now

    def _saliva_rests_for(self) -> float:
        """How long the saliva, left alone, goes on as it is, s."""
        saliva, memory = self.model.saliva, self.film.memory
        if saliva is None:
            return math.inf
        broken = memory[:, film.STATE] == BROKEN
        if (memory[:, film.STATE] == STICKING).any() or (memory[broken, film.LEFT] > CALM_FORCE).any():
            return 0.0
        return moisture.next_change_s(
            memory[:, film.MOISTURE_NOW], self.film.drying, self.film.strength, memory[:, film.Q_NOW], broken
        )

    # -- saved states --

    def _stored(self, name: str) -> np.ndarray:
        """(N, 3) nodal records "u" or "du", m, in the order of the model's nodes."""
        return np.ascontiguousarray(np.take(self.state.arrays[name], self.stored_at, axis=0)[:, :3])

    def _save_due(self) -> None:
        """Save the present state if its time has come."""
        state = self.state
        if state.next_output >= len(self.times) or self._output_step() > state.step:
            return
        u = self._stored("u")
        state.time_s.append(self.time)
        state.frames.append(self.model.nodes + u)
        state.glue.append(self._glue(self.time))
        if self.velocities:
            state.velocities.append(self._stored("du") / state.dt)
        if state.step == 0 and state.base_s == 0:
            state.energies.append((0.0,) * len(ENERGIES))  # at rest
        state.next_output += 1
        while state.next_output < len(self.times) and self._output_step() <= state.step:
            state.next_output += 1  # times closer together than a step
        self._count_calm()
        self._step_for_interval(u)

    def _close_energies(self, logged: np.ndarray) -> int:
        """Complete the ledger of the last saved state, whose velocity the step after it made known."""
        state = self.state
        elastic, hourglass = kernels.strain_energies(*self.energy_arrays, state.frames[-1] - self.model.nodes)
        kinetic, damping, external = (
            logged[kernels.LOG_KINETIC],
            logged[kernels.LOG_DAMPING],
            logged[kernels.LOG_EXTERNAL],
        )
        saliva = logged[kernels.LOG_SALIVA]
        residual = kinetic + elastic + hourglass + damping + saliva - external
        most = max(state.ledger[2], self.floor)
        tolerance = self.residual_tolerance * most + self.floor
        if self._conservative and not abs(residual) <= tolerance:
            return kernels.ENERGY_GREW
        state.energies.append((kinetic, elastic, hourglass, damping, saliva, external, residual))
        if self.velocities:
            state.velocities[-1] = (state.velocities[-1] + self._stored("du") / state.dt) / 2
        if self.auto:
            self.last_good = state.copy()
        return kernels.DONE

    @property
    def _conservative(self) -> bool:
        """Whether the elements' forces derive from the energy that the ledger adds up."""
        return self.elements.terms == 0 and self.model.element_type != "T4ANP"

    def _give_up(self, reason: int) -> None:
        """End the run, or with dt "auto" go back to the last good state and halve the step."""
        if self.auto and self.restarts < RESTARTS and self.last_good is not None:
            self.restarts += 1
            self.limit /= 2
            self.load_state(self.last_good)
            self._change_step(self.state.dt / 2)
            return
        u, du = self._stored("u"), self._stored("du")
        self.stop = diagnose(self.model, self.mass, u, du, self.time, self.state.dt, reason)

    def motion(self) -> Motion:
        """The states whose energies are known, which of a finished run are all."""
        state, shape = self.state, (-1, *self.model.nodes.shape)
        known = len(state.energies)
        stop = self.stop
        if not self.finished:
            stop = Stop(self.time, None, "the run was interrupted", "go on from its checkpoint or run it again")
        return Motion(
            time_s=np.array(state.time_s[:known]),
            positions=np.array(state.frames[:known]).reshape(shape),
            nodes=self.model.nodes,
            energies={name: np.array([row[i] for row in state.energies]) for i, name in enumerate(ENERGIES)},
            dt_s=state.dt,
            steps=state.steps,
            stopped=stop,
            settings={
                "precision": self.precision,
                "device": "cpu" if self.card is None else "cuda",
                "safety": self.safety,
                "stable_dt_s": None if math.isnan(self.stable_dt) else self.stable_dt,
                "added_mass": self.added_mass,
                "restarts": self.restarts,
                "passed_over_s": float(self.skipped_s),
            },
            velocities=np.array(state.velocities[:known]).reshape(shape) if self.velocities else None,
            saliva=self._record(known),
        )

    def _record(self, known: int) -> SalivaRecord | None:
        if self.model.saliva is None:
            return None
        elements = self.model.saliva.elements
        rows = np.array(self.state.glue[:known]).reshape(known, len(elements), 4)
        return SalivaRecord(elements, rows[..., 0].astype(np.uint8), *(rows[..., i].copy() for i in (1, 2, 3)))


def _output_times(model: Model, times: Sequence[float] | None, dt: float) -> np.ndarray:
    """Times to save, s."""
    if times is None and model.output_every is not None and model.dt_s != "auto":
        steps = round(model.duration_s / dt)
        return np.append(np.arange(0, steps, model.output_every), steps) * dt  # the end too, whatever it falls on
    if times is None:
        return np.linspace(0, model.duration_s, SAVED_STATES + 1)
    times = np.array(times, dtype=float)
    if (
        times.ndim != 1
        or not len(times)
        or not (np.diff(times) > 0).all()
        or not (0 <= times[0] <= times[-1] < math.inf)
    ):
        raise InputError(f"expected increasing times of 0 s or more, got {times.tolist() if times.size < 9 else times}")
    return times


def _card(device: str):
    """The module that computes on a card, loaded only where it is asked for; None for the processor."""
    if device == "cpu":
        return None
    from simulator import cuda

    cuda.check()
    return cuda


def _check_settings(precision: str, threads: int | None, device: str, safety: float, mass_scaling: float) -> None:
    faults = []
    if precision not in assembly.PRECISIONS:
        faults.append(f"precision of {', '.join(assembly.PRECISIONS)}, got {precision!r}")
    if threads is not None and threads < 1:
        faults.append(f"threads of 1 or more, got {threads}")
    if device not in DEVICES:
        faults.append(f"device of {', '.join(DEVICES)}, got {device!r}")
    if not 0 < safety <= 1:
        faults.append(f"safety above 0 and at most 1, got {safety}")
    if not 0 < mass_scaling < math.inf:
        faults.append(f"mass_scaling above 0, got {mass_scaling}")
    if faults:
        raise InputError("expected " + "; ".join(faults))
