"""The beacon: a host's clock, broadcast to all robots over the radio."""

from construct import Const, Default, ExprValidator, Int8ul, Int32ul, Int64ul, Struct, obj_

from .values import Value

LIMITS = (Value(14, "BEACON_BYTES", "of the CRTP packet"),)

BEACON = Struct(
    "crtp"
    / Default(ExprValidator(Int8ul, (obj_ & 0xF3) == 0xD2), 0xD2)
    * "CRTP header, D2: port 13 (platform), channel 2 (app); bits 2 and 3 are the link's and mean nothing",
    "kind" / Const(b"\x62") * "beacon",
    "sequence" / Int32ul * "+1 each beacon, wraps",
    "host_us" / Int64ul * "us, the host's clock, read as late as it can before it is sent",
)
