"""A suite of clips to measure a detector with: many mouths, filmed in many conditions, every opening known.

There are two parts, `tune` to work on a detector with and `report` to state how good it is. They share no face and no
random number: each has its own half of the named faces, mixes only these into new ones, and has its own seed.

In each part a few movements, the core, are filmed plainly and then in every setting of every axis of `AXES`, one
factor at a time with all else plain: the movements are the same, so that a difference is due to the setting. The axes
`face`, `action`, `stickiness` and `openings` change the movement and film it plainly. In the group `mix` everything
varies at once, every clip with a face of its own: it stands for clips as they come.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from simulator.camera import Camera
from simulator.clip import pictures
from simulator.errors import InputError
from simulator.faces import FACES, random_face
from simulator.look import TONES, Colour, Inside, Light, Look, Sensor, Skin
from simulator.motion import Motion
from simulator.mouth import Mouth, MouthShape
from simulator.scene import Face, Output, SalivaPatch, Scene, load_scene
from simulator.simulate import simulate
from simulator.truth import Truth, truth
from simulator.video import write_video
from simulator.wording import choices, nearest

PARTS = ("tune", "report")
SEEDS = {"tune": 1_001, "report": 2_002}
NAMED = {
    "tune": ("average", "cupid", "full_lips", "long_chin", "narrow", "older"),
    "report": ("child", "protruding", "short_chin", "smiling", "thin_lips", "wide"),
}
RATE_HZ = 30.0
RESOLUTION = "low"  # of the mesh: the truth is that of whatever mesh is drawn
SAFETIES = (0.9, 0.6, 0.4)  # parts of the stable step that are tried, one after the other
MIX, QUICK_MIX = 112, 16  # clips in which everything varies
MOVEMENTS = ("face", "action", "stickiness", "openings")  # axes that change what is filmed, not how

# action: scene, from and to when it is filmed, s
_ACTIONS = {
    "slow_open": ("slow_open", 0.0, 0.9),
    "fast_open": ("fast_open", 0.0, 0.5),
    "m": ("m", 0.0, 0.6),
    "p": ("p", 0.0, 0.6),
    "mummy": ("mummy", 0.0, 1.3),
    "puppy": ("puppy", 0.0, 1.3),
    "demo": ("demo", 0.0, 1.5),
    "drying": ("drying", 0.0, 3.6),
    "uneven_drying": ("uneven_drying", 0.0, 3.6),
    "double_opening": ("double_opening", 0.1, 1.0),
    "one_sided_left": ("one_sided_left", 0.0, 0.9),
    "one_sided_right": ("one_sided_right", 0.0, 0.9),
    "pout": ("pout", 0.0, 0.8),
    "smile": ("smile", 0.0, 0.8),
    "glued_shut": ("glued_shut", 0.0, 0.9),
    "three_openings": ("double_opening", 0.1, 1.0),
}
_CORE = ("slow_open", "mummy", "double_opening", "one_sided_left", "p", "smile")
_STICKY = ("slow_open", "fast_open", "m")
_BRIDGES = ((-0.007, -0.0035), (0.0035, 0.007))  # two places that stick hard leave three openings, m


@dataclass(frozen=True)
class Filming:
    """How a movement is filmed.

    Parameters
    ----------
    mouth_px : width of the mouth at rest in the picture, px
    picture_mw : width and height of the picture, mouth widths
    shift_mw : how far the mouth lies right of and below the middle of the picture, mouth widths
    drift_mw : how far it sways to either side while it is filmed, mouth widths
    yaw_deg, pitch_deg, roll_deg : as in `simulator.camera.Camera`
    crf : constant rate factor of the video's H.264
    skin, light, inside, sensor, background : as in `simulator.look.Look`
    """

    mouth_px: float = 110.0
    picture_mw: tuple[float, float] = (3.0, 2.6)
    shift_mw: tuple[float, float] = (0.0, 0.0)
    drift_mw: float = 0.0
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    crf: int = 18
    skin: Skin = field(default_factory=Skin)
    light: Light = field(default_factory=Light)
    inside: Inside = field(default_factory=Inside)
    sensor: Sensor = field(default_factory=Sensor)
    background: Colour = Look().background


_CLOSE = {"picture_mw": (1.7, 1.3)}  # large mouths fill the picture, as it would grow too large to be drawn
# axis -> setting -> what differs from the plain filming
AXES: dict[str, dict[str, dict]] = {
    "skin tone": {name: {"skin.tone": name} for name in TONES},
    "lips": {
        "pale": {"skin.lip_redness": 0.0},
        "red": {"skin.lip_redness": 1.0},
        "lipstick": {"skin.lip_colour": (178, 24, 44)},
        "dark lipstick": {"skin.lip_colour": (74, 22, 34)},
        "as the skin": {"skin.lip_colour": (212, 164, 140), "skin.lip_lines": 0.3},
        "dark skin pale": {"skin.tone": "dark", "skin.lip_redness": 0.0},
    },
    "light from": {
        "front": {"light.direction": (0.0, 0.1, 1.0)},
        "left": {"light.direction": (-1.0, 0.1, 0.35)},
        "right": {"light.direction": (1.0, 0.1, 0.35)},
        "above": {"light.direction": (0.0, 1.0, 0.3)},
        "below": {"light.direction": (0.0, -1.0, 0.4)},
        "hard left": {"light.direction": (-1.0, 0.3, 0.25), "light.softness": 0.0, "light.ambient": 0.1},
    },
    "light colour": {
        "warm": {"light.colour": (255, 190, 120), "light.ambient_colour": (255, 205, 150)},
        "cool": {"light.colour": (190, 215, 255), "light.ambient_colour": (180, 210, 255)},
        "green": {"light.colour": (225, 255, 200), "light.ambient_colour": (220, 255, 210)},
        "red cast": {"sensor.cast": (1.3, 1.0, 0.8)},
        "blue cast": {"sensor.cast": (0.75, 1.0, 1.35)},
    },
    "light level": {
        "1/2": {"sensor.exposure": 0.5},
        "1/4": {"sensor.exposure": 0.25},
        "1/10": {"sensor.exposure": 0.1},
        "1.6 times": {"sensor.exposure": 1.6},
        "2.5 times": {"sensor.exposure": 2.5},
    },
    "beard": {"light": {"skin.stubble": 0.3}, "medium": {"skin.stubble": 0.6}, "full": {"skin.stubble": 1.0}},
    "teeth": {
        "none": {"inside.upper_teeth": False, "inside.lower_teeth": False},
        "long upper": {"inside.upper_edge_m": -0.006},
        "lower shown": {"inside.lower_edge_m": 0.002},
        "white": {"inside.teeth_colour": (252, 250, 246), "inside.shadow": 0.1, "inside.depth_m": 0.05},
    },
    "tongue": {
        "none": {"inside.tongue": False},
        "raised": {"inside.tongue_height_m": 0.008},
        "bright": {"inside.tongue_height_m": 0.008, "inside.tongue_colour": (226, 140, 136), "inside.shadow": 0.2},
    },
    "highlights": {
        "matte": {"skin.wetness": 0.0, "skin.sheen": 0.0},
        "wet lips": {"skin.wetness": 1.0, "skin.gloss": 1.0},
        "shining": {"skin.wetness": 1.0, "skin.gloss": 0.2, "skin.sheen": 1.0},
    },
    "noise": {
        "3 %": {"sensor.noise": 0.03, "sensor.read_noise": 0.005},
        "6 %": {"sensor.noise": 0.06, "sensor.read_noise": 0.01},
        "12 %": {"sensor.noise": 0.12, "sensor.read_noise": 0.02},
    },
    "blur": {
        "1.5 px": {"sensor.blur_px": 1.5},
        "3 px": {"sensor.blur_px": 3.0},
        "5 px": {"sensor.blur_px": 5.0},
        "open shutter": {"sensor.shutter": 1.0},
    },
    "compression": {
        "crf 28": {"crf": 28},
        "crf 35": {"crf": 35},
        "crf 42": {"crf": 42},
        "JPEG 50": {"sensor.jpeg": 50},
        "JPEG 20": {"sensor.jpeg": 20},
        "JPEG 8": {"sensor.jpeg": 8},
    },
    "mouth width": {
        "40 px": {"mouth_px": 40.0},
        "60 px": {"mouth_px": 60.0},
        "80 px": {"mouth_px": 80.0},
        "160 px": {"mouth_px": 160.0},
        "250 px": {"mouth_px": 250.0, **_CLOSE},
        "400 px": {"mouth_px": 400.0, **_CLOSE},
        "600 px": {"mouth_px": 600.0, **_CLOSE},
    },
    "shift": {
        "aside": {"shift_mw": (0.8, 0.0)},
        "low": {"shift_mw": (-0.3, 0.7)},
        "swaying": {"drift_mw": 0.25},
    },
    "tilt": {f"{a:+d} deg": {"roll_deg": float(a)} for a in (-15, -8, 8, 15)},
    "turn": {f"{a:+d} deg": {"yaw_deg": float(a)} for a in (-15, -8, 8, 15)},
    "nod": {f"{a:+d} deg": {"pitch_deg": float(a)} for a in (-15, -8, 8, 15)},
    "framing": {
        "close-up": _CLOSE,
        "tight": {"picture_mw": (1.25, 0.95)},
        "far": {"picture_mw": (5.0, 4.0)},
    },
}
# the settings of an axis that are farthest from plain
WORST = {
    "skin tone": ("very light", "very dark"),
    "lips": ("as the skin", "dark skin pale"),
    "light from": ("hard left", "below"),
    "light colour": ("red cast", "blue cast"),
    "light level": ("1/10", "2.5 times"),
    "beard": ("full",),
    "teeth": ("white",),
    "tongue": ("bright",),
    "highlights": ("shining",),
    "noise": ("12 %",),
    "blur": ("5 px",),
    "compression": ("crf 42", "JPEG 8"),
    "mouth width": ("40 px", "600 px"),
    "shift": ("aside", "low", "swaying"),
    "tilt": ("-15 deg", "+15 deg"),
    "turn": ("-15 deg", "+15 deg"),
    "nod": ("-15 deg", "+15 deg"),
    "framing": ("tight", "far"),
}


@dataclass(frozen=True)
class Take:
    """A movement of a face, to be solved once however often it is filmed.

    Parameters
    ----------
    action : see `actions()`
    face : what the face is called
    shape : the face
    stickiness : level, or None for that of the action's scene
    seed : of skin texture and teeth
    """

    action: str
    face: str
    shape: MouthShape
    stickiness: float | None
    seed: int

    @property
    def name(self) -> str:
        level = "" if self.stickiness is None else f"-level{self.stickiness:g}"
        return f"{self.action}{level}-{self.face}"

    @property
    def span_s(self) -> tuple[float, float]:
        """From and to when it is filmed, s."""
        _, start, stop = _ACTIONS[self.action]
        return start, min(stop, _built_in(_ACTIONS[self.action][0]).duration_s)

    def scene(self) -> Scene:
        """What is solved: the action's scene with this face, as long as it is filmed."""
        scene = _built_in(_ACTIONS[self.action][0], self.stickiness)
        patches = scene.saliva.patch
        if self.action == "three_openings":
            sticky = patches[0].stickiness
            patches = tuple(SalivaPatch(sticky, start, stop, edge_m=0.001) for start, stop in _BRIDGES)
        larger = self.shape.width_m / MouthShape().width_m  # places along the lips are those of the average mouth
        wet = scene.moisture
        return dataclasses.replace(
            scene,
            face=Face(resolution=RESOLUTION, **dataclasses.asdict(self.shape)),
            saliva=dataclasses.replace(scene.saliva, patch=_stretched(patches, larger)),
            moisture=dataclasses.replace(wet, patch=_stretched(wet.patch, larger), lick=_stretched(wet.lick, larger)),
            output=Output(frame_rate=RATE_HZ),
            duration_s=self.span_s[1],
            seed=self.seed,
        )


