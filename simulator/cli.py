"""Command line of the simulator: `lipmetrics simulate SCENE -o out`, or `python -m simulator.cli ...`.

What it runs are scenes of mouths (built in, or TOML files) and any models given in NiftySim's XML.

Exit codes: 0 done, 2 bad arguments or input, 3 some items failed or a run ended early, 130 stopped by Ctrl-C, 143 by
SIGTERM; a run that was stopped leaves the states so far and a checkpoint.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import math
import os
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from simulator.errors import InputError, Interrupted
from simulator.wording import choices, nearest

if TYPE_CHECKING:
    from simulator.model import Model
    from simulator.scene import Scene

DONE, BAD_INPUT, SOME_FAILED, STOPPED = 0, 2, 3, 130
PRECISIONS = ("float32", "mixed", "float64")
DEVICES = ("cpu", "cuda")
RESOLUTIONS = ("low", "medium", "high")
EXPORTS = ("obj", "pc2", "gltf", "vtu")
MODELS_ONLY = ("vtu", "velocity")
CORPUS_ONLY = ("repeats", "jobs", "quick", "anew")
NO_CORPUS = ("face", "truth_only", "export", "vtu", "velocity", "resume", "threads", "device")
QUICK = {"resolution": "low", "frame_rate": 30.0, "size": (256, 256)}
SCENES_ONLY = ("stickiness", "face", "resolution", "truth_only", "frame_rate", "size", "seed", "export")


def main(argv: list[str] | None = None, prog: str = "python -m simulator.cli") -> int:
    """Run one command line, called `prog`; returns the exit code."""
    try:
        arguments = _parser(prog).parse_args(argv)
        with _terminated_in_order():
            return run(arguments)
    except InputError as error:
        _complain(str(error))
        return BAD_INPUT
    except (MemoryError, OSError) as error:
        _complain(_sentence(error))
        return BAD_INPUT
    except KeyboardInterrupt:
        _complain("stopped; what was finished before is kept")
        return STOPPED


@contextmanager
def _terminated_in_order() -> Iterator[None]:
    """Let SIGTERM end the command as Ctrl-C does: files that are half written disappear, a run is saved."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def leave(number, frame):
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def run(arguments: argparse.Namespace) -> int:
    """Every scene to its clips and every model to its results; goes past those that fail."""
    if arguments.list:
        return _list(arguments.json)
    if arguments.print is not None:
        return _print(arguments.print)
    if arguments.corpus is not None:
        return _run_corpus(arguments)
    for name in CORPUS_ONLY:
        if getattr(arguments, name):
            raise InputError(f"expected --corpus N, a number of people, to go with --{name}, got none")
    jobs, failed = _jobs(arguments)
    missing = len(failed)
    for folder in dict.fromkeys(job.folder for job in jobs):
        _prepare(folder)
    done, signal_got = [], None
    for job in jobs:
        try:
            summary, signal_got = (_run_model if job.scene is None else _run_scene)(job, arguments)
            done.append((job, summary))
            if signal_got:
                break
        except (InputError, MemoryError, OSError) as error:
            failed.append({"source": job.source, "error": _sentence(error)})
            _complain(_sentence(error))
    if arguments.json:
        summary = {
            "models": [one for job, one in done if job.scene is None],
            "clips": [one for job, one in done if job.scene is not None],
            "failed": failed,
        }
        _say(json.dumps({"command": "simulate", **summary}, indent=2, ensure_ascii=False))
    elif len(jobs) + missing > 1:
        what = "models run" if all(job.scene is None for job in jobs) else "clips made"
        _say(f"{len(done)} of {len(jobs) + missing} {what}")
    if signal_got:
        return 128 + signal_got
    if failed and not done:
        return BAD_INPUT
    return SOME_FAILED if failed or any(one["stopped"] for _, one in done) else DONE


@dataclasses.dataclass(frozen=True)
class _Job:
    """One run: a model's file, or a scene at one level of stickiness.

    Parameters
    ----------
    source : as given
    folder, stem : where its files go and what they are called
    scene : None for a model
    """

    source: str
    folder: Path
    stem: str
    scene: Scene | None = None


