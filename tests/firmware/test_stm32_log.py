"""The logger on the STM32: complete files, whatever the card does, and the counts of what could not be written."""

import struct
from typing import Any

import numpy as np
import pytest
from board import CRTP, HOST, STM32, SYSTEM, cpx, uart
from log_rig import Rig
from memory_card import (
    CLOSE,
    CREATE,
    DISK,
    EXISTS,
    FULL,
    NO_CARD,
    OPEN,
    READ,
    SEEK,
    SYNC,
    TRUNCATE,
    WRITE,
    MemoryCard,
)

from host.native import ffi, lib
from host.usd.decode import decode
from host.usd.log import Log

SECOND = 1_000_000
POSE = {"x_m": 1.0, "z_m": 2.0, "qz": 0.6, "qw": 0.8}
ROW_BYTES = 10 + 6 * 4


def config(ring: int = 8192, hz: int = 1000, startup: int = 1, more: bytes = b"") -> bytes:
    axes = b"".join(b"stateEstimate.%b\n" % each for each in (b"x", b"y", b"z", b"vx", b"yaw", b"qw"))
    return b"1\n%d\nlog\n%d\non:fixedFrequency\n%d\n1\n" % (ring, startup, hz) + axes + more


def flown(seconds: float = 2.0, text: bytes | None = None, **settings: Any) -> Rig:
    rig = Rig(MemoryCard(config() if text is None else text), pose=POSE, sway_m=0.5, **settings)
    rig.run(round(seconds * SECOND))
    return rig


def ended(rig: Rig) -> Rig:
    rig.logging(False)
    rig.run(rig.now_us + 2 * SECOND)
    return rig


def logs(rig: Rig) -> list[Log]:
    """Of all files, in their order."""
    return [decode(bytes(data)) for name, data in sorted(rig.card.files.items()) if name != "config.txt"]


def grid(first_us: int, last_us: int) -> int:
    """Rows that are due at 1 kHz, both ends included."""
    return (last_us - int(first_us)) // 1000 + 1


def last_status(log: Log) -> dict[str, int]:
    rows = log.rows["log.status"].data
    return {name: int(rows[name][-1]) for name in (rows.dtype.names or ())}


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
    assert (rig.app.log.status, rig.app.log.files, rig.app.log.errors) == (lib.STM32_LOG_OFF, 1, 0)
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


def replies(rig: Rig, data: bytes) -> list[bytes]:
    rig.app.uart_packets(rig.now_us)
    rig.app.receive("UART2", uart(cpx(HOST, STM32, CRTP, data)), rig.now_us)
    return rig.app.uart_packets(rig.now_us)


def test_logging_begins_and_ends_by_its_parameter() -> None:
    rig = flown(1.0, config(startup=0))
    assert (rig.app.log.status, sorted(rig.card.files)) == (lib.STM32_LOG_OFF, ["config.txt"])
    answer = cpx(STM32, HOST, CRTP, b"\x23\0usd\0logging\0\x00", last=0)
    assert replies(rig, b"\x23\0usd\0logging\0\x08\x01") == [answer]
    rig.run(2 * SECOND)
    assert rig.app.log.status == lib.STM32_LOG_ON
    assert replies(rig, b"\x23\0usd\0logging\0\x08\x00") == [answer]
    rig.run(3 * SECOND)
    assert replies(rig, b"\x23\0usec\0reset\0\x08\x01") == [cpx(STM32, HOST, CRTP, b"\x23\0usec\0reset\0\x02", last=0)]
    assert replies(rig, b"\x23\0usd\0logging\0\x06\x01") == [
        cpx(STM32, HOST, CRTP, b"\x23\0usd\0logging\0\x16", last=0)
    ]
    rig.logging(True)
    rig.run(4 * SECOND)
    ended(rig)
    assert sorted(rig.card.files) == ["config.txt", "log00", "log01"]
    first, second = logs(rig)
    assert first.is_whole
    assert second.is_whole
    assert first.session != second.session
    assert 850 < len(first.rows["fixedFrequency"]) <= 1000


def test_the_log_is_closed_before_the_power_goes() -> None:
    rig = flown(1.0)
    rig.app.receive("UART2", uart(cpx(HOST, STM32, SYSTEM, b"\x30")), rig.now_us)
    rig.poll()
    rig.run(rig.now_us + 100_000)  # what the Crazyflie gives it
    assert logs(rig)[0].is_whole


