import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_lipmetrics_validation import rows

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import other_landmarks
import validate
import validate_others

from lipmetrics.validation import by_condition


def conditions() -> pd.DataFrame:
    clips = pd.DataFrame(
        [("a", "noise", "3 %", "walk"), ("b", "noise", "6 %", "walk"), ("c", "beard", "full", "walk")],
        columns=["clip", "axis", "setting", "take"],
    )
    clips["condition"] = clips["axis"] + ": " + clips["setting"]
    frames = pd.concat([rows("oo", "oo", name="a"), rows("oo", "oc", name="b"), rows("oo", "oo", name="c", iou=0.8)])
    table = by_condition(frames, clips)
    return table.assign(verdict=["trusted", "not to be used", "with care"])


def test_settings_stand_under_their_verdict():
    lines = validate.trust(conditions()).splitlines()
    assert lines[0] == "| condition | trusted | with care | not to be used |"
    assert lines[2:] == ["| noise | 3 % | - | 6 % |", "| beard | - | full | - |"]


def test_goals_of_methods_stand_side_by_side():
    row = {"what": "IoU", "goal": ">= 0.95", "all": "0.9", "mix": "-", "met": False}
    other = [row | {"all": "0.1", "met": None}, row | {"what": "tones"}]
    lines = validate.goals({"default": {"targets": [row]}, "thesis": {"targets": other}}).splitlines()
    assert lines[2] == "| IoU | >= 0.95 | 0.9 | - | not met | 0.1 | - | - |"
    assert lines[3] == "| tones | >= 0.95 | - | - | - | 0.9 | - | not met |"


def test_some_figures_as_a_table():
    text = validate.shown(conditions(), "condition", {"iou_median": "IoU", "found_percent": "found"})
    assert text.splitlines()[2:] == [
        "| noise: 3 % | 0.9 | 100 |",
        "| noise: 6 % | 0.45 | 100 |",
        "| beard: full | 0.8 | 100 |",
    ]


def test_what_another_tool_sees_as_a_profile():
    ring = [(30, 40), (50, 35), (70, 40), (50, 45)]
    slit = [(30, 40), (50, 39.5), (70, 40), (50, 40.5)]
    lines = [{"inner": one, "ends": [(10, 40), (90, 40)]} for one in (ring, slit)] + [{"inner": None, "ends": None}]
    profile = validate_others.profile_of(lines, np.arange(3) / 25)
    assert profile.frames["status"].tolist() == ["open", "closed", "no_mouth"]
    assert profile.frames["height_px"].tolist()[:2] == [10, 0] and profile.frames["width_px"].iloc[0] == 40
    assert profile.meta["mouth_width_px"] == 80 and profile.corners[0].tolist() == [[40, 10], [40, 90]]


@pytest.mark.parametrize(
    "code, wanted",
    [
        ("import sys; print('no tool', file=sys.stderr); sys.exit(3)", "no tool"),
        ("import json; print(json.dumps({'video': 'v', 'frame': 0, 'inner': None, 'ends': None}))", 1),
    ],
)
def test_a_tool_that_is_not_there_is_said(code, wanted, tmp_path, monkeypatch):
    script = tmp_path / "other_landmarks.py"
    script.write_text(code)
    monkeypatch.setattr(validate_others, "__file__", str(tmp_path / "validate_others.py"))
    found = validate_others.lips_of("mediapipe", sys.executable, [Path("v")])
    assert found == wanted if isinstance(wanted, str) else len(found["v"]) == wanted
    assert json.dumps(found)


def test_the_points_of_dlib_are_those_of_the_package(tmp_path, monkeypatch):
    assert other_landmarks.packaged_predictor() is None
    package = tmp_path / "face_recognition_models"
    package.mkdir()
    (package / "__init__.py").write_text("raise RuntimeError('not to be imported')")
    monkeypatch.syspath_prepend(tmp_path)
    assert Path(other_landmarks.packaged_predictor()).parent.parent == package


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--python", "no/such/python"], "expected --python with an interpreter"),
        (["--only", "nosuch"], "expected conditions such as"),
    ],
)
def test_bad_words_are_refused_in_a_line(words, said, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["validate_others.py", *words])
    with pytest.raises(SystemExit) as ended:
        validate_others.main()
    assert ended.value.code == 2 and said in capsys.readouterr().err


def test_a_video_that_cannot_be_read_is_said(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(other_landmarks.TOOLS, "mediapipe", lambda: lambda rgb: None)
    assert other_landmarks.main("mediapipe", [str(tmp_path / "no.mp4")]) == 2
    assert "no.mp4" in capsys.readouterr().err
