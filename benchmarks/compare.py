"""How fast takes are compared. Prints the speed table of comparison in RESULTS.md.

    python benchmarks/compare.py --write

The work is synthetic: 22 families of smooth movements, 75 takes of each, 180 samples at 90 per second, 4 channels, with
shifted and stretched timing and noise. Times are this process's processor time, best of several, which other work on
the machine disturbs least; wall time is given beside it.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import numpy as np
import pandas as pd
from results import machine, markdown, write_section

from lipmetrics.compare import BAND, RECOGNITION_BAND, align, averages, dtw_path, hausdorff, pairs

FAMILIES, TAKES, SAMPLES, RATE_HZ = 22, 75, 180, 90.0
REPEATS = 3
FIRST_CALLS = """
import time
start = time.process_time()
import numpy as np
from lipmetrics.compare import align, average, hausdorff, pairs
imported = time.process_time()
curve = np.random.default_rng(0).random((50, 3)).cumsum(axis=0)
align(curve, curve[::-1], rate_hz=25)
aligned = time.process_time()
hausdorff(curve, curve[::-1], rate_hz=25)
pairs([(np.arange(50) / 25, curve)], [(np.arange(50) / 25, curve[::-1])])
average([(np.arange(50) / 25, curve)] * 2)
print(imported - start, aligned - imported, time.process_time() - aligned)
"""


def movement(family: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Times (T,) and four channels (T, 4) of one take of a family."""
    time_s = np.arange(SAMPLES) / RATE_HZ
    centre, width = 0.7 + 0.03 * family + random.normal(0, 0.08), 0.2 + 0.01 * family + random.normal(0, 0.03)
    pulse = np.exp(-2 * ((time_s - centre) / width) ** 2)
    channels = np.stack([pulse, 0.6 * pulse**2, 0.5 * pulse**1.5, np.roll(pulse, 3)], axis=1)
    return time_s, channels + random.normal(0, 0.01, channels.shape)


def timed(work: Callable[[], object], repeats: int = REPEATS) -> tuple[float, float]:
    """Least processor time and least wall time of several calls, s."""
    times = []
    for _ in range(repeats):
        cpu, wall = time.process_time(), time.perf_counter()
        work()
        times.append((time.process_time() - cpu, time.perf_counter() - wall))
    return min(cpu for cpu, _ in times), min(wall for _, wall in times)


def speed_table() -> pd.DataFrame:
    """Processor and wall time of the main comparisons."""
    random = np.random.default_rng(1)
    takes = [movement(family, random) for family in range(FAMILIES) for _ in range(TAKES)]
    references = [movement(family, random) for family in range(FAMILIES)]
    groups = {str(family): takes[family * TAKES : (family + 1) * TAKES] for family in range(FAMILIES)}
    long_a, long_b = random.normal(size=(2, 10_000, 4)).cumsum(axis=1)
    one, other = takes[0], references[5]
    work = {
        "36,300 pairs, no band, 1 thread": lambda: pairs(takes, references, band=None, threads=1),
        "36,300 pairs, no band, 2 threads": lambda: pairs(takes, references, band=None, threads=2),
        f"36,300 pairs, band {BAND}, 1 thread": lambda: pairs(takes, references, threads=1),
        f"36,300 pairs, band {BAND}, 2 threads": lambda: pairs(takes, references, threads=2),
        f"36,300 pairs, band {RECOGNITION_BAND} (recognition), 2 threads": lambda: pairs(
            takes, references, band=RECOGNITION_BAND, threads=2
        ),
        "22 averages of 75 takes, no band, 2 threads": lambda: averages(groups, band=None, threads=2),
        "22 averages of 75 takes, band 0.1, 2 threads": lambda: averages(groups, band=0.1, threads=2),
        "one pair of 10,000 samples, no band": lambda: dtw_path(long_a, long_b),
        "one pair of 10,000 samples, band 0.1": lambda: dtw_path(long_a, long_b, band=0.1),
        "align, one pair of 180 samples": lambda: align(one, other),
        "hausdorff, one pair of 180 samples, aligned": lambda: hausdorff(one, other),
    }
    rows = {}
    for name, call in work.items():
        call()
        rows[name] = timed(call, REPEATS if "one pair of 180" not in name else 50)
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["processor s", "wall s"])
    return table.rename_axis("work")


def memory_of_long_pair_mb() -> float:
    """Most memory that a path between two curves of 10,000 samples and 4 channels takes besides them, MB (Linux)."""
    code = (
        "import numpy as np\nfrom pathlib import Path\nfrom lipmetrics.compare import dtw_path\n"
        "def most():\n"
        "    lines = Path('/proc/self/status').read_text().splitlines()\n"
        "    return next(int(line.split()[1]) for line in lines if line.startswith('VmHWM')) / 1024\n"
        "a, b = np.random.default_rng(2).normal(size=(2, 10_000, 4)).cumsum(axis=1)\n"
        "dtw_path(a[:10], b[:10])\nbefore = most()\ndtw_path(a, b)\nprint(most() - before)\n"
    )
    return float(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout)


def first_call_s() -> tuple[float, float, float]:
    """Processor time of import, first align, and first use of the rest, in a new process with nothing compiled."""
    with tempfile.TemporaryDirectory() as cache:
        environment = os.environ | {"NUMBA_CACHE_DIR": cache}
        run = subprocess.run(
            [sys.executable, "-c", FIRST_CALLS], check=True, capture_output=True, text=True, env=environment
        )
    return tuple(map(float, run.stdout.split()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--write", action="store_true", help="put the table into RESULTS.md")
    options = parser.parse_args()
    text = f"## Comparison: speed\n\n{machine()} Synthetic takes of 180 samples and 4 channels;\n"
    text += f"path, alignment and Hausdorff distance of each pair; best of {REPEATS}.\n\n"
    text += markdown(speed_table(), 4)
    imported, aligned, rest = first_call_s()
    text += f"\nMemory of one pair of 10,000 samples: {memory_of_long_pair_mb():.0f} MB besides the curves.\n"
    text += (
        f"With nothing compiled: import {imported:.1f} s, first `align` {aligned:.1f} s, first use of `hausdorff`,\n"
    )
    text += f"`pairs` and `average` {rest:.1f} s of processor time; once per installation.\n"
    print(text)
    if options.write:
        write_section("compare", text)


if __name__ == "__main__":
    sys.exit(main())
