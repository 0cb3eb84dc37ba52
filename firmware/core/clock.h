/// The STM32's stamp clock as the GAP8 sees it: from pairs (stamp sent, GAP8 clock when it had come) to the
/// time of a frame, with a bound.
///
/// A message can only be late. So T - G of all messages lies below the wanted line, and touches it where
/// there was no delay. Messages are gathered in blocks of which the earliest message is kept; four times a
/// second the upper convex hull of the newest 8, 16, 32 and 64 blocks gives a line each. The longest window
/// that the oscillators allow is used: how far the lines are apart says how much they wander (docs/DESIGN.md,
/// "Time on the GAP8"). A delay that all messages share cannot be seen and is not in the bound.
///
/// In ticks of more than 0.1 ms no message shows that edge to less than a tick. There the blocks' means say
/// more: a line among them, lifted by the mean delay, which messages' scatter shows. It is used while the
/// blocks agree that clocks and delays are steady and nothing speaks against the edge; it never leaves the
/// edge by more than a tick. Delays of less than a fifth of a tick hardly move a message from one tick to the
/// next: it may then be half a tick off.
///
/// Integers only. A message costs one multiplication (in coarse ticks three) and no division, and once per
/// block some passes over 64 points. The clocks are raw readings of 32 bits or more, which may wrap;
/// differences are taken in 32 bits.
#ifndef SPINDECK_CORE_CLOCK_H
#define SPINDECK_CORE_CLOCK_H

#include <stdbool.h>
#include <stdint.h>

enum {
    CLOCK_BLOCKS = 64,
    CLOCK_WINDOWS = 4,
    CLOCK_RECENT = 32,
    CLOCK_HELD = 6,    ///< messages in a row that agree with each other and not with the line: a leap
    CLOCK_FRAMES = 64, ///< of the dejitter
    CLOCK_YOUNG_US = 1000000,
    CLOCK_AGE_MAX_US =
        10000000, ///< without messages no time is given after this; after twice it all begins anew
    CLOCK_BOUND_MAX_US = 20000,    ///< nor with a wider bound
    CLOCK_STAMP_WIRE_NS = 1477381, ///< 17 bytes of 10 bits at 42 MHz / 365: from the first bit to the last
};

typedef struct {
    uint32_t tick_ns;    ///< step of the GAP8's stamp clock; 0: 1000
    uint32_t delay_ns;   ///< known delay of every message: that of its bits on the wire
    uint32_t latency_us; ///< after the end of a frame, until its reading: 99 % of frames have less
} clock_known_t;

typedef struct {
    int32_t gap8_us;    ///< of the earliest message, after the anchor
    int32_t ahead_us;   ///< its T - G
    uint16_t count;     ///< messages; 0: the block is empty
    uint16_t below_us;  ///< in coarse ticks: by how much their mean is below it,
    uint16_t spread_us; ///< and their deviation from it; the most: nothing can be said of them
} clock_block_t;

/// Of a block's messages, where ticks are coarse; from the first of them.
typedef struct {
    int64_t y_us; ///< how far they are above the line through it
    uint64_t square_us;
    int32_t gap8_us;
    int32_t ahead_us;
    uint16_t count;
    uint16_t late; ///< so much that they are not among these
} clock_sums_t;

/// b + s g, of T - G in us * 256, g in us after the anchor.
typedef struct {
    int64_t ahead_q8;
    int32_t skew_q31;
} clock_line_t;

/// The line of blocks' means in coarse ticks, lifted to where no message is late.
typedef struct {
    clock_line_t line;
    uint32_t noise_q8;
    uint32_t count; ///< messages; 0: there is none
} clock_means_t;

/// How far the line of a window has been from that of half its length: means over `count` blocks.
typedef struct {
    uint64_t square_q16;
    int64_t mean_q16;
    int32_t votes_q16;  ///< how often it was farther than delays explain
    uint32_t newest_q8; ///< not a mean
    uint8_t count;
} clock_apart_t;

