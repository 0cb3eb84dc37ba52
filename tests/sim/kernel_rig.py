"""One kernel under test, with a robot's configuration that is perfect but for what a test changes."""

from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from host.native import ffi, lib

MS = 1_000_000
SECOND = 1_000_000_000
WIDTH, HEIGHT = 32, 24
Change = Callable[[Any], None]


def perfect(change: Change | None = None) -> Any:
    """A robot_config_t without drift and without faults; `change` edits it."""
    config = ffi.new("robot_config_t *")
    for mcu in range(lib.MCU_COUNT):
        config.clocks[mcu].divider = 85
    config.stm32.wifi_mode = 1
    config.stm32.wifi_ssid = b"drone"
    config.gap8.width, config.gap8.height = WIDTH, HEIGHT
    config.gap8.line_time_ns = 100_000
    camera = config.gap8.camera
    camera.analog_gain, camera.digital_gain, camera.burst = 1, 64, 1
    camera.exposure_lines, camera.frame_period_us = 100, 50_000
    config.uart1_byte_ps = 86_805_556
    config.uart1_gap8_byte_ps = 86_800_000
    config.uart2_stm32_byte_ps = config.uart2_esp32_byte_ps = 17_361_111
    config.spi_byte_ps = 800_000
    config.spi_gap_ns = 20_000
    config.tcp_byte_ps = 400_000
    config.tcp_window_bytes = 65535
    config.tcp_rto_ns = 250 * MS
    config.network_up_ns = 500 * MS
    config.camera_frame_ns = 20 * MS
    config.host_ring_bytes = 1 << 18
    if change is not None:
        change(config)
    return config


def faults(**values: float) -> Any:
    return ffi.new("wire_faults_t *", values)


@dataclass(frozen=True)
class Run:
    local_start_ns: int
    true_start_ns: int
    byte_ps: int
    robot: int
    wire: int
    data: bytes


class Rig:
    def __init__(self, *configs: Any, seed: int = 1) -> None:
        self.k = lib.kernel_new(seed)
        assert self.k != ffi.NULL
        self.keep: list[Any] = []
        for config in configs or (perfect(),):
            assert lib.kernel_add_robot(self.k, config) >= 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, tb: TracebackType | None) -> None:
        lib.kernel_free(self.k)

    def images(self, count: int = 3, robot: int = 0, jpeg: bytes | None = None) -> list[bytes]:
        pictures = [bytes((i + 7 * p) % 251 for p in range(WIDTH * HEIGHT)) for i in range(count)]
        raw = self.views(pictures)
        jpegs = self.views([jpeg] * count) if jpeg is not None else ffi.NULL
        assert lib.kernel_set_images(self.k, robot, raw, jpegs, count) == 0
        return pictures

    def views(self, bodies: list[bytes]) -> Any:
        views = ffi.new("bytes_t[]", len(bodies))
        for view, body in zip(views, bodies, strict=True):
            memory = ffi.new("uint8_t[]", body)
            self.keep.append(memory)
            view.data, view.size = memory, len(body)
        return views

    def run(self, until_ns: int, robot: int = -1, size: int = 0) -> int:
        result: int = lib.kernel_run(self.k, until_ns, robot, size)
        return result

    def stream(self, until_ns: int, robot: int = 0, step_ns: int = 10 * MS) -> bytes:
        """Runs and reads until then, as a host that keeps up."""
        got = b""
        while (now := lib.kernel_now_ns(self.k)) < until_ns:
            assert self.run(min(now + step_ns, until_ns)) == lib.KERNEL_UNTIL
            got += self.read(robot=robot)
        return got

    def read(self, size: int = 1 << 18, robot: int = 0) -> bytes:
        out = ffi.new("uint8_t[]", size)
        return bytes(ffi.buffer(out, lib.kernel_host_read(self.k, robot, out, size)))

    def write(self, data: bytes, robot: int = 0) -> int:
        taken: int = lib.kernel_host_write(self.k, robot, data, len(data))
        return taken

    def local_ns(self, mcu: int, robot: int = 0) -> int:
        local: int = lib.kernel_local_ns(self.k, robot, mcu)
        return local

    def counts(self, wire: int, robot: int = 0) -> Any:
        return lib.kernel_wire_counts(self.k, robot, wire)

    def hashes(self, robot: int = 0) -> list[int]:
        return [lib.kernel_trace_hash(self.k, robot, wire) for wire in range(lib.WIRE_COUNT)]

    def runs(self) -> list[Run]:
        count, size = ffi.new("size_t *"), ffi.new("size_t *")
        runs = lib.kernel_trace_runs(self.k, count)
        data = lib.kernel_trace_data(self.k, size)
        everything = bytes(ffi.buffer(data, size[0])) if size[0] else b""
        return (
            [
                Run(
                    run.local_start_ns,
                    run.true_start_ns,
                    run.byte_ps,
                    run.robot,
                    run.wire,
                    everything[run.offset : run.offset + run.length],
                )
                for run in ffi.unpack(runs, count[0])
            ]
            if count[0]
            else []
        )

    def truth(self) -> list[Any]:
        out = ffi.new("frame_truth_t[]", 4096)
        count = lib.kernel_read_truth(self.k, out, 4096)
        self.keep.append(out)
        return [out[i] for i in range(count)]

    def pairs(self, robot: int = 0) -> list[tuple[int, int, int]]:
        """(sequence, STM32 us, GAP8 us) of the stamps that the GAP8 has and has not reported; at most its 512."""
        gap8 = lib.kernel_gap8(self.k, robot)
        kept = [gap8.pairs[(gap8.pairs_head + i) % lib.GAP8_PAIRS_MAX] for i in range(gap8.pairs_fill)]
        return [(pair.sequence, pair.stm32_us, pair.gap8_us) for pair in kept]
