"""What a command makes. A file: complete or not at all, and never over another without being told to. A folder: new or
empty."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from ..protocol.errors import LocalError


@contextmanager
def new_file(path: str | Path, force: bool | None = None) -> Iterator[IO[bytes]]:
    """Under another name until it is complete. LocalError if it exists (without force) or cannot be written. `force`:
    None if the command has no such option: what it keeps cannot be made again."""
    target = Path(path)
    way_out = "name another file" if force is None else "use --force"
    part = target.with_name(f"{target.name}.part")
    try:
        if target.exists() and not force:
            raise LocalError(f"{target}: exists, and is not overwritten: {way_out}")
        if target.exists() and not target.is_file():  # a device would be gone
            raise LocalError(f"{target}: a folder, a pipe or a device: name a file")
        file = part.open("w+b" if force else "x+b")
    except FileExistsError as error:
        raise LocalError(f"{part}: exists, left by a command that was stopped: remove it, or {way_out}") from error
    except OSError as error:
        raise LocalError(f"{target}: {os.strerror(error.errno or 0)}") from error
    try:
        with file:
            yield file
        part.replace(target)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise LocalError(f"{target}: {os.strerror(error.errno or 0)}") from error
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def new_folder(path: str, option: str = "") -> Path:
    """Creates it, or takes an empty one. LocalError otherwise, which begins with `option`."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise LocalError(f"{option}{path}: not empty, and nothing is ever overwritten: name a new folder")
    except (FileExistsError, NotADirectoryError) as error:
        raise LocalError(f"{option}{path}: a file is there: name a new folder") from error
    except OSError as error:
        raise LocalError(f"{option}{path}: {error.strerror}") from error
    return folder
