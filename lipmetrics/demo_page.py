"""The report of `lipmetrics demo`: a page that holds its pictures and its video itself, a figure and a contact sheet.

In all of them green is the truth and red what was measured.
"""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from textwrap import wrap

import cv2
import numpy as np

from lipmetrics import draw
from lipmetrics.accuracy import SIZES, describe, pair_frames
from lipmetrics.atomic import whole_file
from lipmetrics.frames import open_frames
from lipmetrics.look import OPEN
from lipmetrics.profile import Profile

TRUE_RGB, MEASURED_RGB = (0, 230, 118), (255, 23, 68)
TRUE_COLOUR, MEASURED_COLOUR = "#00b35c", "#d5143c"
COLUMNS = 3
TILE_WIDTH_PX = 320
MARGIN_MW = 0.3  # around the mouth, in mouth widths
TEXT_PX, LINE_PX, GAP_PX, CAPTION_LINES = 10, 18, 8, 3


@dataclass(frozen=True)
class Simulated:
    """A clip and its truth, made by a simulator.

    Parameters
    ----------
    stem : its files are `<stem>.mp4`, the picture, and `<stem>.frames.csv` and so on, the truth
    files : all of them
    about : what it shows, a sentence
    facts : name -> what the report says about how it was made
    seconds : work -> time that took, s
    """

    stem: str
    files: tuple[Path, ...]
    about: str = ""
    facts: dict[str, str] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)


# -- pictures ---------------------------------------------------------------------------------------------------------


