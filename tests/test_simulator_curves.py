import numpy as np
import pytest

from simulator import curves
from simulator.curves import KeyFrames, LoadShape, read_key_frames, write_key_frames
from simulator.errors import InputError

LISTING_3_1 = "0.0 0.0\nlinear\n0.1 0.2\ngeometric\n0.5 0.6\nquarter_sin\n1.0 1.0\n"


@pytest.fixture
def rng():
    return np.random.default_rng(31)


@pytest.fixture
def listing(tmp_path):
    path = tmp_path / "listing.txt"
    path.write_text(LISTING_3_1)
    return read_key_frames(path)


def slope(curve, t, h=1e-7):
    return (curve.value(t + h) - curve.value(t - h)) / (2 * h)


# -- load shapes ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name, at, expected",
    [
        ("POLY345", [0, 0.5, 1, 2], [0, 0.5, 1, 10 * 8 - 15 * 16 + 6 * 32]),
        ("RAMP", [0, 0.25, 1, 1.5], [0, 0.25, 1, 1.5]),
        ("STEP", [0, 1e-9, 1, 1.5], [0, 1, 1, 1]),
        ("HILLY", [0, 0.25, 0.5, 1], [0, 0.25 * np.exp(-2), 0.5, 1]),
        ("RAMPHOLD", [0, 0.05, 0.1, 1], [0, 0.5, 1, 1]),
    ],
)
def test_named_shapes_at_known_points(name, at, expected):
    shape = LoadShape(name, duration_s=4.0)
    np.testing.assert_allclose(shape.value(4.0 * np.array(at)), expected, atol=1e-9)


@pytest.mark.parametrize("name", curves.LOAD_SHAPES)
def test_rates_of_named_shapes_are_their_differences(name, rng):
    shape = LoadShape(name, duration_s=2.5)
    t = rng.uniform(0.001, 3.0, size=(40, 3))
    t = t[np.abs(t - 0.25) > 1e-3]  # the corner of RAMPHOLD
    np.testing.assert_allclose(shape.rate(t), slope(shape, t), atol=2e-7)


@pytest.mark.parametrize("name", curves.LOAD_SHAPES)
def test_named_shapes_are_zero_before_the_start(name):
    shape = LoadShape(name, duration_s=1.0)
    assert shape.value(-0.1) == 0 and shape.rate(-0.1) == 0


def test_shape_of_time_is_kept(listing):
    for curve in (LoadShape("HILLY", 1.0), listing):
        assert isinstance(curve.value(0.3), float) and isinstance(curve.rate(0.3), float)
        assert curve.value(np.zeros((2, 3))).shape == (2, 3) == curve.rate(np.zeros((2, 3))).shape
        assert np.isnan(curve.value(np.nan)) and np.isnan(curve.rate(np.nan))


def test_unknown_shape_names_the_nearest():
    with pytest.raises(InputError, match="got 'ramphld'; did you mean 'RAMPHOLD'"):
        LoadShape("ramphld", 1.0)


@pytest.mark.parametrize("duration", [0, -1, np.nan, np.inf])
def test_duration_above_zero(duration):
    with pytest.raises(InputError, match="above 0 s"):
        LoadShape("RAMP", duration)


# -- key frames -------------------------------------------------------------------------------------------------------


def test_listing_of_the_thesis_at_known_points(listing):
    assert listing == KeyFrames((0, 0.1, 0.5, 1), (0, 0.2, 0.6, 1), ("linear", "geometric", "quarter_sin"))
    expected = {0: 0, 0.05: 0.1, 0.1: 0.2, 0.3: (0.2 * 0.6) ** 0.5, 0.5: 0.6, 0.75: 0.6 + 0.4 * 0.5**0.5, 1: 1}
    np.testing.assert_allclose(listing.value(list(expected)), list(expected.values()), rtol=1e-14)


def test_held_before_and_after(listing):
    curve = KeyFrames((1, 2), (3, 4), ("linear",))
    assert list(curve.value([-5, 0.99, 2, 7, np.inf])) == [3, 3, 4, 4, 4]
    assert list(curve.rate([-5, 0.99, 1, 2, 7])) == [0, 0, 1, 0, 0]


def test_one_key_frame_is_a_constant():
    curve = KeyFrames((0.5,), (2,), ())
    assert list(curve.value([0, 0.5, 1])) == [2, 2, 2] and list(curve.rate([0, 0.5, 1])) == [0, 0, 0]


