/* The innovation gate: it rejects implausible measurements, and detects jumps of the signal. Gross outliers are already
   removed, by `limits.h` or `outliers.c`. */
#ifndef BECALM_GATE_H
#define BECALM_GATE_H

#include "filter.h"
#include "linear.h"

#define GROWS ((real)4) /* an innovation more than this many times larger than those of a jump is not part of it */

/* Return the standard deviation of the change of a prediction's error over a step. */
static inline real error_change_std(const int n, const real *h, const real *F, const real *Q, const real *P) {
    real g[N_MAX], s = 0;
    multiply_HF(n, 1, h, F, g);
    for (int j = 0; j < n; j++) g[j] -= h[j];
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) s += g[i] * P[i * n + j] * g[j] + h[i] * Q[i * n + j] * h[j];
    return s > 0 ? sqrt(s) : 0;
}

/* Return the power of four at or above a variance, or 0 if the variance is not above 0. The result does not depend on
   the last digits of the variance, except near a power of four. */
static inline real round_up(real variance) {
    real power = 1;
    if (!(variance > 0)) return 0;
    variance = variance < (real)1e-290 ? (real)1e-290 : variance > (real)1e200 ? (real)1e200 : variance;
    while (power < variance) power *= 4;
    while (power * (real)0.25 >= variance) power *= (real)0.25;
    return power;
}

/* Increase a predicted covariance so that the innovation becomes likely: only for the level or, without a level or soon
   after another jump, for all states in proportion. Then the increase is limited so that it moves the next prediction
   no farther than the innovation: otherwise repeated jumps would multiply the covariance until no digit is left. */
static inline void jump(const int n, const settings_t *settings, const coefficients_t *model, filter_t *state,
                        const real *F, const real nu, const real hPh) {
    const int64_t level = state->since_jump >= settings->gate_most ? settings->gate_level : -1;
    const real most = WIDE * model->R, square = nu * nu < most ? nu * nu : most;
    real g[N_MAX];
    multiply_HF(n, 1, model->h, F, g);
    for (int i = 0; i < n; i++) {
        real *P = state->P + i * n + i;
        if (level < 0) {
            const real more = hPh > 0 ? round_up(square * (*P / hPh)) : 0, room = round_up(square / (g[i] * g[i])) - *P;
            *P += !(more > room) ? more : room > 0 ? room : 0;
        } else if (i == level)
            *P += round_up(nu * nu / (model->h[i] * model->h[i]));
    }
    state->since_jump = level < 0 ? -n : -1;
    state->jumped = 1, state->burst = fabs(nu);
}

/* Count a rejected measurement; return whether it is accepted after all. Several rejected measurements in a row are
   motion. One soon after a jump is also motion, if its innovation is not much larger than those of the jump. */
static inline int reject(const settings_t *settings, const coefficients_t *model, filter_t *state, const real nu) {
    const real noise = sqrt(2 * model->R + state->wandered * state->wandered);
    const int agrees = state->agreeing > 0 && fabs(nu - state->last_rejected) <= settings->gate_threshold * noise;
    state->agreeing = agrees ? state->agreeing + 1 : 1;
    state->rejected++;
    state->last_rejected = nu, state->wandered = 0;
    const int belongs_to_jump = state->jumped && state->since_jump < GOES_ON && fabs(nu) <= GROWS * state->burst;
    return belongs_to_jump || state->agreeing >= settings->gate_agree || state->rejected >= settings->gate_most;
}

#endif
