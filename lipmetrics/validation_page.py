"""The report of `lipmetrics validate`: tables, figures and the worst frames, in one page that needs no network.

In the pictures green is the truth and red what was measured.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from lipmetrics import draw
from lipmetrics.accuracy import load_truth
from lipmetrics.atomic import whole_file
from lipmetrics.frames import open_frames
from lipmetrics.html_page import bullets, folded, number, picture, span, table, write_page
from lipmetrics.pipeline import measure
from lipmetrics.profile import Profile
from lipmetrics.validation import CLEAR_MW, CLEAR_PX, with_errors
from lipmetrics.validation_verdict import (
    CARE_NAME,
    HEIGHTS_PERCENT,
    REFUSED_NAME,
    TRUSTED_NAME,
    WIDTHS_PX,
    by_class,
    rule,
)

TRUE_RGB, MEASURED_RGB = (0, 230, 118), (255, 23, 68)
COLOURS = {TRUSTED_NAME: "#0072b2", CARE_NAME: "#e69f00", REFUSED_NAME: "#d5143c"}
COLUMNS, TILE_PX, CAPTION_PX = 4, (300, 240), 44
AROUND_MW = 1.7  # width of what a tile shows, mouth widths

SHORT = {
    "iou_median": "IoU",
    "iou_10th": "10th pct",
    "height_percent_median": "height %",
    "height_percent_bias": "bias %",
    "width_percent_median": "width %",
    "area_percent_median": "area %",
    "count_right_percent": "number %",
    "missed_percent": "missed %",
    "false_percent": "false %",
    "onset_frames_median": "onset",
    "jitter_still_percent": "jitter %",
    "found_percent": "found %",
    "confidence_median": "conf.",
}
_OF_GOALS = """All clips are those of every condition, the extreme ones too. In the mix all conditions vary at once.
Real pictures are measured by benchmarks/accuracy.py, these clips with other tools by benchmarks/validate_others.py."""
_OF_COLUMNS = """Median and 10th percentile of the IoU; median errors of height, width and area, in % of the mouth width
(its square), where the mouth is open and was seen to be; bias: mean of measured less true height. Number of openings
right, open frames missed, closed ones called open, mouths found: % of frames. Onset: frames, median."""
_MORE = {
    "plain_iou_median": "IoU, same movements plain",
    "plain_height_percent_median": "height %, same plain",
    "clips": "clips",
    "frames": "frames",
    "height_px_median": "height px",
    "height_px_90th": "height px, 90th pct",
    "height_percent_90th": "height %, 90th pct",
    "width_px_median": "width px",
    "width_percent_90th": "width %, 90th pct",
    "width_percent_bias": "width bias %",
    "area_px_median": "area px²",
    "count_equal_percent": "number equal %",
    "frames_several": "frames with several",
    "several_right_percent": "of these right %",
    "missed_highest_percent": "highest missed %",
    "false_highest_percent": "highest false %",
    "hardly_frames": "hardly open frames",
    "hardly_seen_percent": "of these seen %",
    "onset_frames_90th": "onset, 90th pct",
    "onset_strict_frames_median": "onset from the first sliver",
    "onset_seen_percent": "onsets seen %",
    "merges": "merges",
    "merge_seen_percent": "merges seen %",
    "merge_frames_median": "merge, frames",
    "jitter_closed_percent": "jitter closed %",
    "bad_percent": "bad frames %",
}


def write_report(
    folder: Path,
    summary: Mapping,
    frames: pd.DataFrame,
    clips: pd.DataFrame,
    conditions: pd.DataFrame,
    worst: pd.DataFrame,
    stems: Mapping[str, Path],
) -> None:
    """Write report.html, worst.png and height_error.png into a folder.

    Parameters
    ----------
    summary : as `lipmetrics.validate` makes it
    frames, clips, conditions : the tables of the same names
    worst : rows of `validation_verdict.worst_frames`
    stems : clip -> path of its video and truth without ending
    """
    figure = error_figure(frames, clips, conditions)
    sheet = worst_sheet(worst, stems, summary["method"])
    for name, png in (("height_error.png", figure), ("worst.png", sheet)):
        with whole_file(folder / name) as part:
            part.write_bytes(png)
    facts = summary["facts"]
    what = [f"{name}: {value}" for name, value in facts.items()]
    what += [f"method {summary['method']}, {summary['clips']} clips, {summary['frames']} frames"]
    for name, verb in (("failed", "broke the method"), ("dropped", "could not be solved and are left out")):
        if summary[name]:
            shown = "; ".join(f"{clip} ({reason})" for clip, reason in list(summary[name].items())[:10])
            what.append(f"{len(summary[name])} clips {verb}: {shown}")
    body = [
        "<h1>The detector against the simulator</h1>",
        bullets(what),
        "<h2>Goals</h2>",
        table(target_rows(summary["targets"]), ("", "goal", "all clips", "mix", "")),
        f"<p>{_OF_GOALS}</p>",
        "<h2>Where it can be trusted</h2>",
        bullets(rule()),
        table(*condition_rows(conditions, SHORT)),
        f"<p>{_OF_COLUMNS}</p>",
        "<h2>Height error by condition</h2>",
        picture(figure, "height error by condition"),
        "<p>Median (dot), 10th to 90th percentile (line) of measured less true height.</p>",
        "<h2>By size</h2>",
        table(*_class_rows(by_class(frames, frames["mouth_px"], WIDTHS_PX, "mouth width, px"))),
        table(
            *_class_rows(
                by_class(
                    frames,
                    100 * frames["true_height_px"] / frames["mouth_px"],
                    HEIGHTS_PERCENT,
                    "true height, % of the mouth's width",
                )
            )
        ),
        "<h2>What its confidence is worth</h2>",
        table(*_confidence_rows(summary["confidence"])),
        "<p>A frame is bad where an opening was missed or invented, the IoU is under 0.5 or no mouth was found.</p>",
        "<h2>The worst frames</h2>",
        "<p>Those with the largest area that is measured or true but not both: at most one of a clip, two of a "
        "condition and three of a movement. Green is the truth, red what was measured.</p>",
        picture(sheet, "the worst frames"),
        "<h2>All figures</h2>",
        folded("of every condition", table(*condition_rows(conditions, _MORE))),
        folded("95 % intervals over clips", table(*_interval_rows(conditions))),
        _definitions(),
    ]
    write_page(folder / "report.html", "The detector against the simulator", "\n".join(body))


def target_rows(targets: list[Mapping]) -> list[list[str]]:
    """Rows of what, goal, all clips, mix, met or not."""
    said = {True: "met", False: "not met", None: "-"}
    return [[row["what"], row["goal"], row["all"], row["mix"], said[row["met"]]] for row in targets]


def condition_rows(conditions: pd.DataFrame, columns: Mapping[str, str]) -> tuple[list[list[str]], list[str]]:
    """Rows and head of a table of conditions with some figures."""
    rows = [
        [row["condition"], row["verdict"], *(number(float(row[name])) for name in columns)]
        for _, row in conditions.iterrows()
    ]
    return rows, ["condition", "", *columns.values()]


def _class_rows(classes: pd.DataFrame) -> tuple[list[list[str]], list[str]]:
    shown = {name: title for name, title in SHORT.items() if not name.startswith(("onset", "jitter", "false"))}
    shown = {"frames": "frames"} | shown
    rows = [[row.iloc[0], *(number(float(row[name])) for name in shown)] for _, row in classes.iterrows()]
    return rows, [classes.columns[0] if len(classes) else "", *shown.values()]


def _confidence_rows(rows: list[Mapping]) -> tuple[list[list[str]], list[str]]:
    names = ("frames", "bad_percent", "iou_median", "height_percent_median")
    head = ["confidence", "frames", "bad frames %", "IoU", "height error %"]
    return [[row["confidence"], *(number(float(row[name])) for name in names)] for row in rows], head


def _interval_rows(conditions: pd.DataFrame) -> tuple[list[list[str]], list[str]]:
    names = {"iou_median": "IoU", "height_percent_median": "height error %", "bad_percent": "bad frames %"}
    rows = [
        [row["condition"], *(span(row[f"{name}_low"], row[f"{name}_high"]) for name in names)]
        for _, row in conditions.iterrows()
    ]
    return rows, ["condition", *names.values()]


def _definitions() -> str:
    clear = f"{100 * CLEAR_MW:g} % of the mouth's width and {CLEAR_PX:g} px"
    return "<h2>What counts</h2>" + bullets(
        [
            f"a frame is open where an opening is really {clear} high; lower ones make it hardly open, which is no "
            "fault either way and is told in columns of its own",
            "IoU is of all openings of an open frame, and 0 where it was not seen to be open",
            "the number of openings is right between that of the clear ones and that of all that can be seen",
            "an onset is on time from the first frame in which anything shows to the first in which it is clear",
            "false openings are on mouths that are closed, missed ones on mouths that are open",
            "jitter is the change of height from frame to frame that is not really there, on a still open mouth",
        ]
    )


# -- pictures ---------------------------------------------------------------------------------------------------------


def error_figure(frames: pd.DataFrame, clips: pd.DataFrame, conditions: pd.DataFrame) -> bytes:
    """PNG: median, 10th and 90th percentile of the height error, and of the IoU, of each condition."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    errors = with_errors(frames)
    of = dict(zip(clips["clip"], clips["condition"], strict=True))
    grouped = dict(list(errors.groupby(errors["clip"].map(of), sort=False)))
    names = [name for name in conditions["condition"] if grouped[name]["height_off_percent"].notna().any()]
    verdicts = dict(zip(conditions["condition"], conditions["verdict"], strict=True))
    half = math.ceil(len(names) / 2)
    figure = Figure(figsize=(12, max(2.5, 0.19 * half + 1.2)), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 2, squeeze=False)[0]
    limit = 1.0
    for panel, part in zip(panels, (names[:half], names[half:]), strict=True):
        for row, name in enumerate(part):
            off = grouped[name]["height_off_percent"].dropna()
            low, middle, high = np.quantile(off, [0.1, 0.5, 0.9])
            limit = max(limit, abs(low), abs(high))
            colour = COLOURS[verdicts[name]]
            panel.plot([low, high], [row, row], color=colour, linewidth=1.6, solid_capstyle="butt")
            panel.plot(middle, row, "o", color=colour, markersize=4)
        panel.axvline(0, color="#999999", linewidth=0.8)
        panel.axvspan(-1, 1, color="#000000", alpha=0.06, linewidth=0)
        panel.set_yticks(range(len(part)), part, fontsize=7)
        panel.set_ylim(len(part) - 0.4, -0.6)
        panel.set_xlabel("measured less true height, % of the mouth's width")
        panel.spines[["top", "right"]].set_visible(False)
        panel.tick_params(axis="y", length=0)
    for panel in panels:
        panel.set_xlim(-min(1.05 * limit, 25), min(1.05 * limit, 25))
    handles = [panels[0].plot([], [], "o-", color=colour, label=name)[0] for name, colour in COLOURS.items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=3, frameon=False, fontsize=8)
    return _png(figure)


