import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.model import Displacement, Force
from simulator.moisture import critical, strength_of_level
from simulator.mouth import COMMISSURE, SALIVA, MouthShape
from simulator.muscles import MUSCLES
from simulator.saliva import pooled
from simulator.scene import (
    Action,
    Camera,
    Face,
    Glue,
    Output,
    Scene,
    load_scene,
    scene_from_table,
    scene_names,
    scene_text,
)
from simulator.settings import parse_toml, to_toml

BUILT_IN = (
    "demo",
    "double_opening",
    "drying",
    "fast_open",
    "glued_shut",
    "m",
    "mummy",
    "one_sided_left",
    "one_sided_right",
    "p",
    "pout",
    "puppy",
    "slow_open",
    "smile",
    "uneven_drying",
)
JAW = '[[muscle]]\nname = "jaw"\nkeys = [[0.1, 0.0], "smooth", [0.5, 1.0]]\n'


@pytest.fixture
def load(tmp_path):
    """A scene on the low mesh from a TOML text in a file of its own."""

    def load(text, **how):
        path = tmp_path / "mine.toml"
        if "[face]" not in text:
            text += '\n[face]\nresolution = "low"\n'
        path.write_text(text, encoding="utf-8")
        return load_scene(path, **how)

    return load


def middles(mouth):
    """x of the middle of each saliva element."""
    return mouth.nodes[mouth.elements[mouth.saliva]].mean(axis=1)[:, 0]


# -- built-in scenes --------------------------------------------------------------------------------------------------


def test_the_built_in_scenes():
    assert scene_names() == BUILT_IN


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in ("smile", "puppy") else name for name in BUILT_IN]
)
def test_a_built_in_scene_can_be_solved_and_written_again(name):
    scene = load_scene(name)
    assert scene.name == name and scene.about and "\n" not in scene.about
    again = scene_from_table(parse_toml(to_toml(scene), name), name)
    assert again == scene
    whole = scene.spelled_out()
    assert scene_from_table(parse_toml(to_toml(whole), name), name) == whole
    small = dataclasses.replace(scene, face=dataclasses.replace(scene.face, resolution="low"))
    _, model = small.model()
    assert model.duration_s == scene.duration_s and len(model.loads) > 1
    assert max(action.curve().times_s[-1] for action in scene.muscle) <= scene.duration_s
    lines = scene_text(name).splitlines()
    assert max(map(len, lines)) <= 120
    said = [line for line in lines if re.match(r"\w+ = ", line) and "keys" not in line]
    assert all("#" in line for line in said if not line.startswith("about")), "every setting is explained"


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_scene_is_the_same_action_at_every_level(name):
    none, strong = load_scene(name, 0), load_scene(name, 10)
    assert none.muscle == strong.muscle and strong.saliva.stickiness == 10
    assert none.saliva.stickiness == 0 and all(patch.stickiness == 0 for patch in none.saliva.patch)


def test_a_scene_written_in_full_does_not_change_with_what_is_usual(monkeypatch):
    for name in ("smile", "pout"):
        scene = dataclasses.replace(load_scene(name), face=Face("child", resolution="low"))
        _, before = scene.model()
        text = to_toml(scene.spelled_out())
        assert text.count("peak_n = ") == len(scene.muscle)
        whole = scene_from_table(parse_toml(text, name), name)
        assert whole == scene.spelled_out() == whole.spelled_out()
        with monkeypatch.context() as patched:
            for muscle, usual in MUSCLES.items():
                patched.setitem(MUSCLES, muscle, dataclasses.replace(usual, peak_n=9.0, forward=9.0))
            _, after = whole.model()
            assert len(scene.model()[1].loads) == len(before.loads)
            changed = [load for load in scene.model()[1].loads if isinstance(load, Force)]
        same, forces = ([load for load in model.loads if isinstance(load, Force)] for model in (after, before))
        for one, other, usual in zip(same, forces, changed, strict=True):
            assert np.array_equal(one.magnitudes_n, other.magnitudes_n)
            assert not np.array_equal(usual.magnitudes_n, other.magnitudes_n)


