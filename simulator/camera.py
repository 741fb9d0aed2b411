"""From points of the face to places in the picture: a pinhole camera that looks at the mouth.

Places are (row, column) in px, row downwards, the origin at the centre of pixel (0, 0).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from simulator.errors import InputError

LARGEST_PX = 8192


@dataclass(frozen=True)
class Camera:
    """A camera in front of the face, and how the head is held.

    Parameters
    ----------
    width_px, height_px : size of the picture
    view_m : width of what is seen in the plane of the lips, m
    distance_m : from the camera to that plane, m
    centre_x_m, centre_y_m : point of that plane in the middle of the picture, m
    yaw_deg, pitch_deg, roll_deg : turn of the head about the vertical (positive: its nose to the right of the picture),
        nod (positive: up) and tilt (positive: clockwise in the picture), about the middle of the lips

    Raises
    ------
    InputError : a number out of range
    """

    width_px: int = 512
    height_px: int = 512
    view_m: float = 0.105
    distance_m: float = 0.6
    centre_x_m: float = 0.0
    centre_y_m: float = -0.006
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0

    def __post_init__(self):
        for name in ("width_px", "height_px"):
            value = getattr(self, name)
            if not (isinstance(value, int) and 16 <= value <= LARGEST_PX):
                raise InputError(f"expected {name} as a whole number from 16 to {LARGEST_PX}, got {value!r}")
        limits = {
            "view_m": (0.005, 2.0),
            "distance_m": (0.1, 100.0),
            "centre_x_m": (-0.5, 0.5),
            "centre_y_m": (-0.5, 0.5),
            "yaw_deg": (-60, 60),
            "pitch_deg": (-60, 60),
            "roll_deg": (-180, 180),
        }
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if not (isinstance(value, int | float) and math.isfinite(value) and low <= value <= high):
                raise InputError(f"expected {name} from {low:g} to {high:g}, got {value!r}")

    @property
    def px_per_m(self) -> float:
        """Scale in the plane of the lips, px/m."""
        return self.width_px / self.view_m

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3) turns points of the face into the camera's axes: x right, y up, z towards the camera."""
        yaw, pitch, roll = (math.radians(v) for v in (self.yaw_deg, self.pitch_deg, self.roll_deg))
        about_y = np.array([[math.cos(yaw), 0, math.sin(yaw)], [0, 1, 0], [-math.sin(yaw), 0, math.cos(yaw)]])
        about_x = np.array([[1, 0, 0], [0, math.cos(pitch), math.sin(pitch)], [0, -math.sin(pitch), math.cos(pitch)]])
        about_z = np.array([[math.cos(roll), math.sin(roll), 0], [-math.sin(roll), math.cos(roll), 0], [0, 0, 1]])
        return about_z @ about_x @ about_y

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3), m, in the camera's axes, (..., 3), m: x right, y up, z towards the camera, 0 at the lips."""
        return np.asarray(points) @ self.rotation.T - [self.centre_x_m, self.centre_y_m, 0.0]

    def project(self, points: np.ndarray) -> np.ndarray:
        """Places (..., 2) of points (..., 3), m: row and column, px."""
        seen = self.seen(points)
        scale = self.px_per_m * self.distance_m / (self.distance_m - seen[..., 2])
        row = (self.height_px - 1) / 2 - seen[..., 1] * scale
        column = (self.width_px - 1) / 2 + seen[..., 0] * scale
        return np.stack([row, column], axis=-1)
