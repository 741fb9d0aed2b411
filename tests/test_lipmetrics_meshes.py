import json

import numpy as np
import pytest

from lipmetrics.errors import InputError
from lipmetrics.meshes import LipLoop, MeshSettings, measure_loop, obj_files, read_loop, read_points

X = np.linspace(-2, 2, 9)
LOOP = LipLoop(tuple(range(16)))


def lips(height, centre=(0.0, 0.0, 0.0)):
    """(16, 3) a loop 4 wide, y up, open by heights (9,) shared by both lips: left corner, upper lip, right, lower."""
    height = np.asarray(height, float)
    upper = np.column_stack([X, height / 2, 0.1 * X**2])
    lower = np.column_stack([X, -height / 2, 0.1 * X**2])
    return np.concatenate([upper, lower[-2:0:-1]]) + centre


def moving(*heights):
    return np.array([lips(height) for height in heights])


CLOSED, ARCH = np.zeros(9), np.array([0, 1, 1, 1, 1, 1, 1, 1, 0.0])
TWO = np.array([0, 1, 1, 0, 0, 0, 0.5, 0.5, 0])


def measured(points, loop=LOOP, **settings):
    mouth_width = settings.pop("mouth_width", None)
    return measure_loop(
        points, loop, np.arange(len(points)) / 10, MeshSettings(**{"gap_mw": 0, **settings}), mouth_width
    )


def test_sizes_are_exact_and_closed_is_zero():
    found = measured(moving(CLOSED, ARCH, TWO))
    assert found.mouth_width == pytest.approx(4)
    assert found.channels["width"] == pytest.approx([0, 4, 1.5], abs=1e-6)
    assert found.channels["height"] == pytest.approx([0, 1, 1])
    assert found.channels["area"] == pytest.approx([0, 3.5, 1])
    assert found.channels["total_area"] == pytest.approx([0, 3.5, 1 + 0.5])
    assert found.channels["n_openings"].tolist() == [0, 1, 2]
    assert found.channels["height"][0] == 0 and found.channels["width"][0] == 0


def test_openings_have_places_with_y_down_and_identities():
    points = moving(CLOSED, TWO, ARCH) + np.array([7.0, 3.0, 1.0])
    points[1:, 9:, 1] -= 1 * (ARCH[-2:0:-1] > 0)  # the lower lip sinks
    table = measured(points).openings
    last = table.iloc[-1]
    assert (last.left, last.right) == pytest.approx((-2, 2), abs=1e-6)
    assert (last.top, last.bottom) == pytest.approx((-0.5, 1.5))
    assert last.y > 0 and last.x == pytest.approx(0, abs=1e-12)
    table = measured(moving(CLOSED, TWO, ARCH)).openings
    assert table["event"].tolist() == ["new", "new", "merge"]
    assert table["parents"].iloc[-1] == "1+2"


@pytest.mark.parametrize("turned", ["reversed", "rolled", "lower first"])
def test_the_loop_may_begin_anywhere_and_run_either_way(turned):
    points = moving(CLOSED, ARCH, TWO)
    order = {"reversed": np.arange(16)[::-1], "rolled": np.roll(np.arange(16), 5), "lower first": -np.arange(16) % 16}
    found = measured(points[:, order[turned]])
    assert found.channels["area"] == pytest.approx([0, 3.5, 1])
    assert found.openings["left"].tolist() == pytest.approx([-2, -2, 1 - 0.5], abs=1e-6)


def test_the_lips_may_have_different_numbers_of_vertices():
    few = [*range(9), 10, 12, 14]  # the lower lip has three between the corners
    points = moving(CLOSED, ARCH)[:, few]
    for order in (np.arange(12), np.arange(12)[::-1], np.roll(np.arange(12), 4)[::-1]):
        found = measured(points[:, order], LipLoop(tuple(range(12))))
        assert found.channels["area"] == pytest.approx([0, 0.5 * 3.5 + 0.5 * 3])  # the ends slope over 0.5 and over 1
        assert found.mouth_width == pytest.approx(4)
        assert found.openings["left"].tolist() == pytest.approx([-2], abs=1e-6)


def test_another_axis_may_point_up():
    points = moving(CLOSED, ARCH, TWO)
    swapped = points[:, :, [0, 2, 1]]
    assert measured(swapped, up="z").channels["height"] == pytest.approx([0, 1, 1])
    points[1:, 9:, 1] -= 1 * (ARCH[-2:0:-1] > 0)  # the lower lip sinks
    upside_down = measured(points * [1, -1, 1], up="-y").openings
    assert np.allclose(upside_down[["top", "bottom"]], measured(points).openings[["top", "bottom"]])


