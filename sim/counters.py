"""What is counted in a robot, by the names in the structs of C."""

from __future__ import annotations

import functools
from typing import Any, get_args

from host.link.records import LogState

UART2 = [
    *["uart2.packets_in", "uart2.packets_out", "uart2.credits_in", "uart2.credits_repeated", "uart2.bad_check"],
    *["uart2.bad_length", "uart2.bad_version", "uart2.garbage_bytes", "uart2.gaps"],
]
APPS = {
    "stm32": ["stamps_sent", "stamps_late", "packets_dropped", "packets_unknown", "crtp_ignored", *UART2],
    "gap8": [
        *["frame", "frames_sent", "frames_unsent", "captures_failed", "captures_late"],
        *["stamp_rx.received", "stamp_rx.bad_check", "stamp_rx.garbage_bytes", "stamps_missed", "pairs_lost"],
        *["spi_errors", "packets_dropped", "packets_unknown", "requests_refused"],
    ],
    "esp32": [
        *["frames_forwarded", "frames_dropped", "frames_cut", "frames_unasked", "packets_forwarded"],
        *["packets_dropped", "packets_unroutable", "packets_unsent", "spi_errors", "wifi_refused", "gap8_resets"],
        *[*UART2, "tcp_rx.packets_in", "tcp_rx.skipped_bytes"],
    ],
}
"""Of firmware/*/app.h; a dot becomes an underscore."""
LOG_STATES: tuple[LogState, ...] = get_args(LogState)
LOG = {
    "status": "log.status",
    "files": "log.files",
    "config_errors": "log.config.errors",
    "config_warnings": "log.config.warnings",
    **{
        name: f"log.log.counters.{name}"
        for name in ("requested", "accepted", "dropped", "stall_us", "syncs", "errors", "session")
    },
}
WIRE = ["bytes", "units", "lost", "duplicated", "reordered", "dropped", "flipped", "stalls", "overflowed"]


def read(struct: Any, names: list[str]) -> dict[str, int]:
    return {name.replace(".", "_"): int(functools.reduce(getattr, name.split("."), struct)) for name in names}
