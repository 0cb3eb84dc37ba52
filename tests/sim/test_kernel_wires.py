"""What the faults of a wire do, seen from the counters of the app behind it and from the kernel's own."""

from itertools import pairwise
from math import exp
from typing import Any

import pytest
from kernel_rig import MS, SECOND, Rig, faults, perfect

from host.native import lib

UART1_NS = 17 * 86_805.556  # of one stamp message


def with_faults(wire: int, **values: float) -> Any:
    def change(config: Any) -> None:
        for name, value in values.items():
            setattr(config.wires[wire], name, value)

    return perfect(change)


def delays_us(rig: Rig) -> list[float]:
    """Of each kept stamp, beyond the time that its bytes take."""
    return [gap8_us - stm32_us - UART1_NS / 1000 for _, stm32_us, gap8_us in rig.pairs()]


def sequences(rig: Rig) -> list[int]:
    return [sequence for sequence, _, _ in rig.pairs()]


def test_perfect_wire_counts_what_it_carries() -> None:
    with Rig() as rig:
        rig.run(5 * SECOND - 5 * MS)
        counts = rig.counts(lib.WIRE_UART1)
        assert (counts.units, counts.bytes) == (500, 8500)
        assert sequences(rig) == list(range(500))
        assert all(-1 <= delay <= 1 for delay in delays_us(rig))


def test_latency_delays_every_byte_by_itself() -> None:
    with Rig(with_faults(lib.WIRE_UART1, latency_ns=25 * MS)) as rig:  # more than a period: several under way
        rig.run(5 * SECOND)
        assert sequences(rig) == list(range(498))
        assert all(24_999 <= delay <= 25_001 for delay in delays_us(rig))


def test_jitter_is_exponential_and_keeps_the_order() -> None:
    mean_us = 500
    with Rig(with_faults(lib.WIRE_UART1, jitter_ns=mean_us * 1000)) as rig:
        rig.run(5 * SECOND - MS)
        delays = delays_us(rig)
        assert sequences(rig) == list(range(500))
        assert sum(delays) / 500 == pytest.approx(mean_us, rel=0.15)
        for share in (0.5, 1, 2):
            above = sum(delay > share * mean_us for delay in delays) / 500
            assert above == pytest.approx(exp(-share), abs=0.07)


@pytest.mark.parametrize("loss", [0.0, 0.2, 1.0])
def test_loss_takes_whole_units(loss: float) -> None:
    with Rig(with_faults(lib.WIRE_UART1, loss=loss)) as rig:
        rig.run(50 * SECOND - 5 * MS)
        counts = rig.counts(lib.WIRE_UART1)
        gap8 = lib.kernel_gap8(rig.k, 0)
        assert counts.units == 5000
        assert counts.lost == pytest.approx(5000 * loss, abs=4 * (5000 * loss * (1 - loss)) ** 0.5)
        assert gap8.stamp_rx.received == 5000 - counts.lost
        assert gap8.stamp_rx.garbage_bytes == gap8.stamp_rx.bad_check == 0


def test_duplicates_come_right_behind() -> None:
    with Rig(with_faults(lib.WIRE_UART1, duplicate=1)) as rig:
        rig.run(SECOND - 5 * MS)
        assert sequences(rig) == [number for number in range(100) for _ in range(2)]
        assert rig.counts(lib.WIRE_UART1).duplicated == 100


def test_reordered_units_come_after_the_next() -> None:
    with Rig(with_faults(lib.WIRE_UART1, reorder=1)) as rig:
        rig.run(SECOND - 5 * MS)
        swapped = [number for first in range(0, 100, 2) for number in (first + 1, first)]
        assert sequences(rig) == swapped
        assert rig.counts(lib.WIRE_UART1).reordered == 50


def test_some_reordering_loses_nothing() -> None:
    with Rig(with_faults(lib.WIRE_UART1, reorder=0.3, duplicate=0.2)) as rig:
        rig.run(4 * SECOND - 5 * MS)
        counts = rig.counts(lib.WIRE_UART1)
        assert counts.reordered > 50
        assert counts.duplicated > 20
        got = sequences(rig)
        assert set(range(399)) <= set(got)
        assert len(got) in (400 + counts.duplicated, 399 + counts.duplicated)  # the last may still be held
        assert sum(a > b for a, b in pairwise(got)) == counts.reordered


def test_dropped_and_flipped_bytes_are_counted_and_break_their_message() -> None:
    with Rig(with_faults(lib.WIRE_UART1, drop=0.002)) as rig:
        rig.run(30 * SECOND)
        counts = rig.counts(lib.WIRE_UART1)
        gap8 = lib.kernel_gap8(rig.k, 0)
        assert 50 < counts.dropped < 160  # 102 expected
        broken = 3000 - gap8.stamp_rx.received
        assert 0.9 * counts.dropped <= broken <= counts.dropped  # two may fall into one message
        assert gap8.stamps_missed == broken
    with Rig(with_faults(lib.WIRE_UART1, flip=1)) as rig:
        rig.run(SECOND)
        assert rig.counts(lib.WIRE_UART1).flipped == rig.counts(lib.WIRE_UART1).bytes
        assert lib.kernel_gap8(rig.k, 0).stamp_rx.received == 0


