"""The viewer: one HTML file that replays a moving mouth in the browser, without a network.

`write_page` makes it of a motion and the template `data/view.html`; `view` opens that of a clip. Positions are stored
in 65,536 steps of the box around the motion, about 1 um from where they were.
"""

from __future__ import annotations

import argparse
import base64
import html
import json
import re
import sys
import webbrowser
import zlib
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

import numpy as np

from simulator.atomic import whole_file
from simulator.errors import InputError
from simulator.motion import Motion
from simulator.mouth import LIPS, SALIVA, Mouth
from simulator.playback import frame_times, states_at, values_at
from simulator.stress import von_mises
from simulator.surface import display_frames, display_surface

DONE, BAD_INPUT = 0, 2
ENDING = ".view.html"

_OUTSIDE, _INSIDE, _WALL = 0, 1, 2  # kinds of quads: skin and red of the lips; back and rim; the lips' facing walls
_STRESS_TOP = 99.5  # percentile of the stress where the colours end: a few distorted elements must not dim the rest
_EXTENTS = (("width_m", "height_m", 1000.0, "mm"), ("width_px", "height_px", 1.0, "px"))


def write_page(
    path: str | Path,
    mouth: Mouth,
    motion: Motion,
    *,
    title: str,
    times_s: np.ndarray | None = None,
    truth_frames: Mapping[str, np.ndarray] | None = None,
    stress: np.ndarray | None = None,
) -> Path:
    """Write the page that replays a motion.

    Parameters
    ----------
    path : file to write, by custom `<clip>.view.html`
    title : what stands over the picture
    times_s : (F,) times of the frames, s; None takes the saved ones. Positions are linear between saved states, and
        on the page between frames
    truth_frames : table (DataFrame) of the clip's frames with `time_s`, `n_openings` and extents in m or px; where
        given the page shows them
    stress : (T, E) Pa, von Mises, of the saved states; None computes it of skin and lips as tissue

    Returns
    -------
    path : the file

    Raises
    ------
    InputError : times beyond the motion, shapes that do not fit, or a place that cannot be written to
    """
    times_s = frame_times(motion, times_s)
    frames = display_frames(mouth, motion, times_s)
    clip = {"title": title, "times_s": times_s.tolist(), **_shape(mouth), **_positions(frames)}
    clip |= _stress(mouth, motion, times_s, stress) | _saliva(mouth, motion, times_s)
    if truth_frames is not None:
        clip["truth"] = _truth(truth_frames)
    data = json.dumps(clip, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    parts = {"title": html.escape(title), "clip": data}
    template = files("simulator").joinpath("data/view.html").read_text(encoding="utf-8")
    page = re.sub(r"\{\{(title|clip)\}\}", lambda found: parts[found[1]], template)
    with whole_file(path) as part:
        part.write_text(page, encoding="utf-8", newline="\n")
    return Path(path)


def _shape(mouth: Mouth) -> dict:
    """What does not change over time."""
    surface = display_surface(mouth)
    outside = np.isin(surface.nodes[surface.quads], mouth.outer).all(axis=1)
    on_edge = np.isin(surface.nodes[surface.quads], np.concatenate([mouth.upper, mouth.lower])).all(axis=1)
    kind = np.where(outside, _OUTSIDE, np.where(on_edge & (surface.groups == LIPS), _WALL, _INSIDE))
    border = np.clip(np.round(128 + mouth.border_m[surface.nodes] / 2e-5), 0, 255)  # steps of 0.02 mm
    return {
        "vertices": len(surface.nodes),
        "quads": _packed(surface.quads.astype(np.uint32)),
        "kind": _packed(kind.astype(np.uint8)[:, None]),
        "element_of": _packed(surface.element_of.astype(np.uint32)[:, None]),
        "border": _packed(border.astype(np.uint8)[:, None]),
        "upper": surface.vertex_of(mouth.upper).tolist(),
        "lower": surface.vertex_of(mouth.lower).tolist(),
    }


def _positions(frames: np.ndarray) -> dict:
    low = frames.min(axis=(0, 1))
    step = np.maximum(frames.max(axis=(0, 1)) - low, 1e-9) / 65535
    steps = np.round((frames - low) / step).astype(np.uint16)
    return {
        "low_m": low.tolist(),
        "step_m": step.tolist(),
        "error_m": float(np.linalg.norm(step) / 2),
        "positions": _packed(steps.reshape(len(frames), -1)),
    }


def _stress(mouth: Mouth, motion: Motion, times_s: np.ndarray, stress: np.ndarray | None) -> dict:
    """Steps of 1/255 of `stress_top_pa`."""
    if stress is None:
        values = von_mises(mouth, values_at(motion.time_s, motion.positions, times_s))
    else:
        expected = (len(motion.time_s), len(mouth.elements))
        if np.shape(stress) != expected:
            raise InputError(f"expected stress of shape {expected}, saved states and elements, got {np.shape(stress)}")
        values = values_at(motion.time_s, stress, times_s)
    values = np.nan_to_num(values, nan=0.0, posinf=0.0)
    top = max(float(np.percentile(values[:, mouth.group != SALIVA], _STRESS_TOP)), 1e-6)
    return {
        "stress_top_pa": top,
        "stress": _packed(np.clip(np.round(values / top * 255), 0, 255).astype(np.uint8)),
    }


def _saliva(mouth: Mouth, motion: Motion, times_s: np.ndarray) -> dict:
    if motion.saliva is None:
        return {}
    states = states_at(motion.time_s, motion.saliva.of(mouth.saliva).state, times_s)
    return {"state": _packed(states.astype(np.uint8))}


def _truth(table: Mapping[str, np.ndarray]) -> dict:
    missing = [name for name in ("time_s", "n_openings") if name not in table]
    if missing:
        raise InputError(f"expected truth_frames with the columns time_s and n_openings, got none of {missing[0]}")
    truth = {name: _numbers(table[name]) for name in ("time_s", "n_openings")}
    for width, height, factor, unit in _EXTENTS:
        if width in table and height in table:
            truth |= {
                "width": _numbers(np.asarray(table[width], float) * factor),
                "height": _numbers(np.asarray(table[height], float) * factor),
                "unit": unit,
            }
            break
    return truth


def _numbers(values: np.ndarray) -> list:
    """For JSON, unknown as null."""
    return [float(value) if np.isfinite(value) else None for value in np.asarray(values, float)]


def _packed(values: np.ndarray) -> dict:
    """Rows of unsigned integers, small and easy to unpack: differences between rows, folded to be small when
    negative, all low bytes before all higher ones, deflated, base64."""
    bits = 8 * values.dtype.itemsize
    signed = np.dtype(f"i{values.dtype.itemsize}")
    change = np.diff(values, axis=0, prepend=np.zeros_like(values[:1])).view(signed)  # wraps around
    folded = ((change << 1) ^ (change >> (bits - 1))).astype(signed).astype(f"<i{values.dtype.itemsize}")
    planes = folded.ravel().view(np.uint8).reshape(-1, values.dtype.itemsize).T
    data = base64.b64encode(zlib.compress(planes.tobytes(), 9)).decode("ascii")
    return {"bits": bits, "rows": values.shape[0], "columns": values.shape[1], "data": data}


# -- opening a page ---------------------------------------------------------------------------------------------------


def find_page(path: str | Path) -> Path:
    """The page itself, or the only page in a clip's folder.

    Raises
    ------
    InputError : neither, or several pages
    """
    path = Path(path)
    if path.is_file():
        if path.suffix.lower() not in (".html", ".htm"):
            raise InputError(
                f"expected a clip's folder or its page ({ENDING}), got the file {path}; give the folder it lies in"
            )
        return path
    if not path.is_dir():
        raise InputError(f"expected a clip's folder or its page ({ENDING}), got {path}, which does not exist")
    pages = sorted(path.glob(f"*{ENDING}"))
    if not pages:
        raise InputError(
            f"expected a page (*{ENDING}) in the folder {path}, got none; make a clip with `lipmetrics simulate`, "
            "without --truth-only"
        )
    if len(pages) > 1:
        raise InputError(f"expected one page in {path}, got {len(pages)}; name one of them, such as {pages[0]}")
    return pages[0]


def view(path: str | Path, open_browser: bool = True) -> Path:
    """Open the page of a clip in the browser.

    Parameters
    ----------
    path : a clip's folder with one `*.view.html` in it, or the page
    open_browser : False only finds the page

    Returns
    -------
    path : the page

    Raises
    ------
    InputError : no page there or several, or no browser to be found
    """
    page = find_page(path)
    if open_browser and not webbrowser.open(page.resolve().as_uri()):
        raise InputError(f"expected a browser on this computer, got none; open {page} where there is one")
    return page


def main(argv: list[str] | None = None, prog: str = "python -m simulator.viewer") -> int:
    """The command `lipmetrics view`, called `prog`; returns the exit code: 0 done, 2 bad arguments or input."""
    parser = argparse.ArgumentParser(
        prog=prog,
        description="Replay a simulated clip in the browser.",
        epilog=f"example: {prog} clip/",
    )
    parser.add_argument("clip", help=f"folder of a clip, or its page (*{ENDING})")
    parser.add_argument("--no-browser", action="store_true", help="only say where the page is")
    parser.add_argument("--json", action="store_true", help="a summary for machines on stdout")
    arguments = parser.parse_args(argv)
    try:
        page = view(arguments.clip, open_browser=not arguments.no_browser)
    except (InputError, OSError) as error:
        print(f"{prog}: {error}", file=sys.stderr)
        return BAD_INPUT
    print(json.dumps({"command": "view", "page": str(page)}) if arguments.json else page)
    return DONE


if __name__ == "__main__":
    sys.exit(main())
