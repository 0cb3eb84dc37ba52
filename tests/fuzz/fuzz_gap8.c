/// The GAP8's app, whatever comes over UART1, SPI and from the camera: what it sends are packets that decode,
/// native ones whole, and once it has sent all it has, its deadline lies ahead. It keeps no body beyond its
/// time.
#include "claim.h"
#include "input.h"

#include "firmware/gap8/app.h"

enum { SIDE = 40, BODY_MAX = SIDE * SIDE, SENT_AT_ONCE_MAX = 200 };

typedef struct {
    gap8_t app;
    instant_t now;
    uint8_t *bodies[GAP8_SLOTS]; ///< exactly as large as given, freed when the slot is used again
    int slot;                    ///< of the capture under way
    uint8_t question[ECHO_QUESTION_BYTES];
    uint8_t asked; ///< bytes of it
    uint32_t sequence;
} bench_t;

static void hear_native(bytes_t data) {
    native_frame_t frame;
    native_pair_t pairs[NATIVE_PAIRS_MAX];
    native_reply_t reply;
    uint16_t frame_low;
    uint32_t number;
    size_t count;
    bytes_t body;
    switch (data.data[1]) {
    case NATIVE_FRAME:
        CLAIM(native_frame_decode(data, &frame) == (int)data.size);
        break;
    case NATIVE_DATA:
        CLAIM(native_data_decode(data, &frame_low, &number, &body) == (int)data.size);
        CLAIM(number + body.size <= BODY_MAX);
        break;
    case NATIVE_PAIRS:
        CLAIM(native_pairs_decode(data, pairs, &count, &number) == (int)data.size);
        break;
    default:
        CLAIM(native_reply_decode(data, &reply) == (int)data.size);
    }
}

/// A packet of NanoCockpit's.
static void hear_buffer(bytes_t out) {
    cpx_packet_t packet;
    nanocockpit_begin_t begin;
    nanocockpit_metadata_t metadata;
    CLAIM(nanocockpit_link_decode(out, &packet) == (int)out.size);
    CLAIM(packet.route.function == CPX_STREAMER && out.size % 4 == 0);
    if (packet.data.data[0] == NANOCOCKPIT_MORE) {
        CLAIM(nanocockpit_more_decode(packet.data) > 0);
        return;
    }
    const int head = nanocockpit_begin_decode(packet.data, &begin);
    CLAIM(head > 0);
    const bytes_t rest = {packet.data.data + head, packet.data.size - (size_t)head};
    CLAIM(nanocockpit_metadata_decode(rest, &metadata) > 0);
    CLAIM(begin.size == NANOCOCKPIT_METADATA_BYTES + (uint32_t)metadata.width * metadata.height);
}

/// False when there is nothing to send.
static bool hear_spi(bench_t *self) {
    uint8_t out[NANOCOCKPIT_FRAME_MAX];
    const bool native = self->app.sending >= 0 ? self->app.send_native : self->app.stream.dialect != 0;
    const bool reply = self->app.queue_fill > 0;
    const size_t size = gap8_transmit(&self->app, GAP8_PORT_SPI, (bytes_mut_t){out, sizeof out}, self->now);
    if (size == 0) {
        return false;
    }
    if (self->app.config.firmware == GAP8_NANOCOCKPIT) {
        hear_buffer((bytes_t){out, size});
        return true;
    }
    cpx_packet_t packet;
    CLAIM(cpx_link_decode((bytes_t){out, size}, &packet) == (int)size);
    CLAIM(cpx_route_ok(&packet.route) && packet.route.source == CPX_GAP8 && packet.data.size > 0);
    if (packet.route.function == CPX_APP && (native || reply)) {
        CLAIM(packet.data.data[0] == NATIVE_MAGIC);
        hear_native(packet.data);
    }
    return true;
}

static bool hear_camera(bench_t *self) {
    uint8_t command[GAP8_CAMERA_COMMAND_BYTES];
    if (gap8_transmit(&self->app, GAP8_PORT_CAMERA, (bytes_mut_t){command, sizeof command}, self->now) == 0) {
        return false;
    }
    CLAIM(command[0] < GAP8_SLOTS);
    self->slot = command[0];
    free(self->bodies[self->slot]);
    self->bodies[self->slot] = NULL;
    return true;
}

/// Whole questions: false when there is nothing to send.
static bool hear_uart(bench_t *self) {
    uint8_t out[ECHO_QUESTION_BYTES];
    const size_t most = 1 + self->now.up_us % sizeof out;
    const size_t size = gap8_transmit(&self->app, GAP8_PORT_UART1, (bytes_mut_t){out, most}, self->now);
    CLAIM(size <= most);
    for (size_t i = 0; i < size; i++) {
        CLAIM(self->app.config.firmware == GAP8_NATIVE && self->app.config.echo_period_us != 0);
        self->question[self->asked++] = out[i];
        if (self->asked == ECHO_QUESTION_BYTES) {
            uint8_t number;
            CLAIM(echo_question_decode((bytes_t){self->question, self->asked}, &number) > 0);
            CLAIM(number == self->app.echo.number);
            self->asked = 0;
        }
    }
    return size > 0;
}

