#include "checks.h"

// A CRC is linear: the entry for a byte is the XOR of the entries for its bits. So a table is written as its
// eight entries for 1, 2, 4 .. 128, and the compiler makes the 256. Row k of CRC32 is the effect of a byte
// with k more bytes behind it; read from the last number of each row to its first, and row by row, the
// numbers are the states of the CRC's shift register started at 1. tests/firmware/test_core_checks.py
// compares every entry with zlib.
// clang-format off
#define BIT(n, k, value) ((n) >> (k) & 1 ? (value) : 0)
#define E(n, a, b, c, d, e, f, g, h) \
    BIT(n, 0, a) ^ BIT(n, 1, b) ^ BIT(n, 2, c) ^ BIT(n, 3, d) ^ BIT(n, 4, e) ^ BIT(n, 5, f) ^ BIT(n, 6, g) ^ BIT(n, 7, h)
#define E4(n, ...) E(n, __VA_ARGS__), E((n) + 1, __VA_ARGS__), E((n) + 2, __VA_ARGS__), E((n) + 3, __VA_ARGS__)
#define E16(n, ...) \
    E4(n, __VA_ARGS__), E4((n) + 4, __VA_ARGS__), E4((n) + 8, __VA_ARGS__), E4((n) + 12, __VA_ARGS__)
#define E64(n, ...) \
    E16(n, __VA_ARGS__), E16((n) + 16, __VA_ARGS__), E16((n) + 32, __VA_ARGS__), E16((n) + 48, __VA_ARGS__)
#define ROW(...) E64(0, __VA_ARGS__), E64(64, __VA_ARGS__), E64(128, __VA_ARGS__), E64(192, __VA_ARGS__)

static const uint16_t CRC16[256] = {
    ROW(0x1021, 0x2042, 0x4084, 0x8108, 0x1231, 0x2462, 0x48C4, 0x9188),
};

enum { SLICES = 16 };

static const uint32_t CRC32[SLICES][256] = {
    {ROW(0x77073096, 0xEE0E612C, 0x076DC419, 0x0EDB8832, 0x1DB71064, 0x3B6E20C8, 0x76DC4190, 0xEDB88320)},
    {ROW(0x191B3141, 0x32366282, 0x646CC504, 0xC8D98A08, 0x4AC21251, 0x958424A2, 0xF0794F05, 0x3B83984B)},
    {ROW(0x01C26A37, 0x0384D46E, 0x0709A8DC, 0x0E1351B8, 0x1C26A370, 0x384D46E0, 0x709A8DC0, 0xE1351B80)},
    {ROW(0xB8BC6765, 0xAA09C88B, 0x8F629757, 0xC5B428EF, 0x5019579F, 0xA032AF3E, 0x9B14583D, 0xED59B63B)},
    {ROW(0x3D6029B0, 0x7AC05360, 0xF580A6C0, 0x30704BC1, 0x60E09782, 0xC1C12F04, 0x58F35849, 0xB1E6B092)},
    {ROW(0xCB5CD3A5, 0x4DC8A10B, 0x9B914216, 0xEC53826D, 0x03D6029B, 0x07AC0536, 0x0F580A6C, 0x1EB014D8)},
    {ROW(0xA6770BB4, 0x979F1129, 0xF44F2413, 0x33EF4E67, 0x67DE9CCE, 0xCFBD399C, 0x440B7579, 0x8816EAF2)},
    {ROW(0xCCAA009E, 0x4225077D, 0x844A0EFA, 0xD3E51BB5, 0x7CBB312B, 0xF9766256, 0x299DC2ED, 0x533B85DA)},
    {ROW(0x177B1443, 0x2EF62886, 0x5DEC510C, 0xBBD8A218, 0xACC04271, 0x82F182A3, 0xDE920307, 0x6655004F)},
    {ROW(0xEFC26B3E, 0x04F5D03D, 0x09EBA07A, 0x13D740F4, 0x27AE81E8, 0x4F5D03D0, 0x9EBA07A0, 0xE6050901)},
    {ROW(0xC18EDFC0, 0x586CB9C1, 0xB0D97382, 0xBAC3E145, 0xAEF6C4CB, 0x869C8FD7, 0xD64819EF, 0x77E1359F)},
    {ROW(0x9BA54C6F, 0xEC3B9E9F, 0x03063B7F, 0x060C76FE, 0x0C18EDFC, 0x1831DBF8, 0x3063B7F0, 0x60C76FE0)},
    {ROW(0xDD96D985, 0x605CB54B, 0xC0B96A96, 0x5A03D36D, 0xB407A6DA, 0xB37E4BF5, 0xBD8D91AB, 0xA06A2517)},
    {ROW(0x9D0FE176, 0xE16EC4AD, 0x19AC8F1B, 0x33591E36, 0x66B23C6C, 0xCD6478D8, 0x41B9F7F1, 0x8373EFE2)},
    {ROW(0xB9FBDBE8, 0xA886B191, 0x8A7C6563, 0xCF89CC87, 0x44629F4F, 0x88C53E9E, 0xCAFB7B7D, 0x4E87F0BB)},
    {ROW(0xAE689191, 0x87A02563, 0xD4314C87, 0x73139F4F, 0xE6273E9E, 0x173F7B7D, 0x2E7EF6FA, 0x5CFDEDF4)},
};
// clang-format on

uint8_t xor8(bytes_t in) {
    uint8_t check = 0;
    for (size_t i = 0; i < in.size; i++) {
        check ^= in.data[i];
    }
    return check;
}

uint16_t crc16_ccitt_false(bytes_t in) {
    uint16_t crc = 0xFFFF;
    for (size_t i = 0; i < in.size; i++) {
        crc = (uint16_t)(crc << 8 ^ CRC16[crc >> 8 ^ in.data[i]]);
    }
    return crc;
}

/// The effect of eight bytes; `rows` is the row of the last of them.
static inline uint32_t slice(const uint32_t rows[][256], uint64_t bytes) {
    return rows[7][bytes & 0xFF] ^ rows[6][bytes >> 8 & 0xFF] ^ rows[5][bytes >> 16 & 0xFF] ^
           rows[4][bytes >> 24 & 0xFF] ^ rows[3][bytes >> 32 & 0xFF] ^ rows[2][bytes >> 40 & 0xFF] ^
           rows[1][bytes >> 48 & 0xFF] ^ rows[0][bytes >> 56];
}

uint32_t crc32_zlib(uint32_t crc, bytes_t in) {
    crc = ~crc;
    size_t at = 0;
    for (; in.size - at >= SLICES; at += SLICES) {
        crc = slice(CRC32 + 8, load64_le(in.data + at) ^ crc) ^ slice(CRC32, load64_le(in.data + at + 8));
    }
    for (; at < in.size; at++) {
        crc = crc >> 8 ^ CRC32[0][(crc ^ in.data[at]) & 0xFF];
    }
    return ~crc;
}
