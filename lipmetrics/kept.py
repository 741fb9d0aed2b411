"""Profiles of videos that are kept, so that no video is measured twice in the same way."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np

from lipmetrics import pipeline
from lipmetrics.errors import InputError
from lipmetrics.profile import Profile, load_profile


def measured_profile(
    path: str | Path,
    work_folder: str | Path | None = None,
    *,
    fps: float | None = None,
    method: str = "default",
    progress: bool = False,
) -> Profile:
    """The profile of a video, measured now or found in `work_folder` where it was measured in the same way before.

    The same is: the SHA-256 of the video, the method and its default settings, the frame rate and the versions of all
    that can change a number. It is kept as a profile, `<stem>-<key>.frames.csv` and so on; one that is broken is
    measured anew. Its json also has `corners_px`, the mouth's corners at rest.

    Raises
    ------
    InputError : as of `lipmetrics.measure`, or a folder that cannot be written to
    """
    path, stem = Path(path), None
    if work_folder is not None:
        asked = {"method": method, "fps": fps, "versions": pipeline.versions(), "keeps": "corners_px 1"}
        key = hashlib.sha256(json.dumps([pipeline.source_facts(path), asked], sort_keys=True).encode()).hexdigest()
        stem = f"{path.resolve().name if path.is_dir() else path.stem}-{key[:12]}"
        try:
            return load_profile(Path(work_folder) / stem)
        except InputError:
            pass  # not there yet, or broken
    corners: list[np.ndarray] = []
    profile = pipeline.measure(
        path, method=method, fps=fps, progress=progress, on_look=lambda frame, look: corners.append(look.corners)
    )
    profile.meta["corners_px"] = _corners_at_rest(profile, np.array(corners))
    if work_folder is not None:
        profile.save(work_folder, stem)
        return load_profile(Path(work_folder) / stem)  # rounded as it will be found again
    return profile


def _corners_at_rest(profile: Profile, corners: np.ndarray) -> list | None:
    """[[row, column] left, right]: the median over the quarter of the frames that are least open; None if unknown."""
    height = profile.frames["height_px"].to_numpy(float)
    known = np.flatnonzero(np.isfinite(corners).all(axis=(1, 2)) & np.isfinite(height))
    if len(known) == 0:
        return None
    least = known[np.argsort(height[known], kind="stable")][: max(3, len(known) // 4)]
    return np.median(corners[least], axis=0).tolist()
