"""Pictures for the simulated camera: a built-in moving scene, or a user's own files. Each is kept raw and as JPEG."""

from __future__ import annotations

import functools
import io
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from host.protocol.errors import LocalError

SCENE_PICTURES = 16
SIDE_MAX = 1024
"""IMAGE_SIDE_MAX of firmware/core/image.h."""
MEMORY_BYTES_MAX = 256 << 20
SUFFIXES = (".pgm", ".png", ".ppm")
FORMATS = ("PNG", "PPM")
"""Pillow's names; PPM is all of the PNM family."""


@dataclass(frozen=True)
class Pictures:
    width: int
    height: int
    raw: tuple[bytes, ...]
    jpeg: tuple[bytes, ...]

    @functools.cached_property
    def numbers(self) -> dict[int, list[int]]:
        """By the CRC-32 of a body, the pictures that have it."""
        found: dict[int, list[int]] = {}
        for bodies in (self.raw, self.jpeg):
            for number, body in enumerate(bodies):
                found.setdefault(zlib.crc32(body), []).append(number)
        return found


def scene(width: int, height: int, seed: int, quality: int) -> Pictures:
    """A floor, a bright drone that crosses it, and the picture's number as a row of squares in the top left corner."""
    rng = np.random.default_rng(seed)
    texture = rng.integers(0, 24, (height, width), dtype=np.uint8)
    return _encoded(((f"picture {index}", _scene_picture(texture, index)) for index in range(SCENE_PICTURES)), quality)


def _scene_picture(texture: NDArray[np.uint8], index: int) -> NDArray[np.uint8]:
    height, width = texture.shape
    rows, columns = np.mgrid[0:height, 0:width]
    picture: NDArray[np.uint8] = texture + (40 + 100 * rows / height).astype(np.uint8)
    angle = 2 * np.pi * index / SCENE_PICTURES
    arm = max(2, min(width, height) // 8)
    across = columns - width * (0.5 + 0.3 * np.cos(angle))
    down = rows - height * (0.5 + 0.3 * np.sin(angle))
    # Two arms, seen from above, at 45 degrees.
    thin = max(1.0, arm / 5)
    near = np.maximum(np.abs(across), np.abs(down)) <= arm
    picture[near & ((np.abs(across - down) <= thin) | (np.abs(across + down) <= thin))] = 240
    side = max(1, min(width, height) // 20)
    for bit in range(4):
        picture[:side, bit * side : (bit + 1) * side] = 255 if index >> bit & 1 else 0
    return picture


def load(path: str, quality: int) -> Pictures:
    """A file, or all PGM, PPM and PNG files of a folder, by name. LocalError names the file that cannot be used."""
    place = Path(path)
    if place.is_dir():
        files = sorted(each for each in place.iterdir() if each.suffix.lower() in SUFFIXES)
        if not files:
            raise LocalError(f"camera {path}: no {', '.join(SUFFIXES)} in this folder")
    elif place.exists():
        files = [place]
    else:
        raise LocalError(f"camera {path}: no such file or folder")
    return _encoded(((str(file), _read(file)) for file in files), quality)


def _read(file: Path) -> NDArray[np.uint8]:
    try:
        with Image.open(file, formats=FORMATS) as image:
            if max(image.size) > SIDE_MAX:
                raise LocalError(f"camera {file}: {image.size[0]}x{image.size[1]}, at most {SIDE_MAX} on either side")
            # Pillow clips wider pixels to 255 without a word.
            if image.mode not in ("1", "L", "LA", "P", "RGB", "RGBA"):
                raise LocalError(f"camera {file}: pixels of mode {image.mode}; save it with 8 bits per channel")
            return np.asarray(image.convert("L"))
    except UnidentifiedImageError:
        raise LocalError(f"camera {file}: not a PGM, PPM or PNG file") from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise LocalError(f"camera {file}: {error}") from error


def _encoded(pictures: Iterable[tuple[str, NDArray[np.uint8]]], quality: int) -> Pictures:
    raw, jpeg = [], []
    size: tuple[int, int] | None = None
    memory_bytes = 0
    for name, picture in pictures:
        size = size or (picture.shape[1], picture.shape[0])
        if picture.shape != (size[1], size[0]):
            raise LocalError(
                f"camera {name}: {picture.shape[1]}x{picture.shape[0]}, but the pictures before it are "
                f"{size[0]}x{size[1]}; all must have one size"
            )
        raw.append(picture.tobytes())
        jpeg.append(_jpeg(picture, quality))
        memory_bytes += len(raw[-1]) + len(jpeg[-1])
        if memory_bytes > MEMORY_BYTES_MAX:
            raise LocalError(
                f"camera {name}: the {len(raw)} pictures up to here take more than {MEMORY_BYTES_MAX >> 20} MiB; "
                "give fewer or smaller ones"
            )
    assert size is not None
    return Pictures(size[0], size[1], tuple(raw), tuple(jpeg))


def _jpeg(picture: NDArray[np.uint8], quality: int) -> bytes:
    out = io.BytesIO()
    Image.fromarray(picture).save(out, "JPEG", quality=quality)
    return out.getvalue()


def scene_number(picture: NDArray[np.uint8]) -> int:
    """The number that a picture of the built-in scene shows, raw or decoded from JPEG."""
    side = max(1, min(picture.shape) // 20)
    middle = side // 2
    return sum(int(picture[middle, bit * side + middle] > 128) << bit for bit in range(4))
