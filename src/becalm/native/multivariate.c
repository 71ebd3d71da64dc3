/* The filter and the smoother of several channels that share one state. Equations are numbered as in
   core/reference/kalman.py.

   A missing channel keeps its place in the matrices: its row of H counts as 0, its variance as 1, its innovation as
   0. */
#include "multivariate.h"

#include <stddef.h>

#include "future.h"
#include "opening.h"
#include "score.h"
#include "settling.h"

#define DEAD_PIVOT ((real)1e-15) /* a pivot below this, over its variance, is a rounding error */

/* Call a function whose first arguments are the numbers of states and of channels; for small models these are
   compile-time constants. */
#define SIZE(n, m) ((n) * (M_MAX + 1) + (m))
#define FOR_SMALL(n, m, function, ...)                        \
    switch (SIZE(n, m)) {                                     \
    case SIZE(1, 1): function(1, 1, __VA_ARGS__); break;      \
    case SIZE(2, 1): function(2, 1, __VA_ARGS__); break;      \
    case SIZE(2, 2): function(2, 2, __VA_ARGS__); break;      \
    case SIZE(3, 1): function(3, 1, __VA_ARGS__); break;      \
    case SIZE(3, 3): function(3, 3, __VA_ARGS__); break;      \
    case SIZE(4, 2): function(4, 2, __VA_ARGS__); break;      \
    case SIZE(6, 3): function(6, 3, __VA_ARGS__); break;      \
    default: function((int)(n), (int)(m), __VA_ARGS__);       \
    }

/* Pointers to the arrays in `numbers` of a state. */
typedef struct {
    real *x, *P;         /* (n), (n, n); while GATHERING, right-hand side b and root U of the information */
    real *K;             /* (n, m) gain; zero columns for missing channels */
    real *L, *D;         /* (m, m), (m) innovation covariance S = L D L'; a pivot of 0 carries no information */
    real *nu, *deviation; /* (m) innovations, 0 where missing; their standard deviations, NaN where missing */
    real *K_then, *L_then, *D_then, *P_then; /* K, L, D and P at the last check */
    real *A, *g;         /* (n, n) closed loop (I - K H) F, and H F (m, n); they can be computed again */
} parts_t;

/* Return the number of reals in all these arrays except A and g. */
INLINE int64_t kept(const int64_t n, const int64_t m) { return n + 2 * n * n + 2 * n * m + 2 * m * m + 4 * m; }

INLINE parts_t parts_of(const int n, const int m, multivariate_state_t *state) {
    parts_t p;
    p.x = state->numbers, p.P = p.x + n, p.K = p.P + n * n, p.L = p.K + n * m, p.D = p.L + m * m, p.nu = p.D + m;
    p.deviation = p.nu + m, p.K_then = p.deviation + m, p.L_then = p.K_then + n * m, p.D_then = p.L_then + m * m;
    p.P_then = p.D_then + m, p.A = p.P_then + n * n, p.g = p.A + n * n;
    return p;
}

static int64_t packed(const int64_t n, const int64_t m) {
    return (int64_t)offsetof(multivariate_state_t, numbers) + (int64_t)sizeof(real) * kept(n, m);
}

int64_t multivariate_size(const int64_t states, const int64_t channels) {
    return packed(states, channels) + (int64_t)sizeof(real) * (states * states + channels * states);
}

/* Save a state without the arrays that can be computed again. */
static void save(const multivariate_t *model, const multivariate_state_t *state, void *room) {
    memcpy(room, state, (size_t)packed(model->states, model->channels));
}

static void load(const multivariate_t *model, const void *room, multivariate_state_t *state) {
    memcpy(state, room, (size_t)packed(model->states, model->channels));
    state->closed = 0;
}

/* Return the number of reals in x, P, K, L, D and nu, on which later rows depend. */
static int64_t numbers_in(const int64_t n, const int64_t m) { return n + n * n + n * m + m * m + 2 * m; }

/* Discard the steady-state gain and the checks so far. */
static void lose_gain(multivariate_state_t *state, real *D_then) {
    state->settled = state->agreed = state->closed = 0;
    state->steady = -1, state->next_check = FIRST_CHECK, state->last_step = -1;
    D_then[0] = -1; /* the next check must find a change */
}

void multivariate_start(const multivariate_t *model, const real *x, const real *P, multivariate_state_t *state) {
    const int n = (int)model->states, m = (int)model->channels;
    memset(state, 0, (size_t)multivariate_size(n, m));
    const parts_t p = parts_of(n, m, state);
    state->settled_row = -1, state->score.product = 1;
    lose_gain(state, p.D_then);
    state->steady = 0;
    if (!x) return;
    state->phase = DETERMINED;
    copy(n, x, p.x), copy(n * n, P, p.P);
}

/* Discard a state whose covariance has no digits left; it stays undetermined. No new information is gathered: a prior
   belongs to the first row, and without a prior, gathering might never end. */
static void lose_state(const multivariate_t *model, multivariate_state_t *state) {
    const int64_t n = model->states, m = model->channels;
    const parts_t p = parts_of((int)n, (int)m, state);
    memset(state->numbers, 0, sizeof(real) * (size_t)numbers_in(n, m));
    for (int64_t c = 0; c < m; c++) p.deviation[c] = NOT_A_NUMBER;
    lose_gain(state, p.D_then);
    state->phase = LOST;
}

