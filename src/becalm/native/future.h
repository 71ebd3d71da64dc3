/* The information of later rows on a state (Bryson and Frazier 1963, Bierman 1973), for one channel or several, and
   tests whether the smoothed state is accurate. Equations are numbered as in core/reference/kalman.py. */
#ifndef BECALM_FUTURE_H
#define BECALM_FUTURE_H

#include "filter.h"
#include "information.h"

#define ACCURATE_SHARE ((real)2e-3) /* smoothed over filtered variance: below this, P - P M P loses digits */
#define LEAST_SHARE ((real)1e-10)   /* smoothed over filtered variance: below this, all digits are lost */
#define BLOWN_UP ((real)1e4)        /* standard deviation of F^-1 x' over that of x: above this, F^-1 is not used */

/* Values of `later`: which smoothed results of the next row are known. */
enum { NOTHING_LATER = 0, COVARIANCE_ONLY = 1, STATE_TOO = 2 };

/* Check at compile time: if the gain changes within a block, it cannot settle again before the end of the block. So if
   the gain is settled before and after a block, with the same `steady`, it was used for all rows of the block. */
typedef char settles_late[2 * FIRST_CHECK >= SMOOTHED ? 1 : -1];

static inline void unsettle_future(future_t *future) {
    future->settled = future->steady = 0;
    future->next_check = FIRST_CHECK;
    future->M_then[0] = -1;
}

static inline void forget_future(const int n, future_t *future) {
    future->later = 0;
    for (int i = 0; i < n; i++) future->r[i] = 0;
    for (int i = 0; i < n * n; i++) future->M[i] = 0;
    unsettle_future(future);
}

/* Pass back over a row of m channels: r = A' r + G nu (11), G = (H F)' S^-1 (n, m) */
INLINE void pull_back_state(const int n, const int m, const real *A, const real *G, const real *nu, real *r) {
    real before[N_MAX];
    for (int j = 0; j < n; j++) {
        before[j] = 0;
        for (int c = 0; c < m; c++) before[j] += G[j * m + c] * nu[c];
        for (int i = 0; i < n; i++) before[j] += A[i * n + j] * r[i];
    }
    copy(n, before, r);
}

/* Pass back over a row: M = A' M A + G g (12), g = H F (m, n) */
INLINE void pull_back(const int n, const int m, const real *A, const real *G, const real *g, real *M) {
    real MA[NN_MAX];
    multiply(n, M, A, MA);
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            real s = 0;
            for (int c = 0; c < m; c++) s += G[i * m + c] * g[c * n + j];
            for (int k = 0; k < n; k++) s += A[k * n + i] * MA[k * n + j];
            M[i * n + j] = M[j * n + i] = s;
        }
}

/* Check whether M is the same as at the last check; the next check follows after another eighth of the rows. */
static inline void check_future(const int n, future_t *future, const int64_t rows) {
    future->steady += rows;
    if (future->steady < future->next_check) return;
    future->next_check = future->steady + (future->steady / 8 > FIRST_CHECK ? future->steady / 8 : FIRST_CHECK);
    future->settled = 1;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            const real scale = sqrt(future->M[i * n + i]) * sqrt(future->M[j * n + j]);
            future->settled &= near(future->M[i * n + j], future->M_then[i * n + j], scale);
        }
    copy(n * n, future->M, future->M_then);
}

/* Write P - P M P (10); return the smallest ratio of a smoothed variance to its filtered variance. The product is
   computed as L (I - L' M L) L' with P = L L', because P M P has no digits if only a sum of states is determined. */
INLINE real smooth_covariance(const int n, const real *P, const real *M, real *smoothed) {
    real L[NN_MAX], ML[NN_MAX], left[NN_MAX], least = 1;
    covariance_root(n, P, L);
    multiply(n, M, L, ML);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            left[i * n + j] = i == j;
            for (int k = i; k < n; k++) left[i * n + j] -= L[k * n + i] * ML[k * n + j];
        }
    multiply(n, L, left, ML);
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) smoothed[i * n + j] = smoothed[j * n + i] = dot(n, ML + i * n, L + j * n);
    for (int i = 0; i < n; i++) {
        const real share = P[i * n + i] > 0 ? smoothed[i * n + i] / P[i * n + i] : 1;
        least = share < least ? share : least;
    }
    return least;
}

/* Solve joint equations (R S; 0 ..) for u = R^-1 (d - S x'), given the state x' of the next row: write A and g of
   u = A x' + g, and Z = R^-1; Z Z' is the covariance of u given x'. */
static inline void solve_joint(const int n, const real *joint, const real *right, real *A, real *g, real *Z) {
    for (int j = 0; j < n; j++)
        for (int i = n - 1; i >= 0; i--) {
            real s = i == j;
            for (int k = i + 1; k <= j; k++) s -= joint[i * 2 * n + k] * Z[k * n + j];
            Z[i * n + j] = i > j ? 0 : s / joint[i * 2 * n + i];
        }
    for (int i = 0; i < n; i++) {
        g[i] = 0;
        for (int k = i; k < n; k++) g[i] += Z[i * n + k] * right[k];
        for (int j = 0; j < n; j++) {
            A[i * n + j] = 0;
            for (int k = i; k < n; k++) A[i * n + j] -= Z[i * n + k] * joint[k * 2 * n + n + j];
        }
    }
}

/* Join the information on a state, U x = b + e, with the step to the next one, L^-1 (x' - F x) = e, in the unknowns
   (x, x'). This is for steps for which F^-1 is inaccurate, because a part of the state has decayed. Return whether
   the equations can be solved. */
