"""What `lipmetrics corpus run` costs beyond measuring, how it grows, and what the thesis's corpus would take.

    python benchmarks/corpus.py --write                    # everything, about 15 minutes on two idle cores
    python benchmarks/corpus.py --part jobs memory --small # some of it, in small

Needs no data: the clips are made here. One mouth is simulated and drawn; its video is copied under many names, each
with a number in a part of the file that players pass over, so that the contents differ and the work is the same. A long
clip is the same packets again and again.

- jobs: wall time of a whole run, start of the processes included, on 1 and 2 processes in turn; the best of each;
- overhead: cost of a clip more in a run, less that of `lipmetrics.measure` called on the same files in one process;
- linear: wall time of runs of 10, 100 and 1,000 clips, and of the same run again, when nothing is to be done;
- memory: the most that a worker ever held (VmHWM), by length of the clip;
- thesis: 1,650 clips of 180 frames at 1080p, from runs of a few, and the share of the time that goes into decoding.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pandas as pd
from results import machine, markdown, write_section

PARTS = ("jobs", "overhead", "linear", "memory", "thesis")
SECONDS, RATE = 3, 60  # of the thesis's clips
CORPUS_N = 1650
CAMERA_BIT_S = 20_000_000  # as phones and cameras record 1080p
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
GOALS = {"jobs": ">= 1.8 times", "overhead": "<= 50 ms", "linear": "exponent 1", "memory": "flat"}

# in a process of its own, with one thread, as a worker has it
MEASURE = """
import json, sys, time
import cv2
from lipmetrics import frames
from lipmetrics.pipeline import measure
frames.decoder_threads_n = 1
cv2.setNumThreads(1)
def decode(path):
    with frames.open_frames(path) as opened:
        for _ in opened:
            pass
do = {"measure": measure, "decode": decode}[sys.argv[1]]
do(sys.argv[2])
wall, cpu = time.perf_counter(), time.process_time()
for path in sys.argv[2:]:
    do(path)
print(json.dumps([time.perf_counter() - wall, time.process_time() - cpu]))
"""


@dataclasses.dataclass(frozen=True)
class Sizes:
    """How much is done of everything; `SMALL` is for trying."""

    jobs_n: int = 100
    overhead_n: tuple[int, int] = (10, 110)
    linear_n: tuple[int, ...] = (10, 100, 1000)
    lengths_s: tuple[int, ...] = (3, 60, 600)
    thesis_n: tuple[int, int] = (4, 16)
    repeats: int = 2


SMALL = Sizes(8, (4, 12), (3, 10, 30), (3, 30), (2, 4), 1)


def draw_clip(path: Path, seconds: float, rate: int = RATE, size: tuple[int, int] = (512, 512)) -> Path:
    """A simulated mouth that says mummy, drawn and encoded as cameras do (H.264, noise)."""
    from simulator.clip import pictures
    from simulator.scene import load_scene
    from simulator.simulate import simulate
    from simulator.video import write_video

    scene = load_scene("mummy")
    scene = dataclasses.replace(
        scene,
        duration_s=seconds - 1 / rate,
        face=dataclasses.replace(scene.face, resolution="low"),
        output=dataclasses.replace(scene.output, frame_rate=float(rate)),
        camera=dataclasses.replace(scene.camera, width_px=size[0], height_px=size[1]),
    )
    mouth, model = scene.model()
    motion = simulate(scene, parts=(mouth, model))
    write_video(path, pictures(scene, mouth, motion, scene.frame_times_s), rate, "h264")
    return path


def at_1080p(source: Path, target: Path, seed: int = 0) -> Path:
    """The clip enlarged to 1080 rows in the middle of a grey picture, with noise as a camera's."""
    rng = np.random.default_rng(seed)
    grain = rng.normal(0, 2.5, (1200, 2100, 1)).astype(np.float32)
    with av.open(str(source)) as old, av.open(str(target), "w") as new:
        stream = new.add_stream("libx264", rate=RATE, options={"preset": "veryfast"})
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = 1920, 1080, "yuv420p", CAMERA_BIT_S
        for number, frame in enumerate(old.decode(video=0)):
            picture = np.full((1080, 1920, 3), 128, np.float32)
            picture[:, 420:1500] = cv2.resize(frame.to_ndarray(format="rgb24"), (1080, 1080))
            row, col = rng.integers(0, 120), rng.integers(0, 180)
            picture += grain[row : row + 1080, col : col + 1920]
            large = av.VideoFrame.from_ndarray(picture.clip(0, 255).astype(np.uint8), format="rgb24")
            large.pts, large.time_base = number, Fraction(1, RATE)
            new.mux(stream.encode(large))
        new.mux(stream.encode(None))
    return target


