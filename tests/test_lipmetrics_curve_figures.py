import cv2
import numpy as np
import pytest
from moving_takes import moving_take

from lipmetrics import curve_figures
from lipmetrics.compare import align, average, carry, propose_phases
from lipmetrics.curve_figures import FloorRow, Group


@pytest.fixture
def panels(monkeypatch):
    """Call a figure's function and get its axes instead of a PNG."""
    import matplotlib.figure

    def draw_only(draw, size):
        figure = matplotlib.figure.Figure(figsize=size)
        draw(figure)
        return figure.axes

    monkeypatch.setattr(curve_figures, "_png", draw_only)


@pytest.fixture
def pair():
    return moving_take("real"), moving_take("model", high=0.4, late_s=0.08, rate_hz=50)


def test_profiles_keep_their_own_times(panels, pair):
    groups = [Group("real", [pair[0]], "#000000"), Group("model", [pair[1]], "#ff0000")]
    height, area = curve_figures.profiles_png(groups, ("height", "area"))
    for line, take in zip(height.lines, pair, strict=True):
        np.testing.assert_array_equal(line.get_data(), [take.time_s, take.channels["height"]])
    assert area.get_ylabel() == "area\n(mouth widths²)" and area.get_xlabel() == "time (s)"


def test_the_path_and_the_lag_are_drawn(panels, pair):
    match = align(*pair)
    square, late = curve_figures.path_png(match)
    np.testing.assert_array_equal(square.lines[-1].get_xydata(), match.times_s)
    assert late.lines[-1].get_ydata()[0] == pytest.approx(1000 * match.lag_s)
    assert 60 < 1000 * match.lag_s < 100


def test_the_second_take_is_brought_to_the_first_ones_times(panels, pair):
    match = align(*pair, channels=("height",))
    _, aligned = curve_figures.aligned_png(match)
    np.testing.assert_array_equal(aligned.lines[1].get_data(), [match.a.time_s, match.b_on_a[:, 0]])


def test_regions_are_shaded_where_they_are(panels, pair):
    match = align(*pair)
    regions = propose_phases(pair[0])
    carried = carry(regions, match)
    for panel, parts in zip(
        curve_figures.regions_png(match, regions, carried, "height"), (regions, carried), strict=True
    ):
        assert [text.get_text() for text in panel.texts] == ["onset", "opening", "hold", "closing"]
        starts = [patch.get_x() for patch in panel.patches]
        np.testing.assert_allclose(starts, [region.start_s for region in parts])


def test_floors_show_every_take_and_every_model(panels):
    rows = [
        FloorRow("one", np.array([0.5, 1, 2]), {"m": (3.0, 2.0, 4.0), "n": (0.0, 0.0, 0.0)}),
        FloorRow("two", np.array([1.0]), {"m": (np.nan, np.nan, np.nan), "n": (1.5, np.nan, np.nan)}),
    ]
    (panel,) = curve_figures.floors_png(rows, ["m", "n"], "ratio")
    dots = [line.get_xdata() for line in panel.lines if line.get_marker() == "." and len(line.get_xdata())]
    np.testing.assert_array_equal(dots[0], [0.5, 1, 2])
    marks = [float(line.get_xdata()[0]) for line in panel.lines if line.get_marker() == "D" and len(line.get_xdata())]
    assert marks == [3.0, 1.5]
    below = [line for line in panel.lines if line.get_marker() == "<"]
    assert len(below) == 1  # 0 has no place on a logarithmic scale: an arrow at the edge
    assert [label.get_text() for label in panel.get_yticklabels()] == ["two", "one"]


def test_an_average_is_drawn_with_its_spread(panels):
    takes = [moving_take(high=high) for high in (0.2, 0.3, 0.4)]
    made = average(takes, channels=("height",))
    (panel,) = curve_figures.average_png(made, takes)
    np.testing.assert_array_equal(panel.lines[-1].get_ydata(), made.mean[:, 0])
    assert len(panel.lines) == 4 and len(panel.collections) == 1
    (alone,) = curve_figures.average_png(average(takes[:1], channels=("height",)))
    assert len(alone.collections) == 0


def test_the_same_figure_has_the_same_bytes(pair):
    first, second = (curve_figures.path_png(align(*pair)) for _ in range(2))
    assert first == second
    assert np.ptp(cv2.imdecode(np.frombuffer(first, np.uint8), cv2.IMREAD_COLOR)) > 200


def test_a_take_of_one_frame_can_be_drawn():
    one = moving_take(duration_s=0.0)
    assert curve_figures.path_png(align(one, one)).startswith(b"\x89PNG")
