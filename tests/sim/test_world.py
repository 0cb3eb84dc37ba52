"""Worlds: the same seed gives the same bytes, a log gives the same run, and truth is what stamps are held against."""

import json
import random

import numpy as np
import pytest

from host.protocol.errors import LocalError
from sim import captures, configure, scenario
from sim.truth import TRUTH_DTYPE, Stamped, errors_us
from sim.world import World

REPLAYED = [
    ("hover", {}),
    ("lossy", {}),
    ("swarm", {}),
    ("stock", {}),
    ("hover", {"wire": "uart2"}),
    ("hover", {"wire": "uart1"}),
    ("hover", {"camera_encoding": "jpeg", "camera_jitter_us": 500}),
]


@pytest.mark.parametrize(("name", "settings"), REPLAYED)
def test_a_run_is_repeated_from_its_log(name, settings):
    with World(name, trace="hash", **settings) as world:
        for index in range(len(world.robots)):
            world.listen(index)
        world.run(3)
        again = World.replay(json.loads(json.dumps(world.log)))
        assert again.trace_hash() == world.trace_hash()
        assert again.now_ns == world.now_ns
        assert again.truth.tobytes() == world.truth.tobytes()
        assert [robot.gap8 for robot in again.robots] == [robot.gap8 for robot in world.robots]


def interfere(rng, world, robot):
    """One thing that can be done to a robot, drawn."""
    wire = rng.choice(list(configure.WIRES))
    mcu = rng.choice(["stm32", "gap8", "esp32"])
    action = rng.randrange(10)
    if action == 0:
        robot.set_faults(wire, loss=rng.random() / 4, latency_us=rng.randrange(5000))
    elif action == 1:
        robot.stall(wire, rng.random())
    elif action == 2:
        robot.reboot(mcu, rng.random())
    elif action == 3:
        robot.reset_stamp_clock(mcu, rng.randrange(1000))
    elif action == 4:
        robot.set_rate(mcu, rng.uniform(-20000, 20000))
    elif action == 5:
        robot.inject(wire, rng.randbytes(rng.randrange(1, 200)))
    elif action == 6:
        robot.connect()
    elif action == 7:
        robot.disconnect()
    elif action == 8:
        robot.write(rng.randbytes(rng.randrange(1, 2000)))
    else:
        robot.set_camera_faults(fail=rng.random() / 4, hang=rng.random() / 10)


@pytest.mark.parametrize("seed", range(8))
def test_anything_that_is_done_is_repeated(seed):
    """Slow and partial readers too: TCP's window closes and opens at the same instants."""
    rng = random.Random(seed)
    with World("swarm", robots=2, trace="hash", seed=seed) as world:
        for robot in world.robots:
            robot.connect()
        for _ in range(60):
            world.run(rng.choice([0, 0.001, 0.05, 0.4]))
            robot = rng.choice(world.robots)
            if rng.random() < 0.7:
                robot.read(rng.choice([1, 5000, 40000, None]))
            else:
                interfere(rng, world, robot)
        log = world.log
        again = World.replay(json.loads(json.dumps(log)))
        assert again.trace_hash() == world.trace_hash(), f"seed {seed}"
        assert again.truth.tobytes() == world.truth.tobytes()
        assert [robot.esp32 for robot in again.robots] == [robot.esp32 for robot in world.robots]


def test_a_slow_reader_is_in_the_log_and_a_quick_one_is_not():
    def reads(period_s):
        with World("hover") as world:
            world.robots[0].connect()
            for _ in range(round(6 / period_s)):
                world.run(period_s)
                world.robots[0].read()
            return [record for record in world.log if record["do"] == "reads"]

    assert reads(0.05) == []
    assert reads(2.0) != []


def test_seeds():
    def run(seed):
        with World("hover", trace="hash", seed=seed, uart1_loss=0.1) as world:
            world.listen()
            world.run(2)
            return world.trace_hash()

    assert run(1) == run(1)
    assert run(1) != run(2)


def test_a_replay_that_differs_is_noticed():
    with World("hover", trace="hash") as world:
        world.listen()
        world.run(2)
        log = world.log
        without_request = [record for record in log if record["do"] != "write"]
        assert len(without_request) < len(log)
        assert World.replay(without_request).trace_hash() != world.trace_hash()


