"""`host sync stamps --apply`: the times as a CSV file, or in a copy of the recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np

from ..clock.stamps import Stamped
from ..link.restamp import Restamped, add_times
from ..protocol.errors import LocalError

if TYPE_CHECKING:
    from .sync_stamps_read import Source

HEADER = "frame_index,frame,frame_gap8_us,frame_stm32_us,bound_us,epoch,refused,holdover"
ROW = "row_stm32_us"
"""One column more, where a row was asked for."""


def is_recording(out: str) -> bool:
    return Path(out).suffix == ".mcap"


def check(recording: str, out: str) -> None:
    """LocalError: it is neither, or would take the place of the recording, --force or not."""
    if Path(out).suffix not in (".csv", ".mcap"):
        raise LocalError(f"{out}: its ending chooses the format: .csv, .mcap")
    if Path(out).exists() and Path(recording).exists() and Path(out).samefile(recording):
        raise LocalError(f"{out}: that is the recording, which is only read: name another file")


def restamped(source: Source, result: Stamped) -> list[Restamped]:
    """Of all frames with a GAP8 time, in their order."""
    given = dict(zip(result.frame.tolist(), range(len(result.frame)), strict=True))
    row_us = result.stm32_us - source.before_end_us[result.frame] * result.stm32_per_gap8
    made = []
    frames = zip(source.index, source.number, source.arrival_ns, source.frame_gap8.tolist(), strict=True)
    for place, (index, number, arrival_ns, gap8_us) in enumerate(frames):
        at = given.get(place)
        made.append(
            Restamped(
                frame_index=index,
                frame=number,
                arrival_host_ns=arrival_ns,
                frame_gap8_us=gap8_us,
                frame_stm32_us=None if at is None else round(float(result.stm32_us[at]), 1),
                bound_us=None if at is None else round(float(result.bound_us[at]), 1),
                epoch=None if at is None else int(result.epoch[at]),
                holdover=None if at is None else bool(result.held_over[at]),
                refused=result.refused[place] if at is None else None,
                row_stm32_us=None if at is None or np.isnan(row_us[at]) else round(float(row_us[at]), 1),
            )
        )
    return made


def write(recording: str, name: str, out: IO[bytes], times: Mapping[int, Sequence[Restamped]], with_row: bool) -> None:
    """Into `out`, whose name will be `name`; a CSV file is of one robot."""
    if is_recording(name):
        add_times(recording, out, times)
        return
    out.write(f"{HEADER}{',' + ROW if with_row else ''}\n".encode())
    for frame in (frame for frames in times.values() for frame in frames):
        if frame.refused is None:
            told = f"{frame.frame_stm32_us},{frame.bound_us},{frame.epoch},,{frame.holdover:d}"
        else:
            told = f",,,{frame.refused},"
        row = "" if not with_row else "," if frame.row_stm32_us is None else f",{frame.row_stm32_us}"
        out.write(f"{frame.frame_index},{frame.frame},{frame.frame_gap8_us},{told}{row}\n".encode())
