"""What recording costs: CPU time of `host stream` with and without --record, 4 robots x 15 raw frames a second.

The robots are served by another process (host sim serve), over TCP on loopback. Runs alternate, and their medians are
compared; a run's CPU time is user and system time of that process alone, its start included in both.

    python benchmarks/recording.py [--seconds 15] [--rounds 3] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import IO, Any, cast

ROBOTS = 4
FPS = 15
BAR_PERCENT = 5.0
ROOT = Path(__file__).resolve().parents[1]
HOST = [sys.executable, "-m", "host"]


def serve() -> tuple[subprocess.Popen[str], list[str]]:
    """The robots, and their ports."""
    words = ["sim", "serve", "--listen", "127.0.0.1:0", "--json", f"robots={ROBOTS}", f"camera_fps={FPS}"]
    process = subprocess.Popen([*HOST, *words], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    serving = json.loads(cast(IO[str], process.stdout).readline())
    return process, [robot["port"] for robot in serving["robots"]]


def run(ports: list[str], seconds: float, record: str | None) -> dict[str, Any]:
    """One `host stream`: its CPU seconds, its frames, and what the disk was too slow for."""
    words = ["stream", "--duration", str(seconds), "--json"]
    for port in ports:
        words += ["--port", port]
    if record:
        words += ["--record", record]
    with tempfile.TemporaryFile("w+") as out:
        process = subprocess.Popen([*HOST, *words], cwd=ROOT, stdout=out)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise SystemExit(f"host stream ended with {process.returncode}")
        out.seek(0)
        summaries = [event for event in map(json.loads, out) if event["event"] == "summary"]
    return {
        "cpu_percent": 100 * (usage.ru_utime + usage.ru_stime) / seconds,
        "frames": sum(each["frames"] for each in summaries),
        "missing": sum(sum(each["recorded"]["missing"].values()) for each in summaries) if record else 0,
    }


def measure(seconds: float, rounds: int) -> dict[str, Any]:
    """Medians of alternating runs."""
    server, ports = serve()
    plain, recorded, sizes = [], [], []
    try:
        with tempfile.TemporaryDirectory() as folder:
            for turn in range(rounds):
                plain.append(run(ports, seconds, None))
                path = Path(folder) / f"{turn}.mcap"
                recorded.append(run(ports, seconds, str(path)))
                sizes.append(path.stat().st_size)
                path.unlink()
    finally:
        server.terminate()
        server.wait()
    without, with_ = (statistics.median(each["cpu_percent"] for each in runs) for runs in (plain, recorded))
    return {
        "robots": ROBOTS,
        "fps": round(statistics.median(each["frames"] for each in recorded) / seconds, 1),
        "without_percent": round(without, 2),
        "with_percent": round(with_, 2),
        "recording_percent": round(with_ - without, 2),
        "megabytes_per_s": round(statistics.median(sizes) / seconds / 1e6, 2),
        "missing": sum(each["missing"] for each in recorded),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    figures = measure(arguments.seconds, arguments.rounds)
    if arguments.json:
        print(json.dumps(figures))
        return
    print(
        "recording   {recording_percent:.1f} % of a core more: host stream takes {without_percent:.1f} %, "
        "with --record {with_percent:.1f} %".format_map(figures)
        + f" (bar: {BAR_PERCENT:.0f} % more)"
    )
    print(
        "            {robots} robots, {fps:.0f} frames/s in all, {megabytes_per_s:.1f} MB/s to the disk, "
        "{missing} left out".format_map(figures)
    )


if __name__ == "__main__":
    main()
