"""Corpora on the disk to clips: GRID, Lombard GRID, RAVDESS, MEAD, and any folder whose names follow a template.

A reader looks at names only, never into videos. What it cannot read it hands back with the reason, so that one odd
file does not stop a corpus. Videos of variable frame rate (Lombard GRID: about 24 per second) need nothing special:
every frame is measured at its own time stamp.

Layouts, from the corpora's own descriptions (Cooke et al. 2006; Alghamdi et al. 2018; Livingstone and Russo 2018;
Wang et al. 2020) and from public scripts that read them:

    GRID          s1/bbaf2n.mpg, s1/video/mpg_6000/bbaf2n.mpg, or pictures s1/bbaf2n/*.jpg; bbaf2n.align anywhere
    Lombard GRID  front/s10_l_bbat9p.mov, alignment/s10_l_bbat9p.json; misread: s46_p_gbszs_WRONG_sgbszs.mov
    RAVDESS       Actor_12/01-01-06-01-02-01-12.mp4
    MEAD          M003/video/front/angry/level_1/001.mp4, also front/angry_level_1/001.mp4
"""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from corpus_tools.clips import Clip, Slice
from corpus_tools.naming import Template
from corpus_tools.slices import read_slices
from corpus_tools.wording import nearest
from lipmetrics.endings import PICTURE_ENDINGS, VIDEO_ENDINGS
from lipmetrics.errors import InputError

GRID_FPS = 25.0

# the six letters of a sentence of GRID and their words; w is the one letter of the alphabet that GRID leaves out
GRID_WORDS = {
    "command": {"b": "bin", "l": "lay", "p": "place", "s": "set"},
    "color": {"b": "blue", "g": "green", "r": "red", "w": "white"},
    "preposition": {"a": "at", "b": "by", "i": "in", "w": "with"},
    "letter": {letter: letter for letter in "abcdefghijklmnopqrstuvxyz"},
    "digit": {
        **{"z": "zero", "1": "one", "2": "two", "3": "three", "4": "four"},
        **{"5": "five", "6": "six", "7": "seven", "8": "eight", "9": "nine"},
    },
    "adverb": {"a": "again", "n": "now", "p": "please", "s": "soon"},
}
GRID_CODE = Template("".join(f"{{{field}:{'|'.join(words)}}}" for field, words in GRID_WORDS.items()))
LOMBARD_NAME = Template("{speaker}_{condition:l|p}_{utterance:word}[_WRONG_{said}]")
RAVDESS_NAME = Template(
    "{modality:01..03}-{channel:01..02}-{emotion:01..08}-{intensity:01..02}-{statement:01..02}-{repeat:01..02}-"
    "{actor:01..24}"
)
RAVDESS_CODES = {
    "channel": ("speech", "song"),
    "emotion": ("neutral", "calm", "happy", "sad", "angry", "fearful", "disgust", "surprised"),
    "intensity": ("normal", "strong"),
    "statement": ("kids", "dogs"),  # are talking, are sitting by the door
}
MEAD_EMOTIONS = ("angry", "contempt", "disgusted", "fear", "happy", "neutral", "sad", "surprised")
MEAD_VIEWS = ("front", "down", "top", "left_30", "left_60", "right_30", "right_60")
LOMBARD_VIEWS = ("front", "side")

_MEAD_PATH = re.compile(
    rf"(?:.*/)?([MW]\d{{3}})/(?:video/)?({'|'.join(MEAD_VIEWS)})/({'|'.join(MEAD_EMOTIONS)})[/_]level_([1-3])/(\d+)"
)
_GRID_SPEAKER = re.compile(r"(s\d+)(?:[^0-9].*)?")


@dataclasses.dataclass(frozen=True)
class Reading:
    """What is in a corpus.

    Parameters
    ----------
    clips : in order of their names, which are all different
    misfits : files and folders that are no clips of the corpus, or have the name of another, each with the reason
    """

    clips: tuple[Clip, ...]
    misfits: tuple[tuple[Path, str], ...] = ()


def read_corpus(
    folder: str | Path,
    corpus: str | None = None,
    template: Template | str | None = None,
    *,
    fps: float | None = None,
) -> Reading:
    """Read a corpus by its name (one of `READERS`), or a folder by a template.

    Parameters
    ----------
    fps : of folders of pictures by template, per second

    Raises
    ------
    InputError : an unknown corpus, both or neither, or what the readers refuse
    """
    if (corpus is None) == (template is None):
        raise InputError(
            f"expected a corpus ({', '.join(READERS)}) or a template, got {'both' if corpus else 'neither'}"
        )
    if template is not None:
        return read_folder(folder, template, fps=fps)
    if corpus not in READERS:
        raise InputError(f"expected a corpus out of {', '.join(READERS)}, got {nearest(corpus, READERS)}")
    return READERS[corpus](folder)


