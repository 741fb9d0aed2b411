import dataclasses
from collections import Counter

import numpy as np
import pytest
from moved_mouth import moved_mouth

from lipmetrics.accuracy import load_truth
from simulator import suite as suites
from simulator.errors import InputError
from simulator.faces import FACES
from simulator.look import CLEAN, Inside
from simulator.motion import Stop
from simulator.polygons import mask
from simulator.suite import (
    AXES,
    MOVEMENTS,
    NAMED,
    WORST,
    Filming,
    Solved,
    SuiteClip,
    Take,
    by_take,
    changed,
    clip_key,
    film,
    kept_clips,
    solve_take,
    suite,
    write_clip,
)

TAKE = Take("slow_open", "average", FACES["average"], None, 3)
DARK = Filming(
    mouth_px=60.0,
    picture_mw=(2.0, 1.6),
    inside=Inside(upper_teeth=False, lower_teeth=False, tongue=False),
    sensor=CLEAN,
)


def solved_by_formula(frames: int = 12) -> Solved:
    """A mouth that is moved by formula, as if it had been solved."""
    scene = dataclasses.replace(TAKE.scene(), duration_s=(frames - 1) / suites.RATE_HZ)
    mouth, motion = moved_mouth("low", frames)
    return Solved(scene, mouth, dataclasses.replace(motion, time_s=scene.state_times_s))


def clip_of(filming: Filming, axis: str = "plain", setting: str = "plain") -> SuiteClip:
    return SuiteClip("tune", axis, setting, TAKE, filming)


# -- which clips there are --------------------------------------------------------------------------------------------


def test_the_two_parts_have_no_face_in_common():
    assert not set(NAMED["tune"]) & set(NAMED["report"])
    assert set(NAMED["tune"]) | set(NAMED["report"]) == set(FACES)
    shapes = [{clip.take.shape for clip in suite(part)} for part in ("tune", "report")]
    assert not shapes[0] & shapes[1] and min(map(len, shapes)) > 100
    seeds = [{clip.take.seed for clip in suite(part)} for part in ("tune", "report")]
    assert not seeds[0] & seeds[1]


def test_random_faces_of_a_part_are_between_its_own_named_ones():
    for part, named in NAMED.items():
        widths = [FACES[name].width_m for name in named]
        random = {clip.take.shape.width_m for clip in suite(part) if clip.take.face.startswith("random")}
        assert 0.9 * min(widths) <= min(random) and max(random) <= 1.1 * max(widths)


def test_the_same_part_is_the_same_clips_with_names_of_their_own():
    once, again = suite("report"), suite("report")
    assert once == again
    assert max(Counter(clip.name for clip in once).values()) == 1
    assert max(Counter(clip.fingerprint for clip in once if clip.axis in ("mix", *AXES)).values()) == 1
    other = suite("report", seed=1)
    assert {clip.condition for clip in other} == {clip.condition for clip in once}
    assert not {clip.take.shape for clip in other if clip.axis == "mix"} & {clip.take.shape for clip in once}


def test_every_setting_films_the_same_movements_and_differs_from_plain():
    clips = suite("tune")
    plain = {clip.take for clip in clips if clip.axis == "plain"}
    for axis, settings in AXES.items():
        for setting, changes in settings.items():
            here = [clip for clip in clips if (clip.axis, clip.setting) == (axis, setting)]
            assert len({clip.take for clip in here}) == len(here) == 6 and {clip.take for clip in here} <= plain
            assert {clip.filming for clip in here} == {changed(Filming(), changes)} or not changes
            is_the_default = setting == "light medium"
            assert (here[0].filming == Filming()) == is_the_default, setting
    assert all(clip.filming == Filming() for clip in clips if clip.axis in MOVEMENTS)
    assert len({clip.filming for clip in clips if clip.axis == "mix"}) == suites.MIX


