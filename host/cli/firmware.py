"""`host firmware`: images for the three MCUs, from the same C that the simulator runs."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..protocol.errors import LocalError
from . import firmware_run

if TYPE_CHECKING:
    from ..firmware.build import Image
    from ..firmware.elf import Contents

TARGETS = ("stm32", "gap8", "esp32")
TOOLCHAINS = ("gcc", "zig")
OUTPUT = "spindeck-firmware"
FUNCTIONS_SHOWN = 10

COMPILERS = """\
compilers:
  gcc  stm32: arm-none-eabi-gcc, gap8: riscv64-unknown-elf-gcc, esp32: xtensa-lx106-elf-gcc (apt-get install
       gcc-arm-none-eabi gcc-riscv64-unknown-elf gcc-xtensa-lx106); pip install pyelftools
  zig  stm32 and gap8: pip install 'spindeck[firmware]'
  esptool (pip install esptool) lays the esp32's image out for its boot ROM; without it there is no esp32.bin
"""
BUILD_EXAMPLES = f"""\
{COMPILERS}
examples:
  host firmware build
  host firmware build --target stm32 --toolchain zig --output out
  host firmware build --target stm32 --stamp-divider 84        time messages at 84/85 of the right rate, as released
  host firmware build --json | jq '.functions[:3]'
"""
INFO_EXAMPLES = f"""\
{COMPILERS}
examples:
  host firmware info
  host firmware info spindeck-firmware/stm32.elf
  host firmware info --target esp32
