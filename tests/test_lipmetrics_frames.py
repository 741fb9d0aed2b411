"""Reading of videos and picture sequences: times, turns, ranges, pixel formats, damage and bad input."""

from __future__ import annotations

import gc
import os
import struct
import zlib
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from clips import copy_packets, moving_pictures, smooth_picture, write_pictures, write_sound, write_video

from lipmetrics import frames, pixels
from lipmetrics.errors import InputError
from lipmetrics.frames import open_frames

CONTAINERS = {
    "mp4 with B-frames": ("a.mp4", {"codec": "libx264"}),
    "mov": ("a.mov", {"codec": "mpeg4"}),
    "avi": ("a.avi", {"codec": "mpeg4"}),
    "mpg": ("a.mpg", {"codec": "mpeg1video"}),
    "mkv with B-frames": ("a.mkv", {"codec": "libx264"}),
    "webm, vp9": ("a.webm", {"codec": "libvpx-vp9", "options": {"deadline": "realtime", "cpu-used": "8"}}),
    "webm, vp8": ("b.webm", {"codec": "libvpx"}),
    "GOPs of two": ("g.mp4", {"key_every": 2}),
    "open GOPs": ("c.mp4", {"options": {"x264-params": "open-gop=1:bframes=3:b-adapt=0:scenecut=0"}}),
    "open GOPs of mpeg2": ("c.mkv", {"codec": "mpeg2video", "options": {"bf": "2"}}),
    "no key pictures": ("d.mp4", {"options": {"x264-params": "intra-refresh=1"}}),
    "first packets not shown": ("f.mp4", {"ticks": range(-7, 33)}),
    "key pictures only": ("e.avi", {"codec": "mjpeg", "pixel_format": "yuvj420p"}),
}


def hidden_packet(at: Path) -> Path:
    """VP8 whose eighth packet is decoded but not shown."""

    def hide(packets):
        packet, data = packets[7]
        packets[7] = (packet, bytes([data[0] & ~0x10]) + data[1:])  # the bit show_frame
        return packets

    return copy_packets(write_video(at / "whole.webm", moving_pictures(41), codec="libvpx"), at / "a.webm", hide)


def cut_at_an_open_gop(at: Path) -> Path:
    """HEVC whose first pictures need what was cut away."""
    x265 = {"x265-params": "open-gop=1:bframes=3:b-adapt=0:scenecut=0:log-level=none"}
    whole = write_video(at / "whole.mkv", moving_pictures(53), codec="libx265", options=x265)
    second_key = [i for i, packet in enumerate(packets_of(whole)) if packet.is_keyframe][1]
    return copy_packets(whole, at / "a.mkv", lambda packets: packets[second_key:])


def key_pictures_not_told(at: Path) -> Path:
    """mp4 without a table of its key pictures: all packets seem to be one."""
    path = write_video(at / "a.mp4", moving_pictures(40), codec="mpeg4")
    path.write_bytes(path.read_bytes().replace(b"stss", b"free"))
    assert all(packet.is_keyframe for packet in packets_of(path))
    return path


MADE = {"hidden packet": hidden_packet, "cut at an open GOP": cut_at_an_open_gop, "no key table": key_pictures_not_told}


def packets_of(path: Path) -> list[av.Packet]:
    with av.open(str(path)) as container:
        return [packet for packet in container.demux(video=0) if packet.size]


@pytest.fixture(scope="module", params=[*CONTAINERS, *MADE])
def clip(request, tmp_path_factory) -> Path:
    at = tmp_path_factory.mktemp("clip")
    if request.param in MADE:
        return MADE[request.param](at)
    name, how = CONTAINERS[request.param]
    return write_video(at / name, moving_pictures(40), **how)


@pytest.fixture(scope="module")
def whole(clip):
    """All of a clip, as `read` gives it."""
    return read(clip)


def decoded(path: Path) -> tuple[list[float], list[np.ndarray]]:
    """Times and RGB pictures of a plain decoding loop."""
    with av.open(str(path)) as container:
        shown = [(frame.time, frame.to_ndarray(format="rgb24")) for frame in container.decode(video=0)]
    return [time_s for time_s, _ in shown], [picture for _, picture in shown]


