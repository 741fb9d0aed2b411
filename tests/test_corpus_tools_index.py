"""`corpus index`: what is said of each clip, against decoding it and against drawn faults."""

import csv
import dataclasses
import json
from fractions import Fraction
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from clips import moving_pictures, write_pictures, write_sound, write_video
from drawn_mouth import opened, plain

from corpus_tools import facts as facts_module
from corpus_tools.clips import Clip
from corpus_tools.facts import Facts, _light, _Seen, _seen, clip_facts
from corpus_tools.index import ALONE_N, KINDS, Limits, check, index
from lipmetrics import frames
from lipmetrics.cli import main
from lipmetrics.errors import InputError

GOOD = Facts(
    width_px=640,
    height_px=480,
    frames_n=75,
    length_s=3.0,
    fps=25.0,
    longest_step=1.0,
    has_sound=True,
    damage="",
    looked_n=3,
    mouths_n=3,
    sides_n=0,
    brightness=120.0,
    clipped=0.0,
    mouth_width_px=90.0,
    tilt_deg=2.0,
    off_middle=0.01,
    margin_mw=0.8,
)


@pytest.mark.parametrize(
    ("change", "kind", "what"),
    [
        ({"damage": "cut off after 1.20 s"}, "unreadable", "cut off after 1.20 s"),
        ({"length_s": 2.8}, "length", "2.80 s instead of 3 s"),
        ({"length_s": 3.2}, "length", "3.20 s instead of 3 s"),
        ({"fps": 15.0}, "frame rate", "15 per second, too slow"),
        ({"fps": 30000 / 1001}, "frame rate", "29.97 per second where most have 25"),
        ({"fps": float("nan")}, "frame rate", "unknown"),
        ({"longest_step": 3.0}, "frame rate", "pictures are left out, 2 in a row"),
        ({"brightness": 20.0}, "light", "too dark, grey level 20 of 255"),
        ({"brightness": 240.0}, "light", "too bright, grey level 240 of 255"),
        ({"clipped": 0.5}, "light", "50 % of the pixels are black or white"),
        ({"mouths_n": 0, "mouth_width_px": float("nan")}, "no mouth", "none in 3 pictures looked at"),
        ({"mouth_width_px": 20.0}, "small", "the mouth is 20 px wide"),
        ({"tilt_deg": -30.0}, "turned", "tilted by 30 degrees"),
        ({"off_middle": -0.3}, "turned", "the mouth is 30 % of the face from its middle"),
        ({"sides_n": 2}, "turned", "the face is seen from the side"),
        ({"margin_mw": -0.1}, "cut off", "the mouth is at the edge of the picture"),
    ],
)
def test_each_fault_is_one_problem(change, kind, what):
    assert check(GOOD, Limits(), 25.0, 3.0) == []
    assert check(dataclasses.replace(GOOD, **change), Limits(), 25.0, 3.0) == [(kind, what)]
    assert kind in KINDS


def test_a_length_may_be_out_by_a_picture_and_a_half():
    slow = dataclasses.replace(GOOD, fps=10.0, length_s=3.14)
    assert check(slow, Limits(fps=5), 10.0, 3.0) == []
    assert check(dataclasses.replace(GOOD, length_s=3.14), Limits(), 25.0, 3.0)[0][0] == "length"
    assert check(dataclasses.replace(GOOD, length_s=0.1), Limits(), 25.0, None)[0][1] == "0.10 s only"
    assert check(dataclasses.replace(GOOD, length_s=77.0), Limits(), 25.0, None) == []


@pytest.fixture
def quick(monkeypatch):
    """No mouth is searched for; gives the pictures that would have been looked at."""
    seen = []
    monkeypatch.setattr(facts_module, "_seen", lambda picture: seen.append(picture) or _Seen(True, False, 9.0, 0.0))
    return seen


def decoded(path, **how):
    with frames.open_frames(path, **how) as source:
        return [frame.time_s for frame in source]


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv", "a.avi", "a.mpg"])
def test_times_without_decoding_are_those_of_decoding(tmp_path, quick, name):
    codec = {"a.avi": "mpeg4", "a.mpg": "mpeg1video"}.get(name, "libx264")
    path = write_video(tmp_path / name, moving_pictures(25), codec=codec, sound=name == "a.mp4")
    found, times_s = clip_facts(Clip(path, "a")), decoded(path)
    assert found.frames_n == 25 and found.fps == pytest.approx(25, rel=0.01) and found.longest_step < 1.1
    assert found.length_s == pytest.approx(times_s[-1] - times_s[0] + 0.04, abs=0.002)
    assert (found.width_px, found.height_px, found.has_sound, found.damage) == (96, 64, name == "a.mp4", "")
    start_s, stop_s = times_s[0] + 0.3, times_s[0] + 0.7  # mpg does not begin at 0
    part = clip_facts(Clip(path, "a", start_s=start_s, stop_s=stop_s))
    assert part.frames_n == len(decoded(path, start_s=start_s, stop_s=stop_s)) == 10


