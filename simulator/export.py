"""Results to files: HDF5 to keep and load again, VTK XML for ParaView. Layouts: docs/simulator_formats.md.

Files appear whole or not at all, and hold no time of day: the same run gives the same bytes.
"""

from __future__ import annotations

import base64
import dataclasses
import json
import math
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np

from simulator.atomic import whole_file
from simulator.errors import InputError
from simulator.motion import ENERGIES, Motion, SalivaRecord, Stop

if TYPE_CHECKING:
    from simulator.model import Model

FORMAT, FORMAT_VERSION = "lipmetrics simulated motion", 1
MOST_SHRUNK = 1100  # times that deflate makes anything smaller, at most

_VTK_CELLS = {"H8": (12, 8), "T4": (10, 4), "T4ANP": (10, 4)}  # VTK_HEXAHEDRON, VTK_TETRA; corners
_BLOCK = 2**20  # bytes that are compressed together


def write_motion(motion: Motion, model: Model, path: str | Path, provenance: Mapping | None = None) -> None:
    """Write a motion and the body that moved to an HDF5 file.

    Parameters
    ----------
    motion, model : the result of a run and what was run
    path : file to write
    provenance : whatever else tells where the motion came from, for JSON

    Raises
    ------
    InputError : a place that cannot be written to
    """
    import h5py

    frames, n_nodes = motion.positions.shape[:2]
    with whole_file(path) as part, h5py.File(part, "w") as file:
        file.attrs.update(
            {
                "format": FORMAT,
                "format_version": FORMAT_VERSION,
                "dt_s": motion.dt_s,
                "steps": motion.steps,
                "element_type": model.element_type,
                "damping": model.damping,
                "hourglass": model.hourglass,
                "duration_s": model.duration_s,
                "provenance": json.dumps(
                    {**(provenance or {}), "versions": versions()}, default=_plain, sort_keys=True
                ),
                "settings": json.dumps(motion.settings, default=_plain, sort_keys=True),
            }
        )
        if motion.stopped is not None:
            file.attrs["stopped"] = json.dumps(dataclasses.asdict(motion.stopped), default=_plain)
        _dataset(file, "time_s", motion.time_s, "s")
        chunks = (1, n_nodes, 3) if frames else None  # a state is read whole, a motion state by state
        _dataset(file, "positions", motion.positions, "m", chunks=chunks, compression="gzip", compression_opts=1)
        if motion.velocities is not None:
            _dataset(
                file, "velocities", motion.velocities, "m/s", chunks=chunks, compression="gzip", compression_opts=1
            )
        _dataset(file, "nodes", motion.nodes, "m")
        _dataset(file, "elements", model.elements)
        _dataset(file, "material_of", model.material_of)
        for name, values in motion.energies.items():
            _dataset(file, f"energies/{name}", values, "J")
        if motion.saliva is not None:
            for one in dataclasses.fields(motion.saliva):
                _dataset(file, f"saliva/{one.name}", getattr(motion.saliva, one.name))
        for index, material in enumerate(model.materials):
            group = file.create_group(f"materials/{index}")
            group.attrs["law"] = type(material).__name__
            for field in dataclasses.fields(material):
                group.attrs[field.name] = np.asarray(getattr(material, field.name), float)


def load_motion(path: str | Path) -> Motion:
    """The motion of a file that `write_motion` wrote.

    Raises
    ------
    InputError : no such file, or not a file of `write_motion`
    """
    with _opened(path) as file:
        stopped = file.attrs.get("stopped")
        motion = Motion(
            time_s=_values(file["time_s"]),
            positions=_values(file["positions"]),
            nodes=_values(file["nodes"]),
            energies={name: _values(file["energies"][name]) for name in sorted(file["energies"], key=_energy_order)},
            dt_s=float(file.attrs["dt_s"]),
            steps=int(file.attrs["steps"]),
            stopped=None if stopped is None else Stop(**json.loads(stopped)),
            settings=json.loads(file.attrs["settings"]),
            velocities=_values(file["velocities"]) if "velocities" in file else None,
            saliva=SalivaRecord(**{name: _values(file["saliva"][name]) for name in file["saliva"]})
            if "saliva" in file
            else None,
        )
        if motion.positions.shape != (*motion.time_s.shape, *motion.nodes.shape) or motion.positions.ndim != 3:
            raise ValueError(f"positions of shape {motion.positions.shape} beside nodes of {motion.nodes.shape}")
        return motion


def load_elements(path: str | Path) -> tuple[np.ndarray, str, np.ndarray]:
    """The mesh of a file that `write_motion` wrote.

    Returns
    -------
    elements : node numbers from 0, shape (E, 8) or (E, 4)
    element_type : "H8", "T4" or "T4ANP"
    material_of : number of the material of each element, shape (E,)

    Raises
    ------
    InputError : no such file, or not a file of `write_motion`
    """
    with _opened(path) as file:
        return _values(file["elements"]), str(file.attrs["element_type"]), _values(file["material_of"])


