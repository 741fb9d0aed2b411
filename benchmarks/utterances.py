"""Takes for the benchmarks of comparison: simulated utterances of many mouths, and pieces of real clips.

Everything is made from seeds. What takes long is kept in the folder named by `--cache` (or LIPMETRICS_BENCHMARK_CACHE),
if there is one, and found again by name; empty it after changing the simulator or the detector.
"""

from __future__ import annotations

import dataclasses
import os
import zlib
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import reference

from lipmetrics.take import CHANNELS, Take
from lipmetrics.takes import read_take
from simulator.motion import Motion
from simulator.mouth import Mouth
from simulator.scene import Action, Scene, load_scene
from simulator.simulate import simulate
from simulator.truth import truth

UTTERANCES = ("slow_open", "fast_open", "m", "p", "mummy", "puppy")
LEVELS = (0.0, 4.0, 7.0, 10.0)
REPEATS = 2
TUNE_FACES = ("average", "wide", "full_lips", "older", "short_chin", "cupid")
REPORT_FACES = ("narrow", "thin_lips", "child", "protruding", "long_chin", "smiling")
RATES_HZ = (25.0, 30.0, 50.0, 60.0)  # of the clips, in turn
TEMPO_SD, LOCAL_TEMPO_SD, STRENGTH_SD, SIZE_SD = 0.12, 0.15, 0.10, 0.03
NOISE_MW = {"width": 0.012, "height": 0.006, "area": 0.005}  # of measuring, as docs/validation.md has it
CLOSED_BELOW_MW = 0.012  # height that counts as closed with noise
WINDOW_S = 2.5
MOVES_MW = 0.04  # least range of heights (5 to 95 %) for a piece of a clip to be a movement


def cache_folder() -> Path | None:
    """Where takes are kept, if anywhere."""
    folder = os.environ.get("LIPMETRICS_BENCHMARK_CACHE")
    return Path(folder) if folder else None


def seeded(*names: object) -> np.random.Generator:
    """A generator of its own for each name."""
    return np.random.default_rng([zlib.crc32(str(name).encode()) for name in names])


def kept(name: str, make: Callable[[], Take]) -> Take:
    """A take from the cache, or made and put there."""
    folder = cache_folder()
    if folder is None:
        return make()
    file = folder / f"{name}.npz"
    if file.is_file():
        with np.load(file) as found:
            channels = {key: found[key] for key in found.files if key != "time_s"}
            return Take(name, found["time_s"], channels, source="truth")
    made = make()
    folder.mkdir(parents=True, exist_ok=True)
    part = file.with_suffix(".part.npz")
    np.savez(part, time_s=made.time_s, **made.channels)
    os.replace(part, file)
    return made


# -- simulated --------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Spoken:
    """One simulated take and what it is a take of."""

    utterance: str
    level: float
    face: str
    repeat: int
    take: Take


def spoken(
    faces: Sequence[str],
    utterances: Sequence[str] = UTTERANCES,
    levels: Sequence[float] = LEVELS,
    repeats: int = REPEATS,
) -> list[Spoken]:
    """Takes of all combinations, each with a timing, strength and noise of its own."""
    found = []
    for face in faces:
        for utterance in utterances:
            for level in levels:
                for repeat in range(repeats):
                    name = f"{face}_{utterance}_{level:g}_{repeat}"
                    clean = kept(name, lambda: _simulated(utterance, level, face, repeat, name))  # noqa: B023
                    found.append(Spoken(utterance, level, face, repeat, noisy(clean, seeded("noise", name))))
    return found


def _simulated(utterance: str, level: float, face: str, repeat: int, name: str) -> Take:
    return truth_take(varied(utterance, level, face, repeat), name)


def truth_take(scene: Scene, name: str) -> Take:
    """The truth of a scene in mouth widths, with no files written."""
    mouth, motion = solved(scene)
    frames = truth(motion, mouth, scene.camera, scene.frame_times_s).frames
    columns = {"width": "width_mw", "height": "height_mw", "area": "area_mw2", "n_openings": "n_openings"}
    return Take(
        name,
        frames["time_s"].to_numpy(float),
        {channel: frames[column].to_numpy(float) for channel, column in columns.items()},
        source="truth",
    )


def solved(scene: Scene) -> tuple[Mouth, Motion]:
    """The mouth of a scene and its motion, with smaller steps where the usual ones do not hold."""
    mouth, model = scene.model()
    for safety in (scene.solve.safety, scene.solve.safety / 2, scene.solve.safety / 4):
        settings = dataclasses.replace(scene.solve, safety=safety)
        motion = simulate(dataclasses.replace(scene, solve=settings), parts=(mouth, model))
        if not motion.stopped:
            return mouth, motion
    raise RuntimeError(f"{scene.name}, {scene.face.preset}: {motion.stopped}")


