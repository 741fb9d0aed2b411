"""What is really in the picture: the openings of a simulated mouth, from geometry alone.

The openings are the places between the lips where the saliva is broken, seen by the camera that also takes the
picture. Everything is counted from the nodes of the lips' edges; no picture is made and none is looked at.
"""

from __future__ import annotations

import dataclasses
import gzip
import json
import platform
from contextlib import ExitStack
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd

from simulator import polygons
from simulator.aperture import SEEN_M, lip_edges, visible
from simulator.atomic import whole_file
from simulator.camera import Camera
from simulator.errors import InputError
from simulator.identity import identities
from simulator.motion import Motion, SalivaRecord
from simulator.mouth import Mouth
from simulator.playback import at_times
from simulator.tables import RATE_FORMULA, csv, frame_table, opening_table

FORMAT = "lipmetrics profile 1"
POLYGONS_FORMAT = "lipmetrics polygons 1"
_AREA = polygons.SIZES.index("area")
STATES = ("intact", "broken", "sticking")  # in the order of the numbers in simulator.motion


@dataclass(frozen=True, eq=False)
class Truth:
    """The openings of every frame, and the saliva and the energies behind them.

    Parameters
    ----------
    frames, openings : the tables that `lipmetrics measure` writes, in px
    frames_m, openings_m : the same seen straight on from far away, in m; (0, 0) is the origin of the mesh
    polygons : of each frame, one (n, 2) (row, column) px per opening, in the order of `openings`
    saliva : one row per saliva element per frame
    energies : one row per frame
    meta : provenance, with `mouth_width_px` and `mouth_width_m`
    corners : (2, 2) (row, column) px of the mouth's corners at rest, that of saliva element 0 first
    shape : (rows, columns) of the picture
    """

    frames: pd.DataFrame
    openings: pd.DataFrame
    frames_m: pd.DataFrame
    openings_m: pd.DataFrame
    polygons: list[list[np.ndarray]]
    saliva: pd.DataFrame
    energies: pd.DataFrame
    meta: dict = field(default_factory=dict)
    corners: np.ndarray = field(default_factory=lambda: np.full((2, 2), np.nan))
    shape: tuple[int, int] = (0, 0)

    def masks(self, shape: tuple[int, int] | None = None) -> np.ndarray:
        """(T, rows, columns) bool, True where the pixel's centre lies in an opening; `shape` is the picture's."""
        shape = shape or self.shape
        masks = [polygons.mask(of_frame, shape) for of_frame in self.polygons]
        return np.array(masks, bool).reshape(len(masks), *shape)

    def save(self, folder: str | Path, stem: str, details: bool = True) -> list[Path]:
        """Write the files that docs/ground_truth.md lists into `folder`, made if needed: same truth, same bytes.

        All are complete before the first takes its name; `<stem>.json` comes last. `lipmetrics.load_profile` reads
        `<stem>`. Without `details` saliva, energies and the tables in metres are left out.

        Raises
        ------
        InputError : `folder` cannot be written to
        """
        texts = {
            ".json": _json(self.meta | {"file": stem}),
            ".saliva.csv.gz": csv(self.saliva) if details else None,
            ".energy.csv": csv(self.energies) if details else None,
            ".polygons.json": self._polygons_json(),
            ".metres.openings.csv": csv(self.openings_m) if details else None,
            ".metres.frames.csv": csv(self.frames_m) if details else None,
            ".openings.csv": csv(self.openings),
            ".frames.csv": csv(self.frames),
        }
        texts = {ending: text for ending, text in texts.items() if text is not None}
        paths = [Path(folder) / (stem + ending) for ending in texts]
        with ExitStack() as files:  # leaves in reverse order, so the json comes last
            for path, text in zip(paths, texts.values(), strict=True):
                data = text.encode()
                if path.suffix == ".gz":
                    data = gzip.compress(data, compresslevel=6, mtime=0)
                files.enter_context(whole_file(path)).write_bytes(data)
        return paths[::-1]

    def _polygons_json(self) -> str:
        number = iter(self.openings["opening"].tolist())
        frames = [
            {
                "frame": frame,
                "time_s": round(time, 6),
                "openings": [{"opening": next(number), "outline": np.round(p, 5).tolist()} for p in of_frame],
            }
            for frame, time, of_frame in zip(self.frames["frame"], self.frames["time_s"], self.polygons, strict=True)
        ]
        head = {"format": POLYGONS_FORMAT, "unit": "px", "axes": ["row", "column"], "shape": list(self.shape)}
        rows = ",\n".join(json.dumps(frame, separators=(",", ":")) for frame in frames)
        return f'{json.dumps(head)[:-1]}, "frames": [\n{rows}\n]}}\n'


