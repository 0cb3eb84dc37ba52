#include "parts.h"

bool stm32_reports_asked(stm32_t *self, const cpx_packet_t *packet, uint64_t now_us) {
    native_stream_t stream;
    if (packet->route.source != CPX_HOST || native_stream_decode(packet->data, &stream) < 0) {
        return false;
    }
    self->report_next_us = stream.dialect != 0 ? now_us : NEVER_US;
    return true;
}

void stm32_report(stm32_t *self, instant_t now) {
    const usd_counters_t *counters = &self->log.log.counters;
    const native_log_t report = {
        .state = (uint8_t)self->log.status,
        .epoch = self->epoch,
        .stm32_us = now.stamp_us,
        .files = self->log.files,
        .session = counters->session,
        .requested = counters->requested,
        .accepted = counters->accepted,
        .dropped = counters->dropped,
        .stall_us = counters->stall_us,
        .syncs = counters->syncs,
        .errors = counters->errors,
        .card_errors = self->log.errors,
    };
    uint8_t data[NATIVE_LOG_BYTES];
    native_log_encode(&report, data);
    stm32_send(self, CPX_HOST, CPX_APP, (bytes_t){data, sizeof data});
    self->report_next_us = now.up_us + STM32_REPORT_US;
}
