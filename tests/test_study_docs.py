"""docs/study.md says what the code computes."""

import re
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import study_tables

from study.analysis import analyse
from study.replication import replicate_thesis

TEXT = study_tables.PAGE.read_text(encoding="utf-8")


def test_the_printed_numbers_are_current():
    assert study_tables.with_blocks(TEXT, study_tables.printed_blocks()) == TEXT, "benchmarks/study_tables.py --write"


@pytest.mark.slow
def test_the_analysis_is_current():
    pytest.importorskip("statsmodels")
    assert study_tables.with_blocks(TEXT, study_tables.analysed_blocks()) == TEXT, "benchmarks/study_tables.py --write"


def test_every_printed_number_is_in_the_page():
    table = TEXT.partition("<!-- replication -->")[2].partition("<!-- end")[0]
    for row in replicate_thesis().itertuples():
        line = next(one for one in table.splitlines() if f"| {row.place} | {row.quantity} |" in one)
        assert f"| {row.printed} | {row.from_answers} |" in line
        assert row.agrees or row.reason in line


TERMS = {  # test in the table: head of its definition
    "binomial": "Binomial p.",
    "Student's t": "Over participants.",
    "sign flips": "Sign flips.",
    "bootstrap": "Bootstrap.",
    "GEE": "GEE.",
    "mixed logit": "Mixed logit.",
    "headline": "Headline test.",
}


def test_every_test_that_is_printed_is_defined():
    definitions = TEXT.partition("## Definitions")[2]
    for name in analyse(draws=99).tests["test"]:
        assert f"**{TERMS[name.partition(',')[0]]}**" in definitions


def test_links_lead_somewhere():
    for link in re.findall(r"\]\(([^)#]+)\)", TEXT):
        assert (study_tables.PAGE.parent / link).exists(), link


def test_a_block_that_is_missing_is_told():
    with pytest.raises(KeyError, match="tests"):
        study_tables.with_blocks("nothing", {"tests": ""})