def test_the_sides_of_the_one_sided_scenes():
    for name, side in (("one_sided_left", -1), ("one_sided_right", 1)):
        scene = load_scene(name)
        mouth, model = dataclasses.replace(scene, face=Face(resolution="low")).model()
        x, strength = middles(mouth), model.saliva.strength
        assert (strength[x * side > 0.01] < 0.5 * strength[::-1][x * side > 0.01]).all()  # its mirror image's
        other = dataclasses.replace(load_scene(name), face=Face(resolution="low"))
        assert np.array_equal(other.model()[1].saliva.strength, strength)
    left, right = load_scene("one_sided_left"), load_scene("one_sided_right")
    assert left.muscle == right.muscle


# -- what a scene is made of ------------------------------------------------------------------------------------------


def test_the_smallest_scene():
    scene = Scene(face=Face(resolution="low"), saliva=Glue(pooling=1.0))
    mouth, model = scene.model()
    assert np.array_equal(model.saliva.elements, mouth.saliva)
    np.testing.assert_allclose(model.saliva.strength, strength_of_level(7))
    assert np.array_equal(model.material_of == 1, mouth.group == SALIVA)
    assert np.array_equal(model.material_of == 2, mouth.group == COMMISSURE) and (model.material_of == 2).any()
    assert [material.shear_pa for material in model.materials] == [800, 7700, scene.tissue.corner_shear_pa]
    assert [material.bulk_pa for material in model.materials] == [7000, 191000, scene.tissue.corner_bulk_pa]
    up = model.saliva.up
    np.testing.assert_allclose(np.linalg.norm(up, axis=1), 1)
    assert up[:, 1].min() > 0.9


def test_up_points_across_the_film():
    mouth, model = Scene(face=Face(resolution="low")).model()
    X = mouth.nodes[mouth.elements[mouth.saliva]]
    columns = mouth.nodes[mouth.upper].mean(axis=1) - mouth.nodes[mouth.lower].mean(axis=1)
    for i in (0, 7, len(X) - 1):
        expected = columns[i] + columns[i + 1]
        np.testing.assert_allclose(model.saliva.up[i], expected / np.linalg.norm(expected), atol=1e-12)


def test_times():
    scene = Scene(duration_s=0.5, output=Output(frame_rate=30, states_per_frame=2))
    np.testing.assert_allclose(scene.frame_times_s, np.arange(16) / 30)
    np.testing.assert_allclose(scene.state_times_s, np.arange(31) / 60)
    assert np.array_equal(scene.state_times_s[::2], scene.frame_times_s)
    assert len(Scene(duration_s=0.29, output=Output(frame_rate=100)).frame_times_s) == 30  # 0.29 * 100 is below 29
    assert len(Scene(duration_s=0.01).frame_times_s) == 1
    assert len(Scene(duration_s=1.0, output=Output(frame_rate=29.97)).frame_times_s) == 30


def test_lengths_of_a_face_are_those_of_its_preset_but_for_the_given_ones(load):
    scene = load('[face]\npreset = "wide"\nresolution = "low"\nupper_lip_m = 0.009\n')
    shape = scene.face.shape()
    assert shape.upper_lip_m == 0.009 and shape.width_m > MouthShape().width_m
    whole = scene.spelled_out().face
    assert whole.width_m == shape.width_m and whole.shape() == shape
    assert scene.model()[0].shape == shape


def test_patches_lie_where_they_should_whatever_the_mesh(load):
    text = "[saliva]\npooling = 1\nstickiness = 2\n[[saliva.patch]]\nfrom_m = 0.003\nto_m = 0.009\nstickiness = 10\n"
    for resolution, tolerance in (("low", 1e-12), ("medium", 1e-12)):
        mouth, model = load(text + f'[face]\nresolution = "{resolution}"\n').model()
        x, level = middles(mouth), 10 * model.saliva.strength / strength_of_level(10)
        width = np.diff(mouth.nodes[mouth.upper[:, 0], 0])
        inside, outside = (x > 0.0045) & (x < 0.0075), (x < 0.0015) | (x > 0.0105)
        np.testing.assert_allclose(level[inside], 10, atol=tolerance)
        np.testing.assert_allclose(level[outside], 2, atol=tolerance)
        # glue over the length: 6 mm of 8 levels more, to a sixteenth of an element at each end
        assert (level - 2) @ width == pytest.approx(8 * 0.006, abs=8 * width.max() / 8)


