"""Compiled vector operations against their plain numpy forms."""

import numpy as np
import pytest
from numba import njit

from simulator import simd


@njit
def exercise(records, starts, sums, values, run):
    x, y, z, w = simd.gather(records, starts, 0, run)
    simd.scatter_add(sums, starts, 0, x, y * 2.0 - z / (1.0 + y * y), -z, w)
    v = simd.load(values, 0)
    simd.store(values, 0, simd.inverse_cbrt(v))
    return simd.total(x), simd.lowest(y), simd.lowest(simd.poison_unless_positive(x * 0.0 + 1.0, v - 1.0))


@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_operations_match_numpy(real):
    rng = np.random.default_rng(0)
    lanes = simd.LANES[np.dtype(real)]
    records = rng.random((20, 4)).astype(real)
    starts = (4 * rng.integers(0, 6, lanes)).astype(np.int32)  # with repeats, which must add up
    values = rng.uniform(0.2, 3, lanes).astype(real)
    results = []
    for function in (exercise, exercise.py_func):
        sums, own = np.zeros_like(records), values.copy()
        results.append((function(records, starts, sums, own, 0), sums, own))
    (one, sums, own), (other, plain_sums, plain_own) = results
    tolerance = float(8 * np.finfo(real).eps)
    assert one == pytest.approx(other, rel=tolerance)
    assert np.allclose(sums, plain_sums, rtol=tolerance, atol=tolerance)
    assert np.allclose(own, plain_own, rtol=tolerance)


@njit
def both_ways(records, starts, sums, a, b, run):
    xa, ya, za, _ = simd.gather(records, starts, a, run)
    xb, yb, zb, _ = simd.gather(records, starts, b, run)
    simd.scatter_add_line(sums, starts, a, b, run, xa, ya, za, 2.0 * xb, yb, zb)


def test_a_run_reads_and_adds_the_same_as_numbers_do():
    rng = np.random.default_rng(1)
    records = rng.random((30, 4)).astype(np.float32)
    places = 4 * (5 + np.array(simd.RUN_ORDER))
    starts = np.concatenate([places, places + 4]).astype(np.int32)
    sums = np.zeros((2, 30, 4), np.float32)
    for run in (0, 1):
        both_ways(records, starts, sums[run], 0, 8, run)
    assert np.abs(sums[0]).max() > 1
    assert np.allclose(sums[0, :, :3], sums[1, :, :3], rtol=1e-6)
    assert np.isfinite(sums).all()


@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_inverse_cube_root_is_exact_to_rounding(real):
    x = np.geomspace(1e-3, 1e3, 100_001).astype(real)
    exact = x.astype(np.longdouble) ** (-np.longdouble(1) / 3)
    assert np.abs(simd.inverse_cbrt(x) / exact - 1).max() < 2 * np.finfo(real).eps


def test_nan_and_negative_volume_ratios_poison_the_lowest():
    low = np.full(8, 1e30, np.float32)
    for bad in (np.nan, -0.5, 0.0):
        value = np.full(8, 0.7, np.float32)
        value[3] = bad
        assert simd.poison_unless_positive(low, value).min() <= 0


@njit
def widened(wide, single, other, out):
    old = simd.load_along(single, wide, 0) + simd.zero_along(single, wide)
    new = simd.load_product_along(single, wide, single, other, 0) + simd.spread(single, wide, other, 1)
    simd.store(out, 0, old + new)


@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_products_and_values_per_record_match_numpy(real):
    rng = np.random.default_rng(2)
    single, other = rng.random((2, 8)).astype(np.float32)
    wide = rng.random(8).astype(real)
    out, plain = np.zeros((2, 8), real)
    widened(wide, single, other, out)
    widened.py_func(wide, single, other, plain)
    per_record = np.repeat(other[1:3], 4).astype(real)
    assert np.array_equal(out, plain)
    assert np.array_equal(out, wide + ((single * other).astype(real) + per_record))


@njit
def picked(records, starts, values, out):
    a, b = simd.load(values, 0), simd.load(values, simd.lanes(values))
    low = simd.square_root(simd.maximum(a, 0.0 * a))
    simd.scatter(records, starts, 0, a, simd.maximum(a, b), low, simd.choose(b, a, -b))
    simd.store(out, 0, simd.choose(a - b, b, a))


@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_larger_chosen_and_written_lanes_match_numpy(real):
    lanes = simd.LANES[np.dtype(real)]
    rng = np.random.default_rng(3)
    values = rng.standard_normal(2 * lanes).astype(real)
    values[[0, lanes, lanes + 1]] = 0.0  # not above 0, and two no larger than each other
    starts = (4 * rng.permutation(12)[:lanes]).astype(np.int32)
    records, out = np.full((12, 4), 7, real), np.empty(lanes, real)
    picked(records, starts, values, out)
    a, b = values.reshape(2, lanes)
    expected = np.full((12, 4), 7, real)
    columns = a, np.maximum(a, b), np.sqrt(np.maximum(a, 0)), np.where(b > 0, a, -b)
    expected[starts // 4] = np.stack(columns, axis=1)
    assert np.array_equal(records, expected)
    assert np.array_equal(out, np.minimum(a, b))
    plain, plain_out = np.full((12, 4), 7, real), np.empty(lanes, real)
    picked.py_func(plain, starts, values, plain_out)
    assert np.array_equal(plain, expected) and np.array_equal(plain_out, out)
