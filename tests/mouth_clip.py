"""Pictures of a drawn mouth and the profile that a perfect method would measure in them."""

from __future__ import annotations

import numpy as np

from lipmetrics.look import CLOSED, NO_MOUTH, OPEN, Look
from lipmetrics.openings import Identity, measure_outline
from lipmetrics.outline import fill_outlines
from lipmetrics.profile import Profile, frame_row, opening_row, tables

HEIGHT, WIDTH = 96, 130
MOUTH_WIDTH_PX = 60.0
SKIN, DARK = (205, 160, 140), (70, 10, 10)
CENTRE = (60.0, 50.0)  # row, column: off the middle, so that swapped axes show


def ellipse(half_height: float, centre: tuple[float, float] = CENTRE, half_width: float = 20.0) -> np.ndarray:
    """(72, 2) (row, column) in px."""
    angle = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    return np.column_stack([centre[0] + half_height * np.sin(angle), centre[1] + half_width * np.cos(angle)])


def picture(outlines: list[np.ndarray]) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) uint8 RGB: dark openings on skin."""
    rgb = np.full((HEIGHT, WIDTH, 3), SKIN, np.uint8)
    rgb[fill_outlines(outlines, (HEIGHT, WIDTH))] = DARK
    return rgb


def profile_of(looks: list[Look], times_s: list[float], mouth_width_px: float = MOUTH_WIDTH_PX) -> Profile:
    """The profile of a clip in which `looks` were seen; identities count up from 1 in each frame."""
    frames, openings = [], []
    for index, (time_s, look) in enumerate(zip(times_s, looks, strict=True)):
        found = [measure_outline(outline) for outline in look.outlines]
        frames.append(frame_row(index, time_s, look, found))
        openings += [opening_row(index, time_s, Identity(k + 1), opening) for k, opening in enumerate(found)]
    outlines, corners = [look.outlines for look in looks], [look.corners for look in looks]
    meta = {"file": "drawn.mp4", "mouth_width_px": mouth_width_px}
    return Profile(*tables(frames, openings, mouth_width_px), meta, outlines, corners)


def looks_of(statuses: list[str]) -> list[Look]:
    """One look per status; an opening is 4 px half-high and grows by 0.5 px with every frame."""
    corners = np.array([[CENTRE[0], CENTRE[1] - 30], [CENTRE[0], CENTRE[1] + 30]])
    looks = []
    for k, status in enumerate(statuses):
        outlines = [ellipse(4 + k / 2)] if status == OPEN else []
        known = np.full((2, 2), np.nan) if status == NO_MOUTH else corners
        looks.append(Look(status, outlines, known, {OPEN: 0.9, CLOSED: 0.8, NO_MOUTH: np.nan}[status]))
    return looks
