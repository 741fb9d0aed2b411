import math

import numpy as np
import pandas as pd
import pytest

from lipmetrics.errors import InputError
from lipmetrics.metrics import METRICS, sticky
from lipmetrics.take import OPENING_COLUMNS, Take


def take_of(time_s, frames, unknown=(), scale=1.0):
    """A take of the openings of each frame: (identity, left, right, height) and perhaps event and parents.

    The area is that of a parabola, 2/3 of width times height, its centre in the middle.
    """
    rows, sizes = [], []
    for k, (t, openings) in enumerate(zip(time_s, frames, strict=True)):
        for number, left, right, height, *rest in openings:
            middle, sizes_of = (left + right) / 2, (left, right, -height / 2, height / 2, right - left, height)
            lengths = [scale * length for length in sizes_of]
            area = scale**2 * (right - left) * height * 2 / 3
            rows.append((t, k, number, *lengths, area, scale * middle, 0.0, *(rest or ("", ""))))
        largest = max(openings, key=lambda o: (o[2] - o[1]) * o[3], default=(0, 0, 0, 0))
        width, height = scale * (largest[2] - largest[1]), scale * largest[3]
        sizes.append([np.nan] * 3 if k in unknown else [width, height, width * height * 2 / 3])
    channels = dict(zip(("width", "height", "area"), np.array(sizes).T, strict=True))
    return Take("made", time_s, channels, "mw", pd.DataFrame(rows, columns=list(OPENING_COLUMNS)))


TIME_S = np.arange(31) / 50


def peeling(left_speed=1.0, right_speed=0.5):
    """Closed at 0 s; from 0.02 s on the ends leave -0.1 and 0.1 and go on to -0.5 and 0.3."""
    gone = np.maximum(TIME_S - 0.02, 0)
    left, right = np.maximum(-0.1 - left_speed * gone, -0.5), np.minimum(0.1 + right_speed * gone, 0.3)
    return [[]] + [[(1, left[k], right[k], 0.1 + 0.2 * TIME_S[k])] for k in range(1, len(TIME_S))]


# Two openings: one left from frame 1 on, one right from frame 3 on, one in all from frame 6 on; 10 frames per second
DOUBLE_TIME_S = np.arange(9) / 10
DOUBLE = [
    [],
    [(1, -0.2, -0.1, 0.05, "new", "")],
    [(1, -0.3, -0.1, 0.05)],
    [(1, -0.3, -0.1, 0.1), (2, 0.1, 0.2, 0.02, "new", "")],
    [(1, -0.4, -0.1, 0.1), (2, 0.1, 0.3, 0.03)],
    [(1, -0.4, -0.1, 0.1), (2, 0.1, 0.3, 0.03)],
    [(1, -0.4, 0.4, 0.2, "merge", "1+2")],
    [(1, -0.4, 0.4, 0.3)],
    [],
]


def test_zip_speeds_of_steady_ends():
    take = take_of(TIME_S, peeling())
    assert sticky.zip_speed_left_v1(take) == pytest.approx(1)
    assert sticky.zip_speed_right_v1(take) == pytest.approx(0.5)
    assert sticky.zip_jump_left_v1(take) == pytest.approx(0.02 / 0.4)
    assert sticky.zip_jump_right_v1(take) == pytest.approx(0.01 / 0.2)


def test_zip_speed_is_taken_between_its_shares():
    """The end creeps for the first tenth of its way, then goes at 1 per s, then creeps for the last tenth."""
    place = np.interp(TIME_S, [0.02, 0.2, 0.44, 0.6], [0.1, 0.14, 0.38, 0.4])
    take = take_of(TIME_S, [[]] + [[(1, -0.1, right, 0.1)] for right in place[1:]])
    assert sticky.zip_speed_right_v1(take) == pytest.approx(1)
    slow = sticky.Settings(zip_from=0.0, zip_to=0.1)
    assert sticky.zip_speed_right_v1(take, slow) == pytest.approx(0.04 / 0.18, rel=0.15)
    assert math.isnan(sticky.zip_speed_left_v1(take))  # stays where it is


def test_a_zip_of_three_steps_by_hand():
    """The right end goes 0.1, 0.2, 0.4, 0.5 in steps of 0.1 s, shares 0, 1/4, 3/4, 1 of its way of 0.4.

    It passes 0.2 at 0.08 s and 0.8 at 0.22 s after the first frame. The slopes of the six pairs of (0.08, 0.2),
    (0.1, 0.25), (0.2, 0.75) and (0.22, 0.8) are 2.5, 55/12, 30/7, 5, 55/12 and 2.5; their median is (30/7 + 55/12) / 2.
    """
    take = take_of(np.arange(5) / 10, [[], *([(1, -0.1, right, 0.1)] for right in (0.1, 0.2, 0.4, 0.5))])
    assert sticky.zip_speed_right_v1(take) == pytest.approx(0.4 * (30 / 7 + 55 / 12) / 2)
    assert sticky.zip_jump_right_v1(take) == pytest.approx(0.5)


