"""CPX over SPI (GAP8 <-> ESP32) and over TCP (ESP32 <-> host): one layout."""

from construct import Bytes, Const, Int16ul, OneOf, Padding, Rebuild, Struct, this

from .cpx import ROUTE

FRAME = Struct(
    "length" / Rebuild(OneOf(Int16ul, range(2, 1023)), lambda this: 2 + len(this.data)) * "route and data, 2..1022",
    "route" / ROUTE * "see Route",
    "data" / Bytes(this.length - 2) * "of the packet",
)

IDLE = Struct(
    "length" / Const(0, Int16ul) * "nothing to say",
    Padding(2) * "in the place of a route, ignored",
)


def window_bytes(master_size: int, slave_size: int) -> int:
    """Bytes of one SPI window: four, and then what the longer side still has, in fours, at least four."""
    rest = max(master_size, slave_size) - 4
    return 4 + max(4, -(-rest // 4) * 4)
