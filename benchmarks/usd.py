"""Decode a uSD log of 100 MB (1 kHz rows of 20 floats, an event every 20 rows) into structured arrays, CRC included.

The bound is bytearray(data), taken in turn with it: the best of some rounds each, in processor time. The peer is a
model of the reader that users of the stock firmware have (tests/usd/existing_reader.py), value by value. Peak memory is
that of fresh processes, above what they take without a log.

    python benchmarks/usd.py [--megabytes 100] [--rounds 9] [--model-rounds 1] [--json]
"""

from __future__ import annotations

import argparse
import json
import resource
import struct
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests/usd"))

import numpy as np
from existing_reader import decode as existing  # type: ignore[import-not-found]

from host.usd.decode import decode
from host.usd.files import read_log

FLOATS = 20
EVENT_EVERY = 20
STATUS_EVERY = 250
SESSION = 0x5EED5EED
SEED = 20261122


def made(megabytes: float, statuses: bool) -> bytes:
    """A log; with status rows as this project's logger writes them, or as the stock one does."""
    types = [(0xFFFF, "fixedFrequency", [f"log.v{number}(f)" for number in range(FLOATS)])]
    types.append((9, "estPose", [f"locSrv.{name}(f)" for name in ("x", "y", "z", "qx", "qy", "qz", "qw")]))
    if statuses:
        names = ["requested", "accepted", "dropped", "stall_us", "syncs", "errors", "session", "crc"]
        types.append((20, "log.status", [f"{name}(I)" for name in names]))
    header = struct.pack("<BHH", 0xBC, 2, len(types))
    for number, name, variables in types:
        header += struct.pack("<H", number) + name.encode() + b"\0" + struct.pack("<H", len(variables))
        header += b"".join(each.encode() + b"\0" for each in variables)
    fixed = np.dtype([("id", "<u2"), ("stamp", "<u8"), ("values", "<f4", FLOATS)])
    pose = np.dtype([("id", "<u2"), ("stamp", "<u8"), ("values", "<f4", 7)])
    count = int(megabytes * 1e6 / (fixed.itemsize + pose.itemsize / EVENT_EVERY))
    random = np.random.default_rng(SEED)
    rows, poses = np.empty(count, fixed), np.empty(count // EVENT_EVERY, pose)
    rows["id"], rows["stamp"], rows["values"] = 0xFFFF, np.arange(count) * 1000, random.normal(size=(count, FLOATS))
    poses["id"], poses["stamp"] = 9, np.arange(len(poses)) * 1000 * EVENT_EVERY + 500
    poses["values"] = random.normal(size=(len(poses), 7))
    out = bytearray(header)
    covered = 0

    def status(stamp: int, accepted: int) -> None:
        nonlocal covered
        out.extend(struct.pack("<HQ7I", 20, stamp, accepted, accepted, 0, 2000, accepted // STATUS_EVERY, 0, SESSION))
        out.extend(struct.pack("<I", zlib.crc32(memoryview(out)[covered:])))
        covered = len(out)

    if statuses:
        status(0, 0)
    for number in range(len(poses)):
        out += rows[number * EVENT_EVERY : (number + 1) * EVENT_EVERY].tobytes()
        out += poses[number].tobytes()
        if statuses and number * EVENT_EVERY % STATUS_EVERY < EVENT_EVERY:
            status(number * EVENT_EVERY * 1000 + 900, number * (EVENT_EVERY + 1))
    return bytes(out) + struct.pack("<I", zlib.crc32(out))


def timed(work: Callable[[], Any]) -> float:
    """Seconds of processor time: one thread does all, and others on the machine matter less."""
    begin = time.process_time()
    result = work()
    passed = time.process_time() - begin
    del result
    return passed


def peak_kib() -> int:
    """Of this process so far. Where there is no /proc, what its parent had counts too."""
    status = Path("/proc/self/status")
    if status.exists():
        return int(next(line for line in status.read_text().splitlines() if line.startswith("VmHWM")).split()[1])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def memory(path: str, way: str) -> None:
    """In a process of its own: KiB of peak memory that decoding takes."""
    decode(made(0.01, False))
    before = peak_kib()
    log = decode(Path(path).read_bytes() if way == "read" else read_log(path))
    print(peak_kib() - before if log.is_whole else "not decoded")


def measured_memory(data: bytes) -> dict[str, float]:
    """Of the file's size."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log00"
        path.write_bytes(data)
        of: dict[str, float] = {}
        for way in ("mapped", "read"):
            words = [sys.executable, __file__, "--memory", str(path), way]
            result = subprocess.run(words, capture_output=True, text=True, check=True)
            of[f"peak_{way}"] = round(int(result.stdout) * 1024 / len(data), 2)
        return of


def measure(megabytes: float, rounds: int, model_rounds: int) -> dict[str, float]:
    """All in turn, so that a busy machine slows all."""
    data, own = made(megabytes, False), made(megabytes, True)
    closed = decode(own)
    if not (decode(data).is_whole and closed.is_whole and closed.session == SESSION):
        raise SystemExit("the log does not decode")
    cut = own[:-100]  # As a power cut leaves it: every status row's CRC instead of the one at the end.
    best: dict[str, float] = {}
    for number in range(rounds):
        for name, work, size in (
            ("bytearray", lambda: bytearray(data), len(data)),
            ("decode", lambda: decode(data), len(data)),
            ("decode_statuses", lambda: decode(own), len(own)),
            ("decode_cut", lambda: decode(cut), len(cut)),
            ("model", lambda: existing(data), len(data)),
        ):
            if name == "model" and number >= model_rounds:
                continue
            best[name] = max(best.get(name, 0), size / timed(work) / 1e6)
    figures = {f"{name}_mb_s": round(speed, 1) for name, speed in best.items()}
    for name in ("decode", "decode_statuses", "decode_cut"):
        figures[f"{name}_of_bytearray"] = round(best[name] / best["bytearray"], 2)
    figures["decode_times_model"] = round(best["decode"] / best["model"])
    return {"megabytes": round(len(data) / 1e6, 1), **figures, **measured_memory(data)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--megabytes", type=float, default=100)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--model-rounds", type=int, default=1, help="it takes ten seconds and 1 GB")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--memory", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.memory:
        memory(*arguments.memory)
        return
    figures = measure(arguments.megabytes, arguments.rounds, arguments.model_rounds)
    if arguments.json:
        print(json.dumps(figures))
        return
    print(f"{'bytearray(data)':26} {figures['bytearray_mb_s']:7.0f} MB/s")
    for name, says in (("decode", "decode"), ("decode_statuses", "with status rows"), ("decode_cut", "cut off")):
        print(f"{says:26} {figures[f'{name}_mb_s']:7.0f} MB/s, {figures[f'{name}_of_bytearray']:.2f} of it")
    times = f"decode is {figures['decode_times_model']} times as fast"
    print(f"{'model of the stock reader':26} {figures['model_mb_s']:7.1f} MB/s; {times}")
    print(f"peak memory, of the file   {figures['peak_mapped']:.2f} mapped, {figures['peak_read']:.2f} read")


if __name__ == "__main__":
    main()
