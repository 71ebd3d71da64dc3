/* The smoother of several modes: coming back, each mode is told what the later measurements said.

   To a mode they are a likelihood of its state, exp(g + r' (x - c) - (x - c)' Y (x - c) / 2), about a centre c. Over a
   step it stays one, whatever Q is: Y >= 0, and all that is inverted is I and something positive, so that neither a state
   without noise, nor one that sleeps, nor one that no measurement sees does any harm. Source: the two-filter form of
   Fraser and Potter, IEEE TAC-14 (1969) 387.

   For every pair of a mode before a step and a mode after it, the filtered belief of the one meets what the later
   measurements say to the other; the pair is as probable as its forward probability times how well they agree. So a jump
   that only later measurements reveal is found. What they say to a mode, over all modes after it, is pooled into one
   likelihood by the mean of their logarithms, each weighed by how probable it is: that keeps every covariance positive
   and below the filtered one, where the moments of the mixture would not. */
#include "imm.h"

#include <string.h>

#include "information.h"
#include "modes.h"
#include "normal.h"
#include "product.h"

#define NEGLIGIBLE ((real)1e-16) /* share of a pair that is not looked at */
#define LEAST ((real)-1e300)     /* a logarithm below any */
#define LN_2 ((real)0.69314718055994530942)

/* What later rows say of a row, to each mode, and the step to the first of them. */
typedef struct {
    int known;            /* whether there are any */
    real *g, *c, *r, *Y;  /* (M,), (M, n), (M, n), (M, n, n) */
    const real *F, *Q, *T;
} later_t;

/* Room for one row. Of pairs, the mode before comes first. */
typedef struct {
    real *beliefs; /* that are smoothed */
    real *G;       /* (M, n, n) P = G G' of each mode before */
    real *B;       /* (M, n, n) Q = B B' of each mode after ... */
    const real *Q; /* ... over this step */
    real *Y;       /* (M, n, n) how surely each mode after speaks of the state before the step */
    real *r;       /* (M, M, n) what it says of it */
    real *L, *D;   /* (M, M, n, n), (M, M, n) factors of I + G' Y G */
    real *v;       /* (M, M, n) G v is what the mean moves by */
    real *x, *P;   /* (M, n), (M, n, n) of a mode before with each mode after */
    real *rest;
} rooms_t;

int64_t imm_later_size(const int64_t states, const int64_t modes) {
    const int64_t n = states, m = modes;
    return 1 + m * (1 + 2 * n + 3 * n * n) + m * m;
}

int64_t imm_smooth_room(const int64_t states, const int64_t modes) {
    const int64_t n = states, m = modes;
    return 2 * imm_beliefs_size(n, m) + m * (n + 4 * n * n) + m * m * (3 * n + n * n) +
           IMM_BLOCK * imm_note_size(n, m) + imm_filter_room(n, m);
}

/* Take the next part of a room. */
static real *part(real **room, const int64_t count) {
    real *from = *room;
    *room += count;
    return from;
}

