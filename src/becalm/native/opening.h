/* The start of the filter: gather the information of the first measurements until they determine the state.

   The information is U x = b + e with e ~ N(0, I), where U is upper triangular and may have empty rows (Bierman 1977,
   square root information filter). No prior is needed or assumed. */
#ifndef BECALM_OPENING_H
#define BECALM_OPENING_H

#include "information.h"

#define WELL_DETERMINED ((real)1e-6) /* least eigenvalue of the information, scaled to a unit diagonal */
#define FAR ((real)1e15)             /* largest variance, over R or a variance in Q, that has a digit of these */
#define BELOW_0 ((real)1e-6)         /* a variance below minus this, over R, has lost its digits */
#define LIVE ((real)3e-5)            /* least diagonal element of U with information, over the length of its column */

/* Add the information of a measurement. */
static inline void add_information(const int n, const real *h, const real R, const real z, real *U, real *b) {
    real a[N_MAX];
    for (int i = 0; i < n; i++) a[i] = h[i] / sqrt(R);
    add_equation(n, a, z / sqrt(R), U, b);
}

/* Start with the prior information of the model. */
static inline void begin_information(const int n, const real *prior, real *U, real *b) {
    for (int i = 0; i < n * n; i++) U[i] = prior[i];
    for (int i = 0; i < n; i++) b[i] = 0;
}

/* Predict the information over a step. If no digits remain, replace it by the prior information of the model. */
static inline void predict_information(const int n, const real *F, const real *Q, const real *prior, real *U, real *b) {
    real back[NN_MAX], L[NN_MAX], joint[4 * NN_MAX], right[2 * N_MAX];
    covariance_root(n, Q, L);
    if (!join_step(n, F, L, U, b, back, joint, right)) {
        begin_information(n, prior, U, b);
        return;
    }
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) U[i * n + j] = joint[(n + i) * 2 * n + n + j];
        b[i] = right[n + i];
    }
}

/* Return the length of a column of U. */
static inline real column(const int n, const real *U, const int j) {
    real s = 0;
    for (int i = 0; i <= j; i++) s += U[i * n + j] * U[i * n + j];
    return sqrt(s);
}

/* Estimate h x and its standard deviation from the information; if it does not determine h x, write nothing. */
static inline void estimate_from_information(const int n, const real *h, const real *U, const real *b, real *signal,
                                      real *sigma) {
    real w[N_MAX] = {0}, most = 0, variance = 0, value = 0;
    for (int j = 0; j < n; j++) {
        const real scaled = fabs(h[j]) / (column(n, U, j) > 0 ? column(n, U, j) : 1);
        most = scaled > most ? scaled : most;
    }
    for (int j = 0; j < n; j++) { /* solve U' w = h */
        const real length = column(n, U, j) > 0 ? column(n, U, j) : 1;
        real left = h[j];
        for (int i = 0; i < j; i++) left -= w[i] * U[i * n + j];
        w[j] = 0;
        if (fabs(U[j * n + j]) > LIVE * length)
            w[j] = left / U[j * n + j];
        else if (fabs(left) > (real)1e-6 * most * length)
            return;
        variance += w[j] * w[j], value += w[j] * b[j];
    }
    *signal = value, *sigma = sqrt(variance);
}

/* Write V = U^-1; return whether U has an inverse. */
static inline int invert_root(const int n, const real *U, real *V) {
    for (int j = 0; j < n; j++) {
        if (U[j * n + j] == 0) return 0;
        for (int i = n - 1; i >= 0; i--) {
            real s = i == j;
            for (int k = i + 1; k <= j; k++) s -= U[i * n + k] * V[k * n + j];
            V[i * n + j] = i > j ? 0 : s / U[i * n + i];
        }
    }
    return 1;
}

/* Return whether the information determines all states, given V = U^-1. */
static inline int is_determined(const int n, const real *U, const real *V) {
    real squares = 0;
    for (int i = 0; i < n; i++) {
        if (!(fabs(U[i * n + i]) > LIVE * column(n, U, i))) return 0;
        for (int j = i; j < n; j++) {
            const real scaled = V[i * n + j] * column(n, U, i);
            squares += scaled * scaled;
        }
    }
    return squares * WELL_DETERMINED < 1;
}

/* Return the scale for comparisons of variances: the largest of R and the variances in Q. */
static inline real usual_variance(const int n, const real R, const real *Q) {
    real usual = R;
    for (int i = 0; i < n; i++) usual = Q[i * n + i] > usual ? Q[i * n + i] : usual;
    return usual;
}

/* Write V = U^-1; return whether the information determines the state so well that R or Q keeps some digits. */
static inline int determines_state(const int n, const real R, const real *Q, const real *U, real *V) {
    const real usual = usual_variance(n, R, Q);
    if (!invert_root(n, U, V) || !is_determined(n, U, V)) return 0;
    for (int i = 0; i < n; i++)
        if (!(dot(n, V + i * n, V + i * n) < FAR * usual)) return 0;
    return 1;
}

/* Return whether a variance of h x is NaN, or too negative for a rounding error. If R is 0 there is no scale of
   rounding errors: return 0. */
static inline int is_below_0(const real variance, const real R) { return R > 0 && !(variance >= -BELOW_0 * R); }

/* Return whether a variance of h x, before or after a measurement, is so large that it has no digit of R or Q. */
static inline int loses_digits(const int n, const real R, const real *Q, const real variance) {
    return is_below_0(variance, R) || (R > 0 && variance >= FAR * usual_variance(n, R, Q));
}

/* Replace the information by a state and its covariance, given V = U^-1. */
static inline void determine(const int n, const real *V, real *P, real *x) {
    real state[N_MAX];
    times(n, V, x, state);
    for (int i = 0; i < n; i++) {
        x[i] = state[i];
        for (int j = 0; j < n; j++) P[i * n + j] = dot(n, V + i * n, V + j * n);
    }
}

/* Return the variance of the prediction of h x, one step after a state with covariance V V'. */
static inline real predicted_variance(const int n, const real *h, const real *F, const real *Q, const real *V) {
    real hF[N_MAX], variance = 0;
    multiply_HF(n, 1, h, F, hF);
    for (int j = 0; j < n; j++) {
        real s = 0;
        for (int i = 0; i < n; i++) s += hF[i] * V[i * n + j], variance += h[i] * Q[i * n + j] * h[j];
        variance += s * s;
    }
    return variance;
}

/* Replace the information by a state and its covariance, if the next measurement is then predicted with a variance of
   at most `widest` R; return whether this was done. */
static inline int try_to_determine(const int n, const coefficients_t *model, const real *F, const real *Q, real *P,
                                   real *x) {
    real V[NN_MAX];
    if (!determines_state(n, model->R, Q, P, V)) return 0;
    if (!(predicted_variance(n, model->h, F, Q, V) <= model->widest * model->R)) return 0;
    determine(n, V, P, x);
    return 1;
}

#endif
