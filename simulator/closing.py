"""Lips as they are seen: without the thickness of the saliva, which the mesh puts between them."""

from __future__ import annotations

import numpy as np

from simulator.mouth import Mouth


def shown_positions(mouth: Mouth, positions: np.ndarray) -> np.ndarray:
    """Positions (..., N, 3), m, with the lips' edges moved together by the film's thickness.

    Each pair of an upper and a lower edge node moves along the line that joins them, each by half of
    `mouth.film_m`; pairs that are nearer than that meet in their middle. So the film belongs to the lips, and lips at
    rest touch. All other nodes stay.
    """
    shown = np.array(positions, dtype=float)
    upper, lower = shown[..., mouth.upper, :], shown[..., mouth.lower, :]
    apart = upper - lower
    distance = np.linalg.norm(apart, axis=-1, keepdims=True)
    share = np.minimum(mouth.film_m / np.maximum(distance, 1e-12), 1.0) / 2
    shown[..., mouth.upper, :] = upper - share * apart
    shown[..., mouth.lower, :] = lower + share * apart
    return shown
