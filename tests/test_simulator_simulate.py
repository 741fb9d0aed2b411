import dataclasses
import sys

import numpy as np
import pytest

from simulator.errors import InputError, Interrupted
from simulator.motion import BROKEN
from simulator.scene import Action, Face, Glue, Output, SalivaPatch, Scene, Solving
from simulator.simulate import simulate

SCENE = Scene(
    duration_s=0.04,
    face=Face(resolution="low"),
    saliva=Glue(stickiness=0.5),
    muscle=(Action("jaw", peak_m=0.02, keys=((0.0, 0.0), (0.04, 0.3))),),
    output=Output(frame_rate=50),
    solve=Solving(precision="float64"),
)
PATCHED = dataclasses.replace(SCENE, saliva=Glue(stickiness=0.5, patch=(SalivaPatch(10.0, from_m=0.0),)))


def with_symmetry(scene, symmetric):
    return dataclasses.replace(scene, solve=dataclasses.replace(scene.solve, symmetric=symmetric))


@pytest.fixture(scope="module")
def motion():
    return simulate(SCENE, threads=1)


def test_states_are_those_of_the_scene(motion):
    np.testing.assert_allclose(motion.time_s, SCENE.state_times_s, atol=1e-12)
    assert motion.stopped is None and motion.saliva.state.shape == (3, 30)
    assert motion.settings["precision"] == "float64"
    assert (motion.saliva.state[-1] == BROKEN).any()


def test_a_symmetric_scene_solved_by_half_is_the_whole(motion):
    whole = simulate(with_symmetry(SCENE, False), threads=1)
    np.testing.assert_allclose(motion.positions, whole.positions, atol=1e-8)
    assert np.array_equal(motion.saliva.state, whole.saliva.state)
    np.testing.assert_allclose(motion.energies["elastic_j"], whole.energies["elastic_j"], rtol=1e-4, atol=1e-12)
    x = motion.positions[..., 0]
    assert np.abs(x.max(axis=1) + x.min(axis=1)).max() < 1e-12


def test_only_symmetric_scenes_are_cut_in_two():
    with pytest.raises(InputError, match="symmetric"):
        simulate(with_symmetry(PATCHED, True))
    motion = simulate(PATCHED, threads=1)
    broken = motion.saliva.state[-1] == BROKEN
    assert broken[:13].all() and not broken[22:].any()


def test_the_same_scene_gives_the_same_bits(motion):
    again = simulate(SCENE, threads=2)
    assert np.array_equal(again.positions, motion.positions) and np.array_equal(again.saliva.state, motion.saliva.state)


def test_an_interrupted_run_gives_the_whole_mouth(motion, monkeypatch):
    module = sys.modules["simulator.simulate"]  # `simulator.simulate` is the verb
    before = module.solve

    def solve(*arguments, **how):
        raise Interrupted(before(*arguments, **how), 2)

    monkeypatch.setattr(module, "solve", solve)
    with pytest.raises(Interrupted) as caught:
        simulate(SCENE, threads=1)
    assert np.array_equal(caught.value.motion.positions, motion.positions)
