"""A run on disk: its arrays, and a fingerprint of what it was a run of."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from simulator.atomic import whole_file
from simulator.errors import InputError
from simulator.model import Model

VERSION = 4  # to be raised when the same model takes other bits, or the arrays of a checkpoint change


def fingerprint(model: Model, settings: tuple) -> str:
    """SHA-256 over everything that decides the bits of a run. Curves enter by their values at 1,025 times."""
    digest = hashlib.sha256(f"{VERSION}".encode())
    t = np.linspace(0, model.duration_s, 1025)
    for array in (model.nodes, model.elements, model.material_of):
        digest.update(np.ascontiguousarray(array).tobytes())
    for load in model.loads:
        digest.update(type(load).__name__.encode())
        for name, value in vars(load).items():
            digest.update(np.asarray(value.value(t) if name == "shape" else value, dtype=float).tobytes())
    if model.saliva is not None:
        for value in vars(model.saliva).values():
            if isinstance(value, np.ndarray):
                digest.update(value.tobytes())
        licks = [(lick.time_s, lick.saliva.tolist(), lick.moisture) for lick in model.saliva.licks]
        digest.update(repr((licks, model.saliva.decay_s, model.saliva.ramp_s)).encode())
    numbers = (model.element_type, model.materials, model.damping, model.hourglass, model.dt_s, model.duration_s)
    digest.update(repr((numbers, settings)).encode())
    return digest.hexdigest()


def save(path: str | Path, run: str, arrays: dict[str, np.ndarray]) -> None:
    """Write the arrays of the run with fingerprint `run`; an older checkpoint stays until the new one is complete."""
    with whole_file(path) as part, part.open("wb") as file:
        np.savez(file, run=np.array(run), **arrays)


def load(path: str | Path, run: str) -> dict[str, np.ndarray] | None:
    """The arrays saved at `path`, or None where there is no file.

    Raises
    ------
    InputError : a file that is no checkpoint or is damaged, or that of another run
    """
    if not Path(path).exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except Exception as error:  # a damaged zip or array raises any of a dozen kinds
        raise InputError(
            f"expected a checkpoint in {path}, got a file that is damaged or something else ({error}); "
            "delete it and start the run anew"
        ) from None
    if str(arrays.pop("run", "")) != run:
        raise InputError(
            f"expected the checkpoint of this run in {path}, got that of another model or other settings; "
            "delete it or name another file"
        )
    return arrays
