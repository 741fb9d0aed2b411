"""The viewer's page: what is written into it, and what Chromium makes of it.

In the browser the page checks its own steps, speeds, modes and pictures (#selftest); here the numbers that it unpacked
are compared with those that went in, and pictures of the window from outside with one another.
"""

import base64
import dataclasses
import json
import re
import shutil
import subprocess
import webbrowser
import zlib

import cv2
import numpy as np
import pandas as pd
import pytest
from moved_mouth import moved_mouth

from simulator import viewer
from simulator.errors import InputError
from simulator.motion import BROKEN, STICKING
from simulator.mouth import SALIVA
from simulator.stress import von_mises
from simulator.surface import display_frames, display_surface

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
in_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here to open the page in; install chromium")
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--window-size=640,560",
    "--virtual-time-budget=2000",
]
WEBGL = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
TITLE = 'Slow </script> & "opening" {{clip}}'


@pytest.fixture(scope="module")
def moved():
    mouth, motion = moved_mouth(times=11, patch=(0.004, 0.008))
    motion.saliva.state[6, :2] = STICKING
    return mouth, motion


@pytest.fixture(scope="module")
def truth(moved):
    time_s = moved[1].time_s
    width = np.where(time_s > 0, 0.05 * time_s, np.nan)
    return pd.DataFrame({"time_s": time_s, "n_openings": 2 - (time_s >= 0.5), "width_m": width, "height_m": width / 4})


@pytest.fixture(scope="module")
def page(moved, truth, tmp_path_factory):
    path = tmp_path_factory.mktemp("clip") / "slow.view.html"
    assert viewer.write_page(path, *moved, title=TITLE, truth_frames=truth) == path
    return path


def clip_of(page):
    (text,) = re.findall(r'<script id="clip" type="application/json">(.*?)</script>', page.read_text(), re.DOTALL)
    return json.loads(text)


def unpack(packed):
    """Slow and plain: planes of bytes to folded numbers to differences to values."""
    planes = zlib.decompress(base64.b64decode(packed["data"]))
    rows, columns, size = packed["rows"], packed["columns"], packed["bits"] // 8
    assert len(planes) == rows * columns * size
    count, values = rows * columns, []
    for i in range(count):
        folded = sum(planes[k * count + i] << (8 * k) for k in range(size))
        change = folded // 2 if folded % 2 == 0 else -(folded + 1) // 2
        values.append(((values[i - columns] if i >= columns else 0) + change) % 2 ** (8 * size))
    return np.array(values).reshape(rows, columns)


# -- what is in the page ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.uint32])
def test_packed_numbers_unpack(dtype):
    rng = np.random.default_rng(5)
    values = rng.integers(0, np.iinfo(dtype).max, (7, 40), dtype, endpoint=True)
    values[0, 0], values[1, 0], values[2, 0] = 0, np.iinfo(dtype).max, 0
    assert np.array_equal(unpack(viewer._packed(values)), values)


def test_the_page_holds_the_motion(moved, page):
    mouth, motion = moved
    clip, surface = clip_of(page), display_surface(mouth)
    assert clip["title"] == TITLE and clip["times_s"] == motion.time_s.tolist()
    assert np.array_equal(unpack(clip["quads"]), surface.quads)
    assert np.array_equal(unpack(clip["element_of"])[:, 0], surface.element_of)
    steps = unpack(clip["positions"]).reshape(11, -1, 3)
    error = np.linalg.norm(
        clip["low_m"] + np.array(clip["step_m"]) * steps - display_frames(*moved, motion.time_s), axis=2
    )
    assert error.max() <= clip["error_m"] * (1 + 1e-6) < 2e-6
    assert np.array_equal(unpack(clip["state"]), motion.saliva.state) and BROKEN in motion.saliva.state
    stress = von_mises(mouth, motion.positions)
    top = np.percentile(stress[:, mouth.group != SALIVA], 99.5)
    assert clip["stress_top_pa"] == pytest.approx(top)
    np.testing.assert_allclose(unpack(clip["stress"]) * top / 255, np.minimum(stress, top), atol=0.51 * top / 255)
    assert clip["truth"]["unit"] == "mm" and clip["truth"]["width"][:2] == [None, pytest.approx(5)]
    nodes = surface.nodes[np.array(clip["upper"])]
    assert np.array_equal(nodes, mouth.upper)


