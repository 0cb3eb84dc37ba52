"""Why a serial device cannot be opened, or a port listened at, and what to do: no permission, busy, missing, …

Linux tells much of this to everybody, elsewhere the answer is shorter.
"""

from __future__ import annotations

import contextlib
import difflib
import errno
import os
import socket
import stat
from pathlib import Path

from .discovery import serial_devices

PROC = Path("/proc")
SYS = Path("/sys")
LOCKS = Path("/var/lock")
RULES = "/etc/udev/rules.d/70-spindeck.rules"


def why(error: Exception, device: str) -> str:
    """What pyserial's or the system's error about this device means."""
    number, text = getattr(error, "errno", None), str(error)
    if number == errno.ENOENT or "FileNotFoundError" in text:
        return missing(device)
    if os.name != "posix" and (number == errno.EACCES or "PermissionError" in text):
        return "busy, or no permission: another program may have it open"
    if number in (errno.EACCES, errno.EPERM):
        return no_permission(device)
    if number in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in text:
        return busy(device)
    if number in (errno.ENXIO, errno.ENODEV, errno.EIO):
        return "the device is there, and its hardware does not answer: unplug it and plug it in again"
    if number in (errno.ENOTTY, errno.EISDIR, errno.EINVAL) or "Could not configure port" in text:
        return "this is no serial device"
    return text


def not_listening(error: Exception, host: str, port: int) -> str:
    """Why nobody can listen there."""
    number = getattr(error, "errno", None)
    if isinstance(error, socket.gaierror | UnicodeError):
        return "there is no such address; on this computer alone: 127.0.0.1"
    if number == errno.EADDRINUSE:
        return f"port {port} is in use: another simulator, or another program; name another port, or 0 for any"
    if number == errno.EADDRNOTAVAIL:
        return f"{host} is no address of this computer; 127.0.0.1 is heard on it alone, 0.0.0.0 by the whole network"
    if number == errno.EACCES:
        return f"port {port} is for the administrator alone: name one above 1023"
    return getattr(error, "strerror", None) or str(error)


def is_device(port: str) -> bool:
    """By its name: a device that is not there, but may be plugged in."""
    return "://" not in port and (os.sep in port or port.upper().startswith("COM"))


def missing(device: str) -> str:
    """With the devices that there are, or what else was meant."""
    if device.endswith(".mcap"):
        return f"this is no port. Did you mean replay://{device}?"
    if not is_device(device):
        return (
            "there is no such port. Write socket://ADDRESS:PORT, sim://SCENARIO, replay://FILE, or a serial device, "
            "such as /dev/ttyUSB0; 'host ports' lists what there is"
        )
    known = [each.port for each in serial_devices()]
    near = difflib.get_close_matches(device, known, n=1)
    if near:
        return f"there is no such device. Did you mean {near[0]}? 'host ports' lists them all"
    return f"there is no such device. {'There is ' + ', '.join(known) if known else 'There is none: is it plugged in?'}"


def busy(device: str) -> str:
    """Who has it, as far as this user may know."""
    found = holders(device)
    if os.getpid() in found:
        return "busy: this program has it open already. Is the port given twice?"
    if not found:
        return f"busy: a program of another user has it open; this says which: sudo fuser -v {device}"
    names = ", ".join(f"{name} (process {pid})" for pid, name in found.items())
    return f"busy: {names} has it open: end it first"


def holders(device: str) -> dict[int, str]:
    """Processes that have it open, with the names of their programs. Of other users' processes only those are known
    that hold a lock."""
    try:
        node = Path(device).stat()
    except OSError:
        return {}
    pids = _locking(node) | _lock_file(device)
    wanted = os.path.realpath(device)
    for folder in PROC.glob("[0-9]*"):
        with contextlib.suppress(OSError):  # has ended, or is somebody else's
            if any(_link(each) == wanted for each in (folder / "fd").iterdir()):
                pids.add(int(folder.name))
    return {pid: _name(pid) for pid in sorted(pids) if (PROC / str(pid)).exists()}


def _link(path: Path) -> str:
    try:
        return str(path.readlink())
    except OSError:
        return ""


def _locking(node: os.stat_result) -> set[int]:
    """/proc/locks, "1: FLOCK  ADVISORY  WRITE 4711 00:05:1234 0 EOF": everybody may read it."""
    try:
        lines = (PROC / "locks").read_text(encoding="utf-8").splitlines()
    except OSError:
        return set()
    wanted = f"{os.major(node.st_dev):02x}:{os.minor(node.st_dev):02x}:{node.st_ino}"
    fields = [line.split() for line in lines]
    return {int(each[4]) for each in fields if len(each) > 5 and each[5] == wanted and each[4].isdigit()} - {0}


def _lock_file(device: str) -> set[int]:
    """The old custom of minicom and others."""
    try:
        return {int((LOCKS / f"LCK..{Path(device).name}").read_text(encoding="utf-8"))}
    except (OSError, ValueError):
        return set()


def _name(pid: int) -> str:
    try:
        return (PROC / str(pid) / "comm").read_text(encoding="utf-8").strip()
    except OSError:
        return "a program"


def no_permission(device: str) -> str:
    """With lines to paste."""
    try:
        node = Path(device).stat()
    except OSError:
        return "no permission. Usually this helps: sudo usermod -aG dialout $USER    # then log in again"
    group = _group(node.st_gid)
    told = (
        f"no permission: the device is for {_user(node.st_uid)} and the group {group} ({stat.filemode(node.st_mode)})"
    )
    if _is_member(group) and node.st_gid not in os.getgroups():
        return f"{told}. You are in that group since after you logged in: log out and in again"
    ways = [f"sudo usermod -aG {group} $USER    # then log in again"]
    rule = udev_rule(device)
    if rule is not None:
        reload = "sudo udevadm control --reload && sudo udevadm trigger"
        ways.append(f"echo '{rule}' | sudo tee -a {RULES} && {reload}    # for this kind of adapter alone, at once")
    return "\n  ".join([f"{told}. {'Either of these helps' if rule else 'This helps'}:", *ways])


def udev_rule(device: str) -> str | None:
    """Gives whoever sits at this computer the devices with the same USB vendor and product; None: not USB."""
    folder = SYS / "class" / "tty" / Path(os.path.realpath(device)).name / "device"
    for parent in (folder.resolve(), *folder.resolve().parents):
        try:
            vendor, product = (
                (parent / name).read_text(encoding="utf-8").strip() for name in ("idVendor", "idProduct")
            )
        except OSError:
            continue
        return f'SUBSYSTEM=="tty", ATTRS{{idVendor}}=="{vendor}", ATTRS{{idProduct}}=="{product}", TAG+="uaccess"'
    return None


def _user(uid: int) -> str:
    import pwd

    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


def _group(gid: int) -> str:
    import grp

    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def _is_member(group: str) -> bool:
    import grp

    try:
        return _user(os.getuid()) in grp.getgrnam(group).gr_mem
    except KeyError:
        return False
