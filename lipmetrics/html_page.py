"""The pieces of a page that needs no network: tables, lists, pictures taken in, and the style of all of them."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

from lipmetrics.atomic import whole_file

LONG_CELL = 20  # characters from which on a cell is text


def write_page(path: str | Path, title: str, body: str) -> None:
    """Write a page with this body; it appears whole or not at all.

    Raises InputError if it cannot be written.
    """
    page = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>{body}</body></html>\n"
    )
    with whole_file(path) as part:
        part.write_text(page, encoding="utf-8", newline="\n")


def picture(png: bytes, what: str) -> str:
    """A PNG as part of the page; `what` is said where it cannot be seen."""
    return f'<img alt="{escape(what)}" src="data:image/png;base64,{base64.b64encode(png).decode("ascii")}">'


def table(rows: Iterable[Sequence], head: Sequence[str] = ()) -> str:
    """A table of text; cells that are numbers as text stand to the right, long ones are broken into lines."""

    def line(cells: Sequence, tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}{_side(cell)}>{escape(str(cell))}</{tag}>" for cell in cells) + "</tr>"

    body = "".join(line(row, "td") for row in rows)
    return f'<div class="wide"><table>{line(head, "th") if head else ""}{body}</table></div>'


def bullets(sentences: Iterable[str]) -> str:
    """A list of sentences."""
    return "<ul>" + "".join(f"<li>{escape(one)}</li>" for one in sentences) + "</ul>"


def folded(title: str, body: str) -> str:
    """What opens on a click."""
    return f"<details><summary>{escape(title)}</summary>{body}</details>"


def number(value: float, digits: int = 3) -> str:
    """A number with so many significant digits, a dash where it is unknown."""
    if not math.isfinite(value):
        return "-"
    text = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e+" in text else text


def span(low: float, high: float, digits: int = 3) -> str:
    """An interval, nothing where it is unknown."""
    return f"{number(low, digits)} to {number(high, digits)}" if math.isfinite(low) and math.isfinite(high) else "-"


def _side(cell) -> str:
    text = str(cell)
    if len(text) > LONG_CELL:
        return ' class="t"'
    return ' class="n"' if text and (text[0].isdigit() or text[0] in "--+") else ""


_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; max-width: 72rem; margin: 2rem auto;
  padding: 0 1rem; }
h1 { font-size: 1.7rem; } h2 { font-size: 1.25rem; margin-top: 2.2rem; } h3 { font-size: 1.05rem; }
p, ul { max-width: 62rem; }
img { max-width: min(100%, 62rem); height: auto; display: block; margin: 0.5rem 0; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; margin: 0.5rem 0 1rem; font-size: 0.88rem; font-variant-numeric: tabular-nums; }
td, th { padding: 0.2rem 0.8rem 0.2rem 0; text-align: left; border-bottom: 1px solid #ddd; vertical-align: top;
  white-space: nowrap; }
th { font-weight: 600; } .n { text-align: right; } .t { white-space: normal; min-width: 9rem; }
.note { color: #666; font-size: 0.9rem; }
details { margin: 0.5rem 0; } summary { cursor: pointer; color: #0050a0; }
"""
