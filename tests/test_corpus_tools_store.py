"""The store: what goes in comes out, in whatever order it was made, and by later versions."""

import dataclasses
import json
import math
import sys
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from mouth_clip import looks_of, profile_of

from corpus_tools.clips import Clip, Slice
from corpus_tools.store import (
    VERSION,
    Key,
    Store,
    about_differs,
    check_name,
    store_of_clip,
    store_of_failure,
    write_store,
)
from lipmetrics.errors import InputError
from lipmetrics.openings import Identity, measure_outline
from lipmetrics.profile import Profile, frame_row, opening_row, tables
from lipmetrics.takes import take_of_profile

OLD = Path(__file__).parent / "data" / "store_v1.h5"
KEY = Key("a" * 64, "b" * 64, "c" * 16)


def clip(name="p01_m_1", **fields):
    fields = {"speaker": "p01", "utterance": "m", "repeat": 1, "level": 0.25, "audio": None} | fields
    return Clip(Path("film.mp4"), name, fields, words=(Slice("äh", 0.5, 1.25),))


def profile(statuses=("open", "closed", "no_mouth", "open"), width_px=60.0):
    """With an opening that comes out of two others, so that no column is empty."""
    made = profile_of(looks_of(list(statuses)), [0.1 + k / 30 for k in range(len(statuses))], width_px)
    made.openings.loc[made.openings.index[-1:], ["event", "parents"]] = ["merge", "1+12"]
    made.meta["warnings"] = ["größer als erwartet"]
    return Profile(made.frames, made.openings, made.meta)


def part(folder, name, content):
    path = folder / f"{name}.part"
    path.write_bytes(content)
    return path


def store(tmp_path, clips, path="s.h5", order=1):
    """A store of these clips, each with a profile of its own."""
    parts = {}
    for k, one in list(enumerate(clips))[::order]:
        statuses = ["open", "closed", "no_mouth", "open", *["open"] * k]
        parts[one.name] = part(tmp_path, one.name, store_of_clip(one, profile(statuses), KEY))
    write_store(tmp_path / path, parts)
    return tmp_path / path


def same(one, other):
    pd.testing.assert_frame_equal(one.frames, other.frames, check_exact=True)
    pd.testing.assert_frame_equal(one.openings, other.openings, check_exact=True)
    assert one.meta == other.meta


def test_what_goes_in_comes_out(tmp_path):
    with Store(store(tmp_path, [clip()])) as found:
        same(found.profile("p01_m_1"), profile())
        assert found.fields("p01_m_1") == dict(clip().fields) and found.words("p01_m_1") == clip().words
        assert found.keys() == {"p01_m_1": KEY} and found.failed == {} and found.version == VERSION
        take, wanted = found.take("p01_m_1"), take_of_profile(profile(), "p01_m_1", source="video")
        for name, values in wanted.channels.items():
            np.testing.assert_array_equal(take.channels[name], values)
        pd.testing.assert_frame_equal(take.openings, wanted.openings)
        assert take.meta["fields"]["utterance"] == "m" and take.meta["words"][0].text == "äh"


def test_a_clip_that_is_closed_throughout_and_one_without_a_mouth(tmp_path):
    clips = [clip("shut"), clip("gone")]
    made = {"shut": profile_of(looks_of(["closed"] * 3), [0, 1, 2]), "gone": profile_of(looks_of(["no_mouth"]), [0.0])}
    made["gone"].meta["mouth_width_px"] = math.nan
    parts = {one.name: part(tmp_path, one.name, store_of_clip(one, made[one.name], KEY)) for one in clips}
    write_store(tmp_path / "s.h5", parts)
    with Store(tmp_path / "s.h5") as found:
        for name in ("shut", "gone"):
            got = found.profile(name)
            pd.testing.assert_frame_equal(got.frames, made[name].frames)
            pd.testing.assert_frame_equal(got.openings, made[name].openings)
        assert math.isnan(found.profile("gone").meta["mouth_width_px"])
        with pytest.raises(InputError, match="gone: expected a profile with a known mouth width"):
            found.takes()
        left_out = []
        assert [take.name for take in found.takes(on_misfit=lambda *why: left_out.append(why))] == ["shut"]
        assert [name for name, _ in left_out] == ["gone"] and len(found.takes(unit="px")) == 2


