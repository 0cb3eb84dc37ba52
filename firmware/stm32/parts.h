/// The part of the STM32's app that its firmwares differ in, private to it: message.c.
#ifndef SPINDECK_STM32_PARTS_H
#define SPINDECK_STM32_PARTS_H

#include "app.h"

/// Writes the time message of this instant into self->stamp and returns its size.
uint8_t stm32_message(stm32_t *self, instant_t now);

#endif
