"""Cutting long takes: which pictures a clip has, when, with which sound; cut lists, and cuts proposed."""

import csv
from fractions import Fraction

import av
import numpy as np
import pytest
from clips import smooth_picture, write_video

from corpus_tools import cutting
from corpus_tools.activity import Event, find_events, read_activity
from corpus_tools.cuts import read_cuts
from corpus_tools.long_take import read_take
from corpus_tools.propose import propose, write_proposal
from corpus_tools.protocol import load_protocol
from corpus_tools.segment import segment
from lipmetrics.cli import main
from lipmetrics.errors import InputError
from lipmetrics.frames import open_frames

PROTOCOL = load_protocol()
CUTS = "start_s,stop_s,speaker,utterance,repeat\n"
BLOCK = 8


def numbered(count, height=64, width=96):
    """Pictures that say their number in black and white blocks, over patches that move."""
    still = smooth_picture(height, 2 * width)
    pictures = []
    for i in range(count):
        picture = np.ascontiguousarray(np.roll(still, 2 * i, axis=1)[:, :width])
        for bit in range(10):
            picture[:BLOCK, bit * BLOCK : (bit + 1) * BLOCK] = 255 * (i >> bit & 1)
        pictures.append(picture)
    return pictures


def number_of(rgb):
    return sum(int(rgb[2:-2, :][: BLOCK - 4, k * BLOCK + 2 : k * BLOCK + 6].mean() > 128) << k for k in range(10))


def read(path):
    frames = list(open_frames(path))
    return [frame.rgb() for frame in frames], np.array([frame.time_s for frame in frames])


def rows_of(path):
    with open(path, newline="") as file:
        return {row["clip"]: row for row in csv.DictReader(file)}


def cut(tmp_path, take, lines, head=CUTS, **settings):
    cuts = tmp_path / "cuts.csv"
    cuts.write_text(head + lines)
    answer = segment(take, tmp_path / "clips", cuts=cuts, protocol=PROTOCOL, **settings)
    return answer, rows_of(tmp_path / "clips" / f"{take.stem}.segment.csv")


@pytest.mark.parametrize(
    ("name", "codec", "copied", "options"),
    [
        ("take.mp4", "libx264", {"p_m_1"}, {"bf": "0"}),
        ("take.mov", "mjpeg", {"p_m_1", "p_m_2", "p_p_1"}, {}),
        ("take.mkv", "libx265", {"p_m_1"}, {"x265-params": "bframes=0:log-level=error:open-gop=0"}),
        ("take.webm", "libvpx-vp9", set(), {}),
        ("take.avi", "mpeg4", set(), {}),
        ("take.mpg", "mpeg1video", set(), {}),
    ],
)
def test_clips_have_the_pictures_that_are_shown_in_their_time(tmp_path, name, codec, copied, options):
    pixels = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    made = dict(codec=codec, pixel_format=pixels, options=options, key_every=20)
    take = write_video(tmp_path / name, numbered(90), **made)
    source, _ = read(take)
    # from 0.8 s on: a key picture; 1.602: just after that of frame 40, so from 41 on; the last until the very end
    lines = "0.8,1.4,p,m,1\n1.602,2.6,p,m,2\n2.8,3.6,p,p,1\n"
    answer, rows = cut(tmp_path, take, lines)
    expected = {"p_m_1": range(20, 35), "p_m_2": range(41, 65), "p_p_1": range(70, 90)}
    assert answer["done_n"] == 3 and not answer["failed"] and answer["copied_n"] == len(copied)
    for clip, frames in expected.items():
        row = rows[clip]
        pictures, time_s = read(tmp_path / "clips" / row["file"])
        assert [number_of(picture) for picture in pictures] == list(frames)
        assert (int(row["first_frame"]), int(row["last_frame"])) == (frames[0], frames[-1])
        assert float(row["first_s"]) == pytest.approx(frames[0] / 25, abs=0.0011)
        assert time_s == pytest.approx(np.arange(len(frames)) / 25, abs=0.0011)
        assert row["how"] == ("copied" if clip in copied else "re-encoded") and bool(row["why"]) != (clip in copied)
        worst = max(np.square(a.astype(float) - b).mean() for a, b in zip(pictures, source[frames[0] :], strict=False))
        assert worst == 0


