"""Settings: frozen dataclasses read from TOML tables, and written back as TOML with a comment on every line.

The dataclasses say what is allowed: their annotations give the types (float, int, bool, str, Literal, tuples, other
dataclasses, and unions of these), their own checks the limits, their docstrings the comments.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import sys
import textwrap
import tomllib
import types
import typing
from collections.abc import Iterator, Mapping
from pathlib import Path

from simulator.errors import InputError
from simulator.wording import choices, nearest, short

LARGEST_FILE = 1_000_000  # bytes of a TOML file that somebody wrote
LONGEST_LINE = 5000  # characters: a key of thousands of parts would take minutes to read
_LINE = 110  # characters; a longer line is divided
_PARAMETER = re.compile(r"^(\w+(?:, \w+)*) : (.*)$")


def read_toml(path: str | Path) -> dict:
    """The table that a TOML file holds.

    Raises
    ------
    InputError : no such file, not text, or not TOML; the message names the line
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        text = path.read_text(encoding="utf-8-sig") if size <= LARGEST_FILE else None
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text"
        raise InputError(f"expected a TOML file, got {path}: {reason}") from None
    if text is None:
        raise InputError(f"expected a TOML file of at most {LARGEST_FILE} bytes, got {path} of {size}")
    return parse_toml(text, path.name)


def parse_toml(text: str, name: str) -> dict:
    """The table that a TOML text holds; `name` is what messages call it.

    Raises
    ------
    InputError : not TOML; the message names the line
    """
    longest = max(map(len, text.split("\n")))
    if longest > LONGEST_LINE:
        raise InputError(f"{name}: expected TOML in lines of at most {LONGEST_LINE} characters, got one of {longest}")
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        reason = " ".join(str(error).split()) or "it is nested too deeply"
        raise InputError(f"{name}: expected TOML such as 'duration_s = 1.0', got something else: {reason}") from None


def from_table(cls: type, table: Mapping, where: str):
    """A frozen dataclass from a TOML table.

    Parameters
    ----------
    cls : the dataclass
    table : what `tomllib` gives: keys to numbers, texts, lists and tables
    where : what messages call the place, such as the file's name

    Raises
    ------
    InputError : an unknown key, a missing one, a value of the wrong type or out of range; the message begins with
        `where` and the path of the table
    """
    return _build(cls, table, where, "", None)


def _build(cls: type, table, where: str, path: str, number: int | None):
    place = _place(where, path, number)
    if not isinstance(table, Mapping):
        raise InputError(f"{place}: expected a table of settings, got {_shown(table)}")
    hints = typing.get_type_hints(cls)
    known = {one.name: one for one in dataclasses.fields(cls) if one.init}
    values = {}
    for key, value in table.items():
        if key not in known:
            raise InputError(f"{place}: {_unknown(key, known)}")
        values[key] = _value(hints[key], value, where, f"{path}.{key}" if path else key, place, key)
    for key, one in known.items():
        if key not in values and one.default is dataclasses.MISSING and one.default_factory is dataclasses.MISSING:
            raise InputError(f"{place}: expected the key '{key}', got none; add a line such as {key} = ...")
    try:
        return cls(**values)
    except InputError as error:
        raise InputError(f"{place}: {error}") from None


def _place(where: str, path: str, number: int | None) -> str:
    if not path:
        return where
    return f"{where}, [{path}]" if number is None else f"{where}, [[{path}]] {number}"


def _unknown(key: str, known: Mapping) -> str:
    guess = nearest(key, known)
    if "did you mean" in guess:
        return f"expected a known key, got {guess}"
    return f"expected {choices(known)}, got {guess}"


def _value(kind, value, where: str, path: str, place: str, key: str):
    """`value` as the type `kind`; path, place and key say where it stands."""
    origin = typing.get_origin(kind)
    if origin in (typing.Union, types.UnionType):
        kinds = [one for one in typing.get_args(kind) if one is not type(None)]
        if len(kinds) == 1:
            return _value(kinds[0], value, where, path, place, key)
        for one in kinds:
            try:
                return _value(one, value, where, path, place, key)
            except InputError:
                continue
        raise InputError(f"{place}: expected {key} as {choices(map(_words, kinds))}, got {_shown(value)}")
    if dataclasses.is_dataclass(kind):
        return _build(kind, value, where, path, None)
    if origin is tuple:
        return _items(kind, value, where, path, place, key)
    if origin is typing.Literal:
        allowed = typing.get_args(kind)
        for one in allowed:
            if one == value and type(one) is type(value):
                return value
        shown = nearest(value, [str(one) for one in allowed]) if isinstance(value, str) else _shown(value)
        raise InputError(f"{place}: expected {key} as {_words(kind)}, got {shown}")
    if kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        if abs(value) <= sys.float_info.max:
            return float(value)
        raise InputError(f"{place}: expected {key} as a finite number, got {short(str(value))}")
    if kind in (int, bool, str) and type(value) is kind:
        return value
    raise InputError(f"{place}: expected {key} as {_words(kind)}, got {_shown(value)}")


