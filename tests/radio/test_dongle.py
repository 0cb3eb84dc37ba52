"""What a Crazyradio is told over USB: literally, against Bitcraze's own driver (cflib), and when it goes wrong."""

import errno
import io
import json
import os
import signal
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("usb.core", reason="pyusb is not installed: pip install 'spindeck[radio]'")

import usb.backend.libusb1
import usb.core
from fake_dongle import FakeDongle, FakeUsb, raising

from host.cli import main
from host.protocol.errors import LocalError, NotThereError
from host.protocol.packets import RESET_CLOCKS
from host.radio.dongle import Dongle
from host.radio.url import RadioUrl, parse
from host.usd.decode import decode

BEACON = bytes.fromhex("d2 62 01 02 03 04 05 06 07 08 09 0a 0b 0c")
Plug = Callable[..., None]


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch) -> Plug:
    """Puts these dongles where pyusb looks."""

    def put(*dongles: FakeDongle) -> None:
        monkeypatch.setattr(usb.backend.libusb1, "get_backend", lambda: FakeUsb(*dongles))

    return put


def of_linux(dongle: FakeDongle) -> list[tuple[Any, ...]]:
    """Elsewhere the dongle is not reset."""
    return [each for each in dongle.transfers if each != ("reset",)]


TOLD = [
    ("configuration", 1),
    ("control", 0x40, 0x03, 2, 0, b""),
    ("control", 0x40, 0x01, 80, 0, b""),
    ("control", 0x40, 0x20, 0, 0, b""),
    ("control", 0x40, 0x02, 0, 0, b"\xff\xe7\xe7\xe7\xe7"),
    ("control", 0x40, 0x04, 3, 0, b""),
    ("control", 0x40, 0x10, 0, 0, b""),
    ("control", 0x40, 0x23, 0, 0, b""),
    ("bulk", 0x01, BEACON),
    ("bulk", 0x01, bytes.fromhex("23 00 75 73 65 63 00 72 65 73 65 74 00 08 01")),
]


@pytest.mark.parametrize("version", [0x0053, 0x0500], ids=["PA", "2.0"])
def test_every_transfer(version: int, plug: Plug) -> None:
    dongle = FakeDongle(version=version, state={"ack": 1, "inline": int(version == 0x0500), "carrier": 1})
    plug(dongle)
    opened = Dongle("radio://0/80/2M")
    opened.send(BEACON)
    opened.send(RESET_CLOCKS)
    opened.close()
    assert of_linux(dongle) == TOLD
    assert [packet for _, packet in dongle.sent] == [BEACON, RESET_CLOCKS], "whatever it had been told before"
    assert not dongle.answers, "the dongle answers nothing that nobody reads"


@pytest.fixture
def crazyradio(monkeypatch: pytest.MonkeyPatch) -> Any:
    """cflib's driver of the dongle, over the real pyusb."""
    pytest.importorskip("cflib", reason="cflib is not installed")
    if "libusb_package" not in sys.modules:
        monkeypatch.setitem(sys.modules, "libusb_package", types.ModuleType("libusb_package"))
    before = set(sys.modules)
    from cflib.drivers.crazyradio import Crazyradio

    yield Crazyradio
    for name in set(sys.modules) - before:
        if name.startswith("cflib"):
            del sys.modules[name]