def test_clips_with_loss_are_smaller_and_near(tmp_path):
    take = write_video(tmp_path / "take.mp4", numbered(40), tags={"color_range": 2, "colorspace": 1})
    source, _ = read(take)
    sizes = []
    for crf in (None, 10):
        _, rows = cut(tmp_path, take, "0.2,1.2,p,m,1\n", crf=crf, overwrite=True)
        path = tmp_path / "clips" / rows["p_m_1"]["file"]
        worst = max(np.square(a.astype(float) - b).mean() for a, b in zip(read(path)[0], source[5:30], strict=True))
        assert worst == 0 if crf is None else 0 < worst < 65025 / 10**4.2  # 42 dB
        sizes.append(path.stat().st_size)
    assert sizes[1] < sizes[0]


def test_times_between_pictures_are_kept_to_the_tick(tmp_path):
    steps = np.random.default_rng(1).integers(1200, 7000, 60)
    ticks = np.concatenate([[0], np.cumsum(steps)]).tolist()
    take = write_video(tmp_path / "take.mp4", numbered(61), ticks=ticks, time_base=Fraction(1, 90_000))
    low_s, high_s = ticks[13] / 90_000, ticks[44] / 90_000
    _, rows = cut(tmp_path, take, f"{low_s:.3f},{high_s:.3f},p,m,1\n")
    pictures, time_s = read(tmp_path / "clips" / rows["p_m_1"]["file"])
    assert [number_of(picture) for picture in pictures] == list(range(13, 44))
    assert np.round(time_s * 90_000) == pytest.approx(np.array(ticks[13:44]) - ticks[13], abs=1e-6)


def test_pictures_that_need_one_outside_are_not_copied(tmp_path):
    options = {"bf": "2", "b_adapt": "0", "sc_threshold": "0"}
    take = write_video(tmp_path / "take.mp4", numbered(60), options=options, key_every=30)
    known = read_take(take)
    # I B B P B B P ...: frame 31 alone comes after the P that it needs
    assert cutting.why_not_copied(known, 30, 32) == "needs a picture outside of it"
    assert cutting.why_not_copied(known, 30, 34) == "" and cutting.why_not_copied(known, 30, 60) == ""
    assert cutting.why_not_copied(known, 31, 34) == "does not begin on a key picture"
    _, rows = cut(tmp_path, take, "1.2,1.28,p,m,1\n1.36,1.6,p,m,2\n")
    assert rows["p_m_1"]["why"] == "needs a picture outside of it"
    assert [number_of(p) for p in read(tmp_path / "clips/p_m_1.mp4")[0]] == [30, 31]


def test_a_copy_that_cannot_be_decoded_is_encoded_instead(tmp_path, monkeypatch):
    take = write_video(tmp_path / "take.mp4", numbered(60), options={"bf": "0"}, key_every=30)
    monkeypatch.setattr(cutting, "why_not_copied", lambda *_: "")  # frame 5 is no key picture
    answer, rows = cut(tmp_path, take, "0.2,0.6,p,m,1\n")
    assert rows["p_m_1"]["how"] == "re-encoded" and "could not be copied" in rows["p_m_1"]["why"]
    assert [number_of(p) for p in read(tmp_path / "clips/p_m_1.mp4")[0]] == list(range(5, 15))
    assert answer["copied_n"] == 0 and not list((tmp_path / "clips").glob(".*"))


@pytest.mark.parametrize("hflip", [False, True])
@pytest.mark.parametrize("turn", [0, 90, 180, 270])
def test_turned_and_mirrored_takes_stay_so(tmp_path, turn, hflip):
    take = write_video(tmp_path / "take.mp4", numbered(30), rotation_deg=turn, hflip=hflip, options={"bf": "0"})
    source, _ = read(take)
    _, rows = cut(tmp_path, take, "0.4,0.56,p,m,1\n0.6,0.72,p,m,2\n")
    assert [row["how"] for row in rows.values()] == ["copied", "re-encoded"]
    for clip, first in (("p_m_1", 10), ("p_m_2", 15)):
        for a, b in zip(read(tmp_path / "clips" / rows[clip]["file"])[0], source[first:], strict=False):
            assert a.shape == b.shape and np.abs(a.astype(float) - b).mean() < 2


