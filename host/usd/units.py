"""Units of the variables that the Crazyflie's firmware logs, as its documentation gives them. A log does not say."""

from __future__ import annotations

import re

UNITS: tuple[tuple[str, str], ...] = (
    (r"(stateEstimate|ctrltarget|locSrv)\.p?[xyz]", "m"),
    (r"(stateEstimate|ctrltarget)\.p?v[xyz]", "m/s"),
    (r"stateEstimate\.a[xyz]", "g"),
    (r"(stateEstimate|stabilizer|controller|ctrltarget)\.(roll|pitch|yaw)", "deg"),
    (r"(stateEstimateZ|ctrltargetZ)\.[xyz]", "mm"),
    (r"(stateEstimateZ|ctrltargetZ)\.v[xyz]", "mm/s"),
    (r"(stateEstimateZ|ctrltargetZ)\.a[xyz]", "mm/s²"),
    (r"stateEstimateZ\.rate(Roll|Pitch|Yaw)", "mrad/s"),
    (r"gyro\.[xyz]", "deg/s"),
    (r"acc\.[xyz]", "g"),
    (r"baro\.asl", "m"),
    (r"baro\.temp", "°C"),
    (r"baro\.pressure", "mbar"),
    (r"pm\.vbat", "V"),
    (r"pm\.vbatMV", "mV"),
    (r"rpm\.m[1-4]", "rpm"),
    (r"range\.\w+", "mm"),
    (r"kalman_mm\.tof\w+", "m"),
    (r"distanceDiff|distance", "m"),
    (r"sweepAngle|yawError", "rad"),
    (r"stall_us", "us"),
)


def unit_of(name: str) -> str:
    """Nothing when it is not known, or has none."""
    name = name.partition("#")[0]
    return next((unit for pattern, unit in UNITS if re.fullmatch(pattern, name)), "")
