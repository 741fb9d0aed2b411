"""Readers of files on damaged ones: they return or refuse in one sentence, soon, in little memory, and never crash.

More by hand: `LIPMETRICS_FUZZ=600 pytest tests/test_fuzz_readers.py -k by_hand` tries cases for so many seconds, from
the number in LIPMETRICS_FUZZ_FROM on. `fuzz_readers.bad_files(folder, reader, case)` makes the files of a case again.
"""

import os
import time

import numpy as np
import pytest
from fuzz_readers import READERS, bad_files
from fuzzing import Tried, damaged

CI_CASES, SLOW_CASES, LEAK_TIMES = 2, 6, 30
NO_COMPILER = [name for name in READERS if name not in ("truth", "motion.h5", "checkpoint.npz", "long take")]


def faults(tried, names, cases, times=0):
    found = [tried.read(name, case, times) for case in cases for name in names]
    return [f"{one.reader} {one.case}: {one.fault}" for one in found if one.fault]


def test_readers_refuse_damaged_files_in_a_sentence(tmp_path):
    with Tried(tmp_path) as tried:
        assert faults(tried, NO_COMPILER, range(CI_CASES)) == []


@pytest.mark.slow
def test_readers_refuse_many_damaged_files_in_a_sentence(tmp_path):
    with Tried(tmp_path) as tried:
        assert faults(tried, READERS, range(CI_CASES, SLOW_CASES)) == []


@pytest.mark.slow
def test_reading_the_same_damaged_file_again_takes_no_more_memory(tmp_path):
    with Tried(tmp_path) as tried:
        assert faults(tried, READERS, range(1000, 1001), LEAK_TIMES) == []


@pytest.mark.skipif("LIPMETRICS_FUZZ" not in os.environ, reason="LIPMETRICS_FUZZ=SECONDS says how long to try")
def test_by_hand(tmp_path):
    found, case = [], int(os.environ.get("LIPMETRICS_FUZZ_FROM", 10_000))
    until = time.monotonic() + float(os.environ["LIPMETRICS_FUZZ"])
    with Tried(tmp_path) as tried:
        while time.monotonic() < until:
            found += faults(tried, READERS, [case])
            case += 1
    print(f"up to case {case}")
    assert found == []


def test_a_case_is_the_same_files_every_time(tmp_path):
    for name in ("scene.toml", "store.h5", "cuts.csv"):
        first = {one.name: one.read_bytes() for one in bad_files(tmp_path, name, 3).iterdir()}
        assert first == {one.name: one.read_bytes() for one in bad_files(tmp_path, name, 3).iterdir()}
    good = b"a,b\n1,2\n3,4\n"
    changed = [damaged(good, "a.csv", np.random.default_rng(k), []) for k in range(40)]
    assert len(set(changed)) > 30


@pytest.mark.slow
def test_a_fault_of_every_kind_is_seen(tmp_path, monkeypatch):
    """With readers that crash, hang, eat memory, raise something else or write a page."""
    monkeypatch.setenv("LIPMETRICS_FUZZ_FAULTY", "1")
    monkeypatch.setattr("fuzzing.LONGEST_S", 4.0)
    with Tried(tmp_path) as tried:
        kinds = {
            "crash": "died with",
            "hang": "no answer",
            "eater": "took",
            "raiser": "KeyError",
            "writer": "a message of",
        }
        for name, kind in kinds.items():
            tried.read(name, 0)
            assert kind in tried.read(name, 0).fault, name
        assert "grew by" in tried.read("leaker", 0, 30).fault
        assert tried.read("labels.csv", 0).fault == ""
