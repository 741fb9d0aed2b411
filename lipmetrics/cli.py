"""The command `lipmetrics`: one small function per verb, everything heavy imported when a verb needs it.

Exit codes: 0 done, 2 bad arguments or input, 3 some items of a batch failed, 130 stopped by Ctrl-C.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from pathlib import Path

from lipmetrics.comparison_commands import add_comparison_verbs
from lipmetrics.console import (
    BAD_INPUT,
    DONE,
    SOME_FAILED,
    STOPPED,
    Parser,
    Version,
    above_zero,
    add_verb,
    complain,
    count,
    prepare,
    say,
    say_json,
    seconds,
    sentence,
)
from lipmetrics.endings import VIDEO_ENDINGS
from lipmetrics.errors import InputError


def main(argv: list[str] | None = None) -> int:
    """Run one command line; returns the exit code."""
    words = sys.argv[1:] if argv is None else list(argv)
    # matrices are small here: more threads gain nothing, and on a busy machine they wait for one another for seconds
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if words[:1] == ["simulate"]:  # the simulator reads its own words, and is not even imported for other commands
        from simulator.cli import main as simulate

        return simulate(words[1:], prog="lipmetrics simulate")
    if words[:1] == ["view"]:
        from simulator.viewer import main as view

        return view(words[1:], prog="lipmetrics view")
    if words[:1] == ["corpus"]:
        from corpus_tools.cli import main as corpus

        return corpus(words[1:], prog="lipmetrics corpus")
    if words[:1] == ["study"]:
        from study.cli import main as study

        return study(words[1:], prog="lipmetrics study")
    try:
        arguments = _parser().parse_args(words)
        return arguments.run(arguments)
    except InputError as error:
        complain(str(error))
        return BAD_INPUT
    except (MemoryError, OSError) as error:
        complain(sentence(error))
        return BAD_INPUT
    except KeyboardInterrupt:
        complain("stopped; what was finished before is kept")
        return STOPPED


def run_measure(arguments: argparse.Namespace) -> int:
    """`lipmetrics measure`: every clip to its tables, provenance and pictures; goes past clips that fail."""
    folder = Path(arguments.out)
    prepare(folder)
    sources = find_clips(arguments.videos)
    clips, failed = [], []
    for source, stem in zip(sources, unique_stems(sources), strict=True):
        try:
            clips.append(_measure_one(source, stem, folder, arguments))
        except Exception as error:
            if len(sources) == 1 and not isinstance(error, InputError | OSError | MemoryError):
                raise  # a fault of ours: show where
            failed.append({"source": source, "error": sentence(error)})
            complain(f"{source}: {sentence(error)}" if len(sources) > 1 else sentence(error))
    if arguments.json:
        say_json({"command": "measure", "clips": clips, "failed": failed})
    elif len(sources) > 1:
        say(f"{len(clips)} of {len(sources)} clips measured")
    if not failed:
        return DONE
    return SOME_FAILED if clips else BAD_INPUT


def _measure_one(source: str, stem: str, folder: Path, arguments: argparse.Namespace) -> dict:
    from lipmetrics.pipeline import measure

    if not arguments.overwrite:
        _refuse_to_replace_another(folder / f"{stem}.json", Path(source).absolute().name)
    reading = {
        "fps": arguments.fps,
        "timestamps": arguments.timestamps,
        "start_s": arguments.start,
        "stop_s": arguments.stop,
        "every": arguments.every,
    }
    profile = measure(
        source,
        method=arguments.method,
        roi=arguments.roi,
        mouth_width_px=arguments.mouth_width,
        keep_outlines=arguments.overlay or arguments.sheet,
        progress=sys.stderr.isatty(),
        **reading,
    )
    files = profile.save(folder, stem)
    warnings = list(profile.meta["warnings"])
    if arguments.plot:
        from lipmetrics.plot import plot_profile

        files.append(folder / f"{stem}.plot.png")
        plot_profile(profile, files[-1])
    if arguments.overlay:
        from lipmetrics.overlay import write_overlay

        files.append(folder / f"{stem}.overlay.mp4")
        warnings += write_overlay(source, profile, files[-1], **reading) or []
    if arguments.sheet:
        from lipmetrics.sheet import write_sheet

        files.append(folder / f"{stem}.sheet.png")
        write_sheet(source, profile, files[-1], fps=arguments.fps, timestamps=arguments.timestamps)
    for warning in warnings:
        complain(f"{profile.meta['file']}: warning: {warning}")
    statuses = Counter(profile.frames["status"])
    summary = {
        "source": source,
        "files": [str(path) for path in files],
        "frames": len(profile.frames),
        **{status: statuses[status] for status in ("open", "closed", "no_mouth")},
        "mouth_width_px": profile.meta["mouth_width_px"],
        "warnings": warnings,
    }
    if not arguments.json:
        counts = f"{summary['open']} open, {summary['closed']} closed, {summary['no_mouth']} without a mouth"
        say(f"{profile.meta['file']}: {summary['frames']} frames, {counts} -> {files[0]}")
    return summary


def run_demo(arguments: argparse.Namespace) -> int:
    """`lipmetrics demo`: simulate a sticky mouth, measure its video, compare with the truth."""
    from lipmetrics.demo import demo

    folder = Path(arguments.out)
    prepare(folder)
    report = demo(
        folder,
        simulate_demo,
        method=arguments.method,
        progress=sys.stderr.isatty(),
        rehearsal="lipmetrics.cli:rehearse_demo",
    )
    if arguments.json:
        say_json({"command": "demo", **report})
    else:
        say("\n".join(report["text"]))
    return DONE


def simulate_demo(folder: Path, scene=None):
    """The clip of `lipmetrics demo` with its truth; `scene` is another one than the built-in `demo`."""
    from lipmetrics.demo import Simulated
    from simulator import errors
    from simulator.clip import make_clip
    from simulator.scene import load_scene

    try:
        scene = scene or load_scene("demo")
        # one thread solves: the other core compiles the detector meanwhile
        clip = make_clip(scene, folder, stem="demo", threads=1, progress=sys.stderr.isatty())
    except errors.InputError as error:
        raise InputError(str(error)) from None
    if clip.motion.stopped is not None:
        raise InputError(f"{scene.name}: {clip.motion.stopped}; the states before are kept in {clip.files[0]}")
    camera, motion = scene.camera, clip.motion
    size, rate = f"{camera.width_px} x {camera.height_px} px", f"{scene.output.frame_rate:g} per second"
    stickiness = [f"{scene.saliva.stickiness:g}", *(f"{patch.stickiness:g} in a place" for patch in scene.saliva.patch)]
    facts = {
        "scene": f"{scene.name}; lipmetrics simulate --print {scene.name} writes it out, to be changed",
        "film": f"{len(scene.frame_times_s)} pictures of {size}, {rate}",
        "stickiness": ", ".join(stickiness),
        "mesh": f"{scene.face.resolution}, {len(clip.mouth.elements):,} elements, {len(motion.nodes):,} nodes",
        "solver": f"{motion.steps:,} steps of {1e6 * motion.dt_s:.0f} µs",
    }
    return Simulated("demo", clip.files, scene.about, facts, clip.seconds)


def rehearse_demo(method: str) -> None:
    """Compile what the demo needs after the solver, by the truth of one state of a mouth and by a drawn clip.

    The pictures' part stays with the process that solves: so both take about as long.
    """
    import numpy as np

    from lipmetrics.demo import rehearse
    from simulator.camera import Camera
    from simulator.motion import BROKEN, Motion, SalivaRecord
    from simulator.mouth import mouth_mesh
    from simulator.truth import truth

    mouth = mouth_mesh(resolution="low")
    positions = mouth.nodes[None].copy()
    positions[:, mouth.upper, 1] += 0.005
    ones = np.ones((1, len(mouth.saliva)))
    saliva = SalivaRecord(mouth.saliva, np.full(ones.shape, BROKEN, np.uint8), ones, ones, ones)
    truth(Motion(np.zeros(1), positions, mouth.nodes, {}, 1e-4, 1, saliva=saliva), mouth, Camera())
    rehearse(method)


def run_validate(arguments: argparse.Namespace) -> int:
    """`lipmetrics validate`: measure simulated clips of every kind, and say where the method can be trusted."""
    from lipmetrics.validate import validate

    folder = Path(arguments.out)
    clips, facts = suite_clips(arguments)
    prepare(folder)
    summary = validate(
        clips,
        film_suite,
        folder,
        method=arguments.method,
        jobs=arguments.jobs,
        progress=sys.stderr.isatty(),
        facts=facts,
    )
    text = summary.pop("text")
    if arguments.json:
        say_json({"command": "validate", **summary})
    else:
        say("\n".join(text))
    return SOME_FAILED if summary["failed"] else DONE


def suite_clips(arguments: argparse.Namespace):
    """The clips that a validation is made of, and what its report says about them."""
    from lipmetrics.validate import ClipFacts
    from simulator import errors
    from simulator.suite import NAMED, RATE_HZ, RESOLUTION, SEEDS, clip_key, suite

    only = [one.strip() for one in (arguments.only or "").split(",") if one.strip()]
    try:
        chosen = suite(arguments.part, quick=arguments.quick, only=only, seed=arguments.seed)
    except errors.InputError as error:
        raise InputError(str(error)) from None
    clips = [
        ClipFacts(
            clip=one.name,
            axis=one.axis,
            setting=one.setting,
            condition=one.condition,
            take=one.take.name,
            action=one.take.action,
            face=one.take.face,
            mouth_px=one.filming.mouth_px,
            key=clip_key(one),
            content=one,
        )
        for one in chosen
    ]
    facts = {
        "part": arguments.part + (", quick" if arguments.quick else "") + (f", only {', '.join(only)}" if only else ""),
        "faces": f"{', '.join(NAMED[arguments.part])} and random ones between these; the other part has none of them",
        "seed": f"{SEEDS[arguments.part]}, {arguments.seed}",
        "film": f"{RATE_HZ:g} pictures per second, H.264; {RESOLUTION} mesh",
    }
    return clips, facts


def film_suite(clips, folder: Path) -> str:
    """Write the clips of one movement and their truth; returns why they cannot be filmed, or nothing."""
    from simulator import errors
    from simulator.suite import solve_take, write_clip

    try:
        solved = solve_take(clips[0].content.take)
        if solved.motion is None:
            return solved.dropped
        for one in clips:
            write_clip(one.content, solved, folder, one.key)
    except errors.InputError as error:
        return str(error)
    return ""


def find_clips(inputs: list[str]) -> list[str]:
    """The clips that the inputs name: the videos of a folder in order of name, everything else as it stands.

    A folder without videos stands for itself, an image sequence.
    """
    clips = []
    for given in inputs:
        videos = []
        if os.path.isdir(given):
            names = sorted(name for name in os.listdir(given) if not name.startswith("."))
            videos = [os.path.join(given, name) for name in names if Path(name).suffix.lower() in VIDEO_ENDINGS]
        clips += videos or [given]
    return list(dict.fromkeys(clips))


def unique_stems(sources: list[str]) -> list[str]:
    """Names for the output files, all different: the clip's name without its ending where that is enough.

    Where it is not, the ending is added (`grid_mp4`, `grid_mpg`), then the folder (`anna_grid`), then a number.
    """

    def plain(source: str) -> str:
        path = Path(source)
        if any(mark in path.name for mark in "*?["):  # a pattern of pictures goes by its folder
            path = path.parent
        return (path.resolve().name if path.is_dir() else path.stem) or "clip"

    def with_ending(source: str) -> str:
        return plain(source) + Path(source).suffix.lower().replace(".", "_")

    def with_folder(source: str) -> str:
        return f"{Path(source).resolve().parent.name}_{plain(source)}"

    names = [plain(source) for source in sources]
    for longer in (with_ending, with_folder):
        count = Counter(name.lower() for name in names)  # some file systems do not tell Grid from grid
        names = [longer(s) if count[name.lower()] > 1 else name for s, name in zip(sources, names, strict=True)]
    seen: Counter[str] = Counter()
    for i, name in enumerate(names):
        seen[name.lower()] += 1
        if seen[name.lower()] > 1:
            names[i] = f"{name}_{seen[name.lower()]}"
    return names


def _refuse_to_replace_another(path: Path, name: str) -> None:
    """Two clips of one name, measured one after the other into one folder, must not replace each other unseen."""
    try:
        there = json.loads(path.read_text(encoding="utf-8"))["file"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return
    if there != name:
        raise InputError(f"{path} is the profile of another clip, {there}; choose another -o or give --overwrite")


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="lipmetrics", description="Measure how mouths open in video.")
    parser.add_argument("--version", action=Version, nargs=0, help="show the version and exit")
    verbs = parser.add_subparsers(title="commands", required=True, metavar="COMMAND", parser_class=Parser)
    _add_measure(verbs)
    _add_demo(verbs)
    add_comparison_verbs(verbs)
    _add_validate(verbs)
    verbs.add_parser("simulate", help="ground-truth clips of sticky mouths from scenes", add_help=False)
    verbs.add_parser("view", help="replay a simulated clip in the browser", add_help=False)
    verbs.add_parser("corpus", help="record, cut, check, measure and average a corpus of clips", add_help=False)
    verbs.add_parser("study", help="design, run and analyse a study that compares videos in pairs", add_help=False)
    return parser


def _add_measure(verbs) -> None:
    verb = add_verb(
        verbs,
        "measure",
        run_measure,
        "videos, folders of videos or image sequences to tables, provenance and pictures",
        "lipmetrics measure recordings/ -o out --overlay --plot",
    )
    verb.add_argument(
        "videos", nargs="+", metavar="VIDEO", help="video, folder of videos, or folder or pattern of pictures"
    )
    verb.add_argument("-o", "--out", required=True, metavar="DIR", help="folder for the results, made if needed")
    verb.add_argument("--method", default="default", help="default, or thesis for the published baseline")
    verb.add_argument("--overlay", action="store_true", help="also write a video with outlines and numbers drawn in")
    verb.add_argument("--plot", action="store_true", help="also draw width, height, area and count over time")
    verb.add_argument("--sheet", action="store_true", help="also write a contact sheet of the least certain frames")
    verb.add_argument("--start", type=seconds, metavar="S", help="measure from this time on, s")
    verb.add_argument("--stop", type=seconds, metavar="S", help="measure up to this time, s")
    verb.add_argument("--every", type=count, default=1, metavar="N", help="measure every N-th frame only")
    verb.add_argument("--roi", type=_region, metavar="X,Y,W,H", help="look into this part of the picture only, px")
    verb.add_argument("--mouth-width", type=above_zero, metavar="PX", help="width of the mouth at rest, if known")
    verb.add_argument("--fps", type=above_zero, help="frames per second of an image sequence")
    verb.add_argument("--timestamps", metavar="FILE", help="times of an image sequence in s, one per line")
    verb.add_argument("--overwrite", action="store_true", help="replace results of another clip of the same name")


def _add_demo(verbs) -> None:
    verb = add_verb(
        verbs,
        "demo",
        run_demo,
        "simulate a sticky mouth, measure its video and compare with the truth",
        "lipmetrics demo -o demo",
    )
    verb.add_argument("-o", "--out", default="lipmetrics-demo", metavar="DIR", help="folder for clip and report")
    verb.add_argument("--method", default="default", help="default, or thesis for the published baseline")


def _add_validate(verbs) -> None:
    verb = add_verb(
        verbs,
        "validate",
        run_validate,
        "measure simulated clips of every kind and say where the method can be trusted",
        "lipmetrics validate -o validation --quick",
    )
    verb.add_argument("-o", "--out", default="lipmetrics-validate", metavar="DIR", help="folder for clips and report")
    verb.add_argument("--part", default="report", help="report (default), or tune: other faces and seeds, to work with")
    verb.add_argument("--quick", action="store_true", help="about a tenth of the clips")
    verb.add_argument("--method", default="default", help="default, or thesis for the published baseline")
    verb.add_argument(
        "--only", metavar="CONDITION,...", help="only these axes or conditions, such as 'beard,noise: 6 %%'"
    )
    verb.add_argument("--jobs", type=count, metavar="N", help="processes; 2 where nothing is said")
    verb.add_argument("--seed", type=_whole, default=0, metavar="N", help="other than 0 for other random faces")


def _whole(text: str) -> int:
    if not text.isascii() or not text.isdigit() or len(text) > 9:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 0, got '{text}'")
    return int(text)


def _region(text: str) -> tuple[int, int, int, int]:
    """X,Y,W,H of the command line to (row0, row1, col0, col1), half open."""
    try:
        x, y, width, height = (int(part) for part in text.split(","))
    except ValueError:
        x = y = width = height = -1
    if min(x, y) < 0 or min(width, height) < 1:
        raise argparse.ArgumentTypeError(
            f"expected X,Y,W,H in whole px (left, top, width, height) such as 100,200,160,120, got '{text}'"
        )
    return y, y + height, x, x + width


if __name__ == "__main__":
    sys.exit(main())
