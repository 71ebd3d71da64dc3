/* The IMM filter. Before each row the states of the modes are mixed with the transition probabilities. Then each mode
   predicts and updates its state, and the likelihoods of the measurement update the mode probabilities. Source: Blom
   and Bar-Shalom, IEEE TAC-33 (1988) 780. */
#include "imm.h"

#include <string.h>

#include "filter.h"
#include "modes.h"
#include "normal.h"
#include "pair.h"
#include "product.h"

#define SELDOM ((real)1e-8)  /* least weight of a part in a mixture; one Gaussian cannot represent rarer parts */
#define FARTHEST ((real)1e300) /* half of nu^2 / S; with a larger value, nu has no information on the modes */

int64_t imm_beliefs_size(const int64_t states, const int64_t modes) { return modes * (1 + states + states * states); }
int64_t imm_note_size(const int64_t states, const int64_t modes) {
    return imm_beliefs_size(states, modes) + NOTED * modes;
}
int64_t imm_filter_room(const int64_t states, const int64_t modes) {
    const int64_t n = states, pairs = (modes + 1) / 2;
    return 2 * (pairs * (4 * n * n + 3 * n) + n * n);
}

enum { PAIRS = MODES_MAX / 2 };

INLINE pair_t within(const pair_t value) {
    const mask_t above = value > both(LARGEST), below = value < both(-LARGEST);
    return above[0] | above[1] | below[0] | below[1] ? choose(above, both(LARGEST), choose(below, both(-LARGEST), value))
                                                     : value;
}

/* The states of all modes at a row, in pairs of modes. If the number of modes is odd, the last pair has no second mode:
   in its place F and Q hold 0 and R holds 1; other numbers there are ignored. */
typedef struct {
    real mu[MODES_MAX];
    pair_t *x, *P; /* (pairs, n), (pairs, n, n) */
} pairs_t;

/* The likelihood of a measurement for each mode. */
typedef struct {
    real prior[MODES_MAX];           /* probability of the mode before the measurement */
    real y[MODES_MAX], S[MODES_MAX]; /* prediction of the measurement, and innovation variance */
    real weight[MODES_MAX];          /* density of the measurement, without a common factor */
    real wild[MODES_MAX];            /* share of outliers in this density */
    real square;                     /* the common factor is exp(-square / 2) over the root of 2 pi */
} mode_likelihoods_t;

/* The matrices of the modes for one step, and their measurement noise. */
typedef struct {
    pair_t T[PAIRS * MODES_MAX], R[PAIRS], tail[PAIRS], *F, *Q; /* (pairs, M), (pairs), (pairs), (pairs, n, n) */
    int tails;                                                  /* whether any tail is above 0 */
} step_t;

INLINE void load(const int n, const int m, const real *beliefs, pairs_t *now) {
    for (int j = 0; j < m; j++) now->mu[j] = beliefs[j];
    pack_modes(n, m, beliefs + m, now->x);
    pack_modes(n * n, m, beliefs + m + m * n, now->P);
}

INLINE void save(const int n, const int m, const pairs_t *now, real *beliefs) {
    for (int j = 0; j < m; j++) beliefs[j] = now->mu[j];
    unpack_modes(n, m, now->x, beliefs + m);
    unpack_modes(n * n, m, now->P, beliefs + m + m * n);
}

/* Write the probability of each mode before the step, given each of two modes after it; rare modes get 0. Return the
   probabilities of the two modes (1). */
INLINE pair_t mixing_weights(const int m, const real *mu, const pair_t *T, pair_t *w) {
    pair_t c = both(0), kept = both(0);
    for (int i = 0; i < m; i++) w[i] = mu[i] * T[i], c += w[i];
    const mask_t reached = c > both(UNLIKELY); /* otherwise no transition leads to the mode: mix all modes */
    if (!(reached[0] & reached[1]))
        for (int i = 0; i < m; i++) w[i] = choose(reached, w[i], both(mu[i]));
    for (int i = 0; i < m; i++) w[i] = choose(w[i] > SELDOM * c, w[i], both(0)), kept += w[i];
    kept = 1 / kept;
    for (int i = 0; i < m; i++) w[i] *= kept;
    w[m] = both(0); /* with an odd number of modes, the last pair has no second mode */
    return choose(reached, c, both(UNLIKELY));
}

