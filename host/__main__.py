"""The command, as `python -m host` and as the console scripts `host` and `spindeck`."""

from __future__ import annotations

import os
import signal
import sys

TYPE_CHECKING = False  # typing takes time to load, and Ctrl-C shall be in good hands before that
if TYPE_CHECKING:
    from types import FrameType


def interrupted(number: int, frame: FrameType | None) -> None:
    """Ctrl-C while modules are loaded ends at once: nothing is open yet, and import would print where it was, or even
    take the exception for its own."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            os._exit(130)
        frame = frame.f_back
    raise KeyboardInterrupt


def open_standard_streams() -> None:
    """Those that the caller has closed lead nowhere: no file that is opened later gets their numbers, and what is
    printed is in nobody's way."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(number)
    sys.stdin = sys.stdin or os.fdopen(0, closefd=False)
    sys.stdout = sys.stdout or os.fdopen(1, "w", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, "w", closefd=False)


def main() -> int:
    """Its exit code."""
    open_standard_streams()
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupted)
    try:
        from .cli import main as run

        return run()
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
