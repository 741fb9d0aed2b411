"""Polygons of what is seen between the lips, against dense sampling and against shapes worked out by hand."""

import numpy as np
import pytest
from moved_mouth import moved_mouth

from simulator.aperture import COAT_M, SEEN_M, lip_edges, mouth_edges, runs, shown_positions, visible
from simulator.errors import InputError
from simulator.motion import BROKEN, INTACT, STICKING
from simulator.polygons import SIZES, measure

X, FILM = np.arange(7) * 1e-3, 4e-4


def lips(gap, x=X):
    """Nodes (1, C, 2, 3) of upper and lower edges with a gap over the film, and the same at rest."""

    def edge(y):
        flat = np.stack([x, y, np.zeros(len(x))], axis=-1)
        return np.stack([flat, flat - [0, 0, 0.006]], axis=1)

    zero = np.zeros(len(x))
    return edge(zero)[None], edge(-FILM - np.asarray(gap, float))[None], edge(zero), edge(zero - FILM)


def seen_area(upper, lower, samples=200_001):
    """Area between the lips of one run and number of its pieces, by looking at many places along the mouth."""
    low = max(edge[:, 0].min() for lip in (upper, lower) for edge in (lip[:, 0], lip[:, 1]))
    high = min(edge[:, 0].max() for lip in (upper, lower) for edge in (lip[:, 0], lip[:, 1]))
    u = np.linspace(low, high, samples)

    def furthest(lip, better):
        found = np.full(samples, np.nan)
        pairs = [(lip[c, e], lip[c + 1, e]) for c in range(len(lip) - 1) for e in (0, 1)]
        for p, q in [*pairs, *((column[0], column[1]) for column in lip)]:
            if p[0] != q[0]:
                on = (u >= min(p[0], q[0])) & (u <= max(p[0], q[0]))
                found[on] = better(found[on], p[1] + (q[1] - p[1]) * (u[on] - p[0]) / (q[0] - p[0]))
        return found

    between = furthest(lower, np.fmin) - furthest(upper, np.fmax)
    is_open = between > 0
    return np.clip(between, 0, None).mean() * (high - low), int(np.sum(np.diff(is_open.astype(int), prepend=0) == 1))


def area(pieces):
    return measure(pieces.points, pieces.start)[:, SIZES.index("area")]


def test_closed_lips_are_closed_exactly_and_open_ones_by_what_is_over_the_film():
    gap = np.array([0, 1, 2, 3, 2, 1, 0]) * 1e-3
    upper, lower, *rest = lips(gap)
    edges = lip_edges(upper, lower, *rest, np.full((1, 6), BROKEN))
    np.testing.assert_array_equal(edges.upper[:, [0, -1]], edges.lower[:, [0, -1]])
    np.testing.assert_allclose(
        np.linalg.norm(edges.upper - edges.lower, axis=-1)[0, :, 0], np.maximum(gap - COAT_M, 0), atol=1e-15
    )
    np.testing.assert_allclose(edges.upper[0, 3, 0], upper[0, 3, 0] - [0, (FILM + COAT_M) / 2, 0], atol=1e-15)


def test_lips_that_have_passed_one_another_are_closed():
    upper, lower, *rest = lips(np.full(7, -3 * FILM))
    edges = lip_edges(upper, lower, *rest, np.full((1, 6), BROKEN))
    assert not edges.gap_m.any() and not edges.loose.any()
    np.testing.assert_array_equal(edges.upper, edges.lower)


def test_an_intact_element_closes_both_its_columns():
    upper, lower, *rest = lips(np.full(7, 1e-3))
    state = np.array([[BROKEN, BROKEN, INTACT, STICKING, STICKING, BROKEN]])
    edges = lip_edges(upper, lower, *rest, state)
    np.testing.assert_array_equal(edges.gap_m[0] > 0, [1, 1, 0, 0, 1, 1, 1])
    np.testing.assert_array_equal(edges.loose[0], [1, 1, 0, 1, 1, 1])


def test_a_gap_that_is_not_seen_is_no_opening():
    upper, lower, *rest = lips(np.full(7, 0.9 * SEEN_M))
    assert not lip_edges(upper, lower, *rest, np.full((1, 6), BROKEN)).loose.any()


def test_edges_are_drawn_apart_where_intact_saliva_is_drawn_out():
    upper, lower, *rest = lips(np.full(7, 1e-3))
    drawn = lip_edges(upper, lower, *rest)
    np.testing.assert_array_equal(drawn.upper, lip_edges(upper, lower, *rest, np.full((1, 6), BROKEN)).upper)
    np.testing.assert_allclose(drawn.gap_m, 1e-3 - COAT_M)
    assert not lip_edges(upper, lower, *rest, np.full((1, 6), INTACT)).gap_m.any()


def test_only_the_edges_of_a_mouth_are_drawn_elsewhere():
    mouth, motion = moved_mouth(times=3)
    shown = shown_positions(mouth, motion.positions)
    edges = mouth_edges(mouth, motion.positions, motion.saliva.state)  # all saliva that is open is broken
    np.testing.assert_array_equal(shown[2][mouth.upper], edges.upper[2])
    np.testing.assert_array_equal(shown[2][mouth.lower], edges.lower[2])
    others = np.setdiff1d(np.arange(len(mouth.nodes)), np.concatenate([mouth.upper, mouth.lower]))
    np.testing.assert_array_equal(shown[:, others], motion.positions[:, others])
    with pytest.raises(InputError, match=r"expected positions of shape \(T, 1888, 3\), got \(1888, 3\)"):
        mouth_edges(mouth, motion.positions[0])


