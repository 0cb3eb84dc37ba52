"""Packets to bytes and back, through the C that the robot runs.

Encoders raise LocalError for what does not fit its field; decoders raise PeerError with the place of the first byte
that they were given and what is wrong there.
"""

from typing import Any

from ..native import check, ffi, lib
from .errors import LocalError
from .packets import Beacon, CameraSettings, CpxPacket, Route, StampMessage, StreamRequest

ENCODINGS = {"raw": lib.IMAGE_RAW, "jpeg": lib.IMAGE_JPEG}

RANGES = {
    "cpx_route_t": {
        "destination": "0..7",
        "source": "0..7",
        "function": "0..63",
        "version": "0..3",
        "last_packet": "False or True",
        "reserved": "False or True",
    },
    "native_stream_t": {"dialect": "0 or 1", "data_max": "0 or 144..1020"},
    "native_camera_t": {
        "auto_exposure": "False or True",
        "analog_gain": "1, 2, 4 or 8",
        "digital_gain": "1..255",
        "burst": "1..3",
        "encoding": "raw or jpeg",
        "exposure_lines": "2..65535",
        "frame_period_us": "0..10000000",
    },
    "beacon_t": {"sequence": "0..4294967295", "host_us": "0..18446744073709551615"},
    "paper_camera_t": {"exposure_lines": "2..532", "frame_period_us": "0: the paper's firmware has no frame rate"},
}
"""What a caller is told about a field; the C judges."""


def encode_cpx_tcp(packet: CpxPacket) -> bytes:
    """For the TCP connection, and for SPI."""
    return _encode_cpx(packet, lib.cpx_link_encode, lib.CPX_DATA_MAX, lib.CPX_LINK_FRAME_MAX)


def encode_cpx_uart(packet: CpxPacket) -> bytes:
    return _encode_cpx(packet, lib.cpx_uart_encode, lib.CPX_DATA_UART_MAX, lib.CPX_UART_FRAME_MAX)


def decode_cpx_tcp(data: bytes, offset: int = 0) -> tuple[CpxPacket | None, int]:
    """The packet at `offset` and the bytes it takes. None for a length of 0, which only SPI has."""
    packet, size = _decode_cpx(data, offset, lib.cpx_link_decode, "CPX over TCP")
    return (None if data[offset : offset + 2] == b"\0\0" else packet), size


def decode_cpx_uart(data: bytes, offset: int = 0) -> tuple[CpxPacket | None, int]:
    """The packet at `offset` and the bytes it takes. None for a credit."""
    packet, size = _decode_cpx(data, offset, lib.cpx_uart_decode, "CPX over UART")
    return (None if data[offset + 1] == 0 else packet), size


def decode_stamp(data: bytes, offset: int = 0) -> tuple[StampMessage, int]:
    """The stamp message at `offset` and the bytes it takes."""
    stamp = ffi.new("stamp_t *")
    size = check(lib.stamp_decode(_view(data, offset), stamp), f"stamp message at byte {offset}")
    return StampMessage(stamp.sequence, stamp.stm32_us, stamp.epoch), size


def encode_stream_request(request: StreamRequest) -> bytes:
    """Data of a CPX_APP packet from CPX_HOST to CPX_GAP8, and likewise to CPX_ESP32."""
    values = {"dialect": int(request.native), "data_max": request.data_max}
    stream = _fill("native_stream_t", values)
    out = ffi.new("uint8_t[]", lib.NATIVE_STREAM_BYTES)
    lib.native_stream_encode(stream, out)
    if lib.native_stream_decode((out, len(out)), stream) < 0:
        raise _refusal("native_stream_t", "data_max", values)
    return bytes(out)


def encode_camera_request(settings: CameraSettings) -> bytes:
    """Data of a CPX_APP packet to CPX_GAP8."""
    names = list(RANGES["native_camera_t"])
    values = {name: getattr(settings, name) for name in names}
    values["encoding"] = ENCODINGS.get(settings.encoding, settings.encoding)
    camera = _fill("native_camera_t", values)
    place = lib.native_camera_check(camera)
    if place:
        raise _refusal("native_camera_t", names[place - 1], values)
    out = ffi.new("uint8_t[]", lib.NATIVE_CAMERA_BYTES)
    lib.native_camera_encode(camera, out)
    return bytes(out)


