"""What there is to connect to: serial devices, and AI-decks that announce themselves on the network by mDNS."""

from __future__ import annotations

import time
from dataclasses import dataclass

SERVICE = "_cpx._tcp.local."


@dataclass(frozen=True)
class SerialDevice:
    port: str
    name: str
    """What its USB descriptors say; empty: nothing."""
    usb: str
    """vendor:product in hex, and the serial number if it has one; empty: not USB."""


@dataclass(frozen=True)
class Deck:
    port: str
    name: str
    """aideck-XXXXXX: the last digits of its MAC address."""
    about: str
    """The name that it gives itself in its announcement, or empty."""


def serial_devices() -> list[SerialDevice]:
    """Those that the system lists; a pseudo-terminal is none of them."""
    from serial.tools.list_ports import comports

    found = []
    for each in sorted(comports()):
        usb = "" if each.vid is None else f"{each.vid:04x}:{each.pid:04x}"
        if usb and each.serial_number:
            usb += f" {each.serial_number}"
        name = " ".join(word for word in (each.manufacturer, each.product) if word)
        if not name and each.description != "n/a":
            name = each.description
        found.append(SerialDevice(each.device, name, usb))
    return found


def decks(timeout_s: float) -> list[Deck]:
    """Who answers within that time. OSError when this computer has no network that takes mDNS."""
    from zeroconf import ServiceBrowser, ServiceListener, Zeroconf

    class Names(ServiceListener):
        def __init__(self) -> None:
            self.found: list[str] = []

        def add_service(self, zc: Zeroconf, type_: str, name: str) -> None:
            self.found.append(name)

        def update_service(self, zc: Zeroconf, type_: str, name: str) -> None:
            pass

        def remove_service(self, zc: Zeroconf, type_: str, name: str) -> None:
            self.found.remove(name)

    names, found = Names(), []
    with Zeroconf() as network:
        ServiceBrowser(network, SERVICE, names)
        time.sleep(timeout_s)
        for name in sorted(set(names.found)):
            service = network.get_service_info(SERVICE, name, timeout=1000)
            if service is None:
                continue
            about = (service.properties.get(b"name") or b"").decode(errors="replace")
            for host in service.parsed_addresses():
                where = f"[{host}]" if ":" in host else host
                found.append(Deck(f"socket://{where}:{service.port}", name.partition(".")[0], about))
    return found
