"""What a detection method says about one frame: the contract between the methods and everything after them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

OPEN, CLOSED, NO_MOUTH = "open", "closed", "no_mouth"


@dataclass(frozen=True, slots=True)
class Look:
    """One frame as a method sees it.

    status : ``open``, ``closed`` or ``no_mouth``
    outlines : one closed polygon per opening, each (n, 2) float64 of (row, column) in picture px, last point
        not repeated; pixel (0, 0) has its centre at (0.0, 0.0), so a mask pixel (r, c) covers r-0.5..r+0.5
    corners : (2, 2) float64 (row, column) of the left and right mouth corner in the picture, NaN if unknown
    confidence : 0 (a guess) to 1 (sure); NaN if the method does not say
    evidence : what the confidence was worked out from, as the method orders it; empty if it does not say
    """

    status: str
    outlines: list[np.ndarray] = field(default_factory=list)
    corners: np.ndarray = field(default_factory=lambda: np.full((2, 2), np.nan))
    confidence: float = float("nan")
    evidence: tuple[float, ...] = ()

    @property
    def lip_width_px(self) -> float:
        """Distance between the mouth corners in px, NaN if unknown."""
        (row, col), (other_row, other_col) = self.corners.tolist()
        return math.hypot(other_row - row, other_col - col)
