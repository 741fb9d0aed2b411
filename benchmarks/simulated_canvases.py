"""Simulated mouths for training the default method: solved motions, random looks, and what each pixel shows.

Motions of random faces in all built-in scenes are solved once on the low mesh and kept in a folder. A canvas then is a
random moment of one of them, more often one that has just opened or that has several openings, in a random skin, light
and camera. Of every pixel the shares of mouth (lips and opening), of opening and of lower lip are known from the mesh.

Faces and motions are drawn from SEED; nothing of a validation suite is used here.
"""

from __future__ import annotations

import dataclasses
import math
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache, partial
from importlib.resources import files
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from lipmetrics.artificial import photograph, random_camera
from lipmetrics.atomic import whole_file
from lipmetrics.box import Box, lay_canvas
from simulator.aperture import shown_positions
from simulator.camera import Camera
from simulator.errors import InputError
from simulator.faces import random_face
from simulator.look import Inside, Light, Look, Sensor, Skin
from simulator.mouth import SALIVA, Mouth
from simulator.render import Stage
from simulator.scene import Face, SalivaPatch, Scene, load_scene
from simulator.simulate import simulate
from simulator.truth import truth

SEED = 51_870
MOTIONS = 160
SCENES = tuple(
    sorted(file.name[:-5] for file in files("simulator").joinpath("scenes").iterdir() if file.name.endswith(".toml"))
)
LEVELS = (0.0, 4.0, 7.0, 10.0)  # stickiness: none, slight, normal, strong
PATCHED = 0.4  # share of motions with a stickier place, which parts the opening in two for a while
SLIT_MW = 0.1  # openings lower than this are slits
SHUT, SLITS, SEVERAL, WIDER = 0.3, 0.3, 0.15, 0.25  # weights of the states that are drawn
STAGES, PER_STAGE = 420, 8  # looks, and pictures of each: a look costs as much as ten pictures
MOUTH_PX = (60.0, 120.0)  # in the picture
PICTURE_MW = (2.3, 2.6)  # height and width of the picture
FINER = 4  # sub-pixels along each axis for the share of lips


class Solved(NamedTuple):
    """A solved motion. positions : (T, N, 3) m; state : (T, S); height_mw : (T,) of the highest opening, mouth
    widths; openings : (T,) how many"""

    scene: Scene
    mouth: Mouth
    time_s: np.ndarray
    positions: np.ndarray
    state: np.ndarray
    height_mw: np.ndarray
    openings: np.ndarray


# -- motions


def random_scene(rng: np.random.Generator) -> Scene:
    """A built-in scene with another face, stickiness and strength."""
    scene = load_scene(str(rng.choice(SCENES)))
    shape = random_face(rng)
    face = Face(resolution="low", **dataclasses.asdict(shape))
    scene = dataclasses.replace(scene, face=face)
    level = float(rng.choice(LEVELS)) * rng.uniform(0.8, 1.2)
    if scene.saliva.stickiness > 0:
        scene = scene.with_stickiness(level)
    glue = scene.saliva
    if rng.random() < PATCHED:
        middle, half = rng.uniform(-0.35, 0.35) * shape.width_m, rng.uniform(0.02, 0.07) * shape.width_m
        patch = SalivaPatch(float(rng.uniform(60, 200)), middle - half, middle + half, 0.001)
        glue = dataclasses.replace(glue, patch=(*glue.patch, patch))
    muscle = tuple(
        action if action.peak_m is None else dataclasses.replace(action, peak_m=action.peak_m * rng.uniform(0.35, 1.15))
        for action in scene.muscle
    )
    return dataclasses.replace(scene, saliva=glue, muscle=muscle)


def solve_motions(folder: Path, processes: int = 1, count: int = MOTIONS, seed: int = SEED) -> None:
    """Solve the motions that the folder lacks."""
    folder.mkdir(parents=True, exist_ok=True)
    missing = [n for n in range(count) if not _file(folder, seed, n).exists()]
    if processes == 1:
        for n in missing:
            _solve(folder, seed, n)
        return
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        list(pool.map(partial(_solve, folder, seed), missing))


def _file(folder: Path, seed: int, number: int) -> Path:
    return folder / f"motion_{seed}_{number:04d}.npz"


def _scene(seed: int, number: int, attempt: int) -> Scene:
    return random_scene(np.random.default_rng([seed, number, attempt]))


