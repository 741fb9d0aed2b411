"""The default method: find the mouth, lay a canvas over it, classify its pixels, decide what is open.

Two stages of one kind of classifier (`lipmetrics.forest`), trained on drawn mouths (`lipmetrics.artificial`), the
second on simulated ones too: a coarse one that says where the lips are, and a fine one that sees the coarse answer and
the colours relative to this person's lips and skin. Their answers are made into one mouth by `lipmetrics.decode`, and
`lipmetrics.border` sharpens its borders. The canvas follows the mouth, small steps by a part only: a still face gives
a still measurement.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib import resources
from itertools import takewhile

import cv2
import numpy as np

from lipmetrics import border, features
from lipmetrics.box import ASPECT, CANVAS, COARSE, MOUTH, Box, lay_canvas, nine_of_sixteen
from lipmetrics.confidence import Evidence, confidence, undecided
from lipmetrics.decode import Mouth, Opening, decode, sums_inside
from lipmetrics.errors import InputError
from lipmetrics.find import Place, places
from lipmetrics.forest import load_forest, log_odds
from lipmetrics.look import CLOSED, NO_MOUTH, OPEN, Look
from lipmetrics.regions import likeliest_region, middle_row, sums_over
from lipmetrics.steady import steady

LIP, OPENING, LOWER = range(3)  # outputs: lip or opening, opening, lower lip
ELSEWHERE = -4.0  # log-odds of what was not looked at, far from the lips
MIN_WIDTH_PX = 12  # narrower mouths have nothing left to measure
MAX_ROLL_RAD = 0.4  # of a mouth just found: what looks more tilted is seldom a mouth
STEEPEST_RAD = 0.7  # of a mouth that is being followed
SETTLE_STEPS = 4  # at most, of the canvas over a mouth just found
CHECK_AFTER, CHECK_AT_MOST = 8, 64  # frames until a mouth found outside a face is held against the faces seen by then
NOT_IN_FACE = 0.05  # likelihood below which a mouth is not that of a face
LOOK_ROUND = 8  # every so many frames the whole canvas is looked at, not only where the mouth was
MARGIN = (8, 4)  # rows, columns around the lips that are looked at again: in a frame the lips move less than that
CENTRAL = (20, 92, 7, 57)  # of the fine canvas: looked at in the first frame, even if the coarse look sees less
Region = tuple[int, int, int, int]  # half-open part (row0, row1, col0, col1) of a canvas
Extent = tuple[float, float, float, float]  # top, bottom, left, right of a mouth on a canvas, in its px


@dataclass(frozen=True)
class LipSettings:
    """Settings of `method="default"`. Lengths in mouth widths (mw), evidence in log-odds.

    lean : added to the log-odds of opening
    sure_above : evidence of an opening, above which it is counted: log-likelihood ratio of all its pixels, as if they
        were independent
    switch : evidence that it takes to begin or end an opening within the mouth
    min_height_mw : lower openings are not counted
    found_above : score, 0 to 1, above which a place in the picture counts as a mouth
    found_in_face : the same for the lower part of a face
    confirmed_above : score of the fine look at a mouth just found outside a face, below which it was none
    lost_below : score below which a mouth that was being followed counts as gone
    steady : how much of the evidence of the frame before is kept where the picture has not changed, 0 to below 1
    change : difference in grey levels up to which a pixel has not changed; at twice that nothing is kept
    hysteresis : added to sure_above after a closed frame, taken off after an open one
    move_mw, resize, turn_rad : when the mouth has moved, grown or turned by this much the canvas follows half of it; by
        less, less; by much more, wholly
    rest : below this share of them it stays where it is
    """

    lean: float = 0.4
    sure_above: float = 7.5
    switch: float = 1.5
    min_height_mw: float = 0.022
    found_above: float = 0.52
    found_in_face: float = 0.08
    confirmed_above: float = 0.5
    lost_below: float = 0.1
    steady: float = 0.6
    change: float = 6.0
    hysteresis: float = 3.5
    move_mw: float = 0.06
    resize: float = 0.08
    turn_rad: float = 0.06
    rest: float = 0.3

    def __post_init__(self) -> None:
        if not (0 <= self.steady < 1 and self.change > 0 and self.hysteresis >= 0):
            raise InputError("expected steady from 0 to below 1, change above 0 and hysteresis of at least 0")
        if not 0 <= self.lost_below <= self.found_above <= 1:
            raise InputError(
                f"expected 0 <= lost_below <= found_above <= 1, got {self.lost_below} and {self.found_above}"
            )
        if min(self.min_height_mw, self.move_mw, self.resize, self.turn_rad, self.rest) < 0:
            raise InputError("expected min_height_mw, move_mw, resize, turn_rad and rest of at least 0")


@lru_cache(maxsize=1)
def forests():
    """The forests that come with the package: coarse, fine, and that of the borders."""
    with resources.as_file(resources.files("lipmetrics") / "data" / "lips.npz") as file:
        return tuple(load_forest(file, name) for name in ("coarse", "fine", "border"))


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


def _only(odds: np.ndarray, region: Region) -> np.ndarray:
    """The log-odds (outputs, rows, cols) inside a region, ELSEWHERE around it."""
    row0, row1, col0, col1 = region
    out = np.full_like(odds, ELSEWHERE)
    out[:, row0:row1, col0:col1] = odds[:, row0:row1, col0:col1]
    return out


def coarse_odds(canvas: np.ndarray, region: Region | None = None) -> np.ndarray:
    """Log-odds (3, *COARSE) float32 of a canvas (*COARSE, 3) uint8 RGB; ELSEWHERE outside the region."""
    return _odds(forests()[0], coarse_inputs(canvas, region), COARSE, region)


def fine_odds(canvas: np.ndarray, coarse: np.ndarray, region: Region | None = None) -> np.ndarray:
    """Log-odds (3, *CANVAS) float32 of a canvas (*CANVAS, 3) uint8 RGB and its coarse log-odds; region as above."""
    return _odds(forests()[1], fine_inputs(canvas, coarse, region), CANVAS, region)


def _odds(forest, maps: np.ndarray, size: tuple[int, int], region: Region | None) -> np.ndarray:
    row0, row1, col0, col1 = region or (0, size[0], 0, size[1])
    out = np.full((forest.bias.size, *size), ELSEWHERE, np.float32)
    return log_odds(forest, maps, features.PAD, (0, row1 - row0), (0, col1 - col0), out, (row0, col0))


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
    """What looks like lips on a canvas: mask (rows, cols) bool, and (top, bottom, left, right) half open in its px."""

    mask: np.ndarray
    top: int
    bottom: int
    left: int
    right: int

    @property
    def corners(self) -> np.ndarray:
        """(2, 2) float64 (row, column) of the left and the right end."""
        left_row = middle_row(self.mask, self.left, self.left + 2)
        right_row = middle_row(self.mask, self.right - 2, self.right)
        return np.array([(left_row, self.left - 0.5), (right_row, self.right - 0.5)])


def main_lips(odds: np.ndarray) -> Lips | None:
    """The connected lips nearest the middle of a canvas, from log-odds (rows, cols); None without any."""
    found = likeliest_region(odds, _middle_weight(odds.shape), (0, odds.shape[0], 0, odds.shape[1]))
    if found is None:
        return None
    mask, (left, top, width, height, area) = found
    if area < 6 or width < 2:
        return None
    return Lips(mask, top, top + height, left, left + width)


def lips_score(odds: np.ndarray, lips: Lips | None) -> float:
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
    down, across = (lips.top + lips.bottom - rows) / 2, ASPECT * (lips.left + lips.right - cols) / 2
    centre_off = np.hypot(down, across) / (ASPECT * cols)
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
    tilt = np.arctan2(corners[1, 0] - corners[0, 0], ASPECT * (corners[1, 1] - corners[0, 1]))
    width = (lips.right - lips.left) * to_fine[1] * ASPECT * box.scale
    return Box(
        float(row), float(col), float(width), float(np.clip(box.roll_rad + 0.7 * tilt, -MAX_ROLL_RAD, MAX_ROLL_RAD))
    )


def region_of(extent: Extent, size: tuple[int, int], other: tuple[int, int]) -> Region:
    """The part of a canvas of the `other` size with a mouth found on one of `size`, and MARGIN px around it."""
    per_row, per_col = other[0] / size[0], other[1] / size[1]
    top, bottom, left, right = extent
    row0, col0 = int((top + 0.5) * per_row) - MARGIN[0], int((left + 0.5) * per_col) - MARGIN[1]
    row1, col1 = math.ceil((bottom + 0.5) * per_row) + MARGIN[0], math.ceil((right + 0.5) * per_col) + MARGIN[1]
    return max(row0, 0), min(row1, other[0]), max(col0, 0), min(col1, other[1])


def moved_extent(extent: Extent, box: Box, other: Box) -> Extent:
    """The extent on another box's canvas of what has the `extent` on that of `box`."""
    top, bottom, left, right = extent
    (rows, to_row, row), (cols, to_col, col) = box.onto(other).tolist()
    down = [rows * r + to_row * c + row for r in (top, bottom) for c in (left, right)]
    across = [cols * r + to_col * c + col for r in (top, bottom) for c in (left, right)]
    return min(down), max(down), min(across), max(across)


