"""Answers of an A/B study as one long table, and questions to it: who, which action, how often a against b."""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from study.design import Design, load_design, stimuli_from_codes, stimuli_from_csv
from study.errors import InputError
from study.wording import nearest, short

REQUIRED = ("participant", "left", "right", "chosen")
DATA = Path(__file__).parent / "data"
#: class of speed of the thesis's actions, from its sections 5.1.2 and 5.1.4 (see data/SOURCE.md)
THESIS_SPEED = {
    "open_fast": "fast",
    "p": "fast",
    "puppy": "fast",
    "open_slow": "slow",
    "m": "slow",
    "mummy": "slow",
}
#: which slow action is the fast one's counterpart
THESIS_MATCHES = {"open_fast": "open_slow", "p": "m", "puppy": "mummy"}
_CONDITIONS = ("participant", "action", "level", "audio", "speed")
_TEXT = ("participant", "left", "right", "chosen", "kind", "action", "speed", "expected")


@dataclasses.dataclass(frozen=True)
class Preference:
    """How often a was chosen against b.

    Parameters
    ----------
    for_a, for_b, ties : answers
    """

    for_a: int
    for_b: int
    ties: int = 0

    @property
    def n(self) -> int:
        """Answers for one or the other, ties left out."""
        return self.for_a + self.for_b

    @property
    def ratio(self) -> float:
        """Preference ratio for_a / for_b; infinite if b was never chosen, NaN without answers."""
        if self.for_b:
            return self.for_a / self.for_b
        return np.inf if self.for_a else np.nan

    @property
    def share(self) -> float:
        """for_a / n; NaN without answers."""
        return self.for_a / self.n if self.n else np.nan


@dataclasses.dataclass(frozen=True)
class Choices:
    """Answers to "a or b?" as arrays, for the statistics.

    Parameters
    ----------
    y : (N,) 1 for a, 0 for b, 0.5 for a tie
    person, item : (N,) index of the participant and of the pair of videos, from 0
    persons, items : their names
    table : (N) rows of the answers they come from
    """

    y: np.ndarray
    person: np.ndarray
    item: np.ndarray
    persons: tuple[str, ...]
    items: tuple[str, ...]
    table: pd.DataFrame


