"""Captures: bursts, slots, clients that go, and a camera that fails."""

from typing import Any

import pytest
from board import NEVER_US
from gap8_rig import CONNECTED, GONE, RAW, TIMEOUT_US, capture, gap8, picture, sent, stock


def test_a_command_carries_the_settings() -> None:
    camera = {"analog_gain": 8, "digital_gain": 200, "exposure_lines": 0x1234, "auto_exposure": 1}
    assert capture(gap8(camera=camera), bytes(2400)) == bytes([0, RAW, 1, 8, 200, 0, 0x34, 0x12])


def test_nothing_is_captured_without_a_client_or_a_camera() -> None:
    assert gap8(connect=False).transmit("CAMERA", 0) == b""
    assert gap8(connect=False).deadline() == NEVER_US
    assert gap8(0, 0).transmit("CAMERA", 0) == b""
    always = gap8(connect=False, stream_always=True)
    capture(always, bytes(2400))
    assert len(sent(always)) == 1 + 3


@pytest.mark.parametrize("burst", [1, 2, 3])
def test_bursts_are_back_to_back_and_a_period_apart(burst: int) -> None:
    app = gap8(camera={"burst": burst, "frame_period_us": 100_000})
    times = []
    now_us = 0
    while now_us < 500_000:
        if app.transmit("CAMERA", now_us):
            times.append(now_us)
            now_us += 10_000
            app.receive("CAMERA", bytes(2400), now_us)
            sent(app)
        else:
            assert app.deadline() > now_us
            now_us = app.deadline()
    assert times == [start + 10_000 * n for start in range(0, 500_000, 100_000) for n in range(burst)]
    assert app.captures_late == 0
    assert app.frames_sent == 5 * burst


def test_a_capture_that_takes_longer_than_the_period_keeps_the_grid() -> None:
    app = gap8(camera={"frame_period_us": 50_000})
    times: list[int] = []
    for now_us in range(0, 1_000_000, 1000):
        if app.capturing >= 0 and now_us - times[-1] == 70_000:
            app.receive("CAMERA", bytes(2400), now_us)
            sent(app)
        times += [now_us] if app.transmit("CAMERA", now_us) else []
    assert times == list(range(0, 1_000_000, 70_000))
    assert app.captures_late == 0


def test_captures_go_on_into_free_slots_while_a_frame_is_sent() -> None:
    app = gap8()
    bodies = [picture(2400, seed) for seed in range(3)]
    commands = [capture(app, bodies[0]), capture(app, bodies[1])]
    first = [app.transmit("SPI", 0)[2:]]
    commands.append(capture(app, bodies[2]))
    assert [command[0] for command in commands] == [0, 1, 2]
    assert app.transmit("CAMERA", 0) == b""
    assert app.captures_late == 1
    assert app.transmit("CAMERA", 1) == b""
    assert app.captures_late == 1, "counted once for each capture that has to wait"
    assert app.deadline() == NEVER_US
    packets = first + sent(app)
    assert packets == [packet for body in bodies for packet in stock(60, 40, RAW, [body])]  # oldest first
    assert app.transmit("CAMERA", 2)[0] == 0
    assert app.captures_late == 1


def test_periods_without_a_free_slot_are_left_out_and_counted() -> None:
    app = gap8(camera={"frame_period_us": 10_000})
    for n in range(3):
        capture(app, bytes(2400), n * 10_000)
    for up_us in range(30_000, 100_000, 10_000):
        assert app.deadline() == up_us
        assert app.transmit("CAMERA", up_us) == b""
    assert app.captures_late == 7
    sent(app)
    assert app.transmit("CAMERA", 99_999) == b""
    assert app.transmit("CAMERA", 100_000) != b""


