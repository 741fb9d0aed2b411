"""Two takes set against one another: all numbers of the pair, its figures, and the page that holds both."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from html import escape
from pathlib import Path

from lipmetrics.atomic import whole_file
from lipmetrics.compare import BAND, COST, Alignment, Region, align, carry, compare_gradients, hausdorff, propose_phases
from lipmetrics.compare.distances import SECONDS_PER_UNIT
from lipmetrics.curve_figures import FIRST, SECOND, Group, aligned_png, path_png, profiles_png, regions_png
from lipmetrics.errors import InputError
from lipmetrics.html_page import number, picture, table, write_page
from lipmetrics.measuring import GROUPS, ZERO, Measure, all_measures, formula_of, label_of, unit_of
from lipmetrics.profile import without_nan
from lipmetrics.take import CHANNELS, Take, same_unit

FORMAT = "lipmetrics comparison 1"


@dataclass
class Comparison:
    """Two takes and all that was found.

    pair : metric -> its value for the two
    first_values, second_values : metric -> its value for one of them
    regions, carried : phases of the first, and where the path carries them in the second; empty without movement
    gradients : records of `compare_gradients`
    notes : what limits the numbers
    """

    first: Take
    second: Take
    unit: str
    measures: tuple[Measure, ...]
    match: Alignment
    pair: dict[str, float]
    first_values: dict[str, float]
    second_values: dict[str, float]
    hausdorff: dict
    regions: tuple[Region, ...]
    carried: tuple[Region, ...]
    gradients: list[dict]
    channels: tuple[str, ...]
    notes: list[str]


def compare_takes(
    first: Take,
    second: Take,
    *,
    channels: Sequence[str] = CHANNELS,
    cost: str = COST,
    band: float | None = BAND,
    rate_hz: float | None = None,
    mixed_units: bool = False,
) -> Comparison:
    """Compare two takes; the first one is the reference, "later" means that the second one is.

    Raises
    ------
    InputError : takes that cannot be aligned, or in different units
    """
    unit = same_unit([first, second], allow_mixed=mixed_units)
    settings = {"cost": cost, "band": band, "rate_hz": rate_hz, "mixed_units": mixed_units}
    measuring = all_measures(channels=channels, **settings)
    match = align(first, second, **settings)
    notes = []
    if mixed_units and first.unit != second.unit:
        notes.append(f"Mixed units were allowed: {first.unit} is compared with {second.unit} as if they were one.")
    try:
        regions = propose_phases(first)
        carried = carry(regions, match)
        gradients = compare_gradients(regions, match).to_dict("records")
    except InputError as error:
        regions = carried = ()
        gradients = []
        notes.append(f"No phases: {error}.")
    if match.at_band > 0.1:
        notes.append(
            f"{100 * match.at_band:.0f} % of the path is at the edge of the band: a wider --band may move it farther."
        )
    for take in (first, second):
        if take.openings is None:
            notes.append(f"{take.name} has no table of openings, so nothing is said of how its lips part.")
    return Comparison(
        *(first, second, unit, measuring.measures, match, dict(measuring.pair(first, second))),
        *(dict(measuring.take(first)), dict(measuring.take(second)), asdict(hausdorff(first, second, **settings))),
        *(regions, carried, gradients, tuple(channels), notes),
    )


def write_comparison(found: Comparison, folder: str | Path) -> list[Path]:
    """Write compare.json and compare.html; the same takes give the same bytes.

    Raises InputError if `folder` cannot be written to.
    """
    folder = Path(folder)
    text = json.dumps(without_nan(_rounded(as_record(found))), indent=1, ensure_ascii=False, allow_nan=False)
    with whole_file(folder / "compare.json") as part:
        part.write_text(text + "\n", encoding="utf-8", newline="\n")
    write_page(folder / "compare.html", f"{found.first.name} and {found.second.name}", _body(found))
    return [folder / "compare.json", folder / "compare.html"]


def as_record(found: Comparison) -> dict:
    """A comparison as plain values for JSON."""
    match = found.match
    return {
        "format": FORMAT,
        "first": _take(found.first),
        "second": _take(found.second),
        "unit": found.unit,
        "settings": {
            **{"channels": list(found.channels), "cost": match.cost, "band": match.band, "rate_hz": match.rate_hz},
            **{"seconds_per_unit": SECONDS_PER_UNIT, "clock": match.clock},
        },
        "alignment": {
            **{"distance": match.distance, "per_step": match.per_step, "lag_s": match.lag_s},
            **{"lag_low_s": match.lag_low_s, "lag_high_s": match.lag_high_s, "warp": match.warp},
            **{"hold_s": match.hold_s, "stretch": match.stretch, "at_band": match.at_band},
        },
        "hausdorff": found.hausdorff,
        "pair": {one.name: found.pair.get(one.name, math.nan) for one in found.measures if one.of_pair},
        "first_take": {one.name: found.first_values.get(one.name, math.nan) for one in _single(found)},
        "second_take": {one.name: found.second_values.get(one.name, math.nan) for one in _single(found)},
        "regions": [asdict(region) for region in found.regions],
        "regions_carried": [asdict(region) for region in found.carried],
        "gradients": found.gradients,
        "notes": found.notes,
    }


def in_short(found: Comparison) -> list[str]:
    """The comparison in sentences."""
    pair, match = found.pair, found.match
    late = "later" if match.lag_s >= 0 else "earlier"
    lines = [
        f"{found.second.name} against {found.first.name}, lengths in {found.unit}.",
        f"{found.second.name} is {abs(1000 * match.lag_s):.0f} ms {late}; one of the two stands still in "
        f"{100 * match.warp:.0f} % of the path's steps.",
    ]
    for channel in found.channels:
        values = [f"{word} {number(pair[f'{name}_{channel}_v1'])}" for name, word in _SHORT]
        lines.append(f"{channel}: {', '.join(values)}.")
    counts = [values.get("most_openings_v1", math.nan) for values in (found.first_values, found.second_values)]
    if all(map(math.isfinite, counts)):
        lines.append(f"At most {counts[0]:.0f} and {counts[1]:.0f} openings at once.")
    return lines + found.notes


_SHORT = (("l2", "L2"), ("l2_aligned", "L2 aligned"), ("dtw", "DTW"), ("hausdorff", "Hausdorff"))


def _body(found: Comparison) -> str:
    first, second = found.first, found.second
    groups = [Group(first.name, [first], FIRST, 2.0), Group(second.name, [second], SECOND, 1.5)]
    phases = ""
    if found.regions:
        figure = picture(regions_png(found.match, found.regions, found.carried, "height"), "Phases of both takes")
        phases = f"<h2>Phases</h2>{figure}{_gradients(found)}"
    items = "".join(f"<li>{escape(line)}</li>" for line in in_short(found))
    return f"""
