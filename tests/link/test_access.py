"""Why a device cannot be opened: each reason with what to do, named from what the system knows."""

import errno
import os
import pty
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import serial

import host
from host.link import access
from host.protocol.errors import LocalError, PeerError


@pytest.fixture
def terminal():
    """A pseudo-terminal as a serial device: master, path of the slave."""
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    os.close(slave)
    yield master, path
    os.close(master)


def test_busy_and_by_whom(terminal):
    _, path = terminal
    holder = subprocess.Popen(
        [sys.executable, "-c", f"import serial; p = serial.Serial({path!r}, exclusive=True); print(1, flush=True); "
         "input()"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    )  # fmt: skip
    try:
        assert holder.stdout.readline() == b"1\n"
        with pytest.raises(LocalError, match=rf"{path}: busy: python\S* \(process {holder.pid}\) has it open"):
            host.open(path)
    finally:
        holder.communicate(b"\n")


def test_busy_by_this_very_program(terminal):
    _, path = terminal
    with serial.Serial(path, exclusive=True), pytest.raises(LocalError, match="this program has it open already"):
        host.open(path)


def test_busy_by_someone_unknown(terminal):
    assert "another user" in access.why(OSError(errno.EBUSY, "busy"), terminal[1])
    assert f"fuser -v {terminal[1]}" in access.why(OSError(errno.EBUSY, "busy"), terminal[1])


def test_holders_from_locks_and_lock_files(terminal, tmp_path, monkeypatch):
    """What is known of other users' processes: made-up files of the system, as it writes them."""
    _, path = terminal
    node = Path(path).stat()
    monkeypatch.setattr(access, "PROC", tmp_path / "proc")
    monkeypatch.setattr(access, "LOCKS", tmp_path)
    for pid, name in ((4711, "minicom"), (4712, "screen"), (4713, "gone by name only")):
        (tmp_path / "proc" / str(pid) / "fd").mkdir(parents=True)
        (tmp_path / "proc" / str(pid) / "comm").write_text(f"{name}\n")
    place = f"{os.major(node.st_dev):02x}:{os.minor(node.st_dev):02x}"
    (tmp_path / "proc" / "locks").write_text(
        f"1: POSIX  ADVISORY  WRITE 4713 {place}:{node.st_ino + 1} 0 EOF\n"
        f"2: FLOCK  ADVISORY  WRITE 4712 {place}:{node.st_ino} 0 EOF\n"
        f"2: -> FLOCK  ADVISORY  WRITE 4713 {place}:{node.st_ino} 0 EOF\n"
    )
    (tmp_path / f"LCK..{Path(path).name}").write_text("      4711\n")
    assert access.holders(path) == {4711: "minicom", 4712: "screen"}
    (tmp_path / f"LCK..{Path(path).name}").write_text("9999\n")
    assert access.holders(path) == {4712: "screen"}, "9999 has ended and left its file"


def test_no_permission_with_the_lines_to_paste(tmp_path, monkeypatch):
    monkeypatch.setattr(access, "SYS", tmp_path)
    usb = tmp_path / "devices" / "usb1" / "1-2"
    (usb / "1-2:1.0" / "ttyUSB7").mkdir(parents=True)
    (usb / "idVendor").write_text("10c4\n")
    (usb / "idProduct").write_text("ea60\n")
    (tmp_path / "class" / "tty" / "ttyUSB7").mkdir(parents=True)
    (tmp_path / "class" / "tty" / "ttyUSB7" / "device").symlink_to(usb / "1-2:1.0" / "ttyUSB7")
    device = tmp_path / "ttyUSB7"
    device.touch(mode=0o660)
    said = access.why(PermissionError(errno.EACCES, "Permission denied"), str(device))
    rule = 'SUBSYSTEM=="tty", ATTRS{idVendor}=="10c4", ATTRS{idProduct}=="ea60", TAG+="uaccess"'
    assert "no permission" in said
    assert "usermod -aG" in said
    assert f"echo '{rule}' | sudo tee -a /etc/udev/rules.d/70-spindeck.rules && sudo udevadm control --reload" in said
    assert "udev" not in access.why(PermissionError(errno.EACCES, "Permission denied"), str(tmp_path))


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody who may not")
def test_no_permission_as_it_happens(terminal):
    _, path = terminal
    Path(path).chmod(0o600)
    code = (
        "import grp, os, pwd, serial, host, host.link.stream; os.setgroups([]); os.setgid(65534); os.setuid(65534)\n"
        f"try: host.open({path!r})\n"
        "except host.LocalError as error: print(error)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert f"{path}: no permission" in result.stdout, result.stderr
    assert "usermod -aG" in result.stdout


def test_missing_with_what_there_is(monkeypatch):
    from host.link.discovery import SerialDevice

    known = []
    monkeypatch.setattr(access, "serial_devices", lambda: known)
    with pytest.raises(LocalError, match=r"/dev/ttyUSB8: there is no such device\. There is none: is it plugged in"):
        host.open("/dev/ttyUSB8")
    known.append(SerialDevice("/dev/ttyUSB0", "", ""))
    with pytest.raises(LocalError, match="Did you mean /dev/ttyUSB0"):
        host.open("/dev/ttyUSB8")
    with pytest.raises(LocalError, match="There is /dev/ttyUSB0"):
        host.open("/nowhere/x")


def test_no_serial_device(tmp_path):
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path):
        with pytest.raises(LocalError, match="this is no serial device"):
            host.open(str(path))


def test_refused_on_this_computer():
    with pytest.raises(LocalError, match=r"refused.*nothing listens on port 9"):
        host.open("socket://127.0.0.1:9")


@pytest.mark.parametrize(("framing", "baud"), [("cpx-uart", 576_000), ("stamps", 115_200)])
def test_bytes_and_nothing_in_them_is_the_wrong_baud_rate(terminal, framing, baud):
    """Noise with a start byte and a check that fits by chance now and then, as a wrong rate gives."""
    master, path = terminal
    stop = threading.Event()
    noise = bytes.fromhex("ff0042e1ff13bc2a7ee0ff030a040e9c") * 16 + bytes.fromhex("ff040a042001d4") + b"\x95" * 64

    def make_noise():
        while not stop.is_set():
            os.write(master, noise)
            stop.wait(0.01)

    with host.open(path, framing=framing, timeout=0.5) as stream:
        thread = threading.Thread(target=make_noise)
        thread.start()
        try:
            with pytest.raises(
                PeerError, match=rf"(\d+% garbage|no packet in them): wrong baud rate\? It is {baud}"
            ) as caught:
                list(stream)
            assert str(caught.value).count(str(baud)) == 1
        finally:
            stop.set()
            thread.join()
