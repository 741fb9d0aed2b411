"""Every reader of files that the project has, with good files for it; as a script, the process that reads bad ones.

A reader is a function of a folder with its files, and of the path that it was given good files at.
`python tests/fuzz_readers.py FOLDER` reads lines of a reader's name, a number of a case and how often to read it, and
answers each with what came of it.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import shutil
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from fuzzing import GROWTH_MB, LONGEST_MESSAGE, MEMORY_MB, damaged


class Reader(NamedTuple):
    """make(folder) writes good files into an empty folder, read(folder) reads them; fixed are names never damaged."""

    make: Callable[[Path], object]
    read: Callable[[Path], object]
    fixed: tuple[str, ...] = ()


READERS: dict[str, Reader] = {}


def reader(name: str, make: Callable, *fixed: str):
    def enter(read):
        READERS[name] = Reader(make, read, fixed)
        return read

    return enter


# -- videos and pictures ----------------------------------------------------------------------------------------------


def _video(name: str, **settings):
    def make(folder: Path):
        from clips import moving_pictures, write_video

        write_video(folder / name, moving_pictures(12, 48, 64), **settings)

    return make


def _pictures(name: str):
    def make(folder: Path):
        from clips import moving_pictures, write_pictures

        write_pictures(folder, moving_pictures(3, 24, 32), name)

    return make


VIDEOS = {
    "a.mp4": _video("a.mp4", key_every=4, sound=True, rotation_deg=90),
    "a.mov": _video("a.mov", codec="mpeg4"),
    "a.mkv": _video("a.mkv", codec="ffv1", pixel_format="bgr0"),
    "a.webm": _video("a.webm", codec="libvpx-vp9", options={"cpu-used": "8"}),
    "a.avi": _video("a.avi", codec="mjpeg", pixel_format="yuvj420p"),
    "a.mpg": _video("a.mpg", codec="mpeg1video"),
    "raw.avi": _video("raw.avi", codec="rawvideo", pixel_format="bgr24"),
}
PICTURES = ("frame_{}.png", "frame_{}.jpg", "frame_{}.bmp", "frame_{}.tiff", "frame_{}.webp", "frame_{}.ppm")


def _seen(frames, most: int = 60):
    for k, frame in enumerate(frames):
        frame.rgb()
        if frame.height > 8 and frame.width > 8:
            frame.rgb((2, 7, 1, 6))
        if k >= most:
            break


for _name, _make in VIDEOS.items():

    @reader(_name, _make)
    def _read_video(folder, name=_name):
        from lipmetrics.frames import open_frames

        with open_frames(folder / name) as frames:
            _seen(frames)
        with open_frames(folder / name, start_s=0.2, every=2) as frames:
            _seen(frames)


for _name in PICTURES:

    @reader(_name.format("n"), _pictures(_name))
    def _read_pictures(folder):
        from lipmetrics.frames import open_frames

        _seen(open_frames(folder, fps=25))


def _stamped_pictures(folder: Path):
    _pictures("frame_{}.png")(folder)
    (folder / "times.txt").write_text("time_s,x\n0.0,1\n0.04,2\n0.08,3\n")


@reader("times.txt", _stamped_pictures, "frame_0.png", "frame_1.png", "frame_2.png")
def _read_times(folder):
    from lipmetrics.frames import open_frames

    _seen(open_frames(folder, timestamps=folder / "times.txt"))


@reader("long take", VIDEOS["a.mp4"])
def _read_long_take(folder):
    from corpus_tools.activity import find_events, read_activity
    from corpus_tools.clips import Clip
    from corpus_tools.facts import clip_facts
    from corpus_tools.long_take import pictures, read_take

    try:
        take = read_take(folder / "a.mp4")
        list(pictures(take, [(2, 4)]))
        find_events(read_activity(folder / "a.mp4"))
    finally:
        clip_facts(Clip(folder / "a.mp4", "a", {}))


@reader("study's video", VIDEOS["a.mp4"])
def _read_study_video(folder):
    from study.design import Stimulus
    from study.videos import check_videos

    check_videos([Stimulus("a_7", "a", "7", True, "", str(folder / "a.mp4"), "x")], [])


# -- lipmetrics: tables and meshes ------------------------------------------------------------------------------------


def _profile(folder: Path):
    from mouth_clip import looks_of, profile_of

    from lipmetrics.profile import FORMAT

    statuses = ["closed", "open", "no_mouth", "open", "closed", "open"]
    made = profile_of(looks_of(statuses), [k / 25 for k in range(6)])
    made.openings.loc[made.openings.index[-1:], ["event", "parents"]] = ["merge", "1+12"]
    made.meta |= {"format": FORMAT, "mouth_width_found": "drawn", "warnings": []}
    made.save(folder, "a")


@reader("profile", _profile)
def _read_profile(folder):
    from lipmetrics.profile import load_profile

    load_profile(folder / "a")


@reader("take of a profile", _profile)
def _read_profile_take(folder):
    from lipmetrics.takes import read_take

    for unit in ("mw", "px"):
        take = read_take(folder / "a", unit=unit)
    _measured(take)


@reader("folder of a profile", _profile)
def _read_profile_folder(folder):
    from lipmetrics.takes import read_take

    read_take(folder)


def _truth(folder: Path):
    from moved_mouth import moved_mouth

    from simulator.camera import Camera
    from simulator.truth import truth

    mouth, motion = moved_mouth()
    truth(motion, mouth, Camera(width_px=200, height_px=150), motion.time_s).save(folder, "a")


@reader("truth", _truth)
def _read_truth(folder):
    from lipmetrics.accuracy import load_truth
    from lipmetrics.takes import read_take

    read_take(folder / "a", unit="m")
    load_truth(folder / "a")


def _sizes(folder: Path):
    from moving_takes import write_table

    write_table(folder / "a.csv")


def _measured(take):
    from lipmetrics.metrics import METRICS

    del METRICS, take


@reader("sizes.csv", _sizes)
def _read_sizes(folder):
    from lipmetrics.takes import read_take

    read_take(folder / "a.csv")


def _landmarks(folder: Path):
    points = np.random.default_rng(1).uniform(50, 300, (5, 68, 2))
    head = ["frame", "timestamp", "confidence", "success", *(f"{axis}_{n}" for axis in "xy" for n in range(68))]
    rows = [[k + 1, k / 30, 0.98, 1, *points[k, :, 0], *points[k, :, 1]] for k in range(5)]
    text = "\n".join(",".join(f"{v:.6g}" if not isinstance(v, str) else v for v in row) for row in [head, *rows])
    (folder / "a.csv").write_text(text + "\n")


@reader("landmarks.csv", _landmarks)
def _read_landmarks(folder):
    from lipmetrics.takes import read_take

    read_take(folder / "a.csv")


def _long_landmarks(folder: Path):
    rng = np.random.default_rng(1)
    rows = [
        f"{t / 25},{t},{n},{rng.uniform(50, 300):.4f},{rng.uniform(50, 300):.4f}" for t in range(4) for n in range(68)
    ]
    (folder / "a.csv").write_text("\n".join(["time_s,frame,landmark,x,y", *rows]) + "\n")


@reader("landmarks, a row per point", _long_landmarks)
def _read_long_landmarks(folder):
    from lipmetrics.takes import read_take

    read_take(folder / "a.csv")


LOOP = (0, 1, 2, 3, 4, 5)


def _mesh(folder: Path):
    for t in range(3):
        angle = np.arange(6) * np.pi / 3
        lines = [f"v {-np.cos(a):.6f} {np.sin(a) * (t + 1) / 5:.6f} 0.1" for a in angle]
        (folder / f"m_{t}.obj").write_text("\n".join([*lines, "f 1 2 3", "f 4 5 6"]) + "\n")


@reader("mesh sequence", _mesh)
def _read_mesh(folder):
    from lipmetrics.takes import read_take

    read_take(folder, fps=25, lip_loop=LOOP)


def _mesh_array(folder: Path):
    angle = np.arange(6) * np.pi / 3
    frames = [np.stack([-np.cos(angle), np.sin(angle) * (t + 1) / 5, 0 * angle], axis=1) for t in range(4)]
    np.save(folder / "m.npy", np.array(frames))


@reader("mesh.npy", _mesh_array)
def _read_mesh_array(folder):
    from lipmetrics.takes import read_take

    read_take(folder / "m.npy", fps=25, lip_loop=LOOP)


def _loop(name: str, text: str):
    return lambda folder: (folder / name).write_text(text)


for _name, _text in {
    "loop.json": '{"loop": [0, 1, 2, 3, 4, 5], "corners": [0, 3]}\n',
    "loop.toml": "loop = [0, 1, 2, 3, 4, 5]\ncorners = [0, 3]\n",
    "loop.txt": "# inner lips\n0, 1, 2\n3 4 5\n",
}.items():

    @reader(_name, _loop(_name, _text))
    def _read_loop(folder, name=_name):
        from lipmetrics.meshes import read_loop

        read_loop(folder / name)


@reader("labels.csv", _loop("a.csv", "path,utterance,speaker,repeat\na.mp4,m,p01,1\nb.mp4,puppy,p02,2\n"))
def _read_labels(folder):
    from lipmetrics.labels import read_list

    read_list(folder / "a.csv")


def _average(folder: Path):
    from moving_takes import moving_take

    from lipmetrics.compare.averages import average

    average([moving_take(f"t{k}", late_s=k / 50) for k in range(2)]).save(folder, "a")


@reader("average", _average)
def _read_average(folder):
    from lipmetrics.compare.averages import load_average

    load_average(folder / "a")


def _forests(folder: Path):
    from lipmetrics.forest import Forest, save_forests

    rng = np.random.default_rng(3)
    questions = rng.integers(0, 4, (3, 4, 6)).astype(np.int32)
    forest = Forest(
        questions, np.zeros((3, 4), bool), rng.normal(size=(3, 16, 2)).astype(np.float32), np.zeros(2, "f4")
    )
    save_forests(folder / "a.npz", {"coarse": forest})


@reader("forests.npz", _forests)
def _read_forests(folder):
    from lipmetrics.forest import load_forest

    load_forest(folder / "a.npz", "coarse")


# -- corpus tools -----------------------------------------------------------------------------------------------------


def _protocol(folder: Path):
    from corpus_tools.protocol import protocol_text

    (folder / "protocol.toml").write_text(protocol_text())


@reader("protocol.toml", _protocol)
def _read_protocol(folder):
    from corpus_tools.protocol import load_protocol, prompt_page, sheet_page

    protocol = load_protocol(folder / "protocol.toml")
    prompt_page(protocol)
    sheet_page(protocol)
    protocol.cuts("p01")


@reader("cuts.csv", _loop("a.csv", "start_s,stop_s,speaker,utterance,repeat\n1.0,3.5,p01,m,1\n5.0,8.0,p01,m,2\n"))
def _read_cuts(folder):
    from corpus_tools.cuts import read_cuts
    from corpus_tools.protocol import load_protocol

    read_cuts(folder / "a.csv", load_protocol())


_LOG = "at_s,event,utterance,repeat,kept\n1.0,lick,m,0,1\n5.0,cue,m,1,1\n15.0,cue,m,2,0\n25.0,cue,m,3,true\n"


@reader("log.csv", _loop("p01.log.csv", _LOG))
def _read_log(folder):
    from corpus_tools.cuts import read_cuts
    from corpus_tools.protocol import load_protocol

    read_cuts(folder / "p01.log.csv", load_protocol())


_GRID = (
    'File type = "ooTextFile"\nObject class = "TextGrid"\n\nxmin = 0\nxmax = 1\ntiers? <exists>\nsize = 2\nitem []:\n'
)
_GRID += (
    '  item [1]:\n    class = "IntervalTier"\n    name = "words"\n    xmin = 0\n    xmax = 1\n    intervals: size = 2\n'
)
_GRID += (
    '    intervals [1]:\n      xmin = 0\n      xmax = 0.4\n      text = "bin"\n    intervals [2]:\n      xmin = 0.4\n'
)
_GRID += '      xmax = 1\n      text = ""\n  item [2]:\n    class = "TextTier"\n    name = "points"\n    xmin = 0\n'
_GRID += '    xmax = 1\n    points: size = 1\n    points [1]:\n      number = 0.5\n      mark = "x"\n'
_PHONES = '{"s10_l_bbat9p": [{"phone": "b_B", "offset": 0.1, "duration": 0.05}, '
_PHONES += '{"phone": "ih_E", "offset": 0.15, "duration": 0.1}]}'
for _name, _text in {
    "a.TextGrid": _GRID,
    "a.align": "0 23750 sil\n23750 29500 bin\n29500 34000 blue\n",
    "phones.json": _PHONES,
}.items():

    @reader(_name, _loop(_name, _text))
    def _read_slices(folder, name=_name):
        from corpus_tools.slices import read_slices

        read_slices(folder / name)


def _store(folder: Path):
    shutil.copy(Path(__file__).parent / "data" / "store_v1.h5", folder / "store.h5")


@reader("store.h5", _store)
def _read_store(folder):
    from corpus_tools.store import Store

    with Store(folder / "store.h5") as store:
        first = None
        for read in (lambda: store.table(), lambda: store.keys(), lambda: store.takes(), lambda: store.failed):
            try:
                read()
            except Exception as error:
                if not _is_ours(error):
                    raise
                first = error
        for name in store.names:
            store.words(name)
        store.select(lambda fields: True)
        if first is not None:
            raise first


# -- simulator --------------------------------------------------------------------------------------------------------


def _scene(folder: Path):
    from simulator.scene import load_scene
    from simulator.settings import to_toml

    (folder / "a.toml").write_text(to_toml(load_scene("one_sided_left").spelled_out()))


def _small_scene(folder: Path):
    from simulator.scene import scene_text

    text = scene_text("uneven_drying")
    (folder / "a.toml").write_text(text)


@reader("scene.toml", _scene)
def _read_scene(folder):
    from simulator.scene import load_scene

    _ = load_scene(folder / "a.toml").state_times_s


@reader("scene's model", _small_scene)
def _read_scene_model(folder):
    import dataclasses

    from simulator.scene import load_scene

    scene = load_scene(folder / "a.toml")
    dataclasses.replace(scene, face=dataclasses.replace(scene.face, resolution="low")).model()
    scene.spelled_out()


def _niftysim(folder: Path):
    from test_simulator_niftysim_xml import TWO_HEXAHEDRA

    (folder / "a.xml").write_text(TWO_HEXAHEDRA)


@reader("niftysim.xml", _niftysim)
def _read_niftysim(folder):
    from simulator.niftysim_xml import niftysim_times, read_niftysim

    niftysim_times(read_niftysim(folder / "a.xml"))


@reader("keys.txt", _loop("a.txt", "0.0 0.0\nlinear\n0.1 0.2\ngeometric\n0.5 0.6\nquarter_sin\n1.0 1.0\n"))
def _read_keys(folder):
    from simulator.curves import read_key_frames

    read_key_frames(folder / "a.txt").value(np.linspace(0, 2, 50))


def _box_obj(folder: Path):
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    quads = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f " + " ".join(map(str, quad)) for quad in quads]
    (folder / "a.obj").write_text("\n".join(lines) + "\n")


@reader("volume.obj", _box_obj)
def _read_volume(folder):
    from simulator.volumes import read_closed_surface

    read_closed_surface(folder / "a.obj").inside(np.random.default_rng(0).uniform(-1, 2, (20, 3)))


def _mouth_obj(folder: Path):
    from test_simulator_obj_mesh import surface_lines

    (folder / "a.obj").write_text("\n".join(surface_lines()) + "\n")


@reader("mouth.obj", _mouth_obj)
def _read_mouth(folder):
    from simulator.obj_mesh import read_mouth_obj

    read_mouth_obj(folder / "a.obj", units="mm")


def _motion(folder: Path):
    from glued_blocks import glued_blocks
    from meshes import Ramp

    from simulator.export import write_motion
    from simulator.solver import solve

    model = glued_blocks(Ramp(0.05), peak_m=1e-4)
    write_motion(solve(model, np.linspace(0, 0.002, 3), threads=1), model, folder / "a.h5")


@reader("motion.h5", _motion)
def _read_motion(folder):
    from simulator.export import load_elements, load_motion

    try:
        load_motion(folder / "a.h5")
    finally:
        load_elements(folder / "a.h5")


def _short_run(folder: Path):
    from glued_blocks import glued_blocks
    from meshes import Ramp

    from simulator.solver import solve

    solve(
        glued_blocks(Ramp(0.05), peak_m=1e-4),
        np.linspace(0, 0.002, 3),
        threads=1,
        checkpoint_path=folder / "a.npz",
        checkpoint_every_s=0.0,
    )


@reader("checkpoint.npz", _short_run)
def _read_checkpoint(folder):
    _short_run(folder)


# -- study ------------------------------------------------------------------------------------------------------------


def _design(folder: Path):
    from study.design import make_design, stimuli_from_codes

    stimuli = stimuli_from_codes([f"m_{level}" for level in (0, 4, 7)])
    make_design(stimuli, participants_n=2, catch_n=1).save(folder)


@reader("design.json", _design)
def _read_design(folder):
    from study.design import load_design

    load_design(folder)


_VIDEOS = "stimulus,action,level,audio,speed\nm_0,m,0,0,slow\nm_4,m,4,1,slow\nm_7,m,7,0,fast\n"


@reader("stimuli.csv", _loop("a.csv", _VIDEOS))
def _read_stimuli(folder):
    from study.design import stimuli_from_csv

    stimuli_from_csv(folder / "a.csv")


_ANSWERS = "participant,trial,left,right,chosen,seconds\n1,1,m_0,m_4,m_4,3.5\n1,2,m_4,m_7,,2\n2,1,m_7,m_0,m_0,1.25\n"


@reader("answers.csv", _loop("a.csv", _ANSWERS))
def _read_answers(folder):
    from study.responses import load_answers

    load_answers(folder / "a.csv")


def _settings(folder: Path):
    from study.settings import write_settings

    write_settings(folder, 10)


@reader("study.toml", _settings)
def _read_settings(folder):
    from study.markdown import to_html
    from study.settings import PAGES, load_page, load_settings

    load_settings(folder)
    for name in PAGES:
        to_html(load_page(folder, name))


def _answers_database(folder: Path):
    from study.store import Store

    Store(folder / "study.db", "x", 2, abandoned_after_s=60.0).close()


@reader("study.db", _answers_database)
def _read_database(folder):
    from study.store import Store

    Store(folder / "study.db", "x", 2, abandoned_after_s=60.0).close()


# -- readers with faults, to see that they are found ------------------------------------------------------------------


def _crash(folder):
    if folder.name == "bad":
        os.abort()


def _hang(folder):
    if folder.name == "bad":
        time.sleep(6)  # longer than the test waits for an answer


def _eater(folder):
    if folder.name == "bad":
        np.ones(80_000_000)


def _raiser(folder):
    if folder.name == "bad":
        raise KeyError("x")


def _writer(folder):
    from lipmetrics.errors import InputError

    if folder.name == "bad":
        error = InputError("")
        error.args = ("a\nb",)
        raise error


_LEAKED = []


def _leaker(folder):
    _LEAKED.append(np.ones(200_000))


if "LIPMETRICS_FUZZ_FAULTY" in os.environ:
    _faulty = {"crash": _crash, "hang": _hang, "eater": _eater, "raiser": _raiser, "writer": _writer, "leaker": _leaker}
    for _name, _read in _faulty.items():
        READERS[_name] = Reader(_loop("a.csv", "a,b\n1,2\n"), _read)


# -- one case ---------------------------------------------------------------------------------------------------------


def good_files(folder: Path, name: str) -> Path:
    """The folder with a reader's good files, made the first time."""
    place = folder / "good" / name.replace("/", "_")
    if not place.exists():
        part = place.with_name(f"{place.name}.part")
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        READERS[name].make(part)
        part.rename(place)
    return place


