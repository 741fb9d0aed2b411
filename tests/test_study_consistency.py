import itertools

import numpy as np
import pandas as pd
import pytest

from study.consistency import consistency, heterogeneity_p, participants
from study.responses import answers_from, thesis_answers


def person(name, beats, action="m", levels=(0, 4, 7, 10)) -> list[tuple]:
    """Answers to all pairs of levels; beats(low, high) says whether the lower wins."""
    rows = []
    for low, high in itertools.combinations(levels, 2):
        codes = f"{action}_{low}", f"{action}_{high}"
        rows.append((name, *codes, codes[0] if beats(low, high) else codes[1]))
    return rows


def table(rows) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=["participant", "left", "right", "chosen"])


def test_orderly_and_circular_choices():
    orderly = person("straight", lambda low, high: True)
    around = person("around", lambda low, high: (low, high) in {(0, 4), (4, 7), (7, 10), (4, 10)})
    found = consistency(answers_from(table(orderly + around))).set_index("participant")
    assert found.loc["straight", ["triads", "circular", "zeta"]].tolist() == [4, 0, 1]
    # 0 > 4 > 7 > 0, 0 > 4 > 10 > 0; the other two triples are orderly
    assert found.loc["around", ["triads", "circular", "zeta"]].tolist() == [4, 2, -1]
    assert found.loc["straight", "p"] == pytest.approx(24 / 64)  # 4! orders of 2^6 sets of answers
    assert found.loc["around", "p"] == 1
    assert found.loc["all", ["triads", "circular", "expected"]].tolist() == [8, 2, 2]


def test_several_groups_multiply():
    rows = [row for action in ("m", "p", "b") for row in person("one", lambda low, high: True, action)]
    assert consistency(answers_from(table(rows)))["p"][0] == pytest.approx((24 / 64) ** 3)


def test_coin_flips_have_a_quarter_of_circular_triads_and_honest_p():
    rng = np.random.default_rng(1)
    rows = [row for name in range(300) for row in person(f"p{name}", lambda low, high: rng.random() < 0.5)]
    found = consistency(answers_from(table(rows)))
    assert found["circular"].iloc[-1] / found["triads"].iloc[-1] == pytest.approx(0.25, abs=0.03)
    assert np.mean(found["p"].iloc[:-1] <= 0.4) == pytest.approx(24 / 64, abs=0.09)


def test_ties_and_missing_pairs_make_no_triads():
    rows = person("one", lambda low, high: True)
    rows[0] = (*rows[0][:3], "")
    found = consistency(answers_from(table(rows[:-1])))
    assert found["triads"].tolist() == [0, 0]  # 0-4 tied, 7-10 not asked: every triple needs one of them
    assert np.isnan(found["p"][0]) and np.isnan(found["zeta"][0])


def test_participants_of_the_thesis():
    thesis = thesis_answers()
    found = participants(thesis, *thesis.sticky())
    assert found["for_a"].sum() == 346 and found["for_b"].sum() == 230
    assert found.loc[found["p_holm"] <= 0.05, "participant"].tolist() == ["3", "12"]
    assert (found["for_a"] + found["for_b"]).tolist() == [18, 18, *[30] * 18]


def test_people_who_differ_are_told_from_people_who_do_not():
    rng = np.random.default_rng(2)

    def p(shares):
        rows = []
        for name, share in enumerate(shares):
            for action in range(30):
                won = rng.random() < share
                rows.append((f"p{name}", f"a{action}x_0", f"a{action}x_1", f"a{action}x_{int(won)}"))
        return heterogeneity_p(answers_from(table(rows)), 1, 0, draws=499)

    assert p([0.5] * 12) > 0.05
    assert p([0.3] * 6 + [0.7] * 6) < 0.01


def test_pairs_that_differ_are_not_taken_for_people_who_differ():
    rows = [(f"p{n}", f"a{k}x_0", f"a{k}x_1", f"a{k}x_{int(k < 5)}") for n in range(8) for k in range(10)]
    assert heterogeneity_p(answers_from(table(rows)), 1, 0, draws=99) == 1
