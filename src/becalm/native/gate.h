/* Innovation gate: which measurements are not believed, and before which the signal has jumped. */
#ifndef BECALM_GATE_H
#define BECALM_GATE_H

#include "filter.h"
#include "linear.h"

#define GROWS ((real)4) /* times the innovations of a jump so far: one that is larger is no part of it yet */

/* Return by how much a prediction's error may change over a step, one standard deviation. */
static inline real wander(const int n, const real *h, const real *F, const real *Q, const real *P) {
    real g[N_MAX], s = 0;
    see_through(n, 1, h, F, g);
    for (int j = 0; j < n; j++) g[j] -= h[j];
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) s += g[i] * P[i * n + j] * g[j] + h[i] * Q[i * n + j] * h[j];
    return s > 0 ? sqrt(s) : 0;
}

/* Return the next power of four, which a last digit seldom changes. */
static inline real round_up(real variance) {
    real power = 1;
    if (!(variance > 0)) return 0;
    variance = variance < (real)1e-290 ? (real)1e-290 : variance > (real)1e200 ? (real)1e200 : variance;
    while (power < variance) power *= 4;
    while (power * (real)0.25 >= variance) power *= (real)0.25;
    return power;
}

/* Add to a predicted covariance what makes an innovation likely: to the level alone, or to all states alike, but no more
   than what moves the next measurement as far. Jumps that follow each other soon would multiply what the last one has
   added, until no digit is left. */
static inline void jump(const int n, const settings_t *settings, const coefficients_t *model, filter_t *state,
                        const real *F, const real nu, const real hPh) {
    const int64_t level = state->since_jump >= settings->gate_most ? settings->gate_level : -1;
    const real most = WIDE * model->R, square = nu * nu < most ? nu * nu : most;
    real g[N_MAX];
    see_through(n, 1, model->h, F, g);
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

/* Count a measurement that is rejected; return whether it is accepted after all: so many in a row are motion, and so is
   one soon after a jump that is not far beyond it. */
static inline int reject(const settings_t *settings, const coefficients_t *model, filter_t *state, const real nu) {
    const real noise = sqrt(2 * model->R + state->wandered * state->wandered);
    const int agrees = state->agreeing > 0 && fabs(nu - state->last_rejected) <= settings->gate_threshold * noise;
    state->agreeing = agrees ? state->agreeing + 1 : 1;
    state->rejected++;
    state->last_rejected = nu, state->wandered = 0;
    const int goes_on = state->jumped && state->since_jump < GOES_ON && fabs(nu) <= GROWS * state->burst;
    return goes_on || state->agreeing >= settings->gate_agree || state->rejected >= settings->gate_most;
}

#endif
