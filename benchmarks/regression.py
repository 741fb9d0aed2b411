"""Has anything become slower or less accurate? A short fixed set of works against a stored table.

    python benchmarks/regression.py                  # ratios against regression.json; exit code 3 if a row is marked
    python benchmarks/regression.py --store          # write the table anew, after a change that is meant
    python benchmarks/regression.py --only detector  # rows whose name begins so
    python benchmarks/regression.py --write          # the section of RESULTS.md

Times are processor times on one core, as multiples of the time that a reference work takes on the same machine: a fixed
number of steps in compiled code, half arithmetic, half reading from all over a table that fits into the second cache
only. So tables of two machines can be compared, roughly. Works and reference are taken in turn, in several rounds over
the whole set, and the best of each counts; rows that would be marked get some rounds more. The row of measuring is
against plain decoding of the same file instead. On a machine that is busy with other things times are hardly
reproducible: store, and judge, on an idle one. Errors are the same in every run of the same code; they change a little
with compilers and libraries.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import av
import findings
import numba
import numpy as np
import pandas as pd
import tradeoffs_comparison
import tradeoffs_detector
import tradeoffs_simulator
from results import machine, markdown, write_section
from timing import one_core

from lipmetrics.atomic import whole_file
from lipmetrics.compare import average, pairs
from lipmetrics.errors import InputError
from lipmetrics.frames import open_frames
from lipmetrics.pipeline import measure
from simulator.camera import Camera
from simulator.clip import pictures
from simulator.simulate import simulate
from simulator.truth import truth
from simulator.video import write_video

STORED = Path(__file__).with_name("regression.json")
FORMAT = "lipmetrics regression 1"
SLOWER, WORSE = 1.25, 1.05  # times the stored value from which a row is marked
KINDS = {"time": SLOWER, "error": WORSE}
LEAST = {"time": 0.0, "error": 1e-3}  # smaller differences than this are none
MARKED = 3  # exit code
ROUNDS, MORE = 12, 8  # over the whole set; and over the rows that would be marked
ENOUGH_S = 0.06  # short works are done several times in a row, for about as long
REFERENCE, DECODING, MEASURING = "reference", "decoding", "detector: measure against decoding"
STEPS, TABLE = 6_000_000, 1 << 15


@dataclass(frozen=True)
class Row:
    """kind : of `KINDS`; value : multiples of the reference work's time, or an error; unit : said beside it"""

    kind: str
    value: float
    unit: str


# -- the reference work -----------------------------------------------------------------------------------------------


@numba.njit(cache=True)
def reference_work(table, steps):
    """Half arithmetic that cannot be done side by side, half reading from places all over an int64 table of 2^k."""
    value, place, total = 0.3, 1, 0
    for _ in range(steps):
        value = 3.9 * value * (1.0 - value)
        place = (place * 1103515245 + 12345) & (len(table) - 1)
        total += table[place]
    return value + total


def reference_s() -> float:
    """Processor time of the reference work, s."""
    table = np.arange(TABLE, dtype=np.int64)
    reference_work(table, 1)
    return best_s(lambda: reference_work(table, STEPS), 1)


def best_s(work: Callable[[], object], repeats: int, times: int = 1) -> float:
    """Least processor time of a work that is done `times` times in a row, s for one."""
    taken = []
    for _ in range(repeats):
        began = time.process_time()
        for _ in range(times):
            work()
        taken.append((time.process_time() - began) / times)
    return min(taken)


# -- the works --------------------------------------------------------------------------------------------------------


class Material:
    """What the works need, made when it is first asked for."""

    def __init__(self, folder: Path):
        self.folder = folder

    @cached_property
    def scene(self):
        """slow_open, seen from nearer than usual."""
        scene = findings.scene("slow_open", 7.0, "low")
        return dataclasses.replace(scene, camera=Camera(width_px=360, height_px=288))

    @cached_property
    def solved(self):
        """Mouth and motion of the scene."""
        return tradeoffs_simulator.solved(self.scene)[:2]

    @cached_property
    def clip(self) -> Path:
        """A video of the scene, with its truth beside it."""
        mouth, motion = self.solved
        times = self.scene.frame_times_s
        path = self.folder / "clip.mp4"
        truth(motion, mouth, self.scene.camera, times).save(self.folder, "clip", details=False)
        rate = self.scene.output.frame_rate
        write_video(path, pictures(self.scene, mouth, motion, times), rate, "h264", crf=18, threads=1)
        return path

    @cached_property
    def takes(self) -> list:
        """Takes of known warping."""
        return [tradeoffs_comparison.warped(number) for number in range(24)]

    def frames_s(self, method: str) -> tuple[float, float]:
        """Time of the first frame of the clip, and the mean of the others', s."""
        setting = tradeoffs_detector.Setting(method)
        taken = [seconds for _, seconds in tradeoffs_detector.timed_looks(setting, self.clip)]
        return taken[0], float(np.mean(taken[1:]))

    def decode(self) -> None:
        """Read the clip and do nothing with it."""
        with av.open(str(self.clip)) as container:
            for _ in container.decode(video=0):
                pass

    def draw(self) -> None:
        """Five pictures of the usual size."""
        mouth, motion = self.solved
        scene = dataclasses.replace(self.scene, camera=Camera())
        for _ in pictures(scene, mouth, motion, np.linspace(0.2, 0.8, 5)):
            pass

    def solve(self) -> None:
        """The scene, its mesh left out."""
        simulate(self.scene, parts=self.parts, threads=1)

    @cached_property
    def parts(self):
        """Mouth and model of the scene."""
        return self.scene.model()

    def truths(self) -> None:
        """200 of them."""
        mouth, motion = self.solved
        truth(motion, mouth, self.scene.camera, np.linspace(0, self.scene.duration_s, 200))

    def read(self) -> None:
        """The clip through the package."""
        with open_frames(self.clip) as frames:
            for frame in frames:
                frame.rgb()


