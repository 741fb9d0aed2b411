import json

import numpy as np
import pandas as pd
import pytest

import study
from study.design import make_design, stimuli_from_codes
from study.errors import InputError
from study.rehearsal import rehearse
from study.responses import answers_from
from study.tables import grouped, level_pairs


@pytest.fixture(scope="module")
def thesis():
    return study.analyse(draws=1999)


@pytest.fixture(scope="module")
def rehearsed() -> pd.DataFrame:
    codes = [f"{action}_{level}" for action in ("m", "p", "b", "k") for level in (0, 4, 7)]
    design = make_design(stimuli_from_codes(codes), participants_n=12, catch_n=3, practice_n=2, seed=1)
    return rehearse(design, seed=2, preference=0.8)


def test_the_same_question_by_every_test(thesis):
    tests = thesis.tests.set_index(["test", "sample"])
    assert tests["share"].between(0.59, 0.62).all()
    pooled = tests.loc[("binomial, two-sided", "answers"), "p"]
    people = tests.loc[("Student's t", "participants"), "p"]
    both = tests.loc[("headline", "participants and pairs"), "p"]
    assert pooled < people < both < 0.05  # the more may be otherwise, the larger p


def test_which_conclusions_survive(thesis):
    survives = thesis.verdicts.set_index("conclusion")["survives"].to_dict()
    assert survives == {
        "stickiness improves perceived realism": "yes",
        "some people have a preference, others have not": "yes",
        "all who have a preference prefer sticky": "yes",
        "higher levels are preferred on slower, lower on faster movements": "no",
        "the preferred level depends on the speed": "in part",
        "audio can affect the preferred level": "no",
        "audio lowers the preferred level": "no",
        "level 10 is too much": "in part",
        "level 7 is preferred to level 4": "in part",
        "people can tell the levels apart": "yes",
    }


def test_what_cannot_be_said_is_said(thesis):
    assert thesis.side is None and any("side" in note for note in thesis.notes)
    assert thesis.position.participants_n == 20 and thesis.position.mean == pytest.approx(0.0507, abs=5e-4)


def test_groups_add_up(thesis):
    groups = thesis.groups
    for grouping in ("action", "audio", "speed", "action and audio"):
        part = groups[groups["grouping"] == grouping]
        assert part["for_a"].sum() == 346 and part["for_b"].sum() == 230
    by_audio = groups[groups["grouping"] == "audio"]
    assert [str(one) for one in by_audio["audio"]] == ["0", "1"]  # not 0.0, beside the groupings without audio
    assert (groups["exact_low"] <= groups["share"]).all() and (groups["share"] <= groups["exact_high"]).all()


def test_pairs_of_levels(thesis):
    pairs = thesis.pairs.set_index(["level_a", "level_b"])
    assert pairs.loc[(7, 0), ["for_a", "for_b"]].tolist() == [112, 80]
    assert (pairs["p_holm"] >= pairs["p"]).all() and (pairs["p_headline_holm"] >= pairs["p_headline"]).all()
    by_action = level_pairs(study.thesis_answers(), by="action")
    assert len(by_action) == 36
    assert (by_action["p_holm"] <= 6 * by_action["p"] + 1e-12).all()  # within each action


def test_any_grouping_and_one_answer_each_is_exact():
    table = grouped(study.thesis_answers().where(level=[0, 4]), 4, 0, ["audio", "action"])
    assert table["audio"].tolist() == [0] * 6 + [1] * 4
    assert (table["method"] == "exact").all() and (table["p"] == table["p_two_sided"]).all()
    with pytest.raises(InputError, match="did you mean 'action'"):
        grouped(study.thesis_answers(), 4, 0, "acton")


def test_json_is_plain_and_the_same_twice(thesis, tmp_path):
    thesis.save(tmp_path / "a.json")
    study.analyse(draws=1999).save(tmp_path / "b.json")
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    found = json.loads((tmp_path / "a.json").read_text())
    assert found["answers_n"] == 1152 and found["seed"] == 0
    assert len(found["replication"]) == 24 and found["side"] is None


def test_a_rehearsed_study_from_its_export(rehearsed, tmp_path):
    rehearsed.to_csv(tmp_path / "answers.csv", index=False)
    found = study.analyse(study.load_answers(tmp_path / "answers.csv"), draws=999)
    assert len(found.answers) == 12 * 12  # practice and catch trials are not tests
    assert 0.55 < found.headline.mean < 0.95 and found.side.participants_n == 12
    assert found.verdicts is None and found.replication is None
    assert found.exclusions["catch_n"].tolist() == [3] * 12 and not found.exclusions["excluded"].any()
    found.to_dict()


def test_who_fails_the_catch_trials_is_left_out(rehearsed):
    table = rehearsed.copy()
    name = table["participant"].iloc[0]
    catch = (table["kind"] == "catch") & (table["participant"] == name)
    wrong = np.where(table["expected"] == table["left"], table["right"], table["left"])
    table.loc[catch, "chosen"] = wrong[catch]
    found = study.analyse(answers_from(table), max_wrong_n=2, draws=999)
    assert found.exclusions.query("excluded")["participant"].tolist() == [name]
    assert name not in found.answers.participants and len(found.answers.participants) == 11


def test_a_small_foreign_table_with_ties():
    rows = [(f"p{i}", "x", "y", ["x", "y", "", "y"][i % 4]) for i in range(8)]
    found = study.analyse(answers_from(pd.DataFrame(rows, columns=["participant", "left", "right", "chosen"])))
    assert found.headline is None and any("No headline test" in note for note in found.notes)
    assert found.pairs[["for_a", "for_b", "ties"]].to_numpy().tolist() == [[4, 2, 2]]
    assert found.strengths.tie > 0
    found.to_dict()


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"level": 95}, "between 0 and 1"),
        ({"draws": 5}, "at least 99 draws"),
        ({"max_wrong_n": 1}, "catch trials with a column expected"),
        ({"max_wrong_n": -1}, "0 or more wrong"),
    ],
)
def test_bad_settings_are_refused(settings, message):
    with pytest.raises(InputError, match=message):
        study.analyse(**settings)
