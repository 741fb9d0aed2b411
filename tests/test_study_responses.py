import pandas as pd
import pytest

from study import Answers, InputError, load_answers, thesis_answers
from study.responses import DATA, Preference, answers_from


@pytest.fixture(scope="module")
def thesis() -> Answers:
    return thesis_answers()


@pytest.fixture
def small() -> pd.DataFrame:
    return pd.DataFrame(
        {
            "participant": ["p1", "p1", "p2", "p2"],
            "left": ["m_0", "m_4", "m_4", "m_0"],
            "right": ["m_4", "m_10", "m_0", "m_10"],
            "chosen": ["m_4", "", "m_4", "m_0"],
        }
    )


def test_the_thesis_has_576_sticky_or_not_choices_and_346_for_sticky(thesis):
    assert len(thesis) == 1152 and len(thesis.participants) == 20
    assert thesis.levels == (0, 4, 7, 10)
    assert thesis.preference(*thesis.sticky()) == Preference(346, 230)


def test_counts_agree_with_a_loop_over_the_files(thesis):
    questions = pd.read_csv(DATA / "questions.csv").set_index("question")
    seen = 0
    for row in pd.read_csv(DATA / "answers.csv").itertuples():
        question = questions.loc[row.question]
        if (
            question["action"] == "m"
            and question["audio"] == 1
            and {question["level_1"], question["level_2"]} == {4, 7}
        ):
            seen += row.chosen_video == "m7a"
    found = thesis.where(action="m", audio=1).preference(7, 4)
    assert (found.for_a, found.n) == (seen, 20)


@pytest.mark.parametrize(
    "conditions, n",
    [
        ({"participant": 1}, 36),
        ({"participant": ["1", "3"]}, 96),
        ({"action": "open_slow"}, 120),
        ({"audio": True}, 456),
        ({"level": [0, 7]}, 192),
        ({"level": (4, 7, 10)}, 576),
        ({"speed": "fast", "audio": 0, "action": ["p", "m"]}, 108),
    ],
    ids=str,
)
def test_conditions_select(thesis, conditions, n):
    assert len(thesis.where(**conditions)) == n


def test_a_preference_turns_round_with_its_sides(thesis):
    there, back = thesis.preference([7], [0, 4]), thesis.preference([0, 4], [7])
    assert (there.for_a, there.for_b) == (back.for_b, back.for_a)
    assert there.ratio == pytest.approx(1 / back.ratio)


def test_empty_preferences_have_no_ratio():
    assert Preference(3, 0).ratio == float("inf")
    assert pd.isna(Preference(0, 0).ratio) and pd.isna(Preference(0, 0, 2).share)


def test_any_long_table_will_do(small):
    answers = answers_from(small)
    assert answers.levels == (0, 4, 10) and answers.actions == ["m"]
    assert answers.preference([4, 10], 0) == Preference(2, 1)
    assert answers.preference(10, 4) == Preference(0, 0, ties=1)
    assert answers.table["pair"].nunique() == 3  # whichever stands left
    assert answers.sides_known and not answers.positions_known


def test_sides_do_not_change_what_is_counted(small):
    turned = small.rename(columns={"left": "right", "right": "left"})
    assert answers_from(turned).preference([4, 10], 0) == answers_from(small).preference([4, 10], 0)


def test_levels_that_are_words_stay_words(small):
    words = {"m_0": "none", "m_4": "some", "m_10": "much"}
    small = small.replace(words)
    assert answers_from(small).levels == ("much", "none", "some")


def test_the_order_of_levels_can_be_given(small):
    answers = answers_from(small, levels=[10, 0, "4"])
    assert answers.levels == (10, 0, 4) and answers.sticky() == ([0, 4], [10])
    assert answers.where(participant="p2").levels_shown == [10, 0, 4]
    assert answers.preference([0, 4], 10) == answers_from(small).preference([0, 4], 10)
    with pytest.raises(InputError, match="each of the levels 0, 4, 10 once, the least first, got 0, 4"):
        answers_from(small, levels=[0, 4])


def test_attributes_come_from_a_table_of_videos(tmp_path, small):
    small.to_csv(tmp_path / "answers.csv", index=False)
    (tmp_path / "videos.csv").write_text("stimulus,action,level,audio\nm_0,hum,1,1\nm_4,hum,2,1\nm_10,hum,3,1\n")
    answers = load_answers(tmp_path / "answers.csv", stimuli=tmp_path / "videos.csv")
    assert answers.levels == (1, 2, 3) and answers.actions == ["hum"]
    assert len(answers.where(audio=1)) == 4


def test_practice_and_catch_trials_are_no_tests(small):
    answers = answers_from(small.assign(kind=["practice", "", "catch", "test"]))
    assert len(answers.tests) == 2
    assert len(answers.where(kind="practice")) == 1


def test_who_was_replaced_does_not_count(small):
    assert answers_from(small.assign(session=["done", "done", "replaced", "replaced"])).participants == ["p1"]


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda t: t.drop(columns="chosen"), "rename or add chosen"),
        (lambda t: t[:0], "at least one answer"),
        (lambda t: t.assign(chosen="m_7"), "answer 1: expected chosen to be m_0, m_4 or empty"),
        (lambda t: t.assign(right=t["left"], chosen=""), "two different videos"),
        (lambda t: t.assign(participant=["p1", "", "p2", "p2"]), "answer 2: expected a participant"),
        (lambda t: t.assign(trial=[1, 1, 1, 2]), "trial 1 of participant p1 twice"),
        (lambda t: t.assign(trial=["a", "b", "c", "d"]), "numbers under trial"),
        (lambda t: t.assign(audio="loud"), "0 or 1 under audio"),
    ],
    ids=["column", "empty", "chosen", "same", "nobody", "twice", "trial", "audio"],
)
def test_bad_tables_say_what_is_wrong(small, change, message):
    with pytest.raises(InputError, match=message):
        answers_from(change(small))


def test_bad_questions_name_the_nearest(thesis):
    with pytest.raises(InputError, match="did you mean 'action'"):
        thesis.where(actoin="m")
    with pytest.raises(InputError, match="did you mean 'mummy'"):
        thesis.where(action="mumy")
    with pytest.raises(InputError, match="a level of the answers"):
        thesis.preference(5, 0)
    with pytest.raises(InputError, match="different levels on the two sides, got 4"):
        thesis.preference([4, 7], [0, 4])
    with pytest.raises(InputError, match="a table of answers in"):
        load_answers("nowhere.csv")
