"""What a session says that a port may wait for, on TCP: no frame is complete earlier, and so none gets a later time."""

import random

import pytest
from made_streams import (
    ANNOUNCING,
    GAP8_TO_HOST_CONSOLE,
    comparable,
    nanocockpit,
    native,
    packet,
    pairs,
    paper,
    pixels,
    received,
    status,
    stock,
)

from host.link.frame import Frame
from host.link.session import Dialect, Session

BODY = pixels(60, 50, 1)
CONSOLE = packet(b"hello\n\0", GAP8_TO_HOST_CONSOLE)
STREAMS: dict[Dialect, bytes] = {
    "stock": b"".join([*stock(BODY, 60, 50, route=ANNOUNCING), CONSOLE, *stock(pixels(9, 7, 2), 9, 7)] * 3),
    "native": b"".join(
        [
            *native(1, BODY, 60, 50)[:2],
            *(pairs([(1, 2, 3, 0)]), status(0), CONSOLE),
            *native(1, BODY, 60, 50)[2:],
            *native(2, pixels(9, 7, 2), 9, 7),
            *native(3, BODY, 60, 50, piece=96),
        ]
    ),
    "paper": b"".join([*paper(BODY, 60, 50, 100), CONSOLE, *paper(pixels(9, 7, 2), 9, 7, 200)]),
    "nanocockpit": b"".join(
        [*nanocockpit(BODY, 60, 50, 1, piece=500), *nanocockpit(pixels(9, 7, 2), 9, 7, 2, piece=500)]
    ),
}


@pytest.mark.parametrize("dialect", STREAMS)
@pytest.mark.parametrize("seed", range(10))
def test_no_frame_is_complete_before_the_bytes_wanted_have_come(dialect: Dialect, seed: int) -> None:
    stream, draw = STREAMS[dialect], random.Random(seed)
    whole, _ = received(stream, dialect=dialect, finish=False)
    session = Session("tcp", dialect)
    got, at, most = [], 0, 0
    while at < len(stream):
        wanted = session.bytes_wanted
        most = max(most, wanted)
        few = draw.choice([wanted - 1, draw.randint(0, wanted - 1)])
        early = session.receive(stream[at : at + few], 1)
        assert not any(isinstance(event, Frame) for event in early)
        at += few
        more = draw.choice([1, wanted - few])
        got += early + session.receive(stream[at : at + more], 1)
        at += more
    assert comparable(got) == comparable(whole)
    assert sum(isinstance(event, Frame) for event in got) >= 2
    assert most > 2000, "a port may wait for most of a frame"
