import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from lipmetrics.errors import InputError
from lipmetrics.landmark_tables import is_landmark_table, read_landmarks
from lipmetrics.meshes import MEDIAPIPE_INNER

REFERENCE = Path(os.environ.get("LIPMETRICS_REFERENCE", Path(__file__).parents[2] / "shared" / "reference"))
REAL = REFERENCE / "real" / "videos"


def inner(points, height, x=100.0, y=200.0, width=80.0):
    """(points, 2) px: a lens of this height with corners (x, y) and (x + width, y), from the left one along the top."""
    half = points // 2
    share = np.linspace(0, 1, half + 1)
    curve = height / 2 * np.where((share > 0) & (share < 1), 1.0, 0.0)
    upper = np.column_stack([x + width * share, y - curve])
    lower = np.column_stack([x + width * share, y + curve])
    return np.concatenate([upper, lower[-2:0:-1]])


def face_68(height):
    points = np.random.default_rng(1).uniform(50, 300, (68, 2))
    points[60:] = inner(8, height)
    points[48], points[54] = (90, 200), (190, 200)
    return points


def face_478(height):
    points = np.random.default_rng(2).uniform(50, 300, (478, 2))
    points[list(MEDIAPIPE_INNER)] = inner(20, height)
    points[61], points[291] = (90, 200), (190, 200)
    return points


def wide(faces, names="{axis}_{n}", **first):
    columns = dict(first)
    for axis, name in enumerate("xy"):
        for n in range(faces.shape[1]):
            columns[names.format(axis=name, n=n)] = faces[:, n, axis]
    return pd.DataFrame(columns)


HEIGHTS = [0, 0, 0, 20, 40]
FACES = np.array([face_68(h) for h in HEIGHTS])
AREAS = [0, 0, 0, 20 * 60, 40 * 60]  # 80 wide, each end slopes over a quarter


def save(path, table):
    table.to_csv(path, index=False)
    return path


def openface(path, faces=FACES, **columns):
    T = len(faces)
    first = {"frame": np.arange(1, T + 1), "timestamp": np.arange(T) / 30, "confidence": 0.98, "success": 1}
    table = wide(faces, **(first | columns))
    for axis in "XY":  # places in space, mm, which are other points
        table[f"{axis}_60"] = -1.0
    table["eye_lmk_x_60"] = table["eye_lmk_y_60"] = -1.0
    text = table.to_csv(index=False)
    head, rest = text.split("\n", 1)
    path.write_text(head.replace(",", ", ") + "\n" + rest)
    return path


def test_openface_with_blanks_in_its_header(tmp_path):
    found = read_landmarks(openface(tmp_path / "a.csv"))
    assert found.source == "openface"
    assert found.time_s == pytest.approx(np.arange(5) / 30)
    assert found.channels["height"] == pytest.approx(HEIGHTS)
    assert found.channels["width"] == pytest.approx([0, 0, 0, 80, 80], abs=1e-5)
    assert found.channels["area"] == pytest.approx(AREAS)
    assert found.channels["n_openings"].tolist() == [0, 0, 0, 1, 1]
    assert found.mouth_width == pytest.approx(100)
    assert (found.openings["left"].iloc[0], found.openings["top"].iloc[0]) == pytest.approx((-40, -10), abs=1e-5)


def test_frames_without_success_are_unknown(tmp_path):
    found = read_landmarks(openface(tmp_path / "a.csv", success=[1, 1, 1, 0, 1]))
    assert np.array_equal(found.channels["height"], [0, 0, 0, np.nan, 40], equal_nan=True)
    assert found.channels["n_openings"][4] == 1


def test_pyfeat_and_dlib_are_told_apart_and_need_a_frame_rate(tmp_path):
    frame = np.arange(5)
    feat = save(tmp_path / "f.csv", wide(FACES, frame=frame, FaceRectX=1.0, approx_time="00:00"))
    plain = save(tmp_path / "d.csv", wide(FACES, names="{axis}{n}", frame=frame))
    for path, source in ((feat, "pyfeat"), (plain, "dlib")):
        found = read_landmarks(path, fps=25)
        assert found.source == source
        assert found.time_s == pytest.approx(frame / 25)
        assert found.channels["height"] == pytest.approx(HEIGHTS)
        with pytest.raises(InputError, match="give the frame rate"):
            read_landmarks(path)


