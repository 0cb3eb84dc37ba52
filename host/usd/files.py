"""A log's bytes from where they are: a file, or a file in the image of a card."""

from __future__ import annotations

import functools
import mmap
import os
import stat
from pathlib import Path

from ..protocol.errors import LocalError, PeerError
from .cardimage import CardImage
from .fat import Fault

INSIDE = ":/"
"""Between a card's image and a file on it: card.img:/log00."""


def read_log(name: str) -> bytes | mmap.mmap:
    """The bytes of a log, mapped if they lie in one piece. LocalError when they cannot be had."""
    image, path = split(name)
    if path:
        card = open_card(image)
        return card.read(card.find(path)).data
    if is_card(name):
        raise LocalError(
            f"{name} is the image of a card: name a log on it, as in {name}:/log00 ('host usd info {name}')"
        )
    return read_file(name)


def card_faults(name: str) -> tuple[Fault, ...]:
    """What is wrong with the card on the way to this log; nothing if it lies on none."""
    image, path = split(name)
    if not path:
        return ()
    card = open_card(image)
    return (*card.faults, *card.read(card.find(path)).faults)


def open_card(name: str) -> CardImage:
    """PeerError: it is no card's image."""
    try:
        return walked(name, identity(name))
    except PeerError as error:
        raise PeerError(f"{name}: {error}") from None


@functools.lru_cache(maxsize=1)
def walked(name: str, identity: tuple[int, ...]) -> CardImage:
    """Once, as long as the image stays as it is: one command asks for several logs on it, and for its faults."""
    return CardImage(read_file(name))


def identity(name: str) -> tuple[int, ...]:
    """What another image of this name would not have; nothing if there is no file, which read_file() explains."""
    try:
        found = Path(name).stat()
    except OSError:
        return ()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def is_card(name: str) -> bool:
    """A pipe is none: it can be read once."""
    if split(name)[1] or not Path(name).is_file():
        return False
    try:
        open_card(name)
    except PeerError:
        return False
    return True


def logs_on(name: str) -> list[str]:
    """The logs on a card, by names for read_log; of anything else its own name."""
    if not is_card(name):
        return [name]
    card = open_card(name)
    if logs := [f"{name}:{each.path}" for each in card.files if card.is_log(each)]:
        return logs
    raise LocalError(f"{name}: no logs on this card; 'host usd info {name}' lists its files")


def split(name: str) -> tuple[str, str]:
    """An image and a path on it; the path is empty if this is a file as it is."""
    image, inside, path = name.partition(INSIDE)
    return (image, "/" + path) if inside and not Path(name).exists() else (name, "")


def read_file(name: str) -> bytes | mmap.mmap:
    try:
        with Path(name).open("rb") as file:
            if stat.S_ISCHR(os.fstat(file.fileno()).st_mode):
                raise LocalError(f"{name}: a device that has no end: name a file")
            try:
                return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            except (ValueError, OSError):
                return file.read()  # Empty, or a pipe: these cannot be mapped.
    except OSError as error:
        raise LocalError(f"{name}: {error.strerror}") from error
