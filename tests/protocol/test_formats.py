"""The C against the specification: six tests for every format in wire_formats.py.

Hypothesis is derandomised: a failing case is found again by running the same test again.
"""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wire_format import Format, decode, encode
from wire_formats import FORMATS

seeded = settings(derandomize=True, deadline=None, max_examples=60)
every_format = pytest.mark.parametrize("format_", FORMATS, ids=str)


@every_format
@given(st.data())
@seeded
def test_encode_is_build(format_: Format, data: st.DataObject) -> None:
    values = data.draw(format_.values)
    assert encode(format_, values, 0).hex(" ") == format_.build(values).hex(" ")


@every_format
@given(st.data())
@seeded
def test_decode_is_parse(format_: Format, data: st.DataObject) -> None:
    wire = format_.build(data.draw(format_.values))
    assert decode(format_, wire) == format_.parse(wire)


@every_format
@given(st.data())
@seeded
def test_round_trip(format_: Format, data: st.DataObject) -> None:
    values = data.draw(format_.values)
    wire = encode(format_, values, 0)
    assert decode(format_, wire) == (values, len(wire))


@every_format
@given(st.data())
@settings(seeded, max_examples=10)
def test_every_truncation_is_refused(format_: Format, data: st.DataObject) -> None:
    """decode() also asserts that a refusal leaves the output untouched."""
    wire = format_.build(data.draw(format_.values))
    needed = len(wire) if format_.needed is None else format_.needed
    for size in range(needed):
        assert decode(format_, wire[:size]) is None, f"{size} of {len(wire)} bytes were taken for the whole"
    for size in range(needed, len(wire)):
        assert decode(format_, wire[:size]) == format_.parse(wire[:size])


@every_format
@given(st.data())
@seeded
def test_encode_leaves_nothing_of_the_buffer(format_: Format, data: st.DataObject) -> None:
    values = data.draw(format_.values)
    assert encode(format_, values, 0xA5) == encode(format_, values, 0x5A)


@every_format
@given(st.data())
@settings(seeded, max_examples=150)
def test_random_bytes_are_judged_alike(format_: Format, data: st.DataObject) -> None:
    wire = data.draw(noise(format_))
    assert decode(format_, wire) == format_.parse(wire)


def noise(format_: Format) -> st.SearchStrategy[bytes]:
    """Any bytes; and messages with some bytes replaced, cut or grown, with and without a check that matches."""
    edges = st.sampled_from([0, 1, 2, 3, 4, 5, 99, 100, 101, 254, 255]) | st.integers(0, 255)
    edits = st.lists(st.tuples(st.integers(0, 40), edges), max_size=3)

    def change(wire: bytes, edits: list[tuple[int, int]], cut: int, more: bytes) -> bytes:
        changed = bytearray(wire)
        for place, value in edits:
            if place < len(changed):
                changed[place] = value
        return bytes(changed[: max(0, len(changed) - cut)]) + more

    near = st.builds(
        change, format_.values.map(format_.build), edits, st.sampled_from([0, 0, 0, 1, 7]), st.binary(max_size=4)
    )
    return st.one_of(st.binary(max_size=120), near, near.map(format_.repair))
