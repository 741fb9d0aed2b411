import math

import numpy as np
import pytest
from moving_takes import moving_take

from lipmetrics.errors import InputError
from lipmetrics.labels import Labels
from lipmetrics.measuring import ZERO, Measure, Measuring
from lipmetrics.metrics import HIGHER, LOWER
from lipmetrics.scoring import Labelled, Settings, score
from lipmetrics.take import Take

# A take is one number here, its height: distances can be worked by hand.
NUMBER = Measuring(
    (
        Measure("apart", "mw", LOWER, of_pair=True),
        Measure("alike", "1", HIGHER, of_pair=True),
        Measure("lag", "s", ZERO, of_pair=True),
        Measure("peak", "mw", LOWER, of_pair=False),
    ),
    lambda real, model: {
        "apart": abs(level(model) - level(real)),
        "alike": -abs(level(model) - level(real)),
        "lag": level(model) - level(real),
    },
    lambda take: {"peak": level(take)},
)


def level(take) -> float:
    return float(take.channels["height"][0])


def take(name: str, height: float, unit: str = "mw") -> Take:
    time_s = np.arange(5) / 25
    return Take(name, time_s, {c: np.full(5, float(height)) for c in ("width", "height", "area")}, unit)


def labelled(name: str, height: float, unit: str = "mw") -> Labelled:
    speaker, utterance, repeat = name.split("_")
    return Labelled(take(name, height, unit), Labels(utterance, speaker, repeat))


REAL = [labelled(*row) for row in (("a_mm_1", 1.0), ("a_mm_2", 2.0), ("b_mm_1", 4.0), ("c_mm_1", 8.0))]


def scored(models, references=REAL, **settings):
    return score(models, references, measuring=NUMBER, settings=Settings(**{"draws": 200, **settings}))


def row(table, **where):
    for name, value in where.items():
        table = table[table[name] == value]
    assert len(table) == 1
    return table.iloc[0]


def test_a_clip_is_scored_against_each_speaker_alike():
    found = scored([labelled("x_mm_1", 3.0)])
    clip = row(found.clips, metric="apart")
    # a: (2 + 1) / 2, b: 1, c: 5
    assert clip["value"] == pytest.approx((1.5 + 1 + 5) / 3)
    # leave one speaker out: a1 (3 + 7) / 2, a2 (2 + 6) / 2, b (2.5 + 4) / 2, c (6.5 + 4) / 2
    np.testing.assert_allclose(sorted(found.floor_values["mm", "apart", "speakers"]), [3.25, 4, 5, 5.25])
    assert clip["percentile_speakers"] == 0
    assert clip["ratio_speakers"] == pytest.approx(2.5 / 4.5)
    # repeat against repeat: both of a, 1 apart; ties count half
    np.testing.assert_allclose(found.floor_values["mm", "apart", "repeats"], [1, 1])
    assert clip["percentile_repeats"] == 100
    assert (clip["references_n"], clip["known_n"]) == (4, 4)


def test_a_percentile_counts_the_floor_below_and_half_of_the_ties():
    found = scored([labelled("x_mm_1", 7.0)])  # a 5.5, b 3, c 1 -> 3.1667 is under all; 9.5: a 8, b 5.5, c 1.5 -> 5
    assert row(found.clips, metric="apart")["percentile_speakers"] == 0
    found = scored([labelled("x_mm_1", 9.5)])
    assert row(found.clips, metric="apart")["value"] == pytest.approx(5)
    assert row(found.clips, metric="apart")["percentile_speakers"] == pytest.approx(100 * 2.5 / 4)


def test_higher_is_nearer_gives_the_same_percentile_and_no_ratio():
    found = scored([labelled("x_mm_1", 9.5)])
    apart, alike = (row(found.clips, metric=name) for name in ("apart", "alike"))
    assert alike["value"] == -apart["value"]
    assert (alike["low"], alike["high"]) == (-apart["high"], -apart["low"])
    assert alike["percentile_speakers"] == apart["percentile_speakers"]
    assert math.isnan(alike["ratio_speakers"])


