"""The same run again, from a log (journal.py)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .journal import Record

if TYPE_CHECKING:
    from .world import World

NS = 1_000_000_000
STEP_NS_MIN = 1000
STEP_BYTES = 16384
"""A host that the log says nothing of reads whenever so much may have come."""


def repeat(world: World, records: list[Record]) -> None:
    """Does to a new world all that its log says, at the same times."""
    steps: list[tuple[int, int, Record]] = []
    for record in records:
        if record["do"] != "reads":
            steps.append((record["t"], record["n"], record))
            continue
        robot = record["robot"]
        steps.append((record["t"], record["n"], {"do": "hold", "robot": robot}))
        for place, (t, n, size) in enumerate(record["reads"]):
            last = record["all"] and place == len(record["reads"]) - 1
            steps.append((t, n, {"do": "read", "robot": robot, "size": size, "last": last}))
    held: set[int] = set()
    for t, _, record in sorted(steps, key=lambda step: step[:2]):
        _read_along(world, t, held)
        arguments = {key: value for key, value in record.items() if key not in ("t", "n", "do", "robot")}
        robot = world.robots[record.get("robot", 0)]
        if record["do"] == "hold":
            robot.read()
            held.add(robot.index)
        elif record["do"] == "read":
            robot.read(record["size"])
            if record["last"]:
                held.discard(robot.index)
        elif record["do"] == "broadcast":
            world.broadcast(bytes.fromhex(record["hex"]))
        elif record["do"] != "end":
            robot.repeat(record["do"], arguments)


def _read_along(world: World, until_ns: int, held: set[int]) -> None:
    """Runs until then, reading so often that no host but the held ones holds up its robot."""
    free = [robot for robot in world.robots if robot.index not in held]
    # A host gets at most what the wire carries: as many steps as it takes to stay far from the limit.
    step_ns = min((round(STEP_BYTES * NS / robot.settings.tcp.bytes_per_s) for robot in free), default=NS)
    while world.now_ns < until_ns:
        world.run_until(min(until_ns, world.now_ns + max(step_ns, STEP_NS_MIN)))
        for robot in free:
            robot.read()
