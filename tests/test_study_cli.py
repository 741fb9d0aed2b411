"""The commands design, serve and export, as they are typed."""

import json
import socket
import subprocess
import sys
from pathlib import Path

import av
import numpy as np
import pandas as pd
import pytest
from study_client import ServerProcess, Visitor, write_bytes_as_videos

from lipmetrics.cli import main as lipmetrics
from study.cli import main
from study.design import load_design, stimuli_from_folder
from study.errors import InputError
from study.videos import check_videos


def write_video(path, seconds=0.4, size=(64, 48), codec="libx264", pixels="yuv420p"):
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = *size, pixels
        for i in range(round(25 * seconds)):
            picture = np.full((size[1], size[0], 3), 10 * i % 250, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture)))
        container.mux(stream.encode())


@pytest.fixture
def clips(tmp_path):
    folder = tmp_path / "clips"
    folder.mkdir()
    for name in ("p_0", "p_4", "p_10"):
        write_video(folder / f"{name}.mp4")
    return folder


def test_design_serve_export(clips, tmp_path, capsys):
    pytest.importorskip("uvicorn", reason="the extra web is not installed")
    folder = tmp_path / "study"
    words = ["design", str(clips), "-o", str(folder), "--participants", "2", "--catch", "1", "--seed", "5"]
    assert lipmetrics(["study", *words]) == 0
    out, err = capsys.readouterr()
    assert "3 pairs of 3 videos; 2 participants of 4 trials" in out and f"study serve {folder}" in out and err == ""
    names = {path.name for path in folder.iterdir()}
    assert names == {
        "design.json",
        "design.csv",
        "study.toml",
        *("consent.md", "instructions.md", "thanks.md", "videos"),
    }
    assert (folder / "videos" / "p_4.mp4").read_bytes() == (clips / "p_4.mp4").read_bytes()
    design = load_design(folder)
    assert design.seed == 5 and design.stimulus("p_4").file == "videos/p_4.mp4"
    assert main(["export", str(folder), "-o", str(tmp_path / "a.csv")]) == 2
    assert "there is no such file; 'lipmetrics study serve' makes it" in capsys.readouterr().err
    server = ServerProcess(folder)
    visitor = Visitor(server.port).begin()
    for trial in range(1, 5):
        visitor.answer(trial, "left")
    server.stop()
    assert (
        main(["export", str(folder), "-o", str(tmp_path / "a.csv"), "--ids", str(tmp_path / "ids.csv"), "--json"]) == 0
    )
    said = json.loads(capsys.readouterr().out)
    assert (said["answers"], said["done"], said["active"], said["withdrawn"]) == (4, 1, 0, 0)
    table = pd.read_csv(tmp_path / "a.csv")
    assert (table["chosen"] == table["left"]).all() and len(table) == 4
    assert main([*words[:-1], "6"]) == 2
    assert "expected a folder without a design" in capsys.readouterr().err
    assert main([*words[:-1], "6", "--overwrite"]) == 0 and load_design(folder).seed == 6
    capsys.readouterr()
    assert main(["export", str(folder)]) == 2
    assert "expected answers to design" in capsys.readouterr().err


