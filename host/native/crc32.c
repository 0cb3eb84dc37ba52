#include "crc32.h"

#include "../../firmware/core/checks.h"

#if defined(__GNUC__) && defined(__x86_64__)

#include <immintrin.h>

enum { LANE = 16, STEP = 4 * LANE, WIDE = 256 };

// What a carry-less product with these does is to move 64 bits forward over some bytes of message: the
// numbers are x^n modulo the polynomial, bits reversed (Gopal et al., "Fast CRC Computation for Generic
// Polynomials Using PCLMULQDQ Instruction", Intel 2009). tests/usd/test_crc32.py compares each way with zlib.
#define OVER_256 0x1322D1430, 0x11542778A
#define OVER_64 0x1C6E41596, 0x154442BD4
#define OVER_16 0x0CCAA009E, 0x1751997D0
#define OVER_8 0x163CD6124
#define REDUCE 0x1F7011641, 0x1DB710641

__attribute__((target("pclmul,sse4.1"))) static inline __m128i load(const uint8_t *at) {
    return _mm_loadu_si128((const __m128i *)(const void *)at);
}

__attribute__((target("pclmul,sse4.1"))) static inline __m128i fold(__m128i lane, __m128i over,
                                                                    __m128i next) {
    const __m128i low = _mm_clmulepi64_si128(lane, over, 0x00);
    const __m128i high = _mm_clmulepi64_si128(lane, over, 0x11);
    return _mm_xor_si128(_mm_xor_si128(low, high), next);
}

/// Folds steps of WIDE bytes into STEP bytes of state. Returns how many bytes it has taken, of at least WIDE.
__attribute__((target("vpclmulqdq,avx2"))) static size_t fold_wide(uint32_t crc, const uint8_t *at,
                                                                   size_t size, uint8_t state[STEP]) {
    enum { VECTOR = 32, VECTORS = WIDE / VECTOR };
    const __m256i over = _mm256_broadcastsi128_si256(_mm_set_epi64x(OVER_256));
    __m256i lanes[VECTORS];
    for (int i = 0; i < VECTORS; i++) {
        lanes[i] = _mm256_loadu_si256((const __m256i *)(const void *)(at + i * VECTOR));
    }
    lanes[0] = _mm256_xor_si256(lanes[0], _mm256_set_epi32(0, 0, 0, 0, 0, 0, 0, (int)crc));
    size_t taken = WIDE;
    for (; size - taken >= WIDE; taken += WIDE) {
        for (int i = 0; i < VECTORS; i++) {
            const __m256i next = _mm256_loadu_si256((const __m256i *)(const void *)(at + taken) + i);
            const __m256i low = _mm256_clmulepi64_epi128(lanes[i], over, 0x00);
            const __m256i high = _mm256_clmulepi64_epi128(lanes[i], over, 0x11);
            lanes[i] = _mm256_xor_si256(_mm256_xor_si256(low, high), next);
        }
    }
    const __m256i over_step = _mm256_broadcastsi128_si256(_mm_set_epi64x(OVER_64));
    for (int i = 2; i < VECTORS; i++) {
        const __m256i low = _mm256_clmulepi64_epi128(lanes[i - 2], over_step, 0x00);
        const __m256i high = _mm256_clmulepi64_epi128(lanes[i - 2], over_step, 0x11);
        lanes[i] = _mm256_xor_si256(lanes[i], _mm256_xor_si256(low, high));
    }
    memcpy(state, &lanes[VECTORS - 2], STEP);
    return taken;
}

