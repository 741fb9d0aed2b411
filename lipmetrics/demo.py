"""`lipmetrics demo`: a sticky mouth is simulated, its video measured like any other, and the difference reported.

What simulates is handed over by the command line, as this package knows nothing of the simulator. While it is at work
another process measures a drawn mouth, which compiles the detector: a first run spends most of its time on compiling,
and one process compiles on one core only.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from lipmetrics.accuracy import compare, describe, load_truth
from lipmetrics.atomic import whole_file
from lipmetrics.demo_page import Simulated, write_moments, write_page, write_plot
from lipmetrics.profile import without_nan

LONGEST_WAIT_S = 300.0  # for the other process; then the detector is compiled here


def demo(
    folder: Path,
    simulate: Callable[[Path], Simulated],
    *,
    method: str = "default",
    progress: bool = False,
    rehearsal: str = "lipmetrics.demo:rehearse",
    side_by_side: bool | None = None,
) -> dict:
    """Simulate a clip, measure its video, compare with its truth; everything is written into `folder`.

    Parameters
    ----------
    simulate : writes a clip and its truth into a folder
    method : as in `lipmetrics.measure`
    rehearsal : "module:function" that compiles what comes after the simulation; it is called with the method
    side_by_side : rehearse in another process during the simulation; None does so with two cores or more

    Returns
    -------
    the comparison of `lipmetrics.accuracy.compare`, `seconds` of each work, names of the `files`, and lines of `text`

    Raises InputError if `folder` cannot be written to or the clip cannot be simulated
    """
    started = time.perf_counter()
    with rehearsing(rehearsal, method, _cores() > 1 if side_by_side is None else side_by_side) as rehearsed:
        simulated = simulate(folder)
        simulated_at = time.perf_counter()
        import matplotlib.figure  # noqa: F401  takes a second or two: meanwhile the other process goes on

        from lipmetrics.overlay import write_overlay
        from lipmetrics.pipeline import measure

        rehearsed()
    compiled_at = time.perf_counter()
    stem = simulated.stem
    clip, truth = folder / f"{stem}.mp4", load_truth(folder / stem)
    measured = measure(clip, method=method, keep_outlines=True, progress=progress)
    measured_at = time.perf_counter()
    tables = measured.save(folder, f"{stem}.measured")
    report = compare(measured, truth)
    overlay, moments, plot, facts, page = (
        folder / f"{stem}.{name}" for name in ("overlay.mp4", "moments.png", "report.png", "report.json", "report.html")
    )
    write_overlay(clip, measured, overlay)
    write_moments(clip, measured, truth, moments)
    write_plot(measured, truth, plot)
    with whole_file(facts) as part:
        part.write_text(json.dumps(without_nan(report), indent=2) + "\n", encoding="utf-8")
    ended = time.perf_counter()
    seconds = simulated.seconds | {
        "simulation in all": simulated_at - started,
        "waiting for the detector to be compiled": compiled_at - simulated_at,
        "measurement": measured_at - compiled_at,
        "pictures": ended - measured_at,
        "all": ended - started,
    }
    seconds = {name: round(value, 2) for name, value in seconds.items()}
    write_page(page, simulated, measured, truth, report, seconds, plot=plot, moments=moments, video=overlay)
    text = [
        *describe(report),
        f"simulated in {seconds['simulation in all']:.0f} s, measured in {seconds['measurement']:.0f} s, "
        f"{seconds['all']:.0f} s in all",
        f"open {page} in a browser; all files are in {folder}",
    ]
    files = [*simulated.files, *tables, overlay, moments, plot, facts, page]
    return report | {"seconds": seconds, "files": [str(path) for path in files], "text": text}


@contextmanager
def rehearsing(function: str, method: str, wanted: bool = True) -> Iterator[Callable[[], None]]:
    """Another process fills the cache of compiled code; what is given waits for it.

    It ends with the block, whatever happens. If it fails nothing is lost but time.
    """
    if not wanted:
        yield lambda: None
        return
    module, _, name = function.partition(":")
    code = f"import sys, {module}; {module}.{name}(sys.argv[1])"
    command = [sys.executable, "-P", "-c", code, method]
    quiet = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    other = subprocess.Popen(command, **quiet)

    def wait() -> None:
        try:
            other.wait(LONGEST_WAIT_S)
        except subprocess.TimeoutExpired:
            other.kill()

    try:
        yield wait
    finally:
        if other.poll() is None:
            other.kill()
        other.wait()


def rehearse(method: str = "default") -> None:
    """Measure a short clip of a drawn mouth, so that all that `measure` compiles is there afterwards."""
    from lipmetrics.pipeline import measure

    with TemporaryDirectory() as folder:
        clip = Path(folder) / "rehearsal.mp4"
        write_drawn_clip(clip)
        measure(clip, method=method, keep_outlines=True)
    from matplotlib import font_manager  # noqa: F401  the first import ever lists the machine's fonts


def write_drawn_clip(path: Path) -> None:
    """A drawn mouth that opens, in 6 frames of H.264."""
    import av

    from lipmetrics.artificial import Face, Shape, draw

    with whole_file(path) as part, av.open(str(part), "w", format="mp4") as target:
        stream = target.add_stream("libx264", rate=25, options={"preset": "ultrafast"})
        stream.width, stream.height, stream.pix_fmt = 260, 200, "yuv420p"
        for number, gap in enumerate((0.0, 0.0, 0.1, 0.2, 0.3, 0.3)):
            face = Face(jaw_width=2.3, shape=Shape(gap=(gap / 3, gap)))
            drawn = draw(face, (200, 260), 90.0, rng=np.random.default_rng(0), supersample=1)
            frame = av.VideoFrame.from_ndarray(drawn.picture, format="rgb24")
            frame.pts = number
            target.mux(stream.encode(frame))
        target.mux(stream.encode())


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
