"""Damaged files: seeded changes of good ones, and readers tried on them in a process that may hang or crash.

`damaged` makes a bad file out of a good one. `Tried` runs `python tests/fuzz_readers.py`, the child, which reads one
such file at a time and says what came of it; it is ended and started anew where it hangs or dies.
"""

from __future__ import annotations

import io
import json
import os
import re
import select
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

LONGEST_S = 10.0  # for one file, of a few kB
AGAIN_S = 1.0  # for reading it once more
FIRST_S = 200.0
GROWTH_MB = 400.0  # peak memory of reading one
MEMORY_MB = 3000.0  # address space beyond what the child begins with: what asks for more is refused
LONGEST_MESSAGE = 600

NUMBERS = [
    *("nan", "inf", "-inf", "1e308", "-1e308", "1e999", "1e-320", "-1", "0", "-0.0", "2", "0.5", "1e7", "1e12"),
    *("99999999999999999999999", "-9223372036854775809", "2147483648", "4294967295", "65536", "1_000", "0x10", "1,5"),
    *("", "x", "\uff11\uff12", "1e", "--1", "9" * 5000, "true", "null", '"1"', "[]", "{}"),
]
VALUES = [
    *(None, True, False, 0, -1, 1, 2**31, 2**63, 2**64, 10**30, 1e308, -1e308, 0.5, float("nan"), float("inf"), -0.0),
    *("", "x", "é\n", "\0", "nan", "1", [], [1], [[1]], {}, {"x": 1}, [None], ["x"], "a" * 5000, [[]], [{}]),
]
WORDS = rb"[+-]?\d+\.?\d*(?:[eE][+-]?\d+)?"


def damaged(good: bytes, name: str, rng: np.random.Generator, others: list[bytes]) -> bytes:
    """A bad file made of a good one by one to three changes; `others` are files of other kinds."""
    ending = Path(name).suffix.lower()
    changes: list[Callable] = list(BYTES)
    if b"\0" not in good and _is_text(good):
        changes += TEXT * 2
        if ending == ".json":
            changes += [_json_value] * 8
        if ending == ".csv":
            changes += TABLE * 2
        if ending == ".toml":
            changes += [_toml_value] * 8
        if ending == ".xml":
            changes += XML * 3
    elif good.startswith(b"\x89HDF"):
        changes += [_hdf5] * 12
    elif good.startswith(b"PK"):
        changes += [_npz] * 10
    elif good.startswith(b"\x93NUMPY"):
        changes += [_npy] * 8
    bad = good
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        if rng.random() < 0.02 and others:
            return others[rng.integers(len(others))]
        change = changes[rng.integers(len(changes))]
        try:
            bad = change(bad, rng)
        except Exception:  # what is broken already cannot be changed that way
            bad = _flip(bad, rng)
    return bad


def _is_text(data: bytes) -> bool:
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


def _place(data: bytes, rng) -> int:
    return int(rng.integers(len(data) + 1))


# -- of any file ------------------------------------------------------------------------------------------------------


def _cut(data, rng):
    return data[: _place(data, rng)]


def _head_cut(data, rng):
    return data[_place(data, rng) :]


def _empty(data, rng):
    return b""


def _flip(data, rng):
    bad = bytearray(data)
    for _ in range(int(rng.choice([1, 1, 4, 30]))):
        if bad:
            bad[rng.integers(min(len(bad), int(rng.choice([64, 1024, 10**9]))))] ^= 1 << int(rng.integers(8))
    return bytes(bad)


def _noise(data, rng):
    at, n = _place(data, rng), int(rng.integers(1, 200))
    return data[:at] + rng.bytes(n) + data[at + n :]


def _zeros(data, rng):
    at, n = _place(data, rng), int(rng.choice([1, 4, 64, 4096]))
    return data[:at] + bytes(n) + data[at + n :]


def _nul_between(data, rng):
    at = _place(data, rng)
    return data[:at] + b"\0" + data[at:]


