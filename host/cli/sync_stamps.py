"""`host sync stamps`: what it says."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict
from typing import Any

import numpy as np

from ..clock.stamps import Stamped, stamp
from ..link.restamp import Restamped
from ..protocol.errors import LocalError, PeerError
from . import sync_apply
from .as_json import line
from .sync_stamps_read import Source, read

CANNOT = {
    "stock": "stock frames carry no time and no message of the STM32's: nothing can be worked out but their arrival;"
    " use native firmware",
    "paper": "paper frames carry one STM32 time in ms, already worked out, and neither the GAP8's clock nor the"
    " messages: it cannot be worked out anew. Constant parts can be taken off: add 3.476 ms (40 bytes on the wire), and"
    " 0.5 ms for the cut to ms; subtract readout and exposure to get their middle. Frames that were stamped by an old"
    " message cannot be told from others",
}
NANOCOCKPIT = (
    "NanoCockpit frames bring the last state alone: between frames all others are lost, and as released its STM32 time"
    " is a tick of 1 ms"
)


def run(arguments: argparse.Namespace) -> int:
    """4 if there is no frame, or none of a robot's can be given a time."""
    from ..link.replay import Recording
    from .new_file import new_file
    from .sync_plot import new_picture
    from .sync_stamps_plot import shapes

    code = 0
    if arguments.row and not arguments.apply:
        raise LocalError("--row: its times are in what --apply OUT writes: add it")
    if arguments.apply:
        sync_apply.check(arguments.file, arguments.apply)
    times: dict[int, list[Restamped]] = {}
    with ExitStack() as outputs:
        # Before anything is read, and kept only if all goes well.
        draw = outputs.enter_context(new_picture(arguments.plot, arguments.force))
        table = outputs.enter_context(new_file(arguments.apply, arguments.force)) if arguments.apply else None
        recording = Recording(arguments.file)
        robots = sorted(recording.sources) if arguments.robot is None else [recording.source(arguments.robot).number]
        recording.close()
        if len(robots) > 1 and (draw or (table and not sync_apply.is_recording(arguments.apply))):
            raise LocalError(
                f"{arguments.file}: of {len(robots)} robots; choose one with --robot to draw, or to write a table"
            )
        for robot in robots:
            source = read(arguments.file, robot, arguments.row)
            if not source.dialects:
                raise PeerError(f"{arguments.file}: robot {robot}: no frame came whole")
            result = work_out(source)
            if arguments.json:
                print(line(as_record(arguments.file, source, result)))
            else:
                print("\n".join(lines(arguments.file, source, result)))
            if result is None or not len(result.frame):
                code = 4
                continue
            times[robot] = sync_apply.restamped(source, result)
            if draw:
                draw(*shapes(result, source.own_flags))
        if (table or draw) and not times:
            raise PeerError(f"{arguments.file}: no frame can be given a time, so nothing was written")
        if table:
            sync_apply.write(arguments.file, arguments.apply, table, times, arguments.row is not None)
    return code


def work_out(source: Source) -> Stamped | None:
    """None when the frames have no time of the GAP8's."""
    if not source.index:
        return None
    arrival_us = (np.array(source.arrival_ns, np.int64) - source.arrival_ns[0]).astype(np.float64) / 1000
    all_times = source.stm32, source.gap8, source.frame_gap8, source.frame_after, source.resets
    return stamp(*all_times, source.wire_us, 1000.0 if source.in_ms else 1.0, source.readings, arrival_us)


def as_record(name: str, source: Source, result: Stamped | None) -> dict[str, Any]:
    """For a program."""
    record: dict[str, Any] = {
        "event": "stamps",
        "file": name,
        "robot": source.robot,
        "frames": source.dialects,
        "messages": len(source.stm32),
        "notes": list(notes(source)),
    }
    if result is None:
        return {**record, "stamped": 0, "refused": {}, "epochs": []}
    return {
        **record,
        "stamped": len(result.frame),
        "holdover": int(result.held_over.sum()),
        "refused": dict(Counter(result.refused.values())),
        "messages_dropped": result.sorted.dropped,
        "gap8_tick_us": result.gap8_tick_us,
        "stm32_tick_us": result.stm32_tick_us,
        "not_in_bound": unseen(source, result),
        **echo_record(source),
        "frames_paced": int(result.ends.paced[result.frame].sum()),
        "read_late_us": None if result.ends.late_us is None else round(result.ends.late_us, 1),
        "wire_us": round(result.wire_us, 1),
        "bound_us_median": median(result.bound_us),
        "own_error_us": own_error(source, result),
        "own_flags": dict(Counter(name for names in source.own_flags for name in names)),
        "epochs": [epoch_record(result, number) for number in range(len(result.fitted))],
    }


def unseen(source: Source, result: Stamped) -> str:
    told = source.echo
    most = ""
    if told:
        most = f" (0 to {told.minimum_delay_us + told.minimum_delay_error_us} us, by {told.echoes} echoes)"
    at = "every frame" if result.ends.told else "the end of a frame"
    return f"a delay that every message has beyond the wire{most}; how late the GAP8 reads its clock at {at}"


