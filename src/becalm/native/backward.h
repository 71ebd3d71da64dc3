/* Smooth the rows of one channel with the information of later rows. Equations are numbered as in
   core/reference/kalman.py. */
#ifndef BECALM_BACKWARD_H
#define BECALM_BACKWARD_H

#include "future.h"
#include "opening.h"
#include "pack.h"

/* Smooth a row before which measurements did not determine the state: from the smoothed row after it or, if there is
   none, from the information of the row. Return 0 if the state remains undetermined. */
INLINE int smooth_gathering(const int n, const coefficients_t *model, const filter_t *row, const real *Q,
                            future_t *future, real *signal, real *sigma) {
    const real nothing[N_MAX] = {0};
    const int unknown = row->phase == UNKNOWN;
    const real *U = unknown ? model->prior : row->P, *b = unknown ? nothing : row->x;
    real Pc[N_MAX], V[NN_MAX];
    if (!(future->later == STATE_TOO && from_later(n, U, b, future))) {
        future->later = NOTHING_LATER;
        if (unknown || !determines_state(n, model->R, Q, U, V)) return 0;
        copy(n, b, future->x);
        determine(n, V, future->P, future->x);
        future->later = STATE_TOO;
    }
    if (!unknown) future->level = row->level;
    times(n, future->P, model->c, Pc);
    const real variance = dot(n, model->c, Pc);
    if (!(variance > 0)) return 1;
    *signal = dot(n, model->c, future->x) + future->level;
    *sigma = sqrt(variance);
    return 1;
}

/* Smooth one row: add the information of later rows to its filtered signal. Return 0 if this loses digits and the
   smoothed next row, from which an accurate result could be computed, is not known. */
INLINE int smooth_row(const int n, const coefficients_t *model, const filter_t *row, const real *Q, future_t *future,
                      real *signal, real *sigma) {
    real smoothed[NN_MAX], Pr[N_MAX];
    if (row->phase != DETERMINED) return smooth_gathering(n, model, row, Q, future, signal, sigma);
    const real share = smooth_covariance(n, row->P, future->M, smoothed);
    const int lost = share < ACCURATE_SHARE, known = future->later != NOTHING_LATER;
    const int recomputed = lost && known && covariance_from_later(n, row->P, future);
    if (!recomputed) copy(n * n, share > LEAST_SHARE ? smoothed : row->P, future->P);
    const real variance = smoothed_variance(n, model->c, row->P, future->M, recomputed ? future->P : NULL);
    times(n, row->P, future->r, Pr);
    for (int i = 0; i < n; i++) future->x[i] = row->x[i] + Pr[i]; /* (9) */
    future->later = STATE_TOO, future->level = row->level;
    *signal += dot(n, model->c, Pr);
    *sigma = variance > 0 ? sqrt(variance) : 0;
    return !lost || known;
}

/* Transform the information of later rows: back through the update of a row, and through the step before this row. */
INLINE void step_back(const int n, const real *h, const real S, const real *K, const real *F, const real innovation,
                      future_t *future) {
    real A[NN_MAX], g[N_MAX], G[N_MAX];
    const int used = !isnan(innovation);
    const real nu = used ? innovation : 0;
    multiply_HF(n, 1, h, F, g);
    for (int i = 0; i < n; i++) G[i] = used && S > 0 ? g[i] * (1 / S) : 0; /* S = 0: an exact prediction */
    if (used)
        close_loop(n, 1, F, K, g, A);
    else
        copy(n * n, F, A);
    pull_back_state(n, 1, A, G, &nu, future->r);
    pull_back(n, 1, A, G, g, future->M);
}

/* After `step_back`, prepare the smoothing of the previous row. */
INLINE void prepare_row_before(const int n, const real *F, const real *Q, const int8_t verdict, const int8_t start,
                      future_t *future) {
    if (start == RESTARTS) forget_future(n, future);         /* rows before a restart use no later rows */
    if (verdict == STEP) future->later = NOTHING_LATER; /* a jump adds more than Q */
    copy(n * n, F, future->F), copy(n * n, Q, future->Q);
}

#endif
