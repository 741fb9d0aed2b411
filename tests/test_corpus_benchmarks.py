"""The corpus benchmarks' own arithmetic: sizes of a clip, orders of levels, and clips that differ and play alike."""

import sys
from pathlib import Path

import av
import numpy as np
import pytest
from clips import moving_pictures, write_video

from lipmetrics.take import Take

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import corpus
import levels


def take(height, width=None, speaker="p01", level=0, action="m"):
    height = np.asarray(height, float)
    width = height if width is None else np.asarray(width, float)
    fields = {"speaker": speaker, "action": action, "stickiness": level, "repeat": 1}
    time_s = np.arange(len(height)) / 10
    return Take("one", time_s, {"width": width, "height": height, "area": height * width}, meta={"fields": fields})


def test_sizes_by_hand():
    one = take([0, 0, 0.1, 0.4, 0.2, 0.2], [0, 0, 0.2, 0.8, 0.6, 0.5])
    assert levels.onset_s(one) == pytest.approx(0.2) and levels.widening_s(one) == pytest.approx(0.1)
    assert levels.end_width(one) == 0.5 and levels.overshoot(one) == pytest.approx(1.0)
    assert levels.peak_height(one) == 0.4 and levels.peak_area(one) == pytest.approx(0.32)
    assert levels.early_area(one) == pytest.approx(0.02 / 3)  # of 0, 0.1 and 0.2 s
    assert np.isnan(levels.widening_s(take([0, 0.1]))) and np.isnan(levels.overshoot(take([0.2, 0, 0, 0])))
    twice = take([0, 0.1, 0.2, 0.3, 0.2, 0.1, 0, 0, 0.4, 0.45, 0.1])
    assert levels.second_over_first(twice) == pytest.approx(1.5)
    lower = take([0, 0.1, 0.2, 0.3, 0.2, 0.1, 0, 0, 0.1, 0.15, 0.1])
    assert levels.second_over_first(lower) == pytest.approx(0.5)


def judged(table, way, **more):
    """Heights of the peak by person and level."""
    takes = [take([0, peak], None, f"p{p}", level) for p, row in enumerate(table) for level, peak in enumerate(row)]
    finding = levels.Finding("m", "", levels.peak_height, way, **more)
    return levels.judged(levels.by_level(takes, finding), finding)


def test_orders_of_levels():
    table = [[0.4, 0.3, 0.2], [0.4, 0.4, 0.2], [0.4, 0.5, 0.3], [0.1, 0.2, 0.3]]
    found = judged(table, -1)
    assert (found["all levels"], found["none against"], found["ends"]) == ("1 of 4", "2 of 4", "3 of 4")
    assert found["means"] == "no" and found["0"] == "0.325 (0.150)"  # 0.325, 0.35, 0.25
    assert judged(table[:2], -1)["means"] == "yes" and judged(table[3:], 1)["all levels"] == "1 of 1"
    assert set(judged(table, -1, ends_only=True)) == {"0", "1", "2", "means", "ends"}
    above = judged(table, 0, least=0.25)
    assert (above["all levels"], above["means"]) == ("1 of 4", "no")
    assert judged(table, 0, least=0.15)["all levels"] == "3 of 4"


def frames(path):
    with av.open(str(path)) as container:
        return [(frame.time, frame.to_ndarray(format="rgb24")) for frame in container.decode(video=0)]


def test_copies_differ_and_show_the_same(tmp_path):
    source = write_video(tmp_path / "a.mp4", moving_pictures(4))
    paths = corpus.copies(source, tmp_path / "c", 3)
    assert len({path.read_bytes() for path in (source, *paths)}) == 4
    for path in paths:
        assert all((a[1] == b[1]).all() for a, b in zip(frames(path), frames(source), strict=True))


def test_a_clip_repeated(tmp_path):
    source = write_video(tmp_path / "a.mp4", moving_pictures(5))
    once, thrice = frames(source), frames(corpus.repeated(source, tmp_path / "b.mp4", 3))
    assert len(thrice) == 15 and np.allclose(np.diff([time for time, _ in thrice]), once[1][0] - once[0][0])
    assert all((thrice[k][1] == once[k % 5][1]).all() for k in range(15))
