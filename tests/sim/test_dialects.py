"""Robots with the paper's firmware and with NanoCockpit, heard by a session: every picture as it was taken, every time
as its rule says."""

import itertools

import numpy as np
import pytest

from host.link.frame import Frame
from host.link.records import Announced, NanocockpitStamp, PaperStamp
from sim.truth import PAPER_PERIOD_NS, TRUTH_DTYPE, Stamped, errors_us
from sim.world import World


def shown(world):
    """The pictures of robot 0, raw and JPEG."""
    pictures = world.pictures[0]
    return pictures.raw, pictures.jpeg


def in_order(bodies, pictures):
    """The numbers of these bodies' pictures: each must be one of them."""
    numbers = [pictures.index(body) for body in bodies]
    steps = {(after - before) % len(pictures) for before, after in itertools.pairwise(numbers)}
    return numbers, steps


@pytest.mark.parametrize("dialect", ["auto", "paper"])
@pytest.mark.parametrize("encoding", ["raw", "jpeg"])
@pytest.mark.parametrize("burst", [1, 3])
def test_paper_frames_are_their_pictures(dialect, encoding, burst):
    with World("paper", camera_encoding=encoding, camera_burst=burst, seed=5) as world:
        robot = world.listen(0, dialect)
        robot.run(8)
        raw, jpeg = shown(world)
        frames = robot.frames
        assert len(frames) >= 24
        assert {frame.dialect for frame in frames} == {"paper"}
        _, steps = in_order([frame.body.tobytes() for frame in frames], jpeg if encoding == "jpeg" else raw)
        assert steps == {1}
        assert all(np.array_equal(frame.pixels, frame.pixels) and frame.pixels.shape == (324, 324) for frame in frames)
        assert sum(robot.counters.frames_lost.values()) == 0
        assert robot.counters.garbage_bytes == 0
        assert not any(isinstance(event, Announced) for event in robot.events)
        assert robot.wires["tcp_to_esp32"]["bytes"] == 0, "nothing is transmitted"


def test_paper_times_are_off_by_milliseconds_and_poses_are_the_messages():
    with World("paper", seed=5) as world:
        robot = world.listen(0, "auto")
        robot.run(10)
        errors = robot.stamp_errors_us
        assert len(errors) == len(robot.frames)
        assert -5_500 < errors.min() < errors.max() < -2_000
        for frame in robot.frames:
            pose = frame.paper.pose
            # x goes to and fro by half a metre in four seconds; the message before the frame is at most 10 ms old.
            phase = (frame.paper.frame_ms / 1000 * 85 / 84) % 4 / 2
            expected = 0.5 + 0.5 * ((phase if phase < 1 else 2 - phase) - 0.5)
            assert abs(pose.x_m - expected) < 0.01
            assert (pose.y_m, pose.z_m) == (-0.25, 1.0)
            assert pose.qz == pytest.approx(np.sin(np.radians(15)))


def test_images_of_a_burst_are_sent_one_after_another():
    """Taken 50 ms apart; then their transfer, and nothing is taken meanwhile."""
    with World("paper", camera_burst=3, camera_fps=4, tcp_latency_us=0, tcp_jitter_us=0, seed=5) as world:
        robot = world.listen(0, "auto")
        robot.run(6)
        true_ns = robot.truth["true_ns"]
        gaps_ms = np.diff(true_ns) / 1e6
        assert np.allclose(np.delete(gaps_ms, np.s_[2::3]), 46.9, atol=0.2)
        assert (gaps_ms[2::3] > 600).all()
        arrivals = [frame.arrival_host_ns for frame in robot.frames]
        first_of_burst = [ns for place, ns in enumerate(arrivals) if place % 3 == 0]
        ends = true_ns[2::3]
        assert all(arrived > end for arrived, end in zip(first_of_burst, ends, strict=False))


def test_paper_on_the_other_wires():
    with World("paper", wire="uart1", uart1_flip=0.0005, seed=2) as world:
        robot = world.listen()
        robot.run(3)
        stamps = [event for event in robot.events if isinstance(event, PaperStamp)]
        assert 200 < len(stamps) < 300
        assert robot.counters.bad_check > 0
    with World("paper", wire="uart2", camera_width=80, camera_height=60, camera_fps=2, seed=2) as world:
        robot = world.listen(0, "auto")
        robot.run(4)
        raw, _ = shown(world)
        assert in_order([frame.body.tobytes() for frame in robot.frames], raw)[1] == {1}
        assert {frame.dialect for frame in robot.frames} == {"paper"}


