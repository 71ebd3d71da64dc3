/* Linear algebra for n states. For small models `n` is a compile-time constant, so that every loop is unrolled. */
#ifndef BECALM_LINEAR_H
#define BECALM_LINEAR_H

#include <math.h>
#include <string.h>

#include "kernel.h"

#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#define NOINLINE __attribute__((noinline))
#else
#define INLINE static inline
#define NOINLINE
#endif

/* Unroll a loop over states. Clang does so without a pragma. */
#if defined(__GNUC__) && !defined(__clang__)
#define UNROLL _Pragma("GCC unroll 8")
#else
#define UNROLL
#endif

#define LARGEST ((real)1e200) /* limit of an unobservable state, so that it does not overflow in sums with others */
#define UNCHANGED ((real)1e-13) /* largest change, over a scale, that counts as rounding */

INLINE int near(const real now, const real then, const real scale) { return fabs(now - then) <= UNCHANGED * scale; }

#define EVER ((int64_t)1 << 53) /* number of rows that no record reaches */

/* Return whether a whole number, which may come from a file, is between -most and most. */
static inline int is_count(const int64_t count, const int64_t most) { return count >= -most && count <= most; }

INLINE void copy(const int count, const real *from, real *to) { memcpy(to, from, sizeof(real) * (size_t)count); }

INLINE real dot(const int n, const real *a, const real *b) {
    real s = 0;
    UNROLL
    for (int i = 0; i < n; i++) s += a[i] * b[i];
    return s;
}

/* Return one element of A x + b; this order of additions needs few dependent operations after x. */
INLINE real onward(const int n, const real *row, const real *x, const real b) {
    real sum = b + row[0] * x[0];
    UNROLL
    for (int j = 1; j + 1 < n; j += 2) sum += row[j] * x[j] + row[j + 1] * x[j + 1];
    return n % 2 ? sum : sum + row[n - 1] * x[n - 1];
}

/* y = A x */
INLINE void times(const int n, const real *A, const real *x, real *y) {
    for (int i = 0; i < n; i++) y[i] = dot(n, A + i * n, x);
}

/* C = A B */
INLINE void multiply(const int n, const real *A, const real *B, real *C) {
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            real s = 0;
            for (int k = 0; k < n; k++) s += A[i * n + k] * B[k * n + j];
            C[i * n + j] = s;
        }
}

/* P = A P A' + Q (2) */
INLINE void propagate(const int n, const real *A, const real *Q, real *P) {
    real AP[NN_MAX];
    multiply(n, A, P, AP);
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            const real s = Q[i * n + j] + dot(n, AP + i * n, A + j * n);
            P[i * n + j] = P[j * n + i] = s;
        }
}

/* P = (I - K h) P (I - K h)' + K R K', Joseph's form (7); `Ph` is P h'. */
INLINE void joseph(const int n, const real *h, const real R, const real *K, const real *Ph, real *P) {
    real B[NN_MAX], Bh[N_MAX];
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) B[i * n + j] = P[i * n + j] - K[i] * Ph[j];
    times(n, B, h, Bh);
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            const real s = B[i * n + j] - Bh[i] * K[j] + K[i] * R * K[j];
            P[i * n + j] = P[j * n + i] = s;
        }
}

/* g = H F (m, n): the predicted output as a function of the state before the step */
INLINE void multiply_HF(const int n, const int m, const real *H, const real *F, real *g) {
    for (int c = 0; c < m; c++)
        for (int j = 0; j < n; j++) {
            real s = 0;
            for (int i = 0; i < n; i++) s += H[c * n + i] * F[i * n + j];
            g[c * n + j] = s;
        }
}

/* A = F - K g = (I - K H) F, with K (n, m) */
INLINE void close_loop(const int n, const int m, const real *F, const real *K, const real *g, real *A) {
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            real s = F[i * n + j];
            for (int c = 0; c < m; c++) s -= K[i * m + c] * g[c * n + j];
            A[i * n + j] = s;
        }
}

/* Solve A X = B in place by elimination with pivots, B (n, n); A is overwritten. Return whether A has an inverse. */
static inline int solve(const int n, real *A, real *B) {
    for (int k = 0; k < n; k++) {
        int pivot = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(A[i * n + k]) > fabs(A[pivot * n + k])) pivot = i;
        if (A[pivot * n + k] == 0) return 0;
        for (int j = 0; j < n; j++) {
            real t = A[k * n + j];
            A[k * n + j] = A[pivot * n + j], A[pivot * n + j] = t;
            t = B[k * n + j];
            B[k * n + j] = B[pivot * n + j], B[pivot * n + j] = t;
        }
        for (int i = k + 1; i < n; i++) {
            const real factor = A[i * n + k] / A[k * n + k];
            for (int j = 0; j < n; j++) A[i * n + j] -= factor * A[k * n + j], B[i * n + j] -= factor * B[k * n + j];
        }
    }
    for (int k = n - 1; k >= 0; k--)
        for (int j = 0; j < n; j++) {
            for (int i = k + 1; i < n; i++) B[k * n + j] -= A[k * n + i] * B[i * n + j];
            B[k * n + j] /= A[k * n + k];
        }
    return 1;
}

/* Write the inverse of A; return whether it has one. */
static inline int invert(const int n, const real *A, real *inverse) {
    real B[NN_MAX];
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) B[i * n + j] = A[i * n + j], inverse[i * n + j] = i == j;
    return solve(n, B, inverse);
}

#endif
