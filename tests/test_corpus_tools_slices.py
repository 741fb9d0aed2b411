"""Words and phones: GRID's .align, Praat's TextGrid in both forms, Lombard GRID's phones, and slices of a clip."""

import json
import pickle

import pytest

from corpus_tools.clips import Clip, Slice
from corpus_tools.slices import read_align, read_lombard_alignment, read_slices, read_textgrid, slice_clip
from lipmetrics.errors import InputError

ALIGN = "0 23750 sil\n23750 29500 bin\n29500 34000 blue\n34000 35500 sp\n\n35500 41000 f\n53000 74500 sil\n"
LONG = """File type = "ooTextFile"
Object class = "TextGrid"

xmin = 0
xmax = 2.5
tiers? <exists>
size = 3
item []:
    item [1]:
        class = "IntervalTier"
        name = "words"
        xmin = 0
        xmax = 2.5
        intervals: size = 3 ! of them 1 "silent" and 7 more
        intervals [1]:
            xmin = 0
            xmax = 0.5
            text = ""
        intervals [2]:
            xmin = 0.5
            xmax = 1.25
            text = "say ""42"" now!"
        intervals [3]:
            xmin = 1.25
            xmax = 2.5
            text = "blü"
    item [2]:
        class = "TextTier"
        name = "bell"
        xmin = 0
        xmax = 2.5
        points: size = 1
        points [1]:
            number = 1.1
            mark = "ding"
    item [3]:
        class = "IntervalTier"
        name = "phones"
        xmin = 0
        xmax = 2.5
        intervals: size = 1
        intervals [1]:
            xmin = 5e-1
            xmax = 0.75
            text = "s"
"""
SHORT = """File type = "ooTextFile"
Object class = "TextGrid"

0
2.5
<exists>
3
"IntervalTier"
"words"
0
2.5
3
0
0.5
""
0.5
1.25
"say ""42"" now!"
1.25
2.5
"blü"
"TextTier" "bell" 0 2.5 1 1.1 "ding"
"IntervalTier" "phones" 0 2.5 1 5e-1 0.75 "s"
"""
TIERS = {
    "words": (Slice('say "42" now!', 0.5, 1.25, "words"), Slice("blü", 1.25, 2.5, "words")),
    "phones": (Slice("s", 0.5, 0.75, "phones"),),
}


def write(tmp_path, name, text, encoding="utf-8"):
    path = tmp_path / name
    path.write_bytes(text.encode(encoding))
    return path


def test_align_of_grid(tmp_path):
    """Units of 1/25,000 s: the 75 frames of a clip end at 75,000, frame 23.75 is at 0.95 s."""
    found = read_align(write(tmp_path, "bbaf2n.align", ALIGN))
    assert found == (
        Slice("bin", 0.95, 1.18),
        Slice("blue", 1.18, 1.36),
        Slice("f", 1.42, 1.64),
    )
    assert [25 * one.start_s for one in found] == pytest.approx([23.75, 29.5, 35.5])


