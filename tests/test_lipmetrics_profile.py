import errno
import json
import math

import numpy as np
import pandas as pd
import pytest

from lipmetrics import profile as profiles
from lipmetrics.errors import InputError
from lipmetrics.look import CLOSED, NO_MOUTH, OPEN, Look
from lipmetrics.openings import Identity, measure_outline
from lipmetrics.profile import (
    FRAME_COLUMNS,
    OPENING_COLUMNS,
    Profile,
    load_profile,
    rate_of_change,
    resting_mouth_width,
)

META = {"format": profiles.FORMAT, "file": "drawn.mp4", "warnings": []}


def rectangle(height, width, row=10.0, col=20.0):
    return np.array([(row, col), (row, col + width), (row + height, col + width), (row + height, col)])


def profile_of(heights, mouth_width_px=50.0, step_s=0.04):
    """One opening of each height (or several, a tuple), 20 px wide; 0 is closed, None no mouth."""
    frames, openings = [], []
    for i, height in enumerate(heights):
        status = NO_MOUTH if height is None else OPEN if height else CLOSED
        outlines = [rectangle(h, 20.0, col=30.0 * k) for k, h in enumerate(np.atleast_1d(height))] if height else []
        look = Look(status, outlines, confidence=0.5)
        found = [measure_outline(outline) for outline in outlines]
        frames.append(profiles.frame_row(i, i * step_s, look, found))
        openings += [profiles.opening_row(i, i * step_s, Identity(k + 1), o) for k, o in enumerate(found)]
    meta = META | {"mouth_width_px": mouth_width_px}
    return Profile(*profiles.tables(frames, openings, mouth_width_px), meta)


def test_tables_have_the_columns_that_were_promised():
    found = profile_of([4.0, (4.0, 5.0)])
    assert tuple(found.frames.columns) == FRAME_COLUMNS
    assert tuple(found.openings.columns) == OPENING_COLUMNS
    assert FRAME_COLUMNS[:4] == ("frame", "time_s", "status", "n_openings") and FRAME_COLUMNS[-1] == "confidence"


def test_sizes_are_of_the_largest_opening_and_the_total_is_of_all():
    row = profile_of([(4.0, 5.0)]).frames.iloc[0]
    assert (row.n_openings, row.width_px, row.height_px, row.area_px, row.total_area_px) == (2, 20, 5, 100, 180)
    assert (row.width_mw, row.height_mw, row.area_mw2, row.ratio) == (0.4, 0.1, 0.04, 4.0)


def test_closed_is_zero_and_unknown_is_nan():
    frames = profile_of([0, None, 5.0]).frames
    measured = [c for c in FRAME_COLUMNS if c.endswith(("_px", "_mw", "_mw2")) or c == "n_openings"]
    assert (frames.loc[0, measured] == 0).all()
    assert frames.loc[1, measured].isna().all()
    assert frames.loc[2, measured].notna().all()
    assert math.isnan(frames.ratio[0]) and math.isnan(frames.ratio[1])


def test_a_closed_mouth_is_zero_mouth_widths_high_even_where_the_width_is_unknown():
    frames = profile_of([0, 5.0], mouth_width_px=math.nan).frames
    assert frames.height_mw[0] == 0 and math.isnan(frames.height_mw[1]) and frames.height_px[1] == 5


def test_rate_is_the_change_over_the_previous_three_steps():
    time_s = np.array([0.0, 0.1, 0.2, 0.4, 0.5])
    rate = rate_of_change(np.array([0.0, 1.0, 3.0, 4.0, 4.0]), time_s)
    assert rate == pytest.approx([np.nan, 1 / 0.1, 3 / 0.2, 4 / 0.4, 3 / 0.4], nan_ok=True)


def test_rate_of_a_straight_line_is_its_slope_at_any_frame_rate():
    time_s = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.1, 50))
    assert rate_of_change(3 - 2 * time_s, time_s)[1:] == pytest.approx(-2.0)


def test_rate_carries_nothing_across_an_unknown_value():
    values = np.array([0.0, 1.0, np.nan, 5.0, 6.0, 8.0, 8.0])
    expected = [np.nan, 1.0, np.nan, np.nan, 1.0, 1.5, 1.0]
    assert rate_of_change(values, np.arange(7.0)) == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_rate_of_short_clips(count):
    assert rate_of_change(np.arange(float(count)), np.arange(float(count))) == pytest.approx(
        [np.nan, 1.0, 1.0][:count], nan_ok=True
    )


def test_mouth_width_comes_from_closed_frames_where_there_are_some():
    status = [CLOSED] * 4 + [OPEN] * 20
    height, lips = np.array([0.0] * 4 + [30.0] * 20), np.array([60.0, 62, 61, 90] + [40.0] * 20)
    width, how = resting_mouth_width(status, height, lips)
    assert width == 61.5 and how == "median lip width of 4 closed frames"


def test_mouth_width_comes_from_the_least_open_frames_otherwise():
    status = [CLOSED] + [OPEN] * 11
    height, lips = np.arange(12.0), np.linspace(60, 38, 12)
    width, how = resting_mouth_width(status, height, lips)
    assert width == pytest.approx(58) and how == "median lip width of the 3 least open frames"


def test_mouth_width_is_unknown_without_lips():
    width, how = resting_mouth_width([NO_MOUTH, OPEN], np.array([np.nan, 3.0]), np.array([np.nan, np.nan]))
    assert math.isnan(width) and how.startswith("unknown")


