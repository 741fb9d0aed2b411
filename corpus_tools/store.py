"""One HDF5 file with the measurements of a corpus: tables as columns, fields of the names, provenance.

    /meta                         attributes: format, version, lipmetrics
    /clips/<name>                 attributes: source_sha256, settings_sha256, seen
    /clips/<name>/frames/<column>     (T,) one value a frame
    /clips/<name>/openings/<column>   (R,) one value an opening and frame
    /clips/<name>/about           JSON: fields, start_s, stop_s, words
    /clips/<name>/provenance      JSON: as `lipmetrics measure` writes it
    /failed/<name>                a clip that could not be measured: the same attributes, lasting, about and reason

Closed is 0, unknown is NaN. `docs/corpus_store.md` says more. A store is never changed in place: `write_store` makes a
new one out of parts, each of which is a store of one clip. So it is whole or not there, and two stores of the same
parts have the same bytes, in whatever order the parts came.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import ExitStack, nullcontext
from functools import lru_cache, wraps
from pathlib import Path

import h5py
import numpy as np
import pandas as pd

from corpus_tools.clips import Clip, Slice
from corpus_tools.wording import nearest
from lipmetrics.errors import InputError
from lipmetrics.look import CLOSED, NO_MOUTH, OPEN
from lipmetrics.profile import FRAME_COLUMNS, OPENING_COLUMNS, Profile, with_mouth_width, without_nan
from lipmetrics.take import Take
from lipmetrics.takes import take_of_profile

FORMAT = "lipmetrics corpus store"
MOST_SHRUNK = 1100  # times that deflate makes anything smaller, at most
VERSION = 1  # goes up when an older reader would misread a newer file
STATUS = {OPEN: 0, CLOSED: 1, NO_MOUTH: 2}
EVENT = {"": 0, "new": 1, "split": 2, "merge": 3}
_ENUMS = {
    "status": h5py.enum_dtype(STATUS, "u1"),
    "event": h5py.enum_dtype({word or "goes_on": code for word, code in EVENT.items()}, "u1"),
}
_CODES = {"status": STATUS, "event": EVENT}
_WHOLE = {"frame": "int64", "opening": "int64"}

Where = Mapping[str, object] | Callable[[Mapping[str, object]], bool] | None


def _readable(method: Callable) -> Callable:
    """A method of a store that says in one sentence what in a damaged one it cannot read."""

    @wraps(method)
    def read(self, *arguments, **settings):
        try:
            return method(self, *arguments, **settings)
        except InputError:
            raise
        except (OSError, LookupError, RuntimeError, ValueError, TypeError, AttributeError, OverflowError) as error:
            raise InputError(
                f"expected a store that 'lipmetrics corpus run' wrote, got {self.path}, which is damaged: "
                f"{type(error).__name__} {error}"
            ) from None

    return read


class Store:
    """A store, opened for reading; to be closed, or used in `with`.

    Parameters
    ----------
    path : of the file

    Raises
    ------
    InputError : no such file, not a store, or one of a newer format
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self._file = _open(self.path)
        try:
            self.version = self._checked_version()
        except InputError:
            self._file.close()
            raise

    @_readable
    def _checked_version(self) -> int:
        return _checked_version(self._file, self.path)

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._file.close()

    @property
    @_readable
    def names(self) -> list[str]:
        """Names of the measured clips, in order."""
        return list(self._group("clips"))

    @property
    @_readable
    def failed(self) -> dict[str, str]:
        """Why, by name, of the clips that could not be measured."""
        return {name: _text(group["reason"]) for name, group in self._group("failed").items()}

    @_readable
    def fields(self, name: str) -> dict[str, str | int | float | None]:
        """What the name of a clip says: speaker, utterance, repeat, ..."""
        return dict(self._about(name)["fields"])

    @_readable
    def words(self, name: str) -> tuple[Slice, ...]:
        """Labelled parts of a clip, s from the start of its video."""
        return tuple(Slice(**word) for word in self._about(name)["words"])

    @_readable
    def profile(self, name: str) -> Profile:
        """A clip's tables and provenance, as `lipmetrics.measure` gave them.

        Raises InputError for a name that is not there.
        """
        group = self._clip(name)
        meta = with_mouth_width(json.loads(_text(group["provenance"])), f"{self.path}, {name}")
        return Profile(_table(group["frames"], FRAME_COLUMNS), _table(group["openings"], OPENING_COLUMNS), meta)

    @_readable
    def take(self, name: str, *, unit: str = "mw") -> Take:
        """A clip as a take; `meta["fields"]` and `meta["words"]` say what it is of.

        Raises
        ------
        InputError : a name that is not there, a unit other than mw and px, or mw where the mouth width is unknown
        """
        take = take_of_profile(self.profile(name), name, unit=unit, source="video")
        about = {"fields": self.fields(name), "words": self.words(name)}
        return dataclasses.replace(take, meta=dict(take.meta) | about)

    def takes(
        self, where: Where = None, *, unit: str = "mw", on_misfit: Callable[[str, str], None] | None = None
    ) -> list[Take]:
        """The clips that `where` picks as takes, in order of name.

        Parameters
        ----------
        where : value, or a collection of values, by field, such as {"utterance": "m", "stickiness": [4, 7]}; or a
            function of the fields; None picks all
        unit : `mw` or `px`
        on_misfit : called with the name and the reason for a clip that cannot be had in this unit, which is then left
            out; None raises

        Raises
        ------
        InputError : a field that no clip has, or as `take`
        """
        found = []
        for name in self.select(where):
            try:
                found.append(self.take(name, unit=unit))
            except InputError as error:
                if on_misfit is None:
                    raise
                on_misfit(name, str(error))
        return found

    def select(self, where: Where = None) -> list[str]:
        """Names of the clips that `where` picks, as in `takes`."""
        if where is None:
            return self.names
        all_fields = {name: self.fields(name) for name in self.names}
        if callable(where):
            return [name for name, fields in all_fields.items() if where(fields)]
        known = list(dict.fromkeys(field for fields in all_fields.values() for field in fields))
        for field in where:
            if field not in known:
                raise InputError(f"expected a field out of {', '.join(known) or 'none'}, got {nearest(field, known)}")
        return [
            name
            for name, fields in all_fields.items()
            if all(_fits(fields.get(field), value) for field, value in where.items())
        ]

    @_readable
    def table(self) -> pd.DataFrame:
        """A row per clip, failed ones too: name, the fields, frames_n, length_s, mouth_width_px, reason."""
        rows = []
        for name in self.names:
            group = self._clip(name)
            times = _values(group["frames/time_s"])
            length_s = float(times[-1] - times[0]) if len(times) else math.nan
            width_px = json.loads(_text(group["provenance"])).get("mouth_width_px")
            facts = {"frames_n": len(times), "length_s": length_s, "mouth_width_px": width_px, "reason": ""}
            rows.append({"name": name, **self.fields(name), **facts})
        for name, group in self._group("failed").items():
            rows.append({"name": name, **_about(group)["fields"], "frames_n": 0, "reason": _text(group["reason"])})
        return pd.DataFrame(rows).sort_values("name", ignore_index=True) if rows else pd.DataFrame(columns=["name"])

    @_readable
    def keys(self) -> dict[str, Key]:
        """What each clip was measured from and how, failed ones too."""
        found = {}
        for kind in ("clips", "failed"):
            for name, group in self._group(kind).items():
                attributes = {key: value.decode() for key, value in group.attrs.items() if isinstance(value, bytes)}
                found[name] = Key(
                    attributes["source_sha256"],
                    attributes["settings_sha256"],
                    attributes["seen"],
                    failed=kind == "failed",
                    lasting=kind == "clips" or bool(group.attrs["lasting"]),
                )
        return found

    def _group(self, kind: str):
        return self._file.get(kind) or {}

    def _clip(self, name: str) -> h5py.Group:
        clips = self._group("clips")
        if name not in clips:
            if name in self._group("failed"):
                raise InputError(f"expected a clip that was measured, got '{name}', which failed: {self.failed[name]}")
            raise InputError(f"expected a clip of {self.path}, got {nearest(name, clips)}")
        return clips[name]

    @_readable
    def _about(self, name: str) -> dict:
        return _about(self._clip(name))


