/* The monitor of innovations: it detects a drifting or dead sensor. */
#ifndef BECALM_MONITOR_H
#define BECALM_MONITOR_H

#include <string.h>
#include "linear.h"

#define ROUNDING ((real)6755399441055744.0) /* 1.5 * 2^52: adding it rounds a number to a whole one */

enum { SLACK = PARTS / 2 }; /* slack of the cumulative sums: half a sigma per row */

/* Complete a hop of innovations, and test the window that ends with this hop. */
static inline void end_hop(const settings_t *settings, monitor_t *state) {
    enum { BEFORE = WINDOW_HOPS - 1, WINDOW = WINDOW_HOPS * HOP };
    int64_t total = state->hop_total, squares = state->hop_squares;
    for (int k = 0; k < BEFORE; k++) total += state->totals[k], squares += state->squares[k];
    const real variance = (real)(WINDOW * squares - total * total) / ((real)(WINDOW * (WINDOW - 1)) * PARTS * PARTS);
    state->silent = state->hops >= BEFORE && variance < settings->dead_variance;
    state->powers[state->hops % KEPT_HOPS] = state->hop_power;
    memmove(state->totals, state->totals + 1, sizeof(int64_t) * (BEFORE - 1));
    memmove(state->squares, state->squares + 1, sizeof(int64_t) * (BEFORE - 1));
    state->totals[BEFORE - 1] = state->hop_total, state->squares[BEFORE - 1] = state->hop_squares;
    state->hop_count = state->hop_total = state->hop_squares = 0;
    state->hop_power = 0;
    state->hops++;
}

/* Return the verdict on a normalised innovation, NaN if there is none: DRIFT if one of the two cumulative sums (Page
   1954) reaches the threshold, DEAD while the last window is too quiet for a live sensor. */
static inline int watch(const settings_t *settings, monitor_t *state, real nu) {
    const int64_t row = state->rows++;
    int64_t since = -1;
    if (isnan(nu)) return USED;
    nu = nu > -MOST_SIGMA ? nu : -MOST_SIGMA;
    nu = nu < MOST_SIGMA ? nu : MOST_SIGMA;
    const int64_t part = (int64_t)((nu * PARTS + ROUNDING) - ROUNDING); /* the nearest whole number */
    const int64_t above = state->above + part - SLACK, below = state->below - part - SLACK;
    state->above = above * (above > 0), state->below = below * (below > 0); /* without a branch: the signs are random */
    if (state->above >= settings->drift_threshold) since = state->above_since, state->above = 0;
    if (state->below >= settings->drift_threshold) since = since < 0 ? state->below_since : since, state->below = 0;
    state->above_since = row + 1 + (state->above_since - row - 1) * (state->above > 0);
    state->below_since = row + 1 + (state->below_since - row - 1) * (state->below > 0);
    if (since >= 0 && state->drift_since < 0) state->drift_since = since;
    state->hop_total += part, state->hop_squares += part * part, state->hop_power += nu * nu;
    if (++state->hop_count == HOP) end_hop(settings, state);
    return state->silent ? DEAD : since >= 0 ? DRIFT : USED;
}

/* Return whether the sums, which may come from a file, are possible. */
static inline int monitor_is_sound(const monitor_t *monitor) {
    const int64_t squares = (int64_t)1 << 45; /* largest sum of squares in a hop, in 2^-32 sigma^2 */
    int sound = is_count(monitor->rows, EVER) && is_count(monitor->above, EVER) && is_count(monitor->below, EVER) &&
                is_count(monitor->above_since, EVER) && is_count(monitor->below_since, EVER) && monitor->hops >= 0 &&
                is_count(monitor->hops, EVER) && monitor->hop_count >= 0 && monitor->hop_count < HOP &&
                is_count(monitor->hop_total, (int64_t)1 << 28) && is_count(monitor->hop_squares, squares);
    for (int k = 0; k < WINDOW_HOPS - 1; k++)
        sound = sound && is_count(monitor->totals[k], (int64_t)1 << 28) && is_count(monitor->squares[k], squares);
    return sound;
}

#endif
