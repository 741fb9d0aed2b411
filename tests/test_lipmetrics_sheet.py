import cv2
import mouth_clip
import numpy as np
import pytest
from clips import write_pictures
from mouth_clip import looks_of, picture, profile_of

from lipmetrics import sheet
from lipmetrics.draw import COLOURS, found_by_frame
from lipmetrics.errors import InputError
from lipmetrics.look import OPEN, Look
from lipmetrics.sheet import draw_tile, pick_uncertain, tile_region, write_sheet

STATUSES = ["open"] * 10 + ["closed"] * 10 + ["open"] * 10


class StillFrame:
    """A frame that remembers which regions were asked for."""

    def __init__(self, index, rgb, asked):
        self.index, self.time_s, self._rgb, self._asked = index, index / 25, rgb, asked
        self.height, self.width = rgb.shape[:2]

    def rgb(self, region=None):
        self._asked.append((self.index, region))
        row0, row1, col0, col1 = region
        assert 0 <= row0 < row1 <= self.height
        assert 0 <= col0 < col1 <= self.width
        return self._rgb[row0:row1, col0:col1]


@pytest.fixture
def profile():
    return profile_of(looks_of(STATUSES), [k / 25 for k in range(30)])


def test_lowest_confidence_and_largest_jumps_come_by_turns(profile):
    profile.frames.loc[[3, 25], "confidence"] = [0.1, 0.2]
    # the opening closes from 17 to 0 px before frame 10 and opens to 28 px before frame 20
    reasons = pick_uncertain(profile, 4)
    assert list(reasons) == [3, 10, 20, 25], "in order of time"
    assert reasons[3] == "confidence 0.10"
    assert reasons[20].startswith("height jumps 2")
    assert list(pick_uncertain(profile, 1)) == [3]


def test_frames_are_named_by_their_index_in_the_file(profile):
    profile.frames["frame"] = profile.frames["frame"] * 5 + 2
    profile.frames.loc[3, "confidence"] = 0.1
    assert list(pick_uncertain(profile, 1)) == [17]


def test_a_bad_moment_does_not_fill_the_sheet():
    profile = profile_of(looks_of(["closed"] * 400), [k / 25 for k in range(400)])
    profile.frames.loc[100:110, "confidence"] = 0.1
    picked = list(pick_uncertain(profile, 8))
    assert len(picked) == 8
    assert sum(100 <= k <= 110 for k in picked) == 3


def test_a_frame_without_a_mouth_counts_as_unsure():
    profile = profile_of(looks_of(["closed"] * 6 + ["no_mouth"] + ["closed"] * 6), [k / 25 for k in range(13)])
    assert np.isnan(profile.frames["confidence"][6])
    assert list(pick_uncertain(profile, 1)) == [6]


def test_every_frame_where_there_are_fewer_than_asked_for(profile):
    assert list(pick_uncertain(profile, 100)) == list(range(30))


def test_even_distances_where_nothing_is_known():
    profile = profile_of(looks_of(["closed"] * 31), [k / 25 for k in range(31)])
    profile.frames["confidence"] = np.nan
    assert list(pick_uncertain(profile, 4)) == [0, 10, 20, 30]


def test_region_has_the_mouth_in_its_middle_and_the_tile_shape():
    found = found_by_frame(profile_of([Look(OPEN, [mouth_clip.ellipse(5, (400.0, 500.0))])], [0.0]))[0]
    row0, col0, height, width = tile_region(1000, 1000, found, mouth_width=60.0)
    assert width == pytest.approx(60 * sheet.MARGIN, abs=4)
    assert height * 4 == width * 3
    assert (row0 + (height - 1) / 2, col0 + (width - 1) / 2) == pytest.approx((400, 500), abs=1)


@pytest.mark.parametrize(
    ("half_height", "half_width", "mouth_width", "expected"),
    [(2, 5, 60.0, 60.0), (2, 40, 60.0, 80.0), (60, 5, 60.0, 160.0), (2, 20, np.nan, 40.0)],
    ids=["small opening", "wide opening", "high opening", "mouth width unknown"],
)
def test_region_holds_mouth_and_opening(half_height, half_width, mouth_width, expected):
    outline = mouth_clip.ellipse(half_height, (500.0, 500.0), half_width)
    found = found_by_frame(profile_of([Look(OPEN, [outline])], [0.0]))[0]
    _, _, _, width = tile_region(1000, 1000, found, mouth_width)
    assert width == pytest.approx(expected * sheet.MARGIN, abs=4)


