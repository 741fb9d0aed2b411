"""Sizes of polygons and masks of them, against the measurement's own code and against numbers by hand."""

import numpy as np
import pytest

from lipmetrics.openings import measure_outline
from lipmetrics.outline import fill_outlines
from simulator.polygons import SIZES, mask, measure


def sizes(polygon):
    polygon = np.array(polygon, float)
    return dict(zip(SIZES, measure(polygon, np.array([0, len(polygon)]))[0], strict=True))


def star(rng, corners=25):
    """A simple polygon that is not convex."""
    angle = np.sort(rng.uniform(0, 2 * np.pi, corners))
    radius = rng.uniform(3, 12, corners)
    return np.stack([20 + radius * np.sin(angle), 31 + 2 * radius * np.cos(angle)], axis=1)


def test_a_tilted_bar_is_as_high_as_its_fullest_column():
    bar = sizes([(0, 0), (10, 10), (13, 10), (3, 0)])
    assert (bar["width"], bar["height"], bar["area"]) == pytest.approx((10, 3, 30))
    assert (bar["row_min"], bar["row_max"], bar["col_min"], bar["col_max"]) == (0, 13, 0, 10)
    assert (bar["centroid_row"], bar["centroid_col"]) == pytest.approx((6.5, 5))


def test_two_arms_in_one_column_count_together():
    u = sizes([(0, 0), (0, 10), (9, 10), (9, 0), (7, 0), (7, 8), (2, 8), (2, 0)])
    assert u["height"] == pytest.approx(9)  # the full bar on the right
    assert sizes([(0, 0), (0, 10), (2, 10), (2, 1), (8, 1), (8, 10), (9, 10), (9, 0)])["height"] == pytest.approx(9)


def test_sizes_are_those_of_the_measurement():
    rng = np.random.default_rng(3)
    stars = [star(rng) for _ in range(20)]
    start = np.cumsum([0, *map(len, stars)])
    expected = np.array([tuple(measure_outline(one)) for one in stars])
    np.testing.assert_allclose(measure(np.concatenate(stars), start), expected, rtol=1e-9, atol=1e-9)


def test_mask_is_true_where_the_centre_is_inside():
    polygon = np.array([(0.5, 0.5), (0.5, 3.5), (2.5, 3.5), (2.5, 0.5)])
    expected = np.zeros((4, 6), bool)
    expected[1:3, 1:4] = True
    np.testing.assert_array_equal(mask([polygon], (4, 6)), expected)


def test_masks_are_those_of_the_measurement_also_beyond_the_picture():
    rng = np.random.default_rng(4)
    stars = [star(rng) - (6, 20), star(rng), star(rng) + 100]
    np.testing.assert_array_equal(mask(stars, (30, 50)), fill_outlines(stars, (30, 50)))


def test_no_polygon_is_no_row():
    assert measure(np.zeros((0, 2)), np.zeros(1, int)).shape == (0, 9)
    assert not mask([], (3, 4)).any()
