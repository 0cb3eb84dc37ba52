"""The host's end: TCP with its window, its losses and its order, and the two UARTs."""

from typing import Any

from kernel_rig import MS, SECOND, Rig, perfect

from host.native import lib

ECHO = bytes([5, 0, 0x1C, 0x0E, 1, 0xAA, 0x55])  # host -> GAP8, TEST, echo these two bytes


def connected(config: Any = None, at_ns: int = SECOND, images: bool = True, seed: int = 1) -> Rig:
    rig = Rig(config or perfect(), seed=seed)
    if images:
        rig.images()
    lib.kernel_host_connect(rig.k, 0)
    rig.run(at_ns)
    return rig


def sent_to_host(rig: Rig) -> bytes:
    return b"".join(run.data for run in rig.runs() if run.wire == lib.WIRE_TCP_TO_HOST)


def test_connect_waits_for_the_network() -> None:
    with Rig() as rig:
        rig.images()
        lib.kernel_host_connect(rig.k, 0)
        rig.run(400 * MS)
        assert not lib.kernel_host_connected(rig.k, 0)
        rig.run(SECOND)
        assert lib.kernel_host_connected(rig.k, 0)
        rig.run(2 * SECOND)
        assert lib.kernel_host_available(rig.k, 0) > 10 * 32 * 24


def test_run_stops_as_soon_as_the_host_can_read() -> None:
    with connected() as rig:
        assert rig.run(100 * SECOND, 0, 1000) == lib.KERNEL_BYTES
        now = lib.kernel_now_ns(rig.k)
        assert now < 2 * SECOND
        assert lib.kernel_host_available(rig.k, 0) >= 1000
        assert rig.run(100 * SECOND, 0, 1000) == lib.KERNEL_BYTES  # still there
        assert lib.kernel_now_ns(rig.k) == now


def test_loss_jitter_and_stalls_change_no_byte() -> None:
    def change(config: Any) -> None:
        wire = config.wires[lib.WIRE_TCP_TO_HOST]
        wire.latency_ns, wire.jitter_ns, wire.loss = 5 * MS, 3 * MS, 0.05
        wire.stall_per_s, wire.stall_ns = 1, 50 * MS

    with Rig(perfect(change)) as rig:
        lib.kernel_trace(rig.k, lib.TRACE_FULL)
        rig.images()
        lib.kernel_host_connect(rig.k, 0)
        got = rig.stream(10 * SECOND)
        counts = rig.counts(lib.WIRE_TCP_TO_HOST)
        assert counts.lost > 3
        assert counts.stalls > 3
        assert len(got) > 50_000
        assert sent_to_host(rig).startswith(got)
        assert len(sent_to_host(rig)) - len(got) <= 65535


def test_damage_of_tcp_is_counted_and_the_length_is_right() -> None:
    def change(config: Any) -> None:
        wire = config.wires[lib.WIRE_TCP_TO_HOST]
        wire.drop, wire.flip = 0.001, 0.001

    with Rig(perfect(change)) as rig:
        lib.kernel_trace(rig.k, lib.TRACE_FULL)
        rig.images()
        lib.kernel_host_connect(rig.k, 0)
        got = rig.stream(5 * SECOND)
        rig.run(5 * SECOND + 40 * MS)
        counts = rig.counts(lib.WIRE_TCP_TO_HOST)
        assert counts.dropped > 20
        assert counts.flipped > 20
        assert abs(counts.bytes - counts.dropped - len(got)) <= 4096


def test_host_that_does_not_read_closes_the_window_and_loses_nothing() -> None:
    def change(config: Any) -> None:
        config.host_ring_bytes = 10_000

    with Rig(perfect(change)) as rig:
        lib.kernel_trace(rig.k, lib.TRACE_FULL)
        rig.images()
        lib.kernel_host_connect(rig.k, 0)
        rig.run(5 * SECOND)
        waiting = lib.kernel_host_available(rig.k, 0)
        assert 10_000 - 1440 < waiting <= 10_000
        rig.run(20 * SECOND)
        assert lib.kernel_host_available(rig.k, 0) == waiting
        assert lib.kernel_esp32(rig.k, 0).frames_dropped > 0  # whole frames, so that the stream stays readable
        got = rig.read(1)
        rig.run(21 * SECOND)
        assert lib.kernel_host_available(rig.k, 0) == waiting - 1  # a sliver is not worth a segment
        got += rig.stream(23 * SECOND, step_ns=MS)
        assert len(got) > waiting + 10_000
        assert sent_to_host(rig).startswith(got)
        assert rig.counts(lib.WIRE_TCP_TO_HOST).overflowed == 0


