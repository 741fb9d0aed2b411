"""Openings of a closed loop of points along the inner lips, by geometry: exact, without a picture.

A loop runs from the left corner along the upper lip to the right corner and back along the lower lip, x to the right,
y down. In every column x, open is where the upper lip is above the lower one; lips that pass one another are closed.
The open length h(x) is linear between the points and the places where lines cross, so all sizes are exact sums.
"""

from __future__ import annotations

import numba
import numpy as np
import pandas as pd

from lipmetrics.openings import Identities, Opening

LEFT, RIGHT, TOP, BOTTOM, HEIGHT, AREA, X, Y = range(8)
# Identities grow boxes by 1 px at least: with this many px per mouth width neighbours stay apart.
_PX_PER_MOUTH = 1000.0
_TOUCHING = 1e-9  # of the loop's extent


def stretches(loop: np.ndarray, gap: float = 0.0) -> np.ndarray:
    """Openings of one loop, from left to right: the stretches of columns in which it is open by more than `gap`.

    Parameters
    ----------
    loop : (N, 2) float (x, y), N >= 3, y down
    gap : least open length of a column, in the unit of the loop

    Returns
    -------
    (K, 8) float64: left, right, top, bottom, height (open length of the fullest column), area, x and y of its centre
    """
    loop = np.ascontiguousarray(loop, np.float64)
    reach = np.ptp(loop[:, 0])
    # rounding must not keep an opening together where the lips touch
    tiny = 1e-12 * max(reach, np.abs(loop[:, 0]).max())
    found = _stretches(loop, np.sort(loop[:, 0]), max(float(gap), _TOUCHING * reach), tiny)
    found = found[found[:, AREA] > 0]
    found[:, [X, Y]] /= found[:, [AREA]]
    return found


def as_one(found: np.ndarray) -> np.ndarray:
    """(1, 8) one opening with the reach and the area of all of `found` (K, 8); (0, 8) where there are none."""
    if len(found) < 2:
        return found
    area = found[:, AREA].sum()
    centre = (found[:, [X, Y]] * found[:, [AREA]]).sum(axis=0) / area
    low, high = found.min(axis=0), found.max(axis=0)
    return np.array([[low[LEFT], high[RIGHT], low[TOP], high[BOTTOM], high[HEIGHT], area, *centre]])


def tables(
    time_s: np.ndarray, found: list[np.ndarray | None], mouth_width: float
) -> tuple[dict[str, np.ndarray], pd.DataFrame]:
    """Channels and the table of openings of a take, in the unit of `found`.

    Identities are those of `lipmetrics.openings`, by overlap in x alone: a thin slit may sink by more than its height.

    Parameters
    ----------
    time_s : (T,) s
    found : openings (K, 8) of each frame as of `stretches`; None where they are unknown
    mouth_width : at rest, in the same unit
    """
    names = ("width", "height", "area", "n_openings", "total_area")
    channels = {name: np.full(len(time_s), np.nan) for name in names}
    follow, rows = Identities(reach=0.0), []
    scale = _PX_PER_MOUTH / mouth_width
    for frame, openings in enumerate(found):
        if openings is None:
            continue
        flat = [
            Opening(0.0, 1.0, left, right, right - left, 1.0, area, 0.0, 0.0)
            for left, right, area in (openings[:, [LEFT, RIGHT, AREA]] * [scale, scale, scale**2]).tolist()
        ]
        for identity, one in zip(follow.update(flat), openings.tolist(), strict=True):
            ends, centre = one[:4], one[6:]
            parents = "+".join(map(str, identity.parents))
            sizes = (one[RIGHT] - one[LEFT], one[HEIGHT], one[AREA])
            rows.append((time_s[frame], frame, identity.number, *ends, *sizes, *centre, identity.event, parents))
        if len(openings):
            largest = openings[openings[:, AREA].argmax()]
            sizes = (largest[RIGHT] - largest[LEFT], largest[HEIGHT], largest[AREA])
        else:
            sizes = (0.0, 0.0, 0.0)
        for name, value in zip(names, (*sizes, len(openings), openings[:, AREA].sum()), strict=True):
            channels[name][frame] = value
    columns = ["time_s", "frame", "opening", "left", "right", "top", "bottom", "width", "height", "area", "x", "y"]
    table = pd.DataFrame(rows, columns=[*columns, "event", "parents"])
    numbers = {name: "int64" if name in ("frame", "opening") else float for name in columns}
    return channels, table.astype({**numbers, "event": str, "parents": str})