def repeated(source: Path, target: Path, times: int) -> Path:
    """The packets of a clip, so many times one after the other."""
    with av.open(str(source)) as old, av.open(str(target), "w") as new:
        stream = new.add_stream_from_template(old.streams.video[0])
        packets = [
            (bytes(one), one.pts, one.dts, one.duration, one.is_keyframe)
            for one in old.demux(video=0)
            if one.dts is not None
        ]
        length = max(pts for _, pts, *_ in packets) + packets[0][3]
        for turn in range(times):
            for data, pts, dts, duration, is_key in packets:
                packet = av.Packet(data)
                packet.pts, packet.dts, packet.duration = pts + turn * length, dts + turn * length, duration
                packet.time_base, packet.stream, packet.is_keyframe = old.streams.video[0].time_base, stream, is_key
                new.mux(packet)
    return target


def copies(source: Path, folder: Path, count: int) -> list[Path]:
    """The clip under so many names, each with contents of its own: a box at the end that says its number."""
    folder.mkdir(parents=True)
    data, paths = source.read_bytes(), []
    for number in range(1, count + 1):
        paths.append(folder / f"p01_mummy_{number}.mp4")
        paths[-1].write_bytes(data + struct.pack(">I4sI", 12, b"free", number))
    return paths


def run_s(folder: Path, store: Path, jobs: int) -> float:
    """Wall time of a whole run, s."""
    started = time.perf_counter()
    words = ["corpus", "run", folder, "-o", store, "--jobs", jobs]
    ended = subprocess.run([sys.executable, "-m", "lipmetrics.cli", *map(str, words)], capture_output=True, text=True)
    if ended.returncode:
        raise SystemExit(ended.stderr)
    return time.perf_counter() - started


def alone_s(what: str, paths: Sequence[Path]) -> tuple[float, float]:
    """Wall and processor time of `measure` or `decode` on these clips, warm, in one process of one thread, s."""
    words = [sys.executable, "-c", MEASURE, what, *map(str, paths)]
    return tuple(json.loads(subprocess.run(words, capture_output=True, check=True, env=os.environ | ONE_THREAD).stdout))


def jobs(work: Path, clip: Path, sizes: Sizes) -> str:
    folder = work / "jobs"
    copies(clip, folder, sizes.jobs_n)
    seconds = {1: [], 2: []}
    for repeat in range(sizes.repeats):
        for count, taken in seconds.items():
            taken.append(run_s(folder, work / f"jobs{count}_{repeat}.h5", count))
    if (work / "jobs1_0.h5").read_bytes() != (work / "jobs2_0.h5").read_bytes():
        raise SystemExit("the stores of 1 and of 2 processes differ")
    rows = {
        f"{sizes.jobs_n} clips of {SECONDS} s, 512 x 512": {
            "1 process, s": min(seconds[1]),
            "2 processes, s": min(seconds[2]),
            "times as fast": min(seconds[1]) / min(seconds[2]),
            "the same, by repeat": ", ".join(f"{a / b:.2f}" for a, b in zip(*seconds.values(), strict=True)),
            "goal": GOALS["jobs"],
        }
    }
    return "### Two processes against one\n\n" + _table(rows, "")


def overhead(work: Path, clip: Path, sizes: Sizes) -> str:
    few, many = sizes.overhead_n
    paths = copies(clip, work / "many", many)
    copies(clip, work / "few", few)
    costs, measuring = [], []
    for repeat in range(sizes.repeats):
        took = {n: run_s(work / name, work / f"{name}{repeat}.h5", 1) for n, name in ((few, "few"), (many, "many"))}
        costs.append((took[many] - took[few]) / (many - few))
        measuring.append(alone_s("measure", paths[few:])[0] / (many - few))
    rows = {
        f"a clip of 0.5 s, 256 x 256, of {many}": {
            "in a run, ms": 1000 * min(costs),
            "`measure` alone, ms": 1000 * min(measuring),
            "beyond measuring, ms": 1000 * (min(costs) - min(measuring)),
            "the same, by repeat": ", ".join(f"{1000 * (a - b):.1f}" for a, b in zip(costs, measuring, strict=True)),
            "goal": GOALS["overhead"],
        }
    }
    return "### Beyond measuring\n\n" + _table(rows, "")


def linear(work: Path, clip: Path, sizes: Sizes) -> str:
    rows, counts, taken = {}, [], []
    for count in sizes.linear_n:
        copies(clip, work / f"n{count}", count)
        store = work / f"n{count}.h5"
        first, again = run_s(work / f"n{count}", store, 2), run_s(work / f"n{count}", store, 2)
        rows[f"{count}"] = {
            "first run, s": first,
            "the same again, s": again,
            "store, kB per clip": store.stat().st_size / count / 1000,
        }
        counts.append(count)
        taken.append(first)
    steps = [(b - a) / (m - n) for a, b, n, m in zip(taken, taken[1:], counts, counts[1:], strict=False)]
    text = ", ".join(f"{1000 * s:.0f} ms from {n} to {m}" for s, n, m in zip(steps, counts, counts[1:], strict=False))
    return (
        "### Number of clips\n\n"
        + _table(rows, "clips of 0.5 s, 256 x 256, 2 processes")
        + f"\nA clip more costs {text}; equal where the cost is linear.\n"
    )


