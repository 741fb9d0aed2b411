"""Mesh sequences: the openings between the lips of a moving mesh, from its inner-lip loop alone, without a picture.

A sequence is a folder or a pattern of OBJ files, one per frame, or a `.npy` array (T, V, 3). The loop is a list of
vertex numbers in order around the mouth, counted from 0.
"""

from __future__ import annotations

import glob
import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError  # of numpy's reader of headers

import numpy as np
import pandas as pd

from lipmetrics.errors import InputError
from lipmetrics.look import CLOSED, NO_MOUTH, OPEN
from lipmetrics.loops import HEIGHT, stretches, tables
from lipmetrics.profile import resting_mouth_width
from lipmetrics.toml_text import parse_toml

GAP_MW = 0.01
UP = {"y": (1, 1.0), "-y": (1, -1.0), "z": (2, 1.0), "-z": (2, -1.0)}
MEDIAPIPE_INNER = (78, 191, 80, 81, 82, 13, 312, 311, 310, 415, 308, 324, 318, 402, 317, 14, 87, 178, 88, 95)
NAMED_LOOPS = {"mediapipe": MEDIAPIPE_INNER, "68 points": tuple(range(60, 68))}


@dataclass(frozen=True)
class LipLoop:
    """The inner edge of the lips as vertices of a mesh.

    vertices : numbers from 0, once around the mouth, in either direction
    corners : two of them, where the lips meet; None takes the two farthest apart in x in the frame at rest
    """

    vertices: tuple[int, ...]
    corners: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        numbers = list(self.vertices)
        if len(numbers) > 1 and numbers[0] == numbers[-1]:
            numbers.pop()
        if len(numbers) < 4:
            raise InputError(f"expected a lip loop of 4 vertices or more, got {len(numbers)}")
        if min(numbers) < 0:
            raise InputError(f"expected vertex numbers from 0 upwards in the lip loop, got {min(numbers)}")
        twice = sorted({number for number in numbers if numbers.count(number) > 1})
        if twice:
            raise InputError(f"expected every vertex once in the lip loop, got {twice[0]} more than once")
        if self.corners is not None:
            if len(self.corners) != 2 or self.corners[0] == self.corners[1]:
                raise InputError(f"expected two different corners of the mouth, got {list(self.corners)}")
            lost = [corner for corner in self.corners if corner not in numbers]
            if lost:
                raise InputError(f"expected corners that are vertices of the lip loop, but {lost[0]} is not in it")
        object.__setattr__(self, "vertices", tuple(numbers))


@dataclass(frozen=True)
class MeshSettings:
    """How a lip loop is measured.

    gap_mw : the lips are open where they are apart by more than this, mouth widths
    up : axis of the mesh that points up, `y`, `z`, `-y` or `-z`; x points to the right as one looks at the face
    plane : `axes`, seen along the third axis, or `loop`, seen straight onto the loop: x is the line from corner to
        corner at rest, upwards the line between the lips where they are farthest apart
    rest_frame : frame, from 0, in which corners are looked for and the plane is taken
    """

    gap_mw: float = GAP_MW
    up: str = "y"
    plane: str = "axes"
    rest_frame: int = 0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.gap_mw) and self.gap_mw >= 0):
            raise InputError(f"expected a gap of 0 mouth widths or more, got {self.gap_mw}")
        if self.up not in UP:
            raise InputError(f"expected the axis that points up, {', '.join(UP)}, got '{self.up}'")
        if self.plane not in ("axes", "loop"):
            raise InputError(f"expected the plane 'axes' or 'loop', got '{self.plane}'")


@dataclass(frozen=True, eq=False)
class MeasuredMesh:
    """Channels (T,) and openings in the unit of the mesh, origin in the middle of the mouth at rest, y down."""

    channels: dict[str, np.ndarray]
    openings: pd.DataFrame
    mouth_width: float
    mouth_width_found: str
    facts: dict


