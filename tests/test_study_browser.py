"""Headless Chromium takes part in the study: what the database holds is what was clicked."""

import dataclasses
import re
import shutil
import time

import cv2
import numpy as np
import pytest
from chromium import CHROMIUM, Chromium
from study_client import ServerProcess, write_study

from study.design import load_design
from study.export import answers_table
from study.store import Store

pytest.importorskip("starlette", reason="the extra web is not installed")
pytest.importorskip("uvicorn", reason="the extra web is not installed")
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here to open the pages in; install chromium"),
    pytest.mark.slow,
]

LEVELS = (0, 4, 7, 10)
DURATION_S = 0.48
ANSWERABLE = "!document.getElementById('left').disabled"


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """Simulated mouths, short and small, at four levels of stickiness; each under the names of nine actions."""
    from simulator.clip import make_clip
    from simulator.scene import load_scene

    folder, made = tmp_path_factory.mktemp("clips"), tmp_path_factory.mktemp("made")
    scene = load_scene("p")
    scene = dataclasses.replace(
        scene,
        duration_s=DURATION_S - 0.04,
        face=dataclasses.replace(scene.face, resolution="low"),
        output=dataclasses.replace(scene.output, frame_rate=25.0),
        camera=dataclasses.replace(scene.camera, width_px=320, height_px=240),
    )
    for level in LEVELS:
        clip = make_clip(scene.with_stickiness(level), made, stem=f"p_{level}", progress=False)
        video = next(path for path in clip.files if path.suffix == ".mp4")
        for action in "abcdefghi":
            shutil.copy(video, folder / f"{action}_{level}.mp4")
    return folder


@pytest.fixture
def at(clips, tmp_path):
    """A function that serves a study of the clips: (browser, server, folder)."""
    running = []

    def start(settings="", **design):
        folder = tmp_path / "study"
        write_study(folder, clips, settings, **({"participants_n": 2} | design))
        server = ServerProcess(folder)
        running.append(server.stop)
        browser = Chromium(tmp_path / "profile")
        running.append(browser.close)
        return browser, server, folder

    yield start
    for stop in reversed(running):
        stop()


def to_the_start(browser, server):
    browser.go(server.address)
    browser.wait("document.readyState == 'complete' && !!document.querySelector('button.main')")
    browser.click("button.main")
    browser.arrive("/instructions")
    browser.click("a.button")
    browser.wait("location.pathname == '/trials' && !!document.getElementById('trouble')")


def to_the_trials(browser, server):
    to_the_start(browser, server)
    browser.wait("document.getElementById('play') && !document.getElementById('play').disabled")


def exported(folder):
    design = load_design(folder)
    store = Store(folder / "answers.sqlite", design.identity, len(design.sessions))
    table = answers_table(store, design)
    store.close()
    return design, table


def trial_shown(browser):
    return int(re.search(r"(\d+) of", browser.wait("document.getElementById('progress').textContent"))[1])


