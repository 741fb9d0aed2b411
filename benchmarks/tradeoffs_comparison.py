"""The comparison's run time against its error: band and sampling rate.

- Known warping: a smooth movement of `OWN_HZ` samples per second, and the same at other times, warped as much as the
  utterances of recognition.py are, both with the noise of measuring (utterances.py). Errors are of the time that
  `align` matches with each moment, mean over the movement, and of the lag.
- Recognition: simulated utterances of the `tune` faces, one face left out in turn, as in recognition.py.

Time is that of `pairs` per pair, resampling included, on one thread.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import findings
import numpy as np
import pandas as pd
import recognition
import utterances
from results import markdown
from timing import relative
from tradeoff_figure import Panel, Point, draw

from lipmetrics.compare import BAND, RECOGNITION_BAND, align, averages, pairs
from lipmetrics.compare.alignment import weighted_quantile
from lipmetrics.take import CHANNELS, Take

FIGURE = findings.FIGURES / "tradeoff_comparison.png"
BANDS = (None, 0.02, 0.05, 0.1, 0.2)
OWN_HZ = 60  # of the takes, which is what they are compared at where no rate is given
RATES_HZ = (25, OWN_HZ, 100, 200)
PAIRS = 60
DURATION_S = 2.4
FINE_S = 0.002  # step of what is known
Case = tuple[float | None, int]  # band, rate
CASES: tuple[Case, ...] = tuple(itertools.product(BANDS, RATES_HZ))


@dataclass(frozen=True)
class Warped:
    """a, b : takes; moments_s : (K,) times of a, `later_s` the times of b that are the same; moving : (K,) weights, how
    far the movement goes around each moment"""

    a: Take
    b: Take
    moments_s: np.ndarray
    later_s: np.ndarray
    moving: np.ndarray

    @property
    def lag_s(self) -> float:
        """As `align` defines it."""
        return weighted_quantile(self.later_s - self.moments_s, self.moving, 0.5)


def movement(random: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    """From times (T,), s, to width, height and area (T, 3), mouth widths: a few openings, closed at both ends."""
    centres = np.sort(random.uniform(0.4, DURATION_S - 0.4, random.integers(2, 5)))
    widths, heights = random.uniform(0.08, 0.2, len(centres)), random.uniform(0.05, 0.25, len(centres))

    def at(time_s: np.ndarray) -> np.ndarray:
        height = (heights * np.exp(-(((time_s[:, None] - centres) / widths) ** 2))).sum(axis=1)
        width = 0.7 * (1 - np.exp(-12 * height))
        return np.stack([width, height, 0.7 * width * height], axis=1)

    return at


def warping(random: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    """From times of a movement to those of the same movement said once more: another start, tempo, and local tempo."""
    tempo = np.exp(random.normal(0, utterances.TEMPO_SD))
    depth = np.clip(random.normal(0, utterances.LOCAL_TEMPO_SD), -0.4, 0.4)
    phase, lead_s = random.uniform(0, 2 * np.pi), random.uniform(-0.15, 0.15)

    def later(time_s: np.ndarray) -> np.ndarray:
        turn = 2 * np.pi * time_s / DURATION_S + phase
        bent = time_s + depth * DURATION_S / (2 * np.pi) * (np.sin(turn) - np.sin(phase))
        return lead_s + tempo * bent

    return later


def warped(number: int, rate_hz: float = OWN_HZ) -> Warped:
    """A pair of takes whose warping is known, from its number."""
    random = utterances.seeded("warped", number)
    at, later = movement(random), warping(random)
    moments = np.arange(0, DURATION_S, FINE_S)
    same = later(moments)
    wide = np.arange(-1.0, DURATION_S + 1.0, FINE_S)
    a_s, b_s = (np.arange(0, end, 1 / rate_hz) for end in (DURATION_S, float(same[-1])))
    before = np.interp(b_s, later(wide), wide)  # times of a that b's samples belong to
    takes = [
        utterances.noisy(Take(name, times, dict(zip(CHANNELS, at(same_as).T, strict=True)), source="truth"), random)
        for name, times, same_as in (("a", a_s, a_s), ("b", b_s, before))
    ]
    moving = np.abs(np.gradient(at(moments), axis=0)).sum(axis=1) * (same >= 0)
    return Warped(*takes, moments, same, moving)


def errors_ms(made: Sequence[Warped], band: float | None, rate_hz: float | None = None) -> dict[str, float]:
    """Mean errors of the matched time and of the lag, ms, and the share of pairs whose path is kept in by the band."""
    matched, lag, kept_in = [], [], []
    for one in made:
        found = align(one.a, one.b, band=band, rate_hz=rate_hz)
        off = np.abs(found.to_b(one.moments_s) - one.later_s)
        matched.append(1e3 * np.average(off, weights=one.moving))
        lag.append(1e3 * abs(found.lag_s - one.lag_s))
        kept_in.append(found.at_band > 0.05)
    return {"time": float(np.mean(matched)), "lag": float(np.mean(lag)), "kept_in": float(np.mean(kept_in))}


def times_per_pair_s(made: Sequence[Warped], repeats: int) -> dict[Case, float]:
    """Processor time of a pair for each case, the best of some, all cases in turn, s."""
    takes, references = [one.a for one in made], [one.b for one in made]
    best = dict.fromkeys(CASES, np.inf)
    for number in range(repeats + 1):  # the first compiles
        for band, rate_hz in CASES:
            began = time.process_time()
            pairs(takes, references, band=band, rate_hz=rate_hz, threads=1)
            if number:
                best[band, rate_hz] = min(best[band, rate_hz], time.process_time() - began)
    return {case: each / len(takes) ** 2 for case, each in best.items()}


def not_recognised(takes: Sequence[utterances.Spoken], band: float | None, rate_hz: float) -> float:
    """Percent of the `tune` takes whose nearest average is of another utterance."""
    wrong = []
    for training, queries in recognition.folds(list(takes), "tune"):
        if not training or not queries:
            continue
        made = averages(recognition.grouped(training), band=band, rate_hz=rate_hz)
        true = np.array([list(made).index(one.utterance) for one in queries])
        found = pairs([one.take for one in queries], list(made.values()), band=band, rate_hz=rate_hz, clock="start")
        wrong += list(found.per_step.argmin(axis=1) != true)
    return 100 * float(np.mean(wrong))


def tables(repeats: int, count: int = PAIRS, takes: Sequence[utterances.Spoken] | None = None) -> str:
    """The table of all cases, and the figure."""
    made = [warped(number) for number in range(count)]
    takes = utterances.spoken(utterances.TUNE_FACES) if takes is None else takes
    seconds = times_per_pair_s(made[:20], repeats)
    share = relative(seconds, (BAND, OWN_HZ))
    rows, points = {}, []
    for band, rate_hz in CASES:
        errors = errors_ms(made, band, rate_hz)
        wrong = not_recognised(takes, band, rate_hz)
        points.append((band, rate_hz, share[band, rate_hz], errors["time"], errors["lag"], wrong))
        rows[f"{name(band)}, {rate_hz} Hz"] = {
            "us per pair": 1e6 * seconds[band, rate_hz],
            "time, default = 1": share[band, rate_hz],
            "error of the matched time, ms": errors["time"],
            "error of the lag, ms": errors["lag"],
            "kept in by the band, % of pairs": 100 * errors["kept_in"],
            "not recognised, %": wrong,
        }
    figure(points)
    table = pd.DataFrame(rows).T.rename_axis("band, samples per second")
    return (
        f"{count} pairs of takes whose warping is known, {OWN_HZ} samples per second of their own; {len(takes)} takes\n"
        f"of {len({one.utterance for one in takes})} utterances, averages of other faces. Defaults: band {BAND:g}, for "
        f"recognition {RECOGNITION_BAND:g}, at the takes' own rate.\nFigure: docs/figures/tradeoff_comparison.png.\n\n"
        f"{markdown(table)}"
    )


def name(band: float | None) -> str:
    """Of a band."""
    return "no band" if band is None else f"band {band:g}"


def figure(points: Sequence[tuple]) -> None:
    """Points of band, rate, relative time, and the three errors: a panel for each error, a line for each rate."""
    labels = {
        "known warping: matched time": "error of the matched time, mean, ms",
        "known warping: lag": "error of the lag, mean, ms",
        "recognition": "utterances not recognised, %",
    }
    panels = []
    order = sorted(points, key=lambda point: (point[1], np.inf if point[0] is None else point[0]))
    for column, (title, label) in enumerate(labels.items(), 3):
        default = (RECOGNITION_BAND if title == "recognition" else BAND, OWN_HZ)
        shown = [
            Point(
                ("default: " if point[:2] == default else "") + ("none" if point[0] is None else f"{point[0]:g}"),
                *(point[2], point[column], point[:2] == default, f"{point[1]} Hz"),
            )
            for point in order
        ]
        panels.append(Panel(title, label, shown, joined=True))
    draw(panels, FIGURE, "Comparison: run time against error, by band and sampling rate",
         f"processor time per pair, band {BAND:g} at {OWN_HZ} Hz = 1")  # fmt: skip