def test_runs():
    loose = np.array([[1, 1, 0, 1], [0, 0, 0, 0], [0, 1, 1, 1]], bool)
    frame, first, last = runs(loose)
    np.testing.assert_array_equal(np.stack([frame, first, last], 1), [[0, 0, 1], [0, 3, 3], [2, 1, 3]])


def flat(rows_of_outer, rows_of_inner, u=None):
    """(1, C, 2, 2) edges in the picture."""
    u = np.arange(len(rows_of_outer), dtype=float) if u is None else u
    return np.stack([np.stack([u, rows], -1) for rows in (rows_of_outer, rows_of_inner)], axis=1)[None]


def test_the_side_that_hangs_lower_bounds_the_opening():
    # Outer edge straight at 0, inner edge a tent that hangs from -1 to 1 and back: it cuts in between 0.5 and 1.5.
    upper, lower = flat([0.0, 0.0, 0.0], [-1.0, 1.0, -1.0]), flat([3.0, 3.0, 3.0], [4.0, 4.0, 4.0])
    pieces = visible(upper, lower, np.ones((1, 2), bool), 1e-3)
    corners = {(0.0, 0.0), (0.5, 0.0), (1.0, 1.0), (1.5, 0.0), (2.0, 0.0), (2.0, 3.0), (0.0, 3.0)}
    assert {tuple(np.round(p, 9) + 0.0) for p in pieces.points} - {(1.0, 3.0)} == corners
    assert area(pieces) == pytest.approx([5.5])


def test_where_the_lips_hide_the_middle_there_are_two_openings():
    upper, lower = flat([0.0, 0.0, 0.0], [-1.0, 1.0, -1.0]), flat([0.5, 0.5, 0.5], [0.5, 0.5, 0.5])
    pieces = visible(upper, lower, np.ones((1, 2), bool), 1e-3)
    assert area(pieces) == pytest.approx([0.5 * 0.75 - 0.0625] * 2)
    np.testing.assert_array_equal(pieces.first, [0, 1])
    np.testing.assert_array_equal(pieces.last, [0, 1])


def test_lips_that_touch_at_one_column_part_the_opening():
    upper, lower = (
        flat([0.0, 0.0, 0.0, 0.0, 0.0], [0.0] * 5),
        flat([0.0, 1.0, 0.0, 2.0, 0.0], [0.0, 1.0, 0.0, 2.0, 0.0]),
    )
    pieces = visible(upper, lower, np.ones((1, 4), bool), 1e-3)
    assert area(pieces) == pytest.approx([1, 2])
    np.testing.assert_array_equal(np.stack([pieces.first, pieces.last], 1), [[0, 1], [2, 3]])
    np.testing.assert_array_equal(np.diff(pieces.start), [4, 4])  # where they touch is one corner


def test_what_is_hidden_all_along_is_no_opening():
    upper, lower = flat([0.0] * 3, [2.0] * 3), flat([1.0] * 3, [1.0] * 3)
    pieces = visible(upper, lower, np.ones((1, 2), bool), 1e-3)
    assert len(pieces.frame) == 0 and len(pieces.points) == 0


def test_what_is_nowhere_high_enough_is_no_opening():
    upper, lower = flat([0.0] * 5, [0.0] * 5), flat([0.0, 0.1, 0.0, 0.3, 0.0], [0.0, 0.1, 0.0, 0.3, 0.0])
    pieces = visible(upper, lower, np.ones((1, 4), bool), 0.2)
    assert area(pieces) == pytest.approx([0.3])
    np.testing.assert_array_equal(pieces.first, [2])


def test_lines_that_part_at_a_corner_leave_no_stub():
    upper, lower = flat([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]), flat([2.0, 2.0, 2.0], [2.0, 2.0, 2.0])
    pieces = visible(upper, lower, np.ones((1, 2), bool), 1e-9)
    assert {tuple(p) for p in pieces.points} == {(0, 0), (1, 0), (2, 1), (2, 2), (1, 2), (0, 2)}


@pytest.mark.parametrize("seed", range(8))
def test_envelope_against_dense_sampling(seed):
    """Ragged edges, the inner one shifted as in a turned head; from the fifth on they also run backwards in places."""
    rng = np.random.default_rng(seed)
    columns = 30
    u = np.linspace(0, 100, columns)[None, :, None] + rng.uniform(-1, 1, (2, columns, 2)) * (1.5 if seed < 4 else 4.0)
    u = u + np.array([0.0, rng.uniform(-8, 8)])
    v = rng.uniform(-6, 6, (2, columns, 2)) + np.array([0.0, rng.uniform(2, 25)])[:, None, None]
    upper, lower = np.stack([u[0], v[0]], -1), np.stack([u[1], v[1]], -1)
    pieces = visible(upper[None], lower[None], np.ones((1, columns - 1), bool), 1e-9)
    expected, _ = seen_area(upper, lower)
    assert area(pieces).sum() == pytest.approx(expected, rel=1e-4, abs=1e-3)


def test_number_of_pieces_against_dense_sampling():
    rng = np.random.default_rng(11)
    upper = flat(rng.uniform(-6, 6, 20), rng.uniform(-6, 6, 20))
    lower = flat(rng.uniform(-2, 9, 20), rng.uniform(-2, 9, 20))
    pieces = visible(upper, lower, np.ones((1, 19), bool), 1e-6)
    assert len(pieces.frame) == seen_area(upper[0], lower[0])[1] > 3
