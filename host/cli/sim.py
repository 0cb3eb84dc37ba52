"""`host sim serve`: simulated robots for clients that know nothing of the simulator."""

from __future__ import annotations

import argparse
import contextlib
import ipaddress
import json
import signal
import sys
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, urlencode

from ..protocol.errors import LocalError
from ..protocol.typed import integer
from . import sim_example

if TYPE_CHECKING:
    from sim.scenario import Scenario
    from sim.serial.doors import Door
    from sim.serial.serve import Happening, Server

LISTEN = "127.0.0.1:5000"

EXAMPLES = """\
examples:
  host sim serve                                       then: host stream --port socket://127.0.0.1:5000
  host sim serve --scenario swarm                      four robots, on ports 5000 to 5003
  host sim serve --dialect stock                       for viewers and libraries made for the stock firmware
  host sim serve --pty                                 then: host stream --port /dev/pts/N
  host sim serve --scenario lossy --seed 7 tcp_loss=0.01 camera_fps=15

True time begins with the first client. A second client of the same robot is sent away at once. Ctrl-C ends.
"""


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Declares the command and its options."""
    this = commands.add_parser("sim", help="the simulator: serve its robots to any client; make examples")
    below = this.add_subparsers(dest="sim_command", metavar="COMMAND", title="commands", required=True)
    serve = below.add_parser(
        "serve",
        help="simulated robots as TCP servers, as the ESP32 is one, or as serial ports",
        description="Serve simulated robots: on TCP as the AI-deck's ESP32 does, or as serial ports.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = serve.add_argument
    where = serve.add_mutually_exclusive_group()
    where.add_argument(
        "--listen",
        default=LISTEN,
        metavar="ADDRESS:PORT",
        help=f"the first robot's; the others' ports follow (default {LISTEN}: heard on this computer alone; "
        "0.0.0.0:5000: by the whole network; port 0: any that are free)",
    )
    where.add_argument("--pty", action="store_true", help="a pseudo-terminal with UART2's bytes (wire=uart1: stamps)")
    add("--scenario", default="hover", metavar="NAME", help="hover (default), swarm, lossy, …, or a TOML file")
    add("--dialect", metavar="NAME", help="the robots' firmware: native, stock, … (key `firmware` of the scenario)")
    add("--camera", metavar="PATH", help="what the cameras see: a PGM, PPM or PNG file, or a folder of them")
    add("--seed", type=integer, metavar="N", help="of everything random")
    add("--pace", choices=["real", "max"], help="real: by the wall clock (default); max: as fast as clients read")
    add("--announce", action="store_true", help="by mDNS, as AI-decks do (with --listen)")
    add("--log", metavar="FILE", help="keep what clients sent, and when: sim.world.World.replay repeats the run")
    add("--json", action="store_true", help="JSON lines on stdout")
    add("settings", nargs="*", metavar="KEY=VALUE", help="keys of docs/SCENARIOS.md")
    serve.set_defaults(run=run)
    sim_example.add_parser(below)


def run(arguments: argparse.Namespace) -> int:
    """Serves until Ctrl-C."""
    from sim.serial import registry
    from sim.serial.serve import Server

    from .new_file import new_file

    made = scenario(arguments)
    output = JsonOutput() if arguments.json else Output()
    with contextlib.ExitStack() as open_things:
        doors = open_doors(arguments, len(made.robots), open_things)
        server = Server(made, doors, keep_log=arguments.log is not None, report=output.happened)
        open_things.callback(server.close)
        # Complete before the server closes: that may fail too.
        log = open_things.enter_context(new_file(arguments.log)) if arguments.log else None
        robots = [
            {
                "port": station.door.url,
                "wire": station.robot.settings.wire,
                "firmware": station.robot.settings.firmware,
                "backends": station.robot.backends,
            }
            for station in server.stations
        ]
        # Ended by the system is ended by Ctrl-C.
        before = signal.signal(signal.SIGTERM, signal.default_int_handler)
        open_things.callback(signal.signal, signal.SIGTERM, before)
        try:
            with registry.entered(made.name, robots), announcement(arguments, made.name, doors):
                output.heard_by_all(doors)
                output.serving(made, robots)
                server.run()
        except KeyboardInterrupt:
            output.summary(server)
            if log is not None:
                log.write(json.dumps(server.world.log).encode())
    return 0


def scenario(arguments: argparse.Namespace) -> Scenario:
    """What the options describe together. Each key may be given once, as an option or as KEY=VALUE."""
    from sim import scenario

    pairs = []
    for setting in arguments.settings:
        key, equals, value = setting.partition("=")
        if not equals:
            raise LocalError(f"{setting}: write KEY=VALUE, such as gap8_ppm=80; docs/SCENARIOS.md lists the keys")
        pairs.append((key, value))
    options = {"firmware": arguments.dialect, "camera": arguments.camera, "seed": arguments.seed}
    options["pace"] = arguments.pace
    pairs += [(key, str(value)) for key, value in options.items() if value is not None]
    given = {key for key, _ in pairs}
    if "robot" in given:
        raise LocalError("robot=…: every robot of the scenario is served; robots=… says how many")
    if arguments.pty and "wire" not in given:
        pairs.append(("wire", "uart2"))
    made = scenario.from_url(f"sim://{quote(arguments.scenario, safe='/')}?{urlencode(pairs)}".rstrip("?"))
    if arguments.pty and any(robot.wire == "tcp" for robot in made.robots):
        raise LocalError("--pty: a serial port carries wire=uart2 or wire=uart1, not TCP: use --listen for that")
    if made.pace == "max" and any(robot.wire == "uart2" for robot in made.robots):
        raise LocalError("pace=max: on UART2 each packet waits for the client's credit, in real time: leave it out")
    return made


def open_doors(arguments: argparse.Namespace, count: int, open_things: contextlib.ExitStack) -> list[Door]:
    """One for each robot, closed again when one of them cannot be opened."""
    from sim.serial import doors

    opened: list[Door] = []
    if arguments.announce and arguments.pty:
        raise LocalError("--announce: only what listens on TCP can be announced: leave out --pty")
    host, port = ("", 0) if arguments.pty else doors.address(arguments.listen)
    for number in range(count):
        opened.append(doors.PtyDoor() if arguments.pty else doors.TcpDoor(host, port + number if port else 0))
        open_things.callback(opened[-1].close)
    return opened


def announcement(arguments: argparse.Namespace, name: str, doors: list[Any]) -> contextlib.AbstractContextManager[None]:
    if not arguments.announce:
        return contextlib.nullcontext()
    from sim.serial.announce import announced

    return announced(name, doors)


def figures(server: Server) -> dict[str, Any]:
    """Since the first client came; the ESP32's since it booted last."""
    stations = server.stations
    return {
        "seconds": round(server.world.seconds, 3),
        "clients": sum(station.clients for station in stations),
        "refused": sum(station.refused for station in stations),
        "bytes_to_clients": sum(station.bytes_to_clients for station in stations),
        "bytes_from_clients": sum(station.bytes_from_clients for station in stations),
        "frames_forwarded": sum(station.robot.esp32["frames_forwarded"] for station in stations),
        "frames_dropped": sum(station.robot.esp32["frames_dropped"] for station in stations),
        "times_late": server.times_late,
    }


