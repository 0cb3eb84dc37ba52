/// What a robot's configuration may say.
#ifndef SPINDECK_SIM_CONFIG_H
#define SPINDECK_SIM_CONFIG_H

#include "kernel.h"

bool rate_ok(int64_t rate_ppb);
bool duration_ok(int64_t ns);
bool probability_ok(double value);
bool config_ok(const robot_config_t *config);

#endif
