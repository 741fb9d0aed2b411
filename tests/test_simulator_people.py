"""People of simulated corpora: different, the same again, and spread over the human range."""

import itertools

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.people import people
from simulator.scene import Face, Scene
from simulator.settings import to_toml


def test_people_differ_in_face_skin_and_light():
    for one, other in itertools.combinations(people(12), 2):
        assert one.face != other.face and one.skin != other.skin and one.light != other.light
        assert one.sensor != other.sensor and one.background != other.background
        assert abs(one.skin.melanin - other.skin.melanin) > 0.02


def test_few_people_have_skins_of_the_whole_range():
    for seed in range(5):
        tones = np.sort([one.skin.melanin for one in people(5, seed)])
        assert tones[0] < 0.3 and tones[-1] > 0.7 and np.diff(tones).max() < 0.4


def test_more_people_leave_the_first_as_they_are():
    assert people(9, seed=3)[:4] == people(4, seed=3)
    assert people(4, seed=3) != people(4, seed=4)


def test_exposure_leaves_skin_between_black_and_white():
    """Skin that faces the light: more light on dark skin, but not as much as would make it light."""
    lit = []
    for one in people(40):
        white = one.light.strength + one.light.ambient
        lit.append(float(one.skin.linear.mean()) * white * one.sensor.exposure)
    lit, dark = np.array(lit), np.array([one.skin.melanin for one in people(40)])
    assert lit.min() > 0.06 and lit.max() < 0.7
    assert lit[dark < 0.3].mean() > 2 * lit[dark > 0.7].mean()


def test_the_scene_keeps_its_mesh_and_movement():
    scene = Scene(face=Face(preset="child", resolution="low"), duration_s=0.5)
    (person,) = people(1)
    played = person.plays(scene)
    assert played.face.resolution == "low" and played.duration_s == 0.5 and played.camera.width_px == 512
    assert played.face.width_m == person.face.width_m != scene.face.shape().width_m
    assert played.skin == person.skin and played.camera.yaw_deg == person.yaw_deg
    assert "yaw_deg" in to_toml(played)


@pytest.mark.parametrize("count", [0, 1000])
def test_a_number_that_cannot_be(count):
    with pytest.raises(InputError, match=f"expected 1 to 999 people, got {count}"):
        people(count)
