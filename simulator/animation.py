"""A moving mouth for animation programs: OBJ sequence, PC2 cache, glTF with morph targets, ParaView.

All of them are in m, y up, the face looking along z. Each takes the times of its frames and interpolates linearly
between the saved states, so the frame rate is free of the time step. How to load them: docs/animators.md.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulator import export
from simulator.atomic import whole_file
from simulator.errors import InputError
from simulator.materials import Material
from simulator.motion import Motion
from simulator.mouth import GROUPS, LIPS, SALIVA, SKIN, Mouth
from simulator.playback import at_times, frame_times
from simulator.stress import TISSUE, von_mises
from simulator.surface import Surface, display_frames, display_surface, vertex_normals
from simulator.wording import choices, nearest

KINDS = ("modes", "shapes")
_COLOURS = {SKIN: (0.80, 0.58, 0.48), LIPS: (0.62, 0.24, 0.24)}  # linear RGB
_ROUGHNESS = {SKIN: 0.6, LIPS: 0.35}
_FLOAT, _UINT16, _UINT32 = 5126, 5123, 5125  # component types of glTF


@dataclass(frozen=True)
class MorphFile:
    """What a glTF file holds.

    Parameters
    ----------
    path : the file
    targets : number of morph targets
    error_m : largest distance of a vertex from where it should be, over all vertices and frames, m
    """

    path: Path
    targets: int
    error_m: float


def write_obj_sequence(
    path: str | Path,
    mouth: Mouth,
    motion: Motion,
    times_s: np.ndarray | None = None,
    *,
    normals: bool = False,
    tick: Callable[[Sequence], Sequence] = lambda frames: frames,
) -> list[Path]:
    """Write the surface as one OBJ file per frame, `<stem>_00000.obj` and so on, and their materials `<stem>.mtl`.

    Every frame has the same vertices and quads in the same order; groups and materials are `skin` and `lips`.

    Parameters
    ----------
    path : `<folder>/<stem>.obj`
    times_s : (F,) times of the frames, s; None takes the saved ones
    normals : write the vertices' normals too
    tick : wraps the frame numbers, for a progress bar

    Returns
    -------
    files : the F frames, then the materials

    Raises
    ------
    InputError : times beyond the motion, or a place that cannot be written to
    """
    path = _ending(path, ".obj")
    surface = display_surface(mouth)
    frames = display_frames(mouth, motion, frame_times(motion, times_s))
    files = [path.with_name(f"{path.stem}_{number:05d}.obj") for number in range(len(frames))]
    materials = path.with_suffix(".mtl")
    _write_mtl(materials)
    for number in tick(range(len(files))):
        _write_obj(files[number], frames[number], surface, materials.name, normals)
    return [*files, materials]


def write_pc2(
    path: str | Path, mouth: Mouth, motion: Motion, times_s: np.ndarray | None = None
) -> tuple[Path, Path, Path]:
    """Write a point cache (PC2) and the mesh that it moves, `<stem>.obj` in its first frame.

    A header of 32 bytes (POINTCACHE2, version 1, vertices, first frame 0, 1 frame per sample, samples), then x, y, z
    of every vertex of every frame as little-endian float32, vertices in the order of the OBJ file.

    Parameters
    ----------
    path : the cache, ending .pc2
    times_s : (F,) times of the frames, s; None takes the saved ones

    Returns
    -------
    files : the cache, the mesh, its materials

    Raises
    ------
    InputError : times beyond the motion, or a place that cannot be written to
    """
    path = _ending(path, ".pc2")
    frames = display_frames(mouth, motion, frame_times(motion, times_s))
    base, materials = path.with_suffix(".obj"), path.with_suffix(".mtl")
    _write_mtl(materials)
    _write_obj(base, frames[0], display_surface(mouth), materials.name, False)
    with whole_file(path) as part, part.open("wb") as file:
        file.write(struct.pack("<12siiffi", b"POINTCACHE2\0", 1, frames.shape[1], 0.0, 1.0, len(frames)))
        file.write(frames.astype("<f4").tobytes())
    return path, base, materials


def write_gltf(
    path: str | Path,
    mouth: Mouth,
    motion: Motion,
    times_s: np.ndarray | None = None,
    *,
    kind: str = "modes",
    error_m: float = 1e-4,
    normals: bool = True,
) -> MorphFile:
    """Write the surface and its motion as one glTF 2.0 file with as few morph targets as the accuracy allows.

    Every frame is the first frame plus the sum of weight times target; weights are linear between frames, which is
    what the motion between frames is.

    Parameters
    ----------
    path : file, ending .glb
    times_s : (F,) times of the frames, s; None takes the saved ones; the file's clock starts at the first
    kind : "modes": the principal components of the motion, fewest targets; "shapes": the mouth at chosen times, with
        weights from 0 to 1, for programs and people who want shapes that mean something
    error_m : largest distance of a vertex from its place that is allowed, m
    normals : store normals too, twice the size; without them programs show the mesh with facets

    Raises
    ------
    InputError : unknown kind, an accuracy that single precision cannot keep, times beyond the motion, or a place that
        cannot be written to
    """
    path = _ending(path, ".glb")
    if kind not in KINDS:
        raise InputError(f"expected a kind of morph targets of {choices(KINDS)}, got {nearest(kind, KINDS)}")
    if not (isinstance(error_m, int | float) and 1e-7 <= error_m < math.inf):
        raise InputError(f"expected error_m of 1e-7 m or more, got {error_m!r}")
    times_s = frame_times(motion, times_s)
    surface = display_surface(mouth)
    frames = display_frames(mouth, motion, times_s)
    morph = _modes(frames, error_m) if kind == "modes" else _shapes(frames, times_s, error_m)
    turned = vertex_normals(frames, surface.quads) if normals else None
    with whole_file(path) as part:
        part.write_bytes(_glb(surface, morph, times_s - times_s[0], turned))
    return MorphFile(path, len(morph.targets), morph.error_m)


def write_paraview(
    path: str | Path,
    mouth: Mouth,
    motion: Motion,
    times_s: np.ndarray | None = None,
    *,
    material: Material = TISSUE,
    tick: Callable[[Sequence], Sequence] = lambda frames: frames,
) -> list[Path]:
    """Write the hexahedra for ParaView with what is known of each of them; see `export.write_vtk`. They are as
    they were solved: the film of saliva keeps its thickness, and the lips' edges are not where they are drawn.

    Cell data: `group` (0 skin, 1 lips, 2 saliva), `von_mises` (Pa; NaN in the saliva) and, where the motion has a
    record of the saliva, `saliva_state` (0 intact, 1 broken, 2 sticking; -1 in the tissue), `stretch` and `moisture`
    (over the critical one; both NaN in the tissue).

    Parameters
    ----------
    path : the collection, ending .pvd
    times_s : (F,) times of the frames, s; None takes the saved ones
    material : of skin and lips
    tick : wraps the frame numbers, for a progress bar

    Returns
    -------
    files : the collection, then the F states

    Raises
    ------
    InputError : times beyond the motion, or a place that cannot be written to
    """
    path = _ending(path, ".pvd")
    times_s = frame_times(motion, times_s)
    frames = at_times(motion, times_s)
    shape = (len(times_s), len(mouth.elements))
    stress = von_mises(mouth, frames.positions, material)
    stress[:, mouth.group == SALIVA] = np.nan
    cells = {"group": np.broadcast_to(mouth.group.astype(np.int8), shape), "von_mises": stress}
    if frames.saliva is not None:
        record = frames.saliva
        state = np.full(shape, -1, np.int8)
        state[:, record.elements] = record.state
        cells["saliva_state"] = state
        for name in ("stretch", "moisture"):
            cells[name] = np.full(shape, np.nan)
            cells[name][:, record.elements] = getattr(record, name)
    return export.write_states(path, frames, mouth.elements, "H8", cells, tick)


def _ending(path: str | Path, ending: str) -> Path:
    path = Path(path)
    if path.suffix.lower() != ending:
        raise InputError(f"expected a file name ending {ending}, got '{path.name}'")
    return path


# -- OBJ --------------------------------------------------------------------------------------------------------------


def _write_obj(path: Path, vertices: np.ndarray, surface: Surface, materials: str, normals: bool) -> None:
    lines = ["# lipmetrics: m, y up\n", f"mtllib {materials}\n", "o mouth\n"]
    lines.append("v %.7f %.7f %.7f\n" * len(vertices) % tuple(vertices.ravel().tolist()))
    corner = "%d"
    if normals:
        directions = vertex_normals(vertices, surface.quads)
        lines.append("vn %.4f %.4f %.4f\n" * len(vertices) % tuple(directions.ravel().tolist()))
        corner = "%d//%d"
    for group in (SKIN, LIPS):
        numbers = surface.quads[surface.groups == group] + 1
        if normals:
            numbers = np.repeat(numbers, 2, axis=1)
        name = GROUPS[group]
        lines.append(f"g {name}\nusemtl {name}\ns 1\n")
        lines.append(f"f {' '.join([corner] * 4)}\n" * len(numbers) % tuple(numbers.ravel().tolist()))
    with whole_file(path) as part:
        part.write_text("".join(lines), encoding="ascii", newline="\n")


def _write_mtl(path: Path) -> None:
    text = "".join(f"newmtl {GROUPS[group]}\nKd {r:g} {g:g} {b:g}\n" for group, (r, g, b) in _COLOURS.items())
    with whole_file(path) as part:
        part.write_text(text, encoding="ascii", newline="\n")


# -- morph targets ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Morph:
    """base (V, 3) and targets (K, V, 3), m, weights (F, K), all float32 as they are stored; names of the targets; the
    largest distance of a vertex from its place, m.
    """

    base: np.ndarray
    targets: np.ndarray
    weights: np.ndarray
    names: list[str]
    error_m: float


def _modes(frames: np.ndarray, error_m: float) -> _Morph:
    """Principal components of the way from the first frame; each weight reaches 1 or -1."""
    base = frames[0].astype(np.float32)
    way = (frames - base).reshape(len(frames), -1)
    values, vectors = np.linalg.eigh(way @ way.T)
    targets, weights, rest = [], [], way.copy()
    for k in np.argsort(-values, kind="stable"):
        if _largest(rest) <= 0.98 * error_m:  # what single precision adds fits in the other 2 %
            break
        u = vectors[:, k]
        peak = u[np.argmax(np.abs(u))]  # also fixes the sign
        weights.append((u / peak).astype(np.float32))
        targets.append((u @ way * peak).astype(np.float32))
        rest -= np.outer(u, u @ way)
    return _stacked(frames, base, targets, weights, [f"mode {k + 1}" for k in range(len(targets))], error_m)


def _shapes(frames: np.ndarray, times_s: np.ndarray, error_m: float) -> _Morph:
    """The mouth at the fewest times a greedy choice finds: the worst frame is added until all are near enough."""
    base = frames[0].astype(np.float32)
    keys = [0, len(frames) - 1] if len(frames) > 1 else [0]
    while True:
        left = np.clip(np.searchsorted(keys, np.arange(len(frames)), side="right") - 1, 0, max(len(keys) - 2, 0))
        first = np.array(keys)[left]
        last = np.array(keys)[np.minimum(left + 1, len(keys) - 1)]
        span = np.where(last > first, times_s[last] - times_s[first], 1.0)
        share = (times_s - times_s[first]) / span
        between_keys = (1 - share)[:, None, None] * frames[first] + share[:, None, None] * frames[last]
        error = np.linalg.norm(frames - between_keys, axis=2).max(axis=1)
        if error.max() <= 0.98 * error_m or len(keys) == len(frames):
            break
        keys = sorted({*keys, int(np.argmax(error))})
    weights = np.zeros((len(frames), len(keys)))
    np.add.at(weights, (np.arange(len(frames)), left), 1 - share)
    np.add.at(weights, (np.arange(len(frames)), np.minimum(left + 1, len(keys) - 1)), share)
    targets = [(frames[k] - base).astype(np.float32) for k in keys[1:]]
    weights = list(weights[:, 1:].T.astype(np.float32))
    return _stacked(frames, base, targets, weights, [f"{times_s[k]:g} s" for k in keys[1:]], error_m)


def _stacked(frames, base, targets, weights, names, error_m) -> _Morph:
    targets = np.array(targets, np.float32).reshape(-1, *base.shape)
    weights = np.array(weights, np.float32).reshape(-1, len(frames)).T
    played = base + np.einsum("fk,kvx->fvx", weights.astype(float), targets)  # what a program makes of the file
    error = _largest(frames - played)
    if error > error_m:
        raise InputError(f"expected an error_m that single precision can keep, {error:.2g} m or more, got {error_m:g}")
    return _Morph(base, targets, weights, names, error)


def _largest(way: np.ndarray) -> float:
    """Length of the longest of the vectors (F, V, 3) or (F, 3 V)."""
    return float(np.sqrt((way.reshape(len(way), -1, 3) ** 2).sum(axis=2).max()))


def _glb(surface: Surface, morph: _Morph, times_s: np.ndarray, normals: np.ndarray | None) -> bytes:
    """The file: a JSON chunk that describes the binary chunk."""
    store = _Buffer()
    attributes = {"POSITION": store.add(morph.base, bounds=True, target=34962)}
    targets = [{"POSITION": store.add(one, bounds=True, target=34962)} for one in morph.targets]
    if normals is not None:
        # The normals' own targets are those that fit the frames' normals best with the weights of the positions.
        base = normals[0].astype(np.float32)
        attributes["NORMAL"] = store.add(base, target=34962)
        if targets:
            turned = np.linalg.lstsq(
                morph.weights.astype(float), (normals - base).reshape(len(normals), -1), rcond=None
            )[0]
            for entry, values in zip(targets, turned.reshape(morph.targets.shape), strict=True):
                entry["NORMAL"] = store.add(values.astype(np.float32), target=34962)
    kind = np.uint16 if len(morph.base) < 2**16 - 1 else np.uint32
    primitives = []
    for material, group in enumerate((SKIN, LIPS)):
        quads = surface.quads[surface.groups == group]
        triangles = quads[:, [0, 1, 2, 0, 2, 3]].astype(kind).ravel()
        primitive = {"attributes": attributes, "indices": store.add(triangles, target=34963), "material": material}
        primitives.append(primitive | ({"targets": targets} if targets else {}))
    mesh = {"name": "mouth", "primitives": primitives}
    description = {
        "asset": {"version": "2.0", "generator": "lipmetrics"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "mouth", "mesh": 0}],
        "meshes": [mesh],
        "materials": [
            {
                "name": GROUPS[group],
                "pbrMetallicRoughness": {
                    "baseColorFactor": [*_COLOURS[group], 1.0],
                    "metallicFactor": 0.0,
                    "roughnessFactor": _ROUGHNESS[group],
                },
            }
            for group in (SKIN, LIPS)
        ],
    }
    if targets:
        mesh |= {"weights": [0.0] * len(targets), "extras": {"targetNames": morph.names}}
        sampler = {
            "input": store.add(times_s.astype(np.float32), bounds=True),
            "output": store.add(morph.weights.ravel()),
            "interpolation": "LINEAR",
        }
        channel = {"sampler": 0, "target": {"node": 0, "path": "weights"}}
        description["animations"] = [{"name": "mouth", "samplers": [sampler], "channels": [channel]}]
    description |= {
        "accessors": store.accessors,
        "bufferViews": store.views,
        "buffers": [{"byteLength": len(store.data)}],
    }
    text = json.dumps(description, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(store.data)
    return b"".join(
        [
            struct.pack("<4sII", b"glTF", 2, size),
            struct.pack("<I4s", len(text), b"JSON"),
            text,
            struct.pack("<I4s", len(store.data), b"BIN\0"),
            bytes(store.data),
        ]
    )


class _Buffer:
    """The binary chunk, filled array by array, each with a view and an accessor of its own."""

    def __init__(self):
        self.data, self.views, self.accessors = bytearray(), [], []

    def add(self, values: np.ndarray, bounds: bool = False, target: int | None = None) -> int:
        """Number of the accessor of `values`, (n,) or (n, 3)."""
        packed = values.astype(values.dtype.newbyteorder("<")).tobytes()
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(packed)}
        self.views.append(view | ({"target": target} if target else {}))
        self.data += packed + b"\0" * (-len(packed) % 4)
        component = {"f4": _FLOAT, "u2": _UINT16, "u4": _UINT32}[values.dtype.str[1:]]
        accessor = {
            "bufferView": len(self.views) - 1,
            "componentType": component,
            "count": len(values),
            "type": "SCALAR" if values.ndim == 1 else "VEC3",
        }
        if bounds:
            rows = values.reshape(len(values), -1)
            accessor |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1