def test_bursts_lose_what_starts_within_them() -> None:
    with Rig(with_faults(lib.WIRE_UART1, burst_per_s=1, burst_ns=200 * MS)) as rig:
        rig.run(100 * SECOND)
        counts = rig.counts(lib.WIRE_UART1)
        share = counts.lost / counts.units
        assert share == pytest.approx(0.2 / 1.2, rel=0.35)
    with Rig(with_faults(lib.WIRE_UART1, burst_per_s=1, burst_ns=200 * MS)) as rig:
        rig.run(5 * SECOND)
        got = sequences(rig)
        gaps = [b - a for a, b in pairwise(got) if b - a > 1]
        assert max(gaps) > 5  # in a row, not one by one


def test_stall_holds_bytes_and_lets_them_out_in_order() -> None:
    with Rig() as rig:
        rig.run(1005 * MS)
        assert lib.kernel_stall(rig.k, 0, lib.WIRE_UART1, 100 * MS) == 0
        rig.run(2 * SECOND)
        assert sequences(rig) == list(range(200))
        late = [gap8_us for _, stm32_us, gap8_us in rig.pairs() if 1_005_000 <= stm32_us <= 1_105_000]
        assert late == [1_105_000] * 10
        assert rig.counts(lib.WIRE_UART1).stalls == 1


def test_random_stalls_lose_nothing() -> None:
    with Rig(with_faults(lib.WIRE_UART1, stall_per_s=2, stall_ns=50 * MS)) as rig:
        rig.run(5 * SECOND)
        counts = rig.counts(lib.WIRE_UART1)
        assert counts.stalls > 3
        assert counts.lost == counts.overflowed == 0
        assert max(delays_us(rig)) > 20_000
        assert sequences(rig) == list(range(len(sequences(rig))))


def test_too_much_delayed_is_lost_and_counted() -> None:
    with Rig() as rig:
        lib.kernel_stall(rig.k, 0, lib.WIRE_UART1, 3 * SECOND)
        rig.run(4 * SECOND)
        counts = rig.counts(lib.WIRE_UART1)
        gap8 = lib.kernel_gap8(rig.k, 0)
        assert counts.overflowed == 300 * 17 - 2048
        assert gap8.stamp_rx.received == 2048 // 17 + 100
        assert gap8.stamp_rx.garbage_bytes == 2048 % 17


def test_faults_end_when_they_are_taken_away() -> None:
    with Rig(with_faults(lib.WIRE_UART1, loss=1, latency_ns=3 * MS, reorder=0.5)) as rig:
        rig.run(SECOND - MS)
        assert lib.kernel_set_faults(rig.k, 0, lib.WIRE_UART1, faults()) == 0
        rig.run(2 * SECOND - 5 * MS)
        assert sequences(rig)[-100:] == list(range(100, 200))
        assert abs(delays_us(rig)[-1]) <= 1


def test_each_wire_has_its_own_draws() -> None:
    """A fault on one wire leaves what happens on another as it was."""
    jitter = {"jitter_ns": 300_000, "loss": 0.1}

    def both(config: Any) -> None:
        for name, value in jitter.items():
            setattr(config.wires[lib.WIRE_UART1], name, value)
            setattr(config.wires[lib.WIRE_UART2_TO_ESP32], name, value)

    with Rig(with_faults(lib.WIRE_UART1, **jitter)) as one, Rig(perfect(both)) as two:
        one.run(4 * SECOND)
        two.run(4 * SECOND)
        assert two.counts(lib.WIRE_UART2_TO_ESP32).lost > 0
        assert one.pairs() == two.pairs()


def test_injected_bytes_reach_the_receiver_at_once() -> None:
    with Rig() as rig:
        rig.run(1005 * MS)
        assert lib.kernel_inject(rig.k, 0, lib.WIRE_UART1, b"garbage", 7) == 0
        gap8 = lib.kernel_gap8(rig.k, 0)
        rig.run(2 * SECOND - 5 * MS)
        assert gap8.stamp_rx.garbage_bytes == 7
        assert gap8.stamp_rx.received == 200
        assert rig.counts(lib.WIRE_UART1).bytes == lib.kernel_stm32(rig.k, 0).stamps_sent * 17


@pytest.mark.parametrize(
    "wrong",
    [{"loss": -0.1}, {"loss": 1.1}, {"flip": float("nan")}, {"latency_ns": -1}, {"burst_per_s": 1e9}, {"stall_ns": -5}],
)
def test_impossible_faults_are_refused_and_change_nothing(wrong: dict[str, float]) -> None:
    with Rig() as rig:
        assert lib.kernel_set_faults(rig.k, 0, lib.WIRE_UART1, faults(**wrong)) == lib.KERNEL_ERR_CONFIG
        assert lib.kernel_set_faults(rig.k, 0, lib.WIRE_COUNT, faults()) == lib.KERNEL_ERR_CONFIG
        assert lib.kernel_add_robot(rig.k, with_faults(lib.WIRE_SPI_TO_GAP8, **wrong)) == lib.KERNEL_ERR_CONFIG
        rig.run(SECOND - 5 * MS)
        assert sequences(rig) == list(range(100))
