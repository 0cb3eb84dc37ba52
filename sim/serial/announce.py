"""Served robots on the network by mDNS, as an AI-deck's ESP32 announces itself (aideck-esp-firmware, discovery.c)."""

from __future__ import annotations

import contextlib
import ipaddress
import threading
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from host.protocol.errors import LocalError

from .doors import TcpDoor

if TYPE_CHECKING:
    from zeroconf import ServiceInfo, Zeroconf

SERVICE = "_cpx._tcp.local."
MAC = "02000000{:04X}"
"""02: an address that no manufacturer gave."""


@contextlib.contextmanager
def announced(scenario: str, doors: Sequence[TcpDoor]) -> Iterator[None]:
    """For as long as the `with` lasts. Each robot takes a second to be announced: nobody waits for that."""
    from zeroconf import ServiceInfo, Zeroconf

    host = ipaddress.ip_address(doors[0].host)
    if host.version != 4:
        raise LocalError("--announce: only IPv4 addresses, as decks have them")
    addresses = own_addresses() if host.is_unspecified else [str(host)]
    try:
        network = Zeroconf(interfaces=addresses)
    except OSError as error:
        raise LocalError(f"--announce: this computer's network takes no mDNS ({error}): leave it out") from error
    services = []
    for number, door in enumerate(doors):
        mac = MAC.format(door.port)
        name = f"aideck-{mac[-6:]}"
        about = f"simulated: {scenario}, robot {number}"
        text = {"pname": "aideck", "pversion": "1.1", "id": mac, "name": about, "cpxversion": "1"}
        services.append(
            ServiceInfo(
                SERVICE,
                f"{name}.{SERVICE}",
                port=door.port,
                server=f"{name}.local.",
                parsed_addresses=addresses,
                properties=text,
            )
        )
    threads = [threading.Thread(target=_register, args=(network, service), daemon=True) for service in services]
    try:
        for thread in threads:
            thread.start()
        yield
    finally:
        network.close()  # and tells the network that they are gone


def own_addresses() -> list[str]:
    """IPv4 addresses of this computer in networks; only if it is in none, its own for itself."""
    from ifaddr import get_adapters

    every = [ip.ip for adapter in get_adapters() for ip in adapter.ips if isinstance(ip.ip, str)]
    return [each for each in every if not ipaddress.ip_address(each).is_loopback] or every


def _register(network: Zeroconf, service: ServiceInfo) -> None:
    from zeroconf import EventLoopBlocked, NotRunningException

    with contextlib.suppress(NotRunningException, EventLoopBlocked):  # ended meanwhile
        network.register_service(service, allow_name_change=True)
