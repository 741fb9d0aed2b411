"""Average profiles of a corpus: of each speaker's repeats first, then of the speakers, each step with its spread.

Clips that agree in some fields, such as action and stickiness, are a group. In it every speaker counts once, however
many clips there are of each:

- a speaker's average is the average of that speaker's clips, each of which counts once;
- the group's average is that of the speakers' averages, and `between` is the standard deviation over the speakers;
- `within` is the standard deviation over the repeats of one speaker, pooled over the speakers who have repeats.

What is averaged is aligned first, by shape (`lipmetrics.average`).

Where clips have no speaker, all are taken as repeats of one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from corpus_tools.naming import Template
from corpus_tools.store import Store
from corpus_tools.wording import choices, nearest
from lipmetrics.compare import Average, average
from lipmetrics.compare.alignment import matched_mean
from lipmetrics.errors import InputError
from lipmetrics.profile import FRAMES, load_profile, rate_of_change
from lipmetrics.take import CHANNELS, Take
from lipmetrics.takes import profiles_in, take_of_profile

SPEAKERS = ("speaker", "actor", "person", "talker", "subject", "participant")
ACTIONS = ("slice", "action", "utterance", "statement", "word", "sentence")
LEVELS = ("stickiness", "level")
MEASURES = {
    "onset_s": "first open picture, s from the start of the clip",
    "rise_s": "from there to half the greatest height, s",
    "peak_height": "greatest height",
    "peak_width": "greatest width",
    "peak_area": "greatest area",
    "fastest_opening": "fastest growth of the height, per s, over 3 pictures",
}


@dataclass(frozen=True)
class Group:
    """Clips that agree in the fields `by`.

    fields : their values, in order
    average : of the speakers' averages; its `spread` (T, 3) is the one between speakers, NaN for one speaker
    within : (T, 3) standard deviation over a speaker's repeats, at the same moments; NaN where nobody has repeats
    speakers : average of each speaker's clips; its `spread` is the one within this speaker
    takes : of each speaker
    """

    fields: Mapping[str, object]
    average: Average
    within: np.ndarray
    speakers: Mapping[str, Average]
    takes: Mapping[str, Sequence[Take]]

    @property
    def label(self) -> str:
        return " ".join(str(value) for value in self.fields.values()) or "all"

    @property
    def clips_n(self) -> int:
        return sum(map(len, self.takes.values()))


def read_takes_of(
    source: str | Path, template: Template | None = None, on_misfit: Callable[[str, str], None] | None = None
) -> list[Take]:
    """Takes of a store, or of a folder of profiles whose names follow a template; `meta["fields"]` says of what.

    Parameters
    ----------
    on_misfit : called with the name and the reason for what cannot be averaged: an unknown mouth width, a gap, a
        profile that cannot be read, a name that does not fit; None raises

    Raises
    ------
    InputError : no store or profiles at `source`, or none that can be averaged
    """
    source = Path(source)
    misfits: list[str] = []

    def misfit(name: str, reason: str) -> None:
        misfits.append(reason)
        if on_misfit is None:
            raise InputError(reason)
        on_misfit(name, reason)

    if source.is_dir():
        found = _profiles(source, template, misfit)
    else:
        with Store(source) as store:
            found = store.takes(on_misfit=misfit)
    usable = []
    for take in found:
        try:
            take.array(CHANNELS)
        except InputError as error:
            misfit(take.name, str(error))
        else:
            usable.append(take)
    if not usable:
        why = f"; {misfits[-1]}" if misfits else ""
        raise InputError(f"expected clips that can be averaged in {source}, got none{why}")
    return usable


def default_fields(takes: Sequence[Take]) -> list[str]:
    """What to average by if nothing is said: the action or utterance, and the stickiness where it is known."""
    chosen = (_first(takes, ACTIONS), _first(takes, LEVELS))
    return [field for field in chosen if field]


def speaker_field(takes: Sequence[Take]) -> str | None:
    """The field that says whose mouth it is."""
    return _first(takes, SPEAKERS)


def average_groups(
    takes: Sequence[Take], by: Sequence[str], *, progress: Callable[[], None] | None = None
) -> list[Group]:
    """Average the takes group by group, speakers first, at the highest rate of all takes.

    Parameters
    ----------
    by : fields whose values make a group; none: all takes are one
    progress : called after each group

    Returns
    -------
    groups : in order of their values, numbers by size

    Raises
    ------
    InputError : a field that no take has
    """
    known = list(dict.fromkeys(field for take in takes for field in _fields(take)))
    for field in by:
        if field not in known:
            raise InputError(
                f"expected fields out of {choices(known) if known else 'none'}, got {nearest(field, known)}"
            )
    whose = speaker_field(takes)
    rate_hz = max((take.rate_hz for take in takes if len(take.time_s) > 1), default=25.0)
    sorted_takes: dict[tuple, dict[str, list[Take]]] = {}
    for take in sorted(takes, key=lambda one: one.name):
        fields = _fields(take)
        key = tuple(fields.get(field) for field in by)
        speaker = "" if whose is None or fields.get(whose) is None else str(fields[whose])
        sorted_takes.setdefault(key, {}).setdefault(speaker, []).append(take)
    groups = []
    for key in sorted(sorted_takes, key=lambda values: [order(value) for value in values]):
        own = dict(sorted(sorted_takes[key].items(), key=lambda item: order(item[0])))
        groups.append(_group(dict(zip(by, key, strict=True)), own, rate_hz))
        if progress is not None:
            progress()
    return groups


def measures(take: Take) -> dict[str, float]:
    """The numbers of `MEASURES` of one take; onset and rise are NaN where it never opens."""
    height = take.channels["height"]
    known = np.isfinite(height)
    found = dict.fromkeys(MEASURES, math.nan)
    for channel in CHANNELS:
        found[f"peak_{channel}"] = float(np.nanmax(take.channels[channel]))
    rates = rate_of_change(height, take.time_s)
    if np.isfinite(rates).any():
        found["fastest_opening"] = float(np.nanmax(rates))
    is_open = np.flatnonzero(known & (height > 0))
    if len(is_open):
        onset_s = take.time_s[is_open[0]]
        half = np.flatnonzero(known & (height >= found["peak_height"] / 2))[0]
        found |= {"onset_s": float(onset_s - take.time_s[0]), "rise_s": float(take.time_s[half] - onset_s)}
    return found


def summary_table(groups: Sequence[Group]) -> pd.DataFrame:
    """A row per group: its fields, speakers_n, clips_n, and of each measure the mean, `_between` and `_within`.

    The mean is over the speakers' means; the spreads are as of the curves.
    """
    rows = []
    for group in groups:
        row: dict[str, object] = {**group.fields, "speakers_n": len(group.takes), "clips_n": group.clips_n}
        values = {who: pd.DataFrame([measures(take) for take in takes]) for who, takes in group.takes.items()}
        for name in MEASURES:
            per_speaker = [table[name].dropna().to_numpy() for table in values.values()]
            row |= dict(zip((name, f"{name}_between", f"{name}_within"), _two_spreads(per_speaker), strict=True))
        rows.append(row)
    return _typed(pd.DataFrame(rows), groups)


def speakers_table(groups: Sequence[Group]) -> pd.DataFrame:
    """A row per group and speaker: clips_n, and of each measure the mean and `_within`, over this speaker's clips."""
    rows = []
    for group in groups:
        for who, takes in group.takes.items():
            table = pd.DataFrame([measures(take) for take in takes])
            row: dict[str, object] = {**group.fields, "speaker": who, "clips_n": len(takes)}
            for name in MEASURES:
                row |= {name: table[name].mean(), f"{name}_within": table[name].std(ddof=1)}
            rows.append(row)
    return _typed(pd.DataFrame(rows), groups)


