"""Balance counted trial by trial, over many seeds; names, tables and files of designs."""

import itertools
from collections import Counter, defaultdict

import numpy as np
import pandas as pd
import pytest

from study.design import (
    Stimulus,
    load_design,
    make_design,
    stimuli_from_codes,
    stimuli_from_csv,
    stimuli_from_folder,
)
from study.errors import InputError

THESIS = [f"{action}{level}" for action in ("os", "fs") for level in (0, 4, 7, 10)] + [
    f"{action}{level}{audio}" for action in ("p", "m", "pu", "mu") for level in (0, 4, 7, 10) for audio in ("", "a")
]


def counts(design):
    """Of test trials: how often each pair stood which way round, by participant, action and position."""
    place = {one.code: one for one in design.stimuli}
    by = defaultdict(Counter)
    for person, session in enumerate(design.sessions):
        tests = [one for one in session if one.kind == "test"]
        for position, one in enumerate(tests, start=1):
            first_left = design.pairs[one.question - 1] == (one.left, one.right)
            assert first_left or design.pairs[one.question - 1] == (one.right, one.left)
            action = place[one.left].action, place[one.left].audio
            by["pair"][one.question, first_left] += 1
            by["person"][person, first_left] += 1
            by["person and action"][(person, action), first_left] += 1
            by["position"][one.question, position] += 1
            by["seen"][one.question] += 1
            by["place"][one.question] += position
            by["person saw"][person, one.question] += 1
    return by


def apart(counter):
    """Largest difference between the two ways round."""
    return {key: abs(counter[key, True] - counter[key, False]) for key, _ in counter}


def check(design, participants_n):
    by = counts(design)
    pairs_n = len(design.pairs)
    tests_n = sum(one.kind == "test" for one in design.sessions[0])
    seen = [by["seen"][question] for question in range(1, pairs_n + 1)]
    assert max(seen) - min(seen) <= 1 and sum(seen) == participants_n * tests_n
    assert set(by["person saw"].values()) == {1}
    for what in ("pair", "person", "person and action"):
        total = Counter()
        for (key, _), count in by[what].items():
            total[key] += count
        for key, difference in apart(by[what]).items():
            assert difference == total[key] % 2, (what, key)
    for question in range(1, pairs_n + 1):
        at = [by["position"][question, position] for position in range(1, tests_n + 1)]
        assert max(at) - min(at) <= 1
    return by


def test_sides_and_positions_balance_exactly_over_1000_seeds():
    stimuli = stimuli_from_codes([f"{a}{level}" for a in ("m", "p") for level in (0, 4, 10)])
    schemes = itertools.cycle(
        [
            {"scheme": "all", "participants_n": 6},
            {"scheme": "all", "participants_n": 7},
            {"scheme": "chain", "participants_n": 8},
            {"scheme": "bib", "per_participant_n": 4, "participants_n": 9},
            {"scheme": "bib", "per_participant_n": 3, "participants_n": 8},
        ]
    )
    first_ways = []
    for seed, scheme in zip(range(1000), schemes, strict=False):
        design = make_design(stimuli, seed=seed, **scheme)
        by = check(design, scheme["participants_n"])
        first_ways.append(by["pair"][1, True] and design.sessions[0][0].left == design.pairs[0][0])
        if scheme["scheme"] == "all" and scheme["participants_n"] == 6:  # a full square
            assert set(by["position"].values()) == {1} and len(by["position"]) == 36
            follows = Counter(
                (a.question, b.question) for session in design.sessions for a, b in itertools.pairwise(session)
            )
            assert set(follows.values()) == {1} and len(follows) == 30  # every pair after every other
    assert 0 < np.mean(first_ways) < 1


@pytest.mark.parametrize("participants_n", [19, 20, 130])
def test_the_thesis_design(participants_n):
    design = make_design(stimuli_from_codes(THESIS), participants_n=participants_n, catch_n=4, practice_n=2, seed=5)
    assert len(design.pairs) == 60 and {len(session) for session in design.sessions} == {66}
    by = check(design, participants_n)
    if participants_n % 2 == 0:
        assert set(by["place"].values()) == {participants_n * 61 / 2}  # the mean position of every pair


def test_odd_numbers_of_pairs_per_action():
    """Three pairs per action: the odd ones out of a participant's actions cancel."""
    stimuli = stimuli_from_codes([f"{a}{level}" for a in "pmkt" for level in (0, 4, 10)])
    for seed in range(50):
        check(make_design(stimuli, participants_n=5, seed=seed), 5)


