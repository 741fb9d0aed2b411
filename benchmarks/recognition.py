"""Which band and local cost recognise movements best, on simulated and on real takes, and how well the defaults do.

    LIPMETRICS_BENCHMARK_CACHE=out python benchmarks/recognition.py --write

Settings are compared on the part `tune` and judged on the part `report`: other faces and seeds, other people.

- Simulated: six utterances, spoken by twelve faces, at four levels of stickiness, twice each, with timings, strengths
  and noise of their own (utterances.py). A take is compared with the average of each utterance. `tune`: averages of
  five faces recognise the sixth, in turn. `report`: averages of the six `tune` faces recognise the six others.
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
import reference
import utterances
from results import markdown, write_section
from utterances import REPORT_FACES, TUNE_FACES, UTTERANCES, Spoken, clip_names, detected, landmarks, seeded

from lipmetrics.compare import COST, RECOGNITION_BAND, averages, classify_all, confusion
from lipmetrics.compare.classes import MEASURES, of_measure
from lipmetrics.compare.pairs import pairs
from lipmetrics.take import CHANNELS, Take

BANDS = (None, 0.0, 0.02, 0.05, 0.1, 0.2)
COSTS = ("absolute", "squared")
CHANNEL_SETS = (CHANNELS, ("width",), ("height",), ("area",))
REAL_REPEATS = 3
RATE_HZ = 60.0


# -- simulated --------------------------------------------------------------------------------------------------------


def grouped(takes: list[Spoken]) -> dict[str, list[Take]]:
    """Utterance -> its takes."""
    return {label: [one.take for one in takes if one.utterance == label] for label in UTTERANCES}


def folds(takes: list[Spoken], part: str) -> list[tuple[list[Spoken], list[Spoken]]]:
    """(training, queries) of a part: one face left out in turn, or the other part's faces."""
    if part == "report":
        training, queries = ([one for one in takes if one.face in faces] for faces in (TUNE_FACES, REPORT_FACES))
        return [(training, queries)]
    return [
        (
            [one for one in takes if one.face in TUNE_FACES and one.face != face],
            [one for one in takes if one.face == face],
        )
        for face in TUNE_FACES
    ]


def simulated_rates(takes: list[Spoken], part: str, channels=CHANNELS) -> dict[str, pd.DataFrame]:
    """Measure -> share recognised: a row for each band, a column for each cost."""
    table = {measure: {} for measure in MEASURES}
    for band in BANDS:
        right = {key: [] for key in itertools.product(MEASURES, COSTS)}
        for training, queries in folds(takes, part):
            made = averages(grouped(training), channels=channels, band=band, rate_hz=RATE_HZ)
            true = np.array([list(made).index(one.utterance) for one in queries])
            for cost in COSTS:
                settings = {"channels": channels, "band": band, "cost": cost, "clock": "start", "rate_hz": RATE_HZ}
                found = pairs([one.take for one in queries], list(made.values()), **settings)
                for measure in MEASURES:
                    right[measure, cost] += list(of_measure(found, measure).argmin(axis=1) == true)
        for (measure, cost), hits in right.items():
            table[measure][cost, _of(band)] = np.mean(hits)
    return {measure: _wide(rates) for measure, rates in table.items()}


def _wide(table: dict[tuple[str, str], float]) -> pd.DataFrame:
    """(column, row) -> value as a table, in the order given."""
    columns = dict.fromkeys(column for column, _ in table)
    return pd.DataFrame({one: {row: v for (column, row), v in table.items() if column == one} for one in columns})


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
        shift = detected(clip).time_s[0] - whole.time_s[0]
        whole = Take(clip, whole.time_s + shift, {c: _bridged(whole.channels[c]) for c in CHANNELS}, source="mediapipe")
        for repeat in range(REAL_REPEATS):
            repeats.append(utterances.repeated(same, whole, seeded("real", name, repeat)))
            of.append(number)
    return references, repeats, np.array(of)


