/* Fixed-interval smoother of one channel, in the form of Bryson and Frazier (1963) and Bierman (1973).

   The pass forward leaves its state before every block. The way back needs only the innovations of a block whose gain
   had settled; any other block is filtered again from that state. Equations are numbered as in core/reference.py. */
#include "filter.h"
#include "gap.h"
#include "pack.h"

enum { LONGEST_WAIT = 50 }; /* missing rows after a reject, beyond which it is a spike for good */

#define MUCH ((real)1e-3) /* of a variance: where later rows leave less of it, P - P M P has lost its digits */

/* A gain that was lost within a block has not settled again at its end: so one that has settled, for as many rows as
   before the block, was used for all of them. */
typedef char settles_late[2 * FIRST_CHECK >= SMOOTHED ? 1 : -1];

static void unsettle_future(future_t *future) {
    future->settled = future->steady = 0;
    future->next_check = FIRST_CHECK;
    future->M_then[0] = -1;
}

static void forget_future(const int n, future_t *future) {
    future->later = 0;
    for (int i = 0; i < n; i++) future->r[i] = 0;
    for (int i = 0; i < n * n; i++) future->M[i] = 0;
    unsettle_future(future);
}

int64_t smoother_room(const int64_t states, const int64_t rows) {
    return ((rows + SMOOTHED - 1) / SMOOTHED + 1 + SMOOTHED) * packed_size(states);
}

void smoother_start(forward_t *forward, future_t *future) {
    memset(forward, 0, sizeof *forward);
    forward->filter.settled_row = -1;
    filter_forget(&forward->filter);
    memset(future, 0, sizeof *future);
    unsettle_future(future);
}

/* Return the part of a block from a row on, at most SMOOTHED rows. */
static block_t part_of(const block_t *block, const int64_t row) {
    block_t part = *block;
    part.z += row, part.elapsed += row, part.step += row;
    part.rows = block->rows - row < SMOOTHED ? block->rows - row : SMOOTHED;
    return part;
}

static estimate_t from_row(const estimate_t *estimate, const int64_t row, const int64_t n) {
    const estimate_t part = {estimate->signal + row, estimate->sigma + row, estimate->verdict + row,
                             estimate->innovation + row, estimate->deviation + row,
                             estimate->x ? estimate->x + row * n : NULL};
    return part;
}

/* Filter a part: all of its measurements may enter. */
static void filter_part(const settings_t *settings, const coefficients_t *model, filter_t *state,
                        const block_t *part, const estimate_t *estimate, const int8_t *starts) {
    pass_t pass;
    memcpy(pass.usable, part->z, sizeof(real) * (size_t)part->rows);
    memcpy(pass.starts, starts, (size_t)part->rows);
    filter_block(settings, model, state, part, estimate, &pass);
}

/* Return the first of the measurements in a row that were rejected before a row, or that row. */
static int64_t first_rejected(const block_t *block, const int8_t *verdict, const int64_t row) {
    int64_t first = row, missing = 0;
    for (int64_t k = row - 1; k >= 0 && missing <= LONGEST_WAIT; k--) {
        if (verdict[k] == SPIKE)
            first = k, missing = 0;
        else if (fabs(block->z[k]) <= BEYOND_ANY_SENSOR)
            break;
        else
            missing++;
    }
    return first;
}

/* Filter SMOOTHED rows; return how many may stay. Rows from where a jump began, which is marked, are to be filtered
   again. */
INLINE int64_t forward_part(const int n, const settings_t *settings, const coefficients_t *model, filter_t *state,
                            const block_t *block, const int64_t row, const estimate_t *estimate, real *room,
                            int8_t *starts) {
    const block_t part = part_of(block, row);
    const estimate_t out = from_row(estimate, row, n);
    pack(n, state, room + (SMOOTHED + row / SMOOTHED) * packed_size(n));
    filter_part(settings, model, state, &part, &out, starts + row);
    for (int64_t k = row; settings->gated && k < row + part.rows; k++) {
        if (estimate->verdict[k] != STEP) continue;
        const int64_t first = first_rejected(block, estimate->verdict, k);
        if (first == k) continue;
        starts[first] = JUMPS;
        return first;
    }
    return row + part.rows;
}

