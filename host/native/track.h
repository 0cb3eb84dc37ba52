/// A clock's offset and rate, followed through noisy readings of the offset in both directions.
///
/// The rate wanders at random (a Wiener process), the offset is its integral: a Kalman filter forwards, then
/// the smoother of Rauch, Tung and Striebel backwards. All memory is the caller's. Cost: O(count).
#ifndef SPINDECK_HOST_TRACK_H
#define SPINDECK_HOST_TRACK_H

#include <stddef.h>

enum { TRACK_WORK = 5 }; ///< doubles of work space for each reading

/// `times` increase strictly. `wander` is the growth of the rate's variance with time; all units are the
/// caller's, the same in all arguments. `rate_variance` is that of the rate before the first reading.
/// Out, for each reading: offset, rate, and the offset's variance.
void track_smooth(size_t count, const double *times, const double *values, const double *variances,
                  double wander, double rate_variance, double *work, double *offsets, double *rates,
                  double *offset_variances);

/// The curve through `knots` (1 or more, times increasing strictly) at `count` times: cubic between knots,
/// straight outside. Quick when the times are in order; in any other, a binary search for each.
void track_values(size_t knots, const double *knot_times, const double *offsets, const double *rates,
                  size_t count, const double *times, double *values);

#endif
