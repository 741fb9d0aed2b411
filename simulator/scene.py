"""Scenes: everything a clip is made from, as frozen dataclasses and as TOML files that people read and change.

`load_scene` reads a file or one of the built-in scenes in simulator/scenes; `Scene.model` assembles what the solver
needs. The keys of a file are the fields of the dataclasses here; docs/scenes.md explains them.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Literal

import numpy as np

from simulator.camera import Camera
from simulator.curves import KeyFrames, read_key_frames
from simulator.errors import InputError
from simulator.faces import face
from simulator.look import Colour, Inside, Light, Look, Sensor, Skin
from simulator.materials import NeoHookean
from simulator.model import Load, Model
from simulator.moisture import FULL_LEVEL, Lick, strength_of_level
from simulator.mouth import COMMISSURE, SALIVA, Mouth, MouthShape, mouth_mesh
from simulator.muscles import JAW, MUSCLES, Activation, Jaw, jaw, muscle_loads, skull, usual_force
from simulator.obj_mesh import read_mouth_obj
from simulator.saliva import DECAY_S, POOLING, RAMP_S, Saliva, pooled
from simulator.settings import from_table, parse_toml, read_toml
from simulator.volumes import Box, Ellipsoid, read_closed_surface
from simulator.wording import choices, nearest

LONGEST_S = 600.0
HIGHEST_POOLING = 1000.0
HIGHEST_LEVEL = 1000.0  # ten times the study's strongest glue, and more, for special effects
HIGHEST_RATE = 10_000.0  # frames per second
MOST_FRAMES = 100_000
LARGEST_MOTION = 8e9  # bytes of positions
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")
_SAMPLES = 16  # places in an element at which a patch is looked up


@dataclass(frozen=True)
class Face:
    """Whose mouth it is. A length that is left out is that of the preset.

    Parameters
    ----------
    preset : a built-in face
    resolution : low, medium or high: 870, 3,422 or 13,680 elements
    obj : OBJ file of quads with the groups skin, lips and saliva, used instead of the preset
    obj_units : of that file: m, cm or mm
    width_m : mouth, from corner to corner
    upper_lip_m, lower_lip_m : height of the red of that lip at the middle
    protrusion_m : how far the lips stand out
    bow_m : depth of the dip in the middle of the upper lip's border
    corner_rise_m : how much higher the corners are than the middle of the line between the lips
    thickness_m : depth of skin and lips
    film_m : thickness of the saliva between the closed lips
    half_width_m : from the middle to the edge of the face that is modelled
    above_m, below_m : from the line of the mouth to that edge of the face that is modelled
    face_radius_m : radius of the face seen from above
    chin_m : how far the chin stands out
    groove_m : depth of the furrow between lower lip and chin
    """

    preset: str = "average"
    resolution: str = "medium"
    obj: str | None = None
    obj_units: str = "m"
    width_m: float | None = None
    upper_lip_m: float | None = None
    lower_lip_m: float | None = None
    protrusion_m: float | None = None
    bow_m: float | None = None
    corner_rise_m: float | None = None
    thickness_m: float | None = None
    film_m: float | None = None
    half_width_m: float | None = None
    above_m: float | None = None
    below_m: float | None = None
    face_radius_m: float | None = None
    chin_m: float | None = None
    groove_m: float | None = None

    def shape(self) -> MouthShape:
        """The preset's lengths, but for those given here."""
        return dataclasses.replace(_preset(self.preset), **self._own_lengths())

    def spelled_out(self) -> Face:
        """The same face with all its lengths given."""
        return self if self.obj else dataclasses.replace(self, **dataclasses.asdict(self.shape()))

    def mouth(self) -> Mouth:
        """Its mesh."""
        if self.obj is None:
            return mouth_mesh(self.shape(), self.resolution)
        own = self._own_lengths()
        if set(own) - {"thickness_m"}:
            name = next(name for name in own if name != "thickness_m")
            raise InputError(f"expected lengths of a face without obj, got {name} beside obj = '{self.obj}'")
        return read_mouth_obj(self.obj, own.get("thickness_m", MouthShape().thickness_m), self.obj_units)

    def _own_lengths(self) -> dict[str, float]:
        lengths = {one.name: getattr(self, one.name) for one in dataclasses.fields(MouthShape)}
        return {name: value for name, value in lengths.items() if value is not None}


