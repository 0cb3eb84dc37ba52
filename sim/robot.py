"""One simulated robot: its host's end of the wire, its counters, and what can go wrong with it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from host.native import ffi, lib
from host.protocol.codec import encode_cpx_uart
from host.protocol.errors import LocalError
from host.protocol.packets import CpxPacket, Route

from . import configure, counters, emulated, scenario
from .images import Image
from .settings import RobotSettings, Scalar, Wire
from .storage import Storage, Store

if TYPE_CHECKING:
    from .card import Card
    from .world import World

NS = 1_000_000_000
MCUS = {"stm32": lib.MCU_STM32, "gap8": lib.MCU_GAP8, "esp32": lib.MCU_ESP32}
FAULTS = {field.name for field in dataclasses.fields(Wire)} | {"duplicate", "reorder"}
SHUTDOWN = encode_cpx_uart(CpxPacket(Route(lib.CPX_STM32, lib.CPX_HOST, lib.CPX_SYSTEM), bytes([lib.SYSTEM_SHUTDOWN])))
LANDING_NS = 3 * NS
DURATION_S_MAX = 3600
INJECT_BYTES_MAX = 65536


class Robot:
    """Of a World; `world.robots` holds them."""

    def __init__(self, world: World, index: int, settings: RobotSettings, images: Mapping[str, Image]) -> None:
        self.world = world
        self.index = index
        self.settings = settings
        self.images = images
        """Of the MCUs that are emulated, by name."""
        self._wires: dict[int, Wire] = {}
        """Those that set_faults has changed."""
        self.card: Card | None = None
        """Of `usd_config`."""
        self._image: Path | None = None

    # The host's end of the wire.

    def connect(self) -> None:
        """On TCP: as soon as the robot's network is up. On a UART the host is always there."""
        with self.world.lock:
            lib.kernel_host_connect(self.world.kernel, self.index)
            self.world.did("connect", robot=self.index)

    def disconnect(self) -> None:
        with self.world.lock:
            lib.kernel_host_disconnect(self.world.kernel, self.index)
            self.world.did("disconnect", robot=self.index)

    @property
    def connected(self) -> bool:
        with self.world.lock:
            return bool(lib.kernel_host_connected(self.world.kernel, self.index))

    @property
    def available(self) -> int:
        """Bytes that can be read now."""
        with self.world.lock:
            return int(lib.kernel_host_available(self.world.kernel, self.index))

    def read(self, size: int | None = None) -> bytes:
        """At most `size` of the bytes that are there now. No time passes."""
        with self.world.lock:
            available = self.available
            out = bytearray(available if size is None else min(size, available))
            if not out:
                return b""
            count = lib.kernel_host_read(self.world.kernel, self.index, ffi.from_buffer("uint8_t[]", out), len(out))
            self.world.did_read(self.index, available, count)
            return bytes(out[:count])

    def write(self, data: bytes) -> int:
        """Returns how many bytes were taken: all, unless far more are waiting for the wire than a robot should get."""
        with self.world.lock:
            count = int(lib.kernel_host_write(self.world.kernel, self.index, data, len(data)))
            if count:
                self.world.did_write(self.index, bytes(data[:count]))
            return count

    # Its card.

    def put_card(self, seed: int, robots: int) -> None:
        """As `settings.usd` describes it."""
        from . import cards  # Not everybody has fatfs-ng.

        self._image = cards.image_path(self.settings.usd, self.index, robots)
        self.card = cards.card_of(self.settings.usd, seed)
        self.set_storage(self.card)

    def shut_down(self) -> None:
        """Tells the STM32 that its power goes soon: it closes its log, which takes a while."""
        self.inject("uart2_to_stm32", SHUTDOWN)

    def land(self) -> None:
        """Closes the log and writes the image of the card, if it is to be kept. Once."""
        if self._image is None or self.card is None:
            return
        try:
            self.shut_down()
            end_ns = self.world.now_ns + LANDING_NS
            while self.log["status"] in ("starts", "on", "closes") and self.world.now_ns < end_ns:
                self.world.run_until(self.world.now_ns + NS // 100)
        finally:  # An image that has failed runs no more: then the log stays open, as after a power cut.
            self.card.cut(self.world.now_ns)
            self.card.save(str(self._image))
            self._image = None

    def set_storage(self, store: Store) -> None:
        """The STM32 has this for a card, from now on; best before it boots, as that is when it looks for one."""
        with self.world.lock:
            storage = Storage(store)
            if lib.kernel_set_storage(self.world.kernel, self.index, lib.storage_request, storage.handle) < 0:
                raise LocalError(f"robot {self.index} is using its card now: put another in before the STM32 boots")
            self.world.storages.append(storage)

    # What its parts have counted.

    @property
    def backends(self) -> dict[str, str]:
        """By MCU: "emulated" of one that runs an image, else "native"."""
        return {mcu: "emulated" if mcu in self.images else "native" for mcu in MCUS}

    @property
    def stm32(self) -> dict[str, int]:
        """Counters since the STM32's last boot, by their names in firmware/stm32/app.h."""
        return self._app("stm32", lib.kernel_stm32, counters.APPS["stm32"])

    @property
    def log(self) -> dict[str, int | str]:
        """Of the log on the STM32's card: its status (a LogState), files since boot, errors and warnings of
        config.txt, and the counters of the present file, or of the last."""
        counts = self._app("stm32", lib.kernel_stm32, list(counters.LOG.values()))
        named: dict[str, int | str] = {name: counts[of.replace(".", "_")] for name, of in counters.LOG.items()}
        return {**named, "status": counters.LOG_STATES[int(named["status"])]}

    @property
    def gap8(self) -> dict[str, int]:
        """Likewise, firmware/gap8/app.h."""
        return self._app("gap8", lib.kernel_gap8, counters.APPS["gap8"])

    @property
    def esp32(self) -> dict[str, int]:
        """Likewise, firmware/esp32/app.h."""
        return self._app("esp32", lib.kernel_esp32, counters.APPS["esp32"])

    def _app(self, mcu: str, native: Callable[[Any, int], Any], names: list[str]) -> dict[str, int]:
        with self.world.lock:
            if mcu in self.images:
                counts = emulated.counters(self.world.kernel, self.index, mcu, self.images[mcu], names)
                return {name.replace(".", "_"): count for name, count in counts.items()}
            return counters.read(native(self.world.kernel, self.index), names)

    @property
    def stacks(self) -> dict[str, int]:
        """Of each emulated MCU: how many bytes of its stack have been used since its last boot."""
        with self.world.lock:
            return {
                mcu: emulated.stack_used(self.world.kernel, self.index, mcu, image)
                for mcu, image in self.images.items()
            }

    @property
    def wires(self) -> dict[str, dict[str, int]]:
        """What each direction of each wire has carried, and what its faults did to it (wire_counts_t)."""
        with self.world.lock:
            return {
                name: counters.read(lib.kernel_wire_counts(self.world.kernel, self.index, wires[0]), counters.WIRE)
                for name, wires in configure.WIRES.items()
                if len(wires) == 1
            }

    def stamp_us(self, mcu: str) -> int:
        """Reading of that MCU's stamp clock now."""
        with self.world.lock:
            return int(lib.kernel_stamp_us(self.world.kernel, self.index, _mcu(mcu)))

    # What goes wrong, from now on or at once. Each is logged.

    def set_faults(self, wire: str, **faults: Scalar) -> None:
        """Sets some faults of a wire by their scenario keys, `set_faults("uart1", loss=0.5)`; the rest stay.

        The name of a link ("tcp") means both directions, "tcp_to_host" one.
        """
        wires = _wires(wire)
        link = wire.partition("_to_")[0]
        values: dict[str, Any] = {}
        for key, value in faults.items():
            setting = scenario.find(f"{link}_{key}")
            if setting.field not in FAULTS:
                raise LocalError(f"{setting.name} is no fault: it is set before the world starts")
            values[key] = scenario.checked(setting, value)
        with self.world.lock:
            for each in wires:
                self._wires[each] = dataclasses.replace(self._wires.get(each, getattr(self.settings, link)), **values)
                config = ffi.new("wire_faults_t *", configure.faults(self._wires[each]))
                lib.kernel_set_faults(self.world.kernel, self.index, each, config)
            self.world.did("set_faults", robot=self.index, wire=wire, **values)

    def set_camera_faults(self, fail: float = 0.0, hang: float = 0.0) -> None:
        """Probabilities that a capture fails, or never ends."""
        for key, value in (("camera_fail", fail), ("camera_hang", hang)):
            scenario.checked(scenario.find(key), value)
        with self.world.lock:
            lib.kernel_set_camera_faults(self.world.kernel, self.index, fail, hang)
            self.world.did("set_camera_faults", robot=self.index, fail=fail, hang=hang)

    def stall(self, wire: str, seconds: float) -> None:
        """The wire stands still for so long; nothing on it is lost."""
        wires = _wires(wire)
        duration_ns = _duration_ns(seconds)
        with self.world.lock:
            for each in wires:
                lib.kernel_stall(self.world.kernel, self.index, each, duration_ns)
            self.world.did("stall", robot=self.index, wire=wire, seconds=seconds)

    def inject(self, wire: str, data: bytes) -> None:
        """Gives the receiver bytes that nobody has sent, now. On a link ("tcp"): in the direction of the host."""
        (each, *_) = _wires(wire)
        if len(data) > INJECT_BYTES_MAX:
            raise LocalError(f"inject: {len(data)} bytes, at most {INJECT_BYTES_MAX} at once")
        with self.world.lock:
            lib.kernel_inject(self.world.kernel, self.index, each, data, len(data))
            self.world.did("inject", robot=self.index, wire=wire, hex=data.hex())

    def radio(self, data: bytes) -> None:
        """A CRTP packet that was broadcast comes in by the STM32's radio, now."""
        with self.world.lock:
            if lib.kernel_radio(self.world.kernel, self.index, data, len(data)) < 0:
                raise LocalError(f"robot {self.index} runs an image, which has no radio: backend=native")
            self.world.did("radio", robot=self.index, hex=data.hex())

    def set_rate(self, mcu: str, ppm: float) -> None:
        """The MCU's oscillator runs at this rate error from now on."""
        which = _mcu(mcu)
        scenario.checked(scenario.find(f"{mcu}_ppm"), ppm)
        with self.world.lock:
            lib.kernel_set_rate(self.world.kernel, self.index, which, configure.rate_ppb(ppm))
            self.world.did("set_rate", robot=self.index, mcu=mcu, ppm=ppm)

    def reset_stamp_clock(self, mcu: str, to_us: int = 0) -> None:
        """As `usec.reset` does on the STM32. Deadlines are not touched: they use the uptime."""
        which = _mcu(mcu)
        scenario.checked(scenario.find(f"{mcu}_stamp_start_us"), to_us)
        with self.world.lock:
            lib.kernel_reset_stamp_clock(self.world.kernel, self.index, which, to_us)
            self.world.did("reset_stamp_clock", robot=self.index, mcu=mcu, to_us=to_us)

    def reboot(self, mcu: str, off_seconds: float = 0.0) -> None:
        """Off at once, for so long, and then from its start."""
        which = _mcu(mcu)
        off_ns = _duration_ns(off_seconds)
        with self.world.lock:
            lib.kernel_reboot(self.world.kernel, self.index, which, off_ns)
            self.world.did("reboot", robot=self.index, mcu=mcu, off_seconds=off_seconds)

    def repeat(self, do: str, arguments: dict[str, Any]) -> None:
        """Does again what a log says was done."""
        if do not in DONE:
            raise LocalError(f"this log says {do!r} was done, which is nothing that can be done to a robot")
        if "hex" in arguments:
            arguments = {**arguments, "data": bytes.fromhex(arguments["hex"])}
            del arguments["hex"]
        getattr(self, do)(**arguments)


DONE = {
    *["connect", "disconnect", "write", "set_faults", "set_camera_faults"],
    *["stall", "inject", "radio", "set_rate", "reset_stamp_clock", "reboot"],
}
"""Methods that a log may name."""


def _mcu(name: str) -> int:
    if name not in MCUS:
        raise LocalError(f"no MCU {name!r}{scenario.near(name, list(MCUS))}; there are {', '.join(MCUS)}")
    return int(MCUS[name])


def _wires(name: str) -> tuple[int, ...]:
    if name not in configure.WIRES:
        known = list(configure.WIRES)
        raise LocalError(f"no wire {name!r}{scenario.near(name, known)}; there are {', '.join(known)}")
    return configure.WIRES[name]


def _duration_ns(seconds: float) -> int:
    if not 0 <= seconds <= DURATION_S_MAX:
        raise LocalError(f"seconds={seconds}: allowed is 0 .. {DURATION_S_MAX}")
    return round(seconds * NS)
