#include "wire.h"

static const int64_t FAULT_NS_MAX = (int64_t)1 << 50; // 13 days
static const double FAULTS_PER_S_MAX = 1000;

static bool time_ok(int64_t ns) {
    return ns >= 0 && ns <= FAULT_NS_MAX;
}

static bool within(double value, double max) {
    return value >= 0 && value <= max;
} // NaN is not

bool wire_faults_ok(const wire_faults_t *faults) {
    return time_ok(faults->latency_ns) && time_ok(faults->jitter_ns) && time_ok(faults->burst_ns) &&
           time_ok(faults->stall_ns) && within(faults->loss, 1) && within(faults->duplicate, 1) &&
           within(faults->reorder, 1) && within(faults->drop, 1) && within(faults->flip, 1) &&
           within(faults->burst_per_s, FAULTS_PER_S_MAX) && within(faults->stall_per_s, FAULTS_PER_S_MAX);
}

static int64_t mean_between_ns(double per_s) {
    return per_s < 1e-6 ? 0 : (int64_t)(1e9 / per_s);
}

void carrier_set_faults(carrier_t *self, const wire_faults_t *faults, int64_t now_ns) {
    self->faults = *faults;
    self->loss = random_threshold(faults->loss);
    self->duplicate = random_threshold(faults->duplicate);
    self->reorder = random_threshold(faults->reorder);
    self->drop = random_threshold(faults->drop);
    self->flip = random_threshold(faults->flip);
    self->burst_mean_ns = mean_between_ns(faults->burst_per_s);
    self->stall_mean_ns = mean_between_ns(faults->stall_per_s);
    self->faulty = faults->latency_ns != 0 || faults->jitter_ns != 0 || self->loss != 0 ||
                   self->duplicate != 0 || self->reorder != 0 || self->drop != 0 || self->flip != 0 ||
                   self->burst_mean_ns != 0 || self->stall_mean_ns != 0;
    self->burst_start_ns = now_ns + random_exponential(&self->random, self->burst_mean_ns);
    self->burst_end_ns = self->burst_start_ns + random_exponential(&self->random, faults->burst_ns);
    self->stall_next_ns = now_ns + random_exponential(&self->random, self->stall_mean_ns);
}

static bool in_burst(carrier_t *self, int64_t now_ns) {
    while (self->burst_mean_ns != 0 && now_ns >= self->burst_end_ns) {
        self->burst_start_ns =
            self->burst_end_ns + 1 + random_exponential(&self->random, self->burst_mean_ns);
        self->burst_end_ns = self->burst_start_ns + random_exponential(&self->random, self->faults.burst_ns);
    }
    return self->burst_mean_ns != 0 && now_ns >= self->burst_start_ns;
}

bool carrier_loses(carrier_t *self, int64_t now_ns) {
    bool lost = random_chance(&self->random, self->loss);
    lost = in_burst(self, now_ns) || lost;
    self->counts.lost += lost;
    return lost;
}

bool carrier_duplicates(carrier_t *self) {
    return random_chance(&self->random, self->duplicate);
}

bool carrier_reorders(carrier_t *self) {
    return random_chance(&self->random, self->reorder);
}

int64_t carrier_delay_ns(carrier_t *self) {
    return self->faults.latency_ns + random_exponential(&self->random, self->faults.jitter_ns);
}

size_t carrier_damage(carrier_t *self, uint8_t *bytes, size_t size) {
    if (self->drop == 0 && self->flip == 0) {
        return size;
    }
    size_t left = 0;
    for (size_t i = 0; i < size; i++) {
        if (random_chance(&self->random, self->drop)) {
            self->counts.dropped++;
            continue;
        }
        uint8_t byte = bytes[i];
        if (random_chance(&self->random, self->flip)) {
            byte ^= (uint8_t)(1u << (random_next(&self->random) >> 61));
            self->counts.flipped++;
        }
        bytes[left++] = byte;
    }
    return left;
}

void carrier_draw_stalls(carrier_t *self, int64_t now_ns) {
    while (now_ns >= self->stall_next_ns) {
        int64_t end_ns = self->stall_next_ns + random_exponential(&self->random, self->faults.stall_ns);
        if (end_ns > self->stall_until_ns) {
            self->stall_until_ns = end_ns;
        }
        self->stall_next_ns = end_ns + 1 + random_exponential(&self->random, self->stall_mean_ns);
        self->counts.stalls++;
    }
}
