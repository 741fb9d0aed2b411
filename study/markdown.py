"""The little Markdown that a study's pages need, to HTML that holds nothing else.

Headings (#, ##, ###), paragraphs, lists (-), **bold**, *italic* and [links](https://...). Everything else is text.
"""

from __future__ import annotations

import html
import re

_BLOCK = re.compile(r"\n\s*\n")
_ITEM = re.compile(r"[-*] +")
_LINK = re.compile(r"\[([^\[\]]{1,500})\]\(((?:https?://|mailto:)[^\s()]{1,2000})\)")
_STRONG = re.compile(r"\*\*(?=\S)(.{1,500}?)(?<=\S)\*\*")  # bounded, as what does not end would be looked through
_EMPHASIS = re.compile(r"\*(?=\S)(.{1,500}?)(?<=\S)\*")


def to_html(text: str) -> str:
    """The HTML of a text; characters that mean something in HTML are escaped."""
    return "\n".join(_block(block) for block in _BLOCK.split(text.replace("\r\n", "\n").strip()) if block.strip())


def _block(block: str) -> str:
    lines = [line.strip() for line in block.strip().split("\n")]
    heading = re.match(r"(#{1,3}) +(.*)", lines[0])
    if heading:
        level = len(heading[1])
        rest = "\n".join(lines[1:])
        return f"<h{level}>{_inline(heading[2])}</h{level}>" + ("\n" + _block(rest) if rest else "")
    first = next((i for i, line in enumerate(lines) if _ITEM.match(line)), None)
    if first is None:
        return f"<p>{_inline(' '.join(lines))}</p>"
    before = f"<p>{_inline(' '.join(lines[:first]))}</p>\n" if first else ""
    items: list[str] = []
    for line in lines[first:]:
        match = _ITEM.match(line)
        if match:
            items.append(line[match.end() :])
        else:
            items[-1] += " " + line
    return before + "<ul>\n" + "\n".join(f"<li>{_inline(item)}</li>" for item in items) + "\n</ul>"


def _inline(text: str) -> str:
    text = html.escape(text)
    text = _LINK.sub(r'<a href="\2" rel="noreferrer">\1</a>', text)
    return _EMPHASIS.sub(r"<em>\1</em>", _STRONG.sub(r"<strong>\1</strong>", text))
