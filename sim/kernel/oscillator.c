#include "oscillator.h"

static const int64_t PPT = 1000000000000;
static const int64_t RATE_PPT_MAX = 40000000000; // base, ramp, step and walk together

// Within a segment: |since_ns * rate| <= 1.1e8 * 4e10 = 4.4e18, so that with the bias everything is positive
// and below 2^63, and an unsigned division rounds down.
static int64_t elapsed_local_ns(const oscillator_t *self, int64_t since_ns) {
    const int64_t bias_ns = 4500000;
    uint64_t biased = (uint64_t)(since_ns * self->rate_ppt + self->fraction + bias_ns * PPT);
    return since_ns + (int64_t)(biased / (uint64_t)PPT) - bias_ns;
}

static void anchor(oscillator_t *self, int64_t true_ns) {
    int64_t since_ns = true_ns - self->anchor_ns;
    int64_t gained_ns = elapsed_local_ns(self, since_ns) - since_ns;
    self->fraction += since_ns * self->rate_ppt - gained_ns * PPT;
    self->anchor_local_ns += since_ns + gained_ns;
    self->anchor_ns = true_ns;
}

static void update_rate(oscillator_t *self) {
    int64_t middle_ms = self->segments * OSCILLATOR_SEGMENT_MS + OSCILLATOR_SEGMENT_MS / 2;
    int64_t ramp_ppt =
        middle_ms >= self->ramp_ms ? self->ramp_ppt : self->ramp_ppt * middle_ms / self->ramp_ms;
    bool stepped = self->segments * OSCILLATOR_SEGMENT_NS >= self->step_ns;
    int64_t rate_ppt = self->base_ppt + ramp_ppt + (stepped ? self->step_ppt : 0) + self->walk_ppt;
    self->rate_ppt = rate_ppt > RATE_PPT_MAX    ? RATE_PPT_MAX
                     : rate_ppt < -RATE_PPT_MAX ? -RATE_PPT_MAX
                                                : rate_ppt;
}

static void next_segment(oscillator_t *self) {
    anchor(self, self->segment_ns);
    self->segment_ns += OSCILLATOR_SEGMENT_NS;
    self->segments++;
    if (self->walk_step_ppt != 0) {
        self->walk_ppt += random_normal(&self->random, self->walk_step_ppt);
    }
    update_rate(self);
}

static void advance(oscillator_t *self, int64_t true_ns) {
    while (true_ns >= self->segment_ns) {
        next_segment(self);
    }
}

void oscillator_init(oscillator_t *self, const clock_config_t *config, int64_t origin_ns, random_t random) {
    *self = (oscillator_t){
        .anchor_ns = origin_ns,
        .segment_ns = origin_ns + OSCILLATOR_SEGMENT_NS,
        .base_ppt = config->rate_ppb * 1000,
        .ramp_ppt = config->ramp_ppb * 1000,
        .ramp_ms = config->ramp_ns / 1000000,
        .step_ppt = config->step_ppb * 1000,
        .step_ns = config->step_ns,
        .walk_step_ppt = config->walk_ppb * 316228 / 1000, // sqrt(0.1): ten steps make a second
        .random = random,
    };
    update_rate(self);
}

void oscillator_restart(oscillator_t *self, int64_t true_ns) {
    advance(self, true_ns);
    self->anchor_ns = true_ns;
    self->anchor_local_ns = 0;
    self->fraction = 0;
}

void oscillator_set_rate(oscillator_t *self, int64_t true_ns, int64_t rate_ppb) {
    if (true_ns > self->anchor_ns) { // else it has not been powered up yet
        advance(self, true_ns);
        anchor(self, true_ns);
    }
    self->base_ppt = rate_ppb * 1000;
    update_rate(self);
}

int64_t oscillator_local_ns(oscillator_t *self, int64_t true_ns) {
    advance(self, true_ns);
    return self->anchor_local_ns + elapsed_local_ns(self, true_ns - self->anchor_ns);
}

int64_t oscillator_peek_ns(const oscillator_t *self, int64_t true_ns) {
    oscillator_t copy = *self;
    return oscillator_local_ns(&copy, true_ns);
}

static int64_t when_in_segment_ns(const oscillator_t *self, int64_t wanted_ns) {
    int64_t since_ns = wanted_ns;
    int64_t error_ns = wanted_ns - elapsed_local_ns(self, since_ns);
    for (int step = 0; error_ns != 0 && step < 4; step++) { // each shrinks it by the rate, at most 0.04
        since_ns += error_ns;
        error_ns = wanted_ns - elapsed_local_ns(self, since_ns);
    }
    while (elapsed_local_ns(self, since_ns) < wanted_ns) {
        since_ns++;
    }
    while (since_ns > 0 && elapsed_local_ns(self, since_ns - 1) >= wanted_ns) {
        since_ns--;
    }
    return self->anchor_ns + since_ns;
}

static bool in_segment(const oscillator_t *self, int64_t local_ns) {
    return local_ns - self->anchor_local_ns <= elapsed_local_ns(self, self->segment_ns - self->anchor_ns);
}

int64_t oscillator_when_ns(const oscillator_t *self, int64_t local_ns) {
    if (local_ns <= self->anchor_local_ns) {
        return self->anchor_ns;
    }
    if (in_segment(self, local_ns)) {
        return when_in_segment_ns(self, local_ns - self->anchor_local_ns);
    }
    oscillator_t copy = *self;
    for (int ahead = 0; ahead < OSCILLATOR_AHEAD_SEGMENTS; ahead++) {
        next_segment(&copy);
        if (in_segment(&copy, local_ns)) {
            return when_in_segment_ns(&copy, local_ns - copy.anchor_local_ns);
        }
    }
    return copy.segment_ns;
}
