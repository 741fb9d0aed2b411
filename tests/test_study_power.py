import numpy as np
import pytest
from scipy import stats

from study.design import make_design, stimuli_from_codes
from study.errors import InputError
from study.power import Scenario, design_power, p_values, rejection, sample_size, simulate


def test_simulated_answers_have_the_effects_asked_for():
    y = simulate(Scenario(200, 150, 0.4, 0, 0), 1, np.random.default_rng(0))[0]
    assert y.mean() == pytest.approx(1 / (1 + np.exp(-0.4)), abs=0.01)
    people = simulate(Scenario(400, 200, 0, 1, 0), 1, np.random.default_rng(1))[0].mean(1)
    shares = np.clip(people, 0.01, 0.99)
    assert np.log(shares / (1 - shares)).std() == pytest.approx(1, abs=0.1)


def test_p_values_equal_scipys():
    y = simulate(Scenario(10, 12, 0.3, 0.5, 0.5), 5, np.random.default_rng(2))
    found = p_values(y, np.random.default_rng(3), 99)
    for one, by_people, by_pairs, by_count in zip(
        y, found["participants"], found["pairs"], found["binomial"], strict=True
    ):
        assert by_people == pytest.approx(stats.ttest_1samp(one.mean(1), 0.5).pvalue)
        assert by_pairs == pytest.approx(stats.ttest_1samp(one.mean(0), 0.5).pvalue)
        assert by_count == pytest.approx(stats.binomtest(int(one.sum()), one.size).pvalue)


def test_power_grows_with_participants_and_with_the_preference():
    def power(n, preference):
        return rejection(Scenario(n, 20, preference, 0.5, 0.3), studies_n=300, draws=299)["rate"][0]

    assert power(8, 0.4) < power(16, 0.4) < power(16, 0.8)


def test_power_of_a_coin_study_is_the_binomials():
    """Without effects of people and pairs, power is known from the binomial distribution."""
    n, share = 12 * 20, 1 / (1 + np.exp(-0.3))
    r = np.arange(n + 1)
    reject = np.array([stats.binomtest(int(k), n).pvalue <= 0.05 for k in r])
    known = stats.binom.pmf(r, n, share)[reject].sum()
    found = rejection(Scenario(12, 20, 0.3, 0, 0), studies_n=2000, draws=499).set_index("test")
    assert found.loc["binomial", "rate"] == pytest.approx(known, abs=0.035)
    assert found.loc["headline", "rate"] == pytest.approx(known, abs=0.08)


def test_the_sample_size_is_the_first_that_is_enough():
    n, tried = sample_size(Scenario(8, 30, 0.6, 0.5, 0.3), power=0.8, studies_n=200, seed=1)
    tried = tried.set_index("participants_n")["power"]
    assert tried[n] >= 0.8 > tried[tried.index < n].max()


def test_pairs_that_differ_set_a_limit():
    n, tried = sample_size(Scenario(8, 4, 0.3, 0.5, 1.5), studies_n=100, most=40)
    assert n is None and tried["participants_n"].max() == 40


def test_same_seed_same_rates():
    one = Scenario(8, 8, 0.5)
    assert rejection(one, studies_n=50, seed=4).equals(rejection(one, studies_n=50, seed=4))


def test_a_design_of_parts_is_simulated_as_it_is():
    stimuli = stimuli_from_codes([f"{action}_{level}" for action in ("m", "p", "b", "k") for level in (0, 4, 7)])
    design = make_design(stimuli, participants_n=16, scheme="bib", per_participant_n=8, seed=1)
    low, _ = design_power(design, preference=0, studies_n=60, draws=199)
    high, error = design_power(design, preference=1.5, studies_n=60, draws=199)
    assert low < 0.2 < 0.8 < high and 0 <= error < 0.07


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: Scenario(2, 30), "participants_n to be at least 3"),
        (lambda: Scenario(person_sd=-1), "person_sd to be 0 or more"),
        (lambda: Scenario(preference=float("nan")), "preference in logits"),
        (lambda: sample_size(Scenario(preference=0)), "a preference to find"),
        (lambda: sample_size(Scenario(), power=80), "between 0 and 1"),
    ],
)
def test_bad_scenarios_are_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()
