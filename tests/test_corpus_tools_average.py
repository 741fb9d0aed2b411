"""Averages of a corpus: speakers first, two spreads, tables, figures and the page."""

import base64
import json
import math
import re
import sys

import numpy as np
import pandas as pd
import pytest

from corpus_tools import report
from corpus_tools.average import average_groups, curves_table, measures, read_takes_of, speakers_table, summary_table
from corpus_tools.average_figures import levels_png, speakers_png
from corpus_tools.clips import Clip
from corpus_tools.naming import Template
from corpus_tools.store import Key, store_of_clip, write_store
from lipmetrics.cli import main
from lipmetrics.errors import InputError
from lipmetrics.profile import FORMAT, Profile, tables
from lipmetrics.take import Take

TEMPLATE = "{speaker}_{action}_{stickiness:0|4|7|10}_{repeat:d}"
RATE = 50


def take_of(name, height, fields=None, start_s=0.0):
    height = np.asarray(height, float)
    channels = {"height": height, "width": 2 * height, "area": height**2}
    time_s = start_s + np.arange(len(height)) / RATE
    return Take(name, time_s, channels, meta={"fields": fields or {}})


def opening(size, onset_s=0.4, length_s=2.0):
    time_s = np.arange(round(length_s * RATE) + 1) / RATE
    return size * np.sin(np.pi * np.clip((time_s - onset_s) / 1.2, 0, 1))


def profile_of(size, onset_s, width_px=100.0):
    """A measured clip whose height is `opening`, in mouth widths."""
    rows, openings = [], []
    for i, height in enumerate(opening(size, onset_s) * 100.0):
        status, n = ("open", 1) if height > 0.5 else ("closed", 0)
        h = height if n else 0.0
        rows.append((i, i / RATE, status, n, 2 * h, h, 1.5 * h * h, 1.5 * h * h, 1.0))
        if n:
            extent = (50 - h / 2, 50 + h / 2, 100 - h, 100 + h)
            event = "" if openings else "new"
            openings.append((i, i / RATE, 1, *extent, 2 * h, h, 1.5 * h * h, 50.0, 100.0, event, ""))
    frames, openings = tables(rows, openings, width_px)
    return Profile(frames, openings, {"format": FORMAT, "mouth_width_px": width_px, "mouth_width_found": "rest"})


def corpus():
    """name -> (fields, profile): 3 speakers, 2 actions, 4 levels, 2 repeats; stickier opens later and less."""
    found = {}
    for s, speaker in enumerate(("p01", "p02", "p03")):
        for action in ("mm", "os"):
            for level in (0, 4, 7, 10):
                for repeat in (1, 2):
                    size = (0.5 if action == "os" else 0.3) * (1 + 0.2 * s) * (1 - 0.03 * level) + 0.01 * repeat
                    fields = {"speaker": speaker, "action": action, "stickiness": level, "repeat": repeat}
                    name = Template(TEMPLATE).format(**fields)
                    found[name] = (fields, profile_of(size, 0.2 + 0.03 * level))
    return found


@pytest.fixture(scope="module")
def made():
    return corpus()


@pytest.fixture
def store(tmp_path, made):
    parts = {}
    for name, (fields, profile) in made.items():
        parts[name] = tmp_path / f"{name}.part"
        parts[name].write_bytes(store_of_clip(Clip("x.mp4", name, fields), profile, Key("a", "b", "c")))
    write_store(tmp_path / "corpus.h5", parts)
    return tmp_path / "corpus.h5"


