/* The filter and the smoother of a model of m channels: z = H x + v, x' = F x + w.

   A state is a plain struct; its bytes are a checkpoint. Rows are processed one after the other, so that the boundaries
   between blocks change no bit. */
#ifndef BECALM_MULTIVARIATE_H
#define BECALM_MULTIVARIATE_H

#include "kernel.h"

enum { GAIN = 1, COVARIANCE = 2 }; /* what has settled: only the gain, or also the covariance */

/* A model without its steps. */
typedef struct {
    int64_t states, channels; /* n, m */
    int64_t enough;           /* what must settle before a gain is reused: GAIN, or COVARIANCE */
    int64_t proper_prior;     /* whether `prior` determines the state, so that it predicts the first rows */
    const real *H, *R;        /* (m, n), (m, m) */
    const real *prior, *right; /* U (n, n) and b (n) of the information U x = b + e before the first measurement */
} multivariate_t;

/* Measurements and the steps before them: the step with index step[s] precedes the rows first[s] to first[s + 1] - 1;
   -1 means no step. */
typedef struct {
    const real *z;       /* (rows, m) in the channels' units; NaN where missing */
    const int64_t *first, *step;
    const real *F, *Q;   /* matrices of the steps, (n, n) each */
    const real *lengths; /* lengths of the steps; equal lengths mean equal matrices, in all blocks of a state */
    int64_t rows;
} record_t;

/* Output arrays for the estimates; NULL: not written. */
typedef struct {
    real *signal, *sigma;         /* (rows, m) H x; NaN and inf while it is undetermined */
    real *innovation, *deviation; /* (rows, m), with standard deviation; NaN without a measurement or prediction */
    real *x, *P;                  /* (rows, n), (rows, n, n); NaN and inf while they are undetermined */
} estimates_t;

/* The state: everything that later rows depend on. */
typedef struct {
    int64_t phase;                /* UNKNOWN, GATHERING, DETERMINED, LOST */
    int64_t rows, opened, settled_row; /* numbers of rows, and of rows before the state is determined; first row
                                          with the steady-state gain, -1: none */
    int64_t settled, steady, next_check, agreed, proven; /* as in filter_t; settled, proven: 0, GAIN, COVARIANCE */
    real last_step;               /* length of the step before the last complete row; -1: none */
    int64_t closed;               /* whether A and g belong to the last step */
    score_t score;
    real numbers[];               /* the arrays of parts_t in multivariate.c */
} multivariate_state_t;

/* Return the number of bytes of a state. */
int64_t multivariate_size(int64_t states, int64_t channels);
/* Return whether a state, which may come from a file, is possible for this model. */
int multivariate_is_sound(const multivariate_t *model, const multivariate_state_t *state);
/* Set the state before the first row: x (n) and P (n, n), or the model's prior if they are NULL. */
void multivariate_start(const multivariate_t *model, const real *x, const real *P, multivariate_state_t *state);
void multivariate_filter(const multivariate_t *model, multivariate_state_t *state, const record_t *record,
                         const estimates_t *estimates);
/* Return the number of bytes of working memory for the smoother. */
int64_t multivariate_room(int64_t states, int64_t channels, int64_t rows);
/* Filter and smooth rows, with the information of later rows in `future`, which afterwards includes these rows. The
   array for innovations is needed; it gets those of the filter. */
void multivariate_smooth(const multivariate_t *model, multivariate_state_t *state, const record_t *record,
                         const estimates_t *estimates, future_t *future, void *room);
/* Return the number of bytes of working memory for a fixed lag. */
int64_t multivariate_lag_room(int64_t states, int64_t channels, int64_t lag);
/* Smooth the first `ready` rows with the rows up to `lag` after each. Afterwards the state is that after these rows.
   All steps are equal; the very first row has no step before it. `signal` and `sigma` are (ready, m). */
void multivariate_lag(const multivariate_t *model, multivariate_state_t *state, const record_t *record, int64_t lag,
                      int64_t ready, real *signal, real *sigma, void *room);
/* Set the information of later rows at the end of a record, where there are no later rows. */
void multivariate_end(const multivariate_t *model, future_t *future);

#endif