int multivariate_is_sound(const multivariate_t *model, const multivariate_state_t *state) {
    const int64_t n = model->states, m = model->channels;
    const int64_t counts[] = {state->rows, state->opened, state->settled_row, state->steady, state->next_check,
                              state->agreed, state->score.used};
    int sound = state->phase >= UNKNOWN && state->phase <= LOST && state->settled >= 0 &&
                state->settled <= COVARIANCE && state->proven >= 0 && state->proven <= COVARIANCE;
    for (int k = 0; k < 7; k++) sound = sound && is_count(counts[k], EVER);
    sound = sound && is_count(state->score.exponent, EVER);
    for (int64_t k = 0; sound && k < numbers_in(n, m); k++) sound = isfinite(state->numbers[k]) != 0;
    return sound && isfinite(state->score.squares); /* deviations may be NaN */
}

/* Factor S = L D L'. */
INLINE void factor(const int m, const real *S, real *L, real *D) {
    for (int a = 0; a < m; a++) {
        real d = S[a * m + a];
        for (int c = 0; c < a; c++) d -= L[a * m + c] * L[a * m + c] * D[c];
        D[a] = d > DEAD_PIVOT * S[a * m + a] ? d : 0;
        for (int b = a + 1; b < m; b++) {
            real s = S[b * m + a];
            for (int c = 0; c < a; c++) s -= L[b * m + c] * L[a * m + c] * D[c];
            L[b * m + a] = D[a] > 0 ? s / D[a] : 0;
        }
    }
}

/* Replace v by S^-1 v. */
INLINE void divide(const int m, const real *L, const real *D, real *v) {
    for (int a = 0; a < m; a++)
        for (int c = 0; c < a; c++) v[a] -= L[a * m + c] * v[c];
    for (int a = 0; a < m; a++) v[a] = D[a] > 0 ? v[a] / D[a] : 0;
    for (int a = m - 1; a >= 0; a--)
        for (int c = a + 1; c < m; c++) v[a] -= L[c * m + a] * v[c];
}

/* Add the terms of a row to the likelihood (8): the elements of e = L^-1 nu are independent with variances D. */
INLINE void score_row(const int m, const parts_t *p, score_t *score) {
    real e[M_MAX];
    for (int a = 0; a < m; a++) {
        e[a] = p->nu[a];
        for (int c = 0; c < a; c++) e[a] -= p->L[a * m + c] * e[c];
        if (p->D[a] > 0 && p->D[a] < INFINITE && !isnan(p->deviation[a])) add_score(score, e[a], p->D[a]);
    }
}

/* Write the standard deviation of each channel's signal, sqrt(diag(H P H')); return whether P has lost its digits. */
INLINE int write_sigmas(const int n, const int m, const multivariate_t *model, const real *P, real *sigma) {
    int lost = 0;
    for (int c = 0; c < m; c++) {
        const real *h = model->H + c * n;
        real Ph[N_MAX];
        times(n, P, h, Ph);
        const real variance = dot(n, h, Ph);
        sigma[c] = variance > 0 ? sqrt(variance) : 0;
        lost |= is_below_0(variance, model->R[c * m + c]);
    }
    return lost;
}

/* Compare gain and covariance with those of the last check, and store them for the next check; return what is
   unchanged: COVARIANCE, GAIN or 0. */
static int compare(const int n, const int m, const multivariate_t *model, const parts_t *p) {
    const real *H = model->H;
    int gain = 1, covariance = 1;
    real sigma[M_MAX], sigma_then[M_MAX]; /* compared, too: a gain near 0 settles before the signals' sigma */
    write_sigmas(n, m, model, p->P, sigma), write_sigmas(n, m, model, p->P_then, sigma_then);
    for (int a = 0; a < m; a++) {
        real apart = 0; /* variance of the signal if states were independent: the scale of rounding */
        for (int i = 0; i < n; i++) apart += H[a * n + i] * H[a * n + i] * p->P[i * n + i];
        gain &= near(p->D[a], p->D_then[a], p->D[a]) & near(sigma[a], sigma_then[a], sqrt(apart));
        p->D_then[a] = p->D[a];
        for (int b = 0; b < a; b++) {
            gain &= near(p->L[a * m + b], p->L_then[a * m + b], 1 + fabs(p->L[a * m + b]));
            p->L_then[a * m + b] = p->L[a * m + b];
        }
        for (int i = 0; i < n; i++) {
            const real variance = p->P[i * n + i], K = p->K[i * m + a];
            const int steady = fabs(variance - p->P_then[i * n + i]) <= STEADY * variance; /* else a gain may grow */
            const real spread = steady && p->D[a] > 0 ? sqrt(variance / p->D[a]) : 0;
            gain &= near(K, p->K_then[i * m + a], spread + fabs(K));
            p->K_then[i * m + a] = K;
        }
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            const real scale = sqrt(p->P[i * n + i]) * sqrt(p->P[j * n + j]);
            covariance &= near(p->P[i * n + j], p->P_then[i * n + j], scale);
        }
    copy(n * n, p->P, p->P_then);
    return gain ? covariance ? COVARIANCE : GAIN : 0;
}

