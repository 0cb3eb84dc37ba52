"""What is not a layout: constants, ranges, buffers that are too small, and the documentation."""

import math
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wire_formats import BY_NAME
from wire_messages import any_values
from wire_packets import new_packet

from host.link.headers import NanocockpitState
from host.native import ffi, lib
from host.protocol.spec import beacon, cpx, cpx_link, nanocockpit, native, paper, stamp, tables
from host.protocol.spec.values import Value

ROOT = Path(__file__).resolve().parents[2]
seeded = settings(derandomize=True, deadline=None, max_examples=200)

STATED = [value for listed in (tables.CODES | tables.LIMITS).values() for value in listed]


@pytest.mark.parametrize("value", STATED, ids=lambda value: value.name)
def test_constants_agree(value: Value) -> None:
    assert getattr(lib, value.name) == value.number


def test_sizes_agree() -> None:
    assert beacon.BEACON.sizeof() == lib.BEACON_BYTES
    assert stamp.STAMP.sizeof() == lib.STAMP_BYTES
    assert native.PAIR.sizeof() == lib.NATIVE_PAIR_BYTES
    for name in ("REPLY", "STREAM", "CAMERA", "STATUS", "LOG"):
        assert getattr(native, name).sizeof() == getattr(lib, f"NATIVE_{name}_BYTES")
    assert paper.STAMP.sizeof() == lib.PAPER_STAMP_BYTES
    for name in ("BEGIN", "MORE", "METADATA"):
        assert getattr(nanocockpit, name).sizeof() == getattr(lib, f"NANOCOCKPIT_{name}_BYTES")
    for name in ("STATE", "NOISE", "RANGES"):
        assert getattr(nanocockpit, f"{name}_MESSAGE").sizeof() == getattr(lib, f"NANOCOCKPIT_{name}_BYTES")


def test_routers_forward_alike() -> None:
    for first in range(256):
        for second in (0x00, 0x05, 0x3F, 0x45, 0x85, 0xC5):
            wire = bytes([first, second])
            route = ffi.new("cpx_route_t *")
            lib.cpx_route_decode(wire, route)
            assert lib.cpx_route_ok(route) == cpx.forwardable(cpx.ROUTE.parse(wire)), wire.hex()


@given(any_values("native_camera_t"), st.integers(0, 6), st.sampled_from([0, 1, 2, 3, 4, 8, 9, 10_000_000, 10_000_001]))
@seeded
def test_camera_ranges_agree(settings_: dict[str, int], place: int, edge: int) -> None:
    """One field at an edge, the others in range; and every field anywhere."""
    good = {name: allowed[-1] for name, allowed in native.CAMERA_RANGES}
    name = native.CAMERA_RANGES[place][0]
    one_off = good | {name: edge if name == "frame_period_us" else edge % 256}
    for camera in (good, one_off, settings_):
        assert lib.native_camera_check(ffi.new("native_camera_t *", camera)) == native.camera_check(camera)


@given(st.integers(4, 1024), st.integers(4, 1024))
@seeded
def test_spi_windows_agree(master_size: int, slave_size: int) -> None:
    window = lib.cpx_spi_window_bytes(master_size, slave_size)
    assert window == cpx_link.window_bytes(master_size, slave_size)
    assert window % 4 == 0
    assert max(master_size, slave_size, 8) <= window < max(master_size, slave_size, 8) + 4


UNIT = st.tuples(*[st.floats(-1, 1, width=32)] * 4).filter(lambda q: sum(x * x for x in q) > 0.01)


@given(UNIT)
@seeded
def test_packed_quaternions_agree(raw: tuple[float, ...]) -> None:
    """The same bits, and the same rotation to within half a step of each component."""
    size = math.sqrt(sum(x * x for x in raw))
    unit = struct.unpack("4f", struct.pack("4f", *(x / size for x in raw)))
    packed = lib.nanocockpit_quat(unit)
    near = [abs(abs(x) * 511 * math.sqrt(2) % 1 - 0.5) for x in unit]
    if min(near) > 1e-3 and len({abs(x) for x in unit}) == 4:  # no rounding, no tie on the edge
        assert packed == nanocockpit.quat(unit)
    found = NanocockpitState(0, *[0] * 9, packed, 0, 0, 0).quaternion
    sign = 1 if sum(a * b for a, b in zip(found, unit, strict=True)) > 0 else -1
    assert max(abs(a - sign * b) for a, b in zip(found, unit, strict=True)) < 0.0031
    assert sum(x * x for x in found) == pytest.approx(1)


def test_a_quaternion_that_is_none_still_packs() -> None:
    for raw in ((0, 0, 0, 0), (math.nan,) * 4, (math.inf, 1, 2, 3), (0, 0, 0, 1e30)):
        assert 0 <= lib.nanocockpit_quat(raw) < 2**32


