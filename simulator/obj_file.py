"""Wavefront OBJ files as text: vertices, faces, and the names their faces stand under, each with its line number."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulator.errors import InputError
from simulator.wording import short


@dataclass(frozen=True)
class Face:
    """A polygon of an OBJ file.

    Parameters
    ----------
    corners : vertex numbers from 0, in the file's order
    line : line number, from 1
    names : words of the material, the groups and the object it stands under, in this order
    """

    corners: tuple[int, ...]
    line: int
    names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ObjFile:
    """What a file says of polygons.

    Parameters
    ----------
    vertices : (V, 3), in the units of the file
    vertex_lines : (V,) line numbers, from 1
    faces : the polygons
    """

    path: Path
    vertices: np.ndarray
    vertex_lines: np.ndarray
    faces: tuple[Face, ...]


def read_obj(path: str | Path) -> ObjFile:
    """Read the `v`, `f`, `o`, `g` and `usemtl` lines of a file; other lines are passed over.

    Vertices may carry more than three numbers and corners may carry texture and normal numbers: both are left aside.
    Negative vertex numbers count back from the last vertex before the face.

    Raises
    ------
    InputError : no such file, no vertices or faces, or a line that does not fit; the message names file and line
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise InputError(f"expected an OBJ file, got {path}: {error.strerror}") from None
    vertices, vertex_lines, faces = [], [], []
    material, groups, body = (), (), ()
    for line, words in _lines(text):
        place = f"{path}, line {line}"
        match words[0]:
            case "v":
                vertices.append(_vertex(words[1:], place))
                vertex_lines.append(line)
            case "f":
                corners = tuple(_corner(word, len(vertices), place) for word in words[1:])
                if len(corners) < 3:
                    raise InputError(f"{place}: expected a face of three or more vertices, got {len(corners)}")
                if len(set(corners)) < len(corners):
                    raise InputError(f"{place}: expected a face of different vertices, got one twice")
                faces.append((corners, line, (*material, *groups, *body)))
            case "usemtl":
                material = tuple(words[1:])
            case "g":
                groups = tuple(words[1:])
            case "o":
                body = tuple(words[1:])
    if not vertices or not faces:
        raise InputError(f"expected vertices and faces in {path}, got {len(vertices)} and {len(faces)}")
    for corners, line, _ in faces:
        if max(corners) >= len(vertices):
            raise InputError(
                f"{path}, line {line}: expected vertex numbers up to {len(vertices)}, got {max(corners) + 1}"
            )
    return ObjFile(path, np.array(vertices), np.array(vertex_lines), tuple(Face(*face) for face in faces))


def _lines(text: str):
    """(line number, words) of every line that says something; a backslash at the end joins a line to the next."""
    begun, first = "", 1
    for number, line in enumerate(text.split("\n"), start=1):
        first = first if begun else number
        line = begun + line.split("#")[0].rstrip()
        if line.endswith("\\"):
            begun = line[:-1] + " "
            continue
        begun = ""
        words = line.split()
        if words:
            yield first, words
    if begun.split():
        yield first, begun.split()


def _vertex(words: list[str], place: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(word) for word in words[:3])
    except ValueError:
        x = y = z = math.nan
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
        raise InputError(f"{place}: expected a vertex of three finite numbers, got '{short(' '.join(words))}'")
    return x, y, z


def _corner(word: str, vertices: int, place: str) -> int:
    """Vertex number from 0; numbers beyond the last vertex are judged when all vertices are known."""
    try:
        number = int(word.split("/")[0])
    except ValueError:
        number = 0
    if number == 0 or number < -vertices:
        raise InputError(
            f"{place}: expected vertex numbers from 1, or from -1 back to -{vertices}, got '{short(word)}'"
        )
    return number - 1 if number > 0 else vertices + number
