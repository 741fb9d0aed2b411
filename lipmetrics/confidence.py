"""How likely a frame was measured well, from what the default method knows of the frame anyway.

A frame is measured well when the mouth was found, the number of openings is right (so open or closed is too), and the
height of the largest opening is within 2 % of the mouth's width, or within 1 px where that is more. The likelihood is
a logistic function of four quantities, one for frames called open and one for frames called closed:

    confidence = 1 / (1 + exp(-(bias + sum of weights * min(feature, most)))),    weights >= 0

so it rises, or stays, with every feature of :func:`features`. `most` is the largest value in the frames that it was
fitted to: what is better than anything seen then is not trusted more, and what is worse is trusted less without limit.
Weights come from simulated clips (`benchmarks/calibrate.py`), as data/confidence.json.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lipmetrics.errors import InputError

FORMAT = "lipmetrics confidence 1"
FEATURES = ("border", "lips", "score", "margin")
LARGEST_MARGIN = 3.0


class Evidence(NamedTuple):
    """What is known of a frame in which a mouth was found.

    is_open : 1 if it was called open, else 0
    undecided_rows : p (1 - p) of opening, summed down the column of the mouth where that is most; canvas rows
    undecided_lip_rows : the same of lip or opening, mean over the columns
    score : how much the place looks like one mouth, 0 to 1
    margin : of the opening, counted or not, that was nearest to the other answer, |log((e + 1) / (e0 + 1))| with its
        evidence e and the evidence e0 that was needed
    """

    is_open: float
    undecided_rows: float
    undecided_lip_rows: float
    score: float
    margin: float


@dataclass(frozen=True)
class Logistic:
    """Of one answer, open or closed: `bias`, and of each of `FEATURES` a weight of at least 0 and where it ends."""

    bias: float
    weights: tuple[float, ...]
    most: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.weights) != len(FEATURES) or len(self.most) != len(FEATURES):
            raise InputError(f"expected a weight and an end for each of {', '.join(FEATURES)}")
        if not all(math.isfinite(x) for x in (self.bias, *self.weights, *self.most)) or min(self.weights) < 0:
            raise InputError("expected finite weights of at least 0")


@dataclass(frozen=True)
class Calibration:
    """forests : `forests_id` of the file that the weights were fitted with"""

    open: Logistic
    closed: Logistic
    forests: str = ""


def undecided(odds: np.ndarray) -> np.ndarray:
    """p (1 - p) summed down each column of log-odds (rows, cols): how many rows are undecided, times 1/4 at most."""
    half = np.tanh(0.5 * odds)
    return 0.25 * (1 - half * half).sum(axis=0)


def features(evidence: np.ndarray) -> np.ndarray:
    """Of evidence (..., 5) in the order of `Evidence` what is weighed, (..., 4); of each, more is better."""
    evidence = np.asarray(evidence, float)
    _, rows, lip_rows, score, margin = np.moveaxis(evidence, -1, 0)
    return np.stack(
        [-np.log(rows + 0.05), -np.log(lip_rows + 0.05), score, np.minimum(margin, LARGEST_MARGIN)], axis=-1
    )


def probability(evidence: np.ndarray, calibration: Calibration) -> np.ndarray:
    """Confidence, 0 to 1, of evidence (..., 5); 0 where anything is not finite."""
    evidence = np.asarray(evidence, float)
    known = np.isfinite(evidence).all(axis=-1)
    seen = features(np.where(known[..., None], evidence, 0.0))
    is_open = evidence[..., 0] > 0.5
    odds = np.where(is_open, *(_odds(seen, one) for one in (calibration.open, calibration.closed)))
    return np.where(known, 1 / (1 + np.exp(-np.clip(odds, -500, 500))), 0.0)


def _odds(seen: np.ndarray, one: Logistic) -> np.ndarray:
    return one.bias + np.minimum(seen, one.most) @ np.array(one.weights)


def confidence(evidence: Evidence) -> float:
    """As :func:`probability`, of one frame with the weights of the package; without arrays, which take longer."""
    if not all(map(math.isfinite, evidence)):
        return 0.0
    one = package_calibration().open if evidence.is_open > 0.5 else package_calibration().closed
    seen = (
        -math.log(evidence.undecided_rows + 0.05),
        -math.log(evidence.undecided_lip_rows + 0.05),
        evidence.score,
        min(evidence.margin, LARGEST_MARGIN),
    )
    odds = one.bias
    for value, weight, most in zip(seen, one.weights, one.most, strict=True):
        odds += weight * min(value, most)
    return 1 / (1 + math.exp(-min(max(odds, -500.0), 500.0)))


@lru_cache(maxsize=1)
def package_calibration() -> Calibration:
    """The weights that come with the package."""
    text = (resources.files("lipmetrics") / "data" / "confidence.json").read_text(encoding="utf-8")
    return from_text(text)


def from_text(text: str) -> Calibration:
    """Read what :func:`to_text` wrote; InputError for anything else."""
    try:
        found = json.loads(text)
        if found["format"] != FORMAT:
            raise ValueError(f"format {found['format']!r}")
        parts = {
            name: Logistic(
                float(found[name]["bias"]), *(tuple(map(float, found[name][of])) for of in ("weights", "most"))
            )
            for name in ("open", "closed")
        }
        return Calibration(**parts, forests=str(found["forests"]))
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"expected weights of the confidence ({FORMAT!r}), but: {error}") from None


def to_text(calibration: Calibration) -> str:
    """The weights as JSON."""
    return json.dumps({"format": FORMAT, "features": FEATURES} | asdict(calibration), indent=1) + "\n"


def forests_id(path: str | Path) -> str:
    """What tells one file of forests from another: weights fit the forests that they were fitted with."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()[:16]
