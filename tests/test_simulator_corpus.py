"""Simulated corpora: every clip once, whole, and the same again; goes on after a stop and past what fails."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from corpus_tools.readers import read_folder
from simulator import cli
from simulator import corpus as corpora
from simulator.corpus import Corpus, make_corpus
from simulator.errors import InputError
from simulator.scene import load_scene

SCENE = """
duration_s = 0.1
[face]
resolution = "low"
[saliva]
stickiness = 0
[output]
frame_rate = 20
[camera]
width_px = 64
height_px = 48
[[muscle]]
name = "jaw"
peak_m = 0.01
keys = [[0.0, 0.0], "smooth", [0.1, 1.0]]
"""


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "yawn_now.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture
def here(monkeypatch):
    """Clips are made in this process; gives the names of those that were asked for."""
    asked = []

    def work(todo, processes_n):
        for name, job in todo.items():
            asked.append(name)
            yield name, corpora._make(*job)

    monkeypatch.setattr(corpora, "_work", work)
    return asked


def corpus_of(path, people_n=2, levels=(0.0, 7.0), **more):
    return Corpus(people_n, (load_scene(path),), levels, **more)


def contents(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_names_say_who_does_what_and_how_sticky(scene):
    corpus = corpus_of(scene, levels=(0.0, 7.0), repeats_n=2)
    names = [name for name, _ in corpus.clips()]
    assert names[:4] == ["p01_yawn-now_0_1", "p01_yawn-now_0_2", "p01_yawn-now_7_1", "p01_yawn-now_7_2"]
    assert len(set(names)) == 8 and corpus.template == "{speaker}_{action}_{stickiness:d}_{repeat:d}"
    assert corpus_of(scene, levels=(0.5,)).template == "{speaker}_{action}_{stickiness:number}_{repeat:d}"
    assert len(list(Corpus(5).clips())) == 5 * 6 * 4  # what comes if nothing is said


def test_a_person_is_the_same_in_all_clips_but_for_the_noise(scene):
    clips = dict(corpus_of(scene, repeats_n=2).clips())
    one, again, other = (clips[name] for name in ("p01_yawn-now_0_1", "p01_yawn-now_7_2", "p02_yawn-now_0_1"))
    assert (one.face, one.skin, one.light, one.seed) == (again.face, again.skin, again.light, again.seed)
    assert one.sensor.seed != again.sensor.seed and one.seed != other.seed
    assert (one.saliva.stickiness, again.saliva.stickiness) == (0, 7)


@pytest.mark.slow
def test_the_corpus_is_made_and_read(scene, here, tmp_path):
    made = make_corpus(corpus_of(scene, repeats_n=2), tmp_path / "a")
    assert (made["clips_n"], made["made_n"], made["unchanged_n"], made["failed"]) == (8, 8, 0, [])
    reading = read_folder(tmp_path / "a" / "clips", made["template"])
    assert reading.misfits == () and len(reading.clips) == 8
    assert dict(reading.clips[0].fields) == {"speaker": "p01", "action": "yawn-now", "stickiness": 0, "repeat": 1}
    assert len({clip.path.read_bytes() for clip in reading.clips}) == 8  # repeats differ
    files = contents(tmp_path / "a")
    truth = [name for name in files if name.startswith("truth/p02_yawn-now_7_2.")]
    assert {f"truth/p02_yawn-now_7_2.{e}" for e in ("frames.csv", "scene.toml", "clip.json")} <= set(truth)
    assert not any(name.endswith((".h5", ".mkv", ".html")) for name in files)
    assert not (tmp_path / "a" / ".parts").exists()
    record = json.loads(files["corpus.json"])
    assert [one["name"] for one in record["people"]] == ["p01", "p02"] and record["seed"] == 0
    assert record["people"][0]["skin"]["tone"] != record["people"][1]["skin"]["tone"]

    make_corpus(corpus_of(scene, repeats_n=2), tmp_path / "b")
    assert contents(tmp_path / "b") == files


@pytest.mark.slow
def test_what_is_there_is_not_made_again(scene, here, tmp_path, monkeypatch):
    folder, made = tmp_path / "a", []
    before = corpora.make_clip
    monkeypatch.setattr(corpora, "make_clip", lambda *args, **how: made.append(how["stem"]) or before(*args, **how))
    make_corpus(corpus_of(scene), folder)
    made.clear()
    assert make_corpus(corpus_of(scene), folder)["unchanged_n"] == 4 and made == []
    (folder / "clips" / "p01_yawn-now_7_1.mp4").unlink()  # a clip is gone
    (folder / "truth" / "p02_yawn-now_0_1.clip.json").write_text("{")  # cut off
    assert make_corpus(corpus_of(scene), folder)["made_n"] == 2
    assert made == ["p01_yawn-now_7_1", "p02_yawn-now_0_1"]
    made.clear()
    assert make_corpus(corpus_of(scene, people_n=3), folder)["made_n"] == 2  # one more person
    made.clear()
    scene.write_text(SCENE.replace("0.01\n", "0.012\n"))
    assert make_corpus(corpus_of(scene), folder)["made_n"] == 4
    monkeypatch.setattr(corpora.export, "versions", lambda: {"lipmetrics": "next"})
    assert make_corpus(corpus_of(scene), folder)["made_n"] == 4


def test_a_clip_that_fails_leaves_the_others(scene, here, tmp_path, monkeypatch):
    folder, before = tmp_path / "a", corpora.make_clip

    def make(scene, parts, *, stem, **how):
        if stem.startswith("p01_yawn-now_7"):
            parts.mkdir(parents=True)
            (parts / f"{stem}.mp4").write_bytes(b"half")
            raise InputError("blew up")
        return before(scene, parts, stem=stem, **how)

    monkeypatch.setattr(corpora, "make_clip", make)
    made = make_corpus(corpus_of(scene), folder)
    assert made["failed"] == [{"source": "p01_yawn-now_7_1", "error": "blew up"}] and made["made_n"] == 3
    assert not list(folder.rglob("p01_yawn-now_7_1*")) and not (folder / ".parts").exists()


def test_two_runs_at_a_time_are_refused(scene, here, tmp_path):
    pytest.importorskip("fcntl")
    with corpora._alone(tmp_path / "a"), pytest.raises(InputError, match="one run at a time"):
        make_corpus(corpus_of(scene), tmp_path / "a")


@pytest.mark.parametrize(
    "words, message",
    [
        (["--corpus", "0"], "expected a whole number of at least 1, got '0'"),
        (["--corpus", "2"], "arguments are required: -o/--out"),
        (["--corpus", "2", "yawm", "-o", "a"], "expected a TOML file or a built-in scene"),
        (["--corpus", "2", "m", "m", "-o", "a"], "expected scenes of different names, got 'm' twice"),
        (["--corpus", "2", "--face", "child", "-o", "a"], "expected no --face with --corpus"),
        (["--corpus", "2", "b.xml", "-o", "a"], "expected scenes to go with --corpus, got a model: b.xml"),
        (["--corpus", "1000", "-o", "a"], "expected 1 to 999 people, got 1000"),
        (["--corpus", "999", "--repeats", "99999", "-o", "a"], "expected at most 1000000 clips"),
        (["--corpus", "2", "m", "-o", "there/a"], "expected an output folder to write to"),
        (["m", "--jobs", "2"], "expected --corpus N, a number of people, to go with --jobs"),
    ],
)
def test_bad_arguments_are_one_line(words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("there").write_text("a file")
    try:
        code = cli.main(words)
    except SystemExit as stop:
        code = stop.code
    out, err = capsys.readouterr()
    assert (code, out) == (2, "") and message in err and err.count("\n") == 1


def command(scene, folder, *more):
    words = [sys.executable, "-m", "simulator.cli", "--corpus", "2", scene, "--stickiness", "0,7", "-o", folder, *more]
    return subprocess.Popen(list(map(str, words)), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.slow
def test_the_command_and_a_kill(scene, tmp_path):
    """Two processes give what one gives; their end leaves nothing half-made and no process behind."""
    run = command(scene, tmp_path / "a", "--jobs", "2", "--json")
    out, err = run.communicate(timeout=300)
    assert (run.returncode, err) == (0, "")
    assert json.loads(out)["made_n"] == 4 and len(json.loads(out)["people"]) == 2

    killed = command(scene, tmp_path / "b", "--jobs", "1")
    until = time.monotonic() + 300
    while not list(tmp_path.glob("b/clips/*.mp4")) and time.monotonic() < until:
        time.sleep(0.01)
    os.kill(killed.pid, signal.SIGKILL)
    killed.communicate(timeout=60)  # its pipes close when its processes are gone too
    run = command(scene, tmp_path / "b", "--jobs", "1")
    out, err = run.communicate(timeout=300)
    assert run.returncode == 0 and "4 of 4 clips in " in out
    assert contents(tmp_path / "b") == contents(tmp_path / "a")


def test_noise_has_a_seed_of_its_own():
    import dataclasses

    from moved_mouth import moved_mouth

    from simulator.look import Look, Sensor
    from simulator.render import render

    mouth, motion = moved_mouth("low", 2)[:2]
    camera = dataclasses.replace(load_scene("m").camera, width_px=64, height_px=48)

    def drawn(**sensor):
        look = Look(seed=5, sensor=Sensor(**sensor))
        return np.array(list(render(motion, mouth, camera, look))).astype(int)

    assert (drawn() == drawn(seed=5)).all() and (drawn() != drawn(seed=6)).any()
    still = {"noise": 0.0, "read_noise": 0.0}
    assert (drawn(**still) == drawn(seed=6, **still)).all()  # texture and teeth do not follow it