def test_everyone_counts_once_and_the_two_spreads_are_told_apart():
    """Curves that differ in size alone, at their highest: means and deviations by hand."""
    sizes = {"a": [1.0, 1.2, 1.4], "b": [2.0, 2.2], "c": [3.3]}
    takes = [
        take_of(f"{who}{k}", np.r_[0, np.full(40, size), 0], {"speaker": who})
        for who, own in sizes.items()
        for k, size in enumerate(own)
    ]
    (group,) = average_groups(takes, [])
    k = len(group.average.time_s) // 2
    h = group.average.channels.index("height")
    means = np.array([1.2, 2.1, 3.3])
    pooled = math.sqrt((0.2**2 * 2 + 0.02 * 1) / 3)  # sums of squares over degrees of freedom: 2 of a, 1 of b
    assert group.average.mean[k, h] == pytest.approx(means.mean())
    assert group.average.spread[k, h] == pytest.approx(means.std(ddof=1))
    assert group.within[k, h] == pytest.approx(pooled)
    assert list(group.speakers) == ["a", "b", "c"] and group.clips_n == 6
    row = summary_table([group]).iloc[0]
    assert (row["peak_height"], row["peak_height_between"]) == pytest.approx((means.mean(), means.std(ddof=1)))
    assert row["peak_height_within"] == pytest.approx(pooled) and row["speakers_n"] == 3 and row["clips_n"] == 6
    table = speakers_table([group]).set_index("speaker")
    assert table.loc["a", "peak_width"] == pytest.approx(2.4) and table.loc["b", "clips_n"] == 2
    assert table.loc["a", "peak_height_within"] == pytest.approx(0.2) and math.isnan(
        table.loc["c", "peak_height_within"]
    )


def test_spreads_that_cannot_be_known_are_unknown():
    one = average_groups([take_of("a", opening(1), {"speaker": "x"})], [])[0]
    assert np.isnan(one.average.spread).all() and np.isnan(one.within).all()
    repeats = [take_of("a", opening(1)), take_of("b", opening(1.2))]  # nobody knows whose
    (group,) = average_groups(repeats, [])
    assert np.isnan(group.average.spread).all() and np.isfinite(group.within).all() and list(group.takes) == [""]


def test_rates_and_order_of_clips_do_not_matter():
    rng = np.random.default_rng(5)
    takes = [take_of(f"t{k}", opening(1 + 0.1 * k, 0.2 + 0.05 * k), {"speaker": f"s{k % 3}"}) for k in range(7)]
    half = takes[3]
    slow = {name: values[::2] for name, values in half.channels.items()}
    takes[3] = Take(half.name, half.time_s[::2], slow, meta=half.meta)
    table = curves_table(average_groups(takes, []))
    assert np.diff(table["time_s"]) == pytest.approx(1 / RATE) and table["height"].max() == pytest.approx(1.3, abs=0.02)
    shuffled = [takes[k] for k in rng.permutation(len(takes))]
    pd.testing.assert_frame_equal(table, curves_table(average_groups(shuffled, [])), check_exact=True)


def test_measures():
    found = measures(take_of("a", opening(0.6, 0.4), start_s=5.0))
    assert found["onset_s"] == pytest.approx(0.42) and found["peak_height"] == pytest.approx(0.6)
    # half of a sine's height after a sixth of its half period of 1.2 s
    assert found["rise_s"] == pytest.approx(0.2 - 0.02, abs=0.021) and found["peak_area"] == pytest.approx(0.36)
    assert found["fastest_opening"] == pytest.approx(0.6 * math.pi / 1.2, rel=0.01)
    closed = measures(take_of("a", np.zeros(50)))
    assert closed["peak_height"] == 0 and math.isnan(closed["onset_s"]) and math.isnan(closed["rise_s"])


def test_groups_of_a_store(store):
    takes = read_takes_of(store)
    groups = average_groups(takes, ["action", "stickiness"])
    assert [tuple(group.fields.values()) for group in groups] == [(a, s) for a in ("mm", "os") for s in (0, 4, 7, 10)]
    assert all(group.clips_n == 6 and len(group.takes) == 3 for group in groups)
    summary = summary_table(groups)
    for action in ("mm", "os"):
        own = summary[summary["action"] == action]
        assert (np.diff(own["onset_s"]) > 0.05).all() and (np.diff(own["peak_height"]) < 0).all()
    with pytest.raises(InputError, match="expected fields out of speaker, action, stickiness or repeat, got 'actoin'"):
        average_groups(takes, ["actoin"])


