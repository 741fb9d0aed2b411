"""The tables of the truth: the columns, numbers and text of those that `lipmetrics measure` writes, in px or in m.

Closed is 0. Nothing is unknown, so only the ratio of a closed mouth and the rate of the first frame are NaN.
"""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from simulator.aperture import Pieces
from simulator.identity import Identity
from simulator.polygons import SIZES

RATE_STEPS = 3
RATE_FORMULA = (
    f"(v_i - v_j) / (t_i - t_j), j = {RATE_STEPS} frames back or the first after an unknown value, whichever is later"
)
WHOLE = ("frame", "n_openings", "opening", "element")
TEXT = ("status", "event", "parents", "state")


def frame_table(time_s: np.ndarray, pieces: Pieces, sizes: np.ndarray, mouth_width: float, unit: str) -> pd.DataFrame:
    """One row per frame; sizes are of the frame's largest opening by area, the first of equals.

    Parameters
    ----------
    time_s : (T,) s
    sizes : (K, 9) of the pieces, as `polygons.measure` gives them
    mouth_width : between the corners at rest, in `unit`
    unit : "px" or "m"
    """
    frames = len(time_s)
    count = np.bincount(pieces.frame, minlength=frames)
    area = sizes[:, SIZES.index("area")]
    total = np.bincount(pieces.frame, weights=area, minlength=frames).astype(float)
    order = np.lexsort((np.arange(len(area)), -area, pieces.frame))  # by frame, the largest first
    largest = np.zeros((frames, len(SIZES)))
    is_first = np.diff(pieces.frame[order], prepend=-1) > 0
    largest[pieces.frame[order][is_first]] = sizes[order][is_first]
    width, height, area = (largest[:, SIZES.index(name)] for name in ("width", "height", "area"))
    time_s = np.asarray(time_s, float)
    return pd.DataFrame(
        {
            "frame": np.arange(frames, dtype=np.int64),
            "time_s": time_s,
            "status": pd.Series(np.where(count > 0, "open", "closed"), dtype=object).astype(str),
            "n_openings": pd.array(count, dtype="Int64"),
            f"width_{unit}": width,
            f"height_{unit}": height,
            f"area_{_squared(unit)}": area,
            "width_mw": width / mouth_width,
            "height_mw": height / mouth_width,
            "area_mw2": area / mouth_width**2,
            "ratio": np.divide(width, height, out=np.full(frames, np.nan), where=height > 0),
            f"total_area_{_squared(unit)}": total,
            "d_width_mw_s": rate_of_change(width / mouth_width, time_s),
            "d_height_mw_s": rate_of_change(height / mouth_width, time_s),
            "confidence": np.ones(frames),
        }
    )


def opening_table(
    time_s: np.ndarray, pieces: Pieces, sizes: np.ndarray, who: list[Identity], unit: str
) -> pd.DataFrame:
    """One row per opening per frame, from left to right along the lips; arguments as for `frame_table`."""
    places = dict(zip(SIZES, sizes.T, strict=True))
    in_m = "_m" if unit == "m" else ""
    parents = ["+".join(map(str, one.parents)) for one in who]
    return pd.DataFrame(
        {
            "frame": pieces.frame.astype(np.int64),
            "time_s": np.asarray(time_s, float)[pieces.frame],
            "opening": np.array([one.number for one in who], np.int64),
            **{name + in_m: places[name] for name in ("row_min", "row_max", "col_min", "col_max")},
            f"width_{unit}": places["width"],
            f"height_{unit}": places["height"],
            f"area_{_squared(unit)}": places["area"],
            **{name + in_m: places[name] for name in ("centroid_row", "centroid_col")},
            "event": pd.Series([one.event for one in who], dtype=object).astype(str),
            "parents": pd.Series(parents, dtype=object).astype(str),
        }
    )


def rate_of_change(values: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Rate of change per second (T,), by `RATE_FORMULA`, of values that are all known; NaN at the first frame."""
    rates = np.full(len(values), np.nan)
    here = np.arange(1, len(values))
    back = np.maximum(here - RATE_STEPS, 0)
    rates[1:] = (values[here] - values[back]) / (time_s[here] - time_s[back])
    return rates


def csv(table: pd.DataFrame) -> str:
    """A table as text: times with 6 decimals, other numbers with 7 significant digits, an empty field for NaN."""
    columns = [_texts(name, table[name]) for name in table.columns]
    lines = [",".join(table.columns), *map(",".join, zip(*columns, strict=True))]
    return "\n".join(lines) + "\n"


def _texts(name: str, values: pd.Series) -> list[str]:
    if name in TEXT:
        return values.tolist()
    if name in WHOLE:
        return list(map(str, values.tolist()))
    if name == "time_s":
        return [f"{value:.6f}" for value in (values.to_numpy() + 0.0).tolist()]
    return ["" if math.isnan(value) else f"{value:.7g}" for value in (values.to_numpy() + 0.0).tolist()]


def _squared(unit: str) -> str:
    return "m2" if unit == "m" else unit
