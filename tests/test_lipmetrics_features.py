import numpy as np
import pytest
from drawn_mouth import opened, plain

from lipmetrics import features
from lipmetrics.box import CANVAS, COARSE, MOUTH
from lipmetrics.features import MAX_OFFSET, OCTAVE, PAD

INNER = (slice(None), slice(PAD, -PAD), slice(PAD, -PAD))


def face(size=COARSE):
    """(*size, 3) uint8: a face that fills a canvas as the method lays it; no pixel is near black or white."""
    picture = plain(opened(0.2), size, MOUTH * size[1] / CANVAS[1]).picture
    return (60 + picture * (130 / 255)).astype(np.uint8)


def gained(picture, *gains):
    return np.clip(np.round(picture * np.array(gains)), 0, 255).astype(np.uint8)


def test_log_ratios_are_the_logarithms_they_say():
    rgb = np.random.default_rng(0).integers(0, 256, (9, 13, 3), dtype=np.uint8)
    ratios = features.log_ratios(rgb)
    assert ratios.shape == (3, 9 + 2 * PAD, 13 + 2 * PAD)
    red, green, blue = np.moveaxis(rgb.astype(float), 2, 0)
    grey = np.floor(0.299 * red + 0.587 * green + 0.114 * blue)
    light = OCTAVE * np.log2(grey + 4)
    assert np.abs(ratios[INNER][0] - light).max() < OCTAVE * np.log2(5 / 4) + 1  # grey is off by a step at most
    assert np.abs(ratios[INNER][0] - light).mean() < 2
    for plane, colour in ((1, red), (2, blue)):
        assert np.abs(ratios[INNER][plane] - OCTAVE * np.log2((colour + 8) / (green + 8))).max() <= 1


def test_log_ratios_repeat_their_edge():
    ratios = features.log_ratios(np.random.default_rng(0).integers(0, 256, (9, 13, 3), dtype=np.uint8))
    assert np.array_equal(ratios, np.pad(ratios[INNER], ((0, 0), (PAD, PAD), (PAD, PAD)), mode="edge"))


@pytest.mark.parametrize("step", [1, 3])
def test_quantiles_agree_with_numpy(step):
    rng = np.random.default_rng(0)
    inner = rng.normal(-200, 300, (60, 70)).astype(np.int16)
    weight = rng.random((60, 70)) < 0.5
    plane = np.pad(inner, PAD, constant_values=2000)  # the padding must not count
    every = (slice(None, None, step), slice(None, None, step))
    expected = np.quantile(inner[every][weight[every]], (0.1, 0.5, 0.9))
    assert features._quantiles(plane, weight, PAD, step, 0.1, 0.5, 0.9) == pytest.approx(expected, abs=8)


SURE = 3.0


def test_references_are_medians_of_the_lips_without_the_opening_and_of_the_skin():
    ratios = features.log_ratios(face(CANVAS))
    rows, cols = np.indices(CANVAS)
    away = np.hypot(rows - 60, 0.5 * (cols - 64))
    opening = np.where(away < 10, SURE, -SURE).astype(np.float32)
    where = (rows < 15) | (rows >= 40)
    lip = np.where(away < 14, SURE, np.where(rows < 40, -SURE, -0.5)).astype(np.float32)  # -0.5: neither lip nor skin
    is_lip, is_skin = (away < 14) & (away >= 10), rows < 15
    ratios[INNER][:, ~is_lip & ~is_skin] -= 700  # most pixels, and none of them may count
    expected = [np.median(ratios[INNER][:, chosen], axis=1) for chosen in (is_lip, is_skin)]
    assert features.references(ratios, lip, opening, where) == pytest.approx(np.array(expected), abs=8)


@pytest.mark.parametrize("missing", [0, 1])
def test_all_pixels_stand_in_for_lips_or_skin_of_which_there_are_too_few(missing):
    ratios = features.log_ratios(face(CANVAS))
    ratios[INNER][:, 0] -= 700  # the few are unlike the rest
    where, no_opening = np.ones(CANVAS, bool), np.full(CANVAS, -SURE, np.float32)
    few = np.full(CANVAS, (-SURE, SURE)[missing], np.float32)
    few[0, :29] *= -1  # every second pixel is looked at: 15 of them
    everywhere = np.median(ratios[INNER], axis=(1, 2))
    middles = features.references(ratios, few, no_opening, where)
    assert middles == pytest.approx(np.array([everywhere, everywhere]), abs=8)
    few[0, 29:31] *= -1  # 16 are enough
    middles = features.references(ratios, few, no_opening, where)
    assert middles[missing] == pytest.approx(np.median(ratios[INNER][:, 0, :31:2], axis=1), abs=8)
    assert middles[1 - missing] == pytest.approx(everywhere, abs=8)


