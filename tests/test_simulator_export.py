import dataclasses
import json
import xml.etree.ElementTree as ElementTree

import h5py
import numpy as np
import pytest
from vtu import read_vtu

from simulator import export
from simulator.errors import InputError
from simulator.model import Fixed, Model, NeoHookean, StVenantKirchhoff, ViscoNeoHookean
from simulator.motion import ENERGIES, Motion, Stop

CUBE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float)


@pytest.fixture
def rng():
    return np.random.default_rng(97)


@pytest.fixture
def model():
    return Model(
        nodes=np.vstack([CUBE, CUBE[4:] + np.array([0, 0, 1])]),
        elements=[range(8), range(4, 12)],
        materials=(NeoHookean(800.0, 7000.0), ViscoNeoHookean(1.0, 2.0, 3.0, ((0.3, 0.1), (0.2, 4.0)), ())),
        material_of=[1, 0],
        loads=(Fixed([0, 1, 2, 3]),),
    )


@pytest.fixture
def motion(model, rng):
    times = np.array([0.0, 0.1, 0.25])
    return Motion(
        time_s=times,
        positions=model.nodes + rng.normal(scale=0.1, size=(3, 12, 3)),
        nodes=model.nodes,
        energies={name: rng.uniform(size=3) for name in ENERGIES},
        dt_s=1e-4,
        steps=2500,
        stopped=Stop(0.25, 1, "it turned inside out", "take a smaller step"),
        settings={"precision": "float64", "loads": [Fixed([0, 1])], "threads": np.int64(2), "dt": np.float64(0.5)},
    )


# -- HDF5 -------------------------------------------------------------------------------------------------------------


def test_a_motion_loads_as_it_was(tmp_path, model, motion):
    path = tmp_path / "new" / "motion.h5"
    export.write_motion(motion, model, path)
    again = export.load_motion(path)
    for name in ("time_s", "positions", "nodes"):
        left, right = getattr(motion, name), getattr(again, name)
        assert left.dtype == right.dtype and np.array_equal(left, right)
    assert list(again.energies) == list(ENERGIES)
    assert all(np.array_equal(again.energies[name], motion.energies[name]) for name in ENERGIES)
    assert (again.dt_s, again.steps, again.stopped) == (1e-4, 2500, motion.stopped)
    assert again.settings == {
        "precision": "float64",
        "loads": [{"kind": "Fixed", "nodes": [0, 1], "axes": [0, 1, 2]}],
        "threads": 2,
        "dt": 0.5,
    }
    elements, element_type, material_of = export.load_elements(path)
    assert np.array_equal(elements, model.elements) and element_type == "H8" and material_of.tolist() == [1, 0]


def test_units_and_materials_stand_in_the_file(tmp_path, model, motion):
    export.write_motion(motion, model, tmp_path / "motion.h5")
    with h5py.File(tmp_path / "motion.h5") as file:
        units = {name: file[name].attrs["units"] for name in ("time_s", "positions", "nodes", "energies/kinetic_j")}
        assert units == {"time_s": "s", "positions": "m", "nodes": "m", "energies/kinetic_j": "J"}
        assert json.loads(file.attrs["provenance"])["versions"]["numpy"] == np.__version__
        first, second = (dict(file[f"materials/{i}"].attrs) for i in range(2))
    assert first == {"law": "NeoHookean", "shear_pa": 800, "bulk_pa": 7000, "density": 1050}
    assert second["law"] == "ViscoNeoHookean" and second["isochoric"].tolist() == [[0.3, 0.1], [0.2, 4.0]]


def test_the_energy_ledger_as_a_table(tmp_path, motion):
    export.write_energies(motion, tmp_path / "energy.csv")
    table = np.genfromtxt(tmp_path / "energy.csv", delimiter=",", names=True)
    assert table.dtype.names == ("time_s", *ENERGIES)
    assert np.array_equal(table["time_s"], motion.time_s)
    assert all(np.array_equal(table[name], motion.energies[name]) for name in ENERGIES)


def test_single_precision_stays_single(tmp_path, model, motion):
    motion = dataclasses.replace(motion, positions=motion.positions.astype(np.float32), stopped=None)
    export.write_motion(motion, model, tmp_path / "motion.h5")
    again = export.load_motion(tmp_path / "motion.h5")
    assert again.positions.dtype == np.float32 and again.stopped is None


