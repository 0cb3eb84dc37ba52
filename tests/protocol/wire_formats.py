"""One entry per format of the wires. test_formats.py runs the same six tests over all of them."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st
from wire_format import Format, Values, field_names, parsed, plain
from wire_messages import any_values, merged, message, nested
from wire_packets import (
    ROUTE_NAMES,
    ROUTES,
    encode_nanocockpit,
    encode_packet,
    packets,
    parse_link,
    parse_nanocockpit,
    parse_uart,
    read_packet,
)
from wire_repairs import (
    repair_crc16,
    repair_frame,
    repair_log,
    repair_pairs,
    repair_paper,
    repair_stamp,
    repair_state,
    repair_status,
    repair_uart,
)

from host.native import ffi, lib
from host.protocol.spec import beacon, cpx, cpx_link, cpx_uart, image, nanocockpit, native, paper, stamp

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


GREY = st.fixed_dictionaries({"width": SIDES, "height": SIDES, "depth": st.integers(1, 4)})


def state_only(view: Any, out: Any) -> int:
    """nanocockpit_uart_decode as far as the message with a state goes."""
    used = lib.nanocockpit_uart_decode(view, out)
    return used if used < 0 or used == lib.NANOCOCKPIT_STATE_BYTES else lib.ERR_START


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
