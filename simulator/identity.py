"""Which opening is which from frame to frame, by the saliva elements that they lie between."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Identity(NamedTuple):
    """Who an opening is, what happened to it in this frame, and who it came from.

    event : ``""`` (goes on), ``"new"``, ``"split"`` or ``"merge"``
    parents : identities of the frame before that flow into it, for a merge or a split; its own first in a merge
    """

    number: int
    event: str = ""
    parents: tuple[int, ...] = ()


def identities(frame: np.ndarray, first: np.ndarray, last: np.ndarray, area: np.ndarray) -> list[Identity]:
    """Identities of openings in the order they are given, numbered from 1.

    An opening goes on in the next frame as the one that it shares most elements with (among equals the larger one,
    then the first). One that shares elements with others besides has absorbed them where they do not go on
    themselves, a merge; one that no opening goes on as, but that shares elements with one, has split off from it.

    Parameters
    ----------
    frame : (K,) in increasing order
    first, last : (K,) elements between which each opening lies, both included
    area : (K,) in any unit
    """
    found: list[Identity] = []
    known: list[tuple[Identity, int]] = []  # the openings of the frame before, by their place in the arrays
    frame, first, last = frame.tolist(), first.tolist(), last.tolist()
    # symmetric openings are equal but for rounding, which must not decide
    size = [float(f"{value:.6g}") for value in area]
    next_number, at = 1, 0
    while at < len(frame):
        stop = at
        while stop < len(frame) and frame[stop] == frame[at]:
            stop += 1
        if at == 0 or frame[at - 1] != frame[at] - 1:
            known = []
        now, next_number = _follow(known, list(range(at, stop)), first, last, size, next_number)
        found += now
        known = list(zip(now, range(at, stop), strict=True))
        at = stop
    return found


def _follow(
    known: list[tuple[Identity, int]], places: list[int], first: list, last: list, size: list, next_number: int
) -> tuple[list[Identity], int]:
    """Identities of the openings at some places, given those of the frame before; and the next free number."""
    shared = [[max(0, min(last[p], last[c]) - max(first[p], first[c]) + 1) for c in places] for _, p in known]
    pairs = [(p, c) for p in range(len(known)) for c in range(len(places)) if shared[p][c]]
    pairs.sort(key=lambda pair: (-shared[pair[0]][pair[1]], -min(size[known[pair[0]][1]], size[places[pair[1]]]), pair))
    child_of: dict[int, int] = {}
    parent_of: dict[int, int] = {}
    for p, c in pairs:
        if p not in child_of and c not in parent_of:
            child_of[p], parent_of[c] = c, p
    nearest_child = {p: c for p, c in reversed(pairs)}  # the first pair of each, which shares most
    nearest_parent = {c: p for p, c in reversed(pairs)}
    now = []
    for c in range(len(places)):
        if c in parent_of:
            own = known[parent_of[c]][0].number
            lost = [
                known[p][0].number for p, child in sorted(nearest_child.items()) if child == c and p not in child_of
            ]
            now.append(Identity(own, "merge", (own, *lost)) if lost else Identity(own))
            continue
        parent = nearest_parent.get(c)
        source = () if parent is None else (known[parent][0].number,)
        now.append(Identity(next_number, "split" if source else "new", source))
        next_number += 1
    return now, next_number
