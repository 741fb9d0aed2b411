import numpy as np
import pytest
from contourpy import contour_generator  # which matplotlib needs
from scipy.ndimage import gaussian_filter

from lipmetrics.outline import fill_outlines, level_outlines


def area(outline):
    rows, cols = outline.T
    return abs(np.dot(rows, np.roll(cols, 1)) - np.dot(cols, np.roll(rows, 1))) / 2


def hill(centre, radius, size=(70, 90)):
    """(*size,) float32: radius less the distance from the centre, so the level 0 is a circle."""
    rows, cols = np.indices(size)
    return (radius - np.hypot(rows - centre[0], cols - centre[1])).astype(np.float32)


def test_a_circle_has_its_area_and_its_place():
    (outline,) = level_outlines(hill((30.3, 50.7), 18.4), 0.0)
    assert area(outline) == pytest.approx(np.pi * 18.4**2, rel=0.01)
    assert np.abs(np.hypot(*(outline - (30.3, 50.7)).T) - 18.4).max() < 0.05
    assert not np.array_equal(outline[0], outline[-1])  # the last point is not repeated
    assert outline.dtype == np.float64


@pytest.mark.parametrize("level", [-3.0, 0.0, 4.5])
def test_the_level_is_the_height_of_the_cut(level):
    (outline,) = level_outlines(hill((30.3, 50.7), 18.4), level)
    assert area(outline) == pytest.approx(np.pi * (18.4 - level) ** 2, rel=0.01)


def test_a_hole_is_filled():
    ring = np.minimum(hill((30.3, 45.2), 20.0), -hill((30.3, 45.2), 8.0))
    (outline,) = level_outlines(ring, 0.0)
    assert area(outline) == pytest.approx(np.pi * 20**2, rel=0.01)


def test_regions_come_largest_first():
    small, large, middle = ((15.3, 15.2), 6.0), ((40.2, 60.3), 20.0), ((50.3, 15.2), 11.0)
    outlines = level_outlines(np.max([hill(*each) for each in (small, large, middle)], axis=0), 0.0)
    assert [area(outline) for outline in outlines] == pytest.approx([np.pi * r**2 for r in (20, 11, 6)], rel=0.03)
    assert outlines[0].mean(axis=0) == pytest.approx((40.2, 60.3), abs=0.3)


def test_beyond_the_border_it_is_below_the_level():
    (outline,) = level_outlines(np.full((12, 20), 2.0, np.float32), 0.0)
    assert outline.min(axis=0) == pytest.approx((-0.5, -0.5), abs=0.5)
    assert outline.max(axis=0) == pytest.approx((11.5, 19.5), abs=0.5)
    (outline,) = level_outlines(hill((0.0, 45.0), 20.0), 0.0)
    assert area(outline) == pytest.approx(np.pi * 20**2 / 2, rel=0.06)


def test_nothing_above_the_level_has_no_outline():
    assert level_outlines(np.full((12, 20), -1.0, np.float32), 0.0) == []
    assert level_outlines(np.zeros((12, 20), np.float32), 0.0) == []


def test_a_single_pixel_is_a_small_region_around_its_centre():
    field = np.full((9, 9), -1.0, np.float32)
    field[3, 5] = 1.0
    (outline,) = level_outlines(field, 0.0)
    assert outline.mean(axis=0) == pytest.approx((3, 5), abs=0.01)
    assert area(outline) == pytest.approx(0.5, abs=0.01)


def test_the_field_is_left_as_it_was_and_the_answer_is_the_mask():
    field = np.maximum(hill((30.2, 30.1), 14.3), hill((42.4, 60.6), 17.7))
    before = field.copy()
    assert np.array_equal(fill_outlines(level_outlines(field, 0.0), field.shape), field > 0)
    assert np.array_equal(field, before)


@pytest.mark.parametrize("blur_px", [0.0, 0.5, 1.0, 3.0])
def test_outlines_are_those_of_contourpy(blur_px):
    rng = np.random.default_rng(0)
    for size in ((1, 1), (1, 9), (7, 1), (2, 2), (23, 40), (40, 23), (31, 31)):
        field = gaussian_filter(rng.normal(size=size), blur_px, mode="nearest").astype(np.float32)
        field /= np.abs(field).mean()
        for level in (0.0, 0.3, -0.4):
            z = np.pad(field, 1, constant_values=np.float32(level) - np.float32(1))
            lines = [line[:-1, ::-1] - 1 for line in contour_generator(z=z).lines(level)]
            expected = [line for line in lines if winding(line) > 0]
            outlines = level_outlines(field, level)
            assert sorted(map(len, outlines)) == sorted(map(len, expected))
            assert sorted(map(area, outlines)) == pytest.approx(sorted(map(area, expected)), abs=1e-5)
            assert corners(outlines) == pytest.approx(corners(expected), abs=1e-4)


def winding(outline):
    rows, cols = outline.T
    return np.dot(cols, np.roll(rows, -1)) - np.dot(rows, np.roll(cols, -1))


def corners(outlines):
    points = np.concatenate([*outlines, np.empty((0, 2))])
    return points[np.lexsort(np.round(points, 3).T)]