def write_plot(measured: Profile, truth: Profile, path: Path) -> None:
    """Width, height and area of the largest opening and the number of openings over time, measured over true, PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 8), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(4, 1, sharex=True, height_ratios=(3, 3, 3, 1.6))
    mouth_px = truth.meta["mouth_width_px"]
    for profile, style in (
        (truth, {"color": TRUE_COLOUR, "linewidth": 4, "alpha": 0.6, "label": "truth"}),
        (measured, {"color": MEASURED_COLOUR, "linewidth": 1.4, "marker": ".", "markersize": 4, "label": "measured"}),
    ):
        time_s = profile.frames["time_s"].to_numpy(float)
        for panel, (name, column) in zip(panels, SIZES.items(), strict=False):
            unit = mouth_px ** (2 if name == "area" else 1)
            panel.plot(time_s, 100 * profile.frames[column].to_numpy(float) / unit, **style)
            panel.set_ylabel(f"{name} (% of mouth\nwidth{'²' if name == 'area' else ''})")
        panels[-1].step(time_s, profile.frames["n_openings"].to_numpy(float, na_value=np.nan), where="mid", **style)
    panels[-1].set(ylabel="openings", xlabel="time (s)")
    panels[-1].yaxis.get_major_locator().set_params(integer=True)
    for panel in panels:
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(axis="y", alpha=0.2)
    panels[0].legend(frameon=False, loc="upper right")
    with whole_file(path) as part:
        figure.savefig(part, format="png", metadata={"Software": None})


def write_moments(clip: Path, measured: Profile, truth: Profile, path: Path) -> None:
    """Frames at `key_moments`, cut out around the mouth, the measured outlines over the true ones, as PNG."""
    moments = key_moments(measured, truth)
    found = draw.found_by_frame(measured)
    partner = partners(measured, truth)
    tiles, wanted = [], {int(measured.frames["frame"].iloc[i]): i for i in moments}
    with open_frames(clip) as frames:
        for frame in frames:
            at = wanted.get(frame.index)
            if at is None:
                continue
            window = mouth_window(truth, frame.height, frame.width)
            tiles.append(_tile(frame, window, found[frame.index].outlines, truth, partner[at], moments[at]))
    with whole_file(path) as part:
        part.write_bytes(cv2.imencode(".png", _arrange(tiles)[:, :, ::-1])[1].tobytes())


def partners(measured: Profile, truth: Profile) -> dict[int, int]:
    """Position of a measured frame -> that of the true frame of the same moment."""
    pairs = pair_frames(measured.frames["time_s"].to_numpy(float), truth.frames["time_s"].to_numpy(float))
    return {int(i): int(j) for i, j in pairs}


def key_moments(measured: Profile, truth: Profile) -> dict[int, str]:
    """Position of a measured frame -> why it is worth a look, in order of time."""
    partner = partners(measured, truth)
    if not partner:
        return {}
    at, true_at = np.array(list(partner)), np.array(list(partner.values()))
    a, b = measured.frames.iloc[at], truth.frames.iloc[true_at]
    seen, really = (table["status"].to_numpy() == OPEN for table in (a, b))
    height, count = b["height_px"].to_numpy(float), b["n_openings"].to_numpy(float)
    off = np.where(seen & really, np.abs(a["height_px"].to_numpy(float) - height), -1.0)
    wide = np.where(seen & really, np.abs(a["width_px"].to_numpy(float) - b["width_px"].to_numpy(float)), -1.0)
    several, is_open = np.flatnonzero(count > 1), np.flatnonzero(really)
    picks = [(0, "at rest")]
    if len(is_open):
        first, last, highest = is_open[0], is_open[-1], int(height.argmax())
        picks += [(first, "opens")]
        if len(several):
            behind = min(several[-1] + 1, len(count) - 1)
            picks += [(several[0], "a second opening"), (several[len(several) // 2], "several openings")]
            picks += [(several[-1], "before they merge"), (behind, "merged")]
        picks += [(highest, "highest"), ((highest + last) // 2, "closing"), (last, "last seen open")]
        if seen.any():
            picks += [(int(np.flatnonzero(seen)[0]), "first measured open")]
            errors = {"height": off, "width": wide}
            picks += [(int(e.argmax()), f"largest error in {name}") for name, e in errors.items() if e.max() > 0]
    reasons: dict[int, str] = {}
    for pick, reason in picks:
        there = int(at[pick])
        reasons[there] = f"{reasons[there]}, {reason}" if there in reasons else reason
    return dict(sorted(reasons.items()))


def mouth_window(truth: Profile, height: int, width: int) -> tuple[int, int, int, int]:
    """Rows and columns (row0, row1, col0, col1), half-open, around all that the mouth does in a clip."""
    points = np.concatenate([np.empty((0, 2)), *(outline for frame in truth.outlines for outline in frame)])
    corners = np.array(truth.meta.get("corners_px") or np.empty((0, 2)), float).reshape(-1, 2)
    points = np.concatenate([points, corners])
    if len(points) == 0:
        return 0, height, 0, width
    margin = MARGIN_MW * truth.meta["mouth_width_px"]
    (row0, col0), (row1, col1) = points.min(axis=0) - margin, points.max(axis=0) + margin
    return max(0, int(row0)), min(height, int(row1) + 1), max(0, int(col0)), min(width, int(col1) + 1)


def _tile(frame, window, measured: list[np.ndarray], truth: Profile, at: int, reason: str) -> np.ndarray:
    row0, row1, col0, col1 = window
    scale = TILE_WIDTH_PX / (col1 - col0)
    size = TILE_WIDTH_PX, round((row1 - row0) * scale)
    tile = np.full((size[1] + CAPTION_LINES * LINE_PX, TILE_WIDTH_PX, 3), draw.STRIP_COLOUR, np.uint8)
    picture = tile[: size[1]]
    picture[:] = cv2.resize(frame.rgb((row0, row1, col0, col1)), size, interpolation=cv2.INTER_CUBIC)
    view = draw.View(scale, row0, col0)
    for outlines, colour in ((truth.outlines[at], TRUE_RGB), (measured, MEASURED_RGB)):
        for outline in outlines:
            draw.draw_outline(picture, outline, colour, view)
    for k, line in enumerate((f"{frame.time_s:.3f} s", *wrap(reason, 40)[: CAPTION_LINES - 1]), start=1):
        draw.draw_text(
            tile, line, size[1] + k * LINE_PX - 4, 4, TEXT_PX, draw.QUIET_COLOUR if k > 1 else draw.TEXT_COLOUR
        )
    return tile


def _arrange(tiles: list[np.ndarray]) -> np.ndarray:
    """Tiles in rows of COLUMNS, (H, W, 3) uint8 RGB."""
    if not tiles:
        return np.full((LINE_PX, TILE_WIDTH_PX, 3), draw.STRIP_COLOUR, np.uint8)
    height, width = tiles[0].shape[0] + GAP_PX, TILE_WIDTH_PX + GAP_PX
    rows = -(-len(tiles) // COLUMNS)
    sheet = np.full((rows * height + GAP_PX, min(COLUMNS, len(tiles)) * width + GAP_PX, 3), draw.STRIP_COLOUR, np.uint8)
    for k, tile in enumerate(tiles):
        row, col = GAP_PX + k // COLUMNS * height, GAP_PX + k % COLUMNS * width
        sheet[row : row + tile.shape[0], col : col + TILE_WIDTH_PX] = tile
    return sheet


# -- page -------------------------------------------------------------------------------------------------------------


def write_page(
    path: Path,
    simulated: Simulated,
    measured: Profile,
    truth: Profile,
    report: dict,
    seconds: dict[str, float],
    *,
    plot: Path,
    moments: Path,
    video: Path,
) -> None:
    """The page; `plot`, `moments` and `video` are files that it takes in."""
    mouth_px = report["true_mouth_width_px"]
    versions = measured.meta.get("versions", {}) | truth.meta.get("versions", {})
    body = f"""
