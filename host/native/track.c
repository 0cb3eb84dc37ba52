#include "track.h"

enum { NEAR_KNOTS = 8 };

typedef struct {
    double offset, rate;
    double oo, orr, rr; // covariance: offset with offset, offset with rate, rate with rate
} state_t;

static state_t predict(state_t s, double dt, double wander) {
    return (state_t){
        .offset = s.offset + s.rate * dt,
        .rate = s.rate,
        .oo = s.oo + dt * (2 * s.orr + dt * s.rr) + wander * dt * dt * dt / 3,
        .orr = s.orr + dt * s.rr + wander * dt * dt / 2,
        .rr = s.rr + wander * dt,
    };
}

static state_t update(state_t s, double value, double variance) {
    const double total = s.oo + variance;
    const double gain_o = s.oo / total;
    const double gain_r = s.orr / total;
    const double error = value - s.offset;
    return (state_t){
        .offset = s.offset + gain_o * error,
        .rate = s.rate + gain_r * error,
        .oo = s.oo * variance / total,
        .orr = s.orr * variance / total,
        .rr = s.rr - gain_r * s.orr,
    };
}

/// Adds A S A^T to `to`; A is {{a00, a01}, {a10, a11}}.
static void add(state_t *to, double a00, double a01, double a10, double a11, state_t s) {
    to->oo += a00 * (a00 * s.oo + a01 * s.orr) + a01 * (a00 * s.orr + a01 * s.rr);
    to->orr += a10 * (a00 * s.oo + a01 * s.orr) + a11 * (a00 * s.orr + a01 * s.rr);
    to->rr += a10 * (a10 * s.oo + a11 * s.orr) + a11 * (a10 * s.orr + a11 * s.rr);
}

/// What is known of `s` when its successor is known to be `next`, `dt` later. Only sums of what is positive:
/// where nothing was known of `s`, a difference of covariances would be all rounding.
static state_t look_back(state_t s, state_t next, double dt, double wander) {
    const state_t sure = predict(s, dt, 0); // without the wander
    const state_t p = predict(s, dt, wander);
    const state_t q = {.oo = wander * dt * dt * dt / 3, .orr = wander * dt * dt / 2, .rr = wander * dt};
    const double det = p.oo * p.rr - p.orr * p.orr;
    if (!(det > 0)) {
        return s;
    }
    // Q P^-1: how much of what lies between the prediction and the successor is wander.
    const double k00 = (q.oo * p.rr - q.orr * p.orr) / det;
    const double k01 = (q.orr * p.oo - q.oo * p.orr) / det;
    const double k10 = (q.orr * p.rr - q.rr * p.orr) / det;
    const double k11 = (q.rr * p.oo - q.orr * p.orr) / det;
    state_t m = {
        .offset = next.offset + k00 * (p.offset - next.offset) + k01 * (p.rate - next.rate),
        .rate = next.rate + k10 * (p.offset - next.offset) + k11 * (p.rate - next.rate),
    };
    add(&m, 1 - k00, -k01, -k10, 1 - k11, next);
    add(&m, 1 - k00, -k01, -k10, 1 - k11, q);
    add(&m, k00, k01, k10, k11, sure);
    return predict(m, -dt, 0);
}

static void keep(double *work, state_t s) {
    work[0] = s.offset;
    work[1] = s.rate;
    work[2] = s.oo;
    work[3] = s.orr;
    work[4] = s.rr;
}

static state_t kept(const double *work) {
    return (state_t){.offset = work[0], .rate = work[1], .oo = work[2], .orr = work[3], .rr = work[4]};
}

void track_smooth(size_t count, const double *times, const double *values, const double *variances,
                  double wander, double rate_variance, double *work, double *offsets, double *rates,
                  double *offset_variances) {
    if (count == 0) {
        return;
    }
    state_t s = {.offset = values[0], .rate = 0, .oo = variances[0], .orr = 0, .rr = rate_variance};
    keep(work, s);
    for (size_t i = 1; i < count; i++) {
        s = update(predict(s, times[i] - times[i - 1], wander), values[i], variances[i]);
        keep(work + TRACK_WORK * i, s);
    }
    for (size_t i = count; i-- > 0;) {
        if (i + 1 < count) {
            const double dt = times[i + 1] - times[i];
            const state_t here = kept(work + TRACK_WORK * i);
            s = look_back(here, s, dt, wander);
        }
        offsets[i] = s.offset;
        rates[i] = s.rate;
        offset_variances[i] = s.oo;
    }
}

/// The last knot but one at most, at or before `time`; `near` is where to look first.
static size_t knot_before(size_t knots, const double *knot_times, double time, size_t near) {
    if (time >= knot_times[near]) {
        for (size_t i = near; i < near + NEAR_KNOTS && i + 2 < knots; i++) {
            if (time < knot_times[i + 1]) {
                return i;
            }
        }
    }
    size_t low = 0;
    size_t high = knots - 1;
    while (high - low > 1) {
        const size_t middle = low + (high - low) / 2;
        if (time < knot_times[middle]) {
            high = middle;
        } else {
            low = middle;
        }
    }
    return low;
}

static double cubic(const double *knot_times, const double *offsets, const double *rates, double time) {
    const double span = knot_times[1] - knot_times[0];
    const double u = (time - knot_times[0]) / span;
    if (u < 0) {
        return offsets[0] + rates[0] * span * u;
    }
    if (u > 1) {
        return offsets[1] + rates[1] * span * (u - 1);
    }
    const double rise = offsets[1] - offsets[0];
    const double out = rates[0] * span;
    const double in = rates[1] * span;
    return offsets[0] + u * (out + u * (3 * rise - 2 * out - in + u * (out + in - 2 * rise)));
}

void track_values(size_t knots, const double *knot_times, const double *offsets, const double *rates,
                  size_t count, const double *times, double *values) {
    size_t at = 0;
    for (size_t i = 0; i < count; i++) {
        if (knots == 1) {
            values[i] = offsets[0] + rates[0] * (times[i] - knot_times[0]);
        } else {
            at = knot_before(knots, knot_times, times[i], at);
            values[i] = cubic(knot_times + at, offsets + at, rates + at, times[i]);
        }
    }
}
