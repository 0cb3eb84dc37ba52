"""The stock image stream, to the byte."""

import struct

import pytest
from c_memory import POISONS
from gap8_rig import GAP8_STOCK, JPEG, RAW, capture, gap8, picture, sent, stock


@pytest.mark.parametrize("poison", POISONS)
def test_raw_qvga_is_the_stock_stream_but_for_one_reserved_bit(poison: int) -> None:
    app = gap8(324, 244, poison=poison)
    body = picture(79056)
    capture(app, body)
    assert app.transmit("SPI", 0) == bytes.fromhex("0d00 e305 bc 4401 f400 01 00 d0340100")
    packets = sent(app)
    assert packets == stock(324, 244, RAW, [body])[1:]
    assert len(packets) == 78
    assert len(packets[-1]) == 2 + 516


def test_stock_firmware_leaves_the_reserved_bit_alone() -> None:
    app = gap8(324, 244, firmware=GAP8_STOCK)
    capture(app, picture(79056))
    assert app.transmit("SPI", 0) == bytes.fromhex("0d00 6305 bc 4401 f400 01 00 d0340100")


@pytest.mark.parametrize(("width", "height"), [(1, 1), (102, 10), (102, 100), (1020, 1), (1021, 1), (324, 324)])
def test_a_body_is_never_followed_by_an_empty_packet(width: int, height: int) -> None:
    app = gap8(width, height)
    body = picture(width * height)
    capture(app, body)
    assert sent(app) == stock(width, height, RAW, [body])


def jpeg(segment_bytes: int, data: bytes) -> list[bytes]:
    """File header, data and footer of something built as a JPEG file is."""
    segment = b"\xff\xdb" + struct.pack(">H", segment_bytes + 2) + b"q" * segment_bytes
    return [b"\xff\xd8" + segment + b"\xff\xda\x00\x08" + b"s" * 6, data, b"\xff\xd9"]


@pytest.mark.parametrize("data_bytes", [1, 4, 1019, 1020, 1021, 2040, 9000])
@pytest.mark.parametrize("segment_bytes", [64, 1004, 1005, 3000])
def test_a_jpeg_goes_as_file_header_data_and_footer(segment_bytes: int, data_bytes: int) -> None:
    parts = jpeg(segment_bytes, picture(data_bytes))
    app = gap8(camera={"encoding": JPEG})
    command = capture(app, b"".join(parts))
    assert command[1] == JPEG
    assert sent(app) == stock(60, 40, JPEG, parts)


BROKEN_JPEGS = {
    "one byte": b"\xff",
    "two bytes": b"\xff\xd8",
    "noise": picture(3000),
    "no SOS": b"\xff\xd8\xff\xdb\x00\x04qq" + bytes(2000),
    "cut in the file header": jpeg(500, b"")[0][:300],
    "segment beyond the end": b"\xff\xd8\xff\xda\xff\xff" + bytes(3000),
    "segments without end": b"\xff\xd8" + b"\xff\xdb\x00\x00" * 500,
    "footer only": b"\xff\xd9",
}


@pytest.mark.parametrize("body", BROKEN_JPEGS.values(), ids=BROKEN_JPEGS.keys())
def test_a_broken_jpeg_goes_as_it_is(body: bytes) -> None:
    app = gap8(camera={"encoding": JPEG})
    capture(app, body)
    assert sent(app) == stock(60, 40, JPEG, [body])


def test_a_jpeg_without_its_footer_keeps_all_its_bytes() -> None:
    header, data, _ = jpeg(100, picture(5000))
    app = gap8(camera={"encoding": JPEG})
    capture(app, header + data)
    assert sent(app) == stock(60, 40, JPEG, [header, data])