def test_pictures_that_were_left_out(tmp_path, quick):
    ticks = [k * 1001 for k in range(20)] + [k * 1001 for k in range(23, 30)]
    path = write_video(tmp_path / "a.mp4", moving_pictures(27), ticks=ticks, time_base=Fraction(1, 30000))
    found = clip_facts(Clip(path, "a"))
    assert found.fps == pytest.approx(30000 / 1001, rel=1e-3) and found.longest_step == pytest.approx(4, abs=0.01)


def test_pictures_are_taken_at_key_frames(tmp_path, quick):
    seen = quick
    pictures = moving_pictures(60)
    path = write_video(tmp_path / "a.mp4", pictures, key_every=12, options={"sc_threshold": "0"})
    assert clip_facts(Clip(path, "a")).looked_n == 3

    def number(picture):
        return int(np.argmin([np.abs(picture.astype(int) - one).mean() for one in pictures]))

    assert [number(picture) for picture in seen] == [0, 24, 48]  # those nearest to 5, 50 and 95 %
    seen.clear()
    path = write_video(tmp_path / "b.mp4", pictures, key_every=600, options={"sc_threshold": "0"})
    clip_facts(Clip(path, "b"))
    assert [number(picture) for picture in seen] == [0, 30]
    seen.clear()
    folder = write_pictures(tmp_path / "c", pictures)
    found = clip_facts(Clip(folder, "c", fps=25))
    assert [number(picture) for picture in seen] == [3, 30, 56] or [number(picture) for picture in seen] == [3, 29, 56]
    assert found.frames_n == 60 and found.fps == pytest.approx(25) and found.length_s == pytest.approx(2.4)


