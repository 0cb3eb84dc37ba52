"""What is not a layout: constants, ranges, buffers that are too small, and the documentation."""

import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wire_formats import BY_NAME, any_values, new_packet

from host.native import ffi, lib
from host.protocol.spec import cpx, cpx_link, native, stamp, tables
from host.protocol.spec.values import Value

ROOT = Path(__file__).resolve().parents[2]
seeded = settings(derandomize=True, deadline=None, max_examples=200)

STATED = [value for listed in (tables.CODES | tables.LIMITS).values() for value in listed]


@pytest.mark.parametrize("value", STATED, ids=lambda value: value.name)
def test_constants_agree(value: Value) -> None:
    assert getattr(lib, value.name) == value.number


def test_sizes_agree() -> None:
    assert stamp.STAMP.sizeof() == lib.STAMP_BYTES
    assert native.PAIR.sizeof() == lib.NATIVE_PAIR_BYTES
    for name in ("REPLY", "STREAM", "CAMERA", "STATUS"):
        assert getattr(native, name).sizeof() == getattr(lib, f"NATIVE_{name}_BYTES")


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
