"""Copies of built images in a folder of the user's."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

from ..protocol.errors import LocalError
from .build import Image

NOTE = "spindeck-firmware.json"
"""Which files there are ours: their names and what was written. Anything else is left alone."""


def export(image: Image, folder: Path) -> list[Path]:
    """Writes an image's files there, over those of an earlier build only. LocalError, and nothing written, when a file
    of that name is not ours or has been changed since."""
    try:
        written = note(folder)
        files = {folder / path.name: path for path in image.files}
        for to, made in files.items():
            if to.exists() and digest(to) not in (written.get(to.name), digest(made)):
                raise LocalError(
                    f"{to} is there and is not what 'host firmware build' has written: move it away, or choose another "
                    "folder with --output"
                )
        folder.mkdir(parents=True, exist_ok=True)
        for to, made in files.items():
            shutil.copyfile(made, to)
            written[to.name] = digest(made)
        (folder / NOTE).write_text(json.dumps(written, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    except OSError as error:
        raise LocalError(f"{error.filename or folder}: {error.strerror}") from error
    return list(files)


def note(folder: Path) -> dict[str, str]:
    """What has been written there. LocalError when that file is somebody else's."""
    path = folder / NOTE
    if not path.exists():
        return {}
    try:
        read = json.loads(path.read_text(encoding="utf-8"))
        return {str(name): str(sum_) for name, sum_ in read.items()}
    except (ValueError, AttributeError) as error:
        raise LocalError(f"{path} is not what 'host firmware build' has written: move it away") from error


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
