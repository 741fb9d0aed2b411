"""Averages: of identical and shifted takes, cost that never rises, what the spread is, files."""

import json

import numpy as np
import pytest
from compared_curves import movement, take

import lipmetrics
from lipmetrics.compare import align, average, averages, load_average
from lipmetrics.compare.alignment import matched_mean
from lipmetrics.compare.warping import dtw_path
from lipmetrics.errors import InputError


def varied(count=8, seed=0):
    random = np.random.default_rng(seed)
    made = []
    for _ in range(count):
        time = np.arange(int(random.integers(100, 130))) / 50
        values = random.uniform(0.7, 1.3) * movement(time - random.normal(0, 0.08))
        made.append(take(values + 0.01 * random.random(values.shape)))
    return made


def test_identical_takes():
    found = average([take()] * 4)
    assert np.allclose(found.mean, take().array()[1], rtol=0, atol=1e-15)
    assert np.abs(found.spread).max() < 1e-15
    assert np.abs(found.time_spread_s).max() < 1e-15
    assert (found.channels, found.unit, found.rate_hz, len(found.takes)) == (("width", "height", "area"), "mw", 50, 4)


def test_shifted_takes_keep_their_shape():
    """The plain mean of shifted takes is blurred; the barycentre has their height, and the shift is in its timing."""
    takes = [take(late_s=late) for late in (-0.12, -0.06, 0.0, 0.06, 0.12)]
    found = average(takes)
    plain = np.mean([one.array()[1] for one in takes], axis=0)
    truth = movement(np.arange(111) / 50)
    assert dtw_path(found.mean, truth, band=0.1)[1] < 1e-9
    assert dtw_path(plain, truth, band=0.1)[1] > 0.1
    assert found.spread.max() < 0.05
    moving = np.abs(np.gradient(found.mean[:, 1])) > 0.005
    assert np.median(found.time_spread_s[moving]) == pytest.approx(
        np.std([-0.12, -0.06, 0, 0.06, 0.12], ddof=1), rel=0.1
    )


@pytest.mark.parametrize("band", [None, 0.1])
@pytest.mark.parametrize("seed", range(5))
def test_cost_never_rises_and_is_that_of_the_paths(seed, band):
    takes = varied(seed=seed)
    found = average(takes, band=band, iterations=30, by_shape=False)
    assert len(found.costs) > 2
    assert (np.diff(found.costs) <= 1e-12).all()
    total = 0.0
    for one, path in zip(takes, found.paths, strict=True):
        expected, distance = dtw_path(found.mean, one.array()[1], cost="squared", band=band)
        assert np.array_equal(path, expected)
        total += distance**2
    assert found.costs[-1] == pytest.approx(total)


def test_takes_of_different_size_give_no_spike():
    sizes = np.linspace(0.5, 1.5, 7)
    takes = [take(size * movement(np.arange(111) / 50 - 0.02 * k)) for k, size in enumerate(sizes)]
    found, plain = average(takes), average(takes, by_shape=False)
    peaks = np.mean([one.array()[1].max(axis=0) for one in takes], axis=0)
    assert found.mean.max(axis=0) == pytest.approx(peaks, rel=1e-6)
    assert (plain.mean.max(axis=0) > 1.05 * peaks).all()  # what it would be


@pytest.mark.parametrize("least", ["small", "noise"])
def test_a_take_that_hardly_opens_does_not_bend_the_others(least):
    small = {
        "small": 1e-3 * movement(np.arange(111) / 50 - 0.3),
        "noise": 1e-3 * np.random.default_rng(0).random((111, 3)),
    }[least]
    found = average([take(), take(), take(small)])
    assert found.mean.max(axis=0) == pytest.approx(take().array()[1].max(axis=0) * 2 / 3, rel=0.01)
    assert np.abs(np.diff(found.mean[:, 1])).max() < 0.04  # steps of the takes: 0.03; with a spike 0.08 and more


