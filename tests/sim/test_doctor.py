"""host doctor's judgement on simulated robots: one fault each, none, and one slow stage. benchmarks/doctor.py is the
same with more seeds and a whole minute.
"""

import pytest
from doctor_cases import CLEAN, FAULTS, SLOW, VARIETY, Case, listen

from host.link.counters import SessionCounters
from host.link.diagnosis import diagnose
from host.link.listening import Listening

SMALL = {"camera_width": 160, "camera_height": 120}
SECONDS = 20
NEEDS_SIZE = {"SPI damages packets", "SPI loses packets", "Wi-Fi too slow", "connection damages bytes", "host too slow"}
"""Rates in these are per byte of a full picture."""


@pytest.mark.parametrize("case", FAULTS, ids=lambda case: case.name)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_fault_is_named_and_nothing_else_is_blamed(case, seed):
    size = {} if case.name in NEEDS_SIZE else SMALL
    found = diagnose(listen(case, seed, 30 if size == {} else SECONDS, **size)).findings
    named = [(finding.stage, finding.cause) for finding in found if finding.severity != "note"]
    assert named, "nothing was found"
    assert any(stage == case.stage and cause in case.causes for stage, cause in named), named
    assert {stage for stage, _ in named} == {case.stage}, named
    assert all(finding.what and finding.todo for finding in found)


@pytest.mark.parametrize("seed", range(10))
def test_a_clean_robot_raises_no_alarm(seed):
    diagnosis = diagnose(listen(CLEAN, seed, SECONDS, **SMALL | VARIETY[seed % len(VARIETY)]))
    assert diagnosis.findings == []
    assert diagnosis.healthy
    assert diagnosis.bottleneck == "camera"


@pytest.mark.parametrize("case", SLOW, ids=lambda case: case.name)
def test_the_bottleneck_is_named(case):
    diagnosis = diagnose(listen(case, 3, SECONDS))
    assert diagnosis.bottleneck == case.stage, diagnosis.rate


@pytest.mark.parametrize("seconds", [0.1, 0.6, 0.7, 0.8, 1.0, 1.2, 1.5, 2.0, 3.0])
def test_a_short_look_raises_no_alarm(seconds):
    heard = listen(CLEAN, 1, seconds, **SMALL)
    causes = {finding.cause for finding in diagnose(heard).findings}
    assert causes <= ({"no_frames"} if not heard.frames else {"stock"})


def test_a_stock_stream_says_what_cannot_be_seen():
    diagnosis = diagnose(listen(Case("stock", "", (), {"firmware": "stock"}), 1, SECONDS, **SMALL))
    assert [finding.cause for finding in diagnosis.findings] == ["stock"]
    assert diagnosis.healthy
    assert diagnosis.bottleneck is None


@pytest.mark.parametrize(
    ("settings", "stage", "cause"),
    [
        ({"tcp_drop": 0.000002}, "Wi-Fi", "tcp_damage"),
        ({"spi_loss": 0.002}, "SPI", "frames_broken"),
        ({"tcp_stall_per_s": 0.3, "tcp_stall_ms": 900}, "Wi-Fi", "pauses"),
    ],
)
def test_faults_of_a_stock_stream(settings, stage, cause):
    found = diagnose(listen(Case("stock", "", (), {"firmware": "stock", **settings}), 1, 30)).findings
    assert (stage, cause) in [(finding.stage, finding.cause) for finding in found]


@pytest.mark.parametrize(
    ("settings", "cause"),
    [
        ({"wire": "uart1"}, None),
        ({"wire": "uart1", "uart1_loss": 0.1}, "uart1_loss"),
        ({"wire": "uart1", "uart1_flip": 0.002}, "uart1_damage"),
        ({"wire": "uart1", "stm32_divider": 84}, "clock_84_85"),
        ({"wire": "uart1", "uart1_loss": 1}, "silent"),
        ({"uart1_loss": 1}, "no_stamps"),
        ({"wire": "uart2", "camera_fps": 4, "camera_width": 64, "camera_height": 48}, None),
        (
            {"wire": "uart2", "camera_fps": 4, "camera_width": 64, "camera_height": 48, "uart2_flip": 1e-4},
            "uart2_damage",
        ),
        ({"wire": "uart2", "camera_fps": 0}, "no_frames"),
        ({"camera_fps": 0}, "no_frames"),
        ({"camera_hang": 1}, "no_frames"),
    ],
)
def test_other_wires_and_silence(settings, cause):
    found = [finding.cause for finding in diagnose(listen(Case("", "", (), settings), 1, SECONDS)).findings]
    assert (cause in found) if cause else found == []


def test_bytes_that_are_no_packets():
    heard = Listening("cpx-uart", counters=SessionCounters(bytes=1000, garbage_bytes=900))
    assert [finding.cause for finding in diagnose(heard).findings] == ["not_understood", "uart2_damage"]


@pytest.mark.parametrize("firmware", ["paper", "nanocockpit"])
def test_other_firmware_says_what_cannot_be_seen(firmware):
    diagnosis = diagnose(listen(Case(firmware, "", (), {"firmware": firmware}), 1, SECONDS, **SMALL))
    assert [finding.cause for finding in diagnosis.findings] == [firmware]
    assert diagnosis.healthy
    assert f"{firmware} frames" in diagnosis.rate


@pytest.mark.parametrize(
    ("firmware", "settings", "stage", "cause"),
    [
        ("paper", {"uart1_loss": 1}, "UART1", "no_stamps"),
        ("nanocockpit", {"uart1_loss": 1}, "UART1", "no_stamps"),
        ("nanocockpit", {"tcp_bytes_per_s": 100_000}, "Wi-Fi", "frames_skipped"),
        ("paper", {"wire": "uart1", "stm32_divider": 84}, "clock", "clock_84_85"),
    ],
)
def test_faults_of_other_firmware(firmware, settings, stage, cause):
    found = diagnose(listen(Case(firmware, "", (), {"firmware": firmware, **settings}), 1, SECONDS, **SMALL)).findings
    assert [(each.stage, each.cause) for each in found if each.severity != "note"] == [(stage, cause)]
