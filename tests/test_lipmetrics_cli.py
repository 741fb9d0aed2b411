import errno
import json
import os
import re
import signal
import subprocess
import sys
import textwrap
import time

import av
import cv2
import numpy as np
import pytest
import ring_mouth
from clips import write_pictures, write_sound, write_video

from lipmetrics import cli, detect
from lipmetrics import profile as profiles
from lipmetrics.profile import load_profile
from simulator.scene import Camera, Face, Scene

TABLES = [".frames.csv", ".json", ".openings.csv"]


@pytest.fixture(autouse=True)
def scripted(monkeypatch):
    monkeypatch.setitem(detect.METHODS, "default", "ring_mouth")


@pytest.fixture(scope="module")
def pictures():
    return [ring_mouth.ring(h) for h in (0, 6, 9, 12, 6, 0)]


@pytest.fixture
def clip(tmp_path, pictures):
    return write_video(tmp_path / "take.mp4", pictures)


@pytest.fixture
def run(tmp_path, capsys):
    """Run `lipmetrics measure ARGUMENTS -o out`; returns exit code, stdout and stderr."""

    def run(*arguments):
        code = cli.main(["measure", *map(str, arguments), "-o", str(tmp_path / "out")])
        return code, *capsys.readouterr()

    return run


def written(folder):
    return sorted(path.name for path in folder.iterdir()) if folder.exists() else []


def test_a_clip_is_measured(run, clip, tmp_path):
    code, out, err = run(clip)
    assert (code, err) == (0, "")
    assert out.startswith("take.mp4: 6 frames, 2 open, 2 closed, 2 without a mouth -> ")
    assert written(tmp_path / "out") == ["take" + ending for ending in TABLES]
    assert len(load_profile(tmp_path / "out" / "take").frames) == 6


def test_json_is_one_document_on_stdout(run, clip, tmp_path):
    code, out, _ = run(clip, tmp_path / "missing.mp4", "--json")
    summary = json.loads(out)
    assert code == cli.SOME_FAILED
    assert summary["clips"][0]["frames"] == 6 and summary["clips"][0]["mouth_width_px"] == 40
    assert len(summary["clips"][0]["files"]) == 3
    assert summary["failed"][0]["source"].endswith("missing.mp4")


def test_options_reach_the_measurement(run, clip, tmp_path):
    assert (
        run(clip, "--start", "0.03", "--stop", "0.2", "--every", "2", "--roi", "4,8,100,70", "--mouth-width", "50")[0]
        == 0
    )
    meta = load_profile(tmp_path / "out" / "take").meta
    choices = meta["choices"]
    assert (choices["start_s"], choices["stop_s"], choices["every"]) == (0.03, 0.2, 2)
    assert choices["roi"] == {"row0": 8, "row1": 78, "col0": 4, "col1": 104}
    assert meta["mouth_width_px"] == 50


def test_the_thesis_method_by_name(run, clip, tmp_path):
    assert run(clip, "--method", "thesis")[0] == 0
    assert load_profile(tmp_path / "out" / "take").meta["settings"]["median_px"] == 5


def test_pictures_are_drawn_on_request(run, clip, tmp_path):
    code, _, err = run(clip, "--plot", "--overlay", "--sheet")
    assert (code, err) == (0, "")
    assert set(written(tmp_path / "out")) > {"take.plot.png", "take.overlay.mp4", "take.sheet.png"}


def test_nothing_unasked_is_imported(clip, tmp_path):
    code = f"""
        import sys
        from lipmetrics.cli import main
        assert main(["measure", {str(clip)!r}, "-o", {str(tmp_path / "out")!r}, "--method", "thesis"]) == 0
        unasked = ("matplotlib", "tqdm", "lipmetrics.overlay", "lipmetrics.sheet")
        print([name for name in unasked if name in sys.modules])
    """
    assert python(code).stdout.splitlines()[-1] == "[]"


def test_help_imports_nothing_heavy():
    code = """
        import sys
        from lipmetrics.cli import main
        try:
            main(["--help"])
        except SystemExit as end:
            assert end.code == 0
        print([name for name in ("numpy", "cv2", "av", "numba", "pandas") if name in sys.modules])
    """
    assert python(code).stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize("verb", ["measure", "demo"])