/* Check after a row what has settled; see settling.h. */
INLINE void check_settling_row(const int n, const int m, const multivariate_t *model, multivariate_state_t *state,
                       const parts_t *p, const real *F, const real length, const int complete) {
    if (!complete || length != state->last_step || !F) {
        lose_gain(state, p->D_then);
        if (complete && F) state->last_step = length;
    }
    if (++state->steady < state->next_check || !F) return;
    int same = compare(n, m, model, p);
    if (same && !forgets(n, m, model->H, F, p->K, p->P, (real)0.125 * (real)state->steady)) same = 0;
    state->proven = state->agreed && state->proven < same ? state->proven : same;
    state->agreed = same ? state->agreed + 1 : 0;
    if (0 < state->agreed && state->agreed <= n) {
        state->next_check = state->steady + 1;
        return;
    }
    state->settled = state->proven, state->agreed = 0;
    if (state->settled >= model->enough && state->settled_row < 0) state->settled_row = state->rows;
    state->next_check = state->steady + (state->steady / 8 > FIRST_CHECK ? state->steady / 8 : FIRST_CHECK);
}

INLINE void write_estimates(const int n, const int m, const multivariate_t *model, const real *x, const real *P,
                         const estimates_t *estimates, const int64_t row) {
    for (int c = 0; c < m && estimates->signal; c++) estimates->signal[row * m + c] = dot(n, model->H + c * n, x);
    if (estimates->sigma) write_sigmas(n, m, model, P, estimates->sigma + row * m);
    if (estimates->x) copy(n, x, estimates->x + row * n);
    if (estimates->P) copy(n * n, P, estimates->P + row * n * n);
}

INLINE void write_innovation(const int m, const parts_t *p, const estimates_t *estimates, const int64_t row) {
    for (int c = 0; c < m && estimates->innovation; c++)
        estimates->innovation[row * m + c] = isnan(p->deviation[c]) ? NOT_A_NUMBER : p->nu[c];
    for (int c = 0; c < m && estimates->deviation; c++) estimates->deviation[row * m + c] = p->deviation[c];
}

INLINE int has_arrived(const real z) { return fabs(z) <= BEYOND_ANY_SENSOR; }

/* P = (I - K H) P (I - K H)' + K R K', Joseph's form (7); PH is P H' (n, m). */
INLINE void joseph_of(const int n, const int m, const real *H, const real *R, const real *K, const real *PH, real *P) {
    real B[NN_MAX], C[N_MAX * M_MAX];
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            real s = P[i * n + j];
            UNROLL
            for (int a = 0; a < m; a++) s -= K[i * m + a] * PH[j * m + a];
            B[i * n + j] = s;
        }
        for (int a = 0; a < m; a++) {
            real s = -dot(n, B + i * n, H + a * n);
            UNROLL
            for (int b = 0; b < m; b++) s += K[i * m + b] * R[b * m + a];
            C[i * m + a] = s;
        }
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            real s = B[i * n + j];
            UNROLL
            for (int a = 0; a < m; a++) s += C[i * m + a] * K[j * m + a];
            P[i * n + j] = P[j * n + i] = s;
        }
}

/* Predict: (1), (2). */
INLINE void predict(const int n, const real *F, const real *Q, real *x, real *P) {
    real Fx[N_MAX];
    times(n, F, x, Fx);
    propagate(n, F, Q, P);
    for (int i = 0; i < n; i++) {
        x[i] = Fx[i] < -LARGEST ? -LARGEST : Fx[i] > LARGEST ? LARGEST : Fx[i];
        if (P[i * n + i] > LARGEST) {
            const real shrink = sqrt(LARGEST / P[i * n + i]);
            for (int j = 0; j < n; j++) P[i * n + j] *= shrink, P[j * n + i] *= shrink;
        }
    }
}

/* Filter one row and its covariance; F is NULL if there is no step before it. Return whether the covariance has digits
   left. */
INLINE int filter_row(const int n, const int m, const multivariate_t *model, multivariate_state_t *state,
                      const parts_t *p, const real *F, const real *Q, const real length, const real *z) {
    const real *H = model->H, *R = model->R;
    real PH[N_MAX * M_MAX], S[M_MAX * M_MAX];
    int count = 0, lost = 0;
    real sigma[M_MAX];
    if (F) predict(n, F, Q, p->x, p->P);
    for (int a = 0; a < m; a++) {
        const int arrived = has_arrived(z[a]);
        count += arrived;
        for (int i = 0; i < n; i++) PH[i * m + a] = arrived ? dot(n, p->P + i * n, H + a * n) : 0;
        for (int b = 0; b <= a; b++) {
            real s = 0;
            UNROLL
            for (int i = 0; i < n; i++) s += H[a * n + i] * PH[i * m + b];
            S[a * m + b] = arrived && has_arrived(z[b]) ? s + R[a * m + b] : a == b; /* (4) */
        }
        p->nu[a] = arrived ? z[a] - dot(n, H + a * n, p->x) : 0; /* (3) */
        p->deviation[a] = arrived ? sqrt(S[a * m + a]) : NOT_A_NUMBER;
        lost |= F && arrived && loses_digits(n, R[a * m + a], Q, S[a * m + a]);
    }
    if (lost) return 0;
    factor(m, S, p->L, p->D);
    for (int i = 0; i < n; i++) {
        copy(m, PH + i * m, p->K + i * m);
        divide(m, p->L, p->D, p->K + i * m);                           /* (5) */
        p->x[i] += dot(m, p->K + i * m, p->nu);                        /* (6) */
    }
    if (count) joseph_of(n, m, H, R, p->K, PH, p->P);
    if (write_sigmas(n, m, model, p->P, sigma)) return 0;
    score_row(m, p, &state->score);
    check_settling_row(n, m, model, state, p, F, length, count == m);
    return 1;
}

