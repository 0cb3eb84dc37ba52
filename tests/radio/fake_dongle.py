"""A backend of pyusb with Crazyradios that are not there: it keeps what they are told, and does with packets what their
firmware does (crazyradio-firmware main.c, crazyradio2-firmware legacy_usb.c)."""

import errno
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import usb.backend
import usb.core

NAMES = {1: "Bitcraze", 2: "Crazyradio", 3: ""}
STATE = {0x01: "channel", 0x03: "rate", 0x04: "power", 0x05: "ard", 0x06: "arc", 0x10: "ack", 0x20: "carrier"}


@dataclass
class FakeDongle:
    serial: str = "FD61E54B7A"
    version: int = 0x0053
    """0x0500: a Crazyradio 2.0."""
    on_air: Callable[[bytes], None] = lambda packet: None
    fail: Callable[[str], None] = lambda what: None
    """Called before each "open", "claim", "control" and "bulk": may raise."""
    transfers: list[tuple[Any, ...]] = field(default_factory=list)
    state: dict[str, Any] = field(default_factory=lambda: {"ack": 1, "inline": 0})
    sent: list[tuple[dict[str, Any], bytes]] = field(default_factory=list)
    """What went on the air, with all that the dongle had been told by then."""
    answers: list[bytes] = field(default_factory=list)

    def control(self, kind: int, request: int, value: int, index: int, data: bytes) -> None:
        self.fail("control")
        self.transfers.append(("control", kind, request, value, index, data))
        if request == 0x23 and self.version >= 0x0500:
            self.state["inline"] = value
        elif request == 0x02:
            self.state["address"] = data
        elif request in STATE:
            self.state[STATE[request]] = value
        else:
            raise usb.core.USBError("Pipe error", -9, errno.EPIPE)

    def bulk(self, endpoint: int, packet: bytes) -> None:
        self.fail("bulk")
        self.transfers.append(("bulk", endpoint, packet))
        if self.state["inline"]:
            packet = packet[8:]
        if not self.state["carrier"]:
            self.sent.append((dict(self.state), packet))
            self.on_air(packet)
            if self.state["ack"]:
                self.answers.append(b"\0")


class FakeUsb(usb.backend.IBackend):  # type: ignore[misc]
    def __init__(self, *dongles: FakeDongle) -> None:
        self.dongles = dongles

    def enumerate_devices(self) -> Iterator[FakeDongle]:
        yield from self.dongles

    def get_device_descriptor(self, dev: FakeDongle) -> Any:
        ids = {"idVendor": 0x1915, "idProduct": 0x7777, "bcdDevice": dev.version, "bcdUSB": 0x0110}
        strings = {"iManufacturer": 1, "iProduct": 2, "iSerialNumber": 3}
        kind = {"bDeviceClass": 0xFF, "bDeviceSubClass": 0xFF, "bDeviceProtocol": 0xFF, "bMaxPacketSize0": 64}
        place = {"address": 4, "bus": 1, "port_number": 2, "port_numbers": (2,), "speed": 2}
        return SimpleNamespace(bLength=18, bDescriptorType=1, bNumConfigurations=1, **ids, **strings, **kind, **place)

    def get_configuration_descriptor(self, dev: FakeDongle, config: int) -> Any:
        if config:
            raise IndexError
        sizes = {"bLength": 9, "bDescriptorType": 2, "wTotalLength": 32, "bNumInterfaces": 1, "bConfigurationValue": 1}
        return SimpleNamespace(**sizes, iConfiguration=0, bmAttributes=0x80, bMaxPower=50, extra_descriptors=[])

    def get_interface_descriptor(self, dev: FakeDongle, intf: int, alt: int, config: int) -> Any:
        if intf or alt:
            raise IndexError
        sizes = {"bLength": 9, "bDescriptorType": 4, "bInterfaceNumber": 0, "bAlternateSetting": 0, "bNumEndpoints": 2}
        kind = {"bInterfaceClass": 0xFF, "bInterfaceSubClass": 0, "bInterfaceProtocol": 0, "iInterface": 0}
        return SimpleNamespace(**sizes, **kind, extra_descriptors=[])

    def get_endpoint_descriptor(self, dev: FakeDongle, ep: int, intf: int, alt: int, config: int) -> Any:
        kind = {"bLength": 7, "bDescriptorType": 5, "bEndpointAddress": (0x81, 0x01)[ep], "bmAttributes": 2}
        return SimpleNamespace(
            **kind, wMaxPacketSize=64, bInterval=0, bRefresh=0, bSynchAddress=0, extra_descriptors=[]
        )

    def open_device(self, dev: FakeDongle) -> FakeDongle:
        dev.fail("open")
        return dev

    def close_device(self, dev_handle: FakeDongle) -> None:
        pass

    def set_configuration(self, dev_handle: FakeDongle, config_value: int) -> None:
        dev_handle.transfers.append(("configuration", config_value))

    def get_configuration(self, dev_handle: FakeDongle) -> int:
        return 1

    def claim_interface(self, dev_handle: FakeDongle, intf: int) -> None:
        dev_handle.fail("claim")

    def release_interface(self, dev_handle: FakeDongle, intf: int) -> None:
        pass

    def reset_device(self, dev_handle: FakeDongle) -> None:
        dev_handle.transfers.append(("reset",))

    def bulk_write(self, dev_handle: FakeDongle, ep: int, intf: int, data: Any, timeout: int) -> int:
        dev_handle.bulk(ep, bytes(data))
        return len(data)

    def bulk_read(self, dev_handle: FakeDongle, ep: int, intf: int, buff: Any, timeout: int) -> int:
        if not dev_handle.answers:
            raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        answer = dev_handle.answers.pop(0)
        buff[: len(answer)] = type(buff)("B", answer)
        return len(answer)

    def ctrl_transfer(
        self, dev_handle: FakeDongle, kind: int, request: int, value: int, index: int, data: Any, timeout: int
    ) -> int:
        if kind != 0x80:
            dev_handle.control(kind, request, value, index, bytes(data))
            return len(data)
        dev_handle.fail("descriptor")
        text = (NAMES[value & 0xFF] or dev_handle.serial).encode("utf-16-le") if value & 0xFF else b"\x09\x04"
        answer = bytes([2 + len(text), 3]) + text
        data[: len(answer)] = type(data)("B", answer)
        return len(answer)


def raising(what: str, name: str, number: int, after: int = 0) -> Callable[[str], None]:
    """Fails each `what` after so many with this error of the system's."""
    seen = 0

    def fail(done: str) -> None:
        nonlocal seen
        if done != what:
            return
        seen += 1
        if seen > after:
            kind = usb.core.USBTimeoutError if number == errno.ETIMEDOUT else usb.core.USBError
            raise kind(name, -1, number)

    return fail
