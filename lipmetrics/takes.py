"""Reading takes: profiles, simulated clips, videos, mesh sequences and landmark tables, told apart by their content."""

from __future__ import annotations

import glob
import math
from collections.abc import Sequence
from contextlib import contextmanager
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path

import numpy as np
import pandas as pd

from lipmetrics.endings import PICTURE_ENDINGS, VIDEO_ENDINGS
from lipmetrics.errors import InputError
from lipmetrics.profile import FRAMES, META, OPENINGS, Profile, load_profile
from lipmetrics.take import CHANNELS, OPENING_COLUMNS, SOURCES, UNITS, Take, same_unit, unknown

__all__ = [
    "CHANNELS",
    "OPENING_COLUMNS",
    "SOURCES",
    "UNITS",
    "Take",
    "profiles_in",
    "read_take",
    "read_takes",
    "same_unit",
    "take_of_profile",
    "take_paths",
]
_METRES = ".metres"


def read_take(
    path: str | Path,
    *,
    unit: str = "mw",
    fps: float | None = None,
    lip_loop=None,
    mouth_width: float | None = None,
    work_folder: str | Path | None = None,
    video: bool = False,
    name: str | None = None,
    method: str = "default",
    mesh=None,
    corners: Sequence[int] | None = None,
    metres_per_unit: float | None = None,
    closed_below_mw: float | None = None,
    picture_size: tuple[float, float] | None = None,
    progress: bool = False,
) -> Take:
    """Read one take. What it is is told from its content.

    Parameters
    ----------
    path : a profile (`<stem>`, one of its files, or a folder with one profile); a table with `time_s`, `width_px`,
        `height_px` and `area_px` (or `_mw`, `_mw2`); the folder of a simulated clip; a video, or a folder or pattern of
        pictures; a folder or pattern of OBJ files or a `.npy` array (T, V, 3); or a table of landmarks
    unit : `mw`, mouth widths; `px` of a picture; `m` of a simulated clip's truth or of a mesh with `metres_per_unit`;
        `model` of a mesh
    fps : frames per second, for meshes, and for landmarks and pictures without times; never used where there are times
    lip_loop, corners : of a mesh, see `lipmetrics.meshes.read_loop`
    mouth_width : at rest, in px or the unit of the mesh; None takes the one that is found
    work_folder : profiles of videos are kept here and found again by the video's SHA-256 and all settings
    video : measure the video of a simulated clip instead of reading its truth
    name : of the take; None takes the file's
    method : of measuring a video
    mesh : a `lipmetrics.meshes.MeshSettings`
    closed_below_mw, picture_size : of landmarks, see `lipmetrics.landmark_tables.read_landmarks`
    progress : show a progress bar while a video is measured

    Raises
    ------
    InputError : nothing of this kind at `path`, a broken file, or a unit that cannot be had
    """
    if unit not in UNITS:
        raise InputError(unknown("unit", unit, UNITS))
    for what, value in (("mouth width", mouth_width), ("frame rate", fps), ("length of a unit", metres_per_unit)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(f"expected a {what} above 0, got {value}")
    path = Path(path)
    kind = _kind(path)
    if kind == "profile":
        base = _profile_base(path)
        if not video:
            return _read_profile(base, unit, mouth_width, name)
        path = _video_of_clip(base)
        kind = "video"
    elif video and kind != "video":
        raise InputError(f"expected a video or a simulated clip with one at {path}, found a {kind}")
    if kind == "table of sizes":
        return _read_sizes(path, unit, mouth_width, name)
    if kind == "mesh":
        return _read_mesh(path, unit, fps, lip_loop, corners, mouth_width, metres_per_unit, mesh, name)
    if kind == "table of landmarks":
        return _read_landmarks(path, unit, fps, mouth_width, closed_below_mw, picture_size, name)
    return _read_video(path, unit, fps, mouth_width, work_folder, method, name, progress)


def read_takes(paths: str | Path | Sequence[str | Path], **settings) -> list[Take]:
    """Read several takes; a folder that holds several stands for all of them, in order of name.

    Parameters
    ----------
    paths : as in `read_take`
    settings : as in `read_take`, the same for all

    Raises
    ------
    InputError : as in `read_take`, or no takes
    """
    given = [paths] if isinstance(paths, str | Path) else list(paths)
    every = list(dict.fromkeys(one for path in given for one in take_paths(path)))
    if not every:
        raise InputError("expected one take or more, got none")
    if settings.get("name") is not None and len(every) > 1:
        raise InputError(f"expected no name for {len(every)} takes, got '{settings['name']}'; each has its file's")
    takes = [read_take(path, **settings) for path in every]
    names = [take.name for take in takes]
    for k, (take, path) in enumerate(zip(takes, every, strict=True)):
        if names.count(take.name) > 1:
            folder = path.resolve().parent.name
            takes[k] = replace(take, name=f"{folder}/{take.name}" if folder else take.name)
    seen: dict[str, int] = {}
    for k, take in enumerate(takes):
        seen[take.name] = seen.get(take.name, 0) + 1
        if seen[take.name] > 1:
            takes[k] = replace(take, name=f"{take.name} ({seen[take.name]})")
    return takes


def take_paths(path: str | Path) -> list[Path]:
    """The takes that a path names: those of a folder in order of name, everything else as it stands.

    The first of these that a folder has counts: profiles; OBJ files, which are one take; videos; tables; arrays;
    pictures, which are one take; the folders in it.
    """
    path = Path(path)
    if not path.is_dir():
        return [path]
    if tables := profiles_in(path):
        return tables
    if any(path.glob("[!.]*.obj")):
        return [path]
    inside = sorted(one for one in path.iterdir() if not one.name.startswith("."))
    files = [one for one in inside if one.is_file()]
    for endings in (VIDEO_ENDINGS, {".csv"}, {".npy"}):
        if found := [file for file in files if file.suffix.lower() in endings]:
            return found
    folders = [one for one in inside if one.is_dir()]
    if not folders or any(file.suffix.lower() in PICTURE_ENDINGS for file in files):
        return [path]
    return [one for folder in folders for one in take_paths(folder)]


def _kind(path: Path) -> str:
    """`profile`, `table of sizes`, `table of landmarks`, `mesh` or `video`, by what is in the file or the folder."""
    if glob.has_magic(str(path)) and not path.exists():
        return "mesh" if path.suffix.lower() == ".obj" else "video"
    if _profile_base(path) is not None:
        return "profile"
    if path.is_dir():
        if any(path.glob("[!.]*.obj")):
            return "mesh"
        inside = take_paths(path)
        if inside != [path]:
            some = ", ".join(one.name for one in inside[:3])
            raise InputError(
                f"expected one take in {path}, found a folder with {len(inside)} ({some}); name one of them"
            )
        return "video"
    if not path.is_file():
        raise InputError(_missing(path))
    with _reading(path), path.open("rb") as file:
        head = file.read(4096)
    if not head:
        raise InputError(f"expected a take in {path}, found an empty file")
    if head.startswith(b"\x93NUMPY") or path.suffix.lower() in (".npy", ".obj"):
        return "mesh"
    columns = _header(head, path.suffix.lower() == ".csv")
    if columns is not None:
        return _kind_of_table(path, columns)
    return "video"


def _kind_of_table(path: Path, columns: list[str]) -> str:
    from lipmetrics.landmark_tables import is_landmark_table

    if is_landmark_table(columns):
        return "table of landmarks"
    if "time_s" in columns and any({f"width_{u}", f"height_{u}"} <= set(columns) for u in ("mw", "px")):
        return "table of sizes"
    raise InputError(
        f"expected {path} to be a profile's table (time_s, width_mw, height_mw, area_mw2, or in px) or one of "
        f"landmarks (x_60, y_60 and so on), found the columns {', '.join(columns[:6])}{' ...' * (len(columns) > 6)}"
    )


def _header(head: bytes, named: bool) -> list[str] | None:
    """Names of the columns if a file that begins so is a table: text whose first line has commas, or named so."""
    try:
        line = head.decode("utf-8-sig", errors="strict" if len(head) < 4096 else "ignore").splitlines()[0]
    except (UnicodeDecodeError, IndexError):
        return None
    columns = [column.strip().strip('"') for column in line.split(",")]
    return columns if (named or len(columns) > 1) and line.isprintable() and b"\0" not in head else None


def _missing(path: Path) -> str:
    there = path.parent if path.parent.is_dir() else None
    names = sorted(one.name for one in there.iterdir()) if there else []
    near = get_close_matches(path.name, names, n=1)
    hint = f"; did you mean {near[0]}?" if near else "; check the path"
    return (
        f"expected a profile, a simulated clip, a video, a mesh sequence or a table of landmarks, found no {path}{hint}"
    )


@contextmanager
def _reading(path: Path):
    try:
        yield
    except OSError as error:
        raise InputError(f"expected to read {path}, but: {error.strerror or error}") from None


def _read_sizes(path: Path, unit: str, mouth_width: float | None, name: str | None) -> Take:
    """A table of sizes over time without openings and provenance, in mouth widths or px."""
    table = _read_csv(path)
    name = name or path.name.removesuffix(".csv").removesuffix(".frames")
    has = {
        u: {"width": f"width_{u}", "height": f"height_{u}", "area": f"area_{u}{'2' * (u == 'mw')}"}
        for u in ("mw", "px")
    }
    if unit not in has:
        raise InputError(f"{name}: expected the unit mw or px for a table of sizes, got '{unit}'")
    complete = {u for u, columns in has.items() if set(columns.values()) <= set(table.columns)}
    scale, table_unit = 1.0, unit
    if unit == "mw" and (mouth_width is not None or "mw" not in complete) and "px" in complete:
        if mouth_width is None:
            raise InputError(
                f"{name}: expected a mouth width in px for a table in px, got none; give it, or read it in px"
            )
        scale, table_unit = mouth_width, "px"
    elif unit not in complete:
        missing = [column for column in has[unit].values() if column not in table.columns]
        raise InputError(f"{name}: expected the columns of a take in {unit} in {path}, missing {', '.join(missing)}")
    columns = {channel: (column, 1 + (channel == "area")) for channel, column in has[table_unit].items()}
    columns |= {"n_openings": ("n_openings", 0), "total_area": ("total_area_px", 2)}
    if table_unit == "mw":
        del columns["total_area"]
    channels = {
        channel: _floats(table[column], path) / scale**power
        for channel, (column, power) in columns.items()
        if column in table.columns
    }
    meta = {"file": path.name, "mouth_width": scale if scale != 1 else math.nan, "mouth_width_unit": "px"}
    meta["mouth_width_found"] = "given" if scale != 1 else "unknown: the table says nothing of it"
    return Take(name, _floats(table["time_s"], path), channels, unit, None, "profile", meta)


def _floats(values: pd.Series, path: Path) -> np.ndarray:
    try:
        return values.to_numpy(float, na_value=math.nan)
    except (ValueError, TypeError):
        raise InputError(f"expected numbers in the column '{values.name}' of {path}, found text") from None


def _read_mesh(path, unit, fps, lip_loop, corners, mouth_width, metres_per_unit, settings, name) -> Take:
    from lipmetrics.meshes import measure_loop, read_loop, read_points

    name = name or (path.parent.resolve().name if glob.has_magic(path.name) else path.stem)
    if unit == "px":
        raise InputError(f"{name}: expected the unit mw, model or m for a mesh, got 'px'; no picture is made of it")
    if unit == "m" and metres_per_unit is None:
        raise InputError(
            f"{name}: expected the length of a unit of the mesh in m, got none; give it, or take unit 'model'"
        )
    if lip_loop is None:
        raise InputError(
            f"{name}: expected the vertices of the inner lips to measure a mesh, got none; give the lip loop (a file "
            "with their numbers in order)"
        )
    if fps is None:
        raise InputError(f"{name}: expected the frame rate of a mesh sequence, got none; its files hold no times")
    loop = read_loop(lip_loop, corners)
    points = read_points(path, loop.vertices)
    with _named(name):
        measured = measure_loop(points, loop, np.arange(len(points)) / fps, settings, mouth_width)
    factor = {"mw": 1 / measured.mouth_width, "model": 1.0, "m": metres_per_unit}[unit]
    meta = {"file": path.name, "mouth_width": measured.mouth_width, "mouth_width_unit": "model"}
    meta |= {"mouth_width_found": measured.mouth_width_found, "origin": "middle between the corners at rest"}
    meta |= {"fps": fps, "mesh": measured.facts}
    channels, openings = _scaled(measured.channels, measured.openings, factor)
    return Take(name, np.arange(len(points)) / fps, channels, unit, openings, "mesh", meta)


def _read_landmarks(path, unit, fps, mouth_width, closed_below_mw, picture_size, name) -> Take:
    from lipmetrics.landmark_tables import CLOSED_BELOW_MW, read_landmarks

    name = name or path.stem
    if unit not in ("mw", "px"):
        raise InputError(f"{name}: expected the unit mw or px for landmarks, got '{unit}'")
    measured = read_landmarks(
        path,
        fps=fps,
        mouth_width=mouth_width,
        closed_below_mw=CLOSED_BELOW_MW if closed_below_mw is None else closed_below_mw,
        picture_size=picture_size,
    )
    if unit == "mw" and not math.isfinite(measured.mouth_width):
        raise InputError(
            f"{name}: expected the mouth's corners among the landmarks, but the table has the inner lips alone; give "
            "the width of the mouth at rest in px, or read the take in px"
        )
    factor = 1 / measured.mouth_width if unit == "mw" else 1.0
    meta = {"file": path.name, "mouth_width": measured.mouth_width, "mouth_width_unit": "px"}
    meta |= {"mouth_width_found": measured.mouth_width_found, "origin": "middle of the corners at rest"}
    meta |= {"landmarks": measured.facts}
    channels, openings = _scaled(measured.channels, measured.openings, factor)
    return Take(name, measured.time_s, channels, unit, openings, measured.source, meta)


def _scaled(channels: dict, openings: pd.DataFrame, factor: float) -> tuple[dict, pd.DataFrame]:
    """The same in another unit: lengths times `factor`."""
    power = {"n_openings": 0, "area": 2, "total_area": 2}
    scaled = {name: values * factor ** power.get(name, 1) for name, values in channels.items()}
    lengths = ["left", "right", "top", "bottom", "width", "height", "x", "y"]
    table = openings.copy()
    table[lengths] *= factor
    table["area"] *= factor**2
    return scaled, table


@contextmanager
def _named(name: str):
    """Say whose fault it is."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def _read_video(path, unit, fps, mouth_width, work_folder, method, name, progress) -> Take:
    if unit not in ("mw", "px"):
        raise InputError(f"{path.name}: expected the unit mw or px for a video, got '{unit}'")
    from lipmetrics.kept import measured_profile

    if path.is_file():
        fps = None  # it has its own times
    profile = measured_profile(path, work_folder, fps=fps, method=method, progress=progress)
    name = name or (path.resolve().name if path.is_dir() else path.stem)
    return take_of_profile(profile, name, unit=unit, mouth_width=mouth_width, source="video")


def _video_of_clip(base: Path) -> Path:
    for ending in sorted(VIDEO_ENDINGS, key=lambda one: (one != ".mp4", one)):
        if Path(f"{base}{ending}").is_file():
            return Path(f"{base}{ending}")
    raise InputError(f"expected the clip's video {base}.mp4 beside its tables, found none; simulate it with pictures")


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
    except (OSError, ValueError, OverflowError) as error:
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
    both = ((frames, ["frame", "time_s", *(c for c, _ in columns.values())]), (openings, wanted))
    for table, needs in both:
        missing = [column for column in needs if column not in table.columns]
        if missing:
            raise InputError(f"{name}: expected a profile's tables, missing the columns {', '.join(missing)}")
    frames, openings = (_with_numbers(table, [c for c in needs if c in table.columns], name) for table, needs in both)
    openings = openings.reindex(columns=list(dict.fromkeys([*openings.columns, "event", "parents"])))
    counted = openings["frame"].value_counts().reindex(frames["frame"], fill_value=0).to_numpy()
    if counted.sum() != len(openings) or (counted != frames["n_openings"].to_numpy(float, na_value=0)).any():
        raise InputError(
            f"{name}: expected as many rows of openings as its frames have openings, got others; is a table cut "
            "short or of another measurement?"
        )
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


def _with_numbers(table: pd.DataFrame, columns: list[str], name: str) -> pd.DataFrame:
    """The table, if there are numbers in these columns."""
    for column in columns:
        if table[column].dtype.kind not in "fiu":
            raise InputError(f"{name}: expected numbers in the column '{column}' of its tables, found text")
    return table


def _origin(openings: pd.DataFrame, ends: list[str], meta: dict, table_unit: str) -> tuple[float, float, str]:
    """Column and row of the middle of the mouth in the table's unit, and how it was found."""
    if table_unit == "m":
        return 0.0, 0.0, "middle of the closed lips"
    try:
        corners = np.array(meta.get("corners_px") or [], float)
    except (TypeError, ValueError, OverflowError):
        corners = np.empty(0)
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
