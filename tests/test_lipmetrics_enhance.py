import numpy as np
import pytest

from lipmetrics import enhance


@pytest.fixture
def rgb():
    return np.random.default_rng(0).integers(20, 120, (30, 50, 3), dtype=np.uint8)


def test_clipped_maximum_leaves_out_the_brightest_fraction():
    channel = np.arange(100, dtype=np.uint8).reshape(10, 10)
    assert enhance.clipped_maximum(channel, 0.0) == 99
    assert enhance.clipped_maximum(channel, 0.05) == 94


def test_white_gains_are_255_over_the_maximum_and_ignore_a_reflection(rgb):
    rgb[..., 0] = 51
    rgb[3, 4] = 255
    gains = enhance.white_gains(rgb, 0.01)
    assert gains[0] == 5.0
    assert np.all(gains[1:] == 255 / np.array([enhance.clipped_maximum(rgb[..., k], 0.01) for k in (1, 2)]))


def test_white_balance_multiplies_each_channel_and_saturates():
    rgb = np.array([[[10, 20, 200]]], np.uint8)
    assert enhance.white_balance(rgb, np.array([2.0, 0.5, 3.0])).tolist() == [[[20, 10, 255]]]


def test_white_balance_takes_a_colour_cast_off(rgb):
    cast = (rgb * np.array([1.0, 0.8, 0.5])).astype(np.uint8)
    plain = enhance.white_balance(rgb, enhance.white_gains(rgb, 0.0))
    balanced = enhance.white_balance(cast, enhance.white_gains(cast, 0.0))
    assert np.abs(plain.astype(int) - balanced).max() <= 6  # what rounding to whole levels leaves


def test_stretched_saturation_reaches_full_scale_and_keeps_grey_grey():
    rgb = np.array([[[100, 80, 80], [90, 90, 90]]], np.uint8)
    gain = enhance.saturation_gain(rgb, 0.0)
    stretched = enhance.stretch_saturation(rgb, gain)
    assert gain == pytest.approx(255 / 51)
    assert stretched.tolist() == [[[100, 0, 0], [90, 90, 90]]]


def test_median_filter_removes_a_bright_point_and_keeps_an_edge():
    rgb = np.zeros((20, 20, 3), np.uint8)
    rgb[:, 10:] = 200
    edge = rgb.copy()
    rgb[5, 5] = 255
    assert np.array_equal(enhance.median_filter(rgb, 3), edge)
    assert np.array_equal(enhance.median_filter(rgb, 1), rgb)


@pytest.mark.parametrize("value", [0, 255])
def test_black_and_white_pictures_have_finite_gains(value):
    flat = np.full((8, 8, 3), value, np.uint8)
    assert np.all(np.isfinite(enhance.white_gains(flat, 0.02)))
    assert np.isfinite(enhance.saturation_gain(flat, 0.02))


def test_input_is_left_as_it_is(rgb):
    before = rgb.copy()
    for result in (
        enhance.white_balance(rgb, np.array([2.0, 2.0, 2.0])),
        enhance.stretch_saturation(rgb, 2.0),
        enhance.median_filter(rgb, 1),
    ):
        result[:] = 0
    assert np.array_equal(rgb, before)
