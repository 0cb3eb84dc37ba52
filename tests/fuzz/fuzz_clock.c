/// Whatever the readings of both clocks: a time is given with a bound or not at all, its state stays in
/// range, and no arithmetic overflows.
#include "claim.h"
#include "firmware/core/clock.h"
#include "firmware/core/image.h"
#include "input.h"

static uint64_t take_step(bytes_t *in) {
    const uint8_t kind = take_byte(in);
    const uint64_t low = (uint64_t)take_byte(in) << 8 | take_byte(in);
    // Mostly steps like those of 100 messages a second, sometimes anything.
    return kind < 0xE0 ? 4000 + low % 12000 : low << (kind % 64U);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    bytes_t in = {data, size};
    static const uint32_t TICKS_NS[] = {0, 1000, 30518, 1000000};
    clock_track_t track;
    clock_track_init(&track,
                     &(clock_known_t){TICKS_NS[take_byte(&in) % 4U], CLOCK_STAMP_WIRE_NS, take_byte(&in)});
    uint64_t stm32_us = take_step(&in);
    uint64_t gap8_us = take_step(&in);
    while (in.size > 0) {
        const uint8_t kind = take_byte(&in);
        if (kind % 4U == 0) {
            const uint64_t step = take_step(&in);
            clock_time_t time;
            clock_track_stamp(&track, gap8_us + ((kind & 4U) != 0 ? step : 0), (kind & 8U) == 0, &time);
            CLAIM(((time.flags & FRAME_REFUSED) != 0) != ((time.flags & FRAME_HAS_ESTIMATE) != 0));
            CLAIM(((time.flags & FRAME_HAS_BOUND) != 0) == ((time.flags & FRAME_HAS_ESTIMATE) != 0));
            CLAIM((time.flags & FRAME_HAS_BOUND) == 0 || time.bound_us <= CLOCK_BOUND_MAX_US);
        } else {
            // The same message over and over is the way to long runs.
            const uint64_t stm32_step = take_step(&in);
            const uint64_t gap8_step = take_step(&in);
            const unsigned times = (kind & 8U) != 0 ? 1 : 64;
            for (unsigned i = 0; i < times; i++) {
                stm32_us += stm32_step;
                gap8_us += gap8_step;
                clock_track_take(&track, stm32_us, gap8_us, kind > 0xF8);
            }
        }
        CLAIM(track.blocks_fill <= CLOCK_BLOCKS && track.frames_fill <= CLOCK_FRAMES);
    }
    return 0;
}
