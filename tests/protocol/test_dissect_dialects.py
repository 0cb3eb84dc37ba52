"""The bytes of NanoCockpit's and of the dataset paper's firmware: literal vectors, cut, damaged and in pieces."""

from __future__ import annotations

import json
import zlib
from pathlib import Path

import pytest

from host.protocol.dissect import guess, split
from host.protocol.explain import Explainer, Meaning

VECTORS = json.loads((Path(__file__).resolve().parents[1] / "vectors" / "dialects.json").read_text(encoding="utf-8"))
HEX = {each["format"]: bytes.fromhex(each["hex"]) for each in VECTORS}
VALUES = {each["format"]: each["values"] for each in VECTORS}
PIXELS = bytes(range(24))
IMAGE = HEX["nanocockpit metadata"] + PIXELS


def packet(data: bytes, route: bytes = b"\x63\x06") -> bytes:
    return len(data).to_bytes(2, "little") + route + data


def buffer(body: bytes, first: int, check: int, size: int | None = None, kind: int = 1) -> list[bytes]:
    """In a first packet with so much of it, and others of 8 bytes, the last one padded to fours."""
    size = len(body) if size is None else size
    head = bytes([0x10, kind]) + size.to_bytes(4, "little") + check.to_bytes(4, "little") + b"\0\0"
    made = [packet(head + body[:first])]
    rest = [body[at : at + 8] for at in range(first, len(body), 8)]
    return made + [packet(b"\x11\0\0\0" + part + b"\xa5" * (-len(part) % 4)) for part in rest]


def meanings(data: bytes, framing: str) -> list[Meaning]:
    explainer = Explainer(framing)  # type: ignore[arg-type]
    return [explainer.explain(piece) for piece in split(data, framing)]  # type: ignore[arg-type]


def values(meaning: Meaning) -> dict[str, object]:
    return {each.name: each.value for each in meaning.fields}


@pytest.mark.parametrize("name", ["paper stamp", "nanocockpit state"])
def test_a_message_on_uart1_and_every_cut_of_it(name: str) -> None:
    message = HEX[name]
    (made,) = meanings(message, "stamps")
    assert values(made) == VALUES[name]
    for size in range(1, len(message)):
        kinds = [(piece.kind, piece.size) for piece in split(message + message[:size], "stamps")]
        assert kinds == [("stamp", len(message)), ("truncated", size)]


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("paper stamp", "check byte of a paper stamp message is 0xEB, should be 0x"),
        ("nanocockpit state", "CRC-32 of a nanocockpit state message is 0xAEA492FC, should be 0x"),
    ],
)
def test_a_damaged_message_is_located_and_costs_no_other(name: str, says: str) -> None:
    damaged = bytearray(HEX[name])
    damaged[20] ^= 0x10
    found = list(split(HEX[name] + bytes(damaged) + HEX[name], "stamps"))
    assert [(piece.kind, piece.offset, piece.size) for piece in found] == [
        ("stamp", 0, 40), ("garbage", 40, 40), ("stamp", 80, 40),
    ]  # fmt: skip
    assert found[1].about.startswith(says)


def test_the_other_messages_of_nanocockpit() -> None:
    noise = b"!RNG" + (77).to_bytes(4, "little")
    ranges = b"!TOF" + b"\x10\xee\xee\xee" + bytes(range(64))
    data = b"".join(each + zlib.crc32(each).to_bytes(4, "little") for each in (noise, ranges))
    assert [(piece.layout, piece.size) for piece in split(data, "stamps")] == [
        ("nanocockpit noise", 12), ("nanocockpit ranges", 76),
    ]  # fmt: skip
    assert [values(made) for made in meanings(data, "stamps")] == [{"noise": 77}, {"count": 16}]


def test_an_image_of_nanocockpit_with_its_check() -> None:
    parts = buffer(IMAGE, 150, zlib.crc32(IMAGE))
    made = meanings(b"".join(parts), "nanocockpit")
    assert [meaning.about for meaning in made] == [
        "image, bytes 0..149 of 172",
        "image, bytes 150..157 of 172",
        "image, bytes 158..165 of 172",
        "image, bytes 166..171 of 172, the last ones; the check is right",
    ]
    expected = dict(VALUES["nanocockpit metadata"])
    expected["ranges"] = expected["ranges"][:16]
    assert values(made[0]) == {"type": 1, "size": 172, "check": zlib.crc32(IMAGE), **expected}
    assert next(each.words for each in made[0].fields if each.name == "type") == "IMAGE"
    for at in (149, 171):  # in the first packet, in the last
        damaged = IMAGE[:at] + bytes([IMAGE[at] ^ 1]) + IMAGE[at + 1 :]
        made = meanings(b"".join(buffer(damaged, 150, zlib.crc32(IMAGE))), "nanocockpit")
        assert made[-1].about.endswith(f"the check is wrong, {zlib.crc32(damaged)} here")


