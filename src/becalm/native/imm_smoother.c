/* The IMM smoother: its backward pass computes, for each mode, the likelihood of the later measurements.

   As a function of the mode's state x, this likelihood is exp(g + r' (x - c) - (x - c)' Y (x - c) / 2), with a centre
   c. A step does not change this form for any Q: Y >= 0, and only sums of I and a positive matrix are inverted. So
   states without noise, inactive states and unobservable states are allowed. Source: the two-filter form of Fraser and
   Potter, IEEE TAC-14 (1969) 387.

   For every pair of a mode before a step and a mode after it, the filtered state of the first mode is combined with the
   likelihood of the later measurements for the second mode. The probability of the pair is its forward probability
   times the evidence, the mean of this likelihood over the filtered state. So the smoother finds a jump that only later
   measurements show. For each mode before the step, the likelihoods for all modes after it are pooled into one, by the
   mean of their logarithms weighted with the probabilities of the pairs. So every covariance stays positive and below
   the filtered covariance, which the moments of the mixture would not guarantee. */
#include "imm.h"

#include <string.h>

#include "information.h"
#include "modes.h"
#include "normal.h"
#include "product.h"

#define NEGLIGIBLE ((real)1e-16) /* pairs with a smaller probability are ignored */
#define LEAST ((real)-1e300)     /* a number below any logarithm */
#define LN_2 ((real)0.69314718055994530942)

/* The likelihood of later rows for each mode, and the step to the first of them. */
typedef struct {
    int known;            /* whether there are later rows */
    real *g, *c, *r, *Y;  /* (M,), (M, n), (M, n), (M, n, n) */
    const real *F, *Q, *T; /* matrices of the step */
} later_t;

/* Working memory for one row. Modes before the step are stored in pairs, side by side; they are the first axis of
   arrays that also have an axis of modes after the step. "Twice" means that both numbers of each pair are equal. */
typedef struct {
    real *beliefs;  /* smoothed states */
    real *roots;    /* (M, n, n) memory for roots of covariances */
    const real *Q;  /* the process noise from which B was computed */
    pair_t *x;      /* (pairs, n) state of each mode before */
    pair_t *G;      /* (pairs, n, n) P = G G' of each mode before */
    pair_t *B;      /* (M, n, n) Q = B B' of each mode after, twice */
    pair_t *Y;      /* (M, n, n) information of each mode after on the state before the step, twice */
    pair_t *r;      /* (pairs, M, n) its gradient */
    pair_t *L, *D;  /* (pairs, M, n, n), (pairs, M, n) factors of I + G' Y G */
    pair_t *v;      /* (pairs, M, n) G v is the change of the mean by smoothing */
    pair_t *merged; /* (M, n + n n) state and covariance of two modes before, for each mode after */
    pair_t *step;   /* (9, n, n) for the backward step of one mode after */
    real *rest;     /* the unused memory */
} rooms_t;

int64_t imm_later_size(const int64_t states, const int64_t modes) {
    const int64_t n = states, m = modes;
    return 1 + m * (1 + 2 * n + 3 * n * n) + m * m;
}

int64_t imm_smooth_room(const int64_t states, const int64_t modes) {
    const int64_t n = states, m = modes;
    const int64_t pairs = (m + 1) / 2;
    return 2 * imm_beliefs_size(n, m) + m * n * n + IMM_BLOCK * imm_note_size(n, m) + imm_filter_room(n, m) +
           2 * (pairs * (n + n * n) + 2 * m * n * n + pairs * m * (3 * n + n * n) + m * (n + n * n) + 9 * n * n);
}

/* Take the next part of the memory. */
static real *part(real **room, const int64_t count) {
    real *from = *room;
    *room += count;
    return from;
}

static pair_t *pairs_of(real **room, const int64_t count) { return (pair_t *)part(room, 2 * count); }

