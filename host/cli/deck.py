"""`host deck`: settings of the camera and of the wireless network, with an answer or with who is silent."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..protocol.errors import LocalError, PeerError, PeerSilentError
from ..protocol.typed import integer
from .stream import positive

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..link.stream import Stream
    from ..protocol.packets import CameraSettings

CAMERA = """\
All settings are sent together, and hold from the next capture on: what is not given goes to its default.
The GAP8 needs firmware that speaks native, or the dataset paper's; nothing is sent to any other. A TCP connection is
listened to first, for 2 s at most, to tell which firmware speaks.

examples:
  host deck camera --port socket://192.168.4.1:5000 --exposure-lines 300 --analog-gain 2
  host deck camera --port "sim://hover?pace=max" --fps 5 --encoding jpeg
"""
WIFI = """\
Nothing in the protocol acknowledges these messages: what was sent and what was heard is told. An ESP32 that changes
its network ends the connection. The settings last until it restarts. NanoCockpit's network is compiled into it.
A key on the command line is seen by other users of this computer (ps): without --key it is asked for.

examples:
  host deck wifi --port socket://192.168.4.1:5000 --mode station --ssid lab --key-file lab.key
  host deck wifi --port socket://192.168.4.1:5000 --mode ap --ssid drone7 --open
"""
COMPILED_IN = {
    "camera": "NanoCockpit's camera settings are compiled into it",
    "wifi": "NanoCockpit's network is compiled into its ESP32, which knows no message about it",
}
"""Why NanoCockpit is not asked."""


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Declares both commands and their options."""
    this = commands.add_parser(
        "deck", help="set a deck's camera or wireless network", description="Set a deck's camera or wireless network."
    )
    of_deck = this.add_subparsers(dest="what", metavar="WHAT", required=True)
    camera = of_deck.add_parser("camera", help="exposure, gain, rate, encoding", epilog=CAMERA)
    add = add_common(camera, timeout_s=10.0)
    exposure = camera.add_mutually_exclusive_group()
    exposure.add_argument("--exposure-lines", type=integer, metavar="N", help="fixed exposure, 2..65533 lines")
    exposure.add_argument("--auto-exposure", action="store_true", help="automatic exposure (default)")
    add("--analog-gain", type=integer, metavar="X", help="1, 2, 4 or 8 (default 1)")
    add("--digital-gain", type=integer, metavar="N", help="in 1/64, 1..255 (default 64)")
    add("--fps", type=positive(float), metavar="F", help="frames per second, 0.1..218 (default: as fast as it goes)")
    add("--burst", type=integer, metavar="N", help="images back to back, 1..3 (default 1)")
    add("--encoding", choices=["raw", "jpeg"], help="default raw")
    camera.set_defaults(run=run_camera)
    wifi = of_deck.add_parser("wifi", help="access point or station, name, key", epilog=WIFI)
    add = add_common(wifi, timeout_s=5.0)
    add("--mode", choices=["ap", "station"], required=True, help="its own network, or a member of one")
    add("--ssid", required=True, metavar="NAME", help="of the network, 1 to 32 bytes")
    key = wifi.add_mutually_exclusive_group()
    key.add_argument("--key", metavar="KEY", help="of the network, 8 to 64 bytes; other users can see it here")
    key.add_argument("--key-file", metavar="FILE", help="the key is its first line; - for stdin")
    key.add_argument("--open", action="store_true", help="a network without a key")
    wifi.set_defaults(run=run_wifi)


def add_common(this: argparse.ArgumentParser, timeout_s: float) -> Callable[..., argparse.Action]:
    """What both need to reach a deck."""
    add = this.add_argument
    add("--port", required=True, metavar="PORT", help="as of host stream")
    add("--baud", type=positive(int), help="of a serial port (default 576000)")
    add("--timeout", type=positive(float), default=timeout_s, metavar="S", help="wait so long (default %(default)g)")
    add("--json", action="store_true", help="JSON on stdout, also on a terminal")
    return add


def run_camera(arguments: argparse.Namespace) -> int:
    """Waits until the GAP8 has announced native, asks, and waits for its reply."""
    from ..native import lib
    from ..protocol.codec import RANGES, encode_camera_request
    from .deck_talk import Talk

    settings = camera_settings(arguments)
    request = encode_camera_request(settings)
    with open_deck(arguments) as stream:
        talk = Talk(stream, arguments.timeout, COMPILED_IN["camera"])
        talk.listen()
        talk.until(lambda heard: heard.native or heard.is_stock)
        if talk.heard.dialect == "paper":
            return send_paper(arguments, stream, settings)
        if talk.heard.is_stock:
            raise PeerError(
                f"{arguments.port}: the firmware is stock: it has no camera settings. The GAP8 was sent nothing"
            )
        if talk.heard.native:
            talk.until(lambda heard: heard.reply is not None, (lib.CPX_GAP8, lib.CPX_APP, request))
        reply = talk.heard.reply
        if reply is None:
            raise talk.silent()
    if reply.status:
        names = list(RANGES["native_camera_t"])
        name = names[reply.status - 1] if reply.status <= len(names) else f"field {reply.status}"
        value = getattr(settings, name, "")
        raise PeerError(f"{arguments.port}: the GAP8 refuses {name} {value}. Nothing was changed")
    exposure = "automatic" if settings.auto_exposure else f"{settings.exposure_lines} lines"
    rate = f"{1e6 * settings.burst / settings.frame_period_us:g}" if settings.frame_period_us else "as many as it can"
    tell(
        arguments,
        {"event": "camera", "status": 0, "settings": as_record(settings)},
        f"the GAP8 has taken it: exposure {exposure}, analog gain {settings.analog_gain}, digital gain "
        f"{settings.digital_gain}/64, {rate} fps in bursts of {settings.burst}, {settings.encoding}",
    )
    return 0


