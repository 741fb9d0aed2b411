"""How fast and how accurate the simulator's solver is. Prints the solver's tables of RESULTS.md and its figures.

    python benchmarks/solver.py --write               # all tables, then the section of RESULTS.md
    python benchmarks/solver.py --tables speed auto   # some of them; --help lists all

Meshes are one layer of hexahedra like the lower face, with a closed slit, of the thesis's sizes; "jumbled" is the same
with node and element numbers in random order, "unstructured" a slab of hexahedra cut from tetrahedra. Times of
single-thread kernels are processor time of the thread, the best of many short runs, which other work on the machine
disturbs least; where threads are compared, and where a table says "wall", it is time on the wall. The load of the
machine is printed with the tables.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import statics
from results import machine, markdown, write_section

from simulator import assembly, kernels, symmetry, timestep
from simulator.curves import LoadShape
from simulator.mesh import SHEET_CELLS, block, lip_sheet, shuffled, to_tetrahedra
from simulator.model import Fixed, Force, Model
from simulator.partition import partition
from simulator.solver import solve

FIGURES = Path(__file__).parents[1] / "docs" / "figures"
PRECISIONS = ("float32", "mixed", "float64")
ANIMATION_DT = 1e-5  # s, the thesis's step


def sheet(elements: int, jumbled: bool = False, **settings) -> Model:
    """The benchmark face: rim held, both lips pulled apart, tissue of the thesis."""
    nodes, cells, sets = lip_sheet(elements)
    if jumbled:
        nodes, cells, number = shuffled(nodes, cells, np.random.default_rng(0))
        sets = {name: number[members] for name, members in sets.items()}
    pull = LoadShape("POLY345", settings.get("duration_s", 1.0))
    loads = [Fixed(sets["rim"])]
    for side, newton in (("upper", 0.04), ("lower", -0.08)):
        loads.append(Force(sets[side], 1, newton / len(sets[side]), pull))
    return Model(nodes, cells, loads=tuple(loads), **{"damping": 90.0, **settings})


def unstructured(elements: int) -> Model:
    """A slab of about so many hexahedra, none in a row with another: each tetrahedron of a mesh makes four."""
    side = round((elements / 24) ** 0.5)
    rng = np.random.default_rng(0)
    nodes, cells = block((side, side, 1), (0.1, 0.1, 0.004))
    inner = (nodes[:, :2] > 0).all(axis=1) & (nodes[:, :2] < 0.0999).all(axis=1)
    nodes[inner, :2] += rng.uniform(-0.1, 0.1, (inner.sum(), 2)) * 0.1 / side
    nodes, cells = quartered(nodes, to_tetrahedra(nodes, cells))
    nodes, cells, _ = shuffled(nodes, cells, rng)
    far = np.flatnonzero(nodes[:, 0] > 0.0999)
    pull = Force(far, 0, 0.05 / len(far), LoadShape("POLY345", 1.0))
    return Model(
        nodes, cells, loads=(Fixed(np.flatnonzero(nodes[:, 0] == 0)), pull), damping=90.0, dt_s=ANIMATION_DT / 4
    )


def quartered(nodes: np.ndarray, tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and hexahedra (4 E, 8): every tetrahedron (E, 4) cut at the middles of its edges, faces and volume."""
    corners = [(v,) for v in range(4)]
    edges = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    faces = [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]
    parts = [*corners, *edges, *faces, (0, 1, 2, 3)]
    points = np.stack([nodes[tetrahedra[:, part]].mean(axis=1) for part in parts], axis=1).reshape(-1, 3)
    # the same edge or face of neighbours is known by the nodes it lies between
    names = np.full((len(tetrahedra), len(parts), 4), -1)
    for k, part in enumerate(parts):
        names[:, k, : len(part)] = np.sort(tetrahedra[:, part], axis=1)
    _, first, number = np.unique(names.reshape(-1, 4), axis=0, return_index=True, return_inverse=True)
    number = number.reshape(len(tetrahedra), len(parts))
    place = {frozenset(part): k for k, part in enumerate(parts)}
    hexahedra = []
    for v, a, b, c in ((0, 1, 2, 3), (1, 0, 3, 2), (2, 0, 1, 3), (3, 0, 2, 1)):  # turns that keep the volume positive
        corner = ({v}, {v, a}, {v, a, b}, {v, b}, {v, c}, {v, a, c}, {v, a, b, c}, {v, b, c})
        hexahedra.append(number[:, [place[frozenset(part)] for part in corner]])
    return points[first], np.concatenate(hexahedra)


