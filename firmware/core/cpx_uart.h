/// CPX over UART2 (STM32 <-> ESP32): framing, and flow control by credits.
///
/// Frame: FF, length of route and data (1..100, so 2..100 for a packet), route, data, XOR of all before it.
/// Credit: FF 00, "I have taken your packet, you may send one more". One credit, not a count.
/// The existing firmwares deadlock when a credit is lost and restart on a bad check byte. Here a side that
/// has heard nothing repeats its credit every CPX_UART_CREDIT_US, a frame that stops half-way is given up
/// after CPX_UART_GAP_US, and every bad byte is a counter.
#ifndef SPINDECK_CORE_CPX_UART_H
#define SPINDECK_CORE_CPX_UART_H

#include "cpx.h"

enum {
    CPX_UART_START = 0xFF,
    CPX_UART_FRAME_MAX = 103,    ///< start, length, CPX_MTU_UART, check
    CPX_UART_CREDIT_US = 100000, ///< the stock handshake's period, kept up as long as the line is silent
    CPX_UART_GAP_US = 20000,     ///< silence inside a frame after which the frame is given up
};

/// Writes one whole frame and returns its size, or 0 if `packet->data` exceeds CPX_DATA_UART_MAX or `out` is
/// too small (then nothing is written).
size_t cpx_uart_encode(const cpx_packet_t *packet, bytes_mut_t out);

/// Decodes the frame at the start of `in`. Returns the bytes it takes (a credit takes 2 and leaves `packet`
/// untouched), or ERR_SHORT, ERR_START, ERR_LENGTH (length 1 or over 100), ERR_CHECK.
/// `packet->data` points into `in`.
int cpx_uart_decode(bytes_t in, cpx_packet_t *packet);

/// One end of the line. The caller owns it; it must not be moved between cpx_uart_receive and the use of the
/// packet that it returned. All counters only grow.
typedef struct {
    uint8_t rx[CPX_UART_FRAME_MAX];
    uint8_t rx_fill;
    uint8_t rx_taken;    ///< bytes at the front of rx that are the packet handed out last
    uint64_t rx_last_us; ///< when the last byte came in
    uint8_t tx[CPX_UART_FRAME_MAX];
    uint8_t tx_size; ///< 0: no frame waits
    uint8_t tx_sent;
    bool tx_credit;      ///< the peer allows one more packet
    bool owes_credit;    ///< we allow one more packet and have not said so
    bool held;           ///< a packet was handed out and the app has not accepted it yet
    uint8_t credit_sent; ///< bytes of FF 00 already on the line, 0 when none is under way
    uint64_t credit_us;  ///< when the next unsolicited credit is due
    uint32_t packets_in;
    uint32_t packets_out;
    uint32_t credits_in;
    uint32_t credits_repeated;
    uint32_t bad_check;
    uint32_t bad_length;
    uint32_t bad_version;
    uint32_t
        garbage_bytes; ///< in no good frame and in no credit: each byte received is in just one of the three
    uint32_t gaps;     ///< frames given up after CPX_UART_GAP_US
} cpx_uart_t;

/// Both ends start by offering a credit.
void cpx_uart_init(cpx_uart_t *self, uint64_t now_us);

/// One byte, with the time of its stop bit. True when it completes a packet: `packet` then views self->rx
/// until the next call, and the line gives no new credit until cpx_uart_accept. A packet of a wrong version
/// is counted, dropped and credited, as is one with a bad check byte (the peer would wait for ever
/// otherwise). After a bad frame the search goes on inside its bytes. Now and then (a repeated credit crossed
/// a packet, or a credit was found inside a bad frame) a second packet comes before cpx_uart_accept: take it
/// or drop it.
bool cpx_uart_receive(cpx_uart_t *self, uint8_t byte, uint64_t now_us, cpx_packet_t *packet);

/// The app has room again: the peer gets its credit. Call it once per packet from cpx_uart_receive, later if
/// need be: that is how back-pressure works on this line.
void cpx_uart_accept(cpx_uart_t *self);

/// Takes a copy of one packet to send. False when one still waits, or when the data exceeds
/// CPX_DATA_UART_MAX.
bool cpx_uart_send(cpx_uart_t *self, const cpx_packet_t *packet);

/// The next byte for the line: 1 and *out, or 0 when there is nothing to send now. Credits go first, but
/// never inside a frame.
size_t cpx_uart_transmit(cpx_uart_t *self, uint8_t *out, uint64_t now_us);

/// When cpx_uart_transmit may next have a byte without anything having been received or sent: 0 while it has
/// one, NEVER_US while it waits for cpx_uart_accept only.
uint64_t cpx_uart_deadline(const cpx_uart_t *self);

#endif