def truth(motion: Motion, mouth: Mouth, camera: Camera | None = None, times: np.ndarray | None = None) -> Truth:
    """The ground truth of a simulated mouth.

    Parameters
    ----------
    motion : of the nodes of `mouth`, with the saliva's states
    camera : the picture's; None takes one straight in front
    times : (F,) s, of the frames; None takes the times that were saved

    Raises
    ------
    InputError : a motion of another mesh, one without saliva or with nodes at no finite place, or times outside it
    """
    camera = camera or Camera()
    motion = _edges_only(motion, mouth)
    if times is not None:
        motion = at_times(motion, times)
    if not np.isfinite(motion.positions).all():
        at = motion.time_s[int(np.argmin(np.isfinite(motion.positions).all(axis=(1, 2))))]
        raise InputError(f"expected lips at finite places, got NaN or infinity at {at:g} s; solve with a smaller step")
    time_s = np.asarray(motion.time_s, float)
    columns = len(mouth.upper)
    place = motion.positions.reshape(len(time_s), 2, columns, 2, 3)
    rest = motion.nodes.reshape(2, columns, 2, 3)
    edges = lip_edges(place[:, 0], place[:, 1], rest[0], rest[1], motion.saliva.state)
    lips = np.stack([edges.upper, edges.lower])
    corner_m = rest[:, [0, -1], 0].mean(axis=0)  # of the mouth at rest, on the outer edge

    px = _Seen(camera.project(lips), camera.project(corner_m), edges.loose, SEEN_M * camera.px_per_m)
    metres = _Seen(_straight_on(camera, lips), _straight_on(camera, corner_m), edges.loose, SEEN_M)
    frames, openings = px.tables(time_s, "px")
    frames_m, openings_m = metres.tables(time_s, "m")
    return Truth(
        frames,
        openings,
        frames_m,
        openings_m,
        px.polygons(len(time_s)),
        _saliva_table(time_s, motion.saliva, mouth),
        pd.DataFrame({"frame": np.arange(len(time_s)), "time_s": time_s, **motion.energies}),
        _provenance(motion, mouth, camera, px, metres, times is not None),
        px.corners,
        (camera.height_px, camera.width_px),
    )


class _Seen:
    """The openings as seen in one way: pieces, their sizes and identities.

    lips : (2, T, C, 2, 2) (row, column) of the upper and the lower lip's edges
    corners : (2, 2) (row, column) of the mouth's corners at rest
    loose : (T, C - 1) elements that may be seen through
    seen : an opening is higher than this
    """

    def __init__(self, lips: np.ndarray, corners: np.ndarray, loose: np.ndarray, seen: float):
        self.corners, self.width = corners, float(np.hypot(*(corners[1] - corners[0])))
        if not self.width > seen:
            raise InputError(
                "expected the corners of the mouth apart in the picture, got one place; turn the head less"
            )
        # From (row, column) to places along and across the mouth, so that a tilted head's lips do not run upright.
        row, column = (corners[1] - corners[0]) / self.width
        turn = np.array([[row, column], [column, -row]])
        turned = lips @ turn.T
        pieces = visible(turned[0], turned[1], loose, seen)
        self.pieces = pieces._replace(points=pieces.points @ turn)
        self.sizes = polygons.measure(self.pieces.points, self.pieces.start)

    def tables(self, time_s: np.ndarray, unit: str) -> tuple[pd.DataFrame, pd.DataFrame]:
        who = identities(self.pieces.frame, self.pieces.first, self.pieces.last, self.sizes[:, _AREA])
        frames = frame_table(time_s, self.pieces, self.sizes, self.width, unit)
        return frames, opening_table(time_s, self.pieces, self.sizes, who, unit)

    def polygons(self, frames: int) -> list[list[np.ndarray]]:
        found: list[list[np.ndarray]] = [[] for _ in range(frames)]
        start = self.pieces.start
        for k, frame in enumerate(self.pieces.frame):
            found[frame].append(self.pieces.points[start[k] : start[k + 1]])
        return found


