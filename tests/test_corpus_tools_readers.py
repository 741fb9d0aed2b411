"""Readers: folders laid out as the corpora are, with empty files for their videos."""

import json

import pytest

from corpus_tools.readers import (
    GRID_CODE,
    grid_words,
    read_corpus,
    read_folder,
    read_grid,
    read_lombard,
    read_mead,
    read_ravdess,
)
from lipmetrics.errors import InputError

ALIGN = "0 23750 sil\n23750 29500 bin\n"


def lay_out(root, *paths):
    for path in paths:
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).touch()
    return root


def names(reading):
    return [clip.name for clip in reading.clips]


def test_sentences_of_grid():
    """4 commands x 4 colours x 4 prepositions x 25 letters x 10 digits x 4 adverbs (Cooke et al. 2006)."""
    assert " ".join(grid_words("bbaf2n").values()) == "bin blue at f two now"
    assert " ".join(grid_words("swwz9s").values()) == "set white with z nine soon"
    assert grid_words("lgixzp")["digit"] == "zero"
    for wrong in ("bbaw2n", "bbaf0n", "xbaf2n", "bbaf2", "bbaf2nn", "BBAF2N"):
        assert not GRID_CODE.matches(wrong)


def test_grid_as_videos(tmp_path):
    root = lay_out(
        tmp_path, "s1/bbaf2n.mpg", "s10/video/mpg_6000/bbaf2n.mpg", "s2.mpg_6000.part1/lbax4n.mpg", "s1/x.mpg"
    )
    (root / "s1/bbaf2n.align").write_text(ALIGN)
    (root / "align").mkdir()
    lay_out(root, "align/s10/bbaf2n.align", "bbaf2n.mpg", "notes.txt", ".hidden/s1/bbaf3n.mpg")
    reading = read_grid(root)
    assert names(reading) == ["s10_bbaf2n", "s1_bbaf2n", "s2_lbax4n"]
    clip = reading.clips[1]
    assert clip.path == root / "s1/bbaf2n.mpg" and clip.fps is None
    assert clip.fields["speaker"] == "s1" and clip.fields["utterance"] == "bbaf2n" and clip.fields["letter"] == "f"
    assert [word.text for word in clip.words] == ["bin"] and reading.clips[0].words == ()
    misfits = {path.relative_to(root).as_posix(): why for path, why in reading.misfits}
    assert "expected b, l, p or s for command at the start, got 'x'" in misfits["s1/x.mpg"]
    assert "to lie in a folder of its speaker such as s1" in misfits["bbaf2n.mpg"] and len(misfits) == 2


def test_grid_as_pictures(tmp_path):
    """As Zenodo has them: a folder of pictures for each sentence, alignments elsewhere."""
    root = lay_out(tmp_path, "s1/bbaf2n/frame_0.jpg", "s1/bbaf2n/frame_1.jpg", "alignments/s1/bbaf2n.align")
    (root / "alignments/s1/bbaf2n.align").write_text(ALIGN)
    (clip,) = read_grid(root).clips
    assert clip.path == root / "s1/bbaf2n" and clip.fps == 25 and clip.words[0].text == "bin"
    (clip,) = read_grid(root / "s1").clips
    assert clip.name == "s1_bbaf2n"


def test_lombard_grid(tmp_path):
    root = lay_out(
        tmp_path,
        "front/s10_l_bbat9p.mov",
        "front/s10_p_swib5n.mov",
        "front/s46_p_gbszs_WRONG_sgbszs.mov",
        "front/s27_l_bah2s_WRONG_#sil.mov",
        "front/s27_l_bah2s.mov",
        "side/s10_l_bbat9p.mov",
        "alignment/s10_l_bbat9p.json",
    )
    phones = [{"phone": "b_S", "offset": 0.5, "duration": 0.1}]
    (root / "alignment/s10_l_bbat9p.json").write_text(json.dumps({"s10_l_bbat9p": phones}))
    reading = read_lombard(root)
    first, second, wrong = reading.clips
    assert names(reading) == ["s10_l_bbat9p", "s10_p_swib5n", "s46_p_gbszs_WRONG_sgbszs"]
    assert dict(first.fields) == {
        "speaker": "s10",
        "condition": "lombard",
        "utterance": "bbat9p",
        "view": "front",
        "label": None,
        **grid_words("bbat9p"),
    }
    assert [(word.text, word.tier) for word in first.words] == [("b", "phones"), ("b", "words")]
    assert second.fields["condition"] == "plain" and second.words == ()
    assert wrong.fields["utterance"] == "sgbszs" and wrong.fields["label"] == "gbszs"
    assert wrong.fields["preposition"] == "by" and wrong.fields["digit"] == "zero"
    reasons = [why for _, why in reading.misfits]
    assert len(reasons) == 2 and "got silence, as its name says" in reasons[1]
    assert names(read_lombard(root, ["front", "side"]))[:2] == ["s10_l_bbat9p_front", "s10_l_bbat9p_side"]
    assert len(read_lombard(root / "front").clips) == 3
    with pytest.raises(InputError, match="expected views out of front, side, got 'sides'; did you mean 'side'"):
        read_lombard(root, ["sides"])


