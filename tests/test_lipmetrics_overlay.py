from fractions import Fraction
from functools import cache
from types import SimpleNamespace

import av
import mouth_clip
import numpy as np
import pytest
from clips import write_pictures, write_video
from mouth_clip import looks_of, picture, profile_of

from lipmetrics.draw import COLOURS, View, found_by_frame
from lipmetrics.errors import InputError
from lipmetrics.look import OPEN, Look
from lipmetrics.overlay import LARGE_AREA_PX, LARGE_SIDE_PX, _audio_packets, draw_overlay, plan_layout, write_overlay

TIME_BASE = Fraction(1, 90_000)
# 30 frames a second, then 15, then a gap: what a telephone writes when it gets dark
TICKS = [0, 3_000, 6_000, 9_000, 15_000, 21_000, 27_000, 90_001]
LOOKS = looks_of(["open", "open", "closed", "no_mouth", "open", "open", "open", "open"])


@cache
def seen():
    """Not while tests are collected: it compiles."""
    return profile_of(LOOKS, [tick / 90_000 for tick in TICKS])


def write_clip(path, ticks=TICKS, looks=LOOKS, **options):
    pictures = [picture(look.outlines) for look in looks]
    return write_video(path, pictures, ticks=ticks, time_base=TIME_BASE, **options)


def add_sound(path, codec, rate, tone_from_s):
    """Write a file of 12 pictures at 25 per second and 0.6 s of sound, a 1 kHz tone after silence."""
    with av.open(str(path), "w") as target:
        video = target.add_stream("mpeg2video", rate=25)
        video.height, video.width, video.pix_fmt = mouth_clip.HEIGHT, mouth_clip.WIDTH, "yuv420p"
        audio = target.add_stream(codec, rate=rate, layout="mono")
        for k in range(12):
            frame = av.VideoFrame.from_ndarray(picture([]), format="rgb24")
            frame.pts, frame.time_base = k, Fraction(1, 25)
            target.mux(video.encode(frame))
        target.mux(video.encode())
        at_s = np.arange(int(0.6 * rate)) / rate
        tone = np.where(at_s >= tone_from_s, 12_000 * np.sin(2_000 * np.pi * at_s), 0).astype(np.int16)
        samples = av.AudioFrame.from_ndarray(tone[None], format="s16", layout="mono")
        samples.sample_rate, samples.pts, samples.time_base = rate, 0, Fraction(1, rate)
        target.mux(audio.encode(samples))
        target.mux(audio.encode())
    return path


def tone_start_s(path):
    """When the sound gets louder than a tenth of its maximum."""
    with av.open(str(path)) as container:
        blocks = [(f.time, f.sample_rate, f.to_ndarray().astype(float)) for f in container.decode(audio=0)]
    peak = max(np.abs(samples).max() for _, _, samples in blocks)
    for time_s, rate, samples in blocks:
        loud = np.flatnonzero(np.abs(samples).max(axis=0) > peak / 10)
        if len(loud):
            return time_s + loud[0] / rate
    return np.nan


def frame_ticks(path):
    with av.open(str(path)) as container:
        return [round(Fraction(f.pts) * f.time_base / TIME_BASE) for f in container.decode(video=0)]


def audio_packets(path):
    with av.open(str(path)) as container:
        return [(bytes(p), p.pts * p.time_base) for p in container.demux(audio=0) if p.pts is not None]


def test_frames_keep_their_times_to_the_tick(tmp_path):
    source = write_clip(tmp_path / "a.mp4")
    assert write_overlay(source, seen(), tmp_path / "o.mp4") == []
    assert frame_ticks(source) == TICKS
    assert frame_ticks(tmp_path / "o.mp4") == TICKS


def test_pictures_keep_the_times_given_to_the_microsecond(tmp_path):
    folder = write_pictures(tmp_path / "take", [picture(look.outlines) for look in LOOKS])
    times_s = [0.0, 0.1234567, 0.5, 0.5000001, 1.0, 2.0, 10.0, 100.0]
    write_overlay(folder, seen(), tmp_path / "o.mp4", timestamps=times_s)
    with av.open(str(tmp_path / "o.mp4")) as container:
        read_s = [f.time for f in container.decode(video=0)]
    np.testing.assert_allclose(read_s, times_s, atol=1e-6, rtol=0)


def test_a_cut_starts_at_zero_and_keeps_its_spacing(tmp_path):
    source = write_clip(tmp_path / "a.mp4")
    write_overlay(source, seen(), tmp_path / "o.mp4", start_s=0.1, stop_s=0.4, every=2)
    assert frame_ticks(tmp_path / "o.mp4") == [15_000 - 9_000, 27_000 - 9_000]