static rooms_t rooms_in(const int64_t n, const int64_t m, real *room) {
    const int64_t nn = n * n, pairs = (m + 1) / 2;
    rooms_t rooms;
    rooms.beliefs = part(&room, imm_beliefs_size(n, m)), rooms.roots = part(&room, m * nn);
    rooms.x = pairs_of(&room, pairs * n), rooms.G = pairs_of(&room, pairs * nn);
    rooms.B = pairs_of(&room, m * nn), rooms.Y = pairs_of(&room, m * nn);
    rooms.r = pairs_of(&room, pairs * m * n), rooms.v = pairs_of(&room, pairs * m * n);
    rooms.D = pairs_of(&room, pairs * m * n), rooms.L = pairs_of(&room, pairs * m * nn);
    rooms.merged = pairs_of(&room, m * (n + nn)), rooms.step = pairs_of(&room, 9 * nn);
    rooms.Q = NULL, rooms.rest = room;
    return rooms;
}

static later_t later_in(const int64_t n, const int64_t m, real *memory) {
    later_t later;
    later.known = *part(&memory, 1) > 0;
    later.g = part(&memory, m), later.c = part(&memory, m * n), later.r = part(&memory, m * n);
    later.Y = part(&memory, m * n * n);
    later.F = part(&memory, m * n * n), later.Q = part(&memory, m * n * n), later.T = part(&memory, m * m);
    return later;
}

/* Store in the caller's memory whether there are later rows, and the matrices of the step to the first of them. */
static void keep_later(const int64_t n, const int64_t m, const later_t *later, real *memory) {
    const later_t kept = later_in(n, m, memory);
    real *F = later->Y + m * n * n, *Q = F + m * n * n, *T = Q + m * n * n;
    memory[0] = later->known;
    if (later->F == kept.F) return;
    memcpy(F, later->F, sizeof(real) * (size_t)(m * n * n));
    memcpy(Q, later->Q, sizeof(real) * (size_t)(m * n * n));
    memcpy(T, later->T, sizeof(real) * (size_t)(m * m));
}

/* Return the square roots of two determinants from their pivots, which are all 1 or more, each without a power of 2;
   write the exponents of these powers. */
INLINE pair_t determinant_roots(const int n, const pair_t *D, pair_t *powers) {
    pair_t product = both(1);
    *powers = both(0);
    UNROLL
    for (int a = 0; a < n; a++) {
        product *= D[a];
        if (product[0] > LARGE || product[1] > LARGE) {
            int64_t first = 0, second = 0;
            product = (pair_t){near_one(product[0], &first), near_one(product[1], &second)};
            *powers += (real)0.5 * (pair_t){(real)first, (real)second};
        }
    }
    return roots(product);
}

/* Factor I + G' (Y G) = L D L' with L unit lower triangular; only rounding can make a pivot less than 1. */
INLINE void factor_identity_plus(const int n, const pair_t *G, const pair_t *YG, pair_t *L, pair_t *D) {
    UNROLL
    for (int a = 0; a < n; a++) {
        UNROLL
        for (int b = a; b < n; b++) {
            pair_t s = both(a == b);
            UNROLL
            for (int k = 0; k < n; k++) s += G[k * n + b] * YG[k * n + a];
            UNROLL
            for (int c = 0; c < a; c++) s -= L[b * n + c] * L[a * n + c] * D[c];
            if (a == b)
                D[a] = (pair_t){s[0] > 1 ? s[0] : 1, s[1] > 1 ? s[1] : 1};
            else
                L[b * n + a] = s / D[a];
        }
    }
}

/* C = A B */
INLINE void product_of(const int n, const pair_t *A, const pair_t *B, pair_t *C) {
    UNROLL
    for (int a = 0; a < n; a++) {
        UNROLL
        for (int b = 0; b < n; b++) {
            pair_t s = both(0);
            UNROLL
            for (int k = 0; k < n; k++) s += A[a * n + k] * B[k * n + b];
            C[a * n + b] = s;
        }
    }
}