def _bridged(values: np.ndarray) -> np.ndarray:
    known = np.isfinite(values)
    return np.interp(np.arange(len(values)), np.flatnonzero(known), values[known])


def real_rates(made: tuple, channels=CHANNELS) -> dict[str, pd.DataFrame]:
    """Measure -> share of repeats whose nearest reference is their own: a row for each band, a column for each cost."""
    references, repeats, of = made
    table = {measure: {} for measure in MEASURES}
    for band, cost in itertools.product(BANDS, COSTS):
        found = pairs(repeats, references, channels=channels, band=band, cost=cost, clock="start", rate_hz=50)
        for measure in MEASURES:
            table[measure][cost, _of(band)] = np.mean(of_measure(found, measure).argmin(axis=1) == of)
    return {measure: _wide(rates) for measure, rates in table.items()}


def same_clip() -> tuple[int, int]:
    """How many second halves of clips are nearest to the first half of the same clip; of how many."""
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
    settings = {"band": RECOGNITION_BAND, "clock": "start", "rate_hz": 50}
    found = pairs(halves[1], halves[0], **settings).per_step.argmin(axis=1)
    return int((found == np.arange(len(people))).sum()), len(people)


def grid_table() -> pd.DataFrame:
    """Distance per step between the six GRID clips; the two of one speaker come first."""
    names = ["grid_pwij3p", "grid_id2", "grid_bbaf2n", "grid_lbax4n", "grid_lrwp9a", "grid_sbia1a"]
    takes = [detected(name) for name in names]
    found = pairs(takes, takes, clock="start").per_step
    labels = ["s2, place white in j three please", "s2, set white with p two soon", *(name[5:] for name in names[2:])]
    table = pd.DataFrame(found, index=labels, columns=labels)
    return table.where(~np.eye(len(names), dtype=bool)).rename_axis("GRID clip")


# -- tables -----------------------------------------------------------------------------------------------------------


def every_rate(takes: list[Spoken], made: tuple, part: str) -> dict:
    """(source, channels, measure) -> rates by band and cost."""
    rates = {}
    for channels in CHANNEL_SETS:
        found = {"simulated": simulated_rates(takes, part, channels)}
        if made:
            found["real"] = real_rates(made, channels)
        for source, of_source in found.items():
            rates |= {(source, channels, measure): table for measure, table in of_source.items()}
    return rates


def settings_table(rates: dict, part: str) -> str:
    """Rates of all bands, costs and channels, simulated and real."""
    tables = []
    for (source, channels, measure), table in rates.items():
        if measure == "hausdorff" and channels != CHANNELS:
            continue
        rows = 100 * table.T
        what = " + ".join(channels) + (", Hausdorff" if measure == "hausdorff" else "")
        rows.index = [f"{source}, {what}, {cost}" for cost in rows.index]
        tables.append(rows)
    return markdown(pd.concat(tables).rename_axis(f"`{part}`: recognised, %; columns: band").round(1), 1)


def chosen_band(rates: dict, counts: dict[str, int]) -> tuple[str, pd.Series]:
    """The widest band within a standard error of the best mean rate of simulated and real takes, absolute cost.

    counts : source -> number of takes that the rates are of
    """
    by_source = pd.DataFrame({source: rates[source, CHANNELS, "dtw"][COST] for source in counts})
    mean = by_source.mean(axis=1)
    best = by_source.loc[mean.idxmax()]
    error = np.sqrt(sum(best[source] * (1 - best[source]) / count for source, count in counts.items())) / len(counts)
    order = sorted((name for name in mean.index if name != "none"), key=float)
    return [name for name in order if mean[name] >= mean.max() - error][-1], mean


