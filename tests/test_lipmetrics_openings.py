import cv2
import numpy as np
import pytest

from lipmetrics.openings import Identities, Identity, Opening, fullest_column, measure_outline
from lipmetrics.outline import fill_outlines, trace_outlines


def rectangle(row, col, height, width):
    corners = [(row, col), (row, col + width), (row + height, col + width), (row + height, col)]
    return np.array(corners, float)


def box(row, col, height, width) -> Opening:
    return measure_outline(rectangle(row, col, height, width))


def test_a_rectangle_is_measured_exactly():
    assert box(10.25, 20.5, 3.5, 8.0) == pytest.approx((10.25, 13.75, 20.5, 28.5, 8.0, 3.5, 28.0, 12.0, 24.5))


def test_direction_and_first_corner_do_not_matter():
    outline = np.array([(0, 0), (0, 9), (4, 7), (6, 2), (3, 1)], float)
    for other in (outline[::-1], np.roll(outline, 2, axis=0)):
        assert measure_outline(other) == pytest.approx(measure_outline(outline))


def test_an_ellipse_far_from_the_origin():
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    outline = np.column_stack([5000 + 10 * np.sin(angle), 7000 + 40 * np.cos(angle)])
    opening = measure_outline(outline)
    assert opening.width_px == pytest.approx(80)
    assert opening.height_px == pytest.approx(20)
    assert opening.area_px == pytest.approx(np.pi * 400, rel=1e-4)
    assert (opening.centroid_row, opening.centroid_col) == pytest.approx((5000, 7000))


def test_height_is_the_fullest_column_not_the_extent():
    slanted = np.array([(0, 0), (2, 0), (12, 10), (10, 10)], float)  # 12 px from top to bottom, 2 px high anywhere
    assert fullest_column(slanted) == pytest.approx(2.0)
    wedge = np.array([(0, 0), (4, 10), (0, 10)], float)  # highest at its right end
    assert fullest_column(wedge) == fullest_column(wedge * (1, -1)) == pytest.approx(4.0)
    crescent = np.array([(0, 0), (6, 5), (0, 10), (10, 5)], float)
    assert fullest_column(crescent) == pytest.approx(4.0)


def test_height_adds_up_what_is_inside_one_column():
    comb = np.array([(0, 0), (0, 6), (2, 6), (2, 2), (5, 2), (5, 6), (9, 6), (9, 0)], float)  # arms of 2 and 4 px
    assert fullest_column(comb) == pytest.approx(9.0)
    notched = np.array([(0, 0), (0, 6), (2, 6), (2, 2), (5, 2), (5, 6), (9, 6), (9, 2), (7, 2), (7, 0)], float)
    assert fullest_column(notched) == pytest.approx(7.0)


@pytest.mark.parametrize("outline", [[(3, 4)], [(3, 4), (3, 9)], [(3, 4), (8, 4)], [(1, 1), (2, 2), (3, 3)]])
def test_an_outline_without_area_is_measured_as_such(outline):
    opening = measure_outline(np.array(outline, float))
    assert opening.area_px == 0 and opening.height_px == 0
    assert np.all(np.isfinite(opening))


def test_traced_pixels_keep_their_width_height_and_area():
    rng = np.random.default_rng(3)
    for _ in range(200):
        mask = rng.random(rng.integers(1, 9, 2)) < 0.55
        outlines = trace_outlines(mask)
        assert len(outlines) == cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)[0] - 1
        for outline in outlines:
            filled = fill_outlines([outline], mask.shape)
            opening = measure_outline(outline)
            rows, cols = np.nonzero(filled)
            assert opening.area_px == pytest.approx(filled.sum())
            assert opening.height_px == pytest.approx(filled.sum(axis=0).max())
            assert opening.width_px == cols.max() - cols.min() + 1
            assert (opening.centroid_row, opening.centroid_col) == pytest.approx((rows.mean(), cols.mean()))
        assert np.all(fill_outlines(outlines, mask.shape) >= mask)  # holes are filled, nothing is lost


def test_a_traced_outline_holds_its_corners_only():
    mask = np.zeros((9, 12), bool)
    mask[2:6, 3:11] = True
    assert trace_outlines(mask)[0].tolist() == [[1.5, 2.5], [1.5, 10.5], [5.5, 10.5], [5.5, 2.5]]


def test_small_regions_are_left_out_and_the_largest_comes_first():
    mask = np.zeros((10, 20), bool)
    mask[1, 1] = mask[4:6, 1:4] = mask[3:8, 8:15] = True
    areas = [measure_outline(outline).area_px for outline in trace_outlines(mask, min_area_px=2)]
    assert areas == [35, 6]


def test_filling_takes_pixels_whose_centre_is_inside():
    assert np.argwhere(fill_outlines([rectangle(0.6, 1.4, 1.0, 2.0)], (4, 6))).tolist() == [[1, 2], [1, 3]]
    assert fill_outlines([rectangle(-5, -5, 50, 50)], (4, 6)).all()
    assert not fill_outlines([], (4, 6)).any()


def follow(*frames: list[Opening]) -> list[list[Identity]]:
    identities = Identities()
    return [identities.update(openings) for openings in frames]


def test_an_opening_that_moves_keeps_its_number():
    frames = [[box(50 + 4 * k, 40 + k, 2, 60)] for k in range(6)]  # by more than its own height
    assert [who[0].number for who in follow(*frames)] == [1] * 6


def test_events_of_a_merge():
    apart = [box(50, 20, 5, 10), box(50, 35, 8, 20)]
    first, merged, after = follow(apart, [box(50, 20, 8, 35)], [box(50, 20, 8, 35)])
    assert first == [Identity(1, "new"), Identity(2, "new")]
    assert merged == [Identity(2, "merge", (2, 1))]  # the larger one goes on
    assert after == [Identity(2)]


def test_events_of_a_split():
    _, split, after = follow([box(50, 20, 8, 35)], [box(50, 20, 5, 10), box(50, 35, 8, 20)], [box(50, 35, 8, 20)])
    assert split == [Identity(2, "split", (1,)), Identity(1)]
    assert after == [Identity(1)]


def test_neighbours_do_not_swap_when_one_of_them_grows():
    small, large = [box(50, 20, 4, 6), box(50, 28, 6, 30)], [box(48, 20, 9, 7), box(50, 28, 6, 30)]
    assert [[who.number for who in frame] for frame in follow(small, large, small[::-1])] == [[1, 2], [1, 2], [2, 1]]


def test_neighbours_do_not_swap_when_the_larger_one_almost_closes():
    frames = [box(50, 28, 6, 30), box(50, 20, 4, 6)], [box(50, 20, 4, 6), box(52, 30, 1, 20)]
    assert [[who.number for who in frame] for frame in follow(*frames)] == [[1, 2], [2, 1]]


def test_three_openings_become_one():
    three = [box(50, 10, 4, 10), box(50, 25, 6, 15), box(50, 45, 4, 9)]
    assert follow(three, [box(50, 10, 6, 44)])[1] == [Identity(2, "merge", (2, 1, 3))]


def test_a_mouth_that_was_closed_opens_anew():
    assert [who for who in follow([box(50, 20, 5, 10)], [], [box(50, 20, 5, 10)])] == [
        [Identity(1, "new")],
        [],
        [Identity(2, "new")],
    ]


def test_an_opening_elsewhere_is_new():
    assert follow([box(50, 20, 5, 10)], [box(50, 60, 5, 10)])[1] == [Identity(2, "new")]
