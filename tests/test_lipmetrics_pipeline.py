import hashlib
import json
import math
import shutil

import numpy as np
import pytest
import ring_mouth
from clips import write_pictures, write_video

import lipmetrics
from lipmetrics import detect
from lipmetrics.errors import InputError
from lipmetrics.mask import ThesisSettings
from lipmetrics.pipeline import measure
from lipmetrics.profile import FRAME_COLUMNS, OPENING_COLUMNS


@pytest.fixture(autouse=True)
def scripted(monkeypatch):
    monkeypatch.setitem(detect.METHODS, "script", "ring_mouth")


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """Six frames: closed, opening in two places, merged, closing."""
    pictures = [ring_mouth.ring(*h) for h in ((0,), (5, 7), (6, 8), (9,), (12,), (0,))]
    path = tmp_path_factory.mktemp("clip") / "ring.mp4"
    return write_video(path, pictures, pixel_format="yuv444p", options={"crf": "8"}, ticks=[0, 1, 2, 4, 5, 8])


def test_the_thesis_method_measures_a_video(clip):
    found = measure(clip, method="thesis")
    assert tuple(found.frames.columns) == FRAME_COLUMNS and tuple(found.openings.columns) == OPENING_COLUMNS
    assert found.frames["time_s"].tolist() == pytest.approx([0, 0.04, 0.08, 0.16, 0.2, 0.32])
    assert found.frames["status"].tolist() == ["closed", "open", "open", "open", "open", "closed"]
    assert found.frames["n_openings"].tolist() == [0, 2, 2, 1, 1, 0]
    assert found.frames["height_px"].tolist() == pytest.approx([0, 15, 17, 19, 25, 0], abs=1.5)
    assert found.meta["mouth_width_px"] == pytest.approx(81, abs=2)
    assert found.meta["video"]["variable_frame_rate"] is True
    rise = (found.frames["height_mw"][4] - found.frames["height_mw"][1]) / 0.16
    assert found.frames["d_height_mw_s"][4] == pytest.approx(rise)


def test_identities_and_events_reach_the_table(clip):
    openings = measure(clip, method="thesis").openings
    assert openings["frame"].tolist() == [1, 1, 2, 2, 3, 4]
    assert openings["event"].tolist() == ["new", "new", "", "", "merge", ""]
    merged = openings.iloc[4]
    assert merged["parents"] == "+".join(str(n) for n in openings["opening"][2:4])
    assert openings["opening"].tolist() == [1, 2, 1, 2, 1, 1]


def test_closed_and_unknown_are_told_apart(clip):
    frames = measure(clip, method="script", settings=(8.0, 0.0, None)).frames
    assert frames["status"].tolist() == ["open", "closed", "no_mouth"] * 2
    assert frames["height_px"].tolist() == pytest.approx([8, 0, np.nan] * 2, nan_ok=True)


def test_a_frame_without_a_mouth_does_not_end_an_identity(clip):
    openings = measure(clip, method="script", settings=(8.0, None)).openings
    assert openings["opening"].tolist() == [1, 1, 1]
    assert measure(clip, method="script", settings=(8.0, 0.0)).openings["opening"].tolist() == [1, 2, 3]


def test_choices_reach_the_reader(clip):
    part = measure(clip, method="script", start_s=0.03, stop_s=0.21, every=2)
    assert part.frames["frame"].tolist() == [2, 4]
    given = {name: value for name, value in part.meta["choices"].items() if value is not None}
    assert given == {"start_s": 0.03, "stop_s": 0.21, "every": 2}


def test_a_given_mouth_width_is_used(clip):
    found = measure(clip, method="script", mouth_width_px=50)
    assert found.meta["mouth_width_found"] == "given"
    assert found.frames["height_mw"][0] == pytest.approx(10 / 50)
    assert measure(clip, method="script").meta["mouth_width_px"] == 40.0  # from the corners


@pytest.mark.parametrize("width", [0, -1, math.nan, math.inf])
def test_a_mouth_width_that_is_none_is_refused(clip, width):
    with pytest.raises(InputError, match="expected a mouth width above 0 px"):
        measure(clip, method="script", mouth_width_px=width)


