"""What sticky mouths do, as the thesis found it (5.3.3, 5.3.4, chapter 4), on the truth of the built-in scenes."""

import dataclasses
import itertools
import sys
from pathlib import Path

import numpy as np
import pytest

from simulator import events
from simulator.scene import scene_names

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import findings
from findings import LEVELS, clip, overshoot, profile

pytestmark = pytest.mark.slow


def times(found):
    return found.frames["time_s"].to_numpy()


def rising(values, least=0.0):
    return all(after > before + least for before, after in itertools.pairwise(values))


def first_time(found, size, value):
    """When a size first reaches a value, s; inf if never."""
    there = profile(found, size) >= value
    return times(found)[np.argmax(there)] if there.any() else np.inf


def test_without_stickiness_the_width_is_there_at_once_and_narrows_as_the_mouth_rounds():
    found = clip("slow_open", 0)
    width = profile(found, "width_mw")
    assert first_time(found, "width_mw", 0.95 * width.max()) - events.onset_s(found) < 0.06
    assert width.max() > 0.97
    assert width[-1] < width.max() - 0.04


def test_stickiness_delays_the_opening_and_slows_its_widening():
    clips = [clip("slow_open", level) for level in LEVELS]
    assert rising([events.onset_s(one) for one in clips])
    assert rising([first_time(one, "width_mw", 0.7) - events.onset_s(one) for one in clips], 0.02)


@pytest.mark.parametrize("level", [4, 7, 10])
def test_the_lips_unzip_from_the_middle_outwards(level):
    found = clip("slow_open", level)
    left, right = events.corners_mw(found).T
    open_now = np.isfinite(left)
    assert np.abs(left + right)[open_now].max() < 1e-3
    begins = np.argmax(open_now)
    assert right[begins] < 0.2
    widening = slice(begins, begins + 12)
    assert rising(right[widening]) and rising(-left[widening])
    assert first_time(found, "width_mw", 0.6) - events.onset_s(found) > 0.04


def test_at_the_highest_level_area_and_height_start_slowly():
    free, stuck = clip("slow_open", 0), clip("slow_open", 10)
    early = np.searchsorted(times(free), 0.3)
    assert profile(stuck, "height_mw")[early] < 0.6 * profile(free, "height_mw")[early]
    assert profile(stuck, "area_mw2")[early] < 0.3 * profile(free, "area_mw2")[early]
    assert profile(stuck, "height_mw")[-1] > 0.95 * profile(free, "height_mw")[-1]


def test_at_the_highest_level_the_corners_are_still_stuck_at_the_end():
    free, stuck = clip("slow_open", 0), clip("slow_open", 10)
    assert profile(stuck, "width_mw")[-1] < profile(free, "width_mw")[-1] - 0.05
    last = stuck.saliva[stuck.saliva["frame"] == stuck.saliva["frame"].max()]
    assert (last["state"] == "intact").to_numpy()[[0, -1]].all()
    assert not (clip("slow_open", 4).saliva["state"] == "intact").to_numpy()[-60:].any()


def spread(name):
    """How far apart the areas at levels 4 and 7 are from that at 0, over the area at the end, summed over time, s.

    Not level 10, whose stuck corners make the same difference at any speed.
    """
    areas = [profile(clip(name, level), "area_mw2") for level in LEVELS[:3]]
    step = times(clip(name, 0))[1]
    return np.abs(np.array(areas[1:]) - areas[0]).sum() * step / areas[0][-1]


def test_fast_opening_keeps_the_order_but_differs_less():
    clips = [clip("fast_open", level) for level in LEVELS]
    assert rising([first_time(one, "width_mw", 0.7) for one in clips])
    assert spread("fast_open") < 0.75 * spread("slow_open")
    delays = [[events.onset_s(clip(name, level)) for level in (0, 10)] for name in ("slow_open", "fast_open")]
    assert delays[1][1] - delays[1][0] < 0.5 * (delays[0][1] - delays[0][0])


def test_m_peaks_and_settles_at_low_levels_and_comes_from_below_at_the_highest():
    over = [overshoot(clip("m", level)) for level in LEVELS]
    assert min(over[:2]) > 0.025
    assert over[3] < 0.5 * over[0]
    height = profile(clip("m", 10), "height_mw")
    t = times(clip("m", 10))
    assert height[(t > 0.33) & (t < 0.45)].mean() < height[-1]
    low = profile(clip("m", 0), "height_mw")
    assert low[(t > 0.33) & (t < 0.45)].mean() > low[-1]


def test_p_is_alike_at_all_levels_with_a_peak_a_little_lower_the_higher_the_level():
    peaks = [profile(clip("p", level), "height_mw").max() for level in LEVELS]
    ends = [profile(clip("p", level), "height_mw")[-1] for level in LEVELS]
    onset = [events.onset_s(clip("p", level)) for level in LEVELS]
    assert rising(-np.array(peaks))
    assert np.ptp(ends) < 0.08 * max(ends)
    assert np.ptp(onset) < 0.02
    assert all(overshoot(clip("p", level)) > overshoot(clip("m", level)) for level in LEVELS)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("name", ["mummy", "puppy"])
def test_words_open_twice(name, level):
    spells = events.spells_s(clip(name, level))
    assert len(spells) == 2
    assert spells[1][0] - spells[0][1] > 0.15


@pytest.mark.parametrize("level", LEVELS)
def test_the_second_peak_of_puppy_stands_higher_over_its_settled_height(level):
    assert overshoot(clip("puppy", level), 0.8) > overshoot(clip("mummy", level), 0.8) + 0.03