<h1>A sticky mouth, simulated and measured</h1>
<p>A mouth whose lips are glued by drying saliva was simulated with finite elements and filmed. The film was then
measured like any recording, and what was measured is compared with the openings that are really there. In the pictures
<b class="true">green is the truth</b>, <b class="measured">red is what was measured</b>.</p>
<h2>In short</h2>
{_list(describe(report))}
<h2>What was simulated</h2>
<p>{escape(simulated.about)}.</p>
{_table(simulated.facts.items())}
<video controls loop muted playsinline src="{_inline(video, "video/mp4")}"></video>
<p class="note">The film with what was measured drawn in; each opening has a colour that it keeps.
{_view(path, simulated)}</p>
<h2>Key moments</h2>
<img alt="Frames with the true and the measured outlines" src="{_inline(moments, "image/png")}">
<h2>Over time</h2>
<img alt="Sizes over time, measured and true" src="{_inline(plot, "image/png")}">
<p class="note">Width, height and area are those of the largest opening of a frame.</p>
<h2>How far off</h2>
{_errors(report)}
{_counts(report)}
{_moments(report)}
<h2>How to read this</h2>
<p>Errors are in % of the width of the mouth at rest, here {mouth_px:.0f} px, so 1 % is {mouth_px / 100:.1f} px.
<i>Mean</i> is how far off a frame is on average, either way; <i>bias</i> is what is left when too large and too small
cancel out: one as large as the mean says that the fault is always the same. Both are over the frames in which truth and
measurement are open. <i>Overlap</i> lays the outlines over one another: the area that they share over the area that
either covers, 100 % where they are the same. Frames are matched by the clock of the film; one lasts
{1000 * _step_s(truth):.0f} ms.</p>
<p>What was measured is {escape(str(measured.meta.get("file", "the clip")))}, the H.264 film that a person would have,
compressed with loss; the file that ends in .mkv has the same frames without loss.</p>
<h2>Where it falls short</h2>
{_list(shortcomings(report))}
<h2>Time and versions</h2>
{_table((f"{name}", f"{value:.2f} s") for name, value in seconds.items())}
<p class="note">The first run compiles everything and takes several times as long as the next ones.</p>
{_table(sorted(versions.items()))}
"""
    page = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>lipmetrics demo</title><style>{_STYLE}</style></head><body>{body}</body></html>\n"
    )
    with whole_file(path) as part:
        part.write_text(page, encoding="utf-8")


def shortcomings(report: dict) -> list[str]:
    """What the comparison says against the measurement, and what no such comparison can tell, a sentence each."""
    found = []
    mouth = report["true_mouth_width_px"]
    if report["frames_without_mouth"]:
        found.append(f"No mouth was found in {report['frames_without_mouth']} frames.")
    if report["highest_missed_px"] > 0:
        missed = report["highest_missed_px"]
        found.append(
            f"Thin openings are missed: up to {missed:.1f} px ({100 * missed / mouth:.1f} % of the mouth width) high "
            "they were taken for a closed mouth."
        )
    if report["highest_invented_px"] > 0:
        found.append(
            f"In frames that are closed an opening of up to {report['highest_invented_px']:.1f} px height was seen."
        )
    if report["several_openings_right_percent"] < 100:
        found.append(
            f"Of the {report['frames_with_several_openings']} frames with several openings, their number is right in "
            f"{report['several_openings_right_percent']:.0f} %."
        )
    if math.isfinite(report["merges"]["true_s"]) and not math.isfinite(report["merges"]["measured_s"]):
        found.append("The merging of the openings was not seen.")
    for name in ("width", "height"):
        error = report[name]
        if error["largest_percent"] >= 5:
            found.append(
                f"The {name} is off by up to {error['largest_percent']:.0f} % of the mouth width, at "
                f"{error['largest_at_s']:.2f} s."
            )
    return [
        *found,
        "This is one face, in one light, from the front. Real faces have beards, shadows and turned heads: "
        "benchmarks/RESULTS.md has errors on real recordings.",
        "The detector has learnt from drawn mouths and from other faces of this simulator, so it does better here than "
        "on a recording.",
        "The truth counts an opening from 0.02 mm on, a small part of a pixel, so an onset can only be seen later "
        "in a film, never at the very moment.",
    ]


def _view(path: Path, simulated: Simulated) -> str:
    view = f"{simulated.stem}.view.html"
    if not path.with_name(view).exists():
        return ""
    return f'The simulated mouth itself, from all sides: <a href="{escape(view)}">{escape(view)}</a>.'


def _errors(report: dict) -> str:
    head = ("of the largest opening", "mean", "bias", "largest", "at")
    rows = []
    for name in SIZES:
        error = report[name]
        numbers = [_number(error[f"{kind}_percent"], 1, "%") for kind in ("mean", "bias", "largest")]
        label = f"{name}, % of mouth width" + (" squared" if name == "area" else "")
        rows.append((label, *numbers, _number(error["largest_at_s"], 2, "s")))
    overlap = report["overlap_percent"]
    rows.append(("overlap of the outlines, median", _number(overlap["median"], 1, "%"), "", "", ""))
    rows.append(("overlap of the outlines, least", _number(overlap["least"], 1, "%"), "", "", ""))
    rows.append(("width of the mouth at rest", "", _number(report["mouth_width_off_percent"], 1, "%"), "", ""))
    return _table(rows, head)


def _counts(report: dict) -> str:
    return _table(
        [
            ("frames compared", f"{report['frames']}"),
            ("open, truly and as measured", f"{report['frames_open']} and {report['frames_measured_open']}"),
            ("open or closed is right", _number(report["open_or_closed_right_percent"], 1, "% of the frames")),
            ("number of openings is right", _number(report["number_of_openings_right_percent"], 1, "% of the frames")),
            (
                "the same, where there are several",
                _number(report["several_openings_right_percent"], 1, f"% of {report['frames_with_several_openings']}"),
            ),
        ]
    )


def _moments(report: dict) -> str:
    rows = []
    for name, label in (("opens", "first open"), ("merges", "openings merge"), ("closes", "last open")):
        one = report[name]
        times = [_number(one[key], 3, "s") for key in ("true_s", "measured_s")]
        rows.append((label, *times, _number(one["off_ms"], 0, "ms"), _number(one["off_frames"], 0, "frames")))
    return _table(rows, ("moment", "truly", "measured", "off by", ""))


def _number(value: float, decimals: int, unit: str) -> str:
    return f"{value:.{decimals}f} {unit}" if math.isfinite(value) else "-"


def _table(rows, head: tuple[str, ...] = ()) -> str:
    def line(cells, tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(str(cell))}</{tag}>" for cell in cells) + "</tr>"

    return f"<table>{line(head, 'th') if head else ''}{''.join(line(row, 'td') for row in rows)}</table>"


def _list(sentences: list[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(one)}</li>" for one in sentences) + "</ul>"


def _inline(path: Path, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"


def _step_s(profile: Profile) -> float:
    time_s = profile.frames["time_s"].to_numpy(float)
    return float(np.median(np.diff(time_s))) if len(time_s) > 1 else math.nan


_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; max-width: 60rem; margin: 2rem auto;
  padding: 0 1rem; }
h1 { font-size: 1.7rem; } h2 { font-size: 1.2rem; margin-top: 2rem; }
img, video { max-width: 100%; height: auto; display: block; margin: 0.5rem 0; }
table { border-collapse: collapse; margin: 0.5rem 0 1rem; }
td, th { padding: 0.2rem 0.8rem 0.2rem 0; text-align: left; border-bottom: 1px solid #ddd; vertical-align: top; }
th { font-weight: 600; }
.note { color: #666; font-size: 0.9rem; } .true { color: #00803f; } .measured { color: #d5143c; }
"""
