#include "cpx.h"

void cpx_route_encode(const cpx_route_t *route, uint8_t out[2]) {
    out[0] = (uint8_t)((route->destination & 7U) | (route->source & 7U) << 3 |
                       (route->last_packet ? 0x40U : 0U) | (route->reserved ? 0x80U : 0U));
    out[1] = (uint8_t)((route->function & 0x3FU) | (route->version & 3U) << 6);
}

void cpx_route_decode(const uint8_t in[2], cpx_route_t *route) {
    *route = (cpx_route_t){
        .destination = in[0] & 7U,
        .source = in[0] >> 3 & 7U,
        .function = in[1] & 0x3FU,
        .version = in[1] >> 6,
        .last_packet = (in[0] & 0x40U) != 0,
        .reserved = (in[0] & 0x80U) != 0,
    };
}

static bool in_use(uint8_t target) {
    return target >= CPX_STM32 && target <= CPX_GAP8;
}

bool cpx_route_ok(const cpx_route_t *route) {
    return in_use(route->destination) && in_use(route->source) && route->version == CPX_VERSION;
}
