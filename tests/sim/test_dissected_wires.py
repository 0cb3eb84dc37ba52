"""Whatever goes over any wire of any simulated robot, dissect knows what it is, to the last byte."""

from collections import Counter
from functools import cache

import pytest

from host.link.dialects import Dialect
from host.native import ffi, lib
from host.protocol.dissect import guess, split
from host.protocol.explain import Explainer
from host.protocol.spec.cpx_link import window_bytes
from sim.world import World

FIRMWARES: dict[str, Dialect] = {
    "hover": "native",
    "stock": "stock",
    "paper": "paper",
    "nanocockpit": "nanocockpit",
}
WIRES = {
    lib.WIRE_UART1: ("stamps", "stamps"),
    lib.WIRE_UART1_TO_STM32: ("stamps", "stamps"),
    lib.WIRE_UART2_TO_ESP32: ("cpx-uart", ""),
    lib.WIRE_UART2_TO_STM32: ("cpx-uart", ""),
    lib.WIRE_SPI_TO_ESP32: ("spi", "nanocockpit-spi"),
    lib.WIRE_SPI_TO_GAP8: ("spi", "nanocockpit-spi"),
    lib.WIRE_TCP_TO_HOST: ("tcp", "nanocockpit"),
    lib.WIRE_TCP_TO_ESP32: ("tcp", "nanocockpit"),
}
"""Of CPX and of NanoCockpit."""


SPI = (lib.WIRE_SPI_TO_ESP32, lib.WIRE_SPI_TO_GAP8)


@cache
def sent(scenario: str) -> dict[int, bytes]:
    """What each sender has sent in 0.8 s, by wire."""
    world = World(scenario, trace="full", camera_width=64, camera_height=48)
    world.listen(dialect=FIRMWARES[scenario])
    world.run(0.8)
    count, size = ffi.new("size_t *"), ffi.new("size_t *")
    runs = ffi.unpack(lib.kernel_trace_runs(world.kernel, count), count[0])
    data = bytes(ffi.buffer(lib.kernel_trace_data(world.kernel, size), size[0]))
    windows: dict[int, int] = {}
    for run in runs:
        if run.wire in SPI:  # of both lines, at the same time: the longer side decides
            windows[run.true_start_ns] = max(windows.get(run.true_start_ns, 0), run.length)
    wires: dict[int, bytes] = {}
    for run in runs:
        # The kernel notes what a side has to say: a line carries as many bytes as the window has.
        size = run.length if run.wire not in SPI else window_bytes(*[windows[run.true_start_ns]] * 2)
        told = data[run.offset : run.offset + run.length]
        wires[run.wire] = wires.get(run.wire, b"") + told.ljust(size, b"\0")
    return wires


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize("scenario", FIRMWARES)
def test_every_wire_is_recognised_and_has_no_garbage(scenario: str, wire: int) -> None:
    data = sent(scenario).get(wire, b"")
    expected = WIRES[wire][scenario == "nanocockpit"]
    silent = {
        *[(other, lib.WIRE_UART1_TO_STM32) for other in ("stock", "paper", "nanocockpit")],
        ("stock", lib.WIRE_UART1),  # which stock firmware does not use
        ("stock", lib.WIRE_TCP_TO_ESP32),
        ("paper", lib.WIRE_TCP_TO_ESP32),
        ("nanocockpit", lib.WIRE_UART2_TO_STM32),  # its ESP32 does not know the STM32
    }
    assert (data == b"") == ((scenario, wire) in silent)
    if not data or not expected:
        return
    framing, part = guess(data)
    assert part > 0.9
    if wire == lib.WIRE_SPI_TO_ESP32 and scenario == "nanocockpit":
        # It sends fours, in long windows: without an idle one between them, that is what TCP carries too.
        assert framing in ("nanocockpit", "nanocockpit-spi")
        framing = "nanocockpit-spi"
    assert framing == expected
    pieces = list(split(data, framing))
    assert sum(piece.size for piece in pieces) == len(data)
    kinds = Counter(piece.kind for piece in pieces)
    assert kinds["garbage"] == 0
    assert kinds["truncated"] <= 1
    explainer = Explainer(framing)
    abouts = [explainer.explain(piece).about for piece in pieces]
    unclear = [about for about in abouts if "not known" in about or "unreadable" in about or "no receiver" in about]
    assert unclear == []


def test_what_goes_over_them_has_its_name() -> None:
    names = {
        ("paper", lib.WIRE_UART1): "time message of the paper's firmware",
        ("nanocockpit", lib.WIRE_UART1): "NanoCockpit's state",
        ("hover", lib.WIRE_UART1): "stamp message",
        ("hover", lib.WIRE_UART1_TO_STM32): "question for an echo",
        ("paper", lib.WIRE_TCP_TO_HOST): "image header of the paper's firmware",
        ("hover", lib.WIRE_TCP_TO_HOST): "native frame",
        ("nanocockpit", lib.WIRE_TCP_TO_HOST): "image, bytes 0..3219 of 3220, the last ones; no check was sent",
        ("nanocockpit", lib.WIRE_SPI_TO_ESP32): "image, bytes 0..3219 of 3220, the last ones; no check was sent",
        (
            "nanocockpit",
            lib.WIRE_TCP_TO_ESP32,
        ): "answer to a frame, bytes 0..24 of 25, the last ones; the check is right",
    }
    for (scenario, wire), name in names.items():
        data = sent(scenario)[wire]
        framing, _ = guess(data)
        explainer = Explainer(framing)
        assert name in [explainer.explain(piece).about for piece in split(data, framing)], (scenario, wire)
