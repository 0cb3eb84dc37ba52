"""What `host usd info` says of the image of a card."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ..usd.cardimage import CardImage


def as_record(name: str, card: CardImage) -> dict[str, Any]:
    """For a program."""
    return {
        "event": "card",
        "file": name,
        "fat": card.volume.boot.bits,
        "files": [{"path": each.path, "size": each.size, "log": card.is_log(each)} for each in files(card)],
        "faults": card.faults,
    }


def info_lines(name: str, card: CardImage) -> Iterator[str]:
    """For people."""
    found = files(card)
    yield f"{name}: a card with FAT{card.volume.boot.bits}, {len(found)} files"
    wide = max((len(each.path) for each in found), default=0)
    for each in found:
        yield f"  {each.path:{wide}} {each.size:>12} bytes{', a log' * card.is_log(each)}"
    yield from (f"  fault     {fault}" for fault in card.faults)
    if log := next((each for each in found if card.is_log(each)), None):
        yield f"  next      host usd info {name}:{log.path}"


def files(card: CardImage) -> list[Any]:
    return [each for each in card.files if not each.is_folder]
