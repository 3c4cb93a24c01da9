/*
 * Anything at all into an exported calibration: every call and every number at random, by a seed.
 *
 *     cc -fsanitize=address,undefined -DREAL=double m.c fuzz.c -lm -o fuzz && ./fuzz SEED SAMPLES
 *
 * Exits with 1 where the source breaks its promises: a sample is corrected, finite and with a
 * half-width, or it is flagged, passes through as it was measured and has an infinite one. However
 * long the garbage was, ordinary samples are then corrected again, and a new state passes the check.
 */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define main check
#include "m_check.c"
#undef main

static uint64_t seed;

static uint64_t bits(void)
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return seed;
}

/* A number like `usual`, or one that nobody would expect. */
static double any(double usual)
{
    uint64_t pattern = bits();
    double value;

    switch (bits() % 24) {
    case 0:
        memcpy(&value, &pattern, sizeof value); /* of any size, NaN with any payload */
        return value;
    case 1:
        return bits() % 2 ? NAN : -NAN;
    case 2:
        return bits() % 2 ? INFINITY : -INFINITY;
    case 3:
        return ldexp((double)(int64_t)pattern, -1137); /* subnormal */
    case 4:
        return bits() % 2 ? -0.0 : 0.0;
    case 5:
        return bits() % 2 ? 1.7976931348623157e308 : -3.4e38;
    case 6:
        return usual * ldexp(1.0, (int)(bits() % 128) - 64);
    case 7:
        return nextafter(usual, bits() % 2 ? INFINITY : -INFINITY);
    default:
        return usual;
    }
}

static int failed(const char *what, long at)
{
    printf("call %ld: %s\n", at, what);
    return 1;
}

/* What every sample promises. */
static int broken(int status, const REAL *sample, const REAL *position, const REAL *half_width)
{
    for (int k = 0; k < M_JOINTS; k++) {
        int is_measured = position[k] != position[k];

        for (int i = 0; i < M_SIGNALS; i++) {
            is_measured |= position[k] == sample[i];
        }
        if (status ? !is_measured || half_width[k] != (REAL)INFINITY
                   : !isfinite(position[k]) || !(half_width[k] >= 0)) {
            return 1;
        }
    }
    return status < 0 || status >= 2 * M_ZERO_SUSPECT;
}

int main(int argc, char **argv)
{
    static m_state state;
    REAL sample[M_SIGNALS], position[M_JOINTS], half_width[M_JOINTS], offset[M_JOINTS] = {0};
    const long samples = argc > 2 ? strtol(argv[2], NULL, 10) : 1000;
    double t = 0.0;
    int status = 0;

    seed = 2 * (argc > 1 ? strtoull(argv[1], NULL, 10) : 0) + 1;
    m_init(&state);
    for (long n = 0; n < samples; n++) {
        const int row = (int)(bits() % 8 ? (unsigned long)n % VECTORS : bits() % VECTORS);

        switch (bits() % 64) {
        case 0:
            m_set_homing(&state, bits() % 4 != 0, (int)(bits() % 5) - 1);
            break;
        case 1:
            for (int k = 0; k < M_JOINTS; k++) {
                offset[k] = (REAL)any((double)vector_offset[k]);
            }
            m_rezero(&state, offset);
            break;
        case 2:
            m_acknowledge(&state);
            break;
        case 3:
            m_reset(&state);
            break;
        default:
            break;
        }
        for (int i = 0; i < M_SIGNALS; i++) {
            sample[i] = bits() % 8 ? vector[row].sample[i] : (REAL)any((double)vector[row].sample[i]);
        }
        t = bits() % 32 ? vector[row].t : any(t);
        status = m_step(&state, t, sample, position, half_width);
        if (broken(status, sample, position, half_width)) {
            return failed("what came out is neither corrected nor passed through", n);
        }
    }
    memset(offset, 0, sizeof offset);
    m_reset(&state);
    m_set_homing(&state, 1, M_HOMING_OF_CALIBRATION);
    m_rezero(&state, offset);
    for (int row = VECTORS / 2; row < VECTORS; row++) {
        status = m_step(&state, vector[row].t, vector[row].sample, position, half_width);
    }
    if (status != vector[VECTORS - 1].status) {
        return failed("it does not recover", samples);
    }
    return check();
}
