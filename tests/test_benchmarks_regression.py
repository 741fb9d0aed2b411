"""The regression benchmark's table: normalising, marking, reading and writing; nothing is timed."""

import json
import sys
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from lipmetrics.errors import InputError

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import regression
from regression import Row


def time(value):
    return Row("time", value, "x reference")


def error(value):
    return Row("error", value, "%")


def test_best_of_all_rounds_counts_for_works_and_reference():
    references, first, second = iter([2.0, 1.0, 4.0, 3.0]), iter([5.0, 6.0]), iter([9.0, 7.0])
    best = {}
    works = {"a": lambda: next(first), "b": lambda: next(second)}
    regression.in_rounds(works, 2, best, lambda: next(references))
    assert best == {"reference": 1.0, "a": 5.0, "b": 7.0}


def test_times_are_multiples_of_the_reference_and_measuring_of_decoding():
    best = {"reference": 2.0, "a": 3.0, "decoding": 0.5, regression.MEASURING: 4.0}
    assert regression.time_rows(best) == {"a": time(1.5), regression.MEASURING: Row("time", 8.0, "x decoding")}


def test_reference_work_is_a_known_number_of_steps():
    table = np.arange(8, dtype=np.int64)
    value, place, total = 0.3, 1, 0
    for _ in range(5):
        value = 3.9 * value * (1 - value)
        place = (place * 1103515245 + 12345) % 8
        total += place
    assert regression.reference_work(table, 5) == pytest.approx(value + total, abs=1e-9)


def test_best_of_several_runs_is_the_time_of_one(monkeypatch):
    clock = iter([0.0, 8.0, 10.0, 14.0])  # two runs of two works each
    monkeypatch.setattr(regression.time, "process_time", lambda: next(clock))
    done = count()
    assert regression.best_s(lambda: next(done), repeats=2, times=2) == 2.0
    assert next(done) == 4


@pytest.mark.parametrize(
    "now, stored, marked",
    [
        (time(1.24), time(1.0), False),
        (time(1.26), time(1.0), True),
        (time(0.5), time(1.0), False),
        (error(1.04), error(1.0), False),
        (error(1.06), error(1.0), True),
        (error(0.0005), error(0.0), False),  # nothing that could be seen
        (error(0.002), error(0.0), True),
        (time(9.0), None, False),
    ],
)
def test_rows_are_marked_from_a_quarter_slower_or_a_twentieth_worse(now, stored, marked):
    assert regression.is_marked(now, stored) is marked


def test_table_says_ratio_mark_and_what_is_new_or_gone():
    now = {"a": time(1.5), "b": error(2.0), "c": time(1.0), "e": error(3.0)}
    stored = {"a": time(1.0), "b": error(2.0), "d": time(1.0), "e": error(2.0)}
    table = regression.compared(now, stored)
    assert table["mark"].to_dict() == {
        "a": "slower than stored by > 25 %",
        "b": "",
        "c": "new",
        "e": "worse than stored by > 5 %",
        "d": "gone",
    }
    np.testing.assert_allclose(table["ratio"], [1.5, 1, np.nan, 1.5, np.nan])


def test_rows_that_were_not_asked_for_are_not_gone():
    table = regression.compared({"one: a": time(1.0)}, {"one: a": time(1.0), "two: b": time(1.0)}, only="one")
    assert table.index.tolist() == ["one: a"]


def test_what_is_stored_is_read_back(tmp_path):
    rows = {"a": time(1.23456789), "b": error(0.0)}
    regression.store(rows, tmp_path / "table.json", "a machine")
    assert regression.load(tmp_path / "table.json") == ({"a": time(1.235), "b": error(0.0)}, "a machine")
    assert [path.name for path in tmp_path.iterdir()] == ["table.json"]


def test_the_table_that_comes_with_the_benchmark_can_be_read():
    rows, of = regression.load(regression.STORED)
    assert of
    assert {row.kind for row in rows.values()} == {"time", "error"}


@pytest.mark.parametrize(
    "text, said",
    [
        (None, "cannot be read"),
        ("{", "cannot be read"),
        ("[]", "format"),
        ('{"format": "another", "rows": {}}', "format"),
        ("{}", "format"),
        ({"a": {"kind": "time", "value": 1.0}}, "row 'a'.*kind, value and unit"),
        ({"a": 3}, "row 'a'.*kind, value and unit"),
        ({"a": {"kind": "colour", "value": 1.0, "unit": ""}}, "time or error"),
        ({"a": {"kind": "time", "value": "fast", "unit": ""}}, "of 0 or more"),
        ({"a": {"kind": "time", "value": -1.0, "unit": ""}}, "of 0 or more"),
        ({"a": {"kind": "time", "value": float("nan"), "unit": ""}}, "of 0 or more"),
        ({"a": {"kind": ["time"], "value": 1.0, "unit": ""}}, "time or error"),
    ],
)
def test_a_bad_table_is_refused(tmp_path, text, said):
    path = tmp_path / "table.json"
    if isinstance(text, dict):
        text = json.dumps({"format": regression.FORMAT, "rows": text})
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=f"(?s){said}.*--store"):
        regression.load(path)


@pytest.fixture
def measured(monkeypatch):
    """Two rows at once in the place of the whole set."""
    rows = {"a": time(1.0), "b": error(1.0)}
    monkeypatch.setattr(regression, "measured_rows", lambda folder, only, stored: rows)
    monkeypatch.setattr(regression, "one_core", lambda: None)
    return rows


def test_exit_code_says_whether_a_row_is_marked(tmp_path, measured, capsys):
    place = ["--file", str(tmp_path / "table.json")]
    assert regression.main([*place, "--store"]) == 0
    assert regression.main(place) == 0
    assert "Nothing is marked" in capsys.readouterr().out
    measured["a"] = time(1.3)
    assert regression.main(place) == 3
    assert "slower than stored by > 25 %" in capsys.readouterr().out


def test_without_a_table_the_exit_code_is_that_of_bad_input(tmp_path, measured, capsys):
    assert regression.main(["--file", str(tmp_path / "none.json")]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: expected a stored table")
    assert said.count("\n") == 1


def test_a_broken_table_can_be_stored_anew(tmp_path, measured):
    (tmp_path / "table.json").write_text("{")
    assert regression.main(["--file", str(tmp_path / "table.json"), "--store"]) == 0
    assert regression.load(tmp_path / "table.json")[0] == measured


def test_a_part_is_not_stored(measured):
    with pytest.raises(SystemExit, match="2"):
        regression.main(["--only", "a", "--store"])


def test_rows_that_would_be_marked_are_measured_again(tmp_path, monkeypatch):
    rounds, tries = regression.ROUNDS, []

    def slow_at_first():
        tries.append("slow")
        return 1.1 if len(tries) > rounds else 2.0

    done = []
    works = {"a: slow": slow_at_first, "a: usual": lambda: done.append(1) or 1.2, "b": lambda: 1 / 0}
    monkeypatch.setattr(regression, "time_works", lambda of: works)
    monkeypatch.setattr(regression.in_rounds, "__defaults__", (lambda: 1.0,))
    monkeypatch.setattr(regression, "error_works", lambda of: {"c": (lambda: 5.0, "%")})
    rows = regression.measured_rows(tmp_path, "a", {"a: slow": time(1.0), "a: usual": time(1.0)})
    assert rows == {"a: slow": time(1.1), "a: usual": time(1.2)}
    assert len(tries) == rounds + regression.MORE
    assert len(done) == rounds