/* Mix the states from which each of two modes starts a step (2), (3), and predict them (4). */
INLINE void step_pair(const int n, const int m, const pair_t *w, const pairs_t *now, const pair_t *F, const pair_t *Q,
                      pair_t *x, pair_t *P, pair_t *room) {
    pair_t mixed[N_MAX], FP[N_MAX];
    UNROLL
    for (int a = 0; a < n; a++) {
        pair_t s = both(0);
        for (int i = 0; i < m; i += 2) {
            const pair_t x_a = now->x[i / 2 * n + a];
            s += w[i] * first_of(x_a), s += w[i + 1] * second_of(x_a);
        }
        mixed[a] = s;
    }
    UNROLL
    for (int a = 0; a < n; a++) {
        UNROLL
        for (int b = 0; b <= a; b++) {
            pair_t s = both(0);
            for (int i = 0; i < m; i += 2) {
                const pair_t *x_i = now->x + i / 2 * n, P_i = now->P[i / 2 * n * n + a * n + b];
                s += w[i] * (first_of(P_i) + (first_of(x_i[a]) - mixed[a]) * (first_of(x_i[b]) - mixed[b]));
                s += w[i + 1] * (second_of(P_i) + (second_of(x_i[a]) - mixed[a]) * (second_of(x_i[b]) - mixed[b]));
            }
            room[a * n + b] = room[b * n + a] = within(s);
        }
    }
    UNROLL
    for (int a = 0; a < n; a++) {
        pair_t s = both(0);
        for (int b = 0; b < n; b++) s += F[a * n + b] * mixed[b];
        x[a] = within(s);
    }
    UNROLL
    for (int a = 0; a < n; a++) {
        UNROLL
        for (int b = 0; b < n; b++) {
            pair_t s = both(0);
            UNROLL
            for (int c = 0; c < n; c++) s += F[a * n + c] * room[c * n + b];
            FP[b] = s;
        }
        UNROLL
        for (int b = 0; b <= a; b++) {
            pair_t s = both(0);
            UNROLL
            for (int c = 0; c < n; c++) s += FP[c] * F[b * n + c];
            P[a * n + b] = P[b * n + a] = Q[a * n + b] + s;
        }
    }
}

/* Write each of two modes' prediction of the measurement, its variance (5), and P h. */
INLINE void expect(const int n, const real *h, const pair_t R, const pair_t *x, const pair_t *P, pair_t *Ph, pair_t *y,
                   pair_t *S) {
    *y = both(0), *S = R;
    UNROLL
    for (int a = 0; a < n; a++) {
        pair_t s = both(0);
        UNROLL
        for (int b = 0; b < n; b++) s += P[a * n + b] * h[b];
        Ph[a] = s, *S += h[a] * s, *y += h[a] * x[a];
    }
}

/* Write the likelihood of a measurement for each mode, without a common factor (6). */
INLINE void judge_modes(const int m, const imm_t *imm, const step_t *step, const real z,
                        mode_likelihoods_t *likelihood) {
    real half[MODES_MAX], half_wild[MODES_MAX], least = FARTHEST; /* half of nu^2 over variance */
    for (int j = 0; j < m; j += 2) {
        const pair_t nu = z - *at(likelihood->y + j), square = (real)0.5 * nu * nu;
        *at(half + j) = square / *at(likelihood->S + j);
        if (step->tails) *at(half_wild + j) = square / (*at(likelihood->S + j) + imm->V);
    }
    for (int j = 0; j < m; j++) {
        least = half[j] < least ? half[j] : least;
        if (step->tails && imm->tail[j] > 0) least = half_wild[j] < least ? half_wild[j] : least;
    }
    for (int j = 0; j < m; j += 2) {
        const pair_t S = *at(likelihood->S + j), t = step->tail[j / 2];
        pair_t weight = (1 - t) / roots(S) * exponentials(least - *at(half + j)), share = both(0);
        if (step->tails) {
            const pair_t wild = t / roots(S + imm->V) * exponentials(least - *at(half_wild + j));
            weight += wild, share = choose(wild > both(0), wild / weight, both(0));
        }
        *at(likelihood->weight + j) = weight, *at(likelihood->wild + j) = share;
    }
    likelihood->square = 2 * least;
}

/* Update two modes (7), in Joseph's form, B - (B h) K' + K R K' with B = P - K (P h)'. If the measurement may be an
   outlier, the result is the mixture of both cases; `tame` is the probability that it is no outlier. */
