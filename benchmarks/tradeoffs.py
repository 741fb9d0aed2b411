"""Run time against error, from which the defaults are chosen: one figure each for detector, simulator and comparison.

    python benchmarks/tradeoffs.py --write                        # all of it, and the sections of RESULTS.md
    python benchmarks/tradeoffs.py --part detector comparison     # some of it: printed and drawn, not written

What is compared stands in tradeoffs_detector.py, tradeoffs_simulator.py and tradeoffs_comparison.py, with what the
errors are of. Times are processor times on one core, settings taken in turn and the best of several runs, and as
multiples of the default's. Figures are docs/figures/tradeoff_*.png, the defaults in red.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable

import tradeoffs_comparison
import tradeoffs_detector
import tradeoffs_simulator
from results import machine, write_section
from timing import one_core

PARTS: dict[str, Callable[[int], str]] = {
    "detector": tradeoffs_detector.tables,
    "simulator": tradeoffs_simulator.tables,
    "comparison": tradeoffs_comparison.tables,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--repeats", type=int, default=3, help="of each timing")
    parser.add_argument("--write", action="store_true", help="write the parts' sections of RESULTS.md")
    options = parser.parse_args()
    if options.repeats < 1:
        parser.error(f"expected 1 repeat or more, got {options.repeats}")
    one_core()
    for name in options.part:
        began = time.perf_counter()
        command = f"`python benchmarks/tradeoffs.py --part {name} --write`"
        text = f"## Run time against error: {name}\n\n{command}. {machine()}\n\n"
        text += f"{PARTS[name](options.repeats)}"
        print(text, f"\n{name}: {time.perf_counter() - began:.0f} s", flush=True)
        if options.write:
            write_section(f"tradeoff_{name}", text)


if __name__ == "__main__":
    sys.exit(main())