def curves_table(groups: Sequence[Group]) -> pd.DataFrame:
    """A row per group and moment: time_s, and of each channel the mean, `_between` and `_within`; `time_between_s`."""
    tables = []
    for group in groups:
        made = group.average
        columns: dict[str, object] = {**group.fields, "time_s": made.time_s}
        for c, channel in enumerate(made.channels):
            spreads = (made.mean[:, c], made.spread[:, c], group.within[:, c])
            columns |= dict(zip((channel, f"{channel}_between", f"{channel}_within"), spreads, strict=True))
        tables.append(pd.DataFrame(columns | {"time_between_s": made.time_spread_s}))
    return _typed(pd.concat(tables, ignore_index=True), groups)


def order(value: object) -> tuple:
    """Sort key: numbers by size, then words, then what is unknown."""
    if value is None:
        return (2, 0.0, "")
    try:
        return (0, float(value), str(value))
    except (TypeError, ValueError):
        return (1, 0.0, str(value))


def _group(fields: dict[str, object], takes: dict[str, list[Take]], rate_hz: float) -> Group:
    speakers = {who: average(own, rate_hz=rate_hz, name=who) for who, own in takes.items()}
    whole = average(list(speakers.values()), rate_hz=rate_hz, name=" ".join(map(str, fields.values())) or "all")
    total, freedom = np.zeros_like(whole.mean), 0
    for path, (who, made) in zip(whole.paths, speakers.items(), strict=True):
        n = len(takes[who])
        if n > 1:
            variance = matched_mean(path[:, 0], made.spread[path[:, 1]] ** 2, len(whole.mean))
            total, freedom = total + (n - 1) * variance, freedom + n - 1
    within = np.sqrt(total / freedom) if freedom else np.full_like(whole.mean, np.nan)
    return Group(fields, whole, within, speakers, takes)


