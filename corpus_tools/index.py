"""Checks of a corpus before the work: what is missing, doubled, unreadable, or filmed so that it cannot be measured.

Videos are not decoded for this but for three pictures at most (`corpus_tools.facts`).
"""

from __future__ import annotations

import csv
import hashlib
import math
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from corpus_tools.clips import Clip
from corpus_tools.facts import COLUMNS, Facts, clip_facts
from corpus_tools.workers import Outcome, cores_n, work
from lipmetrics.atomic import whole_file
from lipmetrics.console import sentence
from lipmetrics.errors import InputError
from lipmetrics.frames import _pictures_of as pictures_of

# kinds of problems, in the order in which they are told
KINDS = (
    *("missing", "not expected", "name", "doubled", "unreadable", "length", "frame rate", "light"),
    *("no mouth", "small", "turned", "cut off"),
)
ALONE_N = 8  # clips up to which starting processes takes longer than it saves
NAMED_N = 5  # clips named in a line of the summary


@dataclass(frozen=True)
class Limits:
    """Beyond these a clip has a problem.

    Parameters
    ----------
    length_s : difference from the length that is expected; at least 1.5 pictures are allowed
    shortest_s : where no length is expected
    fps : least pictures per second
    fps_differs : from most clips of the corpus, as a share
    longest_step : in median steps; 2 is one picture left out
    dark, bright : mean grey level around the mouth, 0 to 255
    clipped : share of black and white pixels there
    mouth_width_px : least
    tilt_deg : of the mouth
    off_middle : of the mouth in the face, face widths
    margin_mw : least distance of the lips from the edge of the picture, mouth widths
    """

    length_s: float = 0.1
    shortest_s: float = 0.2
    fps: float = 20.0
    fps_differs: float = 0.01
    longest_step: float = 1.9
    dark: float = 40.0
    bright: float = 225.0
    clipped: float = 0.2
    mouth_width_px: float = 30.0
    tilt_deg: float = 20.0
    off_middle: float = 0.15
    margin_mw: float = 0.12


def index(
    clips: Sequence[Clip],
    out: str | Path,
    *,
    misfits: Sequence[tuple[Path, str]] = (),
    expected: Sequence[str] | None = None,
    clip_s: float | None = None,
    limits: Limits | None = None,
    jobs: int | None = None,
    progress: bool = False,
) -> dict:
    """Check all clips and write a table.

    Parameters
    ----------
    out : the table (CSV): a row per clip, per missing clip and per misfit: name, path, problems, the fields of the
        names, and `corpus_tools.facts.Facts`
    misfits : files that are no clips, with the reason
    expected : names of the clips that should be there; None does not look for missing ones
    clip_s : how long clips should be, s
    jobs : processes; None is one for every core

    Returns
    -------
    `text` to print; `failed`, a line for every kind of problem that there is; `done_n` clips looked at; `problems`,
    names of clips by kind; `table`, its path

    Raises
    ------
    InputError : the table cannot be written
    """
    limits = limits or Limits()
    out = Path(out)
    if out.is_dir():
        raise InputError(f"expected a table to write, got {out}, a folder; choose another -o, such as {out}/index.csv")
    facts, errors = _looked_at(clips, jobs or cores_n(), progress)
    rates = Counter(round(one.fps, 1) for one in facts.values() if not math.isnan(one.fps))
    usual_fps = min(rates, key=lambda fps: (-rates[fps], fps)) if rates else math.nan
    doubled = _doubled(clips)
    rows = []
    for clip in clips:
        found: list[tuple[str, str]] = []
        if expected is not None and clip.name not in set(expected):
            found.append(("not expected", "the protocol has no such clip"))
        if clip.name in doubled:
            found.append(("doubled", f"the same content as {doubled[clip.name]}"))
        if clip.name in errors:
            found.append(("unreadable", errors[clip.name]))
        else:
            found += check(facts[clip.name], limits, usual_fps, clip_s)
        one = facts.get(clip.name)
        rows.append(
            _row(clip.name, clip.path, found)
            | {field: value for field, value in clip.fields.items() if field not in COLUMNS}
            | ({} if one is None else {name: getattr(one, name) for name in COLUMNS})
        )
    rows += [_row(name, None, [("missing", "no such clip")]) for name in _missing(clips, expected)]
    for path, why in misfits:
        kind = "doubled" if "different names" in why else "name"
        rows.append(_row("", path, [(kind, why)]))
    _write(rows, out)
    return _answer(rows, len(clips), out)


