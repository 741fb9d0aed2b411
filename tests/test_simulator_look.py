"""Settings of a picture: every wrong one is one clear sentence."""

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.look import Inside, Light, Look, Sensor, Skin, to_linear, to_srgb

WRONG = {
    "unknown tone": (lambda: Skin(tone="ligth"), "did you mean 'light'"),
    "too dark": (lambda: Skin(tone=1.5), "expected tone as a number from 0 to 1, got 1.5"),
    "colour": (lambda: Skin(colour=(0, 300, 0)), "expected colour as red, green and blue from 0 to 255"),
    "no colour": (lambda: Light(colour=None), "expected colour as red, green and blue"),
    "share": (lambda: Skin(wetness=2), "expected wetness as a number from 0 to 1, got 2"),
    "not a number": (lambda: Skin(film=float("nan")), "expected film as a number"),
    "flag": (lambda: Skin(nose=1), "expected nose as true or false, got 1"),
    "direction": (lambda: Light(direction=(0, 0, 0)), "not all 0"),
    "strength": (lambda: Light(strength=-1), "expected strength as a number from 0 to 20"),
    "teeth": (lambda: Inside(upper_edge_m=1.0), "expected upper_edge_m as a number from -0.03 to 0.03"),
    "cast": (lambda: Sensor(cast=(1, -1, 1)), "three numbers of at least 0"),
    "samples": (lambda: Sensor(samples=0), "samples as a whole number from 1 to 64"),
    "no samples": (lambda: Sensor(samples=None), "samples as a whole number"),
    "quality": (lambda: Sensor(jpeg=101), "jpeg as a whole number from 1 to 100"),
    "kind": (lambda: Look(skin=Light()), "expected skin as a Skin"),
    "seed": (lambda: Look(seed=-1), "expected seed as a whole number from 0 on"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_settings(case):
    make, words = WRONG[case]
    with pytest.raises(InputError, match=words):
        make()


def test_srgb_and_linear_light():
    # IEC 61966-2-1: mid grey 188 is half of the light, and the curve's straight part ends at 10.3
    assert to_linear(188) == pytest.approx(0.503, abs=0.001)
    assert to_linear(10) == pytest.approx(10 / 255 / 12.92)
    every = np.arange(256)
    assert to_srgb(to_linear(every)) == pytest.approx(every, abs=1e-9)
