"""Takes made by formula, for tests of comparison and scores: a mouth that opens once, as a table or as a Take."""

from pathlib import Path

import numpy as np

from lipmetrics.take import Take


def curves(high: float = 0.3, late_s: float = 0.0, rate_hz: float = 25.0, duration_s: float = 1.2) -> dict:
    """Time, width, height and area of one opening of height `high` (mouth widths) about 0.6 s."""
    time_s = np.arange(round(duration_s * rate_hz) + 1) / rate_hz
    height = high * np.clip(1 - ((time_s - 0.6 - late_s) / 0.4) ** 2, 0, None)
    width = 0.9 * np.sqrt(height / high) if high else 0 * height
    return {"time_s": time_s, "width": width, "height": height, "area": np.pi / 4 * width * height}


def moving_take(name: str = "take", unit: str = "mw", **shape) -> Take:
    found = curves(**shape)
    return Take(name, found.pop("time_s"), found, unit)


def write_table(path: Path, **shape) -> Path:
    """The same as a table of sizes in mouth widths."""
    found = curves(**shape)
    rows = zip(*found.values(), strict=True)
    lines = ["time_s,width_mw,height_mw,area_mw2", *(",".join(f"{v:.6f}" for v in row) for row in rows)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")
    return path
