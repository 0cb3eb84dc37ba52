"""Frames on disk: one picture each, one JSON line each. Nothing that is there is ever overwritten."""

from __future__ import annotations

from pathlib import Path
from typing import IO, TYPE_CHECKING

from ..protocol.errors import LocalError, PeerError
from .as_json import as_dict, line

if TYPE_CHECKING:
    from ..link.frame import Frame, LostFrame
    from .row import Row


class Keeper:
    """Writes the frames of one robot into its own folder.

    A raw frame becomes a PGM (PPM for colour), a JPEG stays as it came. Frames that came damaged go to `broken/` as
    they are, and are never given a picture's name. frames.jsonl has one line for each of both, flushed at once.
    """

    def __init__(self, folder: Path, robot: int, row: Row | None = None) -> None:
        folder.mkdir(exist_ok=True)
        self.folder = folder
        self.robot = robot
        self.row = row
        self.lost = 0
        self.index: IO[str] = (folder / "frames.jsonl").open("x", encoding="utf-8")

    def frame(self, frame: Frame) -> None:
        """Writes the picture, then its line: a line never names a picture that is not there."""
        stem = f"{frame.index:06d}"
        if frame.encoding == "jpeg":
            name = f"{stem}.jpg"
            content = frame.body.tobytes()
        elif frame.depth in (1, 3):
            name = f"{stem}.{'pgm' if frame.depth == 1 else 'ppm'}"
            magic = b"P5" if frame.depth == 1 else b"P6"
            content = b"%s\n%d %d\n255\n" % (magic, frame.width, frame.height) + frame.body.tobytes()
        else:
            name = f"{stem}.raw"
            content = frame.body.tobytes()
        self.write(name, content, as_dict(frame, self.robot, self.row))

    def broken(self, lost: LostFrame) -> None:
        """Keeps what came of a lost frame."""
        (self.folder / "broken").mkdir(exist_ok=True)
        self.write(f"broken/{self.lost:06d}.bin", lost.body.tobytes(), as_dict(lost, self.robot))
        self.lost += 1

    def write(self, name: str, content: bytes, record: dict[str, object]) -> None:
        """One file that must be new, and its line."""
        try:
            with (self.folder / name).open("xb") as file:
                file.write(content)
            self.index.write(line({"image": name, **record}) + "\n")
            self.index.flush()
        except OSError as error:
            raise LocalError(f"{self.folder / name}: {error.strerror}; what was written before is complete") from error

    def close(self) -> None:
        """Closes the index; the pictures are closed already."""
        self.index.close()


def save_picture(frame: Frame, path: Path) -> None:
    """The frame as PNG. PeerError if it is a JPEG that cannot be decoded, LocalError if the file cannot be written."""
    from PIL import Image

    try:
        with path.open("xb") as file:
            Image.fromarray(frame.pixels).save(file, format="PNG")
    except PeerError:
        path.unlink()
        raise
    except FileExistsError as error:
        raise LocalError(f"--picture {path}: exists, and nothing is ever overwritten: name another file") from error
    except OSError as error:
        raise LocalError(f"--picture {path}: {error.strerror}") from error
