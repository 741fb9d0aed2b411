"""The recording protocol as data: what is said when, the sheet to print, the prompt page, and the planned cuts.

Built in is the protocol of Leach's thesis, section 5.2.2: 22 actions and utterances, 5 repetitions 10 s apart, lips
licked before each change; with 15 people 1,650 clips of 3 s. Times run from the mark, a flash and a beep of the page.
"""

from __future__ import annotations

import csv
import dataclasses
import html
import io
import json
import math
import re
from collections.abc import Iterable, Sequence
from importlib.resources import files
from pathlib import Path

from corpus_tools.naming import Template, Value
from corpus_tools.wording import nearest, short
from lipmetrics.atomic import whole_file
from lipmetrics.errors import InputError
from lipmetrics.toml_text import parse_toml

TEXTS = ("ready", "lick", "next", "wait", "again", "paused", "done")
MOST_REPETITIONS_N = 1000


@dataclasses.dataclass(frozen=True)
class Utterance:
    """One action or utterance.

    Parameters
    ----------
    utterance : as names of clips say it
    kind : `action`, `sound`, `letter`, `word`, `sentence` or any other
    movement : what the lips do, such as `plosive`
    show : big on the screen
    how : what to do with it, small below; may be empty
    """

    utterance: str
    show: str
    kind: str = ""
    movement: str = ""
    how: str = ""


@dataclasses.dataclass(frozen=True)
class Prompt:
    """What the page asks for at a time: `lick`, or `cue` for one repetition.

    Parameters
    ----------
    at_s : from the mark, s
    repeat : 1 for the first; 0 with `lick`
    """

    at_s: float
    kind: str
    utterance: str
    repeat: int = 0


@dataclasses.dataclass(frozen=True)
class Cut:
    """A clip's place in the long take.

    Parameters
    ----------
    start_s, stop_s : from the start of the video, s
    fields : of its name
    """

    start_s: float
    stop_s: float
    fields: dict[str, Value]