def test_saliva_pools_in_the_corners(load):
    mouth, model = load("[saliva]\nstickiness = 5\npooling = 9").model()
    x, factor = middles(mouth), model.saliva.strength / strength_of_level(5)
    np.testing.assert_allclose(factor, pooled(2 * x / mouth.width_m, 9.0), atol=0.1)
    assert factor[[14, 15]].max() < 1.01 and factor[[0, -1]].min() > 7
    np.testing.assert_allclose(factor, factor[::-1])


def test_an_edge_fades_out_smoothly(load):
    mouth, model = load(
        "[saliva]\npooling = 1\nstickiness = 0\n[[saliva.patch]]\nfrom_m = 0.0\nstickiness = 10\nedge_m = 0.01"
    ).model()
    x, level = middles(mouth), 10 * model.saliva.strength / strength_of_level(10)
    s = np.clip(1 + x / 0.01, 0, 1)
    np.testing.assert_allclose(level, 10 * (3 * s**2 - 2 * s**3), atol=0.1)


def test_a_later_patch_lies_over_an_earlier_one(load):
    text = "[saliva]\npooling = 1\n[[saliva.patch]]\nstickiness = 3\n[[saliva.patch]]\nfrom_m = 0.0\nstickiness = 9\n"
    mouth, model = load(text).model()
    level = 10 * model.saliva.strength / strength_of_level(10)
    np.testing.assert_allclose(level[middles(mouth) > 0.001], 9)
    np.testing.assert_allclose(level[middles(mouth) < -0.001], 3)


def test_moisture_patches_and_licks(load):
    mouth, model = load(
        """
        duration_s = 3
        [saliva]
        stickiness = 10
        pooling = 1
        [moisture]
        initial = 0.8
        drying_per_s = 0.1
        [[moisture.patch]]
        to_m = 0.0
        drying_per_s = 0.3
        [[moisture.patch]]
        from_m = 0.01
        initial = 1.5
        [[moisture.lick]]
        time_s = 2
        moisture = 0.9
        from_m = 0.0
        """
    ).model()
    x, saliva = middles(mouth), model.saliva
    left, middle, right = x < -0.001, (x > 0.001) & (x < 0.0085), x > 0.0115
    np.testing.assert_allclose(saliva.drying_per_s[left], 0.3)
    np.testing.assert_allclose(saliva.drying_per_s[x > 0.001], 0.1)
    np.testing.assert_allclose(saliva.moisture[left | middle], 0.8)
    np.testing.assert_allclose(saliva.moisture[right], 1.5)
    (lick,) = saliva.licks
    assert (lick.time_s, lick.moisture) == (2, 0.9)
    assert np.array_equal(x[lick.saliva], x[x > 0])
    z = critical(saliva.moisture, saliva.strength)
    np.testing.assert_allclose(z[right], 1)  # it lubricates
    np.testing.assert_allclose(z[middle], 1 + 0.8 * strength_of_level(10))


def test_muscles_become_loads(load):
    text = JAW + '[[muscle]]\nname = "press"\npeak_n = 0.02\nkeys = [[0, 1]]\n'
    _, model = load(text).model()
    _, twice = load(text.replace("0.02", "0.04")).model()
    assert any(isinstance(load, Displacement) for load in model.loads)
    forces = [np.abs(load.magnitudes_n).sum() for load in model.loads if isinstance(load, Force)]
    doubled = [np.abs(load.magnitudes_n).sum() for load in twice.loads if isinstance(load, Force)]
    assert len(forces) >= 1
    np.testing.assert_allclose(doubled, 2 * np.array(forces))


