"""Words and phones of a clip: readers of Praat's TextGrid and of the alignments of GRID and Lombard GRID, and slices.

Times are from the start of the clip's video, s. Silences are left out.
"""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Collection
from pathlib import Path

from corpus_tools.clips import Clip, Slice
from corpus_tools.wording import choices, nearest, short
from lipmetrics.errors import InputError

ALIGN_UNITS_PER_S = 25_000  # samples of GRID's sound at 25 kHz; 1,000 of them are one of its 25 frames per second
SILENCES = {"", "sil", "sp", "<eps>", "<sil>", "#"}
ENDINGS = (".align", ".textgrid", ".json")

_ALIGN_LINE = re.compile(r"(\d{1,12})\s+(\d{1,12})\s+(\S+)")
_PHONE = re.compile(r"(.+)_([BIES])")  # with its place in the word: begin, inside, end, single


def read_slices(path: str | Path) -> tuple[Slice, ...]:
    """Read the words, phones and other intervals of `.align`, `.TextGrid` or Lombard GRID's `.json`, in order of time.

    Raises
    ------
    InputError : a file of another kind, one that cannot be read, or one that breaks its format
    """
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        raise InputError(f"expected words in a file *.align, *.TextGrid or *.json, got {path}")
    if ending == ".align":
        return read_align(path)
    if ending == ".json":
        return read_lombard_alignment(path)
    found = [one for tier in read_textgrid(path).values() for one in tier]
    return tuple(sorted(found, key=lambda one: (one.start_s, -one.stop_s)))


def read_align(path: str | Path) -> tuple[Slice, ...]:
    """Read GRID's word times: lines of start, stop and word, in units of 1/25,000 s.

    The unit follows from the files: 74,500 where a clip of 75 frames at 25 per second ends.

    Raises
    ------
    InputError : no such file, a line of another form, or a stop before its start
    """
    found = []
    for number, line in enumerate(_text(path).splitlines(), 1):
        if not line.strip():
            continue
        parts = _ALIGN_LINE.fullmatch(line.strip())
        if parts is None:
            raise InputError(
                f"expected lines of start, stop and word such as '23750 29500 bin' in {path}, got '{short(line)}' in "
                f"line {number}"
            )
        start_s, stop_s = int(parts[1]) / ALIGN_UNITS_PER_S, int(parts[2]) / ALIGN_UNITS_PER_S
        _add(found, parts[3], start_s, stop_s, "words", path)
    return tuple(found)


def read_textgrid(path: str | Path) -> dict[str, tuple[Slice, ...]]:
    """Read the interval tiers of a TextGrid in Praat's long or short text form; point tiers have no lengths, left out.

    Praat's rule reads both forms alike: only numbers that stand free, texts in double quotes and flags such as
    `<exists>` count, all else is there for people; `!` starts a comment
    (https://www.fon.hum.uva.nl/praat/manual/TextGrid_file_formats.html). UTF-16 with its mark, UTF-8 or Latin-1.

    Returns
    -------
    tiers : slices by name of the tier; a name that comes again gets a number, `words-2`

    Raises
    ------
    InputError : no such file, another kind of file, or one that ends early
    """
    values = iter(_praat_values(_text(path)))

    def take(kind: type, what: str):
        value = next(values, None)
        if not isinstance(value, kind) or isinstance(value, bool):
            came = "the end" if value is None else f"'{short(value)}'"
            raise InputError(f"expected {what} in the TextGrid {path}, got {came}")
        return value

    if not take(str, '"ooTextFile" as the first text').startswith("ooTextFile"):
        raise InputError(f"expected a TextGrid in Praat's text form, got another file: {path}; save it as text file")
    if take(str, 'the class "TextGrid"') != "TextGrid":
        raise InputError(f"expected a TextGrid, got another of Praat's objects in {path}; save the TextGrid itself")
    for what in ("the start", "the end"):
        take(float, what)
    if take(_Flag, "the flag <exists>") != "exists":
        return {}
    tiers: dict[str, tuple[Slice, ...]] = {}
    for _ in range(_count(take(float, "the number of tiers"), path)):
        kind, name = take(str, "the class of a tier"), take(str, "the name of a tier")
        if kind not in ("IntervalTier", "TextTier"):
            raise InputError(f"expected tiers of the class IntervalTier or TextTier in {path}, got '{short(kind)}'")
        take(float, f"the start of the tier {name}"), take(float, f"the end of the tier {name}")
        found: list[Slice] = []
        for _ in range(_count(take(float, f"the number of intervals of {name}"), path)):
            start_s = take(float, f"a time of the tier {name}")
            if kind == "IntervalTier":
                stop_s = take(float, f"a time of the tier {name}")
                _add(found, take(str, f"a text of the tier {name}"), start_s, stop_s, name, path)
            else:
                take(str, f"a text of the tier {name}")
        if kind == "IntervalTier":
            unique = (
                name
                if name not in tiers
                else next(f"{name}-{i}" for i in range(2, 10**6) if f"{name}-{i}" not in tiers)
            )
            tiers[unique] = tuple(dataclasses.replace(one, tier=unique) for one in found)
    return tiers


