"""Where the solver holds and where it gives up, over the built-in scenes. Prints the section "stress" of RESULTS.md.

    python benchmarks/stress.py --write                    # all parts, on the low mesh
    python benchmarks/stress.py --part limit threads       # some of them; --help lists all

- faces: every built-in scene with every built-in face at the four levels: runs that stopped, or took a smaller step;
- rest: closed lips that nothing moves, of many faces, without and with the inertia of near ends (docs/solver.md);
- limit: a fixed step below and above the stable limit of the mesh at rest, in every precision;
- extreme: the jaw at its widest, hardly any damping, the most sticky lips;
- mirror: a scene on one half, on the whole, and its mirror image;
- threads: one thread against two.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pandas as pd
from results import machine, markdown, write_section

from simulator import assembly, film, symmetry, timestep
from simulator.faces import FACES, random_face
from simulator.model import Model
from simulator.motion import Motion
from simulator.muscles import JAW, LARGEST_DROP_M
from simulator.scene import Scene, load_scene, scene_names
from simulator.simulate import simulate
from simulator.solver import solve

LEVELS = (0.0, 4.0, 7.0, 10.0)
PRECISIONS = ("float32", "mixed", "float64")
PARTS_OF_LIMIT = (0.90, 0.97, 1.03, 1.10)
LIMIT_SCENES = ("slow_open", "fast_open", "p", "pout", "smile")
RANDOM_FACES = 40
GAINED_J = 1e-14  # kinetic energy of lips at rest: rounding alone leaves 2e-15


def on_mesh(name: str, level: float, face: str | None = None, mesh: str = "low") -> Scene:
    """A built-in scene at a level, with one of the built-in faces or its own, on a mesh."""
    scene = load_scene(name, level)
    scene = scene if face is None else scene.with_face(face)
    return dataclasses.replace(scene, face=dataclasses.replace(scene.face, resolution=mesh))


def residual(motion: Motion) -> float:
    """Largest residual of the energy ledger over the largest work of the loads."""
    work = float(np.abs(motion.energies["external_j"]).max())
    return float(np.abs(motion.energies["residual_j"]).max()) / work if work > 0 else 0.0


def free_step(model: Model) -> float:
    """Stable step of the mesh at rest, s."""
    return timestep.stable_step(model, assembly.masses(model), ~np.logical_or(*assembly.constrained(model)))


def told(motion: Motion) -> str:
    """How a run ended, in a word or two."""
    if motion.stopped is None:
        return "runs"
    assert motion.stopped.cause and motion.stopped.advice
    return f"{'step too large' if 'too large' in motion.stopped.cause else 'stopped'}, {motion.stopped.time_s:.3f} s"


def runs(scenes: Sequence[Scene]) -> Iterator[tuple[Scene, Motion, float]]:
    """Scenes, their motions on one thread, and the processor time of solving, s."""
    for scene in scenes:
        parts = scene.model()
        begun = time.thread_time()
        motion = simulate(scene, parts=parts, threads=1)
        assert np.isfinite(motion.positions).all()
        yield scene, motion, time.thread_time() - begun


def faces_table(faces: Sequence[str] = tuple(FACES), levels: Sequence[float] = LEVELS) -> str:
    """Every scene with every face at every level."""
    rows = {}
    for name in scene_names():
        made = list(runs([on_mesh(name, level, face) for face in faces for level in levels]))
        rows[name] = {
            "runs": len(made),
            "stopped": sum(motion.stopped is not None for _, motion, _ in made),
            "took a smaller step": sum(motion.settings["restarts"] > 0 for _, motion, _ in made),
            "largest residual over work": f"{max(residual(motion) for _, motion, _ in made):.1e}",
            "processor time of a run, s": float(np.mean([taken for *_, taken in made])),
        }
    table = pd.DataFrame(rows).T
    table.index.name = f"scene, {len(faces)} faces x {len(levels)} levels"
    return markdown(table)


def rest_table(mesh: str = "low", count: int = RANDOM_FACES) -> str:
    """Closed lips, not sticky, that nothing moves, for 0.6 s."""
    base = load_scene("slow_open", 0.0)
    shapes = [*FACES.values(), *(random_face(np.random.default_rng([78, number])) for number in range(count))]
    models = []
    for shape in shapes:
        face = dataclasses.replace(base.face, resolution=mesh, **dataclasses.asdict(shape))
        models.append(symmetry.half(dataclasses.replace(base, muscle=(), face=face).model()[1]).model)
    usual, rows = film.NEAR_INERTIA, {}
    try:
        for inertia in (0.0, usual / 5, usual / 2, usual):
            film.NEAR_INERTIA = inertia
            made = [solve(model, np.linspace(0, 0.6, 7), velocities=True, threads=1) for model in models]
            most = [float(np.abs(motion.energies["kinetic_j"]).max()) for motion in made]
            failed = [motion.stopped is not None or motion.settings["restarts"] > 0 for motion in made]
            gained = [m > GAINED_J or f for m, f in zip(most, failed, strict=True)]
            rows[f"{inertia:g}{' (default)' if inertia == usual else ''}"] = {
                "faces": len(made),
                "gained energy": sum(gained),
                "largest kinetic energy, J": f"{max(most):.0e}",
            }
    finally:
        film.NEAR_INERTIA = usual
    table = pd.DataFrame(rows).T
    table.index.name = f"inertia of near ends, {mesh} mesh, 0.9 of the stable step"
    return markdown(table)


def limit_table(scenes: Sequence[str] = LIMIT_SCENES) -> str:
    """Fixed steps below and above the limit of the mesh at rest, level 7."""
    rows = {}
    for name in scenes:
        scene = on_mesh(name, 7.0)
        half = symmetry.half(scene.model()[1]).model
        limit = free_step(half)
        for precision in PRECISIONS:
            row = rows[f"{name}, {precision}"] = {}
            for part in PARTS_OF_LIMIT:
                model = dataclasses.replace(half, dt_s=part * limit)
                row[f"{part:g} of the limit"] = told(solve(model, scene.state_times_s, precision=precision, threads=1))
    table = pd.DataFrame(rows).T
    table.index.name = "scene, level 7"
    return markdown(table)


def extremes(scene: Scene) -> dict[str, Scene]:
    """A scene at the ends of what it may be set to."""
    wide = tuple(
        dataclasses.replace(action, peak_m=LARGEST_DROP_M) if action.name == JAW else action for action in scene.muscle
    )
    calm = dataclasses.replace(scene.tissue, damping_per_s=1.0)
    return {
        "as it is": scene,
        "jaw at its widest, 50 mm": dataclasses.replace(scene, muscle=wide),
        "damping 1 /s": dataclasses.replace(scene, tissue=calm),
        "level 1000": scene.with_stickiness(1000.0) if not scene.saliva.patch else scene.with_stickiness(10.0),
    }


def extreme_table(names: Sequence[str] | None = None, meshes: Sequence[str] = ("low", "medium")) -> str:
    """Every scene at its extremes, level 10."""
    rows = {}
    for mesh in meshes:
        for name in names or scene_names():
            made = extremes(on_mesh(name, 10.0, mesh=mesh))
            rows[f"{name}, {mesh}"] = {
                what: f"{told(motion)}, {residual(motion):.0e}"
                for what, (_, motion, _) in zip(made, runs(list(made.values())), strict=True)
            }
    table = pd.DataFrame(rows).T
    table.index.name = "scene, mesh: how it ended, residual over work"
    return markdown(table)


def mirrored(positions: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Positions (T, N, 3) of the mirror image of a motion of a mesh whose nodes (N, 3) lie symmetric about x = 0."""
    order = np.lexsort(np.round(nodes, 7).T)
    flipped = nodes * [-1, 1, 1]
    partner = np.empty(len(nodes), int)
    partner[order] = np.lexsort(np.round(flipped, 7).T)
    return positions[:, partner] * [-1, 1, 1]