def test_a_stickier_place_makes_two_openings_that_merge_with_a_jump_in_width():
    found = clip("double_opening")
    counts = found.frames["n_openings"].to_numpy(int)
    both = np.flatnonzero(counts == 2)
    merge = events.merges_s(found)
    width, t = profile(found, "width_mw"), times(found)
    assert len(both) >= 4 and counts.max() == 2
    assert len(merge) == 1
    at = np.searchsorted(t, merge[0])
    assert width[at] - width[at - 1] > 0.15
    jumps = np.diff(width)
    assert jumps[both[0] : both[-1]].max() < 0.5 * (width[at] - width[at - 1])


def test_one_sided_openings_lie_off_the_centre_and_mirror_one_another():
    left, right = clip("one_sided_left"), clip("one_sided_right")
    assert events.centre_offset_mw(left) == pytest.approx(-0.09, abs=0.03)
    assert events.centre_offset_mw(right) == pytest.approx(-events.centre_offset_mw(left), abs=2e-3)
    assert np.abs(profile(left, "width_mw") - profile(right, "width_mw")).max() < 5e-3


@pytest.mark.parametrize("name", ["slow_open", "drying"])
def test_symmetric_scenes_stay_symmetric_when_they_are_solved_whole(name):
    one = findings.scene(name, None, "low")
    one = dataclasses.replace(
        one, duration_s=min(one.duration_s, 1.0), solve=dataclasses.replace(one.solve, symmetric=False)
    )
    mouth, model = one.model()
    motion = findings.simulate(one, parts=(mouth, model))
    x = mouth.nodes * [-1, 1, 1]
    partner = np.lexsort(np.round(mouth.nodes, 9).T)
    image = np.lexsort(np.round(x, 9).T)
    gap = np.abs(motion.positions[:, partner] - motion.positions[:, image] * [-1, 1, 1])
    assert gap.max() < 1e-4 * mouth.width_m
    assert np.array_equal(motion.saliva.state, motion.saliva.state[:, ::-1])


def test_drying_lips_open_earlier_each_time_as_the_formulas_say():
    one = findings.scene("drying", None, "low")
    one = dataclasses.replace(one, output=dataclasses.replace(one.output, frame_rate=300.0))
    mouth, model = one.model()
    found = findings.truth(findings.simulate(one, parts=(mouth, model)), mouth, one.camera)
    starts = [begin for begin, _ in events.spells_s(found)]
    delays = np.array(starts) - [0.05, 1.25, 2.45]  # when the jaw begins to sink
    assert len(starts) == 3 and rising(-delays, 0.005)
    saliva = found.saliva
    middle = saliva[np.abs(saliva["x_m"] - saliva["x_m"].abs().min()) < 1e-9]
    t = middle["time_s"].to_numpy()
    moisture = np.maximum(0, 1 - 0.25 * t)  # eq. 3.66
    assert middle["moisture"].to_numpy() == pytest.approx(moisture, abs=1e-9)
    strength = middle["critical"].iloc[0] - 1
    assert middle["critical"].to_numpy() == pytest.approx(1 + strength * moisture, abs=1e-9)  # eq. 3.67
    glued = (middle["state"] == "intact").to_numpy()
    assert (middle["stretch"].to_numpy()[glued] ** 2 <= middle["critical"].to_numpy()[glued] + 1e-9).all()


def test_the_side_that_dries_faster_opens_farther():
    found = clip("uneven_drying")
    offsets = [events.centre_offset_mw(found, (begin + end) / 2) for begin, end in events.spells_s(found)]
    assert abs(offsets[0]) < 0.01
    assert min(offsets[1:]) > 0.02


def test_the_same_scene_twice_is_the_same_to_the_last_bit():
    first, second = (findings.moved("p", 7, "low") for _ in range(2))
    assert first[0].positions.tobytes() == second[0].positions.tobytes()
    assert first[0].saliva.state.tobytes() == second[0].saliva.state.tobytes()
    assert first[1].frames.to_csv() == second[1].frames.to_csv()


@pytest.mark.parametrize(
    ("name", "mesh"),
    [*((name, "low") for name in scene_names() if name != "demo"), *((n, "medium") for n in ("demo", "mummy", "p"))],
)
def test_half_the_time_step_changes_no_frame_by_a_hundredth_of_the_mouth(name, mesh):
    whole, half = clip(name, None, mesh), clip(name, None, mesh, 0.45)
    for size in ("width_mw", "height_mw", "area_mw2"):
        assert np.abs(profile(whole, size) - profile(half, size)).max() < 0.01


def test_the_medium_mesh_is_near_the_high_one():
    medium, high = clip("slow_open", 7), clip("slow_open", 7, "high")
    assert np.abs(profile(medium, "height_mw") - profile(high, "height_mw")).mean() < 0.005
    assert np.abs(profile(medium, "width_mw") - profile(high, "width_mw")).mean() < 0.02


def test_glue_that_is_strong_enough_holds():
    found = clip("glued_shut", None, "low")
    assert (found.frames["status"] == "closed").all()
    assert (found.saliva["state"] == "intact").all()


@pytest.mark.parametrize("name", ["p", "puppy"])
def test_pressed_lips_do_not_pass_through_each_other(name):
    motion, _ = findings.moved(name, 7, "low")
    mouth = findings.scene(name, 7, "low").face.mouth()
    height = np.linalg.norm(motion.positions[:, mouth.upper] - motion.positions[:, mouth.lower], axis=-1)
    rest = np.linalg.norm(mouth.nodes[mouth.upper] - mouth.nodes[mouth.lower], axis=-1)
    upright = motion.positions[:, mouth.upper, 1] > motion.positions[:, mouth.lower, 1]
    assert upright.all()
    assert (rest - height).max() < 0.05 * mouth.shape.thickness_m
    assert motion.saliva.stretch.min() < 1  # they are pressed