def bad_files(folder: Path, name: str, case: int) -> Path:
    """A folder with the reader's files, one of them damaged."""
    good = good_files(folder, name)
    rng = np.random.default_rng([zlib.crc32(name.encode()), case])
    files = sorted(one.name for one in good.iterdir())
    chosen = [one for one in files if one not in READERS[name].fixed]
    chosen = chosen[rng.integers(len(chosen))]
    bad = folder / "bad"
    shutil.rmtree(bad, ignore_errors=True)
    bad.mkdir()
    others = [one.read_bytes() for one in sorted((folder / "good").glob("*/*"))] if case % 7 == 0 else []
    for one in files:
        data = (good / one).read_bytes()
        (bad / one).write_bytes(damaged(data, one, rng, others) if one == chosen else data)
    return bad


def _is_ours(error: BaseException) -> bool:
    return type(error).__name__ == "InputError" and type(error).__module__.endswith(".errors")


def attempt(name: str, folder: Path) -> tuple[str, str]:
    """What came of reading a folder, and what is wrong with it."""
    try:
        READERS[name].read(folder)
    except Exception as error:
        text = str(error)
        if not _is_ours(error):
            import traceback

            last = traceback.extract_tb(error.__traceback__)
            where = next(
                (f for f in reversed(last) if "site-packages" not in f.filename and "lib/python" not in f.filename),
                last[-1],
            )
            return "", f"{type(error).__name__}: {text[:300]} ({Path(where.filename).name}:{where.lineno})"
        if "\n" in text or len(text) > LONGEST_MESSAGE or not text.strip():
            return text[:2000], f"a message of {len(text)} characters and {text.count(chr(10)) + 1} lines"
        return text, ""
    return "returned", ""