def read(source, **how) -> list[tuple[int, float, np.ndarray]]:
    with open_frames(source, **how) as opened:
        return [(frame.index, frame.time_s, frame.rgb()) for frame in opened]


def assert_same(got, expected) -> None:
    assert [row[:2] for row in got] == [row[:2] for row in expected]
    assert all(np.array_equal(a[2], b[2]) for a, b in zip(got, expected, strict=True))


def times_of(opened) -> list[float]:
    return [frame.time_s for frame in opened]


# --- times ------------------------------------------------------------------------------------------------------------


def test_times_and_pictures_are_those_of_a_plain_decoding_loop(clip):
    times_s, pictures = decoded(clip)
    assert 30 < len(times_s) < 50
    with open_frames(clip) as opened:
        got = [(frame.index, frame.time_s, frame.rgb()) for frame in opened]
    assert_same(got, list(zip(range(len(times_s)), times_s, pictures, strict=True)))
    assert opened.warnings == []
    assert opened.variable_frame_rate == (max(np.diff(times_s)) > 0.06)
    assert (opened.info.width, opened.info.height, opened.info.nominal_fps) == (96, 64, 25)


def test_avi_with_b_frames_has_increasing_times(tmp_path):
    path = write_video(tmp_path / "a.avi", moving_pictures(40), codec="libx264", options={"bf": "2"})
    assert any(np.diff(decoded(path)[0]) < 0)  # what FFmpeg calls presentation stamps here is not
    with open_frames(path) as opened:
        assert np.diff(times_of(opened)) == pytest.approx(np.full(39, 0.04))
    assert opened.warnings == []


def test_variable_frame_rate_keeps_every_stamp(tmp_path):
    ticks = [7, 40, 41, 90, 200, 233, 500, 501]
    path = write_video(tmp_path / "a.mp4", moving_pictures(8), ticks=ticks, time_base=Fraction(1, 1000))
    with open_frames(path) as opened:
        assert times_of(opened) == pytest.approx([tick / 1000 for tick in ticks], abs=1e-9)
    assert opened.variable_frame_rate


def test_rounded_stamps_are_not_a_variable_frame_rate(tmp_path):
    with open_frames(write_video(tmp_path / "a.mkv", moving_pictures(30), fps=120)) as opened:
        assert len(set(np.round(np.diff(times_of(opened)), 6))) == 2  # 8 and 9 ms
    assert not opened.variable_frame_rate


def test_joined_recordings_go_on_after_the_jump(tmp_path):
    one = write_video(tmp_path / "one.mpg", moving_pictures(50), codec="mpeg1video").read_bytes()
    (tmp_path / "two.mpg").write_bytes(one + one)
    with open_frames(tmp_path / "two.mpg") as opened:
        times_s = times_of(opened)
    assert len(times_s) == 100
    assert np.diff(times_s) == pytest.approx(np.full(99, 0.04))
    assert len(opened.warnings) == 1
    assert "start again" in opened.warnings[0]


@pytest.mark.parametrize(
    ("stamps", "expected", "warning"),
    [
        ([0.0, 0.1, 0.1, 0.2], [(0, 0.0), (1, 0.1), (3, 0.2)], "not later"),
        ([0.0, 0.2, 0.1, 0.3], [(0, 0.0), (1, 0.2), (3, 0.3)], "not later"),
        ([None, None, 0.5, None], [(0, 0.0), (1, 0.1), (2, 0.5), (3, 0.6)], None),
        ([5.0, 5.1, 0.0, 0.1], [(0, 5.0), (1, 5.1), (2, 5.2), (3, 5.3)], "start again"),
    ],
    ids=["twice the same", "backwards", "missing", "clock starts again"],
)
def test_bad_stamps(stamps, expected, warning):
    notes = frames._Notes()
    timed = frames._timed(((stamp, False, None) for stamp in stamps), 0.1, 0, notes)
    assert [(index, round(time_s, 9)) for index, time_s, _ in timed] == expected
    assert len(notes.lines()) == (warning is not None)
    assert warning is None or warning in notes.lines()[0]


