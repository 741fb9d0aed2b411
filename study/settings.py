"""What an experimenter may change without programming: study.toml and the texts beside it in the study's folder."""

from __future__ import annotations

import dataclasses
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import urlsplit

from study.atomic import whole_file
from study.errors import InputError
from study.wording import nearest, short

SOUNDS = ("left", "both", "off")
PAGES = ("consent", "instructions", "thanks")
ID_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")

TEXTS = {
    "agree": "I agree and take part",
    "begin": "Start",
    "play": "Play",
    "replay": "Play both again",
    "left": "Left",
    "right": "Right",
    "tie": "No difference",
    "practice": "Practice",
    "loading": "The videos are loading ...",
    "watch": "Press Play to watch both videos.",
    "watching": "You can answer once both have played.",
    "choose": "Choose below the videos, or with the arrow keys.",
    "choose_touch": "Choose below the videos.",
    "check_left": "This checks your attention: please choose LEFT this time.",
    "check_right": "This checks your attention: please choose RIGHT this time.",
    "lost": "No connection. Your answer is kept and sent again by itself ...",
    "broken": "A video could not be loaded.",
    "again": "Try again",
    "progress": "{trial} of {of}",
    "withdraw": "Withdraw",
    "withdraw_question": "Do you want to stop and have all your answers deleted? This cannot be undone.",
    "withdraw_yes": "Delete my answers",
    "withdraw_no": "Go on with the study",
    "withdrawn": "Your answers have been deleted. Thank you for your time; you can close this page.",
    "code": "Your completion code:",
    "back": "Finish and return",
    "full": "The study is complete and takes no more participants. Thank you for your interest.",
    "taken": "This link has been used. Please go on in the browser in which you began.",
    "missing_id": "Please open the study by the link you were given: it carries your number.",
    "expired": "Your session has expired, because it rested for too long.",
    "no_script": "The study needs JavaScript; please switch it on.",
    "unknown": "There is no such page. Please open the study by its first page.",
    "cookies": "The study could not remember you; please allow cookies for this page and begin again.",
}

CONSENT = """# {title}

You are invited to take part in a study. You will see pairs of short videos and say each time which one answers the
question better. It takes about {minutes} minutes.

- Taking part is voluntary. You can stop at any time without a reason.
- *Withdraw*, at the bottom of each page, deletes all your answers.
- Your answers are stored under a random number. No name, address or IP address is stored. One cookie lets you go on
  after a break; it is not used for anything else.

By agreeing you say that you are at least 18 years old and that your answers may be used for research.
"""

INSTRUCTIONS = """# How it works

You will see two videos side by side. Press **Play**: both start together.

Once both have played, choose the one you prefer: press the button below it, or the left or right arrow key. You can
play both again (button, or space bar), or one alone (click it), as often as you like.

You cannot go back to an earlier pair. There is no right or wrong answer; follow your first impression.
"""

THANKS = """# Thank you

You have answered everything. Your answers are stored.
"""

LARGEST_FILE = 200_000  # bytes of a file that somebody wrote
LONGEST_LINE = 5000  # characters: a key of thousands of parts would take minutes to read


@dataclasses.dataclass(frozen=True)
class Settings:
    """What study.toml says.

    Parameters
    ----------
    title, question : as the pages show them
    language : of the pages, for browsers and screen readers
    tie_allowed : a third answer, no difference
    sound : of pairs with audio: left, the left video alone is heard when both play; both; or off
    autoplay : start each pair without a press on Play (browsers may refuse this with sound)
    id_parameters : names of what recruiting services add to the link, such as PROLIFIC_PID; stored if named here,
        ignored if not. The first one is required, and admits each participant once.
    completion_code, completion_url : shown when everything is answered; '' for none
    abandoned_after_h : an unfinished session that rested so long gives its place to a new participant when no place is
        left; 0 never
    shared_computer : after the end the first page is there for the next participant, as in a laboratory
    database : SQLite file from the study's folder, or postgresql://...
    texts : words of buttons and messages, in place of `TEXTS`
    """

    title: str = "Which video is more realistic?"
    question: str = "Which of the two looks more realistic?"
    language: str = "en"
    tie_allowed: bool = False
    sound: str = "left"
    autoplay: bool = False
    id_parameters: tuple[str, ...] = ()
    completion_code: str = ""
    completion_url: str = ""
    abandoned_after_h: float = 24.0
    shared_computer: bool = False
    database: str = "answers.sqlite"
    texts: Mapping[str, str] = dataclasses.field(default_factory=lambda: dict(TEXTS))

    def __post_init__(self):
        if self.sound not in SOUNDS:
            raise InputError(f"expected sound to be one of {', '.join(SOUNDS)}, got {nearest(self.sound, SOUNDS)}")
        for name in self.id_parameters:
            if not isinstance(name, str) or not ID_NAME.fullmatch(name):
                raise InputError(f"expected id_parameters such as PROLIFIC_PID, got '{short(str(name))}'")
        if self.completion_url and urlsplit(self.completion_url).scheme not in ("http", "https"):
            raise InputError(f"expected completion_url to begin with https://, got '{short(self.completion_url)}'")
        if not 0 <= self.abandoned_after_h < 1e6:
            raise InputError(f"expected abandoned_after_h to be hours, 0 or more, got {self.abandoned_after_h}")


