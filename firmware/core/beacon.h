/// The beacon: a host broadcasts its clock over the radio, 1 to 10 times a second, and each robot logs when
/// it came. A CRTP packet of 14 bytes for the app channel (port 13, channel 2), so that a Crazyflie hands it
/// to an app:
///
/// D2 | 62 | u32 sequence | u64 the host's clock, us, read as late as it can before it is sent
/// (docs/PROTOCOL.md, "Beacon"). The radio checks it.
#ifndef SPINDECK_CORE_BEACON_H
#define SPINDECK_CORE_BEACON_H

#include "cpx.h"

enum {
    BEACON_BYTES = 14,
    BEACON_CRTP = 0xD2,
    BEACON_CRTP_MASK = 0xF3, ///< the two bits that are left out are the link's
    BEACON_KIND = 0x62,
};

typedef struct {
    uint32_t sequence; ///< +1 each beacon, wraps
    uint64_t host_us;
} beacon_t;

void beacon_encode(const beacon_t *beacon, uint8_t out[14]);

/// BEACON_BYTES, or ERR_SHORT, ERR_START. `*beacon` is untouched on error.
int beacon_decode(bytes_t in, beacon_t *beacon);

#endif
