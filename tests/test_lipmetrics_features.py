import numpy as np
import pytest
from drawn_mouth import opened, plain
from scipy.ndimage import uniform_filter

from lipmetrics import features
from lipmetrics.box import ASPECT, CANVAS, COARSE, MOUTH
from lipmetrics.features import BLUR_WIDTHS, OCTAVE, PAD, REACH

INNER = (slice(None), *(slice(pad, -pad) for pad in PAD))


def face(size=COARSE):
    """(*size, 3) uint8: a face that fills a canvas as the method lays it; no pixel is near black or white."""
    picture = plain(opened(0.2), (size[0], ASPECT * size[1]), ASPECT * MOUTH * size[1] / CANVAS[1]).picture
    return (60 + picture[:, ::ASPECT] * (130 / 255)).astype(np.uint8)


def gained(picture, *gains):
    return np.clip(np.round(picture * np.array(gains)), 0, 255).astype(np.uint8)


def test_log_ratios_are_the_logarithms_they_say():
    rgb = np.random.default_rng(0).integers(0, 256, (9, 13, 3), dtype=np.uint8)
    ratios = features.log_ratios(rgb)
    assert ratios.shape == (3, 9, 13)
    red, green, blue = np.moveaxis(rgb.astype(float), 2, 0)
    grey = np.floor(0.299 * red + 0.587 * green + 0.114 * blue)
    light = OCTAVE * np.log2(grey + 4)
    assert np.abs(ratios[0] - light).max() < OCTAVE * np.log2(5 / 4) + 1  # grey is off by a step at most
    assert np.abs(ratios[0] - light).mean() < 2
    for plane, colour in ((1, red), (2, blue)):
        assert np.abs(ratios[plane] - OCTAVE * np.log2((colour + 8) / (green + 8))).max() <= 1


@pytest.mark.parametrize("step", [1, 3])
def test_quantiles_agree_with_numpy(step):
    rng, shares = np.random.default_rng(0), np.array([0.1, 0.5, 0.9])
    ratios = rng.normal(-200, 300, (3, 200, 310)).astype(np.int16)
    kinds = rng.integers(-1, 3, ratios.shape[1:]).astype(np.int8)
    found = features._quantiles(ratios, kinds, step, shares)
    for kind in (0, 1):
        chosen = ratios[:, ::step, ::step][:, kinds[::step, ::step] == kind]
        assert found[kind] == pytest.approx(np.quantile(chosen, shares, axis=1).T, abs=8)


SURE = 3.0


def test_references_are_medians_of_the_lips_without_the_opening_and_of_the_skin():
    ratios = features.log_ratios(face(CANVAS))
    rows, cols = np.indices(CANVAS)
    away = np.hypot(rows - 60, cols - 32)
    opening = np.where(away < 10, SURE, -SURE).astype(np.float32)
    where = (rows < 15) | (rows >= 40)
    lip = np.where(away < 14, SURE, np.where(rows < 40, -SURE, -0.5)).astype(np.float32)  # -0.5: neither lip nor skin
    is_lip, is_skin = (away < 14) & (away >= 10), rows < 15
    ratios[:, ~is_lip & ~is_skin] -= 700  # most pixels, and none of them may count
    expected = [np.median(ratios[:, chosen], axis=1) for chosen in (is_lip, is_skin)]
    assert features.references(ratios, lip, opening, where) == pytest.approx(np.array(expected), abs=8)


