"""Words for messages: lists of choices, and the known name that a wrong one was probably meant to be."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def choices(names: Iterable) -> str:
    """`a, b or c`."""
    *most, last = map(str, names)
    return f"{', '.join(most)} or {last}" if most else last


def nearest(name: str, known: Iterable[str]) -> str:
    """The name in quotes and, where one of `known` is near, the question whether that was meant."""
    by_lower = {word.lower(): word for word in known}
    near = difflib.get_close_matches(str(name).lower(), list(by_lower), n=1)
    return f"'{short(name)}'" + (f"; did you mean '{by_lower[near[0]]}'?" if near else "")


def short(text: str) -> str:
    """On one line and not longer than 60 characters."""
    text = " ".join(str(text).split())
    return text if len(text) <= 60 else text[:57] + "..."
