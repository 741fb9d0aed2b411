"""The command `lipmetrics corpus`: what each verb writes, says, calls and refuses."""

import json
import subprocess
import sys
import types

import pytest

from corpus_tools import cli
from corpus_tools.protocol import load_protocol, protocol_text
from corpus_tools.readers import READERS
from lipmetrics.cli import main


def test_protocol(tmp_path, capsys):
    folder = tmp_path / "sheet"
    assert main(["corpus", "protocol", "-o", str(folder), "--speaker", "p01", "p02"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "22 utterances x 5, 110 clips a speaker, 21 minutes"
    files = ["protocol.toml", "sheet.html", "prompt.html", "p01.cuts.csv", "p02.cuts.csv"]
    assert lines[1:] == [str(folder / name) for name in files]
    assert sorted(path.name for path in folder.iterdir()) == sorted(files)
    assert main(["corpus", "protocol", "--print"]) == 0
    assert capsys.readouterr().out.rstrip("\n") == protocol_text().rstrip("\n")
    changed = tmp_path / "mine.toml"
    changed.write_text(protocol_text().replace("repetitions_n = 5", "repetitions_n = 2"))
    assert main(["corpus", "protocol", str(changed), "-o", str(folder), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["command"] == "corpus protocol" and answer["clips_n"] == 44
    assert (folder / "protocol.toml").read_text() == changed.read_text() and load_protocol(folder / "protocol.toml")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["protocol"], "lipmetrics: expected -o DIR for the sheet and the prompt page, or --print, got neither"),
        (["protocol", "gone.toml", "--print"], "lipmetrics: expected a protocol in TOML, got gone.toml: No such file"),
        (["protocol", "-o", "{tmp}/file"], "expected an output folder to write to, got"),
        (["protocol", "-o", "{tmp}/x", "--speaker", "a_b"], "expected speaker as text without _ or /, got 'a_b'"),
        (["index", "{tmp}/gone", "-o", "t.csv"], "expected a folder with a corpus, got"),
        (["run", "{tmp}", "-o", "s.h5", "--template", "{a}{b}"], "a template that reads every name in one way"),
        (["run", "{tmp}", "-o", "s.h5"], "expected names of the form {speaker}_{utterance}_{repeat:d} in"),
    ],
)
def test_bad_input_is_one_sentence(tmp_path, capsys, monkeypatch, words, sentence):
    (tmp_path / "file").touch()
    for module in ("index", "batch"):
        hook(monkeypatch, module, "index" if module == "index" else "run", [])
    assert main(["corpus", *(word.replace("{tmp}", str(tmp_path)) for word in words)]) == 2
    said = capsys.readouterr()
    assert sentence in said.err and said.err.count("\n") == 1 and said.out == ""


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ([], "lipmetrics corpus: the following arguments are required: COMMAND"),
        (["gather"], "invalid choice: 'gather'"),
        (["run", "x", "-o", "s.h5", "--jobs", "0"], "expected a whole number of at least 1, got '0'"),
        (["run", "x", "-o", "s.h5", "--corpus", "grid", "--template", "{a}"], "not allowed with argument --corpus"),
        (["segment", "x.mov", "-o", "d", "--mark", "-1"], "expected a time of 0 s or more, got '-1'"),
        (["index", "x", "-o", "t.csv", "--fps", "nan"], "expected a number above 0, got 'nan'"),
    ],
)
def test_bad_arguments_are_one_sentence(capsys, words, sentence):
    with pytest.raises(SystemExit) as end:
        main(["corpus", *words])
    said = capsys.readouterr().err
    assert end.value.code == 2 and sentence in said and said.count("\n") == 1


def hook(monkeypatch, module, name, calls, answer=None):
    """Put a recorder in the place of the function that a verb calls."""

    def recorder(*given, **named):
        calls.append((given, named))
        return dict(answer or {"text": ["well"]})

    monkeypatch.setitem(sys.modules, f"corpus_tools.{module}", types.SimpleNamespace(**{name: recorder}))


def corpus(tmp_path, *names):
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    return str(tmp_path)