def time_works(of: Material) -> dict[str, Callable[[], float]]:
    """Name -> a function that measures once: s."""

    def once(work: Callable[[], object]) -> Callable[[], float]:
        times = []

        def measured() -> float:
            if not times:
                work()  # everything is compiled
                times.append(max(1, round(ENOUGH_S / max(best_s(work, 1), 1e-6))))
            return best_s(work, 1, times[0])

        return measured

    takes = of.takes
    works = {
        "simulator: mesh and model": lambda: of.scene.model(),
        "simulator: solving slow_open, low mesh": of.solve,
        "simulator: 200 truths": of.truths,
        "simulator: 5 pictures, 512 x 512": of.draw,
        "comparison: 576 pairs, band 0.1": lambda: pairs(
            [one.a for one in takes], [one.b for one in takes], band=0.1, threads=1
        ),
        "comparison: average of 24 takes": lambda: average([one.b for one in takes]),
        "detector: reading the clip as RGB": of.read,
        DECODING: of.decode,
        MEASURING: lambda: measure(of.clip),
    }
    measured = {name: once(work) for name, work in works.items()}
    for method in ("default", "thesis"):
        for number, what in enumerate(("first frame", "a later frame")):
            name = f"detector: {method}, {what}, 360 x 288"
            measured[name] = lambda method=method, number=number: of.frames_s(method)[number]
    return measured


def in_rounds(
    works: Mapping[str, Callable[[], float]],
    rounds: int,
    best: dict[str, float],
    reference: Callable[[], float] = reference_s,
) -> None:
    """Lower the best time of each work, and of the reference before each, by measuring all of them once in a round."""
    for _ in range(rounds):
        for name, work in works.items():
            best[REFERENCE] = min(best.get(REFERENCE, math.inf), reference())
            best[name] = min(best.get(name, math.inf), work())


def time_rows(best: Mapping[str, float]) -> dict[str, Row]:
    """Best times as multiples of the reference's; that of measuring of plain decoding's."""
    rows = {}
    for name, seconds in best.items():
        if name not in (REFERENCE, DECODING):
            base = DECODING if name == MEASURING else REFERENCE
            rows[name] = Row("time", seconds / best[base], f"x {base}")
    return rows


def error_works(of: Material) -> dict[str, tuple[Callable[[], float], str]]:
    """Name -> a function that tells an error, and its unit."""

    def clip_error(column: str, method: str = "default") -> Callable[[], float]:
        def told() -> float:
            looks = [look for look, _ in tradeoffs_detector.timed_looks(tradeoffs_detector.Setting(method), of.clip)]
            return float(tradeoffs_detector.simulated_errors(of.clip, looks)[column].mean())

        return told

    def stepping() -> float:
        usual = tradeoffs_simulator.measured("slow_open", 7.0, "low", {})[0]
        exact = tradeoffs_simulator.exact("slow_open", 7.0, "low")
        return tradeoffs_simulator.worst_mean(tradeoffs_simulator.differences(usual, exact))

    def alignment(what: str) -> Callable[[], float]:
        return lambda: tradeoffs_comparison.errors_ms(of.takes, tradeoffs_comparison.BAND)[what]

    return {
        "detector: height error": (clip_error("height_percent"), "% of the mouth width"),
        "detector: 1 - IoU": (clip_error("lost_percent"), "%"),
        "detector: thesis, height error": (clip_error("height_percent", "thesis"), "% of the mouth width"),
        "simulator: error of stepping, slow_open": (stepping, "% of the mouth width"),
        "comparison: error of the matched time": (alignment("time"), "ms"),
        "comparison: error of the lag": (alignment("lag"), "ms"),
    }