@dataclass(frozen=True)
class SuiteClip:
    """A take as it is filmed in one condition.

    Parameters
    ----------
    part : one of `PARTS`
    axis, setting : the condition; the plain clips have the axis and the setting `plain`, the mixed ones `mix`
    take, filming : what is filmed, and how
    """

    part: str
    axis: str
    setting: str
    take: Take
    filming: Filming

    @property
    def condition(self) -> str:
        return condition_name(self.axis, self.setting)

    @property
    def name(self) -> str:
        """What its files can be called; no other clip of the part has it."""
        return f"{_word(self.condition)}.{self.take.name}"

    @property
    def fingerprint(self) -> str:
        """Of everything that the clip is made from but the code."""
        parts = (_of_take(self.take), self.filming, RATE_HZ, SAFETIES)
        return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]


@dataclass(frozen=True, eq=False)
class Solved:
    """The motion of a take. `dropped` says why there is none."""

    scene: Scene
    mouth: Mouth | None = None
    motion: Motion | None = None
    dropped: str = ""


@dataclass(frozen=True, eq=False)
class Filmed:
    """Pictures of a clip and what is really in them.

    Parameters
    ----------
    pictures : (H, W, 3) uint8 RGB in order, to be read once; not compressed yet
    truth : as `simulator.truth` has it, of these pictures; `corners` + `meta["drift_px"][t]` is where the mouth's
        corners at rest are in picture t, row and column
    """

    pictures: Iterator[np.ndarray]
    truth: Truth


