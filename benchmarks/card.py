"""What an NVIDIA card gains over the processor in the simulator's solver. Prints the card's tables of RESULTS.md.

    python benchmarks/card.py --write                     # all tables, then the section of RESULTS.md
    python benchmarks/card.py --sizes 13680 --meshes high --repeats 1

- sheet: 1 s of animation of the benchmark face (solver.py), with dt "auto" and with the thesis's step of 1e-5 s;
- scene: whole scenes at level 7, half of a face solved.

Wall times of `solve` and `simulate`, the two devices in turn, the processor with its measured choice of threads; the
first run on each, which compiles or loads what was compiled before, is told apart. Differences are the largest of any
node at any saved time, over the largest displacement.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import pandas as pd
from results import machine, markdown, write_section
from solver import ANIMATION_DT, sheet

from simulator import cuda
from simulator.errors import InputError
from simulator.mesh import SHEET_CELLS
from simulator.motion import Motion
from simulator.scene import load_scene, scene_names
from simulator.simulate import simulate
from simulator.solver import solve

SCENES = ("slow_open", "mummy")


class Stopwatch:
    """Wall time spent in the steps on the card and in copies, s, which both wait for the card here."""

    def __init__(self):
        from numba import cuda as numba_cuda

        self.spent = {}
        for name in ("_launch", "_send", "_fetch"):
            setattr(cuda.Steps, name, self._timed(name, getattr(cuda.Steps, name), numba_cuda.synchronize))

    def _timed(self, name: str, work: Callable, wait: Callable) -> Callable:
        def timed(steps, *arguments):
            start = time.perf_counter()
            work(steps, *arguments)
            wait()
            self.spent[name] = self.spent.get(name, 0.0) + time.perf_counter() - start

        return timed

    def read(self) -> dict[str, float]:
        spent, self.spent = self.spent, {}
        return {name: spent.get(name, 0.0) for name in ("_launch", "_send", "_fetch")}


def compared(run: Callable[[str], Motion], repeats: int, watch: Stopwatch) -> dict[str, object]:
    """One row: a run on both devices in turn."""
    first, walls, motions, of_card = {}, {"cuda": [], "cpu": []}, {}, []
    equal = True
    for repeat in range(repeats + 1):
        for device, taken in walls.items():
            start = time.perf_counter()
            motion = run(device)
            seconds = time.perf_counter() - start
            spent = watch.read()
            if repeat == 0:
                first[device] = seconds
            else:
                taken.append(seconds)
                if device == "cuda":
                    of_card.append(spent)
            if device == "cuda" and repeat > 0:
                equal = equal and same_bits(motion, motions["cuda"])
            motions[device] = motion
    card, processor = motions["cuda"], motions["cpu"]
    best = of_card[int(np.argmin(walls["cuda"]))]
    row = {
        "processor, s": min(walls["cpu"]),
        "card, s": min(walls["cuda"]),
        "times faster": min(walls["cpu"]) / min(walls["cuda"]),
        "steps": card.steps,
        "us per step, processor": 1e6 * min(walls["cpu"]) / processor.steps,
        "us per step, steps on the card": 1e6 * best["_launch"] / card.steps,
        "card: steps, s": best["_launch"],
        "card: copies, s": best["_send"] + best["_fetch"],
        "first run of card, s": first["cuda"],
        "difference": f"{difference(card, processor):.1e}",
        "residual / work": f"{residual(card):.1e}",
        "equal bits": "yes" if equal else "NO",
    }
    if card.saliva is not None and card.saliva.state.shape == processor.saliva.state.shape:
        row["saliva's states that differ"] = f"{np.mean(card.saliva.state != processor.saliva.state):.1e}"
    if card.stopped or processor.stopped:
        row["stopped"] = f"{card.stopped} / {processor.stopped}"
    return row


def difference(one: Motion, other: Motion) -> float:
    if one.positions.shape != other.positions.shape:
        return np.nan
    return float(np.abs(one.positions - other.positions).max() / np.abs(other.displacements).max())


def residual(motion: Motion) -> float:
    work = np.abs(motion.energies["external_j"]).max()
    return float(np.abs(motion.energies["residual_j"]).max() / work) if work else 0.0


def same_bits(one: Motion, other: Motion) -> bool:
    energies = all(np.array_equal(one.energies[name], other.energies[name]) for name in one.energies)
    return energies and np.array_equal(one.positions, other.positions)


def sheet_table(sizes: list[int], steps: list[str], repeats: int, watch: Stopwatch) -> str:
    rows = {}
    for elements in sizes:
        for dt in steps:
            model = sheet(elements, dt_s="auto" if dt == "auto" else ANIMATION_DT)
            run = partial(lambda model, device: solve(model, np.linspace(0, 1, 26), device=device), model)
            rows[f"{len(model.elements)}, dt {dt}"] = compared(run, repeats, watch)
            print(rows[f"{len(model.elements)}, dt {dt}"], flush=True)
    table = pd.DataFrame(rows)
    table.index.name = "elements of the benchmark face, 1 s"
    return markdown(table, 3)


def scene_table(meshes: list[str], names: list[str], repeats: int, watch: Stopwatch) -> str:
    rows = {}
    for name in names:
        for mesh in meshes:
            scene = load_scene(name, 7.0)
            scene = dataclasses.replace(scene, face=dataclasses.replace(scene.face, resolution=mesh))
            parts = scene.model()
            run = partial(lambda scene, parts, device: simulate(scene, parts=parts, device=device), scene, parts)
            rows[f"{name}, {mesh}, {len(parts[1].elements)}"] = compared(run, repeats, watch)
            print(rows[f"{name}, {mesh}, {len(parts[1].elements)}"], flush=True)
    table = pd.DataFrame(rows)
    table.index.name = "scene at level 7, mesh, elements of which half are solved"
    return markdown(table, 3)


def card_name() -> str:
    from numba import cuda as numba_cuda

    card = numba_cuda.get_current_device()
    name = card.name.decode() if isinstance(card.name, bytes) else card.name
    return f"{name}, {card.MULTIPROCESSOR_COUNT} multiprocessors"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", nargs="*", type=int, choices=SHEET_CELLS, default=list(SHEET_CELLS))
    parser.add_argument("--steps", nargs="+", choices=("auto", "1e-5"), default=["auto", "1e-5"])
    parser.add_argument("--scenes", nargs="*", choices=scene_names(), default=list(SCENES), metavar="SCENE")
    parser.add_argument("--meshes", nargs="*", choices=("low", "medium", "high"), default=["medium", "high"])
    parser.add_argument("--repeats", type=int, default=2, help="after the first run of each")
    parser.add_argument("--write", action="store_true", help="write the card's section of RESULTS.md")
    arguments = parser.parse_args()
    if arguments.repeats < 1:
        parser.error(f"expected 1 repeat or more, got {arguments.repeats}")
    try:
        cuda.check()
    except InputError as error:
        parser.error(str(error))
    watch = Stopwatch()
    text = f"## Graphics card\n\n{card_name()}, beside {machine()}\n"
    for part in (
        sheet_table(arguments.sizes, arguments.steps, arguments.repeats, watch),
        scene_table(arguments.meshes, arguments.scenes, arguments.repeats, watch),
    ):
        print(part, flush=True)
        text += f"\n{part}"
    if arguments.write:
        write_section("card", text)


if __name__ == "__main__":
    main()