INLINE int64_t forward_rows(const int n, const settings_t *settings, const coefficients_t *model, filter_t *state,
                            const block_t *block, const estimate_t *estimate, real *room, int8_t *starts,
                            const int ends) {
    int64_t rows = block->rows;
    for (int64_t row = 0; row < rows;) {
        const int64_t filtered = row + SMOOTHED < rows ? row + SMOOTHED : rows;
        int64_t stay = forward_part(n, settings, model, state, block, row, estimate, room, starts);
        if (stay == rows && !ends && settings->gated) {
            const int64_t first = first_rejected(block, estimate->verdict, rows);
            if (first < rows) rows = stay = first / SMOOTHED * SMOOTHED; /* it may be a jump yet */
        }
        if (stay < filtered) {
            stay = stay / SMOOTHED * SMOOTHED;
            memset(estimate->verdict + stay, 0, (size_t)(filtered - stay));
            unpack(n, room + (SMOOTHED + stay / SMOOTHED) * packed_size(n), state);
        }
        row = stay;
    }
    pack(n, state, room + (SMOOTHED + (rows + SMOOTHED - 1) / SMOOTHED) * packed_size(n));
    return rows;
}

static void find_starts(const settings_t *settings, limits_t *limits, const block_t *block, const int64_t rows,
                        int8_t *starts) {
    for (int64_t row = 0; row < rows; row++) {
        const int usable = fabs(block->z[row]) <= BEYOND_ANY_SENSOR;
        const int anew = check_gap(settings, limits, block->elapsed[row], usable);
        if (anew) starts[row] = ANEW;
    }
}

int64_t smoother_forward(const settings_t *settings, const coefficients_t *model, forward_t *forward,
                         const block_t *block, const estimate_t *estimate, real *room, int8_t *starts,
                         const int ends) {
    limits_t limits = forward->limits;
    int64_t taken = block->rows;
    memset(starts, 0, (size_t)block->rows);
    find_starts(settings, &limits, block, block->rows, starts);
    FOR_STATES(settings->states, taken = forward_rows, settings, model, &forward->filter, block, estimate, room, starts,
               ends)
    find_starts(settings, &forward->limits, block, taken, starts);
    return taken;
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
    copy(n * n, future->M, future->M_then);
}

/* Smooth a block whose gain had settled before it. */
INLINE void smooth_settled(const int n, const coefficients_t *model, const filter_t *state, const real *F,
                           const block_t *part, future_t *future, const estimate_t *estimate, const int only_future) {
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
        if (!only_future) estimate->signal[row] += dot(n, Pc, r); /* (9) */
        if (estimate->x && !only_future)
            for (int i = 0; i < n; i++) estimate->x[row * n + i] += dot(n, state->P + i * n, r);
        UNROLL
        for (int j = 0; j < n; j++) before[j] = hF[j] * nu + dot(n, B + j * n, r);
        UNROLL
        for (int j = 0; j < n; j++) r[j] = before[j]; /* (11) */
    }
    for (int i = 0; i < n; i++) future->r[i] = r[i];
    for (int64_t row = part->rows - 1; row >= 0; row--) {
        if (!only_future && (!future->settled || row == part->rows - 1)) {
            real left = variance;
            for (int i = 0; i < n; i++) left -= Pc[i] * dot(n, future->M + i * n, Pc); /* (10) */
            sigma = left > 0 ? sqrt(left) : 0;
        }
        if (!only_future) estimate->sigma[row] = sigma;
        if (!future->settled) pull_back(n, A, hF, weight, future->M); /* (12) */
    }
    if (!future->settled) notice_future(n, future, part->rows);
    future->later = 0;
}

/* Write the smoothed state and covariance of a row from those of the row after, one step later: given that, the noise w
   of the step is known by G (W x' - b), where W = U F^-1, G = Q W' (I + W Q W')^-1, and its own covariance is
   V = (I - G W) Q (I - G W)' + G G'. So x = F^-1 (x' - w). U and b are the row's information. */