@dataclasses.dataclass(frozen=True)
class Protocol:
    """What is recorded of one person in one take.

    Parameters
    ----------
    title : of the sheet and the page
    utterances : in the order in which they are recorded
    repetitions_n : of each
    interval_s : from one repetition to the next, and from the last to the next lick, s
    start_s : from the mark to the first lick, s
    lick_s : from the prompt to lick to the first repetition, s
    clip_s, before_s : length of a clip, and how much of it comes before the prompt, s
    template : of the names of clips, with the fields speaker, utterance and repeat
    before : sentences read to the participant before the recording
    texts : words of the page by name

    Raises
    ------
    InputError : times that do not fit one another, utterances of one name, or names that the template cannot make
    """

    title: str
    utterances: tuple[Utterance, ...]
    repetitions_n: int
    interval_s: float
    start_s: float
    lick_s: float
    clip_s: float
    before_s: float
    template: Template
    before: tuple[str, ...]
    texts: dict[str, str]

    def __post_init__(self):
        if not 1 <= self.repetitions_n <= MOST_REPETITIONS_N:
            raise InputError(f"expected 1 to {MOST_REPETITIONS_N} repetitions_n, got {self.repetitions_n}")
        for name in ("interval_s", "start_s", "lick_s", "clip_s", "before_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise InputError(f"expected {name} of the protocol in seconds, 0 or more, got {value:g}")
        if not 0 < self.clip_s <= self.interval_s:
            raise InputError(
                f"expected clip_s above 0 and at most interval_s, {self.interval_s:g} s, got {self.clip_s:g} s"
            )
        if self.before_s > min(self.clip_s, self.start_s + self.lick_s):
            raise InputError(
                "expected before_s to be at most clip_s, and at most start_s + lick_s, "
                f"got {self.before_s:g} s; a clip cannot start before the mark"
            )
        if not self.utterances:
            raise InputError("expected one utterance or more in the protocol, got none")
        seen: dict[str, str] = {}
        for one in self.utterances:
            if (before := seen.setdefault(one.utterance.lower(), one.utterance)) is not one.utterance:
                raise InputError(f"expected utterances of different names, got '{before}' and '{one.utterance}'")
        for field in ("speaker", "utterance", "repeat"):
            if field not in self.template.fields:
                raise InputError(
                    f"expected a template with the fields speaker, utterance and repeat, got none of {field} in "
                    f"{self.template.text}"
                )
        speaker = self.template.parse(self.template.example())["speaker"]
        for one in self.utterances:
            for repeat in (1, self.repetitions_n):
                self.template.format(speaker=speaker, utterance=one.utterance, repeat=repeat)

    @property
    def length_s(self) -> float:
        """From the mark to the end, s."""
        return self.start_s + len(self.utterances) * (self.lick_s + self.repetitions_n * self.interval_s)

    def prompts(self) -> list[Prompt]:
        """What the page asks for, in order of time."""
        found = []
        at_s = self.start_s
        for one in self.utterances:
            found.append(Prompt(at_s, "lick", one.utterance))
            for i in range(self.repetitions_n):
                found.append(Prompt(at_s + self.lick_s + i * self.interval_s, "cue", one.utterance, i + 1))
            at_s += self.lick_s + self.repetitions_n * self.interval_s
        return found

    def cuts(self, speaker: str | int, *, mark_s: float = 0.0) -> list[Cut]:
        """The planned cut list of a whole take without pauses, `mark_s` being the time of the mark in its video, s.

        Raises
        ------
        InputError : a speaker that no name can say
        """
        found = []
        for prompt in self.prompts():
            if prompt.kind == "cue":
                fields = {"speaker": speaker, "utterance": prompt.utterance, "repeat": prompt.repeat}
                self.template.format(**fields)
                start_s = mark_s + prompt.at_s - self.before_s
                found.append(Cut(start_s, start_s + self.clip_s, fields))
        return found

    def names(self, speakers: Iterable[str | int]) -> list[str]:
        """Names of all clips that a corpus of these people should have, person by person."""
        return [self.template.format(**cut.fields) for speaker in speakers for cut in self.cuts(speaker)]


def load_protocol(path: str | Path | None = None) -> Protocol:
    """Read a protocol; None is the built-in one.

    Raises
    ------
    InputError : no such file, no TOML, unknown or missing keys, values of another kind, or what `Protocol` refuses
    """
    where = "the built-in protocol" if path is None else str(path)
    try:
        text = protocol_text() if path is None else Path(path).read_text(encoding="utf-8")
        table = parse_toml(text)
    except (OSError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise InputError(
            f"expected a protocol in TOML, got {where}: {reason}; 'lipmetrics corpus protocol --print' shows one"
        ) from None
    kinds = {
        "title": str,
        "repetitions_n": int,
        **dict.fromkeys(("interval_s", "start_s", "lick_s", "clip_s", "before_s"), float),
        "template": str,
        "before": list,
        "texts": dict,
        "utterances": list,
    }
    _check(table, kinds, where, needed=kinds)
    _check(table["texts"], dict.fromkeys(TEXTS, str), f"[texts] of {where}", needed=TEXTS)
    utterances = []
    for i, one in enumerate(table["utterances"]):
        inside = f"the {_nth(i + 1)} of [[utterances]] of {where}"
        names = [field.name for field in dataclasses.fields(Utterance)]
        _check(one, dict.fromkeys(names, str), inside, needed=("utterance", "show"))
        utterances.append(Utterance(**one))
    if not all(isinstance(line, str) for line in table["before"]):
        raise InputError(f"expected 'before' in {where} to be a list of texts, got other things in it")
    values = {name: float(table[name]) if kind is float else table[name] for name, kind in kinds.items()}
    values |= {"utterances": tuple(utterances), "before": tuple(table["before"])}
    try:
        return Protocol(**values | {"template": Template(table["template"])})
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def protocol_text() -> str:
    """The built-in protocol, to be changed."""
    return files("corpus_tools").joinpath("data/protocol.toml").read_text(encoding="utf-8")


def write_cuts(path: str | Path, cuts: Sequence[Cut]) -> Path:
    """Write a cut list: CSV of `start_s`, `stop_s` and the fields of the names."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["start_s", "stop_s", *(cuts[0].fields if cuts else ())])
    writer.writerows([f"{cut.start_s:.3f}", f"{cut.stop_s:.3f}", *cut.fields.values()] for cut in cuts)
    with whole_file(path) as part:
        part.write_text(text.getvalue(), encoding="utf-8", newline="")
    return Path(path)


def write_protocol(
    folder: str | Path, protocol: Protocol, text: str, *, speakers: Sequence[str | int] = ()
) -> list[Path]:
    """Write protocol.toml, sheet.html, prompt.html and, for each speaker, the planned `<speaker>.cuts.csv`.

    Parameters
    ----------
    text : the protocol's file as it was, with its comments
    """
    folder = Path(folder)
    pages = {
        "protocol.toml": text,
        "sheet.html": sheet_page(protocol),
        "prompt.html": prompt_page(protocol, speaker=str(speakers[0]) if len(speakers) == 1 else ""),
    }
    planned = {speaker: protocol.cuts(speaker) for speaker in speakers}  # before anything is written
    for name, content in pages.items():
        with whole_file(folder / name) as part:
            part.write_text(content, encoding="utf-8", newline="\n")
    written = [folder / name for name in pages]
    return written + [write_cuts(folder / f"{speaker}.cuts.csv", cuts) for speaker, cuts in planned.items()]


def prompt_page(protocol: Protocol, *, speaker: str = "") -> str:
    """The page that prompts the participant and keeps the cut list: one HTML file that needs no network."""
    fields = ("title", "repetitions_n", "interval_s", "start_s", "lick_s", "clip_s", "before_s", "texts")
    data = {name: getattr(protocol, name) for name in fields}
    data |= {"speaker": speaker, "template": protocol.template.text}
    data["utterances"] = [dataclasses.asdict(one) for one in protocol.utterances]
    script = json.dumps(data, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    return _filled("prompt.html", title=html.escape(protocol.title), protocol=script)


def sheet_page(protocol: Protocol) -> str:
    """The sheet to print: what is read to the participant, and a line with boxes for every utterance."""
    boxes = '<td class="box"></td>' * protocol.repetitions_n
    licks = [prompt for prompt in protocol.prompts() if prompt.kind == "lick"]
    rows, kind = [], None
    for i, (one, lick) in enumerate(zip(protocol.utterances, licks, strict=True), 1):
        first = ' class="first"' if one.kind != kind else ""
        kind = one.kind
        cells = (
            f'<td class="n">{i}</td><td class="n">{_clock(lick.at_s)}</td><td>{html.escape(one.kind)}</td>'
            f"<td><b>{html.escape(one.show)}</b> <small>{html.escape(one.how)}</small></td>"
            f"<td><code>{html.escape(one.utterance)}</code></td>"
        )
        rows.append(f'<tr{first}>{cells}{boxes}<td class="notes"></td></tr>')
    utterances_n = len(protocol.utterances)
    return _filled(
        "sheet.html",
        title=html.escape(protocol.title),
        before="\n".join(f"<li>{html.escape(line)}</li>" for line in protocol.before),
        repeats="".join(f"<th>{i + 1}</th>" for i in range(protocol.repetitions_n)),
        rows="\n".join(rows),
        template=html.escape(protocol.template.text),
        facts=html.escape(
            f"{utterances_n} actions and utterances, each {protocol.repetitions_n} times at {protocol.interval_s:g} s, "
            f"{utterances_n * protocol.repetitions_n} clips of {protocol.clip_s:g} s, "
            f"{math.ceil(protocol.length_s / 60)} minutes without pauses"
        ),
    )


def _filled(name: str, **parts: str) -> str:
    page = files("corpus_tools").joinpath("data", name).read_text(encoding="utf-8")
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], page)


def _check(table, kinds: dict[str, type], where: str, *, needed: Iterable[str]) -> None:
    """Keys known, none missing, values of their kind."""
    if not isinstance(table, dict):
        raise InputError(f"expected {where} to be a table, got {short(repr(table))}")
    for key, value in table.items():
        if key not in kinds:
            raise InputError(f"expected {', '.join(kinds)} in {where}, got {nearest(key, kinds)}")
        allowed = (int, float) if kinds[key] is float else kinds[key]
        if not isinstance(value, allowed) or isinstance(value, bool):
            wording = {str: "text", int: "a whole number", float: "a number", list: "a list", dict: "a table"}
            raise InputError(f"expected {key} in {where} to be {wording[kinds[key]]}, got {short(repr(value))}")
    missing = [key for key in needed if key not in table]
    if missing:
        raise InputError(f"expected {missing[0]} in {where}, got none; 'lipmetrics corpus protocol --print' shows one")


def _nth(number: int) -> str:
    ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
