/// The STM32's app, whatever comes over UART2 and by radio, whatever the card answers and whenever it is
/// called: what it sends is good stamps without a gap, good CPX frames and good requests, every row of its
/// log is counted, and once it has sent all it has, its deadline lies ahead.
#include "claim.h"
#include "input.h"

#include "firmware/core/uart1.h"
#include "firmware/stm32/app.h"

enum { SENT_AT_ONCE_MAX = 1000 };

static const char CONFIG[] =
    "1\n512\nlog\n1\non:fixedFrequency\n500\n1\nstateEstimate.x\npm.vbatMV\non:estPose\n"
    "locSrv.x\non:estPosition\non:estGyroscope\ngyro.x\non:beacon\n";

typedef struct {
    stm32_t app;
    instant_t now;
    uart1_rx_t gap8;
    uint32_t sequence;
    cpx_uart_t esp32;
    uint8_t request[STORAGE_REQUEST_MAX];
    size_t request_size; ///< 0: none is under way
    bool config_read;
    bool file_open;
} bench_t;

static void hear_stamp(bench_t *self, uint8_t byte) {
    uart1_message_t message;
    uart1_rx_put(&self->gap8, byte);
    if (uart1_rx_take(&self->gap8, &message)) {
        CLAIM(message.size == self->app.stamp_size);
        if (message.kind == UART1_ECHO) {
            CLAIM(message.echo.number == self->app.echo.number && self->app.stamp_echoes);
            CLAIM(self->app.config.stamp_format == STM32_NATIVE);
            return;
        }
        self->sequence++;
        if (message.kind == UART1_STAMP) {
            CLAIM(message.stamp.sequence + 1 == self->sequence);
            CLAIM(message.stamp.epoch == self->app.epoch);
        }
    }
    CLAIM(self->gap8.garbage_bytes == 0);
}

static void hear_cpx(bench_t *self, uint8_t byte) {
    cpx_packet_t packet;
    if (cpx_uart_receive(&self->esp32, byte, 0, &packet)) {
        CLAIM(packet.route.source == CPX_STM32 && packet.data.size > 0);
        cpx_uart_accept(&self->esp32);
    }
    CLAIM(self->esp32.garbage_bytes == 0);
}

static void claim_request(bench_t *self) {
    const uint8_t operation = self->request[0];
    CLAIM(operation >= STORAGE_CREATE && operation <= STORAGE_CLOSE);
    CLAIM(self->file_open == (operation > STORAGE_OPEN));
    CLAIM(self->request_size > 1 || operation >= STORAGE_TRUNCATE);
    self->file_open = self->file_open && operation != STORAGE_CLOSE;
}

static void claim_log(const stm32_log_t *log) {
    const usd_counters_t *counters = &log->log.counters;
    CLAIM(counters->requested == counters->accepted + counters->dropped);
    CLAIM(log->log.written <= log->log.bytes);
    CLAIM(log->log.fill <= log->log.ring_bytes && log->log.fill_max <= log->log.ring_bytes);
}

/// As a card does that has config.txt, unless the fuzzer's byte is an error (negative) or a short write (64
/// and more).
static void answer(bench_t *self, uint8_t choice) {
    uint8_t out[STORAGE_ANSWER_MAX] = {self->request[0]};
    const bool reads = self->request[0] == STORAGE_READ && !self->config_read;
    const size_t data = reads ? sizeof CONFIG - 1 : 0;
    int32_t result = self->request[0] == STORAGE_WRITE ? (int32_t)self->request_size - 1 : (int32_t)data;
    if (choice >= 128 || (choice >= 64 && self->request[0] == STORAGE_WRITE)) {
        result = (int8_t)choice;
    }
    self->config_read = self->config_read || reads;
    self->file_open =
        (self->file_open || self->request[0] <= STORAGE_OPEN) && self->request[0] != STORAGE_CLOSE;
    self->file_open =
        self->file_open && result != STORAGE_NO_CARD && (self->request[0] > STORAGE_OPEN || result >= 0);
    store32_le(out + 1, (uint32_t)result);
    memcpy(out + STORAGE_HEAD_BYTES, CONFIG, data);
    self->request_size = 0;
    const bytes_t in = {out, STORAGE_HEAD_BYTES + data};
    CLAIM(stm32_receive(&self->app, STM32_PORT_STORAGE, in, self->now) == (int)in.size);
    CLAIM(self->app.answers_unknown == 0);
}