def test_a_wrong_frame_hardly_changes_a_zip_speed():
    frames = peeling()
    frames[4] = [(1, -0.5, 0.1, 0.12)]
    assert sticky.zip_speed_left_v1(take_of(TIME_S, frames)) == pytest.approx(1, rel=0.03)
    assert sticky.zip_speed_right_v1(take_of(TIME_S, frames)) == pytest.approx(0.5, rel=0.03)


def test_an_end_that_jumps_open_has_no_speed():
    frames = [[], [(1, -0.1, 0.1, 0.1)], [(1, -0.1, 0.1, 0.1)], *[[(1, -0.5, 0.13, 0.2)]] * 3]
    take = take_of(np.arange(6) / 25, frames)
    assert math.isnan(sticky.zip_speed_left_v1(take))
    assert sticky.zip_jump_left_v1(take) == pytest.approx(1)
    assert math.isnan(sticky.zip_speed_right_v1(take))  # its way is under a tenth of the width
    assert math.isnan(sticky.zip_jump_right_v1(take))


def test_a_beginning_that_was_not_seen():
    take = take_of(TIME_S[:-1], peeling()[1:])
    for name in ("zip_speed_left", "zip_jump_right", "corner_delay_left", "corner_delay_right", "onset_asymmetry"):
        assert math.isnan(sticky.evaluate(take)[f"{name}_v1"]), name


def test_the_stroke_ends_where_the_mouth_closes_again():
    """After the peak the mouth closes half and opens wider, as in speech: that is not part of the first zip."""
    frames = peeling()
    later = [[(1, -0.3, 0.2, 0.05)], [(1, -0.9, 0.9, 0.1)]]
    take = take_of(np.arange(33) / 50, frames + later)
    assert sticky.zip_speed_left_v1(take) == pytest.approx(1)


def test_the_main_opening_is_the_highest_one():
    small = [[], [(7, -0.05, 0.05, 0.01)], []]
    take = take_of(np.arange(34) / 50, small + peeling())
    assert sticky.zip_speed_left_v1(take) == pytest.approx(1)
    opened = sticky.validate(take)
    assert (opened.main[0], opened.main[-1]) == (4, 33)
    assert sticky.validate(opened) is opened  # brought into frames once


def test_unknown_frames_do_not_end_an_opening():
    frames = peeling()
    frames[10] = []
    take = take_of(TIME_S, frames, unknown=(10,))
    assert len(sticky.validate(take).main) == 29
    assert sticky.zip_speed_left_v1(take) == pytest.approx(1)
    assert np.isnan(sticky.openings_over_time(take)[10])
    unseen = take_of(TIME_S, frames, unknown=(0, 10))
    assert math.isnan(sticky.zip_speed_left_v1(unseen))  # not known to be closed before


def test_two_openings_that_merge():
    take = take_of(DOUBLE_TIME_S, DOUBLE)
    np.testing.assert_array_equal(sticky.openings_over_time(take), [0, 1, 1, 2, 2, 2, 1, 1, 0])
    assert sticky.most_openings_v1(take) == 2
    assert sticky.several_share_v1(take) == pytest.approx(3 / 7)
    assert sticky.merges_v1(take) == 1 and sticky.splits_v1(take) == 0
    assert sticky.merge_time_v1(take) == pytest.approx(0.5)
    assert sticky.merge_jump_v1(take) == pytest.approx(0.8 - 0.3)
    found = sticky.events(take)
    assert found[["event", "opening", "parents"]].to_numpy().tolist() == [["merge", 1, "1+2"]]
    assert found.loc[0, ["time_s", "width", "width_before", "jump"]].tolist() == pytest.approx([0.6, 0.8, 0.3, 0.5])


def test_shares_of_time_are_not_shares_of_frames():
    uneven = DOUBLE_TIME_S.copy()
    uneven[6:] += 0.7  # the last frame with two openings lasts longer
    assert sticky.several_share_v1(take_of(uneven, DOUBLE)) == pytest.approx((0.3 + 0.35) / (0.7 + 0.7))


