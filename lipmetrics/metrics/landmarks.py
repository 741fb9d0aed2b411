"""Errors between two sequences of lip landmarks: landmark distance (LMD) in its variants, and lip stability in silence.

LMD is a mean distance of landmarks; papers differ in, or do not say, whether each frame is centred, whether the
landmarks are summed or averaged, and what is scaled. Each variant is a metric of its own. Landmarks are a baseline:
trackers draw a closed mouth where the lips are just open, know one opening only, and jitter.

Frames in which any landmark of either sequence is NaN, not known, are left out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lipmetrics.errors import InputError
from lipmetrics.metrics.points import chosen, pair, sequence
from lipmetrics.metrics.registry import LOWER, NONE, Metric

# Points of MediaPipe's face mesh that THEval's script uses: pairs on the inner lips, and the outer corners of the eyes
MEDIAPIPE_UPPER = (191, 80, 81, 82, 13, 312, 311, 310)
MEDIAPIPE_LOWER = (95, 88, 178, 87, 14, 317, 402, 318)
MEDIAPIPE_EYES = (33, 263)


def validate(reference: np.ndarray, model: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Check a pair of landmark sequences and keep the frames known in both.

    Parameters
    ----------
    reference, model : (T, P, 2) or (T, P, 3) float, the lips' landmarks only (20 of 68 points, say); NaN unknown

    Returns
    -------
    both (K, P, D) float64, K frames known in both

    Raises
    ------
    InputError : other shapes, different numbers of frames or points, infinite values, or no frame known in both
    """
    reference, model = pair(reference, model, (2, 3), unknown=True)
    known = np.isfinite(reference).all(axis=(1, 2)) & np.isfinite(model).all(axis=(1, 2))
    if not known.any():
        raise InputError("expected at least one frame whose landmarks are known in both sequences, found none")
    return reference[known], model[known]


def lmd_raw_v1(reference: np.ndarray, model: np.ndarray) -> float:
    """Mean distance of the landmarks as they are, u: 1/(T P) sum_t sum_p |x_tp - y_tp|.

    Head movement counts as lip error. Source: the plain reading of the name, used where no centring is mentioned.
    """
    reference, model = validate(reference, model)
    return float(_distances(reference, model).mean())


def lmd_chen2018_v1(reference: np.ndarray, model: np.ndarray) -> float:
    """Landmark distance, u: mean distance after the lips of each frame are moved so that their mean is the origin.

        LMD = 1/T 1/P sum_t sum_p |(x_tp - mean_q x_tq) - (y_tp - mean_q y_tq)|

    In px of whatever picture the landmarks were found in: sizes of pictures must be told with the number.

    Source: Chen et al. 2018, Lip Movements Generation at a Glance.
    """
    reference, model = validate(reference, model)
    return float(_distances(_centred(reference), _centred(model)).mean())


def lmd_atvgnet_v1(reference: np.ndarray, model: np.ndarray) -> float:
    """Landmark distance as the code of ATVGnet computes it, u: as `lmd_chen2018_v1` but summed over the landmarks.

        LMD = 1/T sum_t sum_p |(x_tp - mean_q x_tq) - (y_tp - mean_q y_tq)|

    P times the other; for 20 landmarks 20 times. The mean over frames is over all frames of all clips there.

    Source: Chen et al. 2019 (ATVGnet), `evaluation_matrix.py` of its code.
    """
    reference, model = validate(reference, model)
    return float(_distances(_centred(reference), _centred(model)).sum(axis=1).mean())


def lmd_mw_v1(reference: np.ndarray, model: np.ndarray, corners: Sequence[int]) -> float:
    """`lmd_chen2018_v1` with each sequence divided by its own mouth width first, mw.

    The mouth width is the median distance of the corners over the frames, so pictures of any size can be compared.

    Parameters
    ----------
    corners : indices of the left and the right corner of the mouth

    Source: this package.
    """
    reference, model = validate(reference, model)
    reference, model = reference / _mouth_width(reference, corners), model / _mouth_width(model, corners)
    return float(_distances(_centred(reference), _centred(model)).mean())


def lmd_similarity_v1(reference: np.ndarray, model: np.ndarray, corners: Sequence[int]) -> float:
    """Mean distance in mw after one similarity transform of the whole model clip: size, place and tilt do not count.

        LMD = 1/(T P) sum_t sum_p |x_tp - (s R y_tp + d)| / w

    s, R, d minimise the sum of squares over all frames and landmarks together (Umeyama 1991), so that movement from
    frame to frame is not fitted away; w is the reference's mouth width as in `lmd_mw_v1`.

    Source: this package; transform of Umeyama 1991.
    """
    reference, model = validate(reference, model)
    width = _mouth_width(reference, corners)
    return float(_distances(reference, _moved(model, reference)).mean() / width)