INLINE void correct_pair(const int n, const real *h, const int rejects, const pair_t R, const pair_t S, const pair_t nu,
                         const pair_t tame, const pair_t *Ph, pair_t *x, pair_t *P) {
    pair_t K[N_MAX], B[N_MAX];
    const pair_t share = 1 / S;
    UNROLL
    for (int a = 0; a < n; a++) K[a] = Ph[a] * share, x[a] += tame * K[a] * nu;
    UNROLL
    for (int a = 0; a < n; a++) {
        pair_t Bh = both(0);
        UNROLL
        for (int b = 0; b < n; b++) B[b] = P[a * n + b] - K[a] * Ph[b], Bh += B[b] * h[b];
        UNROLL
        for (int b = 0; b <= a; b++) {
            const pair_t KK = K[a] * K[b], updated = B[b] - Bh * K[b] + R * KK;
            pair_t mixed = updated;
            if (rejects) mixed = tame * updated + (1 - tame) * (P[a * n + b] + tame * nu * nu * KK);
            P[a * n + b] = P[b * n + a] = mixed;
        }
    }
}

/* Write the probability of each mode after a measurement (8); return its density, without the common factor. */
INLINE real weigh(const int m, const mode_likelihoods_t *likelihood, real *mu) {
    real total = 0;
    for (int j = 0; j < m; j++) mu[j] = likelihood->prior[j] * likelihood->weight[j], total += mu[j];
    const int possible = total > 1 / FARTHEST; /* if no mode explains the measurement, the probabilities stay */
    const real share = possible ? 1 / total : 1;
    for (int j = 0; j < m; j++) {
        const real own = possible ? mu[j] * share : likelihood->prior[j];
        mu[j] = own > UNLIKELY ? own : UNLIKELY;
    }
    return possible ? total : 1 / FARTHEST;
}

/* Start with the first measurement. */
INLINE void begin(const int n, const int m, const imm_t *imm, const real z, pairs_t *now) {
    for (int j = 0; j < m; j++) {
        const real *start = imm->start + j * (1 + n);
        real *x = numbers_of(now->x, n, j), *P = numbers_of(now->P, n * n, j);
        now->mu[j] = start[0];
        for (int a = 0; a < n; a++) {
            x[2 * a] = a == 0 ? z : 0;
            for (int b = 0; b < n; b++) P[2 * (a * n + b)] = a == b ? start[1 + a] : 0;
        }
    }
}

/* Write the estimates of a row. */
INLINE void write_pairs(const int n, const int m, const real *c, const real level, const pairs_t *now, const int64_t row,
                        const imm_estimate_t *estimate) {
    if (estimate->signal) {
        pair_t own[PAIRS], spread[PAIRS], Pc[N_MAX];
        real y = 0, v = 0;
        for (int q = 0; 2 * q < m; q++)
            expect(n, c, both(0), now->x + q * n, now->P + q * n * n, Pc, own + q, spread + q);
        for (int j = 0; j < m; j++) y += now->mu[j] * own[j / 2][j % 2];
        for (int j = 0; j < m; j++) {
            const real apart = own[j / 2][j % 2] - y;
            v += now->mu[j] * (spread[j / 2][j % 2] + apart * apart);
        }
        estimate->signal[row] = y + level, estimate->sigma[row] = v > 0 ? sqrt(v) : 0;
    }
    if (estimate->probability)
        for (int j = 0; j < m; j++) estimate->probability[j * estimate->rows + row] = now->mu[j];
    if (estimate->mean)
        for (int a = 0; a < n; a++) {
            real s = 0;
            for (int j = 0; j < m; j++) s += now->mu[j] * numbers_of(now->x, n, j)[2 * a];
            estimate->mean[a * estimate->rows + row] = s;
        }
}

/* Write the innovation of the mixture. The mixture is not Gaussian, but the probability of a smaller measurement under
   the mixture is uniformly distributed. The normal quantile of this probability, the score, is standard normal and
   white. Source: Rosenblatt, Annals of Mathematical Statistics 23 (1952) 470. */