@dataclass(frozen=True)
class Tissue:
    """What skin and lips are made of.

    Parameters
    ----------
    shear_pa, bulk_pa : Neo-Hookean modulus, Pa
    corner_shear_pa, corner_bulk_pa : that of the firm tissue at the ends of the line between the lips, Pa
    density : kg/m3
    damping_per_s : mass-proportional damping, 1/s: movements die out by e in twice its inverse
    hourglass : stiffness against shapes that elements of one integration point do not feel, dimensionless
    """

    shear_pa: float = 800.0
    bulk_pa: float = 7000.0
    corner_shear_pa: float = 4000.0
    corner_bulk_pa: float = 35000.0
    density: float = 1050.0
    damping_per_s: float = 20.0
    hourglass: float = 0.08


@dataclass(frozen=True)
class SalivaPatch:
    """A part of the lips that is more or less sticky than the rest.

    Parameters
    ----------
    stickiness : level in the patch, beside the stickiness of the whole
    from_m, to_m : where it begins or ends along the lips, m: 0 is the middle, positive x is right in the picture; left
        out, it goes on to the corner
    edge_m : width over which it fades out beyond its ends, m
    """

    stickiness: float
    from_m: float | None = None
    to_m: float | None = None
    edge_m: float = 0.0

    def __post_init__(self):
        _check_level(self.stickiness)
        _check_part(self)


@dataclass(frozen=True)
class Glue:
    """The saliva between the lips.

    Parameters
    ----------
    stickiness : level: 0 does not stick, 4 is slight, 7 normal, 10 strong, above 10 is for special effects
    pooling : how many times as sticky the corners of the mouth are as its middle: saliva gathers there; 1 is even
    shear_pa, bulk_pa : Neo-Hookean modulus, Pa
    decay_s : the force of broken saliva falls by e in this time, s
    ramp_s : where the lips meet again the force comes back over this time, s
    patch : parts of the lips with a stickiness of their own; a later one lies over an earlier one
    """

    stickiness: float = 7.0
    pooling: float = POOLING
    shear_pa: float = 7700.0
    bulk_pa: float = 191000.0
    decay_s: float = DECAY_S
    ramp_s: float = RAMP_S
    patch: tuple[SalivaPatch, ...] = ()

    def __post_init__(self):
        _check_level(self.stickiness)
        if not (math.isfinite(self.pooling) and 0 < self.pooling <= HIGHEST_POOLING):
            raise InputError(f"expected a pooling above 0 and up to {HIGHEST_POOLING:g}, got {self.pooling:g}")


@dataclass(frozen=True)
class MoisturePatch:
    """A part of the lips that is wetter or drier, or dries faster or more slowly; what is left out is as elsewhere.

    Parameters
    ----------
    from_m, to_m : where it begins or ends along the lips, m; left out, it goes on to the corner
    initial : moisture at the start over the critical one
    drying_per_s : how much of the critical moisture dries in 1 s, 1/s
    edge_m : width over which it fades out beyond its ends, m
    """

    from_m: float | None = None
    to_m: float | None = None
    initial: float | None = None
    drying_per_s: float | None = None
    edge_m: float = 0.0

    def __post_init__(self):
        _check_moisture(self)
        _check_part(self)