def test_the_worst_settings_are_settings():
    assert set(WORST) == set(AXES)
    assert all(setting in AXES[axis] for axis, settings in WORST.items() for setting in settings)


def test_the_quick_suite_is_a_tenth_and_has_every_worst_setting():
    whole, quick = suite("report"), suite("report", quick=True)
    assert set(quick) <= set(whole) and 0.05 < len(quick) / len(whole) < 0.15
    kept = {(clip.axis, clip.setting) for clip in quick}
    assert {(axis, one) for axis, settings in WORST.items() for one in settings} <= kept


def test_only_some_conditions():
    chosen = suite("report", only=["noise", "blur: 3 px"])
    assert {clip.condition for clip in chosen} == {"noise: 3 %", "noise: 6 %", "noise: 12 %", "blur: 3 px"}
    assert len(by_take(chosen)) == 6


@pytest.mark.parametrize(
    "how, sentence",
    [
        ({"part": "reprot"}, "expected a part of .*report.*did you mean 'report'"),
        ({"only": ["noize"]}, "did you mean 'noise'"),
        ({"seed": -1}, "expected a seed of 0 or more, got -1"),
        ({"seed": 0.5}, "expected a seed of 0 or more, got 0.5"),
    ],
)
def test_what_cannot_be_asked_for(how, sentence):
    with pytest.raises(InputError, match=sentence):
        suite(**how)


def test_names_of_files_follow_settings_and_code(monkeypatch):
    one, other = clip_of(Filming()), clip_of(Filming(crf=19))
    assert one.fingerprint == clip_of(Filming()).fingerprint != other.fingerprint
    before = clip_key(one)
    assert before != clip_key(other)
    monkeypatch.setattr(suites, "_code", lambda: "changed")
    assert clip_key(one) != before


# -- films ------------------------------------------------------------------------------------------------------------


def test_places_along_the_lips_go_with_the_width_of_the_mouth():
    wide, child = (dataclasses.replace(TAKE, action="double_opening", shape=FACES[name]) for name in ("wide", "child"))
    of_wide, of_child = (take.scene().saliva.patch[0].to_m for take in (wide, child))
    assert of_wide / of_child == pytest.approx(FACES["wide"].width_m / FACES["child"].width_m)
    three = dataclasses.replace(TAKE, action="three_openings").scene().saliva.patch
    assert [patch.from_m < 0 for patch in three] == [True, False]


@pytest.mark.parametrize("filming", [Filming(mouth_px=60.0), Filming(mouth_px=140.0, picture_mw=(1.5, 1.2))])
def test_the_mouth_is_as_wide_in_the_picture_as_asked_for(filming):
    filmed = film(clip_of(filming), solved_by_formula(3))
    pictures = list(filmed.pictures)
    assert filmed.truth.meta["mouth_width_px"] == pytest.approx(filming.mouth_px, rel=0.03)
    wanted = [size * filming.mouth_px for size in filming.picture_mw[::-1]]
    assert pictures[0].shape[:2] == pytest.approx(wanted, abs=1.01)
    assert len(pictures) == 3 and pictures[0].shape[0] % 2 == pictures[0].shape[1] % 2 == 0


def test_a_shifted_mouth_is_right_of_and_below_the_middle():
    filmed = film(clip_of(dataclasses.replace(DARK, shift_mw=(0.4, 0.2))), solved_by_formula(3))
    middle = (np.array(filmed.truth.shape) - 1) / 2
    away = filmed.truth.corners.mean(axis=0) - middle
    assert away == pytest.approx([0.2 * 60, 0.4 * 60], abs=2.5)


