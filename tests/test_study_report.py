"""The command `study analyse`: words, files, other people's data, bad input."""

import dataclasses
import json
import re

import numpy as np
import pandas as pd
import pytest

from study import cli, report, summary
from study.analysis import analyse
from study.errors import InputError
from study.page import page
from study.printed import between, counted, level_names, number, p_text, percent, points
from study.responses import answers_from


@pytest.fixture(scope="module")
def thesis():
    return analyse(draws=999)


def own_rows(participants_n=6, clips_n=4, seed=1):
    """Answers of a study of others: three methods, ties, a column of their own."""
    rng = np.random.default_rng(seed)
    rows = []
    for person in range(participants_n):
        for clip in range(clips_n):
            for a, b in (("mine", "theirs"), ("mine", "real"), ("real", "theirs")):
                left, right = (a, b) if rng.random() < 0.5 else (b, a)
                chosen = ["", a, a, b][rng.integers(4)]
                rows.append((f"p<{person}>", left, right, chosen, "young" if person % 2 else "old", f"clip{clip}"))
    return pd.DataFrame(rows, columns=["participant", "left", "right", "chosen", "age", "action"])


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "answers.csv"
    own_rows().to_csv(path, index=False)
    return path


def run(*words):
    return cli.main(["analyse", *map(str, words)])


# -- words ------------------------------------------------------------------------------------------------------------


def test_the_result_is_said_first_with_its_interval_and_test(thesis):
    first, second, *_ = summary.in_short(thesis)
    assert first.startswith(
        "Levels 4, 7, 10 were chosen over level 0 in 346 of 576 answers, 60 %, a preference ratio of "
    )
    one = thesis.headline
    assert f"p = {p_text(one.p)}" in first and f"{between(one.low, one.high)}." in first and "more than chance" in first
    assert "other participants" in second and "other pairs" in second


def test_a_preference_within_chance_is_not_sold_as_one(thesis):
    weak = dataclasses.replace(thesis, headline=dataclasses.replace(thesis.headline, p=0.2, caution="only 5 pairs"))
    first, _, third, *_ = summary.in_short(weak)
    assert "no more than chance may bring, p = 0.20" in first
    assert third == "Caution: only 5 pairs."


def test_the_terminal_has_the_replication_and_every_conclusion(thesis):
    text = report.in_text(thesis)
    for row in thesis.replication.itertuples():
        cells = re.escape(row.place), re.escape(row.quantity), re.escape(row.printed), re.escape(row.from_answers)
        assert re.search(r"^  " + r" {2,}".join(cells) + r"( {2,}|$)", text, re.MULTILINE)
    for row in thesis.verdicts.itertuples():
        assert f"{row.conclusion}: {row.estimate}" in text
    assert text.index("In short") < text.index("By every test") < text.index("The thesis's printed numbers")


def test_statements_of_what_is_unknown_are_not_said_twice(thesis):
    text = report.in_text(thesis)
    assert text.count("The side on which a video was shown is not known") == 1


def test_every_row_of_the_pairs_has_its_counts(thesis):
    table = summary.pairs(thesis)
    assert [row[0] for row in table.rows] == ["4 over 0", "7 over 0", "10 over 0", "7 over 4", "10 over 4", "10 over 7"]
    assert [row[1] for row in table.rows][2] == "119 of 192"
    assert all(len(row) == len(table.head) for row in table.rows)


def test_names_stay_as_they_are_and_counts_have_their_number():
    rows = pd.DataFrame([("a", "mine", "theirs", "mine")], columns=["participant", "left", "right", "chosen"])
    found = analyse(answers_from(rows), draws=99)
    assert summary.what_was_asked(found)[0].startswith("1 answer of 1 participant (1 each) to 1 pair of videos")
    assert summary.in_short(found)[0].startswith("theirs was chosen over mine in 0 of 1 answers")


@pytest.mark.parametrize(
    "p, text",
    [
        (0.5, "0.50"),
        (0.0996, "0.10"),
        (0.0994, "0.099"),
        (0.001, "0.001"),
        (7.7e-7, "7.7e-7"),
        (3e-12, "3.0e-12"),
        (np.nan, "-"),
    ],
)
def test_p_values_in_words(p, text):
    assert p_text(p) == text


def test_numbers_in_words():
    assert percent(0.6007) == "60 %" and percent(np.nan) == "-"
    assert points(-0.0787) == "-8" and points(0.001) == "+0" and points(-0.001) == "+0" and points(np.nan) == "-"
    assert between(0.529, 0.672) == "53 to 67 %" and between(np.nan, 1.0) == "-"
    assert between(-0.09, 0.6, number) == "-0.09 to 0.60"
    assert number(np.inf) == "∞" and number(np.nan) == "-"
    assert level_names([0]) == "level 0" and level_names([4, 7.5, 10]) == "levels 4, 7.5, 10"
    assert level_names(range(9)) == "levels 0 to 8" and level_names(["a", "b"]) == "a, b"
    assert level_names("abcd") == "4 others"
    assert counted(1, "pair") == "1 pair" and counted(0, "pair") == "0 pairs"


def test_tables_as_text_line_up():
    table = summary.Table(("a", "b"), (("1", "2"), ("long", "3")))
    assert table.text("") == "a     b\n1     2\nlong  3"
    assert table.markdown() == "| a | b |\n| --- | --- |\n| 1 | 2 |\n| long | 3 |\n"
    assert "<td" in table.html() and "&lt;" in summary.Table(("a",), (("<",),)).html()


# -- page -------------------------------------------------------------------------------------------------------------


