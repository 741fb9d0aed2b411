"""Single numbers of a truth, where the formula that moved the mouth says what they must be."""

import dataclasses
import math

import numpy as np
import pytest
from moved_mouth import moved_mouth

from simulator.camera import Camera
from simulator.errors import InputError
from simulator.events import (
    centre_offset_mw,
    corners_mw,
    merges_s,
    onset_s,
    peak_over_settled,
    reached_s,
    spells_s,
)
from simulator.truth import truth


@pytest.fixture(scope="module")
def opened():
    mouth, motion = moved_mouth("low", 21, patch=(0.004, 0.009))
    return mouth, motion, truth(motion, mouth)


def shut(motion, closed):
    """The same motion, closed and glued in the frames of a mask (T,)."""
    record = dataclasses.replace(motion.saliva, state=motion.saliva.state * ~closed[:, None])
    return dataclasses.replace(motion, saliva=record)


def test_onset_and_merge(opened):
    _, motion, found = opened
    first = np.flatnonzero((motion.saliva.state != 0).sum(axis=1) > 1)[0]
    assert onset_s(found) == motion.time_s[first]
    assert merges_s(found) == [0.5]


def test_spells_of_a_mouth_that_closes_in_between(opened):
    mouth, motion, found = opened
    closed = (motion.time_s > 0.62) & (motion.time_s < 0.78)
    spells = spells_s(truth(shut(motion, closed), mouth))
    np.testing.assert_allclose(spells, [(onset_s(found), 0.6), (0.8, 1.0)])


def test_a_mouth_that_never_opens(opened):
    mouth, motion, _ = opened
    never = truth(shut(motion, np.ones(21, bool)), mouth)
    assert spells_s(never) == [] and merges_s(never) == []
    assert all(math.isnan(f(never)) for f in (onset_s, reached_s, peak_over_settled, centre_offset_mw))
    assert np.isnan(corners_mw(never)).all()


def test_height_reaches_its_share_when_the_formula_says():
    """The height of the formula grows in proportion to time."""
    mouth, motion = moved_mouth("low", 41)
    found = truth(motion, mouth)
    assert reached_s(found, 0.5, "height_mw") == pytest.approx(0.5, abs=0.01)
    assert peak_over_settled(found) == 1.0


def test_peak_over_settled_of_a_mouth_that_goes_half_way_back():
    mouth, motion = moved_mouth("low", 41)
    there = np.r_[0:41, 39:19:-1]
    r = motion.saliva
    record = dataclasses.replace(
        r, state=r.state[there], stretch=r.stretch[there], moisture=r.moisture[there], critical=r.critical[there]
    )
    back = dataclasses.replace(
        motion, time_s=np.arange(len(there)) / 40, positions=motion.positions[there], saliva=record
    )
    assert peak_over_settled(truth(back, mouth)) == pytest.approx(2.0, rel=0.02)


@pytest.mark.parametrize("camera", [Camera(), Camera(centre_y_m=0, roll_deg=70)])
def test_corners_lie_along_the_mouth_also_in_a_tilted_head(opened, camera):
    mouth, motion, _ = opened
    found = truth(motion, mouth, camera)
    ends = corners_mw(found)
    np.testing.assert_allclose(ends[-1], [-0.5, 0.5], atol=0.05)
    assert np.isnan(ends[0]).all()
    # before the merge the largest opening reaches from the left to the patch that is glued
    at = 9
    assert ends[at, 1] == pytest.approx(0.004 / mouth.width_m, abs=0.04) and ends[at, 0] < -0.15
    assert centre_offset_mw(found, motion.time_s[at]) == pytest.approx(ends[at].mean())
    assert centre_offset_mw(found) == pytest.approx(0, abs=1e-6)


def test_unknown_size_and_share(opened):
    with pytest.raises(InputError, match="width_mw, height_mw or area_mw2, got 'width_px'"):
        reached_s(opened[2], size="width_px")
    with pytest.raises(InputError, match="expected a share above 0 and up to 1, got 0"):
        reached_s(opened[2], 0)
