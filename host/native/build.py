"""Builds host.native._native: the firmware's C, the simulator's kernel and the stream splitter, through cffi.

The declarations that Python sees are cut out of the C headers themselves, so that they cannot disagree; what the
compiler knows better (enum values, struct layout) it supplies in API mode.
SPINDECK_CFLAGS and SPINDECK_LDFLAGS add flags: the sanitized build of CI uses them.
"""

import os
import re
import shlex
from pathlib import Path

from cffi import FFI

ROOT = Path(__file__).resolve().parents[2]

# In the order of their includes.
HEADERS = [
    "firmware/core/bytes.h",
    "firmware/core/checks.h",
    "firmware/core/cpx.h",
    "firmware/core/beacon.h",
    "firmware/core/cpx_uart.h",
    "firmware/core/cpx_link.h",
    "firmware/core/stamp.h",
    "firmware/core/echo.h",
    "firmware/core/clock.h",
    "firmware/core/image.h",
    "firmware/core/native_log.h",
    "firmware/core/paper.h",
    "firmware/core/nanocockpit.h",
    "firmware/core/uart1.h",
    "firmware/core/usd_config.h",
    "firmware/core/usd_file.h",
    "firmware/core/usd_log.h",
    "firmware/stm32/storage.h",
    "firmware/stm32/log.h",
    "firmware/stm32/motion.h",
    "firmware/stm32/values.h",
    "firmware/stm32/crtp_log.h",
    "firmware/stm32/app.h",
    "firmware/gap8/app.h",
    "firmware/esp32/app.h",
    "sim/emulator/unicorn.h",
    "sim/emulator/emulator.h",
    "sim/kernel/kernel.h",
    "host/native/stream.h",
    "host/native/clock_run.h",
    "host/native/crc32.h",
    "host/native/usd.h",
    "host/native/track.h",
]
SOURCE_FOLDERS = [
    *["firmware/core", "firmware/stm32", "firmware/gap8", "firmware/esp32"],
    *["sim/emulator", "sim/kernel", "host/native"],
]

FREESTANDING = ["-std=c11", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion"]


def declarations(header: str) -> str:
    """The part of a C header that cffi can read: no preprocessor lines, no comments, no inline functions."""
    text = re.sub(r"/\*.*?\*/", "", header, flags=re.DOTALL)
    text = re.sub(r"//.*", "", text)
    text = re.sub(r"^[ \t]*#.*(?:\\\n.*)*$", "", text, flags=re.MULTILINE)
    text = re.sub(r"^static inline [^{;]*\{(?:.*\}$|.*?^\})", "", text, flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"^_Static_assert.*?;$", "", text, flags=re.MULTILINE)


def sources() -> list[str]:
    """The project's C files (not the file that cffi writes), relative to the root, in a fixed order."""
    return [
        path.relative_to(ROOT).as_posix()
        for folder in SOURCE_FOLDERS
        for path in sorted((ROOT / folder).glob("*.c"))
        if not path.name.startswith("_")
    ]


ffibuilder = FFI()
for name in HEADERS:
    ffibuilder.cdef(declarations((ROOT / name).read_text(encoding="utf-8")))
# Called by the kernel; sim/storage.py says what it does.
ffibuilder.cdef(
    """
extern "Python" int64_t storage_request(void *context, int64_t now_ns, const uint8_t *request, size_t request_size,
                                        uint8_t *answer, size_t *answer_size);
"""
)
ffibuilder.set_source(
    "host.native._native",
    "".join(f'#include "{name}"\n' for name in HEADERS),
    sources=sources(),
    include_dirs=["."],
    depends=[path.relative_to(ROOT).as_posix() for folder in SOURCE_FOLDERS for path in (ROOT / folder).glob("*.h")],
    # Nothing but the module's entry is called from outside: calls between the files need no table.
    extra_compile_args=[*FREESTANDING, "-fvisibility=hidden", *shlex.split(os.environ.get("SPINDECK_CFLAGS", ""))],
    extra_link_args=["-pthread", *shlex.split(os.environ.get("SPINDECK_LDFLAGS", ""))],
)

if __name__ == "__main__":
    os.chdir(ROOT)
    ffibuilder.compile(verbose=False)
