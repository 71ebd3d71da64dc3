/* Fixed-interval smoother of one channel, in the form of Bryson and Frazier (1963) and Bierman (1973).

   The pass forward leaves its state before every block. The way back needs only the innovations of a block whose gain
   had settled; any other block is filtered again from that state. Equations are numbered as in core/reference.py. */
#include "filter.h"
#include "gap.h"

#define MUCH ((real)1e-3) /* of a variance: where later rows leave less of it, P - P M P has lost its digits */

/* One row that was filtered again. */
typedef struct {
    real x[N_MAX], P[NN_MAX], K[N_MAX], S, level;
    int64_t phase;
} row_t;

static void unsettle_future(future_t *future) {
    future->settled = future->steady = 0;
    future->next_check = FIRST_CHECK;
    future->M_then[0] = -1;
}

int64_t smoother_checkpoints(const int64_t rows) { return (rows + SMOOTHED - 1) / SMOOTHED + 1; }

static void forget_future(future_t *future) {
    memset(future, 0, sizeof *future);
    unsettle_future(future);
}

void smoother_start(smoother_t *smoother) {
    memset(smoother, 0, sizeof *smoother);
    smoother->filter.settled_row = -1;
    forget(&smoother->filter);
    forget_future(&smoother->future);
}

/* Return the part of a block from a row on, at most SMOOTHED rows. */
static block_t part_of(const block_t *block, const int64_t row) {
    block_t part = *block;
    part.z += row, part.elapsed += row, part.step += row;
    part.rows = block->rows - row < SMOOTHED ? block->rows - row : SMOOTHED;
    return part;
}

static estimate_t from_row(const estimate_t *estimate, const int64_t row) {
    const estimate_t part = {estimate->signal + row, estimate->sigma + row, estimate->verdict + row,
                             estimate->innovation + row, estimate->deviation + row, NULL};
    return part;
}

/* Filter a part: all of its measurements may enter. */
static void filter_part(const settings_t *settings, const coefficients_t *model, filter_t *state, const block_t *part,
                        const estimate_t *estimate, const int8_t *starts) {
    pass_t pass = {{0}, {0}};
    memcpy(pass.usable, part->z, sizeof(real) * (size_t)part->rows);
    memcpy(pass.anew, starts, (size_t)part->rows);
    filter_block(settings, model, state, part, estimate, &pass);
}

void smoother_forward(const settings_t *settings, const coefficients_t *model, smoother_t *smoother,
                      const block_t *block, const estimate_t *estimate, filter_t *checkpoints, int8_t *starts) {
    for (int64_t row = 0; row < block->rows; row++) {
        const int usable = fabs(block->z[row]) <= BEYOND_ANY_SENSOR;
        starts[row] = (int8_t)check_gap(settings, &smoother->limits, block->elapsed[row], usable);
    }
    for (int64_t row = 0; row < block->rows; row += SMOOTHED) {
        const block_t part = part_of(block, row);
        const estimate_t out = from_row(estimate, row);
        *checkpoints++ = smoother->filter;
        filter_part(settings, model, &smoother->filter, &part, &out, starts + row);
    }
    *checkpoints = smoother->filter;
}

/* M = A' M A + g g' / S */
INLINE void pull_back(const int n, const real *A, const real *g, const real weight, real *M) {
    real MA[NN_MAX];
    multiply(n, M, A, MA);
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            real s = weight * g[i] * g[j];
            for (int k = 0; k < n; k++) s += A[k * n + i] * MA[k * n + j];
            M[i * n + j] = M[j * n + i] = s;
        }
}

/* Notice that M is the same as an eighth of the stretch before. */
static void notice_future(const int n, future_t *future, const int64_t rows) {
    future->steady += rows;
    if (future->steady < future->next_check) return;
    future->next_check = future->steady + (future->steady / 8 > FIRST_CHECK ? future->steady / 8 : FIRST_CHECK);
    future->settled = 1;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            const real scale = sqrt(future->M[i * n + i]) * sqrt(future->M[j * n + j]);
            future->settled &= near(future->M[i * n + j], future->M_then[i * n + j], scale);
        }
    memcpy(future->M_then, future->M, sizeof future->M);
}