def test_one_step_is_the_mean_of_what_is_matched():
    takes = varied(4)
    start, after = (average(takes, iterations=n, by_shape=False) for n in (0, 1))
    for i in range(0, len(start.mean), 7):
        matched = [one.array()[1][path[path[:, 0] == i, 1]] for one, path in zip(takes, start.paths, strict=True)]
        assert after.mean[i] == pytest.approx(np.concatenate(matched).mean(axis=0))


def test_spread_is_the_deviation_between_takes():
    takes = varied(5)
    found = average(takes)
    here = [
        matched_mean(p[:, 0], one.array()[1][p[:, 1]], len(found.mean))
        for one, p in zip(takes, found.paths, strict=True)
    ]
    mean = sum(here) / 5
    assert found.spread == pytest.approx(np.sqrt(sum((one - mean) ** 2 for one in here) / 4))
    small, large = take(0.5 * movement(np.arange(111) / 50)), take(1.5 * movement(np.arange(111) / 50))
    apart = average([small, large], band=0.0)
    assert apart.spread == pytest.approx(movement(np.arange(111) / 50) / np.sqrt(2))


def test_one_take_has_no_spread():
    found = average([take()])
    assert np.isnan(found.spread).all()
    assert np.isnan(found.time_spread_s).all()
    assert np.allclose(found.mean, take().array()[1])


def test_lengths_rates_and_starts_differ():
    takes = [
        take(),
        take(rate_hz=25.0, end_s=2.0),
        take(time_s=7 + np.arange(121) / 50, values=movement(np.arange(121) / 50)),
    ]
    found = average(takes)
    assert found.rate_hz == 50
    assert len(found.time_s) == 111
    assert found.time_s[0] == 0
    assert found.spread.max() < 0.03


def test_groups_in_threads_equal_one_by_one():
    groups = {"a": varied(6, 1), "b": varied(5, 2), "c": [take()]}
    for threads in (1, 2):
        found = averages(groups, threads=threads, iterations=4)
        assert list(found) == ["a", "b", "c"]
        for name, takes in groups.items():
            assert np.array_equal(found[name].mean, average(takes, iterations=4).mean)
            assert found[name].name == name


def test_files_come_back(tmp_path):
    found = average(varied(3), name="opening ä", band=0.2)
    paths = found.save(tmp_path, "open")
    first = [path.read_bytes() for path in paths]
    again = load_average(paths[0])
    for name in ("time_s", "mean", "spread", "time_spread_s"):
        assert getattr(again, name) == pytest.approx(getattr(found, name), rel=1e-8, abs=1e-12)
    for name in ("name", "channels", "unit", "takes", "rate_hz", "band", "costs"):
        assert getattr(again, name) == getattr(found, name)
    found.save(tmp_path, "open")
    assert [path.read_bytes() for path in paths] == first
    assert load_average(tmp_path / "open").name == "opening ä"
    single = average([take()])
    single.save(tmp_path, "single")
    assert np.isnan(load_average(tmp_path / "single").spread).all()
    assert align(again, found).per_step < 1e-7
    assert lipmetrics.average([take()]).mean.shape == (111, 3)


def test_refused_files(tmp_path):
    with pytest.raises(InputError, match="found no"):
        load_average(tmp_path / "nothing")
    average([take()]).save(tmp_path, "a")
    meta = json.loads((tmp_path / "a.average.json").read_text())
    for key, value in (("format", "other"), ("channels", ["lip"]), ("takes", 3)):
        (tmp_path / "a.average.json").write_text(json.dumps(meta | {key: value}))
        with pytest.raises(InputError, match="expected an average"):
            load_average(tmp_path / "a.average.csv")
    (tmp_path / "a.average.json").write_text("[")
    with pytest.raises(InputError, match="expected an average"):
        load_average(tmp_path / "a")


def test_refused_input():
    with pytest.raises(InputError, match="at least one take"):
        average([])
    with pytest.raises(InputError, match="number of iterations"):
        average([take()], iterations=-1)
    with pytest.raises(InputError, match="one unit"):
        average([take(), take(unit="px")])
    with pytest.raises(InputError, match="band from 0 to 1"):
        average([take()], band=2)
