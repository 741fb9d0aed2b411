"""Landmark tables of other programs: the inner lips of MediaPipe, OpenFace, Py-Feat and dlib as baselines.

These have some 8 to 20 points on the inner lips and always one opening; closed lips rarely have the same points, so an
opening lower than a stated height counts as closed.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from lipmetrics.errors import InputError
from lipmetrics.look import CLOSED, NO_MOUTH, OPEN
from lipmetrics.loops import HEIGHT, as_one, stretches, tables
from lipmetrics.meshes import MEDIAPIPE_INNER
from lipmetrics.profile import resting_mouth_width

CLOSED_BELOW_MW = 0.02
_TIMES = {
    **dict.fromkeys(("time_s", "timestamp", "timestamp_s", "time", "seconds", "t", "t_s"), 1.0),
    **dict.fromkeys(("timestamp_ms", "time_ms", "t_ms"), 1e-3),
}
_MOST_LOST = 100_000  # frames in one gap
_POINT = ("landmark", "landmark_id", "landmark_index", "landmark_idx", "point", "point_id", "index", "idx", "id")
_AXIS_FIRST = re.compile(r"(?:(?:landmark|lm|point)_?)?([xy])_?(\d+)")
_NUMBER_FIRST = re.compile(r"(?:(?:landmark|lm|point)_?)?(\d+)_?([xy])")


@dataclass(frozen=True)
class _Layout:
    """inner : points once around the inner lips, left corner, upper lip, right corner; outer : the mouth's corners."""

    inner: tuple[int, ...]
    outer: tuple[int, int] | None


_MEDIAPIPE = _Layout(MEDIAPIPE_INNER, (61, 291))
_POINTS_68 = _Layout(tuple(range(60, 68)), (48, 54))
_INNER_20 = _Layout(tuple(range(20)), None)
_INNER_8 = _Layout(tuple(range(8)), None)


@dataclass(frozen=True, eq=False)
class MeasuredLandmarks:
    """Channels (T,) and openings in px, origin in the middle of the mouth at rest, y down.

    mouth_width : px; NaN where the table has no corners of the mouth and none was given
    """

    time_s: np.ndarray
    channels: dict[str, np.ndarray]
    openings: pd.DataFrame
    source: str
    mouth_width: float
    mouth_width_found: str
    facts: dict


def read_landmarks(
    path: str | Path,
    *,
    fps: float | None = None,
    mouth_width: float | None = None,
    closed_below_mw: float = CLOSED_BELOW_MW,
    picture_size: tuple[float, float] | None = None,
) -> MeasuredLandmarks:
    """Openings from a table of landmarks.

    Parameters
    ----------
    path : CSV with one row per frame and columns such as `x_60`, `y60`, `60_x` or `landmark_60_x`, or with one row per
        point with its number and `x`, `y`; all 468 or 478 points of MediaPipe, 68 points (OpenFace, Py-Feat, dlib), or
        the inner lips alone, 20 points of MediaPipe or 8 of dlib, from the left corner along the upper lip
    fps : frames per second, where the table has no times
    mouth_width : px, at rest; None takes the distance of the outer corners over the closed or least open frames
    closed_below_mw : an opening that is nowhere higher is closed, mouth widths; where the mouth's width is
        unknown, of the inner lips' own at rest
    picture_size : (width, height) px of the video, for points given as shares of it

    Raises
    ------
    InputError : no table of landmarks, no times, several faces, shares of a picture without its size
    """
    path = Path(path)
    if not (math.isfinite(closed_below_mw) and closed_below_mw >= 0):
        raise InputError(
            f"expected a height of 0 mouth widths or more below which lips are closed, got {closed_below_mw}"
        )
    table = _read(path)
    table, xy = _points(table, path)
    layout, source = _layout_of(table, xy, path)
    wanted = [*layout.inner, *(layout.outer or ())]
    points = np.stack([np.stack([xy[n][0], xy[n][1]], axis=1) for n in wanted], axis=1)
    for name in ("success", "n"):
        if name in table.columns:
            points[~(pd.to_numeric(table[name], errors="coerce").to_numpy(float) > 0)] = math.nan
    known = np.isfinite(points).all(axis=(1, 2))
    if not known.any():
        raise InputError(f"expected a frame with all points of the inner lips in {path}, found none")
    points = _in_px(points, known, picture_size, path)
    time_s = _times(table, fps, source, path)
    time_s, points = _with_missing_frames(table, time_s, points)
    known = np.isfinite(points).all(axis=(1, 2))
    inner = points[:, : len(layout.inner)]
    right = len(layout.inner) // 2
    found = [as_one(stretches(one)) if ok else None for one, ok in zip(inner, known, strict=True)]
    height = np.array([math.nan if one is None else one[:, HEIGHT].max(initial=0.0) for one in found])
    inner_width, _ = _at_rest(height, inner[:, 0], inner[:, right], 0.0)
    corners = points[:, len(layout.inner) :] if layout.outer else inner[:, [0, right]]
    how = "given"
    if mouth_width is None and layout.outer is None:
        mouth_width, how = math.nan, "unknown: the table has the inner lips alone"
    elif mouth_width is None:
        # which frames are closed depends on the width, so that of the inner lips decides first
        mouth_width, how = _at_rest(height, corners[:, 0], corners[:, 1], closed_below_mw * inner_width)
        how = how.replace("lip width", "distance of the outer corners")
    unit = mouth_width if math.isfinite(mouth_width) else inner_width
    if not unit > 0:
        raise InputError(f"expected corners of the mouth that are apart in {path}, got both at one place")
    limit = closed_below_mw * unit
    none = np.empty((0, 8))
    found = [one if one is None or one[:, HEIGHT].max(initial=0.0) > limit else none for one in found]
    at_rest = known & (height <= np.nanquantile(height, 0.25))
    x0, y0 = np.median(corners[at_rest].mean(axis=1), axis=0)
    found = [one if one is None else one - [x0, x0, y0, y0, 0, 0, x0, y0] for one in found]
    channels, openings = tables(time_s, found, unit)
    facts = {
        "closed_below_mw": closed_below_mw,
        "points": list(layout.inner),
        "rows": len(table),
        "frames": len(time_s),
    }
    return MeasuredLandmarks(time_s, channels, openings, source, float(mouth_width), how, facts)