static inline int join_next(const int n, const real *F, const real *L, const real *U, const real *b, real *joint,
                     real *right) {
    real back[NN_MAX];
    memset(joint, 0, sizeof(real) * (size_t)(4 * n * n));
    memset(right, 0, sizeof(real) * (size_t)(2 * n));
    if (!invert(n, L, back)) return 0;
    for (int i = 0; i < 2 * n; i++) {
        real a[2 * N_MAX];
        for (int j = 0; j < n; j++) {
            a[j] = i < n ? U[i * n + j] : 0, a[n + j] = i < n ? 0 : -back[(i - n) * n + j];
            for (int k = 0; i >= n && k <= i - n; k++) a[j] += back[(i - n) * n + k] * F[k * n + j];
        }
        add_equation(2 * n, a, i < n ? b[i] : 0, joint, right);
    }
    for (int i = 0; i < n; i++)
        if (joint[i * 2 * n + i] == 0) return 0;
    return 1;
}

/* Write the smoothed state and covariance of a row with the information U x = b + e, from those of the next row; this
   information need not determine the state. Given x', the equations determine the noise w of the step, and then
   x = F^-1 (x' - L w), or they determine x itself. */
static inline int from_later(const int n, const real *U, const real *b, future_t *future) {
    real L[NN_MAX], back[NN_MAX], joint[4 * NN_MAX], right[2 * N_MAX];
    real A[NN_MAX], Z[NN_MAX], g[N_MAX], J[NN_MAX], V[NN_MAX], LZ[NN_MAX], x[N_MAX];
    covariance_root(n, future->Q, L);
    const int by_noise = join_step(n, future->F, L, U, b, back, joint, right);
    if (!by_noise && !join_next(n, future->F, L, U, b, joint, right)) return 0;
    solve_joint(n, joint, right, A, g, Z);
    if (by_noise) { /* x = F^-1 (J x' - L g) + F^-1 L Z e, J = I - L A */
        multiply(n, L, A, J);
        multiply(n, L, Z, LZ);
        for (int i = 0; i < n * n; i++) J[i] = (i % (n + 1) == 0) - J[i];
        times(n, L, g, x);
        multiply(n, back, J, A);
        multiply(n, back, LZ, Z);
        times(n, back, x, g);
        for (int i = 0; i < n; i++) g[i] = -g[i];
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) V[i * n + j] = dot(n, Z + i * n, Z + j * n);
    propagate(n, A, V, future->P);
    times(n, A, future->x, x);
    for (int i = 0; i < n; i++) future->x[i] = x[i] + g[i];
    return 1;
}

/* Write F^-1; return whether it is accurate for a row. It amplifies states that have decayed, and their rounding
   errors. */
static inline int invert_accurately(const int n, const real *F, const real *P, const real *M, real *back) {
    if (!invert(n, F, back)) return 0;
    for (int i = 0; i < n; i++) {
        real blown_up = 0;
        for (int j = 0; j < n; j++) blown_up += fabs(back[i * n + j]) * sqrt(M[j * n + j]);
        if (!(blown_up < BLOWN_UP * sqrt(P[i * n + i]))) return 0;
    }
    return 1;
}

/* Write the smoothed covariance of a row with covariance P from that of the next row, P', if P - P M P would lose its
   digits. With M = F P F' + Q and C = F^-1 (I - Q M^-1) the result is C P' C' + C Q F'^-1 (Anderson and Moore 1979,
   chapter 10). If F^-1 is inaccurate, use the equal expression in Joseph's form, with K = P F' M^-1:
   (I - K F) P (I - K F)' + K (Q + P') K'. Return whether M has an inverse. */
static inline int covariance_from_later(const int n, const real *P, future_t *future) {
    const real *F = future->F, *Q = future->Q;
    real A[NN_MAX], M[NN_MAX], C[NN_MAX], D[NN_MAX], back[NN_MAX], V[NN_MAX];
    copy(n * n, P, M);
    propagate(n, F, Q, M);
    const int by_inverse = invert_accurately(n, F, P, M, back);
    if (by_inverse)
        copy(n * n, Q, D);
    else
        multiply(n, F, P, D);
    if (!solve(n, M, D)) return 0; /* D = M^-1 Q, or K' */
    if (by_inverse) {
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++) A[i * n + j] = (i == j) - D[j * n + i]; /* I - Q M^-1 */
        multiply(n, back, A, C);
        multiply(n, C, Q, A);
        for (int i = 0; i < n; i++)
            for (int j = 0; j <= i; j++) V[i * n + j] = V[j * n + i] = dot(n, A + i * n, back + j * n);
        propagate(n, C, V, future->P);
        return 1;
    }
    for (int i = 0; i < n * n; i++) future->P[i] += Q[i], V[i] = 0;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            C[i * n + j] = D[j * n + i], A[i * n + j] = i == j;
            for (int k = 0; k < n; k++) A[i * n + j] -= D[k * n + i] * F[k * n + j];
        }
    propagate(n, C, V, future->P);
    copy(n * n, P, D);
    propagate(n, A, future->P, D);
    copy(n * n, D, future->P);
    return 1;
}

/* Return the smoothed variance of c x; if its digits are lost, return the filtered variance instead. */
INLINE real smoothed_variance(const int n, const real *c, const real *P, const real *M, const real *recomputed) {
    real Pc[N_MAX];
    times(n, P, c, Pc);
    const real variance = dot(n, c, Pc);
    real left = variance;
    for (int i = 0; i < n; i++) left -= Pc[i] * dot(n, M + i * n, Pc);
    if (recomputed && left < ACCURATE_SHARE * variance) {
        times(n, recomputed, c, Pc);
        const real recomputed_variance = dot(n, c, Pc);
        return recomputed_variance > 0 ? recomputed_variance : variance;
    }
    return left > LEAST_SHARE * variance && left > 0 ? left : variance > 0 ? variance : 0;
}

#endif