@dataclass(frozen=True)
class LickAt:
    """The lips are licked.

    Parameters
    ----------
    time_s : when, s
    moisture : moisture from then on, over the critical one
    from_m, to_m : where the wetted part begins or ends along the lips, m; left out, it goes on to the corner
    """

    time_s: float
    moisture: float = 1.0
    from_m: float | None = None
    to_m: float | None = None

    def __post_init__(self):
        if not self.time_s > 0:
            raise InputError(f"expected time_s above 0 s, got {self.time_s}; what holds at the start is 'initial'")
        _check_moisture(self)
        _check_part(self)


@dataclass(frozen=True)
class Moisture:
    """How wet the saliva is. At the critical moisture, 1, it has its full stickiness; drier it has less in proportion,
    wetter it only lubricates.

    Parameters
    ----------
    initial : moisture at the start over the critical one
    drying_per_s : how much of the critical moisture dries in 1 s, 1/s
    patch : parts of the lips that differ; a later one lies over an earlier one
    lick : wettings, in the order of their times
    """

    initial: float = 1.0
    drying_per_s: float = 0.0
    patch: tuple[MoisturePatch, ...] = ()
    lick: tuple[LickAt, ...] = ()

    def __post_init__(self):
        _check_moisture(self)


@dataclass(frozen=True)
class Action:
    """A muscle or the jaw at work.

    Parameters
    ----------
    name : which muscle, or jaw
    side : both, left or right of the face; the left of the face is right in the picture
    peak_n : force of each side at an activation of 1, N; left out, the muscle's usual one on a mouth of this size
    peak_m : for the jaw: how far the chin sinks at an activation of 1, m
    forward : force out of the mouth over that along the face; left out, the muscle's usual one
    keys : activation over time: [time in s, activation], and between two of them how the one leads to the other:
        smooth, quarter_sin, geometric or linear, which may be left out
    file : text file with the keys instead, as listing 3.1 of the thesis
    box, ellipsoid : where the muscle pulls on the left of the face, instead of its usual place
    volume_obj : OBJ file of a closed surface, for the same
    """

    name: str
    side: Literal["both", "left", "right"] = "both"
    peak_n: float | None = None
    peak_m: float | None = None
    forward: float | None = None
    keys: tuple[tuple[float, float] | str, ...] = ()
    file: str | None = None
    box: Box | None = None
    ellipsoid: Ellipsoid | None = None
    volume_obj: str | None = None

    def __post_init__(self):
        wrong = "peak_n" if self.name == JAW else "peak_m"
        if getattr(self, wrong) is not None:
            right = "peak_m, how far the chin sinks," if self.name == JAW else "peak_n, a force,"
            raise InputError(f"expected {right} for {self.name}, got {wrong}")
        if bool(self.keys) == bool(self.file):
            raise InputError(f"expected keys or a file with them, got {'both' if self.file else 'neither'}")
        if sum(one is not None for one in (self.box, self.ellipsoid, self.volume_obj)) > 1:
            raise InputError("expected one of box, ellipsoid and volume_obj, got several")
        if self.keys:
            self.curve()

    def curve(self) -> KeyFrames:
        """The activation over time."""
        times, values, segments = [], [], []
        for key in self.keys:
            if isinstance(key, str):
                if len(segments) != len(times) - 1:
                    raise InputError(f"expected '{key}' between two key frames such as [0.1, 0.5], got it elsewhere")
                segments.append(key)
            else:
                if times and len(segments) < len(times):
                    segments.append("linear")
                times.append(key[0])
                values.append(key[1])
        if len(segments) == len(times):
            raise InputError(f"expected a key frame such as [0.1, 0.5] after '{segments[-1]}', got the end")
        return KeyFrames(times, values, segments)


@dataclass(frozen=True)
class Solving:
    """How the movement is computed.

    Parameters
    ----------
    dt_s : time step, s, or auto for the largest that is stable
    precision : float32, mixed or float64
    symmetric : whether one half is computed and mirrored; auto does so where both are alike
    safety : part of the stable time step that auto takes
    mass_scaling : factor on the mass, above 1 for larger steps in slow movements
    """

    dt_s: float | Literal["auto"] = "auto"
    precision: Literal["float32", "mixed", "float64"] = "mixed"
    symmetric: bool | Literal["auto"] = "auto"
    safety: float = 0.9
    mass_scaling: float = 1.0


