"""The simulator's run time against the error of the opening's profile: mesh, time step, precision, symmetry, mass.

"All" is against the high mesh in float64 with half the step, "stepping" against the same mesh in float64 with half the
step, so that only the error of time stepping and rounding is left.
"""

from __future__ import annotations

import dataclasses
import time
from functools import lru_cache

import findings
import numpy as np
import pandas as pd
from results import markdown
from timing import relative
from tradeoff_figure import Panel, Point, draw

from simulator.motion import Motion
from simulator.mouth import Mouth
from simulator.scene import Scene, scene_names
from simulator.simulate import simulate
from simulator.solver import SAFETY
from simulator.truth import Truth, truth

FIGURE = findings.FIGURES / "tradeoff_simulator.png"
SIZES = ("width_mw", "height_mw", "area_mw2")
SCENES = (("slow_open", 0.0), ("slow_open", 7.0), ("slow_open", 10.0), ("p", 7.0))
DEFAULT = "medium, mixed, safety 0.9, half"
# What is compared: name -> mesh, and settings of the solver that are not the usual ones.
CASES: dict[str, tuple[str, dict[str, object]]] = {
    "low": ("low", {}),
    DEFAULT: ("medium", {}),
    "high": ("high", {}),
    "safety 0.6": ("medium", {"safety": 0.6}),
    "safety 0.45": ("medium", {"safety": 0.45}),
    "float32": ("medium", {"precision": "float32"}),
    "float64": ("medium", {"precision": "float64"}),
    "whole": ("medium", {"symmetric": False}),
    "mass x 4": ("medium", {"mass_scaling": 4.0}),
    "mass x 16": ("medium", {"mass_scaling": 16.0}),
}
EXACT = {"precision": "float64", "safety": SAFETY / 2}
LEAST = 1e-3  # %, of what the figure shows


def solved(scene: Scene) -> tuple[Mouth, Motion, float]:
    """The mouth of a scene, its motion, and the processor time of solving it on one thread, the mesh left out, s."""
    parts = scene.model()
    start = time.thread_time()
    motion = simulate(scene, parts=parts, threads=1)
    taken = time.thread_time() - start
    if motion.stopped:
        raise RuntimeError(f"{scene.name}: {motion.stopped}")
    return parts[0], motion, taken


def with_solver(scene: Scene, **settings: object) -> Scene:
    """A scene solved in another way."""
    return dataclasses.replace(scene, solve=dataclasses.replace(scene.solve, **settings))


def measured(name: str, level: float | None, mesh: str, changes: dict[str, object]) -> tuple[Truth, float, int]:
    """The truth of a scene solved in some way, the processor time of solving it, s, and the steps."""
    scene = with_solver(findings.scene(name, level, mesh), **changes)
    mouth, motion, seconds = solved(scene)
    return truth(motion, mouth, scene.camera, scene.frame_times_s), seconds, motion.steps


@lru_cache(maxsize=16)
def exact(name: str, level: float | None, mesh: str) -> Truth:
    """What the error of a mesh's time stepping is told by."""
    return measured(name, level, mesh, EXACT)[0]


def differences(one: Truth, other: Truth) -> dict[str, np.ndarray]:
    """Size -> (F,) absolute differences of two profiles, % of the mouth width (of its square for the area)."""
    return {size: 100 * np.abs(findings.profile(one, size) - findings.profile(other, size)) for size in SIZES}


def summed_up(errors: np.ndarray) -> str:
    """Mean, 95th percentile and largest of (F,) errors."""
    return f"{errors.mean():.2f} / {np.percentile(errors, 95):.2f} / {errors.max():.2f}"


def worst_mean(found: dict[str, np.ndarray]) -> float:
    """The largest of the three profiles' mean errors."""
    return float(max(errors.mean() for errors in found.values()))


