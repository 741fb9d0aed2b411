"""docs/protocol.md: its commands are run as printed, on a small recording, a small corpus, and GRID's clips."""

import csv
import os
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from corpus_tools import cli as corpus_cli
from corpus_tools.protocol import load_protocol
from corpus_tools.store import Store
from lipmetrics.cli import main
from simulator import cli as simulator_cli

PAGE = Path(__file__).parents[1] / "docs" / "protocol.md"
TEXT = PAGE.read_text(encoding="utf-8")
COMMANDS = [line.strip() for line in TEXT.splitlines() if line.startswith("    lipmetrics ")]
COMMANDS += re.findall(r"`(lipmetrics [^`]+)`", TEXT)
GRID = {  # the reference clips; pwij3p and swwp2s are one speaker's, of the others no speaker is noted
    "grid_bbaf2n.mpg": "s101/bbaf2n.mpg",
    "grid_lbax4n.mpg": "s102/lbax4n.mpg",
    "grid_lrwp9a.mpg": "s103/lrwp9a.mpg",
    "grid_pwij3p.mpg": "s2/pwij3p.mpg",
    "grid_sbia1a.mpg": "s104/sbia1a.mpg",
    "grid_id2.mpg": "s2/swwp2s.mpg",
}


def words_of(command):
    return shlex.split(command)[1:]


def run(part, capsys):
    """Run the commands of the page that have this word, in order; gives them and what they wrote on stderr."""
    found = [one for one in COMMANDS[: COMMANDS.index(END) + 1] if re.search(rf"(^|[ /]){part}\b", one)]
    said = []
    for command in found:
        code = main(words_of(command))
        said.append(capsys.readouterr().err)
        assert code == 0, (command, said[-1])
    return found, said


END = next(line for line in COMMANDS if "grid_report" in line)


def test_every_command_can_be_read():
    assert len(COMMANDS) > 15
    for command in COMMANDS:
        verb, *words = words_of(command)
        if verb == "simulate":
            simulator_cli._parser("simulate").parse_args(words)
        else:
            assert verb == "corpus"
            corpus_cli._parser("corpus").parse_args(words)


def test_links_lead_somewhere():
    for link in re.findall(r"\]\(([^)#]+)", TEXT):
        assert (PAGE.parent / link).exists(), link


def test_the_numbers_of_the_protocol():
    protocol = load_protocol()
    assert len(protocol.utterances) == 22 and protocol.repetitions_n == 5 and protocol.interval_s == 10
    assert 20 * 60 < protocol.length_s <= 21 * 60 and "22 actions and utterances, 5 repetitions 10 s apart" in TEXT


def draw_take(path):
    """A take of 12 s with two movements, 25 small pictures per second; the second begins 4 s after the first."""
    from moved_mouth import moved_mouth

    from simulator.camera import Camera
    from simulator.render import render
    from simulator.video import write_video

    mouth, motion = moved_mouth("low", 12)[:2]
    frames = list(render(motion, mouth, Camera(width_px=160, height_px=120)))
    moving = [*frames, *frames[::-1]]
    still = [frames[0]]
    seconds = 25
    take = still * (5 * seconds) + moving + still * (3 * seconds) + moving
    take += still * (12 * seconds - len(take))
    write_video(path, take, 25, "h264")


@pytest.mark.slow
def test_with_a_recording(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    draw_take(Path("p01.mov"))
    first = COMMANDS.index("lipmetrics corpus protocol -o sheet --speaker p01")
    commands = COMMANDS[first : first + 5]
    assert [words_of(one)[1] for one in commands] == ["protocol", "segment", "index", "run", "average"]
    assert main(words_of(commands[0])) == 0
    with open("sheet/p01.cuts.csv", newline="") as file:
        planned = list(csv.DictReader(file))
    assert len(planned) == 110
    for row, start_s in zip(planned, (1.3, 5.3), strict=False):  # the page of a short session
        row |= {"start_s": start_s, "stop_s": start_s + 3}
    with open("p01.cuts.csv", "w", newline="") as file:
        table = csv.DictWriter(file, planned[0])
        table.writeheader()
        table.writerows(planned[:2])
    assert main(words_of(commands[1])) == 0
    names = ["p01_open-slow_1", "p01_open-slow_2"]
    assert [path.stem for path in sorted(Path("clips").glob("*.mov"))] == names
    capsys.readouterr()
    assert main(words_of(commands[2])) == 3
    err = capsys.readouterr().err
    assert "missing: 108" in err and "p01_open-slow_3" in err
    assert main(words_of(commands[3])) == 0
    assert main(words_of(commands[4])) == 0
    with Store("corpus.h5") as store:
        assert store.names == names and not store.failed
        assert (store.profile(names[0]).frames["status"] == "open").any()
    summary = pd.read_csv("report/summary.csv")
    assert summary["clips_n"].tolist() == [2] and summary["utterance"].tolist() == ["open-slow"]


@pytest.mark.slow
def test_with_a_small_simulated_corpus(tmp_path, monkeypatch, capsys):
    """The walk as printed; levels come out in their order from the videos alone."""
    monkeypatch.chdir(tmp_path)
    commands, said = run("small", capsys)
    assert len(commands) == 4 and not any(said)
    table = pd.read_csv("small/report/summary.csv").set_index(["action", "stickiness"])
    assert table["speakers_n"].tolist() == [2] * 4
    for action in ("m", "slow-open"):
        free, sticky = table.loc[(action, 0)], table.loc[(action, 10)]
        assert sticky["onset_s"] > free["onset_s"]
        assert sticky["peak_area"] < free["peak_area"] and sticky["peak_width"] < free["peak_width"]
    assert "<img" in Path("small/report/report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_with_the_clips_of_grid(tmp_path, monkeypatch, capsys):
    folder = Path(os.environ.get("LIPMETRICS_REFERENCE", PAGE.parents[2] / "shared" / "reference")) / "real" / "videos"
    if not all((folder / name).is_file() for name in GRID):
        pytest.skip("reference data absent; set LIPMETRICS_REFERENCE or put them in ../shared/reference")
    monkeypatch.chdir(tmp_path)
    for name, place in GRID.items():
        Path("grid", place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(folder / name, Path("grid", place))
    commands, said = run("grid", capsys)
    assert [words_of(one)[1] for one in commands] == ["index", "run", "average"] and not any(said)
    index = pd.read_csv("grid.csv")
    assert index["frames_n"].tolist() == [75] * 6 and index["fps"].tolist() == [25] * 6
    with Store("grid.h5") as store:
        assert len(store.names) == 6 and not store.failed
        assert all((store.profile(name).frames["status"] == "open").mean() > 0.2 for name in store.names)
    summary = pd.read_csv("grid_report/summary.csv").set_index("command")
    assert summary["clips_n"].to_dict() == {"bin": 1, "lay": 2, "place": 1, "set": 2}
    assert summary["speakers_n"].to_dict() == {"bin": 1, "lay": 2, "place": 1, "set": 2}
    assert np.isfinite(summary["peak_height"]).all()