def test_a_turned_head_is_seen_straight_on_in_the_plane_of_its_loop():
    turn = np.radians(40)
    rotation = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    flat = moving(CLOSED, ARCH, TWO) * [1, 1, 0]
    turned = flat @ rotation.T
    assert measured(turned).channels["width"][1] == pytest.approx(4 * np.cos(turn), abs=1e-6)
    found = measured(turned, plane="loop")
    assert found.channels["width"] == pytest.approx([0, 4, 1.5], abs=1e-6)
    assert found.channels["area"] == pytest.approx([0, 3.5, 1])


def test_lips_nearer_than_the_gap_are_closed():
    points = moving(CLOSED, 0.03 * ARCH, ARCH)
    assert measured(points, gap_mw=0.01).channels["n_openings"].tolist() == [0, 0, 1]
    assert measured(points, gap_mw=0.001).channels["n_openings"].tolist() == [0, 1, 1]


def test_mouth_width_is_that_of_closed_frames_unless_given():
    points = moving(CLOSED, CLOSED, CLOSED, ARCH, ARCH)
    points[3:, :, 0] *= 0.5  # a rounded mouth is narrower
    assert measured(points).mouth_width == pytest.approx(4)
    assert "closed" in measured(points).mouth_width_found
    assert measured(points, mouth_width=5.0).mouth_width == 5


def test_a_frame_without_numbers_is_unknown():
    points = moving(CLOSED, ARCH, TWO)
    points[1, 3, 1] = np.nan
    found = measured(points).channels
    assert np.isnan([values[1] for values in found.values()]).all()
    assert found["width"][2] == pytest.approx(1.5, abs=1e-6)


def test_given_corners_part_the_lips():
    points = moving(CLOSED, ARCH)
    shifted = measured(points, LipLoop(tuple(range(16)), (8, 0)))
    assert shifted.facts["corners"] == [0, 8]
    assert shifted.channels["area"] == pytest.approx([0, 3.5])


@pytest.mark.parametrize(
    ("points", "match"),
    [
        (np.zeros((3, 15, 3)), "shape"),
        (np.full((3, 16, 3), np.nan), "NaN or infinity in all"),
        (np.zeros((3, 16, 3)), "both at one place"),
    ],
)
def test_bad_points(points, match):
    with pytest.raises(InputError, match=match):
        measured(points)


def test_bad_settings():
    with pytest.raises(InputError, match="gap of 0"):
        MeshSettings(gap_mw=-1)
    with pytest.raises(InputError, match="points up"):
        MeshSettings(up="x")
    with pytest.raises(InputError, match="plane"):
        MeshSettings(plane="side")
    with pytest.raises(InputError, match="at rest out of 2"):
        measured(moving(CLOSED, ARCH), rest_frame=2)
    with pytest.raises(InputError, match="on both lips"):
        measured(moving(CLOSED, ARCH), LipLoop(tuple(range(16)), (0, 1)))


def test_loop_files(tmp_path):
    texts = {
        "a.txt": "0 1, 2\n3  # the corner\n\n4;5",
        "a.json": "[0, 1, 2, 3, 4, 5]",
        "b.json": json.dumps({"loop": [0, 1, 2, 3, 4, 5, 0], "corners": [0, 3]}),
        "a.toml": "loop = [0, 1, 2, 3, 4, 5]\ncorners = [0, 3]\n",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
        loop = read_loop(tmp_path / name)
        assert loop.vertices == (0, 1, 2, 3, 4, 5)
        assert loop.corners == ((0, 3) if "corners" in text else None)
    assert read_loop([0, 1, 2, 3]).vertices == (0, 1, 2, 3)
    assert read_loop(np.arange(4), (0, 2)).corners == (0, 2)
    assert len(read_loop("mediapipe").vertices) == 20


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "4 vertices"),
        ("1 2 three 4", "vertex numbers"),
        ("1 2 3 4.5", "vertex numbers"),
        ("[1, 2, 3", "vertex numbers"),
        ("[1, 2, 3, 4.5]", "whole vertex numbers"),
        ('{"ring": [1, 2, 3, 4]}', "'loop'"),
        ('{"loop": [1, 2, 3, 4], "corner": [1, 3]}', "got 'corner'"),
        ('{"loop": [1, 2, 3, 4], "corners": [1, 9]}', "9 is not in it"),
        ('{"loop": [1, 2, 3, 4], "corners": [1, 1]}', "two different corners"),
        ("1 2 3 2", "2 more than once"),
        ("-1 2 3 4", "from 0 upwards"),
        ("[" * 50_000, "vertex numbers in"),
    ],
)
def test_bad_loops(tmp_path, text, match):
    (tmp_path / "loop.txt").write_text(text)
    with pytest.raises(InputError, match=match):
        read_loop(tmp_path / "loop.txt")


