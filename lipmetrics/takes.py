"""A take: one recording of one movement as curves over time, whatever it was measured from.

Comparison, metrics and scores see takes only. Closed is 0, unknown is NaN; the two are never mixed. Lengths are in
mouth widths unless another unit is asked for, so that takes of different sizes can be compared; areas in its square.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from lipmetrics.errors import InputError
from lipmetrics.profile import FRAMES, META, OPENINGS, Profile, load_profile

UNITS = ("mw", "px", "m", "model")
SOURCES = ("profile", "truth", "video", "mesh", "mediapipe", "openface", "pyfeat", "dlib")
CHANNELS = ("width", "height", "area")
OPENING_COLUMNS = (
    *("time_s", "frame", "opening", "left", "right", "top", "bottom", "width", "height", "area", "x", "y"),
    *("event", "parents"),
)
_NOT_NEGATIVE = {*CHANNELS, "n_openings", "total_area"}
_COUNTS = {"n_openings"}  # held, not interpolated
_METRES = ".metres"


@dataclass(frozen=True, eq=False)
class Take:
    """One recording of one movement.

    name : what tables and figures call it
    time_s : (T,) float64, strictly increasing, presentation times in s
    channels : name -> (T,) float64; `width`, `height` and `area` of the largest opening, and where known `n_openings`
        and `total_area`; 0 closed, NaN unknown
    unit : of lengths: `mw` (mouth widths), `px`, `m` or `model` (the mesh's own); areas are in its square
    openings : columns `OPENING_COLUMNS`, one row per opening per frame, in that unit; None where they are not known.
        x to the right, y down as one looks at the face; the origin is the middle of the mouth (`meta["origin"]` says
        how it was found); `x`, `y` are the centre of the area; `event` and `parents` as in docs/data_formats.md
    source : `profile`, `truth`, `video`, `mesh`, `mediapipe`, `openface`, `pyfeat` or `dlib`
    meta : where it comes from, the mouth width in the unit of the source and how it was found

    Raises
    ------
    InputError : an array of another shape, times that do not increase, or an unknown unit or source
    """

    name: str
    time_s: np.ndarray
    channels: dict[str, np.ndarray]
    unit: str = "mw"
    openings: pd.DataFrame | None = None
    source: str = "profile"
    meta: dict = field(default_factory=dict)

    def __post_init__(self) -> None:
        time_s = np.ascontiguousarray(self.time_s, float)
        channels = {name: np.ascontiguousarray(values, float) for name, values in self.channels.items()}
        if self.unit not in UNITS:
            raise InputError(f"{self.name}: expected the unit {' or '.join(UNITS)}, got '{self.unit}'")
        if self.source not in SOURCES:
            raise InputError(f"{self.name}: expected the source {' or '.join(SOURCES)}, got '{self.source}'")
        if time_s.ndim != 1 or len(time_s) == 0:
            raise InputError(f"{self.name}: expected the times of one frame or more, got shape {time_s.shape}")
        if not np.isfinite(time_s).all():
            frame = int(np.argmin(np.isfinite(time_s)))
            raise InputError(f"{self.name}: expected a time in s for every frame, got {time_s[frame]} for no. {frame}")
        back = np.flatnonzero(np.diff(time_s) <= 0)
        if len(back):
            k = int(back[0])
            raise InputError(
                f"{self.name}: expected times that increase, got {time_s[k]:g} s and then {time_s[k + 1]:g} s at frame "
                f"no. {k + 1}; leave out frames that are there twice"
            )
        missing = [name for name in CHANNELS if name not in channels]
        if missing:
            raise InputError(f"{self.name}: expected the channels {', '.join(CHANNELS)}, missing {', '.join(missing)}")
        for name, values in channels.items():
            if values.shape != time_s.shape:
                raise InputError(
                    f"{self.name}: expected {len(time_s)} values of '{name}', one per time, got shape {values.shape}"
                )
            if name in _NOT_NEGATIVE and (np.isinf(values).any() or (values < 0).any()):
                odd = values[np.isinf(values) | (values < 0)][0]
                raise InputError(f"{self.name}: expected values of '{name}' from 0 upwards or NaN, got {odd}")
        object.__setattr__(self, "time_s", time_s)
        object.__setattr__(self, "channels", channels)

    @property
    def duration_s(self) -> float:
        """From the first to the last frame, s."""
        return float(self.time_s[-1] - self.time_s[0])

    @property
    def rate_hz(self) -> float:
        """Frames per second, of the median step; NaN for one frame."""
        return 1 / float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else math.nan

    def array(
        self,
        channels: Sequence[str] = CHANNELS,
        rate_hz: float | None = None,
        max_gap_s: float = 0.1,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Channels without unknown values, for what compares curves.

        Unknown frames between known ones are bridged linearly where the known ones are at most `max_gap_s` apart
        (numbers of openings keep the last known one). At the two ends they are left out, `max_gap_s` at most.

        Parameters
        ----------
        channels : C names
        rate_hz : samples per second, evenly from the first time on, linearly between the frames; None keeps the frames

        Returns
        -------
        time_s : (T,) float64
        values : (T, C) float64, contiguous, no NaN

        Raises
        ------
        InputError : an unknown channel, or values that are unknown for longer, with their time
        """
        channels = (channels,) if isinstance(channels, str) else tuple(channels)
        if not channels:
            raise InputError("expected one channel or more, got none")
        for name in channels:
            if name not in self.channels:
                raise InputError(f"{self.name}: {_unknown('channel', name, self.channels)}")
        if not (math.isfinite(max_gap_s) and max_gap_s >= 0):
            raise InputError(f"expected a longest gap of 0 s or more, got {max_gap_s}")
        values = np.column_stack([self.channels[name] for name in channels])
        known = np.isfinite(values)
        if not known.any(axis=0).all():
            name = channels[int(np.argmin(known.any(axis=0)))]
            raise InputError(f"{self.name}: expected '{name}' in some frame, it is unknown in all; leave this take out")
        first = int(known.argmax(axis=0).max())
        last = int(len(values) - 1 - known[::-1].argmax(axis=0).max())
        if first > last:
            raise InputError(f"{self.name}: expected a frame in which all of {', '.join(channels)} are known")
        self._check_gaps(channels, known, first, last, max_gap_s)
        time_s, values, known = self.time_s[first : last + 1], values[first : last + 1], known[first : last + 1]
        if rate_hz is None:
            target = time_s
        else:
            if not (math.isfinite(rate_hz) and rate_hz > 0):
                raise InputError(f"expected a rate above 0 per second, got {rate_hz}")
            count = math.floor((time_s[-1] - time_s[0]) * rate_hz * (1 + 1e-9) + 1e-6) + 1
            target = np.minimum(time_s[0] + np.arange(count) / rate_hz, time_s[-1])
        out = np.empty((len(target), len(channels)))
        for c, name in enumerate(channels):
            at, there = time_s[known[:, c]], values[known[:, c], c]
            if name in _COUNTS:
                out[:, c] = there[np.maximum(np.searchsorted(at, target + 1e-9, side="right") - 1, 0)]
            else:
                out[:, c] = np.interp(target, at, there)
        return target.copy(), out

    def _check_gaps(self, channels: tuple[str, ...], known: np.ndarray, first: int, last: int, max_gap_s: float):
        """Refuse unknown stretches that are too long to be bridged or, at the ends, left out."""
        limit = max_gap_s * (1 + 1e-9) + 1e-9
        for c, name in enumerate(channels):
            at = self.time_s[known[:, c]]
            bridged = np.diff(np.flatnonzero(known[:, c])) > 1
            ends = [(self.time_s[0], self.time_s[first]), (self.time_s[last], self.time_s[-1])]
            gaps = [*zip(at[:-1][bridged], at[1:][bridged], strict=True), *ends]
            for start_s, stop_s in gaps:
                if stop_s - start_s > limit:
                    raise InputError(
                        f"{self.name}: expected a known {name}, but it is unknown from {start_s:.3f} to {stop_s:.3f} "
                        f"s, longer than the {max_gap_s:g} s that are bridged; cut the take there or allow longer gaps"
                    )


def same_unit(takes: Sequence[Take], *, allow_mixed: bool = False) -> str:
    """The one unit of some takes; that of the first where mixed ones are allowed.

    Raises
    ------
    InputError : no takes, or takes in different units
    """
    if not takes:
        raise InputError("expected one take or more, got none")
    first_of = {take.unit: take.name for take in reversed(takes)}
    if len(first_of) > 1 and not allow_mixed:
        found = ", ".join(f"'{first_of[unit]}' in {unit}" for unit in UNITS if unit in first_of)
        raise InputError(
            f"expected takes in one unit, got {found}; read all of them in mouth widths, or allow mixed units"
        )
    return takes[0].unit


def read_take(
    path: str | Path,
    *,
    unit: str = "mw",
    fps: float | None = None,
    mouth_width: float | None = None,
    name: str | None = None,
) -> Take:
    """Read one take; what it is is told from its content."""
    if unit not in UNITS:
        raise InputError(_unknown("unit", unit, UNITS))
    if mouth_width is not None and not (math.isfinite(mouth_width) and mouth_width > 0):
        raise InputError(f"expected a mouth width above 0, got {mouth_width}; leave it out to have it found")
    path = Path(path)
    return _read_profile(_profile_base(path), unit, mouth_width, name)


def take_of_profile(
    profile: Profile, name: str, *, unit: str = "mw", mouth_width: float | None = None, source: str | None = None
) -> Take:
    """A measured profile, or a truth of the same columns, as a take in mouth widths or px.

    Parameters
    ----------
    mouth_width : px, of the mouth at rest; None takes the profile's own

    Raises
    ------
    InputError : a unit that a picture does not have, or mouth widths where the mouth's width is unknown
    """
    if unit not in ("mw", "px"):
        raise InputError(f"{name}: expected the unit mw or px for a profile of a video, got '{unit}'")
    width_px = float(profile.meta["mouth_width_px"]) if mouth_width is None else float(mouth_width)
    scale = 1.0
    if unit == "mw":
        if not (math.isfinite(width_px) and width_px > 0):
            raise InputError(
                f"{name}: expected a profile with a known mouth width, but it was not found in the recording; give the "
                "width of the mouth at rest in px, or read the take in px"
            )
        scale = width_px
    if source is None:
        source = "truth" if profile.meta.get("source") == "simulation" else "profile"
    how = profile.meta.get("mouth_width_found", "unknown") if mouth_width is None else "given"
    meta = {"provenance": profile.meta, "mouth_width": width_px, "mouth_width_unit": "px", "mouth_width_found": how}
    return _of_tables(profile.frames, profile.openings, "px", scale, name, unit, source, meta)


def _profile_base(path: Path) -> Path | None:
    """The common path without ending of the profile that `path` names; None if it names none."""
    base = str(path)
    for ending in (FRAMES, OPENINGS, META):
        base = base.removesuffix(ending)
    base = base.removesuffix(_METRES)
    if path.is_dir():
        tables = profiles_in(path)
        if len(tables) > 1:
            raise InputError(
                f"expected a folder with the profile of one take, found {len(tables)} in {path}, among them "
                f"{tables[0].name} and {tables[1].name}; name one of them"
            )
        return tables[0] if tables else None
    return Path(base) if Path(base + FRAMES).is_file() else None


def profiles_in(folder: Path) -> list[Path]:
    """The profiles in a folder, each by its path without ending, in order of name."""
    found = [str(path).removesuffix(FRAMES) for path in folder.glob("[!.]*" + FRAMES)]
    return [Path(base) for base in sorted(found) if not base.endswith(_METRES)]


def _read_profile(base: Path, unit: str, mouth_width: float | None, name: str | None) -> Take:
    profile = load_profile(base)
    name = name or base.name
    if len(profile.frames) == 0:
        raise InputError(f"expected one frame or more in {base}{FRAMES}, found none; measure the clip anew")
    if unit == "m":
        return _read_metres(base, profile, mouth_width, name)
    return take_of_profile(profile, name, unit=unit, mouth_width=mouth_width)


def _read_metres(base: Path, profile: Profile, mouth_width: float | None, name: str) -> Take:
    """The truth of a simulated clip in m, seen straight on from far away."""
    if profile.meta.get("source") != "simulation":
        raise InputError(f"{name}: expected the unit mw or px for a profile of a video, got 'm'; it knows no metres")
    frames, openings = (_read_csv(Path(f"{base}{_METRES}{ending}")) for ending in (FRAMES, OPENINGS))
    width_m = float(profile.meta.get("mouth_width_m") or math.nan) if mouth_width is None else float(mouth_width)
    meta = {"provenance": profile.meta, "mouth_width": width_m, "mouth_width_unit": "m"}
    meta |= {"mouth_width_found": "geometry" if mouth_width is None else "given"}
    return _of_tables(frames, openings, "m", 1.0, name, "m", "truth", meta)


def _read_csv(path: Path) -> pd.DataFrame:
    try:
        return pd.read_csv(path, keep_default_na=False, na_values=[""], dtype={"event": str, "parents": str})
    except FileNotFoundError:
        raise InputError(f"expected the table {path} beside the clip's others, found no such file") from None
    except (OSError, ValueError) as error:
        raise InputError(f"expected {path} to be a table, but: {' '.join(str(error).split())}") from None


def _of_tables(
    frames: pd.DataFrame,
    openings: pd.DataFrame,
    table_unit: str,
    scale: float,
    name: str,
    unit: str,
    source: str,
    meta: dict,
) -> Take:
    """A take of the two tables of a profile whose columns end in the unit of the table; `scale` is 1 of the take's."""
    u, square = table_unit, "2" * (table_unit == "m")
    columns = {
        **{"width": (f"width_{u}", 1), "height": (f"height_{u}", 1), "area": (f"area_{u}{square}", 2)},
        **{"n_openings": ("n_openings", 0), "total_area": (f"total_area_{u}{square}", 2)},
    }
    ends = [f"{axis}_{end}" + f"_{u}" * (u == "m") for axis in ("col", "row") for end in ("min", "max")]
    centre = [f"centroid_{axis}" + f"_{u}" * (u == "m") for axis in ("col", "row")]
    wanted = ["frame", "time_s", "opening", *ends, f"width_{u}", f"height_{u}", f"area_{u}{square}", *centre]
    for table, needs in ((frames, ["time_s", *(c for c, _ in columns.values())]), (openings, wanted)):
        missing = [column for column in needs if column not in table.columns]
        if missing:
            raise InputError(f"{name}: expected a profile's tables, missing the columns {', '.join(missing)}")
    channels = {
        channel: frames[column].to_numpy(float, na_value=np.nan) / scale**power
        for channel, (column, power) in columns.items()
    }
    x0, y0, how = _origin(openings, ends, meta["provenance"], u)
    table = pd.DataFrame(
        {
            **{
                "time_s": openings["time_s"].to_numpy(float),
                "frame": openings["frame"],
                "opening": openings["opening"],
            },
            "left": (openings[ends[0]] - x0) / scale,
            "right": (openings[ends[1]] - x0) / scale,
            "top": (openings[ends[2]] - y0) / scale,
            "bottom": (openings[ends[3]] - y0) / scale,
            "width": openings[f"width_{u}"] / scale,
            "height": openings[f"height_{u}"] / scale,
            "area": openings[f"area_{u}{square}"] / scale**2,
            "x": (openings[centre[0]] - x0) / scale,
            "y": (openings[centre[1]] - y0) / scale,
            "event": openings["event"].fillna("").astype(str),
            "parents": openings["parents"].fillna("").astype(str),
        },
        columns=list(OPENING_COLUMNS),
    )
    return Take(name, frames["time_s"].to_numpy(float), channels, unit, table, source, meta | {"origin": how})


def _origin(openings: pd.DataFrame, ends: list[str], meta: dict, table_unit: str) -> tuple[float, float, str]:
    """Column and row of the middle of the mouth in the table's unit, and how it was found."""
    if table_unit == "m":
        return 0.0, 0.0, "middle of the closed lips"
    corners = np.array(meta.get("corners_px", []), float)
    if corners.shape == (2, 2) and np.isfinite(corners).all():
        row, col = corners.mean(axis=0)
        return float(col), float(row), "middle between the corners at rest"
    if len(openings) == 0:
        return 0.0, 0.0, "unknown"
    reach = openings.groupby("frame")[ends].agg({ends[0]: "min", ends[1]: "max", ends[2]: "min", ends[3]: "max"})
    widest = reach.loc[(reach[ends[1]] - reach[ends[0]]).idxmax()]
    return (
        float(widest[ends[0]] + widest[ends[1]]) / 2,
        float(widest[ends[2]] + widest[ends[3]]) / 2,
        "middle of the openings in the widest frame",
    )


def _unknown(what: str, given: str, known) -> str:
    from difflib import get_close_matches

    near = get_close_matches(str(given), list(known), n=1)
    hint = f"; did you mean '{near[0]}'?" if near else ""
    return f"expected a {what} out of {', '.join(known)}, got '{given}'{hint}"