def test_codes_and_same_bytes(tmp_path, capsys):
    for name in ("one", "two"):
        assert main(["design", "os0", "os4", "os10", "-o", str(tmp_path / name), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["pairs"] == 3
    one, two = (load_design(tmp_path / name) for name in ("one", "two"))
    assert one == two
    for file in ("design.json", "design.csv", "study.toml"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()
    pytest.importorskip("starlette", reason="the extra web is not installed")
    assert main(["serve", str(tmp_path / "one")]) == 2
    assert "got the bare code os0; make the design of a folder of videos" in capsys.readouterr().err


def test_a_table_of_videos(clips, tmp_path):
    table = tmp_path / "videos.csv"
    table.write_text("stimulus,action,level,speed,file\na,p,0,fast,clips/p_0.mp4\nb,p,4,fast,clips/p_4.mp4\n")
    assert main(["design", "--stimuli", str(table), "-o", str(tmp_path / "s"), "--participants", "2"]) == 0
    assert (tmp_path / "s" / "videos" / "b.mp4").exists() and load_design(tmp_path / "s").stimuli[0].speed == "fast"
    videos = [str(clips / f"p_{level}.mp4") for level in (0, 4)]
    assert main(["design", *videos, "-o", str(tmp_path / "t"), "--participants", "2"]) == 0
    assert [one.code for one in load_design(tmp_path / "t").stimuli] == ["p_0", "p_4"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["design", "-o", "x"], "expected a folder of videos, videos, or codes"),
        (["design", "a0", "--stimuli", "b.csv", "-o", "x"], "either VIDEOS or --stimuli, got both: a0 and b.csv"),
        (["design", "gone/", "-o", "x"], "expected a folder of videos, got gone"),
        (["design", "a0", "a1", "-o", "x", "--pairs", "chian"], "got 'chian'; did you mean 'chain'?"),
        (["design", "a0", "a1"], "the following arguments are required: -o/--out"),
        (["design", "a0", "a1", "-o", "x", "--participants", "0"], "expected a whole number of at least 1, got '0'"),
        (["serve", "gone"], "expected a design at gone"),
        (["serve", "gone", "--port", "99999"], "expected a port from 0 to 65535, got '99999'"),
        (["export", "gone"], "expected a design at gone"),
        (["desing"], "invalid choice: 'desing'"),
        ([], "the following arguments are required: COMMAND"),
    ],
)
def test_bad_words(words, said, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    if words[:1] == ["serve"]:
        pytest.importorskip("uvicorn", reason="the extra web is not installed")
    try:
        code = main(words)
    except SystemExit as stop:
        code = stop.code
    out, err = capsys.readouterr()
    assert code == 2 and out == "" and err.count("\n") == 1 and said in err
    assert not any(tmp_path.iterdir())


def test_a_port_that_is_taken(clips, tmp_path, capsys):
    pytest.importorskip("uvicorn", reason="the extra web is not installed")
    main(["design", str(clips), "-o", str(tmp_path / "s")])
    with socket.create_server(("127.0.0.1", 0)) as other:
        assert main(["serve", str(tmp_path / "s"), "--port", str(other.getsockname()[1])]) == 2
    assert "Address already in use; choose another --port" in capsys.readouterr().err


def test_warnings_about_videos(clips):
    write_video(clips / "p_4.mp4", seconds=0.8)
    write_video(clips / "p_10.mp4", size=(96, 48))
    write_video(clips / "q_0.mp4", pixels="yuv444p")
    write_video(clips / "q_4.mp4", codec="mpeg4")
    stimuli = stimuli_from_folder(clips)
    said = check_videos(stimuli, [("p_0", "p_4"), ("p_0", "p_10"), ("q_0", "q_4")])
    assert said == [
        "q_0: not every browser plays pixels of yuv444p; make them yuv420p",
        "q_4: not every browser plays mpeg4; make it H.264 in .mp4",
        "p_0 and p_4: are shown together, and last 0.40 and 0.80 s",
        "p_0 and p_10: are shown together, and measure 64 x 48 and 96 x 48 px",
    ]
    write_bytes_as_videos(clips, ["p_7"])
    with pytest.raises(InputError, match=r"expected a video in .*p_7\.mp4, but"):
        check_videos(stimuli_from_folder(clips), [])


def test_help_needs_neither_the_server_nor_pandas():
    program = (
        "import sys; from lipmetrics.cli import main\n"
        "try: main(['study', '--help'])\n"
        "except SystemExit: pass\n"
        "assert not {'pandas', 'starlette', 'numpy'} & set(sys.modules), sys.modules"
    )
    root = Path(__file__).parents[1]
    done = subprocess.run([sys.executable, "-c", program], cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "design" in done.stdout, done.stderr
