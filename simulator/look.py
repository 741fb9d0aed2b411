"""How a drawn mouth looks: skin, light, the inside of the mouth and the camera's sensor, each a set of numbers.

Colours are sRGB numbers from 0 to 255 where a person gives them; all reckoning is done in linear light.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

import numpy as np

from simulator.errors import InputError
from simulator.wording import choices, nearest

Colour = tuple[float, float, float]

# Melanin of the named tones, 0 the lightest and 1 the darkest skin drawn.
TONES = {
    "very light": 0.0,
    "light": 0.15,
    "light medium": 0.3,
    "medium": 0.45,
    "tan": 0.6,
    "brown": 0.75,
    "dark": 0.88,
    "very dark": 1.0,
}
# sRGB of skin at these, chosen by eye along the human range; the individual typology angle falls from 56 to -62 deg.
_MELANIN = (0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.88, 1.0)
_SKIN_RGB = (
    (243, 213, 198),
    (233, 196, 176),
    (220, 176, 150),
    (201, 152, 122),
    (172, 121, 90),
    (141, 97, 70),
    (110, 74, 55),
    (82, 55, 42),
)


@dataclass(frozen=True)
class Skin:
    """Skin and lips.

    Parameters
    ----------
    tone : one of `TONES`, or melanin from 0 (lightest) to 1 (darkest)
    redness : blood in the skin, 0 to 1
    lip_redness : blood in the lips, 0 to 1
    colour, lip_colour : sRGB from 0 to 255 in place of what tone and redness give
    texture : contrast of pores and uneven colour, 0 to 1
    lip_lines : depth of the lips' fine lines, 0 to 1
    border_m : width of the soft border of the red of the lips, m
    sheen : strength of the broad highlights on the skin, 0 to 1
    wetness : strength of the highlights on the lips, 0 to 1
    gloss : how narrow these are, 0 (silky) to 1 (wet)
    seam : darkness of the line where the lips meet, 0 to 1
    film : opacity of stretched saliva, 0 (clear) to 1
    stubble : shadow and dots of a beard, 0 to 1
    freckles : 0 to 1
    nose : draw the base of a nose at the top
    """

    tone: str | float = "light medium"
    redness: float = 0.4
    lip_redness: float = 0.5
    colour: Colour | None = None
    lip_colour: Colour | None = None
    texture: float = 0.5
    lip_lines: float = 0.5
    border_m: float = 0.0008
    sheen: float = 0.35
    wetness: float = 0.5
    gloss: float = 0.5
    seam: float = 0.85
    film: float = 0.85
    stubble: float = 0.0
    freckles: float = 0.0
    nose: bool = True

    def __post_init__(self):
        if isinstance(self.tone, str):
            if self.tone not in TONES:
                raise InputError(f"expected a tone of {choices(TONES)}, got {nearest(self.tone, TONES)}")
        else:
            _check_ranges(self, tone=(0, 1))
        shares = ("redness", "lip_redness", "texture", "lip_lines", "sheen", "wetness", "gloss", "seam", "film")
        _check_ranges(self, border_m=(1e-5, 0.01), **dict.fromkeys((*shares, "stubble", "freckles"), (0, 1)))
        _check_colours(self, "colour", "lip_colour")
        _check_flags(self, "nose")

    @property
    def melanin(self) -> float:
        """0 (lightest) to 1 (darkest)."""
        return TONES[self.tone] if isinstance(self.tone, str) else float(self.tone)

    @property
    def linear(self) -> np.ndarray:
        """(3,) reflectance of skin in linear light."""
        if self.colour is not None:
            return to_linear(self.colour)
        rgb = [np.interp(self.melanin, _MELANIN, channel) for channel in zip(*_SKIN_RGB, strict=True)]
        # blood takes green and blue
        return to_linear(rgb) * np.exp(-(self.redness - 0.4) * np.array([0.05, 0.35, 0.30]))

    @property
    def lip_linear(self) -> np.ndarray:
        """(3,) reflectance of the lips in linear light: thin skin over blood, with less melanin."""
        if self.lip_colour is not None:
            return to_linear(self.lip_colour)
        dark = self.melanin
        blood = np.array([0.72, 0.36, 0.38]) * (1 - dark) + np.array([1.05, 0.78, 0.95]) * dark
        return self.linear * blood * np.exp(-(self.lip_redness - 0.5) * np.array([0.1, 1.0, 0.8]))


@dataclass(frozen=True)
class Light:
    """One soft light and light from all around.

    Parameters
    ----------
    direction : towards the light in the camera's axes: x right, y up, z towards the camera; any length
    strength, ambient : of the light and of the surroundings; 0 is none
    colour, ambient_colour : sRGB from 0 to 255
    softness : how far the light reaches round the face, 0 (a point) to 1 (a bright sky)
    """

    direction: tuple[float, float, float] = (-0.45, 0.55, 0.8)
    strength: float = 0.9
    ambient: float = 0.36
    colour: Colour = (255, 247, 237)
    ambient_colour: Colour = (240, 245, 255)
    softness: float = 0.5

    def __post_init__(self):
        _check_ranges(self, strength=(0, 20), ambient=(0, 20), softness=(0, 1))
        _check_colours(self, "colour", "ambient_colour")
        if not (_is_triple(self.direction) and sum(v * v for v in self.direction) > 0):
            raise InputError(f"expected direction as three numbers that are not all 0, got {self.direction!r}")


@dataclass(frozen=True)
class Inside:
    """What is seen between the lips.

    Parameters
    ----------
    upper_teeth, lower_teeth, tongue : draw them
    teeth_colour, gum_colour, tongue_colour, cavity_colour : sRGB from 0 to 255
    upper_edge_m, lower_edge_m : height of the edges of the middle teeth with the jaw closed, m; the lips meet near 0
    teeth_z_m : depth of the front of the upper teeth, m (the middle of the lips is near 0); the lower stand 2 mm behind
    tongue_height_m : how far the tongue is raised, m
    shadow : how much the upper lip darkens what is behind it, 0 to 1
    depth_m : depth over which the light in the mouth falls to 37 %
    """

    upper_teeth: bool = True
    lower_teeth: bool = True
    tongue: bool = True
    teeth_colour: Colour = (236, 226, 205)
    gum_colour: Colour = (196, 112, 110)
    tongue_colour: Colour = (196, 108, 108)
    cavity_colour: Colour = (66, 22, 22)
    upper_edge_m: float = -0.0028
    lower_edge_m: float = -0.0022
    teeth_z_m: float = -0.008
    tongue_height_m: float = 0.0
    shadow: float = 0.6
    depth_m: float = 0.022

    def __post_init__(self):
        _check_flags(self, "upper_teeth", "lower_teeth", "tongue")
        _check_colours(self, "teeth_colour", "gum_colour", "tongue_colour", "cavity_colour")
        edges = dict.fromkeys(("upper_edge_m", "lower_edge_m", "tongue_height_m"), (-0.03, 0.03))
        _check_ranges(self, **edges, teeth_z_m=(-0.03, 0.01), shadow=(0, 1), depth_m=(0.002, 0.2))


@dataclass(frozen=True)
class Sensor:
    """From light to numbers.

    Parameters
    ----------
    exposure : factor on all light
    cast : factors on red, green and blue
    blur_px : spread (standard deviation) of the lens blur, px
    noise : spread of the shot noise at full white, of full scale; it falls with the square root of the light
    read_noise : spread of the noise in the dark, of full scale
    vignette : loss of light in the corners of the picture, 0 to 1
    shutter : part of the time of a frame that the shutter is open, 0 to 1
    samples : most places of the lips that are averaged over that time; fewer are where they move less
    jpeg : quality of JPEG compression of each frame, 1 to 100, or None
    h264 : constant rate factor of H.264 compression of the clip, 0 to 51, or None
    seed : of the noise, where it differs between clips of one face; None takes that of the scene
    """

    exposure: float = 1.0
    cast: tuple[float, float, float] = (1.0, 1.0, 1.0)
    blur_px: float = 0.6
    noise: float = 0.012
    read_noise: float = 0.002
    vignette: float = 0.0
    shutter: float = 0.5
    samples: int = 8
    jpeg: int | None = None
    h264: int | None = None
    seed: int | None = None

    def __post_init__(self):
        _check_ranges(self, exposure=(0, 100), blur_px=(0, 50), noise=(0, 1), read_noise=(0, 1))
        _check_ranges(self, vignette=(0, 1), shutter=(0, 1))
        if not (_is_triple(self.cast) and min(self.cast) >= 0):
            raise InputError(f"expected cast as three numbers of at least 0, got {self.cast!r}")
        for name, low, high in (("samples", 1, 64), ("jpeg", 1, 100), ("h264", 0, 51), ("seed", 0, 2**63 - 1)):
            value = getattr(self, name)
            if value is None and name != "samples":
                continue
            if not (isinstance(value, int) and not isinstance(value, bool) and low <= value <= high):
                raise InputError(f"expected {name} as a whole number from {low} to {high}, got {value!r}")


@dataclass(frozen=True)
class Look:
    """All that a picture of a mouth depends on besides its shape and the camera's place.

    Parameters
    ----------
    skin, light, inside, sensor : see there
    background : sRGB from 0 to 255 of what is behind the head
    seed : of skin texture, teeth and noise
    """

    skin: Skin = field(default_factory=Skin)
    light: Light = field(default_factory=Light)
    inside: Inside = field(default_factory=Inside)
    sensor: Sensor = field(default_factory=Sensor)
    background: Colour = (92, 98, 104)
    seed: int = 0

    def __post_init__(self):
        for one, kind in (("skin", Skin), ("light", Light), ("inside", Inside), ("sensor", Sensor)):
            if not isinstance(getattr(self, one), kind):
                raise InputError(f"expected {one} as a {kind.__name__}, got {getattr(self, one)!r}")
        _check_colours(self, "background")
        if not (isinstance(self.seed, int) and not isinstance(self.seed, bool) and 0 <= self.seed < 2**63):
            raise InputError(f"expected seed as a whole number from 0 on, got {self.seed!r}")


def to_linear(srgb) -> np.ndarray:
    """Linear light from 0 to 1 of sRGB numbers from 0 to 255 (IEC 61966-2-1)."""
    v = np.asarray(srgb, float) / 255
    return np.where(v <= 0.04045, v / 12.92, ((np.maximum(v, 0.04045) + 0.055) / 1.055) ** 2.4)


def to_srgb(linear) -> np.ndarray:
    """sRGB numbers from 0 to 255, not rounded, of linear light (clipped to 0..1)."""
    v = np.clip(np.asarray(linear, float), 0, 1)
    return 255 * np.where(v <= 0.0031308, 12.92 * v, 1.055 * np.maximum(v, 0.0031308) ** (1 / 2.4) - 0.055)


def _is_number(value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_triple(value) -> bool:
    return isinstance(value, tuple | list) and len(value) == 3 and all(map(_is_number, value))


def _check_ranges(settings, **limits) -> None:
    for name, (low, high) in limits.items():
        value = getattr(settings, name)
        if not (_is_number(value) and low <= value <= high):
            raise InputError(f"expected {name} as a number from {low:g} to {high:g}, got {value!r}")


def _check_colours(settings, *names) -> None:
    optional = {one.name for one in fields(settings) if one.default is None}
    for name in names:
        value = getattr(settings, name)
        if value is None and name in optional:
            continue
        if not (_is_triple(value) and all(0 <= v <= 255 for v in value)):
            raise InputError(f"expected {name} as red, green and blue from 0 to 255, got {value!r}")


def _check_flags(settings, *names) -> None:
    for name in names:
        if not isinstance(getattr(settings, name), bool):
            raise InputError(f"expected {name} as true or false, got {getattr(settings, name)!r}")


CLEAN = Sensor(blur_px=0.0, noise=0.0, read_noise=0.0, shutter=0.0)  # no effect of a camera at all
