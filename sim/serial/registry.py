"""Which simulators run on this computer: a small file for each, in a folder of the user's own.

A file is removed when its simulator ends; one whose process has died without that is recognised, and removed by
whoever looks next.
"""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

Simulator = dict[str, Any]
"""pid, scenario, and robots: a list of {"port": URL, "wire": "tcp" | "uart2" | "uart1", "firmware": name,
"backends": {MCU: "native" | "emulated"}}."""


def folder() -> Path:
    """Not necessarily there yet."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime:
        return Path(runtime) / "spindeck"
    user = os.getuid() if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")
    return Path(tempfile.gettempdir()) / f"spindeck-{user}"


@contextlib.contextmanager
def entered(scenario: str, robots: Sequence[dict[str, Any]]) -> Iterator[None]:
    """This process serves these robots, for as long as the `with` lasts. A folder that cannot be written is no reason
    not to serve."""
    path = None
    with contextlib.suppress(OSError):
        folder().mkdir(mode=0o700, parents=True, exist_ok=True)
        file, name = tempfile.mkstemp(suffix=".part", prefix=f"{os.getpid()}-", dir=folder())
        with os.fdopen(file, "w", encoding="utf-8") as out:
            json.dump({"pid": os.getpid(), "born": _born(os.getpid()), "scenario": scenario, "robots": robots}, out)
        path = Path(name).with_suffix(".json")  # under this name only when complete
        Path(name).replace(path)
    try:
        yield
    finally:
        if path is not None:
            path.unlink(missing_ok=True)


def running() -> list[Simulator]:
    """Those that are alive, the oldest process number first."""
    found = []
    for path in sorted(folder().glob("*.json")):
        try:
            simulator = json.loads(path.read_text(encoding="utf-8"))
            alive = _alive(int(simulator["pid"]), simulator["born"])
        except (OSError, ValueError, KeyError, TypeError):
            alive = False
        if alive:
            found.append({key: simulator[key] for key in ("pid", "scenario", "robots")})
        else:
            with contextlib.suppress(OSError):
                path.unlink()
    return sorted(found, key=lambda simulator: int(simulator["pid"]))


def _alive(pid: int, born: str) -> bool:
    if os.name != "posix":
        return True  # there os.kill ends a process, whatever the signal
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass  # alive, and somebody else's
    return _born(pid) == born


def _born(pid: int) -> str:
    """When the process began, in the system's own terms: numbers of processes are used again. Empty: not known."""
    try:
        # Behind the command's name, which is in parentheses and may contain anything.
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[19]
    except (OSError, IndexError):
        return ""