def test_frames_are_the_pictures_that_the_camera_took():
    with World("hover") as world:
        robot = world.listen()
        robot.run(3)
        truth = {int(each["frame"]): int(each["image"]) for each in robot.truth}
        pictures = world.pictures[0].raw
        assert len(robot.frames) > 15
        for frame in robot.frames:
            assert frame.body.tobytes() == pictures[truth[frame.native.frame]]


def test_stamps_are_held_against_the_truth():
    """Without jitter a time is right to the clocks' steps of 1 us, once the guessed mean delay has worn off."""
    with World("hover", uart1_jitter_us=0, camera_jitter_us=0, gap8_quantum="1us", stm32_ppm=0, gap8_ppm=0) as world:
        errors = world.listen().run(6) and world._receivers[0].stamp_errors_us
        assert len(errors) > 40
        assert np.all(np.abs(errors[-20:]) < 3)


def test_errors_are_the_shorter_way_round():
    truth = np.zeros(3, TRUTH_DTYPE)
    truth["frame"] = [0, 1, 2]
    truth["gap8_stamp_us"] = [100, 200, 300]
    wrap_us = 1 << 32
    truth["stm32_stamp_ns"] = [5_000_500, (wrap_us - 1) * 1000, np.iinfo(np.int64).min]
    stamps = [(0, 100, 5003), (1, 200, 4), (0, 100, 4990), (0, 101, 5003), (2, 300, 1), (9, 100, 1)]
    errors = errors_us([Stamped(stm32_us, (frame, gap8_us)) for frame, gap8_us, stm32_us in stamps], truth, 32)
    assert errors[:3].tolist() == [2.5, 5.0, -10.5]
    assert np.isnan(errors[3:]).all(), "another GAP8 time, the STM32 not up, no such frame"


def test_uart_speeds():
    assert configure.robot_config(scenario.load("hover").robots[0]).uart1_byte_ps == 86_904_762
    config = configure.robot_config(scenario.load("hover").robots[0])
    baud = [round(1e13 / config.uart1_byte_ps), round(1e13 / config.uart2_stm32_byte_ps)]
    assert baud == [115068, 575342]
    assert round(1e13 / config.uart2_esp32_byte_ps) == 576000


def test_every_setting_reaches_the_kernel():
    """Each of the numbers below is set away from its default; none may be lost on the way."""
    config = configure.robot_config(
        scenario.load(
            "hover",
            gap8_ppm=1.5,
            gap8_ramp_ppm=2,
            gap8_ramp_s=3,
            gap8_step_ppm=-9,
            gap8_step_s=0.25,
            gap8_walk_ppb=4,
            gap8_boot_ms=5,
            gap8_stamp_start_us=6,
            gap8_stamp_bits=32,
            gap8_quantum="1ms",
            stm32_divider=84,
            uart2_latency_us=7,
            uart2_reorder=0.25,
            uart2_duplicate=0.125,
            spi_flip=0.5,
            tcp_stall_ms=8,
            tcp_window=20000,
            crtp_hz=100,
            camera_fps=4,
            camera_burst=2,
        ).robots[0]
    )
    gap8 = config.clocks[1]
    assert (gap8.rate_ppb, gap8.ramp_ppb, gap8.ramp_ns, gap8.walk_ppb) == (1500, 2000, 3_000_000_000, 4)
    assert (gap8.step_ppb, gap8.step_ns) == (-9000, 250_000_000)
    assert (gap8.boot_ns, gap8.stamp_start_us, gap8.stamp_bits, gap8.quantum) == (5_000_000, 6, 32, 2)
    assert [clock.divider for clock in config.clocks] == [84, 85, 85]
    assert [wire.latency_ns for wire in config.wires] == [0, 7000, 7000, 0, 0, 0, 1_500_000, 1_500_000]
    assert [wire.reorder for wire in config.wires] == [0, 0.25, 0.25, 0, 0, 0, 0, 0]
    assert [wire.duplicate for wire in config.wires] == [0, 0.125, 0.125, 0, 0, 0, 0, 0]
    assert [wire.flip for wire in config.wires] == [0, 0, 0, 0, 0.5, 0.5, 0, 0]
    assert [wire.stall_ns for wire in config.wires] == [0, 0, 0, 0, 0, 0, 8_000_000, 8_000_000]
    assert (config.tcp_window_bytes, config.stm32.crtp_period_us) == (20000, 10000)
    assert (config.gap8.camera.frame_period_us, config.gap8.camera.burst, config.gap8.stamp_bits) == (500_000, 2, 32)


