"""The same calls give the same bytes; traces say what left each sender."""

from typing import Any

import pytest
from kernel_rig import MS, SECOND, Rig, perfect

from host.native import lib

FNV_BASIS, FNV_PRIME = 0xCBF29CE484222325, 0x100000001B3


def troubled(config: Any) -> None:
    for mcu in range(lib.MCU_COUNT):
        config.clocks[mcu].rate_ppb = (-1) ** mcu * 20_000
        config.clocks[mcu].walk_ppb = 500
    for wire in range(lib.WIRE_COUNT):
        faults = config.wires[wire]
        faults.latency_ns, faults.jitter_ns = 50_000, 100_000
        faults.loss, faults.flip, faults.drop = 0.01, 1e-6, 1e-6
        faults.burst_per_s, faults.burst_ns = 0.2, 10 * MS
        faults.stall_per_s, faults.stall_ns = 0.2, 10 * MS
    config.camera_jitter_ns = 20_000
    config.camera_fail = 0.05
    config.gap8.echo_period_us = 1_000_000


def streamed(seed: int, step_ns: int, mode: int = lib.TRACE_HASH) -> tuple[list[int], bytes]:
    with Rig(perfect(troubled), seed=seed) as rig:
        assert lib.kernel_trace(rig.k, mode) == 0
        rig.images()
        lib.kernel_host_connect(rig.k, 0)
        got = rig.stream(4 * SECOND, step_ns=step_ns)
        return rig.hashes(), got


def test_same_seed_same_bytes() -> None:
    first, again, other = (streamed(seed, 10 * MS) for seed in (3, 3, 4))
    assert first == again
    assert len(first[1]) > 30_000
    assert all(a != b for a, b in zip(first[0][:7], other[0][:7], strict=True))


def test_stops_of_a_run_change_nothing() -> None:
    """As long as the host reads before its window closes."""
    assert streamed(3, 10 * MS) == streamed(3, 3_333_333)


def test_hash_and_full_agree_and_hash_is_over_bytes_and_records() -> None:
    with Rig(perfect(troubled)) as rig:
        lib.kernel_trace(rig.k, lib.TRACE_FULL)
        rig.images()
        lib.kernel_host_connect(rig.k, 0)
        rig.stream(SECOND)
        runs = rig.runs()
        hashes = rig.hashes()
    expected = [FNV_BASIS] * lib.WIRE_COUNT
    for run in runs:
        record = (run.local_start_ns, run.true_start_ns, run.byte_ps, len(run.data))
        for byte in run.data + b"".join(value.to_bytes(8, "little") for value in record):
            expected[run.wire] = (expected[run.wire] ^ byte) * FNV_PRIME % 2**64
    assert {run.wire for run in runs} == {0, 1, 2, 3, 4, 5, 6}
    assert [run.true_start_ns for run in runs if run.wire == 0] == sorted(
        run.true_start_ns for run in runs if run.wire == 0
    )
    assert expected == hashes


def test_off_keeps_nothing_and_each_start_is_new() -> None:
    with Rig() as rig:
        rig.run(SECOND)
        assert rig.runs() == []
        assert lib.kernel_trace(rig.k, lib.TRACE_FULL) == 0
        rig.run(2 * SECOND)
        assert len(rig.runs()) >= 100
        assert lib.kernel_trace(rig.k, lib.TRACE_FULL) == 0
        assert rig.runs() == []
        assert rig.hashes() == [FNV_BASIS] * lib.WIRE_COUNT
        assert lib.kernel_trace(rig.k, 3) == lib.KERNEL_ERR_CONFIG


def test_tracing_does_not_change_what_happens() -> None:
    assert streamed(9, 10 * MS, lib.TRACE_OFF)[1] == streamed(9, 10 * MS, lib.TRACE_FULL)[1]


def test_robots_do_not_disturb_each_other() -> None:
    config = perfect(troubled)
    with Rig(config) as alone, Rig(config, config, config) as together:
        for rig in (alone, together):
            lib.kernel_trace(rig.k, lib.TRACE_HASH)
            rig.run(2 * SECOND)
        assert alone.hashes() == together.hashes()
        assert together.hashes(0) != together.hashes(1) != together.hashes(2)


def test_trace_that_starts_within_a_run_leaves_that_run_out() -> None:
    with Rig() as rig:
        rig.run(1000 * MS + 200_000)  # in the third byte of a stamp
        lib.kernel_trace(rig.k, lib.TRACE_FULL)
        rig.run(1020 * MS)
        stamps = [run for run in rig.runs() if run.wire == lib.WIRE_UART1]
        assert [run.true_start_ns for run in stamps] == [1010 * MS]


@pytest.mark.parametrize("mcu", range(3))
def test_reboot_replays(mcu: int) -> None:
    def once() -> tuple[list[int], bytes]:
        with Rig(perfect(troubled), seed=8) as rig:
            lib.kernel_trace(rig.k, lib.TRACE_HASH)
            rig.images()
            lib.kernel_host_connect(rig.k, 0)
            got = rig.stream(1500 * MS)
            assert lib.kernel_reboot(rig.k, 0, mcu, 50 * MS) == 0
            lib.kernel_host_connect(rig.k, 0)
            got += rig.stream(3 * SECOND)
            return rig.hashes(), got

    assert once() == once()
