"""The result of a simulation: where every node is at each saved time, and where the energy went."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

ENERGIES = ("kinetic_j", "elastic_j", "hourglass_j", "damping_j", "external_j", "residual_j")


@dataclass(frozen=True)
class Stop:
    """Why a run ended early.

    Parameters
    ----------
    time_s : simulated time at which it was noticed, s
    element : number of the element at fault, or None where none stands out
    cause : what happened
    advice : what to change
    """

    time_s: float
    element: int | None
    cause: str
    advice: str

    def __str__(self) -> str:
        where = "" if self.element is None else f" in element {self.element}"
        return f"stopped at {self.time_s:.6g} s: {self.cause}{where}; {self.advice}"


@dataclass(frozen=True, eq=False)
class Motion:
    """Positions of all nodes over time.

    Parameters
    ----------
    time_s : (T,) saved times, s, increasing
    positions : (T, N, 3) m
    nodes : (N, 3) positions at rest, m
    energies : name -> (T,) J, the names of `ENERGIES`: kinetic, elastic and hourglass energy held at that time, energy
        taken by damping and done by external forces and prescribed displacements since the start, and the residual
        kinetic + elastic + hourglass + damping - external, which is 0 but for the error of the time stepping
    dt_s : time step, s
    steps : number of steps done
    stopped : why the run ended early, or None
    settings : everything the run depended on, for provenance
    velocities : (T, N, 3) m/s, or None where they were not asked for
    """

    time_s: np.ndarray
    positions: np.ndarray
    nodes: np.ndarray
    energies: dict[str, np.ndarray]
    dt_s: float
    steps: int
    stopped: Stop | None = None
    settings: dict = field(default_factory=dict)
    velocities: np.ndarray | None = None

    @property
    def displacements(self) -> np.ndarray:
        """(T, N, 3) m, relative to the rest positions."""
        return self.positions - self.nodes
