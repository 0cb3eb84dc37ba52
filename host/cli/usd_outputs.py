"""What a command makes of several logs: a file of each in a folder, named after the log."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from ..protocol.errors import LocalError, PeerError


def one_by_one(names: Iterable[str], command: Callable[[str], int]) -> int:
    """Whatever is wrong with one, the others have their turn. 2 if one could not be read, else the highest code."""
    codes = {0}
    for name in names:
        try:
            codes.add(command(name))
        except (LocalError, PeerError) as error:
            print(f"host: {error}", file=sys.stderr)
            codes.add(2 if isinstance(error, LocalError) else 4)
    return 2 if 2 in codes else max(codes)


def outputs(logs: Sequence[str], output: str, ending: str) -> dict[str, str]:
    """By log. `output` is a folder if it is one already or ends in a slash. LocalError if it is none and there are
    several, or two would be one file."""
    folder = Path(output)
    is_folder = output.endswith("/") or folder.is_dir()
    if len(logs) == 1 and not is_folder:
        return {logs[0]: output}
    if not is_folder:
        raise LocalError(f"{output}: one file, and there are {len(logs)} logs: name a folder, as {output}.d/")
    made = {log: str(folder / f"{Path(log).name}{ending}") for log in dict.fromkeys(logs)}
    twice = [name for name, count in Counter(made.values()).items() if count > 1]
    if twice:
        raise LocalError(f"{twice[0]}: of several logs of this name: give them one by one, each with its -o")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise LocalError(f"{output}: {error.strerror}") from error
    return made


def is_same(output: str, log: str) -> bool:
    return Path(output).exists() and Path(log).exists() and Path(output).samefile(log)