def test_ravdess(tmp_path):
    root = lay_out(
        tmp_path,
        "Actor_12/01-01-06-01-02-01-12.mp4",
        "Actor_12/02-01-06-01-02-01-12.mp4",  # the same without sound
        "Actor_12/02-02-01-01-01-02-12.mp4",
        "Actor_12/03-01-06-01-02-01-12.mp4",
        "Actor_12/01-01-09-01-02-01-12.mp4",
        "Actor_12/03-01-06-01-02-01-12.wav",
    )
    reading = read_ravdess(root)
    assert names(reading) == ["01-01-06-01-02-01-12", "02-02-01-01-01-02-12"]
    assert dict(reading.clips[0].fields) == {
        "speaker": "12",
        "utterance": "dogs",
        "repeat": 1,
        "channel": "speech",
        "emotion": "fearful",
        "intensity": "normal",
        "modality": "av",
    }
    assert reading.clips[1].fields["emotion"] == "neutral" and reading.clips[1].fields["modality"] == "video"
    reasons = " ".join(why for _, why in reading.misfits)
    assert len(reading.misfits) == 2 and "which has sound only" in reasons and "for emotion after '01-01-0'" in reasons


def test_mead(tmp_path):
    root = lay_out(
        tmp_path,
        "M003/video/front/angry/level_1/001.mp4",
        "M003/video/left_30/angry/level_1/001.mp4",
        "W009/video/front/neutral_level_1/002.mp4",
        "W009/front/happy/level_3/012.mp4",
        "W009/front/glad/level_3/012.mp4",
    )
    reading = read_mead(root)
    assert names(reading) == [
        "M003-front-angry-level_1-001",
        "W009-front-happy-level_3-012",
        "W009-front-neutral-level_1-002",
    ]
    assert dict(reading.clips[0].fields) == {
        "speaker": "M003",
        "view": "front",
        "emotion": "angry",
        "level": 1,
        "utterance": "001",
    }
    assert [path.parent.parent.name for path, _ in reading.misfits] == ["glad"]
    assert names(read_mead(root / "M003", ["left_30"])) == ["M003-left_30-angry-level_1-001"]


def test_any_folder_by_template(tmp_path):
    root = lay_out(
        tmp_path, "a/p01_m_1.mp4", "a/p01_m_2.MOV", "b/p02_m_1/0.png", "b/p02_m_1/1.png", "b/notes.mp4", "x.png"
    )
    (root / "a/p01_m_1.TextGrid").write_text('"ooTextFile" "TextGrid" 0 1 <exists> 1 "IntervalTier" "w" 0 1 1 0 1 "m"')
    (root / "a/p01_m_2.json").write_text("{}")  # a profile may lie beside a video
    reading = read_folder(root, "{speaker}_{utterance}_{repeat:d}", fps=60)
    assert names(reading) == ["p01_m_1", "p01_m_2", "p02_m_1"]
    assert dict(reading.clips[0].fields) == {"speaker": "p01", "utterance": "m", "repeat": 1}
    assert [clip.fps for clip in reading.clips] == [None, None, 60]
    assert reading.clips[0].words[0].text == "m" and [path.name for path, _ in reading.misfits] == ["notes.mp4"]
    with_folders = read_corpus(root, template="{room:a|b}/{speaker}_{utterance}_{repeat:d}")
    assert names(with_folders) == ["a-p01_m_1", "a-p01_m_2", "b-p02_m_1"]
    assert with_folders.clips[2].fields["room"] == "b"


def test_doubled_and_bad_folders(tmp_path):
    root = lay_out(tmp_path / "c", "a/m_1.mp4", "b/M_1.mp4")
    reading = read_folder(root, "{utterance}_{repeat:d}")
    assert names(reading) == ["M_1"]
    ((path, why),) = reading.misfits
    assert path.name == "m_1.mp4" and why.startswith("expected clips of different names, got m_1 again, after ")
    with pytest.raises(
        InputError, match=r"expected names of the form {a:d} in .*; the first of 2 that do not fit: expected"
    ):
        read_folder(root, "{a:d}")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"expected sentences of GRID such as .* in .*empty, got no videos"):
        read_grid(tmp_path / "empty")
    with pytest.raises(InputError, match=r"expected a folder with a corpus, got .*gone, which is not there"):
        read_mead(tmp_path / "gone")
    with pytest.raises(
        InputError, match="expected a corpus out of grid, lombard, ravdess, mead, got 'gird'; did you mean 'grid'"
    ):
        read_corpus(root, "gird")
    for given in ({}, {"corpus": "grid", "template": "{a}"}):
        with pytest.raises(InputError, match=r"expected a corpus \(grid, lombard, ravdess, mead\) or a template, got"):
            read_corpus(root, **given)
