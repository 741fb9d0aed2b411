"""Scores of a method: what each figure of RESULTS.md means. Nothing is loaded here.

Scores of one picture, against a human's mask:

- IoU, intersection over union of the masks; 0 when the method calls an open mouth closed or finds none;
- height error, |height - true height| in % of the mouth width. The true height is the number of mask pixels in the
  fullest column, the method's is the length inside its outlines along the fullest column, so that it is sub-pixel;
- false: a closed mouth called open; missed: an open mouth called closed or not found.

Scores of one clip, against the landmark tools' profile, in the frames where the two tools agree:

- correlation (Pearson) of the heights in px;
- agreement: frames where both say open or both say closed, height over or under 4 % of the mouth width, each side by
  its own height and width. A frame without a mouth disagrees;
- jitter, the mean |h(t-1) - 2 h(t) + h(t+1)| in % of the mouth width inside parts where the mouth is closed or still.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd
import reference
from reference import Item

from lipmetrics.look import NO_MOUTH, OPEN, Look
from lipmetrics.profile import resting_mouth_width

HEIGHT_CLASSES_PX = (0, 4, 8, 15, 30, np.inf)
OPEN_MW = 0.04  # a video frame is open when its height is more than this many mouth widths
CLOSED_MW, STILL_MW, SHORTEST_RUN = 0.02, 0.03, 5  # the parts of a clip in which jitter is measured
NO_SIGNAL_MW = 0.04  # a clip whose height moves less has no correlation


# --- pictures


@dataclass(frozen=True)
class Scored:
    """A picture, what the method said and how far it is off."""

    item: Item
    look: Look
    row: dict


def score(item: Item, look: Look) -> Scored:
    """Compare one look with the human's mask of the same picture."""
    truth = item.mask()
    outlines = look.outlines if look.status == OPEN else []
    found = reference.fill(outlines, truth.shape)
    width, corners = item.mouth_width_px, item.corners
    off_centre = np.hypot(*(look.corners.mean(axis=0) - corners.mean(axis=0))) / width
    row = {
        "item": item.name,
        "person": reference.person(item.identity),
        "kind": item.kind,
        "truth_open": bool(truth.any()),
        "status": look.status,
        "open": bool(outlines),
        "iou": reference.iou(truth, found),
        "true_height_px": int(truth.sum(axis=0).max()),
        "height_px": reference.height_px(outlines),
        "mouth_width_px": width,
        "lip_width_px": look.lip_width_px,
        "off_centre_mw": off_centre,
        "located": look.status != NO_MOUTH and off_centre <= 0.3 and 1 / 1.5 <= look.lip_width_px / width <= 1.5,
        "confidence": look.confidence,
    }
    row["height_error_pct"] = 100 * abs(row["height_px"] - row["true_height_px"]) / width
    return Scored(item, look, row)


def table(scored: Iterable[Scored]) -> pd.DataFrame:
    """One row per picture."""
    return pd.DataFrame([one.row for one in scored])


def summary(rows: pd.DataFrame) -> dict[str, float]:
    """The figures of a set of pictures."""
    is_open = rows[rows["truth_open"]]
    is_closed = rows[~rows["truth_open"]]
    return {
        "open": len(is_open),
        "closed": len(is_closed),
        "iou_median": is_open["iou"].median(),
        "iou_p10": is_open["iou"].quantile(0.1),
        "height_error_pct": is_open["height_error_pct"].mean(),
        "height_error_median_px": (is_open["height_px"] - is_open["true_height_px"]).abs().median(),
        "height_bias_pct": (
            100 * (is_open["height_px"] - is_open["true_height_px"]) / is_open["mouth_width_px"]
        ).mean(),
        "false_open": int(is_closed["open"].sum()),
        "missed": int((~is_open["open"]).sum()),
        "no_mouth": int((rows["status"] == NO_MOUTH).sum()),
        "located_pct": 100 * rows["located"].mean(),
    }


def by_height(rows: pd.DataFrame) -> pd.DataFrame:
    """Figures of the open pictures by their true height."""
    is_open = rows[rows["truth_open"]]
    classes = pd.cut(is_open["true_height_px"], HEIGHT_CLASSES_PX, right=False)
    return _grouped(is_open, classes)


def by_confidence(rows: pd.DataFrame) -> pd.DataFrame:
    """Figures by third of the method's own confidence; empty when it gives none."""
    known = rows[rows["confidence"].notna()]
    if known["confidence"].nunique() < 3:
        return pd.DataFrame()
    thirds = pd.qcut(known["confidence"].rank(method="first"), 3, labels=["lowest third", "middle", "highest third"])
    wrong = (known["open"] != known["truth_open"]).groupby(thirds, observed=True).sum().rename("wrong open/closed")
    return _grouped(known[known["truth_open"]], thirds).join(wrong)


def _grouped(rows: pd.DataFrame, groups: pd.Series) -> pd.DataFrame:
    grouped = rows.groupby(groups.loc[rows.index], observed=True)
    return pd.DataFrame(
        {
            "n": grouped.size(),
            "IoU median": grouped["iou"].median(),
            "IoU p10": grouped["iou"].quantile(0.1),
            "height error %": grouped["height_error_pct"].mean(),
            "missed": grouped["open"].apply(lambda group: int((~group).sum())),
        }
    )


# --- clips