def test_framing_and_light():
    middle = _seen(plain(opened(0.2)).picture)
    assert middle.has_mouth and middle.mouth_width_px == pytest.approx(90, rel=0.12) and abs(middle.tilt_deg) < 4
    assert middle.margin_mw == pytest.approx(100 / 90 - 0.2, abs=0.25)  # to the lower edge, which is nearest
    tilted = _seen(plain(opened(0.2), roll_rad=0.5, size=(300, 300)).picture)
    assert abs(tilted.tilt_deg) == pytest.approx(np.degrees(0.5), abs=6)
    small = _seen(plain(opened(0.2), px_per_mouth=40).picture)
    assert small.mouth_width_px == pytest.approx(40, rel=0.2)
    picture = plain(opened(0.2)).picture
    rows, cols = picture.shape[:2]
    cut = _seen(np.ascontiguousarray(picture[:, cols // 2 - 50 :]))  # 5 px from the corner
    assert cut.margin_mw < Limits().margin_mw < middle.margin_mw
    dark = _seen((picture * 0.12).astype(np.uint8))
    assert dark.brightness < Limits().dark < middle.brightness
    half = picture.copy()
    half[:, : cols // 2] = 255
    half[: rows // 4, cols // 2 :] = 0
    assert _light(half)[1] == pytest.approx(0.5 + 0.125, abs=0.01) and _light(picture)[1] < 0.01
    assert _light(np.full((4, 4, 3), (255, 60, 60), np.uint8))[1] == 0  # red lips are not clipped
    blank = _seen(np.full((100, 100, 3), 128, np.uint8))
    assert not blank.has_mouth and blank.brightness == pytest.approx(128, abs=0.1)


def test_a_face_from_the_side(monkeypatch):
    """A profile counts only where no face is seen from the front."""
    picture = plain(opened(0.1)).picture
    assert not _seen(picture).from_side
    monkeypatch.setattr(facts_module, "_has_profile", lambda picture: True)
    monkeypatch.setattr(facts_module, "faces", lambda frame: [])
    assert _seen(picture).from_side
    monkeypatch.setattr(facts_module, "faces", lambda frame: [(0.0, 0.0, 260.0, 260.0)])
    assert not _seen(picture).from_side


@lru_cache(maxsize=1)
def mouths():
    """75 small pictures of a mouth, three by three the same."""
    return [cv2.resize(plain(opened(0.1 + k / 100)).picture, (208, 160)) for k in range(3)] * 25


@pytest.fixture
def corpus(tmp_path):
    """p01 as it should be but for one double, p02 with faults."""
    folder = tmp_path / "clips"
    folder.mkdir()
    pictures = mouths()
    write_video(folder / "p01_m_1.mp4", pictures)
    write_video(folder / "p01_m_2.mp4", pictures[1:] + pictures[:1])
    (folder / "p01_m_3.mp4").write_bytes((folder / "p01_m_2.mp4").read_bytes())
    write_video(folder / "p02_m_1.mp4", pictures[:50])
    whole = (folder / "p01_m_1.mp4").read_bytes()
    (folder / "p02_m_2.mp4").write_bytes(whole[: len(whole) // 2])
    write_sound(folder / "p02_m_3.mp4")
    write_video(folder / "p02_m_4.mp4", [picture // 12 for picture in pictures])
    write_video(folder / "p02_dance_1.mp4", pictures[2:] + pictures[:2])
    (folder / "notes.mp4").touch()
    return folder


def rows_of(path):
    with Path(path).open(newline="") as file:
        return {row["name"] or Path(row["path"]).name: row for row in csv.DictReader(file)}


def test_a_corpus_with_faults(corpus, tmp_path, capsys):
    from corpus_tools.protocol import protocol_text

    mine = tmp_path / "mine.toml"
    mine.write_text(protocol_text().replace("repetitions_n = 5", "repetitions_n = 4"))
    words = ["corpus", "index", str(corpus), "-o", str(tmp_path / "t.csv"), "--protocol", str(mine), "--jobs", "1"]
    assert main([*words, "--json"]) == 3
    said = capsys.readouterr()
    rows, answer = rows_of(tmp_path / "t.csv"), json.loads(said.out)
    assert rows["p01_m_1"]["problems"] == rows["p01_m_2"]["problems"] == ""
    assert rows["p01_m_3"]["problems"] == "doubled: the same content as p01_m_2"
    assert rows["p01_m_4"]["problems"] == "missing: no such clip" and rows["p01_m_4"]["path"] == ""
    assert rows["p02_m_1"]["problems"] == "length: 2.00 s instead of 3 s"
    assert rows["p02_m_2"]["problems"].startswith("unreadable: cannot read")
    assert "sound only" in rows["p02_m_3"]["problems"]
    assert rows["p02_m_4"]["problems"].startswith("light: too dark")
    assert rows["p02_dance_1"]["problems"] == "not expected: the protocol has no such clip"
    assert rows["notes.mp4"]["problems"].startswith("name: ") and rows["notes.mp4"]["name"] == ""
    assert (rows["p01_m_1"]["speaker"], rows["p01_m_1"]["repeat"], rows["p01_m_1"]["frames_n"]) == ("p01", "1", "75")
    assert set(answer["problems"]) >= {"missing", "not expected", "name", "doubled", "unreadable", "length", "light"}
    lines = said.err.splitlines()
    assert len(lines) == len(answer["problems"])  # one of summary for each kind
    assert "lipmetrics: length: 1: p02_m_1 (2.00 s instead of 3 s)" in lines
    assert "lipmetrics: unreadable: 2: p02_m_2, p02_m_3 (cannot read" in said.err
    missing = answer["problems"]["missing"]
    assert len(missing) == 22 * 4 * 2 - 7 and "p01_m_4" in missing
    assert f"lipmetrics: missing: {len(missing)}: {missing[0]}, " in said.err
    assert f" and {len(missing) - 5} more\n" in said.err


def test_nothing_wrong(tmp_path, capsys):
    for k in range(2):
        write_video(tmp_path / f"p01_m_{k}.mp4", mouths()[k : k + 50])
    words = ["corpus", "index", str(tmp_path), "-o", str(tmp_path / "t.csv"), "--template", "{who}_{utterance}_{n:d}"]
    assert main(words) == 0
    said = capsys.readouterr()
    assert said.out == f"2 clips, 0 with problems -> {tmp_path / 't.csv'}\n" and said.err == ""


def test_parts_of_one_video_are_no_doubles(tmp_path, quick, monkeypatch):
    monkeypatch.setattr("corpus_tools.index.check", lambda *_: [])
    path = write_video(tmp_path / "a.mp4", mouths())
    parts = [Clip(path, "a", start_s=0.0, stop_s=1.0), Clip(path, "b", start_s=1.0, stop_s=2.0)]
    assert index(parts, tmp_path / "t.csv")["failed"] == []
    late = Clip(path, "c", start_s=7.0, stop_s=8.0)
    assert index([late], tmp_path / "t.csv")["problems"] == {"unreadable": ["c"]}


@pytest.mark.slow
def test_whoever_looks_sees_the_same(tmp_path):
    path = write_video(tmp_path / "a.mp4", mouths())
    clips = [Clip(path, f"word-{k}", start_s=k / 5, stop_s=k / 5 + 0.2) for k in range(ALONE_N + 1)]
    for jobs in (1, 2):
        index(clips, tmp_path / f"{jobs}.csv", jobs=jobs)
    assert (tmp_path / "1.csv").read_bytes() == (tmp_path / "2.csv").read_bytes()


def test_same_pictures_in_two_folders_are_doubles(tmp_path, quick):
    clips = [Clip(write_pictures(tmp_path / name, mouths()[:5]), name, fps=25) for name in "ab"]
    assert index(clips, tmp_path / "t.csv")["problems"]["doubled"] == ["b"]


def test_a_table_that_cannot_be_written(tmp_path):
    with pytest.raises(InputError, match=r"expected a table to write, got .*, a folder"):
        index([Clip("x", "x")], tmp_path)
