"""A motion at other times than the saved ones."""

import dataclasses

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.motion import BROKEN, INTACT, STICKING, Motion, SalivaRecord
from simulator.playback import at_times, frame_times, states_at, values_at


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


def test_values_and_states_alone_are_those_of_the_motion(motion):
    times = [0.0, 0.07, 0.1, 0.3]
    whole = at_times(motion, times)
    np.testing.assert_array_equal(values_at(motion.time_s, motion.positions, times), whole.positions)
    np.testing.assert_array_equal(states_at(motion.time_s, motion.saliva.state, times), whole.saliva.state)


def test_a_saved_time_has_nothing_of_a_next_state_that_is_no_number(motion):
    positions = motion.positions.copy()
    positions[2] = np.nan
    found = values_at(motion.time_s, positions, [0.05, 0.1, 0.2])
    assert np.isfinite(found[:2]).all() and np.isnan(found[2]).all()
    np.testing.assert_array_equal(found[1], positions[1])


def test_frames_are_at_the_saved_times_or_at_given_ones(motion):
    np.testing.assert_array_equal(frame_times(motion), motion.time_s)
    assert frame_times(motion, (0, 0.1)).tolist() == [0.0, 0.1] and frame_times(motion, (0, 0.1)).dtype == float
    with pytest.raises(InputError, match="expected the time of one frame or more, got none"):
        frame_times(motion, [])
    nothing = dataclasses.replace(motion, time_s=np.zeros(0), positions=motion.positions[:0])
    with pytest.raises(InputError, match="expected a motion with saved states, got none"):
        frame_times(nothing)
    with pytest.raises(InputError, match=r"expected times from 0 to 0\.4 s"):
        frame_times(motion, [0.5])


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
