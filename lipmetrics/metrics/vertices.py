"""Errors between two mesh sequences with the same vertices: lip vertex errors, lip distance, mouth opening difference.

The names LVE and MOD mean different things in different codes, so each definition is a metric of its own. All take the
vertices as they are: nothing is scaled, and only where it is part of a published definition anything is centred.
`u` is the unit of the vertices (m, mm or the model's own); a squared error is in u^2. Subtracting the same template
from reference and model changes none of these numbers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lipmetrics.errors import InputError
from lipmetrics.metrics.points import chosen, pair, sequence
from lipmetrics.metrics.registry import LOWER, Metric

# FLAME vertices in the middle of the upper and the lower lip (CodeTalker issue 55, which also says that the earlier
# lower one, 2151, was wrong)
FLAME_UPPER, FLAME_LOWER = 3546, 3504


def validate(
    reference: np.ndarray, model: np.ndarray, lips: Sequence[int], lengths: str = "equal"
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Check a pair of mesh sequences.

    Parameters
    ----------
    reference, model : (T, V, 3) float, the real mouth and the one that is judged
    lips : (n,) int, indices of the lips' vertices
    lengths : `equal` refuses different numbers of frames, `shorter` cuts the longer one's end off

    Returns
    -------
    reference and model (T, V, 3) float64, lips (n,) int64

    Raises
    ------
    InputError : other shapes or lengths, values that are not finite, vertices that do not exist
    """
    if lengths not in ("equal", "shorter"):
        raise InputError(f"expected lengths 'equal' or 'shorter', got {lengths!r}")
    if lengths == "shorter":
        reference, model = sequence(reference, "the reference", (3,)), sequence(model, "the model", (3,))
        frames = min(len(reference), len(model))
        reference, model = reference[:frames], model[:frames]
    reference, model = pair(reference, model, (3,))
    return reference, model, chosen(lips, reference.shape[1], "lip vertices")


def lve_torchmetrics_v1(reference: np.ndarray, model: np.ndarray, lips: Sequence[int]) -> float:
    """Lip vertex error as torchmetrics 1.9 computes it, u^2: mean over frames of the largest squared distance.

        LVE = 1/T sum_t max_v |x_tv - y_tv|^2

    The longer sequence's end is cut off, as there. CodeTalker's and DiffSpeaker's codes compute the same; over several
    clips they average over all frames, not over clips.

    Source: torchmetrics 1.9.0 `lip_vertex_error`; Xing et al. 2023 (CodeTalker), `cal_metric.py`.
    """
    reference, model, lips = validate(reference, model, lips, lengths="shorter")
    return float((_distances(reference[:, lips], model[:, lips]) ** 2).max(axis=1).mean())


def lve_meshtalk_v1(reference: np.ndarray, model: np.ndarray, lips: Sequence[int]) -> float:
    """Lip vertex error of MeshTalk, u: not squared, the lips of each frame moved so that their mean is the origin.

        LVE = 1/T sum_t max_v |(x_tv - mean_w x_tw) - (y_tv - mean_w y_tw)|

    Blind to where the lips are in the face as a whole: a lower lip that hangs too low counts in part.

    Source: Richard et al. 2021 (MeshTalk), computed as in issue 32 of its code.
    """
    reference, model, lips = validate(reference, model, lips)
    return float(_distances(_centred(reference[:, lips]), _centred(model[:, lips])).max(axis=1).mean())


def lve_max_v1(reference: np.ndarray, model: np.ndarray, lips: Sequence[int]) -> float:
    """Lip vertex error as papers word it, u: mean over frames of the largest distance, neither squared nor centred.

        LVE = 1/T sum_t max_v |x_tv - y_tv|

    Source: Fan et al. 2022 (FaceFormer), "maximal L2 error of all lip vertices", average over frames.
    """
    reference, model, lips = validate(reference, model, lips)
    return float(_distances(reference[:, lips], model[:, lips]).max(axis=1).mean())


def mod_artalk_v1(reference: np.ndarray, model: np.ndarray, lips: Sequence[int]) -> float:
    """ "Mouth opening difference" of ARTalk, u: the mean error of the lip vertices, which is no opening at all.

        MOD = 1/(T n) sum_t sum_v |x_tv - y_tv|

    Source: Chu et al. 2025 (ARTalk), issue 17 of its code: it "averages the errors within the region where LVE is
    calculated, rather than taking the maximum value". Whether the errors are squared is not said; here they are not.
    """
    reference, model, lips = validate(reference, model, lips)
    return float(_distances(reference[:, lips], model[:, lips]).mean())


