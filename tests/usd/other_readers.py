"""What others read from a card: mtools, pyfatfs, and what fsck.fat says of it. Tests skip what is not installed."""

import subprocess
import warnings
from pathlib import Path

import pytest

UTF8 = {"PATH": "/usr/bin:/bin:/usr/sbin:/sbin", "LC_ALL": "C.UTF-8"}


def run(*command) -> str:
    done = subprocess.run(command, capture_output=True, text=True, env=UTF8)
    assert done.returncode == 0, (command, done.stdout, done.stderr)
    return done.stdout


def by_mtools(image: Path, offset: int, name: str) -> bytes:
    done = subprocess.run(["mtype", "-i", f"{image}@@{offset}", f"::{name}"], capture_output=True, env=UTF8)
    assert done.returncode == 0, done.stderr
    return done.stdout


def by_pyfatfs(image: Path, offset: int, names: list[str]) -> dict[str, bytes]:
    """Through its lower half: the upper one needs a setuptools of 2024."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        package = pytest.importorskip("pyfatfs.PyFat", reason="pyfatfs is not installed: pip install pyfatfs")
        volume = package.PyFat(offset=offset)
        volume.open(str(image), read_only=True)
    try:
        found = {}
        for name in names:
            entry = entry_of(volume, name)
            clusters = volume.get_cluster_chain(entry.get_cluster()) if entry.filesize else []
            found[name] = b"".join(map(volume.read_cluster_contents, clusters))[: entry.filesize]
        return found
    finally:
        volume.close()


def entry_of(volume, path: str):
    """pyfatfs shows short names in upper case, and wants names as it shows them."""
    found = volume.root_dir
    for name in path.strip("/").split("/"):
        shown = {each.get_short_name().lower(): each for part in found.get_entries() for each in part}
        found = shown.get(name.lower()) or found.get_entry(name)
    return found
