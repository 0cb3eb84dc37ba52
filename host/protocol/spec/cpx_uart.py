"""CPX over UART2 (STM32 <-> ESP32): frames and credits."""

from construct import Bytes, Checksum, Const, Int8ul, OneOf, RawCopy, Rebuild, Struct, this

from .checks import xor8
from .cpx import ROUTE
from .values import Value

TIMES = (
    Value(100000, "CPX_UART_CREDIT_US", "us of silence after which the credit is repeated"),
    Value(20000, "CPX_UART_GAP_US", "us of silence inside a frame after which the frame is given up"),
)

FRAME = Struct(
    "covered"
    / RawCopy(
        Struct(
            "start" / Const(0xFF, Int8ul) * "start",
            "length"
            / Rebuild(OneOf(Int8ul, range(2, 101)), lambda this: 2 + len(this.data))
            * "route and data, 2..100",
            "route" / ROUTE * "see Route",
            "data" / Bytes(this.length - 2) * "of the packet",
        )
    ),
    "check" / Checksum(Int8ul, xor8, this.covered.data) * "XOR of every byte before it, the start included",
)

CREDIT = Struct(
    "start" / Const(0xFF, Int8ul) * "start",
    "length" / Const(0, Int8ul) * "nothing follows, no check byte either",
)
