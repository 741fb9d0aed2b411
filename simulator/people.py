"""People for simulated corpora: each has a face, a skin and a room with a camera of their own, all drawn from one seed.

Person number i of a seed is the same however many there are, so that a corpus can be made larger later. Skins go over
the whole range of tones in an order that spreads from the start; the numbers are plausible ones, not measured.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from simulator.errors import InputError
from simulator.faces import random_face
from simulator.look import Colour, Inside, Light, Sensor, Skin
from simulator.scene import Face, Scene

MOST_PEOPLE_N = 999
_GOLDEN = (math.sqrt(5) - 1) / 2  # multiples of it, modulo 1, are spread evenly however many are taken
_MIDDLE = 0.36  # linear light of skin that needs no other exposure
_TRIES_N = 20  # faces drawn for a person until one can be


@dataclass(frozen=True)
class Person:
    """Whose mouth it is, and how it is filmed.

    Parameters
    ----------
    name : such as p01
    number : from 1
    face, skin, inside : the mouth; the resolution of the mesh is the scene's
    light, sensor, background : of the room
    yaw_deg, pitch_deg, roll_deg : how the head is held
    """

    name: str
    number: int
    face: Face
    skin: Skin
    inside: Inside
    light: Light
    sensor: Sensor
    background: Colour
    yaw_deg: float
    pitch_deg: float
    roll_deg: float

    def plays(self, scene: Scene) -> Scene:
        """The scene with this person in it; what the scene says of face, skin, light and sensor gives way."""
        held = {name: getattr(self, name) for name in ("yaw_deg", "pitch_deg", "roll_deg")}
        return dataclasses.replace(
            scene,
            face=dataclasses.replace(self.face, resolution=scene.face.resolution),
            skin=self.skin,
            inside=self.inside,
            light=self.light,
            sensor=self.sensor,
            background=self.background,
            camera=dataclasses.replace(scene.camera, **held),
        )


def people(count: int, seed: int = 0) -> tuple[Person, ...]:
    """So many different people.

    Raises
    ------
    InputError : none or more than `MOST_PEOPLE_N`
    """
    if not 1 <= count <= MOST_PEOPLE_N:
        raise InputError(f"expected 1 to {MOST_PEOPLE_N} people, got {count}")
    return tuple(_person(number, seed) for number in range(1, count + 1))


def _person(number: int, seed: int) -> Person:
    rng = np.random.default_rng([seed, number])
    start = np.random.default_rng([seed, 0]).uniform()

    def between(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 3)

    face = _face(rng)
    skin = Skin(
        tone=round((start + number * _GOLDEN) % 1, 3),
        redness=between(0.25, 0.6),
        lip_redness=between(0.35, 0.75),
        texture=between(0.3, 0.8),
        lip_lines=between(0.3, 0.8),
        sheen=between(0.2, 0.5),
        wetness=between(0.3, 0.7),
        gloss=between(0.3, 0.7),
        stubble=between(0.15, 0.6) if rng.uniform() < 0.3 else 0.0,
        freckles=between(0.2, 0.7) if rng.uniform() < 0.2 else 0.0,
    )
    enamel = between(-14, 8)
    inside = Inside(teeth_colour=tuple(round(value + enamel, 1) for value in (236, 226, 205)))
    aside, up = math.radians(between(-60, 60)), math.radians(between(10, 55))
    warmth = between(-1, 1)
    light = Light(
        direction=tuple(
            round(value, 3) for value in (math.sin(aside) * math.cos(up), math.sin(up), math.cos(aside) * math.cos(up))
        ),
        strength=between(0.7, 1.05),
        ambient=between(0.28, 0.45),
        colour=(255.0, round(246 - 9 * warmth, 1), round(236 - 18 * warmth, 1)),
        softness=between(0.3, 0.8),
    )
    # Whoever films sets the exposure by the face, but not so far that dark skin gets as bright as light skin.
    lit = float(skin.linear @ (0.2126, 0.7152, 0.0722)) * (light.strength + light.ambient)
    sensor = Sensor(
        exposure=round(between(0.9, 1.1) * math.sqrt(_MIDDLE / lit), 3),
        cast=(between(0.96, 1.04), 1.0, between(0.94, 1.06)),
        blur_px=between(0.4, 0.9),
        noise=between(0.006, 0.018),
    )
    grey = between(60, 190)
    return Person(
        name=f"p{number:02d}",
        number=number,
        face=face,
        skin=skin,
        inside=inside,
        light=light,
        sensor=sensor,
        background=tuple(round(grey + between(-15, 15), 1) for _ in range(3)),
        yaw_deg=between(-4, 4),
        pitch_deg=between(-3, 3),
        roll_deg=between(-3, 3),
    )


def _face(rng: np.random.Generator) -> Face:
    """A random face that a mesh can be made of."""
    for _ in range(_TRIES_N):
        face = Face(**dataclasses.asdict(random_face(rng)), resolution="low")
        try:
            face.mouth()
        except InputError:
            continue
        return face
    raise InputError(f"expected a face that can be in {_TRIES_N} drawn, got none; choose another seed")
