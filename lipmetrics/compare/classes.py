"""Which movement a take shows: the nearest of several averages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from lipmetrics.compare.curves import nearest_name
from lipmetrics.compare.pairs import Pairs, pairs
from lipmetrics.errors import InputError

MEASURES = ("dtw", "hausdorff")
MEASURE = "dtw"
# narrower than that of `align`: which movement it is lies in its timing too, and a wide band warps one into another.
# The best rate on simulated and real takes (docs/validation.md)
RECOGNITION_BAND = 0.02


@dataclass(frozen=True)
class Classification:
    """Labels from nearest to farthest.

    distances : of each label in `labels`
    margin : 1 - nearest / second nearest, 0 (a tie) to 1; NaN with one label
    """

    labels: tuple[str, ...]
    distances: tuple[float, ...]
    margin: float
    measure: str

    @property
    def label(self) -> str:
        """The nearest."""
        return self.labels[0]


def classify(take, averages, *, measure: str = MEASURE, **settings) -> Classification:
    """Rank averages by their distance to a take.

    Parameters
    ----------
    take : in any form `align` takes
    averages : {label: average}, or a sequence of Averages, whose names are the labels; takes serve too
    measure : 'dtw', mean cost per step of the path; 'hausdorff', of the aligned curves (as in the thesis, 5.3.2)
    settings : channels, rate_hz, cost, band (`RECOGNITION_BAND` unless given), clock ('start' unless given),
        seconds_per_unit, mixed_units

    Raises
    ------
    InputError : no averages, labels that occur twice, see `align`
    """
    return classify_all([take], averages, measure=measure, threads=1, **settings)[0]


def classify_all(takes: Sequence, averages, *, measure: str = MEASURE, **settings) -> list[Classification]:
    """`classify` of many takes, in threads (settings as there, and `threads`)."""
    nearest_name(measure, MEASURES, "measure")
    labels, references = _labelled(averages)
    if not len(takes):
        return []
    found = pairs(takes, references, **({"clock": "start", "band": RECOGNITION_BAND} | settings))
    return [_ranked(labels, row, measure) for row in of_measure(found, measure)]


def of_measure(found: Pairs, measure: str) -> np.ndarray:
    """(N, M) the numbers of `Pairs` that a measure goes by."""
    return found.per_step if measure == "dtw" else found.hausdorff


def confusion(true_labels: Sequence[str], found: Sequence[Classification]) -> pd.DataFrame:
    """How often each true label (row) was taken for each label (column), counts, in alphabetical order."""
    if len(true_labels) != len(found):
        raise InputError(f"expected one true label per take, got {len(true_labels)} for {len(found)}")
    names = sorted({*true_labels, *(label for one in found for label in one.labels)})
    table = pd.DataFrame(0, index=pd.Index(names, name="true"), columns=pd.Index(names, name="found"))
    for label, one in zip(true_labels, found, strict=True):
        table.loc[label, one.label] += 1
    return table


def _labelled(averages) -> tuple[list[str], list]:
    items = list(averages.items()) if isinstance(averages, Mapping) else [(one.name, one) for one in averages]
    labels = [str(label) for label, _ in items]
    if not labels:
        raise InputError("expected at least one average to classify by, got none")
    twice = sorted({label for label in labels if labels.count(label) > 1})
    if twice:
        raise InputError(f"expected every average to have a label of its own, got {', '.join(twice)} more than once")
    return labels, [one for _, one in items]


def _ranked(labels: Sequence[str], distances: np.ndarray, measure: str) -> Classification:
    order = np.argsort(distances, kind="stable")
    ranked = distances[order]
    margin = float("nan")
    if len(ranked) > 1:
        margin = float(1 - ranked[0] / ranked[1]) if ranked[1] > 0 else 0.0
    return Classification(tuple(labels[at] for at in order), tuple(map(float, ranked)), margin, measure)