/* Return the length of a column padded to a multiple of four numbers; one or two numbers are not padded. */
INLINE int padded(const int n) { return n < 3 ? n : (n + 3) & ~3; }

/* Write the columns of `sign` times A (rows, columns), each padded with 0. */
INLINE void lay_out(const int rows, const int columns, const real *A, const real sign, real *B) {
    const int wide = padded(rows);
    for (int j = 0; j < columns; j++)
        for (int i = 0; i < wide; i++) B[j * wide + i] = i < rows ? sign * A[i * columns + j] : 0;
}

/* y += A v; B has the padded columns of A. */
INLINE void accumulate(const int rows, const int columns, const real *B, const real *v, real *y) {
    const int wide = padded(rows);
    if (wide < 3) {
        UNROLL
        for (int i = 0; i < rows; i++) {
            UNROLL
            for (int j = 0; j < columns; j++) y[i] += B[j * wide + i] * v[j];
        }
    } else
        for (int i = 0; i < wide; i += 4) {
            real a = y[i], b = y[i + 1], c = y[i + 2], d = y[i + 3];
            UNROLL
            for (int j = 0; j < columns; j++) {
                const real *at = B + j * wide + i;
                a += at[0] * v[j], b += at[1] * v[j], c += at[2] * v[j], d += at[3] * v[j];
            }
            y[i] = a, y[i + 1] = b, y[i + 2] = c, y[i + 3] = d;
        }
}

/* Filter rows with the steady-state gain, up to a row in which a channel is missing or a state is too large; return the
   number of filtered rows. */
INLINE int64_t take_settled(const int n, const int m, const multivariate_t *model, multivariate_state_t *state,
                            const parts_t *p, const record_t *record, const int64_t from, const int64_t to,
                            const estimates_t *estimates) {
    real A[NN_MAX], K[N_MAX * M_MAX], g[N_MAX * M_MAX], H[N_MAX * M_MAX], L[M_MAX * M_MAX], weight[M_MAX];
    real sigma[M_MAX] = {0}, deviation[M_MAX], x[N_MAX], nu[M_MAX];
    lay_out(n, n, p->A, 1, A), lay_out(n, m, p->K, 1, K), lay_out(m, n, p->g, -1, g), lay_out(m, n, model->H, 1, H);
    copy(m * m, p->L, L), copy(n, p->x, x), copy(m, p->deviation, deviation), copy(m, p->nu, nu);
    if (estimates->sigma) write_sigmas(n, m, model, p->P, sigma);
    score_t score = state->score;
    int64_t scale = 0, live = 0, row = from;
    real determinant = 1;
    for (int a = 0; a < m; a++) {
        const int alive = p->D[a] > 0 && p->D[a] < INFINITE;
        weight[a] = alive ? 1 / p->D[a] : 0, live += alive;
        if (alive) determinant = near_one(determinant * near_one(p->D[a], &scale), &scale);
    }
    for (; row < to; row++) {
        const real *z = record->z + row * m;
        real next[N_MAX], e[M_MAX], signal[M_MAX], squares = 0;
        int possible = 1;
        UNROLL
        for (int a = 0; a < m; a++) possible &= has_arrived(z[a]);
        UNROLL
        for (int a = 0; a < padded(m); a++) e[a] = a < m ? z[a] : 0, signal[a] = 0;
        UNROLL
        for (int i = 0; i < padded(n); i++) next[i] = 0;
        accumulate(m, n, g, x, e); /* (3) */
        accumulate(n, m, K, z, next);
        accumulate(n, n, A, x, next); /* (1), (6) */
        UNROLL
        for (int i = 0; i < n; i++) possible &= fabs(next[i]) <= LARGEST;
        if (!possible) break;
        UNROLL
        for (int i = 0; i < n; i++) x[i] = next[i];
        if (estimates->signal) {
            accumulate(m, n, H, x, signal);
            UNROLL
            for (int a = 0; a < m; a++) estimates->signal[row * m + a] = signal[a];
        }
        if (estimates->sigma)
            UNROLL
            for (int a = 0; a < m; a++) estimates->sigma[row * m + a] = sigma[a];
        if (estimates->innovation)
            UNROLL
            for (int a = 0; a < m; a++) estimates->innovation[row * m + a] = e[a];
        if (estimates->deviation)
            UNROLL
            for (int a = 0; a < m; a++) estimates->deviation[row * m + a] = deviation[a];
        if (estimates->x) copy(n, x, estimates->x + row * n);
        if (estimates->P) copy(n * n, p->P, estimates->P + row * n * n);
        UNROLL
        for (int a = 0; a < m; a++) {
            nu[a] = e[a];
            UNROLL
            for (int c = 0; c < a; c++) e[a] -= L[a * m + c] * e[c];
            squares += e[a] * e[a] * weight[a];
        }
        score.squares += squares; /* (8) */
        score.product *= determinant;
        if (!(score.product <= LARGE && score.product >= 1 / LARGE))
            score.product = near_one(score.product, &score.exponent);
    }
    copy(n, x, p->x), copy(m, nu, p->nu);
    score.exponent += scale * (row - from), score.used += live * (row - from);
    state->score = score;
    return row - from;
}