def send_paper(arguments: argparse.Namespace, stream: Stream, settings: CameraSettings) -> int:
    """In the message of the dataset paper's firmware, which nothing answers."""
    from .deck_talk import REPEAT_S

    if arguments.fps is not None:
        raise LocalError("--fps: the paper's firmware has no frame rate, it takes as many as it can: leave it out")
    stream.send_camera(settings)
    until_ns = stream.port.clock_ns() + int(REPEAT_S * 1e9)
    while stream.port.clock_ns() < until_ns and stream.poll() is not None:
        pass  # until it is on its way for sure
    tell(
        arguments,
        {"event": "camera", "status": None, "settings": as_record(settings)},
        "sent to the GAP8 in the message of the paper's firmware, which answers nothing: look at the frames",
    )
    return 0


def camera_settings(arguments: argparse.Namespace) -> CameraSettings:
    """From the options. LocalError when none is given; values are judged by the encoder."""
    from ..link.deck import LINES_MAX, frame_period_us
    from ..protocol.packets import CameraSettings

    names = ("exposure_lines", "analog_gain", "digital_gain", "burst", "encoding")
    given: dict[str, Any] = {name: value for name in names if (value := getattr(arguments, name)) is not None}
    if not given and arguments.fps is None and not arguments.auto_exposure:
        raise LocalError("nothing to set: give at least one of the camera's options (host deck camera --help)")
    given["auto_exposure"] = arguments.exposure_lines is None
    if (arguments.exposure_lines or 0) > LINES_MAX:
        raise LocalError(f"--exposure-lines {arguments.exposure_lines}: the sensor can do 2..{LINES_MAX}")
    if arguments.fps is not None:
        burst = given.get("burst", 1)
        given["frame_period_us"] = frame_period_us(arguments.fps, burst, arguments.exposure_lines)
    return CameraSettings(**given)


def run_wifi(arguments: argparse.Namespace) -> int:
    """Sends the settings to an ESP32 that has answered an echo, and tells what is heard."""
    from ..link.deck import wifi_packets
    from ..native import lib
    from .deck_talk import Talk

    packets = wifi_packets(arguments.ssid, network_key(arguments), arguments.mode == "station")
    with open_deck(arguments) as stream:
        talk = Talk(stream, arguments.timeout, COMPILED_IN["wifi"])
        talk.listen()
        talk.until(lambda heard: heard.echo)
        if not talk.heard.echo:
            raise PeerSilentError(f"{talk.silent()} (No setting was sent.)")
        for _, data in packets:
            stream.send(lib.CPX_ESP32, lib.CPX_WIFI_CTRL, data)
        talk.heard.echo = False
        talk.until(lambda heard: heard.address is not None, may_end=True)
        ended = stream.port.ended if talk.ended else ""
    heard = list(talk.heard.notices)
    if ended:
        heard.append(f"the connection has ended ({ended}), as it does when the network changes")
    if talk.heard.echo and not ended:
        heard.append("the ESP32 still answers on the old network: it has these settings already, or has refused them")
    sent = [text for text, _ in packets]
    record = {"event": "wifi", "sent": sent, "heard": talk.heard.notices, "address": talk.heard.address, "ended": ended}
    tell(
        arguments,
        {**record, "still_answers": talk.heard.echo and not ended},
        "\n".join([*(f"sent   {text}" for text in sent), *(f"heard  {text}" for text in heard or ["nothing"])]),
    )
    return 0


def network_key(arguments: argparse.Namespace) -> str:
    """Of the network; empty for an open one."""
    if arguments.open:
        return ""
    if arguments.key is not None:
        key = str(arguments.key)
    elif arguments.key_file is not None:
        try:
            with sys.stdin if arguments.key_file == "-" else Path(arguments.key_file).open(encoding="utf-8") as file:
                key = file.readline().rstrip("\r\n")
        except (OSError, UnicodeDecodeError) as error:
            raise LocalError(f"--key-file {arguments.key_file}: {getattr(error, 'strerror', error)}") from error
    elif sys.stdin.isatty():
        from getpass import getpass

        key = getpass(f"key of {arguments.ssid}: ")
    else:
        raise LocalError("which key? Give --key-file FILE, or --open for a network without one")
    if not key:
        raise LocalError("the key is empty: give 8 to 64 bytes, or --open for a network without a key")
    return key


def open_deck(arguments: argparse.Namespace) -> Stream:
    """The robot, of which nothing native is asked."""
    import host

    if arguments.port.startswith("replay://"):
        raise LocalError(f"{arguments.port}: a recording cannot be asked to change anything")
    return host.open(arguments.port, baud=arguments.baud, dialect="stock", timeout=None)


def as_record(settings: CameraSettings) -> dict[str, Any]:
    import dataclasses

    return dataclasses.asdict(settings)


def tell(arguments: argparse.Namespace, record: dict[str, Any], text: str) -> None:
    """The answer, on stdout."""
    from .as_json import line

    print(line(record) if arguments.json or not sys.stdout.isatty() else text)