def varied(utterance: str, level: float, face: str, repeat: int, resolution: str = "low") -> Scene:
    """A built-in scene spoken by somebody else, once more.

    Key times go through a smooth seeded warp (overall tempo and a slow change of it), the jaw's way
    and the breath's strength vary, and the clip begins and ends a little earlier or later.
    """
    random = seeded(utterance, level, face, repeat)
    scene = load_scene(utterance, level)
    tempo, strength = np.exp(random.normal(0, TEMPO_SD)), np.exp(random.normal(0, STRENGTH_SD))
    depth, phase = np.clip(random.normal(0, LOCAL_TEMPO_SD), -0.4, 0.4), random.uniform(0, 2 * np.pi)
    lead_s, tail_s = random.uniform(0, 0.15), random.uniform(-0.1, 0.1)
    whole_s = scene.duration_s

    def later(time_s: float) -> float:
        turn = 2 * np.pi * time_s / whole_s + phase
        bent = time_s + depth * whole_s / (2 * np.pi) * (np.sin(turn) - np.sin(phase))
        return float(lead_s + tempo * bent)

    def moved(action: Action) -> Action:
        keys = tuple(key if isinstance(key, str) else (later(key[0]), key[1]) for key in action.keys)
        peaks = {peak: getattr(action, peak) for peak in ("peak_m", "peak_n")}
        peaks = {peak: value * strength for peak, value in peaks.items() if value is not None}
        return dataclasses.replace(action, keys=keys, **peaks)

    return dataclasses.replace(
        scene,
        duration_s=max(later(whole_s) + tail_s, 0.3),
        face=dataclasses.replace(scene.face, preset=face, resolution=resolution),
        muscle=tuple(moved(action) for action in scene.muscle),
        output=dataclasses.replace(scene.output, frame_rate=float(random.choice(RATES_HZ))),
    )


def noisy(take: Take, random: np.random.Generator) -> Take:
    """A take as measuring would see it: a mouth width that is off, and noise that lasts over a few frames."""
    size = np.exp(random.normal(0, SIZE_SD))
    is_open = take.channels["height"] * size >= CLOSED_BELOW_MW
    channels = {}
    for channel in CHANNELS:
        noise = np.empty(len(take.time_s))
        noise[0] = random.normal()
        for k in range(1, len(noise)):
            noise[k] = 0.6 * noise[k - 1] + 0.8 * random.normal()
        values = take.channels[channel] * size ** (2 if channel == "area" else 1) + NOISE_MW[channel] * noise
        channels[channel] = np.where(is_open, np.maximum(values, 0), 0.0)
    return dataclasses.replace(take, channels=channels)


# -- real -------------------------------------------------------------------------------------------------------------


def clip_names(part: str = "all") -> list[str]:
    """The reference videos of one part, in order of name."""
    return sorted(Path(path).stem for path in reference.choose("videos", part)["path"])


@lru_cache(maxsize=64)
def detected(name: str) -> Take:
    """A reference video measured by the default method."""
    folder = cache_folder()
    return read_take(reference.video_file(name), work_folder=folder / "measured" if folder else None)


def landmarks(name: str) -> Take:
    """The same video as MediaPipe's inner lips have it, in mouth widths of the median frame; NaN where not found."""
    table = reference.profile(name)
    width_px = float(table["mouth_w_px"].median())
    height = table["open_h_px"].to_numpy(float) / width_px
    found = (table["mp_ok"] == 1).to_numpy()
    is_open = height >= reference.LANDMARKS_CLOSED_MW
    values = {
        "width": table["inner_w_px"].to_numpy(float) / width_px,
        "height": height,
        "area": table["open_area_px2"].to_numpy(float) / width_px**2,
    }
    channels = {name: np.where(found, np.where(is_open, one, 0.0), np.nan) for name, one in values.items()}
    return Take(name, table["time_s"].to_numpy(float), channels, source="mediapipe")


def pieces(part: str, window_s: float = WINDOW_S) -> list[tuple[str, Take, Take]]:
    """Pieces of the real clips of a part that move and are known to both: (name, detector's take, landmarks' take)."""
    found = []
    for name in clip_names(part):
        one, other = detected(name), landmarks(name)
        other = dataclasses.replace(other, time_s=other.time_s - other.time_s[0] + one.time_s[0])
        count = int((one.duration_s + 1e-6) / window_s)
        for k in range(count):
            start = one.time_s[0] + k * window_s
            cuts = [cut(take, start, start + window_s, f"{name}_{k}") for take in (one, other)]
            heights = [take.channels["height"] for take in cuts]
            known = all(np.isfinite(height).all() for height in heights)
            if known and all(np.ptp(np.percentile(height, (5, 95))) >= MOVES_MW for height in heights):
                found.append((f"{name}_{k}", *cuts))
    return found


def cut(take: Take, start_s: float, stop_s: float, name: str | None = None) -> Take:
    """The frames of a take from one time to before another."""
    inside = (take.time_s >= start_s - 1e-9) & (take.time_s < stop_s - 1e-9)
    channels = {channel: values[inside] for channel, values in take.channels.items()}
    return Take(name or take.name, take.time_s[inside], channels, take.unit, source=take.source)


def repeated(take: Take, whole: Take, random: np.random.Generator) -> Take:
    """A piece said once more: the same movement in another tempo, cut a little elsewhere, at another frame rate.

    take : the piece; whole : the clip it is from
    """
    tempo = np.exp(random.normal(0, TEMPO_SD))
    depth, phase = np.clip(random.normal(0, LOCAL_TEMPO_SD), -0.4, 0.4), random.uniform(0, 2 * np.pi)
    begin, end = take.time_s[[0, -1]] + random.uniform(-0.12, 0.12, 2)
    begin, end = max(begin, whole.time_s[0]), min(end, whole.time_s[-1])
    fine = np.linspace(0, 1, 1001)
    bent = fine + depth / (2 * np.pi) * (np.sin(2 * np.pi * fine + phase) - np.sin(phase))
    rate_hz = float(random.choice(RATES_HZ))
    time_s = np.arange(int((end - begin) * tempo * rate_hz) + 1) / rate_hz
    source_s = begin + (end - begin) * np.interp(time_s / ((end - begin) * tempo), bent, fine)
    return Take(
        take.name,
        time_s,
        {channel: np.interp(source_s, whole.time_s, whole.channels[channel]) for channel in CHANNELS},
        take.unit,
        source=take.source,
    )
