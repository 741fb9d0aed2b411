"""All pairs at once against pair after pair, recognition by the nearest, and parts of movements."""

import itertools

import numpy as np
import pandas as pd
import pytest
from compared_curves import movement, take

import lipmetrics
from lipmetrics.compare import (
    Region,
    align,
    average,
    carry,
    classify,
    classify_all,
    compare_gradients,
    confusion,
    gradients,
    hausdorff,
    pairs,
    propose_phases,
)
from lipmetrics.errors import InputError


def noisy(seed, count, late_s=0.0, factor=1.0):
    random = np.random.default_rng(seed)
    time = np.arange(int(random.integers(90, 130))) / 50
    made = []
    for k in range(count):
        values = factor * movement(time - late_s - random.normal(0, 0.03)) + 0.01 * random.random((len(time), 3))
        made.append(take(values, time + random.uniform(0, 0.1), name=f"{seed}-{k}"))
    return made


@pytest.mark.parametrize("cost", ["absolute", "squared"])
@pytest.mark.parametrize(
    ("band", "clock", "seconds"), [(None, "shared", 1.0), (0.1, "start", 0.3), (0.05, "shared", 3.0)]
)
def test_equals_pair_after_pair(cost, band, clock, seconds):
    takes, references = noisy(1, 3) + noisy(2, 2, 0.2), noisy(3, 2, 0.1) + noisy(4, 1)
    found = pairs(takes, references, cost=cost, band=band, clock=clock, seconds_per_unit=seconds)
    assert found.takes == tuple(one.name for one in takes)
    for a, one in enumerate(takes):
        for b, other in enumerate(references):
            match = align(other, one, cost=cost, band=band, clock=clock, rate_hz=found.rate_hz)
            apart = hausdorff(
                *(one, other), cost=cost, band=band, clock=clock, rate_hz=found.rate_hz, seconds_per_unit=seconds
            )
            assert found.distance[a, b] == pytest.approx(match.distance, rel=1e-9)
            assert found.per_step[a, b] == pytest.approx(match.per_step, rel=1e-9)
            assert found.steps[a, b] == len(match.path)
            assert found.warp[a, b] == pytest.approx(match.warp)
            assert found.lag_s[a, b] == pytest.approx(match.lag_s, abs=1e-9)
            assert found.there[a, b] == pytest.approx(apart.a_to_b, rel=1e-9)
            assert found.back[a, b] == pytest.approx(apart.b_to_a, rel=1e-9)
            assert found.hausdorff[a, b] == pytest.approx(apart.value, rel=1e-9)


def test_threads_and_pieces_change_nothing(monkeypatch):
    takes, references = noisy(5, 9), noisy(6, 4)
    whole = pairs(takes, references, threads=1)
    monkeypatch.setitem(pairs.__globals__, "BLOCK_BYTES", 20_000)
    for threads in (1, 2, 3):
        pieces = pairs(takes, references, threads=threads)
        for name in ("distance", "hausdorff", "there", "back", "lag_s", "warp", "steps"):
            assert np.array_equal(getattr(whole, name), getattr(pieces, name)), name


def test_takes_and_references_exchanged():
    takes, references = noisy(7, 5), noisy(8, 2, 0.1) + noisy(9, 1)
    forth, back = pairs(takes, references), pairs(references, takes)
    assert np.array_equal(forth.distance, back.distance.T)
    assert np.allclose(forth.there, back.back.T, rtol=1e-9)
    assert np.allclose(forth.back, back.there.T, rtol=1e-9)
    assert np.allclose(forth.lag_s, -back.lag_s.T, atol=1e-9)
    few = pairs(takes[:1], references)
    for name in ("distance", "hausdorff", "there", "back", "lag_s", "warp", "steps"):
        assert np.allclose(getattr(few, name), getattr(forth, name)[:1], rtol=1e-12), name


def test_lag_is_positive_for_a_late_take():
    assert pairs([take(late_s=0.1)], [take()]).lag_s[0, 0] == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"threads": 0}, "at least 1 thread"),
        ({"cost": "abs"}, "expected cost to be one of"),
        ({"clock": "x"}, "expected clock"),
        ({"seconds_per_unit": 0}, "seconds_per_unit above 0"),
    ],
)
def test_refused_settings(settings, message):
    with pytest.raises(InputError, match=message):
        pairs([take()], [take()], **settings)


def test_refused_without_takes_or_references():
    for takes, references in (([], [take()]), ([take()], [])):
        with pytest.raises(InputError, match="at least one take and one reference"):
            pairs(takes, references)


@pytest.mark.parametrize("measure", ["dtw", "hausdorff"])
def test_families_are_recognised(measure):
    families = {"wide": (1.3, 0.0), "small": (0.5, 0.0), "plain": (0.9, 0.0)}
    averages = {
        name: average(noisy(20 + at, 5, late, factor), name=name)
        for at, (name, (factor, late)) in enumerate(families.items())
    }
    takes, labels = [], []
    for at, (name, (factor, late)) in enumerate(families.items()):
        takes += noisy(40 + at, 4, late, factor)
        labels += [name] * 4
    found = classify_all(takes, averages, measure=measure)
    assert [one.label for one in found] == labels
    assert all(list(one.distances) == sorted(one.distances) and 0 < one.margin <= 1 for one in found)
    table = confusion(labels, found)
    assert table.to_numpy().tolist() == (4 * np.eye(3, dtype=int)).tolist()
    assert list(table.index) == ["plain", "small", "wide"]
    single = classify(takes[0], list(averages.values()), measure=measure)
    assert single == found[0]
    assert lipmetrics.classify(takes[0], averages, measure=measure) == found[0]


