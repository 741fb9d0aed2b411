"""Bar charts against counts taken straight from the CSV files, whiskers against scipy."""

import csv
import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.container import ErrorbarContainer
from scipy import stats

import study
from study.errors import InputError
from study.figures import (
    THESIS_CHARTS,
    Bar,
    Chart,
    Estimate,
    Panel,
    charts_of,
    draw_chart,
    draw_estimates,
    draw_panels,
    level_colours,
    write_figure,
)
from study.responses import answers_from

DATA = Path(study.__file__).parent / "data"


@pytest.fixture(scope="module")
def thesis():
    return study.thesis_answers()


def rows_of_the_files():
    """(action, audio, level chosen, level not chosen) of every answer."""
    with open(DATA / "questions.csv", newline="") as file:
        questions = {row["question"]: row for row in csv.DictReader(file)}
    with open(DATA / "answers.csv", newline="") as file:
        for row in csv.DictReader(file):
            asked = questions[row["question"]]
            levels = int(asked["level_1"]), int(asked["level_2"])
            first = row["chosen_video"] == asked["video_1"]
            yield asked["action"], int(asked["audio"]), *(levels if first else levels[::-1])


ROWS = list(rows_of_the_files())


def count(chosen, other, action=None, audio=None):
    return sum(
        1
        for a, with_audio, won, lost in ROWS
        if won in chosen and lost in other and action in (None, a) and audio in (None, with_audio)
    )


def heights(figure):
    """Of the bars of each panel that is shown."""
    return [[bar.get_height() for bar in axes.patches] for axes in figure.axes if axes.get_visible()]


@pytest.mark.parametrize("chart", THESIS_CHARTS, ids=lambda chart: chart.name)
def test_bars_of_the_thesis_figures_are_the_counts_of_the_files(thesis, chart):
    sticky, expected = (4, 7, 10), []
    for _, where in chart.parts:
        if chart.kind == "grouped":
            expected.append([count((0,), sticky, **where), count(sticky, (0,), **where)])
        elif chart.kind == "pairs":
            pairs = [(0, 4), (0, 7), (0, 10), (4, 7), (4, 10), (7, 10)]
            expected += [[count((a,), (b,), **where), count((b,), (a,), **where)] for a, b in pairs]
        else:
            levels = (0, 4, 7, 10)
            expected.append([count((a,), [b for b in levels if b != a], **where) for a in levels])
    assert heights(draw_chart(chart, thesis)) == expected


def test_all_figures_of_the_thesis_are_there_once_and_named_in_their_title(thesis):
    assert [chart.name for chart in THESIS_CHARTS] == [f"figure_5_{number:02d}" for number in range(2, 21)]
    assert [chart.title.split(":")[0] for chart in THESIS_CHARTS] == [f"Figure 5.{number}" for number in range(2, 21)]


ACTIONS = {"slow mouth opening": "open_slow", "fast mouth opening": "open_fast"}


@pytest.mark.parametrize("chart", THESIS_CHARTS[2:], ids=lambda chart: chart.name)
def test_figures_of_one_action_show_the_action_that_their_title_names(chart):
    name = chart.title.split(": ")[1].split(", ")[0]
    words, _, audio = name.replace("'", "").partition(" with")
    action = ACTIONS.get(words, words)
    expected = {" audio": [1], "out audio": [0], "": [0] if action in ACTIONS.values() else [0, 1]}[audio]
    assert [where for _, where in chart.parts] == [{"action": action, "audio": one} for one in expected]


def test_counts_that_the_thesis_prints_about_figure_5_2_and_5_8(thesis):
    assert heights(draw_chart(THESIS_CHARTS[0], thesis)) == [[230, 346]]
    assert heights(draw_chart(THESIS_CHARTS[6], thesis)) == [[13, 47]]


def test_whiskers_are_exact_intervals(thesis):
    axes = draw_chart(THESIS_CHARTS[7], thesis).axes[0]  # 6 of 20 and 14 of 20
    drawn = [one for one in axes.containers if isinstance(one, ErrorbarContainer)]
    assert len(drawn) == 2
    for whisker, r in zip(drawn, (6, 14), strict=True):
        ends = whisker.lines[2][0].get_segments()[0][:, 1]
        found = stats.binomtest(r, 20).proportion_ci(0.95, "exact")
        np.testing.assert_allclose(ends / 20, [found.low, found.high], rtol=1e-9)


