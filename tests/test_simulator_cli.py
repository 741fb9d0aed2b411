import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import simulator
from lipmetrics.cli import main as lipmetrics
from simulator import assembly, checkpoint, cli
from simulator.export import load_motion
from simulator.scene import load_scene, scene_names, scene_text

MODEL = """<Model>
  <Nodes DOF="3" NumNodes="8">
0 0 0  1 0 0  1 1 0  0 1 0
0 0 1  1 0 1  1 1 1  0 1 1
  </Nodes>
  <Elements NumEls="1" Type="H8">0 1 2 3 4 5 6 7</Elements>
  <ElementSet Size="all">
    <Material Type="NH"><ElasticParams NumParams="2">800 7000</ElasticParams></Material>0</ElementSet>
  <Constraint Type="Fix" DOF="all" NumNodes="4"><Nodes>0</Nodes></Constraint>
  <Constraint Type="Disp" DOF="2" NumNodes="4" LoadShape="POLY345">
    <Nodes>4</Nodes><Magnitudes Type="UNIFORM">0.25</Magnitudes>
  </Constraint>
  <SystemParams>
    <TimeStep>0.01</TimeStep><TotalTime>1</TotalTime>
    <DampingCoeff>5</DampingCoeff><HGKappa>0.08</HGKappa><Density>1000</Density>
  </SystemParams>
  <Output Freq="20"><Variable>U</Variable></Output>
</Model>
"""


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "cube.xml"
    path.write_text(MODEL)
    return path


@pytest.fixture
def run(tmp_path, capsys):
    def run(*arguments):
        try:
            code = cli.main([*map(str, arguments), "--threads", "1", "-o", str(tmp_path / "out")])
        except SystemExit as stop:
            code = stop.code
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


def test_a_model_to_its_files(run, model, tmp_path):
    code, out, err = run(model, "--vtu")
    assert (code, err) == (0, "")
    assert "1 H8 elements, 1" in out and "largest displacement 0.25 m" in out and "cube.h5" in out
    names = sorted(path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.*"))
    states = [f"cube_vtu/cube_{frame:05d}.vtu" for frame in range(6)]
    assert names == ["cube.energy.csv", "cube.h5", "cube.pvd", *states]
    motion = load_motion(tmp_path / "out" / "cube.h5")
    np.testing.assert_allclose(motion.time_s, [0, 0.2, 0.4, 0.6, 0.8, 1], atol=1e-9)
    r = motion.time_s
    expected = 0.25 * (10 * r**3 - 15 * r**4 + 6 * r**5)
    np.testing.assert_allclose(motion.displacements[:, 4, 2], expected, atol=1e-6)


def test_summary_for_machines(run, model):
    code, out, _ = run(model, "--json", "--precision", "mixed")
    summary = json.loads(out)
    assert code == 0 and summary["command"] == "simulate" and summary["failed"] == []
    (one,) = summary["models"]
    assert one["source"] == str(model) and len(one["files"]) == 2
    assert (one["element_type"], one["elements"], one["nodes"], one["states"]) == ("H8", 1, 8, 6)
    assert one["dt_s"] == 0.01 and one["stopped"] is None
    assert one["largest_displacement_m"] == pytest.approx(0.25)
    assert abs(one["energy_residual_j"]) < 0.01 * one["work_j"]


def test_the_step_can_be_chosen(run, model):
    _, out, _ = run(model, "--json", "--dt", "0.005")
    one = json.loads(out)["models"][0]
    assert one["dt_s"] == 0.005 and one["states"] == 6  # at the times of the file
    _, out, _ = run(model, "--json", "--dt", "auto")
    one = json.loads(out)["models"][0]
    assert one["dt_s"] not in (0.01, 0.005) and one["states"] == 6


@pytest.mark.parametrize("every, times", [(30, [0, 0.3, 0.6, 0.9, 1]), (500, [0, 1]), (100, [0, 1])])
def test_the_end_is_always_reached(run, model, tmp_path, every, times):
    model.write_text(MODEL.replace('Freq="20"', f'Freq="{every}"'))
    assert run(model)[0] == 0
    np.testing.assert_allclose(load_motion(tmp_path / "out" / "cube.h5").time_s, times, atol=1e-9)


def test_a_bad_file_among_good_ones(run, model, tmp_path):
    bad = tmp_path / "bad.xml"
    bad.write_text(MODEL.replace("<Nodes>4<", "<Nodes>5<"))
    code, out, err = run(bad, model)
    assert code == 3 and "1 of 2 models run" in out
    assert err.count("\n") == 1 and "bad.xml, line 11: expected node numbers from 0 to 7" in err
    code, out, _ = run(bad, model, "--json")
    summary = json.loads(out)
    assert code == 3 and summary["failed"][0]["source"] == str(bad) and len(summary["models"]) == 1


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["none.xml"], "none.xml: No such file"),
        (["cube.xml", "--dt", "0"], "expected a time step above 0 s such as 1e-4, or auto, got '0'"),
        (["cube.xml", "--dt", "nan"], "got 'nan'"),
        (["cube.xml", "--checkpoint-every", "-1"], "expected a number of seconds of 0 or more, got '-1'"),
        (["cube.xml", "--threads=0"], "expected a whole number of at least 1, got '0'"),
        (["cube.xml", "--precision", "float16"], "invalid choice: 'float16'"),
        (["cube.xml", "a/cube.xml"], "got 2 named 'cube'"),
        ([], "the following arguments are required: MODEL"),
    ],
)
def test_bad_arguments_are_one_line(run, model, monkeypatch, arguments, message):
    monkeypatch.chdir(model.parent)
    code, out, err = run(*arguments)
    assert code == 2 and out == "" and message in err and err.count("\n") == 1