def test_real_clips_are_read_as_a_plain_decoding_loop_reads_them():
    reference = Path(os.environ.get("LIPMETRICS_REFERENCE", Path(__file__).parents[2] / "shared" / "reference"))
    clips = [reference / "real" / "videos" / name for name in ("vr_1.mp4", "grid_id2.mpg", "pf_pexels.mp4")]
    if not all(path.exists() for path in clips):
        pytest.skip("reference videos absent; LIPMETRICS_REFERENCE names their folder")
    for path in clips:
        with av.open(str(path)) as container:
            expected = [frame.time for frame in container.decode(video=0)]
        with open_frames(path) as opened:
            assert times_of(opened) == expected
        assert opened.warnings == []
        assert opened.variable_frame_rate == (path.stem == "vr_1")


@pytest.mark.parametrize("kind", ["video", "images"])
def test_frames_are_let_go_without_the_garbage_collector(tmp_path, kind):
    pictures = moving_pictures(60)
    path = write_video(tmp_path / "a.mp4", pictures) if kind == "video" else write_pictures(tmp_path / "take", pictures)

    def alive() -> int:
        return sum(isinstance(thing, av.VideoFrame) for thing in gc.get_objects())

    gc.collect()
    before = alive()
    gc.disable()
    try:
        with open_frames(path, fps=None if kind == "video" else 25) as opened:
            most = max(alive() - before for frame in opened if frame.rgb((0, 8, 0, 8)) is not None)
    finally:
        gc.enable()
    assert most < 30  # what decoding threads hold, not what has been seen


# --- ranges -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("start", [0, 1, 10, 17, 20, 24, 32])
def test_a_range_is_a_part_of_the_whole(clip, whole, start):
    start_s = whole[start][1]
    assert_same(read(clip, start_s=start_s), whole[start:])
    before_s = max(0.0, start_s - 0.01)
    ends = [time_s for _, time_s, _ in whole[start + 1 : start + 4]]
    for count, stop_s in enumerate(ends, 1):
        assert_same(read(clip, start_s=before_s, stop_s=stop_s), whole[start : start + count])


@pytest.mark.parametrize(("name", "first_tick"), [("a.mp4", 0), ("a.mkv", 0), ("edit_list.mp4", -7)])
def test_what_lies_before_the_start_is_not_decoded(tmp_path, monkeypatch, name, first_tick):
    first = []
    timed = frames._timed

    def spy(stamped, step_s, first_index, notes):
        first.append(first_index)
        return timed(stamped, step_s, first_index, notes)

    monkeypatch.setattr(frames, "_timed", spy)
    path = write_video(tmp_path / name, moving_pictures(40), ticks=range(first_tick, first_tick + 40))
    assert read(path, start_s=1.0)[0][0] == 25
    assert len(first) == 1
    assert 10 <= first[0] <= 25  # a key picture near frame 25


def test_every_counts_from_the_first_frame_of_the_file(clip, whole):
    assert_same(read(clip, every=7), whole[::7])
    assert_same(read(clip, every=7, start_s=whole[8][1]), whole[14::7])


def test_a_source_can_be_read_again(tmp_path):
    with open_frames(write_video(tmp_path / "a.mp4", moving_pictures(5))) as opened:
        next(iter(opened))
        assert len(times_of(opened)) == len(times_of(opened)) == 5


def test_a_range_without_frames_names_what_is_there(tmp_path):
    path = write_video(tmp_path / "a.mp4", moving_pictures(5))
    with pytest.raises(InputError, match=r"start 3 s, stop 4 s"):
        read(path, start_s=3, stop_s=4)


