import dataclasses

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from study.errors import InputError
from study.headline import _Layout, headline, null_t2_complete, t2_complete, two_way_p
from study.power import Scenario, p_values, rejection, simulate
from study.responses import Choices, thesis_answers


def choices(matrix) -> Choices:
    """Answers of participants (rows) to pairs (columns); NaN where not asked."""
    matrix = np.asarray(matrix, dtype=float)
    person, item = np.nonzero(~np.isnan(matrix))
    names = tuple(map(str, range(matrix.shape[0]))), tuple(map(str, range(matrix.shape[1])))
    return Choices(matrix[person, item], person, item, *names, pd.DataFrame())


def answers(seed, shape=(12, 20), preference=0.3) -> np.ndarray:
    scenario = Scenario(*shape, preference, 0.8, 0.5)
    return simulate(scenario, 1, np.random.default_rng(seed))[0]


def test_variances_of_a_full_table_are_those_of_the_textbook():
    """Two-way analysis of variance without interaction: mean squares by loops."""
    y = answers(1)
    persons_n, items_n = y.shape
    mean = y.mean()
    persons = items_n * sum((row.mean() - mean) ** 2 for row in y) / (persons_n - 1)
    items = persons_n * sum((column.mean() - mean) ** 2 for column in y.T) / (items_n - 1)
    rest = sum(
        (y[i, j] - y[i].mean() - y[:, j].mean() + mean) ** 2 for i in range(persons_n) for j in range(items_n)
    ) / ((persons_n - 1) * (items_n - 1))
    found = headline(choices(y), draws=99)
    assert found.rest_sd**2 == pytest.approx(rest)
    assert found.person_sd**2 == pytest.approx((persons - rest) / items_n)
    assert found.item_sd**2 == pytest.approx((items - rest) / persons_n)
    assert found.error**2 == pytest.approx((persons + items - rest) / y.size)


def test_the_fast_form_for_many_full_studies_is_the_same_test():
    y = answers(2)
    t2, parts = t2_complete(y[None] - 0.5)
    found = headline(choices(y), draws=19_999)
    assert parts[:, 0] == pytest.approx([found.person_sd**2, found.item_sd**2, found.rest_sd**2])
    fast = two_way_p(t2[0], null_t2_complete(*y.shape, 19_999, np.random.default_rng(5))(parts[:, 0]))
    assert fast == pytest.approx(found.p, abs=0.012)


def test_variances_of_a_table_with_holes_are_right_on_average():
    rng = np.random.default_rng(3)
    holes = rng.random((14, 16)) < 0.35
    person, item = np.nonzero(~holes)
    layout = _Layout(person, item, 14, 16)
    y = rng.normal(0, 0.5, (20_000, 14))[:, person] + rng.normal(0, 0.8, (20_000, 16))[:, item]
    y += rng.normal(0, 1, y.shape)
    middle = y.sum(1) ** 2 / y.shape[1]
    squares = [((y @ d) ** 2 / d.sum(0)).sum(1) - middle for d in (layout.by_person, layout.by_item)]
    squares.append((y**2).sum(1) - middle)
    assert layout.solve @ np.mean(squares, axis=1) == pytest.approx([0.25, 0.64, 1], rel=0.03)
    assert y.mean(1).var() == pytest.approx(layout.weights @ [0.25, 0.64, 1], rel=0.05)


def test_draws_in_the_small_space_are_draws_of_whole_tables():
    rng = np.random.default_rng(4)
    person, item = np.nonzero(rng.random((8, 9)) < 0.7)
    layout = _Layout(person, item, 8, 9)
    parts = np.array([0.2, 0.4, 1.0])
    y = rng.normal(0, 0.2**0.5, (20_000, 8))[:, person] + rng.normal(0, 0.4**0.5, (20_000, 9))[:, item]
    y += rng.normal(0, 1, y.shape)
    slow = y.mean(1) ** 2 / (layout.weights @ layout.variances(y))
    fast = layout.null_t2(parts, 20_000, rng)
    assert stats.ks_2samp(slow, fast).pvalue > 0.01


def test_the_interval_holds_the_null_exactly_when_p_is_large():
    for seed in range(12):
        found = headline(choices(answers(seed, preference=0.45)), draws=999)
        assert (found.low <= 0.5 <= found.high) == (found.p > 0.05)


def test_order_of_answers_does_not_matter():
    one = choices(answers(6))
    order = np.random.default_rng(0).permutation(len(one.y))
    other = dataclasses.replace(one, y=one.y[order], person=one.person[order], item=one.item[order])
    assert headline(other, draws=999).p == headline(one, draws=999).p


def test_the_same_seed_gives_the_same_p():
    one = choices(answers(7))
    assert headline(one, draws=999, seed=3) == headline(one, draws=999, seed=3)
    assert headline(one, draws=999, seed=3).p != headline(one, draws=999, seed=4).p


def test_a_preference_of_every_participant_in_every_pair_is_found_and_none_is_not():
    everyone = np.tile([1, 1, 1, 0], (12, 5)).T.reshape(20, 12).T  # 12 x 20, three of four for a
    assert headline(choices(np.roll(everyone, 1, axis=0)), draws=999).p < 0.05
    nobody = np.indices((12, 20)).sum(0) % 2
    found = headline(choices(nobody), draws=999)
    assert found.mean == 0.5 and found.p == 1


def test_few_participants_or_pairs_are_said():
    assert headline(choices(answers(8, (6, 20))), draws=99).caution == "only 6 participants: p is too small"
    assert headline(choices(answers(8, (12, 20))), draws=99).caution == ""


def test_the_thesis_survives_with_a_larger_p():
    thesis = thesis_answers()
    found = headline(thesis.choices(*thesis.sticky()))
    assert found.mean == pytest.approx(346 / 576)
    assert 0.002 < found.p < 0.02
    assert found.low > 0.5


@pytest.mark.parametrize(
    "matrix", [np.ones((2, 9)), np.ones((9, 2)), np.where(np.eye(6), 1, np.nan)], ids=["persons", "pairs", "one each"]
)
def test_layouts_that_cannot_tell_are_refused(matrix):
    with pytest.raises(InputError, match="at least 3 participants to at least 3 pairs"):
        headline(choices(matrix))


@pytest.mark.slow
@pytest.mark.parametrize("person_sd", [0, 0.5, 1])
@pytest.mark.parametrize("item_sd", [0, 0.5])
def test_error_of_the_first_kind_is_4_to_6_percent(person_sd, item_sd):
    found = rejection(Scenario(12, 60, 0, person_sd, item_sd), studies_n=6000, seed=11, draws=999).set_index("test")
    assert 0.036 <= found.loc["headline", "rate"] <= 0.064  # 4 to 6 %, and three standard errors of a half
    if person_sd or item_sd:
        assert found.loc["binomial", "rate"] > 0.09


def test_where_people_and_pairs_differ_only_the_headline_keeps_its_error():
    """A small version of the measurement in benchmarks/study_errors.py."""
    y = simulate(Scenario(16, 30, 0, 0.5, 0.5), 1500, np.random.default_rng(9))
    rate = {name: np.mean(p <= 0.05) for name, p in p_values(y, np.random.default_rng(10), 499).items()}
    assert 0.03 < rate["headline"] < 0.075
    assert rate["binomial"] > 0.2
    assert rate["participants"] > 0.07 and rate["pairs"] > 0.1
