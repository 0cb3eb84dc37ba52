"""`host firmware run`: an image in the emulator, in a simulated robot whose other MCUs are native."""

from __future__ import annotations

import argparse
import contextlib
import sys
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Literal

from ..protocol.errors import LocalError
from .interrupt import Interrupt
from .stream import positive

if TYPE_CHECKING:
    from sim.serial.doors import Client, PtyDoor
    from sim.trace import Run
    from sim.world import World

    from ..protocol.dissect.piece import Framing

Form = Literal["explained", "hex", "raw", "json"]
FORMS: tuple[Form, ...] = ("explained", "hex", "raw")

WIRES: dict[str, dict[str, tuple[str, Framing]]] = {
    "stm32": {"uart1": ("uart1_to_gap8", "stamps"), "uart2": ("uart2_to_esp32", "cpx-uart")},
    "gap8": {"spi": ("spi_to_esp32", "spi")},
}
"""What an MCU sends on, its default first: the wire's name in the simulator, and the framing of host dissect."""

STEP_S = 0.02
FIELDS_SHOWN = 200
"""Characters of what a packet says."""
HEX_SHOWN = 64

EXAMPLES = """\
The STM32 sends time messages on UART1 and CPX on UART2. The GAP8 sends over SPI; on its UART it only asks for echoes.
The other MCUs of the robot run natively. Time is the image's own, from its power-up.

examples:
  host firmware run spindeck-firmware/stm32.elf                time messages, explained
  host firmware run spindeck-firmware/stm32.elf --pty          then: host stream --framing stamps --port /dev/pts/N
  host firmware run spindeck-firmware/stm32.elf --wire uart2 --seconds 3 --form hex
  host firmware run spindeck-firmware/gap8.elf --seconds 2 | host dissect - --framing spi --brief
"""


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Declares the command and its options."""
    this = commands.add_parser(
        "run",
        help="boot an image in the emulator and show what it sends",
        description="Boot an image in the emulator, in a simulated robot, and show what it sends: explained on a "
        "terminal, raw bytes when piped. A fault in the image ends it with registers, PC and function (exit code 4).",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = this.add_argument
    add("image", metavar="IMAGE", help="an ELF file of host firmware build, for the stm32 or the gap8")
    add(
        "--wire",
        choices=["uart1", "uart2", "spi"],
        help="which of its wires (default: uart1 of an stm32, spi of a gap8)",
    )
    add("--seconds", type=positive(float), metavar="S", help="end after S simulated seconds (default: with Ctrl-C)")
    add("--pty", action="store_true", help="the wire's bytes on a pseudo-terminal; its path is printed")
    add("--form", choices=FORMS, help="how bytes are shown (default: explained on a terminal, else raw)")
    add(
        "--pace",
        choices=["real", "max"],
        help="by the wall clock (default on a terminal and with --pty), or as fast as it goes",
    )
    add("--json", action="store_true", help="JSON lines: each run of bytes, then a summary")
    this.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Runs until the time is over, or Ctrl-C."""
    from sim import images
    from sim.world import World

    image = images.load(arguments.image)
    wires = WIRES[image.mcu]
    name = arguments.wire or next(iter(wires))
    if name not in wires:
        raise LocalError(f"--wire {name}: the {image.mcu} sends nothing there, but on {' and '.join(wires)}")
    wire, framing = wires[name]
    form: Form = "json" if arguments.json else arguments.form or ("explained" if sys.stdout.isatty() else "raw")
    if arguments.pty and name == "spi":
        raise LocalError("--pty: the GAP8's UART only receives, and SPI is no serial line: leave it out")
    if arguments.pty and arguments.form:
        raise LocalError("--pty: its bytes are raw: leave out --form")
    show = Show(form, framing)
    pace = arguments.pace or ("real" if arguments.pty or sys.stdout.isatty() else "max")
    with contextlib.ExitStack() as open_things:
        world = open_things.enter_context(
            World("hover", trace="full", keep_log=False, images={image.mcu: arguments.image})
        )
        door = open_door(open_things, arguments.json) if arguments.pty else None
        world.robots[0].connect()  # without a host the GAP8 has nobody to send to
        total = Total(name, image.mcu)
        try:
            for runs in turns(world, pace, arguments.seconds):
                own = [each for each in runs if each.wire == wire]
                total.add(own)
                if door is not None:
                    door.give(own)
                    continue
                for each in own:
                    show.run(each)
                sys.stdout.flush()
        finally:
            total.print(world, arguments.json)
    return 0