def test_a_check_of_nought_is_sent_as_all_ones() -> None:
    nought = bytes.fromhex("9d0ad96d")  # whose CRC-32 is 0
    assert zlib.crc32(nought) == 0
    memory = ffi.from_buffer("uint8_t[]", nought)
    assert lib.nanocockpit_check(0, (memory, 4)) == nanocockpit.check(nought) == 0xFFFFFFFF
    assert lib.nanocockpit_check(zlib.crc32(nought[:2]), (memory + 2, 2)) == 0xFFFFFFFF
    assert lib.nanocockpit_check(0, (memory, 3)) == nanocockpit.check(nought[:3]) == zlib.crc32(nought[:3])


@pytest.mark.parametrize(
    ("wire", "size"),
    [
        (nanocockpit.NOISE_MESSAGE.build({"covered": {"value": {"noise": 77}}}), 12),
        (nanocockpit.RANGES_MESSAGE.build({"covered": {"value": {"count": 16, "ranges": bytes(range(64))}}}), 76),
    ],
)
def test_messages_that_are_skipped(wire: bytes, size: int) -> None:
    """They are checked all the same, and touch nothing."""
    state = ffi.new("nanocockpit_state_t *", {"stm32_time": 5})

    def decode(data: bytes) -> int:
        return int(lib.nanocockpit_uart_decode((ffi.from_buffer("uint8_t[]", data), len(data)), state))

    assert len(wire) == size == decode(wire) == decode(wire + b"more")
    assert [decode(wire[:cut]) for cut in range(size)] == [lib.ERR_SHORT] * size
    for bit in range(32, 8 * size):
        damaged = bytearray(wire)
        damaged[bit // 8] ^= 1 << bit % 8
        assert decode(bytes(damaged)) == lib.ERR_CHECK
    assert state.stm32_time == 5


def test_heads_of_more_packets() -> None:
    out = ffi.new("uint8_t[4]", b"\xa5" * 4)
    lib.nanocockpit_more_encode(out)
    assert bytes(out) == nanocockpit.MORE.build({})

    def decode(data: bytes) -> int:
        return int(lib.nanocockpit_more_decode((ffi.from_buffer("uint8_t[]", data), len(data))))

    assert [decode(b"\x11\x01\x02\x03\x04"[:cut]) for cut in range(6)] == [lib.ERR_SHORT] * 4 + [4, 4]
    assert decode(b"\x10\0\0\0") == lib.ERR_START


PACKET = {"route": {}, "data": bytes(40)}
PAIRS = {"lost": 1, "pairs": [{"sequence": 1}] * 3}


@pytest.mark.parametrize(
    ("name", "values"), [("CPX over UART", PACKET), ("CPX over TCP and SPI", PACKET), ("native pairs", PAIRS)]
)
def test_too_small_a_buffer_is_left_alone(name: str, values: dict[str, object]) -> None:
    encode = BY_NAME[name].encode
    whole = encode(values, ffi.new("uint8_t[1024]"), 1024)
    for room in range(whole):
        buffer = ffi.new("uint8_t[]", b"\xa5" * 1024)
        assert encode(values, buffer, room) == 0
        assert ffi.buffer(buffer)[:1024] == b"\xa5" * 1024
    assert encode(values, ffi.new("uint8_t[]", whole), whole) == whole


@pytest.mark.parametrize(("encode", "data_max"), [(lib.cpx_uart_encode, 98), (lib.cpx_link_encode, 1020)])
def test_too_much_data_is_refused(encode: object, data_max: int) -> None:
    assert callable(encode)
    out = ffi.new("uint8_t[2000]")
    for size, written in ((data_max, True), (data_max + 1, False)):
        packet, _data = new_packet({"route": {}, "data": bytes(size)})
        assert (encode(packet, (out, 2000)) > 0) == written


def test_pairs_are_one_to_forty_eight() -> None:
    out = ffi.new("uint8_t[2000]")
    pairs = ffi.new("native_pair_t[49]")
    assert lib.native_pairs_encode(pairs, 0, 0, (out, 2000)) == 0
    assert lib.native_pairs_encode(pairs, 48, 0, (out, 2000)) == 8 + 48 * 21 + 4
    assert lib.native_pairs_encode(pairs, 49, 0, (out, 2000)) == 0


def test_documentation_is_what_the_specification_says() -> None:
    check = [sys.executable, "-m", "host.protocol.spec.tables", "--check", "docs/PROTOCOL.md"]
    done = subprocess.run(check, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_documentation_has_every_table() -> None:
    text = (ROOT / "docs/PROTOCOL.md").read_text(encoding="utf-8")
    shown = {match["name"] for match in tables.MARKED.finditer(text)}
    assert shown == set(tables.LAYOUTS | tables.CODES | tables.LIMITS)
    assert text.count("<!-- table: ") == len(shown)


def test_a_stale_table_is_found_and_mended(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- table: targets -->\n| old |\n<!-- end -->\nafter\n", encoding="utf-8")
    run = [sys.executable, "-m", "host.protocol.spec.tables", str(page)]
    assert subprocess.run([*run, "--check"], cwd=ROOT, capture_output=True).returncode == 1
    assert subprocess.run(run, cwd=ROOT).returncode == 0
    assert "old" not in page.read_text(encoding="utf-8")
    assert "CPX_GAP8" in page.read_text(encoding="utf-8")
    assert subprocess.run([*run, "--check"], cwd=ROOT).returncode == 0
