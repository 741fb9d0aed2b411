"""How fast the simulated mouth is. Prints the mouth's tables of RESULTS.md.

    python benchmarks/mouth.py --write                     # all tables, then the section of RESULTS.md
    python benchmarks/mouth.py --part solve truth          # some of them; --help lists all

- solve: a second of slow_open against the thesis's 28 s and 354 s on a graphics card, and where the time goes;
- render, truth: pictures and truths per second;
- pool: what gathering of the saliva in the corners does to the opening.

Times are on the wall if not called processor time, with what is compared done in turn, so that a slow spell of the
machine hits all of it; the load of the machine is printed with them.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import tempfile
import time
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path

import findings
import numpy as np
import pandas as pd
from numba import njit
from results import machine, markdown, write_section
from timing import in_turn_s
from tradeoffs_simulator import solved

from simulator import film, kernels, symmetry, timestep
from simulator.camera import Camera
from simulator.look import CLEAN, Look
from simulator.model import Model
from simulator.motion import Motion
from simulator.mouth import Mouth
from simulator.render import render
from simulator.scene import Scene, load_scene
from simulator.simd import LANES
from simulator.simulate import simulate
from simulator.solver import SAFETY, _Run
from simulator.threads import ThreadChoice
from simulator.truth import truth
from simulator.video import write_video

THESIS_S = {"medium": 28.0, "high": 354.0}  # 1 s of slow_open on a graphics card, meshes of 3,414 and 13,680 elements
MESHES = ("low", "medium", "high")


# -- solve ------------------------------------------------------------------------------------------------------------


def speed_table(repeats: int) -> str:
    """A second of slow_open at level 7 against the thesis."""
    works, meshes, steps = {}, {}, {}
    for mesh in THESIS_S:
        scene = findings.scene("slow_open", 7.0, mesh)
        for threads in (None, 1):
            name = f"{mesh}, {'1 thread' if threads else 'measured choice of threads'}"
            parts = scene.model()
            works[name] = partial(simulate, scene, parts=parts, threads=threads)
            steps[name] = works[name]().steps  # and everything is compiled
            meshes[name] = (
                mesh,
                len(parts[0].elements),
                in_turn_s({"": scene.model}, 3)[""][:, 0].min(),
                scene.duration_s,
            )
    rows = {}
    for name, taken in in_turn_s(works, repeats).items():
        mesh, elements, model_s, duration_s = meshes[name]
        thesis = THESIS_S[mesh] * duration_s
        fastest, middle = taken[:, 0].min(), float(np.median(taken[:, 0]))
        rows[name] = {
            "elements, half of them solved": elements,
            "steps": steps[name],
            "best, s": fastest,
            "median, s": middle,
            "processor time, s": taken[:, 1].min(),
            "mesh, s": model_s,
            "thesis (GPU), s": thesis,
            "times faster, best (median)": f"{thesis / fastest:.0f} ({thesis / middle:.0f})",
            "of real time, best (median)": f"{duration_s / fastest:.2f} ({duration_s / middle:.2f})",
        }
    table = pd.DataFrame(rows).T
    table.index.name = f"slow_open, level 7, 1 s solved, of {repeats} runs"
    return markdown(table)


@njit
def _film_passes(glue, nodes, steps):
    work = 0.0
    for _ in range(steps):
        for part in range(nodes.forces.shape[0]):
            work += film.pull_film(glue, nodes, part, 0.0, 1e-9)
    return work


@njit
def _inertia_passes(glue, nodes, steps):
    work = 0.0
    for _ in range(steps):
        for part in range(nodes.forces.shape[0]):
            work += film.ease_film(glue, nodes, part, 1.0, 1e-5)
    return work


@njit
def _element_passes(elements, nodes, scratch, steps):
    low = 1e30
    for _ in range(steps):
        for part in range(nodes.forces.shape[0]):
            low = min(low, kernels.element_forces(elements, nodes, part, scratch))
    return low


@njit
def _node_passes(nodes, stats, steps):
    for _ in range(steps):
        for part in range(nodes.forces.shape[0]):
            kernels._join_forces(nodes, part)
            kernels._advance_nodes(nodes, part, 1.0, stats)


@njit
def _jaw_passes(loads, nodes, curves, steps):
    work = 0.0
    for _ in range(steps):
        for part in range(nodes.forces.shape[0]):
            work += kernels._move_nodes(loads, nodes, part, curves, 1, 1.0, 0.0, 1e-4)
    return work


def passes_table(repeats: int) -> str:
    """Where a step's time goes, one core."""
    columns = {}
    for mesh in MESHES:
        scene = findings.scene("slow_open", 7.0, mesh)
        half = symmetry.half(scene.model()[1]).model
        columns[f"{mesh}, {len(half.elements)} elements"] = _passes_us(_set_up(half, scene), repeats)
    table = pd.DataFrame(columns)
    table.index.name = "us per step of the mouth at rest, each by itself, one core, processor time, best"
    return markdown(table, 1)