@pytest.mark.parametrize(("first", "expected"), [(80_000, 80_000), (10**9, 0)], ids=["soon", "broadcast clock"])
def test_a_late_clock_plays_from_the_first_frame(tmp_path, first, expected):
    source = write_clip(tmp_path / "a.mkv", ticks=[first + tick for tick in TICKS])
    write_overlay(source, seen(), tmp_path / "o.mp4")
    assert frame_ticks(tmp_path / "o.mp4")[0] == pytest.approx(expected, abs=90)  # mkv counts in milliseconds


def test_it_plays_in_a_browser(tmp_path):
    write_overlay(write_clip(tmp_path / "a.mp4"), seen(), tmp_path / "o.mp4")
    data = (tmp_path / "o.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat"), "starts to play before it is all there"
    with av.open(str(tmp_path / "o.mp4")) as container:
        video = container.streams.video[0].codec_context
        assert (video.name, video.pix_fmt) == ("h264", "yuv420p")
        assert (video.width % 2, video.height % 2) == (0, 0)


def test_aac_is_copied_packet_by_packet(tmp_path):
    source = write_clip(tmp_path / "a.mp4", ticks=[k * 3_600 for k in range(8)], sound=True)
    write_overlay(source, seen(), tmp_path / "o.mp4")
    assert len(audio_packets(source)) > 3
    assert audio_packets(tmp_path / "o.mp4") == audio_packets(source)


def test_sound_is_cut_with_the_picture(tmp_path):
    source = write_clip(tmp_path / "a.mp4", ticks=[k * 3_600 for k in range(8)], sound=True)
    write_overlay(source, seen(), tmp_path / "o.mp4", start_s=0.1, stop_s=0.2)
    kept = [(data, at_s - Fraction(1, 10)) for data, at_s in audio_packets(source) if 0.1 <= at_s < 0.2]
    assert kept
    assert audio_packets(tmp_path / "o.mp4") == kept


@pytest.mark.parametrize(
    ("name", "codec", "rate"),
    [("a.mpg", "mp2", 44_100), ("a.mkv", "pcm_s16le", 16_000), ("a.avi", "pcm_s16le", 22_050)],
)
def test_other_sound_becomes_aac_in_time(tmp_path, name, codec, rate):
    source = add_sound(tmp_path / name, codec, rate, tone_from_s=0.3)
    profile = profile_of(looks_of(["closed"] * 12), [k / 25 for k in range(12)])
    assert write_overlay(source, profile, tmp_path / "o.mp4") == []
    with av.open(str(source)) as before, av.open(str(tmp_path / "o.mp4")) as after:
        assert after.streams.audio[0].codec_context.name == "aac"
        first_s = [next(container.decode(video=0)).time for container in (before, after)]
    # what counts is the sound against the picture; AAC rings a little ahead of a sudden tone
    assert tone_start_s(tmp_path / "o.mp4") - first_s[1] == pytest.approx(tone_start_s(source) - first_s[0], abs=0.012)


def test_sound_that_no_decoder_knows_is_left_out_and_told():
    remarks = []
    assert list(_audio_packets(SimpleNamespace(codec_context=None), None, 0.0, (0.0, 1.0), remarks)) == []
    assert remarks == ["the overlay has no sound: no decoder knows its kind"]


@pytest.mark.parametrize(
    "size", [(8, 8), (256, 256), (33, 641), (1080, 1920), (1280, 720), (8000, 8000), (2, 20000), (20000, 3)], ids=str
)
def test_layout_fits_text_and_players(size):
    layout = plan_layout(*size)
    assert (layout.height % 2, layout.width % 2) == (0, 0)
    assert layout.picture_height * layout.picture_width <= 1.01 * LARGE_AREA_PX
    assert max(layout.picture_height, layout.picture_width) <= LARGE_SIDE_PX
    assert layout.picture_height == pytest.approx(size[0] * layout.scale, abs=1)
    assert layout.picture_width == pytest.approx(size[1] * layout.scale, abs=1)
    assert layout.text_px >= 11
    rows, cols = zip(*layout.cells.values(), strict=True)
    assert min(rows) >= layout.picture_height, "text hides no part of the picture"
    assert max(rows) + 3.5 * layout.text_px <= layout.height
    assert min(cols) > 0
    assert layout.scale == 1 or min(size) < 400 or max(size) > 3840


def test_outlines_and_corners_land_on_the_mouth():
    two = [mouth_clip.ellipse(8, (60, 30), 10), mouth_clip.ellipse(8, (60, 70), 10)]
    corners = np.array([[55.0, 15.0], [55.0, 90.0]])
    profile = profile_of([Look(OPEN, two, corners)], [0.0])
    layout = plan_layout(mouth_clip.HEIGHT, mouth_clip.WIDTH)
    drawn = draw_overlay(picture([]), layout, found_by_frame(profile)[0], 0, 0.0)
    assert layout.scale == 5
    for outline, colour in zip(two, COLOURS, strict=False):
        rows, cols = np.nonzero((np.abs(drawn[: layout.picture_height].astype(int) - colour) < 40).all(axis=2))
        low, high = View(layout.scale).to_drawn(np.array([outline.min(axis=0), outline.max(axis=0)]))
        np.testing.assert_allclose([rows.min(), cols.min(), rows.max(), cols.max()], [*low, *high], atol=1.5)
    assert (drawn[55 * 5 + 2, [15 * 5 + 2, 90 * 5 + 2]] > 230).all()


