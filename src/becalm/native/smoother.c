/* Fixed-interval smoother of one channel, in the form of Bryson and Frazier (1963) and Bierman (1973).

   The forward pass stores the state before every block. For a block with the steady-state gain the backward pass needs
   only the innovations; any other block is filtered again from the stored state. Equations are numbered as in
   core/reference/kalman.py. */
#include "backward.h"
#include "gap.h"

enum { LONGEST_WAIT = 50 }; /* after more consecutive missing rows, a rejected measurement remains a spike */

enum { SKIPPED = 2 }; /* value of `only_future`: no row of the block is smoothed */

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

void smoother_begin_after(const settings_t *settings, const coefficients_t *model, forward_t *forward,
                          const real first, const int64_t rows, const real steps) {
    filter_begin_after(settings, model, &forward->limits, &forward->filter, first, rows, steps);
}

/* Return the first of the consecutive rejected measurements before a row, or the row itself if there are none. */
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

/* Filter SMOOTHED rows from `row` on; return the first row that is not final. If it is one of the filtered rows or an
   earlier row, a jump starts there: the row is marked, and rows from there on must be filtered again. */
INLINE int64_t forward_part(const int n, const settings_t *settings, const coefficients_t *model, filter_t *state,
                            const block_t *block, const int64_t row, const estimate_t *estimate, real *room,
                            int8_t *starts) {
    const block_t part = rows_from(block, row, SMOOTHED);
    const estimate_t out = estimate_from(estimate, row, n);
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
            if (first < rows) rows = stay = first / SMOOTHED * SMOOTHED; /* the rejected measurements may still become a jump */
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

int64_t smoother_forward(const settings_t *settings, const coefficients_t *model, forward_t *forward,
                         const block_t *block, const estimate_t *estimate, real *room, int8_t *starts,
                         const int ends) {
    const limits_t before = forward->limits;
    int64_t taken = block->rows;
    memset(starts, 0, (size_t)block->rows);
    find_starts(settings, &forward->limits, block, block->rows, starts);
    FOR_STATES(settings->states, taken = forward_rows, settings, model, &forward->filter, block, estimate, room, starts,
               ends)
    if (taken < block->rows) { /* the caller passes the other rows again */
        forward->limits = before;
        find_starts(settings, &forward->limits, block, taken, starts);
    }
    return taken;
}

/* Add the effect of later rows to the estimates of a row (9). */
INLINE void add_later(const int n, const real *P, const real *Pc, const real *r, const int64_t row,
                      const estimate_t *estimate) {
    estimate->signal[row] += dot(n, Pc, r);
    if (estimate->x)
        for (int i = 0; i < n; i++) estimate->x[row * n + i] += dot(n, P + i * n, r);
}

/* Smooth a block with the steady-state gain. Two rows are processed at once: this halves the number of dependent
   operations in the recursion for r. */
INLINE void smooth_settled(const int n, const coefficients_t *model, const filter_t *state, const real *F,
                           const block_t *part, future_t *future, const estimate_t *estimate, const int only_future) {
    real A[NN_MAX], B[NN_MAX], BB[NN_MAX], hF[N_MAX], BhF[N_MAX], G[N_MAX], Pc[N_MAX], r[N_MAX]; /* B = A' */
    real sigma = 0;
    const real weight = state->S > 0 ? 1 / state->S : 0;
    multiply_HF(n, 1, model->h, F, hF);
    close_loop(n, 1, F, state->K, hF, A);
    for (int i = 0; i < n; i++) {
        G[i] = weight * hF[i];
        for (int j = 0; j < n; j++) B[j * n + i] = A[i * n + j];
    }
    multiply(n, B, B, BB), times(n, B, hF, BhF);
    times(n, state->P, model->c, Pc);
    for (int i = 0; i < n; i++) r[i] = future->r[i];
    for (int64_t row = part->rows - 1; row >= 0; row -= 2) {
        const real nu = weight * estimate->innovation[row], nu_before = row ? weight * estimate->innovation[row - 1] : 0;
        real before[N_MAX], two_before[N_MAX];
        if (!only_future) add_later(n, state->P, Pc, r, row, estimate);
        UNROLL
        for (int j = 0; j < n; j++) before[j] = onward(n, B + j * n, r, hF[j] * nu); /* (11) */
        if (row && !only_future) add_later(n, state->P, Pc, before, row - 1, estimate);
        UNROLL
        for (int j = 0; j < n; j++)
            two_before[j] = row ? onward(n, BB + j * n, r, BhF[j] * nu + hF[j] * nu_before) : before[j];
        UNROLL
        for (int j = 0; j < n; j++) r[j] = two_before[j];
    }
    for (int i = 0; i < n; i++) future->r[i] = r[i];
    for (int64_t row = part->rows - 1; row >= 0; row--) {
        if (!only_future && (!future->settled || row == part->rows - 1)) {
            sigma = sqrt(smoothed_variance(n, model->c, state->P, future->M, NULL)); /* (10) */
        }
        if (!only_future) estimate->sigma[row] = sigma;
        if (row == 0)
            future->later =
                smooth_covariance(n, state->P, future->M, future->P) > LEAST_SHARE ? COVARIANCE_ONLY : NOTHING_LATER;
        if (!future->settled) pull_back(n, 1, A, G, hF, future->M); /* (12) */
    }
    if (!future->settled) check_future(n, future, part->rows);
}

/* Filter a block again, row by row, and smooth it. */
INLINE void smooth_again(const int n, const settings_t *settings, const coefficients_t *model, filter_t *state,
                         const block_t *part, future_t *future, const estimate_t *estimate, int8_t *starts,
                         real *room, const int only_future) {
    for (int64_t row = 0; row < part->rows; row++) {
        const block_t one = rows_from(part, row, 1);
        const estimate_t out = estimate_from(estimate, row, n);
        filter_part(settings, model, state, &one, &out, starts + row);
        pack(n, state, room + row * packed_size(n));
    }
    unsettle_future(future);
    for (int64_t row = part->rows - 1; row >= 0; row--) {
        const real *F = part->F + (int64_t)part->step[row] * n * n, *Q = part->Q + (int64_t)part->step[row] * n * n;
        unpack(n, room + row * packed_size(n), state);
        if (only_future != SKIPPED) {
            real signal = estimate->signal[row], sigma = estimate->sigma[row];
            smooth_row(n, model, state, Q, future, &signal, &sigma);
            if (!only_future) estimate->signal[row] = signal, estimate->sigma[row] = sigma;
            if (!only_future && estimate->x && future->later) copy(n, future->x, estimate->x + row * n);
        } else
            future->later = NOTHING_LATER;
        if (state->phase == DETERMINED)
            step_back(n, model->h, state->S, state->K, F, estimate->innovation[row], future);
        prepare_row_before(n, F, Q, estimate->verdict[row], starts[row], future);
    }
}

INLINE void backward_rows(const int n, const settings_t *settings, const coefficients_t *model, future_t *future,
                          const block_t *block, const estimate_t *estimate, real *room, int8_t *starts,
                          const int only_future) {
    const int64_t parts = (block->rows + SMOOTHED - 1) / SMOOTHED, size = packed_size(n);
    for (int64_t k = parts - 1; k >= 0; k--) {
        const block_t part = rows_from(block, k * SMOOTHED, SMOOTHED);
        const estimate_t out = estimate_from(estimate, k * SMOOTHED, n);
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
                         only_future && k ? SKIPPED : only_future);
    }
}

void smoother_backward(const settings_t *settings, const coefficients_t *model, future_t *future,
                       const block_t *block, const estimate_t *estimate, real *room, int8_t *starts,
                       const int only_future) {
    FOR_STATES(settings->states, backward_rows, settings, model, future, block, estimate, room, starts, only_future)
}
