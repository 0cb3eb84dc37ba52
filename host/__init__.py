"""Time-stamped frames from nano drones: `for frame in host.open("sim://hover"): …`.

Nothing is loaded before it is used, so that `import host` and `host --help` stay quick.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False  # typing takes longer to load than all that is here
if TYPE_CHECKING:
    from typing import Any

    from .link.records import (
        LOSS_CAUSES,
        Announced,
        Console,
        Frame,
        Garbage,
        LogStatus,
        LostFrame,
        NanocockpitHeader,
        NanocockpitStamp,
        NanocockpitState,
        NativeClock,
        NativeEcho,
        NativeHeader,
        Packet,
        PaperHeader,
        PaperStamp,
        Pose,
        Reply,
        SessionCounters,
        Stamp,
        State,
        Status,
    )
    from .link.session import Session
    from .link.stream import Stream
    from .link.stream import open_stream as open  # noqa: A004 - host.open is the name that users know
    from .protocol.errors import ConnectionLostError, LocalError, PeerError, PeerSilentError, SpindeckError
    from .protocol.packets import CameraSettings

_HOME = {
    "open": ("link.stream", "open_stream"),
    "Stream": ("link.stream", "Stream"),
    "Session": ("link.session", "Session"),
    "CameraSettings": ("protocol.packets", "CameraSettings"),
    **{
        name: ("protocol.errors", name)
        for name in ("ConnectionLostError", "LocalError", "PeerError", "PeerSilentError", "SpindeckError")
    },
    **{
        name: ("link.records", name)
        for name in (
            "LOSS_CAUSES",
            "Announced",
            "Console",
            "Frame",
            "Garbage",
            "LogStatus",
            "LostFrame",
            "NanocockpitHeader",
            "NanocockpitStamp",
            "NanocockpitState",
            "NativeClock",
            "NativeEcho",
            "NativeHeader",
            "Packet",
            "PaperHeader",
            "PaperStamp",
            "Pose",
            "Reply",
            "SessionCounters",
            "Stamp",
            "State",
            "Status",
        )
    },
}

__all__ = [
    "LOSS_CAUSES",
    "Announced",
    "CameraSettings",
    "ConnectionLostError",
    "Console",
    "Frame",
    "Garbage",
    "LocalError",
    "LogStatus",
    "LostFrame",
    "NanocockpitHeader",
    "NanocockpitStamp",
    "NanocockpitState",
    "NativeClock",
    "NativeEcho",
    "NativeHeader",
    "Packet",
    "PaperHeader",
    "PaperStamp",
    "PeerError",
    "PeerSilentError",
    "Pose",
    "Reply",
    "Session",
    "SessionCounters",
    "SpindeckError",
    "Stamp",
    "State",
    "Status",
    "Stream",
    "open",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'host' has no attribute {name!r}")
    module, inside = _HOME[name]
    value = getattr(importlib.import_module(f".{module}", __name__), inside)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