def test_the_report(store, tmp_path, capsys, monkeypatch):
    out = tmp_path / "report"
    assert main(["corpus", "average", str(store), "-o", str(out), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["clips_n"] == 48 and answer["speakers_n"] == 3 and len(answer["groups"]) == 8
    assert answer["groups"][1] == {"action": "mm", "stickiness": 4, "speakers_n": 3, "clips_n": 6}
    names = ["averages.csv", "report.html", "speakers.csv", "summary.csv"]
    assert sorted(path.name for path in out.iterdir()) == names
    page = (out / "report.html").read_text()
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert len(pictures) == 4 and all(base64.b64decode(one).startswith(b"\x89PNG") for one in pictures)
    assert "http" not in page and "by action and stickiness" in page and "↘" in page and "↗" in page
    table = pd.read_csv(out / "averages.csv")
    assert {"action", "stickiness", "time_s", "height", "height_between", "height_within"} <= set(table.columns)
    assert len(pd.read_csv(out / "summary.csv")) == 8 and len(pd.read_csv(out / "speakers.csv")) == 24
    for name in ("levels_png", "speakers_png"):  # drawing them again takes long, and says nothing new
        monkeypatch.setattr(report, name, lambda *_: b"\x89PNG")
    assert main(["corpus", "average", str(store), "-o", str(out), "--by", "speaker"]) == 0
    assert capsys.readouterr().out.startswith("48 clips, 3 speakers, 3 groups by speaker\n")
    assert len(pd.read_csv(out / "summary.csv")) == 3


def test_a_folder_of_profiles(tmp_path, made, capsys):
    folder = tmp_path / "profiles"
    for name in ("p01_os_0_1", "p01_os_0_2", "p02_os_10_1"):
        made[name][1].save(folder, name)
    profile_of(0.5, 0.2, math.nan).save(folder, "p03_os_0_1")
    profile_of(0.5, 0.2).save(folder, "other")
    words = ["corpus", "average", str(folder), "-o", str(tmp_path / "out"), "--template", TEMPLATE]
    assert main(words) == 3
    said = capsys.readouterr()
    assert "lipmetrics: p03_os_0_1: " in said.err and "known mouth width" in said.err and "other: " in said.err
    table = pd.read_csv(tmp_path / "out/summary.csv")
    assert table["stickiness"].tolist() == [0, 10] and table["clips_n"].tolist() == [2, 1]
    assert "2 clips could not be averaged" in (tmp_path / "out/report.html").read_text()
    assert main([*words[:-2]]) == 2  # names of the protocol
    assert "expected clips that can be averaged in" in capsys.readouterr().err


def test_bad_sources(tmp_path):
    (tmp_path / "none").mkdir()
    with pytest.raises(InputError, match=r"expected profiles .* or a store of 'lipmetrics corpus run', got"):
        read_takes_of(tmp_path / "none")
    with pytest.raises(InputError, match="expected a store that 'lipmetrics corpus run' wrote, got"):
        read_takes_of(tmp_path / "gone.h5")


def test_parquet(store, tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "pyarrow", None)
        without.setitem(sys.modules, "pyarrow.parquet", None)
        assert main(["corpus", "average", str(store), "-o", str(out), "--parquet"]) == 2
    assert "pip install 'lipmetrics[parquet]'" in capsys.readouterr().err and not list(out.iterdir())
    pytest.importorskip("pyarrow")
    monkeypatch.setattr(report, "levels_png", lambda *_: b"\x89PNG")
    monkeypatch.setattr(report, "speakers_png", lambda *_: b"\x89PNG")
    report.write_report(store, out, parquet=True)
    for name in ("averages", "summary", "speakers"):
        read, text = pd.read_parquet(out / f"{name}.parquet"), pd.read_csv(out / f"{name}.csv")
        assert list(read.columns) == list(text.columns) and len(read) == len(text)
        assert read["stickiness"].tolist() == text["stickiness"].tolist()


@pytest.mark.slow
def test_figures_show_every_level_and_speaker(store):
    groups = [group for group in average_groups(read_takes_of(store), ["action", "stickiness"])][:4]
    curves = {f"stickiness {g.fields['stickiness']}": (g.average, g.average.spread) for g in groups}
    png = levels_png(curves, "mm")
    bare = {label: (made, np.full_like(made.mean, np.nan)) for label, (made, _) in curves.items()}
    assert png == levels_png(curves, "mm") and png != levels_png(bare, "mm")
    assert levels_png(bare, "mm") != levels_png(dict(list(bare.items())[:3]), "mm")
    speakers = {
        who: {label: (g.speakers[who], g.takes[who]) for label, g in zip(curves, groups, strict=True)}
        for who in groups[0].takes
    }
    assert speakers_png(speakers, list(curves), "mm").startswith(b"\x89PNG")
