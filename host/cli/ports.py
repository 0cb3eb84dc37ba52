"""`host ports`: what there is to connect to, and to broadcast with."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

from ..protocol.typed import real

TIMEOUT_S = 2.0

EXAMPLES = """\
examples:
  host ports
  host ports --timeout 5          decks that are slow to answer
  host ports --timeout 0 --json   without asking the network
"""


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Declares the command and its options."""
    this = commands.add_parser(
        "ports",
        help="list serial devices, AI-decks on the network, running simulators, and Crazyradios",
        description="List serial devices, AI-decks that announce themselves on the network, simulators that run on "
        "this computer, and Crazyradios (for host sync beacons; with pyusb). JSON lines when piped.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = this.add_argument
    add("--timeout", type=seconds, default=TIMEOUT_S, metavar="S", help="wait so long for decks (default 2; 0: do not)")
    add("--json", action="store_true", help="JSON lines on stdout, also on a terminal")
    this.set_defaults(run=run)


def seconds(text: str) -> float:
    value = real(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"must be 0 or more, not {text}")
    return value


def run(arguments: argparse.Namespace) -> int:
    """Prints all that is found; 0 even if that is nothing."""
    found = [*serial(), *radios(), *simulators()]
    if arguments.timeout:
        found += network(arguments.timeout)
    if arguments.json or not sys.stdout.isatty():
        for each in found:
            print(json.dumps({"event": "port", **each}, separators=(",", ":")))
        return 0
    width = max((len(each["port"]) for each in found), default=0)
    for each in found:
        print(f"{each['port']:{width}}  {line(each)}")
    if not found:
        print("nothing found. 'host sim serve' starts a simulated robot", file=sys.stderr)
    return 0


def serial() -> list[dict[str, Any]]:
    from ..link.access import holders
    from ..link.discovery import serial_devices

    return [
        {
            "kind": "serial",
            "port": each.port,
            "name": each.name,
            "usb": each.usb,
            "open_in": [f"{name} (process {pid})" for pid, name in holders(each.port).items()],
        }
        for each in serial_devices()
    ]


def radios() -> list[dict[str, Any]]:
    from ..radio.dongle import dongles

    return [
        {"kind": "radio", "port": f"radio://{number}/CHANNEL/RATE", "serial": serial}
        for number, serial in enumerate(dongles())
    ]


def simulators() -> list[dict[str, Any]]:
    from sim.serial.registry import running

    return [
        {
            "kind": "simulator",
            "port": robot["port"],
            "scenario": simulator["scenario"],
            "robot": number,
            "wire": robot["wire"],
            "firmware": robot["firmware"],
            "pid": simulator["pid"],
        }
        for simulator in running()
        for number, robot in enumerate(simulator["robots"])
    ]


def network(timeout_s: float) -> list[dict[str, Any]]:
    from ..link.discovery import decks

    try:
        found = decks(timeout_s)
    except OSError as error:
        print(f"host: the network was not asked: it takes no mDNS here ({error})", file=sys.stderr)
        return []
    return [{"kind": "deck", "port": each.port, "name": each.name, "about": each.about} for each in found]


def line(record: dict[str, Any]) -> str:
    """What a person wants to know of it."""
    if record["kind"] == "serial":
        words = [record["name"] or "serial device", f"({record['usb']})" if record["usb"] else ""]
        words.append(f"in use: {', '.join(record['open_in'])}" if record["open_in"] else "")
        return " ".join(word for word in words if word)
    if record["kind"] == "radio":
        about = (
            f"serial number {record['serial']}" if record["serial"] else "no permission: host sync beacons says more"
        )
        return f"Crazyradio ({about}), for host sync beacons"
    if record["kind"] == "simulator":
        return (
            f"simulator: {record['scenario']}, robot {record['robot']}, {record['firmware']} firmware on "
            f"{record['wire']} (process {record['pid']})"
        )
    return " ".join(word for word in (record["name"], f"({record['about']})" if record["about"] else "") if word)