def union(one: Region, other: Region) -> Region:
    """The smallest region that holds both."""
    return min(one[0], other[0]), max(one[1], other[1]), min(one[2], other[2]), max(one[3], other[3])


def fits(mouth: Mouth, region: Region, size: tuple[int, int]) -> bool:
    """Whether a mouth on a canvas of `size` ends inside the region, or where the canvas ends."""
    row0, row1, col0, col1 = region
    top, bottom, _, _ = mouth.extent
    return (
        (top > row0 or row0 == 0)
        and (bottom < row1 - 1 or row1 == size[0])
        and (mouth.left > col0 or col0 == 0)
        and (mouth.right < col1 or col1 == size[1])
    )


def mouth_score(odds: np.ndarray, mouth: Mouth) -> float:
    """How much log-odds of lips or opening (rows, cols) look like this one mouth in the middle of a canvas, 0 to 1.

    Its mean probability, less the share of what looks like lips but is elsewhere; less if it is off the middle, of the
    wrong size, or runs off the canvas.
    """
    rows, cols = odds.shape
    area, total, likely, everywhere = sums_inside(odds, mouth.left, mouth.top, mouth.bottom)
    if area == 0:
        return 0.0
    chance = total / area  # not of log-odds: teeth that do not look like a mouth must not hide its lips
    stray = (everywhere - likely) / (everywhere - likely + 2 * area)
    off_size = math.log((mouth.right - mouth.left) / (cols * MOUTH / CANVAS[1]))
    middle = mouth.middle
    off_centre = math.hypot(middle[0] - (rows - 1) / 2, ASPECT * (middle[1] - (cols - 1) / 2)) / (ASPECT * cols)
    top, bottom, _, _ = mouth.extent
    runs_off = mouth.left == 0 or mouth.right == cols or top < 0 or bottom > rows - 1
    score = chance * (1 - stray) * math.exp(-((off_size / 0.6) ** 2) - (off_centre / 0.25) ** 2)
    return score * (0.6 if runs_off else 1.0)


