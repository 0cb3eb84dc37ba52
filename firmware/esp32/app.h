/// The ESP32's part: a router between UART2 (STM32), SPI (GAP8) and one TCP client (the host).
///
/// Every queue is bounded. A frame from the GAP8 is taken whole or dropped whole, decided at its first packet
/// by whether all of it fits the image buffer: so a slow or stalled TCP connection never holds up the STM32's
/// packets and never cuts a frame. Packets of the STM32 overtake image packets. Nothing of an old connection
/// reaches a new client, and nothing native one that has not asked for it. Faults of the stock router that
/// are not repeated here: docs/DESIGN.md, "ESP32".
#ifndef SPINDECK_ESP32_APP_H
#define SPINDECK_ESP32_APP_H

#include "../core/cpx_link.h"
#include "../core/cpx_uart.h"
#include "../core/image.h"
#include "../core/nanocockpit.h"
#include "../core/native_log.h"
#include "../core/paper.h"

typedef enum {
    ESP32_PORT_UART2 = 0,
    ESP32_PORT_SPI = 1,     ///< this side is slave
    ESP32_PORT_TCP = 2,     ///< bytes of the one connection
    ESP32_PORT_NETWORK = 3, ///< events of the Wi-Fi driver in, commands to it out
    ESP32_PORT_COUNT = 4,
} esp32_port_t;

/// First byte on ESP32_PORT_NETWORK, in.
enum {
    NETWORK_UP = 1,     ///< then four bytes of IPv4; a fifth byte 1 when as station
    NETWORK_CLIENT = 2, ///< a host has connected
    NETWORK_CLIENT_GONE = 3,
    NETWORK_DOWN = 4,
};
/// First byte on ESP32_PORT_NETWORK, out: NETWORK_START, u8 mode (0 station, 1 access point), u8 SSID length,
/// SSID, u8 key length, key. NETWORK_RESET_GAP8: pull the GAP8's reset line for 100 ms.
enum { NETWORK_START = 16, NETWORK_RESET_GAP8 = 17 };

enum {
    ESP32_IMAGE_BYTES = 114688, ///< a whole 324 x 324 raw frame with its packet headers, and some
    ESP32_UART_IMAGE_BYTES =
        16384,         ///< of images, wait for a host on UART2, which takes up to a second for them
    ESP32_TO_UART = 8, ///< packets, each of up to CPX_MTU, split on the way out
    ESP32_TO_SPI = 8,
    ESP32_TO_TCP = 16,                ///< packets other than images
    ESP32_CLIENT_REPEAT_US = 1000000, ///< both neighbours are told again this often whether a client is there
    ESP32_NEWS_REPEAT_US = 100000,    ///< likewise, as long as the STM32 has not sent the Wi-Fi settings
    ESP32_STATUS_US = 1000000,
    ESP32_PAIRS_BYTES = 4096,    ///< room left for pairs when a native frame is taken
    ESP32_HOLD_UART_US = 50000,  ///< a packet waits this long for room, and the STM32 for its credit
    ESP32_HOLD_TCP_US = 1000000, ///< likewise, and the host's bytes behind it
    ESP32_TCP_GAP_US = 500000,   ///< silence inside a packet from the host after which it is given up
};

typedef struct {
    uint8_t host_on_uart; ///< 1: no Wi-Fi; the host sits on UART2 in the STM32's place
    uint8_t
        bridge; ///< 1: as NanoCockpit's, between the GAP8 and the host, by its length rule; see esp32_init
} esp32_config_t;

/// One packet as SPI and TCP carry it: length, route, data.
typedef struct {
    uint16_t size; ///< 0: none
    uint8_t bytes[CPX_LINK_FRAME_MAX];
} esp32_packet_t;

typedef struct {
    esp32_packet_t *slots; ///< in the same esp32_t
    uint8_t capacity;
    uint8_t head;
    uint8_t fill;
} esp32_queue_t;

/// A packet that was taken and has found no room yet.
typedef struct {
    esp32_packet_t packet;
    uint64_t until_us; ///< then it is dropped
} esp32_held_t;