INLINE pair_t sum_of(const int n, const pair_t *a, const pair_t *b) {
    pair_t s = both(0);
    UNROLL
    for (int k = 0; k < n; k++) s += a[k] * b[k];
    return s;
}

/* v = L^-1 v */
INLINE void solve_lower(const int n, const pair_t *L, pair_t *v) {
    UNROLL
    for (int a = 0; a < n; a++) {
        UNROLL
        for (int c = 0; c < a; c++) v[a] -= L[a * n + c] * v[c];
    }
}

/* v = L'^-1 v */
INLINE void solve_upper(const int n, const pair_t *L, pair_t *v) {
    UNROLL
    for (int a = n - 1; a >= 0; a--) {
        UNROLL
        for (int c = a + 1; c < n; c++) v[a] -= L[c * n + a] * v[c];
    }
}

/* y = A' x */
INLINE void times_transposed(const int n, const pair_t *A, const pair_t *x, pair_t *y) {
    UNROLL
    for (int a = 0; a < n; a++) {
        pair_t s = both(0);
        UNROLL
        for (int k = 0; k < n; k++) s += A[k * n + a] * x[k];
        y[a] = s;
    }
}

/* The backward pass over the step into one mode; both numbers of each pair are equal. */
typedef struct {
    const pair_t *B;
    pair_t *F, *Y, *YB, *L; /* matrix of the step; information after the step; Y B; factor of I + B' Y B */
    pair_t D[N_MAX], c[N_MAX], r[N_MAX];
    pair_t g; /* without half the logarithm of the determinant */
} backward_step_t;

/* Prepare the backward pass over the step into mode i, and write the information on the state before the step (10):
   F' (A' Y A + W' W) F with W = (I + B' Y B)^-1 B' Y, A = I - B W. */
INLINE void begin_backward_step(const int n, const int i, const later_t *later, const rooms_t *rooms,
                                backward_step_t *step, pair_t *before) {
    const int nn = n * n;
    pair_t powers, *room = rooms->step, *W = room + 4 * nn, *A = room + 5 * nn;
    pair_t *AF = room + 6 * nn, *WF = room + 7 * nn;
    step->B = rooms->B + i * nn;
    step->F = room, step->Y = room + nn, step->YB = room + 2 * nn, step->L = room + 3 * nn;
    for (int k = 0; k < nn; k++) step->F[k] = both(later->F[i * nn + k]), step->Y[k] = both(later->Y[i * nn + k]);
    for (int a = 0; a < n; a++) step->c[a] = both(later->c[i * n + a]), step->r[a] = both(later->r[i * n + a]);
    product_of(n, step->Y, step->B, step->YB);
    factor_identity_plus(n, step->B, step->YB, step->L, step->D);
    const pair_t root = determinant_roots(n, step->D, &powers);
    step->g = later->g[i] - (logarithms(root) + powers * LN_2);
    UNROLL
    for (int b = 0; b < n; b++) {
        pair_t w[N_MAX];
        UNROLL
        for (int a = 0; a < n; a++) w[a] = step->YB[b * n + a];
        solve_lower(n, step->L, w);
        UNROLL
        for (int a = 0; a < n; a++) w[a] /= step->D[a];
        solve_upper(n, step->L, w);
        UNROLL
        for (int a = 0; a < n; a++)
            W[a * n + b] = w[a], A[a * n + b] = both(a == b) - sum_of(n, step->B + a * n, w);
    }
    product_of(n, A, step->F, AF);
    product_of(n, W, step->F, WF);
    product_of(n, step->Y, AF, A);
    UNROLL
    for (int a = 0; a < n; a++) {
        UNROLL
        for (int b = 0; b <= a; b++) {
            pair_t s = both(0);
            UNROLL
            for (int k = 0; k < n; k++) s += AF[k * n + a] * A[k * n + b] + WF[k * n + a] * WF[k * n + b];
            before[a * n + b] = before[b * n + a] = s;
        }
    }
}