def test_clips_are_picked_by_their_fields(tmp_path):
    some = [(who, what, n) for who in "ab" for what in ("m", "os") for n in (1, 2)]
    clips = [clip(f"{who}_{what}_{n}", speaker=who, utterance=what, repeat=n) for who, what, n in some]
    clips.append(clip("c_m_1", speaker="c", audio="a"))
    with Store(store(tmp_path, clips)) as found:
        assert found.names == sorted(one.name for one in clips) and len(found.takes()) == 9
        assert [take.name for take in found.takes({"speaker": "b", "repeat": 2})] == ["b_m_2", "b_os_2"]
        assert found.select({"utterance": ["os", "pu"], "speaker": {"a"}}) == ["a_os_1", "a_os_2"]
        assert found.select({"audio": None, "repeat": 1, "utterance": "m"}) == ["a_m_1", "b_m_1"]
        assert found.select(lambda fields: fields["audio"] == "a") == ["c_m_1"]
        assert found.select({"speaker": "z"}) == []
        with pytest.raises(InputError, match=r"a field out of speaker, .* got 'utterence'; did you mean 'utter"):
            found.takes({"utterence": "m"})
        with pytest.raises(InputError, match=r"expected a clip of .*s.h5, got 'a_m_3'; did you mean 'a_m_"):
            found.profile("a_m_3")
        table = found.table()
    assert list(table["name"]) == sorted(one.name for one in clips) and table["frames_n"].sum() == 9 * 4 + 36
    assert table.loc[0, "length_s"] == pytest.approx(3 / 30) and table.loc[0, "mouth_width_px"] == 60


def test_order_and_number_of_steps_leave_no_trace(tmp_path):
    clips = [clip(name) for name in ("b", "é", "a", "B")]
    once = store(tmp_path, clips).read_bytes()
    assert store(tmp_path, clips, "t.h5", order=-1).read_bytes() == once
    store(tmp_path, clips[1:3], "u.h5")
    sources = dict.fromkeys(["é", "a"], tmp_path / "t.h5") | {"b": tmp_path / "b.part", "B": tmp_path / "B.part"}
    write_store(tmp_path / "v.h5", sources)
    assert (tmp_path / "v.h5").read_bytes() == once


def test_what_is_said_of_a_clip_can_change_without_measuring(tmp_path):
    first, now = clip("a"), clip("a", utterance="mu")
    path = store(tmp_path, [first, clip("b")])
    with Store(path) as found:
        assert about_differs(found, now) and not about_differs(found, first)
    write_store(tmp_path / "t.h5", dict.fromkeys(["a", "b"], path), [now], {"a": "0" * 16})
    with Store(tmp_path / "t.h5") as found:
        assert found.fields("a")["utterance"] == "mu" and found.fields("b")["utterance"] == "m"
        assert found.keys() == {"a": dataclasses.replace(KEY, seen="0" * 16), "b": KEY}
        same(found.profile("a"), profile())


def test_what_failed_is_kept_with_its_reason(tmp_path):
    key = dataclasses.replace(KEY, failed=True, lasting=False)
    parts = {"bad": part(tmp_path, "bad", store_of_failure(clip("bad"), "kein Film", key))}
    parts["good"] = part(tmp_path, "good", store_of_clip(clip("good"), profile(), KEY))
    write_store(tmp_path / "s.h5", parts)
    with Store(tmp_path / "s.h5") as found:
        assert found.names == ["good"] and found.failed == {"bad": "kein Film"}
        assert found.keys() == {"good": KEY, "bad": key}
        assert list(found.table()["reason"]) == ["kein Film", ""]
        with pytest.raises(InputError, match="expected a clip that was measured, got 'bad', which failed: kein Film"):
            found.take("bad")


def test_a_stored_file_of_format_1_is_read():
    with Store(OLD) as found:
        assert found.names == ["p01_m_1", "p01_os_2"] and found.failed == {"p02_m_1": "expected a video, got a poem"}
        assert found.fields("p01_os_2") == {"speaker": "p01", "utterance": "os", "repeat": 2, "stickiness": None}
        assert found.words("p01_m_1") == (Slice("m", 0.25, 1.0, "phones"),)
        one = found.profile("p01_m_1")
        assert list(one.frames["status"]) == ["closed", "open", "no_mouth", "open"]
        assert list(one.frames["n_openings"].fillna(-1)) == [0, 1, -1, 2]
        np.testing.assert_allclose(one.frames["width_mw"], [0, 40 / 60, np.nan, 40 / 60], rtol=1e-3)
        assert list(one.openings["event"]) == ["new", "split", "split"]
        assert list(one.openings["parents"]) == ["", "1", "1"] and list(one.openings["frame"]) == [1, 3, 3]
        assert one.meta["mouth_width_px"] == 60 and one.meta["method"] == "drawn"
        take = found.takes({"utterance": "m"})[0]
        np.testing.assert_allclose(take.time_s, [0, 0.04, 0.08, 0.12])
        assert found.keys()["p01_m_1"] == Key("1" * 64, "2" * 64, "3" * 16)
        assert found.keys()["p02_m_1"] == Key("4" * 64, "2" * 64, "5" * 16, failed=True, lasting=True)


