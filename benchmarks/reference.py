"""The reference pictures, videos and their ground truth, and the split of them by person.

The data are not part of the project. They are looked for in the folder named by the environment variable
LIPMETRICS_REFERENCE, or else in ``shared/reference`` beside the repository.

Axes are (row, column) with the origin at the centre of pixel (0, 0), lengths are in px of the picture.
"""

from __future__ import annotations

import hashlib
import os
import re
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from lipmetrics.frames import open_frames
from lipmetrics.look import CLOSED, NO_MOUTH, OPEN, Look

PARTS = ("tune", "report", "all")
NOSE, MOUTH, UPPER_LIP, LOWER_LIP, SKIN = 2, 10, 11, 12, 1  # classes of the stills' .label.png
# The byte whose parity divides every kind, open and closed, most evenly; chosen before any detector was run.
SPLIT_BYTE = 20
# What the stored landmark outlines count as closed, in mouth widths: 3 px on the stills' mouths of 120 px.
LANDMARKS_CLOSED_MW = 0.025


def reference_folder() -> Path | None:
    """Folder of the reference data (it holds ``real/index.csv``), or None where they are absent."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "reference"
    folder = Path(os.environ.get("LIPMETRICS_REFERENCE", beside))
    return folder if (folder / "real" / "index.csv").is_file() else None


def person(identity: str) -> str:
    """What may not be divided by the split: the identity, and for faces cut from one photograph the photograph."""
    return re.sub(r"^([ah]_\d+)_\d+$", r"\1", identity)


def part_of(identity: str) -> str:
    """``tune`` or ``report``: the lowest bit of one byte of the SHA-256 of the person's name."""
    return PARTS[hashlib.sha256(person(identity).encode()).digest()[SPLIT_BYTE] & 1]


@lru_cache(maxsize=1)
def index() -> pd.DataFrame:
    """``index.csv`` with the column ``part``, one row per item."""
    folder = reference_folder()
    if folder is None:
        raise FileNotFoundError(
            "Expected the reference data in LIPMETRICS_REFERENCE or ../shared/reference, found none."
        )
    table = pd.read_csv(folder / "real" / "index.csv")
    return table.assign(part=table["identity"].map(part_of), folder=table["path"].str.split("/").str[0])


def choose(folder: str, part: str) -> pd.DataFrame:
    """Rows of the index in one folder (``videos``, ``hand``, ``stills_mask``, ``stills_pts``) and one part."""
    if part not in PARTS:
        raise ValueError(f"Expected part to be one of {', '.join(PARTS)}, got {part!r}.")
    table = index()
    return table[(table["folder"] == folder) & ((part == "all") | (table["part"] == part))]


@dataclass(frozen=True)
class Item:
    """One still or video frame with a human's opening mask; a crop of one if ``window`` is set.

    window : half-open (row0, row1, col0, col1) of the full picture; every coordinate below is then the window's
    """

    path: str
    identity: str
    window: tuple[int, int, int, int] | None = None
    name: str = field(default="")

    @property
    def kind(self) -> str:
        return self.path.split("/")[0]

    @property
    def file(self) -> Path:
        return reference_folder() / "real" / self.path

    def picture(self) -> np.ndarray:
        """(height, width, 3) uint8 RGB."""
        if self.kind == "hand":
            video, frame = split_hand_name(self.file.name)
            return self._cut(hand_frames(video)[frame])
        return self._cut(cv2.cvtColor(cv2.imread(str(self.file)), cv2.COLOR_BGR2RGB))

    def mask(self) -> np.ndarray:
        """(height, width) bool, True where the human marked the opening."""
        stem = self.file if self.kind == "hand" else self.file.with_suffix(".mask.png")
        return self._cut(cv2.imread(str(stem), cv2.IMREAD_GRAYSCALE) > 0)

    def labels(self) -> np.ndarray:
        """(height, width) uint8 class numbers; stills_mask only."""
        from PIL import Image  # reads palette numbers, OpenCV only their colours; comes with matplotlib

        return self._cut(np.asarray(Image.open(self.file.with_suffix(".label.png"))))

    @cached_property
    def lips(self) -> np.ndarray:
        """(n, 2) float64 points of the lips' outer edge (all lip pixels on stills_mask); empty for hand frames."""
        offset = np.array(self.window[0::2] if self.window else (0, 0))
        if self.kind == "stills_mask":
            whole = Item(self.path, self.identity)
            lips = np.isin(whole.labels(), (MOUTH, UPPER_LIP, LOWER_LIP)).astype(np.uint8)
            _, parts, stats, _ = cv2.connectedComponentsWithStats(lips)  # stray pixels would widen the mouth
            return np.argwhere(parts == 1 + stats[1:, cv2.CC_STAT_AREA].argmax()) - offset
        if self.kind == "stills_pts":
            return read_points(self.file.with_suffix(".mouth20.csv"))[0][:12] - offset
        return np.empty((0, 2))

    @property
    def corners(self) -> np.ndarray:
        """(2, 2) float64 (row, column) of the leftmost and rightmost point of the lips.

        Of hand frames the landmark tool's, as nobody marked their lips.
        """
        if self.kind == "hand":
            return stored_mediapipe(self).corners
        sides = (self.lips[self.lips[:, 1] == end] for end in (self.lips[:, 1].min(), self.lips[:, 1].max()))
        return np.array([side.mean(axis=0) for side in sides])

    @property
    def mouth_width_px(self) -> float:
        """Columns from one end of the lips to the other; of hand frames the landmark tool's width (index.csv)."""
        if len(self.lips):
            return float(np.ptp(self.lips[:, 1]))
        return float(index().set_index("path").loc[self.path, "mouth_px"])

    def _cut(self, array: np.ndarray) -> np.ndarray:
        if self.window is None:
            return array
        row0, row1, col0, col1 = self.window
        return np.ascontiguousarray(array[row0:row1, col0:col1])