def test_who_sees_which_way_is_by_chance():
    """Over seeds, any participant sees any pair one way in half of the designs."""
    stimuli = stimuli_from_codes([f"p{level}" for level in (0, 4, 7, 10)])
    ways, orders = np.zeros((4, 6)), np.zeros((6, 6))
    for seed in range(600):
        for person, session in enumerate(make_design(stimuli, participants_n=4, seed=seed).sessions):
            for one in session:
                ways[person, one.question - 1] += one.left == f"p{min(int(one.left[1:]), int(one.right[1:]))}"
                orders[one.question - 1, one.trial - 1] += 1
    assert np.all(np.abs(ways / 600 - 0.5) < 5 * 0.5 / 600**0.5)
    assert np.all(np.abs(orders / 2400 - 1 / 6) < 0.05)


def test_parts_meet_evenly():
    stimuli = stimuli_from_codes([f"p{level}" for level in range(7)])
    design = make_design(stimuli, scheme="bib", per_participant_n=7, participants_n=21, seed=1)
    met = Counter()
    for session in design.sessions:
        met.update(itertools.combinations(sorted(one.question for one in session), 2))
    assert set(counts(design)["seen"].values()) == {7}
    every = [met[pair] for pair in itertools.combinations(range(1, 22), 2)]
    assert np.mean(every) == 2.1 and max(every) <= 5 and np.std(every) < 1  # by chance 1.3 to 1.7


