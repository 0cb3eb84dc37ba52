"""WIFI_CTRL and SYSTEM: the first data byte is a command, what follows depends on it."""

from construct import Array, GreedyBytes, Int8ul, Pass, Struct, Switch, this

from .values import Value

WIFI_COMMANDS = (
    Value(0x10, "WIFI_SET_SSID", "to ESP32: name of the network, 1 to 32 bytes, no NUL"),
    Value(0x11, "WIFI_SET_KEY", "to ESP32: key, 8 to 64 bytes, no NUL; none: open network"),
    Value(0x20, "WIFI_CONNECT", "to ESP32, after the other two: u8, 0 station, else access point"),
    Value(0x31, "WIFI_CONNECTED", "ESP32 to GAP8 and STM32: four bytes of IPv4, first number first; station only"),
    Value(0x32, "WIFI_CLIENT_CONNECTED", "ESP32 to GAP8 and STM32: u8, 1 a host has connected, 0 it has gone"),
)

SYSTEM_COMMANDS = (
    Value(0x10, "SYSTEM_RESET_GAP8", "to ESP32: holds the GAP8 in reset for 100 ms; answered with the same byte"),
    Value(0x20, "SYSTEM_CLIENT", "to STM32: u8, sets the flag that a host is connected"),
    Value(0x21, "SYSTEM_BRIDGE", "to STM32: u8, 1 CRTP goes over CPX, 0 over radio"),
    Value(0x30, "SYSTEM_SHUTDOWN", "to STM32, this project's: its power goes soon, so its log is closed"),
)

WIFI_CTRL = Struct(
    "command" / Int8ul * "a WIFI_ command",
    "argument"
    / Switch(
        this.command,
        {0x10: GreedyBytes, 0x11: GreedyBytes, 0x20: Int8ul, 0x31: Array(4, Int8ul), 0x32: Int8ul},
        default=GreedyBytes,
    )
    * "by command",
)

SYSTEM = Struct(
    "command" / Int8ul * "a SYSTEM_ command",
    "argument"
    / Switch(this.command, {0x10: Pass, 0x20: Int8ul, 0x21: Int8ul, 0x30: Pass}, default=GreedyBytes)
    * "by command",
)
