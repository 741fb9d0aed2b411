"""What was said in a take, who said it and which repeat it is: from file names by a pattern, or from a table."""

from __future__ import annotations

import csv
import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from lipmetrics.errors import InputError

FIELDS = ("speaker", "utterance", "repeat", "group")
IGNORED = "any"
COLUMNS = ("path", *FIELDS)
_FIELD = re.compile(r"\{([^{}]*)\}")


@dataclass(frozen=True)
class Labels:
    """Labels of one take; None is unknown. Takes without an utterance are all one utterance.

    group : who moves in it: the name of a model, or of the references
    """

    utterance: str | None = None
    speaker: str | None = None
    repeat: str | None = None
    group: str | None = None


def labels_of_name(path: str | Path, pattern: str) -> Labels:
    """Labels from a take's path by a pattern such as "{speaker}_{utterance}_{repeat}".

    The pattern is matched with the whole name, without its ending; with slashes in it, with as many folders as well
    ("{speaker}/{utterance}_{repeat}"). {any} stands for something that does not matter. Only an utterance may hold the
    characters that separate the fields: "s1_slow_open_2" is speaker s1, utterance slow_open, repeat 2.

    Raises
    ------
    InputError : a pattern that cannot be read, or a name that it does not fit
    """
    found = _compiled(pattern).fullmatch(_comparable(path, pattern.count("/")))
    if found is None:
        raise InputError(
            f"expected a name like {pattern!r}, got {_comparable(path, pattern.count('/'))!r}; "
            "rename it, give another --names, or label takes with --list"
        )
    return Labels(**found.groupdict())


def _comparable(path: str | Path, folders: int) -> str:
    path = Path(path)
    name = path.name
    for ending in (".frames.csv", ".openings.csv"):
        name = name.removesuffix(ending)
    # a name may hold dots of its own: only what looks like an ending goes
    name = re.sub(r"\.[A-Za-z][A-Za-z0-9]{0,4}$", "", name) if name == path.name else name
    parents = path.absolute().parts[:-1]
    return "/".join((*parents[len(parents) - folders :], name))


def _compiled(pattern: str) -> re.Pattern[str]:
    pieces = _FIELD.split(pattern)
    texts, fields = pieces[::2], pieces[1::2]
    for name in fields:
        if name not in (*FIELDS, IGNORED):
            near = difflib.get_close_matches(name, (*FIELDS, IGNORED), 1)
            guess = f"; did you mean {{{near[0]}}}" if near else ""
            raise InputError(f"expected --names to hold {_braced((*FIELDS, IGNORED))}, got {{{name}}}{guess}")
    twice = {name for name in fields if name != IGNORED and fields.count(name) > 1}
    if twice or not set(fields) & set(FIELDS) or any("{" in text or "}" in text for text in texts):
        raise InputError(f"expected --names like '{{speaker}}_{{utterance}}_{{repeat}}', each once, got {pattern!r}")
    if any(text == "" for text in texts[1:-1]):
        raise InputError(f"expected something between the fields of --names, such as '_', got {pattern!r}")
    separators = re.escape("".join(dict.fromkeys("".join(texts[1:-1]))) + "/")
    expression = re.escape(texts[0])
    for name, text in zip(fields, texts[1:], strict=True):
        body = "[^/]+" if name == "utterance" or len(fields) == 1 else f"[^{separators}]+"
        expression += (body if name == IGNORED else f"(?P<{name}>{body})") + re.escape(text)
    return re.compile(expression)


def read_list(path: str | Path) -> dict[Path, Labels]:
    """Labels of takes from a CSV with the column `path` and any of utterance, speaker, repeat and group.

    Paths are relative to the table's folder; an empty field is unknown.

    Returns
    -------
    absolute path -> Labels, in the order of the table

    Raises
    ------
    InputError : no such table, unknown or missing columns, an empty path, a path named twice
    """
    path = Path(path)
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file)
            rows = list(reader)
            columns = [str(name).strip() for name in reader.fieldnames or ()]
    except FileNotFoundError:
        raise InputError(f"expected the table {path}, found no such file") from None
    except (OSError, UnicodeError, csv.Error) as error:
        raise InputError(
            f"expected {path} to be a CSV table with the columns {_listed(COLUMNS)}, but: {error}"
        ) from None
    if "path" not in columns:
        raise InputError(
            f"expected the columns {_listed(COLUMNS)} in {path}, of which path is needed, got {_listed(columns)}"
        )
    for name in columns:
        near = difflib.get_close_matches(name, COLUMNS, 1)
        if name not in COLUMNS and near:  # other columns are the user's own; a slip of the pen is not
            raise InputError(
                f"expected the columns {_listed(COLUMNS)} in {path}, got {name!r}; did you mean {near[0]!r}"
            )
    found: dict[Path, Labels] = {}
    for number, row in enumerate(rows, start=2):
        fields = {str(key).strip(): (value or "").strip() for key, value in row.items() if isinstance(value, str)}
        if not fields.get("path"):
            raise InputError(f"expected a path in every row of {path}, found none in line {number}")
        try:
            take = normal(path.parent / fields["path"])
        except (OSError, ValueError, RuntimeError) as error:
            raise InputError(f"expected the path of a take in line {number} of {path}, but: {error}") from None
        if take in found:
            raise InputError(f"expected each take once in {path}, got {fields['path']!r} again in line {number}")
        found[take] = Labels(**{name: fields.get(name) or None for name in FIELDS})
    if not found:
        raise InputError(f"expected at least one take in {path}, found none")
    return found


def normal(path: str | Path) -> Path:
    """An absolute path without '..', so that two ways to write it are equal."""
    return Path(path).expanduser().resolve()


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"


def _braced(names: Iterable[str]) -> str:
    return ", ".join(f"{{{name}}}" for name in names)
