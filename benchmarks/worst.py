"""Pictures of what a method does worst, to look at."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from scores import Scored, clip_scores


def write_worst(scored: list[Scored], count: int, file: Path) -> None:
    """A contact sheet of the pictures scored worst, the truth in green and the method in red."""
    worst = sorted(scored, key=lambda one: (one.row["iou"], one.row["located"], -one.row["height_error_pct"]))[:count]
    tiles = [_tile(one) for one in worst]
    columns = min(5, len(tiles))
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    sheet = np.vstack([np.hstack(tiles[start : start + columns]) for start in range(0, len(tiles), columns)])
    file.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(file), cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))


def _tile(one: Scored, height: int = 225, width: int = 300) -> np.ndarray:
    """The mouth's surroundings, twice its width, with outlines and figures: (height, width, 3) uint8 RGB."""
    scale = width / (2 * one.item.mouth_width_px)
    row, col = one.item.corners.mean(axis=0)
    # (x, y) of the picture's pixel centres -> (x, y) of the tile's
    place = np.array([[scale, 0, width / 2 - scale * col], [0, scale, height / 2 - scale * row]])
    tile = cv2.warpAffine(one.item.picture(), place, (width, height), flags=cv2.INTER_LINEAR)
    truth = cv2.warpAffine(one.item.mask().astype(np.uint8), place, (width, height), flags=cv2.INTER_NEAREST)
    cv2.drawContours(tile, cv2.findContours(truth, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0], -1, (0, 255, 0), 1)
    for outline in one.look.outlines:
        points = outline[:, ::-1] @ place[:, :2].T + place[:, 2]
        cv2.polylines(tile, [np.round(points * 16).astype(np.int32)], True, (255, 0, 0), 1, cv2.LINE_AA, 4)
    for end in one.look.corners[np.isfinite(one.look.corners).all(axis=1)]:
        x, y = np.round(place[:, :2] @ end[::-1] + place[:, 2]).astype(int).tolist()
        cv2.circle(tile, (x, y), 3, (255, 160, 0), -1)
    text = f"{one.item.name} {one.look.status} IoU {one.row['iou']:.2f} conf {one.look.confidence:.2f}"
    cv2.putText(tile, text, (4, height - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.38, (255, 255, 0), 1, cv2.LINE_AA)
    return tile


def draw_worst_clips(frames: pd.DataFrame, count: int, file: Path) -> None:
    """Height over time of the clips that agree least with the landmark tools."""
    from matplotlib.figure import Figure

    scores = clip_scores(frames)
    worst = (scores["correlation"].fillna(1) + scores["agreement_pct"] / 100).sort_values().index[:count]
    figure = Figure(figsize=(12, 2 * len(worst)), layout="constrained")
    for axes, clip in zip(figure.subplots(len(worst), squeeze=False)[:, 0], worst, strict=True):
        rows = frames[frames["clip"] == clip]
        trusted = rows["open_h_px"].where(rows["agree"] == 1)
        axes.plot(rows["time_s"], rows["open_h_px"], color="0.7", label="MediaPipe, the tools disagree")
        axes.plot(rows["time_s"], trusted, "g", label="MediaPipe, the tools agree")
        axes.plot(rows["time_s"], rows["height_px"], "r", lw=0.8, label="this method")
        one = scores.loc[clip]
        axes.set_title(f"{clip}: correlation {one['correlation']:.2f}, agreement {one['agreement_pct']:.0f} %", size=9)
        axes.set_ylabel("height, px")
    figure.axes[0].legend(fontsize=7)
    figure.axes[-1].set_xlabel("time, s")
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=80)
