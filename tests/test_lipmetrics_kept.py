import numpy as np
import pytest
from mouth_clip import looks_of, profile_of

from lipmetrics import kept, pipeline
from lipmetrics.errors import InputError
from lipmetrics.kept import measured_profile
from lipmetrics.look import CLOSED, NO_MOUTH, OPEN
from lipmetrics.profile import FORMAT


@pytest.fixture
def measured(monkeypatch):
    """Calls of a `measure` that sees four frames at once, whatever the file holds."""
    calls = []

    def measure(source, *, on_look, **settings):
        calls.append((str(source), settings))
        looks = looks_of([CLOSED, OPEN, NO_MOUTH, OPEN])
        for look in looks:
            on_look(None, look)
        profile = profile_of(looks, [0.0, 0.04, 0.08, 0.12], 60.0)
        profile.meta["format"] = FORMAT
        return profile

    monkeypatch.setattr(pipeline, "measure", measure)
    return calls


def video(path, content=b"pictures"):
    path.write_bytes(content)
    return path


def test_a_video_is_measured_once(tmp_path, measured):
    path = video(tmp_path / "clip.mp4")
    first = measured_profile(path, tmp_path / "work")
    again = measured_profile(path, tmp_path / "work")
    assert len(measured) == 1
    assert first.frames.equals(again.frames) and first.meta == again.meta
    assert sorted(one.name.split("-")[0] for one in (tmp_path / "work").iterdir()) == ["clip"] * 3


def test_corners_at_rest_are_kept(tmp_path, measured):
    profile = measured_profile(video(tmp_path / "clip.mp4"), tmp_path / "work")
    assert np.allclose(profile.meta["corners_px"], [[60, 20], [60, 80]])


@pytest.mark.parametrize("changed", ["content", "method", "frame rate", "versions"])
def test_it_is_measured_again_where_something_differs(tmp_path, measured, monkeypatch, changed):
    path = video(tmp_path / "clip.mp4")
    measured_profile(path, tmp_path / "work")
    settings = {}
    if changed == "content":
        video(path, b"pictureS")
    elif changed == "versions":
        monkeypatch.setattr(pipeline, "versions", lambda: {"lipmetrics": "another"})
    else:
        settings = {"method": "thesis"} if changed == "method" else {"fps": 30.0}
    measured_profile(path, tmp_path / "work", **settings)
    assert len(measured) == 2
    measured_profile(path, tmp_path / "work", **settings)
    assert len(measured) == 2


def test_a_broken_profile_is_measured_again(tmp_path, measured):
    path = video(tmp_path / "clip.mp4")
    measured_profile(path, tmp_path / "work")
    (table,) = (tmp_path / "work").glob("*.frames.csv")
    table.write_text("frame,time_s\n")
    assert len(measured_profile(path, tmp_path / "work").frames) == 4
    assert len(measured) == 2


def test_nothing_is_kept_without_a_folder(tmp_path, measured):
    path = video(tmp_path / "clip.mp4")
    measured_profile(path)
    measured_profile(path)
    assert len(measured) == 2 and [one.name for one in tmp_path.iterdir()] == ["clip.mp4"]


def test_a_video_that_is_missing(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        measured_profile(tmp_path / "clip.mp4", tmp_path / "work")


def test_corners_that_are_never_found_are_unknown():
    profile = profile_of(looks_of([NO_MOUTH, NO_MOUTH]), [0.0, 0.04])
    assert kept._corners_at_rest(profile, np.full((2, 2, 2), np.nan)) is None
