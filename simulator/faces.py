"""Faces that look like different people: named shapes of the lower face, and random ones for suites of clips.

The lengths are plausible ones, chosen so that the faces can be told apart; none was measured on a person.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from simulator.errors import InputError
from simulator.mouth import MouthShape
from simulator.wording import choices, nearest

FACES = {
    "average": MouthShape(),
    "wide": MouthShape(width_m=0.060, upper_lip_m=0.0070, lower_lip_m=0.0090, half_width_m=0.070, face_radius_m=0.080),
    "narrow": MouthShape(
        width_m=0.042, upper_lip_m=0.0078, lower_lip_m=0.0092, half_width_m=0.060, face_radius_m=0.068
    ),
    "full_lips": MouthShape(
        upper_lip_m=0.0110, lower_lip_m=0.0135, protrusion_m=0.0075, bow_m=0.0012, thickness_m=0.007
    ),
    "thin_lips": MouthShape(
        upper_lip_m=0.0042, lower_lip_m=0.0058, protrusion_m=0.0032, bow_m=0.0007, corner_rise_m=-0.0015
    ),
    "child": MouthShape(
        width_m=0.036,
        upper_lip_m=0.0068,
        lower_lip_m=0.0080,
        protrusion_m=0.0045,
        bow_m=0.0014,
        corner_rise_m=0.0004,
        thickness_m=0.005,
        half_width_m=0.050,
        above_m=0.030,
        below_m=0.040,
        face_radius_m=0.055,
        chin_m=0.003,
        groove_m=0.0018,
    ),
    "older": MouthShape(
        width_m=0.053,
        upper_lip_m=0.0048,
        lower_lip_m=0.0068,
        protrusion_m=0.0030,
        bow_m=0.0006,
        corner_rise_m=-0.0030,
        thickness_m=0.005,
        above_m=0.044,
        chin_m=0.0065,
        groove_m=0.0032,
    ),
    "protruding": MouthShape(
        upper_lip_m=0.0088, lower_lip_m=0.0110, protrusion_m=0.0095, bow_m=0.0010, chin_m=0.0025, groove_m=0.0020
    ),
    "short_chin": MouthShape(width_m=0.048, below_m=0.043, chin_m=0.0025, groove_m=0.0016, protrusion_m=0.0058),
    "long_chin": MouthShape(width_m=0.052, below_m=0.066, chin_m=0.0075, groove_m=0.0030, face_radius_m=0.072),
    "cupid": MouthShape(
        width_m=0.045, upper_lip_m=0.0092, lower_lip_m=0.0100, bow_m=0.0026, corner_rise_m=0.0010, protrusion_m=0.0062
    ),
    "smiling": MouthShape(width_m=0.056, upper_lip_m=0.0062, lower_lip_m=0.0085, corner_rise_m=0.0030, bow_m=0.0008),
}


def face(name: str, **changes: float) -> MouthShape:
    """The shape of a face by name, with some lengths changed, m.

    Raises
    ------
    InputError : unknown name, or unknown length
    """
    if name not in FACES:
        raise InputError(f"expected a face of {choices(FACES)}, got {nearest(name, FACES)}")
    known = [one.name for one in fields(MouthShape)]
    for key in changes:
        if key not in known:
            raise InputError(f"expected a length of a face of {choices(known)}, got {nearest(key, known)}")
    return replace(FACES[name], **changes)


def random_face(rng: np.random.Generator, names: Sequence[str] = tuple(FACES)) -> MouthShape:
    """A face between two of the named ones, its lengths then varied by up to a tenth."""
    one, other = (FACES[name] for name in rng.choice(sorted(names), 2, replace=False))
    mix = rng.uniform()
    lengths = {}
    for field in fields(MouthShape):
        between = (1 - mix) * getattr(one, field.name) + mix * getattr(other, field.name)
        lengths[field.name] = round(between * rng.uniform(0.9, 1.1), 6)
    lengths["film_m"] = one.film_m  # the lips are closed on everyone alike
    return MouthShape(**lengths)