/* Write r of the likelihood for the states before the step, with their means x as centres; return g (11). */
INLINE pair_t likelihood_before_step(const int n, const backward_step_t *step, const pair_t *x, pair_t *r) {
    pair_t d[N_MAX], q[N_MAX], u[N_MAX], y[N_MAX], g = step->g;
    UNROLL
    for (int a = 0; a < n; a++) d[a] = sum_of(n, step->F + a * n, x) - step->c[a];
    UNROLL
    for (int a = 0; a < n; a++) {
        const pair_t Yd = sum_of(n, step->Y + a * n, d);
        g += (step->r[a] - (real)0.5 * Yd) * d[a], q[a] = step->r[a] - Yd;
    }
    times_transposed(n, step->B, q, u);
    solve_lower(n, step->L, u);
    UNROLL
    for (int a = 0; a < n; a++) y[a] = u[a] / step->D[a], g += (real)0.5 * u[a] * y[a];
    solve_upper(n, step->L, y);
    UNROLL
    for (int a = 0; a < n; a++) q[a] -= sum_of(n, step->YB + a * n, y);
    times_transposed(n, step->F, q, r);
    return g;
}

/* Return the logarithms of the evidence, without g, for states with covariance P = G G', plus log shares (12). r and Y
   are those of the likelihood about the means of the states. Write the factors of I + G' Y G, and
   v = (I + G' Y G)^-1 G' r. */
INLINE pair_t log_evidence(const int n, const pair_t *G, const pair_t *Y, const pair_t *r, const pair_t share,
                           pair_t *YG, pair_t *L, pair_t *D, pair_t *v) {
    pair_t powers, fit = both(0);
    product_of(n, Y, G, YG);
    factor_identity_plus(n, G, YG, L, D);
    times_transposed(n, G, r, v);
    solve_lower(n, L, v);
    UNROLL
    for (int a = 0; a < n; a++) {
        const pair_t u = v[a];
        v[a] = u / D[a], fit += (real)0.5 * u * v[a];
    }
    solve_upper(n, L, v);
    const pair_t root = determinant_roots(n, D, &powers);
    return fit + logarithms(share / root) - powers * LN_2;
}

/* Combine all modes before a step with all modes after it: write to `fit` (M, M) the logarithm of the probability of
   each pair, without a common factor (10) to (12). */
INLINE void combine_modes(const int n, const int m, const mode_states_t now, const later_t *later, rooms_t *rooms,
                          real *fit) {
    const int nn = n * n;
    if (rooms->Q != later->Q)
        for (int i = 0; i < m; i++) {
            covariance_root(n, later->Q + i * nn, rooms->roots);
            for (int k = 0; k < nn; k++) rooms->B[i * nn + k] = both(rooms->roots[k]);
        }
    rooms->Q = later->Q;
    for (int j = 0; j < m; j++) covariance_root(n, now.P + j * nn, rooms->roots + j * nn);
    pack_modes(nn, m, rooms->roots, rooms->G);
    pack_modes(n, m, now.x, rooms->x);
    for (int i = 0; i < m; i++) {
        pair_t *Y = rooms->Y + i * nn;
        backward_step_t step;
        begin_backward_step(n, i, later, rooms, &step, Y);
        for (int q = 0; 2 * q < m; q++) {
            const int first = 2 * q, second = first + 1 < m ? first + 1 : first, at = q * m + i;
            const real least = UNLIKELY * UNLIKELY, one = now.mu[first] * later->T[first * m + i];
            const real other = now.mu[second] * later->T[second * m + i];
            const pair_t share = {one > least ? one : least, other > least ? other : least};
            const pair_t g = likelihood_before_step(n, &step, rooms->x + q * n, rooms->r + at * n);
            const pair_t fitted =
                g + log_evidence(n, rooms->G + q * nn, Y, rooms->r + at * n, share, rooms->step + 8 * nn,
                                 rooms->L + at * nn, rooms->D + at * n, rooms->v + at * n);
            if (second > first) fit[second * m + i] = fitted[1] > LEAST && fitted[1] < -LEAST ? fitted[1] : LEAST;
            fit[first * m + i] = fitted[0] > LEAST && fitted[0] < -LEAST ? fitted[0] : LEAST;
        }
    }
}

