"""A simulated corpus: people x scenes x levels of stickiness x repeats, each a clip with its truth, on all cores.

    OUT/clips/p01_slow-open_7_1.mp4           the videos, and nothing else
    OUT/truth/p01_slow-open_7_1.frames.csv    what is really there, and the scene to make the clip again
    OUT/corpus.json                           who the people are, and all that the corpus was made from

A clip is made in a hidden folder and moved to its place when it is complete, the file that says so last. A clip that
is there, made from the same scene by the same versions, is not made again: a run that was stopped is started again
with the same words.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import multiprocessing
import os
import shutil
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from simulator import export
from simulator.atomic import whole_file
from simulator.clip import clip_sources, make_clip
from simulator.errors import InputError
from simulator.people import Person, people
from simulator.scene import Scene, load_scene

SCENES = ("slow_open", "fast_open", "m", "p", "mummy", "puppy")  # the actions of the study
LEVELS = (0.0, 4.0, 7.0, 10.0)  # and its levels of stickiness
MOST_CLIPS_N = 1_000_000
CLIPS, TRUTH, PARTS, RECORD = "clips", "truth", ".parts", "corpus.json"
LOSSES_N = 3  # of a worker, after which the run gives up
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Corpus:
    """What is in a corpus.

    Parameters
    ----------
    people_n : how many
    scenes : what they do; their names are those of the actions, `_` written as `-`
    levels : of stickiness
    repeats_n : of each; they differ in the noise of the camera
    seed : of people and noise
    """

    people_n: int
    scenes: tuple[Scene, ...] = ()
    levels: tuple[float, ...] = LEVELS
    repeats_n: int = 1
    seed: int = 0
    people: tuple[Person, ...] = field(init=False)

    def __post_init__(self):
        if not self.scenes:
            object.__setattr__(self, "scenes", tuple(map(load_scene, SCENES)))
        names = [action(scene).lower() for scene in self.scenes]
        if double := next((name for name in names if names.count(name) > 1), None):
            raise InputError(f"expected scenes of different names, got '{double}' twice")
        if self.repeats_n < 1:
            raise InputError(f"expected 1 or more repeats, got {self.repeats_n}")
        clips_n = self.people_n * len(self.scenes) * len(self.levels) * self.repeats_n
        if clips_n > MOST_CLIPS_N:
            raise InputError(f"expected at most {MOST_CLIPS_N} clips, got {clips_n}; make several corpora")
        object.__setattr__(self, "people", people(self.people_n, self.seed))

    @property
    def template(self) -> str:
        """Of the names of the clips, as `lipmetrics corpus --template` wants it."""
        level = "d" if all(float(level).is_integer() for level in self.levels) else "number"
        return f"{{speaker}}_{{action}}_{{stickiness:{level}}}_{{repeat:d}}"

    def clips(self) -> Iterator[tuple[str, Scene]]:
        """Name and scene of each clip.

        Raises
        ------
        InputError : a level that a scene cannot be brought to, or a scene whose face is a file
        """
        for person in self.people:
            for scene in self.scenes:
                if scene.face.obj is not None:
                    raise InputError(f"expected scenes whose face can be another's, got {scene.face.obj}")
                played = person.plays(scene)
                for level in self.levels:
                    for repeat in range(1, self.repeats_n + 1):
                        name = f"{person.name}_{action(scene)}_{level:g}_{repeat}"
                        yield name, _with_noise(played.with_stickiness(level), self.seed, person, name)


def action(scene: Scene) -> str:
    """What a scene is called in names of clips, whose parts `_` divides."""
    return scene.name.replace("_", "-")


def make_corpus(
    corpus: Corpus, folder: str | Path, *, jobs: int | None = None, progress: bool = False, anew: bool = False
) -> dict:
    """Make the clips of a corpus that are not there yet.

    Parameters
    ----------
    folder : made if needed; other files in it stay
    jobs : processes; None is one for every core
    progress : show clips done and the time left on stderr
    anew : make all clips again

    Returns
    -------
    `clips_n` clips wanted, `made_n` made now, `unchanged_n` there before; `failed`, a list of
    `{"source": name, "error": sentence}`; `people`, `template`, `clips` and `truth` (folders)

    Raises
    ------
    InputError : what `Corpus.clips` refuses, a place that cannot be written to, another run at work there, or processes
        that end again and again
    """
    folder = Path(folder)
    todo = {name: (name, scene, folder, anew) for name, scene in corpus.clips()}
    failed, made_n = [], 0
    with _alone(folder) as parts:
        _write_record(corpus, folder)
        outcomes = _work(todo, min(jobs or cores_n(), len(todo)))
        if progress:
            from tqdm import tqdm

            outcomes = tqdm(outcomes, total=len(todo), unit="clip", desc="made", smoothing=0.05, file=sys.stderr)
        for name, (is_new, error) in outcomes:
            made_n += is_new
            if error is not None:
                failed.append({"source": name, "error": error})
        with suppress(OSError):
            parts.rmdir()
    failed.sort(key=lambda one: one["source"])
    return {
        "clips_n": len(todo),
        "made_n": made_n,
        "unchanged_n": len(todo) - made_n - len(failed),
        "people": [dataclasses.asdict(person) for person in corpus.people],
        "template": corpus.template,
        "clips": str(folder / CLIPS),
        "truth": str(folder / TRUTH),
        "failed": failed,
    }


def cores_n() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


# -- one clip ----------------------------------------------------------------------------------------------------------


def _make(name: str, scene: Scene, folder: Path, anew: bool) -> tuple[bool, str | None]:
    """Whether a clip was made, or why it could not be; in a process of its own."""
    try:
        if not anew and _is_there(name, scene, folder):
            return False, None
        parts = folder / PARTS / name
        shutil.rmtree(parts, ignore_errors=True)
        try:
            clip = make_clip(scene, parts, stem=name, lossless=False, extras=False, threads=1)
            if clip.motion.stopped is not None:
                return False, str(clip.motion.stopped)
            _move(parts, folder, name)
        finally:
            shutil.rmtree(parts, ignore_errors=True)
    except (InputError, MemoryError, OSError) as error:
        return False, " ".join(str(error).split()) or "ran out of memory; use fewer --jobs"
    return True, None


def _is_there(name: str, scene: Scene, folder: Path) -> bool:
    """Whether the clip was made from this scene, by these versions."""
    try:
        facts = json.loads(_said_by(folder, name).read_text(encoding="utf-8"))
        made_from = facts["sha256"]
    except (OSError, ValueError, KeyError, TypeError):
        return False
    if facts.get("versions") != export.versions() or not (folder / CLIPS / f"{name}.mp4").is_file():
        return False
    return made_from == {source: hashlib.sha256(data).hexdigest() for source, data in clip_sources(scene, name).items()}


def _move(parts: Path, folder: Path, name: str) -> None:
    """Bring what was made to its place; what says that the clip is complete goes first and comes last."""
    done = _said_by(folder, name)
    for place in (folder / CLIPS, folder / TRUTH):
        place.mkdir(exist_ok=True)
    done.unlink(missing_ok=True)
    for path in sorted(parts.iterdir(), key=lambda path: path.name == done.name):
        os.replace(path, folder / (CLIPS if path.suffix == ".mp4" else TRUTH) / path.name)


def _said_by(folder: Path, name: str) -> Path:
    return folder / TRUTH / f"{name}.clip.json"


def _with_noise(scene: Scene, seed: int, person: Person, name: str) -> Scene:
    """The scene with the texture and teeth of a person, which are the same in all clips, and noise of its own."""

    def drawn(text: str) -> int:
        return int.from_bytes(hashlib.sha256(f"{seed} {text}".encode()).digest()[:4])

    return dataclasses.replace(
        scene, seed=drawn(person.name), sensor=dataclasses.replace(scene.sensor, seed=drawn(name))
    )


# -- all of them -------------------------------------------------------------------------------------------------------


def _work(todo: dict[str, tuple], processes_n: int) -> Iterator[tuple[str, tuple[bool, str | None]]]:
    """Make clips in processes of their own, which end when this one does; gives what became of each as it comes."""
    left = dict(todo)
    for _ in range(LOSSES_N):
        try:
            with _pool(processes_n) as pool:
                running: dict[Future, str] = {pool.submit(_make, *job): name for name, job in left.items()}
                for future in as_completed(running):
                    answer = future.result()
                    del left[running[future]]
                    yield running[future], answer
            return
        except BrokenProcessPool:  # killed, or out of memory; what it was at is made again
            continue
    raise InputError(
        f"expected processes that make clips, but one was ended from outside {LOSSES_N} times, perhaps for want of "
        "memory; use fewer --jobs, and run it again to go on from here"
    )


@contextmanager
def _pool(processes_n: int) -> Iterator[ProcessPoolExecutor]:
    context = multiprocessing.get_context("spawn")
    theirs, ours = context.Pipe(duplex=False)
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    pool = ProcessPoolExecutor(processes_n, mp_context=context, initializer=_begin, initargs=(theirs,))
    try:
        yield pool
    except BaseException:
        ours.close()  # ends them at once
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        for end in (ours, theirs):
            end.close()
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _begin(line) -> None:
    """In each process: leave Ctrl-C to the one that started it, and end when the line to that one is cut."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end() -> None:
        with suppress(EOFError, OSError):
            line.recv()
        os._exit(1)

    threading.Thread(target=end, daemon=True).start()


