"""Positions and attitudes out of a log's variables, in real logs too, and how long those hold an estimate."""

from typing import Any

import numpy as np
import pytest
from logs import real
from scipy.spatial.transform import Rotation

from host.protocol.errors import LocalError
from host.usd import runs
from host.usd.decode import decode
from host.usd.track import decompressed, read_track


def compressed(quaternion: Any) -> int:
    """As quatcompress.h does it."""
    largest = int(np.argmax(np.abs(quaternion)))
    packed = largest
    for place in range(4):
        if place != largest:
            negative = (quaternion[place] < 0) != (quaternion[largest] < 0)
            packed = packed << 10 | int(negative) << 9 | int(511 * (abs(quaternion[place]) / np.sqrt(0.5)) + 0.5)
    return packed


def test_compressed_quaternions() -> None:
    turns = Rotation.random(500, random_state=4)
    packed = np.array([compressed(each) for each in turns.as_quat()], np.uint32)
    assert (Rotation.from_quat(decompressed(packed)).inv() * turns).magnitude().max() < 0.005
    assert decompressed(np.array([3 << 30], np.uint32)).tolist() == [[0, 0, 0, 1]]


def test_sources_of_real_logs() -> None:
    flight = decode(real("flights/eckart12"))
    assert read_track(flight).name == "fixedFrequency:stateEstimate"
    assert {read_track(flight, name).name for name in ("estPose", "locSrv", "estPose:locSrv")} == {"estPose:locSrv"}
    with pytest.raises(LocalError, match="gyro: no position or attitude; there are fixedFrequency:stateEstimate"):
        read_track(flight, "gyro")
    with pytest.raises(LocalError, match="fixedFrequency: several"):
        read_track(decode(real("flights/hole-1.5s")), "fixedFrequency")
    with pytest.raises(LocalError, match="no position or attitude in it"):
        read_track(decode(real("events/kalman03")))
    older = read_track(decode(real("swap-2/cf50_02")))
    assert older.name == "fixedFrequency:stateEstimateZ"
    assert np.abs(older.position_m).max() < 5
    assert older.attitude is not None


@pytest.mark.parametrize("name", ["flights/jana00", "flights/jana20", "flights/eckart12"])
def test_how_long_real_logs_at_500_hz_hold_an_estimate(name: str) -> None:
    """The README's figures."""
    found = read_track(decode(real(name)))
    rows = np.arange(len(found.stamp_us))
    held_us = np.diff(found.stamp_us[runs.is_new(found, rows, rows * 0)].astype(float))
    assert 3900 < np.median(held_us) < 6000
    assert np.percentile(held_us, 99) < 10_000