@pytest.mark.parametrize("catch_n", [1, 4, 5])
def test_catch_and_practice_trials(catch_n):
    stimuli = stimuli_from_codes(THESIS)
    design = make_design(stimuli, participants_n=20, catch_n=catch_n, practice_n=3, seed=2)
    left_n = 0
    for session in design.sessions:
        assert [one.trial for one in session] == list(range(1, 64 + catch_n))
        assert [one.kind for one in session[:4]] == ["practice"] * 3 + ["test"]
        places = [one.trial for one in session if one.kind == "catch"]
        assert len(places) == catch_n
        assert all((i * 59) // catch_n <= place - 4 - i for i, place in enumerate(places))
        checks = [one for one in session if one.kind == "catch"]
        assert all(one.instructed and one.expected in (one.left, one.right) for one in checks)
        lefts = sum(one.expected == one.left for one in checks)
        assert abs(2 * lefts - catch_n) <= 1
        left_n += lefts
        assert not any(one.expected for one in session if one.kind != "catch")
    assert 2 * left_n == 20 * catch_n


def test_catch_pairs_of_their_own():
    design = make_design(
        stimuli_from_codes(["p0", "p4", "bad0", "bad1"]), participants_n=2, catch_n=2, catch_pairs=[("bad1", "bad0")]
    )
    assert design.pairs == (("p0", "p4"),)
    for session in design.sessions:
        checks = [one for one in session if one.kind == "catch"]
        assert {(one.left, one.right) for one in checks} == {("bad1", "bad0"), ("bad0", "bad1")}
        assert all(one.expected == "bad1" and not one.instructed and one.question == 0 for one in checks)


def test_pairs():
    stimuli = stimuli_from_codes(["slow_open_10", "slow_open_0", "slow_open_4", "m0a", "m4a", "m0"])
    assert stimuli[0] == Stimulus("m0", "m", "0") and stimuli[1] == Stimulus("m0a", "m", "0", True)
    assert make_design(stimuli, participants_n=1).pairs == (
        ("m0a", "m4a"),
        ("slow_open_0", "slow_open_4"),
        ("slow_open_0", "slow_open_10"),
        ("slow_open_4", "slow_open_10"),
    )
    chain = make_design(stimuli, participants_n=1, scheme="chain").pairs
    assert chain == (("m0a", "m4a"), ("slow_open_0", "slow_open_4"), ("slow_open_4", "slow_open_10"))
    models = stimuli_from_codes(["ours", "theirs", "real"])
    assert len(make_design(models, participants_n=1).pairs) == 3


def test_saved_and_loaded(tmp_path):
    design = make_design(stimuli_from_codes(THESIS), participants_n=3, catch_n=2, seed=9)
    paths = design.save(tmp_path)
    assert load_design(tmp_path) == design and load_design(paths[0]).identity == design.identity
    before = [path.read_bytes() for path in paths]
    make_design(stimuli_from_codes(THESIS[::-1]), participants_n=3, catch_n=2, seed=9).save(tmp_path)
    assert [path.read_bytes() for path in paths] == before
    other = make_design(stimuli_from_codes(THESIS), participants_n=3, catch_n=2, seed=10)
    assert other.identity != design.identity
    table = pd.read_csv(paths[1], keep_default_na=False)
    assert len(table) == 186 and table["kind"].value_counts()["catch"] == 6
    row = table[(table["participant"] == 2) & (table["trial"] == 5)].iloc[0]
    assert (row["left"], row["right"]) == (design.sessions[1][4].left, design.sessions[1][4].right)
    assert str(row["level_left"]) == design.stimulus(row["left"]).level


def test_stimuli_of_a_folder_and_of_a_table(tmp_path):
    for name in ("p_0.mp4", "p_4.MP4", "notes.txt", ".p_7.mp4", "p_0.mkv"):
        (tmp_path / name).write_bytes(name.encode())
    stimuli = stimuli_from_folder(tmp_path)
    assert [one.code for one in stimuli] == ["p_0", "p_4"] and stimuli[0].file == str(tmp_path / "p_0.mp4")
    assert len(stimuli[0].sha256) == 64 and stimuli[0].sha256 != stimuli[1].sha256
    table = tmp_path / "videos.csv"
    table.write_text("stimulus,action,level,audio,speed,file\nx,p,10,1,fast,p_4.MP4\ny,p,2,1,fast,p_0.mp4\n")
    assert [(one.code, one.level, one.audio, one.speed) for one in stimuli_from_csv(table)] == [
        ("y", "2", True, "fast"),
        ("x", "10", True, "fast"),
    ]
    for text, said in (
        ("stimulus,levle\nx,1\n", r"got 'levle'; did you mean 'level'\?"),
        ("action\nx\n", "expected a column stimulus"),
        ("stimulus,audio\nx,loud\ny,1\n", "expected 0 or 1 under audio, got 'loud'"),
        ("stimulus\nx\nx\n", "expected every video once, got 'x'"),
        ("stimulus,file\nx,gone.mp4\ny,p_0.mp4\n", "gone.mp4 of x, but: No such file"),
    ):
        table.write_text(text)
        with pytest.raises(InputError, match=said):
            stimuli_from_csv(table)
    with pytest.raises(InputError, match="expected a table of videos"):
        stimuli_from_csv(tmp_path / "gone.csv")


def test_bad_input(tmp_path):
    stimuli = stimuli_from_codes(["p0", "p4", "p10"])
    for asked, said in (
        ({"scheme": "chains"}, r"all, chain or bib, got 'chains'; did you mean 'chain'\?"),
        ({"participants_n": 0}, "at least 1 participants, got 0"),
        ({"catch_n": -1}, "at least 0 catch trials, got -1"),
        ({"scheme": "bib"}, "expected --per-participant N"),
        ({"scheme": "bib", "per_participant_n": 4}, "1 to 3 pairs per participant, got 4"),
        ({"per_participant_n": 2}, "only with --pairs bib"),
        ({"catch_pairs": [("p0", "p5")]}, "in a catch pair, got 'p5'"),
    ):
        with pytest.raises(InputError, match=said):
            make_design(stimuli, **{"participants_n": 2} | asked)
    with pytest.raises(InputError, match="two videos of one action at different levels, got none"):
        make_design(stimuli_from_codes(["p0", "m0"]), participants_n=2)
    with pytest.raises(InputError, match="at least 2 videos to pair, got 1"):
        stimuli_from_codes(["p0"])
    with pytest.raises(InputError, match="got 'p0' more often"):
        stimuli_from_codes(["p0", "p0"])
    with pytest.raises(InputError, match="got 'real'; rename it"):
        stimuli_from_codes(["p0", "real"])
    with pytest.raises(InputError, match="which is none"):
        stimuli_from_folder(tmp_path / "gone")
    with pytest.raises(InputError, match="got none"):
        stimuli_from_folder(tmp_path)
    with pytest.raises(InputError, match="make one with 'lipmetrics study design'"):
        load_design(tmp_path)
    for text in ("{", "[]", '{"format": 1}', '{"format": 1, "stimuli": [], "sessions": 3}'):
        (tmp_path / "design.json").write_text(text)
        with pytest.raises(InputError, match="expected a design as"):
            load_design(tmp_path)
    (tmp_path / "design.json").write_text('{"format": 7}')
    with pytest.raises(InputError, match="format 1, got 7"):
        load_design(tmp_path)
    with pytest.raises(InputError, match="a video of the design, got 'p_10'; did you mean 'p10'"):
        make_design(stimuli, participants_n=1).stimulus("p_10")
