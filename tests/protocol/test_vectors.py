"""Literal packets: from existing firmware, and the committed ones in tests/vectors."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from construct import ConstructError
from wire_format import decode, encode
from wire_formats import BY_NAME

from host.protocol.spec import control

VECTORS = Path(__file__).resolve().parents[1] / "vectors"
FILES = ["native", "dialects"]


def route(source: int, destination: int, function: int, last_packet: bool = False) -> dict[str, Any]:
    ends = {"destination": destination, "source": source, "function": function}
    return ends | {"version": 0, "last_packet": last_packet, "reserved": False}


LITERAL: list[tuple[str, dict[str, Any], str]] = [
    # STM32 to ESP32: connect as access point.
    ("CPX over UART", {"route": route(1, 2, 4), "data": b"\x20\x01"}, "ff 04 0a 04 20 01 d4"),
    # ESP32 to STM32: a host has connected.
    ("CPX over UART", {"route": route(2, 1, 4, True), "data": b"\x32\x01"}, "ff 04 51 04 32 01 9d"),
    # Host to STM32: bridge on, as cflib sends it.
    ("CPX over TCP and SPI", {"route": route(3, 1, 1), "data": b"\x21\x01"}, "04 00 19 01 21 01"),
    # ESP32 to GAP8's bootloader: start the application.
    ("CPX over TCP and SPI", {"route": route(2, 4, 15, True), "data": b"\x06"}, "03 00 54 0f 06"),
    # The stock header of a raw picture, whole packet and header alone.
    (
        "CPX over TCP and SPI",
        {"route": route(4, 3, 5, True), "data": bytes.fromhex("bc4401f4000100d0340100")},
        "0d 00 63 05 bc 44 01 f4 00 01 00 d0 34 01 00",
    ),
    (
        "stock header",
        {"width": 324, "height": 244, "depth": 1, "type": 0, "size": 79056},
        "bc 44 01 f4 00 01 00 d0 34 01 00",
    ),
    ("CPX route", route(4, 3, 5, True) | {"reserved": True}, "e3 05"),
    # NanoCockpit: the same bytes as CPX over TCP would have, but for the length, which leaves out the route.
    (
        "nanocockpit frame",
        {"route": route(4, 3, 6, True), "data": bytes.fromhex("11000000aabbccdd")},
        "08 00 63 06 11 00 00 00 aa bb cc dd",
    ),
    # As the Crazyradio broadcasts it: the CRTP packet alone.
    ("beacon", {"sequence": 4000000001, "host_us": 0x1122334455667788}, "d2 62 01 28 6b ee 88 77 66 55 44 33 22 11"),
]


def committed() -> list[tuple[str, dict[str, Any], str]]:
    entries = [entry for name in FILES for entry in json.loads((VECTORS / f"{name}.json").read_text(encoding="utf-8"))]
    for entry in entries:
        if entry["format"] == "native data":
            entry["values"]["body"] = bytes(range(24))
    return [(entry["format"], entry["values"], entry["hex"]) for entry in entries]


@pytest.mark.parametrize(("name", "values", "wire"), LITERAL + committed())
def test_literal_packet(name: str, values: dict[str, Any], wire: str) -> None:
    format_, raw = BY_NAME[name], bytes.fromhex(wire)
    assert encode(format_, values, 0xA5).hex(" ") == wire
    assert format_.build(values).hex(" ") == wire
    assert decode(format_, raw) == (values, len(raw))
    assert format_.parse(raw) == (values, len(raw))


def test_every_format_has_a_vector() -> None:
    covered = {name for name, _, _ in LITERAL + committed()}
    assert covered == set(BY_NAME)


@pytest.mark.parametrize("name", FILES)
def test_committed_vectors_are_what_the_maker_prints(name: str) -> None:
    made = subprocess.run([sys.executable, VECTORS / f"make_{name}.py"], capture_output=True, text=True, check=True)
    assert made.stdout == (VECTORS / f"{name}.json").read_text(encoding="utf-8")


CONTROL = [
    (control.WIFI_CTRL, "2001", (0x20, 1)),
    (control.WIFI_CTRL, "3201", (0x32, 1)),
    (control.WIFI_CTRL, "31c0a80401", (0x31, [192, 168, 4, 1])),
    (control.WIFI_CTRL, "106162", (0x10, b"ab")),
    (control.SYSTEM, "2101", (0x21, 1)),
    (control.SYSTEM, "10", (0x10, None)),
]


@pytest.mark.parametrize(("spec", "wire", "meaning"), CONTROL)
def test_literal_command(spec: Any, wire: str, meaning: tuple[int, Any]) -> None:
    """The robot reads these by hand: there is no codec to compare with."""
    found = spec.parse(bytes.fromhex(wire))
    assert (found.command, found.argument) == meaning
    assert spec.build(found).hex() == wire


def test_a_command_without_its_argument_is_refused() -> None:
    for spec, wire in ((control.WIFI_CTRL, "20"), (control.WIFI_CTRL, "31c0a804"), (control.SYSTEM, "21")):
        with pytest.raises(ConstructError):
            spec.parse(bytes.fromhex(wire))
