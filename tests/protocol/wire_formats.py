"""One entry per format: how the C does it, how the specification does it, and what values it can hold.

test_formats.py runs the same six tests over all of them.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from construct import ConstructError
from hypothesis import strategies as st

from host.native import ffi, lib
from host.protocol.spec import beacon, checks, cpx, cpx_link, cpx_uart, image, nanocockpit, native, paper, stamp

Values = dict[str, Any]


@dataclass(frozen=True)
class Format:
    name: str
    values: st.SearchStrategy[Values]
    build: Callable[[Values], bytes]
    """By the specification."""
    parse: Callable[[bytes], tuple[Values, int] | None]
    """By the specification: values and bytes used, or None when it refuses."""
    encode: Callable[[Values, Any, int], int]
    """By the C, into a buffer of that size: bytes written."""
    decode: Callable[..., int]
    """The C function: a bytes_t and then `outputs`."""
    outputs: tuple[str, ...]
    read: Callable[[list[Any], int], Values]
    """The values in `outputs`; the int is what `decode` returned."""
    needed: int | None = None
    """Bytes from which on a truncated message is a shorter message; None: it never is."""
    repair: Callable[[bytes], bytes] = bytes
    """Makes the check of random bytes match, so that more than the check is tried."""

    def __str__(self) -> str:
        return self.name


def plain(container: Any, names: list[str]) -> Values:
    return {name: container[name] for name in names}


def parsed(spec: Any, data: bytes, take: Callable[[Any], Values]) -> tuple[Values, int] | None:
    stream = io.BytesIO(data)
    try:
        return take(spec.parse_stream(stream)), stream.tell()
    except ConstructError:
        return None


# Messages: one C struct whose fields have the specification's names.


def field_names(ctype: str) -> list[str]:
    return [name for name, _ in ffi.typeof(ctype).fields]


def any_values(ctype: str, **known: st.SearchStrategy[Any]) -> st.SearchStrategy[Values]:
    """Every field over its whole range, but for the known ones."""
    strategies = {
        name: known.get(name, st.integers(0, 256 ** ffi.sizeof(field.type) - 1))
        for name, field in ffi.typeof(ctype).fields
    }
    return st.fixed_dictionaries(strategies)


def message(
    name: str, ctype: str, c_name: str, spec: Any, size: int, values: st.SearchStrategy[Values], **more: Any
) -> Format:
    names = field_names(ctype)
    encoder = getattr(lib, f"{c_name}_encode")

    def encode(given: Values, buffer: Any, room: int) -> int:
        assert room >= size
        encoder(ffi.new(f"{ctype} *", given), buffer)
        return size

    return Format(
        name,
        values,
        spec.build,
        lambda data: parsed(spec, data, lambda found: plain(found, names)),
        encode,
        getattr(lib, f"{c_name}_decode"),
        (f"{ctype} *",),
        lambda outputs, _: {field: getattr(outputs[0], field) for field in names},
        **more,
    )


SIDES = st.integers(1, 1024)


def pictures(encoding: str, size: str) -> st.SearchStrategy[Values]:
    """What a picture can be, raw and JPEG, up to the largest body."""
    shapes = st.tuples(SIDES, SIDES, st.integers(1, 4))
    small = shapes.filter(lambda shape: shape[0] * shape[1] * shape[2] <= 1 << 20)
    raw = small.map(lambda s: dict(zip(("width", "height", "depth"), s, strict=True)) | {size: s[0] * s[1] * s[2]})
    jpeg = st.tuples(shapes, st.integers(1, 1 << 20)).map(
        lambda both: dict(zip(("width", "height", "depth"), both[0], strict=True)) | {size: both[1]}
    )
    return st.one_of(raw.map(lambda v: v | {encoding: 0}), jpeg.map(lambda v: v | {encoding: 1}))


def merged(*parts: st.SearchStrategy[Values]) -> st.SearchStrategy[Values]:
    return st.tuples(*parts).map(lambda dicts: {name: value for part in dicts for name, value in part.items()})


# Packets: a route and data.

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


def repair_uart(data: bytes) -> bytes:
    if len(data) < 2 or len(data) < data[1] + 3:
        return data
    end = data[1] + 2
    return data[:end] + bytes([checks.xor8(data[:end])]) + data[end + 1 :]


def repair_stamp(data: bytes) -> bytes:
    return data[:15] + checks.crc16(data[2:15]).to_bytes(2, "little") + data[17:] if len(data) >= 17 else data


def repair_crc16(data: bytes) -> bytes:
    """Of an echo's question, or of its answer."""
    size = 5 if data[1:2] == b"\x2b" else 17
    return (
        data[: size - 2] + checks.crc16(data[2 : size - 2]).to_bytes(2, "little") + data[size:]
        if len(data) >= size
        else data
    )


