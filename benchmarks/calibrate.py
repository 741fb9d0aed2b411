"""What `confidence` is worth: fit it to simulated clips, and hold it against others and against photographs.

    python benchmarks/calibrate.py                # fit on part `tune`, print what comes of it on both parts
    python benchmarks/calibrate.py --write        # also data/confidence.json, docs/figures/calibration.png, RESULTS.md

The weights are fitted to part `tune` of the suite (`simulator.suite`) and to nothing else: its quick clips and every
seventh of the others. Part `report` is thinned in the same way; it and the reference pictures, where they are there,
only check. Clips are kept in LIPMETRICS_BENCHMARK_CACHE, or made anew in a temporary folder. Fit again whenever the
forests have changed.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

import cv2
import matplotlib
import numpy as np
import pandas as pd
import reference
from results import markdown, write_section
from scipy.optimize import minimize

import lipmetrics
from lipmetrics.accuracy import load_truth
from lipmetrics.atomic import whole_file
from lipmetrics.confidence import FEATURES, Calibration, Evidence, Logistic, features, forests_id, probability, to_text
from lipmetrics.look import NO_MOUTH, OPEN
from lipmetrics.openings import measure_outline
from lipmetrics.pipeline import measure
from lipmetrics.still import look_at
from lipmetrics.validation import PLAIN, score_frames
from simulator.suite import WORST, SuiteClip, condition_name, kept_clips, suite

matplotlib.use("Agg")

DATA = Path(lipmetrics.__file__).parent / "data"
WRITTEN_TO, FORESTS = DATA / "confidence.json", DATA / "lips.npz"
FIGURE = Path(__file__).parents[1] / "docs" / "figures" / "calibration.png"
EVERY = 7  # not a multiple of the six movements that are filmed in each condition, so that all of them come up
RIDGE = 0.001  # times half the sum of squares of weights of standardised features, against the mean log loss
HEIGHT_MW, HEIGHT_PX = 0.02, 1.0  # how far a good height may be off: the larger of the two
LOOSE_MW = 0.05  # the same, for pictures whose outlines people drew
BINS, RESAMPLES, SEED = 10, 200, 3
STEADY_LOSS = 0.02  # falls of the share of good frames below this are none


def is_good(frames: pd.DataFrame, height_mw: float = HEIGHT_MW) -> np.ndarray:
    """Which rows of `score_frames` were measured well, as lipmetrics.confidence defines it."""
    off = (frames["height_px"] - frames["true_height_px"]).abs()
    near = off <= np.maximum(height_mw * frames["mouth_px"], HEIGHT_PX)
    counted = (frames["n"] >= frames["n_clear"]) & (frames["n"] <= frames["n_visible"])
    return (frames["found"].astype(bool) & counted & near).to_numpy()


def thinned(part: str) -> list[SuiteClip]:
    """The clips of a part that are used here."""
    quick = {clip.name for clip in suite(part, quick=True)}
    return [clip for number, clip in enumerate(suite(part)) if number % EVERY == 0 or clip.name in quick]


def clip_rows(clips: Iterable[SuiteClip], folder: Path) -> pd.DataFrame:
    """Rows of `score_frames` with clip, axis, condition, good, and what `Evidence` has, NaN without a mouth."""
    tables = []
    for clip, path in kept_clips(clips, folder):
        looks = []
        measured = measure(path, keep_outlines=True, on_look=lambda _, look, looks=looks: looks.append(look))
        known = pd.DataFrame([evidence_row(look) for look in looks])
        rows = score_frames(measured, load_truth(path.with_suffix("")))
        if len(rows) != len(known):
            raise SystemExit(f"expected every frame of {clip.name} to be scored, got {len(rows)} of {len(known)}")
        facts = {"clip": clip.name, "axis": clip.axis, "condition": clip.condition}
        tables.append(pd.concat([rows, known], axis=1).assign(**facts))
    frames = pd.concat(tables, ignore_index=True)
    return frames.assign(good=is_good(frames))


def evidence_row(look) -> dict[str, float]:
    """What `Evidence` has of a look; NaN where no mouth was found."""
    values = look.evidence if look.status != NO_MOUTH and look.evidence else [np.nan] * len(Evidence._fields)
    return dict(zip(Evidence._fields, values, strict=True))


def evidence_of(frames: pd.DataFrame) -> np.ndarray:
    """(n, 5) in the order of `Evidence`."""
    return frames[list(Evidence._fields)].to_numpy(float)


def former(frames: pd.DataFrame) -> np.ndarray:
    """What stood in the column before it was calibrated: score (0.3 + 0.7 tanh(margin / 2)); 0 without a mouth."""
    return np.nan_to_num(frames["score"] * (0.3 + 0.7 * np.tanh(frames["margin"] / 2))).astype(float)


# -- fitting ----------------------------------------------------------------------------------------------------------


def fit_logistic(seen: np.ndarray, good: np.ndarray, ridge: float = RIDGE) -> Logistic:
    """Weights of at least 0 of features (n, F) that make good (n,) bool likeliest, less a ridge."""
    middle, spread = seen.mean(axis=0), seen.std(axis=0)
    spread = np.where(spread > 1e-9, spread, 1.0)
    standard, good = (seen - middle) / spread, good.astype(float)

    def loss(weights):
        odds = standard @ weights[1:] + weights[0]
        off = 1 / (1 + np.exp(-odds)) - good
        value = (np.logaddexp(0, odds) - good * odds).mean() + ridge * (weights[1:] ** 2).sum() / 2
        slope = np.concatenate([[off.mean()], standard.T @ off / len(good) + ridge * weights[1:]])
        return value, slope

    bounds = [(None, None)] + [(0, None)] * seen.shape[1]
    found = minimize(loss, np.zeros(seen.shape[1] + 1), jac=True, method="L-BFGS-B", bounds=bounds).x
    weights = found[1:] / spread
    rounded = [tuple(float(f"{x:.6g}") for x in values) for values in (weights, seen.max(axis=0))]
    return Logistic(float(f"{found[0] - weights @ middle:.6g}"), *rounded)


def fit(frames: pd.DataFrame) -> Calibration:
    """The calibration that suits these frames; the ones in which no mouth was found say nothing."""
    parts = {}
    for name, status in (("open", True), ("closed", False)):
        of = frames[(frames["status"] != NO_MOUTH) & ((frames["status"] == OPEN) == status)]
        parts[name] = fit_logistic(features(evidence_of(of)), of["good"].to_numpy(bool))
    return Calibration(**parts, forests=forests_id(FORESTS))


# -- what it is worth -------------------------------------------------------------------------------------------------


def area_under_curve(values: np.ndarray, good: np.ndarray) -> float:
    """Chance that a good frame has a larger value than one that is not (Mann and Whitney 1947), ties half."""
    ranks, good = pd.Series(values).rank().to_numpy(), np.asarray(good, bool)
    count = good.sum()
    if count in (0, len(good)):
        return float("nan")
    return float((ranks[good].sum() - count * (count + 1) / 2) / (count * (len(good) - count)))


def groups(values: np.ndarray, bins: int = BINS) -> np.ndarray:
    """Number of the group of each value: as many in each, from the smallest values on."""
    order = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    return order * bins // len(values)


def calibration_error(values: np.ndarray, good: np.ndarray, bins: int = BINS) -> float:
    """Mean distance between mean value and share of good frames over groups of equal size (Naeini et al. 2015)."""
    of = groups(values, bins)
    return float(sum(abs(values[of == k].mean() - good[of == k].mean()) * (of == k).mean() for k in np.unique(of)))


def reliability(values: np.ndarray, good: np.ndarray, clip: np.ndarray, bins: int = BINS) -> pd.DataFrame:
    """Of each group: frames, mean value, share of good frames with its 95 % interval; whole clips are resampled."""
    of, rng = groups(values, bins), np.random.default_rng(SEED)
    number, names = pd.factorize(clip)
    right, all_ = (np.zeros((len(names), bins)) for _ in range(2))
    np.add.at(right, (number, of), good)
    np.add.at(all_, (number, of), 1)
    picks = rng.integers(0, len(names), (RESAMPLES, len(names)))
    with np.errstate(invalid="ignore"):
        drawn = right[picks].sum(axis=1) / all_[picks].sum(axis=1)
    low, high = np.nanpercentile(drawn, [2.5, 97.5], axis=0)
    rows = {
        "frames": all_.sum(axis=0).astype(int),
        "confidence": [values[of == k].mean() for k in range(bins)],
        "good": [good[of == k].mean() for k in range(bins)],
        "low": low,
        "high": high,
    }
    return pd.DataFrame(rows)


def deciles(frames: pd.DataFrame) -> pd.DataFrame:
    """By tenth of confidence: frames, confidence, share that is good, errors."""
    of = groups(frames["now"].to_numpy())
    off = 100 * (frames["height_px"] - frames["true_height_px"]).abs() / frames["mouth_px"]
    table = pd.DataFrame(
        {
            "frames": frames.groupby(of).size(),
            "confidence": frames["now"].groupby(of).mean(),
            "good": frames["good"].groupby(of).mean(),
            "height error %, median": off.groupby(of).median(),
            "90th percentile": off.groupby(of).quantile(0.9),
            "number wrong %": 100
            * (1 - frames["n"].between(frames["n_clear"], frames["n_visible"]).groupby(of).mean()),
        }
    )
    table.index = pd.Index([f"{k + 1}" for k in table.index], name="tenth")
    return table


def by_worst(frames: pd.DataFrame) -> pd.DataFrame:
    """Of the worst settings of each axis, against the same movements filmed plainly: confidence and good frames."""
    take = frames["clip"].str.rpartition(".")[2]  # a setting may hold a point
    rows = {}
    for axis, settings in WORST.items():
        for setting in settings:
            name = condition_name(axis, setting)
            here = frames["condition"] == name
            plain = (frames["condition"] == PLAIN) & take.isin(take[here])
            if not (here.any() and plain.any()):
                continue
            row = {}
            for what, column in (("good", "good"), ("confidence", "now"), ("before", "before")):
                of = frames[column].astype(float)
                row |= {f"{what}, plain": of[plain].mean(), f"{what}, worst": of[here].mean()}
            worse = row["good, worst"] < row["good, plain"] - STEADY_LOSS
            falls = row["confidence, worst"] < row["confidence, plain"]
            row["falls"] = ("yes" if falls else "no") + ("" if worse else ", as little goes wrong" if not falls else "")
            rows[name] = row
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("worst setting")


def with_plain_of_worst(part: str) -> list[SuiteClip]:
    """`thinned`, and of the worst settings and of plain all the movements, so that like is compared with like."""
    worst = {condition_name(axis, setting) for axis, settings in WORST.items() for setting in settings} | {PLAIN}
    chosen = {clip.name for clip in thinned(part)}
    return [clip for clip in suite(part) if clip.name in chosen or clip.condition in worst]


# -- photographs ------------------------------------------------------------------------------------------------------


def photograph_rows() -> pd.DataFrame:
    """The reference pictures with masks by people, each seen by itself; columns as of :func:`clip_rows`."""
    rows = []
    for kind in ("stills_mask", "stills_pts", "hand"):
        for item in reference.items(kind, "all"):
            look, mask, width = look_at(item.picture()), item.mask(), item.mouth_width_px
            found = [measure_outline(each) for each in look.outlines] if look.status == OPEN else []
            clear, visible, true_px = openings_of(mask, width)
            middle = np.hypot(*(look.corners.mean(axis=0) - item.corners.mean(axis=0))) / width
            is_found = look.status != NO_MOUTH and middle <= 0.3 and 1 / 1.5 <= look.lip_width_px / width <= 1.5
            largest = max(found, key=lambda one: one.area_px, default=None)
            row = {
                "clip": item.name,
                "status": look.status,
                "n": np.nan if look.status == NO_MOUTH else len(found),
                "n_clear": clear,
                "n_visible": visible,
                "height_px": np.nan if look.status == NO_MOUTH else largest.height_px if largest else 0.0,
                "true_height_px": true_px,
                "mouth_px": width,
                "found": is_found,
            }
            rows.append(row | evidence_row(look))
    frames = pd.DataFrame(rows)
    return frames.assign(good=is_good(frames), nearly=is_good(frames, LOOSE_MW))


def openings_of(mask: np.ndarray, width_px: float) -> tuple[int, int, float]:
    """Of a mask of openings: how many are clear, how many there are, and the height of the largest, px."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    heights = [int((labels == k).sum(axis=0).max()) for k in range(1, count)]
    if not heights:
        return 0, 0, 0.0
    clear = sum(height >= max(HEIGHT_MW * width_px, HEIGHT_PX) for height in heights)
    return clear, len(heights), float(heights[int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))])