@pytest.mark.parametrize("missing", [0, 1])
def test_all_pixels_stand_in_for_lips_or_skin_of_which_there_are_too_few(missing):
    ratios = features.log_ratios(face(CANVAS))
    ratios[:, 0] -= 700  # the few are unlike the rest
    where, no_opening = np.ones(CANVAS, bool), np.full(CANVAS, -SURE, np.float32)
    few = np.full(CANVAS, (-SURE, SURE)[missing], np.float32)
    few[0, :29] *= -1  # every second pixel is looked at: 15 of them
    everywhere = np.median(ratios, axis=(1, 2))
    middles = features.references(ratios, few, no_opening, where)
    assert middles == pytest.approx(np.array([everywhere, everywhere]), abs=8)
    few[0, 29:31] *= -1  # 16 are enough
    middles = features.references(ratios, few, no_opening, where)
    assert middles[missing] == pytest.approx(np.median(ratios[:, 0, :31:2], axis=1), abs=8)
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
    assert (maps.shape, maps.dtype) == ((count, size[0] + 2 * PAD[0], size[1] + 2 * PAD[1]), np.uint8)
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
    row0, row1, col0, col1 = region = (5 * size[0] // 8, size[0] - 6, 11, size[1])
    part, whole = maps_of(picture, region), maps_of(picture)
    assert np.array_equal(part, whole[:, row0 : row1 + 2 * PAD[0], col0 : col1 + 2 * PAD[1]])


def edge_on(plane, reach):
    """(H + 2 reach[0], W + 2 reach[1]) float64: the plane with its edge going on."""
    return np.pad(plane.astype(float), [(n, n) for n in reach], mode="edge")


def quantised(plane, middle, gain):
    """In steps of 1/1024, as close as the method knows its gains."""
    slope, level = np.round(1024 * gain), np.round(1024 * (128.5 - gain * middle))
    return np.clip(np.floor((slope * edge_on(plane, REACH) + level) / 1024), 0, 255)


def blurred(padded, box):
    """Means of box x BLUR_WIDTHS[box] pixels to the nearest whole number, of a plane padded by REACH; padded by PAD."""
    mean = uniform_filter(padded, (box, BLUR_WIDTHS[box]))
    return np.floor(mean + 0.5)[tuple(slice(reach - pad, pad - reach) for reach, pad in zip(REACH, PAD, strict=True))]


def test_coarse_maps_are_blurs_of_the_ratios_relative_to_the_middle():
    picture = face(COARSE)
    ratios, maps = features.log_ratios(picture), iter(coarse(picture))
    everywhere = np.zeros(COARSE, np.int8)
    quantiles = features._quantiles(ratios, everywhere, 2, np.array([0.1, 0.5, 0.9]))[0]
    for plane, gain, (low, middle, high) in zip(ratios, features.GAINS, quantiles, strict=True):
        for factor in (gain, features.SPREAD_GAIN / max(high - low, features.MIN_SPREAD)):
            for box in features.COARSE_BLURS:
                assert np.array_equal(next(maps), blurred(quantised(plane, middle, factor), box)), box
    assert len(list(maps)) == 2


def test_fine_maps_are_blurs_relative_to_lips_and_skin_and_of_the_log_odds():
    rng = np.random.default_rng(0)
    ratios, middles = features.log_ratios(face(CANVAS)), rng.normal(0, 60, (2, 3))
    odds = rng.normal(0, 3, (3, *CANVAS)).astype(np.float32)
    maps = iter(features.fine_maps(ratios, middles, odds))
    for c, gain in enumerate(features.GAINS):
        for k, boxes in enumerate(features.FINE_BLURS):
            for box in boxes:
                expected = blurred(quantised(ratios[c], middles[k, c], gain), box)
                assert np.array_equal(next(maps), expected), (c, k, box)
    for plane in odds:
        padded = np.floor(np.clip(128 + 24 * edge_on(plane, REACH), 0, 255))
        for box in features.ODDS_BLURS:
            assert np.array_equal(next(maps), blurred(padded, box)), box
    lip = np.clip(0.25 * odds[0] + 0.5, 0, 1)
    total = 1e-3 + lip.sum(axis=0)
    share = edge_on(np.floor(255 * lip.cumsum(axis=0) / total), PAD)
    share[: PAD[0]] = 0  # above the canvas there is no lip yet
    assert np.array_equal(next(maps), share)
    assert np.array_equal(next(maps), edge_on(np.floor(np.minimum(4 * total, 255)) * np.ones(CANVAS), PAD))


@pytest.mark.parametrize("box", sorted({*features.COARSE_BLURS, *sum(features.FINE_BLURS, ()), *features.ODDS_BLURS}))
def test_every_sum_a_box_can_have_is_divided_and_rounded_right(box):
    area = box * BLUR_WIDTHS[box]
    sums = np.arange(255 * area + 1, dtype=np.uint64)
    half, times = area // 2, (1 << 23) // area + (box > 1)
    assert ((sums + half) * times < 1 << 32).all()
    assert np.array_equal(((sums + half) * times) >> 23, (sums + half) // area)


def test_place_in_the_lips_runs_from_their_upper_to_their_lower_edge():
    share, amount = fine(face(CANVAS))[-4:-2][INNER]
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
    inner_rows, inner_cols = rows[PAD[0] : -PAD[0], 0], cols[0, PAD[1] : -PAD[1]]
    assert inner_rows == pytest.approx(np.linspace(0, 255, size[0]), abs=1)
    assert inner_cols == pytest.approx(np.linspace(0, 255, size[1]), abs=1)
    assert (rows[: PAD[0]] == 0).all()
    assert (rows[-PAD[0] :] == 255).all()


@pytest.mark.parametrize("value", [0, 128, 255])
def test_a_picture_of_one_colour_is_like_its_own_middle_everywhere(value):
    maps = coarse(np.full((*COARSE, 3), value, np.uint8))
    assert np.abs(maps[:-2].astype(int) - 128).max() <= 16
