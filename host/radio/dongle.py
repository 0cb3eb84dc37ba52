"""A Crazyradio on USB, through pyusb; and this computer's clock."""

from __future__ import annotations

import errno
import sys
import time
from collections.abc import Callable
from typing import Any

from ..protocol.errors import ConnectionLostError, LocalError, NotThereError, PeerSilentError
from . import crazyradio
from .crazyradio import Control
from .url import parse

TIMEOUT_MS = 100
LOOK_S = 0.05
"""So often Ctrl-C is looked at."""
AWAKE_S = 0.001
"""So long before a beacon this computer sleeps no more: who has just woken up is slower to send, and less evenly."""
RULE = 'SUBSYSTEM=="usb", ATTRS{idVendor}=="1915", ATTRS{idProduct}=="7777", TAG+="uaccess"'
PERMIT = (
    f"echo '{RULE}' | sudo tee /etc/udev/rules.d/70-crazyradio.rules && sudo udevadm control --reload && "
    "sudo udevadm trigger"
)


class Dongle:
    """Broadcasts. LocalError: it cannot be opened; says what to do."""

    heard = None

    def __init__(self, url: str) -> None:
        wanted = parse(url)
        self.url = url
        try:
            import usb.core
            import usb.util
        except ImportError as error:
            raise LocalError(f"{url}: a Crazyradio needs pyusb: pip install 'spindeck[radio]'") from error
        self._usb: Any = usb
        self._device = find(usb, url, wanted.dongle)
        try:
            # As every other program begins: what the dongle had been told before, and half a packet, are forgotten.
            self._device.set_configuration(crazyradio.CONFIGURATION)
            if sys.platform == "linux":
                self._device.reset()
            usb.util.claim_interface(self._device, crazyradio.INTERFACE)
            for control in crazyradio.settings(wanted):
                self._tell(control)
        except (usb.core.USBError, NotImplementedError) as error:
            self.close()
            raise LocalError(f"{url}: {why(error)}") from error
        try:
            self._tell(crazyradio.INLINE_OFF)
        except usb.core.USBError as error:
            if error.errno != errno.EPIPE:
                self.close()
                raise LocalError(f"{url}: {why(error)}") from error

    def now_us(self) -> int:
        # The monotonic clock; on Windows time.monotonic has steps of 15.6 ms before Python 3.13.
        return time.perf_counter_ns() // 1000

    def wait_until(self, at_us: int, stop: Callable[[], bool]) -> None:
        while not stop() and (left_s := (at_us - self.now_us()) * 1e-6) > 0:
            if left_s > AWAKE_S:
                time.sleep(min(left_s - AWAKE_S, LOOK_S))

    def send(self, packet: bytes) -> None:
        try:
            taken = self._device.write(crazyradio.OUT, packet, TIMEOUT_MS)
        except self._usb.core.USBTimeoutError as error:
            raise PeerSilentError(f"{self.url}: the dongle has not taken a packet within {TIMEOUT_MS} ms") from error
        except self._usb.core.USBError as error:
            raise ConnectionLostError(f"{self.url}: the dongle is gone ({error.strerror}): pulled out?") from error
        if taken != len(packet):
            raise PeerSilentError(f"{self.url}: the dongle has taken {taken} of {len(packet)} bytes")

    def close(self) -> None:
        self._usb.util.dispose_resources(self._device)

    def _tell(self, control: Control) -> None:
        self._device.ctrl_transfer(
            crazyradio.TO_DEVICE, control.request, control.value, 0, control.data, timeout=10 * TIMEOUT_MS
        )


def find(usb: Any, url: str, dongle: int | str) -> Any:
    try:
        found = plugged_in(usb)
    except usb.core.NoBackendError as error:
        raise LocalError(
            f"{url}: pyusb finds no libusb: sudo apt install libusb-1.0-0, or brew install libusb"
        ) from error
    except usb.core.USBError as error:
        raise LocalError(f"{url}: this computer's USB cannot be looked at: {error.strerror}") from error
    if not found:
        raise NotThereError(f"{url}: no Crazyradio is plugged in (USB 1915:7777); sim://swarm needs none")
    if isinstance(dongle, int):
        if dongle >= len(found):
            raise NotThereError(f"{url}: there is no dongle {dongle}: {len(found)} plugged in, counted from 0")
        return found[dongle]
    serials = [serial_of(usb, each) for each in found]
    if None in serials:
        raise LocalError(f"{url}: the dongles may not be asked for their serial numbers: {PERMIT}")
    for each, serial in zip(found, serials, strict=True):
        if str(serial).upper() == dongle.upper():
            return each
    raise NotThereError(f"{url}: no dongle has this serial number; there is {', '.join(map(str, serials))}")


def plugged_in(usb: Any) -> list[Any]:
    return list(usb.core.find(find_all=True, idVendor=crazyradio.VENDOR, idProduct=crazyradio.PRODUCT))


def serial_of(usb: Any, device: Any) -> str | None:
    """None: this user may not ask it."""
    try:
        return str(device.serial_number)
    except (ValueError, NotImplementedError, usb.core.USBError):
        return None


def dongles() -> list[str | None]:
    """Serial numbers of all that are plugged in; None: one that this user may not use. Empty without pyusb."""
    try:
        import usb.core

        return [serial_of(usb, each) for each in plugged_in(usb)]
    except (ImportError, ValueError, OSError):  # what pyusb's NoBackendError and USBError are
        return []


def why(error: Any) -> str:
    """A dongle that is there cannot be used."""
    if isinstance(error, NotImplementedError):
        return "the dongle has no driver that libusb can use: on Windows, WinUSB"
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"no permission to use the dongle. This helps: {PERMIT}"
    if error.errno == errno.EBUSY:
        return "the dongle is busy: another program (a client, Crazyswarm) has it; end that, or use a second dongle"
    if error.errno in (errno.ENODEV, errno.EIO, errno.ENOENT):
        return "the dongle does not answer: unplug it and plug it in again"
    return f"the dongle does not do what it is told: {error.strerror or error}"