@dataclasses.dataclass(frozen=True)
class Answers:
    """A long table of answers.

    Parameters
    ----------
    table : one row per answer: participant, left, right, chosen ('' for a tie), pair (name of the pair of videos, the
        same whichever stands left), action, level_left, level_right, audio (0 or 1), speed, kind (test, practice or
        catch), trial (position in the session, from 1), and further columns as they came
    levels : of the whole study, least first; numbers if all are
    source : where it comes from, in words
    sides_known : whether `left` and `right` say where the videos stood; False: nothing can be said about sides
    positions_known : whether `trial` says in which order the participant answered
    matches : which slow action is the counterpart of a fast one, {fast: slow}; None if there are no such pairs
    """

    table: pd.DataFrame
    levels: tuple = ()
    source: str = ""
    sides_known: bool = True
    positions_known: bool = True
    matches: Mapping[str, str] | None = None

    def __len__(self) -> int:
        return len(self.table)

    @property
    def participants(self) -> list[str]:
        return _in_order(self.table["participant"].unique())

    @property
    def levels_shown(self) -> list:
        """Levels that come in these answers, least first."""
        shown = set(_levels_of(self.table))
        return [one for one in self.levels if one in shown]

    @property
    def actions(self) -> list[str]:
        """Actions in the order in which they come in the table of pairs."""
        return list(dict.fromkeys(self.table.sort_values("_order", kind="stable")["action"]))

    @functools.cached_property
    def tests(self) -> Answers:
        """Without practice and catch trials."""
        return dataclasses.replace(self, table=self.table[self.table["kind"] == "test"])

    def where(self, **conditions) -> Answers:
        """The answers that meet all conditions: a column and the value, or several values, that it must have.

        `level` asks that both videos have one of the levels. `where(action="m", audio=1, level=[0, 7])`.

        Raises
        ------
        InputError : no such column, or a value that never comes in it
        """
        keep = np.ones(len(self.table), dtype=bool)
        for name, wanted in conditions.items():
            if name == "level":
                ranks = self._ranks(wanted)
                keep &= np.isin(self._arrays["left"], ranks) & np.isin(self._arrays["right"], ranks)
                continue
            if name not in self.table or name.startswith("_"):
                known = [*_CONDITIONS, *(c for c in self.table if c not in _CONDITIONS and not c.startswith("_"))]
                raise InputError(f"expected a column of the answers, got {nearest(name, known)}")
            codes, present = self._codes(name)
            values = [str(int(one)) if isinstance(one, (bool, np.bool_)) else str(one) for one in _several(wanted)]
            for one in values:
                if one not in present:
                    raise InputError(f"expected a value that {name} has, got {nearest(one, sorted(present))}")
            keep &= np.isin(codes, [present[one] for one in values])
        part = dataclasses.replace(self, table=self.table[keep])
        part.__dict__["_arrays"] = {name: array[keep] for name, array in self._arrays.items()}
        return part

    def preference(self, a: Iterable, b: Iterable) -> Preference:
        """How often a level of `a` was chosen in trials against a level of `b` (levels, or several)."""
        _, y = self._asked(a, b)
        return Preference(int((y == 1).sum()), int((y == 0).sum()), int((y == 0.5).sum()))

    def choices(self, a: Iterable, b: Iterable) -> Choices:
        """The trials of a level of `a` against a level of `b`, as arrays.

        Raises
        ------
        InputError : an unknown level, or one that is in both
        """
        return self._choices(*self._asked(a, b))

    def left_chosen(self) -> Choices:
        """y = 1 where the video on the left was chosen, 0.5 for a tie, as arrays."""
        return self._choices(np.ones(len(self), dtype=bool), self._arrays["left_won"])

    def higher_chosen(self) -> Choices:
        """y = 1 where the higher of the two levels was chosen, 0 for the lower, 0.5 for a tie."""
        left, right = self._arrays["left"], self._arrays["right"]
        keep = left != right
        won = self._arrays["left_won"][keep]
        return self._choices(keep, np.where((left > right)[keep], won, 1 - won))

    def sticky(self) -> tuple[list, list]:
        """The levels above the least, and the least: the question "with the effect or without?"."""
        if len(self.levels) < 2:
            raise InputError(f"expected at least two levels, got {', '.join(map(str, self.levels)) or 'none'}")
        return list(self.levels[1:]), list(self.levels[:1])

    def _asked(self, a, b) -> tuple[np.ndarray, np.ndarray]:
        """Which answers put a level of `a` against one of `b` (N,), and y of those."""
        a, b = self._ranks(a), self._ranks(b)
        both = [self.levels[rank] for rank in a if rank in b]
        if both:
            raise InputError(f"expected different levels on the two sides, got {both[0]} on both")
        left, right = self._arrays["left"], self._arrays["right"]
        a_left = np.isin(left, a) & np.isin(right, b)
        keep = a_left | (np.isin(left, b) & np.isin(right, a))
        won = self._arrays["left_won"][keep]
        return keep, np.where(a_left[keep], won, 1 - won)

    def _choices(self, keep: np.ndarray, y: np.ndarray) -> Choices:
        table = self.table[keep]
        (person, persons), (item, items) = (
            _renumbered(self._arrays[code][keep], table[column])
            for code, column in (("person", "participant"), ("pair", "pair"))
        )
        return Choices(y, person, item, persons, items, table)

    @functools.cached_property
    def _arrays(self) -> dict[str, np.ndarray]:
        """(N) numbers for the columns that every question needs: person and pair in the order of their names, left and
        right as places in `levels`, left_won (1, 0, or 0.5 for a tie)."""
        table = self.table
        rank = {level: i for i, level in enumerate(self.levels)}
        left, right = (table[side].map(rank).to_numpy(dtype=np.int64) for side in ("level_left", "level_right"))
        chosen = table["chosen"].to_numpy(dtype=object)
        won = np.where(chosen == "", 0.5, (chosen == table["left"].to_numpy(dtype=object)).astype(float))
        return {
            "person": _numbered(table["participant"]),
            "pair": _numbered(table["pair"]),
            "left": left,
            "right": right,
            "left_won": won,
        }

    def _codes(self, column: str) -> tuple[np.ndarray, dict[str, int]]:
        """(N) numbers of the values of a column, and which number a value, as text, has."""
        codes, values = pd.factorize(self.table[column])
        texts: dict[str, int] = {}
        for code, value in enumerate(values):
            texts.setdefault(str(value), code)
        return codes, texts

    def _ranks(self, wanted) -> list[int]:
        by_text = {_plain(level): rank for rank, level in enumerate(self.levels)}
        found = []
        for one in _several(wanted):
            if _plain(one) not in by_text:
                raise InputError(f"expected a level of the answers, got {nearest(_plain(one), by_text)}")
            found.append(by_text[_plain(one)])
        return found


def choices_from(table: pd.DataFrame, y: np.ndarray) -> Choices:
    """Arrays of some rows of `Answers.table` and what was answered in them (N,)."""
    (person, persons), (item, items) = (
        _renumbered(_numbered(table[column]), table[column]) for column in ("participant", "pair")
    )
    return Choices(np.asarray(y, dtype=float), person, item, persons, items, table)