def test_an_image_without_a_check_or_without_its_end() -> None:
    whole, cut = buffer(IMAGE, 150, 0), buffer(IMAGE, 150, 0)[:2]
    made = meanings(b"".join([*cut, *whole]), "nanocockpit")
    assert made[2].about == "image, bytes 0..149 of 172; the buffer before lacks 14 of 172 bytes"
    assert made[-1].about.endswith("the last ones; no check was sent")
    made = meanings(b"".join(whole[1:]), "nanocockpit")
    assert made[0].about.startswith("no buffer is under way")
    (made_,) = meanings(packet(b"\x10\x01" + (160).to_bytes(4, "little") + bytes(6) + IMAGE), "nanocockpit")
    assert made_.about == "image, bytes 0..159 of 160 and 12 more than announced, the last ones; no check was sent"


def test_the_hosts_answer() -> None:
    reply = HEX["nanocockpit reply"]
    (made,) = meanings(
        packet(HEX["nanocockpit begin"][:1] + b"\xf0\x19" + bytes(9) + reply, b"\x5c\x06"), "nanocockpit"
    )
    assert made.about.startswith("answer to a frame, bytes 0..24 of 25")
    assert values(made) == {"type": 0xF0, "size": 25, "check": 0, **VALUES["nanocockpit reply"]}


@pytest.mark.parametrize(
    "data", [b"\x10", b"\x11", b"\x10\x01\x05", b"\x12abc", b"\x10\x77" + bytes(10), b"\x10" + bytes(40)]
)
def test_odd_buffers_are_no_crash(data: bytes) -> None:
    made = meanings(b"".join(buffer(IMAGE, 150, 0)) + packet(data), "nanocockpit")
    assert made[-1].about


@pytest.mark.parametrize("garbage", [b"\xff\xff\xff", b"\x00", bytes(range(200, 250)), b"\x00\x10\x63\x06\x10"])
def test_garbage_between_packets_costs_none(garbage: bytes) -> None:
    before, behind = b"".join(buffer(IMAGE, 150, 0)), b"".join(buffer(IMAGE, 140, 0))
    found = [piece for piece in split(before + garbage + behind, "nanocockpit") if piece.kind != "packet"]
    assert [(piece.kind, piece.offset, piece.size) for piece in found] == [("garbage", len(before), len(garbage))]


def test_every_cut_of_a_packet() -> None:
    whole = b"".join(buffer(IMAGE, 150, 0))
    for size in range(1, len(whole)):
        kinds = [piece.kind for piece in split(whole[:size], "nanocockpit")]
        assert set(kinds) <= {"packet", "truncated"}
        # By the rule of CPX the first header announces 164 bytes: cut there, nothing speaks against that.
        assert guess(whole[:size])[0].startswith("nanocockpit") or size < 8 or size == 164


@pytest.mark.parametrize(
    ("data", "framing"),
    [
        (HEX["paper stamp"] * 2, "stamps"),
        (HEX["nanocockpit state"], "stamps"),
        (b"".join(buffer(IMAGE, 150, 0)), "nanocockpit"),
        (b"".join(part + bytes(8) for part in buffer(IMAGE, 148, 0)), "nanocockpit-spi"),
        (b"\x2d\x00\x63\x05" + HEX["paper header"] + b"\x0a\x00\x63\x05" + bytes(8), "tcp"),
        (bytes(5000), "spi"),
        (bytes(100_000) + bytes.fromhex("03 00 54 0f 06 00 00 00") + bytes(100_000), "spi"),
        (bytes(100_000) + b"".join(buffer(IMAGE, 148, 0)) + bytes(100_000), "nanocockpit-spi"),
    ],
)
def test_guess(data: bytes, framing: str) -> None:
    assert guess(data) == (framing, pytest.approx(1, abs=0.01))
