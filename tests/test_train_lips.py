"""Training of the default method's forests: questions, split finder, a tiny forest, and forests in use."""

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import train_lips as train

from lipmetrics.errors import InputError
from lipmetrics.features import MAX_OFFSET, PAD
from lipmetrics.forest import Forest, load_forest, log_odds, save_forests
from lipmetrics.lips import LIP, OPENING

TINY = {"trees": 20, "depth": 5, "questions": 300, "tried": 60}
UNSEEN = 10_000_000  # canvases from this number on are in no training set


@pytest.fixture(scope="module")
def coarse():
    """A coarse forest from 45 tight and 45 wide canvases."""
    return train.train_stage(replace(train.COARSE_STAGE, **TINY), train.coarse_example, scale=0.005)


def random_forest(rng, depth, maps=3, trees=5, outputs=2, reach=4):
    questions = rng.integers(-reach, reach + 1, (trees, depth, 6))
    single = rng.random((trees, depth)) < 0.4
    questions[..., 0] = rng.integers(0, maps, (trees, depth))
    questions[..., 5] = np.where(single, rng.integers(0, 256, single.shape), rng.integers(-80, 80, single.shape))
    leaves = rng.standard_normal((trees, 1 << depth, outputs)).astype(np.float32)
    return Forest(questions.astype(np.int32), single, leaves, rng.standard_normal(outputs).astype(np.float32))


def slow_log_odds(forest, maps, pad, row, col):
    """The log-odds (K,) of one pixel, tree by tree."""
    total = forest.bias.astype(float)
    for questions, single, leaves in zip(forest.questions, forest.single, forest.leaves, strict=True):
        leaf = 0
        for d, (c, dr, dc, er, ec, threshold) in enumerate(questions):
            answer = int(maps[c, pad[0] + row + dr, pad[1] + col + dc])
            if not single[d]:
                answer -= int(maps[c, pad[0] + row + er, pad[1] + col + ec])
            leaf += (answer > threshold) << d
        total = total + leaves[leaf]
    return total


# --- forests


@pytest.mark.parametrize("depth", [1, 6, 8])
def test_log_odds_equal_a_walk_through_the_trees_pixel_by_pixel(depth):
    rng = np.random.default_rng(depth)
    forest, pad = random_forest(rng, depth), (5, 4)
    maps = rng.integers(0, 256, (3, 9 + 2 * pad[0], 13 + 2 * pad[1])).astype(np.uint8)
    odds = log_odds(forest, maps, pad, (2, 9), (1, 12))
    slow = [[slow_log_odds(forest, maps, pad, row, col) for col in range(1, 12)] for row in range(2, 9)]
    np.testing.assert_allclose(odds, np.moveaxis(slow, -1, 0), atol=1e-5)


def test_a_saved_forest_gives_the_same_log_odds(tmp_path, coarse):
    other = random_forest(np.random.default_rng(2), depth=8)
    save_forests(tmp_path / "both.npz", {"coarse": coarse, "other": other})
    maps, _ = train.coarse_example(train.SETS["tight"], np.random.default_rng(3))
    for name, forest in (("coarse", coarse), ("other", other)):
        loaded = load_forest(tmp_path / "both.npz", name)
        before, after = (log_odds(f, maps, PAD, (0, 20), (0, 30)) for f in (forest, loaded))
        np.testing.assert_array_equal(before, after)


def test_trees_too_deep_for_a_leaf_number_of_one_byte_are_refused(tmp_path):
    rng = np.random.default_rng(0)
    deepest = random_forest(rng, depth=8)
    with pytest.raises(InputError, match="depth 1 to 8, got 9"):
        random_forest(rng, depth=9)
    save_forests(tmp_path / "deep.npz", {"deep": deepest})
    with np.load(tmp_path / "deep.npz") as file:
        parts = dict(file)
    parts["deep_questions"] = np.concatenate([parts["deep_questions"], parts["deep_questions"][:, :1]], axis=1)
    parts["deep_leaves"] = np.concatenate([parts["deep_leaves"]] * 2, axis=1)
    np.savez(tmp_path / "deep.npz", **parts)
    with pytest.raises(InputError, match="depth 1 to 8, got 9"):
        load_forest(tmp_path / "deep.npz", "deep")


def test_a_forest_with_a_leaf_too_few_is_refused():
    forest = random_forest(np.random.default_rng(0), depth=3)
    with pytest.raises(InputError, match="5 trees of 8 leaves, got 5 of 7"):
        replace(forest, leaves=forest.leaves[:, :7])