def is_landmark_table(columns: list[str]) -> bool:
    """Whether a table with these columns looks like one of landmarks."""
    columns = [str(column).strip() for column in columns]
    long = {"x", "y"} <= set(columns) and any(column in _POINT for column in columns)
    return long or len(_numbered(columns)) >= 8


def _read(path: Path) -> pd.DataFrame:
    try:
        table = pd.read_csv(path, low_memory=False)
    except FileNotFoundError:
        raise InputError(f"expected the table {path}, found no such file") from None
    except (OSError, ValueError) as error:
        raise InputError(f"expected {path} to be a table of landmarks, but: {' '.join(str(error).split())}") from None
    table.columns = [str(column).strip() for column in table.columns]
    if len(table) == 0:
        raise InputError(f"expected one frame or more in {path}, found none")
    return table


def _numbered(columns: list[str]) -> dict[int, dict[str, str]]:
    """Columns of x and y of each point. Capitals are other things: OpenFace's X_0 is a place in space, in mm."""
    found: dict[int, dict[str, str]] = {}
    for column in columns:
        if match := _AXIS_FIRST.fullmatch(column):
            axis, number = match.groups()
        elif match := _NUMBER_FIRST.fullmatch(column):
            number, axis = match.groups()
        else:
            continue
        found.setdefault(int(number), {})[axis] = column
    return {number: axes for number, axes in found.items() if len(axes) == 2}


def _points(table: pd.DataFrame, path: Path) -> tuple[pd.DataFrame, dict[int, tuple[np.ndarray, np.ndarray]]]:
    """One row per frame, and (T,) x and y of every point."""
    number = next((name for name in _POINT if name in table.columns), None)
    if number is not None and {"x", "y"} <= set(table.columns):
        return _points_of_long(table, number, path)
    columns = _numbered(list(table.columns))
    if "frame" in table.columns and table["frame"].duplicated().any():
        twice = table["frame"][table["frame"].duplicated()].iloc[0]
        raise InputError(
            f"expected one face per frame in {path}, found several rows of frame {twice}; keep those of one face"
        )
    return table, {
        number: tuple(_numbers(table[axes[axis]], path) for axis in "xy") for number, axes in columns.items()
    }


def _points_of_long(table: pd.DataFrame, number: str, path: Path):
    key = next((name for name in ("frame", *_TIMES) if name in table.columns), None)
    if key is None:
        raise InputError(f"expected a column 'frame' or 'time_s' in {path}, which has one row per point")
    if table.duplicated([key, number]).any():
        row = table[table.duplicated([key, number])].iloc[0]
        raise InputError(
            f"expected one face per frame in {path}, found point {row[number]} several times in {key} {row[key]}; "
            "keep the rows of one face"
        )
    if not table[[key, number]].notna().all(axis=None):
        raise InputError(f"expected {key} and number of every point in {path}, found an empty field")
    frames, first, row = np.unique(table[key].to_numpy(), return_index=True, return_inverse=True)
    x, y, numbers = (_numbers(table[name], path) for name in ("x", "y", number))
    points = {}
    for n in np.unique(numbers[np.isfinite(numbers) & (numbers == np.floor(numbers))]):
        here = numbers == n
        points[int(n)] = tuple(np.full(len(frames), math.nan) for _ in "xy")
        for values, column in zip(points[int(n)], (x, y), strict=True):
            values[row[here]] = column[here]
    return table.iloc[first].reset_index(drop=True), points