def test_every_verb_has_help_with_an_example(verb, capsys):
    with pytest.raises(SystemExit) as end:
        cli.main([verb, "--help"])
    assert end.value.code == 0
    assert f"example: lipmetrics {verb}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "required: COMMAND"),
        (["meassure"], "invalid choice: 'meassure'"),
        (["measure", "a.mp4"], "required: -o/--out"),
        (["measure", "-o", "out"], "required: VIDEO"),
        (["measure", "a.mp4", "-o", "out", "--every", "0"], "expected a whole number of at least 1, got '0'"),
        (["measure", "a.mp4", "-o", "out", "--start", "soon"], "expected a time in seconds such as 1.5, got 'soon'"),
        (["measure", "a.mp4", "-o", "out", "--roi", "1,2,3"], "expected X,Y,W,H in whole px"),
        (["measure", "a.mp4", "-o", "out", "--roi", "1,2,0,4"], "expected X,Y,W,H in whole px"),
        (["measure", "a.mp4", "-o", "out", "--mouth-width", "-3"], "expected a number above 0, got '-3'"),
        (["measure", "a.mp4", "-o", "out", "--mouth-width", "nan"], "expected a number above 0, got 'nan'"),
    ],
)
def test_bad_arguments_are_one_line_and_code_2(arguments, sentence, capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(arguments)
    out, err = capsys.readouterr()
    assert (end.value.code, out) == (2, "")
    assert sentence in err and err.count("\n") == 1


def _empty(path):
    path.write_bytes(b"")
    return path


def _text(path):
    path.write_text("these are the minutes of the meeting\n" * 50)
    return path


def _no_frames(path):
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.height, stream.width, stream.pix_fmt = 32, 32, "yuv420p"
        container.start_encoding()
    return path


def _empty_folder(path):
    folder = path.with_suffix("")
    folder.mkdir()
    return folder


BAD_FILES = {
    "missing": lambda path: path,
    "empty": _empty,
    "text": _text,
    "sound only": write_sound,
    "no frames": _no_frames,
    "empty folder": _empty_folder,
    "a folder that is not there": lambda path: path.parent / "nowhere" / "take.mp4",
}


@pytest.mark.parametrize("make", BAD_FILES.values(), ids=BAD_FILES.keys())
def test_bad_input_is_one_line_and_code_2(make, run, tmp_path):
    code, out, err = run(make(tmp_path / "bad.mp4"))
    assert (code, out) == (2, "")
    assert err.startswith("lipmetrics: ") and err.count("\n") == 1 and len(err) > 40
    assert written(tmp_path / "out") == []


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--method", "thesys"], "did you mean 'thesis'"),
        (["--start", "5"], "got start 5 s"),
        (["--start", "2", "--stop", "1"], "start"),
        (["--roi", "100,0,50,50"], "inside the picture of 120 x 80 px"),
        (["--fps", "25"], "fps"),
    ],
)
def test_choices_that_do_not_fit_the_clip_are_one_line_and_code_2(arguments, sentence, run, clip, tmp_path):
    code, _, err = run(clip, *arguments)
    assert code == 2 and sentence in err and err.count("\n") == 1
    assert written(tmp_path / "out") == []


def test_a_batch_goes_past_bad_clips_and_names_them(run, tmp_path, pictures):
    folder = tmp_path / "recordings"
    folder.mkdir()
    write_video(folder / "a.mp4", pictures)
    _empty(folder / "b.mp4")
    write_video(folder / "c.MOV", pictures)
    _empty(folder / "._a.mp4")  # what macOS leaves beside a file
    (folder / "notes.txt").write_text("speaker 3")
    code, out, err = run(folder)
    assert code == cli.SOME_FAILED
    assert "2 of 3 clips measured" in out
    assert err.count("\n") == 1 and str(folder / "b.mp4") in err
    assert written(tmp_path / "out") == [stem + ending for stem in ("a", "c") for ending in TABLES]


def test_a_batch_in_which_all_fail_is_code_2(run, tmp_path):
    code, _, err = run(_empty(tmp_path / "a.mp4"), tmp_path / "b.mp4")
    assert code == 2 and err.count("\n") == 2


def test_a_fault_of_ours_does_not_stop_a_batch(run, clip, tmp_path, pictures, monkeypatch):
    other = write_video(tmp_path / "other.mp4", pictures)
    look = ring_mouth._Script.look

    def trip(self, frame):
        if not tripped:
            tripped.append(1)
            raise KeyError("missing piece")
        return look(self, frame)

    tripped = []
    monkeypatch.setattr(ring_mouth._Script, "look", trip)
    code, _, err = run(clip, other)
    assert code == cli.SOME_FAILED and "unexpected KeyError: 'missing piece'" in err
    tripped.clear()
    with pytest.raises(KeyError):
        run(clip)


def test_an_image_sequence_folder_is_one_clip(run, tmp_path, pictures):
    folder = write_pictures(tmp_path / "speaker.1", pictures)
    assert run(folder, "--fps", "25")[0] == 0
    assert run(folder / "*.png", "--fps", "25")[0] == 2  # the pattern is another source of the same name
    assert written(tmp_path / "out") == ["speaker.1" + ending for ending in TABLES]