def test_a_saved_profile_comes_back(tmp_path):
    found = profile_of([4.0, (4.0, 5.0), 0, None])
    paths = found.save(tmp_path / "deep" / "er", "clip.v2")
    names = ["clip.v2.frames.csv", "clip.v2.openings.csv", "clip.v2.json"]
    assert [path.name for path in paths] == names
    for path in (*paths, paths[0].parent / "clip.v2"):
        back = load_profile(path)
        pd.testing.assert_frame_equal(back.frames, found.frames, rtol=1e-6)
        pd.testing.assert_frame_equal(back.openings, found.openings, rtol=1e-6)
        assert back.meta == found.meta
    assert sorted(path.name for path in paths[0].parent.iterdir()) == sorted(names)


def test_unknown_is_an_empty_field_and_null(tmp_path):
    frames, _, meta = profile_of([None, 0], mouth_width_px=math.nan).save(tmp_path, "clip")
    rows = frames.read_text().splitlines()
    assert rows[1] == "0,0.000000,no_mouth,,,,,,,,,,,,0.5"
    assert rows[2] == "1,0.040000,closed,0,0,0,0,0,0,0,,0,,,0.5"
    assert json.loads(meta.read_text())["mouth_width_px"] is None
    assert math.isnan(load_profile(meta).meta["mouth_width_px"])


def test_a_clip_that_is_always_closed_has_an_empty_table_of_openings(tmp_path):
    profile_of([0, 0]).save(tmp_path, "clip")
    assert len(load_profile(tmp_path / "clip").openings) == 0


def test_the_same_profile_gives_the_same_bytes(tmp_path):
    first = [path.read_bytes() for path in profile_of([4.0, None, 0]).save(tmp_path / "a", "clip")]
    second = [path.read_bytes() for path in profile_of([4.0, None, 0]).save(tmp_path / "b", "clip")]
    assert first == second
    assert not any(b"\r" in data for data in first)


def test_a_full_disk_leaves_the_old_files_and_no_parts(tmp_path, monkeypatch):
    old = [path.read_bytes() for path in profile_of([4.0]).save(tmp_path, "clip")]
    write = profiles.Path.write_text

    def fill_up(path, text, **kwargs):
        if ".frames.csv" in path.name:  # the last of the three
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(path, text, **kwargs)

    monkeypatch.setattr(profiles.Path, "write_text", fill_up)
    with pytest.raises(InputError, match="No space left on device"):
        profile_of([9.0]).save(tmp_path, "clip")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["clip.frames.csv", "clip.json", "clip.openings.csv"]
    assert [(tmp_path / f"clip{e}").read_bytes() for e in (".frames.csv", ".openings.csv", ".json")] == old


def test_a_file_in_the_folders_place_is_one_sentence(tmp_path):
    (tmp_path / "out").write_text("here")
    with pytest.raises(InputError, match=r"expected to write .*out"):
        profile_of([4.0]).save(tmp_path / "out", "clip")


def _drop_column(folder):
    pd.read_csv(folder / "clip.frames.csv").drop(columns=["ratio", "area_px"]).to_csv(folder / "clip.frames.csv")


def _replace(name, old, new):
    return lambda folder: (folder / name).write_text((folder / name).read_text().replace(old, new))


def _width(text):
    return lambda folder: (folder / "clip.json").write_text(
        '{"format": "lipmetrics profile 1", "mouth_width_px": ' + text + "}"
    )


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (lambda folder: (folder / "clip.openings.csv").unlink(), "clip.openings.csv, found no such file"),
        (lambda folder: (folder / "clip.json").unlink(), "clip.json beside the tables, found no such file"),
        (lambda folder: (folder / "clip.json").write_text("{"), "clip.json to be JSON"),
        (lambda folder: (folder / "clip.json").write_text("[]"), "to say format 'lipmetrics profile 1', got 'list'"),
        (lambda folder: (folder / "clip.json").write_text('{"format": "2"}'), "to say format .*, got '2'"),
        (_drop_column, "missing area_px, ratio"),
        (_replace("clip.frames.csv", "open,", "ajar,"), "expected status open, closed or no_mouth, got ajar"),
        (_replace("clip.frames.csv", "0.04", "soon"), "soon"),
        (_replace("clip.openings.csv", "0,0.0", ",0.0"), "a number in every row of frame and opening"),
        (lambda folder: (folder / "clip.frames.csv").write_bytes(bytes(range(256))), "clip.frames.csv"),
        (lambda folder: (folder / "clip.frames.csv").write_text(""), "clip.frames.csv"),
        (lambda folder: (folder / "clip.json").write_text("[" * 50_000), "clip.json to be JSON"),
        (_width("[]"), "a number or null"),
        (_width(str(10**400)), "a number of 401 digits"),
        (_replace("clip.frames.csv", "\n0,", "\ninf,"), "whole numbers of frames"),
        (_replace("clip.frames.csv", "\n0,", "\n0.5,"), "whole numbers of frames"),
        (_replace("clip.frames.csv", "open,", "a" * 100_000 + ","), r"expected status .* \.\.\. "),
    ],
)
def test_what_is_wrong_with_a_table_is_said_in_one_line(tmp_path, damage, sentence):
    profile_of([4.0, 5.0]).save(tmp_path, "clip")
    damage(tmp_path)
    with pytest.raises(InputError, match=sentence) as error:
        load_profile(tmp_path / "clip.frames.csv")
    assert "\n" not in str(error.value)
