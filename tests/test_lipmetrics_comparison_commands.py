import json
import re
from html.parser import HTMLParser

import cv2
import numpy as np
import pandas as pd
import pytest
from moving_takes import write_table

from lipmetrics import cli, curve_figures

NAMES = ("--names", "{speaker}_{utterance}_{repeat}")


@pytest.fixture
def folder(tmp_path):
    """Three speakers with two repeats of two utterances, and two models."""
    for s, speaker in enumerate("abc"):
        for u, utterance in enumerate(("mm", "oh")):
            for repeat in (1, 2):
                shape = {"high": 0.3 + 0.2 * u + 0.02 * s + 0.005 * repeat, "late_s": 0.02 * s}
                write_table(tmp_path / f"real/{speaker}_{utterance}_{repeat}.csv", **shape)
    for u, utterance in enumerate(("mm", "oh")):
        write_table(tmp_path / f"near/x_{utterance}_1.csv", high=0.33 + 0.2 * u, late_s=0.02, rate_hz=30)
        write_table(tmp_path / f"far/x_{utterance}_1.csv", high=0.6 + 0.2 * u, late_s=0.16, rate_hz=60)
    return tmp_path


@pytest.fixture
def drawn():
    """Asked for by tests that look at figures; the others go without, as figures take most of the time."""


@pytest.fixture(autouse=True)
def figures(request, monkeypatch):
    if "drawn" not in request.fixturenames:
        monkeypatch.setattr(curve_figures, "_png", lambda draw, size: b"a figure")


@pytest.fixture
def run(folder, capsys, monkeypatch):
    """Run `lipmetrics ARGUMENTS` in the folder; returns exit code, stdout and stderr."""
    monkeypatch.chdir(folder)

    def run(*arguments):
        code = cli.main([str(argument) for argument in arguments])
        return code, *capsys.readouterr()

    return run