def condition_name(axis: str, setting: str) -> str:
    """What a condition is called: `axis: setting`, or the one word where both are the same."""
    return axis if axis == setting else f"{axis}: {setting}"


def actions() -> tuple[str, ...]:
    """Names of the movements."""
    return tuple(_ACTIONS)


def conditions(part: str = "report") -> tuple[str, ...]:
    """Names of the conditions of a part, in the order of its clips."""
    return tuple(dict.fromkeys(clip.condition for clip in suite(part)))


def suite(
    part: str = "report", *, quick: bool = False, only: Iterable[str] = (), seed: int = 0
) -> tuple[SuiteClip, ...]:
    """The clips of a part.

    Parameters
    ----------
    part : one of `PARTS`
    quick : about a tenth of them: one clip in the worst settings of each axis, a few plain and mixed ones
    only : names of conditions or of axes; none takes all
    seed : other than 0 for other random faces and mixtures

    Raises
    ------
    InputError : an unknown part or condition, or a seed below 0
    """
    if part not in PARTS:
        raise InputError(f"expected a part of {choices(PARTS)}, got {nearest(part, PARTS)}")
    if not (isinstance(seed, int) and seed >= 0):
        raise InputError(f"expected a seed of 0 or more, got {seed!r}")
    whole = [*_plain(part, seed), *_varied(part, seed), *_moved(part, seed), *_mixed(part, seed)]
    only = tuple(only)
    if only:
        axes, names = {clip.axis for clip in whole}, {clip.condition for clip in whole}
        for one in only:
            if one not in axes | names:
                known = sorted(axes | names)
                raise InputError(f"expected conditions such as {choices(sorted(axes))}, got {nearest(one, known)}")
        whole = [clip for clip in whole if clip.axis in only or clip.condition in only]
    return tuple(_tenth(whole) if quick else whole)