@pytest.mark.parametrize("text", [LONG, SHORT], ids=["long", "short"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_textgrids(tmp_path, text, encoding):
    path = write(tmp_path, "a.TextGrid", text, encoding)
    assert read_textgrid(path) == TIERS
    assert [one.text for one in read_slices(path)] == ['say "42" now!', "s", "blü"]
    old = text.replace('"ooTextFile"', '"ooTextFile short"').replace('Object class = "TextGrid"', '"TextGrid"')
    assert read_textgrid(write(tmp_path, "b.TextGrid", old.replace("\n", "\r\n"), encoding)) == TIERS


def test_tiers_of_one_name_and_none(tmp_path):
    found = read_textgrid(write(tmp_path, "a.TextGrid", SHORT.replace("phones", "words")))
    assert list(found) == ["words", "words-2"] and found["words-2"][0].tier == "words-2"
    assert read_textgrid(write(tmp_path, "b.TextGrid", '"ooTextFile" "TextGrid" 0 1 <absent>')) == {}


def test_phones_of_lombard_grid(tmp_path):
    phones = [("SIL", 0, 0.3), ("b_B", 0.3, 0.1), ("ih_I", 0.4, 0.1), ("n_E", 0.5, 0.1), ("ey_S", 0.6, 0.2)]
    entries = [{"phone": phone, "offset": start, "duration": length} for phone, start, length in phones]
    found = read_lombard_alignment(write(tmp_path, "a.json", json.dumps({"s10_l_bbat9p": entries})))
    words = [one for one in found if one.tier == "words"]
    assert [(one.text, one.start_s, one.stop_s) for one in words] == [
        ("b-ih-n", 0.3, pytest.approx(0.6)),
        ("ey", 0.6, pytest.approx(0.8)),
    ]
    assert [one.text for one in found if one.tier == "phones"] == ["b", "ih", "n", "ey"]
    broken = [{"phone": f"{one}_B", "offset": i, "duration": 1} for i, one in enumerate("xy")]  # a word without an end
    broken += [{"phone": "z_E", "offset": 2, "duration": 1}]
    assert read_slices(write(tmp_path, "c.json", json.dumps({"x": broken})))[1] == Slice("y-z", 1, 3, "words")
    plain = [{"phone": "b", "offset": 0.1, "duration": 0.1}]
    assert read_slices(write(tmp_path, "b.json", json.dumps({"x": plain}))) == (Slice("b", 0.1, 0.2, "phones"),)


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("a.align", "0 100 sil\n100 bin", "expected lines of start, stop and word .* got '100 bin' in line 2"),
        ("a.align", "0 100 sil\n200 100 bin", "expected 'bin' in .* got 0.008 to 0.004 s"),
        ("a.align", "-5 100 bin", "got '-5 100 bin' in line 1"),
        ("a.TextGrid", "", 'expected "ooTextFile" as the first text in the TextGrid .*, got the end'),
        ("a.TextGrid", '"ooBinaryFile" "TextGrid"', "expected a TextGrid in Praat's text form"),
        ("a.TextGrid", '"ooTextFile" "Sound" 0 1', "expected a TextGrid, got another of Praat's objects"),
        ("a.TextGrid", LONG[:500], "in the TextGrid .*, got the end"),
        ("a.TextGrid", SHORT.replace("\n3\n0\n", "\n3.5\n0\n"), "expected a whole number of tiers or intervals"),
        ("a.TextGrid", SHORT.replace("TextTier", "PitchTier"), "got 'PitchTier'"),
        ("a.TextGrid", SHORT.replace("0.5\n1.25", "1.25\n0.5"), "to start at 0 s or later and to stop after that"),
        ("a.TextGrid", SHORT.replace('"blü"', "7"), "expected a text of the tier words in .*, got '7.0'"),
        ("a.json", "{}", "expected phones of one clip as"),
        ("a.json", "[1]", "expected phones of one clip as"),
        ("a.json", '{"a": [{"phone": "b"}]}', "expected phones of one clip as"),
        ("a.json", '{"a"', "expected phones of one clip as"),
        ("a.txt", "", r"expected words in a file \*.align, \*.TextGrid or \*.json, got"),
    ],
)
def test_broken_files_are_refused(tmp_path, name, text, sentence):
    with pytest.raises(InputError, match=sentence) as refused:
        read_slices(write(tmp_path, name, text))
    assert "\n" not in str(refused.value)
    with pytest.raises(InputError, match=r"expected a file with words to read, got .*gone.align: No such file"):
        read_slices(tmp_path / "gone.align")


def test_slices_of_a_clip(tmp_path):
    words = read_align(write(tmp_path, "bbaf2n.align", ALIGN))
    phones = (Slice("@", 1.0, 1.1, "phones"), Slice("ih_1", 1.1, 1.2, "phones"))
    clip = Clip("s1/bbaf2n.mpg", "s1_bbaf2n", {"speaker": "s1"}, words=words + phones)
    first, _, last = slice_clip(clip)
    assert (first.name, first.start_s, first.stop_s) == ("s1_bbaf2n-01-bin", 0.95, 1.18)
    assert first.fields == {"speaker": "s1", "slice": "bin", "slice_n": 1} and first.path == clip.path
    assert last.name == "s1_bbaf2n-03-f" and last.words == (words[2],)
    assert [one.name for one in slice_clip(clip, "phones")] == ["s1_bbaf2n-01-x", "s1_bbaf2n-02-ih-1"]
    (blue,) = slice_clip(clip, labels=["blue"], margin_s=0.1)
    assert blue.name == "s1_bbaf2n-02-blue" and (blue.start_s, blue.stop_s) == pytest.approx((1.08, 1.46))
    part = Clip("s1/bbaf2n.mpg", "part", words=words, start_s=1.1, stop_s=1.5)
    (only,) = slice_clip(part, margin_s=1.0)
    assert only.fields["slice"] == "blue" and (only.start_s, only.stop_s) == (1.1, 1.5)
    with pytest.raises(InputError, match="to have the tier phone, got 'phone'; did you mean 'phones'"):
        slice_clip(clip, "phone")
    with pytest.raises(InputError, match="expected x to have the tier words, got a clip without words"):
        slice_clip(Clip("x.mp4", "x"))
    with pytest.raises(InputError, match="expected a margin of 0 s or more, got nan"):
        slice_clip(clip, margin_s=float("nan"))


def test_clips_travel_and_do_not_change():
    clip = Clip("a.mp4", "a", {"repeat": 1}, 0.5, 2.0, (Slice("m", 0.6, 1.0),), 25.0)
    again = pickle.loads(pickle.dumps(clip))
    assert again == clip and hash(again) == hash(clip) and again.words == clip.words and again.fps == 25
    with pytest.raises(TypeError):
        clip.fields["repeat"] = 2
    for bad, sentence in (
        ({"name": ""}, "expected a name for the clip a.mp4, got none"),
        ({"name": "a/b"}, "without / and"),
        ({"start_s": 2.0, "stop_s": 2.0}, "got a start at 2 s and a stop at 2 s"),
        ({"start_s": -1.0}, "got a start at -1 s and a stop at inf s"),
        ({"stop_s": float("nan")}, "expected b to start at 0 s"),
    ):
        with pytest.raises(InputError, match=sentence):
            Clip(**{"path": "a.mp4", "name": "b"} | bad)