def lip_distance(vertices: np.ndarray, upper: int = FLAME_UPPER, lower: int = FLAME_LOWER) -> np.ndarray:
    """Distance of a vertex of the upper lip from one of the lower lip in every frame, u.

    Parameters
    ----------
    vertices : (T, V, 3) float
    upper, lower : indices; the defaults are those of FLAME

    Returns
    -------
    (T,) float64. Not 0 in a closed mouth unless both are on the lips' inner edge

    Source: Xing et al. 2023 (CodeTalker), figure of lip distance, computed as in issue 55 of its code.
    """
    vertices = sequence(vertices, "vertices", (3,))
    at = chosen([upper, lower], vertices.shape[1], "vertices of upper and lower lip", 2)
    return np.linalg.norm(vertices[:, at[0]] - vertices[:, at[1]], axis=1)


def lip_distance_error_v1(
    reference: np.ndarray, model: np.ndarray, upper: int = FLAME_UPPER, lower: int = FLAME_LOWER
) -> float:
    """Mean absolute difference of the lip distances, u. 1/T sum_t | d(x_t) - d(y_t) |, d as in `lip_distance`.

    Source: the curve is CodeTalker's (issue 55 of its code); the mean absolute difference is this package's.
    """
    reference, model = pair(reference, model, (3,))
    return float(np.abs(lip_distance(reference, upper, lower) - lip_distance(model, upper, lower)).mean())


def mod_msmd_v1(reference: np.ndarray, model: np.ndarray, upper: int = FLAME_UPPER, lower: int = FLAME_LOWER) -> float:
    """Mouth opening difference of "Model See Model Do", u: root mean square difference of lip distances / sqrt(3).

        MOD = sqrt( 1/T sum_t (g(x_t) - g(y_t))^2 ),  g = sqrt(mean over x, y, z of (upper - lower)^2) = d / sqrt(3)

    The mean over the three coordinates, not their sum, makes g smaller than a distance. There the two points are
    landmarks 51 and 57 of 68, the middle of the outer edges of the lips.

    Source: Pan et al. 2025 (Model See Model Do), issue 2 of its code.
    """
    reference, model = pair(reference, model, (3,))
    difference = lip_distance(reference, upper, lower) - lip_distance(model, upper, lower)
    return float(np.sqrt((difference**2).mean() / 3))


def evaluate(
    reference: np.ndarray,
    model: np.ndarray,
    lips: Sequence[int],
    *,
    upper: int | None = None,
    lower: int | None = None,
    lengths: str = "equal",
) -> dict[str, float]:
    """All metrics of this module by name.

    Parameters
    ----------
    reference, model : (T, V, 3) float
    lips : (n,) int
    upper, lower : vertices in the middle of the two lips; without them the metrics of lip distance are left out
    lengths : as in `validate`

    Raises
    ------
    InputError : as `validate`, or one of upper and lower without the other
    """
    if (upper is None) != (lower is None):
        raise InputError("expected a vertex of the upper and one of the lower lip, or neither, got one of them")
    reference, model, lips = validate(reference, model, lips, lengths)
    scores = {row.name: row.function(reference, model, lips) for row in ROWS if row.needs == "mesh pair"}
    if upper is not None:
        midpoints = [row for row in ROWS if row.needs == "mesh midpoints"]
        scores.update({row.name: row.function(reference, model, upper, lower) for row in midpoints})
    return scores


def _distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(T, n) distances of the points of (T, n, D)."""
    return np.linalg.norm(a - b, axis=2)


def _centred(points: np.ndarray) -> np.ndarray:
    return points - points.mean(axis=1, keepdims=True)


ROWS = (
    Metric(
        *("lve_torchmetrics_v1", "vertices", "u^2", LOWER, "mesh pair", lve_torchmetrics_v1),
        *("1/T sum_t max_v |x_tv - y_tv|^2", "torchmetrics 1.9.0; CodeTalker, cal_metric.py"),
    ),
    Metric(
        *("lve_meshtalk_v1", "vertices", "u", LOWER, "mesh pair", lve_meshtalk_v1),
        *("1/T sum_t max_v |x'_tv - y'_tv|, x' centred in each frame", "Richard et al. 2021; MeshTalk issue 32"),
    ),
    Metric(
        *("lve_max_v1", "vertices", "u", LOWER, "mesh pair", lve_max_v1),
        *("1/T sum_t max_v |x_tv - y_tv|", "Fan et al. 2022, in words"),
    ),
    Metric(
        *("mod_artalk_v1", "vertices", "u", LOWER, "mesh pair", mod_artalk_v1),
        *("1/(T n) sum_t sum_v |x_tv - y_tv|", "Chu et al. 2025; ARTalk issue 17"),
    ),
    Metric(
        *("lip_distance_error_v1", "vertices", "u", LOWER, "mesh midpoints", lip_distance_error_v1),
        *("1/T sum_t | d(x_t) - d(y_t) |", "curve of Xing et al. 2023, CodeTalker issue 55"),
    ),
    Metric(
        *("mod_msmd_v1", "vertices", "u", LOWER, "mesh midpoints", mod_msmd_v1),
        *("sqrt( 1/T sum_t (d(x_t) - d(y_t))^2 / 3 )", "Pan et al. 2025; issue 2 of its code"),
    ),
)