/* Smooth a block whose gain had settled before it. */
INLINE void smooth_settled(const int n, const coefficients_t *model, const filter_t *state, const real *F,
                           const block_t *part, future_t *future, const estimate_t *estimate) {
    real A[NN_MAX], B[NN_MAX], hF[N_MAX], Pc[N_MAX], r[N_MAX], sigma = 0; /* B = A' */
    const real weight = 1 / state->S, variance = state->sigma * state->sigma;
    for (int j = 0; j < n; j++) {
        hF[j] = 0;
        for (int i = 0; i < n; i++) hF[j] += model->h[i] * F[i * n + j];
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) A[i * n + j] = B[j * n + i] = F[i * n + j] - state->K[i] * hF[j]; /* (I - K h) F */
    times(n, state->P, model->c, Pc);
    for (int i = 0; i < n; i++) r[i] = future->r[i];
    for (int64_t row = part->rows - 1; row >= 0; row--) {
        real before[N_MAX];
        const real nu = weight * estimate->innovation[row];
        estimate->signal[row] += dot(n, Pc, r); /* (9) */
        UNROLL
        for (int j = 0; j < n; j++) before[j] = hF[j] * nu + dot(n, B + j * n, r);
        UNROLL
        for (int j = 0; j < n; j++) r[j] = before[j]; /* (11) */
    }
    for (int i = 0; i < n; i++) future->r[i] = r[i];
    for (int64_t row = part->rows - 1; row >= 0; row--) {
        if (!future->settled || row == part->rows - 1) {
            real left = variance;
            for (int i = 0; i < n; i++) left -= Pc[i] * dot(n, future->M + i * n, Pc); /* (10) */
            sigma = left > 0 ? sqrt(left) : 0;
        }
        estimate->sigma[row] = sigma;
        if (!future->settled) pull_back(n, A, hF, weight, future->M); /* (12) */
    }
    if (!future->settled) notice_future(n, future, part->rows);
    future->later = 0;
}

/* Write the smoothed state and covariance of a row from those of the row after, one step later: given that, the noise w
   of the step is known by G (W x' - b), where W = U F^-1, G = Q W' (I + W Q W')^-1, and its own covariance is
   V = (I - G W) Q (I - G W)' + G G'. So x = F^-1 (x' - w). U and b are the row's information. */
static int from_later(const int n, const real *F, const real *Q, const real *U, const real *b, future_t *future) {
    real W[NN_MAX], T[NN_MAX], G[NN_MAX], V[NN_MAX], J[NN_MAX], back[NN_MAX], x[N_MAX], Gb[N_MAX];
    if (!invert(n, F, back)) return 0;
    multiply(n, U, back, W);
    multiply(n, W, Q, G); /* (Q W')' */
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            T[i * n + j] = dot(n, G + i * n, W + j * n) + (i == j);
            if (i == j && !(T[i * n + i] < LOST_DIGITS)) return 0;
        }
    if (!solve(n, T, G)) return 0; /* G' = T^-1 W Q */
    for (int i = 0; i < n; i++) {
        Gb[i] = 0;
        for (int k = 0; k < n; k++) Gb[i] += G[k * n + i] * b[k];
        for (int j = 0; j < n; j++) {
            J[i * n + j] = i == j;
            for (int k = 0; k < n; k++) J[i * n + j] -= G[k * n + i] * W[k * n + j]; /* I - G W */
        }
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            V[i * n + j] = 0;
            for (int k = 0; k < n; k++) V[i * n + j] += G[k * n + i] * G[k * n + j];
        }
    memcpy(T, Q, sizeof(real) * (size_t)(n * n));
    propagate(n, J, V, T); /* T = (I - G W) Q (I - G W)' + G G' */
    propagate(n, J, T, future->P);
    for (int i = 0; i < n * n; i++) V[i] = 0;
    propagate(n, back, V, future->P);
    times(n, J, future->x, x);
    for (int i = 0; i < n; i++) x[i] += Gb[i];
    times(n, back, x, future->x);
    return 1;
}

/* The same where the row has a covariance, which P - P M P would lose the digits of: with M = F P F' + Q and
   C = F^-1 (I - Q M^-1), it is C P' C' + C Q F'^-1 (Anderson and Moore 1979, chapter 10). */
static int covariance_from_later(const int n, const real *F, const real *Q, const real *P, future_t *future) {
    real A[NN_MAX], M[NN_MAX], C[NN_MAX], D[NN_MAX], back[NN_MAX], V[NN_MAX];
    memcpy(M, P, sizeof M);
    propagate(n, F, Q, M);
    memcpy(D, Q, sizeof(real) * (size_t)(n * n));
    if (!invert(n, F, back) || !solve(n, M, D)) return 0; /* D = M^-1 Q */
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) A[i * n + j] = (i == j) - D[j * n + i]; /* I - Q M^-1 */
    multiply(n, back, A, C);
    multiply(n, C, Q, A);
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) V[i * n + j] = V[j * n + i] = dot(n, A + i * n, back + j * n);
    propagate(n, C, V, future->P);
    return 1;
}