def test_an_unknown_mouth_width_is_a_warning(clip):
    found = measure(clip, method="script", settings=(None,))
    assert math.isnan(found.meta["mouth_width_px"])
    assert any("--mouth-width" in warning for warning in found.meta["warnings"])


def test_the_provenance_names_the_file_the_settings_and_the_versions(clip):
    meta = measure(clip, method="thesis", settings=ThesisSettings(median_px=3)).meta
    data = clip.read_bytes()
    assert meta["source"] == {"name": "ring.mp4", "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    assert meta["settings"]["median_px"] == 3 and meta["method"] == "thesis"
    assert (meta["video"]["width"], meta["video"]["height"]) == (ring_mouth.WIDTH, ring_mouth.HEIGHT)
    assert meta["versions"]["lipmetrics"] and meta["versions"]["numpy"] == np.__version__


def test_the_same_input_gives_the_same_bytes_wherever_it_lies(clip, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    copy = shutil.copy(clip, tmp_path / "elsewhere" / clip.name)
    written = [measure(path, method="thesis").save(tmp_path / str(i), "x") for i, path in enumerate((clip, copy))]
    assert [path.read_bytes() for path in written[0]] == [path.read_bytes() for path in written[1]]
    assert "elsewhere" not in written[1][2].read_text()


def test_a_sequence_of_pictures_is_measured(tmp_path):
    folder = write_pictures(tmp_path / "take", [ring_mouth.ring(h) for h in (0, 6, 9)])
    found = measure(folder, method="thesis", fps=10)
    assert found.frames["time_s"].tolist() == pytest.approx([0, 0.1, 0.2])
    assert found.meta["source"]["files"] == 3
    times = tmp_path / "times.txt"
    times.write_text("0\n0.5\n0.7\n")
    timed = measure(f"{folder}/*.png", method="thesis", timestamps=times)
    assert timed.frames["time_s"].tolist() == pytest.approx([0, 0.5, 0.7])
    assert timed.meta["choices"]["timestamps"]["name"] == "times.txt"
    assert timed.meta["source"]["sha256"] == found.meta["source"]["sha256"]
    json.dumps(measure(folder, method="thesis", timestamps=[0, 1, 2]).meta)


def test_a_region_gives_the_same_openings(clip):
    whole = measure(clip, method="thesis").openings
    part = measure(clip, method="thesis", roi=(8, 78, 4, 110)).openings
    assert part["centroid_col"].tolist() == pytest.approx(whole["centroid_col"].tolist(), abs=0.5)
    assert part["centroid_row"].tolist() == pytest.approx(whole["centroid_row"].tolist(), abs=0.5)


def test_nothing_outside_the_region_is_seen(clip):
    assert set(measure(clip, method="thesis", roi=(0, 15, 0, 40)).frames["status"]) == {"no_mouth"}


def test_outlines_are_kept_only_when_asked_for(clip):
    assert measure(clip, method="script").outlines == []
    kept = measure(clip, method="script", settings=(8.0, 0.0), keep_outlines=True)
    assert [len(outlines) for outlines in kept.outlines] == [1, 0] * 3
    assert len(kept.corners) == 6 and kept.corners[0].shape == (2, 2)


def test_on_look_sees_every_frame(clip):
    seen = []
    measure(clip, method="script", on_look=lambda frame, look: seen.append((frame.index, look.status)))
    assert seen == list(enumerate(["open", "closed", "no_mouth"] * 2))


def test_progress_goes_to_stderr(clip, capsys):
    measure(clip, method="script", progress=True)
    out, err = capsys.readouterr()
    assert out == "" and "ring.mp4" in err


def test_public_names_load_when_used():
    assert lipmetrics.measure is measure
    assert {"measure", "load_profile", "opening_mask", "find_openings"} <= set(dir(lipmetrics))
    with pytest.raises(AttributeError, match="no attribute 'meassure'"):
        _ = lipmetrics.meassure
