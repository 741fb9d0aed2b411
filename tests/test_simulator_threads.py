"""The choice of threads, with a clock that the test turns."""

import pytest

from simulator import threads


@pytest.fixture
def clock(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(threads.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(threads, "available_cores", lambda: 2)
    monkeypatch.setattr(threads, "machine_is_busy", lambda: False)
    return now


def work(choice, clock, seconds_per_step, stretches=40):
    """Numbers of threads used, and seconds lost against one thread."""
    used, lost = [], 0.0
    for _ in range(stretches):
        count, steps = choice.next(500)
        clock[0] += seconds_per_step[count] * steps
        lost += (seconds_per_step[count] - seconds_per_step[1]) * steps
        choice.report(count, steps)
        used.append(count)
    return used, lost


def test_the_faster_number_is_kept(clock):
    assert work(threads.ThreadChoice(None, 4), clock, {1: 1e-4, 2: 6e-5})[0][-1] == 2
    assert work(threads.ThreadChoice(None, 4), clock, {1: 1e-4, 2: 1.05e-4})[0][-1] == 1


def test_a_second_thread_that_waits_for_time_slices_costs_little(clock):
    used, lost = work(threads.ThreadChoice(None, 4), clock, {1: 1e-4, 2: 8e-3})
    assert used.count(2) == 1
    assert lost < 0.02  # s


def test_the_time_to_start_a_thread_does_not_count_against_it(clock):
    choice, used = threads.ThreadChoice(None, 4), []
    for _ in range(40):
        count, steps = choice.next(500)
        clock[0] += (2e-4 if count == 2 else 0.0) + {1: 1e-4, 2: 6e-5}[count] * steps
        choice.report(count, steps)
        used.append(count)
    assert used[-1] == 2


def test_load_of_the_last_minute_counts_only_while_something_waits(monkeypatch):
    monkeypatch.setattr(threads, "available_cores", lambda: 2)
    monkeypatch.setattr(threads.os, "getloadavg", lambda: (4.0, 4.0, 4.0), raising=False)
    for running, busy in ((1, False), (2, False), (3, True), (None, True)):
        monkeypatch.setattr(threads, "_running_now", lambda running=running: running)
        assert threads.machine_is_busy() is busy
    monkeypatch.setattr(threads.os, "getloadavg", lambda: (1.0, 1.0, 1.0))
    assert not threads.machine_is_busy()


def test_threads_are_given_up_when_other_work_comes_and_tried_again_later(clock):
    choice = threads.ThreadChoice(None, 4)
    assert work(choice, clock, {1: 1e-4, 2: 6e-5})[0][-1] == 2
    assert work(choice, clock, {1: 1e-4, 2: 5e-4}, 2)[0][-1] == 1
    clock[0] += threads.AGAIN_AFTER_S
    assert work(choice, clock, {1: 1e-4, 2: 6e-5})[0][-1] == 2


def test_a_busy_machine_or_one_part_or_a_request_settles_it(clock, monkeypatch):
    assert set(work(threads.ThreadChoice(2, 4), clock, {1: 1e-4, 2: 1e-2})[0]) == {2}
    assert set(work(threads.ThreadChoice(None, 1), clock, {1: 1e-4})[0]) == {1}
    assert set(work(threads.ThreadChoice(8, 4), clock, {2: 1e-4, 1: 1e-4})[0]) == {2}  # of 2 cores
    monkeypatch.setattr(threads, "machine_is_busy", lambda: True)
    assert set(work(threads.ThreadChoice(None, 4), clock, {1: 1e-4, 2: 1e-5})[0]) == {1}