def clip_scores(frames: pd.DataFrame) -> pd.DataFrame:
    """Figures of each clip, one row per clip, from the rows of ``evaluate_videos``."""
    return pd.DataFrame({clip: _score_clip(rows) for clip, rows in frames.groupby("clip", sort=False)}).T


def _score_clip(rows: pd.DataFrame) -> dict[str, float]:
    resting, _ = resting_mouth_width(rows["status"].tolist(), *rows[["height_px", "lip_width_px"]].to_numpy(float).T)
    ours = rows["height_px"].to_numpy(float) / resting
    theirs = (rows["open_h_px"] / rows["mouth_w_px"]).where(rows["mp_ok"] == 1).to_numpy(float)
    trusted = ((rows["agree"] == 1) & (rows["mp_ok"] == 1)).to_numpy()
    compared = trusted & np.isfinite(ours)
    same = ((ours > OPEN_MW) == (theirs > OPEN_MW)) & np.isfinite(ours)
    closed, still = (frames & np.isfinite(ours) for frames in (closed_frames(theirs), still_frames(theirs)))
    return {
        "frames": len(rows),
        "trusted": int(trusted.sum()),
        "found_pct": 100 * np.isfinite(ours).mean(),
        "correlation": correlation(
            rows["height_px"].to_numpy(float)[compared], rows["open_h_px"].to_numpy(float)[compared]
        )
        if np.ptp(np.percentile(theirs[trusted], [5, 95])) >= NO_SIGNAL_MW
        else np.nan,
        "same": int(same[trusted].sum()),
        "agreement_pct": 100 * same[trusted].mean(),
        "called_open_pct": 100 * np.mean(ours[trusted] > OPEN_MW),
        "tools_open_pct": 100 * np.mean(theirs[trusted] > OPEN_MW),
        "width_ratio": resting / rows["mouth_w_px"].median(),
        **{f"jitter_closed_{who}": jitter(height, closed) for who, height in (("ours", ours), ("tools", theirs))},
        **{f"jitter_still_{who}": jitter(height, still) for who, height in (("ours", ours), ("tools", theirs))},
        "bends_closed": len(bends(ours, closed)),
        "bends_still": len(bends(ours, still)),
    }


def correlation(one: np.ndarray, other: np.ndarray) -> float:
    """Pearson correlation; 0 when a side never moves or there is nothing to compare."""
    if len(one) < 3 or np.ptp(one) == 0 or np.ptp(other) == 0:
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])


def closed_frames(height_mw: np.ndarray) -> np.ndarray:
    """Frames in runs of at least SHORTEST_RUN in which the height stays under CLOSED_MW mouth widths, bool."""
    low = height_mw < CLOSED_MW
    return _covered(np.convolve(low, np.ones(SHORTEST_RUN), "valid") == SHORTEST_RUN, len(low))


def still_frames(height_mw: np.ndarray) -> np.ndarray:
    """Frames of an open mouth in windows of SHORTEST_RUN in which the height changes by less than STILL_MW, bool."""
    if len(height_mw) < SHORTEST_RUN:
        return np.zeros(len(height_mw), bool)
    windows = np.lib.stride_tricks.sliding_window_view(height_mw, SHORTEST_RUN)
    return _covered((np.ptp(windows, axis=1) < STILL_MW) & (windows.min(axis=1) >= CLOSED_MW), len(height_mw))


def _covered(starts: np.ndarray, length: int) -> np.ndarray:
    """Frames that lie in a window beginning at a marked frame."""
    frames = np.zeros(length, bool)
    for shift in range(SHORTEST_RUN):
        frames[shift : shift + len(starts)] |= starts
    return frames


def bends(height_mw: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Absolute second differences in % of the mouth width where three neighbours lie in ``frames`` and are known."""
    inside = frames[:-2] & frames[1:-1] & frames[2:]
    bend = 100 * np.abs(height_mw[:-2] - 2 * height_mw[1:-1] + height_mw[2:])[inside]
    return bend[np.isfinite(bend)]


def jitter(height_mw: np.ndarray, frames: np.ndarray) -> float:
    """Mean of ``bends``, NaN when there is no such frame."""
    found = bends(height_mw, frames)
    return float(found.mean()) if len(found) else np.nan


def video_summary(clips: pd.DataFrame) -> dict[str, float]:
    """The figures of all clips from ``clip_scores``; jitter is the mean over frames, not over clips."""

    def pooled(jitter: str, weight: str) -> float:
        return float((clips[jitter] * clips[weight]).sum() / clips[weight].sum()) if clips[weight].sum() else np.nan

    return {
        "clips": len(clips),
        "found_pct": float((clips["found_pct"] * clips["frames"]).sum() / clips["frames"].sum()),
        "correlation_median": clips["correlation"].median(),
        "correlation_p10": clips["correlation"].quantile(0.1),
        "agreement_pct": 100 * clips["same"].sum() / clips["trusted"].sum(),
        "agreement_median_pct": clips["agreement_pct"].median(),
        "jitter_closed_pct": pooled("jitter_closed_ours", "bends_closed"),
        "jitter_closed_tools_pct": pooled("jitter_closed_tools", "bends_closed"),
        "jitter_still_pct": pooled("jitter_still_ours", "bends_still"),
        "jitter_still_tools_pct": pooled("jitter_still_tools", "bends_still"),
    }
