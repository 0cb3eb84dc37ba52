"""The import table of docs/DESIGN.md ("Who may import whom") as a test."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PYTHON = [
    path
    for folder in ("host", "sim")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if "build" not in path.relative_to(ROOT).parts[:1]
]

# Module prefix -> what of host and sim it may import, and what it may never import from outside.
IO = {"socket", "time", "threading", "serial", "asyncio", "select", "subprocess"}
RULES: list[tuple[str, set[str], set[str]]] = [
    ("host.native.build", set(), IO | {"numpy"}),
    ("host.native", {"host.native", "host.protocol.errors"}, IO | {"numpy"}),
    ("host.protocol.errors", set(), IO | {"numpy"}),
    ("host.protocol.spec", {"host.protocol.spec"}, IO | {"numpy"}),
    ("host.protocol.dissect", {"host.protocol.spec", "host.protocol.dissect"}, IO | {"numpy"}),
    ("host.protocol.explain", {"host.protocol.spec", "host.protocol.dissect"}, IO | {"numpy"}),
    ("host.protocol", {"host.protocol.packets", "host.protocol.codec", "host.protocol.errors", "host.native"}, IO),
    ("host.link.stream", {"host.link", "host.protocol", "host.native"}, set()),
    *(
        (f"host.link.{name}", {"host.link", "host.protocol", "host.native"}, set())
        for name in (
            "access",
            "discovery",
            "ports",
            "recording",
            "recover",
            "replay",
            "replay_server",
            "restamp",
            "serial",
        )
    ),
    (
        "host.link",
        {
            "host.link.records",
            "host.link.frame",
            "host.link.headers",
            "host.link.counters",
            "host.link.assemble",
            "host.link.dialects",
            "host.link.expected",
            "host.link.pairs",
            "host.link.session",
        }
        | {"host.protocol", "host.native"}
        | {
            "host.link.finding",
            "host.link.listening",
            "host.link.rules",
            "host.link.rules_of_log",
            "host.link.rules_of_time",
        }
        | {"host.link.mcap", "host.link.mcap_summary", "host.link.foxglove"},
        IO,
    ),
    ("host.firmware", {"host.firmware", "host.protocol.errors"}, IO - {"subprocess"} | {"numpy"}),
    ("host.radio.dongle", {"host.radio", "host.protocol"}, set()),
    ("host.radio", {"host.radio", "host.protocol", "host.native"}, IO | {"usb"}),
    ("host.usd", {"host.usd", "host.native", "host.protocol.errors"}, IO),
    ("host.clock", {"host.clock", "host.native", "host.protocol.errors"}, IO),
    ("host.cli", {"host", "sim"}, set()),
    ("host.__main__", {"host.cli"}, set()),
    ("host", {"host.link", "host.protocol"}, set()),
    ("sim.images", {"sim", "host.native", "host.protocol", "host.firmware"}, IO | {"random"}),
    ("sim.serial", {"sim", "host.native", "host.protocol", "host.link.access"}, set()),
    (
        "sim",
        {"sim", "host.native", "host.protocol", "host.link.session"}
        | {"host.link.records", "host.link.frame", "host.link.counters"},
        IO | {"random"},
    ),
]


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path: Path) -> set[str]:
    """Every module that the file imports, absolute, wherever in the file, but not under TYPE_CHECKING."""
    package = module_name(path) if path.name == "__init__.py" else module_name(path).rpartition(".")[0]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            node.body = []
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            stem = ".".join([*base, *([node.module] if node.module else [])])
            # `from . import x` and `from .x import y`: either may be a module.
            found |= {stem} if node.module else set()
            found |= {f"{stem}.{alias.name}" for alias in node.names if is_module(f"{stem}.{alias.name}")}
    return found


def is_module(name: str) -> bool:
    path = ROOT / Path(*name.split("."))
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


def within(name: str, prefixes: set[str]) -> bool:
    return any(name == prefix or name.startswith(prefix + ".") for prefix in prefixes)


@pytest.mark.parametrize("path", PYTHON, ids=lambda path: module_name(path))
def test_python_layers(path: Path) -> None:
    name = module_name(path)
    _, allowed, never = next(rule for rule in RULES if within(name, {rule[0]}))
    for found in imports(path):
        if within(found, {"host", "sim"}):
            assert within(found, allowed), f"{name} may not import {found}"
        else:
            assert not within(found, never), f"{name} may not import {found}"


def test_specification_shares_nothing_with_the_c() -> None:
    for path in sorted((ROOT / "host/protocol/spec").glob("*.py")):
        outside = {name.split(".")[0] for name in imports(path)} - {"host"}
        assert outside <= {"construct", "crcmod", "typing", "collections", "pathlib", "sys", "argparse", "re",
                           "dataclasses", "__future__"}, path  # fmt: skip


STANDARD = {"stdint.h", "stddef.h", "stdbool.h", "string.h"}


@pytest.mark.parametrize("path", sorted((ROOT / "firmware").rglob("*.[ch]")), ids=lambda path: path.name)
def test_firmware_layers(path: Path) -> None:
    folder = path.relative_to(ROOT).parts[1]
    for bracket, included in re.findall(r'^\s*#\s*include\s*([<"])([^>"]+)', path.read_text(encoding="utf-8"), re.M):
        if bracket == "<":
            assert included in STANDARD, f"{path}: firmware is freestanding"
        else:
            target = (path.parent / included).resolve().relative_to(ROOT).parts
            allowed = {("firmware", "core"), ("firmware", "board"), ("firmware", folder)}
            assert target[:2] in allowed, f"{path} includes {included}"
            assert "board" in path.parts or "board" not in target, f"{path} knows its board: {included}"


# Folder -> what of the project its C may include.
SIMULATOR = {
    "sim/emulator": {"firmware/core", "sim/emulator"},
    "sim/kernel": {"firmware/core", "firmware/stm32", "firmware/gap8", "firmware/esp32", "sim/emulator", "sim/kernel"},
}


@pytest.mark.parametrize("folder", SIMULATOR)
def test_simulator_layers(folder: str) -> None:
    for path in sorted((ROOT / folder).rglob("*.[ch]")):
        text = path.read_text(encoding="utf-8")
        for bracket, included in re.findall(r'^\s*#\s*include\s*([<"])([^>"]+)', text, re.M):
            if bracket == "<":
                assert included not in {"time.h", "sys/time.h", "unicorn/unicorn.h"}, f"{path} includes {included}"
            else:
                target = (path.parent / included).resolve().relative_to(ROOT).parent.as_posix()
                assert any(f"{target}/".startswith(f"{each}/") for each in SIMULATOR[folder]), f"{path}: {included}"


def test_no_file_is_called_by_a_word_that_says_nothing() -> None:
    for path in PYTHON:
        assert not {"utils", "common", "misc", "helpers", "manager"} & set(module_name(path).split("."))