def echo_record(source: Source) -> dict[str, int | None]:
    """What the robot last said of the delay that every message has."""
    if source.echo:
        return asdict(source.echo)
    return {"minimum_delay_us": None, "minimum_delay_error_us": None, "echoes": 0}


def median(values: Any) -> float | None:
    return round(float(np.median(values)), 2) if len(values) else None


def own_error(source: Source, result: Stamped) -> dict[str, float] | None:
    """Of the times that the robot gave, against those from all messages: median and worst."""
    if not len(source.stm32):
        return None
    away = source.own_stm32_us[result.frame] - result.stm32_us
    # The robot's times are those that its messages count, less the wraps that these show beside the frame.
    wraps = result.sorted.stm32_us - source.stm32.astype(np.int64)
    after = source.frame_after[result.frame]
    before_us, after_us = (
        away + wraps[np.clip(beside, 0, len(wraps) - 1)].astype(np.float64) for beside in (after - 1, after)
    )
    away = np.where(np.abs(before_us) < np.abs(after_us), before_us, after_us)
    away = away[~np.isnan(away)]
    if not len(away):
        return None
    worst = float(away[np.argmax(np.abs(away))])
    return {"median": round(float(np.median(away)), 1), "sd": round(float(away.std()), 1), "worst": round(worst, 1)}


def epoch_record(result: Stamped, number: int) -> dict[str, Any]:
    each = result.fitted[number]
    mine = result.epoch == number
    known = each.steadiness
    best = int(np.argmin(known.deviation_ppm)) if known.span_s else None
    return {
        "epoch": number,
        "why": each.epoch.why,
        "from_gap8_us": round(each.sent_us[0]),
        "to_gap8_us": round(each.sent_us[1]),
        "messages": len(each.epoch.messages),
        "frames": int(mine.sum()),
        "drift_ppm": round(each.drift_ppm, 3),
        "stm32_counts_84_of_85": each.is_slow,
        "sure_of_84_of_85": not each.wire_bound_us,
        "delay_us": median(each.smoothed.mu_us),
        "bound_us_median": median(result.bound_us[mine]),
        "bound_us_max": round(float(result.bound_us[mine].max()), 2) if mine.any() else None,
        "block_s": median(each.smoothed.block_s),
        "steadiest_ppm": None if best is None else round(known.deviation_ppm[best], 4),
        "steadiest_s": None if best is None else round(known.span_s[best], 2),
    }


def notes(source: Source) -> Iterator[str]:
    for dialect in source.dialects:
        if dialect in CANNOT and "native" not in source.dialects:
            yield CANNOT[dialect]
        elif dialect == "nanocockpit":
            yield NANOCOCKPIT


def lines(name: str, source: Source, result: Stamped | None) -> Iterator[str]:
    """For people."""
    record = as_record(name, source, result)
    frames = ", ".join(f"{count} {dialect} frames" for dialect, count in source.dialects.items())
    yield f"{name}, robot {source.robot}: {frames}, {len(source.stm32)} messages with both clocks"
    if result is not None:
        yield (
            f"  clocks    GAP8 in steps of {result.gap8_tick_us:.4g} us, STM32 of {result.stm32_tick_us:.4g} us;"
            f" {result.wire_us:.1f} us on the wire taken off"
        )
        for each in record["epochs"]:
            seconds = (each["to_gap8_us"] - each["from_gap8_us"]) * 1e-6
            yield f"  epoch {each['epoch']:<4}{seconds:.1f} s, {each['messages']} messages: {each['why']}"
            slow = "; the STM32 counts 84 where 85 have passed" if each["stm32_counts_84_of_85"] else ""
            slow += "" if each["sure_of_84_of_85"] else "; or the GAP8's clock is off by more: in the bound"
            yield f"            drift {each['drift_ppm']:+.2f} ppm (GAP8 against STM32){slow}"
            bound = "no frame" if each["bound_us_median"] is None else f"±{each['bound_us_median']:.1f} us (99 %)"
            yield f"            messages late by {each['delay_us']:.0f} us on average; frames' bound {bound}"
        for why, count in record["messages_dropped"].items():
            yield f"  dropped   {count} messages: {why}"
        yield f"  stamped   {record['stamped']} of {len(source.index)} frames"
        if record["own_error_us"]:
            own = record["own_error_us"]
            yield (
                f"  robot's   own times were {own['median']:+.1f} us off (median), sd {own['sd']:.1f},"
                f" worst {own['worst']:+.1f}"
            )
        if record["holdover"]:
            yield (
                f"  holdover  {record['holdover']} of them before the first message or behind the last: right if the"
                " clock was not set meanwhile"
            )
        for why, count in record["refused"].items():
            yield f"  refused   {count} frames: {why}"
        if record["read_late_us"] is not None:
            yield (
                f"  frames    {record['frames_paced']} of one pace: their ends were read late by"
                f" {record['read_late_us']:.1f} us on average, taken off"
            )
        yield f"  unseen    {unseen(source, result)}"
    yield from (f"  note      {each}" for each in record["notes"])