def test_a_muscle_in_a_volume_of_its_own(load):
    text = '[[muscle]]\nname = "zygomaticus"\nkeys = [[0, 1]]\n'
    usual, moved = load(text), load(text + "ellipsoid = {centre_m = [0.03, 0.01, 0], radii_m = [0.01, 0.01, 0.03]}\n")
    for scene, place in ((usual, None), (moved, 0.03)):
        mouth, model = scene.model()
        pulled = np.unique(np.concatenate([load.nodes for load in model.loads if isinstance(load, Force)]))
        x = np.abs(mouth.nodes[pulled, 0])
        assert place is None or (x.min() > place - 0.01 and x.max() < place + 0.01)
    box = load(text + "box = {low_m = [0.02, 0.0, -0.1], high_m = [0.04, 0.02, 0.1]}\n")
    assert box.muscle[0].box.high_m == (0.04, 0.02, 0.1)


def test_segments_between_keys():
    action = Action("jaw", keys=((0.0, 0.0), (0.1, 0.5), "smooth", (0.2, 1.0)))
    curve = action.curve()
    assert curve.segments == ("linear", "smooth") and curve.times_s == (0.0, 0.1, 0.2)


def test_keys_from_a_file(load, tmp_path):
    (tmp_path / "jaw.txt").write_text("0.0 0.0\nlinear\n0.1 0.2\ngeometric\n0.5 0.6\nquarter_sin\n1.0 1.0\n")
    scene = load('[[muscle]]\nname = "jaw"\nfile = "jaw.txt"\n')
    (action,) = scene.muscle
    assert action.file is None and action.keys[:3] == ((0.0, 0.0), "linear", (0.1, 0.2))
    assert action.curve().segments == ("linear", "geometric", "quarter_sin")
    with pytest.raises(InputError, match=r"mine\.toml, \[\[muscle\]\] 1: .*none\.txt: No such file"):
        load('[[muscle]]\nname = "jaw"\nfile = "none.txt"\n')


def test_stickiness_in_place_of_the_scenes_own(load):
    text = "[saliva]\nstickiness = 4\n[[saliva.patch]]\nfrom_m = 0.0\nstickiness = 12\n"
    scene = load(text, stickiness=6)
    assert scene.saliva.stickiness == 6 and scene.saliva.patch[0].stickiness == pytest.approx(18)
    with pytest.raises(InputError, match="whose stickiness is above 0 beside its patches"):
        load(text.replace("stickiness = 4", "stickiness = 0"), stickiness=6)
    with pytest.raises(InputError, match=r"expected a stickiness from 0 to 10, .* got -1"):
        load_scene("m", -1)


def test_names_come_from_the_file_unless_given(load):
    assert load("").name == "mine"
    assert load('name = "other"').name == "other"


def test_a_built_in_name_wins_and_files_are_found_by_path(load, tmp_path):
    scene = load("duration_s = 0.25")
    assert scene == load_scene(str(tmp_path / "mine.toml"))
    (tmp_path / "plain").write_text("duration_s = 0.25\n")
    assert load_scene(tmp_path / "plain").duration_s == 0.25