def test_the_truth_of_a_swaying_mouth_sways_with_the_picture():
    filmed = film(clip_of(dataclasses.replace(DARK, drift_mw=0.4)), solved_by_formula(12))
    assert np.ptp(np.array(filmed.truth.meta["drift_px"]), axis=0).min() > 8
    rows = filmed.truth.openings.set_index("frame")
    for frame, picture in enumerate(filmed.pictures):
        polygons = filmed.truth.polygons[frame]
        if frame < 6:
            continue  # hardly open yet
        inside = mask(polygons, picture.shape[:2])
        assert picture[inside].mean() < 60 < 100 < picture[~inside].mean()
        assert rows.loc[frame, "row_min"] == pytest.approx(polygons[0][:, 0].min(), abs=1e-3)
        assert rows.loc[frame, "col_max"] == pytest.approx(polygons[0][:, 1].max(), abs=1e-3)


def test_a_clip_is_written_with_its_truth(tmp_path):
    path = write_clip(clip_of(DARK), solved_by_formula(4), tmp_path, "clip")
    assert path == tmp_path / "clip.mp4"
    known = load_truth(tmp_path / "clip")
    assert len(known.frames) == 4 and known.meta["drift_px"] == [[0, 0]] * 4
    endings = [".frames.csv", ".json", ".mp4", ".openings.csv", ".polygons.json"]
    assert sorted(one.name.removeprefix("clip") for one in tmp_path.iterdir()) == endings


def test_clips_that_are_kept_are_not_made_again_and_a_movement_is_solved_once(tmp_path, monkeypatch, capsys):
    solved = []

    def solve(take):
        solved.append(take.action)
        return solved_by_formula(3) if take is TAKE else Solved(take.scene(), dropped="energy growth")

    monkeypatch.setattr(suites, "solve_take", solve)
    one, other = clip_of(DARK), clip_of(dataclasses.replace(DARK, mouth_px=40.0))
    lost = dataclasses.replace(one, take=dataclasses.replace(TAKE, action="p"))
    made = list(kept_clips([one, lost, other], tmp_path / "kept"))
    assert [clip for clip, _ in made] == [one, other] and solved == ["slow_open", "p"]
    assert "dropped, energy growth" in capsys.readouterr().out
    assert all(path.name == f"{clip_key(clip)}.mp4" and path.exists() for clip, path in made)
    made[1][1].unlink()
    assert list(kept_clips([one, other], tmp_path / "kept")) == made and solved == ["slow_open", "p", "slow_open"]
    assert list(kept_clips([one, other], tmp_path / "kept")) == made and len(solved) == 3


def test_a_movement_that_blows_up_is_tried_again_with_smaller_steps(monkeypatch):
    tried = []

    def simulate(scene, **how):
        tried.append(scene.solve.safety)
        motion = solved_by_formula(3).motion
        stop = Stop(0.1, 3, "energy growth", "smaller steps") if scene.solve.safety > stable else None
        return dataclasses.replace(motion, stopped=stop)

    monkeypatch.setattr(suites, "simulate", simulate)
    stable = 0.7
    solved = solve_take(TAKE)
    assert tried == [0.9, 0.6] and solved.motion is not None and not solved.dropped
    stable = 0.1
    solved = solve_take(TAKE)
    assert tried[2:] == [0.9, 0.6, 0.4] and solved.motion is None and "energy growth" in solved.dropped
    with pytest.raises(InputError, match="expected a movement that could be solved, got slow_open-average"):
        film(clip_of(Filming()), solved)


def test_the_truth_begins_with_the_video():
    clip = clip_of(DARK)
    later = dataclasses.replace(clip, take=dataclasses.replace(clip.take, action="double_opening"))
    start_s = later.take.span_s[0]
    solved = solved_by_formula(12)
    filmed = film(later, solved)
    times = solved.scene.frame_times_s
    assert start_s > 0 and filmed.truth.frames["time_s"].iloc[0] == 0
    assert np.diff(filmed.truth.frames["time_s"]) == pytest.approx(np.diff(times[times >= start_s - 1e-9]), abs=2e-6)
    first = filmed.truth.openings.groupby("frame")["time_s"].first()
    assert (first == filmed.truth.frames["time_s"][first.index].to_numpy()).all()
