/* Detect gaps that the filter cannot bridge, because float64 would lose the information from before the gap. */
#ifndef BECALM_GAP_H
#define BECALM_GAP_H

#include "filter.h"
#include "linear.h"

/* Count a row and its time; return whether the gap before its measurement is too long for the filter. */
INLINE int check_gap(const settings_t *settings, limits_t *state, const real elapsed, const int usable) {
    if (state->measurements) state->now += elapsed;
    if (!usable) return 0;
    real longest = settings->longest_gap;
    if (state->measurements >= settings->gap_measurements && state->last > 0) {
        const real spans = settings->gap_spans * state->last;
        longest = spans < longest ? spans : longest;
    }
    const int restarts = state->measurements && state->now - state->last > longest;
    if (restarts) state->now = 0, state->measurements = 0;
    state->last = state->now;
    state->measurements++;
    return restarts;
}

/* Mark the rows at which the filter restarts, among the first `rows` rows of a block. */
static inline void find_starts(const settings_t *settings, limits_t *limits, const block_t *block, const int64_t rows,
                               int8_t *starts) {
    limits_t own = *limits; /* a local copy can stay in registers */
    for (int64_t row = 0; row < rows; row++) {
        const int usable = fabs(block->z[row]) <= BEYOND_ANY_SENSOR;
        const int restarts = check_gap(settings, &own, block->elapsed[row], usable);
        if (restarts) starts[row] = RESTARTS;
    }
    *limits = own;
}

#endif