def make_old_store(path):
    """How tests/data/store_v1.h5 was made; it stays as it is whatever becomes of the format."""
    first, second = looks_of(["closed", "open"]), looks_of(["no_mouth", "open"])
    looks = [*first, *second]
    looks[3].outlines.append(looks[3].outlines[0] * [0.5, 0.25])
    frames, rows = [], []
    for k, look in enumerate(looks):
        found = [measure_outline(outline) for outline in look.outlines]
        who = [Identity(1, "new")] if k == 1 else [Identity(1, "split", (1,)), Identity(2, "split", (1,))]
        frames.append(frame_row(k, k / 25, look, found))
        rows += [opening_row(k, k / 25, w, o) for w, o in zip(who, found, strict=False)]
    meta = {"format": "lipmetrics profile 1", "file": "drawn.mp4", "method": "drawn", "mouth_width_px": 60.0}
    key = Key("1" * 64, "2" * 64, "3" * 16)
    fields = {"speaker": "p01", "utterance": "m", "repeat": 1, "stickiness": 4}
    m = Clip("x.mp4", "p01_m_1", fields, words=(Slice("m", 0.25, 1.0, "phones"),))
    os_2 = Clip("x.mp4", "p01_os_2", fields | {"utterance": "os", "repeat": 2, "stickiness": None})
    bad = Clip("x.mp4", "p02_m_1", fields | {"speaker": "p02"})
    contents = {one.name: store_of_clip(one, Profile(*tables(frames, rows, 60.0), meta), key) for one in (m, os_2)}
    lasting = Key("4" * 64, "2" * 64, "5" * 16, failed=True)
    contents["p02_m_1"] = store_of_failure(bad, "expected a video, got a poem", lasting)
    parts = {name: part(path.parent, name, content) for name, content in contents.items()}
    path.unlink(missing_ok=True)
    write_store(path, parts)
    for one in parts.values():
        one.unlink()


def test_a_newer_format_is_refused_in_one_sentence(tmp_path):
    path = store(tmp_path, [clip()])
    with h5py.File(path, "r+") as file:
        file["meta"].attrs["version"] = VERSION + 1
        file["meta"].attrs["lipmetrics"] = np.bytes_("9.1")
    sentence = rf"of format {VERSION} or older, got format {VERSION + 1} .* lipmetrics 9\.1 wrote; update lipmetrics"
    with pytest.raises(InputError, match=sentence):
        Store(path)


def test_other_files_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"expected a store .*, got .*gone.h5: no such file"):
        Store(tmp_path / "gone.h5")
    with pytest.raises(InputError, match="a folder"):
        Store(tmp_path)
    text = part(tmp_path, "text", b"name,path\n")
    with pytest.raises(InputError, match="no HDF5 file or is damaged"):
        Store(text)
    cut = part(tmp_path, "cut", store(tmp_path, [clip()]).read_bytes()[:3000])
    with pytest.raises(InputError, match="no HDF5 file or is damaged"):
        Store(cut)
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["meta"] = 1
    with pytest.raises(InputError, match="another kind of HDF5 file"):
        Store(tmp_path / "other.h5")


def test_names_that_no_group_can_have():
    check_name("a.b ü")
    for name in (".", "a\0b"):
        with pytest.raises(InputError, match="expected a name of a clip that can stand in a store"):
            check_name(name)


def test_other_programs_see_words(tmp_path):
    """Codes carry their meaning in the file, and JSON is JSON."""
    with h5py.File(store(tmp_path, [clip()])) as file:
        group = file["clips/p01_m_1"]
        assert h5py.check_enum_dtype(group["frames/status"].dtype) == {"open": 0, "closed": 1, "no_mouth": 2}
        assert list(group["frames/status"]) == [0, 1, 2, 0]
        assert json.loads(bytes(group["about"][()]))["fields"]["level"] == 0.25


if __name__ == "__main__":
    make_old_store(OLD if len(sys.argv) < 2 else Path(sys.argv[1]))


def _other(name, make):
    def damage(file):
        del file[name]
        if make is not None:
            make(file)

    return damage


@pytest.mark.parametrize(
    "damage",
    [
        _other("clips/p01_m_1/about", None),
        _other(
            "clips/p01_m_1/about", lambda file: file.update({"clips/p01_m_1/about": np.frombuffer(b"\xff\xfe", "u1")})
        ),
        _other("clips/p01_m_1/frames/time_s", lambda file: file.update({"clips/p01_m_1/frames/time_s": np.zeros(2)})),
        _other(
            "clips/p01_m_1/frames/time_s",
            lambda file: file.create_dataset("clips/p01_m_1/frames/time_s", (10**12,), "f8", chunks=(1000,)),
        ),
        _other(
            "clips/p01_m_1/frames/status", lambda file: file.update({"clips/p01_m_1/frames/status": np.full(4, 99)})
        ),
        _other(
            "clips/p01_m_1/provenance",
            lambda file: file.update({"clips/p01_m_1/provenance": np.frombuffer(b"[]", "u1")}),
        ),
    ],
)
def test_a_damaged_store_is_one_sentence(tmp_path, damage):
    path = store(tmp_path, [clip()])
    with h5py.File(path, "r+") as file:
        damage(file)
    with Store(path) as found, pytest.raises(InputError, match="damaged") as error:
        found.words("p01_m_1")
        found.profile("p01_m_1")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("version", ["x", np.arange(3)])
def test_a_version_that_is_no_number(tmp_path, version):
    path = store(tmp_path, [clip()])
    with h5py.File(path, "r+") as file:
        file["meta"].attrs["version"] = version
    with pytest.raises(InputError, match="damaged"):
        Store(path)