def repair_frame(data: bytes) -> bytes:
    """All checks; the later ones are not there in a short message, and then not judged."""
    return repair_check32(repair_check32(repair_check32(data, 100), 124), 140)


def repair_pairs(data: bytes) -> bytes:
    return repair_check32(data, 8 + 21 * data[2]) if len(data) > 2 else data


def repair_status(data: bytes) -> bytes:
    return repair_check32(data, 60)


def repair_log(data: bytes) -> bytes:
    return repair_check32(data, 48)


def repair_check32(data: bytes, at: int) -> bytes:
    return data[:at] + checks.crc32(data[:at]).to_bytes(4, "little") + data[at + 4 :] if len(data) >= at + 4 else data


def repair_paper(data: bytes) -> bytes:
    return data[:39] + bytes([checks.xor8(data[2:39])]) + data[40:] if len(data) >= 40 else data


def repair_state(data: bytes) -> bytes:
    return data[:36] + checks.crc32(data[:36]).to_bytes(4, "little") + data[40:] if len(data) >= 40 else data


# Messages whose struct has structs and arrays in it. Their values are flat: no name is in two of the parts.

FLOATS = st.floats(width=32, allow_nan=False)
BY_KIND = {"float": FLOATS, "int16_t": st.integers(-(2**15), 2**15 - 1)}


def flat_values(ctype: Any, **known: st.SearchStrategy[Any]) -> dict[str, st.SearchStrategy[Any]]:
    """A strategy for each leaf."""
    found: dict[str, st.SearchStrategy[Any]] = {}
    for name, field in ctype.fields:
        kind = field.type
        if kind.kind == "struct":
            found |= flat_values(kind, **known)
        elif kind.kind == "array":
            found[name] = st.lists(leaf(kind.item), min_size=kind.length, max_size=kind.length)
        else:
            found[name] = known.get(name, leaf(kind))
    return found


def leaf(kind: Any) -> st.SearchStrategy[Any]:
    return BY_KIND.get(kind.cname, st.integers(0, 256 ** ffi.sizeof(kind) - 1))


def fill(struct: Any, ctype: Any, values: Values) -> Any:
    for name, field in ctype.fields:
        if field.type.kind == "struct":
            fill(getattr(struct, name), field.type, values)
        else:
            setattr(struct, name, values[name])
    return struct


def flat(struct: Any, ctype: Any) -> Values:
    found: Values = {}
    for name, field in ctype.fields:
        value = getattr(struct, name)
        if field.type.kind == "struct":
            found |= flat(value, field.type)
        else:
            found[name] = [same(each) for each in value] if field.type.kind == "array" else same(value)
    return found


def same(value: Any) -> Any:
    """A NaN is equal to nothing, but which one it is is none of our business."""
    return "nan" if value != value else value


def picked(container: Any, names: list[str]) -> Values:
    """Those names out of a Container and the ones in it."""
    found: Values = {}
    for name, value in container.items():
        if name in names:
            found[name] = [same(each) for each in value] if isinstance(value, list) else same(value)
        elif isinstance(value, dict):
            found |= picked(value, names)
    return found


