/// config.txt of the uSD card: any text ends with a result, whose blocks and findings are within their
/// bounds, and it does not matter how the text is cut. What it describes makes a header and rows.
#include "claim.h"
#include "input.h"

#include "firmware/core/cpx.h"
#include "firmware/core/usd_file.h"

enum { VARIABLES = 3, EVENTS = 2, VALUES_BYTES = 16, HEADER_MAX = 65536 };

static const usd_variable_t variables[VARIABLES] = {
    {.name = "a.x", .type = 'f', .offset = 0},
    {.name = "a.long_name_of_31_characters_12", .type = 'B', .offset = 4},
    {.name = "pm.b", .type = 'H', .offset = 6},
};
static const usd_event_t events[EVENTS] = {
    {.name = "est", .payload_count = 1, .payload = {{.name = "id", .type = 'b', .offset = 8}}},
    {.name = "x"},
};

static void claim_blocks(const usd_config_t *config) {
    CLAIM(config->block_count <= USD_CONFIG_BLOCKS_MAX);
    CLAIM(config->ring_bytes >= USD_CONFIG_RING_MIN);
    CLAIM(memchr(config->name, 0, sizeof config->name) != NULL && config->name[0] != 0);
    CLAIM(config->period_us <= 1000000 && config->period_us % 1000 == 0);
    bool fixed = false;
    for (uint8_t i = 0; i < config->block_count; i++) {
        const usd_block_t *block = &config->blocks[i];
        CLAIM(block->event < EVENTS || block->event == USD_CONFIG_FIXED);
        CLAIM(block->variable_count <= USD_CONFIG_VARIABLES_MAX);
        for (uint8_t n = 0; n < block->variable_count; n++) {
            CLAIM(block->variables[n] < VARIABLES);
        }
        for (uint8_t n = 0; n < i; n++) {
            CLAIM(config->blocks[n].event != block->event);
        }
        fixed = fixed || block->event == USD_CONFIG_FIXED;
    }
    CLAIM(fixed == (config->period_us > 0));
}

static void claim_file(const usd_config_t *config) {
    static uint8_t header[HEADER_MAX];
    const size_t size = usd_header_encode(config, 0, (bytes_mut_t){header, sizeof header});
    CLAIM(size < sizeof header);
    const uint8_t values[VALUES_BYTES] = {0};
    for (uint8_t i = 0; i < config->block_count; i++) {
        uint8_t row[USD_ROW_BYTES_MAX];
        const usd_block_t *block = &config->blocks[i];
        CLAIM(usd_row_encode(config->table, block, 1, values, row) == usd_row_bytes(config->table, block));
    }
}

static void claim_findings(const usd_config_t *config) {
    const uint32_t count = (uint32_t)config->errors + config->warnings;
    uint16_t line = 1;
    for (uint32_t i = 0; i < count && i < USD_CONFIG_FINDINGS_MAX; i++) {
        CLAIM(config->findings[i].line >= line && config->findings[i].line <= config->line);
        line = config->findings[i].line;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    const usd_table_t table = {variables, events, VARIABLES, EVENTS};
    usd_config_t whole, pieces;
    bytes_t input = {data, size};
    const size_t cut = take_byte(&input);
    usd_config_init(&whole, &table);
    usd_config_init(&pieces, &table);
    usd_config_put(&whole, input);
    usd_config_put(&pieces, take(&input, cut));
    usd_config_put(&pieces, input);
    const int result = usd_config_end(&whole);
    CLAIM(usd_config_end(&pieces) == result);
    CLAIM(memcmp(&whole, &pieces, sizeof whole) == 0);
    CLAIM(result == 0 || result == ERR_VALUE);
    claim_findings(&whole);
    if (result == 0) {
        claim_blocks(&whole);
        claim_file(&whole);
    }
    return 0;
}