def test_a_burst_waits_for_slots_for_all_of_it() -> None:
    app = gap8(camera={"burst": 2})
    capture(app, bytes(2400))
    capture(app, bytes(2400))
    assert app.transmit("CAMERA", 0) == b""  # one slot is free
    assert app.captures_late == 2
    for _ in range(4):
        app.transmit("SPI", 0)
    assert app.frames_sent == 1
    assert [capture(app, bytes(2400))[0] for _ in range(2)] == [0, 2]


@pytest.mark.parametrize("body", [b"", bytes(2399), bytes(2401)], ids=["failed", "short", "long"])
def test_a_capture_without_a_whole_picture_has_failed(body: bytes) -> None:
    app = gap8()
    capture(app, body)
    assert (app.captures_failed, app.frame) == (1, 0)
    assert sent(app) == []
    capture(app, bytes(2400))
    assert len(sent(app)) == 4


def test_a_camera_that_never_answers_costs_one_second() -> None:
    app = gap8()
    assert app.transmit("CAMERA", 5) != b""
    assert app.deadline() == 5 + TIMEOUT_US
    assert app.transmit("CAMERA", 4 + TIMEOUT_US) == b""
    assert app.transmit("SPI", 5 + TIMEOUT_US) == b""  # any port notices
    assert app.captures_failed == 1
    assert app.transmit("CAMERA", 5 + TIMEOUT_US) != b""
    app.receive("CAMERA", bytes(2400), 6 + TIMEOUT_US)
    assert (app.captures_failed, app.frame) == (1, 1)


def test_an_answer_after_the_timeout_is_no_frame() -> None:
    app = gap8()
    app.transmit("CAMERA", 0)
    app.receive("CAMERA", bytes(2400), TIMEOUT_US)
    assert (app.captures_failed, app.frame) == (1, 0)
    app.receive("CAMERA", bytes(2400), TIMEOUT_US)
    assert (app.captures_failed, app.frame) == (1, 0)


def test_a_client_that_goes_in_mid_frame_leaves_nothing_behind() -> None:
    app = gap8()
    bodies = [picture(2400, seed) for seed in range(3)]
    capture(app, bodies[0])
    capture(app, bodies[1])
    for _ in range(2):
        app.transmit("SPI", 0)
    app.transmit("CAMERA", 0)
    app.receive("SPI", GONE, 1)
    assert sent(app) == []
    assert app.frames_unsent == 2
    app.receive("CAMERA", bytes(2400), 2)  # the capture that was under way
    assert app.frames_unsent == 3
    assert app.transmit("CAMERA", 3) == b""
    assert app.deadline() == NEVER_US
    app.receive("SPI", CONNECTED, 4_000_000)
    capture(app, bodies[2], 4_000_000)
    assert sent(app) == stock(60, 40, RAW, [bodies[2]])


def test_being_told_again_that_a_client_is_there_changes_nothing() -> None:
    app = gap8(camera={"frame_period_us": 100_000})
    capture(app, bytes(2400))
    app.transmit("SPI", 0)
    app.receive("SPI", CONNECTED, 50_000)
    assert app.transmit("CAMERA", 50_000) == b""
    assert len(sent(app)) == 3
    assert app.frames_unsent == 0


@pytest.mark.parametrize(
    "config",
    [
        {"width": 1025},
        {"height": 1025},
        {"height": 0},
        {"stamp_bits": 65},
        {"camera": {"burst": 4}},
        {"camera": {"exposure_lines": 1}},
    ],
    ids=str,
)
def test_a_configuration_out_of_range_is_refused(config: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="-5"):
        gap8(**config)


def test_a_new_client_begins_with_a_whole_burst() -> None:
    app = gap8(camera={"burst": 3, "frame_period_us": 100_000})
    app.transmit("CAMERA", 0)
    app.receive("SPI", GONE, 1)
    app.receive("CAMERA", bytes(2400), 2)
    app.receive("SPI", CONNECTED, 3)
    for _ in range(3):
        capture(app, bytes(2400), 4)
    assert app.transmit("CAMERA", 5) == b""
    assert app.deadline() == 100_003
