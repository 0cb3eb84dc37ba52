"""From the sources that came with this package to an image: ELF, binary, map.

A build depends on nothing but the sources and the compiler: it runs on a copy in a folder of its own, and names files
as they are called below firmware/. So two builds are equal byte for byte, and one that was made before is taken from
the cache, where it lies under the hash of everything that went into it. (zig's run-time library says in its debug
information where zig lies: with another zig, the ELF file and the map differ in that. The binary does not.)
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from ..protocol.errors import LocalError
from .elf import write_binary
from .targets import Target, target_of
from .toolchains import TESTED, Toolchain, find

SOURCES = Path(__file__).resolve().parents[2] / "firmware"
"""Beside `host`, in a checkout as in a wheel."""

FLAGS = (
    *("-std=c11", "-O2", "-g", "-ffreestanding", "-ffp-contract=off", "-ffunction-sections", "-fdata-sections"),
    *("-Wall", "-Wextra", "-Wconversion"),
)
CALLED_BY_COMPILERS = "board/memory.c"
"""Calls to these come into being with the machine code: too late for files that have become one program."""
MESSAGE_LINES = 12


@dataclass(frozen=True)
class Image:
    """Files of one build."""

    target: Target
    toolchain: Toolchain
    folder: Path
    warnings: str
    """Of the compiler; empty with those that the tests use."""

    @property
    def elf(self) -> Path:
        return self.folder / f"{self.target.name}.elf"

    @property
    def binary(self) -> Path | None:
        """What goes into flash memory. None for an ESP32 without esptool."""
        path = self.folder / f"{self.target.name}.bin"
        return path if path.exists() else None

    @property
    def map(self) -> Path:
        return self.folder / f"{self.target.name}.map"

    @property
    def files(self) -> list[Path]:
        return [path for path in (self.elf, self.binary, self.map) if path]


def build(name: str, toolchain: str | None = None, defines: Mapping[str, str] | None = None) -> Image:
    """The image of one target, from the cache if it has been built before. LocalError without a compiler."""
    target = target_of(name)
    compiler = find(target, toolchain)
    made = tuple(f"-D{key}={value}" for key, value in sorted((defines or {}).items()))
    sources = sources_of(target)
    folder = cache() / f"{target.name}-{key(target, compiler, made, sources)}"
    if not folder.exists():
        store(target, compiler, made, sources, folder)
    return Image(target, compiler, folder, (folder / "warnings.txt").read_text(encoding="utf-8"))


def sources_of(target: Target) -> list[Path]:
    """All files that it depends on, relative to SOURCES, in a fixed order."""
    folders = ("board", "core", target.name, f"{target.name}/board")
    found = [path.relative_to(SOURCES) for each in folders for path in sorted((SOURCES / each).glob("*.[chSl]*"))]
    if not any(path.suffix == ".ld" for path in found):
        raise LocalError(f"{SOURCES}: no sources of the {target.name}'s firmware there: install spindeck again")
    return found


def key(target: Target, compiler: Toolchain, defines: tuple[str, ...], sources: list[Path]) -> str:
    """Of a build: equal keys, equal bytes."""
    digest = hashlib.sha256()
    options = (*FLAGS, *compiler.compile[1:], *compiler.whole, *compiler.link, *defines)
    for part in (compiler.version, *options, esptool_version() if target.name == "esp32" else ""):
        digest.update(part.encode() + b"\0")
    for path in sources:
        content = (SOURCES / path).read_bytes()
        digest.update(f"{path.as_posix()}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()[:16]


def cache() -> Path:
    """Where builds are kept. Deleting it costs no more than building again."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "spindeck" / "firmware"


def store(target: Target, compiler: Toolchain, defines: tuple[str, ...], sources: list[Path], folder: Path) -> None:
    """Builds into the cache. Several processes may do so at once: each folder appears whole, or not."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f"{folder.name}-", dir=folder.parent))
    except OSError as error:
        raise LocalError(
            f"{folder.parent} cannot be written ({error.strerror}): set XDG_CACHE_HOME to a folder that can"
        ) from error
    try:
        result = work / "result"
        result.mkdir()
        warnings = make(target, compiler, defines, sources, work, result)
        (result / "warnings.txt").write_text(warnings, encoding="utf-8")
        try:
            result.rename(folder)
        except OSError:
            if not folder.exists():  # else another process was first, with the same bytes
                raise
    finally:
        shutil.rmtree(work, ignore_errors=True)


def make(
    target: Target, compiler: Toolchain, defines: tuple[str, ...], sources: list[Path], work: Path, result: Path
) -> str:
    """Compiles in `work`, links into `result`, and returns the warnings."""
    for path in sources:
        (work / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(SOURCES / path, work / path)
    names = {work: "firmware", Path(compiler.compile[0]).parent: "compiler"}
    # The first is for C; the second is what gcc passes on for assembly.
    maps = [f"-f{kind}-prefix-map={path}={name}" for path, name in names.items() for kind in ("file", "debug")]
    objects = {path.as_posix(): f"{path.as_posix()}.o" for path in sources if path.suffix in (".c", ".S")}

    flags = (*FLAGS, *defines, *maps, "-Iboard")

    def compile_one(path: str) -> str:
        whole = () if path == CALLED_BY_COMPILERS else compiler.whole
        return run(work, *compiler.compile, *flags, *whole, "-c", path, "-o", objects[path])[1]

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        warnings = "".join(threads.map(compile_one, objects))
    script = next(path.as_posix() for path in sources if path.suffix == ".ld")
    elf = f"{target.name}.elf"
    # Saved, what is made on the way has names that the map may tell. Each file has had its warnings; of all together
    # gcc believes that what one function fills and another reads may not be filled.
    made = ("-save-temps", "-Wno-maybe-uninitialized")
    whole = (*flags, *compiler.whole, *made) if compiler.whole else ()
    options = (*whole, "-nostartfiles", "-g", "-Wl,--gc-sections", "-Wl,--print-map", f"-Wl,-T,{script}", "-o", elf)
    printed, said = run(work, *compiler.compile, *options, *objects.values(), *compiler.link)
    shutil.move(work / elf, result / elf)
    (result / f"{target.name}.map").write_text(printed, encoding="utf-8")
    if target.name == "esp32":
        write_esp32(result / elf)
    else:
        write_binary(result / elf)
    return warnings + said


def run(folder: Path, *command: str) -> tuple[str, str]:
    """Its stdout and stderr. LocalError with the beginning of what it says when it fails."""
    own = str(cache().parent / "zig")
    variables = {**os.environ, "ZIG_GLOBAL_CACHE_DIR": own, "ZIG_LOCAL_CACHE_DIR": own, "LC_ALL": "C"}
    done = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        said = "\n".join(done.stderr.splitlines()[:MESSAGE_LINES])
        raise LocalError(f"{command[0]} cannot build the firmware; {TESTED} can:\n{said}")
    return done.stdout, done.stderr


def esptool_version() -> str:
    """Of the optional package that lays out images for the ESP32's boot ROM; empty if it is not installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("esptool")
    except PackageNotFoundError:
        return ""


def write_esp32(elf: Path) -> None:
    """As the boot ROM reads it from flash at 0x1000. Nothing without esptool."""
    if esptool_version():
        options = ("--chip", "esp32", "elf2image", "--output", elf.with_suffix(".bin").name, elf.name)
        run(elf.parent, sys.executable, "-m", "esptool", *options)
