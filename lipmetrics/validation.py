"""How good a method is on clips whose truth is known: from profiles to one row per frame, clip and condition.

What counts
-----------
A frame is `open` where an opening is really as high as `CLEAR_MW` of the mouth's width and `CLEAR_PX`, such an opening
is a clear one; `closed` where nothing is open; and `hardly` open between the two. Hardly open frames are in rows of
their own: seen or not, neither is a fault.

- IoU is of all openings of an open frame; where the frame was not seen to be open it is 0: what is missed counts.
- Height, width and area are those of the largest opening, in frames that are open and were seen to be; error is
  measured less true, in px and in % of the mouth's true width (its square, for areas).
- The number of openings is right where it lies between that of the clear ones and that of all that can be seen.
- An onset is a frame that is the first to be open after a closed one. It is on time from the first frame in which
  something can be seen to the first clear one; later it is late, earlier it is early. Of a merge at least two clear
  openings were there the frame before.
- Missed are open frames that were called closed or without a mouth; false are closed ones that were called open.
- Jitter is the change from one frame to the next that is not really there, of the height, in % of the mouth's width: on
  a closed mouth, and on an open one that is still (`STILL_MW`).
- A mouth is found where its middle is within `NEAR_MW` of the true one and its width right within a factor of
  `WIDTH_FACTOR`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd

from lipmetrics.accuracy import overlap, pair_frames
from lipmetrics.look import NO_MOUTH, OPEN
from lipmetrics.profile import Profile

CLEAR_MW, CLEAR_PX = 0.02, 1.0
STILL_MW = 0.003
NEAR_MW, WIDTH_FACTOR = 0.3, 1.5
BEFORE = 6  # frames before something can be seen in which an early onset is looked for
NEAR_MERGE = 8  # frames around a merge in which it is looked for
BAD_IOU = 0.5  # an open frame with less is a bad one, as are those missed, false, or without the mouth
PLAIN = "plain"  # the axis of the clips that are filmed plainly
AGAINST_PLAIN = ("iou_median", "height_percent_median", "bad_percent", "confidence_median")
RESAMPLES, SEED = 200, 5  # of the clips, for intervals

KINDS = ("open", "hardly", "closed")
SIZES = {"height": "height_px", "width": "width_px", "area": "area_px"}


def score_frames(measured: Profile, truth: Profile) -> pd.DataFrame:
    """One row per frame of both: what is there, what was measured, and how far that is off.

    Parameters
    ----------
    measured : with outlines and corners
    truth : with outlines; `meta` may hold `corners_px` (2, 2) and `drift_px` (T, 2), see simulator.suite

    Returns
    -------
    columns frame, time_s, kind (of `KINDS`), status, n, n_visible, n_clear, and of each size in `SIZES` true_* and the
    measured one, px, and of the area of all openings; iou; merge and true_merge; found; confidence; mouth_px, which is
    the true width
    """
    pairs = pair_frames(measured.frames["time_s"].to_numpy(float), truth.frames["time_s"].to_numpy(float))
    a, b = measured.frames.iloc[pairs[:, 0]], truth.frames.iloc[pairs[:, 1]]
    mouth_px = float(truth.meta["mouth_width_px"])
    clear_px = max(CLEAR_MW * mouth_px, CLEAR_PX)
    heights = truth.openings.groupby("frame")["height_px"].apply(lambda h: int((h >= clear_px).sum()))
    clear = heights.reindex(b["frame"], fill_value=0).to_numpy(int)
    visible = b["n_openings"].to_numpy(float, na_value=0).astype(int)
    kind = np.select([clear > 0, visible > 0], ["open", "hardly"], "closed")
    status = a["status"].to_numpy(str)
    seen = status == OPEN
    table = {
        "frame": b["frame"].to_numpy(int),
        "time_s": b["time_s"].to_numpy(float),
        "kind": kind,
        "status": status,
        "n": a["n_openings"].to_numpy(float, na_value=np.nan),
        "n_visible": visible,
        "n_clear": clear,
    }
    for column in SIZES.values():
        table[f"true_{column}"], table[column] = b[column].to_numpy(float), a[column].to_numpy(float)
    iou = np.full(len(pairs), np.nan)
    for row, (i, j) in enumerate(pairs):
        if kind[row] == "open":
            iou[row] = overlap(measured.outlines[i], truth.outlines[j]) if seen[row] else 0.0
    table["iou"] = iou
    for name, of in (("true_total_area_px", b), ("total_area_px", a)):
        table[name] = of["total_area_px"].to_numpy(float)
    table["merge"] = np.isin(table["frame"], _merge_frames(measured, a, b))
    before = np.concatenate([[0], clear[:-1]])
    merged = truth.openings.loc[truth.openings["event"] == "merge", "frame"].unique()
    table["true_merge"] = np.isin(table["frame"], merged) & (before > 1)
    table["found"] = _found(measured, truth, pairs, status, mouth_px)
    table["confidence"] = a["confidence"].to_numpy(float)
    table["mouth_px"] = mouth_px
    return pd.DataFrame(table)


def _merge_frames(measured: Profile, a: pd.DataFrame, b: pd.DataFrame) -> np.ndarray:
    """True frame numbers of the frames in which merges were measured."""
    merged = measured.openings.loc[measured.openings["event"] == "merge", "frame"].unique()
    return b["frame"].to_numpy()[np.isin(a["frame"].to_numpy(), merged)]


def _found(measured: Profile, truth: Profile, pairs, status: np.ndarray, mouth_px: float) -> np.ndarray:
    found = status != NO_MOUTH
    corners = np.asarray(truth.meta.get("corners_px", np.full((2, 2), np.nan)), float)
    if not measured.corners or not np.isfinite(corners).all():
        return found
    drift = np.asarray(truth.meta.get("drift_px") or np.zeros((len(truth.frames), 2)), float)
    for row, (i, j) in enumerate(pairs):
        seen = np.asarray(measured.corners[i], float)
        if found[row] and np.isfinite(seen).all():
            away = np.linalg.norm(seen.mean(axis=0) - corners.mean(axis=0) - drift[j])
            wider = np.linalg.norm(seen[1] - seen[0]) / mouth_px
            found[row] = away <= NEAR_MW * mouth_px and 1 / WIDTH_FACTOR <= wider <= WIDTH_FACTOR
    return found


# -- what follows from the frames -------------------------------------------------------------------------------------


def with_errors(frames: pd.DataFrame) -> pd.DataFrame:
    """The frames with *_off_px and *_off_percent of each size, count_right, missed, false and bad."""
    table = frames.copy()
    is_open, seen = table["kind"] == "open", table["status"] == OPEN
    for name, column in SIZES.items():
        off = (table[column] - table[f"true_{column}"]).where(is_open & seen)
        unit = table["mouth_px"] ** (2 if name == "area" else 1)
        table[f"{name}_off_px"], table[f"{name}_off_percent"] = off, 100 * off / unit
    table["count_right"] = (table["n"] >= table["n_clear"]) & (table["n"] <= table["n_visible"])
    table["count_equal"] = table["n"] == table["n_clear"]
    table["missed"] = is_open & ~seen
    table["false"] = (table["kind"] == "closed") & seen
    table["bad"] = table["missed"] | table["false"] | ~table["found"].astype(bool) | (table["iou"] < BAD_IOU)
    return table


def onsets(frames: pd.DataFrame) -> list[tuple[float, float]]:
    """Of each onset of one clip how late it was seen, in frames; NaN where it was not.

    Returns
    -------
    late, late_strict : from when it may be seen (0 while it is on time); from the first frame in which anything shows
    """
    kind, seen = frames["kind"].to_numpy(str), frames["status"].to_numpy(str) == OPEN
    found = []
    spells = _spells(kind != "closed")
    for number, (start, stop) in enumerate(spells):
        clear = start + np.flatnonzero(kind[start:stop] == "open")
        if start == 0 or len(clear) == 0:
            continue
        first = max(start - BEFORE, spells[number - 1][1] if number else 0)
        at = first + np.flatnonzero(seen[first:stop])
        if len(at) == 0:
            found.append((math.nan, math.nan))
            continue
        late = max(at[0] - clear[0], 0) + min(at[0] - start, 0)
        found.append((float(late), float(at[0] - start)))
    return found


def merges(frames: pd.DataFrame) -> list[float]:
    """Of each merge of one clip how late it was seen, in frames; NaN where it was not."""
    true, seen = (np.flatnonzero(frames[name].to_numpy(bool)) for name in ("true_merge", "merge"))
    late = []
    for at in true:
        near = seen[np.abs(seen - at) <= NEAR_MERGE]
        late.append(float(near[np.argmin(np.abs(near - at))] - at) if len(near) else math.nan)
    return late


def jitter(frames: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Changes of the height that are not really there, in % of the mouth's width: on the closed and the still mouth."""
    kind, mouth = frames["kind"].to_numpy(str), frames["mouth_px"].to_numpy(float)
    height, true = frames["height_px"].to_numpy(float), frames["true_height_px"].to_numpy(float)
    change = 100 * np.abs(np.diff(height - true)) / mouth[1:]
    closed = (kind[1:] == "closed") & (kind[:-1] == "closed")
    is_open = (kind[1:] == "open") & (kind[:-1] == "open") & (height[1:] > 0) & (height[:-1] > 0)
    still = is_open & (np.abs(np.diff(true)) < STILL_MW * mouth[1:])
    known = np.isfinite(change)
    return change[closed & known], change[still & known]


