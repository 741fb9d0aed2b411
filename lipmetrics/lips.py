"""The default method: find the mouth, lay a canvas over it, classify its pixels, trace the openings.

Two stages of one kind of classifier (`lipmetrics.forest`), trained on drawn mouths (`lipmetrics.artificial`) and
on nothing else: a coarse one that says where the lips are, and a fine one that sees the coarse answer and the
colours relative to this person's lips and skin. The canvas follows the mouth, but is laid anew only when the
mouth has moved on it: a still face gives a still measurement.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import resources

import cv2
import numba
import numpy as np

from lipmetrics import features
from lipmetrics.box import CANVAS, COARSE, MOUTH, Box, lay_canvas, nine_of_sixteen
from lipmetrics.errors import InputError
from lipmetrics.find import places
from lipmetrics.forest import load_forest, log_odds
from lipmetrics.look import CLOSED, NO_MOUTH, OPEN, Look
from lipmetrics.outline import level_outlines
from lipmetrics.regions import likeliest_region, middle_row, sums_over

LIP, OPENING, LOWER = range(3)  # outputs: lip or opening, opening; of the coarse stage also lower lip
ELSEWHERE = -4.0  # log-odds of what was not looked at, far from the lips
NEAR_MW = 0.25  # an opening this far above or below the middle of the lips needs e times the evidence
FILLED = 0.5  # above 0, the level of the outlines
_CLOSING = np.ones((5, 9), np.uint8)  # an opening may cut the lips' outline by so many rows and columns
MIN_WIDTH_PX = 12  # narrower mouths have nothing left to measure
SETTLE_STEPS = 4  # at most, of the canvas over a mouth just found
MARGIN = 8  # px around the lips that are looked at again: in a frame the lips move less than that
Region = tuple[int, int, int, int]  # half-open part (row0, row1, col0, col1) of a canvas


@dataclass(frozen=True)
class LipSettings:
    """Settings of `method="default"`. Lengths in mouth widths (mw), evidence in log-odds.

    open_above : a pixel is opening above this
    sure_above : an opening has a pixel above this, or it is not counted
    min_height_mw : lower openings are not counted
    found_above : score, 0 to 1, above which a place in the picture counts as a mouth
    found_in_face : the same for the lower part of a face
    confirmed_above : score of the fine look at a mouth just found outside a face, below which it was none
    lost_below : score below which a mouth that was being followed counts as gone
    steady : how much of the evidence of the frame before is kept where the picture has not changed, 0 to below 1
    change : difference in grey levels up to which a pixel has not changed; at twice that nothing is kept
    hysteresis : added to sure_above after a closed frame, taken off after an open one
    move_mw, resize, turn_rad : the canvas is laid anew when the mouth has moved, grown or turned by this much
    """

    open_above: float = -0.25
    sure_above: float = 1.5
    min_height_mw: float = 0.022
    found_above: float = 0.45
    found_in_face: float = 0.08
    confirmed_above: float = 0.65
    lost_below: float = 0.1
    steady: float = 0.6
    change: float = 6.0
    hysteresis: float = 0.3
    move_mw: float = 0.06
    resize: float = 0.08
    turn_rad: float = 0.06

    def __post_init__(self) -> None:
        if not (0 <= self.steady < 1 and self.change > 0 and self.hysteresis >= 0):
            raise InputError("expected steady from 0 to below 1, change above 0 and hysteresis of at least 0")
        if not 0 <= self.lost_below <= self.found_above <= 1:
            raise InputError(
                f"expected 0 <= lost_below <= found_above <= 1, got {self.lost_below} and {self.found_above}"
            )
        if not self.open_above <= self.sure_above:
            raise InputError(f"expected open_above <= sure_above, got {self.open_above} and {self.sure_above}")
        if min(self.min_height_mw, self.move_mw, self.resize, self.turn_rad) < 0:
            raise InputError("expected min_height_mw, move_mw, resize and turn_rad of at least 0")


@lru_cache(maxsize=1)
def forests():
    """The coarse and the fine forest that come with the package."""
    with resources.as_file(resources.files("lipmetrics") / "data" / "lips.npz") as file:
        return load_forest(file, "coarse"), load_forest(file, "fine")


def shrunk(canvas: np.ndarray) -> np.ndarray:
    """A canvas of any size, or one plane of it, averaged down to the coarse size."""
    if canvas.shape == (*CANVAS, 3) and canvas.dtype == np.uint8:
        return nine_of_sixteen(canvas)
    return cv2.resize(canvas, COARSE[::-1], interpolation=cv2.INTER_AREA)


def coarse_inputs(canvas: np.ndarray, region: Region | None = None) -> np.ndarray:
    """The maps that the coarse forest sees, of a canvas (*COARSE, 3) uint8 RGB, in use as in training."""
    return features.coarse_maps(features.log_ratios(canvas), region)


def fine_inputs(canvas: np.ndarray, coarse: np.ndarray, region: Region | None = None) -> np.ndarray:
    """The maps that the fine forest sees, of a canvas (*CANVAS, 3) uint8 RGB and its coarse log-odds (3, *COARSE)."""
    enlarged = np.empty((len(coarse), *CANVAS), np.float32)
    for plane, target in zip(coarse, enlarged, strict=True):
        cv2.resize(plane, CANVAS[::-1], dst=target)
    ratios = features.log_ratios(canvas)
    middles = features.references(ratios, enlarged[LIP], enlarged[OPENING], _oval())
    return features.fine_maps(ratios, middles, enlarged, region)


def coarse_odds(canvas: np.ndarray, region: Region | None = None) -> np.ndarray:
    """Log-odds (3, *COARSE) float32 of a canvas (*COARSE, 3) uint8 RGB; ELSEWHERE outside the region."""
    return _odds(forests()[0], coarse_inputs(canvas, region), COARSE, region)


def fine_odds(canvas: np.ndarray, coarse: np.ndarray, region: Region | None = None) -> np.ndarray:
    """Log-odds (2, *CANVAS) float32 of a canvas (*CANVAS, 3) uint8 RGB and its coarse log-odds; region as above."""
    return _odds(forests()[1], fine_inputs(canvas, coarse, region), CANVAS, region)


def _odds(forest, maps: np.ndarray, size: tuple[int, int], region: Region | None) -> np.ndarray:
    row0, row1, col0, col1 = region or (0, size[0], 0, size[1])
    inside = log_odds(forest, maps, features.PAD, (0, row1 - row0), (0, col1 - col0))
    if region is None:
        return inside
    out = np.full((len(inside), *size), ELSEWHERE, np.float32)
    out[:, row0:row1, col0:col1] = inside
    return out


@lru_cache(maxsize=1)
def _oval() -> np.ndarray:
    rows, cols = (np.linspace(-1, 1, n) for n in CANVAS)
    return np.hypot(rows[:, None], cols[None, :]) < 0.95


@lru_cache(maxsize=4)
def _middle_weight(size: tuple[int, int]) -> np.ndarray:
    rows, cols = (np.linspace(-1, 1, n) for n in size)
    return np.exp(-((rows[:, None] / 0.5) ** 2) - (cols[None, :] / 0.7) ** 2).astype(np.float32)


def _equal(canvas: np.ndarray, other: np.ndarray) -> bool:
    """Whether two canvases are the same; where one row tells that they are not, the others are not compared."""
    middle = CANVAS[0] // 2
    return np.array_equal(canvas[middle], other[middle]) and np.array_equal(canvas, other)


@dataclass(frozen=True)
class Lips:
    """The lips on a canvas: mask (rows, cols) bool, and (top, bottom, left, right) half open in its px."""

    mask: np.ndarray
    top: int
    bottom: int
    left: int
    right: int

    def region(self, size: tuple[int, int]) -> Region:
        """The part of a canvas of `size` with these lips and MARGIN around them."""
        per_row, per_col = size[0] / self.mask.shape[0], size[1] / self.mask.shape[1]
        return (
            max(int(self.top * per_row) - MARGIN, 0),
            min(int(np.ceil(self.bottom * per_row)) + MARGIN, size[0]),
            max(int(self.left * per_col) - MARGIN, 0),
            min(int(np.ceil(self.right * per_col)) + MARGIN, size[1]),
        )

    def centred(self, enlarged: float) -> Lips:
        """Where these lips lie on a canvas laid over their middle, on which everything is so much larger; no mask."""
        rows, cols = self.mask.shape
        high, wide = enlarged * (self.bottom - self.top) / 2, enlarged * (self.right - self.left) / 2
        return replace(
            self,
            top=max(int(rows / 2 - high), 0),
            bottom=min(int(np.ceil(rows / 2 + high)), rows),
            left=max(int(cols / 2 - wide), 0),
            right=min(int(np.ceil(cols / 2 + wide)), cols),
        )

    def fits(self, region: Region, size: tuple[int, int]) -> bool:
        """Whether the lips end inside the region, or where the canvas ends."""
        row0, row1, col0, col1 = region
        return (
            (self.top > row0 or row0 == 0)
            and (self.bottom < row1 or row1 == size[0])
            and (self.left > col0 or col0 == 0)
            and (self.right < col1 or col1 == size[1])
        )

    @property
    def corners(self) -> np.ndarray:
        """(2, 2) float64 (row, column) of the left and the right end."""
        left_row = middle_row(self.mask, self.left, self.left + 3)
        right_row = middle_row(self.mask, self.right - 3, self.right)
        return np.array([(left_row, self.left - 0.5), (right_row, self.right - 0.5)])


def main_lips(odds: np.ndarray, region: Region | None = None) -> Lips | None:
    """The connected lips nearest the middle of a canvas, from log-odds (rows, cols) in the region; None without any."""
    found = likeliest_region(odds, _middle_weight(odds.shape), region or (0, odds.shape[0], 0, odds.shape[1]))
    if found is None:
        return None
    mask, (left, top, width, height, area) = found
    if area < 12 or width < 4:
        return None
    return Lips(mask, top, top + height, left, left + width)


def mouth_score(odds: np.ndarray, lips: Lips | None) -> float:
    """How much log-odds (rows, cols) of a canvas look like one mouth in its middle, 0 to 1.

    The lips' mean probability, less the share of what looks like lips but is elsewhere or runs off the canvas.
    """
    if lips is None:
        return 0.0
    area, total, above = sums_over(odds, lips.mask, lips.top, lips.bottom)
    inside = 1 / (1 + np.exp(-total / area))
    stray = (above - area) / (above + area)
    rows, cols = odds.shape
    filled = area / ((lips.bottom - lips.top) * (lips.right - lips.left))
    width = (lips.right - lips.left) / (cols * MOUTH / CANVAS[1])
    centre_off = np.hypot((lips.left + lips.right) / 2 - cols / 2, (lips.top + lips.bottom) / 2 - rows / 2) / cols
    off_size = abs(np.log(width))
    runs_off = lips.left == 0 or lips.right == cols or lips.top == 0 or lips.bottom == rows
    score = inside * (1 - stray) * np.exp(-((off_size / 0.6) ** 2) - (centre_off / 0.25) ** 2)
    return float(score * min(1.0, filled / 0.45) * (0.6 if runs_off else 1.0))


def moved_box(box: Box, lips: Lips, size: tuple[int, int]) -> Box:
    """The box of the lips found on a canvas of `size` that was laid by `box`."""
    to_fine = np.array(CANVAS) / np.array(size)
    corners = (lips.corners + 0.5) * to_fine - 0.5
    middle = (np.array([(lips.top + lips.bottom) / 2, (lips.left + lips.right) / 2])) * to_fine - 0.5
    row, col = box.to_picture(middle[None])[0]
    tilt = np.arctan2(corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1])
    width = (lips.right - lips.left) * to_fine[1] * box.scale
    return Box(float(row), float(col), float(width), float(np.clip(box.roll_rad + 0.7 * tilt, -0.7, 0.7)))


def settle(frame, box: Box, steps: int) -> tuple[Box, float]:
    """Move a box to the lips it sees, a few times; the box and its score, 0 where it sees none."""
    score = 0.0
    for _ in range(steps):
        canvas = lay_canvas(frame, box, COARSE)
        if canvas is None:
            return box, 0.0
        odds = coarse_odds(canvas)[LIP]
        lips = main_lips(odds)
        if lips is None:
            return box, 0.0
        score = mouth_score(odds, lips)
        box = moved_box(box, lips, COARSE)
        if not MIN_WIDTH_PX <= box.width_px <= 4 * frame.width:
            return box, 0.0
    return box, score


def openings_on(odds: np.ndarray, lips: Lips, settings: LipSettings) -> tuple[np.ndarray, float]:
    """Which openings count: a field (rows, cols) float32 above 0 inside them, and the peak log-odds of the best.

    odds : fine log-odds (outputs, rows, cols). An opening lies in the lips, is high enough and somewhere sure. Openings
    of one mouth lie side by side, so of two in the same columns the one with more evidence counts: the other is a
    shadow under the lip or the nose.
    """
    row0, row1, col0, col1 = lips.region(lips.mask.shape)
    middle = (lips.mask.shape[0] - 1) / 2 - row0
    odds, mask = odds[:, row0:row1, col0:col1], lips.mask[row0:row1, col0:col1]
    field = np.minimum(odds[OPENING] - settings.open_above, odds[LIP] + 1)
    around = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, _CLOSING) > 0
    count, labels, stats, _ = cv2.connectedComponentsWithStats((field > 0).astype(np.uint8), connectivity=4)
    low = settings.min_height_mw * MOUTH
    nearness = np.exp(-(((np.arange(row1 - row0) - middle) / (NEAR_MW * MOUTH)) ** 2))
    likely = []
    for k in range(1, count):
        left, top, width, height, area = stats[k]
        if height < low or area < 6:
            continue
        window = np.s_[top : top + height, left : left + width]
        part = labels[window] == k
        if part.sum(axis=0).max() < low or np.count_nonzero(part & around[window]) < 0.6 * area:
            continue
        inside = odds[OPENING][window][part]
        peak = float(np.partition(inside, -3)[-3:].mean())
        if peak >= settings.sure_above:
            evidence = float(np.clip(inside - settings.open_above, 0, 4).sum() * nearness[top + height // 2])
            likely.append((evidence, left, left + width, k, peak))
    likely.sort(reverse=True)
    kept = []
    for evidence, left, right, k, peak in likely:
        apart = all(min(right, r) - max(left, a) <= 0.3 * min(right - left, r - a) for _, a, r, _, _ in kept)
        if apart and evidence >= 0.05 * likely[0][0]:
            kept.append((evidence, left, right, k, peak))
    keep = np.zeros(count, bool)
    keep[[k for *_, k, _ in kept]] = True
    best = max((peak for *_, peak in kept), default=float(odds[OPENING][mask].max()))
    field = np.where((labels > 0) & ~keep[labels], -1, field)
    for *_, k, _ in kept:  # what lies in an opening, above and below it, is a tongue or a tooth
        part = labels == k
        held = np.maximum.accumulate(part, axis=0) & np.maximum.accumulate(part[::-1], axis=0)[::-1]
        field = np.where(held & ~part, FILLED, field)
    out = np.full(lips.mask.shape, -1, np.float32)
    out[row0:row1, col0:col1] = field
    return out, best


@numba.njit(cache=True, nogil=True)
def _steady(canvas, canvas_before, odds, odds_before, keep, change):
    """odds += weight (odds_before - odds), weight from `keep` at a change of `change` grey levels to 0 at twice it."""
    outputs, height, width = odds.shape
    change_of, weight = np.zeros(width + 2, np.int32), np.empty(width, np.float32)  # a column more on each side
    for i in range(height):
        new, old = odds[0, i], odds_before[0, i]
        differing = 0
        for j in range(width):
            differing += new[j] != old[j]
        if not differing:
            continue
        change_of[:] = 0
        first, end = max(i - 1, 0), min(i + 2, height)
        for r in range(first, end):
            now, before = canvas[r], canvas_before[r]
            for j in range(width):
                change_of[j + 1] += abs(np.int32(now[j, 1]) - np.int32(before[j, 1]))
        for j in range(width):
            total = change_of[j] + change_of[j + 1] + change_of[j + 2]
            n = (end - first) * (min(j + 2, width) - max(j - 1, 0))
            weight[j] = keep * min(max(2.0 - total / (n * change), 0.0), 1.0) if new[j] != old[j] else 0.0
        for k in range(outputs):
            new, old = odds[k, i], odds_before[k, i]
            for j in range(width):
                new[j] += weight[j] * (old[j] - new[j])


class _Detector:
    """Looks at the frames of one clip in order; what it remembers is where the mouth was."""

    def __init__(self, settings: LipSettings) -> None:
        self.settings = settings
        self._rest = 0  # frames not to search, after a search found nothing
        self._pause = 1
        self._forget()

    def _forget(self) -> None:
        """Nothing is known of the mouth: it has gone, or another shot has begun."""
        self._box: Box | None = None
        self._region: Region | None = None  # of the coarse canvas as it is laid now, where the lips should be
        self._canvas: np.ndarray | None = None
        self._look: Look | None = None
        self._earlier = None  # box, canvas and log-odds of the frame before

    def look(self, frame) -> Look:
        """What the method says about the next frame of the clip."""
        if self._box is not None:
            canvas = lay_canvas(frame, self._box)
            if canvas is not None and self._canvas is not None and _equal(canvas, self._canvas):
                return self._look
            look, score = self._measure(canvas)
            if score >= self.settings.lost_below:
                self._canvas, self._look = canvas, look
                return look
            self._forget()  # look for it elsewhere in this frame
        needed = self._search(frame)
        if needed is None:
            return Look(NO_MOUTH, confidence=0.0)
        for _ in range(SETTLE_STEPS):
            box, canvas = self._box, lay_canvas(frame, self._box)
            look, score = self._measure(canvas)
            if self._box is box or score < self.settings.lost_below:
                break
        if score < needed:
            self._forget()
            return Look(NO_MOUTH, confidence=0.0)
        self._canvas, self._look = canvas, look
        return look

    def _search(self, frame) -> float | None:
        """Lay the box over the likeliest mouth; the score it then needs on the fine canvas, None if there is none."""
        if self._rest > 0:
            self._rest -= 1
            return None
        for place in places(frame):
            best, best_score = None, self.settings.found_in_face if place.is_face else self.settings.found_above
            for start in place.boxes:
                box, score = settle(frame, start, 2)
                score *= place.likelihood(box)
                if score > best_score:
                    best, best_score = box, score
            if best:
                self._pause = 1
                self._box, _ = settle(frame, best, 2)
                return self.settings.lost_below if place.is_face else self.settings.confirmed_above
        self._rest = self._pause = min(2 * self._pause, 8)
        return None

    def _measure(self, canvas: np.ndarray | None) -> tuple[Look, float]:
        lost = Look(NO_MOUTH, confidence=0.0), 0.0
        if canvas is None:
            return lost
        coarse, lips = self._coarse(shrunk(canvas))
        if lips is None:
            return lost
        region = lips.region(CANVAS)
        odds = self._steadied(canvas, fine_odds(canvas, coarse, region))
        lips = main_lips(odds[LIP], region)
        if lips is None:
            return lost
        box, settings = self._box, self.settings
        score = mouth_score(odds[LIP], lips)
        if self._look is not None:
            sign = 1 if self._look.status == CLOSED else -1
            settings = replace(settings, sure_above=settings.sure_above + sign * settings.hysteresis)
        field, peak = openings_on(odds, lips, settings)
        outlines = [box.to_picture(outline) for outline in level_outlines(field, 0.0)]
        self._region = lips.region(COARSE)
        self._follow(moved_box(box, lips, CANVAS), lips)
        decided = np.tanh(abs(peak - settings.sure_above) / 2)
        confidence = float(score * (0.3 + 0.7 * decided))
        return Look(OPEN if outlines else CLOSED, outlines, box.to_picture(lips.corners), confidence), score

    def _steadied(self, canvas: np.ndarray, odds: np.ndarray) -> np.ndarray:
        """Log-odds drawn towards those of the frame before where the picture is the same: noise is not movement."""
        earlier, settings = self._earlier, self.settings
        if earlier is not None and earlier[0] is self._box and settings.steady > 0:
            _steady(canvas, earlier[1], odds, earlier[2], settings.steady, settings.change)
        self._earlier = (self._box, canvas, odds)
        return odds

    def _coarse(self, canvas: np.ndarray) -> tuple[np.ndarray, Lips | None]:
        """Coarse log-odds and lips, looking only around where the lips were while they stay there."""
        if self._region is not None:
            region = self._region
            odds = coarse_odds(canvas, region)
            lips = main_lips(odds[LIP], region)
            if lips is not None and lips.fits(region, COARSE):
                return odds, lips
        odds = coarse_odds(canvas)
        return odds, main_lips(odds[LIP])

    def _follow(self, seen: Box, lips: Lips) -> None:
        """Lay the canvas anew for the next frame if the mouth has left its place."""
        now, s = self._box, self.settings
        if not seen.width_px >= MIN_WIDTH_PX:
            return
        moved = np.hypot(seen.row - now.row, seen.col - now.col) > s.move_mw * now.width_px
        resized = abs(np.log(seen.width_px / now.width_px)) > s.resize
        turned = abs(seen.roll_rad - now.roll_rad) > s.turn_rad
        if moved or resized or turned:
            width = now.width_px * float(np.clip(seen.width_px / now.width_px, 0.8, 1.25))
            self._box = replace(seen, width_px=width)
            self._region = lips.centred(now.scale / self._box.scale).region(COARSE)


def make_detector(settings: LipSettings | None, info):
    """A detector of the default method for the frames of one clip."""
    return _Detector(settings or LipSettings())
