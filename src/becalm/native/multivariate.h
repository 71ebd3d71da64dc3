/* The filter and the smoother of any model, its m channels together: z = H x + v, x' = F x + w.

   A state is a plain struct; its bytes are a checkpoint. Rows are processed one after the other, so that any cut gives
   the same bits. */
#ifndef BECALM_MULTIVARIATE_H
#define BECALM_MULTIVARIATE_H

#include "kernel.h"

enum { GAIN = 1, COVARIANCE = 2 }; /* what has settled: the gain, or the covariance, too */

/* What is known of a model, but for its steps. */
typedef struct {
    int64_t states, channels; /* n, m */
    int64_t enough;           /* what has to settle before a gain is used again: GAIN, or COVARIANCE */
    int64_t foretells;        /* whether `prior` determines the state, so that the first rows are predicted by it */
    const real *H, *R;        /* (m, n), (m, m) */
    const real *prior, *right; /* U (n, n) and b (n) of the information U x = b + e before the first measurement */
} multivariate_t;

/* Rows of measurements, and the steps before them: rows first[s] to first[s + 1] - 1 follow step[s] each; -1: none. */
typedef struct {
    const real *z;       /* (rows, m) in the channels' units; NaN where missing */
    const int64_t *first, *step;
    const real *F, *Q;   /* of the steps, (n, n) each */
    const real *lengths; /* of the steps: equal ones are the same step, in every block that a state goes through */
    int64_t rows;
} record_t;

/* What is estimated of them; NULL where it is not wanted. */
typedef struct {
    real *signal, *sigma;         /* (rows, m) H x; NaN and inf while measurements do not tell it */
    real *innovation, *deviation; /* (rows, m) and what is expected of it; NaN where there is no measurement, or prediction */
    real *x, *P;                  /* (rows, n), (rows, n, n); NaN and inf while measurements do not determine them */
} beliefs_t;

/* All that later rows depend on. */
typedef struct {
    int64_t phase;                /* UNKNOWN, GATHERING, DETERMINED */
    int64_t rows, opened, settled_row; /* so far; until measurements determined the state; the first with a settled gain, -1 */
    int64_t settled, steady, next_check, agreed, proven; /* 0, GAIN or COVARIANCE; see filter_t */
    real last_step;               /* its length; -1: none */
    int64_t closed;               /* whether A and g are those of the last step */
    score_t score;
    real numbers[];               /* x, P, K, L, D, nu, deviation; as at the last check; A, g: see multivariate.c */
} knowledge_t;

/* Bytes of a state. */
int64_t multivariate_size(int64_t states, int64_t channels);
/* Return whether a state, which may come from a file, is one that such a model can have. */
int multivariate_is_sound(const multivariate_t *model, const knowledge_t *state);
/* Begin with the state before the first row: x (n) and P (n, n), or nothing but the model's prior, where they are NULL. */
void multivariate_start(const multivariate_t *model, const real *x, const real *P, knowledge_t *state);
void multivariate_filter(const multivariate_t *model, knowledge_t *state, const record_t *record,
                         const beliefs_t *beliefs);
/* Bytes of room that smoothing takes beside the state. */
int64_t multivariate_room(int64_t states, int64_t channels, int64_t rows);
/* Filter a record and come back over it, with what later rows say of its last one, which changes to what its own rows
   say, too. Innovations stay those of the filter, and are needed. */
void multivariate_smooth(const multivariate_t *model, knowledge_t *state, const record_t *record,
                         const beliefs_t *beliefs, future_t *future, void *room);
/* Bytes of room that a fixed lag takes. */
int64_t multivariate_lag_room(int64_t states, int64_t channels, int64_t lag);
/* Smooth the first `told` rows, whose steps are all alike, by those up to `lag` after each, from the state before them,
   which becomes that after them; no step precedes the first row of all. `signal` and `sigma` are (told, m). */
void multivariate_lag(const multivariate_t *model, knowledge_t *state, const record_t *record, int64_t lag,
                      int64_t told, real *signal, real *sigma, void *room);
/* What is known of the future at the end of a record. */
void multivariate_end(const multivariate_t *model, future_t *future);

#endif
