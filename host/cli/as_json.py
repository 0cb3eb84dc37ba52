"""Events as JSON lines: one object each, `event` first, times with their clock in the name."""

from __future__ import annotations

import dataclasses
import json
from typing import TYPE_CHECKING, Any

from ..link.frame import Frame, LostFrame
from ..link.records import Event, State
from ..link.state import describe

if TYPE_CHECKING:
    from .row import Row

EVENT_NAMES = {
    "LostFrame": "lost_frame",
    "PaperStamp": "paper_stamp",
    "NanocockpitStamp": "nanocockpit_stamp",
    "LogStatus": "log_status",
}


def as_dict(event: Event, robot: int, row: Row | None = None) -> dict[str, Any]:
    """Everything but pixels and pairs, which become their number. What a frame's dialect adds lies beside the rest, and
    the time of a row if one is given."""
    name = type(event).__name__
    record: dict[str, Any] = {"event": EVENT_NAMES.get(name, name.lower()), "robot": robot}
    for field in dataclasses.fields(event):
        record[field.name] = getattr(event, field.name)
    if isinstance(event, Frame):
        record.update(bytes=int(event.body.size), pairs=None if event.pairs is None else len(event.pairs))
        header = event.native or event.paper or event.nanocockpit
        record.update(dataclasses.asdict(header) if header else {})
        record.update(dialect=event.dialect, frame_stm32_us=event.frame_stm32_us)
        if row:
            record.update(row=row.of(event.height), row_stm32_us=row.stm32_us(event))
        if event.nanocockpit:
            record.update(round_trip_us=event.nanocockpit.round_trip_us)
        for name in ("native", "paper", "nanocockpit", "body"):
            del record[name]
    elif isinstance(event, LostFrame):
        del record["body"]
    elif isinstance(event, State):
        record["text"] = describe(event, event.arrival_host_ns)
    elif isinstance(record.get("data"), bytes):
        record["data"] = record["data"].hex()
    return record


def line(record: dict[str, Any]) -> str:
    """One line of JSON, without the newline."""
    return json.dumps(record, separators=(",", ":"), allow_nan=False, default=dataclasses.asdict)
