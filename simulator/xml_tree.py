"""XML as a tree whose elements know their line, for messages that name the place.

Read with expat: no document type, so no entities of any kind, and nothing outside the file is ever opened.
"""

from __future__ import annotations

import math
import re
import xml.parsers.expat
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from simulator.errors import InputError
from simulator.wording import choices, nearest, short


@dataclass
class Element:
    """An XML element that knows its place in the file."""

    tag: str
    attributes: dict[str, str]
    file: str
    line: int
    children: list[Element] = field(default_factory=list)
    pieces: list[tuple[int, str]] = field(default_factory=list)  # (line, text on that line)

    @property
    def place(self) -> str:
        return f"{self.file}, line {self.line}"

    def all(self, tag: str) -> list[Element]:
        return [child for child in self.children if child.tag == tag]

    def find(self, tag: str) -> Element | None:
        return next(iter(self.all(tag)), None)

    def need(self, tag: str) -> Element:
        child = self.find(tag)
        if child is None:
            raise InputError(f"{self.place}: expected a <{tag}> in <{self.tag}>, got none")
        return child

    def attribute(self, name: str, known=None) -> str:
        if name not in self.attributes:
            raise InputError(f'{self.place}: expected an attribute {name}="..." in <{self.tag}>, got none')
        value = self.attributes[name].strip()
        if known and value not in known:
            raise InputError(f"{self.place}: expected {name} to be {choices(known)}, got {nearest(value, known)}")
        return value

    def text(self) -> str:
        return "".join(text for _, text in self.pieces)

    def line_of(self, index: int) -> str:
        """Place of the `index`-th word of the text, or of the last where there are fewer."""
        starts = [match.start() for match in re.finditer(r"\S+", self.text())]
        offset = starts[min(index, len(starts) - 1)]
        for line, text in self.pieces:
            if offset < len(text):
                return f"{self.file}, line {line}"
            offset -= len(text)
        raise IndexError(index)

    def numbers(self, kind: type, count: int | None, what: str) -> np.ndarray:
        """The numbers of the text, finite, `count` of them (any count above 0 for None)."""
        words = self.text().split()
        try:
            values = np.array(words, dtype=kind)
            fault = ~np.isfinite(values)
        except (ValueError, OverflowError):
            fault = np.array([not _is_number(word, kind) for word in words])
        if fault.any():
            index = int(np.argmax(fault))
            wanted = "finite numbers" if kind is float else "whole numbers"
            raise InputError(f"{self.line_of(index)}: expected {wanted} in <{self.tag}>, got '{short(words[index])}'")
        if (count is None and len(words) == 0) or (count is not None and len(words) != count):
            raise InputError(f"{self.place}: expected {what} in <{self.tag}>, got {len(words)} numbers")
        return values

    def number(self, kind: type = float):
        return self.numbers(kind, 1, "one number")[0].item()


def _is_number(word: str, kind: type) -> bool:
    try:
        return abs(kind(word)) < (math.inf if kind is float else 2**63)
    except ValueError:
        return False


def parse(path: Path, what: str, check: Callable[[Element, Element | None], None]) -> Element:
    """Read a file as a tree.

    Parameters
    ----------
    path : the file
    what : what it should be, for messages
    check : called with each element at its start tag, and its parent (None for the root), before it joins the tree

    Raises
    ------
    InputError : a file that cannot be opened or is not well-formed, a document type, and whatever `check` raises
    """
    tree: list[Element] = []  # the open elements, innermost last
    roots: list[Element] = []
    parser = xml.parsers.expat.ParserCreate()

    def start(tag, attributes):
        element = Element(tag, attributes, str(path), parser.CurrentLineNumber)
        check(element, tree[-1] if tree else None)
        if tree:
            tree[-1].children.append(element)
            tree[-1].pieces.append((element.line, " "))  # what stands before and after a tag are two words
        else:
            roots.append(element)
        tree.append(element)

    def end(tag):
        tree.pop()

    def text(data):
        tree[-1].pieces.append((parser.CurrentLineNumber, data))

    def doctype(*_):
        raise InputError(
            f"{path}, line {parser.CurrentLineNumber}: expected {what}, got a document type "
            "declaration; take the <!DOCTYPE ...> out"
        )

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = text, doctype
    try:
        with path.open("rb") as file:
            parser.ParseFile(file)
    except OSError as error:
        raise InputError(f"expected {what}, got {path}: {error.strerror or error}") from None
    except xml.parsers.expat.ExpatError as error:
        reason = xml.parsers.expat.ErrorString(error.code)
        opened = f" with <{tree[-1].tag}> of line {tree[-1].line} open" if tree else ""
        raise InputError(
            f"{path}, line {error.lineno}: expected {what} in XML, but it is malformed{opened}: {reason}"
        ) from None
    except (LookupError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}, line 1: expected XML in UTF-8, got another encoding ({error})") from None
    return roots[0]