def tables(repeats: int, scenes: tuple = SCENES, best: str = "high") -> str:
    """A table for each scene, the figure of all of them, and every built-in scene at half the step.

    best : mesh whose exact solution is the reference of "all"
    """
    text, points = "", {}
    for name, level in scenes:
        rows, of_scene = _one_scene(name, level, repeats, best)
        table = pd.DataFrame(rows).T
        table.index.name = f"{name}, level {level:g}"
        text += markdown(table) + "\n"
        for case, numbers in of_scene.items():
            points.setdefault(case, []).append(numbers)
    figure(points)
    return (
        "Mean / 95th percentile / largest difference over the frames, in % of the mouth width (area: of its square). "
        '"All" is against the high mesh in float64 with half the step, "stepping" against the same mesh in float64 '
        "with half the step. The width moves in whole saliva elements, and a frame in which one breaks earlier stands "
        "out by all of it. Figure: docs/figures/tradeoff_simulator.png, the means of the scenes' worst of width, "
        f"height and area.\n\n{text}{half_step_table()}"
    )


def _one_scene(name: str, level: float, repeats: int, best: str) -> tuple[dict, dict]:
    """Rows of the table, and case -> relative time, error against the best, error of stepping."""
    found, seconds = {}, {case: [] for case in CASES}
    for _, changes in CASES.values():
        measured(name, level, "low", changes)  # compiled
    for _ in range(repeats):
        for case, (mesh, changes) in CASES.items():
            found[case] = measured(name, level, mesh, changes)
            seconds[case].append(found[case][1])
    times = {case: min(each) for case, each in seconds.items()}
    share = relative(times, DEFAULT)
    rows, of_scene = {}, {}
    for case, (mesh, _) in CASES.items():
        known, _, steps = found[case]
        against, stepping = (differences(known, exact(name, level, which)) for which in (best, mesh))
        row = rows[case] = {"processor time, s": times[case], "of the default's": share[case], "steps": steps}
        row |= {f"{size.split('_')[0]}, all": summed_up(errors) for size, errors in against.items()}
        row |= {f"{size.split('_')[0]}, stepping": summed_up(errors) for size, errors in stepping.items()}
        of_scene[case] = share[case], worst_mean(against), worst_mean(stepping)
    return rows, of_scene


def figure(points: dict[str, list[tuple[float, float, float]]]) -> None:
    """Draw means over the scenes; case -> of each scene relative time, error against the best, error of stepping."""
    panels = []
    titles = ("mesh and stepping: against the high mesh", "stepping alone: against the same mesh")
    for column, title in enumerate(titles, 1):
        shown = []
        for case, numbers in points.items():
            mesh = CASES[case][0]
            of_case = np.array(numbers)
            time_share = float(np.exp(np.log(of_case[:, 0]).mean()))
            label = f"default: {mesh}" if case == DEFAULT else case
            shown.append(Point(label, time_share, float(of_case[:, column].mean()), case == DEFAULT))
        error = "mean difference of the profile, % of the mouth width"
        panels.append(Panel(title, error, shown, log=True, least=LEAST))
    of = f"mean of {len(next(iter(points.values())))} scenes"
    draw(panels, FIGURE, f"Simulator: run time against error, {of}", "processor time of solving, default = 1")


def half_step_table(mesh: str = "low") -> str:
    """Every built-in scene at half the time step."""
    rows = {}
    for name in scene_names():
        usual, _, steps = measured(name, None, mesh, {})
        finer, _, more_steps = measured(name, None, mesh, {"safety": SAFETY / 2})
        found = differences(usual, finer)
        rows[name] = {"steps": steps, "at half the step": more_steps}
        rows[name] |= {size.split("_")[0]: summed_up(errors) for size, errors in found.items()}
        rows[name]["frames above 1 %"] = f"{np.any([e > 1 for e in found.values()], axis=0).mean():.0%}"
    table = pd.DataFrame(rows).T
    table.index.name = f"{mesh} mesh, mean / 95th percentile / largest difference, % of the mouth width"
    return "Every built-in scene against itself at half the time step.\n\n" + markdown(table)