def test_a_session_of_60_trials(at):
    browser, server, folder = at('completion_code = "DONE7"\n', catch_n=4, practice_n=2)
    design = load_design(folder)
    assert len(design.sessions[0]) == 60
    rng = np.random.default_rng(8)
    to_the_trials(browser, server)
    clicks, replays = [], []
    for trial in design.sessions[0]:
        number = trial.trial
        browser.wait(f"document.getElementById('progress').textContent.includes('{number} of 60')")
        if number == 20:  # a reload in the middle
            browser.reload()
            browser.wait(f"document.getElementById('progress').textContent.includes('{number} of 60')")
        if number == 30:  # there is no way back to an earlier pair
            browser.see("history.back()")
            browser.arrive("/instructions")
            browser.click("a.button")
            browser.wait("location.pathname == '/trials' && document.getElementById('progress').textContent")
            assert trial_shown(browser) == number
        browser.wait("!document.getElementById('play').disabled")
        shown = browser.see("['left', 'right'].map((side) => document.querySelector(`#side_${side} video`).src)")
        sources = [folder / design.stimulus(code).file for code in (trial.left, trial.right)]
        for address, source in zip(shown, sources, strict=True):
            length = browser.see(f"fetch('{address}').then((r) => r.arrayBuffer()).then((b) => b.byteLength)")
            assert length == source.stat().st_size
        for key in ("ArrowLeft", "ArrowRight"):  # too early
            browser.press(key)
        assert browser.see("document.getElementById('left').disabled && document.getElementById('right').disabled")
        if number % 2:
            browser.click("#play")
        else:
            browser.press(" ")
        browser.wait(ANSWERABLE)
        replays.append(int(rng.integers(0, 3)) if number % 10 == 1 else 0)
        for _ in range(replays[-1]):
            browser.click("#play")
            browser.wait("videos.left.ended && videos.right.ended")
        says = browser.see("document.getElementById('hint').textContent")
        assert ("attention" in says) == trial.instructed
        if trial.instructed:
            assert ("LEFT" if trial.expected == trial.left else "RIGHT") in says
        side = str(rng.choice(["left", "right"]))
        clicks.append(getattr(trial, side))
        if number == 40:  # the server dies just before the answer, and comes back
            server.kill()
        if rng.random() < 0.5:
            browser.click(f"#{side}")
        else:
            browser.press({"left": "ArrowLeft", "right": "ArrowRight"}[side])
        if number == 40:
            browser.wait("!document.getElementById('trouble').hidden")
            assert "sent again by itself" in browser.see("document.getElementById('trouble_text').textContent")
            server.start()
    browser.arrive("/done")
    assert "DONE7" in browser.see("document.body.innerText")
    _, table = exported(folder)
    assert table["chosen"].tolist() == clicks
    assert table["trial"].tolist() == list(range(1, 61)) and set(table["session"]) == {"done"}
    assert table["left"].tolist() == [one.left for one in design.sessions[0]]
    assert table["replays_left"].tolist() == table["replays_right"].tolist() == replays
    np.testing.assert_allclose(table["watched_left_s"], DURATION_S * (1 + np.array(replays)), atol=0.05)
    assert (table["response_time_s"] >= DURATION_S * 0.9).all() and (table["choice_time_s"] > 0).all()
    assert table["start_drift_s"].notna().all() and table["start_drift_s"].abs().median() < 0.1
    assert table["loads_n"].tolist() == [3 - 1 if n in (20, 30) else 1 for n in range(1, 61)]
    hosts = {re.match(r"\w+://([^/]*)", one)[1] for one in browser.requests if not one.startswith("data:")}
    assert hosts == {f"127.0.0.1:{server.port}"}  # nothing comes from elsewhere
    assert not [one for one in browser.said if "ERR_CONNECTION" not in one]


def test_answers_only_after_both_have_played_and_single_replays(at):
    browser, server, folder = at("tie_allowed = true\n")
    to_the_trials(browser, server)
    for key in ("ArrowLeft", "ArrowRight", "ArrowDown"):
        browser.press(key)
    browser.see("document.querySelectorAll('.choice').forEach((one) => one.click())")
    browser.click("#play")
    browser.see("document.getElementById('left').click()")
    browser.press("ArrowLeft")
    assert exported(folder)[1].empty and trial_shown(browser) == 1
    browser.wait(ANSWERABLE)
    browser.click("#side_right video")
    browser.wait("!videos.right.paused")
    assert browser.see("videos.left.paused")
    browser.wait("videos.right.ended")
    browser.press("ArrowDown")
    browser.wait("document.getElementById('progress').textContent.startsWith('2 of')")
    (row,) = exported(folder)[1].to_dict("records")
    assert (row["chosen"], row["replays_left"], row["replays_right"]) == ("", 0, 1)
    assert row["watched_right_s"] == pytest.approx(2 * DURATION_S, abs=0.05)