def test_the_same_motion_gives_the_same_bytes(tmp_path, model, motion):
    for name in ("a.h5", "b.h5"):
        export.write_motion(motion, model, tmp_path / name)
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_a_motion_of_no_states(tmp_path, model, motion):
    empty = dataclasses.replace(
        motion, time_s=motion.time_s[:0], positions=motion.positions[:0], energies={n: np.zeros(0) for n in ENERGIES}
    )
    export.write_motion(empty, model, tmp_path / "motion.h5")
    assert export.load_motion(tmp_path / "motion.h5").positions.shape == (0, 12, 3)
    assert export.write_vtk(empty, model, tmp_path / "motion.pvd") == [tmp_path / "motion.pvd"]


def test_other_files_are_refused_in_one_sentence(tmp_path, model, motion):
    path = tmp_path / "motion.h5"
    with pytest.raises(InputError, match=r"motion\.h5, which is no file"):
        export.load_motion(path)
    path.write_bytes(b"no HDF5")
    with pytest.raises(InputError, match=r"got .*motion\.h5: .*file signature not found"):
        export.load_motion(path)
    with h5py.File(path, "w") as file:
        file["x"] = 1
    with pytest.raises(InputError, match=r"got .*motion\.h5 of 'None'"):
        export.load_elements(path)
    export.write_motion(motion, model, path)
    with h5py.File(path, "a") as file:
        del file["nodes"]
    with pytest.raises(InputError, match=r"motion\.h5: .*'nodes' doesn't exist"):
        export.load_motion(path)
    with h5py.File(path, "a") as file:
        file.attrs["format_version"] = 99
    with pytest.raises(InputError, match="version 99"):
        export.load_motion(path)
    export.write_motion(motion, model, path)
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(InputError, match=r"motion\.h5: .*truncated"):
        export.load_motion(path)


def test_a_failed_write_leaves_the_file_before(tmp_path, model, motion):
    path = tmp_path / "motion.h5"
    path.write_bytes(b"before")
    with pytest.raises(TypeError):
        export.write_motion(dataclasses.replace(motion, energies={"kinetic_j": object()}), model, path)
    assert path.read_bytes() == b"before" and [p.name for p in tmp_path.iterdir()] == ["motion.h5"]


# -- VTK --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("element_type, cell", [("H8", 12), ("T4", 10), ("T4ANP", 10)])
def test_vtu_holds_every_number(tmp_path, rng, element_type, cell):
    corners = 8 if element_type == "H8" else 4
    points, elements = rng.normal(size=(20, 3)), rng.integers(0, 20, (7, corners))
    velocity, pressure = rng.normal(size=(20, 3)).astype(np.float32), rng.normal(size=7)
    path = tmp_path / "state.vtu"
    export.write_vtu(path, points, elements, element_type, {"velocity": velocity}, {"p <Pa>": pressure}, 0.1)
    sections, counts, field = read_vtu(path)
    assert counts == {"NumberOfPoints": 20, "NumberOfCells": 7}
    assert np.array_equal(sections["Points"]["Points"], points)
    assert np.array_equal(sections["Cells"]["connectivity"], elements.ravel())
    assert sections["Cells"]["offsets"].tolist() == [corners * (i + 1) for i in range(7)]
    assert sections["Cells"]["types"].tolist() == [cell] * 7
    assert np.array_equal(sections["PointData"]["velocity"], velocity)
    assert np.array_equal(sections["CellData"]["p <Pa>"], pressure)
    assert field["TimeValue"].tolist() == [0.1]


