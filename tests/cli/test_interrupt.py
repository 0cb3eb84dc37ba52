"""Ctrl-C while modules are loaded."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
AT = """
import os, signal, sys

class Loading:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Loading)
sys.argv = ["host", "stream", "--port", "sim://hover", "--json"]
from host.__main__ import main
sys.exit(main())
"""


@pytest.mark.parametrize(
    "module", ["host.cli", "argparse", "host.cli.doctor", "host.link.stream", "numpy", "_cffi_backend"]
)
def test_no_traceback_wherever_it_comes(module: str) -> None:
    command = [sys.executable, "-c", AT.format(module=module)]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=60)
    assert ended.stderr == ""
    assert ended.returncode == 130


def test_both_commands_begin_there() -> None:
    import tomllib

    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    assert scripts == {"host": "host.__main__:main", "spindeck": "host.__main__:main"}
