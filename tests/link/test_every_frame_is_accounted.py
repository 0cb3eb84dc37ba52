"""Simulated robots on bad wires: every native frame number is delivered, or is in exactly one loss counter."""

import pytest

import host

FAULTS = [
    "tcp_loss=0",
    "tcp_stall_per_s=0.7&tcp_stall_ms=2000",
    "tcp_bytes_per_s=40000",
    "tcp_flip=2e-5",
    "tcp_drop=2e-5",
    "spi_loss=0.01",
    "camera_encoding=jpeg&tcp_flip=1e-4",
    "wire=uart2&uart2_loss=0.002",
    "wire=uart2&uart2_flip=2e-5",
]
SECONDS = 10


@pytest.mark.parametrize("faults", FAULTS)
def test_delivered_or_in_one_counter(faults: str) -> None:
    url = f"sim://hover?pace=max&seed=1&camera_fps=20&camera_width=64&camera_height=48&{faults}"
    numbers: list[int] = []
    lost_before, lost_between, lost_since = 0, 0, 0
    with host.open(url, timeout=None) as stream:
        for event in stream.events():
            if isinstance(event, host.Frame) and event.native is not None:
                lost_before, lost_between = (lost_before, lost_between + lost_since) if numbers else (lost_since, 0)
                lost_since = 0
                numbers.append(event.native.frame)
            lost_since += isinstance(event, host.LostFrame)
            if event.arrival_host_ns > SECONDS * 1_000_000_000:
                break
        counters = stream.counters
        world = stream.port.world
    skipped = numbers[-1] - numbers[0] + 1 - len(numbers)
    without_event = sum(counters.frames_lost.values()) - lost_before - lost_between - lost_since
    assert numbers == sorted(set(numbers)), url
    assert skipped == lost_between + without_event, f"{url}: {counters}"
    assert set(counters.frames_lost) == set(host.LOSS_CAUSES)
    assert counters.renumbered == 0
    if faults == FAULTS[0]:
        assert skipped == 0
    else:
        assert skipped > 0, f"{url}: the fault did nothing"
    if "stall" in faults or "bytes_per_s" in faults:
        assert counters.frames_lost["esp32_dropped"] == skipped
        assert world.robots[0].esp32["frames_dropped"] >= skipped
