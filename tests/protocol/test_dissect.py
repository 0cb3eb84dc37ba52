"""Every byte of a capture is accounted for, whatever it is; what is known is named; what is not is explained."""

from __future__ import annotations

import random
import struct
import zlib

import crcmod.predefined
import pytest
from hypothesis import given
from hypothesis import strategies as st

from host.protocol.dissect import SPLITTERS, Framing, Piece, guess, split
from host.protocol.explain import Explainer, Meaning

FRAMINGS: list[Framing] = list(SPLITTERS)


def tcp(data: bytes, route: bytes = b"\x63\x05") -> bytes:
    return struct.pack("<H", len(data) + 2) + route + data


def uart(data: bytes, route: bytes = b"\x63\x05") -> bytes:
    frame = bytes([0xFF, len(data) + 2]) + route + data
    check = 0
    for byte in frame:
        check ^= byte
    return frame + bytes([check])


STAMP = bytes.fromhex("d52a0700000040e201000000000003")
STAMP += struct.pack("<H", crcmod.predefined.mkPredefinedCrcFun("crc-ccitt-false")(STAMP[2:]))
HEADER = bytes.fromhex("bc 3c 00 32 00 01 00 b8 0b 00 00")  # 60 x 50 raw
BODY = random.Random(1).randbytes(3000)
IMAGE = [tcp(HEADER), tcp(BODY[:1020]), tcp(BODY[1020:2040]), tcp(BODY[2040:])]
CONNECT = bytes.fromhex("04 00 0a 04 20 01")


def pieces(data: bytes, framing: Framing) -> list[Piece]:
    """All of them, after a look at whether they are all of the bytes."""
    found = list(split(data, framing))
    at = 0
    for piece in found:
        assert piece.offset == at
        assert piece.size > 0
        at += piece.size
    assert at == len(data)
    return found


def kinds(data: bytes, framing: Framing) -> list[tuple[str, int]]:
    return [(piece.kind, piece.size) for piece in pieces(data, framing)]


def meanings(data: bytes, framing: Framing) -> list[Meaning]:
    explainer = Explainer(framing)
    return [explainer.explain(piece) for piece in pieces(data, framing) if piece.kind in ("packet", "stamp")]


def values(meaning: Meaning) -> dict[str, object]:
    return {field.name: field.value for field in meaning.fields}


FRAGMENTS = st.sampled_from(
    [
        *(tcp(HEADER), CONNECT, tcp(b"\x4e\x02abcdef"), tcp(b"hi\0", b"\x63\x02"), tcp(b"x", b"\x63\x45")),
        *(uart(b"hi", b"\x51\x04"), b"\xff\x00", uart(bytes(98), b"\x23\x05"), b"\xff\x62\xff", STAMP, STAMP[:9]),
        uart(b"\x4e\x02", b"\x30\x05"),  # from nobody to nobody
        *(bytes(8), bytes.fromhex("03 00 54 0f 06 00 00 00"), b"\x4e", b"\xfe\x03\x63\x05"),
    ]
)
CAPTURES = st.lists(st.one_of(FRAGMENTS, st.binary(max_size=40)), max_size=12).map(b"".join)


@pytest.mark.parametrize("framing", FRAMINGS)
@given(data=CAPTURES)
def test_any_bytes_are_accounted_for(framing: Framing, data: bytes) -> None:
    for meaning in meanings(data, framing):
        assert meaning.about


@given(data=CAPTURES)
def test_any_bytes_have_a_guess(data: bytes) -> None:
    framing, part = guess(data)
    assert framing in FRAMINGS
    assert 0 <= part <= 1


@pytest.mark.parametrize("framing", FRAMINGS)
@pytest.mark.parametrize("byte", [b"\x00", b"\xff", b"\x02", b"\x4e", b"\xd5"])
def test_the_same_byte_for_ever(framing: Framing, byte: bytes) -> None:
    meanings(byte * 5000, framing)


@pytest.mark.parametrize("framing", FRAMINGS)
def test_random_bytes_in_bulk(framing: Framing) -> None:
    meanings(random.Random(7).randbytes(100_000), framing)