@pytest.mark.parametrize("segment", curves.SEGMENTS)
@pytest.mark.parametrize("values", [(0.2, 0.9), (5.0, 1e-3), (-0.1, -4.0), (2.0, 2.0)])
def test_rates_of_segments_are_their_differences_and_ends_meet(segment, values, rng):
    curve = KeyFrames((0.3, 1.1), values, (segment,))
    t = np.concatenate([rng.uniform(0.31, 1.09, 30), rng.uniform(-1, 0.29, 5), rng.uniform(1.11, 2, 5)])
    np.testing.assert_allclose(curve.rate(t), slope(curve, t), atol=3e-7 * max(np.abs(values)))
    first, last = curve.value([0.3, np.nextafter(1.1, 0)])
    assert first == values[0] and last == pytest.approx(values[1], rel=1e-14)


def test_rate_at_a_key_frame_is_that_of_the_segment_it_starts(listing):
    ratio = np.log(3) / 0.4
    np.testing.assert_allclose(listing.rate([0, 0.1, 0.5, 1]), [2, 0.2 * ratio, 0.4 / 0.5 * np.pi / 2, 0], rtol=1e-14)
    before = np.nextafter([0.1, 0.5, 1], 0)
    np.testing.assert_allclose(listing.rate(before), [2, 0.6 * ratio, 0], rtol=1e-12, atol=1e-12)


def test_geometric_over_many_orders():
    curve = KeyFrames((0, 1), (1e-300, 1e300), ("geometric",))
    assert curve.value(0.5) == pytest.approx(1, rel=1e-12)


@pytest.mark.parametrize(
    "arguments, message",
    [
        (((0, 0), (0, 1), ("linear",)), "increasing time, got 0.0 s after 0.0 s"),
        (((1, 0), (0, 1), ("linear",)), "increasing time, got 0.0 s after 1.0 s"),
        (((0, 1), (0, np.nan), ("linear",)), "finite times and values, got key frame 2"),
        (((0, np.inf), (0, 1), ("linear",)), "finite times and values"),
        (((0, 1), (0, 1), ("geometric",)), "geometric segment between two values of one sign"),
        (((0, 1), (-1, 1), ("geometric",)), "use linear"),
        (((0, 1), (-1, 0), ("geometric",)), "got -1.0 and 0.0 from 0.0 to 1.0 s"),
        (((0, 1), (0, 1), ("quarter_sine",)), "did you mean 'quarter_sin'"),
        (((0, 1), (0,), ("linear",)), "2 times, 1 values"),
        (((0, 1), (0, 1), ()), "0 segments"),
        (((), (), ()), "0 times"),
    ],
)
def test_bad_key_frames(arguments, message):
    with pytest.raises(InputError, match=message):
        KeyFrames(*arguments)


# -- files ------------------------------------------------------------------------------------------------------------


def test_printed_line_numbers_comments_and_gaps_are_read_over(tmp_path, listing):
    numbered = tmp_path / "numbered.txt"
    numbered.write_text("".join(f"{i} {line}\n" for i, line in enumerate(LISTING_3_1.splitlines(), start=1)))
    commented = tmp_path / "commented.txt"
    commented.write_text("# jaw\r\n\r\n" + LISTING_3_1.replace("\n", "   # why\r\n\r\n"), encoding="utf-8-sig")
    assert read_key_frames(numbered) == listing == read_key_frames(commented)


def test_written_file_reads_back_equal(tmp_path, rng):
    times, values = np.cumsum(rng.uniform(0.01, 1, 9)), rng.uniform(1e-6, 1, 9)
    curve = KeyFrames(times, values, rng.choice(curves.SEGMENTS, 8))
    write_key_frames(curve, tmp_path / "new" / "curve.txt")
    assert read_key_frames(tmp_path / "new" / "curve.txt") == curve


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "got none"),
        ("# only a comment\n", "got none"),
        ("0 0\nlinera\n1 1\n", "line 2: .*got 'linera'; did you mean 'linear'"),
        ("0 0\n1 1\n", "line 2: expected a segment .* got '1 1'"),
        ("0 0\nlinear\n", "line 2: expected a key frame after 'linear'"),
        ("0 0\nlinear\n1 one\n", "line 3: expected a key frame 'time value' in finite numbers, got '1 one'"),
        ("0 0\nlinear\n1\n", "line 3: expected a key frame"),
        ("0 nan\n", "line 1: expected a key frame"),
        ("1 0\n\nlinear\n0.5 1\n", "line 4: expected key frames in increasing time"),
        ("0 0\ngeometric\n1 1\n", "line 3: expected a geometric segment"),
        ("linear\n0 0\n", "line 1: expected a key frame"),
    ],
)
def test_bad_files_name_the_line(tmp_path, text, message):
    path = tmp_path / "bad.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_key_frames(path)
    assert "bad.txt" in str(caught.value) and "\n" not in str(caught.value)


def test_missing_and_binary_files(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        read_key_frames(tmp_path / "none.txt")
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(InputError, match="it is not text"):
        read_key_frames(tmp_path / "picture.png")