class Page(HTMLParser):
    """What a page refers to, its words, and whether its tags are in order."""

    def __init__(self, text: str):
        super().__init__()
        self.sources, self.words, self.open = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.sources += [value for name, value in attributes if name in ("src", "href")]
        if tag not in ("img", "meta", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def page_of(path):
    page = Page(path.read_text(encoding="utf-8"))
    assert page.open == []
    assert page.sources and all(source.startswith("data:image/png;base64,") for source in page.sources)
    return page, " ".join(page.words)


def test_a_folder_is_scored_against_a_folder(run, folder, drawn):
    code, out, err = run("score", "near", "--reference", "real", *NAMES, "-o", "out", "--draws", 50)
    assert (code, err) == (0, "")
    assert "near: L2 width" in out and "percentile" in out
    record = json.loads((folder / "out/score.json").read_text())
    row = next(r for r in record["overall"] if r["metric"] == "l2_height_v1")
    assert (row["clips_n"], row["utterances_n"], row["pairs_n"], row["known_n"]) == (2, 2, 12, 12)
    assert row["percentile_speakers"] < 60 and row["ratio_repeats"] > 1
    assert record["primary_floor"] == "speakers"
    assert len(record["floor_values"]["mm"]["l2_height_v1"]["speakers"]) == 6
    table = pd.read_csv(folder / "out/score.csv")
    assert set(table["take"]) == {"x_mm_1", "x_oh_1"}
    assert {"l2_height_v1", "l2_aligned_height_v1", "lag_v1", "warp_v1", "peak_height_v1"} <= set(table["metric"])
    page, words = page_of(folder / "out/report.html")
    assert len(page.sources) == 5  # floors, curves, path, aligned curves, phases
    assert "A closer look" in words and "2 utterances of 3 speakers" in words


def test_two_models_are_compared(run, folder):
    models = ("--model", "near=near", "--model", "far & wide=far")
    code, out, _ = run("score", *models, "--reference", "real", *NAMES, "-o", "out", "--draws", 50, "--json")
    found = json.loads(out)
    assert code == 0 and list(found["models"]) == ["near", "far & wide"]
    one = next(row for row in found["comparisons"] if row["metric"] == "l2_height_v1")
    assert one["difference"] < 0 and one["first_nearer"] == 2
    lag = {row["model"]: row for row in found["overall"] if row["metric"] == "lag_v1"}
    assert lag["far & wide"]["bias"] > 0.1 > abs(lag["near"]["bias"])
    rows = [line for line in (folder / "out/score.tex").read_text().splitlines() if not line.startswith("%")]
    assert rows[1].startswith(r"far \& wide & ") and all(row.endswith(r" \\") for row in rows)
    assert "Models against each other" in page_of(folder / "out/report.html")[1]


def test_a_list_tells_all(run, folder):
    rows = ["path,utterance,speaker,repeat,group"]
    for path in sorted(folder.glob("*/*.csv")):
        speaker, utterance, repeat = path.stem.split("_")
        group = "real" if path.parent.name == "real" else path.parent.name
        rows.append(f"{path.parent.name}/{path.name},{utterance},{speaker},{repeat},{group}")
    (folder / "list.csv").write_text("\n".join(rows))
    code, out, _ = run("score", "--list", "list.csv", "-o", "out", "--draws", 20, "--json")
    listed = json.loads(out)
    assert code == 0 and set(listed["models"]) == {"near", "far"}
    models = ("--model", "far=far", "--model", "near=near")
    named = json.loads(run("score", *models, "--reference", "real", *NAMES, "--draws", 20, "--json")[1])
    assert listed["overall"] == named["overall"]


def test_without_labels_all_takes_are_one_utterance(run):
    code, out, _ = run(
        "score", "near/x_mm_1.csv", "--reference", "real/a_mm_1.csv", "real/b_mm_1.csv", "-o", "out", "--draws", 20
    )
    assert code == 0
    assert "all takes count as one utterance" in out and "Not every speaker is known" in out


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes(run, folder):
    words = ("score", "near", "--reference", "real", *NAMES, "--draws", 20)
    for out in ("one", "two"):
        run(*words, "-o", out, "--seed", 3)
    run(*words, "-o", "three", "--seed", 4)
    for name in ("score.json", "score.csv", "score.tex", "report.html"):
        assert (folder / "one" / name).read_bytes() == (folder / "two" / name).read_bytes()
    assert (folder / "one/score.json").read_bytes() != (folder / "three/score.json").read_bytes()


def test_bad_takes_are_passed_over(run, folder):
    (folder / "real/d_mm_1.csv").write_text("time_s,width_mw,height_mw,area_mw2\n0,oops,1,1\n")
    write_table(folder / "real/loose.csv")
    write_table(folder / "near/x_eh_1.csv")
    code, out, err = run("score", "near", "--reference", "real", *NAMES, "-o", "out", "--draws", 20, "--json")
    assert code == cli.SOME_FAILED
    failed = json.loads(out)["failed"]
    assert {path.split("/")[1] for path in failed} == {"d_mm_1.csv", "loose.csv", "x_eh_1.csv"}
    assert err.count("passed over") == 3 and "Traceback" not in err
    assert "Passed over" in page_of(folder / "out/report.html")[1]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("score", "near"), "expected real takes after --reference"),
        (("score", "--reference", "real"), "expected a model's takes in front of --reference"),
        (("score", "near", "--reference", "rael"), "did you mean real"),
        (("score", "near", "--reference", "real", "--names", "{speker}_{utterance}"), "did you mean {speaker}"),
        (("score", "near", "--reference", "real", *NAMES, "--channels", "depth"), "got 'depth'"),
        (("score", "near", "--reference", "real", *NAMES, "--cost", "squarred"), "did you mean 'squared'"),
        (("score", "near", "--reference", "real", "--list", "none.csv"), "no such file"),
        (("compare", "near/x_mm_1.csv", "near/x_mm_2.csv"), "did you mean x_mm_1.csv"),
        (("compare", "near", "far/x_mm_1.csv"), "expected one take in near"),
        (("average", "none", "-o", "out/mm"), "none"),
    ],
)
def test_bad_words_are_a_sentence_and_code_2(run, words, sentence):
    code, out, err = run(*words)
    assert (code, out) == (cli.BAD_INPUT, "")
    assert sentence in err and "Traceback" not in err


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("score", "--model", "near", "--reference", "real"), "expected NAME=PATH"),
        (("score", "near", "--reference", "real", "--band", "2"), "a share from 0 to 1 such as 0.1, or none, got '2'"),
        (("score", "near", "--reference", "real", "--seed", "-1"), "--seed"),
        (("compare", "a"), "required: B"),
        (("average", "a"), "required: -o/--out"),
    ],
)
def test_bad_options_are_one_line(run, words, sentence, capsys):
    with pytest.raises(SystemExit) as end:
        run(*words)
    assert end.value.code == 2
    err = capsys.readouterr().err
    assert sentence in err and err.count("\n") == 1


