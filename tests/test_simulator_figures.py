"""Figures of the truth."""

import cv2
import numpy as np
import pytest
from moved_mouth import moved_mouth

from simulator.errors import InputError
from simulator.figures import plot_saliva, plot_truth
from simulator.truth import truth


@pytest.fixture(scope="module")
def found():
    mouth, motion = moved_mouth("low", 6)
    return truth(motion, mouth)


@pytest.mark.parametrize("ending", ["png", *(pytest.param(e, marks=pytest.mark.slow) for e in ("pdf", "svg"))])
def test_the_same_truth_gives_the_same_bytes(found, tmp_path, ending):
    for draw, what in ((plot_truth, {"level 0": found, "level 7": found}), (plot_saliva, found)):
        for name in "ab":
            draw(what, tmp_path / f"{name}.{ending}", "title")
        assert (tmp_path / f"a.{ending}").read_bytes() == (tmp_path / f"b.{ending}").read_bytes()


def test_every_line_and_state_is_drawn(found, tmp_path):
    plot_truth({"level 0": found}, tmp_path / "one.png")
    plot_saliva(found, tmp_path / "states.png")
    one, states = (cv2.imread(str(tmp_path / name))[..., ::-1].astype(int) for name in ("one.png", "states.png"))
    assert (np.abs(one - (0x35, 0xA7, 0xC4)).max(axis=2) < 30).sum() > 500  # three lines
    for colour in ((0xB7, 0xD7, 0xE8), (0x2B, 0x2B, 0x33)):
        assert (np.abs(states - colour).max(axis=2) < 3).mean() > 0.1


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda found, folder: plot_truth({}, folder / "a.png"), "expected one truth or more"),
        (lambda found, folder: plot_truth({"a": found}, folder / "a.jpg"), "named .png, .pdf or .svg, got 'a.jpg'"),
        (lambda found, folder: plot_saliva(found, folder / "a"), "named .png, .pdf or .svg, got 'a'"),
    ],
)
def test_bad_figures(found, tmp_path, draw, message):
    with pytest.raises(InputError, match=message):
        draw(found, tmp_path)
    assert not list(tmp_path.iterdir())


def test_too_few_frames(tmp_path):
    mouth, motion = moved_mouth("low", 6)
    with pytest.raises(InputError, match="expected two frames or more to draw, got 1"):
        plot_saliva(truth(motion, mouth, times=[0.5]), tmp_path / "a.png")