def _set_up(half: Model, scene: Scene) -> _Run:
    return _Run(half, scene.state_times_s, "mixed", SAFETY, 1.0, None, False)


def _passes_us(run: _Run, repeats: int) -> dict[str, float]:
    """What a step does -> its time, us."""
    steps = max(10, int(4e4 / len(run.model.elements)))
    kind = run.elements.constants.dtype
    scratch = np.empty(kernels.GROUP * kernels.KEPT * LANES[kind], kind)
    curves, _ = run._load_table(0)
    stats = np.zeros(kernels.STATS)
    works = {
        "elements": lambda: _element_passes(run.elements, run.nodes, scratch, steps),
        "saliva": lambda: _film_passes(run.film, run.nodes, steps),
        "saliva's inertia": lambda: _inertia_passes(run.film, run.nodes, steps),
        "nodes": lambda: _node_passes(run.nodes, stats, steps),
        "jaw's nodes": lambda: _jaw_passes(run.loads, run.nodes, curves, steps),
    }
    best = {}
    for name, work in works.items():
        work()
        taken = []
        for _ in range(repeats):
            run.nodes.forces[:] = 0.0
            start = time.thread_time()
            work()
            taken.append(time.thread_time() - start)
        best[name] = 1e6 * min(taken) / steps
    return best


class _Stopwatch:
    """Processor time of this thread by what it was spent on, s."""

    def __init__(self):
        self.spent: dict[str, float] = {}

    def time(self, what: str, work: Callable, *arguments):
        start = time.thread_time()
        result = work(*arguments)
        self.spent[what] = self.spent.get(what, 0.0) + time.thread_time() - start
        return result

    def watch(self, owner: object, name: str, what: str) -> None:
        """Time every call of a method or function from now on."""
        work = getattr(owner, name)
        setattr(owner, name, lambda *arguments: self.time(what, work, *arguments))


def share_table() -> str:
    """Where the time of a whole solution goes."""
    table = pd.DataFrame({mesh: _shares_ms(mesh) for mesh in MESHES})
    table.index.name = "slow_open, level 7, 1 thread, processor time, ms"
    return markdown(table, 1)


def _shares_ms(mesh: str) -> dict[str, float]:
    scene = findings.scene("slow_open", 7.0, mesh)
    model = scene.model()[1]
    watch = _Stopwatch()
    part = watch.time("halving the mesh", symmetry.half, model)
    stable_step = timestep.stable_step
    watch.watch(timestep, "stable_step", "stable step")
    try:
        run = watch.time("other setting up", _set_up, part.model, scene)
    finally:
        timestep.stable_step = stable_step
    inner = {
        "_load_table": "load factors",
        "_steps": "steps",
        "_save_due": "saving states",
        "_close_energies": "energies of states",
    }
    for name, what in inner.items():
        watch.watch(run, name, what)
    watch.time("other", _to_the_end, run)
    motion = watch.time("handing over", run.motion)
    watch.time("mirroring", part.mirrored, motion)
    spent = watch.spent
    spent["other setting up"] -= spent["stable step"]
    spent["other"] -= sum(spent[what] for what in inner.values())
    return {name: 1e3 * seconds for name, seconds in spent.items()} | {
        "number of steps": run.state.steps,
        "one step, us": 1e6 * spent["steps"] / run.state.steps,
    }


