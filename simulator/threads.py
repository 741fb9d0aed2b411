"""How many threads a run uses: measured while it runs, because a busy machine makes a second thread a loss."""

from __future__ import annotations

import os
import time

TRIALS = 3  # stretches that each number of threads is tried for
AGAIN_AFTER_S = 10.0  # a choice is tried anew after this long


class ThreadChoice:
    """Alternates between the possible numbers of threads, then keeps the fastest, and drops it when it turns slow.

    Parameters
    ----------
    requested : number of threads, or None to measure
    parts : number of parts the mesh is divided in; no more threads than that
    """

    def __init__(self, requested: int | None, parts: int):
        if requested is not None:
            self._candidates = [max(1, min(requested, parts))]
        else:
            self._candidates = [n for n in (1, 2, 4) if n <= min(available_cores(), parts)]
        self.most = self._candidates[-1]
        self._start_trial()

    def _start_trial(self) -> None:
        self._best = {n: float("inf") for n in self._candidates}
        self._left = [n for n in self._candidates for _ in range(TRIALS)][::-1]
        self._chosen_at = None

    def count(self) -> int:
        """Number of threads for the next stretch of steps, whose clock starts now."""
        self._started = time.perf_counter()
        if len(self._candidates) == 1:
            return self._candidates[0]
        if self._left:
            return self._left[-1]
        if self._chosen_at is None:
            self._chosen_at = self._started
        elif self._started - self._chosen_at > AGAIN_AFTER_S:
            self._start_trial()
            return self._left[-1]
        return min(self._best, key=self._best.get)

    def report(self, count: int, steps: int) -> None:
        """Tell that the stretch has ended after `steps` steps."""
        per_step = (time.perf_counter() - self._started) / max(steps, 1)
        if self._left:
            self._left.pop()
            self._best[count] = min(self._best[count], per_step)
        elif count > 1 and per_step > 1.2 * self._best[1]:
            self._best[count] = per_step  # other work has come to the machine


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