class Stepper:
    """The inner loop alone, one thread, for timing."""

    def __init__(self, model: Model, precision: str, steps: int):
        self.model, self.steps = model, steps
        division = partition(model.elements, assembly.laws(model), len(model.nodes))
        mass, dt = assembly.masses(model), model.dt_s
        self.elements = assembly.element_arrays(model, division, assembly.PRECISIONS[precision][0], dt)
        self.nodes = assembly.node_arrays(model, division, precision, dt, mass)
        self.loads, curves, _ = assembly.load_arrays(model, division, mass)
        self.film, _ = assembly.film_arrays(model, division)
        values = [curve.value(dt * np.arange(steps + 2)) for curve in curves]
        self.curves = np.array(values).reshape(len(curves), steps + 2)
        self.gravity = np.zeros((steps + 2, 8))
        half = model.damping * dt / 2
        self.scheme = ((1 - half) / (1 + half), model.damping, dt, 1.1, 1.0)
        self.log = np.zeros((kernels.LOG_ROWS, steps))
        self.stats = np.zeros((2, len(division.node_starts) - 1, kernels.STATS))

    def run(self) -> None:
        arrays = (self.elements, self.nodes, self.loads, self.film, self.curves, self.gravity)
        sums = (np.zeros(1, np.int64), self.scheme, kernels.LEDGER.copy(), self.log, self.stats)
        reason, _ = kernels.advance(*arrays, 1, self.steps, 0, 1, *sums)
        assert reason == kernels.DONE, reason


def best(run: Callable[[], object], repeats: int, timer: Callable[[], float] = time.thread_time) -> tuple[float, float]:
    """Best and median time of one call, s."""
    taken = []
    for _ in range(repeats):
        start = timer()
        run()
        taken.append(timer() - start)
    return min(taken), float(np.median(taken))


def speed_table(repeats: int) -> str:
    """Million element steps per second on one core."""
    meshes = {
        "mouth": partial(sheet, dt_s=ANIMATION_DT),
        "mouth, jumbled": partial(sheet, jumbled=True, dt_s=ANIMATION_DT),
        "unstructured": unstructured,
    }
    rows = {}
    for precision in PRECISIONS:
        for name, make in meshes.items():
            cells = {}
            for elements in SHEET_CELLS:
                model = make(elements)
                stepper = Stepper(model, precision, max(10, int(3e5 / elements)))
                stepper.run()
                fastest, middle = best(stepper.run, repeats)
                work = stepper.steps * len(model.elements) / 1e6
                cells[f"about {elements}"] = f"{work / fastest:.1f} ({work / middle:.1f})"
            rows[f"{precision}, {name}"] = cells
    table = pd.DataFrame(rows).T
    table.index.name = "million element steps per s, best (median)"
    return "Inner loop, one core, processor time.\n\n" + markdown(table)


def type_table(repeats: int) -> str:
    """Time and critical step per element type."""
    nodes, cells = block((24, 8, 8), (0.03, 0.01, 0.01))
    rows = {}
    for kind in ("H8", "T4", "T4ANP"):
        elements = cells if kind == "H8" else to_tetrahedra(nodes, cells)
        model = Model(nodes, elements, kind, dt_s=1e-5, loads=(Fixed(np.flatnonzero(nodes[:, 0] == 0)),))
        stepper = Stepper(model, "mixed", 40)
        stepper.run()
        fastest, _ = best(stepper.run, repeats)
        critical = timestep.stable_step(model, assembly.masses(model))
        rows[kind] = {
            "elements": len(elements),
            "ns per element step": 1e9 * fastest / 40 / len(elements),
            "critical step, ms": 1e3 * critical,
            "processor time per simulated s, s": fastest / 40 / critical,
        }
    table = pd.DataFrame(rows).T
    table.index.name = "block of 24 x 8 x 8 cells"
    return "Element types on the same nodes, mixed precision, one core.\n\n" + markdown(table, 3)


def precision_table(duration_s: float) -> str:
    """Run time against error after many steps of 1e-5 s."""
    rows = {}
    for elements, damping in ((852, 90.0), (852, 5.0)):
        reference = None
        for precision in reversed(PRECISIONS):
            model = sheet(elements, damping=damping, dt_s=ANIMATION_DT, duration_s=duration_s)
            start = time.thread_time()
            motion = solve(model, [duration_s], precision=precision, threads=1)
            taken = time.thread_time() - start
            u = motion.displacements[-1]
            reference = u if precision == "float64" else reference
            error = np.abs(u - reference).max() / np.abs(reference).max()
            rows[f"{precision}, damping {damping:g} /s"] = {
                "processor time, s": f"{taken:.2f}",
                "largest error / largest displacement": "truth" if precision == "float64" else f"{error:.1e}",
                "largest energy residual / work": f"{_residual(motion):.1e}",
            }
    table = pd.DataFrame(rows).T
    table.index.name = f"{elements} elements, {duration_s / ANIMATION_DT:,.0f} steps of 1e-5 s"
    return "Precision. The default is the fastest whose error stays below 1e-5.\n\n" + markdown(table)


