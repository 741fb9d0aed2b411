"""What docs/validation.md says of comparison: a sticky model is nearer to a sticky mouth, a clip is near to itself."""

import itertools
import sys
from pathlib import Path

import numpy as np
import pytest

from lipmetrics.take import Take

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import likeness
import recognition
import reference
import utterances

needs_data = pytest.mark.skipif(
    reference.reference_folder() is None,
    reason="reference data absent; set LIPMETRICS_REFERENCE or put them in ../shared/reference",
)
SCENES = likeness.SCENES


@pytest.fixture(autouse=True)
def no_cache(monkeypatch):
    monkeypatch.delenv("LIPMETRICS_BENCHMARK_CACHE", raising=False)


def truths(scene, who):
    """The hidden mouth and both models from their truth, low mesh."""
    real = utterances.truth_take(likeness.hidden_scene(scene, who, "low"), "real")
    return real, likeness.model_takes(scene, who, real, "low")


@pytest.fixture(scope="module")
def older():
    return {scene: truths(scene, likeness.HIDDEN["older"]) for scene in SCENES}


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_sticky_model_is_nearer_in_width(older, scene):
    width = likeness.likeness(*older[scene]).loc["width"]
    assert (width["sticky"] < 0.7 * width["non-sticky"]).all(), width


@pytest.mark.slow
def test_width_jumps_where_two_openings_merge(older):
    real, models = older["double_opening"]
    for take in (real, models["sticky"]):
        _, before, after = likeness.merge_jump(take)
        assert after > before + 0.2
    assert likeness.merge_jump(models["non-sticky"]) is None


@pytest.mark.slow
def test_models_end_at_the_height_of_the_recording(older):
    for real, models in older.values():
        assert models["non-sticky"].channels["height"][-1] == pytest.approx(real.channels["height"][-1], abs=0.01)


def take(height, rate_hz=25.0, **channels):
    height = np.asarray(height, float)
    return Take("a", np.arange(len(height)) / rate_hz, {"width": height, "height": height, "area": height} | channels)


def test_jump_of_a_merge_worked_out_by_hand():
    width = np.array([0, 0.2, 0.3, 0.35, 0.7, 0.75, 0.8])
    count = np.array([0, 1, 2, 2, 1, 1, 1])
    found = likeness.merge_jump(take(width, width=width, n_openings=count))
    assert found == pytest.approx((4 / 25, 0.3, 0.75))
    assert likeness.merge_jump(take(width, width=width, n_openings=np.minimum(count, 1))) is None


def test_noise_leaves_closed_frames_closed_and_follows_the_seed():
    clean = take([0, 0, 0.2, 0.3, 0.3, 0.0])
    one, again, other = (utterances.noisy(clean, utterances.seeded("noise", seed)) for seed in (1, 1, 2))
    assert (one.channels["height"][[0, 1, 5]] == 0).all()
    assert np.array_equal(one.channels["height"], again.channels["height"])
    assert not np.array_equal(one.channels["height"], other.channels["height"])
    assert one.channels["height"][2:5] == pytest.approx(clean.channels["height"][2:5], abs=0.06)


def test_a_repeat_is_the_same_movement_at_another_pace():
    whole = take(np.sin(np.linspace(0, 3, 200)) ** 2, rate_hz=50)
    piece = utterances.cut(whole, 1.0, 3.0)
    found = utterances.repeated(piece, whole, utterances.seeded("pace", 4))
    assert found.duration_s != pytest.approx(piece.duration_s, abs=0.01)
    assert np.diff(found.channels["height"]).min() < 0 < np.diff(found.channels["height"]).max()
    assert found.channels["height"].max() == pytest.approx(piece.channels["height"].max(), abs=1e-3)
    ramp = take(np.linspace(0, 1, 200), rate_hz=50)
    rising = utterances.repeated(utterances.cut(ramp, 1.0, 3.0), ramp, utterances.seeded("pace", 4)).channels["height"]
    assert (np.diff(rising) > 0).all()
    assert rising[[0, -1]] == pytest.approx([1 / 3.98, 2.98 / 3.98], abs=0.04)


def test_same_names_give_the_same_scene_and_others_another():
    one, again, other = (utterances.varied("mummy", 7.0, "wide", repeat) for repeat in (0, 0, 1))
    assert one == again
    assert one.duration_s != other.duration_s
    assert one.muscle[0].keys != other.muscle[0].keys
    for action in one.muscle:
        times = [key[0] for key in action.keys if not isinstance(key, str)]
        assert (np.diff(times) > 0).all()


