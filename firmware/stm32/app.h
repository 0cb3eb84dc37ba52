/// The STM32 flight controller's part: a time message 100 times a second, CPX over UART2, and the log on its
/// card.
///
/// The four verbs (docs/DESIGN.md, "One firmware, four verbs"): the board, or the simulator's kernel, moves
/// bytes between wires and these functions, and nobody else does. After every call of stm32_receive, at the
/// end of every transmission, and when stm32_deadline has come, it calls stm32_transmit on each idle port, in
/// the order of their numbers. The storage counts as idle always: while a request is under way the app has no
/// other, but rows of its log are due even when all lines are busy.
#ifndef SPINDECK_STM32_APP_H
#define SPINDECK_STM32_APP_H

#include "../core/beacon.h"
#include "../core/cpx_uart.h"
#include "../core/echo.h"
#include "../core/image.h"
#include "../core/uart1.h"
#include "crtp_log.h"
#include "log.h"
#include "values.h"

typedef enum {
    STM32_PORT_UART1 = 0,   ///< to the GAP8; from it come questions for an echo
    STM32_PORT_UART2 = 1,   ///< to and from the ESP32
    STM32_PORT_STORAGE = 2, ///< to and from the card (storage.h)
    STM32_PORT_RADIO = 3,   ///< in only: one CRTP packet that was broadcast
    STM32_PORT_COUNT = 4,
} stm32_port_t;

enum {
    STM32_QUEUE_PACKETS = 8, ///< waiting for UART2
    STM32_WIFI_RETRY_US = 2000000,
    STM32_REPORT_US = 1000000, ///< from one message about the log to the next
    STM32_NAME_BYTES = 32,
};

/// stm32_config_t.stamp_format: whose firmware's time messages go out.
typedef enum {
    STM32_NATIVE = 0,
    STM32_PAPER = 1,
    STM32_NANOCOCKPIT = 2,    ///< its time in ticks of 1 ms of the uptime
    STM32_NANOCOCKPIT_US = 3, ///< its time is the stamp clock, as in crazyflie-firmware's example
} stm32_stamp_format_t;

/// Zero is a usable value for every field.
typedef struct {
    uint8_t stamp_format;     ///< stm32_stamp_format_t
    pose_t pose;              ///< where the robot hovers; a quaternion of zeros is no rotation
    float sway_m;             ///< and how far it goes to and fro along x, once in STM32_SWAY_US
    uint32_t stamp_period_us; ///< 0 means STAMP_PERIOD_US; UINT32_MAX: no stamps
    uint8_t wifi_mode;        ///< 0 none: leave the ESP32 alone; 1 access point; 2 station
    char wifi_ssid[32];       ///< NUL-terminated
    char wifi_key[64];        ///< NUL-terminated; empty: an open network
    uint32_t crtp_period_us;  ///< while the host has the bridge on, a CRTP console packet this often; 0: none
    uint32_t mocap_period_us; ///< as if motion capture told the robot its pose this often; 0: it does not
    stm32_log_config_t log;
} stm32_config_t;

typedef struct {
    uint8_t size;
    uint8_t route[2];
    uint8_t data[98];
} stm32_packet_t;

/// Of the GAP8's question, if its answer has not begun to leave.
typedef struct {
    uint8_t heard[5]; ///< the last bytes from the GAP8
    bool waits;
    uint8_t number;
    instant_t received; ///< its last stop bit
} stm32_echo_t;

typedef struct {
    stm32_config_t config;
    cpx_uart_t uart2;
    uint8_t stamp[40];  ///< the message under way
    uint8_t stamp_size; ///< of it
    uint8_t stamp_sent; ///< stamp_size: none under way
    bool stamp_echoes;  ///< the one under way is an answer
    stm32_echo_t echo;
    uint64_t stamp_next_us; ///< uptime
    instant_t stamp_last;   ///< of the last message: a stamp clock that went back starts a new epoch
    uint32_t stamp_sequence;
    uint8_t epoch;
    bool uart2_busy;   ///< a byte is on its way
    uint64_t rests_us; ///< uptime until when, if nothing is received, UART1 alone has bytes; 0: not known
    uint64_t wifi_next_us;
    uint64_t crtp_next_us;
    uint64_t report_next_us; ///< about the log; NEVER_US: the host has not asked
    uint32_t crtp_sequence;
    bool client; ///< a host is connected to the ESP32
    bool bridge; ///< the host wants CRTP over CPX
    stm32_packet_t queue[8];
    uint8_t queue_head;
    uint8_t queue_fill;
    uint32_t stamps_sent;
    uint32_t stamps_late;     ///< periods that passed without a message
    uint32_t packets_dropped; ///< the queue was full
    uint32_t packets_unknown; ///< a function or destination that is not ours
    uint32_t crtp_ignored;    ///< CRTP from host or radio: there is no flight controller behind it
    uint32_t answers_unknown; ///< of the storage, to nothing that was asked
    uint32_t sampled_file;    ///< of log.files, for which the next two hold
    uint64_t imu_next_us;
    uint64_t mocap_next_us;
    attitude_t attitude;
    pose_t external; ///< the last pose that came from outside
    beacon_t beacon; ///< the last that came
    usd_table_t table;
    crtp_log_t telemetry; ///< variables that a client has subscribed to
    stm32_log_t log;
    uint8_t log_ring[STM32_LOG_RING_BYTES];
} stm32_t;

/// 0, or ERR_VALUE for a mode above 2, a format that is none, or a name without its NUL. `self` is the
/// caller's; all of it but the ring's bytes is written. Must not be moved afterwards.
int stm32_init(stm32_t *self, const stm32_config_t *config, instant_t now);

/// Bytes that came in on `port`; `now` is the time of the last stop bit. Returns how many were taken (all).
int stm32_receive(stm32_t *self, stm32_port_t port, bytes_t in, instant_t now);

/// Writes at most what the part's FIFO takes (one byte on a UART, a request on the storage) and returns how
/// much. The caller calls it at the instant when the last byte has left: that instant is the time in a stamp
/// message.
size_t stm32_transmit(stm32_t *self, stm32_port_t port, bytes_mut_t out, instant_t now);

/// The uptime at which stm32_transmit wants to be called even if nothing is received, or NEVER_US. Call
/// it when all idle ports have been asked: one that had nothing is not looked at again before something is
/// due.
uint64_t stm32_deadline(stm32_t *self);

#endif
