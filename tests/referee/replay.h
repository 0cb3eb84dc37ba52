/// What replay.c needs of the machine that it runs on. The machine's start-up code calls replay once, with
/// memory initialised and interrupts off.
#ifndef SPINDECK_REFEREE_REPLAY_H
#define SPINDECK_REFEREE_REPLAY_H

#include "../../firmware/core/bytes.h"

/// Waits until it has left over the machine's UART.
void machine_write(bytes_t out);

/// Makes the recorded calls, in their order, and writes after each what it gave:
/// u8 verb << 4 | port, u64 result, and the bytes that a transmit has handed out.
/// After the last one: u8 REPLAY_END. REPLAY_REFUSED: this recording is not for this app.
void replay(void);

enum { REPLAY_END = 0xE0, REPLAY_REFUSED = 0xF0 };

#endif