@pytest.mark.parametrize(
    ("change", "frames", "last_s", "size"),
    [
        (likeness.Change(), 26, 1.0, (32, 48)),
        (likeness.Change(tempo=1.25, keep_frames=True), 26, 1.25, (32, 48)),
        (likeness.Change(tempo=0.8), 21, 0.8, (32, 48)),
        (likeness.Change(rate=0.4), 11, 1.0, (32, 48)),
        (likeness.Change(size=0.5), 26, 1.0, (16, 24)),
    ],
)
def test_changed_clips_have_the_times_and_sizes_they_should(tmp_path, change, frames, last_s, size):
    clip = [(k / 25, np.full((32, 48, 3), 9 * k, np.uint8)) for k in range(26)]
    likeness.changed(clip, change, tmp_path / "a.mkv")
    found = likeness.pictures_of(tmp_path / "a.mkv")
    assert len(found) == frames
    assert found[-1][0] - found[0][0] == pytest.approx(last_s, abs=2e-3)
    assert found[0][1].shape[:2] == size
    first_at = {time: picture[0, 0, 0] / 9 / 25 for time, picture in found}
    for time, original_s in first_at.items():
        assert original_s == pytest.approx(time / last_s, abs=0.05)


def test_folds_keep_faces_apart():
    taken = [
        utterances.Spoken("m", 0.0, face, 0, take([0, 1]))
        for face in (*utterances.TUNE_FACES, *utterances.REPORT_FACES)
    ]
    for part, count in (("tune", 6), ("report", 1)):
        folds = recognition.folds(taken, part)
        assert len(folds) == count
        for training, queries in folds:
            assert queries
            assert not {one.face for one in training} & {one.face for one in queries}
            assert {one.face for one in training} <= set(utterances.TUNE_FACES)


def test_recognition_has_the_chosen_band():
    bump = np.exp(-(np.linspace(-3, 3, 100) ** 2))
    late = take(np.roll(bump, 8))
    averages = {"a": take(bump)}
    default = recognition.classify_all([late], averages)[0].distances
    chosen, wide = (recognition.classify_all([late], averages, band=band)[0].distances for band in (0.02, 0.1))
    assert default == chosen
    assert default > wide


def test_chosen_band_is_the_widest_within_a_standard_error_of_the_best():
    rates = {
        (source, utterances.CHANNELS, "dtw"): recognition._wide(
            {("absolute", band): rate for band, rate in zip(("none", "0", "0.05", "0.1"), values, strict=True)}
        )
        for source, values in {"simulated": (0.5, 0.62, 0.61, 0.6), "real": (0.3, 0.60, 0.58, 0.5)}.items()
    }
    # best mean 0.61; standard error sqrt(0.62 0.38 / 300 + 0.6 0.4 / 300) / 2 = 0.020; means 0.595 and 0.55 beyond
    assert recognition.chosen_band(rates, {"simulated": 300, "real": 300})[0] == "0.05"
    assert recognition.chosen_band(rates, {"simulated": 30000, "real": 30000})[0] == "0"


@pytest.mark.slow
def test_utterances_of_unseen_faces_are_recognised_well_above_chance():
    training = utterances.spoken(("average", "older"), levels=(0.0, 7.0), repeats=1)
    queries = utterances.spoken(("long_chin",), levels=(0.0, 7.0), repeats=2)
    made = recognition.averages(recognition.grouped(training), rate_hz=60)
    found = recognition.classify_all([one.take for one in queries], made, rate_hz=60)
    right = np.mean([one.label == query.utterance for one, query in zip(found, queries, strict=True)])
    assert right > 2 / 6


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_sticky_model_is_nearer_to_a_filmed_mouth(scene):
    """In width and area by every measure; the height of the largest opening hardly tells them apart."""
    who = likeness.HIDDEN[likeness.SHOWN]
    real = likeness.filmed(likeness.hidden_scene(scene, who), "real")
    table = likeness.likeness(real, likeness.model_takes(scene, who, real))
    assert len(table) == 12
    nearer = table["sticky"] < table["non-sticky"]
    assert nearer.loc["width"].all() and nearer.loc["area"].all(), table
    assert nearer.loc["height"].sum() >= 3, table


@needs_data
@pytest.mark.slow
def test_a_clip_measured_anew_is_far_nearer_to_itself_than_clips_are_to_one_another():
    names = ("grid_bbaf2n", "grid_lrwp9a", "vr_5")
    takes = {name: likeness.remeasured(reference.video_file(name), name) for name in names}
    first, *others = likeness.CHANGES
    between = [
        likeness.against(takes[a][first], takes[b][first])["DTW, height"] for a, b in itertools.combinations(names, 2)
    ]
    for name in names:
        for change in others:
            distance = likeness.against(takes[name][first], takes[name][change])["DTW, height"]
            mild = "H.264, crf 23" in change or not any(word in change for word in ("crf", "MPEG"))
            assert distance < (0.3 if mild else 0.9) * np.median(between), (name, change)
