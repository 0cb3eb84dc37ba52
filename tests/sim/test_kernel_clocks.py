"""Local time against exact fractions, and the instants that follow from it."""

from fractions import Fraction
from math import ceil, floor, sqrt
from typing import Any

import pytest
from kernel_rig import MS, SECOND, Rig, perfect

from host.native import ffi, lib

PPB = 10**9
STOPS = [1, 2, 999, 99_999_999, 100_000_000, 100_000_001, 123_456_789, 10 * SECOND + 7, 301 * SECOND]


def with_clock(mcu: int, **values: int) -> Any:
    def change(config: Any) -> None:
        for name, value in values.items():
            setattr(config.clocks[mcu], name, value)

    return perfect(change)


@pytest.mark.parametrize("rate_ppb", [0, 1, -1, 18_000, -80_123, 20_000_000, -20_000_000])
def test_local_time_is_the_exact_integral(rate_ppb: int) -> None:
    with Rig(with_clock(lib.MCU_GAP8, rate_ppb=rate_ppb)) as rig:
        for stop in STOPS:
            rig.run(stop)
            assert rig.local_ns(lib.MCU_GAP8) == stop * (PPB + rate_ppb) // PPB, stop
            assert rig.local_ns(lib.MCU_STM32) == stop


def test_fraction_is_carried_over_rate_changes() -> None:
    changes = [(33, 7), (34, -7), (1_000_003, 20_000_000), (250_000_001, -19_999_999), (SECOND, 3)]
    with Rig() as rig:
        local, since, rate = Fraction(0), 0, 0
        for at, new in [*changes, (7 * SECOND + 1, 0)]:
            rig.run(at)
            local += Fraction((at - since) * (PPB + rate), PPB)
            since, rate = at, new
            assert rig.local_ns(lib.MCU_ESP32) == floor(local)
            assert lib.kernel_set_rate(rig.k, 0, lib.MCU_ESP32, new) == 0


def test_ramp_rises_in_steps_of_its_segments_and_stays() -> None:
    ramp_ppb, ramp_ms = 50_000, 2_000
    with Rig(with_clock(lib.MCU_STM32, ramp_ppb=ramp_ppb, ramp_ns=ramp_ms * MS)) as rig:
        local = Fraction(0)
        for segment in range(40):
            middle_ms = segment * 100 + 50
            rate = Fraction(ramp_ppb * min(middle_ms, ramp_ms), ramp_ms)
            local += 100 * MS * (1 + rate / PPB)
            rig.run((segment + 1) * 100 * MS)
            assert abs(rig.local_ns(lib.MCU_STM32) - local) < 1
        before = rig.local_ns(lib.MCU_STM32)
        rig.run(5 * SECOND)
        assert rig.local_ns(lib.MCU_STM32) - before == SECOND + ramp_ppb


@pytest.mark.parametrize("step_ppb", [50_000, -2_000_000])
def test_step_comes_at_the_next_segment_and_stays(step_ppb: int) -> None:
    with Rig(with_clock(lib.MCU_GAP8, rate_ppb=-7_000, step_ppb=step_ppb, step_ns=1_250 * MS)) as rig:
        for at_ms, stepped_ms in ((1_250, 0), (1_300, 0), (1_301, 1), (5_000, 3_700)):
            rig.run(at_ms * MS)
            local = at_ms * MS * (1 - Fraction(7_000, PPB)) + Fraction(stepped_ms * MS * step_ppb, PPB)
            assert rig.local_ns(lib.MCU_GAP8) == floor(local)


def test_random_walk_has_its_deviation_after_a_second_and_after_four() -> None:
    walk_ppb, robots = 1_000, 200
    config = with_clock(lib.MCU_GAP8, walk_ppb=walk_ppb)
    with Rig(*[config] * robots, seed=5) as rig:

        def rates(at_ns: int) -> list[int]:
            rig.run(at_ns)
            before = [rig.local_ns(lib.MCU_GAP8, robot) for robot in range(robots)]
            rig.run(at_ns + 100 * MS)
            return [10 * (rig.local_ns(lib.MCU_GAP8, r) - before[r] - 100 * MS) for r in range(robots)]

        for seconds in (1, 4):
            after = rates(seconds * SECOND)
            deviation = sqrt(sum(rate * rate for rate in after) / robots)
            assert deviation == pytest.approx(walk_ppb * sqrt(seconds), rel=0.15)  # three sigma of 200 draws


