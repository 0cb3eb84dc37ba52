"""The compilers: GNU's, one for each target, and zig, which pip installs and which has two of the targets."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from ..protocol.errors import LocalError
from .targets import Target

NAMES = ("gcc", "zig")
NO_UNWINDING = ("-fno-unwind-tables", "-fno-asynchronous-unwind-tables")
TESTED = "gcc 12.2 and zig 0.17.1"
ZIG_PACKAGE = "pip install 'spindeck[firmware]'"


class MissingError(LocalError):
    """There is no compiler, but there could be one: the message says which."""


@dataclass(frozen=True)
class Toolchain:
    """A compiler for one target."""

    name: str
    version: str
    """As it calls itself, and what it cannot: two builds with equal versions are equal."""
    compile: tuple[str, ...]
    """The command and what is the target's own; also links."""
    link: tuple[str, ...]
    """At the end of a link."""
    whole: tuple[str, ...] = ()
    """Target.gcc_whole, if it can."""


def find(target: Target, name: str | None = None) -> Toolchain:
    """The compiler called `name`, or without a name GNU's if it is installed and zig otherwise. MissingError says what
    to install."""
    if name not in (None, *NAMES):
        raise LocalError(f"no toolchain {name!r}: {' or '.join(NAMES)}")
    if name in (None, "gcc") and (gcc := shutil.which(f"{target.gcc}-gcc")):
        version, command = first_line(gcc, "--version"), (gcc, *target.gcc_flags)
        whole = target.gcc_whole
        if whole and not accepts(*command, *whole):
            version, whole = f"{version}, built without LTO: images are slower in the emulator", ()
        return Toolchain("gcc", version, command, ("-nostdlib", "-lgcc"), whole)
    if name in (None, "zig") and target.zig_flags and (zig := zig_program()):
        # What these would add calls functions that are not there, or is never used. compiler-rt comes by itself.
        flags = ("-fno-sanitize=undefined", "-fno-stack-protector", *NO_UNWINDING)
        version = f"zig {first_line(zig, 'version')}"
        return Toolchain("zig", version, (zig, "cc", *target.zig_flags, *flags), ("-Wl,-e,board_reset",))
    raise MissingError(missing(target, name))


def missing(target: Target, name: str | None) -> str:
    """What to do about a compiler that is not there."""
    gcc = f"{target.gcc}-gcc (apt-get install {target.package})"
    if name == "zig" and not target.zig_flags:
        return f"zig has no code generator for the {target.name}: --toolchain gcc, which is {gcc}"
    zig = f"zig ({ZIG_PACKAGE})"
    choices = {"gcc": [gcc], "zig": [zig], None: [gcc, zig][: 1 + bool(target.zig_flags)]}[name]
    return f"no compiler for the {target.name}: install {' or '.join(choices)}"


def zig_program() -> str | None:
    """That of the package ziglang."""
    package = importlib.util.find_spec("ziglang")
    if package is None or package.origin is None:
        return None
    return shutil.which("zig", path=str(Path(package.origin).parent))


def accepts(*command: str) -> bool:
    """It compiles an empty file so. A gcc can be built without LTO, and then fails at its options."""
    probe = (*command, "-c", "-x", "c", "-", "-o", os.devnull)
    return subprocess.run(probe, stdin=subprocess.DEVNULL, capture_output=True, check=False).returncode == 0


def first_line(*command: str) -> str:
    """What it prints about itself. LocalError when it cannot be started."""
    try:
        run = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise LocalError(f"{command[0]} cannot be run: {error}") from error
    return re.sub(r"\s+", " ", run.stdout.strip().partition("\n")[0])