def test_every_cut_of_a_tcp_capture() -> None:
    """Whatever the end of the capture cuts, what is before it is the same, and the rest is said to be cut."""
    whole = CONNECT + tcp(HEADER) + tcp(b"hi\0", b"\x63\x02")
    ends = [0, 6, 21, 28]
    for size in range(len(whole) + 1):
        found = kinds(whole[:size], "tcp")
        packets = max(number for number, end in enumerate(ends) if end <= size)
        assert [kind for kind, _ in found[:packets]] == ["packet"] * packets
        assert found[packets:] == ([("truncated", size - ends[packets])] if size > ends[packets] else [])


def test_an_image_is_followed_over_its_packets() -> None:
    console = tcp(b"hello\0", b"\x63\x02")
    made = meanings(IMAGE[0] + IMAGE[1] + console + IMAGE[2] + IMAGE[3], "tcp")
    assert [meaning.about for meaning in made] == [
        "stock image header",
        "image body, bytes 0..1019 of 3000",
        "console",
        "image body, bytes 1020..2039 of 3000",
        "image body, bytes 2040..2999 of 3000, the last ones",
    ]
    assert values(made[0]) == {"width": 60, "height": 50, "depth": 1, "type": 0, "size": 3000}
    assert values(made[2]) == {"text": "hello"}


def test_an_image_that_was_cut_short_is_told_at_the_next_header() -> None:
    made = meanings(IMAGE[0] + IMAGE[1] + b"".join(IMAGE), "tcp")
    assert made[2].about == "stock image header; the image before lacks 1980 of 3000 bytes"
    assert made[-1].about.endswith("the last ones")


@pytest.mark.parametrize("garbage", [b"\xff\xff\xff", b"\x00", bytes(2), random.Random(3).randbytes(50)])
def test_garbage_in_tcp_is_located_and_costs_no_packet(garbage: bytes) -> None:
    before, behind = CONNECT * 2, b"".join(IMAGE)
    found = pieces(before + garbage + behind, "tcp")
    assert [(piece.kind, piece.offset, piece.size) for piece in found if piece.kind != "packet"] == [
        ("garbage", len(before), len(garbage))
    ]
    assert len([piece for piece in found if piece.kind == "packet"]) == 6
    assert next(piece.about for piece in found if piece.kind == "garbage")


def test_a_wrong_length_is_found_out() -> None:
    """The packet with it is the garbage, and not what it seems to contain."""
    damaged = bytearray(tcp(b"hello", b"\x63\x02"))
    damaged[0] += 9
    found = pieces(CONNECT + bytes(damaged) + CONNECT * 4, "tcp")
    assert [(piece.kind, piece.size) for piece in found] == [("packet", 6), ("garbage", 9), *[("packet", 6)] * 4]
    assert found[1].about.startswith("length 16 leads to no header")


@pytest.mark.parametrize(
    ("header", "says"),
    [
        (b"\x01\x00\x63\x05", "length 1"),
        (b"\xff\x03\x63\x05", "length 1023"),
        (b"\x06\x00\x03\x05", "source 0"),
        (b"\x06\x00\x67\x05", "destination 7"),
    ],
)
def test_why_a_header_is_garbage(header: bytes, says: str) -> None:
    garbage = pieces(header + CONNECT * 4, "tcp")[0]
    assert garbage.kind == "garbage"
    assert garbage.about.startswith(says)


def test_odd_packets_are_believed_when_another_follows() -> None:
    odd = tcp(b"abc", b"\x63\x45")  # version 1
    assert kinds(odd + CONNECT, "tcp") == [("packet", 7), ("packet", 6)]
    assert meanings(odd + CONNECT, "tcp")[0].about == "no receiver knows what to do with it"
    assert kinds(odd + b"\x01" + CONNECT * 3, "tcp")[0] == ("garbage", 8)


def test_uart_frames_credits_and_damage() -> None:
    good = bytes.fromhex("ff 04 0a 04 20 01 d4")
    bad = good[:-1] + b"\xd5"
    found = pieces(b"\xff\x00" + good + bad + b"\x00" + good + good[:4], "cpx-uart")
    assert [(piece.kind, piece.size) for piece in found] == [
        ("credit", 2), ("packet", 7), ("garbage", 8), ("packet", 7), ("truncated", 4),
    ]  # fmt: skip
    assert found[2].about == "check byte of 7 bytes is 0xD5, should be 0xD4"
    assert found[4].about == "the capture ends after 4 of 7 bytes of a frame"


def test_a_frame_inside_a_frame_that_never_ended() -> None:
    found = pieces(b"\xff\x62\x63\x05" + uart(b"hi", b"\x51\x04"), "cpx-uart")
    assert [(piece.kind, piece.size) for piece in found] == [("garbage", 4), ("packet", 7)]
    assert "no more than 4 bytes" in found[0].about


