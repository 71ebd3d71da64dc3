/* Fixed-interval smoother of one channel, in the form of Bryson and Frazier (1963) and Bierman (1973).

   The pass forward leaves its state before every block. The way back needs only the innovations of a block whose gain
   had settled; any other block is filtered again from that state. Equations are numbered as in core/reference.py. */
#include "filter.h"
#include "gap.h"
#include "information.h"
#include "pack.h"

enum { LONGEST_WAIT = 50 }; /* missing rows after a reject, beyond which it is a spike for good */

#define MUCH ((real)1e-3)    /* of a variance: where later rows leave less of it, P - P M P loses its digits */
#define HARDLY ((real)1e-10) /* of a variance: and where they leave less than that, it has lost them */
#define BLOWN_UP ((real)1e4) /* times what a row knows: then F^-1 of the next says nothing of it */

enum { SKIPPED = 2 }; /* of `only_future`: not even the last rows are smoothed */
enum { NOTHING_LATER = 0, COVARIANCE_ONLY = 1, STATE_TOO = 2 }; /* what `later` tells of the row after */

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

/* Write P - P M P (10); return how little it leaves of a variance at the least, as a share. It is L (I - L' M L) L' with
   P = L L': where states are known by their sum alone, P M P has no digits. */
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
        if (row == 0)
            future->later =
                smooth_covariance(n, state->P, future->M, future->P) > HARDLY ? COVARIANCE_ONLY : NOTHING_LATER;
        if (!future->settled) pull_back(n, A, hF, weight, future->M); /* (12) */
    }
    if (!future->settled) notice_future(n, future, part->rows);
}

/* Given what later rows say of x', write u = R^-1 (d - S x'), of which joint equations (R S; 0 ..) are, as A x' + g,
   and Z = R^-1, whose square is its own covariance. */
static void solve_joint(const int n, const real *joint, const real *right, real *A, real *g, real *Z) {
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

/* Join what is known of a state, U x = b + e, with the next one, L^-1 (x' - F x) = e, in the unknowns (x, x'): where so
   much has faded that F^-1 is of no use. */
static int join_next(const int n, const real *F, const real *L, const real *U, const real *b, real *joint,
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

/* Write the smoothed state and covariance of a row that gathers information, U x = b + e, from those of the row after:
   given x', the noise w of the step is known, and x = F^-1 (x' - L w); or x itself is. */
static int from_later(const int n, const real *U, const real *b, future_t *future) {
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

/* Return whether F^-1, which is written, keeps what a row knows: what has faded it blows up, with its rounding. */
static int goes_back(const int n, const real *F, const real *P, const real *M, real *back) {
    if (!invert(n, F, back)) return 0;
    for (int i = 0; i < n; i++) {
        real blown_up = 0;
        for (int j = 0; j < n; j++) blown_up += fabs(back[i * n + j]) * sqrt(M[j * n + j]);
        if (!(blown_up < BLOWN_UP * sqrt(P[i * n + i]))) return 0;
    }
    return 1;
}

/* The same where the row has a covariance, which P - P M P would lose the digits of: with M = F P F' + Q and
   C = F^-1 (I - Q M^-1), it is C P' C' + C Q F'^-1 (Anderson and Moore 1979, chapter 10). Where F^-1 is of no use, it
   is (I - K F) P (I - K F)' + K (Q + P') K' with K = P F' M^-1, the same in Joseph's form. */
static int covariance_from_later(const int n, const real *P, future_t *future) {
    const real *F = future->F, *Q = future->Q;
    real A[NN_MAX], M[NN_MAX], C[NN_MAX], D[NN_MAX], back[NN_MAX], V[NN_MAX];
    copy(n * n, P, M);
    propagate(n, F, Q, M);
    const int by_inverse = goes_back(n, F, P, M, back);
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

/* Return a smoothed variance of c x, never 0: where its digits are lost, that of the pass forward. */
INLINE real smoothed_variance(const int n, const real *c, const real *P, const real *M, const real *recomputed) {
    real Pc[N_MAX];
    times(n, P, c, Pc);
    const real variance = dot(n, c, Pc);
    real left = variance;
    for (int i = 0; i < n; i++) left -= Pc[i] * dot(n, M + i * n, Pc);
    if (recomputed && left < MUCH * variance) {
        times(n, recomputed, c, Pc);
        const real told = dot(n, c, Pc);
        return told > 0 ? told : variance;
    }
    return left > HARDLY * variance ? left : variance;
}

/* Smooth one row that was filtered again. */
INLINE void smooth_row(const int n, const coefficients_t *model, const filter_t *row, future_t *future, real *signal,
                       real *sigma) {
    const real *c = model->c;
    real variance;
    if (row->phase != DETERMINED) {
        const real nothing[N_MAX] = {0};
        const int unknown = row->phase == UNKNOWN;
        const real *U = unknown ? model->prior : row->P, *b = unknown ? nothing : row->x;
        real Pc[N_MAX];
        future->later = future->later == STATE_TOO && from_later(n, U, b, future) ? STATE_TOO : NOTHING_LATER;
        if (!future->later) return;
        if (!unknown) future->level = row->level;
        times(n, future->P, c, Pc);
        variance = dot(n, c, Pc);
        if (!(variance > 0)) return;
    } else {
        real smoothed[NN_MAX], Pr[N_MAX];
        const real share = smooth_covariance(n, row->P, future->M, smoothed);
        const int recomputed = share < MUCH && future->later && covariance_from_later(n, row->P, future);
        if (!recomputed) copy(n * n, share > HARDLY ? smoothed : row->P, future->P);
        variance = smoothed_variance(n, c, row->P, future->M, recomputed ? future->P : NULL);
        times(n, row->P, future->r, Pr);
        for (int i = 0; i < n; i++) future->x[i] = row->x[i] + Pr[i]; /* (9) */
        future->later = STATE_TOO, future->level = row->level;
    }
    *signal = dot(n, c, future->x) + future->level;
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
        if (only_future != SKIPPED) {
            real signal = estimate->signal[row], sigma = estimate->sigma[row];
            smooth_row(n, model, state, future, &signal, &sigma);
            if (!only_future) estimate->signal[row] = signal, estimate->sigma[row] = sigma;
            if (!only_future && estimate->x && future->later) copy(n, future->x, estimate->x + row * n);
        } else
            future->later = NOTHING_LATER;
        if (state->phase == DETERMINED) step_back(n, model->h, state, F, estimate->innovation[row], future);
        if (starts[row] == ANEW) forget_future(n, future); /* rows before it know nothing of it */
        if (estimate->verdict[row] == STEP) future->later = NOTHING_LATER; /* Q is not all that lies between */
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
                         only_future && k ? SKIPPED : only_future);
    }
}

void smoother_backward(const settings_t *settings, const coefficients_t *model, future_t *future,
                       const block_t *block, const estimate_t *estimate, real *room, const int8_t *starts,
                       const int only_future) {
    FOR_STATES(settings->states, backward_rows, settings, model, future, block, estimate, room, starts, only_future)
}
