"""Where bytes come from: sockets, serial devices, simulated robots and recordings, all read and written alike."""

from __future__ import annotations

import errno
import socket
import sys
import time
from collections.abc import Callable
from typing import Any, Protocol, cast
from urllib.parse import quote, urlsplit

from ..protocol.errors import LocalError, NotThereError
from .access import is_device, why
from .dialects import Dialect
from .session import FRAMINGS, Framing

POLL_S = 0.1
"""A read waits this long at most, so that Ctrl-C, close() and repeated requests are never held up."""
CONNECT_S = 5.0
ABSENT = frozenset({errno.ENOENT, errno.ECONNREFUSED, errno.EHOSTUNREACH, errno.ENETUNREACH, errno.ETIMEDOUT})
"""What the system says of a robot that is off, and of an adapter that is not plugged in."""
ALONE = "An AI-deck serves one client at a time: is another program connected to it?"
RECEIVE_BYTES = 1 << 18
TCP_PORT = 5000
HANDLERS = ("sim.serial", "host.link.serial")
"""Where pyserial finds sim:// and replay://."""
BAUD: dict[str, int] = {"cpx-uart": 576_000, "stamps": 115_200, "tcp": 576_000}


class Port(Protocol):
    """One open connection."""

    url: str
    framing: Framing
    world: Any
    """The simulated world behind it, or None."""
    robot: Any
    """Which robot of that world."""
    baud: int | None
    """Of a serial line; None: there is none in between that could be wrong."""
    ended: str
    """Why the last read said that it was the end; empty when a recording is over."""

    @property
    def seam(self) -> str:
        """Of a replay: what begins anew with the next read, "connection" or "loop"; empty after any other read."""

    def read(self, wanted: int) -> bytes | memoryview | None:
        """What has come: valid until the next read. None: nothing for POLL_S. Empty: nothing ever will again.
        A slow line waits until there are `wanted` bytes, or less after POLL_S, a simulated one 5 ms; TCP does not. More
        are taken if they are there."""

    def write(self, data: bytes) -> None:
        """Sends, or keeps what the line does not take now until the next call."""

    def clock_ns(self) -> int:
        """Monotonic; of a simulated port its true time."""

    def close(self) -> None:
        """At once, and for good."""


class SocketPort:
    """The robot's TCP server. Reads go into one buffer that is used again: no allocation, and it stays in the cache."""

    world = None
    robot = None
    baud: int | None = None
    seam = ""

    def __init__(self, url: str) -> None:
        self.url = url
        self.framing: Framing = "tcp"
        self.ended = ""
        self._socket = connect(url)
        self._buffer = memoryview(bytearray(RECEIVE_BYTES))
        self._unsent = b""
        self._heard = False

    def read(self, wanted: int) -> memoryview | None:
        try:
            size = self._socket.recv_into(self._buffer)
        except TimeoutError:
            return None
        except OSError as error:
            self.ended = f"the connection broke: {error.strerror}"
            return self._buffer[:0]
        if not size:
            self.ended = "closed by the robot" if self._heard else f"closed by the robot before a byte came. {ALONE}"
        self._heard = True
        return self._buffer[:size]

    def write(self, data: bytes) -> None:
        self._unsent += data
        try:
            self._unsent = self._unsent[self._socket.send(self._unsent) :]
        except TimeoutError:
            return
        except OSError:
            # A broken connection is the next read's news, behind what has come before it broke.
            self._unsent = b""

    def clock_ns(self) -> int:
        return time.monotonic_ns()

    def close(self) -> None:
        self._socket.close()


class AbsentPort:
    """A connection that is not there yet: it has ended before it began."""

    world = None
    robot = None
    baud: int | None = None
    seam = ""

    def __init__(self, url: str, framing: Framing, why_not: str) -> None:
        self.url = url
        self.framing = framing
        self.ended = why_not

    def read(self, wanted: int) -> bytes:
        return b""

    def write(self, data: bytes) -> None:
        """Nobody is there."""

    def clock_ns(self) -> int:
        return time.monotonic_ns()

    def close(self) -> None:
        """Nothing was opened."""


class SerialPort:
    """Whatever pyserial opens, simulated robots included."""

    def __init__(self, url: str, port: Any, framing: Framing, baud: int) -> None:
        self.url = url
        self.framing = framing
        self.ended = ""
        self.world = getattr(port, "world", None)
        self.baud: int | None = None if hasattr(port, "clock_ns") else baud
        self.robot = getattr(port, "robot", None)
        self.epoch_ns: int | None = getattr(port, "epoch_ns", None)
        """Of a replay: what its recording added to clock_ns() to get dates."""
        self.dialect: Dialect = getattr(port, "dialect", "auto")
        """Of a replay: the one that it was recorded with."""
        self.clock_ns: Callable[[], int] = getattr(port, "clock_ns", time.monotonic_ns)
        self._port = port
        self._read_some: Callable[[int], bytes] = getattr(port, "read_some", self._read_and_look)
        self._unsent = b""
        if hasattr(port, "tell_seams"):
            port.tell_seams()

    @property
    def seam(self) -> str:
        return getattr(self._port, "seam", "")

    def _read_and_look(self, wanted: int) -> bytes:
        data: bytes = self._port.read(1 if self.framing == "tcp" else wanted)
        waiting = self._port.in_waiting if data else 0
        return data + self._port.read(waiting) if waiting else data

    def read(self, wanted: int) -> bytes | None:
        from serial import SerialException

        try:
            data = self._read_some(wanted)
        except (SerialException, OSError) as error:
            self.ended = "" if getattr(self._port, "over", False) else str(error)
            return b""
        return data or None

    def write(self, data: bytes) -> None:
        from serial import SerialException, SerialTimeoutException

        self._unsent += data
        try:
            sent = self._port.write(self._unsent)
            self._unsent = self._unsent[len(self._unsent) if sent is None else sent :]
        except SerialTimeoutException:
            return
        except (SerialException, OSError):
            # As on a socket: the next read says so.
            self._unsent = b""

    def close(self) -> None:
        self._port.close()


