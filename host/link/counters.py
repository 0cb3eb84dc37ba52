"""What a session has counted, and why frames are lost."""

from __future__ import annotations

from dataclasses import dataclass, field, fields


@dataclass(slots=True)
class SessionCounters:
    """Everything that a session has counted since it began. A copy: reading it later gives later figures."""

    bytes: int = 0
    packets: dict[str, int] = field(default_factory=dict)
    """By function: system, console, crtp, wifi_ctrl, app, streamer, test, bootloader."""
    frames: int = 0
    frames_lost: dict[str, int] = field(default_factory=dict)
    """By cause: a key of LOSS_CAUSES. Each lost frame is in exactly one; only `unexplained` may shrink, when the
    ESP32's next status explains it."""
    garbage_bytes: int = 0
    cut_bytes: int = 0
    """Of garbage_bytes: the beginning of a packet whose rest never came, as the connection, or a recording, ended."""
    bad_version: int = 0
    unknown_function: int = 0
    stray_packets: int = 0
    """Pieces of images whose frame is lost already."""
    bad_messages: int = 0
    """Messages of the native dialect and of NanoCockpit that cannot be decoded."""
    renumbered: int = 0
    """Native frame numbers began anew or jumped: the GAP8 has restarted, or had taken this host for gone. What was
    lost there is not known."""
    stamps: int = 0
    pairs: int = 0
    pairs_lost: int = 0
    """By the GAP8 since the first report, or here because no frame came that could carry them."""
    bad_check: int = 0
    """Packets (CPX over UART) or stamp messages with a wrong checksum."""
    bad_length: int = 0
    """CPX over UART: a length byte out of range."""
    credits: int = 0
    """CPX over UART: heard from the other end."""
    gaps: int = 0
    """CPX over UART: packets that stopped half-way."""

    def __add__(self, other: SessionCounters) -> SessionCounters:
        """Of two connections together."""
        total = SessionCounters()
        for each in fields(self):
            mine, theirs = getattr(self, each.name), getattr(other, each.name)
            if isinstance(mine, dict):
                setattr(total, each.name, {key: mine.get(key, 0) + theirs.get(key, 0) for key in {**mine, **theirs}})
            else:
                setattr(total, each.name, mine + theirs)
        return total


LOSS_CAUSES = {
    "cut_short": "not native: the next frame began before this one was complete",
    "overrun": "a piece reached beyond the size that the header announced",
    "missing_data": "native: pieces of it, or its header, never came",
    "bad_crc": "native, NanoCockpit: all came, and the CRC-32 does not match",
    "bad_jpeg": "all came, and it does not start and end as a JPEG does",
    "garbage": "not native: garbage in the middle of it",
    "disconnected": "the connection ended",
    "gap8_unsent": "captured and never sent, says the GAP8",
    "esp32_dropped": "dropped whole because the connection was too slow, says the ESP32",
    "unexplained": "its number was skipped and nobody has said why",
}
