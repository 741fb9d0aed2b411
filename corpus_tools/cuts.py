"""Cut lists: which parts of a long take become which clips.

A cut list is a CSV with a column `start_s`, `stop_s` where the length is not the protocol's, and the fields of the
names, or a column `name` instead of them; other columns are passed over. The log of the prompt page is read too.
Times run from the first picture of the take, or from the mark where its time is given.
"""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from corpus_tools.naming import Template, Value
from corpus_tools.protocol import Protocol
from corpus_tools.wording import nearest, short
from lipmetrics.errors import InputError

LOG_COLUMNS = ("at_s", "event", "utterance", "repeat", "kept")
_LOG_ENDINGS = (".log", ".cuts")


@dataclass(frozen=True)
class Piece:
    """A clip to be: its name, without an ending, and its part of the take, s from the take's first picture."""

    name: str
    start_s: float
    stop_s: float


def read_cuts(path: str | Path, protocol: Protocol, *, speaker: str | None = None, mark_s: float = 0.0) -> list[Piece]:
    """Read a cut list, or the log of the prompt page.

    Parameters
    ----------
    protocol : its template names the clips, its clip_s is their length where there is no `stop_s`
    speaker : where the list has no column for it; None takes the name of a log, `<speaker>.log.csv`
    mark_s : added to all times, s

    Returns
    -------
    pieces : in order of time

    Raises
    ------
    InputError : no such file or no table, a missing or unknown column, a time that is no number, a name that the
        template cannot make, and what `check` refuses
    """
    rows = _rows(Path(path))
    columns = list(rows[0])
    if not rows[1:]:
        raise InputError(f"expected a cut list with a cut or more, got {path} with its head alone")
    is_log = set(LOG_COLUMNS) <= set(columns)
    template = protocol.template
    named = "name" in columns
    if not is_log:
        _check_columns(path, columns, template, speaker)
    elif speaker is None:
        speaker = _stem(Path(path))
    pieces = []
    for line, row in enumerate(rows[1:], 2):
        where = f"line {line} of {path}"
        cells = dict(zip(columns, row, strict=False))
        if is_log:
            if cells["event"] != "cue" or cells["kept"] not in ("1", "true"):
                continue
            start_s = _time(cells["at_s"], "at_s", where) - protocol.before_s
            stop_s = start_s + protocol.clip_s
        else:
            start_s = _time(cells["start_s"], "start_s", where)
            given = cells.get("stop_s", "")
            stop_s = _time(given, "stop_s", where) if given else start_s + protocol.clip_s
        if named and not is_log:
            name = _checked_name(cells["name"], where)
        else:
            name = _made_name(template, cells, speaker, where)
        pieces.append(Piece(name, start_s + mark_s, stop_s + mark_s))
    if not pieces:
        raise InputError(f"expected a log with prompts that were kept, got none in {path}")
    return check(pieces, str(path))


def check(pieces: Sequence[Piece], where: str) -> list[Piece]:
    """The pieces in order of time.

    Raises
    ------
    InputError : a piece that starts before the take or does not stop after its start, pieces that overlap, or two of
        one name
    """
    for one in pieces:
        if not 0 <= one.start_s < one.stop_s < math.inf:
            raise InputError(
                f"expected {one.name} to start at 0 s or later and to stop after that, got {one.start_s:g} to "
                f"{one.stop_s:g} s in {where}"
            )
    name, count = Counter(one.name for one in pieces).most_common(1)[0]
    if count > 1:
        raise InputError(f"expected each name once, got {name} {count} times in {where}; number the repeats")
    ordered = sorted(pieces, key=lambda one: one.start_s)
    for before, after in pairwise(ordered):
        if after.start_s < before.stop_s - 1e-6:
            raise InputError(
                f"expected cuts that do not overlap, got {before.name} until {before.stop_s:g} s and {after.name} from "
                f"{after.start_s:g} s in {where}"
            )
    return ordered


def _rows(path: Path) -> list[list[str]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text"
        raise InputError(f"expected a cut list in CSV, got {path}: {reason}") from None
    head = text.split("\n", 1)[0]
    divider = next((sign for sign in (";", "\t") if sign in head and "," not in head), ",")
    try:
        rows = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(text), delimiter=divider) if any(row)]
    except csv.Error as error:
        raise InputError(f"expected a cut list in CSV, got {path}: {error}") from None
    if not rows:
        raise InputError(f"expected a cut list in CSV, got {path}, which is empty")
    for number, row in enumerate(rows[1:], 2):
        if len(row) != len(rows[0]):
            raise InputError(f"expected {len(rows[0])} cells in row {number} of {path}, got {len(row)}")
    return rows


def _check_columns(path: str | Path, columns: Sequence[str], template: Template, speaker: str | None) -> None:
    fields = [] if "name" in columns else [field for field in template.fields if not (field == "speaker" and speaker)]
    for needed in ("start_s", *fields):
        if needed in columns or (needed != "start_s" and _may_be_missing(template, needed)):
            continue
        known = {"start_s", "stop_s", *template.fields, *LOG_COLUMNS}
        strange = next((f", got {nearest(one, [needed])}" for one in columns if one not in known), "")
        hint = "; or give --speaker" if needed == "speaker" else ""
        raise InputError(f"expected a column {needed} in {path}{strange or ', got none'}{hint}")


def _may_be_missing(template: Template, field: str) -> bool:
    others = {name: value for name, value in template.parse(template.example()).items() if name != field}
    try:
        template.format(**others)
    except InputError:
        return False
    return True


def _made_name(template: Template, cells: Mapping[str, str], speaker: str | None, where: str) -> str:
    example = template.parse(template.example())
    fields: dict[str, Value] = {}
    for field, like in example.items():
        text = cells.get(field, "") or (speaker if field == "speaker" and speaker else "")
        if text:
            fields[field] = _value(text, like)
    try:
        return template.format(**fields)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _value(text: str, like: Value) -> Value:
    """The text as what the template makes of such a field."""
    try:
        return type(like)(text) if isinstance(like, int | float) else text
    except ValueError:
        return text  # the template says what it wants


def _checked_name(name: str, where: str) -> str:
    parts = name.split("/")
    if not name or any(part in ("", ".", "..") or part.startswith(".") for part in parts) or "\\" in name:
        raise InputError(f"expected the name of a clip at {where}, without its ending, got '{short(name)}'")
    return name


def _time(text: str, column: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"expected {column} in seconds such as 12.5 at {where}, got '{short(text)}'")
    return value


def _stem(path: Path) -> str:
    stem = path.name.removesuffix(".csv")
    for ending in _LOG_ENDINGS:
        stem = stem.removesuffix(ending)
    return stem
