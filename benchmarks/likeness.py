"""Is a sticky model nearer to a sticky mouth than one that does not stick? And is a clip near to itself?

    LIPMETRICS_BENCHMARK_CACHE=out python benchmarks/likeness.py --write

Thesis figures 5.37 to 5.42 with simulated mouths. A hidden scene plays the real mouth: another face, other saliva,
another jaw than the models have. Its video is rendered and measured by the detector, as a recording would be. The
models have the average face and the built-in saliva, sticky and not, from their truth as a mesh would give it. An
animator sees in a recording when the jaw moves and how far the mouth is open at last, so both models' jaws have the
hidden one's timing, and go as far as the non-sticky model needs to end at the recording's height.

The second part changes reference clips in ways that should not matter (speed, size, frame rate, compression), measures
them anew, and sets the distance from the clip itself beside the distances between clips.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import tempfile
import zlib
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pandas as pd
import reference
import utterances
from results import markdown, write_section
from utterances import solved, truth_take

from lipmetrics.compare import align, aligned_hausdorff, aligned_l2
from lipmetrics.frames import open_frames
from lipmetrics.metrics import curves
from lipmetrics.take import CHANNELS, Take
from lipmetrics.takes import read_take
from simulator.clip import pictures
from simulator.scene import Scene, load_scene
from simulator.video import write_video

FIGURES = Path(__file__).parents[1] / "docs" / "figures"
SCENES = ("slow_open", "double_opening")
MODELS = {"sticky": 7.0, "non-sticky": 0.0}
MEASURES = {"L2": curves.l2, "L2 aligned": curves.l2_aligned, "DTW": curves.dtw, "Hausdorff": curves.hausdorff}
FIRST_WAY_M = 0.025


@dataclasses.dataclass(frozen=True)
class Hidden:
    """What the mouth that plays the real one has other than the models: face, saliva, jaw and picture."""

    face: str
    level: float
    jaw_m: float
    keys_s: tuple[float, float]  # the jaw starts and arrives
    patch_m: tuple[float, float]  # stickier place of double_opening
    patch_level: float  # of it, beside the others' level
    tone: str
    yaw_deg: float = 0.0


HIDDEN = {
    "full_lips": Hidden("full_lips", 8.0, 0.024, (0.06, 0.80), (0.0025, 0.0060), 150.0, "brown", 3.0),
    "older": Hidden("older", 6.0, 0.023, (0.03, 0.70), (0.0020, 0.0055), 160.0, "light"),
    "wide": Hidden("wide", 8.0, 0.027, (0.07, 0.78), (0.0020, 0.0065), 170.0, "tan", -3.0),
    "cupid": Hidden("cupid", 5.5, 0.022, (0.05, 0.80), (0.0020, 0.0055), 150.0, "very light"),
    "protruding": Hidden("protruding", 7.5, 0.025, (0.04, 0.68), (0.0030, 0.0065), 150.0, "dark"),
}
SHOWN = "cupid"


def hidden_scene(name: str, who: Hidden, resolution: str = "medium") -> Scene:
    """The scene that plays the real mouth."""
    scene = load_scene(name, who.level)
    (jaw,) = scene.muscle
    start, stop = who.keys_s
    patches = tuple(
        dataclasses.replace(one, stickiness=who.patch_level, from_m=who.patch_m[0], to_m=who.patch_m[1])
        for one in scene.saliva.patch
    )
    return dataclasses.replace(
        scene,
        name=f"{name}_{who.face}",
        seed=5,
        face=dataclasses.replace(scene.face, preset=who.face, resolution=resolution),
        saliva=dataclasses.replace(scene.saliva, patch=patches),
        muscle=(dataclasses.replace(jaw, peak_m=who.jaw_m, keys=((start, 0.0), "smooth", (stop, 1.0))),),
        skin=dataclasses.replace(scene.skin, tone=who.tone),
        camera=dataclasses.replace(scene.camera, yaw_deg=who.yaw_deg),
    )


def model_scene(name: str, level: float, who: Hidden, way_m: float, resolution: str = "medium") -> Scene:
    """A built-in scene, sticky or not, whose jaw goes by `way_m` at the times of a hidden mouth's."""
    scene = load_scene(name, MODELS["sticky"])
    (jaw,) = scene.muscle
    start, stop = who.keys_s
    scene = scene.with_stickiness(level)
    return dataclasses.replace(
        scene,
        face=dataclasses.replace(scene.face, resolution=resolution),
        muscle=(dataclasses.replace(jaw, peak_m=way_m, keys=((start, 0.0), "smooth", (stop, 1.0))),),
    )


