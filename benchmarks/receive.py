"""Receive and split a 324x244 stock stream over loopback: from the socket to frame objects with their arrival time.

The sender is another process with prepared bytes. The bound is a bare recv_into of the same bytes, measured in turn
with it: the best of some rounds each. Then a long run, to see that memory stays flat.

    python benchmarks/receive.py [--frames 6000] [--rounds 9] [--long 10000] [--json]
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

import host
from host.link.ports import RECEIVE_BYTES
from host.native import ffi, lib

WIDTH, HEIGHT = 324, 244
SEED = 20260801
PREPARED_FRAMES = 16
PEERS = (
    "peers' clients, measured the same way on another machine: cflib 0.1.34 0.015 of its bound and 1.20 CPU s per "
    "1000 frames; the official viewer's loop without its windows 0.074 and 0.23"
)


def packet(data: bytes) -> bytes:
    """CPX over TCP from the GAP8 to the host, as the stock streamer sends it."""
    out = ffi.new("uint8_t[]", lib.CPX_LINK_FRAME_MAX)
    route = (lib.CPX_HOST, lib.CPX_GAP8, lib.CPX_APP, 0, True, False)
    source = ffi.from_buffer("uint8_t[]", data)
    size = lib.cpx_link_encode(ffi.new("cpx_packet_t *", (route, (source, len(data)))), (out, len(out)))
    return bytes(ffi.buffer(out, size))


def prepared() -> bytes:
    """Some frames of noise."""
    random = np.random.default_rng(SEED)
    header = ffi.new("uint8_t[]", lib.IMAGE_STOCK_BYTES)
    lib.image_stock_encode(ffi.new("image_stock_t *", (WIDTH, HEIGHT, 1, lib.IMAGE_RAW, WIDTH * HEIGHT)), header)
    parts = []
    for _ in range(PREPARED_FRAMES):
        body = random.integers(0, 256, WIDTH * HEIGHT, np.uint8).tobytes()
        parts.append(packet(bytes(header)))
        parts += [packet(body[at : at + lib.CPX_DATA_MAX]) for at in range(0, len(body), lib.CPX_DATA_MAX)]
    return b"".join(parts)


def send(ports: Any, runs: list[int]) -> None:
    """The other process: serves each run on one connection."""
    data = memoryview(prepared())
    with socket.create_server(("127.0.0.1", 0)) as server:
        ports.send(server.getsockname()[1])
        for frames in runs:
            connection, _ = server.accept()
            with connection:
                for _ in range(frames // PREPARED_FRAMES):
                    connection.sendall(data)


def bare(port: int) -> int:
    """Frames' worth of bytes."""
    buffer = bytearray(RECEIVE_BYTES)
    total = 0
    with socket.create_connection(("127.0.0.1", port)) as connection:
        while size := connection.recv_into(buffer):
            total += size
    return total * PREPARED_FRAMES // len(prepared())


def stream(port: int) -> int:
    """Complete frames with the size that was sent."""
    frames = 0
    with host.open(f"socket://127.0.0.1:{port}", dialect="stock") as robot:
        for frame in robot:
            frames += frame.arrival_host_ns > 0 and frame.width == WIDTH
    return frames


def timed(receive: Callable[[int], int], port: int, frames: int) -> tuple[float, float]:
    """Wall and CPU seconds."""
    wall, cpu = time.perf_counter(), time.process_time()
    received = receive(port)
    result = time.perf_counter() - wall, time.process_time() - cpu
    if received != frames:
        raise SystemExit(f"{receive.__name__}: {received} of {frames} frames")
    return result


def resident_kib() -> int:
    """Peak memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def measure(frames: int, rounds: int, long: int) -> dict[str, float]:
    """Both, in turn, so that a busy machine slows both."""
    frames -= frames % PREPARED_FRAMES
    long -= long % PREPARED_FRAMES
    here, there = multiprocessing.Pipe()
    sender = multiprocessing.Process(target=send, args=(there, [frames, frames] * rounds + [long]), daemon=True)
    sender.start()
    port = here.recv()
    results: dict[str, list[tuple[float, float]]] = {"bare": [], "stream": []}
    for _ in range(rounds):
        results["bare"].append(timed(bare, port, frames))
        results["stream"].append(timed(stream, port, frames))
    before = resident_kib()
    timed(stream, port, long)
    grown = resident_kib() - before
    sender.join()
    best = {name: (min(wall for wall, _ in runs), min(cpu for _, cpu in runs)) for name, runs in results.items()}
    return {
        "frames": frames,
        "bare_us_per_frame": round(best["bare"][0] / frames * 1e6, 2),
        "stream_us_per_frame": round(best["stream"][0] / frames * 1e6, 2),
        "ratio": round(best["bare"][0] / best["stream"][0], 3),
        "bare_cpu_s_per_1000": round(best["bare"][1] / frames * 1e3, 4),
        "stream_cpu_s_per_1000": round(best["stream"][1] / frames * 1e3, 4),
        "long_frames": long,
        "long_growth_kib": grown,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=6000)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--long", type=int, default=10_000)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    figures = measure(arguments.frames, arguments.rounds, arguments.long)
    if arguments.json:
        print(json.dumps(figures))
        return
    line = "{:16} {:.1f} us a frame, {:.3f} CPU s per 1000"
    print(line.format("bare recv_into", figures["bare_us_per_frame"], figures["bare_cpu_s_per_1000"]))
    print(line.format("frame objects", figures["stream_us_per_frame"], figures["stream_cpu_s_per_1000"]))
    print(f"ratio            {figures['ratio']:.2f} of the bound")
    print(f"memory           {figures['long_growth_kib']} KiB more after {figures['long_frames']} frames")
    print(PEERS)


if __name__ == "__main__":
    main()
