"""What sticky mouths do: the profiles of thesis figures 5.37 to 5.48, from the truth of simulated scenes.

`python benchmarks/findings.py --write` draws docs/figures/*.png and the table in RESULTS.md;
tests/test_findings.py asserts what they show.
"""

from __future__ import annotations

import argparse
import dataclasses
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import results

from simulator import events
from simulator.clip import pictures
from simulator.figures import plot_saliva, plot_truth
from simulator.motion import Motion
from simulator.scene import Scene, load_scene
from simulator.simulate import simulate
from simulator.truth import Truth, truth

FIGURES = Path(__file__).parents[1] / "docs" / "figures"
COMMAND = "`python benchmarks/findings.py --write`, medium mesh; figures in docs/figures"
LEVELS = (0, 4, 7, 10)
ACTIONS = ("slow_open", "fast_open", "m", "p", "mummy", "puppy")
ONE_EACH = ("double_opening", "one_sided_left", "drying", "uneven_drying")


def scene(name: str, level: float | None = None, resolution: str = "medium") -> Scene:
    """A built-in scene at a level of stickiness and a resolution."""
    one = load_scene(name, level)
    return dataclasses.replace(one, face=dataclasses.replace(one.face, resolution=resolution))


@lru_cache(maxsize=64)
def clip(name: str, level: float | None = None, resolution: str = "medium", safety: float = 0.9) -> Truth:
    """The truth of a built-in scene."""
    return moved(name, level, resolution, safety)[1]


def moved(
    name: str, level: float | None = None, resolution: str = "medium", safety: float = 0.9
) -> tuple[Motion, Truth]:
    """The motion of a built-in scene, and its truth."""
    one = scene(name, level, resolution)
    one = dataclasses.replace(one, solve=dataclasses.replace(one.solve, safety=safety))
    mouth, model = one.model()
    motion = simulate(one, parts=(mouth, model))
    if motion.stopped:
        raise RuntimeError(f"{name}: {motion.stopped}")
    return motion, truth(motion, mouth, one.camera, one.frame_times_s)


def profile(found: Truth, size: str) -> np.ndarray:
    """(F,) size of the largest opening, mouth widths: "width_mw", "height_mw" or "area_mw2"; 0 where closed."""
    return found.frames[size].to_numpy(float)


def overshoot(found: Truth, after_s: float = 0.0) -> float:
    """Largest height from a time on over the height at the end, less 1."""
    height = profile(found, "height_mw")
    return float(height[found.frames["time_s"] >= after_s].max() / height[-1] - 1)


def zip_time_s(found: Truth) -> float:
    """From the first opening to 90 % of the width at the end, s."""
    return events.reached_s(found, 0.9, "width_mw") - events.onset_s(found)


def table() -> list[str]:
    """A row for each scene and level, in Markdown."""
    rows = [
        "| scene | level | onset, s | width 90 % after, s | width, height at the end | height over that | openings |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, level in [(name, level) for name in ACTIONS for level in LEVELS] + [(name, None) for name in ONE_EACH]:
        found = clip(name, level)
        openings = "; ".join(f"{begin:.2f} to {end:.2f} s" for begin, end in events.spells_s(found))
        end = f"{profile(found, 'width_mw')[-1]:.2f}, {profile(found, 'height_mw')[-1]:.3f}"
        rest = profile(found, "height_mw")[-1] == 0
        numbers = ("", "") if rest else (f"{zip_time_s(found):.2f}", f"{overshoot(found):+.1%}")
        shown = "" if level is None else f"{level:g}"
        rows.append(
            f"| {name} | {shown} | {events.onset_s(found):.2f} | {numbers[0]} | {end} | {numbers[1]} | {openings} |"
        )
    return rows


def draw() -> None:
    """All figures."""
    FIGURES.mkdir(parents=True, exist_ok=True)
    for name in ACTIONS:
        plot_truth({f"level {level}": clip(name, level) for level in LEVELS}, FIGURES / f"{name}.png", name)
    pair = {"level 0": clip("slow_open", 0), "a stickier place": clip("double_opening")}
    plot_truth(pair, FIGURES / "double_opening.png", "double_opening")
    sides = {name: clip(name) for name in ("one_sided_left", "one_sided_right")}
    plot_truth(sides, FIGURES / "one_sided.png", "one_sided_left and one_sided_right")
    plot_truth({"even": clip("drying"), "right side faster": clip("uneven_drying")}, FIGURES / "drying.png", "drying")
    plot_saliva(clip("double_opening"), FIGURES / "double_opening_saliva.png", "double_opening")
    plot_saliva(clip("uneven_drying"), FIGURES / "uneven_drying_saliva.png", "uneven_drying")
    draw_sheet("slow_open", (0.2, 0.26, 0.32, 0.4, 0.52, 0.9), FIGURES / "slow_open_pictures.jpg")
    draw_sheet("double_opening", (0.2, 0.3, 0.38, 0.44, 0.5, 0.9), FIGURES / "double_opening_pictures.jpg", (7,))
    meshes = {f"{name} mesh": clip("slow_open", 7, name) for name in ("low", "medium", "high")}
    plot_truth(meshes, FIGURES / "mesh_profiles.png", "slow_open, level 7")


def draw_sheet(name: str, times_s: tuple[float, ...], path: Path, levels: tuple[float, ...] = LEVELS) -> None:
    """Pictures of a scene: a row for each level, a column for each time, as thesis figure 4.15 has them turned."""
    rows = []
    for level in levels:
        one = scene(name, level)
        one = dataclasses.replace(one, camera=dataclasses.replace(one.camera, width_px=224, height_px=224, view_m=0.08))
        mouth, model = one.model()
        motion = simulate(one, parts=(mouth, model))
        rows.append(np.hstack(list(pictures(one, mouth, motion, np.array(times_s)))))
    write_jpeg(np.vstack(rows), path)


def write_jpeg(picture: np.ndarray, path: Path) -> None:
    """Write an RGB picture whole or not at all."""
    part = path.with_suffix(".part.jpg")
    cv2.imwrite(str(part), picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])
    part.replace(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="draw the figures and write the table")
    arguments = parser.parse_args()
    lines = table()
    print("\n".join(lines))
    if arguments.write:
        draw()
        results.write_section("findings", "\n".join(("## What sticky mouths do", "", COMMAND, "", *lines)))


if __name__ == "__main__":
    main()