@dataclass(frozen=True)
class Output:
    """What is kept of the movement.

    Parameters
    ----------
    frame_rate : pictures per second
    states_per_frame : computed states that are kept per picture
    mode : picture, or as in thesis figure 3.18 wireframe or stress (von Mises)
    """

    frame_rate: float = 60.0
    states_per_frame: int = 1
    mode: Literal["picture", "wireframe", "stress"] = "picture"

    def __post_init__(self):
        if not 1 <= self.frame_rate <= HIGHEST_RATE:
            raise InputError(f"expected frame_rate from 1 to {HIGHEST_RATE:g} per second, got {self.frame_rate:g}")
        if not 1 <= self.states_per_frame <= 100:
            raise InputError(f"expected states_per_frame from 1 to 100, got {self.states_per_frame}")


@dataclass(frozen=True)
class Scene:
    """A mouth, what it does, and how it is filmed.

    Parameters
    ----------
    name : what its files are called
    about : what it shows, in a sentence
    duration_s : length of the clip, s
    seed : of skin texture, teeth and noise
    background : red, green and blue from 0 to 255 of what is behind the head
    face : whose mouth
    tissue : skin and lips
    saliva : what glues the lips
    moisture : how wet that is
    muscle : who moves the mouth
    solve : how the movement is computed
    output : what is kept of it
    camera : where the camera stands, and how the head is held
    skin : skin and lips
    light : one soft light, and light from all around
    inside : what is seen between the lips
    sensor : from light to the numbers of the picture
    """

    name: str = "scene"
    about: str = ""
    duration_s: float = 1.0
    seed: int = 0
    background: Colour = Look().background
    face: Face = field(default_factory=Face)
    tissue: Tissue = field(default_factory=Tissue)
    saliva: Glue = field(default_factory=Glue)
    moisture: Moisture = field(default_factory=Moisture)
    muscle: tuple[Action, ...] = ()
    solve: Solving = field(default_factory=Solving)
    output: Output = field(default_factory=Output)
    camera: Camera = field(default_factory=Camera)
    skin: Skin = field(default_factory=Skin)
    light: Light = field(default_factory=Light)
    inside: Inside = field(default_factory=Inside)
    sensor: Sensor = field(default_factory=Sensor)

    def __post_init__(self):
        if not _NAME.fullmatch(self.name):
            raise InputError(
                f"expected a name of letters, digits, '_', '-' and '.', which files can be called, got '{self.name}'"
            )
        if not 0 < self.duration_s <= LONGEST_S:
            raise InputError(f"expected duration_s above 0 and up to {LONGEST_S:g} s, got {self.duration_s:g}")
        if self.duration_s * self.output.frame_rate * self.output.states_per_frame > MOST_FRAMES:
            raise InputError(
                f"expected at most {MOST_FRAMES} states, got {self.duration_s:g} s at {self.output.frame_rate:g} "
                f"pictures per second and {self.output.states_per_frame} states per picture"
            )

        _ = self.look  # checks seed and background

    @property
    def look(self) -> Look:
        """All that the pictures depend on besides shape and camera."""
        return Look(self.skin, self.light, self.inside, self.sensor, self.background, self.seed)

    @property
    def frame_times_s(self) -> np.ndarray:
        """(F,) times of the pictures, s, from 0."""
        count = math.floor(self.duration_s * self.output.frame_rate + 1e-9) + 1
        return np.arange(count) / self.output.frame_rate

    @property
    def state_times_s(self) -> np.ndarray:
        """(T,) times of the states to keep, s, from 0; every one of the pictures is among them."""
        per_frame = self.output.states_per_frame
        count = (len(self.frame_times_s) - 1) * per_frame + 1
        return np.arange(count) / (self.output.frame_rate * per_frame)

    def with_stickiness(self, level: float) -> Scene:
        """The same scene at another level; patches keep their proportion to it."""
        _check_level(level)
        before = self.saliva.stickiness
        if self.saliva.patch and before == 0 and level > 0:
            raise InputError(
                f"expected a scene whose stickiness is above 0 beside its patches, to bring it to {level:g}, "
                f"got 0 in {self.name}"
            )
        patches = tuple(
            dataclasses.replace(one, stickiness=one.stickiness * level / before if before else 0.0)
            for one in self.saliva.patch
        )
        return dataclasses.replace(self, saliva=dataclasses.replace(self.saliva, stickiness=level, patch=patches))

    def with_face(self, preset: str) -> Scene:
        """The same scene with a built-in face; lengths that the scene gives the mouth of its own are left out.

        Raises
        ------
        InputError : unknown face, or a scene whose face is a file
        """
        if self.face.obj is not None:
            raise InputError(
                f"expected a scene with a built-in face to bring '{preset}' into, got one with {self.face.obj}"
            )
        face(preset)
        return dataclasses.replace(self, face=Face(preset=preset, resolution=self.face.resolution))

    def spelled_out(self) -> Scene:
        """The same scene with everything given that a preset or what is usual stands for.

        Raises
        ------
        InputError : a face that cannot be, an unknown muscle
        """
        unsaid = any(action.name != JAW and action.peak_n is None for action in self.muscle)
        mouth = self.face.mouth() if unsaid else None  # it takes time to make
        actions = tuple(_spelled_out(action, mouth) for action in self.muscle)
        return dataclasses.replace(self, face=self.face.spelled_out(), muscle=actions)

    def jaw(self, mouth: Mouth) -> Jaw:
        """The movement of the lower teeth."""
        return jaw(mouth, [_activation(action) for action in self.muscle])

    def model(self) -> tuple[Mouth, Model]:
        """The mesh, and what is to be solved.

        Raises
        ------
        InputError : a face that cannot be, an unknown muscle, a patch beside the lips, more states than fit in memory
        """
        mouth = self.face.mouth()
        if len(self.state_times_s) * mouth.nodes.nbytes > LARGEST_MOTION:
            raise InputError(
                f"expected a motion of at most {LARGEST_MOTION / 1e9:g} GB, got {len(self.state_times_s)} states of "
                f"{len(mouth.nodes)} nodes; choose a lower frame_rate, fewer states_per_frame or a coarser resolution"
            )
        tissue, glue = self.tissue, self.saliva
        return mouth, Model(
            nodes=mouth.nodes,
            elements=mouth.elements,
            materials=(
                NeoHookean(tissue.shear_pa, tissue.bulk_pa, tissue.density),
                NeoHookean(glue.shear_pa, glue.bulk_pa, tissue.density),
                NeoHookean(tissue.corner_shear_pa, tissue.corner_bulk_pa, tissue.density),
            ),
            material_of=np.select([mouth.group == SALIVA, mouth.group == COMMISSURE], [1, 2], 0),
            loads=_loads(mouth, self.muscle),
            damping=tissue.damping_per_s,
            hourglass=tissue.hourglass,
            dt_s=self.solve.dt_s,
            duration_s=self.duration_s,
            saliva=self._saliva(mouth),
        )

    def _saliva(self, mouth: Mouth) -> Saliva:
        glue, wet = self.saliva, self.moisture
        upper, lower = mouth.nodes[mouth.upper].sum(axis=1), mouth.nodes[mouth.lower].sum(axis=1)
        up = (upper - lower)[:-1] + (upper - lower)[1:]
        columns = (upper[:, 0] + lower[:, 0]) / 4  # x of the boundaries between the elements
        place = ((columns[1:] + columns[:-1]) - (columns[0] + columns[-1])) / (columns[-1] - columns[0])  # -1 to 1
        level, moisture, drying = (
            np.full(len(mouth.saliva), value, float) for value in (glue.stickiness, wet.initial, wet.drying_per_s)
        )
        for number, patch in enumerate(glue.patch, start=1):
            share = _shares(columns, patch, f"[[saliva.patch]] {number}")
            level += share * (patch.stickiness - level)
        for number, patch in enumerate(wet.patch, start=1):
            share = _shares(columns, patch, f"[[moisture.patch]] {number}")
            if patch.initial is not None:
                moisture += share * (patch.initial - moisture)
            if patch.drying_per_s is not None:
                drying += share * (patch.drying_per_s - drying)
        licks = tuple(
            Lick(
                lick.time_s,
                np.flatnonzero(_shares(columns, lick, f"[[moisture.lick]] {number}") >= 0.5),
                lick.moisture,
            )
            for number, lick in enumerate(wet.lick, start=1)
        )
        return Saliva(
            elements=mouth.saliva,
            up=up / np.linalg.norm(up, axis=1)[:, None],
            strength=strength_of_level(FULL_LEVEL) * level / FULL_LEVEL * pooled(place, glue.pooling),
            moisture=moisture,
            drying_per_s=drying,
            licks=licks,
            decay_s=glue.decay_s,
            ramp_s=glue.ramp_s,
        )


