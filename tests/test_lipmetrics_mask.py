from dataclasses import replace

import numpy as np
import pytest
from ring_mouth import DARK, LIP, SKIN, ring

from lipmetrics import detect, mask, still
from lipmetrics.errors import InputError
from lipmetrics.look import CLOSED, NO_MOUTH, OPEN
from lipmetrics.openings import measure_outline


def seen(picture, **settings):
    return still.look_at(picture, method="thesis", settings=mask.ThesisSettings(**settings))


@pytest.mark.parametrize(("half_heights", "status"), [((0,), CLOSED), ((8,), OPEN), ((8, 6), OPEN)])
def test_openings_are_the_holes_in_the_lips(half_heights, status):
    look = seen(ring(*half_heights))
    assert look.status == status
    assert len(look.outlines) == np.count_nonzero(half_heights)


def test_an_opening_is_measured_where_it_was_drawn():
    opening = measure_outline(seen(ring(8)).outlines[0])
    assert opening.width_px == pytest.approx(25, abs=2)
    assert opening.height_px == pytest.approx(17, abs=2)
    assert (opening.centroid_row, opening.centroid_col) == pytest.approx((45, 50), abs=0.5)


def test_corners_are_the_ends_of_the_lips():
    look = seen(ring(8))
    assert look.corners == pytest.approx(np.array([[45, 9.5], [45, 90.5]]), abs=1)
    assert look.lip_width_px == pytest.approx(81, abs=2)
    lips = np.zeros((9, 12), bool)
    lips[3:6, 4:8] = True
    assert mask.lip_corners(lips).tolist() == [[4.0, 3.5], [4.0, 7.5]]


def test_white_teeth_belong_to_the_opening():
    picture = ring(10)
    picture[38:44, 42:58] = 235
    assert measure_outline(seen(picture).outlines[0]).height_px == pytest.approx(21, abs=2)


def test_a_red_tongue_inside_belongs_to_the_opening():
    picture = ring(12)
    picture[44:50, 45:55] = LIP
    opening = measure_outline(seen(picture).outlines[0])
    assert opening.height_px == pytest.approx(25, abs=2)
    assert opening.area_px == pytest.approx(np.pi * 12 * 12, rel=0.15)


def test_a_broken_ring_encloses_nothing():
    picture = ring(8)
    picture[40:50, :50] = SKIN
    assert seen(picture).status == CLOSED


@pytest.mark.parametrize("value", [0, 128, 255])
def test_a_flat_picture_has_no_mouth(value):
    assert seen(np.full((40, 60, 3), value, np.uint8)).status == NO_MOUTH


def test_a_black_start_does_not_decide_the_gains():
    detector = mask.ThesisDetector(mask.ThesisSettings(gain_frames=1))
    looks = [detector.look(still._Still(picture)) for picture in (np.zeros_like(ring(8)), ring(8))]
    assert [look.status for look in looks] == [NO_MOUTH, OPEN]
    assert looks[1].outlines[0] == pytest.approx(seen(ring(8)).outlines[0])


def test_noise_and_tiny_pictures_do_not_crash():
    rng = np.random.default_rng(1)
    for shape in ((1, 1, 3), (8, 8, 3), (50, 70, 3)):
        assert seen(rng.integers(0, 256, shape, dtype=np.uint8)).status in (OPEN, CLOSED, NO_MOUTH)


@pytest.mark.parametrize("cast", [(1.0, 1.0, 1.0), (1.0, 0.85, 0.7), (0.8, 0.9, 1.0)])
def test_the_colour_of_the_light_does_not_matter(cast):
    picture = (ring(8) * np.array(cast)).astype(np.uint8)
    assert measure_outline(seen(picture).outlines[0]).height_px == pytest.approx(17, abs=2)