def test_a_missing_loop_names_the_known_ones(tmp_path):
    with pytest.raises(InputError, match="mediapipe"):
        read_loop(tmp_path / "none.txt")


def write_obj(path, points):
    path.write_text("# a mesh\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in points) + "vn 0 0 1\nf 1 2 3\n")


def test_obj_files_are_taken_in_the_order_of_their_numbers(tmp_path):
    for number in (10, 9, 100):
        write_obj(tmp_path / f"frame_{number}.obj", np.full((4, 3), float(number)))
    (tmp_path / "frame.mtl").write_text("")
    assert [file.name for file in obj_files(tmp_path)] == ["frame_9.obj", "frame_10.obj", "frame_100.obj"]
    points = read_points(tmp_path / "frame_*.obj", (2, 3))
    assert points.shape == (3, 2, 3) and points[:, 0, 0].tolist() == [9, 10, 100]


def test_obj_vertices_may_have_colours(tmp_path):
    (tmp_path / "a.obj").write_text("v 1 2 3 0.5 0.5 0.5\nv 4 5 6 0.5 0.5 0.5\n")
    assert read_points(tmp_path, (1,)).tolist() == [[[4, 5, 6]]]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "found none"),
        ("v 1 2\nv 3 4\n", "three numbers"),
        ("v 1 2 3\nv 4 5", "three numbers"),
        ("v 1 2 x\n", "three numbers"),
        ("v 1 2 3\n", "has 2 vertices and b.obj 1"),
    ],
)
def test_bad_obj_files(tmp_path, text, match):
    (tmp_path / "a.obj").write_text("v 1 2 3\nv 4 5 6\n")
    (tmp_path / "b.obj").write_text(text)
    with pytest.raises(InputError, match=match):
        read_points(tmp_path, (0, 1))


def test_arrays(tmp_path):
    array = np.arange(2 * 5 * 3, dtype=np.float32).reshape(2, 5, 3)
    np.save(tmp_path / "a.npy", array)
    assert np.array_equal(read_points(tmp_path / "a.npy", (4, 0)), array[:, [4, 0]])


@pytest.mark.parametrize(
    ("array", "match"),
    [
        (np.zeros((5, 3)), r"\(T, V, 3\)"),
        (np.zeros((2, 5, 2)), r"\(T, V, 3\)"),
        (np.zeros((0, 5, 3)), r"\(T, V, 3\)"),
        (np.array([["a", "b"]]), "numbers"),
        (np.zeros((2, 3, 3)), "below 3"),
    ],
)
def test_bad_arrays(tmp_path, array, match):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(InputError, match=match):
        read_points(tmp_path / "a.npy", (0, 4))


def test_broken_arrays(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((2, 5, 3)))
    whole = (tmp_path / "a.npy").read_bytes()
    shapes = (b"(2, 5, 3", b"(1000000000000, 3, 3), }", b"(99999999999999999999, 3, 3), }")
    odd = [whole[:128].replace(b"(2, 5, 3), }" + b" " * (len(s) - 12), s) + whole[128:] for s in shapes]
    odd[0] = whole.replace(b"(2, 5, 3), }", b"(2, 5, 3    ")
    for data in (whole[:-8], whole[:20], b"", b"no array", *odd):
        (tmp_path / "b.npy").write_bytes(data)
        with pytest.raises(InputError, match="saved by numpy"):
            read_points(tmp_path / "b.npy", (0,))
    with pytest.raises(InputError, match="no such file"):
        read_points(tmp_path / "c.npy", (0,))


def test_a_loop_file_with_a_key_of_thousands_of_parts_is_not_read(tmp_path):
    (tmp_path / "loop.toml").write_text("a." * 50_000 + "a = 1\n")
    with pytest.raises(InputError, match="a line of 100005 characters"):
        read_loop(tmp_path / "loop.toml")


def test_a_kind_of_number_that_cannot_be_parsed_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((2, 5, 3)))
    damaged = (tmp_path / "a.npy").read_bytes().replace(b"<f8", b",f8")
    (tmp_path / "a.npy").write_bytes(damaged)
    with pytest.raises(InputError, match="saved by numpy"):
        read_points(tmp_path / "a.npy", (0,))
