/// The parts of the STM32's app, private to it.
#ifndef SPINDECK_STM32_PARTS_H
#define SPINDECK_STM32_PARTS_H

#include "app.h"
#include "grid.h"

// app.c
/// Queues one packet for UART2.
void stm32_send(stm32_t *self, uint8_t destination, uint8_t function, bytes_t data);

// message.c
/// Writes the time message of this instant into self->stamp and returns its size.
uint8_t stm32_message(stm32_t *self, instant_t now);

// echo.c
/// A byte from the GAP8, whose stop bit has just come.
void stm32_echo_hear(stm32_t *self, uint8_t byte, instant_t now);
/// Writes the answer that begins to leave now into self->stamp and returns its size; 0: there is none, or the
/// stamp clock was set since the question.
uint8_t stm32_echo_answer(stm32_t *self, instant_t now);

// rows.c
/// Makes the rows of the log that are due.
void stm32_log_rows(stm32_t *self, instant_t now);
/// A row of this event, if it is wanted.
void stm32_log_event(stm32_t *self, uint16_t event, instant_t now);
/// A position came from outside; the event is STM32_EST_POSE or STM32_EST_POSITION.
void stm32_heard_position(stm32_t *self, const pose_t *pose, uint16_t event, instant_t now);
uint64_t stm32_rows_deadline(const stm32_t *self);
/// What there is to be logged, on the card and over CRTP.
stm32_values_t stm32_values_at(const stm32_t *self, uint64_t up_us);

// report.c
/// A host asks for messages about the log, or for none. False for what is no such request.
bool stm32_reports_asked(stm32_t *self, const cpx_packet_t *packet, uint64_t now_us);
/// Queues one, and says when the next is due.
void stm32_report(stm32_t *self, instant_t now);

// crtp.c
/// A CRTP packet from the host or the radio: a position, a beacon, or usd.logging set. False: there is
/// nothing behind this app for it.
bool stm32_crtp(stm32_t *self, bytes_t in, instant_t now);
/// Queues what is due of the variables that a client has subscribed to: one packet.
void stm32_telemetry(stm32_t *self, instant_t now);

#endif