def test_the_page_needs_nothing_else_and_escapes_names():
    answers = answers_from(own_rows(), source="<script>alert(1)</script>")
    text = page(analyse(answers, draws=99), {"all": b"\x89PNG"})
    assert not re.search(r'(src|href)="(?!data:)', text) and "<script" not in text and "@import" not in text
    assert "p&lt;1&gt;" in text and "p<1>" not in text
    assert 'src="data:image/png;base64,iVBORw=="' in text


def test_the_page_has_every_section_and_the_thesis_only_where_it_belongs(thesis):
    heads = re.findall("<h2>(.*?)</h2>", page(thesis, {}))
    assert heads[:2] == ["In short", "By every test"]
    assert "Where the thesis&#x27;s conclusions survive" in heads and "Does speed change the preference?" in heads
    others = re.findall("<h2>(.*?)</h2>", page(analyse(answers_from(own_rows()), draws=99), {}))
    assert not [head for head in others if "thesis" in head]
    assert {"By level", "By participant", "Side and position", "How the numbers were computed"} <= set(others)


def test_catch_trials_and_who_was_left_out_are_told():
    rows = own_rows()
    catch = pd.DataFrame(
        [(name, "mine", "theirs", "theirs" if name == "p<0>" else "mine") for name in rows["participant"].unique()],
        columns=["participant", "left", "right", "chosen"],
    ).assign(kind="catch", expected="mine", action="clip0")
    both = pd.concat([rows.assign(kind="test", expected=""), catch], ignore_index=True).fillna("")
    found = analyse(answers_from(both), max_wrong_n=0, draws=99)
    text = page(found, {})
    assert "1 of 6 catch trials were answered otherwise than expected; left out: 1 participant." in text
    assert "Left out because of wrong catch trials: 1 participant." in text
    assert len(found.answers.participants) == 5


# -- files ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_files_of_other_peoples_data_are_whole_and_the_same_each_time(own, tmp_path, capsys):
    folders = [tmp_path / "one", tmp_path / "two"]
    for folder in folders:
        assert run(own, "-o", folder) == 0
    first, second = (
        {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}
        for folder in folders
    )
    assert first == second
    names = {"report.html", "analysis.json", "tables/pairs.csv", "tables/participants.csv", "figures/all_pairs.png"}
    assert names <= set(first)
    assert "72 answers of 6 participants" in capsys.readouterr().out


def test_their_own_columns_are_kept(own):
    table = report.tables(analyse(report.load_answers(own), draws=99))["answers"]
    assert list(table["age"]) == list(own_rows()["age"])
    assert not [name for name in table if str(name).startswith("_")]


def test_json_has_the_numbers_of_the_analysis(own, capsys):
    assert run(own, "--json", "--seed", "3") == 0
    facts = json.loads(capsys.readouterr().out)
    found = analyse(report.load_answers(own), seed=3)
    assert facts["command"] == "analyse" and facts["files"] == []
    assert [row["for_a"] for row in facts["pairs"]] == list(found.pairs["for_a"])
    assert {name: facts[name] for name in found.to_dict()} == found.to_dict()


def test_another_level_can_be_the_one_compared_with(own, capsys):
    assert run(own, "--least", "theirs") == 0
    assert " were chosen over theirs in " in capsys.readouterr().out
    assert run(own) == 0
    assert " were chosen over mine in " in capsys.readouterr().out


def test_least_puts_one_level_first_and_keeps_the_others():
    answers = answers_from(own_rows())
    changed = report.with_least(answers, "theirs")
    assert list(changed.levels) == ["theirs", "mine", "real"] and list(answers.levels) == ["mine", "real", "theirs"]
    with pytest.raises(InputError, match="did you mean 'theirs'"):
        report.with_least(answers, "their")


@pytest.mark.parametrize(
    "change, words, message",
    [
        (lambda t: t.drop(columns="chosen"), (), "add chosen"),
        (lambda t: t.assign(chosen="yours"), (), "expected chosen to be"),
        (lambda t: t.iloc[:0], (), "expected at least one answer"),
        (lambda t: t.assign(left=t["right"]), (), "expected two different videos"),
        (lambda t: t, ("--least", "their"), "did you mean 'theirs'"),
        (lambda t: t, ("--max-wrong", "1"), "expected catch trials"),
        (lambda t: t.assign(kind="practice"), (), "expected answers to test trials"),
    ],
)
def test_bad_answers_are_told_in_one_sentence(own, capsys, change, words, message):
    change(pd.read_csv(own, keep_default_na=False)).to_csv(own, index=False)
    assert run(own, *words) == 2
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1 and said.startswith("lipmetrics study: ")


def test_other_bad_input_is_told_in_one_sentence(own, tmp_path, capsys):
    assert run(tmp_path / "none.csv") == 2
    assert run("--stimuli", own) == 2
    (tmp_path / "binary.csv").write_bytes(bytes(range(256)))
    assert run(tmp_path / "binary.csv") == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 3 and "Traceback" not in said


def test_an_output_folder_that_is_a_file_is_told(own, capsys):
    assert run(own, "-o", own) == 2
    said = capsys.readouterr().err
    assert "expected to write" in said and said.count("\n") == 1


@pytest.mark.parametrize("words", [["--level", "95"], ["--seed", "-1"], ["--max-wrong", "x"], ["--colour"], ["a", "b"]])
def test_bad_words_are_told(words, capsys):
    with pytest.raises(SystemExit) as stop:
        run(*words)
    assert stop.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.slow
def test_the_bundled_answers_give_the_report_with_all_figures(tmp_path, capsys):
    assert run("-o", tmp_path) == 0
    out = capsys.readouterr().out
    assert "346 of 576" in out and "survives" in out
    figures = {file.stem for file in (tmp_path / "figures").iterdir()}
    assert {f"figure_5_{number:02d}" for number in range(2, 21)} <= figures
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert text.count("data:image/png") == len(figures)
