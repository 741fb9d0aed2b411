"""Command line of the solver: `lipmetrics simulate model.xml -o out`, or `python -m simulator.cli ...`.

Exit codes: 0 done, 2 bad arguments or input, 3 some models failed or a run ended early, 130 stopped by Ctrl-C, 143 by
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

if TYPE_CHECKING:
    from simulator.model import Model

DONE, BAD_INPUT, SOME_FAILED, STOPPED = 0, 2, 3, 130
PRECISIONS = ("float32", "mixed", "float64")


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
    """Every model to its results; goes past models that fail."""
    folder = Path(arguments.out)
    _check_stems(arguments.models)
    _prepare(folder)
    done, failed, signal_got = [], [], None
    for source in arguments.models:
        try:
            summary, signal_got = _run_one(source, folder, arguments)
            done.append(summary)
            if signal_got:
                break
        except (InputError, MemoryError, OSError) as error:
            failed.append({"source": source, "error": _sentence(error)})
            _complain(_sentence(error))
    if arguments.json:
        _say(json.dumps({"command": "simulate", "models": done, "failed": failed}, indent=2, ensure_ascii=False))
    elif len(arguments.models) > 1:
        _say(f"{len(done)} of {len(arguments.models)} models run")
    if signal_got:
        return 128 + signal_got
    if failed and not done:
        return BAD_INPUT
    return SOME_FAILED if failed or any(one["stopped"] for one in done) else DONE


def _run_one(source: str, folder: Path, arguments: argparse.Namespace) -> tuple[dict, int | None]:
    """Summary of one run, and the signal that broke it off, if any."""
    from simulator import export
    from simulator.niftysim_xml import read_niftysim
    from simulator.solver import solve

    model = read_niftysim(source)
    times = _times(model)
    if arguments.dt is not None:
        model = dataclasses.replace(model, dt_s=arguments.dt)
    stem = Path(source).stem
    saved = folder / f"{stem}.checkpoint.npz"
    if arguments.resume and not saved.exists():
        raise InputError(
            f"{source}: expected the checkpoint of an interrupted run in {saved}, got no such file; "
            "leave out --resume to start the run anew"
        )
    chosen = {name: getattr(arguments, name) for name in ("precision", "threads")}
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


def _check_stems(sources: list[str]) -> None:
    """Two models of one name would replace each other's results unseen."""
    count = Counter(Path(source).stem.lower() for source in sources)
    stem, often = count.most_common(1)[0]
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
        description="Run models of deformable bodies given in NiftySim's XML.",
        epilog=f"example: {prog} model.xml -o out --vtu",
    )
    add_arguments(parser)
    return parser


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments that `run` reads."""
    parser.add_argument("models", nargs="+", metavar="MODEL", help="NiftySim model (XML)")
    parser.add_argument("-o", "--out", required=True, metavar="DIR", help="folder for the results, made if needed")
    parser.add_argument("--vtu", action="store_true", help="also write the states for ParaView (.pvd, .vtu)")
    parser.add_argument("--dt", type=_time_step, metavar="S", help="time step, s, or auto; default: the model's own")
    parser.add_argument("--precision", choices=PRECISIONS, help="arithmetic; default: what the solver takes by itself")
    parser.add_argument("--threads", type=_count, metavar="N", help="threads; default: what is fastest")
    parser.add_argument("--velocity", action="store_true", help="also save nodal velocities, m/s, with each state")
    parser.add_argument(
        "--checkpoint-every",
        type=_seconds,
        default=60.0,
        metavar="S",
        help="save the run in DIR/MODEL.checkpoint.npz after every S seconds of work; default: 60. Ctrl-C saves it too",
    )
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoint of a run that was interrupted")
    parser.add_argument("--json", action="store_true", help="print one machine-readable summary on stdout")


def _time_step(text: str) -> float | str:
    if text == "auto":
        return text
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"expected a time step above 0 s such as 1e-4, or auto, got '{text}'")
    return value


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"expected a number of seconds of 0 or more, got '{text}'")
    return value


def _count(text: str) -> int:
    if not text.isascii() or not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, got '{text}'")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())
