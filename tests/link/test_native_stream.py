"""Native frames: their fields, their checks, one cause for each number that was not delivered, and asking for them."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from made_streams import (
    ANNOUNCING,
    bodies,
    causes,
    log_status,
    native,
    native_header,
    packet,
    pairs,
    pixels,
    received,
    reply,
    status,
    stock,
)

from host.link.dialects import ASKS_MAX, REPEAT_NS
from host.link.frame import PAIR_DTYPE, Frame, LostFrame
from host.link.pairs import PAIRS_KEPT
from host.link.records import LogStatus, Packet, Reply, Status
from host.link.session import SEND_PACKETS, Session
from host.protocol.errors import LocalError
from host.protocol.packets import CameraSettings

BODY = pixels(60, 50, 1)
ASK_GAP8 = bytes.fromhex("08005c054e100100") + b"\0\0"
ASK_ESP32 = bytes.fromhex("08005a054e100100") + b"\0\0"
ASK_STM32 = bytes.fromhex("080059054e100100") + b"\0\0"
ASK_ALL = ASK_GAP8 + ASK_ESP32 + ASK_STM32


def frame(number: int, **values: int) -> bytes:
    return b"".join(native(number, BODY, 60, 50, **values))


def lost(session: Session) -> dict[str, int]:
    return {cause: count for cause, count in session.counters.frames_lost.items() if count}


def only_frame(stream: bytes) -> Frame:
    (found,) = [event for event in received(stream)[0] if isinstance(event, Frame)]
    return found


def test_every_field_of_a_header() -> None:
    got = only_frame(frame(0x01020304, gap8_us=1 << 40, stm32_us=1 << 41, bound_us=77, epoch=3, stamp_sequence=5))
    assert got.pixels.tobytes() == BODY
    assert got.native is not None
    assert (got.native.frame, got.native.epoch, got.native.stamp_sequence) == (0x01020304, 3, 5)
    assert (got.native.frame_gap8_us, got.frame_stm32_us, got.native.bound_us) == (1 << 40, 1 << 41, 77)
    assert (got.native.exposure_lines, got.native.line_time_ns, got.native.digital_gain) == (100, 125_333, 64)
    assert set(got.native.counters) >= {"stamps_missed", "frames_unsent", "pairs_lost"}


def test_a_field_that_the_flags_deny_is_none() -> None:
    got = only_frame(frame(1, flags=0, stamp_age_us=0xFFFFFFFF))
    assert got.native is not None
    assert (got.frame_stm32_us, got.native.bound_us, got.native.stamp_age_us) == (None, None, None)


def test_pairs_go_with_the_next_frame() -> None:
    rows = [(7, 10_000, 10_500, 1), (8, 20_000, 20_500, 1)]
    more = [(9, 30_000, (1 << 64) - 1, 255)]
    events, session = received(frame(1) + pairs(rows) + pairs(more, lost=4) + frame(2) + frame(3))
    frames = [event for event in events if isinstance(event, Frame)]
    taken = [each.pairs for each in frames]
    assert all(each is not None and each.dtype == PAIR_DTYPE for each in taken)
    assert [len(each) for each in taken if each is not None] == [0, 3, 0]
    np.testing.assert_array_equal(taken[1], np.array(rows + more, PAIR_DTYPE))
    assert (session.counters.pairs, session.counters.pairs_lost) == (3, 4)


def test_pairs_without_frames_are_bounded_and_counted() -> None:
    session = Session("tcp", "stock")
    many = pairs([(number, 0, 0, 0) for number in range(48)])
    for _ in range(PAIRS_KEPT // 48 + 10):
        session.receive(many, 1)
    kept = session.receive(frame(1), 1)
    assert isinstance(kept[0], Frame)
    assert kept[0].pairs is not None
    assert len(kept[0].pairs) <= PAIRS_KEPT
    assert session.counters.pairs_lost == session.counters.pairs - len(kept[0].pairs)


def test_a_wrong_pixel_is_a_bad_crc() -> None:
    stream = bytearray(frame(1) + frame(2) + frame(3))
    stream[len(frame(1)) + 500] ^= 1
    events, session = received(bytes(stream))
    assert causes(events) == ["bad_crc"]
    assert bodies(events) == [BODY, BODY]
    assert lost(session) == {"bad_crc": 1}
    (bad,) = [event for event in events if isinstance(event, LostFrame)]
    assert (bad.frame, bad.received_bytes) == (2, 3000)


@pytest.mark.parametrize("missing", [1, 2, 3])
def test_a_missing_piece(missing: int) -> None:
    packets = native(2, BODY, 60, 50)
    del packets[missing]
    events, session = received(frame(1) + b"".join(packets) + frame(3))
    assert bodies(events) == [BODY, BODY]
    assert lost(session) == {"missing_data": 1}
    (bad,) = [event for event in events if isinstance(event, LostFrame)]
    start, end = (missing - 1) * 1012, min(missing * 1012, 3000)
    assert bad.body.tobytes() == BODY[:start] + bytes(end - start) + BODY[end:]
    assert bad.received_bytes == 3000 - (end - start)


def test_a_missing_header_is_counted_once() -> None:
    events, session = received(frame(1) + b"".join(native(2, BODY, 60, 50)[1:]) + frame(3))
    assert bodies(events) == [BODY, BODY]
    assert lost(session) == {"missing_data": 1}
    assert session.counters.stray_packets == 3


def test_a_piece_twice_is_ignored() -> None:
    packets = native(1, BODY, 60, 50)
    events, session = received(b"".join([*packets[:3], packets[2], *packets[3:]]))
    assert bodies(events) == [BODY]
    assert session.counters.stray_packets == 1


def test_a_piece_beyond_the_end() -> None:
    packets = native(1, BODY, 60, 50)
    beyond = packet(struct.pack("<BBHI", 0x4E, 2, 1, 2999) + b"xx")
    events, session = received(b"".join([*packets[:3], beyond]) + frame(2))
    assert causes(events) == ["overrun"]
    assert bodies(events) == [BODY]
    assert lost(session) == {"overrun": 1}


@pytest.mark.parametrize(
    ("unsent", "first_status", "second_status", "expected"),
    [
        (5, None, None, {"gap8_unsent": 5}),
        (9, None, None, {"gap8_unsent": 5}),
        (2, None, None, {"gap8_unsent": 2, "unexplained": 3}),
        (2, 10, 12, {"gap8_unsent": 2, "esp32_dropped": 2, "unexplained": 1}),
        (0, 10, 99, {"esp32_dropped": 5}),
        (0, None, 4, {"esp32_dropped": 4, "unexplained": 1}),
    ],
)
def test_numbers_that_were_skipped(
    unsent: int, first_status: int | None, second_status: int | None, expected: dict[str, int]
) -> None:
    before = b"" if first_status is None else status(first_status)
    after = b"" if second_status is None else status(second_status)
    _, session = received(before + frame(10, frames_unsent=7) + frame(16, frames_unsent=7 + unsent) + after)
    assert lost(session) == expected
    assert sum(expected.values()) == 5


def test_a_lost_frame_inside_a_gap_is_not_counted_twice() -> None:
    broken = b"".join(native(12, BODY, 60, 50, crc=1))
    _, session = received(frame(10) + broken + frame(14))
    assert lost(session) == {"bad_crc": 1, "unexplained": 2}


def test_a_restart_of_the_gap8_is_no_gap() -> None:
    _, session = received(frame(5000) + frame(0) + frame(1))
    assert lost(session) == {}
    assert session.counters.renumbered == 1


def test_numbers_wrap() -> None:
    _, session = received(frame(0xFFFFFFFE) + frame(1))
    assert lost(session) == {"unexplained": 2}


def test_the_end_in_the_middle_of_a_frame() -> None:
    events, session = received(frame(1) + frame(2)[:1500])
    assert causes(events) == ["disconnected"]
    assert lost(session) == {"disconnected": 1}


def test_messages() -> None:
    events, session = received(status(3, up_us=17) + reply(17, 5) + packet(b"\x4e\x63\x00\x00"))
    first, second, third = events
    assert isinstance(first, Status)
    assert (first.up_us, first.counters["frames_dropped"]) == (17, 3)
    assert isinstance(second, Reply)
    assert (second.request, second.status) == (17, 5)
    assert isinstance(third, Packet)
    assert session.counters.bad_messages == 1


def test_a_native_header_that_is_impossible_opens_nothing() -> None:
    bad = bytearray(native_header(1, BODY, 60, 50))
    bad[16:20] = struct.pack("<I", 0xFFFFFFFF)
    events, session = received(packet(bytes(bad)) + frame(2))
    assert bodies(events) == [BODY]
    assert session.counters.bad_messages == 1


# Asking for native frames.

STOCK = b"".join(stock(BODY, 60, 50))
STOCK_ANNOUNCING = b"".join(stock(BODY, 60, 50, route=ANNOUNCING))


def test_auto_sends_nothing_before_an_announcement() -> None:
    session = Session("tcp", "auto")
    assert session.data_to_send() == b""
    session.receive(STOCK, 1)
    session.tick(10**12)
    assert session.data_to_send() == b""
    session.receive(STOCK_ANNOUNCING[:15], 10**12 + 1)
    assert session.data_to_send() == ASK_ALL


def test_stock_never_sends() -> None:
    session = Session("tcp", "stock")
    for now in range(20):
        session.receive(STOCK_ANNOUNCING, now * REPEAT_NS)
        session.tick(now * REPEAT_NS)
        assert session.data_to_send() == b""


@pytest.mark.parametrize("dialect", ["auto", "native"])
def test_asking_is_repeated_each_second_and_ends(dialect: Any) -> None:
    session = Session("tcp", dialect)
    asked = len(session.data_to_send())
    for now in range(0, 30 * REPEAT_NS, REPEAT_NS // 4):
        session.receive(STOCK_ANNOUNCING, now)
        asked += len(session.data_to_send())
        session.tick(now + 1)
        asked += len(session.data_to_send())
    assert asked == ASKS_MAX * len(ASK_ALL)


def test_native_asks_at_once() -> None:
    assert Session("tcp", "native").data_to_send() == ASK_ALL


def test_native_frames_end_the_asking_and_a_restart_begins_it_again() -> None:
    session = Session("tcp", "auto")
    session.receive(STOCK_ANNOUNCING, 0)
    assert session.data_to_send() != b""
    session.receive(frame(1), 1)
    session.tick(5 * REPEAT_NS)
    assert session.data_to_send() == ASK_ESP32 + ASK_STM32, "their counters have not come yet"
    session.receive(status(0) + log_status(), 6 * REPEAT_NS)
    session.tick(9 * REPEAT_NS)
    assert session.data_to_send() == b""
    session.receive(STOCK_ANNOUNCING, 9 * REPEAT_NS)
    assert session.data_to_send() == ASK_ALL


def test_an_stm32_that_has_restarted_is_asked_again() -> None:
    session = Session("tcp", "native")
    session.receive(frame(1) + status(0) + log_status(), 0)
    session.data_to_send()
    asked = []
    for now in range(0, 40 * REPEAT_NS, REPEAT_NS // 4):
        session.receive(log_status() if now < 5 * REPEAT_NS else b"", now)
        session.tick(now)
        asked += [(now, data)] if (data := session.data_to_send()) else []
    assert {data for _, data in asked} == {ASK_STM32}
    assert len(asked) == ASKS_MAX
    assert 3 * REPEAT_NS < asked[0][0] - 5 * REPEAT_NS < 4 * REPEAT_NS


def test_on_uart2_there_is_no_stm32_to_ask() -> None:
    session, sent = Session("cpx-uart", "native"), b""
    for now in range(0, 10 * REPEAT_NS, REPEAT_NS // 100):
        session.receive(b"\xff\x00", now)
        sent += session.data_to_send()
    assert ASK_GAP8[2:] in sent
    assert ASK_STM32[2:] not in sent


@pytest.mark.parametrize("state", range(10))
def test_what_the_stm32_says_of_its_log(state: int) -> None:
    events, session = received(log_status(dropped=7, state=state))
    names = ["off", "starts", "on", "closes", "no_card", "no_config", "bad_config", "no_name", "full", "failed"]
    counters = {"requested": 1000, "accepted": 993, "dropped": 7, "stall_us": 250_000, "syncs": 40, "errors": 0} | {
        "card_errors": 6
    }
    assert events == [LogStatus(events[0].arrival_host_ns, names[state], 2**33, 3, 1, 0xCAFE, counters)]
    assert session.counters.bad_messages == 0


def test_a_log_message_that_is_damaged_is_counted() -> None:
    events, session = received(log_status()[:-1] + b"\0" + log_status(state=10))
    assert [type(event) for event in events] == [Packet, Packet]
    assert session.counters.bad_messages == 2


def test_camera_request() -> None:
    session = Session("tcp", "stock")
    session.request_camera(CameraSettings(auto_exposure=False, analog_gain=4, encoding="jpeg", exposure_lines=0x1234))
    sent = session.data_to_send()
    assert sent[:6] == bytes.fromhex("10005c054e11")
    assert sent[6:] == bytes([0, 4, 64, 1, 1, 0]) + b"\x34\x12" + b"\0\0\0\0"
    assert session.data_to_send() == b""


def test_wrong_settings_are_refused_with_their_range() -> None:
    with pytest.raises(LocalError, match="1, 2, 4 or 8"):
        Session().request_camera(CameraSettings(analog_gain=3))


def test_requests_that_nobody_takes_are_bounded() -> None:
    session = Session("cpx-uart", "stock")
    for _ in range(SEND_PACKETS):
        session.request_camera(CameraSettings())
    with pytest.raises(LocalError, match="faster"):
        session.request_camera(CameraSettings())


def test_a_tap_cannot_send() -> None:
    with pytest.raises(LocalError, match="only listens"):
        Session("stamps").request_camera(CameraSettings())
    assert Session("stamps", "native").data_to_send() == b""


@pytest.mark.parametrize(("framing", "dialect"), [("udp", "auto"), ("tcp", "morse")])
def test_unknown_words_are_refused(framing: Any, dialect: Any) -> None:
    with pytest.raises(LocalError, match="choose"):
        Session(framing, dialect)


def test_a_header_that_comes_twice_is_one_frame() -> None:
    packets = native(2, BODY, 60, 50)
    events, session = received(frame(1) + packets[0] + b"".join(packets) + frame(3))
    assert [event.native.frame for event in events if isinstance(event, Frame) and event.native] == [1, 2, 3]
    assert sum(session.counters.frames_lost.values()) == 0
    assert session.counters.stray_packets == 1


@pytest.mark.parametrize("byte", [4, 24, 39, 60, 99, 103])
def test_a_damaged_header_is_no_frame(byte: int) -> None:
    """Its number, its times: nothing of them is believed."""
    packets = native(2, BODY, 60, 50)
    damaged = bytearray(packets[0])
    damaged[4 + byte] ^= 0x10
    events, session = received(frame(1) + bytes(damaged) + b"".join(packets[1:]) + frame(3))
    assert [event.native.frame for event in events if isinstance(event, Frame) and event.native] == [1, 3]
    assert session.counters.frames_lost["missing_data"] == 1
    assert session.counters.bad_messages == 1


def test_after_stock_frames_the_numbers_begin_anew() -> None:
    """The GAP8 has restarted: which numbers were skipped is not known, whether the new ones are lower or not."""
    _, session = received(frame(1) + STOCK_ANNOUNCING + frame(9) + frame(10))
    assert sum(session.counters.frames_lost.values()) == 0
    assert session.counters.renumbered == 1
