"""The average of several takes of one movement: DTW barycentre averaging, with its spread.

Petitjean, Ketterlin and Gancarski, "A global averaging method for dynamic time warping" (Pattern Recognition 44, 2011):
each take is aligned with the average, squared local cost, and every sample of the average becomes the mean of all
samples matched with it; repeated, which never raises the sum of squared costs.

Takes are aligned by shape: every channel is divided by its greatest value first. Aligned as they are, takes of
different size give an average with a spike, where all samples of the top of the larger ones meet its highest sample.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from lipmetrics.atomic import whole_file
from lipmetrics.compare.alignment import matched_mean
from lipmetrics.compare.curves import CHANNELS, Curve, even, thread_count
from lipmetrics.compare.pairs import pack
from lipmetrics.compare.warping import BAND, best_paths, check_settings, check_size
from lipmetrics.errors import InputError

FORMAT = "lipmetrics average 1"
TABLE, META = ".average.csv", ".average.json"
ITERATIONS = 10
TOLERANCE = 1e-6


@dataclass(frozen=True)
class Average:
    """The average of N takes.

    time_s : (T,) seconds from the start, even
    mean : (T, C)
    spread : (T, C) standard deviation over the takes (N - 1 in the denominator) of what each take has at that
        moment: the mean of its samples matched with it; NaN for a single take
    time_spread_s : (T,) standard deviation over the takes of when each take was there, seconds from its start: the
        timing that alignment takes out of `spread`
    unit : of lengths; areas in its square
    takes : names of the takes
    paths : of the average to each take, (L, 2) int64 each; empty after loading
    costs : summed squared cost before each iteration, and of the result; of the shapes where those were aligned
    """

    name: str
    time_s: np.ndarray
    mean: np.ndarray
    spread: np.ndarray
    time_spread_s: np.ndarray
    channels: tuple[str, ...]
    unit: str
    takes: tuple[str, ...]
    rate_hz: float
    band: float | None
    costs: tuple[float, ...]
    by_shape: bool
    paths: tuple[np.ndarray, ...] = field(default=(), repr=False)

    def as_curve(self) -> Curve:
        """The mean as a curve to compare with."""
        return Curve(self.name, self.time_s, self.mean, self.channels, self.unit)

    def save(self, folder: str | Path, stem: str) -> list[Path]:
        """Write `<stem>.average.csv` and `<stem>.average.json` into `folder`; the same average gives the same bytes.

        Raises InputError if `folder` cannot be written to.
        """
        columns = {"time_s": self.time_s}
        for at, channel in enumerate(self.channels):
            columns |= {channel: self.mean[:, at], f"{channel}_sd": self.spread[:, at]}
        columns["time_sd_s"] = self.time_spread_s
        text = io.StringIO()
        pd.DataFrame(columns).to_csv(text, index=False, float_format="%.9g", lineterminator="\n")
        meta = {"format": FORMAT, "name": self.name, "channels": list(self.channels), "unit": self.unit}
        meta |= {"rate_hz": self.rate_hz, "band": self.band, "n_takes": len(self.takes), "takes": list(self.takes)}
        meta |= {
            "method": "DTW barycentre averaging",
            "by_shape": self.by_shape,
            "cost": "squared",
            "costs": [float(cost) for cost in self.costs],
        }
        paths = [Path(folder) / (stem + TABLE), Path(folder) / (stem + META)]
        with whole_file(paths[1]) as meta_part, whole_file(paths[0]) as table_part:
            table_part.write_text(text.getvalue(), encoding="utf-8", newline="\n")
            meta_part.write_text(json.dumps(meta, indent=2, ensure_ascii=False) + "\n", encoding="utf-8", newline="\n")
        return paths


def average(
    takes: Sequence,
    *,
    channels: Sequence[str] = CHANNELS,
    rate_hz: float | None = None,
    band: float | None = BAND,
    iterations: int = ITERATIONS,
    by_shape: bool = True,
    name: str = "average",
    mixed_units: bool = False,
) -> Average:
    """Average takes of one movement.

    Times are counted from each take's first sample. Starts from the mean of the takes stretched to their median
    length; stops after `iterations`, or when the cost falls by less than a millionth.

    Parameters
    ----------
    takes : at least one, in any form `align` takes
    rate_hz : of the average; None for the highest of the takes' own
    band : see `dtw_path`
    by_shape : align what is left when each channel is divided by its greatest value; the mean is then that of what each
        take has at matched moments. Else the values themselves are aligned, and the mean is their barycentre

    Raises
    ------
    InputError : no takes, unusable takes or settings, different units
    """
    if not isinstance(iterations, (int, np.integer)) or iterations < 0:
        raise InputError(f"expected a number of iterations, 0 or more, got {iterations!r}")
    curves, rate_hz = even(takes, channels, rate_hz, mixed_units)
    _, share = check_settings("squared", band)
    lengths = [len(curve.time_s) for curve in curves]
    count = int(np.median(lengths))
    check_size(count, max(lengths), share)
    aligned = _shapes(curves) if by_shape else curves
    mean = np.mean([_stretched(curve.data, count) for curve in aligned], axis=0)
    values, at = pack(aligned)
    mean, costs, kept = _barycentre(mean, values, at, share, iterations)
    here = np.stack(
        [matched_mean(path[:, 0], curve.data[path[:, 1]], count) for curve, path in zip(curves, kept, strict=True)]
    )
    if by_shape:
        mean = here.mean(axis=0)
    when = np.stack([matched_mean(path[:, 0], path[:, 1:] / rate_hz, count)[:, 0] for path in kept])
    if len(curves) > 1:
        spread, time_spread = here.std(axis=0, ddof=1), when.std(axis=0, ddof=1)
    else:
        spread, time_spread = np.full_like(mean, np.nan), np.full(count, np.nan)
    units = sorted({curve.unit for curve in curves if curve.unit})
    return Average(
        *(name, np.arange(count) / rate_hz, mean, spread, time_spread, curves[0].channels, "+".join(units)),
        *(tuple(curve.name for curve in curves), rate_hz, band, costs, by_shape, kept),
    )


def averages(groups: Mapping[str, Sequence], *, threads: int | None = None, **settings) -> dict[str, Average]:
    """`average` of several groups {name: takes}, in threads; settings as there. The result does not depend on threads.

    Raises
    ------
    InputError : see `average`
    """
    with ThreadPoolExecutor(thread_count(threads)) as pool:
        made = pool.map(lambda item: average(item[1], name=item[0], **settings), groups.items())
        return dict(zip(groups, made, strict=True))


def load_average(path: str | Path) -> Average:
    """Read an average back, without its paths. path : either file, or their common path without an ending.

    Raises
    ------
    InputError : a file is missing or not one of ours
    """
    base = str(path).removesuffix(TABLE).removesuffix(META)
    try:
        meta = json.loads(Path(base + META).read_text(encoding="utf-8"))
        if meta["format"] != FORMAT:
            raise ValueError(meta["format"])
        table = pd.read_csv(base + TABLE)
        channels = tuple(meta["channels"])
        return Average(
            *(meta["name"], table["time_s"].to_numpy(float), table[list(channels)].to_numpy(float)),
            *(table[[f"{c}_sd" for c in channels]].to_numpy(float), table["time_sd_s"].to_numpy(float)),
            *(channels, meta["unit"], tuple(meta["takes"]), meta["rate_hz"], meta["band"], tuple(meta["costs"])),
            by_shape=meta["by_shape"],
        )
    except FileNotFoundError as error:
        raise InputError(
            f"expected an average's two files {base}{TABLE} and {META}, found no {error.filename}"
        ) from None
    except (OSError, ValueError, KeyError, TypeError, RecursionError, OverflowError) as error:
        raise InputError(f"expected an average ({FORMAT!r}) in {base}{TABLE} and {META}, got: {error}") from None


def _shapes(curves: Sequence[Curve]) -> list[Curve]:
    """The curves with every channel divided by its greatest value."""
    sizes = [curve.data.max(axis=0) for curve in curves]
    return [
        replace(curve, data=curve.data / np.where(size > 0, size, 1.0))
        for curve, size in zip(curves, sizes, strict=True)
    ]


def _barycentre(
    mean: np.ndarray, values: np.ndarray, at: np.ndarray, band: float, iterations: int
) -> tuple[np.ndarray, tuple[float, ...], tuple[np.ndarray, ...]]:
    """Average (T, C), cost before each iteration and of the result, and the result's path to each take."""
    count, costs = len(mean), []
    by_length = np.argsort(np.diff(at), kind="stable")
    back = np.argsort(by_length)
    while True:
        found = best_paths(values, at, by_length, mean, np.array([0, count]), False, True, band)
        totals, lengths, paths = (of_takes[back, 0] for of_takes in found)
        costs.append(float(totals.sum()))
        if len(costs) > iterations or (len(costs) > 1 and costs[-2] - costs[-1] <= TOLERANCE * costs[-2]):
            return (
                mean,
                tuple(costs),
                tuple(path[-n:, ::-1].astype(np.int64) for path, n in zip(paths, lengths, strict=True)),
            )
        taken = np.arange(paths.shape[1]) >= paths.shape[1] - lengths[:, None]
        places, matched = paths[..., 1][taken], (paths[..., 0] + at[:-1, None])[taken]
        mean = np.ascontiguousarray(matched_mean(places, values[matched], count))


def _stretched(values: np.ndarray, count: int) -> np.ndarray:
    """Values (T, C) on `count` samples from the first to the last."""
    if len(values) == count:
        return values
    places = np.linspace(0, len(values) - 1, count)
    return np.stack([np.interp(places, np.arange(len(values)), column) for column in values.T], axis=1)