def connect(url: str) -> socket.socket:
    """A TCP connection to what a socket:// URL names."""
    try:
        parts = urlsplit(url)
        address = (parts.hostname or "", TCP_PORT if parts.port is None else parts.port)
    except ValueError as error:
        raise LocalError(f"{url}: {error}; write socket://ADDRESS:PORT") from error
    if not address[0] or not address[1] or parts.path not in ("", "/") or parts.query:
        raise LocalError(f"{url}: write socket://ADDRESS:PORT")
    try:
        made = socket.create_connection(address, timeout=CONNECT_S)
    except ConnectionRefusedError as error:
        raise NotThereError(
            f"{url}: connection refused: something is at {address[0]}, and nothing listens on port {address[1]}. "
            "Is the AI-deck's Wi-Fi firmware running?"
        ) from error
    except (socket.gaierror, UnicodeError) as error:
        raise LocalError(f"{url}: no such address: {getattr(error, 'strerror', 'no name is like that')}") from error
    except OSError as error:
        absent = isinstance(error, TimeoutError) or error.errno in ABSENT
        raise (NotThereError if absent else LocalError)(
            f"{url}: {address[0]} cannot be reached ({error.strerror or error}). "
            "Is the robot on, and is this computer in its Wi-Fi network?"
        ) from error
    made.settimeout(POLL_S)
    made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return made


def open_port(url: str, baud: int | None = None, framing: str | None = None, camera: str | None = None) -> Port:
    """Opens any pyserial URL, or socket://ADDRESS:PORT with our own reading. LocalError says why it cannot be.

    What the bytes are follows from the port: TCP's framing on socket://, CPX over UART on serial ports, what a
    simulated port says of itself; `framing` overrides. `camera` is for the simulator: pictures for it to see.
    """
    if framing is not None and framing not in FRAMINGS:
        raise LocalError(f"framing {framing!r}: choose {', '.join(FRAMINGS)}")
    if not url:
        raise LocalError("no port is named: 'host ports' lists what there is, and sim://hover is a simulated robot")
    scheme = url.partition("://")[0].lower() if "://" in url else ""
    if camera is not None:
        if scheme != "sim":
            raise LocalError(f"{url}: only a simulated robot (sim://…) can be given pictures to see")
        url += f"{'&' if '?' in url else '?'}camera_path={quote(camera, safe='/')}"
    chosen = framing_of(url, framing)
    if scheme == "socket":
        port = SocketPort(url)
        port.framing = chosen
        return port
    baud = baud or BAUD[chosen]
    opened = open_serial(url, scheme, baud)
    own = getattr(opened, "framing", None)
    if own is not None and framing is not None and own != framing:
        opened.close()
        raise LocalError(f"{url} carries {own}, not {framing}: leave the framing out")
    return SerialPort(url, opened, own or chosen, baud)


def framing_of(url: str, told: str | None) -> Framing:
    """What the bytes are on a port that does not say so itself."""
    return cast(Framing, told or ("tcp" if url.lower().startswith("socket://") else "cpx-uart"))


def open_serial(url: str, scheme: str, baud: int) -> Any:
    """Through pyserial, with errors that say what to do."""
    import serial

    for package in HANDLERS:
        if package not in serial.protocol_handler_packages:
            serial.protocol_handler_packages.append(package)
    if scheme == "rfc2217" and not urlsplit(url).netloc.rpartition(":")[2].isdecimal():
        raise LocalError(f"{url}: write rfc2217://ADDRESS:PORT")
    # Two readers on one device would each get half of the bytes.
    alone = {} if scheme or sys.platform == "win32" else {"exclusive": True}
    try:
        return serial.serial_for_url(url, baudrate=baud, timeout=POLL_S, write_timeout=POLL_S, **alone)
    except OSError as error:  # pyserial's own are such, with the system's number or behind them
        number = error.errno or getattr(error.__context__, "errno", None)
        absent = number in ABSENT and (number != errno.ENOENT or is_device(url))
        raise (NotThereError if absent else LocalError)(f"{url}: {why(error, url)}") from error
    except ValueError as error:
        if "not known" not in str(error):
            raise LocalError(f"{url}: {error}") from error
        if scheme == "sim":
            raise LocalError(
                f"{url}: the simulator cannot be loaded; this says why: python -c 'import sim.serial.protocol_sim'"
            ) from error
        if scheme == "radio":
            raise LocalError(f"{url}: a Crazyradio brings no images: it is for 'host sync beacons'") from error
        raise LocalError(
            f"{url}: {scheme}:// is not known. Use socket://ADDRESS:PORT, sim://SCENARIO, replay://FILE, "
            "rfc2217://ADDRESS:PORT, or a serial device such as /dev/ttyUSB0 or COM3"
        ) from error