static rooms_t rooms_in(const int64_t n, const int64_t m, real *room) {
    rooms_t rooms;
    rooms.beliefs = part(&room, imm_beliefs_size(n, m));
    rooms.G = part(&room, m * n * n), rooms.B = part(&room, m * n * n), rooms.Y = part(&room, m * n * n);
    rooms.r = part(&room, m * m * n), rooms.v = part(&room, m * m * n), rooms.D = part(&room, m * m * n);
    rooms.L = part(&room, m * m * n * n);
    rooms.x = part(&room, m * n), rooms.P = part(&room, m * n * n);
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

/* Keep, at the end of a call, what later rows say in memory. */
static void keep_later(const int64_t n, const int64_t m, const later_t *later, real *memory) {
    const later_t kept = later_in(n, m, memory);
    real *F = later->Y + m * n * n, *Q = F + m * n * n, *T = Q + m * n * n;
    memory[0] = later->known;
    if (later->F == kept.F) return;
    memcpy(F, later->F, sizeof(real) * (size_t)(m * n * n));
    memcpy(Q, later->Q, sizeof(real) * (size_t)(m * n * n));
    memcpy(T, later->T, sizeof(real) * (size_t)(m * m));
}

/* Factor I + G' Y G = L D L' with L unit lower triangular; no pivot is below 1, but by rounding. Return the determinant
   but for powers of two, which are counted. */
INLINE real factor_beside_one(const int n, const real *G, const real *YG, real *L, real *D, int64_t *exponent) {
    real product = 1;
    *exponent = 0;
    for (int a = 0; a < n; a++)
        for (int b = a; b < n; b++) {
            real s = a == b;
            for (int k = 0; k < n; k++) s += G[k * n + b] * YG[k * n + a];
            for (int c = 0; c < a; c++) s -= L[b * n + c] * L[a * n + c] * D[c];
            if (a == b) {
                D[a] = s > 1 ? s : 1;
                product *= D[a];
                if (product > LARGE) product = near_one(product, exponent);
            } else
                L[b * n + a] = s / D[a];
        }
    return product;
}

/* v = L^-1 v */
INLINE void solve_lower(const int n, const real *L, real *v) {
    for (int a = 0; a < n; a++)
        for (int c = 0; c < a; c++) v[a] -= L[a * n + c] * v[c];
}

/* v = L'^-1 v */
INLINE void solve_upper(const int n, const real *L, real *v) {
    for (int a = n - 1; a >= 0; a--)
        for (int c = a + 1; c < n; c++) v[a] -= L[c * n + a] * v[c];
}

/* y = A' x */
INLINE void times_transposed(const int n, const real *A, const real *x, real *y) {
    for (int a = 0; a < n; a++) {
        y[a] = 0;
        for (int k = 0; k < n; k++) y[a] += A[k * n + a] * x[k];
    }
}

/* The way back over a step into one mode. */
typedef struct {
    const real *F, *B;
    real YB[NN_MAX], L[NN_MAX], D[N_MAX]; /* Y B; factors of I + B' Y B */
    real half;                            /* of the logarithm of its determinant */
} way_t;

/* Begin the way back, and write how surely the state before the step is spoken of (10): F' (A' Y A + W' W) F with
   W = (I + B' Y B)^-1 B' Y, A = I - B W. */
INLINE void begin_way(const int n, const real *F, const real *B, const real *Y, way_t *way, real *before) {
    real W[NN_MAX], A[NN_MAX], AF[NN_MAX], WF[NN_MAX], w[N_MAX];
    int64_t exponent;
    way->F = F, way->B = B;
    multiply(n, Y, B, way->YB);
    const real product = factor_beside_one(n, B, way->YB, way->L, way->D, &exponent);
    way->half = (real)0.5 * (logarithm(product) + (real)exponent * LN_2);
    for (int b = 0; b < n; b++) {
        for (int a = 0; a < n; a++) w[a] = way->YB[b * n + a];
        solve_lower(n, way->L, w);
        for (int a = 0; a < n; a++) w[a] /= way->D[a];
        solve_upper(n, way->L, w);
        for (int a = 0; a < n; a++) W[a * n + b] = w[a], A[a * n + b] = (a == b) - dot(n, B + a * n, w);
    }
    multiply(n, A, F, AF);
    multiply(n, W, F, WF);
    multiply(n, Y, AF, A);
    for (int a = 0; a < n; a++)
        for (int b = 0; b <= a; b++) {
            real s = 0;
            for (int k = 0; k < n; k++) s += AF[k * n + a] * A[k * n + b] + WF[k * n + a] * WF[k * n + b];
            before[a * n + b] = before[b * n + a] = s;
        }
}

/* Write r of the state before the step, about a mean x, from r and Y of that after it, about c; return what g changes by
   (11). */
INLINE real go_back(const int n, const way_t *way, const real *x, const real *c, const real *r_after, const real *Y,
                    real *r) {
    real d[N_MAX], q[N_MAX], u[N_MAX], y[N_MAX], g = -way->half;
    times(n, way->F, x, d);
    for (int a = 0; a < n; a++) d[a] -= c[a];
    times(n, Y, d, q);
    for (int a = 0; a < n; a++) g += (r_after[a] - (real)0.5 * q[a]) * d[a], q[a] = r_after[a] - q[a];
    times_transposed(n, way->B, q, u);
    solve_lower(n, way->L, u);
    for (int a = 0; a < n; a++) y[a] = u[a] / way->D[a], g += (real)0.5 * u[a] * y[a];
    solve_upper(n, way->L, y);
    for (int a = 0; a < n; a++) q[a] -= dot(n, way->YB + a * n, y);
    times_transposed(n, way->F, q, r);
    return g;
}

/* Return how well a belief P = G G' agrees with r and Y about its mean, as a log-likelihood, times a share (12). Write
   the factors of I + G' Y G, and v = (I + G' Y G)^-1 G' r. */
INLINE real agree(const int n, const real *G, const real *Y, const real *r, const real share, real *L, real *D, real *v) {
    real YG[NN_MAX], fit = 0;
    int64_t exponent;
    multiply(n, Y, G, YG);
    const real product = factor_beside_one(n, G, YG, L, D, &exponent);
    times_transposed(n, G, r, v);
    solve_lower(n, L, v);
    for (int a = 0; a < n; a++) {
        const real u = v[a];
        v[a] = u / D[a], fit += (real)0.5 * u * v[a];
    }
    solve_upper(n, L, v);
    return fit + logarithm(share / sqrt(product)) - (real)0.5 * (real)exponent * LN_2;
}

/* Let all pairs meet: write how well they fit, as logarithms (10) to (12). */
INLINE void meet(const int n, const int m, const beliefs_t now, const later_t *later, rooms_t *rooms, real *fit) {
    const int nn = n * n;
    for (int i = 0; i < m && rooms->Q != later->Q; i++) covariance_root(n, later->Q + i * nn, rooms->B + i * nn);
    rooms->Q = later->Q;
    for (int j = 0; j < m; j++) covariance_root(n, now.P + j * nn, rooms->G + j * nn);
    for (int i = 0; i < m; i++) {
        const real *after = later->Y + i * nn;
        real *Y = rooms->Y + i * nn;
        way_t way;
        begin_way(n, later->F + i * nn, rooms->B + i * nn, after, &way, Y);
        for (int j = 0; j < m; j++) {
            const int pair = j * m + i;
            const real probable = now.mu[j] * later->T[pair], least = UNLIKELY * UNLIKELY;
            real *r = rooms->r + pair * n;
            real told = later->g[i] + go_back(n, &way, now.x + j * n, later->c + i * n, later->r + i * n, after, r);
            told += agree(n, rooms->G + j * nn, Y, r, probable > least ? probable : least, rooms->L + pair * nn,
                          rooms->D + pair * n, rooms->v + pair * n);
            fit[pair] = told > LEAST && told < -LEAST ? told : LEAST;
        }
    }
}

/* Write the smoothed state of mode j, merged over all modes after it, given the share of each (13). */
INLINE void smooth_mode(const int n, const int m, const int j, const real *share, const real mu, const beliefs_t now,
                        const rooms_t *rooms, real *x, real *P) {
    const int nn = n * n;
    const real *G = rooms->G + j * nn;
    for (int a = 0; a < n; a++) x[a] = 0;
    for (int i = 0; i < nn; i++) P[i] = 0;
    for (int i = 0; i < m; i++) {
        if (!(share[i] * mu > NEGLIGIBLE)) continue;
        const real *L = rooms->L + (j * m + i) * nn, *D = rooms->D + (j * m + i) * n, *v = rooms->v + (j * m + i) * n;
        real *own = rooms->x + i * n, *spread = rooms->P + i * nn, W[NN_MAX]; /* G (I + G' Y G)^-1 G' = W D^-1 W' */
        for (int a = 0; a < n; a++) {
            own[a] = now.x[j * n + a] + dot(n, G + a * n, v);
            x[a] += share[i] * own[a];
            for (int b = 0; b < n; b++) W[a * n + b] = G[a * n + b];
            solve_lower(n, L, W + a * n);
            for (int b = 0; b <= a; b++) {
                real s = 0;
                for (int k = 0; k < n; k++) s += W[a * n + k] * W[b * n + k] / D[k];
                spread[a * n + b] = s;
            }
        }
    }
    for (int i = 0; i < m; i++) {
        if (!(share[i] * mu > NEGLIGIBLE)) continue;
        const real *own = rooms->x + i * n, *spread = rooms->P + i * nn;
        for (int a = 0; a < n; a++)
            for (int b = 0; b <= a; b++)
                P[a * n + b] += share[i] * (spread[a * n + b] + (own[a] - x[a]) * (own[b] - x[b]));
    }
    for (int a = 0; a < n; a++)
        for (int b = 0; b < a; b++) P[b * n + a] = P[a * n + b];
}

/* Pool what all modes after it say to mode j into one likelihood, as likely as all of them (14). */
INLINE void pool(const int n, const int m, const int j, const real *share, const real evidence, const rooms_t *rooms,
                 const later_t *later) {
    const int nn = n * n;
    real *r = later->r + j * n, *Y = later->Y + j * nn, L[NN_MAX], D[N_MAX], v[N_MAX];
    for (int a = 0; a < n; a++) {
        r[a] = 0;
        for (int i = 0; i < m; i++) r[a] += share[i] * rooms->r[(j * m + i) * n + a];
    }
    for (int k = 0; k < nn; k++) {
        Y[k] = 0;
        for (int i = 0; i < m; i++) Y[k] += share[i] * rooms->Y[i * nn + k];
    }
    later->g[j] = evidence - agree(n, rooms->G + j * nn, Y, r, 1, L, D, v);
}

/* Come back over the step after a row: write its smoothed beliefs, and what later rows say of it. */
INLINE void smooth_row(const int n, const int m, const beliefs_t now, later_t *later, rooms_t *rooms) {
    const int nn = n * n;
    const beliefs_t own = beliefs_in(n, m, rooms->beliefs);
    real fit[MODES_MAX * MODES_MAX], highest[MODES_MAX], total[MODES_MAX], best = LEAST, every = 0;
    meet(n, m, now, later, rooms, fit);
    for (int j = 0; j < m; j++) {
        real *share = fit + j * m; /* of each mode after it, once they are scaled */
        highest[j] = LEAST, total[j] = 0;
        for (int i = 0; i < m; i++) highest[j] = share[i] > highest[j] ? share[i] : highest[j];
        for (int i = 0; i < m; i++) share[i] = exponential(share[i] - highest[j]), total[j] += share[i];
        for (int i = 0; i < m; i++) share[i] /= total[j];
        best = highest[j] > best ? highest[j] : best;
    }
    for (int j = 0; j < m; j++) own.mu[j] = total[j] * exponential(highest[j] - best), every += own.mu[j];
    for (int j = 0; j < m; j++) {
        const real mu = own.mu[j] / every, *share = fit + j * m;
        own.mu[j] = mu > UNLIKELY ? mu : UNLIKELY;
        if (mu > NEGLIGIBLE)
            smooth_mode(n, m, j, share, mu, now, rooms, own.x + j * n, own.P + j * nn);
        else
            for (int k = 0; k < nn; k++) own.P[j * nn + k] = now.P[j * nn + k], own.x[j * n + k % n] = now.x[j * n + k % n];
        pool(n, m, j, share, highest[j] + logarithm(total[j] / now.mu[j]), rooms, later);
    }
}

/* Add what the measurement of a row said to what later ones say, all about the filtered mean (9). */
INLINE void take_back(const int n, const int m, const real *h, const beliefs_t now, const real *noted, later_t *later) {
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
    for (int j = 0; j < m; j++) later->g[j] -= best; /* a factor that all have tells nothing */
    later->known = 1;
}

/* Smooth rows that were noted, the last first, and write them from a row of the estimate on. */
INLINE void smooth_rows(const int n, const imm_t *imm, const real level, const int32_t *step, real *notes,
                        const int64_t rows, const int64_t first, later_t *later, rooms_t *rooms,
                        const imm_estimate_t *estimate) {
    const int m = (int)imm->modes, nn = n * n;
    const int64_t size = imm_beliefs_size(n, m), noted = imm_note_size(n, m);
    for (int64_t row = rows - 1; row >= 0; row--) {
        const beliefs_t now = beliefs_in(n, m, notes + row * noted);
        const int64_t at = (int64_t)step[row] * m;
        if (!(now.mu[0] > 0)) break; /* before the first measurement */
        if (later->known)
            smooth_row(n, m, now, later, rooms);
        else /* nothing follows, and nothing is said of it */
            for (int k = 0; k < m * nn; k++) later->g[k / nn] = later->r[k / n] = later->Y[k] = 0;
        write_estimate(n, m, imm->c, level, later->known ? beliefs_in(n, m, rooms->beliefs) : now, first + row, estimate);
        take_back(n, m, imm->h, now, now.mu + size, later);
        later->F = imm->F + at * nn, later->Q = imm->Q + at * nn, later->T = imm->T + at * m;
    }
}

static void come_back(const imm_t *imm, const real level, const int32_t *step, real *notes, const int64_t rows,
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
        come_back(imm, level, some.step, notes, some.rows, from, &known, &rooms, estimate);
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
        come_back(imm, level, step + from, notes + from * noted, stop - from, from, &later, &rooms, estimate);
    }
}
