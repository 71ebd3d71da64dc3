/* Pack the state of a filter: copy it without the unused parts of its arrays. */
#ifndef BECALM_PACK_H
#define BECALM_PACK_H

#include <stddef.h>
#include <string.h>

#include "linear.h"

enum { HEAD = offsetof(filter_t, x) / sizeof(real) }; /* number of numbers before the arrays */

static inline int64_t packed_size(const int64_t n) { return HEAD + 6 * n + n * n; }

INLINE void pack(const int n, const filter_t *state, real *packed) {
    const real *arrays[] = {state->x, state->ahead, state->K, state->L, state->K_then, state->variance_then};
    memcpy(packed, state, offsetof(filter_t, x));
    for (int k = 0; k < 6; k++) copy(n, arrays[k], packed + HEAD + k * n);
    copy(n * n, state->P, packed + HEAD + 6 * n);
}

INLINE void unpack(const int n, const real *packed, filter_t *state) {
    real *arrays[] = {state->x, state->ahead, state->K, state->L, state->K_then, state->variance_then};
    memcpy(state, packed, offsetof(filter_t, x));
    for (int k = 0; k < 6; k++) copy(n, packed + HEAD + k * n, arrays[k]);
    copy(n * n, packed + HEAD + 6 * n, state->P);
}

/* Pack a struct whose last field is a filter, at offset `at`; the next function unpacks it. */
static inline void pack_after(const int64_t n, const void *whole, const size_t at, char *packed) {
    memcpy(packed, whole, at);
    pack((int)n, (const filter_t *)(const void *)((const char *)whole + at), (real *)(void *)(packed + at));
}

static inline void unpack_after(const int64_t n, const char *packed, const size_t at, void *whole) {
    memcpy(whole, packed, at);
    unpack((int)n, (const real *)(const void *)(packed + at), (filter_t *)(void *)((char *)whole + at));
}

static inline int64_t size_after(const int64_t n, const size_t at) {
    return (int64_t)at + packed_size(n) * (int64_t)sizeof(real);
}

/* The next functions read a field of a packed state. */
static inline int64_t packed_phase(const real *packed) {
    int64_t phase;
    memcpy(&phase, packed + offsetof(filter_t, phase) / sizeof(real), sizeof phase);
    return phase;
}

static inline real packed_S(const real *packed) { return packed[offsetof(filter_t, S) / sizeof(real)]; }

static inline const real *packed_K(const int64_t n, const real *packed) { return packed + HEAD + 2 * n; }

static inline const real *packed_P(const int64_t n, const real *packed) { return packed + HEAD + 6 * n; }

#endif
