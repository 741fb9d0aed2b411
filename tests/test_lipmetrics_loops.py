import numpy as np
import pytest

from lipmetrics.loops import AREA, as_one, stretches, tables
from lipmetrics.openings import measure_outline


def loop_of(x, upper, lower):
    """(N, 2) loop with y down from heights above 0 at the same places."""
    x, upper, lower = (np.asarray(values, float) for values in (x, upper, lower))
    return np.concatenate([np.column_stack([x, -upper]), np.column_stack([x, -lower])[-2:0:-1]])


def by_columns(loop, gap, columns=50_001):
    """The same by brute force: open lengths of many columns, from the edges' crossings with each."""
    x = np.linspace(loop[:, 0].min(), loop[:, 0].max(), columns)[1:-1] + 1e-9
    crossings = []
    for a, b in zip(np.roll(loop, 1, axis=0), loop, strict=True):
        sign = np.sign(b[0] - a[0])
        inside = (x > min(a[0], b[0])) & (x <= max(a[0], b[0]))
        y = a[1] + (b[1] - a[1]) * (x - a[0]) / (b[0] - a[0]) if sign else np.zeros(len(x))
        crossings.append(np.where(inside, y, np.inf) + 0j * sign + 1j * np.where(inside, sign, 0))
    crossings = np.array(crossings)
    order = np.argsort(crossings.real, axis=0, kind="stable")
    y, sign = (np.take_along_axis(part, order, axis=0) for part in (crossings.real, crossings.imag))
    depth = np.cumsum(sign, axis=0)[:-1]
    with np.errstate(invalid="ignore"):
        length = np.where(depth > 0, np.diff(y, axis=0), 0.0).sum(axis=0)
    open_ = np.concatenate([[False], length > gap, [False]])
    edges = np.flatnonzero(np.diff(open_.astype(int)))
    step = x[1] - x[0]
    return [(x[a], x[b - 1], length[a:b].max(), length[a:b].sum() * step) for a, b in edges.reshape(-1, 2)]


def test_a_rectangle_is_measured_exactly():
    found = stretches(np.array([(1.0, 2), (5, 2), (5, 3), (1, 3)]))
    assert found.tolist() == [[1, 5, 2, 3, 1, 4, 3, 2.5]]


def test_one_opening_is_what_the_outline_of_it_measures():
    rng = np.random.default_rng(3)
    x = np.sort(rng.uniform(-10, 10, 25))
    upper, lower = rng.uniform(0.5, 4, 25), -rng.uniform(0.5, 4, 25)
    upper[[0, -1]] = lower[[0, -1]] = 0
    loop = loop_of(x, upper, lower)
    (found,) = stretches(loop)
    outline = measure_outline(loop[:, ::-1])
    left, right, top, bottom, height, area, x0, y0 = found
    assert [top, bottom, left, right] == pytest.approx(outline[:4])
    assert [right - left, height, area, y0, x0] == pytest.approx(outline[4:])


def test_an_opening_that_is_highest_at_its_upright_end():
    (found,) = stretches(np.array([(0.0, 0), (2, -1), (2, 1)]))
    assert found == pytest.approx([0, 2, -1, 1, 2, 2, 4 / 3, 0], abs=1e-7)


def test_rounding_does_not_join_openings_where_the_lips_touch():
    x = np.linspace(0, 10, 41)
    curve = np.abs(np.sin(np.pi * x / 5))  # 1e-16 at x = 5
    assert 0 < curve[20] < 1e-12
    assert len(stretches(loop_of(x, curve, -curve))) == 2


def test_two_openings_where_the_lips_touch_between_them():
    found = stretches(loop_of([0, 1, 2, 3, 4], [0, 1, 0, 2, 0], [0, 0, 0, 0, 0]))
    assert found[:, :2] == pytest.approx(np.array([[0, 2], [2, 4]]), abs=1e-7)
    assert found[:, AREA] == pytest.approx([1, 2])


