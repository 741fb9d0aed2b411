import json
import math

import numpy as np
import pandas as pd
import pytest
from mouth_clip import looks_of, profile_of
from moved_mouth import moved_mouth

import lipmetrics
from lipmetrics import pipeline
from lipmetrics.errors import InputError
from lipmetrics.look import CLOSED, NO_MOUTH, OPEN
from lipmetrics.meshes import MeshSettings
from lipmetrics.profile import FORMAT
from lipmetrics.take import OPENING_COLUMNS, Take, same_unit
from lipmetrics.takes import read_take, read_takes, take_of_profile, take_paths
from simulator.animation import write_obj_sequence
from simulator.camera import Camera
from simulator.surface import display_surface
from simulator.truth import truth

CHANNELS = ("width", "height", "area")


def take(values, time_s=None, name="made", unit="mw", **others):
    values = np.asarray(values, float)
    time_s = np.arange(len(values)) / 25 if time_s is None else time_s
    return Take(name, time_s, {"width": values, "height": values, "area": values, **others}, unit)


def profile(statuses, mouth_width_px=60.0, time_s=None):
    time_s = np.arange(len(statuses)) / 25 if time_s is None else time_s
    made = profile_of(looks_of(statuses), list(time_s), mouth_width_px)
    made.meta |= {"format": FORMAT, "mouth_width_found": "drawn", "warnings": []}
    return made


STATUSES = [CLOSED, OPEN, NO_MOUTH, OPEN, CLOSED]


# -- Take -------------------------------------------------------------------------------------------------------------


def test_a_take_checks_its_arrays():
    for bad, match in (
        ({"time_s": [0, 1, 1]}, "1 s and then 1 s at frame no. 2"),
        ({"time_s": [0, math.nan, 2]}, "got nan for no. 1"),
        ({"time_s": []}, "one frame or more"),
        ({"time_s": [0, 1]}, "expected 2 values of 'width'"),
        ({"unit": "cm"}, "got 'cm'"),
        ({"source": "guess"}, "got 'guess'"),
        ({"channels": {"width": np.ones(3)}}, "missing height, area"),
        ({"channels": {name: np.array([1, -1, 1.0]) for name in CHANNELS}}, "got -1.0"),
        ({"channels": {name: np.array([1, np.inf, 1.0]) for name in CHANNELS}}, "got inf"),
    ):
        good = {"name": "a", "time_s": [0, 1, 2], "channels": dict.fromkeys(CHANNELS, np.ones(3)), "unit": "mw"}
        with pytest.raises(InputError, match=match):
            Take(**(good | bad))


def test_rate_and_duration():
    assert take([1, 2, 3]).rate_hz == pytest.approx(25)
    assert take([1, 2, 3, 4], [0, 0.016667, 0.033333, 0.05]).rate_hz == pytest.approx(60)
    assert take([1, 2, 3, 4], [0, 0.1, 0.2, 2.0]).rate_hz == pytest.approx(10)
    assert math.isnan(take([1]).rate_hz)
    assert take([1, 2, 3], [1, 2, 4]).duration_s == 3


def test_array_gives_the_frames_as_they_are():
    time_s, values = take([0, 1, 2], total_area=np.array([3, 4, 5.0])).array(("height", "total_area"))
    assert time_s.tolist() == [0, 0.04, 0.08]
    assert values.tolist() == [[0, 3], [1, 4], [2, 5]]
    assert values.flags.c_contiguous


def test_array_bridges_short_gaps_by_time_and_refuses_long_ones():
    time_s = [0, 0.04, 0.05, 0.09]
    _, values = take([1, np.nan, np.nan, 10], time_s).array(("width",))
    assert values[:, 0] == pytest.approx([1, 5, 6, 10])
    with pytest.raises(InputError, match=r"width.*from 0.000 to 0.090 s"):
        take([1, np.nan, np.nan, 10], time_s).array(max_gap_s=0.08)
    take([1, 2, np.nan, 4], [0, 1, 1.02, 1.04]).array(max_gap_s=0.04)  # long steps between known frames are none


def test_array_leaves_out_short_unknown_ends_and_refuses_long_ones():
    time_s, values = take([np.nan, 1, 2, np.nan]).array(("width",))
    assert time_s.tolist() == [0.04, 0.08] and values[:, 0].tolist() == [1, 2]
    with pytest.raises(InputError, match=r"from 0.000 to 0.120 s"):
        take([np.nan, np.nan, np.nan, 1, 2]).array()
    with pytest.raises(InputError, match="unknown in all"):
        take([np.nan, np.nan]).array()


