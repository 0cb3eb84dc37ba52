"""The pictures that the cameras of a world show, as the kernel reads them: where they are, without copying them."""

from __future__ import annotations

import functools
from typing import Any

from host.native import ffi

from . import camera
from .settings import RobotSettings


@functools.lru_cache(maxsize=4)
def _scene(width: int, height: int, seed: int, quality: int) -> camera.Pictures:
    return camera.scene(width, height, seed, quality)


class Albums:
    """Robots with the same pictures share them. They must live as long as the kernel."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._albums: dict[tuple[str | int, ...], tuple[camera.Pictures, list[Any]]] = {}
        self._buffers: list[Any] = []

    def of(self, settings: RobotSettings) -> tuple[camera.Pictures, list[Any]]:
        """With the arrays of views, raw and JPEG, for kernel_set_images."""
        own = settings.camera
        key: tuple[str | int, ...]
        key = (settings.camera_path, own.quality) if settings.camera_path else (own.width, own.height, own.quality)
        if key not in self._albums:
            if settings.camera_path:
                pictures = camera.load(settings.camera_path, own.quality)
            else:
                pictures = _scene(own.width, own.height, self._seed, own.quality)
            views = []
            for bodies in (pictures.raw, pictures.jpeg):
                buffers = [ffi.from_buffer("uint8_t[]", body) for body in bodies]
                self._buffers += buffers
                views.append(ffi.new("bytes_t[]", [{"data": each, "size": len(each)} for each in buffers]))
            self._albums[key] = (pictures, views)
        return self._albums[key]

    def close(self) -> None:
        """After the kernel."""
        self._albums.clear()
        self._buffers.clear()