# -- what cannot be used ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("durations = 1", r"mine\.toml: expected a known key, got 'durations'; did you mean 'duration_s'"),
        ("duration_s = 0", r"mine\.toml: expected duration_s above 0 and up to 600 s, got 0"),
        ("duration_s = 1e9", "expected duration_s above 0 and up to 600 s, got 1e.09"),
        ("duration_s = nan", "expected duration_s as a finite number, got nan"),
        ('name = "../out"', "expected a name of letters, digits"),
        ("seed = -1", "expected seed as a whole number from 0 on, got -1"),
        ("background = [0, 0, 300]", "expected background as red, green and blue from 0 to 255"),
        ("[output]\nframe_rate = 1e6", r"\[output\]: expected frame_rate from 1 to 10000 per second, got 1e\+06"),
        ("duration_s = 500\n[output]\nframe_rate = 1000", "expected at most 100000 states, got 500 s at 1000"),
        ("[camera]\nwidth_px = 100000", r"\[camera\]: expected width_px as a whole number from 16 to 8192, got 100000"),
        ("[camera]\nwith_px = 100", r"\[camera\]: expected a known key, got 'with_px'; did you mean 'width_px'"),
        ("[skin]\ntone = 'green'", r"\[skin\]: expected a tone of"),
        ("[saliva]\nstickiness = -1", r"\[saliva\]: expected a stickiness from 0 to 10"),
        ("[saliva]\nstickiness = 1e6", "or for special effects to 1000, got 1e.06"),
        ("[saliva]\npooling = 0", r"\[saliva\]: expected a pooling above 0 and up to 1000, got 0"),
        ("[saliva]\nstickiness = nan", "expected stickiness as a finite number, got nan"),
        ("[moisture]\ninitial = -0.1", r"\[moisture\]: expected initial of 0 or more, got -0.1"),
        ("[moisture]\ndrying_per_s = -2", "expected drying_per_s of 0 or more, got -2"),
        ("[[moisture.patch]]\ninitial = -2", r"\[\[moisture.patch\]\] 1: expected initial of 0 or more, got -2"),
        ("[[moisture.lick]]\ntime_s = 1\nmoisture = -2", r"\[\[moisture.lick\]\] 1: expected moisture of 0 or more"),
        ("[[moisture.lick]]\ntime_s = 0", "expected time_s above 0 s, got 0.0; what holds at the start is 'initial'"),
        ("[[saliva.patch]]\nstickiness = 4\nfrom_m = 1\nto_m = 0", "expected from_m below to_m, got 1 and 0"),
        ("[[saliva.patch]]\nstickiness = 4\nedge_m = -1", "expected edge_m of 0 or more and below 1 m, got -1"),
        ("[[saliva.patch]]\nfrom_m = 0", "expected the key 'stickiness', got none"),
        (
            '[[muscle]]\nname = "jwa"\nkeys = [[0, 1]]',
            r"\[\[muscle\]\] 1: expected a muscle of .* got 'jwa'; did you mean",
        ),
        ('[[muscle]]\nname = "jaw"', "expected keys or a file with them, got neither"),
        ('[[muscle]]\nname = "jaw"\nkeys = [[0, 1]]\nfile = "a"', "expected keys or a file with them, got both"),
        ('[[muscle]]\nname = "jaw"\npeak_n = 1\nkeys = [[0, 1]]', "expected peak_m, how far the chin sinks, for jaw"),
        ('[[muscle]]\nname = "press"\npeak_m = 1\nkeys = [[0, 1]]', "expected peak_n, a force, for press, got peak_m"),
        ('[[muscle]]\nname = "jaw"\npeak_m = 25\nkeys = [[0, 1]]', "expected a jaw whose chin moves by up to 0.05 m"),
        (JAW.replace("0.1, 0.0", "0.6, 0.0"), r"\[\[muscle\]\] 1: expected key frames in increasing time, got 0.5 s"),
        (JAW.replace("smooth", "smoth"), "expected a segment of linear, .* got 'smoth'; did you mean 'smooth'"),
        (JAW.replace('"smooth",', '"smooth", "linear",'), "expected 'linear' between two key frames"),
        (JAW.replace(", [0.5, 1.0]", ""), "after 'smooth', got the end"),
        (JAW.replace("[0.1, 0.0]", "[0.1]"), "expected item 1 of keys as a list of 2 numbers or a text in quotes"),
        (JAW.replace("0.1, 0.0", "nan, 0.0"), "expected item 1 of keys as"),
        ('[[muscle]]\nname = "jaw"\nside = "top"\nkeys = [[0, 1]]', "expected side as 'both', 'left' or 'right'"),
        ('[face]\npreset = "avrage"', r"\[face\]: expected a face of .* got 'avrage'; did you mean 'average'"),
        ('[solve]\nprecision = "double"', "expected precision as 'float32', 'mixed' or 'float64', got 'double'"),
        ('[solve]\nsymmetric = "no"', "expected symmetric as true or false or 'auto', got 'no'"),
        ("duration_s = = 1", r"mine\.toml: expected TOML .* line 1"),
    ],
)
def test_bad_scenes_are_one_sentence(load, text, sentence):
    with pytest.raises(InputError, match=sentence) as caught:
        load(text)
    assert "\n" not in str(caught.value) and "mine.toml" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[face]\nwidth_m = 0.5", "expected width_m between 0.02 and 0.12 m, got 0.5"),
        (
            '[face]\nresolution = "hihg"',
            "expected a resolution of low, medium or high, got 'hihg'; did you mean 'high'",
        ),
        ('[face]\nobj = "none.obj"', "none.obj"),
        ('[face]\nobj = "a.obj"\nwidth_m = 0.05', "expected lengths of a face without obj, got width_m"),
        ("[[saliva.patch]]\nstickiness = 4\nfrom_m = 0.2", r"\[\[saliva.patch\]\] 1: expected a part of the lips"),
        ("[[moisture.patch]]\ninitial = 1\nto_m = -0.2", r"\[\[moisture.patch\]\] 1: expected a part of the lips"),
        (
            "[[moisture.lick]]\ntime_s = 2\n[[moisture.lick]]\ntime_s = 1",
            "expected licks in the order of their times",
        ),
        ("[tissue]\nshear_pa = -1", "shear"),
        (JAW + JAW, "expected one activation of the jaw, got 2"),
        (
            'duration_s = 600\n[face]\nresolution = "high"\n[output]\nframe_rate = 100',
            "expected a motion of at most 8 GB, got 60001 states",
        ),
    ],
)
def test_scenes_that_cannot_be_modelled(load, text, sentence):
    scene = load(text)
    with pytest.raises(InputError, match=sentence) as caught:
        scene.model()
    assert "\n" not in str(caught.value)


