#include "world.h"

void camera_poll(robot_t *r) {
    uint8_t command[GAP8_CAMERA_COMMAND_BYTES];
    if (node_transmit(r, MCU_GAP8, GAP8_PORT_CAMERA, (bytes_mut_t){command, sizeof command}) !=
        sizeof command) {
        return;
    }
    // A command while a capture is under way takes its place: the app has given the old one up.
    camera_t *camera = &r->camera;
    camera->ended = false;
    camera->jpeg = command[1] == IMAGE_JPEG;
    bool hangs = random_chance(&camera->random, camera->hang);
    camera->failed = random_chance(&camera->random, camera->fail) || camera->count == 0 ||
                     (camera->jpeg ? camera->jpegs : camera->raw) == NULL;
    if (hangs) {
        robot_not(r, SOURCE_CAMERA);
        return;
    }
    node_t *node = &r->nodes[MCU_GAP8];
    int64_t exposure_ns = (int64_t)load16_le(command + 6) * r->config.gap8.line_time_ns;
    camera->end_local_ns = node_local_ns(r, node) + r->config.camera_frame_ns + exposure_ns;
    robot_at(r, SOURCE_CAMERA, oscillator_when_ns(&node->oscillator, camera->end_local_ns));
}

static void frame_end(robot_t *r) {
    camera_t *camera = &r->camera;
    node_t *stm32 = &r->nodes[MCU_STM32];
    camera->ended = true;
    camera->truth = (frame_truth_t){
        .true_ns = r->now_ns,
        .stm32_stamp_ns =
            stm32->up ? stamp_clock_exact_ns(&stm32->stamp, node_local_ns(r, stm32)) : INT64_MIN,
        .robot = (int32_t)r->index,
    };
}

void camera_due(robot_t *r) {
    camera_t *camera = &r->camera;
    node_t *gap8 = &r->nodes[MCU_GAP8];
    if (!camera->ended &&
        node_local_ns(r, gap8) < camera->end_local_ns) { // further off than the oscillator looks
        robot_at(r, SOURCE_CAMERA, oscillator_when_ns(&gap8->oscillator, camera->end_local_ns));
        return;
    }
    if (!camera->ended) {
        frame_end(r);
        int64_t jitter_ns = random_exponential(&camera->random, r->config.camera_jitter_ns);
        if (jitter_ns != 0) {
            robot_at(r, SOURCE_CAMERA, r->now_ns + jitter_ns);
            return;
        }
    }
    bytes_t body = {NULL, 0};
    if (!camera->failed) {
        camera->truth.gap8_stamp_us = node_instant(r, gap8).stamp_us;
        camera->truth.frame = camera->completed++;
        camera->truth.boot = gap8->boots - 1;
        camera->truth.image = camera->next;
        body = (camera->jpeg ? camera->jpegs : camera->raw)[camera->next];
        camera->next = camera->next + 1 < camera->count ? camera->next + 1 : 0;
        r->captures[r->captured++] = (capture_t){.known_ns = r->now_ns, .truth = camera->truth};
    }
    node_receive(r, MCU_GAP8, GAP8_PORT_CAMERA, body);
    node_poll(r, MCU_GAP8);
}

void camera_off(robot_t *r) {
    r->camera.ended = false;
    r->camera.completed = 0;
    robot_not(r, SOURCE_CAMERA);
}