def test_reading_a_clock_does_not_change_it() -> None:
    config = with_clock(lib.MCU_GAP8, walk_ppb=5_000, ramp_ppb=100, ramp_ns=SECOND, rate_ppb=-3)
    with Rig(config) as seldom, Rig(config) as often:
        for stop in range(0, 3 * SECOND, 7_654_321):
            often.run(stop)
            often.local_ns(lib.MCU_GAP8)
        seldom.run(3 * SECOND)
        often.run(3 * SECOND)
        assert seldom.local_ns(lib.MCU_GAP8) == often.local_ns(lib.MCU_GAP8)


@pytest.mark.parametrize("rate_ppb", [0, 17, -80_000, 20_000_000, -20_000_000])
def test_stamps_leave_at_the_first_instant_of_their_deadline(rate_ppb: int) -> None:
    """And the byte time is the sender's: the last stop bit ends at the first ns at which its 17 bytes are over."""

    def first_ns(local: Fraction) -> int:
        return ceil(local * PPB / (PPB + rate_ppb))

    with Rig(with_clock(lib.MCU_STM32, rate_ppb=rate_ppb)) as rig:
        lib.kernel_trace(rig.k, lib.TRACE_FULL)
        rig.run(2 * SECOND)
        stamps = [run for run in rig.runs() if run.wire == lib.WIRE_UART1]
        pairs = rig.pairs()
        assert len(stamps) >= 190
        for number, (run, (sequence, stm32_us, gap8_us)) in enumerate(zip(stamps, pairs, strict=True)):
            assert sequence == number
            deadline_ns = stm32_us * 1000
            assert run.true_start_ns == first_ns(Fraction(deadline_ns))
            assert run.local_start_ns == run.true_start_ns * (PPB + rate_ppb) // PPB
            assert run.local_start_ns // 1000 == stm32_us
            end_local_ns = run.local_start_ns + ceil(Fraction(17 * run.byte_ps, 1000))
            assert gap8_us == first_ns(Fraction(end_local_ns)) // 1000
            assert len(run.data) == 17


def stamp_after(rig: Rig, mcu: int) -> int:
    stamp: int = lib.kernel_stamp_us(rig.k, 0, mcu)
    return stamp


def test_stamp_clock_quanta() -> None:
    def change(config: Any) -> None:
        for mcu, quantum in enumerate([lib.QUANTUM_1US, lib.QUANTUM_RTC, lib.QUANTUM_1MS]):
            config.clocks[mcu].quantum = quantum

    with Rig(perfect(change)) as rig:
        for stop in [0, 999, 1000, 30_517, 30_518, 61_035, 61_036, 999_999, MS, SECOND - 1, SECOND]:
            rig.run(stop)
            assert stamp_after(rig, 0) == stop // 1000
            assert stamp_after(rig, 1) == stop * 32768 // SECOND * 1_000_000 // 32768
            assert stamp_after(rig, 2) == stop // MS * 1000


