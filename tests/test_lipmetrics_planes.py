"""Averages straight from the planes against averages of the converted picture."""

from itertools import product

import av
import numpy as np
import pytest
from av.video.reformatter import VideoReformatter
from clips import smooth_picture

from lipmetrics import planes
from lipmetrics.frames import Frame
from lipmetrics.pixels import Turn

AS_STORED = Turn()


def frame_of(pixel_format="yuv420p", matrix=1, color_range=1, turn=AS_STORED, size=(96, 128)):
    """A frame of soft patches with noise, so that no pixel is like the one beside it, and none is cut to 0 or 255."""
    rng = np.random.default_rng(0)
    pixels = 70 + 0.4 * smooth_picture(*size) + rng.integers(-20, 21, (*size, 3))
    picture = av.VideoFrame.from_ndarray(pixels.clip(0, 255).astype(np.uint8), format="rgb24")
    picture = picture.reformat(format=pixel_format)
    picture.colorspace, picture.color_range = matrix, color_range
    return Frame(0, 0.0, picture, turn, VideoReformatter())


def block_means(pixels, shrink):
    """Means over blocks, one by one."""
    high, wide = pixels.shape[0] // shrink, pixels.shape[1] // shrink
    out = np.empty((high, wide, 3))
    for i, j in product(range(high), range(wide)):
        out[i, j] = pixels[i * shrink : (i + 1) * shrink, j * shrink : (j + 1) * shrink].mean(axis=(0, 1))
    return out


@pytest.mark.parametrize("color_range", [1, 2])
@pytest.mark.parametrize("matrix", [*sorted(planes.MATRICES), 0, 3])
@pytest.mark.parametrize("pixel_format", sorted(planes.FORMATS))
def test_colours_are_those_of_the_converted_picture(pixel_format, matrix, color_range):
    frame, region = frame_of(pixel_format, matrix, color_range), (7, 90, 11, 120)
    off = frame.averaged(region, 1).astype(int) - frame.rgb(region)
    assert np.abs(off).max() <= 1  # 0 where swscale has vector instructions for this
    assert abs(off.mean()) < 0.5


@pytest.mark.parametrize("region", [(0, 96, 0, 128), (8, 90, 12, 127), (7, 94, 13, 120)], ids=str)
@pytest.mark.parametrize("shrink", [2, 3, 4, 5, 17, 40])
@pytest.mark.parametrize("pixel_format", ["yuv420p", "yuv422p", "yuv444p", "gray"])
def test_averages_are_those_of_the_converted_picture(pixel_format, shrink, region):
    frame = frame_of(pixel_format)
    off = frame.averaged(region, shrink) - block_means(frame.rgb(region), shrink)
    assert np.abs(off).max() < 3  # green is the sum of three products that are cut to whole numbers
    if off.size > 300:
        assert np.abs(off).mean() < 0.4
        assert np.abs(off.mean(axis=(0, 1))).max() < 0.2


@pytest.mark.parametrize("turn", [Turn(*flags) for flags in product([False, True], repeat=3)], ids=str)
def test_a_turned_picture_is_averaged_as_displayed(turn):
    frame = frame_of(turn=turn)
    region = (3, frame.height - 4, 9, frame.width - 2)
    for shrink in (1, 2, 3):
        off = frame.averaged(region, shrink) - block_means(frame.rgb(region), shrink)
        assert np.abs(off).max() < 3


def test_odd_sizes_are_averaged_after_conversion():
    frame = frame_of(size=(71, 83))
    assert np.abs(frame.averaged((2, 70, 3, 80), 3) - block_means(frame.rgb((2, 70, 3, 80)), 3)).max() <= 0.5


def test_a_large_bright_block_does_not_run_over():
    picture = av.VideoFrame.from_ndarray(np.full((3 * 700 // 2, 700), 235, np.uint8), format="yuv420p")
    frame = Frame(0, 0.0, picture, Turn(), VideoReformatter())
    expected = frame.rgb((0, 2, 0, 2))[0, 0]
    for shrink in (16, 17, 64, planes.MAX_SHRINK, 300):
        assert np.abs(frame.averaged((0, 700, 0, 700), shrink) - expected.astype(int)).max() <= 1
