/* The first measurements, which do not determine the state yet: their information is gathered.

   U x = b + e with e ~ N(0, I); U is upper triangular and may have empty rows (Bierman 1977, square root information
   filter). No prior is needed, and none is made up. */
#ifndef BECALM_OPENING_H
#define BECALM_OPENING_H

#include "linear.h"

#define WELL_DETERMINED ((real)1e-6) /* of information scaled to a unit diagonal: its least eigenvalue */
#define LIVE ((real)3e-5)            /* of a column: a diagonal element of U that says something */

/* Add an equation, a x = b, by rotations; `a` is used up. */
static void add_equation(const int n, real *a, real right, real *U, real *b) {
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

static void add_information(const int n, const real *h, const real R, const real z, real *U, real *b) {
    real a[N_MAX];
    for (int i = 0; i < n; i++) a[i] = h[i] / sqrt(R);
    add_equation(n, a, z / sqrt(R), U, b);
}

/* Begin with what the model itself knows. */
static void begin_information(const int n, const real *prior, real *U, real *b) {
    for (int i = 0; i < n * n; i++) U[i] = prior[i];
    for (int i = 0; i < n; i++) b[i] = 0;
}

/* Predict one step. With W = U F^-1 the equations are W x' = b + e + W w; they are whitened by the root of
   I + W Q W'. After a step so long that all has faded, or that digits are lost, only the prior is left. */
static void carry_information(const int n, const real *F, const real *Q, const real *prior, real *U, real *b) {
    real back[NN_MAX], W[NN_MAX], T[NN_MAX], right[N_MAX];
    if (!invert(n, F, back)) {
        begin_information(n, prior, U, b);
        return;
    }
    multiply(n, U, back, W);
    for (int i = 0; i < n; i++) { /* T = I + W Q W' = C C', and C^-1 W, row by row */
        real WQ[N_MAX];
        for (int j = 0; j < n; j++) {
            WQ[j] = 0;
            for (int k = 0; k < n; k++) WQ[j] += W[i * n + k] * Q[k * n + j];
        }
        for (int j = 0; j < n; j++) T[i * n + j] = dot(n, WQ, W + j * n) + (i == j);
        right[i] = b[i];
    }
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) {
            real s = T[i * n + j];
            for (int k = 0; k < j; k++) s -= T[i * n + k] * T[j * n + k];
            if (i == j && !(s * LOST_DIGITS >= T[i * n + i] && T[i * n + i] < INFINITE)) {
                begin_information(n, prior, U, b);
                return;
            }
            T[i * n + j] = i == j ? sqrt(s) : s / T[j * n + j];
        }
        for (int k = 0; k < i; k++) {
            for (int j = 0; j < n; j++) W[i * n + j] -= T[i * n + k] * W[k * n + j];
            right[i] -= T[i * n + k] * right[k];
        }
        for (int j = 0; j < n; j++) W[i * n + j] /= T[i * n + i];
        right[i] /= T[i * n + i];
    }
    for (int i = 0; i < n * n; i++) U[i] = 0;
    for (int i = 0; i < n; i++) b[i] = 0;
    for (int i = 0; i < n; i++) add_equation(n, W + i * n, right[i], U, b);
}

/* Return the length of a column of U. */
static real column(const int n, const real *U, const int j) {
    real s = 0;
    for (int i = 0; i <= j; i++) s += U[i * n + j] * U[i * n + j];
    return sqrt(s);
}

/* Estimate h x and its standard deviation from what is known; NaN and inf where that does not tell. */
static void estimate_from_information(const int n, const real *h, const real *U, const real *b, real *signal,
                                      real *sigma) {
    real w[N_MAX], most = 0, variance = 0, value = 0;
    for (int j = 0; j < n; j++) {
        const real scaled = fabs(h[j]) / (column(n, U, j) > 0 ? column(n, U, j) : 1);
        most = scaled > most ? scaled : most;
    }
    for (int j = 0; j < n; j++) { /* U' w = h: the equations that make it up */
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

/* Turn information into a state and its covariance, in place; return whether it determines them. */
static int try_to_determine(const int n, real *P, real *x) {
    real V[NN_MAX], state[N_MAX], squares = 0; /* V = U^-1 */
    for (int j = 0; j < n; j++) {
        if (!(fabs(P[j * n + j]) > LIVE * column(n, P, j))) return 0;
        for (int i = n - 1; i >= 0; i--) {
            real s = i == j;
            for (int k = i + 1; k <= j; k++) s -= P[i * n + k] * V[k * n + j];
            V[i * n + j] = i > j ? 0 : s / P[i * n + i];
        }
    }
    for (int i = 0; i < n; i++)
        for (int j = i; j < n; j++) {
            const real scaled = V[i * n + j] * column(n, P, i);
            squares += scaled * scaled;
        }
    if (!(squares * WELL_DETERMINED < 1)) return 0;
    times(n, V, x, state);
    for (int i = 0; i < n; i++) {
        x[i] = state[i];
        for (int j = 0; j < n; j++) P[i * n + j] = dot(n, V + i * n, V + j * n);
    }
    return 1;
}

#endif
