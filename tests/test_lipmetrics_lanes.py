"""Many curves aligned with one at a time against pair after pair, which has references of its own."""

import numpy as np
import pytest

from lipmetrics.compare import kernels, lanes, warping
from lipmetrics.compare.warping import best_paths, dtw_path
from lipmetrics.errors import InputError


def packed(curves):
    return np.concatenate(curves), np.concatenate([[0], np.cumsum([len(curve) for curve in curves])])


def curves(random, lengths, channels, whole_numbers=False):
    if whole_numbers:
        return [random.integers(0, 3, (n, channels)).astype(float) for n in lengths]
    return [random.normal(size=(n, channels)).cumsum(axis=0) for n in lengths]


def agree(many, ones, picks, many_first, cost, band):
    """Whether all costs and paths are exactly those of `dtw_path`, pair after pair."""
    share = -1.0 if band is None else band
    totals, lengths, paths = best_paths(
        *packed(many), np.array(picks), *packed(ones), many_first, cost == "squared", share
    )
    for a, pick in enumerate(picks):
        for b, one in enumerate(ones):
            order = (many[pick], one) if many_first else (one, many[pick])
            path, distance = dtw_path(*order, cost=cost, band=band)
            found = paths[a, b, -lengths[a, b] :]
            assert np.array_equal(found if many_first else found[:, ::-1], path)
            assert (np.sqrt(totals[a, b]) if cost == "squared" else totals[a, b]) == distance


@pytest.mark.parametrize("many_first", [True, False])
@pytest.mark.parametrize("cost", ["absolute", "squared"])
@pytest.mark.parametrize("band", [None, 0.0, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_equals_pair_after_pair(channels, band, cost, many_first):
    random = np.random.default_rng(1)
    many = curves(random, [30, 31, 1, 30, 47, 12, 30, 33, 2, 30, 61], channels)
    ones = curves(random, [30, 1, 45, 17], channels)
    agree(many, ones, [3, 0, 1, 7, 2, 4, 10, 9, 5, 8], many_first, cost, band)


@pytest.mark.parametrize("many_first", [True, False])
@pytest.mark.parametrize("band", [None, 0.2])
def test_ties_go_the_same_way(band, many_first):
    random = np.random.default_rng(2)
    for lengths in ([21] * 20, [17, 21, 19, 25, 21, 20, 18, 30, 23]):
        many, ones = curves(random, lengths, 1, True), curves(random, [17, 21, 26], 1, True)
        agree(many, ones, list(range(len(many))), many_first, "absolute", band)


@pytest.mark.parametrize("many_first", [True, False])
def test_more_channels_and_long_curves_go_pair_after_pair(many_first, monkeypatch):
    random = np.random.default_rng(3)
    agree(curves(random, [20, 31], 5), curves(random, [25], 5), [1, 0], many_first, "absolute", 0.2)
    monkeypatch.setattr(warping, "MOST_BYTES", 1000)
    monkeypatch.setattr(lanes, "warp", None)
    agree(curves(random, [20, 31], 2), curves(random, [25], 2), [1, 0], many_first, "absolute", 0.2)


def test_sums_that_are_not_finite_are_refused():
    many, ones = packed([np.full((3, 1), 1e308), np.ones((3, 1))]), packed([np.full((3, 1), -1e308)])
    with pytest.raises(InputError, match="too large to compare"):
        best_paths(*many, np.array([0, 1]), *ones, True, False, -1.0)


def test_lag_leaves_its_work_space_empty():
    random = np.random.default_rng(4)
    x, y = curves(random, [20, 25], 2)
    path, _ = dtw_path(x, y)
    moved = [kernels.moves(curve) for curve in (x, y)]
    assert np.allclose(moved[0][1:], np.abs(np.diff(x, axis=0)).sum(axis=1))
    weights = np.zeros(2 * 45)
    first = kernels.lag_half_samples(*moved, path.astype(np.int32), weights)
    assert not weights.any()
    assert kernels.lag_half_samples(*moved, path.astype(np.int32), weights) == first
