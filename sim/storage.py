"""The kernel's storage port in Python: each request of an STM32 goes to its store, as its card."""

from __future__ import annotations

from typing import Any, Protocol

from host.native import ffi, lib


class Store(Protocol):
    """Takes requests of firmware/stm32/storage.h. All its chance comes from its own seed. One that is given to two
    robots may be called by two threads at a time."""

    def request(self, request: bytes, true_ns: int) -> tuple[bytes, int]:
        """The answer, and how long the operation takes in ns."""

    def cut(self, true_ns: int) -> None:
        """The power has gone: what is under way is cut now."""


class Storage:
    """Binds a store to a robot; lives as long as the kernel."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self.error: BaseException | None = None
        """Of the store: an exception cannot pass through C."""
        self.handle: Any = ffi.new_handle(self)

    def answer(self, request: bytes, now_ns: int) -> tuple[bytes, int]:
        if self.error is not None:
            return b"", 0
        try:
            if request:
                return self.store.request(request, now_ns)
            self.store.cut(now_ns)
        except BaseException as error:  # Raised again when the kernel has returned.
            self.error = error
        return b"", 0

    def raise_error(self) -> None:
        if self.error is not None:
            error, self.error = self.error, None
            raise error


@ffi.def_extern()  # type: ignore[untyped-decorator, unused-ignore]
def storage_request(context: Any, now_ns: int, request: Any, size: int, answer: Any, answer_size: Any) -> int:
    storage = ffi.from_handle(context)
    data, duration_ns = storage.answer(bytes(ffi.buffer(request, size)) if size else b"", now_ns)
    ffi.buffer(answer, lib.STORAGE_ANSWER_MAX)[: len(data)] = data
    answer_size[0] = len(data)
    return int(duration_ns)