def test_scenes_that_are_not_there(tmp_path):
    with pytest.raises(InputError, match="got 'slow_opne'; did you mean 'slow_open'"):
        load_scene("slow_opne")
    with pytest.raises(InputError, match=r"none\.toml: No such file"):
        load_scene(tmp_path / "none.toml")
    with pytest.raises(InputError, match="expected a TOML file"):
        load_scene(tmp_path)
    with pytest.raises(InputError, match=r"expected a built-in scene of .* got 'fast_opn'; did you mean 'fast_open'"):
        scene_text("fast_opn")


def test_settings_are_those_of_the_parts():
    scene = Scene(camera=Camera(width_px=100), saliva=Glue(stickiness=3))
    assert scene.look.seed == 0 and scene.look.skin == scene.skin


def test_the_example_in_the_documentation(tmp_path):
    text = (Path(__file__).parent.parent / "docs" / "scenes.md").read_text(encoding="utf-8")
    (tmp_path / "example.toml").write_text(text.split("```toml\n")[1].split("```")[0], encoding="utf-8")
    scene = load_scene(tmp_path / "example.toml")
    assert scene.face.shape().width_m == 0.054 and scene.skin.tone == "brown"
    _, model = scene.model()
    assert model.saliva.licks[0].time_s == 0.1
    keys = {one.name for part in parts(scene) for one in dataclasses.fields(part)}
    looks = {
        one.name
        for part in (scene.camera, scene.skin, scene.light, scene.inside, scene.sensor)
        for one in dataclasses.fields(part)
    }
    assert not [key for key in keys - looks if not re.search(rf"[`\[.]{key}\b", text)], "every key is explained"


def parts(settings):
    """A dataclass and all in it."""
    yield settings
    for one in dataclasses.fields(settings):
        value = getattr(settings, one.name)
        for inner in value if isinstance(value, tuple) else (value,):
            if dataclasses.is_dataclass(inner):
                yield from parts(inner)


def test_a_whole_number_of_stickiness_is_a_number():
    scene = load_scene("double_opening", 7)
    low = dataclasses.replace(scene, face=dataclasses.replace(scene.face, resolution="low"))
    same = dataclasses.replace(low, saliva=dataclasses.replace(low.saliva, stickiness=7.0))
    assert np.array_equal(low.model()[1].saliva.strength, same.model()[1].saliva.strength)