# --- turns ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("hflip", [False, True])
@pytest.mark.parametrize("rotation_deg", [0, 90, 180, 270])
@pytest.mark.parametrize("name", ["a.mp4", "a.mov", "a.mkv"])
def test_the_turn_is_applied_once(tmp_path, name, rotation_deg, hflip):
    upright = smooth_picture(64, 96)
    stored = np.ascontiguousarray(np.rot90(upright[:, ::-1] if hflip else upright, -rotation_deg // 90))
    path = write_video(tmp_path / name, [stored] * 3, rotation_deg=rotation_deg, hflip=hflip)
    with open_frames(path) as opened:
        info = opened.info
        for frame in opened:
            shown = frame.rgb()
            assert (frame.height, frame.width) == (info.height, info.width) == (64, 96)
            assert np.abs(shown.astype(int) - upright).mean() < 6
            assert np.array_equal(frame.rgb((3, 40, 11, 90)), shown[3:40, 11:90])
    assert (info.rotation_deg, info.mirrored) == (rotation_deg, hflip)


def test_exif_of_a_photograph_is_applied(tmp_path):
    upright = smooth_picture(64, 96)
    ok, jpg = cv2.imencode(".jpg", cv2.cvtColor(np.ascontiguousarray(np.rot90(upright)), cv2.COLOR_RGB2BGR))
    assert ok
    # orientation 6: to be turned by 90 degrees to the right
    tiff = b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 274, 3, 1, 6, 0, 0)
    exif = b"\xff\xe1" + struct.pack(">H", len(tiff) + 8) + b"Exif\0\0" + tiff
    (tmp_path / "a.jpg").write_bytes(jpg[:2].tobytes() + exif + jpg[2:].tobytes())
    [(_, _, shown)] = read(tmp_path / "a.jpg")
    assert np.abs(shown.astype(int) - upright).mean() < 6


def test_display_matrices_written_by_hand(tmp_path):
    upright = smooth_picture(64, 96)
    path = write_video(tmp_path / "a.mp4", [upright] * 2)
    data = path.read_bytes()
    at = data.index(b"tkhd") + 4 + 40
    assert data[at : at + 4] == struct.pack(">i", 1 << 16)
    half_turn = struct.pack(">9i", -(1 << 16), 0, 0, 0, -(1 << 16), 0, 96 << 16, 64 << 16, 1 << 30)
    path.write_bytes(data[:at] + half_turn + data[at + 36 :])
    assert np.abs(read(path)[0][2].astype(int) - upright[::-1, ::-1]).mean() < 6


# --- pixels -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pixel_format", [*sorted(pixels._LAYOUTS), "yuv411p", "yuva420p", "gbrp", "rgb48le", "ya8"])
@pytest.mark.parametrize("size", [(64, 96), (63, 97), (8, 8), (1, 1)], ids=str)
def test_a_region_is_cut_from_the_whole(pixel_format, size):
    rng = np.random.default_rng(4)
    source = av.VideoFrame.from_ndarray(smooth_picture(*size), format="rgb24").reformat(format=pixel_format)
    frame = frames.Frame(0, 0.0, source, pixels.Turn(), av.video.reformatter.VideoReformatter())
    whole = frame.rgb().copy()
    assert np.abs(whole.astype(int) - source.to_ndarray(format="rgb24")).max() <= 1  # 16 bits: rounded, not cut
    for _ in range(20):
        row0, row1 = sorted(rng.choice(size[0] + 1, 2, replace=False))
        col0, col1 = sorted(rng.choice(size[1] + 1, 2, replace=False))
        part = frame.rgb((row0, row1, col0, col1))
        assert np.array_equal(part, whole[row0:row1, col0:col1])
        part[:] = 0  # the caller's own
    frame.rgb()[:] = 0
    assert np.array_equal(frame.rgb(), whole)


@pytest.mark.parametrize("color_range", [1, 2], ids=["limited", "full"])
@pytest.mark.parametrize("colorspace", [1, 2, 5, 6, 9, 3], ids=["709", "none", "470bg", "170m", "2020", "reserved"])
def test_matrix_and_range_follow_the_tags(colorspace, color_range):
    grey = np.full((32, 32), 100, np.uint8)
    u, v = np.full((16, 16), 90, np.uint8), np.full((16, 16), 160, np.uint8)
    planes = np.concatenate([grey.ravel(), u.ravel(), v.ravel()]).reshape(48, 32)
    source = av.VideoFrame.from_ndarray(planes, format="yuv420p")
    source.colorspace, source.color_range = colorspace, color_range
    red, blue = {1: (0.2126, 0.0722), 9: (0.2627, 0.0593)}.get(colorspace, (0.299, 0.114))
    scale = (255 / 219, 255 / 224, 16) if color_range == 1 else (1, 1, 0)
    y, pb, pr = (100 - scale[2]) * scale[0], (90 - 128) * scale[1], (160 - 128) * scale[1]
    r, b = y + 2 * (1 - red) * pr, y + 2 * (1 - blue) * pb
    expected = (r, (y - red * r - blue * b) / (1 - red - blue), b)
    frame = frames.Frame(0, 0.0, source, pixels.Turn(), av.video.reformatter.VideoReformatter())
    for shown in (frame.rgb(), frame.rgb((5, 20, 3, 30))):
        assert np.abs(shown - np.array(expected)).max() < 3


def test_16_bit_grey_is_scaled_by_257(tmp_path):
    deep = np.linspace(0, 65535, 64 * 96).astype(np.uint16).reshape(64, 96)
    assert cv2.imwrite(str(tmp_path / "a.png"), deep)
    video = write_video(tmp_path / "a.mkv", [deep], codec="ffv1", pixel_format="gray16le", source_format="gray16le")
    for path in (tmp_path / "a.png", video):
        [(_, _, shown)] = read(path)
        assert np.array_equal(shown, np.repeat(np.round(deep / 257).astype(np.uint8)[..., None], 3, axis=2))


def test_transparent_pixels_lie_over_mid_grey(tmp_path):
    colours = np.zeros((8, 8, 4), np.uint8)
    colours[..., 0] = 200  # red
    colours[:4, :, 3] = 255
    colours[4:6, :, 3] = 51
    video = write_video(tmp_path / "a.mov", [colours], codec="png", pixel_format="rgba", source_format="rgba")
    [(_, _, shown)] = read(video)
    assert shown[0, 0].tolist() == [200, 0, 0]
    assert shown[5, 0].tolist() == [142, 102, 102]
    assert shown[7, 7].tolist() == [128, 128, 128]


def test_palette_pictures(tmp_path):
    def chunk(name: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    rows = b"\0\0\1" + b"\0\1\2"  # a filter byte, then indices
    (tmp_path / "a.png").write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", 2, 2, 8, 3, 0, 0, 0))
        + chunk(b"PLTE", bytes([10, 20, 30, 40, 50, 60, 70, 80, 90]))
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )
    [(_, _, shown)] = read(tmp_path / "a.png")
    assert shown.tolist() == [[[10, 20, 30], [40, 50, 60]], [[40, 50, 60], [70, 80, 90]]]


@pytest.mark.parametrize("size", [(8, 8), (9, 7), (1, 1)], ids=str)
def test_small_and_odd_sizes(tmp_path, size):
    pictures = moving_pictures(3, *size)
    video = write_video(tmp_path / "a.mkv", pictures, codec="ffv1", pixel_format="bgr0")
    folder = write_pictures(tmp_path / "folder", pictures)
    for got in (read(video), read(folder, fps=25)):
        assert [np.array_equal(row[2], picture) for row, picture in zip(got, pictures, strict=True)] == [True] * 3


@pytest.mark.slow
def test_8000_px_a_side(tmp_path):
    big = np.zeros((8000, 8000, 3), np.uint8)
    big[4000:4100, 5000:5100] = (200, 100, 50)
    video = write_video(tmp_path / "a.mp4", [big], codec="mjpeg", pixel_format="yuvj420p")
    with open_frames(video) as opened:
        [part] = [frame.rgb((4010, 4020, 5010, 5020)) for frame in opened]
    assert np.abs(part.astype(int) - (200, 100, 50)).max() < 6


# --- damage -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("a.mp4", {"container_options": {"movflags": "faststart"}}),
        ("a.mkv", {}),
        ("a.webm", {"codec": "libvpx-vp9", "options": {"deadline": "realtime", "cpu-used": "8"}}),
        ("a.avi", {"codec": "mjpeg", "pixel_format": "yuvj420p"}),
        ("a.mpg", {"codec": "mpeg1video"}),
    ],
)
def test_a_cut_off_file_is_read_to_its_last_readable_frame(tmp_path, capfd, name, how):
    path = write_video(tmp_path / name, moving_pictures(40, 128, 192), **how)
    whole = read(path)
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * 0.7)])
    with open_frames(path) as opened:
        got = [(frame.index, frame.time_s, frame.rgb()) for frame in opened]
    assert 10 < len(got) < 40
    assert_same(got[:-2], whole[: len(got) - 2])
    # the head of an mpg does not tell its length
    assert any(("damaged" if name == "a.mpg" else "is cut off") in text for text in opened.warnings)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv"])
