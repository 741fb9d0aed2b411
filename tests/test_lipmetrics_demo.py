import json
import os
import re
import subprocess
import sys
import textwrap
from html.parser import HTMLParser

import cv2
import numpy as np
import pandas as pd
import pytest
import ring_mouth
from clips import write_video
from mouth_clip import profile_of

from lipmetrics import cli, demo_page, detect
from lipmetrics.demo import demo, rehearsing, write_drawn_clip
from lipmetrics.demo_page import Simulated, key_moments
from lipmetrics.errors import InputError
from lipmetrics.frames import open_frames
from lipmetrics.look import CLOSED, OPEN, Look
from lipmetrics.profile import load_profile
from simulator.scene import Action, Camera, Face, Glue, Output, Scene

FPS = 25
SCRIPT = (10.0, 0.0, None, 10.0, 0.0, None)  # what the method of `ring_mouth` sees, px; None is no mouth


def box(height: float, col: float = 20.0) -> np.ndarray:
    return np.array([[20, col], [20, col + 20], [20 + height, col + 20], [20 + height, col]], float)


def profile(*frames: list[np.ndarray]):
    looks = [Look(OPEN if boxes else CLOSED, boxes) for boxes in frames]
    return profile_of(looks, [i / FPS for i in range(len(frames))])


@pytest.fixture
def simulate(monkeypatch):
    """A simulator that writes a clip of 6 pictures and a truth of 8, 4, 0, 12 + 6, 0 and 0 px."""
    monkeypatch.setitem(detect.METHODS, "default", "ring_mouth")

    def simulate(folder):
        write_video(folder / "take.mp4", [ring_mouth.ring(h) for h in (8, 4, 0, 12, 0, 0)])
        true = profile([box(8)], [box(4)], [], [box(12), box(6, 60.0)], [], [])
        files = true.save(folder, "take")
        frames = [{"openings": [{"outline": outline.tolist()} for outline in frame]} for frame in true.outlines]
        meta = json.loads(files[2].read_text()) | {"format": "lipmetrics profile 1"}
        files[2].write_text(json.dumps(meta))
        (folder / "take.polygons.json").write_text(json.dumps({"frames": frames}))
        return Simulated("take", (folder / "take.mp4", *files), "A <mouth>", {"mesh": "none"}, {"solve": 0.5})

    return simulate


class Page(HTMLParser):
    """What a page refers to, its words, and whether its tags are in order."""

    def __init__(self, text: str):
        super().__init__()
        self.sources, self.links, self.words, self.open = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.sources += [given["src"]] if "src" in given else []
        self.links += [given["href"]] if "href" in given else []
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


# -- the whole --------------------------------------------------------------------------------------------------------


def test_files_and_numbers(simulate, tmp_path):
    report = demo(tmp_path, simulate, side_by_side=False)
    assert all(os.path.getsize(path) for path in report["files"])
    endings = ("frames.csv", "measured.frames.csv", "overlay.mp4", "report.html", "report.json", "report.png")
    assert {f"take.{ending}" for ending in endings} <= {os.path.basename(path) for path in report["files"]}
    # the same from the tables, reckoned anew
    seen, true = (pd.read_csv(tmp_path / f"take{name}.frames.csv") for name in (".measured", ""))
    assert np.allclose(seen["time_s"], true["time_s"])
    both = (seen["status"] == "open") & (true["status"] == "open")
    off = 100 * (seen["height_px"] - true["height_px"])[both] / 60
    assert both.tolist() == [True, False, False, True, False, False]
    assert report["height"]["mean_percent"] == pytest.approx(off.abs().mean(), rel=1e-5)
    assert report["height"]["bias_percent"] == pytest.approx(off.mean(), abs=1e-5)
    assert report["open_or_closed_right_percent"] == pytest.approx(100 * (seen["status"] == true["status"]).mean())
    assert report["frames_without_mouth"] == 2 and report["highest_missed_px"] == 4
    assert report["overlap_percent"]["least"] == pytest.approx(100 * 200 / (240 + 120), abs=3)
    assert {"solve", "simulation in all", "measurement", "all"} <= set(report["seconds"])
    saved = json.loads((tmp_path / "take.report.json").read_text())
    assert saved["height"] == report["height"] and "seconds" not in saved
    assert any("height" in line and "%" in line for line in report["text"])
    assert (load_profile(tmp_path / "take.measured").frames["status"] == "open").sum() == 2