def test_the_chance_line_is_at_half_of_the_answers():
    bars = (Bar("a", 3, 10, "#123456"), Bar("b", 7, 10, "#123456"))
    axes = draw_panels([Panel("one", bars)], "title").axes[0]
    lines = [segment for one in axes.collections for segment in one.get_segments() if segment[0][1] == segment[1][1]]
    assert [line[0][1] for line in lines] == [5, 5]


def test_the_p_value_beneath_the_title_is_two_sided_and_exact(thesis):
    title = draw_chart(THESIS_CHARTS[2], thesis).axes[0].get_title()
    assert title == "ratio 2.75, p = 3.9e-4"
    assert stats.binomtest(44, 60).pvalue == pytest.approx(3.9e-4, rel=0.013)


def small(names, answers):
    rows = [(f"p{i}", left, right, chosen) for i, (left, right, chosen) in enumerate(answers)]
    assert {name for row in rows for name in row[1:3]} == set(names)
    return answers_from(pd.DataFrame(rows, columns=["participant", "left", "right", "chosen"]))


def test_ties_are_told_and_not_drawn():
    answers = small("ab", [("a", "b", "a"), ("b", "a", "b"), ("b", "a", ""), ("a", "b", "b")])
    figure = draw_chart(Chart("all", "all", "grouped", (("", {}),)), answers)
    assert heights(figure) == [[1, 2]]
    assert figure.axes[0].get_title().endswith("1 tie")


def test_charts_of_any_answers_leave_out_what_says_nothing():
    two = small("ab", [("a", "b", "a")])
    assert [chart.name for chart in charts_of(two)] == ["all"]
    three = small("abc", [("a", "b", "a"), ("b", "c", "c"), ("a", "c", "c")])
    assert [chart.name for chart in charts_of(three)] == ["all", "all_pairs"]


def test_charts_of_several_actions_have_a_panel_each(thesis):
    charts = {chart.name: chart for chart in charts_of(thesis)}
    assert list(charts) == ["all", "all_pairs", "by_action", "by_action_levels"]
    figure = draw_chart(charts["by_action"], thesis)
    assert len(heights(figure)) == 10
    assert sum(map(sum, heights(figure))) == 576


def test_too_many_pairs_for_bars_are_left_to_rows_of_estimates():
    names = "abcdefg"
    answers = small(names, [(a, b, a) for i, a in enumerate(names) for b in names[i + 1 :]])
    assert "all_pairs" not in [chart.name for chart in charts_of(answers)]


def test_estimates_stand_at_their_values_in_order():
    rows = [Estimate("first", 0.6, 0.5, 0.7, group="x"), Estimate("second", 0.4, 0.2, 0.6, group="y")]
    axes = draw_estimates(rows, "title", "share (%)").axes[0]
    labels = dict(zip([one.get_text() for one in axes.get_yticklabels()], axes.get_yticks(), strict=True))
    intervals = {
        float(line.get_ydata()[0]): list(line.get_xdata()) for line in axes.lines if len(line.get_xdata()) == 2
    }
    assert intervals[labels["first"]] == pytest.approx([50, 70])
    assert intervals[labels["second"]] == pytest.approx([20, 60])
    assert labels["x"] < labels["first"] < labels["y"] < labels["second"]


def test_an_estimate_without_interval_is_a_point():
    axes = draw_estimates([Estimate("one", 0.6, np.nan, np.nan)], "title", "share (%)").axes[0]
    assert [line.get_xdata()[0] for line in axes.lines if line.get_marker() == "o"] == pytest.approx([60])


def test_levels_have_colours_of_their_own():
    for n in range(1, 12):
        assert len(set(level_colours(n))) == n


def test_the_same_figure_gives_the_same_bytes(thesis, tmp_path):
    files = [write_figure(draw_chart(THESIS_CHARTS[0], thesis), tmp_path / f"{name}.png") for name in "ab"]
    first, second = (file.read_bytes() for file in files)
    assert first == second and first.startswith(b"\x89PNG")


def test_a_place_that_cannot_be_written_to_is_told(thesis, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="expected to write"):
        write_figure(draw_chart(THESIS_CHARTS[0], thesis), tmp_path / "file" / "figure.png")


def test_parts_without_answers_are_left_out(thesis):
    part = dataclasses.replace(thesis.where(action="m", level=[0, 4]), levels=thesis.levels)
    chart = Chart("x", "x", "pairs", (("", {}),))
    assert heights(draw_chart(chart, part)) == [[22, 18]]