@pytest.mark.parametrize(("row", "row0"), [(5.0, 0), (500.0, 468), (995.0, 934)])
def test_region_stays_inside_the_picture(row, row0):
    outline = mouth_clip.ellipse(2, (row, 1000.0 - row))
    found = found_by_frame(profile_of([Look(OPEN, [outline])], [0.0]))[0]
    top, left, height, width = tile_region(1000, 1000, found, 48.0)
    assert (top, height, width) == (row0, 66, 88)
    assert 0 <= left <= 1000 - width


def test_region_is_the_whole_picture_where_no_mouth_was_found():
    found = found_by_frame(profile_of(looks_of(["no_mouth"]), [0.0]))[0]
    assert tile_region(300, 200, found, mouth_width=60.0) == (0, -100, 300, 400)
    assert tile_region(200, 400, found, mouth_width=60.0) == (-50, 0, 300, 400)


@pytest.mark.parametrize(
    "centre", [(50.0, 60.0), (14.0, 23.0), (81.0, 107.0)], ids=["inside", "first corner", "last corner"]
)
def test_outline_lies_on_the_opening_in_the_tile(centre):
    outline = mouth_clip.ellipse(12, centre)
    profile = profile_of([Look(OPEN, [outline], confidence=0.5)], [0.0])
    frame = StillFrame(0, picture([outline]), [])
    tile = draw_tile(frame, found_by_frame(profile)[0], 40.0, "")
    place = tile[: sheet.TILE_HEIGHT_PX].astype(int)
    drawn = (np.abs(place - COLOURS[0]) < 60).all(axis=2)
    dark = (np.abs(place - mouth_clip.DARK) < 25).all(axis=2)
    outside = cv2.dilate(drawn.astype(np.uint8), np.ones((3, 3)))
    cv2.floodFill(outside, None, (0, 0), 2)
    assert dark.sum() > 500
    assert not dark[outside == 2].any(), "what is dark lies inside the outline"


def test_only_the_pieces_needed_are_decoded_and_nothing_after_the_last(tmp_path, monkeypatch, profile):
    profile.frames["confidence"] = 0.9
    profile.frames.loc[[4, 12], "confidence"] = 0.1
    asked, read, opened = [], [], {}

    class Source:
        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def __iter__(self):
            for index in range(30):
                read.append(index)
                yield StillFrame(index, np.zeros((1080, 1920, 3), np.uint8), asked)

    monkeypatch.setattr(sheet, "open_frames", lambda source, **how: opened.update(how) or Source())
    write_sheet("a.mp4", profile, tmp_path / "s.png", 3)
    assert [index for index, _ in asked] == [4, 12, 20]
    assert opened["start_s"] == pytest.approx(4 / 25, abs=0.002)
    assert opened["start_s"] < 4 / 25
    assert read == list(range(21))
    assert all((row1 - row0) * (col1 - col0) < 200 * 200 for _, (row0, row1, col0, col1) in asked)


def test_sheet_is_a_png_of_all_tiles(tmp_path, profile):
    folder = write_pictures(tmp_path / "take", [picture(outlines) for outlines in profile.outlines])
    write_sheet(folder, profile, tmp_path / "s.png", 8, fps=25)
    drawn = cv2.imread(str(tmp_path / "s.png"))
    tile_row, tile_col = sheet.TILE_HEIGHT_PX + 3 * sheet.LINE_PX, sheet.TILE_WIDTH_PX
    assert drawn.shape[0] >= 2 * tile_row
    assert drawn.shape[1] >= sheet.COLUMNS * tile_col
    assert [p.name for p in tmp_path.iterdir() if p.is_file()] == ["s.png"]


@pytest.mark.parametrize("statuses", [["no_mouth"] * 3, ["closed"], ["open"]], ids=str)
def test_every_profile_has_a_sheet(tmp_path, statuses):
    profile = profile_of(looks_of(statuses), [k / 25 for k in range(len(statuses))], mouth_width_px=np.nan)
    folder = write_pictures(tmp_path / "take", [picture(outlines) for outlines in profile.outlines])
    write_sheet(folder, profile, tmp_path / "s.png", fps=25)
    drawn = cv2.imread(str(tmp_path / "s.png"))
    assert min(drawn.shape[:2]) > 50
    assert len(np.unique(drawn.reshape(-1, 3), axis=0)) > 20  # frames and text, not an empty sheet


def test_another_clip_than_the_measured_one_is_refused(tmp_path, profile):
    folder = write_pictures(tmp_path / "take", [picture([])])
    profile.frames["frame"] += 100
    with pytest.raises(InputError, match=r"expected the profile's frames in .*take, found none"):
        write_sheet(folder, profile, tmp_path / "s.png", fps=25)


def test_no_tiles_make_no_sheet(tmp_path, profile):
    with pytest.raises(InputError, match="expected at least 1 frame on the contact sheet, got 0"):
        write_sheet("a.mp4", profile, tmp_path / "s.png", 0)
