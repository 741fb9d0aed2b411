import numpy as np
import pytest
from drawn_mouth import AskedFrame

from lipmetrics import find
from lipmetrics.box import Box


def grey(height, width):
    return AskedFrame(np.full((height, width, 3), 128, np.uint8))


@pytest.mark.parametrize(("height", "width"), [(360, 480), (480, 360), (70, 90), (1080, 1920)])
def test_without_a_face_mouths_of_every_size_are_tried_everywhere(height, width):
    rng = np.random.default_rng(0)
    widths = []
    for place in find.places(grey(height, width)):
        assert place.face is None
        wide = place.boxes[0].width_px
        widths.append(wide)
        assert all(box.width_px == wide and box.roll_rad == 0 for box in place.boxes)
        middles = np.array([(box.row, box.col) for box in place.boxes])
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
        away = [abs(box.row - 149.5) + abs(box.col - 199.5) for box in place.boxes]
        assert away == sorted(away)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (8, 8), (2, 300), (300, 2), (39, 39)])
def test_pictures_too_small_for_a_face_are_no_trouble(height, width):
    assert find.faces(grey(height, width)) == []
    for place in find.places(grey(height, width)):
        assert all(isinstance(box, Box) for box in place.boxes)


def test_faces_are_given_in_px_of_the_picture_largest_first(monkeypatch):
    class Cascade:
        def detectMultiScale(self, picture, **_):
            assert max(picture.shape) == find.FACE_SIDE
            return np.array([(10, 20, 50, 50), (100, 40, 120, 120)])

    monkeypatch.setattr(find, "_cascade", lambda name: Cascade())
    assert find.faces(grey(960, 1280)) == [
        (400, 160, 480, 480),
        (40, 80, 200, 200),
    ]  # searched at a quarter of its size


def test_the_mouths_of_the_faces_are_tried_first(monkeypatch):
    faces = [(400.0, 160.0, 480.0, 480.0), (40.0, 80.0, 200.0, 200.0)]
    monkeypatch.setattr(find, "faces", lambda frame: faces)
    places = list(find.places(grey(960, 1280)))
    assert [place.face for place in places[:3]] == [*faces, None]
    for (left, top, side, _), place in zip(faces, places, strict=False):
        for box in place.boxes:
            assert box.col == left + side / 2
            assert top + 0.65 * side < box.row < top + 0.95 * side
            assert 0.25 * side < box.width_px < 0.6 * side
            assert place.allows(box)


def test_a_face_allows_a_mouth_in_its_lower_part_only():
    place = find.Place([], (100.0, 200.0, 300.0, 300.0))
    assert place.allows(Box(440.0, 250.0, 120.0))
    for strange in (
        Box(260.0, 250.0, 120.0),
        Box(440.0, 120.0, 120.0),
        Box(440.0, 250.0, 20.0),
        Box(440.0, 250.0, 290.0),
    ):
        assert not place.allows(strange)
        assert find.Place([]).allows(strange)