def write_energies(motion: Motion, path: str | Path) -> None:
    """Write the energy ledger as a table (CSV): `time_s` and one column per energy, J.

    Raises
    ------
    InputError : a place that cannot be written to
    """
    columns = {"time_s": motion.time_s, **motion.energies}
    rows = zip(*(np.asarray(values, float).tolist() for values in columns.values()), strict=True)
    with whole_file(path) as part:
        part.write_text(
            "\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows), ""]), encoding="ascii"
        )


def write_vtk(
    motion: Motion,
    model: Model,
    path: str | Path,
    tick: Callable[[Sequence], Sequence] = lambda frames: frames,
    cell_data: Mapping[str, np.ndarray] | None = None,
) -> list[Path]:
    """Write a motion for ParaView: a collection `path` (.pvd) with the time of each state, and its states (.vtu).

    The states lie in a folder beside the collection, `<stem>_vtu/`. The points stand where the nodes are; point data
    `displacement` (m) leads there from rest, `velocity` (m/s) is there where the motion has it; cell data `material` is
    the number of the material.

    Parameters
    ----------
    motion, model : the result of a run and what was run
    path : the collection, ending .pvd
    tick : wraps the frame numbers, for a progress bar
    cell_data : more values in the elements, name -> (T, E) or (T, E, K)

    Returns
    -------
    files : the collection, then the states in order of time

    Raises
    ------
    InputError : shapes that do not fit, or a place that cannot be written to
    """
    material = np.broadcast_to(model.material_of, (len(motion.time_s), len(model.elements)))
    cells = {"material": material, **(cell_data or {})}
    return write_states(path, motion, model.elements, model.element_type, cells, tick)


def write_states(
    path: str | Path,
    motion: Motion,
    elements: np.ndarray,
    element_type: str,
    cell_data: Mapping[str, np.ndarray],
    tick: Callable[[Sequence], Sequence] = lambda frames: frames,
) -> list[Path]:
    """Write a motion of any elements for ParaView; as `write_vtk`, with all cell data given: name -> (T, E) or
    (T, E, K).

    Raises
    ------
    InputError : shapes that do not fit, or a place that cannot be written to
    """
    path = Path(path)
    folder = path.with_name(f"{path.stem}_vtu")
    files = [folder / f"{path.stem}_{frame:05d}.vtu" for frame in range(len(motion.time_s))]
    for name, values in cell_data.items():
        if len(values) != len(files):
            raise InputError(f"expected {len(files)} states of cell data '{name}', got {len(values)}")
    for frame in tick(range(len(files))):
        point_data = {"displacement": motion.positions[frame] - motion.nodes}
        if motion.velocities is not None:
            point_data["velocity"] = motion.velocities[frame]
        write_vtu(
            files[frame],
            motion.positions[frame],
            elements,
            element_type,
            point_data,
            {name: values[frame] for name, values in cell_data.items()},
            motion.time_s[frame],
        )
    write_pvd(path, files, motion.time_s)
    return [path, *files]