def _to_the_end(run: _Run) -> None:
    choice = ThreadChoice(1, parts=len(run.parts.node_starts) - 1)
    while not run.finished:
        run.advance(choice, None)


# -- render and truth -------------------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def _filmed() -> tuple[Scene, Mouth, Motion]:
    scene = findings.scene("slow_open", 7.0)
    mouth, motion, _ = solved(scene)
    return scene, mouth, motion


def _looks() -> dict[str, Look]:
    """Looks with one effect less, and one with none."""
    full = Look()

    def without(part: str, **changes) -> Look:
        return dataclasses.replace(full, **{part: dataclasses.replace(getattr(full, part), **changes)})

    bare = dataclasses.replace(
        full,
        skin=dataclasses.replace(full.skin, texture=0.0, lip_lines=0.0, wetness=0.0, sheen=0.0, film=0.0, seam=0.0),
        inside=dataclasses.replace(full.inside, upper_teeth=False, lower_teeth=False, tongue=False, shadow=0.0),
        sensor=CLEAN,
    )
    return {
        "all effects": full,
        "no motion blur": without("sensor", shutter=0.0),
        "no lens blur": without("sensor", blur_px=0.0),
        "no noise": without("sensor", noise=0.0, read_noise=0.0),
        "no effect of the sensor": dataclasses.replace(full, sensor=CLEAN),
        "no skin texture": without("skin", texture=0.0, lip_lines=0.0),
        "no highlights": without("skin", wetness=0.0, sheen=0.0),
        "no saliva film": without("skin", film=0.0),
        "no teeth, no tongue": without("inside", upper_teeth=False, lower_teeth=False, tongue=False),
        "none of these": bare,
        "all effects and JPEG 80": without("sensor", jpeg=80),
        "all effects and H.264 28": without("sensor", h264=28),
    }


def render_tables(repeats: int) -> str:
    """Pictures per second."""
    scene, mouth, motion = _filmed()
    times, rate = scene.frame_times_s, scene.output.frame_rate
    jaw = _jaw_of(scene, mouth)

    def draw(camera: Camera, look: Look, threads: int, mode: str = "picture") -> int:
        frames = render(
            motion, mouth, camera, look, times_s=times, frame_rate=rate, jaw=jaw, threads=threads, mode=mode
        )
        return sum(1 for _ in frames)

    small, large = Camera(), Camera(width_px=1920, height_px=1080)
    works = {name: partial(draw, small, look, 2) for name, look in _looks().items()}
    works["all effects, 1 thread"] = partial(draw, small, Look(), 1)
    works |= {mode: partial(draw, small, Look(), 2, mode) for mode in ("wireframe", "stress")}
    works["1920 x 1080, all effects"] = partial(draw, large, Look(), 2)
    works["1920 x 1080, all effects, 1 thread"] = partial(draw, large, Look(), 1)
    draw(small, Look(), 2)
    rows = {name: _per_second(len(times), seconds) for name, seconds in in_turn_s(works, repeats).items()}
    table = pd.DataFrame(rows).T
    table.index.name = "pictures, 512 x 512 and 2 threads if not said otherwise"
    text = f"{len(times)} pictures of slow_open, medium mesh, level 7.\n\n"
    return text + markdown(table, 1) + "\n" + _encode_table(motion, mouth, times, rate, repeats)


def _per_second(count: int, seconds: np.ndarray) -> dict[str, float]:
    """From what `in_turn_s` found for `count` pictures."""
    return {
        "best, 1/s": count / seconds[:, 0].min(),
        "median, 1/s": count / float(np.median(seconds[:, 0])),
        "processor time of one, ms": 1e3 * seconds[:, 1].min() / count,
    }