def test_disconnect_tells_the_robot_and_keeps_what_had_arrived() -> None:
    def change(config: Any) -> None:
        config.wires[lib.WIRE_TCP_TO_HOST].latency_ns = 20 * MS

    with connected(perfect(change), at_ns=3 * SECOND) as rig:
        arrived = lib.kernel_host_available(rig.k, 0)
        assert arrived > 0
        lib.kernel_host_disconnect(rig.k, 0)
        rig.run(4 * SECOND)
        assert not lib.kernel_host_connected(rig.k, 0)
        assert lib.kernel_host_available(rig.k, 0) == arrived
        assert not lib.kernel_esp32(rig.k, 0).client
        assert not lib.kernel_gap8(rig.k, 0).client
        assert rig.write(b"x") == 0
        lib.kernel_host_connect(rig.k, 0)
        rig.run(5 * SECOND)
        assert lib.kernel_host_available(rig.k, 0) > arrived


def test_host_bytes_get_through_whatever_the_link_does() -> None:
    def change(config: Any) -> None:
        wire = config.wires[lib.WIRE_TCP_TO_ESP32]
        wire.latency_ns, wire.jitter_ns, wire.loss = 5 * MS, 2 * MS, 0.05
        config.tcp_byte_ps = 4_000_000

    with connected(perfect(change), images=False) as rig:
        replies = b""
        for number in range(300):
            message = ECHO[:-1] + bytes([number % 256])
            for part in (message[:3], message[3:]):
                assert rig.write(part) == len(part)
            replies += rig.stream(lib.kernel_now_ns(rig.k) + 50 * MS)
        replies += rig.stream(lib.kernel_now_ns(rig.k) + 2 * SECOND)
        assert rig.counts(lib.WIRE_TCP_TO_ESP32).lost > 3
        echoed = [
            replies[i + 6]
            for i in range(len(replies) - 6)
            if replies[i : i + 2] == b"\x05\0" and replies[i + 5] == 0xAA
        ]
        assert echoed == [number % 256 for number in range(300)]


def test_host_writes_are_bounded() -> None:
    with connected(images=False) as rig:
        assert rig.write(bytes(200_000)) == 65536
        assert rig.write(bytes(200_000)) == 1440  # what the first segment left free
        assert rig.write(b"x") == 0
        rig.run(2 * SECOND)
        assert rig.write(b"x") == 1


def test_esp32_reboot_ends_the_connection() -> None:
    with connected() as rig:
        lib.kernel_reboot(rig.k, 0, lib.MCU_ESP32, 10 * MS)
        assert not lib.kernel_host_connected(rig.k, 0)
        arrived = lib.kernel_host_available(rig.k, 0)
        rig.run(10 * SECOND)
        assert not lib.kernel_host_connected(rig.k, 0)
        assert lib.kernel_host_available(rig.k, 0) == arrived
        lib.kernel_host_connect(rig.k, 0)
        lib.kernel_reboot(rig.k, 0, lib.MCU_STM32, 10 * MS)  # which sets the network up again
        rig.run(20 * SECOND)
        assert lib.kernel_host_connected(rig.k, 0)
        assert lib.kernel_host_available(rig.k, 0) > arrived


def on_uart(wire: int) -> Any:
    def change(config: Any) -> None:
        config.host_wire = wire
        config.esp32.host_on_uart = wire == lib.HOST_UART2
        config.host_ring_bytes = 5000

    return perfect(change)


def test_uart1_tap_hears_what_the_gap8_hears() -> None:
    with Rig(on_uart(lib.HOST_UART1)) as rig:
        lib.kernel_trace(rig.k, lib.TRACE_FULL)
        rig.run(SECOND - 5 * MS)
        heard = rig.read()
        assert heard == b"".join(run.data for run in rig.runs() if run.wire == lib.WIRE_UART1)
        assert len(heard) == 1700
        assert lib.kernel_gap8(rig.k, 0).stamp_rx.received == 100
        assert rig.write(b"nowhere") == 7
        rig.run(10 * SECOND - 5 * MS)
        assert lib.kernel_host_available(rig.k, 0) == 5000
        assert rig.counts(lib.WIRE_UART1).overflowed == 900 * 17 - 5000


def test_host_on_uart2_takes_its_byte_times() -> None:
    with Rig(on_uart(lib.HOST_UART2)) as rig:
        lib.kernel_trace(rig.k, lib.TRACE_FULL)
        rig.run(SECOND)
        assert rig.read()[:2] == b"\xff\x00"  # the ESP32 offers its credit
        assert rig.write(b"\xff\x00" * 3) == 6
        rig.run(SECOND + 6 * 17_361 - 10)
        assert rig.counts(lib.WIRE_UART2_TO_ESP32).bytes == 5
        rig.run(SECOND + 6 * 17_361 + 10)
        assert rig.counts(lib.WIRE_UART2_TO_ESP32).bytes == 6
        assert lib.kernel_esp32(rig.k, 0).uart2.credits_in == 3
        assert lib.kernel_stm32(rig.k, 0).uart2.credits_in == 0  # its own UART2 is connected to nothing
        run = next(run for run in rig.runs() if run.wire == lib.WIRE_UART2_TO_ESP32)
        assert (run.true_start_ns, run.data) == (SECOND, b"\xff\x00" * 3)
