"""From how likely each pixel is lip or opening to one mouth: where it lies and, column by column, where it is open.

A column of a mouth is skin, upper lip, opening, lower lip and skin, in this order; each part may be of height zero, and
where the opening is, the lips touch. The best borders in all columns together are found by dynamic programming
(Viterbi 1967, IEEE Trans. Inf. Theory 13): evidence of the pixels against jumps from column to column. So a shadow
under the lip or the nose, which has skin on one side, is no opening, however dark it is.

Inside, a border is counted from the upper edge of the map: border r lies above row r.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numba as nb
import numpy as np

# Floors of probabilities: no pixel speaks more strongly against a part than the logarithm of its floor.
LIP_FLOOR, OPENING_FLOOR = 0.05, 0.03
SKIN_FLOOR = 0.3  # what lies around a mouth - nostrils, beards, shadows - often looks like lips
LEAST_LIP_PX, LEAST_LIP_COST = 2, 1.0  # lip expected over and under an opening, and the cost of each px less
SEAM_COST, SIDE_COST = 1.0, 2.0  # of a jump: times its rows for the seam, times rows + rows^2 / 2 for a border
STEEPEST = 6  # rows per column
BAND = 4  # rows above and below the best border in which its mean is taken
MOUTH_SWITCH, MOUTH_BIAS = 2.5, 0.3  # cost of a corner of the mouth, and of a column of it
HEAT = 2.0  # pixels side by side say much the same: their evidence together is worth so many times less
CORNER_ROWS = 3  # above and below the seam, in which lips are followed to the corner
NARROWEST = 2  # columns of a mouth
LEAST_BEYOND, MOST_BEYOND = 0.25, 0.7  # columns that an opening reaches beyond the middles of its first and last
CORNER_COLS = 3  # farthest that lips are followed beyond the columns that tell them from skin
FAR_FROM, FAR_COST = (
    0.3,
    40.0,
)  # share of the map's width from its middle where a column begins to cost, up to this at the edge

ODDS_STEPS, ODDS_MAX = 16, 8  # table of the logistic function: steps per unit of log-odds, and where it ends
PARTS = 512  # steps of the tables of logarithms

_ODDS = np.arange(-ODDS_MAX * ODDS_STEPS, ODDS_MAX * ODDS_STEPS + 1) / ODDS_STEPS
_LOGISTIC = (1 / (1 + np.exp(-_ODDS))).astype(np.float32)
_CHANCES = np.arange(PARTS + 1) / PARTS
_LOG_LIP, _LOG_OPENING = (np.log(_CHANCES + floor).astype(np.float32) for floor in (LIP_FLOOR, OPENING_FLOOR))
_LOG_SKIN = np.log(SKIN_FLOOR + (1 - SKIN_FLOOR) * _CHANCES).astype(np.float32)
_JUMPS = np.arange(STEEPEST + 1)
_SEAM_COSTS = (SEAM_COST * _JUMPS).astype(np.float32)
_SIDE_COSTS = (SIDE_COST * (_JUMPS + _JUMPS**2 / 2)).astype(np.float32)


@dataclass(frozen=True)
class Opening:
    """outline : (n, 2) float64 (row, column) px; height : of its highest column, px; evidence : log-likelihood ratio of
    open against closed, all columns together"""

    outline: np.ndarray
    height: float
    evidence: float


@dataclass(frozen=True)
class Mouth:
    """A mouth on a map, in its px: (0, 0) is the centre of its first pixel, so row 0 begins at -0.5.

    left, right : its columns, half open
    seam : (columns,) row along which the lips meet, or would
    top, bottom : (columns,) rows where the lips border on skin
    upper, lower : (columns,) rows where the opening borders on the lips, or would
    evidence : (columns,) log-likelihood ratio of open against closed there
    likely : (columns,) log-likelihood ratio of a mouth there against skin only
    """

    left: int
    right: int
    seam: np.ndarray
    top: np.ndarray
    bottom: np.ndarray
    upper: np.ndarray
    lower: np.ndarray
    evidence: np.ndarray
    likely: np.ndarray

    @property
    def corners(self) -> np.ndarray:
        """(2, 2) float64 (row, column) of the left and the right end."""
        return np.array([(self.seam[:2].mean(), self.left - 0.5), (self.seam[-2:].mean(), self.right - 0.5)])

    @cached_property
    def extent(self) -> tuple[float, float, float, float]:
        """Highest and lowest row of the lips, and where its columns begin and end."""
        return float(self.top.min()), float(self.bottom.max()), self.left - 0.5, self.right - 0.5

    @cached_property
    def middle(self) -> tuple[float, float]:
        """(row, column) half-way between the upper and the lower end, and between the corners."""
        return (quantile(self.top, 0.1) + quantile(self.bottom, 0.9)) / 2, (self.left + self.right - 1) / 2

    @property
    def slope(self) -> float:
        """Rows per column by which the seam falls from left to right, least squares."""
        return _slope(self.seam)

    def open_runs(self, switch: float) -> np.ndarray:
        """First column and column after the last (n, 2) of what is open, counted from `left`; as :meth:`openings`."""
        is_open = np.concatenate([[False], switched(self.evidence, switch), [False]])
        return np.flatnonzero(is_open[1:] != is_open[:-1]).reshape(-1, 2)

    def openings(self, switch: float, sharpened: Callable | None = None) -> list[Opening]:
        """Where it is open, from left to right; a column where open becomes closed, or closed open, costs `switch`.

        sharpened : from the first column of an opening, and its borders (n,), to better borders
        """
        found = []
        for begin, end in self.open_runs(switch):
            upper, lower, count = self.upper[begin:end], self.lower[begin:end], end - begin
            if sharpened is not None:
                upper, lower = sharpened(self.left + begin, upper, lower)
            outline = np.empty((2 * count + 2, 2))
            outline[1 : count + 1, 0], outline[count + 2 :, 0] = upper, lower[::-1]
            outline[1 : count + 1, 1] = np.arange(self.left + begin, self.left + end)
            outline[count + 2 :, 1] = outline[count:0:-1, 1]
            outline[0] = (upper[0] + lower[0]) / 2, self.left + begin - _beyond(lower - upper)
            outline[count + 1] = (upper[-1] + lower[-1]) / 2, self.left + end - 1 + _beyond((lower - upper)[::-1])
            found.append(Opening(outline, float((lower - upper).max()), float(self.evidence[begin:end].sum())))
        return found


def decode(odds: np.ndarray, region: tuple[int, int, int, int] | None = None, lean: float = 0.0) -> Mouth | None:
    """The best mouth on log-odds (3, rows, cols) float32 of lips or opening, opening, and lower lip; None without one.

    region : half-open part (row0, row1, col0, col1) of the map to look at, all of it by default; the mouth is given in
        the map's px all the same
    lean : added to the log-odds of opening
    """
    row0, row1, col0, col1 = region or (0, odds.shape[1], 0, odds.shape[2])
    left, right, found = _decode(
        np.ascontiguousarray(odds[:, row0:row1, col0:col1]),  # else all is compiled twice
        np.float32(lean),
        _column_costs(odds.shape[2])[col0:col1],
        _LOGISTIC,
        _LOG_LIP,
        _LOG_OPENING,
        _LOG_SKIN,
        _SEAM_COSTS,
        _SIDE_COSTS,
    )
    if right - left < NARROWEST:
        return None
    found[:5] += row0 - 0.5
    seam, top, bottom, upper, lower, evidence, likely = found
    return Mouth(left + col0, right + col0, seam, top, bottom, upper, lower, evidence, likely)


@lru_cache(maxsize=4)
def _column_costs(cols: int) -> np.ndarray:
    """What a column (cols,) of mouth costs: the canvas was laid over the mouth, so its edges are seldom part of it."""
    from_middle = np.abs(np.arange(cols) - (cols - 1) / 2) / cols
    return MOUTH_BIAS + FAR_COST * np.clip((from_middle - FAR_FROM) / (0.5 - FAR_FROM), 0, None)


@nb.njit(cache=True, nogil=True)
def _decode(odds, lean, column_costs, logistic, log_lip, log_opening, log_skin, seam_costs, side_costs):
    rows, cols = odds.shape[1:]
    above, below = np.empty((rows + 1, cols), np.float32), np.empty((rows + 1, cols), np.float32)
    begin, end = np.empty((rows + 1, cols), np.int16), np.empty((rows + 1, cols), np.int16)
    skin = np.empty(cols, np.float32)
    column_scores(odds, lean, logistic, log_lip, log_opening, log_skin, above, below, begin, end, skin)
    # the seam runs where something above and something below make most of a mouth, or where there is none
    score = np.empty((rows + 1, cols), np.float32)
    for j in range(cols):
        best = above[0, j]
        for i in range(rows + 1):
            best = max(best, above[i, j])
            score[i, j] = best
        best = below[rows, j]
        for i in range(rows, -1, -1):
            best = max(best, below[i, j])
            score[i, j] = max(score[i, j] + best - skin[j], np.float32(0))
    highest, lowest = np.zeros(cols, np.int64), np.full(cols, rows, np.int64)
    seam = best_path(score, highest, lowest, seam_costs)
    likely = np.empty(cols)
    for j in range(cols):
        likely[j] = score[seam[j], j] - column_costs[j]
    left, right = _best_run(switched(likely, MOUTH_SWITCH), likely)
    if right - left < NARROWEST:
        return left, right, np.zeros((7, 0))
    left = _corner(odds[0], seam, left, -1)
    right = _corner(odds[0], seam, right - 1, 1) + 1
    found = np.zeros((7, right - left))
    seam, above, below = seam[left:right], above[:, left:right], below[:, left:right]
    upper = best_path(above, highest, seam, side_costs)
    lower = best_path(below, seam, lowest, side_costs)
    found[3] = mean_path(above, upper, highest, seam, side_costs, HEAT)
    found[4] = mean_path(below, lower, seam, lowest, side_costs, HEAT)
    for j in range(right - left):
        closed = above[upper[j], j] + below[upper[j], j]
        for i in range(upper[j] + 1, lower[j] + 1):
            closed = max(closed, above[i, j] + below[i, j])
        found[0, j] = seam[j]
        found[1, j] = begin[upper[j], left + j]
        found[2, j] = end[lower[j], left + j]
        found[5, j] = above[upper[j], j] + below[lower[j], j] - closed
        found[6, j] = likely[left + j]
    return left, right, found


@nb.njit(cache=True, nogil=True)
def _corner(lip, seam, col, side):
    """The last column from `col` on towards `side`, -1 or 1, to which lips go on; the seam is moved there with them.

    Lips end thinner than the evidence of a column can tell from skin.
    """
    rows, cols = lip.shape
    row = seam[col]
    for _ in range(CORNER_COLS):
        if not 0 <= col + side < cols:
            break
        best, at = np.float32(0), -1
        for i in range(max(row - CORNER_ROWS, 0), min(row + CORNER_ROWS, rows)):
            if lip[i, col + side] > best:
                best, at = lip[i, col + side], i
        if at < 0:
            break
        col += side
        row = min(max(at, row - 1), row + 1)
        seam[col] = row
    return col


@nb.njit(cache=True, nogil=True)
def _look_up(table, chance):
    return table[int(chance * np.float32(PARTS))]


@nb.njit(cache=True, nogil=True)
def _chance(logistic, odds):
    k = int(np.float32(ODDS_STEPS) * odds + np.float32(ODDS_MAX * ODDS_STEPS + 0.5))
    return logistic[min(max(k, 0), logistic.size - 1)]


@nb.njit(cache=True, nogil=True)
def column_scores(odds, lean, logistic, log_lip, log_opening, log_skin, above, below, begin, end, all_skin):
    """Log-likelihoods of each column of odds (3, rows, cols) for every place of the opening's borders.

    Fills above and below (rows + 1, cols): an opening from border u to border l has above[u] + below[l]; the lips
    around it are as high as suits best, from border begin[u] and to border end[l]. Fills all_skin (cols,): no mouth.
    """
    rows, cols = odds.shape[1:]
    skin, inside = np.zeros(rows + 1, np.float32), np.zeros(rows + 1, np.float32)
    upper, lower = np.zeros(rows + 1, np.float32), np.zeros(rows + 1, np.float32)
    least, cost = LEAST_LIP_PX, np.float32(LEAST_LIP_COST)
    tiny, one = np.float32(0.02), np.float32(1)
    for j in range(cols):
        for i in range(rows):  # sums from the top
            opening = _chance(logistic, odds[1, i, j] + lean)
            mouth = max(_chance(logistic, odds[0, i, j]), opening)
            low = max(_chance(logistic, odds[2, i, j]), tiny)
            low = (mouth - opening) * low / (low + max(mouth - opening - low, tiny))
            skin[i + 1] = skin[i] + _look_up(log_skin, one - mouth)
            inside[i + 1] = inside[i] + _look_up(log_opening, opening)
            lower[i + 1] = lower[i] + _look_up(log_lip, low)
            upper[i + 1] = upper[i] + _look_up(log_lip, mouth - opening - low)
        all_skin[j] = skin[rows]
        best, where = np.float32(-1e30), 0
        for i in range(rows + 1):
            if i >= least and skin[i - least] - upper[i - least] > best:
                best, where = skin[i - least] - upper[i - least], i - least
            above[i, j], begin[i, j] = best, where
            for k in range(min(least, i + 1)):
                thin = skin[i - k] - upper[i - k] - cost * (least - k)
                if thin > above[i, j]:
                    above[i, j], begin[i, j] = thin, i - k
            above[i, j] += upper[i] - inside[i]
        best, where = np.float32(-1e30), rows
        for i in range(rows, -1, -1):
            if i + least <= rows and lower[i + least] - skin[i + least] > best:
                best, where = lower[i + least] - skin[i + least], i + least
            below[i, j], end[i, j] = best, where
            for k in range(min(least, rows - i + 1)):
                thin = lower[i + k] - skin[i + k] - cost * (least - k)
                if thin > below[i, j]:
                    below[i, j], end[i, j] = thin, i + k
            below[i, j] += skin[rows] - lower[i] + inside[i]


@nb.njit(cache=True, nogil=True)
def best_path(score, highest, lowest, costs):
    """Rows (cols,) int64, one per column of score (rows, cols), with the greatest sum of scores less costs[jump].

    A jump is the distance in rows between neighbouring columns, less than len(costs); in column j the path lies between
    the rows highest[j] and lowest[j]. These change by less than len(costs) between neighbouring columns too.
    """
    rows, cols = score.shape
    never = np.float32(-1e30)
    reach = len(costs) - 1
    # plain loops: array expressions take several times as long to compile
    value, before = np.empty(rows, np.float32), np.empty(rows + 2 * reach, np.float32)
    came = np.zeros((cols, rows), np.int8)
    for i in range(before.size):
        before[i] = never
    for j in range(cols):
        if j:
            for i in range(rows):
                before[reach + i] = value[i]
                value[i] -= costs[0]
            for jump in range(1, reach + 1):
                for sign in (-1, 1):
                    first = reach + sign * jump
                    others, here, by, cost = before[first : first + rows], came[j], np.int8(sign * jump), costs[jump]
                    for i in range(value.size):
                        other = others[i] - cost
                        better = other > value[i]
                        value[i] = other if better else value[i]
                        here[i] = by if better else here[i]
            for i in range(rows):
                value[i] += score[i, j]
        else:
            for i in range(rows):
                value[i] = score[i, 0]
        for i in range(highest[j]):
            value[i] = never
        for i in range(lowest[j] + 1, rows):
            value[i] = never
    best = 0
    for i in range(1, rows):
        if value[i] > value[best]:
            best = i
    path = np.empty(cols, np.int64)
    path[cols - 1] = best
    for j in range(cols - 1, 0, -1):
        path[j - 1] = path[j] + came[j, path[j]]
    return path


@nb.njit(cache=True, nogil=True)
def mean_path(score, path, highest, lowest, costs, heat):
    """Mean row (cols,) float64 of all paths as in :func:`best_path` that stay within BAND rows of `path`.

    Each counts with exp(its sum / heat), so the mean lies between rows, where the evidence puts it, and hardly moves
    with noise (forward-backward: Rabiner 1989, Proc. IEEE 77).
    """
    cols = score.shape[1]
    size = 2 * BAND + 1
    step = np.exp(-costs.astype(np.float64) / heat)
    weight = np.zeros((cols, size))
    for j in range(cols):
        for k in range(size):
            i = path[j] + k - BAND
            if highest[j] <= i <= lowest[j]:
                weight[j, k] = np.exp(min((score[i, j] - score[path[j], j]) / heat, 300.0))
    ahead, behind = np.ones((cols, size)), np.ones((cols, size))
    ahead[0] = weight[0]
    for j in range(1, cols):
        for k in range(size):
            total = 0.0
            for m in range(size):
                jump = abs(path[j] + k - path[j - 1] - m)
                if jump < len(step):
                    total += step[jump] * ahead[j - 1, m]
            ahead[j, k] = total * weight[j, k]
        ahead[j] /= ahead[j].sum()
    for j in range(cols - 2, -1, -1):
        for k in range(size):
            total = 0.0
            for m in range(size):
                jump = abs(path[j] + k - path[j + 1] - m)
                if jump < len(step):
                    total += step[jump] * weight[j + 1, m] * behind[j + 1, m]
            behind[j, k] = total
        behind[j] /= behind[j].sum()
    mean = np.empty(cols)
    for j in range(cols):
        share = ahead[j] * behind[j]
        total = share.sum()
        mean[j] = path[j]
        for k in range(size):
            mean[j] += (k - BAND) * share[k] / total
    return mean


@nb.njit(cache=True, nogil=True)
def switched(evidence, cost):
    """Columns (cols,) bool that are on: the greatest sum of their evidence (cols,), less `cost` for each change between
    on and off; beyond both ends all is off."""
    cols = len(evidence)
    changed = np.zeros((cols, 2), np.bool_)  # on the best way to off and to on in this column
    off, on = 0.0, -1e30
    for j in range(cols):
        changed[j, 0], changed[j, 1] = on - cost > off, off - cost > on
        off, on = max(off, on - cost), max(on, off - cost) + evidence[j]
    state = np.zeros(cols, np.bool_)
    is_on = on - cost > off
    for j in range(cols - 1, -1, -1):
        state[j] = is_on
        if changed[j, 1 if is_on else 0]:
            is_on = not is_on
    return state


@nb.njit(cache=True, nogil=True)
def _best_run(on, evidence):
    """First column and column after the last of the run of on (cols,) whose evidence has the greatest sum."""
    best, begin, end, start, total = 0.0, 0, 0, 0, 0.0
    for j in range(len(on)):
        if not on[j]:
            start, total = j + 1, 0.0
            continue
        total += evidence[j]
        if total > best:
            best, begin, end = total, start, j + 1
    return begin, end


def _beyond(heights: np.ndarray) -> float:
    """Columns that an opening of heights (n,), from one end on, reaches beyond that end: on as it falls to it."""
    inward = min(2, len(heights) - 1)
    fall = (heights[inward] - heights[0]) / inward if inward else 0.0
    reach = heights[0] / fall if fall > 0 else LEAST_BEYOND
    return min(max(float(reach), LEAST_BEYOND), MOST_BEYOND)


@nb.njit(cache=True, nogil=True)
def _slope(values):
    """Of the straight line nearest to values (n,), per place."""
    middle = (len(values) - 1) / 2
    rise, run = 0.0, 0.0
    for k in range(len(values)):
        rise += (k - middle) * values[k]
        run += (k - middle) ** 2
    return rise / run


@nb.njit(cache=True, nogil=True)
def quantile(values, share):
    """As numpy.quantile with linear interpolation, of (n,); its preparations take longer than a few numbers do."""
    ordered = np.sort(values)
    place = share * (len(ordered) - 1)
    below = int(place)
    above = min(below + 1, len(ordered) - 1)
    return ordered[below] + (place - below) * (ordered[above] - ordered[below])


@nb.njit(cache=True, nogil=True)
def sums_inside(odds, left, top, bottom):
    """Pixels of log-odds (rows, cols) between the borders top and bottom (n,) of the columns from `left` on: their
    number, the sum of their probabilities, how many are above 0; and how many of all pixels are above 0."""
    area, chance, likely, everywhere = 0, 0.0, 0, 0
    for i in range(odds.shape[0]):
        line = odds[i]
        for j in range(line.size):
            everywhere += line[j] > 0
        for k in range(len(top)):
            if top[k] < i < bottom[k]:
                value = line[left + k]
                area += 1
                likely += value > 0
                chance += 1 / (1 + np.exp(-value))
    return area, chance, likely, everywhere
