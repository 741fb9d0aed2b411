"""Files that appear whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from study.errors import InputError


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Give a temporary path beside `path` to write to; rename it to `path` at the end, delete it after an error.

    The folder is made if it does not exist. A reader never sees a half-written `path`: a file that was there
    before stays until the new one is complete.

    Raises
    ------
    InputError : the place cannot be written to (no permission, a file in the folder's place, disk full)
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            part.touch()
            yield part
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(
            f"expected to write {path}, but: {error.strerror or error}; choose another output folder or free some space"
        ) from error