def _solve(folder: Path, seed: int, number: int) -> None:
    for attempt in range(20):
        scene = _scene(seed, number, attempt)
        try:
            mouth, model = scene.model()
            motion = simulate(scene, parts=(mouth, model), threads=1)
            found = truth(motion, mouth, Camera(), motion.time_s)
        except InputError:  # lengths that do not make a face, or a patch beside the lips
            continue
        if motion.stopped is None:
            break
    else:
        raise SystemExit(f"expected a motion of number {number} in 20 attempts, got none")
    frames = found.frames
    with whole_file(_file(folder, seed, number)) as part, part.open("wb") as file:
        np.savez(
            file,
            attempt=attempt,
            time_s=motion.time_s,
            positions=motion.positions.astype(np.float32),
            state=motion.saliva.of(mouth.saliva).state,
            height_mw=frames["height_mw"].fillna(0).to_numpy(float),
            openings=frames["n_openings"].to_numpy(int),
        )


@lru_cache(maxsize=200)
def solved(folder: Path, number: int, seed: int = SEED) -> Solved:
    """A motion that :func:`solve_motions` has solved."""
    with np.load(_file(folder, seed, number)) as kept:
        scene = _scene(seed, number, int(kept["attempt"]))
        names = ("time_s", "positions", "state", "height_mw", "openings")
        return Solved(scene, scene.face.mouth(), *(kept[name] for name in names))


# -- moments and looks


def random_states(motion: Solved, count: int, rng: np.random.Generator) -> list[int]:
    """Numbers of up to `count` different states of a motion: a third shut, the others open, half of these only just."""
    height, openings = motion.height_mw, motion.openings
    slit = (openings > 0) & (height < SLIT_MW)
    weight = np.zeros(len(height))
    for share, kind in ((SHUT, openings == 0), (SEVERAL, openings > 1), (SLITS, slit), (WIDER, height >= SLIT_MW)):
        if kind.any():
            weight[kind] += share / kind.sum()
    some = min(count, int((weight > 0).sum()))
    return sorted(rng.choice(len(height), some, replace=False, p=weight / weight.sum()).tolist())


def random_look(rng: np.random.Generator) -> Look:
    """Skin, light, the inside of the mouth and a camera's sensor over the human range and beyond."""

    def colour(middle, spread):
        return tuple(float(v) for v in np.clip(np.array(middle) + rng.normal(0, spread, 3), 0, 255))

    red = rng.uniform(60, 220)
    painted = (red, red * rng.uniform(0.15, 0.6), red * rng.uniform(0.2, 0.7))
    pale = rng.random() < 0.15  # lips that hardly differ from the skin
    skin = Skin(
        tone=float(rng.uniform(0, 1)),
        redness=float(rng.uniform(0, 1)),
        lip_redness=0.0 if pale else float(rng.uniform(0, 1)),
        lip_colour=painted if not pale and rng.random() < 0.15 else None,
        texture=float(rng.uniform(0, 1)),
        lip_lines=float(rng.uniform(0, 1)),
        border_m=float(rng.uniform(0.0003, 0.0015)),
        sheen=float(rng.uniform(0, 0.8)),
        wetness=float(rng.uniform(0, 1)),
        gloss=float(rng.uniform(0, 1)),
        seam=float(rng.uniform(0.2, 1)),
        film=float(rng.uniform(0.5, 1)),
        stubble=float(rng.uniform(0, 1)) if rng.random() < 0.35 else 0.0,
        freckles=float(rng.uniform(0, 1)) if rng.random() < 0.2 else 0.0,
        nose=bool(rng.random() < 0.9),
    )
    warm, sky = rng.normal(0, 18), rng.normal(0, 14)
    light = Light(
        direction=(float(rng.normal(0, 0.6)), float(rng.normal(0.3, 0.7)), float(rng.uniform(0.3, 1.2))),
        strength=float(rng.uniform(0.4, 1.2)),
        ambient=float(rng.uniform(0.12, 0.7)),
        colour=tuple(float(v) for v in np.clip((245 + warm, 240, 235 - warm), 0, 255)),
        ambient_colour=tuple(float(v) for v in np.clip((238 + sky, 240, 245 - sky), 0, 255)),
        softness=float(rng.uniform(0, 1)),
    )
    inside = Inside(
        upper_teeth=bool(rng.random() < 0.85),
        lower_teeth=bool(rng.random() < 0.75),
        tongue=bool(rng.random() < 0.85),
        teeth_colour=colour((228, 216, 194), 14),
        gum_colour=colour((190, 112, 110), 16),
        tongue_colour=colour((188, 105, 105), 18),
        cavity_colour=colour(np.array((66, 24, 24)) * rng.uniform(0.3, 1.4), 6),
        upper_edge_m=float(rng.normal(-0.0028, 0.0018)),
        lower_edge_m=float(rng.normal(-0.0024, 0.0018)),
        teeth_z_m=float(rng.uniform(-0.012, -0.006)),
        tongue_height_m=float(rng.uniform(-0.003, 0.01)),
        shadow=float(rng.uniform(0.2, 0.95)),
        depth_m=float(rng.uniform(0.008, 0.035)),
    )
    sensor = Sensor(
        exposure=float(np.exp(rng.normal(0, 0.25))),
        blur_px=float(rng.uniform(0, 0.7)),
        noise=float(abs(rng.normal(0, 0.012))),
        vignette=float(rng.uniform(0, 0.4)) if rng.random() < 0.3 else 0.0,
        shutter=0.0,
    )
    return Look(skin, light, inside, sensor, colour((110, 110, 112), 45), int(rng.integers(2**31)))