static int64_t filter_settled(const int n, const int m, const multivariate_t *model, multivariate_state_t *state,
                              const parts_t *p, const real *F, const record_t *record, const int64_t from,
                              const int64_t to, const estimates_t *estimates) {
    int64_t taken = 0;
    if (!state->closed) {
        multiply_HF(n, m, model->H, F, p->g);
        close_loop(n, m, F, p->K, p->g, p->A);
        state->closed = 1;
    }
    FOR_SMALL(n, m, taken = take_settled, model, state, p, record, from, to, estimates)
    return taken;
}

/* Add the information of the channels that arrived; with R = C C', C lower triangular, its equations are
   C^-1 (z - H x) = e. */
static void add_measurements(const int n, const int m, const multivariate_t *model, const real *z, real *U, real *b) {
    real C[M_MAX * M_MAX], a[M_MAX * N_MAX], right[M_MAX];
    int seen[M_MAX], count = 0;
    for (int c = 0; c < m; c++)
        if (has_arrived(z[c])) seen[count++] = c;
    for (int c = 0; c < count; c++) {
        copy(n, model->H + seen[c] * n, a + c * n);
        right[c] = z[seen[c]];
        for (int d = 0; d <= c; d++) {
            real s = model->R[seen[c] * m + seen[d]];
            for (int k = 0; k < d; k++) s -= C[c * m + k] * C[d * m + k];
            C[c * m + d] = d < c ? s / C[d * m + d] : sqrt(s);
            const real part = d < c ? C[c * m + d] : 0;
            for (int i = 0; i < n; i++) a[c * n + i] -= part * a[d * n + i];
            right[c] -= part * right[d];
        }
        for (int i = 0; i < n; i++) a[c * n + i] /= C[c * m + c];
        right[c] /= C[c * m + c];
    }
    for (int c = 0; c < count; c++) add_equation(n, a + c * n, right[c], U, b);
}

/* Solve U' w = h. If the information determines the state, the estimate of h x is w' b, with variance w' w. */
static void solve_output_weights(const int n, const real *h, const real *U, real *w) {
    for (int j = 0; j < n; j++) {
        real s = h[j];
        for (int i = 0; i < j; i++) s -= w[i] * U[i * n + j];
        w[j] = s / U[j * n + j];
    }
}

/* Predict a row from information that determines the state: (3), (4), (8). */
static void predict_from_information(const int n, const int m, const multivariate_t *model, const real *z,
                                     const parts_t *p, score_t *score) {
    real S[M_MAX * M_MAX], w[M_MAX * N_MAX];
    for (int a = 0; a < m; a++) {
        const int arrived = has_arrived(z[a]);
        solve_output_weights(n, model->H + a * n, p->P, w + a * n);
        for (int b = 0; b <= a; b++)
            S[a * m + b] = arrived && has_arrived(z[b]) ? dot(n, w + a * n, w + b * n) + model->R[a * m + b] : a == b;
        p->nu[a] = arrived ? z[a] - dot(n, w + a * n, p->x) : 0;
        p->deviation[a] = arrived ? sqrt(S[a * m + a]) : NOT_A_NUMBER;
    }
    factor(m, S, p->L, p->D);
    score_row(m, p, score);
}

/* Return whether the next measurement is predicted well enough for the covariance form to be accurate. */
static int is_narrow(const int n, const int m, const multivariate_t *model, const real *F, const real *Q,
                     const real *P) {
    real ahead[NN_MAX], Ph[N_MAX];
    copy(n * n, P, ahead);
    propagate(n, F, Q, ahead);
    for (int c = 0; c < m; c++) {
        times(n, ahead, model->H + c * n, Ph);
        if (!(dot(n, model->H + c * n, Ph) <= WIDE * model->R[c * m + c])) return 0;
    }
    return 1;
}

/* Write the signals of a row that the information determines, NaN and inf for its other signals and for its state. */
static void write_opening(const int n, const int m, const multivariate_t *model, const multivariate_state_t *state,
                          const parts_t *p, const estimates_t *estimates, const int64_t row) {
    for (int c = 0; c < m; c++) {
        real signal = NOT_A_NUMBER, sigma = INFINITE;
        if (model->proper_prior && state->phase != LOST) {
            real w[N_MAX];
            solve_output_weights(n, model->H + c * n, p->P, w);
            signal = dot(n, w, p->x), sigma = sqrt(dot(n, w, w));
        } else if (state->phase == GATHERING)
            estimate_from_information(n, model->H + c * n, p->P, p->x, &signal, &sigma);
        if (estimates->signal) estimates->signal[row * m + c] = signal;
        if (estimates->sigma) estimates->sigma[row * m + c] = sigma;
    }
    for (int i = 0; i < n && estimates->x; i++) estimates->x[row * n + i] = NOT_A_NUMBER;
    for (int i = 0; i < n * n && estimates->P; i++) estimates->P[row * n * n + i] = INFINITE;
}

