"""What has left each sender: the kernel's full trace as Python's objects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from host.native import ffi, lib

WIRES = {
    lib.WIRE_UART1: "uart1_to_gap8",
    lib.WIRE_UART1_TO_STM32: "uart1_to_stm32",
    lib.WIRE_UART2_TO_ESP32: "uart2_to_esp32",
    lib.WIRE_UART2_TO_STM32: "uart2_to_stm32",
    lib.WIRE_SPI_TO_ESP32: "spi_to_esp32",
    lib.WIRE_SPI_TO_GAP8: "spi_to_gap8",
    lib.WIRE_TCP_TO_HOST: "tcp_to_host",
    lib.WIRE_TCP_TO_ESP32: "tcp_to_esp32",
}


@dataclass(frozen=True, slots=True)
class Run:
    """Bytes that left back to back, before any fault of the wire (trace_run_t)."""

    robot: int
    wire: str
    local_ns: int
    """When the first one began to leave, on the sender's clock."""
    true_ns: int
    byte_ps: int
    """What one takes, on the sender's clock; on TCP true time."""
    data: bytes


def take(kernel: Any) -> list[Run]:
    """All that have ended since the last call, in the order in which they ended."""
    count, size = ffi.new("size_t *"), ffi.new("size_t *")
    runs = lib.kernel_trace_runs(kernel, count)
    start = lib.kernel_trace_data(kernel, size)
    data = bytes(ffi.buffer(start, size[0])) if size[0] else b""
    taken = [
        Run(
            run.robot,
            WIRES[run.wire],
            run.local_start_ns,
            run.true_start_ns,
            run.byte_ps,
            data[run.offset : run.offset + run.length],
        )
        for run in runs[0 : count[0]]
    ]
    lib.kernel_trace_forget(kernel)
    return taken
