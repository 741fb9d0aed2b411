import numpy as np

from lipmetrics.outline import fill_outlines, trace_outlines


def area(outline):
    rows, cols = outline.T
    return abs(np.dot(rows, np.roll(cols, 1)) - np.dot(cols, np.roll(rows, 1))) / 2


def test_what_is_traced_and_filled_is_the_mask():
    rng = np.random.default_rng(0)
    mask = np.zeros((40, 60), bool)
    for _ in range(12):
        top, left = rng.integers(0, (36, 54))
        mask[top : top + rng.integers(2, 12), left : left + rng.integers(2, 12)] = True
    mask[20, 30] = True
    before = mask.copy()
    outlines = trace_outlines(mask)
    filled = fill_outlines(outlines, mask.shape)
    assert filled[mask].all()
    holes = filled & ~mask  # are filled
    assert sum(map(area, outlines)) == np.count_nonzero(mask) + np.count_nonzero(holes)
    assert [area(each) for each in outlines] == sorted(map(area, outlines), reverse=True)
    assert np.array_equal(mask, before)


def test_a_hole_is_filled():
    ring = np.ones((8, 9), bool)
    ring[3:5, 3:6] = False
    (outline,) = trace_outlines(ring)
    assert fill_outlines([outline], (10, 12))[:8, :9].all()
    assert area(outline) == 72


def test_a_pixel_is_inside_when_its_centre_is():
    triangle = np.array([(0.4, 0.4), (0.4, 5.6), (5.6, 0.4)])
    rows, cols = np.indices((7, 7))
    inside = (rows > 0.4) & (cols > 0.4) & (rows + cols < 6.0)
    assert np.array_equal(fill_outlines([triangle], (7, 7)), inside)