def write_beeps(path, sound_codec, beeps_s, seconds=6, rate=16_000, pictures=None):
    """A take with a beep of 0.1 s at each of these times."""
    pictures = numbered(25 * seconds) if pictures is None else pictures
    samples = np.zeros(seconds * rate)
    for at_s in beeps_s:
        span = np.arange(round(at_s * rate), round((at_s + 0.1) * rate))
        samples[span] = 0.5 * np.sin(2 * np.pi * 1000 * span / rate)
    codec = "mpeg4" if path.suffix == ".avi" else "libx264"
    with av.open(str(path), "w") as target:
        video = target.add_stream(codec, rate=25, options={"bf": "0"})
        video.height, video.width, video.pix_fmt, video.gop_size = 64, 96, "yuv420p", 25
        sound = target.add_stream(sound_codec, rate=rate, layout="mono")
        for i, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = i, Fraction(1, 25)
            target.mux(video.encode(frame))
            low = i * rate // 25
            form = "s16" if sound_codec.startswith("pcm") else "fltp"
            piece = samples[None, low : low + rate // 25]
            piece = (piece * 32767).astype(np.int16) if form == "s16" else piece.astype(np.float32)
            heard = av.AudioFrame.from_ndarray(np.ascontiguousarray(piece), format=form, layout="mono")
            heard.sample_rate, heard.pts, heard.time_base = rate, low, Fraction(1, rate)
            target.mux(sound.encode(heard))
        target.mux(video.encode())
        target.mux(sound.encode())
    return path


def beeps_in(path):
    """Times at which the sound begins to be loud, s on the clip's clock, and when the sound ends."""
    starts, end_s, last_loud_s = [], 0.0, -1.0
    with av.open(str(path)) as container:
        for frame in container.decode(audio=0):
            values = frame.to_ndarray()[0].astype(float)
            values = values / (32768 if "16" in frame.format.name else 1)
            for k in np.flatnonzero(np.abs(values) > 0.1):
                at_s = frame.time + k / frame.sample_rate
                if at_s - last_loud_s > 0.2:
                    starts.append(at_s)
                last_loud_s = at_s
            end_s = frame.time + frame.samples / frame.sample_rate
    return starts, end_s


@pytest.mark.parametrize(
    ("name", "sound", "kept"),
    [
        ("take.mp4", "aac", "copied"),
        ("take.mkv", "aac", "copied"),
        ("take.mov", "pcm_s16le", "re-encoded"),
        ("take.avi", "pcm_s16le", "re-encoded"),
    ],
)
def test_sound_stays_with_the_pictures(tmp_path, name, sound, kept):
    take = write_beeps(tmp_path / name, sound, [0.5, 1.5, 2.5, 3.5, 4.5, 5.5])
    _, rows = cut(tmp_path, take, "1.0,3.0,p,m,1\n3.16,5.16,p,m,2\n")
    for clip, expected in (("p_m_1", [0.5, 1.5]), ("p_m_2", [0.34, 1.34])):
        path = tmp_path / "clips" / rows[clip]["file"]
        _, time_s = read(path)
        starts, end_s = beeps_in(path)
        assert np.array(starts) - time_s[0] == pytest.approx(expected, abs=0.004)
        assert end_s - time_s[0] == pytest.approx(2.0, abs=0.15) and rows[clip]["sound"] == kept


def test_same_take_same_bytes(tmp_path):
    take = write_beeps(tmp_path / "take.mp4", "aac", [1.5])
    cut(tmp_path, take, "1.0,2.0,p,m,1\n2.2,3.0,p,m,2\n")
    files = sorted((tmp_path / "clips").iterdir())
    before = [path.read_bytes() for path in files]
    assert [path.name for path in files] == ["p_m_1.mp4", "p_m_2.mp4", "take.contact.png", "take.segment.csv"]
    cut(tmp_path, take, "1.0,2.0,p,m,1\n2.2,3.0,p,m,2\n", overwrite=True)
    assert [path.read_bytes() for path in sorted((tmp_path / "clips").iterdir())] == before


@pytest.mark.parametrize(
    ("head", "lines", "sentence"),
    [
        (CUTS, "0,1,p,m,1\n0.96,2,p,m,2\n", "expected cuts that do not overlap, got p_m_1 until 1 s and p_m_2 from"),
        (CUTS, "0,1,p,m,1\n1,2,p,m,1\n", "expected each name once, got p_m_1 2 times"),
        (CUTS, "1,4,p,m,1\n", "expected cuts inside of the take, which ends at 2.400 s, got p_m_1 from 1 to 4 s"),
        (CUTS, "1,1,p,m,1\n", "expected p_m_1 to start at 0 s or later and to stop after that, got 1 to 1 s"),
        (CUTS, "-0.5,1,p,m,1\n", "expected p_m_1 to start at 0 s or later"),
        (CUTS, "0.41,0.43,p,m,1\n", "expected a picture in p_m_1, got none from 0.41 to 0.43 s"),
        (CUTS, "soon,1,p,m,1\n", "expected start_s in seconds such as 12.5 at line 2 of .*, got 'soon'"),
        (CUTS, "0,1,p,m,one\n", "line 2 of .*: expected repeat as a whole number, got 'one'"),
        (CUTS, "0,1,p,,\n", "line 2 of .*: expected a value for utterance, got none"),
        (CUTS, "0,1,p,m\n", "expected 5 cells in row 2 of .*, got 4"),
        (CUTS, "", "expected a cut list with a cut or more, got .* with its head alone"),
        (
            "start_s,speaker,uterance,repeat\n",
            "0,p,m,1\n",
            "expected a column utterance in .*, got 'uterance'; did you",
        ),
        ("start_s,utterance,repeat\n", "0,m,1\n", "expected a column speaker in .*, got none; or give --speaker"),
        ("begin,name\n", "0,a\n", "expected a column start_s in"),
        ("start_s,name\n", "0,../a\n", "expected the name of a clip at line 2 of .*, without its ending, got '../a'"),
        ("", "", "expected a cut list in CSV, got .*, which is empty"),
    ],
)
def test_bad_cut_lists(tmp_path, head, lines, sentence):
    take = tmp_path / "take.mp4"
    write_video(take, numbered(60), key_every=60)
    with pytest.raises(InputError, match=sentence):
        cut(tmp_path, take, lines, head)
    assert not (tmp_path / "clips").exists()


def test_bad_takes(tmp_path):
    (tmp_path / "broken.mp4").write_bytes(b"no video at all" * 100)
    (tmp_path / "empty.mp4").touch()
    for name, sentence in (
        ("broken.mp4", "cannot read .*broken.mp4 as a video"),
        ("empty.mp4", "empty"),
        ("tak.mp4", "expected the video of a take, got no file at .*tak.mp4; there are broken.mp4, empty.mp4"),
    ):
        with pytest.raises(InputError, match=sentence):
            cut(tmp_path, tmp_path / name, "0,1,p,m,1\n")


def test_clips_that_are_there_stay(tmp_path, capsys):
    take = write_video(tmp_path / "take.mp4", numbered(60))
    (tmp_path / "clips").mkdir()
    (tmp_path / "clips/p_m_2.mp4").write_text("mine")
    with pytest.raises(InputError, match=r"expected to write a new file, but .*p_m_2.mp4 exists; add --overwrite"):
        cut(tmp_path, take, "0,1,p,m,1\n1,2,p,m,2\n")
    assert [path.name for path in (tmp_path / "clips").iterdir()] == ["p_m_2.mp4"]
    words = ["corpus", "segment", str(take), "--cuts", str(tmp_path / "cuts.csv"), "-o", str(tmp_path / "clips")]
    assert main(words) == 2 and "add --overwrite" in capsys.readouterr().err
    assert main([*words, "--overwrite"]) == 0
    assert len(read(tmp_path / "clips/p_m_2.mp4")[0]) == 25
    with pytest.raises(InputError, match="which is the take; choose another -o"):
        segment(
            take, tmp_path, cuts=_list(tmp_path, "start_s,stop_s,name\n0,1,take\n"), protocol=PROTOCOL, overwrite=True
        )


def _list(tmp_path, text):
    path = tmp_path / "own.csv"
    path.write_text(text)
    return path


def test_a_clip_that_fails_is_told_and_the_others_are_made(tmp_path, capsys):
    take = write_video(tmp_path / "take.mp4", numbered(75), options={"bf": "0"}, key_every=25)
    known = read_take(take)
    data = bytearray(take.read_bytes())
    with av.open(str(take)) as container:
        packets = [packet for packet in container.demux(video=0) if packet.size]
        for packet in packets[30:33]:  # of the middle clip
            data[packet.pos : packet.pos + packet.size] = bytes(packet.size)
    take.write_bytes(data)
    assert len(read_take(take).pts) == len(known.pts)
    (tmp_path / "cuts.csv").write_text(CUTS + "0.2,0.8,p,m,1\n1.2,1.8,p,m,2\n2.2,2.8,p,m,3\n")
    words = ["corpus", "segment", str(take), "--cuts", str(tmp_path / "cuts.csv"), "-o", str(tmp_path / "clips")]
    assert main(words) == 3
    said = capsys.readouterr()
    assert "lipmetrics: p_m_2: " in said.err and "2 clips of take.mp4" in said.out
    names = sorted(path.name for path in (tmp_path / "clips").iterdir())
    assert names == ["p_m_1.mp4", "p_m_3.mp4", "take.contact.png", "take.segment.csv"]
    assert rows_of(tmp_path / "clips/take.segment.csv")["p_m_2"]["file"] == ""


def test_lists_in_other_forms(tmp_path):
    path = tmp_path / "p07.log.csv"
    path.write_text(
        "at_s,event,utterance,repeat,dry_s,kept\n0.000,mark,,,,\n10.000,lick,m,,,\n16.000,cue,m,1,6,0\n"
        "26.000,repeat,m,1,,\n26.000,cue,m,1,16,1\n36.000,cue,m,2,26,1\n"
    )
    found = read_cuts(path, PROTOCOL, mark_s=2.0)
    assert [(one.name, one.start_s, one.stop_s) for one in found] == [("p07_m_1", 27.5, 30.5), ("p07_m_2", 37.5, 40.5)]
    path = tmp_path / "mine.csv"
    path.write_text("note;start_s;repeat;utterance\nx;20;2;m\ny;12.25;1;m\n")
    found = read_cuts(path, PROTOCOL, speaker="p01")
    assert [(one.name, one.start_s, one.stop_s) for one in found] == [("p01_m_1", 12.25, 15.25), ("p01_m_2", 20, 23)]


def speaking_take(path, onsets, seconds):
    """A dark patch that opens and closes for a second at each onset; noise everywhere."""
    rng = np.random.default_rng(0)
    still = smooth_picture(64, 96).astype(int)
    pictures = []
    for i in range(25 * seconds):
        picture = still.copy()
        for onset in onsets:
            if onset <= i / 25 < onset + 1:
                half = round(12 * np.sin(np.pi * (i / 25 - onset)))
                picture[40 - half : 40 + half, 30:66] = 20
        pictures.append(np.clip(picture + rng.integers(-3, 4, picture.shape), 0, 255).astype(np.uint8))
    return write_video(path, pictures, key_every=25, options={"crf": "18"})


def test_movement_is_found_where_it_is(tmp_path, capsys):
    onsets = [4.0, 9.2, 14.4]
    take = speaking_take(tmp_path / "take.mp4", onsets, 18)
    events = find_events(read_activity(take))
    assert [event.start_s for event in events] == pytest.approx(onsets, abs=0.12)
    assert [event.stop_s for event in events] == pytest.approx([one + 1 for one in onsets], abs=0.2)
    words = ["corpus", "segment", str(take), "-o", str(tmp_path / "out"), "--speaker", "p01"]
    assert main(words) == 0 and "3 cuts proposed" in capsys.readouterr().out
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["take.proposed.contact.png", "take.proposed.csv", "take.proposed.png"]  # and no clip
    with pytest.raises(InputError, match=r"line 2 of .*: expected a value for utterance, got none"):
        read_cuts(tmp_path / "out/take.proposed.csv", PROTOCOL)
    assert main(words) == 2 and "take.proposed.csv exists" in capsys.readouterr().err
    still = write_video(tmp_path / "still.mp4", [smooth_picture(64, 96)] * 100)
    assert main(["corpus", "segment", str(still), "-o", str(tmp_path / "none")]) == 2
    assert "expected movement or sound in" in capsys.readouterr().err
    short = write_video(tmp_path / "short.mp4", numbered(30))
    assert main(["corpus", "segment", str(short), "-o", str(tmp_path / "none")]) == 2
    assert "expected a take longer than a clip of 3 s, got 1.20 s" in capsys.readouterr().err


def test_sound_alone_is_proposed_with_a_note(tmp_path):
    take = write_beeps(tmp_path / "take.mp4", "aac", [2.0], pictures=[smooth_picture(64, 96)] * 150)
    (heard,) = find_events(read_activity(take))
    assert heard.start_s == pytest.approx(2.0, abs=0.15) and heard.movement == 0 and heard.louder_db > 12
    (one,) = propose([heard], 6.0, PROTOCOL).cuts
    assert one.start_s == pytest.approx(1.5, abs=0.15) and one.note == "sound alone"


def test_proposals_take_their_names_from_the_plan(tmp_path):
    rng = np.random.default_rng(3)
    cues = [prompt for prompt in PROTOCOL.prompts() if prompt.kind == "cue"]
    licks = [prompt.at_s + 37.2 for prompt in PROTOCOL.prompts() if prompt.kind == "lick"]
    onsets = np.array([cue.at_s for cue in cues]) + 37.7 + rng.uniform(-0.2, 0.2, len(cues))
    seen = [k for k in range(len(cues)) if k not in (5, 77)]  # two were too small to be seen
    events = [Event(onsets[k], onsets[k] + 1, 8.0, 0.0) for k in seen]
    events = sorted(events + [Event(at, at + 1, 9.0, 0.0) for at in licks], key=lambda event: event.start_s)
    found = propose(events, 1400.0, PROTOCOL, speaker="p01")
    assert len(found.cuts) == 110 and len(found.others) == 22 and found.mark_s == pytest.approx(37.7, abs=0.1)
    assert [one.note for k, one in enumerate(found.cuts) if k in (5, 77)] == ["nothing seen; by the plan"] * 2
    at = [one.start_s for k, one in enumerate(found.cuts) if k in seen]
    assert at == pytest.approx(onsets[seen] - PROTOCOL.before_s, abs=0.001)
    write_proposal(tmp_path / "p.csv", found, PROTOCOL, speaker="p01")
    pieces = read_cuts(tmp_path / "p.csv", PROTOCOL)
    assert [one.name for one in pieces] == PROTOCOL.names(["p01"])
    # with the mark known, an event answers the prompt before it, late as it may be
    late = [Event(cue.at_s + 20 + 2.4, cue.at_s + 23, 8.0, 0.0) for cue in cues[:3]]
    found = propose(late, 1400.0, PROTOCOL, speaker="p01", mark_s=20.0)
    assert len(found.cuts) == 110 and sum(one.event is not None for one in found.cuts) == 3
    # three of 110 say nothing of the plan, though they are 10 s apart
    found = propose(late, 1400.0, PROTOCOL, speaker="p01")
    assert found.mark_s is None and [one.fields for one in found.cuts] == [{"speaker": "p01"}] * 3


def test_a_cell_longer_than_a_field_of_csv(tmp_path):
    (tmp_path / "a.csv").write_text("start_s,name\n1.0," + "x" * 200_000 + "\n")
    with pytest.raises(InputError, match="field larger"):
        read_cuts(tmp_path / "a.csv", load_protocol())
