"""Video files: what goes in comes out, the same bytes every time, and nothing half-written."""

from fractions import Fraction

import av
import numpy as np
import pytest

from simulator.errors import InputError
from simulator.video import compressed, write_video


def frames_of(count=7, height=64, width=96):
    rng = np.random.default_rng(5)
    return [rng.integers(0, 256, (height, width, 3), np.uint8) for _ in range(count)]


def ramp(count=7, height=64, width=96):
    row, column = np.mgrid[:height, :width]
    return [np.stack([2 * row + k, column + 40, 150 - row], axis=-1).astype(np.uint8) for k in range(count)]


def read(path):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        decoded = list(container.decode(stream))
        return [f.to_ndarray(format="rgb24") for f in decoded], [f.time for f in decoded], stream.average_rate


@pytest.mark.parametrize("codec, ending", [("ffv1", "mkv"), ("h264_lossless", "mp4")])
def test_lossless_is_lossless(tmp_path, codec, ending):
    frames = frames_of()
    assert write_video(tmp_path / f"a.{ending}", iter(frames), Fraction(30000, 1001), codec) == 7
    back, times, rate = read(tmp_path / f"a.{ending}")
    assert np.array_equal(back, frames) and rate == Fraction(30000, 1001)
    assert times == pytest.approx(np.arange(7) * 1001 / 30000, abs=6e-4)


def test_h264_for_people(tmp_path):
    frames = ramp()
    write_video(tmp_path / "a.mp4", frames, 25, "h264", crf=10)
    with av.open(str(tmp_path / "a.mp4")) as container:
        stream = container.streams.video[0]
        assert stream.pix_fmt == "yuv420p" and stream.codec_context.colorspace == 1
    back, times, _ = read(tmp_path / "a.mp4")
    assert np.abs(np.subtract(back, frames, dtype=int)).mean() < 3 and times[1] == pytest.approx(0.04)
    data = (tmp_path / "a.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")  # a browser can start at once


@pytest.mark.parametrize("codec, ending", [("ffv1", "mkv"), ("h264", "mp4"), ("h264_lossless", "mkv")])
def test_equal_frames_equal_bytes(tmp_path, codec, ending):
    for name in "ab":
        write_video(tmp_path / f"{name}.{ending}", ramp(), 29.97, codec)
    assert (tmp_path / f"a.{ending}").read_bytes() == (tmp_path / f"b.{ending}").read_bytes()


def test_compressed_frames_are_near_and_in_order():
    frames = ramp(count=9, height=65, width=97)
    for crf, near in ((12, 2.0), (40, 12.0)):
        back = list(compressed(iter(frames), 25, crf))
        assert len(back) == 9 and back[0].shape == (65, 97, 3)
        error = np.abs(np.subtract(back, frames, dtype=int)).mean()
        assert error < near
    # each is nearest to its own
    frames = [np.full((64, 96, 3), 40 + 20 * k, np.uint8) for k in range(9)]
    back = list(compressed(iter(frames), 25, 20))
    assert [b.mean() for b in back] == pytest.approx([f.mean() for f in frames], abs=3)


def test_nothing_half_written(tmp_path):
    def broken():
        yield from frames_of(2)
        raise RuntimeError("out of frames")

    (tmp_path / "a.mkv").write_bytes(b"old")
    with pytest.raises(RuntimeError, match="out of frames"):
        write_video(tmp_path / "a.mkv", broken())
    assert [p.name for p in tmp_path.iterdir()] == ["a.mkv"] and (tmp_path / "a.mkv").read_bytes() == b"old"


def test_bad_input(tmp_path):
    with pytest.raises(InputError, match="did you mean 'h264'"):
        write_video(tmp_path / "a.mp4", frames_of(), 25, "h265")
    with pytest.raises(InputError, match=r"ends in \.mkv or \.avi for ffv1, got 'a\.mp4'"):
        write_video(tmp_path / "a.mp4", frames_of(), 25, "ffv1")
    with pytest.raises(InputError, match="got none"):
        write_video(tmp_path / "a.mkv", [])
    with pytest.raises(InputError, match="even height and width"):
        write_video(tmp_path / "a.mp4", frames_of(1, 33, 33), 25, "h264")
    with pytest.raises(InputError, match="frames of one size"):
        write_video(tmp_path / "a.mkv", [*frames_of(1), *frames_of(1, 32, 32)])
    with pytest.raises(InputError, match="uint8 RGB, got float64"):
        write_video(tmp_path / "a.mkv", [np.zeros((4, 4, 3))])
    with pytest.raises(InputError, match="crf as a whole number"):
        write_video(tmp_path / "a.mp4", frames_of(1), 25, "h264", crf=60)
    for rate in (0, "fast", float("nan")):
        with pytest.raises(InputError, match="expected frame_rate above 0"):
            write_video(tmp_path / "a.mkv", frames_of(1), rate)
    assert not list(tmp_path.iterdir())
