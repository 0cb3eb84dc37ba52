/// The ESP32's part: a router between UART2 (STM32), SPI (GAP8) and one TCP client (the host).
///
/// Every queue is bounded. A frame from the GAP8 is taken whole or dropped whole, decided at its first packet by
/// whether all of it fits the image buffer: so a slow or stalled TCP connection never holds up the STM32's packets
/// and never cuts a frame. Packets of the STM32 overtake image packets. Nothing of an old connection reaches a new
/// client. Faults of the stock router that are not repeated here: docs/DESIGN.md, "ESP32".
#ifndef SPINDECK_ESP32_APP_H
#define SPINDECK_ESP32_APP_H

#include "../core/cpx_link.h"
#include "../core/cpx_uart.h"
#include "../core/image.h"

typedef enum {
    ESP32_PORT_UART2 = 0,
    ESP32_PORT_SPI = 1,     ///< this side is slave
    ESP32_PORT_TCP = 2,     ///< bytes of the one connection
    ESP32_PORT_NETWORK = 3, ///< events of the Wi-Fi driver in, commands to it out
    ESP32_PORT_COUNT = 4,
} esp32_port_t;

/// First byte on ESP32_PORT_NETWORK, in.
enum {
    NETWORK_UP = 1,           ///< then four bytes of IPv4; a fifth byte 1 when as station
    NETWORK_CLIENT = 2,       ///< a host has connected
    NETWORK_CLIENT_GONE = 3,
    NETWORK_DOWN = 4,
};
/// First byte on ESP32_PORT_NETWORK, out: NETWORK_START, u8 mode (0 station, 1 access point), u8 SSID length, SSID,
/// u8 key length, key. NETWORK_RESET_GAP8: pull the GAP8's reset line for 100 ms.
enum { NETWORK_START = 16, NETWORK_RESET_GAP8 = 17 };

enum {
    ESP32_IMAGE_BYTES = 114688,  ///< a whole 324 x 324 raw frame with its packet headers, and some
    ESP32_TO_UART = 8,           ///< packets, each of up to CPX_MTU, split on the way out
    ESP32_TO_SPI = 8,
    ESP32_TO_TCP = 16,           ///< packets other than images
    ESP32_CLIENT_REPEAT_US = 1000000, ///< the GAP8 is told again this often whether a client is there
    ESP32_STATUS_US = 1000000,
};

typedef struct {
    uint8_t host_on_uart; ///< 1: no Wi-Fi; the host sits on UART2 in the STM32's place
} esp32_config_t;

typedef struct {
    uint16_t size; ///< route and data
    uint8_t bytes[1022];
} esp32_packet_t;

typedef struct {
    esp32_config_t config;
    cpx_uart_t uart2;
    cpx_tcp_rx_t tcp_rx;
    bool network_up;
    bool client;
    bool native;               ///< the host has asked for status messages
    uint8_t ssid[33];
    uint8_t ssid_size;
    uint8_t key[65];
    uint8_t key_size;
    uint8_t mode;
    uint8_t network_command;   ///< waiting to go out, or 0
    esp32_packet_t to_uart[8];
    uint8_t to_uart_head, to_uart_fill;
    uint16_t uart_split;       ///< data bytes of the first packet that are already sent in earlier pieces
    esp32_packet_t to_spi[8];
    uint8_t to_spi_head, to_spi_fill;
    esp32_packet_t to_tcp[16];
    uint8_t to_tcp_head, to_tcp_fill;
    uint8_t image[ESP32_IMAGE_BYTES]; ///< ring of whole TCP packets
    uint32_t image_head, image_fill;
    uint32_t image_packet_left;  ///< bytes of the packet at the head that are not yet given to TCP
    uint16_t packet_sent;        ///< bytes of to_tcp's first packet already given to TCP
    uint32_t frame_left;         ///< body bytes still to come from the GAP8
    bool frame_dropping;
    uint64_t client_next_us;
    uint64_t status_next_us;
    uint32_t frames_forwarded;
    uint32_t frames_dropped;
    uint32_t frames_cut;
    uint32_t packets_forwarded;
    uint32_t packets_dropped;
    uint32_t packets_unroutable;
    uint32_t packets_unsent;     ///< for a host that is not there, or that has gone
    uint32_t spi_errors;
    uint32_t wifi_refused;       ///< settings that cannot be used (key of 1..7 characters, too long a name)
    uint32_t gap8_resets;
} esp32_t;

int esp32_init(esp32_t *self, const esp32_config_t *config, instant_t now);

/// Returns the bytes taken. All of them, but on TCP: there it stops before a packet for which a queue has no room,
/// and the caller offers the rest again later (the board leaves them in the socket).
int esp32_receive(esp32_t *self, esp32_port_t port, bytes_t in, instant_t now);

/// SPI: what the slave sends in the next window, or four zero bytes when it has nothing to say but is ready, or 0
/// when it is not ready for a window. TCP: up to out.size bytes, packets may be cut at any byte.
size_t esp32_transmit(esp32_t *self, esp32_port_t port, bytes_mut_t out, instant_t now);

uint64_t esp32_deadline(const esp32_t *self);

#endif
