"""host.protocol.codec: what fits is encoded as the specification does, what does not is refused with the reason."""

import pytest

from host.native import lib
from host.protocol import codec
from host.protocol.errors import LocalError, PeerError
from host.protocol.packets import CameraSettings, CpxPacket, Route, StampMessage, StreamRequest
from host.protocol.spec import native

BRIDGE = CpxPacket(Route(lib.CPX_STM32, lib.CPX_HOST, lib.CPX_SYSTEM), b"\x21\x01")


def test_tcp_and_uart_there_and_back() -> None:
    assert codec.encode_cpx_tcp(BRIDGE).hex() == "040019012101"
    assert codec.decode_cpx_tcp(b"??" + codec.encode_cpx_tcp(BRIDGE), 2) == (BRIDGE, 6)
    empty = CpxPacket(Route(4, 2, 63, last_packet=True, reserved=True), b"")
    assert codec.decode_cpx_tcp(codec.encode_cpx_tcp(empty)) == (empty, 4)
    assert codec.decode_cpx_uart(codec.encode_cpx_uart(BRIDGE) + b"more") == (BRIDGE, 7)


def test_what_is_no_packet() -> None:
    assert codec.decode_cpx_tcp(b"\x00\x00\x55\x55") == (None, 4)
    assert codec.decode_cpx_uart(b"\xff\x00") == (None, 2)


def test_stamp() -> None:
    wire = bytes.fromhex("d5 2a 40 e2 01 00 74 f3 c8 f4 e5 00 00 00 03 6f 5d")
    assert codec.decode_stamp(b"x" + wire, 1) == (StampMessage(123456, 987654321012, 3), 17)


def test_requests() -> None:
    assert codec.encode_stream_request(StreamRequest(True, 200)) == native.STREAM.build({"dialect": 1, "data_max": 200})
    assert codec.encode_stream_request(StreamRequest(False)) == native.STREAM.build({"dialect": 0, "data_max": 0})
    settings = CameraSettings(False, 8, 255, 3, "jpeg", exposure_lines=2, frame_period_us=10_000_000)
    given = {"auto_exposure": 0, "analog_gain": 8, "digital_gain": 255, "burst": 3, "encoding": 1, "exposure_lines": 2}
    assert codec.encode_camera_request(settings) == native.CAMERA.build(given | {"frame_period_us": 10_000_000})


def test_settings_nobody_has_changed_are_in_range() -> None:
    assert native.camera_check(native.CAMERA.parse(codec.encode_camera_request(CameraSettings()))) == 0


@pytest.mark.parametrize(
    ("route", "reason"),
    [
        (Route(8, 3, 1), "destination is 8: give 0..7"),
        (Route(1, -1, 1), "source is -1: give 0..7"),
        (Route(1, 3, 64), "function is 64: give 0..63"),
        (Route(1, 3, 1, version=4), "version is 4: give 0..3"),
        (Route(1, 3, 1000), "function is 1000: give 0..63"),
    ],
)
def test_a_route_that_does_not_fit(route: Route, reason: str) -> None:
    with pytest.raises(LocalError, match=f"^{reason}$"):
        codec.encode_cpx_tcp(CpxPacket(route, b""))


def test_data_that_does_not_fit() -> None:
    with pytest.raises(LocalError, match="1021 bytes of data: at most 1020 fit"):
        codec.encode_cpx_tcp(CpxPacket(BRIDGE.route, bytes(1021)))
    with pytest.raises(LocalError, match="99 bytes of data: at most 98 fit"):
        codec.encode_cpx_uart(CpxPacket(BRIDGE.route, bytes(99)))


@pytest.mark.parametrize("data_max", [-1, 1, 99, 1021, 70000])
def test_a_stream_request_that_does_not_fit(data_max: int) -> None:
    with pytest.raises(LocalError, match=rf"^data_max is {data_max}: give 0 or 144\.\.1020$"):
        codec.encode_stream_request(StreamRequest(True, data_max))


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (CameraSettings(auto_exposure=2), "auto_exposure is 2: give False or True"),  # type: ignore[arg-type]
        (CameraSettings(analog_gain=3), "analog_gain is 3: give 1, 2, 4 or 8"),
        (CameraSettings(digital_gain=0), "digital_gain is 0: give 1..255"),
        (CameraSettings(burst=4), "burst is 4: give 1..3"),
        (CameraSettings(encoding="png"), "encoding is png: give raw or jpeg"),  # type: ignore[arg-type]
        (CameraSettings(exposure_lines=1), "exposure_lines is 1: give 2..65535"),
        (CameraSettings(exposure_lines=65536), "exposure_lines is 65536: give 2..65535"),
        (CameraSettings(frame_period_us=10_000_001), "frame_period_us is 10000001: give 0..10000000"),
    ],
)
def test_camera_settings_that_do_not_fit(settings: CameraSettings, reason: str) -> None:
    with pytest.raises(LocalError) as refused:
        codec.encode_camera_request(settings)
    assert str(refused.value) == reason


def test_bytes_that_mean_nothing() -> None:
    with pytest.raises(PeerError, match="CPX over TCP at byte 3: too short"):
        codec.decode_cpx_tcp(b"abc\x04\x00", 3)
    with pytest.raises(PeerError, match="CPX over TCP at byte 0: length out of range"):
        codec.decode_cpx_tcp(b"\x01\x00\x00\x00")
    with pytest.raises(PeerError, match="CPX over UART at byte 0: checksum"):
        codec.decode_cpx_uart(bytes.fromhex("ff040a042001d5"))
    with pytest.raises(PeerError, match="stamp message at byte 1: does not start"):
        codec.decode_stamp(bytes(20), 1)
    with pytest.raises(LocalError, match=r"offset is 4: give 0\.\.3"):
        codec.decode_stamp(b"abc", 4)