def items(folder: str, part: str) -> list[Item]:
    """The stills or hand frames of one folder and part."""
    return [
        Item(row.path, row.identity, name=Path(row.path).name.split(".")[0])
        for row in choose(folder, part).itertuples()
    ]


def split_hand_name(name: str) -> tuple[str, int]:
    """``lp_d18_f0118.mask.png`` -> (``lp_d18``, 118)."""
    video, frame = re.fullmatch(r"(.+)_f(\d+)\.mask\.png", name).groups()
    return video, int(frame)


@lru_cache(maxsize=4)
def hand_frames(video: str) -> dict[int, np.ndarray]:
    """The hand-labelled frames of a video: frame index -> (height, width, 3) uint8 RGB."""
    names = index().query("folder == 'hand'")["path"].map(lambda path: split_hand_name(Path(path).name))
    wanted = {frame for name, frame in names if name == video}
    found = {}
    with open_frames(video_file(video)) as frames:
        for frame in frames:
            if frame.index in wanted:
                found[frame.index] = frame.rgb()
            if len(found) == len(wanted):
                break
    return found


def video_file(stem: str) -> Path:
    """Path of a reference video by its name without suffix."""
    (path,) = index().query("folder == 'videos'")["path"].loc[lambda paths: paths.map(lambda p: Path(p).stem) == stem]
    return reference_folder() / "real" / path


def profile(stem: str) -> pd.DataFrame:
    """The landmark tools' profile of a video, one row per frame (open_h_px, mouth_w_px, agree, ...)."""
    return pd.read_csv(video_file(stem).with_suffix("").with_suffix(".profile.csv"))


def read_points(path: Path) -> dict[int, np.ndarray]:
    """Landmark points by frame: (n, 2) float64 (row, column). The file has x, y; rows may differ in length."""
    lines = path.read_text().splitlines()[1:]
    rows = (np.array(line.split(","), dtype=float) for line in lines if line)
    return {int(row[0]): row[2 : 2 + 2 * int(row[1])].reshape(-1, 2)[:, ::-1] for row in rows}


def landmark_look(outline: np.ndarray, mouth_width_px: float) -> Look:
    """A stored landmark outline (n, 2) as a Look; open when higher than LANDMARKS_CLOSED_MW mouth widths."""
    if not len(outline):
        return Look(NO_MOUTH)
    ends = outline[[outline[:, 1].argmin(), outline[:, 1].argmax()]]
    middle, half = ends.mean(axis=0), np.array([0.0, mouth_width_px / 2])
    corners = np.array([middle - half, middle + half])  # the outer corners are not stored, only their distance
    if height_px([outline]) < LANDMARKS_CLOSED_MW * mouth_width_px:
        return Look(CLOSED, corners=corners)
    return Look(OPEN, [outline], corners)