def test_scores_are_one_half_at_their_thresholds():
    rgb = np.array([[[110, 90, 90], [200, 100, 100], [90, 90, 90], [90, 110, 90]]], np.uint8)
    assert mask.red_green_score(rgb, 0.1)[0] == pytest.approx([0.5, 1.0, 0.0, 0.0])
    assert mask.hue_score(rgb, 0.0, 15.0, 0.1)[0] == pytest.approx([1.0, 1.0, 0.0, 0.0])
    orange = np.array([[[200, 125, 100]]], np.uint8)  # hue 15 degrees
    assert mask.hue_score(orange, 0.0, 15.0, 0.1)[0, 0] == pytest.approx(0.5, abs=0.05)
    assert mask.hue_score(orange, 345.0, 60.0, 0.1)[0, 0] == pytest.approx(0.75, abs=0.05)  # across 0 degrees


def test_correlation_decides_between_two_opinions():
    a, b = np.array([0.9]), np.array([0.2])
    assert [float(how(a, b)[0]) for how in mask.CORRELATIONS.values()] == pytest.approx([0.9, 0.2, 0.55])


def test_gains_are_estimated_once_per_clip():
    detector = mask.ThesisDetector(mask.ThesisSettings(gain_frames=1, median_px=1))
    bright = detector.enhanced(ring(8))
    half = detector.enhanced(ring(8) // 2)
    assert np.abs(half.astype(int) - bright // 2).max() <= 6  # not stretched to full scale again


def test_a_region_is_answered_in_coordinates_of_the_picture():
    picture = ring(8)
    whole = mask.ThesisDetector(mask.ThesisSettings()).look(still._Still(picture))
    part = mask.ThesisDetector(mask.ThesisSettings(), (10, 80, 5, 115)).look(still._Still(picture))
    assert part.outlines[0] == pytest.approx(whole.outlines[0])
    assert part.corners == pytest.approx(whole.corners)


def test_roi_of_any_method_is_answered_in_coordinates_of_the_picture():
    picture = ring(8)
    picture[:8, :] = LIP  # a red bar outside the region
    info = replace_info(picture)
    look = detect.make_detector("thesis", None, info, (10, 80, 5, 115)).look(still._Still(picture))
    opening = measure_outline(look.outlines[0])
    assert (opening.centroid_row, opening.centroid_col) == pytest.approx((45, 50), abs=0.5)
    with pytest.raises(InputError, match=r"inside the picture of 120 x 80 px, got X,Y,W,H = 5,10,120,70"):
        detect.make_detector("thesis", None, info, (10, 80, 5, 125))


def replace_info(picture):
    from lipmetrics.frames import VideoInfo

    empty = dict.fromkeys(VideoInfo.__dataclass_fields__)
    return replace(VideoInfo(**empty), height=picture.shape[0], width=picture.shape[1])


def test_settings_name_every_fault():
    with pytest.raises(InputError, match="odd median_px of at least 1, got 4; correlation to be one of or, and, mean"):
        mask.ThesisSettings(median_px=4, correlation="xor")


def test_unknown_method_names_the_nearest():
    with pytest.raises(InputError, match="got 'thesys'; did you mean 'thesis'"):
        still.look_at(ring(8), method="thesys")


@pytest.mark.parametrize(
    "picture", [np.zeros((4, 4), np.uint8), np.zeros((4, 4, 3)), None, np.zeros((0, 4, 3), np.uint8)]
)
def test_only_rgb_pictures_are_taken(picture):
    with pytest.raises(InputError, match="expected one"):
        still.look_at(picture, method="thesis")


def test_opening_mask_and_find_openings_agree():
    picture = ring(8, 5)
    openings = still.find_openings(picture, method="thesis")
    shown = still.opening_mask(picture, method="thesis")
    assert len(openings) == 2 and openings[0].area_px > openings[1].area_px
    assert shown.shape == picture.shape[:2] and shown.dtype == bool
    assert shown.sum() == sum(opening.area_px for opening in openings)
    assert tuple(picture[tuple(np.argwhere(shown)[len(np.argwhere(shown)) // 2])]) == DARK
    assert not still.opening_mask(ring(0), method="thesis").any()