@numba.njit(cache=True, nogil=True, error_model="numpy")  # plain loops: quick to compile
def _stretches(loop, places, gap, tiny):
    """Walk over the columns from left to right, between neighbouring `cuts`: there no line begins, ends or crosses."""
    count = len(loop)
    line = np.empty((count, 4))  # x, y of the left end, slope, x of the right end
    sign = np.empty(count)
    lines = 0
    for k in range(count):
        xa, ya, xb, yb = loop[k - 1, 0], loop[k - 1, 1], loop[k, 0], loop[k, 1]
        if xa == xb:  # upright: its ends belong to other lines
            continue
        sign[lines] = 1.0 if xa < xb else -1.0  # to the right along the upper lip, back along the lower one
        if xa > xb:
            xa, ya, xb, yb = xb, yb, xa, ya
        line[lines, 0], line[lines, 1], line[lines, 2], line[lines, 3] = xa, ya, (yb - ya) / (xb - xa), xb
        lines += 1
    order, cuts = np.empty(count, np.int64), np.empty(count * count // 2 + 2)
    y0, y1 = np.empty(count), np.empty(count)
    found = np.zeros((4 * count, 8))  # a tangle with more openings than this is no loop of lips
    openings, inside = 0, False
    for p in range(count - 1):
        left, right = places[p], places[p + 1]
        if right - left <= tiny:
            continue
        m = 0
        for k in range(lines):
            if line[k, 0] <= left + tiny and line[k, 3] >= right - tiny:
                order[m] = k
                y0[m] = line[k, 1] + line[k, 2] * (left - line[k, 0])
                y1[m] = line[k, 1] + line[k, 2] * (right - line[k, 0])
                m += 1
        cuts[0] = left
        used = 1
        for i in range(m):
            for j in range(i):
                d0, d1 = y0[i] - y0[j], y1[i] - y1[j]
                if d0 * d1 < 0:
                    cuts[used] = left + (right - left) * d0 / (d0 - d1)
                    used += 1
        cuts[used] = right
        for c in range(1, used):  # insertion: there are hardly ever more than two
            value, j = cuts[c], c
            while j > 0 and cuts[j - 1] > value:
                cuts[j] = cuts[j - 1]
                j -= 1
            cuts[j] = value
        for c in range(used):
            x0, x1 = cuts[c], cuts[c + 1]
            if x1 - x0 <= tiny:
                continue
            for i in range(m):  # from the top down, by the middle
                k, j = order[i], i
                middle = line[k, 1] + line[k, 2] * ((x0 + x1) / 2 - line[k, 0])
                while (
                    j > 0
                    and line[order[j - 1], 1] + line[order[j - 1], 2] * ((x0 + x1) / 2 - line[order[j - 1], 0]) > middle
                ):
                    order[j] = order[j - 1]
                    j -= 1
                order[j] = k
            h0, h1, depth = 0.0, 0.0, 0.0
            for i in range(m):
                k = order[i]
                y0[i] = line[k, 1] + line[k, 2] * (x0 - line[k, 0])
                y1[i] = line[k, 1] + line[k, 2] * (x1 - line[k, 0])
                if depth > 0:
                    h0 += y0[i] - y0[i - 1]
                    h1 += y1[i] - y1[i - 1]
                depth += sign[k]
            if inside and h0 <= gap:
                inside = False
                openings += 1
            if max(h0, h1) <= gap or openings == len(found):
                continue
            part0 = (gap - h0) / (h1 - h0) if h0 < gap else 0.0
            part1 = (gap - h0) / (h1 - h0) if h1 < gap else 1.0
            a, b = x0 + part0 * (x1 - x0), x0 + part1 * (x1 - x0)
            one, width = found[openings], b - a
            if not inside:
                inside = True
                one[0], one[2], one[3] = a, np.inf, -np.inf
            one[1] = b
            one[4] = max(one[4], h0, h1)
            depth, top0, top1 = 0.0, 0.0, 0.0
            for i in range(m):
                low0, low1 = y0[i] + part0 * (y1[i] - y0[i]), y0[i] + part1 * (y1[i] - y0[i])
                if depth > 0:
                    one[2], one[3] = min(one[2], top0, top1), max(one[3], low0, low1)
                    g0, g1 = low0 - top0, low1 - top1
                    one[5] += width * (g0 + g1) / 2
                    one[6] += width * (a * (g0 + g1) / 2 + width * (g0 + 2 * g1) / 6)
                    one[7] += width * (low0**2 + low0 * low1 + low1**2 - top0**2 - top0 * top1 - top1**2) / 6
                top0, top1 = low0, low1
                depth += sign[order[i]]
            if h1 <= gap:
                inside = False
                openings += 1
    if inside:
        openings += 1
    return found[:openings]
