"""Warping paths against all paths, a matrix worked by hand, a plain table, and two other codes."""

import numpy as np
import pytest

from lipmetrics.compare.kernels import band_width
from lipmetrics.compare.warping import dtw_path
from lipmetrics.errors import InputError

COSTS = ("absolute", "squared")


def rng():
    return np.random.default_rng(5)


def local(x, y, cost):
    x, y = np.reshape(x, (len(x), -1)), np.reshape(y, (len(y), -1))
    gap = x[:, None] - y[None]
    return (gap**2).sum(axis=2) if cost == "squared" else np.abs(gap).sum(axis=2)


def allowed(n, m, band):
    """The band's rule as the documentation has it."""
    if band is None:
        return np.ones((n, m), bool)
    radius = int(np.floor(band * (max(n, m) - 1) + 1e-9))
    i, j = np.indices((n, m))
    return (j - i <= radius + max(0, m - n)) & (i - j <= radius + max(0, n - m))


def all_paths(n, m, i=0, j=0):
    if (i, j) == (n - 1, m - 1):
        yield [(i, j)]
        return
    for di, dj in ((1, 1), (1, 0), (0, 1)):
        if i + di < n and j + dj < m:
            for rest in all_paths(n, m, i + di, j + dj):
                yield [(i, j), *rest]


def table(x, y, cost, band=None):
    """Distance and path from a plain table, ties looking back: diagonal, i - 1, j - 1."""
    costs = np.where(allowed(len(x), len(y), band), local(x, y, cost), np.inf)
    n, m = costs.shape
    sums = np.full((n + 1, m + 1), np.inf)
    sums[0, 0] = 0
    for i in range(n):
        for j in range(m):
            sums[i + 1, j + 1] = costs[i, j] + min(sums[i, j], sums[i, j + 1], sums[i + 1, j])
    i, j = n, m
    path = [(n - 1, m - 1)]
    while (i, j) != (1, 1):
        steps = [(i - 1, j - 1), (i - 1, j), (i, j - 1)]
        i, j = min(steps, key=lambda at: sums[at])
        path.append((i - 1, j - 1))
    total = sums[n, m]
    return np.array(path[::-1]), float(np.sqrt(total) if cost == "squared" else total)


@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize("band", [None, 0.0, 0.3])
@pytest.mark.parametrize(("n", "m"), [(1, 1), (1, 4), (3, 1), (2, 2), (4, 4), (5, 3), (3, 6), (5, 5)])
def test_no_monotone_path_is_cheaper(n, m, band, cost):
    random = rng()
    inside = allowed(n, m, band)
    for channels in (1, 2, 3):
        x, y = random.normal(size=(n, channels)), random.normal(size=(m, channels))
        costs = local(x, y, cost)
        sums = [sum(costs[at] for at in path) for path in all_paths(n, m) if all(inside[at] for at in path)]
        best = min(sums) if cost == "absolute" else np.sqrt(min(sums))
        path, distance = dtw_path(x, y, cost=cost, band=band)
        assert distance == pytest.approx(best, rel=1e-12)
        assert all(inside[tuple(at)] for at in path)
        total = sum(costs[tuple(at)] for at in path)
        assert distance == pytest.approx(total if cost == "absolute" else np.sqrt(total), rel=1e-12)


def test_example_worked_by_hand():
    """The table of least costs, filled by hand as in Mueller, Information Retrieval for Music and Motion (2007), 4.1.

    x = 1 3 9 2 1 (rows) against y = 2 0 0 8 7 2 (columns), absolute local cost.
    """
    sums = [
        [1, 2, 3, 10, 16, 17],
        [2, 4, 5, 8, 12, 13],
        [9, 11, 13, 6, 8, 15],
        [9, 11, 13, 12, 11, 8],
        [10, 10, 11, 18, 17, 9],
    ]
    x, y = [1, 3, 9, 2, 1], [2, 0, 0, 8, 7, 2]
    found = [[dtw_path(x[: i + 1], y[: j + 1])[1] for j in range(6)] for i in range(5)]
    assert found == sums
    path, distance = dtw_path(x, y)
    assert distance == 9
    assert path.tolist() == [[0, 0], [0, 1], [1, 2], [2, 3], [2, 4], [3, 5], [4, 5]]


