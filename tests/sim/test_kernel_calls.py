"""A recording of a node's calls changes nothing, and is enough to run the app alone."""

from typing import Any

import pytest
from kernel_rig import MS, Rig, perfect

from host.native import ffi, lib

MCUS = {lib.MCU_STM32: "stm32", lib.MCU_GAP8: "gap8", lib.MCU_ESP32: "esp32"}


def troubled(config: Any) -> None:
    config.wires[lib.WIRE_UART1].loss = config.wires[lib.WIRE_UART2_TO_STM32].flip = 0.01
    config.wires[lib.WIRE_SPI_TO_GAP8].duplicate = 0.1


def run(rig: Rig) -> None:
    lib.kernel_trace(rig.k, lib.TRACE_HASH)
    rig.images()
    lib.kernel_host_connect(rig.k, 0)
    rig.stream(800 * MS)
    lib.kernel_reset_stamp_clock(rig.k, 0, lib.MCU_STM32, 7)
    lib.kernel_reboot(rig.k, 0, lib.MCU_GAP8, 50 * MS)
    rig.stream(1200 * MS)


def calls_of(rig: Rig, mcu: int) -> tuple[list[Any], bytes]:
    count, size = ffi.new("size_t *"), ffi.new("size_t *")
    calls = lib.kernel_calls(rig.k, 0, mcu, count)
    data = lib.kernel_calls_data(rig.k, 0, mcu, size)
    return ffi.unpack(calls, count[0]) if count[0] else [], bytes(ffi.buffer(data, size[0])) if size[0] else b""


def replay(name: str, calls: list[Any], data: bytes) -> None:
    """Makes the calls of a new app of its own and compares what they give."""
    init, receive, transmit, deadline = (
        getattr(lib, f"{name}_{verb}") for verb in ("init", "receive", "transmit", "deadline")
    )
    app, config = ffi.new(f"{name}_t *"), ffi.new(f"{name}_config_t *")
    kept = []
    for call in calls:
        given = data[call.offset : call.offset + call.length]
        if call.verb == lib.CALL_INIT:
            ffi.buffer(config)[:] = given
            assert init(app, config, call.now) == ffi.cast("int64_t", call.result)
        elif call.verb == lib.CALL_RECEIVE:
            kept.append(ffi.new("uint8_t[]", given))  # a camera's body is looked at again later
            assert receive(app, call.port, (kept[-1], call.length), call.now) == ffi.cast("int64_t", call.result)
        elif call.verb == lib.CALL_TRANSMIT:
            out = ffi.new("uint8_t[]", call.room)
            assert transmit(app, call.port, (out, call.room), call.now) == call.result == call.length
            assert ffi.buffer(out)[: call.length] == given
        else:
            assert deadline(app) == call.result


@pytest.mark.parametrize("mcu", MCUS)
def test_the_app_alone_gives_the_same(mcu: int) -> None:
    with Rig(perfect(troubled)) as rig:
        assert lib.kernel_record_calls(rig.k, 0, mcu) == 0
        run(rig)
        hashes = rig.hashes()
        calls, data = calls_of(rig, mcu)
        replay(MCUS[mcu], calls, data)
        assert {call.verb for call in calls} == {lib.CALL_INIT, lib.CALL_RECEIVE, lib.CALL_TRANSMIT, lib.CALL_DEADLINE}
        assert calls[0].verb == lib.CALL_INIT
        assert sum(call.verb == lib.CALL_INIT for call in calls) == 1 + (mcu == lib.MCU_GAP8)
    with Rig(perfect(troubled)) as rig:
        run(rig)
        assert rig.hashes() == hashes


def test_refusals_and_what_is_not_recorded() -> None:
    with Rig() as rig:
        assert lib.kernel_record_calls(rig.k, 1, 0) == lib.KERNEL_ERR_CONFIG
        assert lib.kernel_record_calls(rig.k, 0, 3) == lib.KERNEL_ERR_CONFIG
        assert calls_of(rig, 0) == ([], b"")
        assert lib.kernel_record_calls(rig.k, 0, 0) == 0
        assert lib.kernel_record_calls(rig.k, 0, 0) == lib.KERNEL_ERR_CONFIG
        rig.run(100 * MS)
        assert calls_of(rig, 0)[0]
        assert calls_of(rig, 1) == calls_of(rig, 3) == ([], b"")