def test_autoplay(at):
    browser, server, _ = at("autoplay = true\n")
    to_the_start(browser, server)
    browser.wait(ANSWERABLE)
    browser.press("ArrowLeft")
    browser.wait("document.getElementById('progress').textContent.startsWith('2 of')")
    browser.wait(ANSWERABLE)


def test_a_video_that_cannot_be_loaded(at):
    browser, server, folder = at()
    design = load_design(folder)
    path = folder / design.stimulus(design.sessions[0][0].left).file
    content = path.read_bytes()
    path.write_bytes(b"no video")
    to_the_start(browser, server)
    browser.wait("!document.getElementById('trouble').hidden && !document.getElementById('again').hidden")
    assert browser.see("document.getElementById('play').disabled")
    path.write_bytes(content)
    browser.do("Network.clearBrowserCache")
    browser.click("#again")
    browser.click("#play")
    browser.wait(ANSWERABLE)


@pytest.mark.parametrize(
    ("width", "height"), [(1000, 760), (390, 844), (844, 390), (320, 568)], ids=["desktop", "phone", "lying", "small"]
)
def test_layout(at, tmp_path, width, height):
    browser, server, _ = at("tie_allowed = true\n")
    browser.resize(width, height, mobile=width < 900)
    browser.go(server.address)
    browser.wait("!!document.querySelector('form')")
    assert browser.see("document.documentElement.scrollWidth") <= width
    to_the_trials(browser, server)
    browser.click("#play")
    browser.wait(ANSWERABLE)
    boxes = {
        name: browser.see(f"document.querySelector('{selector}').getBoundingClientRect().toJSON()")
        for name, selector in {
            **{side: f"#side_{side} video" for side in ("left", "right")},
            **{f"{side} button": f"#{side}" for side in ("left", "right")},
            "play": "#play",
            "question": "#question",
        }.items()
    }
    for what in ("", " button"):
        left, right = boxes[f"left{what}"], boxes[f"right{what}"]
        assert left["top"] == right["top"] and left["width"] == pytest.approx(right["width"], abs=1)
        assert 0 <= left["left"] < left["right"] <= right["left"] < right["right"] <= width  # side by side
    assert boxes["left"]["bottom"] <= boxes["left button"]["top"]
    assert boxes["left"]["height"] >= 0.7 * 0.75 * boxes["left"]["width"] or height < 400
    assert all(box["top"] >= 0 and box["bottom"] <= height for box in boxes.values()), boxes  # without scrolling
    assert boxes["left button"]["height"] >= 40 and boxes["play"]["height"] >= 39  # for thumbs
    assert browser.see("document.documentElement.scrollWidth") <= width
    picture = tmp_path / "window.png"
    browser.picture(picture)
    pixels = cv2.imread(str(picture)).astype(int)
    scale = pixels.shape[1] / width
    for side in ("left", "right"):
        box = boxes[side]
        middle = [int(scale * (box[a] + box[b]) / 2) for a, b in (("top", "bottom"), ("left", "right"))]
        blue, _, red = (
            pixels[middle[0] - 5 : middle[0] + 5, middle[1] - 30 : middle[1] + 30].reshape(-1, 3).mean(axis=0)
        )
        assert red > blue + 5  # lips or mouth, not the page


def test_withdrawal(at):
    browser, server, folder = at()
    to_the_trials(browser, server)
    browser.click("#play")
    browser.wait(ANSWERABLE)
    browser.click("#left")
    browser.wait("document.getElementById('progress').textContent.startsWith('2 of')")
    browser.click("footer a")
    browser.arrive("/withdraw")
    browser.click("a.button")  # no, go on
    browser.wait(
        "document.getElementById('progress') && document.getElementById('progress').textContent.startsWith('2 of')"
    )
    assert len(exported(folder)[1]) == 1
    browser.click("footer a")
    browser.click("form button")
    browser.wait("document.body.innerText.includes('have been deleted')")
    assert exported(folder)[1].empty
    browser.go(server.address)
    browser.wait("!!document.querySelector('form')")
    time.sleep(0.1)
    assert not browser.said