def nested(
    name: str,
    c_name: str,
    spec: Any,
    size: int,
    *,
    arrange: Callable[[Values], Any] = lambda values: values,
    decode: Any = None,
    values: st.SearchStrategy[Values] | None = None,
    **more: Any,
) -> Format:
    ctype = ffi.typeof(f"{c_name}_t")
    encoder = getattr(lib, f"{c_name}_encode")
    own = flat_values(ctype)

    def encode(given: Values, buffer: Any, room: int) -> int:
        assert room >= size
        encoder(fill(ffi.new(f"{c_name}_t *"), ctype, given), buffer)
        return size

    return Format(
        name,
        st.fixed_dictionaries(own) if values is None else merged(st.fixed_dictionaries(own), values),
        lambda given: spec.build(arrange(given)),
        lambda data: parsed(spec, data, lambda found: picked(found, list(own))),
        encode,
        decode or getattr(lib, f"{c_name}_decode"),
        (f"{c_name}_t *",),
        lambda outputs, _: flat(outputs[0], ctype),
        **more,
    )


def state_only(view: Any, out: Any) -> int:
    """nanocockpit_uart_decode as far as the message with a state goes."""
    used = lib.nanocockpit_uart_decode(view, out)
    return used if used < 0 or used == lib.NANOCOCKPIT_STATE_BYTES else lib.ERR_START


def parse_nanocockpit(data: bytes) -> tuple[Values, int] | None:
    return parsed(nanocockpit.FRAME, data, packet_values)


def encode_nanocockpit(values: Values, buffer: Any, room: int) -> int:
    size = 4 + len(values["data"])
    assert room >= size
    lib.nanocockpit_link_header(ffi.new("cpx_route_t *", values["route"]), len(values["data"]), buffer)
    ffi.buffer(buffer, size)[4:] = values["data"]
    return size


GREY = st.fixed_dictionaries({"width": SIDES, "height": SIDES, "depth": st.integers(1, 4)})


# The two messages that are no plain struct.


def encode_data(values: Values, buffer: Any, room: int) -> int:
    size = 8 + len(values["body"])
    assert room >= size
    lib.native_data_encode_head(values["frame_low"], values["offset"], buffer)
    ffi.buffer(buffer, size)[8:] = values["body"]
    return size


def encode_pairs(values: Values, buffer: Any, room: int) -> int:
    pairs = ffi.new("native_pair_t[]", values["pairs"])
    return int(lib.native_pairs_encode(pairs, len(pairs), values["lost"], (buffer, room)))


def read_pairs(outputs: list[Any], _: int) -> Values:
    pairs, count, lost = outputs
    names = field_names("native_pair_t")
    return {"lost": lost[0], "pairs": [{name: getattr(pairs[i], name) for name in names} for i in range(count[0])]}


def parse_pairs(data: bytes) -> tuple[Values, int] | None:
    names = field_names("native_pair_t")
    return parsed(
        native.PAIRS, data, lambda found: {"lost": found.lost, "pairs": [plain(pair, names) for pair in found.pairs]}
    )


