"""A recording as the robot that it was: a TCP server that sends what the robot sent, when it sent it."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

from serial import SerialException

from ..protocol.errors import LocalError, SpindeckError
from .access import not_listening
from .serial.protocol_replay import Serial

POLL_S = 0.1
CLOSE_S = 2.0
"""A client has this long to read the rest and hang up, once all is sent."""
READ_BYTES = 1 << 20
DRAIN_BYTES = 1 << 16

Tell = Callable[[dict[str, Any]], None]


class ReplayServer:
    """One robot on one port. Each client gets the recording from its beginning, one client at a time."""

    def __init__(self, url: str, address: tuple[str, int], tell: Tell) -> None:
        """Listens. LocalError when the recording or the address cannot be used."""
        self._url = url
        self._tell = tell
        self._stop = threading.Event()
        self.error: SpindeckError | None = None
        with contextlib.closing(Serial(url)) as replay:
            self.robot, self.framing = replay.robot, replay.framing
        try:
            family = socket.getaddrinfo(*address, type=socket.SOCK_STREAM)[0][0]
            self._listener = socket.create_server(address, family=family)
        except (OSError, UnicodeError) as error:
            place = f"--listen {address[0]}:{address[1]}"
            raise LocalError(f"{place}: {not_listening(error, *address)}") from error
        self._listener.settimeout(POLL_S)
        host, port = self._listener.getsockname()[:2]
        self.address = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        self._tell(
            {"event": "listening", "robot": self.robot, "port": f"socket://{self.address}", "framing": self.framing}
        )
        self._thread.start()

    def wait(self, seconds: float) -> bool:
        """True once it has played to the end, or has failed."""
        self._thread.join(seconds)
        return not self._thread.is_alive()

    def close(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        self._listener.close()

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                with contextlib.suppress(TimeoutError):
                    client, peer = self._listener.accept()
                    self._tell({"event": "connected", "robot": self.robot, "client": f"{peer[0]}:{peer[1]}"})
                    with client, contextlib.closing(Serial(self._url, timeout=POLL_S)) as replay:
                        sent, why = self._play(client, replay)
                    self._tell({"event": "ended", "robot": self.robot, "bytes": sent, "why": why})
                    if why == "end of the recording":
                        return
        except (SpindeckError, OSError) as error:
            self.error = error if isinstance(error, SpindeckError) else LocalError(str(error))

    def _play(self, client: socket.socket, replay: Serial) -> tuple[int, str]:
        """Bytes sent, and why no more."""
        sent = 0
        client.settimeout(POLL_S)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            while not self._stop.is_set():
                try:
                    data = memoryview(replay.read(READ_BYTES))
                except SerialException:
                    self._hang_up(client)
                    return sent, "end of the recording"
                while data and not self._stop.is_set():
                    with contextlib.suppress(TimeoutError):
                        size = client.send(data)
                        data, sent = data[size:], sent + size
                if self._has_hung_up(client):
                    return sent, "the client has gone"
        except OSError as error:
            return sent, f"the client has gone: {error.strerror}"
        return sent, "stopped"

    def _has_hung_up(self, client: socket.socket) -> bool:
        """Reads what the client sends, and forgets it: a recording does not listen."""
        client.setblocking(False)
        try:
            return not client.recv(DRAIN_BYTES)
        except BlockingIOError:
            return False
        finally:
            client.settimeout(POLL_S)

    def _hang_up(self, client: socket.socket) -> None:
        """So that the client gets the last byte: a socket that is closed with bytes unread resets the connection."""
        client.shutdown(socket.SHUT_WR)
        until_s = time.monotonic() + CLOSE_S
        while time.monotonic() < until_s and not self._stop.is_set():
            with contextlib.suppress(TimeoutError):
                if not client.recv(DRAIN_BYTES):
                    return
