"""`lipmetrics validate`: simulated clips are filmed, measured and scored, and all of it is said in one report.

Clips and scores are kept in the output folder, each as soon as it is there: a run that was stopped goes on where it
was, and nothing is done twice. A clip is made anew when its settings or the simulator's code have changed, and measured
anew when the code of this package has. What films is handed over by the command line, as this package knows nothing of
the simulator.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from lipmetrics.atomic import whole_file
from lipmetrics.console import sentence
from lipmetrics.detect import METHODS, make_detector
from lipmetrics.errors import InputError
from lipmetrics.profile import without_nan
from lipmetrics.validation import by_condition, figures
from lipmetrics.validation_verdict import calibration, targets, verdict, worst_frames

CLIPS, SCORED = "clips", "scored"  # folders
BATCH = 12  # clips of one movement that are filmed by one process: it is solved anew for the next ones
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_OF_THE_REPORT = ("validate.py", "validation_page.py", "validation_verdict.py", "cli.py")  # they change no score


@dataclass(frozen=True)
class ClipFacts:
    """A clip of a suite.

    Parameters
    ----------
    clip : its name
    axis, setting, condition : what is particular about it
    take, action, face : what is filmed
    mouth_px : width of the mouth, px
    key : changes with everything that the clip is made from
    content : what `film` makes it from
    """

    clip: str
    axis: str
    setting: str
    condition: str
    take: str
    action: str
    face: str
    mouth_px: float
    key: str
    content: object


# clips of one movement, a folder -> why they cannot be filmed, or nothing; writes <key>.mp4 and its truth
Film = Callable[[Sequence[ClipFacts], Path], str]


def validate(
    clips: Sequence[ClipFacts],
    film: Film,
    folder: str | Path,
    *,
    method: str = "default",
    jobs: int | None = None,
    progress: bool = False,
    facts: dict | None = None,
) -> dict:
    """Film, measure and score clips, and write frames.csv, clips.csv, conditions.csv, summary.json, report.html.

    Those of another method than the default are in a folder of its name inside `folder`; the clips are the same.

    Parameters
    ----------
    clips : what to film; those of one `take` are filmed by one process
    film : a function of a module, as it is called in other processes
    folder : for clips, scores and the report
    method : as in `lipmetrics.measure`
    jobs : processes; None takes two, or as many as there are cores if these are fewer
    progress : show a bar with the time left
    facts : what the report says about the suite

    Returns
    -------
    summary, as summary.json has it, with the `text` to print

    Raises
    ------
    InputError : an unknown method, a folder that cannot be written to, or no clip that could be scored
    """
    started = time.perf_counter()
    folder = Path(folder)
    if method not in METHODS:
        make_detector(method, None, None)  # says which there are
    code = code_hash()
    scores = {one.clip: folder / SCORED / f"{one.key}.{method}.{code}.csv" for one in clips}
    waiting = [one for one in clips if not scores[one.clip].exists()]
    work = _Work({}, {}, 0.0)
    batches = _batches(waiting)
    if batches:
        work = _work(batches, film, folder, method, scores, jobs or default_jobs(), progress)
    failed, dropped = work.failed, work.dropped
    rows = {one.clip: _read(scores[one.clip]) for one in clips if one.clip not in failed | dropped}
    if not rows:
        reasons = "; ".join(Counter([*failed.values(), *dropped.values()]))
        raise InputError(f"expected a clip that can be scored, got none: {reasons}")
    frames = pd.concat([table.assign(clip=name) for name, table in rows.items()], ignore_index=True)
    scored_s = time.perf_counter() - started
    from lipmetrics.validation_page import write_report

    table = pd.DataFrame([{name: getattr(one, name) for name in _COLUMNS} for one in clips if one.clip in rows])
    conditions = by_condition(frames, table)
    conditions.insert(3, "verdict", [verdict(row) for _, row in conditions.iterrows()])
    of_clips = pd.DataFrame([figures(group) for _, group in frames.groupby("clip", sort=False)])
    of_clips = pd.concat([table, of_clips.drop(columns="clips")], axis=1)
    summary = {
        "method": method,
        "facts": facts or {},
        "clips": len(rows),
        "frames": len(frames),
        "failed": failed,
        "dropped": dropped,
        "targets": targets(frames, table, conditions, len(failed)),
        "figures": figures(frames),
        "confidence": calibration(frames).to_dict("records"),
        "clips_made_and_measured": len(waiting),
        "seconds": round(scored_s, 1),
        "processor_seconds": round(work.processor_s, 1),
    }
    place = folder if method == "default" else folder / method
    _write_csv(frames[["clip", *frames.columns.drop("clip")]], place / "frames.csv")
    _write_csv(of_clips, place / "clips.csv")
    _write_csv(conditions, place / "conditions.csv")
    keys = {one.clip: folder / CLIPS / one.key for one in clips}
    worst = worst_frames(frames, table)
    write_report(place, summary, frames, table, conditions, worst, keys)
    with whole_file(place / "summary.json") as part:
        part.write_text(json.dumps(without_nan(summary), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    return summary | {"text": _text(summary, conditions, place)}


_COLUMNS = ("clip", "axis", "setting", "condition", "take", "action", "face", "mouth_px")


def default_jobs() -> int:
    """Two processes, or fewer where there are fewer cores."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(2, cores)