def test_stamp_clock_starts_wraps_divides_and_is_reset() -> None:
    start = 2**32 - 500_000
    config = with_clock(lib.MCU_STM32, stamp_start_us=start, stamp_bits=32, divider=84, rate_ppb=1_000_000)
    with Rig(config) as rig:
        rig.run(400 * MS)
        local = rig.local_ns(lib.MCU_STM32)
        assert local == 400_400_000
        assert stamp_after(rig, lib.MCU_STM32) == start + local * 84 // 85 // 1000
        rig.run(600 * MS)
        local = rig.local_ns(lib.MCU_STM32)
        assert stamp_after(rig, lib.MCU_STM32) == (start + local * 84 // 85 // 1000) % 2**32 < 200_000
        assert lib.kernel_reset_stamp_clock(rig.k, 0, lib.MCU_STM32, 77) == 0
        rig.run(SECOND)
        assert stamp_after(rig, lib.MCU_STM32) == 77 + (rig.local_ns(lib.MCU_STM32) - local) * 84 // 85 // 1000


def test_reset_of_the_stamp_clock_moves_no_deadline() -> None:
    with Rig() as rig, Rig() as plain:
        for each in (rig, plain):
            lib.kernel_trace(each.k, lib.TRACE_FULL)
            each.run(505 * MS)
        lib.kernel_reset_stamp_clock(rig.k, 0, lib.MCU_STM32, 0)
        rig.run(SECOND)
        plain.run(SECOND)
        starts = [[run.true_start_ns for run in each.runs() if run.wire == lib.WIRE_UART1] for each in (rig, plain)]
        assert starts[0] == starts[1]
        assert rig.pairs()[-1][1] < 500_000 < plain.pairs()[-1][1]


def test_rate_change_moves_a_deadline_that_is_already_set() -> None:
    with Rig() as rig:
        rig.run(1_001 * MS)  # stamps at 1000 and 1010 ms
        lib.kernel_set_rate(rig.k, 0, lib.MCU_STM32, 20_000_000)
        lib.kernel_trace(rig.k, lib.TRACE_FULL)
        rig.run(1_020 * MS)
        first = next(run for run in rig.runs() if run.wire == lib.WIRE_UART1)
        assert first.true_start_ns == 1_001 * MS + ceil(Fraction(9 * MS * 100, 102))


def test_mcus_boot_at_their_time_and_local_time_starts_then() -> None:
    with Rig(with_clock(lib.MCU_GAP8, boot_ns=300 * MS, rate_ppb=1000)) as rig:
        rig.run(300 * MS - 1)
        assert rig.local_ns(lib.MCU_GAP8) == 0
        assert rig.pairs() == []
        rig.run(1300 * MS)
        assert rig.local_ns(lib.MCU_GAP8) == SECOND + 1000


def test_reboot_starts_local_time_anew_and_warm_up_goes_on() -> None:
    with Rig(with_clock(lib.MCU_STM32, ramp_ppb=50_000, ramp_ns=SECOND)) as rig:
        rig.run(2 * SECOND)
        assert lib.kernel_reboot(rig.k, 0, lib.MCU_STM32, 250 * MS) == 0
        rig.run(2 * SECOND + 249 * MS)
        assert rig.local_ns(lib.MCU_STM32) == 0
        rig.run(3 * SECOND + 250 * MS)
        assert rig.local_ns(lib.MCU_STM32) == SECOND + 50_000
        assert (
            lib.kernel_stm32(rig.k, 0).stamps_sent == 100
        )  # at 0, 10, ..., 990 ms since the boot; the next is on the line


def test_reboot_before_the_first_boot_waits_for_it() -> None:
    with Rig(with_clock(lib.MCU_STM32, boot_ns=SECOND)) as rig:
        rig.run(100 * MS)
        lib.kernel_reboot(rig.k, 0, lib.MCU_STM32, 1)
        rig.run(1500 * MS)
        assert rig.local_ns(lib.MCU_STM32) == 500 * MS


@pytest.mark.parametrize(
    ("field", "value"),
    [("boot_ns", -1), ("rate_ppb", 20_000_001), ("rate_ppb", -20_000_001), ("ramp_ns", -1), ("step_ns", -1),
     ("step_ppb", 20_000_001), ("walk_ppb", -1), ("stamp_bits", 65), ("quantum", 3), ("divider", 0), ("divider", 83)],
)  # fmt: skip
def test_impossible_clocks_are_refused(field: str, value: int) -> None:
    k = lib.kernel_new(1)
    assert lib.kernel_add_robot(k, with_clock(lib.MCU_ESP32, **{field: value})) == lib.KERNEL_ERR_CONFIG
    assert lib.kernel_add_robot(k, perfect()) == 0
    lib.kernel_free(k)


def test_stamp_start_must_fit_its_width() -> None:
    k = lib.kernel_new(1)
    fits = with_clock(lib.MCU_GAP8, stamp_bits=32, stamp_start_us=2**32 - 1)
    too_large = with_clock(lib.MCU_GAP8, stamp_bits=32, stamp_start_us=2**32)
    assert lib.kernel_add_robot(k, too_large) == lib.KERNEL_ERR_CONFIG
    assert lib.kernel_add_robot(k, fits) == 0
    lib.kernel_free(k)


def test_past_is_refused() -> None:
    with Rig() as rig:
        rig.run(SECOND)
        assert rig.run(SECOND - 1) == lib.KERNEL_ERR_TIME
        assert lib.kernel_now_ns(rig.k) == SECOND


def test_calls_for_no_such_robot_are_refused() -> None:
    with Rig() as rig:
        assert lib.kernel_set_rate(rig.k, 1, 0, 0) == lib.KERNEL_ERR_CONFIG
        assert lib.kernel_set_rate(rig.k, -1, 0, 0) == lib.KERNEL_ERR_CONFIG
        assert lib.kernel_reboot(rig.k, 1, 0, 0) == lib.KERNEL_ERR_CONFIG
        assert lib.kernel_stm32(rig.k, 1) == ffi.NULL
        assert lib.kernel_host_available(rig.k, 1) == 0
        assert rig.read(robot=1) == b""
