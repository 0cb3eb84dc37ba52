"""Captured bytes, piece by piece, from the specification alone: construct decodes, nothing of the C is used.

Every byte of the capture is in exactly one piece, whatever the bytes are. Where a piece begins is found as the
receivers of docs/PROTOCOL.md find it; since a capture is all there, a place is only believed when what follows fits.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator

from .lines import split_checked, stamp_piece, uart_piece
from .links import CPX, NANOCOCKPIT, split_spi, split_tcp
from .piece import Framing, Piece

GUESS_BYTES = 1 << 15
SPI_WORD = 4
MEANT = ("packet", "credit", "stamp")
"""Kinds that chance does not make."""

SPLITTERS: dict[Framing, Callable[[bytes], Iterator[Piece]]] = {
    "tcp": lambda data: split_tcp(CPX, data),
    "nanocockpit": lambda data: split_tcp(NANOCOCKPIT, data),
    "cpx-uart": lambda data: split_checked(data, uart_piece),
    "stamps": lambda data: split_checked(data, stamp_piece),
    "spi": lambda data: split_spi(CPX, data),
    "nanocockpit-spi": lambda data: split_spi(NANOCOCKPIT, data),
}


def split(data: bytes, framing: Framing) -> Iterator[Piece]:
    """The pieces in their order, without a gap."""
    return SPLITTERS[framing](data)


def guess(data: bytes, among: Iterable[Framing] = tuple(SPLITTERS)) -> tuple[Framing, float]:
    """The framing that explains most of the first bytes, and what part of them it explains.

    Packets and messages count for it, garbage against it: an SPI may be idle throughout, and a capture shorter than its
    first packet. Zeros at the start, which may be many on an idle SPI, are left out.
    """
    zeros = len(data) - len(data.lstrip(b"\0"))
    head = data[zeros - zeros % SPI_WORD :][:GUESS_BYTES] if zeros < len(data) else data[:GUESS_BYTES]
    sizes = {framing: sizes_by_kind(head, framing) for framing in among}
    meant = {framing: sum(size[kind] for kind in MEANT) for framing, size in sizes.items()}
    best = max(sizes, key=lambda framing: meant[framing] - sizes[framing]["garbage"])  # the first of equals
    cut = 0 if meant[best] else sizes[best]["truncated"]
    return best, (meant[best] + sizes[best]["idle"] + cut) / max(1, len(head))


def sizes_by_kind(data: bytes, framing: Framing) -> Counter[str]:
    """Bytes."""
    sizes = Counter[str]()
    for piece in split(data, framing):
        sizes[piece.kind] += piece.size
    return sizes