def clip_key(clip: SuiteClip) -> str:
    """Changes with everything that a clip is made from, this package's code too: what a file that is kept is called."""
    return hashlib.sha256(f"{clip.fingerprint} {_code()}".encode()).hexdigest()[:16]


def by_take(clips: Iterable[SuiteClip]) -> dict[Take, list[SuiteClip]]:
    """The clips of each movement: it is solved once and filmed in all of them."""
    found: dict[Take, list[SuiteClip]] = {}
    for clip in clips:
        found.setdefault(clip.take, []).append(clip)
    return found


def solve_take(take: Take) -> Solved:
    """Compute a movement; where the run does not stay stable, with smaller steps."""
    scene = take.scene()
    mouth, model = scene.model()
    for safety in SAFETIES:
        scene = dataclasses.replace(scene, solve=dataclasses.replace(scene.solve, safety=safety))
        motion = simulate(scene, parts=(mouth, model), threads=1)
        if motion.stopped is None:
            return Solved(scene, mouth, motion)
    return Solved(scene, dropped=str(motion.stopped))


def film(clip: SuiteClip, solved: Solved) -> Filmed:
    """Draw a clip, with its truth.

    Raises
    ------
    InputError : a movement that could not be solved
    """
    if solved.motion is None:
        raise InputError(f"expected a movement that could be solved, got {clip.take.name}: {solved.dropped}")
    how, shape, mouth, motion = clip.filming, clip.take.shape, solved.mouth, solved.motion
    start, stop = clip.take.span_s
    times = solved.scene.frame_times_s
    times = times[(times >= start - 1e-9) & (times <= stop + 1e-9)]
    width, height = (max(32, round(size * how.mouth_px / 2) * 2) for size in how.picture_mw)
    reach = math.ceil(how.drift_mw * how.mouth_px)
    px_per_m = how.mouth_px / shape.width_m
    right, down = how.shift_mw
    scene = dataclasses.replace(
        solved.scene,
        camera=Camera(
            width_px=width + 2 * reach,
            height_px=height + 2 * reach,
            view_m=(width + 2 * reach) / px_per_m,
            centre_x_m=-right * shape.width_m,
            centre_y_m=down * shape.width_m,
            yaw_deg=how.yaw_deg,
            pitch_deg=how.pitch_deg,
            roll_deg=how.roll_deg,
        ),
        skin=how.skin,
        light=how.light,
        inside=how.inside,
        sensor=how.sensor,
        background=how.background,
    )
    drawn = pictures(scene, mouth, motion, times)
    corners = reach + np.round(
        reach * np.stack([0.5 * np.sin(2 * np.pi * times / 1.3), np.sin(2 * np.pi * times / 0.9)], axis=1)
    ).astype(int)
    known = _on_the_clock(truth(motion, mouth, scene.camera, times), times[0])
    return Filmed(_windows(drawn, corners, (height, width)), _shifted(known, -corners, (height, width)))


