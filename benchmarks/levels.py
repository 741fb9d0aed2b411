"""Whether sticky mouths behave by level as they should, seen from the videos alone, beside what is really there.

    lipmetrics simulate --corpus 5 -o corpus
    lipmetrics corpus run corpus/clips --template "{speaker}_{action}_{stickiness:d}_{repeat:d}" -o corpus/corpus.h5
    python benchmarks/levels.py corpus --write

prints for each finding of docs/validation.md ("The sticky mouth") the mean over people by level, its standard deviation
between people, how many people have all levels in the order that was found, and how many the highest on the right side
of the lowest; from the videos and from the truth. A finding that does not hold is printed like the others.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from results import markdown, write_section

from corpus_tools.average import average_groups, measures, read_takes_of
from corpus_tools.average_figures import levels_png
from corpus_tools.naming import Template
from lipmetrics.errors import InputError
from lipmetrics.take import Take

TEMPLATE = Template("{speaker}_{action}_{stickiness:d}_{repeat:d}")
WIDE_MW, END_S = 0.7, 0.1
TIED = 1e-9  # times are those of pictures, and often equal
FIGURE = Path(__file__).parents[1] / "docs" / "figures" / "corpus_slow_open.png"


def onset_s(take: Take) -> float:
    return measures(take)["onset_s"]


def widening_s(take: Take) -> float:
    """From the first open picture to a width of 0.7 mouth widths, s."""
    wide = np.flatnonzero(take.channels["width"] >= WIDE_MW)
    return float(take.time_s[wide[0]] - take.time_s[0]) - onset_s(take) if len(wide) else math.nan


def end_width(take: Take) -> float:
    """Mean width over the last 0.1 s."""
    return float(np.nanmean(take.channels["width"][take.time_s > take.time_s[-1] - END_S]))


def peak_height(take: Take) -> float:
    return measures(take)["peak_height"]


def peak_area(take: Take) -> float:
    return measures(take)["peak_area"]


def early_area(take: Take) -> float:
    """Mean area over the first half of the clip: small where an opening is late, low or narrow."""
    return float(np.nanmean(take.channels["area"][take.time_s < take.time_s[0] + np.ptp(take.time_s) / 2]))


def overshoot(take: Take) -> float:
    """Greatest height over that of the last 0.1 s, less 1."""
    end = float(np.nanmean(take.channels["height"][take.time_s > take.time_s[-1] - END_S]))
    return peak_height(take) / end - 1 if end > 0 else math.nan


def second_over_first(take: Take) -> float:
    """Greatest height after the middle closure over that before it."""
    height, time = np.nan_to_num(take.channels["height"]), take.time_s - take.time_s[0]
    middle = (time > 0.4) & (time < 1.0)
    at = time[middle][np.argmin(height[middle])]
    first = height[time < at].max()
    return float(height[time > at].max() / first) if first > 0 else math.nan


@dataclass(frozen=True)
class Finding:
    """What is said of an action: `size` goes up (1) or down (-1) with the level, or is above `least` at all (0).

    `ends_only`: levels between the lowest and the highest are not said to differ.
    """

    action: str
    says: str
    size: Callable[[Take], float]
    way: int
    least: float = 0.0
    ends_only: bool = False


FINDINGS = (
    Finding("slow-open", "later onset, s", onset_s, 1),
    Finding("slow-open", "width 0.7 later after it, s", widening_s, 1),
    Finding("slow-open", "smaller area at first, mw2", early_area, -1),
    Finding("slow-open", "narrower at the end, mw", end_width, -1, ends_only=True),
    Finding("fast-open", "later onset, s", onset_s, 1),
    Finding("fast-open", "smaller area at first, mw2", early_area, -1),
    Finding("fast-open", "narrower at the end, mw", end_width, -1, ends_only=True),
    Finding("m", "later onset, s", onset_s, 1),
    Finding("m", "less of a peak over the end", overshoot, -1),
    Finding("m", "smaller greatest area, mw2", peak_area, -1),
    Finding("p", "lower peak, mw", peak_height, -1),
    Finding("p", "less of a peak over the end", overshoot, -1),
    Finding("mummy", "smaller greatest area, mw2", peak_area, -1),
    Finding("puppy", "smaller greatest area, mw2", peak_area, -1),
    Finding("puppy", "second peak over the first, above 1", second_over_first, 0, 1.0),
)


def by_level(takes: Sequence[Take], finding: Finding) -> pd.DataFrame:
    """A row per person, a column per level: the mean over the repeats."""
    rows = [
        {**take.meta["fields"], "size": finding.size(take)}
        for take in takes
        if take.meta["fields"]["action"] == finding.action
    ]
    return pd.DataFrame(rows).pivot_table("size", "speaker", "stickiness", dropna=False)


def judged(values: pd.DataFrame, finding: Finding) -> dict[str, str]:
    """Cells of a row: mean and spread by level, people in order, people whose extremes are."""
    cells = {f"{level}": f"{column.mean():.3f} ({column.std():.3f})" for level, column in values.items()}
    if finding.way == 0:
        holds = int((values > finding.least).all(axis=1).sum())
        return cells | {"means": _yes((values.mean() > finding.least).all()), "all levels": f"{holds} of {len(values)}"}
    steps = finding.way * np.diff(values.to_numpy(), axis=1)
    ends = finding.way * (values.iloc[:, -1] - values.iloc[:, 0])
    of = f" of {len(values)}"
    cells["ends"] = f"{int((ends > TIED).sum())}{of}"
    if finding.ends_only:
        return cells | {"means": _yes(ends.mean() > TIED)}
    means = finding.way * np.diff(values.mean())
    return cells | {
        "means": _yes((means > TIED).all()),
        "all levels": f"{int((steps > TIED).all(axis=1).sum())}{of}",
        "none against": f"{int((steps > -TIED).all(axis=1).sum())}{of}",
    }


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def curve_errors(videos: Sequence[Take], truths: Sequence[Take]) -> pd.DataFrame:
    """Mean absolute difference of the groups' average curves, over the greatest value of the truth, %."""
    seen, real = (
        {tuple(one.fields.values()): one.average for one in average_groups(takes, ["action", "stickiness"])}
        for takes in (videos, truths)
    )
    rows = {}
    for (action, level), truth in real.items():
        found = seen[action, level]
        row = rows.setdefault(action, {})
        for c, channel in enumerate(truth.channels):
            at = np.interp(truth.time_s, found.time_s, found.mean[:, c])
            row.setdefault(channel, []).append(100 * np.abs(at - truth.mean[:, c]).mean() / truth.mean[:, c].max())
    return pd.DataFrame({action: {c: np.mean(v) for c, v in row.items()} for action, row in rows.items()}).T