def measured_rows(folder: Path, only: str, stored: Mapping[str, Row]) -> dict[str, Row]:
    """All rows whose name begins with `only`; times that would be marked are measured some more."""
    of, best = Material(folder), {}
    works = {name: work for name, work in time_works(of).items() if name.startswith(only)}
    if MEASURING in works:
        works[DECODING] = time_works(of)[DECODING]
    in_rounds(works, ROUNDS, best)
    slow = [name for name, row in time_rows(best).items() if is_marked(row, stored.get(name))]
    again = {name: works[name] for name in works if name in slow or (name == DECODING and MEASURING in slow)}
    in_rounds(again, MORE, best)
    errors = {name: (work, unit) for name, (work, unit) in error_works(of).items() if name.startswith(only)}
    return time_rows(best) | {name: Row("error", work(), unit) for name, (work, unit) in errors.items()}


# -- the table --------------------------------------------------------------------------------------------------------


def is_marked(now: Row, stored: Row | None) -> bool:
    """Whether a row is slower or worse than stored by more than its kind allows."""
    if stored is None:
        return False
    return now.value > stored.value * KINDS[now.kind] and now.value - stored.value > LEAST[now.kind]


def compared(now: Mapping[str, Row], stored: Mapping[str, Row], only: str = "") -> pd.DataFrame:
    """One row for each name in either: stored, now, ratio, and a mark; what was not stored or measured is NaN."""
    rows = {}
    for name in dict.fromkeys([*now, *(name for name in stored if name.startswith(only))]):
        one, old = now.get(name), stored.get(name)
        unit = (one or old).unit
        row = rows[name] = {"unit": unit, "stored": math.nan, "now": math.nan, "ratio": math.nan, "mark": ""}
        if old:
            row["stored"] = old.value
        if one:
            row["now"] = one.value
        if not old:
            row["mark"] = "new"
        elif not one:
            row["mark"] = "gone"
        else:
            row["ratio"] = one.value / old.value if old.value else (1.0 if not one.value else math.inf)
            if is_marked(one, old):
                more = f"> {100 * (KINDS[one.kind] - 1):.0f} %"
                row["mark"] = f"{'slower' if one.kind == 'time' else 'worse'} than stored by {more}"
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("work")


def load(path: Path) -> tuple[dict[str, Row], str]:
    """A stored table, and the machine that it is of.

    Raises
    ------
    InputError : no such file, or not a table of ours
    """
    again = f"store one with `python benchmarks/{Path(__file__).name} --store`"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"expected a stored table in {path}, but it cannot be read ({error}); {again}") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT or not isinstance(content.get("rows"), dict):
        raise InputError(f"expected {path} to hold a table with the format '{FORMAT}', got something else; {again}")
    rows = {}
    for name, row in content["rows"].items():
        try:
            rows[name] = Row(**row)
        except TypeError:
            raise InputError(
                f"expected row '{name}' of {path} to have kind, value and unit, got {row}; {again}"
            ) from None
        value, kind = rows[name].value, rows[name].kind
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if kind not in list(KINDS) or not is_number or not 0 <= value < math.inf:
            known = " or ".join(KINDS)
            got = f"kind {kind!r}, value {value!r}"
            raise InputError(f"expected row '{name}' of {path} to be {known}, of 0 or more, got {got}; {again}")
    return rows, str(content.get("machine", ""))


def store(rows: Mapping[str, Row], path: Path, about: str) -> None:
    """Write a table, whole or not at all."""
    content = {"format": FORMAT, "machine": about, "rows": {name: asdict(row) for name, row in rows.items()}}
    for row in content["rows"].values():
        row["value"] = float(f"{row['value']:.4g}")
    with whole_file(path) as part:
        part.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", action="store_true", help="write the stored table anew")
    parser.add_argument("--only", default="", help="rows whose name begins so, as detector, simulator, comparison")
    parser.add_argument("--file", type=Path, default=STORED, help="the stored table")
    parser.add_argument("--write", action="store_true", help="write the section of RESULTS.md")
    options = parser.parse_args(arguments)
    if options.only and (options.store or options.write):
        parser.error("expected the whole set for --store and --write; leave --only out")
    try:
        stored, of = ({}, "") if options.store else load(options.file)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    about = machine()
    one_core()
    with tempfile.TemporaryDirectory() as folder:
        rows = measured_rows(Path(folder), options.only, stored)
    if not rows:
        print(f"error: expected rows that begin with '{options.only}', got none", file=sys.stderr)
        return 2
    table = compared(rows, stored, options.only)
    text = f"## Regression\n\n`python benchmarks/regression.py --write`. {about}\nStored on: {of or about}\n\n"
    text += markdown(table, 3)
    print(text)
    if options.write:
        write_section("regression", text)
    if options.store:
        store(rows, options.file, about)
        return 0
    marked = table["mark"].str.contains("than stored").sum()
    print(f"{marked} of {len(table)} rows marked." if marked else "Nothing is marked.")
    return MARKED if marked else 0


if __name__ == "__main__":
    sys.exit(main())
