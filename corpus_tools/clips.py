"""A clip of a corpus: one video, or a part of one, with what is said of it in words and fields."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from lipmetrics.errors import InputError


@dataclasses.dataclass(frozen=True)
class Slice:
    """A labelled part of a clip: a word or a phone.

    Parameters
    ----------
    text : the label, such as `bin` or `b`; never empty
    start_s, stop_s : from the start of the clip's video, s; start < stop
    tier : what the label is one of, such as `words` or `phones`
    """

    text: str
    start_s: float
    stop_s: float
    tier: str = "words"


@dataclasses.dataclass(frozen=True)
class Clip:
    """A video to measure; may travel to another process.

    Parameters
    ----------
    path : video file, folder of pictures or pattern of pictures
    name : of this clip alone, without `/`; the key in tables and stores
    fields : what the name says, such as speaker, utterance, repeat, stickiness: text, whole numbers, numbers or None
    start_s, stop_s : the part of the video to be measured, s; None: from its start, to its end
    words : labelled parts in order of time, where known
    fps : pictures per second of a folder of pictures; None for a video, which has its own times

    Raises
    ------
    InputError : no name or one with `/`, or a part that ends before it starts
    """

    path: Path
    name: str
    fields: Mapping[str, str | int | float | None] = dataclasses.field(default_factory=dict)
    start_s: float | None = None
    stop_s: float | None = None
    words: tuple[Slice, ...] = ()
    fps: float | None = None

    def __post_init__(self):
        object.__setattr__(self, "path", Path(self.path))
        object.__setattr__(self, "fields", MappingProxyType(dict(self.fields)))
        object.__setattr__(self, "words", tuple(self.words))
        if not self.name:
            raise InputError(f"expected a name for the clip {self.path}, got none; name it by a template")
        if "/" in self.name or "\\" in self.name:
            raise InputError(f"expected a name of a clip without / and \\, got {self.name}; put - there")
        start_s, stop_s = self.start_s or 0.0, math.inf if self.stop_s is None else self.stop_s
        if not 0 <= start_s < stop_s:
            raise InputError(
                f"expected {self.name} to start at 0 s or later and to stop after that, got a start at {start_s:g} s "
                f"and a stop at {stop_s:g} s"
            )

    def __reduce__(self):  # the fields cannot be changed, and such a mapping does not travel as it is
        return _clip, (str(self.path), self.name, dict(self.fields), self.start_s, self.stop_s, self.words, self.fps)

    def __hash__(self):
        return hash((self.path, self.name, self.start_s, self.stop_s))


def _clip(path: str, *rest) -> Clip:
    return Clip(Path(path), *rest)
