"""Named, versioned measures of mouth movement, and the register of all of them.

Each family is a module like those of mir_eval: `validate`, one function per score, and `evaluate`, all of them by name.
"""

from __future__ import annotations

import difflib

from lipmetrics.errors import InputError
from lipmetrics.metrics import curves, landmarks, movement, sticky, vertices
from lipmetrics.metrics.registry import HIGHER, LOWER, NEEDS, NONE, Metric

FAMILIES = (vertices, landmarks, movement, sticky, curves)
METRICS: dict[str, Metric] = {row.name: row for family in FAMILIES for row in family.ROWS}

__all__ = [
    "HIGHER",
    "LOWER",
    "METRICS",
    "NEEDS",
    "NONE",
    "Metric",
    "landmarks",
    "metric",
    "movement",
    "sticky",
    "vertices",
]


def metric(name: str) -> Metric:
    """The metric of this name; InputError names the nearest known one."""
    if name not in METRICS:
        near = difflib.get_close_matches(str(name), METRICS, n=1, cutoff=0.5)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise InputError(f"expected the name of a metric, got {name!r}{hint}")
    return METRICS[name]