def stored_mediapipe(item: Item) -> Look:
    """MediaPipe's stored outline of a hand-labelled frame."""
    video, frame = split_hand_name(item.file.name)
    points = read_points(video_file(video).with_suffix(".lips.csv"))
    return landmark_look(points.get(frame, np.empty((0, 2))), item.mouth_width_px)


def fill(outlines: list[np.ndarray], shape: tuple[int, int]) -> np.ndarray:
    """Mask of closed polygons: a pixel is inside when its centre is (cv2.fillPoly would add the whole border).

    outlines : each (n, 2) (row, column); parts outside the picture are cut off
    Returns (height, width) bool, the union of the polygons.
    """
    height, width = shape
    mask = np.zeros(shape, bool)
    rows = np.arange(height)
    for outline in outlines:
        start, end = np.asarray(outline, float), np.roll(outline, -1, axis=0).astype(float)
        edge, row = np.nonzero((start[:, :1] <= rows) != (end[:, :1] <= rows))
        (row0, col0), (row1, col1) = start[edge].T, end[edge].T
        crossing = col0 + (row - row0) * (col1 - col0) / (row1 - row0)
        flips = np.zeros((height, width + 1), bool)
        np.logical_xor.at(flips, (row, np.clip(np.ceil(crossing), 0, width).astype(int)), True)
        mask |= np.logical_xor.accumulate(flips, axis=1)[:, :width]
    return mask


def height_px(outlines: list[np.ndarray]) -> float:
    """Length inside the polygons along the fullest pixel column, px (sub-pixel); 0 without outlines."""
    if not outlines:
        return 0.0
    every = np.concatenate(outlines)
    columns = np.arange(np.ceil(every[:, 1].min()), np.floor(every[:, 1].max()) + 1)
    total = np.zeros(len(columns))
    for outline in outlines:
        start, end = np.asarray(outline, float), np.roll(outline, -1, axis=0).astype(float)
        side = (start[:, 1:] <= columns).astype(int) - (end[:, 1:] <= columns)  # +1 leftwards, -1 rightwards
        edge, column = np.nonzero(side)
        (row0, col0), (row1, col1) = start[edge].T, end[edge].T
        crossing = row0 + (columns[column] - col0) * (row1 - row0) / (col1 - col0)
        signed = np.zeros(len(columns))
        np.add.at(signed, column, side[edge, column] * crossing)
        total += np.abs(signed)
    return float(total.max(initial=0.0))


def iou(one: np.ndarray, other: np.ndarray) -> float:
    """Intersection over union of two masks; 1 when both are empty."""
    union = np.count_nonzero(one | other)
    return np.count_nonzero(one & other) / union if union else 1.0


def close_up(item: Item, rng: np.random.Generator | None = None) -> Item:
    """The mouth alone, 1.6 x 1.2 mouth widths; with ``rng`` moved by up to 10 % and scaled by 0.9 to 1.3."""
    width = item.mouth_width_px
    middle = (item.lips.min(axis=0) + item.lips.max(axis=0)) / 2
    size = np.array([1.2, 1.6]) * width
    if rng is not None:
        size = size * rng.uniform(0.9, 1.3)
        middle = middle + rng.uniform(-0.1, 0.1, 2) * size
    return _window(item, middle - size / 2, middle + size / 2)


def nose_to_chin(item: Item) -> Item:
    """The lower face: rows from the tip of the nose to the chin, 4:3, centred on the mouth; stills_mask only."""
    labels, width = item.labels(), item.mouth_width_px
    nose = np.flatnonzero((labels == NOSE).any(axis=1))
    centre = item.corners[:, 1].mean()
    below_mouth = labels[:, int(centre - width / 4) : int(centre + width / 4) + 1] == SKIN
    top = nose.max() - 0.25 * np.ptp(nose)  # the label ends under the nostrils; the tip is a quarter higher
    chin = max(np.flatnonzero(below_mouth.any(axis=1)).max(), item.lips[:, 0].max())
    half = max((chin - top) * 4 / 3, 1.6 * width) / 2
    return _window(item, np.array([top, centre - half]), np.array([chin, centre + half]))


def _window(item: Item, low: np.ndarray, high: np.ndarray) -> Item:
    shape = item.mask().shape
    (row0, col0), (row1, col1) = np.maximum(np.round(low), 0).astype(int), np.minimum(np.round(high), shape).astype(int)
    return Item(item.path, item.identity, (row0, row1, col0, col1), item.name)