/* Filter one row while measurements do not determine the state: add the information of the row. */
static void open_row(const int n, const int m, const multivariate_t *model, multivariate_state_t *state,
                     const parts_t *p, const record_t *record, const real *F, const real *Q, const int64_t row,
                     const estimates_t *estimates) {
    const real *z = record->z + row * m;
    real V[NN_MAX], P[NN_MAX], x[N_MAX];
    int count = 0;
    for (int c = 0; c < m; c++) {
        count += has_arrived(z[c]);
        p->nu[c] = 0, p->deviation[c] = NOT_A_NUMBER;
    }
    if (state->phase == GATHERING && F)
        predict_information(n, F, Q, model->prior, p->P, p->x);
    else if (state->phase == UNKNOWN && (count || model->proper_prior)) {
        state->phase = GATHERING;
        copy(n * n, model->prior, p->P), copy(n, model->right, p->x);
    }
    state->opened++;
    if (state->phase == GATHERING) {
        if (model->proper_prior) predict_from_information(n, m, model, z, p, &state->score);
        add_measurements(n, m, model, z, p->P, p->x);
    }
    write_opening(n, m, model, state, p, estimates, row);
    if (state->phase == GATHERING) {
        const int inverted = invert_root(n, p->P, V), determined = inverted && is_determined(n, p->P, V);
        if (inverted && (determined || model->proper_prior)) {
            copy(n * n, p->P, P), copy(n, p->x, x);
            determine(n, V, P, x);
            if (estimates->x) copy(n, x, estimates->x + row * n);
            if (estimates->P) copy(n * n, P, estimates->P + row * n * n);
            if (determined &&
                (!model->proper_prior || is_narrow(n, m, model, F ? F : record->F, F ? Q : record->Q, P))) {
                copy(n * n, P, p->P), copy(n, x, p->x);
                state->phase = DETERMINED;
            }
        }
    }
    write_innovation(m, p, estimates, row);
}

/* Return the run that contains a row; the search starts at `run`. */
static int64_t run_of(const record_t *record, const int64_t row, int64_t run) {
    while (record->first[run + 1] <= row) run++;
    while (record->first[run] > row) run--;
    return run;
}

/* Filter rows of a record. */
INLINE void filter_rows(const int n, const int m, const multivariate_t *model, multivariate_state_t *state,
                        const record_t *record, int64_t row, const int64_t to, int64_t *run,
                        const estimates_t *estimates) {
    const parts_t p = parts_of(n, m, state);
    while (row < to) {
        *run = run_of(record, row, *run);
        const int64_t step = record->step[*run];
        const real *F = step < 0 ? NULL : record->F + step * n * n, *Q = step < 0 ? NULL : record->Q + step * n * n;
        const real length = step < 0 ? -1 : record->lengths[step];
        if (state->settled >= model->enough) {
            const int64_t end = record->first[*run + 1] < to ? record->first[*run + 1] : to;
            const int64_t taken = F && length == state->last_step
                                      ? filter_settled(n, m, model, state, &p, F, record, row, end, estimates)
                                      : 0;
            state->rows += taken, row += taken;
            if (taken) continue;
            lose_gain(state, p.D_then); /* later rows must not depend on the row at which the gain settled */
        }
        if (state->phase == DETERMINED && !filter_row(n, m, model, state, &p, F, Q, length, record->z + row * m))
            lose_state(model, state);
        if (state->phase == DETERMINED || state->phase == LOST) {
            write_innovation(m, &p, estimates, row);
            if (state->phase == LOST)
                write_opening(n, m, model, state, &p, estimates, row);
            else
                write_estimates(n, m, model, p.x, p.P, estimates, row);
        } else
            open_row(n, m, model, state, &p, record, F, Q, row, estimates);
        state->rows++, row++;
    }
}

static void filter_rows_of(const multivariate_t *model, multivariate_state_t *state, const record_t *record,
                           const int64_t row, const int64_t to, int64_t *run, const estimates_t *estimates) {
    FOR_SMALL(model->states, model->channels, filter_rows, model, state, record, row, to, run, estimates)
}

void multivariate_filter(const multivariate_t *model, multivariate_state_t *state, const record_t *record,
                         const estimates_t *estimates) {
    int64_t run = 0;
    filter_rows_of(model, state, record, 0, record->rows, &run, estimates);
}

int64_t multivariate_room(const int64_t states, const int64_t channels, const int64_t rows) {
    return ((rows + SMOOTHED - 1) / SMOOTHED + 1 + SMOOTHED) * packed(states, channels);
}

void multivariate_end(const multivariate_t *model, future_t *future) {
    memset(future, 0, sizeof *future);
    forget_future((int)model->states, future);
}

/* Pass r back through a block with the steady-state gain (11), and add its effect to the estimates of each row (9). */
INLINE void pass_back_settled(const int n, const int m, const multivariate_t *model, const parts_t *p, const real *A,
                              const real *G_, const int64_t from, const int64_t to, const estimates_t *estimates,
                              real *r_) {
    real B[NN_MAX], back[NN_MAX], P[NN_MAX], G[N_MAX * M_MAX], HP[M_MAX * N_MAX], seen[M_MAX * N_MAX], r[N_MAX];
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) B[j * n + i] = A[i * n + j];
    for (int c = 0; c < m; c++) times(n, p->P, model->H + c * n, seen + c * n);
    lay_out(n, n, B, 1, back), lay_out(n, n, p->P, 1, P), lay_out(n, m, G_, 1, G), lay_out(m, n, seen, 1, HP);
    copy(n, r_, r);
    for (int64_t row = to - 1; row >= from; row--) {
        real before[N_MAX], change[N_MAX];
        if (estimates->signal) {
            for (int c = 0; c < padded(m); c++) change[c] = c < m ? estimates->signal[row * m + c] : 0;
            accumulate(m, n, HP, r, change);
            for (int c = 0; c < m; c++) estimates->signal[row * m + c] = change[c];
        }
        if (estimates->x) {
            for (int i = 0; i < padded(n); i++) change[i] = i < n ? estimates->x[row * n + i] : 0;
            accumulate(n, n, P, r, change);
            copy(n, change, estimates->x + row * n);
        }
        UNROLL
        for (int i = 0; i < padded(n); i++) before[i] = 0;
        accumulate(n, m, G, estimates->innovation + row * m, before);
        accumulate(n, n, back, r, before);
        UNROLL
        for (int i = 0; i < n; i++) r[i] = before[i];
    }
    copy(n, r, r_);
}