@pytest.mark.parametrize("names", ["{axis}_{n}", "{axis}{n}", "{n}_{axis}", "landmark_{n}_{axis}", "lm{n}{axis}"])
def test_mediapipe_wide(tmp_path, names):
    faces = np.array([face_478(h) for h in HEIGHTS])
    found = read_landmarks(save(tmp_path / "a.csv", wide(faces, names, timestamp_ms=np.arange(5) * 40)))
    assert found.source == "mediapipe"
    assert found.time_s == pytest.approx(np.arange(5) / 25)
    assert found.channels["height"] == pytest.approx(HEIGHTS)
    assert found.channels["width"] == pytest.approx([0, 0, 0, 80, 80], abs=1e-5)
    assert found.mouth_width == pytest.approx(100)


def test_mediapipe_long_in_any_order_as_shares_of_the_picture(tmp_path):
    faces = np.array([face_478(h) for h in HEIGHTS])
    rows = [
        {"frame": t, "landmark": n, "x": faces[t, n, 0] / 640, "y": faces[t, n, 1] / 360, "z": 0.0, "time_s": t / 25}
        for t in range(5)
        for n in range(478)
    ]
    path = save(tmp_path / "a.csv", pd.DataFrame(rows).sample(frac=1, random_state=1))
    found = read_landmarks(path, picture_size=(640, 360))
    assert found.channels["height"] == pytest.approx(HEIGHTS)
    assert found.channels["area"] == pytest.approx([0, 0, 0, 20 * 72, 40 * 72])  # ends slope over a tenth
    assert found.time_s == pytest.approx(np.arange(5) / 25)
    with pytest.raises(InputError, match="give its size"):
        read_landmarks(path)


@pytest.mark.parametrize(("points", "source"), [(20, "mediapipe"), (8, "dlib")])
def test_inner_lips_alone_know_no_mouth_width(tmp_path, points, source):
    faces = np.array([inner(points, h) for h in HEIGHTS])
    path = save(tmp_path / "a.csv", wide(faces, "{axis}{n}", frame=np.arange(5), n=points))
    found = read_landmarks(path, fps=25)
    assert found.source == source and np.isnan(found.mouth_width)
    assert found.channels["height"] == pytest.approx(HEIGHTS)
    assert read_landmarks(path, fps=25, mouth_width=90.0).mouth_width == 90


def test_low_openings_and_lips_that_cross_are_closed(tmp_path):
    faces = np.array([face_68(h) for h in (1.9, 2.1, 30, 0)])
    faces[3, 61:64, 1] += 5  # upper below lower
    faces[3, 61, 1] -= 6  # but for one point
    path = save(tmp_path / "a.csv", wide(faces, frame=np.arange(4)))
    found = read_landmarks(path, fps=25, mouth_width=100.0)
    assert found.channels["n_openings"].tolist() == [0, 1, 1, 0]
    faces[2, 62, 1], faces[2, 66, 1] = 205, 195  # lips that cross in the middle and are open on both sides
    crossed = read_landmarks(save(path, wide(faces, frame=np.arange(4))), fps=25, mouth_width=100.0)
    assert crossed.channels["n_openings"][2] == 1 and crossed.channels["width"][2] == pytest.approx(80, abs=1e-5)
    assert found.channels["area"][[0, 3]].tolist() == [0, 0]
    exact = read_landmarks(path, fps=25, mouth_width=100.0, closed_below_mw=0.0).channels["n_openings"]
    assert exact.tolist() == [1, 1, 1, 1]