def check(facts: Facts, limits: Limits, usual_fps: float, clip_s: float | None) -> list[tuple[str, str]]:
    """Problems of a clip by itself: kinds and what is wrong."""
    found = []
    if facts.damage:
        found.append(("unreadable", facts.damage))
    if clip_s is not None:
        allowed_s = max(limits.length_s, 1.5 / facts.fps if facts.fps > 0 else 0.0)
        if abs(facts.length_s - clip_s) > allowed_s:
            found.append(("length", f"{facts.length_s:.2f} s instead of {clip_s:g} s"))
    elif facts.length_s < limits.shortest_s:
        found.append(("length", f"{facts.length_s:.2f} s only"))
    if math.isnan(facts.fps):
        found.append(("frame rate", "unknown"))
    elif facts.fps < limits.fps:
        found.append(("frame rate", f"{facts.fps:.4g} per second, too slow"))
    elif abs(facts.fps / usual_fps - 1) > limits.fps_differs:
        found.append(("frame rate", f"{facts.fps:.4g} per second where most have {usual_fps:.4g}"))
    if facts.longest_step > limits.longest_step:
        found.append(("frame rate", f"pictures are left out, {facts.longest_step - 1:.0f} in a row"))
    if facts.brightness < limits.dark:
        found.append(("light", f"too dark, grey level {facts.brightness:.0f} of 255"))
    elif facts.brightness > limits.bright:
        found.append(("light", f"too bright, grey level {facts.brightness:.0f} of 255"))
    if facts.clipped > limits.clipped:
        found.append(("light", f"{100 * facts.clipped:.0f} % of the pixels are black or white"))
    if 2 * facts.sides_n > facts.looked_n:
        found.append(("turned", "the face is seen from the side"))
    if not facts.mouths_n:
        found.append(("no mouth", f"none in {facts.looked_n} pictures looked at"))
        return found
    if facts.mouth_width_px < limits.mouth_width_px:
        found.append(("small", f"the mouth is {facts.mouth_width_px:.0f} px wide"))
    if abs(facts.tilt_deg) > limits.tilt_deg:
        found.append(("turned", f"tilted by {abs(facts.tilt_deg):.0f} degrees"))
    if abs(facts.off_middle) > limits.off_middle:
        found.append(("turned", f"the mouth is {100 * abs(facts.off_middle):.0f} % of the face from its middle"))
    if facts.margin_mw < limits.margin_mw:
        found.append(("cut off", "the mouth is at the edge of the picture"))
    return found


def _looked_at(clips: Sequence[Clip], jobs: int, progress: bool) -> tuple[dict[str, Facts], dict[str, str]]:
    """Facts by name, and what is wrong with the clips that have none."""
    todo = [(clip.name, (clip,)) for clip in clips]
    outcomes = work("corpus_tools.facts:clip_facts", todo, jobs) if jobs > 1 and len(todo) > ALONE_N else _here(todo)
    if progress:
        from tqdm import tqdm

        outcomes = tqdm(outcomes, total=len(todo), unit="clip", desc="looked at", file=sys.stderr, leave=False)
    facts, errors = {}, {}
    for outcome in outcomes:
        if outcome.error is None:
            facts[outcome.key] = outcome.value
        else:
            errors[outcome.key] = outcome.error
    return facts, errors


def _here(todo) -> Iterator[Outcome]:
    for name, (clip,) in todo:
        try:
            yield Outcome(name, clip_facts(clip))
        except Exception as error:
            yield Outcome(name, error=sentence(error))


def _missing(clips: Sequence[Clip], expected: Sequence[str] | None) -> list[str]:
    there = {clip.name for clip in clips}
    return [name for name in dict.fromkeys(expected or ()) if name not in there]


def _doubled(clips: Sequence[Clip]) -> dict[str, str]:
    """Clips with the content of an earlier one; only files of the same size are read for that."""
    paths = list(dict.fromkeys(clip.path for clip in clips))  # parts of one video are no doubles
    by_size: dict[tuple, list[Path]] = defaultdict(list)
    for path in paths:
        try:
            sizes = tuple(one.stat().st_size for one in _files(path))
        except (InputError, OSError):
            continue
        by_size[sizes].append(path)
    same: dict[Path, Path] = {}
    for some in by_size.values():
        first: dict[str, Path] = {}
        for path in some if len(some) > 1 else ():
            try:
                other = first.setdefault(_sha256(path), path)
            except OSError:
                continue
            if other != path:
                same[path] = other
    names = {clip.path: clip.name for clip in reversed(clips)}
    return {clip.name: names[same[clip.path]] for clip in clips if clip.path in same}


def _files(path: Path) -> list[Path]:
    return [path] if path.is_file() else pictures_of(path)


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    for one in _files(path):
        with one.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def _row(name: str, path: Path | None, found: list[tuple[str, str]]) -> dict:
    problems = "; ".join(f"{kind}: {what}" for kind, what in found)
    return {"name": name, "path": "" if path is None else str(path), "problems": problems, "_found": found}


def _write(rows: list[dict], out: Path) -> None:
    names = list(dict.fromkeys(name for row in rows for name in row if name not in (*COLUMNS, "_found")))
    with whole_file(out) as path, path.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, [*names, *COLUMNS], extrasaction="ignore", lineterminator="\n")
        table.writeheader()
        table.writerows({name: _cell(value) for name, value in row.items()} for row in rows)


def _cell(value):
    """Numbers to 4 digits after the point, nothing for what is unknown."""
    if isinstance(value, float):
        return "" if math.isnan(value) else round(value, 4)
    return value


def _answer(rows: list[dict], clips_n: int, out: Path) -> dict:
    by_kind: dict[str, dict[str, str]] = {kind: {} for kind in KINDS}
    for row in rows:
        for kind, what in row["_found"]:
            by_kind[kind].setdefault(row["name"] or row["path"], what)
    by_kind = {kind: whats for kind, whats in by_kind.items() if whats}
    failed = []
    for kind, whats in by_kind.items():
        named = ", ".join(list(whats)[:NAMED_N]) + (f" and {len(whats) - NAMED_N} more" if len(whats) > NAMED_N else "")
        first = next(iter(whats.values()))
        failed.append(
            {"source": f"{kind}: {len(whats)}", "error": named + ("" if kind == "missing" else f" ({first})")}
        )
    bad_n = sum(bool(row["_found"]) for row in rows[:clips_n])
    return {
        "text": [f"{clips_n} clips, {bad_n} with problems -> {out}"],
        "failed": failed,
        "done_n": clips_n,
        "problems": {kind: list(whats) for kind, whats in by_kind.items()},
        "table": str(out),
    }