FORMATS = [
    Format(
        "CPX route",
        ROUTES,
        cpx.ROUTE.build,
        lambda data: parsed(cpx.ROUTE, data, lambda found: plain(found, ROUTE_NAMES)),
        lambda values, buffer, _: lib.cpx_route_encode(ffi.new("cpx_route_t *", values), buffer) or 2,
        # It takes two bytes and no length: the short case is the caller's.
        lambda view, out: lib.ERR_SHORT if view.size < 2 else lib.cpx_route_decode(view.data, out) or 2,
        ("cpx_route_t *",),
        lambda outputs, _: {name: getattr(outputs[0], name) for name in ROUTE_NAMES},
    ),
    Format(
        "CPX over UART",
        packets(98),
        lambda values: cpx_uart.FRAME.build({"covered": {"value": values}}),
        parse_uart,
        encode_packet(lib.cpx_uart_encode),
        lib.cpx_uart_decode,
        ("cpx_packet_t *",),
        lambda outputs, used: {} if used == 2 else read_packet(outputs, used),
        repair=repair_uart,
    ),
    Format(
        "CPX over TCP and SPI",
        packets(1020),
        cpx_link.FRAME.build,
        parse_link,
        encode_packet(lib.cpx_link_encode),
        lib.cpx_link_decode,
        ("cpx_packet_t *",),
        read_packet,
    ),
    Format(
        "stamp message",
        any_values("stamp_t"),
        lambda values: stamp.STAMP.build({"covered": {"value": values}}),
        lambda data: parsed(stamp.STAMP, data, lambda found: plain(found.covered.value, field_names("stamp_t"))),
        lambda values, buffer, _: lib.stamp_encode(ffi.new("stamp_t *", values), buffer) or 17,
        lib.stamp_decode,
        ("stamp_t *",),
        lambda outputs, _: {name: getattr(outputs[0], name) for name in field_names("stamp_t")},
        repair=repair_stamp,
    ),
    Format(
        "echo question",
        st.fixed_dictionaries({"number": st.integers(0, 255)}),
        lambda values: stamp.QUESTION.build({"covered": {"value": values}}),
        lambda data: parsed(stamp.QUESTION, data, lambda found: plain(found.covered.value, ["number"])),
        lambda values, buffer, _: lib.echo_question_encode(values["number"], buffer) or 5,
        lib.echo_question_decode,
        ("uint8_t *",),
        lambda outputs, _: {"number": outputs[0][0]},
        repair=repair_crc16,
    ),
    Format(
        "echo answer",
        any_values("echo_answer_t"),
        lambda values: stamp.ANSWER.build({"covered": {"value": values}}),
        lambda data: parsed(stamp.ANSWER, data, lambda found: plain(found.covered.value, field_names("echo_answer_t"))),
        lambda values, buffer, _: lib.echo_answer_encode(ffi.new("echo_answer_t *", values), buffer) or 17,
        lib.echo_answer_decode,
        ("echo_answer_t *",),
        lambda outputs, _: {name: getattr(outputs[0], name) for name in field_names("echo_answer_t")},
        repair=repair_crc16,
    ),
    message("beacon", "beacon_t", "beacon", beacon.BEACON, 14, any_values("beacon_t")),
    message("stock header", "image_stock_t", "image_stock", image.STOCK_HEADER, 11, pictures("type", "size")),
    message(
        "native frame",
        "native_frame_t",
        "native_frame",
        native.FRAME,
        144,
        merged(
            any_values("native_frame_t", skew_ppb=st.integers(-(2**31), 2**31 - 1)), pictures("encoding", "body_bytes")
        ),
        repair=repair_frame,
    ),
    Format(
        "native data",
        st.fixed_dictionaries(
            {
                "frame_low": st.integers(0, 0xFFFF),
                "offset": st.integers(0, 2**32 - 1),
                "body": st.binary(min_size=1, max_size=1012),
            }
        ),
        native.DATA.build,
        lambda data: parsed(native.DATA, data, lambda found: plain(found, ["frame_low", "offset", "body"])),
        encode_data,
        lib.native_data_decode,
        ("uint16_t *", "uint32_t *", "bytes_t *"),
        lambda out, _: {
            "frame_low": out[0][0],
            "offset": out[1][0],
            "body": ffi.buffer(out[2].data, out[2].size)[:],
        },
        needed=9,
    ),
    Format(
        "native pairs",
        st.fixed_dictionaries(
            {
                "lost": st.integers(0, 2**32 - 1),
                "pairs": st.lists(any_values("native_pair_t"), min_size=1, max_size=5)
                | any_values("native_pair_t").map(lambda pair: [pair] * 48),
            }
        ),
        native.PAIRS.build,
        parse_pairs,
        encode_pairs,
        lib.native_pairs_decode,
        ("native_pair_t[48]", "size_t *", "uint32_t *"),
        read_pairs,
        repair=repair_pairs,
    ),
    message(
        "native status",
        "native_status_t",
        "native_status",
        native.STATUS,
        64,
        any_values("native_status_t"),
        repair=repair_status,
    ),
    message(
        "native log",
        "native_log_t",
        "native_log",
        native.LOG,
        52,
        any_values("native_log_t", state=st.integers(0, 9)),
        repair=repair_log,
    ),
    message("native reply", "native_reply_t", "native_reply", native.REPLY, 4, any_values("native_reply_t")),
    message(
        "native stream",
        "native_stream_t",
        "native_stream",
        native.STREAM,
        6,
        any_values("native_stream_t", dialect=st.integers(0, 1), data_max=st.just(0) | st.integers(144, 1020)),
    ),
    message("native camera", "native_camera_t", "native_camera", native.CAMERA, 14, any_values("native_camera_t")),
    nested(
        "paper stamp",
        "paper_stamp",
        paper.STAMP,
        40,
        arrange=lambda values: {"covered": {"value": values}},
        repair=repair_paper,
    ),
    nested("paper header", "paper_header", paper.HEADER, 43, values=pictures("type", "size")),
    nested("paper camera", "paper_camera", paper.CAMERA, 8),
    nested(
        "nanocockpit state",
        "nanocockpit_state",
        nanocockpit.STATE_MESSAGE,
        40,
        arrange=lambda values: {"covered": {"value": {"state": values}}},
        decode=state_only,
        repair=repair_state,
    ),
    Format(
        "nanocockpit frame",
        packets(4088),
        nanocockpit.FRAME.build,
        parse_nanocockpit,
        encode_nanocockpit,
        lib.nanocockpit_link_decode,
        ("cpx_packet_t *",),
        read_packet,
    ),
    nested("nanocockpit begin", "nanocockpit_begin", nanocockpit.BEGIN, 12),
    nested(
        "nanocockpit metadata",
        "nanocockpit_metadata",
        nanocockpit.METADATA,
        148,
        arrange=lambda values: values | {"state": values},
        values=GREY,
    ),
    nested("nanocockpit reply", "nanocockpit_reply", nanocockpit.REPLY, 25),
]
BY_NAME = {format_.name: format_ for format_ in FORMATS}


