"""Processor times of works that are taken in turn, so that a slow spell of the machine hits all of them."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping

import cv2
import numpy as np


def one_core() -> None:
    """Keep this process, with every thread it will start, on one core."""
    cv2.setNumThreads(1)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def in_turn_s(works: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, np.ndarray]:
    """(repeats, 2) times of each work, s, on the wall and of the processor with all threads; works taken in turn."""
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in works}
    for _ in range(repeats):
        for name, work in works.items():
            wall, own = time.perf_counter(), time.process_time()
            work()
            taken[name].append((time.perf_counter() - wall, time.process_time() - own))
    return {name: np.array(times) for name, times in taken.items()}


def relative(times_s: Mapping[str, float], to: str) -> dict[str, float]:
    """Times as multiples of one of them."""
    return {name: each / times_s[to] for name, each in times_s.items()}
