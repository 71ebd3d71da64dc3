/* Combine many equal steps into one by repeated doubling. */
#ifndef BECALM_DOUBLING_H
#define BECALM_DOUBLING_H

#include "linear.h"

/* Write A and W, the transition matrix and the process noise of one step that equals `rows` steps with F and Q. */
static inline void many_steps(const int n, const real *F, const real *Q, uint32_t rows, real *A, real *W) {
    real B[NN_MAX], V[NN_MAX], BB[NN_MAX], more[NN_MAX];
    copy(n * n, F, B), copy(n * n, Q, V);
    for (int i = 0; i < n * n; i++) A[i] = i % (n + 1) == 0, W[i] = 0;
    for (; rows; rows >>= 1) {
        if (rows & 1) {
            propagate(n, B, V, W);
            multiply(n, B, A, more);
            copy(n * n, more, A);
        }
        copy(n * n, V, more);
        propagate(n, B, V, more);
        multiply(n, B, B, BB);
        copy(n * n, BB, B), copy(n * n, more, V);
    }
}

#endif