def silent_lip_stability_theval_v1(
    points: np.ndarray,
    silent: np.ndarray,
    upper: Sequence[int] = MEDIAPIPE_UPPER,
    lower: Sequence[int] = MEDIAPIPE_LOWER,
    eyes: Sequence[int] = MEDIAPIPE_EYES,
) -> float:
    """Movement of the lips in silence, in distances between the eyes: median absolute deviation from the mean.

        a_t = mean_k |y(upper_k) - y(lower_k)| / |eye_1 - eye_2|,  score = median over silent t of |a_t - mean a|

    About the mean, not the median. There, silence is what a speech detector leaves in stretches of at least 0.3 s, and
    pictures are squeezed to a square first: give the coordinates as MediaPipe does, as shares of the picture's sides.

    Parameters
    ----------
    points : (T, P, 2) float (x, y); NaN unknown
    silent : (T,) bool, the frames that are silent
    upper, lower, eyes : indices; the defaults are MediaPipe's, as there

    Returns
    -------
    float, NaN where fewer than 2 silent frames are known, as there

    Source: Quignon et al. 2026 (THEval), `Synchronization/silent_lip_stability.py` of its code.
    """
    points = sequence(points, "landmarks", (2, 3), unknown=True)
    silent = np.asarray(silent)
    if silent.shape != (len(points),) or silent.dtype != bool:
        raise InputError(f"expected silent as true or false for each of the {len(points)} frames, got {silent.shape}")
    upper, lower = (chosen(side, points.shape[1], "points of the lips") for side in (upper, lower))
    if len(upper) != len(lower):
        raise InputError(f"expected as many points of the upper as of the lower lip, got {len(upper)} and {len(lower)}")
    eyes = chosen(eyes, points.shape[1], "points of the eyes", 2)
    between_eyes = np.linalg.norm(points[:, eyes[0], :2] - points[:, eyes[1], :2], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        opening = np.abs(points[:, upper, 1] - points[:, lower, 1]).mean(axis=1) / between_eyes
    opening = opening[silent & np.isfinite(opening)]
    if len(opening) < 2:
        return float("nan")
    return float(np.median(np.abs(opening - opening.mean())))


def evaluate(reference: np.ndarray, model: np.ndarray, *, corners: Sequence[int] | None = None) -> dict[str, float]:
    """All landmark distances by name; those in mouth widths are left out without the corners' indices.

    Raises
    ------
    InputError : as `validate`
    """
    reference, model = validate(reference, model)
    scores = {row.name: row.function(reference, model) for row in ROWS if row.needs == "landmark pair"}
    if corners is not None:
        with_corners = [row for row in ROWS if row.needs == "landmark pair with corners"]
        scores.update({row.name: row.function(reference, model, corners) for row in with_corners})
    return scores


def _distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(T, P) distances of the points of (T, P, D)."""
    return np.linalg.norm(a - b, axis=2)


def _centred(points: np.ndarray) -> np.ndarray:
    return points - points.mean(axis=1, keepdims=True)


def _mouth_width(points: np.ndarray, corners: Sequence[int]) -> float:
    left, right = chosen(corners, points.shape[1], "corners of the mouth", 2)[:2]
    width = float(np.median(np.linalg.norm(points[:, left] - points[:, right], axis=1)))
    if width == 0:
        raise InputError(f"expected corners of the mouth apart from one another, landmarks {left} and {right} coincide")
    return width


def _moved(model: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """`model` (T, P, D) moved onto `reference` by the similarity transform of least squares, no mirroring."""
    dimensions = model.shape[2]
    y, x = model.reshape(-1, dimensions), reference.reshape(-1, dimensions)
    y_mean, x_mean = y.mean(axis=0), x.mean(axis=0)
    spread = ((y - y_mean) ** 2).sum()
    if spread == 0:
        raise InputError("expected a model whose landmarks are apart from one another, all coincide")
    left, sizes, right = np.linalg.svd((x - x_mean).T @ (y - y_mean))
    signs = np.ones(dimensions)
    signs[-1] = np.sign(np.linalg.det(left) * np.linalg.det(right))
    rotation = left @ np.diag(signs) @ right
    scale = (sizes * signs).sum() / spread
    return (scale * (y - y_mean) @ rotation.T + x_mean).reshape(model.shape)


ROWS = (
    Metric(
        *("lmd_raw_v1", "landmarks", "u", LOWER, "landmark pair", lmd_raw_v1),
        *("1/(T P) sum_t sum_p |x_tp - y_tp|", "plain reading of the name"),
    ),
    Metric(
        *("lmd_chen2018_v1", "landmarks", "u", LOWER, "landmark pair", lmd_chen2018_v1),
        *("1/(T P) sum_t sum_p |x'_tp - y'_tp|, x' centred in each frame", "Chen et al. 2018"),
    ),
    Metric(
        *("lmd_atvgnet_v1", "landmarks", "u", LOWER, "landmark pair", lmd_atvgnet_v1),
        *("1/T sum_t sum_p |x'_tp - y'_tp|, x' centred in each frame", "ATVGnet, evaluation_matrix.py"),
    ),
    Metric(
        *("lmd_mw_v1", "landmarks", "mw", LOWER, "landmark pair with corners", lmd_mw_v1),
        *("lmd_chen2018_v1 of x / w_x and y / w_y, w the median corner distance", "this package"),
    ),
    Metric(
        *("lmd_similarity_v1", "landmarks", "mw", LOWER, "landmark pair with corners", lmd_similarity_v1),
        *("1/(T P) sum_t sum_p |x_tp - (s R y_tp + d)| / w_x, one s, R, d per clip", "this package; Umeyama 1991"),
    ),
    Metric(
        *("silent_lip_stability_theval_v1", "landmarks", "1", NONE, "landmarks with silence"),
        silent_lip_stability_theval_v1,
        *("median over silent t of |a_t - mean a|, a over the distance of the eyes", "Quignon et al. 2026, THEval"),
    ),
)
