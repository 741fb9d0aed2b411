"""A scene to a folder of files: motion, truth, pictures, and what animators take away (docs/scenes.md lists them).

The files of a clip are made in a hidden folder beside their place and moved there together when all are complete: a run
that fails leaves what was there before.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
import queue
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulator import export
from simulator.errors import InputError, Interrupted
from simulator.model import Model
from simulator.motion import Motion
from simulator.mouth import Mouth
from simulator.scene import Scene
from simulator.settings import to_toml
from simulator.simulate import simulate
from simulator.wording import choices, nearest

EXPORTS = ("obj", "pc2", "gltf", "vtu")
UNFINISHED = ".unfinished"  # in the names of the states of a run that did not reach its end


@dataclass(frozen=True, eq=False)
class Clip:
    """What `make_clip` made.

    Parameters
    ----------
    scene, mouth, motion : what is in it; `motion.stopped` says why a run ended early
    files : the files, in order of name; of a run that ended early only its states
    seconds : work -> time it took, s
    """

    scene: Scene
    mouth: Mouth
    motion: Motion
    files: tuple[Path, ...]
    seconds: dict[str, float]


def make_clip(
    scene: Scene,
    folder: str | Path,
    *,
    stem: str | None = None,
    truth_only: bool = False,
    people: bool = True,
    lossless: bool = True,
    extras: bool = True,
    exports: Sequence[str] = (),
    threads: int | None = None,
    device: str = "cpu",
    progress: bool = False,
    checkpoint_every_s: float = 60.0,
    resume: bool = False,
) -> Clip:
    """Simulate a scene and write all that comes of it.

    Parameters
    ----------
    scene : what to film
    folder : where the files go; made if needed
    stem : what they are called; None takes the scene's name
    truth_only : make no pictures and no page to view
    people : write the H.264 video for people
    lossless : write the lossless one; one of both at least is written
    extras : keep the motion and energies, and the page to view
    exports : any of `EXPORTS`
    threads : of the solver; None measures what is fastest
    device : that the solver runs on, as for `solver.solve`
    progress : show bars with the time left
    checkpoint_every_s : seconds of work after which the run is saved in `<stem>.checkpoint.npz`
    resume : go on from that file if it is there

    Raises
    ------
    InputError : a scene that cannot be solved, an unknown export, a place that cannot be written to. Once solved, the
        states are kept in `<stem>.unfinished.h5`
    Interrupted : Ctrl-C while it was being solved; the states so far are kept there, and the run can be resumed
    """
    folder, stem = Path(folder), stem or scene.name
    for one in exports:
        if one not in EXPORTS:
            raise InputError(f"expected exports of {choices(EXPORTS)}, got {nearest(one, EXPORTS)}")
    if not (people or lossless or truth_only):
        raise InputError("expected a video for people, a lossless one or the truth only, got none of them")
    mouth, model = scene.model()
    sources = clip_sources(scene, stem)
    facts = {"scene": stem, "sha256": {name: hashlib.sha256(data).hexdigest() for name, data in sources.items()}}
    seconds: dict[str, float] = {}
    saved = folder / f"{stem}.checkpoint.npz"

    def keep(motion: Motion) -> tuple[Path, ...]:
        return _write_motion(motion, model, folder, stem + UNFINISHED, facts)

    with _work_folder(folder, stem) as work:
        try:
            with _timed(seconds, "solve"):
                motion = simulate(
                    scene,
                    parts=(mouth, model),
                    threads=threads,
                    device=device,
                    progress=progress,
                    checkpoint_path=saved,
                    checkpoint_every_s=checkpoint_every_s,
                    resume=resume,
                )
        except Interrupted as interrupted:
            keep(interrupted.motion)
            raise
        saved.unlink(missing_ok=True)
        if motion.stopped is not None:
            return Clip(scene, mouth, motion, keep(motion), seconds)
        try:
            if extras:
                export.write_motion(motion, model, work / f"{stem}.h5", facts)
            for name, data in sources.items():
                (work / name).write_bytes(data)
            with _timed(seconds, "truth"):
                truth = _write_truth(scene, mouth, motion, work, stem)
            if not truth_only:
                with _timed(seconds, "render"):
                    kinds = ("lossless",) * lossless + ("people",) * people
                    _write_videos(scene, mouth, motion, work, stem, kinds, _ticker("pictures", progress))
            if extras and not truth_only:
                with _timed(seconds, "page"):
                    _write_page(scene, mouth, motion, truth, work, stem)
            if exports:
                with _timed(seconds, "export"):
                    _export(scene, mouth, motion, work, stem, exports, _ticker("exports", progress))
            _write_provenance(mouth, motion, work, stem, facts)
            files = _move(work, folder)
        except (InputError, OSError) as error:
            raise InputError(f"{_reason(error)}; the motion is kept in {keep(motion)[0]}") from None
        except BaseException:
            keep(motion)
            raise
        for ending in (".h5", ".energy.csv"):
            (folder / f"{stem}{UNFINISHED}{ending}").unlink(missing_ok=True)
    return Clip(scene, mouth, motion, files, seconds)


def unfinished(folder: str | Path, stem: str) -> Path:
    """Where `make_clip` keeps the states of a run that did not reach its end."""
    return Path(folder) / f"{stem}{UNFINISHED}.h5"


def clip_sources(scene: Scene, stem: str) -> dict[str, bytes]:
    """Name -> content of the files that make this clip again: the scene with all it leaves out, and its surfaces."""
    whole = dataclasses.replace(scene.spelled_out(), name=stem)
    files = {}

    def copied(path: str | None, what: str) -> str | None:
        if path is None:
            return None
        name = f"{stem}.{what}.obj"
        try:
            files[name] = Path(path).read_bytes()
        except OSError as error:
            raise InputError(f"expected the surface {path}, but: {error.strerror or error}") from None
        return name

    face = dataclasses.replace(whole.face, obj=copied(whole.face.obj, "face"))
    actions = tuple(
        dataclasses.replace(action, volume_obj=copied(action.volume_obj, f"muscle{number}"))
        for number, action in enumerate(whole.muscle, start=1)
    )
    text = to_toml(dataclasses.replace(whole, face=face, muscle=actions))
    return {f"{stem}.scene.toml": text.encode(), **files}


def _write_motion(motion: Motion, model: Model, folder: Path, stem: str, facts: dict) -> tuple[Path, ...]:
    files = folder / f"{stem}.h5", folder / f"{stem}.energy.csv"
    export.write_motion(motion, model, files[0], facts)
    export.write_energies(motion, files[1])
    return files


def _write_provenance(mouth: Mouth, motion: Motion, folder: Path, stem: str, facts: dict) -> None:
    """What the clip was made from and how; no time of day, so that the same scene gives the same bytes."""
    text = json.dumps(
        {
            **facts,
            "versions": export.versions(),
            "elements": len(mouth.elements),
            "nodes": len(mouth.nodes),
            "dt_s": motion.dt_s,
            "steps": motion.steps,
            "states": len(motion.time_s),
            "solver": motion.settings,
            "energy_j": {name: float(values[-1]) for name, values in motion.energies.items()},
            "files": sorted(path.name for path in folder.iterdir()),
        },
        indent=2,
        sort_keys=True,
    )
    (folder / f"{stem}.clip.json").write_text(text + "\n", encoding="utf-8")


@contextmanager
def _work_folder(folder: Path, stem: str) -> Iterator[Path]:
    """A hidden folder for files that are not complete yet; it disappears whatever happens."""
    work = folder / f".{stem}.{os.getpid()}.part"
    try:
        work.mkdir(parents=True)
    except OSError as error:
        raise InputError(
            f"expected an output folder to write to, got {folder}: {error.strerror or error}; choose another one"
        ) from None
    try:
        yield work
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _move(work: Path, folder: Path) -> tuple[Path, ...]:
    """Move everything from the one folder to the other, over what is there."""
    moved = []
    for path in sorted(work.iterdir()):
        target = folder / path.name
        if path.is_dir() and target.is_dir():
            shutil.rmtree(target)
        os.replace(path, target)
        moved.append(target)
    return tuple(moved)


@contextmanager
def _timed(seconds: dict[str, float], work: str) -> Iterator[None]:
    started = time.perf_counter()
    yield
    seconds[work] = round(time.perf_counter() - started, 3)


def _ticker(what: str, progress: bool) -> Callable:
    def tick(frames, total: int | None = None):
        from tqdm import tqdm

        return tqdm(frames, desc=what, total=total, leave=False, disable=not progress)

    return tick


def _reason(error: BaseException) -> str:
    if isinstance(error, OSError):
        return f"expected to write the clip, but: {' '.join(str(error).split())}"
    return str(error)


# -- what other modules know ------------------------------------------------------------------------------------------


def _write_truth(scene: Scene, mouth: Mouth, motion: Motion, folder: Path, stem: str):
    """Write the tables of the truth; returns it."""
    from simulator.truth import truth

    found = truth(motion, mouth, scene.camera, scene.frame_times_s)
    found.save(folder, stem)
    return found


def _write_videos(scene: Scene, mouth: Mouth, motion: Motion, folder: Path, stem: str, kinds, tick) -> None:
    """Draw every frame once, into a lossless video, one for people, or both."""
    from simulator.video import write_video

    rate, times = scene.output.frame_rate, scene.frame_times_s
    writers = {
        "lossless": lambda frames: write_video(folder / f"{stem}.mkv", frames, rate),
        "people": lambda frames: write_video(folder / f"{stem}.mp4", map(_even, frames), rate, "h264"),
    }
    frames = tick(pictures(scene, mouth, motion, times), total=len(times))
    if len(kinds) == 1:
        writers[kinds[0]](frames)
    else:
        _read_twice(frames, *(writers[kind] for kind in kinds))


def pictures(scene: Scene, mouth: Mouth, motion: Motion, times_s: np.ndarray) -> Iterator[np.ndarray]:
    """(H, W, 3) uint8 pictures of a scene at some times, s, as its clip shows them."""
    from simulator.render import render

    jaw = _lower_teeth(scene, mouth)
    settings = {"times_s": times_s, "frame_rate": scene.output.frame_rate, "mode": scene.output.mode, "jaw": jaw}
    return render(motion, mouth, scene.camera, scene.look, **settings)


def _lower_teeth(scene: Scene, mouth: Mouth) -> Callable:
    """From a time, s, to how the renderer wants the jaw: its angle, degrees, and y and z of its joint, m."""
    moved = scene.jaw(mouth)

    def jaw(time_s: float) -> tuple[float, tuple[float, float]]:
        angle, joint = moved.transform(time_s)
        return math.degrees(angle), (float(joint[1]), float(joint[2]))

    return jaw


def _read_twice(frames: Iterator[np.ndarray], first: Callable, second: Callable) -> None:
    """Give the frames, which come but once, to two functions that read them all; the second has a thread of its own."""
    passed: queue.Queue = queue.Queue(maxsize=8)

    def received() -> Iterator[np.ndarray]:
        while (frame := passed.get()) is not None:
            yield frame

    with ThreadPoolExecutor(1) as pool:
        other = pool.submit(second, received())

        def hand(frame: np.ndarray | None) -> None:
            while not other.done():
                try:
                    return passed.put(frame, timeout=0.2)
                except queue.Full:
                    continue
            return other.result()  # it has given up: says why

        def handed_on() -> Iterator[np.ndarray]:
            for frame in frames:
                hand(frame)
                yield frame

        try:
            first(handed_on())
        finally:
            hand(None)
    other.result()


def _even(frame: np.ndarray) -> np.ndarray:
    """Without the last row or column where their number is odd, as players of H.264 want it."""
    height, width = frame.shape[:2]
    return frame[: height // 2 * 2, : width // 2 * 2]


def _write_page(scene: Scene, mouth: Mouth, motion: Motion, truth, folder: Path, stem: str) -> None:
    from simulator.viewer import write_page

    path, title = folder / f"{stem}.view.html", f"{stem}: {scene.about}" if scene.about else stem
    write_page(path, mouth, motion, title=title, times_s=scene.frame_times_s, truth_frames=truth.frames_m)


def _export(scene: Scene, mouth: Mouth, motion: Motion, folder: Path, stem: str, exports: Sequence[str], tick) -> None:
    from simulator import animation

    times = scene.frame_times_s
    if "obj" in exports:
        animation.write_obj_sequence(folder / f"{stem}_obj" / f"{stem}.obj", mouth, motion, times, tick=tick)
    if "pc2" in exports:
        animation.write_pc2(folder / f"{stem}.pc2", mouth, motion, times)
    if "gltf" in exports:
        animation.write_gltf(folder / f"{stem}.glb", mouth, motion, times)
    if "vtu" in exports:
        animation.write_paraview(folder / f"{stem}.pvd", mouth, motion, times, tick=tick)