def code_hash() -> str:
    """Of the files of this package that a score can depend on."""
    digest = hashlib.sha256()
    here = Path(__file__).parent
    for path in sorted(here.rglob("*")):
        is_code = path.suffix == ".py" and path.name not in _OF_THE_REPORT
        if is_code or (path.parent.name == "data" and path.is_file()):
            digest.update(str(path.relative_to(here)).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def _batches(clips: Iterable[ClipFacts]) -> list[list[ClipFacts]]:
    """Clips of one movement together, `BATCH` at most, the largest batches first."""
    of: dict[str, list[ClipFacts]] = {}
    for one in clips:
        of.setdefault(one.take, []).append(one)
    batches = [same[k : k + BATCH] for same in of.values() for k in range(0, len(same), BATCH)]
    return sorted(batches, key=len, reverse=True)


@dataclass
class _Work:
    """failed, dropped : clip -> why; processor_s : time of all processes"""

    failed: dict[str, str]
    dropped: dict[str, str]
    processor_s: float


def _work(batches, film: Film, folder: Path, method: str, scores, jobs: int, progress: bool) -> _Work:
    from tqdm import tqdm

    done = _Work({}, {}, 0.0)
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))  # the processes take it over; the cores are theirs
    context = multiprocessing.get_context("spawn")
    bar = tqdm(total=sum(map(len, batches)), desc="clips", unit="clip", disable=not progress, leave=False)
    pool = ProcessPoolExecutor(min(jobs, len(batches)), mp_context=context)
    try:
        paths = [[scores[one.clip] for one in batch] for batch in batches]
        tasks = {
            pool.submit(score_batch, batch, film, folder / CLIPS, method, of_batch): batch
            for batch, of_batch in zip(batches, paths, strict=True)
        }
        for task in as_completed(tasks):
            failed, reason, spent_s = task.result()
            done.failed |= failed
            done.dropped |= {one.clip: reason for one in tasks[task] if reason}
            done.processor_s += spent_s
            bar.update(len(tasks[task]))
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        bar.close()
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
    return done


def score_batch(
    batch: Sequence[ClipFacts], film: Film, folder: Path, method: str, scores: Sequence[Path]
) -> tuple[dict[str, str], str, float]:
    """Film those clips of a batch that are not there, measure and score all; writes a table of frames each.

    Returns
    -------
    failed : clip -> error of the method
    reason : why the batch could not be filmed, or nothing
    processor_s : time that it took on all threads
    """
    started = time.process_time()

    import cv2

    from lipmetrics.accuracy import load_truth
    from lipmetrics.pipeline import measure
    from lipmetrics.validation import score_frames

    cv2.setNumThreads(1)
    missing = [one for one in batch if not (folder / f"{one.key}.mp4").exists()]
    if missing and (reason := film(missing, folder)):
        return {}, reason, time.process_time() - started
    failed = {}
    for one, path in zip(batch, scores, strict=True):
        try:
            measured = measure(folder / f"{one.key}.mp4", method=method, keep_outlines=True)
        except Exception as error:  # a method that breaks is a finding, not the end
            failed[one.clip] = sentence(error)
            continue
        _write_csv(score_frames(measured, load_truth(folder / one.key)), path)
    return failed, "", time.process_time() - started


def _write_csv(table: pd.DataFrame, path: Path) -> None:
    with whole_file(path) as part:
        table.to_csv(part, index=False, float_format="%.6g", lineterminator="\n")


def _read(path: Path) -> pd.DataFrame:
    try:
        return pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise InputError(f"expected the scores {path}, but: {' '.join(str(error).split())}; delete them") from None


def _text(summary: dict, conditions: pd.DataFrame, folder: Path) -> list[str]:
    lines = []
    for row in summary["targets"]:
        met = {True: "met", False: "not met", None: "-"}[row["met"]]
        lines.append(f"{met:8} {row['what']}: {row['all']} (goal {row['goal']}; mix {row['mix']})")
    counts = Counter(conditions["verdict"])
    lines.append("conditions: " + ", ".join(f"{count} {name}" for name, count in counts.items()))
    if summary["failed"] or summary["dropped"]:
        lines.append(f"{len(summary['failed'])} clips broke the method, {len(summary['dropped'])} could not be solved")
    lines.append(
        f"{summary['clips']} clips, {summary['frames']} frames, {summary['seconds']:.0f} s, "
        f"{summary['processor_seconds']:.0f} s of processors"
    )
    return [*lines, f"open {folder / 'report.html'} in a browser"]
