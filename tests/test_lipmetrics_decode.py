from dataclasses import replace
from itertools import combinations_with_replacement, product

import numpy as np
import pytest
from drawn_mouth import PLAIN, opened, overlap, plain

from lipmetrics import decode as d
from lipmetrics.artificial import Shape
from lipmetrics.box import ASPECT
from lipmetrics.decode import Mouth, best_path, column_scores, decode, mean_path, switched


def paths(rows, cols, highest, lowest, reach):
    for path in product(range(rows), repeat=cols):
        inside = all(h <= row <= low for row, h, low in zip(path, highest, lowest, strict=True))
        if inside and max((abs(a - b) for a, b in zip(path[1:], path, strict=False)), default=0) < reach:
            yield np.array(path)


def sum_of(path, score, costs):
    return score[path, np.arange(len(path))].sum() - costs[np.abs(np.diff(path))].sum()


COSTS = np.array([0.0, 0.4, 1.1], np.float32)


def scores(rng, spread, shape):
    """Random scores (rows, cols), laid out as `decode` passes them on: code is compiled for each layout anew."""
    return rng.normal(0, spread, (*shape, 2)).astype(np.float32)[..., 0]


@pytest.mark.parametrize("bounded", [False, True])
def test_the_best_path_is_the_best_of_all_paths(bounded):
    rng = np.random.default_rng(0)
    for _ in range(20):
        score = scores(rng, 1, (5, 5))
        highest, lowest = np.zeros(5, np.int64), np.full(5, 4, np.int64)
        if bounded:
            highest, lowest = np.array([0, 1, 2, 1, 1]), np.array([3, 3, 4, 2, 3])
        found = best_path(score, highest, lowest, COSTS)
        sums = {tuple(path): sum_of(path, score, COSTS) for path in paths(5, 5, highest, lowest, len(COSTS))}
        assert tuple(found) == max(sums, key=sums.get)


def test_the_mean_path_is_the_mean_of_all_paths():
    rng = np.random.default_rng(1)
    highest, lowest = np.array([0, 1, 0, 0]), np.array([3, 3, 3, 2])
    for _ in range(10):
        score = scores(rng, 2, (4, 4))
        best = best_path(score, highest, lowest, COSTS)
        every = list(paths(4, 4, highest, lowest, len(COSTS)))  # all rows are within BAND of the best path
        weights = np.exp([sum_of(path, score, COSTS) / 1.5 for path in every])
        mean = np.average(every, axis=0, weights=weights)
        assert mean_path(score, best, highest, lowest, COSTS, 1.5) == pytest.approx(mean, abs=1e-5)


def test_switching_is_the_best_of_all_ways_to_switch():
    rng = np.random.default_rng(2)
    for _ in range(50):
        evidence = rng.normal(0, 1, 8)
        gains = {}
        for state in product((False, True), repeat=8):
            changes = np.count_nonzero(np.diff([0, *state, 0]))
            gains[state] = evidence[list(state)].sum() - 0.7 * changes
        assert tuple(switched(evidence, 0.7)) == max(gains, key=gains.get)


def test_column_scores_are_the_best_of_all_lips():
    rng = np.random.default_rng(3)
    odds = rng.normal(0, 2, (3, 7, 4)).astype(np.float32)
    above, below = np.empty((8, 4), np.float32), np.empty((8, 4), np.float32)
    begin, end = np.empty((8, 4), np.int16), np.empty((8, 4), np.int16)
    skin_only = np.empty(4, np.float32)
    column_scores(
        odds, np.float32(0), d._LOGISTIC, d._LOG_LIP, d._LOG_OPENING, d._LOG_SKIN, above, below, begin, end, skin_only
    )
    mouth, opening, low = 1 / (1 + np.exp(-odds.astype(float)))
    mouth = np.maximum(mouth, opening)
    low = np.maximum(low, 0.02)
    share = low / (low + np.maximum(mouth - opening - low, 0.02))
    skin, inside = np.log(0.3 + 0.7 * (1 - mouth)), np.log(0.03 + opening)
    lower, upper = np.log(0.05 + (mouth - opening) * share), np.log(0.05 + (mouth - opening) * (1 - share))
    for j in range(4):
        assert skin_only[j] == pytest.approx(skin[:, j].sum(), abs=0.1)
        for u, v in combinations_with_replacement(range(8), 2):
            best = {}
            for a, b in product(range(u + 1), range(v, 8)):
                parts = ((skin, 0, a), (upper, a, u), (inside, u, v), (lower, v, b), (skin, b, 7))
                thin = max(2 - (u - a), 0) + max(2 - (b - v), 0)
                best[a, b] = sum(part[top:bottom, j].sum() for part, top, bottom in parts) - thin
            assert above[u, j] + below[v, j] == pytest.approx(max(best.values()), abs=0.2)  # tables have steps
            assert best[int(begin[u, j]), int(end[v, j])] == pytest.approx(max(best.values()), abs=0.2)


