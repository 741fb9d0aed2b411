"""Curves for the tests of comparison: one smooth movement, shifted, stretched or carried on a bent time."""

import numpy as np

from lipmetrics.takes import Take


def movement(time_s):
    """Width, height and area of a mouth that opens once about 1 s and closes, (T, 3); at rest outside 0.5 to 1.6 s."""
    rise = np.clip((np.asarray(time_s, float) - 0.5) / 0.4, 0, 1)
    fall = np.clip((np.asarray(time_s, float) - 1.1) / 0.5, 0, 1)
    height = 0.4 * (np.sin(rise * np.pi / 2) ** 2 - np.sin(fall * np.pi / 2) ** 2)
    width = 0.8 * np.sqrt(height / 0.4)
    return np.stack([width, height, width * height * 0.7], axis=1)


def take(values=None, time_s=None, rate_hz=50.0, name="made", unit="mw", late_s=0.0, end_s=2.2):
    """A Take of `movement`, `late_s` late, or of given values (T, 3)."""
    if time_s is None:
        time_s = np.arange(round(end_s * rate_hz) + 1 if values is None else len(values)) / rate_hz
    if values is None:
        values = movement(np.asarray(time_s) - late_s)
    width, height, area = np.asarray(values, float).T
    return Take(name, time_s, {"width": width, "height": height, "area": area}, unit)