def write_clip(clip: SuiteClip, solved: Solved, folder: str | Path, stem: str | None = None) -> Path:
    """Write `<stem>.mp4` and the truth's tables beside it; returns the video's path. `stem` None takes the clip's name.

    Raises
    ------
    InputError : a movement that could not be solved, or a folder that cannot be written to
    """
    folder, stem = Path(folder), stem or clip.name
    filmed = film(clip, solved)
    filmed.truth.save(folder, stem, details=False)
    path = folder / f"{stem}.mp4"
    write_video(path, filmed.pictures, RATE_HZ, "h264", crf=clip.filming.crf, threads=1)
    return path


def kept_clips(clips: Iterable[SuiteClip], folder: str | Path) -> Iterator[tuple[SuiteClip, Path]]:
    """The clips and their videos in a folder, truths beside them; what is not there yet under its key is made.

    Movements that cannot be solved are named on the terminal and left out.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for take, of_take in by_take(clips).items():
        solved = None
        for clip in of_take:
            path = folder / f"{clip_key(clip)}.mp4"
            if not path.exists():
                solved = solved or solve_take(take)
                if solved.motion is None:
                    print(f"{clip.name}: dropped, {solved.dropped}")
                    continue
                write_clip(clip, solved, folder, path.stem)
            yield clip, path


# -- faces and groups of clips ----------------------------------------------------------------------------------------


def _face(part: str, seed: int, number: int) -> tuple[str, MouthShape]:
    """The named faces of a part, then any number of random ones between them."""
    named = NAMED[part]
    if number < len(named):
        return named[number], FACES[named[number]]
    return f"random{number}", random_face(np.random.default_rng([SEEDS[part], seed, number]), named)


def _take(part: str, seed: int, action: str, number: int, stickiness: float | None = None) -> Take:
    name, shape = _face(part, seed, number)
    return Take(action, name, shape, stickiness, SEEDS[part] + number + 10_000 * seed)


def _core(part: str, seed: int) -> list[Take]:
    """Movements that are filmed in every condition: named and random faces in turn."""
    faces = [0, 6, 2, 7, 4, 8]
    return [_take(part, seed, action, number) for action, number in zip(_CORE, faces, strict=True)]


def _plain(part: str, seed: int) -> list[SuiteClip]:
    takes = _core(part, seed)
    for number, action in enumerate(_CORE):  # the same movements by other faces
        takes += [_take(part, seed, action, 9 + number), _take(part, seed, action, 15 + number)]
    return [SuiteClip(part, "plain", "plain", take, Filming()) for take in takes]


def _varied(part: str, seed: int) -> Iterator[SuiteClip]:
    core = _core(part, seed)
    for axis, settings in AXES.items():
        for setting, changes in settings.items():
            filming = changed(Filming(), changes)
            yield from (SuiteClip(part, axis, setting, take, filming) for take in core)


def _moved(part: str, seed: int) -> Iterator[SuiteClip]:
    def clips(axis: str, setting: str, takes: Iterable[Take]) -> Iterator[SuiteClip]:
        return (SuiteClip(part, axis, setting, take, Filming()) for take in takes)

    for number, name in enumerate(NAMED[part]):
        takes = [_take(part, seed, action, number) for action in ("slow_open", "mummy", "double_opening")]
        yield from clips("face", name, takes)
    number = itertools.count(30)
    apart = ("double_opening", "three_openings", "one_sided_left", "one_sided_right")
    for action in _ACTIONS:
        if action not in apart:
            several = 2 if action in ("drying", "uneven_drying") else 4
            yield from clips("action", action, [_take(part, seed, action, next(number)) for _ in range(several)])
    for level in (0.0, 4.0, 7.0, 10.0):  # of the same faces, so that the level alone differs
        takes = [_take(part, seed, action, 24 + k, level) for action in _STICKY for k in range(2)]
        yield from clips("stickiness", f"{level:g}", takes)
    for action, setting in zip(apart, ("two", "three", "left", "right"), strict=True):
        yield from clips("openings", setting, [_take(part, seed, action, next(number)) for _ in range(6)])


def _mixed(part: str, seed: int) -> Iterator[SuiteClip]:
    names = [name for name in _ACTIONS if name not in ("drying", "uneven_drying")]
    for number in range(MIX):
        rng = np.random.default_rng([SEEDS[part], seed, 7, number])
        sticky = float(rng.choice([0, 4, 7, 10])) if names[number % len(names)] in _STICKY else None
        take = _take(part, seed, names[number % len(names)], 200 + number, sticky)
        yield SuiteClip(part, "mix", "mix", take, _any_filming(rng))


def _any_filming(rng: np.random.Generator) -> Filming:
    """Everything varies: skin and lips over the human range, rooms and cameras as people have them."""

    def often(share: float, value, otherwise):
        return value if rng.uniform() < share else otherwise

    def between(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 4)

    def times(low: float, high: float) -> float:
        return round(float(np.exp(rng.uniform(np.log(low), np.log(high)))), 4)

    warmth = between(-1, 1)
    tint = (255.0, 250 - 45 * max(warmth, 0), 240 - 110 * max(warmth, 0))
    tint = (255 - 60 * max(-warmth, 0), tint[1] - 25 * max(-warmth, 0), min(255.0, tint[2] + 15 * max(-warmth, 0)))
    size = times(50, 300)
    near = often(0.4 if size < 200 else 1.0, True, False)
    return Filming(
        mouth_px=size,
        picture_mw=(between(1.5, 2.1), between(1.2, 1.7)) if near else (between(2.4, 4.0), between(2.0, 3.2)),
        shift_mw=(between(-0.1, 0.1), between(-0.08, 0.08)) if near else (between(-0.5, 0.5), between(-0.3, 0.3)),
        drift_mw=often(0.3, between(0.0, 0.12), 0.0),
        yaw_deg=between(-15, 15),
        pitch_deg=between(-12, 12),
        roll_deg=round(float(np.clip(rng.normal(0, 5), -15, 15)), 2),
        crf=int(rng.integers(16, 30)),
        skin=Skin(
            tone=between(0, 1),
            redness=between(0.2, 0.7),
            lip_redness=between(0.1, 0.9),
            texture=between(0.2, 0.9),
            lip_lines=between(0.2, 0.9),
            sheen=between(0.1, 0.8),
            wetness=between(0.1, 0.9),
            gloss=between(0.1, 0.9),
            stubble=often(0.25, between(0.1, 0.8), 0.0),
            freckles=often(0.15, between(0.2, 0.8), 0.0),
        ),
        light=Light(
            direction=(between(-0.9, 0.9), between(-0.2, 0.9), between(0.4, 1.0)),
            strength=between(0.6, 1.1),
            ambient=between(0.15, 0.6),
            softness=between(0.1, 0.9),
            colour=tint,
        ),
        inside=Inside(
            upper_teeth=often(0.92, True, False),
            lower_teeth=often(0.85, True, False),
            tongue=often(0.85, True, False),
            teeth_colour=(between(205, 250), between(195, 244), between(165, 236)),
            upper_edge_m=between(-0.005, -0.001),
            lower_edge_m=between(-0.0035, 0.0),
            tongue_height_m=often(0.3, between(0.0, 0.007), 0.0),
            shadow=between(0.3, 0.8),
        ),
        sensor=Sensor(
            exposure=times(0.55, 1.5),
            cast=(times(0.9, 1.12), 1.0, times(0.9, 1.12)),
            blur_px=between(0.4, 1.4),
            noise=times(0.005, 0.03),
            vignette=between(0.0, 0.3),
            shutter=between(0.2, 0.9),
            jpeg=often(0.15, int(rng.integers(40, 90)), None),
        ),
        background=(between(20, 230), between(20, 230), between(20, 230)),
    )


def _tenth(clips: list[SuiteClip]) -> list[SuiteClip]:
    """One clip of each worst setting, another movement each time; every sixth of the others' first clips."""
    kept, worst, others, counts = [], itertools.count(), itertools.count(), {}
    for clip in clips:
        seen = counts[clip.condition] = counts.get(clip.condition, -1) + 1
        if clip.axis in WORST:
            if clip.setting in WORST[clip.axis]:
                if seen == 0:
                    wanted = next(worst) % (len(_CORE) - 1)  # the last, the smile, never opens
                if seen == wanted:
                    kept.append(clip)
        elif clip.axis in ("plain", "mix"):
            if seen < (len(_CORE) if clip.axis == "plain" else QUICK_MIX):
                kept.append(clip)
        elif seen == 0 and next(others) % 2 == 0:
            kept.append(clip)
    return kept