def _items(kind, value, where: str, path: str, place: str, key: str) -> tuple:
    kinds = typing.get_args(kind)
    many = len(kinds) == 2 and kinds[1] is Ellipsis
    if not isinstance(value, list | tuple) or not (many or len(value) == len(kinds)):
        raise InputError(f"{place}: expected {key} as {_words(kind)}, got {_shown(value)}")
    if many and dataclasses.is_dataclass(kinds[0]):
        return tuple(_build(kinds[0], one, where, path, i) for i, one in enumerate(value, start=1))
    one_kind = kinds[:1] * len(value) if many else kinds
    return tuple(
        _value(kind, one, where, path, place, f"item {i} of {key}")
        for i, (kind, one) in enumerate(zip(one_kind, value, strict=True), start=1)
    )


def _words(kind) -> str:
    """What a type is called in a message."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if dataclasses.is_dataclass(kind):
        return "a table"
    if origin is typing.Literal:
        return choices([f"'{one}'" if isinstance(one, str) else _shown(one) for one in inner])
    if origin is tuple and inner[-1] is Ellipsis:
        return "a list of tables" if dataclasses.is_dataclass(inner[0]) else "a list"
    if origin is tuple:
        return f"a list of {len(inner)} numbers"
    if origin in (typing.Union, types.UnionType):
        return choices([_words(one) for one in inner if one is not type(None)])
    return {float: "a number", int: "a whole number", bool: "true or false", str: "a text in quotes"}[kind]


def _shown(value) -> str:
    """A TOML value as somebody would have written it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list):
        return f"the list {short(str(value))}" if value else "an empty list"
    return f"'{short(value)}'" if isinstance(value, str) else short(str(value))


def to_toml(settings: object) -> str:
    """A frozen dataclass as a TOML text that `from_table` reads back equal; what is None is left out.

    Every line carries as a comment what the docstring of the dataclass says of that field.

    Raises
    ------
    InputError : a value that TOML cannot hold
    """
    return "\n".join(_lines(settings, "")) + "\n"


def _lines(settings: object, path: str) -> Iterator[str]:
    about, hints = descriptions(type(settings)), typing.get_type_hints(type(settings))
    inner, above = [], ""
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        tables = isinstance(value, tuple) and value and all(dataclasses.is_dataclass(one) for one in value)
        if tables or dataclasses.is_dataclass(value):
            inner.append((field.name, value))
        elif value is not None and not (value == () and field.default == ()):
            comment = about.get(field.name, "")
            place = _place(type(settings).__name__, path, None)
            value = _value(hints[field.name], value, "", "", place, field.name)  # as it would be read
            lines = list(_line(field.name, value, comment))
            yield from lines[-1:] if comment and above == comment else lines  # said once of fields described together
            above = comment if len(lines) > 1 else ""
    for name, value in inner:
        below = f"{path}.{name}" if path else name
        many = isinstance(value, tuple)
        for one in value if many else (value,):
            yield ""
            yield from _above(about.get(name, ""))
            yield f"[[{below}]]" if many else f"[{below}]"
            yield from _lines(one, below)


def _line(name: str, value: object, comment: str) -> Iterator[str]:
    text = f"{name} = {_written(value)}"
    if isinstance(value, tuple) and len(text) > _LINE:
        rows = [f"    {_written(one)}," for one in value]
        text = "\n".join([f"{name} = [", *rows, "]"])
    if not comment:
        yield text
    elif "\n" in text or len(text) + len(comment) + 4 > _LINE:
        yield from _above(comment)
        yield text
    else:
        yield f"{text}  # {comment}"


def _above(comment: str) -> Iterator[str]:
    yield from (f"# {line}" for line in textwrap.wrap(comment, _LINE - 2))


def _written(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return _quoted(value)
    return "[" + ", ".join(_written(one) for one in value) + "]"


def _quoted(text: str) -> str:
    escapes = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\t": "\\t", "\r": "\\r"}

    def escaped(char: str) -> str:
        plain = char >= " " and char != "\x7f"
        return escapes.get(char) or (char if plain else f"\\u{ord(char):04X}")

    return '"' + "".join(map(escaped, text)) + '"'


def descriptions(cls: type) -> dict[str, str]:
    """Name of each field -> what the docstring says of it under `Parameters`, on one line."""
    found: dict[str, str] = {}
    names: list[str] = []
    for line in inspect.cleandoc(cls.__doc__ or "").splitlines():
        match = _PARAMETER.match(line)
        if match:
            names = match[1].split(", ")
            found.update(dict.fromkeys(names, match[2]))
        elif names and line.startswith("    "):
            found.update({name: f"{found[name]} {line.strip()}" for name in names})
        else:
            names = []
    known = {field.name for field in dataclasses.fields(cls)}
    return {name: text for name, text in found.items() if name in known}