def filmed(scene: Scene, name: str) -> Take:
    """The take of a scene's rendered video, measured by the detector."""

    def make() -> Take:
        mouth, motion = solved(scene)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"{name}.mkv"
            write_video(file, pictures(scene, mouth, motion, scene.frame_times_s), scene.output.frame_rate)
            return read_take(file, name=name)

    return utterances.kept(f"video_{name}", make)


def fitted_way_m(name: str, who: Hidden, last_mw: float, resolution: str) -> float:
    """How far the jaw has to go for the non-sticky model to end at a height, mouth widths: two steps of the secant."""
    ways = [FIRST_WAY_M, 1.15 * FIRST_WAY_M]

    def height(way_m: float) -> float:
        key = f"fit_{name}_{who.face}_{1e6 * way_m:.0f}_{resolution}"
        take = utterances.kept(key, lambda: truth_take(model_scene(name, 0.0, who, way_m, resolution), "fit"))
        return float(take.channels["height"][-1])

    heights = [height(way_m) for way_m in ways]
    slope = (heights[1] - heights[0]) / (ways[1] - ways[0])
    return float(np.clip(ways[0] + (last_mw - heights[0]) / slope, 0.01, 0.05))


def model_takes(name: str, who: Hidden, real: Take, resolution: str = "medium") -> dict[str, Take]:
    """The takes of both models of a scene, from their truth; the jaw's way is fitted to the last height of `real`."""
    way_m = fitted_way_m(name, who, float(np.median(real.channels["height"][-5:])), resolution)
    takes = {}
    for label, level in MODELS.items():
        key = f"model_{name}_{who.face}_{level:g}_{1e6 * way_m:.0f}_{resolution}"
        takes[label] = utterances.kept(key, lambda: truth_take(model_scene(name, level, who, way_m, resolution), label))  # noqa: B023
    return takes


# -- distances --------------------------------------------------------------------------------------------------------


def likeness(real: Take, models: dict[str, Take]) -> pd.DataFrame:
    """Distance of each model: rows (channel, measure), columns models. One alignment of all three channels."""
    found = {label: curves.validate(real, model) for label, model in models.items()}
    rows = {
        (channel, name): {label: measure(pair, channel=channel) for label, pair in found.items()}
        for channel, (name, measure) in itertools.product(CHANNELS, MEASURES.items())
    }
    return pd.DataFrame(rows).T


def likeness_tables(hidden: dict[str, Hidden]) -> str:
    """Numbers of the shown mouth, and how many of all hidden mouths the sticky model is nearer to."""
    text = ""
    for name in SCENES:
        every = {}
        for label, who in hidden.items():
            real = filmed(hidden_scene(name, who), f"{name}_{label}")
            every[label] = real, likeness(real, model_takes(name, who, real))
        _, shown = every[SHOWN]
        table = shown.apply(lambda row: f"{row['sticky']:.4f} / {row['non-sticky']:.4f}", axis=1)
        text += _grid(table, f"{name}: sticky / non-sticky model to '{SHOWN}'")
        ratios = pd.DataFrame({label: one["sticky"] / one["non-sticky"] for label, (_, one) in every.items()})
        table = ratios.apply(
            lambda row: f"{(row < 1).sum()} of {len(row)}; {row.median():.2f} ({row.min():.2f} to {row.max():.2f})",
            axis=1,
        )
        text += _grid(table, f"{name}: sticky nearer to so many; sticky over non-sticky, median (range)")
    return text + jump_table(hidden)


def _grid(cells: pd.Series, title: str) -> str:
    """Texts by (channel, measure) as a table of channels in rows and measures in columns."""
    table = pd.DataFrame({measure: {channel: cells[channel, measure] for channel in CHANNELS} for measure in MEASURES})
    return markdown(table.rename_axis(title)) + "\n"


def jump_table(hidden: dict[str, Hidden]) -> str:
    """When openings merge in double_opening, and the width before and after."""
    rows = {}
    for label, who in hidden.items():
        real = filmed(hidden_scene("double_opening", who), f"double_opening_{label}")
        truth = utterances.kept(f"truth_{label}", lambda: truth_take(hidden_scene("double_opening", who), label))  # noqa: B023
        models = model_takes("double_opening", who, real)
        takes = {"hidden, truth": truth, "hidden, video": real, **models}
        rows[label] = {key: _jump_text(merge_jump(take), take) for key, take in takes.items()}
    table = pd.DataFrame(rows).T
    table.index.name = "double_opening: when two openings merge, width before and after"
    return markdown(table)