@pytest.mark.parametrize("rate", ["1M", "2M"])
@pytest.mark.parametrize("channel", [0, 2, 80, 100])
def test_as_cflib_does_it(rate: str, channel: int, crazyradio: Any, plug: Plug) -> None:
    """Each transfer of ours is one of cflib's, byte for byte, and what goes on the air is the same, sent alike."""
    theirs = FakeDongle()
    radio = crazyradio(device=usb.core.Device(theirs, FakeUsb(theirs)))
    radio.set_channel(channel)
    radio.set_data_rate({"1M": radio.DR_1MPS, "2M": radio.DR_2MPS}[rate])
    radio.set_address((0xFF, 0xE7, 0xE7, 0xE7, 0xE7))
    radio.set_ack_enable(False)
    for packet in (BEACON, RESET_CLOCKS):
        assert radio.send_packet(packet) is None, "nothing comes back: cflib waits for it, 1 s"
    ours = FakeDongle()
    plug(ours)
    dongle = Dongle(f"radio://0/{channel}/{rate}")
    for packet in (BEACON, RESET_CLOCKS):
        dongle.send(packet)
    own = ("control", 0x40, 0x23, 0, 0, b"")
    assert [each for each in ours.transfers if each not in theirs.transfers] == [own]
    assert [each for each in ours.transfers if each[0] == "bulk"] == [
        each for each in theirs.transfers if each[0] == "bulk"
    ]
    unused = {"ard", "arc"}  # of acknowledgements
    for (state, packet), (their_state, their_packet) in zip(ours.sent, theirs.sent, strict=True):
        assert packet == their_packet
        assert state == {key: value for key, value in their_state.items() if key not in unused}


def test_which_dongle(plug: Plug) -> None:
    dongles = FakeDongle("E7E7"), FakeDongle("0123456789")
    plug(*dongles)
    Dongle("radio://1/80/2M").send(BEACON)
    Dongle("radio://0123456789/80/1m").send(BEACON)
    Dongle("radio://e7e7/80/1M").send(BEACON)
    assert [len(each.sent) for each in dongles] == [1, 2]
    with pytest.raises(NotThereError, match="there is no dongle 2: 2 plugged in, counted from 0"):
        Dongle("radio://2/80/2M")
    with pytest.raises(NotThereError, match="no dongle has this serial number; there is E7E7, 0123456789"):
        Dongle("radio://E7E8/80/2M")


