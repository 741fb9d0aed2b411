"""Score the takes of models against real takes: how far off, in relation to how far real takes are from one another.

A clip's score in a metric is its mean distance to the real takes of the same utterance, speakers counting alike. The
same number of every real take is the floor (`lipmetrics.floors`): a score is given with its percentile in the floor and
its ratio to the floor's median. A distance is the metric itself where it compares two takes (`curves`), and the
absolute difference of two takes' values where it describes one (`movement`, `sticky`).

Intervals are percentile bootstrap intervals that draw the speakers of the references and the speakers (or, unknown,
the clips) of the model; utterances are taken as they are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from lipmetrics import floors
from lipmetrics.compare import BAND, COST
from lipmetrics.errors import InputError
from lipmetrics.intervals import DRAWS, FEWEST_CLUSTERS, LEVEL, cluster_counts, compare_paired, holm
from lipmetrics.labels import Labels, labels_of_name
from lipmetrics.measuring import AT_BAND, ZERO, Measure, Measuring, all_measures
from lipmetrics.metrics import HIGHER
from lipmetrics.take import CHANNELS, Take, same_unit

ANY_UTTERANCE = "all takes"
FEWEST_SPEAKERS = 5  # of a model: with fewer, models are compared by utterance
MOST_AT_BAND = 0.1  # share of the paths at the edge of the band that is not mentioned
MOST_AT_ONCE = 4_000_000  # elements of the largest array of a bootstrap


@dataclass(frozen=True)
class Settings:
    """How to score.

    channels : of the curves that are compared
    cost, band : local cost and Sakoe-Chiba band of the alignment, as in `lipmetrics.align`
    rate_hz : samples per second of the compared curves; None: the higher of the two takes' rates
    allow_mixed_units : compare lengths in different units as if they were one
    same_speaker : compare a clip with the takes of its own speaker only
    draws, level, seed : of the bootstrap
    """

    channels: tuple[str, ...] = CHANNELS
    cost: str = COST
    band: float | None = BAND
    rate_hz: float | None = None
    allow_mixed_units: bool = False
    same_speaker: bool = False
    draws: int = DRAWS
    level: float = LEVEL
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Labelled:
    """A take and its labels; `path` is where it came from, if it came from a file."""

    take: Take
    labels: Labels = field(default_factory=Labels)
    path: str = ""

    @property
    def utterance(self) -> str:
        return self.labels.utterance or ANY_UTTERANCE


@dataclass
class Score:
    """Scores of models. `better` of a metric says which way is nearer; `bias` is model minus real.

    clips : a row per model, clip and metric: value with its interval (`low`, `high`), bias, and for each floor that can
        be had `percentile_<floor>` and `ratio_<floor>`
    utterances, overall : the same averaged over the clips of an utterance, and over the utterances, with intervals
    floors : a row per utterance, metric and kind of floor: number of takes, median and quantiles
    floor_values : (utterance, metric, kind) -> (n,) the floor itself
    comparisons : a row per pair of models and metric
    measures : the metrics, in order
    primary : the kind of floor that percentiles without further word refer to, or None
    notes : what limits the numbers, a sentence each
    failed : take -> why it was passed over
    pair_values : (model, utterance) -> (clips, real takes, metrics), signed values of pairs
    """

    clips: pd.DataFrame
    utterances: pd.DataFrame
    overall: pd.DataFrame
    floors: pd.DataFrame
    floor_values: dict[tuple[str, str, str], np.ndarray]
    comparisons: pd.DataFrame
    measures: tuple[Measure, ...]
    models: dict[str, list[Labelled]]
    references: list[Labelled]
    settings: Settings
    primary: str | None
    unit: str
    notes: list[str]
    failed: dict[str, str]
    pair_values: dict[tuple[str, str], np.ndarray] = field(default_factory=dict, repr=False)

    def clip_distances(self, model: str, clip: Labelled, measure: Measure) -> np.ndarray:
        """Distances (n,) of a clip in a metric to the real takes of its utterance, in their order."""
        same = [one for one in self.models[model] if one.utterance == clip.utterance]
        values = self.pair_values[model, clip.utterance][same.index(clip), :, self.measures.index(measure)]
        return _distance(measure, values)


def score(
    models: Mapping[str, Sequence[Take | Labelled]] | Sequence[Take | Labelled],
    references: Sequence[Take | Labelled],
    *,
    names: str | None = None,
    settings: Settings | None = None,
    measuring: Measuring | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Score:
    """Score takes of one model, or of several by name, against real takes.

    Parameters
    ----------
    models : takes of a model, or name -> takes
    references : real takes
    names : pattern of the takes' names, such as "{speaker}_{utterance}_{repeat}"; None: takes that are not `Labelled`
        are all one utterance of unknown speakers
    measuring : the metrics; None: all of `lipmetrics.metrics` that need curves or openings
    progress : called with the number of pairs done and of all pairs

    Raises
    ------
    InputError : no takes, mixed units that were not allowed, no model take of an utterance that was really said
    """
    settings = settings or Settings()
    named = dict(models) if isinstance(models, Mapping) else {"model": models}
    named = {name: [_labelled(take, names) for take in takes] for name, takes in named.items()}
    real = [_labelled(take, names) for take in references]
    if not real:
        raise InputError("expected one real take or more as the reference, got none")
    empty = [name for name, takes in named.items() if not takes]
    if empty or not named:
        raise InputError(f"expected one take or more of each model, got none of {', '.join(empty) or 'any'}")
    everything = [one.take for one in (*real, *(one for takes in named.values() for one in takes))]
    unit = same_unit(everything, allow_mixed=settings.allow_mixed_units)
    if measuring is None:
        measuring = all_measures(
            channels=settings.channels,
            cost=settings.cost,
            band=settings.band,
            rate_hz=settings.rate_hz,
            mixed_units=settings.allow_mixed_units,
        )
    return _Scoring(named, real, settings, measuring, unit, progress or (lambda done, of: None)).run()


def _labelled(take: Take | Labelled, names: str | None) -> Labelled:
    if isinstance(take, Labelled):
        return take
    return Labelled(take, labels_of_name(take.name, names) if names else Labels())


class _Scoring:
    """One run: distances first, then everything that is computed from them."""

    def __init__(self, models, references, settings: Settings, measuring: Measuring, unit: str, progress) -> None:
        self.models, self.references = models, references
        self.settings, self.measuring, self.unit, self.progress = settings, measuring, unit, progress
        self.failed: dict[str, str] = {}
        self.notes: list[str] = []
        self.drawn: dict[str, tuple] = {}

    def run(self) -> Score:
        self._take_values()
        self._match_utterances()
        self._number_speakers()
        self._distances()
        kinds = self._floor_kinds()
        clips, utterances, overall, floor_rows, floor_values = [], [], [], [], {}
        for measure in self.measuring.measures:
            for u in self.utterances:
                for kind in kinds:
                    values = self._floor(u, measure, kind, np.ones((1, self.speakers_n)))[0][0]
                    floor_values[u, measure.name, kind] = _shown(measure, values[np.isfinite(values)])
                    floor_rows.append(_floor_row(u, measure, kind, floor_values[u, measure.name, kind]))
            for model in self.models:
                rows = self._rows(model, measure, kinds)
                clips += rows[0]
                utterances += rows[1]
                overall += rows[2]
        clips = pd.DataFrame(clips)
        self._describe(kinds)
        return Score(
            clips,
            pd.DataFrame(utterances),
            pd.DataFrame(overall),
            pd.DataFrame(floor_rows, columns=FLOOR_COLUMNS),
            floor_values,
            self._compare(clips),
            self.measuring.measures,
            self.models,
            self.references,
            self.settings,
            kinds[0] if kinds else None,
            self.unit,
            self.notes,
            self.failed,
            self.to_real,
        )

    # -- what there is ------------------------------------------------------------------------------------------------

    def _take_values(self) -> None:
        """Values of single takes; a take that cannot be measured is passed over."""
        names = [measure.name for measure in self.measuring.measures if not measure.of_pair]
        self.values: dict[int, np.ndarray] = {}

        def usable(one: Labelled) -> bool:
            try:
                found = self.measuring.take(one.take)
                self.measuring.pair(one.take, one.take)  # finds what would spoil each of its pairs
            except InputError as error:
                self.failed[one.path or one.take.name] = str(error)
                return False
            self.values[id(one)] = np.array([found.get(name, math.nan) for name in names], float)
            return True

        self.references = [one for one in self.references if usable(one)]
        self.models = {name: [one for one in takes if usable(one)] for name, takes in self.models.items()}
        if not self.references:
            raise InputError(f"expected a real take that can be compared, got none; {_first(self.failed)}")
        for name, takes in self.models.items():
            if not takes:
                raise InputError(f"expected a take of {name} that can be compared, got none; {_first(self.failed)}")

    def _match_utterances(self) -> None:
        """Model takes of utterances that nobody really said are passed over."""
        said = list(dict.fromkeys(one.utterance for one in self.references))
        mute = all(one.labels.utterance is None for one in self.references)
        for name, takes in self.models.items():
            kept = []
            for one in takes:
                same = one.utterance in said
                if same and self.settings.same_speaker:
                    speakers = {r.labels.speaker for r in self.references if r.utterance == one.utterance}
                    same = one.labels.speaker is not None and one.labels.speaker in speakers
                    why = f"expected a real take of speaker {one.labels.speaker} saying '{one.utterance}', found none"
                else:
                    why = f"expected a real take of the utterance '{one.utterance}', found none among {_some(said)}"
                if same:
                    kept.append(one)
                else:
                    self.failed[one.path or one.take.name] = why
            if not kept:
                hint = "; the real takes have no utterances: label them too" if mute else ""
                raise InputError(
                    f"expected a take of {name} with an utterance that a real take has, got none: "
                    f"{_first(self.failed)}{hint}"
                )
            self.models[name] = kept
        used = {one.utterance for takes in self.models.values() for one in takes}
        self.utterances = [u for u in said if u in used]
        unused = [u for u in said if u not in used]
        if unused:
            self.notes.append(f"No model has a take of {len(unused)} of the real utterances: {_some(unused)}.")
        self.real = {u: [one for one in self.references if one.utterance == u] for u in self.utterances}

    def _number_speakers(self) -> None:
        """Each unknown speaker is one by itself; their numbers are one list over all utterances."""
        number: dict = {}
        for takes in self.real.values():
            for one in takes:
                number.setdefault(self._who(one), len(number))
        self.speakers_n = len(number)
        self.speaker = {u: np.array([number[self._who(one)] for one in takes]) for u, takes in self.real.items()}
        self.speaker_number = number
        self.speakers_known = all(one.labels.speaker is not None for takes in self.real.values() for one in takes)

    @staticmethod
    def _who(one: Labelled):
        return one.labels.speaker if one.labels.speaker is not None else id(one)

    def _distances(self) -> None:
        """For each utterance: model takes x real takes x metrics, and real takes x real takes x metrics."""
        self.to_real: dict[tuple[str, str], np.ndarray] = {}  # signed values of pairs
        self.among: dict[str, np.ndarray] = {}
        self.clips_of = {
            (m, u): [one for one in takes if one.utterance == u] for m, takes in self.models.items() for u in self.real
        }
        self.at_bands: dict[str, list[float]] = {m: [] for m in self.models}
        pairs = sum(len(takes) * len(self.real[u]) for (_, u), takes in self.clips_of.items())
        pairs += sum(len(takes) * (len(takes) - 1) // 2 for takes in self.real.values())
        done = 0
        for u, real in self.real.items():
            n, k = len(real), len(self.measuring.measures)
            among = np.full((n, n, k), np.nan)
            for i in range(n):
                for j in range(i + 1, n):
                    among[i, j] = among[j, i] = self._pair(real[i], real[j])  # only sizes count, not signs
                    done += 1
                    self.progress(done, pairs)
            self.among[u] = among
            for m in self.models:
                clips = self.clips_of[m, u]
                values = np.full((len(clips), n, k), np.nan)
                for i, clip in enumerate(clips):
                    for j, one in enumerate(real):
                        values[i, j] = self._pair(one, clip)
                        self.at_bands[m].append(self.at_band)
                        done += 1
                        self.progress(done, pairs)
                self.to_real[m, u] = values

    def _pair(self, real: Labelled, other: Labelled) -> np.ndarray:
        """Values of a pair in the order of the metrics; other minus real for those of single takes."""
        try:
            found = self.measuring.pair(real.take, other.take)
        except InputError as error:
            self.failed[f"{real.path or real.take.name} with {other.path or other.take.name}"] = str(error)
            found = {}
        self.at_band = float(found.get(AT_BAND, 0.0))  # of the pair just aligned
        out = np.full(len(self.measuring.measures), np.nan)
        single = [k for k, measure in enumerate(self.measuring.measures) if not measure.of_pair]
        out[single] = self.values[id(other)] - self.values[id(real)]
        for k, measure in enumerate(self.measuring.measures):
            if measure.of_pair:
                out[k] = found.get(measure.name, math.nan)
        return out

    def _unit(self, measure: Measure) -> str:
        return measure.unit if self.unit == "mw" else measure.unit.replace("mw", self.unit)

    def _k(self, measure: Measure) -> int:
        return self.measuring.measures.index(measure)

    # -- numbers ------------------------------------------------------------------------------------------------------

    def _floor_kinds(self) -> list[str]:
        """The floors that can be had, the one that percentiles refer to first."""
        several = [len(set(groups)) > 1 for groups in self.speaker.values()]
        repeats = [len(set(groups)) < len(groups) for groups in self.speaker.values()]
        kinds = []
        if any(several):
            kinds.append(floors.SPEAKERS if self.speakers_known else floors.TAKES)
        if self.speakers_known and any(repeats):
            kinds.append(floors.REPEATS)
            if self.settings.same_speaker:
                kinds.reverse()
        return kinds

    def _floor(self, u: str, measure: Measure, kind: str, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The floor (B, n) of distances and its weights (B, n), for counts of speakers (B, S)."""
        distances = _distance(measure, self.among[u][:, :, self._k(measure)])
        groups = self.speaker[u]
        if kind == floors.REPEATS:
            values = np.broadcast_to(floors.within_group(distances, groups), (len(counts), len(groups)))
        else:
            values = floors.against_groups(floors.leave_group_out(distances, groups, self.speakers_n), counts)
        return values, counts[:, groups]

    def _scores(self, model: str, u: str, measure: Measure, counts: np.ndarray) -> np.ndarray:
        """Scores (B, m) of a model's clips of an utterance."""
        distances = _distance(measure, self.to_real[model, u][:, :, self._k(measure)])
        means = floors.group_means(distances, self.speaker[u], self.speakers_n)
        if self.settings.same_speaker:
            own = np.array([self.speaker_number[self._who(one)] for one in self.clips_of[model, u]], int)
            return np.broadcast_to(means[np.arange(len(own)), own], (len(counts), len(own)))
        return floors.against_groups(means, counts)

    def _counts(self, model: str) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """Drawn counts of the references' speakers (B, S), of the model's clusters (B, K), and the clips' clusters."""
        if model in self.drawn:
            return self.drawn[model]
        takes = self.models[model]
        speakers = {one.labels.speaker for one in takes}
        by_speaker = None not in speakers and len(speakers) > 1
        number: dict = {}
        clusters = {
            u: np.array(
                [
                    number.setdefault(one.labels.speaker if by_speaker else id(one), len(number))
                    for one in self.clips_of[model, u]
                ],
                int,
            )
            for u in self.utterances
        }
        draws, seed = self.settings.draws, self.settings.seed
        both = cluster_counts(self.speakers_n, draws, seed), cluster_counts(len(number), draws, seed + 1)
        self.drawn[model] = (*both, clusters)
        return self.drawn[model]

    def _rows(self, model: str, measure: Measure, kinds: list[str]) -> tuple[list[dict], list[dict], list[dict]]:
        counts, own_counts, _ = self._counts(model)
        plain = self._numbers(model, measure, kinds, np.ones((1, self.speakers_n)), np.ones((1, own_counts.shape[1])))
        clusters_n = (counts.shape[1], own_counts.shape[1])
        drawn = self._numbers(model, measure, kinds, counts, own_counts) if max(clusters_n) > 1 else plain
        clips, utterances = [], []
        head = {"model": model}
        what = {"metric": measure.name, "unit": self._unit(measure), "better": measure.better}
        for u in self.utterances:
            for i, one in enumerate(self.clips_of[model, u]):
                label = {"take": one.take.name, "utterance": u, "speaker": one.labels.speaker or ""}
                label |= {"repeat": one.labels.repeat or "", **what}
                numbers = self._with_limits(measure, plain["clips", u], drawn["clips", u], i)
                counted = self._counted(model, u, measure, i)
                clips.append(head | label | numbers | counted)
            if self.clips_of[model, u]:
                numbers = self._with_limits(measure, plain["utterance", u], drawn["utterance", u], 0)
                size = {"clips_n": len(self.clips_of[model, u])}
                utterances.append(head | {"utterance": u, **what} | size | numbers)
        numbers = self._with_limits(measure, plain["overall"], drawn["overall"], 0)
        size = {
            "clips_n": len(self.models[model]),
            "utterances_n": sum(bool(self.clips_of[model, u]) for u in self.utterances),
        }
        bias = np.array([row["bias"] for row in clips if math.isfinite(row["bias"])])
        known = {name: sum(row[name] for row in clips) for name in ("references_n", "known_n")}
        size |= {"pairs_n": known["references_n"], "known_n": known["known_n"]}
        overall = head | what | size | numbers | {"bias": float(bias.mean()) if len(bias) else math.nan}
        return clips, utterances, [overall]

    def _numbers(self, model: str, measure: Measure, kinds: list[str], counts: np.ndarray, own: np.ndarray) -> dict:
        """Columns (B, .) of value and, for each floor, percentile, ratio and median, of clips, utterances and all."""
        _, _, clusters = self._counts(model)
        out: dict = {}
        parts = []
        for u in self.utterances:
            scores = self._scores(model, u, measure, counts)
            if scores.shape[1] == 0:
                continue
            columns = {"value": scores}
            medians = {}
            for kind in kinds:
                values, weights = self._floor(u, measure, kind, counts)
                columns[f"percentile_{kind}"] = _in_pieces(scores, values, weights)
                median = medians[kind] = floors.weighted_median(values, weights)
                columns[f"ratio_{kind}"] = _ratio(measure, scores, median[:, None])
            out["clips", u] = columns
            weight = own[:, clusters[u]]
            mean = {name: _weighted_mean(values, weight)[:, None] for name, values in columns.items()}
            for kind, median in medians.items():
                mean[f"ratio_{kind}"] = _ratio(measure, mean["value"], median[:, None])
                mean[f"median_{kind}"] = median[:, None]
            out["utterance", u] = mean
            parts.append(mean)
        overall = {name: _mean([part[name] for part in parts]) for name in parts[0]}
        for kind in kinds:
            both = [
                np.isfinite(part["value"]) & np.isfinite(part[f"median_{kind}"]) for part in parts
            ]  # the mean of the scores over the mean of the medians, of the same utterances
            value = _mean([np.where(b, part["value"], np.nan) for b, part in zip(both, parts, strict=True)])
            median = _mean([np.where(b, part[f"median_{kind}"], np.nan) for b, part in zip(both, parts, strict=True)])
            overall[f"ratio_{kind}"] = _ratio(measure, value, median)
            overall[f"median_{kind}"] = median
        out["overall"] = overall
        return out

    def _with_limits(self, measure: Measure, plain: dict, drawn: dict, i: int) -> dict:
        row = {}
        for name, values in plain.items():
            value = float(values[0, i])
            if name.startswith("median"):
                row[name] = float(_shown(measure, value))
                continue
            low, high = _limits(drawn[name][:, i], self.settings) if math.isfinite(value) else (math.nan, math.nan)
            if name == "value" and measure.better == HIGHER:
                value, low, high = -value, -high, -low
            prefix = "" if name == "value" else f"{name}_"
            row |= {name: value, f"{prefix}low": low, f"{prefix}high": high}
        return row

    def _counted(self, model: str, u: str, measure: Measure, i: int) -> dict:
        values = self.to_real[model, u][i, :, self._k(measure)]
        if self.settings.same_speaker:
            values = values[self.speaker[u] == self.speaker_number[self._who(self.clips_of[model, u][i])]]
        known = np.isfinite(values)
        signed = not measure.of_pair or measure.better == ZERO
        bias = float(values[known].mean()) if signed and known.any() else math.nan
        return {"bias": bias, "references_n": len(values), "known_n": int(known.sum())}

    # -- models against one another -----------------------------------------------------------------------------------

    def _compare(self, clips: pd.DataFrame) -> pd.DataFrame:
        rows = []
        names = list(self.models)
        for a in range(len(names)):
            for b in range(a + 1, len(names)):
                for measure in self.measuring.measures:
                    of = clips[clips["metric"] == measure.name]
                    first, second = (of[of["model"] == names[k]] for k in (a, b))
                    rows.append(self._paired(names[a], names[b], measure, first, second))
        rows = [row for row in rows if row]
        table = pd.DataFrame(rows, columns=COMPARISON_COLUMNS)
        if len(table):
            table["p_holm"] = np.concatenate(
                [holm(part["p"].to_numpy()) for _, part in table.groupby(["first", "second"], sort=False)]
            )
        return table

    def _paired(self, name_a: str, name_b: str, measure: Measure, first: pd.DataFrame, second: pd.DataFrame) -> dict:
        keys = ["utterance", "speaker", "repeat"]
        once = not first.duplicated(keys).any() and not second.duplicated(keys).any()
        both = first.merge(second, on=keys, suffixes=("_a", "_b")) if once else first.iloc[:0]
        item = "clip"
        if len(both) < len(first) or len(both) < len(second):
            # not clip by clip: the utterances' means are what both have
            item = "utterance"
            means = [
                part.groupby("utterance", sort=False)["value"].mean().rename(n)
                for part, n in ((first, "value_a"), (second, "value_b"))
            ]
            both = pd.concat(means, axis=1, join="inner").reset_index()
            both["speaker"] = ""
        if not (np.isfinite(both.get("value_a", np.nan)) & np.isfinite(both.get("value_b", np.nan))).any():
            return {}
        said, speakers = (len(set(both[name])) for name in ("utterance", "speaker"))
        cluster = item
        if item == "clip":
            cluster = "speaker" if speakers >= FEWEST_SPEAKERS else "utterance" if said > 1 else "clip"
        labels = both[cluster].to_numpy() if cluster in both else None
        found = compare_paired(
            both["value_a"].to_numpy(float),
            both["value_b"].to_numpy(float),
            None if labels is None else np.unique(labels, return_inverse=True)[1],
            draws=self.settings.draws,
            level=self.settings.level,
            seed=self.settings.seed,
        )
        nearer = (found.first_lower, found.second_lower)
        if measure.better == HIGHER:
            nearer = nearer[::-1]
        return {
            **{
                "first": name_a,
                "second": name_b,
                "metric": measure.name,
                "unit": self._unit(measure),
                "better": measure.better,
            },
            **{"mean_first": found.mean_first, "mean_second": found.mean_second, "difference": found.difference.value},
            **{"low": found.difference.low, "high": found.difference.high, "interval": found.difference.method},
            **{"p": found.test.p, "p_holm": math.nan, "p_exact": found.test.exact, "smallest_p": found.test.smallest_p},
            **{"first_nearer": nearer[0], "second_nearer": nearer[1], "items_n": found.items_n, "item": item},
            **{"cluster": cluster, "clusters_n": found.test.clusters},
        }

    # -- words --------------------------------------------------------------------------------------------------------

    def _describe(self, kinds: list[str]) -> None:
        takes = [one for real in self.real.values() for one in real]
        unlabelled = all(one.labels.utterance is None for one in takes)
        if unlabelled:
            self.notes.append(
                "No utterances are known, so all takes count as one utterance; --names or --list tells which is which."
            )
        if not self.speakers_known:
            floor = "the floor is of takes against takes and " if kinds else ""
            self.notes.append(
                f"Not every speaker is known, so {floor}intervals draw single takes: with several takes of one speaker "
                f"{'both are' if kinds else 'they are'} too narrow."
            )
        elif self.speakers_n == 1:
            self.notes.append(
                "All real takes are of one speaker: the floor between speakers cannot be had, and the score has no "
                "interval for the choice of speakers."
            )
        if self.speakers_known and floors.REPEATS not in kinds:
            self.notes.append("No speaker repeats an utterance: the floor of repeat against repeat cannot be had.")
        if not kinds:
            self.notes.append(
                "There is one real take of each utterance only: no floor can be had, so no percentile and no ratio."
            )
        if 1 < self.speakers_n < FEWEST_CLUSTERS:
            who = "speakers" if self.speakers_known else "real takes"
            self.notes.append(
                f"Intervals rest on {self.speakers_n} {who}; with fewer than {FEWEST_CLUSTERS} they are too narrow."
            )
        for kind in kinds:
            sizes = [len(groups) for groups in self.speaker.values()]
            if kind != floors.REPEATS and max(sizes) < 20:
                step = f"{100 / max(sizes):.0f} or coarser"
                self.notes.append(
                    f"An utterance has at most {max(sizes)} real takes: percentiles are in steps of {step}."
                )
                break
        for model, shares in self.at_bands.items():
            if np.mean(shares) > MOST_AT_BAND:
                share = f"{100 * np.mean(shares):.0f} % of the paths"
                self.notes.append(
                    f"{model}: {share} is at the edge of the band, so its lag is a lower bound; a wider --band shows "
                    "how late or early it is."
                )
        if self.settings.allow_mixed_units:
            self.notes.append("Mixed units were allowed: lengths are compared as if they were in one unit.")