@dataclasses.dataclass(frozen=True)
class Key:
    """What a clip was measured from and how.

    Parameters
    ----------
    source_sha256 : of the content; empty where it could not be read
    settings_sha256 : of the method, its settings, the part of the video and all versions
    seen : short hash of names, sizes and times of change of the files
    failed : it could not be measured
    lasting : the same content would give the same again
    """

    source_sha256: str
    settings_sha256: str
    seen: str
    failed: bool = False
    lasting: bool = True


def store_of_clip(clip: Clip, profile: Profile, key: Key) -> bytes:
    """The bytes of a store of one clip."""

    def fill(file: h5py.File) -> None:
        group = _new_group(file, "clips", clip, key)
        for kind, table in (("frames", profile.frames), ("openings", profile.openings)):
            columns = group.create_group(kind)
            for name in table.columns:
                _put(columns, name, _column(table[name], name))
        _put_text(group, "provenance", _json(profile.meta))

    return _in_memory(fill)


def store_of_failure(clip: Clip, reason: str, key: Key) -> bytes:
    """The bytes of a store that says of one clip why it could not be measured."""

    def fill(file: h5py.File) -> None:
        group = _new_group(file, "failed", clip, key)
        group.attrs["lasting"] = np.uint8(key.lasting)
        _put_text(group, "reason", reason)

    return _in_memory(fill)


