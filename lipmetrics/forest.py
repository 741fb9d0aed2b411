"""Pixel classifier: oblivious boosted trees on differences of blurred, locally normalised colour maps.

Every node of a tree level asks the same question of every pixel - is map[c] at one offset, or its difference to
the same map at a second offset, above a threshold? - so a level is a comparison of whole rows, which the compiler
turns into vector instructions on bytes; the answers make an index into the leaf table. A leaf holds the log-odds of
up to three outputs side by side in one integer, so that one look-up and one addition serve them all.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numba as nb
import numpy as np

from lipmetrics.errors import InputError

MAX_DEPTH = 8  # a pixel's leaf is numbered in one byte
_AT_ONCE = 4  # trees whose leaves are added in one go over the pixels


@dataclass(frozen=True)
class Forest:
    """Trees of depth D, 1 to MAX_DEPTH, whose answers are added up; InputError for deeper ones.

    questions : (T, D, 6) int32 of (map, row offset, col offset, second row offset, second col offset, threshold);
        with `single` (T, D) True the second offset is not used
    leaves : (T, 2**D, K) float32, additive log-odds of K outputs
    bias : (K,) float32
    """

    questions: np.ndarray
    single: np.ndarray
    leaves: np.ndarray
    bias: np.ndarray

    @cached_property
    def ready(self) -> _Ready:
        """The same trees as :func:`log_odds` walks them."""
        return _Ready.of(self)

    def __post_init__(self) -> None:
        trees, depth = self.questions.shape[:2]
        if not 1 <= depth <= MAX_DEPTH:
            raise InputError(
                f"expected trees of depth 1 to {MAX_DEPTH}, got {depth}; train the forest with fewer levels"
            )
        if self.leaves.shape[:2] != (trees, 1 << depth):
            raise InputError(
                f"expected {trees} trees of {1 << depth} leaves, got {self.leaves.shape[0]} of {self.leaves.shape[1]}; "
                "take questions and leaves from one forest"
            )


@dataclass(frozen=True)
class _Ready:
    """A forest in the form of the kernel.

    Differences are asked for as ``max(a - b, 0) > limit``, which bytes can answer; where the threshold is below 0 a
    and b change places and the answer is the opposite, so the leaves do too.

    offsets : (T, D, 5) int64 of (map, row offset, col offset, second row offset, second col offset)
    limits : (T, D) uint8
    fields : (W, T, 2**D) int64, each of up to three outputs in `bits` bits of its own, none below 0
    steps, least : (K,) float64; log-odds of an output are least + step * (the sum of its fields)
    """

    offsets: np.ndarray
    single: np.ndarray
    limits: np.ndarray
    fields: np.ndarray
    bits: int
    steps: np.ndarray
    least: np.ndarray

    @classmethod
    def of(cls, forest: Forest) -> _Ready:
        offsets, thresholds = forest.questions[..., :5].astype(np.int64), forest.questions[..., 5].astype(np.int64)
        below = thresholds < 0
        swapped = below & ~forest.single
        offsets[swapped] = offsets[swapped][:, [0, 3, 4, 1, 2]]
        # a map is never below 0, so the answer to a single question with such a threshold is yes
        limits = np.where(below, np.where(forest.single, 255, -thresholds - 1), thresholds)
        trees, depth = thresholds.shape
        flips = (below << np.arange(depth)).sum(axis=1)
        leaf = np.arange(1 << depth)[None, :] ^ flips[:, None]
        leaves = forest.leaves[np.arange(trees)[:, None], leaf].astype(np.float64)

        outputs = forest.bias.size
        per_word = min(outputs, 3)
        bits = min(63 // per_word, 31)
        lowest = leaves.min(axis=1)
        ranges = (leaves.max(axis=1) - lowest).sum(axis=0)
        steps = np.where(ranges > 0, ranges, 1) / ((1 << bits) - 1 - trees)  # so that no sum leaves its field
        whole = np.rint((leaves - lowest[:, None]) / steps).astype(np.int64)
        fields = np.zeros((-(-outputs // per_word), trees, 1 << depth), np.int64)
        for k in range(outputs):
            fields[k // per_word] += whole[..., k] << (bits * (k % per_word))
        limits = np.clip(limits, 0, 255).astype(np.uint8)
        return cls(offsets, forest.single, limits, fields, bits, steps, lowest.sum(axis=0) + forest.bias)


def save_forests(path, forests: dict[str, Forest]) -> None:
    """Write named forests into one compressed npz file."""
    parts = {}
    for name, forest in forests.items():
        parts[f"{name}_questions"] = forest.questions.astype(np.int16)
        parts[f"{name}_single"] = forest.single
        parts[f"{name}_leaves"] = forest.leaves.astype(np.float32)
        parts[f"{name}_bias"] = forest.bias
    np.savez_compressed(path, **parts)


def load_forest(file, name: str) -> Forest:
    """One forest of a file written by :func:`save_forests`; InputError if its trees are too deep to be used."""
    try:
        with np.load(file, allow_pickle=False) as parts:
            questions, single, leaves, bias = (
                parts[f"{name}_{one}"] for one in ("questions", "single", "leaves", "bias")
            )
        return Forest(questions.astype(np.int32), single.astype(bool), np.ascontiguousarray(leaves, np.float32), bias)
    except InputError:
        raise
    except Exception as error:  # a damaged zip or array raises any of a dozen kinds
        raise InputError(f"expected a file of forests with '{name}' in it, got {file}: {error}") from None


@nb.njit(inline="always")
def _leaf_numbers(maps, stride, start, offsets, single, limits, leaf):
    """Leaf of one tree for a run of pixels: bit d says yes to question d."""
    run = leaf.size
    leaf[:] = 0
    for d in range(limits.size):
        c, row, col, second_row, second_col = offsets[d]
        bit, limit = np.uint8(1 << d), limits[d]
        begin = start + row * stride + col
        first = maps[c, begin : begin + run]
        if single[d]:
            for j in range(run):
                leaf[j] |= bit if first[j] > limit else np.uint8(0)
        else:
            begin = start + second_row * stride + second_col
            second = maps[c, begin : begin + run]
            for j in range(run):
                leaf[j] |= bit if np.uint8(max(first[j], second[j]) - second[j]) > limit else np.uint8(0)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _grow(maps, stride, start, rows, width, offsets, single, limits, fields, bits, steps, least, out, top, left):
    """maps (C, pixels of the padded canvas in a row); the asked-for rows begin at `start`, `stride` apart.

    The padding between two rows is asked along with them: one long run of comparisons beats many short ones.
    """
    n_trees, words = limits.shape[0], fields.shape[0]
    leaf = np.empty((_AT_ONCE, (rows - 1) * stride + width), np.uint8)
    total = np.zeros((words, rows, width), np.int64)
    for t in range(0, n_trees, _AT_ONCE):
        some = min(_AT_ONCE, n_trees - t)
        for i in range(some):
            _leaf_numbers(maps, stride, start, offsets[t + i], single[t + i], limits[t + i], leaf[i])
        for w in range(words):
            if some < _AT_ONCE:
                for i in range(some):
                    table = fields[w, t + i]
                    for r in range(rows):
                        one, row = leaf[i, r * stride : r * stride + width], total[w, r]
                        for j in range(width):
                            row[j] += table[one[j]]
                continue
            table0, table1, table2, table3 = fields[w, t], fields[w, t + 1], fields[w, t + 2], fields[w, t + 3]
            for r in range(rows):
                begin, end, row = r * stride, r * stride + width, total[w, r]
                leaf0, leaf1, leaf2, leaf3 = (
                    leaf[0, begin:end],
                    leaf[1, begin:end],
                    leaf[2, begin:end],
                    leaf[3, begin:end],
                )
                for j in range(width):
                    row[j] += table0[leaf0[j]] + table1[leaf1[j]] + table2[leaf2[j]] + table3[leaf3[j]]
    per_word = min(steps.size, 3)
    mask = (1 << bits) - 1
    for k in range(steps.size):
        shift = bits * (k % per_word)
        for r in range(rows):
            line, row = total[k // per_word, r], out[k, top + r, left : left + width]
            for j in range(width):
                row[j] = least[k] + steps[k] * ((line[j] >> shift) & mask)


def log_odds(
    forest: Forest,
    maps: np.ndarray,
    pad: tuple[int, int],
    rows: tuple[int, int],
    cols: tuple[int, int],
    out: np.ndarray | None = None,
    place: tuple[int, int] = (0, 0),
) -> np.ndarray:
    """Log-odds (K, rows, cols) float32 of the outputs at the pixels rows x cols.

    out : (K, H, W) float32, larger, to write them into from `place` (row, column) on; a new array by default
    maps : (C, H + 2 pad[0], W + 2 pad[1]) uint8, padded by at least the largest offsets
    """
    (row0, row1), (col0, col1) = rows, cols
    if out is None:
        out = np.empty((forest.bias.size, row1 - row0, col1 - col0), np.float32)
    stride, ready = maps.shape[2], forest.ready
    _grow(
        np.ascontiguousarray(maps).reshape(len(maps), -1),
        stride,
        (row0 + pad[0]) * stride + col0 + pad[1],
        row1 - row0,
        col1 - col0,
        ready.offsets,
        ready.single,
        ready.limits,
        ready.fields,
        ready.bits,
        ready.steps,
        ready.least,
        out,
        *place,
    )
    return out