def load_scene(path_or_name: str | Path, stickiness: float | None = None) -> Scene:
    """A scene from a TOML file, or a built-in one by its name.

    Parameters
    ----------
    path_or_name : TOML file, or one of `scene_names()`
    stickiness : level to use instead of the scene's own; patches keep their proportion to it

    Raises
    ------
    InputError : no such scene, or a file with something in it that cannot be used; the message names the place
    """
    name = str(path_or_name)
    if name in scene_names():
        table, where, folder = parse_toml(scene_text(name), f"{name}.toml"), f"{name}.toml", Path()
    else:
        path = Path(path_or_name)
        if path.suffix.lower() != ".toml" and not path.exists():
            raise InputError(
                f"expected a TOML file or a built-in scene of {choices(scene_names())}, "
                f"got {nearest(name, scene_names())}"
            )
        table, where, folder, name = read_toml(path), path.name, path.parent, path.stem
    table.setdefault("name", name)
    scene = scene_from_table(table, where, folder)
    return scene if stickiness is None else scene.with_stickiness(stickiness)


def scene_from_table(table: Mapping, where: str, folder: Path = Path()) -> Scene:
    """A scene from what a TOML file holds; `where` is what messages call it, files are looked for from `folder` on."""
    scene = from_table(Scene, table, where)
    actions = []
    for number, action in enumerate(scene.muscle, start=1):
        try:
            actions.append(_with_files(action, folder))
            _activation(actions[-1])
        except InputError as error:
            raise InputError(f"{where}, [[muscle]] {number}: {error}") from None
    try:
        _preset(scene.face.preset)
    except InputError as error:
        raise InputError(f"{where}, [face]: {error}") from None
    whose = scene.face
    if whose.obj is not None:
        whose = dataclasses.replace(whose, obj=str(folder / whose.obj))
    return dataclasses.replace(scene, muscle=tuple(actions), face=whose)