def write_store(
    path: Path, parts: Mapping[str, Path], clips: Iterable[Clip] = (), seen: Mapping[str, str] | None = None
) -> None:
    """Write a store to `path`, which must not be there: the clip of each name out of its part.

    Parameters
    ----------
    parts : paths of stores, by name of the clip to be taken from it, measured or failed
    clips : what is said of the clips now, where it should replace what the part says
    seen : the same for `Key.seen`
    """
    now = {clip.name: _json_about(clip) for clip in clips}
    uses = Counter(parts.values())
    with h5py.File(path, "w-") as file, ExitStack() as stack:
        _put_meta(file)
        groups = {kind: file.create_group(kind) for kind in ("clips", "failed")}
        often = {part: stack.enter_context(Store(part)) for part, n in uses.items() if n > 1}
        for name in sorted(parts):
            with nullcontext(often[parts[name]]) if parts[name] in often else Store(parts[name]) as part:
                kind = "clips" if name in part._group("clips") else "failed"
                source, group = part._file[kind][name], groups[kind].create_group(name)
                for key, value in source.attrs.items():
                    group.attrs[key] = np.bytes_(seen[name]) if key == "seen" and seen and name in seen else value
                for child in source:  # what is replaced leaves no hole, so the bytes do not tell that it was
                    if child == "about":
                        _put_text(group, child, now.get(name) or _text(source[child]))
                    else:
                        part._file.copy(source[child], group, child)


def about_differs(store: Store, clip: Clip) -> bool:
    """Whether a store says something else of a clip than the clip itself."""
    kind = "clips" if clip.name in store._group("clips") else "failed"
    return _text(store._file[kind][clip.name]["about"]) != _json_about(clip)


def check_name(name: str) -> None:
    """Raise InputError for a name that no group of HDF5 can have."""
    if name == "." or "\0" in name:
        raise InputError(f"expected a name of a clip that can stand in a store, got {name!r}; rename it")


# -- the file ----------------------------------------------------------------------------------------------------------


def _open(path: Path) -> h5py.File:
    if not path.is_file():
        what = "a folder" if path.is_dir() else "no such file"
        raise InputError(f"expected a store that 'lipmetrics corpus run' wrote, got {path}: {what}")
    try:
        return h5py.File(path, "r", locking=False)  # never changed in place, so there is nothing to wait for
    except OSError:
        raise InputError(
            f"expected a store that 'lipmetrics corpus run' wrote, got {path}, which is no HDF5 file or is damaged"
        ) from None


def _checked_version(file: h5py.File, path: Path) -> int:
    attributes = file["meta"].attrs if "meta" in file else {}
    found = attributes.get("format", b"")
    if found != FORMAT.encode():
        raise InputError(f"expected a store that 'lipmetrics corpus run' wrote, got {path}, another kind of HDF5 file")
    version = int(attributes["version"])
    if version > VERSION:
        writer = attributes.get("lipmetrics", b"?").decode()
        raise InputError(
            f"expected a store of format {VERSION} or older, got format {version} in {path}, which lipmetrics {writer} "
            "wrote; update lipmetrics"
        )
    return version