# --- canvases


@pytest.mark.parametrize("name", train.SETS)
def test_shares_of_a_canvas_are_shares_and_openings_are_mouth(name):
    kind = train.SETS[name]
    for seed in range(5):
        canvas, shares = train.draw_canvas(kind, np.random.default_rng(seed))
        assert canvas.shape == (*kind.size, 3) and canvas.dtype == np.uint8
        assert shares.shape == (3, *kind.size) and shares.min() >= 0 and shares.max() <= 1
        assert (shares[OPENING] <= shares[LIP] + 1e-6).all()


def test_a_mouth_of_the_right_size_lies_in_the_middle_and_fills_half_the_canvas():
    still = replace(train.SETS["fine"], resize=0.0, move_mw=0.0, turn_rad=0.0, far=0.0, empty=0.0)
    for seed in range(5):
        _, shares = train.draw_canvas(still, np.random.default_rng(seed))
        rows, cols = (np.flatnonzero((shares[LIP] > 0.5).any(axis=axis)) for axis in (1, 0))
        assert abs((rows[0] + rows[-1]) / 2 - (still.size[0] - 1) / 2) < 2
        assert abs((cols[0] + cols[-1]) / 2 - (still.size[1] - 1) / 2) < 4  # thin corners may fall short
        assert -12 < cols[-1] - cols[0] + 1 - still.size[1] / 2 < 6  # a turned head looks narrower


def test_a_canvas_without_a_mouth_passes_through_both_stages(coarse):
    for name, example in (("wide", train.coarse_example), ("fine", partial(train.fine_example, coarse))):
        empty = replace(train.SETS[name], empty=1.0)
        questions = train.random_questions(train.FINE_STAGE if name == "fine" else train.COARSE_STAGE, _rng())
        answers, shares = train.read_pixels(example, questions, None, (empty, 0))
        assert answers.shape == (len(questions.single), train.PIXELS)
        assert answers.std() > 0
        assert shares.shape == (train.PIXELS, 3) and not shares.any()


def test_two_thirds_of_the_pixels_are_on_the_lips_or_around_them():
    lip = np.zeros((120, 160), np.float32)
    lip[60:64, 70:90] = 1
    rows, cols = train.choose_pixels(lip, np.random.default_rng(0))
    assert len(rows) == len(cols) == train.PIXELS
    near = (abs(rows - 61.5) < 16) & (abs(cols - 79.5) < 30)
    assert near.mean() > 0.65
    assert 0.3 < lip[rows, cols].mean() < 0.6


def test_the_same_canvas_is_drawn_every_time_and_another_for_every_number():
    questions = train.random_questions(train.COARSE_STAGE, _rng())
    read = partial(train.read_pixels, train.coarse_example, questions, None)
    (first, _), (again, _), (other, _) = (read((train.SETS["tight"], i)) for i in (4, 4, 5))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.5


# --- questions


@pytest.mark.parametrize("stage", [train.COARSE_STAGE, train.FINE_STAGE], ids=lambda stage: stage.name)
def test_questions_stay_on_the_canvas_and_each_asks_something(stage):
    questions = train.random_questions(stage, _rng())
    parts = questions.parts
    assert parts.shape == (stage.questions, 5)
    assert (np.array(PAD) >= MAX_OFFSET).all()
    assert (abs(parts[:, 1:]).reshape(-1, 2, 2).max(axis=(0, 1)) <= MAX_OFFSET).all()
    assert set(parts[:, 0]) == set(range(stage.maps))
    position = parts[:, 0] >= stage.maps - train.POSITION_MAPS
    assert questions.single[position].all() and not parts[position, 1:].any()
    assert not parts[questions.single, 3:].any()
    same = (parts[:, 1:3] == parts[:, 3:5]).all(axis=1) & ~questions.single
    assert same.mean() < 0.01  # two far offsets may meet by chance


def test_answers_are_differences_of_map_values():
    rng = np.random.default_rng(0)
    maps = rng.integers(0, 256, (2, 5 + 2 * PAD[0], 6 + 2 * PAD[1])).astype(np.uint8)
    parts = np.array([(0, 2, -3, 0, 0), (1, -4, 5, 1, 7), (1, 1, 1, 0, 0)], np.int32)
    questions = train.Questions(parts, np.array([False, False, True]))
    answers = train.ask(questions, maps, np.array([3]), np.array([4]))
    by_hand = maps.astype(int)[:, PAD[0] :, PAD[1] :]
    np.testing.assert_array_equal(
        answers[:, 0],
        [by_hand[0, 5, 1] - by_hand[0, 3, 4], maps[1, PAD[0] - 1, PAD[1] + 9] - by_hand[1, 4, 11], by_hand[1, 4, 5]],
    )


