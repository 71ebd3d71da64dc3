/* Detect when the gain has reached its steady state; from then on it is reused, and no covariance is computed. */
#ifndef BECALM_SETTLING_H
#define BECALM_SETTLING_H

#include "filter.h"
#include "linear.h"

#define STEADY ((real)1e-9)    /* largest relative change of a steady variance */
#define FORGOTTEN ((real)0.9)  /* largest remaining share of the initial uncertainty after an eighth of the rows */

/* Compare gain and sigma with those of the last check, and store them for the next check; return whether they are
   unchanged. */
static inline int check_gain(const int n, filter_t *state) {
    int settled = near(state->S, state->S_then, state->S) & near(state->sigma, state->sigma_then, state->sigma);
    for (int i = 0; i < n; i++) {
        const real variance = state->P[i * n + i];
        const int steady = fabs(variance - state->variance_then[i]) <= STEADY * variance; /* else a gain may grow */
        const real spread = steady && state->S > 0 ? sqrt(variance / state->S) : 0;
        settled &= near(state->K[i], state->K_then[i], spread + fabs(state->K[i]));
        state->variance_then[i] = variance, state->K_then[i] = state->K[i];
    }
    state->S_then = state->S, state->sigma_then = state->sigma;
    return settled;
}

/* Return whether the filter reduces the influence of its initial state by a tenth or more within some rows; otherwise
   the gain is slow, and may still change. */
static inline int forgets(const int n, const int m, const real *H, const real *F, const real *K, const real *P,
                          real rows) {
    real A[NN_MAX], squared[NN_MAX], g[M_MAX * N_MAX];
    multiply_HF(n, m, H, F, g);
    close_loop(n, m, F, K, g, A);
    for (; rows >= 2; rows *= (real)0.5) {
        multiply(n, A, A, squared);
        copy(n * n, squared, A);
    }
    for (int c = 0; c < m; c++) {
        real before = 0, left = 0;
        for (int j = 0; j < n; j++) {
            const real spread = sqrt(P[j * n + j]);
            real s = 0;
            for (int i = 0; i < n; i++) s += H[c * n + i] * A[i * n + j];
            before += fabs(H[c * n + j]) * spread;
            left += fabs(s) * spread;
        }
        if (!(left <= FORGOTTEN * before)) return 0;
    }
    return 1;
}

/* Discard the steady-state gain and the checks so far. */
static inline void unsettle(filter_t *state) {
    state->settled = state->agreed = state->predicted = 0;
    state->steady = -1, state->next_check = FIRST_CHECK;
    state->last_step = -1, state->S_then = -1;
}

/* Check after a row whether the gain has settled. It must be unchanged for n more rows, because an oscillating gain may
   have the same value at two checks. */
INLINE void check_settling(const int n, const real *h, const real *F, filter_t *state, const real elapsed,
                           const int complete) {
    if (!complete || elapsed != state->last_step) {
        unsettle(state);
        if (complete) state->last_step = elapsed;
    }
    state->predicted = 0;
    if (++state->steady < state->next_check) return;
    const int settled =
        check_gain(n, state) && forgets(n, 1, h, F, state->K, state->P, (real)0.125 * (real)state->steady);
    state->agreed = settled ? state->agreed + 1 : 0;
    if (0 < state->agreed && state->agreed <= n) {
        state->next_check = state->steady + 1;
        return;
    }
    state->settled = settled, state->agreed = 0;
    state->next_check = state->steady + (state->steady / 8 > FIRST_CHECK ? state->steady / 8 : FIRST_CHECK);
}

#endif