def _jump_text(jump: tuple[float, float, float] | None, take: Take) -> str:
    if jump is None:
        return f"never more than {int(np.nanmax(take.channels['n_openings']))}"
    return f"{jump[0]:.2f} s, {jump[1]:.2f} to {jump[2]:.2f}"


def merge_jump(take: Take) -> tuple[float, float, float] | None:
    """When two openings become one for the last time, and the width of the largest before and after; None if never.

    Widths are of two frames before and after, as merging may take a frame.
    """
    count = take.channels["n_openings"]
    at = np.flatnonzero((count[:-1] >= 2) & (count[1:] == 1))
    if not len(at):
        return None
    k = int(at[-1])
    width = take.channels["width"]
    return float(take.time_s[k + 1]), float(width[max(k - 1, 0) : k + 1].min()), float(width[k + 1 : k + 3].max())


def figure(real: Take, models: dict[str, Take], path: Path) -> None:
    """Width, height and area over time of the real mouth and both models."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    style = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.linewidth": 0.8}
    with rc_context(style):
        drawn = Figure(figsize=(12, 3.9), dpi=100, layout="constrained")
        axes = drawn.subplots(1, 3)
        looks = {"sticky": ("#d55e00", "-"), "non-sticky": ("#0072b2", (0, (5, 2)))}
        for panel, channel in zip(axes, CHANNELS, strict=True):
            panel.plot(
                real.time_s, real.channels[channel], color="black", linewidth=2.2, label="real (hidden, from video)"
            )
            for label, model in models.items():
                colour, dashes = looks[label]
                panel.plot(
                    *(model.time_s, model.channels[channel]),
                    **{"color": colour, "linestyle": dashes, "linewidth": 1.5, "label": f"{label} model"},
                )
            unit = "mouth widths" + ("²" if channel == "area" else "")
            panel.set(xlabel="time (s)", ylabel=f"{channel} ({unit})", xlim=(0, 1))
            panel.set_ylim(bottom=0)
            panel.grid(axis="y", color="#000000", alpha=0.08, linewidth=0.6)
        drawn.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
        part = path.with_suffix(".part.png")
        drawn.savefig(part, metadata={"Software": None})
        part.replace(path)


# -- a clip against itself --------------------------------------------------------------------------------------------

CLIPS = (
    *("grid_bbaf2n", "grid_id2", "grid_lbax4n", "grid_lrwp9a", "grid_pwij3p", "grid_sbia1a"),
    *("mead_happy", "vox_00473", "st_aoc", "st_menendez", "lp_d18", "vr_5"),
)
LENGTH_S = 3.0
Pictures = list[tuple[float, np.ndarray]]  # time, s, and RGB


@dataclasses.dataclass(frozen=True)
class Change:
    """What is done to a clip before it is measured again.

    tempo : how much longer it takes; size : factor; rate : frames per second over those of the clip, nearest picture
    """

    tempo: float = 1.0
    size: float = 1.0
    rate: float = 1.0
    keep_frames: bool = False  # of another tempo: the same pictures at other times, instead of a fixed frame rate
    codec: str = "ffv1"
    options: tuple[tuple[str, str], ...] = ()


CHANGES = {
    "as it is, lossless": Change(),
    "0.8 times as fast, same pictures": Change(tempo=1.25, keep_frames=True),
    "1.25 times as fast, same frame rate": Change(tempo=0.8),
    "half the size": Change(size=0.5),
    "1.5 times the size": Change(size=1.5),
    "half the frame rate": Change(rate=0.5),
    "2.4 times the frame rate, pictures repeated": Change(rate=2.4),
    "H.264, crf 23": Change(codec="libx264", options=(("crf", "23"),)),
    "H.264, crf 28": Change(codec="libx264", options=(("crf", "28"),)),
    "H.264, crf 38": Change(codec="libx264", options=(("crf", "38"),)),
    "MPEG-4, quantiser 12": Change(codec="mpeg4", options=(("qmin", "12"), ("qmax", "12"))),
    "half the size, half the frame rate, crf 28": Change(size=0.5, rate=0.5, codec="libx264", options=(("crf", "28"),)),
}


def changed(frames: Pictures, change: Change, path: Path) -> None:
    """Write the pictures of a clip with a change."""
    times = np.array([time for time, _ in frames]) - frames[0][0]
    rate = (len(times) - 1) / times[-1]
    if change.keep_frames:
        order, rate = np.arange(len(times)), rate / change.tempo
    else:
        rate *= change.rate
        target = np.arange(int(times[-1] * change.tempo * rate + 1e-6) + 1) / (rate * change.tempo)
        order = np.abs(target[:, None] - times[None, :]).argmin(axis=1)
    size = [2 * round(side * change.size / 2) for side in frames[0][1].shape[:2]]
    with av.open(str(path), "w") as container:
        stream = container.add_stream(
            change.codec, rate=Fraction(rate).limit_denominator(1001), options=dict(change.options)
        )
        stream.height, stream.width = size
        stream.pix_fmt = "bgr0" if change.codec == "ffv1" else "yuv420p"
        for k in order:
            picture = frames[k][1]
            if size != list(picture.shape[:2]):
                way = cv2.INTER_AREA if change.size < 1 else cv2.INTER_CUBIC
                picture = cv2.resize(picture, size[::-1], interpolation=way)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))


def remeasured(clip: Path, name: str) -> dict[str, Take]:
    """Change -> the take of the first seconds of a clip after it."""

    def make(change: Change, label: str) -> Take:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "changed.mkv"
            changed(pictures_of(clip), change, file)
            return read_take(file, name=label)

    return {
        label: utterances.kept(
            f"itself_{name}_{zlib.crc32(repr(change).encode()):08x}",
            lambda: make(change, label),  # noqa: B023
        )
        for label, change in CHANGES.items()
    }


def pictures_of(clip: Path, length_s: float = LENGTH_S) -> Pictures:
    """The first seconds of a video."""
    found: Pictures = []
    with open_frames(clip) as frames:
        for frame in frames:
            if found and frame.time_s - found[0][0] >= length_s - 1e-6:
                break
            found.append((frame.time_s, frame.rgb()))
    return found


def against(one: Take, other: Take) -> dict[str, float]:
    """Distances of two takes, each from its start: cost per step, aligned L2, Hausdorff; cost of the height alone."""
    match = align(one, other, clock="start")
    return {
        "DTW": match.per_step,
        "L2 aligned": aligned_l2(match).value,
        "Hausdorff": aligned_hausdorff(match).value,
        "DTW, height": align(one, other, channels=("height",), clock="start").per_step,
    }


def itself_tables(names: tuple[str, ...] = CLIPS) -> str:
    """Distance of clips from themselves after each change, beside those between clips."""
    takes = {name: remeasured(reference.video_file(name), name) for name in names}
    first, *others = CHANGES
    between = pd.DataFrame([against(takes[a][first], takes[b][first]) for a, b in itertools.combinations(names, 2)])
    typical = between.median()

    def row(made: dict[str, Take]) -> dict[str, str]:
        found = pd.DataFrame([against(takes[name][first], made[name]) for name in names])
        share = 100 * found / typical
        return {
            key: f"{found[key].median():.3f}; {share[key].median():.0f} %, {share[key].max():.0f} %" for key in found
        }

    rows = {label: row({name: takes[name][label] for name in names}) for label in others}
    rows["measured by MediaPipe instead"] = row({name: _landmarks(name) for name in names})
    for word, share in (("least", 0.0), ("5th percentile", 0.05), ("median", 0.5)):
        at = between.quantile(share)
        rows[f"between two clips, {word}"] = {
            key: f"{at[key]:.3f}; {100 * at[key] / typical[key]:.0f} %" for key in at.index
        }
    table = pd.DataFrame(rows).T
    table.index.name = (
        f"{len(names)} clips, first {LENGTH_S:g} s: median; median and largest over the median between clips"
    )
    return markdown(table)


def _landmarks(name: str) -> Take:
    take = utterances.landmarks(name)
    return utterances.cut(take, -np.inf, take.time_s[0] + LENGTH_S)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write the section of RESULTS.md and the figures")
    arguments = parser.parse_args()
    text = "## Likeness\n\n`python benchmarks/likeness.py --write`\n\n"
    text += "### A mouth that sticks and two models\n\n" + likeness_tables(HIDDEN)
    if reference.reference_folder() is not None:
        text += "\n### A clip against itself\n\n" + itself_tables()
    print(text)
    if arguments.write:
        for name in SCENES:
            real = filmed(hidden_scene(name, HIDDEN[SHOWN]), f"{name}_{SHOWN}")
            figure(real, model_takes(name, HIDDEN[SHOWN], real), FIGURES / f"likeness_{name}.png")
        write_section("likeness", text)


if __name__ == "__main__":
    main()
