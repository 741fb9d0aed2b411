"""What stands for a simulator in tests of `validate`: clips of rings, and their truth; nothing is solved."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import ring_mouth
from clips import write_video
from mouth_clip import profile_of

from lipmetrics.look import CLOSED, OPEN, Look
from lipmetrics.validate import ClipFacts

FPS = 25
HEIGHTS = (0, 0, 3, 6, 9, 9)  # half heights, px


def facts(name: str, axis: str = "plain", setting: str = "plain", take: str = "walk") -> ClipFacts:
    return ClipFacts(
        name, axis, setting, axis if axis == setting else f"{axis}: {setting}", take, "a", "f", 80.0, name, name
    )


def film(clips, folder: Path) -> str:
    """Write a clip and its truth for each, and add its name to films.txt; those of the take `impossible` fail."""
    if clips[0].take == "impossible":
        return "energy growth at 0.1 s"
    folder.mkdir(parents=True, exist_ok=True)
    for one in clips:
        looks = []
        for half in HEIGHTS:
            angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
            ring = np.column_stack([45 + half * np.sin(angle), 50 + 12 * np.cos(angle)])
            looks.append(Look(OPEN if half else CLOSED, [ring] if half else []))
        true = profile_of(looks, [i / FPS for i in range(len(looks))], 80.0)
        files = true.save(folder, one.key)
        meta = json.loads(files[2].read_text())
        meta |= {"format": "lipmetrics profile 1", "corners_px": [[45, 10], [45, 90]]}
        files[2].write_text(json.dumps(meta))
        frames = [{"openings": [{"outline": outline.tolist()} for outline in frame]} for frame in true.outlines]
        (folder / f"{one.key}.polygons.json").write_text(json.dumps({"frames": frames}))
        write_video(folder / f"{one.key}.mp4", [ring_mouth.ring(half) for half in HEIGHTS])
        with (folder / "films.txt").open("a") as file:
            file.write(f"{one.clip}\n")
    return ""