def test_a_folder_that_cannot_be_written(run, model, tmp_path):
    (tmp_path / "out").write_text("a file")
    code, _, err = run(model)
    assert code == 2 and "expected an output folder to write to" in err and err.count("\n") == 1


def test_a_body_without_support_names_the_file(run, model):
    fix = MODEL[MODEL.index("  <Constraint") : MODEL.index("  <SystemParams")]
    model.write_text(MODEL.replace(fix, ""))
    code, _, err = run(model)
    assert code == 2 and str(model) in err and err.count("\n") == 1


def test_a_run_that_blows_up_keeps_what_it_has(run, model, tmp_path):
    text = MODEL.replace("<TimeStep>0.01<", "<TimeStep>0.4<").replace("<TotalTime>1<", "<TotalTime>200<")
    model.write_text(text.replace("POLY345", "STEP").replace('Type="Disp"', 'Type="Force"').replace('"20"', '"1"'))
    code, out, err = run(model, "--json")
    (one,) = json.loads(out)["models"]
    assert code == 3 and err.count("\n") == 1 and "the states before are kept" in err
    assert one["stopped"]["time_s"] < 200 and one["states"] >= 1
    again = load_motion(tmp_path / "out" / "cube.h5")
    assert again.stopped.cause == one["stopped"]["cause"] and np.isfinite(again.positions).all()