def test_index_expects_all_clips_of_everyone_who_is_there(tmp_path, monkeypatch, capsys):
    calls = []
    hook(monkeypatch, "index", "index", calls)
    folder = corpus(tmp_path, "p01_m_1.mp4", "p02_m_1.mp4", "odd.mp4")
    assert main(["corpus", "index", folder, "-o", "t.csv"]) == 0
    (clips, out), named = calls.pop()
    assert [clip.name for clip in clips] == ["p01_m_1", "p02_m_1"] and out == "t.csv"
    assert named["expected"] == load_protocol().names(["p01", "p02"]) and named["clip_s"] == 3
    assert [path.name for path, _ in named["misfits"]] == ["odd.mp4"]
    assert main(["corpus", "index", folder, "-o", "t.csv", "--speaker", "p03"]) == 0
    assert calls.pop()[1]["expected"] == load_protocol().names(["p03"])
    assert main(["corpus", "index", folder, "-o", "t.csv", "--template", "{who}_m_{n:d}"]) == 0
    assert calls.pop()[1]["expected"] is None
    assert capsys.readouterr().out == "well\n" * 3


def test_run_and_slices(tmp_path, monkeypatch, capsys):
    calls = []
    hook(monkeypatch, "batch", "run", calls)
    folder = corpus(tmp_path, "s1/bbaf2n.mpg", "s1/bbaf2n.align", "s1/odd.mpg")
    (tmp_path / "s1/bbaf2n.align").write_text("23750 29500 bin\n29500 34000 blue\n")
    assert main(["corpus", "run", folder, "-o", "s.h5", "--corpus", "grid", "--jobs", "2", "--method", "thesis"]) == 0
    (clips, store), named = calls.pop()
    assert [clip.name for clip in clips] == ["s1_bbaf2n"] and store == "s.h5"
    assert (named["jobs"], named["dask"], named["method"]) == (2, None, "thesis")
    assert "lipmetrics: left out" in capsys.readouterr().err
    words = ["--corpus", "grid", "--slices", "words", "--margin", "0.1", "--dask", "tcp://x:1"]
    assert main(["corpus", "run", folder, "-o", "s.h5", *words]) == 0
    (clips, _), named = calls.pop()
    assert [clip.name for clip in clips] == ["s1_bbaf2n-01-bin", "s1_bbaf2n-02-blue"] and named["dask"] == "tcp://x:1"
    assert clips[0].start_s == pytest.approx(0.85)
    assert main(["corpus", "run", folder, "-o", "s.h5", "--corpus", "grid", "--slices", "phones"]) == 2
    assert "expected s1_bbaf2n to have the tier phones, got 'phones'; it has words" in capsys.readouterr().err
    corpus(tmp_path, "s1/lbax4n.mpg")
    assert main(["corpus", "run", folder, "-o", "s.h5", "--corpus", "grid", "--slices", "words"]) == 0
    assert "expected s1_lbax4n to have the tier words, got a clip without words" in capsys.readouterr().err
    assert set(cli.CORPORA) == set(READERS)


@pytest.mark.parametrize(("done_n", "code"), [(1, 3), (0, 2)])
def test_what_failed_is_told(tmp_path, monkeypatch, capsys, done_n, code):
    failed = [{"source": "a.mp4", "error": "expected a video"}]
    hook(monkeypatch, "report", "write_report", [], {"failed": failed, "done_n": done_n, "text": ["x"]})
    assert main(["corpus", "average", "s.h5", "-o", str(tmp_path), "--json"]) == code
    said = capsys.readouterr()
    assert said.err == "lipmetrics: a.mp4: expected a video\n" and json.loads(said.out)["failed"] == failed


def test_segment(tmp_path, monkeypatch):
    calls = []
    hook(monkeypatch, "segment", "segment", calls)
    out = str(tmp_path / "clips")
    assert main(["corpus", "segment", "p01.mov", "-o", out, "--cuts", "p01.cuts.csv", "--mark", "12.4"]) == 0
    (given, named) = calls.pop()
    assert given == ("p01.mov", out) and named["cuts"] == "p01.cuts.csv" and named["mark_s"] == 12.4
    assert named["protocol"] == load_protocol() and named["speaker"] is None and named["overwrite"] is False


def test_help_is_light():
    """Neither numba nor pandas nor the simulator for a page of help."""
    script = (
        "import sys; from lipmetrics.cli import main\n"
        "try: main(['corpus', '--help'])\nexcept SystemExit: pass\n"
        "print(sorted({'numba', 'pandas', 'numpy', 'h5py', 'av', 'simulator'} & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == "[]" and "protocol" in run.stdout