def coarse(picture, region=None):
    return features.coarse_maps(features.log_ratios(picture), region)


def fine(picture, region=None):
    ratios = features.log_ratios(picture)
    rows = np.arange(CANVAS[0])[:, None] * np.ones(CANVAS[1])
    odds = np.stack([3 - np.abs(rows - 56) / 4] * 3).astype(np.float32)
    return features.fine_maps(
        ratios, features.references(ratios, odds[0], -odds[0], np.ones(CANVAS, bool)), odds, region
    )


@pytest.mark.parametrize(("maps_of", "size", "count"), [(coarse, COARSE, 20), (fine, CANVAS, 22)])
def test_maps_hardly_change_with_light_and_white_balance(maps_of, size, count):
    picture = face(size)
    maps = maps_of(picture)
    assert (maps.shape, maps.dtype) == ((count, size[0] + 2 * PAD, size[1] + 2 * PAD), np.uint8)
    of_picture = maps[INNER][:12].astype(float)
    spread = of_picture.std(axis=(1, 2))
    assert spread.min() > 3
    for gains in ((0.7, 0.7, 0.7), (1.3, 1.3, 1.3), (1.15, 1.0, 0.85), (0.8, 0.9, 1.2)):
        change = np.abs(of_picture - maps_of(gained(picture, *gains))[INNER][:12]).mean(axis=(1, 2)) / spread
        assert change.max() < 0.5, gains
        assert change.mean() < 0.2, gains


@pytest.mark.parametrize(("maps_of", "size"), [(coarse, COARSE), (fine, CANVAS)])
def test_maps_of_a_part_are_that_part_of_the_maps(maps_of, size):
    picture = face(size)
    row0, row1, col0, col1 = region = (5 * size[0] // 8, size[0] - 6, 21, size[1])
    part, whole = maps_of(picture, region), maps_of(picture)
    seen = slice(PAD - MAX_OFFSET, MAX_OFFSET - PAD)  # farther out no forest looks
    expected = whole[:, row0 : row1 + 2 * PAD, col0 : col1 + 2 * PAD]
    assert part.shape == expected.shape
    assert np.array_equal(part[:, seen, seen], expected[:, seen, seen])


def test_place_in_the_lips_runs_from_their_upper_to_their_lower_edge():
    share, amount = fine(face(CANVAS))[-4:-2, PAD:-PAD, PAD:-PAD]
    assert (np.diff(share.astype(int), axis=0) >= 0).all()
    assert (share[:36] == 0).all()  # the lips are about row 56, some 30 rows of them
    assert (share[80:] >= 254).all()
    assert np.abs(share[56] - 128.0).max() < 8
    assert amount.min() == amount.max() > 60


@pytest.mark.parametrize(("maps_of", "size"), [(coarse, COARSE), (fine, CANVAS)])
def test_the_last_maps_are_the_place_on_the_canvas(maps_of, size):
    rows, cols = maps_of(face(size))[-2:]
    assert (rows[:, :1] == rows).all()
    assert (cols[:1] == cols).all()
    inner_rows, inner_cols = rows[PAD:-PAD, 0], cols[0, PAD:-PAD]
    assert inner_rows == pytest.approx(np.linspace(0, 255, size[0]), abs=1)
    assert inner_cols == pytest.approx(np.linspace(0, 255, size[1]), abs=1)
    assert (rows[:PAD] == 0).all()
    assert (rows[-PAD:] == 255).all()


@pytest.mark.parametrize("value", [0, 128, 255])
def test_a_picture_of_one_colour_is_like_its_own_middle_everywhere(value):
    maps = coarse(np.full((*COARSE, 3), value, np.uint8))
    assert np.abs(maps[:-2].astype(int) - 128).max() <= 16
