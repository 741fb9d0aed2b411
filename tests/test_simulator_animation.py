"""Exports read back by small readers written from the formats' descriptions, independent of the writers."""

import dataclasses
import json
import struct
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from moved_mouth import moved_mouth
from vtu import read_vtu

from simulator import animation
from simulator.errors import InputError
from simulator.motion import BROKEN
from simulator.mouth import SALIVA
from simulator.stress import von_mises
from simulator.surface import display_frames, display_surface, vertex_normals
from simulator.truth import truth

TIMES = np.linspace(0.0, 1.0, 31)


@pytest.fixture(scope="module")
def moved():
    return moved_mouth(times=21)


@pytest.fixture(scope="module")
def frames(moved):
    return display_frames(*moved, TIMES)


def read_obj(path):
    """vertices, normals, group -> quads of vertices from 0, group -> quads of normals."""
    vertices, normals, quads, turned, group = [], [], {}, {}, None
    for line in path.read_text().splitlines():
        word, *rest = line.split()
        if word == "v":
            vertices.append([float(x) for x in rest])
        elif word == "vn":
            normals.append([float(x) for x in rest])
        elif word == "g":
            (group,) = rest
        elif word == "f":
            corners = [corner.split("/") for corner in rest]
            quads.setdefault(group, []).append([int(corner[0]) - 1 for corner in corners])
            turned.setdefault(group, []).append([int(corner[-1]) - 1 for corner in corners])
    return np.array(vertices), np.array(normals), quads, turned


# -- OBJ and PC2 ------------------------------------------------------------------------------------------------------


def test_obj_sequence(tmp_path, moved, frames):
    *files, materials = animation.write_obj_sequence(tmp_path / "seq" / "mouth.obj", *moved, TIMES, normals=True)
    assert [file.name for file in files[:2]] == ["mouth_00000.obj", "mouth_00001.obj"] and len(files) == 31
    assert materials.read_text().count("newmtl") == 2 and "mtllib mouth.mtl" in files[3].read_text()
    surface = display_surface(moved[0])
    for number in (0, 17, 30):
        vertices, normals, quads, turned = read_obj(files[number])
        np.testing.assert_allclose(vertices, frames[number], atol=5.1e-8)
        assert list(quads) == ["skin", "lips"] and quads == turned
        assert np.array_equal(np.concatenate([quads["skin"], quads["lips"]]), surface.quads)
        assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 2e-4
        outside = np.isin(surface.nodes, moved[0].outer)
        assert normals[outside][:, 2].mean() > 0.7 and normals[~outside][:, 2].mean() < -0.7
    without = animation.write_obj_sequence(tmp_path / "plain.obj", *moved, [0.5])
    assert len(without) == 2 and "vn" not in without[0].read_text()


def test_what_gapes_in_the_files_is_what_the_truth_counts(tmp_path):
    """An opening is where one looks past the facing edges of both lips; two of them, then one."""
    mouth, motion = moved_mouth(times=11, patch=(0.002, 0.004))
    broken = dataclasses.replace(motion.saliva, state=np.full_like(motion.saliva.state, BROKEN))
    loose = dataclasses.replace(motion, saliva=broken)  # no intact element holds one that stands open
    *files, _ = animation.write_obj_sequence(tmp_path / "m.obj", mouth, motion)
    surface, expected = display_surface(mouth), truth(motion, mouth).frames_m
    area_m2 = truth(loose, mouth).frames_m["total_area_m2"]
    upper, lower = surface.vertex_of(mouth.upper), surface.vertex_of(mouth.lower)
    for number in (0, 2, 4, 7, 10):
        vertices, *_ = read_obj(files[number])
        x, gap = vertices[upper[:, 0], 0], (vertices[upper].min(axis=1) - vertices[lower].max(axis=1))[:, 1]
        assert gap.max() == pytest.approx(expected["height_m"][number], abs=2e-7)  # files have 7 decimals
        assert np.trapezoid(gap, x) == pytest.approx(area_m2[number], abs=2e-7 * mouth.width_m)
    assert expected["n_openings"][[0, 4, 10]].tolist() == [0, 2, 1] and expected["height_m"][10] > 0.014


def test_pc2_and_its_mesh(tmp_path, moved, frames):
    cache, base, _ = animation.write_pc2(tmp_path / "mouth.pc2", *moved, TIMES)
    data = cache.read_bytes()
    assert data[:12] == b"POINTCACHE2\0"
    version, points, start, rate, samples = struct.unpack_from("<iiffi", data, 12)
    assert (version, points, start, rate, samples) == (1, frames.shape[1], 0.0, 1.0, 31)
    stored = np.frombuffer(data, "<f4", offset=32).reshape(samples, points, 3)
    np.testing.assert_allclose(stored, frames, atol=1e-8)
    vertices, *_ = read_obj(base)
    np.testing.assert_allclose(vertices, stored[0], atol=6e-8)