def encode_paper_camera(settings: CameraSettings) -> bytes:
    """Likewise, for the dataset paper's firmware. Nothing answers it."""
    encode_camera_request(settings)  # judges what both have in common
    values = {name: getattr(settings, name) for name in RANGES["native_camera_t"]}
    if settings.exposure_lines > lib.PAPER_CAMERA_LINES_MAX:
        raise _refusal("paper_camera_t", "exposure_lines", values)
    if settings.frame_period_us:
        raise _refusal("paper_camera_t", "frame_period_us", values)
    del values["frame_period_us"]
    values["encoding"] = ENCODINGS[settings.encoding]
    out = ffi.new("uint8_t[]", lib.PAPER_CAMERA_BYTES)
    lib.paper_camera_encode(_fill("paper_camera_t", values), out)
    return bytes(out)


def encode_nanocockpit(packet: CpxPacket) -> bytes:
    """For NanoCockpit's TCP connection: the length leaves out the route."""
    if len(packet.data) > lib.NANOCOCKPIT_DATA_MAX:
        raise LocalError(f"{len(packet.data)} bytes of data: at most {lib.NANOCOCKPIT_DATA_MAX} fit")
    head = ffi.new("uint8_t[4]")
    lib.nanocockpit_link_header(_route(packet.route), len(packet.data), head)
    return bytes(head) + packet.data


def encode_nanocockpit_reply(frame_gap8_us: int, frame_id: int) -> bytes:
    """Data of a CPX_STREAMER packet to CPX_GAP8: this frame has come."""
    reply = ffi.new("uint8_t[]", lib.NANOCOCKPIT_REPLY_BYTES)
    lib.nanocockpit_reply_encode(ffi.new("nanocockpit_reply_t *", (frame_gap8_us, frame_id)), reply)
    check = lib.nanocockpit_check(0, (reply, len(reply)))
    begin = ffi.new("nanocockpit_begin_t *", (lib.NANOCOCKPIT_INFERENCE, len(reply), check))
    head = ffi.new("uint8_t[]", lib.NANOCOCKPIT_BEGIN_BYTES)
    lib.nanocockpit_begin_encode(begin, head)
    return bytes(head) + bytes(reply)


def encode_beacon(beacon: Beacon) -> bytes:
    """A CRTP packet, for a broadcast by radio."""
    out = ffi.new("uint8_t[]", lib.BEACON_BYTES)
    lib.beacon_encode(_fill("beacon_t", {"sequence": beacon.sequence, "host_us": beacon.host_us}), out)
    return bytes(out)


def _view(data: bytes, offset: int) -> Any:
    """A bytes_t of data[offset:]. The C reads it within the call and keeps nothing."""
    if not 0 <= offset <= len(data):
        raise LocalError(f"offset is {offset}: give 0..{len(data)}")
    return ffi.new("bytes_t *", (ffi.from_buffer("uint8_t[]", data) + offset, len(data) - offset))[0]


def _refusal(struct: str, name: str, values: dict[str, Any]) -> LocalError:
    return LocalError(f"{name} is {values[name]}: give {RANGES[struct][name]}")


def _fill(struct: str, values: dict[str, Any]) -> Any:
    """A new struct. LocalError for a value that its field cannot hold."""
    made = ffi.new(f"{struct} *")
    for name, value in values.items():
        try:
            setattr(made, name, value)
        except (OverflowError, TypeError) as error:
            raise _refusal(struct, name, values) from error
    return made


def _route(route: Route) -> Any:
    """A cpx_route_t. LocalError for a field that does not fit its bits."""
    values = {name: getattr(route, name) for name in RANGES["cpx_route_t"]}
    made = _fill("cpx_route_t", values)
    wire = ffi.new("uint8_t[2]")
    lib.cpx_route_encode(made, wire)
    lib.cpx_route_decode(wire, made)
    for name, value in values.items():
        if getattr(made, name) != value:  # its bits are fewer than its byte's
            raise _refusal("cpx_route_t", name, values)
    return made


def _encode_cpx(packet: CpxPacket, encode: Any, data_max: int, frame_max: int) -> bytes:
    route = _route(packet.route)
    data = ffi.from_buffer("uint8_t[]", packet.data)
    out = ffi.new("uint8_t[]", frame_max)
    size = encode(ffi.new("cpx_packet_t *", (route[0], (data, len(data)))), (out, frame_max))
    if size == 0:
        raise LocalError(f"{len(data)} bytes of data: at most {data_max} fit")
    return bytes(ffi.buffer(out, size))


def _decode_cpx(data: bytes, offset: int, decode: Any, what: str) -> tuple[CpxPacket, int]:
    packet = ffi.new("cpx_packet_t *")
    view = _view(data, offset)
    size = check(decode(view, packet), f"{what} at byte {offset}")
    route = Route(**{name: getattr(packet.route, name) for name in RANGES["cpx_route_t"]})
    body = bytes(ffi.buffer(packet.data.data, packet.data.size)) if packet.data.size else b""
    return CpxPacket(route, body), size
