from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drawn_mouth import opened, plain

import lipmetrics
from lipmetrics import confidence as module
from lipmetrics.confidence import (
    FEATURES,
    Calibration,
    Evidence,
    Logistic,
    confidence,
    features,
    forests_id,
    from_text,
    package_calibration,
    probability,
    to_text,
    undecided,
)
from lipmetrics.errors import InputError
from lipmetrics.look import NO_MOUTH
from lipmetrics.still import look_at

SHIPPED = package_calibration()
DATA = Path(lipmetrics.__file__).parent / "data"
CLEAR = Evidence(1, 0.2, 0.4, 0.9, 2.0)
# how each number changes when there is less to go by
WORSE = {"undecided_rows": 3.0, "undecided_lip_rows": 3.0, "score": -0.3, "margin": -1.0}


def random_evidence(count: int) -> np.ndarray:
    rng = np.random.default_rng(4)
    columns = [rng.integers(0, 2, count), *(rng.uniform(0, top, count) for top in (8, 8, 1, 6))]
    return np.column_stack(columns).astype(float)


def test_it_is_a_likelihood():
    found = probability(random_evidence(500), SHIPPED)
    assert found.min() >= 0 and found.max() <= 1 and np.ptp(found) > 0.3


@pytest.mark.parametrize("name", WORSE)
@pytest.mark.parametrize("is_open", [0, 1])
def test_less_evidence_is_never_more_confidence(name, is_open):
    evidence = random_evidence(300)
    evidence[:, 0] = is_open
    worse = evidence.copy()
    worse[:, Evidence._fields.index(name)] += WORSE[name]
    assert (probability(worse, SHIPPED) <= probability(evidence, SHIPPED)).all()


def test_every_kind_of_evidence_counts_somewhere():
    weights = np.array([SHIPPED.open.weights, SHIPPED.closed.weights])
    assert (weights >= 0).all() and (weights.max(axis=1) > 0).all()


def test_better_than_anything_seen_is_not_trusted_more():
    ends = Calibration(*[Logistic(0.0, (1.0,) * 4, (0.0, 0.0, 0.5, 1.0))] * 2)
    at_the_end = Evidence(1, 0.95, 0.95, 0.5, 1.0)
    assert probability(at_the_end, ends) == pytest.approx(1 / (1 + np.exp(-1.5)))
    assert probability(Evidence(1, 0.0, 0.0, 1.0, 3.0), ends) == pytest.approx(1 / (1 + np.exp(-1.5)))


@pytest.mark.parametrize("evidence", random_evidence(20).tolist())
def test_one_frame_is_as_many_are(evidence):
    assert confidence(Evidence(*evidence)) == pytest.approx(float(probability(evidence, SHIPPED)), abs=1e-12)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_known_is_not_trusted(value):
    assert confidence(CLEAR._replace(score=value)) == 0
    assert probability(CLEAR._replace(score=value), SHIPPED) == 0


def test_rows_that_are_undecided():
    odds = np.array([[0.0, 40.0], [np.log(3), -40.0]])
    assert undecided(odds) == pytest.approx([1 / 4 + 3 / 16, 0])


def test_weights_are_read_as_they_were_written():
    assert from_text(to_text(SHIPPED)) == SHIPPED
    assert len(FEATURES) == features(CLEAR).shape[-1]


@pytest.mark.parametrize(
    "text", ["", "[]", '{"format": "other"}', "{" * 2000, to_text(SHIPPED).replace("weights", "w")]
)
def test_other_texts_are_no_weights(text):
    with pytest.raises(InputError, match="expected weights of the confidence"):
        from_text(text)


def test_weights_below_zero_are_refused():
    with pytest.raises(InputError, match="weights of at least 0"):
        replace(SHIPPED.open, weights=(1, 1, 1, -0.1))
    with pytest.raises(InputError, match="for each of border"):
        replace(SHIPPED.open, weights=(1, 1))


def test_the_weights_belong_to_the_forests():
    assert SHIPPED.forests == forests_id(DATA / "lips.npz"), "run benchmarks/calibrate.py --write"


def test_a_blurred_mouth_is_trusted_less_and_nothing_not_at_all():
    import cv2

    picture = plain(opened(0.25)).picture
    sharp = look_at(picture)
    looks = [look_at(cv2.GaussianBlur(picture, (0, 0), width)) for width in (3, 6)]
    values = [sharp.confidence, *(look.confidence for look in looks)]
    assert values == sorted(values, reverse=True) and values[0] > values[-1] + 0.05
    assert len(sharp.evidence) == len(Evidence._fields)
    nothing = look_at(np.full((200, 300, 3), 120, np.uint8))
    assert nothing.status == NO_MOUTH and nothing.confidence == 0


def test_the_package_reads_its_own_file():
    assert from_text((DATA / "confidence.json").read_text(encoding="utf-8")) == module.package_calibration()
