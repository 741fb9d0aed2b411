"""The profile of a clip: its two tables, its provenance, their files, and the rates of change.

Closed is 0, unknown is NaN (an empty field in the CSV); the two are never mixed. Lengths end in `_px` or in `_mw`,
mouth widths; areas in `_px` (pixels) or `_mw2`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from lipmetrics.atomic import whole_file
from lipmetrics.errors import InputError
from lipmetrics.look import CLOSED, NO_MOUTH, OPEN, Look
from lipmetrics.openings import Identity, Opening

FORMAT = "lipmetrics profile 1"
FRAMES, OPENINGS, META = ".frames.csv", ".openings.csv", ".json"
FRAME_COLUMNS = (
    *("frame", "time_s", "status", "n_openings", "width_px", "height_px", "area_px", "width_mw", "height_mw"),
    *("area_mw2", "ratio", "total_area_px", "d_width_mw_s", "d_height_mw_s", "confidence"),
)
OPENING_COLUMNS = (
    *("frame", "time_s", "opening", "row_min", "row_max", "col_min", "col_max", "width_px", "height_px", "area_px"),
    *("centroid_row", "centroid_col", "event", "parents"),
)
RATE_STEPS = 3
RATE_FORMULA = (
    f"(v_i - v_j) / (t_i - t_j), j = {RATE_STEPS} frames back or the first after an unknown value, whichever is later"
)
_MEASURED = ["n_openings", "width_px", "height_px", "area_px", "total_area_px"]
_TEXT = {"status", "event", "parents"}
_WHOLE = {"frame", "n_openings", "opening"}


@dataclass
class Profile:
    """What was measured in one clip.

    frames : one row per frame, columns `FRAME_COLUMNS`; sizes are of the frame's largest opening by area
    openings : one row per opening per frame, columns `OPENING_COLUMNS`
    meta : provenance; `mouth_width_px` is NaN where it is unknown
    outlines : polygons (n, 2) float64 (row, column) of each frame's openings, in the order of both tables; empty
        unless they were asked for, as they are not saved
    corners : mouth corners (2, 2) float64 (row, column), left then right, of each frame; empty likewise
    """

    frames: pd.DataFrame
    openings: pd.DataFrame
    meta: dict
    outlines: list[list[np.ndarray]] = field(default_factory=list)
    corners: list[np.ndarray] = field(default_factory=list)

    def save(self, folder: str | Path, stem: str) -> list[Path]:
        """Write `<stem>.frames.csv`, `<stem>.openings.csv` and `<stem>.json` into `folder`, made if needed.

        All three are complete before the first takes its name; the json comes last. Times have 6 decimals, other
        numbers 7 significant digits. The same profile gives the same bytes.

        Raises InputError if `folder` cannot be written to.
        """
        texts = {
            META: json.dumps(without_nan(self.meta), indent=2, ensure_ascii=False, allow_nan=False) + "\n",
            OPENINGS: _csv(self.openings),
            FRAMES: _csv(self.frames),
        }
        paths = {ending: Path(folder) / (stem + ending) for ending in texts}
        with ExitStack() as files:  # leaves in reverse order: frames, openings, json
            for ending, text in texts.items():
                part = files.enter_context(whole_file(paths[ending]))
                part.write_text(text, encoding="utf-8", newline="\n")
        return [paths[FRAMES], paths[OPENINGS], paths[META]]


def load_profile(path: str | Path) -> Profile:
    """Read a profile back, without outlines.

    Parameters
    ----------
    path : any one of the three files, or their common path without an ending (`out/clip` or `out/clip.mp4`'s stem)

    Raises
    ------
    InputError : a file is missing, is not a table of ours, or lacks columns
    """
    base = str(path)
    for ending in (FRAMES, OPENINGS, META):
        base = base.removesuffix(ending)
    frames = _read_table(Path(base + FRAMES), FRAME_COLUMNS)
    openings = _read_table(Path(base + OPENINGS), OPENING_COLUMNS)
    odd = sorted(set(frames["status"]) - {OPEN, CLOSED, NO_MOUTH})
    if odd:
        raise InputError(f"{base}{FRAMES}: expected status {OPEN}, {CLOSED} or {NO_MOUTH}, got {', '.join(odd)}")
    return Profile(frames, openings, _read_meta(Path(base + META)))


def frame_row(index: int, time_s: float, look: Look, found: Sequence[Opening]) -> tuple:
    """One frame as measured, in px: `FRAME_COLUMNS` up to area_px, then total_area_px and confidence."""
    if look.status == NO_MOUTH:
        return (index, time_s, NO_MOUTH, *[math.nan] * len(_MEASURED), look.confidence)
    if look.status == CLOSED or not found:
        return (index, time_s, CLOSED, *[0] * len(_MEASURED), look.confidence)
    largest = max(found, key=lambda opening: opening.area_px)
    total = sum(opening.area_px for opening in found)
    sizes = (len(found), largest.width_px, largest.height_px, largest.area_px, total)
    return (index, time_s, OPEN, *sizes, look.confidence)


def opening_row(index: int, time_s: float, identity: Identity, opening: Opening) -> tuple:
    """One opening in one frame: `OPENING_COLUMNS`. `parents` joins the identities that flow into it by "+"."""
    extents = opening[:4]
    sizes = (opening.width_px, opening.height_px, opening.area_px, opening.centroid_row, opening.centroid_col)
    return (index, time_s, identity.number, *extents, *sizes, identity.event, "+".join(map(str, identity.parents)))


def tables(
    frame_rows: list[tuple], opening_rows: list[tuple], mouth_width_px: float
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The two tables from the rows of `frame_row` and `opening_row`; `mouth_width_px` may be NaN, unknown."""
    frames = pd.DataFrame(frame_rows, columns=["frame", "time_s", "status", *_MEASURED, "confidence"])
    numbers = {"time_s": float, "confidence": float, **dict.fromkeys(_MEASURED, float)}
    frames = frames.astype({"frame": "int64", "status": str, **numbers})
    for name, power in (("width", 1), ("height", 1), ("area", 2)):
        in_px = frames[f"{name}_px"].to_numpy()
        # a closed mouth is 0 mouth widths high, even where the mouth width is unknown
        frames[f"{name}_mw" + "2" * (power == 2)] = np.where(in_px == 0, 0.0, in_px / mouth_width_px**power)
    width, height = frames["width_px"].to_numpy(), frames["height_px"].to_numpy()
    frames["ratio"] = np.divide(width, height, out=np.full(len(frames), np.nan), where=height > 0)
    for name in ("width", "height"):
        frames[f"d_{name}_mw_s"] = rate_of_change(frames[f"{name}_mw"].to_numpy(), frames["time_s"].to_numpy())
    frames["n_openings"] = frames["n_openings"].astype("Int64")

    openings = pd.DataFrame(opening_rows, columns=list(OPENING_COLUMNS))
    openings = openings.astype({c: str if c in _TEXT else "int64" if c in _WHOLE else float for c in OPENING_COLUMNS})
    return frames[list(FRAME_COLUMNS)], openings


def rate_of_change(values: np.ndarray, time_s: np.ndarray, steps: int = RATE_STEPS) -> np.ndarray:
    """Rate of change per second at each frame, a moving average over the previous `steps` steps with real time steps.

        rate_i = (v_i - v_j) / (t_i - t_j)

    which is the mean of the rates of the steps j .. i, each weighted with its duration. j is i - steps, or the first
    frame after the last unknown value or of the clip where that is later: nothing is carried across a gap.

    Parameters
    ----------
    values, time_s : (T,) float; values may be NaN, unknown; times strictly increase

    Returns
    -------
    (T,) float64; NaN where v_i is unknown, at the first frame and at the first frame after a gap
    """
    here = np.arange(len(values))
    known = np.isfinite(values)
    gap_before = np.maximum.accumulate(np.where(known, -1, here))
    back = np.maximum(here - steps, gap_before + 1)
    rates = np.full(len(values), np.nan)
    i = here[known & (back < here)]
    rates[i] = (values[i] - values[back[i]]) / (time_s[i] - time_s[back[i]])
    return rates


def resting_mouth_width(status: list[str], height_px: np.ndarray, lip_width_px: np.ndarray) -> tuple[float, str]:
    """Width of the mouth at rest in px and how it was found, from every frame's status, height and lip width (T,).

    The median over the closed frames; where fewer than 3 are closed, over the quarter of the frames (at least 3)
    that are least open, because a wide open or rounded mouth is narrower. NaN where no frame knows its lips.
    """
    known = np.isfinite(lip_width_px)
    closed = known & (np.array(status) == CLOSED)
    if closed.sum() >= 3:
        return float(np.median(lip_width_px[closed])), f"median lip width of {closed.sum()} closed frames"
    seen = np.flatnonzero(known & np.isfinite(height_px))
    if len(seen) == 0:
        return math.nan, "unknown: the mouth corners were not found"
    least = seen[np.argsort(height_px[seen], kind="stable")][: max(3, len(seen) // 4)]
    return float(np.median(lip_width_px[least])), f"median lip width of the {len(least)} least open frames"


def _csv(table: pd.DataFrame) -> str:
    table = table.copy()
    for name in table.columns:
        if name == "time_s":
            table[name] = [f"{value:.6f}" for value in table[name] + 0.0]
        elif name not in _TEXT | _WHOLE:
            table[name] = ["" if math.isnan(value) else f"{value + 0.0:.7g}" for value in table[name]]
    return table.to_csv(index=False, lineterminator="\n")


def _read_table(path: Path, columns: tuple[str, ...]) -> pd.DataFrame:
    types = {c: str if c in _TEXT else float for c in columns}
    try:
        table = pd.read_csv(
            path, dtype=types, keep_default_na=False, na_values={c: [""] for c in columns if c not in _TEXT}
        )
    except FileNotFoundError:
        raise InputError(f"expected the table {path}, found no such file; measure the clip first") from None
    except (OSError, ValueError) as error:  # pandas raises ValueErrors for text that is not such a table
        raise InputError(f"expected {path} to be a table that lipmetrics wrote, but: {_one_line(error)}") from None
    missing = [c for c in columns if c not in table.columns]
    if missing:
        raise InputError(f"expected {path} to have the columns of a profile, missing {', '.join(missing)}")
    if not table[list(_WHOLE & set(columns) - {"n_openings"})].notna().all(axis=None):
        raise InputError(f"expected a number in every row of frame and opening in {path}, found an empty field")
    whole = {c: "Int64" if c == "n_openings" else "int64" for c in columns if c in _WHOLE}
    for name in whole:
        if not (table[name].dropna() % 1 == 0).all():
            raise InputError(f"expected whole numbers of frames and openings in {path}, found another under {name}")
    try:
        return table[list(columns)].astype(whole)
    except (ValueError, TypeError) as error:
        raise InputError(f"expected whole numbers of frames and openings in {path}, but: {_one_line(error)}") from None


def _read_meta(path: Path) -> dict:
    try:
        meta = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"expected the provenance {path} beside the tables, found no such file") from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"expected {path} to be JSON that lipmetrics wrote, but: {_one_line(error)}") from None
    if not isinstance(meta, dict) or meta.get("format") != FORMAT:
        found = meta.get("format") if isinstance(meta, dict) else type(meta).__name__
        raise InputError(f"expected {path} to say format '{FORMAT}', got {found!r}")
    return with_mouth_width(meta, str(path))


def with_mouth_width(meta: dict, where: str) -> dict:
    """What a profile's JSON says, with NaN for a mouth width that is unknown; InputError for one that is no number."""
    width = meta.get("mouth_width_px")
    if width is not None and (isinstance(width, bool) or not isinstance(width, int | float)):
        raise InputError(f"expected mouth_width_px in {where} to be a number or null, got {width!r}")
    try:
        return meta | {"mouth_width_px": math.nan if width is None else float(width)}
    except OverflowError:
        raise InputError(
            f"expected mouth_width_px in {where} to be a width in px, got a number of {len(str(width))} digits"
        ) from None


def without_nan(value):
    """JSON has no NaN: null stands for unknown."""
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [without_nan(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