def _size(data, rng):
    """Where sizes stand: an extreme whole number."""
    n = int(rng.choice([2, 4, 8]))
    at = int(rng.integers(min(len(data), int(rng.choice([128, 2048, 10**9]))) + 1))
    value = int(
        rng.choice([0, 1, 2 ** (8 * n - 1) - 1, 2 ** (8 * n - 1), 2 ** (8 * n) - 1, 100_000 % 2 ** (8 * n)], 1)[0]
    )
    return data[:at] + value.to_bytes(n, str(rng.choice(["little", "big"]))) + data[at + n :]


def _without(data, rng):
    a, b = sorted((_place(data, rng), _place(data, rng)))
    return data[:a] + data[b:]


def _twice(data, rng):
    a, b = sorted((_place(data, rng), _place(data, rng)))
    return data[:b] + data[a:]


def _tail(data, rng):
    return data + rng.bytes(int(rng.integers(1, 3000)))


BYTES = [_cut, _cut, _head_cut, _empty, _flip, _flip, _flip, _noise, _zeros, _nul_between, _size, _size, _size]
BYTES += [_without, _twice, _tail]


# -- of texts ---------------------------------------------------------------------------------------------------------


def _lines(data):
    return data.split(b"\n")


def _line_without(data, rng):
    lines = _lines(data)
    del lines[rng.integers(len(lines))]
    return b"\n".join(lines)


def _line_twice(data, rng):
    lines = _lines(data)
    at = rng.integers(len(lines))
    return b"\n".join([*lines[: at + 1], *lines[at:]])


def _lines_swapped(data, rng):
    lines = _lines(data)
    a, b = rng.integers(len(lines), size=2)
    lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


def _number(data, rng):
    found = list(re.finditer(WORDS, data))
    one = found[rng.integers(len(found))]
    return data[: one.start()] + NUMBERS[rng.integers(len(NUMBERS))].encode() + data[one.end() :]


def _numbers(data, rng):
    new = NUMBERS[rng.integers(len(NUMBERS))].encode()
    return re.sub(WORDS, lambda found: new if rng.random() < 0.3 else found[0], data)


def _word(data, rng):
    found = list(re.finditer(rb"\w+", data))
    one, other = (found[rng.integers(len(found))] for _ in range(2))
    return data[: one.start()] + other[0] + data[one.end() :]


def _recoded(data, rng):
    kind = ("utf-16", "utf-16-le", "utf-32", "utf-8-sig", "cp1252")[rng.integers(5)]
    return (data.decode() + "é").encode(kind, "replace")


def _not_utf8(data, rng):
    at = _place(data, rng)
    return data[:at] + b"\xff\xc3" + data[at:]


def _odd_sign(data, rng):
    at = _place(data, rng)
    signs = [
        b'"',
        b"'",
        b",",
        b";",
        b"\t",
        b"\r",
        b"\r\n",
        b"\n\n",
        b"#",
        b"[",
        b"]",
        b"{",
        b"}",
        b"<",
        b">",
        b"&",
        b"\\",
    ]
    signs += ["\u2028".encode(), "\u0085".encode(), "\u202e".encode(), b"\x1b[31m", b"\x0c", b"%", b"=", b" " * 5000]
    return data[:at] + signs[rng.integers(len(signs))] + data[at:]


def _deep(data, rng):
    signs = [b"[", b'{"a":', b"[[a]]\n", b"<a>", b"a = [", b"(", b'"', b"a.", b'[{"a":']
    at = _place(data, rng) if rng.random() < 0.7 else 0
    return data[:at] + signs[rng.integers(len(signs))] * int(rng.choice([200, 3000, 50_000])) + data[at:]


def _long_line(data, rng):
    at = _place(data, rng)
    return data[:at] + bytes([int(rng.integers(33, 126))]) * 200_000 + data[at:]


