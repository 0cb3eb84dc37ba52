/// CPX: the packet that travels between STM32, ESP32, GAP8 and host, whatever the link below.
///
/// A packet is a two-byte route and then data. Links (cpx_uart.h, cpx_spi.h, cpx_tcp.h) add their own
/// framing. Layout and limits: docs/PROTOCOL.md, "CPX".
#ifndef SPINDECK_CORE_CPX_H
#define SPINDECK_CORE_CPX_H

#include "bytes.h"

enum {
    CPX_VERSION = 0,
    CPX_ROUTE_BYTES = 2,
    CPX_MTU_UART = 100,     ///< route and data, STM32 <-> ESP32
    CPX_MTU = 1022,         ///< route and data, everywhere else
    CPX_DATA_UART_MAX = 98, ///< CPX_MTU_UART - CPX_ROUTE_BYTES
    CPX_DATA_MAX = 1020,    ///< CPX_MTU - CPX_ROUTE_BYTES
};

/// Who a packet is from and for. 0 and 5..7 are not in use.
enum { CPX_STM32 = 1, CPX_ESP32 = 2, CPX_HOST = 3, CPX_GAP8 = 4 };

/// What a packet is about.
enum {
    CPX_SYSTEM = 1,
    CPX_CONSOLE = 2,
    CPX_CRTP = 3,
    CPX_WIFI_CTRL = 4,
    CPX_APP = 5,
    CPX_STREAMER = 6, ///< NanoCockpit firmware only
    CPX_TEST = 14,
    CPX_BOOTLOADER = 15,
};

/// WIFI_CTRL: the first data byte. SYSTEM: likewise.
enum {
    WIFI_SET_SSID = 0x10,
    WIFI_SET_KEY = 0x11,
    WIFI_CONNECT = 0x20,          ///< then u8: 0 station, else access point
    WIFI_CONNECTED = 0x31,        ///< then four bytes of IPv4, ESP32 -> GAP8 and STM32
    WIFI_CLIENT_CONNECTED = 0x32, ///< then u8: 1 a host has connected, 0 it has gone
    SYSTEM_RESET_GAP8 = 0x10,     ///< to the ESP32, which answers with the same byte
    SYSTEM_CLIENT = 0x20,         ///< to the STM32, then u8
    SYSTEM_BRIDGE = 0x21,         ///< to the STM32, then u8: CRTP goes over CPX while 1
    SYSTEM_SHUTDOWN = 0x30,       ///< to the STM32: its power goes soon, so its log is closed
    TEST_SINK = 0,
    TEST_ECHO = 1,
    BOOTLOADER_JUMP = 6, ///< ESP32 -> GAP8, at its start: go on to the app
};

/// Errors of the decoders in core. Whatever is negative left the output untouched.
enum {
    ERR_SHORT = -1,  ///< more bytes are needed before this can be judged
    ERR_START = -2,  ///< the first bytes are not this message's
    ERR_LENGTH = -3, ///< the length field is out of range
    ERR_CHECK = -4,  ///< the checksum does not match
    ERR_VALUE = -5,  ///< a field has a value that the format does not allow
};

typedef struct {
    uint8_t destination; ///< 0..7
    uint8_t source;      ///< 0..7
    uint8_t function;    ///< 0..63
    uint8_t version;     ///< 0..3; CPX_VERSION is the one in use
    bool last_packet;    ///< set or clear without meaning in existing firmware: never rely on it
    bool reserved;       ///< 0 in stock firmware; native firmware announces itself with it (see image.h)
} cpx_route_t;

/// `data` belongs to whoever made the packet.
typedef struct {
    cpx_route_t route;
    bytes_t data;
} cpx_packet_t;

/// Fields wider than their bits are masked. Cannot fail.
void cpx_route_encode(const cpx_route_t *route, uint8_t out[2]);

/// Every two bytes decode to some route. Cannot fail.
void cpx_route_decode(const uint8_t in[2], cpx_route_t *route);

/// True when source and destination are in 1..4 and the version is CPX_VERSION: what a router may forward.
bool cpx_route_ok(const cpx_route_t *route);

#endif
