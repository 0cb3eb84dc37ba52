"""Packets: a route and data."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hypothesis import strategies as st
from wire_format import Values, field_names, parsed, plain

from host.native import ffi, lib
from host.protocol.spec import cpx_link, cpx_uart, nanocockpit

ROUTE_NAMES = field_names("cpx_route_t")
ROUTES = st.fixed_dictionaries(
    {
        "destination": st.integers(0, 7),
        "source": st.integers(0, 7),
        "function": st.integers(0, 63),
        "version": st.integers(0, 3),
        "last_packet": st.booleans(),
        "reserved": st.booleans(),
    }
)


def packets(data_max: int) -> st.SearchStrategy[Values]:
    sizes = st.one_of(st.integers(0, 40), st.integers(data_max - 2, data_max))
    return st.fixed_dictionaries({"route": ROUTES, "data": sizes.flatmap(lambda n: st.binary(min_size=n, max_size=n))})


def packet_values(container: Any) -> Values:
    return {"route": plain(container.route, ROUTE_NAMES), "data": container.data}


def read_packet(outputs: list[Any], _: int) -> Values:
    found = outputs[0]
    route = {name: getattr(found.route, name) for name in ROUTE_NAMES}
    return {"route": route, "data": ffi.buffer(found.data.data, found.data.size)[:]}


def new_packet(values: Values) -> tuple[Any, Any]:
    """A cpx_packet_t, and its data, which must be kept as long as the packet."""
    data = ffi.new("uint8_t[]", values["data"] or b"\0")
    return ffi.new("cpx_packet_t *", (values["route"], (data, len(values["data"])))), data


def encode_packet(encoder: Any) -> Callable[[Values, Any, int], int]:
    def encode(values: Values, buffer: Any, room: int) -> int:
        packet, _data = new_packet(values)
        return int(encoder(packet, (buffer, room)))

    return encode


def parse_uart(data: bytes) -> tuple[Values, int] | None:
    frame = parsed(cpx_uart.FRAME, data, lambda found: packet_values(found.covered.value))
    return frame or parsed(cpx_uart.CREDIT, data, lambda _: {})


def parse_link(data: bytes) -> tuple[Values, int] | None:
    silence = {"route": dict.fromkeys(ROUTE_NAMES, 0), "data": b""}
    return parsed(cpx_link.FRAME, data, packet_values) or parsed(cpx_link.IDLE, data, lambda _: silence)


def parse_nanocockpit(data: bytes) -> tuple[Values, int] | None:
    return parsed(nanocockpit.FRAME, data, packet_values)


def encode_nanocockpit(values: Values, buffer: Any, room: int) -> int:
    size = 4 + len(values["data"])
    assert room >= size
    lib.nanocockpit_link_header(ffi.new("cpx_route_t *", values["route"]), len(values["data"]), buffer)
    ffi.buffer(buffer, size)[4:] = values["data"]
    return size