def scene_names() -> tuple[str, ...]:
    """Names of the built-in scenes."""
    return tuple(sorted(one.name[:-5] for one in _built_in().iterdir() if one.name.endswith(".toml")))


def scene_text(name: str) -> str:
    """The TOML file of a built-in scene, as it was written.

    Raises
    ------
    InputError : no such scene
    """
    if name not in scene_names():
        raise InputError(f"expected a built-in scene of {choices(scene_names())}, got {nearest(name, scene_names())}")
    return (_built_in() / f"{name}.toml").read_text(encoding="utf-8")


def _built_in():
    return files("simulator") / "scenes"


def _with_files(action: Action, folder: Path) -> Action:
    """The action with the keys of its file, and its volume looked for from `folder` on."""
    if action.volume_obj is not None:
        action = dataclasses.replace(action, volume_obj=str(folder / action.volume_obj))
    if action.file is None:
        return action
    curve = read_key_frames(folder / action.file)
    keys = [key for pair in zip(curve.times_s, curve.values, strict=True) for key in (pair, "")][:-1]
    keys[1::2] = curve.segments
    return dataclasses.replace(action, keys=tuple(keys), file=None)


def _shares(columns: np.ndarray, part, place: str) -> np.ndarray:
    """(S,) share of each saliva element that lies in a part of the lips; columns are the S + 1 x between them, m."""
    start = -math.inf if part.from_m is None else part.from_m
    end = math.inf if part.to_m is None else part.to_m
    inside = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    x = columns[:-1, None] + np.diff(columns)[:, None] * inside
    beyond = np.maximum(np.maximum(start - x, x - end), 0.0)
    edge = getattr(part, "edge_m", 0.0)
    weight = np.clip(1 - beyond / edge, 0, 1) if edge > 0 else (beyond == 0).astype(float)
    share = (weight * weight * (3 - 2 * weight)).mean(axis=1)
    if not share.any():
        raise InputError(
            f"{place}: expected a part of the lips, which reach from {columns[0]:.4g} to {columns[-1]:.4g} m, "
            f"got {start:g} to {end:g} m"
        )
    return share