def _jobs(arguments: argparse.Namespace) -> tuple[list[_Job], list[dict]]:
    """What is to be run, and the scenes that cannot be."""
    if not arguments.models:
        raise InputError("the following arguments are required: MODEL or SCENE; 'simulate --list' shows the scenes")
    are_models = {source: _is_model(source) for source in arguments.models}
    for chosen, kind, others in ((MODELS_ONLY, "models", "scene"), (SCENES_ONLY, "scenes", "model")):
        given = [name for name in chosen if getattr(arguments, name)]
        if given and set(are_models.values()) == {kind == "scenes"}:
            raise InputError(
                f"expected {kind} to go with --{given[0].replace('_', '-')}, got a {others}: {arguments.models[0]}"
                + ("; use --export vtu" if given[0] == "vtu" else "")
            )
    jobs, failed = [], []
    for source in arguments.models:
        if not are_models[source]:
            try:
                jobs += _scene_jobs(source, arguments)
            except InputError as error:
                failed.append({"source": source, "error": _sentence(error)})
                _complain(_sentence(error))
        elif arguments.out is None:
            raise InputError("the following arguments are required: -o/--out, for models")
        else:
            jobs.append(_Job(source, Path(arguments.out), Path(source).stem))
    _check_stems(jobs)
    return jobs, failed


def _scene_jobs(source: str, arguments: argparse.Namespace) -> list[_Job]:
    """A scene with each face and at each level that is asked for."""
    from simulator.scene import load_scene

    scene = _with_choices(load_scene(source), arguments)
    folder = Path(scene.name if arguments.out is None else arguments.out)
    try:
        scenes = [(scene.name, scene)]
        if arguments.face is not None:
            scenes = [(f"{face.replace('_', '-')}_{scene.name}", scene.with_face(face)) for face in arguments.face]
        if arguments.stickiness is not None:
            levels = arguments.stickiness
            scenes = [(f"{stem}_{level:g}", one.with_stickiness(level)) for stem, one in scenes for level in levels]
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    return [_Job(source, folder, stem, one) for stem, one in scenes]


def _with_choices(scene: Scene, arguments: argparse.Namespace) -> Scene:
    """The scene with what the command line says otherwise."""

    def changed(part, **values):
        return dataclasses.replace(part, **{name: value for name, value in values.items() if value is not None})

    width, height = arguments.size or (None, None)
    return changed(
        scene,
        face=changed(scene.face, resolution=arguments.resolution),
        solve=changed(scene.solve, dt_s=arguments.dt, precision=arguments.precision),
        output=changed(scene.output, frame_rate=arguments.frame_rate),
        camera=changed(scene.camera, width_px=width, height_px=height),
        seed=arguments.seed,
    )


def _is_model(source: str) -> bool:
    """Whether this is NiftySim's XML, by its ending or by how it begins."""
    path = Path(source)
    if path.suffix.lower() in (".xml", ".toml"):
        return path.suffix.lower() == ".xml"
    try:
        with path.open("rb") as file:
            return file.read(200).removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<")
    except OSError:
        return False


def _run_scene(job: _Job, arguments: argparse.Namespace) -> tuple[dict, int | None]:
    """Summary of one clip, and the signal that broke it off, if any."""
    from simulator.clip import make_clip, unfinished

    saved = job.folder / f"{job.stem}.checkpoint.npz"
    _check_resume(arguments, job.source, saved)
    started = time.perf_counter()
    signal_got = None
    try:
        clip = make_clip(
            job.scene,
            job.folder,
            stem=job.stem,
            truth_only=arguments.truth_only,
            exports=arguments.export or (),
            threads=arguments.threads,
            device=arguments.device or "cpu",
            progress=sys.stderr.isatty(),
            checkpoint_every_s=arguments.checkpoint_every,
            resume=arguments.resume,
        )
        motion, files, seconds = clip.motion, clip.files, clip.seconds
    except Interrupted as interrupted:
        motion, signal_got, seconds = interrupted.motion, interrupted.signal, {}
        files = (unfinished(job.folder, job.stem),)
    except InputError as error:
        raise InputError(f"{job.source}: {error}") from None
    if motion.stopped:
        _complain(f"{job.source}: {motion.stopped}; the states before are kept in {files[0]}")
    summary = {
        "source": job.source,
        "name": job.stem,
        "stickiness": job.scene.saliva.stickiness,
        "files": [str(path) for path in files],
        "nodes": len(motion.nodes),
        "dt_s": motion.dt_s,
        "steps": motion.steps,
        "states": len(motion.time_s),
        "frames": len(job.scene.frame_times_s),
        "seconds": round(time.perf_counter() - started, 3),
        "seconds_of": seconds,
        "energy_residual_j": _last(motion.energies.get("residual_j", ())),
        "stopped": None if motion.stopped is None else dataclasses.asdict(motion.stopped),
    }
    if not arguments.json and not motion.stopped:
        _say(
            f"{job.stem}: {summary['frames']} frames, stickiness {summary['stickiness']:g}, {motion.steps} steps of "
            f"{motion.dt_s:.3g} s, {summary['seconds']:.3g} s -> {job.folder}{os.sep}{job.stem}.*"
        )
    return summary, signal_got


