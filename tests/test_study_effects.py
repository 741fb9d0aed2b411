import numpy as np
import pandas as pd
import pytest
from scipy import stats

from study.effects import hotelling_p, interaction, position_effect, side_effect
from study.errors import InputError
from study.responses import THESIS_MATCHES, answers_from, thesis_answers


def study_of(chance, *, persons_n=15, seed=0, actions=("m", "p"), audios=(0, 1)) -> pd.DataFrame:
    """All pairs of levels 0, 4, 7 for everybody; chance(low, high, action, audio, trial 0 to 1, left) of the higher."""
    rng = np.random.default_rng(seed)
    rows = []
    for person in range(persons_n):
        cells = [(a, s, low, high) for a in actions for s in audios for low, high in ((0, 4), (0, 7), (4, 7))]
        for trial, at in enumerate(rng.permutation(len(cells))):
            action, audio, low, high = cells[at]
            codes = [f"{action}{level}{'a' * audio}" for level in (low, high)]
            higher_left = bool(rng.integers(2))
            left, right = codes[::-1] if higher_left else codes
            p = chance(low, high, action, audio, trial / (len(cells) - 1), higher_left)
            rows.append((f"p{person}", trial + 1, left, right, codes[int(rng.random() < p)], action, low, high, audio))
    table = pd.DataFrame(
        rows, columns=["participant", "trial", "left", "right", "chosen", "action", "low", "high", "audio"]
    )
    return table.drop(columns=["low", "high"])


def test_a_pull_to_the_left_is_found_and_is_no_preference_of_levels():
    answers = answers_from(study_of(lambda low, high, action, audio, at, left: 0.75 if left else 0.25))
    side = side_effect(answers)
    assert side.share == pytest.approx(0.75, abs=0.06) and side.p_t < 1e-4 and side.low > 0.5
    assert abs(answers.preference(*answers.sticky()).share - 0.5) < 0.12


def test_without_a_pull_the_side_is_even():
    side = side_effect(answers_from(study_of(lambda *_: 0.7, seed=3)))
    assert side.low < 0.5 < side.high


def test_sides_that_are_not_known_give_nothing():
    assert side_effect(thesis_answers()) is None


def test_a_preference_that_grows_over_the_session_has_that_slope():
    answers = answers_from(study_of(lambda low, high, action, audio, at, left: 0.2 + 0.6 * at, persons_n=60))
    found = position_effect(answers, *answers.sticky())
    assert found.low < 0.6 < found.high and found.p < 0.001
    flat = answers_from(study_of(lambda *_: 0.6, persons_n=60))
    found = position_effect(flat, *flat.sticky())
    assert found.low < 0 < found.high
    without = answers_from(study_of(lambda *_: 0.6).drop(columns="trial"))
    assert position_effect(without, *without.sticky()) is None


def test_higher_chosen_counts_levels_not_sides():
    thesis = thesis_answers()
    choices = thesis.higher_chosen()
    by_hand = sum(thesis.preference(b, a).for_a for a in thesis.levels for b in thesis.levels if b > a)
    assert choices.y.sum() == by_hand and len(choices.y) == 1152


def test_audio_that_lowers_the_level_is_found():
    answers = answers_from(
        study_of(lambda low, high, action, audio, at, left: 0.25 if audio else 0.75, actions=("m", "p", "b", "k"))
    )
    found = interaction(answers, "audio", 0, 1, draws=999)
    assert found.higher.low < -0.5 < found.higher.high
    assert found.matched_higher.mean == pytest.approx(found.higher.mean)
    assert found.matched_higher.p < 0.01 and found.p_levels < 1e-4
    by_level = found.levels.set_index("level")["difference"]
    assert by_level[0] == pytest.approx(0.5, abs=0.1) and by_level[7] == pytest.approx(-0.5, abs=0.1)
    assert (found.levels["p_holm"] >= found.levels["p"]).all()


def test_audio_that_does_nothing_is_not_found():
    found = interaction(answers_from(study_of(lambda *_: 0.7, seed=5)), "audio", 0, 1, draws=999)
    assert found.higher.low < 0 < found.higher.high and found.p_levels > 0.05
    assert found.matched_higher.p > 0.05


def test_speed_in_the_thesis_pairs_actions_and_leaves_out_the_unfinished():
    found = interaction(thesis_answers(), "speed", "slow", "fast", matches=THESIS_MATCHES, draws=999)
    assert found.left_out == ("1", "2")
    assert found.matched_higher.n == 18 * 30 and found.matched_higher.items_n == 30
    assert found.matched_sticky.n == 18 * 15
    thesis = thesis_answers().where(participant=[str(i) for i in range(3, 21)])
    fast, slow = (thesis.where(speed=speed).preference([4, 7, 10], 0).share for speed in ("fast", "slow"))
    assert found.sticky.mean == pytest.approx(fast - slow)


def test_where_everybody_sees_a_part_nobody_is_left_out_for_it():
    table = study_of(lambda low, high, action, audio, at, left: 0.25 if audio else 0.75, actions=("m", "p", "b", "k"))
    own = table["participant"].str[1:].astype(int) % 4
    seen = table["action"].map({"m": 0, "p": 1, "b": 2, "k": 3})
    parts = table[(seen != own) & ((seen != (own + 1) % 4) | (table["participant"] == "p0"))]
    found = interaction(answers_from(parts), "audio", 0, 1, draws=999)
    assert found.left_out == () and found.higher.participants_n == 15
    assert found.higher.low < -0.5 < found.higher.high


def test_a_factor_of_ones_own():
    table = study_of(lambda low, high, action, audio, at, left: 0.9 if audio else 0.4, audios=(0, 1))
    table["screen"] = table.pop("audio").map({0: "small", 1: "large"})
    table["left"], table["right"], table["chosen"] = (table[c].str.rstrip("a") for c in ("left", "right", "chosen"))
    found = interaction(answers_from(table), "screen", "small", "large", draws=999)
    assert found.higher.mean == pytest.approx(0.5, abs=0.12) and found.higher.p < 1e-4


def test_hotelling_with_one_column_is_students_test_and_with_two_the_textbook_formula():
    x = np.random.default_rng(1).normal(0.4, 1, (14, 2))
    assert hotelling_p(x[:, :1]) == pytest.approx(stats.ttest_1samp(x[:, 0], 0).pvalue)
    t2 = 14 * x.mean(0) @ np.linalg.solve(np.cov(x.T), x.mean(0))
    assert hotelling_p(x) == pytest.approx(stats.f.sf(t2 * (14 - 2) / (2 * 13), 2, 12))
    assert hotelling_p(np.c_[x, x.sum(1)]) == pytest.approx(hotelling_p(x))
    assert np.isnan(hotelling_p(x[:2]))


def test_bad_factors_are_refused():
    thesis = thesis_answers()
    with pytest.raises(InputError, match="did you mean 'audio'"):
        interaction(thesis, "adio", 0, 1)
    with pytest.raises(InputError, match="a value that audio has"):
        interaction(thesis, "audio", 0, 2)
    with pytest.raises(InputError, match="at least 3 participants"):
        interaction(thesis.where(participant=["3", "4"]), "audio", 0, 1)