def test_the_same_motion_gives_the_same_bytes(tmp_path, moved):
    for folder in ("a", "b"):
        animation.write_pc2(tmp_path / folder / "m.pc2", *moved)
        animation.write_gltf(tmp_path / folder / "m.glb", *moved)
    for name in ("m.pc2", "m.obj", "m.glb"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


# -- glTF -------------------------------------------------------------------------------------------------------------


def read_glb(path):
    """The description, and what checks the accessors and gives their values."""
    data = path.read_bytes()
    magic, version, size, length, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, size, kind) == (b"glTF", 2, len(data), b"JSON") and length % 4 == 0
    description = json.loads(data[20 : 20 + length])
    binary_size, kind = struct.unpack_from("<I4s", data, 20 + length)
    assert kind == b"BIN\0" and 28 + length + binary_size == size
    assert description["buffers"] == [{"byteLength": binary_size}]
    binary = data[28 + length :]

    def values(number):
        accessor = description["accessors"][number]
        view = description["bufferViews"][accessor["bufferView"]]
        dtype = {5126: "<f4", 5123: "<u2", 5125: "<u4"}[accessor["componentType"]]
        columns = {"SCALAR": 1, "VEC3": 3}[accessor["type"]]
        assert view["byteOffset"] % 4 == 0 and view["byteOffset"] + view["byteLength"] <= binary_size
        assert view["byteLength"] == accessor["count"] * columns * np.dtype(dtype).itemsize
        part = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        rows = np.frombuffer(part, dtype).reshape(-1, columns)
        if "min" in accessor:  # exactly, as single precision
            assert np.array_equal(np.float32(accessor["min"]), rows.min(axis=0))
            assert np.array_equal(np.float32(accessor["max"]), rows.max(axis=0))
        return rows

    return description, values


def replay(description, values, time_s):
    """Positions and unit normals at a time, as a player of glTF computes them."""
    (mesh,) = description["meshes"]
    primitive = mesh["primitives"][0]
    (entry,) = description["animations"]
    (channel,), (sampler,) = entry["channels"], entry["samplers"]
    assert channel["target"] == {"node": 0, "path": "weights"} and sampler["interpolation"] == "LINEAR"
    clock = values(sampler["input"])[:, 0]
    table = values(sampler["output"]).reshape(len(clock), -1)
    weights = [np.interp(time_s, clock, column) for column in table.T]
    result = []
    for name in ("POSITION", "NORMAL"):
        total = values(primitive["attributes"][name]).astype(float)
        for weight, target in zip(weights, primitive["targets"], strict=True):
            total = total + weight * values(target[name])
        result.append(total)
    return result[0], result[1] / np.linalg.norm(result[1], axis=1, keepdims=True)


@pytest.mark.parametrize("kind", animation.KINDS)
@pytest.mark.parametrize("error_m", [1e-3, 1e-4])
def test_gltf_replays_the_motion_within_its_stated_error(tmp_path, moved, frames, kind, error_m):
    made = animation.write_gltf(tmp_path / "mouth.glb", *moved, TIMES, kind=kind, error_m=error_m)
    assert made.error_m <= error_m
    description, values = read_glb(made.path)
    worst = 0.0
    for time, frame in zip(TIMES, frames, strict=True):
        positions, _ = replay(description, values, time)
        worst = max(worst, np.linalg.norm(positions - frame, axis=1).max())
    assert worst == pytest.approx(made.error_m, rel=0.01, abs=1e-8)
    half_way = (TIMES[10] + TIMES[11]) / 2
    positions, normals = replay(description, values, half_way)
    assert np.linalg.norm(positions - (frames[10] + frames[11]) / 2, axis=1).max() <= error_m
    turned = vertex_normals((frames[10] + frames[11]) / 2, display_surface(moved[0]).quads)
    still = vertex_normals(frames[0], display_surface(moved[0]).quads)
    assert np.abs(normals - turned).mean() < 0.4 * np.abs(still - turned).mean()

    (mesh,) = description["meshes"]
    assert made.targets == len(mesh["weights"]) == len(mesh["extras"]["targetNames"])
    sampler = description["animations"][0]["samplers"][0]
    table = values(sampler["output"])
    assert len(table) == made.targets * len(TIMES)
    assert np.abs(table).max() <= 1 + 1e-6 and (kind == "modes" or table.min() >= 0)