def sure_odds(drawing, sure=3.0):
    """Log-odds (3, rows, cols) of one who knows the truth, never surer than `sure`."""
    return (sure * (2 * np.stack([drawing.lip, drawing.opening, drawing.lower]) - 1)).astype(np.float32)


def small(shape, face=PLAIN):
    """A drawing on the canvas: what is drawn with square px has ASPECT columns made one."""
    drawing = plain(shape, (112, 128), 64.0, centre=(52.0, 63.0), face=face)
    shares = {
        name: getattr(drawing, name).reshape(112, -1, ASPECT).mean(axis=-1) for name in ("lip", "opening", "lower")
    }
    corners = (drawing.corners + 0.5) / (1, ASPECT) - 0.5
    return replace(drawing, corners=corners, **shares)


@pytest.mark.parametrize("true_mw", [0.0, 0.06, 0.15, 0.4, 0.7])
def test_what_was_drawn_is_found_again(true_mw):
    drawing = small(opened(true_mw))
    mouth = decode(sure_odds(drawing))
    assert np.hypot(*((mouth.corners - drawing.corners) * (1, ASPECT)).T).max() < 4
    openings = mouth.openings(3.0)
    if true_mw == 0:
        assert openings == []
        return
    (opening,) = openings
    assert opening.height == pytest.approx(64 * true_mw, abs=1.5)
    assert overlap([opening.outline], drawing.opening) > (0.9 if true_mw > 0.1 else 0.7)
    assert opening.evidence > 25


def test_lips_that_stick_leave_two_openings():
    drawing = small(opened(0.2, glued=((-0.15, 0.2),)))
    openings = decode(sure_odds(drawing)).openings(3.0)
    assert len(openings) == 2
    assert overlap([each.outline for each in openings], drawing.opening) > 0.85


