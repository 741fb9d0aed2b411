import numpy as np
import pytest

from lipmetrics.errors import InputError
from lipmetrics.metrics import METRICS, landmarks

# Four landmarks: left and right corner, upper and lower lip; two frames, the mouth is 8 wide
REFERENCE = np.array([[[0.0, 0], [8, 0], [4, -1], [4, 1]], [[0, 0], [8, 0], [4, -1], [4, 3]]])
# the lower lip of the model hangs 4 too low in frame 0, all of frame 1 is 3 too far right
MODEL = REFERENCE + np.array([[[0.0, 0], [0, 0], [0, 0], [0, 4]], [[3, 0], [3, 0], [3, 0], [3, 0]]])


def test_without_centring_a_moved_head_is_an_error():
    assert landmarks.lmd_raw_v1(REFERENCE, MODEL) == pytest.approx((4 + 4 * 3) / 8)


def test_centred_as_published_and_summed_as_in_the_code():
    # centring moves the model of frame 0 up by 1: errors 1, 1, 1, 3; frame 1 has none left
    assert landmarks.lmd_chen2018_v1(REFERENCE, MODEL) == pytest.approx(6 / 8)
    assert landmarks.lmd_atvgnet_v1(REFERENCE, MODEL) == pytest.approx(6 / 2)


def test_in_mouth_widths_the_size_of_the_picture_does_not_matter():
    assert landmarks.lmd_mw_v1(REFERENCE, MODEL, (0, 1)) == pytest.approx(6 / 8 / 8)
    assert landmarks.lmd_mw_v1(REFERENCE, 10 * MODEL, (0, 1)) == pytest.approx(6 / 8 / 8)


def test_size_place_and_tilt_are_no_error_but_movement_is():
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    turned = 2.5 * REFERENCE @ turn.T + np.array([40.0, -7])
    assert landmarks.lmd_similarity_v1(REFERENCE, turned, (0, 1)) == pytest.approx(0, abs=1e-12)
    still = np.repeat(REFERENCE[:1], 2, axis=0)
    assert landmarks.lmd_similarity_v1(REFERENCE, still, (0, 1)) > 0.03
    mirrored = REFERENCE * np.array([1.0, -1])
    assert landmarks.lmd_similarity_v1(REFERENCE, mirrored, (0, 1)) > 0.03


def test_the_similarity_is_the_best_one():
    """Any small change of the transform found by searching makes the sum of squares larger."""
    from scipy.optimize import minimize

    rng = np.random.default_rng(1)
    reference, model = rng.normal(size=(2, 3, 5, 2))

    def apart(parameters):
        a, b, dx, dy = parameters  # s R = [[a, -b], [b, a]]
        moved = model @ np.array([[a, -b], [b, a]]).T + np.array([dx, dy])
        return moved - reference

    best = minimize(lambda p: (apart(p) ** 2).sum(), np.array([1.0, 0, 0, 0]), tol=1e-14).x
    expected = np.linalg.norm(apart(best), axis=2).mean() / np.median(
        np.linalg.norm(np.diff(reference[:, :2], axis=1), axis=2)
    )
    assert landmarks.lmd_similarity_v1(reference, model, (0, 1)) == pytest.approx(expected, rel=1e-6)


def test_frames_that_are_not_known_are_left_out():
    gap = np.concatenate([MODEL, np.full((1, 4, 2), np.nan)])
    longer = np.concatenate([REFERENCE, REFERENCE[:1]])
    assert landmarks.evaluate(longer, gap, corners=(0, 1)) == landmarks.evaluate(REFERENCE, MODEL, corners=(0, 1))
    with pytest.raises(InputError, match="known in both sequences, found none"):
        landmarks.validate(REFERENCE, np.full((2, 4, 2), np.nan))


def test_silent_lip_stability_by_hand():
    """Openings of 1, 2, 3, 10 between eyes 2 apart: 0.5, 1, 1.5, 5; mean 2; deviations 1.5, 1, 0.5, 3; median 1.25."""
    points = np.zeros((6, 4, 2))
    points[:, 1, 1] = [1, 2, 3, 10, 50, np.nan]
    points[:, 3, 0] = 2
    silent = np.array([True, True, True, True, False, True])
    score = landmarks.silent_lip_stability_theval_v1
    assert score(points, silent, upper=[0], lower=[1], eyes=[2, 3]) == pytest.approx(1.25)
    assert np.isnan(score(points, np.array([True] + [False] * 5), upper=[0], lower=[1], eyes=[2, 3]))
    with pytest.raises(InputError, match="each of the 6 frames"):
        score(points, silent[:3], upper=[0], lower=[1], eyes=[2, 3])
    with pytest.raises(InputError, match="as many points of the upper"):
        score(points, silent, upper=[0, 1], lower=[1], eyes=[2, 3])
    with pytest.raises(InputError, match="between 0 and 3, got 191"):
        score(points, silent)


def test_evaluate_gives_all_by_name():
    names = [row.name for row in METRICS.values() if row.family == "landmarks"]
    assert list(landmarks.evaluate(REFERENCE, MODEL, corners=(0, 1))) == names[:-1]
    assert list(landmarks.evaluate(REFERENCE, MODEL)) == names[:3]


def test_bad_input_is_named():
    with pytest.raises(InputError, match=r"\(frames, points, 2 or 3\)"):
        landmarks.lmd_raw_v1(REFERENCE[0], MODEL[0])
    with pytest.raises(InputError, match="as many frames"):
        landmarks.lmd_raw_v1(REFERENCE, MODEL[:1])
    with pytest.raises(InputError, match="landmarks 2 and 2 coincide"):
        landmarks.lmd_mw_v1(REFERENCE, MODEL, (2, 2))
    with pytest.raises(InputError, match="all coincide"):
        landmarks.lmd_similarity_v1(REFERENCE, np.zeros_like(MODEL), (0, 1))