def test_lips_that_pass_one_another_are_closed():
    found = stretches(loop_of([0, 1, 2, 3, 4], [0, 1, -1, 1, 0], [0] * 5))
    assert found[:, :2] == pytest.approx(np.array([[0, 1.5], [2.5, 4]]), abs=1e-7)
    assert len(stretches(loop_of([0, 1, 2, 3, 4], [0, -1, -1, -1, 0], [0] * 5))) == 0


def test_an_opening_ends_where_the_lips_are_nearer_than_the_gap():
    (found,) = stretches(loop_of([0, 2, 4], [0, 1, 0], [0, -1, 0]), gap=0.5)
    assert found[[0, 1, 4]] == pytest.approx([0.5, 3.5, 2])
    assert found[AREA] == pytest.approx(4 - 2 * 0.5 * 0.5 / 2)
    assert len(stretches(loop_of([0, 2, 4], [0, 1, 0], [0, -1, 0]), gap=2.0)) == 0


@pytest.mark.parametrize("gap", [0.0, 0.3])
def test_tangled_loops_are_as_by_brute_force(gap):
    rng = np.random.default_rng(5)
    for _ in range(6):
        angle = np.linspace(np.pi, 3 * np.pi, 15)[:-1]  # from the left corner over the top, and wider than its corners
        loop = np.column_stack([np.cos(angle), 0.4 * np.sin(angle)]) + rng.normal(0, 0.25, (14, 2))
        found, slow = stretches(loop, gap), [row for row in by_columns(loop, gap) if row[1] - row[0] > 1e-3]
        found = found[found[:, 1] - found[:, 0] > 1e-3]
        assert len(found) == len(slow)
        for one, (left, right, height, area) in zip(found, slow, strict=True):
            assert one[[0, 1, 4, 5]] == pytest.approx([left, right, height, area], abs=1e-3)


def test_a_loop_that_bulges_beyond_its_corners_is_open_there():
    loop = np.array([(0, 0), (-1, -1), (2, -1), (1, 0), (2, 1), (-1, 1.0)])
    (found,) = stretches(loop)
    assert found[[0, 1]] == pytest.approx([-1, 2])
    assert found[AREA] == pytest.approx(4)  # the trapezium of 3 and 1 by 1, twice


def test_several_pieces_as_one():
    pieces = stretches(loop_of([0, 1, 2, 3, 4], [0, 1, 0, 2, 0], [0] * 5))
    (one,) = as_one(pieces)
    assert one[:6] == pytest.approx([0, 4, -2, 0, 2, 3], abs=1e-7)
    assert one[6] == pytest.approx((1 * 1 + 2 * 3) / 3)
    assert len(as_one(pieces[:0])) == 0


def test_tables_follow_openings_that_split_and_merge():
    def frame(*spans):
        return np.array([[a, b, 0, 1, 1, b - a, (a + b) / 2, 0.5] for a, b in spans], float).reshape(-1, 8)

    found = [frame(), frame((0, 4)), frame((0, 1.8), (2, 4)), frame((0, 4)), None, frame((1, 3))]
    channels, openings = tables(np.arange(6) / 10, found, mouth_width=5)
    assert np.array_equal(channels["n_openings"], [0, 1, 2, 1, np.nan, 1], equal_nan=True)
    assert np.array_equal(channels["width"], [0, 4, 2, 4, np.nan, 2], equal_nan=True)
    assert np.allclose(channels["total_area"], [0, 4, 3.8, 4, np.nan, 2], equal_nan=True)
    assert openings["event"].tolist() == ["new", "split", "", "merge", ""]
    assert openings["opening"].tolist() == [1, 2, 1, 1, 1]
    assert openings["parents"].tolist() == ["", "1", "", "1+2", ""]
    assert openings["frame"].tolist() == [1, 2, 2, 3, 5]


def test_an_opening_that_closes_beside_another_does_not_merge_with_it():
    both = np.array([(0, 1.8, 0, 1, 1, 1.8, 0.9, 0.5), (2, 4, 0, 1, 1, 2, 3, 0.5)])
    one = both[1:]
    _, openings = tables(np.arange(2) / 10, [both, one], mouth_width=5)
    assert openings["event"].tolist() == ["new", "new", ""] and openings["opening"].tolist() == [1, 2, 2]
