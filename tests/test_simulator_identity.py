"""Who is who among openings from frame to frame."""

import numpy as np

from simulator.identity import Identity, identities


def follow(*frames):
    """Identities of openings given as (first, last) or (first, last, area), frame by frame."""
    rows = [(k, *(one if len(one) == 3 else (*one, one[1] - one[0] + 1))) for k, of in enumerate(frames) for one in of]
    frame, first, last, area = np.array(rows).T
    return identities(frame.astype(int), first.astype(int), last.astype(int), area)


def test_an_opening_goes_on_under_its_number():
    assert follow([(3, 5)], [(2, 6)], [(0, 9)]) == [Identity(1, "new"), Identity(1), Identity(1)]


def test_the_one_that_shares_most_goes_on_in_a_merge():
    assert follow([(0, 3), (6, 15)], [(0, 15)])[-1] == Identity(2, "merge", (2, 1))


def test_among_equals_the_larger_goes_on_then_the_first():
    assert follow([(0, 4, 1.0), (6, 10, 2.0)], [(0, 10)])[-1] == Identity(2, "merge", (2, 1))
    assert follow([(0, 4, 1.0 - 1e-12), (6, 10, 1.0)], [(0, 10)])[-1] == Identity(1, "merge", (1, 2))


def test_the_larger_part_goes_on_in_a_split():
    assert follow([(0, 15)], [(0, 3), (6, 15)])[1:] == [Identity(2, "split", (1,)), Identity(1)]


def test_far_apart_is_new_and_after_a_closed_frame_too():
    assert follow([(0, 3)], [(8, 9)])[-1] == Identity(2, "new")
    assert follow([(0, 3)], [], [(0, 3)])[-1] == Identity(2, "new")


def test_three_flow_together():
    assert follow([(0, 1), (4, 9), (12, 13)], [(0, 13)])[-1] == Identity(2, "merge", (2, 1, 3))


def test_neighbours_that_go_on_side_by_side_do_not_merge():
    assert follow([(0, 4), (6, 9)], [(0, 5), (7, 9)])[2:] == [Identity(1), Identity(2)]


def test_no_openings():
    none = np.zeros(0, int)
    assert identities(none, none, none, none.astype(float)) == []