def test_clips_of_one_name_get_names_of_their_own():
    assert cli.unique_stems(["x/grid.mp4", "x/lip.v2.mp4"]) == ["grid", "lip.v2"]
    assert cli.unique_stems(["x/grid.mp4", "x/grid.mpg", "x/b.mp4"]) == ["grid_mp4", "grid_mpg", "b"]
    assert cli.unique_stems(["x/a/grid.mp4", "x/b/grid.mp4"]) == ["a_grid", "b_grid"]
    assert cli.unique_stems(["1/a/grid.mp4", "2/a/grid.mp4"]) == ["a_grid", "a_grid_2"]
    assert cli.unique_stems(["x/Grid.mp4", "x/grid.mpg"]) == ["Grid_mp4", "grid_mpg"]
    everything = [f"{a}/{b}.{c}" for a in "xy" for b in ("g", "g_mp4", "x_g") for c in ("mp4", "mpg")]
    assert len(set(cli.unique_stems(everything))) == len(everything)


def test_the_same_clip_named_twice_is_measured_once(clip):
    assert cli.find_clips([str(clip), str(clip.parent)]) == [str(clip)]


def test_another_clip_of_the_same_name_does_not_replace_the_first(run, clip, tmp_path, pictures):
    assert run(clip)[0] == 0
    assert run(clip)[0] == 0  # the same clip again is fine
    before = (tmp_path / "out" / "take.json").read_bytes()
    other = write_video(tmp_path / "take.avi", pictures, codec="mpeg4")
    code, _, err = run(other)
    assert code == 2 and "profile of another clip, take.mp4" in err
    assert (tmp_path / "out" / "take.json").read_bytes() == before
    assert run(other, "--overwrite")[0] == 0


def test_an_output_folder_that_cannot_be_is_found_out_first(run, clip, tmp_path):
    (tmp_path / "out").write_text("a file")
    code, _, err = run(clip)
    assert code == 2 and "expected an output folder" in err and err.count("\n") == 1


