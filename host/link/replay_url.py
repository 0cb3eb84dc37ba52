"""replay:// URLs, read and written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qsl, quote, unquote, urlencode

from ..protocol.errors import LocalError
from ..protocol.typed import integer, real


def number(read: Callable[[str], float], least: float) -> Callable[[str], Any]:
    def parse(text: str) -> float:
        value = read(text)
        if not least <= value < 1e9:
            raise ValueError
        return value

    return parse


KEYS: dict[str, tuple[Callable[[str], Any], str]] = {
    "rate": (number(real, 1e-3), "a number from 0.001 and below 1e9, 1 is as fast as it was"),
    "loop": ({"0": False, "1": True}.__getitem__, "0 or 1"),
    "start": (number(real, 0), "seconds from the beginning"),
    "robot": (number(integer, 0), "the number of a robot in the recording"),
    "pace": ({"real": "real", "max": "max"}.__getitem__, "real or max"),
}


@dataclass(frozen=True)
class Choice:
    """What a URL asks for."""

    path: str
    rate: float = 1.0
    loop: bool = False
    start: float = 0.0
    robot: int | None = None
    pace: str = "real"


def from_url(url: str) -> Choice:
    """LocalError when it is none."""
    path, _, query = url.partition("://")[2].partition("?")
    values: dict[str, Any] = {}
    for key, value in parse_qsl(query, keep_blank_values=True):
        if key not in KEYS:
            raise LocalError(f"{url}: no key {key!r}; there are {', '.join(KEYS)}")
        parse, allowed = KEYS[key]
        try:
            values[key] = parse(value)
        except (ValueError, KeyError) as error:
            raise LocalError(f"{url}: {key}={value}: {allowed}") from error
    if not path:
        raise LocalError(f"{url}: write replay://FILE")
    return Choice(unquote(path), **values)


def to_url(path: str, **values: object) -> str:
    """The URL of a recording with these keys."""
    return f"replay://{quote(path)}?{urlencode(values)}"