def test_begin_end_and_begin_again_in_one_breath() -> None:
    rig = flown(1.0)
    for on in (False, True, False, True):
        rig.logging(on)
        rig.run(rig.now_us + 1000)
    rig.run(rig.now_us + SECOND)
    ended(rig)
    assert all(log.is_whole for log in logs(rig))
    assert len(logs(rig)) >= 2


def test_the_first_free_name_is_taken() -> None:
    card = MemoryCard(config())
    card.files |= {f"log{n:02}": bytearray(b"old") for n in range(100) if n != 42}
    rig = Rig(card)
    rig.run(2 * SECOND)
    ended(rig)
    assert decode(bytes(card.files["log42"])).is_whole
    assert sum(data == b"old" for data in card.files.values()) == 99
    rig.logging(True)
    rig.run(rig.now_us + SECOND)
    assert rig.app.log.status == lib.STM32_LOG_NO_NAME
    assert card.done[-1] == (CREATE, EXISTS)


@pytest.mark.parametrize(
    ("text", "status"),
    [(None, lib.STM32_LOG_NO_CONFIG), (b"2\n", lib.STM32_LOG_BAD_CONFIG), (b"", lib.STM32_LOG_BAD_CONFIG)],
)
def test_without_a_usable_config_nothing_is_written(text: bytes | None, status: int) -> None:
    rig = Rig(MemoryCard(text))
    rig.run(SECOND)
    assert rig.app.log.status == status
    assert {operation for operation, _ in rig.card.done} <= {OPEN, 3, CLOSE}


def test_without_a_card_the_robot_flies() -> None:
    card = MemoryCard(config())
    card.fails = lambda operation, argument: NO_CARD
    rig = Rig(card)
    rig.run(SECOND)
    assert (rig.app.log.status, len(card.done), rig.app.log.errors) == (lib.STM32_LOG_NO_CARD, 1, 0)
    card.fails = lambda operation, argument: None
    rig.logging(True)
    rig.run(2 * SECOND)
    assert rig.app.log.status == lib.STM32_LOG_ON


def test_a_long_config_with_findings_is_read_to_its_end() -> None:
    text = b"# comments\n" * 300 + config(hz=300, more=b"no.such\n" + b"#\n" * 500)
    rig = flown(1.0, text)
    assert (rig.app.log.config.errors, rig.app.log.config.warnings) == (1, 1)
    assert [(each.line, each.kind) for each in rig.app.log.config.findings[0:2]] == [
        (306, lib.USD_WARNING_ROUNDED),
        (314, lib.USD_ERROR_VARIABLE),
    ]
    assert set(np.diff(logs(ended(rig))[0].rows["fixedFrequency"].stamp_us).tolist()) == {3000}


@pytest.mark.parametrize("sync_us", [0, 50_000])
def test_what_is_synced_is_verified_at_any_moment(sync_us: int) -> None:
    """Power is cut after every operation: what the card has then, with stale bytes where nothing was written."""
    rig = Rig(MemoryCard(config()), log={"sync_us": sync_us})
    period_us = sync_us or 250_000
    checked, before = 0, b""
    while rig.now_us < 2 * SECOND:
        rig.run(rig.now_us + 5000)
        data = rig.card.synced.get("log00", b"")
        if data == before:
            continue
        before = data
        log = decode(data)
        assert log.session is not None
        rows = log.rows["fixedFrequency"]
        verified = rows.stamp_us[rows.is_verified]
        if not len(verified):
            continue  # of the header and the first status row
        assert len(data) == lib.STM32_LOG_CHUNK_BYTES
        late_us = rig.now_us - int(verified[-1]) if len(verified) else 0
        assert late_us < period_us // 4, "a sync leaves little behind"
        assert verified.tolist() == list(
            range(int(rows.stamp_us[0]), int(rows.stamp_us[0]) + 1000 * len(verified), 1000)
        )
        checked += 1
    assert 2 * SECOND // period_us - 1 <= checked <= 2 * SECOND // period_us + 1


def tolerance_us(ring: int, hz: int = 1000) -> int:
    """How long a card may stand still: rows fill what the ring has, but for what waits there already."""
    waiting = 512 + lib.USD_STATUS_BYTES + lib.USD_LOG_END_BYTES
    return (ring - waiting) // ROW_BYTES * SECOND // hz