def changed(filming: Filming, changes: Mapping[str, object]) -> Filming:
    """A filming with some settings changed, named as `crf` or `skin.tone`."""
    for name, value in changes.items():
        whole, _, inner = name.partition(".")
        if inner:
            value = dataclasses.replace(getattr(filming, whole), **{inner: value})
        filming = dataclasses.replace(filming, **{whole: value})
    return filming


# -- small steps ------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=256)
def _built_in(name: str, stickiness: float | None = None) -> Scene:
    return load_scene(name, stickiness)


@lru_cache(maxsize=1024)
def _of_take(take: Take) -> str:
    """All that a movement is made from, as text."""
    return repr((take, _ACTIONS[take.action], take.scene()))


@lru_cache(maxsize=1)
def _code() -> str:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _stretched(parts: tuple, factor: float) -> tuple:
    """Parts of the lips on a mouth `factor` times as wide."""

    def far(part) -> dict:
        names = [name for name in ("from_m", "to_m", "edge_m") if getattr(part, name, None) is not None]
        return {name: getattr(part, name) * factor for name in names}

    return tuple(dataclasses.replace(part, **far(part)) for part in parts)


def _windows(frames: Iterable[np.ndarray], corners: np.ndarray, size: tuple[int, int]) -> Iterator[np.ndarray]:
    """The part of each frame whose upper left corner is given, (T, 2) row and column."""
    for frame, (row, column) in zip(frames, corners, strict=True):
        yield frame[row : row + size[0], column : column + size[1]]


