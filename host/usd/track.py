"""Where a robot was and how it was turned, row by row: positions and attitudes out of a log's variables."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..protocol.errors import LocalError
from .log import Log, Rows

POSITIONS = ("stateEstimate", "stateEstimateZ", "locSrv", "ctrltarget", "ctrltargetZ")
"""Groups whose x, y, z are a position, if there is no attitude that says so; the first there is the default."""
AXES = ("x", "y", "z")
QUATERNION = ("qx", "qy", "qz", "qw")
COMPRESSED = "quat"
NORM_OFF = 0.05
"""A quaternion whose norm is further from 1 is none: before the first pose, all its numbers are 0."""


@dataclass(frozen=True, slots=True)
class Track:
    """Rows with a position, an attitude or both, in the order of the log."""

    name: str
    """TYPE:GROUP."""
    stamp_us: NDArray[np.uint64]
    quantum_us: int
    """Stamps are cut to multiples of this."""
    epochs: tuple[range, ...]
    is_verified: NDArray[np.bool_]
    position_m: NDArray[np.float64] | None
    """(rows, 3)."""
    attitude: NDArray[np.float64] | None
    """(rows, 4), x y z w, of length 1; NaN where the log has none."""


def read_track(log: Log, source: str | None = None) -> Track:
    """`source`: a group of variables, a type of rows, or TYPE:GROUP. None: the first group that is known to be a pose.
    LocalError when there is none, or several that are meant."""
    there = {f"{rows.type.name}:{group}": (rows, group) for rows in log.rows.values() for group in groups(rows)}
    if not there:
        raise LocalError("no position or attitude in it, as stateEstimate.x, .y, .z or stateEstimate.qx, .qy, .qz, .qw")
    name = choose(list(there), source)
    rows, group = there[name]
    return Track(
        name=name,
        stamp_us=rows.stamp_us,
        quantum_us=1000 if log.version == 1 else 1,
        epochs=rows.epochs,
        is_verified=rows.is_verified,
        position_m=positions(rows, group),
        attitude=attitudes(rows, group),
    )


def choose(there: list[str], source: str | None) -> str:
    if source is None:
        known = [name for group in POSITIONS for name in there if name.endswith(f":{group}")]
        return (known or there)[0]
    found = [name for name in there if source in (name, *name.split(":"))]
    if len(found) == 1:
        return found[0]
    what = "several" if found else "no position or attitude"
    raise LocalError(f"{source}: {what}; there {'is' if len(there) == 1 else 'are'} {', '.join(found or there)}")


def groups(rows: Rows) -> Iterator[str]:
    """That hold a pose."""
    members: dict[str, set[str]] = {}
    for each in rows.type.variables:
        group, _, name = each.name.rpartition(".")
        members.setdefault(group, set()).add(name)
    for group, names in members.items():
        if (group in POSITIONS and names.issuperset(AXES)) or names.issuperset(QUATERNION) or COMPRESSED in names:
            yield group


def positions(rows: Rows, group: str) -> NDArray[np.float64] | None:
    """Integers are millimetres: stateEstimateZ and ctrltargetZ."""
    values = columns(rows, group, AXES)
    if values is None:
        return None
    whole = all(rows.data.dtype[f"{group}.{axis}"].kind in "iu" for axis in AXES)
    return values / 1000 if whole else values


def attitudes(rows: Rows, group: str) -> NDArray[np.float64] | None:
    values = columns(rows, group, QUATERNION)
    if values is None:
        if f"{group}.{COMPRESSED}" not in (rows.data.dtype.names or ()):
            return None
        values = decompressed(rows.data[f"{group}.{COMPRESSED}"])
    length = np.sqrt((values * values).sum(axis=1, keepdims=True))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(np.abs(length - 1) < NORM_OFF, values / length, np.nan)


def columns(rows: Rows, group: str, names: tuple[str, ...]) -> NDArray[np.float64] | None:
    if not {f"{group}.{name}" for name in names} <= set(rows.data.dtype.names or ()):
        return None
    return np.stack([rows.data[f"{group}.{name}"].astype(np.float64) for name in names], axis=1)


def decompressed(packed: NDArray[Any]) -> NDArray[np.float64]:
    """The Crazyflie's 32 bits of a unit quaternion (quatcompress.h): which of the four is largest, and then sign and
    nine bits of each of the others."""
    rest = packed.astype(np.uint32)
    largest = (rest >> 30).astype(np.intp)
    values = np.zeros((len(rest), 4))
    for place in (3, 2, 1, 0):
        here = largest != place
        size = (rest & 511) / 511 * np.sqrt(0.5)
        values[:, place] = np.where(here, np.where(rest >> 9 & 1, -size, size), 0)
        rest = np.where(here, rest >> 10, rest)
    values[np.arange(len(rest)), largest] = np.sqrt(np.maximum(0, 1 - (values * values).sum(axis=1)))
    return values