def new_outputs(format_: Format, poison: int) -> list[Any]:
    """The outputs of `decode`, every byte of them set to `poison`."""
    made = [ffi.new(kind) for kind in format_.outputs]
    for each in made:
        room = ffi.buffer(each)
        room[:] = bytes([poison]) * len(room)
    return made


def decode(format_: Format, data: bytes) -> tuple[Values, int] | None:
    """What the C makes of `data`, like Format.parse. AssertionError when it refuses and has still written."""
    outputs = new_outputs(format_, 0xA5)
    before = [ffi.buffer(each)[:] for each in outputs]
    # A block of its own and of this very size: the address sanitizer then sees a read beyond it.
    memory = ffi.new("uint8_t[]", len(data))
    ffi.buffer(memory)[:] = data
    view = ffi.new("bytes_t *", (memory, len(data)))
    used = format_.decode(view[0], *outputs)
    if used < 0:
        assert [ffi.buffer(each)[:] for each in outputs] == before, f"refused ({used}), but the output is touched"
        return None
    return format_.read(outputs, used), used


def encode(format_: Format, values: Values, poison: int) -> bytes:
    """What the C writes into a buffer full of `poison`. AssertionError when it writes beyond what it says."""
    room = 4200
    buffer = ffi.new("uint8_t[]", bytes([poison]) * room)
    used = format_.encode(values, buffer, room)
    written = ffi.buffer(buffer)[:room]
    assert written[used:] == bytes([poison]) * (room - used)
    return bytes(written[:used])