def evidence_of(
    odds: np.ndarray,
    region: Region,
    mouth: Mouth,
    score: float,
    candidates: list[Opening],
    counted: list[Opening],
    needed: float,
) -> Evidence:
    """What is known of a frame for its confidence: log-odds (3, *CANVAS) and what came of them.

    candidates, counted : openings before and after they were held against the evidence `needed`
    """
    top, bottom, _, _ = mouth.extent
    rows = slice(max(int(top) - 1, region[0]), min(int(bottom) + 2, region[1]))
    opening, lip = (undecided(odds[kind, rows, mouth.left : mouth.right]) for kind in (OPENING, LIP))
    bar = max(needed, 0.0) + 1
    nearest = min(
        (abs(math.log((each.evidence + 1) / bar)) for each in candidates if each.evidence > 0), default=math.log(bar)
    )
    return Evidence(float(bool(counted)), float(opening.max()), float(lip.mean()), score, nearest)


def mouth_box(box: Box, mouth: Mouth, size: tuple[int, int]) -> Box:
    """The box of a mouth found on a canvas of `size` that was laid by `box`."""
    per_row, per_col = CANVAS[0] / size[0], CANVAS[1] / size[1]
    row, col = mouth.middle
    row, col = box.place((row + 0.5) * per_row - 0.5, (col + 0.5) * per_col - 0.5)
    tilt = math.atan(mouth.slope * per_row / (per_col * ASPECT))
    width = (mouth.right - mouth.left) * per_col * ASPECT * box.scale
    return Box(row, col, width, min(max(box.roll_rad + 0.7 * tilt, -STEEPEST_RAD), STEEPEST_RAD))