@pytest.mark.parametrize("rest", [-8, 0, 8])
def test_arrays_of_several_blocks(tmp_path, rng, monkeypatch, rest):
    monkeypatch.setattr(export, "_BLOCK", 240)
    values = rng.normal(size=90 + rest // 8)
    points = rng.normal(size=(len(values), 3))
    export.write_vtu(tmp_path / "s.vtu", points, [[0, 1, 2, 3]], "T4", {"value": values})
    sections, _, field = read_vtu(tmp_path / "s.vtu")
    assert np.array_equal(sections["Points"]["Points"], points) and field == {}
    assert np.array_equal(sections["PointData"]["value"], values)


def test_a_series_with_its_times(tmp_path, model, motion):
    seen = []
    files = export.write_vtk(
        motion, model, tmp_path / "out" / "smile.pvd", lambda frames: seen.append(frames) or frames
    )
    assert [path.relative_to(tmp_path / "out").as_posix() for path in files] == [
        "smile.pvd",
        *(f"smile_vtu/smile_0000{i}.vtu" for i in range(3)),
    ]
    assert len(seen[0]) == 3
    entries = ElementTree.parse(files[0]).getroot().findall("Collection/DataSet")
    assert [float(entry.attrib["timestep"]) for entry in entries] == [0.0, 0.1, 0.25]
    for frame, entry in enumerate(entries):
        sections, _, field = read_vtu(files[0].parent / entry.attrib["file"])
        assert np.array_equal(sections["Points"]["Points"], motion.positions[frame])
        assert np.array_equal(sections["PointData"]["displacement"], motion.displacements[frame])
        assert sections["CellData"]["material"].tolist() == [1, 0]
        assert field["TimeValue"].tolist() == [motion.time_s[frame]]


def test_a_series_with_values_in_the_elements(tmp_path, model, motion, rng):
    cells = {"stress": rng.normal(size=(3, 2)), "fibre": rng.normal(size=(3, 2, 3))}
    files = export.write_vtk(motion, model, tmp_path / "smile.pvd", cell_data=cells)
    for frame, file in enumerate(files[1:]):
        (sections, *_) = read_vtu(file)
        assert sections["CellData"]["material"].tolist() == [1, 0]
        for name, values in cells.items():
            assert np.array_equal(sections["CellData"][name], values[frame])
    with pytest.raises(InputError, match="expected 3 states of cell data 'stress', got 2"):
        export.write_vtk(motion, model, tmp_path / "smile.pvd", cell_data={"stress": np.zeros((2, 2))})
    with pytest.raises(InputError, match="expected 2 values of CellData 'stress', got 5"):
        export.write_vtk(motion, model, tmp_path / "smile.pvd", cell_data={"stress": np.zeros((3, 5))})


def test_meshio_reads_the_same(tmp_path, model, motion):
    meshio = pytest.importorskip("meshio", reason="meshio, an independent reader, is not installed")
    files = export.write_vtk(motion, model, tmp_path / "smile.pvd")
    mesh = meshio.read(files[2])
    assert np.array_equal(mesh.points, motion.positions[1])
    (cells,) = mesh.cells
    assert cells.type == "hexahedron" and np.array_equal(cells.data, model.elements)
    assert np.array_equal(mesh.point_data["displacement"], motion.displacements[1])


def test_the_collection_comes_last(tmp_path, model, motion):
    def broken(frames):
        yield 0
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export.write_vtk(motion, model, tmp_path / "smile.pvd", broken)
    assert sorted(path.name for path in tmp_path.rglob("*.*")) == ["smile_00000.vtu"]


@pytest.mark.parametrize(
    "arguments, message",
    [
        ((np.zeros((4, 2)), [[0, 1, 2, 3]], "T4"), r"got \(4, 2\) and \(1, 4\)"),
        ((np.zeros((4, 3)), [[0, 1, 2, 3]], "H8"), r"H8 elements of shape \(E, 8\)"),
        ((np.zeros((4, 3)), [[0, 1, 2, 3]], "H20"), "got 'H20'"),
        ((np.zeros((4, 3)), [[0, 1, 2, 3]], "T4", {"u": np.zeros(3)}), "expected 4 values of PointData 'u', got 3"),
    ],
)
def test_arrays_that_do_not_fit(tmp_path, arguments, message):
    with pytest.raises(InputError, match=message):
        export.write_vtu(tmp_path / "s.vtu", *arguments)
    assert not list(tmp_path.iterdir())


def test_linear_material_is_kept(tmp_path, model, motion):
    model = dataclasses.replace(model, materials=(StVenantKirchhoff(3000.0, 0.4),), material_of=[0, 0])
    export.write_motion(motion, model, tmp_path / "m.h5")
    with h5py.File(tmp_path / "m.h5") as file:
        assert file["materials/0"].attrs["poisson"] == 0.4


@pytest.mark.parametrize(
    "damage",
    [
        lambda file: file.attrs.__setitem__("format_version", "x"),
        lambda file: file.attrs.__setitem__("steps", h5py.Empty("f")),
        lambda file: file.attrs.__setitem__("stopped", "null"),
        lambda file: file.attrs.__setitem__("settings", "[" * 20_000),
        lambda file: file.__delitem__("energies") or file.__setitem__("energies", 1.0),
        lambda file: file.__delitem__("nodes") or file.__setitem__("nodes", np.zeros((5, 3))),
        lambda file: file.__delitem__("time_s") or file.create_dataset("time_s", (10**12,), "f8", chunks=(1000,)),
    ],
)
def test_a_damaged_motion_is_one_sentence(model, motion, tmp_path, damage):
    export.write_motion(motion, model, tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        damage(file)
    with pytest.raises(InputError, match="motion") as error:
        export.load_motion(tmp_path / "a.h5")
    assert "\n" not in str(error.value)
