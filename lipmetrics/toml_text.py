"""TOML texts that people write, read in a bounded time."""

from __future__ import annotations

import tomllib

LARGEST_TEXT = 1_000_000  # characters
LONGEST_LINE = 5000  # characters: a key of thousands of parts would take minutes to read


def parse_toml(text: str) -> dict:
    """The table that a TOML text holds; ValueError or RecursionError, with a reason, for anything else."""
    if len(text) > LARGEST_TEXT:
        raise ValueError(f"a text of {len(text)} characters, more than {LARGEST_TEXT}")
    longest = max(map(len, text.split("\n")))
    if longest > LONGEST_LINE:
        raise ValueError(f"a line of {longest} characters, more than {LONGEST_LINE}")
    return tomllib.loads(text)
