"""Where clients come in to a served robot: a listening TCP socket, or a pseudo-terminal. Nothing here ever waits, and
nothing here knows of robots."""

from __future__ import annotations

import contextlib
import os
import re
import select
import socket
import time
from typing import Protocol

from host.link.access import not_listening
from host.protocol.errors import LocalError

PORT = 5000
"""The ESP32's."""
PORT_MAX = 65535
SEND_BUFFER_BYTES = 65536
"""TCP_SND_BUF of the real ESP32: what a client does not read soon stands still in the robot, as it really does."""
KEEPALIVE_S = 5
"""Silence after which a client that has vanished is looked for."""
SETTLE_S = 0.2
"""Whoever opens a serial port throws away what had come until then (pyserial does): nothing is sent so soon."""


class Client(Protocol):
    """Somebody who came in."""

    name: str

    def fileno(self) -> int: ...

    def receive(self, size: int) -> bytes | None:
        """None: nothing now. Empty: gone."""

    def send(self, data: memoryview) -> int:
        """How much was taken now. OSError: gone."""

    def close(self) -> None: ...


class Door(Protocol):
    url: str
    """What a client opens."""

    def fileno(self) -> int | None:
        """Readable when somebody may be there; None: nothing tells, look often."""

    def accept(self) -> Client | None:
        """Who has come since, if anybody."""

    def close(self) -> None: ...


class TcpClient:
    def __init__(self, connection: socket.socket, name: str) -> None:
        self.name = name
        self._socket = connection
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in (("TCP_KEEPIDLE", KEEPALIVE_S), ("TCP_KEEPINTVL", KEEPALIVE_S), ("TCP_KEEPCNT", 2)):
            if hasattr(socket, option):
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)

    def fileno(self) -> int:
        return self._socket.fileno()

    def receive(self, size: int) -> bytes | None:
        try:
            return self._socket.recv(size)
        except BlockingIOError:
            return None
        except OSError:
            return b""

    def send(self, data: memoryview) -> int:
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        # Unread input would turn the end of the stream into a reset, which throws away what is still under way.
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)
            while self._socket.recv(SEND_BUFFER_BYTES):
                pass
        self._socket.close()


class TcpDoor:
    def __init__(self, host: str, port: int) -> None:
        """LocalError when nobody can listen there."""
        self._listener = _listen(host, port)
        address = self._listener.getsockname()
        self.host, self.port = str(address[0]), int(address[1])
        here = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.host, self.host)
        self.url = f"socket://{shown(here, self.port)}"

    def fileno(self) -> int:
        return self._listener.fileno()

    def accept(self) -> Client | None:
        try:
            connection, address = self._listener.accept()
        except OSError:
            return None  # nobody, or somebody who has gone again
        return TcpClient(connection, shown(str(address[0]), int(address[1])))

    def close(self) -> None:
        self._listener.close()


class PtyClient:
    def __init__(self, master: int, path: str) -> None:
        self.name = f"a reader of {path}"
        self.left = False
        self._master = master

    def fileno(self) -> int:
        return self._master

    def receive(self, size: int) -> bytes | None:
        if hung_up(self._master):
            return b""
        try:
            return os.read(self._master, size) or None
        except BlockingIOError:
            return None
        except OSError:
            return b""

    def send(self, data: memoryview) -> int:
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Nobody can be sent away from a serial port: who still has it open comes in again."""
        self.left = True


class PtyDoor:
    def __init__(self) -> None:
        """LocalError where there are no pseudo-terminals."""
        try:
            import tty

            self._master, slave = os.openpty()
        except (ImportError, AttributeError, OSError) as error:
            raise LocalError(f"no pseudo-terminal can be made here ({error}): use --listen") from error
        tty.setraw(slave)
        self.url = os.ttyname(slave)
        # From now on the master hangs up whenever nobody has the other side open.
        os.close(slave)
        os.set_blocking(self._master, False)
        self._inside: PtyClient | None = None
        self._opened_s: float | None = None

    def fileno(self) -> None:
        return None

    def accept(self) -> Client | None:
        if hung_up(self._master):
            if self._inside is not None or self._opened_s is not None:
                self._empty()
            self._inside = self._opened_s = None
            return None
        if self._inside is not None and not self._inside.left:
            return None
        now_s = time.monotonic()
        self._opened_s = now_s if self._opened_s is None else self._opened_s
        if now_s - self._opened_s < SETTLE_S and not select.select([self._master], [], [], 0)[0]:
            return None
        self._inside = PtyClient(self._master, self.url)
        return self._inside

    def close(self) -> None:
        os.close(self._master)

    def _empty(self) -> None:
        """What one reader left unread, or wrote last, is nothing for the next one."""
        import termios

        with contextlib.suppress(OSError, termios.error):
            slave = os.open(self.url, os.O_RDWR | os.O_NOCTTY)
            try:
                termios.tcflush(slave, termios.TCIOFLUSH)
            finally:
                os.close(slave)


def hung_up(master: int) -> bool:
    """Nobody has the other side of this pseudo-terminal open."""
    poll = select.poll()
    poll.register(master, 0)
    return any(events & (select.POLLHUP | select.POLLERR | select.POLLNVAL) for _, events in poll.poll(0))


def shown(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def address(text: str) -> tuple[str, int]:
    """ADDRESS:PORT, [ADDRESS]:PORT or ADDRESS, as host and port."""
    found = re.fullmatch(
        r"(?:\[(?P<six>[^\]]+)\]|(?P<four>[^:\[\]]*[^:\[\]0-9][^:\[\]]*))(?::(?P<port>[0-9]{1,9}))?", text
    )
    if not found or int(found["port"] or 0) > PORT_MAX:
        raise LocalError(f"--listen {text}: write ADDRESS:PORT, such as 127.0.0.1:{PORT}, with a port up to {PORT_MAX}")
    return found["six"] or found["four"], int(found["port"] or PORT)


def _listen(host: str, port: int) -> socket.socket:
    place = shown(host, port)
    if port > PORT_MAX:
        raise LocalError(f"--listen: each robot has a port of its own, and there is none after {PORT_MAX}: begin lower")
    try:
        family, _, _, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
    except (OSError, UnicodeError) as error:
        raise LocalError(f"--listen {place}: {not_listening(error, host, port)}") from error
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        if os.name == "posix":
            # A port is free again as soon as nobody listens there, whatever its old connections still do.
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        listener.bind(where)
        listener.listen()
        listener.setblocking(False)
    except OSError as error:
        listener.close()
        raise LocalError(f"--listen {place}: {not_listening(error, host, port)}") from error
    return listener