/// Where in the image stream the GAP8 is.
typedef enum {
    IMAGES_BETWEEN = 0, ///< between two frames
    IMAGES_TAKING,      ///< in a frame that goes on to the host
    IMAGES_DROPPING,    ///< in a frame that does not
    IMAGES_LOST,        ///< unknown: nothing goes on before the next start of a frame
} esp32_images_t;

typedef struct {
    esp32_config_t config;
    cpx_uart_t uart2;
    cpx_tcp_rx_t tcp_rx;
    uint64_t tcp_heard_us; ///< when bytes were last taken from the host
    bool network_up;
    bool network_started; ///< the driver has been told the present settings
    bool client;
    bool native;   ///< the host has asked for status messages
    bool reports;  ///< likewise, for the STM32's about its log
    bool requests; ///< it has sent the GAP8 a native request: replies are for it
    uint8_t ssid[32];
    uint8_t ssid_size;
    uint8_t key[64];
    uint8_t key_size;
    uint8_t mode;             ///< 0 station, 1 access point
    bool network_start_waits; ///< commands that have not gone out yet
    bool network_reset_waits;
    esp32_packet_t to_uart_slots[8];
    esp32_queue_t to_uart;
    uint16_t uart_split; ///< data bytes of the first packet that are already sent in earlier pieces
    esp32_packet_t to_spi_slots[8];
    esp32_queue_t to_spi;
    esp32_packet_t to_tcp_slots[16];
    esp32_queue_t to_tcp;
    uint16_t packet_sent; ///< bytes of to_tcp's first packet already given to TCP
    esp32_held_t from_uart;
    esp32_held_t from_tcp;
    uint8_t image[ESP32_IMAGE_BYTES]; ///< ring of whole TCP packets
    uint32_t image_head, image_fill;
    uint32_t image_packet_left;             ///< of the packet at the head, already begun: what is left of it
    uint8_t image_route[2];                 ///< host on UART2: of the packet at the head
    uint8_t bridged[NANOCOCKPIT_FRAME_MAX]; ///< bridge: the packet that comes from the host
    uint16_t bridged_fill;
    esp32_images_t images;
    bool frame_native;
    uint16_t frame_data_max;  ///< longest CPX data of a native frame; 0: this host has not asked for any
    uint32_t frame_left;      ///< body bytes still to come from the GAP8
    uint32_t frame_ring_left; ///< bytes of the ring that they will take
    uint64_t client_next_us;
    uint64_t status_next_us;
    uint32_t frames_forwarded;
    uint32_t frames_dropped;
    uint32_t frames_cut;
    uint32_t frames_unasked; ///< native, for a host that has not asked: held back
    uint32_t packets_forwarded;
    uint32_t packets_dropped;
    uint32_t packets_unroutable; ///< no such end, no way to it, or for the ESP32 and unknown to it
    uint32_t packets_empty;      ///< without data: the stock router drops them too
    uint32_t packets_unsent; ///< for a host that is not there, has gone, came in the middle of a frame, or
                             ///< has not asked for native
    uint32_t spi_errors;
    uint32_t wifi_refused; ///< settings that cannot be used (key of 1..7 characters, too long a name)
    uint32_t gap8_resets;
} esp32_t;

/// 0, or ERR_VALUE for a bridge without Wi-Fi or a value above 1. A bridge starts its network by itself, as
/// access point "crazyflie", open, and uses neither UART2 nor any message of its own.
int esp32_init(esp32_t *self, const esp32_config_t *config, instant_t now);

/// Returns the bytes taken. All of them, but on TCP: there it stops behind a packet for which a queue has no
/// room, and the caller offers the rest again later (the board leaves them in the socket).
int esp32_receive(esp32_t *self, esp32_port_t port, bytes_t in, instant_t now);

/// SPI: what the slave sends in the next window, or four zero bytes when it has nothing to say but is ready.
/// It is always ready: what it has no room for, it drops. TCP: up to out.size bytes, packets may be cut at
/// any byte.
size_t esp32_transmit(esp32_t *self, esp32_port_t port, bytes_mut_t out, instant_t now);

uint64_t esp32_deadline(const esp32_t *self);

#endif
