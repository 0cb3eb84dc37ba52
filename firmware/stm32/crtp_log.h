/// The Crazyflie's log service (CRTP port 5, protocol version 4 and later): a client reads the table of
/// variables and subscribes to some of them, in blocks, each with a period.
///
/// The variables are those that config.txt can name. A value goes as the type that it has: a block that wants
/// another is refused. Raw memory is never sent.
#ifndef SPINDECK_STM32_CRTP_LOG_H
#define SPINDECK_STM32_CRTP_LOG_H

#include "../core/usd_file.h"
#include "values.h"

enum {
    CRTP_LOG_BLOCKS = 4,
    CRTP_LOG_BYTES_MAX = 26,    ///< of values in a block: a CRTP packet has 30
    CRTP_LOG_PERIOD_US = 10000, ///< periods are given in such steps
    CRTP_LOG_PACKET_MAX = 40,   ///< of CRTP it is 31
};

typedef struct {
    bool used;
    uint8_t id; ///< the client's
    usd_block_t variables;
    uint32_t period_us;
    uint64_t next_us; ///< uptime; NEVER_US: stopped
} crtp_log_block_t;

typedef struct {
    crtp_log_block_t blocks[4];
    uint64_t next_us; ///< uptime at which the next packet of values is due, or NEVER_US
} crtp_log_t;

/// No blocks.
void crtp_log_reset(crtp_log_t *self);

/// A packet for the service (header byte first) and room for the answer. Returns its
/// size, or 0 for what is no request.
size_t crtp_log_receive(crtp_log_t *self, const usd_table_t *table, bytes_t in, uint64_t now_us,
                        uint8_t out[40]);

/// One packet of values that is due (header byte first): its size, or 0 if none is.
size_t crtp_log_values(crtp_log_t *self, const usd_table_t *table, uint64_t now_us, const void *values,
                       uint8_t out[40]);

#endif
