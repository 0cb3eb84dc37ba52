"""The native messages on UART1: times, STM32 -> GAP8, and the echo, there and back."""

from construct import Checksum, Const, Int8ul, Int16ul, Int32ul, Int64ul, RawCopy, Struct, this

from .checks import crc16
from .values import Value

TIMES = (
    Value(10000, "STAMP_PERIOD_US", "us of uptime from message to message"),
    Value(1477381, "CLOCK_STAMP_WIRE_NS", "ns on the wire: 17 x 10 bits of 365 cycles at 42 MHz"),
    Value(434000, "ECHO_QUESTION_WIRE_NS", "ns on the wire of an echo's question: 5 x 10 bits of 434 cycles at 50 MHz"),
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

QUESTION = Struct(
    "sync" / Const(b"\xd5\x2b") * "start",
    "covered" / RawCopy(Struct("number" / Int8ul * "+1 each question, wraps")),
    "crc16" / Checksum(Int16ul, crc16, this.covered.data) * "CRC-16/CCITT-FALSE of byte 2",
)
ANSWER = Struct(
    "sync" / Const(b"\xd5\x2c") * "start",
    "covered"
    / RawCopy(
        Struct(
            "number" / Int8ul * "of the question",
            "received_stm32_us" / Int64ul * "us, STM32 stamp clock at the question's last stop bit",
            "held_us" / Int32ul * "us of that clock from then until the answer's first byte starts to leave",
        )
    ),
    "crc16" / Checksum(Int16ul, crc16, this.covered.data) * "CRC-16/CCITT-FALSE of bytes 2..14",
)
