"""SPI windows: what they carry, when they end, and what their faults do."""

from itertools import pairwise
from typing import Any

from kernel_rig import MS, SECOND, Rig, faults, perfect

from host.native import lib


def with_spi(direction: int, **values: float) -> Any:
    def change(config: Any) -> None:
        for name, value in values.items():
            setattr(config.wires[direction], name, value)

    return perfect(change)


def streamed(rig: Rig, until_ns: int = 5 * SECOND) -> bytes:
    rig.images()
    lib.kernel_host_connect(rig.k, 0)
    return rig.stream(until_ns)


def test_each_window_carries_both_directions_and_takes_its_time() -> None:
    with Rig() as rig:
        lib.kernel_trace(rig.k, lib.TRACE_FULL)
        streamed(rig, 2 * SECOND)
        there = [run for run in rig.runs() if run.wire == lib.WIRE_SPI_TO_ESP32]
        back = [run for run in rig.runs() if run.wire == lib.WIRE_SPI_TO_GAP8]
        assert len(there) > 50
        assert [run.true_start_ns for run in there] == [run.true_start_ns for run in back]
        close = 0
        for window, answer, following in zip(there, back, there[1:], strict=False):
            size = lib.cpx_spi_window_bytes(len(window.data), len(answer.data))
            end_ns = window.true_start_ns + 20_000 + size * 800
            assert following.true_start_ns >= end_ns
            close += following.true_start_ns == end_ns
        assert close >= 25  # header and body of a frame go back to back
        assert {len(run.data) for run in back if run.data[:2] == b"\0\0"} == {4}


def test_lost_windows_lose_frames_and_the_robot_says_so() -> None:
    with Rig(with_spi(lib.WIRE_SPI_TO_ESP32, loss=0.2)) as rig:
        streamed(rig, 10 * SECOND)
        counts = rig.counts(lib.WIRE_SPI_TO_ESP32)
        gap8, esp32 = lib.kernel_gap8(rig.k, 0), lib.kernel_esp32(rig.k, 0)
        assert counts.lost > 30
        assert gap8.frames_sent > 150
        assert 0 < esp32.frames_forwarded < gap8.frames_sent
        assert rig.counts(lib.WIRE_SPI_TO_GAP8).lost == 0


def test_duplicates_are_delivered_twice() -> None:
    with Rig() as once, Rig(with_spi(lib.WIRE_SPI_TO_ESP32, duplicate=1)) as twice:
        assert len(streamed(twice, 2 * SECOND)) > 1.5 * len(streamed(once, 2 * SECOND))
        counts = twice.counts(lib.WIRE_SPI_TO_ESP32)
        assert counts.duplicated == counts.units


def test_delay_holds_up_the_window_and_loses_nothing() -> None:
    delay_ns = 12 * SECOND  # further than an oscillator looks ahead
    with Rig(with_spi(lib.WIRE_SPI_TO_GAP8, latency_ns=delay_ns)) as rig:
        lib.kernel_trace(rig.k, lib.TRACE_FULL)
        rig.run(60 * SECOND)
        starts = [run.true_start_ns for run in rig.runs() if run.wire == lib.WIRE_SPI_TO_GAP8]
        assert len(starts) >= 4
        for start, following in pairwise(starts):
            assert following - start >= delay_ns + 20_000 + 8 * 800
        assert rig.counts(lib.WIRE_SPI_TO_GAP8).lost == 0


def test_stall_of_either_direction_stops_the_bus() -> None:
    for wire in (lib.WIRE_SPI_TO_ESP32, lib.WIRE_SPI_TO_GAP8):
        with Rig() as rig:
            streamed(rig, 2 * SECOND)
            units = rig.counts(wire).units
            lib.kernel_stall(rig.k, 0, wire, 500 * MS)
            rig.stream(2490 * MS)
            assert rig.counts(wire).units <= units + 1  # one may have been under way
            rig.stream(3 * SECOND)
            assert rig.counts(wire).units > units + 10


def test_damage_is_counted_and_survived() -> None:
    with Rig(with_spi(lib.WIRE_SPI_TO_ESP32, flip=0.001, drop=0.001)) as rig:
        streamed(rig)
        counts = rig.counts(lib.WIRE_SPI_TO_ESP32)
        assert counts.flipped > 20
        assert counts.dropped > 20
        assert lib.kernel_set_faults(rig.k, 0, lib.WIRE_SPI_TO_ESP32, faults()) == 0
        before = lib.kernel_esp32(rig.k, 0).frames_forwarded
        rig.stream(7 * SECOND)
        assert lib.kernel_esp32(rig.k, 0).frames_forwarded >= before + 38  # of 40