def test_a_damaged_middle_is_gone_past(tmp_path, capfd, name):
    path = write_video(tmp_path / name, moving_pictures(60))
    whole = read(path)
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + len(data) // 10] = bytes(len(data) // 10)
    path.write_bytes(data)
    with open_frames(path) as opened:
        got = [(frame.time_s, frame.rgb()) for frame in opened]
    assert 30 < len(got) < 60
    assert {time_s for time_s, _ in got} < {time_s for _, time_s, _ in whole}
    assert got[-1][0] == whole[-1][1]
    assert np.array_equal(got[-1][1], whole[-1][2])  # sound again after the next key picture
    assert any("x, first near" in text for text in opened.warnings)
    assert capfd.readouterr() == ("", "")


def test_pixels_that_are_not_square_are_told(tmp_path):
    path = write_video(tmp_path / "a.avi", moving_pictures(2, 576, 720), codec="dvvideo")
    with open_frames(path) as opened:
        assert opened.info.pixel_aspect == pytest.approx(16 / 15)
        assert "1.067 times as wide as high" in opened.warnings[0]


# --- picture sequences ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", ["png", "bmp", "tif", "webp", "ppm", "jpg"])
def test_a_folder_is_read_in_natural_order(tmp_path, suffix):
    pictures = moving_pictures(12)
    folder = write_pictures(tmp_path / "take", pictures, "frame_{}." + suffix)
    (folder / "notes.txt").write_text("not a picture")
    (folder / ("._frame_1." + suffix)).write_text("left by a Mac")
    got = read(folder, fps=50)
    assert [row[:2] for row in got] == [(i, i / 50) for i in range(12)]
    apart = [np.abs(row[2].astype(int) - picture).mean() for row, picture in zip(got, pictures, strict=True)]
    assert max(apart) < (3 if suffix in ("jpg", "webp") else 1e-9)