def _spells(flags: np.ndarray) -> list[tuple[int, int]]:
    step = np.diff(flags.astype(int), prepend=0, append=0)
    return list(zip(np.flatnonzero(step == 1).tolist(), np.flatnonzero(step == -1).tolist(), strict=True))


# -- figures of some clips --------------------------------------------------------------------------------------------


def figures(frames: pd.DataFrame) -> dict[str, float]:
    """What is said about some clips; NaN where nothing can be.

    Parameters
    ----------
    frames : rows of `score_frames` with a column `clip`
    """
    table = with_errors(frames)
    is_open, closed, hardly = (table["kind"] == kind for kind in ("open", "closed", "hardly"))
    by_clip = [rows for _, rows in table.groupby("clip", sort=False)]
    late = [one for rows in by_clip for one in onsets(rows)]
    onset, strict = np.array([one[0] for one in late]), np.array([one[1] for one in late])
    merge = np.array([one for rows in by_clip for one in merges(rows)])
    shaking = [jitter(rows) for rows in by_clip]
    found = {
        "clips": len(by_clip),
        "frames": len(table),
        "frames_open": int(is_open.sum()),
        "frames_closed": int(closed.sum()),
        "iou_median": _middle(table["iou"][is_open]),
        "iou_10th": _quantile(table["iou"][is_open], 0.1),
    }
    for name in SIZES:
        for unit in ("px", "percent"):
            off = table[f"{name}_off_{unit}"].dropna()
            found[f"{name}_{unit}_median"] = _middle(off.abs())
            found[f"{name}_{unit}_90th"] = _quantile(off.abs(), 0.9)
            found[f"{name}_{unit}_bias"] = _mean(off)
    found |= {
        "count_right_percent": _percent(table["count_right"]),
        "count_equal_percent": _percent(table["count_equal"][~hardly]),
        "several_right_percent": _percent(table["count_right"][table["n_clear"] > 1]),
        "frames_several": int((table["n_clear"] > 1).sum()),
        "missed_percent": _percent(table["missed"][is_open]),
        "missed_highest_percent": _largest(100 * table["true_height_px"] / table["mouth_px"], table["missed"]),
        "false_percent": _percent(table["false"][closed]),
        "false_highest_percent": _largest(100 * table["height_px"] / table["mouth_px"], table["false"]),
        "hardly_frames": int(hardly.sum()),
        "hardly_seen_percent": _percent((table["status"] == OPEN)[hardly]),
        "onsets": len(onset),
        "onset_frames_median": _middle(np.abs(onset)),
        "onset_frames_90th": _quantile(np.abs(onset), 0.9),
        "onset_frames_bias": _mean(onset),
        "onset_strict_frames_median": _middle(np.abs(strict)),
        "onset_seen_percent": _percent(np.isfinite(onset)),
        "merges": len(merge),
        "merge_frames_median": _middle(np.abs(merge)),
        "merge_seen_percent": _percent(np.isfinite(merge)),
        "jitter_closed_percent": _mean(np.concatenate([np.empty(0), *(one[0] for one in shaking)])),
        "jitter_still_percent": _mean(np.concatenate([np.empty(0), *(one[1] for one in shaking)])),
        "found_percent": _percent(table["found"]),
        "confidence_median": _middle(table["confidence"]),
        "bad_percent": _percent(table["bad"]),
    }
    return found


