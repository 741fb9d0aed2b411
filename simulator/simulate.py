"""From a scene to the motion of its mouth."""

from __future__ import annotations

from pathlib import Path

from simulator import symmetry
from simulator.errors import InputError, Interrupted
from simulator.model import Model
from simulator.motion import Motion
from simulator.mouth import Mouth
from simulator.scene import Scene
from simulator.solver import solve


def simulate(
    scene: Scene,
    *,
    parts: tuple[Mouth, Model] | None = None,
    threads: int | None = None,
    device: str = "cpu",
    progress: bool = False,
    checkpoint_path: str | Path | None = None,
    checkpoint_every_s: float = 60.0,
    resume: bool = True,
) -> Motion:
    """Compute how the mouth of a scene moves.

    A scene that is mirror-symmetric is solved on one half.

    Parameters
    ----------
    scene : mouth, saliva, muscles
    parts : mesh and model of the scene, where they are known already; None takes those of `scene.model()`
    threads : number of threads; None measures what is fastest. The result does not depend on it
    device : as for `solver.solve`
    progress : show a progress bar with the time left
    checkpoint_path, checkpoint_every_s, resume : as for `solver.solve`

    Returns
    -------
    Motion at `scene.state_times_s`; `stopped` says why a run ended early

    Raises
    ------
    InputError : a scene that cannot be solved
    Interrupted : Ctrl-C; a KeyboardInterrupt with the motion so far
    """
    _, model = parts or scene.model()
    half = _half(model, scene.solve.symmetric)
    how = scene.solve
    try:
        motion = solve(
            model if half is None else half.model,
            scene.state_times_s,
            precision=how.precision,
            threads=threads,
            device=device,
            safety=how.safety,
            mass_scaling=how.mass_scaling,
            checkpoint_path=checkpoint_path,
            checkpoint_every_s=checkpoint_every_s,
            resume=resume,
            progress=progress,
        )
    except Interrupted as interrupted:
        if half is not None:
            interrupted.motion = half.mirrored(interrupted.motion)
        raise
    return motion if half is None else half.mirrored(motion)


def _half(model: Model, symmetric: bool | str) -> symmetry.Half | None:
    """One half of the model, or None where the whole is to be solved."""
    if symmetric is False:
        return None
    try:
        return symmetry.half(model)
    except InputError:
        if symmetric == "auto":
            return None
        raise