static int from_later(const int n, const real *U, const real *b, future_t *future) {
    const real *F = future->F, *Q = future->Q;
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
    copy(n * n, Q, T);
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
static int covariance_from_later(const int n, const real *P, future_t *future) {
    const real *F = future->F, *Q = future->Q;
    real A[NN_MAX], M[NN_MAX], C[NN_MAX], D[NN_MAX], back[NN_MAX], V[NN_MAX];
    copy(n * n, P, M);
    propagate(n, F, Q, M);
    copy(n * n, Q, D);
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

/* Smooth one row that was filtered again. */
INLINE void smooth_row(const int n, const coefficients_t *model, const filter_t *row, future_t *future, real *signal,
                       real *sigma) {
    const real level = row->phase == UNKNOWN ? future->level : row->level;
    if (row->phase != DETERMINED) {
        const real nothing[N_MAX] = {0};
        const int unknown = row->phase == UNKNOWN;
        const real *U = unknown ? model->prior : row->P, *b = unknown ? nothing : row->x;
        future->later = future->later && from_later(n, U, b, future);
        if (!future->later) return;
    } else {
        real PM[NN_MAX], smoothed[NN_MAX], Pr[N_MAX];
        int lost = 0;
        multiply(n, row->P, future->M, PM);
        multiply(n, PM, row->P, smoothed);
        for (int i = 0; i < n * n; i++) smoothed[i] = row->P[i] - smoothed[i]; /* (10) */
        for (int i = 0; i < n; i++) lost |= smoothed[i * n + i] < MUCH * row->P[i * n + i];
        if (!(lost && future->later && covariance_from_later(n, row->P, future))) copy(n * n, smoothed, future->P);
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
INLINE void step_back(const int n, const real *h, const filter_t *row, const real *F, const real innovation,
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
    copy(n, r, future->r);
    pull_back(n, A, g, weight, future->M);
}

/* Filter a block again, row by row, and smooth it. */
INLINE void smooth_again(const int n, const settings_t *settings, const coefficients_t *model, filter_t *state,
                         const block_t *part, future_t *future, const estimate_t *estimate, const int8_t *starts,
                         real *room, const int only_future) {
    for (int64_t row = 0; row < part->rows; row++) {
        block_t one = part_of(part, row);
        const estimate_t out = from_row(estimate, row, n);
        one.rows = 1;
        filter_part(settings, model, state, &one, &out, starts + row);
        pack(n, state, room + row * packed_size(n));
    }
    unsettle_future(future);
    for (int64_t row = part->rows - 1; row >= 0; row--) {
        const real *F = part->F + (int64_t)part->step[row] * n * n, *Q = part->Q + (int64_t)part->step[row] * n * n;
        unpack(n, room + row * packed_size(n), state);
        if (!only_future) {
            smooth_row(n, model, state, future, estimate->signal + row, estimate->sigma + row);
            if (estimate->x && future->later) copy(n, future->x, estimate->x + row * n);
        }
        if (state->phase == DETERMINED) step_back(n, model->h, state, F, estimate->innovation[row], future);
        if (starts[row] == ANEW) forget_future(n, future); /* rows before it know nothing of it */
        if (estimate->verdict[row] == STEP) future->later = 0; /* Q is not all that lies between */
        copy(n * n, F, future->F), copy(n * n, Q, future->Q);
    }
}

INLINE void backward_rows(const int n, const settings_t *settings, const coefficients_t *model, future_t *future,
                          const block_t *block, const estimate_t *estimate, real *room, const int8_t *starts,
                          const int only_future) {
    const int64_t parts = (block->rows + SMOOTHED - 1) / SMOOTHED, size = packed_size(n);
    for (int64_t k = parts - 1; k >= 0; k--) {
        const block_t part = part_of(block, k * SMOOTHED);
        const estimate_t out = from_row(estimate, k * SMOOTHED, n);
        const int64_t at = (int64_t)part.step[0] * n * n;
        filter_t state;
        unpack(n, room + (SMOOTHED + k + 1) * size, &state);
        const int64_t settled = state.settled, steady = state.steady;
        unpack(n, room + (SMOOTHED + k) * size, &state);
        if (settled && state.settled && steady == state.steady) { /* one gain for all rows */
            smooth_settled(n, model, &state, part.F + at, &part, future, &out, only_future);
            copy(n * n, part.F + at, future->F), copy(n * n, part.Q + at, future->Q);
        } else
            smooth_again(n, settings, model, &state, &part, future, &out, starts + k * SMOOTHED, room,
                         only_future);
    }
}

void smoother_backward(const settings_t *settings, const coefficients_t *model, future_t *future,
                       const block_t *block, const estimate_t *estimate, real *room, const int8_t *starts,
                       const int only_future) {
    FOR_STATES(settings->states, backward_rows, settings, model, future, block, estimate, room, starts, only_future)
    future->later &= !only_future;
}