def _typed(table: pd.DataFrame, groups: Sequence[Group]) -> pd.DataFrame:
    """Fields of whole numbers stay so where some clips lack them; mixed ones become text."""
    for field in groups[0].fields if groups else ():
        known = [group.fields[field] for group in groups if group.fields[field] is not None]
        if all(isinstance(value, int) for value in known):
            table[field] = table[field].astype("Int64")
        elif not all(isinstance(value, int | float) for value in known):
            table[field] = table[field].map(lambda value: value if value is None else str(value))
    return table


def _two_spreads(per_speaker: Iterable[np.ndarray]) -> tuple[float, float, float]:
    """Mean of the speakers' means, their standard deviation, and the pooled one within speakers."""
    known = [values for values in per_speaker if len(values)]
    if not known:
        return (math.nan,) * 3
    means = np.array([values.mean() for values in known])
    freedom = sum(len(values) - 1 for values in known)
    squares = sum(float(np.square(values - values.mean()).sum()) for values in known)
    between = float(means.std(ddof=1)) if len(means) > 1 else math.nan
    within = math.sqrt(squares / freedom) if freedom else math.nan
    mean, noise = float(means.mean()), 1e-9 * float(np.abs(means).max())
    return mean, *(0.0 if spread < noise else spread for spread in (between, within))


def _profiles(folder: Path, template: Template | None, misfit: Callable[[str, str], None]) -> list[Take]:
    tables = profiles_in(folder)
    if not tables:
        raise InputError(
            f"expected profiles (*{FRAMES}) or a store of 'lipmetrics corpus run', got {folder} without any"
        )
    found = []
    for path in tables:
        stem = Path(path).name.removesuffix(FRAMES)
        try:
            fields = {} if template is None else template.parse(stem)
            take = take_of_profile(load_profile(path), stem)
        except InputError as error:
            misfit(stem, str(error))
        else:
            take.meta["fields"] = fields
            found.append(take)
    return found


def _fields(take: Take) -> Mapping[str, object]:
    return take.meta.get("fields", {})


def _first(takes: Sequence[Take], candidates: Sequence[str]) -> str | None:
    for field in candidates:
        if any(_fields(take).get(field) is not None for take in takes):
            return field
    return None
