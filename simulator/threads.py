"""How many threads a run uses: measured while it runs, because on a busy machine a second thread is a loss.

Threads wait for one another by spinning, twice a step. Where another program takes a core, each wait lasts a time slice
of milliseconds, so more threads are tried on two steps first, then on a few at a time, and dropped at once when they
turn out slow.
"""

from __future__ import annotations

import os
import time

TRIALS = 3  # stretches that each number of threads is tried for
AGAIN_AFTER_S = 10.0  # a choice is tried anew after this long
PROBE_STEPS = 2  # that first show whether more threads get a core at all
PROBE_WAIT_S = 1e-3  # what starting them may take
TRIAL_STEPS = 8  # of a stretch that tries more than one thread
ALONE_STEPS = 32  # of a stretch that tries one, so that even a short run gains from a second
STRETCH = 128  # most steps that more than one thread does before its time is looked at
SLOWER = 1.1  # times the time of one thread, at which more are given up


class ThreadChoice:
    """Tries the possible numbers of threads, then keeps the fastest, and drops it when it turns slow.

    Parameters
    ----------
    requested : number of threads, or None to measure
    parts : number of parts the mesh is divided in; no more threads than that, nor than there are cores
    """

    def __init__(self, requested: int | None, parts: int):
        most = max(1, min(available_cores(), parts))
        self._candidates = [n for n in (1, 2, 4) if n <= most] if requested is None else [min(requested, most)]
        self._measured = len(self._candidates) > 1
        self.most = self._candidates[-1]
        self._start_trial()

    def _start_trial(self) -> None:
        self._best = {n: float("inf") for n in self._candidates}
        idle = not self._measured or not machine_is_busy()
        self._left = [n for n in self._candidates for _ in range(TRIALS) if n == 1 or idle]
        self._unproven = {n for n in self._candidates if n > 1}
        self._chosen_at = None

    def next(self, steps: int) -> tuple[int, int]:
        """Number of threads for the next stretch, whose clock starts now, and how many of `steps` steps it may do."""
        now = self._started = time.perf_counter()
        if not self._measured:
            return self._candidates[0], steps
        if self._chosen_at is not None and now - self._chosen_at > AGAIN_AFTER_S:
            self._start_trial()
        if self._left:
            count = self._left[0]
            most = ALONE_STEPS if count == 1 else PROBE_STEPS if count in self._unproven else TRIAL_STEPS
            return count, min(steps, most)
        if self._chosen_at is None:
            self._chosen_at = now
        count = min(self._best, key=self._best.get)
        return count, steps if count == 1 else min(steps, STRETCH)

    def report(self, count: int, steps: int) -> None:
        """Tell that the stretch has ended after `steps` steps."""
        if not self._measured:
            return
        taken = time.perf_counter() - self._started
        per_step = taken / max(steps, 1)
        if count in self._unproven and self._left:
            self._unproven.remove(count)
            if taken > PROBE_WAIT_S + 2 * steps * self._best[1]:
                self._left = [n for n in self._left if n != count]
        elif self._left:
            self._left.pop(0)
            self._best[count] = min(self._best[count], per_step)
            if count > 1 and per_step > 2 * self._best[1]:
                self._left = [n for n in self._left if n != count]
        elif count == 1 or per_step > SLOWER * self._best[1]:
            self._best[count] = per_step  # for one thread to follow the machine's load, for more to be given up


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def machine_is_busy() -> bool:
    """Whether other work asks for as much as this machine has, so that a second thread would have to wait.

    The load of the last minute says so, unless fewer processes than cores want to run right now.
    """
    if not hasattr(os, "getloadavg") or os.getloadavg()[0] < available_cores() + 0.5:
        return False
    running = _running_now()
    return running is None or running > available_cores()


def _running_now() -> int | None:
    """Threads of the whole machine that run or wait for a core, this one included; None where nobody tells."""
    try:
        with open("/proc/loadavg", encoding="ascii") as file:
            return int(file.read().split()[3].partition("/")[0])
    except (OSError, ValueError, IndexError):
        return None