def write_vtu(
    path: str | Path,
    points_m: np.ndarray,
    elements: np.ndarray,
    element_type: str,
    point_data: Mapping[str, np.ndarray] | None = None,
    cell_data: Mapping[str, np.ndarray] | None = None,
    time_s: float | None = None,
) -> None:
    """Write one mesh at one time for ParaView: VTK XML unstructured grid, binary, zlib-compressed.

    Parameters
    ----------
    path : file to write, ending .vtu
    points_m : positions of the nodes, m, shape (N, 3)
    elements : node numbers from 0, shape (E, 8) or (E, 4); VTK's order of corners is the solver's
    element_type : "H8", "T4" or "T4ANP"
    point_data : name -> values at the nodes, shape (N,) or (N, 3)
    cell_data : name -> values in the elements, shape (E,) or (E, K)
    time_s : time of the mesh, s, kept in the file where given

    Raises
    ------
    InputError : shapes that do not fit, or a place that cannot be written to
    """
    points = np.asarray(points_m)
    elements = np.asarray(elements)
    if element_type not in _VTK_CELLS:
        raise InputError(f"expected an element type of {', '.join(_VTK_CELLS)}, got '{element_type}'")
    cell_type, corners = _VTK_CELLS[element_type]
    if points.ndim != 2 or points.shape[1] != 3 or elements.ndim != 2 or elements.shape[1] != corners:
        raise InputError(
            f"expected points of shape (N, 3) and {element_type} elements of shape (E, {corners}), "
            f"got {points.shape} and {elements.shape}"
        )
    count = len(elements)
    cells = {
        "connectivity": elements.astype(np.int64).ravel(),  # VTK reads it only as one column
        "offsets": corners * np.arange(1, count + 1, dtype=np.int64),
        "types": np.full(count, cell_type, np.uint8),
    }
    with whole_file(path) as part, part.open("w", encoding="ascii") as file:
        file.write(
            '<?xml version="1.0"?>\n'
            '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64" '
            'compressor="vtkZLibDataCompressor">\n<UnstructuredGrid>\n'
        )
        if time_s is not None:
            file.write(f"<FieldData>\n{_data_array('TimeValue', np.array([time_s], float), field=True)}</FieldData>\n")
        file.write(f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{count}">\n')
        file.write(f"<Points>\n{_data_array('Points', points)}</Points>\n<Cells>\n")
        file.writelines(_data_array(name, values) for name, values in cells.items())
        file.write("</Cells>\n")
        for section, data, rows in (("PointData", point_data, len(points)), ("CellData", cell_data, count)):
            file.write(f"<{section}>\n")
            for name, values in (data or {}).items():
                if len(values) != rows:
                    raise InputError(f"expected {rows} values of {section} '{name}', got {len(values)}")
                file.write(_data_array(name, np.asarray(values)))
            file.write(f"</{section}>\n")
        file.write("</Piece>\n</UnstructuredGrid>\n</VTKFile>\n")


def write_pvd(path: str | Path, files, times_s) -> None:
    """Write a ParaView collection that gives each file its time.

    Parameters
    ----------
    path : file to write, ending .pvd
    files : the T files, in or below the folder of `path`
    times_s : their times, s, shape (T,)

    Raises
    ------
    InputError : a place that cannot be written to
    """
    path = Path(path)
    names = [quoteattr(Path(file).relative_to(path.parent).as_posix()) for file in files]
    lines = [
        f'<DataSet timestep="{float(time)!r}" part="0" file={name}/>\n'
        for name, time in zip(names, times_s, strict=True)
    ]
    with whole_file(path) as part:
        part.write_text(
            '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n<Collection>\n'
            + "".join(lines)
            + "</Collection>\n</VTKFile>\n",
            encoding="utf-8",
        )


def _data_array(name: str, values: np.ndarray, field: bool = False) -> str:
    """One array as VTK's compressed binary: a header of sizes and the blocks, each base64."""
    values = np.ascontiguousarray(values)
    if values.dtype == bool:
        values = values.astype(np.uint8)
    kind = {"f": "Float", "i": "Int", "u": "UInt"}[values.dtype.kind] + str(8 * values.dtype.itemsize)
    data = values.astype(values.dtype.newbyteorder("<")).tobytes()
    blocks = [data[start : start + _BLOCK] for start in range(0, len(data), _BLOCK)]
    packed = [zlib.compress(block, level=1) for block in blocks]
    last = len(blocks[-1]) % _BLOCK if blocks else 0  # VTK's convention: 0 when the last block is full
    header = np.array([len(blocks), _BLOCK, last, *map(len, packed)], "<u8").tobytes()
    text = (base64.b64encode(header) + base64.b64encode(b"".join(packed))).decode("ascii")
    size = f'NumberOfTuples="{len(values)}"' if field else f'NumberOfComponents="{math.prod(values.shape[1:])}"'
    return f'<DataArray type="{kind}" Name={quoteattr(name)} {size} format="binary">{text}</DataArray>\n'


def _dataset(file, name: str, values: np.ndarray, units: str | None = None, **storage) -> None:
    dataset = file.create_dataset(name, data=values, **storage)
    if units:
        dataset.attrs["units"] = units


def _values(dataset) -> np.ndarray:
    """A data set's values, if it is not much larger than what the file holds of it: what is declared costs nothing."""
    if getattr(dataset, "shape", None) is None:
        raise ValueError(f"no values in {dataset.name}")
    held = dataset.id.get_storage_size()
    if dataset.nbytes > MOST_SHRUNK * held + 1e5:
        raise ValueError(f"{dataset.name} declares {dataset.nbytes} bytes and holds {held}")
    return dataset[()]


@contextmanager
def _opened(path: str | Path) -> Iterator:
    """An HDF5 file of this format; whatever is wrong with it becomes one sentence."""
    import h5py

    path = Path(path)
    if not path.is_file():
        raise InputError(f"expected a file of a simulated motion, got {path}, which is no file")
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") != FORMAT or int(file.attrs["format_version"]) > FORMAT_VERSION:
                raise InputError(
                    f"expected a file of format '{FORMAT}' up to version {FORMAT_VERSION}, got {path} of "
                    f"'{file.attrs.get('format')}' version {file.attrs.get('format_version')}"
                )
            yield file
    except InputError:
        raise
    except (OSError, LookupError, RuntimeError, ValueError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(f"expected a file of a simulated motion, got {path}: {' '.join(str(error).split())}") from None


def versions() -> dict[str, str]:
    """Name -> version of the packages that results depend on."""
    found = {}
    for name in ("lipmetrics", "numba", "numpy"):
        with suppress(PackageNotFoundError):  # run from a source folder
            found[name] = version(name)
    return found


def _energy_order(name: str) -> int:
    return ENERGIES.index(name) if name in ENERGIES else len(ENERGIES)


def _plain(value: object) -> object:
    """What JSON can hold of a setting."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if dataclasses.is_dataclass(value):
        return {"kind": type(value).__name__} | {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    return str(value)