def test_a_native_message_in_pieces_on_the_uart() -> None:
    status = struct.pack("<BBHQ12I", 0x4E, 4, 0, 77, *range(12))
    pairs = struct.pack("<BBBBI", 0x4E, 3, 5, 0, 9) + b"".join(struct.pack("<IQQB", i, i, i, 0) for i in range(5))
    status, pairs = (message + struct.pack("<I", zlib.crc32(message)) for message in (status, pairs))
    assert len(status) < 98 < len(pairs)
    made = meanings(
        uart(status, b"\x53\x05") + uart(pairs[:98], b"\x23\x05") + b"\xff\x00" + uart(pairs[98:]), "cpx-uart"
    )
    assert [meaning.about for meaning in made] == [
        "native status",
        "a message in pieces, 98 bytes so far",
        "native pairs",
    ]
    assert values(made[0])["up_us"] == 77
    assert values(made[2])["lost"] == 9
    assert values(made[2])["pairs"] == [{"sequence": i, "stm32_us": i, "gap8_us": i, "epoch": 0} for i in range(5)]


def test_stamps() -> None:
    damaged = STAMP[:5] + b"\x55" + STAMP[6:]
    found = pieces(STAMP + damaged + b"\xd5" + STAMP + STAMP[:16], "stamps")
    assert [(piece.kind, piece.size) for piece in found] == [
        ("stamp", 17), ("garbage", 18), ("stamp", 17), ("truncated", 16),
    ]  # fmt: skip
    assert found[1].about.startswith("CRC-16 of a stamp message is")
    made = meanings(STAMP, "stamps")[0]
    assert values(made) == {"sequence": 7, "stm32_us": 123456, "epoch": 3}
    assert [field.meaning for field in made.fields if field.name == "stm32_us"] == [
        "us, STM32 stamp clock when the first byte starts to leave"
    ]


def test_spi_windows() -> None:
    boot = bytes.fromhex("03 00 54 0f 06") + b"\xaa\xaa\xaa"  # what lies behind a packet means nothing
    found = pieces(bytes(8) + boot + bytes(16) + boot + CONNECT + b"\xbb\xbb", "spi")
    assert [(piece.kind, piece.size) for piece in found] == [
        ("idle", 8), ("packet", 8), ("idle", 16), ("packet", 8), ("packet", 8),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("data", "framing"),
    [
        (b"".join(IMAGE), "tcp"),
        (uart(b"hi", b"\x51\x04") + b"\xff\x00" * 3, "cpx-uart"),
        (b"\xff\x00" * 3, "cpx-uart"),
        (STAMP * 3, "stamps"),
        (bytes(8) + bytes.fromhex("03 00 54 0f 06 00 00 00") * 3, "spi"),
    ],
)
def test_guess(data: bytes, framing: Framing) -> None:
    assert guess(data)[0] == framing
    assert guess(b"\x13\x37" + data)[0] == framing


def test_keys_are_not_shown_unless_asked() -> None:
    packet = tcp(b"\x11secret-key", b"\x1a\x04")
    assert "secret-key" not in repr(meanings(packet, "tcp"))
    piece = pieces(packet, "tcp")[0]
    assert values(Explainer("tcp", show_keys=True).explain(piece))["argument"] == "secret-key"


def test_the_papers_header_begins_an_image_and_its_numbers_may_be_none() -> None:
    header = HEADER + struct.pack("<I7f", 1234, 0.5, -0.25, 1.0, float("nan"), 0.0, float("inf"), 1.0)
    made = meanings(tcp(header) + b"".join(IMAGE[1:]), "tcp")
    assert made[0].about == "image header of the paper's firmware"
    values = {each.name: each.value for each in made[0].fields}
    assert values["frame_stm32_ms"] == 1234
    assert values["x_m"] == 0.5
    assert (values["qx"], values["qz"]) == ("nan", "inf")
    assert made[-1].about.endswith("the last ones")


def test_the_papers_camera_settings() -> None:
    (made,) = meanings(tcp(bytes.fromhex("00 00 08 01 32 00 01 01"), route=b"\x4c\x05"), "tcp")
    assert made.about == "camera settings of the paper's firmware"
    assert {each.name: each.value for each in made.fields}["exposure_lines"] == 50