def test_gltf_describes_itself_as_the_standard_asks(tmp_path, moved):
    made = animation.write_gltf(tmp_path / "mouth.glb", *moved)
    description, values = read_glb(made.path)
    assert description["asset"]["version"] == "2.0"
    assert [material["name"] for material in description["materials"]] == ["skin", "lips"]
    count = len(display_surface(moved[0]).nodes)
    triangles = 0
    for primitive in description["meshes"][0]["primitives"]:
        indices = values(primitive["indices"])
        assert indices.max() < count and len(indices) % 3 == 0
        triangles += len(indices) // 3
        assert len(primitive["targets"]) == made.targets
        for entry in (primitive["attributes"], *primitive["targets"]):
            assert set(entry) == {"POSITION", "NORMAL"}
            assert description["accessors"][entry["POSITION"]]["count"] == count
            assert "min" in description["accessors"][entry["POSITION"]]  # the standard wants them of all positions
    assert triangles == 2 * len(display_surface(moved[0]).quads)
    sampler = description["animations"][0]["samplers"][0]
    assert values(sampler["input"])[0, 0] == 0 and "min" in description["accessors"][sampler["input"]]
    for number in range(len(description["accessors"])):
        assert np.isfinite(values(number)).all()


def test_better_accuracy_takes_more_targets(tmp_path, moved):
    made = [animation.write_gltf(tmp_path / "m.glb", *moved, error_m=error) for error in (2e-3, 2e-4, 1e-6)]
    assert made[0].targets < made[1].targets < made[2].targets and made[2].error_m <= 1e-6


def test_gltf_of_one_frame_and_without_normals(tmp_path, moved):
    made = animation.write_gltf(tmp_path / "still.glb", *moved, [0.5], normals=False)
    description, _ = read_glb(made.path)
    assert made.targets == 0 and "animations" not in description
    assert set(description["meshes"][0]["primitives"][0]["attributes"]) == {"POSITION"}


# -- ParaView ---------------------------------------------------------------------------------------------------------


def test_paraview_knows_every_element(tmp_path, moved):
    mouth, motion = moved
    times = np.array([0.0, 0.475, 1.0])
    collection, *states = animation.write_paraview(tmp_path / "mouth.pvd", mouth, motion, times)
    entries = ElementTree.parse(collection).getroot().iter("DataSet")
    assert [float(entry.get("timestep")) for entry in entries] == times.tolist()
    cells = read_vtu(states[1])[0]["CellData"]
    assert set(cells) == {"group", "von_mises", "saliva_state", "stretch", "moisture"}
    assert np.array_equal(cells["group"], mouth.group)
    half_way = (motion.positions[9] + motion.positions[10]) / 2
    expected = von_mises(mouth, half_way[None])[0]
    tissue = mouth.group != SALIVA
    np.testing.assert_allclose(cells["von_mises"][tissue], expected[tissue], rtol=1e-6, atol=1e-6)
    assert np.isnan(cells["von_mises"][~tissue]).all()
    assert np.array_equal(cells["saliva_state"][mouth.saliva], motion.saliva.state[9])
    assert (cells["saliva_state"][tissue] == -1).all() and BROKEN in cells["saliva_state"]
    stretch = (motion.saliva.stretch[9] + motion.saliva.stretch[10]) / 2
    np.testing.assert_allclose(cells["stretch"][mouth.saliva], stretch)
    assert np.isnan(cells["stretch"][tissue]).all()


def test_paraview_without_a_record_of_the_saliva(tmp_path, moved):
    mouth, motion = moved
    _, state = animation.write_paraview(tmp_path / "m.pvd", mouth, dataclasses.replace(motion, saliva=None), [0.5])
    assert set(read_vtu(state)[0]["CellData"]) == {"group", "von_mises"}


# -- bad input --------------------------------------------------------------------------------------------------------


def test_bad_input_is_refused_in_one_sentence(tmp_path, moved):
    mouth, motion = moved
    with pytest.raises(InputError, match="kind of morph targets of modes or shapes, got 'mode'; did you mean 'modes'"):
        animation.write_gltf(tmp_path / "m.glb", mouth, motion, kind="mode")
    with pytest.raises(InputError, match="error_m of 1e-7 m or more, got 0"):
        animation.write_gltf(tmp_path / "m.glb", mouth, motion, error_m=0)
    with pytest.raises(InputError, match=r"ending \.glb, got 'm\.gltf'"):
        animation.write_gltf(tmp_path / "m.gltf", mouth, motion)
    with pytest.raises(InputError, match="times from 0 to 1 s"):
        animation.write_pc2(tmp_path / "m.pc2", mouth, motion, [0.0, 2.0])
    with pytest.raises(InputError, match="the time of one frame or more, got none"):
        animation.write_paraview(tmp_path / "m.pvd", mouth, motion, [])
    positions = motion.positions.copy()
    positions[7:, 3] = np.nan
    blown_up = dataclasses.replace(motion, positions=positions)
    for write, name in ((animation.write_obj_sequence, "m.obj"), (animation.write_gltf, "m.glb")):
        with pytest.raises(InputError, match=r"some that are not at 0\.35 s"):
            write(tmp_path / name, mouth, blown_up)
    assert not list(tmp_path.iterdir())