def test_array_resamples_by_time():
    time_s, values = take([0, 1, 4], [1.0, 1.1, 1.4]).array(("width",), rate_hz=20)
    assert time_s == pytest.approx(1 + np.arange(9) / 20)
    assert values[:, 0] == pytest.approx(10 * (time_s - 1))
    assert len(take([0, 1, 2, 3], [0, 0.016667, 0.033333, 0.05]).array(rate_hz=60)[0]) == 4


def test_numbers_of_openings_are_held_not_interpolated():
    one = take([0, 1, 2], [0, 0.1, 0.2], n_openings=np.array([0, 2, 1.0]))
    assert one.array(("n_openings",), rate_hz=20)[1][:, 0].tolist() == [0, 0, 2, 2, 1]


def test_array_names_the_nearest_channel_and_refuses_bad_settings():
    with pytest.raises(InputError, match="did you mean 'height'"):
        take([1, 2]).array(("hight",))
    with pytest.raises(InputError, match="rate above 0"):
        take([1, 2]).array(rate_hz=0)
    with pytest.raises(InputError, match="longest gap"):
        take([1, 2]).array(max_gap_s=-1)
    with pytest.raises(InputError, match="one channel"):
        take([1, 2]).array(())


def test_same_unit():
    mw, px = take([1], name="a"), take([1], name="b", unit="px")
    assert same_unit([mw, mw]) == "mw" and same_unit([px, mw], allow_mixed=True) == "px"
    with pytest.raises(InputError, match="'a' in mw, 'b' in px"):
        same_unit([mw, px])
    with pytest.raises(InputError, match="one take or more"):
        same_unit([])


# -- profiles ---------------------------------------------------------------------------------------------------------


def test_a_profile_in_mouth_widths_and_in_px(tmp_path):
    made = profile(STATUSES)
    made.save(tmp_path, "clip")
    for path in (tmp_path, tmp_path / "clip", tmp_path / "clip.frames.csv", tmp_path / "clip.json"):
        found = read_take(path)
        assert (found.name, found.unit, found.source) == ("clip", "mw", "profile")
        assert np.allclose(found.channels["width"], made.frames["width_px"] / 60, equal_nan=True)
        assert np.allclose(found.channels["area"], made.frames["area_px"] / 3600, equal_nan=True)
    assert found.channels["width"][0] == 0 and math.isnan(found.channels["width"][2])
    assert np.array_equal(found.channels["n_openings"], [0, 1, np.nan, 1, 0], equal_nan=True)
    assert np.allclose(read_take(tmp_path, unit="px").channels["height"], made.frames["height_px"], equal_nan=True)
    assert read_take(tmp_path, mouth_width=120.0).channels["width"][1] == pytest.approx(40 / 120)
    assert lipmetrics.read_take is read_take


def test_openings_of_a_profile_have_x_to_the_right_and_y_down(tmp_path):
    made = profile(STATUSES)
    made.meta["corners_px"] = [[60.0, 10.0], [54.0, 102.0]]  # their middle is 6 px to the right and 3 px above
    made.save(tmp_path, "clip")
    found = read_take(tmp_path)
    assert list(found.openings.columns) == list(OPENING_COLUMNS)
    first = found.openings.iloc[0]
    assert (first.left, first.right, first.x) == pytest.approx((-26 / 60, 14 / 60, -6 / 60))
    assert first.top < 0 < first.bottom and first.y == pytest.approx(3 / 60)
    assert first.width == pytest.approx(40 / 60) and first.time_s == 0.04
    del made.meta["corners_px"]
    guessed = take_of_profile(made, "a").meta
    assert guessed["origin"] == "middle of the openings in the widest frame"


def test_an_unknown_mouth_width_is_refused_in_mouth_widths_only(tmp_path):
    profile(STATUSES, math.nan).save(tmp_path, "clip")
    with pytest.raises(InputError, match="known mouth width"):
        read_take(tmp_path)
    assert read_take(tmp_path, unit="px").channels["width"][1] == 40
    assert read_take(tmp_path, mouth_width=80).channels["width"][1] == pytest.approx(0.5)
    with pytest.raises(InputError, match="knows no metres"):
        read_take(tmp_path, unit="m")