def memory(work: Path, clip: Path, sizes: Sizes) -> str:
    rows = {}
    for seconds in sizes.lengths_s:
        folder = work / f"long{seconds}"
        folder.mkdir()
        repeated(clip, folder / "p01_mummy_1.mp4", seconds // SECONDS)
        worker, parent = peaks(folder, work / f"long{seconds}.h5")
        rows[f"{seconds} s"] = {"frames": seconds * 30, "worker, MB": worker / 1e6, "the run itself, MB": parent / 1e6}
    return "### Peak memory\n\n" + _table(rows, "one clip, 256 x 256, 30 per second", 1)


def peaks(folder: Path, store: Path) -> tuple[float, float]:
    """The most memory that the one worker and the run itself ever held, bytes; Linux only."""
    words = [sys.executable, "-m", "lipmetrics.cli", "corpus", "run", str(folder), "-o", str(store), "--jobs", "1"]
    run = subprocess.Popen(words, stdout=subprocess.DEVNULL)
    most: dict[int, float] = {}
    while run.poll() is None:
        for pid in (run.pid, *_children(run.pid)):
            most[pid] = max(most.get(pid, 0.0), _peak(pid))
        time.sleep(0.005)
    if run.returncode:
        raise SystemExit(f"corpus run ended with {run.returncode}")
    return max(peak for pid, peak in most.items() if pid != run.pid), most[run.pid]


def _children(pid: int) -> list[int]:
    try:
        found = map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split())
        return [one for one in found if b"spawn_main" in Path(f"/proc/{one}/cmdline").read_bytes()]
    except OSError:
        return []


def _peak(pid: int) -> float:
    try:
        for line in Path(f"/proc/{pid}/status").read_text().splitlines():
            if line.startswith("VmHWM"):
                return 1024.0 * int(line.split()[1])
    except OSError:
        pass
    return 0.0


def thesis(work: Path, clip: Path, sizes: Sizes) -> str:
    few, many = sizes.thesis_n
    large = at_1080p(clip, work / "large.mp4")
    paths = copies(large, work / "hd", many)
    copies(large, work / "hd_few", few)
    begun, costs = [], []
    for repeat in range(sizes.repeats):
        short, long = (run_s(work / name, work / f"{name}{repeat}.h5", 2) for name in ("hd_few", "hd"))
        costs.append((long - short) / (many - few))
        begun.append(short - few * costs[-1])
    (_, decoding), (_, measuring) = (alone_s(what, paths[:few]) for what in ("decode", "measure"))
    hours = [(start + CORPUS_N * cost) / 3600 for start, cost in zip(begun, costs, strict=True)]
    rows = {
        f"{CORPUS_N} clips of {SECONDS * RATE} frames, 1920 x 1080, {large.stat().st_size / 1e6:.1f} MB each": {
            "measured": f"{many} clips",
            "s per clip, 2 processes": statistics.median(costs),
            "hours in all, 2 processes": statistics.median(hours),
            "processor s per clip": measuring / few,
            "of which decoding, %": 100 * decoding / measuring,
        }
    }
    return "### The thesis's corpus\n\n" + _table(rows, "extrapolated")


def _table(rows: dict[str, dict], name: str, decimals: int = 2) -> str:
    table = pd.DataFrame.from_dict(rows, orient="index")
    table.index.name = name
    return markdown(table, decimals)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--part", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--small", action="store_true", help="few clips, to try it")
    parser.add_argument("--write", action="store_true", help="into RESULTS.md")
    arguments = parser.parse_args()
    if arguments.write and (arguments.small or set(arguments.part) != set(PARTS)):
        parser.error("--write takes everything: leave out --part and --small")
    sizes = SMALL if arguments.small else Sizes()
    texts = ["## Corpus\n\n" + machine() + " Clips are made by the script; run times are wall times unless said.\n"]
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        whole = draw_clip(work / "whole.mp4", SECONDS)
        short = draw_clip(work / "short.mp4", 0.5, 30, (256, 256))
        slow = draw_clip(work / "slow.mp4", SECONDS, 30, (256, 256))
        one = copies(short, work / "warm", 1)
        run_s(work / "warm", work / "warm.h5", 1)  # compiles, once per machine
        alone_s("measure", one)
        clips = {"jobs": whole, "overhead": short, "linear": short, "memory": slow, "thesis": whole}
        for part in arguments.part:
            began = time.perf_counter()
            texts.append(globals()[part](work, clips[part], sizes))
            print(texts[-1] + f"\n({time.perf_counter() - began:.0f} s)\n", flush=True)
    if arguments.write:
        write_section("corpus", "\n".join(texts))


if __name__ == "__main__":
    main()