def test_paper_before_its_first_message():
    """The STM32 boots late: until then the time is the GAP8's and is not given as the STM32's."""
    with World("paper", stm32_boot_ms=0, uart1_loss=1.0, seed=2) as world:
        robot = world.listen(0, "auto")
        robot.run(3)
        assert len(robot.frames) > 5
        assert {frame.paper.heard for frame in robot.frames} == {False}
        assert {frame.frame_stm32_us for frame in robot.frames} == {None}
        assert {frame.paper.pose for frame in robot.frames} == {None}
        assert len(robot.stamp_errors_us) == 0


def test_a_frame_without_a_number_is_found_by_its_picture():
    truth = np.zeros(6, TRUTH_DTYPE)
    truth["true_ns"] = np.arange(6) * 10**8
    truth["stm32_stamp_ns"] = np.arange(6) * 10**8 + 3 * 10**9
    truth["stm32_stamp_ns"][5] = np.iinfo(np.int64).min
    truth["image"] = [0, 1, 2, 0, 1, 2]
    pictures = {77: [1], 88: [2], 99: [7]}

    def error(stm32_us, crc, arrival_ns):
        (found,) = errors_us([Stamped(stm32_us, None, body_crc32=crc, arrival_ns=arrival_ns)], truth, 48, pictures)
        return found

    assert error(3_099_000, 77, 10**9) == -1000
    assert error(3_250_000, 77, 10**9) == 150_000, "the nearest of its picture, not the nearest"
    assert error(3_250_000, 77, 3 * 10**8) == 150_000
    assert error(3_410_000, 77, 3 * 10**8) == 310_000, "the other one was taken later than it came"
    assert error(3_240_000, 5, 10**9) == 40_000, "an unknown picture may be any"
    assert error(3_200_500, 88, 10**9) == 500, "the STM32 was not up at the other"
    assert np.isnan(error(3_000_000, 99, 10**9))
    assert np.isnan(error(3_000_000, 77, 0))
    assert error(3_101_000 + PAPER_PERIOD_NS // 1000, 77, 10**9) == 1000, "u32 of milliseconds has wrapped"


@pytest.mark.parametrize("dialect", ["auto", "nanocockpit"])
@pytest.mark.parametrize("check", ["no", "yes"])
def test_nanocockpit_frames_are_their_pictures(dialect, check):
    with World("nanocockpit", nanocockpit_check=check, seed=5) as world:
        robot = world.listen(0, dialect)
        robot.run(3)
        frames = robot.frames
        assert len(frames) > 120
        assert {frame.dialect for frame in frames} == {"nanocockpit"}
        numbers, _ = in_order([frame.body.tobytes() for frame in frames], shown(world)[0])
        ids = [frame.nanocockpit.frame_id for frame in frames]
        assert {frame.nanocockpit.checked for frame in frames} == {check == "yes"}
        # The sensor's counter goes on with the pictures, as long as no frame is missed.
        assert {(number - frame_id) % 16 for number, frame_id in zip(numbers, ids, strict=True)} == {
            (numbers[0] - ids[0]) % 16
        }
        assert sum(robot.counters.frames_lost.values()) == 0
        assert (robot.counters.garbage_bytes, robot.counters.bad_messages) == (0, 0)


def test_nanocockpit_gives_both_clocks():
    with World("nanocockpit", stm32_ppm=0, gap8_ppm=0, gap8_quantum="1us", gap8_boot_ms=0, seed=5) as world:
        robot = world.listen(0, "auto")
        robot.run(3)
        of = {int(row["gap8_stamp_us"]): row for row in robot.truth}
        for frame in robot.frames:
            header = frame.nanocockpit
            assert header.frame_gap8_us in of
            # 40 bytes at 115068 Bd, and the jitter of the wire; a tick is 1 ms.
            delay_us = header.state_gap8_us - header.state.stm32_time * 1000
            assert 3_400 < delay_us < 7_000
            assert header.state.y_mm == -250
            assert abs(header.state.vx_mm_s) == 250
            assert header.round_trip_us is None
            assert frame.frame_stm32_us is None
        assert len(robot.stamp_errors_us) == 0


def test_nanocockpit_clock_of_the_example():
    with World("nanocockpit", nanocockpit_clock="us", stm32_stamp_start_us=2**33 + 5, seed=5) as world:
        robot = world.listen(0, "auto")
        robot.run(1)
        times = [frame.nanocockpit.state.stm32_time for frame in robot.frames]
        assert 500_000 < times[-1] < 1_100_000, "32 bits of the stamp clock"


def test_nanocockpit_round_trip():
    with World("nanocockpit", seed=5) as world:
        robot = world.listen(0, "nanocockpit")
        robot.run(2)
        trips = [frame.nanocockpit.round_trip_us for frame in robot.frames if frame.nanocockpit.reply_gap8_us]
        assert len(trips) > 60
        assert 10_000 < min(trips) < max(trips) < 100_000


def test_a_slow_connection_costs_whole_frames():
    """The ESP32 drops them whole; the sensor's counter tells how many."""
    with World("nanocockpit", tcp_bytes_per_s=500_000, seed=5) as world:
        robot = world.listen(0, "auto")
        robot.run(5)
        raw, _ = shown(world)
        assert len(robot.frames) > 50
        assert all(frame.body.tobytes() in raw for frame in robot.frames)
        lost = robot.counters.frames_lost
        assert lost["unexplained"] == sum(lost.values()) > 50
        taken = robot.truth["gap8_stamp_us"]
        first, last = (robot.frames[place].nanocockpit.frame_gap8_us for place in (0, -1))
        between = int(((taken >= first) & (taken <= last)).sum())
        assert lost["unexplained"] == between - len(robot.frames) + robot.gap8["captures_late"]
        assert robot.esp32["frames_dropped"] >= lost["unexplained"]


def test_nanocockpit_on_uart1():
    with World("nanocockpit", wire="uart1", seed=2) as world:
        robot = world.listen()
        robot.run(2)
        states = [event.state for event in robot.events if isinstance(event, NanocockpitStamp)]
        assert len(states) in (199, 200)
        assert {after.stm32_time - before.stm32_time for before, after in itertools.pairwise(states)} == {10}


@pytest.mark.parametrize("scenario", ["paper", "nanocockpit"])
def test_damage_is_counted_and_the_rest_comes(scenario):
    with World(scenario, nanocockpit_check="yes", tcp_flip=2e-7, tcp_drop=2e-7, seed=3) as world:
        robot = world.listen(0, "auto")
        robot.run(40)
        raw, _ = shown(world)
        lost = sum(robot.counters.frames_lost.values())
        good = [frame for frame in robot.frames if frame.body.tobytes() in raw]
        assert lost > 0
        assert len(good) > 0.8 * len(robot.truth)
        if scenario == "nanocockpit":
            assert len(good) == len(robot.frames), "its check finds all damage"


@pytest.mark.parametrize("scenario", ["paper", "nanocockpit"])
@pytest.mark.parametrize("mcu", ["gap8", "esp32", "stm32"])
def test_a_reboot_of_any_part(scenario, mcu):
    with World(scenario, seed=3) as world:
        robot = world.listen(0, "auto")
        robot.run(2)
        robot.reboot(mcu, 0.2)
        robot.run(1)
        if not robot.connected:
            robot.connect()
        robot.run(3)
        before = len(robot.frames)
        robot.run(1)
        assert len(robot.frames) >= before + 4
        raw, _ = shown(world)
        assert all(frame.body.tobytes() in raw for frame in robot.frames)


@pytest.mark.parametrize("scenario", ["paper", "nanocockpit"])
def test_a_run_is_repeated_from_its_log(scenario):
    with World(scenario, trace="hash", seed=9) as world:
        robot = world.listen(0, "nanocockpit" if scenario == "nanocockpit" else "auto")
        robot.run(1)
        robot.set_faults("uart1", loss=0.3)
        robot.run(1)
        log, trace = world.log, world.trace_hash()
    with World.replay(log) as again:
        assert again.trace_hash() == trace


def test_robots_of_all_firmwares_in_one_world():
    kinds = ["native", "stock", "paper", "nanocockpit"]
    with World("hover", robots=4, firmware=kinds, camera_width=160, camera_height=160, seed=4) as world:
        robots = [world.listen(index, "auto") for index in range(4)]
        world.run(4)
        for kind, robot in zip(kinds, robots, strict=True):
            frames = [event for event in robot.events if isinstance(event, Frame)]
            assert len(frames) > 20
            assert frames[-1].dialect == kind
            assert sum(robot.counters.frames_lost.values()) == 0
