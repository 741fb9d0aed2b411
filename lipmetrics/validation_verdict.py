"""What the figures of a validation say: targets met, where a method can be trusted, what its confidence is worth.

The rule for a condition, of its clips: a method is `trusted` where it is within all limits of `TRUSTED`, `not to be
used` where it is beyond any of `REFUSED`, and to be used `with care` between the two. What cannot be told (a mouth that
never opens has no IoU) does not count against it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping

import numpy as np
import pandas as pd

from lipmetrics.validation import PLAIN, figures, with_errors

TRUSTED_NAME, CARE_NAME, REFUSED_NAME = VERDICTS = ("trusted", "with care", "not to be used")
# figure: (at least, at most)
TRUSTED = {
    "iou_median": (0.85, math.inf),
    "height_percent_median": (-math.inf, 1.5),
    "missed_percent": (-math.inf, 5.0),
    "false_percent": (-math.inf, 2.0),
    "count_right_percent": (95.0, math.inf),
    "found_percent": (98.0, math.inf),
}
# what is beyond these is refused
REFUSED = {
    "iou_median": (0.7, math.inf),
    "height_percent_median": (-math.inf, 4.0),
    "missed_percent": (-math.inf, 20.0),
    "false_percent": (-math.inf, 10.0),
    "count_right_percent": (80.0, math.inf),
    "found_percent": (90.0, math.inf),
}
WIDE_PX = 80.0
WORSE_PERCENT = 5.0  # more bad frames than in the plain clips: confidence has to fall
MIX, TONE = "mix", "skin tone"
WIDTHS_PX = (0, 60, 80, 120, 200, 350, math.inf)
HEIGHTS_PERCENT = (2, 4, 7, 12, 20, math.inf)
CONFIDENCES = (0, 0.3, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0001)


def verdict(row: Mapping[str, float]) -> str:
    """One of `VERDICTS` for the figures of a condition."""
    if any(not _within(row[name], limits) for name, limits in REFUSED.items()):
        return REFUSED_NAME
    return TRUSTED_NAME if all(_within(row[name], limits) for name, limits in TRUSTED.items()) else CARE_NAME


def rule() -> list[str]:
    """The rule in words."""

    def words(rule: dict) -> str:
        return ", ".join(
            f"{_WORDS[name]} {'at least' if math.isfinite(low) else 'at most'} {low if math.isfinite(low) else high:g}"
            f"{'' if name == 'iou_median' else ' %'}"
            for name, (low, high) in rule.items()
        )

    return [
        f"trusted: {words(TRUSTED)}",
        f"not to be used where any of these fails: {words(REFUSED)}",
        "with care: between the two",
    ]


_WORDS = {
    "iou_median": "median IoU",
    "height_percent_median": "median height error",
    "missed_percent": "open frames missed",
    "false_percent": "closed frames called open",
    "count_right_percent": "number of openings right",
    "found_percent": "mouths found",
}


def _within(value: float, limits: tuple[float, float]) -> bool:
    return math.isnan(value) or limits[0] <= value <= limits[1]


def targets(frames: pd.DataFrame, clips: pd.DataFrame, conditions: pd.DataFrame, failed: int = 0) -> list[dict]:
    """The goals of a method, each with what was reached: `goal`, `all` and `mix` (texts), and `met`, of all clips.

    Parameters
    ----------
    frames, clips : of all conditions
    conditions : rows of `by_condition` with `verdict`
    failed : clips that the method broke on
    """
    of = dict(zip(clips["clip"], clips["axis"], strict=True))
    axis = frames["clip"].map(of)
    groups = {"all": frames, MIX: frames[axis == MIX]}
    rows: list[dict] = []

    whole = {name: figures(group) for name, group in groups.items() if len(group)}
    wide = {name: group[group["mouth_px"] >= WIDE_PX] for name, group in groups.items()}
    of_wide = {name: figures(group) for name, group in wide.items() if len(group)}

    def row(what: str, goal: str, source: dict, texts, right) -> None:
        shown = {key: texts(source[key]) if key in source else "-" for key in groups}
        met = right(source["all"]) if "all" in source else None
        rows.append({"what": what, "goal": goal, **shown, "met": met})

    row(
        f"mask IoU, mouth {WIDE_PX:g} px wide or more, median",
        ">= 0.95",
        of_wide,
        lambda f: f"{f['iou_median']:.3f}",
        lambda f: f["iou_median"] >= 0.95,
    )
    row(
        f"mask IoU, mouth {WIDE_PX:g} px wide or more, 10th percentile",
        ">= 0.85",
        of_wide,
        lambda f: f"{f['iou_10th']:.3f}",
        lambda f: f["iou_10th"] >= 0.85,
    )
    for size in ("height", "width"):
        px, percent = f"{size}_px_median", f"{size}_percent_median"
        row(
            f"{size} error, median",
            "<= 0.5 px or 1 % of the mouth width",
            whole,
            lambda f, px=px, percent=percent: f"{f[px]:.2f} px, {f[percent]:.2f} %",
            lambda f, px=px, percent=percent: f[px] <= 0.5 or f[percent] <= 1,
        )
    row(
        "number of openings right",
        ">= 98 % of frames",
        whole,
        lambda f: f"{f['count_right_percent']:.1f} %",
        lambda f: f["count_right_percent"] >= 98,
    )
    row(
        "onset time error, median",
        "<= 1 frame",
        whole,
        lambda f: f"{f['onset_frames_median']:.1f} frames; {100 - f['onset_seen_percent']:.1f} % not seen",
        lambda f: f["onset_frames_median"] <= 1,
    )
    row(
        "false openings on closed mouths",
        "<= 0.5 % of frames",
        whole,
        lambda f: f"{f['false_percent']:.2f} %",
        lambda f: f["false_percent"] <= 0.5,
    )
    tones = conditions[conditions["axis"] == TONE].dropna(subset=["iou_median"])
    movements = clips[clips["axis"] == TONE].groupby("setting")["take"].apply(frozenset)
    if len(tones) > 1 and len(set(movements)) == 1:  # else a difference is due to the movement
        low, high = (tones.loc[pick(tones["iou_median"])] for pick in (pd.Series.idxmin, pd.Series.idxmax))
        apart = high["iou_median"] - low["iou_median"]
        shown = f"{apart:.3f} ({low['setting']} {low['iou_median']:.3f}, {high['setting']} {high['iou_median']:.3f})"
        rows.append({"what": "skin tone: median IoU, best less worst", "goal": "<= 0.03", "all": shown, MIX: "-"})
        rows[-1]["met"] = bool(apart <= 0.03)
    rows.append({"what": "clips that the method breaks on", "goal": "0", "all": str(failed), MIX: "-"})
    rows[-1]["met"] = failed == 0
    rows += _silent(conditions)
    return rows


def _silent(conditions: pd.DataFrame) -> list[dict]:
    """Whether confidence falls wherever more goes wrong than with the same movements filmed plainly."""
    varied = conditions[conditions["plain_bad_percent"].notna() & (conditions["axis"] != PLAIN)]
    if not len(varied):
        return []
    worse = varied[varied["bad_percent"] > varied["plain_bad_percent"] + WORSE_PERCENT]
    silent = worse.loc[worse["confidence_median"] >= worse["plain_confidence_median"], "condition"].tolist()
    shown = f"{len(worse) - len(silent)} of {len(worse)}" + (f"; not in {', '.join(silent)}" if silent else "")
    what = f"conditions with over {WORSE_PERCENT:g} % more bad frames than plain, in which confidence falls"
    return [{"what": what, "goal": "all", "all": shown, MIX: "-", "met": not silent if len(worse) else None}]


def by_class(frames: pd.DataFrame, values: pd.Series, edges, name: str) -> pd.DataFrame:
    """Rows of `figures` of the frames whose value lies in each class from one edge to the next."""
    rows = []
    for low, high in itertools.pairwise(edges):
        part = frames[(values >= low) & (values < high)]
        if len(part):
            title = f"{low:g} to {high:g}" if math.isfinite(high) else f"{low:g} or more"
            rows.append({name: title} | figures(part))
    return pd.DataFrame(rows)


def calibration(frames: pd.DataFrame) -> pd.DataFrame:
    """What confidence is worth: frames by confidence, with the share that is bad and the errors of the rest."""
    table = with_errors(frames)
    rows = []
    for low, high in itertools.pairwise(CONFIDENCES):
        part = table[(table["confidence"] >= low) & (table["confidence"] < high)]
        if len(part):
            rows.append(
                {
                    "confidence": f"{low:g} to {min(high, 1):g}",
                    "middle": float(part["confidence"].median()),
                    "frames": len(part),
                    "bad_percent": 100 * float(part["bad"].mean()),
                    "iou_median": float(np.nanmedian(part["iou"])) if part["iou"].notna().any() else math.nan,
                    "height_percent_median": float(part["height_off_percent"].abs().median()),
                }
            )
    return pd.DataFrame(rows)


def disagreement_mw2(frames: pd.DataFrame) -> np.ndarray:
    """Area that is measured or true but not both, over the square of the mouth's width, of each frame."""
    true, seen = (np.nan_to_num(frames[name].to_numpy(float)) for name in ("true_total_area_px", "total_area_px"))
    iou = np.nan_to_num(frames["iou"].to_numpy(float))
    apart = (true + seen) * (1 - iou) / (1 + iou)
    return np.where(frames["kind"] == "hardly", 0.0, apart) / frames["mouth_px"].to_numpy(float) ** 2


def worst_frames(frames: pd.DataFrame, clips: pd.DataFrame, count: int = 20) -> pd.DataFrame:
    """The frames of the largest `disagreement_mw2`: at most one of a clip, two of a condition, three of a movement."""
    table = frames.assign(apart=disagreement_mw2(frames)).merge(clips, on="clip")
    table = table.sort_values("apart", ascending=False, kind="stable").drop_duplicates("clip")
    table = table[table.groupby("condition").cumcount() < 2]
    table = table[table.groupby("take").cumcount() < 3]
    return table[table["apart"] > 0].head(count)
