"""The contact sheet: first, middle and last picture of each clip, with its name, to check the cuts by eye."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from lipmetrics import draw
from lipmetrics.atomic import whole_file

COLUMNS = 3
VIEW_PX = 160  # width of a picture
TEXT_PX, LINE_PX, GAP_PX = 9, 15, 10
MISSING_COLOUR = (255, 120, 90)


@dataclass(frozen=True)
class Tile:
    """A clip on the sheet: up to three pictures (h, w, 3) uint8 RGB, and two lines below; `bad` in red."""

    views: Sequence[np.ndarray]
    name: str
    line: str
    bad: bool = False


def write_contact(path: str | Path, tiles: Sequence[Tile], title: str) -> None:
    """Write the sheet as PNG; it appears whole or not at all.

    Raises InputError if it cannot be written.
    """
    shapes = [view.shape for tile in tiles for view in tile.views]
    height = max((round(h * VIEW_PX / w) for h, w, _ in shapes), default=VIEW_PX * 9 // 16)
    columns = max(1, min(COLUMNS, len(tiles)))
    rows = -(-len(tiles) // columns)
    step_col, step_row = 3 * VIEW_PX + 4 + 2 * GAP_PX, height + 2 * LINE_PX + 2 * GAP_PX
    top = 3 * TEXT_PX + GAP_PX
    width = max(columns * step_col + GAP_PX, draw.text_size(title, TEXT_PX + 2) + 2 * GAP_PX)
    sheet = np.full((top + rows * step_row, width, 3), draw.STRIP_COLOUR, np.uint8)
    draw.draw_text(sheet, title, 2 * TEXT_PX + GAP_PX // 2, GAP_PX, TEXT_PX + 2)
    for k, tile in enumerate(tiles):
        row, col = top + k // columns * step_row, GAP_PX + k % columns * step_col
        for i, view in enumerate(tile.views):
            h = min(height, round(view.shape[0] * VIEW_PX / view.shape[1]))
            small = cv2.resize(view, (VIEW_PX, h), interpolation=cv2.INTER_AREA)
            left = col + i * (VIEW_PX + 2)
            sheet[row : row + h, left : left + VIEW_PX] = small
        colour = MISSING_COLOUR if tile.bad else draw.TEXT_COLOUR
        _line(sheet, tile.name, row + height + LINE_PX, col, colour)
        _line(sheet, tile.line, row + height + 2 * LINE_PX, col, MISSING_COLOUR if tile.bad else draw.QUIET_COLOUR)
    png = cv2.imencode(".png", sheet[:, :, ::-1])[1]
    with whole_file(path) as part:
        part.write_bytes(png.tobytes())


def _line(sheet: np.ndarray, text: str, row: int, col: int, colour: tuple[int, int, int]) -> None:
    """A line of text, cut off where its tile ends."""
    text = text.encode("ascii", "replace").decode()  # the font has no other letters
    while len(text) > 4 and draw.text_size(text, TEXT_PX) > 3 * VIEW_PX + 4:
        text = text[:-4] + "..."
    draw.draw_text(sheet, text, row, col, TEXT_PX, colour)
