"""The rows of the STM32's log: what they hold, on which grid, in which order."""

import struct
from typing import Any

import numpy as np
import pytest
from log_rig import SECOND, config, ended, flown, last_status, logs

from host.native import ffi, lib
from host.usd.log import Log


def rows_of(data: bytes, log: Log) -> list[tuple[int, int]]:
    """Id and stamp of every row as they stand in the file."""
    sizes = {each.id: each.row_bytes + 2 for each in log.types}
    at, found = log.header_bytes, []
    while at < len(data) - 4:
        number, stamp = struct.unpack_from("<HQ", data, at)
        found.append((number, stamp))
        at += sizes[number]
    assert at == len(data) - 4
    return found


def test_a_closed_file_is_whole_and_every_row_is_on_its_grid() -> None:
    rig = ended(flown())
    assert sorted(rig.card.files) == ["config.txt", "log00"]
    assert (rig.app.log.status, rig.app.log.files, rig.app.log.errors) == (lib.LOG_OFF, 1, 0)
    data = bytes(rig.card.files["log00"])
    (log,) = logs(rig)
    assert log.is_whole
    assert log.verified_count == log.row_count
    rows = log.rows["fixedFrequency"]
    first = int(rows.stamp_us[0])
    assert rows.stamp_us.tolist() == list(range(first, 2 * SECOND + 1, 1000))
    status = last_status(log)
    assert (status["requested"], status["accepted"], status["dropped"]) == (len(rows), len(rows), 0)
    assert (status["errors"], status["stall_us"], log.session) == (0, 2000, rig.app.log.log.counters.session)
    stamps = [stamp for _, stamp in rows_of(data, log)]
    assert stamps == sorted(stamps)


def test_rows_hold_what_the_robot_says_of_itself() -> None:
    (log,) = logs(ended(flown(5.0)))
    rows = log.rows["fixedFrequency"]
    phase = rows.stamp_us % 4_000_000
    gone = np.where(phase < 2_000_000, phase, 4_000_000 - phase) / 2_000_000
    assert rows.data["stateEstimate.x"] == pytest.approx(1.0 + 0.5 * (gone - 0.5), abs=1e-6)
    assert rows.data["stateEstimate.vx"] == pytest.approx(np.where(phase < 2_000_000, 0.25, -0.25))
    assert set(rows.data["stateEstimate.z"]) == {2.0}
    assert rows.data["stateEstimate.yaw"] == pytest.approx(2 * np.degrees(np.arctan2(0.6, 0.8)), abs=1e-3)


@pytest.mark.parametrize("axis", ["roll", "pitch", "yaw"])
@pytest.mark.parametrize("degrees", [-179, -135, -91, -90, -60, -1, 0, 0.01, 44, 46, 89, 120, 180])
def test_angles_are_those_of_the_crazyflie(axis: str, degrees: float) -> None:
    if axis == "pitch" and abs(degrees) > 90:
        pytest.skip("not what a pitch can be")
    half = np.radians(degrees) / 2
    pose = {"q" + {"roll": "x", "pitch": "y", "yaw": "z"}[axis]: np.sin(half), "qw": np.cos(half)}
    attitude = lib.attitude_of(lib_pose(pose))
    sign = -1 if axis == "pitch" else 1
    near = 0.1 if axis == "pitch" and abs(degrees) > 80 else 1e-3  # where a float's sine says little about the angle
    assert getattr(attitude, f"{axis}_deg") * sign == pytest.approx(degrees, abs=near)


def lib_pose(pose: dict[str, float]) -> Any:
    return ffi.new("pose_t *", pose)


EVENTS = (
    b"on:estPose\nlocSrv.x\nlocSrv.qw\non:estPosition\nlocSrv.y\non:estGyroscope\ngyro.x\non:estAcceleration\nacc.z\n"
)


def test_events_stand_among_the_rows_in_the_order_of_time() -> None:
    rig = flown(0.5, config(hz=100, more=EVENTS), mocap_period_us=10_000)
    for n in range(200):
        rig.run(rig.now_us + 777)
        rig.crtp(b"\x61\x08" + struct.pack("<7f", n, 1, 2, 0, 0, 0, 1))
        rig.crtp(b"\x60" + struct.pack("<3f", 7, -n, 9))
    data = bytes(ended(rig).card.files["log00"])
    (log,) = logs(rig)
    assert log.is_whole
    stamps = [stamp for _, stamp in rows_of(data, log)]
    assert stamps == sorted(stamps)
    poses = log.rows["estPose"].data
    sent = [int(x) for x in poses["locSrv.x"] if x >= 2]  # motion capture's own are below
    assert sent == list(range(2, 200))
    assert [int(y) for y in log.rows["estPosition"].data["locSrv.y"]] == [-n for n in range(200)]
    assert set(log.rows["estPosition"].data["source"]) == {0}
    assert len(log.rows["estGyroscope"]) == len(log.rows["estAcceleration"]) > 600
    assert set(log.rows["estAcceleration"].data["acc.z"]) == {1.0}
    assert len(log.rows["fixedFrequency"]) < 80
    assert rig.app.crtp_ignored == 0


@pytest.mark.parametrize(
    "data",
    [
        *[b"\x61\x08" + struct.pack("<7f", 0, 0, float("nan"), 0, 0, 0, 1), b"\x61\x08" + bytes(27)],
        *[b"\x61\x09" + bytes(28), b"\x60" + bytes(11), b"\x60" + struct.pack("<3f", float("inf"), 0, 0)],
        *[b"\x62", b"\x30", b"\x23\x01usd\0logging\0\x08\x01", b"\x23\0usd\0logging\0", b"\x23\0usd", b"\x23"],
    ],
    ids=bytes.hex,
)
def test_what_is_no_position_and_no_parameter_is_counted(data: bytes) -> None:
    rig = flown(0.5, config(more=EVENTS))
    rig.crtp(data)
    assert rig.app.crtp_ignored == 1
    log = logs(ended(rig))[0]
    assert (len(log.rows["estPose"]), len(log.rows["estPosition"])) == (0, 0)


@pytest.mark.parametrize("by_radio", [True, False])
def test_a_beacon_is_a_row_with_the_time_of_its_coming(by_radio: bool) -> None:
    rig = flown(0.5, config(hz=10, more=b"on:beacon\npm.vbatMV\n"))
    came = []
    for n in range(5):
        rig.run(rig.now_us + 100_123)
        packet = struct.pack("<BBIQ", 0xDE, 0x62, 2**32 - 2 + n & 0xFFFFFFFF, 2**48 - 2 + n)
        if by_radio:
            rig.radio(packet)
        else:
            rig.crtp(packet)
        came.append(rig.now_us)
    for wrong in (b"\xd2\x62" + bytes(11), b"\xd2\x63" + bytes(12), b"\xd1\x62" + bytes(12), b"\xd2"):
        rig.radio(wrong)
    rig.radio(b"")
    assert rig.app.crtp_ignored == 5
    log = logs(ended(rig))[0]
    rows = log.rows["beacon"].data
    assert rows["sequence"].tolist() == [2**32 - 2, 2**32 - 1, 0, 1, 2]
    assert (rows["hostUs"] + (rows["hostUsHigh"].astype(np.int64) << 32)).tolist() == [2**48 - 2, 2**48 - 1, 0, 1, 2]
    if by_radio:
        assert log.rows["beacon"].stamp_us.tolist() == came