def _on_the_clock(known: Truth, start_s: float) -> Truth:
    """A truth whose first frame is at 0 s, as that of the video is, though it is filmed from `start_s` on."""
    tables = ("frames", "openings", "frames_m", "openings_m", "saliva", "energies")
    parts = {name: getattr(known, name) for name in tables}
    return dataclasses.replace(
        known, **{name: part.assign(time_s=(part["time_s"] - start_s).round(6)) for name, part in parts.items()}
    )


def _shifted(known: Truth, drift_px: np.ndarray, size: tuple[int, int]) -> Truth:
    """A truth whose frames are moved by (T, 2) rows and columns."""
    of = drift_px[known.openings["frame"].to_numpy(int)]
    openings = known.openings.copy()
    for axis, name in enumerate(("row", "col")):
        for column in (f"{name}_min", f"{name}_max", f"centroid_{name}"):
            openings[column] += of[:, axis]
    polygons = [[one + move for one in frame] for frame, move in zip(known.polygons, drift_px, strict=True)]
    meta = known.meta | {"drift_px": drift_px.tolist()}
    return dataclasses.replace(known, openings=openings, polygons=polygons, meta=meta, shape=size)


def _word(text: str) -> str:
    return "".join(char if char.isalnum() or char in "+-." else "_" for char in text)
