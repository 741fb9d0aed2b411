"""The result of a simulation: where every node is at each saved time, and where the energy went."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from simulator.errors import InputError

ENERGIES = ("kinetic_j", "elastic_j", "hourglass_j", "damping_j", "saliva_j", "external_j", "residual_j")


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


INTACT, BROKEN, STICKING = 0, 1, 2  # states of a saliva element


@dataclass(frozen=True, eq=False)
class SalivaRecord:
    """The saliva between the lips over time, element by element.

    Parameters
    ----------
    elements : (S,) element numbers
    state : (T, S) uint8, INTACT, BROKEN or STICKING (its force is being ramped in again)
    stretch : (T, S) height over height at rest, the square root of Q = C11 (thesis eq. 3.61)
    moisture : (T, S) moisture over critical moisture, M / Mc (thesis eqs 3.66 and 3.67)
    critical : (T, S) Z, the value of Q at which the element breaks
    """

    elements: np.ndarray
    state: np.ndarray
    stretch: np.ndarray
    moisture: np.ndarray
    critical: np.ndarray

    def of(self, elements: np.ndarray) -> SalivaRecord:
        """The record of these elements (S,) in this order.

        Raises
        ------
        InputError : other elements than those of the record
        """
        order = np.argsort(self.elements, kind="stable")
        if not np.array_equal(self.elements[order], np.sort(elements)):
            raise InputError(
                f"expected a record of the {len(elements)} elements of the mouth's saliva, got one of "
                f"{len(self.elements)}, other ones among them; give the mouth that was solved"
            )
        columns = order[np.searchsorted(self.elements[order], elements)]
        values = (np.asarray(one)[:, columns] for one in (self.state, self.stretch, self.moisture, self.critical))
        return SalivaRecord(np.asarray(elements), *values)


@dataclass(frozen=True, eq=False)
class Motion:
    """Positions of all nodes over time.

    Parameters
    ----------
    time_s : (T,) saved times, s, increasing
    positions : (T, N, 3) m
    nodes : (N, 3) positions at rest, m
    energies : name -> (T,) J, the names of `ENERGIES`: kinetic, elastic and hourglass energy held at that time, energy
        taken by damping and by the saliva and done by external forces and prescribed displacements since the start,
        and the residual kinetic + elastic + hourglass + damping + saliva - external, which is 0 but for the error of
        the time stepping
    dt_s : time step, s
    steps : number of steps done
    stopped : why the run ended early, or None
    settings : everything the run depended on, for provenance
    velocities : (T, N, 3) m/s, or None where they were not asked for
    saliva : the saliva's states, or None where the model has none
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
    saliva: SalivaRecord | None = None

    @property
    def displacements(self) -> np.ndarray:
        """(T, N, 3) m, relative to the rest positions."""
        return self.positions - self.nodes