/// Everything that goes out now. No credit comes in meanwhile, so it ends.
static void send_all(bench_t *self) {
    uint8_t byte;
    const bytes_mut_t out = {&byte, 1};
    bool sent = true;
    for (int i = 0; sent; i++) {
        CLAIM(i < SENT_AT_ONCE_MAX);
        sent = false;
        if (stm32_transmit(&self->app, STM32_PORT_UART1, out, self->now) > 0) {
            hear_stamp(self, byte);
            sent = true;
        }
        if (stm32_transmit(&self->app, STM32_PORT_UART2, out, self->now) > 0) {
            hear_cpx(self, byte);
            sent = true;
        }
        if (self->request_size == 0) {
            const bytes_mut_t room = {self->request, sizeof self->request};
            self->request_size = stm32_transmit(&self->app, STM32_PORT_STORAGE, room, self->now);
            if (self->request_size > 0) {
                claim_request(self);
            }
        }
    }
    claim_log(&self->app.log);
    CLAIM(stm32_deadline(&self->app) > self->now.up_us);
}

static stm32_config_t make_config(bytes_t *input) {
    const uint8_t choice = take_byte(input);
    stm32_config_t config = {.wifi_mode = choice & 3U};
    if (config.wifi_mode == 3) {
        config.wifi_mode = 0;
        config.stamp_format = 1 + take_byte(input) % 4;
        config.sway_m = (float)take_byte(input);
        config.pose.qx = (float)take_byte(input) - 100;
    }
    config.stamp_period_us = choice & 4U ? take_byte(input) : 0;
    config.crtp_period_us = choice & 8U ? 1U + take_byte(input) : 0;
    config.mocap_period_us = choice & 8U ? 1000U : 0;
    config.log.sync_us = take_byte(input) * 100U;
    const bytes_t ssid = take(input, choice >> 4);
    memcpy(config.wifi_ssid, ssid.data, ssid.size);
    const bytes_t key = take(input, choice & 16U ? sizeof config.wifi_key : 0);
    memcpy(config.wifi_key, key.data, key.size);
    return config;
}

static void wait(bench_t *self, uint64_t us) {
    self->now.up_us += us;
    self->now.stamp_us += us;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static bench_t bench;
    if (size == 0) {
        return 0;
    }
    bytes_t input = {data, size};
    memset(&bench, 0, sizeof bench);
    uart1_rx_init(&bench.gap8, UART1_ALL);
    cpx_uart_init(&bench.esp32, 0);
    const stm32_config_t config = make_config(&input);
    if (stm32_init(&bench.app, &config, bench.now) < 0) {
        return 0;
    }
    while (input.size > 0) {
        const uint8_t choice = take_byte(&input);
        const bytes_t in = take(&input, choice >> 2);
        switch (choice & 3U) {
        case 0:
            if (in.size == 0) {
                uint8_t question[ECHO_QUESTION_BYTES];
                echo_question_encode(choice, question);
                const bytes_t asked = {question, sizeof question};
                CLAIM(stm32_receive(&bench.app, STM32_PORT_UART1, asked, bench.now) == (int)asked.size);
            }
            CLAIM(stm32_receive(&bench.app, STM32_PORT_UART1, in, bench.now) == (int)in.size);
            CLAIM(stm32_receive(&bench.app, STM32_PORT_UART2, in, bench.now) == (int)in.size);
            break;
        case 1:
            wait(&bench, take_us(&input));
            break;
        case 2:
            if (bench.request_size > 0) {
                answer(&bench, take_byte(&input));
            } else if (in.size > 0) {
                CLAIM(stm32_receive(&bench.app, STM32_PORT_RADIO, in, bench.now) == (int)in.size);
            } else {
                bench.now.stamp_us = 0; // the stamp clock is reset
            }
            break;
        default:
            send_all(&bench);
        }
    }
    send_all(&bench);
    return 0;
}