def _check_level(level: float) -> None:
    if not 0 <= level <= HIGHEST_LEVEL:
        raise InputError(
            f"expected a stickiness from 0 to 10, or for special effects to {HIGHEST_LEVEL:g}, got {level:g}"
        )


def _check_moisture(settings: object) -> None:
    for name in ("initial", "drying_per_s", "moisture"):
        value = getattr(settings, name, None)
        if value is not None and not value >= 0:
            raise InputError(f"expected {name} of 0 or more, got {value:g}")


def _check_part(part) -> None:
    if part.from_m is not None and part.to_m is not None and not part.from_m < part.to_m:
        raise InputError(f"expected from_m below to_m, got {part.from_m:g} and {part.to_m:g}")
    if not 0 <= getattr(part, "edge_m", 0.0) < 1:
        raise InputError(f"expected edge_m of 0 or more and below 1 m, got {part.edge_m:g}")


# -- what other modules know ------------------------------------------------------------------------------------------


def _preset(name: str) -> MouthShape:
    """Lengths of a built-in face."""
    return face(name)


def _activation(action: Action) -> Activation:
    """A muscle at work, as the module of the muscles wants it."""
    volume = action.box or action.ellipsoid
    if action.volume_obj is not None:
        volume = read_closed_surface(action.volume_obj)
    peak = action.peak_m if action.peak_n is None else action.peak_n
    return Activation(
        muscle=action.name,
        peak=peak,
        curve=action.curve(),
        side=action.side,
        volume=volume,
        forward=action.forward,
    )


def _loads(mouth: Mouth, actions: tuple[Action, ...]) -> tuple[Load, ...]:
    """The held skull, the jaw and the muscles."""
    return (skull(mouth), *muscle_loads(mouth, [_activation(action) for action in actions]))


def _spelled_out(action: Action, mouth: Mouth | None) -> Action:
    """The action with what is usual given; a usual force is that of this mouth."""
    activation = _activation(action)  # of a known muscle
    if action.name == JAW:
        return dataclasses.replace(action, peak_m=activation.peak)
    return dataclasses.replace(
        action,
        peak_n=usual_force(mouth, action.name) if action.peak_n is None else action.peak_n,
        forward=MUSCLES[action.name].forward if action.forward is None else action.forward,
    )
