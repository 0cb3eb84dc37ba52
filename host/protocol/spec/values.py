"""A named number of the protocol: what a table lists and a test compares with the C."""

from typing import NamedTuple


class Value(NamedTuple):
    number: int
    name: str
    """As in the C."""
    meaning: str