def intervals(frames: pd.DataFrame, resamples: int = RESAMPLES) -> dict[str, tuple[float, float]]:
    """95 % bootstrap intervals over clips of the median IoU, the median height error (%) and the bad frames (%)."""
    table = with_errors(frames)
    by_clip = [rows for _, rows in table.groupby("clip", sort=False)]
    rng = np.random.default_rng(SEED)
    picks = rng.integers(0, len(by_clip), (resamples, len(by_clip)))

    def interval(values: list[np.ndarray], of: Callable[[np.ndarray], float]) -> tuple[float, float]:
        values = [each[np.isfinite(each)] for each in values]
        drawn = [of(np.concatenate([values[k] for k in pick])) for pick in picks]
        if not np.isfinite(drawn).any():
            return math.nan, math.nan
        return tuple(np.nanpercentile(drawn, [2.5, 97.5]).tolist())

    return {
        "iou_median": interval([rows["iou"].to_numpy(float) for rows in by_clip], _middle),
        "height_percent_median": interval(
            [rows["height_off_percent"].abs().to_numpy(float) for rows in by_clip], _middle
        ),
        "bad_percent": interval([100 * rows["bad"].to_numpy(float) for rows in by_clip], _mean),
    }


def by_condition(frames: pd.DataFrame, clips: pd.DataFrame) -> pd.DataFrame:
    """One row of `figures` per condition, in the order of the clips, with the intervals of `intervals`.

    Columns plain_* are the figures of the same movements filmed plainly, NaN where these are not among the clips.

    Parameters
    ----------
    frames : rows of `score_frames` with a column `clip`
    clips : columns clip, axis, setting, condition, take
    """
    rows = []
    of = dict(zip(clips["clip"], clips["condition"], strict=True))
    grouped = dict(list(frames.groupby(frames["clip"].map(of), sort=False)))
    plain = clips[clips["axis"] == PLAIN].set_index("take")["clip"]
    known: dict[frozenset, dict] = {}
    for (axis, setting, condition), of_condition in clips.groupby(["axis", "setting", "condition"], sort=False):
        if condition not in grouped:
            continue
        row = {"condition": condition, "axis": axis, "setting": setting} | figures(grouped[condition])
        takes = frozenset(of_condition["take"])
        if takes not in known:
            same = takes <= set(plain.index)
            known[takes] = figures(frames[frames["clip"].isin(plain[list(takes)])]) if same else {}
        row |= {f"plain_{name}": known[takes].get(name, math.nan) for name in AGAINST_PLAIN}
        for name, (low, high) in intervals(grouped[condition]).items():
            row |= {f"{name}_low": low, f"{name}_high": high}
        rows.append(row)
    return pd.DataFrame(rows)


def _middle(values: Sequence[float]) -> float:
    return _quantile(values, 0.5)


def _quantile(values: Sequence[float], share: float) -> float:
    values = np.asarray(values, float)
    values = values[np.isfinite(values)]
    return float(np.quantile(values, share)) if len(values) else math.nan


def _mean(values: Sequence[float]) -> float:
    values = np.asarray(values, float)
    values = values[np.isfinite(values)]
    return float(values.mean()) if len(values) else math.nan


def _percent(flags) -> float:
    return 100 * _mean(np.asarray(flags, float))


def _largest(values: pd.Series, where: pd.Series) -> float:
    return float(values[where.astype(bool)].max()) if where.any() else math.nan
