"""Train the pixel classifiers of the default method on drawn and simulated mouths.

    python benchmarks/train_lips.py                              # writes lipmetrics/data/lips.npz, 40 min on 2 cores
    python benchmarks/train_lips.py --scale 0.05 -o try.npz      # a quick try on a twentieth of the canvases
    python benchmarks/train_lips.py --album album -o new.npz     # keeps the simulated pictures for the next time

Every canvas has its own seed. It is drawn (`lipmetrics.artificial`), or cut out of a simulated picture
(`simulated_canvases`), and gives PIXELS pixels, each with the numbers to
learn: its share of mouth (lips and opening), of opening and, in the coarse stage, of lower lip. The pixels answer a
pool of random questions, differences of two map values; the answers are kept as bins of one byte. Trees are added one
at a time, each a Newton step on the log loss (Friedman 2001, Annals of Statistics 29; split gain as in Chen and
Guestrin 2016, KDD), and all nodes of a level ask the same question (oblivious trees: Kohavi 1994, ECML). The fine
forest is trained on what it will see in use: the finished coarse forest's answers to canvases new to that forest. A
third forest, for the borders (`lipmetrics.border`), learns on canvases new to both how far these are off.

The same SEED gives the same forests on the same machine, whatever the number of processes.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import cv2
import numba as nb
import numpy as np
from simulated_canvases import MOTIONS, STAGES, cut_canvas, draw_pictures, solve_motions

import lipmetrics
from lipmetrics import border
from lipmetrics.artificial import draw, lip_curves, photograph, random_camera, random_face
from lipmetrics.atomic import whole_file
from lipmetrics.box import ASPECT, CANVAS, COARSE, MOUTH
from lipmetrics.decode import decode
from lipmetrics.features import COARSE_COUNT, FINE_COUNT, MAX_OFFSET, PAD
from lipmetrics.forest import Forest, log_odds, save_forests
from lipmetrics.lips import LIP, OPENING, LipSettings, coarse_inputs, fine_inputs, shrunk

SHARES = ("mouth", "opening", "lower lip")  # what is known of a pixel, in the order of lips.LIP, OPENING, LOWER
WRITTEN_TO = Path(lipmetrics.__file__).parent / "data" / "lips.npz"
SEED = 1


# --- what is drawn


@dataclass(frozen=True)
class CanvasSet:
    """How many canvases, and how the mouth lies on them. Spreads are standard deviations, lengths mouth widths (mw)."""

    number: int  # second part of the seed
    count: int
    size: tuple[int, int]  # rows, columns of the canvas; it is drawn with square px and narrowed, as in use
    resize: float  # spread of the logarithm of the mouth's size
    move_mw: float  # spread of its place, along rows and along columns
    turn_rad: float
    closed: float  # share of shut mouths
    simulated: float = 0.0  # share of canvases cut out of simulated pictures instead of drawn
    far: float = 0.0  # share of canvases whose mouth is FAR_MW from the middle, half or wholly outside
    empty: float = 0.0  # share of canvases with texture and no face at all


FAR_MW = 1.4
DRAWN = (CANVAS[0] * 3 // 4, CANVAS[1] * 3 // 4)  # coarse canvases are drawn larger and averaged down, as in use
SETS = {
    # a mouth that is being followed, one frame later
    "tight": CanvasSet(1, 9000, DRAWN, resize=0.13, move_mw=0.07, turn_rad=0.13, closed=0.25),
    # places the search tries: a mouth of the wrong size, half of one, none
    "wide": CanvasSet(2, 9000, DRAWN, resize=0.4, move_mw=0.3, turn_rad=0.2, closed=0.25, far=0.2, empty=0.12),
    # the canvas as it lies when the mouth is measured
    "fine": CanvasSet(3, 13000, CANVAS, resize=0.07, move_mw=0.04, turn_rad=0.06, closed=0.3, far=0.05, empty=0.04),
    # some of these simulated
    "mixed": CanvasSet(
        3,
        16500,
        CANVAS,
        resize=0.07,
        move_mw=0.04,
        turn_rad=0.06,
        closed=0.3,
        simulated=0.22,
        far=0.05,
        empty=0.04,
    ),
    # the same, open and new to the other forests
    "border": CanvasSet(4, 1200, CANVAS, resize=0.07, move_mw=0.04, turn_rad=0.06, closed=0.1, simulated=0.5),
}


# --- how it is learnt


@dataclass(frozen=True)
class Stage:
    """One of the two forests. Why these values stands beside COARSE_STAGE and FINE_STAGE."""

    name: str
    sets: tuple[str, ...]
    maps: int
    outputs: int  # the first so many of SHARES
    trees: int
    depth: int  # at most 8: leaves are numbered in one byte
    rate: float  # share of the Newton step that a tree takes
    questions: int  # in the pool
    tried: int  # of them, at each level of a tree
    spread_px: float  # of most offsets
    nearby: float  # share of offsets with spread NEARBY_PX instead


# In per cent: the change of the log loss of openings on other canvases, after training on 1000, against trees=60,
# depth=6, rate=0.25, tried=140 in the coarse stage and trees=60, depth=8, rate=0.3, tried=300 in the fine one.
COARSE_STAGE = Stage(
    name="coarse",
    sets=("tight", "wide"),
    maps=COARSE_COUNT,
    outputs=3,  # the lower lip tells the fine stage on which side of it the opening lies
    trees=70,  # 100: -3 %, but this stage runs at every place of a search
    depth=7,  # 5: +1 %, 8: -3 %; each level costs the same in use
    rate=0.3,  # 0.15: +5 %, 0.4: -2 %
    questions=1600,  # a pool drawn once is answered and binned once: 1.8 GB for all pixels
    tried=100,  # 60: +0.3 %, 200: -0.1 %, 300: -1 %
    spread_px=4.0,  # most of the height of a lip on this canvas
    nearby=0.4,  # the border of a lip is told by the pixels at both sides of it
)
FINE_STAGE = Stage(
    name="fine",
    sets=("fine",),
    maps=FINE_COUNT,
    outputs=3,  # the lower lip tells an opening from a shadow under the lip
    trees=80,  # 60: +4 %, and every frame goes through them
    depth=8,  # 6: +3 %
    rate=0.4,  # 0.15: +10 %, 0.5: -5 %
    questions=1600,  # near and far ones; 1.3 GB for all pixels
    tried=120,  # 300 or 800: under 1 %
    spread_px=5.0,  # half of the height of a lip on this canvas
    nearby=0.4,  # the border of an opening is told by the pixels at both sides of it
)
# of the fine forest that has seen simulated mouths, beside the one that has not; README.md has figures for 0, 1/2 and 1
MIXED_WEIGHT = 1 / 3
BORDER_STAGE = Stage(
    name="border",
    sets=("border",),
    maps=border.COUNT,
    outputs=1,
    trees=60,
    depth=6,
    rate=0.2,
    questions=800,
    tried=120,
    spread_px=4.0,
    nearby=0.5,
)
BORDERS = 40  # places of each canvas and of each opening on it
PIXELS = 80  # of each canvas: its pixels resemble one another, so more canvases teach more than more pixels
NEAR_LIPS_PX = (5.0, 2.5)  # rows, columns: spread of the pixels that are taken around the lips, where mistakes are made
ROW_SHARE = 0.4  # of the pixels choose a tree's questions: faster, and trees differ; all of them set its leaves
BINS = 32  # of each answer: the sums of all bins and leaves stay in the processor's cache
EDGE_CANVASES = 500  # the bins' edges are quantiles of the answers on so many: 40,000 values place 31 edges well
NEARBY_PX = 1.7  # spread of an offset in the neighbourhood
# shares of questions: a pixel minus the one asked about, minus another; rest: one
AGAINST_CENTRE, AGAINST_OTHER = 0.5, 0.25
POSITION_MAPS = 2  # the last maps are row and column, which are asked without an offset
DAMPING = 20.0  # added to a leaf's curvature, at most 0.25 a pixel: leaves of few pixels stay near 0
MIN_CURVATURE = 1e-3  # of a pixel: pixels that are already right do not freeze a leaf

Example = Callable[[CanvasSet, np.random.Generator], tuple[np.ndarray, np.ndarray]]  # to maps, shares


@dataclass(frozen=True)
class Questions:
    """parts : (F, 5) int32 of (map, row offset, col offset, second row offset, second col offset);
    single : (F,) bool, the second offset is not used. As in `lipmetrics.forest.Forest`, without thresholds."""

    parts: np.ndarray
    single: np.ndarray


# --- canvases


def draw_canvas(kind: CanvasSet, rng: np.random.Generator, album: Path | None = None) -> tuple[np.ndarray, np.ndarray]:
    """A canvas (rows, cols, 3) uint8 RGB and its shares (3, rows, cols) float32 in the order of SHARES.

    album : folder of simulated pictures; without one all canvases are drawn
    """
    square = (kind.size[0], kind.size[1] * ASPECT)
    if rng.random() < kind.empty:
        return narrowed(draw_texture(square, rng)), np.zeros((len(SHARES), *kind.size), np.float32)
    if album is not None and rng.random() < kind.simulated:
        away_mw = rng.normal(0, FAR_MW if rng.random() < kind.far else kind.move_mw, 2)
        turn_rad = rng.normal(0, kind.turn_rad)
        return cut_canvas(album, kind.size, np.exp(rng.normal(0, kind.resize)), away_mw, turn_rad, kind.closed, rng)
    face = random_face(rng, closed=rng.random() < kind.closed)
    across = np.linspace(-0.5, 0.5, 241) * face.shape.width
    upper, _, _, lower = lip_curves(face.shape, across)
    mw_px = square[1] * MOUTH / CANVAS[1]  # a mouth of the right size, px
    px_per_mouth = mw_px * np.exp(rng.normal(0, kind.resize)) / face.shape.width
    away_px = mw_px * rng.normal(0, FAR_MW if rng.random() < kind.far else kind.move_mw, 2)
    middle = (np.array(square) - 1) / 2 + away_px
    drawing = draw(
        face,
        square,
        px_per_mouth,
        centre=(middle[0] - px_per_mouth * (upper.min() + lower.max()) / 2, middle[1]),
        roll_rad=rng.normal(0, kind.turn_rad),
        camera=random_camera(rng),
        rng=rng,
        supersample=1,  # four times faster than 2; the camera blurs most of its jagged lines
    )
    shares = (drawing.lip, drawing.opening, drawing.lower)
    return narrowed(drawing.picture), np.stack([narrowed(share) for share in shares])


def narrowed(square: np.ndarray) -> np.ndarray:
    """What is drawn with square px (rows, cols, ...) on a canvas: ASPECT columns are made one."""
    return cv2.resize(square, (square.shape[1] // ASPECT, square.shape[0]), interpolation=cv2.INTER_AREA)


def draw_texture(size: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """A picture (rows, cols, 3) uint8 RGB of nothing: noise of several sizes in random colours, photographed."""
    noise = np.zeros((*size, 3), np.float32)
    for cells, strength in zip((2, 4, 8, 16, 32, 64, 128), rng.uniform(0, 1, 7), strict=True):
        small = rng.standard_normal((cells, cells, 3)).astype(np.float32)
        noise += np.float32(strength) * cv2.resize(small, size[::-1], interpolation=cv2.INTER_CUBIC)
    picture = rng.uniform(0.02, 0.3) * noise + rng.uniform(0.1, 0.9, 3) * rng.uniform(0.3, 1)
    grey = picture.mean(axis=-1, keepdims=True)
    picture = grey + rng.uniform(0, 1) * (picture - grey)
    return photograph(np.clip(picture, 0, 1).astype(np.float32), random_camera(rng), rng)


def coarse_example(kind: CanvasSet, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Maps of the coarse stage of a canvas, and the shares (3, *COARSE) to learn."""
    canvas, shares = draw_canvas(kind, rng)
    return coarse_inputs(shrunk(canvas)), np.stack([shrunk(share) for share in shares])