def test_what_is_signed_counts_by_its_size_and_keeps_its_bias():
    found = scored([labelled("x_mm_1", 3.0)])
    for name in ("lag", "peak"):
        clip = row(found.clips, metric=name)
        assert clip["value"] == pytest.approx(2.5)
        assert clip["bias"] == pytest.approx(np.mean([2, 1, -1, -5]))
    assert math.isnan(row(found.clips, metric="apart")["bias"])


def test_a_real_take_among_its_like_is_typical():
    rng = np.random.default_rng(3)
    real = [labelled(f"s{k}_mm_1", height) for k, height in enumerate(rng.normal(50, 5, 40))]
    mine = [labelled(f"m{k}_mm_1", height) for k, height in enumerate(rng.normal(50, 5, 40))]
    overall = row(scored(mine, real).overall, metric="apart")
    assert 35 < overall["percentile_speakers"] < 65
    assert overall["percentile_speakers_low"] < overall["percentile_speakers"] < overall["percentile_speakers_high"]
    assert overall["ratio_speakers"] == pytest.approx(1, abs=0.25)


def test_utterances_are_kept_apart_and_averaged():
    real = [
        labelled(f"{s}_{u}_1", h) for u, of in (("mm", (1, 3)), ("pp", (10, 20))) for s, h in zip("ab", of, strict=True)
    ]
    found = scored([labelled("x_mm_1", 2.0), labelled("x_pp_1", 12.0), labelled("y_pp_1", 18.0)], real)
    assert row(found.utterances, metric="apart", utterance="mm")["value"] == 1
    assert row(found.utterances, metric="apart", utterance="pp")["value"] == 5
    overall = row(found.overall, metric="apart")
    assert overall["value"] == 3
    assert overall["ratio_speakers"] == pytest.approx(3 / ((2 + 10) / 2))
    assert (overall["clips_n"], overall["utterances_n"]) == (3, 2)


def test_same_speaker_compares_with_that_speaker_only():
    found = scored([labelled("a_mm_9", 4.0)], same_speaker=True)
    clip = row(found.clips, metric="apart")
    assert clip["value"] == 2.5
    assert clip["references_n"] == 2
    assert found.primary == "repeats"


def test_one_speaker_has_repeats_only_and_says_so():
    found = scored([labelled("x_mm_1", 3.0)], REAL[:2])
    assert found.primary == "repeats"
    assert "percentile_speakers" not in found.clips
    assert any("of one speaker" in note for note in found.notes)


def test_one_take_has_no_floor_and_says_so():
    found = scored([labelled("x_mm_1", 3.0)], REAL[:1])
    assert found.primary is None
    assert math.isnan(found.clips["low"].iloc[0])
    assert any("no floor" in note for note in found.notes)


def test_unknown_speakers_are_told_of():
    found = score([take("x", 3)], [take("p", 1), take("q", 2), take("r", 4)], measuring=NUMBER)
    assert found.primary == "takes"
    assert set(found.clips["utterance"]) == {"all takes"}
    assert any("one utterance" in note for note in found.notes)
    assert any("speaker" in note for note in found.notes)


def test_names_label_takes():
    found = score(
        [take("x_mm_1", 3)], [one.take for one in REAL], names="{speaker}_{utterance}_{repeat}", measuring=NUMBER
    )
    assert found.primary == "speakers"
    assert row(found.clips, metric="apart")["speaker"] == "x"