def _straight_on(camera: Camera, points: np.ndarray) -> np.ndarray:
    """(row, column) in m of points (..., 3), m, turned as the head is: no perspective, the mesh's origin at (0, 0)."""
    turned = points @ camera.rotation.T
    return np.stack([-turned[..., 1], turned[..., 0]], axis=-1)


def _edges_only(motion: Motion, mouth: Mouth) -> Motion:
    """The motion of the nodes of the lips' edges: first all of the upper lip, then all of the lower."""
    if motion.positions.shape[1] != len(mouth.nodes):
        raise InputError(
            f"expected a motion of the mouth's {len(mouth.nodes)} nodes, got {motion.positions.shape[1]}; "
            "give the mouth that was solved"
        )
    if motion.saliva is None:
        raise InputError("expected a motion with the saliva's states, got one without; solve a model that has saliva")
    nodes = np.concatenate([mouth.upper.ravel(), mouth.lower.ravel()])
    return dataclasses.replace(
        motion,
        positions=motion.positions[:, nodes],
        nodes=mouth.nodes[nodes],
        velocities=None,
        saliva=motion.saliva.of(mouth.saliva),
    )


def _saliva_table(time_s: np.ndarray, record: SalivaRecord, mouth: Mouth) -> pd.DataFrame:
    frames, count = len(time_s), len(record.elements)
    middle = mouth.nodes[mouth.elements[record.elements]].mean(axis=1)
    return pd.DataFrame(
        {
            "frame": np.repeat(np.arange(frames), count),
            "time_s": np.repeat(time_s, count),
            "element": np.tile(record.elements, frames),
            "x_m": np.tile(middle[:, 0], frames),
            "state": np.array(STATES, object)[record.state.ravel()],
            "stretch": record.stretch.ravel(),
            "moisture": record.moisture.ravel(),
            "critical": record.critical.ravel(),
        }
    )


def _provenance(motion: Motion, mouth: Mouth, camera: Camera, px: _Seen, metres: _Seen, chosen: bool) -> dict:
    """What a reader needs to get the same numbers again; no time of day, so the same bytes too."""
    return {
        "format": FORMAT,
        "file": "",
        "source": "simulation",
        "method": "geometry",
        "settings": {
            "seen_m": SEEN_M,
            "times": "given" if chosen else "as saved",
            "camera": dataclasses.asdict(camera),
            "mouth": None if mouth.shape is None else dataclasses.asdict(mouth.shape),
            "elements": len(mouth.elements),
            "saliva_elements": len(mouth.saliva),
            "film_m": mouth.film_m,
            "solver": {"dt_s": motion.dt_s, "steps": motion.steps, **motion.settings},
        },
        "mouth_width_px": px.width,
        "mouth_width_m": metres.width,
        "mouth_width_found": "geometry",
        "corners_px": px.corners.tolist(),
        "rates": RATE_FORMULA,
        "warnings": [] if motion.stopped is None else [str(motion.stopped)],
        "versions": {
            "lipmetrics": version("lipmetrics"),
            "python": platform.python_version(),
            "numpy": np.__version__,
        },
    }


def _json(meta: dict) -> str:
    """As JSON, with null for what is not finite and text for what JSON has no word for."""
    return json.dumps(_plain(meta), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(value):
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)