def measure_loop(
    points: np.ndarray,
    loop: LipLoop,
    time_s: np.ndarray,
    settings: MeshSettings | None = None,
    mouth_width: float | None = None,
) -> MeasuredMesh:
    """Openings of a moving lip loop.

    The loop's points are joined by straight lines and seen straight on, without perspective. An opening is a stretch
    of columns in which the upper lip is above the lower one by more than the gap; its sizes are the full ones.

    Parameters
    ----------
    points : (T, N, 3) of the vertices of the loop, in its order; a frame with NaN is unknown
    time_s : (T,) s
    mouth_width : at rest, in the unit of the mesh; None takes the distance of the corners over the closed or least
        open frames

    Raises
    ------
    InputError : points of another shape, unknown in all frames or in the one at rest, or with corners at one place
    """
    settings = settings or MeshSettings()
    points = np.asarray(points, float)
    if points.ndim != 3 or points.shape[1:] != (len(loop.vertices), 3):
        raise InputError(f"expected points of shape (T, {len(loop.vertices)}, 3) for the lip loop, got {points.shape}")
    known = np.isfinite(points).all(axis=(1, 2))
    if not known.any():
        raise InputError("expected a frame in which the lip loop has numbers, got NaN or infinity in all of them")
    rest = settings.rest_frame
    if not 0 <= rest < len(points) or not known[rest]:
        raise InputError(f"expected a frame at rest out of {len(points)} with a known lip loop, got no. {rest}")
    if loop.corners is None:
        across = points[rest, :, 0] if settings.plane == "axes" else _along_the_longest(points[rest])
        left, right = int(across.argmin()), int(across.argmax())
    else:
        left, right = (loop.vertices.index(corner) for corner in loop.corners)
    if points[rest, left, 0] > points[rest, right, 0]:
        left, right = right, left
    order = np.roll(np.arange(len(loop.vertices)), -left)
    n_upper = (right - left) % len(order) + 1  # corner to corner, both included
    points = points[:, order]
    if np.allclose(points[rest, 0], points[rest, n_upper - 1], rtol=0, atol=1e-9 * np.ptp(points[known])):
        raise InputError("expected corners of the mouth that are apart in the frame at rest, got both at one place")
    seen = _seen(points, known, n_upper, settings)
    apart = _apart(seen, n_upper)
    if apart[known][np.abs(apart[known]).argmax()] > 0:  # y is down: the first half of the loop is the lower lip
        seen = np.concatenate([seen[:, :1], seen[:, :0:-1]], axis=1)
        n_upper = seen.shape[1] - n_upper + 2
    corner = seen[:, [0, n_upper - 1]]
    corner_distance = np.linalg.norm(corner[:, 1] - corner[:, 0], axis=1)
    how = "given"
    if mouth_width is None:
        height = np.array([_highest(stretches(one)) if ok else math.nan for one, ok in zip(seen, known, strict=True)])
        status = [NO_MOUTH if not ok else OPEN if h > 0 else CLOSED for ok, h in zip(known, height, strict=True)]
        mouth_width, how = resting_mouth_width(status, height, corner_distance)
        how = how.replace("lip width", "distance of the loop's corners")
    if not mouth_width > 0:
        raise InputError(f"expected a mouth width above 0, got {mouth_width}; give the corners of the mouth")
    seen = seen - corner[rest].mean(axis=0)
    gap = settings.gap_mw * mouth_width
    found = [stretches(one, gap) if ok else None for one, ok in zip(seen, known, strict=True)]
    channels, openings = tables(np.asarray(time_s, float), found, mouth_width)
    numbers = np.array(loop.vertices)[order]
    facts = {
        "loop": list(loop.vertices),
        "corners": [int(numbers[0]), int(numbers[(right - left) % len(order)])],
        "gap_mw": settings.gap_mw,
        "up": settings.up,
        "plane": settings.plane,
        "rest_frame": rest,
    }
    return MeasuredMesh(channels, openings, float(mouth_width), how, facts)


def _along_the_longest(points: np.ndarray) -> np.ndarray:
    """(N,) place of each point along the line between the two that are farthest apart, to the right in x."""
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    a, b = np.unravel_index(apart.argmax(), apart.shape)
    way = points[b] - points[a]
    return points @ (way if way[0] >= 0 else -way)


