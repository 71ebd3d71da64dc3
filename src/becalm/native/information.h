/* The information on a state, as equations U x = b + e with e ~ N(0, I) and U upper triangular, and its change over a
   step. */
#ifndef BECALM_INFORMATION_H
#define BECALM_INFORMATION_H

#include <string.h>

#include "linear.h"

#define LOST_DIGITS ((real)1e10) /* largest entry of the joint equations; above this, fewer than six digits remain */
#define NOTHING ((real)1e-15)    /* a smaller share of a variance is a rounding error */

/* Add an equation, a x = right + e, by rotations; `a` is overwritten. */
static inline void add_equation(const int n, real *a, real right, real *U, real *b) {
    for (int i = 0; i < n; i++) {
        const real length = sqrt(U[i * n + i] * U[i * n + i] + a[i] * a[i]);
        if (a[i] == 0 || length == 0) continue; /* 0 also where a square underflows */
        const real cosine = U[i * n + i] / length, sine = a[i] / length;
        for (int j = i; j < n; j++) {
            const real u = U[i * n + j];
            U[i * n + j] = cosine * u + sine * a[j];
            a[j] = cosine * a[j] - sine * u;
        }
        const real u = b[i];
        b[i] = cosine * u + sine * right;
        right = cosine * right - sine * u;
    }
}

/* Write the root L of a covariance, Q = L L' with L lower triangular; columns of states without variance are 0. */
static inline void covariance_root(const int n, const real *Q, real *L) {
    L[0] = 0;
    for (int j = 0; j < n; j++)
        for (int i = 0; i < n; i++) {
            real s = Q[i * n + j];
            for (int k = 0; k < j; k++) s -= L[i * n + k] * L[j * n + k];
            if (i < j)
                L[i * n + j] = 0;
            else if (i == j)
                L[i * n + j] = s > NOTHING * Q[j * n + j] ? sqrt(s) : 0;
            else
                L[i * n + j] = L[j * n + j] > 0 ? s / L[j * n + j] : 0;
        }
}

/* Join the information on a state, U x = b + e, with the step after it, x' = F x + L w. With W = U F^-1 the equations
   for (w, x') are w = e and W x' - W L w = b + e. They are made triangular without a square of W L (Bierman 1977).
   Write F^-1 to `back`, and the equations to `joint` (2n, 2n) and `right` (2n). Return whether the equations are
   accurate; they are not for a step so long that all states have decayed. */
static inline int join_step(const int n, const real *F, const real *L, const real *U, const real *b, real *back,
                            real *joint, real *right) {
    real W[NN_MAX], a[2 * N_MAX];
    if (!invert(n, F, back)) return 0;
    multiply(n, U, back, W);
    memset(joint, 0, sizeof(real) * (size_t)(4 * n * n));
    for (int i = 0; i < n; i++) joint[i * 2 * n + i] = 1;
    for (int i = 0; i < 2 * n; i++) right[i] = 0;
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            a[j] = 0, a[n + j] = W[i * n + j];
            for (int k = j; k < n; k++) a[j] -= W[i * n + k] * L[k * n + j];
            if (!(fabs(a[j]) < LOST_DIGITS && fabs(a[n + j]) < INFINITE)) return 0;
        }
        add_equation(2 * n, a, b[i], joint, right);
    }
    return 1;
}

#endif