def test_an_answer_is_above_an_edge_exactly_if_its_bin_is():
    answers = np.random.default_rng(0).integers(-9, 9, (4, 500)).astype(np.int16)  # few values: edges coincide
    edges = train.bin_edges(answers)
    bins = train.to_bins(answers, edges)
    assert edges.shape == (4, train.BINS - 1)
    for at in range(train.BINS - 1):
        np.testing.assert_array_equal(bins > at, answers > edges[:, at, None])


# --- trees


def slow_split(bins, rows, leaf, slopes, leaves):
    """Gain of every split of one question, by sums over the pixels of each side."""
    outputs = slopes.shape[1] // 2
    gains = np.zeros(train.BINS - 1)
    for at in range(train.BINS - 1):
        for side in (bins[rows] <= at, bins[rows] > at):
            for j in range(leaves):
                g, h = np.split(slopes[side & (leaf == j)].sum(axis=0, dtype=float), [outputs])
                gains[at] += (g**2 / (h + train.DAMPING)).sum()
    return gains


def test_the_best_split_is_the_one_a_slow_search_finds():
    rng = np.random.default_rng(5)
    bins = rng.integers(0, train.BINS, (6, 900)).astype(np.uint8)
    rows = np.flatnonzero(rng.random(900) < 0.6)
    leaf = rng.integers(0, 4, rows.size).astype(np.int32)
    gradient = rng.standard_normal((rows.size, 2)) + 2.0 * (bins[3, rows] > 11)[:, None]
    slopes = np.hstack([gradient, rng.uniform(0.01, 0.25, (rows.size, 2))]).astype(np.float32)
    tried = np.array([4, 3, 0])
    gains, splits = train.best_splits(bins, tried, rows, leaf, slopes, 4)
    slow = np.array([slow_split(bins[q], rows, leaf, slopes, 4) for q in tried])
    np.testing.assert_array_equal(splits, slow.argmax(axis=1))
    np.testing.assert_allclose(gains, slow.max(axis=1), rtol=1e-9)
    assert gains.argmax() == 1 and splits[1] == 11


def test_log_loss_of_sure_and_of_undecided_answers():
    odds = np.array([[0.0, np.log(3)], [0.0, np.log(3)]])
    shares = np.array([[0.0, 1.0], [1.0, 0.0]])
    expected = [np.log(2), -(np.log(0.75) + np.log(0.25)) / 2]
    np.testing.assert_allclose(train.log_loss(odds, shares), expected)


def test_a_tiny_forest_tells_openings_from_lips_it_has_not_seen(coarse):
    on_opening, on_lip, on_skin = [], [], []
    for i in range(25):
        rng = np.random.default_rng([train.SEED, 1, UNSEEN + i])
        maps, shares = train.coarse_example(train.SETS["tight"], rng)
        odds = log_odds(coarse, maps, PAD, (0, shares.shape[1]), (0, shares.shape[2]))
        on_opening.append(odds[:, shares[OPENING] > 0.9])
        on_lip.append(odds[:, (shares[LIP] > 0.9) & (shares[OPENING] < 0.1)])
        on_skin.append(odds[:, shares[LIP] < 0.1])
    opening, lip, skin = (np.concatenate(each, axis=1) for each in (on_opening, on_lip, on_skin))
    assert opening.shape[1] > 500
    assert chance_above(opening[OPENING], lip[OPENING]) > 0.8  # 0.5 is guessing
    assert chance_above(lip[LIP], skin[LIP]) > 0.9


def chance_above(some, others):
    """How often a random one of `some` exceeds a random one of `others`."""
    return np.searchsorted(np.sort(others), some).mean() / len(others)


@pytest.mark.slow
def test_the_fine_stage_learns_from_the_coarse_answers(coarse, capsys):
    fine = train.train_stage(replace(train.FINE_STAGE, **TINY), partial(train.fine_example, coarse), scale=0.003)
    assert fine.leaves.shape == (20, 32, 3) and np.isfinite(fine.leaves).all()
    coarse_answers = train.FINE_STAGE.maps - 4 - 6  # before them the colours, after them place on the lips and canvas
    assert (fine.questions[..., 0] >= coarse_answers).any()
    assert "fine, 20 trees" in capsys.readouterr().out


