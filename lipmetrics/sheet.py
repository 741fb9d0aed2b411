"""The contact sheet: the frames of a profile that look least certain, each cut out around the mouth."""

from __future__ import annotations

import math
from itertools import zip_longest
from pathlib import Path

import cv2
import numpy as np

from lipmetrics import draw
from lipmetrics.atomic import whole_file
from lipmetrics.errors import InputError
from lipmetrics.frames import Frame, open_frames
from lipmetrics.look import NO_MOUTH, OPEN
from lipmetrics.profile import Profile

COLUMNS = 6
TILE_HEIGHT_PX, TILE_WIDTH_PX = 180, 240
# What a tile shows: this many mouth widths, or this many times the opening where that is more.
MARGIN = 1.8
TEXT_PX = 10
LINE_PX = 17
GAP_PX = 10


def write_sheet(
    source: str | Path,
    profile: Profile,
    path: str | Path,
    n: int = 24,
    *,
    fps: float | None = None,
    timestamps: str | Path | None = None,
) -> None:
    """Write a PNG of the `n` frames of `profile` that most want a look, in order of time, with outlines and numbers.

    `source` is read once, from the first of these frames to the last, and only the pieces around the mouth are kept.

    Parameters
    ----------
    source, fps, timestamps : as in `lipmetrics.frames.open_frames`
    profile : with its outlines, as `lipmetrics.measure` returns it
    path : the PNG to write; it appears whole or not at all

    Raises
    ------
    InputError : `source` cannot be read or holds none of the frames; `path` cannot be written; `n` is under 1
    """
    if n < 1:
        raise InputError(f"expected at least 1 frame on the contact sheet, got {n}; leave the number out for 24")
    reasons = pick_uncertain(profile, n)
    found = draw.found_by_frame(profile)
    mouth_width = draw.mouth_width_px(profile)
    tiles: list[np.ndarray] = []
    with open_frames(source, fps=fps, timestamps=timestamps, start_s=_just_before(profile, min(reasons))) as frames:
        for frame in frames:
            if frame.index in reasons:
                tiles.append(draw_tile(frame, found[frame.index], mouth_width, reasons[frame.index]))
                if len(tiles) == len(reasons):
                    break
    if not tiles:
        raise InputError(f"expected the profile's frames in {source}, found none; give the clip that was measured")
    title = f"{Path(source).name}: the {len(tiles)} of {len(profile.frames)} frames to look at first"
    png = cv2.imencode(".png", _arrange(tiles, title)[:, :, ::-1])[1]
    with whole_file(path) as part:
        part.write_bytes(png.tobytes())


def pick_uncertain(profile: Profile, n: int) -> dict[int, str]:
    """Frame index -> why it was taken, of up to `n` frames that look least certain, in order of time.

    By turns the frame of lowest confidence (no mouth found counts as none) and the frame where the height of the
    opening has changed most since the measured frame before; frames at even distances where these do not suffice.
    Frames nearer than a hundredth of the clip to one already taken wait until nothing else is left, so that a single
    bad moment does not fill the sheet.
    """
    rows = profile.frames
    confidence = np.where(rows["status"] == NO_MOUTH, 0.0, rows["confidence"].to_numpy(float))
    height = rows["height_px"].to_numpy(float)
    jump = np.abs(np.diff(height, prepend=np.nan))
    unsure = [(i, f"confidence {confidence[i]:.2f}") for i in _smallest_first(confidence)]
    jumped = [(i, f"height jumps {jump[i]:.1f} px") for i in _smallest_first(-jump) if jump[i] > 0]
    even = [(int(i), "") for i in np.linspace(0, len(rows) - 1, min(n, len(rows)))]
    by_turns = [candidate for pair in zip_longest(unsure, jumped) for candidate in pair if candidate is not None]

    taken: dict[int, str] = {}
    for least_distance in (len(rows) / 100, 1):
        for i, reason in (*by_turns, *even):
            if len(taken) == n:
                break
            if all(abs(i - other) >= least_distance for other in taken):
                taken[i] = reason
    index = rows["frame"].to_numpy(int)
    return {int(index[i]): taken[i] for i in sorted(taken)}