def test_two_models_are_compared_on_the_same_clips():
    real = [labelled(f"{s}_u{k}_1", 10 + d) for k in range(6) for s, d in (("a", -1), ("b", 1))]
    models = {
        "near": [labelled(f"x_u{k}_1", 10.0 + 0.1 * k) for k in range(6)],
        "far": [labelled(f"x_u{k}_1", 14.0 + 0.1 * k) for k in range(6)],
    }
    one = row(scored(models, real).comparisons, metric="apart")
    assert (one["first"], one["second"], one["items_n"], one["item"], one["cluster"]) == (
        "near",
        "far",
        6,
        "clip",
        "utterance",
    )
    assert one["difference"] == pytest.approx(one["mean_first"] - one["mean_second"])
    assert one["first_nearer"] == 6 and one["high"] < 0
    assert one["p"] == pytest.approx(2 / 2**6) and one["p_exact"]
    alike = row(scored(models, real).comparisons, metric="alike")
    assert alike["first_nearer"] == 6 and alike["difference"] > 0


def test_takes_of_other_speakers_are_compared_by_utterance():
    real = [labelled(f"{s}_u{k}_1", 10 + d) for k in range(3) for s, d in (("a", -1), ("b", 1))]
    models = {"p": [labelled(f"x_u{k}_1", 12) for k in range(3)], "q": [labelled(f"y_u{k}_1", 15) for k in range(3)]}
    one = row(scored(models, real).comparisons, metric="apart")
    assert (one["item"], one["items_n"], one["difference"]) == ("utterance", 3, -3)


def test_a_bad_take_is_passed_over_and_named():
    def fussy(real, model):
        if level(model) > 100:
            raise InputError("expected a mouth, got a whale")
        return NUMBER.pair(real, model)

    measuring = Measuring(NUMBER.measures, fussy, NUMBER.take)
    found = score([labelled("x_mm_1", 3), labelled("w_mm_1", 1000), labelled("x_pp_1", 3)], REAL, measuring=measuring)
    assert set(found.clips["take"]) == {"x_mm_1"}
    assert found.failed["w_mm_1"] == "expected a mouth, got a whale"
    assert "utterance 'pp'" in found.failed["x_pp_1"]


def test_the_same_seed_gives_the_same_numbers_and_another_does_not():
    clips = [labelled("x_mm_1", 3.0), labelled("y_mm_1", 5.0)]
    real = [labelled(f"s{k}_mm_1", k**1.5) for k in range(15)]
    first, again, other = (scored(clips, real, seed=seed) for seed in (1, 1, 2))
    assert first.overall.equals(again.overall)
    assert not first.overall.equals(other.overall)
    assert not first.clips.equals(other.clips)  # these depend on the real speakers that are drawn, and on no others


def test_intervals_cover_the_truth_as_often_as_they_say():
    hits, rng = 0, np.random.default_rng(0)
    for _ in range(60):
        real = [labelled(f"s{k}_mm_1", height) for k, height in enumerate(rng.normal(100, 3, 25))]
        clip = row(scored([labelled("x_mm_1", 120)], real).clips, metric="apart")
        hits += clip["low"] <= 20 <= clip["high"]
    assert 50 <= hits <= 60


@pytest.mark.parametrize(
    ("models", "references", "sentence"),
    [
        ([], REAL, "expected one take or more of each model, got none of model"),
        ([labelled("x_mm_1", 1)], [], "expected one real take or more"),
        ([labelled("x_kk_1", 1)], REAL, "expected a take of model with an utterance that a real take has"),
        ([labelled("x_mm_1", 1, "px")], REAL, "one unit"),
    ],
)
def test_bad_input(models, references, sentence):
    with pytest.raises(InputError, match=sentence):
        scored(models, references)


def test_mixed_units_by_request():
    assert any("Mixed units" in n for n in scored([labelled("x_mm_1", 1, "px")], allow_mixed_units=True).notes)


def test_lag_that_the_band_holds_back_is_told_of():
    real = [moving_take(name) for name in "pq"]
    late = score([moving_take(late_s=0.3)], real, settings=Settings(draws=20))
    assert any("edge of the band" in note for note in late.notes)
    free = score([moving_take(late_s=0.3)], real, settings=Settings(draws=20, band=None))
    assert not any("edge of the band" in note for note in free.notes)
    assert row(free.clips, metric="lag_v1")["bias"] > 0.2 > row(late.clips, metric="lag_v1")["bias"]