def test_a_table_of_sizes_alone(tmp_path):
    made = profile(STATUSES)
    made.save(tmp_path / "all", "clip")
    path = tmp_path / "clip.csv"
    path.write_bytes((tmp_path / "all" / "clip.frames.csv").read_bytes())
    found = read_take(path)
    assert found.openings is None and found.name == "clip"
    assert np.allclose(found.channels["width"], made.frames["width_mw"], equal_nan=True)
    assert read_take(path, mouth_width=80).channels["height"][1] == pytest.approx(made.frames["height_px"][1] / 80)
    pd.read_csv(path)[["time_s", "width_px", "height_px", "area_px"]].to_csv(path, index=False)
    assert read_take(path, unit="px").channels["width"][1] == 40
    with pytest.raises(InputError, match="mouth width in px"):
        read_take(path)
    pd.read_csv(path).drop(columns="area_px").to_csv(path, index=False)
    with pytest.raises(InputError, match="missing area_px"):
        read_take(path, unit="px")


@pytest.mark.parametrize("text", ["hi\n", "a,b\n1,2\n"])
def test_a_table_of_something_else_is_refused_as_a_table(tmp_path, text):
    (tmp_path / "wrong.csv").write_text(text)
    with pytest.raises(InputError, match=r"to be a profile's table .* found the columns (hi|a, b)$"):
        read_take(tmp_path / "wrong.csv")


def test_a_profile_that_is_cut_short_is_refused(tmp_path):
    profile(STATUSES).save(tmp_path, "clip")
    whole = (tmp_path / "clip.frames.csv").read_text()
    header = whole.index("\n") + 1
    for length in (0, 40, header, header + 1, header + 6, header + 12):
        (tmp_path / "clip.frames.csv").write_text(whole[:length])
        with pytest.raises(InputError):
            read_take(tmp_path)
    (tmp_path / "clip.frames.csv").write_text(whole[: whole.rindex("3,0.12") + 15])
    with pytest.raises(InputError, match="as many rows of openings"):
        read_take(tmp_path)


def test_a_table_of_frames_without_its_companions_is_told(tmp_path):
    profile(STATUSES).save(tmp_path, "clip")
    (tmp_path / "clip.json").unlink()
    with pytest.raises(InputError, match=r"clip\.json"):
        read_take(tmp_path / "clip")


# -- simulated clips and meshes ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """A mouth of two openings that merge: its truth in `clip`, its surface in `obj`, and its inner lips."""
    folder = tmp_path_factory.mktemp("moved")
    mouth, motion = moved_mouth("medium", patch=(0.002, 0.008))
    truth(motion, mouth, Camera()).save(folder / "clip", "moved")
    write_obj_sequence(folder / "obj" / "moved.obj", mouth, motion)
    surface = display_surface(mouth)
    upper, lower = (surface.vertex_of(lip[:, 1]).tolist() for lip in (mouth.upper, mouth.lower))
    (folder / "loop.json").write_text(json.dumps({"loop": upper + lower[::-1], "corners": [upper[0], upper[-1]]}))
    return folder


def test_a_simulated_clip_is_read_from_its_truth(clip):
    found = read_take(clip / "clip")
    frames = pd.read_csv(clip / "clip" / "moved.frames.csv")
    assert (found.name, found.source, found.unit) == ("moved", "truth", "mw")
    assert np.allclose(found.channels["width"], frames["width_mw"], rtol=1e-6)
    metres = read_take(clip / "clip" / "moved.metres.frames.csv", unit="m")
    table = pd.read_csv(clip / "clip" / "moved.metres.frames.csv")
    assert np.array_equal(metres.channels["area"], table["area_m2"])
    assert metres.channels["width"][-1] == pytest.approx(0.05, rel=1e-3)
    assert metres.meta["mouth_width"] == pytest.approx(0.05)
    last = metres.openings.iloc[-1]
    assert (last.left, last.right) == pytest.approx((-0.025, 0.025), abs=1e-4) and last.bottom > 0.01 > last.top


def test_the_video_of_a_simulated_clip_is_measured_when_asked_for(clip, tmp_path, monkeypatch):
    for file in (clip / "clip").iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    with pytest.raises(InputError, match=r"moved\.mp4"):
        read_take(tmp_path, video=True)
    (tmp_path / "moved.mp4").write_bytes(b"pictures")
    monkeypatch.setattr(pipeline, "measure", lambda path, **_: profile([OPEN, CLOSED]))
    monkeypatch.setattr("lipmetrics.kept._corners_at_rest", lambda *_: None)
    found = read_take(tmp_path, video=True)
    assert found.source == "video" and len(found.time_s) == 2
    assert read_take(tmp_path / "moved.mp4").source == "video"