/* Smooth one row that was filtered again; F and Q are of the step to the row after. */
static void smooth_row(const int n, const coefficients_t *model, const row_t *row, const real *F, const real *Q,
                       future_t *future, real *signal, real *sigma) {
    const real level = row->phase == UNKNOWN ? future->level : row->level;
    if (row->phase != DETERMINED) {
        const real nothing[N_MAX] = {0};
        const int unknown = row->phase == UNKNOWN;
        const real *U = unknown ? model->prior : row->P, *b = unknown ? nothing : row->x;
        future->later = future->later && from_later(n, F, Q, U, b, future);
        if (!future->later) return;
    } else {
        real PM[NN_MAX], smoothed[NN_MAX], Pr[N_MAX];
        int lost = 0;
        multiply(n, row->P, future->M, PM);
        multiply(n, PM, row->P, smoothed);
        for (int i = 0; i < n * n; i++) smoothed[i] = row->P[i] - smoothed[i]; /* (10) */
        for (int i = 0; i < n; i++) lost |= smoothed[i * n + i] < MUCH * row->P[i * n + i];
        if (!(lost && future->later && covariance_from_later(n, F, Q, row->P, future)))
            memcpy(future->P, smoothed, sizeof smoothed);
        times(n, row->P, future->r, Pr);
        for (int i = 0; i < n; i++) future->x[i] = row->x[i] + Pr[i]; /* (9) */
        future->later = 1;
    }
    real Pc[N_MAX];
    times(n, future->P, model->c, Pc);
    const real variance = dot(n, model->c, Pc);
    future->level = level;
    *signal = dot(n, model->c, future->x) + level;
    *sigma = variance > 0 ? sqrt(variance) : 0;
}

/* Carry what later rows say through the update of a row, and through the step before it (11), (12). */
static void step_back(const int n, const real *h, const row_t *row, const real *F, const real innovation,
                      future_t *future) {
    real A[NN_MAX], g[N_MAX], r[N_MAX];
    const int used = !isnan(innovation);
    const real weight = used ? 1 / row->S : 0;
    for (int j = 0; j < n; j++) {
        g[j] = 0;
        for (int i = 0; i < n; i++) g[j] += h[i] * F[i * n + j];
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) A[i * n + j] = F[i * n + j] - (used ? row->K[i] * g[j] : 0);
    for (int j = 0; j < n; j++) {
        r[j] = used ? g[j] * weight * innovation : 0;
        for (int i = 0; i < n; i++) r[j] += A[i * n + j] * future->r[i];
    }
    memcpy(future->r, r, sizeof r);
    pull_back(n, A, g, weight, future->M);
}

/* Filter a block again, row by row, and smooth it. */
static void smooth_again(const settings_t *settings, const coefficients_t *model, filter_t state, const block_t *part,
                         future_t *future, const estimate_t *estimate, const int8_t *starts, const int64_t step_after) {
    const int n = (int)settings->states;
    row_t rows[SMOOTHED];
    for (int64_t row = 0; row < part->rows; row++) {
        block_t one = part_of(part, row);
        const estimate_t out = from_row(estimate, row);
        one.rows = 1;
        filter_part(settings, model, &state, &one, &out, starts + row);
        memcpy(rows[row].x, state.x, sizeof state.x);
        memcpy(rows[row].P, state.P, sizeof state.P);
        memcpy(rows[row].K, state.K, sizeof state.K);
        rows[row].S = state.S, rows[row].level = state.level, rows[row].phase = state.phase;
    }
    unsettle_future(future);
    for (int64_t row = part->rows - 1; row >= 0; row--) {
        const int64_t after = row + 1 < part->rows ? part->step[row + 1] : step_after;
        const real *F = part->F + (int64_t)part->step[row] * n * n;
        smooth_row(n, model, rows + row, part->F + after * n * n, part->Q + after * n * n, future,
                   estimate->signal + row, estimate->sigma + row);
        if (rows[row].phase == DETERMINED) step_back(n, model->h, rows + row, F, estimate->innovation[row], future);
        if (starts[row]) forget_future(future); /* rows before it know nothing of it */
    }
}

/* Whether a gain had settled before a block, and was used for all of its rows. */
static int was_settled(const filter_t *before, const filter_t *after) {
    return before->settled && after->settled && before->steady == after->steady;
}

void smoother_backward(const settings_t *settings, const coefficients_t *model, smoother_t *smoother,
                       const block_t *block, const estimate_t *estimate, const filter_t *checkpoints,
                       const int8_t *starts) {
    future_t *future = &smoother->future;
    const int64_t parts = (block->rows + SMOOTHED - 1) / SMOOTHED;
    int64_t step_after = 0;
    for (int64_t k = parts - 1; k >= 0; k--) {
        const block_t part = part_of(block, k * SMOOTHED);
        const estimate_t out = from_row(estimate, k * SMOOTHED);
        const real *F = block->F + part.step[0] * settings->states * settings->states;
        if (!was_settled(checkpoints + k, checkpoints + k + 1))
            smooth_again(settings, model, checkpoints[k], &part, future, &out, starts + k * SMOOTHED, step_after);
        else
            FOR_STATES(settings->states, smooth_settled, model, checkpoints + k, F, &part, future, &out);
        step_after = part.step[0];
    }
}