/// A good stamp, or a good answer to the last question.
static void good(bench_t *self, uint8_t choice) {
    uint8_t message[STAMP_BYTES];
    const stamp_t stamp = {self->sequence++, self->now.stamp_us, 0};
    const echo_answer_t answer = {self->app.echo.number, self->now.stamp_us, choice * 10U};
    if (choice & 8U) {
        stamp_encode(&stamp, message);
    } else {
        echo_answer_encode(&answer, message);
    }
    const bytes_t in = {message, sizeof message};
    CLAIM(gap8_receive(&self->app, GAP8_PORT_UART1, in, self->now) == (int)in.size);
    CLAIM(self->app.echo.count[0] <= GAP8_ECHO_HALF && self->app.echo.count[1] <= GAP8_ECHO_HALF);
}

static void send_all(bench_t *self) {
    bool sent = true;
    for (int i = 0; sent; i++) {
        CLAIM(i < SENT_AT_ONCE_MAX);
        sent = hear_spi(self);
        sent = hear_camera(self) || sent;
        sent = hear_uart(self) || sent;
    }
    CLAIM(gap8_deadline(&self->app) > self->now.up_us);
}

/// Ends the capture: the right size for a raw picture, or another one.
static void capture(bench_t *self, bytes_t in) {
    if (self->slot < 0) {
        return;
    }
    const size_t raw = (size_t)self->app.config.width * self->app.config.height;
    const size_t size = in.size > 0 && in.data[0] & 1U ? in.size : raw;
    uint8_t *body = calloc(size + 1, 1);
    memcpy(body, in.data, in.size < size ? in.size : size);
    self->bodies[self->slot] = realloc(body, size + (size == 0));
    CLAIM(gap8_receive(&self->app, GAP8_PORT_CAMERA, (bytes_t){self->bodies[self->slot], size}, self->now) ==
          (int)size);
    self->slot = -1;
}

static int init(bench_t *self, bytes_t *input) {
    const uint8_t choice = take_byte(input);
    const uint8_t firmware = (choice >> 4 & 1U) | (choice >> 5 & 2U);
    const gap8_config_t config = {
        .width = SIDE,
        .height = 1 + choice % SIDE,
        .camera = {.auto_exposure = choice & 1U,
                   .analog_gain = 1,
                   .digital_gain = 64,
                   .burst = 1 + choice % 3,
                   .encoding = firmware == GAP8_NANOCOCKPIT ? IMAGE_RAW : choice >> 1 & 1U,
                   .exposure_lines = 100,
                   .frame_period_us = choice & 4U ? 1U + take_byte(input) * 1000U : 0},
        .stamp_tick_ns = choice & 8U ? 30518 : 0,
        .frame_latency_us = choice & 16U ? 100 : 0,
        .stamp_bits = choice & 8U ? 32 : 0,
        .firmware = firmware,
        .paper = choice & 15U,
        .nanocockpit_check = (choice & 1U) != 0,
        .stream_always = (choice & 32U) != 0,
        .echo_period_us = choice & 1U ? 1000 : 0,
    };
    self->slot = -1;
    return gap8_init(&self->app, &config, self->now);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static bench_t bench;
    bytes_t input = {data, size};
    memset(&bench, 0, sizeof bench);
    CLAIM(init(&bench, &input) == 0);
    while (input.size > 0) {
        const uint8_t choice = take_byte(&input);
        const bytes_t in = choice % 6 < 3 ? take(&input, choice / 6) : (bytes_t){input.data, 0};
        switch (choice % 6) {
        case 0:
            if (in.size == 0) {
                good(&bench, choice);
            }
            CLAIM(gap8_receive(&bench.app, GAP8_PORT_UART1, in, bench.now) == (int)in.size);
            break;
        case 1:
            CLAIM(gap8_receive(&bench.app, GAP8_PORT_SPI, in, bench.now) == (int)in.size);
            break;
        case 2:
            capture(&bench, in);
            break;
        case 3: {
            const uint64_t us = take_us(&input);
            bench.now.up_us += us;
            bench.now.stamp_us += us;
            break;
        }
        case 4:
            (void)(choice & 8U ? hear_spi(&bench) : hear_camera(&bench));
            break;
        default:
            send_all(&bench);
        }
    }
    send_all(&bench);
    for (int slot = 0; slot < GAP8_SLOTS; slot++) {
        free(bench.bodies[slot]);
    }
    return 0;
}