static void pass_back_block(const int n, const int m, const multivariate_t *model, const parts_t *p, const real *A,
                         const real *G, const int64_t from, const int64_t to, const estimates_t *estimates, real *r) {
    FOR_SMALL(n, m, pass_back_settled, model, p, A, G, from, to, estimates, r)
}

/* Smooth a block with the steady-state gain. */
INLINE void smooth_settled(const int n, const int m, const multivariate_t *model, multivariate_state_t *state,
                           const real *F, const int64_t from, const int64_t to, const estimates_t *estimates,
                           future_t *future) {
    const parts_t p = parts_of(n, m, state);
    const int spread = estimates->sigma || estimates->P;
    real A[NN_MAX], g[M_MAX * N_MAX], G[N_MAX * M_MAX], sigma[M_MAX] = {0};
    multiply_HF(n, m, model->H, F, g);
    close_loop(n, m, F, p.K, g, A);
    for (int i = 0; i < n; i++) {
        for (int c = 0; c < m; c++) G[i * m + c] = g[c * n + i];
        divide(m, p.L, p.D, G + i * m);
    }
    pass_back_block(n, m, model, &p, A, G, from, to, estimates, future->r);
    future->later = NOTHING_LATER;
    for (int64_t row = to - 1; spread && row >= from; row--) {
        if (!future->settled || row == to - 1) {
            for (int c = 0; c < m; c++)
                sigma[c] = sqrt(smoothed_variance(n, model->H + c * n, p.P, future->M, NULL)); /* (10) */
            if (estimates->P && !(smooth_covariance(n, p.P, future->M, future->P) > LEAST_SHARE))
                copy(n * n, p.P, future->P);
        }
        if (estimates->sigma) copy(m, sigma, estimates->sigma + row * m);
        if (estimates->P) copy(n * n, future->P, estimates->P + row * n * n);
        if (row == from && smooth_covariance(n, p.P, future->M, future->P) > LEAST_SHARE)
            future->later = COVARIANCE_ONLY;
        if (!future->settled) pull_back(n, m, A, G, g, future->M); /* (12) */
    }
    if (spread && !future->settled) check_future(n, future, to - from);
}

/* Smooth a row that was filtered again; its smoothed x and P replace those of the next row in `future`. */
INLINE void smooth_row(const int n, const int m, const multivariate_t *model, const multivariate_state_t *state,
                       const parts_t *p, const estimates_t *estimates, const int64_t row, future_t *future) {
    const int spread = estimates->sigma || estimates->P;
    real change[N_MAX];
    if (state->phase == LOST) {
        forget_future(n, future);
        write_opening(n, m, model, state, p, estimates, row);
        return;
    }
    if (state->phase != DETERMINED) {
        const int unknown = state->phase == UNKNOWN;
        const real *U = unknown ? model->prior : p->P, *b = unknown ? model->right : p->x;
        if (future->later == STATE_TOO)
            future->later = from_later(n, U, b, future) ? STATE_TOO : NOTHING_LATER;
        else {
            real V[NN_MAX];
            future->later = model->proper_prior && invert_root(n, U, V) ? STATE_TOO : NOTHING_LATER;
            if (future->later) {
                copy(n * n, U, future->P), copy(n, b, future->x);
                determine(n, V, future->P, future->x);
            }
        }
        if (!future->later) {
            write_opening(n, m, model, state, p, estimates, row);
            return;
        }
    } else {
        times(n, p->P, future->r, change);
        for (int i = 0; i < n; i++) future->x[i] = p->x[i] + change[i]; /* (9) */
        if (spread) {
            real smoothed[NN_MAX];
            const real share = smooth_covariance(n, p->P, future->M, smoothed);
            const int recomputed = share < ACCURATE_SHARE && future->later && covariance_from_later(n, p->P, future);
            if (!recomputed) copy(n * n, share > LEAST_SHARE ? smoothed : p->P, future->P);
        }
        future->later = STATE_TOO;
    }
    for (int c = 0; c < m && estimates->signal; c++)
        estimates->signal[row * m + c] = dot(n, model->H + c * n, future->x);
    if (estimates->sigma) write_sigmas(n, m, model, future->P, estimates->sigma + row * m);
    if (estimates->x) copy(n, future->x, estimates->x + row * n);
    if (estimates->P) copy(n * n, future->P, estimates->P + row * n * n);
}

/* Transform the information of later rows: back through the update of a row, and through the step before this row. */
INLINE void step_back(const int n, const int m, const multivariate_t *model, const parts_t *p, const real *F,
                      const int spread, future_t *future) {
    real A[NN_MAX], g[M_MAX * N_MAX], G[N_MAX * M_MAX];
    multiply_HF(n, m, model->H, F, g);
    close_loop(n, m, F, p->K, g, A);
    for (int i = 0; i < n; i++) {
        for (int c = 0; c < m; c++) G[i * m + c] = isnan(p->deviation[c]) ? 0 : g[c * n + i];
        divide(m, p->L, p->D, G + i * m);
    }
    pull_back_state(n, m, A, G, p->nu, future->r);
    if (spread) pull_back(n, m, A, G, g, future->M);
}