def test_a_full_disk_is_one_line_and_leaves_nothing(run, clip, tmp_path, monkeypatch):
    write = profiles.Path.write_text

    def fill_up(path, text, **kwargs):
        write(path, text[: len(text) // 2], **kwargs)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(profiles.Path, "write_text", fill_up)
    code, _, err = run(clip)
    assert code == 2 and "No space left on device" in err and err.count("\n") == 1
    assert written(tmp_path / "out") == []


@pytest.mark.parametrize(
    ("error", "sentence"),
    [(MemoryError(), "ran out of memory"), (OSError(errno.EIO, "Input/output error"), "Input/output error")],
)
def test_errors_of_the_machine_are_one_line(run, clip, monkeypatch, error, sentence):
    def fail(self, frame):
        raise error

    monkeypatch.setattr(ring_mouth._Script, "look", fail)
    code, _, err = run(clip)
    assert code == 2 and sentence in err and err.count("\n") == 1


ODD_PICTURES = {
    "one frame": lambda rng: ring_mouth.ring(9),
    "8 x 8": lambda rng: ring_mouth.ring(9)[:8, :8],
    "odd size": lambda rng: ring_mouth.ring(9)[:77, :113],
    "16-bit grey": lambda rng: rng.integers(0, 65536, (60, 90), dtype=np.uint16),
    "alpha": lambda rng: np.dstack([ring_mouth.ring(9), np.full((80, 120), 99, np.uint8)]),
    "black": lambda rng: np.zeros((60, 90, 3), np.uint8),
    "white": lambda rng: np.full((60, 90, 3), 255, np.uint8),
    "noise": lambda rng: rng.integers(0, 256, (60, 90, 3), dtype=np.uint8),
}


@pytest.mark.parametrize("draw", ODD_PICTURES.values(), ids=ODD_PICTURES.keys())
def test_odd_pictures_are_measured_or_refused_in_one_line(draw, run, tmp_path):
    path = tmp_path / "odd.png"
    assert cv2.imwrite(str(path), draw(np.random.default_rng(0)))
    code, _, err = run(path, "--method", "thesis")
    assert code == 0 and err.count("\n") <= 1
    table = load_profile(tmp_path / "out" / "odd").frames
    assert len(table) == 1 and table["time_s"][0] == 0


def test_a_file_that_ends_early_is_measured_with_a_warning(run, tmp_path, pictures):
    whole = write_video(tmp_path / "whole.mp4", pictures * 20, container_options={"movflags": "faststart"})
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size * 2 // 3])
    code, out, err = run(cut)
    assert code == 0 and "cut.mp4: " in out
    assert "cut.mp4: warning: " in err
    assert 10 < len(load_profile(tmp_path / "out" / "cut").frames) < 120


# --- in a process of its own ---


def python(code, **kwargs):
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, check=True, **kwargs
    )


STUCK = """
    import sys, time
    sys.path.insert(0, {tests!r})
    import ring_mouth
    from lipmetrics import cli, detect, profile
    detect.METHODS["default"] = "ring_mouth"
    {trap}
    sys.exit(cli.main(["measure", *{clips!r}, "-o", {out!r}]))
"""
TRAPS = {
    "measuring the second clip": """
    look, seen = ring_mouth._Script.look, []
    def stop(self, frame):
        seen.append(frame)
        if len(seen) > 8:
            print("stuck", flush=True)
            time.sleep(60)
        return look(self, frame)
    ring_mouth._Script.look = stop
    """,
    "writing the second clip": """
    write = profile.Path.write_text
    def stop(path, text, **kwargs):
        write(path, text[: len(text) // 2], **kwargs) if "second" in path.name else write(path, text, **kwargs)
        if "second.frames" in path.name:
            print("stuck", flush=True)
            time.sleep(60)
    profile.Path.write_text = stop
    """,
}


@pytest.fixture
def stuck(request, tmp_path, pictures):
    """A process that has finished one clip and is stuck half-way in the second."""
    clips = [str(write_video(tmp_path / f"{name}.mp4", pictures)) for name in ("first", "second")]
    code = STUCK.format(
        tests=os.path.dirname(__file__), trap=TRAPS[request.param].strip(), clips=clips, out=str(tmp_path / "out")
    )
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    for line in process.stdout:
        if line == "stuck\n":
            break
    time.sleep(0.1)
    yield process
    process.kill()
    process.communicate()


@pytest.mark.parametrize(
    "stuck",
    [pytest.param("measuring the second clip", marks=pytest.mark.slow), "writing the second clip"],
    indirect=True,
)
def test_killed_half_way_leaves_whole_tables_only(stuck, tmp_path):
    stuck.send_signal(signal.SIGKILL)
    stuck.wait()
    visible = [name for name in written(tmp_path / "out") if not name.startswith(".")]
    assert visible == ["first" + ending for ending in TABLES]
    assert len(load_profile(tmp_path / "out" / "first").frames) == 6


@pytest.mark.parametrize(
    "stuck",
    ["measuring the second clip", pytest.param("writing the second clip", marks=pytest.mark.slow)],
    indirect=True,
)
def test_ctrl_c_is_code_130_without_a_traceback(stuck, tmp_path):
    stuck.send_signal(signal.SIGINT)
    _, err = stuck.communicate()
    assert (stuck.returncode, err) == (130, "lipmetrics: stopped; what was finished before is kept\n")
    assert written(tmp_path / "out") == ["first" + ending for ending in TABLES]


def test_a_reader_that_goes_away_does_not_stop_the_work(tmp_path, pictures):
    clips = [str(write_video(tmp_path / f"{name}.mp4", pictures)) for name in "abc"]
    command = [
        sys.executable,
        "-m",
        "lipmetrics.cli",
        "measure",
        *clips,
        "-o",
        str(tmp_path / "out"),
        "--method",
        "thesis",
    ]
    read_end, write_end = os.pipe()
    os.close(read_end)
    done = subprocess.run(command, stdout=write_end, stderr=subprocess.PIPE, text=True, check=False)
    os.close(write_end)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(written(tmp_path / "out")) == 9


def test_demo_into_a_place_that_cannot_be_written_to(tmp_path, capsys):
    (tmp_path / "taken").write_text("a file")
    assert cli.main(["demo", "-o", str(tmp_path / "taken")]) == cli.BAD_INPUT
    assert re.fullmatch(r"lipmetrics: expected an output folder to write to, got .*; .*\n", capsys.readouterr().err)


@pytest.mark.parametrize(
    ("scene", "code", "sentence"),
    [
        (Scene(camera=Camera(width_px=32), face=Face(preset="nobody")), cli.BAD_INPUT, "expected a face of "),
        (KeyboardInterrupt(), cli.STOPPED, "stopped; what was finished before is kept"),
        (OSError(errno.ENOSPC, "No space left on device"), cli.BAD_INPUT, "No space left on device"),
    ],
)
def test_a_demo_that_fails_is_one_sentence(scene, code, sentence, tmp_path, capsys, monkeypatch):
    simulate = cli.simulate_demo

    def failing(folder):
        if isinstance(scene, BaseException):
            raise scene
        return simulate(folder, scene)

    monkeypatch.setattr(cli, "simulate_demo", failing)
    assert cli.main(["demo", "-o", str(tmp_path / "demo")]) == code
    err = capsys.readouterr().err
    assert err.startswith("lipmetrics: ") and sentence in err and err.count("\n") == 1
    assert written(tmp_path / "demo") == []
