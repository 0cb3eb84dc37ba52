"""What a format of the wires is for the tests: how the C does it, how the specification does it, what it can hold."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from construct import ConstructError
from hypothesis import strategies as st

from host.native import ffi

Values = dict[str, Any]


@dataclass(frozen=True)
class Format:
    name: str
    values: st.SearchStrategy[Values]
    build: Callable[[Values], bytes]
    """By the specification."""
    parse: Callable[[bytes], tuple[Values, int] | None]
    """By the specification: values and bytes used, or None when it refuses."""
    encode: Callable[[Values, Any, int], int]
    """By the C, into a buffer of that size: bytes written."""
    decode: Callable[..., int]
    """The C function: a bytes_t and then `outputs`."""
    outputs: tuple[str, ...]
    read: Callable[[list[Any], int], Values]
    """The values in `outputs`; the int is what `decode` returned."""
    needed: int | None = None
    """Bytes from which on a truncated message is a shorter message; None: it never is."""
    repair: Callable[[bytes], bytes] = bytes
    """Makes the check of random bytes match, so that more than the check is tried."""

    def __str__(self) -> str:
        return self.name


def plain(container: Any, names: list[str]) -> Values:
    return {name: container[name] for name in names}


def parsed(spec: Any, data: bytes, take: Callable[[Any], Values]) -> tuple[Values, int] | None:
    stream = io.BytesIO(data)
    try:
        return take(spec.parse_stream(stream)), stream.tell()
    except ConstructError:
        return None


def field_names(ctype: str) -> list[str]:
    return [name for name, _ in ffi.typeof(ctype).fields]


def new_outputs(format_: Format, poison: int) -> list[Any]:
    """The outputs of `decode`, every byte of them set to `poison`."""
    made = [ffi.new(kind) for kind in format_.outputs]
    for each in made:
        room = ffi.buffer(each)
        room[:] = bytes([poison]) * len(room)
    return made


def decode(format_: Format, data: bytes) -> tuple[Values, int] | None:
    """What the C makes of `data`, like Format.parse. AssertionError when it refuses and has still written."""
    outputs = new_outputs(format_, 0xA5)
    before = [ffi.buffer(each)[:] for each in outputs]
    # A block of its own and of this very size: the address sanitizer then sees a read beyond it.
    memory = ffi.new("uint8_t[]", len(data))
    ffi.buffer(memory)[:] = data
    view = ffi.new("bytes_t *", (memory, len(data)))
    used = format_.decode(view[0], *outputs)
    if used < 0:
        assert [ffi.buffer(each)[:] for each in outputs] == before, f"refused ({used}), but the output is touched"
        return None
    return format_.read(outputs, used), used


def encode(format_: Format, values: Values, poison: int) -> bytes:
    """What the C writes into a buffer full of `poison`. AssertionError when it writes beyond what it says."""
    room = 4200
    buffer = ffi.new("uint8_t[]", bytes([poison]) * room)
    used = format_.encode(values, buffer, room)
    written = ffi.buffer(buffer)[:room]
    assert written[used:] == bytes([poison]) * (room - used)
    return bytes(written[:used])