def test_confusion_rows_are_the_truth():
    found = classify_all([take()], {"a": take(), "b": take(2 * movement(np.arange(111) / 50))})
    table = confusion(["b"], found)
    assert table.loc["b", "a"] == 1
    assert table.to_numpy().sum() == 1


def test_margin_of_ties_and_of_one_label():
    assert classify(take(), {"a": take(), "b": take()}).margin == 0
    assert np.isnan(classify(take(), {"a": take()}).margin)
    assert classify_all([], {"a": take()}) == []


def test_classification_refuses():
    with pytest.raises(InputError, match="at least one average"):
        classify(take(), {})
    with pytest.raises(InputError, match="average more than once"):
        classify(take(), [average([take()]), average([take()])])
    with pytest.raises(InputError, match="did you mean 'hausdorff'"):
        classify(take(), {"a": take()}, measure="hausdorf")
    with pytest.raises(InputError, match="one true label per take"):
        confusion(["a"], [])


def test_proposed_phases_of_a_known_movement():
    """A trapezium: rise 0.2 to 0.7 s, top to 1.2 s, fall to 2.2 s."""
    time = np.arange(301) / 100
    height = np.clip(np.minimum((time - 0.2) / 0.5, (2.2 - time) / 1.0), 0, 1)
    regions = propose_phases((time, height))
    assert [region.label for region in regions] == ["onset", "opening", "hold", "closing"]
    bounds = [regions[0].start_s, *(region.end_s for region in regions)]
    assert bounds == pytest.approx([0.225, 0.30, 0.65, 1.30, 2.15], abs=0.011)
    assert all(one.end_s == other.start_s for one, other in itertools.pairwise(regions))
    with pytest.raises(InputError, match="expected height to change, got 1 throughout"):
        propose_phases((time, np.ones(301)))


def test_phases_of_the_highest_peak_and_of_cut_takes():
    time = np.arange(301) / 100
    two = np.maximum(0.6 * np.exp(-(((time - 0.6) / 0.2) ** 2)), np.exp(-(((time - 2) / 0.2) ** 2)))
    regions = propose_phases((time, two))
    assert regions[0].start_s > 1
    cut = propose_phases((time[200:], two[200:]))  # starts at the peak
    assert cut[0].start_s == cut[1].end_s == pytest.approx(2.0)


def test_regions_come_back_from_a_bent_time():
    """Known bend: b shows at bend(t) what a shows at t."""
    time = np.arange(221) / 100
    a = (time, movement(time))
    bent = time + 0.12 * np.sin(np.pi * time / 2.2)
    b = (time, np.stack([np.interp(time, bent, column) for column in movement(time).T], axis=1))
    regions = propose_phases((time, movement(time)[:, 1]))
    carried = carry(regions, align(a, b))
    for region, other in zip(regions, carried, strict=True):
        assert other.label == region.label
        assert other.start_s == pytest.approx(np.interp(region.start_s, time, bent), abs=0.0101)
        assert other.end_s == pytest.approx(np.interp(region.end_s, time, bent), abs=0.0101)


def test_regions_keep_off_a_longer_rest():
    a, b = take(late_s=-0.2, end_s=2.0), take(late_s=0.1, end_s=2.6)
    regions = (Region("all", 0.3, 1.4),)
    (carried,) = carry(regions, align(a, b, band=None))
    assert carried.start_s == pytest.approx(0.6, abs=0.021)
    assert carried.end_s == pytest.approx(1.7, abs=0.021)


def test_gradients_of_ramps():
    time = np.arange(101) / 50
    take_ = (time, np.stack([2 * time, -time, np.where(time < 1, 0, 4 * (time - 1))], axis=1))
    table = gradients(take_, [Region("first", 0.0, 0.5), Region("last", 1.5, 2.0), Region("none", 0.505, 0.51)])
    assert list(table["region"].unique()) == ["first", "last", "none"]
    first = table[table["region"] == "first"].set_index("channel")
    assert first["mean_slope"].tolist() == pytest.approx([2, -1, 0], abs=1e-9)
    assert first["peak_slope"].tolist() == pytest.approx([2, -1, 0], abs=1e-9)
    assert first["change"].tolist() == pytest.approx([1, -0.5, 0], abs=1e-9)
    assert first["duration_s"].tolist() == [0.5] * 3
    assert table[table["region"] == "last"].set_index("channel").loc["area", "mean_slope"] == pytest.approx(4)
    assert table[table["region"] == "none"]["mean_slope"].isna().all()


def test_gradients_compared_in_the_same_regions():
    time = np.arange(221) / 100
    a, b = (time, movement(time)), (time * 1.25, 2 * movement(time))  # slower by a quarter, twice as large
    match = align(a, b, band=None, rate_hz=100)
    table = compare_gradients(propose_phases((time, movement(time)[:, 1])), match).set_index(["region", "channel"])
    assert table.loc[("opening", "height"), "peak_slope_ratio"] == pytest.approx(2 / 1.25, rel=0.05)
    assert table.loc[("closing", "height"), "peak_slope_ratio"] == pytest.approx(2 / 1.25, rel=0.05)
    assert isinstance(table, pd.DataFrame)


@pytest.mark.parametrize(
    ("region", "message"),
    [
        (Region("a", 1.0, 0.5), "start <= end"),
        (Region("a", 9.0, 9.5), "lies outside"),
        (Region("a", np.nan, 1), "start <="),
    ],
)
def test_refused_regions(region, message):
    with pytest.raises(InputError, match=message):
        gradients(take(), [region])
    with pytest.raises(InputError, match=message):
        carry([region], align(take(), take()))