def report(folder: Path) -> str:
    """The section of RESULTS.md."""
    left_out: list[str] = []
    videos = read_takes_of(folder / "corpus.h5", on_misfit=lambda name, why: left_out.append(f"{name}: {why}"))
    truths = read_takes_of(folder / "truth", TEMPLATE)
    tables = {"from the videos": videos, "from the truth": truths}
    text = (
        f"## Levels of stickiness in a simulated corpus\n\n{len(videos)} videos, {len(truths)} clips. Mean over people "
        "(standard deviation between people) by level. `means`: whether these are in order; `all levels`: people with "
        "all levels in order; `none against`: the same, equal ones allowed (times are those of pictures, 1/60 s "
        "apart); `ends`: people whose highest level lies on the right side of the lowest.\n"
    )
    for name, takes in tables.items():
        rows = {f"{one.action}: {one.says}": judged(by_level(takes, one), one) for one in FINDINGS}
        table = pd.DataFrame.from_dict(rows, orient="index").fillna("-")
        table.index.name = name
        text += "\n" + markdown(table)
    errors = curve_errors(videos, truths)
    errors.index.name = "average curves, mean difference from the truth's, % of their greatest value"
    text += "\n" + markdown(errors, 1)
    if left_out:
        text += f"\nNot averaged: {'; '.join(left_out)}.\n"
    return text


def draw(folder: Path) -> None:
    """The averages of the slow opening by level, from the videos above those of the truth."""
    pictures = []
    for what, takes in (("videos", read_takes_of(folder / "corpus.h5", on_misfit=lambda *_: None)), ("truth", None)):
        takes = read_takes_of(folder / "truth", TEMPLATE) if takes is None else takes
        takes = [take for take in takes if take.meta["fields"]["action"] == "slow-open"]
        curves = {
            f"stickiness {group.fields['stickiness']}": (group.average, group.average.spread)
            for group in average_groups(takes, ["action", "stickiness"])
        }
        png = levels_png(curves, f"slow opening, mean and spread over people, from the {what}")
        pictures.append(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR))
    cv2.imwrite(str(FIGURE), np.vstack(pictures), [cv2.IMWRITE_PNG_COMPRESSION, 9])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="of `lipmetrics simulate --corpus`, with corpus.h5 of its clips")
    parser.add_argument("--write", action="store_true", help="into RESULTS.md")
    arguments = parser.parse_args()
    try:
        text = report(arguments.folder)
        if arguments.write:
            draw(arguments.folder)
    except InputError as error:
        parser.error(str(error))
    print(text)
    if arguments.write:
        write_section("levels", text)


if __name__ == "__main__":
    main()