/* Write the smoothed states of two modes: mixtures over all modes after the step, with the given shares (13). */
INLINE void smooth_pair(const int n, const int m, const int q, const pair_t *share, const rooms_t *rooms, pair_t *x,
                        pair_t *P) {
    const int nn = n * n;
    const pair_t *G = rooms->G + q * nn;
    for (int a = 0; a < n; a++) x[a] = both(0);
    for (int i = 0; i < m; i++) {
        if (!(share[i][0] > 0 || share[i][1] > 0)) continue;
        const pair_t *L = rooms->L + (q * m + i) * nn, *D = rooms->D + (q * m + i) * n, *v = rooms->v + (q * m + i) * n;
        pair_t *own = rooms->merged + i * (n + nn), *spread = own + n, *W = rooms->step; /* G (I + G' Y G)^-1 G' */
        for (int a = 0; a < n; a++) {
            own[a] = rooms->x[q * n + a] + sum_of(n, G + a * n, v);
            x[a] += choose(share[i] > both(0), share[i] * own[a], both(0));
            for (int b = 0; b < n; b++) W[a * n + b] = G[a * n + b];
            solve_lower(n, L, W + a * n);
            for (int b = 0; b <= a; b++) {
                pair_t s = both(0);
                for (int k = 0; k < n; k++) s += W[a * n + k] * W[b * n + k] / D[k];
                spread[a * n + b] = s;
            }
        }
    }
    for (int a = 0; a < n; a++)
        for (int b = 0; b <= a; b++) {
            pair_t s = both(0);
            for (int i = 0; i < m; i++) {
                if (!(share[i][0] > 0 || share[i][1] > 0)) continue;
                const pair_t *own = rooms->merged + i * (n + nn);
                const pair_t apart = (own[a] - x[a]) * (own[b] - x[b]);
                s += choose(share[i] > both(0), share[i] * (own[n + a * n + b] + apart), both(0));
            }
            P[a * n + b] = P[b * n + a] = s;
        }
}

/* Pool, for each of two modes, the likelihoods for all modes after the step into one likelihood with r and Y (14);
   return the logarithm of its evidence for the mode's state, without g. */
INLINE pair_t pool(const int n, const int m, const int q, const pair_t *share, const rooms_t *rooms, pair_t *r,
                   pair_t *Y) {
    const int nn = n * n;
    pair_t *L = rooms->step, *YG = L + nn, D[N_MAX], v[N_MAX];
    for (int a = 0; a < n; a++) {
        r[a] = both(0);
        for (int i = 0; i < m; i++) r[a] += share[i] * rooms->r[(q * m + i) * n + a];
    }
    for (int k = 0; k < nn; k++) {
        Y[k] = both(0);
        for (int i = 0; i < m; i++) Y[k] += share[i] * rooms->Y[i * nn + k];
    }
    return log_evidence(n, rooms->G + q * nn, Y, r, both(1), YG, L, D, v);
}

/* Pass back over the step after a row: write the smoothed states of the row, if `wanted`, and the likelihood of the
   later rows as a function of its state. */
