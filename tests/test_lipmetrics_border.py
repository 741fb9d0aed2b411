"""Sharper borders: straightening a canvas along a border, and moving borders as a forest says."""

import numpy as np
import pytest

from lipmetrics.border import COUNT, LOWER, REACH, ROWS, SEEN, SHARE, UPPER, moved, straightened
from lipmetrics.errors import InputError
from lipmetrics.features import FINE_COUNT, PAD
from lipmetrics.forest import Forest, load_forest, save_forests

ROWS_N, COLS_N = 60, 40


def ramp(per_row=2.0, per_col=1.0, origin=(0, 0)):
    """Fine maps (C, ...) that rise along rows and columns of the canvas, and log-odds that do."""
    rows = np.arange(ROWS_N + 2 * PAD[0])[:, None] - PAD[0] + origin[0]
    cols = np.arange(COLS_N + 2 * PAD[1])[None] - PAD[1] + origin[1]
    plane = np.clip(60 + per_row * rows + per_col * cols, 0, 255).astype(np.uint8)
    odds = np.zeros((3, 112, 64), np.float32)
    odds[1] = (np.arange(112)[:, None] - 20) / 24
    return np.repeat(plane[None], FINE_COUNT, axis=0), odds


def always(answer):
    """A forest that says the same everywhere."""
    return Forest(
        np.zeros((1, 1, 6), np.int32),
        np.ones((1, 1), bool),
        np.full((1, 2, 1), answer / 2, np.float32),
        np.array([answer / 2], np.float32),
    )


@pytest.mark.parametrize("side", [UPPER, LOWER])
def test_the_middle_row_is_the_border_and_rows_run_into_the_opening(side):
    maps, odds = ramp(origin=(7, 3))
    left, upper, lower = 15, np.array([20.0, 21.5, 22.25]), np.array([30.0, 31.0, 29.5])
    border = upper if side == UPPER else lower
    seen = straightened(maps, odds, (7, 3), left, upper, lower, side)
    assert seen.shape == (COUNT, ROWS, 3 + 2 * PAD[1])
    for k in range(3):
        for step in (-3, 0, 5):
            value = 60 + 2 * (border[k] + side * step) + left + k
            assert abs(int(seen[0, PAD[0] + step, PAD[1] + k]) - value) <= 0.5
            assert abs(int(seen[len(SEEN) + 1, PAD[0] + step, PAD[1] + k]) - (128 + border[k] + side * step - 20)) <= 1


def test_a_border_is_moved_into_the_opening_by_what_the_forest_says():
    maps, odds = ramp()
    upper, lower = np.full(9, 20.0), np.full(9, 40.0)
    for answer in (-1.5, 0.8):
        above, below = moved(always(answer), maps, odds, (0, 0), 10, upper, lower)
        off = np.tanh(answer / 2) * SHARE * REACH
        np.testing.assert_allclose(above, 20 + off, atol=1e-4)
        np.testing.assert_allclose(below, 40 - off, atol=1e-4)


def test_borders_do_not_pass_one_another():
    maps, odds = ramp()
    above, below = moved(always(9.0), maps, odds, (0, 0), 10, np.full(9, 20.0), np.full(9, 22.0))
    np.testing.assert_allclose(above, 21)
    np.testing.assert_allclose(below, 21)


def test_the_answer_does_not_depend_on_the_region_that_is_looked_at():
    maps, odds = ramp()
    upper, lower = np.full(5, 25.0), np.full(5, 33.0)
    whole = straightened(maps, odds, (0, 0), 12, upper, lower, UPPER)
    part = straightened(maps[:, 6:, 4:], odds, (6, 4), 12, upper, lower, UPPER)
    np.testing.assert_array_equal(whole[:, 4:-4], part[:, 4:-4])


def test_a_file_without_a_border_forest_is_refused(tmp_path):
    path = tmp_path / "one.npz"
    save_forests(path, {"coarse": always(1.0)})
    with pytest.raises(InputError, match="'border'"):
        load_forest(path, "border")