<h1>{escape(first.name)} and {escape(second.name)}</h1>
<ul>{items}</ul>
<h2>Over time</h2>
{picture(profiles_png(groups, found.channels), "Curves of both takes")}
<h2>Alignment</h2>
{picture(path_png(found.match), "The path between both")}
{picture(aligned_png(found.match), "Both, as they are and aligned")}
<p class="note">Aligned by dynamic time warping on width, height and area together. Alignment forgives lateness: read
what comes after it together with lag and warp.</p>
{phases}
<h2>All numbers</h2>
{_numbers(found)}
<p class="note">{escape(first.name)}: {_origin(first)} {escape(second.name)}: {_origin(second)}</p>
"""


def _numbers(found: Comparison) -> str:
    parts = []
    for family in GROUPS:
        measures = [one for one in found.measures if one.family == family]
        rows = []
        for one in measures:
            if one.of_pair:
                sign = "+" if one.better == ZERO and found.pair.get(one.name, 0) > 0 else ""
                cells = [sign + number(found.pair.get(one.name, math.nan))]
            else:
                a, b = (values.get(one.name, math.nan) for values in (found.first_values, found.second_values))
                cells = [number(a), number(b), f"{b - a:+.3g}" if math.isfinite(b - a) else "-"]
            rows.append([label_of(one.name), unit_of(one, found.unit), *cells, formula_of(one.name)])
        if not rows:
            continue
        of = ["value"] if measures[0].of_pair else [found.first.name, found.second.name, "difference"]
        parts.append(f"<h3>{escape(family.capitalize())}</h3>{table(rows, ['metric', 'unit', *of, 'definition'])}")
    return "".join(parts)


def _gradients(found: Comparison) -> str:
    rows = []
    for row in found.gradients:
        cells = [row["region"], row["channel"]]
        cells += [number(row[name]) for name in ("duration_s_a", "duration_s_b", "mean_slope_a", "mean_slope_b")]
        rows.append([*cells, number(row["mean_slope_ratio"])])
    a, b = found.first.name, found.second.name
    head = ["phase", "channel", f"lasts, {a} (s)", f"{b} (s)", f"slope, {a} (per s)", f"{b} (per s)", "ratio"]
    about = "Phases are proposed on the first take and carried over by the path; slopes are of least squares lines."
    return f'{table(rows, head)}<p class="note">{about}</p>'


def _single(found: Comparison) -> list[Measure]:
    return [one for one in found.measures if not one.of_pair]


def _take(take: Take) -> dict:
    known = {
        name: take.meta[name] for name in ("mouth_width", "mouth_width_unit", "mouth_width_found") if name in take.meta
    }
    frames = {"frames": len(take.time_s), "duration_s": take.duration_s}
    return {"name": take.name, "source": take.source, "unit": take.unit, **frames, **known}


def _origin(take: Take) -> str:
    facts = _take(take)
    text = f"{facts['source']}, {facts['frames']} frames in {facts['duration_s']:.2f} s"
    if math.isfinite(facts.get("mouth_width") or math.nan):
        text += f", mouth width {facts['mouth_width']:.4g} {facts['mouth_width_unit']} ({facts['mouth_width_found']})"
    return escape(text) + "."


def _rounded(value):
    """Nine significant digits: those after differ from machine to machine."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    return float(f"{value:.9g}") if isinstance(value, float) else value