def test_kinds_of_quads(moved, page):
    mouth, surface = moved[0], display_surface(moved[0])
    kind = unpack(clip_of(page)["kind"])[:, 0]
    corners = surface.nodes[surface.quads]
    assert np.array_equal(kind == 0, np.isin(corners, mouth.outer).all(axis=1))
    assert (kind == 2).sum() == 2 * len(mouth.saliva) + 2  # two lips and the two corners


def test_the_page_needs_no_network_and_is_safe(page):
    text = page.read_text()
    assert not re.findall(r"https?:|//[a-z]+\.|\bimport\b|\bfetch\b|XMLHttp|@import|src=", text.replace("//-", ""))
    assert re.findall(r'href="([^"]*)"', text) == ["data:,"]
    assert "<title>Slow &lt;/script&gt; &amp; &quot;opening&quot; {{clip}}</title>" in text
    assert text.count("</script>") == 2


def test_other_times_and_given_stress(tmp_path, moved):
    mouth, motion = moved
    stress = np.zeros((11, len(mouth.elements)))
    stress[:, 0] = 100 * motion.time_s
    stress[:, 5] = np.nan
    page = viewer.write_page(tmp_path / "a.view.html", mouth, motion, title="a", times_s=[0.25, 0.5], stress=stress)
    clip = clip_of(page)
    assert clip["times_s"] == [0.25, 0.5] and "truth" not in clip
    assert clip["stress_top_pa"] > 0 and unpack(clip["stress"])[:, 1:].max() == 0
    assert np.array_equal(unpack(clip["state"]), motion.saliva.state[[2, 5]])


def test_a_record_in_another_order_gives_the_same_page(tmp_path, moved, truth, page):
    mouth, motion = moved
    turned = dataclasses.replace(motion, saliva=motion.saliva.of(mouth.saliva[::-1]))
    again = viewer.write_page(tmp_path / "c.html", mouth, turned, title=TITLE, truth_frames=truth)
    assert again.read_bytes() == page.read_bytes()


def test_the_same_motion_gives_the_same_bytes(tmp_path, moved, truth, page):
    again = viewer.write_page(tmp_path / "b.html", *moved, title=TITLE, truth_frames=truth)
    assert again.read_bytes() == page.read_bytes()


def test_a_page_of_the_medium_mesh_is_small(tmp_path):
    page = viewer.write_page(tmp_path / "m.view.html", *moved_mouth("medium", times=60), title="m")
    assert page.stat().st_size < 8e6


def test_bad_input(tmp_path, moved):
    mouth, motion = moved
    path = tmp_path / "a.view.html"
    with pytest.raises(InputError, match=r"stress of shape \(11, 870\), saved states and elements, got \(3, 870\)"):
        viewer.write_page(path, mouth, motion, title="a", stress=np.zeros((3, 870)))
    with pytest.raises(InputError, match="columns time_s and n_openings, got none of n_openings"):
        viewer.write_page(path, mouth, motion, title="a", truth_frames=pd.DataFrame({"time_s": [0.0]}))
    with pytest.raises(InputError, match="times from 0 to 1 s"):
        viewer.write_page(path, mouth, motion, title="a", times_s=[0.0, 3.0])
    assert not path.exists()


# -- opening it -------------------------------------------------------------------------------------------------------


def test_view_opens_the_page_of_a_clip(page, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or True)
    assert viewer.view(page.parent) == page == viewer.view(page)
    assert opened == [page.resolve().as_uri()] * 2
    assert viewer.view(page, open_browser=False) == page and len(opened) == 2
    monkeypatch.setattr(webbrowser, "open", lambda address: False)
    with pytest.raises(InputError, match=r"expected a browser .*slow\.view\.html where there is one"):
        viewer.view(page)


