"""The videos of a study: copied beside the design, and looked at for what browsers would trip over."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Sequence
from pathlib import Path

from study.atomic import whole_file
from study.design import Stimulus
from study.errors import InputError
from study.wording import short

CODECS = ("h264", "vp8", "vp9", "av1")
DURATIONS_APART_S = 0.1


def copy_videos(stimuli: Sequence[Stimulus], folder: str | Path) -> list[Stimulus]:
    """Copy the stimuli's files to folder/videos/<code><ending>; returns the stimuli with paths from `folder`."""
    copied = []
    for one in stimuli:
        if one.file:
            name = f"{one.code}{Path(one.file).suffix.lower()}"
            if "/" in name or "\\" in name or name.startswith("."):
                raise InputError(f"expected codes that can name a file, got '{short(one.code)}'")
            target = Path(folder) / "videos" / name
            if not (target.exists() and target.samefile(one.file)):
                with whole_file(target) as part:
                    shutil.copyfile(one.file, part)
            one = dataclasses.replace(one, file=f"videos/{name}")
        copied.append(one)
    return copied


def check_videos(stimuli: Sequence[Stimulus], pairs: Sequence[tuple[str, str]]) -> list[str]:
    """Warnings: a codec or pixel format that some browsers do not play, pairs of unequal length or size.

    Raises
    ------
    InputError : a file without a video that can be read
    """
    import av

    facts, warnings = {}, []
    for one in stimuli:
        if not one.file:
            continue
        try:
            with av.open(one.file, metadata_errors="replace") as container:
                stream = container.streams.video[0]
                context = stream.codec_context
                if context is None:
                    raise InputError(f"expected a video in {one.file}, but: its kind of picture is unknown")
                seconds = (
                    float(stream.duration * stream.time_base) if stream.duration else (container.duration or 0) / 1e6
                )
                facts[one.code] = (seconds, f"{context.width} x {context.height}")
                codec, colours = context.name, context.pix_fmt
                silent = not container.streams.audio
        except (av.FFmpegError, IndexError, OSError) as error:
            raise InputError(f"expected a video in {one.file}, but: {short(str(error))}") from None
        codec = codec.removeprefix("lib").removesuffix("dav1d") or codec
        if not any(name in context.codec.canonical_name for name in CODECS):
            warnings.append(f"{one.code}: not every browser plays {codec}; make it H.264 in .mp4")
        elif colours != "yuv420p":
            warnings.append(f"{one.code}: not every browser plays pixels of {colours}; make them yuv420p")
        if one.audio and silent:
            warnings.append(f"{one.code}: is to be shown with sound, and has none")
    for a, b in pairs:
        if a in facts and b in facts:
            if abs(facts[a][0] - facts[b][0]) > DURATIONS_APART_S:
                warnings.append(f"{a} and {b}: are shown together, and last {facts[a][0]:.2f} and {facts[b][0]:.2f} s")
            if facts[a][1] != facts[b][1]:
                warnings.append(f"{a} and {b}: are shown together, and measure {facts[a][1]} and {facts[b][1]} px")
    return warnings