# -- report -----------------------------------------------------------------------------------------------------------


def worth(tables: dict[str, tuple[pd.DataFrame, str]]) -> pd.DataFrame:
    """Name -> frames and the column that says what is good: figures of the confidence now and before."""
    rows = {}
    for name, (frames, column) in tables.items():
        good, row = frames[column].to_numpy(bool), {"frames": len(frames), "good": frames[column].mean()}
        for when in ("now", "before"):
            values = frames[when].to_numpy(float)
            row |= {
                f"mean, {when}": values.mean(),
                f"calibration error, {when}": calibration_error(values, good),
                f"AUC, {when}": area_under_curve(values, good),
            }
        rows[name] = row
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("frames of")


def draw(curves: dict[str, pd.DataFrame], before: pd.DataFrame, path: Path) -> None:
    """Share of good frames against confidence, with intervals; on the right the formula of before."""
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4.4), sharey=True, constrained_layout=True)
    marks = zip("os^D", ("tab:blue", "tab:orange", "tab:green", "tab:red"), strict=True)
    for (name, table), (mark, colour) in zip(curves.items(), marks, strict=False):
        _curve(left, table, mark, colour, name)
    _curve(right, before, "o", "tab:blue", "simulated, part report")
    for axes, title in ((left, "confidence"), (right, "the formula before it was calibrated")):
        axes.plot([0, 1], [0, 1], color="0.7", lw=1)
        axes.set(xlim=(0, 1), ylim=(0, 1.02), xlabel="predicted", title=title)
        axes.legend(loc="lower right", fontsize=8)
    left.set_ylabel("share of frames measured well")
    with whole_file(path) as part:
        figure.savefig(part, dpi=110, format="png", metadata={"Software": None})
    plt.close(figure)