def mirror_table(mesh: str = "low") -> str:
    """Largest differences, mm, of motions that should be each other's image."""
    rows = {}
    left, right = (simulate(on_mesh(f"one_sided_{side}", 7.0, mesh=mesh), threads=1) for side in ("left", "right"))
    image = mirrored(right.positions, right.nodes)
    rows["one_sided_left and the image of one_sided_right"] = {"mm": 1e3 * np.abs(left.positions - image).max()}
    for name in ("slow_open", "p"):
        scene = on_mesh(name, 7.0, mesh=mesh)
        whole = dataclasses.replace(scene, solve=dataclasses.replace(scene.solve, symmetric=False))
        one, other = (simulate(each, threads=1) for each in (scene, whole))
        rows[f"{name}, half and whole"] = {"mm": 1e3 * np.abs(one.positions - other.positions).max()}
        image = mirrored(other.positions, other.nodes)
        rows[f"{name}, whole and its image"] = {"mm": 1e3 * np.abs(other.positions - image).max()}
    table = pd.DataFrame(rows).T
    table.index.name = f"{mesh} mesh, level 7"
    return markdown(table, 6)


def threads_table(mesh: str = "low") -> str:
    """Whether one thread and two give the same bits."""
    same = []
    for name in scene_names():
        one, two = (simulate(on_mesh(name, 7.0, mesh=mesh), threads=count) for count in (1, 2))
        same.append(one.positions.tobytes() == two.positions.tobytes())
    return f"One thread and two give the same bits in {sum(same)} of {len(same)} scenes ({mesh} mesh, level 7).\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts: dict[str, Callable[[], str]] = {
        "faces": faces_table,
        "rest": rest_table,
        "limit": limit_table,
        "extreme": extreme_table,
        "mirror": mirror_table,
        "threads": threads_table,
    }
    parser.add_argument("--part", nargs="+", choices=parts, default=list(parts))
    parser.add_argument("--write", action="store_true", help="write the section of RESULTS.md")
    arguments = parser.parse_args()
    text = f"## Stress of the solver\n\n{machine()}\n"
    print(text)
    for name in arguments.part:
        part = f"### {name.capitalize()}\n\n{parts[name]()}"
        print(part, flush=True)
        text += f"\n{part}"
    if arguments.write:
        write_section("stress", text)


if __name__ == "__main__":
    main()