def test_the_same_twice(simulate, tmp_path):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        demo(tmp_path / name, simulate, side_by_side=False)
    for ending in ("report.json", "report.png", "moments.png", "measured.frames.csv"):
        one, two = ((tmp_path / name / f"take.{ending}").read_bytes() for name in ("one", "two"))
        assert one == two, ending


def test_the_page_holds_all_itself(simulate, tmp_path):
    (tmp_path / "take.view.html").write_text("there")
    demo(tmp_path, simulate, side_by_side=False)
    text = (tmp_path / "take.report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert page.open == []
    assert len(page.sources) == 3 and all(re.match(r"data:(image/png|video/mp4);base64,", s) for s in page.sources)
    assert not re.search(r"https?:|//[a-z]|<script|@import|url\(", re.sub(r"base64,[^\"]*", "", text))
    assert page.links == ["take.view.html"]
    words = " ".join(page.words)
    assert "A <mouth>." in words and "No mouth was found in 2 frames." in words
    assert "up to 4.0 px (6.7 % of the mouth width)" in words
    assert "3.3 %" in words  # both heights are off by 2 px of 60


def test_a_simulation_that_fails_leaves_no_report(tmp_path):
    def simulate(folder):
        raise InputError("no such face")

    with pytest.raises(InputError, match="no such face"):
        demo(tmp_path, simulate, side_by_side=False)
    assert list(tmp_path.iterdir()) == []


# -- pictures ---------------------------------------------------------------------------------------------------------


def test_key_moments_are_those_of_the_truth():
    one, two = [box(4)], [box(6), box(2, 60.0)]
    true = profile([], one, two, two, two, [box(9)], [box(12)], [box(8)], one, [])
    seen = profile([], [], one, two, two, [box(9)], [box(12)], [box(8)], [box(9)], [])
    moments = key_moments(seen, true)
    assert list(moments) == sorted(moments)
    assert moments[0] == "at rest" and moments[1] == "opens"
    assert moments[2] == "a second opening, first measured open" and moments[3] == "several openings"
    assert moments[4] == "before they merge" and moments[5] == "merged"
    assert moments[6] == "highest" and moments[7] == "closing"
    assert moments[8] == "last seen open, largest error in height"
    assert key_moments(profile([]), profile([])) == {0: "at rest"}


def test_moments_show_truth_in_green_and_measurement_in_red(simulate, tmp_path):
    demo(tmp_path, simulate, side_by_side=False)
    rgb = cv2.imread(str(tmp_path / "take.moments.png"))[:, :, ::-1].astype(int)
    for colour in (demo_page.TRUE_RGB, demo_page.MEASURED_RGB):
        assert (np.abs(rgb - colour).sum(axis=2) < 60).sum() > 100


# -- the other process ------------------------------------------------------------------------------------------------


def test_the_other_process_ends_with_the_block(monkeypatch):
    started = []
    popen = subprocess.Popen

    def start(command, **how):
        started.append(popen([sys.executable, "-c", "import time; time.sleep(60)"], **how))
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", start)
    with pytest.raises(KeyboardInterrupt), rehearsing("lipmetrics.demo:rehearse", "default"):
        raise KeyboardInterrupt
    assert len(started) == 1 and started[0].returncode is not None
    with rehearsing("lipmetrics.demo:rehearse", "default", wanted=False) as rehearsed:
        rehearsed()
    assert len(started) == 1


def test_a_rehearsal_that_fails_is_no_loss(monkeypatch):
    popen = subprocess.Popen
    monkeypatch.setattr(subprocess, "Popen", lambda command, **how: popen([sys.executable, "-c", "1 / 0"], **how))
    with rehearsing("lipmetrics.demo:rehearse", "default") as rehearsed:
        rehearsed()


def test_the_rehearsed_clip_is_a_face_that_opens(tmp_path):
    write_drawn_clip(tmp_path / "drawn.mp4")
    with open_frames(tmp_path / "drawn.mp4") as frames:
        pictures = [frame.rgb().astype(int) for frame in frames]
        assert frames.info.kind == "video"
    assert len(pictures) == 6
    assert pictures[-1][100:125, 110:150].sum() < 0.6 * pictures[0][100:125, 110:150].sum()


def test_the_other_process_calls_the_function_with_the_method(tmp_path, monkeypatch):
    (tmp_path / "rehearsed.py").write_text("from pathlib import Path\ndef run(method): Path(__file__ + method).touch()")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with rehearsing("rehearsed:run", "thesis") as rehearsed:
        rehearsed()
    assert (tmp_path / "rehearsed.pythesis").exists()


@pytest.mark.slow
@pytest.mark.parametrize("method", ["default", "thesis"])
def test_a_rehearsal_compiles_all_that_a_simulated_clip_needs(method, tmp_path):
    """In a process of its own, as other tests compile too."""
    cli.simulate_demo(tmp_path, SMALL)
    code = f"""
        import sys
        from numba.core.dispatcher import Dispatcher
        from lipmetrics import measure
        from lipmetrics.cli import rehearse_demo
        from simulator.truth import truth
        from simulator.scene import load_scene
        from simulator.simulate import simulate

        def compiled():
            names = ("lipmetrics", "simulator.aperture", "simulator.polygons", "simulator.truth")
            modules = [module for name, module in sys.modules.items() if name.startswith(names)]
            return {{
                (module.__name__, name, str(signature))
                for module in modules
                for name, kernel in vars(module).items()
                if isinstance(kernel, Dispatcher)
                for signature in kernel.signatures
            }}

        rehearse_demo("{method}")
        before = compiled()
        scene = load_scene("{tmp_path / "demo.scene.toml"}")
        mouth, model = scene.model()
        truth(simulate(scene, parts=(mouth, model)), mouth, scene.camera, scene.frame_times_s)
        measure("{tmp_path / "demo.mp4"}", method="{method}", keep_outlines=True)
        print(len(before) > 0, compiled() - before)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "True set()", done.stderr


# -- with the simulator -----------------------------------------------------------------------------------------------

SMALL = Scene(
    name="small",
    about="A mouth opens",
    duration_s=0.4,
    face=Face(resolution="low"),
    saliva=Glue(stickiness=0.5),
    muscle=(Action("jaw", peak_m=0.02, keys=((0.04, 0.0), "smooth", (0.3, 1.0))),),
    output=Output(frame_rate=25),
    camera=Camera(width_px=240, height_px=200),
)


@pytest.mark.slow
def test_a_simulated_clip_is_measured_well(tmp_path, monkeypatch, capsys):
    small = cli.simulate_demo
    monkeypatch.setattr(cli, "simulate_demo", lambda folder: small(folder, SMALL))
    assert cli.main(["demo", "-o", str(tmp_path / "out"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["command"] == "demo" and report["frames"] == 11 and report["frames_open"] >= 5
    assert report["height"]["mean_percent"] < 6
    assert report["mouth_width_px"] == pytest.approx(report["true_mouth_width_px"], rel=0.1)
    assert report["true_mouth_width_px"] == pytest.approx(
        240 * 0.05 / 0.105, rel=0.02
    )  # 50 mm of the 105 that are seen
    assert all(os.path.getsize(path) for path in report["files"])
    page = (tmp_path / "out" / "demo.report.html").read_text(encoding="utf-8")
    assert "low, 870 elements" in page and "A mouth opens." in page
    # what was written is what is read
    true = pd.read_csv(tmp_path / "out" / "demo.frames.csv")
    polygons = json.loads((tmp_path / "out" / "demo.polygons.json").read_text())["frames"]
    assert [len(frame["openings"]) for frame in polygons] == true["n_openings"].tolist()
    highest = max(
        (np.ptp([row for row, _ in opening["outline"]]) for frame in polygons for opening in frame["openings"]),
    )
    assert true["height_px"].max() == pytest.approx(highest, rel=0.25) and report["frames"] == len(true)