/* Filter a block again, row by row, and smooth it. */
INLINE void smooth_again(const int n, const int m, const multivariate_t *model, multivariate_state_t *state,
                         const record_t *record, const int64_t from, const int64_t to, int64_t *run,
                         const estimates_t *estimates, future_t *future, char *room) {
    const estimates_t nothing = {NULL, NULL, NULL, NULL, NULL, NULL};
    const parts_t p = parts_of(n, m, state);
    const int64_t size = packed(n, m);
    for (int64_t row = from; row < to; row++) {
        filter_rows_of(model, state, record, row, row + 1, run, &nothing);
        save(model, state, room + (row - from) * size);
    }
    unsettle_future(future);
    for (int64_t row = to - 1; row >= from; row--) {
        *run = run_of(record, row, *run);
        const int64_t step = record->step[*run];
        load(model, room + (row - from) * size, state);
        smooth_row(n, m, model, state, &p, estimates, row, future);
        if (step < 0) {
            future->later = NOTHING_LATER;
            continue;
        }
        const real *F = record->F + step * n * n, *Q = record->Q + step * n * n;
        if (state->phase == DETERMINED)
            step_back(n, m, model, &p, F, estimates->sigma || estimates->P, future);
        copy(n * n, F, future->F), copy(n * n, Q, future->Q);
    }
}

INLINE void backward_rows(const int n, const int m, const multivariate_t *model, multivariate_state_t *state,
                          const record_t *record, const estimates_t *estimates, future_t *future, char *room) {
    const int64_t size = packed(n, m);
    int64_t run = 0;
    for (int64_t k = (record->rows + SMOOTHED - 1) / SMOOTHED - 1; k >= 0; k--) {
        const int64_t from = k * SMOOTHED, to = from + SMOOTHED < record->rows ? from + SMOOTHED : record->rows;
        load(model, room + (SMOOTHED + k + 1) * size, state);
        const int64_t settled = state->settled >= model->enough, steady = state->steady;
        load(model, room + (SMOOTHED + k) * size, state);
        run = run_of(record, from, run);
        if (settled && state->settled >= model->enough && steady == state->steady) { /* one gain for all rows */
            const int64_t at = record->step[run] * n * n;
            smooth_settled(n, m, model, state, record->F + at, from, to, estimates, future);
            copy(n * n, record->F + at, future->F), copy(n * n, record->Q + at, future->Q);
        } else
            smooth_again(n, m, model, state, record, from, to, &run, estimates, future, room);
    }
}

void multivariate_smooth(const multivariate_t *model, multivariate_state_t *state, const record_t *record,
                         const estimates_t *estimates, future_t *future, void *room) {
    const int64_t size = packed(model->states, model->channels);
    char *own = room, *before = own + SMOOTHED * size;
    const estimates_t ahead = {estimates->signal, NULL, estimates->innovation, estimates->deviation, estimates->x,
                               NULL};
    int64_t run = 0;
    for (int64_t row = 0; row < record->rows; row += SMOOTHED, before += size) {
        save(model, state, before);
        filter_rows_of(model, state, record, row, row + SMOOTHED < record->rows ? row + SMOOTHED : record->rows, &run,
                    &ahead);
    }
    save(model, state, before);
    FOR_SMALL(model->states, model->channels, backward_rows, model, state, record, estimates, future, own)
    load(model, before, state);
}

int64_t multivariate_lag_room(const int64_t states, const int64_t channels, const int64_t lag) {
    return multivariate_size(states, channels) + multivariate_room(states, channels, lag + 1) +
           (int64_t)sizeof(future_t) + 4 * (lag + 1) * channels * (int64_t)sizeof(real);
}

void multivariate_lag(const multivariate_t *model, multivariate_state_t *state, const record_t *record,
                      const int64_t lag, const int64_t ready, real *signal, real *sigma, void *room) {
    const int64_t m = model->channels, most = (lag + 1) * m, size = multivariate_size(model->states, m);
    const estimates_t nothing = {NULL, NULL, NULL, NULL, NULL, NULL};
    multivariate_state_t *ahead = room;
    real *rows = (real *)(void *)((char *)room + size);
    future_t *future = (future_t *)(void *)(rows + 4 * most);
    for (int64_t row = 0; row < ready; row++) {
        const int64_t count = record->rows - row > lag ? lag + 1 : record->rows - row, fresh = state->rows == 0;
        const int64_t first[] = {0, fresh ? 1 : count, count}, step[] = {fresh ? -1 : 0, 0};
        record_t window = *record;
        window.z += row * m, window.first = first, window.step = step, window.rows = count;
        const estimates_t estimates = {rows, rows + most, rows + 2 * most, rows + 3 * most, NULL, NULL};
        memcpy(ahead, state, (size_t)size);
        multivariate_end(model, future);
        multivariate_smooth(model, ahead, &window, &estimates, future, future + 1);
        copy((int)m, estimates.signal, signal + row * m), copy((int)m, estimates.sigma, sigma + row * m);
        window.rows = 1;
        multivariate_filter(model, state, &window, &nothing);
    }
}