def _encode_table(motion: Motion, mouth: Mouth, times: np.ndarray, rate: float, repeats: int) -> str:
    rows = {}
    with tempfile.TemporaryDirectory() as folder:
        for size, camera in {"512 x 512": Camera(), "1920 x 1080": Camera(width_px=1920, height_px=1080)}.items():
            frames = list(render(motion, mouth, camera, times_s=times, frame_rate=rate))
            works, files = {}, {}
            for codec, ending in (("ffv1", "mkv"), ("h264", "mp4")):
                files[codec] = Path(folder) / f"{size}.{ending}"
                works[codec] = partial(write_video, files[codec], frames, rate, codec)
            for codec, seconds in in_turn_s(works, repeats).items():
                rows[f"{codec}, {size}"] = _per_second(len(frames), seconds)
                rows[f"{codec}, {size}"]["kB each"] = files[codec].stat().st_size / len(frames) / 1e3
    table = pd.DataFrame(rows).T
    table.index.name = "encoding by itself, 2 threads"
    return markdown(table, 1)


def _jaw_of(scene: Scene, mouth: Mouth) -> Callable[[float], tuple]:
    moved = scene.jaw(mouth)

    def jaw(time_s: float) -> tuple[float, tuple[float, float]]:
        angle, joint = moved.transform(time_s)
        return float(np.degrees(angle)), (float(joint[1]), float(joint[2]))

    return jaw


def truth_table(repeats: int) -> str:
    """Truths per second, from a motion in memory."""
    scene, mouth, motion = _filmed()
    times = np.linspace(0, scene.duration_s, 1000)
    found = truth(motion, mouth, scene.camera, times)
    with tempfile.TemporaryDirectory() as folder:
        works = {
            "truth": lambda: truth(motion, mouth, scene.camera, times),
            "writing its files": lambda: found.save(folder, "clip"),
            "masks, 512 x 512": lambda: found.masks(),
        }
        taken = in_turn_s(works, repeats)
    rows = {name: _per_second(len(times), seconds) for name, seconds in taken.items()}
    table = pd.DataFrame(rows).T
    table.index.name = f"truth only, {len(times)} frames of slow_open, medium"
    return markdown(table)


# -- pool -------------------------------------------------------------------------------------------------------------


def pool_table(mesh: str = "medium") -> str:
    """The opening with more and less saliva in the corners than elsewhere."""
    usual = load_scene("slow_open").saliva.pooling
    rows = {}
    for pooling in sorted({1.0, 4.0, 12.0, 100.0, usual}):
        row = rows[f"{pooling:g}{' (default)' if pooling == usual else ''}"] = {}
        for level in (4.0, 7.0, 10.0):
            scene = findings.scene("slow_open", level, mesh)
            scene = dataclasses.replace(scene, saliva=dataclasses.replace(scene.saliva, pooling=pooling))
            mouth, motion, _ = solved(scene)
            found = truth(motion, mouth, scene.camera, scene.frame_times_s)
            width = findings.profile(found, "width_mw")
            if not width.any():
                row[f"level {level:g}"] = "never opens"
                continue
            onset = found.frames["time_s"].to_numpy()[np.argmax(width > 0)]
            row[f"level {level:g}"] = f"{onset:.2f} / {findings.zip_time_s(found):.2f} / {width[-1]:.2f}"
    table = pd.DataFrame(rows).T
    table.index.name = "saliva in the corners over that in the middle"
    return (
        "Gathering of the saliva in the corners, slow_open: when the lips part, s / from then to 90 % of the last "
        "width, s / last width, mouth widths.\n\n" + markdown(table)
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts: dict[str, Callable[[int], str]] = {
        "solve": lambda n: "\n".join([speed_table(max(n, 5)), share_table(), passes_table(30)]),
        "render": render_tables,
        "truth": truth_table,
        "pool": lambda n: pool_table(),
    }
    parser.add_argument("--part", nargs="+", choices=parts, default=list(parts))
    parser.add_argument("--repeats", type=int, default=3, help="of each timing; at least 5 of a second of slow_open")
    parser.add_argument("--write", action="store_true", help="write the mouth's section of RESULTS.md")
    arguments = parser.parse_args()
    text = f"## Simulated mouth\n\n{machine()}\n"
    print(text)
    for name in arguments.part:
        load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
        part = f"### {name.capitalize()}{load}\n\n{parts[name](arguments.repeats)}"
        print(part, flush=True)
        text += f"\n{part}"
    if arguments.write:
        write_section("mouth", text)


if __name__ == "__main__":
    main()