def _seen(points: np.ndarray, known: np.ndarray, n_upper: int, settings: MeshSettings) -> np.ndarray:
    """(T, N, 2) x to the right, y down, of points (T, N, 3) that begin with one lip's `n_upper`."""
    axis, sign = UP[settings.up]
    x_axis, up_axis = np.eye(3)[0], sign * np.eye(3)[axis]
    if settings.plane == "loop":
        rest = points[settings.rest_frame]
        x_axis = rest[n_upper - 1] - rest[0]
        x_axis = x_axis / np.linalg.norm(x_axis)
        first, second = points[:, 1 : n_upper - 1], points[:, n_upper:]
        if not first.shape[1] or not second.shape[1]:
            raise InputError("expected vertices between the corners on both lips, got none on one of them")
        across = first.mean(axis=1) - second.mean(axis=1)
        across = across - np.outer(across @ x_axis, x_axis)
        length = np.where(known, np.linalg.norm(across, axis=1), 0.0)
        widest = across[length.argmax()]
        if length.max() <= 1e-9 * np.linalg.norm(rest[n_upper - 1] - rest[0]):
            raise InputError("expected lips that part in some frame to find the plane of the loop; take plane 'axes'")
        widest = widest / length.max()
        up_axis = widest if widest @ up_axis >= 0 else -widest
    return np.stack([points @ x_axis, -(points @ up_axis)], axis=2)


def _apart(seen: np.ndarray, n_upper: int) -> np.ndarray:
    """(T,) mean of y of the first lip less that of the second, corners left out."""
    if n_upper < 3 or n_upper == seen.shape[1]:
        raise InputError("expected vertices between the corners on both lips, got none on one of them")
    return seen[:, 1 : n_upper - 1, 1].mean(axis=1) - seen[:, n_upper:, 1].mean(axis=1)


def _highest(found: np.ndarray) -> float:
    return float(found[:, HEIGHT].max(initial=0.0))


def read_loop(given: str | Path | Sequence[int] | LipLoop, corners: Sequence[int] | None = None) -> LipLoop:
    """A lip loop from numbers, a file or the name of a known topology.

    Parameters
    ----------
    given : a `LipLoop`; vertex numbers from 0; `mediapipe` (its 468 or 478 points) or `68 points`; or a file: text
        with the numbers apart by blanks, commas or line ends (`#` begins a comment), or JSON or TOML, a list or
        `loop = [...]` with `corners = [left, right]` where wanted
    corners : two vertices of the loop, instead of those of the file

    Raises
    ------
    InputError : no such file or name, or something else than whole numbers from 0, each once
    """
    if isinstance(given, LipLoop):
        return given if corners is None else LipLoop(given.vertices, _whole(corners, "corners"))
    where, found = "lip loop", {}
    if isinstance(given, str) and given in NAMED_LOOPS:
        found = {"loop": NAMED_LOOPS[given]}
    elif isinstance(given, str | Path):
        where = str(given)
        found = _loop_of_file(Path(given))
    else:
        found = {"loop": given}
    vertices = _whole(found["loop"], where)
    if corners is None and found.get("corners") is not None:
        corners = found["corners"]
    return LipLoop(vertices, None if corners is None else _whole(corners, f"corners of {where}"))


def _loop_of_file(path: Path) -> dict:
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(
            f"expected a file with the vertex numbers of the inner lips or one of the names {', '.join(NAMED_LOOPS)}, "
            f"found no file {path}"
        ) from None
    except (OSError, ValueError) as error:
        raise InputError(f"expected {path} to be text with vertex numbers, but: {_one_line(error)}") from None
    try:
        if path.suffix.lower() == ".toml":
            found = parse_toml(text)
        elif path.suffix.lower() == ".json" or text.lstrip()[:1] in ("[", "{"):
            found = json.loads(text)
        else:
            lines = (line.split("#")[0] for line in text.splitlines())
            found = [int(word) for line in lines for word in re.split(r"[\s,;]+", line) if word]
    except (ValueError, RecursionError) as error:
        raise InputError(f"expected vertex numbers in {path}, but: {_one_line(error)}") from None
    if isinstance(found, list):
        found = {"loop": found}
    if not isinstance(found, dict) or "loop" not in found:
        raise InputError(f"expected {path} to be a list of vertex numbers or to hold one as 'loop', got neither")
    odd = sorted(set(found) - {"loop", "corners"})
    if odd:
        raise InputError(f"expected 'loop' and 'corners' in {path}, got '{odd[0]}'")
    return found


