"""Captures and the truth about them, and what a reboot takes with it."""

from fractions import Fraction
from math import ceil
from typing import Any

from kernel_rig import MS, SECOND, Rig, perfect

from host.native import ffi, lib


def always(config: Any) -> None:
    config.gap8.stream_always = True


def changed(**values: float) -> Any:
    def change(config: Any) -> None:
        always(config)
        for name, value in values.items():
            setattr(config, name, value)

    return perfect(change)


def test_truth_of_each_capture() -> None:
    rate_ppb = -50_000

    def change(config: Any) -> None:
        always(config)
        config.clocks[lib.MCU_GAP8].rate_ppb = rate_ppb
        config.clocks[lib.MCU_STM32].stamp_start_us = 5_000
        config.clocks[lib.MCU_STM32].divider = 84

    with Rig(perfect(change)) as rig:
        rig.images(3)
        rig.run(SECOND)
        truth = rig.truth()
        assert len(truth) == 20
        for number, each in enumerate(truth):
            end_local_ns = number * 50 * MS + 20 * MS + 100 * 100_000
            assert each.true_ns == ceil(Fraction(end_local_ns * 10**9, 10**9 + rate_ppb))
            assert each.gap8_stamp_us == end_local_ns // 1000
            assert each.stm32_stamp_ns == 5_000_000 + each.true_ns * 84 // 85
            assert (each.frame, each.boot, each.image, each.robot) == (number, 0, number % 3, 0)
        assert lib.kernel_gap8(rig.k, 0).frame == 20
        assert rig.truth() == []


def test_interrupt_jitter_is_in_the_stamp_and_not_in_the_truth() -> None:
    with Rig(changed(camera_jitter_ns=100_000)) as rig:
        rig.images()
        rig.run(10 * SECOND)
        late = [each.gap8_stamp_us - each.true_ns / 1000 for each in rig.truth()]
        assert all(delay > -1 for delay in late)
        assert 70 < sum(late) / len(late) < 130


def test_stm32_time_is_unknown_while_it_is_off() -> None:
    with Rig(changed()) as rig:
        rig.images()
        lib.kernel_reboot(rig.k, 0, lib.MCU_STM32, 100 * SECOND)
        rig.run(SECOND)
        assert {each.stm32_stamp_ns for each in rig.truth()} == {-(2**63)}


def test_failed_captures_are_no_frames() -> None:
    with Rig(changed(camera_fail=0.5)) as rig:
        rig.images()
        rig.run(5 * SECOND)
        truth = rig.truth()
        gap8 = lib.kernel_gap8(rig.k, 0)
        assert 20 < gap8.captures_failed < 80
        assert [each.frame for each in truth] == list(range(gap8.frame))
        assert gap8.captures_failed + gap8.frame == 100


def test_hanging_captures_are_given_up_by_the_app() -> None:
    with Rig(changed(camera_hang=1)) as rig:
        rig.images()
        rig.run(5500 * MS)
        gap8 = lib.kernel_gap8(rig.k, 0)
        assert gap8.captures_failed == 10  # given up after half a second and twice 124 lines of 0.1 ms
        assert gap8.frame == 0
        assert lib.kernel_set_camera_faults(rig.k, 0, 0, 0) == 0
        rig.run(8 * SECOND)
        assert gap8.frame > 20
        assert [each.frame for each in rig.truth()] == list(range(gap8.frame))


def test_without_images_every_capture_fails() -> None:
    with Rig(changed()) as rig:
        rig.run(SECOND)
        assert lib.kernel_gap8(rig.k, 0).captures_failed == 20
        assert rig.truth() == []


def test_jpeg_is_taken_from_its_own_images() -> None:
    def change(config: Any) -> None:
        always(config)
        config.gap8.camera.encoding = lib.IMAGE_JPEG

    with Rig(perfect(change)) as rig:
        rig.images(jpeg=b"\xff\xd8 not checked here \xff\xd9" * 10)
        lib.kernel_host_connect(rig.k, 0)
        got = rig.stream(2 * SECOND)
        assert b" not checked here " in got
        assert lib.kernel_gap8(rig.k, 0).captures_failed == 0
    with Rig(perfect(change)) as rig:
        rig.images()
        rig.run(SECOND)
        assert lib.kernel_gap8(rig.k, 0).captures_failed == 20


def test_pictures_arrive_as_they_were() -> None:
    with Rig(changed()) as rig:
        pictures = rig.images(2)
        lib.kernel_host_connect(rig.k, 0)
        got = rig.stream(2 * SECOND)
        for picture in pictures:
            assert picture in got  # smaller than a packet, so in one piece


def test_images_of_a_wrong_size_are_refused() -> None:
    with Rig() as rig:
        assert lib.kernel_set_images(rig.k, 0, rig.views([b"short"]), ffi.NULL, 1) == lib.KERNEL_ERR_CONFIG
        assert lib.kernel_set_images(rig.k, 0, ffi.NULL, ffi.NULL, 0) == lib.KERNEL_ERR_CONFIG


def test_gap8_reboot_starts_frames_anew_and_counts() -> None:
    with Rig(changed()) as rig:
        rig.images()
        rig.run(525 * MS)  # in a capture
        lib.kernel_reboot(rig.k, 0, lib.MCU_GAP8, 100 * MS)
        rig.run(SECOND)
        truth = rig.truth()
        assert [(each.boot, each.frame) for each in truth] == [(0, n) for n in range(10)] + [(1, n) for n in range(7)]
        assert truth[10].true_ns == 655 * MS
        assert truth[10].gap8_stamp_us == 30_000


def test_camera_faults_out_of_range_are_refused() -> None:
    with Rig() as rig:
        assert lib.kernel_set_camera_faults(rig.k, 0, 1.5, 0) == lib.KERNEL_ERR_CONFIG
        assert lib.kernel_set_camera_faults(rig.k, 0, 0, float("nan")) == lib.KERNEL_ERR_CONFIG


def test_truth_is_bounded_and_what_goes_is_counted() -> None:
    def change(config: Any) -> None:
        always(config)
        config.gap8.width = config.gap8.height = 1
        config.gap8.line_time_ns = 1
        config.gap8.camera.frame_period_us = 0
        config.camera_frame_ns = 1_000
        config.spi_byte_ps = 1_000
        config.spi_gap_ns = 0

    with Rig(perfect(change)) as rig:
        assert lib.kernel_set_images(rig.k, 0, rig.views([b"x"]), ffi.NULL, 1) == 0
        until_ns = 0
        while lib.kernel_gap8(rig.k, 0).frame < 70_000:
            until_ns += 100 * MS
            assert until_ns < 10 * SECOND
            rig.run(until_ns)
        frames = lib.kernel_gap8(rig.k, 0).frame
        assert lib.kernel_truth_lost(rig.k) == frames - 65536
        assert rig.truth()[0].frame == frames - 65536