def animation_table(sizes: list[int], duration_s: float) -> str:
    """1 s of animation in steps of 1e-5 s."""
    rows = {}
    for elements in sizes:
        model = sheet(elements, dt_s=ANIMATION_DT, duration_s=duration_s)
        wall, start = time.perf_counter(), time.thread_time()
        motion = solve(model, np.linspace(0, duration_s, 26), threads=1)
        taken, wall = time.thread_time() - start, time.perf_counter() - wall
        rows[str(len(model.elements))] = {
            "processor time per animated s, s": taken / duration_s,
            "wall per animated s, s": wall / duration_s,
            "largest displacement, mm": 1e3 * np.abs(motion.displacements[-1]).max(),
            "largest energy residual / work": f"{_residual(motion):.1e}",
            "stopped": str(motion.stopped or "no"),
        }
    table = pd.DataFrame(rows).T
    table.index.name = f"elements, steps of 1e-5 s over {duration_s:g} s"
    return "Animation with the thesis's step, one core, mixed precision.\n\n" + markdown(table)


def auto_table(sizes: list[int]) -> str:
    """The same second with dt "auto"."""
    rows = {}
    for elements in sizes:
        exact = solve(sheet(elements, dt_s=2e-5), [1.0], threads=1) if elements < 10_000 else None
        for threads in (1, None):
            taken, used = [], []
            for _ in range(3):
                start, own = time.perf_counter(), time.process_time()
                motion = solve(sheet(elements), np.linspace(0, 1, 26), threads=threads)
                taken.append(time.perf_counter() - start)
                used.append(time.process_time() - own)
            u = motion.displacements[-1]
            error = "-"
            if exact is not None:
                truth = exact.displacements[-1]
                error = f"{np.abs(u - truth).max() / np.abs(truth).max():.1e}"
            rows[f"{elements} elements, {'1 thread' if threads else 'measured choice'}"] = {
                "wall, s, best of 3": min(taken),
                "processor time, s": min(used),
                "steps": motion.steps,
                "stable step at rest, ms": 1e3 * motion.settings["stable_dt_s"],
                "error against dt = 2e-5 s": error,
                "energy residual / work": f"{_residual(motion):.1e}",
            }
    table = pd.DataFrame(rows).T
    table.index.name = "1 s of animation, dt auto"
    return markdown(table)


def threads_table(repeats: int) -> str:
    """One thread, two threads, and the measured choice, on the wall."""
    rows = {}
    for elements in SHEET_CELLS:
        model = sheet(elements, dt_s=ANIMATION_DT, duration_s=ANIMATION_DT * max(200, 6e6 / elements))
        times = {1: [], 2: [], None: []}
        for _ in range(repeats):
            for threads, taken in times.items():
                start = time.perf_counter()
                solve(model, [model.duration_s], threads=threads)
                taken.append(time.perf_counter() - start)
        rows[str(len(model.elements))] = {
            "1 thread, s": min(times[1]),
            "2 threads, s": min(times[2]),
            "measured choice, s": min(times[None]),
            "choice / 1 thread": min(times[None]) / min(times[1]),
        }
    table = pd.DataFrame(rows).T
    table.index.name = "elements"
    return "Threads, wall, best of alternating runs.\n\n" + markdown(table)