def read_folder(folder: str | Path, template: Template | str, *, fps: float | None = None) -> Reading:
    """Read videos, and folders of pictures, whose names follow a template.

    Parameters
    ----------
    template : of names without their endings; with a `/` of paths from the folder, else of the last part alone
    fps : of the pictures, per second

    Words are read from a file beside the video that has its name and the ending `.TextGrid` or `.align`.

    Raises
    ------
    InputError : no such folder, or no clip in it that fits
    """
    template = Template(template) if isinstance(template, str) else template
    words_at = _words_by_stem(folder, {".align", ".textgrid"})

    def clip_of(path: Path, place: str) -> Clip:
        name = place if "/" in template.text else place.rpartition("/")[2]
        fields = template.parse(name)
        return Clip(
            path, name.replace("/", "-"), fields, words=_words(words_at.get(place)), fps=fps if path.is_dir() else None
        )

    return _read(folder, clip_of, f"names of the form {template.text}")


def read_grid(folder: str | Path) -> Reading:
    """Read GRID: videos or folders of pictures named by sentence, inside of a folder for each speaker.

    Fields: speaker (`s1`), utterance (`bbaf2n`), and its words command, color, preposition, letter, digit, adverb.
    """
    by_speaker: dict[tuple[str | None, str], Path] = {}
    for place, path in _words_by_stem(folder, {".align", ".textgrid"}).items():
        code = place.rpartition("/")[2]
        by_speaker.setdefault((_grid_speaker(place, folder), code), path)

    def clip_of(path: Path, place: str) -> Clip:
        code = place.rpartition("/")[2]
        fields = grid_words(code)
        speaker = _grid_speaker(place, folder)
        if speaker is None:
            raise InputError(f"expected {path} to lie in a folder of its speaker such as s1, got none")
        words = _words(by_speaker.get((speaker, code)))
        fields = {"speaker": speaker, "utterance": code, **fields}
        return Clip(path, f"{speaker}_{code}", fields, words=words, fps=GRID_FPS if path.is_dir() else None)

    return _read(folder, clip_of, "sentences of GRID such as s1/bbaf2n.mpg or s1/bbaf2n/*.jpg")


def grid_words(code: str) -> dict[str, str]:
    """The words of a sentence of GRID by their place: `bbaf2n` is bin blue at f two now."""
    return {field: GRID_WORDS[field][letter] for field, letter in GRID_CODE.parse(code).items()}


def read_lombard(folder: str | Path, views: Collection[str] = ("front",)) -> Reading:
    """Read Lombard GRID; what was said counts, not the label: `s46_p_gbszs_WRONG_sgbszs` is the sentence sgbszs.

    Fields: speaker, condition (`lombard` or `plain`), utterance, view, label (None, or what should have been said),
    and the words as for GRID. Clips in which nothing was said (`_WRONG_#sil`), or not a sentence, are misfits.

    Parameters
    ----------
    views : of `front` and `side`, the folders of the two cameras
    """
    _check_views(views, LOMBARD_VIEWS)
    words_at = {
        place.rpartition("/")[2]: path for place, path in _words_by_stem(folder, {".json", ".textgrid"}).items()
    }

    def clip_of(path: Path, place: str) -> Clip | None:
        view = next((part for part in place.split("/")[-2::-1] if part in LOMBARD_VIEWS), None) or Path(folder).name
        if view not in LOMBARD_VIEWS:
            raise InputError(f"expected {path} to lie in the folder front or side, got neither")
        if view not in views:
            return None
        stem = place.rpartition("/")[2]
        fields = LOMBARD_NAME.parse(stem)
        said = fields["said"] or fields["utterance"]
        if "sil" in said.lower() and not GRID_CODE.matches(said):
            raise InputError(f"expected a sentence in {path}, got silence, as its name says")
        words = grid_words(said)
        about = {
            "speaker": fields["speaker"],
            "condition": "lombard" if fields["condition"] == "l" else "plain",
            "utterance": said,
            "view": view,
            "label": fields["utterance"] if fields["said"] else None,
        }
        name = stem if len(views) == 1 else f"{stem}_{view}"
        return Clip(path, name, about | words, words=_words(words_at.get(stem)))

    return _read(folder, clip_of, "sentences of Lombard GRID such as front/s10_l_bbat9p.mov")


def read_ravdess(folder: str | Path) -> Reading:
    """Read the videos of RAVDESS; of a recording that is there with sound (01-) and without (02-), the one with sound.

    Fields: speaker (`12`), utterance (`kids` or `dogs`), repeat, channel, emotion, intensity, modality (`av`, `video`).
    """
    both: dict[str, str] = {}
    for _, place in _sources(folder):
        stem = place.rpartition("/")[2]
        if RAVDESS_NAME.matches(stem):
            both[stem[2:]] = min(stem, both.get(stem[2:], stem))

    def clip_of(path: Path, place: str) -> Clip | None:
        stem = place.rpartition("/")[2]
        codes = RAVDESS_NAME.parse(stem)
        if codes["modality"] == 3:
            raise InputError(f"expected videos of RAVDESS, which start with 01 or 02, got {path}, which has sound only")
        if both[stem[2:]] != stem:
            return None
        said = {field: words[codes[field] - 1] for field, words in RAVDESS_CODES.items()}
        fields = {
            "speaker": f"{codes['actor']:02d}",
            "utterance": said.pop("statement"),
            "repeat": codes["repeat"],
            **said,
            "modality": "av" if codes["modality"] == 1 else "video",
        }
        return Clip(path, stem, fields)

    return _read(folder, clip_of, "videos of RAVDESS such as Actor_12/01-01-06-01-02-01-12.mp4")


