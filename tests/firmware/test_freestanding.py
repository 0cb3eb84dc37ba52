"""The firmware is freestanding C11: it compiles without a warning, keeps no state of its own, and calls only string.h.

What it may include is checked in tests/test_layers.py.
"""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted(ROOT.glob("firmware/*/*.c"))
WARNINGS = ["-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wpedantic", "-Wstrict-prototypes", "-Werror"]
# Some distributions' compilers add calls of their own.
NO_ADDITIONS = ["-fno-stack-protector", "-U_FORTIFY_SOURCE"]
FLAGS = ["-std=c11", "-O2", "-ffreestanding", "-ffp-contract=off", *NO_ADDITIONS, *WARNINGS]
# Of string.h: each board brings these.
FROM_OUTSIDE = {"memchr", "memcmp", "memcpy", "memmove", "memset", "strlen"}
COMPILERS = [name for name in ("gcc", "clang", "clang-19") if shutil.which(name)]


def compile_(compiler: str, source: Path, folder: Path) -> Path:
    compiled = folder / f"{source.parent.name}-{source.stem}.o"
    result = subprocess.run(
        [compiler, *FLAGS, "-c", source, "-o", compiled], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    return compiled


def symbols(compiled: list[Path]) -> list[tuple[str, str]]:
    """Kind (as nm's letters) and name."""
    result = subprocess.run(["nm", "--no-sort", *compiled], capture_output=True, text=True, check=True)
    return [(words[-2], words[-1]) for words in map(str.split, result.stdout.splitlines()) if len(words) >= 2]


def faults(found: list[tuple[str, str]]) -> list[str]:
    defined = {name for kind, name in found if kind in "Tt"}
    state = [f"{name} is state outside any struct" for kind, name in found if kind in "BbDdCSs"]
    calls = [f"{name} comes from outside" for kind, name in found if kind == "U" and name not in defined | FROM_OUTSIDE]
    return sorted(state + calls)


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("source", SOURCES, ids=lambda source: f"{source.parent.name}/{source.name}")
def test_compiles_without_a_warning(source: Path, compiler: str, tmp_path: Path) -> None:
    compile_(compiler, source, tmp_path)


@pytest.mark.parametrize("compiler", COMPILERS)
def test_keeps_no_state_and_calls_only_string_h(compiler: str, tmp_path: Path) -> None:
    found = symbols([compile_(compiler, source, tmp_path) for source in SOURCES])
    assert {"cpx_route_encode", "crc32_zlib"} <= {name for kind, name in found if kind == "T"}
    assert faults(found) == []


def test_state_and_calls_would_be_found(tmp_path: Path) -> None:
    source = tmp_path / "bad.c"
    source.write_text(
        "static int counter; static int start = 3; int puts(const char *); int next(void);"
        'int next(void) { puts("x"); counter += start; return start++ + counter++; }'
    )
    found = faults(symbols([compile_("gcc", source, tmp_path)]))
    assert found == [
        "counter is state outside any struct",
        "puts comes from outside",
        "start is state outside any struct",
    ]