def _run_corpus(arguments: argparse.Namespace) -> int:
    """`--corpus N`: N people do all scenes at all levels."""
    from simulator.corpus import LEVELS, SCENES, Corpus, make_corpus
    from simulator.scene import load_scene

    for name in NO_CORPUS:
        if getattr(arguments, name):
            raise InputError(f"expected no --{name.replace('_', '-')} with --corpus, got one; leave it out")
    if arguments.out is None:
        raise InputError("the following arguments are required: -o/--out, with --corpus")
    if arguments.quick:
        for name, value in QUICK.items():
            if getattr(arguments, name) is None:
                setattr(arguments, name, value)
    for source in arguments.models:
        if _is_model(source):
            raise InputError(f"expected scenes to go with --corpus, got a model: {source}")
    scenes = tuple(_with_choices(load_scene(source), arguments) for source in arguments.models or SCENES)
    corpus = Corpus(
        arguments.corpus,
        scenes,
        LEVELS if arguments.stickiness is None else arguments.stickiness,
        arguments.repeats or 1,
        arguments.seed or 0,
    )
    started = time.perf_counter()
    made = make_corpus(corpus, arguments.out, jobs=arguments.jobs, progress=sys.stderr.isatty(), anew=arguments.anew)
    for one in made["failed"]:
        _complain(f"{one['source']}: {one['error']}")
    seconds = round(time.perf_counter() - started, 3)
    done_n = made["clips_n"] - len(made["failed"])
    if arguments.json:
        _say(json.dumps({"command": "simulate", **made, "seconds": seconds}, indent=2, ensure_ascii=False))
    else:
        _say(
            f"{done_n} of {made['clips_n']} clips in {made['clips']}, {made['made_n']} made now, {seconds:.3g} s; "
            f"their names: --template '{made['template']}'"
        )
    return DONE if not made["failed"] else SOME_FAILED if done_n else BAD_INPUT


def _list(as_json: bool) -> int:
    """The built-in scenes and what they show."""
    from simulator.scene import load_scene, scene_names

    about = {name: load_scene(name).about for name in scene_names()}
    if as_json:
        _say(json.dumps({"command": "simulate", "scenes": about}, indent=2, ensure_ascii=False))
    else:
        width = max(map(len, about))
        _say("\n".join(f"{name:{width}}  {text}" for name, text in about.items()))
    return DONE


def _print(name: str) -> int:
    from simulator.scene import scene_text

    _say(scene_text(name).rstrip("\n"))
    return DONE


def _run_model(job: _Job, arguments: argparse.Namespace) -> tuple[dict, int | None]:
    """Summary of one run of a model, and the signal that broke it off, if any."""
    from simulator import export
    from simulator.niftysim_xml import read_niftysim
    from simulator.solver import solve

    source, folder, stem = job.source, job.folder, job.stem
    model = read_niftysim(source)
    times = _times(model)
    if arguments.dt is not None:
        model = dataclasses.replace(model, dt_s=arguments.dt)
    saved = folder / f"{stem}.checkpoint.npz"
    _check_resume(arguments, source, saved)
    chosen = {name: getattr(arguments, name) for name in ("precision", "threads", "device")}
    chosen = {name: value for name, value in chosen.items() if value is not None}
    provenance = {
        "source": Path(source).name,
        "sha256": hashlib.sha256(Path(source).read_bytes()).hexdigest(),
        "choices": {"dt": arguments.dt, **chosen},
    }
    started = time.perf_counter()
    signal_got = None
    try:
        motion = solve(
            model,
            times,
            progress=sys.stderr.isatty(),
            velocities=arguments.velocity,
            checkpoint_path=saved,
            checkpoint_every_s=arguments.checkpoint_every,
            resume=arguments.resume,
            **chosen,
        )
    except Interrupted as interrupted:
        motion, signal_got = interrupted.motion, interrupted.signal
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    seconds = time.perf_counter() - started
    files = [folder / f"{stem}.h5", folder / f"{stem}.energy.csv"]
    export.write_motion(motion, model, files[0], provenance)
    export.write_energies(motion, files[1])
    if arguments.vtu:
        files += export.write_vtk(motion, model, folder / f"{stem}.pvd", _ticker("states for ParaView"))
    if motion.stopped:
        _complain(f"{source}: {motion.stopped}; the states before are kept")
    if not (signal_got and motion.stopped):
        saved.unlink(missing_ok=True)
    summary = {
        "source": source,
        "files": [str(path) for path in files],
        "element_type": model.element_type,
        "elements": len(model.elements),
        "nodes": len(model.nodes),
        "dt_s": motion.dt_s,
        "steps": motion.steps,
        "states": len(motion.time_s),
        "seconds": round(seconds, 3),
        "largest_displacement_m": float(abs(motion.displacements).max(initial=0.0)),
        "work_j": _last(motion.energies["external_j"]),
        "energy_residual_j": _last(motion.energies["residual_j"]),
        "stopped": None if motion.stopped is None else dataclasses.asdict(motion.stopped),
    }
    if not arguments.json:
        _say(_in_words(summary))
    return summary, signal_got