def turns(world: World, pace: str, seconds: float | None) -> Iterator[list[Run]]:
    """What was sent in each step of simulated time; until Ctrl-C if no end is given."""
    started_s = time.monotonic()
    with Interrupt() as interrupt:
        while not interrupt.asked and (seconds is None or world.seconds < seconds):
            world.run(STEP_S if seconds is None else min(STEP_S, seconds - world.seconds))
            world.robots[0].read()
            yield world.take_trace()
            ahead_s = world.seconds - (time.monotonic() - started_s)
            if pace == "real" and ahead_s > 0:
                time.sleep(ahead_s)


class Show:
    """Prints what was sent."""

    def __init__(self, form: Form, framing: Framing) -> None:
        self.form = form
        self.framing = framing
        self.explainer: Any = None
        if form in ("explained", "json"):
            try:
                from ..protocol import explain
            except ModuleNotFoundError as error:
                if error.name not in ("construct", "crcmod"):
                    raise
                raise LocalError(
                    f"bytes are explained with {error.name}, which is not installed: pip install 'spindeck[spec]', or "
                    "--form hex"
                ) from error
            self.explainer = explain.Explainer(framing)

    def run(self, sent: Run) -> None:
        """One run of bytes."""
        if self.form == "raw":
            sys.stdout.buffer.write(self.filled(sent.data))
            return
        if self.form == "hex":
            shown = sent.data[:HEX_SHOWN].hex(" ") + (" …" if len(sent.data) > HEX_SHOWN else "")
            print(f"{sent.local_ns * 1e-9:13.6f} {len(sent.data):5} {shown}")
            return
        from ..protocol import dissect
        from ..protocol.explain import NAMES
        from .dissect import headline, line, record

        for piece in dissect.split(sent.data, self.framing):
            meaning = self.explainer.explain(piece)
            of = piece.content.route.function if piece.kind == "packet" else None
            what = piece.layout or (piece.kind if of is None else NAMES.get(of, "unknown"))
            if self.form == "json":
                print(
                    line(
                        {**record(piece, what, meaning, sent.data), "local_ns": sent.local_ns, "true_ns": sent.true_ns}
                    )
                )
            elif piece.kind != "idle":
                fields = ", ".join(f"{each.name} {each.words or each.value}" for each in meaning.fields)
                said = f"{headline(piece, what, meaning)}{'; ' * bool(fields)}{fields}"
                print(f"{sent.local_ns * 1e-9:13.6f} {piece.size:5} {said[:FIELDS_SHOWN]}")

    def filled(self, data: bytes) -> bytes:
        """As it goes over the wire: an SPI window is longer than what is in it, and host dissect reads windows."""
        if self.framing != "spi":
            return data
        from ..native import lib

        return data.ljust(lib.cpx_spi_window_bytes(len(data), len(data)), b"\0")


class Total:
    """What has happened, for the end."""

    def __init__(self, wire: str, mcu: str) -> None:
        self.wire = wire
        self.mcu = mcu
        self.runs = 0
        self.bytes = 0

    def add(self, runs: list[Run]) -> None:
        self.runs += len(runs)
        self.bytes += sum(len(each.data) for each in runs)

    def print(self, world: World, as_json: bool) -> None:
        """JSON on stdout, for people on stderr."""
        stack = world.robots[0].stacks[self.mcu]
        if as_json:
            from .dissect import line

            made = {"seconds": round(world.seconds, 6), "mcu": self.mcu, "wire": self.wire, "runs": self.runs}
            print(line({"event": "summary", **made, "bytes": self.bytes, "stack_used_bytes": stack}), flush=True)
            return
        print(
            f"{self.mcu}: {world.seconds:.3f} s simulated; {self.bytes} bytes in {self.runs} runs on {self.wire}; "
            f"{stack} bytes of stack used",
            file=sys.stderr,
        )


class Door:
    """A pseudo-terminal; whoever opens it gets what is sent from then on."""

    def __init__(self, door: PtyDoor) -> None:
        self.door = door
        self.client: Client | None = None

    def give(self, runs: list[Run]) -> None:
        self.client = self.door.accept() or self.client
        if self.client is not None and self.client.receive(4096) == b"":  # what else it writes goes nowhere
            self.client = None
        if self.client is None:
            return
        with contextlib.suppress(OSError):
            self.client.send(memoryview(b"".join(each.data for each in runs)))


def open_door(open_things: contextlib.ExitStack, as_json: bool) -> Door:
    """And says where it is."""
    from sim.serial.doors import PtyDoor

    door = PtyDoor()
    open_things.callback(door.close)
    if as_json:
        from .dissect import line

        print(line({"event": "pty", "port": door.url}), flush=True)
    else:
        print(door.url, flush=True)
    return Door(door)