def confusions(takes: list[Spoken], channels=CHANNELS) -> tuple[pd.DataFrame, float]:
    """Held-out takes by the default settings: true utterance in rows, found one in columns; and the share right."""
    ((training, queries),) = folds(takes, "report")
    made = averages(grouped(training), channels=channels, rate_hz=RATE_HZ)
    found = classify_all([one.take for one in queries], made, channels=channels, rate_hz=RATE_HZ)
    table = confusion([one.utterance for one in queries], found)
    table = table.loc[list(UTTERANCES), list(UTTERANCES)]
    return table, float(np.trace(table.to_numpy()) / table.to_numpy().sum())


def by_level(takes: list[Spoken]) -> pd.Series:
    """Share of held-out takes recognised at each level of stickiness."""
    ((training, queries),) = folds(takes, "report")
    made = averages(grouped(training), rate_hz=RATE_HZ)
    found = classify_all([one.take for one in queries], made, rate_hz=RATE_HZ)
    right = [one.label == query.utterance for one, query in zip(found, queries, strict=True)]
    return pd.Series(right).groupby([query.level for query in queries]).mean()


def held_out(takes: list[Spoken], made: tuple) -> str:
    """Recognition of the `report` part by the defaults."""
    table, share = confusions(takes)
    _, by_height = confusions(takes, ("height",))
    levels = ", ".join(f"{100 * rate:.0f} % at level {level:g}" for level, rate in by_level(takes).items())
    table.index.name = "spoken by faces that no average has seen; columns: found"
    text = f"Simulated: {100 * share:.0f} % of {table.to_numpy().sum()} right, one in {len(UTTERANCES)} by chance;\n"
    text += f"{levels}; by the height alone {100 * by_height:.0f} %.\n\n{markdown(table, 0)}"
    if not made:
        return text
    references, repeats, of = made
    rows = {}
    for channels in (CHANNELS, ("height",)):
        settings = {"band": RECOGNITION_BAND, "clock": "start", "rate_hz": 50}
        found = pairs(repeats, references, channels=channels, **settings).per_step.argmin(axis=1)
        clips = np.array([one.name.rsplit("_", 1)[0] for one in references])
        rows[" + ".join(channels)] = {
            "own piece": f"{(found == of).sum()}",
            "another piece of the same clip": f"{((found != of) & (clips[found] == clips[of])).sum()}",
            "another clip": f"{(clips[found] != clips[of]).sum()}",
        }
    table = pd.DataFrame(rows).T
    table.index.name = f"real: what {len(repeats)} repeats of {len(references)} pieces were taken for"
    right, count = same_clip()
    text += f"\n{markdown(table, 0)}\nOther words of the same person: {count} clips were cut into halves;"
    text += " the first 1.4 s of a second\n"
    text += f"half were nearest to those of the clip's own first half in {right} (1 by chance).\n"
    return text + "\nDistance per step between GRID sentences (all different):\n\n" + markdown(grid_table(), 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write the section of RESULTS.md")
    arguments = parser.parse_args()
    takes = utterances.spoken((*TUNE_FACES, *REPORT_FACES))
    real = {part: real_takes(part) if reference.reference_folder() else () for part in ("tune", "report")}
    rates = {part: every_rate(takes, real[part], part) for part in ("tune", "report")}
    text = "## Recognition\n\n`python benchmarks/recognition.py --write`; what is what stands at its head.\n"
    if real["tune"]:
        counts = {"simulated": sum(one.face in TUNE_FACES for one in takes), "real": len(real["tune"][1])}
        band, mean = chosen_band(rates["tune"], counts)
        means = ", ".join(f"{name} {100 * rate:.1f}" for name, rate in mean.items())
        text += f"Defaults: band {RECOGNITION_BAND:g}, {COST} cost. The widest band within a standard error of the best"
        text += f" on `tune`\nis {band} (mean of simulated and real, three channels, %: {means}).\n"
    for part in ("tune", "report"):
        text += f"\n### Band and local cost, `{part}`\n\n{settings_table(rates[part], part)}"
    text += f"\n### Held-out takes, defaults\n\n{held_out(takes, real['report'])}"
    print(text)
    if arguments.write:
        write_section("recognition", text)


if __name__ == "__main__":
    main()