class Output:
    """For people: the ports on stdout, all else on stderr."""

    def serving(self, made: Scenario, robots: list[dict[str, Any]]) -> None:
        from .show import emulated

        kinds = ", ".join(sorted({robot["firmware"] for robot in robots}))
        of: dict[str, list[str]] = {}
        for number, robot in enumerate(robots):
            if said := emulated(robot["backends"]):
                of.setdefault(said, []).append(str(number))
        notes = [f"; robot {', '.join(numbers)}: {said}" for said, numbers in of.items()]
        said = f"{len(robots)} robot{'s' * (len(robots) > 1)} of {made.name} ({kinds} firmware{''.join(notes)})"
        self._say(f"serving {said}; time begins with the first client; Ctrl-C ends")
        for robot in robots:
            print(robot["port"], flush=True)

    def heard_by_all(self, doors: list[Door]) -> None:
        """Who asked for it may not know what it means."""
        if any(ipaddress.ip_address(getattr(door, "host", "127.0.0.1")).is_unspecified for door in doors):
            self._say("every computer in your networks can connect; --listen 127.0.0.1:5000 is for this one alone")

    def happened(self, what: Happening) -> None:
        told = {
            "came": f"{what.client} has come",
            "went": f"{what.client} has gone",
            "refused": f"{what.client} was sent away: this robot has a client already (the real ESP32 would let it "
            "hang unheard)",
            "replaced": f"{what.client} has long taken nothing and made room for another client",
            "ended": f"{what.client} was sent away by the robot: its ESP32 or its Wi-Fi has gone",
        }
        self._say(f"{what.true_ns * 1e-9:.3f} s, robot {what.robot}: {told[what.what]}")

    def summary(self, server: Server) -> None:
        said = figures(server)
        late = said.pop("times_late")
        words = ", ".join(f"{value} {key.replace('_', ' ')}" for key, value in said.items() if key != "seconds")
        late_words = f"; {late} times this computer was too slow, and time stood still" if late else ""
        self._say(f"served {said['seconds']} s: {words}{late_words}")

    @staticmethod
    def _say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)


class JsonOutput(Output):
    """For programs."""

    def serving(self, made: Scenario, robots: list[dict[str, Any]]) -> None:
        self._line("serving", {"scenario": made.name, "robots": robots})

    def happened(self, what: Happening) -> None:
        self._line(what.what, {"robot": what.robot, "client": what.client, "true_ns": what.true_ns})

    def summary(self, server: Server) -> None:
        self._line("summary", figures(server))

    @staticmethod
    def _line(event: str, record: dict[str, Any]) -> None:
        print(json.dumps({"event": event, **record}, separators=(",", ":")), flush=True)