@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize("band", [None, 0.0, 0.1, 0.5])
@pytest.mark.parametrize(
    ("n", "m", "channels"), [(40, 40, 1), (33, 70, 2), (70, 33, 3), (64, 65, 4), (30, 31, 6), (9, 90, 5)]
)
def test_equals_plain_table(n, m, channels, band, cost):
    random = rng()
    x, y = random.normal(size=(n, channels)).cumsum(axis=0), random.normal(size=(m, channels)).cumsum(axis=0)
    expected_path, expected = table(x, y, cost, band)
    path, distance = dtw_path(x, y, cost=cost, band=band)
    assert distance == pytest.approx(expected, rel=1e-12)
    assert np.array_equal(path, expected_path)


@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize("band", [None, 0.2])
def test_ties_go_diagonal_then_first_then_second(band, cost):
    random = rng()
    for _ in range(30):
        x, y = random.integers(0, 3, 21).astype(float), random.integers(0, 3, 17).astype(float)
        assert np.array_equal(dtw_path(x, y, cost=cost, band=band)[0], table(x, y, cost, band)[0])


def test_multiplied_values_multiply_the_distance_in_both_costs():
    x, y = rng().normal(size=(2, 30))
    for cost in COSTS:
        assert dtw_path(3 * x, 3 * y, cost=cost)[1] == pytest.approx(3 * dtw_path(x, y, cost=cost)[1])


def test_costs_differ_as_stated():
    path, distance = dtw_path([0.0, 0.0], [3.0, 4.0])
    assert distance == 7
    path, distance = dtw_path([0.0, 0.0], [3.0, 4.0], cost="squared")
    assert distance == 5
    assert path.tolist() == [[0, 0], [1, 1]]


def test_single_samples_and_constants():
    path, distance = dtw_path([2.0], [5.0])
    assert (path.tolist(), distance) == ([[0, 0]], 3.0)
    path, distance = dtw_path([2.0], [5.0, 1.0, 2.0], band=0.0)
    assert (path.tolist(), distance) == ([[0, 0], [0, 1], [0, 2]], 4.0)
    path, distance = dtw_path(np.ones(20), np.ones(20))
    assert distance == 0
    assert np.array_equal(path, np.stack([np.arange(20)] * 2, axis=1))


def test_integers_lists_and_strided_arrays_are_taken():
    x = np.arange(20.0).reshape(10, 2)
    assert dtw_path(x[:, 0].tolist(), x[:, 0].astype(np.int32))[1] == 0
    assert dtw_path(x[::2, ::-1], np.asfortranarray(x[::2, ::-1]))[1] == 0


@pytest.mark.parametrize(("n", "m"), [(n, m) for n in (2, 3, 7, 10, 21) for m in (2, 3, 8, 10, 40)])
@pytest.mark.parametrize("band", [0.0, 0.05, 0.3, 1.0])
def test_band_is_symmetric_reversible_and_connected(n, m, band):
    inside = allowed(n, m, band)
    assert np.array_equal(inside, allowed(m, n, band).T)
    assert np.array_equal(inside, inside[::-1, ::-1])
    forth, _ = dtw_path(np.zeros(n), np.zeros(m), band=band)
    assert all(inside[tuple(at)] for at in forth)
    steps = np.diff(forth, axis=0)
    assert set(map(tuple, steps)) <= {(1, 1), (1, 0), (0, 1)}
    random = rng()
    x, y = random.normal(size=n), random.normal(size=m)
    distance = dtw_path(x, y, band=band)[1]
    assert distance == pytest.approx(dtw_path(y, x, band=band)[1], rel=1e-12)
    assert distance == pytest.approx(dtw_path(x[::-1], y[::-1], band=band)[1], rel=1e-12)
    if n == m:
        i, j = np.indices((n, m))
        assert np.array_equal(inside, abs(i - j) <= np.floor(band * (n - 1) + 1e-9))


def test_band_radius_in_samples_of_the_longer():
    assert band_width(101, 101, 0.1) == 10
    assert band_width(101, 51, 0.29) == 29  # 0.29 x 100 is a little less than 29 in binary
    assert band_width(1, 1, 0.5) == 0
    assert band_width(11, 11, -1.0) == -1


def test_whole_band_changes_nothing():
    x, y = rng().normal(size=(2, 50))
    assert np.array_equal(dtw_path(x, y, band=1.0)[0], dtw_path(x, y)[0])