def test_pixel_centres_stay_centres_when_enlarged():
    np.testing.assert_allclose(View(3, row0=10, col0=20).to_drawn([[10.0, 20.0], [9.5, 19.5]]), [[1, 1], [-0.5, -0.5]])


@pytest.mark.parametrize("measured", [True, False])
def test_the_picture_itself_is_left_alone_where_nothing_was_found(measured):
    profile = profile_of(looks_of(["no_mouth"]), [0.0])
    layout = plan_layout(600, 501)
    still = np.random.default_rng(1).integers(0, 256, (600, 501, 3), dtype=np.uint8)
    drawn = draw_overlay(still, layout, found_by_frame(profile)[0] if measured else None, 7, 1.5)
    assert layout.scale == 1
    np.testing.assert_array_equal(drawn[:600, :501], still)
    assert drawn[600:].max() > 200


def test_strip_changes_with_the_numbers():
    profile = profile_of(looks_of(["open", "closed"]), [0.0, 0.04])
    layout = plan_layout(mouth_clip.HEIGHT, mouth_clip.WIDTH)
    found = found_by_frame(profile)
    strips = [draw_overlay(picture([]), layout, f, 0, 0.0)[layout.picture_height :] for f in (found[0], found[1], None)]
    assert not np.array_equal(strips[0], strips[1])
    assert not np.array_equal(strips[1], strips[2])


def test_rotated_source_is_drawn_upright(tmp_path):
    source = write_clip(tmp_path / "a.mp4", rotation_deg=90)
    write_overlay(source, seen(), tmp_path / "o.mp4")
    expected = plan_layout(mouth_clip.WIDTH, mouth_clip.HEIGHT)
    with av.open(str(tmp_path / "o.mp4")) as container:
        frame = next(container.decode(video=0))
        assert (frame.height, frame.width, frame.rotation) == (expected.height, expected.width, 0)


def test_oblong_pixels_stay_oblong(tmp_path):
    with av.open(str(tmp_path / "a.mp4"), "w") as target:
        video = target.add_stream("libx264", rate=25)
        video.height, video.width, video.pix_fmt = mouth_clip.HEIGHT, mouth_clip.WIDTH, "yuv420p"
        video.codec_context.sample_aspect_ratio = Fraction(16, 15)
        target.mux(video.encode(av.VideoFrame.from_ndarray(picture([]), format="rgb24")))
        target.mux(video.encode())
    write_overlay(tmp_path / "a.mp4", seen(), tmp_path / "o.mp4")
    with av.open(str(tmp_path / "o.mp4")) as container:
        assert container.streams.video[0].sample_aspect_ratio == Fraction(16, 15)


def test_frames_that_the_profile_does_not_hold_are_drawn_too(tmp_path):
    source = write_clip(tmp_path / "a.mp4")
    write_overlay(source, profile_of(LOOKS[:2], [0.0, 1 / 30]), tmp_path / "o.mp4")
    assert frame_ticks(tmp_path / "o.mp4") == TICKS


def test_a_profile_without_outlines_is_refused(tmp_path):
    bare = profile_of(LOOKS, [tick / 90_000 for tick in TICKS])
    bare.outlines, bare.corners = [], []
    with pytest.raises(InputError, match="expected a profile with outlines"):
        write_overlay(write_clip(tmp_path / "a.mp4"), bare, tmp_path / "o.mp4")


def test_nothing_is_left_of_an_overlay_that_fails_half_way(tmp_path, monkeypatch):
    source = write_clip(tmp_path / "a.mp4")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "o.mp4").write_bytes(b"older")

    def fail_at_the_fifth(*arguments):
        if arguments[3] == 4:
            raise OSError(28, "No space left on device")
        return draw_overlay(*arguments)

    monkeypatch.setattr("lipmetrics.overlay.draw_overlay", fail_at_the_fifth)
    with pytest.raises(InputError, match="No space left on device"):
        write_overlay(source, seen(), tmp_path / "out" / "o.mp4")
    assert [(p.name, p.read_bytes()) for p in (tmp_path / "out").iterdir()] == [("o.mp4", b"older")]


def test_a_place_that_cannot_be_written_to(tmp_path):
    source = write_clip(tmp_path / "a.mp4")
    with pytest.raises(InputError, match="expected to write"):
        write_overlay(source, seen(), source / "o.mp4")