def _times(model: Model) -> np.ndarray | None:
    """The times that the file asks for by its own step, whatever step is taken, and the end."""
    if model.output_every is None:
        return None
    interval = model.output_every * model.dt_s
    count = math.ceil((model.duration_s - model.dt_s / 2) / interval)
    return np.append(interval * np.arange(count), model.duration_s)


def _in_words(summary: dict) -> str:
    steps = (
        f"{summary['steps']} steps of {summary['dt_s']:.3g} s, {summary['states']} states, {summary['seconds']:.3g} s"
    )
    return (
        f"{summary['source']}: {summary['elements']} {summary['element_type']} elements, {steps}, "
        f"largest displacement {summary['largest_displacement_m']:.4g} m, work {summary['work_j']:.4g} J, "
        f"of which {summary['energy_residual_j']:.2g} J unaccounted for -> {summary['files'][0]}"
    )


def _last(values) -> float:
    return float(values[-1]) if len(values) else 0.0


def _check_resume(arguments: argparse.Namespace, source: str, saved: Path) -> None:
    if arguments.resume and not saved.exists():
        raise InputError(
            f"{source}: expected the checkpoint of an interrupted run in {saved}, got no such file; "
            "leave out --resume to start the run anew"
        )


def _check_stems(jobs: list[_Job]) -> None:
    """Two runs of one name would replace each other's results unseen."""
    count = Counter((str(job.folder), job.stem.lower()) for job in jobs)
    for (_, stem), often in count.most_common(1):
        if often > 1:
            raise InputError(
                f"expected models of different names, got {often} named '{stem}'; run them into folders of their own"
            )


def _prepare(folder: Path) -> None:
    """Find out before the work, not after it, that nothing can be written."""
    probe = folder / f".simulator.{os.getpid()}.part"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"expected an output folder to write to, got {folder}: {reason}; choose another -o") from None


def _ticker(what: str):
    def tick(frames):
        from tqdm import tqdm

        return tqdm(frames, desc=what, leave=False, disable=not sys.stderr.isatty())

    return tick


def _sentence(error: Exception) -> str:
    """One line for any error."""
    if isinstance(error, MemoryError):
        return "ran out of memory; close other programs or save fewer states"
    return " ".join(str(error).split()) or type(error).__name__


def _complain(text: str) -> None:
    print(f"simulate: {text}", file=sys.stderr)


