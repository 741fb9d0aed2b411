"""From a clip to its profile: the whole method on one screen."""

from __future__ import annotations

import hashlib
import math
import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict, is_dataclass
from importlib.metadata import version
from pathlib import Path

import av
import cv2
import numba
import numpy as np
import pandas as pd

from lipmetrics.detect import make_detector
from lipmetrics.errors import InputError
from lipmetrics.frames import Frame, FrameSource, open_frames
from lipmetrics.frames import _pictures_of as pictures_of
from lipmetrics.look import NO_MOUTH, OPEN, Look
from lipmetrics.openings import Identities, measure_outline
from lipmetrics.profile import FORMAT, RATE_FORMULA, Profile, frame_row, opening_row, resting_mouth_width, tables

# whose versions can change a number in the tables
_PACKAGES = (av, cv2, numba, np, pd)


def measure(
    source: str | Path,
    *,
    method: str = "default",
    settings=None,
    fps: float | None = None,
    timestamps: str | Path | Sequence[float] | None = None,
    start_s: float | None = None,
    stop_s: float | None = None,
    every: int = 1,
    roi: tuple[int, int, int, int] | None = None,
    mouth_width_px: float | None = None,
    keep_outlines: bool = False,
    progress: bool = False,
    on_look: Callable[[Frame, Look], None] | None = None,
) -> Profile:
    """Measure every opening of the mouth in every frame of a clip.

    Parameters
    ----------
    source, fps, timestamps, start_s, stop_s, every : as in `lipmetrics.frames.open_frames`
    method, settings, roi : as in `lipmetrics.detect.make_detector`
    mouth_width_px : width of the mouth at rest; found from the closed or least open frames if None
    keep_outlines : keep `Profile.outlines` and `Profile.corners`, which an overlay needs
    progress : show a progress bar with the time left on stderr
    on_look : called with every frame and what the method says about it

    Returns
    -------
    Profile; memory grows with the rows of its tables only

    Raises
    ------
    InputError : the source cannot be read or has no frame in the time asked for; an argument cannot be used
    """
    if mouth_width_px is not None and not (math.isfinite(mouth_width_px) and mouth_width_px > 0):
        raise InputError(f"expected a mouth width above 0 px, got {mouth_width_px}; leave it out to have it found")
    frame_rows, opening_rows, lip_width_px, outlines, corners = [], [], [], [], []
    identities = Identities()
    with open_frames(source, fps=fps, timestamps=timestamps, start_s=start_s, stop_s=stop_s, every=every) as frames:
        detector = make_detector(method, settings, frames.info, roi)
        for frame in _with_progress(frames, start_s, stop_s, every) if progress else frames:
            look = detector.look(frame)
            found = [measure_outline(outline) for outline in look.outlines] if look.status == OPEN else []
            who = identities.update(found) if look.status != NO_MOUTH else []
            frame_rows.append(frame_row(frame.index, frame.time_s, look, found))
            opening_rows += [opening_row(frame.index, frame.time_s, w, o) for w, o in zip(who, found, strict=True)]
            lip_width_px.append(look.lip_width_px)
            if keep_outlines:
                outlines.append(look.outlines if found else [])
                corners.append(look.corners)
            if on_look:
                on_look(frame, look)

    warnings, how = list(frames.warnings), "given"
    if mouth_width_px is None:
        status, height_px = [row[2] for row in frame_rows], np.array([row[5] for row in frame_rows], float)
        mouth_width_px, how = resting_mouth_width(status, height_px, np.array(lip_width_px))
        if math.isnan(mouth_width_px):
            warnings.append("the mouth's width was not found, so sizes are in px only; give it with --mouth-width")
    choices = {"start_s": start_s, "stop_s": stop_s, "every": every, "fps": fps, "timestamps": timestamps, "roi": roi}
    meta = _provenance(source, frames, method, getattr(detector, "settings", settings), choices)
    meta |= {"mouth_width_px": float(mouth_width_px), "mouth_width_found": how, "warnings": warnings}
    return Profile(*tables(frame_rows, opening_rows, mouth_width_px), meta, outlines, corners)


def _provenance(source: str | Path, frames: FrameSource, method: str, settings, choices: dict) -> dict:
    """What a reader needs to get the same numbers again; no time of day and no folder, so the same bytes too."""
    video = asdict(frames.info) | {"variable_frame_rate": frames.variable_frame_rate}
    del video["path"]
    if choices["roi"] is not None:
        choices["roi"] = dict(zip(("row0", "row1", "col0", "col1"), choices["roi"], strict=True))
    if isinstance(choices["timestamps"], str | os.PathLike):
        choices["timestamps"] = _file_facts([Path(choices["timestamps"])])
    elif choices["timestamps"] is not None:
        choices["timestamps"] = "given as numbers"
    return {
        "format": FORMAT,
        "file": Path(source).absolute().name,
        "source": _file_facts([Path(source)] if frames.info.kind == "video" else pictures_of(Path(source))),
        "video": video,
        "method": method,
        "settings": asdict(settings) if is_dataclass(settings) else settings,
        "choices": choices,
        "rates": RATE_FORMULA,
        "versions": versions(),
    }


def versions() -> dict[str, str]:
    """Versions of everything that can change a number."""
    ours = {"lipmetrics": version("lipmetrics"), "python": platform.python_version()}
    return ours | {package.__name__: package.__version__ for package in _PACKAGES}


def source_facts(source: str | Path) -> dict:
    """Name, size and SHA-256 of a video, or of the pictures of a sequence one after the other.

    Raises InputError if there is nothing to read.
    """
    return _file_facts([Path(source)] if Path(source).is_file() else pictures_of(Path(source)))


def _with_progress(frames, start_s: float | None, stop_s: float | None, every: int):
    from tqdm import tqdm

    info = frames.info
    last_s = info.duration_s if stop_s is None else min(stop_s, info.duration_s)
    expected = (last_s - (start_s or 0)) * info.nominal_fps / every
    total = max(1, round(expected)) if math.isfinite(expected) else None
    return tqdm(frames, total=total, desc=Path(info.path).name, unit="frame", leave=False)


def _file_facts(paths: list[Path]) -> dict:
    """Name, size and SHA-256 of a file; for a sequence, of all its files one after the other in their order."""
    digest, size = hashlib.sha256(), 0
    for path in paths:
        with path.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
                size += len(block)
    facts = {"name": paths[0].name} if len(paths) == 1 else {"first": paths[0].name, "files": len(paths)}
    return facts | {"bytes": size, "sha256": digest.hexdigest()}
