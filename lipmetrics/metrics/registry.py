"""What is known of a metric besides its function: name with version, unit, direction, needs, formula and source."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

LOWER, HIGHER, NONE = "lower", "higher", "none"

# What the function of a metric is called with, by the word in its row
NEEDS = {
    "mesh pair": "(reference, model, lips)",
    "mesh midpoints": "(reference, model, upper, lower)",
    "landmark pair": "(reference, model)",
    "landmark pair with corners": "(reference, model, corners)",
    "landmarks with silence": "(points, silent)",
    "take": "(take)",
    "take with silence": "(take, silence)",
    "openings": "(take)",
    "take pair": "(reference, model)",
}


@dataclass(frozen=True)
class Metric:
    """One named, versioned number.

    name : ends in its version, `_v1`; the numbers of one name never change, a changed definition gets a new version
    family : the module it lives in: vertices, landmarks, movement, sticky or curves
    unit : `mw` is a mouth width, or the length unit of the take where that is another; `u` the unit of the points
        that were given; `1` none
    better : `lower` or `higher` is nearer to the reference; `none` describes a movement and is neither
    needs : a key of `NEEDS`, which says what the function is called with
    """

    name: str
    family: str
    unit: str
    better: str
    needs: str
    function: Callable
    formula: str
    source: str