def read_lombard_alignment(path: str | Path) -> tuple[Slice, ...]:
    """Read the phones of Lombard GRID: `{"s10_l_bbat9p": [{"phone": "b_B", "offset": 0.1, "duration": 0.05}, ...]}`.

    Where phones carry their place in the word (`_B` begin, `_I` inside, `_E` end, `_S` alone), tier `words` has the
    words too, each named by its phones, such as `b-ih-n`.

    Raises
    ------
    InputError : no such file, no JSON, or JSON of another form
    """
    try:
        (phones,) = json.loads(_text(path)).values()
        entries = [(str(one["phone"]), float(one["offset"]), float(one["duration"])) for one in phones]
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
        raise InputError(
            f"expected phones of one clip as {{name: [{{phone, offset, duration}}, ...]}} in {path}, got another form"
        ) from None
    found: list[Slice] = []
    word: list[Slice] = []
    for phone, start_s, length_s in entries:
        place = _PHONE.fullmatch(phone)
        label = place[1] if place else phone
        before = len(found)
        _add(found, label, start_s, start_s + length_s, "phones", path)
        if not place or len(found) == before:
            word = []
            continue
        word = [found[-1]] if place[2] in "BS" else [*word, found[-1]]
        if place[2] in "ES":
            text = "-".join(one.text for one in word)
            found.append(Slice(text, word[0].start_s, word[-1].stop_s, "words"))
            word = []
    return tuple(sorted(found, key=lambda one: (one.start_s, -one.stop_s)))


def slice_clip(
    clip: Clip, tier: str = "words", *, labels: Collection[str] | None = None, margin_s: float = 0.0
) -> list[Clip]:
    """Cut a clip into those of its words (or of another tier).

    Parameters
    ----------
    tier : such as `words` or `phones`
    labels : only these; None takes all
    margin_s : added on both sides, s, not beyond the clip

    Returns
    -------
    clips : named `<clip>-<number>-<label>`, the number counting the tier from 1; the fields `slice` and `slice_n` say
        the label and the number. A slice that is not inside of the clip's own part is left out

    Raises
    ------
    InputError : a tier that the clip does not have, or a margin below 0
    """
    if not margin_s >= 0:
        raise InputError(f"expected a margin of 0 s or more, got {margin_s:g} s")
    tiers = dict.fromkeys(one.tier for one in clip.words)
    if tier not in tiers:
        known = f"got {nearest(tier, tiers)}; it has {choices(tiers)}" if tiers else "got a clip without words"
        raise InputError(f"expected {clip.name} to have the tier {tier}, {known}")
    low_s, high_s = clip.start_s or 0.0, math.inf if clip.stop_s is None else clip.stop_s
    found = []
    for number, one in enumerate((one for one in clip.words if one.tier == tier), 1):
        if labels is not None and one.text not in labels:
            continue
        if one.start_s < low_s or one.stop_s > high_s:
            continue
        label = re.sub(r"[^\w-]+", "", one.text.replace("_", "-")) or "x"
        found.append(
            dataclasses.replace(
                clip,
                name=f"{clip.name}-{number:02d}-{label}",
                fields={**clip.fields, "slice": one.text, "slice_n": number},
                start_s=max(low_s, one.start_s - margin_s),
                stop_s=min(high_s, one.stop_s + margin_s),
                words=(one,),
            )
        )
    return found


class _Flag(str):
    """A word in `< >`."""


def _praat_values(text: str) -> list[str | float | _Flag]:
    """Free numbers, quoted texts and flags of a file, in order."""
    values: list[str | float | _Flag] = []
    pattern = re.compile(r'"((?:[^"]|"")*)"|!([^\n]*)|<(\w+)>|(\S+)')
    for found in pattern.finditer(text):
        if found[1] is not None:
            values.append(found[1].replace('""', '"'))
        elif found[3] is not None:
            values.append(_Flag(found[3]))
        elif found[4] is not None and re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", found[4]):
            values.append(float(found[4]))
    return values


def _count(value: float, path: str | Path) -> int:
    if not (value == int(value) and 0 <= value < 1e7):
        raise InputError(f"expected a whole number of tiers or intervals in the TextGrid {path}, got {value:g}")
    return int(value)


def _add(found: list[Slice], text: str, start_s: float, stop_s: float, tier: str, path: str | Path) -> None:
    """Append a slice that is not a silence, and not without length."""
    text = text.strip()
    if text.lower() in SILENCES or start_s == stop_s:
        return
    if not 0 <= start_s < stop_s < math.inf:
        raise InputError(
            f"expected '{short(text)}' in {path} to start at 0 s or later and to stop after that, got {start_s:g} to "
            f"{stop_s:g} s"
        )
    found.append(Slice(text, start_s, stop_s, tier))


def _text(path: str | Path) -> str:
    try:
        raw = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"expected a file with words to read, got {path}: {error.strerror or error}") from None
    try:
        if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
            return raw.decode("utf-16")
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")