def test_ports_lists_them(plug: Plug, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def listed() -> list[Any]:
        assert main(["ports", "--timeout", "0", "--json"]) == 0
        found = [json.loads(each) for each in capsys.readouterr().out.splitlines()]
        return [(each["port"], each["serial"]) for each in found if each["kind"] == "radio"]

    plug(FakeDongle(), FakeDongle(fail=raising("open", "Access denied", errno.EACCES)))
    assert listed() == [("radio://0/CHANNEL/RATE", "FD61E54B7A"), ("radio://1/CHANNEL/RATE", None)]
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    assert main(["ports", "--timeout", "0"]) == 0
    table = capsys.readouterr().out
    assert "Crazyradio (serial number FD61E54B7A), for host sync beacons" in table
    assert "no permission" in table
    plug()
    assert listed() == []

    def unreadable(*_: object) -> None:
        raise usb.core.USBError("Other error", -99, None)

    plug(FakeDongle())
    monkeypatch.setattr(FakeUsb, "enumerate_devices", unreadable)
    assert listed() == []
    assert main(["sync", "beacons", "--port", "radio://0/80/2M"]) == 2
    assert "this computer's USB cannot be looked at: Other error" in capsys.readouterr().err
    for name in ("libusb0", "libusb1", "openusb"):
        monkeypatch.setattr(f"usb.backend.{name}.get_backend", lambda: None)
    assert listed() == []
    monkeypatch.setitem(sys.modules, "usb", None)
    monkeypatch.setitem(sys.modules, "usb.core", None)
    assert listed() == []


def test_urls() -> None:
    assert parse("radio://0/80/2M") == RadioUrl(0, 80, "2M")
    assert parse("RADIO://FD61E54B7A/0/1m") == RadioUrl("FD61E54B7A", 0, "1M")
    for url, why in {
        "radio://": "write radio://DONGLE/CHANNEL/RATE",
        "radio://0/80": "write radio://DONGLE/CHANNEL/RATE",
        "radio:///80/2M": "no dongle",
        "radio://0/80/2M/E7E7E7E7E7": "leave out the address /E7E7E7E7E7",
        "radio://0/80/2M?rate_limit=100": "write radio://",
        "radio://0/101/2M": r"channel 101: give that of the robots, 0\.\.100",
        "radio://0/-1/2M": "channel -1",
        "radio://0/80/250K": "rate 250K: give that of the robots, 1M or 2M",
        "usb://0": "write radio://",
    }.items():
        with pytest.raises(LocalError, match=why):
            parse(url)


def test_why_it_cannot_be_opened(
    plug: Plug, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def said(port: str = "radio://0/80/2M") -> str:
        assert main(["sync", "beacons", "--port", port, "--duration", "1"]) == 2
        text = capsys.readouterr().err
        assert text.count("\n") == 1, "one line"
        return text

    plug()
    assert "no Crazyradio is plugged in" in said()
    plug(FakeDongle(fail=raising("open", "Access denied", errno.EACCES)))
    rule = 'SUBSYSTEM=="usb", ATTRS{idVendor}=="1915", ATTRS{idProduct}=="7777", TAG+="uaccess"'
    assert rule in said()
    assert rule in said("radio://FD61E54B7A/80/2M")
    plug(FakeDongle(fail=raising("claim", "Resource busy", errno.EBUSY)))
    assert "the dongle is busy: another program" in said()
    plug(FakeDongle(fail=raising("control", "Input/Output Error", errno.EIO)))
    assert "unplug it and plug it in again" in said()
    plug(FakeDongle(fail=raising("control", "Input/Output Error", errno.EIO, after=6)))
    assert "unplug it and plug it in again" in said()

    def unsupported(what: str) -> None:
        raise NotImplementedError("Operation not supported or unimplemented on this platform")

    plug(FakeDongle(fail=unsupported))
    assert "on Windows, WinUSB" in said()
    monkeypatch.setattr(usb.backend.libusb1, "get_backend", lambda: None)
    for name in ("libusb0", "openusb"):
        monkeypatch.setattr(f"usb.backend.{name}.get_backend", lambda: None)
    assert "apt install libusb-1.0-0" in said()
    monkeypatch.setitem(sys.modules, "usb", None)
    monkeypatch.setitem(sys.modules, "usb.core", None)
    assert "pip install 'spindeck[radio]'" in said()


def send(log: Path, *more: str) -> int:
    return main(["sync", "beacons", "--port", "radio://0/80/2M", "--hz", "10", "--log", str(log), "--json", *more])


def test_a_run_by_this_computers_clock(plug: Plug, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Sent, said and logged agree."""
    dongle = FakeDongle()
    plug(dongle)
    log = tmp_path / "host00"
    assert send(log, "--duration", "1.2", "--reset") == 0
    events = [json.loads(each) for each in capsys.readouterr().out.splitlines()]
    assert {each["event"] for each in events[:-1]} <= {"beacons"}
    assert events[-1]["event"] == "summary"
    packets = [packet for _, packet in dongle.sent]
    assert packets.pop(0) == RESET_CLOCKS
    summary = events[-1]
    assert len(packets) == summary["sent"] == 12 - summary["skipped"]
    numbers = [int.from_bytes(each[2:6], "little") for each in packets]
    assert numbers == list(range(numbers[0], numbers[0] + len(packets)))
    rows = decode(log.read_bytes()).rows["beaconSent"]
    host_us = [int.from_bytes(each[6:], "little") for each in packets]
    assert rows.data["sequence"].tolist() == numbers
    assert (rows.data["hostUs"].astype(int) + (rows.data["hostUsHigh"].astype(int) << 32)).tolist() == host_us
    transfer_us = sorted((rows.stamp_us.astype(int) - host_us).tolist())
    assert transfer_us[0] >= 0
    assert transfer_us[-1] == summary["transfer_us_max"]
    assert summary["late_us_max"] >= summary["late_us_p95"] >= summary["late_us_p50"] >= 0
    before = log.read_bytes()
    assert send(log, "--duration", "1") == 2
    assert "exists, and is not overwritten" in capsys.readouterr().err
    assert log.read_bytes() == before


def test_pulled_out_on_the_way(plug: Plug, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "host00"
    plug(FakeDongle(fail=raising("bulk", "No such device (it may have been disconnected)", errno.ENODEV, after=3)))
    assert send(log, "--duration", "5") == 5
    out, err = capsys.readouterr()
    assert json.loads(out)["sent"] == 3
    assert "the dongle is gone (No such device" in err
    assert f"(3 beacons were sent; {log} has what was sent before)" in err
    found = decode(log.read_bytes())
    assert np.diff(found.rows["beaconSent"].data["sequence"]).tolist() == [1, 1]
    assert not found.damages


def test_pulled_out_before_the_first(plug: Plug, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plug(FakeDongle(fail=raising("bulk", "No such device", errno.ENODEV)))
    assert send(tmp_path / "host00", "--duration", "5") == 5
    assert list(tmp_path.iterdir()) == []
    assert send(tmp_path / "host00", "--duration", "5", "--reset") == 5
    assert list(tmp_path.iterdir()) == []
    assert capsys.readouterr().out == ""


def test_a_dongle_that_takes_nothing_more(plug: Plug, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without a time it takes in, as its firmware hangs: each packet fails, and after some it is given up."""
    plug(FakeDongle(fail=raising("bulk", "Operation timed out", errno.ETIMEDOUT, after=2)))
    assert send(tmp_path / "host00", "--duration", "9") == 3
    out, err = capsys.readouterr()
    summary = json.loads(out)
    assert (summary["sent"], summary["failed"]) == (2, 5)
    assert "has not taken a packet within 100 ms: 5 packets in a row (2 beacons were sent" in err
    last = summary["sequence"]
    sent = decode((tmp_path / "host00").read_bytes()).rows["beaconSent"].data["sequence"]
    assert sent.tolist() == [last - 6, last - 5]


@pytest.mark.parametrize(
    ("error", "code"),
    [(BrokenPipeError(), 0), (KeyboardInterrupt(), 130), (OSError(errno.ENOSPC, "No space left on device"), 2)],
    ids=["head", "twice Ctrl-C", "/dev/full"],
)
def test_whatever_ends_it_the_log_is_kept(
    error: BaseException, code: int, plug: Plug, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program that reads our lines and has enough; whoever is impatient."""
    dongle = FakeDongle()
    plug(dongle)

    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr("host.cli.sync_send.tell", fail)
    monkeypatch.setattr("host.cli.sync_send.SECOND_US", 200_000)
    monkeypatch.setattr("host.cli.forget_output", lambda: None)
    assert send(tmp_path / "host00") == code
    found = decode((tmp_path / "host00").read_bytes())
    assert len(found.rows["beaconSent"]) == len(dongle.sent) > 0
    assert not found.damages


class SmallDisk(io.FileIO):
    """With room for 150 bytes: the last write that fits is a short one."""

    def write(self, data: Any) -> int:
        room = 150 - self.tell()
        if room == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().write(data[:room])


def test_a_disk_that_is_full(
    plug: Plug, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rows that fit are kept."""
    dongle = FakeDongle()
    plug(dongle)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", lambda path, mode, buffering: SmallDisk(str(path), mode))
        assert send(tmp_path / "host00") == 2
    out, err = capsys.readouterr()
    assert (tmp_path / "host00").stat().st_size == 150
    rows = len(decode((tmp_path / "host00").read_bytes()).rows["beaconSent"])
    assert 0 < rows == len(dongle.sent) - 1
    assert f"host00: No space left on device; {rows} beacons are in it" in err
    assert json.loads(out)["sent"] == rows + 1


def test_a_dongle_that_takes_nothing_at_all(plug: Plug, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In less time than it takes to give it up."""
    plug(FakeDongle(fail=raising("bulk", "Operation timed out", errno.ETIMEDOUT)))
    assert send(tmp_path / "host00", "--duration", "0.3") == 3
    assert "has not taken a packet within 100 ms" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("more", "code"), [([], 0), (["--duration", "9"], 130)])
def test_ctrl_c(more: list[str], code: int, plug: Plug, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dongle = FakeDongle()

    def stop(packet: bytes) -> None:
        if len(dongle.sent) == 3:
            signal.raise_signal(signal.SIGINT)

    dongle.on_air = stop
    plug(dongle)
    assert send(tmp_path / "host00", *more) == code
    assert json.loads(capsys.readouterr().out)["sent"] == len(dongle.sent) == 3
    assert len(decode((tmp_path / "host00").read_bytes()).rows["beaconSent"]) == 3
