import numpy as np
import pytest

from lipmetrics.errors import InputError
from lipmetrics.metrics import METRICS, vertices

# Two frames, three vertices; the lips are vertices 0 and 1. Worked by hand:
# frame 0: model vertex 0 is off by (3, 4, 0), 5 long; frame 1: vertex 1 by (0, 0, 2), vertex 2, no lip, by 100
REFERENCE = np.array([[[0.0, 0, 0], [0, 1, 0], [9, 9, 9]], [[0, 0, 0], [0, 3, 0], [9, 9, 9]]])
MODEL = REFERENCE + np.array([[[3.0, 4, 0], [0, 0, 0], [0, 0, 0]], [[0, 0, 0], [0, 0, 2], [100, 0, 0]]])
LIPS = [0, 1]


def test_torchmetrics_squares_the_largest_error_of_each_frame():
    assert vertices.lve_torchmetrics_v1(REFERENCE, MODEL, LIPS) == pytest.approx((25 + 4) / 2)


def test_the_words_of_the_papers_are_not_squared():
    assert vertices.lve_max_v1(REFERENCE, MODEL, LIPS) == pytest.approx((5 + 2) / 2)
    # both errors in the first frame: only the larger one counts there, and none in the second
    both = REFERENCE + np.array([[[3.0, 4, 0], [0, 0, 2], [0, 0, 0]], np.zeros((3, 3))])
    assert vertices.lve_max_v1(REFERENCE, both, LIPS) == pytest.approx(5 / 2)


def test_meshtalk_centres_each_frame_first():
    # the mean of the lips moves by half of the one error, so both vertices are off by half of it
    assert vertices.lve_meshtalk_v1(REFERENCE, MODEL, LIPS) == pytest.approx((2.5 + 1) / 2)
    moved = REFERENCE + np.array([7.0, -2, 1])
    assert vertices.lve_meshtalk_v1(REFERENCE, moved, LIPS) == pytest.approx(0, abs=1e-12)


def test_mod_of_artalk_is_the_mean_error():
    assert vertices.mod_artalk_v1(REFERENCE, MODEL, LIPS) == pytest.approx((5 + 0 + 0 + 2) / 4)


def test_lip_distance_and_its_differences():
    np.testing.assert_allclose(vertices.lip_distance(REFERENCE, 0, 1), [1, 3])
    # model: frame 0 from (3, 4, 0) to (0, 1, 0), sqrt(18); frame 1 from the origin to (0, 3, 2), sqrt(13)
    np.testing.assert_allclose(vertices.lip_distance(MODEL, 0, 1), [np.sqrt(18), np.sqrt(13)])
    off = np.array([np.sqrt(18) - 1, np.sqrt(13) - 3])
    assert vertices.lip_distance_error_v1(REFERENCE, MODEL, 0, 1) == pytest.approx(off.sum() / 2)
    assert vertices.mod_msmd_v1(REFERENCE, MODEL, 0, 1) == pytest.approx(np.sqrt((off**2).sum() / 2 / 3))


def test_a_template_taken_from_both_changes_nothing():
    template = np.arange(9.0).reshape(3, 3)
    assert vertices.evaluate(REFERENCE - template, MODEL - template, LIPS) == pytest.approx(
        vertices.evaluate(REFERENCE, MODEL, LIPS)
    )


def test_the_same_as_torchmetrics():
    torch = pytest.importorskip("torch")
    lve = pytest.importorskip("torchmetrics.functional.multimodal").lip_vertex_error
    rng = np.random.default_rng(4)
    reference, model = rng.normal(size=(7, 30, 3)), rng.normal(size=(9, 30, 3))  # it cuts the longer one
    lips = [3, 5, 8, 21]
    theirs = lve(torch.tensor(model), torch.tensor(reference), mouth_map=lips)
    assert vertices.lve_torchmetrics_v1(reference, model, lips) == pytest.approx(float(theirs), rel=1e-12)


def test_the_same_as_codetalkers_steps():
    """An independent transcription of the steps: squares, sum over coordinates, largest of the lips, mean."""
    rng = np.random.default_rng(5)
    reference, model = rng.normal(size=(2, 6, 12, 3))
    slow = np.mean(
        [max(sum((model[t, v, k] - reference[t, v, k]) ** 2 for k in range(3)) for v in (1, 7)) for t in range(6)]
    )
    assert vertices.lve_torchmetrics_v1(reference, model, [1, 7]) == pytest.approx(slow)


def test_evaluate_gives_all_by_name():
    rows = [row for row in METRICS.values() if row.family == "vertices"]
    scores = vertices.evaluate(REFERENCE, MODEL, LIPS, upper=0, lower=1)
    assert list(scores) == [row.name for row in rows]
    assert scores["lve_max_v1"] == 3.5 and scores["mod_msmd_v1"] == vertices.mod_msmd_v1(REFERENCE, MODEL, 0, 1)
    assert "mod_msmd_v1" not in vertices.evaluate(REFERENCE, MODEL, LIPS)


def test_lengths_differ_only_where_it_is_asked_for():
    longer = np.concatenate([MODEL, MODEL + 50])
    assert vertices.lve_torchmetrics_v1(REFERENCE, longer, LIPS) == pytest.approx(14.5)  # part of its definition
    assert vertices.evaluate(REFERENCE, longer, LIPS, lengths="shorter")["lve_max_v1"] == pytest.approx(3.5)
    with pytest.raises(InputError, match="as many frames in the model as in the reference, got 4 and 2"):
        vertices.lve_max_v1(REFERENCE, longer, LIPS)
    with pytest.raises(InputError, match="as many frames"):
        vertices.evaluate(REFERENCE, longer, LIPS)


@pytest.mark.parametrize(
    ("reference", "lips", "message"),
    [
        (REFERENCE.reshape(2, 9), LIPS, r"\(2, 9\); reshape"),
        (REFERENCE[:0], LIPS, r"got \(0, 3, 3\)"),
        (np.where(REFERENCE == 9, np.nan, REFERENCE), LIPS, "first in frame 0"),
        (REFERENCE[:, :2], LIPS, "same points"),
        (REFERENCE, [0, 3], "between 0 and 2, got 3"),
        (REFERENCE, np.array([], int), "at least 1 whole number"),
        (REFERENCE, [0.5], "at least 1 whole number"),
        (REFERENCE, [True, False, False], "use np.flatnonzero"),
        ([["a"]], LIPS, "array of numbers"),
    ],
)
def test_bad_input_is_named(reference, lips, message):
    with pytest.raises(InputError, match=message):
        vertices.lve_max_v1(reference, MODEL, lips)


def test_bad_words_are_named():
    with pytest.raises(InputError, match="'equal' or 'shorter', got 'cut'"):
        vertices.validate(REFERENCE, MODEL, LIPS, lengths="cut")
    with pytest.raises(InputError, match="or neither"):
        vertices.evaluate(REFERENCE, MODEL, LIPS, upper=1)
    with pytest.raises(InputError, match="between 0 and 2, got 3546"):
        vertices.lip_distance(REFERENCE)
