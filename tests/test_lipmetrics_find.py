from dataclasses import replace

import numpy as np
import pytest
from drawn_mouth import AskedFrame

from lipmetrics import find
from lipmetrics.box import Box


def grey(height, width):
    return AskedFrame(np.full((height, width, 3), 128, np.uint8))


def by_width(place):
    """The boxes of a place, in their order, by how wide they are."""
    boxes = {}
    for box in place.boxes:
        boxes.setdefault(box.width_px, []).append(box)
    return boxes


@pytest.mark.parametrize(("height", "width"), [(360, 480), (480, 360), (70, 90), (1080, 1920)])
def test_without_a_face_mouths_of_every_size_are_tried_everywhere(height, width):
    rng = np.random.default_rng(0)
    widths = []
    for place in find.places(grey(height, width)):
        assert not place.is_face
        assert place.rectangle == (0, 0, width, height)
        for wide, boxes in by_width(place).items():
            widths.append(wide)
            assert all(box.roll_rad == 0 for box in boxes)
            middles = np.array([(box.row, box.col) for box in boxes])
            assert (middles >= 0).all()
            assert (middles < (height, width)).all()
            room = np.array([(0.45 * wide, height - 1 - 0.45 * wide), (0.6 * wide, width - 1 - 0.6 * wide)])
            for _ in range(30):  # any mouth that lies in the picture has a box near it
                mouth = np.array([rng.uniform(*span) if span[0] < span[1] else span.mean() for span in room])
                assert np.abs(middles - mouth).max(axis=1).min() <= 0.55 * find.STRIDE * wide
    assert widths == sorted(widths, reverse=True)
    assert max(widths) <= 0.75 * width
    assert (np.array(widths[:-1]) / widths[1:] < 1.5).all()


def test_the_middle_of_the_picture_comes_first():
    for place in find.places(grey(300, 400)):
        for boxes in by_width(place).values():
            away = [abs(box.row - 149.5) + abs(box.col - 199.5) for box in boxes]
            assert away == sorted(away)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (8, 8), (2, 300), (300, 2), (39, 39)])
def test_pictures_too_small_for_a_face_are_no_trouble(height, width):
    assert find.faces(grey(height, width)) == []
    for place in find.places(grey(height, width)):
        assert all(isinstance(box, Box) for box in place.boxes)


class Cascade:
    """A face detector that sees these (left, top, width, height), px of the picture it is shown."""

    def __init__(self, *seen):
        self.seen = seen

    def detectMultiScale(self, picture, **_):
        assert max(picture.shape) == find.FACE_SIDE
        return np.array(self.seen)


def test_faces_are_given_in_px_of_the_picture_largest_first(monkeypatch):
    monkeypatch.setattr(find, "_cascade", lambda name: Cascade((10, 20, 50, 50), (100, 40, 120, 120)))
    assert find.faces(grey(960, 1280)) == [
        (400, 160, 480, 480),
        (40, 80, 200, 200),
    ]  # searched at a quarter of its size


def test_the_second_face_detector_is_asked_only_if_the_first_sees_nothing(monkeypatch):
    first, second = find.CASCADES
    cascades = {first: Cascade(), second: Cascade((10, 20, 50, 50))}
    monkeypatch.setattr(find, "_cascade", cascades.get)
    assert find.faces(grey(240, 320)) == [(10, 20, 50, 50)]
    cascades[first] = Cascade((30, 20, 60, 60))
    assert find.faces(grey(240, 320)) == [(30, 20, 60, 60)]


def test_the_mouths_of_the_faces_are_tried_first(monkeypatch):
    faces = [(400.0, 160.0, 480.0, 480.0), (40.0, 80.0, 200.0, 200.0)]
    monkeypatch.setattr(find, "faces", lambda frame: faces)
    places = list(find.places(grey(960, 1280)))
    assert [place.rectangle for place in places[:3]] == [*faces, (0, 0, 1280, 960)]
    assert [place.is_face for place in places] == [True, True, *[False] * (len(places) - 2)]
    for (left, top, side, _), place in zip(faces, places, strict=False):
        for box in place.boxes:
            assert box.col == left + side / 2
            assert top + 0.65 * side < box.row < top + 0.95 * side
            assert 0.25 * side < box.width_px < 0.6 * side
            assert place.likelihood(box) > 0.5


FACE = find.Place([], (100.0, 200.0, 300.0, 400.0), (0.8, 0.5, 0.4), (0.1, 0.15, 0.5), least=0.0, is_face=True)


@pytest.mark.parametrize(
    ("box", "spreads_away"),
    [
        (Box(520.0, 250.0, 120.0), 0),
        (Box(560.0, 250.0, 120.0), 1),
        (Box(440.0, 250.0, 120.0), 2),
        (Box(520.0, 205.0, 120.0), 1),
        (Box(520.0, 250.0, 120.0 * np.exp(-0.5)), 1),
        (Box(480.0, 295.0, 120.0 * np.exp(1.0)), np.sqrt(1 + 1 + 4)),
    ],
)
def test_a_mouth_is_the_less_likely_the_farther_it_is_from_where_mouths_are(box, spreads_away):
    assert FACE.likelihood(box) == pytest.approx(np.exp(-0.5 * spreads_away**2))


def test_no_place_is_less_likely_than_the_least():
    far = Box(5000.0, 250.0, 120.0)
    assert FACE.likelihood(far) == pytest.approx(0.0)
    assert replace(FACE, least=0.5).likelihood(far) == pytest.approx(0.5)


def test_how_likely_a_mouth_is_does_not_depend_on_the_size_of_the_picture():
    box, large = Box(500.0, 220.0, 100.0), Box(1000.0, 440.0, 200.0)
    twice = replace(FACE, rectangle=tuple(2 * side for side in FACE.rectangle))
    assert twice.likelihood(large) == pytest.approx(FACE.likelihood(box))