def draw_tile(frame: Frame, found: draw.Found, mouth_width: float, reason: str) -> np.ndarray:
    """One tile of the sheet with its caption, (TILE_HEIGHT_PX + 3 lines, TILE_WIDTH_PX, 3) uint8 RGB.

    Only the piece around the mouth is taken from `frame`; the whole picture where the mouth was not found.
    """
    row0, col0, height, width = tile_region(frame.height, frame.width, found, mouth_width)
    top, bottom = max(row0, 0), min(row0 + height, frame.height)
    left, right = max(col0, 0), min(col0 + width, frame.width)
    piece = np.full((height, width, 3), draw.STRIP_COLOUR, np.uint8)
    piece[top - row0 : bottom - row0, left - col0 : right - col0] = frame.rgb((top, bottom, left, right))

    view = draw.View(TILE_WIDTH_PX / width, row0, col0)
    drawn = np.full((TILE_HEIGHT_PX + 3 * LINE_PX, TILE_WIDTH_PX, 3), draw.STRIP_COLOUR, np.uint8)
    picture = drawn[:TILE_HEIGHT_PX]
    interpolation = cv2.INTER_CUBIC if view.scale > 1 else cv2.INTER_AREA
    picture[:] = cv2.resize(piece, (TILE_WIDTH_PX, TILE_HEIGHT_PX), interpolation=interpolation)
    for outline, identity in zip(found.outlines, found.identities, strict=True):
        draw.draw_outline(picture, outline, draw.colour_of(identity), view)
    draw.draw_corners(picture, found.corners, view)

    row = found.row
    if row.status == OPEN:
        state = f"height {row.height_px:.1f} px  {draw.format_number(row.height_mw, 2, ' mw')}"
    else:
        state = row.status.replace("_", " ")
    lines = (f"frame {row.frame}  {row.time_s:.3f} s", state, reason)
    for k, (line, colour) in enumerate(
        zip(lines, (draw.TEXT_COLOUR, draw.TEXT_COLOUR, draw.QUIET_COLOUR), strict=True)
    ):
        draw.draw_text(drawn, line, TILE_HEIGHT_PX + LINE_PX * (k + 1) - 3, 2, TEXT_PX, colour)
    return drawn


def tile_region(height: int, width: int, found: draw.Found, mouth_width: float) -> tuple[int, int, int, int]:
    """(row0, col0, height, width) in source px of what a tile shows: the mouth, in its middle where the picture allows.

    It reaches beyond the picture only where that is smaller than the tile's shape asks for, by as much on both sides.
    """
    points = np.concatenate([*found.outlines, found.corners])
    points = points[np.isfinite(points).all(axis=1)]
    whole = max(width, height * TILE_WIDTH_PX / TILE_HEIGHT_PX)
    if len(points):
        low, high = points.min(axis=0), points.max(axis=0)
        extent = max(high[1] - low[1], (high[0] - low[0]) * TILE_WIDTH_PX / TILE_HEIGHT_PX, np.nan_to_num(mouth_width))
        (row, col), wanted = (low + high) / 2, min(MARGIN * extent, whole)
    else:
        (row, col), wanted = ((height - 1) / 2, (width - 1) / 2), whole
    quarter = max(2, math.ceil(wanted / 4))
    return _start(row, 3 * quarter, height), _start(col, 4 * quarter, width), 3 * quarter, 4 * quarter


def _start(middle: float, length: int, whole: int) -> int:
    """First px of a stretch of `length` px around `middle`, moved into 0..`whole`; centred where it is longer."""
    if length > whole:
        return (whole - length) // 2
    return min(max(0, round(middle - (length - 1) / 2)), whole - length)


def _just_before(profile: Profile, index: int) -> float | None:
    """A time in s from which a reading still meets the frame; None for the clip's beginning, which may lie before 0."""
    rows = profile.frames
    time_s = float(rows["time_s"][rows["frame"] == index].iloc[0]) - 0.001
    return time_s if time_s > 0 else None


def _smallest_first(values: np.ndarray) -> list[int]:
    """Positions of the known values, smallest first, the earlier one first where they are equal."""
    order = np.argsort(values, kind="stable")
    return [int(i) for i in order if np.isfinite(values[i])]


def _arrange(tiles: list[np.ndarray], title: str) -> np.ndarray:
    """Tiles in rows of COLUMNS under a title, (H, W, 3) uint8 RGB."""
    columns = min(COLUMNS, len(tiles))
    rows = -(-len(tiles) // columns)
    step_row, step_col = tiles[0].shape[0] + GAP_PX, TILE_WIDTH_PX + GAP_PX
    top = 3 * TEXT_PX + GAP_PX
    width = max(columns * step_col, draw.text_size(title, TEXT_PX) + GAP_PX) + GAP_PX
    sheet = np.full((top + rows * step_row, width, 3), draw.STRIP_COLOUR, np.uint8)
    draw.draw_text(sheet, title, 2 * TEXT_PX + GAP_PX // 2, GAP_PX, TEXT_PX + 2)
    for k, tile in enumerate(tiles):
        row, col = top + k // columns * step_row, GAP_PX + k % columns * step_col
        sheet[row : row + tile.shape[0], col : col + TILE_WIDTH_PX] = tile
    return sheet