def test_the_same_seed_gives_the_same_forest_whatever_the_threads():
    stage = replace(train.COARSE_STAGE, trees=2, depth=3, questions=40, tried=20)
    questions = train.random_questions(stage, _rng())
    rng = np.random.default_rng(1)
    answers = rng.integers(-99, 99, (40, 600)).astype(np.int16)
    edges = train.bin_edges(answers)
    shares = (answers[:3].T > 20).astype(np.float32)
    bins = train.to_bins(answers, edges)
    one, two = (train.grow(stage, questions, edges, bins, shares, np.random.default_rng(9), n) for n in (1, 2))
    np.testing.assert_array_equal(one.questions, two.questions)
    np.testing.assert_array_equal(one.leaves, two.leaves)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_file_whatever_the_processes(tmp_path, monkeypatch):
    for stage in ("COARSE_STAGE", "FINE_STAGE", "BORDER_STAGE"):
        monkeypatch.setattr(train, stage, replace(getattr(train, stage), **TINY))
    for processes in ("1", "2"):
        out = str(tmp_path / f"{processes}.npz")
        kept = ["--album", str(tmp_path / "album")]  # test_simulated_canvases.py says that the pictures are the same
        words = ["train_lips.py", "-o", out, "--scale", "0.002", "--processes", processes, *kept]
        monkeypatch.setattr(sys, "argv", words)
        train.main()
    assert (tmp_path / "1.npz").read_bytes() == (tmp_path / "2.npz").read_bytes()


def test_both_forests_answer_with_their_weighted_mean(coarse):
    rng = _rng()
    other = replace(coarse, leaves=-2 * coarse.leaves + 0.1, bias=coarse.bias + 1)
    maps = rng.integers(0, 255, (train.COARSE_COUNT, 9 + 2 * PAD[0], 11 + 2 * PAD[1])).astype(np.uint8)
    one, two, mean = (log_odds(f, maps, PAD, (0, 9), (0, 11)) for f in (coarse, other, train.both(coarse, other, 0.25)))
    np.testing.assert_allclose(mean, 0.75 * one + 0.25 * two, atol=1e-3)


# --- borders


def test_true_borders_are_where_the_shares_of_a_column_add_up_to():
    column = np.zeros((40, 3), np.float32)
    column[10:20, 0] = 1
    column[9, 0], column[20, 0] = 0.25, 0.5  # from 9.25 to 20 in px centres
    column[5:8, 1], column[15:18, 1] = 1, 0.9  # two openings: the one that was found counts
    upper, lower = train.true_borders(column, np.array([11.0, 14.0, 10.0]), np.array([18.0, 19.0, 12.0]))
    np.testing.assert_allclose(upper[:2], [9.25, 14.6], atol=1e-6)
    np.testing.assert_allclose(lower[:2], [20.0, 17.3], atol=1e-6)
    assert np.isnan(upper[2]) and np.isnan(lower[2])


@pytest.mark.slow
def test_the_border_stage_learns_how_far_off_the_borders_are(coarse, capsys):
    fine = train.train_stage(replace(train.FINE_STAGE, **TINY), partial(train.fine_example, coarse), scale=0.003)
    borders = train.train_borders(partial(train.border_example, coarse, fine), scale=0.01)
    assert borders.leaves.shape[2] == 1 and np.isfinite(borders.leaves).all()
    off, left = [], []
    for i in range(12):
        rng = np.random.default_rng([train.SEED, 4, UNSEEN + i])
        for maps, share in train.border_example(coarse, fine, train.SETS["border"], rng):
            known = np.isfinite(share)
            answer = 1 / (1 + np.exp(-log_odds(borders, maps, PAD, (0, 1), (0, len(share)))[0, 0]))
            off += np.abs(share - 0.5)[known].tolist()
            left += np.abs(share - answer)[known].tolist()
    assert np.mean(left) < 0.95 * np.mean(off)


# --- command line


def test_a_quick_try_does_not_replace_the_shipped_forests(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["train_lips.py", "--scale", "0.01"])
    with pytest.raises(SystemExit):
        train.main()
    assert "-o FILE" in capsys.readouterr().err


def test_an_album_that_cannot_be_made_is_refused(monkeypatch, capsys, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(train, "solve_motions", lambda *_: pytest.fail("began to train"))
    monkeypatch.setattr(sys, "argv", ["train_lips.py", "--album", str(tmp_path / "file")])
    with pytest.raises(SystemExit) as ended:
        train.main()
    assert ended.value.code == 2 and "--album FOLDER" in capsys.readouterr().err


def _rng():
    return np.random.default_rng(6)