def test_a_body_too_large_for_the_esp32_is_refused():
    with pytest.raises(LocalError, match="camera_width=640, camera_height=480: a raw frame takes"):
        World("hover", camera_width=640, camera_height=480, camera_fps=5)
    World("hover", camera_width=640, camera_height=480, camera_fps=5, camera_encoding="jpeg").close()


def test_a_folder_of_pictures_gives_the_camera_its_size(tmp_path):
    from PIL import Image

    picture = np.arange(80 * 60, dtype=np.uint32).astype(np.uint8).reshape(60, 80)
    Image.fromarray(picture).save(tmp_path / "a.pgm")
    with World("hover", camera=str(tmp_path)) as world:
        frames = world.listen().run(2)
        assert np.array_equal(frames[0].pixels, picture)


def test_faults_are_merged_and_counted():
    with World("hover", uart1_jitter_us=0) as world:
        robot = world.robots[0]
        robot.set_faults("uart1", loss=0.5)
        robot.set_faults("uart1", latency_us=10)
        world.run(10)
        assert 350 < robot.wires["uart1_to_gap8"]["lost"] < 650
        assert robot.wires["tcp_to_host"]["lost"] == 0
        assert robot.gap8["stamps_missed"] > 300


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda robot: robot.set_faults("uart3", loss=1), "no wire 'uart3': did you mean uart"),
        (lambda robot: robot.set_faults("uart1", los=1), "no scenario key 'uart1_los': did you mean uart1_loss?"),
        (lambda robot: robot.set_faults("tcp", reorder=0.5), "tcp_reorder is not possible"),
        (lambda robot: robot.set_faults("uart1", loss=2), "uart1_loss=2.0: allowed is 0 .. 1"),
        (lambda robot: robot.set_faults("spi", hz=1000000), "spi_hz is no fault"),
        (lambda robot: robot.set_rate("gap9", 1), "no MCU 'gap9': did you mean gap8?"),
        (lambda robot: robot.set_rate("gap8", 20001), "gap8_ppm=20001.0: allowed"),
        (lambda robot: robot.reboot("gap8", -1), "seconds=-1"),
        (lambda robot: robot.stall("tcp", float("nan")), "seconds=nan"),
        (lambda robot: robot.world.run(-1), "seconds=-1"),
        (lambda robot: robot.world.run_until(-1), "has passed"),
        (lambda robot: robot.world.trace_hash(), "keeps no trace"),
        (lambda robot: robot.inject("tcp", bytes(65537)), "65537 bytes"),
        (lambda robot: robot.world.listen(1), "robot 1: this world has 0 .. 0"),
        (lambda robot: World("hover", trace="some"), "trace=some"),
        (lambda robot: World.replay([]), "a log begins with its world"),
    ],
)
def test_refusals(act, message):
    with World("hover") as world, pytest.raises(LocalError) as error:
        act(world.robots[0])
    assert message in str(error.value)


def test_after_closing():
    world = World("hover")
    world.listen()
    world.run(2)
    world.close()
    world.close()
    assert len(world.truth) > 5
    assert world.log[-1]["do"] == "end"
    with pytest.raises(LocalError, match="closed"):
        world.run(1)


def test_a_reboot_of_the_esp32_cuts_the_connection():
    with World("hover") as world:
        robot = world.listen()
        before = len(robot.run(2))
        robot.reboot("esp32", 0.2)
        robot.run(2)
        assert not robot.connected
        robot.reboot("stm32")  # it sets up the network
        robot.connect()
        assert len(robot.run(4)) > before + 10


def test_an_empty_list_of_robots_truth_is_typed():
    with World("hover", camera_fps=0) as world:
        world.run(1)
        assert world.truth.dtype == TRUTH_DTYPE
        assert len(world.truth) == 0


def test_truth_forgets_the_oldest_alone(monkeypatch):
    monkeypatch.setattr(captures, "TRUTH_MAX", 20)
    with World("hover") as world:
        world.robots[0].connect()
        world.run(2.5)
        seen = world.truth["frame"].tolist()
        world.run(1)
        kept = world.truth["frame"].tolist()
        assert len(kept) == 20
        assert kept == list(range(kept[-1] - 19, kept[-1] + 1))
        assert kept[0] in seen
        assert world.truth_lost == world.robots[0].gap8["frame"] - 20
