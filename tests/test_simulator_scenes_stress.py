"""The solver over built-in scenes at the ends of what they may be set to; the whole is benchmarks/stress.py."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

from simulator import symmetry
from simulator.scene import scene_names
from simulator.simulate import simulate
from simulator.solver import solve

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import stress

SOFT = 0.7  # of the stable step at rest: what a scene that squeezes its elements still bears


def short(name, level, duration_s=0.3, **changes):
    return dataclasses.replace(stress.on_mesh(name, level), duration_s=duration_s, **changes)


@pytest.mark.parametrize("precision", stress.PRECISIONS)
def test_a_fixed_step_runs_below_the_limit_and_is_told_above_it(precision):
    scene = short("slow_open", 7.0)
    half = symmetry.half(scene.model()[1]).model
    limit = stress.free_step(half)
    below = solve(dataclasses.replace(half, dt_s=SOFT * limit), scene.state_times_s, precision=precision, threads=1)
    assert below.stopped is None and stress.residual(below) < 1e-3
    above = solve(dataclasses.replace(half, dt_s=1.1 * limit), scene.state_times_s, precision=precision, threads=1)
    assert 0 < above.stopped.time_s < scene.duration_s and 0 <= above.stopped.element < len(half.elements)
    assert "too large" in above.stopped.cause and "use dt_s" in above.stopped.advice
    assert np.isfinite(above.positions).all()


def test_a_scene_and_its_mirror_image_move_alike():
    left, right = (simulate(short(f"one_sided_{side}", 7.0, 0.7), threads=1) for side in ("left", "right"))
    moved = np.abs(left.positions - left.nodes).max()
    assert np.abs(left.positions - stress.mirrored(right.positions, right.nodes)).max() < 1e-4 * moved
    assert np.abs(left.positions - stress.mirrored(left.positions, left.nodes)).max() > 0.01 * moved


def test_two_threads_give_the_same_bits():
    one, two = (simulate(short("p", 7.0, 0.1), threads=count) for count in (1, 2))
    assert one.positions.tobytes() == two.positions.tobytes()


@pytest.mark.parametrize("what", ["jaw at its widest, 50 mm", "damping 1 /s", "level 1000"])
def test_extremes_run_and_balance(what):
    (_, motion, _) = next(stress.runs([stress.extremes(short("fast_open", 10.0))[what]]))
    assert motion.stopped is None and stress.residual(motion) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("name", scene_names())
def test_every_scene_runs_with_faces_whose_lips_once_blew_up(name):
    for face in ("wide", "smiling", "older", "thin_lips"):
        for _, motion, _ in stress.runs([stress.on_mesh(name, level, face) for level in (0.0, 10.0)]):
            assert motion.stopped is None and stress.residual(motion) < 0.01