def _in_memory(fill: Callable[[h5py.File], None]) -> bytes:
    with h5py.File("part", "w", driver="core", backing_store=False) as file:
        _put_meta(file)
        fill(file)
        file.flush()
        return file.id.get_file_image()


@lru_cache(maxsize=1)
def _our_version() -> str:
    from importlib.metadata import version

    return version("lipmetrics")


def _put_meta(file: h5py.File) -> None:
    meta = file.create_group("meta")
    meta.attrs["format"] = np.bytes_(FORMAT)
    meta.attrs["version"] = np.int32(VERSION)
    meta.attrs["lipmetrics"] = np.bytes_(_our_version())


def _new_group(file: h5py.File, kind: str, clip: Clip, key: Key) -> h5py.Group:
    group = file.create_group(f"{kind}/{clip.name}")
    for name in ("source_sha256", "settings_sha256", "seen"):
        group.attrs[name] = np.bytes_(getattr(key, name))
    _put_text(group, "about", _json_about(clip))
    return group


def _json_about(clip: Clip) -> str:
    words = [dataclasses.asdict(word) for word in clip.words]
    return _json({"fields": dict(clip.fields), "start_s": clip.start_s, "stop_s": clip.stop_s, "words": words})


def _json(value) -> str:
    return json.dumps(without_nan(value), ensure_ascii=False, allow_nan=False)


def _about(group: h5py.Group) -> dict:
    return json.loads(_text(group["about"]))


def _put_text(group: h5py.Group, name: str, text: str) -> None:
    _put(group, name, np.frombuffer(text.encode(), np.uint8))


def _put(group: h5py.Group, name: str, values: np.ndarray) -> None:
    """`group[name] = values`, at a third of the time: there are thirty columns to a clip."""
    kind, space = h5py.h5t.py_create(values.dtype, logical=True), h5py.h5s.create_simple(values.shape)
    plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plan.set_obj_track_times(False)
    dataset = h5py.h5d.create(group.id, name.encode(), kind, space, plan)
    dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, np.ascontiguousarray(values))


def _values(dataset: h5py.Dataset) -> np.ndarray:
    """A data set's values, if it is not much larger than what the file holds of it: what is declared costs nothing."""
    if not isinstance(dataset, h5py.Dataset) or dataset.shape is None:
        raise ValueError(f"no values in {getattr(dataset, 'name', dataset)}")
    if dataset.nbytes > MOST_SHRUNK * dataset.id.get_storage_size() + 1e5:
        raise ValueError(f"{dataset.name} declares {dataset.nbytes} bytes and holds {dataset.id.get_storage_size()}")
    return dataset[()]


def _text(dataset: h5py.Dataset) -> str:
    return _values(dataset).tobytes().decode()


def _column(values: pd.Series, name: str) -> np.ndarray:
    """A column as it is stored: codes for words, NaN where unknown."""
    if name in _CODES:
        return np.array([_CODES[name][word] for word in values], "u1").view(_ENUMS[name])
    if name == "parents":
        longest = max((len(text) for text in values), default=0)
        return np.array(values.tolist(), f"S{max(1, longest)}")
    return values.to_numpy(_WHOLE.get(name, "float64"), na_value=np.nan) if name not in _WHOLE else values.to_numpy()


def _table(group: h5py.Group, columns: Collection[str]) -> pd.DataFrame:
    table = {}
    for name in columns:
        values = _values(group[name])
        if name in _CODES:
            words = np.array(list(_CODES[name]), object)
            table[name] = pd.Series(words[values], dtype=str)
        elif name == "parents":
            table[name] = pd.Series([text.decode() for text in values.tolist()], dtype=str)
        elif name == "n_openings":
            table[name] = pd.array(values, dtype="Int64") if len(values) else pd.array([], dtype="Int64")
        else:
            table[name] = values
    return pd.DataFrame(table)


def _fits(value, wanted) -> bool:
    if isinstance(wanted, Collection) and not isinstance(wanted, str):
        return value in wanted
    return value == wanted


def flush_to_disk(path: Path) -> None:
    """Wait until a file is on the disk, for what it was made of is about to be deleted."""
    with open(path, "rb+") as file:
        os.fsync(file.fileno())
