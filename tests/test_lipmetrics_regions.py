import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, label

from lipmetrics.regions import likeliest_region, middle_row, sums_over


def test_the_likeliest_region_is_the_one_with_the_most_weight():
    rng = np.random.default_rng(0)
    for _ in range(20):
        odds = (40 * gaussian_filter(rng.normal(size=(60, 70)), 2)).astype(np.float32)
        weight = rng.random(odds.shape).astype(np.float32)
        part = np.zeros(odds.shape, bool)
        part[7:47, 11:61] = True
        labels, count = label((odds > 0) & part)
        scores = [(weight * np.minimum(odds, 3))[labels == k].sum() for k in range(1, count + 1)]
        expected = labels == 1 + np.argmax(scores)
        mask, (left, top, width, height, area) = likeliest_region(odds, weight, (7, 47, 11, 61))
        assert np.array_equal(mask, expected)
        rows, cols = np.nonzero(expected)
        assert (left, top, area) == (cols.min(), rows.min(), len(rows))
        assert (width, height) == (np.ptp(cols) + 1, np.ptp(rows) + 1)


@pytest.mark.parametrize(
    ("odds_of_ten", "odds_of_six", "tenfold"), [(2.0, 50.0, True), (0.5, 3.0, False)], ids=["no more than 3", "up to 3"]
)
def test_how_much_log_odds_count(odds_of_ten, odds_of_six, tenfold):
    odds = np.full((9, 20), -1.0, np.float32)
    odds[2, :10], odds[5, :6] = odds_of_ten, odds_of_six
    mask, (*_, area) = likeliest_region(odds, np.ones_like(odds), (0, 9, 0, 20))
    assert area == mask.sum() == (10 if tenfold else 6)


def test_where_nothing_is_above_0_there_is_no_region():
    nothing = np.zeros((9, 9), np.float32)
    assert likeliest_region(nothing, np.ones_like(nothing), (0, 9, 0, 9)) is None


def test_sums_over_a_mask():
    rng = np.random.default_rng(0)
    odds, mask = rng.normal(size=(30, 40)).astype(np.float32), rng.random((30, 40)) < 0.3
    mask[:7], mask[25:] = False, False
    expected = (mask.sum(), odds[mask].sum(dtype=float), (odds > 0).sum())
    assert sums_over(odds, mask, 7, 25) == pytest.approx(expected)


def test_the_middle_of_the_rows_with_a_pixel_in_some_columns():
    mask = np.zeros((20, 30), bool)
    mask[[3, 4, 12], [5, 7, 6]] = True
    mask[19, 8] = mask[1, 4] = True
    assert middle_row(mask, 5, 8) == pytest.approx((3 + 4 + 12) / 3)
