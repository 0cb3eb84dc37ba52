"""Served robots on the network by mDNS, as an AI-deck's ESP32 announces itself (aideck-esp-firmware, discovery.c)."""

from __future__ import annotations

import contextlib
import ipaddress
import socket
from collections.abc import Iterator, Sequence

from host.protocol.errors import LocalError

from .doors import TcpDoor

SERVICE = "_cpx._tcp.local."
MAC = "02000000{:04X}"
"""02: an address that no manufacturer gave."""


@contextlib.contextmanager
def announced(scenario: str, doors: Sequence[TcpDoor]) -> Iterator[None]:
    """For as long as the `with` lasts."""
    from ifaddr import get_adapters
    from zeroconf import IPVersion, ServiceInfo, Zeroconf

    host = ipaddress.ip_address(doors[0].host)
    addresses = [str(host)]
    if host.is_unspecified:
        own = [ip.ip for adapter in get_adapters() for ip in adapter.ips if isinstance(ip.ip, str)]
        addresses = [each for each in own if not each.startswith("127.")] or own
    try:
        with Zeroconf(
            interfaces=addresses, ip_version=IPVersion.V6Only if host.version == 6 else IPVersion.V4Only
        ) as network:
            for number, door in enumerate(doors):
                mac = MAC.format(door.port)
                service = ServiceInfo(
                    SERVICE,
                    f"aideck-{mac[-6:]}.{SERVICE}",
                    port=door.port,
                    server=f"aideck-{mac[-6:]}.local.",
                    parsed_addresses=addresses,
                    properties={
                        "pname": "aideck",
                        "pversion": "1.1",
                        "id": mac,
                        "name": f"simulated: {scenario}, robot {number}",
                        "cpxversion": "1",
                    },
                )
                network.register_service(service, allow_name_change=True)
            yield
    except (OSError, socket.gaierror) as error:
        raise LocalError(f"--announce: this computer's network takes no mDNS ({error}): leave it out") from error