def worst_sheet(worst: pd.DataFrame, stems: Mapping[str, Path], method: str) -> bytes:
    """PNG: the frames of some rows with `clip`, `frame`, `condition` and figures, the truth in green."""
    tiles = []
    for _, row in worst.iterrows():
        stem = stems[row["clip"]]
        video, truth = Path(f"{stem}.mp4"), load_truth(stem)
        measured = measure(video, method=method, keep_outlines=True)
        with open_frames(video) as source:
            rgb = next((one.rgb() for one in source if one.index == row["frame"]), None)
        if rgb is not None:
            tiles.append(_tile(rgb, row, measured, truth))
    blank = np.full((TILE_PX[1] + CAPTION_PX, TILE_PX[0], 3), 24, np.uint8)
    tiles = tiles or [blank]
    tiles += [blank] * (-len(tiles) % min(COLUMNS, len(tiles)))
    columns = min(COLUMNS, len(tiles))
    rows = [np.hstack(tiles[k : k + columns]) for k in range(0, len(tiles), columns)]
    return cv2.imencode(".png", np.vstack(rows)[:, :, ::-1])[1].tobytes()


def _tile(rgb: np.ndarray, row: pd.Series, measured: Profile, truth: Profile) -> np.ndarray:
    """The mouth of a frame with both outlines, on a strip that says what it is."""
    at = int(np.flatnonzero(truth.frames["frame"].to_numpy() == row["frame"])[0])
    drift = np.asarray(truth.meta.get("drift_px") or np.zeros((len(truth.frames), 2)), float)
    middle = np.asarray(truth.meta["corners_px"], float).mean(axis=0) + drift[at]
    mouth = float(truth.meta["mouth_width_px"])
    size = AROUND_MW * mouth * np.array([TILE_PX[1] / TILE_PX[0], 1.0])
    scale = TILE_PX[0] / size[1]
    row0, col0 = middle - size / 2 + [0.1 * mouth, 0.0]
    to_tile = np.array([[scale, 0, -col0 * scale], [0, scale, -row0 * scale]])
    tile = cv2.warpAffine(rgb, to_tile, TILE_PX, flags=cv2.INTER_LINEAR if scale > 1 else cv2.INTER_AREA)
    view = draw.View(scale, row0, col0)
    here = int(np.argmin(np.abs(measured.frames["time_s"].to_numpy(float) - row["time_s"])))
    for outlines, colour in ((truth.outlines[at], TRUE_RGB), (measured.outlines[here], MEASURED_RGB)):
        for outline in outlines:
            draw.draw_outline(tile, outline, colour, view)
    strip = np.full((CAPTION_PX, TILE_PX[0], 3), 24, np.uint8)
    iou = f"IoU {row['iou']:.2f}" if math.isfinite(row["iou"]) else row["kind"]
    seen = str(row["status"]).replace("_", " ")
    draw.draw_text(strip, f"{row['condition']}", 17, 6, 10)
    text = f"{row['take']}, {row['time_s']:.2f} s: {seen}, {iou}, conf {row['confidence']:.2f}"
    draw.draw_text(strip, text, 36, 6, 7 if draw.text_size(text, 8) > TILE_PX[0] - 8 else 8, draw.QUIET_COLOUR)
    return np.vstack([tile, strip])


def _png(figure) -> bytes:
    file = io.BytesIO()
    figure.savefig(file, format="png", metadata={"Software": None})
    return file.getvalue()
