/* What a filter knows, without the room that its arrays do not need. */
#ifndef BECALM_PACK_H
#define BECALM_PACK_H

#include <stddef.h>
#include <string.h>

#include "linear.h"

enum { HEAD = offsetof(filter_t, x) / sizeof(real) };

static int64_t packed_size(const int64_t n) { return HEAD + 6 * n + n * n; }

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

#endif