@contextmanager
def _alone(folder: Path) -> Iterator[Path]:
    """The folder for what is being made, ours alone; what an earlier run left there half-made goes."""
    parts = folder / PARTS
    try:
        parts.mkdir(parents=True, exist_ok=True)
        lock = _locked(parts, folder)
    except OSError as error:
        raise InputError(
            f"expected an output folder to write to, got {folder}: {error.strerror or error}; choose another -o"
        ) from None
    try:
        for path in parts.iterdir():
            shutil.rmtree(path, ignore_errors=True)
        yield parts
    finally:
        if lock is not None:
            os.close(lock)


def _locked(parts: Path, folder: Path) -> int | None:
    """A lock that goes with the process, however it ends; None where there are no such locks."""
    try:
        import fcntl
    except ImportError:
        return None
    lock = os.open(parts, os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        raise InputError(
            f"expected {folder} to be written by one run at a time, another is at work; wait for it or choose another "
            "-o"
        ) from None
    except OSError:
        pass  # a file system without locks
    return lock


def _write_record(corpus: Corpus, folder: Path) -> None:
    """Who the people are, and all that the corpus was made from; no time of day."""
    record = {
        "people": [dataclasses.asdict(person) for person in corpus.people],
        "actions": [action(scene) for scene in corpus.scenes],
        "stickiness": list(corpus.levels),
        "repeats_n": corpus.repeats_n,
        "seed": corpus.seed,
        "template": corpus.template,
        "versions": export.versions(),
    }
    with whole_file(folder / RECORD) as part:
        part.write_text(json.dumps(record, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