def test_an_exported_mesh_measures_as_its_truth_says(clip):
    """Truth closes the columns that touch intact saliva and keeps a coat of 0.1 mm on the lips; the mesh knows neither.

    So an end of an opening may differ by an element, 0.83 mm, and a height by the coat.
    """
    true = read_take(clip / "clip", unit="m")
    found = read_take(
        clip / "obj",
        unit="m",
        metres_per_unit=1.0,
        fps=10,
        lip_loop=clip / "loop.json",
        mesh=MeshSettings(gap_mw=0.002),
    )
    assert found.source == "mesh" and len(found.openings) == found.channels["n_openings"].sum() > 0
    assert found.time_s == pytest.approx(true.time_s)
    assert found.channels["n_openings"].tolist() == true.channels["n_openings"].tolist()
    off = {name: np.abs(found.channels[name] - true.channels[name]).max() for name in CHANNELS}
    assert off["height"] < 0.11e-3
    assert off["width"] < 0.84e-3
    assert off["area"] < 0.05 * 0.1e-3 + 1e-6
    assert found.meta["mouth_width"] == pytest.approx(0.05, rel=1e-4)
    merges = [one.openings.query("event == 'merge'")[["frame", "parents"]].to_numpy().tolist() for one in (found, true)]
    assert merges[0] == merges[1] == [[5, "1+2"]]
    ends = [
        one.openings.groupby("frame")[["left", "right"]].agg({"left": "min", "right": "max"}) for one in (found, true)
    ]
    assert np.abs(ends[0] - ends[1]).to_numpy().max() < 0.9e-3


def test_a_mesh_says_what_it_needs(clip):
    settings = {"fps": 10, "lip_loop": clip / "loop.json"}
    assert read_take(clip / "obj", **settings).unit == "mw"
    pattern = read_take(clip / "obj" / "moved_*.obj", unit="model", **settings)
    assert pattern.channels["width"][-1] == pytest.approx(0.0488, abs=1e-3) and pattern.name == "obj"
    for changed, match in (
        ({"fps": None}, "frame rate of a mesh"),
        ({"lip_loop": None}, "vertices of the inner lips"),
        ({"unit": "px"}, "no picture is made"),
        ({"unit": "m"}, "length of a unit"),
        ({"lip_loop": [0, 1, 2, 10**6]}, "numbers count from 0"),
        ({"fps": -1}, "frame rate above 0"),
    ):
        with pytest.raises(InputError, match=match):
            read_take(clip / "obj", **(settings | changed))


def test_an_array_of_vertices(tmp_path):
    x = np.linspace(-1, 1, 5)
    loop = np.concatenate([np.column_stack([x, 0 * x, 0 * x]), np.column_stack([x, 0 * x, 0 * x])[-2:0:-1]])
    points = np.repeat(loop[None], 4, axis=0)
    points[2:, 1:4, 1] = 0.5
    np.save(tmp_path / "mouth.npy", points)
    found = read_take(tmp_path / "mouth.npy", fps=50, lip_loop=range(8), mesh=MeshSettings(gap_mw=0))
    assert found.name == "mouth" and found.time_s == pytest.approx([0, 0.02, 0.04, 0.06])
    assert found.channels["area"] == pytest.approx([0, 0, 0.75 / 4, 0.75 / 4])
    with pytest.raises(InputError, match="found a mesh"):
        read_take(tmp_path / "mouth.npy", fps=50, lip_loop=range(8), video=True)


# -- landmarks, and what is told apart ---------------------------------------------------------------------------------