def test_mixed_units_are_refused_unless_asked_for(run, folder):
    write_table(folder / "px.csv")
    text = (folder / "px.csv").read_text().replace("_mw2", "_px").replace("_mw", "_px")
    (folder / "px.csv").write_text(text)
    code, _, err = run("compare", "near/x_mm_1.csv", "px.csv")
    assert code == 2 and "mouth width" in err


def test_compare_tells_lateness(run, folder, drawn):
    code, out, err = run("compare", "near/x_mm_1.csv", "far/x_mm_1.csv", "-o", "out", "--band", "none")
    assert (code, err) == (0, "")
    assert re.search(r"far/x_mm_1 is 1[2-6]\d ms later", out)
    record = json.loads((folder / "out/compare.json").read_text())
    assert (
        record["pair"]["lag_v1"] == pytest.approx(record["alignment"]["lag_s"]) and record["settings"]["band"] is None
    )
    assert record["first_take"]["peak_height_v1"] == pytest.approx(0.33, abs=1e-3)
    assert [region["label"] for region in record["regions_carried"]] == ["onset", "opening", "hold", "closing"]
    assert len(page_of(folder / "out/compare.html")[0].sources) == 4
    before = (folder / "out/compare.html").read_bytes()
    run("compare", "near/x_mm_1.csv", "far/x_mm_1.csv", "-o", "out", "--band", "none")
    assert (folder / "out/compare.html").read_bytes() == before


def test_compare_without_movement_has_no_phases(run, folder):
    write_table(folder / "shut.csv", high=0.0)
    code, out, _ = run("compare", "shut.csv", "near/x_mm_1.csv", "-o", "out", "--json")
    assert code == 0
    assert json.loads(out)["regions"] == []


def test_average_writes_table_provenance_and_figure(run, folder, drawn):
    (folder / "real/d_mm_1.csv").write_text("time_s,width_mw,height_mw,area_mw2\n0,oops,1,1\n")
    code, out, err = run("average", *sorted(folder.glob("real/*_mm_*.csv")), "-o", "out/mm.csv", "--json")
    assert code == cli.SOME_FAILED and "d_mm_1" in err
    found = json.loads(out)
    assert len(found["takes"]) == 6
    table = pd.read_csv(folder / "out/mm.average.csv")
    assert table["height"].max() == pytest.approx(0.3275, abs=0.01)
    assert {"height_sd", "time_sd_s"} <= set(table)
    assert json.loads((folder / "out/mm.average.json").read_text())["n_takes"] == 6
    assert np.ptp(cv2.imread(str(folder / "out/mm.average.png"))) > 200


@pytest.mark.parametrize("verb", ["compare", "average", "score"])
def test_help_has_an_example(verb, capsys):
    with pytest.raises(SystemExit) as end:
        cli.main([verb, "--help"])
    assert end.value.code == 0
    assert f"example: lipmetrics {verb}" in " ".join(capsys.readouterr().out.split())
