"""The native time message, STM32 -> GAP8 over UART1."""

from construct import Checksum, Const, Int8ul, Int16ul, Int32ul, Int64ul, RawCopy, Struct, this

from .checks import crc16
from .values import Value

TIMES = (
    Value(10000, "STAMP_PERIOD_US", "us of uptime from message to message"),
    Value(1477381, "CLOCK_STAMP_WIRE_NS", "ns on the wire: 17 x 10 bits of 365 cycles at 42 MHz"),
)

STAMP = Struct(
    "sync" / Const(b"\xd5\x2a") * "start",
    "covered"
    / RawCopy(
        Struct(
            "sequence" / Int32ul * "+1 each message, wraps",
            "stm32_us" / Int64ul * "us, STM32 stamp clock when the first byte starts to leave",
            "epoch" / Int8ul * "resets of the stamp clock since boot, wraps",
        )
    ),
    "crc16" / Checksum(Int16ul, crc16, this.covered.data) * "CRC-16/CCITT-FALSE of bytes 2..14",
)
