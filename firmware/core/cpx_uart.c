#include "cpx_uart.h"

#include "checks.h"

#include <string.h>

enum { HEAD_BYTES = 2, CHECK_BYTES = 1, CREDIT_BYTES = 2 };

size_t cpx_uart_encode(const cpx_packet_t *packet, bytes_mut_t out) {
    const bytes_t data = packet->data;
    const size_t check_at = HEAD_BYTES + CPX_ROUTE_BYTES + data.size;
    if (data.size > CPX_DATA_UART_MAX || out.size < check_at + CHECK_BYTES) {
        return 0;
    }
    out.data[0] = CPX_UART_START;
    out.data[1] = (uint8_t)(CPX_ROUTE_BYTES + data.size);
    cpx_route_encode(&packet->route, out.data + HEAD_BYTES);
    if (data.size > 0) {
        memcpy(out.data + HEAD_BYTES + CPX_ROUTE_BYTES, data.data, data.size);
    }
    out.data[check_at] = xor8((bytes_t){out.data, check_at});
    return check_at + CHECK_BYTES;
}

int cpx_uart_decode(bytes_t in, cpx_packet_t *packet) {
    if (in.size == 0) {
        return ERR_SHORT;
    }
    if (in.data[0] != CPX_UART_START) {
        return ERR_START;
    }
    if (in.size < HEAD_BYTES) {
        return ERR_SHORT;
    }
    const uint8_t length = in.data[1];
    if (length == 0) {
        return CREDIT_BYTES;
    }
    if (length < CPX_ROUTE_BYTES || length > CPX_MTU_UART) {
        return ERR_LENGTH;
    }
    const int check_at = HEAD_BYTES + length;
    if (in.size < (size_t)check_at + CHECK_BYTES) {
        return ERR_SHORT;
    }
    if (xor8((bytes_t){in.data, (size_t)check_at}) != in.data[check_at]) {
        return ERR_CHECK;
    }
    cpx_route_decode(in.data + HEAD_BYTES, &packet->route);
    packet->data = (bytes_t){in.data + HEAD_BYTES + CPX_ROUTE_BYTES, (size_t)length - CPX_ROUTE_BYTES};
    return check_at + CHECK_BYTES;
}

void cpx_uart_init(cpx_uart_t *self, uint64_t now_us) {
    *self = (cpx_uart_t){.rx_last_us = now_us, .owes_credit = true, .credit_us = now_us};
}

static void drop(cpx_uart_t *self, size_t count) {
    self->rx_fill = (uint8_t)(self->rx_fill - count);
    memmove(self->rx, self->rx + count, self->rx_fill);
}

static void give_credit(cpx_uart_t *self) {
    self->owes_credit = !self->held;
}

/// Judges the bytes in rx until a packet is at their start (true) or more must come first (false). After an
/// error only one byte goes: the next frame may start inside the bad one. `stale`: nothing more will come for
/// these bytes.
static bool find_packet(cpx_uart_t *self, bool stale, cpx_packet_t *packet) {
    bool gap_counted = false;
    while (self->rx_fill > 0) {
        cpx_packet_t found;
        const int result = cpx_uart_decode((bytes_t){self->rx, self->rx_fill}, &found);
        if (result == CREDIT_BYTES) {
            self->tx_credit = true;
            self->credits_in++;
            drop(self, CREDIT_BYTES);
            continue;
        }
        if (result > 0 && found.route.version != CPX_VERSION) {
            self->bad_version++;
            give_credit(self);
            drop(self, (size_t)result);
            continue;
        }
        if (result > 0) {
            self->packets_in++;
            self->rx_taken = (uint8_t)result;
            *packet = found;
            return true;
        }
        if (result == ERR_SHORT) {
            if (!stale) {
                return false;
            }
            self->gaps += gap_counted ? 0 : 1;
            gap_counted = true;
        } else if (result == ERR_LENGTH) {
            self->bad_length++;
        } else if (result == ERR_CHECK) {
            self->bad_check++;
            give_credit(self);
        }
        self->garbage_bytes++;
        drop(self, 1);
    }
    return false;
}

bool cpx_uart_receive(cpx_uart_t *self, uint8_t byte, uint64_t now_us, cpx_packet_t *packet) {
    if (self->rx_taken > 0) {
        drop(self, self->rx_taken);
        self->rx_taken = 0;
    }
    const bool stale = now_us - self->rx_last_us >= CPX_UART_GAP_US;
    bool found = stale && find_packet(self, true, packet);
    self->rx[self->rx_fill++] = byte;
    self->rx_last_us = now_us;
    found = found || find_packet(self, false, packet);
    if (found) {
        self->held = true;
        self->owes_credit = false;
    }
    return found;
}

void cpx_uart_accept(cpx_uart_t *self) {
    self->held = false;
    give_credit(self);
}

bool cpx_uart_send(cpx_uart_t *self, const cpx_packet_t *packet) {
    if (self->tx_size > 0) {
        return false;
    }
    self->tx_size = (uint8_t)cpx_uart_encode(packet, (bytes_mut_t){self->tx, sizeof self->tx});
    return self->tx_size > 0;
}

static bool frame_may_go(const cpx_uart_t *self) {
    return self->tx_sent > 0 || (self->tx_size > 0 && self->tx_credit);
}

/// When the credit is repeated. Not inside a frame that comes in: the peer is using it, and a repeated one
/// would allow a second packet. What came in whole, as the credits of a peer that only listens, is no reason.
static uint64_t repeat_us(const cpx_uart_t *self) {
    const uint64_t gap_us = self->rx_fill > self->rx_taken ? self->rx_last_us + CPX_UART_GAP_US : 0;
    return self->credit_us > gap_us ? self->credit_us : gap_us;
}

size_t cpx_uart_transmit(cpx_uart_t *self, uint8_t *out, uint64_t now_us) {
    if (self->credit_sent > 0) {
        self->credit_sent = 0;
        self->credit_us = now_us + CPX_UART_CREDIT_US;
        *out = 0;
        return 1;
    }
    const bool repeat = !self->held && now_us >= repeat_us(self);
    if (self->tx_sent == 0 && (self->owes_credit || repeat)) {
        self->credits_repeated += self->owes_credit ? 0 : 1;
        self->owes_credit = false;
        self->credit_sent = 1;
        *out = CPX_UART_START;
        return 1;
    }
    if (!frame_may_go(self)) {
        return 0;
    }
    self->tx_credit = self->tx_sent > 0 && self->tx_credit;
    *out = self->tx[self->tx_sent++];
    if (self->tx_sent == self->tx_size) {
        self->tx_size = 0;
        self->tx_sent = 0;
        self->packets_out++;
    }
    return 1;
}

uint64_t cpx_uart_deadline(const cpx_uart_t *self) {
    if (self->credit_sent > 0 || self->owes_credit || frame_may_go(self)) {
        return 0;
    }
    return self->held ? NEVER_US : repeat_us(self);
}