# -- pictures


def draw_pictures(folder: Path, processes: int = 1, stages: int = STAGES, motions: int = MOTIONS) -> None:
    """Draw the pictures that the folder lacks: for each stage PER_STAGE states of a random motion, in a random look.

    A picture is 000000_0.png, its shares are 000000_0.shares.png, and 000000.npz says where the mouths lie.
    """
    missing = [n for n in range(stages) if not (folder / f"{n:06d}.npz").exists()]
    work = partial(_draw_stage, folder, motions)
    if processes == 1:
        list(map(work, missing))
        return
    with ProcessPoolExecutor(processes, get_context("spawn"), cv2.setNumThreads, (1,)) as pool:
        list(pool.map(work, missing, chunksize=4))


def _draw_stage(folder: Path, motions: int, number: int) -> None:
    rng = np.random.default_rng([SEED, 2, number])
    motion = solved(folder, int(rng.integers(motions)))
    mouth = motion.mouth
    mouth_px = math.exp(rng.uniform(*np.log(MOUTH_PX)))
    size = tuple(round(side * mouth_px) for side in PICTURE_MW)
    yaw, pitch, roll = np.clip(rng.normal(0, (8.0, 8.0, 2.0)), -20, 20).tolist()
    view = {"yaw_deg": yaw, "pitch_deg": pitch, "roll_deg": roll, "distance_m": math.exp(rng.normal(0, 0.5))}
    camera = Camera(width_px=size[1], height_px=size[0], view_m=PICTURE_MW[1] * mouth.width_m, **view)
    stage = Stage(mouth, camera, random_look(rng))
    jaw = motion.scene.jaw(mouth)
    places, states = [], random_states(motion, PER_STAGE, rng)
    for k, state_number in enumerate(states):
        positions, state = motion.positions[state_number].astype(float), motion.state[state_number]
        during = None
        if rng.random() < 0.2:  # the shutter was open from one state to another
            last, reach = len(motion.time_s) - 1, rng.uniform(0, 0.5)
            others = motion.positions[[max(state_number - 1, 0), min(state_number + 1, last)]]
            during = tuple((1 - reach) * positions + reach * other for other in others)
        angle, joint = jaw.transform(float(motion.time_s[state_number]))
        picture = stage.draw(
            positions,
            state=state,
            during=during,
            jaw=(math.degrees(angle), (float(joint[1]), float(joint[2]))),
            frame=k,
        )
        patches = lip_patches(mouth, positions)
        opening = stage.cover(positions, state)
        upper, lower = (lip_share(camera, patches[side], size) for side in ("upper", "lower"))
        whole = np.maximum(np.maximum(upper, lower), opening)
        shares = np.stack([whole, opening, np.minimum(lower, whole - opening)], axis=-1)
        ends = np.concatenate([camera.project(patch) for side in patches.values() for patch in side])
        corners = camera.project(positions[[mouth.upper[[0, -1], 0], mouth.lower[[0, -1], 0]]].mean(axis=0))
        places.append((*(ends.min(axis=0) + ends.max(axis=0)) / 2, *(corners[1] - corners[0])))
        _write_png(folder / f"{number:06d}_{k}.png", picture)
        _write_png(folder / f"{number:06d}_{k}.shares.png", np.uint8(np.rint(255 * shares)))
    with whole_file(folder / f"{number:06d}.npz") as part, part.open("wb") as file:
        np.savez(file, places=places, openings=motion.openings[states])


def _write_png(path: Path, picture: np.ndarray) -> None:
    path.write_bytes(cv2.imencode(".png", picture[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 2])[1].tobytes())


class Picture(NamedTuple):
    """File of a picture, middle of its lips (row, column), way from corner to corner, and whether it is open."""

    stem: str
    middle: tuple[float, float]
    across: tuple[float, float]
    is_open: bool


@lru_cache(maxsize=1)
def pictures(folder: Path) -> tuple[list[Picture], list[Picture]]:
    """The shut and the open pictures of a folder, in order."""
    found: tuple[list[Picture], list[Picture]] = ([], [])
    for file in sorted(folder.glob("[0-9]*.npz")):
        with np.load(file) as kept:
            for k, (place, openings) in enumerate(zip(kept["places"], kept["openings"], strict=True)):
                stem = f"{file.stem}_{k}"
                found[int(openings > 0)].append(Picture(stem, tuple(place[:2]), tuple(place[2:]), bool(openings > 0)))
    return found