@pytest.mark.parametrize("place", ["under the lower lip", "between nose and upper lip", "in the lower lip"])
def test_what_has_no_lip_on_one_side_is_no_opening(place):
    drawing = small(Shape())
    odds = sure_odds(drawing)
    rows = np.flatnonzero(drawing.lip[:, 32] > 0.5)
    lower = np.flatnonzero(drawing.lower[:, 32] > 0.5)
    top = {
        "under the lower lip": rows[-1] + 3,
        "between nose and upper lip": rows[0] - 10,
        "in the lower lip": lower[len(lower) // 2] - 1,
    }[place]
    height = 3 if place == "in the lower lip" else 8
    odds[:2, top : top + height, 25:39] = 3.0
    odds[2, top : top + height, 25:39] = -3.0
    assert [each for each in decode(odds).openings(3.0) if each.evidence > 7.5] == []
    wide_open = sure_odds(small(opened(0.3)))
    assert decode(wide_open).openings(3.0)[0].evidence > 7.5


def test_teeth_and_tongue_do_not_break_an_opening():
    drawing = small(opened(0.35))
    odds = sure_odds(drawing)
    inside = drawing.opening > 0.5
    rows = np.flatnonzero(inside[:, 32])
    odds[1, rows[3] : rows[8], 27:37] = -1.0  # not seen as opening
    (opening,) = decode(odds).openings(3.0)
    assert overlap([opening.outline], drawing.opening) > 0.85


def test_borders_lie_between_pixels():
    """An edge that moves by parts of a pixel moves the border in the same direction, on the whole as far."""
    rows, across = np.arange(40)[:, None], np.abs(np.arange(60) - 29.5) < 25
    found = []
    for shift in np.arange(0, 1.01, 0.25):

        def band(top, bottom, shift=shift):
            edges = np.clip(np.minimum(rows - top - shift, bottom + shift - rows), -3, 3)
            return np.where(across, edges, -3).astype(np.float32)

        (opening,) = decode(np.stack([band(5, 33), band(14, 22), band(23, 33)])).openings(3.0)
        middle = np.abs(opening.outline[:, 1] - 29.5) < 10
        found.append(np.sort(opening.outline[middle, 0]))
    steps = np.diff(found, axis=0)
    assert steps.min() > 0
    assert steps.sum(axis=0) == pytest.approx(1, abs=0.01)


def test_noise_hardly_moves_the_borders():
    rng = np.random.default_rng(4)
    odds = sure_odds(small(opened(0.3)))
    noisy = [
        decode((odds + rng.normal(0, 1, odds.shape)).astype(np.float32)).openings(3.0)[0].height for _ in range(20)
    ]
    assert np.std(noisy) < 0.3


def test_a_region_gives_the_same_mouth_in_px_of_the_map():
    odds = sure_odds(small(opened(0.3)))
    whole, part = decode(odds), decode(odds, (20, 100, 10, 55))
    assert (whole.left, whole.right) == (part.left, part.right)
    assert whole.upper == pytest.approx(part.upper)
    assert whole.lower == pytest.approx(part.lower)


def test_nothing_is_found_on_nothing():
    assert decode(np.full((3, 30, 40), -4.0, np.float32)) is None
    assert decode(np.full((3, 30, 1), 4.0, np.float32)) is None


def test_quantiles_are_those_of_numpy():
    rng = np.random.default_rng(2)
    for count in (1, 2, 3, 64):
        values = rng.normal(size=count)
        for share in (0.0, 0.1, 0.5, 0.9, 1.0):
            assert d.quantile(values, share) == pytest.approx(np.quantile(values, share))


def test_sums_between_the_borders_are_those_of_a_mask():
    rng = np.random.default_rng(3)
    odds = rng.normal(0, 3, (20, 30)).astype(np.float32)
    top, bottom = rng.uniform(-1, 8, 12), rng.uniform(8, 20, 12)
    row = np.arange(20)[:, None]
    part = odds[:, 5:17][(row > top) & (row < bottom)]
    expected = part.size, (1 / (1 + np.exp(-part.astype(float)))).sum(), (part > 0).sum(), (odds > 0).sum()
    assert d.sums_inside(odds, 5, top, bottom) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("tip", [0.4, 0.6])
def test_an_opening_that_tapers_ends_where_it_tapers_to(tip):
    """Columns 10 to 29 of a rhombus whose ends lie `tip` columns farther out."""
    columns = np.arange(10, 30)
    half = 0.8 * np.minimum(columns - (10 - tip), 29 + tip - columns)
    level = np.full(20, 30.0)
    evidence = np.full(20, 5.0)
    mouth = Mouth(10, 30, level, level - 20, level + 20, level - half, level + half, evidence, evidence)
    (opening,) = mouth.openings(1.5)
    assert opening.outline[:, 1].min() == pytest.approx(10 - tip)
    assert opening.outline[:, 1].max() == pytest.approx(29 + tip)


def test_borders_can_be_sharpened_before_the_outline_is_made():
    level, evidence = np.full(8, 20.0), np.full(8, 5.0)
    mouth = Mouth(4, 12, level, level - 9, level + 9, level - 3, level + 3, evidence, evidence)
    (opening,) = mouth.openings(1.5, lambda left, upper, lower: (upper + left / 4, lower + 1))
    assert opening.height == pytest.approx(6)
    assert opening.outline[1:9, 0] == pytest.approx(18)
    assert opening.outline[10:, 0] == pytest.approx(24)
