"""The decoder against the independent specification (construct)."""

import math
import struct

import pytest
from construct import ConstructError
from hypothesis import given, settings
from hypothesis import strategies as st
from logs import MINIMAL, Writer, check_account, fill, real

from host.protocol.spec import usd
from host.usd.decode import decode
from host.usd.log import STATUS_VARIABLES

RANGES = {
    "B": (0, 2**8 - 1), "b": (-(2**7), 2**7 - 1), "H": (0, 2**16 - 1),
    "h": (-(2**15), 2**15 - 1), "I": (0, 2**32 - 1), "i": (-(2**31), 2**31 - 1),
}  # fmt: skip
NAMES = st.text("abcXYZ019._", min_size=1, max_size=12)


def values(letter: str) -> st.SearchStrategy[float]:
    if letter in RANGES:
        return st.integers(*RANGES[letter])
    return st.floats(width=32 if letter == "f" else 16, allow_nan=False)


@st.composite
def logs(draw: st.DrawFn) -> tuple[list[dict[str, object]], list[tuple[int, int, list[float]]]]:
    ids = draw(st.lists(st.integers(0, 0xFFFF), min_size=1, max_size=4, unique=True))
    names = draw(st.lists(NAMES, min_size=len(ids), max_size=len(ids), unique=True))
    letters = {number: draw(st.lists(st.sampled_from("BbHhIife"), max_size=5)) for number in ids}
    types = [
        {"id": number, "name": name, "count": len(letters[number]),
         "variables": [f"v{place}({letter})" for place, letter in enumerate(letters[number])]}
        for number, name in zip(ids, names, strict=True)
    ]  # fmt: skip
    stamp, rows = draw(st.integers(0, 2**40)), []
    for number in draw(st.lists(st.sampled_from(ids), max_size=12)):
        stamp += draw(st.integers(0, 10**6))
        rows.append((number, stamp, [draw(values(letter)) for letter in letters[number]]))
    return types, rows


@settings(max_examples=30, deadline=None)
@given(logs())
def test_what_the_specification_builds(
    made: tuple[list[dict[str, object]], list[tuple[int, int, list[float]]]],
) -> None:
    types, rows = made
    data = usd.build(types, rows)
    log = decode(data)
    assert log.is_whole
    for each in types:
        expected = [(stamp, *values) for number, stamp, values in rows if number == each["id"]]
        assert log.rows[str(each["name"])].data.tolist() == expected


@settings(max_examples=30, deadline=None)
@given(logs(), st.data())
def test_cut_off_and_changed(
    made: tuple[list[dict[str, object]], list[tuple[int, int, list[float]]]], data: st.DataObject
) -> None:
    """Never an exception, never a byte that is both returned and lost, nothing verified without a CRC."""
    whole = usd.build(*made)
    broken = bytearray(whole[: data.draw(st.integers(0, len(whole)))])
    for place in data.draw(st.lists(st.integers(0, max(len(broken) - 1, 0)), max_size=3)) if broken else []:
        broken[place] = data.draw(st.integers(0, 255))
    log = decode(broken)
    check_account(log)
    assert log.verified_count == 0 or log.crc == "good"


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=300), st.booleans())
def test_any_bytes(data: bytes, begins_well: bool) -> None:
    log = decode(MINIMAL[:33] + data if begins_well else data)
    check_account(log)
    assert log.verified_count == 0 or log.crc == "good"


def agree(data: bytes) -> None:
    """Both readings of a whole log are the same rows."""
    theirs = usd.parse(data)
    log = decode(data)
    for name, rows in log.rows.items():
        read = [(stamp, *values) for other, stamp, values in theirs if other == name]
        for ours, their in zip(rows.data.tolist(), read, strict=True):
            assert all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in zip(ours, their, strict=True))


def test_the_smallest_log() -> None:
    assert usd.parse(MINIMAL) == [("fixedFrequency", 1000, [1.0])]
    agree(MINIMAL)


def test_status_rows() -> None:
    data = fill(Writer(session=0xABCD1234), seed=1, rows=100).close()
    agree(data)
    last = usd.STATUS.parse(data[-36:-4])
    assert tuple(name for name in last if not name.startswith("_")) == STATUS_VARIABLES
    row = decode(data).rows["log.status"].data[-1]
    assert all(row[name] == last[name] for name in STATUS_VARIABLES)


@pytest.mark.parametrize("name", ["flights/eckart12"])
def test_a_real_log(name: str) -> None:
    """Its first rows, closed there: construct is slow."""
    data = real(name)[:30_000]
    log = decode(data)
    body = data[: log.parts[-1].end]
    agree(body + struct.pack("<I", usd.crc32(body)))


def test_the_specification_refuses_what_is_damaged() -> None:
    for place in range(len(MINIMAL)):
        broken = bytearray(MINIMAL)
        broken[place] ^= 0x10
        with pytest.raises((ValueError, ConstructError, KeyError)):
            usd.parse(bytes(broken))
        assert not decode(broken).is_whole
