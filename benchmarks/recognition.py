"""Which band and local cost recognise movements best, on simulated and on real takes, and how well the defaults do.

    LIPMETRICS_BENCHMARK_CACHE=out python benchmarks/recognition.py --write

Settings are compared on the part `tune` and judged on the part `report`: other faces and seeds, other people.

- Simulated: six utterances, spoken by twelve faces, at four levels of stickiness, twice each, with timings, strengths and
  noise of their own (utterances.py). A take is compared with the average of each utterance. `tune`: averages of five
  faces recognise the sixth, in turn. `report`: averages of the six `tune` faces recognise the six others.
- Real: nobody says anything twice in the reference clips. So a repeat is made of what is there: a piece of 2.5 s as
  the detector measured it is the reference; the same piece as MediaPipe measured it, put through a seeded warp of
  its timing and cut a little elsewhere, is what is to be recognised among all pieces of its part. Differences of
  measuring are real here, differences of timing are not.
"""

from __future__ import annotations

import argparse
import itertools

import numpy as np
import pandas as pd
import utterances
from results import markdown, write_section
from utterances import REPORT_FACES, TUNE_FACES, UTTERANCES, Spoken, clip_names, detected, landmarks, seeded

from lipmetrics.compare import BAND, COST, averages, classify_all, confusion
from lipmetrics.compare.pairs import pairs
from lipmetrics.take import CHANNELS, Take

BANDS = (None, 0.0, 0.02, 0.05, 0.1, 0.2, 0.3)
COSTS = ("absolute", "squared")
CHANNEL_SETS = (CHANNELS, ("width", "height"), ("width",), ("height",), ("area",))
REAL_REPEATS = 4


# -- simulated --------------------------------------------------------------------------------------------------------


def grouped(takes: list[Spoken]) -> dict[str, list[Take]]:
    """Utterance -> its takes."""
    return {label: [one.take for one in takes if one.utterance == label] for label in UTTERANCES}


def recognised(training: list[Spoken], queries: list[Spoken], **settings: object) -> tuple[list[str], list]:
    """True labels and classifications of takes by the averages of others."""
    made = averages(grouped(training), channels=settings["channels"], band=settings["band"], rate_hz=RATE_HZ)
    found = classify_all([one.take for one in queries], made, rate_hz=RATE_HZ, **settings)
    return [one.utterance for one in queries], found


RATE_HZ = 60.0


def folds(takes: list[Spoken], part: str) -> list[tuple[list[Spoken], list[Spoken]]]:
    """(training, queries) of a part: one face left out in turn, or the other part's faces."""
    if part == "report":
        training, queries = ([one for one in takes if one.face in faces] for faces in (TUNE_FACES, REPORT_FACES))
        return [(training, queries)]
    return [
        ([one for one in takes if one.face in TUNE_FACES and one.face != face], [one for one in takes if one.face == face])
        for face in TUNE_FACES
    ]


def simulated_rates(takes: list[Spoken], part: str, channels=CHANNELS, measure: str = "dtw") -> pd.DataFrame:
    """Share recognised: a row for each band, a column for each cost."""
    table = {}
    for band, cost in itertools.product(BANDS, COSTS):
        right = []
        for training, queries in folds(takes, part):
            labels, found = recognised(training, queries, channels=channels, band=band, cost=cost, measure=measure)
            right += [one.label == label for label, one in zip(labels, found, strict=True)]
        table[_of(band), cost] = np.mean(right)
    return pd.Series(table).unstack(sort=False)


def _of(band: float | None) -> str:
    return "none" if band is None else f"{band:g}"


# -- real -------------------------------------------------------------------------------------------------------------


def real_takes(part: str) -> tuple[list[Take], list[Take], np.ndarray]:
    """References, repeats, and the reference (number) that each is a repeat of."""
    references, repeats, of = [], [], []
    for number, (name, piece, same) in enumerate(utterances.pieces(part)):
        references.append(piece)
        clip = name.rsplit("_", 1)[0]
        whole = landmarks(clip)
        whole = utterances.cut(whole, -np.inf, np.inf)
        shift = detected(clip).time_s[0] - whole.time_s[0]
        whole = Take(clip, whole.time_s + shift, {c: _bridged(whole.channels[c]) for c in CHANNELS}, source="mediapipe")
        for repeat in range(REAL_REPEATS):
            repeats.append(utterances.repeated(same, whole, seeded("real", name, repeat)))
            of.append(number)
    return references, repeats, np.array(of)


def _bridged(values: np.ndarray) -> np.ndarray:
    known = np.isfinite(values)
    return np.interp(np.arange(len(values)), np.flatnonzero(known), values[known])


def real_rates(made: tuple, channels=CHANNELS, measure: str = "dtw") -> pd.DataFrame:
    """Share of repeats whose nearest reference is their own: a row for each band, a column for each cost."""
    references, repeats, of = made
    table = {}
    for band, cost in itertools.product(BANDS, COSTS):
        found = pairs(repeats, references, channels=channels, band=band, cost=cost, clock="start", rate_hz=50)
        numbers = found.per_step if measure == "dtw" else found.hausdorff
        table[_of(band), cost] = np.mean(numbers.argmin(axis=1) == of)
    return pd.Series(table).unstack(sort=False)


def same_clip() -> tuple[int, int, int]:
    """Second halves of clips whose nearest first half is of the same clip; of how many; how many of the same person."""
    halves = [[], []]
    people = []
    for name in clip_names():
        take = detected(name)
        middle = (take.time_s[0] + take.time_s[-1]) / 2
        both = [utterances.cut(take, -np.inf, middle, name), utterances.cut(take, middle, np.inf, name)]
        if all(np.isfinite(one.channels["height"]).all() for one in both):
            for side, one in zip(halves, both, strict=True):
                start = one.time_s[0]
                side.append(utterances.cut(one, start, start + 1.4))
            people.append(name)
    found = pairs(halves[1], halves[0], clock="start", rate_hz=50).per_step.argmin(axis=1)
    return int((found == np.arange(len(people))).sum()), len(people)


def grid_table() -> pd.DataFrame:
    """Distance per step between the six GRID clips; the two of one speaker come first."""
    names = ["grid_pwij3p", "grid_id2", "grid_bbaf2n", "grid_lbax4n", "grid_lrwp9a", "grid_sbia1a"]
    takes = [detected(name) for name in names]
    found = pairs(takes, takes, clock="start").per_step
    labels = ["s2, place white in j three please", "s2, set white with p two soon", *(name[5:] for name in names[2:])]
    table = pd.DataFrame(found, index=labels, columns=labels)
    return table.where(~np.eye(len(names), dtype=bool)).rename_axis("GRID clip")