def landmark_table(path, outer=True):
    columns = {"frame": np.arange(3)}
    points = {n: (100.0 + 10 * n, 200.0) for n in range(8)} if not outer else {n: (50.0 + n, 60.0) for n in range(68)}
    start = 60 if outer else 0
    ring = [(100, 200), (120, 190), (140, 190), (160, 190), (180, 200), (160, 210), (140, 210), (120, 210)]
    points |= {start + k: place for k, place in enumerate(ring)}
    if outer:
        points |= {48: (90, 200), 54: (190, 200)}
    for n, (x, y) in points.items():
        columns[f"x_{n}"], columns[f"y_{n}"] = np.full(3, float(x)), np.full(3, float(y))
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def test_landmarks(tmp_path):
    found = read_take(landmark_table(tmp_path / "a.csv"), fps=25)
    assert (found.source, found.unit) == ("dlib", "mw")
    assert found.channels["width"] == pytest.approx([0.8] * 3)
    assert found.channels["area"] == pytest.approx([0.12] * 3)
    assert found.openings["left"].tolist() == pytest.approx([-0.4] * 3)
    assert found.openings["area"].tolist() == pytest.approx([0.12] * 3)
    alone = landmark_table(tmp_path / "b.csv", outer=False)
    with pytest.raises(InputError, match="inner lips alone"):
        read_take(alone, fps=25)
    assert read_take(alone, fps=25, unit="px").channels["height"] == pytest.approx([20] * 3)
    assert read_take(alone, fps=25, mouth_width=100).channels["height"] == pytest.approx([0.2] * 3)
    with pytest.raises(InputError, match="mw or px for landmarks"):
        read_take(alone, fps=25, unit="m")


def test_what_cannot_be_a_take_is_told(tmp_path):
    (tmp_path / "empty.csv").write_bytes(b"")
    (tmp_path / "people.csv").write_text("name,age\nanna,3\n")
    for name, match in (("empty.csv", "an empty file"), ("people.csv", "columns name, age"), ("emty.csv", "empty.csv")):
        with pytest.raises(InputError, match=match):
            read_take(tmp_path / name)
    with pytest.raises(InputError, match="did you mean 'model'"):
        read_take(tmp_path, unit="modell")
    with pytest.raises(InputError, match="mouth width above 0"):
        read_take(tmp_path, mouth_width=-3)
    (tmp_path / "none").mkdir()
    with pytest.raises(InputError, match="expected pictures"):
        read_take(tmp_path / "none")
    (tmp_path / "text.mp4").write_text("no video")
    with pytest.raises(InputError, match="video"):
        read_take(tmp_path / "text.mp4")


def test_several_takes_of_a_folder_in_order_of_name(tmp_path):
    for stem in ("b", "a", "c"):
        profile(STATUSES).save(tmp_path / "out", stem)
    assert [one.name for one in read_takes(tmp_path / "out")] == ["a", "b", "c"]
    with pytest.raises(InputError, match="found 3 in"):
        read_take(tmp_path / "out")
    profile(STATUSES).save(tmp_path / "other", "a")
    both = read_takes([tmp_path / "out", tmp_path / "other", tmp_path / "out"])
    assert [one.name for one in both] == ["out/a", "b", "c", "other/a"]
    assert [one.name for one in read_takes(tmp_path)] == ["other/a", "out/a", "b", "c"]
    with pytest.raises(InputError, match="no name for 3"):
        read_takes(tmp_path / "out", name="x")
    with pytest.raises(InputError, match="one take or more"):
        read_takes([])


def test_a_folder_of_other_takes(tmp_path):
    for name in ("b.csv", "a.csv"):
        landmark_table(tmp_path / name)
    assert [one.name for one in read_takes(tmp_path, fps=25)] == ["a", "b"]
    with pytest.raises(InputError, match=r"a folder with 2 \(a.csv, b.csv\)"):
        read_take(tmp_path, fps=25)
    (tmp_path / "c.mp4").write_bytes(b"")
    assert take_paths(tmp_path) == [tmp_path / "c.mp4"]
    assert take_paths(tmp_path / "c.mp4") == [tmp_path / "c.mp4"]


def test_a_folder_of_pictures_is_one_video(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "notes.txt").write_text("")
    assert take_paths(tmp_path) == [tmp_path / "sub"]
    (tmp_path / "1.png").write_bytes(b"")
    assert take_paths(tmp_path) == [tmp_path]


@pytest.mark.parametrize("column", ["width_m", "height_m"])
def test_text_among_the_numbers_of_a_truth_in_metres(tmp_path, column):
    mouth, motion = moved_mouth()
    truth(motion, mouth, Camera(), motion.time_s).save(tmp_path, "a")
    table = pd.read_csv(tmp_path / "a.metres.frames.csv", dtype=str)
    table.loc[0, column] = "--1"
    table.to_csv(tmp_path / "a.metres.frames.csv", index=False)
    with pytest.raises(InputError, match=f"expected numbers in the column '{column}'"):
        read_take(tmp_path / "a", unit="m")