@pytest.mark.parametrize("ring", [2048, 8192, 65535])
def test_a_stall_within_the_tolerance_loses_nothing_and_beyond_it_every_row_is_counted(ring: int) -> None:
    for factor, loses in ((0.95, False), (1.5, True)):
        rig = flown(1.0, config(ring))
        stall_us = round(tolerance_us(ring) * factor)
        rig.operation_us = lambda stall_us=stall_us: stall_us
        rig.run(rig.now_us + 20_000)
        rig.operation_us = lambda: 2000
        rig.run(rig.now_us + stall_us + SECOND)
        due = rig.now_us
        (log,) = logs(ended(rig))
        status = last_status(log)
        rows = log.rows["fixedFrequency"]
        assert log.is_whole
        assert (status["dropped"] > 0) == loses
        assert status["accepted"] == len(rows)
        assert status["requested"] == grid(rows.stamp_us[0], due)
        assert status["requested"] == status["accepted"] + status["dropped"]
        assert status["stall_us"] == stall_us
        assert rig.app.log.log.fill_max <= ring


def test_stalls_of_a_bad_card_all_the_time() -> None:
    rig = Rig(MemoryCard(config(65535)), seed=3)
    rig.operation_us = lambda: 2000 if rig.rng.random() < 0.99 else 400_000
    rig.run(20 * SECOND)
    (log,) = logs(ended(rig))
    assert log.is_whole
    assert last_status(log)["dropped"] == 0
    assert len(log.rows["fixedFrequency"]) > 19_900


@pytest.mark.parametrize("room", [5_000, 40_000, 40_001, 300_000, 1_200_000])
def test_a_full_card_ends_the_log_properly(room: int) -> None:
    rig = Rig(MemoryCard(config(), room))
    rig.run(60 * SECOND)
    assert rig.app.log.status == lib.STM32_LOG_FULL
    (log,) = logs(rig)
    assert log.is_whole
    assert log.verified_count == log.row_count
    status = last_status(log)
    assert status["accepted"] == len(log.rows["fixedFrequency"])
    assert (status["dropped"], status["errors"]) == (1, 1)
    assert room - log.size < 4096 + 512 + len(rig.card.files["config.txt"]), "the card is used"
    writes = [result for operation, result in rig.card.done if operation == WRITE]
    assert all(result > 0 for result in writes)


@pytest.mark.parametrize("room", [200, 1000])
def test_a_card_without_room_for_a_header(room: int) -> None:
    rig = Rig(MemoryCard(config(), room))
    rig.run(5 * SECOND)
    assert rig.app.log.status == lib.STM32_LOG_FULL
    assert rig.card.done[-1][0] == CLOSE


def test_the_header_is_on_the_card_before_space_is_allocated() -> None:
    """Else a power cut may leave a directory that names clusters in which an older log lies."""
    rig = Rig(MemoryCard(config()))
    rig.run(SECOND)
    operations = [operation for operation, _ in rig.card.done]
    assert operations[: operations.index(SEEK)] == [OPEN, READ, READ, CLOSE, CREATE, WRITE, SYNC]


def test_a_card_that_cannot_allocate_ahead() -> None:
    """A short write is a full card, too: the file ends behind its last status row."""
    card = MemoryCard(config(), 40_000)
    card.fails = lambda operation, argument: DISK if operation == SEEK and len(card.done) < 8 else None
    rig = Rig(card)
    rig.run(10 * SECOND)
    assert rig.app.log.status == lib.STM32_LOG_FULL
    (log,) = logs(rig)
    assert log.is_whole
    status = last_status(log)
    assert status["accepted"] == len(log.rows["fixedFrequency"])
    assert 0 < status["dropped"] < 250 + 100
    assert status["errors"] == 2


def nth(operation: int, numbers: set[int], result: int) -> Any:
    """Fails those requests for this operation."""
    seen = [0]

    def fails(which: int, argument: bytes) -> int | None:
        seen[0] += which == operation
        return result if which == operation and seen[0] in numbers else None

    return fails


def test_a_write_that_fails_is_tried_again() -> None:
    rig = Rig(MemoryCard(config()))
    rig.card.fails = nth(WRITE, {5, 9, 10}, DISK)
    rig.run(2 * SECOND)
    (log,) = logs(ended(rig))
    assert log.is_whole
    status = last_status(log)
    assert (status["dropped"], status["errors"], len(rig.card.files)) == (0, 3, 2)