def _memory_mb(what: str) -> float:
    with open("/proc/self/status", encoding="ascii") as status:
        line = next((line for line in status if line.startswith(what)), f"{what} 0 kB")
    return int(line.split()[1]) / 1024


def _forget_peak() -> None:
    with contextlib.suppress(OSError), open("/proc/self/clear_refs", "w", encoding="ascii") as file:
        file.write("5")


def main(folder: Path) -> None:
    """Answer lines of `name case [times]` until there are no more."""
    known = set()
    size = int((_memory_mb("VmSize") + MEMORY_MB) * 2**20)
    resource.setrlimit(resource.RLIMIT_AS, (size, size))
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    print("ready", file=answers, flush=True)
    for line in sys.stdin:
        name, case, *times = line.strip().split("\t")
        if name not in known:  # what it needs is imported, and good files are read, before memory is looked at
            known.add(name)
            told, fault = attempt(name, good_files(folder, name))
            if told != "returned":
                print(json.dumps({"told": told, "fault": f"good files: {told} {fault}"}), file=answers, flush=True)
                continue
        bad = bad_files(folder, name, int(case))
        _forget_peak()
        before = _memory_mb("VmRSS")
        started = time.perf_counter()
        told, fault = attempt(name, bad)
        taken_s = time.perf_counter() - started
        grown = _memory_mb("VmHWM") - before
        if not fault and grown > GROWTH_MB:
            fault = f"took {grown:.0f} MB"
        if not fault and times:
            fault = _leak(name, bad, int(times[0]))
        answer = {"told": told, "fault": fault, "taken_s": round(taken_s, 3), "grown_mb": round(grown, 1)}
        print(json.dumps(answer), file=answers, flush=True)


def _leak(name: str, folder: Path, times: int) -> str:
    """What is wrong with memory after reading the same files many times."""
    for _ in range(times // 3):
        attempt(name, folder)
    before = _memory_mb("VmRSS")
    for _ in range(times):
        attempt(name, folder)
    grown = _memory_mb("VmRSS") - before
    return f"grew by {grown:.1f} MB in {times} readings" if grown > 0.05 * times + 10 else ""


if __name__ == "__main__":
    main(Path(sys.argv[1]))