def _read_png(path: Path) -> np.ndarray:
    return np.ascontiguousarray(cv2.imread(str(path), cv2.IMREAD_COLOR)[..., ::-1])


class _Frame:
    """A picture with what `lay_canvas` asks of a frame."""

    def __init__(self, picture: np.ndarray) -> None:
        self.picture = picture
        self.height, self.width = picture.shape[:2]

    def rgb(self, region: tuple[int, int, int, int]) -> np.ndarray:
        row0, row1, col0, col1 = region
        return self.picture[row0:row1, col0:col1]


def cut_canvas(
    folder: Path,
    size: tuple[int, int],
    resize: float,
    away_mw: np.ndarray,
    turn_rad: float,
    closed: float,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """A canvas (rows, cols, 3) uint8 RGB cut out of a random picture as in use, and its shares (3, rows, cols) float32.

    Parameters
    ----------
    folder : with the pictures
    resize : how many times too large the mouth is on the canvas
    away_mw : (2,) by which the mouth lies off the middle, downwards and to the right
    turn_rad : by which it is turned
    closed : share of shut mouths
    """
    shut, opened = pictures(folder)
    some = (shut if rng.random() < closed else opened) or shut or opened
    one = some[int(rng.integers(len(some)))]
    down, right = one.across
    width_px, roll = math.hypot(down, right) / resize, math.atan2(down, right) - turn_rad
    middle = np.array(one.middle) - away_mw * width_px
    picture = np.float32(_read_png(folder / f"{one.stem}.png")) / np.float32(255)
    taken = photograph(picture, random_camera(rng), rng)
    box = Box(float(middle[0]), float(middle[1]), width_px, roll)
    canvas, shares = (
        lay_canvas(_Frame(each), box, size) for each in (taken, _read_png(folder / f"{one.stem}.shares.png"))
    )
    if canvas is None:  # beside the picture
        return cut_canvas(folder, size, resize, away_mw / 2, turn_rad, closed, rng)
    return canvas, np.moveaxis(shares.astype(np.float32) / 255, -1, 0)


# -- what is known


def lip_patches(mouth: Mouth, positions: np.ndarray) -> dict[str, list[np.ndarray]]:
    """Polygons (n, 3), m, that make up the red of both lips when the nodes are at positions (N, 3).

    The border of the red runs through the quads, where the distance to it is 0; the saliva's quads are halved.
    """
    shown = shown_positions(mouth, positions[None])[0]
    upper_edge = np.zeros(len(mouth.nodes), bool)
    upper_edge[mouth.upper[:, 0]] = True
    patches: dict[str, list[np.ndarray]] = {"upper": [], "lower": []}
    seam_x = mouth.nodes[mouth.upper[:, 0], 0]
    seam_y = (mouth.nodes[mouth.upper[:, 0], 1] + mouth.nodes[mouth.lower[:, 0], 1]) / 2
    for quad, group in zip(mouth.outer, mouth.group, strict=True):
        points, border = shown[quad], mouth.border_m[quad]
        if group == SALIVA:
            top = upper_edge[quad]
            middle = points.copy()
            for k in range(4):  # its partner across the film is the neighbour of the other lip
                other = (k + 1) % 4 if top[(k + 1) % 4] != top[k] else (k - 1) % 4
                middle[k] = (points[k] + points[other]) / 2
            patches["upper"].append(np.where(top[:, None], points, middle))
            patches["lower"].append(np.where(top[:, None], middle, points))
            continue
        if border.max() <= 0:
            continue
        rest = mouth.nodes[quad].mean(axis=0)
        side = "upper" if rest[1] > np.interp(rest[0], seam_x, seam_y) else "lower"
        patches[side].append(points if border.min() >= 0 else _cut(points, border))
    return patches


def _cut(points: np.ndarray, border: np.ndarray) -> np.ndarray:
    """The part of a polygon (n, 3) where the border (n,), linear between its corners, is positive."""
    kept = []
    for k in range(len(points)):
        nearer, farther = border[k - 1], border[k]
        if (nearer > 0) != (farther > 0):
            kept.append(points[k - 1] + nearer / (nearer - farther) * (points[k] - points[k - 1]))
        if farther > 0:
            kept.append(points[k])
    return np.array(kept)


def lip_share(camera: Camera, patches: list[np.ndarray], size: tuple[int, int]) -> np.ndarray:
    """(rows, cols) float32 share of every pixel that the polygons cover."""
    mask = np.zeros((size[0] * FINER, size[1] * FINER), np.uint8)
    for patch in patches:
        places = (camera.project(patch) + 0.5) * FINER - 0.5
        cv2.fillConvexPoly(mask, np.rint(places[:, ::-1] * 16).astype(np.int32), 1, cv2.LINE_8, 4)
    return cv2.resize(mask.astype(np.float32), size[::-1], interpolation=cv2.INTER_AREA)
