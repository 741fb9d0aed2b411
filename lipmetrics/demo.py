"""`lipmetrics demo`: a drawn mouth whose openings are known exactly, measured from its video, and the difference."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import av
import numpy as np

from lipmetrics.artificial import Drawing, Face, Shape, draw, lip_curves
from lipmetrics.atomic import whole_file
from lipmetrics.look import CLOSED, OPEN, Look
from lipmetrics.openings import Identities, measure_outline
from lipmetrics.overlay import write_overlay
from lipmetrics.pipeline import measure
from lipmetrics.profile import FORMAT, Profile, frame_row, opening_row, tables

FPS = 25
SIZE = (360, 480)  # rows, columns: a face from nose to chin
MOUTH_WIDTH_PX = 150.0
CENTRE = (160.0, 236.0)  # row, column
FACE = Face(jaw_width=2.3, upper_teeth=0.08, cavity=(0.12, 0.05, 0.05))


def demo(folder: Path, *, method: str = "default", progress: bool = False) -> dict:
    """Draw a clip, measure it, compare with the truth; everything is written into `folder`.

    Returns
    -------
    the comparison: mean errors of the largest opening in % of the mouth width, shares of frames judged right, names of
    the files, and the same as lines of `text`

    Raises InputError if `folder` cannot be written to.
    """
    shapes = sticky_opening()
    clip = folder / "demo.mp4"
    write_clip(clip, shapes)
    truth = true_profile(shapes)
    measured = measure(clip, method=method, keep_outlines=True, progress=progress)
    files = [clip, *truth.save(folder, "truth"), *measured.save(folder, "demo")]
    files += [folder / "demo.overlay.mp4", folder / "demo.report.png", folder / "demo.report.json"]
    write_overlay(clip, measured, files[-3])
    plot_comparison(measured, truth, files[-2])
    report = compare(measured, truth)
    with whole_file(files[-1]) as part:
        part.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return report | {"files": [str(path) for path in files], "text": [*describe(report), f"files in {folder}"]}


def sticky_opening() -> list[Shape]:
    """The mouth in every frame: it rests, opens around a patch that sticks, comes unstuck, closes; 3 s."""
    shapes = []
    for time_s in np.arange(3 * FPS) / FPS:
        opening = np.interp(time_s, (0.4, 1.5, 2.0, 2.7), (0.0, 0.42, 0.42, 0.0))
        patch = np.interp(time_s, (0.4, 1.1), (0.2, 0.12))  # half its width, share of half the mouth width
        shapes.append(
            Shape(
                gap=(0.35 * opening, 0.65 * opening),
                span=(-0.55 - 0.6 * opening, 0.55 + 0.6 * opening),
                glued=((0.15 - patch, 0.15 + patch),) if opening > 0 and time_s < 1.1 else (),
            )
        )
    return shapes


def drawn(shape: Shape) -> Drawing:
    """The face with this mouth; the chin follows the lower lip, the skin stays the same."""
    face = replace(FACE, shape=shape, chin_y=FACE.chin_y + 0.8 * shape.gap[1])
    return draw(face, SIZE, MOUTH_WIDTH_PX, CENTRE, rng=np.random.default_rng(0), supersample=1)


def write_clip(path: Path, shapes: list[Shape]) -> None:
    """Draw each shape and write them all as an H.264 mp4 of `FPS` frames per second."""
    with whole_file(path) as part, av.open(str(part), "w", format="mp4") as target:
        stream = target.add_stream("libx264", rate=FPS, options={"crf": "18"})
        stream.height, stream.width = SIZE
        stream.pix_fmt = "yuv420p"
        for i, shape in enumerate(shapes):
            frame = av.VideoFrame.from_ndarray(drawn(shape).picture, format="rgb24")
            frame.pts = i
            target.mux(stream.encode(frame))
        target.mux(stream.encode())


def true_outlines(shape: Shape) -> list[np.ndarray]:
    """The openings of a shape as drawn by `write_clip`, (n, 2) float64 (row, column) in px each, from its curves."""
    x = np.linspace(-shape.width / 2, shape.width / 2, 1001)
    _, upper, lower, _ = lip_curves(shape, x)
    inside = np.concatenate([[False], (lower - upper) * MOUTH_WIDTH_PX > 0.1, [False]])
    starts, stops = np.flatnonzero(inside[1:] & ~inside[:-1]), np.flatnonzero(inside[:-1] & ~inside[1:])
    outlines = []
    for start, stop in zip(starts, stops, strict=True):
        along, upper_edge, lower_edge = x[start:stop], upper[start:stop], lower[start:stop]
        rows = np.concatenate([upper_edge, lower_edge[::-1]])
        cols = np.concatenate([along, along[::-1]])
        outlines.append(np.column_stack([CENTRE[0] + MOUTH_WIDTH_PX * rows, CENTRE[1] + MOUTH_WIDTH_PX * cols]))
    return outlines


def true_profile(shapes: list[Shape]) -> Profile:
    """The profile of the clip from geometry alone, in the tables that `measure` writes."""
    identities = Identities()
    frames, openings = [], []
    for i, shape in enumerate(shapes):
        outlines = true_outlines(shape)
        found = [measure_outline(outline) for outline in outlines]
        frames.append(frame_row(i, i / FPS, Look(OPEN if found else CLOSED, outlines), found))
        openings += [opening_row(i, i / FPS, w, o) for w, o in zip(identities.update(found), found, strict=True)]
    meta = {"format": FORMAT, "file": "demo.mp4", "mouth_width_px": MOUTH_WIDTH_PX, "mouth_width_found": "drawn so"}
    return Profile(*tables(frames, openings, MOUTH_WIDTH_PX), meta)


def compare(measured: Profile, truth: Profile) -> dict:
    """How far a measured profile is from the true one of the same frames.

    Errors are mean absolute differences of the largest opening over the frames that both see open, in % of the true
    mouth width; shares are over all frames.
    """
    a, b = measured.frames, truth.frames
    both = ((a["status"] == OPEN) & (b["status"] == OPEN)).to_numpy()
    width_px = truth.meta["mouth_width_px"]

    def error(column: str) -> float:
        return float(100 * np.abs(a[column] - b[column])[both].mean() / width_px) if both.any() else float("nan")

    return {
        "frames": len(b),
        "frames_open": int((b["status"] == OPEN).sum()),
        "height_error_percent": error("height_px"),
        "width_error_percent": error("width_px"),
        "open_or_closed_right_percent": float(100 * (a["status"] == b["status"]).mean()),
        "number_of_openings_right_percent": float(100 * (a["n_openings"] == b["n_openings"]).fillna(False).mean()),
        "mouth_width_px": measured.meta["mouth_width_px"],
        "true_mouth_width_px": width_px,
    }


def describe(report: dict) -> list[str]:
    """The comparison in words, one line each."""
    return [
        f"drawn and measured: {report['frames']} frames, {report['frames_open']} of them open",
        f"opening height is off by {report['height_error_percent']:.1f} % of the mouth width on average, "
        f"its width by {report['width_error_percent']:.1f} %",
        f"open or closed is right in {report['open_or_closed_right_percent']:.0f} % of the frames, "
        f"the number of openings in {report['number_of_openings_right_percent']:.0f} %",
        f"mouth width {report['mouth_width_px']:.1f} px, drawn {report['true_mouth_width_px']:.1f} px",
    ]


def plot_comparison(measured: Profile, truth: Profile, path: Path) -> None:
    """Width, height and number of openings over time, measured over true, as a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 6), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(3, 1, sharex=True)
    labels = {"width_px": "width (px)", "height_px": "height (px)", "n_openings": "openings"}
    for panel, (column, label) in zip(panels, labels.items(), strict=True):
        for profile, style, name in ((truth, {"color": "0.6", "linewidth": 4}, "drawn"), (measured, {}, "measured")):
            panel.plot(
                profile.frames["time_s"], profile.frames[column].to_numpy(float, na_value=np.nan), label=name, **style
            )
        panel.set_ylabel(label)
    panels[0].legend(frameon=False)
    panels[-1].set_xlabel("time (s)")
    with whole_file(path) as part:
        figure.savefig(part, format="png", metadata={"Software": None})