INLINE void smooth_row(const int n, const int m, const mode_states_t now, const int wanted, later_t *later,
                       rooms_t *rooms) {
    const int nn = n * n;
    const mode_states_t own = beliefs_in(n, m, rooms->beliefs);
    real fit[MODES_MAX * MODES_MAX], highest[MODES_MAX], best = LEAST, every = 0;
    pair_t share[MODES_MAX / 2 * MODES_MAX], sum[MODES_MAX / 2], top[MODES_MAX / 2];
    combine_modes(n, m, now, later, rooms, fit);
    for (int j = 0; j < m; j++) {
        highest[j] = LEAST;
        for (int i = 0; i < m; i++) highest[j] = fit[j * m + i] > highest[j] ? fit[j * m + i] : highest[j];
        best = highest[j] > best ? highest[j] : best;
    }
    for (int q = 0; 2 * q < m; q++) {
        const int first = 2 * q, second = first + 1 < m ? first + 1 : first; /* an unpaired last mode counts twice */
        top[q] = (pair_t){highest[first], highest[second]}, sum[q] = both(0);
        for (int i = 0; i < m; i++) {
            share[q * m + i] = exponentials((pair_t){fit[first * m + i], fit[second * m + i]} - top[q]);
            sum[q] += share[q * m + i];
        }
        const pair_t probable = sum[q] * exponentials(top[q] - best);
        own.mu[first] = probable[0], every += probable[0];
        if (second > first) own.mu[second] = probable[1], every += probable[1];
    }
    for (int q = 0; 2 * q < m; q++) {
        const int first = 2 * q, second = first + 1 < m ? first + 1 : first;
        const pair_t mu = (pair_t){own.mu[first], own.mu[second]} / every;
        pair_t used_share[MODES_MAX], *x = rooms->step + 2 * nn, *P = x + n, *r = rooms->step + 4 * nn, *Y = r + n;
        for (int i = 0; i < m; i++) {
            share[q * m + i] /= sum[q];
            used_share[i] = choose(share[q * m + i] * mu > both(NEGLIGIBLE), share[q * m + i], both(0));
        }
        if (wanted) smooth_pair(n, m, q, used_share, rooms, x, P);
        const pair_t pooled = pool(n, m, q, share + q * m, rooms, r, Y);
        const pair_t evidence = top[q] + logarithms(sum[q] / (pair_t){now.mu[first], now.mu[second]}) - pooled;
        for (int j = first; j <= second; j++) {
            const real likely = j == first ? mu[0] : mu[1], *x_j = (real *)x + j % 2, *P_j = (real *)P + j % 2;
            const real *r_j = (real *)r + j % 2, *Y_j = (real *)Y + j % 2;
            const int smoothed = wanted && likely > NEGLIGIBLE;
            own.mu[j] = likely > UNLIKELY ? likely : UNLIKELY;
            later->g[j] = j == first ? evidence[0] : evidence[1];
            for (int a = 0; a < n; a++)
                own.x[j * n + a] = smoothed ? x_j[2 * a] : now.x[j * n + a], later->r[j * n + a] = r_j[2 * a];
            for (int i = 0; i < nn; i++)
                own.P[j * nn + i] = smoothed ? P_j[2 * i] : now.P[j * nn + i], later->Y[j * nn + i] = Y_j[2 * i];
        }
    }
}

/* Add the likelihood of a row's measurement to that of the later measurements; the centre is the filtered mean (9). */
INLINE void add_measurement(const int n, const int m, const real *h, const mode_states_t now, const real *noted,
                            later_t *later) {
    real best = LEAST;
    for (int j = 0; j < m; j++, noted += NOTED) {
        real *r = later->r + j * n, *Y = later->Y + j * n * n;
        for (int a = 0; a < n; a++) {
            later->c[j * n + a] = now.x[j * n + a];
            r[a] += noted[0] * h[a];
            for (int b = 0; b < n; b++) Y[a * n + b] += noted[1] * h[a] * h[b];
        }
        later->g[j] += noted[2];
        best = later->g[j] > best ? later->g[j] : best;
    }
    for (int j = 0; j < m; j++) later->g[j] -= best; /* a common factor has no information */
    later->known = 1;
}

