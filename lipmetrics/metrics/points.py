"""Checks of point sequences: vertices (T, V, 3) and landmarks (T, P, 2 or 3), and the choice of points in them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lipmetrics.errors import InputError


def sequence(points: np.ndarray, what: str, dimensions: tuple[int, ...], unknown: bool = False) -> np.ndarray:
    """`points` as (T, P, D) float64, D one of `dimensions`, T and P at least 1.

    Parameters
    ----------
    what : name in messages
    unknown : whether NaN, a point that is not known, may occur

    Raises
    ------
    InputError : another shape, no numbers, or values that are not finite
    """
    try:
        array = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"expected {what} to be an array of numbers, got {type(points).__name__}") from None
    last = " or ".join(map(str, dimensions))
    if array.ndim != 3 or array.shape[2] not in dimensions or 0 in array.shape:
        hint = "; reshape (T, 3 V) to (T, V, 3)" if array.ndim == 2 and 3 in dimensions else ""
        raise InputError(f"expected {what} of shape (frames, points, {last}), got {array.shape}{hint}")
    bad = np.isinf(array) if unknown else ~np.isfinite(array)
    if bad.any():
        frame = int(np.flatnonzero(bad.any(axis=(1, 2)))[0])
        raise InputError(f"expected finite coordinates in {what}, found others first in frame {frame}")
    return array


def pair(reference: np.ndarray, model: np.ndarray, dimensions: tuple[int, ...], unknown: bool = False):
    """Both as `sequence`; InputError unless they have the same numbers of frames, points and dimensions."""
    reference = sequence(reference, "the reference", dimensions, unknown)
    model = sequence(model, "the model", dimensions, unknown)
    if reference.shape[1:] != model.shape[1:]:
        raise InputError(
            f"expected the same points in the reference and the model, got {reference.shape[1:]} and {model.shape[1:]}"
        )
    if len(reference) != len(model):
        raise InputError(
            f"expected as many frames in the model as in the reference, got {len(model)} and {len(reference)}; "
            "bring both to the same frames first, or cut them with lengths='shorter' where that is offered"
        )
    return reference, model


def chosen(indices: Sequence[int] | int, count: int, what: str, at_least: int = 1) -> np.ndarray:
    """Indices of points as (n,) int64; InputError for fewer than `at_least`, a mask, or one beyond `count`."""
    array = np.atleast_1d(np.asarray(indices))
    if array.dtype == bool:
        raise InputError(f"expected {what} as indices, got a mask of true and false; use np.flatnonzero(mask)")
    if array.ndim != 1 or array.size < at_least or not np.issubdtype(array.dtype, np.integer):
        raise InputError(f"expected {what} as at least {at_least} whole number(s), got {indices!r}")
    wrong = array[(array < 0) | (array >= count)]
    if wrong.size:
        raise InputError(f"expected {what} between 0 and {count - 1}, got {wrong[0]}")
    return array.astype(np.int64)