"""


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Declares the commands and their options."""
    this = commands.add_parser("firmware", help="images for the STM32, the GAP8 and the ESP32")
    below = this.add_subparsers(dest="firmware_command", metavar="COMMAND", title="commands", required=True)
    build = below.add_parser(
        "build",
        help="compile and link images",
        description="Compile and link images: ELF, binary and map, and a table of what takes how much room. Equal "
        "sources and compilers give equal bytes. Only files of an earlier build are overwritten.",
        epilog=BUILD_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    common(build)
    build.add_argument("-o", "--output", default=OUTPUT, metavar="DIR", help=f"where to (default {OUTPUT})")
    build.add_argument("--stamp-divider", type=int, choices=[84, 85], help="of the stm32's time; 85 is right (default)")
    build.set_defaults(run=run_build)
    info = below.add_parser(
        "info",
        help="what an image is, what is in it, and what not to believe of it",
        description="What an image is, which compiler made it, what takes how much room, and what it cannot do. "
        "Without IMAGE: those that this computer can build.",
        epilog=INFO_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    info.add_argument("image", nargs="?", metavar="IMAGE", help="an ELF file of host firmware build")
    common(info)
    info.set_defaults(run=run_info)
    firmware_run.add_parser(below)


def common(parser: argparse.ArgumentParser) -> None:
    """Options of both."""
    add = parser.add_argument
    add("--target", choices=[*TARGETS, "all"], help="which MCU; all (default): each that has a compiler here")
    add("--toolchain", choices=TOOLCHAINS, help="the compiler (default: gcc where it is installed, else zig)")
    add("--functions", type=int, metavar="N", help=f"how many of the largest are listed (default {FUNCTIONS_SHOWN})")
    add("--json", action="store_true", help="JSON lines: an object for each image, with all functions")


def run_build(arguments: argparse.Namespace) -> int:
    """Builds, copies, and prints the table."""
    from ..firmware.elf import read
    from ..firmware.export import export

    defines = {} if arguments.stamp_divider is None else {"STM32_STAMP_DIVIDER": str(arguments.stamp_divider)}
    if defines and arguments.target != "stm32":
        raise LocalError("--stamp-divider is the stm32's: with --target stm32")
    for image in images(arguments, defines):
        files = export(image, Path(arguments.output))
        show(arguments, read(image.elf), image, files)
    return 0


def run_info(arguments: argparse.Namespace) -> int:
    """Reads one image, or builds what can be built, and tells all about it."""
    from ..firmware.elf import read

    if arguments.image is not None:
        if arguments.target or arguments.toolchain:
            raise LocalError("IMAGE says itself what it is: leave out --target and --toolchain")
        path = Path(arguments.image)
        show(arguments, read(path), None, [path], whole=True)
        return 0
    for image in images(arguments, {}):
        show(arguments, read(image.elf), image, image.files, whole=True)
    return 0


def images(arguments: argparse.Namespace, defines: dict[str, str]) -> list[Image]:
    """The chosen ones. Of all, those without a compiler here are left out and named; LocalError if none is left."""
    from ..firmware.build import build

    if arguments.target not in (None, "all"):
        return [warned(build(arguments.target, arguments.toolchain, defines))]
    from ..firmware.targets import target_of
    from ..firmware.toolchains import MissingError, find

    made: list[Image] = []
    for name in TARGETS:
        try:
            find(target_of(name), arguments.toolchain)
        except MissingError as error:
            if name == TARGETS[-1] and not made:
                raise
            print(f"host: left out: {error}", file=sys.stderr)
            continue
        made.append(warned(build(name, arguments.toolchain, defines)))
    return made


def warned(image: Image) -> Image:
    """Passes on what the compiler has complained about."""
    if image.warnings:
        print(image.warnings, end="", file=sys.stderr)
    return image


def show(
    arguments: argparse.Namespace, contents: Contents, image: Image | None, files: list[Path], whole: bool = False
) -> None:
    """One image, for a program or for people."""
    if arguments.json:
        from . import as_json

        print(as_json.line(record(contents, image, files)))
        return
    target = contents.target
    print(f"{target.name}: {target.part}")
    print(f"  {files[0]}{''.join(f' {path.suffix}' for path in files[1:])}")
    print(f"  compiler: {image.toolchain.version if image else contents.compiler}")
    for use in contents.uses:
        print(f"  {use.memory:<8} {use.bytes:>9,} of {use.of_bytes:>9,} bytes  {use.bytes / use.of_bytes:>4.0%}")
    print(f"  to load: {contents.load_bytes:,} bytes; reserved for the stack: {contents.stack_bytes:,}")
    if whole:
        print(f"  entry 0x{contents.entry:08x}")
        print("  sections:")
        for section in contents.sections:
            print(f"    0x{section.address:08x} {section.bytes:>9,}  {section.name}")
        print("  symbols:")
        for name, address in contents.symbols.items():
            print(f"    0x{address:08x}  {name}")
    print_functions(contents, FUNCTIONS_SHOWN if arguments.functions is None else max(0, arguments.functions))
    for limit in target.limits if whole else ():
        print(f"  NOTE: {limit}")


def print_functions(contents: Contents, shown: int) -> None:
    """The largest, and what is left."""
    if shown:
        print("  functions, largest first:")
    for function in contents.functions[:shown]:
        print(f"    {function.bytes:>9,}  {function.name}")
    rest = contents.functions[shown:]
    if rest:
        print(f"    {sum(function.bytes for function in rest):>9,}  in {len(rest)} more")


def record(contents: Contents, image: Image | None, files: list[Path]) -> dict[str, Any]:
    """One image, for a program."""
    of = {path.suffix[1:]: str(path) for path in files}
    return {
        "event": "image",
        "target": contents.target.name,
        "part": contents.target.part,
        "toolchain": image.toolchain.name if image else None,
        "compiler": image.toolchain.version if image else contents.compiler,
        "elf": of.get("elf") or str(files[0]),
        "bin": of.get("bin"),
        "map": of.get("map"),
        "entry": contents.entry,
        "load_bytes": contents.load_bytes,
        "stack_bytes": contents.stack_bytes,
        "memories": [asdict(use) for use in contents.uses],
        "sections": [asdict(section) for section in contents.sections],
        "functions": [asdict(function) for function in contents.functions],
        "symbols": contents.symbols,
        "limits": list(contents.target.limits),
    }