TEXT = [_line_without, _line_twice, _lines_swapped, _number, _number, _number, _numbers, _word, _recoded, _not_utf8]
TEXT += [_odd_sign, _odd_sign, _deep, _long_line]


def _cells(data):
    return [line.split(b",") for line in _lines(data)]


def _joined(cells):
    return b"\n".join(b",".join(row) for row in cells)


def _cell(data, rng):
    cells = _cells(data)
    row = cells[rng.integers(len(cells))]
    row[rng.integers(len(row))] = NUMBERS[rng.integers(len(NUMBERS))].encode()
    return _joined(cells)


def _column_without(data, rng):
    cells = _cells(data)
    at = rng.integers(len(cells[0]))
    return _joined([row[:at] + row[at + 1 :] for row in cells])


def _column_twice(data, rng):
    cells = _cells(data)
    at = rng.integers(len(cells[0]))
    return _joined([row[:at] + row[at : at + 1] + row[at:] for row in cells])


def _column_of(data, rng):
    cells = _cells(data)
    at, new = rng.integers(len(cells[0])), NUMBERS[rng.integers(len(NUMBERS))].encode()
    return _joined([cells[0], *([*row[:at], new, *row[at + 1 :]] for row in cells[1:])])


def _heading(data, rng):
    cells = _cells(data)
    new = [b"", b"time_s", b"frame", b"x", b"Unnamed: 0", cells[0][0]]
    cells[0][rng.integers(len(cells[0]))] = new[rng.integers(len(new))]
    return _joined(cells)


def _head_alone(data, rng):
    return _lines(data)[0] + b"\n"


def _semicolons(data, rng):
    return data.replace(b",", b";")


TABLE = [
    _cell,
    _cell,
    _cell,
    _column_without,
    _column_twice,
    _column_of,
    _column_of,
    _heading,
    _head_alone,
    _semicolons,
]


def _json_value(data, rng):
    """Another value anywhere in the tree, or a key left out or renamed."""
    tree = json.loads(data)
    places = []

    def walk(node):
        for key in node if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ():
            places.append((node, key))
            walk(node[key])

    walk(tree)
    if not places or rng.random() < 0.05:
        return json.dumps(VALUES[rng.integers(len(VALUES))]).encode()
    level = rng.integers(1, len(places) + 1)  # the first, nearest to the root, are the rarest in big files
    node, key = places[rng.integers(level)]
    if rng.random() < 0.2:
        del node[key]
    elif isinstance(node, dict) and rng.random() < 0.1:
        node[f"{key}x"] = node.pop(key)
    else:
        node[key] = VALUES[rng.integers(len(VALUES))]
    return json.dumps(tree).encode()


def _toml_value(data, rng):
    found = list(re.finditer(rb"(?m)^(\w+\s*=\s*)([^\n]*)$", data))
    one = found[rng.integers(len(found))]
    new = [
        *NUMBERS,
        "'x'",
        "[1, 'x']",
        "[[1]]",
        "{a = 1}",
        "[nan, inf, 1]",
        "1979-05-27",
        "07:32:00",
        "[0, 0, 0]",
        "['', 1]",
    ]
    text = new[rng.integers(len(new))].encode()
    return data[: one.start(2)] + text + data[one.end(2) :]


def _xml_number(data, rng):
    found = list(re.finditer(rb'"[^"]*"|>[^<]+<', data))
    one = found[rng.integers(len(found))]
    new = NUMBERS[rng.integers(len(NUMBERS))].encode().replace(b"&", b"").replace(b'"', b"")
    return data[: one.start() + 1] + new + data[one.end() - 1 :]


def _xml_tag(data, rng):
    found = list(re.finditer(rb"<(\w+)([^>]*)>", data))
    one, other = found[rng.integers(len(found))], found[rng.integers(len(found))]
    return data.replace(b"<" + one[1], b"<" + other[1]).replace(b"</" + one[1] + b">", b"</" + other[1] + b">")


