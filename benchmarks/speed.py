"""How fast a method is, on one core. Prints the speed tables of RESULTS.md.

    python benchmarks/speed.py --methods default thesis --write

- find and measure: time of finding the mouth in a decoded frame and measuring its openings, conversion to RGB included,
  decoding not; median over the frames after the first, and the first frame by itself;
- measure against decoding: ``lipmetrics.measure`` of a whole 1080p file over reading every frame of it with PyAV and
  doing nothing with them, the two in turn, as the ratio of medians.

The process is bound to one core, so that no library helps itself to more, and times are this core's time spent on it,
which other work on the machine disturbs least. Ratios within a run mean more than times.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pandas as pd
import reference
from results import markdown, write_section
from timing import in_turn_s, one_core

from lipmetrics.detect import make_detector
from lipmetrics.frames import open_frames
from lipmetrics.openings import measure_outline
from lipmetrics.pipeline import measure

SMALL_CLIPS = ("grid_bbaf2n", "grid_lbax4n", "grid_sbia1a")  # 360 x 288 as they are
LARGE_CLIP, LARGE_CLIP_S = "st_aoc", 8  # 512 x 512, 25 frames per s; enlarged to 1080p
REPEATS = 3


def enlarge(source: Path, target: Path, height: int = 1080, width: int = 1920, rate: int = 25) -> None:
    """A copy of a video scaled to ``height`` rows and set in the middle of a grey picture ``width`` wide, H.264."""
    with av.open(str(source)) as old, av.open(str(target), "w") as new:
        stream = new.add_stream("libx264", rate=rate, options={"preset": "veryfast", "crf": "20"})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for number, frame in enumerate(old.decode(video=0)):
            inner = round(frame.width * height / frame.height)
            left = (width - inner) // 2
            picture = np.full((height, width, 3), 128, np.uint8)
            scaled = cv2.resize(frame.to_ndarray(format="rgb24"), (inner, height), interpolation=cv2.INTER_CUBIC)
            picture[:, max(left, 0) : max(left, 0) + inner] = scaled[:, max(-left, 0) : max(-left, 0) + width]
            large = av.VideoFrame.from_ndarray(picture, format="rgb24")
            large.pts, large.time_base = number, Fraction(1, rate)
            new.mux(stream.encode(large))
        new.mux(stream.encode(None))


def frame_times_ms(path: Path, method: str) -> np.ndarray:
    """Time of finding and measuring in every frame of a clip, decoding left out, ms."""
    times = []
    with open_frames(path) as frames:
        detector = make_detector(method, None, frames.info)
        for frame in frames:
            began = time.thread_time()
            for outline in detector.look(frame).outlines:
                measure_outline(outline)
            times.append(1000 * (time.thread_time() - began))
    return np.array(times)


def decode(path: Path) -> None:
    """Read every frame and do nothing with it."""
    with av.open(str(path)) as container:
        container.streams.video[0].thread_type = "AUTO"
        for _ in container.decode(video=0):
            pass


def find_and_measure(methods: list[str], clips: dict[str, list[Path]]) -> pd.DataFrame:
    """Rows: method and size; columns: ms in a frame after the first, and in the first frame."""
    rows = {}
    for method in methods:
        frame_times_ms(clips["360x288"][0], method)  # compiles
        for size, paths in clips.items():
            times = [frame_times_ms(path, method) for path in paths for _ in range(2)]
            later = np.concatenate([each[1:] for each in times])
            rows[f"{method}, {size}"] = {
                "median, ms": np.median(later),
                "mean, ms": later.mean(),
                "95th percentile, ms": np.percentile(later, 95),
                "first frame, ms": np.median([each[0] for each in times]),
            }
    return pd.DataFrame(rows).T.rename_axis("method, size")


def measure_against_decoding(methods: list[str], path: Path) -> pd.DataFrame:
    """Rows: decoding with PyAV, reading with the package, ``measure``; columns: s, and times decoding."""

    def read() -> None:
        with open_frames(path) as frames:
            for _ in frames:
                pass

    works = {"decoding (PyAV)": lambda: decode(path), "reading (lipmetrics)": read}
    works |= {f"measure, {method}": lambda method=method: measure(path, method=method) for method in methods}
    times = {name: float(np.median(each[:, 1])) for name, each in in_turn_s(works, REPEATS).items()}
    base = times["decoding (PyAV)"]
    return pd.DataFrame(
        {"s": times, "times decoding": {name: each / base for name, each in times.items()}}
    ).rename_axis("1080p clip")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--methods", nargs="+", default=["default", "thesis"])
    parser.add_argument("--write", action="store_true", help="put the tables into RESULTS.md")
    options = parser.parse_args()
    if reference.reference_folder() is None:
        parser.error("expected the reference data in LIPMETRICS_REFERENCE or ../shared/reference, found none")

    one_core()
    with tempfile.TemporaryDirectory() as folder:
        large = Path(folder) / "large.mp4"
        enlarge(reference.video_file(LARGE_CLIP), large)
        clips = {"360x288": [reference.video_file(clip) for clip in SMALL_CLIPS], "1920x1080": [large]}
        text = "## Speed\n\nOne core. MediaPipe takes 3.6 ms (360x288) to 5.1 ms (1080p) per frame, dlib 11 to 188 ms\n"
        text += "(the reference data's account, another machine).\n\n### Finding and measuring, decoding left out\n\n"
        text += markdown(find_and_measure(options.methods, clips))
        rate = 8 * large.stat().st_size / 1e6 / LARGE_CLIP_S
        text += f"\n### The whole of `measure` against decoding ({LARGE_CLIP_S} s of 1080p at {rate:.1f} Mbit/s)\n\n"
        text += markdown(measure_against_decoding(options.methods, large))
    print(text)
    if options.write:
        write_section("speed", text)


if __name__ == "__main__":
    sys.exit(main())
