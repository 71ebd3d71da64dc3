/* The states of all modes at a row: mu is the probability of each mode, x and P its state and covariance. */
#ifndef BECALM_MODES_H
#define BECALM_MODES_H

#include "imm.h"
#include "pair.h"

#define UNLIKELY ((real)1e-100) /* least probability of a mode, so that every mode can become probable again */

typedef struct {
    real *mu, *x, *P; /* (M,), (M, n), (M, n, n) */
} mode_states_t;

INLINE mode_states_t beliefs_in(const int n, const int m, real *memory) {
    const mode_states_t beliefs = {memory, memory + m, memory + m + m * n};
    return beliefs;
}

/* Return a pointer to the first of the `rows` numbers of one mode; its next numbers are two places apart. */
INLINE real *numbers_of(pair_t *numbers, const int rows, const int mode) {
    return (real *)(numbers + mode / 2 * rows) + mode % 2;
}

/* Copy numbers of all modes, (M, rows), into pairs; the next function copies them back. */
INLINE void pack_modes(const int rows, const int m, const real *from, pair_t *to) {
    for (int i = 0; i < (m + 1) / 2 * rows; i++) to[i] = both(0);
    for (int j = 0; j < m; j++)
        for (int i = 0; i < rows; i++) numbers_of(to, rows, j)[2 * i] = from[j * rows + i];
}

INLINE void unpack_modes(const int rows, const int m, pair_t *from, real *to) {
    for (int j = 0; j < m; j++)
        for (int i = 0; i < rows; i++) to[j * rows + i] = numbers_of(from, rows, j)[2 * i];
}

/* Write the estimates of a row. */
INLINE void write_estimate(const int n, const int m, const real *c, const real level, const mode_states_t now,
                           const int64_t row, const imm_estimate_t *estimate) {
    if (estimate->signal) {
        real own[MODES_MAX], y = 0, v = 0, Pc[N_MAX];
        for (int j = 0; j < m; j++) own[j] = dot(n, c, now.x + j * n), y += now.mu[j] * own[j];
        for (int j = 0; j < m; j++) {
            times(n, now.P + j * n * n, c, Pc);
            v += now.mu[j] * (dot(n, c, Pc) + (own[j] - y) * (own[j] - y));
        }
        estimate->signal[row] = y + level, estimate->sigma[row] = v > 0 ? sqrt(v) : 0;
    }
    if (estimate->probability)
        for (int j = 0; j < m; j++) estimate->probability[j * estimate->rows + row] = now.mu[j];
    if (estimate->mean)
        for (int a = 0; a < n; a++) {
            real s = 0;
            for (int j = 0; j < m; j++) s += now.mu[j] * now.x[j * n + a];
            estimate->mean[a * estimate->rows + row] = s;
        }
}

/* Filter rows with a given level; the states in `beliefs` change. */
void filter_modes(const imm_t *imm, real *beliefs, real level, const imm_block_t *block, const imm_estimate_t *estimate,
                  const imm_passed_t *passed, real *room, score_t *score);

#endif
