"""A motion at other times than the saved ones."""

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.motion import BROKEN, INTACT, STICKING, Motion, SalivaRecord
from simulator.playback import at_times


@pytest.fixture
def motion():
    time_s = np.array([0.0, 0.1, 0.4])
    positions = np.random.default_rng(1).normal(size=(3, 5, 3))
    state = np.array([[INTACT, BROKEN], [BROKEN, BROKEN], [STICKING, INTACT]], np.uint8)
    numbers = np.arange(6.0).reshape(3, 2)
    record = SalivaRecord(np.array([3, 4]), state, numbers, numbers + 1, numbers * 2)
    energies = {"kinetic_j": np.array([0.0, 1.0, 3.0])}
    return Motion(time_s, positions, positions[0], energies, 1e-4, 4000, velocities=2 * positions, saliva=record)


def test_saved_times_come_back_to_the_last_bit(motion):
    same = at_times(motion, motion.time_s)
    np.testing.assert_array_equal(same.positions, motion.positions)
    np.testing.assert_array_equal(same.saliva.state, motion.saliva.state)
    np.testing.assert_array_equal(same.energies["kinetic_j"], motion.energies["kinetic_j"])


def test_between_saved_times_numbers_are_linear_and_states_are_the_last(motion):
    part = at_times(motion, [0.05, 0.25])
    np.testing.assert_allclose(part.positions, (motion.positions[:2] + motion.positions[1:]) / 2)
    np.testing.assert_allclose(part.velocities, 2 * part.positions)
    np.testing.assert_allclose(part.energies["kinetic_j"], [0.5, 2.0])
    np.testing.assert_array_equal(part.saliva.state, motion.saliva.state[:2])
    np.testing.assert_allclose(part.saliva.moisture[1], (motion.saliva.moisture[1] + motion.saliva.moisture[2]) / 2)
    np.testing.assert_array_equal(part.time_s, [0.05, 0.25])


def test_times_that_round_are_the_saved_ones(motion):
    for error in (-1e-12, 1e-12):
        rounded = at_times(motion, np.array([0.1, 0.4]) + error)
        np.testing.assert_array_equal(rounded.positions, motion.positions[1:])
        np.testing.assert_array_equal(rounded.saliva.state, motion.saliva.state[1:])


def test_no_times_give_no_states(motion):
    none = at_times(motion, [])
    assert none.positions.shape == (0, 5, 3)
    assert none.saliva.state.shape == (0, 2)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([0.0, 0.5], "expected times from 0 to 0.4 s.*got 0.5"),
        ([-0.1], "expected times from 0 to 0.4 s.*got -0.1"),
        ([0.2, 0.1], "expected times that increase, got 0.1 after 0.2 s"),
        ([0.1, np.nan], "finite numbers"),
        ([[0.1]], "another shape"),
        ("soon", "expected times as a list of numbers"),
    ],
)
def test_bad_times(motion, times, message):
    with pytest.raises(InputError, match=message):
        at_times(motion, times)
