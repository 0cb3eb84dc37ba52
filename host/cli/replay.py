"""`host replay`: a recording as the robot that it was."""

from __future__ import annotations

import argparse
import contextlib
import sys
from typing import Any

from ..protocol.errors import LocalError
from ..protocol.typed import integer, real
from .stream import positive

EXAMPLES = """\
Each robot of the recording gets a port of its own, from the given one on. A client gets what the robot sent, byte for
byte and in its rhythm, from the beginning; what it sends is ignored. Ends when every robot was played to its end.

To see a recording, or to use it wherever a PORT goes, no server is needed:
  host stream --port replay://flight1.mcap
  host stream --port "replay://flight1.mcap?rate=2&loop=1&start=10&robot=0"
  host stream --port "replay://flight1.mcap?pace=max" --images pictures

examples:
  host replay flight1.mcap
  host replay flight1.mcap --rate 0.5 --loop --start 12.5
  host replay flight1.mcap --listen 127.0.0.1:6000 --robot 1
"""


def address(text: str) -> tuple[str, int]:
    """An argparse type: HOST:PORT."""
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not host or not port.isascii() or not port.isdigit() or int(port) > 65535:
        raise argparse.ArgumentTypeError(f"write HOST:PORT, such as 127.0.0.1:5000, not {text}")
    return host, int(port)


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Declares the command and its options."""
    this = commands.add_parser(
        "replay",
        help="play a recording as the robot's TCP server",
        description="Play a recording as the robot that it was: a TCP server on this computer.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = this.add_argument
    add("file", metavar="FILE", help="a recording: host stream --record makes them")
    add("--rate", type=positive(float), default=1.0, metavar="R", help="so many times as fast (default 1)")
    add("--loop", action="store_true", help="again and again, until Ctrl-C")
    add("--start", type=real, default=0.0, metavar="S", help="begin S seconds after the beginning (default 0)")
    add("--robot", type=integer, metavar="N", help="only this one (default: all in the recording)")
    add(
        "--listen", type=address, default=("127.0.0.1", 5000), metavar="HOST:PORT",
        help="where the first robot is; the next one is a port further (default 127.0.0.1:5000; port 0: any free ones)",
    )  # fmt: skip
    add("--json", action="store_true", help="JSON lines on stdout, also on a terminal")
    this.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Serves until every robot was played, or Ctrl-C."""
    from ..link.replay import Recording
    from ..link.replay_server import ReplayServer
    from ..link.replay_url import to_url
    from .as_json import line

    as_json = arguments.json or not sys.stdout.isatty()

    def tell(event: dict[str, Any]) -> None:
        print(line(event) if as_json else in_words(event), flush=True)

    with contextlib.closing(Recording(arguments.file)) as recording:
        robots = sorted(recording.sources) if arguments.robot is None else [arguments.robot]
    host, port = arguments.listen
    if port + len(robots) > 65536:
        raise LocalError(f"--listen {host}:{port}: {len(robots)} robots need as many ports")
    with contextlib.ExitStack() as servers:
        playing = []
        for number, robot in enumerate(robots):
            choice = {"rate": arguments.rate, "loop": int(arguments.loop), "start": arguments.start, "robot": robot}
            url = to_url(arguments.file, **choice)
            server = ReplayServer(url, (host, port + number if port else 0), tell)
            servers.callback(server.close)
            playing.append(server)
        for server in playing:
            server.start()
        with contextlib.suppress(KeyboardInterrupt):
            while not all(server.wait(0.1) for server in playing):
                pass
        for server in playing:
            if server.error is not None:
                raise server.error
    return 0


def in_words(event: dict[str, Any]) -> str:
    """One line for people."""
    robot = f"robot {event['robot']}: "
    if event["event"] == "listening":
        framing = "" if event["framing"] == "tcp" else f" --framing {event['framing']}"
        return f"{robot}host stream --port {event['port']}{framing}"
    if event["event"] == "connected":
        return f"{robot}{event['client']} has connected"
    return f"{robot}{event['bytes']} bytes sent: {event['why']}"
