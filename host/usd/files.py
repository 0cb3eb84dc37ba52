"""A log's bytes from where they are."""

from __future__ import annotations

import mmap
from pathlib import Path

from ..protocol.errors import LocalError


def read_log(name: str) -> bytes | mmap.mmap:
    """The bytes of a log, mapped. LocalError when they cannot be had."""
    try:
        with Path(name).open("rb") as file:
            try:
                return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            except (ValueError, OSError):
                return file.read()  # Empty, or a pipe: these cannot be mapped.
    except OSError as error:
        raise LocalError(f"{name}: {error.strerror}") from error