def _whole(numbers, where: str) -> tuple[int, ...]:
    try:
        listed = np.asarray(numbers).ravel().tolist() if not isinstance(numbers, str) else None
    except ValueError:
        listed = None
    if listed is None or any(isinstance(n, bool) or not isinstance(n, int) for n in listed):
        raise InputError(f"expected whole vertex numbers from 0 in the {where}, got {str(numbers)[:60]}")
    return tuple(listed)


def read_points(path: str | Path, vertices: Sequence[int]) -> np.ndarray:
    """(T, N, 3) float64: where the given vertices are in every frame of a sequence.

    Parameters
    ----------
    path : a folder or a pattern of OBJ files, taken in the order of their numbers, or a `.npy` (T, V, 3)

    Raises
    ------
    InputError : no such files, a file that is broken or of another mesh, or vertices that the mesh does not have
    """
    path = Path(path)
    if path.suffix.lower() == ".npy":
        return _points_of_array(path, vertices)
    files = obj_files(path)
    if not files:
        raise InputError(f"expected OBJ files in {path}, found none")
    points, count = [], None
    for file in files:
        of_file = _read_obj(file)
        if count is None:
            count = len(of_file)
            _check_vertices(vertices, count, file)
        if len(of_file) != count:
            raise InputError(
                f"expected one mesh that moves, but {files[0].name} has {count} vertices and {file.name} {len(of_file)}"
            )
        points.append(of_file[list(vertices)])
    return np.array(points)


def obj_files(path: Path) -> list[Path]:
    """OBJ files of a folder or a pattern, frame_2 before frame_10; none if it is something else."""
    from lipmetrics.frames import _natural

    if path.is_dir():
        found = [file for file in path.iterdir() if file.is_file()]
    elif glob.has_magic(str(path)):
        found = [Path(name) for name in glob.glob(str(path), recursive=True) if Path(name).is_file()]
    else:
        found = [path] if path.is_file() else []
    found = [file for file in found if file.suffix.lower() == ".obj" and not file.name.startswith(".")]
    return sorted(found, key=lambda file: (str(file.parent), _natural(file.name)))


def _read_obj(path: Path) -> np.ndarray:
    """(V, 3) float64 vertices of an OBJ file."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"expected the OBJ file {path}, but: {error.strerror or error}") from None
    rows = [line[2:] for line in data.splitlines() if line[:2] in (b"v ", b"v\t")]
    if not rows:
        raise InputError(f"expected vertices (lines 'v x y z') in {path}, found none")
    try:
        numbers = np.array(b" ".join(rows).split(), float)
    except ValueError as error:
        raise InputError(f"expected three numbers in every line 'v' of {path}, but: {_one_line(error)}") from None
    wide = len(rows[0].split())  # a fourth number is a weight, four to seven hold a colour
    if wide < 3 or len(numbers) != wide * len(rows) or len(rows[-1].split()) != wide:
        raise InputError(f"expected three numbers in every line 'v' of {path}, got others; is the file cut short?")
    return numbers.reshape(len(rows), wide)[:, :3]


def _points_of_array(path: Path, vertices: Sequence[int]) -> np.ndarray:
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except FileNotFoundError:
        raise InputError(f"expected the array {path}, found no such file") from None
    except (OSError, ValueError, TypeError, EOFError, OverflowError, MemoryError, SyntaxError, TokenError) as error:
        raise InputError(f"expected {path} to be an array (T, V, 3) saved by numpy, but: {_one_line(error)}") from None
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        kind = getattr(array, "dtype", type(array).__name__)
        raise InputError(f"expected {path} to hold numbers of shape (T, V, 3), got {kind}")
    if array.ndim != 3 or array.shape[2] != 3 or 0 in array.shape:
        raise InputError(f"expected vertices of shape (T, V, 3) in {path}, got {array.shape}")
    _check_vertices(vertices, array.shape[1], path)
    return np.asarray(array[:, list(vertices)], float)


def _check_vertices(vertices: Sequence[int], count: int, path: Path) -> None:
    if max(vertices) >= count:
        raise InputError(
            f"expected vertex numbers below {count}, that of the vertices in {path.name}, got {max(vertices)} in the "
            "lip loop; numbers count from 0"
        )


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
