"""Pixel classifier: oblivious boosted trees on differences of blurred, locally normalised colour maps.

Every node of a tree level asks the same question of every pixel - is map[c] at one offset, or its difference to
the same map at a second offset, above a threshold? - so a level is a comparison of whole rows, which the compiler
turns into vector instructions; the answers make an index into the leaf table.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numba as nb
import numpy as np

from lipmetrics.errors import InputError

MAX_DEPTH = 8  # a pixel's leaf is numbered in one byte


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
    def leaves_by_output(self) -> np.ndarray:
        """(K, T, 2**D) float32, the leaves of one output side by side."""
        return np.ascontiguousarray(self.leaves.transpose(2, 0, 1), np.float32)

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
    with np.load(file) as parts:
        questions = parts[f"{name}_questions"].astype(np.int32)
        leaves = np.ascontiguousarray(parts[f"{name}_leaves"])
        return Forest(questions, parts[f"{name}_single"], leaves, parts[f"{name}_bias"])


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _grow(maps, stride, start, rows, width, questions, single, leaves, bias, out):
    """maps (C, pixels of the padded canvas in a row); the asked-for rows begin at `start`, `stride` apart.

    The padding between two rows is asked along with them: one long run of comparisons beats many short ones.
    """
    n_trees, depth = questions.shape[0], questions.shape[1]
    run = (rows - 1) * stride + width
    index = np.empty(run, np.uint8)
    for k in range(bias.size):
        out[k, :, :] = bias[k]
    for t in range(n_trees):
        index[:] = 0
        for d in range(depth):
            c, dy, dx, ey, ex, threshold = questions[t, d]
            bit = np.uint8(1 << d)
            begin = start + dy * stride + dx
            first = maps[c, begin : begin + run]
            if single[t, d]:
                limit = np.uint8(min(max(threshold, 0), 255))
                for j in range(run):
                    index[j] |= bit if first[j] > limit else np.uint8(0)
            else:
                begin = start + ey * stride + ex
                second = maps[c, begin : begin + run]
                least = np.int16(threshold)
                for j in range(run):
                    index[j] |= bit if np.int16(np.int16(first[j]) - np.int16(second[j])) > least else np.uint8(0)
        for k in range(bias.size):
            table = leaves[k, t]
            for r in range(rows):
                answers, row = index[r * stride : r * stride + width], out[k, r]
                for j in range(width):
                    row[j] += table[answers[j]]


def log_odds(forest: Forest, maps: np.ndarray, pad: int, rows: tuple[int, int], cols: tuple[int, int]) -> np.ndarray:
    """Log-odds (K, rows, cols) float32 of the outputs at the pixels rows x cols.

    maps : (C, H + 2 pad, W + 2 pad) uint8, padded by at least the largest offset
    """
    (row0, row1), (col0, col1) = rows, cols
    out = np.empty((forest.bias.size, row1 - row0, col1 - col0), np.float32)
    stride = maps.shape[2]
    _grow(
        np.ascontiguousarray(maps).reshape(len(maps), -1),
        stride,
        (row0 + pad) * stride + col0 + pad,
        row1 - row0,
        col1 - col0,
        forest.questions,
        forest.single,
        forest.leaves_by_output,
        forest.bias,
        out,
    )
    return out