def test_a_pattern_chooses_among_the_files(tmp_path):
    folder = write_pictures(tmp_path / "take[1]", moving_pictures(4), "left_{}.png")
    write_pictures(folder, moving_pictures(3, seed=1), "right_{}.png")
    assert len(read(folder, fps=25)) == 7
    assert len(read(tmp_path / "take*" / "right_*.png", fps=25)) == 3


@pytest.mark.parametrize(
    "text",
    [
        "0.5\n0.54\n0.6\n",
        "# seconds\n\n0.5\n0.54\n0.6",
        "frame,time_s\n0,0.5\n1,0.54\n2,0.6\n",
        "time_s;x\n.5;\n.54;\n.6;",
    ],
    ids=["lines", "comment", "table", "semicolons"],
)
def test_time_stamp_files(tmp_path, text):
    folder = write_pictures(tmp_path / "take", moving_pictures(3))
    (tmp_path / "times.csv").write_text(text)
    with open_frames(folder, timestamps=tmp_path / "times.csv", start_s=0.52) as opened:
        assert [(frame.index, frame.time_s) for frame in opened] == [(1, 0.54), (2, 0.6)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0\n0.1\n", "3 pictures, but .*times.csv has 2"),
        ("0\n0.2\n0.1\n", "time 3 is 0.1 after 0.2"),
        ("0\n0.1\n0.1\n", "time 3 is 0.1 after 0.1"),
        ("0\n0.1\nnan\n", "time 3 is nan"),
        ("0\n0.1\nlate\n", "late"),
        ("a,b\n0,1\n0,2\n", "column time_s"),
        ("", "is empty"),
        (None, "cannot read time stamps"),
    ],
    ids=["too few", "backwards", "twice", "NaN", "words", "no such column", "empty", "missing"],
)
def test_bad_time_stamp_files(tmp_path, text, message):
    folder = write_pictures(tmp_path / "take", moving_pictures(3))
    if text is not None:
        (tmp_path / "times.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        open_frames(folder, timestamps=tmp_path / "times.csv")


def test_gaps_and_mixed_types_in_a_sequence_are_told(tmp_path):
    folder = write_pictures(tmp_path / "take", moving_pictures(4))
    assert open_frames(folder, fps=25).warnings == []
    (folder / "frame_2.png").unlink()
    assert "gaps" in open_frames(folder, fps=25).warnings[0]
    write_pictures(folder, moving_pictures(1), "other_{}.bmp")
    assert "several file types" in open_frames(folder, fps=25).warnings[0]


def test_one_picture_needs_no_rate(tmp_path):
    folder = write_pictures(tmp_path, moving_pictures(1))
    assert [row[:2] for row in read(folder)] == [row[:2] for row in read(folder / "frame_0.png")] == [(0, 0.0)]


@pytest.mark.parametrize("fps", [0, -25, float("nan"), float("inf"), 1e9, "fast"])
def test_absurd_rates(tmp_path, fps):
    with pytest.raises(InputError, match="expected fps above 0"):
        open_frames(write_pictures(tmp_path, moving_pictures(2)), fps=fps)


def test_bad_pictures_are_named(tmp_path):
    folder = write_pictures(tmp_path / "take", moving_pictures(3))
    write_pictures(folder, moving_pictures(1, 32, 32), "frame_9{}.png")
    with pytest.raises(InputError, match=r"frame_90\.png is 32 x 32 px .* 96 x 64 px"):
        read(folder, fps=25)
    (folder / "frame_1.png").write_bytes((folder / "frame_2.png").read_bytes()[:60])
    with pytest.raises(InputError, match=r"cannot read picture .*frame_1\.png"):
        read(folder, fps=25)
    (folder / "frame_0.png").write_text("not a picture")
    with pytest.raises(InputError, match=r"cannot read picture .*frame_0\.png"):
        open_frames(folder, fps=25)


# --- bad input --------------------------------------------------------------------------------------------------------


def cut_before_the_index(path: Path) -> Path:
    write_video(path, moving_pictures(5))
    path.write_bytes(path.read_bytes()[:-400])
    return path


def no_frames(path: Path) -> Path:
    """A video whose packets are there but hold nothing."""
    write_video(path, moving_pictures(5), container_options={"movflags": "faststart"})
    data = path.read_bytes()
    start = data.index(b"mdat") + 4
    path.write_bytes(data[:start] + bytes(len(data) - start))
    return path


def made(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def folder_of(path: Path, name: str) -> Path:
    path.mkdir()
    (path / name).write_text("x")
    return path


BAD_SOURCES = {
    "missing": (lambda at: at / "absent.mp4", "does not exist"),
    "empty": (lambda at: made(at / "a.mp4", b""), r"is empty \(0 bytes\)"),
    "text named mp4": (lambda at: made(at / "a.mp4", b"hello there\n" * 50), "cannot read .* as a video"),
    "text": (lambda at: made(at / "a.txt", b"hello there\n" * 50), "is a text file"),
    "cut before its index": (lambda at: cut_before_the_index(at / "a.mp4"), "cut off before its index"),
    "sound only": (lambda at: write_sound(at / "a.mp4"), "sound only"),
    "no frames": (lambda at: no_frames(at / "a.mp4"), "none can be decoded"),
    "folder without pictures": (lambda at: folder_of(at / "takes", "a.mp4"), "there is none among its 1 files"),
    "empty folder": (lambda at: at, "there is none among its 0 files"),
    "pattern without match": (lambda at: at / "*.png", "there is none among its 0 files"),
    "neither file nor folder": (lambda at: Path("/dev/null"), "neither"),
    "too large": (
        lambda at: write_pictures(at, [np.zeros((2, 20_001, 3), np.uint8)]) / "frame_0.png",
        "at most 20000 px",
    ),
}


@pytest.mark.parametrize(("make", "message"), BAD_SOURCES.values(), ids=BAD_SOURCES.keys())
def test_bad_sources_raise_one_sentence(tmp_path, capfd, make, message):
    source = make(tmp_path)
    capfd.readouterr()  # encoders talk
    with pytest.raises(InputError, match=message) as error:
        open_frames(source)
    assert "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"fps": 25}, "fps or timestamps only with pictures"),
        ({"timestamps": [0.0]}, "fps or timestamps only with pictures"),
        ({"start_s": -1}, "start -1"),
        ({"start_s": float("nan")}, "start nan"),
        ({"stop_s": float("nan")}, "stop nan"),
        ({"start_s": 2, "stop_s": 2}, "start 2 and stop 2"),
        ({"every": 0}, "every to be a whole number"),
        ({"every": 1.5}, "every to be a whole number"),
        ({"every": True}, "every to be a whole number"),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else "",
)
def test_arguments_that_do_not_fit(tmp_path, how, message):
    path = write_video(tmp_path / "a.mp4", moving_pictures(1))
    with pytest.raises(InputError, match=message):
        open_frames(path, **how)


def test_pictures_need_one_of_rate_and_times(tmp_path):
    folder = write_pictures(tmp_path, moving_pictures(2))
    with pytest.raises(InputError, match="got neither"):
        open_frames(folder)
    with pytest.raises(InputError, match="got both"):
        open_frames(folder, fps=25, timestamps=[0.0, 1.0])


def test_one_frame_is_a_video(tmp_path):
    assert [row[:2] for row in read(write_video(tmp_path / "a.mp4", moving_pictures(1)))] == [(0, 0.0)]


def write_with_cover(path: Path, codec: str) -> Path:
    """A file with a cover picture of 500 px and a stream of the codec: libx264 or aac."""
    with av.open(str(path), "w") as container:
        art = container.add_stream("png", rate=25)
        art.width = art.height = 500
        art.pix_fmt = "rgb24"
        art.disposition = av.stream.Disposition.attached_pic
        stream = container.add_stream(codec, rate=25 if codec == "libx264" else 16000)
        if codec == "libx264":
            stream.height, stream.width, stream.pix_fmt = 64, 96, "yuv420p"
            content = [av.VideoFrame.from_ndarray(picture, format="rgb24") for picture in moving_pictures(3)]
        else:
            content = [av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")]
            content[0].sample_rate = 16000
        container.start_encoding()
        packet = av.Packet(cv2.imencode(".png", smooth_picture(500, 500))[1].tobytes())
        packet.stream, packet.pts, packet.dts, packet.time_base = art, 0, 0, Fraction(1, 25)
        packet.is_keyframe = True
        container.mux(packet)
        for i, frame in enumerate(content):
            frame.pts, frame.time_base = i, Fraction(1, 25)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def test_cover_art_is_not_the_video(tmp_path):
    with open_frames(write_with_cover(tmp_path / "a.mp4", "libx264")) as opened:
        assert (opened.info.width, opened.info.codec, len(times_of(opened))) == (96, "h264", 3)
    with pytest.raises(InputError, match="sound only"):
        open_frames(write_with_cover(tmp_path / "song.mp4", "aac"))


def test_sound_beside_the_picture_is_seen(tmp_path):
    assert open_frames(write_video(tmp_path / "a.mp4", moving_pictures(3), sound=True)).info.has_audio
    assert not open_frames(write_video(tmp_path / "b.mp4", moving_pictures(3))).info.has_audio


def test_a_title_in_another_encoding_does_no_harm(tmp_path):
    path = write_video(tmp_path / "a.mp4", moving_pictures(3))
    data = path.read_bytes()
    name = b"VideoHandler"
    assert name in data
    path.write_bytes(data.replace(name, b"\xff\xfe\xa0\x80" + name[4:]))
    with open_frames(path) as frames:
        assert len(list(frames)) == 3


def test_a_kind_of_picture_that_nobody_knows(tmp_path):
    path = write_video(tmp_path / "a.avi", moving_pictures(3), codec="mjpeg", pixel_format="yuvj420p")
    path.write_bytes(path.read_bytes().replace(b"MJPG", b"zz\0\1"))
    with pytest.raises(InputError, match="a kind of picture that is unknown"):
        open_frames(path)


def test_a_time_stamp_longer_than_a_field_of_csv(tmp_path):
    write_pictures(tmp_path / "p", moving_pictures(2))
    (tmp_path / "t.txt").write_text("time_s,x\n0.0," + "9" * 200_000 + "\n0.1,1\n")
    with pytest.raises(InputError, match="field larger"):
        open_frames(tmp_path / "p", timestamps=tmp_path / "t.txt")
