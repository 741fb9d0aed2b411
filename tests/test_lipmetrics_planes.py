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


def block_means(pixels, block):
    """Means over blocks, one by one."""
    down, across = block
    high, wide = pixels.shape[0] // down, pixels.shape[1] // across
    out = np.empty((high, wide, 3))
    for i, j in product(range(high), range(wide)):
        out[i, j] = pixels[i * down : (i + 1) * down, j * across : (j + 1) * across].mean(axis=(0, 1))
    return out


@pytest.mark.parametrize("color_range", [1, 2])
@pytest.mark.parametrize("matrix", [*sorted(planes.MATRICES), 0, 3])
@pytest.mark.parametrize("pixel_format", sorted(planes.FORMATS))
def test_colours_are_those_of_the_converted_picture(pixel_format, matrix, color_range):
    frame, region = frame_of(pixel_format, matrix, color_range), (7, 90, 11, 120)
    off = frame.averaged(region, (1, 1)).astype(int) - frame.rgb(region)
    assert np.abs(off).max() <= 1  # 0 where swscale has vector instructions for this
    assert abs(off.mean()) < 0.5


@pytest.mark.parametrize("region", [(0, 96, 0, 128), (8, 90, 12, 127), (7, 94, 13, 120)], ids=str)
@pytest.mark.parametrize(
    "block", [(1, 2), (2, 1), (2, 2), (3, 3), (1, 3), (3, 6), (4, 4), (2, 5), (5, 5), (17, 17), (20, 40)], ids=str
)
@pytest.mark.parametrize("pixel_format", ["yuv420p", "yuv422p", "yuv444p", "gray"])
def test_averages_are_those_of_the_converted_picture(pixel_format, block, region):
    frame = frame_of(pixel_format)
    off = frame.averaged(region, block) - block_means(frame.rgb(region), block)
    assert np.abs(off).max() < 3  # green is the sum of three products that are cut to whole numbers
    if off.size > 300:
        assert np.abs(off).mean() < 0.4
        assert np.abs(off.mean(axis=(0, 1))).max() < 0.2


@pytest.mark.parametrize("turn", [Turn(*flags) for flags in product([False, True], repeat=3)], ids=str)
def test_a_turned_picture_is_averaged_as_displayed(turn):
    frame = frame_of(turn=turn)
    region = (3, frame.height - 4, 9, frame.width - 2)
    for block in ((1, 1), (2, 2), (3, 3), (1, 2), (2, 3)):
        off = frame.averaged(region, block) - block_means(frame.rgb(region), block)
        assert np.abs(off).max() < 3


def test_odd_sizes_are_averaged_after_conversion():
    frame = frame_of(size=(71, 83))
    assert np.abs(frame.averaged((2, 70, 3, 80), (3, 4)) - block_means(frame.rgb((2, 70, 3, 80)), (3, 4))).max() <= 0.5


def test_a_large_bright_block_does_not_run_over():
    picture = av.VideoFrame.from_ndarray(np.full((3 * 700 // 2, 700), 235, np.uint8), format="yuv420p")
    frame = Frame(0, 0.0, picture, Turn(), VideoReformatter())
    expected = frame.rgb((0, 2, 0, 2))[0, 0]
    for block in ((16, 16), (17, 17), (64, 128), (planes.MAX_BLOCK, planes.MAX_BLOCK), (300, 300)):
        assert np.abs(frame.averaged((0, 700, 0, 700), block) - expected.astype(int)).max() <= 1