def compile_table() -> str:
    """The first run on a machine, when everything is compiled, and the first run of a later process."""
    code = (
        "import time; start = time.perf_counter(); import numpy as np\n"
        "from simulator.mesh import block; from simulator.model import Fixed, Gravity, Model\n"
        "from simulator.curves import LoadShape; from simulator.solver import solve\n"
        "nodes, elements = block((20, 4, 1), (0.02, 0.004, 0.001))\n"
        "loads = (Fixed(np.flatnonzero(nodes[:, 0] == 0)), Gravity(1.0, (0, 1, 0), LoadShape('RAMP', 0.01)))\n"
        "solve(Model(nodes, elements, loads=loads, duration_s=0.01), [0.01], threads=1)\n"
        "print(time.perf_counter() - start)"
    )
    taken = []
    with tempfile.TemporaryDirectory() as cache:
        environment = os.environ | {"NUMBA_CACHE_DIR": cache, "PYTHONPATH": str(Path(__file__).parents[1])}
        for _ in range(2):
            done = subprocess.run(
                [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
            )
            taken.append(float(done.stdout))
    table = pd.DataFrame({"H8, mixed": {"compiling, s": taken[0], "compiled before, s": taken[1]}}).T
    table.index.name = "start of Python to the end of a small run, wall"
    return markdown(table)


def symmetry_table(repeats: int) -> str:
    """A symmetric scene whole and as half."""
    model = sheet(3414, dt_s=ANIMATION_DT, duration_s=0.02)
    part = symmetry.half(model)
    times = {"whole": [], "half": []}
    for _ in range(repeats):
        for name, one in (("whole", model), ("half", part.model)):
            start = time.thread_time()
            motion = solve(one, [0.02], threads=1)
            times[name].append(time.thread_time() - start)
            if name == "whole":
                whole = motion
    mirrored = part.mirrored(motion)
    difference = np.abs(mirrored.positions - whole.positions).max() / np.abs(whole.displacements).max()
    table = pd.DataFrame(
        {
            "3408 elements": {
                "whole, s": min(times["whole"]),
                "half, s": min(times["half"]),
                "times faster": min(times["whole"]) / min(times["half"]),
                "largest difference / displacement": f"{difference:.1e}",
            }
        }
    ).T
    table.index.name = "symmetric scene, 2,000 steps, processor time"
    return markdown(table)


def bending_table(figure: bool) -> str:
    """Thesis 3.2.3: how far a block bends, by element type and hourglass stiffness."""
    length, side = 0.08, 0.01
    cases = [(kind, 0.08) for kind in ("T4", "T4ANP", "H8")] + [("H8", kappa) for kappa in (1.0, 0.01, 0.0)]
    rows, shapes = {}, {}
    for cells in ((16, 2, 2), (32, 4, 4)):
        nodes, hexahedra = block(cells, (length, side, side))
        for kind, kappa in cases:
            elements = hexahedra if kind == "H8" else to_tetrahedra(nodes, hexahedra)
            held, loaded = np.flatnonzero(nodes[:, 0] < 1e-9), np.flatnonzero(nodes[:, 0] > length - 1e-9)
            share = np.ones(len(loaded))
            for axis in (1, 2):  # the same traction whatever the mesh: edge nodes carry half
                edge = (nodes[loaded, axis] < 1e-9) | (nodes[loaded, axis] > side - 1e-9)
                share[edge] *= 0.5
            loads = (Fixed(held), Force(loaded, 2, -1e-3 * share / share.sum(), LoadShape("POLY345", 3.0)))
            model = Model(nodes, elements, kind, loads=loads, damping=30.0, hourglass=kappa, duration_s=3.0)
            motion = solve(model, [3.0], threads=1)
            name = kind if kind != "H8" else f"H8, hourglass {kappa:g}"
            sag = -motion.displacements[-1, loaded, 2].mean() if len(motion.time_s) else np.nan
            row = rows.setdefault(name, {})
            row[f"sag, mm, {cells[0]} x {cells[1]} x {cells[2]}"] = 1e3 * sag if motion.stopped is None else np.nan
            if cells == (16, 2, 2):
                row["critical step, ms"] = 1e3 * motion.settings["stable_dt_s"]
                row["stopped"] = motion.stopped.cause if motion.stopped else "no"
                shapes[name] = (nodes, motion)
    if figure:
        _bending_figure(shapes)
    table = pd.DataFrame(rows).T
    table.index.name = "block 80 x 10 x 10 mm, held at one end, 1 mN at the other"
    return markdown(table, 3)


def _bending_figure(shapes: dict) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 6.2), layout="constrained")
    left, right = figure.subplots(2, 1, sharex=True, sharey=True)
    colours = {"T4": "tab:red", "T4ANP": "black", "H8, hourglass 1": "tab:orange", "H8, hourglass 0.08": "tab:green"}
    colours |= {"H8, hourglass 0.01": "tab:blue", "H8, hourglass 0": "tab:purple"}
    panels = {
        left: ("T4", "T4ANP", "H8, hourglass 1"),
        right: ("T4", "T4ANP", "H8, hourglass 0.08", "H8, hourglass 0.01", "H8, hourglass 0"),
    }
    for axes, names in panels.items():
        for name in names:
            nodes, motion = shapes[name]
            if not len(motion.positions):
                continue
            middle = np.abs(nodes[:, 1] - 0.005) < 1e-9
            for height in (0.0, 0.01):
                line = np.flatnonzero(middle & (np.abs(nodes[:, 2] - height) < 1e-9))
                line = line[np.argsort(nodes[line, 0])]
                x = 1e3 * motion.positions[-1, line]
                axes.plot(x[:, 0], x[:, 2], color=colours[name], label=name if height == 0 else None)
        axes.set_ylabel("z, mm")
        axes.set_aspect("equal")
        axes.legend(frameon=False, fontsize=8, loc="lower left")
    right.set_xlabel("x, mm")
    left.set_title("Bent block, 16 x 2 x 2 cells: stiff hourglass control", fontsize=10)
    right.set_title("usual, little and no hourglass control", fontsize=10)
    FIGURES.mkdir(parents=True, exist_ok=True)
    figure.savefig(FIGURES / "bending.png", dpi=110)


