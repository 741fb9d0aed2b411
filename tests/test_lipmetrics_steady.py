import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from lipmetrics.steady import steady

REGION, REGION_BEFORE = (3, 20, 0, 24), (4, 18, 2, 25)
STILL, MOVED = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), ((1.02, 0.05, -0.7), (-0.03, 0.97, 1.3))


def frames(rng, difference):
    """Two canvases (22, 25, 3) that differ by up to so many grey levels, and log-odds of both."""
    before = rng.integers(20, 200, (22, 25, 3)).astype(np.uint8)
    now = (before + rng.integers(0, difference + 1, before.shape)).astype(np.uint8)
    return now, before, *rng.normal(0, 3, (2, 3, 22, 25)).astype(np.float32)


def slowly(canvas, odds, region, before, odds_before, region_before, back, keep, change):
    """The same, step by step over whole planes."""
    rows, cols = np.tensordot(np.array(back), [*np.indices(canvas.shape[:2]), np.ones(canvas.shape[:2])], 1)
    known, *old = (
        map_coordinates(plane.astype(float), (rows, cols), order=1, mode="nearest")
        for plane in (before[..., 1], *odds_before)
    )
    counted = np.zeros(canvas.shape[:2])
    counted[max(region[0] - 1, 0) : region[1] + 1, max(region[2] - 1, 0) : region[3] + 1] = 1
    difference = cv2.boxFilter(
        counted * abs(canvas[..., 1] - known), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT
    )
    number = cv2.boxFilter(np.ones(canvas.shape[:2]), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    weight = keep * np.clip(2 - difference / number / change, 0, 1)
    row0, row1, col0, col1 = region_before
    weight[(rows < row0) | (rows > row1 - 1) | (cols < col0) | (cols > col1 - 1)] = 0
    inside = np.zeros(weight.shape, bool)
    inside[region[0] : region[1], region[2] : region[3]] = True
    return odds + np.where(inside, weight, 0) * (np.array(old) - odds)


@pytest.mark.parametrize("back", [STILL, MOVED], ids=["still", "moved"])
@pytest.mark.parametrize("difference", [0, 12, 30])
def test_evidence_is_kept_as_far_as_the_picture_has_not_changed(back, difference):
    canvas, before, odds, odds_before = frames(np.random.default_rng(difference), difference)
    expected = slowly(canvas, odds, REGION, before, odds_before, REGION_BEFORE, back, 0.6, 6.0)
    found = odds.copy()
    steady(canvas, found, REGION, before, odds_before, REGION_BEFORE, np.array(back), 0.6, 6.0)
    assert found == pytest.approx(expected, abs=1e-3)
    assert (found == odds).mean() > 0.2  # outside


def test_of_a_still_picture_the_share_asked_for_is_kept():
    canvas, _, odds, odds_before = frames(np.random.default_rng(0), 0)
    found = odds.copy()
    steady(canvas, found, (0, 22, 0, 25), canvas, odds_before, (0, 22, 0, 25), np.array(STILL), 0.75, 6.0)
    assert found == pytest.approx(0.25 * odds + 0.75 * odds_before, abs=1e-5)