def fine_example(
    coarse: Forest, kind: CanvasSet, rng: np.random.Generator, album: Path | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Maps of the fine stage of a canvas, as seen after the forest `coarse`, and shares (3, *CANVAS)."""
    canvas, shares = draw_canvas(kind, rng, album)
    odds = log_odds(coarse, coarse_inputs(shrunk(canvas)), PAD, (0, COARSE[0]), (0, COARSE[1]))
    return fine_inputs(canvas, odds), shares


def border_example(
    coarse: Forest, fine: Forest, kind: CanvasSet, rng: np.random.Generator, album: Path | None = None
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of each border of the openings that are found on a canvas: the straightened maps, and how far off it is.

    The second, (n,), is the share of 2 REACH by which the true border lies into the opening, plus a half; NaN where
    the opening is not truly open.
    """
    canvas, shares = draw_canvas(kind, rng, album)
    odds = log_odds(coarse, coarse_inputs(shrunk(canvas)), PAD, (0, COARSE[0]), (0, COARSE[1]))
    maps = fine_inputs(canvas, odds)
    odds = log_odds(fine, maps, PAD, (0, CANVAS[0]), (0, CANVAS[1]))
    mouth = decode(odds, lean=LipSettings().lean)
    found = []
    for begin, end in mouth.open_runs(LipSettings().switch) if mouth is not None else ():
        left, upper, lower = mouth.left + begin, mouth.upper[begin:end], mouth.lower[begin:end]
        truth = true_borders(shares[OPENING][:, left : left + end - begin], upper, lower)
        for side, measured, true in ((border.UPPER, upper, truth[0]), (border.LOWER, lower, truth[1])):
            off = np.clip(side * (true - measured) / (2 * border.REACH), -0.5, 0.5) + 0.5
            found.append((border.straightened(maps, odds, (0, 0), left, upper, lower, side), off))
    return found


def true_borders(opening: np.ndarray, upper: np.ndarray, lower: np.ndarray) -> np.ndarray:
    """Rows (2, n) where the opening, shares (rows, n), begins and ends in each column; NaN where there is none.

    Of several openings in a column it is the one with the greatest share of what was found, from upper to lower (n,).
    """
    truth = np.full((2, opening.shape[1]), np.nan)
    rows = np.arange(len(opening))
    for j, column in enumerate(opening.T):
        is_open = np.concatenate([[False], column > 0.02, [False]])
        best = 0.0
        for begin, end in np.flatnonzero(is_open[1:] != is_open[:-1]).reshape(-1, 2):
            part = column[begin:end]
            near = (rows[begin:end] > upper[j] - 3) & (rows[begin:end] < lower[j] + 3)
            if part[near].sum() > best:
                best, middle = part[near].sum(), begin + int(part.argmax())
                truth[:, j] = (
                    middle + 0.5 - column[begin : middle + 1].sum(),
                    middle + 0.5 + column[middle + 1 : end].sum(),
                )
    return truth


def choose_pixels(lip: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of PIXELS pixels: a third anywhere, a third on the lips, a third around them.

    lip : (rows, cols) share of mouth; without a mouth all pixels are taken anywhere
    """
    height, width = lip.shape
    mouth = np.flatnonzero(lip > 0.08)
    if mouth.size == 0:
        return np.divmod(rng.integers(0, lip.size, PIXELS), width)
    third = PIXELS // 3
    rows, cols = np.divmod(rng.choice(mouth, PIXELS - 2 * third), width)
    rows = np.clip(rows + np.round(rng.normal(0, NEAR_LIPS_PX[0], rows.size)).astype(int), 0, height - 1)
    cols = np.clip(cols + np.round(rng.normal(0, NEAR_LIPS_PX[1], cols.size)).astype(int), 0, width - 1)
    pixels = np.concatenate([rng.integers(0, lip.size, third), rng.choice(mouth, third), rows * width + cols])
    return np.divmod(pixels, width)


# --- questions and answers


def random_questions(stage: Stage, rng: np.random.Generator) -> Questions:
    """The pool of questions of a stage."""
    count = stage.questions
    parts = np.zeros((count, 5), np.int32)
    parts[:, 0] = rng.integers(0, stage.maps, count)
    for k in range(1, 5):
        spread = np.where(rng.random(count) < stage.nearby, NEARBY_PX, stage.spread_px)
        far_at_times = rng.standard_t(3, count) * spread
        most = MAX_OFFSET[(k + 1) % 2]
        parts[:, k] = np.clip(np.round(far_at_times / (1, ASPECT)[(k + 1) % 2]), -most, most)
    kind = rng.random(count)
    centre = kind < AGAINST_CENTRE
    parts[centre, 3:5] = 0
    parts[centre & ~parts[:, 1:3].any(axis=1), 1] = 3  # not a pixel minus itself
    position = parts[:, 0] >= stage.maps - POSITION_MAPS
    parts[position, 1:5] = 0
    single = (kind >= AGAINST_CENTRE + AGAINST_OTHER) | position
    parts[single, 3:5] = 0
    return Questions(parts, single)


def ask(questions: Questions, maps: np.ndarray, rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
    """Answers (F, n) int16 of n pixels.

    maps : (C, H + 2 PAD[0], W + 2 PAD[1]) uint8; rows, cols : (n,) without padding
    """
    which, row, col, second_row, second_col = questions.parts.T[:, :, None]
    down, across = PAD[0] + rows, PAD[1] + cols
    answers = maps[which, row + down, col + across].astype(np.int16)
    answers -= np.where(questions.single[:, None], 0, maps[which, second_row + down, second_col + across])
    return answers


def read_pixels(example: Example, questions: Questions, edges: np.ndarray | None, task: tuple[CanvasSet, int]):
    """Draw a canvas: answers of its pixels (F, PIXELS), as bins where edges are given, and their shares (PIXELS, 3)."""
    kind, index = task
    rng = np.random.default_rng([SEED, kind.number, index])
    maps, shares = example(kind, rng)
    rows, cols = choose_pixels(shares[LIP], rng)
    answers = ask(questions, maps, rows, cols)
    return answers if edges is None else to_bins(answers, edges), shares[:, rows, cols].T


class Workers:
    """Processes for a whole training, as starting them takes seconds; a single one works here. To be used in `with`."""

    def __init__(self, processes: int = 1):
        self.processes = processes
        # not forked: OpenCV's threads do not survive it; they are started when the first tasks come
        context = get_context("spawn")
        self._pool = ProcessPoolExecutor(processes, context, cv2.setNumThreads, (1,)) if processes > 1 else None

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def map(self, work: Callable, tasks: list) -> Iterator:
        """What the work makes of each task, in order."""
        return map(work, tasks) if self._pool is None else self._pool.map(work, tasks, chunksize=16)


ALONE = Workers()


def read_all(example, questions, edges, tasks, workers: Workers) -> tuple[np.ndarray, np.ndarray]:
    """:func:`read_pixels` of all tasks in order, side by side: (F, N) and (N, 3)."""
    answers = np.empty((len(questions.single), PIXELS * len(tasks)), np.int16 if edges is None else np.uint8)
    shares = np.empty((PIXELS * len(tasks), len(SHARES)), np.float32)
    done = workers.map(partial(read_pixels, example, questions, edges), tasks)
    for n, (some, their_shares) in enumerate(done):
        here = slice(n * PIXELS, (n + 1) * PIXELS)
        answers[:, here], shares[here] = some, their_shares
    return answers, shares


def bin_edges(answers: np.ndarray) -> np.ndarray:
    """Edges (F, BINS - 1) int16 that divide answers (F, n) evenly; an answer is in bin b if b edges are below it."""
    return np.floor(np.quantile(answers, np.arange(1, BINS) / BINS, axis=1).T).astype(np.int16)


@nb.njit(cache=True, nogil=True)
def to_bins(answers, edges):
    """Bins (F, n) uint8 of answers (F, n) with edges (F, BINS - 1)."""
    out = np.zeros(answers.shape, np.uint8)
    for f in range(answers.shape[0]):
        for i in range(answers.shape[1]):
            for edge in edges[f]:
                out[f, i] += answers[f, i] > edge
    return out


# --- trees


@nb.njit(cache=True, nogil=True)
def best_splits(bins, tried, rows, leaf, slopes, leaves):
    """The best threshold of every question in `tried`: its gain (len(tried),) and last bin below (len(tried),).

    bins : (F, N) uint8; rows : (n,) the pixels that count; leaf : (n,) where they are, under `leaves`;
    slopes : (n, 2 K) float32, K gradients, then K curvatures. The gain is the sum of G^2 / (H + DAMPING) over
    outputs, leaves and both sides, which is twice the drop of the loss, up to a constant, to second order.
    """
    outputs = slopes.shape[1] // 2
    gains = np.empty(tried.size)
    splits = np.empty(tried.size, np.int64)
    sums = np.empty((leaves, BINS, 2 * outputs))
    total = np.empty((leaves, 2 * outputs))
    below = np.empty((leaves, 2 * outputs))
    for n in range(tried.size):
        sums[:] = 0
        its_bins = bins[tried[n]]
        for i in range(rows.size):
            b = its_bins[rows[i]]
            for k in range(2 * outputs):
                sums[leaf[i], b, k] += slopes[i, k]
        total[:] = 0
        for b in range(BINS):
            total += sums[:, b]
        below[:] = 0
        gains[n] = -1.0
        for b in range(BINS - 1):
            below += sums[:, b]
            gain = 0.0
            for j in range(leaves):
                for k in range(outputs):
                    g, h = below[j, k], below[j, outputs + k]
                    rest_g, rest_h = total[j, k] - g, total[j, outputs + k] - h
                    gain += g * g / (h + DAMPING) + rest_g * rest_g / (rest_h + DAMPING)
            if gain > gains[n]:
                gains[n], splits[n] = gain, b
    return gains, splits


def grow(
    stage: Stage,
    questions: Questions,
    edges: np.ndarray,
    bins: np.ndarray,
    shares: np.ndarray,
    rng: np.random.Generator,
    threads: int = 1,
) -> Forest:
    """Boost a forest on N pixels; prints the log loss of the outputs every 10 trees.

    edges : (F, BINS - 1); bins : (F, N) uint8 from :func:`to_bins`; shares : (N, K) float32, 0 to 1
    """
    began = time.perf_counter()
    pixels, outputs = shares.shape
    mean = np.clip(shares.mean(axis=0, dtype=float), 1e-3, 1 - 1e-3)
    bias = np.log(mean / (1 - mean)).astype(np.float32)
    odds = np.tile(bias, (pixels, 1))
    parts = np.zeros((stage.trees, stage.depth, 6), np.int32)
    single = np.zeros((stage.trees, stage.depth), bool)
    leaves = np.zeros((stage.trees, 1 << stage.depth, outputs), np.float32)
    with ThreadPoolExecutor(threads) as pool:
        for t in range(stage.trees):
            chance = 1 / (1 + np.exp(-odds))
            slopes = np.hstack([shares - chance, np.maximum(chance * (1 - chance), MIN_CURVATURE)])
            rows = np.flatnonzero(rng.random(pixels) < ROW_SHARE)
            leaf = np.zeros(pixels, np.int32)
            for d in range(stage.depth):
                tried = rng.choice(stage.questions, min(stage.tried, stage.questions), replace=False)
                split = partial(best_splits, bins, rows=rows, leaf=leaf[rows], slopes=slopes[rows], leaves=1 << d)
                found = list(pool.map(split, np.array_split(tried, threads)))
                gains, splits = (np.concatenate(each) for each in zip(*found, strict=True))
                question, at = tried[gains.argmax()], splits[gains.argmax()]
                parts[t, d] = *questions.parts[question], edges[question, at]
                single[t, d] = questions.single[question]
                leaf |= (bins[question] > at).astype(np.int32) << d
            for k in range(outputs):
                g, h = (np.bincount(leaf, slopes[:, c], 1 << stage.depth) for c in (k, outputs + k))
                leaves[t, :, k] = stage.rate * g / (h + DAMPING)
            odds += leaves[t, leaf]
            if t % 10 == 9 or t == stage.trees - 1:
                losses = ", ".join(f"{o} {x:.4f}" for o, x in zip(SHARES, log_loss(odds, shares), strict=False))
                print(
                    f"{stage.name}, {t + 1} trees, {time.perf_counter() - began:.0f} s: log loss {losses}", flush=True
                )
    return Forest(parts, single, leaves, bias)


def log_loss(odds: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Mean log loss (K,) in nats per pixel of log-odds (N, K) against shares (N, K)."""
    return (np.logaddexp(0, odds) - shares * odds).mean(axis=0, dtype=float)


def train_stage(stage: Stage, example: Example, scale: float = 1.0, workers: Workers = ALONE) -> Forest:
    """Draw the stage's canvases, `scale` times as many as its sets say, and grow its forest."""
    rng = np.random.default_rng([SEED, *stage.name.encode()])
    tasks = [(SETS[name], i) for name in stage.sets for i in range(max(1, round(scale * SETS[name].count)))]
    questions = random_questions(stage, rng)
    some = tasks[:: max(1, len(tasks) // EDGE_CANVASES)]
    edges = bin_edges(read_all(example, questions, None, some, workers)[0])
    bins, shares = read_all(example, questions, edges, tasks, workers)
    print(f"{stage.name}: {len(tasks)} canvases, {len(shares)} pixels", flush=True)
    return grow(stage, questions, edges, bins, shares[:, : stage.outputs], rng, workers.processes)


def both(one: Forest, other: Forest, weight: float) -> Forest:
    """A forest that answers with the mean of two, the other one's `weight` of it."""
    parts = [(one, 1 - weight), (other, weight)]
    leaves = np.concatenate([np.float32(share) * forest.leaves for forest, share in parts])
    questions, single = (
        np.concatenate([getattr(forest, name) for forest, _ in parts]) for name in ("questions", "single")
    )
    return Forest(questions, single, leaves, np.float32(sum(share * forest.bias for forest, share in parts)))


def read_borders(example, questions: Questions, task: tuple[CanvasSet, int]) -> tuple[np.ndarray, np.ndarray]:
    """Answers (F, n) int16 and shares (n, 1) of up to BORDERS places of the borders on a canvas."""
    kind, index = task
    rng = np.random.default_rng([SEED, kind.number, index])
    answers, shares = [np.empty((len(questions.single), 0), np.int16)], [np.empty((0, 1), np.float32)]
    for maps, off in example(kind, rng):
        cols = np.flatnonzero(np.isfinite(off))
        cols = rng.choice(cols, min(len(cols), BORDERS // 2), replace=False)
        answers.append(ask(questions, maps, np.zeros(len(cols), int), cols))
        shares.append(off[cols, None].astype(np.float32))
    return np.concatenate(answers, axis=1), np.concatenate(shares)


def train_borders(example, scale: float = 1.0, workers: Workers = ALONE) -> Forest:
    """Grow the forest that moves borders, as :func:`train_stage`."""
    stage = BORDER_STAGE
    rng = np.random.default_rng([SEED, *stage.name.encode()])
    tasks = [(SETS[name], i) for name in stage.sets for i in range(max(1, round(scale * SETS[name].count)))]
    questions = random_questions(stage, rng)
    read = list(workers.map(partial(read_borders, example, questions), tasks))
    answers, shares = (
        np.concatenate(each, axis=axis) for each, axis in zip(zip(*read, strict=True), (1, 0), strict=True)
    )
    edges = bin_edges(answers[:, :: max(1, answers.shape[1] // (EDGE_CANVASES * PIXELS))])
    print(f"{stage.name}: {len(tasks)} canvases, {len(shares)} places", flush=True)
    return grow(stage, questions, edges, to_bins(answers, edges), shares, rng, workers.processes)


# --- command line


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, help=f"file to write, default {WRITTEN_TO}")
    parser.add_argument("--scale", type=float, default=1.0, help="draw this many times as many canvases")
    parser.add_argument("--processes", type=int, default=2, help="on so many cores; the result is the same")
    parser.add_argument("--album", type=Path, help="keep the simulated pictures in this folder, or take them from it")
    options = parser.parse_args()
    if options.processes < 1 or not 0 < options.scale <= 1:
        parser.error("expected --processes of at least 1 and --scale above 0 and up to 1")
    if options.scale < 1 and options.output is None:
        parser.error("expected -o FILE with --scale: a quick try does not replace the package's own forests")
    if options.album is not None:
        try:
            options.album.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            parser.error(f"expected --album FOLDER that can be written to, got {options.album}: {error.strerror}")
    scale, processes = options.scale, options.processes
    with tempfile.TemporaryDirectory() as passing, Workers(processes) as workers:
        album = options.album or Path(passing)
        motions, looks = (math.ceil(scale * whole) for whole in (MOTIONS, STAGES))
        solve_motions(album, processes, motions)
        draw_pictures(album, processes, looks, motions)
        coarse = train_stage(COARSE_STAGE, coarse_example, scale, workers)
        example = partial(fine_example, coarse, album=album)
        stages = (FINE_STAGE, replace(FINE_STAGE, sets=("mixed",)))
        drawn, mixed = (train_stage(stage, example, scale, workers) for stage in stages)
        fine = both(drawn, mixed, MIXED_WEIGHT)
        borders = train_borders(partial(border_example, coarse, fine, album=album), scale, workers)
    forests = {"coarse": coarse, "fine": fine, "border": borders}
    with whole_file(options.output or WRITTEN_TO) as part, part.open("wb") as file:
        save_forests(file, forests)


if __name__ == "__main__":
    main()