FLOOR_COLUMNS = ["utterance", "metric", "floor", "takes_n", "median", "q05", "q25", "q75", "q95"]
COMPARISON_COLUMNS = [
    *("first", "second", "metric", "unit", "better", "mean_first", "mean_second", "difference", "low", "high"),
    *("interval", "p", "p_holm", "p_exact", "smallest_p", "first_nearer", "second_nearer", "items_n", "item"),
    *("cluster", "clusters_n"),
]


def _distance(measure: Measure, values: np.ndarray) -> np.ndarray:
    """Signed values to what is lower for nearer."""
    if measure.better == HIGHER and measure.of_pair:
        return -values
    return np.abs(values) if not measure.of_pair or measure.better == ZERO else values


def _shown(measure: Measure, distance):
    return -distance if measure.better == HIGHER and measure.of_pair else distance


def _ratio(measure: Measure, scores: np.ndarray, median: np.ndarray) -> np.ndarray:
    """Score over the floor's median; NaN where higher is nearer (a ratio says nothing) or the median is 0."""
    scores, median = np.broadcast_arrays(scores, median)
    usable = (median > 0) & (measure.better != HIGHER)
    return np.divide(scores, median, out=np.full(scores.shape, np.nan), where=usable)


def _in_pieces(scores: np.ndarray, floor: np.ndarray, weights: np.ndarray) -> np.ndarray:
    step = max(1, MOST_AT_ONCE // max(1, scores.shape[1] * floor.shape[1]))
    pieces = [slice(at, at + step) for at in range(0, len(scores), step)]
    return np.concatenate([floors.percentile(scores[s], floor[s], weights[s]) for s in pieces])


def _weighted_mean(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    weights = np.where(np.isfinite(values), weights, 0.0)
    total = weights.sum(axis=1)
    sums = (np.where(weights > 0, values, 0.0) * weights).sum(axis=1)
    return np.divide(sums, total, out=np.full(len(values), np.nan), where=total > 0)


def _mean(columns: list[np.ndarray]) -> np.ndarray:
    values = np.concatenate(columns, axis=1)
    return _weighted_mean(values, np.ones_like(values))[:, None]


def _limits(drawn: np.ndarray, settings: Settings) -> tuple[float, float]:
    drawn = drawn[np.isfinite(drawn)]
    if len(drawn) < max(2, settings.draws / 2):
        return math.nan, math.nan
    low, high = np.quantile(drawn, [(1 - settings.level) / 2, (1 + settings.level) / 2])
    return float(low), float(high)


def _floor_row(u: str, measure: Measure, kind: str, values: np.ndarray) -> dict:
    quantiles = np.quantile(values, [0.5, 0.05, 0.25, 0.75, 0.95]) if len(values) else np.full(5, np.nan)
    names = ("median", "q05", "q25", "q75", "q95")
    row = {"utterance": u, "metric": measure.name, "floor": kind, "takes_n": len(values)}
    return row | dict(zip(names, map(float, quantiles), strict=True))


def _first(failed: dict[str, str]) -> str:
    name, why = next(iter(failed.items()), ("", ""))
    return why if name and name in why else f"{name}: {why}"


def _some(names: Sequence[str], most: int = 5) -> str:
    text = ", ".join(f"'{name}'" for name in names[:most])
    return text + (f" and {len(names) - most} more" if len(names) > most else "")