def test_three_that_become_one_and_one_that_splits():
    parts = [(1, -0.4, -0.2, 0.1), (2, -0.1, 0.1, 0.1), (3, 0.2, 0.4, 0.1)]
    split = [(1, -0.4, 0.1, 0.1), (4, 0.3, 0.4, 0.1, "split", "1")]
    take = take_of(np.arange(4) / 10, [[], parts, [(1, -0.4, 0.4, 0.2, "merge", "1+2+3")], split])
    assert sticky.merges_v1(take) == 2 and sticky.splits_v1(take) == 1 and sticky.most_openings_v1(take) == 3
    assert sticky.events(take)["jump"].tolist() == pytest.approx([0.6, -0.7])
    assert sticky.merge_jump_v1(take) == pytest.approx(0.6)  # a split is no merge


def test_corner_delays_by_hand():
    # left: 0.8 of the outermost -0.5 is -0.4, reached 0.3 s after the first frame, which covers the middle; right: 0.24
    take = take_of(TIME_S, peeling())
    assert sticky.corner_delay_left_v1(take) == pytest.approx(0.3)
    assert sticky.corner_delay_right_v1(take) == pytest.approx((0.24 - 0.1) / 0.5)
    # a sticky middle: x = 0 is first covered by the merge, the nearest opening is 0.1 away the frame before
    double = take_of(DOUBLE_TIME_S, DOUBLE)
    covers_middle = 0.5 + 0.1 * 0.1 / (0.1 + 0.4)
    covers_left = 0.3 + 0.1 * (0.32 - 0.3) / (0.4 - 0.3)
    assert sticky.corner_delay_left_v1(double) == pytest.approx(covers_left - covers_middle)
    one_sided = take_of(np.arange(3) / 10, [[], [(1, 0.1, 0.2, 0.1)], [(1, 0.1, 0.3, 0.1)]])
    assert math.isnan(sticky.corner_delay_left_v1(one_sided)) and math.isnan(sticky.corner_delay_right_v1(one_sided))


def test_area_asymmetry_by_hand():
    def of(*openings):
        return sticky.area_asymmetry_v1(take_of([0.0, 0.1], [[], list(openings)]))

    assert of((1, 0.1, 0.3, 0.1)) == 1 and of((1, -0.3, -0.1, 0.1)) == -1
    assert of((1, -0.2, 0.2, 0.1)) == pytest.approx(0)
    # a parabola from -1 to 3: left of 0 it has 3/4 (u - u^3 / 3) + 1/2 at u = -1/2, 5/32 of its area
    assert of((1, -1, 3, 0.1)) == pytest.approx(1 - 2 * 5 / 32)
    # areas 0.2 x 0.1 left and 0.1 x 0.1 right
    assert of((1, -0.4, -0.2, 0.1), (2, 0.2, 0.3, 0.1)) == pytest.approx(-1 / 3)


def test_area_asymmetry_weighs_with_time():
    frames = [[], [(1, 0.1, 0.2, 0.1)], [(1, -0.2, -0.1, 0.1)], []]
    assert sticky.area_asymmetry_v1(take_of([0, 0.1, 0.2, 0.7], frames)) == pytest.approx((0.1 - 0.3) / (0.1 + 0.3))


def test_a_lens_with_its_centre_aside_is_divided_by_its_mean():
    take = take_of([0.0, 0.1], [[], [(1, -0.5, 0.5, 0.1)]])
    take.openings["x"] = 0.1
    u = np.linspace(0, 1, 200001)  # beta with a = 2.4, b = 1.6 on -0.5 .. 0.5
    density = u**1.4 * (1 - u) ** 0.6
    assert (density * (u - 0.5)).sum() / density.sum() == pytest.approx(0.1, abs=1e-6)
    expected = (density[u > 0.5].sum() - density[u < 0.5].sum()) / density.sum()
    assert sticky.area_asymmetry_v1(take) == pytest.approx(expected, abs=1e-4)


def test_onset_asymmetry_by_hand():
    # half of the outermost 0.5 is 0.25: left after (0.25 - 0.1) / 1 s, right after (0.25 - 0.1) / 0.5 s
    assert sticky.onset_asymmetry_v1(take_of(TIME_S, peeling())) == pytest.approx(0.15 - 0.3)


def mirrored(frames):
    return [[(one[0], -one[2], -one[1], *one[3:]) for one in openings] for openings in frames]


@pytest.mark.parametrize("frames", [peeling(), DOUBLE], ids=["peeling", "double"])
def test_in_the_mirror_left_is_right(frames):
    time_s = TIME_S if len(frames) == len(TIME_S) else DOUBLE_TIME_S
    one, other = (sticky.evaluate(take_of(time_s, f)) for f in (frames, mirrored(frames)))
    for name in ("zip_speed", "zip_jump", "corner_delay"):
        assert other[f"{name}_left_v1"] == pytest.approx(one[f"{name}_right_v1"], nan_ok=True)
        assert other[f"{name}_right_v1"] == pytest.approx(one[f"{name}_left_v1"], nan_ok=True)
    assert other["area_asymmetry_v1"] == pytest.approx(-one["area_asymmetry_v1"])
    assert other["onset_asymmetry_v1"] == pytest.approx(-one["onset_asymmetry_v1"], nan_ok=True)
    same = ("several_share_v1", "merge_time_v1", "merge_jump_v1", "width_at_peak_v1")
    assert [other[name] for name in same] == pytest.approx([one[name] for name in same], nan_ok=True)