def read_mead(folder: str | Path, views: Collection[str] = ("front",)) -> Reading:
    """Read MEAD in both of its layouts. Fields: speaker (`M003`), view, emotion, level, utterance (`001`).

    Parameters
    ----------
    views : of the seven cameras; others than `front` show the mouth from the side
    """
    _check_views(views, MEAD_VIEWS)
    root = Path(folder).resolve()

    def clip_of(path: Path, place: str) -> Clip | None:
        # the folder given may be one of a speaker, or deeper
        found = _MEAD_PATH.fullmatch(place) or _MEAD_PATH.fullmatch(f"{root.as_posix()}/{place}")
        if found is None:
            raise InputError(f"expected a path such as M003/video/front/angry/level_1/001.mp4, got {path}")
        speaker, view, emotion, level, number = found.groups()
        if view not in views:
            return None
        fields = {"speaker": speaker, "view": view, "emotion": emotion, "level": int(level), "utterance": number}
        return Clip(path, f"{speaker}-{view}-{emotion}-level_{level}-{number}", fields)

    return _read(folder, clip_of, "videos of MEAD such as M003/video/front/angry/level_1/001.mp4")


READERS: dict[str, Callable[..., Reading]] = {
    "grid": read_grid,
    "lombard": read_lombard,
    "ravdess": read_ravdess,
    "mead": read_mead,
}


# -- the disk ----------------------------------------------------------------------------------------------------------


def _read(folder: str | Path, clip_of: Callable[[Path, str], Clip | None], what: str) -> Reading:
    """A clip for every source, None for one that is not wanted; `clip_of` refuses what does not fit."""
    clips: list[Clip] = []
    misfits: list[tuple[Path, str]] = []
    for path, place in _sources(folder):
        try:
            clip = clip_of(path, place)
        except InputError as error:
            misfits.append((path, str(error)))
            continue
        if clip is not None:
            clips.append(clip)
    if not clips:
        why = f"; the first of {len(misfits)} that do not fit: {misfits[0][1]}" if misfits else ", got no videos"
        raise InputError(f"expected {what} in {folder}{why}")
    first: dict[str, Clip] = {}
    for clip in sorted(clips, key=lambda clip: (clip.name, str(clip.path))):
        other = first.setdefault(clip.name.lower(), clip)  # some file systems do not tell Anna from anna
        if other is not clip:
            misfits.append((clip.path, f"expected clips of different names, got {clip.name} again, after {other.path}"))
    return Reading(tuple(first.values()), tuple(misfits))


def _sources(folder: str | Path) -> Iterator[tuple[Path, str]]:
    """Videos, and folders that hold pictures, with their paths from the folder without endings, in order."""
    root = Path(folder)
    if not root.is_dir():
        raise InputError(
            f"expected a folder with a corpus, got {folder}, which is {'a file' if root.exists() else 'not there'}"
        )
    for at, folders, names in os.walk(root, followlinks=True):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        inside = [name for name in sorted(names) if not name.startswith(".")]
        videos = [name for name in inside if Path(name).suffix.lower() in VIDEO_ENDINGS]
        for name in videos:
            path = Path(at, name)
            yield path, path.relative_to(root).with_suffix("").as_posix()
        if not videos and Path(at) != root and any(Path(name).suffix.lower() in PICTURE_ENDINGS for name in inside):
            yield Path(at), Path(at).relative_to(root).as_posix()


def _words_by_stem(folder: str | Path, endings: Collection[str]) -> dict[str, Path]:
    """Files with words by their paths from the folder without endings."""
    root = Path(folder)
    found: dict[str, Path] = {}
    for at, folders, names in os.walk(root, followlinks=True):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(names):
            path = Path(at, name)
            if path.suffix.lower() in endings:
                found.setdefault(path.relative_to(root).with_suffix("").as_posix(), path)
    return found


def _words(path: Path | None) -> tuple[Slice, ...]:
    return () if path is None else read_slices(path)


def _grid_speaker(place: str, folder: str | Path) -> str | None:
    """The nearest folder above that is named as a speaker of GRID: s1, s1_processed, s1.mpg_6000.part1."""
    above = [*Path(folder).resolve().parts[-2:], *place.split("/")[:-1]]
    for part in reversed(above):
        if found := _GRID_SPEAKER.fullmatch(part):
            return found[1]
    return None


def _check_views(views: Collection[str], known: tuple[str, ...]) -> None:
    for view in views:
        if view not in known:
            raise InputError(f"expected views out of {', '.join(known)}, got {nearest(view, known)}")
    if not views:
        raise InputError(f"expected one view or more out of {', '.join(known)}, got none")