def _numbered(column: pd.Series) -> np.ndarray:
    """(N) places of the values in the order of their names."""
    codes, names = pd.factorize(column)
    place = np.empty(len(names), dtype=np.int64)
    place[[list(names).index(name) for name in _in_order(names)]] = np.arange(len(names))
    return place[codes]


def _renumbered(codes: np.ndarray, column: pd.Series) -> tuple[np.ndarray, tuple[str, ...]]:
    """Codes without gaps, and the names that they stand for."""
    _, first, codes = np.unique(codes, return_index=True, return_inverse=True)
    return codes, tuple(column.iloc[first])


def thesis_answers() -> Answers:
    """The 1,152 answers of the thesis's study (study/data/SOURCE.md), sides not known, order known.

    `left` is the video of the lower level, wherever it stood.
    """
    questions = pd.read_csv(DATA / "questions.csv")
    answers = pd.read_csv(DATA / "answers.csv").merge(questions, on="question", how="left", validate="many_to_one")
    table = answers.rename(
        columns={
            "position": "trial",
            "chosen_video": "chosen",
            "video_1": "left",
            "video_2": "right",
            "level_1": "level_left",
            "level_2": "level_right",
        }
    )
    table["speed"] = table["action"].map(THESIS_SPEED)
    source = "M. I. Leach, Physically-based Animation of 'Sticky Lips', thesis, Sheffield 2020, appendix A"
    answers = answers_from(table, source=source, name="the thesis's answers")
    return dataclasses.replace(answers, sides_known=False, matches=THESIS_MATCHES)


def load_answers(
    path: str | Path,
    *,
    design: Design | str | Path | None = None,
    stimuli: str | Path | None = None,
    levels: Sequence | None = None,
) -> Answers:
    """Answers of a CSV with a row per answer and at least participant, left, right and chosen.

    What the codes of the videos stand for comes from, first to last: columns of the table itself (level_left,
    level_right, action, audio, speed), `stimuli` (a CSV with the columns stimulus, action, level, audio, speed),
    `design` (a design or its design.json), the codes themselves (puppy_7: action puppy, level 7). Other columns stay
    and can be asked for by name. `levels` gives the order of levels, the least first, where their names do not (numbers
    by size, words by the alphabet).

    Raises
    ------
    InputError : no such file, a column missing, a choice that was not shown, an answer twice, no answers
    """
    path = Path(path)
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
    except (OSError, ValueError) as error:
        raise InputError(f"expected a table of answers in {path}, but: {short(str(error))}") from None
    if isinstance(design, (str, Path)):
        design = load_design(design)
    known = stimuli_from_csv(stimuli) if stimuli else list(design.stimuli) if design else None
    return answers_from(table, known, levels=levels, source=str(path), name=str(path))


def answers_from(
    table: pd.DataFrame,
    stimuli=None,
    *,
    levels: Sequence | None = None,
    source: str = "",
    name: str = "the answers",
) -> Answers:
    """Answers of a table as `load_answers` reads it; `stimuli` is a list of `study.design.Stimulus` or None."""
    table = table.rename(columns=lambda column: str(column).strip().lower()).reset_index(drop=True)
    missing = [column for column in REQUIRED if column not in table]
    if missing:
        raise InputError(
            f"{name}: expected the columns {', '.join(REQUIRED)}, got {short(', '.join(table)) or 'none'}; "
            f"rename or add {', '.join(missing)}"
        )
    if not len(table):
        raise InputError(f"{name}: expected at least one answer, got only a header")
    for column in _TEXT:
        if column in table:
            table[column] = table[column].fillna("").astype(str).str.strip()
    if "session" in table:  # of somebody whose place another participant took
        table = table[table["session"].astype(str) != "replaced"].reset_index(drop=True)
    positions_known = "trial" in table
    if "kind" not in table:
        table["kind"] = "test"
    table["kind"] = table["kind"].where(table["kind"] != "", "test")
    _check(table, name)
    table = _with_attributes(table, stimuli, name)
    if positions_known:
        table["trial"] = _numbers(table["trial"], "trial", name)
    else:
        table["trial"] = table.groupby("participant").cumcount() + 1
    table["_order"] = _pair_order(table)
    return Answers(table, _level_order(table, levels, name), source, True, positions_known)


def _check(table: pd.DataFrame, name: str) -> None:
    def first(wrong: pd.Series) -> int:
        return int(np.flatnonzero(wrong.to_numpy())[0])

    for column in ("participant", "left", "right"):
        empty = table[column] == ""
        if empty.any():
            raise InputError(f"{name}, answer {first(empty) + 1}: expected a {column}, got an empty cell")
    same = table["left"] == table["right"]
    if same.any():
        row = first(same)
        raise InputError(f"{name}, answer {row + 1}: expected two different videos, got {table['left'][row]} twice")
    wrong = (table["chosen"] != table["left"]) & (table["chosen"] != table["right"]) & (table["chosen"] != "")
    if wrong.any():
        row = first(wrong)
        shown = [table["left"][row], table["right"][row]]
        raise InputError(
            f"{name}, answer {row + 1}: expected chosen to be {shown[0]}, {shown[1]} or empty (a tie), "
            f"got {nearest(table['chosen'][row], shown)}"
        )
    if "trial" in table:
        twice = table.duplicated(["participant", "trial"])
        if twice.any():
            row = first(twice)
            raise InputError(
                f"{name}: expected one answer per participant and trial, got trial {table['trial'][row]} of "
                f"participant {table['participant'][row]} twice"
            )