@pytest.mark.parametrize("frames", [peeling(), DOUBLE], ids=["peeling", "double"])
def test_only_lengths_grow_with_the_unit(frames):
    time_s = TIME_S if len(frames) == len(TIME_S) else DOUBLE_TIME_S
    one, large = (sticky.evaluate(take_of(time_s, frames, scale=scale)) for scale in (1, 240))
    for name, value in one.items():
        factor = 240 if METRICS[name].unit.startswith("mw") else 1
        assert large[name] == pytest.approx(value * factor, rel=1e-9, abs=1e-9, nan_ok=True), name


def test_evaluate_is_every_function_by_itself():
    take = take_of(DOUBLE_TIME_S, DOUBLE)
    rows = [row for row in METRICS.values() if row.family == "sticky"]
    assert sticky.evaluate(take) == pytest.approx({row.name: row.function(take) for row in rows}, nan_ok=True)
    assert sticky.width_at_peak_v1(take) == pytest.approx(0.8)


def test_a_mouth_that_never_opens():
    scores = sticky.evaluate(take_of([0, 0.1], [[], []]))
    zero = ("several_share_v1", "most_openings_v1", "merges_v1", "splits_v1", "merge_jump_v1", "width_at_peak_v1")
    assert {name for name, value in scores.items() if value == 0} == set(zero)
    assert all(math.isnan(value) for name, value in scores.items() if name not in zero)
    assert sticky.events(take_of([0, 0.1], [[], []])).empty


def test_bad_input_is_named():
    take = take_of(DOUBLE_TIME_S, DOUBLE)
    blind = Take("marks", take.time_s, take.channels, source="openface")
    with pytest.raises(InputError, match="marks: expected a take that knows its openings one by one"):
        sticky.evaluate(blind)
    assert sticky.width_at_peak_v1(blind) == pytest.approx(0.8)  # needs no openings
    with pytest.raises(InputError, match="missing left, parents"):
        sticky.merges_v1(
            Take("made", take.time_s, take.channels, openings=take.openings.drop(columns=["left", "parents"]))
        )
    with pytest.raises(InputError, match=r"got one at 0\.3 s, no frame"):
        sticky.merges_v1(Take("made", take.time_s + (take.time_s > 0.25) * 0.01, take.channels, openings=take.openings))
    with pytest.raises(InputError, match="expected a take, got list"):
        sticky.events([take])
    with pytest.raises(InputError, match="zip_from < zip_to"):
        sticky.Settings(zip_from=0.9)
    with pytest.raises(InputError, match="corner_share above 0"):
        sticky.Settings(corner_share=0)


@pytest.mark.slow
def test_simulated_mouths(tmp_path):
    """What is known from how they were made: lips that stick more peel more slowly, and which side sticks."""
    simulator = pytest.importorskip("simulator.scene")
    from dataclasses import replace

    from lipmetrics.takes import read_take
    from simulator.simulate import simulate
    from simulator.truth import truth

    def filmed(name, stickiness=None):
        scene = simulator.load_scene(name, stickiness=stickiness)
        scene = replace(scene, face=replace(scene.face, resolution="low"))
        mouth, model = scene.model()
        stem = f"{name}_{stickiness}"
        motion = simulate(scene, parts=(mouth, model), threads=1)
        truth(motion, mouth, scene.camera, scene.frame_times_s).save(tmp_path, stem)
        return sticky.evaluate(read_take(tmp_path / stem))

    loose, stuck = filmed("slow_open", 0), filmed("slow_open", 7)
    for side in ("left", "right"):
        assert loose[f"zip_speed_{side}_v1"] > 3 * stuck[f"zip_speed_{side}_v1"] > 1
        assert loose[f"corner_delay_{side}_v1"] < 0.05 < 0.15 < stuck[f"corner_delay_{side}_v1"]
    assert abs(stuck["area_asymmetry_v1"]) < 0.01 and stuck["most_openings_v1"] == 1

    double = filmed("double_opening")
    assert double["most_openings_v1"] == 2 and double["merges_v1"] == 1
    assert double["merge_jump_v1"] > 0.2 and double["several_share_v1"] > 0.1

    left = filmed("one_sided_left")
    assert left["area_asymmetry_v1"] < -0.3 and left["onset_asymmetry_v1"] < -0.1
