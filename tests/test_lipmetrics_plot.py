import subprocess
import sys

import numpy as np
import pytest
from mouth_clip import looks_of, profile_of

from lipmetrics.errors import InputError
from lipmetrics.plot import draw_figure, frame_edges, plot_profile, status_spans

STATUSES = ["open"] * 3 + ["closed"] * 2 + ["no_mouth"] * 2 + ["open"] + ["no_mouth"]
TIMES_S = [0.0, 0.1, 0.2, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9]  # a frame was dropped after 0.2 s


@pytest.fixture
def profile():
    return profile_of(looks_of(STATUSES), TIMES_S)


def test_panels_show_the_profile_over_true_time(profile):
    width, height, area, openings = draw_figure(profile).axes
    for panel, column in ((width, "width_mw"), (height, "height_mw"), (area, "area_mw2")):
        time_s, values = panel.lines[0].get_data()
        np.testing.assert_array_equal(time_s, TIMES_S)
        np.testing.assert_allclose(values, profile.frames[column])
        assert "mouth widths" in panel.get_ylabel()
    values, edges_s, _ = openings.patches[-1].get_data()
    np.testing.assert_array_equal(values, [1, 1, 1, 0, 0, np.nan, np.nan, 1, np.nan])
    assert edges_s[3] == pytest.approx(0.3)
    assert openings.get_xlabel() == "time (s)"


def test_closed_is_drawn_as_zero_and_unknown_not_at_all(profile):
    values = draw_figure(profile).axes[1].lines[0].get_ydata()
    assert values[3] == 0
    assert np.isnan(values[5])


def test_a_known_frame_between_unknown_ones_is_a_dot(profile):
    dots = draw_figure(profile).axes[1].lines[1].get_xdata()
    np.testing.assert_array_equal(dots, [0.8])


def test_sizes_are_in_px_where_the_mouth_width_is_unknown():
    profile = profile_of(looks_of(["open", "open"]), [0.0, 0.1], mouth_width_px=np.nan)
    height = draw_figure(profile).axes[1]
    assert height.get_ylabel() == "height\n(px)"
    np.testing.assert_allclose(height.lines[0].get_ydata(), profile.frames["height_px"])


def test_total_area_appears_with_a_second_opening_only(profile):
    assert len(draw_figure(profile).axes[2].lines) == 2
    profile.frames.loc[1, "n_openings"] = 2
    assert len(draw_figure(profile).axes[2].lines) == 3


@pytest.mark.parametrize("statuses", [["no_mouth"] * 4, ["closed"] * 4, ["open"], ["no_mouth"]], ids=str)
def test_every_profile_can_be_drawn(tmp_path, statuses):
    profile = profile_of(looks_of(statuses), [k / 25 for k in range(len(statuses))])
    plot_profile(profile, tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("kind", ["png", *(pytest.param(k, marks=pytest.mark.slow) for k in ("pdf", "svg"))])
def test_same_profile_same_bytes(tmp_path, profile, kind):
    for name in "ab":
        plot_profile(profile, tmp_path / f"{name}.{kind}")
    assert (tmp_path / f"a.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"a.{kind}", f"b.{kind}"]


def test_other_kinds_of_file_are_refused(tmp_path, profile):
    with pytest.raises(InputError, match=r"expected a figure named \.png, \.pdf or \.svg, got 'a\.jpg'"):
        plot_profile(profile, tmp_path / "a.jpg")


def test_a_place_that_cannot_be_written_to(tmp_path, profile):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="expected to write"):
        plot_profile(profile, tmp_path / "file" / "a.png")


def test_frame_edges_lie_half_way():
    np.testing.assert_allclose(frame_edges(np.array([0.0, 0.1, 0.3])), [-0.05, 0.05, 0.2, 0.4])
    np.testing.assert_allclose(frame_edges(np.array([2.0])), [1.5, 2.5])


def test_status_spans_are_runs_between_edges():
    edges_s = np.arange(6.0)
    assert status_spans(np.array(["open", "closed", "closed", "no_mouth", "open"]), edges_s) == [
        ("closed", 1.0, 3.0),
        ("no_mouth", 3.0, 4.0),
    ]
    assert status_spans(np.array(["open"]), edges_s[:2]) == []


def test_matplotlib_waits_until_a_figure_is_asked_for():
    code = "import sys, lipmetrics.plot; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