def _with_attributes(table: pd.DataFrame, stimuli, name: str) -> pd.DataFrame:
    codes = sorted(set(table["left"]) | set(table["right"]))
    needs = [c for c in ("level_left", "level_right", "action", "audio", "speed") if c not in table]
    if needs:
        if stimuli is None:
            stimuli = stimuli_from_codes(codes)
        by_code = {one.code: one for one in stimuli}
        for code in codes:
            if code not in by_code:
                raise InputError(f"{name}: expected videos of the design, got {nearest(code, by_code)}")
        of = {
            "level_left": ("left", "level"),
            "level_right": ("right", "level"),
            "action": ("left", "action"),
            "audio": ("left", "audio"),
            "speed": ("left", "speed"),
        }
        for column in needs:
            side, attribute = of[column]
            table[column] = table[side].map({code: getattr(one, attribute) for code, one in by_code.items()})
    for column in ("action", "speed"):
        table[column] = table[column].fillna("").astype(str)
    audio = table["audio"].astype(str).str.strip().str.lower()
    yes, no = audio.isin(["1", "true", "yes", "1.0"]), audio.isin(["0", "false", "no", "0.0", "", "nan"])
    if not (yes | no).all():
        raise InputError(f"{name}: expected 0 or 1 under audio, got '{short(audio[~(yes | no)].iloc[0])}'")
    table["audio"] = yes.astype(int)
    levels = {column: table[column].astype(str).str.strip() for column in ("level_left", "level_right")}
    as_numbers = {column: pd.to_numeric(text, errors="coerce") for column, text in levels.items()}
    if all(np.isfinite(one).all() for one in as_numbers.values()):
        whole = all((one == one.round()).all() for one in as_numbers.values())
        levels = {column: one.astype(int) if whole else one.astype(float) for column, one in as_numbers.items()}
    for column, values in levels.items():
        table[column] = values
    low = np.where(table["left"] < table["right"], table["left"], table["right"])
    high = np.where(table["left"] < table["right"], table["right"], table["left"])
    table["pair"] = [f"{a} {b}" for a, b in zip(low, high, strict=True)]
    return table


def _pair_order(table: pd.DataFrame) -> pd.Series:
    """Place of the pair: by question where the table numbers them, else by first appearance."""
    if "question" in table:
        numbers = pd.to_numeric(table["question"], errors="coerce")
        if numbers.notna().all():
            return numbers
    return pd.Series(pd.factorize(table["pair"])[0], index=table.index)


def _numbers(column: pd.Series, what: str, name: str) -> pd.Series:
    numbers = pd.to_numeric(column, errors="coerce")
    wrong = ~np.isfinite(numbers)
    if wrong.any():
        raise InputError(f"{name}: expected numbers under {what}, got '{short(str(column[wrong].iloc[0]))}'")
    return numbers.astype(int)


def _level_order(table: pd.DataFrame, wanted: Sequence | None, name: str) -> tuple:
    found = _levels_of(table)
    if wanted is None:
        return tuple(found)
    by_text = {_plain(level): level for level in found}
    wanted = [_plain(one) for one in _several(wanted)]
    if sorted(wanted) != sorted(by_text):
        raise InputError(
            f"{name}: expected each of the levels {', '.join(by_text)} once, the least first, got {', '.join(wanted)}"
        )
    return tuple(by_text[one] for one in wanted)


def _levels_of(table: pd.DataFrame) -> list:
    return _in_order(pd.unique(table[["level_left", "level_right"]].to_numpy().ravel()))


def _several(wanted) -> list:
    if isinstance(wanted, (str, bytes)) or not isinstance(wanted, Iterable):
        return [wanted]
    return list(wanted)


def _plain(level) -> str:
    text = str(level).strip()
    try:
        return f"{float(text):g}"
    except ValueError:
        return text


def _in_order(values: Iterable) -> list:
    """Sorted as a person would: 2 before 10, also within names."""

    def key(value):
        parts = re.split(r"(\d+(?:\.\d+)?)", str(value))
        return [(0, float(part), "") if i % 2 else (1, 0.0, part) for i, part in enumerate(parts) if part or i % 2]

    return sorted((v.item() if isinstance(v, np.generic) else v for v in values), key=key)
