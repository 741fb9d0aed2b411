import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import simulator
from lipmetrics.cli import main as lipmetrics
from simulator import assembly, checkpoint, cli
from simulator.export import load_motion

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