def test_a_file_that_cannot_go_on_is_ended_and_the_next_begins_with_what_was_lost() -> None:
    rig = Rig(MemoryCard(config()))
    rig.card.fails = nth(WRITE, {60, 61, 62}, DISK)
    rig.run(3 * SECOND)
    due = rig.now_us
    first, second = logs(ended(rig))
    assert first.is_whole
    assert second.is_whole
    one, two = last_status(first), last_status(second)
    assert 0 < one["dropped"] < 350
    assert one["accepted"] == len(first.rows["fixedFrequency"])
    assert second.rows["log.status"].data["requested"][0] == second.rows["log.status"].data["dropped"][0] > 0
    assert one["errors"] == 3
    begin = int(first.rows["fixedFrequency"].stamp_us[0])
    assert one["requested"] + two["requested"] == grid(begin, due)
    both = np.concatenate([first.rows["fixedFrequency"].stamp_us, second.rows["fixedFrequency"].stamp_us])
    assert (np.diff(both) > 0).all()
    assert set((both % 1000).tolist()) == {begin % 1000}, "the grid is kept"


def test_a_card_that_fails_for_good_is_given_up() -> None:
    rig = flown(1.0)
    rig.card.fails = lambda operation, argument: DISK
    rig.run(5 * SECOND)
    assert rig.app.log.status == lib.STM32_LOG_FAILED
    assert rig.app.log.errors > 3
    asked = len(rig.card.done)
    rig.run(60 * SECOND)
    assert len(rig.card.done) == asked
    assert decode(rig.card.synced["log00"]).verified_count > 500


def test_only_writes_of_every_file_fail() -> None:
    rig = flown(1.0)
    rig.card.fails = lambda operation, argument: DISK if operation == WRITE else None
    rig.run(5 * SECOND)
    assert rig.app.log.status == lib.STM32_LOG_FAILED
    assert len(rig.card.files) <= 2 + lib.STM32_LOG_TRIES


def test_a_sync_that_fails_is_counted_and_the_next_one_covers_it() -> None:
    rig = Rig(MemoryCard(config()))
    rig.card.fails = nth(SYNC, {2, 4}, DISK)
    rig.run(2 * SECOND)
    (log,) = logs(ended(rig))
    assert log.is_whole
    assert last_status(log)["errors"] == 2


OPERATIONS = 70


@pytest.mark.parametrize("result", [DISK, FULL, NO_CARD])
@pytest.mark.parametrize("burst", [1, 3, 5])
def test_any_operation_may_fail(result: int, burst: int) -> None:
    """Each in its turn, alone or with those behind it: what is on the card decodes, and every row is accounted for."""
    for first in range(1, OPERATIONS):
        rig = Rig(MemoryCard(config(2048)))
        rig.card.fails = lambda *_, rig=rig, first=first: (
            result if first <= len(rig.card.done) + 1 < first + burst else None
        )
        rig.run(500_000)
        due = rig.now_us
        was_on = rig.app.log.status == lib.STM32_LOG_ON
        ended(rig)
        where = f"operation {first} to {first + burst - 1} fail with {result}"
        files = logs(rig)
        assert rig.app.log.status not in (lib.STM32_LOG_ON, lib.STM32_LOG_CLOSES, lib.STM32_LOG_STARTS), where
        for log in files:
            assert log.damages == () or not log.is_whole, where
            if log.is_whole:
                assert last_status(log)["accepted"] == len(log.rows["fixedFrequency"]), where
        if was_on and files and all(log.is_whole and len(log.rows["fixedFrequency"]) for log in files):
            begin = int(files[0].rows["fixedFrequency"].stamp_us[0])
            requested = sum(last_status(log)["requested"] for log in files)
            assert requested == grid(begin, due), where


def test_close_and_truncate_that_fail_leave_a_log_that_can_be_read() -> None:
    for operation in (TRUNCATE, CLOSE):
        rig = flown(1.0)
        rig.card.fails = lambda which, argument, operation=operation: DISK if which == operation else None
        (log,) = logs(ended(rig))
        assert log.verified_count == log.row_count
        assert rig.app.log.errors == 1
        assert rig.app.log.status == lib.STM32_LOG_OFF


@pytest.mark.parametrize(
    "answer", [b"", b"\x04", b"\x05\0\0\0\0", b"\x04\xff\xff\xff\x7f", b"\x04" + bytes(4) + bytes(600)]
)
def test_answers_that_nobody_asked_for(answer: bytes) -> None:
    rig = flown(1.0)
    while rig._answer is not None:
        rig.run(rig.now_us + 100)
    rig.app.receive("STORAGE", answer, rig.now_us)
    assert rig.app.answers_unknown == 1
    assert logs(ended(rig))[0].is_whole


def test_sessions_differ_from_boot_to_boot_and_from_robot_to_robot() -> None:
    sessions = set()
    for seed in range(5):
        for boot in range(5):
            rig = flown(0.2, log={"seed": seed, "boot": boot})
            sessions.add(rig.app.log.log.counters.session)
    assert len(sessions) == 25
    assert 0 not in sessions