/// `crc` is inverted; `size` is a multiple of LANE and at least STEP.
__attribute__((target("pclmul,sse4.1"))) static uint32_t carry_less(uint32_t crc, const uint8_t *at,
                                                                    size_t size, bool wide) {
    const uint8_t *const end = at + size;
    uint8_t state[STEP];
    if (wide && size >= WIDE) {
        at += fold_wide(crc, at, size, state);
    } else {
        memcpy(state, at, STEP);
        store32_le(state, load32_le(state) ^ crc);
        at += STEP;
    }
    __m128i a = load(state);
    __m128i b = load(state + LANE);
    __m128i c = load(state + 2 * LANE);
    __m128i d = load(state + 3 * LANE);
    __m128i over = _mm_set_epi64x(OVER_64);
    for (; end - at >= STEP; at += STEP) {
        a = fold(a, over, load(at));
        b = fold(b, over, load(at + LANE));
        c = fold(c, over, load(at + 2 * LANE));
        d = fold(d, over, load(at + 3 * LANE));
    }
    over = _mm_set_epi64x(OVER_16);
    a = fold(fold(fold(a, over, b), over, c), over, d);
    for (; at < end; at += LANE) {
        a = fold(a, over, load(at));
    }
    const __m128i low_32 = _mm_setr_epi32(~0, 0, ~0, 0);
    a = _mm_xor_si128(_mm_srli_si128(a, 8), _mm_clmulepi64_si128(a, over, 0x10));
    b = _mm_clmulepi64_si128(_mm_and_si128(a, low_32), _mm_set_epi64x(0, OVER_8), 0x00);
    a = _mm_xor_si128(_mm_srli_si128(a, 4), b);
    over = _mm_set_epi64x(REDUCE);
    b = _mm_clmulepi64_si128(_mm_and_si128(a, low_32), over, 0x10);
    b = _mm_clmulepi64_si128(_mm_and_si128(b, low_32), over, 0x00);
    return (uint32_t)_mm_extract_epi32(_mm_xor_si128(a, b), 1);
}

static bool has_carry_less(void) {
    return __builtin_cpu_supports("pclmul") && __builtin_cpu_supports("sse4.1");
}

static bool has_wide(void) {
    return __builtin_cpu_supports("vpclmulqdq") && __builtin_cpu_supports("avx2");
}

static bool by_processor(uint8_t way, uint32_t crc, bytes_t in, uint32_t *out) {
    const bool wide = way == CRC32_CARRY_LESS_WIDE;
    if ((way != CRC32_CARRY_LESS && !wide) || !has_carry_less() || (wide && !has_wide())) {
        return false;
    }
    const size_t whole = in.size < STEP ? 0 : in.size - in.size % LANE;
    if (whole > 0) {
        crc = ~carry_less(~crc, in.data, whole, wide);
    }
    *out = crc32_zlib(crc, (bytes_t){in.data + whole, in.size - whole});
    return true;
}

static uint8_t best_way(void) {
    return has_wide() ? CRC32_CARRY_LESS_WIDE : CRC32_CARRY_LESS;
}

#elif defined(__GNUC__) && defined(__aarch64__) && defined(__LITTLE_ENDIAN__)

#if defined(__linux__)
#include <sys/auxv.h>
static bool has_crc(void) {
    return (getauxval(AT_HWCAP) & 1U << 7) != 0; // HWCAP_CRC32
}
#else
static bool has_crc(void) {
#if defined(__ARM_FEATURE_CRC32) || defined(__APPLE__)
    return true;
#else
    return false;
#endif
}
#endif

// The instructions by their names in assembly: compilers disagree about how to declare them for a processor
// that has them only perhaps.
static inline uint32_t step_8(uint32_t crc, uint64_t value) {
    __asm__(".arch_extension crc\n\tcrc32x %w0, %w0, %x1" : "+r"(crc) : "r"(value));
    return crc;
}

static inline uint32_t step_1(uint32_t crc, uint8_t value) {
    __asm__(".arch_extension crc\n\tcrc32b %w0, %w0, %w1" : "+r"(crc) : "r"((uint32_t)value));
    return crc;
}

static bool by_processor(uint8_t way, uint32_t crc, bytes_t in, uint32_t *out) {
    if (way != CRC32_INSTRUCTIONS || !has_crc()) {
        return false;
    }
    crc = ~crc;
    size_t at = 0;
    for (; in.size - at >= 8; at += 8) {
        crc = step_8(crc, load64_le(in.data + at));
    }
    for (; at < in.size; at++) {
        crc = step_1(crc, in.data[at]);
    }
    *out = ~crc;
    return true;
}

static uint8_t best_way(void) {
    return CRC32_INSTRUCTIONS;
}

#else

static bool by_processor(uint8_t way, uint32_t crc, bytes_t in, uint32_t *out) {
    (void)way;
    (void)crc;
    (void)in;
    (void)out;
    return false;
}

static uint8_t best_way(void) {
    return CRC32_TABLES;
}

#endif

bool crc32_by(uint8_t way, uint32_t crc, bytes_t in, uint32_t *out) {
    if (way == CRC32_TABLES) {
        *out = crc32_zlib(crc, in);
        return true;
    }
    return by_processor(way, crc, in, out);
}

uint32_t crc32_host(uint32_t crc, bytes_t in) {
    uint32_t out = 0;
    if (!crc32_by(best_way(), crc, in, &out)) {
        out = crc32_zlib(crc, in);
    }
    return out;
}
