"""A log whose beginning is lost or overwritten, its header with it: another log's header says how its rows lie."""

from __future__ import annotations

from dataclasses import replace

from ..protocol.errors import LocalError
from .header import Header, HeaderError, read_header
from .rows import RowReader

WHY = "no header: rows are read as those of another log"


def borrowed(data: memoryview, other: memoryview) -> Header:
    """The other log's, as if it ended where rows follow each other for the first time. LocalError: it has none."""
    try:
        header = read_header(other)
    except HeaderError as error:
        raise LocalError(f"there is no header to borrow: {error.why}") from None
    return replace(header, size=RowReader(data, header).find(0, None), borrowed=True)