def load_settings(folder: str | Path) -> Settings:
    """The settings in study.toml of a study's folder; the defaults where it says nothing.

    Raises
    ------
    InputError : the file cannot be read, an unknown name, or a value of the wrong kind
    """
    path = Path(folder) / "study.toml"
    try:
        text = path.read_text(encoding="utf-8")
        if len(text) > LARGEST_FILE or any(len(line) > LONGEST_LINE for line in text.split("\n")):
            raise ValueError(f"a text over {LARGEST_FILE} or a line over {LONGEST_LINE} characters")
        raw = tomllib.loads(text)
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"expected settings at {path}, but: {reason}; 'lipmetrics study design' makes them") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected TOML, but: {short(str(error))}") from None
    try:
        return _settings(raw)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _settings(raw: dict) -> Settings:
    fields = {field.name: field for field in dataclasses.fields(Settings)}
    values = {}
    for name, value in raw.items():
        if name not in fields:
            raise InputError(f"expected a setting, got {nearest(name, fields)}")
        values[name] = _texts(value) if name == "texts" else _like(getattr(Settings, name), name, value)
    return Settings(**values)


def _like(default, name: str, value):
    """The value, if it is of the default's kind."""
    if isinstance(default, tuple) and isinstance(value, list):
        return tuple(value)
    if type(default) is float and type(value) is int:
        return float(value)
    if type(value) is not type(default):
        kind = {str: "text in quotes", bool: "true or false", float: "a number", tuple: "a list in [ ]"}[type(default)]
        raise InputError(f"expected {name} to be {kind}, got {short(repr(value))}")
    return value


def _texts(raw) -> dict[str, str]:
    if not isinstance(raw, dict):
        raise InputError("expected texts to be a table, [texts]")
    for name, value in raw.items():
        if name not in TEXTS:
            raise InputError(f"expected a text under [texts], got {nearest(name, TEXTS)}")
        if not isinstance(value, str):
            raise InputError(f"expected {name} to be text in quotes, got {short(repr(value))}")
    return TEXTS | raw


def load_page(folder: str | Path, name: str) -> str:
    """The Markdown of one of `PAGES`."""
    path = Path(folder) / f"{name}.md"
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise InputError(f"expected a page of at most {LARGEST_FILE} bytes, got {path} of {path.stat().st_size}")
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"expected the text of a page at {path}, but: {reason}") from None


def write_settings(folder: str | Path, minutes: int) -> list[Path]:
    """study.toml with every setting explained, and the pages' texts; files that are there already stay as they are."""
    default = Settings()
    folder = Path(folder)
    contents = {
        "study.toml": _TOML.format(
            **{
                field.name: _toml(getattr(default, field.name))
                for field in dataclasses.fields(Settings)
                if field.name != "texts"
            },
            texts="\n".join(f"# {name} = {_toml(text)}" for name, text in TEXTS.items()),
        ),
        "consent.md": CONSENT.format(title=default.title, minutes=minutes),
        "instructions.md": INSTRUCTIONS,
        "thanks.md": THANKS,
    }
    written = []
    for name, text in contents.items():
        if not (folder / name).exists():
            with whole_file(folder / name) as part:
                part.write_text(text, encoding="utf-8")
            written.append(folder / name)
    return written


def _toml(value) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return f"{value:g}" if isinstance(value, float) else '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'


_TOML = """\
# Settings of this study. The pages' texts are in consent.md, instructions.md and thanks.md.
title = {title}
question = {question}
language = {language}            # of the pages, such as "de"; the words of buttons are at the end
tie_allowed = {tie_allowed}        # a third answer, "no difference"
sound = {sound}             # of pairs with audio: "left" (the left video is heard when both play), "both" or "off"
autoplay = {autoplay}           # start each pair without a press on Play

# What recruiting services add to the link; stored only if named here. The first one is required and admits once.
# Prolific: id_parameters = ["PROLIFIC_PID", "STUDY_ID", "SESSION_ID"]
id_parameters = {id_parameters}
completion_code = {completion_code}      # shown at the end
completion_url = {completion_url}       # such as "https://app.prolific.com/submissions/complete?cc=..."

abandoned_after_h = {abandoned_after_h}     # then an unfinished session gives its place away, if none is left; 0 never
shared_computer = {shared_computer}    # after the end the first page is for the next participant, as in a laboratory
database = {database}  # a file in this folder, or postgresql://user:password@host/name

[texts]                      # take the # away and change the words
{texts}
"""
