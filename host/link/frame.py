"""One image, complete or lost.

`arrival_host_ns` is as in records.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..protocol.errors import PeerError
from .headers import NanocockpitHeader, NativeHeader, PaperHeader

Encoding = Literal["raw", "jpeg"]

PAIR_DTYPE = np.dtype([("sequence", "<u4"), ("stm32_us", "<u8"), ("gap8_us", "<u8"), ("epoch", "u1")])
"""One stamp message as the GAP8 received it: its number, STM32 time in it, GAP8 time of its last stop bit."""


@dataclass(slots=True)
class Frame:
    """One complete image. `body` is the receiver's own memory: keep it as long as you like."""

    index: int
    """Complete frames received before this one, on earlier connections of the same stream too."""
    arrival_host_ns: int
    width: int
    height: int
    depth: int
    """Bytes per pixel."""
    encoding: Encoding
    body: NDArray[np.uint8]
    """Shape (bytes,): pixels row by row, or a JPEG file."""
    native: NativeHeader | None = None
    """Of a native frame."""
    pairs: NDArray[np.void] | None = None
    """dtype PAIR_DTYPE: the stamp messages that the GAP8 reported since the frame before; native only."""
    paper: PaperHeader | None = None
    """Of a frame from the dataset paper's firmware."""
    nanocockpit: NanocockpitHeader | None = None
    """Of a frame from NanoCockpit. A frame with none of the three is stock: it carries no time."""

    @property
    def dialect(self) -> Literal["stock", "paper", "nanocockpit", "native"]:
        """Which firmware sends such frames."""
        if self.native:
            return "native"
        if self.nanocockpit:
            return "nanocockpit"
        return "paper" if self.paper else "stock"

    @property
    def pixels(self) -> NDArray[np.uint8]:
        """Shape (height, width), or (height, width, depth). A JPEG is decoded at each call; PeerError if broken."""
        if self.encoding == "jpeg":
            return decode_jpeg(self.body, self.width, self.height)
        shape = (self.height, self.width) if self.depth == 1 else (self.height, self.width, self.depth)
        return self.body.reshape(shape)

    @property
    def frame_stm32_us(self) -> int | None:
        """Estimated STM32 time of the end of this frame, or None: native and paper only. NanoCockpit leaves that to
        whoever has many pairs of its state's two times."""
        if self.native:
            return self.native.frame_stm32_us
        return self.paper.frame_ms * 1000 if self.paper and self.paper.heard else None

    def row_before_end_us(self, row: float) -> float | None:
        """From the middle of a row's exposure to the end of frame, GAP8 time; row 0 is the top one, (height - 1) / 2
        the middle. None of frames that do not say how they were taken: all but native."""
        if not self.native:
            return None
        lines = self.height - 1 - row + self.native.exposure_lines / 2
        return lines * self.native.line_time_ns / 1000

    def row_stm32_us(self, row: float) -> float | None:
        """Estimated STM32 time of the middle of a row's exposure, by row_before_end_us; its bound is that of the end of
        frame. None without an estimate, or of frames that do not say how they were taken."""
        before_end_us = self.row_before_end_us(row)
        if self.native is None or self.native.frame_stm32_us is None or before_end_us is None:
            return None
        return self.native.frame_stm32_us - before_end_us * (self.stm32_per_gap8 or 1)

    @property
    def stm32_per_gap8(self) -> float | None:
        """How fast the STM32's clock runs on the GAP8's, as the GAP8 found it; None when it does not say."""
        return 1 + self.native.clock.skew_ppb * 1e-9 if self.native and self.native.clock else None


def decode_jpeg(body: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """Shape (height, width). PeerError when the file is damaged or of another size than its header said."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(body.tobytes()), formats=["JPEG"]) as image:
            if image.size != (width, height):
                raise PeerError(f"JPEG is {image.size[0]}x{image.size[1]}, its header said {width}x{height}")
            return np.asarray(image.convert("L"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise PeerError(f"JPEG cannot be decoded: {error}") from error


@dataclass(frozen=True, slots=True)
class LostFrame:
    """A frame that began and never came whole: what arrived is kept aside and is never shown as a picture."""

    arrival_host_ns: int
    cause: str
    """A key of SessionCounters.frames_lost."""
    received_bytes: int
    expected_bytes: int
    body: NDArray[np.uint8]
    """Shape (expected_bytes,): what came, zero elsewhere."""
    frame: int | None = None
    """native_frame_t.frame, when known."""
