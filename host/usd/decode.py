"""A whole log, from its bytes. Never an exception for what is in them."""

from __future__ import annotations

from dataclasses import replace
from mmap import mmap

from .blocks import decode_blocks
from .header import Header, HeaderError, read_header
from .headerless import borrowed
from .log import ByteRange, Damage, Log
from .pieces import Piece, epochs_of, rows_of, take
from .recover import Recovered, merged, recover
from .rows import CRC_BYTES, RowReader, Walk, filling

Buffer = bytes | bytearray | memoryview | mmap


def decode(source: Buffer, header_of: Buffer | None = None) -> Log:
    """Everything that can be trusted in the bytes of a file (or of an mmap of it), which are not kept. `header_of`: of
    a log of the same configuration; the rows are read as its rows, whatever the file begins with."""
    data = memoryview(source).cast("B")
    if header_of is not None:
        return decode_rows(data, borrowed(data, memoryview(header_of).cast("B")))
    if len(data) and data[0] == 0:
        return nothing(data, 0, filling(data) or "not a log: it begins with 0x00")
    if log := decode_blocks(data):
        return log
    try:
        header = read_header(data)
    except HeaderError as error:
        return nothing(data, error.at, error.why)
    return decode_rows(data, header)


def decode_rows(data: memoryview, header: Header) -> Log:
    reader = RowReader(data, header)
    taken = take(reader)
    found = whole(reader, taken.walk) or recover(reader)
    if header.repaired is not None:
        found = doubted(reader, found, header.repaired)
    return Log(
        size=len(data),
        version=2 if header.version == 2 else 1,
        header_bytes=0 if header.borrowed else header.size,
        types=header.types,
        rows=rows_of(reader, found.pieces, taken),
        parts=tuple(ByteRange(piece.walk.begin, piece.walk.end) for piece in found.pieces),
        verified=tuple(found.verified),
        damages=tuple(found.damages),
        epochs=epochs_of(reader, found.pieces),
        crc=found.crc,
        session=found.session,
    )


def whole(reader: RowReader, walk: Walk) -> Recovered | None:
    """A log that its logger has closed, and that is as it was written: its rows are taken as they are."""
    end = len(reader.data) - CRC_BYTES
    if walk.end != end or walk.crc != int.from_bytes(reader.data[end:], "little"):
        return None
    sessions = set(reader.status_fields(walk.statuses, ("session",))[0])
    if len(sessions) > 1:
        return None  # A CRC over parts that end with their own does not depend on what is in them.
    pieces = [Piece(part, True, epoch) for epoch, part in enumerate(reader.parts(walk))] if end > walk.begin else []
    return Recovered(pieces, [], [ByteRange(0, end)], next(iter(sessions), None), "good")


def doubted(reader: RowReader, found: Recovered, repaired: int) -> Recovered:
    """A repaired log's CRCs are good for all its rows; its notes say which of them were verified before."""
    pieces: list[Piece] = []
    since = 0
    for piece in found.pieces:
        begin = piece.walk.begin
        for note in reader.places(repaired, piece.walk):
            end = note + reader.row_bytes_at(note)
            pieces.append(replace(piece, walk=reader.walk(begin, end, None, strict=False)))
            if int.from_bytes(reader.data[end - 8 : end - 4], "little"):
                pieces[since:] = [replace(each, verified=False) for each in pieces[since:]]
            begin, since = end, len(pieces)
        if begin < piece.walk.end:
            pieces.append(replace(piece, walk=reader.walk(begin, piece.walk.end, None, strict=False)))
    pieces[since:] = [replace(each, verified=False) for each in pieces[since:]]
    verified = merged([ByteRange(each.walk.begin, each.walk.end) for each in pieces if each.verified])
    return replace(found, pieces=pieces, verified=verified)


def nothing(data: memoryview, at: int, why: str) -> Log:
    """Without a header nothing says what the bytes are."""
    damage = Damage(0, len(data), why if at == 0 else f"{why} (byte {at})")
    return Log(len(data), None, 0, (), {}, (), (), (damage,), (), "absent", None)