static void write_innovation(const int m, const imm_t *imm, const real z, const mode_likelihoods_t *likelihood,
                             const int64_t row, const imm_estimate_t *estimate) {
    real y = 0, v = 0, sides[2] = {0, 0}; /* probability of smaller and of larger measurements */
    for (int j = 0; j < m; j++) y += likelihood->prior[j] * likelihood->y[j];
    for (int j = 0; j < m; j++) {
        const real t = imm->tail[j], nu = z - likelihood->y[j];
        const int larger = nu > 0;
        v += likelihood->prior[j] * (likelihood->S[j] + (likelihood->y[j] - y) * (likelihood->y[j] - y));
        real beyond = (1 - t) * upper_tail(fabs(nu) / sqrt(likelihood->S[j]));
        if (t > 0) beyond += t * upper_tail(fabs(nu) / sqrt(likelihood->S[j] + imm->V));
        sides[larger] += likelihood->prior[j] * beyond, sides[!larger] += likelihood->prior[j] * (1 - beyond);
    }
    const real sigma = sqrt(v);
    estimate->innovation[row] = sigma * normal_score(sides[0], sides[1]), estimate->innovation_sigma[row] = sigma;
}

/* Store the likelihood of a measurement for each mode: p, W and g of exp(g + p h d - W (h d)^2 / 2), where d is the
   difference between the state and its posterior mean x. W is w / R, and p is W (z - h x). w is 1 or, if outliers are
   rejected, the probability that the measurement is no outlier. g is chosen so that the mean of this function over the
   mode's prediction equals the likelihood in the filter (9). */
INLINE void store_likelihoods(const int n, const int m, const imm_t *imm, const real z,
                              const mode_likelihoods_t *likelihood, const pairs_t *now, real *noted) {
    for (int j = 0; j < m; j++, noted += NOTED) {
        const real t = imm->tail[j], R = imm->R[j], s = likelihood->S[j] - R, nu = z - likelihood->y[j];
        const real W = (imm->rejects ? 1 - likelihood->wild[j] : 1) / R;
        real y = z;
        for (int a = 0; a < n; a++) y -= imm->h[a] * numbers_of(now->x, n, j)[2 * a];
        const real S = likelihood->S[j], own = likelihood->weight[j];
        const real weight = own > 1 / FARTHEST /* otherwise the weight has lost its digits */
                                ? logarithm(own)
                                : (real)0.5 * (likelihood->square - nu * nu / S) + logarithm((1 - t) / sqrt(S));
        noted[0] = W * y, noted[1] = W;
        noted[2] = weight + (real)0.5 * (logarithm(1 + W * s) + W * nu * nu / (1 + W * s) - W * y * y);
    }
}

/* Update all modes with a measurement; return its density without the common factor. */
INLINE real update(const int n, const int m, const imm_t *imm, const step_t *step, const real z, pairs_t *now,
                   pair_t *Ph, mode_likelihoods_t *likelihood) {
    for (int q = 0; 2 * q < m; q++)
        expect(n, imm->h, step->R[q], now->x + q * n, now->P + q * n * n, Ph + q * n, at(likelihood->y + 2 * q),
               at(likelihood->S + 2 * q));
    for (int j = 0; j < m; j++) likelihood->prior[j] = now->mu[j];
    judge_modes(m, imm, step, z, likelihood);
    for (int q = 0; 2 * q < m; q++) {
        const pair_t nu = z - *at(likelihood->y + 2 * q);
        pair_t tame = both(1);
        if (imm->rejects) tame -= *at(likelihood->wild + 2 * q);
        correct_pair(n, imm->h, imm->rejects != 0, step->R[q], *at(likelihood->S + 2 * q), nu, tame, Ph + q * n,
                     now->x + q * n, now->P + q * n * n);
    }
    return weigh(m, likelihood, now->mu);
}

/* Arrange the matrices of a step in pairs of modes. */
INLINE void lay_out(const int n, const int m, const imm_t *imm, const int64_t number, step_t *step) {
    pack_modes(n * n, m, imm->F + number * m * n * n, step->F);
    pack_modes(n * n, m, imm->Q + number * m * n * n, step->Q);
    for (int q = 0; 2 * q < m; q++) {
        step->R[q] = both(1), step->tail[q] = both(0);
        for (int i = 0; i < m; i++) step->T[q * m + i] = both(0);
    }
    for (int j = 0; j < m; j++) {
        step->R[j / 2][j % 2] = imm->R[j], step->tail[j / 2][j % 2] = imm->tail[j], step->tails |= imm->tail[j] > 0;
        for (int i = 0; i < m; i++) step->T[j / 2 * m + i][j % 2] = imm->T[(number * m + i) * m + j];
    }
}