def _curve(axes, table: pd.DataFrame, mark: str, colour: str, name: str) -> None:
    off = np.abs(table[["low", "high"]].to_numpy().T - table["good"].to_numpy())
    axes.errorbar(table["confidence"], table["good"], off, marker=mark, color=colour, capsize=2, lw=1, ms=4, label=name)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="the weights, the figure and the section of RESULTS.md")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as passing:
        folder = Path(os.environ.get("LIPMETRICS_BENCHMARK_CACHE", passing)) / "suite"
        tune, report = clip_rows(thinned("tune"), folder), clip_rows(with_plain_of_worst("report"), folder)
    weights = fit(tune)
    if options.write:
        with whole_file(WRITTEN_TO) as part:
            part.write_text(to_text(weights), encoding="utf-8")
    photographs = photograph_rows() if reference.reference_folder() is not None else None
    sets = [each for each in (tune, report, photographs) if each is not None]
    for frames in sets:
        frames["now"], frames["before"] = probability(evidence_of(frames), weights), former(frames)
    chosen = {clip.name for clip in thinned("report")}
    thin = report[report["clip"].isin(chosen)]  # else the worst settings would count most
    tables = {"simulated, part tune": (tune, "good"), "simulated, part report": (thin, "good")}
    if photographs is not None:
        tables |= {
            "photographs": (photographs, "good"),
            f"photographs, height within {100 * LOOSE_MW:g} %": (photographs, "nearly"),
        }
    curves = {
        name: reliability(
            of["now"].to_numpy(), of[column].to_numpy(float), of["clip"].to_numpy(), 10 if len(of) > 999 else 6
        )
        for name, (of, column) in tables.items()
        if "tune" not in name
    }
    before = reliability(thin["before"].to_numpy(), thin["good"].to_numpy(float), thin["clip"].to_numpy())
    of_weights = pd.DataFrame(
        {name: getattr(weights, name).weights for name in ("open", "closed")},
        index=pd.Index(FEATURES, name="weight of"),
    )
    of_weights.loc["bias"] = [weights.open.bias, weights.closed.bias]
    text = "\n".join(
        [
            "## Calibration of confidence",
            "",
            f"`python benchmarks/calibrate.py --write`: fitted on {tune['clip'].nunique()} clips of part `tune`, "
            f"{len(tune)} frames. Good: mouth found, number of openings right, height within 2 % of its width or 1 px.",
            "",
            markdown(worth(tables), 3),
            "By tenth of confidence, part `report`:",
            "",
            markdown(deciles(thin)),
            "At the worst settings, part `report`, against the same movements filmed plainly, means:",
            "",
            markdown(by_worst(report)),
            markdown(of_weights, 3),
        ]
    )
    print(text)
    if options.write:
        draw(curves, before, FIGURE)
        write_section("calibration", text)


if __name__ == "__main__":
    main()
