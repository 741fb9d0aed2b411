"""The long table, its dictionary, and the dry run that fills one."""

import numpy as np
import pandas as pd

from study.design import make_design, stimuli_from_codes
from study.export import DICTIONARY, answers_table, write_answers, write_outside_ids
from study.rehearsal import rehearse
from study.store import Store

CODES = [f"{action}{level}" for action in "pm" for level in (0, 4, 7, 10)]


def answered(design, store, key, count, choose):
    session = store.session(key)
    for one in design.sessions[session.slot][:count]:
        store.answer(
            key,
            one.trial,
            f"nonce{one.trial}",
            left=one.left,
            right=one.right,
            chosen=choose(one),
            last=one.trial == len(design.sessions[0]),
            measures={"response_time_s": one.trial / 2, "start_drift_s": None, "replays_left": 3},
        )


def test_table_and_dictionary(tmp_path):
    design = make_design(stimuli_from_codes(CODES), participants_n=3, catch_n=1, seed=4)
    store = Store(":memory:", design.identity, 3)
    store.begin("a", {"PID": "x"}), store.begin("b", {"PID": "y"}), store.begin("c", {"PID": "z"})
    answered(design, store, "b", 13, lambda one: one.right)
    answered(design, store, "a", 5, lambda one: one.left)
    answered(design, store, "c", 2, lambda one: "")
    store.withdraw("c")
    table = answers_table(store, design)
    assert list(table) == list(DICTIONARY)
    assert table["slot"].tolist() == [1] * 5 + [2] * 13
    assert table["session"].tolist() == ["active"] * 5 + ["done"] * 13
    assert table["trial"].tolist() == [*range(1, 6), *range(1, 14)]
    assert (table["chosen"] == np.where(table["slot"] == 1, table["left"], table["right"])).all()
    assert table["response_time_s"].tolist() == [trial / 2 for trial in table["trial"]]
    assert table["start_drift_s"].isna().all() and (table["replays_left"] == 3).all()
    for _, row in table.iterrows():
        planned = design.sessions[row["slot"] - 1][row["trial"] - 1]
        assert (row["left"], row["right"], row["kind"], row["expected"], row["question"]) == (
            *(planned.left, planned.right, planned.kind, planned.expected, planned.question),
        )
        assert row["level_left"] == planned.left[1:] and row["action"] == planned.left[0]
    done = answers_table(store, design, complete=True)
    assert len(done) == 13 and set(done["session"]) == {"done"}
    paths = write_answers(tmp_path / "out" / "answers.csv", table)
    assert [path.name for path in paths] == ["answers.csv", "answers.dictionary.csv"]
    read = pd.read_csv(paths[0], keep_default_na=False)
    assert list(read) == pd.read_csv(paths[1])["column"].tolist() and len(read) == 18
    ids = pd.read_csv(write_outside_ids(tmp_path / "ids.csv", store))
    assert sorted(ids["value"]) == ["x", "y"] and set(ids["participant"]) == set(table["participant"])
    empty = answers_table(Store(":memory:", design.identity, 3), design)
    assert empty.empty and list(empty) == list(DICTIONARY)


def test_dry_run():
    design = make_design(stimuli_from_codes(CODES), participants_n=60, catch_n=2, practice_n=1, seed=4)
    table = rehearse(design, seed=3)
    assert len(table) == 60 * 15 and set(table["session"]) == {"done"} and table["participant"].nunique() == 60
    pd.testing.assert_frame_equal(table, rehearse(design, seed=3))
    checks = table[table["kind"] == "catch"]
    assert 0.9 < (checks["chosen"] == checks["expected"]).mean() <= 1
    tests = table[table["kind"] == "test"]
    high = np.where(tests["level_left"].astype(int) > tests["level_right"].astype(int), tests["left"], tests["right"])
    share = (tests["chosen"] == high).mean()
    assert 0.52 < share < 0.68  # the logit 0.4 is 0.6
    nothing = rehearse(design, seed=3, preference=-8.0, person_sd=0.0, item_sd=0.0)
    tests = nothing[nothing["kind"] == "test"]
    assert (tests["chosen"] == high).mean() < 0.01