def static_table() -> str:
    """The settled state against scikit-fem's quadratic elements; and the figure."""
    from importlib.util import find_spec

    if find_spec("skfem") is None:
        return (
            "Static limit: left out, as scikit-fem is absent; install it with `pip install 'lipmetrics[benchmarks]'`.\n"
        )
    counts = [4, 8, 16]
    rows, errors = {}, {}
    for name, material in statics.MATERIALS.items():
        truth = statics.equilibrium(8, material)
        cases = {f"H8, {2 * n} x {n} x {n}": statics.settled(n, material) for n in counts}
        found = {label: statics.distance(case, truth) for label, case in cases.items()}
        errors[name] = list(found.values())
        row = {label: f"{error:.1e}" for label, error in found.items()}
        row["order"] = f"{-np.polyfit(np.log(counts), np.log(errors[name]), 1)[0]:.2f}"
        row["compliance, 32 x 16 x 16"] = f"{cases['H8, 32 x 16 x 16'].compliance_j / truth.compliance_j - 1:+.1e}"
        coarse = statics.equilibrium(4, material)
        row["scikit-fem itself, 8 x 4 x 4 against 16 x 8 x 8"] = f"{statics.distance(coarse, truth):.1e}"
        rows[name] = row
    _static_figure(counts, errors)
    table = pd.DataFrame(rows).T
    table.index.name = "relative L2 distance of displacements from scikit-fem"
    return "Static limit: settled blocks against triquadratic hexahedra of scikit-fem (16 x 8 x 8).\n\n" + markdown(
        table
    )


def _static_figure(counts: list[int], errors: dict[str, list[float]]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.8, 3.8), layout="constrained")
    axes = figure.subplots()
    h = 1e3 * statics.SIZE_M[1] / np.array(counts)
    for name, values in errors.items():
        axes.loglog(h, values, "o-", label=name)
    first = min(values[0] for values in errors.values())
    axes.loglog(h, first * (h / h[0]) ** 2, "--", color="grey", label="order 2")
    axes.set_xlabel("element size, mm")
    axes.set_ylabel("relative L2 distance of displacements")
    axes.set_xticks(h, [f"{size:g}" for size in h])
    axes.minorticks_off()
    axes.legend(frameon=False, fontsize=8)
    FIGURES.mkdir(parents=True, exist_ok=True)
    figure.savefig(FIGURES / "static_convergence.png", dpi=110)


def _residual(motion) -> float:
    work = np.abs(motion.energies["external_j"]).max()
    return float(np.abs(motion.energies["residual_j"]).max() / work) if work else 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    tables = {
        "speed": lambda a: speed_table(a.repeats),
        "types": lambda a: type_table(a.repeats),
        "precision": lambda a: precision_table(a.seconds),
        "animation": lambda a: animation_table(a.sizes, a.seconds),
        "auto": lambda a: auto_table(a.sizes),
        "threads": lambda a: threads_table(7),
        "compile": lambda a: compile_table(),
        "symmetry": lambda a: symmetry_table(5),
        "bending": lambda a: bending_table(True),
        "static": lambda a: static_table(),
    }
    parser.add_argument("--tables", nargs="+", choices=tables, default=list(tables))
    parser.add_argument("--sizes", nargs="+", type=int, choices=SHEET_CELLS, default=list(SHEET_CELLS))
    parser.add_argument(
        "--seconds", type=float, default=1.0, help="animated time of the precision and animation tables"
    )
    parser.add_argument("--repeats", type=int, default=30, help="of the short timings")
    parser.add_argument("--write", action="store_true", help="write the solver's section of RESULTS.md")
    arguments = parser.parse_args()
    text = f"## Solver\n\n{machine()}\n"
    for name in arguments.tables:
        part = tables[name](arguments)
        print(part, flush=True)
        text += f"\n{part}"
    if arguments.write:
        write_section("solver", text)


if __name__ == "__main__":
    main()