def _numbers(values: pd.Series, path: Path) -> np.ndarray:
    try:
        return values.to_numpy(float, na_value=math.nan)
    except (ValueError, TypeError):
        raise InputError(f"expected numbers in the column '{values.name}' of {path}, found text") from None


def _layout_of(table: pd.DataFrame, xy: dict, path: Path) -> tuple[_Layout, str]:
    have = set(xy)
    if have >= {*_MEDIAPIPE.inner, *_MEDIAPIPE.outer}:
        return _MEDIAPIPE, "mediapipe"
    if have >= {*_POINTS_68.inner, *_POINTS_68.outer} and max(have) <= 67:
        if {"success", "confidence"} & set(table.columns):
            return _POINTS_68, "openface"
        pyfeat = any(name.startswith(("FaceRect", "FaceScore")) for name in table.columns)
        return _POINTS_68, "pyfeat" if pyfeat or "approx_time" in table.columns else "dlib"
    if have == set(_INNER_20.inner):
        return _INNER_20, "mediapipe"
    if have == set(_INNER_8.inner):
        return _INNER_8, "dlib"
    raise InputError(
        f"expected x and y of the points of MediaPipe (468 or 478), of a face of 68 points (OpenFace, Py-Feat, dlib), "
        f"or of the inner lips alone (20 or 8) in {path}, found {len(have)} points"
        + (f", numbers {min(have)} to {max(have)}" if have else "")
    )


def _in_px(points: np.ndarray, known: np.ndarray, picture_size, path: Path) -> np.ndarray:
    """Shares of the picture, which MediaPipe gives, as px."""
    shares = np.abs(points[known]).max() <= 4.0  # no mouth is that near the picture's corner in px
    if picture_size is None:
        if shares:
            raise InputError(
                f"expected points in px in {path}, got shares of the picture; give its size, (width, height) in px"
            )
        return points
    size = np.asarray(picture_size, float)
    if size.shape != (2,) or not (np.isfinite(size).all() and (size > 0).all()):
        raise InputError(f"expected a picture's size as (width, height) in px, got {picture_size}")
    return points * size if shares else points


def _times(table: pd.DataFrame, fps: float | None, source: str, path: Path) -> np.ndarray:
    for name, unit_s in _TIMES.items():
        if name in table.columns:
            time_s = _numbers(table[name], path) * unit_s
            if len(time_s) == 1 or np.ptp(time_s) > 0:  # OpenFace writes 0 for all pictures of a folder
                return time_s
    if fps is None:
        raise InputError(
            f"expected times in {path} (a column 'time_s' or 'timestamp'), found none; give the frame rate"
        )
    if not (math.isfinite(fps) and fps > 0):
        raise InputError(f"expected a frame rate above 0 per second, got {fps}")
    frame = _numbers(table["frame"], path) if "frame" in table.columns else np.arange(len(table), dtype=float)
    return (frame - (source == "openface")) / fps  # OpenFace counts from 1


def _with_missing_frames(table: pd.DataFrame, time_s: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows that are unknown for the frames that a program left out because it found no face."""
    if "frame" not in table.columns or len(table) < 3:
        return time_s, points
    frame = pd.to_numeric(table["frame"], errors="coerce").to_numpy(float)
    steps = np.diff(frame)
    step = np.median(steps)
    if not (np.isfinite(frame).all() and (steps > 0).all() and (np.diff(time_s) > 0).all()):
        return time_s, points  # a take says what is wrong with such times
    lost = [
        np.arange(frame[k] + step, frame[k + 1] - step / 2, step)[:_MOST_LOST] for k in np.flatnonzero(steps > step)
    ]
    if not lost:
        return time_s, points
    every = np.concatenate([frame, *lost])
    order = np.argsort(every, kind="stable")
    filled = np.concatenate([points, np.full((len(every) - len(frame), *points.shape[1:]), math.nan)])
    return np.interp(every[order], frame, time_s), filled[order]


def _at_rest(height: np.ndarray, left: np.ndarray, right: np.ndarray, closed_below: float) -> tuple[float, str]:
    status = [NO_MOUTH if math.isnan(h) else CLOSED if h <= closed_below else OPEN for h in height]
    return resting_mouth_width(status, height, np.linalg.norm(right - left, axis=1))