def _xml_element(data, rng):
    """An element left out, or there twice."""
    found = list(re.finditer(rb"(?s)<(\w+)[^>]*>.*?</\1>", data))
    inner = list(re.finditer(rb"(?s)<(\w+)[^>]*>[^<]*</\1>", data))
    one = [*found, *inner][rng.integers(len(found) + len(inner))]
    return data[: one.start()] + one[0] * int(rng.choice([0, 2])) + data[one.end() :]


def _xml_entities(data, rng):
    lol = b'<!DOCTYPE m [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    return lol + data if rng.random() < 0.5 else data.replace(b"0", b"&#x30;&nbsp;", 1)


XML = [_xml_number, _xml_number, _xml_number, _xml_tag, _xml_element, _xml_element, _xml_entities]


# -- of arrays --------------------------------------------------------------------------------------------------------


def _array(values: np.ndarray, rng) -> np.ndarray:
    """Another array in its place."""
    match int(rng.integers(10)):
        case 0:
            return values.ravel()[: values.size // 2]
        case 1:
            return np.array(VALUES[rng.integers(4, 14)], float)
        case 2:
            return values.astype(str)
        case 3:
            return values[..., None]
        case 4:
            return np.full_like(values, np.nan) if values.dtype.kind == "f" else np.full_like(values, -1)
        case 5:
            return np.zeros((0, *values.shape[1:]), values.dtype)
        case 6:
            return values.astype(complex)
        case 7 if values.dtype.kind in "fiu" and values.size:
            values = values.copy()
            big = np.finfo(values.dtype).max if values.dtype.kind == "f" else np.iinfo(values.dtype).max
            values.ravel()[rng.integers(values.size)] = big
            return values
        case 8:
            return values.astype(np.int8 if values.dtype.kind == "f" else float)
        case _:
            return np.concatenate([np.atleast_1d(values)] * 2)


def _npy(data, rng):
    if rng.random() < 0.5:
        huge = [b"(1000000000000, 3, 3)", b"(-1, 3, 3)", b"(99999999999999999999,)", b"()", b"(3.5,)", b"(3, 'x')"]
        head = re.sub(rb"\([\d, ]*\)", huge[rng.integers(len(huge))], data[:128])
        odd = [b"'|O'", b"'<f9'", b"'<U99999999'", b"'|V8'", b"'<M8[s]'", b"None"]
        head = re.sub(rb"'<f8'", odd[rng.integers(len(odd))], head) if rng.random() < 0.4 else head
        return head[:118].ljust(118 if rng.random() < 0.2 else 127) + b"\n" + data[128:]
    out = io.BytesIO()
    values = np.load(io.BytesIO(data), allow_pickle=False)
    if rng.random() < 0.1:
        np.save(out, np.array([{}, 1], object), allow_pickle=True)
    else:
        np.save(out, _array(values, rng))
    return out.getvalue()


def _npz(data, rng):
    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        parts = {name: packed.read(name) for name in packed.namelist()}
    name = list(parts)[rng.integers(len(parts))]
    if rng.random() < 0.2:
        del parts[name]
    elif rng.random() < 0.3:
        parts[name] = _flip(parts[name], rng)
    elif rng.random() < 0.1:
        parts[name] = b"x"
    else:
        parts[name] = _npy(parts[name], rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as packed:
        for key, value in parts.items():
            packed.writestr(key, value)
    return out.getvalue()


def _hdf5(data, rng):
    """A data set or an attribute of another kind or size, or missing."""
    import h5py

    held = io.BytesIO(data)
    with h5py.File(held, "r+") as file:
        places = []
        file.visit(places.append)
        place = places[rng.integers(len(places))] if rng.random() < 0.85 else "/"
        node = file[place]
        if list(node.attrs) and rng.random() < 0.6:
            key = list(node.attrs)[rng.integers(len(node.attrs))]
            if rng.random() < 0.25:
                del node.attrs[key]
            else:
                odd = [
                    0,
                    -1,
                    2**40,
                    np.nan,
                    "x",
                    "",
                    "{}",
                    "[1]",
                    "null",
                    b"\xff\xfe",
                    np.arange(3),
                    h5py.Empty("f"),
                    "[" * 9000,
                ]
                node.attrs[key] = odd[rng.integers(len(odd))]
        elif place == "/":
            del file[places[0]]
        elif rng.random() < 0.2 or isinstance(node, h5py.Group):
            parent = node.parent
            del file[place]
            if rng.random() < 0.5:
                parent[place.split("/")[-1]] = np.arange(3)
        else:
            kind, shape = node.dtype, node.shape
            values = node[()]
            del file[place]
            match int(rng.integers(7)):
                case 0:
                    file.create_dataset(place, (10**12,), kind, chunks=(1000,))
                case 1:
                    file.create_dataset(place, (10**6, *shape), kind, chunks=True)
                case 2:
                    file[place] = h5py.Empty(kind)
                case 3:
                    file[place] = [b"\xff\xfe", b"x"]
                case 4:
                    file[place] = "text"
                case 5:
                    file.create_dataset(place, data=np.atleast_1d(values), compression="gzip")
                case _:
                    changed = _array(np.asarray(values), rng)
                    file[place] = changed.astype("S") if changed.dtype.kind == "U" else changed
    return held.getvalue()


# -- the child --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """What came of reading one damaged file: `returned`, `refused`, or a fault.

    fault : empty, or what is wrong with it: another exception, a hang, a crash, memory, a message of several lines
    """

    reader: str
    case: int
    told: str
    fault: str = ""
    taken_s: float = 0.0
    grown_mb: float = 0.0


class Tried:
    """Readers tried on damaged files, in a process of their own. To be used in `with`."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.child: subprocess.Popen | None = None
        self.known: set[str] = set()

    def __enter__(self) -> Tried:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def read(self, reader: str, case: int, times: int = 0) -> Outcome:
        """Case number `case` of a reader; with `times`, read so often again to see whether memory grows."""
        if self.child is None:
            self._start()
        self.child.stdin.write((f"{reader}\t{case}\t{times}\n" if times else f"{reader}\t{case}\n").encode())
        self.child.stdin.flush()
        new, self.known = reader not in self.known, self.known | {reader}
        longest_s = LONGEST_S + AGAIN_S * times
        line = self._line(FIRST_S if new else longest_s)  # at first good files are made and code is compiled
        if not line:
            fault = f"no answer in {longest_s:g} s" if line is None else f"died with {self.child.wait()}"
            self._end()
            return Outcome(reader, case, "", fault)
        return Outcome(reader, case, **json.loads(line))

    def _start(self) -> None:
        script = Path(__file__).with_name("fuzz_readers.py")
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        quiet = (self.folder / "child.txt").open("ab")
        self.child = subprocess.Popen(
            [sys.executable, str(script), str(self.folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=quiet,
            env=environment,
        )
        quiet.close()
        if not self._line(FIRST_S):
            raise RuntimeError(
                "the process that tries readers did not start: " + (self.folder / "child.txt").read_text()
            )

    def _line(self, longest_s: float) -> bytes | None:
        """The next line that the child writes; None where it writes none in time, nothing where it has ended."""
        until, found = time.monotonic() + longest_s, b""
        while not found.endswith(b"\n"):
            ready, _, _ = select.select([self.child.stdout], [], [], max(0.0, until - time.monotonic()))
            if not ready:
                return None
            piece = os.read(self.child.stdout.fileno(), 65536)
            if not piece:
                return b""
            found += piece
        return found

    def _end(self) -> None:
        if self.child is not None:
            self.child.kill()
            self.child.wait()
            self.child.stdin.close()
            self.child.stdout.close()
            self.child, self.known = None, set()