@pytest.mark.parametrize(
    ("x", "y", "message"),
    [
        ([], [1.0], "x: expected at least one sample"),
        ([1.0], np.zeros((0, 2)), "y: expected at least one sample"),
        (np.zeros((3, 0)), [1.0], "at least one sample and one channel"),
        ([1.0, np.nan, 2.0], [1.0], "x: expected finite values, got nan at sample 1, channel 0"),
        ([1.0], [[0.0, np.inf]], "y: expected finite values, got inf at sample 0, channel 1"),
        ([1.0, 2.0], [1.0, np.nan], "y: expected finite values"),
        (np.zeros((5, 3)), np.zeros((5, 1)), "same number of channels in x and y, got 3 and 1"),
        (np.zeros((5, 3)), np.zeros((5, 5)), "got 3 and 5"),
        (np.zeros((5, 3, 1)), np.zeros(5), r"expected shape \(samples,\) or \(samples, channels\), got \(5, 3, 1\)"),
        (["a"], [1.0], "x: expected numbers"),
        (3.0, [1.0], "expected shape"),
        ([1e308, 1e308], [-1e308, -1e308], "too large"),
    ],
)
def test_refused_curves(x, y, message):
    with pytest.raises(InputError, match=message):
        dtw_path(x, y)


@pytest.mark.parametrize("band", [-0.1, 1.5, "wide", np.nan, True])
def test_refused_band(band):
    with pytest.raises(InputError, match="expected a band from 0 to 1"):
        dtw_path([1.0, 2.0], [1.0, 2.0], band=band)


def test_refused_cost_names_the_nearest():
    with pytest.raises(InputError, match=r"got 'squard'; did you mean 'squared'\?"):
        dtw_path([1.0], [1.0], cost="squard")


def test_refused_size_before_any_memory_is_taken():
    with pytest.raises(InputError, match="too many to align"):
        dtw_path(np.zeros(200_000), np.zeros(200_000))


@pytest.mark.parametrize(("n", "m"), [(60, 60), (40, 73)])
def test_equals_tslearn(n, m):
    """Same local cost (squared, root of the sum), tie rule and band. Left out: NaN, at which tslearn trims."""
    metrics = pytest.importorskip("tslearn.metrics")
    random = rng()
    for channels in (1, 3):
        x, y = random.normal(size=(n, channels)).cumsum(axis=0), random.normal(size=(m, channels)).cumsum(axis=0)
        expected_path, expected = metrics.dtw_path(x, y, be="numpy")
        path, distance = dtw_path(x, y, cost="squared")
        assert distance == pytest.approx(expected, rel=1e-12)
        assert np.array_equal(path, expected_path)
        for radius in (6, 15):
            banded = metrics.dtw_path(x, y, be="numpy", global_constraint="sakoe_chiba", sakoe_chiba_radius=radius)
            path, distance = dtw_path(x, y, cost="squared", band=radius / (max(n, m) - 1))
            assert distance == pytest.approx(banded[1], rel=1e-12)
            assert np.array_equal(path, banded[0])


@pytest.mark.parametrize(("n", "m"), [(60, 60), (40, 73)])
def test_equals_dtaidistance(n, m):
    """Same local cost (squared, root of the sum); its window is our radius + 1.

    Left out: `distance_fast` with pruning (infinite for near-diagonal paths), `use_lowmem`, other local costs in C.
    """
    dtw_ndim = pytest.importorskip("dtaidistance.dtw_ndim")
    random = rng()
    x, y = random.normal(size=(n, 3)).cumsum(axis=0), random.normal(size=(m, 3)).cumsum(axis=0)
    path, distance = dtw_path(x, y, cost="squared")
    expected_path, expected = dtw_ndim.warping_path(x, y, include_distance=True)
    assert distance == pytest.approx(expected, rel=1e-12)
    assert np.array_equal(path, expected_path)
    for radius in (6, 15):
        banded = dtw_ndim.warping_path(x, y, include_distance=True, window=radius + 1)
        path, distance = dtw_path(x, y, cost="squared", band=radius / (max(n, m) - 1))
        assert distance == pytest.approx(banded[1], rel=1e-12)
        assert np.array_equal(path, banded[0])
