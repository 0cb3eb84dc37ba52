"""The logger when the card is full, fails or loses its power: complete files, and the counts of what could not be
written."""

from typing import Any

import numpy as np
import pytest
from log_rig import ROW_BYTES, SECOND, Rig, config, ended, flown, grid, last_status, log_files, logs
from memory_card import CLOSE, CREATE, DISK, FULL, NO_CARD, OPEN, READ, SEEK, STALE, SYNC, TRUNCATE, WRITE, MemoryCard

from host.native import lib
from host.usd.decode import decode


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


@pytest.mark.parametrize("room", [5_000, 40_000, 40_001, 300_000, 1_200_000])
def test_a_full_card_ends_the_log_properly(room: int) -> None:
    rig = Rig(MemoryCard(config(), room))
    rig.run(60 * SECOND)
    assert rig.app.log.status == lib.LOG_FULL
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
    assert rig.app.log.status == lib.LOG_FULL
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
    assert rig.app.log.status == lib.LOG_FULL
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
    assert rig.app.log.status == lib.LOG_FAILED
    assert rig.app.log.errors > 3
    asked = len(rig.card.done)
    rig.run(60 * SECOND)
    assert len(rig.card.done) == asked
    assert decode(rig.card.synced["log00"]).verified_count > 500


def test_only_writes_of_every_file_fail() -> None:
    rig = flown(1.0)
    rig.card.fails = lambda operation, argument: DISK if operation == WRITE else None
    rig.run(5 * SECOND)
    assert rig.app.log.status == lib.LOG_FAILED
    assert len(rig.card.files) <= 2 + lib.STM32_LOG_TRIES


def test_a_sync_that_fails_is_counted_and_the_next_one_covers_it() -> None:
    rig = Rig(MemoryCard(config()))
    rig.card.fails = nth(SYNC, {2, 4}, DISK)
    rig.run(2 * SECOND)
    (log,) = logs(ended(rig))
    assert log.is_whole
    assert last_status(log)["errors"] == 2


OPERATIONS = 40


@pytest.mark.parametrize("result", [DISK, FULL, NO_CARD])
@pytest.mark.parametrize("burst", [1, 3, 5])
def test_any_operation_may_fail(result: int, burst: int) -> None:
    """Each in its turn, alone or with those behind it: what is on the card decodes, and every row is accounted for."""
    for first in range(1, OPERATIONS):
        rig = Rig(MemoryCard(config(2048, hz=250)))
        rig.card.fails = lambda *_, rig=rig, first=first: (
            result if first <= len(rig.card.done) + 1 < first + burst else None
        )
        rig.run(500_000)
        due = rig.now_us
        was_on = rig.app.log.status == lib.LOG_ON
        ended(rig)
        where = f"operation {first} to {first + burst - 1} fail with {result}"
        files = logs(rig)
        assert rig.app.log.status not in (lib.LOG_ON, lib.LOG_CLOSES, lib.LOG_STARTS), where
        for (name, data), log in zip(log_files(rig), files, strict=True):
            for damage in log.damages:
                lost = data[damage.offset : damage.offset + damage.size].rstrip(STALE)
                assert len(lost) < ROW_BYTES, f"{where}: {damage}: more than the beginning of a row"
            assert log.verified_count >= decode(rig.card.synced.get(name, b"")).verified_count, where
            if log.is_whole:
                assert last_status(log)["accepted"] == len(log.rows["fixedFrequency"]), where
        if was_on and files and all(log.is_whole and len(log.rows["fixedFrequency"]) for log in files):
            begin = int(files[0].rows["fixedFrequency"].stamp_us[0])
            requested = sum(last_status(log)["requested"] for log in files)
            assert requested == grid(begin, due, 4000), where


def test_close_and_truncate_that_fail_leave_a_log_that_can_be_read() -> None:
    for operation in (TRUNCATE, CLOSE):
        rig = flown(1.0)
        rig.card.fails = lambda which, argument, operation=operation: DISK if which == operation else None
        (log,) = logs(ended(rig))
        assert log.verified_count == log.row_count
        assert rig.app.log.errors == 1
        assert rig.app.log.status == lib.LOG_OFF


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
