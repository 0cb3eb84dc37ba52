"""Memory of exactly the asked size for C to read and write, so that a sanitizer sees one byte too many."""

from typing import Any
from weakref import WeakKeyDictionary

from host.native import ffi

POISONS = (0xA5, 0x5A)


# A struct of cffi does not keep alive what its pointers point to.
_memory_of: WeakKeyDictionary[Any, Any] = WeakKeyDictionary()


class Bytes:
    """A bytes_t of `data` (`.view`) and the memory behind it, which lives as long as either."""

    def __init__(self, data: bytes) -> None:
        self.memory = ffi.new("uint8_t[]", len(data))
        ffi.buffer(self.memory)[:] = data
        self.view = ffi.new("bytes_t *", (self.memory, len(data)))[0]
        _memory_of[self.view] = self.memory


class Room:
    """A bytes_mut_t of `size` bytes (`.view`), filled with `poison`."""

    def __init__(self, size: int, poison: int = POISONS[0]) -> None:
        self.memory = ffi.new("uint8_t[]", size)
        ffi.buffer(self.memory)[:] = bytes([poison]) * size
        self.view = ffi.new("bytes_mut_t *", (self.memory, size))[0]

    def __bytes__(self) -> bytes:
        return bytes(ffi.buffer(self.memory))


def poisoned(c_type: str, poison: int) -> Any:
    """A new `c_type *` whose every byte is `poison`."""
    pointer = ffi.new(f"{c_type} *")
    ffi.buffer(pointer)[:] = bytes([poison]) * ffi.sizeof(c_type)
    return pointer


def untouched(pointer: Any, poison: int) -> bool:
    return set(bytes(ffi.buffer(pointer))) == {poison}


def seen(view: Any) -> bytes:
    """What a bytes_t shows."""
    return bytes(ffi.buffer(view.data, view.size)) if view.size else b""