def start(model, out, *more):
    """The command on a long run, in a process of its own; returns it once its first checkpoint is there."""
    text = MODEL.replace("<TotalTime>1<", "<TotalTime>4000<").replace('Freq="20"', 'Freq="1000"')
    model.write_text(text)
    command = [sys.executable, "-m", "simulator.cli", str(model), "-o", str(out), "--threads", "1", "--velocity"]
    process = subprocess.Popen([*command, "--checkpoint-every", "0", *more], stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 120
    while not (out / "cube.checkpoint.npz").exists() and process.poll() is None and time.monotonic() < end:
        time.sleep(0.01)
    return process


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_run_broken_off_and_resumed_gives_the_same_files(run, model, tmp_path, number, code):
    out = tmp_path / "out"
    process = start(model, out)
    time.sleep(0.1)
    process.send_signal(number)
    err = process.communicate(timeout=60)[1]
    assert process.returncode == code and "interrupted" in err and err.count("\n") == 1
    part = load_motion(out / "cube.h5")
    assert 0 < len(part.time_s) < 401 and part.stopped is not None

    assert run(model, "--velocity", "--resume")[0] == 0
    resumed = [(out / name).read_bytes() for name in ("cube.h5", "cube.energy.csv")]
    assert not (out / "cube.checkpoint.npz").exists()
    assert run(model, "--velocity")[0] == 0
    assert resumed == [(out / name).read_bytes() for name in ("cube.h5", "cube.energy.csv")]
    whole = load_motion(out / "cube.h5")
    assert len(whole.time_s) == 401
    assert np.array_equal(part.positions, whole.positions[: len(part.time_s)])


@pytest.mark.slow
def test_a_killed_run_goes_on_from_its_last_checkpoint(run, model, tmp_path):
    process = start(model, tmp_path / "out")
    process.kill()
    process.communicate(timeout=60)
    assert run(model, "--velocity", "--resume")[0] == 0
    assert len(load_motion(tmp_path / "out" / "cube.h5").time_s) == 401


def test_checkpoints_that_cannot_be_used(run, model, tmp_path):
    file = tmp_path / "out" / "cube.checkpoint.npz"
    code, _, err = run(model, "--resume")
    assert code == 2 and "got no such file" in err and str(file) in err and err.count("\n") == 1
    assert run(model)[0] == 0
    results = (tmp_path / "out" / "cube.h5").read_bytes()
    file.write_bytes(b"PK nonsense")
    code, _, err = run(model, "--resume")
    assert code == 2 and "damaged" in err and str(file) in err and err.count("\n") == 1
    checkpoint.save(file, "another run", {})
    code, _, err = run(model, "--resume")
    assert code == 2 and "another model" in err and str(file) in err and err.count("\n") == 1
    assert (tmp_path / "out" / "cube.h5").read_bytes() == results


def test_velocities_are_written_where_asked_for(run, model, tmp_path):
    assert run(model, "--vtu")[0] == 0
    state = tmp_path / "out" / "cube_vtu" / "cube_00003.vtu"
    assert load_motion(tmp_path / "out" / "cube.h5").velocities is None and b'"velocity"' not in state.read_bytes()
    assert run(model, "--vtu", "--velocity")[0] == 0
    velocities = load_motion(tmp_path / "out" / "cube.h5").velocities
    assert velocities.shape == (6, 8, 3) and b'Name="velocity"' in state.read_bytes()
    r = 0.4
    assert velocities[2, 4, 2] == pytest.approx(0.25 * (30 * r**2 - 60 * r**3 + 30 * r**4), rel=1e-3)


def test_precisions_are_those_of_the_solver():
    assert set(cli.PRECISIONS) == set(assembly.PRECISIONS)


def test_help_needs_no_compiler():
    code = (
        "import sys; from simulator import cli; cli._parser('simulate').format_help(); sys.exit('numba' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_lipmetrics_simulate_is_this_command(model, tmp_path, capsys):
    assert lipmetrics(["simulate", str(model), "-o", str(tmp_path / "out")]) == 0
    assert load_motion(tmp_path / "out" / "cube.h5").positions.shape[1:] == (8, 3)
    capsys.readouterr()
    assert lipmetrics(["simulate", str(tmp_path / "none.xml"), "-o", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    with pytest.raises(SystemExit) as end:
        lipmetrics(["simulate", "--help"])
    assert end.value.code == 0
    assert "lipmetrics simulate model.xml" in capsys.readouterr().out


def test_the_package_offers_its_verbs(model):
    motion = simulator.solve(simulator.read_niftysim(model), [1.0], threads=1)
    assert motion.positions[-1, 4, 2] == pytest.approx(1.25, abs=1e-3)
    assert set(simulator.__all__) <= set(dir(simulator))
    with pytest.raises(AttributeError, match="nothing"):
        _ = simulator.nothing


# -- scenes -----------------------------------------------------------------------------------------------------------

SCENE = """
about = "A blink of an opening"
duration_s = 0.02
[face]
resolution = "low"
[output]
frame_rate = 100
[camera]
width_px = 64
height_px = 48
[[saliva.patch]]
from_m = 0.0
stickiness = 9
[[muscle]]
name = "jaw"
keys = [[0.0, 0.0], [0.02, 0.1]]
"""


@pytest.fixture
def scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "blink.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture
def simulate(capsys):
    """Run `simulate ARGUMENTS`; returns exit code, stdout and stderr."""

    def simulate(*arguments):
        try:
            code = cli.main([*map(str, arguments)])
        except SystemExit as stop:
            code = stop.code
        return code, *capsys.readouterr()

    return simulate


def test_a_scene_to_its_files(simulate, scene, tmp_path):
    code, out, err = simulate("blink.toml", "--truth-only", "--threads", "1")
    assert (code, err) == (0, "")
    assert out.startswith("blink: 3 frames, stickiness 7, ") and out.count("\n") == 1
    files = {path.name for path in (tmp_path / "blink").iterdir()}
    assert {"blink.scene.toml", "blink.h5", "blink.frames.csv", "blink.clip.json"} < files
    assert not any(name.startswith(".") or "checkpoint" in name for name in files)
    motion = load_motion(tmp_path / "blink" / "blink.h5")
    np.testing.assert_allclose(motion.time_s, [0, 0.01, 0.02], atol=1e-12)
    assert motion.saliva.state.shape == (3, 30)


def test_choices_reach_the_scene_and_every_level_has_its_clip(simulate, scene, tmp_path):
    words = ("--stickiness", "0,7.5", "--frame-rate", "50", "--size", "80x60", "--seed", "5", "--dt", "4e-5")
    code, out, _ = simulate(scene, "--truth-only", "-o", tmp_path / "out", *words, "--precision", "float64", "--json")
    summary = json.loads(out)
    assert code == 0 and summary["models"] == summary["failed"] == []
    assert [one["name"] for one in summary["clips"]] == ["blink_0", "blink_7.5"]
    assert [one["frames"] for one in summary["clips"]] == [2, 2]
    assert all(Path(name).exists() for one in summary["clips"] for name in one["files"])
    used = load_scene(tmp_path / "out" / "blink_7.5.scene.toml")
    assert (used.saliva.stickiness, used.output.frame_rate, used.seed) == (7.5, 50, 5)
    assert used.saliva.patch[0].stickiness == pytest.approx(9 * 7.5 / 7)
    assert (used.camera.width_px, used.camera.height_px) == (80, 60)
    assert (used.solve.dt_s, used.solve.precision) == (4e-5, "float64")
    again, _, _ = simulate(tmp_path / "out" / "blink_7.5.scene.toml", "--truth-only", "-o", tmp_path / "again")
    first, second = ((tmp_path / name / "blink_7.5.h5").read_bytes() for name in ("out", "again"))
    assert again == 0 and first == second


def test_every_face_at_every_level_has_its_clip(simulate, scene, tmp_path):
    words = ("--face", "thin_lips,child", "--stickiness", "0,7", "--frame-rate", "50", "--truth-only", "--json")
    code, out, _ = simulate(scene, "-o", tmp_path / "out", *words)
    names = [one["name"] for one in json.loads(out)["clips"]]
    assert code == 0
    assert names == ["thin-lips_blink_0", "thin-lips_blink_7", "child_blink_0", "child_blink_7"]
    face = load_scene(tmp_path / "out" / "child_blink_0.scene.toml").face
    assert (face.preset, face.resolution) == ("child", "low")


def test_scenes_among_models_and_bad_ones(simulate, scene, model, tmp_path):
    (tmp_path / "bad.toml").write_text("duration = 1")
    code, out, err = simulate("bad.toml", scene, model, "--threads", "1", "-o", tmp_path / "out", "--truth-only")
    assert code == 3 and "2 of 3 clips made" in out
    assert err == "simulate: bad.toml: expected a known key, got 'duration'; did you mean 'duration_s'?\n"
    assert (tmp_path / "out" / "cube.h5").exists() and (tmp_path / "out" / "blink.h5").exists()
    code, out, _ = simulate("bad.toml", "none.toml", "--json")
    assert code == 2 and [one["source"] for one in json.loads(out)["failed"]] == ["bad.toml", "none.toml"]
    assert not (tmp_path / "bad").exists()


def test_a_scene_that_blows_up_keeps_what_it_has(simulate, scene, tmp_path):
    scene.write_text(SCENE.replace("0.02", "0.2"))
    code, out, err = simulate(scene, "--dt", "0.002", "--truth-only")
    assert code == 3 and out == "" and err.count("\n") == 1
    assert "stopped at" in err and "the states before are kept in blink/blink.unfinished.h5" in err
    assert load_motion(tmp_path / "blink" / "blink.unfinished.h5").stopped is not None
    assert not (tmp_path / "blink" / "blink.h5").exists()


def test_the_built_in_scenes_are_listed_and_printed(simulate, tmp_path):
    code, out, _ = simulate("--list")
    assert code == 0 and len(out.splitlines()) == len(scene_names()) == 15
    assert "slow_open        The mouth opens slowly and wide" in out
    assert set(json.loads(simulate("--list", "--json")[1])["scenes"]) == set(scene_names())
    code, out, _ = simulate("--print", "mummy")
    assert code == 0 and out == scene_text("mummy")
    (tmp_path / "mummy.toml").write_text(out)
    assert load_scene(tmp_path / "mummy.toml") == load_scene("mummy")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["slow_opne"], "got 'slow_opne'; did you mean 'slow_open'?"),
        (["--print", "slow_opne"], "expected a built-in scene of demo, double_opening, "),
        (["none.toml"], "none.toml: No such file"),
        (["m", "--face", "wyde"], "m: expected a face of"),
        (["m", "--stickiness", "x"], "expected levels from 0 to 10 such as 7 or 0,4,7,10, got 'x'"),
        (["m", "--stickiness", "-3"], "expected"),
        (["m", "--stickiness", "1e9"], "m: expected a stickiness from 0 to 10"),
        (["m", "--size", "640"], "expected a size in px such as 640x480, got '640'"),
        (["m", "--size", "100000x10"], "expected width_px as a whole number from 16 to 8192, got 100000"),
        (["m", "--seed", "-1"], "expected a whole number of 0 or more, got '-1'"),
        (["m", "--export", "obj,gtlf"], "expected exports of obj, pc2, gltf or vtu, got 'gtlf'; did you mean 'gltf'?"),
        (["m", "--frame-rate", "1e6"], "expected frame_rate from 1 to 10000 per second, got 1e+06"),
        (["m", "--frame-rate", "nan"], "expected a number above 0, got 'nan'"),
        (["m", "--resolution", "huge"], "invalid choice: 'huge'"),
        (["m", "m"], "got 2 named 'm'"),
        (["m", "--vtu"], "expected models to go with --vtu, got a scene: m; use --export vtu"),
        (["cube.xml", "-o", "out", "--truth-only"], "expected scenes to go with --truth-only, got a model: cube.xml"),
        (["cube.xml"], "the following arguments are required: -o/--out"),
        (["m", "--resume"], "m: expected the checkpoint of an interrupted run in m/m.checkpoint.npz, got no such file"),
    ],
)
def test_bad_arguments_of_scenes_are_one_line(simulate, model, monkeypatch, arguments, message):
    monkeypatch.chdir(model.parent)
    code, out, err = simulate(*arguments)
    assert code == 2 and out == "" and message in err and err.count("\n") == 1


def test_only_xml_is_taken_for_a_model(tmp_path):
    for name, text, is_model in (
        ("a.xml", "", True),
        ("b.toml", "<Model>", False),
        ("c", "\ufeff \n<Model>", True),
        ("d", "duration_s = 1", False),
    ):
        (tmp_path / name).write_text(text, encoding="utf-8")
        assert cli._is_model(str(tmp_path / name)) is is_model
    assert cli._is_model("none.xml") and not cli._is_model("slow_open")


def test_choices_of_the_command_line_are_those_of_the_modules():
    from simulator import clip, mouth

    assert tuple(mouth.RESOLUTIONS) == cli.RESOLUTIONS and clip.EXPORTS == cli.EXPORTS


def test_the_verbs_are_not_hidden_by_their_modules():
    code = (
        "import simulator.render, simulator.simulate, simulator.truth, simulator; from simulator import render; "
        "assert callable(simulator.simulate) and callable(simulator.truth) and callable(render)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_lipmetrics_lists_the_commands_of_the_simulator(tmp_path, capsys):
    with pytest.raises(SystemExit):
        lipmetrics(["--help"])
    out = capsys.readouterr().out
    assert "ground-truth clips of sticky mouths" in out and "replay a simulated clip" in out
    assert lipmetrics(["view", str(tmp_path), "--no-browser"]) == 2
    assert "expected a page" in capsys.readouterr().err