INLINE void filter_rows(const int n, const imm_t *imm, real *beliefs, const real level, const imm_block_t *block,
                        const imm_estimate_t *estimate, const imm_passed_t *passed, real *memory, score_t *score) {
    const int m = (int)imm->modes, nn = n * n, pairs = (m + 1) / 2;
    const int64_t size = imm_beliefs_size(n, m), noted = imm_note_size(n, m);
    pair_t *room = (pair_t *)memory;
    pairs_t now = {{0}, room, room + pairs * n}, next = {{0}, now.P + pairs * nn, now.P + pairs * (nn + n)};
    pair_t *Ph = next.P + pairs * nn, *rest = Ph + pairs * n;
    step_t step = {.F = rest, .Q = rest + pairs * nn};
    int32_t laid_out = -1;
    rest = step.Q + pairs * nn;
    load(n, m, beliefs, &now);
    for (int64_t row = 0; row < block->rows; row++) {
        const real z = block->z[row] - level;
        const int arrived = fabs(block->z[row]) <= imm->largest;
        int judged = 0;
        mode_likelihoods_t likelihood;
        if (passed->before && row % IMM_BLOCK == 0) save(n, m, &now, passed->before + row / IMM_BLOCK * size);
        if (now.mu[0] > 0) {
            if (block->step[row] != laid_out) laid_out = block->step[row], lay_out(n, m, imm, laid_out, &step);
            for (int q = 0; q < pairs; q++) {
                pair_t w[MODES_MAX + 1];
                const pair_t c = mixing_weights(m, now.mu, step.T + q * m, w);
                for (int j = 2 * q; j < m && j < 2 * q + 2; j++) next.mu[j] = c[j % 2];
                step_pair(n, m, w, &now, step.F + q * nn, step.Q + q * nn, next.x + q * n, next.P + q * nn, rest);
            }
            const pairs_t last = now;
            now = next, next = last;
            if (arrived) {
                const real density = update(n, m, imm, &step, z, &now, Ph, &likelihood);
                judged = 1;
                score->squares += likelihood.square, score->used++;
                score->product = near_one(score->product * near_one(density, &score->exponent), &score->exponent);
            }
        } else if (arrived)
            begin(n, m, imm, z, &now);
        if (now.mu[0] > 0) write_pairs(n, m, imm->c, level, &now, row, estimate);
        if (judged && estimate->innovation) write_innovation(m, imm, z, &likelihood, row, estimate);
        if (judged && estimate->wild) {
            estimate->wild[row] = 0;
            for (int j = 0; j < m; j++) estimate->wild[row] += now.mu[j] * likelihood.wild[j];
        }
        if (passed->notes) {
            real *noted_row = passed->notes + row * noted;
            save(n, m, &now, noted_row);
            if (judged)
                store_likelihoods(n, m, imm, z, &likelihood, &now, noted_row + size);
            else
                memset(noted_row + size, 0, sizeof(real) * (size_t)(noted - size));
        }
    }
    save(n, m, &now, beliefs);
}

void filter_modes(const imm_t *imm, real *beliefs, const real level, const imm_block_t *block,
                  const imm_estimate_t *estimate, const imm_passed_t *passed, real *room, score_t *score) {
    FOR_FEW_STATES(imm->states, filter_rows, imm, beliefs, level, block, estimate, passed, room, score)
}

void imm_filter(const imm_t *imm, imm_state_t *state, const imm_block_t *block, const imm_estimate_t *estimate,
                const imm_passed_t *passed, real *room, score_t *score) {
    for (int64_t row = 0; row < block->rows && !state->has_level; row++) {
        const real first = block->z[row];
        if (!(fabs(first) <= imm->largest)) continue;
        state->level = fabs(first) <= imm->largest_level ? first : 0, state->has_level = 1;
    }
    filter_modes(imm, state->beliefs, state->level, block, estimate, passed, room, score);
}

int imm_is_sound(const imm_t *imm, const imm_state_t *state) {
    const int64_t n = imm->states, m = imm->modes, size = imm_beliefs_size(n, m);
    const real *mu = state->beliefs;
    if (state->layout != IMM_LAYOUT || state->states != n || state->modes != m) return 0;
    if ((state->has_level != 0 && state->has_level != 1) || !(fabs(state->level) <= BEYOND_ANY_SENSOR)) return 0;
    for (int64_t i = 0; i < size; i++)
        if (!(fabs(mu[i]) < INFINITE)) return 0;
    for (int64_t j = 0; j < m; j++)
        if (mu[0] > 0 ? !(mu[j] > 0 && mu[j] <= 2) : mu[j] != 0) return 0;
    return 1; /* a variance may be negative: after a measurement of 1e12 sigma it has no digits */
}
