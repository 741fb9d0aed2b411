"""What the commands share: how they read words, say results and complain. Nothing heavy is imported.

Exit codes: 0 done, 2 bad arguments or input, 3 some items of a batch failed, 130 stopped by Ctrl-C.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from pathlib import Path

from lipmetrics.errors import InputError

DONE, BAD_INPUT, SOME_FAILED, STOPPED = 0, 2, 3, 130


def prepare(folder: Path) -> None:
    """Find out before the work, not after it, that nothing can be written."""
    probe = folder / f".lipmetrics.{os.getpid()}.part"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"expected an output folder to write to, got {folder}: {reason}; choose another -o") from None


def sentence(error: Exception) -> str:
    """One line for any error."""
    if isinstance(error, MemoryError):
        return "ran out of memory; close other programs or measure a part of the picture with --roi"
    text = " ".join(str(error).split()) or type(error).__name__
    return text if isinstance(error, InputError | OSError) else f"unexpected {type(error).__name__}: {text}"


def complain(text: str) -> None:
    print(f"lipmetrics: {text}", file=sys.stderr)


def say(text: str) -> None:
    """Print a result; once nobody reads on, the work goes on in silence."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def say_json(summary: dict) -> None:
    from lipmetrics.profile import without_nan

    say(json.dumps(without_nan(summary), indent=2, ensure_ascii=False))


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line instead of a page of usage."""

    def error(self, message: str):
        self.exit(BAD_INPUT, f"{self.prog}: {message}; see '{self.prog} --help'\n")


def add_verb(verbs, name: str, run, what: str, example: str) -> argparse.ArgumentParser:
    verb = verbs.add_parser(name, help=what, description=what[0].upper() + what[1:] + ".", epilog=f"example: {example}")
    verb.add_argument("--json", action="store_true", help="print one machine-readable summary on stdout")
    verb.set_defaults(run=run)
    return verb


class Version(argparse.Action):
    """`--version`, looked up only when asked for."""

    def __call__(self, parser, namespace, values, option_string=None):
        from importlib.metadata import version

        say(f"lipmetrics {version('lipmetrics')}")
        parser.exit()


def number(text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"expected {what}, got '{text}'")
    return value


def seconds(text: str) -> float:
    return number(text, "a time in seconds such as 1.5")


def above_zero(text: str) -> float:
    value = number(text, "a number above 0")
    if value <= 0:
        raise argparse.ArgumentTypeError(f"expected a number above 0, got '{text}'")
    return value


def count(text: str) -> int:
    if not text.isascii() or not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, got '{text}'")
    return int(text)