typedef struct {
    clock_known_t known;
    bool anchored; ///< a message has come since the beginning of the epoch
    bool expired;  ///< none for so long that the next one begins anew
    bool fitted;   ///< `line` says more than the first message
    bool skewed;   ///< `skew_q31` is known, maybe from an earlier epoch
    bool young;    ///< the epoch began less than CLOCK_YOUNG_US ago
    bool first;    ///< and it is the first
    uint8_t epoch; ///< as the STM32 counts them
    uint8_t stuck; ///< messages in a row with the same stamp
    uint64_t anchor_stm32_us;
    uint64_t anchor_gap8_us;
    uint64_t last_stm32_us; ///< message that came last, whatever it was taken for
    uint64_t last_gap8_us;
    uint64_t used_stm32_us; ///< message that was taken last
    uint64_t used_gap8_us;
    uint64_t begin_gap8_us; ///< of the epoch
    clock_line_t line;      ///< as fitted, and lifted since by earlier messages
    int32_t skew_q31;
    uint32_t noise_q8;  ///< parts of the bound: delays,
    uint32_t wander_q8; ///< oscillators
    uint32_t window_us; ///< that the line is from
    uint32_t window_count;
    uint32_t mean_q8;       ///< delay over the smallest, us * 256
    clock_apart_t apart[3]; ///< of the windows, from the second on
    uint32_t recent_q8[32]; ///< how late the newest messages were by the line, ring
    uint8_t recent_head;
    uint8_t recent_fill;
    uint32_t doubt_recent_us;  ///< by how much the line may be wrong: by these,
    uint32_t doubt_blocks_us;  ///< by the newest blocks,
    uint32_t doubt_sag_us;     ///< by the blocks of its window,
    uint32_t doubt_stray_us;   ///< by a rate that stepped,
    uint32_t doubt_windows_us; ///< by the lines of shorter windows,
    uint32_t doubt_early_us;   ///< by a message that was too early
    uint8_t doubt_early_blocks;
    clock_block_t blocks[64]; ///< oldest first
    uint8_t blocks_fill;
    uint32_t block_us;    ///< length of a block
    clock_block_t open;   ///< block under way
    int64_t open_best_q8; ///< its best message against the line
    clock_sums_t sums;
    clock_means_t means;
    int32_t open_begin_us;
    uint64_t held_stm32_us; ///< first of the messages that agree with each other and not with the line
    uint64_t held_gap8_us;
    uint8_t held_fill;
    uint32_t dropped;            ///< messages that were not taken
    uint32_t leaps;              ///< of the STM32's clock that no message announced
    uint32_t frames_gap8_us[64]; ///< readings at the ends of the newest frames, ring,
    uint32_t frames_number[64];  ///< and the frames' numbers, those counted that did not come
    uint8_t frames_head;
    uint8_t frames_fill;
    uint8_t frames_off; ///< frames in a row that are not on the line of these
} clock_track_t;

typedef struct {
    uint16_t flags; ///< FRAME_* of image.h
    uint8_t epoch;
    uint64_t stm32_us;
    uint32_t bound_us;   ///< either side, 99 %
    uint32_t latency_us; ///< in bound_us: how well it is known how late the frame's end was read
    uint32_t age_us;     ///< since the last message that was taken
    uint32_t window_us;
    uint32_t window_count; ///< messages in it
    uint32_t mean_us;      ///< delay, above the smallest
    int32_t skew_ppb;      ///< of the STM32's clock against the GAP8's
} clock_time_t;

void clock_track_init(clock_track_t *self, const clock_known_t *known);

/// A message that has passed its check; `gap8_us` when its last bit had come.
void clock_track_take(clock_track_t *self, uint64_t stm32_us, uint64_t gap8_us, uint8_t epoch);

/// The time of a frame that has ended; its end was read at `gap8_us`. Frames are given in their order.
/// `regular`: it began when it was due, at one rate with those before it.
void clock_track_stamp(clock_track_t *self, uint64_t gap8_us, bool regular, clock_time_t *time);

#endif
