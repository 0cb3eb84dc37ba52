"""ChaN FatFs, the file system of the Crazyflie's firmware, from the package fatfs-ng: one of its own for each card."""

from __future__ import annotations

import datetime
import importlib.machinery
import importlib.util
import shutil
import tempfile
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

from host.protocol.errors import LocalError

from .card_sectors import Sectors

DRIVE = b"0:"
READ, WRITE, CREATE_NEW, CREATE_ALWAYS = 0x01, 0x02, 0x04, 0x08
OK, NOT_READY, NO_FILE, NO_PATH, DENIED, EXISTS = 0, 3, 4, 5, 7, 8
DISK_ERROR = 1
DATE = datetime.datetime(2026, 1, 1)
"""Of every file: a robot has no calendar, and equal runs give equal cards."""

_idle: list[ModuleType] = []


def load() -> ModuleType:
    """The package has one volume in one set of variables, so each card needs a copy of its library."""
    if _idle:
        return _idle.pop()
    try:
        spec = importlib.util.find_spec("fatfs.wrapper")
    except ModuleNotFoundError:
        spec = None
    if spec is None or spec.origin is None:
        raise LocalError("a simulated card needs fatfs-ng: pip install 'spindeck[card]'")
    with tempfile.TemporaryDirectory() as folder:
        copy = str(Path(folder) / Path(spec.origin).name)
        shutil.copyfile(spec.origin, copy)
        loader = importlib.machinery.ExtensionFileLoader("fatfs.wrapper", copy)
        copied = importlib.util.spec_from_loader("fatfs.wrapper", loader, origin=copy)
        assert copied is not None
        module = importlib.util.module_from_spec(copied)
        loader.exec_module(module)
    # FatFs writes to the volume mounted before: so there is never another one.
    vars(module)["volume"] = module.FATFS_Handle()
    vars(module)["datetime"] = SimpleNamespace(datetime=SimpleNamespace(now=lambda: DATE))
    return module


def give_back(module: ModuleType) -> None:
    """For the next card: a library cannot be unloaded."""
    vars(module)["__diskio_wrapper_disks"] = {}
    _idle.append(module)


class FatFs:
    """A mounted volume. Each method gives FatFs's result first; `OK` is none of its errors."""

    def __init__(self, module: ModuleType, disk: Sectors) -> None:
        vars(module)["__diskio_wrapper_disks"] = disk
        self._library: Any = module
        self._disk = disk
        self.mounted, _ = self._call("pyf_mount", module.volume, DRIVE, 1)

    def open(self, name: bytes, mode: int) -> tuple[int, Any]:
        file = self._library.FIL_Handle()
        return self._call("pyf_open", file, DRIVE + name, mode)[0], file

    def read(self, file: Any, size: int) -> tuple[int, bytes]:
        result, data = self._call("pyf_read", file, size)
        return result, data or b""

    def write(self, file: Any, data: bytes) -> tuple[int, int]:
        result, written = self._call("pyf_write", file, data)
        return result, written or 0

    def seek(self, file: Any, place: int) -> int:
        return self._call("pyf_lseek", file, place)[0]

    def truncate(self, file: Any) -> int:
        return self._call("pyf_truncate", file)[0]

    def sync(self, file: Any) -> int:
        return self._call("pyf_sync", file)[0]

    def close(self, file: Any) -> int:
        return self._call("pyf_close", file)[0]

    def remove(self, name: bytes) -> int:
        return self._call("pyf_unlink", DRIVE + name)[0]

    def _call(self, function: str, *arguments: Any) -> tuple[int, Any]:
        self._disk.failed = ""
        try:
            found = getattr(self._library, function)(*arguments)
        except self._library.FatFSException as error:
            return error.code, None
        if self._disk.failed:
            return DISK_ERROR, None
        return found if isinstance(found, tuple) else (found, None)