def test_frames_that_the_table_leaves_out_are_unknown(tmp_path):
    faces = np.array([face_68(h) for h in (0, 0, 10, 20, 30)])
    frame = np.array([0, 1, 2, 5, 6])
    found = read_landmarks(save(tmp_path / "a.csv", wide(faces, frame=frame)), fps=10)
    assert found.time_s == pytest.approx(np.arange(7) / 10)
    assert np.array_equal(found.channels["height"], [0, 0, 10, np.nan, np.nan, 20, 30], equal_nan=True)


def test_the_width_at_rest_is_that_of_the_least_open_frames(tmp_path):
    faces = np.array([face_68(h) for h in (0, 0, 0, 40, 40, 40, 40)])
    faces[3:, 54, 0] = 150
    assert read_landmarks(save(tmp_path / "a.csv", wide(faces)), fps=25).mouth_width == pytest.approx(100)


def spoil(table, how):
    if how == "two faces":
        return pd.concat([table, table.iloc[[2]]])
    if how == "text":
        table["x_60"] = table["x_60"].astype(object)
        table.loc[1, "x_60"] = "far"
    if how == "no points":
        table[[c for c in table if c != "frame"]] = np.nan
    if how == "few points":
        return table[["frame", *[f"{axis}_{n}" for n in range(12) for axis in "xy"]]]
    if how == "empty":
        return table.iloc[:0]
    return table


@pytest.mark.parametrize(
    ("how", "match"),
    [
        ("two faces", "one face per frame.*frame 2"),
        ("text", "numbers in the column 'x_60'"),
        ("no points", "frame with all points"),
        ("few points", "found 12 points, numbers 0 to 11"),
        ("empty", "one frame or more"),
    ],
)
def test_bad_tables(tmp_path, how, match):
    path = save(tmp_path / "a.csv", spoil(wide(FACES, frame=np.arange(5)), how))
    with pytest.raises(InputError, match=match):
        read_landmarks(path, fps=25)


def test_other_bad_input(tmp_path):
    path = save(tmp_path / "a.csv", wide(FACES, frame=np.arange(5)))
    with pytest.raises(InputError, match="frame rate above 0"):
        read_landmarks(path, fps=0)
    with pytest.raises(InputError, match="closed"):
        read_landmarks(path, fps=25, closed_below_mw=-1)
    with pytest.raises(InputError, match="no such file"):
        read_landmarks(tmp_path / "b.csv")
    with pytest.raises(InputError, match="size as"):
        read_landmarks(path, fps=25, picture_size=(640,))
    (tmp_path / "c.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="table of landmarks"):
        read_landmarks(tmp_path / "c.csv")
    rows = pd.DataFrame({"frame": [0, 0], "landmark": [1, 1], "x": [1.0, 2.0], "y": [1.0, 2.0]})
    with pytest.raises(InputError, match=r"one face per frame.*several times"):
        read_landmarks(save(tmp_path / "d.csv", rows))


def test_what_is_a_table_of_landmarks():
    assert is_landmark_table(["frame", *(f" {axis}_{n}" for axis in "xy" for n in range(68))])
    assert is_landmark_table(["frame", "landmark", "x", "y"])
    assert not is_landmark_table(["frame", "time_s", "status", "width_px"])
    assert not is_landmark_table(["x", "y", "label"])


@pytest.mark.skipif(
    not REAL.is_dir(), reason="reference data absent; set LIPMETRICS_REFERENCE or put them in ../shared/reference"
)
def test_recordings_give_the_heights_that_were_counted_by_other_code():
    counted = pd.read_csv(REAL / "vr_1.profile.csv")
    width = float(counted["mouth_w_px"].median())
    lips = read_landmarks(REAL / "vr_1.lips.csv", fps=25, mouth_width=width, closed_below_mw=0.0)
    off = np.abs(lips.channels["height"] - counted["open_h_px"])
    assert len(off) == 135 and np.quantile(off, 0.95) < 0.3
    dlib = read_landmarks(REAL / "vr_1.dlib.csv", fps=25, mouth_width=width, closed_below_mw=0.0)
    assert np.quantile(np.abs(dlib.channels["height"] - counted["dlib_h_px"]), 0.95) < 1.5  # whole px