def settle(frame, place: Place, box: Box, steps: int) -> tuple[Box, float]:
    """Move a box to the lips it sees, a few times; the best of them and its score, 0 where it sees none.

    The score is that of the look by which a box was found, times how likely a mouth lies there in this place.
    """
    best, best_score = box, 0.0
    for _ in range(steps):
        canvas = lay_canvas(frame, box, COARSE)
        if canvas is None:
            break
        odds = coarse_odds(canvas)[LIP]
        lips = main_lips(odds)
        if lips is None:
            break
        box = moved_box(box, lips, COARSE)
        if not MIN_WIDTH_PX <= box.width_px <= 4 * frame.width:
            break
        score = lips_score(odds, lips) * place.likelihood(box)
        if score > best_score:
            best, best_score = box, score
    return best, best_score


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
        self._seen: Region | None = None  # of the fine canvas, where the mouth was
        self._settled = False
        self._looked = 0
        self._earlier = None  # box, canvas, log-odds of the frame before, and the region that these are of
        self._in_face = True  # the mouth is known to be a face's
        self._check_in = self._check_pause = CHECK_AFTER

    def look(self, frame) -> Look:
        """What the method says about the next frame of the clip."""
        if self._box is not None and not self._in_face:
            self._check_place(frame)
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
        self._box = box
        self._canvas, self._look, self._settled = canvas, look, True
        return look

    def _check_place(self, frame) -> None:
        """Now and then, whether a face has come up that has its mouth elsewhere than the one being followed."""
        self._check_in -= 1
        if self._check_in > 0:
            return
        self._check_in = self._check_pause = min(2 * self._check_pause, CHECK_AT_MOST)
        likely = [place.likelihood(self._box) for place in takewhile(lambda place: place.is_face, places(frame))]
        self._in_face = max(likely, default=0.0) >= NOT_IN_FACE
        if likely and not self._in_face:
            self._forget()

    def _search(self, frame) -> float | None:
        """Lay the box over the likeliest mouth; the score it then needs on the fine canvas, None if there is none."""
        if self._rest > 0:
            self._rest -= 1
            return None
        for place in places(frame):
            best, best_score = None, self.settings.found_in_face if place.is_face else self.settings.found_above
            for start in place.boxes:
                box, score = settle(frame, place, start, 2)
                if score > best_score:
                    best, best_score = box, score
            if best:
                self._pause = 1
                self._in_face = place.is_face
                self._box, _ = settle(frame, place, best, 2)
                return self.settings.lost_below if place.is_face else self.settings.confirmed_above
        self._rest = self._pause = min(2 * self._pause, 8)
        return None

    def _measure(self, canvas: np.ndarray | None) -> tuple[Look, float]:
        lost = Look(NO_MOUTH, confidence=0.0), 0.0
        if canvas is None:
            return lost
        earlier = self._earlier
        odds, region, mouth, maps = self._decoded(canvas)
        if self._seen is not None and (mouth is None or not fits(mouth, region, CANVAS)):
            self._region, self._seen, self._earlier = None, None, earlier  # it has left where it was: look everywhere
            odds, region, mouth, maps = self._decoded(canvas)
        if mouth is None:
            return lost
        box, settings = self._box, self.settings
        score = mouth_score(odds[LIP], mouth)
        sharpened = partial(border.moved, forests()[2], maps, odds, (region[0], region[2]))
        candidates = mouth.openings(settings.switch, sharpened)
        openings = [each for each in candidates if each.height >= settings.min_height_mw * ASPECT * MOUTH]
        needed = settings.sure_above
        if self._look is not None:
            needed += settings.hysteresis if self._look.status == CLOSED else -settings.hysteresis
        counted = [each for each in openings if each.evidence >= needed]
        outlines = [box.to_picture(each.outline) for each in counted]
        self._follow(mouth_box(box, mouth, CANVAS))
        if self._box is box or self._settled:
            extent = mouth.extent if self._box is box else moved_extent(mouth.extent, box, self._box)
            self._region, self._seen = region_of(extent, CANVAS, COARSE), region_of(extent, CANVAS, CANVAS)
        else:
            self._region = self._seen = None
        known = evidence_of(odds, region, mouth, score, candidates, counted, needed)
        status = OPEN if outlines else CLOSED
        return Look(status, outlines, box.to_picture(mouth.corners), confidence(known), known), score

    def _decoded(self, canvas: np.ndarray) -> tuple[np.ndarray, Region, Mouth | None, np.ndarray]:
        """Fine log-odds, the part of the canvas that they are of, the mouth there, and the maps of that part."""
        coarse, region = self._coarse(shrunk(canvas))
        maps = fine_inputs(canvas, coarse, region)
        odds = self._steadied(canvas, _odds(forests()[1], maps, CANVAS, region), region)
        return odds, region, decode(odds, region, self.settings.lean), maps

    def _steadied(self, canvas: np.ndarray, odds: np.ndarray, region: Region) -> np.ndarray:
        """Log-odds drawn towards those of the frame before where the picture is the same: noise is not movement."""
        settings = self.settings
        if self._earlier is not None and settings.steady > 0:
            box, *before = self._earlier
            steady(canvas, odds, region, *before, self._box.onto(box), settings.steady, settings.change)
        self._earlier = (self._box, canvas, odds, region)
        return odds

    def _coarse(self, canvas: np.ndarray) -> tuple[np.ndarray, Region]:
        """Coarse log-odds, and where on the fine canvas to look: where the mouth was, if that is known.

        Every LOOK_ROUND frames the whole canvas is looked at, lest a part of the mouth be followed.
        """
        self._looked += 1
        region, seen = self._region, self._seen
        if region is not None and seen is not None and self._looked % LOOK_ROUND:
            return coarse_odds(canvas, region), seen
        odds = coarse_odds(canvas)
        mouth = decode(odds)
        if region is not None and seen is not None and mouth is not None and fits(mouth, region, COARSE):
            odds = _only(odds, region)  # as if it had not been looked at, so that the fine answer does not jump
        else:
            self._region, self._seen, seen = None, None, CENTRAL
        return odds, seen if mouth is None else union(region_of(mouth.extent, COARSE, CANVAS), seen)

    def _follow(self, seen: Box) -> None:
        """Let the canvas of the next frame follow the mouth: wholly a mouth just found, else the more it has moved."""
        now, s = self._box, self.settings
        if not seen.width_px >= MIN_WIDTH_PX:
            return
        steps = (
            math.hypot(seen.row - now.row, seen.col - now.col) / (s.move_mw * now.width_px),
            math.log(seen.width_px / now.width_px) / s.resize,
            (seen.roll_rad - now.roll_rad) / s.turn_rad,
        )
        if self._settled:
            move, resize, turn = (z * z / (1 + z * z) if abs(z) > s.rest else 0.0 for z in steps)
        else:
            move = resize = turn = float(max(map(abs, steps)) > 1)
        if max(move, resize, turn) == 0:
            return
        self._box = Box(
            now.row + move * (seen.row - now.row),
            now.col + move * (seen.col - now.col),
            now.width_px * min(max((seen.width_px / now.width_px) ** resize, 0.8), 1.25),
            now.roll_rad + turn * (seen.roll_rad - now.roll_rad),
        )


def make_detector(settings: LipSettings | None, info):
    """A detector of the default method for the frames of one clip."""
    return _Detector(settings or LipSettings())
