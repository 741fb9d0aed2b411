"""Measure all clips of a corpus into one store: on all cores or a cluster, never twice, and past broken ones.

Each clip that is done is kept at once as a whole file in the folder `<store>.parts` beside the store. The store is made
of these and of the store that was there, by one process, at the end. So a run that is killed goes on where it was.

A clip is unchanged, and not measured again, where its content (SHA-256) and how it is measured (method, settings, part
of the video, versions of everything that can change a number) are the same. Files whose names, sizes and times of
change are as they were are not read for that.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import lru_cache
from pathlib import Path

from corpus_tools.clips import Clip
from corpus_tools.store import (
    Key,
    Store,
    about_differs,
    check_name,
    flush_to_disk,
    store_of_clip,
    store_of_failure,
    write_store,
)
from corpus_tools.workers import Outcome, cores_n, on_dask, work
from lipmetrics.atomic import whole_file
from lipmetrics.errors import InputError
from lipmetrics.frames import _pictures_of as pictures_of

PARTS, ENDING = ".parts", ".h5"


def run(
    clips: Sequence[Clip],
    store: str | Path,
    *,
    jobs: int | None = None,
    dask: str | None = None,
    method: str = "default",
    reread: bool = False,
    progress: bool = False,
) -> dict:
    """Measure what the store does not have yet, and make the store anew.

    Parameters
    ----------
    clips : of different names; clips of the store that are not among them stay as they are
    store : path of the store, made if needed
    jobs : processes; None is one for every core
    dask : address of a Dask scheduler, instead of `jobs`; its workers see the clips under the same absolute paths
    method : as in `lipmetrics.measure`
    reread : compare the contents of all files, also of those that look unchanged
    progress : show clips done and the time left on stderr

    Returns
    -------
    `text` to print; `failed`, a list of `{"source", "error"}`; `done_n` clips of these in the store, of which
    `measured_n` were measured now and `unchanged_n` before; `store`, its path

    Raises
    ------
    InputError : no clips, two of one name, an unknown method, a store that cannot be read or written, another run that
        writes it, or no worker
    """
    store = Path(store)
    by_name = _checked(clips)
    settings = {clip.name: _settings_sha256(clip, method) for clip in clips}
    with ExitStack() as stack:
        parts = stack.enter_context(_parts_folder(store))
        old = _old_store(store, stack)
        kept = _Kept(parts, old)
        jobs_todo, seen_now = [], {}
        for clip in clips:
            seen = seen_of(clip.path)
            key = kept.keys.get(clip.name)
            same = key is not None and key.settings_sha256 == settings[clip.name] and key.lasting
            if same and seen == key.seen and seen and not reread:
                continue
            known = key.source_sha256 if same else None
            there = dataclasses.replace(clip, path=clip.path.absolute())
            jobs_todo.append((clip.name, (there, method, settings[clip.name], known)))
        outcomes = (
            on_dask(dask, "corpus_tools.batch:measure_clip", jobs_todo)
            if dask and jobs_todo
            else work("corpus_tools.batch:measure_clip", jobs_todo, jobs or cores_n())
        )
        stack.enter_context(closing(outcomes))  # ends the workers, whatever happens here
        tried = set()
        for outcome in _with_progress(outcomes, len(jobs_todo), progress):
            if isinstance(outcome.value, str):
                raise InputError(outcome.value)
            clip = by_name[outcome.key]
            seen, part = _part_of(outcome, clip, settings[clip.name])
            if part is None:
                seen_now[clip.name] = seen
            else:
                tried.add(clip.name)
                kept.keep(clip.name, part)
        _merge(store, parts, kept, old, list(clips), seen_now, stack)
    return _answer(store, by_name, tried)


def measure_clip(
    clip: Clip, method: str, settings_sha256: str, known_sha256: str | None
) -> tuple[str, bytes | None] | str:
    """Measure a clip, in a worker.

    Parameters
    ----------
    known_sha256 : of the content that was measured before in the same way; None if it was not

    Returns
    -------
    seen : of its files, as `Key.seen`
    part : a store of this clip, measured or failed; None where it is unchanged

    or one sentence, where this worker would measure other than the process that sent the clip

    Raises
    ------
    OSError : a file changed while it was measured
    """
    from lipmetrics.pipeline import measure, source_facts

    if _settings_sha256(clip, method) != settings_sha256:
        return (
            "expected the same versions of lipmetrics, Python and its packages here and on the workers, got others; "
            "install the same everywhere"
        )
    seen, sha256 = seen_of(clip.path), ""
    try:
        if known_sha256 is not None and source_facts(clip.path)["sha256"] == known_sha256:
            return seen, None
        profile = measure(clip.path, method=method, fps=clip.fps, start_s=clip.start_s, stop_s=clip.stop_s)
    except InputError as error:
        with suppress(InputError, OSError):  # not there or not to be read, so tried again next time
            sha256 = source_facts(clip.path)["sha256"]
        return seen, store_of_failure(clip, str(error), Key(sha256, settings_sha256, seen, True, bool(sha256)))
    if seen_of(clip.path) != seen:
        raise OSError(f"{clip.path} changed while it was measured; run it again")
    return seen, store_of_clip(clip, profile, Key(profile.meta["source"]["sha256"], settings_sha256, seen))


def seen_of(path: Path) -> str:
    """Short hash of names, sizes and times of change of a video or its pictures; empty where they are not there."""
    try:
        paths = [path] if path.is_file() else pictures_of(path)
        facts = [(one.name, one.stat().st_size, one.stat().st_mtime_ns) for one in paths]
    except (InputError, OSError):
        return ""
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:16]


# -- parts -------------------------------------------------------------------------------------------------------------


class _Kept:
    """What has been measured: parts beside the store, which count first, and the store that was there."""

    def __init__(self, folder: Path, old: Store | None):
        self.folder = folder
        self.keys: dict[str, Key] = {} if old is None else old.keys()
        self.parts: dict[str, Path] = {}
        for path in sorted(folder.iterdir()):
            try:
                with Store(path) as part:
                    ((name, key),) = part.keys().items()
            except (InputError, OSError, KeyError, ValueError):  # cut off by a power failure, or not ours
                path.unlink()
                continue
            self.keys[name], self.parts[name] = key, path

    def keep(self, name: str, part: bytes) -> None:
        path = self.folder / (hashlib.sha256(name.encode()).hexdigest()[:24] + ENDING)
        with whole_file(path) as file:
            file.write_bytes(part)
        self.parts[name] = path


def _part_of(outcome: Outcome, clip: Clip, settings_sha256: str) -> tuple[str, bytes | None]:
    if outcome.error is None:
        return outcome.value
    seen = seen_of(clip.path)
    return seen, store_of_failure(clip, outcome.error, Key("", settings_sha256, seen, failed=True, lasting=False))


def _merge(store: Path, folder: Path, kept: _Kept, old: Store | None, clips, seen_now, stack: ExitStack) -> None:
    """Make the store of the parts and the old store, unless nothing is new; then the parts are not needed any more."""
    sources = {} if old is None else dict.fromkeys(old.keys(), store)
    is_new = old is None or bool(kept.parts) or bool(seen_now)
    is_new = is_new or any(about_differs(old, clip) for clip in clips)
    if is_new:
        new = folder / f"merged{ENDING}"
        sources |= kept.parts
        try:
            new.unlink(missing_ok=True)
            write_store(new, sources, clips, seen_now)
            flush_to_disk(new)
            os.replace(new, store)
        except OSError as error:
            new.unlink(missing_ok=True)
            raise InputError(
                f"expected to write {store}, but: {error.strerror or error}; free some space and run it again, which "
                "goes on from here"
            ) from error
    shutil.rmtree(folder)


@contextmanager
def _parts_folder(store: Path) -> Iterator[Path]:
    """The folder for the parts, ours alone until the end; it goes once it is empty."""
    folder = store.with_name(store.name + PARTS)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = _locked(folder, store)
    except OSError as error:
        raise InputError(
            f"expected to write {folder}, but: {error.strerror or error}; choose another place for the store"
        ) from None
    try:
        yield folder
    finally:
        if lock is not None:
            os.close(lock)
        with suppress(OSError):  # not empty, or gone already
            folder.rmdir()


def _locked(folder: Path, store: Path) -> int | None:
    """A lock that goes with the process, however it ends; None where there are no such locks."""
    try:
        import fcntl
    except ImportError:
        return None
    lock = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        raise InputError(
            f"expected {store} to be written by one run at a time, another is at work; wait for it or choose another -o"
        ) from None
    except OSError:
        pass  # a file system without locks
    return lock


def _old_store(store: Path, stack: ExitStack) -> Store | None:
    return stack.enter_context(Store(store)) if store.exists() else None


# -- the rest ----------------------------------------------------------------------------------------------------------


def _checked(clips: Sequence[Clip]) -> dict[str, Clip]:
    if not clips:
        raise InputError("expected one clip or more to measure, got none")
    by_name: dict[str, Clip] = {}
    for clip in clips:
        check_name(clip.name)
        if by_name.setdefault(clip.name, clip) is not clip:
            raise InputError(
                f"expected clips of different names, got {clip.name} for {by_name[clip.name].path} and {clip.path}"
            )
    return by_name


@lru_cache(maxsize=8)
def _method_facts(method: str) -> str:
    """A method with its settings and all versions, as JSON."""
    from lipmetrics.detect import make_detector
    from lipmetrics.pipeline import versions

    settings = dataclasses.asdict(make_detector(method, None, info=None).settings)
    return json.dumps([method, settings, versions()], sort_keys=True)


def _settings_sha256(clip: Clip, method: str) -> str:
    part = {"start_s": clip.start_s, "stop_s": clip.stop_s, "fps": clip.fps}
    return hashlib.sha256(f"{_method_facts(method)}{json.dumps(part)}".encode()).hexdigest()


def _with_progress(outcomes: Iterator[Outcome], total: int, progress: bool) -> Iterator[Outcome]:
    if not progress:
        return outcomes
    from tqdm import tqdm

    return iter(tqdm(outcomes, total=total, unit="clip", desc="measured", smoothing=0.05, file=sys.stderr))


def _answer(path: Path, by_name: dict[str, Clip], tried: set[str]) -> dict:
    with Store(path) as store:
        reasons = {name: reason for name, reason in store.failed.items() if name in by_name}
    failed = [{"source": str(by_name[name].path), "error": reason} for name, reason in sorted(reasons.items())]
    done_n, measured_n = len(by_name) - len(failed), len(tried - set(reasons))
    return {
        "text": [f"{done_n} of {len(by_name)} clips in {path}, {measured_n} measured now"],
        "failed": failed,
        "done_n": done_n,
        "measured_n": measured_n,
        "unchanged_n": done_n - measured_n,
        "store": str(path),
    }
