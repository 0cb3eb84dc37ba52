"""Time-stamped frames from nano drones: `for frame in host.open("sim://hover"): …`.

Nothing is loaded before it is used, so that `import host` and `host --help` stay quick.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False  # typing takes longer to load than all that is here
if TYPE_CHECKING:
    from typing import Any

    from .link.counters import LOSS_CAUSES, SessionCounters
    from .link.frame import Frame, LostFrame
    from .link.headers import (
        NanocockpitHeader,
        NanocockpitState,
        NativeClock,
        NativeEcho,
        NativeHeader,
        PaperHeader,
        Pose,
    )
    from .link.records import (
        Announced,
        Console,
        Garbage,
        LogStatus,
        NanocockpitStamp,
        Packet,
        PaperStamp,
        Reply,
        Stamp,
        State,
        Status,
    )
    from .link.session import Session
    from .link.stream import Stream
    from .link.stream import open_stream as open  # noqa: A004 - host.open is the name that users know
    from .protocol.errors import ConnectionLostError, LocalError, PeerError, PeerSilentError, SpindeckError
    from .protocol.packets import CameraSettings

_NAMES = {
    "link.stream": "Stream",
    "link.session": "Session",
    "link.counters": "LOSS_CAUSES SessionCounters",
    "link.frame": "Frame LostFrame",
    "link.headers": "NanocockpitHeader NanocockpitState NativeClock NativeEcho NativeHeader PaperHeader Pose",
    "link.records": "Announced Console Garbage LogStatus NanocockpitStamp Packet PaperStamp Reply Stamp State Status",
    "protocol.errors": "ConnectionLostError LocalError PeerError PeerSilentError SpindeckError",
    "protocol.packets": "CameraSettings",
}
_HOME = {name: (module, name) for module, names in _NAMES.items() for name in names.split()} | {
    "open": ("link.stream", "open_stream")
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
