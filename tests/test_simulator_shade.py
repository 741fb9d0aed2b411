"""Kernels of the camera against slow arithmetic."""

import numpy as np
import pytest
from scipy.ndimage import convolve1d

from simulator import shade

EVERY = np.arange(256, dtype=np.uint8)  # a curve that keeps light as it is
SHAPE = (11, 19)


def light(seed):
    linear = np.zeros((*SHAPE, 4), np.float32)
    linear[..., :3] = np.random.default_rng(seed).random((*SHAPE, 3))
    return linear


def developed(linear, lens=(1.0,), gains=(1, 1, 1, 0), noise=0.0, vignette=0.0, seed=0):
    grain = np.random.default_rng(1).standard_normal(5000, np.float32)
    picture = np.empty((*SHAPE, 3), np.uint8)
    lens, gains = np.array(lens, np.float32), np.array(gains, np.float32)
    shade.develop(linear, lens, gains, noise, 0.0, vignette, grain, seed, EVERY, picture)
    return picture.astype(float)


def test_lens_exposure_and_vignette_against_convolution():
    lens = np.array([0.05, 0.2, 0.4, 0.25, 0.1])
    linear = light(0)
    blurred = linear[..., :3].astype(float)
    for axis in (0, 1):
        blurred = convolve1d(blurred, lens[::-1], axis=axis, mode="nearest")
    y, x = np.indices(SHAPE) - (np.array(SHAPE)[:, None, None] - 1) / 2
    falls = 1 - 0.6 * (x**2 + y**2) * (2 / max(SHAPE)) ** 2 / 2
    expected = 255 * blurred * [1.0, 0.8, 0.3] * falls[..., None]
    found = developed(linear, lens, (1.0, 0.8, 0.3, 0.0), vignette=0.6)
    assert np.abs(found - expected).max() < 0.51
    assert not developed(np.full_like(linear, -1)).any() and (developed(np.full_like(linear, 2)) == 255).all()


def test_noise_of_a_row_depends_on_its_seed_alone():
    linear = np.full((*SHAPE, 4), 0.5, np.float32)
    one, again, other = (developed(linear, noise=0.1, seed=s) for s in (0, 0, 1))
    assert np.array_equal(one, again)
    assert np.array_equal(other[:-1], one[1:])  # seeds count rows: frames stand a picture's height apart
    assert (one[0] != one[1]).mean() > 0.8


def test_smear_is_the_mean_of_places_along_the_movement():
    linear = light(2)
    moved = np.random.default_rng(3).uniform(-6, 6, (*SHAPE, 2)).astype(np.float32)
    moved[:3] *= 0.04  # hardly at all
    out = np.empty_like(linear)
    shade.smear(linear, moved, 5, out)
    assert np.array_equal(out[:3], linear[:3])
    for row in range(3, SHAPE[0]):
        for column in range(SHAPE[1]):
            count = min(int(np.abs(moved[row, column]).max()) + 2, 5)
            if np.abs(moved[row, column]).max() <= 0.3:
                continue
            total = np.zeros(3)
            for share in (np.arange(count) + 0.5) / count - 0.5:
                y, x = np.clip(np.array([row, column]) - share * moved[row, column], 0, np.array(SHAPE) - 1.01)
                r, c = int(y), int(x)
                square = linear[r : r + 2, c : c + 2, :3]
                total += np.einsum("r,c,rca->a", [r + 1 - y, y - r], [c + 1 - x, x - c], square)
            assert out[row, column, :3] == pytest.approx(total / count, abs=1e-5)
