import dataclasses

import pytest

from study import replicate_thesis, thesis_answers
from study.replication import as_printed, check_statements


@pytest.fixture(scope="module")
def table():
    return replicate_thesis()


def test_every_printed_number_agrees_or_has_a_reason(table):
    assert len(table) == 24
    assert ((table["reason"] != "") == ~table["agrees"].astype(bool)).all()


def test_the_numbers_under_the_reason_are_the_printed_ones(table):
    """One answer less and P(> r) give every printed digit; only cut digits and the slip of 0.00004 need more."""
    numbers = table[table["reconstructed"].notna()]
    assert len(numbers) == 13
    for row in numbers.itertuples():
        if "slip" in row.reason:
            assert as_printed(row.reconstructed) == "0.0000004" and row.printed == "0.00004"
        elif "cut" in row.reason:
            assert str(row.reconstructed).startswith(row.printed)
        elif row.quantity.endswith("p"):
            assert as_printed(row.reconstructed) == row.printed
        else:
            assert f"{row.reconstructed:.2f}" == row.printed


def test_the_headline_numbers_of_the_thesis(table):
    row = table[table["place"] == "5.1.5"].set_index("quantity")
    ratio = row.loc["sticky against none: ratio"]
    assert (ratio["printed"], ratio["from_answers"]) == ("1.51", "1.50")
    assert (ratio["for_a"], ratio["for_b"]) == (346, 230)
    p = row.loc["sticky against none: p"]
    assert p["p_at_least"] == pytest.approx(7.66e-7, rel=1e-3)
    assert p["p_at_least"] > p["p_more_than"] > p["reconstructed"]


def test_p_values_in_the_thesis_print():
    assert [as_printed(p) for p in (0.0023, 3.95e-7, 0.0125, 0.00009999)] == ["0.002", "0.0000004", "0.01", "0.0001"]


def test_statements_about_the_figures_hold_in_the_counts():
    found = check_statements()
    assert found["holds"].all()
    counts = found.set_index("place")["counts"]
    assert counts["5.1.4, figure 5.7 (f)"] == "7 against 10 18:2"
    assert counts["5.1.4, figure 5.16"] == "sticky against none without audio 38:16, with 24:30"


def test_other_answers_change_the_statements():
    thesis = thesis_answers()
    table = thesis.table.copy()
    other = table["left"].where(table["chosen"] != table["left"], table["right"])
    found = check_statements(dataclasses.replace(thesis, table=table.assign(chosen=other)))
    assert not found.set_index("place").loc["5.1.4, figure 5.10", "holds"]
    assert not found.set_index("place").loc["5.1.5", "holds"]