def test_command_line(page, tmp_path, capsys):
    assert viewer.main([str(page.parent), "--no-browser"]) == 0
    assert capsys.readouterr().out == f"{page}\n"
    assert viewer.main([str(page), "--no-browser", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"command": "view", "page": str(page)}
    (tmp_path / "notes.txt").touch()
    for path, sentence in (
        (tmp_path, r"expected a page \(\*\.view\.html\) in the folder .*, got none; make a clip"),
        (tmp_path / "gone", "which does not exist"),
        (tmp_path / "notes.txt", r"got the file .*notes\.txt; give the folder it lies in"),
    ):
        assert viewer.main([str(path)]) == 2
        said = capsys.readouterr()
        assert said.out == "" and said.err.count("\n") == 1 and re.search(sentence, said.err)
    for name in ("a.view.html", "b.view.html"):
        (tmp_path / name).touch()
    assert viewer.main([str(tmp_path)]) == 2
    assert re.search(r"expected one page .*, got 2; name one of them, such as .*a\.view\.html", capsys.readouterr().err)


# -- in the browser ---------------------------------------------------------------------------------------------------


def chromium(page, state, profile, *extra):
    """What Chromium prints when it opens the page at `#state`."""
    command = [CHROMIUM, *FLAGS, f"--user-data-dir={profile}", *extra, f"{page.resolve().as_uri()}#{state}"]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout


@pytest.fixture
def picture(page, tmp_path):
    def taken(state):
        file = tmp_path / "window.png"
        chromium(page, state, tmp_path / "profile", *WEBGL, f"--screenshot={file}")
        return cv2.imread(str(file)).astype(int)

    return taken


@in_browser
@pytest.mark.slow
def test_the_page_passes_its_own_checks_and_unpacks_what_was_packed(moved, page, tmp_path):
    dom = chromium(page, "selftest", tmp_path, *WEBGL, "--dump-dom")
    found = re.search(r'id="result">(.*?)</script>', dom, re.DOTALL)
    assert found, dom[-2000:]
    result = json.loads(found[1])
    failed = [name for name, right in result["checks"].items() if not right]
    assert not failed and len(result["checks"]) >= 38 and result["named"]
    assert len({one["hash"] for one in result["pixels"].values()}) == 8  # four modes at the start and the end
    assert all(0.05 < one["covered"] < 0.95 for one in result["pixels"].values())
    mouth, motion = moved
    frame = display_frames(mouth, motion, motion.time_s[[result["frame"]]])[0]
    np.testing.assert_allclose(np.reshape(result["vertices"], (-1, 3)), frame[::10], atol=result["error_m"] + 1e-8)
    stress = von_mises(mouth, motion.positions[[result["frame"]]])[0][display_surface(mouth).element_of][::10]
    top = clip_of(page)["stress_top_pa"]
    np.testing.assert_allclose(result["stress"], np.minimum(stress / top, 1) * 255, atol=0.51)


@in_browser
@pytest.mark.slow
def test_pictures_of_the_window(picture):
    shots = {mode: picture(f"mode={mode}&frame=10&view=front") for mode in ("shaded", "wireframe", "stress", "saliva")}
    middle = (slice(100, 330), slice(170, 470))  # of the window, within the face
    for one, other in (("shaded", "wireframe"), ("stress", "saliva"), ("shaded", "stress"), ("wireframe", "saliva")):
        assert np.abs(shots[one][middle] - shots[other][middle]).mean() > 10
    blue, _, red = np.moveaxis(shots["shaded"][middle], -1, 0)
    assert np.mean(red > blue + 15) > 0.9  # skin and lips
    closed = picture("mode=shaded&frame=0&view=front")
    assert (shots["shaded"][middle].sum(axis=2) < 120).sum() > 10 * (closed[middle].sum(axis=2) < 120).sum()

    intact, broken = (
        lambda shot, colour=colour: np.abs(shot[middle] - colour).sum(axis=2) < 10
        for colour in ([168, 95, 31], [20, 92, 222])  # blue, green, red
    )
    glued, patched = picture("mode=saliva&frame=0&view=front"), picture("mode=saliva&frame=4&view=front")
    assert intact(glued).sum() > 300 and broken(glued).sum() == 0
    assert broken(shots["saliva"]).sum() > 300 and intact(shots["saliva"]).sum() == 0
    columns = np.flatnonzero(broken(patched).any(axis=0))
    inside = intact(patched)[:, columns.min() : columns.max()].any(axis=0)
    assert inside.sum() > 5 and np.flatnonzero(inside).min() + columns.min() > 150  # the patch is on the right


@in_browser
@pytest.mark.slow
def test_without_webgl_the_page_says_so(page, tmp_path):
    dom = chromium(page, "", tmp_path, "--disable-3d-apis", "--disable-gpu", "--dump-dom")
    (notice,) = re.findall(r'<p id="sorry"([^>]*)>(.*?)</p>', dom)
    assert "hidden" not in notice[0] and "no WebGL 2" in notice[1]
