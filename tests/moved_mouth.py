"""A mouth moved by formula, not by the solver: for tests of what comes after the solver."""

import numpy as np

from simulator.motion import BROKEN, INTACT, Motion, SalivaRecord
from simulator.mouth import Mouth, mouth_mesh


def moved_mouth(
    resolution: str = "low", times: int = 11, drop_m: float = 0.015, patch: tuple[float, float] | None = None
) -> tuple[Mouth, Motion]:
    """A mouth whose lower lip sinks by `drop_m` in the middle over 1 s, and opens from the middle outwards.

    patch : x from, to (m) that stays glued until half of the time, so that there are two openings before
    """
    mouth = mouth_mesh(resolution=resolution)
    time_s = np.linspace(0.0, 1.0, times)
    half = mouth.width_m / 2
    x, y = mouth.nodes[:, 0], mouth.nodes[:, 1]
    below = np.zeros(len(mouth.nodes), bool)
    per_row = len(np.unique(np.round(x, 9)))
    rows = np.arange(len(mouth.nodes)) % (len(mouth.nodes) // 2) // per_row
    below[rows <= rows[mouth.lower[0, 0]]] = True
    middle = (mouth.nodes[mouth.lower[:-1, 0], 0] + mouth.nodes[mouth.lower[1:, 0], 0]) / 2
    positions, states = [], []
    for t in time_s:
        reach = half * t  # the opening's half width

        def sunk(x, t=t, reach=reach):
            s = np.clip(1 - (x / max(reach, 1e-9)) ** 2, 0, None)
            opening = drop_m * t * s
            if patch is not None and t < 0.5:
                opening = opening * np.clip(np.maximum(patch[0] - x, x - patch[1]) / 0.003, 0, 1)
            return opening

        moved = mouth.nodes.copy()
        far = np.clip(1 + y / 0.05, 0, 1)  # less towards the chin
        moved[:, 1] -= np.where(below, sunk(x) * far, 0.0)
        positions.append(moved)
        states.append(np.where(sunk(middle) > 0, BROKEN, INTACT))
    positions, states = np.array(positions), np.array(states, np.uint8)
    ends = positions[:, mouth.upper] - positions[:, mouth.lower]
    height = np.linalg.norm(ends.mean(axis=2), axis=2)
    stretch = (height[:, :-1] + height[:, 1:]) / 2 / mouth.film_m
    ones = np.ones_like(stretch)
    record = SalivaRecord(mouth.saliva, states, stretch, ones, ones)
    return mouth, Motion(time_s, positions, mouth.nodes, {}, 1e-4, 10000, saliva=record)