def _say(text: str) -> None:
    """Print a result; once nobody reads on, the work goes on in silence."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line instead of a page of usage."""

    def error(self, message: str):
        self.exit(BAD_INPUT, f"{self.prog}: {message}; see '{self.prog} --help'\n")


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = _Parser(
        prog=prog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Make ground-truth clips of sticky mouths from scenes, or run models given in NiftySim's XML.\n"
        "Beside the video of a clip lie the exact openings of its every frame.",
        epilog=f"example: {prog} slow_open --stickiness 7 -o clip\n         {prog} --corpus 5 -o corpus\n"
        f"         {prog} model.xml -o out --vtu",
    )
    add_arguments(parser)
    return parser


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments that `run` reads."""
    parser.add_argument(
        "models",
        nargs="*",
        metavar="SCENE",
        help="scene: a TOML file or a built-in name; or a NiftySim model (XML)",
    )
    parser.add_argument(
        "-o", "--out", metavar="DIR", help="folder for the results, made if needed; default: SCENE's name"
    )
    parser.add_argument("--list", action="store_true", help="show the built-in scenes and what they show")
    parser.add_argument("--print", metavar="NAME", help="write out a built-in scene, to be changed: > my_scene.toml")
    scenes = parser.add_argument_group("scenes")
    scenes.add_argument(
        "--stickiness",
        type=_levels,
        metavar="L[,L]",
        help="level from 0 to 10 in place of the scene's; a clip for each",
    )
    scenes.add_argument(
        "--face",
        type=_names,
        metavar="NAME[,NAME]",
        help="built-in face in place of the scene's; a clip for each, named after it",
    )
    scenes.add_argument("--resolution", choices=RESOLUTIONS, help="mesh; default: the scene's")
    scenes.add_argument("--truth-only", action="store_true", help="make the tables of the truth and no pictures")
    scenes.add_argument("--frame-rate", type=_above_zero, metavar="N", help="pictures per second; default: the scene's")
    scenes.add_argument("--size", type=_size, metavar="WxH", help="size of the pictures, px; default: the scene's")
    scenes.add_argument(
        "--seed", type=_whole, metavar="N", help="of skin texture, teeth and noise; default: the scene's"
    )
    scenes.add_argument("--export", type=_exports, metavar="KIND[,KIND]", help=f"also write {choices(EXPORTS)}")
    corpus = parser.add_argument_group("a corpus")
    corpus.add_argument(
        "--corpus",
        type=_count,
        metavar="N",
        help="N people, each with a face, a skin and a light of their own, do all scenes at all levels; without scenes "
        "and levels: the six actions of the study at 0, 4, 7, 10. What is there already is not made again",
    )
    corpus.add_argument("--repeats", type=_count, metavar="N", help="of each clip, with other noise; default: 1")
    corpus.add_argument("--jobs", type=_count, metavar="N", help="processes; default: one for every core")
    corpus.add_argument("--quick", action="store_true", help="low mesh, 256x256 at 30 per second, to try it out")
    corpus.add_argument("--anew", action="store_true", help="make all clips again")
    parser = parser.add_argument_group("running")
    parser.add_argument("--vtu", action="store_true", help="models: also write the states for ParaView (.pvd, .vtu)")
    parser.add_argument("--dt", type=_time_step, metavar="S", help="time step, s, or auto; default: the model's own")
    parser.add_argument("--precision", choices=PRECISIONS, help="arithmetic; default: what the solver takes by itself")
    parser.add_argument("--threads", type=_count, metavar="N", help="threads; default: what is fastest")
    parser.add_argument("--device", choices=DEVICES, help="cuda: solve on an NVIDIA card; default: the processor")
    parser.add_argument("--velocity", action="store_true", help="models: also save nodal velocities, m/s")
    parser.add_argument(
        "--checkpoint-every",
        type=_seconds,
        default=60.0,
        metavar="S",
        help="save the run in DIR/NAME.checkpoint.npz after every S seconds of work; default: 60. Ctrl-C saves it too",
    )
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoint of a run that was interrupted")
    parser.add_argument("--json", action="store_true", help="print one machine-readable summary on stdout")


def _time_step(text: str) -> float | str:
    if text == "auto":
        return text
    value = _number_or_nan(text)
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"expected a time step above 0 s such as 1e-4, or auto, got '{text}'")
    return value


def _seconds(text: str) -> float:
    value = _number_or_nan(text)
    if not 0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"expected a number of seconds of 0 or more, got '{text}'")
    return value


def _above_zero(text: str) -> float:
    value = _number_or_nan(text)
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"expected a number above 0, got '{text}'")
    return value


def _names(text: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(part.strip() for part in text.split(",")))


def _levels(text: str) -> tuple[float, ...]:
    """`0,4,7` to its numbers, each once."""
    levels = tuple(dict.fromkeys(_number_or_nan(part) for part in text.split(",")))
    if not all(0 <= level < math.inf for level in levels):
        raise argparse.ArgumentTypeError(f"expected levels from 0 to 10 such as 7 or 0,4,7,10, got '{text}'")
    return levels


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().partition("x")
    if not (width.isascii() and width.isdigit() and height.isascii() and height.isdigit()):
        raise argparse.ArgumentTypeError(f"expected a size in px such as 640x480, got '{text}'")
    return int(width), int(height)


def _exports(text: str) -> tuple[str, ...]:
    kinds = tuple(dict.fromkeys(text.split(",")))
    for kind in kinds:
        if kind not in EXPORTS:
            raise argparse.ArgumentTypeError(f"expected exports of {choices(EXPORTS)}, got {nearest(kind, EXPORTS)}")
    return kinds


def _whole(text: str) -> int:
    if not text.isascii() or not text.isdigit():
        raise argparse.ArgumentTypeError(f"expected a whole number of 0 or more, got '{text}'")
    return int(text)


def _number_or_nan(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _count(text: str) -> int:
    if not text.isascii() or not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, got '{text}'")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())