/* Smooth filtered rows from their notes, from the last row to the first; row 0 is row `first` of the estimate. */
INLINE void smooth_rows(const int n, const imm_t *imm, const real level, const int32_t *step, real *notes,
                        const int64_t rows, const int64_t first, later_t *later, rooms_t *rooms,
                        const imm_estimate_t *estimate) {
    const int m = (int)imm->modes, nn = n * n, wanted = estimate->signal || estimate->probability || estimate->mean;
    const int64_t size = imm_beliefs_size(n, m), noted = imm_note_size(n, m);
    for (int64_t row = rows - 1; row >= 0; row--) {
        const mode_states_t now = beliefs_in(n, m, notes + row * noted);
        const int64_t at = (int64_t)step[row] * m;
        if (!(now.mu[0] > 0)) break; /* before the first measurement */
        if (later->known)
            smooth_row(n, m, now, wanted, later, rooms);
        else /* without later rows the smoothed estimate is the filtered one */
            for (int k = 0; k < m * nn; k++) later->g[k / nn] = later->r[k / n] = later->Y[k] = 0;
        write_estimate(n, m, imm->c, level, later->known ? beliefs_in(n, m, rooms->beliefs) : now, first + row, estimate);
        add_measurement(n, m, imm->h, now, now.mu + size, later);
        later->F = imm->F + at * nn, later->Q = imm->Q + at * nn, later->T = imm->T + at * m;
    }
}

static void smooth_rows_of(const imm_t *imm, const real level, const int32_t *step, real *notes, const int64_t rows,
                      const int64_t first, later_t *later, rooms_t *rooms, const imm_estimate_t *estimate) {
    FOR_FEW_STATES(imm->states, smooth_rows, imm, level, step, notes, rows, first, later, rooms, estimate)
}

void imm_smooth(const imm_t *imm, const real level, const imm_block_t *block, const real *before,
                const imm_estimate_t *estimate, real *later, real *room) {
    const int64_t n = imm->states, m = imm->modes, size = imm_beliefs_size(n, m);
    rooms_t rooms = rooms_in(n, m, room);
    later_t known = later_in(n, m, later);
    real *beliefs = rooms.rest, *notes = beliefs + size, *rest = notes + IMM_BLOCK * imm_note_size(n, m);
    for (int64_t k = (block->rows + IMM_BLOCK - 1) / IMM_BLOCK - 1; k >= 0; k--) {
        const int64_t from = k * IMM_BLOCK, left = block->rows - from;
        const imm_block_t some = {block->z + from, block->step + from, left < IMM_BLOCK ? left : IMM_BLOCK};
        const imm_estimate_t nothing = {NULL, NULL, NULL, NULL, NULL, NULL, NULL, 0};
        const imm_passed_t passed = {NULL, notes};
        score_t score = {0, 1, 0, 0};
        memcpy(beliefs, before + k * size, sizeof(real) * (size_t)size);
        filter_modes(imm, beliefs, level, &some, &nothing, &passed, rest, &score);
        smooth_rows_of(imm, level, some.step, notes, some.rows, from, &known, &rooms, estimate);
    }
    keep_later(n, m, &known, later);
}

void imm_smooth_late(const imm_t *imm, const real level, const int32_t *step, real *notes, const int64_t rows,
                     const int64_t turn, const int64_t every, const int64_t lag, const imm_estimate_t *estimate,
                     real *room) {
    const int64_t n = imm->states, m = imm->modes, noted = imm_note_size(n, m);
    rooms_t rooms = rooms_in(n, m, room);
    later_t later = later_in(n, m, rooms.rest);
    for (int64_t stop = turn; stop <= rows; stop += every) {
        const int64_t from = stop - 1 > lag ? stop - 1 - lag : 0;
        later.known = 0;
        smooth_rows_of(imm, level, step + from, notes + from * noted, stop - from, from, &later, &rooms, estimate);
    }
}
